//! The accessible region of the whole grid along any direction, by the depth engine.
//!
//! Method: G of the depth engine for every cell under the grid, then the voxels that stand no lower
//! than it. Cubes of voxels that lie wholly above or below the G of all cells they could fall in
//! are taken or left as a whole, 64 of their voxels at a time; least and largest G of the cells
//! under a cube are looked up ([`Bounds`]). A few voxels are asked singly.
//!
//! Guarantees: the voxels outside the obstacle that [`DepthMap::reaches`] accepts.

use super::Scene;
use super::depth::{cutter_map_of_grid, nozzle_map_of_grid};
use super::lattice::DepthMap;
use super::tiles::Tiles;
use super::wanted::FEW;
use crate::base::{DVec3, Direction};
use crate::machine::{Tool, ToolKind};
use crate::voxel::{BitGrid, Frame};
use pulp::{Arch, NullaryFnOnce};
use rayon::prelude::*;

/// Voxels of a block along each axis: a byte of a row.
const BLOCK: usize = 8;

/// Voxels along each axis of the parts that a block is split into when it is neither wholly above
/// nor wholly below, and of those that these are split into.
const PARTS: [usize; 2] = [BLOCK / 2, BLOCK / 4];

/// Cells of a tile along each axis, for blocks, for parts and for parts of these. Larger tiles tell
/// less, smaller ones take longer to make.
const TILES: [usize; 3] = [8, 4, 2];

/// Margin in mm of the verdict on a cube: far above the rounding of f32 heights, far below a voxel.
const MARGIN_MM: f32 = 1e-3;

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
    if candidates.count() > FEW {
        return voxels(map, candidates, true, frame);
    }
    let mut out = BitGrid::new(frame.dims);
    let reached = candidates.iter_ones().filter(|v| map.reaches(frame.center(*v)));
    reached.for_each(|v| out.set(v, true));
    out
}

/// The voxels of `set`, or those outside it, that a map reaches.
fn voxels(map: &DepthMap, set: &BitGrid, inside: bool, frame: &Frame) -> BitGrid {
    let mut out = BitGrid::new(frame.dims);
    if frame.dims.contains(&0) {
        return out;
    }
    let steps = map.steps(frame.pitch);
    let arch = Arch::new();
    let [blocks, parts, small] = arch.dispatch(MakeBounds { map, steps: &steps });
    let flip = if inside { 0 } else { !0 };
    let sieve = Sieve { map, frame, set, flip, steps, blocks, parts, small };
    out.par_slabs_mut(BLOCK).for_each(|(z, slab)| {
        arch.dispatch(SiftSlab { sieve: &sieve, z, slab });
    });
    out
}

/// Makes the bounds, by the widest registers there are.
struct MakeBounds<'a> {
    map: &'a DepthMap,
    steps: &'a [DVec3; 3],
}

impl NullaryFnOnce for MakeBounds<'_> {
    type Output = [Bounds; 3];

    #[inline(always)]
    fn call(self) -> [Bounds; 3] {
        Bounds::of(self.map, self.steps)
    }
}

/// Fills the slab that starts at slice `z`, by the widest registers there are.
struct SiftSlab<'a> {
    sieve: &'a Sieve<'a>,
    z: usize,
    slab: &'a mut [u64],
}

impl NullaryFnOnce for SiftSlab<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let SiftSlab { sieve, z, slab } = self;
        let mut mixed = Vec::new();
        for y in (0..sieve.frame.dims[1]).step_by(BLOCK) {
            for w in 0..sieve.set.words_per_row() {
                sieve.column(slab, [w, y, z], &mut mixed);
            }
        }
    }
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
    /// Of parts of parts.
    small: Bounds,
}

/// Voxels of a word that are taken and those that are to be asked singly.
#[derive(Clone, Copy, Default)]
struct Masks {
    all: u64,
    mixed: u64,
}

impl Sieve<'_> {
    /// Eight blocks along x: word `w` of the rows from (y, z) on. `slab` starts at slice z, `mixed` is
    /// scratch.
    #[inline(always)]
    fn column(&self, slab: &mut [u64], [w, y, z]: [usize; 3], mixed: &mut Vec<[u8; 3]>) {
        let [nx, ny, nz] = self.frame.dims;
        let (wide, deep) = (BLOCK.min(ny - y), BLOCK.min(nz - z));
        // Voxels past the end of a row are none.
        let valid = if w * 64 + 64 > nx { self.set.last_word_mask() } else { !0 };
        let (mut asked, mut any) = ([0; BLOCK * BLOCK], 0);
        for k in 0..deep {
            for j in 0..wide {
                let bits = (self.set.row(y + j, z + k)[w] ^ self.flip) & valid;
                asked[j + BLOCK * k] = bits;
                any |= bits;
            }
        }
        if any == 0 {
            return;
        }
        let first = self.map.place(self.frame.center([w * 64, y, z]));
        let blocks = self.blocks.verdicts(first);
        // The blocks' bits are bytes of the word.
        let byte = |set: u8, x: usize| u64::from(set >> x & 1) * (0xFF << (8 * x));
        let (mut whole, mut masks) = (0, [[Masks::default(); 4]; 4]);
        for x in (0..8).filter(|x| any >> (8 * x) & 0xFF != 0) {
            whole |= byte(blocks.all, x);
            if (blocks.some & !blocks.all) >> x & 1 == 1 {
                let at = first + self.steps[0] * (x * BLOCK) as f64;
                self.split(x * BLOCK, at, &mut masks);
            }
        }
        if any & (0..8).map(|x| byte(blocks.some, x)).sum::<u64>() == 0 {
            return;
        }
        let words = self.set.words_per_row();
        if blocks.some == blocks.all {
            for k in 0..deep {
                for j in 0..wide {
                    slab[(k * ny + y + j) * words + w] = asked[j + BLOCK * k] & whole;
                }
            }
            return;
        }
        // What is to be asked singly is listed first: a loop that ends at a different voxel in every
        // word keeps the machine from looking up the next while it waits for one.
        mixed.clear();
        let mut pass = [0; BLOCK * BLOCK];
        for k in 0..deep {
            for j in 0..wide {
                let (m, asked) = (&masks[j / PARTS[1]][k / PARTS[1]], asked[j + BLOCK * k]);
                pass[j + BLOCK * k] = asked & (whole | m.all);
                let mut rest = asked & m.mixed;
                while rest != 0 {
                    let start = rest.trailing_zeros() & !(PARTS[1] as u32 - 1);
                    mixed.push([start as u8, j as u8, k as u8]);
                    rest &= !(0b11 << start);
                }
            }
        }
        for &[start, j, k] in mixed.iter() {
            let row = first + self.steps[1] * f64::from(j) + self.steps[2] * f64::from(k);
            let at = row + self.steps[0] * f64::from(start);
            let pair = [at, at + self.steps[0]].map(|at| u64::from(self.map.reaches_at(at)));
            pass[usize::from(j) + BLOCK * usize::from(k)] |= (pair[0] | pair[1] << 1) << start;
        }
        for k in 0..deep {
            for j in 0..wide {
                let of = j + BLOCK * k;
                slab[(k * ny + y + j) * words + w] = pass[of] & asked[of];
            }
        }
    }

    /// The parts of a block at bit `x` of a word that stands at `at`, and their parts.
    #[inline(always)]
    fn split(&self, x: usize, at: DVec3, masks: &mut [[Masks; 4]; 4]) {
        let octant = |part: usize| [part & 1, part >> 1 & 1, part >> 2];
        let told = self.parts.verdicts(at);
        for part in (0..8).filter(|p| told.some >> p & 1 == 1) {
            let [i, j, k] = octant(part);
            let x = x + i * PARTS[0];
            if told.all >> part & 1 == 1 {
                for m in masks[2 * j..2 * j + 2].iter_mut().flat_map(|m| &mut m[2 * k..][..2]) {
                    m.all |= 0xF << x;
                }
                continue;
            }
            let by = |a: usize, i: usize| self.steps[a] * (i * PARTS[0]) as f64;
            let told = self.small.verdicts(at + by(0, i) + by(1, j) + by(2, k));
            for part in (0..8).filter(|p| told.some >> p & 1 == 1) {
                let [i, dj, dk] = octant(part);
                let m = &mut masks[2 * j + dj][2 * k + dk];
                let bits = 0b11 << (x + i * PARTS[1]);
                *(if told.all >> part & 1 == 1 { &mut m.all } else { &mut m.mixed }) |= bits;
            }
        }
    }
}

/// What the bounds tell of eight cubes of voxels, a bit each.
#[derive(Clone, Copy)]
struct Told {
    /// Some of its voxels may be reached.
    some: u8,
    /// All of them are.
    all: u8,
}

/// Least and largest G under cubes of voxels: over all cells from a tile of cells on that a cube
/// whose first cell lies in it may span. Eight cubes are looked up together.
struct Bounds {
    /// Tiles per cell.
    per_cell: f32,
    /// Tiles along u.
    nu: i32,
    /// From the place asked for to the first cell of each cube, and to its lowest and highest voxel.
    first: [[f32; 8]; 2],
    lowest: [f32; 8],
    highest: [f32; 8],
    /// The last first cell of a cube that the map holds all cells of.
    last: [f32; 2],
    /// With the margin; at the end that of a cube of which nothing is known.
    range: Vec<(f32, f32)>,
}

/// What hides the rounding of places, cells: far above that of f32 up to some thousand cells.
const HAIR: f64 = 2e-3;

/// The integer below a number from 0 to 2²¹, by the rounding of additions: a conversion of floats
/// guards against what is no integer, one number at a time. Of an integer it may be the one before:
/// a tile's range reaches far enough for a cube that starts where the next one does.
#[inline(always)]
fn below(x: f32) -> i32 {
    const ONE_AND_A_HALF_TIMES_2_TO_23: f32 = 12_582_912.0;
    let rounded = (x - 0.5) + ONE_AND_A_HALF_TIMES_2_TO_23;
    (rounded.to_bits() as i32).wrapping_sub(ONE_AND_A_HALF_TIMES_2_TO_23.to_bits() as i32)
}

impl Bounds {
    /// Those of blocks along a word, of the parts of a block and of the parts of a part.
    #[inline(always)]
    fn of(map: &DepthMap, steps: &[DVec3; 3]) -> [Bounds; 3] {
        let (cells, nu, nv) = map.cells();
        let n = [nu, nv];
        let small = Tiles::of::<{ TILES[2] }>(cells, cells, n);
        let parts = Tiles::of::<{ TILES[1] / TILES[2] }>(&small.least, &small.largest, small.n);
        let blocks = Tiles::of::<{ TILES[0] / TILES[1] }>(&parts.least, &parts.largest, parts.n);
        let row: [[usize; 3]; 8] = std::array::from_fn(|i| [i, 0, 0]);
        let octants: [[usize; 3]; 8] = std::array::from_fn(|i| [i & 1, i >> 1 & 1, i >> 2]);
        [
            Bounds::over(blocks, n, TILES[0], BLOCK, steps, row),
            Bounds::over(parts, n, TILES[1], PARTS[0], steps, octants),
            Bounds::over(small, n, TILES[2], PARTS[1], steps, octants),
        ]
    }

    /// Those of eight cubes of `voxels` along each axis, on a map of `n` cells; `cubes` are the
    /// cubes' numbers along x, y, z.
    #[inline(always)]
    fn over(
        tiles: Tiles,
        n: [usize; 2],
        tile: usize,
        voxels: usize,
        steps: &[DVec3; 3],
        cubes: [[usize; 3]; 8],
    ) -> Bounds {
        // From a cube's first voxel to its lowest and highest ones, in cells and mm.
        let reach = [0, 1, 2].map(|a| {
            let ends = steps.map(|s| s[a] * (voxels - 1) as f64);
            let sum = |f: fn(f64, f64) -> f64| ends.iter().map(|e| f(*e, 0.0)).sum::<f64>();
            (sum(f64::min), sum(f64::max))
        });
        // A cube's first cell may be any of its tile.
        let spans = [0, 1].map(|a| {
            let cells = (reach[a].1 - reach[a].0 + 2.0 * HAIR) as usize + 1;
            cells.div_ceil(tile) + 1
        });
        let to = |a: usize, more: f64| {
            cubes.map(|c| {
                let cube = (0..3).map(|i| steps[i][a] * (c[i] * voxels) as f64).sum::<f64>();
                (cube + more) as f32
            })
        };
        // The cell that holds a place is the floor of what lies half a cell further.
        let last = |a: usize| n[a] as f64 - 1.0 - (reach[a].1 - reach[a].0) - 2.0 * HAIR;
        let tiles_along_u = tiles.n[0] as i32;
        let mut range = tiles.widened(spans, MARGIN_MM);
        // What is said of a cube that lies, in part, where no cells are.
        range.push((f32::NEG_INFINITY, f32::INFINITY));
        Bounds {
            per_cell: 1.0 / tile as f32,
            nu: tiles_along_u,
            first: [0, 1].map(|a| to(a, reach[a].0 + 0.5 - HAIR)),
            lowest: to(2, reach[2].0),
            highest: to(2, reach[2].1),
            last: [last(0) as f32, last(1) as f32],
            range,
        }
    }

    /// What there is to tell of the eight cubes from the place `at` on.
    #[inline(always)]
    fn verdicts(&self, at: DVec3) -> Told {
        let (u, v, z) = (at.x as f32, at.y as f32, at.z as f32);
        let mut tile = [0; 8];
        for (c, tile) in tile.iter_mut().enumerate() {
            let (u, v) = (u + self.first[0][c], v + self.first[1][c]);
            let known = (u >= 0.0) & (v >= 0.0) & (u <= self.last[0]) & (v <= self.last[1]);
            let row = self.nu.wrapping_mul(below(v * self.per_cell));
            let at = below(u * self.per_cell).wrapping_add(row);
            *tile = if known { at as u32 } else { u32::MAX };
        }
        let unknown = self.range.len() - 1;
        let mut told = Told { some: 0, all: 0 };
        for (c, tile) in tile.iter().enumerate() {
            let (least, most) = self.range[(*tile as usize).min(unknown)];
            told.some |= u8::from(z + self.highest[c] >= least) << c;
            told.all |= u8::from(z + self.lowest[c] > most) << c;
        }
        told
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
            let few = air.minus(&solid.grown());
            let few = BitGrid::from_fn(frame.dims, |v| few.get(v) && v[0] % 7 == 3);
            assert!((1..=FEW).contains(&few.count()) && air.count() > FEW);
            assert_eq!(reachable(&map, &few, &frame), one.and(&few), "{d:?}");
            assert_eq!(reached_along(&scene, &solid, &cutter, d), one, "{d:?}");
            let one = singly(&nozzle_map(&scene, &air, &nozzle, d, 0.0));
            assert_eq!(reached_along(&scene, &solid, &nozzle, d), one, "{d:?}");
        }
    }
}
