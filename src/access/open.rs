//! The accessible region of the whole grid along any direction, by the depth engine.
//!
//! Method: G of the depth engine for every cell under the grid, then the voxels that stand no lower
//! than it. Cubes of voxels that lie wholly above or below the G of all cells they could fall in
//! are taken or left as a whole, 64 of their voxels at a time; least and largest G of the cells
//! under a cube are looked up ([`Bounds`]).
//!
//! Guarantees: the voxels outside the obstacle that [`DepthMap::reaches`] accepts.

use super::Scene;
use super::depth::{cutter_map_of_grid, nozzle_map_of_grid};
use super::filter::{Extreme, Largest, Least, running_extreme};
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

/// Margin in mm of the verdict on a cube: far above the rounding of f32 heights, far below a voxel.
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
    voxels(&map, obstacle, false, &scene.frame)
}

/// The voxels of `candidates` that a map reaches.
pub fn reachable(map: &DepthMap, candidates: &BitGrid, frame: &Frame) -> BitGrid {
    voxels(map, candidates, true, frame)
}

/// The voxels of `set`, or those outside it, that a map reaches.
fn voxels(map: &DepthMap, set: &BitGrid, inside: bool, frame: &Frame) -> BitGrid {
    let mut out = BitGrid::new(frame.dims);
    if frame.dims.contains(&0) {
        return out;
    }
    let steps = map.steps(frame.pitch);
    let [blocks, parts] = Bounds::of(map, &steps);
    let sieve = Sieve { map, frame, set, flip: if inside { 0 } else { !0 }, steps, blocks, parts };
    let words = out.words_per_row();
    out.par_slabs_mut(BLOCK).for_each(|(z, slab)| {
        for y in (0..frame.dims[1]).step_by(BLOCK) {
            (0..words).for_each(|w| sieve.column(slab, [w, y, z]));
        }
    });
    out
}

/// What tells the voxels apart.
struct Sieve<'a> {
    map: &'a DepthMap,
    frame: &'a Frame,
    set: &'a BitGrid,
    /// All ones when the voxels outside the set are asked for.
    flip: u64,
    steps: [DVec3; 3],
    blocks: Bounds,
    parts: Bounds,
}

/// Voxels of a word that are taken and those that are to be asked singly.
#[derive(Clone, Copy, Default)]
struct Masks {
    all: u64,
    mixed: u64,
}

impl Sieve<'_> {
    /// Eight blocks along x: word `w` of the rows from (y, z) on. `slab` starts at slice z.
    fn column(&self, slab: &mut [u64], [w, y, z]: [usize; 3]) {
        let [nx, ny, nz] = self.frame.dims;
        let (wide, deep) = (BLOCK.min(ny - y), BLOCK.min(nz - z));
        // Voxels past the end of a row are none.
        let valid = if w * 64 + 64 > nx { self.set.last_word_mask() } else { !0 };
        let asked = |j: usize, k: usize| (self.set.row(y + j, z + k)[w] ^ self.flip) & valid;
        let mut any = 0;
        for k in 0..deep {
            (0..wide).for_each(|j| any |= asked(j, k));
        }
        if any == 0 {
            return;
        }
        let first = self.map.place(self.frame.center([w * 64, y, z]));
        let masks = self.masks(any, first);
        if masks.iter().all(|m| m.all | m.mixed == 0) {
            return;
        }
        let words = self.set.words_per_row();
        for k in 0..deep {
            for j in 0..wide {
                let (m, asked) = (&masks[j / PART + 2 * (k / PART)], asked(j, k));
                let mut pass = asked & m.all;
                if asked & m.mixed != 0 {
                    let row = first + self.steps[1] * j as f64 + self.steps[2] * k as f64;
                    pass |= self.singly(asked & m.mixed, row);
                }
                slab[(k * ny + y + j) * words + w] = pass;
            }
        }
    }

    /// What the bounds tell of eight blocks that start at `first`, for each half along y and z.
    fn masks(&self, any: u64, first: DVec3) -> [Masks; 4] {
        let mut masks = [Masks::default(); 4];
        for b in 0..64 / BLOCK {
            let byte = 0xFF << (b * BLOCK);
            if any & byte == 0 {
                continue;
            }
            let at = first + self.steps[0] * (b * BLOCK) as f64;
            match self.blocks.verdict(at) {
                Verdict::None => {}
                Verdict::All => masks.iter_mut().for_each(|m| m.all |= byte),
                Verdict::Mixed => {
                    for part in 0..8 {
                        let [i, j, k] = [part & 1, part >> 1 & 1, part >> 2];
                        let by = |a: usize, n: usize| self.steps[a] * (n * PART) as f64;
                        let nibble = 0x0F << (b * BLOCK + i * PART);
                        let m = &mut masks[j + 2 * k];
                        match self.parts.verdict(at + by(0, i) + by(1, j) + by(2, k)) {
                            Verdict::None => {}
                            Verdict::All => m.all |= nibble,
                            Verdict::Mixed => m.mixed |= nibble,
                        }
                    }
                }
            }
        }
        masks
    }

    /// The voxels of a word that the map reaches; the word's first voxel stands at `first`.
    fn singly(&self, asked: u64, first: DVec3) -> u64 {
        let (mut rest, mut pass) = (asked, 0);
        while rest != 0 {
            let start = rest.trailing_zeros() as usize & !(PART - 1);
            let mut at = first + self.steps[0] * start as f64;
            for i in start..start + PART {
                pass |= u64::from(self.map.reaches_at(at)) << i;
                at += self.steps[0];
            }
            rest &= !(0x0F << start);
        }
        pass & asked
    }
}

/// What the bounds tell of a cube of voxels.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Verdict {
    None,
    All,
    Mixed,
}

/// Least and largest G under cubes of voxels: over all cells from a tile of cells on that a cube
/// whose first cell lies in it may span.
struct Bounds {
    /// Tiles per cell.
    per_cell: f64,
    /// Tiles along u and v.
    n: [usize; 2],
    /// From the first voxel of a cube to the lowest and highest of its others, in cells and mm.
    reach: [(f64, f64); 3],
    /// The last cell that a cube may touch, for the map to hold all of them.
    last: DVec2,
    range: Vec<(f32, f32)>,
}

/// What hides the rounding of places, cells.
const HAIR: f64 = 1e-6;

impl Bounds {
    /// Those of blocks and of their parts.
    fn of(map: &DepthMap, steps: &[DVec3; 3]) -> [Bounds; 2] {
        let (cells, nu, nv) = map.cells();
        let fine = [Tiles::of::<Least>(cells, [nu, nv], 2), Tiles::of::<Largest>(cells, [nu, nv], 2)];
        let coarse = [
            Tiles::of::<Least>(&fine[0].cells, fine[0].n, 4),
            Tiles::of::<Largest>(&fine[1].cells, fine[1].n, 4),
        ];
        let of = |[least, largest]: [Tiles; 2], tile: usize, voxels: usize| {
            let far = (voxels - 1) as f64;
            let reach = [0, 1, 2].map(|a| {
                let ends = steps.map(|s| s[a] * far);
                let sum = |f: fn(f64, f64) -> f64| ends.iter().map(|e| f(*e, 0.0)).sum::<f64>();
                (sum(f64::min), sum(f64::max))
            });
            // A cube's first cell may be any of its tile.
            let spans = [0, 1].map(|a| {
                let cells = (reach[a].1 - reach[a].0 + 2.0 * HAIR) as usize + 1;
                (tile - 1 + cells) / tile + 1
            });
            let n = least.n;
            let least = least.widened::<Least>(spans).cells;
            let largest = largest.widened::<Largest>(spans).cells;
            let range = least.into_iter().zip(largest).collect();
            let last = DVec2::new((nu - 1) as f64, (nv - 1) as f64);
            Bounds { per_cell: 1.0 / tile as f64, n, reach, last, range }
        };
        [of(coarse, 8, BLOCK), of(fine, 2, PART)]
    }

    /// What there is to tell of a cube whose first voxel stands at `at`.
    #[inline]
    fn verdict(&self, at: DVec3) -> Verdict {
        let [u, v, z] = self.reach;
        let lo = DVec2::new(at.x + u.0, at.y + v.0) + DVec2::splat(0.5 - HAIR);
        let hi = DVec2::new(at.x + u.1, at.y + v.1);
        if lo.x < 0.0 || lo.y < 0.0 || hi.x > self.last.x || hi.y > self.last.y {
            return Verdict::Mixed;
        }
        let tile = [lo.x, lo.y].map(|c| (c * self.per_cell) as i32 as usize);
        let Some((least, most)) = self.range.get(tile[0] + self.n[0] * tile[1]) else {
            return Verdict::Mixed;
        };
        if at.z + z.1 < f64::from(*least) - MARGIN_MM {
            Verdict::None
        } else if at.z + z.0 > f64::from(*most) + MARGIN_MM {
            Verdict::All
        } else {
            Verdict::Mixed
        }
    }
}

/// Extremes of square tiles of cells.
struct Tiles {
    n: [usize; 2],
    cells: Vec<f32>,
}

impl Tiles {
    fn of<E: Extreme>(cells: &[f32], [nu, nv]: [usize; 2], tile: usize) -> Tiles {
        let n = [nu.div_ceil(tile), nv.div_ceil(tile)];
        let mut out = Vec::with_capacity(n[0] * n[1]);
        let mut across = vec![E::NONE; nu];
        for rows in cells.chunks(nu.max(1) * tile) {
            across.fill(E::NONE);
            for row in rows.chunks(nu.max(1)) {
                across.iter_mut().zip(row).for_each(|(a, c)| *a = E::of(*a, *c));
            }
            out.extend(across.chunks(tile).map(|t| t.iter().fold(E::NONE, |a, c| E::of(a, *c))));
        }
        Tiles { n, cells: out }
    }

    /// Each the extreme of those from it on, `spans` of them along either axis.
    fn widened<E: Extreme>(mut self, spans: [usize; 2]) -> Tiles {
        let room = &mut Vec::new();
        // What runs on from a row's end into the next only widens the range there.
        running_extreme::<E>(&mut self.cells, room, 1, spans[0]);
        running_extreme::<E>(&mut self.cells, room, self.n[0], spans[1]);
        self
    }
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
