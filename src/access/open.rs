//! The accessible region of the whole grid along any direction, by the depth engine.
//!
//! Method: G of the depth engine for every cell under the grid, then the voxels that stand no lower
//! than it. Blocks of voxels that lie wholly above or below the G of all cells they could fall in
//! are taken or left as a whole; least and largest G of tiles of cells tell.
//!
//! Guarantees: the voxels outside the obstacle that [`DepthMap::reaches`] accepts.

use super::Scene;
use super::depth::{cutter_map_of_grid, nozzle_map_of_grid};
use super::lattice::DepthMap;
use crate::base::{DVec2, DVec3, Direction};
use crate::machine::{Tool, ToolKind};
use crate::voxel::{BitGrid, Frame};
use rayon::prelude::*;

/// Voxels of a block along each axis: a byte of a row.
const BLOCK: usize = 8;

/// Voxels along each axis of the parts that a block is split into when it is neither wholly above
/// nor wholly below.
const PART: usize = BLOCK / 2;

/// Cells of a tile along each axis, for blocks and for their parts: about a third of what either
/// spans. Larger tiles tell less, smaller ones take longer to look through.
const TILES: [usize; 2] = [8, 4];

/// Margin in mm of the verdict on a block: far above the rounding of f32 heights, far below a voxel.
const MARGIN_MM: f64 = 1e-3;

/// A(O, T, K) − O along `direction`, for the voxels of the grid of `obstacle`, whose boundary and
/// fixed points `scene` holds. A nozzle's tip stands at the voxel itself.
pub fn reached_along(
    scene: &Scene,
    obstacle: &BitGrid,
    tool: &Tool,
    direction: Direction,
) -> BitGrid {
    let map = match tool.kind {
        ToolKind::Subtractive => cutter_map_of_grid(scene, tool, direction),
        ToolKind::Additive => nozzle_map_of_grid(scene, tool, direction),
    };
    let test = |_: [usize; 3], at: DVec3| map.reaches_at(at);
    voxels(&map, obstacle, false, &scene.frame, test)
}

/// The voxels of `candidates` that a map reaches.
pub fn reachable(map: &DepthMap, candidates: &BitGrid, frame: &Frame) -> BitGrid {
    voxels(map, candidates, true, frame, |v, _| map.reaches(frame.center(v)))
}

/// Least and largest value of each tile of cells.
struct Tiles {
    tile: usize,
    cells: [usize; 2],
    n: [usize; 2],
    range: Vec<(f32, f32)>,
}

impl Tiles {
    fn of(map: &DepthMap, tile: usize) -> Tiles {
        let (cells, nu, nv) = map.cells();
        let n = [nu.div_ceil(tile), nv.div_ceil(tile)];
        let mut range = vec![(f32::INFINITY, f32::NEG_INFINITY); n[0] * n[1]];
        for (j, row) in cells.chunks(nu.max(1)).enumerate() {
            let tiles = &mut range[j / tile * n[0]..][..n[0]];
            for (tile, run) in tiles.iter_mut().zip(row.chunks(tile)) {
                for g in run {
                    tile.0 = if *g < tile.0 { *g } else { tile.0 };
                    tile.1 = if *g > tile.1 { *g } else { tile.1 };
                }
            }
        }
        Tiles { tile, cells: [nu, nv], n, range }
    }

    /// Least and largest value over cells lo ..= hi; no largest where some lie outside the map.
    fn over(&self, lo: DVec2, hi: DVec2) -> (f64, f64) {
        let tile = |c: f64, a: usize| ((c.max(0.0) as usize) / self.tile).min(self.n[a] - 1);
        let beyond = DVec2::new((self.cells[0] - 1) as f64, (self.cells[1] - 1) as f64);
        let outside = lo.min_element() < 0.0 || hi.cmpgt(beyond).any();
        let (mut least, mut most) =
            (f32::INFINITY, if outside { f32::INFINITY } else { f32::NEG_INFINITY });
        for j in tile(lo.y, 1)..=tile(hi.y, 1) {
            for t in &self.range[j * self.n[0]..][tile(lo.x, 0)..=tile(hi.x, 0)] {
                least = least.min(t.0);
                most = most.max(t.1);
            }
        }
        (f64::from(least), f64::from(most))
    }
}

/// The voxels of `set`, or those outside it, that pass: by blocks where a map tells, else singly.
/// The test is given the voxel and its [`DepthMap::place`].
fn voxels(
    map: &DepthMap,
    set: &BitGrid,
    inside: bool,
    frame: &Frame,
    test: impl Fn([usize; 3], DVec3) -> bool + Sync,
) -> BitGrid {
    let mut out = BitGrid::new(frame.dims);
    let [nx, ny, nz] = frame.dims;
    if frame.dims.contains(&0) {
        return out;
    }
    let tiles = TILES.map(|tile| Tiles::of(map, tile));
    let steps = map.steps(frame.pitch);
    let words = out.words_per_row();
    let [block, part] = [BLOCK, PART].map(|n| Reach::of(&steps, n));
    out.par_slabs_mut(BLOCK).for_each(|(z0, slab)| {
        let deep = BLOCK.min(nz - z0);
        for y0 in (0..ny).step_by(BLOCK) {
            let wide = BLOCK.min(ny - y0);
            for x0 in (0..nx).step_by(BLOCK) {
                let asked = bits_of(set, inside, [x0, y0, z0], [wide, deep]);
                if asked.iter().all(|b| *b == 0) {
                    continue;
                }
                let at = map.place(frame.center([x0, y0, z0]));
                let whole = block.verdict(&tiles[0], at);
                if whole == Verdict::None {
                    continue;
                }
                let mut bits = asked;
                if whole == Verdict::Mixed {
                    let tell = |p| part.verdict(&tiles[1], p);
                    sift(&mut bits, [wide, deep], at, &steps, tell, |bits, j, k, p| {
                        passing(bits, [x0, y0 + j, z0 + k], p, steps[0], &test)
                    });
                }
                for k in 0..deep {
                    for j in 0..wide {
                        let word = &mut slab[(k * ny + y0 + j) * words + x0 / 64];
                        *word |= u64::from(bits[j + BLOCK * k]) << (x0 % 64);
                    }
                }
            }
        }
    });
    out
}

/// Keeps the voxels of a mixed block that pass: by its parts where they tell, else row by row.
/// `size` is the block's rows along y and z, `at` the place of its first voxel.
fn sift(
    bits: &mut [u8; BLOCK * BLOCK],
    size: [usize; 2],
    at: DVec3,
    steps: &[DVec3; 3],
    tell: impl Fn(DVec3) -> Verdict,
    passing: impl Fn(u8, usize, usize, DVec3) -> u8,
) {
    let place = |j: usize, k: usize| at + steps[1] * j as f64 + steps[2] * k as f64;
    for z in (0..size[1]).step_by(PART) {
        for y in (0..size[0]).step_by(PART) {
            let p = place(y, z);
            let halves = [tell(p), tell(p + steps[0] * PART as f64)];
            let of = |v| {
                let low = if halves[0] == v { 0x0F } else { 0 };
                if halves[1] == v { low | 0xF0 } else { low }
            };
            let (all, mixed): (u8, u8) = (of(Verdict::All), of(Verdict::Mixed));
            for k in z..(z + PART).min(size[1]) {
                for j in y..(y + PART).min(size[0]) {
                    let row = &mut bits[j + BLOCK * k];
                    let asked = *row & mixed;
                    *row &= all;
                    if asked != 0 {
                        *row |= passing(asked, j, k, place(j, k));
                    }
                }
            }
        }
    }
}

/// What the tiles tell of a cube of voxels.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Verdict {
    None,
    All,
    Mixed,
}

/// From the first voxel of a cube to the lowest and highest of its others, in cells and mm.
struct Reach([(f64, f64); 3]);

impl Reach {
    fn of(steps: &[DVec3; 3], n: usize) -> Reach {
        let far = (n - 1) as f64;
        Reach([0, 1, 2].map(|a| {
            let ends = steps.map(|s| s[a] * far);
            let sum = |f: fn(f64, f64) -> f64| ends.iter().map(|e| f(*e, 0.0)).sum::<f64>();
            (sum(f64::min), sum(f64::max))
        }))
    }

    fn verdict(&self, tiles: &Tiles, at: DVec3) -> Verdict {
        let [u, v, z] = self.0;
        let lo = DVec2::new(at.x + u.0, at.y + v.0) - DVec2::splat(1.0);
        let hi = DVec2::new(at.x + u.1, at.y + v.1) + DVec2::splat(1.0);
        let (least, most) = tiles.over(lo, hi);
        if at.z + z.1 < least - MARGIN_MM {
            Verdict::None
        } else if at.z + z.0 > most + MARGIN_MM {
            Verdict::All
        } else {
            Verdict::Mixed
        }
    }
}

/// The voxels of a block inside or outside a set, a byte a row; `size` rows along y and z.
fn bits_of(
    grid: &BitGrid,
    inside: bool,
    [x, y, z]: [usize; 3],
    size: [usize; 2],
) -> [u8; BLOCK * BLOCK] {
    let mut bits = [0; BLOCK * BLOCK];
    // Voxels past the end of a row are none.
    let mask = 0xFFu8 >> (BLOCK - (grid.dims()[0] - x).min(BLOCK));
    let flip = if inside { 0 } else { !0 };
    for k in 0..size[1] {
        for j in 0..size[0] {
            let word = grid.row(y + j, z + k)[x / 64];
            bits[j + BLOCK * k] = (((word >> (x % 64)) as u8) ^ flip) & mask;
        }
    }
    bits
}

/// Those of the next voxels along x that pass.
#[inline]
fn passing(
    bits: u8,
    v: [usize; 3],
    mut p: DVec3,
    step: DVec3,
    test: &impl Fn([usize; 3], DVec3) -> bool,
) -> u8 {
    let mut pass = 0;
    for i in 0..BLOCK {
        if bits >> i & 1 == 1 {
            pass |= u8::from(test([v[0] + i, v[1], v[2]], p)) << i;
        }
        p += step;
    }
    pass
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::access::{cutter_map, nozzle_map};
    use crate::base::fibonacci_sphere;
    use crate::morph::complement;

    #[test]
    fn blocks_tell_what_single_voxels_do() {
        let frame = Frame { pitch: 0.7, dims: [75, 41, 38], origin: DVec3::new(-3.0, 1.0, 0.0) };
        let solid = BitGrid::from_fn(frame.dims, |[x, y, z]| {
            let wave = 14.0 + 9.0 * (x as f64 / 6.0).sin() * (y as f64 / 9.0).cos();
            (z as f64) < wave && !((20..26).contains(&x) && y > 9)
        });
        let air = complement(&solid);
        let scene = Scene::new(&frame, &solid, &[]);
        let (cutter, nozzle) =
            (Tool::builtin("w2v-cutter").unwrap(), Tool::builtin("w2v-nozzle").unwrap());
        for d in fibonacci_sphere(12).into_iter().chain([Direction::Z, Direction::NEG_Y]) {
            let singly = |map: &DepthMap| {
                BitGrid::from_fn(frame.dims, |v| air.get(v) && map.reaches(frame.center(v)))
            };
            let map = cutter_map(&scene, &air, &cutter, d);
            let one = singly(&map);
            assert_eq!(reachable(&map, &air, &frame), one, "{d:?}");
            assert_eq!(reached_along(&scene, &solid, &cutter, d), one, "{d:?}");
            let one = singly(&nozzle_map(&scene, &air, &nozzle, d, 0.0));
            assert_eq!(reached_along(&scene, &solid, &nozzle, d), one, "{d:?}");
        }
    }
}
