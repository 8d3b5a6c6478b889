//! Which voxels a triangle mesh fills.
//!
//! A voxel is solid when the generalised winding number w of the mesh around its centre exceeds ½
//! (Jacobson, Kavan & Sorkine-Hornung 2013), after the mesh's orientation has been repaired
//! (`repair` lists its steps). So holes are closed by the surface on which w = ½, self-intersecting
//! and overlapping bodies unite, doubled sheets count once, a third of the faces may be reversed,
//! an inward shell inside a body is a void and an outward one is solid.
//!
//! Method. Rims of open surfaces are closed by cones. Of the closed whole, the signed crossings of
//! the voxel rows (rays along x) add up to whole winding numbers, with no arithmetic that rounding
//! could upset: an edge's crossing with a row is computed once and the same for both its
//! triangles. What the cones added is taken away again (`closure`), by boxes of voxels. A closed
//! mesh has no cones. Cost: the crossings, plus the voxels near rims and cones.
//!
//! Guarantees: the same bits at any thread count; on a closed oriented mesh exactly the voxels
//! whose centres it winds around, where a face through centres owns those on its low side along
//! each axis, not those on its high side. Not guaranteed: voxels whose w is within about 0.005 of
//! ½, next to holes; features thinner than a voxel may fall between centres.

use super::closure::{ConeField, VoxelBox};
use super::loops::{boundary_loops, cone, unbalanced_edges};
use super::repair::repair;
use super::winding::slice;
use super::{BitGrid, Frame};
use crate::base::{Cancelled, Ctx, DVec3};
use crate::mesh::TriMesh;
use rayon::prelude::*;

/// Slices of the grid a task works on: enough to spread a pass over all triangles' heights.
const SLAB: usize = 8;

/// How far, in voxels, the apex of a cone is moved off its rim's centroid. Flat holes often lie in
/// a plane of voxel centres, where the solid angle of a flat cone is undefined; w does not depend
/// on where the apex is. Off by more and the cone is larger than it need be.
const APEX_NUDGE: DVec3 = DVec3::new(0.0713, 0.0519, 0.0907);

/// The voxels of `frame` whose centres are inside `mesh`.
///
/// # Errors
/// [`Cancelled`] when the user has asked to stop.
pub fn voxelise(mesh: &TriMesh, frame: &Frame, ctx: &Ctx) -> Result<BitGrid, Cancelled> {
    ctx.check()?;
    let surface = Surface::of(mesh, frame);
    ctx.check()?;
    let rounded = Rounded::of(&surface.cones, frame.dims);
    ctx.begin("voxelise", frame.dims[2] as u64);
    let mut grid = BitGrid::new(frame.dims);
    let slice_words = (grid.words_per_row() * frame.dims[1]).max(1);
    let done = grid.par_slabs_mut(SLAB).try_for_each(|(z0, words)| {
        ctx.check()?;
        let depth = words.len() / slice_words;
        let near = surface.reaching(z0..z0 + depth);
        for (z, slice) in (z0..).zip(words.chunks_mut(slice_words)) {
            let mut events = surface.events(&near, z, frame.dims);
            rounded.events(z, frame.dims, &mut events);
            fill(events, frame.dims, slice);
        }
        ctx.advance(depth as u64);
        Ok(())
    });
    ctx.end();
    done.map(|()| grid)
}

/// The winding number of row `y` changes by `by` from voxel `x` on.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Event {
    y: u32,
    x: u32,
    by: i32,
}

/// The repaired mesh and the cones that close it, voxel centres at whole numbers.
struct Surface {
    vertices: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    cones: ConeField,
    /// First slice a triangle, then a cone triangle, reaches, and the one after its last.
    spans: Vec<[i32; 2]>,
}

impl Surface {
    fn of(mesh: &TriMesh, frame: &Frame) -> Surface {
        let repaired = repair(mesh);
        let vertices: Vec<DVec3> =
            repaired.vertices.iter().map(|v| frame.grid_from_world(*v) - 0.5).collect();
        let rim = unbalanced_edges(&repaired.triangles);
        let fans = boundary_loops(rim)
            .iter()
            .flat_map(|l| {
                let points: Vec<DVec3> = l.iter().map(|&i| vertices[i as usize]).collect();
                cone(&points, APEX_NUDGE).collect::<Vec<_>>()
            })
            .collect();
        let mut surface = Surface {
            vertices,
            triangles: repaired.triangles,
            cones: ConeField::new(fans),
            spans: Vec::new(),
        };
        surface.spans = (0..surface.triangles.len() + surface.cones.fans().len())
            .into_par_iter()
            .map(|i| {
                let z = surface.corners(i).map(|p| p.z);
                let (lo, hi) = (z[0].min(z[1]).min(z[2]), z[0].max(z[1]).max(z[2]));
                [lo.ceil() as i32, hi.ceil() as i32]
            })
            .collect();
        surface
    }

    fn corners(&self, i: usize) -> [DVec3; 3] {
        match i.checked_sub(self.triangles.len()) {
            None => self.triangles[i].map(|v| self.vertices[v as usize]),
            Some(fan) => self.cones.fans()[fan],
        }
    }

    /// The triangles that meet a range of slices.
    fn reaching(&self, slices: std::ops::Range<usize>) -> Vec<u32> {
        let (lo, hi) = (slices.start as i32, slices.end as i32);
        let meets = |s: &[i32; 2]| s[0] < hi && s[1] > lo && s[0] < s[1];
        (0u32..).zip(&self.spans).filter(|(_, s)| meets(s)).map(|(i, _)| i).collect()
    }

    /// Where the rows of slice `z` cross the triangles.
    fn events(&self, near: &[u32], z: usize, [nx, ny, _]: [usize; 3]) -> Vec<Event> {
        let mut events = Vec::new();
        let first = |c: f64, n: usize| c.ceil().clamp(0.0, n as f64) as usize;
        for &i in near {
            let Some([down, up]) = slice(&self.corners(i as usize), z as f64) else { continue };
            // Counter-clockwise in (y, z), its upward edge on the right, a triangle faces +x.
            let (lo, hi, by) = if up.1 > down.1 { (down, up, -1) } else { (up, down, 1) };
            for y in first(lo.1, ny)..first(hi.1, ny) {
                let x = lo.0 + (y as f64 - lo.1) / (hi.1 - lo.1) * (hi.0 - lo.0);
                let x = first(x, nx);
                if x < nx {
                    events.push(Event { y: y as u32, x: x as u32, by });
                }
            }
        }
        events
    }
}

/// What the cones' winding number rounds to, as boxes ordered by their first slice.
struct Rounded {
    boxes: Vec<(VoxelBox, i32)>,
    /// Boxes that meet each slice.
    by_slice: Vec<Vec<u32>>,
}

impl Rounded {
    fn of(cones: &ConeField, dims: [usize; 3]) -> Rounded {
        let boxes = cones.rounded(dims);
        let mut by_slice = vec![Vec::new(); if boxes.is_empty() { 0 } else { dims[2] }];
        for (i, (b, _)) in (0u32..).zip(&boxes) {
            by_slice[b.lo[2]..b.hi[2]].iter_mut().for_each(|s| s.push(i));
        }
        Rounded { boxes, by_slice }
    }

    fn events(&self, z: usize, [nx, ..]: [usize; 3], events: &mut Vec<Event>) {
        for &i in self.by_slice.get(z).map_or(&[][..], |s| s) {
            let (b, k) = self.boxes[i as usize];
            for y in b.lo[1] as u32..b.hi[1] as u32 {
                events.push(Event { y, x: b.lo[0] as u32, by: -k });
                if b.hi[0] < nx {
                    events.push(Event { y, x: b.hi[0] as u32, by: k });
                }
            }
        }
    }
}

/// Sets the voxels of a slice around which the events leave a positive number.
fn fill(mut events: Vec<Event>, [nx, ny, _]: [usize; 3], words: &mut [u64]) {
    events.sort_unstable();
    let words_per_row = words.len() / ny;
    for row in events.chunk_by(|a, b| a.y == b.y) {
        let y = row[0].y as usize;
        let bits = &mut words[y * words_per_row..(y + 1) * words_per_row];
        let mut winding = 0;
        for (i, e) in row.iter().enumerate() {
            winding += e.by;
            let until = row.get(i + 1).map_or(nx, |n| n.x as usize);
            if winding > 0 && until > e.x as usize {
                super::bitgrid::set_bits(bits, e.x as usize, until);
            }
        }
    }
}
