//! Replays operations on single voxels in the order of fabrication and holds each against its
//! rule at its moment (INV Defs. 2.5, 2.6; `docs/RULES.md`, operations).
//!
//! Reach is read off bit rows along x, y and z; what hangs on what is kept up exactly
//! ([`super::standing`]).

use super::standing::Standing;
use crate::plan::{Deed, Operation, Orientation};
use crate::voxel::BitGrid;

/// What is wrong with an operation.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum OperationFault {
    #[error("operation {time}: voxel {voxel:?} is outside the box")]
    Outside { time: usize, voxel: [u16; 3] },
    #[error("operation {time}: voxel {voxel:?} is deposited where material is")]
    Filled { time: usize, voxel: [u16; 3] },
    #[error("operation {time}: voxel {voxel:?} is cut where nothing is")]
    Absent { time: usize, voxel: [u16; 3] },
    #[error("operation {time}: nothing below carries the deposit at {voxel:?}")]
    Uncarried { time: usize, voxel: [u16; 3] },
    #[error("operation {time}: material above the deposit at {voxel:?} meets the nozzle")]
    Below { time: usize, voxel: [u16; 3] },
    #[error("operation {time}: the cutter cannot reach {voxel:?}")]
    Unreached { time: usize, voxel: [u16; 3] },
    #[error("operation {time}: without {voxel:?} something is loose")]
    Loose { time: usize, voxel: [u16; 3] },
    #[error("the initial state is not stable: {voxel:?} is not connected to the base")]
    Unstable { voxel: [usize; 3] },
    #[error("the operations end with {excess} voxels too many and {deficit} too few")]
    End { excess: usize, deficit: usize },
}

/// Sets of solid voxels by rows along one axis.
struct Rows {
    words: usize,
    bits: Vec<u64>,
}

impl Rows {
    fn new(length: usize, rows: usize) -> Rows {
        let words = length.div_ceil(64);
        Rows { words, bits: vec![0; words * rows] }
    }

    fn set(&mut self, row: usize, at: usize, solid: bool) {
        let word = &mut self.bits[row * self.words + at / 64];
        if solid { *word |= 1 << (at % 64) } else { *word &= !(1 << (at % 64)) }
    }

    fn row(&self, row: usize) -> &[u64] {
        &self.bits[row * self.words..(row + 1) * self.words]
    }

    /// Whether the row has a bit at `from` or later.
    fn any_from(&self, row: usize, from: usize) -> bool {
        let row = self.row(row);
        let first = from / 64;
        first < row.len()
            && (row[first] >> (from % 64) != 0 || row[first + 1..].iter().any(|w| *w != 0))
    }

    /// Whether the row has a bit before `to`.
    fn any_before(&self, row: usize, to: usize) -> bool {
        let row = self.row(row);
        let last = (to / 64).min(row.len());
        row[..last].iter().any(|w| *w != 0)
            || (last < row.len() && row[last] & ((1u64 << (to % 64)) - 1) != 0)
    }
}

struct Replay {
    dims: [usize; 3],
    along: [Rows; 3],
    /// Solid voxels in each slab across x, y, z, and which slabs have any.
    counts: [Vec<u32>; 3],
    slabs: [Rows; 3],
    standing: Standing,
    length: usize,
}

/// Replays `operations` from `initial` with a cutter of `length` voxels; they must end in `target`.
///
/// # Errors
/// The first operation that breaks a rule, or how far the end is from the target.
///
/// # Panics
/// When the two grids have different dimensions.
pub fn verify_operations(
    initial: &BitGrid,
    target: &BitGrid,
    operations: &[Operation],
    length: u32,
) -> Result<(), OperationFault> {
    assert_eq!(initial.dims(), target.dims(), "both states lie on one grid");
    let mut replay = Replay::new(initial, length as usize)?;
    for (time, op) in operations.iter().enumerate() {
        replay.apply(time, op)?;
    }
    let end = BitGrid::from_fn(target.dims(), |v| replay.solid(v));
    let (excess, deficit) = (end.minus(target).count(), target.minus(&end).count());
    if excess + deficit > 0 {
        return Err(OperationFault::End { excess, deficit });
    }
    Ok(())
}

impl Replay {
    fn new(initial: &BitGrid, length: usize) -> Result<Replay, OperationFault> {
        let dims @ [nx, ny, nz] = initial.dims();
        let mut r = Replay {
            dims,
            along: [Rows::new(nx, ny * nz), Rows::new(ny, nx * nz), Rows::new(nz, nx * ny)],
            counts: dims.map(|n| vec![0; n]),
            slabs: dims.map(|n| Rows::new(n, 1)),
            standing: Standing::new(dims, (0..nz).map(|z| z == 0).collect()),
            length,
        };
        initial.iter_ones().for_each(|v| r.put(v, true));
        if r.standing.added(initial.iter_ones()) {
            return Ok(r);
        }
        let loose = initial.iter_ones().find(|v| !r.standing.has(*v));
        Err(OperationFault::Unstable { voxel: loose.unwrap_or_default() })
    }

    fn solid(&self, [x, y, z]: [usize; 3]) -> bool {
        self.along[0].row(y + self.dims[1] * z)[x / 64] >> (x % 64) & 1 == 1
    }

    fn put(&mut self, [x, y, z]: [usize; 3], solid: bool) {
        let [nx, ny, _] = self.dims;
        self.along[0].set(y + ny * z, x, solid);
        self.along[1].set(x + nx * z, y, solid);
        self.along[2].set(x + nx * y, z, solid);
        for (axis, at) in [x, y, z].into_iter().enumerate() {
            let count = &mut self.counts[axis][at];
            *count = if solid { *count + 1 } else { *count - 1 };
            self.slabs[axis].set(0, at, *count > 0);
        }
    }

    fn apply(&mut self, time: usize, op: &Operation) -> Result<(), OperationFault> {
        let (voxel, v) = (op.voxel, op.voxel.map(usize::from));
        if (0..3).any(|a| v[a] >= self.dims[a]) {
            return Err(OperationFault::Outside { time, voxel });
        }
        let ways: &[Orientation] = match &op.deed {
            Deed::Add => return self.add(time, voxel),
            Deed::Cut(way) => std::slice::from_ref(way),
            Deed::CutAnyhow => &Orientation::ALL,
        };
        if !self.solid(v) {
            return Err(OperationFault::Absent { time, voxel });
        }
        if !ways.iter().any(|way| self.reaches(*way, v)) {
            return Err(OperationFault::Unreached { time, voxel });
        }
        self.put(v, false);
        if self.standing.removed([v].into_iter()) {
            Ok(())
        } else {
            Err(OperationFault::Loose { time, voxel })
        }
    }

    /// Def. 2.5.
    fn add(&mut self, time: usize, voxel: [u16; 3]) -> Result<(), OperationFault> {
        let v @ [_, _, z] = voxel.map(usize::from);
        if self.solid(v) {
            return Err(OperationFault::Filled { time, voxel });
        }
        if self.slabs[2].any_from(0, z + 1) {
            return Err(OperationFault::Below { time, voxel });
        }
        let mut below = self.standing.neighbours(v).filter(|q| q[2] < z);
        if z > 0 && !below.any(|q| self.standing.has(q)) {
            return Err(OperationFault::Uncarried { time, voxel });
        }
        self.put(v, true);
        // A carrier is a neighbour that stands.
        self.standing.added([v].into_iter());
        Ok(())
    }

    /// Whether the tool of Def. 2.4 meets nothing.
    fn reaches(&self, way: Orientation, [x, y, z]: [usize; 3]) -> bool {
        let [nx, ny, _] = self.dims;
        let (axis, row, at, from_above) = match way {
            Orientation::Down => (2, x + nx * y, z, true),
            Orientation::MinusX => (0, y + ny * z, x, true),
            Orientation::PlusX => (0, y + ny * z, x, false),
            Orientation::MinusY => (1, x + nx * z, y, true),
            Orientation::PlusY => (1, x + nx * z, y, false),
        };
        let (rows, slabs) = (&self.along[axis], &self.slabs[axis]);
        if from_above {
            !rows.any_from(row, at + 1) && !slabs.any_from(0, at.saturating_add(self.length))
        } else {
            let beyond = (at + 1).saturating_sub(self.length);
            !rows.any_before(row, at) && !slabs.any_before(0, beyond)
        }
    }
}
