//! Where no tree grows: a way of cells through all eighteen neighbours, sideways and upward too.
//!
//! A cell that no other cell of the way carries will want a carrier of its own once its layer is
//! the top one, hence costs [`UNCARRIED`] more. The search is Dijkstra's from the cells that would
//! help to the first one beside grounded material. A way is accreted from the ground up; when a
//! cell of it bars another, all of it is undone and the barred cell left out of the next search.
//!
//! The last search is confined to cells just under the top layer that lie open to the sky or at
//! the side of the domain. The cutter reaches each of them whatever else is accreted there
//! (L ≥ 2), and around what is left of the top layer they form a closed ring (INV Sec. 3.3), so
//! this search finds a way and the way holds.

use super::bottleneck::Bottleneck;
use super::forest::carried;
use super::workpiece::{Cell, Ways, Workpiece};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Cells that one without a carrier costs later. Lower, and shelves creep under ceilings; higher,
/// and ways run deep for nothing.
const UNCARRIED: u32 = 1;

/// Ways that may fail before the search is confined.
const ATTEMPTS: usize = 6;

/// Cells looked at before a search gives up and the confined one begins. Fewer, and sheets of
/// support creep along under the top layer; more, and time is lost where no way is.
pub(super) const MOST_VISITS: usize = 10_000;

/// The same for a tree that ends in the air: a longer way is not worth the tree.
pub(super) const NEAR_VISITS: usize = 3_000;

/// Scratch space for all searches of one plan.
pub(super) struct Detour {
    /// Place of a cell in `visits`, plus one; 0 for cells not looked at.
    place: Vec<u32>,
    visits: Vec<Visit>,
}

struct Visit {
    cell: Cell,
    cost: u32,
    /// Place of the cell before, toward the source; its own for a source.
    from: u32,
    usable: bool,
    done: bool,
}

impl Detour {
    pub fn new(w: &Workpiece) -> Detour {
        Detour { place: vec![0; w.len()], visits: Vec::new() }
    }

    /// Accretes one way from any of `sources`, given with the cost of each, to grounded material;
    /// what was accreted, in order.
    pub fn connect(
        &mut self,
        w: &mut Workpiece,
        b: &mut Bottleneck,
        sources: &[(Cell, u32)],
    ) -> Vec<(Cell, Ways)> {
        let added = self.connect_free(w, b, sources, MOST_VISITS);
        if !added.is_empty() {
            return added;
        }
        let usable = |w: &Workpiece, c| w.empty(c) && w.always_open(c);
        let way = self.search(w, b, sources, usize::MAX, usable).unwrap_or_default();
        let added = build(w, &way).unwrap_or_default();
        b.accreted(w, &way[..added.len()]);
        added
    }

    /// The same with no guarantee: nothing when no way is found or each one bars itself.
    pub fn connect_free(
        &mut self,
        w: &mut Workpiece,
        b: &mut Bottleneck,
        sources: &[(Cell, u32)],
        most_visits: usize,
    ) -> Vec<(Cell, Ways)> {
        let mut barred: Vec<Cell> = Vec::new();
        for _ in 0..ATTEMPTS {
            let usable = |w: &Workpiece, c| w.empty(c) && w.access(c) && !barred.contains(&c);
            let Some(way) = self.search(w, b, sources, most_visits, usable) else { break };
            match build(w, &way) {
                Ok(added) => {
                    b.accreted(w, &way);
                    return added;
                }
                Err(cell) => barred.push(cell),
            }
        }
        Vec::new()
    }

    /// The cheapest way, from the ground to the source.
    fn search(
        &mut self,
        w: &Workpiece,
        b: &Bottleneck,
        sources: &[(Cell, u32)],
        most_visits: usize,
        usable: impl Fn(&Workpiece, Cell) -> bool,
    ) -> Option<Vec<Cell>> {
        let way = self.run(w, b, sources, most_visits, usable).map(|ground| self.trace(ground));
        self.visits.drain(..).for_each(|v| self.place[v.cell as usize] = 0);
        way
    }

    /// Dijkstra's search; the visit it arrives with.
    fn run(
        &mut self,
        w: &Workpiece,
        b: &Bottleneck,
        sources: &[(Cell, u32)],
        most_visits: usize,
        usable: impl Fn(&Workpiece, Cell) -> bool,
    ) -> Option<u32> {
        let mut heap = BinaryHeap::new();
        for &(s, cost) in sources {
            let v = self.visit(w, s, &usable);
            let visit = &mut self.visits[v as usize];
            if visit.usable && cost < visit.cost {
                (visit.cost, visit.from) = (cost, v);
                heap.push(Reverse((cost, s, false)));
            }
        }
        let offsets = w.offsets();
        while let Some(Reverse((cost, cell, arrived))) = heap.pop() {
            let v = self.place[cell as usize] - 1;
            if arrived {
                return Some(v);
            }
            if self.visits.len() > most_visits {
                return None;
            }
            if std::mem::replace(&mut self.visits[v as usize].done, true) {
                continue;
            }
            let has_carrier = w.height(cell) == 0 || carried(w, b, cell);
            let near = offsets.map(|o| (cell as i32 + o) as Cell);
            if w.height(cell) == 0 || near.iter().any(|n| b.grounded(*n, w.top)) {
                heap.push(Reverse((cost + if has_carrier { 0 } else { UNCARRIED }, cell, true)));
            }
            let below = w.carriers(cell);
            for n in near {
                if w.height(n) >= w.top {
                    continue;
                }
                let step = if has_carrier || below.contains(&n) { 1 } else { 1 + UNCARRIED };
                let v_n = self.visit(w, n, &usable);
                let visit = &mut self.visits[v_n as usize];
                if visit.usable && visit.cost > cost + step {
                    (visit.cost, visit.from) = (cost + step, v);
                    heap.push(Reverse((cost + step, n, false)));
                }
            }
        }
        None
    }

    /// The visit of a cell, a new one with no cost where there was none.
    fn visit(
        &mut self,
        w: &Workpiece,
        cell: Cell,
        usable: &impl Fn(&Workpiece, Cell) -> bool,
    ) -> u32 {
        let place = &mut self.place[cell as usize];
        if *place == 0 {
            let (usable, from) = (usable(w, cell), self.visits.len() as u32);
            self.visits.push(Visit { cell, cost: u32::MAX, from, usable, done: false });
            *place = from + 1;
        }
        *place - 1
    }

    fn trace(&self, ground: u32) -> Vec<Cell> {
        let mut at = ground;
        let mut way = vec![self.visits[at as usize].cell];
        while self.visits[at as usize].from != at {
            at = self.visits[at as usize].from;
            way.push(self.visits[at as usize].cell);
        }
        way
    }
}

/// Accretes the cells in order, or undoes all and names the one that cannot be reached.
fn build(w: &mut Workpiece, way: &[Cell]) -> Result<Vec<(Cell, Ways)>, Cell> {
    let mut log = Vec::new();
    let mut added = Vec::new();
    for &cell in way {
        let ways = w.ways(cell);
        if ways.is_empty() {
            w.undo(log.into_iter());
            return Err(cell);
        }
        log.push(w.accrete(cell));
        added.push((cell, ways));
    }
    Ok(added)
}
