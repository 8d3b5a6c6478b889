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

/// How much more than the cheapest a way may cost to be taken in the same search, and how far it
/// lies from those at least, in cells. A search costs what it begins from, and a broad underside
/// takes ways by the hundred.
const SLACK: u32 = 2;
const APART: i32 = 16;

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

    /// Accretes ways from some of `sources`, given with the cost of each, to grounded material: the
    /// cheapest, and those that cost hardly more and lie apart; what was accreted, in order.
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
        let ways = self.search(w, b, sources, usize::MAX, usable);
        build_all(w, b, &ways).unwrap_or_default()
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
            let ways = self.search(w, b, sources, most_visits, usable);
            if ways.is_empty() {
                break;
            }
            match build_all(w, b, &ways) {
                Ok(added) => return added,
                Err(cell) => barred.push(cell),
            }
        }
        Vec::new()
    }

    /// The ways to take, each from the ground to its source, the cheapest first.
    fn search(
        &mut self,
        w: &Workpiece,
        b: &Bottleneck,
        sources: &[(Cell, u32)],
        most_visits: usize,
        usable: impl Fn(&Workpiece, Cell) -> bool,
    ) -> Vec<Vec<Cell>> {
        let ways = self.run(w, b, sources, most_visits, usable);
        self.visits.drain(..).for_each(|v| self.place[v.cell as usize] = 0);
        ways
    }

    /// Dijkstra's search.
    fn run(
        &mut self,
        w: &Workpiece,
        b: &Bottleneck,
        sources: &[(Cell, u32)],
        most_visits: usize,
        usable: impl Fn(&Workpiece, Cell) -> bool,
    ) -> Vec<Vec<Cell>> {
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
        let mut found = Found::default();
        let mut most_cost = u32::MAX;
        while let Some(Reverse((cost, cell, arrived))) = heap.pop() {
            if cost > most_cost {
                break;
            }
            let v = self.place[cell as usize] - 1;
            if arrived {
                most_cost = most_cost.min(cost + SLACK);
                found.take(w, self.trace(v));
                if sources.len() == 1 {
                    break;
                }
                continue;
            }
            if self.visits.len() > most_visits {
                break;
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
        found.ways
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

/// Ways that lie apart.
#[derive(Default)]
struct Found {
    ways: Vec<Vec<Cell>>,
    /// Their boxes, widened.
    boxes: Vec<[(i32, i32); 3]>,
}

impl Found {
    fn take(&mut self, w: &Workpiece, way: Vec<Cell>) {
        let mut span = [(i32::MAX, i32::MIN); 3];
        for cell in &way {
            for (span, at) in span.iter_mut().zip(w.voxel(*cell)) {
                *span = (span.0.min(at), span.1.max(at));
            }
        }
        let meets =
            |b: &[(i32, i32); 3]| b.iter().zip(&span).all(|(b, s)| b.0 <= s.1 && s.0 <= b.1);
        if !self.boxes.iter().any(meets) {
            self.boxes.push(span.map(|(low, high)| (low - APART, high + APART)));
            self.ways.push(way);
        }
    }
}

/// Accretes those of the ways that bar nothing of themselves or of the ones before; the first cell
/// that cannot be reached when that is none.
fn build_all(
    w: &mut Workpiece,
    b: &mut Bottleneck,
    ways: &[Vec<Cell>],
) -> Result<Vec<(Cell, Ways)>, Cell> {
    let mut added = Vec::new();
    let mut barred = None;
    for way in ways {
        match build(w, way) {
            Ok(new) => {
                b.accreted(w, way);
                added.extend(new);
            }
            Err(cell) => barred = barred.or(Some(cell)),
        }
    }
    match barred {
        Some(cell) if added.is_empty() => Err(cell),
        _ => Ok(added),
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
