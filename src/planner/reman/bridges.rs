//! Bridges: what a cut leaves standing so that nothing comes loose.
//!
//! An over-cut may free a piece that it cannot reach itself. The piece would fall, and with it the
//! plan (rule `stability`). The shortest way through the cut material from what is held to the
//! piece is left standing instead, one voxel thicker all round; a later cut takes both. A piece that
//! nothing leads to, since it stands on the base on its own, keeps a foot there.
//!
//! Not guaranteed: that a bridge bears a load, or that a later cut reaches it; what stands at the
//! end is residual like any other.

use crate::voxel::{BitGrid, Components, Connectivity, components};
use std::collections::VecDeque;

/// Neighbours by which a part hangs together (rule `stability`): the faces first, then the edges.
const NEIGHBOURS: [[isize; 3]; 18] = [
    [1, 0, 0],
    [-1, 0, 0],
    [0, 1, 0],
    [0, -1, 0],
    [0, 0, 1],
    [0, 0, -1],
    [1, 1, 0],
    [1, -1, 0],
    [-1, 1, 0],
    [-1, -1, 0],
    [1, 0, 1],
    [1, 0, -1],
    [-1, 0, 1],
    [-1, 0, -1],
    [0, 1, 1],
    [0, 1, -1],
    [0, -1, 1],
    [0, -1, -1],
];

/// How many of them are faces.
const FACES: usize = 6;

/// Marks of the search: not seen, held, or 2 + the neighbour by which a voxel was entered.
const UNSEEN: u8 = 0;
const HELD: u8 = 1;

/// The voxels of `cut` to leave so that every piece of `loose` hangs on `held`, over faces where that
/// can be; none where no way through `cut` leads to it.
pub fn bridges(held: &BitGrid, loose: &BitGrid, cut: &BitGrid) -> BitGrid {
    // The first way to a piece does for all of it.
    let pieces = components(loose, Connectivity::Edge18);
    let mut hangs = vec![false; pieces.count()];
    let mut ways = BitGrid::new(held.dims());
    for neighbours in [&NEIGHBOURS[..FACES], &NEIGHBOURS[..]] {
        if !hangs.iter().all(|h| *h) {
            hang(neighbours, (held, loose, cut), &pieces, &mut hangs, &mut ways);
        }
    }
    ways.grown().and(cut)
}

/// The same; where no way leads to a piece, to those voxels of `cut` as well that are held where they are, the
/// `feet`.
pub fn bridges_or_feet(
    held: &BitGrid,
    loose: &BitGrid,
    cut: &BitGrid,
    feet: impl FnOnce() -> BitGrid,
) -> BitGrid {
    let ways = bridges(held, loose, cut);
    match ways.is_empty() {
        true => bridges(&held.or(&feet()), loose, cut),
        false => ways,
    }
}

/// Marks the shortest ways over some neighbours to the pieces that do not hang yet.
fn hang(
    neighbours: &[[isize; 3]],
    (held, loose, cut): (&BitGrid, &BitGrid, &BitGrid),
    pieces: &Components,
    hangs: &mut [bool],
    ways: &mut BitGrid,
) {
    let dims = held.dims();
    let at = |v: [usize; 3]| v[0] + dims[0] * (v[1] + dims[1] * v[2]);
    let mut marks = vec![UNSEEN; dims.iter().product()];
    // Deep inside what is held no way begins.
    let mut front: VecDeque<[usize; 3]> = held.and(&loose.or(cut).grown()).iter_ones().collect();
    front.iter().for_each(|v| marks[at(*v)] = HELD);
    let mut left = hangs.iter().filter(|h| !**h).count();
    while let Some(v) = front.pop_front() {
        if left == 0 {
            break;
        }
        for (n, step) in neighbours.iter().enumerate() {
            let Some(next) = stepped(v, *step, dims) else { continue };
            if marks[at(next)] != UNSEEN || !(loose.get(next) || cut.get(next)) {
                continue;
            }
            marks[at(next)] = 2 + n as u8;
            front.push_back(next);
            if let Some(piece) = pieces.label_of(next)
                && !std::mem::replace(&mut hangs[piece as usize], true)
            {
                trace(&marks, next, cut, ways);
                left -= 1;
            }
        }
    }
}

/// Marks the way back from a voxel to what is held, and where it ends if that would be cut.
fn trace(marks: &[u8], from: [usize; 3], cut: &BitGrid, ways: &mut BitGrid) {
    let (mut v, dims) = (from, cut.dims());
    loop {
        let mark = marks[v[0] + dims[0] * (v[1] + dims[1] * v[2])];
        if ways.get(v) || mark <= HELD && !cut.get(v) {
            return;
        }
        ways.set(v, true);
        if mark <= HELD {
            return;
        }
        match stepped(v, NEIGHBOURS[usize::from(mark - 2)].map(|c| -c), dims) {
            Some(back) => v = back,
            None => return,
        }
    }
}

fn stepped(v: [usize; 3], step: [isize; 3], dims: [usize; 3]) -> Option<[usize; 3]> {
    let mut to = v;
    for a in 0..3 {
        to[a] = v[a].checked_add_signed(step[a]).filter(|c| *c < dims[a])?;
    }
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
    fn a_piece_that_no_face_leads_to_hangs_by_an_edge() {
        let dims = [8, 4, 8];
        let held = BitGrid::from_fn(dims, |[_, _, z]| z < 2);
        let cut = BitGrid::from_fn(dims, |v| v == [3, 1, 2]);
        let loose = BitGrid::from_fn(dims, |v| v == [4, 1, 3]);
        assert_eq!(bridges(&held, &loose, &cut), cut);
    }

    #[test]
    fn a_piece_without_a_way_gets_no_bridge() {
        let dims = [8, 4, 8];
        let held = BitGrid::from_fn(dims, |[_, _, z]| z < 2);
        let loose = BitGrid::from_fn(dims, |[_, _, z]| z == 6);
        assert!(bridges(&held, &loose, &BitGrid::new(dims)).is_empty());
    }

    /// A plate on a block of its own, apart from what is held.
    #[test]
    fn a_piece_apart_keeps_a_foot() {
        let dims = [30, 9, 12];
        let held = BitGrid::from_fn(dims, |[x, _, _]| x < 5);
        let loose = BitGrid::from_fn(dims, |[x, _, z]| x > 8 && z == 8);
        let cut = BitGrid::from_fn(dims, |[x, _, z]| x > 8 && z < 8);
        assert!(bridges(&held, &loose, &cut).is_empty());
        let feet = BitGrid::from_fn(dims, |[x, _, z]| x > 8 && z < 1);
        let left = bridges_or_feet(&held, &loose, &cut, || feet.clone());
        assert!(left.is_subset_of(&cut) && left.intersects(&feet));
        let standing = held.or(&loose).or(&left);
        let stands = flood(&standing, &held.or(&left.and(&feet)), Connectivity::Edge18);
        assert_eq!(stands, standing);
        assert!(left.count() <= 9 * 8, "{}", left.count());
        // Where a bridge does, there are no feet.
        let beside = cut.or(&BitGrid::from_fn(dims, |[x, _, z]| (5..=8).contains(&x) && z > 5));
        let left = bridges_or_feet(&held, &loose, &beside, || unreachable!());
        assert!(!left.is_empty());
    }
}
