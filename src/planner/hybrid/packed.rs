//! Voxel sets at rest: a search keeps hundreds of states, most of them only to be known again.

use crate::voxel::BitGrid;

/// A voxel set as runs along its rows.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Packed {
    dims: [usize; 3],
    /// Row by row: the number of its runs, then x and length of each.
    runs: Vec<u32>,
    key: u128,
}

impl Packed {
    pub fn of(grid: &BitGrid) -> Packed {
        let [_, ny, nz] = grid.dims();
        let mut runs = Vec::new();
        let mut all = grid.runs().peekable();
        for (y, z) in (0..nz).flat_map(|z| (0..ny).map(move |y| (y, z))) {
            let count = runs.len();
            runs.push(0);
            while let Some((_, _, x, len)) = all.next_if(|r| (r.0, r.1) == (y, z)) {
                runs.extend([x as u32, len as u32]);
                runs[count] += 1;
            }
        }
        runs.shrink_to_fit();
        Packed { dims: grid.dims(), runs, key: key(&grid.words()) }
    }

    pub fn grid(&self) -> BitGrid {
        let ny = self.dims[1];
        let mut grid = BitGrid::new(self.dims);
        let mut rest = &self.runs[..];
        let mut row = 0;
        while let [count, after @ ..] = rest {
            let (own, next) = after.split_at(2 * *count as usize);
            for run in own.chunks_exact(2) {
                grid.fill_run(row % ny, row / ny, run[0] as usize, run[1] as usize);
            }
            (rest, row) = (next, row + 1);
        }
        grid
    }

    /// 128 bits that differ for different sets of one frame but by a chance of 2⁻¹²⁸ a pair.
    pub fn key(&self) -> u128 {
        self.key
    }

    /// Bytes it takes.
    pub fn bytes(&self) -> usize {
        self.runs.capacity() * size_of::<u32>()
    }
}

/// Two multiplicative hashes side by side.
fn key(words: &[u64]) -> u128 {
    let (mut a, mut b) = (0x9E37_79B9_7F4A_7C15_u64, 0xC2B2_AE3D_27D4_EB4F_u64);
    for w in words {
        a = (a ^ w).wrapping_mul(0xFF51_AFD7_ED55_8CCD).rotate_left(31);
        b = (b.rotate_left(27) ^ w).wrapping_mul(0xC4CE_B9FE_1A85_EC53);
        b ^= b >> 29;
    }
    u128::from(a) << 64 | u128::from(b)
}
