//! What one way (direction, holding, nozzle) lays on a state, and which way lays most.
//!
//! Method. Everything a way can lay is found in one sweep from below: a voxel is laid when
//! something carries it within the overhang angle and the nozzle stands at it clear of the state.
//! What the block itself has laid lies lower along the direction and is never in the nozzle's way.
//! From straight above, as clamped, the base carries its first layer.
//!
//! Guarantees: a block's voxels are carried, clear and connected when they are laid.

use super::setting::Setting;
use crate::access::{CarrierTable, CloseNozzle, Scene, nozzle_map, reachable};
use crate::base::{Cancelled, Ctx, DVec3, Direction};
use crate::machine::{HoldingMode, Tool};
use crate::plan::Job;
use crate::region::steady;
use crate::voxel::{BitGrid, Connectivity, Frame, flood};
use rayon::prelude::*;
use std::collections::HashMap;

/// A shorter nozzle is taken when it prints this share of what the longest prints.
const SHORTER_TOOL_SHARE: f64 = 0.97;

/// Ways laid closely for what the coarse grid does not show, those clear at most of it.
const CLEAREST_WAYS: usize = 8;

/// Voxels up to which exact distances are asked: with more, it is not half a voxel that is in the way.
const MOST_CLOSELY: usize = 3000;

/// Of so few voxels no maps are asked before: they would take longer, and exact distances tell the same and more.
const FEWEST_CLOSELY: usize = 300;

/// Of so many voxels those that a nozzle does not get at past what is next to them are told before a map is made.
const MOST_NEARBY: usize = 20_000;

/// A way to print: direction, holding and nozzle.
#[derive(Clone, Copy)]
pub struct Way<'a> {
    pub direction: Direction,
    pub holding: usize,
    pub tool: &'a Tool,
}

impl Way<'_> {
    /// Whether its deposits may begin on the bare base: from straight above, held as clamped.
    pub fn on_base(&self) -> bool {
        self.holding == 0 && self.direction == Direction::Z
    }
}

/// The lowest layer of a grid that lies over the base plane; of a grid coarser than the job's, for
/// the most part.
pub fn base_layer(frame: &Frame) -> Option<usize> {
    (0..frame.dims[2]).find(|z| frame.center([0, 0, *z]).z >= 0.0)
}

/// The ways along `directions` with one nozzle, each in the first holding that can point there.
pub fn ways_along<'a>(
    setting: &Setting<'a>,
    directions: &[Direction],
    tool: &'a Tool,
) -> Vec<Way<'a>> {
    let holding = |d: &Direction| (0..setting.holdings.len()).find(|h| setting.can_point(*h, *d));
    directions
        .iter()
        .filter_map(|d| Some(Way { direction: *d, holding: holding(d)?, tool }))
        .collect()
}

/// A block that is, or could be, laid.
pub struct Block<'a> {
    pub way: Way<'a>,
    pub region: BitGrid,
    /// Voxels of it beyond skin.
    pub gain: usize,
}

/// What can be laid on a state, on one grid.
#[derive(Clone, Copy)]
pub struct Layer<'s> {
    pub job: &'s Job,
    pub state: &'s BitGrid,
    pub left: &'s BitGrid,
    pub core: &'s BitGrid,
    /// Fixed points of each holding.
    pub fixed: &'s [Vec<DVec3>],
    /// Whether nozzles are told clear by exact distances where little is left.
    pub closely: bool,
}

impl Layer<'_> {
    /// Indices of the ways that lay any of the core, the one that lays most first.
    pub fn ranked(&self, ways: &[Way], ctx: &Ctx) -> Result<Vec<usize>, Cancelled> {
        Ok(descending(&self.gains(ways, ctx)?))
    }

    /// Voxels of the core that each way lays.
    fn gains(&self, ways: &[Way], ctx: &Ctx) -> Result<Vec<usize>, Cancelled> {
        let scenes = self.scenes();
        let close = self.close(&scenes);
        let gain = |way: &Way| {
            ctx.check()?;
            Ok(self.lay_in(*way, &close[way.holding]).gain)
        };
        ways.par_iter().map(gain).collect()
    }

    /// The few ways whose nozzles stand clear at most of what is left of the core, of those that may do so at
    /// `least` voxels.
    pub fn clearest<'a>(
        &self,
        ways: &[Way<'a>],
        least: usize,
        ctx: &Ctx,
    ) -> Result<Vec<Way<'a>>, Cancelled> {
        let scenes = self.scenes();
        let close = self.close(&scenes);
        let wanted = self.left.and(self.core);
        let clear: Vec<usize> = ways
            .par_iter()
            .map(|w| {
                ctx.check()?;
                Ok(self.clear(*w, &close[w.holding], &wanted, least).count())
            })
            .collect::<Result<_, Cancelled>>()?;
        Ok(descending(&clear).into_iter().take(CLEAREST_WAYS).map(|i| ways[i]).collect())
    }

    /// Where, of what is left of the core, the nozzle of any of the ways stands clear.
    pub fn clear_along_any(&self, ways: &[Way], ctx: &Ctx) -> Result<BitGrid, Cancelled> {
        let scenes = self.scenes();
        let close = self.close(&scenes);
        let wanted = self.left.and(self.core);
        let none = || BitGrid::new(self.state.dims());
        let join = |mut any: BitGrid, clear: BitGrid| {
            any.union_with(&clear);
            Ok(any)
        };
        ways.par_iter()
            .map(|w| {
                ctx.check()?;
                Ok(self.clear(*w, &close[w.holding], &wanted, 1))
            })
            .try_reduce(none, join)
    }

    /// What is in the way, in each holding.
    fn scenes(&self) -> Vec<Scene> {
        self.fixed.iter().map(|f| Scene::new(&self.job.frame, self.state, f)).collect()
    }

    /// The same, for exact questions.
    fn close<'c>(&'c self, scenes: &'c [Scene]) -> Vec<CloseNozzle<'c>> {
        scenes.iter().map(|s| CloseNozzle::new(s, self.state)).collect()
    }

    /// The block with the first of some shorter or coarser nozzles that lays nearly as much; with
    /// a coarser tip all of it, since a crease that it leaves is closed by what it lays.
    pub fn with_shorter<'a>(&self, block: Block<'a>, shorter: &'a [Tool]) -> Block<'a> {
        let tip = block.way.tool.tip_radius();
        let enough = |b: &Block| {
            let share = if b.way.tool.tip_radius() > tip { 1.0 } else { SHORTER_TOOL_SHARE };
            b.gain as f64 >= share * block.gain as f64
        };
        let mut short = shorter.iter().map(|tool| self.lay(Way { tool, ..block.way }));
        short.find(enough).unwrap_or(block)
    }

    /// The block that lays most of the core; of equals the first, none where nothing is laid.
    pub fn best<'a>(&self, ways: &[Way<'a>], ctx: &Ctx) -> Result<Option<Block<'a>>, Cancelled> {
        let gains = self.gains(ways, ctx)?;
        let best = (0..ways.len()).max_by_key(|&i| (gains[i], std::cmp::Reverse(i)));
        Ok(best.filter(|i| gains[*i] > 0).map(|i| self.lay(ways[i])))
    }

    /// Of the blocks that lay `least` voxels of the core, the one that lays most where each counts the less the more
    /// ways lay it: by one over the square of their number.
    pub fn scarcest<'a>(
        &self,
        ways: &[Way<'a>],
        least: usize,
        ctx: &Ctx,
    ) -> Result<Option<Block<'a>>, Cancelled> {
        let scenes = self.scenes();
        let close = self.close(&scenes);
        let core = self.left.and(self.core);
        let places: HashMap<[usize; 3], u32> = core.iter_ones().zip(0..).collect();
        let laid = |way: &Way| -> Result<Vec<u32>, Cancelled> {
            ctx.check()?;
            let region = self.lay_in(*way, &close[way.holding]).region;
            Ok(region.iter_ones().filter_map(|v| places.get(&v).copied()).collect())
        };
        let laid: Vec<Vec<u32>> = ways.par_iter().map(laid).collect::<Result<_, _>>()?;
        let mut ways_to = vec![0u32; places.len()];
        laid.iter().flatten().for_each(|v| ways_to[*v as usize] += 1);
        let worth = |of: &[u32]| -> f64 {
            of.iter().map(|v| 1.0 / f64::from(ways_to[*v as usize]).powi(2)).sum()
        };
        let mut best: Option<(f64, usize)> = None;
        for (i, of) in laid.iter().enumerate().filter(|(_, of)| of.len() >= least) {
            let worth = worth(of);
            if best.is_none_or(|(w, _)| worth > w) {
                best = Some((worth, i));
            }
        }
        Ok(best.map(|(_, i)| self.lay(ways[i])))
    }

    /// Where a way's nozzle stands clear; nowhere if that is at fewer than `least` voxels for sure.
    fn clear(&self, way: Way, close: &CloseNozzle, candidates: &BitGrid, least: usize) -> BitGrid {
        let (tool, d, dip) = (way.tool, way.direction, self.job.rules.nozzle_dip_mm);
        let map = |some: &BitGrid| {
            let map = nozzle_map(close.scene(), some, tool, d, dip);
            reachable(&map, some, &self.job.frame)
        };
        // Along the axes the maps are exact, and obstacles lie on the very edge of a nozzle.
        if d.is_grid_axis() || candidates.count() > MOST_NEARBY {
            return map(candidates);
        }
        let set = |of: Vec<[usize; 3]>| {
            let mut grid = BitGrid::new(candidates.dims());
            of.into_iter().for_each(|v| grid.set(v, true));
            grid
        };
        let all: Vec<[usize; 3]> = candidates.iter_ones().collect();
        let open = close.open_nearby(&all, tool, d, dip);
        if open.len() < least.max(1) {
            return set(Vec::new());
        }
        if self.closely && open.len() <= FEWEST_CLOSELY {
            return set(close.clear(&open, tool, d, dip));
        }
        let open = set(open);
        let mut clear = map(&open);
        let others: Vec<[usize; 3]> = open.minus(&clear).iter_ones().collect();
        if self.closely && others.len() <= MOST_CLOSELY {
            let more = close.clear(&others, tool, d, dip);
            more.into_iter().for_each(|v| clear.set(v, true));
        }
        clear
    }

    /// All that one way lays, from below.
    pub fn lay<'a>(&self, way: Way<'a>) -> Block<'a> {
        let scene = Scene::new(&self.job.frame, self.state, &self.fixed[way.holding]);
        self.lay_in(way, &CloseNozzle::new(&scene, self.state))
    }

    /// The same among what is in the way in its holding.
    fn lay_in<'a>(&self, way: Way<'a>, close: &CloseNozzle) -> Block<'a> {
        let job = self.job;
        let clear = self.clear(way, close, self.left, 1);
        let table = CarrierTable::new(way.direction, job.rules.overhang_deg);
        let mut voxels: Vec<([usize; 3], f64)> =
            clear.iter_ones().map(|v| (v, way.direction.dot(job.frame.center(v)))).collect();
        voxels.sort_by(|a, b| a.1.total_cmp(&b.1));
        let mut solid = self.state.clone();
        let mut region = BitGrid::new(self.state.dims());
        let plate = if way.on_base() { base_layer(&job.frame) } else { None };
        // Carried, but touching nothing by a face or an edge until a neighbour beside it is laid.
        let mut waiting = BitGrid::new(self.state.dims());
        let mut any_wait = false;
        for (v, _) in voxels {
            if plate != Some(v[2]) {
                let around = solid.around(v);
                if !table.carries_among(around, &solid, v) {
                    continue;
                }
                // A carrier alone may touch at a corner only, and what hangs by a corner is not connected.
                if around & JOINTS == 0 {
                    waiting.set(v, true);
                    any_wait = true;
                    continue;
                }
            }
            let mut laid = vec![v];
            while let Some(v) = laid.pop() {
                solid.set(v, true);
                region.set(v, true);
                if any_wait && waiting.around(v) & JOINTS != 0 {
                    let due: Vec<_> = joints(v, solid.dims()).filter(|q| waiting.get(*q)).collect();
                    due.iter().for_each(|q| waiting.set(*q, false));
                    laid.extend(due);
                }
            }
        }
        if plate.is_some() && job.rules.holding == HoldingMode::Refixture {
            self.keep_one_body(&mut region, &solid);
        }
        Block { way, gain: region.count_and(self.core), region }
    }

    /// Drops what stands on the base beside the part: where steps may hold the part anew, it has to
    /// stay one body.
    fn keep_one_body(&self, region: &mut BitGrid, solid: &BitGrid) {
        let body = match self.state.is_empty() {
            true => steady(solid, &self.job.frame, HoldingMode::Refixture, 0.0),
            false => flood(solid, self.state, Connectivity::Edge18),
        };
        region.intersect_with(&body);
    }
}

/// Face and edge neighbours as bits of [`BitGrid::around`].
const JOINTS: u32 = {
    let (mut bits, mut i) = (0, 0);
    while i < 27 {
        let far = (i % 3 != 1) as u8 + (i / 3 % 3 != 1) as u8 + (i / 9 != 1) as u8;
        if far == 1 || far == 2 {
            bits |= 1 << i;
        }
        i += 1;
    }
    bits
};

/// The same within the grid.
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

/// Whether a voxel has a solid face or edge neighbour that lies no higher along a direction, and so is laid no later.
pub fn joined_from_below(solid: &BitGrid, v: [usize; 3], up: Direction) -> bool {
    let rise = |q: [usize; 3]| {
        let step: [f64; 3] = std::array::from_fn(|a| q[a] as f64 - v[a] as f64);
        up.dot(DVec3::from_array(step))
    };
    // Neighbours beside each other differ by rounding alone.
    joints(v, solid.dims()).any(|q| solid.get(q) && rise(q) < 1e-6)
}

#[cfg(test)]
mod tests {
    use super::super::local_tests::job_of;
    use super::*;

    #[test]
    fn joints_are_the_same_as_bits() {
        let bit = |q: [usize; 3]| 1 << (q[0] + 3 * q[1] + 9 * q[2]);
        let all = joints([1, 1, 1], [3, 3, 3]).map(bit).fold(0u32, |all, b| all | b);
        assert_eq!((all, all.count_ones()), (JOINTS, 18));
    }

    /// A layer on a plate, printed along any of three ways, and less of it under a roof, along one.
    #[test]
    fn what_one_way_alone_lays_comes_before_more_that_others_lay_as_well() {
        let frame = Frame { pitch: 1.0, dims: [60, 40, 30], origin: DVec3::ZERO };
        let wall = |[x, y, z]: [usize; 3]| x > 20 && x < 24 && y > 4 && y < 36 && z < 24;
        let roof = |[x, y, z]: [usize; 3]| x < 24 && y > 4 && y < 36 && (20..24).contains(&z);
        let state = BitGrid::from_fn(frame.dims, |v| v[2] < 4 || wall(v) || roof(v));
        let open = |[x, y, z]: [usize; 3]| x > 40 && y > 2 && y < 38 && z == 4;
        let under = |[x, y, z]: [usize; 3]| x == 20 && y > 8 && y < 32 && (10..14).contains(&z);
        let left = BitGrid::from_fn(frame.dims, |v| open(v) || under(v));
        let job = job_of(frame, state.clone(), state.or(&left), |_| true);
        let fixed = vec![Vec::new()];
        let layer = Layer {
            job: &job,
            state: &state,
            left: &left,
            core: &left,
            fixed: &fixed,
            closely: false,
        };
        let tool = Tool::longest(&job.nozzles).unwrap();
        let tilted = |x: f64| Direction::new(DVec3::new(x, 0.0, 1.0)).unwrap();
        let ways = [Direction::Z, tilted(0.3), tilted(0.4), Direction::NEG_X]
            .map(|direction| Way { direction, holding: 0, tool });
        let ctx = Ctx::quiet();
        let largest = layer.best(&ways, &ctx).unwrap().unwrap();
        assert!(largest.way.direction != Direction::NEG_X && largest.gain > 500);
        let scarcest = layer.scarcest(&ways, 1, &ctx).unwrap().unwrap();
        assert_eq!((scarcest.way.direction, scarcest.gain), (Direction::NEG_X, 23 * 4));
        // Of what is too little to be a block the largest is left.
        let least = layer.scarcest(&ways, 23 * 4 + 1, &ctx).unwrap().unwrap();
        assert_eq!(least.gain, largest.gain);
        assert!(layer.scarcest(&ways, left.count(), &ctx).unwrap().is_none());
    }
}
