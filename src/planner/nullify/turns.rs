//! In which order and orientation the accretions of one turn come, so that the cutter turns seldom.
//!
//! Between two erosions the order of accretions is free as long as the cutter reaches each cell
//! and each hangs on something. Orientation by orientation all that can be taken is taken, the
//! orientation that serves most first. A cell may overtake earlier ones when
//!
//! - none of them is its neighbour: so what it hung on is there before it, as it was;
//! - each of them keeps an orientation that served it in the given order and that the cell is not
//!   in the way of.
//!
//! So the first one left can always be taken, and the end is the same state.
//!
//! Guarantees: the same cells, valid whenever the given order is. Not guaranteed: fewest turns.

use super::layer::Undoing;
use super::workpiece::{Cell, Undo, Ways, Workpiece};

/// Skipped cells that are looked at one by one; of more, those in the cell's lines are.
const FEW: usize = 256;

/// Scratch space for all turns of one plan.
pub(super) struct Turns {
    /// Place in the phase of a cell that is still to come, plus one; 0 for all others.
    place: Vec<u32>,
}

/// One turn of the cutter: what it takes, what that leaves the others, and how to take it back.
struct Run {
    taken: Vec<usize>,
    left: Vec<Ways>,
    log: Vec<Undo>,
}

impl Turns {
    pub fn new(w: &Workpiece) -> Turns {
        Turns { place: vec![0; w.len()] }
    }

    /// Accretes the cells of `phase`, each given with the orientations that serve in that order.
    pub fn grouped(&mut self, w: &mut Workpiece, phase: &[(Cell, Ways)]) -> Vec<(Cell, Undoing)> {
        for (i, (cell, _)) in phase.iter().enumerate() {
            self.place[*cell as usize] = i as u32 + 1;
        }
        let mut left: Vec<Ways> = phase.iter().map(|(_, ways)| *ways).collect();
        let mut pending: Vec<usize> = (0..phase.len()).collect();
        let mut done = Vec::with_capacity(phase.len());
        while let Some(&first) = pending.first() {
            let mut best = (0, w.ways(phase[first].0));
            for way in (0..5).map(Ways::only) {
                let run = self.run(w, phase, &pending, &left, way);
                if run.taken.len() > best.0 {
                    best = (run.taken.len(), way);
                }
                run.taken.iter().for_each(|i| self.place[phase[*i].0 as usize] = *i as u32 + 1);
                w.undo(run.log.into_iter());
            }
            let run = self.run(w, phase, &pending, &left, best.1);
            debug_assert!(!run.taken.is_empty(), "the first can always be taken");
            if run.taken.is_empty() {
                return phase
                    .iter()
                    .map(|(cell, ways)| (*cell, Undoing::Accreted(*ways)))
                    .collect();
            }
            done.extend(run.taken.iter().map(|i| (phase[*i].0, Undoing::Accreted(best.1))));
            left = run.left;
            pending.retain(|i| self.place[phase[*i].0 as usize] != 0);
        }
        done
    }

    /// Takes in the given order all that one orientation serves.
    fn run(
        &mut self,
        w: &mut Workpiece,
        phase: &[(Cell, Ways)],
        pending: &[usize],
        left: &[Ways],
        way: Ways,
    ) -> Run {
        let mut run = Run { taken: Vec::new(), left: left.to_vec(), log: Vec::new() };
        let mut skipped = Vec::new();
        for &i in pending {
            let cell = phase[i].0;
            let serves = !w.ways(cell).and(way).is_empty();
            if serves && self.may_overtake(w, phase, cell, &skipped, &mut run.left) {
                run.log.push(w.accrete(cell));
                self.place[cell as usize] = 0;
                run.taken.push(i);
            } else {
                skipped.push(i);
            }
        }
        run
    }

    /// Whether the cell may come before all that was skipped; what that leaves them goes into
    /// `left`.
    fn may_overtake(
        &self,
        w: &Workpiece,
        phase: &[(Cell, Ways)],
        cell: Cell,
        skipped: &[usize],
        left: &mut [Ways],
    ) -> bool {
        let Some(&last) = skipped.last() else { return true };
        let earlier = |c: Cell| {
            let place = self.place[c as usize] as usize;
            (1..=last + 1).contains(&place).then(|| place - 1)
        };
        if w.widens(cell) || w.neighbours(cell).into_iter().any(|n| earlier(n).is_some()) {
            return false;
        }
        let mut barred: Vec<(usize, Ways)> = Vec::new();
        if skipped.len() <= FEW {
            let met = skipped.iter().filter_map(|i| Some((*i, w.bars(cell, phase[*i].0)?)));
            barred.extend(met);
        } else {
            for (step, way) in w.lines() {
                let mut at = cell as i32 + step;
                while !w.outside(at as Cell) {
                    barred.extend(earlier(at as Cell).map(|other| (other, Ways::only(way))));
                    at += step;
                }
            }
        }
        if barred.iter().any(|(other, way)| left[*other].without(*way).is_empty()) {
            return false;
        }
        barred.into_iter().for_each(|(other, way)| left[other] = left[other].without(way));
        true
    }
}
