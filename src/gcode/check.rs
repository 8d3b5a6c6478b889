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

/// Working moves one by one: each begins and ends where the path's does. Moves of the path no longer
/// than what is written may be left out, so the program may stand before any of several moves: all
/// of them are carried along, since the one that lies nearest need not be the one that was written.
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
    let from = |i: usize| i.checked_sub(1).map(|before| path.moves[before].tip);
    let planned: Vec<(Option<DVec3>, DVec3)> = path
        .moves
        .iter()
        .enumerate()
        .filter(|(_, m)| works(m.kind))
        .map(|(i, m)| (from(i), m.tip))
        .collect();
    let is_short = |&(from, to): &(Option<DVec3>, DVec3)| from.is_some_and(|f| same(f, to));
    let is_made = |&(from, to): &(Option<DVec3>, DVec3), w: &Motion| {
        same(w.to, to) && w.from.zip(from).is_none_or(|(a, b)| same(a, b))
    };
    // The moves of the path that may come next, rising.
    let mut next = vec![0];
    for w in motions.iter().filter(|m| m.gait == gait) {
        let mut after = Vec::new();
        let mut seen = 0;
        for first in &next {
            let mut i = seen.max(*first);
            while let Some(p) = planned.get(i) {
                if is_made(p, w) {
                    after.push(i + 1);
                }
                i += 1;
                if !is_short(p) {
                    break;
                }
            }
            seen = i;
        }
        if after.is_empty() {
            let wanted = next.last().and_then(|i| planned.get(*i));
            let but = match wanted {
                Some((_, to)) => format!(", the plan's path has one to ({to:.3})"),
                None => " that the plan's path does not have".into(),
            };
            return Some(found(w.line, format!("{what} to ({:.3}){but}", w.to)));
        }
        next = after;
    }
    let last = next.last().copied().unwrap_or_default();
    let (_, to) = planned[last..].iter().find(|p| !is_short(p))?;
    Some(found(line, format!("{what} to ({to:.3}) is missing in this step")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Direction;
    use crate::toolpath::{Figures, Move};

    /// A move of 0.3 µm that rounding leaves out, before one hardly longer than what is written: the
    /// program's next move was once taken for it, and later, where it was written, for the next.
    #[test]
    fn short_moves_left_out_keep_no_others_from_their_own() {
        let tips = [
            [15.6668, -96.2424],
            [15.668423, -96.239735],
            [15.668241, -96.239561],
            [15.667224, -96.249891],
            [15.746770, -96.255170],
            [15.9, -96.3],
        ];
        let moves: Vec<Move> = tips
            .iter()
            .map(|[x, y]| Move { kind: MoveKind::Cut, tip: DVec3::new(*x, *y, 22.8), feed: 400.0 })
            .collect();
        let path = Toolpath {
            step: 0,
            kind: StepKind::Subtractive,
            tool: "t".into(),
            direction: Direction::Z,
            holding: 0,
            safe_height: 50.0,
            bead_mm2: 0.0,
            moves,
            figures: Figures::default(),
        };
        // Words are rounded where the machine counts from, not where the work does.
        let to_grid = |v: f64, from: f64| ((v - from) * 1e3).round() / 1e3 + from;
        let rounded = |[x, y]: [f64; 2]| DVec3::new(to_grid(x, 3.15e-4), to_grid(y, 6.02e-4), 22.8);
        let program = |kept: &[usize]| -> Vec<Motion> {
            let tips: Vec<DVec3> = kept.iter().map(|i| rounded(tips[*i])).collect();
            let froms = std::iter::once(None).chain(tips.iter().copied().map(Some));
            let motion = |(k, (to, from)): (usize, (&DVec3, Option<DVec3>))| Motion {
                line: k + 1,
                step: 0,
                gait: Gait::Feed,
                from,
                to: *to,
                feed: 400.0,
            };
            tips.iter().zip(froms).enumerate().map(motion).collect()
        };
        assert_eq!(follows(&program(&[0, 1, 3, 4, 5]), &path, 1), None);
        assert_eq!(follows(&program(&[0, 1, 2, 3, 4, 5]), &path, 1), None);
        let astray = follows(&program(&[0, 1, 3, 5]), &path, 1).unwrap();
        assert_eq!(astray.line, 4);
        let early = follows(&program(&[0, 1, 3, 4]), &path, 1).unwrap();
        assert_eq!((early.line, early.message.contains("missing")), (1, true));
        let late = follows(&program(&[0, 1, 2, 3, 4, 5, 0]), &path, 1).unwrap();
        assert_eq!((late.line, late.message.contains("does not have")), (7, true));
    }
}
