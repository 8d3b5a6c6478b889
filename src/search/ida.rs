//! Iterative deepening A* over worlds whose successors are dear (Korf 1985).
//!
//! Method: depth-first search for paths whose estimate f = g + (1 + w) h stays within a limit; the
//! limit then rises to the least estimate that exceeded it. States are numbered by their key, a
//! state's successors are asked for once and kept, and none is searched again within one round at
//! no lower cost and no shallower depth. Successors come in order of f. One that is dear to make may
//! be promised with lower bounds of its cost and of what remains after it; it is made when its turn
//! comes.
//!
//! Guarantees: with w = 0, no patience with branches set, and an h that never exceeds what is left to pay, a goal found is one of
//! least g + h among those within the depth allowed, up to [`TIE`]. The result is the same for the
//! same answers of the world. Not guaranteed: that with w > 0 the goal is a cheapest one; that the
//! search ends early when no goal exists, for which there are limits.
//!
//! ```
//! use hmplan::search::{IdaOptions, Made, Successor, World, ida};
//! /// Steps of 1 and 3 to 7, each for 1.
//! struct Line;
//! impl World for Line {
//!     type State = u32;
//!     type Action = u32;
//!     type Error = std::convert::Infallible;
//!     fn key(&self, s: &u32) -> u128 { u128::from(*s) }
//!     fn remaining(&self, s: &u32) -> f64 { f64::from(7u32.abs_diff(*s)) / 3.0 }
//!     fn is_goal(&self, s: &u32) -> bool { *s == 7 }
//!     fn successors(&self, s: &u32) -> Result<Vec<Successor<u32, u32>>, Self::Error> {
//!         let step = |by| Successor::Made(Made { action: by, cost: 1.0, state: *s + by });
//!         Ok([1, 3].map(step).into())
//!     }
//! }
//! let found = ida(&Line, 0, &IdaOptions::default(), &mut |_| true).unwrap();
//! assert_eq!((found.cost, found.path.len()), (3.0, 3));
//! ```

use std::collections::HashMap;

/// Estimates that differ by no more than this share are the same: sums of the same costs in
/// another order differ in the last digits.
pub const TIE: f64 = 1e-12;

/// A successor that has been made.
#[derive(Clone, Debug)]
pub struct Made<S, A> {
    pub action: A,
    /// Finite, not negative.
    pub cost: f64,
    pub state: S,
}

/// A way on from a state.
#[derive(Clone, Debug)]
pub enum Successor<S, A> {
    Made(Made<S, A>),
    /// Not made yet; neither figure exceeds that of what will be made.
    Promised {
        action: A,
        cost_at_least: f64,
        remaining_at_least: f64,
    },
}

/// What is searched.
pub trait World {
    type State;
    type Action: Clone;
    type Error;

    /// Equal for equal states and, for all practical purposes, for no others.
    fn key(&self, state: &Self::State) -> u128;

    /// h: an estimate of what is left to pay.
    fn remaining(&self, state: &Self::State) -> f64;

    fn is_goal(&self, state: &Self::State) -> bool;

    /// How far a state is from any goal: of paths that reach none, the one that ends nearest is
    /// kept.
    fn shortfall(&self, state: &Self::State) -> f64 {
        self.remaining(state)
    }

    /// All ways on.
    fn successors(&self, state: &Self::State) -> Result<Successors<Self>, Self::Error>;

    /// Makes a promised successor; none when it turns out to lead nowhere.
    fn make(
        &self,
        _state: &Self::State,
        _action: &Self::Action,
    ) -> Result<Option<(f64, Self::State)>, Self::Error> {
        Ok(None)
    }
}

/// The ways on from a state of a world.
pub type Successors<W> = Vec<Successor<<W as World>::State, <W as World>::Action>>;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IdaOptions {
    /// w ≥ 0: how much more the remaining estimate counts than what was paid.
    pub weight: f64,
    /// Longest path, in actions.
    pub most_steps: usize,
    /// States whose successors are asked for at most.
    pub most_expanded: usize,
    /// States expanded in a branch of the start without coming nearer, before the next branch has
    /// its turn, however high its estimate; the rest of the branch waits for the next round. None
    /// searches each branch to its end, as a cheapest path asks for.
    pub branch_patience: Option<usize>,
}

impl Default for IdaOptions {
    fn default() -> Self {
        IdaOptions {
            weight: 0.0,
            most_steps: usize::MAX,
            most_expanded: usize::MAX,
            branch_patience: None,
        }
    }
}

/// How far a search is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Status {
    pub round: usize,
    /// The limit of f in this round.
    pub limit: f64,
    pub depth: usize,
    /// States seen, and those whose successors were asked for.
    pub states: usize,
    pub expanded: usize,
    /// The least shortfall of any state seen.
    pub shortfall: f64,
}

/// Why a search ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    Goal,
    /// No path within the depth allowed leads to a goal.
    Exhausted,
    /// The caller, or [`IdaOptions::most_expanded`], stopped it.
    Stopped,
}

/// A state seen, in the order in which states were seen; the first is the start.
#[derive(Clone, Debug, PartialEq)]
pub struct Seen<A> {
    /// The state it was first reached from, and how.
    pub from: Option<(usize, A)>,
    /// g of that way.
    pub paid: f64,
    pub remaining: f64,
    pub shortfall: f64,
    pub goal: bool,
    /// When its successors were asked for, counted from 0.
    pub expanded: Option<usize>,
}

/// What a search gives: a path to a goal, else the one that ends nearest to one.
#[derive(Clone, Debug)]
pub struct Found<A> {
    pub ending: Ending,
    pub path: Vec<A>,
    /// g of the path, and h at its end.
    pub paid: f64,
    pub remaining: f64,
    /// g + h.
    pub cost: f64,
    /// How far its end is from a goal: see [`World::shortfall`].
    pub shortfall: f64,
    /// h of the start.
    pub bound: f64,
    pub rounds: usize,
    pub expanded: usize,
    pub tree: Vec<Seen<A>>,
}

/// Searches from `start`. `go_on` is asked before every expansion and may stop the search.
///
/// # Errors
/// Those of the world.
pub fn ida<W: World>(
    world: &W,
    start: W::State,
    options: &IdaOptions,
    go_on: &mut dyn FnMut(&Status) -> bool,
) -> Result<Found<W::Action>, W::Error> {
    let mut search = Search {
        world,
        options,
        go_on,
        nodes: Vec::new(),
        numbers: HashMap::new(),
        expanded: 0,
        round: 0,
        limit: 0.0,
        next_limit: f64::INFINITY,
        best: Best { shortfall: f64::INFINITY, paid: 0.0, path: Vec::new(), node: 0 },
        branch: Branch::default(),
    };
    let (start, _) = search.number(start, None, 0.0);
    search.consider(start, 0.0, &[], None);
    let bound = search.nodes[start].seen.remaining;
    search.limit = search.estimate(0.0, bound);
    let ending = loop {
        search.round += 1;
        search.next_limit = f64::INFINITY;
        search.branch = Branch::default();
        let before = search.expanded;
        match search.round(start)? {
            Some(ending) => break ending,
            None if search.next_limit < f64::INFINITY => {
                // One that was left waits for the next that has not had its turn.
                let turn = search.branch.next.filter(|_| search.branch.left);
                search.limit = turn.unwrap_or(search.next_limit);
            }
            // Something waits for this round, unless nothing new was found in the last one.
            None if search.branch.left && search.expanded > before => {}
            None => break Ending::Exhausted,
        }
    };
    let remaining = search.nodes[search.best.node].seen.remaining;
    Ok(Found {
        ending,
        paid: search.best.paid,
        remaining,
        cost: search.best.paid + remaining,
        shortfall: search.nodes[search.best.node].seen.shortfall,
        path: search.best.path,
        bound,
        rounds: search.round,
        expanded: search.expanded,
        tree: search.nodes.into_iter().map(|n| n.seen).collect(),
    })
}

enum Way<A> {
    Made { action: A, cost: f64, to: usize },
    Promised { action: A, cost_at_least: f64, remaining_at_least: f64 },
    Nowhere,
}

struct Node<S, A> {
    state: S,
    seen: Seen<A>,
    ways: Option<Vec<Way<A>>>,
    /// (round, g, depth) with which it was searched; in one round only the best of them.
    searched: Vec<(usize, f64, usize)>,
}

/// A state on the current path.
struct Level {
    node: usize,
    paid: f64,
    /// Ways still to go, the best last, with their f.
    left: Vec<(f64, usize)>,
    /// The way by which the path goes on.
    way: usize,
}

/// The branch of the start that is being searched.
#[derive(Default)]
struct Branch {
    /// Its nearest state so far, and when that was found.
    shortfall: f64,
    since: usize,
    /// Whether any branch was left early in this round.
    left: bool,
    /// The least f of a branch beyond the limit of this round.
    next: Option<f64>,
}

struct Best<A> {
    shortfall: f64,
    paid: f64,
    path: Vec<A>,
    node: usize,
}

struct Search<'a, W: World> {
    world: &'a W,
    options: &'a IdaOptions,
    go_on: &'a mut dyn FnMut(&Status) -> bool,
    nodes: Vec<Node<W::State, W::Action>>,
    numbers: HashMap<u128, usize>,
    expanded: usize,
    round: usize,
    limit: f64,
    next_limit: f64,
    best: Best<W::Action>,
    branch: Branch,
}

impl<W: World> Search<'_, W> {
    fn estimate(&self, paid: f64, remaining: f64) -> f64 {
        paid + (1.0 + self.options.weight) * remaining
    }

    fn exceeds(&self, f: f64) -> bool {
        f > self.limit + TIE * self.limit.abs()
    }

    /// The number of a state, and whether it is new.
    fn number(
        &mut self,
        state: W::State,
        from: Option<(usize, W::Action)>,
        paid: f64,
    ) -> (usize, bool) {
        let key = self.world.key(&state);
        if let Some(n) = self.numbers.get(&key) {
            return (*n, false);
        }
        let seen = Seen {
            from,
            paid,
            remaining: self.world.remaining(&state),
            shortfall: self.world.shortfall(&state),
            goal: self.world.is_goal(&state),
            expanded: None,
        };
        self.nodes.push(Node { state, seen, ways: None, searched: Vec::new() });
        self.numbers.insert(key, self.nodes.len() - 1);
        (self.nodes.len() - 1, true)
    }

    /// Keeps the path to a state when it ends nearer to a goal than any before.
    fn consider(&mut self, node: usize, paid: f64, path: &[Level], last: Option<&W::Action>) {
        let shortfall = self.nodes[node].seen.shortfall;
        if shortfall < self.branch.shortfall {
            (self.branch.shortfall, self.branch.since) = (shortfall, self.expanded);
        }
        let better = shortfall < self.best.shortfall
            || shortfall == self.best.shortfall && paid < self.best.paid;
        if better {
            let path = self.actions(path, last);
            self.best = Best { shortfall, paid, path, node };
        }
    }

    fn actions(&self, path: &[Level], last: Option<&W::Action>) -> Vec<W::Action> {
        let before = path[..path.len().saturating_sub(usize::from(last.is_some()))].iter();
        let steps = before.filter_map(|l| match self.nodes[l.node].ways.as_ref()?.get(l.way)? {
            Way::Made { action, .. } => Some(action.clone()),
            _ => None,
        });
        steps.chain(last.cloned()).collect()
    }

    /// One depth-first search within the limit; none when it ended without a goal.
    fn round(&mut self, start: usize) -> Result<Option<Ending>, W::Error> {
        let mut path: Vec<Level> = Vec::new();
        if let Some(ending) = self.enter(start, 0.0, &mut path)? {
            return Ok(Some(ending));
        }
        while !path.is_empty() {
            let vain = self.expanded - self.branch.since;
            if path.len() > 1 && self.options.branch_patience.is_some_and(|p| vain > p) {
                self.branch.left = true;
                path.truncate(1);
            }
            if path.len() == 1 {
                self.branch.shortfall = f64::INFINITY;
                self.branch.since = self.expanded;
            }
            let at_start = path.len() == 1;
            let Some(level) = path.last_mut() else { break };
            let Some((f, way)) = level.left.pop() else {
                path.pop();
                continue;
            };
            let (node, paid) = (level.node, level.paid);
            if self.exceeds(f) {
                self.next_limit = self.next_limit.min(f);
                if at_start {
                    self.branch.next = Some(self.branch.next.map_or(f, |next| next.min(f)));
                }
                continue;
            }
            let ways = self.nodes[node].ways.as_ref().map_or(&[][..], |w| &w[..]);
            match ways.get(way) {
                Some(Way::Made { cost, to, .. }) => {
                    let (to, paid) = (*to, paid + cost);
                    level.way = way;
                    if let Some(ending) = self.enter(to, paid, &mut path)? {
                        return Ok(Some(ending));
                    }
                }
                Some(Way::Promised { .. }) => {
                    if let Some(f) = self.redeem(node, way, paid, &path)? {
                        let Some(level) = path.last_mut() else { continue };
                        // Back into the order, best last.
                        let at = level.left.partition_point(|(other, _)| *other > f);
                        level.left.insert(at, (f, way));
                    }
                }
                _ => {}
            }
        }
        Ok(None)
    }

    /// Puts a state within the limit on the path, with its ways on; an ending when it is a goal or
    /// the search is stopped.
    fn enter(
        &mut self,
        node: usize,
        paid: f64,
        path: &mut Vec<Level>,
    ) -> Result<Option<Ending>, W::Error> {
        let depth = path.len();
        if self.nodes[node].seen.goal {
            let path = self.actions(path, None);
            self.best = Best { shortfall: 0.0, paid, path, node };
            return Ok(Some(Ending::Goal));
        }
        let round = self.round;
        let searched = &mut self.nodes[node].searched;
        searched.retain(|(r, ..)| *r == round);
        if depth >= self.options.most_steps
            || searched.iter().any(|(_, g, d)| *g <= paid && *d <= depth)
        {
            return Ok(None);
        }
        searched.push((round, paid, depth));
        if self.nodes[node].ways.is_none() {
            let status = Status {
                round,
                limit: self.limit,
                depth,
                states: self.nodes.len(),
                expanded: self.expanded,
                shortfall: self.best.shortfall,
            };
            if self.expanded >= self.options.most_expanded || !(self.go_on)(&status) {
                return Ok(Some(Ending::Stopped));
            }
            self.expand(node, paid, path)?;
        }
        let ways = self.nodes[node].ways.as_ref().map_or(&[][..], |w| &w[..]);
        let mut left: Vec<(f64, usize)> = ways
            .iter()
            .enumerate()
            .filter_map(|(i, way)| {
                let (cost, remaining) = match way {
                    Way::Made { cost, to, .. } => (*cost, self.nodes[*to].seen.remaining),
                    Way::Promised { cost_at_least, remaining_at_least, .. } => {
                        (*cost_at_least, *remaining_at_least)
                    }
                    Way::Nowhere => return None,
                };
                Some((self.estimate(paid + cost, remaining), i))
            })
            .collect();
        left.sort_by(|a, b| b.0.total_cmp(&a.0).then(b.1.cmp(&a.1)));
        path.push(Level { node, paid, left, way: usize::MAX });
        Ok(None)
    }

    fn expand(&mut self, node: usize, paid: f64, path: &mut Vec<Level>) -> Result<(), W::Error> {
        let successors = self.world.successors(&self.nodes[node].state)?;
        self.nodes[node].seen.expanded = Some(self.expanded);
        self.expanded += 1;
        path.push(Level { node, paid, left: Vec::new(), way: usize::MAX });
        let mut ways = Vec::with_capacity(successors.len());
        for successor in successors {
            ways.push(match successor {
                Successor::Made(Made { action, cost, state }) => {
                    let from = Some((node, action.clone()));
                    let (to, _) = self.number(state, from, paid + cost);
                    self.consider(to, paid + cost, path, Some(&action));
                    Way::Made { action, cost, to }
                }
                Successor::Promised { action, cost_at_least, remaining_at_least } => {
                    Way::Promised { action, cost_at_least, remaining_at_least }
                }
            });
        }
        path.pop();
        self.nodes[node].ways = Some(ways);
        Ok(())
    }

    /// Makes a promised way; its f, or none when it leads nowhere.
    fn redeem(
        &mut self,
        node: usize,
        way: usize,
        paid: f64,
        path: &[Level],
    ) -> Result<Option<f64>, W::Error> {
        let promised = self.nodes[node].ways.as_ref().and_then(|w| w.get(way));
        let Some(Way::Promised { action, .. }) = promised else { return Ok(None) };
        let action = action.clone();
        let made = self.world.make(&self.nodes[node].state, &action)?;
        let mut f = None;
        let mut kept = Way::Nowhere;
        if let Some((cost, state)) = made {
            let (to, _) = self.number(state, Some((node, action.clone())), paid + cost);
            self.consider(to, paid + cost, path, Some(&action));
            f = Some(self.estimate(paid + cost, self.nodes[to].seen.remaining));
            kept = Way::Made { action, cost, to };
        }
        if let Some(slot) = self.nodes[node].ways.as_mut().and_then(|w| w.get_mut(way)) {
            *slot = kept;
        }
        Ok(f)
    }
}
