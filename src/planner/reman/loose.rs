//! What of an initial part hangs on nothing on the grid: tips that touch the rest by a corner.
//!
//! Method. No step may leave anything loose, so what is loose from the beginning goes with the first: an over-cut along
//! one direction that takes all of it, and of what else is to be removed only what is near. Where that is too
//! little, for the cutter has to get there, it may take any of it.
//!
//! Guarantees: those of cuts; after it all that stands is held. Not guaranteed: that there is such a cut. A loose body
//! that no cutter takes at once, or that is more than a tip, is for the verifier to name.

use super::Options;
use super::round::volumes;
use super::setting::Setting;
use crate::access::over_cut;
use crate::base::Ctx;
use crate::plan::{Action, Origin, Step, StepKind};
use crate::planner::PlanError;
use crate::region::steady;
use crate::voxel::{BitGrid, distance_within};

/// How far from what is loose more is taken with it, mm: about as far as a cutter is wide.
const NEAR_MM: f64 = 3.0;

/// Share of the initial part that may be loose: more is a body of its own or the part itself in the air, which no cut
/// mends, and every try looks at all of it.
const MOST_LOOSE: f64 = 1e-2;

/// The cut that takes all that is loose in the initial part; none where nothing or much is, or no one cut does.
pub fn first_cut(
    setting: &Setting,
    options: &Options,
    ctx: &Ctx,
) -> Result<Option<Step>, PlanError> {
    let job = setting.job;
    let held = |solid: &BitGrid| steady(solid, &job.frame, job.rules.holding, job.rules.grip_mm);
    let loose = job.initial.minus(&held(&job.initial));
    if loose.is_empty() || loose.count() as f64 > MOST_LOOSE * job.initial.count() as f64 {
        return Ok(None);
    }
    let removable = volumes(job, &[]).removed;
    let near = removable.and(&distance_within(&loose, NEAR_MM / job.frame.pitch));
    let mut directions = setting.axes(0);
    directions.extend(setting.sampled(0, options.directions));
    let fixed = setting.fixed(0, &job.initial);
    for rest in [near, removable] {
        for direction in &directions {
            for tool in setting.with_last_resort().cutters() {
                ctx.check()?;
                let cut = over_cut(&job.frame, &job.initial, &rest, &fixed, tool, *direction);
                let stands = job.initial.minus(&cut.region);
                if !loose.is_subset_of(&cut.region) || held(&stands) != stands {
                    continue;
                }
                tracing::debug!(loose = loose.count(), cut = cut.region.count(), "loose");
                return Ok(Some(Step {
                    kind: StepKind::Subtractive,
                    tool: tool.name.clone(),
                    direction: *direction,
                    holding: 0,
                    region: cut.region,
                    block: 0,
                    origin: Origin { plane: None, action: Some(Action::OC) },
                }));
            }
        }
    }
    tracing::debug!(loose = loose.count(), "loose, and no cut takes it");
    Ok(None)
}

#[cfg(test)]
mod tests {
    use super::super::local_tests::{block, block_job, bowl};
    use super::super::plan;
    use super::*;
    use crate::plan::Job;
    use crate::verify::verify;

    /// A block with something on top of it and a bowl in its top.
    fn job(more: impl Fn([usize; 3]) -> bool + Sync) -> Job {
        let target = |v: [usize; 3]| block(v) && v[0] < 28;
        block_job(|v| block(v) && !bowl(v) || more(v), target, |_| true)
    }

    #[test]
    fn a_tip_that_hangs_by_a_corner_goes_with_the_first_step() {
        let tip = [31, 27, 18];
        let job = job(|v| v == tip);
        let (plan, report) = plan(&job, &Options::default(), &Ctx::quiet()).unwrap();
        assert!(plan.steps[0].region.get(tip));
        let after = job.initial.minus(&plan.steps[0].region);
        assert_eq!(steady(&after, &job.frame, job.rules.holding, job.rules.grip_mm), after);
        assert_eq!(report.standing.class, 0);
        let verdict = verify(&job, plan, &Ctx::quiet()).unwrap();
        assert!(verdict.passed(), "{:?}", verdict.rules);
    }

    #[test]
    fn a_part_of_one_piece_gets_no_cut_for_it() {
        let job = job(|_| false);
        let made = first_cut(&Setting::new(&job), &Options::default(), &Ctx::quiet());
        assert!(made.unwrap().is_none());
    }
}
