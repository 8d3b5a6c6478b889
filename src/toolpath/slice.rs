//! Plane sections of a voxel region as polygons.
//!
//! Method: occupancy is interpolated trilinearly between voxel centres, sampled on a lattice of the
//! plane across the direction, and its level set at one half traced by marching squares. The cells
//! that any voxel of a storey can reach are known beforehand; the others are empty without a look.
//!
//! Guarantees: closed outlines, outer ones anticlockwise, holes clockwise; a flat face of the region lies on
//! the voxel face. Not guaranteed: edges sharper than a voxel, which the level set rounds.

use super::image::Lattice;
use crate::base::{DVec2, DVec3};
use crate::voxel::{BitGrid, Frame};
use std::borrow::Cow;
use std::ops::Range;

pub(super) type Outline = Vec<DVec2>;

/// Level of the outline. Just under one half, so that a plane exactly between a solid and an empty
/// voxel counts as solid instead of tracing noise.
const LEVEL: f32 = 0.499;

/// Trilinear occupancy at a world point.
fn occupancy(region: &BitGrid, frame: &Frame, p: DVec3) -> f32 {
    let g = frame.grid_from_world(p) - DVec3::splat(0.5);
    let low = g.floor();
    let t = (g - low).as_vec3();
    let base = [low.x as i64, low.y as i64, low.z as i64];
    let mut sum = 0.0;
    for corner in 0..8 {
        let bit = |a: usize| (corner >> a & 1) as i64;
        let weight = |a: usize, t: f32| if bit(a) == 1 { t } else { 1.0 - t };
        let w = weight(0, t.x) * weight(1, t.y) * weight(2, t.z);
        if w > 0.0 && region.get_or_empty([base[0] + bit(0), base[1] + bit(1), base[2] + bit(2)]) {
            sum += w;
        }
    }
    sum
}

/// A region made ready to be cut at many heights.
pub(super) struct Slices<'a> {
    region: Cow<'a, BitGrid>,
    frame: &'a Frame,
    lattice: Lattice,
    /// Lattice cells over or under voxel centres, storey by storey, a pitch each.
    cells: BitGrid,
    /// Height at which the first storey begins.
    low: f64,
    /// How far from its centre a voxel is felt: cells along u and along v, and mm of height.
    reach: ([usize; 2], f64),
}

impl<'a> Slices<'a> {
    /// Outlines close where `lattice` reaches a cell beyond the region.
    pub fn new(region: Cow<'a, BitGrid>, frame: &'a Frame, lattice: Lattice) -> Slices<'a> {
        let (h, plane) = (frame.pitch, lattice.plane);
        // A voxel is felt within a pitch along each grid axis.
        let felt = |d: DVec3| h * d.abs().element_sum();
        // Its centre lies up to half a cell from that of its cell.
        let cells = |d: DVec3| (felt(d) / lattice.s + 0.5 + 1e-6).floor() as usize;
        let reach = ([cells(plane.u), cells(plane.v)], felt(plane.d) + 1e-6 * h);
        let heights = || region.iter_ones().map(|v| plane.height(frame.center(v)));
        let (low, high) =
            heights().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), z| (a.min(z), b.max(z)));
        let storeys = if low <= high { ((high - low) / h) as usize + 1 } else { 0 };
        let last = DVec2::new(lattice.n[0] as f64, lattice.n[1] as f64) - DVec2::ONE;
        let mut near = BitGrid::new([lattice.n[0], lattice.n[1], storeys]);
        for v in region.iter_ones() {
            let p = frame.center(v);
            // From outside it is felt no farther in than from the rim.
            let g = ((plane.across(p) - lattice.origin) / lattice.s).round();
            let g = g.clamp(DVec2::ZERO, last);
            near.set([g.x as usize, g.y as usize, ((plane.height(p) - low) / h) as usize], true);
        }
        Slices { region, frame, lattice, cells: near, low, reach }
    }

    /// Outlines of the region in the plane at height `z`.
    pub fn at(&self, z: f64) -> Vec<Outline> {
        let Some((cells, rows)) = self.felt(z) else { return Vec::new() };
        let (l, nx) = (&self.lattice, self.lattice.n[0]);
        let mut values = vec![0.0; l.cells()];
        for (j, row) in rows.clone().zip(cells.chunks(self.cells.words_per_row())) {
            for (w, bits) in row.iter().enumerate() {
                let mut rest = *bits;
                while rest != 0 {
                    let i = w * 64 + rest.trailing_zeros() as usize;
                    rest &= rest - 1;
                    let p = l.world([i, j], z);
                    values[i + nx * j] = occupancy(&self.region, self.frame, p);
                }
            }
        }
        outlines(l, &values, rows)
    }

    /// Rows of cells, and the words of those, in which voxels are felt at height `z`.
    fn felt(&self, z: f64) -> Option<(Vec<u64>, Range<usize>)> {
        let [nx, ny, storeys] = self.cells.dims();
        let ([across, along], height) = self.reach;
        let h = self.frame.pitch;
        let (first, last) = ((z - height - self.low) / h, (z + height - self.low) / h);
        if storeys == 0 || last < 0.0 || first >= storeys as f64 {
            return None;
        }
        let (first, last) = (first.max(0.0) as usize, (last as usize).min(storeys - 1));
        let words = self.cells.words_per_row();
        let mut all = vec![0u64; words * ny];
        let (mut from, mut to) = (ny, 0);
        for (k, y) in (first..=last).flat_map(|k| (0..ny).map(move |y| (k, y))) {
            let row = self.cells.row(y, k);
            if row.iter().all(|w| *w == 0) {
                continue;
            }
            let (a, b) = (y.saturating_sub(along), (y + along + 1).min(ny));
            (from, to) = (from.min(a), to.max(b));
            for out in all[a * words..b * words].chunks_mut(words) {
                out.iter_mut().zip(row).for_each(|(o, r)| *o |= r);
            }
        }
        if from >= to {
            return None;
        }
        let mut out = all[from * words..to * words].to_vec();
        for row in out.chunks_mut(words) {
            for _ in 0..across {
                widen(row);
            }
            // Nothing beyond the last cell.
            let spare = words * 64 - nx;
            row[words - 1] &= !0 >> spare;
        }
        Some((out, from..to))
    }
}

/// Sets the neighbours of a row's bits.
fn widen(row: &mut [u64]) {
    let mut before = 0;
    for i in 0..row.len() {
        let (own, next) = (row[i], row.get(i + 1).copied().unwrap_or(0));
        row[i] = own | own << 1 | own >> 1 | before >> 63 | next << 63;
        before = own;
    }
}

/// For each case of marching squares (bits: corners 00, 10, 11, 01) its segments as edge pairs,
/// the inside to the left. Edges: 0 bottom, 1 right, 2 top, 3 left. Two solid corners that meet
/// only diagonally stay apart.
const SEGMENTS: [&[(usize, usize)]; 16] = [
    &[],
    &[(0, 3)],
    &[(1, 0)],
    &[(1, 3)],
    &[(2, 1)],
    &[(0, 3), (2, 1)],
    &[(2, 0)],
    &[(2, 3)],
    &[(3, 2)],
    &[(0, 2)],
    &[(1, 0), (3, 2)],
    &[(1, 2)],
    &[(3, 1)],
    &[(0, 1)],
    &[(3, 0)],
    &[],
];

/// Level lines of values on the lattice's cells, all of which are zero but in `rows`.
fn outlines(lattice: &Lattice, values: &[f32], rows: Range<usize>) -> Vec<Outline> {
    let [nx, ny] = lattice.n;
    // A line runs between a row with values and the next.
    let rows = rows.start.saturating_sub(1)..(rows.end + 1).min(ny);
    const NONE: u32 = u32::MAX;
    // Edge 2·i runs from cell i to the right, 2·i + 1 upward; `next` follows the outline.
    let mut next = vec![NONE; 2 * values.len()];
    for j in rows.start..rows.end.min(ny.saturating_sub(1)) {
        for i in 0..nx.saturating_sub(1) {
            let at = i + nx * j;
            let corners = [at, at + 1, at + nx + 1, at + nx];
            let case =
                (0..4).filter(|k| values[corners[*k]] > LEVEL).map(|k| 1 << k).sum::<usize>();
            let edges = [2 * at, 2 * (at + 1) + 1, 2 * (at + nx), 2 * at + 1];
            for (from, to) in SEGMENTS[case] {
                next[edges[*from]] = edges[*to] as u32;
            }
        }
    }
    let point = |edge: usize| {
        let (a, b) = (edge / 2, edge / 2 + if edge.is_multiple_of(2) { 1 } else { nx });
        let t = (LEVEL - values[a]) / (values[b] - values[a]);
        let (p, q) = (lattice.uv(lattice.cell_of_index(a)), lattice.uv(lattice.cell_of_index(b)));
        p.lerp(q, f64::from(t))
    };
    let mut out = Vec::new();
    for start in 2 * nx * rows.start..2 * nx * rows.end {
        let mut outline = Vec::new();
        let mut at = start;
        while next[at] != NONE {
            outline.push(point(at));
            let to = next[at] as usize;
            next[at] = NONE;
            at = to;
        }
        if outline.len() >= 3 {
            out.push(outline);
        }
    }
    out
}

/// Signed area, mm²; positive for anticlockwise outlines.
pub(super) fn area(outlines: &[Outline]) -> f64 {
    let one =
        |o: &Outline| (0..o.len()).map(|i| o[i].perp_dot(o[(i + 1) % o.len()])).sum::<f64>() / 2.0;
    outlines.iter().map(one).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Direction;

    fn sample(region: &BitGrid, frame: &Frame, d: Direction, z: f64) -> f64 {
        let plane = d.image_plane();
        let far = DVec2::splat(40.0);
        let middle = plane.across(frame.bounds().center());
        let l = Lattice::over(frame, plane, frame.pitch, middle - far, middle + far);
        let found = Slices::new(Cow::Borrowed(region), frame, l).at(z);
        assert_eq!(found, plainly(region, frame, &l, z));
        area(&found)
    }

    /// Every cell looked at.
    fn plainly(region: &BitGrid, frame: &Frame, l: &Lattice, z: f64) -> Vec<Outline> {
        let at = |i: usize| l.world(l.cell_of_index(i), z);
        let values: Vec<f32> = (0..l.cells()).map(|i| occupancy(region, frame, at(i))).collect();
        outlines(l, &values, 0..l.n[1])
    }

    #[test]
    fn cells_that_are_passed_over_are_empty() {
        let mut rng = crate::base::rng(3, 0);
        let frame = Frame { pitch: 0.5, dims: [37, 21, 18], origin: DVec3::new(0.3, -4.0, 2.0) };
        for (share, turn) in [(2, DVec3::Z), (9, DVec3::NEG_Y), (1, DVec3::new(0.3, -0.8, 0.5))] {
            let mut region = BitGrid::new(frame.dims);
            for v in BitGrid::from_fn(frame.dims, |_| true).iter_ones() {
                region.set(v, rand::RngExt::random_range(&mut rng, 0..100) < share);
            }
            let plane = Direction::new(turn).unwrap().image_plane();
            let middle = plane.across(frame.bounds().center());
            for (s, far) in [(0.5, 25.0), (0.25, 17.0), (0.5, 4.0)] {
                let far = DVec2::splat(far);
                let l = Lattice::over(&frame, plane, s, middle - far, middle + far);
                let slices = Slices::new(Cow::Borrowed(&region), &frame, l);
                let top = plane.height(frame.bounds().center());
                for k in -60..=60 {
                    let z = top + f64::from(k) * 0.21;
                    assert_eq!(slices.at(z), plainly(&region, &frame, &l, z), "{turn} {z}");
                }
            }
        }
    }

    #[test]
    fn a_block_has_its_own_area_from_every_side() {
        let frame = Frame { pitch: 0.5, dims: [60, 50, 40], origin: DVec3::ZERO };
        let block = BitGrid::from_fn(frame.dims, |[x, y, z]| {
            (10..50).contains(&x) && (10..40).contains(&y) && (5..35).contains(&z)
        });
        // Marching squares cuts each of the four corners by h²/8.
        let cut = 4.0 * 0.25 / 8.0;
        for (d, want) in [(Direction::Z, 300.0), (Direction::NEG_X, 225.0), (Direction::Y, 300.0)] {
            let z = d.dot(frame.bounds().center());
            assert!((sample(&block, &frame, d, z + 0.1) - want + cut).abs() < 0.3, "{d:?}");
        }
        let tilted = Direction::new(DVec3::new(0.0, 1.0, 1.0)).unwrap();
        let z = tilted.dot(frame.bounds().center());
        // The middle section of a 15 × 15 square prism across its diagonal.
        let want = 20.0 * 15.0 * 2f64.sqrt();
        assert!((sample(&block, &frame, tilted, z) - want).abs() < 0.03 * want);
    }

    #[test]
    fn a_hole_turns_the_other_way() {
        let frame = Frame { pitch: 1.0, dims: [20, 20, 3], origin: DVec3::ZERO };
        let ring = BitGrid::from_fn(frame.dims, |[x, y, _]| {
            let inner = (8..12).contains(&x) && (8..12).contains(&y);
            (2..18).contains(&x) && (2..18).contains(&y) && !inner
        });
        let got = sample(&ring, &frame, Direction::Z, 1.5);
        assert!((got - (256.0 - 16.0)).abs() < 0.1, "{got}");
    }
}
