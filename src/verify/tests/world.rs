//! Small jobs and plans.

use crate::base::{Ctx, DVec3, Direction};
use crate::machine::{
    BaseKind, Chain, Control, Holding, Linear, Machine, Mount, Place, Process, Rotary, Section,
    Shape, Table, Taken, Tool, ToolKind, Workholding,
};
use crate::mesh::TriMesh;
use crate::plan::{Job, Origin, Plan, Rules, Step, StepKind};
use crate::verify::{Verdict, verify};
use crate::voxel::{BitGrid, Frame};

pub const DIMS: [usize; 3] = [16, 14, 18];

/// Voxels with lo ≤ (x, y, z) < hi.
pub fn cuboid(lo: [usize; 3], hi: [usize; 3]) -> BitGrid {
    BitGrid::from_fn(DIMS, |v| (0..3).all(|a| lo[a] <= v[a] && v[a] < hi[a]))
}

pub fn voxels(of: &[[usize; 3]]) -> BitGrid {
    let mut g = BitGrid::new(DIMS);
    of.iter().for_each(|v| g.set(*v, true));
    g
}

pub fn section(shape: Shape, active: bool) -> Section {
    Section { shape, active }
}

pub fn cylinder(z0: f64, z1: f64, r: f64) -> Shape {
    Shape::Frustum { z0, r0: r, z1, r1: r }
}

/// Flat end Ø 2 mm, 10 mm long; holder Ø 8 mm.
pub fn cutter() -> Tool {
    Tool {
        name: "cutter".into(),
        kind: ToolKind::Subtractive,
        sections: vec![
            section(cylinder(0.0, 10.0, 1.0), true),
            section(cylinder(10.0, 20.0, 4.0), false),
        ],
        process: Process::default(),
        taken: Taken::Always,
    }
}

/// Tip of this radius up to `body_z`, body Ø 6 mm, a head without end 10 mm above the tip.
pub fn nozzle(tip_radius: f64, body_z: f64) -> Tool {
    Tool {
        name: "nozzle".into(),
        kind: ToolKind::Additive,
        sections: vec![
            section(cylinder(0.0, body_z, tip_radius), true),
            section(cylinder(body_z, 10.0, 3.0), false),
            section(Shape::Platform { z: 10.0 }, false),
        ],
        process: Process::default(),
        taken: Taken::Always,
    }
}

/// A tilting rotary table without end in C, of this tilt, and ± 10 m of travel.
pub fn machine(workholding: Workholding, tilt_deg: f64) -> Machine {
    let linear =
        Linear { limits_mm: [-1e4, 1e4], home_mm: 0.0, on: Mount::Head, axis: None, carried_by: 0 };
    let rotary = |letter, axis, limits_deg| Rotary {
        letter,
        on: Mount::Table,
        axis,
        pivot_mm: [0.0; 3],
        limits_deg,
        home_deg: 0.0,
        rapid_deg_min: 3600.0,
    };
    Machine {
        name: "test".into(),
        description: String::new(),
        workholding,
        kinematics: Chain {
            table_center_mm: [0.0; 3],
            x: linear,
            y: linear,
            z: linear,
            first: rotary('A', Direction::NEG_X, Some([-tilt_deg, tilt_deg])),
            second: rotary('C', Direction::NEG_Z, None),
        },
        control: Control {
            dialect: "test".into(),
            clearance_mm: 20.0,
            rapid_mm_min: 1e4,
            max_feed_mm_min: 1e4,
            max_spindle_rpm: 1e4,
            acceleration_mm_s2: 500.0,
            acceleration_deg_s2: 360.0,
            tool_change_s: 15.0,
            post: Default::default(),
        },
        extruder: None,
        tools: Vec::new(),
    }
}

pub fn step(kind: StepKind, direction: Direction, region: BitGrid) -> Step {
    let tool = match kind {
        StepKind::Subtractive => "cutter",
        StepKind::Additive => "nozzle",
    };
    Step {
        kind,
        tool: tool.into(),
        direction,
        holding: 0,
        region,
        block: 0,
        origin: Origin::default(),
    }
}

pub fn cut(direction: Direction, region: BitGrid) -> Step {
    step(StepKind::Subtractive, direction, region)
}

pub fn add(direction: Direction, region: BitGrid) -> Step {
    step(StepKind::Additive, direction, region)
}

/// A job whose target is what the steps leave, pitch 1 mm, on a pedestal 30 mm over its table.
pub fn case(initial: BitGrid, steps: Vec<Step>) -> (Job, Plan) {
    let mut target = initial.clone();
    for s in steps.iter().filter(|s| s.region.dims() == DIMS) {
        match s.kind {
            StepKind::Subtractive => target.subtract(&s.region),
            StepKind::Additive => target.union_with(&s.region),
        }
    }
    let frame = Frame { pitch: 1.0, dims: DIMS, origin: DVec3::ZERO };
    let hold = Workholding {
        pedestal_mm: 30.0,
        table: Table::Disc { radius_mm: 20.0 },
        place: Place::default(),
    };
    let nothing = || TriMesh::new(Vec::new(), Vec::new()).unwrap();
    let job = Job {
        frame,
        initial,
        target,
        initial_mesh: nothing(),
        target_mesh: nothing(),
        machine: machine(hold, 90.0),
        cutters: vec![cutter()],
        nozzles: vec![nozzle(0.4, 3.0)],
        rules: Rules::for_pitch(1.0, 1.0),
    };
    (job, Plan { holdings: vec![Holding::AS_CLAMPED], steps })
}

pub fn without_base((mut job, plan): (Job, Plan)) -> (Job, Plan) {
    job.rules.base = BaseKind::None;
    (job, plan)
}

pub fn judge((job, plan): &(Job, Plan)) -> Verdict {
    let verdict = verify(job, plan.clone(), &Ctx::quiet()).unwrap();
    assert_eq!(verdict.passed(), verdict.failed_rules().is_empty());
    assert_eq!(verdict.lines().len(), 6);
    for r in &verdict.rules {
        assert_eq!(r.passed, r.detail.is_empty(), "{r:?}");
    }
    verdict
}

#[track_caller]
pub fn assert_valid(case: &(Job, Plan)) {
    let v = judge(case);
    assert!(v.passed(), "{}", v.lines().join("\n"));
    assert!(v.into_verified().is_ok());
}

#[track_caller]
pub fn assert_fails(case: &(Job, Plan), rules: &[&str]) -> Verdict {
    let v = judge(case);
    assert_eq!(v.failed_rules(), rules, "{}", v.lines().join("\n"));
    *v.into_verified().unwrap_err()
}
