//! Deposits with deposits and cuts with cuts: fewer changes of process, where the order is free.
//!
//! An accretion may come earlier than it did, as long as the cutter reaches its cell: with more of
//! the part still there, its neighbour is there too and nothing is loose. So erosions wait: from
//! the finished model backward, accretions are taken in their order while the cutter reaches them,
//! then erosions in theirs while all that was accreted before them is there, and so on in turn.
//! For these two orders no other merging has fewer turns, since each turn goes as far as any could.
//!
//! Within a turn the accretions are sorted by orientation ([`super::turns`]).
//!
//! Guarantees: the same operations, valid whenever the given order is.

use super::layer::Undoing;
use super::turns::Turns;
use super::workpiece::{Cell, Workpiece};

/// `deeds` of nullification, done in as few turns of erosion and accretion as their two orders
/// allow. `w` is the state before them all, and after them on return.
pub(super) fn gathered(w: &mut Workpiece, deeds: &[(Cell, Undoing)]) -> Vec<(Cell, Undoing)> {
    let mut accretions = Vec::new();
    // With how many accretions came before.
    let mut erosions = Vec::new();
    for (cell, undoing) in deeds {
        match undoing {
            Undoing::Accreted(_) => accretions.push(*cell),
            Undoing::Eroded => erosions.push((*cell, accretions.len())),
        }
    }
    let mut gathered = Vec::with_capacity(deeds.len());
    let (mut accreted, mut eroded) = (0, 0);
    let mut turns = Turns::new(w);
    loop {
        let before = gathered.len();
        let (mut phase, mut log) = (Vec::new(), Vec::new());
        while let Some(&cell) = accretions.get(accreted) {
            let ways = w.ways(cell);
            if ways.is_empty() {
                break;
            }
            log.push(w.accrete(cell));
            phase.push((cell, ways));
            accreted += 1;
        }
        w.undo(log.into_iter());
        gathered.extend(turns.grouped(w, &phase));
        while let Some(&(cell, needed)) = erosions.get(eroded) {
            if needed > accreted {
                break;
            }
            w.erode(cell);
            w.top = w.highest();
            gathered.push((cell, Undoing::Eroded));
            eroded += 1;
        }
        if gathered.len() == before {
            // Nothing is left; the given order shows that no turn gets stuck.
            return gathered;
        }
    }
}
