//! Cutting down in levels, one pocket to its ground before the next.
//!
//! Method: of each level the connected parts of what is still to cut there are pockets, each cut contour parallel; what
//! lies under one is cut before its neighbours, so that the tool seldom leaves a pocket. Guarantee: none is cut deeper under what
//! is still to cut beside it than the edge is long, so that neither shank nor holder meets that. Not guaranteed: the
//! shortest way between pockets; the next is the one nearest to the tip.

use super::super::contour::{chains_over, parts};
use super::super::image::{Cell, Lattice};
use super::{LEAST_STEP_SHARE, SAME_HEIGHT_MM, Stage};
use crate::base::Cancelled;

/// Connected cells, with no others beside them, over which there is still something to cut from a level down.
struct Pocket {
    cells: Vec<usize>,
    /// Levels from the first, which is 1.
    level: usize,
}

/// The pocket with the cell nearest to `here`, or the first, taken out of some.
fn nearest_pocket(lattice: &Lattice, some: &mut Vec<Pocket>, here: Option<Cell>) -> Option<Pocket> {
    /// Looks at the cells of a pocket.
    const LOOKS: usize = 16;
    let away = |p: &Pocket| {
        let looks = p.cells.iter().step_by(p.cells.len() / LOOKS + 1);
        let cells = looks.map(|k| lattice.cell_of_index(*k));
        cells
            .map(|c| here.map_or(0, |h| c[0].abs_diff(h[0]).pow(2) + c[1].abs_diff(h[1]).pow(2)))
            .min()
    };
    let nearest = (0..some.len()).min_by_key(|i| (away(&some[*i]), *i))?;
    Some(some.remove(nearest))
}

impl Stage<'_> {
    /// Cuts down to `bottom` in levels, where that is below `ceiling`: one pocket to its ground before the next, so that
    /// the tool seldom leaves one, or as deep as the edge is long before any goes deeper. Levels above what was already
    /// cut `near` a cell are passed over: only air is left there.
    pub(super) fn levels(
        &mut self,
        bottom: &[f32],
        ceiling: &[f32],
        near: &[f32],
    ) -> Result<(), Cancelled> {
        let same = SAME_HEIGHT_MM as f32;
        let due: Vec<usize> = (0..bottom.len())
            .filter(|i| bottom[*i] < ceiling[*i].min(self.done[*i]) - same)
            .collect();
        let open = |i: usize| ceiling[i].min(near[i]).max(bottom[i]);
        let start = due.iter().map(|i| open(*i)).fold(f32::NEG_INFINITY, f32::max);
        let start = start.min(self.safe as f32) + same;
        let least = LEAST_STEP_SHARE * self.lattice.s;
        let step = self.process.step_down.max(least) as f32;
        let stepover = self.process.stepover / self.lattice.s;
        let (lattice, feed) = (self.lattice, self.process.feed);
        // What is still to cut beside a pocket must not meet shank or holder: none goes deeper under it than the edge is long.
        let at_once = ((self.work.tool.active_length() / f64::from(step)) as usize).max(1);
        let first = parts(&lattice, &due).into_iter().map(|cells| Pocket { cells, level: 1 });
        // The pockets that are still to be cut, those under one together, of the deepest last; and those of the next depth.
        let (mut open, mut later): (Vec<Vec<Pocket>>, Vec<Pocket>) =
            (vec![first.collect()], Vec::new());
        while let Some(beside) = open.last_mut() {
            self.work.ctx.check()?;
            let here = self.at.map(|(c, _)| c);
            let Some(Pocket { cells, level: k }) = nearest_pocket(&lattice, beside, here) else {
                open.pop();
                if open.is_empty() && !later.is_empty() {
                    open.push(std::mem::take(&mut later));
                }
                continue;
            };
            let level = start - k as f32 * step;
            let last = if k == 1 { start + same } else { start - (k - 1) as f32 * step };
            let z = |i: usize| bottom[i].max(level);
            let is_due = |i: &usize| {
                let fresh = z(*i) < ceiling[*i].min(last) - same;
                fresh && (bottom[*i] >= level || level < near[*i])
            };
            let set: Vec<usize> = cells.iter().copied().filter(is_due).collect();
            self.follow(chains_over(&lattice, &set, stepover), stepover, &z, feed)?;
            for i in set {
                self.done[i] = self.done[i].min(z(i));
            }
            let deeper: Vec<usize> =
                cells.into_iter().filter(|i| bottom[*i] < level - same).collect();
            let under = parts(&lattice, &deeper).into_iter();
            let under = under.map(|cells| Pocket { cells, level: k + 1 });
            if k.is_multiple_of(at_once) {
                later.extend(under);
            } else {
                open.push(under.collect());
            }
        }
        self.retract();
        Ok(())
    }
}
