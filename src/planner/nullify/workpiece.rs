//! The state M of INV Sec. 2.1 with the bookkeeping that answers "can the cutter get there" in
//! constant time: the top of every column, the ends of every row, the bounds of the whole.
//!
//! Only the top layer K is ever eroded and only voxels below it are ever accreted. Row ends are
//! therefore kept for layers below K alone, where they only ever widen; column tops and bounds
//! are exact.

use super::operation::Orientation;
use crate::voxel::BitGrid;

/// A voxel of the padded grid: one layer of [`OUTSIDE`] around the domain.
pub(super) type Cell = u32;

pub(super) const EMPTY: u8 = 0;
pub(super) const SOLID: u8 = 1;
/// Beyond the domain: never solid, never to be filled.
pub(super) const OUTSIDE: u8 = 2;

pub(super) struct Workpiece {
    dims: [i32; 3],
    /// Steps of a cell index along y and z.
    stride: [i32; 2],
    cells: Vec<u8>,
    /// Highest solid voxel of a column; −1 without any.
    tops: Vec<i32>,
    /// First and last solid x of the rows (y, z); (nx, −1) without any.
    x_ends: Vec<(i32, i32)>,
    /// First and last solid y of the rows (x, z).
    y_ends: Vec<(i32, i32)>,
    slabs: [Slabs; 2],
    /// K: the highest layer with solid voxels, as the layer loop sets it.
    pub top: i32,
    /// L in voxels.
    pub length: i32,
}

/// How many voxels each slab across one axis holds, and which slabs are the outermost.
struct Slabs {
    counts: Vec<u32>,
    first: i32,
    last: i32,
}

/// What [`Workpiece::undo`] needs to take back one accretion.
pub(super) struct Undo {
    cell: Cell,
    top: i32,
    x_ends: (i32, i32),
    y_ends: (i32, i32),
    bounds: [(i32, i32); 2],
}

impl Slabs {
    fn new(n: usize) -> Slabs {
        Slabs { counts: vec![0; n], first: n as i32, last: -1 }
    }

    fn add(&mut self, i: i32) {
        self.counts[i as usize] += 1;
        self.first = self.first.min(i);
        self.last = self.last.max(i);
    }

    fn remove(&mut self, i: i32) {
        self.counts[i as usize] -= 1;
        while self.first <= self.last && self.counts[self.first as usize] == 0 {
            self.first += 1;
        }
        while self.last >= self.first && self.counts[self.last as usize] == 0 {
            self.last -= 1;
        }
        if self.first > self.last {
            (self.first, self.last) = (self.counts.len() as i32, -1);
        }
    }
}

impl Workpiece {
    /// The state `solid` for a cutter of `length` voxels. The caller has checked that every axis
    /// has fewer than 2¹⁶ voxels and the padded grid fewer than 2³¹.
    pub fn new(solid: &BitGrid, length: u32) -> Workpiece {
        let dims = solid.dims();
        let [nx, ny, nz] = dims;
        let padded = (nx + 2) * (ny + 2) * (nz + 2);
        let mut w = Workpiece {
            dims: dims.map(|n| n as i32),
            stride: [(nx + 2) as i32, ((nx + 2) * (ny + 2)) as i32],
            cells: vec![OUTSIDE; padded],
            tops: vec![-1; nx * ny],
            x_ends: vec![(nx as i32, -1); ny * nz],
            y_ends: vec![(ny as i32, -1); nx * nz],
            slabs: [Slabs::new(nx), Slabs::new(ny)],
            top: -1,
            length: i32::try_from(length).unwrap_or(i32::MAX / 2).min(i32::MAX / 2),
        };
        for z in 0..nz {
            for y in 0..ny {
                let first = w.cell([0, y as i32, z as i32]) as usize;
                w.cells[first..first + nx].fill(EMPTY);
            }
        }
        for v in solid.iter_ones() {
            let v = v.map(|c| c as i32);
            w.insert(w.cell(v), v);
            w.top = w.top.max(v[2]);
        }
        w
    }

    pub fn cell(&self, [x, y, z]: [i32; 3]) -> Cell {
        (x + 1 + self.stride[0] * (y + 1) + self.stride[1] * (z + 1)) as Cell
    }

    pub fn voxel(&self, cell: Cell) -> [i32; 3] {
        let (c, [row, layer]) = (cell as i32, self.stride);
        [c % row - 1, c % layer / row - 1, c / layer - 1]
    }

    pub fn dims(&self) -> [i32; 3] {
        self.dims
    }

    /// Cells of the padded grid.
    pub fn len(&self) -> usize {
        self.cells.len()
    }

    pub fn height(&self, cell: Cell) -> i32 {
        cell as i32 / self.stride[1] - 1
    }

    pub fn solid(&self, cell: Cell) -> bool {
        self.cells[cell as usize] == SOLID
    }

    pub fn empty(&self, cell: Cell) -> bool {
        self.cells[cell as usize] == EMPTY
    }

    /// The five cells that carry a deposit at `cell` (Def. 2.5), the one straight below first.
    pub fn carriers(&self, cell: Cell) -> [Cell; 5] {
        let (c, [row, layer]) = (cell as i32, self.stride);
        let below = c - layer;
        [below, below - 1, below + 1, below - row, below + row].map(|c| c as Cell)
    }

    /// The five cells that `cell` carries.
    pub fn carried_by(&self, cell: Cell) -> [Cell; 5] {
        let (c, [row, layer]) = (cell as i32, self.stride);
        let above = c + layer;
        [above, above - 1, above + 1, above - row, above + row].map(|c| c as Cell)
    }

    /// How far in from the side of the domain the cutter comes to `cell`; 0 from above or not at
    /// all.
    pub fn depth(&self, cell: Cell) -> i32 {
        let [x, y, _] = self.voxel(cell);
        match self.access(cell) {
            None | Some(Orientation::Down) => 0,
            Some(Orientation::PlusX) => x + 1,
            Some(Orientation::MinusX) => self.dims[0] - x,
            Some(Orientation::PlusY) => y + 1,
            Some(Orientation::MinusY) => self.dims[1] - y,
        }
    }

    /// The eight neighbours in the same layer.
    pub fn beside(&self, cell: Cell) -> [Cell; 8] {
        let (c, row) = (cell as i32, self.stride[0]);
        [-1, 1, -row, row, -row - 1, -row + 1, row - 1, row + 1].map(|o| (c + o) as Cell)
    }

    /// 𝒩: the eighteen face and edge neighbours.
    pub fn neighbours(&self, cell: Cell) -> [Cell; 18] {
        let c = cell as i32;
        self.offsets().map(|o| (c + o) as Cell)
    }

    /// Offsets to 𝒩: below, beside, above.
    pub fn offsets(&self) -> [i32; 18] {
        let [r, l] = self.stride;
        [
            -l,
            -l - 1,
            -l + 1,
            -l - r,
            -l + r,
            -1,
            1,
            -r,
            r,
            -r - 1,
            -r + 1,
            r - 1,
            r + 1,
            l,
            l - 1,
            l + 1,
            l - r,
            l + r,
        ]
    }

    /// An orientation in which the cutter could remove `cell`, were it solid (Def. 2.4): its row
    /// is free on the tool's side and nothing lies beyond the tool's length.
    pub fn access(&self, cell: Cell) -> Option<Orientation> {
        let [x, y, z] = self.voxel(cell);
        let [nx, ny, _] = self.dims;
        if self.tops[(x + nx * y) as usize] < z && self.top < z + self.length {
            return Some(Orientation::Down);
        }
        let (first, last) = self.x_ends[(y + ny * z) as usize];
        if x < first && self.slabs[0].first > x - self.length {
            return Some(Orientation::PlusX);
        }
        if x > last && self.slabs[0].last < x + self.length {
            return Some(Orientation::MinusX);
        }
        let (first, last) = self.y_ends[(x + nx * z) as usize];
        if y < first && self.slabs[1].first > y - self.length {
            return Some(Orientation::PlusY);
        }
        if y > last && self.slabs[1].last < y + self.length {
            return Some(Orientation::MinusY);
        }
        None
    }

    /// Whether `cell` lies just under the top layer and the cutter reaches it whatever else is
    /// accreted: from above where nothing stands over it, or at the side of the domain.
    pub fn always_open(&self, cell: Cell) -> bool {
        let [x, y, z] = self.voxel(cell);
        let [nx, ny, _] = self.dims;
        let at_side = x == 0 || y == 0 || x == nx - 1 || y == ny - 1;
        z == self.top - 1 && (at_side || self.tops[(x + nx * y) as usize] < z)
    }

    fn insert(&mut self, cell: Cell, [x, y, z]: [i32; 3]) {
        let [nx, ny, _] = self.dims;
        self.cells[cell as usize] = SOLID;
        let top = &mut self.tops[(x + nx * y) as usize];
        *top = (*top).max(z);
        let widen = |ends: &mut (i32, i32), at: i32| *ends = (ends.0.min(at), ends.1.max(at));
        widen(&mut self.x_ends[(y + ny * z) as usize], x);
        widen(&mut self.y_ends[(x + nx * z) as usize], y);
        self.slabs[0].add(x);
        self.slabs[1].add(y);
    }

    /// Makes `cell` solid.
    pub fn accrete(&mut self, cell: Cell) -> Undo {
        let v @ [x, y, z] = self.voxel(cell);
        let [nx, ny, _] = self.dims;
        let undo = Undo {
            cell,
            top: self.tops[(x + nx * y) as usize],
            x_ends: self.x_ends[(y + ny * z) as usize],
            y_ends: self.y_ends[(x + nx * z) as usize],
            bounds: [0, 1].map(|a| (self.slabs[a].first, self.slabs[a].last)),
        };
        self.insert(cell, v);
        undo
    }

    /// Takes back accretions, the last first.
    pub fn undo(&mut self, log: impl DoubleEndedIterator<Item = Undo>) {
        let [nx, ny, _] = self.dims;
        for u in log.rev() {
            let [x, y, z] = self.voxel(u.cell);
            self.cells[u.cell as usize] = EMPTY;
            self.tops[(x + nx * y) as usize] = u.top;
            self.x_ends[(y + ny * z) as usize] = u.x_ends;
            self.y_ends[(x + nx * z) as usize] = u.y_ends;
            for (slabs, (at, bounds)) in self.slabs.iter_mut().zip([x, y].into_iter().zip(u.bounds))
            {
                slabs.counts[at as usize] -= 1;
                (slabs.first, slabs.last) = bounds;
            }
        }
    }

    /// Empties a voxel of the top layer.
    pub fn erode(&mut self, cell: Cell) {
        let [x, y, z] = self.voxel(cell);
        self.cells[cell as usize] = EMPTY;
        let mut below = cell as i32 - self.stride[1];
        let mut top = z - 1;
        while top >= 0 && self.cells[below as usize] != SOLID {
            below -= self.stride[1];
            top -= 1;
        }
        self.tops[(x + self.dims[0] * y) as usize] = top;
        self.slabs[0].remove(x);
        self.slabs[1].remove(y);
    }

    /// The solid cells of layer z, row by row, every other row backward.
    pub fn layer(&self, z: i32) -> Vec<Cell> {
        let [nx, ny, _] = self.dims;
        let mut cells = Vec::new();
        for y in 0..ny {
            let first = self.cell([0, y, z]);
            let from = cells.len();
            let row = first..first + nx as Cell;
            cells.extend(row.filter(|c| self.cells[*c as usize] == SOLID));
            if y % 2 == 1 {
                cells[from..].reverse();
            }
        }
        cells
    }
}
