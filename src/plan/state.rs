use super::{Job, Plan, StepKind};
use crate::voxel::BitGrid;

/// What a plan leaves, by definition of its steps.
#[derive(Clone, Debug)]
pub struct End {
    /// The last state.
    pub state: BitGrid,
    /// Old material that was never removed.
    pub reused: BitGrid,
    /// Everything any step removed.
    pub removed: BitGrid,
    /// Everything any step added.
    pub added: BitGrid,
    /// In the last state but not in the target.
    pub excess: BitGrid,
    /// In the target but not in the last state.
    pub deficit: BitGrid,
}

/// Applies the steps in order.
pub fn end_state(job: &Job, plan: &Plan) -> End {
    let mut state = job.initial.clone();
    let mut reused = job.initial.clone();
    let mut removed = BitGrid::new(job.frame.dims);
    let mut added = BitGrid::new(job.frame.dims);
    for step in &plan.steps {
        match step.kind {
            StepKind::Subtractive => {
                state.subtract(&step.region);
                reused.subtract(&step.region);
                removed.union_with(&step.region);
            }
            StepKind::Additive => {
                state.union_with(&step.region);
                added.union_with(&step.region);
            }
        }
    }
    let excess = state.minus(&job.target);
    let deficit = job.target.minus(&state);
    reused.intersect_with(&job.target);
    End { state, reused, removed, added, excess, deficit }
}
