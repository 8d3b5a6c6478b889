//! Weighted set cover, solved exactly.
//!
//! Method: a set that another, no heavier one contains is dropped. Of the rest the least choice
//! that covers a few elements is an integer program, solved by branch and bound; elements it misses
//! join the few until none is missed. Such a choice is the least for all of them: the program with
//! fewer elements asks for less. Mostly a few dozen of thousands decide.

use good_lp::{Expression, ProblemVariables, Solution, SolverModel, Variable, microlp, variable};

/// A set over the elements 0..n with its weight.
#[derive(Clone, Debug, PartialEq)]
pub struct WeightedSet {
    /// Finite and not negative.
    pub weight: f64,
    /// Sorted element indices.
    pub covers: Vec<usize>,
}

#[derive(Debug, thiserror::Error, PartialEq)]
pub enum CoverError {
    #[error("element {0} is in no set")]
    Uncoverable(usize),
    #[error("the integer program did not solve: {0}")]
    Solver(String),
}

/// Indices of a least-weight choice of sets that covers 0..elements, ascending.
pub fn set_cover(elements: usize, sets: &[WeightedSet]) -> Result<Vec<usize>, CoverError> {
    let all: Vec<Column> =
        sets.iter().map(|s| Column { weight: s.weight, covers: &s.covers }).collect();
    let columns = undominated(elements, &all, |_| 0);
    let mut coverers: Vec<Vec<usize>> = vec![Vec::new(); elements];
    for (i, &c) in columns.iter().enumerate() {
        sets[c].covers.iter().for_each(|e| coverers[*e].push(i));
    }
    if let Some(e) = coverers.iter().position(Vec::is_empty) {
        return Err(CoverError::Uncoverable(e));
    }
    // The rarest first: they leave the least choice.
    let mut order: Vec<usize> = (0..elements).collect();
    order.sort_by_key(|&e| (coverers[e].len(), e));
    let weights: Vec<f64> = columns.iter().map(|c| sets[*c].weight).collect();
    let mut rows: Vec<&[usize]> = Vec::new();
    let mut is_chosen = vec![false; columns.len()];
    loop {
        // Of the missed, as many as no set has two of: each of them asks for one more.
        let mut is_met = is_chosen.clone();
        let known = rows.len();
        for &e in &order {
            if !coverers[e].iter().any(|i| is_met[*i]) {
                coverers[e].iter().for_each(|i| is_met[*i] = true);
                rows.push(&coverers[e]);
            }
        }
        if rows.len() == known {
            let chosen = columns.iter().zip(&is_chosen).filter(|(_, is)| **is);
            return Ok(chosen.map(|(c, _)| *c).collect());
        }
        is_chosen = vec![false; columns.len()];
        for i in least(&weights, &rows, |i| sets[columns[i]].covers.len())? {
            is_chosen[i] = true;
        }
    }
}

/// The least choice of columns that has one of every row. Of what few rows leave alike, the column that covers the
/// most elements in all is looked at: others then miss fewer.
fn least(
    weights: &[f64],
    rows: &[&[usize]],
    size: impl Fn(usize) -> usize,
) -> Result<Vec<usize>, CoverError> {
    // A tiny surcharge per set prefers fewer sets among equal weights; it is far below any
    // difference of real weights (fractions of a volume with at most 10⁷ voxels).
    const SET_SURCHARGE: f64 = 1e-9;
    let mut of_column: Vec<Vec<usize>> = vec![Vec::new(); weights.len()];
    for (r, row) in rows.iter().enumerate() {
        row.iter().for_each(|i| of_column[*i].push(r));
    }
    let covers = weights.iter().zip(&of_column);
    let all: Vec<Column> =
        covers.map(|(weight, covers)| Column { weight: *weight, covers }).collect();
    let columns = undominated(rows.len(), &all, size);
    let mut variables = ProblemVariables::new();
    let chosen: Vec<Variable> =
        columns.iter().map(|_| variables.add(variable().binary())).collect();
    let weight = |c: &usize| weights[*c] + SET_SURCHARGE;
    let objective: Expression = columns.iter().zip(&chosen).map(|(c, v)| weight(c) * *v).sum();
    let mut model = variables.minimise(objective).using(microlp);
    let mut coverers = vec![Expression::default(); rows.len()];
    for (c, v) in columns.iter().zip(&chosen) {
        of_column[*c].iter().for_each(|r| coverers[*r] += *v);
    }
    for row in coverers {
        model = model.with(row.geq(1.0));
    }
    let solution = model.solve().map_err(|e| CoverError::Solver(e.to_string()))?;
    let taken = columns.iter().zip(&chosen).filter(|(_, v)| solution.value(**v) > 0.5);
    Ok(taken.map(|(c, _)| *c).collect())
}

/// A set as far as some elements go.
struct Column<'a> {
    weight: f64,
    covers: &'a [usize],
}

type Bits = Vec<u64>;

fn bits(len: usize, ones: impl Iterator<Item = usize>) -> Bits {
    let mut b = vec![0u64; len.div_ceil(64)];
    ones.for_each(|i| b[i / 64] |= 1 << (i % 64));
    b
}

fn is_subset(a: &Bits, b: &Bits) -> bool {
    a.iter().zip(b).all(|(a, b)| a & !b == 0)
}

/// Columns that no other, no heavier column contains; of equals the one of the largest `size`, and the first of these,
/// stays.
fn undominated(elements: usize, columns: &[Column], size: impl Fn(usize) -> usize) -> Vec<usize> {
    let is_any = |i: &usize| !columns[*i].covers.is_empty();
    let mut order: Vec<usize> = (0..columns.len()).filter(is_any).collect();
    order.sort_by(|&a, &b| {
        let ([one, other], largest) = ([&columns[a], &columns[b]], size(b).cmp(&size(a)));
        let weight = one.weight.total_cmp(&other.weight);
        weight.then(other.covers.len().cmp(&one.covers.len())).then(largest).then(a.cmp(&b))
    });
    let mut kept: Vec<(usize, Bits)> = Vec::new();
    for i in order {
        let b = bits(elements, columns[i].covers.iter().copied());
        if !kept.iter().any(|(_, k)| is_subset(&b, k)) {
            kept.push((i, b));
        }
    }
    let mut columns: Vec<usize> = kept.into_iter().map(|(i, _)| i).collect();
    columns.sort_unstable();
    columns
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::rng;
    use rand::RngExt;

    fn cost(sets: &[WeightedSet], choice: &[usize]) -> f64 {
        choice.iter().map(|i| sets[*i].weight).sum()
    }

    fn brute_force(elements: usize, sets: &[WeightedSet]) -> f64 {
        (0u32..1 << sets.len())
            .filter(|mask| {
                (0..elements).all(|e| {
                    (0..sets.len()).any(|i| mask >> i & 1 == 1 && sets[i].covers.contains(&e))
                })
            })
            .map(|mask| {
                (0..sets.len()).filter(|i| mask >> i & 1 == 1).map(|i| sets[i].weight).sum()
            })
            .fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn equals_brute_force_on_random_instances() {
        let mut rng = rng(11, 0);
        let mut solved = 0;
        for _ in 0..200 {
            let elements = rng.random_range(1..9);
            let count = rng.random_range(1..17);
            let sets: Vec<WeightedSet> = (0..count)
                .map(|_| WeightedSet {
                    weight: f64::from(rng.random_range(0..50u32)) / 50.0,
                    covers: (0..elements).filter(|_| rng.random_bool(0.35)).collect(),
                })
                .collect();
            let best = brute_force(elements, &sets);
            match set_cover(elements, &sets) {
                Ok(choice) => {
                    solved += 1;
                    assert!((cost(&sets, &choice) - best).abs() < 1e-6, "{sets:?}");
                    for e in 0..elements {
                        assert!(choice.iter().any(|i| sets[*i].covers.contains(&e)));
                    }
                }
                Err(CoverError::Uncoverable(e)) => {
                    assert!(sets.iter().all(|s| !s.covers.contains(&e)));
                }
                Err(e) => panic!("{e}"),
            }
        }
        assert!(solved > 50, "only {solved} instances had a cover");
    }

    /// Thousands of elements that few decide: no worse than the greedy choice, and complete.
    #[test]
    fn a_large_instance_is_covered() {
        let mut rng = rng(5, 0);
        let elements = 5000;
        let mut sets: Vec<WeightedSet> = (0..300)
            .map(|_| {
                let (first, len) = (rng.random_range(0..elements), rng.random_range(1..600));
                WeightedSet { weight: 1.0, covers: (first..(first + len).min(elements)).collect() }
            })
            .collect();
        sets.extend(
            (0..10)
                .map(|i| WeightedSet { weight: 1.5, covers: (i * 500..(i + 1) * 500).collect() }),
        );
        let choice = set_cover(elements, &sets).unwrap();
        let mut left: Vec<bool> = vec![true; elements];
        let mut greedy = 0.0;
        while left.iter().any(|l| *l) {
            let gain =
                |s: &WeightedSet| s.covers.iter().filter(|e| left[**e]).count() as f64 / s.weight;
            let best = sets.iter().max_by(|a, b| gain(a).total_cmp(&gain(b))).unwrap();
            best.covers.iter().for_each(|e| left[*e] = false);
            greedy += best.weight;
        }
        assert!(cost(&sets, &choice) <= greedy + 1e-9);
        for e in 0..elements {
            assert!(choice.iter().any(|i| sets[*i].covers.binary_search(&e).is_ok()));
        }
    }

    #[test]
    fn nothing_to_cover_needs_nothing() {
        assert_eq!(set_cover(0, &[]), Ok(vec![]));
        assert_eq!(set_cover(1, &[]), Err(CoverError::Uncoverable(0)));
    }
}
