//! Which voxels others hang on: those without which something is not connected to the ground.
//!
//! These are the articulation points of the graph of solid voxels and their neighbours, with the
//! ground as one vertex that all grounded voxels are tied to (Tarjan: Depth-first search and linear
//! graph algorithms, 1972). Exact, in one search with a stack of its own.

use super::workpiece::{Cell, Workpiece};

/// One voxel on the way from the ground to the one that is looked at.
struct Visit {
    cell: Cell,
    /// Next of its neighbours to look at.
    next: usize,
}

/// For each cell, whether something that is solid would be loose without it. Ground are the base
/// layer and what `grounded` holds for; what is loose already is left out.
pub(super) fn hinges(w: &Workpiece, grounded: impl Fn(Cell) -> bool) -> Vec<bool> {
    let mut hinge = vec![false; w.len()];
    // In which order cells are come to, from 1; the ground is 0, as is what was not seen.
    let mut order = vec![0u32; w.len()];
    // The earliest cell that a cell or what was come to through it is beside.
    let mut low = vec![0u32; w.len()];
    let mut count = 0;
    let offsets = w.offsets();
    let stands = |c: Cell| w.height(c) == 0 || grounded(c);
    for root in (0..w.dims()[2]).flat_map(|z| w.layer(z)) {
        if order[root as usize] != 0 || !stands(root) {
            continue;
        }
        count += 1;
        (order[root as usize], low[root as usize]) = (count, 0);
        let mut way = vec![Visit { cell: root, next: 0 }];
        while let Some(visit) = way.last_mut() {
            let cell = visit.cell;
            if let Some(offset) = offsets.get(visit.next) {
                visit.next += 1;
                let n = (cell as i32 + offset) as Cell;
                if !w.solid(n) {
                    continue;
                }
                if order[n as usize] == 0 {
                    count += 1;
                    order[n as usize] = count;
                    low[n as usize] = if stands(n) { 0 } else { count };
                    way.push(Visit { cell: n, next: 0 });
                } else {
                    low[cell as usize] = low[cell as usize].min(order[n as usize]);
                }
                continue;
            }
            way.pop();
            if let Some(before) = way.last() {
                let before = before.cell as usize;
                hinge[before] |= low[cell as usize] >= order[before];
                low[before] = low[before].min(low[cell as usize]);
            }
        }
    }
    hinge
}

#[cfg(test)]
mod tests {
    use super::super::naive_tests::{random_stable, stable};
    use super::*;

    #[test]
    fn a_hinge_is_what_leaves_something_loose() {
        let (mut hinged, mut free) = (0, 0);
        for stream in 0..300u64 {
            let dims = [3 + stream as usize % 4, 4, 3 + stream as usize % 3];
            let solid = random_stable(dims, 25 + 5 * (stream % 9), stream);
            let w = Workpiece::new(&solid, 2);
            let hinge = hinges(&w, |_| false);
            for v in solid.iter_ones() {
                let mut without = solid.clone();
                without.set(v, false);
                let is = hinge[w.cell(v.map(|c| c as i32)) as usize];
                assert_eq!(is, !stable(&without), "{v:?} of stream {stream}");
                if is { hinged += 1 } else { free += 1 }
            }
        }
        assert!(hinged > 100 && free > 500, "{hinged} {free}");
    }
}
