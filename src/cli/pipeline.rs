//! The stages between the job and the files, as the command line calls them: setup, planner,
//! posting, program check. Each turns the library's answer into what is reported.

use super::config::{LOOKED_AT, PlanConfig};
use super::exit::Failure;
use super::plan::{Clock, digest};
use hmplan::base::{Ctx, DAffine3};
use hmplan::gcode::{self, CheckReport, Deviation, Gouge, PostError, Program};
use hmplan::mesh::TriMesh;
use hmplan::plan::{Job, Plan, PlanFile, Schedule};
use hmplan::planner::setup::{PosedSetup, SetupOptions};
use hmplan::planner::{PlanError, hybrid, nullify, reman, setup};
use hmplan::report::{PlannerFigures, RuleLine};
use hmplan::toolpath::{self, ToolpathError, Toolpaths};
use hmplan::verify::Verdict;

/// What posting gave: the program, the time each step takes (s), and how its check went.
#[derive(Default)]
pub struct Posted {
    /// None when the program may not be handed out.
    pub text: Option<String>,
    /// Each step as a program of its own, when the whole may be handed out.
    pub steps: Vec<String>,
    pub step_seconds: Vec<f64>,
    pub time_s: f64,
    /// Volumes that the program lays and removes, mm³.
    pub deposited_mm3: f64,
    pub removed_mm3: f64,
    pub rules: Vec<RuleLine>,
}

/// What a planner gives.
pub struct Planned {
    pub plan: Plan,
    pub figures: PlannerFigures,
    /// Of planner nullify.
    pub schedule: Option<Schedule>,
    /// Of planner search.
    pub trace: Option<String>,
    /// Of planner reman: how it compares with the plan of another placement.
    pub standing: reman::Standing,
}

/// Searches the place of the target in the initial part, both standing, and the initial part's pose
/// where that is asked for.
pub fn search_setup(
    initial: &TriMesh,
    target: &TriMesh,
    config: &PlanConfig,
    ctx: &Ctx,
) -> Result<PosedSetup, Failure> {
    let mut options = SetupOptions {
        holding: config.rules.holding,
        score: config.setup_score,
        refined: config.setup_candidates.unwrap_or(LOOKED_AT),
        ..SetupOptions::default()
    };
    options.grip_mm = config.rules.grip_mm.unwrap_or(options.grip_mm);
    if config.initial_pose_search {
        return setup::search_poses(initial, target, &options, ctx).map_err(failure);
    }
    let report = setup::search(initial, target, &options, ctx).map_err(failure)?;
    Ok(PosedSetup { initial: DAffine3::IDENTITY, report, poses: 1, pose: 0 })
}

/// Plans with the planner asked for.
pub fn plan(
    job: &Job,
    config: &PlanConfig,
    ctx: &Ctx,
    clock: &mut Clock,
) -> Result<Planned, Failure> {
    if let Some(options) = &config.nullify {
        return nullified(job, options, config.schedule.is_some(), ctx, clock);
    }
    if let Some(options) = &config.search {
        return searched(job, options, ctx, clock);
    }
    let (plan, report) = reman::plan(job, &config.reman, ctx).map_err(failure)?;
    for (stage, seconds) in &report.seconds {
        if !clock.seconds.add(stage, *seconds) {
            tracing::debug!("stage {stage}: {seconds:.2} s");
        }
    }
    let figures = PlannerFigures {
        planner: "reman".into(),
        reuse_initial: Some(report.reuse_initial),
        base_height_ratio: report.base_height_ratio,
        inaccessible_sm: Some(report.inaccessible_sm),
        inaccessible_am: Some(report.inaccessible_am),
        planes_global: Some(report.planes_global),
        planes_local: Some(report.planes_local),
        notes: report.notes,
        ..PlannerFigures::default()
    };
    Ok(Planned { plan, figures, schedule: None, trace: None, standing: report.standing })
}

fn searched(
    job: &Job,
    options: &hybrid::Options,
    ctx: &Ctx,
    clock: &mut Clock,
) -> Result<Planned, Failure> {
    let (plan, r) = clock.time("search", || hybrid::plan(job, options, ctx)).map_err(failure)?;
    let class = match r.goal {
        true if r.left_mm3 == 0.0 => 0,
        true => 1,
        false => 2,
    };
    let figures = PlannerFigures {
        planner: "search".into(),
        cost: Some(r.cost),
        cost_lower_bound: Some(r.bound),
        states_expanded: Some(r.expanded),
        notes: r.notes,
        ..PlannerFigures::default()
    };
    Ok(Planned {
        plan,
        figures,
        schedule: None,
        trace: Some(r.trace),
        standing: reman::Standing { class, given_up_mm3: 0.0, left_mm3: r.left_mm3 },
    })
}

fn nullified(
    job: &Job,
    options: &nullify::Options,
    scheduled: bool,
    ctx: &Ctx,
    clock: &mut Clock,
) -> Result<Planned, Failure> {
    let (plan, s) = clock.time("search", || nullify::plan(job, options, ctx)).map_err(failure)?;
    let schedule = match scheduled {
        true => Some(Schedule::new(s.dims, &s.operations).map_err(Failure::input)?),
        false => None,
    };
    let mut notes = vec![format!(
        "Planned for the half-space tools of the method, L = {} voxels, in a box of {} × {} × {}.",
        options.length, s.dims[0], s.dims[1], s.dims[2]
    )];
    if s.tries > 1 {
        notes.push(format!("The best of {} tries within the time limit.", s.tries));
    }
    let figures = PlannerFigures {
        planner: "nullify".into(),
        operations: Some(s.operations.len()),
        support_voxels: Some(s.supports),
        notes,
        ..PlannerFigures::default()
    };
    Ok(Planned { plan, figures, schedule, trace: None, standing: Default::default() })
}

/// What a planner's error is to the command.
pub fn failure(e: PlanError) -> Failure {
    match e {
        PlanError::Cancelled => Failure::Interrupted,
        e => Failure::input(e),
    }
}

/// Paths, program and its check; what `aside` gives, which is done beside the program, since that
/// is written and read line by line. A program is handed out only when it passes, or when
/// `regardless` is set; what keeps it back is in the rules.
pub fn post<T: Send>(
    job: &Job,
    verdict: &Verdict,
    regardless: bool,
    aside: impl FnOnce() -> T + Send,
    ctx: &Ctx,
) -> Result<(Posted, T), Failure> {
    let made = paths(job, verdict, ctx);
    let (checked, aside) = rayon::join(|| made.and_then(|p| checked(job, verdict, &p, ctx)), aside);
    let posted = match checked {
        Ok((program, report)) => {
            let fit = report.passed() || regardless;
            Posted {
                text: fit.then(|| program.text().to_string()),
                steps: if fit { program.steps() } else { Vec::new() },
                step_seconds: report.steps.iter().map(|s| s.time_s).collect(),
                time_s: report.time_s(),
                deposited_mm3: report.total(|s| s.deposited_mm3),
                removed_mm3: report.total(|s| s.removed_mm3),
                rules: program_rules(&report),
            }
        }
        Err(PostError::Paths(ToolpathError::Cancelled(_))) => return Err(Failure::Interrupted),
        Err(e) => {
            let rule = RuleLine { rule: "program".into(), passed: false, figure: e.to_string() };
            Posted { rules: vec![rule], ..Posted::default() }
        }
    };
    Ok((posted, aside))
}

fn paths(job: &Job, verdict: &Verdict, ctx: &Ctx) -> Result<Toolpaths, PostError> {
    Ok(match verdict.clone().into_verified() {
        Ok(verified) => toolpath::for_plan(job, &verified, ctx)?,
        Err(_) => toolpath::for_unverified(job, &verdict.plan, ctx)?,
    })
}

fn checked(
    job: &Job,
    verdict: &Verdict,
    paths: &Toolpaths,
    ctx: &Ctx,
) -> Result<(Program, CheckReport), PostError> {
    let plan = &verdict.plan;
    let program = gcode::post(job, plan, paths, &plan_digest(job, plan))?;
    let report = gcode::check(program.text(), job, plan, Some(paths), ctx)?;
    Ok((program, report))
}

/// Names a plan in its program: a digest of its steps.
fn plan_digest(job: &Job, plan: &Plan) -> String {
    let digests: Vec<String> = PlanFile::step_records(plan, &job.frame, &[])
        .iter()
        .map(|s| format!("{:?} {} {:?} {}", s.kind, s.tool, s.direction, s.region.sha256()))
        .collect();
    digest(digests.join("\n").as_bytes())
}

/// Holds a program's text against the plan.
pub fn check_program(
    job: &Job,
    plan: &Plan,
    text: &str,
    ctx: &Ctx,
) -> Result<Vec<RuleLine>, Failure> {
    match gcode::check(text, job, plan, None, ctx) {
        Ok(report) => Ok(program_rules(&report)),
        Err(ToolpathError::Cancelled(_)) => Err(Failure::Interrupted),
        Err(e) => Err(Failure::input(e)),
    }
}

/// How far what a program leaves is from the target; none where the job has no target mesh.
pub fn deviation(
    job: &Job,
    plan: &Plan,
    text: &str,
    ctx: &Ctx,
) -> Result<Option<Deviation>, Failure> {
    if job.target_mesh.is_empty() || plan.steps.is_empty() {
        return Ok(None);
    }
    match gcode::deviation(text, job, plan, ctx) {
        Ok(map) => Ok(Some(map)),
        Err(ToolpathError::Cancelled(_)) => Err(Failure::Interrupted),
        Err(e) => Err(Failure::input(e)),
    }
}

/// The map's figures in one sentence.
pub fn deviation_note(d: &Deviation) -> String {
    let figures = format!(
        "Deviation of the program from the target (deviation.ply): {:.1} % of the machined surface cut \
         deeper than {:.2} mm (most {:.2} mm), {:.1} % left higher than roughing leaves (most {:.2} mm), \
         {:.1} % more where no such cutter comes nearer; beads at most {:.2} mm outside.",
        100.0 * d.gouged,
        toolpath::GOUGE_MM,
        d.gouge_mm,
        100.0 * d.left,
        d.excess_mm,
        100.0 * d.unreached,
        d.outside_mm,
    );
    let Some(Gouge { at, line }) = d.deepest else { return figures };
    let place = format!("({:.1}, {:.1}, {:.1})", at.x, at.y, at.z);
    format!("{figures} The deepest cut, at {place} mm, is that of line {line}.")
}

/// One line when the program passes, else one a broken rule with its first finding.
fn program_rules(report: &CheckReport) -> Vec<RuleLine> {
    if report.passed() {
        let least = report.steps.iter().map(|s| s.coverage).fold(1.0, f64::min);
        let figure = format!(
            "{} lines, {:.1} min; at least {:.1} % of each region covered",
            report.lines,
            report.time_s() / 60.0,
            100.0 * least
        );
        return vec![RuleLine { rule: "program".into(), passed: true, figure }];
    }
    let mut broken: Vec<_> = report.findings.iter().map(|f| f.rule).collect();
    broken.sort_unstable();
    broken.dedup();
    let line = |rule| {
        let mut of_rule = report.findings.iter().filter(|f| f.rule == rule);
        let first =
            of_rule.next().map_or(String::new(), |f| format!("line {}: {}", f.line, f.message));
        let more = match of_rule.count() {
            0 => String::new(),
            n => format!("; and {n} more"),
        };
        RuleLine { rule: format!("program-{rule}"), passed: false, figure: first + &more }
    };
    broken.into_iter().map(line).collect()
}
