//! The way down into material: along the pass that begins there, never straight.
//!
//! Method: from the height at which material begins, the tip goes out along the first cells of the
//! pass and back again, falling all the way, as often as it takes to be down at the first cell
//! without falling steeper than [`SLOPE`]; a pass too short for that is widened by the cells beside
//! it that lie as deep. Guarantees: no height below that of its cell; the last is the first cell at
//! its own. Not guaranteed: a ramp where the cutter has room for nothing else than to go straight.

use super::image::{Cell, Image, Lattice, Profile};

/// Fall of a ramp over its length: 6°, which centre-cutting flat and ball ends take in plastic,
/// wax and aluminium. Steeper loads the end's middle, which does not cut; flatter only takes time.
pub(super) const SLOPE: f64 = 0.1;

/// Depths up to this go straight, mm: less than a finishing stock.
pub(super) const LEAST_MM: f64 = 0.05;

/// Ways out and back at most; where more would be needed the ramp is steeper.
const MOST_TRIPS: usize = 12;

/// Cells beside a short pass that are looked at, mm from its beginning.
const BESIDE_MM: f64 = 1.5;

/// The tops of what is still to cut, seen along the axis.
pub(super) struct Stock {
    lattice: Lattice,
    tops: Vec<f32>,
    /// Cells under the edge and the edge's height over the tip there.
    edge: Vec<(i64, i64, f32)>,
}

impl Stock {
    /// `tops` are the highest voxel centres to cut, `half` what stands over them.
    pub fn new(tops: &Image, edge: &Profile, half: f64) -> Stock {
        let raised = tops.data.iter().map(|z| z + half as f32).collect();
        Stock { lattice: tops.lattice, tops: raised, edge: edge.offsets() }
    }

    /// The tip stood at a height over a cell, cutting.
    pub fn cut(&mut self, cell: Cell, z: f64) {
        for (di, dj, k) in &self.edge {
            if let Some(at) = beyond(&self.lattice, cell, *di, *dj) {
                self.tops[at] = self.tops[at].min(z as f32 + k);
            }
        }
    }

    /// Height at which a tip over cell `i` meets material; −∞ where there is none.
    pub fn over(&self, i: usize) -> f32 {
        let cell = self.lattice.cell_of_index(i);
        let meets = self.edge.iter().filter_map(|(di, dj, k)| {
            beyond(&self.lattice, cell, *di, *dj).map(|at| self.tops[at] - k)
        });
        meets.fold(f32::NEG_INFINITY, f32::max)
    }
}

/// Index of the cell so many cells away, if it is one.
fn beyond(lattice: &Lattice, cell: Cell, di: i64, dj: i64) -> Option<usize> {
    let (i, j) = (cell[0] as i64 + di, cell[1] as i64 + dj);
    let inside = i >= 0 && j >= 0 && i < lattice.n[0] as i64 && j < lattice.n[1] as i64;
    inside.then(|| i as usize + lattice.n[0] * j as usize)
}

/// A way down at the first cell of a pass.
pub(super) struct Ramp {
    /// Height at which it begins, over the first cell.
    pub from: f64,
    /// Cells and heights after that; empty when the way is straight.
    pub way: Vec<(Cell, f64)>,
}

/// The ramp of a pass: `z` are its heights, infinite where nothing is to cut; `open` those at
/// which a tip meets material, over any cell. It begins at `high` at most.
pub(super) fn ramp(
    lattice: &Lattice,
    pass: &[Cell],
    z: &dyn Fn(usize) -> f32,
    open: &dyn Fn(usize) -> f32,
    high: f64,
) -> Ramp {
    let height = |c: Cell| f64::from(z(lattice.index(c)));
    let begins = |c: Cell| f64::from(open(lattice.index(c))).max(height(c));
    let first = pass[0];
    let end = height(first);
    let straight = Ramp { from: begins(first).min(high).max(end), way: Vec::new() };
    if straight.from - end <= LEAST_MM {
        return straight;
    }
    let half = (straight.from - end) / SLOPE / 2.0;
    let mut cells = level_part(lattice, pass, &height, half);
    if reach(lattice, &cells) < BESIDE_MM.min(half) {
        let wider = beside(lattice, first, &height);
        if reach(lattice, &wider) > reach(lattice, &cells) {
            cells = wider;
        }
    }
    let length = reach(lattice, &cells);
    if length == 0.0 {
        return straight;
    }
    let from = cells.iter().map(|c| begins(*c)).fold(straight.from, f64::max).min(high).max(end);
    let drop = from - end;
    let trips = (drop / SLOPE / (2.0 * length)).ceil().clamp(1.0, MOST_TRIPS as f64);
    let whole = 2.0 * length * trips;
    let (mut way, mut gone, mut at) = (Vec::new(), 0.0, first);
    for _ in 0..trips as usize {
        for c in cells[1..].iter().chain(cells[..cells.len() - 1].iter().rev()) {
            gone += apart(lattice, at, *c);
            at = *c;
            way.push((*c, (from - drop * gone / whole).max(height(*c))));
        }
    }
    Ramp { from, way }
}

fn apart(lattice: &Lattice, a: Cell, b: Cell) -> f64 {
    lattice.uv(a).distance(lattice.uv(b))
}

/// Length of a row of cells, mm.
fn reach(lattice: &Lattice, cells: &[Cell]) -> f64 {
    cells.windows(2).map(|w| apart(lattice, w[0], w[1])).sum()
}

/// The beginning of a pass, up to a length, as far as it has no steps in it.
fn level_part(
    lattice: &Lattice,
    pass: &[Cell],
    height: &dyn Fn(Cell) -> f64,
    length: f64,
) -> Vec<Cell> {
    let (mut out, mut gone) = (vec![pass[0]], 0.0);
    for w in pass.windows(2) {
        let step = (height(w[1]) - height(w[0])).abs();
        if gone >= length || !step.is_finite() || step > 2.0 * lattice.s {
            break;
        }
        gone += apart(lattice, w[0], w[1]);
        out.push(w[1]);
    }
    out
}

/// The longest straight row of cells from a cell on that lie no higher.
fn beside(lattice: &Lattice, first: Cell, height: &dyn Fn(Cell) -> f64) -> Vec<Cell> {
    let most = (BESIDE_MM / lattice.s).ceil() as usize;
    let end = height(first);
    let mut best = vec![first];
    for (di, dj) in [(1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, 1), (-1, -1), (1, -1)] {
        let mut row = vec![first];
        let mut at = first;
        while row.len() <= most {
            let i = at[0].checked_add_signed(di).filter(|i| *i < lattice.n[0]);
            let j = at[1].checked_add_signed(dj).filter(|j| *j < lattice.n[1]);
            let Some(next) = i.zip(j).map(|(i, j)| [i, j]) else { break };
            if height(next) > end + 1e-3 {
                break;
            }
            row.push(next);
            at = next;
        }
        if reach(lattice, &row) > reach(lattice, &best) {
            best = row;
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::{DVec2, DVec3, Direction};
    use crate::voxel::Frame;

    fn lattice() -> Lattice {
        let frame = Frame { pitch: 0.5, dims: [1; 3], origin: DVec3::ZERO };
        let mut l =
            Lattice::over(&frame, Direction::Z.image_plane(), 0.5, DVec2::ZERO, DVec2::ZERO);
        l.n = [40, 40];
        l
    }

    #[test]
    fn a_ramp_falls_slowly_and_ends_where_the_pass_begins() {
        let l = lattice();
        let pass: Vec<Cell> = (5..30).map(|i| [i, 7]).collect();
        let r = ramp(&l, &pass, &|_| 1.0, &|_| 2.5, 10.0);
        assert_eq!(r.from, 2.5);
        assert_eq!(r.way.last(), Some(&(pass[0], 1.0)));
        let (mut at, mut z) = (pass[0], r.from);
        for (c, h) in &r.way {
            let length = apart(&l, at, *c);
            assert!(*h < z && z - h <= SLOPE * length * 1.001, "{c:?} {h}");
            (at, z) = (*c, *h);
        }
    }

    #[test]
    fn steps_short_passes_and_little_depth_are_seen_to() {
        let l = lattice();
        let pass: Vec<Cell> = (5..30).map(|i| [i, 7]).collect();
        // A wall after six cells: the ramp stays before it, going back and forth.
        let z = |i: usize| if l.cell_of_index(i)[0] > 10 { 6.0 } else { 1.0 };
        let r = ramp(&l, &pass, &z, &|_| 2.0, 10.0);
        assert!(r.way.len() >= 20 && r.way.iter().all(|(c, _)| c[0] <= 10));
        // A pass of one cell in a hole three cells wide uses the hole.
        let hole = |i: usize| if l.cell_of_index(i)[1] == 7 { 1.0 } else { f32::INFINITY };
        let r = ramp(&l, &pass[..1], &hole, &|_| 2.0, 10.0);
        assert!(!r.way.is_empty() && r.way.iter().all(|(c, _)| c[1] == 7));
        // As wide as the cutter: straight down. A skin: too.
        let alone = |i: usize| if l.cell_of_index(i) == [5, 7] { 1.0 } else { f32::INFINITY };
        assert!(ramp(&l, &pass[..1], &alone, &|_| 2.0, 10.0).way.is_empty());
        assert!(ramp(&l, &pass, &|_| 1.0, &|_| 1.03, 10.0).way.is_empty());
    }
}
