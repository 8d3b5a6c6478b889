//! The judge of plans: replays every step and holds it against `docs/RULES.md`, to the letter.
//!
//! Method: voxel centres against the analytic tool, in plain code that shares nothing with the
//! planners beyond grid, mesh, tool, workholding and plan types. One file a rule: [`Rule`] names
//! them. Tool access is decided by branch and bound over a pyramid of obstacle heights, which skips
//! only what provably cannot collide; the points that remain are tested one by one.
//!
//! Guarantees: a [`Verified`] plan obeys every rule, and only this module makes one. The verdict,
//! its figures and the first offender named are the same at any thread count. Whatever cannot be
//! judged (a region on another grid, a tool that is not the job's) is refused, never passed over.
//! Not guaranteed: anything about the shape between voxel centres; that skin is machinable, which
//! the finishing paths answer; that a plan without faults is a good one.
//!
//! Lengths are mm, volumes mm³, voxels are counted. Heights and radii are compared with
//! [`ROUNDING_MM`] to spare.

mod access_additive;
mod access_subtractive;
mod bodies;
mod content;
mod end;
mod machine_limits;
mod operations;
mod profile;
mod replay;
mod skyline;
mod stability;
mod standing;
mod support;
mod tally;
#[cfg(test)]
mod tests;
mod thin;
mod tiplattice;
mod verdict;

pub use end::{Measures, Place, Residual};
pub use operations::{OperationFault, verify_operations};
pub use verdict::{Rule, RuleResult, Verdict, Verified};

use crate::base::{Cancelled, Ctx};
use crate::machine::ToolKind;
use crate::plan::{Job, Plan, Step, StepKind};
use replay::Replay;

/// Slack in mm with which heights and radii are compared, in the plan's favour.
///
/// Voxel centres often lie exactly on a tool's edge (a radius of six pitches, along an axis), where
/// two orders of the same sum differ in the last digits: about 1e-13 mm at 1 m. Much smaller than
/// 1e-12 and rounding refuses valid plans; much larger than 1e-6 and it would hide real contact.
pub const ROUNDING_MM: f64 = 1e-9;

/// Judges a plan against every rule.
///
/// # Errors
/// [`Cancelled`] when the user stops the run; a plan that breaks rules is a [`Verdict`], no error.
pub fn verify(job: &Job, plan: Plan, ctx: &Ctx) -> Result<Verdict, Cancelled> {
    let mut results = Vec::new();
    if let Err(fault) = content::grids(job) {
        results.push(fault);
        return Ok(Verdict { rules: results, measures: Measures::unknown(job.frame.dims), plan });
    }
    ctx.begin("verify", plan.steps.len() as u64);
    let mut replay = Replay::new(job, &plan);
    let mut watch = stability::Watch::new(job, plan.steps.len());
    for (index, step) in plan.steps.iter().enumerate() {
        ctx.check()?;
        if let Err(fault) = content::region_grid(job, index, step) {
            results.push(fault);
            continue;
        }
        replay.take(step);
        results.push(content::check(job, index, step, &replay.before));
        results.push(machine_limits::check(job, &plan, index, replay.held()));
        results.extend(tool_access(job, index, step, &replay, ctx)?);
        if step.kind == StepKind::Additive {
            results.push(support::check(job, index, step, &replay.before));
        }
        results.push(watch.check(job, index, step, &replay.after));
        ctx.advance(1);
    }
    let measures = end::measure(job, &replay);
    results.push(end::check(job, &measures));
    ctx.end();
    Ok(Verdict { rules: results, plan, measures })
}

/// None when the step's tool is not one that can be judged; the machine rule then says why.
fn tool_access(
    job: &Job,
    index: usize,
    step: &Step,
    replay: &Replay,
    ctx: &Ctx,
) -> Result<Option<RuleResult>, Cancelled> {
    let Ok(tool) = machine_limits::tool_of(job, step) else { return Ok(None) };
    Ok(Some(match tool.kind {
        ToolKind::Subtractive => {
            let site = replay.site(job, step);
            access_subtractive::result(index, step, tool, &site, ctx)?
        }
        ToolKind::Additive => {
            let site = replay.site(job, step);
            access_additive::result(index, step, tool, job.rules.nozzle_dip_mm, &site, ctx)?
        }
    }))
}
