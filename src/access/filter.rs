//! Grey-scale dilation and erosion of depth images by a round kernel.
//!
//! out(c) = op over the kernel's cells o of image(c + o) + value(o), for the wanted cells c only;
//! cells outside the image have no part in it. The kernel depends on the distance alone, so rows
//! above and below share their work, cells left and right share their addition, and a run of one
//! value (the flat of a holder) takes a running extreme instead of one pass a cell. Extremes of
//! f32 are exact: every order of evaluation gives the same bytes.

use pulp::Arch;
use rayon::prelude::*;
use std::marker::PhantomData;
use std::ops::Range;

/// Cells per register block of the inner loop: four of a machine's widest common registers.
const BLOCK: usize = 32;

/// Wanted runs closer than this are computed as one; the gap costs less than a second start.
const JOIN: usize = 24;

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

    /// The cells at most `reach` cells away along each axis, within `width`.
    pub fn grown(&self, reach: usize, width: usize) -> Spans {
        let rows = (0..self.rows.len())
            .map(|j| {
                let near = j.saturating_sub(reach)..(j + reach + 1).min(self.rows.len());
                let mut wide: Vec<Range<usize>> = self.rows[near]
                    .iter()
                    .flatten()
                    .map(|s| s.start.saturating_sub(reach)..(s.end + reach).min(width))
                    .collect();
                wide.sort_by_key(|s| s.start);
                let mut runs = Vec::new();
                wide.into_iter().for_each(|s| push(&mut runs, s));
                runs
            })
            .collect();
        Spans { rows }
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
}

impl Kernel {
    /// Every `stride`-th cell up to `reach` along each axis where `value` of its distance (cells)
    /// is something.
    pub fn of(reach: usize, stride: usize, value: impl Fn(f64) -> Option<f32>) -> Kernel {
        let mut rows = Vec::new();
        for j in (0..=reach).step_by(stride) {
            let mut cells: Vec<(usize, f32)> = (0..=reach)
                .step_by(stride)
                .filter_map(|i| Some((i, value(((i * i + j * j) as f64).sqrt())?)))
                .collect();
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
        Kernel { reach, rows }
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
    let arch = Arch::new();
    out.par_chunks_mut(width).zip(&spans.rows).enumerate().for_each_init(
        Scratch::default,
        |scratch, (row, (out, spans))| {
            for span in spans {
                let start = (at.0 + span.start as isize, at.1 + row as isize);
                let out = &mut out[span.clone()];
                match op {
                    Op::Max => {
                        arch.dispatch(Run::<Largest>::of(image, start, out, kernel, scratch))
                    }
                    Op::Min => arch.dispatch(Run::<Least>::of(image, start, out, kernel, scratch)),
                }
            }
        },
    );
}

pub trait Extreme: Send + Sync {
    /// Loses against everything.
    const NONE: f32;
    fn of(a: f32, b: f32) -> f32;
}

pub struct Largest;
pub struct Least;

impl Extreme for Largest {
    const NONE: f32 = f32::NEG_INFINITY;
    #[inline(always)]
    fn of(a: f32, b: f32) -> f32 {
        if a > b { a } else { b }
    }
}

impl Extreme for Least {
    const NONE: f32 = f32::INFINITY;
    #[inline(always)]
    fn of(a: f32, b: f32) -> f32 {
        if a < b { a } else { b }
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

/// Every cell becomes the extreme of `length` cells from it on, `stride` apart, by doubling; the last
/// ones of the array stand for shorter runs. `room` is scratch.
#[inline(always)]
pub fn running_extreme<E: Extreme>(
    cells: &mut Vec<f32>,
    room: &mut Vec<f32>,
    stride: usize,
    length: usize,
) {
    let mut covered = 1;
    while covered < length {
        let step = covered.min(length - covered);
        let far = cells.get(step * stride..).unwrap_or_default();
        room.resize(cells.len(), E::NONE);
        for ((r, near), far) in room.iter_mut().zip(cells.iter()).zip(far) {
            *r = E::of(*near, *far);
        }
        let n = far.len();
        room[n..].copy_from_slice(&cells[n..]);
        std::mem::swap(cells, room);
        covered += step;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn naive(op: Op, image: &Image, at: (isize, isize), c: (usize, usize), k: &Naive) -> f32 {
        let height = (image.cells.len() / image.width) as isize;
        let mut best = if op == Op::Max { f32::NEG_INFINITY } else { f32::INFINITY };
        for &(i, j, value) in k {
            let x = at.0 + c.0 as isize + i;
            let y = at.1 + c.1 as isize + j;
            if (0..image.width as isize).contains(&x) && (0..height).contains(&y) {
                let h = image.cells[(x + y * image.width as isize) as usize] + value;
                best = if op == Op::Max { best.max(h) } else { best.min(h) };
            }
        }
        best
    }

    type Naive = Vec<(isize, isize, f32)>;

    proptest! {
        #[test]
        fn equals_the_definition(
            width in 1usize..50, height in 1usize..20, out_width in 1usize..60,
            out_height in 1usize..12, at in (-30isize..30, -12isize..12), reach in 0usize..14,
            stride in 1usize..3, flat in 0f64..14.0, seed in any::<u64>(), max in any::<bool>(),
        ) {
            let mut state = seed;
            let mut next = || {
                state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                ((state >> 33) % 1000) as f32 / 8.0
            };
            let cells: Vec<f32> = (0..width * height).map(|_| next()).collect();
            let mask: Vec<bool> = (0..out_width * out_height).map(|_| next() < 8.0).collect();
            let image = Image { width, cells: &cells };
            let value = |d: f64| {
                (d <= reach as f64).then_some(if d <= flat { 2.0 } else { d as f32 })
            };
            let mut all = Naive::new();
            let r = reach as isize;
            for j in (-r..=r).filter(|j| j.unsigned_abs() % stride == 0) {
                for i in (-r..=r).filter(|i| i.unsigned_abs() % stride == 0) {
                    if let Some(v) = value(((i * i + j * j) as f64).sqrt()) {
                        all.push((i, j, v));
                    }
                }
            }
            let op = if max { Op::Max } else { Op::Min };
            let none = if max { f32::NEG_INFINITY } else { f32::INFINITY };
            let spans = Spans::of(&mask, out_width);
            let mut out = vec![none; out_width * out_height];
            let kernel = Kernel::of(reach, stride, value);
            filter(op, &image, at, out_width, &mut out, &spans, &kernel);
            for c in (0..out.len()).filter(|c| mask[*c]) {
                let place = (c % out_width, c / out_width);
                prop_assert_eq!(out[c], naive(op, &image, at, place, &all), "{:?}", place);
            }
        }
    }

    #[test]
    fn grown_spans_hold_every_cell_within_reach() {
        let mut mask = vec![false; 40 * 9];
        mask[3 + 40 * 4] = true;
        mask[39 + 40 * 8] = true;
        let grown = Spans::of(&mask, 40).grown(2, 40);
        let rows: Vec<_> = grown.rows().cloned().collect();
        assert!(rows[1].is_empty());
        assert_eq!(rows[2], vec![1usize..6; 1]);
        assert_eq!(rows[6], [1..6, 37..40]);
        assert_eq!(rows[8], vec![37usize..40; 1]);
    }
}
