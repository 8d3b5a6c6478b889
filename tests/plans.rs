//! Whole plans through the library: what the planner makes of the shipped pairs and of small
//! worlds, judged by the verifier alone.

use hmplan::base::{Aabb, Ctx, DVec3};
use hmplan::machine::{HoldingMode, Machine, Tool, ToolKind};
use hmplan::mesh::{ReadOptions, TriMesh, read};
use hmplan::plan::{Job, Plan, Rules, StepKind};
use hmplan::planner::reman::{self, Report};
use hmplan::verify::{Verdict, verify};
use hmplan::voxel::{BitGrid, Connectivity, Frame, flood, voxelise};
use proptest::prelude::*;
use std::path::Path;

/// Coarse enough for a debug build; fine enough that no feature of the pairs is lost.
const PITCH: f64 = 0.8;

fn job(initial: TriMesh, target: TriMesh, pitch: f64, holding: HoldingMode) -> Job {
    let bounds = initial.bounds().union(target.bounds());
    let frame = Frame::around(bounds, pitch, 1).unwrap();
    let solid = |m: &TriMesh| voxelise(m, &frame, &Ctx::quiet()).unwrap();
    let (a, b) = (solid(&initial), solid(&target));
    with_solids(frame, [a, b], [initial, target], holding)
}

fn with_solids(
    frame: Frame,
    [initial, target]: [BitGrid; 2],
    [initial_mesh, target_mesh]: [TriMesh; 2],
    holding: HoldingMode,
) -> Job {
    let machine = Machine::builtin("generic-5axis").unwrap();
    let tools = |kind| machine.tools_of(kind).into_iter().cloned().collect::<Vec<Tool>>();
    let (cutters, nozzles) = (tools(ToolKind::Subtractive), tools(ToolKind::Additive));
    let rules = Rules { holding, ..Rules::for_pitch(frame.pitch, 0.2) };
    Job { frame, initial, target, initial_mesh, target_mesh, machine, cutters, nozzles, rules }
}

fn planned(job: &Job) -> (Verdict, Report) {
    planned_in(job, 1)
}

fn planned_in(job: &Job, rounds: usize) -> (Verdict, Report) {
    let options = reman::Options { rounds, ..reman::Options::default() };
    let (plan, report) = reman::plan(job, &options, &Ctx::quiet()).unwrap();
    (verify(job, plan, &Ctx::quiet()).unwrap(), report)
}

fn pair(name: &str) -> [TriMesh; 2] {
    ["initial", "target"].map(|part| {
        let file = format!("{}/fixtures/{name}_{part}.obj", env!("CARGO_MANIFEST_DIR"));
        read(Path::new(&file), &ReadOptions::default()).unwrap().mesh
    })
}

#[test]
fn every_shipped_pair_is_planned_and_verified() {
    for name in ["bearing", "blade", "block_bracket", "cross", "flange", "impeller"] {
        let [initial, target] = pair(name);
        let job = job(initial, target, PITCH, HoldingMode::Base);
        let (verdict, _) = planned(&job);
        assert!(verdict.passed(), "{name}: {:?}", verdict.lines());
        assert!(!verdict.plan.steps.is_empty(), "{name}");
    }
}

#[test]
fn the_same_part_needs_no_step() {
    let [initial, target] = pair("same");
    let (verdict, report) = planned(&job(initial, target, PITCH, HoldingMode::Base));
    assert!(verdict.passed());
    assert!(verdict.plan.steps.is_empty());
    assert_eq!(report.reuse_initial, 1.0);
}

/// The pocket of [`pocket_below`], mm.
const RADIUS: f64 = 8.0;
const DEPTH: f64 = 8.0;

/// A block of 40 × 30 × 20 mm, and the same with a round pocket that goes up from its base.
fn pocket_below() -> (Frame, [BitGrid; 2], [TriMesh; 2]) {
    let size = DVec3::new(40.0, 30.0, 20.0);
    let block = TriMesh::cuboid(DVec3::ZERO, size);
    let frame = Frame::around(Aabb { min: DVec3::ZERO, max: size }, 0.5, 1).unwrap();
    let solid = voxelise(&block, &frame, &Ctx::quiet()).unwrap();
    let hollow = BitGrid::from_fn(frame.dims, |v| {
        let p = frame.center(v);
        let pocket = (p.x - 20.0).hypot(p.y - 15.0) < RADIUS && p.z < DEPTH;
        solid.get(v) && !pocket
    });
    (frame, [solid, hollow], [block.clone(), block])
}

#[test]
fn a_pocket_open_only_below_is_residual_in_one_holding_and_named() {
    let (frame, solids, meshes) = pocket_below();
    let volume = std::f64::consts::PI * RADIUS * RADIUS * DEPTH;
    let (verdict, report) = planned(&with_solids(frame, solids, meshes, HoldingMode::Base));
    assert!(verdict.measures.residual_mm3 > 0.8 * volume, "{}", verdict.measures.residual_mm3);
    assert!(
        report.notes.iter().any(|n| n.contains("pockets that are open only below")),
        "{:?}",
        report.notes
    );
    // Nothing is given up for what only another holding mends.
    assert_eq!(report.planes_global, 0);
}

#[test]
fn turned_over_the_same_pocket_is_cut() {
    let (frame, solids, meshes) = pocket_below();
    let (verdict, report) = planned(&with_solids(frame, solids, meshes, HoldingMode::Refixture));
    assert!(verdict.passed(), "{:?}", verdict.lines());
    assert!(verdict.plan.steps.iter().all(|s| s.kind == StepKind::Subtractive));
    assert!(!report.notes.iter().any(|n| n.contains("open only below")), "{:?}", report.notes);
    assert_eq!(verdict.measures.residual_mm3, 0.0);
}

#[test]
fn turned_over_a_part_stands_on_the_top_it_then_has() {
    let (frame, [block, hollow], meshes) = pocket_below();
    // The target ends 4 mm below the top of the initial part.
    let low = BitGrid::from_fn(frame.dims, |v| hollow.get(v) && frame.center(v).z < 16.0);
    let (verdict, _) = planned(&with_solids(frame, [block, low], meshes, HoldingMode::Refixture));
    assert!(verdict.passed(), "{:?}", verdict.lines());
    assert_eq!(verdict.plan.holdings.len(), 2);
    assert!((verdict.plan.holdings[1].height_mm + 16.0).abs() < 1e-9);
}

/// A foot with boxes on and over it, of 1 mm voxels: corners and sizes within `ROOM`.
fn blocks() -> impl Strategy<Value = Vec<([usize; 3], [usize; 3])>> {
    let corner = (1..ROOM[0] - 6, 1..ROOM[1] - 6, 2..ROOM[2] - 5);
    let size = (3..14usize, 3..14usize, 3..12usize);
    prop::collection::vec((corner, size), 1..5).prop_map(|boxes| {
        let foot = ([8, 6, 1], [12, 10, 3]);
        let array = |(x, y, z)| [x, y, z];
        let boxes = boxes.into_iter().map(|(c, s)| (array(c), array(s)));
        std::iter::once(foot).chain(boxes).collect()
    })
}

const ROOM: [usize; 3] = [30, 24, 22];

fn solid_of(boxes: &[([usize; 3], [usize; 3])]) -> BitGrid {
    BitGrid::from_fn(ROOM, |v| {
        let within = |(lo, size): &([usize; 3], [usize; 3])| {
            (0..3).all(|a| (lo[a]..lo[a] + size[a]).contains(&v[a]) && v[a] + 1 < ROOM[a])
        };
        boxes.iter().any(within)
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 12, ..ProptestConfig::default() })]

    /// A plan may leave a residual; it may not break any other rule, whatever the parts are.
    /// Among them: cuts that would free what they do not reach. Further rounds of cuts and deposits
    /// leave no more, and count as reused only what no round took.
    #[test]
    fn no_plan_breaks_a_rule_but_the_end(initial in blocks(), target in blocks(), turn in any::<bool>()) {
        let frame = Frame { pitch: 1.0, dims: ROOM, origin: DVec3::new(-15.0, -12.0, -1.0) };
        let holding = if turn { HoldingMode::Refixture } else { HoldingMode::Base };
        let mesh = TriMesh::cuboid(DVec3::new(-14.0, -11.0, 0.0), DVec3::new(14.0, 11.0, 20.0));
        let solids = [&initial, &target].map(|b| largest(&solid_of(b)));
        let job = with_solids(frame, solids, [mesh.clone(), mesh], holding);
        let (verdict, _) = planned(&job);
        let failed = verdict.failed_rules();
        prop_assert!(failed.iter().all(|r| *r == "end"), "{:?}", verdict.lines());
        let (again, _) = planned_in(&job, 3);
        let failed = again.failed_rules();
        prop_assert!(failed.iter().all(|r| *r == "end"), "{:?}", again.lines());
        let (one, three) = (&verdict.measures, &again.measures);
        prop_assert!(three.residual_mm3 <= one.residual_mm3 && three.reused_mm3 <= one.reused_mm3);
        if one.residual_mm3 == 0.0 {
            prop_assert_eq!(&verdict.plan, &again.plan);
        }
    }
}

/// The body that stands on the foot.
fn largest(solid: &BitGrid) -> BitGrid {
    let foot = BitGrid::from_fn(ROOM, |v| v[2] == 1);
    flood(solid, &foot, Connectivity::Face6)
}

#[test]
fn one_thread_plans_as_two_do() {
    let plan_on = |threads: usize| -> Plan {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let [initial, target] = pair("bearing");
        pool.install(|| {
            let job = job(initial, target, 1.2, HoldingMode::Base);
            reman::plan(&job, &reman::Options::default(), &Ctx::quiet()).unwrap().0
        })
    };
    assert_eq!(plan_on(1), plan_on(2));
}
