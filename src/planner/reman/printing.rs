//! Additive blocks: V_A taken apart backward into pieces that print on planes.
//!
//! Method. Backward, from the finished part Q: along a direction n the voxels of V_A are swept from
//! the top down and joined into components, so that every component is a piece of Q above a plane
//! across n. A component is *good* while each of its voxels is carried within the overhang angle
//! and the nozzle stands there clear of everything that is not part of V_A. The maximal good
//! components of one direction make one block: all that remains beside it lies below its planes, so
//! its base is planar and nothing near it stands higher. Whatever else of Q stands in the nozzle's
//! way is found on the depth image and taken out of the block. Blocks are removed backward and
//! printed forward.
//!
//! Forward, each block is laid again against the true state, voxel by voxel from below, so that
//! what a step adds is carried and clear by definition; what is not is left out and reported.

use super::setting::Setting;
use crate::access::{CarrierTable, Scene, nozzle_map, reachable, supported, world_extent};
use crate::base::{Cancelled, Ctx, DVec3, Direction};
use crate::machine::Tool;
use crate::plan::{Origin, Plane, Step, StepKind};
use crate::voxel::{BitGrid, Connectivity, Frame, components};
use rayon::prelude::*;

/// The additive steps, the state they leave, and what of V_A they could not add.
pub struct Printing {
    pub steps: Vec<Step>,
    pub state: BitGrid,
    pub unreached: BitGrid,
}

/// A way to print: direction, holding and nozzle.
#[derive(Clone, Copy)]
struct Way<'a> {
    direction: Direction,
    holding: usize,
    tool: &'a Tool,
}

/// A block found backward.
struct Block<'a> {
    way: Way<'a>,
    region: BitGrid,
}

/// Components of a block smaller than this share of its largest are left to other directions:
/// the very tops of every bump would otherwise be blocks of their own.
const COMPONENT_SHARE: f64 = 0.05;

/// A preferred direction (plane or facet normal, up) is taken without a look at the samples when
/// it prints this share of what is left.
const ENOUGH_SHARE: f64 = 0.9;

/// Rounds in which voxels blocked by other parts of Q are taken out of a block.
const CLEARING_ROUNDS: usize = 6;

/// Prints `added` onto `state`; `preferred` directions are tried before the sampled ones.
pub fn print_blocks(
    setting: &Setting,
    state: &BitGrid,
    added: &BitGrid,
    preferred: &[Direction],
    samples: usize,
    ctx: &Ctx,
) -> Result<Printing, Cancelled> {
    let blocks = backward(setting, state, added, preferred, samples, ctx)?;
    forward(setting, state, added, blocks, ctx)
}

fn ways<'a>(setting: &Setting<'a>, directions: &[Direction]) -> Vec<Way<'a>> {
    let mut ways = Vec::new();
    for d in directions {
        let Some(holding) = (0..setting.holdings.len()).find(|h| setting.can_point(*h, *d)) else {
            continue;
        };
        ways.extend(setting.job.nozzles.iter().map(|tool| Way { direction: *d, holding, tool }));
    }
    ways
}

fn backward<'a>(
    setting: &Setting<'a>,
    state: &BitGrid,
    added: &BitGrid,
    preferred: &[Direction],
    samples: usize,
    ctx: &Ctx,
) -> Result<Vec<Block<'a>>, Cancelled> {
    let first = ways(setting, preferred);
    let all: Vec<Direction> =
        (0..setting.holdings.len()).flat_map(|h| setting.sampled(h, samples)).collect();
    let sampled = ways(setting, &all);
    let fixed: Vec<Vec<DVec3>> =
        (0..setting.holdings.len()).map(|h| setting.fixed(h, state)).collect();
    let sweep = Sweeper { setting, state, fixed: &fixed };
    let mut blocks: Vec<Block> = Vec::new();
    let mut left = added.clone();
    let mut clear_first = sweep.clear(&first, &left, ctx)?;
    let mut clear_sampled: Option<Vec<BitGrid>> = None;
    while !left.is_empty() {
        let mut best = sweep.best(&first, &clear_first, &left, ctx)?;
        let count = |b: &Option<Block>| b.as_ref().map_or(0, |b| b.region.count());
        if (count(&best) as f64) < ENOUGH_SHARE * left.count() as f64 {
            if clear_sampled.is_none() {
                clear_sampled = Some(sweep.clear(&sampled, &left, ctx)?);
            }
            let clear = clear_sampled.as_deref().unwrap_or_default();
            let other = sweep.best(&sampled, clear, &left, ctx)?;
            if count(&other) > count(&best) {
                best = other;
            }
        }
        let Some(block) = best.filter(|b| !b.region.is_empty()) else { break };
        left.subtract(&block.region);
        clear_first.iter_mut().for_each(|c| c.intersect_with(&left));
        blocks.push(block);
    }
    blocks.reverse();
    Ok(blocks)
}

struct Sweeper<'s, 'a> {
    setting: &'s Setting<'a>,
    /// What stands before anything is printed.
    state: &'s BitGrid,
    fixed: &'s [Vec<DVec3>],
}

impl<'a> Sweeper<'_, 'a> {
    /// Where each way's nozzle stands clear of the state and the fixed points.
    fn clear(&self, ways: &[Way], left: &BitGrid, ctx: &Ctx) -> Result<Vec<BitGrid>, Cancelled> {
        let frame = &self.setting.job.frame;
        let scenes: Vec<Scene> =
            self.fixed.iter().map(|fixed| Scene::new(frame, self.state, fixed)).collect();
        ways.par_iter()
            .map(|way| {
                ctx.check()?;
                Ok(self.depositable(&scenes[way.holding], way, left))
            })
            .collect()
    }

    fn depositable(&self, scene: &Scene, way: &Way, candidates: &BitGrid) -> BitGrid {
        let job = self.setting.job;
        match world_extent(candidates, &job.frame) {
            None => candidates.clone(),
            Some(within) => {
                let dip = job.rules.nozzle_dip_mm;
                let map = nozzle_map(scene, &within, way.tool, way.direction, dip);
                reachable(&map, candidates, &job.frame)
            }
        }
    }

    /// The largest block any of the ways prints of what is left; of equals the first.
    fn best(
        &self,
        ways: &[Way<'a>],
        clear: &[BitGrid],
        left: &BitGrid,
        ctx: &Ctx,
    ) -> Result<Option<Block<'a>>, Cancelled> {
        let standing = self.state.or(left);
        let sizes: Vec<(usize, BitGrid)> = ways
            .par_iter()
            .zip(clear)
            .map(|(way, clear)| {
                ctx.check()?;
                let clear = clear.and(left);
                let region =
                    if clear.is_empty() { clear } else { self.sweep(way, &clear, left, &standing) };
                Ok((region.count(), region))
            })
            .collect::<Result<_, Cancelled>>()?;
        // Ranked by size before the costly check against the rest of the part.
        let mut order: Vec<usize> = (0..sizes.len()).filter(|i| sizes[*i].0 > 0).collect();
        order.sort_by_key(|&i| (std::cmp::Reverse(sizes[i].0), i));
        let mut best: Option<Block> = None;
        for i in order {
            let at_least = best.as_ref().map_or(0, |b| b.region.count());
            if sizes[i].0 <= at_least {
                break;
            }
            let region = self.freed(&ways[i], &clear[i], left, sizes[i].1.clone(), &standing);
            if region.count() > at_least {
                best = Some(Block { way: ways[i], region });
            }
        }
        Ok(best)
    }

    /// Takes out of a block what other parts of Q block, until nothing does.
    fn freed(
        &self,
        way: &Way,
        clear: &BitGrid,
        left: &BitGrid,
        mut region: BitGrid,
        standing: &BitGrid,
    ) -> BitGrid {
        let frame = &self.setting.job.frame;
        let mut clear = clear.and(left);
        for _ in 0..CLEARING_ROUNDS {
            if region.is_empty() {
                return region;
            }
            let rest = standing.minus(&region);
            let scene = Scene::new(frame, &rest, &self.fixed[way.holding]);
            let free = self.depositable(&scene, way, &region);
            if free == region {
                return region;
            }
            clear.subtract(&region.minus(&free));
            region = self.sweep(way, &clear, left, standing);
        }
        BitGrid::new(frame.dims)
    }

    /// The maximal good components of `left` along a way.
    fn sweep(&self, way: &Way, clear: &BitGrid, left: &BitGrid, standing: &BitGrid) -> BitGrid {
        let job = self.setting.job;
        let table = CarrierTable::new(way.direction, job.rules.overhang_deg);
        let good = supported(&table, standing, clear);
        let found = good_components(&job.frame, way.direction, left, &good);
        drop_crumbs(&found)
    }
}

/// Sweeps `left` from the top along `direction`; returns the voxels whose component, when their own
/// layer was complete, held good voxels only.
fn good_components(frame: &Frame, direction: Direction, left: &BitGrid, good: &BitGrid) -> BitGrid {
    let mut out = BitGrid::new(left.dims());
    let Some((lo, hi)) = left.extent() else { return out };
    let size: [usize; 3] = std::array::from_fn(|a| hi[a] - lo[a] + 3);
    let cell = |v: [usize; 3]| {
        let [x, y, z]: [usize; 3] = std::array::from_fn(|a| v[a] - lo[a] + 1);
        x + size[0] * (y + size[1] * z)
    };
    // Layers of the sweep: whole voxel layers along a grid axis, half a pitch otherwise.
    let thickness = if direction.is_grid_axis() { frame.pitch } else { frame.pitch / 2.0 };
    let voxels: Vec<[usize; 3]> = left.iter_ones().collect();
    let heights: Vec<f64> = voxels.iter().map(|v| direction.dot(frame.center(*v))).collect();
    let top = heights.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let layer = |i: usize| ((top - heights[i]) / thickness + 0.25) as usize;
    let layers = (0..voxels.len()).map(layer).max().map_or(0, |l| l + 1);
    let mut starts = vec![0usize; layers + 1];
    (0..voxels.len()).for_each(|i| starts[layer(i) + 1] += 1);
    (0..layers).for_each(|l| starts[l + 1] += starts[l]);
    let mut order = vec![0u32; voxels.len()];
    let mut next = starts.clone();
    for i in 0..voxels.len() {
        order[next[layer(i)]] = i as u32;
        next[layer(i)] += 1;
    }
    const ABSENT: u32 = u32::MAX;
    let mut parent = vec![ABSENT; size.iter().product()];
    let mut spoiled = vec![false; voxels.len()];
    let mut root = vec![0u32; voxels.len()];
    let offsets: Vec<isize> = (0..27)
        .filter(|i| *i != 13)
        .map(|i: isize| {
            let (x, y, z) = (i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1);
            x + size[0] as isize * (y + size[1] as isize * z)
        })
        .collect();
    fn find(root: &mut [u32], mut i: u32) -> u32 {
        while root[i as usize] != i {
            root[i as usize] = root[root[i as usize] as usize];
            i = root[i as usize];
        }
        i
    }
    for l in 0..layers {
        let members = &order[starts[l]..starts[l + 1]];
        for &i in members {
            let v = voxels[i as usize];
            let c = cell(v);
            parent[c] = i;
            root[i as usize] = i;
            spoiled[i as usize] = !good.get(v);
            for o in &offsets {
                let n = parent[c.wrapping_add_signed(*o)];
                if n != ABSENT {
                    let (a, b) = (find(&mut root, n), find(&mut root, i));
                    if a != b {
                        let (low, high) = (a.min(b), a.max(b));
                        root[high as usize] = low;
                        spoiled[low as usize] |= spoiled[high as usize];
                    }
                }
            }
        }
        for &i in members {
            let r = find(&mut root, i);
            if !spoiled[r as usize] {
                out.set(voxels[i as usize], true);
            }
        }
    }
    out
}

/// Keeps the components that are not far smaller than the largest.
fn drop_crumbs(found: &BitGrid) -> BitGrid {
    let parts = components(found, Connectivity::Corner26);
    let largest = parts.sizes().iter().copied().max().unwrap_or(0);
    let least = COMPONENT_SHARE * largest as f64;
    let mut kept = BitGrid::new(found.dims());
    for v in found.iter_ones() {
        if parts.label_of(v).is_some_and(|l| parts.sizes()[l as usize] as f64 >= least) {
            kept.set(v, true);
        }
    }
    kept
}

fn forward(
    setting: &Setting,
    state: &BitGrid,
    added: &BitGrid,
    blocks: Vec<Block>,
    ctx: &Ctx,
) -> Result<Printing, Cancelled> {
    let job = setting.job;
    let mut printing =
        Printing { steps: Vec::new(), state: state.clone(), unreached: added.clone() };
    let mut held: Option<(usize, Vec<DVec3>)> = None;
    for block in blocks {
        ctx.check()?;
        let way = block.way;
        if held.as_ref().is_none_or(|(h, _)| *h != way.holding) {
            held = Some((way.holding, setting.fixed(way.holding, &printing.state)));
        }
        let fixed = held.as_ref().map_or(&[][..], |(_, f)| f);
        // What an earlier block could not add is tried again with every later one.
        let region = lay(job, &printing.state, &block.region, fixed, &way);
        if region.is_empty() {
            continue;
        }
        let lowest = region
            .iter_ones()
            .map(|v| way.direction.dot(job.frame.center(v)))
            .fold(f64::INFINITY, f64::min);
        printing.state.union_with(&region);
        printing.unreached.subtract(&region);
        printing.steps.push(Step {
            kind: StepKind::Additive,
            tool: way.tool.name.clone(),
            direction: way.direction,
            holding: way.holding,
            region,
            block: printing.steps.len(),
            origin: Origin {
                plane: Some(Plane {
                    normal: way.direction,
                    offset: lowest - job.frame.pitch / 2.0,
                }),
                action: None,
            },
        });
    }
    Ok(printing)
}

/// The part of `wanted` that is clear and carried when laid from below.
fn lay(
    job: &crate::plan::Job,
    state: &BitGrid,
    wanted: &BitGrid,
    fixed: &[DVec3],
    way: &Way,
) -> BitGrid {
    let Some(within) = world_extent(wanted, &job.frame) else { return wanted.clone() };
    let scene = Scene::new(&job.frame, state, fixed);
    let map = nozzle_map(&scene, &within, way.tool, way.direction, job.rules.nozzle_dip_mm);
    let clear = reachable(&map, wanted, &job.frame);
    let table = CarrierTable::new(way.direction, job.rules.overhang_deg);
    let mut voxels: Vec<([usize; 3], f64)> =
        clear.iter_ones().map(|v| (v, way.direction.dot(job.frame.center(v)))).collect();
    voxels.sort_by(|a, b| a.1.total_cmp(&b.1));
    let mut solid = state.clone();
    let mut region = BitGrid::new(state.dims());
    for (v, _) in voxels {
        if table.carries(&solid, v) {
            solid.set(v, true);
            region.set(v, true);
        }
    }
    region
}
