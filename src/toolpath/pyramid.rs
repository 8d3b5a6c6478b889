//! Dilation of a height image by rings, for tools so wide that ring by ring takes minutes.
//!
//! Method: branch and bound over a pyramid of maxima. What a block of obstacles can raise a tile of tips to is
//! bounded by its highest cell less the ring's height at the least distance between the two; blocks are opened the
//! highest bound first, and what bounds a tile no higher than its lowest tip stands at already is not opened.
//!
//! Guarantee: to the last bit what lifting by every ring gives, for rings that rise outward. Lengths are in cells.

use super::image::{Image, Lattice};
use std::collections::BinaryHeap;
use std::ops::Range;

/// Cells along a side of a tile of tips and of the smallest block of obstacles.
pub(super) const TILE: usize = 8;

/// Heights of rings by their outer radius, which is a whole number of cells but for the last's.
pub(super) struct Rings {
    /// By the distance from the axis, rounded up.
    heights: Vec<f32>,
    /// Square of the outermost radius.
    rim2: f64,
}

impl Rings {
    /// None where a ring lies lower than the one within it, or has not a whole number for its radius.
    pub fn of(discs: &[(f64, f32)]) -> Option<Rings> {
        let (last, inner) = discs.split_last()?;
        let rise = discs.windows(2).all(|d| d[0].0 < d[1].0 && d[0].1 <= d[1].1);
        if !rise || inner.iter().any(|d| d.0.fract() != 0.0) {
            return None;
        }
        let mut heights = Vec::new();
        for (radius, z) in discs {
            heights.resize(radius.ceil() as usize + 1, *z);
        }
        Some(Rings { heights, rim2: last.0 * last.0 })
    }

    /// The height at the square of a distance; +∞ outside.
    fn height(&self, square: usize) -> f32 {
        let square = square as f64;
        if square > self.rim2 { f32::INFINITY } else { self.heights[square.sqrt().ceil() as usize] }
    }
}

/// Maxima of an image over blocks of [`TILE`] cells a side, then over four blocks each, up to one.
pub(super) struct Pyramid<'a> {
    image: &'a Image,
    levels: Vec<Maxima>,
}

/// The highest cell of every block.
pub(super) struct Maxima {
    n: [usize; 2],
    most: Vec<f32>,
}

/// A block with what it raises a tile to at most.
struct Open {
    bound: f32,
    level: usize,
    at: [usize; 2],
}

impl PartialEq for Open {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Open {}

impl PartialOrd for Open {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Open {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.bound.total_cmp(&other.bound)
    }
}

/// Cells `from`..`to` in the image's own numbering, which may lie outside it.
type Span = [(i64, i64); 2];

/// Square of the least distance between cells of two boxes.
fn apart(a: &Span, b: &Span) -> usize {
    let gap = |a: (i64, i64), b: (i64, i64)| (b.0 - a.1 + 1).max(a.0 - b.1 + 1).max(0) as usize;
    let [x, y] = [gap(a[0], b[0]), gap(a[1], b[1])];
    x * x + y * y
}

impl<'a> Pyramid<'a> {
    pub fn of(image: &'a Image) -> Pyramid<'a> {
        let mut levels = vec![Maxima::of(image)];
        while let Some(last) = levels.last().filter(|l| l.most.len() > 1) {
            let next = Maxima::over(last.n, 2, |[i, j]| last.most[i + last.n[0] * j]);
            levels.push(next);
        }
        Pyramid { image, levels }
    }

    /// Raises the rows `rows` of tips over `over`, of which the first is row `first`, by the rings under them.
    /// `shift` is the place of cell (0, 0) of `over` in the image.
    pub fn raise(
        &self,
        rings: &Rings,
        rows: &mut [f32],
        first: usize,
        over: &Lattice,
        shift: [i64; 2],
    ) {
        let nx = over.n[0].max(1);
        let height = rows.len() / nx;
        for x in (0..nx).step_by(TILE) {
            let from = [x as i64 + shift[0], first as i64 + shift[1]];
            let size = [TILE.min(nx - x), height];
            let span = [0, 1].map(|a| (from[a], from[a] + size[a] as i64));
            self.raise_tile(rings, &span, &mut |raise| {
                let mut least = f32::INFINITY;
                for j in 0..size[1] {
                    for (i, tip) in rows[j * nx + x..][..size[0]].iter_mut().enumerate() {
                        raise([from[0] + i as i64, from[1] + j as i64], tip);
                        least = least.min(*tip);
                    }
                }
                least
            });
        }
    }

    /// Raises a tile; `each` hands every tip of it with its place to a function, and gives the lowest then.
    fn raise_tile(
        &self,
        rings: &Rings,
        tile: &Span,
        each: &mut impl FnMut(&mut dyn FnMut([i64; 2], &mut f32)) -> f32,
    ) {
        let mut least = each(&mut |_, _| {});
        let mut open = BinaryHeap::new();
        let push = |open: &mut BinaryHeap<Open>, level: usize, at: [usize; 2], least: f32| {
            let most = self.levels[level].most[at[0] + self.levels[level].n[0] * at[1]];
            let bound = most - rings.height(apart(tile, &self.span(level, at)));
            if bound > least {
                open.push(Open { bound, level, at });
            }
        };
        push(&mut open, self.levels.len() - 1, [0; 2], least);
        while let Some(Open { bound, level, at }) = open.pop() {
            if bound <= least {
                return;
            }
            if level > 0 {
                let below = self.levels[level - 1].n;
                for child in [[0, 0], [1, 0], [0, 1], [1, 1]] {
                    let child = [2 * at[0] + child[0], 2 * at[1] + child[1]];
                    if child[0] < below[0] && child[1] < below[1] {
                        push(&mut open, level - 1, child, least);
                    }
                }
                continue;
            }
            let [us, vs] = self.span(0, at);
            for v in vs.0..vs.1 {
                for u in us.0..us.1 {
                    let z = self.image.data[u as usize + self.image.lattice.n[0] * v as usize];
                    if z - rings.height(apart(tile, &[(u, u + 1), (v, v + 1)])) <= least {
                        continue;
                    }
                    least = each(&mut |[x, y], tip| {
                        let square = (x - u) * (x - u) + (y - v) * (y - v);
                        *tip = tip.max(z - rings.height(square as usize));
                    });
                }
            }
        }
    }

    /// The cells of a block.
    fn span(&self, level: usize, at: [usize; 2]) -> Span {
        let side = TILE << level;
        let n = self.image.lattice.n;
        [0, 1].map(|a| ((at[a] * side) as i64, ((at[a] + 1) * side).min(n[a]) as i64))
    }
}

impl Maxima {
    /// Over blocks of [`TILE`] cells a side.
    pub fn of(image: &Image) -> Maxima {
        Maxima::over(image.lattice.n, TILE, |c| image.data[image.lattice.index(c)])
    }

    /// The blocks of an image that hold any height, as far as they lie within some columns and rows: the columns
    /// and rows in each, and its highest cell, mm.
    pub fn each(
        &self,
        us: Range<usize>,
        vs: Range<usize>,
    ) -> impl Iterator<Item = (Range<usize>, Range<usize>, f64)> {
        let part =
            |of: &Range<usize>, k: usize| (k * TILE).max(of.start)..((k + 1) * TILE).min(of.end);
        let blocks = |of: &Range<usize>| of.start / TILE..of.end.div_ceil(TILE);
        let [across, along] = [&us, &vs].map(blocks);
        let all = along.flat_map(move |j| across.clone().map(move |i| [i, j]));
        all.map(move |[i, j]| (part(&us, i), part(&vs, j), f64::from(self.most[i + self.n[0] * j])))
            .filter(|(.., most)| *most > f64::NEG_INFINITY)
    }

    /// Maxima of `n` cells over blocks of `side` of them.
    fn over(n: [usize; 2], side: usize, cell: impl Fn([usize; 2]) -> f32) -> Maxima {
        let m = n.map(|n| n.div_ceil(side).max(1));
        let mut most = vec![f32::NEG_INFINITY; m[0] * m[1]];
        for j in 0..n[1] {
            for i in 0..n[0] {
                let block = &mut most[i / side + m[0] * (j / side)];
                *block = block.max(cell([i, j]));
            }
        }
        Maxima { n: m, most }
    }
}
