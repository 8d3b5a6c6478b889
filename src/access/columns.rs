//! The depth engine on voxels: grey-scale morphology on the heights of columns.
//!
//! For a tool that goes up without end and never narrows, an obstacle is the height h(u, v) of its
//! highest voxel in each column. The tip may stand at (u, v, t) from H(u, v) = max h − f + 1 on, f
//! the lowest offset of the body in a column, and the edge touches (u, v, z) from
//! G(u, v) = min H + k on, k the lowest offset of the edge.

use super::VoxelTool;
use crate::morph::{Chord, Element, Plane, Window};
use crate::voxel::BitGrid;
use rayon::prelude::*;

/// Height of a column without an obstacle: lower than any tool is long.
const NONE: i32 = i32::MIN / 4;

/// An image of heights with the position of its first cell.
struct Heights {
    lo: [i64; 2],
    n: [usize; 2],
    cells: Vec<i32>,
}

/// HB Alg. 1 for a tool whose offsets lie in the grid's axes: the voxels of the grid that the edge
/// touches from tips at which the body meets nothing of `obstacle`.
pub fn accessible(obstacle: &BitGrid, tool: &VoxelTool) -> BitGrid {
    let edge = tool.touching();
    let Some(reach) = edge.bounds() else { return BitGrid::new(obstacle.dims()) };
    let grid = Window::of(obstacle.dims());
    let tips = grid.minus(&reach);
    let lowest = lowest_tips(&tops(obstacle), tool.body(), &tips, &grid);
    let touched = touched_from(&lowest, &edge, &grid);
    from_heights(&touched, obstacle.dims())
}

/// The highest solid voxel of each column.
fn tops(grid: &BitGrid) -> Heights {
    let [nx, ny, nz] = grid.dims();
    let mut cells = vec![NONE; nx * ny];
    cells.par_chunks_mut(nx.max(1)).enumerate().for_each(|(y, row)| {
        let mut open = vec![!0u64; grid.words_per_row()];
        for z in (0..nz).rev() {
            for (w, (open, bits)) in open.iter_mut().zip(grid.row(y, z)).enumerate() {
                let mut new = bits & *open;
                *open &= !bits;
                while new != 0 {
                    row[w * 64 + new.trailing_zeros() as usize] = z as i32;
                    new &= new - 1;
                }
            }
        }
    });
    Heights { lo: [0, 0], n: [nx, ny], cells }
}

/// H at the tips of a window.
fn lowest_tips(tops: &Heights, body: &Element, tips: &Window, grid: &Window) -> Heights {
    let n = [tips.dims()[0], tips.dims()[1]];
    let link = grid.minus(tips);
    let highest = tops.cells.iter().copied().max().unwrap_or(NONE);
    let mut cells = vec![NONE; n[0] * n[1]];
    cells.par_chunks_mut(n[0].max(1)).enumerate().for_each(|(j, row)| {
        let v = tips.lo[1] + j as i64;
        let mut room = Vec::new();
        for layer in body.layers() {
            let chords: &[Chord] = match &layer.plane {
                Plane::Whole => {
                    raise(row, std::iter::repeat(highest), layer.z);
                    continue;
                }
                Plane::Chords(c) => c,
            };
            for c in chords {
                let (x, end) = (c.x.max(link.lo[0]), (c.x + c.len).min(link.hi[0]));
                let from = v + c.y;
                if x >= end || !(0..tops.n[1] as i64).contains(&from) {
                    continue;
                }
                let from = &tops.cells[from as usize * tops.n[0]..][..tops.n[0]];
                running_max(from, tips.lo[0] + x, n[0], (end - x) as usize, &mut room);
                raise(row, room.iter().copied(), layer.z);
            }
        }
    });
    Heights { lo: [tips.lo[0], tips.lo[1]], n, cells }
}

/// row[i] = max(row[i], heights[i] − f + 1), where there is a height.
fn raise(row: &mut [i32], heights: impl Iterator<Item = i32>, f: i64) {
    for (r, h) in row.iter_mut().zip(heights).filter(|(_, h)| *h > NONE) {
        *r = (*r).max((i64::from(h) - f + 1).max(i64::from(NONE) + 1) as i32);
    }
}

/// out[i] = max of cells[at + i .. at + i + length], i < n; cells outside the row are NONE.
fn running_max(cells: &[i32], at: i64, n: usize, length: usize, out: &mut Vec<i32>) {
    out.clear();
    out.extend(
        (0..(n + length - 1) as i64).map(|i| {
            usize::try_from(at + i).ok().and_then(|c| cells.get(c)).copied().unwrap_or(NONE)
        }),
    );
    let mut covered = 1;
    while covered < length {
        let step = covered.min(length - covered);
        for i in 0..out.len() - step {
            out[i] = out[i].max(out[i + step]);
        }
        covered += step;
    }
    out.truncate(n);
}

/// G over the grid's columns.
fn touched_from(lowest: &Heights, edge: &Element, grid: &Window) -> Heights {
    let n = [grid.dims()[0], grid.dims()[1]];
    let mut cells = vec![i32::MAX; n[0] * n[1]];
    cells.par_chunks_mut(n[0].max(1)).enumerate().for_each(|(j, row)| {
        for (k, c) in edge.chords() {
            let v = j as i64 - c.y - lowest.lo[1];
            let Some(v) = usize::try_from(v).ok().filter(|v| *v < lowest.n[1]) else { continue };
            let from = &lowest.cells[v * lowest.n[0]..][..lowest.n[0]];
            for x in c.x..c.x + c.len {
                // The window of tips holds every x − k.
                let first = (-x - lowest.lo[0]) as usize;
                for (g, h) in row.iter_mut().zip(&from[first..]) {
                    *g = (*g).min(h.saturating_add(k as i32));
                }
            }
        }
    });
    Heights { lo: [0, 0], n, cells }
}

/// The voxels from each column's height on.
fn from_heights(heights: &Heights, dims: [usize; 3]) -> BitGrid {
    let mut out = BitGrid::new(dims);
    if dims.contains(&0) {
        return out;
    }
    for (i, h) in heights.cells.iter().enumerate() {
        let z = usize::try_from(*h).unwrap_or(0);
        if z < dims[2] {
            out.set([i % dims[0], i / dims[0], z], true);
        }
    }
    for z in 1..dims[2] {
        for y in 0..dims[1] {
            let below = out.row(y, z - 1).to_vec();
            out.row_mut(y, z).iter_mut().zip(below).for_each(|(o, b)| *o |= b);
        }
    }
    out
}
