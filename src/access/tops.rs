//! The first voxels of a set that someone meets who looks along a grid axis.

use crate::base::DVec3;
use crate::voxel::BitGrid;
use rayon::prelude::*;

/// Height of a column without a voxel: lower than any tool is long.
pub const NONE: i32 = i32::MIN / 4;

/// The grid axis along which a direction points, and whether it points up that axis. None of a
/// direction that is tilted.
pub fn axis_of(d: DVec3) -> Option<(usize, bool)> {
    (0..3).find(|a| d[*a].abs() == 1.0).map(|a| (a, d[a] > 0.0))
}

/// A voxel of a column along `axis`: at the place `[a, b]` among the other two axes, `at` along it.
pub fn voxel(axis: usize, [a, b]: [usize; 2], at: usize) -> [usize; 3] {
    match axis {
        0 => [at, a, b],
        1 => [a, at, b],
        _ => [a, b, at],
    }
}

/// The number along `axis` of the highest voxel of each column, of the lowest unless `up`. Columns
/// are ordered by the other two axes, the earlier one running fastest.
pub fn tops(grid: &BitGrid, axis: usize, up: bool) -> Vec<i32> {
    let [nx, ny, nz] = grid.dims();
    if axis == 0 {
        let mut cells = vec![NONE; ny * nz];
        cells.par_chunks_mut(ny.max(1)).enumerate().for_each(|(z, row)| {
            for (y, top) in row.iter_mut().enumerate() {
                *top = end_of(grid.row(y, z), up).map_or(NONE, |x| x as i32);
            }
        });
        return cells;
    }
    let (across, along) = if axis == 1 { (nz, ny) } else { (ny, nz) };
    let mut cells = vec![NONE; nx * across];
    cells.par_chunks_mut(nx.max(1)).enumerate().for_each(|(a, row)| {
        let mut open = vec![!0u64; grid.words_per_row()];
        if let Some(last) = open.last_mut() {
            *last = grid.last_word_mask();
        }
        for i in 0..along {
            let i = if up { along - 1 - i } else { i };
            let bits = if axis == 1 { grid.row(i, a) } else { grid.row(a, i) };
            let mut left = 0;
            for (w, (open, bits)) in open.iter_mut().zip(bits).enumerate() {
                let mut new = bits & *open;
                *open &= !bits;
                left |= *open;
                while new != 0 {
                    row[w * 64 + new.trailing_zeros() as usize] = i as i32;
                    new &= new - 1;
                }
            }
            if left == 0 {
                break;
            }
        }
    });
    cells
}

/// The last, or the first, voxel of a row.
fn end_of(row: &[u64], up: bool) -> Option<usize> {
    if up {
        let w = row.iter().rposition(|w| *w != 0)?;
        return Some(w * 64 + 63 - row[w].leading_zeros() as usize);
    }
    let w = row.iter().position(|w| *w != 0)?;
    Some(w * 64 + row[w].trailing_zeros() as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tops_are_the_ends_of_every_column() {
        let dims = [70, 9, 11];
        let grid =
            BitGrid::from_fn(dims, |[x, y, z]| (x * 7 + y * 13 + z * 29) % 23 == 0 && x != 5);
        for axis in 0..3 {
            let others: Vec<usize> = (0..3).filter(|a| *a != axis).map(|a| dims[a]).collect();
            for up in [false, true] {
                let found = tops(&grid, axis, up);
                assert_eq!(found.len(), others[0] * others[1]);
                for (i, top) in found.iter().enumerate() {
                    let column = [i % others[0], i / others[0]];
                    let mut solid = (0..dims[axis]).filter(|t| grid.get(voxel(axis, column, *t)));
                    let end = if up { solid.next_back() } else { solid.next() };
                    assert_eq!(*top, end.map_or(NONE, |t| t as i32), "{axis} {up} {column:?}");
                }
            }
        }
    }
}
