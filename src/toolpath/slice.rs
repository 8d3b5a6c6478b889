//! Plane sections of a voxel region as polygons.
//!
//! Method: occupancy is interpolated trilinearly between voxel centres, sampled on a lattice of the
//! plane across the direction, and its level set at one half traced by marching squares.
//!
//! Guarantees: closed outlines, outer ones anticlockwise, holes clockwise; a flat face of the region lies on
//! the voxel face. Not guaranteed: edges sharper than a voxel, which the level set rounds.

use super::image::Lattice;
use crate::base::{DVec2, DVec3};
use crate::voxel::{BitGrid, Frame};

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

/// Outlines of the region in the plane at height `z`; `lattice` must reach a cell beyond it.
pub(super) fn section(region: &BitGrid, frame: &Frame, lattice: &Lattice, z: f64) -> Vec<Outline> {
    let values: Vec<f32> = (0..lattice.cells())
        .map(|i| occupancy(region, frame, lattice.world(lattice.cell_of_index(i), z)))
        .collect();
    outlines(lattice, &values)
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

fn outlines(lattice: &Lattice, values: &[f32]) -> Vec<Outline> {
    let [nx, ny] = lattice.n;
    const NONE: u32 = u32::MAX;
    // Edge 2·i runs from cell i to the right, 2·i + 1 upward; `next` follows the outline.
    let mut next = vec![NONE; 2 * values.len()];
    for j in 0..ny.saturating_sub(1) {
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
        let (a, b) = (edge / 2, edge / 2 + if edge % 2 == 0 { 1 } else { nx });
        let t = (LEVEL - values[a]) / (values[b] - values[a]);
        let (p, q) = (lattice.uv(lattice.cell_of_index(a)), lattice.uv(lattice.cell_of_index(b)));
        p.lerp(q, f64::from(t))
    };
    let mut out = Vec::new();
    for start in 0..next.len() {
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
        area(&section(region, frame, &l, z))
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
