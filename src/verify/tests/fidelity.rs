//! The verifier and the plain reading agree on random small worlds, and on valid plans with one
//! voxel changed.

use super::reference::{Finding, findings};
use super::world::{add, cut, cylinder, machine, section};
use crate::base::{Ctx, DVec3, Direction};
use crate::machine::Process;
use crate::machine::{
    BaseKind, Holding, HoldingMode, Place, Shape, Table, Taken, Tool, ToolKind, Workholding,
};
use crate::mesh::TriMesh;
use crate::plan::{Job, Plan, Rules, Step};
use crate::verify::{Rule, verify};
use crate::voxel::{BitGrid, Frame};
use proptest::prelude::*;

/// What the verifier finds, in the reference's terms.
fn found(job: &Job, plan: &Plan) -> Vec<Finding> {
    let verdict = verify(job, plan.clone(), &Ctx::quiet()).unwrap();
    let voxel = job.frame.voxel_volume();
    let count = |r: &crate::verify::RuleResult| match r.rule {
        Rule::End => (verdict.measures.residual_mm3 / voxel).round() as usize,
        _ => r.figure as usize,
    };
    verdict.rules.iter().filter(|r| !r.passed).map(|r| (r.rule, r.step, count(r))).collect()
}

/// Findings in one order.
fn sorted(mut f: Vec<Finding>) -> Vec<Finding> {
    f.sort_by_key(|(rule, step, _)| (step.is_none(), *step, *rule));
    f
}

#[track_caller]
fn agree(job: &Job, plan: &Plan) -> Result<(), TestCaseError> {
    prop_assert_eq!(sorted(found(job, plan)), sorted(findings(job, plan)));
    Ok(())
}

/// Radii on and off multiples of the pitch, since centres on an edge are where rounding bites.
fn radius() -> impl Strategy<Value = f64> {
    prop_oneof![prop::sample::select(vec![0.35, 0.5, 0.7, 1.0, 1.4, 1.5, 2.1]), 0.2f64..2.5]
}

fn tool(kind: ToolKind) -> impl Strategy<Value = Tool> {
    (0..4, radius(), 0.5f64..4.0, radius(), 0..3, any::<bool>()).prop_map(
        move |(tip, r, length, wide, upper, bead)| {
            let edge = match tip {
                0 => Shape::Ball { radius: r },
                1 => Shape::BullNose { radius: r, corner: 0.4 * r },
                2 => Shape::Frustum { z0: 0.0, r0: 0.3 * r, z1: length, r1: r },
                _ => cylinder(0.0, length, r),
            };
            let active = kind == ToolKind::Subtractive;
            let mut sections = vec![
                section(edge, active || bead),
                section(cylinder(edge.top(), edge.top() + length, r), active),
            ];
            let top = edge.top() + length;
            if upper > 0 {
                sections.push(section(cylinder(top, top + 3.0, r + wide), false));
            }
            if upper > 1 {
                sections.push(section(Shape::Platform { z: top + 2.0 }, false));
            }
            let name = if active { "cutter" } else { "nozzle" };
            Tool {
                name: name.into(),
                kind,
                sections,
                process: Process::default(),
                taken: Taken::Always,
            }
        },
    )
}

fn direction() -> impl Strategy<Value = Direction> {
    let axes = [
        Direction::X,
        Direction::NEG_X,
        Direction::Y,
        Direction::NEG_Y,
        Direction::Z,
        Direction::NEG_Z,
    ];
    let c = || -1.0f64..1.0;
    let diagonals: Vec<Direction> = [[1.0, 1.0, 1.0], [1.0, 0.0, 1.0], [0.0, -1.0, 1.0]]
        .into_iter()
        .map(|v| Direction::new(DVec3::from_array(v)).unwrap())
        .collect();
    prop_oneof![
        prop::sample::select(axes.to_vec()),
        prop::sample::select(diagonals),
        (c(), c(), c())
            .prop_filter_map("zero", |(x, y, z)| Direction::new(DVec3::new(x, y, z)).ok()),
    ]
}

/// Boxes, spheres and noise: shapes that are sometimes reachable.
fn solid(dims: [usize; 3]) -> impl Strategy<Value = BitGrid> {
    let corner = || dims.map(|n| 0..n).prop_map(|c| c);
    let cuboid = (corner(), corner()).prop_map(move |(a, b)| {
        BitGrid::from_fn(dims, |v| {
            (0..3).all(|i| (a[i].min(b[i])..=a[i].max(b[i])).contains(&v[i]))
        })
    });
    let noise = proptest::collection::vec(any::<bool>(), dims.iter().product::<usize>());
    let noise = noise.prop_map(move |bits| {
        BitGrid::from_fn(dims, |[x, y, z]| bits[x + dims[0] * (y + dims[1] * z)])
    });
    prop_oneof![4 => cuboid, 1 => noise]
}

#[derive(Clone, Debug)]
struct Figures {
    pitch: f64,
    pedestal: f64,
    holding: HoldingMode,
    base: BaseKind,
    overhang: f64,
    dip: f64,
    tau: f64,
    tilt: f64,
}

fn figures() -> impl Strategy<Value = Figures> {
    (
        prop::sample::select(vec![0.5, 0.7, 1.0]),
        prop::sample::select(vec![1.0, 3.0]),
        any::<bool>(),
        any::<bool>(),
        prop::sample::select(vec![30.0, 45.0, 50.0, 60.0]),
        prop::sample::select(vec![0.0, 0.3, 1.0]),
        prop::sample::select(vec![0.0, 1.0, 2.5]),
        prop::sample::select(vec![90.0, 180.0]),
    )
        .prop_map(|(pitch, pedestal, base, refixture, overhang, dip, tau, tilt)| Figures {
            pitch,
            pedestal,
            holding: if refixture { HoldingMode::Refixture } else { HoldingMode::Base },
            base: if base { BaseKind::Pedestal } else { BaseKind::None },
            overhang,
            dip,
            tau,
            tilt,
        })
}

fn job(f: &Figures, [initial, target]: [BitGrid; 2], cutter: Tool, nozzle: Tool) -> Job {
    let frame = Frame { pitch: f.pitch, dims: initial.dims(), origin: DVec3::new(-1.3, 0.4, 0.0) };
    let hold = Workholding {
        pedestal_mm: f.pedestal,
        table: Table::Box { x_mm: 8.0, y_mm: 5.0 },
        place: Place::default(),
    };
    let machine = machine(hold, f.tilt);
    let mut rules = Rules::for_pitch(f.pitch, f.pitch);
    (rules.holding, rules.base) = (f.holding, f.base);
    (rules.overhang_deg, rules.nozzle_dip_mm) = (f.overhang, f.dip);
    (rules.tolerance_mm, rules.grip_mm) = (f.tau, 1.5 * f.pitch);
    let nothing = || TriMesh::new(Vec::new(), Vec::new()).unwrap();
    Job {
        frame,
        initial,
        target,
        initial_mesh: nothing(),
        target_mesh: nothing(),
        machine,
        cutters: vec![cutter],
        nozzles: vec![nozzle],
        rules,
    }
}

fn world() -> impl Strategy<Value = (Job, Plan)> {
    let small = prop_oneof![
        4 => [1usize..8, 1usize..8, 1usize..8],
        1 => [63usize..68, 1usize..3, 2usize..4],
    ];
    small.prop_flat_map(|dims| {
        let step = (any::<bool>(), direction(), solid(dims), any::<bool>());
        (
            figures(),
            [solid(dims), solid(dims)],
            (tool(ToolKind::Subtractive), tool(ToolKind::Additive)),
            proptest::collection::vec(step, 1..4),
            any::<bool>(),
        )
            .prop_map(|(f, solids, (cutter, nozzle), steps, sloppy)| {
                let mut job = job(&f, solids, cutter, nozzle);
                let (mut state, mut plan) =
                    (job.initial.clone(), Plan { holdings: vec![], steps: vec![] });
                let flipped = Holding { up: Direction::NEG_Z, height_mm: -3.0 * f.pitch };
                plan.holdings = vec![Holding::AS_CLAMPED, flipped];
                for (is_cut, d, region, flip) in steps {
                    // Regions that fit the state, so that rules beyond the first are broken alone.
                    let mut s: Step = match is_cut {
                        true if !sloppy => cut(d, region.and(&state)),
                        true => cut(d, region),
                        false if !sloppy => add(d, region.minus(&state)),
                        false => add(d, region),
                    };
                    s.holding = flip as usize;
                    if is_cut {
                        state.subtract(&s.region)
                    } else {
                        state.union_with(&s.region)
                    }
                    plan.steps.push(s);
                }
                if !sloppy {
                    job.target = state;
                }
                // The reference has no word for a part held by nothing.
                let held = |job: &Job, plan: &Plan| {
                    let v = verify(job, plan.clone(), &Ctx::quiet()).unwrap();
                    !v.rules.iter().any(|r| r.detail.contains("grip height"))
                };
                if !held(&job, &plan) {
                    job.rules.base = BaseKind::None;
                }
                (job, plan)
            })
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(160))]

    #[test]
    fn random_worlds_are_judged_as_the_page_reads((job, plan) in world()) {
        agree(&job, &plan)?;
    }
}

/// Milled and built up along oblique and straight directions; passes every rule.
fn valid() -> (Job, Plan) {
    let dims = [12, 10, 12];
    let block = |lo: [usize; 3], hi: [usize; 3]| {
        BitGrid::from_fn(dims, |v| (0..3).all(|a| lo[a] <= v[a] && v[a] < hi[a]))
    };
    let part = block([2, 2, 0], [9, 8, 6]);
    let pocket = block([3, 3, 4], [7, 7, 6]);
    let tower = block([3, 3, 4], [6, 6, 8]);
    let side = block([8, 2, 2], [9, 8, 6]);
    let tilted = Direction::new(DVec3::new(0.3, 0.1, 1.0)).unwrap();
    let steps = vec![cut(tilted, pocket), cut(Direction::X, side), add(Direction::Z, tower)];
    let mut target = part.clone();
    target.subtract(&steps[0].region);
    target.subtract(&steps[1].region);
    target.union_with(&steps[2].region);
    let mut cutter = super::world::cutter();
    cutter.sections[0].shape = cylinder(0.0, 10.0, 0.6);
    let f = Figures {
        pitch: 1.0,
        pedestal: 12.0,
        holding: HoldingMode::Base,
        base: BaseKind::Pedestal,
        overhang: 50.0,
        dip: 1.0,
        tau: 0.0,
        tilt: 90.0,
    };
    let mut job = job(&f, [part, target], cutter, super::world::nozzle(0.4, 3.0));
    job.rules.deviation = 0.0;
    (job, Plan { holdings: vec![Holding::AS_CLAMPED], steps })
}

#[test]
fn the_plan_that_is_mutated_is_valid() {
    let (job, plan) = valid();
    assert_eq!(found(&job, &plan), []);
    assert_eq!(findings(&job, &plan), []);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    #[test]
    fn one_changed_voxel_is_judged_as_the_page_reads(
        step in 0usize..3,
        at in [0usize..12, 0usize..10, 0usize..12],
        near in any::<prop::sample::Index>(),
        nudge in [-1i64..=1, -1i64..=1, -1i64..=1],
        anywhere in prop::bool::weighted(0.2),
    ) {
        let (job, mut plan) = valid();
        let region = &mut plan.steps[step].region;
        let ones: Vec<[usize; 3]> = region.iter_ones().collect();
        let close = *near.get(&ones);
        let dims = region.dims();
        let v = match anywhere {
            true => at,
            false => std::array::from_fn(|a| (close[a] as i64 + nudge[a]).clamp(0, dims[a] as i64 - 1) as usize),
        };
        let was = region.get(v);
        region.set(v, !was);
        agree(&job, &plan)?;
        prop_assert!(!found(&job, &plan).is_empty(), "a plan that must not deviate passed at {v:?}");
    }
}

#[test]
fn the_verdict_is_the_same_at_any_thread_count() {
    let (job, mut plan) = valid();
    plan.steps[0].region.set([5, 5, 2], true);
    plan.steps[1].region.set([4, 4, 3], true);
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| verify(&job, plan.clone(), &Ctx::quiet()).unwrap())
    };
    let (one, four) = (with(1), with(4));
    assert_eq!(one.rules, four.rules);
    assert_eq!(one.lines(), four.lines());
    assert!(!one.passed());
}
