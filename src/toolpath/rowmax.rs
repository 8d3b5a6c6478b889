//! Maxima over runs of cells in the rows of an image, two looks each.

use super::image::Image;
use rayon::prelude::*;

/// The greater of two heights, neither of which is a NaN: `f32::max` looks for that every time.
fn higher(a: f32, b: f32) -> f32 {
    if b > a { b } else { a }
}

/// Sparse table of one row: level k holds maxima over 2ᵏ cells to the right. None where the row is
/// empty.
pub(super) struct RowMax(Vec<Vec<f32>>);

pub(super) fn row_tables(img: &Image, widest: usize) -> Vec<RowMax> {
    let nx = img.lattice.n[0].max(1);
    let build = |row: &[f32]| {
        if row.iter().all(|z| *z == f32::NEG_INFINITY) {
            return RowMax(Vec::new());
        }
        let mut levels = vec![row.to_vec()];
        let mut span = 1;
        while 2 * span <= widest && 2 * span <= nx {
            let last = &levels[levels.len() - 1];
            let pairs = last.iter().zip(&last[span..]);
            levels.push(pairs.map(|(a, b)| higher(*a, *b)).collect());
            span *= 2;
        }
        RowMax(levels)
    };
    img.data.par_chunks(nx).map(build).collect()
}

impl RowMax {
    /// row[i] = max(row[i], max of the table's cells from i + first on, `width` of them, less z).
    pub fn lift(&self, row: &mut [f32], first: i64, width: usize, z: f32) {
        let Some(cells) = self.0.first() else { return };
        let (n, len) = (cells.len() as i64, row.len() as i64);
        // Where the whole chord lies in the row, two lookups a cell do.
        let from = (-first).clamp(0, len);
        let to = (n - width as i64 + 1 - first).clamp(from, len);
        let k = width.ilog2() as usize;
        let Some(level) = self.0.get(k).filter(|_| to > from) else {
            return self.lift_cut(row, first, width, z);
        };
        let left = (from + first) as usize;
        let right = left + width - (1 << k);
        let inner = &mut row[from as usize..to as usize];
        if left == right {
            for (r, a) in inner.iter_mut().zip(&level[left..]) {
                *r = higher(*r, a - z);
            }
        } else {
            for (r, (a, b)) in inner.iter_mut().zip(level[left..].iter().zip(&level[right..])) {
                *r = higher(*r, higher(*a, *b) - z);
            }
        }
        self.lift_cut(&mut row[..from as usize], first, width, z);
        self.lift_cut(&mut row[to as usize..], first + to, width, z);
    }

    /// The same cell by cell, for chords that the row's ends cut.
    fn lift_cut(&self, row: &mut [f32], first: i64, width: usize, z: f32) {
        let n = self.0[0].len() as i64;
        for (i, r) in row.iter_mut().enumerate() {
            let c = i as i64 + first;
            let (a, b) = (c.max(0), (c + width as i64 - 1).min(n - 1));
            if a > b {
                continue;
            }
            let k = ((b - a + 1).ilog2() as usize).min(self.0.len() - 1);
            let level = &self.0[k];
            let span = 1usize << k;
            let (mut at, last) = (a as usize, b as usize + 1 - span);
            let mut m = level[at].max(level[last]);
            while at + span < last {
                at += span;
                m = m.max(level[at]);
            }
            *r = r.max(m - z);
        }
    }
}
