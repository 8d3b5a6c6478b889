//! Replays operations on single voxels in the order of fabrication and holds each against its
//! rule at its moment (INV Defs. 2.5, 2.6; `docs/RULES.md`, operations).
//!
//! Reach is read off bit rows along x, y and z. Stability after a cut is exact: every solid voxel
//! has a parent among its neighbours, and parents lead to the base layer. A cut leaves only the
//! voxels whose parent it was to be re-hung; a neighbour serves when its own line of parents
//! reaches the base without them, else what hangs there is searched through until one does. What
//! finds none is loose. A re-hanging walks lines as long as the part is high; the search is rare.

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

const NOBODY: u32 = u32::MAX;

struct Replay {
    dims: [usize; 3],
    along: [Rows; 3],
    /// Solid voxels in each slab across x, y, z, and which slabs have any.
    counts: [Vec<u32>; 3],
    slabs: [Rows; 3],
    /// The neighbour each solid voxel hangs on; itself in the base layer.
    parent: Vec<u32>,
    /// Marks of the search at hand.
    seen: Vec<u32>,
    search: u32,
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
    let end = BitGrid::from_fn(target.dims(), |v| replay.solid(replay.index(v)));
    let (excess, deficit) = (end.minus(target).count(), target.minus(&end).count());
    if excess + deficit > 0 {
        return Err(OperationFault::End { excess, deficit });
    }
    Ok(())
}

impl Replay {
    fn new(initial: &BitGrid, length: usize) -> Result<Replay, OperationFault> {
        let dims @ [nx, ny, nz] = initial.dims();
        let n = nx * ny * nz;
        let mut r = Replay {
            dims,
            along: [Rows::new(nx, ny * nz), Rows::new(ny, nx * nz), Rows::new(nz, nx * ny)],
            counts: dims.map(|n| vec![0; n]),
            slabs: dims.map(|n| Rows::new(n, 1)),
            parent: vec![NOBODY; n],
            seen: vec![0; n],
            search: 0,
            length,
        };
        let mut open = Vec::new();
        for v in initial.iter_ones() {
            r.put(v, true);
            if v[2] == 0 {
                let i = r.index(v);
                r.parent[i] = i as u32;
                open.push(v);
            }
        }
        while let Some(v) = open.pop() {
            for q in r.neighbours(v) {
                let i = r.index(q);
                if r.solid(i) && r.parent[i] == NOBODY {
                    r.parent[i] = r.index(v) as u32;
                    open.push(q);
                }
            }
        }
        match initial.iter_ones().find(|v| r.parent[r.index(*v)] == NOBODY) {
            Some(voxel) => Err(OperationFault::Unstable { voxel }),
            None => Ok(r),
        }
    }

    fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        x + self.dims[0] * (y + self.dims[1] * z)
    }

    fn voxel(&self, i: usize) -> [usize; 3] {
        let [nx, ny, _] = self.dims;
        [i % nx, i / nx % ny, i / nx / ny]
    }

    fn solid(&self, i: usize) -> bool {
        let [x, y, z] = self.voxel(i);
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

    /// Face and edge neighbours inside the box.
    fn neighbours(&self, v: [usize; 3]) -> impl Iterator<Item = [usize; 3]> + use<> {
        let dims = self.dims;
        (0..27usize).filter_map(move |i| {
            let o = [i % 3, i / 3 % 3, i / 9];
            let off_axes = o.iter().filter(|c| **c != 1).count();
            let mut q = [0; 3];
            for a in 0..3 {
                q[a] = (v[a] + o[a]).checked_sub(1).filter(|c| *c < dims[a])?;
            }
            (off_axes == 1 || off_axes == 2).then_some(q)
        })
    }

    fn apply(&mut self, time: usize, op: &Operation) -> Result<(), OperationFault> {
        let (voxel, v) = (op.voxel, op.voxel.map(usize::from));
        if (0..3).any(|a| v[a] >= self.dims[a]) {
            return Err(OperationFault::Outside { time, voxel });
        }
        let i = self.index(v);
        let ways: &[Orientation] = match &op.deed {
            Deed::Add => return self.add(time, voxel, i),
            Deed::Cut(way) => std::slice::from_ref(way),
            Deed::CutAnyhow => &Orientation::ALL,
        };
        if !self.solid(i) {
            return Err(OperationFault::Absent { time, voxel });
        }
        if !ways.iter().any(|way| self.reaches(*way, v)) {
            return Err(OperationFault::Unreached { time, voxel });
        }
        self.put(v, false);
        self.parent[i] = NOBODY;
        if self.rehang(i, v) { Ok(()) } else { Err(OperationFault::Loose { time, voxel }) }
    }

    /// Def. 2.5.
    fn add(&mut self, time: usize, voxel: [u16; 3], i: usize) -> Result<(), OperationFault> {
        let v @ [_, _, z] = voxel.map(usize::from);
        if self.solid(i) {
            return Err(OperationFault::Filled { time, voxel });
        }
        if self.slabs[2].any_from(0, z + 1) {
            return Err(OperationFault::Below { time, voxel });
        }
        let below = self.neighbours(v).filter(|q| q[2] < z).map(|q| self.index(q));
        let carrier = if z == 0 { Some(i) } else { below.into_iter().find(|q| self.solid(*q)) };
        let Some(carrier) = carrier else {
            return Err(OperationFault::Uncarried { time, voxel });
        };
        self.put(v, true);
        self.parent[i] = carrier as u32;
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

    /// Whether the line of parents from `i` ends in the base layer without meeting a voxel that
    /// hangs on nothing.
    fn stands(&self, mut i: usize) -> bool {
        loop {
            match self.parent[i] {
                NOBODY => return false,
                p if p as usize == i => return true,
                p => i = p as usize,
            }
        }
    }

    /// Finds new parents for what hung on the voxel just cut; false when something is loose.
    fn rehang(&mut self, cut: usize, v: [usize; 3]) -> bool {
        let mut orphans: Vec<usize> = self
            .neighbours(v)
            .map(|q| self.index(q))
            .filter(|q| self.parent[*q] == cut as u32)
            .collect();
        orphans.iter().for_each(|o| self.parent[*o] = NOBODY);
        while !orphans.is_empty() {
            let before = orphans.len();
            let mut left = Vec::new();
            for &o in &orphans {
                let near = self.neighbours(self.voxel(o)).map(|q| self.index(q));
                let host = near.into_iter().find(|q| self.solid(*q) && self.stands(*q));
                match host {
                    Some(host) => self.parent[o] = host as u32,
                    None => left.push(o),
                }
            }
            orphans = left;
            if orphans.len() == before {
                if !self.search_ground(orphans[0]) {
                    return false;
                }
                let parent = &self.parent;
                orphans.retain(|o| parent[*o] == NOBODY);
            }
        }
        true
    }

    /// Searches all that is connected to `start` for a voxel that stands, and hangs the way to it
    /// there.
    fn search_ground(&mut self, start: usize) -> bool {
        self.search += 1;
        self.seen[start] = self.search;
        let mut open = std::collections::VecDeque::from([start]);
        let mut came_from = std::collections::HashMap::new();
        while let Some(i) = open.pop_front() {
            for q in self.neighbours(self.voxel(i)) {
                let q = self.index(q);
                if self.seen[q] == self.search || !self.solid(q) {
                    continue;
                }
                self.seen[q] = self.search;
                came_from.insert(q, i);
                if self.stands(q) {
                    let mut host = q;
                    while let Some(&next) = came_from.get(&host) {
                        self.parent[next] = host as u32;
                        host = next;
                    }
                    return true;
                }
                open.push_back(q);
            }
        }
        false
    }
}
