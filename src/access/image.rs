//! Depth images: the highest obstacle points over the cells of a lattice, and images of coarser
//! cells.
//!
//! Guarantees: a coarse cell is the highest of the fine cells that lie in it, which none straddles.

use super::Scene;
use super::cells::Cells;
use super::filter::Spans;
use super::lattice::Lattice;
use super::tops::{NONE, axis_of, tops, voxel};
use crate::base::{DVec3, ImagePlane};
use pulp::{Arch, NullaryFnOnce};

/// The highest points over the cells of a lattice, mm, with its pooling.
pub type DepthImage = (usize, Lattice, Cells);

/// Puts every obstacle point of a scene into the first image, and those beyond it into the others;
/// the height of the highest.
pub fn splat(scene: &Scene, plane: &ImagePlane, images: &mut [DepthImage]) -> f64 {
    let Some(((_, lattice, image), coarser)) = images.split_first_mut() else { return f64::MIN };
    let (mut highest, beyond) = match axis_of(plane.d) {
        Some((axis, up)) => splat_columns(scene, plane, lattice, image, (axis, up)),
        None => Arch::new().dispatch(SplatVoxels { scene, plane, lattice: *lattice, image }),
    };
    for p in beyond.iter().chain(scene.fixed()) {
        let (uv, z) = (plane.across(*p), plane.height(*p));
        highest = highest.max(z);
        if let Some(c) = lattice.cell(uv) {
            image[c] = image[c].max(z as f32);
            continue;
        }
        for (_, lattice, image) in coarser.iter_mut() {
            if let Some(c) = lattice.cell(uv) {
                image[c] = image[c].max(z as f32);
            }
        }
    }
    highest
}

/// Puts the voxels of a scene into an image along a grid axis, of each column the highest, since all
/// of it share a cell; answers as [`SplatVoxels`].
fn splat_columns(
    scene: &Scene,
    plane: &ImagePlane,
    lattice: &Lattice,
    image: &mut [f32],
    (axis, up): (usize, bool),
) -> (f64, Vec<DVec3>) {
    let (mut highest, mut beyond) = (f64::MIN, Vec::new());
    let step = lattice.steps(plane, scene.frame.pitch)[0];
    let place = |[x, y, z]: [usize; 3]| {
        let centre = scene.frame.center([0, y, z]);
        let first = lattice.place(plane.across(centre)).extend(plane.height(centre));
        first + step * x as f64
    };
    let dims = scene.voxels().dims();
    let heights: Vec<f64> = (0..dims[axis]).map(|t| place(voxel(axis, [0, 0], t)).z).collect();
    let width = dims[usize::from(axis == 0)].max(1);
    for (i, top) in tops(scene.voxels(), axis, up).into_iter().enumerate() {
        if top == NONE {
            continue;
        }
        let (column, top) = ([i % width, i / width], top as usize);
        let z = heights[top];
        highest = highest.max(z);
        match lattice.cell_at(place(voxel(axis, column, 0)).truncate()) {
            Some(c) => image[c] = image[c].max(z as f32),
            None => beyond.push(scene.frame.center(voxel(axis, column, top))),
        }
    }
    (highest, beyond)
}

/// Puts the voxels of a scene into an image; answers with the height of the highest of them and the
/// centres of those beyond it. The lattice comes by value: what the loop looks at stays in
/// registers, not behind a reference that a store might change.
struct SplatVoxels<'a> {
    scene: &'a Scene,
    plane: &'a ImagePlane,
    lattice: Lattice,
    image: &'a mut [f32],
}

impl NullaryFnOnce for SplatVoxels<'_> {
    type Output = (f64, Vec<DVec3>);

    #[inline(always)]
    fn call(self) -> (f64, Vec<DVec3>) {
        let SplatVoxels { scene, plane, lattice, image } = self;
        let (mut highest, mut beyond) = (f64::MIN, Vec::new());
        let step = lattice.steps(plane, scene.frame.pitch)[0];
        let [_, ny, nz] = scene.voxels().dims();
        for (y, z) in (0..nz).flat_map(|z| (0..ny).map(move |y| (y, z))) {
            let row = scene.voxels().row(y, z);
            if row.iter().all(|w| *w == 0) {
                continue;
            }
            let centre = scene.frame.center([0, y, z]);
            let first = lattice.place(plane.across(centre)).extend(plane.height(centre));
            for (w, &bits) in row.iter().enumerate() {
                let mut rest = bits;
                while rest != 0 {
                    let x = w * 64 + rest.trailing_zeros() as usize;
                    rest &= rest - 1;
                    let at = first + step * x as f64;
                    highest = if at.z > highest { at.z } else { highest };
                    match lattice.cell_at(at.truncate()).and_then(|c| image.get_mut(c)) {
                        Some(c) => *c = if at.z as f32 > *c { at.z as f32 } else { *c },
                        None => beyond.push(scene.frame.center([x, y, z])),
                    }
                }
            }
        }
        (highest, beyond)
    }
}

/// The highest of the cells of an image that lie in each cell of a coarser one, where it is higher
/// than what the coarser one has.
pub fn pool(fine: &Lattice, from: &[f32], coarse: &Lattice, onto: &mut [f32]) {
    let [columns, rows] = coarse.pooled(fine);
    let mut across = vec![f32::NEG_INFINITY; fine.nu];
    for (j, row) in rows.iter().enumerate() {
        for (a, h) in across.iter_mut().zip(&from[j * fine.nu..]) {
            *a = if *h > *a { *h } else { *a };
        }
        if rows.get(j + 1) == Some(row) {
            continue;
        }
        let onto = &mut onto[coarse.nu * row..][..coarse.nu];
        for (a, i) in across.iter_mut().zip(&columns) {
            onto[*i] = if *a > onto[*i] { *a } else { onto[*i] };
            *a = f32::NEG_INFINITY;
        }
    }
}

/// Raises the cells of `tips` to the value of the coarse cell they lie in.
pub fn spread(from: &Lattice, coarse: &[f32], onto: &Lattice, tips: &Spans, out: &mut [f32]) {
    let [columns, rows] = from.pooled(onto);
    let mut wide = vec![f32::NEG_INFINITY; onto.nu];
    let mut of_row = None;
    for ((row, spans), out) in rows.iter().zip(tips.rows()).zip(out.chunks_mut(onto.nu)) {
        if spans.is_empty() {
            continue;
        }
        if of_row != Some(row) {
            of_row = Some(row);
            let coarse = &coarse[from.nu * row..][..from.nu];
            wide.iter_mut().zip(&columns).for_each(|(w, i)| *w = coarse[*i]);
        }
        for s in spans {
            for (o, w) in out[s.clone()].iter_mut().zip(&wide[s.clone()]) {
                *o = if *w > *o { *w } else { *o };
            }
        }
    }
}
