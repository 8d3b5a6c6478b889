//! From operations to steps: consecutive operations of one kind and orientation make one region
//! removed or added by one tool from one direction (INV Sec. 5.1 groups them further into patches
//! of a layer, which the toolpaths do).
//!
//! A step asks less than its operations: a cut is judged against the state after the whole step,
//! a deposit against the state before it and its own lower layers.

use super::{NullifyError, PlanError, Sequence};
use crate::base::Direction;
use crate::machine::Holding;
use crate::plan::{Deed, Job, MOST_STATE_BITS, Operation, Origin, Plan, Step, StepKind};
use crate::voxel::BitGrid;

/// Where each run of operations of one deed ends.
pub(super) fn runs(operations: &[Operation]) -> Vec<&[Operation]> {
    operations.chunk_by(|a, b| a.deed == b.deed).collect()
}

/// Changes between deposits and cuts.
pub(super) fn switches(operations: &[Operation]) -> usize {
    let adds = |op: &Operation| op.deed == Deed::Add;
    operations.windows(2).filter(|w| adds(&w[0]) != adds(&w[1])).count()
}

/// The plan of a sequence; without steps when their regions would not fit a plan file.
pub(super) fn steps(job: &Job, sequence: &Sequence) -> Result<Plan, PlanError> {
    let missing = |kind| PlanError::NoTool { kind };
    let cutter = &job.cutters.first().ok_or(missing("subtractive"))?.name;
    let nozzle = &job.nozzles.first().ok_or(missing("additive"))?.name;
    let runs = runs(&sequence.operations);
    let dims = job.frame.dims;
    let bits = dims[0].div_ceil(64) as u64 * 64 * (dims[1] * dims[2]) as u64;
    if bits.saturating_mul(runs.len() as u64) > MOST_STATE_BITS {
        return Err(NullifyError::TooManySteps { steps: runs.len(), dims }.into());
    }
    let mut blocks = [0usize; 2];
    let mut steps = Vec::with_capacity(runs.len());
    for run in runs {
        let (kind, tool, direction) = match run[0].deed {
            Deed::Cut(way) => (StepKind::Subtractive, cutter, way.spindle()),
            Deed::Add | Deed::CutAnyhow => (StepKind::Additive, nozzle, Direction::Z),
        };
        let mut region = BitGrid::new(dims);
        for op in run {
            region
                .set(std::array::from_fn(|a| sequence.corner[a] + usize::from(op.voxel[a])), true);
        }
        let block = &mut blocks[usize::from(kind == StepKind::Additive)];
        steps.push(Step {
            kind,
            tool: tool.clone(),
            direction,
            holding: 0,
            region,
            block: *block,
            origin: Origin::default(),
        });
        *block += 1;
    }
    Ok(Plan { holdings: vec![Holding::AS_CLAMPED], steps })
}
