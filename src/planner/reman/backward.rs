//! An order of blocks that is found from its end.
//!
//! What is laid early is in the way of what comes later: on its walls the nozzle's tip leaves films, and blocks that lie
//! beside each other close them in. Which blocks do so cannot be told when they are laid, but it can from the end
//! (assembly by disassembly).
//!
//! Method. With all that is wanted standing, the last block along a direction is the largest set B of which the nozzle
//! can lay every voxel while all else stands. It is a greatest fixed point: begin with all that something carries, and
//! leave out what the nozzle does not get at past the rest, until nothing more is left out. Leaving out adds obstacles
//! alone, so the result does not depend on the order, and it contains every set of that kind. The largest of those
//! along the axes is taken away; of what then stands the last block is looked for again, while it is no crumb. What
//! remains is printed first, what few ways lay before what many do, and the blocks follow in the order opposite to that
//! in which they were found.
//!
//! Skin need not be printed, so none of it is in the way; it goes with the block next to it.
//!
//! Guarantees: those of blocks (`laying`), by which each is laid anew. Not guaranteed: that a block then lays all
//! that it was found to: what carries it may be missing.

use super::coarse::Coarse;
use super::laying::{Way, base_layer, ways_along};
use super::printing::{Printing, Wanted, print_in_order};
use super::setting::Setting;
use crate::access::{CarrierTable, Scene, nozzle_map, reachable, supported};
use crate::base::{Cancelled, Ctx, DVec3, Direction};
use crate::plan::Job;
use crate::voxel::{BitGrid, distance_within};

/// A block is no crumb if it is this share of the core.
const LEAST_SHARE: f64 = 0.05;

/// The share of the core that may remain to be printed first: of more, printing all forward tells as much.
const MOST_FIRST: f64 = 0.2;

/// Prints in an order found from its end; none where too much would come first.
pub fn print_backward(
    setting: &Setting,
    coarse: &Coarse,
    wanted: &Wanted,
    ctx: &Ctx,
) -> Result<Option<Printing>, Cancelled> {
    let Some(tool) = setting.nozzles().last() else { return Ok(None) };
    let axes: Vec<Direction> = (0..setting.holdings.len()).flat_map(|h| setting.axes(h)).collect();
    let ways = ways_along(setting, &axes, tool);
    let fixed: Vec<Vec<DVec3>> =
        (0..setting.holdings.len()).map(|h| setting.fixed(h, wanted.state)).collect();
    let near = setting.job.rules.tolerance_mm / setting.job.frame.pitch;
    let all = wanted.core.count() as f64;
    let skin = wanted.added.minus(wanted.core);
    let mut core = wanted.core.clone();
    let mut left = wanted.added.clone();
    let mut order: Vec<(Way, BitGrid)> = Vec::new();
    loop {
        let standing = Standing { job: setting.job, state: wanted.state, core: &core, left: &left };
        let best = standing.largest(&ways, &fixed, ctx)?;
        let Some((gain, way, mut block)) = best else { break };
        if (gain as f64) < LEAST_SHARE * all {
            break;
        }
        core.subtract(&block);
        let beside = skin.and(&left).and(&distance_within(&block, near));
        block.union_with(&beside.minus(&distance_within(&core, near)));
        left.subtract(&block);
        tracing::debug!(direction = ?way.direction, gain, left = core.count(), "backward");
        order.push((way, block));
    }
    if order.is_empty() || core.count() as f64 > MOST_FIRST * all {
        return Ok(None);
    }
    order.reverse();
    print_in_order(setting, coarse, wanted, (&left, &order), ctx).map(Some)
}

/// What stands at some time, looked at from the end.
pub struct Standing<'s> {
    pub job: &'s Job,
    /// What stood before anything was printed.
    pub state: &'s BitGrid,
    /// What of that which is to be printed stands yet, beyond skin and in all.
    pub core: &'s BitGrid,
    pub left: &'s BitGrid,
}

impl Standing<'_> {
    /// The largest block that any of some ways could have laid last, with its size in voxels; of equals the first.
    pub fn largest<'a>(
        &self,
        ways: &[Way<'a>],
        fixed: &[Vec<DVec3>],
        ctx: &Ctx,
    ) -> Result<Option<(usize, Way<'a>, BitGrid)>, Cancelled> {
        let mut best: Option<(usize, Way, BitGrid)> = None;
        for way in ways {
            ctx.check()?;
            let known = best.as_ref().map_or(0, |b| b.0);
            let block = self.last_block(*way, &fixed[way.holding], known);
            let gain = block.count();
            if gain > known {
                best = Some((gain, *way, block));
            }
        }
        Ok(best)
    }

    /// The largest block of the core that a way could have laid last; none if it is no larger than `known`.
    pub fn last_block(&self, way: Way, fixed: &[DVec3], known: usize) -> BitGrid {
        let job = self.job;
        let table = CarrierTable::new(way.direction, job.rules.overhang_deg);
        let mut block = supported(&table, &self.state.or(self.left), self.core);
        if let (true, Some(base)) = (way.on_base(), base_layer(&job.frame)) {
            self.core.iter_ones().filter(|v| v[2] == base).for_each(|v| block.set(v, true));
        }
        loop {
            let before = block.count();
            if before <= known {
                return BitGrid::new(job.frame.dims);
            }
            let obstacle = self.state.or(&self.core.minus(&block));
            let scene = Scene::new(&job.frame, &obstacle, fixed);
            let dip = job.rules.nozzle_dip_mm;
            let map = nozzle_map(&scene, &block, way.tool, way.direction, dip);
            block = reachable(&map, &block, &job.frame);
            if block.count() == before {
                return block;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::local_tests::{assert_verifies, job_of};
    use super::super::printing::{Patience, print_along_axes, print_blocks};
    use super::*;
    use crate::machine::{Section, Shape, Taken, Tool};
    use crate::voxel::Frame;
    use proptest::prelude::*;

    /// What is left of a block when voxels that the nozzle does not get at are left out one by one, in some order, by the
    /// shape of the nozzle alone.
    fn one_by_one(standing: &Standing, way: Way, mut block: BitGrid, backward: bool) -> BitGrid {
        let job = standing.job;
        let place = |v: [usize; 3]| {
            let p = job.frame.center(v);
            let height = way.direction.dot(p);
            (p - way.direction.vec() * height, height)
        };
        let meets = |v: [usize; 3], o: [usize; 3]| {
            let ((at, height), (by, over)) = (place(v), place(o));
            way.tool.sections.iter().any(|s| {
                let tip = s.shape.lower_surface(0.0) == 0.0;
                let dip = if tip { job.rules.nozzle_dip_mm } else { 0.0 };
                over - s.shape.lower_surface(at.distance(by)) - dip > height + 1e-4
            })
        };
        loop {
            let rest = standing.state.or(&standing.core.minus(&block));
            let mut all: Vec<[usize; 3]> = block.iter_ones().collect();
            if backward {
                all.reverse();
            }
            let out = all.into_iter().find(|v| rest.iter_ones().any(|o| meets(*v, o)));
            let Some(v) = out else { return block };
            block.set(v, false);
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn the_last_block_is_what_leaving_out_one_by_one_leaves(
            seed in any::<u64>(),
            axis in 0usize..5,
            backward in any::<bool>(),
        ) {
            let dims = [13, 12, 11];
            let frame = Frame { pitch: 0.3, dims, origin: DVec3::ZERO };
            let is_hit = |[x, y, z]: [usize; 3], one_in: u64| {
                let n = ((x * 31 + y) * 37 + z) as u64;
                (n ^ seed).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40 & 0xFF < 256 / one_in
            };
            let old = |v: [usize; 3]| v[2] < 3 || v[0] < 4 && is_hit(v, 9);
            let new = |v: [usize; 3]| !old(v) && v[2] < 9 && !is_hit([v[2], v[0], v[1]], 3);
            let target = BitGrid::from_fn(dims, |v| old(v) || new(v));
            let job = job_of(frame, BitGrid::from_fn(dims, old), target, |_| true);
            let core = BitGrid::from_fn(dims, new);
            let standing = Standing { job: &job, state: &job.initial, core: &core, left: &core };
            let direction = Setting::new(&job).axes(0)[axis];
            let tool = Tool::longest(&job.nozzles).unwrap();
            let way = Way { direction, holding: 0, tool };
            let table = CarrierTable::new(direction, job.rules.overhang_deg);
            let carried = supported(&table, &job.target, &core);
            let want = one_by_one(&standing, way, carried, backward);
            prop_assert_eq!(standing.last_block(way, &[], 0), want.clone());
            prop_assert!(standing.last_block(way, &[], want.count()).is_empty());
        }
    }

    /// A tall core that gets a coat on all sides, from the base up.
    #[test]
    fn a_coat_is_printed_nearly_whole() {
        let frame = Frame { pitch: 0.4, dims: [62, 62, 50], origin: DVec3::ZERO };
        let from_axis = |[x, y, _]: [usize; 3]| (x as f64 - 30.5).hypot(y as f64 - 30.5);
        let inner = |v: [usize; 3]| from_axis(v) < 18.0;
        let outer = |v: [usize; 3]| from_axis(v) < 27.0;
        let [initial, target] =
            [BitGrid::from_fn(frame.dims, inner), BitGrid::from_fn(frame.dims, outer)];
        let mut job = job_of(frame, initial, target, |t| t.taken <= Taken::LastResort);
        // Wider than the machine's own needle, whose films are skin on this grid: with that all orders lay everything.
        let part =
            |z0, r0, z1, r1| Section { shape: Shape::Frustum { z0, r0, z1, r1 }, active: false };
        job.nozzles.last_mut().unwrap().sections = vec![
            part(0.0, 0.3, 1.5, 0.7),
            part(1.5, 0.7, 15.0, 0.7),
            part(15.0, 0.7, 25.0, 4.5),
            part(25.0, 4.5, 60.0, 4.5),
            part(60.0, 25.0, 140.0, 25.0),
        ];
        let (setting, coarse) = (Setting::new(&job).with_last_resort(), Coarse::of(&job));
        let added = job.target.minus(&job.initial);
        let wanted = Wanted {
            state: &job.initial,
            added: &added,
            core: &added.minus(&setting.skin(&job.initial)),
            preferred: &[],
            samples: 60,
            patience: Patience::Endless,
        };
        let ctx = Ctx::quiet();
        let left = |p: &Printing| p.unreached.count_and(wanted.core);
        let greedy = left(&print_blocks(&setting, &coarse, &wanted, &[], &ctx).unwrap());
        let axes = left(&print_along_axes(&setting, &coarse, &wanted, &ctx).unwrap());
        let backward = print_backward(&setting, &coarse, &wanted, &ctx).unwrap().unwrap();
        assert!(2 * left(&backward) < greedy.min(axes), "{} {greedy} {axes}", left(&backward));
        let job = Job { target: job.initial.or(&added.minus(&backward.unreached)), ..job };
        assert_verifies(&job, backward.steps);
    }
}
