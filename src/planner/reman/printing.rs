//! Additive blocks (W2V Sec. 6): V_A in blocks along few directions.
//!
//! Method. From a state, everything that a way (direction, holding, nozzle) can lay is found in one
//! sweep from below: a voxel is laid when something carries it within the overhang angle and the
//! nozzle stands at it clear of the state. What the block itself has laid lies lower along the
//! direction and is never in the nozzle's way. The way that lays most comes first; which one
//! that is, is judged on the coarse grid, and the block itself is laid on the job's own.
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

/// A block prints at least this share of the core: less is left to a plane or to the residual,
/// since a change of direction for a crumb helps nobody.
const LEAST_SHARE: f64 = 5e-4;

/// And at least this much, mm³: a deposit smaller than a few millimetres of bead has no path.
const LEAST_MM3: f64 = 1.0;

/// Ways that are looked at closely after the coarse ranking, of the preferred and of the sampled
/// ones: more costs time, fewer trusts a staircase of coarse voxels too much.
const FINALISTS: usize = 3;

/// Ways laid closely for what the coarse grid does not show, those clear at most of it.
const CLEAREST_WAYS: usize = 8;

/// Prints what is wanted, block by block: ways are ranked on the coarse grid, the best of them are
/// laid on the job's own.
pub fn print_blocks(
    setting: &Setting,
    coarse: &Coarse,
    wanted: &Wanted,
    ctx: &Ctx,
) -> Result<Printing, Cancelled> {
    let mut printing = Printing::start(wanted.state, wanted.added);
    // Shorter nozzles reach less: they are asked once the direction is known.
    let Some((longest, shorter)) = setting.job.nozzles.split_last() else { return Ok(printing) };
    let preferred = ways_along(setting, wanted.preferred, longest);
    let sampled: Vec<Direction> =
        (0..setting.holdings.len()).flat_map(|h| setting.sampled(h, wanted.samples)).collect();
    let sampled = ways_along(setting, &sampled, longest);
    let core = coarse.most(wanted.core);
    let share = LEAST_SHARE * wanted.core.count() as f64;
    let least = share.max(LEAST_MM3 / setting.job.frame.voxel_volume()).ceil() as usize;
    let mut held: Option<(usize, Vec<DVec3>)> = None;
    loop {
        let left_over = printing.unreached.count_and(wanted.core);
        if left_over < least {
            break;
        }
        // A holding stays as it began until another takes its place.
        let fixed: Vec<Vec<DVec3>> = (0..setting.holdings.len())
            .map(|h| match &held {
                Some((now, fixed)) if *now == h => fixed.clone(),
                _ => setting.fixed(h, &printing.state),
            })
            .collect();
        let state = coarse.most(&printing.state);
        let left = coarse.most(&printing.state.or(&printing.unreached)).minus(&state);
        let quick =
            Layer { job: &coarse.job, state: &state, left: &left, core: &core, fixed: &fixed };
        let fine = Layer {
            job: setting.job,
            state: &printing.state,
            left: &printing.unreached,
            core: wanted.core,
            fixed: &fixed,
        };
        let finalists = |ways: &[Way<'_>]| -> Result<Vec<usize>, Cancelled> {
            let ranked = quick.ranked(ways, ctx)?;
            Ok(ranked.into_iter().take(FINALISTS).collect())
        };
        let mut some: Vec<Way> = finalists(&preferred)?.into_iter().map(|i| preferred[i]).collect();
        let mut best = fine.best(&some, ctx)?;
        if best.as_ref().is_none_or(|b| (b.gain as f64) < ENOUGH_SHARE * left_over as f64) {
            some = finalists(&sampled)?.into_iter().map(|i| sampled[i]).collect();
            let other = fine.best(&some, ctx)?;
            let gain = best.as_ref().map_or(0, |b| b.gain);
            best = other.filter(|o| o.gain > gain).or(best);
        }
        if best.as_ref().is_none_or(|b| b.gain < least) {
            // Too small or too tight for the coarse grid.
            let all: Vec<Way> = preferred.iter().chain(&sampled).copied().collect();
            best = fine.best(&fine.clearest(&all, ctx)?, ctx)?;
        }
        let Some(block) = best.filter(|b| b.gain >= least) else { break };
        let block = fine.with_shorter(block, shorter);
        tracing::debug!(
            direction = ?block.way.direction,
            tool = block.way.tool.name,
            gain = block.gain,
            left = left_over - block.gain,
            "print"
        );
        let holding = block.way.holding;
        printing.take(setting.job, block);
        held = Some((holding, fixed.into_iter().nth(holding).unwrap_or_default()));
    }
    Ok(printing)
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
    /// Indices of the ways that lay any of the core, the one that lays most first.
    fn ranked(&self, ways: &[Way], ctx: &Ctx) -> Result<Vec<usize>, Cancelled> {
        let gains: Vec<usize> = ways
            .par_iter()
            .map(|way| {
                ctx.check()?;
                Ok(self.lay(*way).gain)
            })
            .collect::<Result<_, Cancelled>>()?;
        Ok(descending(&gains))
    }

    /// The few ways whose nozzles stand clear at most of what is left of the core.
    fn clearest<'a>(&self, ways: &[Way<'a>], ctx: &Ctx) -> Result<Vec<Way<'a>>, Cancelled> {
        let wanted = self.left.and(self.core);
        let scenes: Vec<Scene> =
            self.fixed.iter().map(|f| Scene::new(&self.job.frame, self.state, f)).collect();
        let clear: Vec<usize> = ways
            .par_iter()
            .map(|w| {
                ctx.check()?;
                Ok(self.clear(*w, &scenes[w.holding], &wanted).count())
            })
            .collect::<Result<_, Cancelled>>()?;
        Ok(descending(&clear).into_iter().take(CLEAREST_WAYS).map(|i| ways[i]).collect())
    }

    /// The block with the first of some shorter nozzles that lays nearly as much.
    fn with_shorter<'a>(&self, block: Block<'a>, shorter: &'a [Tool]) -> Block<'a> {
        let least = SHORTER_TOOL_SHARE * block.gain as f64;
        let mut short = shorter.iter().map(|tool| self.lay(Way { tool, ..block.way }));
        short.find(|b| b.gain as f64 >= least).unwrap_or(block)
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

/// Face and edge neighbours within the grid.
fn joints(v: [usize; 3], dims: [usize; 3]) -> impl Iterator<Item = [usize; 3]> {
    (0..27usize).filter_map(move |i| {
        let o = [i % 3, i / 3 % 3, i / 9];
        let far = o.iter().filter(|c| **c != 1).count();
        let q: [usize; 3] = std::array::from_fn(|a| (v[a] + o[a]).wrapping_sub(1));
        ((1..=2).contains(&far) && (0..3).all(|a| q[a] < dims[a])).then_some(q)
    })
}

/// Indices of what is above 0, the largest first; of equals the first.
fn descending(counts: &[usize]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..counts.len()).filter(|i| counts[*i] > 0).collect();
    order.sort_by_key(|&i| (std::cmp::Reverse(counts[i]), i));
    order
}

/// Whether a voxel has a solid face or edge neighbour: a carrier alone may touch at a corner only,
/// and what hangs by a corner is not connected.
fn joined(solid: &BitGrid, v: [usize; 3]) -> bool {
    joints(v, solid.dims()).any(|q| solid.get(q))
}
