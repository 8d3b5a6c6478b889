//! One layer at a time, from the top down: erode what may go, grow supports for what may not.
//!
//! A voxel of the top layer is *carried* when one of its five carriers is grounded, that is, stays
//! connected without this layer; it is *needy* otherwise. Material below that only hangs on the
//! layer is *hanging*. Needy voxels and hanging material form clusters; the carried voxels beside
//! a cluster are its anchors. As long as each cluster keeps one anchor, every other carried voxel
//! may be eroded, in any order: its carrier stays, and nothing loses its way to the base. Eroding
//! first opens the way for the cutter from above, so supports are grown after it, and so on until
//! nothing is needy and the rest of the layer goes at once.

use super::bottleneck::Bottleneck;
use super::detour::{Detour, NEAR_VISITS};
use super::forest::{Demand, Forest, carried};
use super::ledge;
use super::workpiece::{Cell, Ways, Workpiece};
use std::collections::{BTreeSet, HashSet};

/// Layers down to which trees are looked for before ledges are built. Measured: with 12, ledges
/// spread where long trees would do; without a limit, single deep trunks cost more than ledges.
const FIRST: i32 = 40;

/// Demands that a tree ending in the air must serve for each such end, on average. Fewer, and its
/// way sideways costs more than ledges would; more, and sheets of ledges follow the top down.
const FEWEST: usize = 3;

/// What a way sideways to the ground costs to begin, in cells: for each layer it begins above the
/// tool's full reach, since it wants carriers of its own as soon as the top comes down to it, and
/// for each needy voxel less than five that it serves. Lower, and sheets of support follow the top
/// down; higher, and ways run deep that could have been short.
const SHALLOW: u32 = 2;
const SERVED: u32 = 2;

/// The planner's whole state.
pub(super) struct Nullifier {
    pub w: Workpiece,
    pub b: Bottleneck,
    pub forest: Forest,
    detour: Detour,
    /// In the order of nullification: the reverse of fabrication.
    pub deeds: Vec<(Cell, Undoing)>,
    /// M of INV Sec. 5.2: fewer connected voxels are eroded only when nothing else helps.
    pub minimum_feature: usize,
    /// Cluster of a cell plus one; 0 for none.
    label: Vec<u32>,
}

/// One operation of nullification.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Undoing {
    /// Undoes an AM (Def. 3.1).
    Eroded,
    /// Undoes an SM in any of these orientations (Def. 3.2).
    Accreted(Ways),
}

/// Nothing more can be done in a layer: the theorem of INV Sec. 3.3 says this does not happen.
#[derive(Debug)]
pub(super) struct Stuck {
    pub layer: i32,
    pub left: usize,
}

#[derive(Default)]
struct Survey {
    needy: Vec<Cell>,
    /// Cells of hanging material just under the layer.
    hanging: Vec<Cell>,
}

/// Clusters of needy and hanging cells.
#[derive(Default)]
struct Clusters {
    /// All labelled cells.
    cells: Vec<Cell>,
    /// Those of hanging material.
    hanging: Vec<Cell>,
    /// Carried voxels of the layer beside each cluster.
    anchors: Vec<u32>,
}

/// How many rounds of a layer go by before trees without a limit are looked for again: twice as
/// many after each time in vain, none after a find. What would help lies deep and rarely changes.
#[derive(Default)]
struct Patience {
    left: usize,
    wait: usize,
}

impl Patience {
    fn is_over(&mut self) -> bool {
        let over = self.left == 0;
        self.left = self.left.saturating_sub(1);
        over
    }

    fn tried(&mut self, found: bool) {
        self.wait = if found { 0 } else { 2 * self.wait + 1 };
        self.left = self.wait;
    }
}

impl Nullifier {
    pub fn new(w: Workpiece, minimum_feature: usize, seed: u64) -> Nullifier {
        let b = Bottleneck::new(&w);
        let forest = Forest::new(&w, seed);
        let detour = Detour::new(&w);
        let label = vec![0; w.len()];
        Nullifier { w, b, forest, detour, deeds: Vec::new(), minimum_feature, label }
    }

    /// INV Sec. 4.2: trees for every voxel that nothing carries, as far as the cutter reaches them
    /// in the whole model.
    pub fn support_ahead(&mut self) {
        let mut demands = Vec::new();
        for z in 1..=self.w.top {
            let bare = |c: &Cell| !self.w.carriers(*c).into_iter().any(|c| self.w.solid(c));
            let bare = self.w.layer(z).into_iter().filter(bare);
            demands.extend(bare.map(|cell| Demand { cell, group: 0 }));
        }
        let grown = self.forest.grow(&mut self.w, &mut self.b, &demands, i32::MAX);
        self.record(&grown);
    }

    /// Erodes the whole of layer `top`, the highest with material.
    pub fn strip(&mut self, top: i32) -> Result<(), Stuck> {
        self.w.top = top;
        let mut rest = self.w.layer(top);
        if top == 0 {
            self.erode(&rest);
            return Ok(());
        }
        let mut hasty = false;
        // Demands that found no tree although the cutter reaches under them: asked again only when
        // nothing else helps, since what would help them lies deep and rarely changes.
        let mut vain: HashSet<Cell> = HashSet::new();
        let mut patience = Patience::default();
        loop {
            let survey = self.survey(&rest);
            if survey.needy.is_empty() && survey.hanging.is_empty() {
                self.erode(&rest);
                return Ok(());
            }
            let clusters = self.clusters(&rest, &survey);
            let spared = self.erode_safe(&mut rest, &clusters, hasty);
            let demands = self.demands(&survey, &clusters);
            let hopeful: Vec<Demand> =
                demands.iter().filter(|d| !vain.contains(&d.cell)).copied().collect();
            let mut grown = self.forest.grow(&mut self.w, &mut self.b, &hopeful, FIRST);
            let w = &self.w;
            let reached = |c: Cell| w.carriers(c).into_iter().any(|c| w.empty(c) && w.access(c));
            vain.extend(hopeful.iter().map(|d| d.cell).filter(|c| reached(*c)));
            if grown.is_empty() {
                grown = self.hang(&hopeful);
            }
            if grown.is_empty() {
                grown = ledge::build(&mut self.w, &mut self.b, &survey.needy);
            }
            if grown.is_empty() && patience.is_over() {
                grown = self.forest.grow(&mut self.w, &mut self.b, &demands, i32::MAX);
                patience.tried(!grown.is_empty());
            }
            self.record(&grown);
            if grown.is_empty() {
                if spared && !hasty {
                    self.unlabel(&clusters);
                    hasty = true;
                    continue;
                }
                let sources = self.sources(&survey.needy, &clusters.hanging, &demands);
                let way = self.detour.connect(&mut self.w, &mut self.b, &sources);
                if way.is_empty() {
                    return Err(Stuck { layer: top, left: rest.len() });
                }
                self.record(&way);
            }
            hasty = false;
            self.unlabel(&clusters);
        }
    }

    /// Erodes what of layer `top` is not to be kept, the last layer with anything to erode.
    pub fn strip_to(&mut self, top: i32, keep: impl Fn(Cell) -> bool) -> Result<(), Stuck> {
        self.w.top = top;
        let mut rest = self.w.layer(top);
        rest.retain(|c| !keep(*c));
        let w = &self.w;
        let bare = |c: &&Cell| top > 0 && !w.carriers(**c).into_iter().any(|c| w.solid(c));
        match rest.iter().filter(bare).count() {
            0 => {
                self.erode(&rest);
                Ok(())
            }
            left => Err(Stuck { layer: top, left }),
        }
    }

    fn erode(&mut self, cells: &[Cell]) {
        for &cell in cells {
            self.w.erode(cell);
            self.b.eroded(cell);
            self.deeds.push((cell, Undoing::Eroded));
        }
    }

    fn record(&mut self, added: &[(Cell, Ways)]) {
        self.deeds.extend(added.iter().map(|(c, ways)| (*c, Undoing::Accreted(*ways))));
    }

    /// Trees for demands that none can ground from here: they end in the air as deep as the cutter
    /// reaches, and ways lead from their ends sideways to the ground.
    fn hang(&mut self, demands: &[Demand]) -> Vec<(Cell, Ways)> {
        let ends = self.forest.hanging_ends(&self.w, &self.b, demands);
        if ends.len() * FEWEST > demands.len() {
            return Vec::new();
        }
        let mut grown = Vec::new();
        for end in ends {
            if self.w.empty(end) {
                grown.extend(self.detour.connect_free(
                    &mut self.w,
                    &mut self.b,
                    &[(end, 0)],
                    NEAR_VISITS,
                ));
            }
        }
        if !grown.is_empty() {
            grown.extend(self.forest.grow(&mut self.w, &mut self.b, demands, FIRST));
        }
        grown
    }

    fn survey(&self, rest: &[Cell]) -> Survey {
        let mut survey = Survey::default();
        for &cell in rest {
            let mut needy = true;
            for c in self.w.carriers(cell) {
                if self.b.grounded(c, self.w.top) {
                    needy = false;
                } else if self.w.solid(c) {
                    survey.hanging.push(c);
                }
            }
            if needy {
                survey.needy.push(cell);
            }
        }
        survey
    }

    /// Labels clusters by flooding, and counts their anchors among `rest`.
    fn clusters(&mut self, rest: &[Cell], survey: &Survey) -> Clusters {
        let mut clusters = Clusters::default();
        for &seed in survey.needy.iter().chain(&survey.hanging) {
            if self.label[seed as usize] == 0 {
                clusters.anchors.push(0);
                self.flood(seed, &mut clusters);
            }
        }
        for &cell in rest {
            if self.label[cell as usize] == 0 {
                for label in self.clusters_at(cell).into_iter().flatten() {
                    clusters.anchors[label as usize - 1] += 1;
                }
            }
        }
        clusters
    }

    fn flood(&mut self, seed: Cell, clusters: &mut Clusters) {
        let label = clusters.anchors.len() as u32;
        let top = self.w.top;
        let mut open = vec![seed];
        self.label[seed as usize] = label;
        while let Some(cell) = open.pop() {
            clusters.cells.push(cell);
            if self.w.height(cell) < top {
                clusters.hanging.push(cell);
            }
            for n in self.w.neighbours(cell) {
                if !self.w.solid(n) || self.label[n as usize] != 0 {
                    continue;
                }
                let belongs = if self.w.height(n) == top {
                    !carried(&self.w, &self.b, n)
                } else {
                    !self.b.grounded(n, top)
                };
                if belongs {
                    self.label[n as usize] = label;
                    open.push(n);
                }
            }
        }
    }

    fn unlabel(&mut self, clusters: &Clusters) {
        for &cell in &clusters.cells {
            self.label[cell as usize] = 0;
        }
    }

    /// The clusters beside a carried voxel of the layer, each once.
    fn clusters_at(&self, cell: Cell) -> [Option<u32>; 13] {
        let mut found = [None; 13];
        let mut n = 0;
        for c in self.w.beside(cell).into_iter().chain(self.w.carriers(cell)) {
            let label = self.label[c as usize];
            if label != 0 && !found[..n].contains(&Some(label)) {
                found[n] = Some(label);
                n += 1;
            }
        }
        found
    }

    /// Erodes carried voxels as long as every cluster keeps an anchor; whether patches smaller
    /// than the minimum feature were left although they could go.
    fn erode_safe(&mut self, rest: &mut Vec<Cell>, clusters: &Clusters, hasty: bool) -> bool {
        let mut anchors = clusters.anchors.clone();
        let mut free = Vec::new();
        for &cell in rest.iter() {
            if self.label[cell as usize] != 0 {
                continue;
            }
            let beside = self.clusters_at(cell);
            if beside.into_iter().flatten().all(|l| anchors[l as usize - 1] > 1) {
                for l in beside.into_iter().flatten() {
                    anchors[l as usize - 1] -= 1;
                }
                free.push(cell);
            }
        }
        let spared = if hasty { false } else { self.spare_small(&mut free) };
        self.erode(&free);
        let w = &self.w;
        rest.retain(|c| w.solid(*c));
        spared
    }

    /// Drops connected patches smaller than the minimum feature; whether there were any.
    fn spare_small(&mut self, free: &mut Vec<Cell>) -> bool {
        if self.minimum_feature <= 1 {
            return false;
        }
        const FREE: u32 = u32::MAX;
        const KEPT: u32 = u32::MAX - 1;
        for &c in free.iter() {
            self.label[c as usize] = FREE;
        }
        let mut patch = Vec::new();
        for &seed in free.iter() {
            if self.label[seed as usize] != FREE {
                continue;
            }
            patch.clear();
            patch.push(seed);
            self.label[seed as usize] = KEPT;
            let mut next = 0;
            while next < patch.len() {
                for n in self.w.beside(patch[next]) {
                    if self.label[n as usize] == FREE {
                        self.label[n as usize] = KEPT;
                        patch.push(n);
                    }
                }
                next += 1;
            }
            if patch.len() < self.minimum_feature {
                patch.iter().for_each(|c| self.label[*c as usize] = 0);
            }
        }
        let before = free.len();
        free.retain(|c| std::mem::take(&mut self.label[*c as usize]) == KEPT);
        free.len() < before
    }

    /// What carriers are to be grown for: the needy voxels, and one lowest point of each cluster
    /// with hanging material.
    fn demands(&self, survey: &Survey, clusters: &Clusters) -> Vec<Demand> {
        let needy = survey.needy.iter().map(|c| Demand { cell: *c, group: 0 });
        let tips = clusters.hanging.iter().filter(|c| {
            self.w.height(**c) > 0 && !self.w.carriers(**c).into_iter().any(|c| self.w.solid(c))
        });
        let tips = tips.map(|c| Demand { cell: *c, group: self.label[*c as usize] });
        needy.chain(tips).collect()
    }

    /// Empty cells from which a way to the ground would help, each with what it costs to begin
    /// there: carriers of the needy, cells a tree could lead to, cells beside hanging material.
    fn sources(
        &mut self,
        needy: &[Cell],
        hanging: &[Cell],
        demands: &[Demand],
    ) -> Vec<(Cell, u32)> {
        let (w, top) = (&self.w, self.w.top);
        let under = needy.iter().flat_map(|c| w.carriers(*c));
        let beside = hanging.iter().flat_map(|c| w.neighbours(*c));
        let tree = self.forest.reachable(w, &self.b, demands);
        let cells = under.chain(beside).chain(tree);
        let cells: BTreeSet<Cell> = cells.filter(|c| w.empty(*c) && w.height(*c) < top).collect();
        let served = |c: Cell| {
            let above = w.carried_by(c);
            above.iter().filter(|c| w.solid(**c) && !carried(w, &self.b, **c)).count() as u32
        };
        let cost = |c: Cell| {
            SHALLOW * (w.length.min(top) - (top - w.height(c))).max(0) as u32
                + SERVED * (5 - served(c))
        };
        cells.into_iter().map(|c| (c, cost(c))).collect()
    }
}
