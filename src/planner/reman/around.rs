//! Blocks all around a part that stands on the base, in an order found from its end.
//!
//! What blocks leave at their seams is films: beside a wall along its axis a nozzle's tip keeps its radius off. A seam
//! across the axis of the later block leaves none. So of two opposite directions only what lies beyond planes across them is
//! laid, last of all, and what is between them before it, along the other two: its blocks end at those planes. On the base
//! no nozzle lies level, and none stands upright beside a tall part: there the first layer goes along leaning directions.
//!
//! Method. (1) The first layer on the base is laid along directions that lean as far as the overhang angle lets it grow
//! sideways out of what stands; a layer that thin is in nobody's way. (2) From the end, as in `backward`: the last blocks are
//! those beyond the planes, then those between them, then ever the largest that a leaning direction or an axis could have
//! laid last. Each is cut down to what it lays indeed on all that comes before it. (3) Forward, each as it was found. Skin
//! may be laid early and be in a later block's way; what is, of what that block missed, is left out, and all is laid anew.
//!
//! Guarantees: those of blocks (`laying`). Not guaranteed: that nothing is left.

use super::backward::Standing;
use super::coarse::Coarse;
use super::laying::{Layer, Way, base_layer, ways_along};
use super::printing::{Printing, Wanted, print_closely, print_each};
use super::setting::Setting;
use crate::base::{Cancelled, Ctx, DVec3, Direction};
use crate::plan::Job;
use crate::region::above;
use crate::voxel::{BitGrid, distance_within};

/// How much less than the overhang angle leaning directions rise over the base, degrees: a voxel's neighbours lie in few
/// directions, and hardly any lies in the one along which the layer grows.
const SPARE_DEG: f64 = 2.5;

/// Leaning directions all around: one every ten degrees.
const LEANING: usize = 36;

/// Share of the extent of what is printed that lies between the planes. Found on ribs around a round core: from a third to
/// nearly three fifths of it leaves as little.
const MIDDLE: f64 = 0.5;

/// The share of the core that the blocks from the four sides leave at most: a foot, not half a part.
const MOST_FOOT: f64 = 0.1;

/// Blocks that are looked for before those from the sides: more are no plan that anybody wants.
const MOST_OTHERS: usize = 12;

/// How often all is laid anew without skin that was in the way.
const MOST_ANEW: usize = 3;

/// Of so many missed voxels, with those that may have carried them, it is asked what is in their way: every one of them is
/// held against all skin around, and of more it is not skin that is in the way.
const MOST_MISSED: usize = 2000;

/// How far from what a block missed the rest of it that it missed as well may have carried that, in voxels.
const CARRIED_BY: f64 = 4.0;

/// Blocks in the order in which they are laid.
type Order<'a> = Vec<(Way<'a>, BitGrid)>;

/// Prints all around; none where the machine cannot point to all four sides or too much is not laid from these.
pub fn print_around(
    setting: &Setting,
    coarse: &Coarse,
    wanted: &Wanted,
    ctx: &Ctx,
) -> Result<Option<Printing>, Cancelled> {
    let Some(tool) = setting.nozzles().last() else { return Ok(None) };
    let sides = [[Direction::X, Direction::NEG_X], [Direction::Y, Direction::NEG_Y]];
    let [xs, ys] = sides.map(|d| ways_along(setting, &d, tool));
    if xs.len() < 2 || ys.len() < 2 {
        return Ok(None);
    }
    let mut ways = ways_along(setting, &leaning(setting.job.rules.overhang_deg), tool);
    ways.extend(ways_along(setting, &setting.axes(0), tool));
    let base = base_layer(&setting.job.frame);
    let first =
        BitGrid::from_fn(wanted.added.dims(), |v| Some(v[2]) == base && wanted.added.get(v));
    let foot = print_closely(setting, coarse, wanted, (&first, &ways), ctx)?;
    let left = |p: &Printing| p.unreached.count_and(wanted.core);
    let mut best: Option<Printing> = None;
    for (outer, inner) in [(&ys, &xs), (&xs, &ys)] {
        let Some(order) = order(setting, wanted, &foot, (outer, inner, &ways), ctx)? else {
            continue;
        };
        let printing = laid_in(setting, coarse, wanted, (&foot, order), ctx)?;
        let now = left(&printing);
        if best.as_ref().is_none_or(|b| now < left(b)) {
            best = Some(printing);
        }
        if now == 0 {
            break;
        }
    }
    Ok(best)
}

/// Directions all around that rise a little less over the base than the overhang angle.
pub fn leaning(overhang_deg: f64) -> Vec<Direction> {
    let (rise, aside) = (overhang_deg - SPARE_DEG).to_radians().sin_cos();
    let around = (0..LEANING).map(|k| std::f64::consts::TAU * k as f64 / LEANING as f64);
    let along = |a: f64| DVec3::new(aside * a.cos(), aside * a.sin(), rise);
    around.filter_map(|a| Direction::new(along(a)).ok()).collect()
}

/// The blocks after the first layer, in the order in which they are laid; none where too much is not laid from the sides.
fn order<'a>(
    setting: &Setting<'a>,
    wanted: &Wanted,
    foot: &Printing,
    (outer, inner, others): (&[Way<'a>], &[Way<'a>], &[Way<'a>]),
    ctx: &Ctx,
) -> Result<Option<Order<'a>>, Cancelled> {
    let job = setting.job;
    let fixed: Vec<Vec<DVec3>> =
        (0..setting.holdings.len()).map(|h| setting.fixed(h, wanted.state)).collect();
    let mut core = wanted.core.minus(&foot.state);
    let mut left = wanted.added.minus(&foot.state);
    let all = core.count();
    let mut order: Order = Vec::new();
    let mut settle = |core: &mut BitGrid, left: &mut BitGrid, way: Way<'a>, block: &BitGrid| {
        let standing = Standing { job, state: &foot.state, core, left };
        let block = laid_last(&standing, way, &fixed, block);
        let gain = block.count_and(core);
        core.subtract(&block);
        left.subtract(&block);
        tracing::debug!(direction = ?way.direction, gain, left = core.count(), "around");
        order.push((way, block));
        gain
    };
    for way in outer.iter().chain(inner) {
        ctx.check()?;
        let standing = Standing { job, state: &foot.state, core: &core, left: &left };
        let mut block = standing.last_block(*way, &fixed[way.holding], 0);
        if outer.iter().any(|o| o.direction == way.direction) {
            let over = plane(wanted.core, job, way.direction);
            block = above(&block, &job.frame, way.direction.vec(), over);
        }
        settle(&mut core, &mut left, *way, &block);
    }
    if core.count() as f64 > MOST_FOOT * all as f64 {
        return Ok(None);
    }
    for _ in 0..MOST_OTHERS {
        let standing = Standing { job, state: &foot.state, core: &core, left: &left };
        let Some((_, way, block)) = standing.largest(others, &fixed, ctx)? else { break };
        if settle(&mut core, &mut left, way, &block) == 0 {
            break;
        }
    }
    order.reverse();
    Ok(Some(order))
}

/// Where the middle of some voxels ends along a direction, mm.
fn plane(of: &BitGrid, job: &Job, direction: Direction) -> f64 {
    let heights = of.iter_ones().map(|v| direction.dot(job.frame.center(v)));
    let (lo, hi) =
        heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), z| (lo.min(z), hi.max(z)));
    lo + (hi - lo) * (1.0 + MIDDLE) / 2.0
}

/// What of a block, and of the skin beside it, is laid on all else that stands: what lacks its carriers comes before it.
fn laid_last(standing: &Standing, way: Way, fixed: &[Vec<DVec3>], block: &BitGrid) -> BitGrid {
    let &Standing { job, state, core, left } = standing;
    let near = job.rules.tolerance_mm / job.frame.pitch;
    let mut block = block.or(&left.minus(core).and(&distance_within(block, near)));
    loop {
        let before = block.count();
        let state = state.or(&core.minus(&block));
        let layer = Layer { job, state: &state, left: &block, core, fixed, closely: true };
        block = layer.lay(way).region;
        if block.count() == before {
            return block;
        }
    }
}

/// Lays blocks in their order, and again without skin that was in the way of what was missed.
fn laid_in(
    setting: &Setting,
    coarse: &Coarse,
    wanted: &Wanted,
    (foot, mut order): (&Printing, Order),
    ctx: &Ctx,
) -> Result<Printing, Cancelled> {
    let left = |p: &Printing| p.unreached.and(wanted.core);
    let mut best = print_each(setting, coarse, wanted, (foot, &order), ctx)?;
    for _ in 0..MOST_ANEW {
        let missed = left(&best);
        if missed.is_empty() {
            break;
        }
        let beside = best.unreached.and(&distance_within(&missed, CARRIED_BY));
        if beside.count() > MOST_MISSED {
            break;
        }
        ctx.check()?;
        leave_out_skin(setting.job, wanted, &beside, &mut order);
        let other = print_each(setting, coarse, wanted, (foot, &order), ctx)?;
        tracing::debug!(before = missed.count(), after = left(&other).count(), "around anew");
        if left(&other).count() >= missed.count() {
            break;
        }
        best = other;
    }
    Ok(best)
}

/// Takes that skin out of blocks which is in the way of what later blocks missed.
fn leave_out_skin(job: &Job, wanted: &Wanted, missed: &BitGrid, order: &mut Order) {
    let widest = order
        .iter()
        .flat_map(|(way, _)| &way.tool.sections)
        .filter(|s| s.shape.lower_surface(0.0) <= job.rules.tolerance_mm);
    let reach = widest.map(|s| s.shape.max_radius()).fold(0.0, f64::max) + job.rules.tolerance_mm;
    let near = distance_within(missed, reach / job.frame.pitch);
    let skin: Vec<[usize; 3]> = wanted.added.minus(wanted.core).and(&near).iter_ones().collect();
    let mut later: Vec<(Way, [usize; 3])> = Vec::new();
    for (way, region) in order.iter_mut().rev() {
        for o in &skin {
            if region.get(*o) && later.iter().any(|(way, v)| is_in_the_way(job, way, *v, *o)) {
                region.set(*o, false);
            }
        }
        later.extend(missed.and(region).iter_ones().map(|v| (*way, v)));
    }
}

/// Whether a voxel that stands is in the nozzle's way at another, or less than a voxel off it: so far maps may err.
fn is_in_the_way(job: &Job, way: &Way, at: [usize; 3], standing: [usize; 3]) -> bool {
    let offset = job.frame.center(standing) - job.frame.center(at);
    let rise = way.direction.dot(offset);
    let slack = job.frame.pitch;
    let aside = ((offset - way.direction.vec() * rise).length() - slack).max(0.0);
    way.tool.sections.iter().any(|s| {
        let dip = if s.shape.lower_surface(0.0) == 0.0 { job.rules.nozzle_dip_mm } else { 0.0 };
        rise + slack > s.shape.lower_surface(aside) + dip
    })
}

#[cfg(test)]
mod tests {
    use super::super::backward::print_backward;
    use super::super::local_tests::{assert_verifies, job_of};
    use super::super::printing::Patience;
    use super::*;
    use crate::machine::Taken;
    use crate::voxel::Frame;

    /// Three ribs that wind up a tall core which stands on the base.
    fn ribbed() -> Job {
        let frame = Frame { pitch: 0.4, dims: [74, 74, 76], origin: DVec3::new(-14.8, -14.8, 0.0) };
        let inner = |v: [usize; 3]| frame.center(v).truncate().length() < 10.0;
        let rib = |v: [usize; 3]| {
            let p = frame.center(v);
            let turned = p.y.atan2(p.x) - p.z / 40.0 * std::f64::consts::TAU;
            p.truncate().length() < 14.0 && (3.0 * turned).cos() > 0.0
        };
        let initial = BitGrid::from_fn(frame.dims, inner);
        let target = BitGrid::from_fn(frame.dims, |v| inner(v) || rib(v));
        job_of(frame, initial, target, |t| t.taken <= Taken::LastResort)
    }

    #[test]
    fn ribs_around_a_tall_core_are_printed_whole() {
        let job = ribbed();
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
        let backward = print_backward(&setting, &coarse, &wanted, &ctx).unwrap();
        let around = print_around(&setting, &coarse, &wanted, &ctx).unwrap().unwrap();
        let before = backward.as_ref().map_or(wanted.core.count(), left);
        assert!(before > 100, "{before}");
        assert_eq!(left(&around), 0, "{before} by the other order");
        let job = Job { target: job.initial.or(&added.minus(&around.unreached)), ..job };
        assert_verifies(&job, around.steps);
    }

    #[test]
    fn only_what_is_beside_or_over_the_tip_is_in_the_way() {
        let job = ribbed();
        let tool = job.nozzles.last().unwrap();
        let way = Way { direction: Direction::NEG_Y, holding: 0, tool };
        let meets = |o: [usize; 3]| is_in_the_way(&job, &way, [37, 20, 40], o);
        // Along -y the nozzle comes from there.
        assert!(meets([37, 10, 40]) && meets([38, 10, 41]));
        assert!(!meets([37, 24, 40]) && !meets([37, 10, 50]) && !meets([44, 18, 40]));
    }
}
