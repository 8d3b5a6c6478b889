//! The lattice of tips across a direction, and heights on it.

use super::cells::Cells;
use crate::base::{Aabb, DVec2, DVec3, ImagePlane};
use crate::voxel::Frame;
use std::ops::Range;

/// Margin in mm that hides the rounding of f32 heights (parts up to metres) from the verdict.
const ROUNDING_MM: f32 = 1e-4;

/// Lowest height per lattice cell at which something holds; see [`super::cutter_map`], [`super::nozzle_map`].
pub struct DepthMap {
    pub(super) plane: ImagePlane,
    pub(super) lattice: Lattice,
    pub(super) lowest: Cells,
}

impl DepthMap {
    /// Whether the point at `p` may be cut (or deposited) along the map's direction. `p` is the
    /// centre of a voxel of the set the map was made for; of any other point the answer is no.
    #[inline]
    pub fn reaches(&self, p: DVec3) -> bool {
        self.reaches_at(self.place(p))
    }

    /// The cells' values and their numbers along u and v.
    pub(super) fn cells(&self) -> (&[f32], usize, usize) {
        (&self.lowest, self.lattice.nu, self.lattice.nv)
    }

    /// (u, v) of a point in cells and its height in mm.
    pub(super) fn place(&self, p: DVec3) -> DVec3 {
        self.lattice.place(self.plane.across(p)).extend(self.plane.height(p))
    }

    /// What a step of `mm` along x, y, z adds to [`DepthMap::place`].
    pub(super) fn steps(&self, mm: f64) -> [DVec3; 3] {
        self.lattice.steps(&self.plane, mm)
    }

    /// [`DepthMap::reaches`] of a [`DepthMap::place`].
    #[inline(always)]
    pub(super) fn reaches_at(&self, at: DVec3) -> bool {
        let cell = self.lattice.cell_at(at.truncate()).and_then(|c| self.lowest.get(c));
        cell.is_some_and(|low| at.z as f32 >= *low + ROUNDING_MM)
    }
}

/// The corners of a box.
pub(super) fn corners(b: &Aabb) -> [DVec3; 8] {
    std::array::from_fn(|i| {
        let pick = |bit: usize, lo: f64, hi: f64| if i >> bit & 1 == 0 { lo } else { hi };
        DVec3::new(pick(0, b.min.x, b.max.x), pick(1, b.min.y, b.max.y), pick(2, b.min.z, b.max.z))
    })
}

/// A window of the tip lattice of a direction, or of one whose cells are squares of its cells.
#[derive(Clone, Copy)]
pub(super) struct Lattice {
    pub spacing: f64,
    /// 1 / spacing: a cell is looked up for every point, and a division would take half the time.
    per_mm: f64,
    /// (u, v) of cell (0, 0).
    pub first: DVec2,
    pub nu: usize,
    pub nv: usize,
    /// Cells of the tip lattice along each axis of a cell.
    pub pool: usize,
    /// Number of cell (0, 0), counted from the cell that holds the frame's anchor.
    number: [i64; 2],
}

/// The nearest integer of a number below 2³¹, by the rounding of an addition.
#[inline(always)]
fn nearest(x: f64) -> i32 {
    const ONE_AND_A_HALF_TIMES_2_TO_52: f64 = 6_755_399_441_055_744.0;
    (x + ONE_AND_A_HALF_TIMES_2_TO_52).to_bits() as i32
}

impl Lattice {
    /// Cells that hold every point of the box `b` and `margin` mm around it. `pool` cells of
    /// the tip lattice, which is anchored to the frame, make one cell along each axis.
    pub fn around(
        frame: &Frame,
        b: &Aabb,
        plane: &ImagePlane,
        spacing: f64,
        margin: f64,
        pool: usize,
    ) -> Self {
        let anchor = plane.across(frame.center([0, 0, 0]));
        let (mut lo, mut hi) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        for uv in corners(b).map(|c| plane.across(c)) {
            (lo, hi) = (lo.min(uv), hi.max(uv));
        }
        let cells = pool as f64;
        let first = ((lo - anchor - DVec2::splat(margin)) / spacing).floor();
        let last = ((hi - anchor + DVec2::splat(margin)) / spacing).ceil();
        let (first, last) = ((first / cells).floor(), (last / cells).floor());
        let n = last - first + DVec2::ONE;
        // A cell's centre is that of its tips.
        let middle = DVec2::splat((cells - 1.0) / 2.0);
        Lattice {
            spacing: spacing * cells,
            per_mm: 1.0 / (spacing * cells),
            first: anchor + (first * cells + middle) * spacing,
            nu: n.x as usize,
            nv: n.y as usize,
            pool,
            number: [first.x as i64, first.y as i64],
        }
    }

    /// (u, v) of a point, mm, in cells.
    pub fn place(&self, uv: DVec2) -> DVec2 {
        (uv - self.first) * self.per_mm
    }

    /// (u, v), mm, of a [`Lattice::place`].
    #[inline(always)]
    pub fn across(&self, at: DVec2) -> DVec2 {
        self.first + at * self.spacing
    }

    /// What a step of `mm` along x, y, z adds to the place of a point (cells) and its height (mm).
    pub fn steps(&self, plane: &ImagePlane, mm: f64) -> [DVec3; 3] {
        let scale = mm * self.per_mm;
        let (u, v, d) = (plane.u * scale, plane.v * scale, plane.d * mm);
        [0, 1, 2].map(|a| DVec3::new(u[a], v[a], d[a]))
    }

    /// Whether a point at most `spread` from (u, v), mm, may lie in a cell: true of all that do.
    #[inline(always)]
    pub fn may_hold(&self, uv: DVec2, spread: DVec2) -> bool {
        let (at, spread) = (self.place(uv), spread * self.per_mm);
        // A cell reaches half a cell beyond its centre; the other half is for rounding.
        let near =
            |at: f64, spread: f64, cells: usize| at + spread >= -1.0 && at - spread <= cells as f64;
        near(at.x, spread.x, self.nu) && near(at.y, spread.y, self.nv)
    }

    /// The cell nearest to (u, v).
    #[inline]
    pub fn cell(&self, uv: DVec2) -> Option<usize> {
        self.cell_at(self.place(uv))
    }

    /// The cell nearest to a [`Lattice::place`].
    #[inline(always)]
    pub fn cell_at(&self, at: DVec2) -> Option<usize> {
        let [i, j] = [nearest(at.x), nearest(at.y)].map(|n| n as u32 as usize);
        (i < self.nu && j < self.nv).then(|| i + self.nu * j)
    }

    /// The numbers below `n` of the steps from a [`Lattice::place`] that may lie in a cell: all that do
    /// are among them.
    #[inline(always)]
    pub fn steps_within(&self, at: DVec2, step: DVec2, n: usize) -> Range<usize> {
        let (mut lo, mut hi) = (0.0f64, n as f64);
        for (a, cells) in [(0, self.nu), (1, self.nv)] {
            // A cell reaches half a cell beyond its centre; the other half is for rounding.
            let [from, to] = [-1.0 - at[a], cells as f64 - at[a]];
            if step[a] == 0.0 {
                hi = if from > 0.0 || to < 0.0 { 0.0 } else { hi };
                continue;
            }
            let [p, q] = [from / step[a], to / step[a]];
            lo = lo.max(p.min(q).floor());
            hi = hi.min(p.max(q).ceil() + 1.0);
        }
        let lo = lo as usize;
        lo..(hi.max(0.0) as usize).max(lo)
    }

    /// How far cell (0, 0) of `other`, of cells of the same size, lies from this one's.
    pub fn offset_of(&self, other: &Lattice) -> (isize, isize) {
        let by = |a: usize| (other.number[a] - self.number[a]) as isize;
        (by(0), by(1))
    }

    /// For each column and each row of a lattice of smaller cells the one of this lattice in which
    /// it lies.
    pub fn pooled(&self, fine: &Lattice) -> [Vec<usize>; 2] {
        let ratio = (self.pool / fine.pool) as i64;
        let of = |axis: usize, n: usize| {
            let first = fine.number[axis];
            let cell = |i: i64| ((first + i).div_euclid(ratio) - self.number[axis]) as usize;
            (0..n as i64).map(cell).collect()
        };
        [of(0, fine.nu), of(1, fine.nv)]
    }

    /// Per row of cells, those that the shadow of a box falls on, with a cell to spare.
    pub fn under_box(&self, b: &Aabb, plane: &ImagePlane) -> Vec<Range<usize>> {
        let at = corners(b).map(|c| (plane.across(c) - self.first) * self.per_mm);
        let near = |j: usize, p: &DVec2| (p.y - j as f64).abs() <= 1.0;
        (0..self.nv)
            .map(|j| {
                let (mut lo, mut hi) = (f64::INFINITY, f64::NEG_INFINITY);
                let mut take = |u: f64| (lo, hi) = (lo.min(u), hi.max(u));
                at.iter().filter(|p| near(j, p)).for_each(|p| take(p.x));
                // Where each segment between two corners crosses the row's band. Those inside the
                // shadow do no harm.
                for (i, p) in at.iter().enumerate() {
                    for q in &at[i + 1..] {
                        for y in [j as f64 - 1.0, j as f64 + 1.0] {
                            let t = (y - p.y) / (q.y - p.y);
                            if (0.0..=1.0).contains(&t) {
                                take(p.x + t * (q.x - p.x));
                            }
                        }
                    }
                }
                if lo > hi {
                    return 0..0;
                }
                let from = (lo - 1.0).floor().max(0.0) as usize;
                from..((hi + 2.0).ceil().max(0.0) as usize).min(self.nu).max(from)
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Direction;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn no_step_that_lies_in_a_cell_is_left_out(
            d in (-1.0f64..1.0, -1.0f64..1.0, 0.1f64..1.0),
            at in (-40.0f64..40.0, -40.0f64..40.0),
            size in 1.0f64..9.0,
        ) {
            let d = Direction::new(DVec3::new(d.0, d.1, d.2)).unwrap();
            let frame = Frame { pitch: 0.5, dims: [8; 3], origin: DVec3::ZERO };
            let plane = d.image_plane();
            let b = Aabb { min: DVec3::ZERO, max: DVec3::splat(size) };
            let lattice = Lattice::around(&frame, &b, &plane, 0.25, 1.0, 2);
            let (at, step) = (DVec2::from(at), lattice.steps(&plane, 0.5)[0].truncate());
            let within = lattice.steps_within(at, step, 100);
            prop_assert!(within.is_empty() || within.end <= 101);
            for x in 0..100 {
                let inside = lattice.cell_at(at + step * x as f64).is_some();
                prop_assert!(!inside || within.contains(&x), "{x} not in {within:?}");
            }
        }
    }
}
