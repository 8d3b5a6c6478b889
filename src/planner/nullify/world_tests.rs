//! Models of a real size: a gyroid, a truss, and plans with one operation changed.
//!
//! `HMPLAN_FULL=1` takes the sizes that are too large for a debug build.

use super::naive_tests::{random, standing};
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

/// A dropped or doubled operation never passes; a swap or a turn only when the rules still hold.
#[test]
fn single_changes_of_a_large_plan_are_refused() {
    let target = gyroid(if full() { 50 } else { 24 });
    let none = BitGrid::new(target.dims());
    let ops = made(&target, 10);
    let mut harmless = [0; 4];
    for i in 0..1_000u64 {
        let mut at = random(77, i) as usize % (ops.len() - 1);
        let kind = i as usize % 4;
        if kind == 2 {
            // Only a cut has an orientation.
            let cut = |op: &Operation| op.deed != Deed::Add;
            at = (at..ops.len()).chain(0..at).find(|t| cut(&ops[*t])).unwrap();
        }
        let mut changed = ops.clone();
        match (kind, ops[at].deed) {
            (0, _) => changed.swap(at, at + 1),
            (1, _) => drop(changed.remove(at)),
            (2, Deed::Cut(way)) => {
                let others = Orientation::ALL.into_iter().filter(|o| *o != way);
                changed[at].deed = Deed::Cut(others.cycle().nth(i as usize / 4 % 4).unwrap());
            }
            _ => changed.insert(at, ops[at]),
        }
        harmless[kind] += usize::from(verify_operations(&none, &target, &changed, 10).is_ok());
    }
    println!("of 250 each, harmless: swapped, dropped, turned, doubled {harmless:?}");
    assert_eq!([harmless[1], harmless[3]], [0, 0]);
    assert!(harmless[2] < 200, "{harmless:?}");
}
