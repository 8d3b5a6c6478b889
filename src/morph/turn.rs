//! Turns of grids and elements by right angles, exact.

use super::Element;
use crate::base::Direction;
use crate::voxel::BitGrid;
use rayon::prelude::*;

/// Maps a grid axis of a direction to +z by swapping and flipping axes. Swaps mirror, which a tool
/// that is round about its axis does not notice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Axis {
    /// 0, 1, 2 for x, y, z.
    index: usize,
    flip: bool,
}

impl Axis {
    /// The axis of a grid direction; none for any other direction.
    pub fn of(direction: Direction) -> Option<Axis> {
        let v = direction.vec().to_array();
        let index = v.iter().position(|c| *c != 0.0)?;
        direction.is_grid_axis().then_some(Axis { index, flip: v[index] < 0.0 })
    }

    /// The dims of a grid of `dims` with this axis pointing up.
    pub fn dims_up(self, mut dims: [usize; 3]) -> [usize; 3] {
        dims.swap(self.index, 2);
        dims
    }

    /// The grid with this axis pointing up.
    pub fn up(self, grid: &BitGrid) -> BitGrid {
        let swapped = match self.index {
            0 => swap_xz(grid),
            1 => swap_yz(grid),
            _ => grid.clone(),
        };
        if self.flip { flip_z(&swapped) } else { swapped }
    }

    /// The inverse of [`Axis::up`].
    pub fn down(self, grid: &BitGrid) -> BitGrid {
        let flipped = if self.flip { flip_z(grid) } else { grid.clone() };
        match self.index {
            0 => swap_xz(&flipped),
            1 => swap_yz(&flipped),
            _ => flipped,
        }
    }
}

fn flip_z(grid: &BitGrid) -> BitGrid {
    let mut out = BitGrid::new(grid.dims());
    let nz = grid.dims()[2];
    out.par_rows_mut().for_each(|(y, z, row)| row.copy_from_slice(grid.row(y, nz - 1 - z)));
    out
}

fn swap_yz(grid: &BitGrid) -> BitGrid {
    let [nx, ny, nz] = grid.dims();
    let mut out = BitGrid::new([nx, nz, ny]);
    out.par_rows_mut().for_each(|(y, z, row)| row.copy_from_slice(grid.row(z, y)));
    out
}

/// Swaps x and z by blocks of 64 × 64 bits.
fn swap_xz(grid: &BitGrid) -> BitGrid {
    let [nx, ny, nz] = grid.dims();
    let mut out = BitGrid::new([nz, ny, nx]);
    let (words_in, words_out) = (grid.words_per_row(), out.words_per_row());
    let planes: Vec<Vec<u64>> = (0..ny)
        .into_par_iter()
        .map(|y| {
            let mut plane = vec![0u64; nx * words_out];
            let mut block = [0u64; 64];
            for bz in 0..words_out {
                for bx in 0..words_in {
                    for (i, word) in block.iter_mut().enumerate() {
                        let z = bz * 64 + i;
                        *word = if z < nz { grid.row(y, z)[bx] } else { 0 };
                    }
                    if block.iter().all(|w| *w == 0) {
                        continue;
                    }
                    transpose(&mut block);
                    for (i, word) in block.iter().enumerate().take(nx - bx * 64) {
                        plane[(bx * 64 + i) * words_out + bz] = *word;
                    }
                }
            }
            plane
        })
        .collect();
    out.par_rows_mut().for_each(|(y, z, row)| {
        row.copy_from_slice(&planes[y][z * words_out..(z + 1) * words_out]);
    });
    out
}

/// Bit j of word i becomes bit i of word j (Warren, Hacker's Delight, 7-3).
fn transpose(a: &mut [u64; 64]) {
    let mut j = 32;
    let mut mask: u64 = 0x0000_0000_FFFF_FFFF;
    while j > 0 {
        let mut k = 0;
        while k < 64 {
            let t = ((a[k] >> j) ^ a[k + j]) & mask;
            a[k] ^= t << j;
            a[k + j] ^= t;
            k = (k + j + 1) & !j;
        }
        j >>= 1;
        mask ^= mask << j;
    }
}

/// A rotation by right angles: row i of the matrix is ±e of `from[i]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rotation {
    from: [usize; 3],
    sign: [i64; 3],
}

impl Rotation {
    fn apply(&self, o: [i64; 3]) -> [i64; 3] {
        std::array::from_fn(|i| self.sign[i] * o[self.from[i]])
    }

    /// The rotated grid, its lowest corner at voxel 0 again.
    pub fn of_grid(&self, grid: &BitGrid) -> BitGrid {
        let dims: [usize; 3] = std::array::from_fn(|i| grid.dims()[self.from[i]]);
        let mut out = BitGrid::new(dims);
        for v in grid.iter_ones() {
            let o = self.apply(v.map(|c| c as i64));
            out.set(
                std::array::from_fn(|i| {
                    (if self.sign[i] < 0 { o[i] + dims[i] as i64 - 1 } else { o[i] }) as usize
                }),
                true,
            );
        }
        out
    }
}

/// The 24 rotations of the cube, the identity first.
pub fn cardinal_rotations() -> Vec<Rotation> {
    let mut all = Vec::new();
    for (from, odd) in [
        ([0, 1, 2], false),
        ([1, 2, 0], false),
        ([2, 0, 1], false),
        ([0, 2, 1], true),
        ([2, 1, 0], true),
        ([1, 0, 2], true),
    ] {
        for signs in 0..8u32 {
            let sign = std::array::from_fn(|i| 1 - 2 * i64::from(signs >> i & 1));
            if (signs.count_ones() % 2 == 1) == odd {
                all.push(Rotation { from, sign });
            }
        }
    }
    all
}

/// A finite element, rotated.
pub fn turned(element: &Element, rotation: &Rotation) -> Element {
    let offsets: Vec<[i64; 3]> = element
        .chords()
        .flat_map(|(z, c)| (c.x..c.x + c.len).map(move |x| [x, c.y, z]))
        .map(|o| rotation.apply(o))
        .collect();
    Element::from_offsets(&offsets)
}
