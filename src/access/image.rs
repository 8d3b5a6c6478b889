//! Depth images: the highest obstacle points over the cells of a lattice, and images of coarser
//! cells.
//!
//! Guarantees: a coarse cell is the highest of the fine cells that lie in it, which none straddles,
//! and of the points beyond the finer images that lie in it.

use super::Scene;
use super::cells::Cells;
use super::filter::Spans;
use super::floors::Floors;
use super::lattice::Lattice;
use super::scene::{BRICK, Bar, Row};
use super::tops::{NONE, axis_of, tops, voxel};
use crate::base::{Aabb, DVec2, DVec3, ImagePlane};
use pulp::{Arch, NullaryFnOnce};

/// The highest points over the cells of a lattice, mm, with its pooling.
pub type DepthImage = (usize, Lattice, Cells);

/// Puts every obstacle point of a scene that stands at `least` mm or higher into the first image that
/// has a cell for it (each is wider than those before) and what these hold into the coarser ones;
/// the height of the highest point. Points below `floors` may be left out.
pub fn splat(
    scene: &Scene,
    plane: &ImagePlane,
    (least, floors): (f64, Option<&Floors>),
    images: &mut [DepthImage],
) -> f64 {
    let of_voxels = match axis_of(plane.d) {
        Some(along) => splat_columns(scene, plane, least, images, along),
        None => {
            let bricks = floors.map(|f| Bricks::that_matter(scene, plane, f));
            let bricks = bricks.as_ref();
            Arch::new().dispatch(SplatVoxels { scene, plane, least, bricks, images })
        }
    };
    let fixed = SplatFixed { scene, plane, least, floors, images, highest: of_voxels };
    let highest = Arch::new().dispatch(fixed);
    for i in 1..images.len() {
        let (finer, coarser) = images.split_at_mut(i);
        let (Some((_, fine, from)), Some((_, lattice, image))) =
            (finer.last(), coarser.first_mut())
        else {
            continue;
        };
        pool(fine, from, lattice, image);
    }
    highest
}

/// Puts a point at (u, v), mm, and a height into the first image that has a cell for it.
#[inline(always)]
fn put(images: &mut [DepthImage], uv: DVec2, height: f64) {
    let z = height as f32;
    for (_, lattice, image) in images {
        if let Some(cell) = lattice.cell(uv).and_then(|c| image.get_mut(c)) {
            *cell = if z > *cell { z } else { *cell };
            return;
        }
    }
}

/// Far above the rounding of the heights of points and boxes.
const ROUNDING_MM: f64 = 1e-6;

/// [`splat`] of points that are no voxels'.
struct SplatFixed<'a> {
    scene: &'a Scene,
    plane: &'a ImagePlane,
    least: f64,
    floors: Option<&'a Floors>,
    images: &'a mut [DepthImage],
    /// Height of the highest point so far.
    highest: f64,
}

impl NullaryFnOnce for SplatFixed<'_> {
    type Output = f64;

    #[inline(always)]
    fn call(self) -> f64 {
        let SplatFixed { scene, plane, least, floors, images, mut highest } = self;
        let plane = *plane;
        let [u, v, d] = [plane.u, plane.v, plane.d].map(DVec3::abs);
        let widest = images.last().map(|(_, widest, _)| *widest);
        // Whether no point of a box is asked for.
        let is_passed_over = |b: &Aabb, highest: f64| {
            let (middle, half) = ((b.min + b.max) / 2.0, (b.max - b.min) / 2.0);
            let top = plane.height(middle) + d.dot(half) + ROUNDING_MM;
            let is_seen = || {
                let (at, spread) = (plane.across(middle), DVec2::new(u.dot(half), v.dot(half)));
                widest.is_some_and(|w| w.may_hold(at, spread))
                    && floors.is_none_or(|f| f.may_matter(at, spread, top))
            };
            top <= highest && (top < least || !is_seen())
        };
        for (pile, groups) in scene.piles() {
            if is_passed_over(pile, highest) {
                continue;
            }
            for (b, points) in groups {
                if is_passed_over(b, highest) {
                    continue;
                }
                for p in points {
                    let z = plane.height(*p);
                    highest = if z > highest { z } else { highest };
                    if z >= least {
                        put(images, plane.across(*p), z);
                    }
                }
            }
        }
        highest
    }
}

/// [`splat`] of the voxels of a scene along a grid axis, of each column the highest, since all of it
/// share a cell.
fn splat_columns(
    scene: &Scene,
    plane: &ImagePlane,
    least: f64,
    images: &mut [DepthImage],
    (axis, up): (usize, bool),
) -> f64 {
    let mut highest = f64::MIN;
    let Some(((_, lattice, image), coarser)) = images.split_first_mut() else { return highest };
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
        if z < least {
            continue;
        }
        match lattice.cell_at(place(voxel(axis, column, 0)).truncate()) {
            Some(c) => image[c] = image[c].max(z as f32),
            None => put(coarser, plane.across(scene.frame.center(voxel(axis, column, top))), z),
        }
    }
    highest
}

/// Which bricks of a grid may hold an obstacle that matters.
struct Bricks {
    /// Words of a row.
    words: usize,
    /// Of each word of the rows of a bar, the voxels in bricks that may.
    masks: Vec<u64>,
    /// Whether any of a bar may.
    any: Vec<bool>,
}

impl Bricks {
    fn that_matter(scene: &Scene, plane: &ImagePlane, floors: &Floors) -> Bricks {
        let dims = scene.voxels().dims();
        let [_, ny, nz]: [usize; 3] = std::array::from_fn(|a| dims[a].div_ceil(BRICK[a]));
        let words = dims[0].div_ceil(64);
        let size: [f64; 3] = std::array::from_fn(|a| (BRICK[a] - 1) as f64);
        let half = DVec3::from_array(size) * (scene.frame.pitch / 2.0);
        let [u, v, d] = [plane.u, plane.v, plane.d].map(|axis| axis.abs().dot(half));
        let (spread, rise) = (DVec2::new(u, v) + ROUNDING_MM, d + ROUNDING_MM);
        let may = |brick: [usize; 3]| {
            let first = scene.frame.center(std::array::from_fn(|a| brick[a] * BRICK[a]));
            let middle = first + half;
            floors.may_matter(plane.across(middle), spread, plane.height(middle) + rise)
        };
        let mut masks = vec![0; words * ny * nz];
        let filled = &scene.filled().bricks;
        for (i, (mask, filled)) in
            masks.iter_mut().zip(filled).enumerate().filter(|(_, (_, f))| **f != 0)
        {
            let (w, y, z) = (i % words, i / words % ny, i / words / ny);
            for k in 0..64 / BRICK[0] {
                let brick = (!0 >> (64 - BRICK[0])) << (k * BRICK[0]);
                if filled & brick != 0 && may([w * (64 / BRICK[0]) + k, y, z]) {
                    *mask |= brick;
                }
            }
        }
        let any = masks.chunks(words.max(1)).map(|row| row.iter().any(|m| *m != 0)).collect();
        Bricks { words, masks, any }
    }

    /// The masks of the words of the rows of a bar.
    #[inline(always)]
    fn of_bar(&self, number: usize) -> &[u64] {
        &self.masks[self.words * number..][..self.words]
    }
}

/// [`splat`] of the voxels of a scene along any direction.
struct SplatVoxels<'a> {
    scene: &'a Scene,
    plane: &'a ImagePlane,
    least: f64,
    /// Those that are looked at; none for all.
    bricks: Option<&'a Bricks>,
    images: &'a mut [DepthImage],
}

impl NullaryFnOnce for SplatVoxels<'_> {
    type Output = f64;

    #[inline(always)]
    fn call(self) -> f64 {
        let SplatVoxels { scene, plane, least, bricks, images } = self;
        let mut highest = f64::MIN;
        let Some(((_, lattice, image), coarser)) = images.split_first_mut() else { return highest };
        // What the loop looks at stays in registers, not behind a reference that a store might
        // change.
        let lattice = *lattice;
        let widest = coarser.last().map_or(lattice, |(_, widest, _)| *widest);
        let pitch = scene.frame.pitch;
        let step = lattice.steps(plane, pitch)[0];
        let wide_step = widest.steps(plane, pitch)[0].truncate();
        let nx = scene.voxels().dims()[0];
        let steep = plane.d.abs();
        // Along the direction the highest comes early from one end or the other.
        let (bars, n) = (&scene.filled().bars, scene.filled().bars.len());
        let bars = (0..n).map(|i| &bars[if plane.d.z > 0.0 { n - 1 - i } else { i }]);
        for Bar { number, low, high, rows } in bars {
            let may = bricks.is_none_or(|b| b.any[*number]);
            let [low, high] = [low, high].map(|v| scene.frame.center(*v));
            let half = (high - low) / 2.0;
            let most = plane.height(low + half) + steep.dot(half) + ROUNDING_MM;
            if most <= highest && (!may || most < least) {
                continue;
            }
            let masks = bricks.map(|b| b.of_bar(*number));
            for &Row { y, z, ends: [lo, hi] } in rows {
                let centre = scene.frame.center([0, y, z]);
                let across = plane.across(centre);
                let first = lattice.place(across).extend(plane.height(centre));
                let [p, q] = [lo, hi].map(|x| (first + step * x as f64).z);
                let top = if p > q { p } else { q };
                highest = if top > highest { top } else { highest };
                if top < least || !may {
                    continue;
                }
                let row = scene.voxels().row(y, z);
                // What falls beside the widest image is asked for by none.
                let within = widest.steps_within(widest.place(across), wide_step, nx);
                let (from, end) = (within.start.max(lo), within.end.min(hi + 1));
                if from >= end {
                    continue;
                }
                let last = end - 1;
                for (w, &bits) in row.iter().enumerate().take(last / 64 + 1).skip(from / 64) {
                    let mut rest = bits & masks.map_or(!0, |m| m[w]);
                    if w == from / 64 {
                        rest &= !0 << (from % 64);
                    }
                    if w == last / 64 {
                        rest &= !0 >> (63 - last % 64);
                    }
                    while rest != 0 {
                        let x = w * 64 + rest.trailing_zeros() as usize;
                        rest &= rest - 1;
                        let at = first + step * x as f64;
                        if let Some(c) =
                            lattice.cell_at(at.truncate()).and_then(|c| image.get_mut(c))
                        {
                            *c = if at.z as f32 > *c { at.z as f32 } else { *c };
                            continue;
                        }
                        put(coarser, lattice.across(at.truncate()), at.z);
                    }
                }
            }
        }
        highest
    }
}

/// The highest of the cells of an image that lie in each cell of a coarser one, where it is higher
/// than what the coarser one has.
fn pool(fine: &Lattice, from: &[f32], coarse: &Lattice, onto: &mut [f32]) {
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
