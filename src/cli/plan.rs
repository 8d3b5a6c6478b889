//! `hmplan plan`: read, place, voxelise, plan, judge, post, write.

use super::args::{OutputArgs, Setup};
use super::config::PlanConfig;
use super::exit::{Exit, Failure};
use super::inputs::{self, Grids, Part};
use super::output::{self, Destination};
use super::pipeline;
use super::{progress, summary};
use hmplan::base::{Ctx, DAffine3, DVec3};
use hmplan::machine::{Holding, Taken, Tool};
use hmplan::mesh::TriMesh;
use hmplan::plan::{
    Inputs, Job, Plan, PlanFile, ProgramRecord, Rules, SCHEMA, Seconds, StepKind, Summary,
    end_state,
};
use hmplan::planner::reman;
use hmplan::planner::setup::Candidate;
use hmplan::report;
use hmplan::verify::verify;
use hmplan::voxel::{BitGrid, Skin};
use rayon::prelude::*;
use sha2::{Digest as _, Sha256};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Measured times of the stages.
pub struct Clock {
    start: Instant,
    pub seconds: Seconds,
}

impl Clock {
    pub fn start() -> Clock {
        Clock { start: Instant::now(), seconds: Seconds::default() }
    }

    /// Runs one stage and adds its time.
    pub fn time<R>(&mut self, stage: &'static str, work: impl FnOnce() -> R) -> R {
        let began = Instant::now();
        let result = work();
        self.seconds.add(stage, began.elapsed().as_secs_f64());
        result
    }

    fn total(mut self) -> Seconds {
        self.seconds.add("total", self.start.elapsed().as_secs_f64());
        self.seconds
    }
}

pub fn run(config: &PlanConfig, output: &OutputArgs) -> Result<Exit, Failure> {
    let mut clock = Clock::start();
    let destination = Destination::claim(&config.output)?;
    let ctx = context(output, config.time_limit_s, config.seed)?;
    let mut parts = load(config, &mut clock)?;
    let places = places(&mut parts, config, &ctx, &mut clock)?;
    let Made { prepared, planned, notes } = best_of(&mut parts, &places, config, &ctx, &mut clock)?;
    let Prepared { job, inputs } = prepared;
    let pipeline::Planned { plan, mut figures, schedule, trace, .. } = planned;
    figures.notes.splice(0..0, notes);
    figures.notes.extend(inputs::below_base(&job));
    let verdict = clock.time("verify", || verify(&job, plan, &ctx))?;
    let posts = config.nullify.is_none() && (verdict.passed() || config.post_unverified);
    if config.nullify.is_some() {
        figures.notes.push(
            "No program was written: the tools of planner nullify are half-spaces, no machine's."
                .into(),
        );
    } else if !posts {
        figures.notes.push("No program was written, since the plan does not verify.".into());
    }
    let draft = destination.begin()?;
    let aside = ctx.without_progress();
    let states = || write_states(&draft, &job, &verdict.plan, &aside);
    let (posted, states) = match posts {
        true => clock.time("toolpaths", || {
            pipeline::post(&job, &verdict, config.post_unverified, states, &ctx)
        })?,
        false => (pipeline::Posted::default(), states()),
    };
    states?;

    let plan = &verdict.plan;
    let deviation = match &posted.text {
        Some(text) if config.deviation_map => {
            clock.time("verify", || pipeline::deviation(&job, plan, text, &ctx))?
        }
        _ => None,
    };
    figures.notes.extend(deviation.as_ref().map(pipeline::deviation_note));
    let mut rules = report::rule_lines(&verdict);
    rules.extend(posted.rules);
    let mut summary = report::summarise(&job, &verdict, figures, clock.total());
    summary.take_rules(rules.iter().map(|r| (r.rule.as_str(), r.passed)));
    summary.peak_memory_mib = peak_memory_mib();
    let file = PlanFile {
        schema: SCHEMA.into(),
        hmplan_version: env!("CARGO_PKG_VERSION").into(),
        seed: config.seed,
        command: config.command(),
        inputs,
        grid: job.frame,
        machine: job.machine.clone(),
        tools: job.cutters.iter().chain(&job.nozzles).cloned().collect(),
        rules: job.rules,
        holdings: plan.holdings.clone(),
        steps: PlanFile::step_records(plan, &job.frame, &posted.step_seconds),
        program: posted.text.as_ref().map(|text| ProgramRecord {
            path: output::PROGRAM.into(),
            sha256: digest(text.as_bytes()),
            lines: text.lines().count(),
            time_s: posted.step_seconds.iter().sum(),
            deposited_mm3: posted.deposited_mm3,
            removed_mm3: posted.removed_mm3,
        }),
        summary,
    };

    ctx.check()?;
    let report = || -> Result<(), Failure> {
        let page = report::page(&file, &job, plan, &rules)
            .map_err(|e| Failure::Io(format!("the report cannot be made ({e:#})")))?;
        draft.write(output::REPORT, |out| out.write_all(page.as_bytes()))
    };
    let program = || match &posted.text {
        Some(text) => draft.write(output::PROGRAM, |out| out.write_all(text.as_bytes())),
        None => Ok(()),
    };
    let (report, program) = rayon::join(report, program);
    report.and(program)?;
    if let Some(map) = &deviation {
        draft.write(output::DEVIATION, |out| map.write_ply(out))?;
    }
    if config.program_steps {
        for (i, (text, step)) in posted.steps.iter().zip(&plan.steps).enumerate() {
            let kind = match step.kind {
                StepKind::Subtractive => "subtractive",
                StepKind::Additive => "additive",
            };
            let name = format!("{}/{:02}-{kind}.gcode", output::PROGRAMS, i + 1);
            draft.write(&name, |out| out.write_all(text.as_bytes()))?;
        }
    }
    draft.write(output::PLAN, |out| out.write_all(&file.to_json()))?;
    ctx.check()?;
    draft.publish()?;
    if let (Some(schedule), Some(path)) = (&schedule, &config.schedule) {
        write_beside(path, |out| schedule.write(out))?;
    }
    if let (Some(trace), Some(path)) = (&trace, &config.trace) {
        write_beside(path, |out| out.write_all(trace.as_bytes()))?;
    }
    let location = report::residual_location(&job, &verdict);
    summary::show(&file, &rules, location.as_deref(), output)?;
    Ok(outcome(&file.summary))
}

/// 0 only when every rule holds and nothing is left over.
pub fn outcome(summary: &Summary) -> Exit {
    if summary.verified && summary.residual_mm3 == 0.0 { Exit::Done } else { Exit::Unverified }
}

/// Ctrl-C asks to stop; a second one stops at once.
pub fn context(output: &OutputArgs, limit: Option<f64>, seed: u64) -> Result<Ctx, Failure> {
    let cancel = Arc::new(AtomicBool::new(false));
    let flag = cancel.clone();
    ctrlc::set_handler(move || {
        if flag.swap(true, Ordering::Relaxed) {
            std::process::exit(Exit::Interrupted as i32);
        }
    })
    .map_err(|e| Failure::Io(format!("Ctrl-C cannot be caught ({e})")))?;
    // A limit beyond what a clock can hold is none.
    let limit = limit.and_then(|s| Duration::try_from_secs_f64(s).ok());
    let deadline = limit.and_then(|d| Instant::now().checked_add(d));
    Ok(Ctx::new(cancel, deadline, progress::fitting(output), seed))
}

/// The parts as they stand.
struct Parts {
    initial: Option<(Part, TriMesh)>,
    target: Part,
}

fn load(config: &PlanConfig, clock: &mut Clock) -> Result<Parts, Failure> {
    let (mut initial, mut target) = clock.time("load", || -> Result<_, Failure> {
        Ok((config.initial.as_ref().map(Part::read).transpose()?, Part::read(&config.target)?))
    })?;
    for part in initial.iter().chain([&target]) {
        for warning in &part.record.warnings {
            tracing::warn!("{}: {warning}", part.record.path);
        }
    }
    let mut standing: Vec<_> =
        initial.iter_mut().zip(&config.initial).map(|(p, c)| (p, c.up)).collect();
    standing.push((&mut target, config.target.up));
    inputs::stand(&mut standing)?;
    let placed = |part: Part| part.placed().map(|mesh| (part, mesh));
    Ok(Parts { initial: initial.map(placed).transpose()?, target })
}

/// A place of the target, and what to say of it.
#[derive(Clone)]
struct Place {
    motion: DAffine3,
    note: Option<String>,
    reused_share: f64,
}

/// Where the target may stand, the best place first: as in its file, or as the setup search finds.
fn places(
    parts: &mut Parts,
    config: &PlanConfig,
    ctx: &Ctx,
    clock: &mut Clock,
) -> Result<Vec<Place>, Failure> {
    let (Some((_, initial_mesh)), Setup::Search) = (&parts.initial, config.setup) else {
        let kept = parts.target.record.plan_from_part().unwrap_or(DAffine3::IDENTITY);
        return Ok(vec![Place { motion: kept, note: None, reused_share: 0.0 }]);
    };
    let turned = DAffine3::from_mat3(config.target.up.to_z());
    parts.target.place(&turned);
    let standing = parts.target.placed()?;
    let found =
        clock.time("setup", || pipeline::search_setup(initial_mesh, &standing, config, ctx))?;
    let place = |c: &Candidate| Place {
        motion: c.transform * turned,
        note: Some(found.note(c)),
        reused_share: c.reused_share,
    };
    Ok([&found.winner].into_iter().chain(&found.others).map(place).collect())
}

/// A plan, and what it was made for.
struct Made {
    prepared: Prepared,
    planned: pipeline::Planned,
    notes: Vec<String>,
}

/// Plans every place, as long as there is time, and keeps the best plan.
fn best_of(
    parts: &mut Parts,
    places: &[Place],
    config: &PlanConfig,
    ctx: &Ctx,
    clock: &mut Clock,
) -> Result<Made, Failure> {
    let plan_at = |parts: &mut Parts, place: &Place, clock: &mut Clock| -> Result<_, Failure> {
        let mut notes: Vec<String> = place.note.clone().into_iter().collect();
        let mut prepared = prepare(parts, place, config, ctx, clock)?;
        if config.setup == Setup::Search && config.is_reman() {
            let looked = || reman::shift_off_hidden(&prepared.job, &config.reman, ctx);
            if let Some(shift) = clock.time("setup", looked)? {
                let by = DVec3::from_array(shift.map(|n| n as f64 * prepared.job.frame.pitch));
                let motion = DAffine3::from_translation(by) * place.motion;
                prepared = prepare(parts, &Place { motion, ..place.clone() }, config, ctx, clock)?;
                notes.push(format!(
                    "The target was moved on by ({:.2}, {:.2}, {:.2}) mm, so that the reused \
                     volume hides nothing of what is printed.",
                    by.x, by.y, by.z
                ));
            }
        }
        let planned = pipeline::plan(&prepared.job, config, ctx, clock)?;
        let standing = planned.standing;
        Ok((Made { prepared, planned, notes }, standing))
    };
    let told = |i: usize, place: &Place, s: &reman::Standing| {
        let how = match s.class {
            0 => format!("a complete plan that gives up {:.1} mm³", s.mm3),
            1 => format!("{:.1} mm³ given up and, ten times, left", s.mm3),
            _ => format!("{:.1} mm³ left, more than the rules allow", s.mm3),
        };
        let share = 100.0 * place.reused_share;
        format!("Placement {} of {}, {share:.1} % inside: {how}.", i + 1, places.len())
    };
    let Some((first, others)) = places.split_first() else {
        return Err(Failure::input("the setup search found no placement"));
    };
    let (mut best, mut standing) = plan_at(parts, first, clock)?;
    let mut lines = vec![told(0, first, &standing)];
    for (i, place) in others.iter().enumerate() {
        if ctx.out_of_time() {
            lines.push("The time limit came before the other placements.".into());
            break;
        }
        let (made, s) = plan_at(parts, place, clock)?;
        lines.push(told(i + 1, place, &s));
        if s < standing {
            (best, standing) = (made, s);
        }
    }
    if !others.is_empty() {
        best.notes.extend(lines);
    }
    Ok(best)
}

/// What there is before planning begins.
struct Prepared {
    job: Job,
    inputs: Inputs,
}

fn prepare(
    parts: &mut Parts,
    place: &Place,
    config: &PlanConfig,
    ctx: &Ctx,
    clock: &mut Clock,
) -> Result<Prepared, Failure> {
    let tools: Vec<Tool> = config.cutters.iter().chain(&config.nozzles).cloned().collect();
    let mut sampled = |motion: &DAffine3| {
        parts.target.place(motion);
        let (initial, pitch) = (parts.initial.as_ref(), config.resolution_mm);
        clock.time("voxelise", || Grids::of(initial, &parts.target, pitch, &tools, ctx))
    };
    let mut grids = sampled(&place.motion)?;
    // What is made voxel by voxel stands on the base with voxels. A place found by search may put
    // a tip on it that is finer than these; whole voxels lower, the solid is the same.
    let gap_mm = inputs::gap_mm(&grids.target, &grids.frame);
    if config.nullify.is_some() && config.setup == Setup::Search && gap_mm > 0.0 {
        let lower = DAffine3::from_translation(DVec3::Z * -gap_mm) * place.motion;
        grids = sampled(&lower)?;
    }
    let Grids { frame, initial: initial_solid, target: target_solid, target_mesh } = grids;
    let (initial, target) = (parts.initial.as_ref(), &parts.target);
    let (mut cutters, mut nozzles) = (config.cutters.clone(), config.nozzles.clone());
    if let Some(options) = &config.nullify {
        cutters = vec![Tool::inv_cutter(frame.pitch, options.length)];
        nozzles = vec![Tool::inv_nozzle(frame.pitch)];
    }
    for tools in [&mut cutters, &mut nozzles] {
        tools.retain(|t| match t.taken {
            Taken::Always => true,
            Taken::FineGrids => t.is_round_at(frame.pitch),
            // Planner search weighs all its tools against each other at every step.
            Taken::LastResort => config.search.is_none(),
        });
    }
    let mut rules = Rules::for_pitch(frame.pitch, layer_mm(&nozzles));
    rules.holding = config.rules.holding;
    rules.base = config.rules.base;
    rules.tolerance_mm = config.rules.tolerance_mm.unwrap_or(rules.tolerance_mm);
    rules.grip_mm = config.rules.grip_mm.unwrap_or(rules.grip_mm);
    rules.deviation = config.search.as_ref().map_or(rules.deviation, |s| s.delta);
    let mut machine = config.machine.clone();
    if config.find_place {
        let contact = Holding::AS_CLAMPED.contact(&target_solid, &frame, rules.grip_mm);
        let sum: DVec3 = contact.iter_ones().map(|v| frame.center(v)).sum();
        let foot = sum / contact.count().max(1) as f64;
        machine.workholding.place = machine.find_place(frame.bounds(), foot);
    }
    let job = Job {
        frame,
        initial: initial_solid,
        target: target_solid,
        initial_mesh: initial.map(|i| i.1.clone()).unwrap_or_default(),
        target_mesh,
        machine,
        cutters,
        nozzles,
        rules,
    };
    let inputs =
        Inputs { initial: initial.map(|i| i.0.record.clone()), target: target.record.clone() };
    Ok(Prepared { job, inputs })
}

/// States written at most; of longer plans every n-th. All of them together have no more voxels
/// than this: a surface of millions of triangles for each would fill a disk.
const MOST_STATES: usize = 200;
const MOST_STATE_VOXELS: usize = 1 << 29;

/// States of which each begins with the surface of the one before: the more, the fewer surfaces
/// are made whole, and the fewer threads have work.
const STATES_RUN: usize = 12;

/// Writes a file whole: to a sibling first, then renamed.
fn write_beside(
    path: &Path,
    content: impl FnOnce(&mut dyn std::io::Write) -> std::io::Result<()>,
) -> Result<(), Failure> {
    let failed = |e: std::io::Error| Failure::writing(path, &e);
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut out = std::io::BufWriter::new(tempfile::NamedTempFile::new_in(folder).map_err(failed)?);
    content(&mut out).map_err(failed)?;
    let file = out.into_inner().map_err(|e| failed(e.into_error()))?;
    file.persist(path).map_err(|e| failed(e.error))?;
    Ok(())
}

/// The workpiece after each step, and what was reused, removed and added in all.
fn write_states(draft: &output::Draft, job: &Job, plan: &Plan, ctx: &Ctx) -> Result<(), Failure> {
    let most = (MOST_STATE_VOXELS / job.frame.voxel_count().max(1)).clamp(1, MOST_STATES);
    let stride = plan.steps.len().div_ceil(most).max(1);
    let mut state = job.initial.clone();
    let mut shown: Vec<(String, BitGrid)> = Vec::new();
    for (i, step) in plan.steps.iter().enumerate() {
        let kind = match step.kind {
            StepKind::Subtractive => {
                state.subtract(&step.region);
                "subtractive"
            }
            StepKind::Additive => {
                state.union_with(&step.region);
                "additive"
            }
        };
        // Of thousands of steps nobody looks at each.
        if (i + 1) % stride == 0 || i + 1 == plan.steps.len() {
            shown.push((format!("{:02}-{kind}", i + 1), state.clone()));
        }
    }
    let end = end_state(job, plan);
    let totals = [("reused", end.reused), ("removed", end.removed), ("added", end.added)];
    let totals = totals.map(|(name, grid)| (String::from(name), grid));
    let write = |run: &[(String, BitGrid)]| -> Result<(), Failure> {
        let mut last: Option<Skin> = None;
        for (name, grid) in run {
            ctx.check()?;
            let skin = match &last {
                Some(skin) => skin.patched(grid, &job.frame),
                None => Skin::of(grid, &job.frame),
            };
            let skin = skin
                .map_err(|e| Failure::Io(format!("the surface of {name} cannot be made ({e})")))?;
            draft.write(&format!("{}/{name}.stl", output::STATES), |out| skin.write_stl(out))?;
            last = Some(skin);
        }
        Ok(())
    };
    shown.par_chunks(STATES_RUN).chain(totals.par_chunks(1)).try_for_each(write)
}

/// SHA-256 as lower-case hexadecimal.
pub fn digest(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|b| format!("{b:02x}")).collect()
}

/// Largest resident memory of this process so far, MiB; none where the system does not tell.
fn peak_memory_mib() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
    let kib: f64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some((kib / 1024.0 * 10.0).round() / 10.0)
}

/// The thinnest layer of the nozzles used, mm: how deep any of them may ride into its own layer.
fn layer_mm(nozzles: &[Tool]) -> f64 {
    nozzles.iter().map(|t| t.process.layer_mm).fold(f64::INFINITY, f64::min)
}
