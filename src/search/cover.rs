//! Weighted set cover, solved exactly.
//!
//! Method: rows and columns are reduced by dominance first (a set that another, no heavier one
//! contains is dropped; an element whose every set also covers another makes that other one
//! redundant), then the rest is an integer program handed to branch and bound.

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
    for e in 0..elements {
        if !sets.iter().any(|s| s.covers.binary_search(&e).is_ok()) {
            return Err(CoverError::Uncoverable(e));
        }
    }
    if elements == 0 {
        return Ok(Vec::new());
    }
    let columns = undominated(elements, sets);
    let rows = decisive_elements(elements, sets, &columns);
    let mut variables = ProblemVariables::new();
    let chosen: Vec<Variable> =
        columns.iter().map(|_| variables.add(variable().binary())).collect();
    // A tiny surcharge per set prefers fewer sets among equal weights; it is far below any
    // difference of real weights (fractions of a volume with at most 10⁷ voxels).
    const SET_SURCHARGE: f64 = 1e-9;
    let objective: Expression =
        columns.iter().zip(&chosen).map(|(&c, v)| (sets[c].weight + SET_SURCHARGE) * *v).sum();
    let mut model = variables.minimise(objective).using(microlp);
    for &e in &rows {
        let coverers: Expression = columns
            .iter()
            .zip(&chosen)
            .filter(|(c, _)| sets[**c].covers.binary_search(&e).is_ok())
            .map(|(_, v)| Expression::from(*v))
            .sum();
        model = model.with(coverers.geq(1.0));
    }
    let solution = model.solve().map_err(|e| CoverError::Solver(e.to_string()))?;
    Ok(columns
        .iter()
        .zip(&chosen)
        .filter(|(_, v)| solution.value(**v) > 0.5)
        .map(|(c, _)| *c)
        .collect())
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

/// Columns that no other, no heavier column contains; of equals the first stays.
fn undominated(elements: usize, sets: &[WeightedSet]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..sets.len()).filter(|i| !sets[*i].covers.is_empty()).collect();
    order.sort_by(|&a, &b| {
        let weight = sets[a].weight.total_cmp(&sets[b].weight);
        weight.then(sets[b].covers.len().cmp(&sets[a].covers.len())).then(a.cmp(&b))
    });
    let mut kept: Vec<(usize, Bits)> = Vec::new();
    for i in order {
        let b = bits(elements, sets[i].covers.iter().copied());
        if !kept.iter().any(|(_, k)| is_subset(&b, k)) {
            kept.push((i, b));
        }
    }
    let mut columns: Vec<usize> = kept.into_iter().map(|(i, _)| i).collect();
    columns.sort_unstable();
    columns
}

/// Elements that remain once every element implied by another is dropped.
fn decisive_elements(elements: usize, sets: &[WeightedSet], columns: &[usize]) -> Vec<usize> {
    let coverers: Vec<Bits> = (0..elements)
        .map(|e| {
            let covering = columns
                .iter()
                .enumerate()
                .filter(|(_, c)| sets[**c].covers.binary_search(&e).is_ok());
            bits(columns.len(), covering.map(|(i, _)| i))
        })
        .collect();
    (0..elements)
        .filter(|&e| {
            !(0..elements).any(|o| {
                o != e
                    && is_subset(&coverers[o], &coverers[e])
                    && (coverers[o] != coverers[e] || o < e)
            })
        })
        .collect()
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

    #[test]
    fn nothing_to_cover_needs_nothing() {
        assert_eq!(set_cover(0, &[]), Ok(vec![]));
        assert_eq!(set_cover(1, &[]), Err(CoverError::Uncoverable(0)));
    }
}
