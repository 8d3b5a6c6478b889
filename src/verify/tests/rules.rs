//! Content, support, stability, machine: for each a plan that breaks it alone and a valid twin.

use super::world::*;
use crate::base::{DVec3, Direction};
use crate::machine::{Holding, HoldingMode, ToolKind};
use crate::verify::support::unsupported;
use crate::voxel::BitGrid;

fn block() -> BitGrid {
    cuboid([3, 3, 0], [11, 11, 6])
}

fn pocket() -> BitGrid {
    cuboid([5, 5, 4], [9, 9, 6])
}

#[test]
fn a_pocket_and_its_filling_are_valid() {
    let steps = vec![cut(Direction::Z, pocket()), add(Direction::Z, pocket())];
    assert_valid(&case(block(), steps));
}

#[test]
fn a_plan_without_steps_is_judged_by_its_end_alone() {
    assert_valid(&case(block(), vec![]));
    let mut other = case(block(), vec![]);
    other.0.target = pocket();
    assert_fails(&other, &["end"]);
}

#[test]
fn content_cutting_air() {
    let mut region = pocket();
    region.set([6, 6, 6], true);
    let v = assert_fails(&case(block(), vec![cut(Direction::Z, region)]), &["content"]);
    let r = v.rules.iter().find(|r| !r.passed).unwrap();
    assert_eq!((r.figure, r.step), (1.0, Some(0)));
    assert!(r.detail.contains("(6.50, 6.50, 6.50)"), "{}", r.detail);
}

#[test]
fn content_adding_into_material() {
    let region = cuboid([5, 5, 5], [9, 9, 8]);
    assert_fails(&case(block(), vec![add(Direction::Z, region)]), &["content"]);
    let above = cuboid([5, 5, 6], [9, 9, 8]);
    assert_valid(&case(block(), vec![add(Direction::Z, above)]));
}

#[test]
fn content_empty_and_foreign_regions() {
    let none = BitGrid::new(DIMS);
    assert_fails(&case(block(), vec![cut(Direction::Z, none.clone())]), &["content"]);
    assert_fails(&case(block(), vec![add(Direction::X, none)]), &["content"]);
    let foreign = BitGrid::from_fn([3, 3, 3], |_| true);
    assert_fails(&case(block(), vec![cut(Direction::Z, foreign)]), &["content"]);
}

#[test]
fn a_job_on_two_grids_or_none_is_refused_whole() {
    let mut c = case(block(), vec![]);
    c.0.target = BitGrid::new([2, 2, 2]);
    assert_fails(&c, &["content"]);
    for pitch in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let mut c = case(block(), vec![cut(Direction::Z, pocket())]);
        c.0.frame.pitch = pitch;
        assert_fails(&c, &["content"]);
    }
}

#[test]
fn support_a_ledge_hangs_on_its_wall_but_nothing_carries_it() {
    let ledge = voxels(&[[11, 6, 5]]);
    assert_valid(&without_base(case(block(), vec![add(Direction::X, ledge.clone())])));
    // Carried at 45° by the wall's next voxel down: only the second one out is not.
    assert_valid(&case(block(), vec![add(Direction::Z, ledge)]));
    let long = cuboid([11, 6, 5], [13, 7, 6]);
    let v = assert_fails(&case(block(), vec![add(Direction::Z, long)]), &["support"]);
    assert!(v.lines()[2].contains("(12.50, 6.50, 5.50)"), "{}", v.lines()[2]);
}

#[test]
fn support_45_degrees_passes_at_50_and_60_do_not() {
    let slope = |run: usize| {
        BitGrid::from_fn(DIMS, |[x, y, z]| {
            (5..9).contains(&y) && (6..8).contains(&z) && (8..11 + run * (z - 5)).contains(&x)
        })
    };
    let nozzle_clear = |c: &mut (crate::plan::Job, crate::plan::Plan)| {
        c.0.nozzles = vec![nozzle(0.4, 9.0)];
    };
    let mut steep = case(block(), vec![add(Direction::Z, slope(1))]);
    nozzle_clear(&mut steep);
    assert_valid(&steep);
    let mut flat = case(block(), vec![add(Direction::Z, slope(2))]);
    nozzle_clear(&mut flat);
    assert_fails(&flat, &["support"]);
    // 54.7°, over a corner: refused at 50°, taken at 60°, and the angle itself is allowed.
    let below = voxels(&[[5, 5, 5]]);
    let region = voxels(&[[6, 6, 6]]);
    let count = |deg| unsupported(&add(Direction::Z, region.clone()), &below, deg).count;
    assert_eq!((count(50.0), count(60.0)), (1, 0));
    assert_eq!(count(2f64.sqrt().atan().to_degrees()), 0);
    assert_eq!(count(f64::NAN), 1);
}

#[test]
fn support_over_a_voxel_between() {
    // x over corner a (54.7°), b under a: x − b leans 35°.
    let region = voxels(&[[6, 6, 6]]);
    let count = |solid: &[[usize; 3]]| {
        unsupported(&add(Direction::Z, region.clone()), &voxels(solid), 50.0).count
    };
    assert_eq!(count(&[[5, 5, 5], [5, 5, 4]]), 0);
    assert_eq!(count(&[[5, 5, 5]]), 1);
    assert_eq!(count(&[[5, 5, 4]]), 1, "the voxel between must be solid");
    assert_eq!(count(&[[5, 5, 5], [4, 4, 4]]), 1, "b leans as much as a");
}

#[test]
fn stability_a_cut_through_drops_the_upper_half() {
    let column = || cuboid([5, 5, 0], [10, 10, 10]);
    let through = cuboid([5, 5, 5], [10, 10, 6]);
    let v = assert_fails(&case(column(), vec![cut(Direction::X, through)]), &["stability"]);
    assert_eq!(v.rules.iter().find(|r| !r.passed).unwrap().figure, 100.0);
    let with_neck = cuboid([6, 5, 5], [10, 10, 6]);
    assert_valid(&case(column(), vec![cut(Direction::X, with_neck)]));
}

#[test]
fn stability_edges_hold_and_corners_do_not() {
    let on = |v: [usize; 3]| case(cuboid([5, 5, 0], [6, 6, 4]).or(&voxels(&[v])), vec![]);
    for (v, loose) in [([6, 5, 4], 0), ([6, 6, 3], 0), ([5, 4, 4], 0), ([6, 6, 4], 1)] {
        let (job, _) = on(v);
        assert_eq!(super::super::stability::unheld(&job.initial, &job.frame, 2.0).count, loose);
        assert_eq!(super::super::stability::apart(&job.initial).count, loose);
    }
}

#[test]
fn stability_refixtured_parts_are_one_body_anywhere() {
    let column = || cuboid([5, 5, 0], [10, 10, 10]);
    let foot = cuboid([5, 5, 0], [10, 10, 2]);
    let based = without_base(case(column(), vec![cut(Direction::X, foot)]));
    assert_fails(&based, &["stability"]);
    let mut refixtured = based;
    refixtured.0.rules.holding = HoldingMode::Refixture;
    assert_valid(&refixtured);
    let through = cuboid([5, 5, 4], [10, 10, 5]);
    let mut apart = case(column(), vec![cut(Direction::X, through)]);
    apart.0.rules.holding = HoldingMode::Refixture;
    let v = assert_fails(&apart, &["stability"]);
    let r = v.rules.iter().find(|r| !r.passed).unwrap();
    assert_eq!(r.figure, 100.0, "the smaller piece is the loose one");
}

#[test]
fn an_empty_state_is_stable() {
    let all = block();
    let mut c = without_base(case(all.clone(), vec![cut(Direction::Z, all)]));
    assert_valid(&c);
    c.0.rules.holding = HoldingMode::Refixture;
    assert_valid(&c);
}

fn side_cut() -> (crate::plan::Job, crate::plan::Plan) {
    case(block(), vec![cut(Direction::X, cuboid([8, 3, 2], [11, 11, 6]))])
}

#[test]
fn machine_direction_beyond_the_tilt() {
    assert_valid(&side_cut());
    let mut c = side_cut();
    c.0.machine.kinematics.first.limits_deg = Some([-60.0, 60.0]);
    let v = assert_fails(&c, &["machine"]);
    assert!(v.lines()[4].contains("90.00°"), "{}", v.lines()[4]);
    let mut c = side_cut();
    c.1.steps[0].direction = Direction::new(DVec3::new(1.0, 0.0, -0.01)).unwrap();
    assert_fails(&without_base(c), &["machine"]);
}

#[test]
fn machine_travel_of_the_linear_axes() {
    // Gauge 10 mm, pedestal 30 mm, a pocket from z = 4 to 6: the nose goes to 44.5 and 45.5.
    let mut c = case(block(), vec![cut(Direction::Z, pocket())]);
    c.0.machine.kinematics.z.limits_mm = [44.4, 1e4];
    assert_valid(&c);
    c.0.machine.kinematics.z.limits_mm = [44.6, 1e4];
    let v = assert_fails(&c, &["machine"]);
    assert!(v.lines()[4].contains("axis Z"), "{}", v.lines()[4]);
    c.0.machine.kinematics.z.limits_mm = [0.0, 45.4];
    assert_fails(&c, &["machine"]);
    // The contact's middle stands at x = 0, the pocket reaches 1.5 mm to both sides of it.
    let mut c = case(block(), vec![cut(Direction::Z, pocket())]);
    c.0.machine.kinematics.x.limits_mm = [-1.5, 1.5];
    assert_valid(&c);
    c.0.machine.kinematics.x.limits_mm = [-1.5, 1.4];
    assert_fails(&c, &["machine"]);
}

#[test]
fn machine_tools_of_the_job_and_the_kind_only() {
    let mut c = side_cut();
    c.1.steps[0].tool = "laser".into();
    assert_fails(&c, &["machine"]);
    c.1.steps[0].tool = "nozzle".into();
    assert_fails(&c, &["machine"]);
    let mut c = side_cut();
    c.0.cutters[0].kind = ToolKind::Additive;
    assert_fails(&c, &["machine"]);
    let mut c = side_cut();
    c.0.cutters[0].sections.clear();
    assert_fails(&c, &["machine"]);
}

#[test]
fn machine_holdings() {
    let with = |mode: HoldingMode, holdings: Vec<Holding>, used: usize| {
        let mut c = side_cut();
        c.0.rules.holding = mode;
        c.1.holdings = holdings;
        c.1.steps[0].holding = used;
        c
    };
    use HoldingMode::{Base, Refixture};
    let clamped = Holding::AS_CLAMPED;
    let flipped = Holding { up: Direction::NEG_Z, height_mm: -6.0 };
    assert_valid(&with(Refixture, vec![clamped, flipped], 1));
    assert_valid(&with(Base, vec![clamped, flipped], 0));
    assert_fails(&with(Base, vec![clamped, flipped], 1), &["machine"]);
    assert_fails(&with(Refixture, vec![clamped], 1), &["machine"]);
    assert_fails(&with(Base, vec![], 0), &["machine"]);
    assert_fails(&with(Base, vec![Holding { up: Direction::Z, height_mm: -1.0 }], 0), &["machine"]);
    let in_the_air = Holding { up: Direction::NEG_Z, height_mm: -60.0 };
    let v = assert_fails(&with(Refixture, vec![clamped, in_the_air], 1), &["machine"]);
    assert!(v.lines()[4].contains("grip height"), "{}", v.lines()[4]);
    let oblique = Direction::new(DVec3::new(0.1, 0.0, -1.0)).unwrap();
    let mut c = with(Refixture, vec![clamped, Holding { up: oblique, height_mm: -6.0 }], 1);
    c.0.rules.grip_mm = 5.0;
    c.0.machine.kinematics.first.limits_deg = Some([-100.0, 100.0]);
    assert_fails(&c, &["machine"]);
}

#[test]
fn a_cancelled_run_gives_no_verdict() {
    use std::sync::{Arc, atomic::AtomicBool};
    let stop = Arc::new(AtomicBool::new(true));
    let ctx = crate::base::Ctx::new(stop, None, Arc::new(crate::base::Silent), 0);
    let (job, plan) = side_cut();
    assert!(crate::verify::verify(&job, plan, &ctx).is_err());
}
