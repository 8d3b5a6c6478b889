//! Monte Carlo tree search over sequences of a fixed number of choices.
//!
//! Method: UCT (Kocsis and Szepesvári 2006) with progressive widening. A node is a prefix of
//! choices; a selected node that may widen gets a child drawn from those not tried yet, nearer the
//! front of the list more often; the rest of the sequence is drawn the same way; the reward of the
//! complete sequence goes back to every node on its path. Rewards are those of W2V Eq. 5: 0 for an
//! invalid sequence, else where its value lies between the value known at the start and the best
//! conceivable one, times the cube of its ratio to the best found when it is better than that.
//! The bound is Q/N + c·√(ln T / N), Q/N where it lies in the range of the rewards seen so far; the
//! paper prints the root over the 2 only, under which a node visited often is never left.
//!
//! A node whose every continuation has been judged is closed and not entered again, so a tree with
//! fewer leaves than iterations is searched completely. Several trees with seeds of their own grow
//! side by side; of equal finds that of the first tree stands.
//!
//! Guarantees: the same answer for the same seed at any thread count; the optimum once a single
//! tree has been searched completely. Not guaranteed: the optimum otherwise.

use crate::base::{Cancelled, Ctx, Rng, rng};
use rand::RngExt;
use rayon::prelude::*;

/// What is decided, layer by layer.
pub trait Sequence: Sync {
    /// Number of choices in a complete sequence.
    fn layers(&self) -> usize;
    /// Number of options of a layer, the most promising first.
    fn options(&self, layer: usize) -> usize;
    /// The value of a complete sequence; none where it breaks a rule.
    fn value(&self, choices: &[usize]) -> Option<f64>;
    /// A value known to be reachable, and one that none exceeds.
    fn bounds(&self) -> (f64, f64);
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Strategy {
    /// Upper confidence bounds decide where to look.
    Tree,
    /// Every sequence is drawn anew (the comparison of W2V Fig. 16).
    Random,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Budget {
    /// Sequences judged by all trees together.
    pub iterations: usize,
    pub strategy: Strategy,
    pub seed: u64,
}

/// The best sequence found.
#[derive(Clone, Debug, PartialEq)]
pub struct Found {
    pub choices: Vec<usize>,
    pub value: f64,
}

/// What a search ended with.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// None where no sequence that was judged is valid.
    pub best: Option<Found>,
    /// Sequences judged.
    pub judged: usize,
}

/// Trees that grow side by side: their number is fixed, since the answer depends on it.
const TREES: usize = 4;

/// A tree gets at least this many iterations; fewer make it a random draw.
const LEAST_PER_TREE: usize = 50;

/// A node visited N times has at most ⌈WIDENING · √N⌉ children. Smaller digs deeper before it looks
/// aside, larger the other way.
const WIDENING: f64 = 2.0;

/// Weight of the second term of the bound: √2 over rewards between 0 and 1 as the paper has it, on
/// the fifth of that range in which the means of good and bad prefixes of a few layers lie.
const EXPLORATION: f64 = std::f64::consts::SQRT_2 / 5.0;

/// Draws lean to the front of a list by this power of a uniform number; 1 leans nowhere.
const LEAN: i32 = 2;

/// Searches for the sequence of largest value.
pub fn search(problem: &impl Sequence, budget: &Budget, ctx: &Ctx) -> Result<Outcome, Cancelled> {
    let layers = problem.layers();
    if (0..layers).any(|l| problem.options(l) == 0) {
        return Ok(Outcome { best: None, judged: 0 });
    }
    let trees = (budget.iterations / LEAST_PER_TREE).clamp(1, TREES);
    let grown: Vec<Outcome> = (0..trees)
        .into_par_iter()
        .map(|t| {
            let share = budget.iterations / trees + usize::from(t < budget.iterations % trees);
            Tree::new(problem, rng(budget.seed, t as u64)).grow(share, budget.strategy, ctx)
        })
        .collect::<Result<_, Cancelled>>()?;
    let judged = grown.iter().map(|o| o.judged).sum();
    let best = grown
        .into_iter()
        .filter_map(|o| o.best)
        .reduce(|a, b| if b.value > a.value { b } else { a });
    Ok(Outcome { best, judged })
}

struct Node {
    /// (option, node), in the order of their expansion.
    children: Vec<(usize, usize)>,
    visits: f64,
    reward: f64,
    /// Every continuation has been judged.
    closed: bool,
}

struct Tree<'p, P> {
    problem: &'p P,
    rng: Rng,
    nodes: Vec<Node>,
    best: Option<Found>,
    judged: usize,
    /// Least and largest reward of a valid sequence so far.
    range: (f64, f64),
}

impl<'p, P: Sequence> Tree<'p, P> {
    fn new(problem: &'p P, rng: Rng) -> Self {
        let range = (f64::INFINITY, f64::NEG_INFINITY);
        let mut tree = Tree { problem, rng, nodes: Vec::new(), best: None, judged: 0, range };
        tree.add();
        tree
    }

    fn add(&mut self) -> usize {
        self.nodes.push(Node { children: Vec::new(), visits: 0.0, reward: 0.0, closed: false });
        self.nodes.len() - 1
    }

    fn grow(
        mut self,
        iterations: usize,
        strategy: Strategy,
        ctx: &Ctx,
    ) -> Result<Outcome, Cancelled> {
        for _ in 0..iterations {
            ctx.check()?;
            if self.nodes[0].closed || ctx.out_of_time() {
                break;
            }
            match strategy {
                Strategy::Tree => self.iterate(),
                Strategy::Random => {
                    let choices = self.completed(Vec::new());
                    self.judge(choices);
                }
            }
        }
        Ok(Outcome { best: self.best, judged: self.judged })
    }

    /// Selection, expansion, simulation, back-propagation.
    fn iterate(&mut self) {
        let layers = self.problem.layers();
        let (mut path, mut prefix) = (vec![0], Vec::new());
        let mut node = 0;
        while prefix.len() < layers {
            let (option, child, is_new) = self.descend(node, prefix.len());
            prefix.push(option);
            path.push(child);
            node = child;
            if is_new {
                break;
            }
        }
        let is_leaf = prefix.len() == layers;
        let choices = self.completed(prefix);
        let reward = self.judge(choices);
        if is_leaf {
            self.nodes[node].closed = true;
        }
        for (depth, &n) in path.iter().enumerate().rev() {
            self.nodes[n].visits += 1.0;
            self.nodes[n].reward += reward;
            let all = depth < layers && self.nodes[n].children.len() == self.problem.options(depth);
            if all && self.nodes[n].children.iter().all(|(_, c)| self.nodes[*c].closed) {
                self.nodes[n].closed = true;
            }
        }
    }

    /// The child to go on with: a new one while the node may widen, else that of the largest bound.
    fn descend(&mut self, node: usize, layer: usize) -> (usize, usize, bool) {
        let options = self.problem.options(layer);
        let Node { children, visits, .. } = &self.nodes[node];
        let wide = (WIDENING * visits.sqrt()).ceil().max(1.0) as usize;
        let open = children.iter().any(|(_, c)| !self.nodes[*c].closed);
        if children.len() < options && (children.len() < wide || !open) {
            let option = self.untried(node, options);
            let child = self.add();
            self.nodes[node].children.push((option, child));
            return (option, child, true);
        }
        let total = visits.max(1.0).ln();
        let (least, most) = if self.range.0 <= self.range.1 { self.range } else { (0.0, 1.0) };
        let bound = |&(_, c): &(usize, usize)| {
            let Node { visits, reward, .. } = self.nodes[c];
            // Where all rewards so far are alike, their differences are what there is to go by.
            let mean = (reward / visits - least) / (most - least).max(1e-9);
            mean + EXPLORATION * (total / visits).sqrt()
        };
        // Of equal bounds the child expanded first: `max_by` would take the last.
        let (option, child) = *children
            .iter()
            .filter(|(_, c)| !self.nodes[*c].closed)
            .reduce(|a, b| if bound(b) > bound(a) { b } else { a })
            .expect("a node that is not closed has an open child or an untried option");
        (option, child, false)
    }

    /// An option of a node that has no child yet.
    fn untried(&mut self, node: usize, options: usize) -> usize {
        let tried: Vec<usize> = self.nodes[node].children.iter().map(|c| c.0).collect();
        let rank = self.draw(options - tried.len());
        (0..options).filter(|o| !tried.contains(o)).nth(rank).expect("rank < untried options")
    }

    fn draw(&mut self, options: usize) -> usize {
        let lean = self.rng.random::<f64>().powi(LEAN);
        ((lean * options as f64) as usize).min(options - 1)
    }

    fn completed(&mut self, mut prefix: Vec<usize>) -> Vec<usize> {
        while prefix.len() < self.problem.layers() {
            let option = self.draw(self.problem.options(prefix.len()));
            prefix.push(option);
        }
        prefix
    }

    /// Judges a sequence, keeps it if it is the best, and gives its reward (W2V Eq. 5).
    fn judge(&mut self, choices: Vec<usize>) -> f64 {
        self.judged += 1;
        let Some(value) = self.problem.value(&choices) else { return 0.0 };
        let (floor, ceiling) = self.problem.bounds();
        let share = ((value - floor) / (ceiling - floor).max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
        let known = self.best.as_ref().map(|b| b.value);
        if known.is_none_or(|k| value > k) {
            self.best = Some(Found { choices, value });
        }
        let reward = match known {
            Some(k) if k > 0.0 && value > k => share * (value / k).powi(3),
            _ => share,
        };
        self.range = (self.range.0.min(reward), self.range.1.max(reward));
        reward
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};

    /// Options with values of their own, less a penalty for neighbours that quarrel.
    struct Toy {
        values: Vec<Vec<f64>>,
        calls: AtomicUsize,
    }

    impl Toy {
        fn new(layers: usize, options: usize, seed: u64) -> Toy {
            let mut rng = rng(seed, 7);
            let row = |_| (0..options).map(|_| rng.random::<f64>()).collect();
            Toy { values: (0..layers).map(row).collect(), calls: AtomicUsize::new(0) }
        }

        fn judged(&self, choices: &[usize]) -> Option<f64> {
            let quarrel = choices.windows(2).any(|w| (w[0] + 2 * w[1]) % 5 == 0);
            let each = choices.iter().zip(&self.values).map(|(c, v)| v[*c]);
            (!quarrel).then(|| each.sum::<f64>())
        }

        fn optimum(&self) -> f64 {
            let counts: Vec<usize> = self.values.iter().map(Vec::len).collect();
            (0..counts.iter().product())
                .filter_map(|mut i: usize| {
                    let choices: Vec<usize> = counts
                        .iter()
                        .map(|c| {
                            let option = i % c;
                            i /= c;
                            option
                        })
                        .collect();
                    self.judged(&choices)
                })
                .fold(f64::NEG_INFINITY, f64::max)
        }
    }

    impl Sequence for Toy {
        fn layers(&self) -> usize {
            self.values.len()
        }

        fn options(&self, layer: usize) -> usize {
            self.values[layer].len()
        }

        fn value(&self, choices: &[usize]) -> Option<f64> {
            self.calls.fetch_add(1, Ordering::Relaxed);
            self.judged(choices)
        }

        fn bounds(&self) -> (f64, f64) {
            (0.0, self.values.len() as f64)
        }
    }

    fn budget(iterations: usize, strategy: Strategy, seed: u64) -> Budget {
        Budget { iterations, strategy, seed }
    }

    #[test]
    fn a_tree_with_fewer_leaves_than_iterations_is_searched_completely() {
        for seed in 0..20 {
            let toy = Toy::new(3, 3, seed);
            let found = search(&toy, &budget(49, Strategy::Tree, seed), &Ctx::quiet()).unwrap();
            assert_eq!(found.best.map(|b| b.value), Some(toy.optimum()), "seed {seed}");
            assert!(found.judged <= 49);
        }
    }

    #[test]
    fn the_optimum_of_trees_with_hundreds_of_leaves_is_found() {
        for seed in 0..10 {
            let toy = Toy::new(4, 5, seed); // 625 leaves, 1,000 iterations a tree
            let found = search(&toy, &budget(4000, Strategy::Tree, seed), &Ctx::quiet()).unwrap();
            assert_eq!(found.best.map(|b| b.value), Some(toy.optimum()), "seed {seed}");
        }
    }

    #[test]
    fn the_tree_finds_more_than_random_draws_of_the_same_number() {
        let mean = |strategy| {
            let found = (0..20).map(|seed| {
                let toy = Toy::new(7, 12, seed);
                let found = search(&toy, &budget(500, strategy, seed), &Ctx::quiet()).unwrap();
                found.best.map_or(0.0, |b| b.value)
            });
            found.sum::<f64>() / 20.0
        };
        let (tree, random) = (mean(Strategy::Tree), mean(Strategy::Random));
        assert!(tree > random, "{tree} against {random}");
    }

    #[test]
    fn a_problem_without_a_valid_sequence_has_no_answer() {
        struct Void;
        impl Sequence for Void {
            fn layers(&self) -> usize {
                2
            }
            fn options(&self, _: usize) -> usize {
                3
            }
            fn value(&self, _: &[usize]) -> Option<f64> {
                None
            }
            fn bounds(&self) -> (f64, f64) {
                (0.0, 1.0)
            }
        }
        let found = search(&Void, &budget(40, Strategy::Tree, 1), &Ctx::quiet()).unwrap();
        assert_eq!(found.best, None);
        // Nine leaves, and a draw for each of the three nodes above them.
        assert!((9..=12).contains(&found.judged), "{}", found.judged);
    }

    #[test]
    fn the_same_seed_gives_the_same_answer_at_any_thread_count() {
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let toy = Toy::new(6, 9, 3);
            pool.install(|| search(&toy, &budget(300, Strategy::Tree, 5), &Ctx::quiet()).unwrap())
        };
        assert_eq!(run(1), run(3));
    }
}
