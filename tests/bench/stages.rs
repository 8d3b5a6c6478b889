//! Speed of the stages of the main job on shipped fixtures, by criterion: planning, verification,
//! paths, post and program check, each on the result of the one before.
//!
//! `cargo bench --bench stages`. The parts keep their poses and the grid the pitch that the command
//! line takes for them at a fine setting, so that a stage takes long enough to be measured.

use criterion::{Criterion, criterion_group, criterion_main};
use hmplan::base::{Aabb, Ctx};
use hmplan::gcode::{check, post};
use hmplan::machine::{Machine, Taken, Tool, ToolKind};
use hmplan::mesh::{ReadOptions, TriMesh, read};
use hmplan::plan::{Job, Rules};
use hmplan::planner::reman;
use hmplan::toolpath::for_unverified;
use hmplan::verify::verify;
use hmplan::voxel::{Frame, voxelise};
use std::path::Path;

/// A pair that is only cut, and one that is cut and printed on.
const PAIRS: [&str; 2] = ["block_bracket", "cross"];

/// Voxel size, mm.
const PITCH_MM: f64 = 0.5;

/// Empty voxels around both parts, as the command line leaves.
const MARGIN: usize = 1;

fn job(name: &str) -> Job {
    let mesh = |part: &str| -> TriMesh {
        let file = format!("fixtures/{name}_{part}.obj");
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(file);
        read(&path, &ReadOptions::default()).expect("a shipped part").mesh
    };
    let (initial_mesh, target_mesh) = (mesh("initial"), mesh("target"));
    let (a, b) = (initial_mesh.bounds(), target_mesh.bounds());
    let both = Aabb { min: a.min.min(b.min), max: a.max.max(b.max) };
    let frame = Frame::around(both, PITCH_MM, MARGIN).expect("a frame");
    let solid = |mesh| voxelise(mesh, &frame, &Ctx::quiet()).expect("no one cancels");
    let machine = Machine::builtin("generic-5axis").expect("a preset");
    let tools = |kind| -> Vec<Tool> {
        let coarse = machine.tools_of(kind).into_iter().filter(|t| t.taken == Taken::Always);
        coarse.cloned().collect()
    };
    let (cutters, nozzles) = (tools(ToolKind::Subtractive), tools(ToolKind::Additive));
    let rules = Rules::for_pitch(PITCH_MM, nozzles[0].process.layer_mm);
    Job {
        frame,
        initial: solid(&initial_mesh),
        target: solid(&target_mesh),
        initial_mesh,
        target_mesh,
        machine,
        cutters,
        nozzles,
        rules,
    }
}

fn stages(c: &mut Criterion) {
    let ctx = Ctx::quiet();
    for name in PAIRS {
        let job = job(name);
        let planned = || reman::plan(&job, &reman::Options::default(), &ctx).expect("a plan").0;
        let plan = planned();
        let paths = for_unverified(&job, &plan, &ctx).expect("paths");
        let program = post(&job, &plan, &paths, "sha256:0").expect("a program");
        let mut group = c.benchmark_group(name);
        group.sample_size(10);
        group.bench_function("plan", |b| b.iter(planned));
        group.bench_function("verify", |b| {
            b.iter(|| verify(&job, plan.clone(), &ctx).expect("no one cancels").rules.len())
        });
        group.bench_function("paths", |b| {
            b.iter(|| for_unverified(&job, &plan, &ctx).expect("paths").all().len())
        });
        group.bench_function("post", |b| {
            b.iter(|| post(&job, &plan, &paths, "sha256:0").expect("a program").text().len())
        });
        group.bench_function("program check", |b| {
            let of = || check(program.text(), &job, &plan, Some(&paths), &ctx);
            b.iter(|| of().expect("a report").lines)
        });
        group.finish();
    }
}

criterion_group!(all, stages);
criterion_main!(all);
