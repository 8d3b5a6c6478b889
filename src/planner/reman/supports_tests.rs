//! Supports and the bare base on worlds small enough to know the answer.

use super::laying::{Layer, Way, base_layer};
use super::local_tests::job_of;
use super::printing::OnSupports;
use super::setting::Setting;
use super::supports::lay_on_supports;
use super::{Options, plan};
use crate::access::CarrierTable;
use crate::base::{Ctx, DVec3, Direction};
use crate::machine::{HoldingMode, Taken, Tool};
use crate::plan::{Job, StepKind};
use crate::verify::verify;
use crate::voxel::{BitGrid, Connectivity, Frame, flood};

const DIMS: [usize; 3] = [44, 24, 30];

/// A plate, and a target with a mushroom on it: a post and a flat roof far wider than 50° allows.
fn job() -> Job {
    let frame = Frame { pitch: 1.0, dims: DIMS, origin: DVec3::ZERO };
    let plate = |[x, y, z]: [usize; 3]| (1..43).contains(&x) && (1..23).contains(&y) && z < 4;
    let initial = BitGrid::from_fn(DIMS, plate);
    let target = BitGrid::from_fn(DIMS, |[x, y, z]| {
        let post = (18..26).contains(&x) && (8..16).contains(&y);
        let roof = (6..38).contains(&x) && (4..20).contains(&y) && (16..20).contains(&z);
        plate([x, y, z]) || post && z < 20 || roof
    });
    job_of(frame, initial, target, |t| t.taken == Taken::Always)
}

/// A way straight from above.
fn upright(job: &Job) -> Way<'_> {
    Way { direction: Direction::Z, holding: 0, tool: Tool::longest(&job.nozzles).unwrap() }
}

/// What can be laid of what is `left` of a job.
fn layer<'s>(job: &'s Job, left: &'s BitGrid, fixed: &'s [Vec<DVec3>]) -> Layer<'s> {
    Layer { job, state: &job.initial, left, core: left, fixed, closely: false }
}

/// All that is laid straight from above where no supports are to be in one set, and slim ones in
/// another.
fn on_supports(layer: &Layer, avoided: &BitGrid, slim: &BitGrid) -> BitGrid {
    let none = BitGrid::new(DIMS);
    let on = OnSupports { direction: Direction::Z, avoided, slim, ahead: &none };
    lay_on_supports(layer, upright(layer.job), &on).region
}

/// Whether a region can be laid layer by layer from below along z: each voxel carried by the layers
/// under it, and each layer, once laid, one body with the part or the base.
fn is_carried(job: &Job, state: &BitGrid, region: &BitGrid) -> bool {
    let table = CarrierTable::new(Direction::Z, job.rules.overhang_deg);
    let plate = base_layer(&job.frame);
    let mut solid = state.clone();
    (0..DIMS[2]).all(|z| {
        let layer = BitGrid::from_fn(DIMS, |v| v[2] == z && region.get(v));
        let carried = layer.iter_ones().all(|v| plate == Some(z) || table.carries(&solid, v));
        solid.union_with(&layer);
        let roots = BitGrid::from_fn(DIMS, |v| state.get(v) || plate == Some(v[2]));
        carried && layer.is_subset_of(&flood(&solid, &roots, Connectivity::Edge18))
    })
}

#[test]
fn a_roof_is_printed_whole_on_supports_that_reach_down_to_the_part() {
    let job = job();
    let setting = Setting::new(&job);
    let left = job.target.minus(&job.initial);
    let fixed = vec![setting.fixed(0, &job.initial)];
    let layer = layer(&job, &left, &fixed);
    let plain = layer.lay(upright(&job));
    assert!(plain.gain < left.count(), "the roof overhangs");
    let none = BitGrid::new(DIMS);
    let region = on_supports(&layer, &none, &none);
    assert!(left.is_subset_of(&region));
    assert!(is_carried(&job, &job.initial, &region));
    let supports = region.minus(&left);
    assert!(!supports.intersects(&job.target));
    // What the post's flare carries needs none, and the others grow together: fewer than half of
    // columns under the whole roof.
    assert!(supports.count() < 6 * (32 * 16 - 8 * 8), "{}", supports.count());
}

#[test]
fn supports_are_slim_where_they_are_told_to_be() {
    let mut job = job();
    // A grid as fine as a bead is wide.
    job.frame.pitch = 0.5;
    let setting = Setting::new(&job);
    let left = job.target.minus(&job.initial);
    let fixed = vec![setting.fixed(0, &job.initial)];
    let layer = layer(&job, &left, &fixed);
    let (none, all) = (BitGrid::new(DIMS), BitGrid::from_fn(DIMS, |_| true));
    let (wide, slim) = (on_supports(&layer, &none, &none), on_supports(&layer, &none, &all));
    for region in [&wide, &slim] {
        assert!(left.is_subset_of(region) && is_carried(&job, &job.initial, region));
    }
    // Half-way down trunks stand alone: wide ones have a neighbour on every side of their middle.
    let trunks = |region: &BitGrid| {
        let row = BitGrid::from_fn(DIMS, |v| v[2] == 6 && region.minus(&left).get(v));
        let inner = |[x, y, z]: [usize; 3]| {
            [[x - 1, y, z], [x + 1, y, z], [x, y - 1, z], [x, y + 1, z]].iter().all(|n| row.get(*n))
        };
        row.iter_ones().filter(|v| inner(*v)).count()
    };
    assert!(trunks(&wide) > 4 && trunks(&slim) == 0, "{} {}", trunks(&wide), trunks(&slim));
}

#[test]
fn supports_lean_past_what_the_nozzle_does_not_get_at() {
    let mut job = job();
    // A wall as high as the roof is low, close under its edge: the nozzle keeps 2 mm away from it.
    let wall = |[x, y, z]: [usize; 3]| (36..38).contains(&x) && (2..22).contains(&y) && z < 12;
    let with_wall = BitGrid::from_fn(DIMS, |v| job.initial.get(v) || wall(v));
    job.initial = with_wall.clone();
    job.target.union_with(&with_wall);
    let setting = Setting::new(&job);
    let left = job.target.minus(&job.initial);
    let fixed = vec![setting.fixed(0, &job.initial)];
    let layer = layer(&job, &left, &fixed);
    let none = BitGrid::new(DIMS);
    let region = on_supports(&layer, &none, &none);
    assert!(left.is_subset_of(&region), "{} left", left.minus(&region).count());
    assert!(is_carried(&job, &job.initial, &region));
}

#[test]
fn supports_stand_past_what_is_to_be_avoided() {
    let job = job();
    let setting = Setting::new(&job);
    let left = job.target.minus(&job.initial);
    let fixed = vec![setting.fixed(0, &job.initial)];
    let layer = layer(&job, &left, &fixed);
    let none = BitGrid::new(DIMS);
    let before = on_supports(&layer, &none, &none).minus(&left);
    // A slab across the roof's side, in which supports stood; the roof leans over it.
    let avoided = BitGrid::from_fn(DIMS, |[x, _, z]| (8..10).contains(&x) && z >= 4);
    assert!(before.intersects(&avoided));
    let region = on_supports(&layer, &avoided, &none);
    assert!(!region.minus(&left).intersects(&avoided));
    assert!(left.is_subset_of(&region), "{} left", left.minus(&region).count());
    assert!(is_carried(&job, &job.initial, &region));
}

#[test]
fn a_voxel_carried_across_a_corner_is_laid_once_its_neighbour_is() {
    let mut job = job();
    // Two steps of stairs that touch at a corner alone, and a voxel beside the upper one.
    let corner = [20, 10, 5];
    job.initial = BitGrid::from_fn(DIMS, |[_, _, z]| z < 4);
    job.initial.set([19, 9, 4], true);
    let beside = [21, 10, 5];
    job.initial.set([21, 10, 4], true);
    let setting = Setting::new(&job);
    let fixed = vec![setting.fixed(0, &job.initial)];
    let laid = |left: &[[usize; 3]]| {
        let left = BitGrid::from_fn(DIMS, |v| left.contains(&v));
        let layer = layer(&job, &left, &fixed);
        layer.lay(upright(&job)).gain
    };
    assert_eq!(laid(&[beside]), 1);
    assert_eq!(laid(&[corner, beside]), 2);
}

#[test]
fn a_plan_prints_supports_cuts_them_and_verifies() {
    let job = job();
    let ctx = Ctx::quiet();
    let (made, report) = plan(&job, &Options::default(), &ctx).unwrap();
    let verdict = verify(&job, made, &ctx).unwrap();
    assert!(verdict.passed(), "{:?}", verdict.rules);
    let kinds: Vec<StepKind> = verdict.plan.steps.iter().map(|s| s.kind).collect();
    let last_deposit = kinds.iter().rposition(|k| *k == StepKind::Additive);
    let last_cut = kinds.iter().rposition(|k| *k == StepKind::Subtractive);
    assert!(last_cut > last_deposit, "the supports are cut last: {kinds:?}");
    assert!(report.notes.iter().any(|n| n.contains("supports")), "{:?}", report.notes);
}

#[test]
fn what_stands_beside_the_part_begins_on_the_bare_base() {
    let mut job = job();
    job.initial =
        BitGrid::from_fn(DIMS, |[x, y, z]| (1..12).contains(&x) && (1..23).contains(&y) && z < 10);
    job.target = BitGrid::from_fn(DIMS, |[x, y, z]| {
        (1..12).contains(&x) && (1..23).contains(&y) && z < 10
            || (24..40).contains(&x) && (4..20).contains(&y) && z < 12
    });
    let left = job.target.minus(&job.initial);
    for (holding, laid) in [(HoldingMode::Base, left.count()), (HoldingMode::Refixture, 0)] {
        job.rules.holding = holding;
        let setting = Setting::new(&job);
        let fixed = vec![setting.fixed(0, &job.initial)];
        let layer = layer(&job, &left, &fixed);
        // Held anew, it would be a second body.
        assert_eq!(layer.lay(upright(&job)).gain, laid, "{holding:?}");
        let tilted = Direction::new(DVec3::new(0.1, 0.0, 1.0)).unwrap();
        let way = Way { direction: tilted, ..upright(&job) };
        assert_eq!(layer.lay(way).gain, 0, "only from straight above");
    }
}
