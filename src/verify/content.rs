//! Rule `content`: a cut takes only what is there, a deposit adds only what is not, and every
//! step does something. A region on another grid than the job's has no content to speak of.

use super::tally::Tally;
use super::{Rule, RuleResult};
use crate::plan::{Job, Step, StepKind};
use crate::voxel::BitGrid;

pub(super) fn check(job: &Job, index: usize, step: &Step, before: &BitGrid) -> RuleResult {
    if step.region.is_empty() {
        return refused(Some(index), "empty regions", 1.0, "the region is empty; drop the step");
    }
    let (wrong, means, why) = match step.kind {
        StepKind::Subtractive => {
            (step.region.minus(before), "voxels cut where nothing is", "the cut leaves the part")
        }
        StepKind::Additive => {
            (step.region.and(before), "voxels added where material is", "the deposit enters it")
        }
    };
    let tally = Tally { count: wrong.count(), first: wrong.iter_ones().next() };
    tally.result(Rule::Content, index, means, &job.frame, || why.into())
}

/// Whether the job's own solids lie on its frame, and the frame has a size.
pub(super) fn grids(job: &Job) -> Result<(), RuleResult> {
    let f = &job.frame;
    if !(f.pitch > 0.0 && f.pitch.is_finite() && f.origin.is_finite()) {
        let what = format!("pitch {} mm and origin {} mm are no grid", f.pitch, f.origin);
        return Err(refused(None, "mm pitch", f.pitch, &what));
    }
    for (name, grid) in [("initial", &job.initial), ("target", &job.target)] {
        if grid.dims() != f.dims {
            let what = format!(
                "the {name} part is on a grid of {:?}, the job's has {:?}",
                grid.dims(),
                f.dims
            );
            return Err(refused(None, "grids that do not fit", 1.0, &what));
        }
    }
    Ok(())
}

/// Whether the region lies on the job's frame.
pub(super) fn region_grid(job: &Job, index: usize, step: &Step) -> Result<(), RuleResult> {
    if step.region.dims() == job.frame.dims {
        return Ok(());
    }
    let what = format!(
        "the region is on a grid of {:?}, the job's has {:?}",
        step.region.dims(),
        job.frame.dims
    );
    Err(refused(Some(index), "grids that do not fit", 1.0, &what))
}

fn refused(step: Option<usize>, means: &'static str, figure: f64, detail: &str) -> RuleResult {
    RuleResult {
        rule: Rule::Content,
        step,
        passed: false,
        figure,
        figure_means: means,
        detail: detail.into(),
    }
}
