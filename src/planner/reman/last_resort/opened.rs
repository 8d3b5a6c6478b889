//! What no tool gets at beside that which is kept is opened before anything is printed.
//!
//! Method. (1) Over what a plan misses the longest nozzle is let down from straight above; what the stock keeps in its way, and
//! what is a voxel from it, is cut: what a plane would give up (W2V Sec. 4.2), but for all that is in nobody's way. Over stock
//! that no cutter gets at a cone is cut. (2) All of these pits are one cut of the stock; then all is printed as before, with
//! what they gave up, on supports that stand nowhere near stock that was left. In `pits` the cones go through what was printed
//! as well: where that stands on supports, it cannot be made again without them.
//!
//! Where so much stock stands that no plan is valid, cones as slim as a slim cutter go over all of it, the largest bodies first, and
//! what they open the way to is cut as well (`with_standing_opened`): planes would give up far more.
//!
//! Where all was cut before anything is printed this is done as long as it gives little up for what it gains; elsewhere where the pits may
//! leave nothing at all.
//!
//! Guarantees: those of cuts and deposits; of what is kept at most a share of the target is given up at a time, and taken is what
//! leaves less and ranks no lower or gives little up for it. Not guaranteed: that less is left, or that less could not be given up.

use super::*;
use crate::machine::Section;
use crate::planner::reman::pits::{cone, cut_with_skin, pit_over};
use crate::planner::reman::printed_first::on_coarse_grid;
use crate::planner::reman::round::{COMPLETION_SHARE, UnderPlanes};
use crate::region::Volumes;
use crate::voxel::{Connectivity, components};

/// How much wider pits get for each mm up, those that are made first, and those over what these leave, a round or two for
/// each: a needle nozzle widens by .36, one that leans to close a roof is in the way of all that stands steeper than it.
const OPENINGS: [f64; 2] = [0.6, 2.1];

/// So often what is missing then is opened as well, where all is printed on what was cut before: on a bracket the first time
/// left a fiftieth of it, and each after that half, which ceases to be worth it before long.
const MOST_OPENED: usize = 8;

/// What may be given up for a voxel less that is missing: what is still missing then is opened by pits through what was
/// printed, which on a bracket asked for a thousand each.
const MOST_GIVEN_UP: usize = 100;

/// How much wider pits over stock get for each mm up where there is much of it. On a bracket cones of .2, .36 and .6 all opened
/// everything, and gave up .21, .26 and .32 of it.
const SLIM_OPENING: f64 = 0.2;

/// Share of the target that may be given up to open stock, where else no plan is valid.
const MOST_OVER_STOCK: f64 = 0.5;

/// So often stock is opened and what that opens is cut: bodies of at least this share of what stands each time, for others may be
/// reached then. Half of the bracket's stock at a time, where that gave least up, gave up a little less in all (.17 and .24
/// of it instead of .21 and .26), but two thirds more of it was missing in the end.
const MOST_STOCK_OPENED: usize = 4;
const BODY_SHARE: f64 = 0.02;

/// What comes of an attempt that leaves so much stock that it is not valid when the stock is opened from above before anything is
/// printed; none where the coarse grid shows that this leaves more than the rules allow.
pub fn with_standing_opened(run: &mut Run, plain: &Attempt) -> Result<Option<Attempt>, PlanError> {
    let job = run.start.setting.job;
    let is_invalid = |a: &Attempt, job: &Job| a.standing(job, a.volumes.reused.count()).class == 2;
    let stands = plain.excess.count() > plain.deficit.count() && is_invalid(plain, job);
    if !stands || !run.options.supports || run.ctx.out_of_time() {
        return Ok(None);
    }
    let (options, ctx) = (run.options, run.ctx);
    let is_hopeful = on_coarse_grid(run.start, |look| {
        let plain = look.attempt(plain.clips.clone(), options, ctx)?;
        let opened = look.printed_on_opened(&plain, options, ctx)?;
        let Some((made, _, _)) = opened else { return Ok(false) };
        made.tell("stock opened, on the coarse grid", 0);
        Ok(!is_invalid(&made, look.setting.job))
    })?;
    run.clock.lap("blocks");
    if !is_hopeful {
        return Ok(None);
    }
    let setting = run.start.setting.with_last_resort();
    let start = run.start.in_setting(&setting);
    let Some((made, under, grounds)) = start.printed_on_opened(plain, options, ctx)? else {
        return Ok(None);
    };
    made.tell("stock opened", 0);
    let made = closely_cut(run, &under, made)?;
    if !made.comes_before(plain, job) {
        return Ok(None);
    }
    opened_first(run, under, grounds, made).map(Some)
}

/// The best of an attempt on supports and of those that have the stock opened over what it leaves.
pub(super) fn opened_first(
    run: &mut Run,
    mut under: UnderPlanes,
    mut grounds: Grounds,
    mut best: Attempt,
) -> Result<Attempt, PlanError> {
    let setting = run.start.setting.with_last_resort();
    let start = run.start.in_setting(&setting);
    let job = setting.job;
    let mut now = best.clone();
    for (round, opening) in OPENINGS.into_iter().enumerate() {
        let is_little = now.left() as f64 <= MOST_AHEAD * job.target.count() as f64;
        if now.left() == 0 || !is_little || run.ctx.out_of_time() {
            break;
        }
        let Some(pit) = start.over_all(&under, &grounds.stock, &now, opening) else { break };
        let (parts, most) = ((&under, &grounds.stock), most_to_complete(job));
        let Some((opened, stock)) = start.cut_open(parts, (&pit, most), run.ctx)? else { break };
        let near = distance_within(&now.excess, NEAR_STUCK).minus(&job.target);
        grounds.care.avoided.union_with(&near);
        // Printed ahead, what pits open is in the way of what lies beside it.
        let opened_up = distance_within(&now.deficit, 2.0 * AHEAD_MM / job.frame.pitch);
        grounds.care.ahead.subtract(&opened_up);
        let how = (run.options, run.ctx);
        let with = (run.options.supports, &mut grounds.care);
        let Some(made) = rounds(&start, (&opened, &stock), with, None, how)? else { break };
        let made = closely_cut(run, &opened, made)?;
        made.tell("opened first", round);
        let is_less = made.left() < now.left();
        if is_better(&made, &best, job) {
            best = made.clone();
        }
        if !is_less {
            break;
        }
        (under, grounds.stock, now) = (opened, stock, made);
    }
    run.clock.lap("blocks");
    Ok(best)
}

/// What comes of an attempt that cut first and then printed on supports when the stock is opened over what it misses, and
/// again over what it then misses, as long as that gives little up.
pub fn with_missing_opened(run: &mut Run, mut best: Attempt) -> Result<Attempt, PlanError> {
    let setting = run.start.setting.with_last_resort();
    let start = run.start.in_setting(&setting);
    let job = setting.job;
    for round in 0..MOST_OPENED {
        if best.deficit.is_empty() || run.ctx.out_of_time() {
            break;
        }
        let (under, stock) = (UnderPlanes::of_attempt(&best), finished_stock(&best));
        let Some(pit) = start.over_missing(&stock, &best.deficit) else { break };
        let most = most_to_complete(job);
        let Some((under, stock)) = start.cut_open((&under, &stock), (&pit, most), run.ctx)? else {
            break;
        };
        let care = Care::none(job);
        let with = (Some(care.of_supports()), Patience::Endless);
        let before = best.cuts_after();
        let opened = start.finished(&under, &stock, with, &before, run.options, run.ctx)?;
        let Some(opened) = opened else { break };
        let opened = closely_cut(run, &under, opened)?;
        opened.tell("missing opened first", round);
        let fewer = best.left().saturating_sub(opened.left());
        let given_up = best.volumes.reused.count().saturating_sub(opened.volumes.reused.count());
        if fewer == 0 || given_up > MOST_GIVEN_UP * fewer {
            break;
        }
        best = opened;
    }
    run.clock.lap("blocks");
    Ok(best)
}

/// How many voxels may be given up at a time to leave nothing.
fn most_to_complete(job: &Job) -> usize {
    (COMPLETION_SHARE * job.target.count() as f64) as usize
}

impl Start<'_> {
    /// What is printed on supports on the stock of an attempt when that is opened over what stands, and what it began with.
    fn printed_on_opened(
        &self,
        plain: &Attempt,
        options: &Options,
        ctx: &Ctx,
    ) -> Result<Option<(Attempt, UnderPlanes, Grounds)>, PlanError> {
        let job = self.setting.job;
        let (under, stock) = (UnderPlanes::of_attempt(plain), finished_stock(plain));
        let opened = self.opened_over(under, stock, plain.excess.clone(), options, ctx)?;
        let Some((under, stock)) = opened else { return Ok(None) };
        let mut care = Care::none(job);
        let made = rounds(self, (&under, &stock), (true, &mut care), None, (options, ctx))?;
        Ok(made.map(|made| (made, under, Grounds { stock, care })))
    }

    /// A stock opened over what stands in it, and what that opens cut, the largest bodies first; none where that would give up
    /// too much.
    fn opened_over(
        &self,
        mut under: UnderPlanes,
        mut stock: Stock,
        mut standing: BitGrid,
        options: &Options,
        ctx: &Ctx,
    ) -> Result<Option<(UnderPlanes, Stock)>, PlanError> {
        let (setting, job) = (self.setting, self.setting.job);
        let Some(nozzle) = setting.nozzles().last() else { return Ok(None) };
        let foot = nozzle.tip_radius() + job.frame.pitch / 2.0;
        let mut most = (MOST_OVER_STOCK * job.target.count() as f64) as usize;
        for round in 0..MOST_STOCK_OPENED {
            let bodies = components(&standing, Connectivity::Corner26);
            let least = BODY_SHARE * standing.count() as f64;
            let sizes = bodies.sizes();
            let mut pit = BitGrid::new(job.frame.dims);
            for label in (0..sizes.len()).filter(|l| sizes[*l] as f64 >= least) {
                let body: Vec<[usize; 3]> = bodies.grid_of(label as u32).iter_ones().collect();
                let over = (&stock.state, &job.frame);
                pit.union_with(&pit_over(over, &body, Direction::Z, cone(foot, SLIM_OPENING)));
            }
            if pit.count_and(&under.volumes.reused) == 0 {
                break;
            }
            let Some(opened) = self.cut_open((&under, &stock), (&pit, most), ctx)? else {
                return Ok(None);
            };
            let kept = under.volumes.reused.count();
            (under, stock) = opened;
            most -= kept.saturating_sub(under.volumes.reused.count()).min(most);
            let reused = &under.volumes.reused;
            let next_job = Job { initial: stock.state.clone(), ..job.clone() };
            let next = setting.of_next_round(&next_job, setting.old_of(reused));
            let removable = stock.state.minus(&job.target);
            let deep = removable.minus(&setting.skin(reused));
            let samples = options.directions;
            let cuts =
                Cuts { removable: &removable, deep: &deep, samples, before: &[], patient: true };
            let cutting = cut_blocks(&next, self.coarse, &cuts, ctx)?;
            let cuts = followed(stock.cuts, cutting.steps);
            stock = Stock { cuts, state: cutting.state };
            standing = cutting.unreached;
            tracing::debug!(round, standing = standing.count(), "stock opened");
            if standing.is_empty() || ctx.out_of_time() {
                break;
            }
        }
        Ok(Some((under, stock)))
    }

    /// Pits over all that a plan leaves; none where nothing that is kept is in the way of some of it. What is missing
    /// under that which is printed is no less so with pits, and only what leaves nothing is worth them.
    fn over_all(
        &self,
        under: &UnderPlanes,
        stock: &Stock,
        made: &Attempt,
        opening: f64,
    ) -> Option<BitGrid> {
        let (state, frame) = (&stock.state, &self.setting.job.frame);
        let nozzle = self.setting.nozzles().last()?;
        let wide = cone(nozzle.tip_radius() + frame.pitch / 2.0, opening);
        let mut pit = BitGrid::new(state.dims());
        let mut over = |left: &BitGrid, of: &dyn Fn(&BitGrid) -> Option<BitGrid>| {
            let bodies = components(left, Connectivity::Corner26);
            (0..bodies.count()).try_for_each(|label| {
                let of_body = of(&bodies.grid_of(label as u32))?;
                let in_the_way = of_body.count_and(&under.volumes.reused);
                pit.union_with(&of_body);
                (in_the_way > 0).then_some(())
            })
        };
        over(&made.excess, &|body| {
            let voxels: Vec<[usize; 3]> = body.iter_ones().collect();
            Some(pit_over((state, frame), &voxels, Direction::Z, &wide))
        })?;
        over(&made.deficit, &|body| self.over_missing(stock, body))?;
        Some(pit)
    }

    /// What of the stock the longest nozzle meets, and what is a voxel from it, when it comes straight down on what is missing.
    fn over_missing(&self, stock: &Stock, missing: &BitGrid) -> Option<BitGrid> {
        let frame = &self.setting.job.frame;
        let nozzle = self.setting.nozzles().last()?;
        let lower = |aside: f64| {
            let of = |s: &Section| s.shape.lower_surface((aside - frame.pitch).max(0.0));
            nozzle.sections.iter().map(of).fold(f64::INFINITY, f64::min)
        };
        let voxels: Vec<[usize; 3]> = missing.iter_ones().collect();
        Some(pit_over((&stock.state, frame), &voxels, Direction::Z, lower))
    }

    /// The stock with a pit in it, and the volumes then; none where that gives nothing up, or too much.
    fn cut_open(
        &self,
        (under, stock): (&UnderPlanes, &Stock),
        (pit, most): (&BitGrid, usize),
        ctx: &Ctx,
    ) -> Result<Option<(UnderPlanes, Stock)>, PlanError> {
        let (setting, job) = (self.setting, self.setting.job);
        let (state, kept) = (&stock.state, &under.volumes.reused);
        let given_up = pit.count_and(kept);
        tracing::debug!(pit = pit.count(), given_up, most, "to be opened");
        if !(1..=most).contains(&given_up) {
            return Ok(None);
        }
        let next_job = Job { initial: state.clone(), ..job.clone() };
        let next = setting.of_next_round(&next_job, setting.old_of(kept));
        let excess = setting.beyond_skin(&state.minus(&job.target), kept);
        let what = (pit, (kept, &excess));
        let cutting = cut_with_skin(&next, self.coarse, what, (Direction::Z, 0), ctx)?;
        let cut = state.minus(&cutting.state);
        if cut.count_and(kept) == 0 {
            return Ok(None);
        }
        let volumes = Volumes {
            reused: kept.minus(&cut),
            removed: under.volumes.removed.or(&cut),
            added: under.volumes.added.or(&cut.and(&job.target)),
        };
        let cuts = followed(stock.cuts.clone(), cutting.steps);
        let opened = UnderPlanes { clips: under.clips.clone(), volumes };
        Ok(Some((opened, Stock { cuts, state: cutting.state })))
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::local_tests::{assert_verifies, job_of, with_run};
    use super::super::super::round::{Mending, attempt};
    use super::*;
    use crate::base::DVec3;
    use crate::plan::{Plan, end_state};
    use crate::voxel::Frame;

    const DIMS: [usize; 3] = [70, 60, 40];

    fn within([x, y, z]: [usize; 3], least: [usize; 3], end: [usize; 3]) -> bool {
        let is_in = |v: usize, a: usize| (least[a]..end[a]).contains(&v);
        is_in(x, 0) && is_in(y, 1) && is_in(z, 2)
    }

    /// A block that gets a cap, and a cavity under its top that nothing gets into.
    fn job() -> Job {
        let frame = Frame { pitch: 0.5, dims: DIMS, origin: DVec3::ZERO };
        let block = |v| within(v, [3, 3, 0], [67, 57, 30]);
        let cavity = |v| within(v, [40, 25, 22], [50, 35, 27]);
        let cap = |v| within(v, [8, 8, 30], [24, 50, 36]);
        let initial = BitGrid::from_fn(DIMS, block);
        let target = BitGrid::from_fn(DIMS, |v| block(v) && !cavity(v) || cap(v));
        job_of(frame, initial, target, |_| true)
    }

    /// With nothing given up, as a plan that ends so.
    fn plain(run: &Run) -> Attempt {
        let how = (run.options, Mending::None);
        let (start, ctx) = (run.start, run.ctx);
        attempt(start.setting, start.coarse, Vec::new(), &start.preferred, how, ctx).unwrap()
    }

    #[test]
    fn stock_that_nothing_gets_at_is_opened_before_anything_is_printed() {
        let job = job();
        let (without, made) = with_run(&job, |run| {
            let without = plain(run);
            let made = last_resort(run, without.clone(), None).unwrap();
            (without, made)
        });
        assert!(without.excess.count() > 10, "{}", without.excess.count());
        assert_eq!(made.left(), 0, "{} {}", made.excess.count(), made.deficit.count());
        let lost = without.volumes.reused.count() - made.volumes.reused.count();
        assert!((100..1500).contains(&lost), "{lost}");
        let plan = Plan { holdings: Vec::new(), steps: made.steps.clone() };
        assert_eq!(end_state(&job, &plan).reused, made.volumes.reused);
        assert_verifies(&job, made.steps);
    }

    /// A block with hollows that nothing gets into, as long as that is opened.
    fn hollow(is_hollow: impl Fn([usize; 3]) -> bool + Sync) -> Job {
        let frame = Frame { pitch: 0.5, dims: DIMS, origin: DVec3::ZERO };
        let block = |v| within(v, [3, 3, 0], [67, 57, 30]);
        let initial = BitGrid::from_fn(DIMS, block);
        let target = BitGrid::from_fn(DIMS, |v| block(v) && !is_hollow(v));
        job_of(frame, initial, target, |_| true)
    }

    /// Planes gave up two thirds of a bracket with much stock between its struts, and no plan was complete.
    #[test]
    fn much_stock_that_nothing_gets_at_is_opened_by_slim_cones() {
        let job =
            hollow(|v| [10, 30, 50].iter().any(|x| within(v, [*x, 25, 17], [x + 10, 35, 27])));
        let (before, made) = with_run(&job, |run| {
            let before = plain(run);
            let made = with_standing_opened(run, &before).unwrap().expect("it can be opened");
            (before, made)
        });
        assert!(
            !before.is_valid(&job) && before.excess.count() > 1000,
            "{}",
            before.excess.count()
        );
        assert_eq!(made.left(), 0, "{} {}", made.excess.count(), made.deficit.count());
        let lost = before.volumes.reused.count() - made.volumes.reused.count();
        assert!(lost > 300 && (lost as f64) < 0.05 * job.target.count() as f64, "{lost}");
        let plan = Plan { holdings: Vec::new(), steps: made.steps.clone() };
        assert_eq!(end_state(&job, &plan).reused, made.volumes.reused);
        assert_verifies(&job, made.steps);
    }

    #[test]
    fn stock_is_not_opened_where_that_would_give_up_most_of_the_part() {
        let job = hollow(|v| within(v, [8, 8, 2], [62, 52, 10]));
        let found = with_run(&job, |run| {
            let before = plain(run);
            assert!(before.excess.count() > 5000);
            with_standing_opened(run, &before).unwrap().is_some()
        });
        assert!(!found);
    }

    /// Held against the definition, over a few voxels beside the block.
    #[test]
    fn what_a_nozzle_meets_straight_down_is_cut() {
        let job = job();
        let beside = [[1, 20, 2], [1, 21, 2], [30, 58, 9]];
        let (pit, nozzle) = with_run(&job, |run| {
            let stock = Stock { cuts: Vec::new(), state: job.initial.clone() };
            let mut missing = BitGrid::new(DIMS);
            beside.iter().for_each(|v| missing.set(*v, true));
            let pit = run.start.over_missing(&stock, &missing).unwrap();
            (pit, run.start.setting.nozzles().last().unwrap().clone())
        });
        let lower = |aside: f64| {
            let of = nozzle.sections.iter().map(|s| s.shape.lower_surface(aside.max(0.0)));
            of.fold(f64::INFINITY, f64::min)
        };
        let want = BitGrid::from_fn(DIMS, |v| {
            let at = job.frame.center(v);
            let meets = |tip: [usize; 3]| {
                let from = at - job.frame.center(tip);
                from.z > lower(from.truncate().length() - job.frame.pitch) - job.frame.pitch / 4.0
            };
            job.initial.get(v) && beside.into_iter().any(meets)
        });
        assert_eq!(pit, want);
        assert!(pit.count() > 50, "{}", pit.count());
    }

    /// A wall so tall that the nozzle's head meets its top while the tip is a little beside its foot: the row there was missing.
    #[test]
    fn a_row_at_the_foot_of_a_tall_wall_is_printed_after_the_wall_s_top_is_cut() {
        const DIMS: [usize; 3] = [60, 40, 64];
        let frame = Frame { pitch: 0.5, dims: DIMS, origin: DVec3::ZERO };
        let wall = |v| within(v, [10, 6, 0], [16, 34, 54]);
        let foot = |v| within(v, [16, 6, 0], [30, 34, 3]);
        let initial = BitGrid::from_fn(DIMS, wall);
        let target = BitGrid::from_fn(DIMS, |v| wall(v) || foot(v));
        let job = job_of(frame, initial, target, |_| true);
        let (before, made) = with_run(&job, |run| {
            let setting = run.start.setting.with_last_resort();
            let start = run.start.in_setting(&setting);
            let before =
                cut_first(&start, &UnderPlanes::of(&job, Vec::new()), run.options, run.ctx)
                    .unwrap();
            let made = with_missing_opened(run, before.clone()).unwrap();
            (before, made)
        });
        assert!(before.deficit.count() > 0);
        assert_eq!(made.left(), 0, "{} of {}", made.left(), before.left());
        let lost = before.volumes.reused.count() - made.volumes.reused.count();
        assert!(lost > 0 && lost < 10 * before.deficit.count(), "{lost}");
        assert_verifies(&job, made.steps);
    }
}
