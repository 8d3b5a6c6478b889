//! Bridges: what a cut leaves standing so that nothing comes loose.
//!
//! An over-cut may free a piece that it cannot reach itself. The piece would fall, and with it the
//! plan (rule `stability`). The shortest way through the cut material from what is held to the
//! piece is left standing instead, one voxel thicker all round; a later cut takes both.
//!
//! Not guaranteed: that a bridge bears a load, or that a later cut reaches it; what stands at the
//! end is residual like any other.

use crate::voxel::{BitGrid, Connectivity, components};
use std::collections::VecDeque;

/// Face neighbours: axis and step.
const FACES: [(usize, isize); 6] = [(0, 1), (0, -1), (1, 1), (1, -1), (2, 1), (2, -1)];

/// Marks of the search: not seen, held, or 2 + the face by which a voxel was entered.
const UNSEEN: u8 = 0;
const HELD: u8 = 1;

/// The voxels of `cut` to leave so that every piece of `loose` hangs on `held`; none where no way
/// through `cut` leads to it.
pub fn bridges(held: &BitGrid, loose: &BitGrid, cut: &BitGrid) -> BitGrid {
    let dims = held.dims();
    let at = |v: [usize; 3]| v[0] + dims[0] * (v[1] + dims[1] * v[2]);
    let mut marks = vec![UNSEEN; dims.iter().product()];
    let mut front: VecDeque<[usize; 3]> = VecDeque::new();
    for v in held.iter_ones() {
        marks[at(v)] = HELD;
        front.push_back(v);
    }
    let mut ways = BitGrid::new(dims);
    // The first way to a piece does for all of it.
    let pieces = components(loose, Connectivity::Edge18);
    let mut hangs = vec![false; pieces.count()];
    while let Some(v) = front.pop_front() {
        for (face, (axis, step)) in FACES.iter().enumerate() {
            let Some(next) = stepped(v, *axis, *step, dims) else { continue };
            if marks[at(next)] != UNSEEN || !(loose.get(next) || cut.get(next)) {
                continue;
            }
            marks[at(next)] = 2 + face as u8;
            front.push_back(next);
            if let Some(piece) = pieces.label_of(next)
                && !std::mem::replace(&mut hangs[piece as usize], true)
            {
                trace(&marks, next, dims, &mut ways);
            }
        }
    }
    ways.grown().and(cut)
}

/// Marks the way back from a voxel to what is held.
fn trace(marks: &[u8], from: [usize; 3], dims: [usize; 3], ways: &mut BitGrid) {
    let mut v = from;
    loop {
        let mark = marks[v[0] + dims[0] * (v[1] + dims[1] * v[2])];
        if mark <= HELD || ways.get(v) {
            return;
        }
        ways.set(v, true);
        let (axis, step) = FACES[usize::from(mark - 2)];
        match stepped(v, axis, -step, dims) {
            Some(back) => v = back,
            None => return,
        }
    }
}

fn stepped(v: [usize; 3], axis: usize, step: isize, dims: [usize; 3]) -> Option<[usize; 3]> {
    let mut to = v;
    to[axis] = v[axis].checked_add_signed(step).filter(|c| *c < dims[axis])?;
    Some(to)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::voxel::flood;

    #[test]
    fn every_loose_piece_hangs_on_what_is_held_by_the_shortest_way() {
        let dims = [30, 9, 12];
        let all = BitGrid::from_fn(dims, |_| true);
        let held = BitGrid::from_fn(dims, |[_, _, z]| z < 2);
        let loose = BitGrid::from_fn(dims, |[x, _, z]| !(4..=25).contains(&x) && z == 8);
        let cut = all.minus(&held).minus(&loose);
        let left = bridges(&held, &loose, &cut);
        assert!(left.is_subset_of(&cut));
        let standing = held.or(&loose).or(&left);
        assert_eq!(flood(&standing, &held, Connectivity::Edge18), standing);
        // Straight down from either piece, three voxels wide, and not from every voxel of it.
        assert!(left.count() <= cut.count() / 3, "{} of {}", left.count(), cut.count());
    }

    #[test]
    fn a_piece_without_a_way_gets_no_bridge() {
        let dims = [8, 4, 8];
        let held = BitGrid::from_fn(dims, |[_, _, z]| z < 2);
        let loose = BitGrid::from_fn(dims, |[_, _, z]| z == 6);
        assert!(bridges(&held, &loose, &BitGrid::new(dims)).is_empty());
    }
}
