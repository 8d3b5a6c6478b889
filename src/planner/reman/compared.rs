//! The strategies that W2V compares its own with (Fig. 14): global planes from above, one plane
//! from below.
//!
//! Both judge a placement by making its blocks on the coarse grid; the last good one is then made on
//! the job's own.

use super::Run;
use super::clip::Clip;
use super::coarse::Coarse;
use super::global::shifted;
use super::round::{Attempt, Mending, attempt};
use super::setting::Setting;
use crate::base::Direction;
use crate::plan::{Job, Plane};
use crate::planner::PlanError;

/// Rounds of shifting: 0.7 to this power of the distance to the base is left, a fiftieth.
const SHIFTS: usize = 11;

/// Halvings of the interval in which a single plane is placed: a fiftieth of it is left.
const HALVINGS: usize = 6;

/// Residual on the coarse grid that still passes, as a share of the target: its staircase.
const COARSE_RESIDUAL_SHARE: f64 = 2e-3;

/// Places planes on the coarse grid.
struct Trial<'a, 'r> {
    run: &'r Run<'a>,
    job: &'r Job,
    setting: &'r Setting<'r>,
    look: &'r Coarse,
}

impl Trial<'_, '_> {
    fn passes(&self, planes: &[Plane]) -> Result<bool, PlanError> {
        let Run { start, options, ctx, .. } = self.run;
        ctx.check()?;
        let clips = planes.iter().map(|p| Clip::global(*p)).collect();
        let made = attempt(
            self.setting,
            self.look,
            clips,
            &start.preferred,
            (options, Mending::None),
            ctx,
        )?;
        let most = COARSE_RESIDUAL_SHARE * self.job.target.count() as f64;
        Ok(made.residual() as f64 <= most)
    }
}

fn made(run: &mut Run, planes: &[Plane]) -> Result<Attempt, PlanError> {
    let Run { start, options, ctx, report, clock, .. } = run;
    let clips = planes.iter().map(|p| Clip::global(*p)).collect();
    let made = start.attempt(clips, options, ctx)?;
    report.count_inaccessible(start.setting.job, &made.excess, &made.deficit);
    clock.lap("blocks");
    Ok(made)
}

/// All planes shifted toward the base together until everything is reached.
pub fn top_down(run: &mut Run, mut planes: Vec<Plane>) -> Result<Attempt, PlanError> {
    let job = run.start.coarse.as_job();
    let (setting, look) = (Setting::new(&job), Coarse::of(&job));
    for _ in 0..SHIFTS {
        let trial = Trial { run, job: &job, setting: &setting, look: &look };
        if planes.is_empty() || trial.passes(&planes)? || run.ctx.out_of_time() {
            break;
        }
        planes = shifted(run.start.setting, &planes);
    }
    run.clock.lap("search");
    made(run, &planes)
}

/// One plane across each axis of the part, as far out as everything is reached; the one that keeps
/// most.
pub fn bottom_up(run: &mut Run) -> Result<Attempt, PlanError> {
    let job = run.start.coarse.as_job();
    let (setting, look) = (Setting::new(&job), Coarse::of(&job));
    let ideal = job.ideal_reuse();
    let mut best: Option<(usize, Plane)> = None;
    for normal in [Direction::Z, Direction::X, Direction::NEG_X, Direction::Y, Direction::NEG_Y] {
        let heights = ideal.iter_ones().map(|v| normal.dot(job.frame.center(v)));
        let (low, high) =
            heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), z| (l.min(z), h.max(z)));
        if low > high {
            continue;
        }
        let trial = Trial { run, job: &job, setting: &setting, look: &look };
        // The interval in which the last good offset lies; nothing reused is good.
        let (mut good, mut bad) = (low - job.frame.pitch, high + job.frame.pitch);
        let at = |offset| Plane { normal, offset };
        if trial.passes(&[at(bad)])? {
            good = bad;
        }
        for _ in 0..HALVINGS {
            let middle = (good + bad) / 2.0;
            if good >= bad || run.ctx.out_of_time() {
                break;
            }
            if trial.passes(&[at(middle)])? {
                good = middle;
            } else {
                bad = middle;
            }
        }
        let kept = super::volumes(&job, &[Clip::global(at(good))]).reused.count();
        if best.is_none_or(|(most, _)| kept > most) {
            best = Some((kept, at(good)));
        }
    }
    run.clock.lap("search");
    let planes: Vec<Plane> = best.into_iter().map(|(_, p)| p).collect();
    run.report.planes_global = planes.len();
    made(run, &planes)
}
