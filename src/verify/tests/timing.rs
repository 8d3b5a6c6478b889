//! How long a verification of the usual size takes; run by hand, judged by nobody's clock:
//! `cargo test --release --lib verify::tests::timing -- --ignored --nocapture`.

use super::world::{add, case, cut, cylinder, section};
use crate::base::{Ctx, DVec3, Direction};
use crate::machine::{Process, Shape, Tool, ToolKind};
use crate::verify::verify;
use crate::voxel::{BitGrid, Frame};

const N: usize = 200;
const PITCH: f64 = 0.5;

fn grid(f: impl Fn([usize; 3]) -> bool + Sync) -> BitGrid {
    BitGrid::from_fn([N; 3], f)
}

fn long_cutter() -> Tool {
    Tool {
        name: "cutter".into(),
        kind: ToolKind::Subtractive,
        sections: vec![
            section(Shape::Ball { radius: 3.0 }, true),
            section(cylinder(3.0, 60.0, 3.0), true),
            section(cylinder(60.0, 120.0, 16.0), false),
            section(cylinder(120.0, 200.0, 40.0), false),
        ],
        process: Process::default(),
        fine_grids_only: false,
    }
}

fn long_nozzle() -> Tool {
    Tool {
        name: "nozzle".into(),
        kind: ToolKind::Additive,
        sections: vec![
            section(cylinder(0.0, 5.0, 2.0), true),
            section(cylinder(5.0, 30.0, 4.5), false),
            section(Shape::Platform { z: 30.0 }, false),
        ],
        process: Process::default(),
        fine_grids_only: false,
    }
}

#[test]
#[ignore = "a measurement"]
fn seconds_a_step() {
    let block = grid(|[x, y, z]| (20..180).contains(&x) && (20..180).contains(&y) && z < 150);
    let pockets = grid(|[x, y, z]| {
        let in_pocket = |c: usize| (26..174).contains(&c) && (c - 26) % 50 < 44;
        in_pocket(x) && in_pocket(y) && (70..150).contains(&z)
    });
    let side = grid(|[x, y, z]| {
        (150..180).contains(&x) && (20..180).contains(&y) && (20..150).contains(&z)
    });
    let dome = grid(|[x, y, z]| {
        let r2 = (x as f64 - 100.0).powi(2) + (y as f64 - 100.0).powi(2);
        (70..150).contains(&z) && r2 < (85.0 - 0.5 * (z as f64 - 70.0)).powi(2)
    });
    let tilted = Direction::new(DVec3::new(0.2, 0.13, 1.0)).unwrap();
    let directions = [Direction::Z, tilted, Direction::X];
    let ctx = Ctx::quiet();
    let report = |name: &str, initial: &BitGrid, step| {
        let (mut job, plan) = case(BitGrid::new(super::world::DIMS), vec![step]);
        let region = &plan.steps[0].region;
        job.target = match plan.steps[0].kind {
            crate::plan::StepKind::Subtractive => initial.minus(region),
            crate::plan::StepKind::Additive => initial.or(region),
        };
        job.frame = Frame { pitch: PITCH, dims: [N; 3], origin: DVec3::ZERO };
        job.initial = initial.clone();
        (job.cutters, job.nozzles) = (vec![long_cutter()], vec![long_nozzle()]);
        job.machine.workholding.pedestal_mm = 60.0;
        job.rules = crate::plan::Rules::for_pitch(PITCH, PITCH);
        let voxels = region.count();
        let start = std::time::Instant::now();
        let v = verify(&job, plan, &ctx).unwrap();
        println!("{name:<28} {voxels:>8} voxels {:>6.2} s", start.elapsed().as_secs_f64());
        v.lines().iter().filter(|l| l.contains("FAILED")).for_each(|l| println!("    {l}"));
    };
    for d in directions {
        let v = d.vec();
        let name = |what: &str| format!("{what} ({:.2}, {:.2}, {:.2})", v.x, v.y, v.z);
        report(&name("cut pockets"), &block, cut(d, pockets.and(&block)));
        report(&name("cut side"), &block, cut(d, side.and(&block)));
        let foot = grid(|[x, y, z]| z < 70 && (20..180).contains(&x) && (20..180).contains(&y));
        report(&name("add dome"), &foot, add(d, dome.clone()));
        let walled = block.minus(&pockets);
        report(&name("add into pockets"), &walled, add(d, pockets.clone()));
    }
}
