//! What a plan gives up and need not.
//!
//! Method. Planes give up all that lies over them. Where the plan that won gives up much, nothing is given up at
//! first: of a worn part, of which little is to be cut, all is printed on the part as it is (`printed_first`); of others all
//! that is to go is cut, and the rest printed on supports (`cut_first`) or, where that leaves too much, in any order
//! without. The coarse grid tells first whether either leaves no more than the rules allow. What is then missing is
//! opened by pits (`pits`), which may give up as much as the plan that won if that one leaves nothing.
//!
//! Where the first planes give up much of a part that is not worn, this is looked at before any plan under planes: if
//! it leaves nothing and gives up half of that at most, it is the plan. What was found is not looked for again. With a time
//! limit planes come first.
//!
//! Guarantees: those of cuts and deposits; the plan that won stays where this one ranks no higher. Not guaranteed: that
//! what can be kept is found, or found in few blocks and holdings.

use super::fewest::with_fewest_cuts;
use super::last_resort::{FEW_BELOW, closely_cut, cut_first, with_missing_opened};
use super::locals::is_complete;
use super::pits::with_pits;
use super::printed_first::{on_coarse_grid, printed_first};
use super::round::{Attempt, Mending, UnderPlanes, attempt_under};
use super::{Options, Run, Start};
use crate::base::Ctx;
use crate::planner::PlanError;

/// Share of the target that a plan gives up for another to be looked for that keeps it.
pub const KEEPING_SHARE: f64 = 0.05;

/// The same for parts that are not worn, where looking takes as long as the plan did: a bearing that gives up 0.07 was
/// looked at in vain, for half as long again.
const KEEPING_SHARE_OF_OTHERS: f64 = 0.1;

/// Share of the target that is to be cut from a worn part at most. Of others much more has to go, and
/// printing before it went left something on each of four tried.
const WORN_SHARE: f64 = 0.05;

/// Share of what the first planes give up that a plan which gives nothing up at first may give up in pits to be
/// the plan without another look: planes that are moved, and local ones, keep more than the first.
const PLAIN_SHARE: f64 = 0.5;

/// Whether the part is worn, and whether so many voxels of what is reused leave enough for another plan to be worth
/// a look.
fn is_worth_a_look(run: &Run, reused: usize) -> (bool, bool) {
    let job = run.start.setting.job;
    let target = job.target.count() as f64;
    let given_up = job.ideal_reuse().count().saturating_sub(reused) as f64;
    let is_worn = job.initial.minus(&job.target).count() as f64 <= WORN_SHARE * target;
    let share = if is_worn { KEEPING_SHARE } else { KEEPING_SHARE_OF_OTHERS };
    (is_worn, given_up > share * target && run.options.supports && !run.ctx.out_of_time())
}

/// A plan that keeps so much more than the first planes do, and leaves nothing, that no plan under planes is looked
/// for; of parts that are not worn.
pub fn kept_at_first(run: &mut Run, under_planes: usize) -> Result<Option<Attempt>, PlanError> {
    let (is_worn, is_worth_it) = is_worth_a_look(run, under_planes);
    // With little time a plan under planes is there sooner, and nothing is lost where it ends.
    if is_worn || !is_worth_it || run.ctx.is_limited() {
        return Ok(None);
    }
    let job = run.start.setting.job;
    let made = all_kept(run)?;
    run.all_kept = Some(made.clone());
    // Of what stands, pits take nothing.
    let may_be_complete = |m: &Attempt| m.may_be_valid(job) && m.excess.count() <= FEW_BELOW;
    let Some(made) = made.filter(may_be_complete) else { return Ok(None) };
    let notes = run.report.notes.clone();
    let made = opened(run, made, Some(under_planes))?;
    let gives_up = |reused: usize| job.ideal_reuse().count().saturating_sub(reused) as f64;
    let keeps_enough =
        gives_up(made.volumes.reused.count()) <= PLAIN_SHARE * gives_up(under_planes);
    if made.left() == 0 && keeps_enough {
        let made = with_fewest_cuts(run, made)?;
        run.clock.lap("blocks");
        return Ok(Some(made));
    }
    let told = std::mem::replace(&mut run.report.notes, notes);
    run.all_opened = (made.left() == 0).then_some((made, told));
    Ok(None)
}

/// A plan that keeps more than one that gives up much, and ranks higher.
pub fn keeping_more(run: &mut Run, best: &Attempt) -> Result<Option<Attempt>, PlanError> {
    let job = run.start.setting.job;
    let (is_worn, is_worth_it) = is_worth_a_look(run, best.volumes.reused.count());
    let has_a_way = !is_worn || is_complete(best, job);
    if !is_worth_it || !has_a_way {
        return Ok(None);
    }
    let made = match run.all_kept.take() {
        Some(made) => made,
        None if is_worn => printed_first(run)?,
        None => all_kept(run)?,
    };
    let may_rank_higher =
        |m: &Attempt| m.may_be_valid(job) && (best.left() > 0 || m.excess.count() <= FEW_BELOW);
    let Some(made) = made.filter(may_rank_higher) else { return Ok(None) };
    let notes = std::mem::take(&mut run.report.notes);
    let rival = is_complete(best, job).then(|| best.volumes.reused.count());
    // Pits that gave up less than all the rival does are those that would be found for it.
    let known = run.all_opened.take();
    let made = match known.filter(|(m, _)| rival.is_none_or(|r| m.volumes.reused.count() >= r)) {
        Some((made, told)) => {
            run.report.notes = told;
            made
        }
        None => opened(run, made, rival)?,
    };
    // Here what stands in pockets that are open only below counts as well: giving more up may leave none.
    if !made.comes_before(best, job) {
        run.report.notes = notes;
        return Ok(None);
    }
    // The notes so far told of planes and pits of the plan that gives way.
    let made = with_fewest_cuts(run, made)?;
    run.clock.lap("blocks");
    Ok(Some(made))
}

/// An attempt that gives nothing up, and the pits that open what it misses, giving up no more than `rival` keeps.
pub fn opened(run: &mut Run, made: Attempt, rival: Option<usize>) -> Result<Attempt, PlanError> {
    let made = with_pits(run, made, rival)?;
    let made = closely_cut(run, &UnderPlanes::of_attempt(&made), made)?;
    made.tell("keeping more", 0);
    Ok(made)
}

/// What comes of cutting first, nothing given up, with deposits on supports or, where that leaves too much, in any
/// order without; none where the coarse grid shows that either leaves more than the rules allow.
fn all_kept(run: &mut Run) -> Result<Option<Attempt>, PlanError> {
    let (start, options, ctx) = (run.start, run.options, run.ctx);
    let printing = on_coarse_grid(start, |start| {
        for printing in [Printed::OnSupports, Printed::AsItStands] {
            let under = UnderPlanes::of(start.setting.job, Vec::new());
            let look = kept_and(printing, start, &under, options, ctx)?;
            look.tell(printing.on_coarse_grid(), 0);
            if look.may_be_valid(start.setting.job) {
                return Ok(Some(printing));
            }
        }
        Ok(None)
    })?;
    run.clock.lap("blocks");
    let Some(printing) = printing else { return Ok(None) };
    let setting = start.setting.with_last_resort();
    let under = UnderPlanes::of(start.setting.job, Vec::new());
    let made = kept_and(printing, &start.in_setting(&setting), &under, options, ctx)?;
    made.tell("cut first", 0);
    let made = closely_cut(run, &under, made)?;
    run.clock.lap("blocks");
    match printing {
        Printed::OnSupports => with_missing_opened(run, made).map(Some),
        Printed::AsItStands => Ok(Some(made)),
    }
}

/// How is printed what is missing once all is cut.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Printed {
    /// Straight up first, on supports where nothing else carries it.
    OnSupports,
    /// Along whatever direction takes the most, on what stands. What is printed straight up first may wall in what
    /// another direction would have had to come before.
    AsItStands,
}

impl Printed {
    fn on_coarse_grid(self) -> &'static str {
        match self {
            Printed::OnSupports => "cut first, on the coarse grid",
            Printed::AsItStands => "cut first, without supports, on the coarse grid",
        }
    }
}

/// All that is to go cut with nothing given up, and what is missing then printed one way or the other.
pub fn kept_and(
    printing: Printed,
    start: &Start,
    under: &UnderPlanes,
    options: &Options,
    ctx: &Ctx,
) -> Result<Attempt, PlanError> {
    match printing {
        Printed::OnSupports => cut_first(start, under, options, ctx),
        Printed::AsItStands => {
            let how = (options, Mending::Some);
            attempt_under(start.setting, start.coarse, under.clone(), &start.preferred, how, ctx)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::clip::Clip;
    use super::super::local_tests::{assert_verifies, block, block_job, bowl, job_of, with_run};
    use super::*;
    use crate::base::{DVec3, Direction};
    use crate::machine::Taken;
    use crate::plan::Plane;
    use crate::voxel::{BitGrid, Frame};

    /// Much is to be cut from a block with a bowl in its top, and a plane under the bowl gives up half of it.
    #[test]
    fn what_a_plane_gave_up_is_kept_where_all_is_reached_without_it() {
        let job = block_job(
            |v| block(v) && !bowl(v),
            |v| block(v) && v[0] < 26,
            |t| t.taken == Taken::Always,
        );
        let (made, notes) = with_run(&job, |run| {
            run.report.notes.push("Of the plan that gives way.".into());
            let clip = Clip::global(Plane { normal: Direction::Z, offset: 8.0 });
            let best = run.start.attempt(vec![clip], run.options, run.ctx).unwrap();
            assert!(is_complete(&best, &job));
            assert!(2 * best.volumes.reused.count() < job.target.count());
            let made = keeping_more(run, &best).unwrap().expect("nothing has to be given up");
            (made, run.report.notes.clone())
        });
        assert!(notes.is_empty(), "{notes:?}");
        assert_eq!(made.left(), 0);
        assert_eq!(made.volumes.reused, job.ideal_reuse());
        assert_verifies(&job, made.steps);
    }

    /// A plan that keeps more took the place of a complete one though stock stood in a pocket that is open only below.
    #[test]
    fn a_complete_plan_does_not_give_way_to_one_that_leaves_a_pocket_below() {
        let pocket = |v: [usize; 3]| (8..12).contains(&v[0]) && (8..12).contains(&v[1]) && v[2] < 4;
        let job = block_job(
            |v| block(v) && !bowl(v),
            |v| block(v) && v[0] < 26 && !pocket(v),
            |t| t.taken == Taken::Always,
        );
        let (found, left) = with_run(&job, |run| {
            let clip = Clip::global(Plane { normal: Direction::Z, offset: 8.0 });
            let mut best = run.start.attempt(vec![clip], run.options, run.ctx).unwrap();
            assert!(!best.excess.is_empty() && best.excess.count() <= FEW_BELOW);
            assert_eq!(best.excess, best.below);
            let left = best.left();
            // As if another cut had it.
            best.excess.subtract(&best.below.clone());
            best.below.subtract(&best.below.clone());
            (keeping_more(run, &best).unwrap().is_some(), left)
        });
        assert!(!found && left > 0);
    }

    /// What is printed straight up walls in a niche that opens to the side. A cross lost all but 0.06 of what it had in
    /// common with an impeller for that.
    #[test]
    fn a_niche_is_filled_before_the_wall_in_front_of_it() {
        const DIMS: [usize; 3] = [44, 36, 40];
        let main = |[x, y, z]: [usize; 3]| (8..24).contains(&x) && (8..28).contains(&y) && z < 34;
        let niche = |[x, y, z]: [usize; 3]| {
            (21..24).contains(&x) && (10..26).contains(&y) && (18..31).contains(&z)
        };
        let wall = |[x, y, z]: [usize; 3]| {
            (24..34).contains(&x) && (8..28).contains(&y) && (4..34).contains(&z)
        };
        let frame = Frame { pitch: 1.0, dims: DIMS, origin: DVec3::ZERO };
        let initial = BitGrid::from_fn(DIMS, |v| main(v) && !niche(v));
        let target = BitGrid::from_fn(DIMS, |v| main(v) || wall(v));
        let job = job_of(frame, initial, target, |t| t.taken == Taken::Always);
        let made = with_run(&job, |run| {
            let options = run.options;
            let on_supports =
                cut_first(run.start, &UnderPlanes::of(&job, Vec::new()), options, run.ctx).unwrap();
            assert!(!on_supports.may_be_valid(&job), "{}", on_supports.left());
            all_kept(run).unwrap().expect("the wall can wait")
        });
        assert!(made.is_valid(&job), "{}", made.left());
        assert_eq!(made.volumes.reused, job.ideal_reuse());
        assert_verifies(&job, made.steps);
    }

    /// A plan that gives up little is not looked beside.
    #[test]
    fn a_plan_that_keeps_nearly_all_stays() {
        let job = block_job(block, |v| block(v) && v[0] < 26, |t| t.taken == Taken::Always);
        let (found, notes) = with_run(&job, |run| {
            run.report.notes.push("Of the plan that stays.".into());
            let best = run.start.attempt(Vec::new(), run.options, run.ctx).unwrap();
            let found = keeping_more(run, &best).unwrap().is_some();
            (found, run.report.notes.len())
        });
        assert!(!found);
        assert_eq!(notes, 1);
    }
}
