//! The state M of INV Sec. 2.1 with the bookkeeping that answers "can the cutter get there" in
//! constant time: the top of every column, the ends of every row, the bounds of the whole.
//!
//! Only the top layer K is ever eroded and only voxels below it are ever accreted. Row ends are
//! therefore kept for layers below K alone, where they only ever widen; column tops and bounds
//! are exact.

use crate::plan::Orientation;
use crate::voxel::BitGrid;

/// A voxel of the padded grid: one layer of [`OUTSIDE`] around the domain.
pub(super) type Cell = u32;

pub(super) const EMPTY: u8 = 0;
pub(super) const SOLID: u8 = 1;
/// Beyond the domain: never solid, never to be filled.
pub(super) const OUTSIDE: u8 = 2;

/// A set of orientations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Ways(u8);

impl Ways {
    pub const ALL: Ways = Ways(0b11111);

    pub fn is_empty(self) -> bool {
        self.0 == 0
    }

    pub fn and(self, other: Ways) -> Ways {
        Ways(self.0 & other.0)
    }

    /// The one orientation with this place in [`Orientation::ALL`].
    pub fn only(i: usize) -> Ways {
        Ways(1 << i)
    }

    pub fn without(self, other: Ways) -> Ways {
        Ways(self.0 & !other.0)
    }

    pub fn any(self) -> Option<Orientation> {
        Orientation::ALL.into_iter().enumerate().find(|(i, _)| self.0 >> i & 1 == 1).map(|o| o.1)
    }
}

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
    slabs: [Slabs; 3],
    /// K: the highest layer with solid voxels, as the layer loop sets it.
    pub top: i32,
    /// L in voxels.
    pub length: i32,
    /// No voxel below this layer is accreted: what stands there is reused as it is.
    pub floor: i32,
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
    bounds: [(i32, i32); 3],
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
            slabs: [Slabs::new(nx), Slabs::new(ny), Slabs::new(nz)],
            top: -1,
            floor: 0,
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

    /// The highest layer with material; −1 without any.
    pub fn highest(&self) -> i32 {
        self.slabs[2].last
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
        match self.ways(cell).any() {
            None | Some(Orientation::Down) => 0,
            Some(Orientation::PlusX) => x + 1,
            Some(Orientation::MinusX) => self.dims[0] - x,
            Some(Orientation::PlusY) => y + 1,
            Some(Orientation::MinusY) => self.dims[1] - y,
        }
    }

    /// Steps along the lines of cells whose tool a cell is in, each with the place in
    /// [`Orientation::ALL`] of the orientation: what lies below is cut from above, and so on.
    pub fn lines(&self) -> [(i32, usize); 5] {
        let [row, layer] = self.stride;
        [(-layer, 0), (1, 1), (-1, 2), (row, 3), (-row, 4)]
    }

    /// The orientation in which `cell` would be in the way of a cut at `other`, if any.
    pub fn bars(&self, cell: Cell, other: Cell) -> Option<Ways> {
        let ([x, y, z], [ox, oy, oz]) = (self.voxel(cell), self.voxel(other));
        let way = match (ox - x, oy - y, oz - z) {
            (0, 0, d) if d < 0 => 0,
            (d, 0, 0) if d > 0 => 1,
            (_, 0, 0) => 2,
            (0, d, 0) if d > 0 => 3,
            (0, _, 0) => 4,
            _ => return None,
        };
        Some(Ways::only(way))
    }

    /// Whether the cell lies beyond the domain.
    pub fn outside(&self, cell: Cell) -> bool {
        self.cells[cell as usize] == OUTSIDE
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

    /// The orientations in which the cutter could remove `cell`, solid or not (Def. 2.4): its row
    /// is free on the tool's side and nothing lies beyond the tool's length.
    pub fn ways(&self, cell: Cell) -> Ways {
        let v @ [x, y, z] = self.voxel(cell);
        if z < self.floor {
            return Ways(0);
        }
        let [nx, ny, _] = self.dims;
        let mut ways = u8::from(self.open_above(v));
        let (first, last) = self.x_ends[(y + ny * z) as usize];
        ways |= u8::from(x <= first && self.slabs[0].first > x - self.length) << 1;
        ways |= u8::from(x >= last && self.slabs[0].last < x + self.length) << 2;
        let (first, last) = self.y_ends[(x + nx * z) as usize];
        ways |= u8::from(y <= first && self.slabs[1].first > y - self.length) << 3;
        ways |= u8::from(y >= last && self.slabs[1].last < y + self.length) << 4;
        Ways(ways)
    }

    /// Whether the cutter could remove `cell` in any orientation.
    pub fn access(&self, cell: Cell) -> bool {
        let v @ [x, y, z] = self.voxel(cell);
        if z < self.floor {
            return false;
        }
        if self.open_above(v) {
            return true;
        }
        let [nx, ny, _] = self.dims;
        let x_ends = self.x_ends[(y + ny * z) as usize];
        let y_ends = self.y_ends[(x + nx * z) as usize];
        (x <= x_ends.0 && self.slabs[0].first > x - self.length)
            || (x >= x_ends.1 && self.slabs[0].last < x + self.length)
            || (y <= y_ends.0 && self.slabs[1].first > y - self.length)
            || (y >= y_ends.1 && self.slabs[1].last < y + self.length)
    }

    fn open_above(&self, [x, y, z]: [i32; 3]) -> bool {
        self.tops[(x + self.dims[0] * y) as usize] <= z && self.top < z + self.length
    }

    /// Whether `cell` lies just under the top layer and the cutter reaches it whatever else is
    /// accreted: from above where nothing stands over it, or at the side of the domain.
    pub fn always_open(&self, cell: Cell) -> bool {
        let [x, y, z] = self.voxel(cell);
        let [nx, ny, _] = self.dims;
        let at_side = x == 0 || y == 0 || x == nx - 1 || y == ny - 1;
        z == self.top - 1 && (at_side || self.tops[(x + nx * y) as usize] < z)
    }

    /// Whether `cell` lies beyond all material along x or y, so that it may end up in the cutter's
    /// half-space for others.
    pub fn widens(&self, cell: Cell) -> bool {
        let [x, y, _] = self.voxel(cell);
        [x, y].into_iter().zip(&self.slabs).any(|(at, s)| at < s.first || at > s.last)
    }

    fn insert(&mut self, cell: Cell, [x, y, z]: [i32; 3]) {
        let [nx, ny, _] = self.dims;
        self.cells[cell as usize] = SOLID;
        let top = &mut self.tops[(x + nx * y) as usize];
        *top = (*top).max(z);
        let widen = |ends: &mut (i32, i32), at: i32| *ends = (ends.0.min(at), ends.1.max(at));
        widen(&mut self.x_ends[(y + ny * z) as usize], x);
        widen(&mut self.y_ends[(x + nx * z) as usize], y);
        for (slabs, at) in self.slabs.iter_mut().zip([x, y, z]) {
            slabs.add(at);
        }
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
            bounds: [0, 1, 2].map(|a| (self.slabs[a].first, self.slabs[a].last)),
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
            let at = [x, y, z].into_iter().zip(u.bounds);
            for (slabs, (at, bounds)) in self.slabs.iter_mut().zip(at) {
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
        for (slabs, at) in self.slabs.iter_mut().zip([x, y, z]) {
            slabs.remove(at);
        }
    }

    /// Empties any voxel and keeps column tops, row ends and the top layer exact.
    pub fn remove(&mut self, cell: Cell) {
        self.erode_any(cell);
        let [x, y, z] = self.voxel(cell);
        let [nx, ny, _] = self.dims;
        let row = self.cell([0, y, z]);
        let at = (y + ny * z) as usize;
        self.x_ends[at] = shrunk(self.x_ends[at], x, nx, |i| self.solid(row + i as Cell));
        let first = self.cell([x, 0, z]);
        let at = (x + nx * z) as usize;
        let step = self.stride[0];
        let solid = |i: i32| self.solid((first as i32 + i * step) as Cell);
        self.y_ends[at] = shrunk(self.y_ends[at], y, ny, solid);
        self.top = self.slabs[2].last;
    }

    fn erode_any(&mut self, cell: Cell) {
        let [x, y, z] = self.voxel(cell);
        let column = (x + self.dims[0] * y) as usize;
        let top = self.tops[column];
        self.erode(cell);
        if top > z {
            self.tops[column] = top;
        }
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

/// The ends of a row of `n` after the voxel at `gone` went.
fn shrunk(ends: (i32, i32), gone: i32, n: i32, solid: impl Fn(i32) -> bool) -> (i32, i32) {
    let (mut first, mut last) = ends;
    if gone == first {
        while first <= last && !solid(first) {
            first += 1;
        }
    }
    if gone == last {
        while last >= first && !solid(last) {
            last -= 1;
        }
    }
    if first > last { (n, -1) } else { (first, last) }
}
