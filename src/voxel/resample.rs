//! Coarser grids: a quick look at a solid before the exact one.

use super::{BitGrid, Frame};
use rayon::prelude::*;

impl Frame {
    /// The frame whose voxels are cubes of `factor` voxels of this one, from the same corner.
    pub fn coarsened(&self, factor: usize) -> Frame {
        Frame {
            pitch: self.pitch * factor as f64,
            dims: self.dims.map(|n| n.div_ceil(factor)),
            origin: self.origin,
        }
    }
}

/// The grid of [`Frame::coarsened`] in which a voxel is solid when at least `least` of the
/// factor³ voxels in it are.
pub fn coarsened(grid: &BitGrid, factor: usize, least: usize) -> BitGrid {
    if factor == 1 && least == 1 {
        return grid.clone();
    }
    let [_, ny, nz] = grid.dims();
    let mut out = BitGrid::new(grid.dims().map(|n| n.div_ceil(factor)));
    let nx = out.dims()[0];
    if least == 1 {
        // Any will do: all rows of a cube at once.
        out.par_rows_mut().for_each_init(
            || vec![0u64; grid.words_per_row()],
            |any, (cy, cz, row)| {
                any.fill(0);
                for z in cz * factor..((cz + 1) * factor).min(nz) {
                    for y in cy * factor..((cy + 1) * factor).min(ny) {
                        any.iter_mut().zip(grid.row(y, z)).for_each(|(any, bits)| *any |= bits);
                    }
                }
                each_one(any, |x| row[x / factor / 64] |= 1 << (x / factor % 64));
            },
        );
        return out;
    }
    out.par_rows_mut().for_each_init(
        || vec![0usize; nx],
        |counts, (cy, cz, row)| {
            counts.fill(0);
            for z in cz * factor..((cz + 1) * factor).min(nz) {
                for y in cy * factor..((cy + 1) * factor).min(ny) {
                    each_one(grid.row(y, z), |x| counts[x / factor] += 1);
                }
            }
            for (x, _) in counts.iter().enumerate().filter(|(_, n)| **n >= least) {
                row[x / 64] |= 1 << (x % 64);
            }
        },
    );
    out
}

/// The places of the ones in a row of words.
fn each_one(words: &[u64], mut f: impl FnMut(usize)) {
    for (w, &bits) in words.iter().enumerate() {
        let mut rest = bits;
        while rest != 0 {
            f(w * 64 + rest.trailing_zeros() as usize);
            rest &= rest - 1;
        }
    }
}

/// The voxels of a grid of `dims` that lie in a solid voxel of its coarsened grid.
pub fn refined(coarse: &BitGrid, factor: usize, dims: [usize; 3]) -> BitGrid {
    let mut out = BitGrid::new(dims);
    for (y, z, x, n) in coarse.runs() {
        let (from, to) = (x * factor, ((x + n) * factor).min(dims[0]));
        for fz in z * factor..((z + 1) * factor).min(dims[2]) {
            for fy in y * factor..((y + 1) * factor).min(dims[1]) {
                out.fill_run(fy, fz, from, to - from);
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::DVec3;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn counts_what_lies_in_each_cube(
            dims in [1usize..140, 1usize..9, 1usize..9], factor in 1usize..5, least in 1usize..9,
            salt in any::<u64>(),
        ) {
            let solid = |v: [usize; 3]| {
                let n = v.iter().fold(salt, |s, c| (s ^ *c as u64).wrapping_mul(0x9E3779B97F4A7C15));
                n >> 62 == 0
            };
            let grid = BitGrid::from_fn(dims, solid);
            let coarse = coarsened(&grid, factor, least);
            for cell in BitGrid::from_fn(coarse.dims(), |_| true).iter_ones() {
                let inside = grid.iter_ones().filter(|v| v.map(|c| c / factor) == cell).count();
                prop_assert_eq!(coarse.get(cell), inside >= least);
            }
            let fine = refined(&coarsened(&grid, factor, 1), factor, dims);
            prop_assert!(grid.is_subset_of(&fine));
            for v in fine.iter_ones() {
                prop_assert!(coarsened(&grid, factor, 1).get(v.map(|c| c / factor)));
            }
        }
    }

    #[test]
    fn the_frame_keeps_its_corner() {
        let frame = Frame { pitch: 0.5, dims: [5, 6, 7], origin: DVec3::new(1.0, 2.0, 3.0) };
        let coarse = frame.coarsened(2);
        assert_eq!(coarse.dims, [3, 3, 4]);
        assert_eq!(coarse.center([0, 0, 0]), DVec3::new(1.5, 2.5, 3.5));
    }
}
