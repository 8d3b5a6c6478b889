//! The last of the deposits: crumbs that a finished plan misses.
//!
//! Method. Blocks that lay less than a few beads are not made while a plan is looked for, since a change of
//! direction for a crumb helps nobody. Where crumbs are all that is missing, each attempt makes such blocks if they
//! leave nothing ([`print_crumbs`]). The plan that won, pits included, makes them also if they leave no more than half.
//! Here directions are denser.
//!
//! Guarantees: those of deposits. The plan misses less, or is the one before. Not guaranteed: that a crumb is worth
//! its change of direction to whoever runs the program.

use super::printing::{Patience, Printing, Wanted, print_crumbs};
use super::round::{Attempt, along};
use super::{Run, followed};
use crate::plan::Job;
use crate::planner::PlanError;

/// Directions are so much denser than those of other blocks: a crevice is open to few of them.
const DENSER: usize = 4;

/// Of so many voxels before, so few may be missing after.
fn no_more_than_half(before: usize, after: usize) -> bool {
    2 * after <= before
}

/// The plan with blocks for the crumbs that it misses, where those leave no more than half.
pub fn with_crumbs(run: &mut Run, best: Attempt) -> Result<Attempt, PlanError> {
    if best.deficit.is_empty() || run.ctx.out_of_time() {
        return Ok(best);
    }
    let setting = run.start.setting.with_last_resort();
    let job = setting.job;
    let state = best.end(job);
    let next_job = Job { initial: state.clone(), ..job.clone() };
    let next = setting.of_next_round(&next_job, setting.old_of(&best.volumes.reused));
    let missing = job.target.minus(&state);
    let wanted = Wanted {
        state: &state,
        added: &missing,
        core: &best.deficit,
        preferred: &along(&best.clips, &run.start.preferred),
        samples: DENSER * run.options.directions,
        patience: Patience::Endless,
    };
    let none = Printing::before_any(state.clone(), missing.clone());
    let coarse = run.start.coarse;
    let printing = print_crumbs(&next, coarse, &wanted, none, no_more_than_half, run.ctx)?;
    run.clock.lap("blocks");
    Ok(best.with_deposits(printing))
}

impl Attempt {
    /// With deposits after all its steps.
    fn with_deposits(mut self, printing: Printing) -> Attempt {
        self.steps = followed(self.steps, printing.steps);
        self.deficit.intersect_with(&printing.unreached);
        self
    }
}

#[cfg(test)]
mod tests {
    use super::super::Options;
    use super::super::coarse::Coarse;
    use super::super::local_tests::{block, block_job};
    use super::super::plan;
    use super::super::printing::{leaves_none, print_blocks};
    use super::super::setting::Setting;
    use super::*;
    use crate::base::{Ctx, Direction};
    use crate::verify::verify;

    /// A block that has to get a pin of two voxels, of which one is beyond the skin.
    fn job(hollow: impl Fn([usize; 3]) -> bool + Sync) -> Job {
        let pin = |v: [usize; 3]| (v[0], v[1]) == (12, 14) && (18..20).contains(&v[2]);
        block_job(|v| block(v) && !hollow(v), |v| block(v) || pin(v), |_| true)
    }

    #[test]
    fn a_pin_smaller_than_any_block_is_printed_in_the_end() {
        let job = job(|_| false);
        let (plan, report) = plan(&job, &Options::default(), &Ctx::quiet()).unwrap();
        assert_eq!(plan.steps.len(), 1);
        assert_eq!(report.standing.class, 0);
        let verdict = verify(&job, plan, &Ctx::quiet()).unwrap();
        assert!(verdict.passed(), "{:?}", verdict.rules);
    }

    /// With a hollow that no nozzle gets into the pin alone is half of what is missing.
    #[test]
    fn crumbs_are_printed_only_if_that_leaves_as_little_as_asked() {
        let job = job(|v| v.iter().zip([14, 13, 8]).all(|(c, m)| c.abs_diff(m) < 2));
        let (setting, coarse) = (Setting::new(&job), Coarse::of(&job));
        let added = job.target.minus(&job.initial);
        let core = added.minus(&setting.skin(&job.initial));
        assert_eq!(core.count(), 2);
        let wanted = Wanted {
            state: &job.initial,
            added: &added,
            core: &core,
            preferred: &[Direction::Z],
            samples: 20,
            patience: Patience::Endless,
        };
        let ctx = &Ctx::quiet();
        let usual = || print_blocks(&setting, &coarse, &wanted, &[], ctx).unwrap();
        assert!(usual().unreached.and(&core).count() == 2);
        let all = print_crumbs(&setting, &coarse, &wanted, usual(), leaves_none, ctx).unwrap();
        assert_eq!(all.steps.len(), usual().steps.len());
        let half = print_crumbs(&setting, &coarse, &wanted, usual(), no_more_than_half, ctx);
        assert_eq!(half.unwrap().unreached.and(&core).count(), 1);
    }
}
