//! `hmplan plan`: read, place, voxelise, plan, judge, post, write.

use super::args::OutputArgs;
use super::config::PlanConfig;
use super::exit::{Exit, Failure};
use super::output::{self, Destination};
use super::placing::{Made, Placing, Prepared, load, places};
use super::{inputs, pipeline, progress, summary};
use hmplan::base::Ctx;
use hmplan::plan::{
    Job, Plan, PlanFile, ProgramRecord, SCHEMA, Seconds, StepKind, Summary, end_state,
};
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
    let besides = config.schedule.iter().chain(&config.trace);
    besides.into_iter().try_for_each(|file| destination.refuse_own(file))?;
    let ctx = context(output, config.time_limit_s, config.seed)?;
    let mut parts = load(config, &mut clock)?;
    let places = places(&mut parts, config, &ctx, &mut clock)?;
    let mut placing = Placing { parts: &mut parts, config, ctx: &ctx, clock: &mut clock };
    let Made { prepared, planned, notes } = placing.best_of(&places)?;
    let Prepared { job, inputs } = prepared;
    let pipeline::Planned { plan, mut figures, schedule, trace, .. } = planned;
    figures.notes.splice(0..0, notes);
    figures.notes.extend(inputs::below_base(&job));
    // Planner nullify keeps nothing to begin with.
    if config.nullify.is_none() {
        figures.notes.extend(inputs::above_base(&job));
    }
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
            time_s: posted.time_s,
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
            let kind = output::kind_name(step.kind);
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
        match step.kind {
            StepKind::Subtractive => state.subtract(&step.region),
            StepKind::Additive => state.union_with(&step.region),
        }
        // Of thousands of steps nobody looks at each.
        if (i + 1) % stride == 0 || i + 1 == plan.steps.len() {
            let kind = output::kind_name(step.kind);
            shown.push((format!("{:02}-{kind}", i + 1), state.clone()));
        }
    }
    let end = end_state(job, plan);
    let grids = [end.reused, end.removed, end.added];
    let totals: Vec<_> = output::TOTALS.map(String::from).into_iter().zip(grids).collect();
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
