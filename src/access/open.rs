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

/// Cells of a tile along each axis.
const TILE: usize = 8;

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
    open_voxels(&map, obstacle, &scene.frame)
}

/// Least and largest value of each tile of cells.
struct Tiles {
    n: [usize; 2],
    range: Vec<(f32, f32)>,
}

impl Tiles {
    fn of(map: &DepthMap) -> Tiles {
        let (cells, nu, nv) = map.cells();
        let n = [nu.div_ceil(TILE), nv.div_ceil(TILE)];
        let mut range = vec![(f32::INFINITY, f32::NEG_INFINITY); n[0] * n[1]];
        for (j, row) in cells.chunks(nu.max(1)).enumerate() {
            let tiles = &mut range[j / TILE * n[0]..][..n[0]];
            for (tile, run) in tiles.iter_mut().zip(row.chunks(TILE)) {
                for g in run {
                    tile.0 = if *g < tile.0 { *g } else { tile.0 };
                    tile.1 = if *g > tile.1 { *g } else { tile.1 };
                }
            }
        }
        Tiles { n, range }
    }

    /// Least and largest value over cells lo ..= hi.
    fn over(&self, lo: DVec2, hi: DVec2) -> (f64, f64) {
        let tile = |c: f64, a: usize| ((c.max(0.0) as usize) / TILE).min(self.n[a] - 1);
        let (mut least, mut most) = (f32::INFINITY, f32::NEG_INFINITY);
        for j in tile(lo.y, 1)..=tile(hi.y, 1) {
            for t in &self.range[j * self.n[0]..][tile(lo.x, 0)..=tile(hi.x, 0)] {
                least = least.min(t.0);
                most = most.max(t.1);
            }
        }
        (f64::from(least), f64::from(most))
    }
}

/// The voxels outside `obstacle` that a map of the whole grid reaches.
fn open_voxels(map: &DepthMap, obstacle: &BitGrid, frame: &Frame) -> BitGrid {
    let mut out = BitGrid::new(frame.dims);
    let [nx, ny, nz] = frame.dims;
    if frame.dims.contains(&0) {
        return out;
    }
    let tiles = Tiles::of(map);
    let steps = map.steps(frame.pitch);
    let words = out.words_per_row();
    // From a block's first voxel to the lowest and highest of its others, in cells and mm.
    let far = (BLOCK - 1) as f64;
    let spread = |c: [f64; 3]| {
        let ends = c.map(|c| c * far);
        (ends.iter().map(|e| e.min(0.0)).sum::<f64>(), ends.iter().map(|e| e.max(0.0)).sum::<f64>())
    };
    let [u, v, z] = [0, 1, 2].map(|a| spread(steps.map(|s| s[a])));
    out.par_slabs_mut(BLOCK).for_each(|(z0, slab)| {
        let deep = BLOCK.min(nz - z0);
        for y0 in (0..ny).step_by(BLOCK) {
            let wide = BLOCK.min(ny - y0);
            for x0 in (0..nx).step_by(BLOCK) {
                let inside = empty_bits(obstacle, [x0, y0, z0], [wide, deep]);
                if inside.iter().all(|b| *b == 0) {
                    continue;
                }
                let at = map.place(frame.center([x0, y0, z0]));
                let lo = DVec2::new(at.x + u.0, at.y + v.0) - DVec2::splat(1.0);
                let hi = DVec2::new(at.x + u.1, at.y + v.1) + DVec2::splat(1.0);
                let (least, most) = tiles.over(lo, hi);
                if at.z + z.1 < least - MARGIN_MM {
                    continue;
                }
                let all = at.z + z.0 > most + MARGIN_MM;
                for k in 0..deep {
                    for j in 0..wide {
                        let mut bits = inside[j + BLOCK * k];
                        if bits != 0 && !all {
                            let p = at + steps[1] * j as f64 + steps[2] * k as f64;
                            bits &= row_bits(map, p, steps[0]);
                        }
                        let word = &mut slab[(k * ny + y0 + j) * words + x0 / 64];
                        *word |= u64::from(bits) << (x0 % 64);
                    }
                }
            }
        }
    });
    out
}

/// The empty voxels of a block, a byte a row; `size` rows along y and z.
fn empty_bits(grid: &BitGrid, [x, y, z]: [usize; 3], size: [usize; 2]) -> [u8; BLOCK * BLOCK] {
    let mut bits = [0; BLOCK * BLOCK];
    // Voxels past the end of a row are none.
    let mask = 0xFFu8 >> (BLOCK - (grid.dims()[0] - x).min(BLOCK));
    for k in 0..size[1] {
        for j in 0..size[0] {
            let word = grid.row(y + j, z + k)[x / 64];
            bits[j + BLOCK * k] = !((word >> (x % 64)) as u8) & mask;
        }
    }
    bits
}

/// Which of the next voxels along x a map reaches.
#[inline]
fn row_bits(map: &DepthMap, mut p: DVec3, step: DVec3) -> u8 {
    let mut bits = 0;
    for i in 0..BLOCK {
        bits |= u8::from(map.reaches_at(p)) << i;
        p += step;
    }
    bits
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::access::{cutter_map, nozzle_map, reachable};
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
            let one = reachable(&cutter_map(&scene, &air, &cutter, d), &air, &frame);
            assert_eq!(reached_along(&scene, &solid, &cutter, d), one, "{d:?}");
            let one = reachable(&nozzle_map(&scene, &air, &nozzle, d, 0.0), &air, &frame);
            assert_eq!(reached_along(&scene, &solid, &nozzle, d), one, "{d:?}");
        }
    }
}
