//! Printing first: nothing given up for it.
//!
//! Method. What is missing is printed on the initial part as it is, straight up and on supports where
//! nothing else carries it, then along every direction; what stands outside the target is cut after
//! that, and what is still missing printed (`last_resort` without planes). A worn part has little to
//! be cut and much that a plane would give up. The coarse grid, on which it takes a second, says
//! whether it is worth making.
//!
//! Guarantees: those of cuts and deposits. Not guaranteed: that nothing is left. What no nozzle
//! reaches beside that which is reused stays missing.

use super::clip::Clip;
use super::coarse::Coarse;
use super::last_resort::on_supports;
use super::round::{Attempt, UnderPlanes};
use super::setting::Setting;
use super::{Run, Start};
use crate::planner::PlanError;

/// What comes of printing first; none where the coarse grid shows that it leaves more than the rules
/// allow.
pub fn printed_first(run: &mut Run) -> Result<Option<Attempt>, PlanError> {
    if glimpse(run, &[])? == Leaves::TooMuch {
        return Ok(None);
    }
    let setting = run.start.setting.with_last_resort();
    let start = run.start.in_setting(&setting);
    let under = UnderPlanes::of(setting.job, Vec::new());
    let made = on_supports(&start, &under, run.options, run.ctx)?;
    made.tell("printed first", 0);
    run.clock.lap("blocks");
    Ok(Some(made))
}

/// What some way of making a plan leaves on the coarse grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Leaves {
    /// Nothing, or nothing is told: the grid is so coarse that nothing would hold the part.
    Nothing,
    /// What the rules allow.
    Little,
    TooMuch,
}

/// What supports and waiting stock leave under some planes, on the coarse grid.
pub fn glimpse(run: &mut Run, clips: &[Clip]) -> Result<Leaves, PlanError> {
    let Run { start, options, clock, ctx, .. } = run;
    let leaves = on_coarse_grid(start, |look| {
        let job = look.setting.job;
        let clips = clips.iter().map(|c| {
            let seeds = c.seeds.as_ref().map(|s| start.coarse.any(s));
            Clip { seeds, ..c.clone() }
        });
        let under = UnderPlanes::of(job, clips.collect());
        let made = on_supports(look, &under, options, ctx)?;
        made.tell("glimpse", 0);
        let reused = made.volumes.reused.count();
        // All that is left counts: what is open only below is no better than the rest here.
        Ok(match made.standing(job, reused).class {
            _ if reused == 0 => Leaves::Nothing,
            0 => Leaves::Nothing,
            1 => Leaves::Little,
            _ => Leaves::TooMuch,
        })
    })?;
    clock.lap("blocks");
    Ok(leaves)
}

/// Looks at the coarse job, planned on as it is, with the tools of the last resort.
pub fn on_coarse_grid<T>(
    start: &Start,
    look: impl FnOnce(&Start) -> Result<T, PlanError>,
) -> Result<T, PlanError> {
    let job = start.coarse.as_job();
    let setting = Setting::new(&job).with_last_resort();
    let (coarse, preferred) = (Coarse::of(&job), start.preferred.clone());
    look(&Start { setting: &setting, coarse: &coarse, preferred, bad_bases: Vec::new() })
}

#[cfg(test)]
mod tests {
    use super::super::local_tests::{assert_verifies, block, block_job, bowl, with_run};
    use super::*;
    use crate::base::Direction;
    use crate::machine::Taken;
    use crate::plan::{Job, Plane, StepKind};

    /// A block that has to be whole, a little too long, with something missing.
    fn job(missing: impl Fn([usize; 3]) -> bool + Sync) -> Job {
        let target = |v: [usize; 3]| block(v) && v[0] < 28;
        block_job(|v| block(v) && !missing(v), target, |t| t.taken == Taken::Always)
    }

    /// Worn on top: a bowl is no base for a plane to keep, but it is filled from above.
    #[test]
    fn a_worn_top_is_filled_before_anything_is_cut() {
        let job = job(bowl);
        let made = with_run(&job, |run| printed_first(run).unwrap().unwrap());
        assert_eq!(made.left(), 0);
        assert_eq!(made.volumes.reused, job.ideal_reuse(), "nothing is given up");
        let first = made.steps.iter().position(|s| s.kind == StepKind::Subtractive);
        assert!(first.is_some_and(|f| f > 0), "the end comes off after the first deposit");
        assert_verifies(&job, made.steps);
    }

    /// A hollow that no nozzle gets into asks for a plane, whose look says so.
    #[test]
    fn a_closed_hollow_is_not_worth_the_try() {
        let hollow =
            |v: [usize; 3]| v.iter().zip([8..20, 8..20, 5..13]).all(|(c, r)| r.contains(c));
        let job = job(hollow);
        assert!(with_run(&job, |run| printed_first(run).unwrap().is_none()));
        let seen = |offset: f64| {
            let clip = Clip::global(Plane { normal: Direction::Z, offset });
            with_run(&job, |run| glimpse(run, std::slice::from_ref(&clip)).unwrap())
        };
        assert_eq!(seen(100.0), Leaves::TooMuch);
        assert_eq!(seen(5.0), Leaves::Nothing);
    }
}
