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

/// The voxel of an operation in the job's grid.
fn place(op: &Operation, sequence: &Sequence) -> [usize; 3] {
    std::array::from_fn(|a| sequence.corner[a] + usize::from(op.voxel[a]))
}

/// The rows of the job's grid from the first to the last with a voxel of these operations.
fn rows(run: &[Operation], sequence: &Sequence, dims: [usize; 3]) -> std::ops::Range<usize> {
    let row = |op: &Operation| {
        let [_, y, z] = place(op, sequence);
        y + dims[1] * z
    };
    let first = run.iter().map(row).min().unwrap_or(0);
    first..run.iter().map(row).max().map_or(first, |last| last + 1)
}

/// Bits that the regions of these runs take in memory and in a plan file.
fn region_bits(runs: &[&[Operation]], sequence: &Sequence, dims: [usize; 3]) -> u64 {
    let row_bits = dims[0].div_ceil(64) as u64 * 64;
    runs.iter().map(|run| rows(run, sequence, dims).len() as u64 * row_bits).sum()
}

/// The plan of a sequence; without steps when their regions would not fit a plan file.
pub(super) fn steps(job: &Job, sequence: &Sequence) -> Result<Plan, PlanError> {
    let missing = |kind| PlanError::NoTool { kind };
    let cutter = &job.cutters.first().ok_or(missing("subtractive"))?.name;
    let nozzle = &job.nozzles.first().ok_or(missing("additive"))?.name;
    let runs = runs(&sequence.operations);
    let dims = job.frame.dims;
    if region_bits(&runs, sequence, dims) > MOST_STATE_BITS {
        return Err(NullifyError::TooManySteps { steps: runs.len(), dims }.into());
    }
    let mut blocks = [0usize; 2];
    let mut steps = Vec::with_capacity(runs.len());
    for run in runs {
        let (kind, tool, direction) = match run[0].deed {
            Deed::Cut(way) => (StepKind::Subtractive, cutter, way.spindle()),
            Deed::Add | Deed::CutAnyhow => (StepKind::Additive, nozzle, Direction::Z),
        };
        let mut region = BitGrid::with_rows(dims, rows(run, sequence, dims));
        run.iter().for_each(|op| region.set(place(op, sequence), true));
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

#[cfg(test)]
mod tests {
    use super::super::{Options, operations};
    use super::*;
    use crate::base::Ctx;

    /// Bits of the regions of a ball on a foot, `n` voxels across.
    fn bits(n: usize) -> u64 {
        let ball = BitGrid::from_fn([n; 3], |v| {
            let [x, y, z] = v.map(|c| 2.0 * (c as f64 + 0.5) / n as f64 - 1.0);
            x * x + y * y + z * z < 0.9 || (z < 0.0 && x * x + y * y < 0.04)
        });
        let operations = operations(&ball, &Options::default(), &Ctx::quiet()).unwrap();
        let sequence = Sequence {
            corner: [0; 3],
            dims: [n; 3],
            supports: 0,
            switches: 0,
            reused: 0,
            tries: 1,
            operations,
        };
        region_bits(&runs(&sequence.operations), &sequence, [n; 3])
    }

    /// What the refusal of a plan with too many steps advises.
    #[test]
    fn a_coarser_grid_has_smaller_regions() {
        // Rows of 64 bits at least: both are whole words.
        let (coarse, fine) = (bits(32), bits(64));
        assert!(fine > 4 * coarse, "{coarse} {fine}");
    }
}
