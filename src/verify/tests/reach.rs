//! Tool access, both kinds: plans that break it alone, and valid twins.

use super::world::*;
use crate::base::Direction;
use crate::machine::{Holding, HoldingMode, Section, Shape, Table};
use crate::voxel::BitGrid;

fn block() -> BitGrid {
    cuboid([3, 3, 0], [11, 11, 12])
}

#[test]
fn an_undercut_is_cut_from_the_side_only() {
    let cave = || cuboid([6, 5, 4], [11, 9, 7]);
    let v = assert_fails(&case(block(), vec![cut(Direction::Z, cave())]), &["tool-access"]);
    assert_eq!(
        v.rules.iter().find(|r| !r.passed).unwrap().figure,
        48.0,
        "all but the rim that the edge brushes"
    );
    assert_valid(&case(block(), vec![cut(Direction::X, cave())]));
}

#[test]
fn the_holder_ends_a_deep_slot() {
    let slot = |depth: usize| {
        let tall = cuboid([2, 2, 0], [13, 13, 16]);
        case(tall, vec![cut(Direction::Z, cuboid([6, 6, 16 - depth], [9, 9, 16]))])
    };
    assert_valid(&slot(10));
    let v = assert_fails(&slot(12), &["tool-access"]);
    assert_eq!(v.rules.iter().find(|r| !r.passed).unwrap().figure, 2.0 * 9.0 - 9.0);
}

#[test]
fn a_cut_is_judged_against_its_output() {
    // The region itself is no obstacle, however thick.
    let whole_top = cuboid([3, 3, 2], [11, 11, 12]);
    assert_valid(&case(block(), vec![cut(Direction::Z, whole_top)]));
}

#[test]
fn a_round_cutter_leaves_what_it_cannot_enter() {
    let mut c = case(block(), vec![cut(Direction::Z, cuboid([6, 6, 9], [9, 9, 12]))]);
    assert_valid(&c);
    c.0.cutters[0].sections[0].shape = cylinder(0.0, 10.0, 1.5);
    assert_valid(&c);
    c.0.cutters[0].sections[0].shape = cylinder(0.0, 10.0, 2.1);
    assert_fails(&c, &["tool-access"]);
    // A ball of radius 3 touches the corner voxel of a floor only 2 mm up: its tip would be in it.
    let pocket = cuboid([4, 4, 9], [11, 11, 12]);
    let mut c = case(cuboid([1, 1, 0], [14, 13, 12]), vec![cut(Direction::Z, pocket)]);
    c.0.cutters[0].sections[0].shape = cylinder(0.0, 10.0, 3.0);
    assert_valid(&c);
    c.0.cutters[0].sections[0].shape = Shape::Ball { radius: 3.0 };
    c.0.cutters[0].sections.push(section(cylinder(3.0, 10.0, 3.0), true));
    assert_fails(&c, &["tool-access"]);
}

#[test]
fn a_cutting_edge_without_end_is_refused() {
    let mut c = case(block(), vec![cut(Direction::Z, cuboid([6, 6, 9], [9, 9, 12]))]);
    let endless = Section { shape: Shape::Platform { z: 0.0 }, active: true };
    c.0.cutters[0].sections = vec![endless];
    assert_fails(&c, &["tool-access"]);
}

#[test]
fn the_nozzle_body_meets_a_tall_wall() {
    let beside = |wall: usize| {
        let part = cuboid([3, 3, 0], [11, 11, 4]).or(&cuboid([3, 3, 4], [5, 11, 4 + wall]));
        case(part, vec![add(Direction::Z, cuboid([5, 5, 4], [8, 9, 5]))])
    };
    assert_valid(&beside(4)); // 3 mm over the first layer: as high as the tip is long
    assert_fails(&beside(5), &["tool-access"]);
}

#[test]
fn the_tip_may_dip_and_the_body_may_not() {
    let beside = |wall: usize, nozzle| {
        let part = cuboid([3, 3, 0], [11, 11, 4]).or(&cuboid([3, 3, 4], [5, 11, 4 + wall]));
        let mut c = case(part, vec![add(Direction::Z, cuboid([5, 5, 4], [8, 9, 5]))]);
        c.0.nozzles = vec![nozzle];
        c
    };
    // A tip of radius 1.2 overlaps the wall's centres at 1 mm; it may stand 1 mm low.
    assert_valid(&beside(1, nozzle(1.2, 3.0)));
    assert_valid(&beside(2, nozzle(1.2, 3.0)));
    assert_fails(&beside(3, nozzle(1.2, 3.0)), &["tool-access"]);
    // Half a millimetre up the body begins: 1 mm of wall is above it, dip or no dip.
    assert_valid(&beside(1, nozzle(0.4, 0.5)));
    assert_fails(&beside(2, nozzle(0.4, 0.5)), &["tool-access"]);
    let mut c = beside(2, nozzle(1.2, 3.0));
    c.0.rules.nozzle_dip_mm = 0.9;
    assert_fails(&c, &["tool-access"]);
    for dip in [-0.1, f64::NAN, f64::INFINITY] {
        let mut c = beside(1, nozzle(0.4, 3.0));
        c.0.rules.nozzle_dip_mm = dip;
        assert_fails(&c, &["tool-access"]);
    }
}

#[test]
fn a_deposit_does_not_meet_its_own_lower_layers() {
    let tower = cuboid([5, 5, 4], [8, 8, 16]);
    assert_valid(&case(cuboid([3, 3, 0], [11, 11, 4]), vec![add(Direction::Z, tower)]));
}

#[test]
fn table_and_pedestal_stop_a_head() {
    let mut c = case(
        cuboid([3, 3, 0], [11, 11, 6]),
        vec![cut(Direction::X, cuboid([8, 3, 0], [11, 11, 1]))],
    );
    // A short edge: the holder's radius of 4 mm begins 1 mm out.
    c.0.cutters[0].sections[0].shape = cylinder(0.0, 1.0, 0.8);
    c.0.cutters[0].sections[1].shape = cylinder(4.0, 20.0, 4.0);
    c.0.cutters[0].sections.push(section(cylinder(1.0, 4.0, 0.8), false));
    let upper = cuboid([8, 3, 1], [11, 11, 6]);
    c.1.steps.insert(0, cut(Direction::Z, upper.clone()));
    c.0.cutters.push(super::world::cutter());
    c.0.cutters[1].name = "long".into();
    c.1.steps[0].tool = "long".into();
    c.0.target.subtract(&upper);
    c.0.machine.workholding.pedestal_mm = 2.0;
    c.0.machine.workholding.table = Table::Disc { radius_mm: 20.0 };
    assert_fails(&c, &["tool-access"]);
    c.0.machine.workholding.pedestal_mm = 30.0;
    c.0.machine.workholding.table = Table::Disc { radius_mm: 1.0 };
    assert_valid(&c);
    c.0.machine.workholding.pedestal_mm = 2.0;
    c.0.machine.workholding.table = Table::Disc { radius_mm: 20.0 };
    assert_valid(&without_base(c));
}

#[test]
fn a_new_holding_brings_new_obstacles() {
    // Pocket from below: only once the part is flipped, and its old base is free.
    let part = cuboid([3, 3, 0], [11, 11, 6]);
    let pocket = cuboid([5, 5, 0], [9, 9, 2]);
    let mut c = case(part, vec![cut(Direction::NEG_Z, pocket)]);
    c.0.rules.holding = HoldingMode::Refixture;
    c.0.machine.kinematics.first.limits_deg = Some([-180.0, 180.0]);
    assert_fails(&c, &["tool-access"]);
    c.1.holdings.push(Holding { up: Direction::NEG_Z, height_mm: -6.0 });
    c.1.steps[0].holding = 1;
    assert_valid(&c);
    // And from above the pedestal is now in the way.
    let mut above = c.clone();
    let slot = cuboid([5, 5, 3], [9, 9, 6]);
    above.1.steps.push(cut(Direction::Z, slot.clone()));
    above.0.target.subtract(&slot);
    assert_valid(&above);
    above.1.steps[1].holding = 1;
    assert_fails(&above, &["tool-access"]);
}
