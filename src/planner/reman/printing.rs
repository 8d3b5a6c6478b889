//! Additive blocks (W2V Sec. 6): V_A in blocks along few directions.
//!
//! Method. From a state, everything that a way (direction, holding, nozzle) can lay is found in one
//! sweep from below: a voxel is laid when something carries it within the overhang angle and the
//! nozzle stands at it clear of the state. What the block itself has laid lies lower along the
//! direction and is never in the nozzle's way. The way that lays most comes first; which one
//! that is, is judged on the coarse grid, and the block itself is laid on the job's own.
//!
//! Such blocks may close in on material that could have been laid before them. What is left at the
//! end is therefore put earlier: with only the voxels that carry it, between two layers of one of
//! the blocks, and all that follows is laid again. This is kept as long as less is left.
//!
//! Guarantees: each block's voxels are carried, clear and connected when they are laid. Not
//! guaranteed: that every voxel finds its turn; what no block reaches is returned.

use super::coarse::Coarse;
use super::setting::Setting;
use crate::access::{CarrierTable, Scene, nozzle_map, reachable, supported};
use crate::base::{Cancelled, Ctx, DVec3, Direction};
use crate::machine::Tool;
use crate::plan::{Job, Origin, Plane, Step, StepKind};
use crate::voxel::BitGrid;
use rayon::prelude::*;

/// The additive steps, the state they leave, and what of V_A they could not add.
#[derive(Clone)]
pub struct Printing {
    pub steps: Vec<Step>,
    pub state: BitGrid,
    pub unreached: BitGrid,
}

/// What is to be printed.
pub struct Wanted<'w> {
    /// What stands before anything is printed.
    pub state: &'w BitGrid,
    pub added: &'w BitGrid,
    /// The part of `added` beyond skin, the only one that asks for blocks.
    pub core: &'w BitGrid,
    /// Directions tried before the sampled ones.
    pub preferred: &'w [Direction],
    /// Sampled directions per hemisphere.
    pub samples: usize,
}

/// A way to print: direction, holding and nozzle.
#[derive(Clone, Copy)]
struct Way<'a> {
    direction: Direction,
    holding: usize,
    tool: &'a Tool,
}

/// A preferred direction (plane or facet normal, up) is taken without a look at the samples when
/// it prints this share of what is left.
const ENOUGH_SHARE: f64 = 0.9;

/// A shorter nozzle is taken when it prints this share of what the longest prints.
const SHORTER_TOOL_SHARE: f64 = 0.97;

/// A block prints at least this share of the core: less is left to a plane or to the residual,
/// since a change of direction for a crumb helps nobody.
const LEAST_SHARE: f64 = 5e-4;

/// Insertions at most, the orders tried for each, and the ways and the heights of every block among
/// which their place is sought.
const MOST_REPAIRS: usize = 10;
const REPAIR_TRIES: usize = 3;
const REPAIR_WAYS: usize = 10;
const REPAIR_HEIGHTS: usize = 10;

/// Ways laid closely for what is left at the end, those that are clear at most of it.
const FINISHING_WAYS: usize = 6;

/// Prints what is wanted: blocks are chosen and put in order on the coarse grid, laid on the job's
/// own, and what is then left is looked for there.
pub fn print_blocks(
    setting: &Setting,
    coarse: &Coarse,
    wanted: &Wanted,
    ctx: &Ctx,
) -> Result<Printing, Cancelled> {
    // Shorter nozzles reach less: they are asked once the direction is known.
    let Some((longest, shorter)) = setting.job.nozzles.split_last() else {
        return Ok(Printing::start(wanted.state, wanted.added));
    };
    let mut ways = ways_along(setting, wanted.preferred, longest);
    let first = ways.len();
    let sampled: Vec<Direction> =
        (0..setting.holdings.len()).flat_map(|h| setting.sampled(h, wanted.samples)).collect();
    ways.extend(ways_along(setting, &sampled, longest));

    let fine = Level::new(setting, wanted.state, wanted.added, wanted.core);
    let coarse_setting = Setting::new(&coarse.job);
    let state = coarse.most(wanted.state);
    let added = coarse.most(&wanted.state.or(wanted.added)).minus(&state);
    let core = coarse.most(wanted.core);
    let quick = Level::new(&coarse_setting, &state, &added, &core);
    let mut orders: Vec<Order> = Vec::new();
    let mut rough = Printing::start(&state, &added);
    quick.fill(&mut rough, &mut orders, &ways, first, ctx)?;
    let orders = quick.repair(rough, orders, &ways, first, ctx)?;

    let dims = setting.job.frame.dims;
    let orders: Vec<Order> = orders
        .into_iter()
        .map(|o| Order { only: o.only.map(|g| coarse.refined(&g.grown(), dims)), ..o })
        .collect();
    let mut printing = fine.replay(&orders, shorter, ctx)?;
    tracing::debug!(blocks = printing.steps.len(), left = fine.left(&printing), "laid");
    fine.finish(&mut printing, &ways, shorter, ctx)?;
    Ok(printing)
}

/// A block to be laid.
#[derive(Clone)]
struct Order<'a> {
    way: Way<'a>,
    /// Greatest height along the direction, mm.
    upto: f64,
    /// What is meant, where that is not all that the way lays.
    only: Option<BitGrid>,
}

/// What is to be printed, on one grid.
struct Level<'s, 'a> {
    setting: &'s Setting<'a>,
    state: &'s BitGrid,
    added: &'s BitGrid,
    core: &'s BitGrid,
    /// Fewest core voxels of a block.
    least: usize,
}

impl<'s, 'a> Level<'s, 'a> {
    fn new(
        setting: &'s Setting<'a>,
        state: &'s BitGrid,
        added: &'s BitGrid,
        core: &'s BitGrid,
    ) -> Self {
        let least = ((LEAST_SHARE * core.count() as f64) as usize).max(1);
        Level { setting, state, added, core, least }
    }

    /// Core voxels still to be printed.
    fn left(&self, printing: &Printing) -> usize {
        printing.unreached.count_and(self.core)
    }

    fn fixed(&self, state: &BitGrid) -> Vec<Vec<DVec3>> {
        (0..self.setting.holdings.len()).map(|h| self.setting.fixed(h, state)).collect()
    }

    fn layer<'l>(
        &'l self,
        printing: &'l Printing,
        left: &'l BitGrid,
        fixed: &'l [Vec<DVec3>],
    ) -> Layer<'l> {
        Layer { job: self.setting.job, state: &printing.state, left, core: self.core, fixed }
    }

    /// Takes blocks, the largest first, until none lays enough. The first ways are preferred.
    fn fill<'w>(
        &self,
        printing: &mut Printing,
        orders: &mut Vec<Order<'w>>,
        ways: &[Way<'w>],
        first: usize,
        ctx: &Ctx,
    ) -> Result<(), Cancelled> {
        while self.left(printing) >= self.least {
            let fixed = self.fixed(&printing.state);
            let layer = self.layer(printing, &printing.unreached, &fixed);
            let enough = ENOUGH_SHARE * self.left(printing) as f64;
            let mut best = layer.best(&ways[..first], ctx)?;
            if best.as_ref().is_none_or(|b| (b.gain as f64) < enough) {
                best = layer.best(ways, ctx)?;
            }
            let Some(block) = best.filter(|b| b.gain >= self.least) else { break };
            orders.push(Order { way: block.way, upto: f64::INFINITY, only: None });
            printing.take(self.setting.job, block);
        }
        Ok(())
    }

    /// Looks at every way for what is left on the job's own grid.
    fn finish(
        &self,
        printing: &mut Printing,
        ways: &[Way<'a>],
        shorter: &'a [Tool],
        ctx: &Ctx,
    ) -> Result<(), Cancelled> {
        while self.left(printing) > 0 {
            let fixed = self.fixed(&printing.state);
            let core_left = printing.unreached.and(self.core);
            let layer = self.layer(printing, &printing.unreached, &fixed);
            // A way that is clear at none of the core cannot gain any.
            let scenes: Vec<Scene> = fixed
                .iter()
                .map(|f| Scene::new(&self.setting.job.frame, &printing.state, f))
                .collect();
            let clear: Vec<usize> = ways
                .par_iter()
                .map(|w| {
                    ctx.check()?;
                    Ok(layer.clear(*w, &scenes[w.holding], &core_left).count())
                })
                .collect::<Result<_, Cancelled>>()?;
            let mut order: Vec<usize> = (0..ways.len()).filter(|i| clear[*i] > 0).collect();
            order.sort_by_key(|&i| (std::cmp::Reverse(clear[i]), i));
            let some: Vec<Way> = order.iter().take(FINISHING_WAYS).map(|i| ways[*i]).collect();
            let Some(block) = layer.best(&some, ctx)?.filter(|b| b.gain >= self.least) else {
                break;
            };
            let block = layer.with_shorter(block, f64::INFINITY, shorter);
            printing.take(self.setting.job, block);
        }
        Ok(())
    }

    /// Lays blocks in an order; a block that lays nothing of the core falls away.
    fn replay(
        &self,
        orders: &[Order<'a>],
        shorter: &'a [Tool],
        ctx: &Ctx,
    ) -> Result<Printing, Cancelled> {
        let mut printing = Printing::start(self.state, self.added);
        for i in 0..orders.len() {
            ctx.check()?;
            self.lay_order(&mut printing, orders, i, shorter);
        }
        Ok(printing)
    }

    fn lay_order<'w>(
        &self,
        printing: &mut Printing,
        orders: &[Order<'w>],
        i: usize,
        shorter: &'w [Tool],
    ) {
        let order = &orders[i];
        let fixed = self.fixed(&printing.state);
        let left = match &order.only {
            Some(only) => printing.unreached.and(only),
            None => printing.unreached.clone(),
        };
        let layer = self.layer(printing, &left, &fixed);
        let block = layer.lay(order.way, order.upto);
        if block.gain > 0 {
            let block = layer.with_shorter(block, order.upto, shorter);
            printing.take(self.setting.job, block);
        }
    }

    /// Puts what is left between the layers of an earlier block, as long as that leaves less.
    fn repair<'w>(
        &self,
        mut best: Printing,
        mut orders: Vec<Order<'w>>,
        ways: &[Way<'w>],
        first: usize,
        ctx: &Ctx,
    ) -> Result<Vec<Order<'w>>, Cancelled> {
        for _ in 0..MOST_REPAIRS {
            let left = self.left(&best);
            if left < self.least {
                break;
            }
            let missing = best.unreached.and(self.core);
            let mut better = false;
            for mut tried in self.inserted(&orders, &missing, ways, ctx)? {
                let mut printing = Printing::start(self.state, self.added);
                for i in 0..tried.len() {
                    ctx.check()?;
                    self.lay_order(&mut printing, &tried, i, &[]);
                }
                self.fill(&mut printing, &mut tried, ways, first, ctx)?;
                tracing::debug!(
                    before = left,
                    after = self.left(&printing),
                    blocks = tried.len(),
                    "repair"
                );
                if self.left(&printing) < left {
                    (best, orders, better) = (printing, tried, true);
                    break;
                }
            }
            if !better {
                break;
            }
        }
        Ok(orders)
    }

    /// Orders in which most of `missing` is laid, with only what carries it, between two layers of
    /// one of the blocks; the most promising first.
    fn inserted<'w>(
        &self,
        orders: &[Order<'w>],
        missing: &BitGrid,
        ways: &[Way<'w>],
        ctx: &Ctx,
    ) -> Result<Vec<Vec<Order<'w>>>, Cancelled> {
        let job = self.setting.job;
        let end = self.state.or(self.added);
        // The ways that are open to most of what is missing while nothing is printed.
        let start = Printing::start(self.state, self.added);
        let open = |state: &BitGrid, ways: &[Way<'w>]| -> Result<Vec<usize>, Cancelled> {
            let fixed = self.fixed(state);
            let scenes: Vec<Scene> =
                fixed.iter().map(|f| Scene::new(&job.frame, state, f)).collect();
            let layer = self.layer(&start, missing, &fixed);
            ways.par_iter()
                .map(|w| {
                    ctx.check()?;
                    let clear = layer.clear(*w, &scenes[w.holding], missing);
                    let table = CarrierTable::new(w.direction, job.rules.overhang_deg);
                    Ok(supported(&table, &end, &clear).count())
                })
                .collect()
        };
        let at_start = open(self.state, ways)?;
        let mut best: Vec<usize> = (0..ways.len()).filter(|i| at_start[*i] > 0).collect();
        best.sort_by_key(|&i| (std::cmp::Reverse(at_start[i]), i));
        let ways: Vec<Way> = best.into_iter().take(REPAIR_WAYS).map(|i| ways[i]).collect();

        // (open, block, height, way), the latest of equals first.
        let mut places: Vec<(usize, usize, f64, usize)> = Vec::new();
        let mut printing = Printing::start(self.state, self.added);
        for (j, order) in orders.iter().enumerate() {
            let before = printing.state.clone();
            self.lay_order(&mut printing, orders, j, &[]);
            let laid = printing.state.minus(&before);
            let height = |v: [usize; 3]| order.way.direction.dot(job.frame.center(v));
            let heights = laid.iter_ones().map(height);
            let (lo, hi) = heights
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), z| (lo.min(z), hi.max(z)));
            for k in 0..REPAIR_HEIGHTS {
                let upto =
                    lo + (hi - lo) * k as f64 / REPAIR_HEIGHTS as f64 - job.frame.pitch / 4.0;
                let mut state = before.clone();
                laid.iter_ones().filter(|v| height(*v) <= upto).for_each(|v| state.set(v, true));
                for (w, n) in open(&state, &ways)?.into_iter().enumerate() {
                    places.push((n, j, upto, w));
                }
            }
        }
        places.sort_by(|a, b| {
            b.0.cmp(&a.0).then(b.1.cmp(&a.1)).then(b.2.total_cmp(&a.2)).then(a.3.cmp(&b.3))
        });
        let mut tries = Vec::new();
        for (n, j, upto, w) in places.into_iter().take(REPAIR_TRIES) {
            if n == 0 {
                break;
            }
            let mut tried = orders[..j].to_vec();
            tried.push(Order { upto: upto.min(orders[j].upto), ..orders[j].clone() });
            let mut printing = Printing::start(self.state, self.added);
            for i in 0..tried.len() {
                self.lay_order(&mut printing, &tried, i, &[]);
            }
            let fixed = self.fixed(&printing.state);
            let block =
                self.layer(&printing, &printing.unreached, &fixed).lay(ways[w], f64::INFINITY);
            let reached = block.region.and(missing);
            if reached.is_empty() {
                continue;
            }
            let only = carriers(job, &block, &printing.state, &reached);
            tried.push(Order { way: ways[w], upto: f64::INFINITY, only: Some(only) });
            tried.extend_from_slice(&orders[j..]);
            tries.push(tried);
        }
        Ok(tries)
    }
}

/// `reached` with one chain of carriers each, down to the state.
fn carriers(job: &Job, block: &Block, state: &BitGrid, reached: &BitGrid) -> BitGrid {
    let table = CarrierTable::new(block.way.direction, job.rules.overhang_deg);
    let height = |v: [usize; 3]| block.way.direction.dot(job.frame.center(v));
    let mut voxels: Vec<([usize; 3], f64)> =
        block.region.iter_ones().map(|v| (v, height(v))).collect();
    voxels.sort_by(|a, b| b.1.total_cmp(&a.1));
    let solid = state.or(&block.region);
    let mut needed = reached.clone();
    for (v, _) in voxels {
        if needed.get(v) {
            for c in table.steepest(&solid, v) {
                if block.region.get(c) {
                    needed.set(c, true);
                }
            }
        }
    }
    needed
}

impl Printing {
    fn start(state: &BitGrid, added: &BitGrid) -> Printing {
        Printing { steps: Vec::new(), state: state.clone(), unreached: added.clone() }
    }

    fn take(&mut self, job: &Job, block: Block) {
        let Way { direction, holding, tool } = block.way;
        let heights = block.region.iter_ones().map(|v| direction.dot(job.frame.center(v)));
        let lowest = heights.fold(f64::INFINITY, f64::min);
        self.state.union_with(&block.region);
        self.unreached.subtract(&block.region);
        self.steps.push(Step {
            kind: StepKind::Additive,
            tool: tool.name.clone(),
            direction,
            holding,
            region: block.region,
            block: self.steps.len(),
            origin: Origin {
                plane: Some(Plane { normal: direction, offset: lowest - job.frame.pitch / 2.0 }),
                action: None,
            },
        });
    }
}

/// The ways along `directions` with one nozzle, each in the first holding that can point there.
fn ways_along<'a>(setting: &Setting<'a>, directions: &[Direction], tool: &'a Tool) -> Vec<Way<'a>> {
    let holding = |d: &Direction| (0..setting.holdings.len()).find(|h| setting.can_point(*h, *d));
    directions
        .iter()
        .filter_map(|d| Some(Way { direction: *d, holding: holding(d)?, tool }))
        .collect()
}

/// A block that is, or could be, laid.
struct Block<'a> {
    way: Way<'a>,
    region: BitGrid,
    /// Voxels of it beyond skin.
    gain: usize,
}

/// What can be laid on a state, on one grid.
struct Layer<'s> {
    job: &'s Job,
    state: &'s BitGrid,
    left: &'s BitGrid,
    core: &'s BitGrid,
    /// Fixed points of each holding.
    fixed: &'s [Vec<DVec3>],
}

impl Layer<'_> {
    /// The block with the first of some shorter nozzles that lays nearly as much.
    fn with_shorter<'a>(&self, block: Block<'a>, upto: f64, shorter: &'a [Tool]) -> Block<'a> {
        let least = SHORTER_TOOL_SHARE * block.gain as f64;
        let short = shorter.iter().map(|tool| self.lay(Way { tool, ..block.way }, upto));
        let short = short.into_iter().find(|b| b.gain as f64 >= least);
        short.unwrap_or(block)
    }

    /// The block that lays most of the core; of equals the first, none where nothing is laid.
    fn best<'a>(&self, ways: &[Way<'a>], ctx: &Ctx) -> Result<Option<Block<'a>>, Cancelled> {
        let gains: Vec<usize> = ways
            .par_iter()
            .map(|way| {
                ctx.check()?;
                Ok(self.lay(*way, f64::INFINITY).gain)
            })
            .collect::<Result<_, Cancelled>>()?;
        let best = (0..ways.len()).max_by_key(|&i| (gains[i], std::cmp::Reverse(i)));
        Ok(best.filter(|i| gains[*i] > 0).map(|i| self.lay(ways[i], f64::INFINITY)))
    }

    /// Where a way's nozzle stands clear.
    fn clear(&self, way: Way, scene: &Scene, candidates: &BitGrid) -> BitGrid {
        let dip = self.job.rules.nozzle_dip_mm;
        let map = nozzle_map(scene, candidates, way.tool, way.direction, dip);
        reachable(&map, candidates, &self.job.frame)
    }

    /// All that one way lays, from below, up to a height along its direction (mm).
    fn lay<'a>(&self, way: Way<'a>, upto: f64) -> Block<'a> {
        let job = self.job;
        let scene = Scene::new(&job.frame, self.state, &self.fixed[way.holding]);
        let clear = self.clear(way, &scene, self.left);
        let table = CarrierTable::new(way.direction, job.rules.overhang_deg);
        let mut voxels: Vec<([usize; 3], f64)> =
            clear.iter_ones().map(|v| (v, way.direction.dot(job.frame.center(v)))).collect();
        voxels.retain(|(_, z)| *z <= upto);
        voxels.sort_by(|a, b| a.1.total_cmp(&b.1));
        let mut solid = self.state.clone();
        let mut region = BitGrid::new(self.state.dims());
        for (v, _) in voxels {
            if table.carries(&solid, v) && joined(&solid, v) {
                solid.set(v, true);
                region.set(v, true);
            }
        }
        Block { way, gain: region.count_and(self.core), region }
    }
}

/// Face and edge neighbours within the grid.
fn joints(v: [usize; 3], dims: [usize; 3]) -> impl Iterator<Item = [usize; 3]> {
    (0..27usize).filter_map(move |i| {
        let o = [i % 3, i / 3 % 3, i / 9];
        let far = o.iter().filter(|c| **c != 1).count();
        let q: [usize; 3] = std::array::from_fn(|a| (v[a] + o[a]).wrapping_sub(1));
        ((1..=2).contains(&far) && (0..3).all(|a| q[a] < dims[a])).then_some(q)
    })
}

/// Whether a voxel has a solid face or edge neighbour: a carrier alone may touch at a corner only,
/// and what hangs by a corner is not connected.
fn joined(solid: &BitGrid, v: [usize; 3]) -> bool {
    joints(v, solid.dims()).any(|q| solid.get(q))
}
