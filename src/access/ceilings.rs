//! How high the voxels asked about stand, so that tips which stand higher need no further look.
//!
//! A tip that may stand no lower than H serves a voxel x of its surroundings only where H + k ≤ x_z,
//! and k is nowhere negative. Once the wide sections of a tool hold a tip higher than every voxel
//! near it, the narrow ones can only raise it further: whatever its height, it is refused.
//!
//! Guarantees: a tip that is left out serves no voxel asked about. Heights are kept by squares of
//! cells, so some tips that serve none are looked at all the same.

use super::filter::Spans;
use super::tiles::{Extreme, Largest, running_extreme};

/// Cells along each axis of the squares. Larger ones leave out fewer tips, smaller ones take longer
/// to look up.
const TILE: usize = 8;

/// Heights in mm that no voxel near a square's cells exceeds; by squares of a window's cells.
pub struct Ceilings {
    /// Squares along u.
    width: usize,
    heights: Vec<f32>,
}

impl Ceilings {
    /// Of no voxel, for a window of so many cells along u and v.
    pub fn none(nu: usize, nv: usize) -> Ceilings {
        let (width, height) = (nu.div_ceil(TILE), nv.div_ceil(TILE));
        Ceilings { width, heights: vec![f32::NEG_INFINITY; width * height] }
    }

    /// Takes in a voxel over cell (i, j) at a height, mm.
    #[inline(always)]
    pub fn raise(&mut self, i: usize, j: usize, height: f32) {
        let tile = &mut self.heights[i / TILE + self.width * (j / TILE)];
        *tile = Largest::of(height, *tile);
    }

    /// For cells up to `reach` away from the voxels', along either axis, `margin` mm higher.
    pub fn around(&self, reach: usize, margin: f32) -> Ceilings {
        let by = reach.div_ceil(TILE);
        let width = self.width + 2 * by;
        let mut wide = vec![f32::NEG_INFINITY; width * by];
        for row in self.heights.chunks(self.width.max(1)) {
            wide.resize(wide.len() + by, f32::NEG_INFINITY);
            wide.extend(row.iter().map(|h| h + margin));
            wide.resize(wide.len() + by, f32::NEG_INFINITY);
        }
        wide.resize(wide.len() + width * by, f32::NEG_INFINITY);
        let room = &mut Vec::new();
        // What runs on from a row's end into the next only raises the ceiling there.
        running_extreme::<Largest>(&mut wide, room, 1, 2 * by + 1);
        running_extreme::<Largest>(&mut wide, room, width, 2 * by + 1);
        let rows = wide.chunks(width.max(1)).take(self.heights.len() / self.width.max(1));
        let heights = rows.flat_map(|row| row[..self.width].iter().copied()).collect();
        Ceilings { width: self.width, heights }
    }

    /// The cells of `tips` that stand no higher than the ceiling over them, with some of those
    /// beside; `lowest` are rows of `nu` cells.
    pub fn below(&self, tips: &Spans, lowest: &[f32], nu: usize) -> Spans {
        let row = |(j, spans): (usize, &Vec<std::ops::Range<usize>>)| {
            let ceilings = &self.heights[self.width * (j / TILE)..][..self.width];
            let row = &lowest[nu * j..][..nu];
            let mut open = Vec::new();
            for span in spans {
                let mut from = span.start;
                while from < span.end {
                    let end = ((from / TILE + 1) * TILE).min(span.end);
                    let ceiling = ceilings[from / TILE];
                    if row[from..end].iter().any(|h| *h <= ceiling) {
                        open.push(from..end);
                    }
                    from = end;
                }
            }
            open
        };
        Spans::of_rows(tips.rows().enumerate().map(row))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn no_tip_that_serves_a_voxel_is_left_out(
            n in (1usize..60, 1usize..60),
            reach in 0usize..20,
            voxels in prop::collection::vec((0usize..60, 0usize..60, -5.0f32..5.0), 0..6),
            heights in prop::collection::vec(-5.0f32..5.0, 64),
        ) {
            let (nu, nv) = n;
            let voxels: Vec<_> = voxels.into_iter().map(|(i, j, h)| (i % nu, j % nv, h)).collect();
            let mut ceilings = Ceilings::none(nu, nv);
            voxels.iter().for_each(|(i, j, h)| ceilings.raise(*i, *j, *h));
            let near = ceilings.around(reach, 0.01);
            let lowest: Vec<f32> = (0..nu * nv).map(|c| heights[(c * 7) % 64]).collect();
            let open = near.below(&Spans::all(nu, nv), &lowest, nu);
            for (j, spans) in open.rows().enumerate() {
                for i in 0..nu {
                    let serves = voxels.iter().any(|(x, y, h)| {
                        x.abs_diff(i) <= reach && y.abs_diff(j) <= reach && lowest[i + nu * j] <= *h
                    });
                    prop_assert!(!serves || spans.iter().any(|s| s.contains(&i)), "{i} {j}");
                }
            }
        }
    }
}
