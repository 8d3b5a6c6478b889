//! Models of a real size: a gyroid, a truss, and plans with one operation changed.
//!
//! `HMPLAN_FULL=1` takes the sizes that are too large for a debug build.

#[path = "../../../tests/fixtures/solids.rs"]
mod solids;

use super::naive_tests::{random, replay, standing};
use super::{Options, operations};
use crate::base::{Ctx, DAffine3, DMat3, DVec3};
use crate::mesh::{ReadOptions, read};
use crate::plan::{Deed, Operation, Orientation};
use crate::verify::verify_operations;
use crate::voxel::{BitGrid, Frame, voxelise};
use solids::{TRUSS, in_gyroid, in_truss};
use std::path::Path;
use std::time::Instant;

fn full() -> bool {
    std::env::var_os("HMPLAN_FULL").is_some()
}

fn gyroid(n: usize) -> BitGrid {
    standing(&BitGrid::from_fn([n; 3], |v| in_gyroid(n, v)))
}

fn truss() -> BitGrid {
    standing(&BitGrid::from_fn(TRUSS, in_truss))
}

/// The mesh `fertility`, y up, at this pitch; none where it does not lie beside the project.
fn fertility(pitch: f64) -> Option<BitGrid> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/meshes/fertility.off");
    if !path.exists() {
        println!("{} left out: it is not there", path.display());
        return None;
    }
    let mesh = read(&path, &ReadOptions::default()).unwrap().mesh;
    let turn = DMat3::from_cols(DVec3::X, DVec3::Z, -DVec3::Y);
    let turned = mesh.transformed(&DAffine3::from_mat3(turn)).unwrap();
    let frame = Frame::around(turned.bounds(), pitch, 0).unwrap();
    let solid = voxelise(&turned, &frame, &Ctx::quiet()).unwrap();
    Some(standing(&solid))
}

/// Plans and replays; the operations.
fn made(target: &BitGrid, length: u32) -> Vec<Operation> {
    let options = Options { length, ..Options::default() };
    let ops = operations(target, &options, &Ctx::quiet()).unwrap();
    assert_eq!(verify_operations(&BitGrid::new(target.dims()), target, &ops, length), Ok(()));
    ops
}

#[test]
fn a_gyroid_and_a_truss_are_made_exactly() {
    for n in if full() { vec![50, 100] } else { vec![50] } {
        let target = gyroid(n);
        let ops = made(&target, 10);
        println!("gyroid {n}: {} solid, {} operations", target.count(), ops.len());
    }
    let target = truss();
    let ops = made(&target, 10);
    println!("truss: {} solid, {} operations", target.count(), ops.len());
}

/// The state after these operations, whatever their rules.
fn after(mut state: BitGrid, operations: &[Operation]) -> BitGrid {
    operations.iter().for_each(|op| state.set(op.voxel.map(usize::from), op.deed == Deed::Add));
    state
}

/// The operations with one change, and the first and last place where they differ.
fn mutated(ops: &[Operation], kind: usize, i: u64) -> (Vec<Operation>, usize, usize) {
    let mut at = random(77, i) as usize % (ops.len() - 1);
    let mut changed = ops.to_vec();
    match kind {
        // With its neighbour, then with any other.
        0 => changed.swap(at, at + 1),
        1 => {
            let other = random(78, i) as usize % ops.len();
            changed.swap(at, other);
            return (changed, at.min(other), at.max(other));
        }
        2 => drop(changed.remove(at)),
        3 => changed.insert(at, ops[at]),
        _ => {
            // Only a cut has an orientation.
            let cut = |t: &usize| ops[*t].deed != Deed::Add;
            at = (at..ops.len()).chain(0..at).find(cut).unwrap();
            let others = Orientation::ALL.into_iter().filter(|o| Deed::Cut(*o) != ops[at].deed);
            changed[at].deed = Deed::Cut(others.cycle().nth(i as usize / 5 % 4).unwrap());
            return (changed, at, at);
        }
    }
    (changed, at, at + 1)
}

#[test]
fn single_changes_of_a_large_plan_are_refused_or_shown_to_be_harmless() {
    if !full() {
        return judge_changes(&gyroid(24));
    }
    judge_changes(&gyroid(100));
    // 250 voxels along its longest side.
    if let Some(target) = fertility(0.8) {
        judge_changes(&target);
    }
}

/// Of 1,000 single changes each is refused, or the changed part keeps every rule to the letter and
/// ends in the state it ended in before, after which nothing is changed.
fn judge_changes(target: &BitGrid) {
    let none = BitGrid::new(target.dims());
    let length = 10;
    let began = Instant::now();
    let options = Options { length, ..Options::default() };
    let ops = operations(target, &options, &Ctx::quiet()).unwrap();
    let planning = began.elapsed().as_secs_f64();
    let began = Instant::now();
    assert_eq!(verify_operations(&none, target, &ops, length), Ok(()));
    let replaying = began.elapsed().as_secs_f64();
    println!("planned in {planning:.2} s, replayed in {replaying:.2} s");
    let (mut harmless, mut refused) = ([0; 5], [0; 5]);
    for i in 0..1_000u64 {
        let kind = i as usize % 5;
        let (changed, first, last) = mutated(&ops, kind, i);
        if verify_operations(&none, target, &changed, length).is_err() {
            refused[kind] += 1;
            continue;
        }
        assert!(kind != 2 && kind != 3, "operation {first} dropped or doubled");
        let before = after(none.clone(), &ops[..first]);
        let end = replay(before.clone(), &changed[first..=last], length);
        assert_eq!(end, Ok(after(before, &ops[first..=last])), "change {i} of kind {kind}");
        harmless[kind] += 1;
    }
    println!(
        "{} operations; swapped with the next, with any, dropped, doubled, turned: {refused:?} \
         refused, {harmless:?} harmless",
        ops.len()
    );
    assert!(refused[1] > 150 && refused[4] > 50, "{refused:?}");
}
