//! Models of a real size: a gyroid, a truss, and plans with one operation changed.
//!
//! `HMPLAN_FULL=1` takes the sizes that are too large for a debug build.

use super::naive_tests::{random, replay, standing};
use super::{Options, operations};
use crate::base::Ctx;
use crate::plan::{Deed, Operation, Orientation};
use crate::verify::verify_operations;
use crate::voxel::BitGrid;

fn full() -> bool {
    std::env::var_os("HMPLAN_FULL").is_some()
}

/// A sheet gyroid of `n` voxels a side, two periods along each.
fn gyroid(n: usize) -> BitGrid {
    let solid = BitGrid::from_fn([n; 3], |v| {
        let [x, y, z] = v.map(|c| 4.0 * std::f64::consts::PI * c as f64 / n as f64);
        (x.sin() * y.cos() + y.sin() * z.cos() + z.sin() * x.cos()).abs() < 0.5
    });
    standing(&solid)
}

/// A beam of chords, posts and diagonals, standing on its two ends.
fn truss() -> BitGrid {
    let solid = BitGrid::from_fn([100, 20, 20], |[x, y, z]| {
        let side = !(3..17).contains(&y);
        let chord = side && !(3..17).contains(&z) && !(z == 0 && (5..95).contains(&x));
        let slope = (x % 40).min(39 - x % 40);
        let diagonal = side && slope.abs_diff(z) < 3;
        let cross = z >= 17 && x % 20 < 3;
        chord || diagonal || cross
    });
    standing(&solid)
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

/// Of 1,000 single changes each is refused, or the changed part keeps every rule to the letter and
/// ends in the state it ended in before, after which nothing is changed.
#[test]
fn single_changes_of_a_large_plan_are_refused_or_shown_to_be_harmless() {
    let target = gyroid(if full() { 100 } else { 24 });
    let none = BitGrid::new(target.dims());
    let length = 10;
    let ops = made(&target, length);
    let (mut harmless, mut refused) = ([0; 5], [0; 5]);
    for i in 0..1_000u64 {
        let kind = i as usize % 5;
        let (changed, first, last) = mutated(&ops, kind, i);
        if verify_operations(&none, &target, &changed, length).is_err() {
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
