//! Additive blocks (W2V Sec. 6): V_A in blocks along few directions.
//!
//! Method. From a state, everything that a way (direction, holding, nozzle) can lay is found in one
//! sweep from below: a voxel is laid when something carries it within the overhang angle and the
//! nozzle stands at it clear of the state. What the block itself has laid lies lower along the
//! direction and is never in the nozzle's way. The way that lays most comes first; which one
//! that is, is judged on the coarse grid, and the block itself is laid on the job's own.
//!
//! Such blocks may close in on material that could have been laid before them. What is left at the
//! end is therefore put first: with only the voxels that carry it, as a block before all others,
//! and the others are laid again. This is kept as long as less is left.
//!
//! Guarantees: each block's voxels are carried, clear and connected when they are laid. Not
//! guaranteed: that every voxel finds its turn; what no block reaches is returned.

use super::coarse::Coarse;
use super::setting::Setting;
use crate::access::{CarrierTable, Scene, nozzle_map, reachable};
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

/// Ways that are looked at closely after the coarse ranking: more costs time, fewer trusts a
/// staircase of coarse voxels too much.
const FINALISTS: usize = 3;

/// A block prints at least this share of the core: less is left to a plane or to the residual,
/// since a change of direction for a crumb helps nobody.
const LEAST_SHARE: f64 = 5e-4;

/// Blocks put before all others at most, and ways tried for each.
const MOST_REPAIRS: usize = 8;
const REPAIR_WAYS: usize = 3;

/// Prints what is wanted, block by block.
pub fn print_blocks(
    setting: &Setting,
    coarse: &Coarse,
    wanted: &Wanted,
    ctx: &Ctx,
) -> Result<Printing, Cancelled> {
    // Shorter nozzles reach less: they are asked once the direction is known.
    let Some((longest, shorter)) = setting.job.nozzles.split_last() else {
        return Ok(Printing::start(wanted));
    };
    let mut ways = ways_along(setting, wanted.preferred, longest);
    let first = ways.len();
    let sampled: Vec<Direction> =
        (0..setting.holdings.len()).flat_map(|h| setting.sampled(h, wanted.samples)).collect();
    ways.extend(ways_along(setting, &sampled, longest));
    let press = Press {
        setting,
        coarse,
        wanted,
        ways,
        first,
        shorter,
        core: coarse.most(wanted.core),
        least: ((LEAST_SHARE * wanted.core.count() as f64) as usize).max(1),
    };
    let mut orders = Vec::new();
    let mut best = Printing::start(wanted);
    press.fill(&mut best, &mut orders, ctx)?;
    press.repair(best, orders, ctx)
}

/// A block to be laid: its way and, when not all that the way lays is meant, what is.
#[derive(Clone)]
struct Order<'a> {
    way: Way<'a>,
    only: Option<BitGrid>,
}

/// What stays the same while blocks are chosen.
struct Press<'s, 'a> {
    setting: &'s Setting<'a>,
    coarse: &'s Coarse,
    wanted: &'s Wanted<'s>,
    ways: Vec<Way<'a>>,
    /// How many of the ways are preferred.
    first: usize,
    shorter: &'a [Tool],
    /// The core on the coarse grid.
    core: BitGrid,
    /// Fewest core voxels of a block.
    least: usize,
}

impl<'a> Press<'_, 'a> {
    fn left(&self, printing: &Printing) -> usize {
        printing.unreached.count_and(self.wanted.core)
    }

    /// Takes blocks, the largest first, until none lays enough.
    fn fill(
        &self,
        printing: &mut Printing,
        orders: &mut Vec<Order<'a>>,
        ctx: &Ctx,
    ) -> Result<(), Cancelled> {
        while self.left(printing) >= self.least {
            let Some(block) = self.next(printing, ctx)? else { break };
            tracing::debug!(
                direction = ?block.way.direction,
                tool = block.way.tool.name,
                gain = block.gain,
                left = self.left(printing) - block.gain,
                "print"
            );
            orders.push(Order { way: block.way, only: None });
            printing.take(self.setting.job, block);
        }
        Ok(())
    }

    /// The next block, if any lays enough.
    fn next(&self, printing: &Printing, ctx: &Ctx) -> Result<Option<Block<'a>>, Cancelled> {
        let fixed = self.fixed(&printing.state);
        let state = self.coarse.most(&printing.state);
        let left = self.coarse.most(&printing.state.or(&printing.unreached)).minus(&state);
        let quick = Layer {
            job: &self.coarse.job,
            state: &state,
            left: &left,
            core: &self.core,
            fixed: &fixed,
        };
        let fine = self.layer(printing, &printing.unreached, &fixed);
        let enough = (ENOUGH_SHARE * self.left(printing) as f64) as usize;
        let mut best: Option<Block> = None;
        for upto in [self.first, self.ways.len()] {
            let finalists: Vec<Way> =
                quick.ranked(&self.ways[..upto], ctx)?.into_iter().take(FINALISTS).collect();
            best = fine.best(&finalists, ctx)?;
            if best.as_ref().is_some_and(|b| b.gain >= enough) {
                break;
            }
        }
        if best.as_ref().is_none_or(|b| b.gain < self.least) {
            // Too small or too tight for the coarse grid: every way, on the job's own.
            best = fine.best(&self.ways, ctx)?;
        }
        let Some(block) = best.filter(|b| b.gain >= self.least) else { return Ok(None) };
        let least = SHORTER_TOOL_SHARE * block.gain as f64;
        let short = self
            .shorter
            .iter()
            .map(|tool| fine.lay(Way { tool, ..block.way }))
            .find(|b| b.gain as f64 >= least);
        Ok(Some(short.unwrap_or(block)))
    }

    /// Puts what is left before all other blocks, as long as that leaves less.
    fn repair(
        &self,
        mut best: Printing,
        mut orders: Vec<Order<'a>>,
        ctx: &Ctx,
    ) -> Result<Printing, Cancelled> {
        for put_first in 0..MOST_REPAIRS {
            let left = self.left(&best);
            if left < self.least {
                break;
            }
            let missing = best.unreached.and(self.wanted.core);
            let ahead = self.replay(&orders[..put_first], ctx)?;
            let mut better = false;
            for order in self.carrying(&ahead, &missing, ctx)? {
                let mut tried = orders.clone();
                tried.insert(put_first, order);
                let mut printing = self.replay(&tried, ctx)?;
                self.fill(&mut printing, &mut tried, ctx)?;
                tracing::debug!(before = left, after = self.left(&printing), "repair");
                if self.left(&printing) < left {
                    (best, orders, better) = (printing, tried, true);
                    break;
                }
            }
            if !better {
                break;
            }
        }
        Ok(best)
    }

    /// Lays blocks again in an order; blocks that lay nothing of the core any more fall away.
    fn replay(&self, orders: &[Order<'a>], ctx: &Ctx) -> Result<Printing, Cancelled> {
        let mut printing = Printing::start(self.wanted);
        for order in orders {
            ctx.check()?;
            let fixed = self.fixed(&printing.state);
            let left = match &order.only {
                Some(only) => printing.unreached.and(only),
                None => printing.unreached.clone(),
            };
            let block = self.layer(&printing, &left, &fixed).lay(order.way);
            if block.gain > 0 {
                printing.take(self.setting.job, block);
            }
        }
        Ok(printing)
    }

    /// Blocks that lay most of `missing` next, each with only what carries that.
    fn carrying(
        &self,
        printing: &Printing,
        missing: &BitGrid,
        ctx: &Ctx,
    ) -> Result<Vec<Order<'a>>, Cancelled> {
        let fixed = self.fixed(&printing.state);
        let frame = &self.setting.job.frame;
        let fine = self.layer(printing, &printing.unreached, &fixed);
        // A way that is clear at little of what is missing need not be laid.
        let scenes: Vec<Scene> =
            fixed.iter().map(|f| Scene::new(frame, &printing.state, f)).collect();
        let clear: Vec<usize> = self
            .ways
            .par_iter()
            .map(|w| {
                ctx.check()?;
                Ok(fine.clear(*w, &scenes[w.holding], missing).count())
            })
            .collect::<Result<_, Cancelled>>()?;
        let mut order: Vec<usize> = (0..self.ways.len()).filter(|i| clear[*i] > 0).collect();
        order.sort_by_key(|&i| (std::cmp::Reverse(clear[i]), i));
        order.truncate(2 * REPAIR_WAYS);
        let mut blocks: Vec<(usize, Order)> = order
            .par_iter()
            .map(|&i| {
                ctx.check()?;
                let block = fine.lay(self.ways[i]);
                let reached = block.region.and(missing);
                let only = self.carriers(&block, &printing.state, &reached);
                Ok((reached.count(), Order { way: block.way, only: Some(only) }))
            })
            .collect::<Result<_, Cancelled>>()?;
        blocks.retain(|(n, _)| *n > 0);
        blocks.sort_by_key(|(n, _)| std::cmp::Reverse(*n));
        blocks.truncate(REPAIR_WAYS);
        Ok(blocks.into_iter().map(|(_, o)| o).collect())
    }

    /// `reached` with one chain of carriers each, down to the state.
    fn carriers(&self, block: &Block, state: &BitGrid, reached: &BitGrid) -> BitGrid {
        let job = self.setting.job;
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

    fn fixed(&self, state: &BitGrid) -> Vec<Vec<DVec3>> {
        (0..self.setting.holdings.len()).map(|h| self.setting.fixed(h, state)).collect()
    }

    fn layer<'l>(
        &'l self,
        printing: &'l Printing,
        left: &'l BitGrid,
        fixed: &'l [Vec<DVec3>],
    ) -> Layer<'l> {
        let (job, core) = (self.setting.job, self.wanted.core);
        Layer { job, state: &printing.state, left, core, fixed }
    }
}

impl Printing {
    fn start(wanted: &Wanted) -> Printing {
        Printing { steps: Vec::new(), state: wanted.state.clone(), unreached: wanted.added.clone() }
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
    /// Ways that lay any of the core, the one that lays most first.
    fn ranked<'a>(&self, ways: &[Way<'a>], ctx: &Ctx) -> Result<Vec<Way<'a>>, Cancelled> {
        let gains: Vec<usize> = ways
            .par_iter()
            .map(|way| {
                ctx.check()?;
                Ok(self.lay(*way).gain)
            })
            .collect::<Result<_, Cancelled>>()?;
        let mut order: Vec<usize> = (0..ways.len()).filter(|i| gains[*i] > 0).collect();
        order.sort_by_key(|&i| (std::cmp::Reverse(gains[i]), i));
        Ok(order.into_iter().map(|i| ways[i]).collect())
    }

    /// The block that lays most of the core; of equals the first, none where nothing is laid.
    fn best<'a>(&self, ways: &[Way<'a>], ctx: &Ctx) -> Result<Option<Block<'a>>, Cancelled> {
        let gains: Vec<usize> = ways
            .par_iter()
            .map(|way| {
                ctx.check()?;
                Ok(self.lay(*way).gain)
            })
            .collect::<Result<_, Cancelled>>()?;
        let best = (0..ways.len()).max_by_key(|&i| (gains[i], std::cmp::Reverse(i)));
        Ok(best.filter(|i| gains[*i] > 0).map(|i| self.lay(ways[i])))
    }

    /// Where a way's nozzle stands clear.
    fn clear(&self, way: Way, scene: &Scene, candidates: &BitGrid) -> BitGrid {
        let dip = self.job.rules.nozzle_dip_mm;
        let map = nozzle_map(scene, candidates, way.tool, way.direction, dip);
        reachable(&map, candidates, &self.job.frame)
    }

    /// All that one way lays, from below.
    fn lay<'a>(&self, way: Way<'a>) -> Block<'a> {
        let job = self.job;
        let scene = Scene::new(&job.frame, self.state, &self.fixed[way.holding]);
        let clear = self.clear(way, &scene, self.left);
        let table = CarrierTable::new(way.direction, job.rules.overhang_deg);
        let mut voxels: Vec<([usize; 3], f64)> =
            clear.iter_ones().map(|v| (v, way.direction.dot(job.frame.center(v)))).collect();
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

/// Whether a voxel has a solid face or edge neighbour: a carrier alone may touch at a corner only,
/// and what hangs by a corner is not connected.
fn joined(solid: &BitGrid, v: [usize; 3]) -> bool {
    let p = v.map(|c| c as i64);
    (0..27).any(|i: i64| {
        let o = [i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1];
        let far = o.iter().map(|c| c.abs()).sum::<i64>();
        (1..=2).contains(&far) && solid.get_or_empty([p[0] + o[0], p[1] + o[1], p[2] + o[2]])
    })
}
