//! The forward rules of INV Sec. 2 to the letter, one operation at a time, with a flood fill
//! after every cut: the reference every plan is held against.

use super::initial::from_initial;
use super::{Options, operations};
use crate::base::Ctx;
use crate::plan::{Deed, Operation, Orientation};
use crate::verify::verify_operations;
use crate::voxel::BitGrid;

type P = [i64; 3];

/// Offsets to 𝒩.
fn neighbourhood() -> impl Iterator<Item = P> {
    (0..27i64)
        .map(|i| [i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1])
        .filter(|o| (1..=2).contains(&o.iter().map(|c| c * c).sum::<i64>()))
}

fn plus(a: P, b: P) -> P {
    std::array::from_fn(|i| a[i] + b[i])
}

/// What of `g` is connected to the base layer.
pub(super) fn standing(g: &BitGrid) -> BitGrid {
    let mut seen = BitGrid::new(g.dims());
    let mut open: Vec<[usize; 3]> = g.iter_ones().filter(|v| v[2] == 0).collect();
    open.iter().for_each(|v| seen.set(*v, true));
    while let Some(v) = open.pop() {
        for o in neighbourhood() {
            let p = plus(v.map(|c| c as i64), o);
            if g.get_or_empty(p) {
                let q = p.map(|c| c as usize);
                if !seen.get(q) {
                    seen.set(q, true);
                    open.push(q);
                }
            }
        }
    }
    seen
}

pub(super) fn stable(g: &BitGrid) -> bool {
    standing(g) == *g
}

/// 𝒯_S (Def. 2.4).
fn in_cutter(v: P, q: P, way: Orientation, length: i64) -> bool {
    let (axis, sign) = match way {
        Orientation::Down => (2, 1),
        Orientation::PlusX => (0, -1),
        Orientation::MinusX => (0, 1),
        Orientation::PlusY => (1, -1),
        Orientation::MinusY => (1, 1),
    };
    let along = sign * (q[axis] - v[axis]);
    let on_row = (0..3).all(|a| a == axis || q[a] == v[a]);
    along >= length || (on_row && along > 0)
}

/// Replays the operations from `state`; the final state, or what is wrong.
pub(super) fn replay(
    mut state: BitGrid,
    operations: &[Operation],
    length: u32,
) -> Result<BitGrid, String> {
    for (t, op) in operations.iter().enumerate() {
        let v = op.voxel.map(i64::from);
        let at = op.voxel.map(usize::from);
        let bad = |why: &str| Err(format!("operation {t} {op:?}: {why}"));
        match op.deed {
            Deed::Add => {
                if state.get(at) {
                    return bad("is solid already");
                }
                let carried = neighbourhood().any(|o| o[2] == -1 && state.get_or_empty(plus(v, o)));
                if v[2] != 0 && !carried {
                    return bad("is not carried");
                }
                if state.iter_ones().any(|q| q[2] as i64 > v[2]) {
                    return bad("lies under material");
                }
                state.set(at, true);
            }
            Deed::CutAnyhow => return bad("does not say how"),
            Deed::Cut(way) => {
                if !state.get(at) {
                    return bad("is empty already");
                }
                let length = i64::from(length);
                if state.iter_ones().any(|q| in_cutter(v, q.map(|c| c as i64), way, length)) {
                    return bad("is not reached");
                }
                state.set(at, false);
                if !stable(&state) {
                    return bad("leaves something loose");
                }
            }
        }
    }
    Ok(state)
}

fn check(target: &BitGrid, length: u32) {
    let options = Options { length, ..Options::default() };
    let ops = operations(target, &options, &Ctx::quiet()).unwrap();
    let voxels: Vec<_> = target.iter_ones().collect();
    match replay(BitGrid::new(target.dims()), &ops, length) {
        Ok(end) => assert_eq!(end, *target, "L = {length}, {voxels:?}"),
        Err(e) => panic!("{e}; L = {length}, {:?}: {voxels:?}", target.dims()),
    }
}

/// Plans from one random part to another; whether any of the first is kept.
fn check_pair(initial: &BitGrid, target: &BitGrid, length: u32) -> Option<bool> {
    let options = Options { length, ..Options::default() };
    let (ops, kept) = from_initial(initial, target, &options, &Ctx::quiet()).ok()?;
    match replay(initial.clone(), &ops, length) {
        Ok(end) => assert_eq!(end, *target),
        Err(e) => panic!("{e}; L = {length}, {:?}", target.dims()),
    }
    Some(kept > 0)
}

#[test]
fn one_random_part_is_made_of_another() {
    let (mut made, mut reused) = (0, 0);
    for stream in 0..400u64 {
        let dims = [4 + stream as usize % 5, 4 + stream as usize % 3, 3 + stream as usize % 4];
        let fill = |i| random_stable(dims, 55 + 10 * (stream % 4), 2 * stream + i);
        if let Some(kept) = check_pair(&fill(0), &fill(1), 2 + (stream % 4) as u32) {
            made += 1;
            reused += usize::from(kept);
        }
    }
    println!("{made} of 400 made, {reused} of them reuse something");
    assert!(made > 380 && reused > 100, "{made} {reused}");
}

/// A rod from the base to the four sides of its box, over its top and down into its middle.
fn coil() -> BitGrid {
    let corners: [P; 10] = [
        [4, 4, 0],
        [4, 4, 2],
        [0, 4, 2],
        [0, 4, 4],
        [0, 0, 4],
        [8, 0, 4],
        [8, 8, 4],
        [4, 8, 4],
        [4, 8, 8],
        [4, 4, 8],
    ];
    let end = [4, 4, 5];
    let mut rod = BitGrid::new([9; 3]);
    for (from, to) in corners.into_iter().zip(corners.into_iter().skip(1).chain([end])) {
        let length = (0..3).map(|a| (to[a] - from[a]).abs()).max().unwrap_or(0);
        for i in 0..=length {
            let at: P = std::array::from_fn(|a| from[a] + i * (to[a] - from[a]).signum());
            rod.set(at.map(|c| c as usize), true);
        }
    }
    rod
}

/// By every order of cuts that the rules allow.
#[test]
fn a_coil_deeper_than_the_cutter_is_locked() {
    let coil = coil();
    assert!(stable(&coil));
    let target = BitGrid::from_fn([9; 3], |v| v == [4, 4, 0]);
    let from = |length| {
        let options = Options { length, ..Options::default() };
        from_initial(&coil, &target, &options, &Ctx::quiet())
    };
    let said = from(2).unwrap_err().to_string();
    assert!(said.contains("locked") && said.contains("holds others up"), "{said}");
    let (ops, _) = from(10).unwrap();
    assert_eq!(replay(coil.clone(), &ops, 10), Ok(target));

    let end = [4, 4, 5];
    let (mut seen, mut open) = (vec![coil.clone()], vec![coil]);
    while let Some(state) = open.pop() {
        for v in state.iter_ones() {
            for way in Orientation::ALL {
                let op = Operation { voxel: v.map(|c| c as u16), deed: Deed::Cut(way) };
                let Ok(next) = replay(state.clone(), &[op], 2) else { continue };
                assert!(next.get(end));
                if !seen.contains(&next) {
                    seen.push(next.clone());
                    open.push(next);
                }
            }
        }
    }
    assert!(seen.len() > 1);
    println!("{} states, the end of the coil in each", seen.len());
}

#[test]
fn what_cannot_be_made_is_refused_with_the_reason() {
    let said = |target: &BitGrid, length| {
        let options = Options { length, ..Options::default() };
        operations(target, &options, &Ctx::quiet()).unwrap_err().to_string()
    };
    let cube = BitGrid::from_fn([2, 2, 2], |_| true);
    assert!(said(&cube, 1).contains("L = 1"));
    assert!(said(&BitGrid::new([2, 2, 2]), 10).contains("empty"));
    let corner = BitGrid::from_fn([2, 2, 2], |v| v == [0, 0, 0] || v == [1, 1, 1]);
    assert!(said(&corner, 10).contains("1 of its 2 voxels"), "{}", said(&corner, 10));
}

/// The fast replay and the naive one agree on plans with one operation swapped with its
/// neighbour, dropped, doubled or turned.
#[test]
fn the_fast_replay_judges_mutations_as_the_naive_one_does() {
    let (mut harmless, mut refused) = (0, 0);
    for stream in 0..1_000u64 {
        let dims = [4 + stream as usize % 4, 5, 4 + stream as usize % 3];
        let target = random_stable(dims, 35 + 5 * (stream % 8), stream);
        let (length, none) = (2 + (stream % 3) as u32, BitGrid::new(dims));
        let options = Options { length, ..Options::default() };
        let Ok(mut ops) = operations(&target, &options, &Ctx::quiet()) else { continue };
        assert_eq!(verify_operations(&none, &target, &ops, length), Ok(()));
        let at = random(stream, 1) as usize % (ops.len() - 1).max(1);
        match (stream % 4, ops[at].deed) {
            (0, _) if ops.len() > 1 => ops.swap(at, at + 1),
            (1, _) => drop(ops.remove(at)),
            (2, Deed::Cut(way)) => {
                let other = Orientation::ALL.into_iter().find(|o| *o != way);
                ops[at].deed = Deed::Cut(other.unwrap());
            }
            _ => ops.insert(at, ops[at]),
        }
        let naive = replay(none.clone(), &ops, length).is_ok_and(|end| end == target);
        let fast = verify_operations(&none, &target, &ops, length);
        assert_eq!(fast.is_ok(), naive, "{stream}: {fast:?}");
        if naive { harmless += 1 } else { refused += 1 }
    }
    assert!(refused > 500 && harmless > 20, "{refused} {harmless}");
}

fn solid_of(dims: [usize; 3], bits: u64) -> BitGrid {
    BitGrid::from_fn(dims, |[x, y, z]| bits >> (x + dims[0] * (y + dims[1] * z)) & 1 == 1)
}

#[test]
fn every_stable_solid_of_three_small_grids_is_made_exactly() {
    for dims in [[3, 3, 2], [3, 2, 3], [2, 2, 4]] {
        let n: usize = dims.iter().product();
        let mut made = 0;
        for bits in 1..1u64 << n {
            let target = solid_of(dims, bits);
            if stable(&target) {
                check(&target, 2 + (bits % 2) as u32);
                made += 1;
            }
        }
        assert!(made > 10_000, "{dims:?}: {made}");
    }
}

/// A well-mixed number for each (stream, i).
pub(super) fn random(stream: u64, i: u64) -> u64 {
    let mut h = (stream << 32 ^ i).wrapping_add(0x9E37_79B9_7F4A_7C15);
    h = (h ^ h >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    h = (h ^ h >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
    h ^ h >> 31
}

/// A random solid, `percent` of it filled, without what is loose.
pub(super) fn random_stable(dims: [usize; 3], percent: u64, stream: u64) -> BitGrid {
    standing(&BitGrid::from_fn(dims, |[x, y, z]| {
        random(stream, (x + dims[0] * (y + dims[1] * z)) as u64) % 100 < percent
    }))
}

#[test]
fn random_solids_are_made_exactly() {
    let mut made = 0;
    for stream in 0..100_000 {
        let target = random_stable([3, 3, 3], 20 + 10 * (stream % 7), stream);
        if !target.is_empty() {
            check(&target, 2);
            made += 1;
        }
    }
    assert!(made > 90_000, "{made}");
}

#[test]
fn larger_random_solids_are_made_exactly() {
    for stream in 0..2_000u64 {
        let side = |k: u64| 3 + ((stream * 7 + k * 13) % 10) as usize;
        let percent = 10 + 7 * (stream % 11);
        let target = random_stable([side(0), side(1), side(2)], percent, stream);
        if !target.is_empty() {
            check(&target, 2 + (stream % 5) as u32);
        }
    }
}
