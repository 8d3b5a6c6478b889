use super::interpret::{Gait, Motion, Run, Setting, run};
use super::program::{Checked, Program};
use super::report::{CheckReport, Finding, Rule, StepFigures};
use super::sweep::{Scene, WRITTEN_MM, judge};
use crate::base::{Ctx, DVec3};
use crate::plan::{Job, Plan, StepKind};
use crate::toolpath::{MoveKind, Replay, Toolpath, ToolpathError, Toolpaths};
use rayon::prelude::*;

/// Largest difference between the working length a path promises and the one its program runs where
/// arcs stand for chords: a share of the length, since an arc 0.005 mm high is longer than its chord
/// by a fifth of a per cent at most where it is worth writing, and a floor in mm.
const PROMISED_ARCS: (f64, f64) = (3e-3, 0.1);

/// A program is not read beyond this size: 1 GiB, ten times the largest plan's.
const MOST_BYTES: usize = 1 << 30;

/// Judges a program's text against a plan. With `promised`, working lengths and volumes must be
/// those of the paths it was written from.
///
/// # Errors
/// When the plan itself is not of the job, or the user stops the run; a bad program is a report.
pub fn check(
    text: &str,
    job: &Job,
    plan: &Plan,
    promised: Option<&Toolpaths>,
    ctx: &Ctx,
) -> Result<CheckReport, ToolpathError> {
    let lines = text.bytes().filter(|b| *b == b'\n').count();
    if text.len() > MOST_BYTES {
        let message = format!("{} bytes, more than {MOST_BYTES}", text.len());
        let findings = vec![Finding { line: 1, rule: Rule::Syntax, message }];
        return Ok(CheckReport { findings, steps: Vec::new(), lines });
    }
    let replay = Replay::of(job, plan)?;
    let run = interpret(text, job, plan, &replay);
    ctx.begin("check program", plan.steps.len() as u64);
    let judged: Result<Vec<(StepFigures, Vec<Finding>)>, ToolpathError> = (0..plan.steps.len())
        .into_par_iter()
        .map(|i| {
            ctx.check()?;
            let line = run.step_lines.get(i).copied().unwrap_or(lines.max(1));
            let judged = judge_step(job, plan, &replay, i, &run.motions, line, ctx)?;
            ctx.check()?;
            ctx.advance(1);
            Ok(judged)
        })
        .collect();
    ctx.end();
    let mut findings = run.findings;
    let mut steps = Vec::with_capacity(plan.steps.len());
    for (i, (mut figures, more)) in judged?.into_iter().enumerate() {
        findings.extend(more);
        let idle = run.idle.iter().filter(|(changes, _)| *changes == i + 1).map(|(_, s)| s);
        figures.time_s += job.machine.control.tool_change_s + idle.sum::<f64>();
        if let Some(p) = promised.and_then(|p| p.all().get(i)) {
            let line = run.step_lines.get(i).copied().unwrap_or(lines.max(1));
            let arcs = job.machine.control.post.arcs;
            findings.extend(against(of_step(&run.motions, i), &figures, p, line, arcs));
        }
        steps.push(figures);
    }
    findings.sort_by_key(|f| (f.line, f.rule));
    Ok(CheckReport { findings, steps, lines })
}

fn interpret(text: &str, job: &Job, plan: &Plan, replay: &Replay) -> Run {
    let placements: Vec<_> = plan
        .steps
        .iter()
        .zip(&replay.contact_center)
        .map(|(s, c)| job.machine.placement(&plan.holdings[s.holding], *c))
        .collect();
    run(text, &Setting { job, plan, placements: &placements })
}

/// Where a program moves, in order of its steps.
pub(super) fn motions(text: &str, job: &Job, plan: &Plan, replay: &Replay) -> Vec<Motion> {
    interpret(text, job, plan, replay).motions
}

/// As [`check`]; hands out the program as checked when no rule is broken.
///
/// # Errors
/// As [`check`].
pub fn check_program(
    program: Program,
    job: &Job,
    plan: &Plan,
    promised: Option<&Toolpaths>,
    ctx: &Ctx,
) -> Result<(CheckReport, Option<Checked<Program>>), ToolpathError> {
    let report = check(program.text(), job, plan, promised, ctx)?;
    let checked = report.passed().then(|| Checked::new(program));
    Ok((report, checked))
}

fn judge_step(
    job: &Job,
    plan: &Plan,
    replay: &Replay,
    i: usize,
    motions: &[Motion],
    line: usize,
    ctx: &Ctx,
) -> Result<(StepFigures, Vec<Finding>), ToolpathError> {
    let step = &plan.steps[i];
    let no_tool = || ToolpathError::NoTool { step: i, tool: step.tool.clone() };
    let scene = Scene {
        frame: &job.frame,
        machine: &job.machine,
        step,
        tool: job.tool(&step.tool).ok_or_else(no_tool)?,
        before: &replay.states[i],
        after: &replay.states[i + 1],
        fixed: &replay.fixed[i],
        tolerance: job.rules.tolerance_mm,
        line,
        ctx,
    };
    Ok(judge(&scene, of_step(motions, i)))
}

fn of_step(motions: &[Motion], i: usize) -> &[Motion] {
    let from = motions.partition_point(|m| m.step < i);
    &motions[from..motions.partition_point(|m| m.step <= i)]
}

/// Whether a step of the program goes where its path goes.
fn against(
    motions: &[Motion],
    figures: &StepFigures,
    path: &Toolpath,
    line: usize,
    arcs: bool,
) -> Option<Finding> {
    if arcs { as_long(figures, path, line) } else { follows(motions, path, line) }
}

/// Where arcs stand for chords: whether the program works for as long as its path promises.
fn as_long(figures: &StepFigures, path: &Toolpath, line: usize) -> Option<Finding> {
    let off = |a: f64, b: f64| (a - b).abs() > PROMISED_ARCS.0 * b + PROMISED_ARCS.1;
    let (want, what) = match path.kind {
        // In a program all moves at feed are alike.
        StepKind::Subtractive => {
            (path.length(MoveKind::Cut) + path.length(MoveKind::Approach), "mm at feed")
        }
        StepKind::Additive => (path.length(MoveKind::Deposit), "mm of beads"),
    };
    off(figures.working_mm, want).then(|| Finding {
        line,
        rule: Rule::Volume,
        message: format!("{:.1} {what}, the plan's paths have {want:.1}", figures.working_mm),
    })
}

/// Working moves one by one: each begins and ends where the path's does. Moves shorter than what is
/// written may be left out.
fn follows(motions: &[Motion], path: &Toolpath, line: usize) -> Option<Finding> {
    let same = |a: DVec3, b: DVec3| a.distance(b) <= WRITTEN_MM;
    let (gait, what) = match path.kind {
        StepKind::Subtractive => (Gait::Feed, "a cut"),
        StepKind::Additive => (Gait::Deposit, "a bead"),
    };
    let works = |k: MoveKind| match path.kind {
        StepKind::Subtractive => matches!(k, MoveKind::Cut | MoveKind::Approach),
        StepKind::Additive => k == MoveKind::Deposit,
    };
    let found = |line: usize, message: String| Finding { line, rule: Rule::Volume, message };
    let mut made = motions.iter().filter(|m| m.gait == gait).peekable();
    for (i, m) in path.moves.iter().enumerate().filter(|(_, m)| works(m.kind)) {
        let from = i.checked_sub(1).map(|before| path.moves[before].tip);
        let begins = |w: &Motion| w.from.zip(from).is_none_or(|(a, b)| same(a, b));
        match made.peek() {
            Some(w) if same(w.to, m.tip) && begins(w) => {
                made.next();
            }
            _ if from.is_some_and(|f| same(f, m.tip)) => {}
            Some(w) => {
                let message =
                    format!("{what} to ({:.3}), the plan's path has one to ({:.3})", w.to, m.tip);
                return Some(found(w.line, message));
            }
            None => {
                let message = format!("{what} to ({:.3}) is missing in this step", m.tip);
                return Some(found(line, message));
            }
        }
    }
    let more = made.next()?;
    Some(found(more.line, format!("{what} to ({:.3}) that the plan's path does not have", more.to)))
}
