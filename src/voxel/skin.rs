//! The surface of a voxel set as an STL file has it, and that of a set which differs a little.
//!
//! Method: facets come in the order of their voxels, and smoothing moves them by what lies
//! within [`SMOOTHING_REACH`] voxels. So the file of the next state of a workpiece is that of the
//! last one, but for blocks near a voxel that changed; those are made anew with enough of the
//! voxels around them.
//!
//! Guarantees: the bytes of [`surface`](super::surface) written as STL, whatever the skin was
//! patched from. Not guaranteed: that patching pays where most blocks change; they are then all made
//! anew.

use super::surface::{SMOOTHING_REACH, Scope, smooth_net};
use super::{BitGrid, Frame};
use crate::mesh::{InvalidMesh, STL_FACET, stl_facet, write_stl_head};
use rayon::prelude::*;
use std::io::{self, Write};

/// Where more than this share of the blocks must be looked at, they all are.
const MOST_PATCHED: f64 = 0.7;

const _: () = assert!(Scope::BLOCK >= SMOOTHING_REACH);

/// A surface, facet by facet.
pub struct Skin {
    facets: Vec<u8>,
    /// The first facet of each row of voxels in a block, counted along x, y, z, and their number.
    starts: Vec<u32>,
    solid: BitGrid,
}

impl Skin {
    /// The surface of the solid voxels.
    ///
    /// # Errors
    /// [`InvalidMesh`] when the frame puts the surface farther out than a mesh may be.
    pub fn of(grid: &BitGrid, frame: &Frame) -> Result<Skin, InvalidMesh> {
        Skin::within(grid, frame, None)
    }

    /// The surface of another set on the same frame.
    ///
    /// # Errors
    /// As [`Skin::of`].
    pub fn patched(&self, grid: &BitGrid, frame: &Frame) -> Result<Skin, InvalidMesh> {
        let anew = changed(&self.solid, grid).grown();
        let scope = Scope::of(anew.grown(), grid);
        let [tx, ty, tz] = anew.dims();
        if scope.blocks.count() as f64 > MOST_PATCHED * (tx * ty * tz) as f64 {
            return Skin::of(grid, frame);
        }
        let patch = Skin::within(grid, frame, Some(&scope))?;
        let [_, ny, nz] = grid.dims();
        let mut out = Skin { facets: Vec::new(), starts: Vec::new(), solid: grid.clone() };
        out.facets.reserve(self.facets.len());
        out.starts.reserve(self.starts.len());
        let mut count = 0;
        // The run of facets to copy next, and whose they are.
        let (mut run, mut of) = (0..0, self);
        for (key, x) in (0..ny * nz).flat_map(|r| (0..tx).map(move |x| (x + tx * r, x))) {
            let (y, z) = (key / tx % ny / Scope::BLOCK, key / tx / ny / Scope::BLOCK);
            let from = if anew.get([x, y, z]) { &patch } else { self };
            let part = from.starts[key]..from.starts[key + 1];
            out.starts.push(count);
            count += part.end - part.start;
            if std::ptr::eq(from, of) && part.start == run.end {
                run.end = part.end;
            } else if part.start < part.end {
                out.facets.extend_from_slice(of.bytes(run));
                (run, of) = (part, from);
            }
        }
        out.facets.extend_from_slice(of.bytes(run));
        out.starts.push(count);
        Ok(out)
    }

    fn within(grid: &BitGrid, frame: &Frame, scope: Option<&Scope>) -> Result<Skin, InvalidMesh> {
        let (mesh, net) = smooth_net(grid, frame, scope)?;
        let [tx, ..] = Scope::counts(grid.dims());
        let [_, ny, nz] = grid.dims();
        let mut starts = vec![0; tx * ny * nz + 1];
        let mut filled = 0;
        for ([x, y, z], quad) in &net.owners {
            let key = x / Scope::BLOCK + tx * (y + ny * z);
            // Rows before it without a facet begin where it begins.
            starts[filled..=key].fill(net.firsts[*quad as usize]);
            filled = key + 1;
        }
        starts[filled..].fill(mesh.triangles().len() as u32);
        let mut facets = vec![0; STL_FACET * mesh.triangles().len()];
        facets.par_chunks_mut(STL_FACET).with_min_len(4096).enumerate().for_each(|(t, f)| {
            f.copy_from_slice(&stl_facet(mesh.corners(t)));
        });
        Ok(Skin { facets, starts, solid: grid.clone() })
    }

    fn bytes(&self, facets: std::ops::Range<u32>) -> &[u8] {
        &self.facets[STL_FACET * facets.start as usize..STL_FACET * facets.end as usize]
    }

    /// Writes binary STL in millimetres. Errors: those of [`write_stl_head`].
    pub fn write_stl(&self, mut out: impl Write) -> io::Result<()> {
        write_stl_head(self.facets.len() / STL_FACET, &mut out)?;
        out.write_all(&self.facets)?;
        out.flush()
    }
}

/// Blocks in which two grids differ.
fn changed(a: &BitGrid, b: &BitGrid) -> BitGrid {
    let [_, ny, nz] = a.dims();
    let mut blocks = BitGrid::new(Scope::counts(a.dims()));
    for (y, z) in (0..nz).flat_map(|z| (0..ny).map(move |y| (y, z))) {
        for (w, (a, b)) in a.row(y, z).iter().zip(b.row(y, z)).enumerate() {
            let mut rest = a ^ b;
            while rest != 0 {
                let x = w * 64 + rest.trailing_zeros() as usize;
                blocks.set([x, y, z].map(|c| c / Scope::BLOCK), true);
                rest &= rest - 1;
            }
        }
    }
    blocks
}

#[cfg(test)]
mod tests {
    use super::super::surface;
    use super::*;
    use crate::base::DVec3;
    use crate::mesh::write_stl;

    fn plainly(grid: &BitGrid, frame: &Frame) -> Vec<u8> {
        let mut out = Vec::new();
        write_stl(&surface(grid, frame).unwrap(), &mut out).unwrap();
        out
    }

    #[test]
    fn a_patched_skin_is_the_whole_surface_to_the_last_byte() {
        let mut rng = crate::base::rng(31, 0);
        let mut number = |n: usize| rand::RngExt::random_range(&mut rng, 0..n);
        let frame = Frame { pitch: 0.3, dims: [133, 95, 81], origin: DVec3::new(-7.1, 3.3, 0.7) };
        let mut grid = BitGrid::from_fn(frame.dims, |v| {
            let p = DVec3::from_array(v.map(|c| c as f64));
            let tube = (p.truncate() - DVec3::new(60.0, 50.0, 0.0).truncate()).length();
            (20.0..41.0).contains(&tube) || v[2] < 5
        });
        // Voxels that touch along edges and at corners, and a part apart.
        for _ in 0..400 {
            grid.set([number(30), 60 + number(30), 20 + number(9)], true);
        }
        let mut skin = Skin::of(&grid, &frame).unwrap();
        let mut patches = 0;
        for step in 0..9 {
            let n = [0, 1, 3, 60, 7, 2, 2, 1, 4000][step];
            let near = [number(133), number(95), number(81)];
            for _ in 0..n {
                let far = [6, 6, 6, 12, 3, 133, 133, 2, 133][step];
                let v = [0, 1, 2].map(|a| (near[a] + number(far)) % frame.dims[a]);
                let solid = grid.get(v);
                grid.set(v, !solid);
            }
            let blocks = changed(&skin.solid, &grid).grown().grown();
            let all: usize = blocks.dims().iter().product();
            patches += usize::from((blocks.count() as f64) < MOST_PATCHED * all as f64);
            skin = skin.patched(&grid, &frame).unwrap();
            let mut out = Vec::new();
            skin.write_stl(&mut out).unwrap();
            assert!(out == plainly(&grid, &frame), "step {step}");
        }
        assert!(patches >= 6, "{patches}");
        let none = Skin::of(&BitGrid::new([3; 3]), &Frame { dims: [3; 3], ..frame }).unwrap();
        assert!(none.facets.is_empty());
    }
}
