//! Support trees: from voxels that need a carrier down to material that stands, five ways a layer.
//!
//! Below the demands the cells that the cutter can reach are explored layer by layer; each learns
//! the least number of cells that lead from it to a landing, a cell over grounded material or on
//! the base. Then carriers are chosen from the top down: of the cells that carry open ends the one
//! that saves most cells against single trunks comes first, so that branches merge where they
//! cover many ends. Every cell but a landing stands on a cell of its own tree, so no later layer
//! asks for a carrier under a tree.

use super::bottleneck::Bottleneck;
use super::workpiece::{Cell, Ways, Workpiece};
use std::collections::BinaryHeap;

/// Layers to which trees are looked for, the next depth only for what the one before left.
/// Shallow first saves exploring cones down to the base under demands that land close by.
const DEPTHS: [i32; 3] = [12, 60, i32::MAX];

/// Ends of one layer that are drawn to each other; the cost is quadratic in them. Below, trunks
/// that could merge stay apart; above, crowded layers take long while coverage merges them anyway.
const DRAWN_ENDS: usize = 160;

/// Price of a support cell that carries nothing else, and how much less it is for each voxel of a
/// lower layer that it carries and nothing else does. Measured: half a cell a voxel gives fewest
/// supports; at nothing, trees pass by what will want support next, at more they wander to it.
const CELL: u32 = 12;
const BARE: u32 = 6;

/// Price of an end in the air, and of each layer it hangs above the tool's full reach. An end costs
/// a way of several cells; cheaper, and trunks do not merge before they end.
const HANGING: u32 = 60;
const SHALLOW: u32 = 50;

/// Layers down to which ends in the air are looked for: beyond, the cutter seldom reaches.
const REACH: i32 = 16;

const UNREACHED: u32 = u32::MAX;

/// Scratch space for all forests of one plan.
pub(super) struct Forest {
    /// Place of a cell in `nodes`, plus one; 0 for cells not explored.
    place: Vec<u32>,
    nodes: Vec<Node>,
    pub seed: u64,
}

struct Node {
    cell: Cell,
    /// Cells to add from here to the ground, this one included.
    cost: u32,
    /// The node that carries this one once chosen; itself for a landing.
    carrier: u32,
    /// On the base or over grounded material.
    lands: bool,
    /// Ends in the air.
    hangs: bool,
    /// Carries a demand itself.
    tip: bool,
    useful: bool,
}

/// A voxel that needs a carrier.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Demand {
    pub cell: Cell,
    /// Of the demands with one group above 0 only the cheapest is served.
    pub group: u32,
}

/// The explored nodes by layer.
struct Levels {
    /// The layer of the first of `starts`.
    top: i32,
    /// Where each layer begins in the nodes, from the highest down, and where the last one ends.
    starts: Vec<usize>,
    /// Whether the depth limit ended the search anywhere.
    cut: bool,
}

/// What choosing a node is worth, compared field by field.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Gain {
    /// Cells saved against a trunk of its own for each end.
    saved: i64,
    covered: u32,
    /// Minus the distance to the nearest end it could merge with further down.
    away: i32,
    tie: u64,
}

/// Whether grounded material carries the cell (Def. 2.5).
pub(super) fn carried(w: &Workpiece, b: &Bottleneck, cell: Cell) -> bool {
    w.carriers(cell).into_iter().any(|c| b.grounded(c, w.top))
}

/// What a support cell costs: less when it also carries voxels of lower layers that nothing
/// carries yet.
fn price(w: &Workpiece, cell: Cell) -> u32 {
    if w.height(cell) + 1 >= w.top {
        return CELL;
    }
    let bare = |c: &Cell| w.solid(*c) && !w.carriers(*c).into_iter().any(|c| w.solid(c));
    let served = w.carried_by(cell).iter().filter(|c| bare(c)).count() as u32;
    CELL.saturating_sub(served * BARE).max(1)
}

/// The order of equals: of the cells for seed 0, else shuffled by the seed.
fn scrambled(cell: u64, seed: u64) -> u64 {
    if seed == 0 {
        return u64::MAX - cell;
    }
    let mut h = (cell ^ seed.rotate_left(32)).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    h ^= h >> 29;
    h = h.wrapping_mul(0xBF58_476D_1CE4_E5B9);
    h ^ (h >> 32)
}

impl Forest {
    pub fn new(w: &Workpiece, seed: u64) -> Forest {
        Forest { place: vec![0; w.len()], nodes: Vec::new(), seed }
    }

    /// Grows trees for the demands that can be met; what was accreted, in order.
    pub fn grow(
        &mut self,
        w: &mut Workpiece,
        b: &mut Bottleneck,
        demands: &[Demand],
        deepest: i32,
    ) -> Vec<(Cell, Ways)> {
        let mut open = demands.to_vec();
        let mut grown = Vec::new();
        for depth in DEPTHS.map(|d| d.min(deepest)) {
            let levels = self.explore(w, b, &open, depth);
            self.measure(w, &levels);
            let chosen = self.choose(w, &open, &levels);
            let added = self.plant(w, &chosen);
            self.clear();
            let cells: Vec<Cell> = added.iter().map(|(c, _)| *c).collect();
            b.accreted(w, &cells);
            grown.extend(added);
            let met: Vec<u32> = open
                .iter()
                .filter(|d| d.group > 0 && carried(w, b, d.cell))
                .map(|d| d.group)
                .collect();
            open.retain(|d| !carried(w, b, d.cell) && !met.contains(&d.group));
            if open.is_empty() || !levels.cut || depth == deepest {
                break;
            }
        }
        grown
    }

    /// The empty cells to which a tree under the demands could lead.
    pub fn reachable(&mut self, w: &Workpiece, b: &Bottleneck, demands: &[Demand]) -> Vec<Cell> {
        self.explore(w, b, demands, REACH);
        let cells = self.nodes.iter().map(|n| n.cell).collect();
        self.clear();
        cells
    }

    /// Where trees for demands that no tree can ground would best end in the air: merged as far as
    /// the cutter reaches, each end worth a way sideways to the ground.
    pub fn hanging_ends(&mut self, w: &Workpiece, b: &Bottleneck, demands: &[Demand]) -> Vec<Cell> {
        let levels = self.explore(w, b, demands, REACH);
        for i in (0..self.nodes.len()).rev() {
            if self.nodes[i].cost == UNREACHED {
                let cell = self.nodes[i].cell;
                let best = self.rest(w, cell);
                self.nodes[i].hangs = best == UNREACHED;
                let depth = (w.top - w.height(cell)).min(w.length);
                let end = HANGING + SHALLOW * (w.length - depth) as u32;
                self.nodes[i].cost = price(w, cell) + if best == UNREACHED { end } else { best };
            }
        }
        let chosen = self.choose(w, demands, &levels);
        let hanging = chosen.iter().map(|n| &self.nodes[*n as usize]).filter(|n| n.hangs);
        let ends = hanging.map(|n| n.cell).collect();
        self.clear();
        ends
    }

    /// Cells under the demands that the cutter reaches, by layer from the highest down.
    fn explore(&mut self, w: &Workpiece, b: &Bottleneck, demands: &[Demand], depth: i32) -> Levels {
        let mut by_height: Vec<(i32, Cell)> =
            demands.iter().map(|d| (w.height(d.cell), d.cell)).collect();
        by_height.sort_unstable_by(|p, q| q.cmp(p));
        let mut levels = Levels { top: -1, starts: Vec::new(), cut: false };
        let Some(&(highest, _)) = by_height.first() else { return levels };
        levels.top = highest - 1;
        let mut next = 0;
        let mut from = 0;
        let mut z = highest - 1;
        while z >= 0 {
            levels.starts.push(self.nodes.len());
            let until = self.nodes.len();
            while next < by_height.len() && by_height[next].0 == z + 1 {
                for c in w.carriers(by_height[next].1) {
                    self.reach(w, b, c);
                }
                next += 1;
            }
            let deepest = highest.saturating_sub(depth);
            let closed = z < deepest;
            for i in from..until {
                if self.nodes[i].cost != UNREACHED {
                    continue;
                }
                if closed {
                    levels.cut = true;
                } else {
                    for c in w.carriers(self.nodes[i].cell) {
                        self.reach(w, b, c);
                    }
                }
            }
            from = until;
            if next == by_height.len() && (self.nodes.len() == until || closed) {
                break;
            }
            z -= 1;
        }
        levels.starts.push(self.nodes.len());
        levels
    }

    fn reach(&mut self, w: &Workpiece, b: &Bottleneck, cell: Cell) {
        if self.place[cell as usize] != 0 || !w.empty(cell) || !w.access(cell) {
            return;
        }
        let lands = w.height(cell) == 0 || carried(w, b, cell);
        let carrier = self.nodes.len() as u32;
        let cost = if lands { price(w, cell) } else { UNREACHED };
        self.nodes.push(Node {
            cell,
            cost,
            lands,
            hangs: false,
            carrier,
            tip: false,
            useful: false,
        });
        self.place[cell as usize] = carrier + 1;
    }

    fn node(&self, cell: Cell) -> Option<usize> {
        (self.place[cell as usize] as usize).checked_sub(1)
    }

    /// Costs from the deepest layer up.
    fn measure(&mut self, w: &Workpiece, levels: &Levels) {
        for i in (0..*levels.starts.last().unwrap_or(&0)).rev() {
            if self.nodes[i].cost == UNREACHED {
                let best = self.rest(w, self.nodes[i].cell);
                if best != UNREACHED {
                    self.nodes[i].cost = best + price(w, self.nodes[i].cell);
                }
            }
        }
    }

    /// Cells to add under `cell` so that it is carried; [`UNREACHED`] when none will do.
    fn rest(&self, w: &Workpiece, cell: Cell) -> u32 {
        let costs = w.carriers(cell).into_iter().filter_map(|c| self.node(c));
        costs.map(|n| self.nodes[n].cost).min().unwrap_or(UNREACHED)
    }

    /// Chooses carriers from the top down; the chosen nodes, the highest first.
    fn choose(&mut self, w: &Workpiece, demands: &[Demand], levels: &Levels) -> Vec<u32> {
        let mut by_height: Vec<(i32, Cell)> =
            self.cheapest(w, demands).into_iter().map(|c| (w.height(c), c)).collect();
        by_height.sort_unstable_by(|p, q| q.cmp(p));
        let mut next = 0;
        let mut chosen: Vec<u32> = Vec::new();
        let mut fresh = 0;
        for level in 0..levels.starts.len().saturating_sub(1) {
            let z = levels.top - level as i32;
            let mut ends: Vec<Cell> = Vec::new();
            for n in &chosen[fresh..] {
                let node = &self.nodes[*n as usize];
                // A landing is its own carrier.
                if !node.lands && !node.hangs {
                    ends.push(node.cell);
                }
            }
            while next < by_height.len() && by_height[next].0 == z + 1 {
                ends.push(by_height[next].1);
                next += 1;
            }
            fresh = chosen.len();
            ends.sort_unstable();
            ends.dedup();
            self.cover(w, &ends, &mut chosen);
        }
        chosen
    }

    /// The demands that can be met, one for each group.
    fn cheapest(&self, w: &Workpiece, demands: &[Demand]) -> Vec<Cell> {
        let mut met: Vec<(u32, u32, Cell)> = demands
            .iter()
            .map(|d| (d.group, self.rest(w, d.cell), d.cell))
            .filter(|(_, rest, _)| *rest != UNREACHED)
            .collect();
        met.sort_unstable();
        let mut last = 0;
        met.retain(|(group, _, _)| *group == 0 || std::mem::replace(&mut last, *group) != *group);
        met.into_iter().map(|(_, _, cell)| cell).collect()
    }

    /// Carriers for the ends of one layer, by greatest saving first.
    fn cover(&mut self, w: &Workpiece, ends: &[Cell], chosen: &mut Vec<u32>) {
        let rests: Vec<u32> = ends.iter().map(|e| self.rest(w, *e)).collect();
        let mut open = vec![true; ends.len()];
        let mut candidates: Vec<u32> = ends
            .iter()
            .flat_map(|e| w.carriers(*e))
            .filter_map(|c| self.node(c))
            .filter(|n| self.nodes[*n].cost != UNREACHED)
            .map(|n| n as u32)
            .collect();
        candidates.sort_unstable();
        candidates.dedup();
        let mut heap: BinaryHeap<(Gain, u32)> =
            candidates.into_iter().map(|n| (self.gain(w, n, ends, &rests, &open), n)).collect();
        while let Some((gain, n)) = heap.pop() {
            let now = self.gain(w, n, ends, &rests, &open);
            if now.covered == 0 {
                continue;
            }
            if now < gain {
                heap.push((now, n));
                continue;
            }
            chosen.push(n);
            for e in w.carried_by(self.nodes[n as usize].cell) {
                if let Ok(i) = ends.binary_search(&e)
                    && open[i]
                {
                    open[i] = false;
                    match self.node(e) {
                        Some(upper) => self.nodes[upper].carrier = n,
                        None => self.nodes[n as usize].tip = true,
                    }
                }
            }
        }
    }

    fn gain(&self, w: &Workpiece, n: u32, ends: &[Cell], rests: &[u32], open: &[bool]) -> Gain {
        let node = &self.nodes[n as usize];
        let mut gain = Gain { saved: -i64::from(node.cost), covered: 0, away: 0, tie: 0 };
        let mine = w.carried_by(node.cell);
        for e in mine {
            if let Ok(i) = ends.binary_search(&e)
                && open[i]
            {
                gain.saved += i64::from(rests[i]);
                gain.covered += 1;
            }
        }
        if !node.lands && ends.len() <= DRAWN_ENDS {
            let [x, y, _] = w.voxel(node.cell);
            let away = ends.iter().filter(|e| !mine.contains(e)).map(|e| {
                let [ex, ey, _] = w.voxel(*e);
                (ex - x).abs() + (ey - y).abs()
            });
            // Ends further apart than their trunks are long never meet.
            gain.away = -away.min().unwrap_or(0).min(2 * (node.cost / CELL) as i32);
        }
        gain.tie = scrambled(u64::from(node.cell), self.seed);
        gain
    }

    /// Accretes the chosen cells from the bottom up, without those whose tree cannot be finished.
    fn plant(&mut self, w: &mut Workpiece, chosen: &[u32]) -> Vec<(Cell, Ways)> {
        let mut order: Vec<(i32, i32, u32)> = Vec::with_capacity(chosen.len());
        for &n in chosen {
            let cell = self.nodes[n as usize].cell;
            // The innermost first: what lies outside would bar the way to it.
            order.push((w.height(cell), -w.depth(cell), n));
        }
        order.sort_unstable();
        let mut wanted: Vec<u32> = order.into_iter().map(|(_, _, n)| n).collect();
        loop {
            let mut log = Vec::new();
            let mut added = Vec::new();
            for &n in &wanted {
                let node = &self.nodes[n as usize];
                let carrier = &self.nodes[node.carrier as usize];
                let stands = node.carrier == n || w.solid(carrier.cell);
                let ways = w.ways(node.cell);
                if stands && !ways.is_empty() {
                    log.push(w.accrete(node.cell));
                    added.push((node.cell, ways));
                }
            }
            if added.len() == wanted.len() {
                return added;
            }
            // Fewer cells stand in each other's way less, so this ends.
            self.mark_useful(w, chosen);
            w.undo(log.into_iter());
            wanted.retain(|n| self.nodes[*n as usize].useful);
        }
    }

    /// Marks the planted nodes on the way from a demand to the ground. `chosen` holds every node
    /// after those it carries.
    fn mark_useful(&mut self, w: &Workpiece, chosen: &[u32]) {
        for &n in chosen {
            let tip = self.nodes[n as usize].tip;
            self.nodes[n as usize].useful = tip;
        }
        for &n in chosen {
            let node = &mut self.nodes[n as usize];
            node.useful &= w.solid(node.cell);
            if node.useful {
                let carrier = node.carrier;
                self.nodes[carrier as usize].useful = true;
            }
        }
    }

    fn clear(&mut self) {
        for node in self.nodes.drain(..) {
            self.place[node.cell as usize] = 0;
        }
    }
}
