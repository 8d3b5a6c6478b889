use super::ida::{Ending, IdaOptions, Made, Successor, World, ida};
use proptest::prelude::*;
use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::convert::Infallible;

/// A graph of a few states; h is a share of the true cost to the nearest goal.
#[derive(Debug)]
struct Graph {
    edges: Vec<Vec<(usize, f64)>>,
    goals: Vec<bool>,
    h: Vec<f64>,
    /// Edges whose number this divides are promised; 0 for none.
    promised: usize,
    /// How often each state's successors were asked for.
    asked: RefCell<BTreeMap<usize, usize>>,
    made: Cell<usize>,
}

impl World for Graph {
    type State = usize;
    type Action = usize;
    type Error = Infallible;

    fn key(&self, s: &usize) -> u128 {
        *s as u128
    }

    fn remaining(&self, s: &usize) -> f64 {
        self.h[*s]
    }

    fn is_goal(&self, s: &usize) -> bool {
        self.goals[*s]
    }

    fn successors(&self, s: &usize) -> Result<Vec<Successor<usize, usize>>, Infallible> {
        *self.asked.borrow_mut().entry(*s).or_default() += 1;
        let way = |(i, &(to, cost)): (usize, &(usize, f64))| {
            if self.promised > 0 && i % self.promised == 0 {
                return Successor::Promised {
                    action: i,
                    cost_at_least: cost / 2.0,
                    remaining_at_least: self.h[to] / 3.0,
                };
            }
            Successor::Made(Made { action: i, cost, state: to })
        };
        Ok(self.edges[*s].iter().enumerate().map(way).collect())
    }

    fn make(&self, s: &usize, action: &usize) -> Result<Option<(f64, usize)>, Infallible> {
        self.made.set(self.made.get() + 1);
        // Every fourth promise is empty.
        let (to, cost) = self.edges[*s][*action];
        Ok((to % 4 != 3).then_some((cost, to)))
    }
}

impl Graph {
    fn open(&self, s: usize) -> impl Iterator<Item = (usize, usize, f64)> + '_ {
        self.edges[s].iter().enumerate().filter_map(move |(i, &(to, cost))| {
            let empty = self.promised > 0 && i % self.promised == 0 && to % 4 == 3;
            (!empty).then_some((i, to, cost))
        })
    }

    /// The least g + h of any goal within `depth` steps, by trying every path.
    fn cheapest(&self, s: usize, paid: f64, depth: usize) -> Option<f64> {
        if self.goals[s] {
            return Some(paid + self.h[s]);
        }
        if depth == 0 {
            return None;
        }
        let ways = self.open(s).filter_map(|(_, to, c)| self.cheapest(to, paid + c, depth - 1));
        ways.reduce(f64::min)
    }

    fn end_of(&self, path: &[usize]) -> (usize, f64) {
        path.iter().fold((0, 0.0), |(s, paid), a| {
            let (to, cost) = self.edges[s][*a];
            (to, paid + cost)
        })
    }
}

fn graph() -> impl Strategy<Value = Graph> {
    let n = 9usize;
    (
        proptest::collection::vec(proptest::collection::vec((0..n, 0u8..40), 0..4), n),
        proptest::collection::vec(0u8..5, n),
        0.0f64..=1.0,
        0usize..3,
    )
        .prop_map(move |(edges, goals, share, promised)| {
            let edges: Vec<Vec<(usize, f64)>> = edges
                .into_iter()
                .map(|e| e.into_iter().map(|(to, c)| (to, f64::from(c) * 0.1)).collect())
                .collect();
            let goals: Vec<bool> =
                goals.iter().enumerate().map(|(i, g)| i > 0 && *g == 0).collect();
            // True costs to go, by relaxing until nothing changes.
            let mut to_go: Vec<f64> =
                goals.iter().map(|g| if *g { 0.0 } else { f64::INFINITY }).collect();
            for _ in 0..n {
                for s in 0..n {
                    let least = edges[s].iter().map(|(to, c)| c + to_go[*to]);
                    to_go[s] = least.fold(to_go[s], f64::min);
                }
            }
            let h = to_go.iter().map(|c| if c.is_finite() { c * share } else { 1.0 }).collect();
            let asked = RefCell::default();
            Graph { edges, goals, h, promised, asked, made: Cell::new(0) }
        })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]
    #[test]
    fn without_weight_the_cost_is_that_of_trying_every_path(g in graph(), depth in 1usize..6) {
        let options = IdaOptions { most_steps: depth, ..IdaOptions::default() };
        let found = ida(&g, 0, &options, &mut |_| true).unwrap();
        prop_assert!(found.path.len() <= depth);
        let (end, paid) = g.end_of(&found.path);
        prop_assert!((paid - found.paid).abs() < 1e-9);
        match g.cheapest(0, 0.0, depth) {
            Some(cost) => {
                prop_assert_eq!(found.ending, Ending::Goal);
                prop_assert!(g.goals[end]);
                prop_assert!((found.cost - cost).abs() < 1e-9, "{} for {}", found.cost, cost);
            }
            None => prop_assert_eq!(found.ending, Ending::Exhausted),
        }
        // However many rounds there were.
        prop_assert!(g.asked.borrow().values().all(|n| *n == 1));
        let promises: usize = g.edges.iter().map(Vec::len).sum();
        prop_assert!(g.made.get() <= promises);
    }

    #[test]
    fn with_weight_a_goal_is_found_when_there_is_one(g in graph(), w in 0.0f64..5.0) {
        let options = IdaOptions { weight: w, most_steps: 9, ..IdaOptions::default() };
        let found = ida(&g, 0, &options, &mut |_| true).unwrap();
        let reachable = g.cheapest(0, 0.0, 9);
        prop_assert_eq!(found.ending == Ending::Goal, reachable.is_some());
        if let Some(cost) = reachable {
            prop_assert!(found.cost <= (1.0 + w) * cost + 1e-9);
        }
    }

    #[test]
    fn leaving_branches_early_loses_no_goal(g in graph(), patience in 0usize..4) {
        let options =
            IdaOptions { weight: 1.0, most_steps: 9, branch_patience: Some(patience), ..Default::default() };
        let found = ida(&g, 0, &options, &mut |_| true).unwrap();
        prop_assert_eq!(found.ending == Ending::Goal, g.cheapest(0, 0.0, 9).is_some());
    }

    #[test]
    fn a_stopped_search_gives_the_path_that_ends_nearest(g in graph(), stop in 0usize..6) {
        let options = IdaOptions { most_expanded: stop, ..IdaOptions::default() };
        let found = ida(&g, 0, &options, &mut |_| true).unwrap();
        prop_assert!(found.expanded <= stop);
        let (end, paid) = g.end_of(&found.path);
        prop_assert!((paid - found.paid).abs() < 1e-9);
        if found.ending != Ending::Goal {
            let nearest = found.tree.iter().map(|s| s.shortfall).fold(f64::INFINITY, f64::min);
            prop_assert_eq!(g.h[end], nearest);
        }
    }
}

/// The eight puzzle on 3 × 2 tiles: states are many, paths more.
struct Tiles;

impl World for Tiles {
    type State = [u8; 6];
    type Action = usize;
    type Error = Infallible;

    fn key(&self, s: &[u8; 6]) -> u128 {
        s.iter().fold(0, |k, t| k * 6 + u128::from(*t))
    }

    fn remaining(&self, s: &[u8; 6]) -> f64 {
        let far = |i: usize, t: usize| (i % 3).abs_diff(t % 3) + (i / 3).abs_diff(t / 3);
        let tiles = s.iter().enumerate().filter(|(_, t)| **t != 0);
        tiles.map(|(i, t)| far(i, usize::from(*t)) as f64).sum()
    }

    fn is_goal(&self, s: &[u8; 6]) -> bool {
        *s == [0, 1, 2, 3, 4, 5]
    }

    fn successors(&self, s: &[u8; 6]) -> Result<Vec<Successor<[u8; 6], usize>>, Infallible> {
        let Some(hole) = s.iter().position(|t| *t == 0) else { return Ok(Vec::new()) };
        let near = |i: &usize| (i % 3).abs_diff(hole % 3) + (i / 3).abs_diff(hole / 3) == 1;
        let made = |i: usize| {
            let mut state = *s;
            state.swap(i, hole);
            Successor::Made(Made { action: i, cost: 1.0, state })
        };
        Ok((0..6).filter(near).map(made).collect())
    }
}

#[test]
fn the_hardest_small_sliding_puzzle_takes_21_moves() {
    let options = IdaOptions { most_steps: 40, ..IdaOptions::default() };
    let hardest = ida(&Tiles, [3, 4, 5, 0, 1, 2], &options, &mut |_| true).unwrap();
    let breadth = {
        let (mut seen, mut front, mut moves) =
            (std::collections::BTreeSet::from([[3, 4, 5, 0, 1, 2]]), vec![[3, 4, 5, 0, 1, 2]], 0);
        while !front.iter().any(|s| Tiles.is_goal(s)) {
            moves += 1;
            front = front
                .iter()
                .flat_map(|s| Tiles.successors(s).unwrap())
                .filter_map(|s| match s {
                    Successor::Made(m) => Some(m.state),
                    Successor::Promised { .. } => None,
                })
                .filter(|s| seen.insert(*s))
                .collect();
        }
        moves
    };
    assert_eq!((hardest.ending, hardest.path.len()), (Ending::Goal, breadth));
    assert!(hardest.rounds > 1 && hardest.expanded <= 360);
}

#[test]
fn the_caller_may_stop_and_hears_how_far_it_is() {
    let mut heard = Vec::new();
    let found = ida(&Tiles, [3, 4, 5, 0, 1, 2], &IdaOptions::default(), &mut |s| {
        heard.push(*s);
        s.expanded < 5
    });
    let found = found.unwrap();
    assert_eq!((found.ending, found.expanded), (Ending::Stopped, 5));
    assert!(heard.windows(2).all(|p| p[0].limit <= p[1].limit && p[0].states <= p[1].states));
}
