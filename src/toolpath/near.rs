//! Voxels at the surface of a mesh.
//!
//! Method: every triangle marks the voxels around it, once for a whole plan; large triangles are
//! halved along their longest side until the box of a piece holds little else. Guarantees: exactly
//! the voxels whose centre lies within [`NEAR_PITCH`] of a triangle that has an area, to rounding.
//! Not guaranteed: which mesh the surface is of where two come that near.

use crate::base::DVec3;
use crate::mesh::{TriMesh, closest_on_triangle};
use crate::voxel::{BitGrid, Frame};
use rayon::prelude::*;

/// A boundary voxel's centre lies this many pitches from its surface at most: √3/2.
pub(super) const NEAR_PITCH: f64 = 0.87;

/// Sides of the pieces whose boxes are searched, pitches: a piece has about as many voxels near it
/// as its box has others.
const PIECE_PITCH: f64 = 6.0;

/// Triangles that one task marks: a grid for each is what it costs.
const LEAST_TASK: usize = 4096;

/// Voxels of the frame whose centres lie within [`NEAR_PITCH`] pitches of the mesh.
pub(super) fn voxels_near(mesh: &TriMesh, frame: &Frame) -> BitGrid {
    let blank = || BitGrid::new(frame.dims);
    (0..mesh.triangles().len())
        .into_par_iter()
        .with_min_len(LEAST_TASK)
        .fold(blank, |mut near, t| {
            if mesh.area_normal(t).try_normalize().is_some() {
                mark(mesh.corners(t), frame, &mut near);
            }
            near
        })
        .reduce(blank, |mut a, b| {
            a.union_with(&b);
            a
        })
}

fn mark(t: [DVec3; 3], frame: &Frame, near: &mut BitGrid) {
    let [a, b, c] = t;
    let reach = NEAR_PITCH * frame.pitch;
    let low = frame.grid_from_world(a.min(b).min(c) - reach);
    let high = frame.grid_from_world(a.max(b).max(c) + reach);
    let last = DVec3::from_array(frame.dims.map(|n| n as f64));
    if low.cmpgt(last).any() || high.cmplt(DVec3::ZERO).any() {
        return;
    }
    let sides =
        [(a.distance(b), [c, a, b]), (b.distance(c), [a, b, c]), (c.distance(a), [b, c, a])];
    let [_, second, third] = sides;
    let longest = sides[0].0.max(second.0).max(third.0);
    if longest > PIECE_PITCH * frame.pitch {
        let (_, [apex, from, to]) = sides.into_iter().find(|s| s.0 == longest).unwrap_or(sides[0]);
        let middle = (from + to) / 2.0;
        mark([apex, from, middle], frame, near);
        mark([apex, middle, to], frame, near);
        return;
    }
    let (low, high) = (low.floor().max(DVec3::ZERO), high.ceil().min(last));
    let range = |axis: usize| low[axis] as usize..high[axis] as usize;
    for z in range(2) {
        for y in range(1) {
            for x in range(0) {
                let v = [x, y, z];
                let p = frame.center(v);
                if !near.get(v) && closest_on_triangle(p, t).distance(p) <= reach {
                    near.set(v, true);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::NearestTriangle;

    #[test]
    fn marks_what_a_search_from_each_voxel_finds() {
        let frame = Frame { pitch: 0.5, dims: [40, 33, 27], origin: DVec3::new(-1.0, 0.5, -2.0) };
        let tilted = |p: DVec3| DVec3::new(p.x + 0.3 * p.y, p.y - 0.2 * p.z, p.z + 0.1 * p.x);
        let boxed = TriMesh::cuboid(DVec3::new(1.0, 2.0, 0.3), DVec3::new(12.0, 11.7, 8.1));
        let points = boxed.vertices().iter().map(|p| tilted(*p)).collect();
        // Partly outside the grid, with a triangle that has no area.
        let mut triangles = boxed.triangles().to_vec();
        triangles.push([0, 1, 1]);
        let mesh = TriMesh::new(points, triangles).unwrap();
        let near = voxels_near(&mesh, &frame);
        let reach = NEAR_PITCH * frame.pitch;
        let index = NearestTriangle::new(&mesh, reach);
        let mut found = 0;
        let [nx, ny, nz] = frame.dims;
        for v in (0..nx * ny * nz).map(|i| [i % nx, i / nx % ny, i / (nx * ny)]) {
            let wanted = index.query(frame.center(v)).is_some_and(|q| q.distance <= reach);
            assert_eq!(near.get(v), wanted, "{v:?}");
            found += usize::from(wanted);
        }
        assert!(found > 1000, "{found}");
        assert!(voxels_near(&TriMesh::default(), &frame).is_empty());
    }
}
