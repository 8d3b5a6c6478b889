//! A solid in boxes of boxes, for exact questions that few of its voxels have a say in.
//!
//! Method: grids coarser by [`FACTOR`] and again, a voxel of each solid where any in it is; a walk
//! passes over whole boxes that a bound rules out. Inner voxels are there too: off the grid axes a fine tool may pass
//! between those at the surface and meet one below.
//!
//! Guarantees: every voxel none of whose boxes the bound rules out is visited, once and in a fixed order; of others none.

use crate::base::DVec3;
use crate::voxel::{BitGrid, Frame, coarsened};
use std::ops::ControlFlow;

/// Boxes along the side of the next larger one: 8 takes larger steps past what is of no concern, 2 more of them.
const FACTOR: usize = 4;

/// Sizes of boxes; the largest are 64 voxels wide, a few on a side of the usual grids.
const LEVELS: usize = 3;

/// The voxels of a solid, and boxes of them.
pub struct Boxes<'a> {
    frame: &'a Frame,
    solid: &'a BitGrid,
    /// From boxes of [`FACTOR`] voxels a side to the largest.
    coarser: Vec<(Frame, BitGrid)>,
}

impl<'a> Boxes<'a> {
    pub fn new(frame: &'a Frame, solid: &'a BitGrid) -> Self {
        let mut coarser: Vec<(Frame, BitGrid)> = Vec::new();
        for _ in 0..LEVELS {
            let (frame, finer) = coarser.last().map_or((frame, solid), |(f, g)| (f, g));
            coarser.push((frame.coarsened(FACTOR), coarsened(finer, FACTOR, 1)));
        }
        Boxes { frame, solid, coarser }
    }

    /// Visits the voxels in boxes that `may` matter, until one says to stop; whether one did. A box is told by
    /// its centre and how far from that the centres of its voxels may lie, mm.
    pub fn visit(
        &self,
        may: &impl Fn(DVec3, f64) -> bool,
        each: &mut impl FnMut([usize; 3]) -> ControlFlow<()>,
    ) -> ControlFlow<()> {
        let Some((_, largest)) = self.coarser.last() else { return ControlFlow::Continue(()) };
        largest.iter_ones().try_for_each(|b| self.enter(self.coarser.len(), b, may, each))
    }

    /// One box of a level, a voxel of level 0.
    fn enter(
        &self,
        level: usize,
        at: [usize; 3],
        may: &impl Fn(DVec3, f64) -> bool,
        each: &mut impl FnMut([usize; 3]) -> ControlFlow<()>,
    ) -> ControlFlow<()> {
        let Some(below) = level.checked_sub(1) else { return each(at) };
        let (frame, _) = &self.coarser[below];
        // From its centre to that of a voxel in its corner.
        let radius = (frame.pitch - self.frame.pitch) * 0.75f64.sqrt();
        if !may(frame.center(at), radius) {
            return ControlFlow::Continue(());
        }
        let grid = if below == 0 { self.solid } else { &self.coarser[below - 1].1 };
        let from = at.map(|c| c * FACTOR);
        let to: [usize; 3] = std::array::from_fn(|a| (from[a] + FACTOR).min(grid.dims()[a]));
        for z in from[2]..to[2] {
            for y in from[1]..to[1] {
                for x in (from[0]..to[0]).filter(|x| grid.get([*x, y, z])) {
                    self.enter(below, [x, y, z], may, each)?;
                }
            }
        }
        ControlFlow::Continue(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_ball_holds_is_visited_once_and_no_far_box_is_entered() {
        let frame = Frame { pitch: 0.5, dims: [83, 41, 70], origin: DVec3::new(3.0, -2.0, 0.5) };
        let solid = BitGrid::from_fn(frame.dims, |[x, y, z]| (x * 7 + y * 5 + z * 3) % 11 < 4);
        let boxes = Boxes::new(&frame, &solid);
        for (centre, reach) in [([40, 20, 30], 6.0), ([2, 1, 69], 9.0), ([200, 1, 1], 5.0)] {
            let c = frame.center(centre);
            let looked = std::cell::Cell::new(0);
            let may = |at: DVec3, radius: f64| {
                looked.set(looked.get() + 1);
                at.distance(c) - radius <= reach
            };
            let mut seen = Vec::new();
            let whole = boxes.visit(&may, &mut |v| {
                if frame.center(v).distance(c) <= reach {
                    seen.push(v);
                }
                ControlFlow::Continue(())
            });
            assert!(whole.is_continue());
            seen.sort_by_key(|v| [v[2], v[1], v[0]]);
            let inside = |v: &[usize; 3]| frame.center(*v).distance(c) <= reach;
            assert_eq!(seen, solid.iter_ones().filter(inside).collect::<Vec<_>>());
            assert!(looked.get() < 1500, "{}", looked.get());
        }
        let mut seen = 0;
        let stopped = boxes.visit(&|_, _| true, &mut |_| {
            seen += 1;
            if seen == 5 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        });
        assert!(stopped.is_break());
        assert_eq!(seen, 5);
    }
}
