//! Grey-scale dilation and erosion of depth images by a round kernel.
//!
//! out(c) = op over the kernel's cells o of image(c + o) + value(o), for the wanted cells c only;
//! cells outside the image have no part in it. The kernel depends on the distance alone, so rows
//! above and below share their work, cells left and right share their addition, and a run of one
//! value (the flat of a holder) takes a running extreme instead of one pass a cell. Extremes of
//! f32 are exact: every order of evaluation gives the same bytes.
//!
//! Blocks of cells whose value the bounds of what the kernel sees from them already tell are
//! settled without it: where nothing seen can pass what the cells hold (the ball under a holder that
//! stands higher), and where all that is seen is one value. Sums of f32 never fall when a summand
//! rises, so what is settled has the bytes that the kernel would have given.

use super::tiles::{Extreme, Largest, Least, Tiles, running_extreme};
use pulp::Arch;
use rayon::prelude::*;
use std::marker::PhantomData;
use std::ops::Range;

/// Cells per register block of the inner loop: four of a machine's widest common registers.
const BLOCK: usize = 32;

/// Wanted runs closer than this are computed as one; the gap costs less than a second start.
const JOIN: usize = 24;

/// Cells along each axis of the tiles whose bounds settle blocks. Larger ones settle fewer, smaller
/// ones take longer to look through.
const TILE: usize = 8;

/// An image has its bounds made only when at least one in so many of its cells is asked for, so that
/// a few wanted cells do not cost a look at all of it.
const BOUNDS_WORTH: usize = 4;

/// Passes that a flat run takes, about.
const FLAT_COST: usize = 6;

/// A flat run shorter than this is cheaper cell by cell.
const LEAST_FLAT: usize = 4;

#[derive(Clone, Copy, PartialEq)]
pub enum Op {
    Max,
    Min,
}

/// An image by rows of `width` cells.
pub struct Image<'a> {
    pub width: usize,
    pub cells: &'a [f32],
}

/// The wanted cells of an image: disjoint ascending runs per row.
#[derive(Clone)]
pub struct Spans {
    rows: Vec<Vec<Range<usize>>>,
}

impl Spans {
    #[cfg(test)]
    pub fn all(width: usize, height: usize) -> Spans {
        let whole = 0..width;
        Spans { rows: vec![vec![whole]; height] }
    }

    /// Runs of a mask of rows of `width` cells.
    pub fn of(mask: &[bool], width: usize) -> Spans {
        let rows = mask
            .chunks(width)
            .map(|row| {
                let mut runs: Vec<Range<usize>> = Vec::new();
                for i in (0..width).filter(|i| row[*i]) {
                    push(&mut runs, i..i + 1);
                }
                runs
            })
            .collect();
        Spans { rows }
    }

    /// One run a row.
    pub fn of_runs(runs: Vec<Range<usize>>) -> Spans {
        let row = |run: Range<usize>| if run.is_empty() { Vec::new() } else { vec![run] };
        Spans { rows: runs.into_iter().map(row).collect() }
    }

    /// Runs per row, each no earlier than the one before; those close together are joined.
    pub fn of_rows(rows: impl Iterator<Item = Vec<Range<usize>>>) -> Spans {
        let joined = |row: Vec<Range<usize>>| {
            let mut runs = Vec::new();
            row.into_iter().for_each(|s| push(&mut runs, s));
            runs
        };
        Spans { rows: rows.map(joined).collect() }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.rows.iter().all(|runs| runs.is_empty())
    }

    /// The cells at most `reach` cells away along each axis, within `width`.
    pub fn grown(&self, reach: usize, width: usize) -> Spans {
        Spans::of_rows((0..self.rows.len()).map(|j| {
            let near = j.saturating_sub(reach)..(j + reach + 1).min(self.rows.len());
            let mut wide: Vec<Range<usize>> = self.rows[near]
                .iter()
                .flatten()
                .map(|s| s.start.saturating_sub(reach)..(s.end + reach).min(width))
                .collect();
            wide.sort_by_key(|s| s.start);
            wide
        }))
    }

    /// Number of cells.
    fn count(&self) -> usize {
        self.rows.iter().flatten().map(|run| run.len()).sum()
    }

    pub fn rows(&self) -> impl Iterator<Item = &Vec<Range<usize>>> {
        self.rows.iter()
    }
}

/// Appends a run that starts no earlier than the last one.
fn push(runs: &mut Vec<Range<usize>>, run: Range<usize>) {
    match runs.last_mut() {
        Some(last) if run.start <= last.end + JOIN => last.end = last.end.max(run.end),
        _ => runs.push(run),
    }
}

/// One row of a kernel at ±`j` rows.
struct KernelRow {
    j: usize,
    /// Half width and value of the run of equal values in its middle.
    flat: Option<(usize, f32)>,
    /// (i, value) at ±i cells beside that run.
    beside: Vec<(usize, f32)>,
}

/// A round kernel: values by distance.
pub struct Kernel {
    reach: usize,
    rows: Vec<KernelRow>,
    /// Least and largest of its values.
    least: f32,
    largest: f32,
}

impl Kernel {
    /// Every `stride`-th cell up to `reach` along each axis where `value` of its distance (cells)
    /// is something.
    pub fn of(reach: usize, stride: usize, value: impl Fn(f64) -> Option<f32>) -> Kernel {
        let (mut rows, mut least, mut largest) = (Vec::new(), Least::NONE, Largest::NONE);
        for j in (0..=reach).step_by(stride) {
            let mut cells: Vec<(usize, f32)> = (0..=reach)
                .step_by(stride)
                .filter_map(|i| Some((i, value(((i * i + j * j) as f64).sqrt())?)))
                .collect();
            for (_, v) in &cells {
                (least, largest) = (Least::of(*v, least), Largest::of(*v, largest));
            }
            let mut flat = None;
            if let (1, Some(&(0, middle))) = (stride, cells.first()) {
                let run = cells.iter().take_while(|(_, v)| *v == middle).count();
                if run > LEAST_FLAT {
                    flat = Some((run - 1, middle));
                    cells.drain(..run);
                }
            }
            if flat.is_some() || !cells.is_empty() {
                rows.push(KernelRow { j, flat, beside: cells });
            }
        }
        Kernel { reach, rows, least, largest }
    }

    /// About how many passes over a run of cells it takes.
    pub fn cost(&self) -> usize {
        let flat = |row: &KernelRow| if row.flat.is_some() { FLAT_COST } else { 0 };
        self.rows.iter().map(|row| row.beside.len() + flat(row)).sum()
    }

    /// The largest of its values; less than any number where it has none.
    pub fn largest(&self) -> f32 {
        self.largest
    }
}

/// Filters `image` into the `spans` of `out`, an image of `width` whose cell (0, 0) lies at `at`
/// cells from the image's own; what `out` holds takes part.
pub fn filter(
    op: Op,
    image: &Image,
    at: (isize, isize),
    width: usize,
    out: &mut [f32],
    spans: &Spans,
    kernel: &Kernel,
) {
    if kernel.rows.is_empty() {
        return;
    }
    let arch = Arch::new();
    let worth = spans.count() >= image.cells.len() / BOUNDS_WORTH;
    let seen = worth.then(|| arch.dispatch(MakeSeen { image, reach: kernel.reach }));
    out.par_chunks_mut(width).zip(&spans.rows).enumerate().for_each_init(
        Scratch::default,
        |scratch, (row, (out, spans))| {
            let place = |i: usize| (at.0 + i as isize, at.1 + row as isize);
            let mut run = |out: &mut [f32], cells: Range<usize>| {
                let (start, out) = (place(cells.start), &mut out[cells]);
                match op {
                    Op::Max => {
                        arch.dispatch(Run::<Largest>::of(image, start, out, kernel, scratch))
                    }
                    Op::Min => arch.dispatch(Run::<Least>::of(image, start, out, kernel, scratch)),
                }
            };
            for span in spans {
                let Some(seen) = &seen else {
                    run(out, span.clone());
                    continue;
                };
                let mut open = span.start;
                for from in span.clone().step_by(BLOCK) {
                    let end = (from + BLOCK).min(span.end);
                    let block = &mut out[from..end];
                    let settled = match op {
                        Op::Max => seen.settle::<Largest>(place(from), block, kernel.largest),
                        Op::Min => seen.settle::<Least>(place(from), block, kernel.least),
                    };
                    if settled {
                        if open < from {
                            run(out, open..from);
                        }
                        open = end;
                    }
                }
                if open < span.end {
                    run(out, open..span.end);
                }
            }
        },
    );
}

/// Bounds of what a kernel sees from blocks of cells of an image.
struct Seen {
    reach: isize,
    /// Cells of the image along u and v.
    cells: [isize; 2],
    /// Tiles along u and v.
    tiles: [usize; 2],
    /// Least and largest cell seen from a block whose first seen cell lies in a tile, or among more.
    range: Vec<(f32, f32)>,
}

/// Makes the bounds, by the widest registers there are.
struct MakeSeen<'a> {
    image: &'a Image<'a>,
    reach: usize,
}

impl pulp::NullaryFnOnce for MakeSeen<'_> {
    type Output = Seen;

    #[inline(always)]
    fn call(self) -> Seen {
        let MakeSeen { image, reach } = self;
        let n = [image.width, image.cells.len().checked_div(image.width).unwrap_or(0)];
        let of_tiles = Tiles::of::<TILE>(image.cells, image.cells, n);
        let tiles = of_tiles.n;
        // The first cell may be the last of its tile.
        let over = |cells: usize| (cells + TILE - 1).div_ceil(TILE);
        let range = of_tiles.widened([over(BLOCK + 2 * reach), over(1 + 2 * reach)], 0.0);
        Seen { reach: reach as isize, cells: n.map(|n| n as isize), tiles, range }
    }
}

impl Seen {
    /// Whether the bounds tell the values of a block of at most [`BLOCK`] cells whose first lies at
    /// `start` of the image; it has them then. `value` is the kernel's extreme one.
    #[inline(always)]
    fn settle<E: Extreme>(&self, start: (isize, isize), block: &mut [f32], value: f32) -> bool {
        let first = [start.0 - self.reach, start.1 - self.reach];
        let tile = [0, 1].map(|a| (first[a].max(0) as usize / TILE).min(self.tiles[a] - 1));
        let Some(&(least, most)) = self.range.get(tile[0] + self.tiles[0] * tile[1]) else {
            return false;
        };
        let best = E::of(least, most) + value;
        if block.iter().all(|b| E::of(best, *b) == *b) {
            return true;
        }
        let past = [first[0] + block.len() as isize + 2 * self.reach, start.1 + self.reach + 1];
        // Of a kernel that reaches beyond the image the cell of that value may be missing.
        let whole = (0..2).all(|a| first[a] >= 0 && past[a] <= self.cells[a]);
        if whole && least == most {
            block.iter_mut().for_each(|b| *b = E::of(best, *b));
        }
        whole && least == most
    }
}

#[derive(Default)]
struct Scratch {
    /// Extremes so far, the run rounded up to whole blocks.
    best: Vec<f32>,
    /// Two rows of the image made one, `reach` cells wider on either side.
    rows: Vec<f32>,
    running: Vec<f32>,
    room: Vec<f32>,
}

/// One run of cells that starts at `start` of the image, by the widest registers there are.
struct Run<'a, E> {
    image: &'a Image<'a>,
    start: (isize, isize),
    out: &'a mut [f32],
    kernel: &'a Kernel,
    scratch: &'a mut Scratch,
    extreme: PhantomData<E>,
}

impl<'a, E> Run<'a, E> {
    fn of(
        image: &'a Image<'a>,
        start: (isize, isize),
        out: &'a mut [f32],
        kernel: &'a Kernel,
        scratch: &'a mut Scratch,
    ) -> Self {
        Run { image, start, out, kernel, scratch, extreme: PhantomData }
    }
}

impl<E: Extreme> pulp::NullaryFnOnce for Run<'_, E> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Run { image, start, out, kernel, scratch, .. } = self;
        let blocks = out.len().div_ceil(BLOCK);
        let Scratch { best, rows, running, room } = scratch;
        best.clear();
        best.extend_from_slice(out);
        best.resize(blocks * BLOCK, E::NONE);
        let left = start.0 - kernel.reach as isize;
        let len = best.len() + 2 * kernel.reach;
        for k in &kernel.rows {
            let above = part_of(image, left, start.1 + k.j as isize, len);
            let below = part_of(image, left, start.1 - k.j as isize, len);
            let Some((at, row)) = above.or(below) else { continue };
            let rows: &[f32] = match (above, below) {
                (Some((_, a)), Some(_)) if k.j == 0 && a.len() == len => a,
                (Some((_, a)), Some((_, b))) if a.len() == len => {
                    rows.clear();
                    rows.extend(a.iter().zip(b).map(|(a, b)| E::of(*a, *b)));
                    rows
                }
                _ => {
                    rows.clear();
                    rows.resize(at, E::NONE);
                    rows.extend_from_slice(row);
                    rows.resize(len, E::NONE);
                    if let (Some(_), Some((at, row))) = (above, below) {
                        for (r, h) in rows[at..].iter_mut().zip(row) {
                            *r = E::of(*r, *h);
                        }
                    }
                    rows
                }
            };
            if let Some((half, value)) = k.flat {
                running.clear();
                running.extend_from_slice(&rows[kernel.reach - half..]);
                running_extreme::<E>(running, room, 1, 2 * half + 1);
                for (b, r) in best.iter_mut().zip(running.iter()) {
                    *b = E::of(r + value, *b);
                }
            }
            for (c, block) in best.chunks_exact_mut(BLOCK).enumerate() {
                beside::<E>(block, &rows[c * BLOCK..], kernel.reach, &k.beside);
            }
        }
        out.copy_from_slice(&best[..out.len()]);
    }
}

/// Takes what lies ±i cells from a block into it; `rows` starts `reach` cells before the block.
#[inline(always)]
fn beside<E: Extreme>(block: &mut [f32], rows: &[f32], reach: usize, cells: &[(usize, f32)]) {
    let mut acc = [E::NONE; BLOCK];
    acc.copy_from_slice(block);
    for &(i, value) in cells {
        let (a, b) = (&rows[reach - i..][..BLOCK], &rows[reach + i..][..BLOCK]);
        for x in 0..BLOCK {
            acc[x] = E::of(E::of(a[x], b[x]) + value, acc[x]);
        }
    }
    block.copy_from_slice(&acc);
}

/// Of `len` cells of the image's row `j` from column `left` those that there are, and where they
/// start.
#[inline(always)]
fn part_of<'a>(image: &Image<'a>, left: isize, j: isize, len: usize) -> Option<(usize, &'a [f32])> {
    let height = image.cells.len().checked_div(image.width).unwrap_or(0) as isize;
    if j < 0 || j >= height {
        return None;
    }
    let from = (-left).clamp(0, len as isize);
    let to = (image.width as isize - left).clamp(from, len as isize);
    let source = (j * image.width as isize + left + from) as usize;
    (from < to).then(|| (from as usize, &image.cells[source..][..(to - from) as usize]))
}

#[cfg(test)]
#[path = "filter_tests.rs"]
mod tests;
