//! Least and largest values of squares of an image's cells.
//!
//! Extremes of f32 are exact: every order of evaluation gives the same bytes.

use super::cells::Cells;

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

/// Extremes of square tiles of cells.
pub struct Tiles {
    /// Tiles along u and v.
    pub n: [usize; 2],
    pub least: Cells,
    pub largest: Cells,
}

impl Tiles {
    /// Of tiles of TILE cells along each axis; the cells are given by their own extremes.
    #[inline(always)]
    pub fn of<const TILE: usize>(least: &[f32], largest: &[f32], [nu, nv]: [usize; 2]) -> Tiles {
        let (width, n) = (nu.max(1), [nu.div_ceil(TILE), nv.div_ceil(TILE)]);
        let mut across = [vec![0.0; n[0] * TILE], vec![0.0; n[0] * TILE]];
        let [mut low, mut high] = [Cells::with_room(n[0] * n[1]), Cells::with_room(n[0] * n[1])];
        for (least, largest) in least.chunks(width * TILE).zip(largest.chunks(width * TILE)) {
            let [lows, highs] = &mut across;
            lows.fill(Least::NONE);
            highs.fill(Largest::NONE);
            for (least, largest) in least.chunks(width).zip(largest.chunks(width)) {
                lows.iter_mut().zip(least).for_each(|(a, c)| *a = Least::of(*a, *c));
                highs.iter_mut().zip(largest).for_each(|(a, c)| *a = Largest::of(*a, *c));
            }
            let least = |t: &[f32]| t.iter().fold(Least::NONE, |a, c| Least::of(a, *c));
            let largest = |t: &[f32]| t.iter().fold(Largest::NONE, |a, c| Largest::of(a, *c));
            low.extend(lows.chunks_exact(TILE).map(least));
            high.extend(highs.chunks_exact(TILE).map(largest));
        }
        Tiles { n, least: low, largest: high }
    }

    /// Of each the extremes of those from it on, `spans` of them along either axis, with a margin.
    #[inline(always)]
    pub fn widened(mut self, spans: [usize; 2], margin: f32) -> Vec<(f32, f32)> {
        let room = &mut Cells::with_room(self.least.len());
        // What runs on from a row's end into the next only widens the range there.
        for (stride, span) in [(1, spans[0]), (self.n[0], spans[1])] {
            running_extreme::<Least>(&mut self.least, room, stride, span);
            running_extreme::<Largest>(&mut self.largest, room, stride, span);
        }
        let range = self.least.iter().zip(self.largest.iter());
        range.map(|(least, most)| (least - margin, most + margin)).collect()
    }
}
