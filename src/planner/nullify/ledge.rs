//! Ledges: cells just under the top layer that hang sideways on grounded material.
//!
//! Where no tree reaches the ground, one cell beside what stands often carries several needy
//! voxels at once. It will want a carrier itself when its layer is the top one, so a ledge comes
//! after trees; and only the ledges that serve most are built before the layer is eroded further,
//! because erosion opens places that serve more.

use super::bottleneck::Bottleneck;
use super::forest::carried;
use super::workpiece::{Cell, Ways, Workpiece};
use std::collections::BinaryHeap;

/// Builds the ledges that carry the greatest number of `needy` voxels any ledge can carry; what
/// was accreted, in order.
pub(super) fn build(w: &mut Workpiece, b: &mut Bottleneck, needy: &[Cell]) -> Vec<(Cell, Ways)> {
    let mut heap: BinaryHeap<(usize, usize, Cell)> = BinaryHeap::new();
    let mut candidates: Vec<Cell> = needy.iter().flat_map(|c| w.carriers(*c)).collect();
    candidates.sort_unstable();
    candidates.dedup();
    for c in candidates {
        let gain = served(w, b, c);
        if gain > 0 && hangs(w, b, c) {
            heap.push((gain, shared(w, c), c));
        }
    }
    let Some(&(most, _, _)) = heap.peek() else { return Vec::new() };
    let mut added = Vec::new();
    while let Some((gain, tie, cell)) = heap.pop() {
        if gain < most {
            break;
        }
        let now = served(w, b, cell);
        if now < gain {
            heap.push((now, tie, cell));
            continue;
        }
        let ways = w.ways(cell);
        if !w.empty(cell) || ways.is_empty() {
            continue;
        }
        w.accrete(cell);
        b.accreted(w, &[cell]);
        added.push((cell, ways));
        for n in w.beside(cell) {
            let gain = served(w, b, n);
            if gain >= most && hangs(w, b, n) {
                heap.push((gain, shared(w, n), n));
            }
        }
    }
    added
}

/// Voxels of the top layer that nothing carries and `cell` would.
fn served(w: &Workpiece, b: &Bottleneck, cell: Cell) -> usize {
    w.carried_by(cell).into_iter().filter(|c| w.solid(*c) && !carried(w, b, *c)).count()
}

/// Voxels of the same layer that nothing carries, near enough to share a carrier with `cell`.
fn shared(w: &Workpiece, cell: Cell) -> usize {
    let bare = |c: Cell| w.solid(c) && !w.carriers(c).into_iter().any(|c| w.solid(c));
    let near = w.carriers(cell).into_iter().flat_map(|c| w.carried_by(c));
    near.filter(|c| *c != cell && bare(*c)).count()
}

/// Whether the cell can be accreted beside grounded material.
fn hangs(w: &Workpiece, b: &Bottleneck, cell: Cell) -> bool {
    w.empty(cell) && w.neighbours(cell).into_iter().any(|n| b.grounded(n, w.top)) && w.access(cell)
}
