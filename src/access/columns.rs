//! The depth engine on voxels: grey-scale morphology on the heights of columns.
//!
//! For a tool that goes up without end and never narrows, an obstacle is the height h(u, v) of its
//! highest voxel in each column. The tip may stand at (u, v, t) from H(u, v) = max h − f + 1 on, f
//! the lowest offset of the body in a column, and the edge touches (u, v, z) from
//! G(u, v) = min H + k on, k the lowest offset of the edge.

use super::VoxelTool;
use super::tops::{NONE, tops};
use crate::morph::{Chord, Element, Plane, Window};
use crate::voxel::BitGrid;
use rayon::prelude::*;
use std::collections::BTreeMap;

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
    let lowest = lowest_tips(&heights(obstacle), tool.body(), &tips, &grid);
    let touched = touched_from(&lowest, &edge, &grid);
    from_heights(&touched, obstacle.dims())
}

/// The highest solid voxel of each column.
fn heights(grid: &BitGrid) -> Heights {
    let [nx, ny, _] = grid.dims();
    Heights { lo: [0, 0], n: [nx, ny], cells: tops(grid, 2, true) }
}

/// H at the tips of a window. Chords of one place and length share their running extremes.
fn lowest_tips(tops: &Heights, body: &Element, tips: &Window, grid: &Window) -> Heights {
    let n = [tips.dims()[0], tips.dims()[1]];
    let link = grid.minus(tips);
    let highest = tops.cells.iter().copied().max().unwrap_or(NONE);
    let mut cells = vec![NONE; n[0] * n[1]];
    let mut extremes = vec![NONE; n[0] * tops.n[1]];
    for layer in body.layers() {
        let chords: &[Chord] = match &layer.plane {
            Plane::Whole => {
                raise(&mut cells, std::iter::repeat(highest), layer.z);
                continue;
            }
            Plane::Chords(c) => c,
        };
        let mut alike: BTreeMap<(i64, i64), Vec<i64>> = BTreeMap::new();
        for c in chords {
            let (x, end) = (c.x.max(link.lo[0]), (c.x + c.len).min(link.hi[0]));
            if x < end {
                alike.entry((x, end - x)).or_default().push(c.y);
            }
        }
        for ((x, len), ys) in alike {
            extremes
                .par_chunks_mut(n[0].max(1))
                .zip(tops.cells.par_chunks(tops.n[0].max(1)))
                .for_each_init(Vec::new, |room, (out, from)| {
                    running_max(from, tips.lo[0] + x, n[0], len as usize, room);
                    out.copy_from_slice(&room[..n[0]]);
                });
            cells.par_chunks_mut(n[0].max(1)).enumerate().for_each(|(j, row)| {
                let v = tips.lo[1] + j as i64;
                for from in ys.iter().filter_map(|y| usize::try_from(v + y).ok()) {
                    if from < tops.n[1] {
                        let from = &extremes[from * n[0]..(from + 1) * n[0]];
                        raise(row, from.iter().copied(), layer.z);
                    }
                }
            });
        }
    }
    Heights { lo: [tips.lo[0], tips.lo[1]], n, cells }
}

/// row[i] = max(row[i], heights[i] − f + 1), where there is a height.
fn raise(row: &mut [i32], heights: impl Iterator<Item = i32>, f: i64) {
    // Tools are shorter than NONE is low: without a height the sum stays below every real one.
    let by = (1 - f).clamp(i64::from(NONE) / 2, -i64::from(NONE) / 2) as i32;
    for (r, h) in row.iter_mut().zip(heights) {
        let raised = if h > NONE { h + by } else { NONE };
        *r = if raised > *r { raised } else { *r };
    }
}

/// out[i] = max of cells[at + i .. at + i + length], i < n; cells outside the row are NONE. The
/// rest of `out` is scratch.
fn running_max(cells: &[i32], at: i64, n: usize, length: usize, out: &mut Vec<i32>) {
    out.clear();
    out.resize(n + length - 1, NONE);
    let first = (-at).clamp(0, out.len() as i64);
    let last = (cells.len() as i64 - at).clamp(first, out.len() as i64);
    out[first as usize..last as usize]
        .copy_from_slice(&cells[(at + first) as usize..(at + last) as usize]);
    let mut covered = 1;
    while covered < length {
        let step = covered.min(length - covered);
        for i in 0..out.len() - step {
            let ahead = out[i + step];
            out[i] = if ahead > out[i] { ahead } else { out[i] };
        }
        covered += step;
    }
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
