//! The end rule, skin against residual, and the measures.

use super::world::*;
use crate::base::{DVec3, Direction};
use crate::voxel::BitGrid;

fn block() -> BitGrid {
    cuboid([3, 3, 0], [11, 11, 6])
}

#[test]
fn what_lies_within_the_tolerance_is_skin_and_what_lies_deeper_is_residual() {
    // Unreached excess on top of what is reused: τ = 1.5 mm takes one layer.
    for (layers, passes) in [(1usize, true), (2, false)] {
        let mut c = case(block(), vec![]);
        c.0.target = cuboid([3, 3, 0], [11, 11, 6 - layers]);
        let m = judge(&c).measures;
        let layer = 64.0;
        assert_eq!(m.excess_mm3, layer * layers as f64);
        assert_eq!((m.skin_mm3, m.residual_mm3), (layer, layer * (layers - 1) as f64));
        assert_eq!(m.residual.is_empty(), passes);
        if passes {
            assert_valid(&c);
            assert_eq!(m.deviation_relative, 0.0);
        } else {
            assert_fails(&c, &["end"]);
            assert_eq!(m.deviation_relative, 64.0 / (64.0 * 4.0));
            let place = m.residual.excess_place.unwrap();
            assert_eq!((place.voxels, place.centroid), (64, DVec3::new(7.0, 7.0, 5.5)));
            assert_eq!(place.bounds.min, DVec3::new(3.0, 3.0, 5.0));
            assert_eq!(place.bounds.max, DVec3::new(11.0, 11.0, 6.0));
        }
    }
}

#[test]
fn a_missing_tower_is_a_deficit_that_is_described() {
    let mut c = case(block(), vec![]);
    c.0.target = block().or(&cuboid([4, 4, 6], [6, 6, 12])).or(&cuboid([9, 9, 6], [10, 10, 8]));
    let v = assert_fails(&c, &["end"]);
    let place = v.measures.residual.deficit_place.as_ref().unwrap();
    // The first layer over the block is skin.
    assert_eq!(place.voxels, 4 * 5 + 1);
    let largest = place.largest.as_ref().unwrap();
    assert_eq!((largest.voxels, largest.centroid), (20, DVec3::new(5.0, 5.0, 9.5)));
    assert!(v.lines()[5].contains("(5.00, 5.00, 9.50)"), "{}", v.lines()[5]);
    assert_eq!(v.measures.residual.deficit.count(), 21);
    assert!(v.measures.residual.excess_place.is_none());
}

#[test]
fn a_small_residual_passes_and_is_still_named() {
    let mut c = case(block(), vec![]);
    c.0.target = block().or(&cuboid([4, 4, 6], [5, 5, 9]));
    assert_valid(&c);
    let m = judge(&c).measures;
    assert_eq!((m.residual_mm3, m.skin_mm3), (2.0, 1.0));
    c.0.rules.deviation = 0.0052;
    assert_valid(&c);
    c.0.rules.deviation = 0.004;
    assert_fails(&c, &["end"]);
    c.0.rules.deviation = f64::NAN;
    assert_fails(&c, &["end"]);
}

#[test]
fn skin_is_measured_from_what_was_reused_not_from_what_was_added() {
    // Old and new top alike: the missing layer lies next to added material only.
    let old = block();
    let new = cuboid([3, 3, 6], [11, 11, 9]);
    let mut c = case(old.clone(), vec![add(Direction::Z, new.clone())]);
    c.0.target = old.or(&cuboid([3, 3, 6], [11, 11, 10]));
    let m = assert_fails(&c, &["end"]).measures;
    assert_eq!((m.skin_mm3, m.deficit_mm3, m.added_mm3), (0.0, 64.0, new.count() as f64));
    assert_eq!(m.reused_mm3, old.count() as f64);
}

#[test]
fn material_removed_and_added_again_is_not_reused() {
    let top = cuboid([3, 3, 4], [11, 11, 6]);
    let steps = vec![cut(Direction::Z, top.clone()), add(Direction::Z, top)];
    let m = judge(&case(block(), steps)).measures;
    assert_eq!((m.reused_mm3, m.removed_mm3, m.added_mm3), (64.0 * 4.0, 128.0, 128.0));
}

#[test]
fn an_empty_target_is_met_or_infinitely_missed() {
    let nothing = BitGrid::new(DIMS);
    let mut c = without_base(case(nothing.clone(), vec![]));
    assert_valid(&c);
    c.0.initial = block();
    c.0.target = nothing;
    let v = assert_fails(&c, &["end"]);
    assert_eq!(v.measures.deviation_relative, f64::INFINITY);
}

#[test]
fn an_absurd_tolerance_calls_everything_skin_and_ends() {
    let mut c = case(block(), vec![]);
    c.0.target = block().or(&cuboid([4, 4, 6], [6, 6, 12]));
    for tau in [100.0, 1e12, f64::INFINITY] {
        c.0.rules.tolerance_mm = tau;
        assert_eq!(judge(&c).measures.residual_mm3, 0.0);
    }
    for tau in [f64::NAN, -1.0] {
        c.0.rules.tolerance_mm = tau;
        assert_eq!(judge(&c).measures.skin_mm3, 0.0);
    }
}
