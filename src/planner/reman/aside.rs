//! Printing on supports that are cut away again.
//!
//! Method. What is wanted is printed straight up on supports. These are cut, and then what is still missing is printed.
//! Where cutters leave a few of the supports, all is made once more with none near them, and kept if that leaves less.
//!
//! Guarantees: those of cuts and deposits. Not guaranteed: that no support is left, or that a third try would not leave
//! less.

use super::coarse::Coarse;
use super::cutting::{Cuts, cut_blocks};
use super::followed;
use super::last_resort::NEAR_STUCK;
use super::printing::{
    OnSupports, Printing, Wanted, leaves_none, print_blocks, print_crumbs, print_on_supports,
};
use super::setting::Setting;
use crate::base::{Ctx, Direction};
use crate::plan::Job;
use crate::planner::PlanError;
use crate::voxel::{BitGrid, distance_within};

/// Up to so many voxels of supports that no cutter gets at, what they carry is made again without supports near them, and
/// may then miss so many times as many more. Of more, exact distances take most in the end.
const FEW_STUCK: usize = 5;
/// What stands counts for so many times as much that is missing: pits open this, not that.
pub const MORE_MISSING: usize = 10;

/// What is wanted printed straight up on supports, these cut away, and then what is still missing; once more without
/// supports near a few that no cutter gets at, if what that leaves is less: it can be opened by pits.
pub fn on_supports_and_cut(
    setting: &Setting,
    coarse: &Coarse,
    wanted: &Wanted,
    samples: usize,
    ctx: &Ctx,
) -> Result<Printing, PlanError> {
    let none = BitGrid::new(setting.job.frame.dims);
    let (first, stuck) = but(setting, coarse, wanted, (samples, &none), ctx)?;
    if !(1..=FEW_STUCK).contains(&stuck.count()) {
        return Ok(first);
    }
    let avoided = distance_within(&stuck, NEAR_STUCK).minus(&setting.job.target);
    let (again, still_stuck) = but(setting, coarse, wanted, (samples, &avoided), ctx)?;
    let missing = |p: &Printing| p.unreached.count_and(wanted.core);
    tracing::debug!(
        stuck = stuck.count(),
        still = still_stuck.count(),
        missing = missing(&first),
        now = missing(&again),
        "supports left"
    );
    let stand = [stuck.count(), still_stuck.count()];
    let is_better = leaves_less(stand, [missing(&first), missing(&again)]);
    Ok(if is_better { again } else { first })
}

/// Whether a second try is worth more than the first, by the supports that either leaves standing and by what it misses.
fn leaves_less(stand: [usize; 2], missing: [usize; 2]) -> bool {
    stand[1] < stand[0] && missing[1] <= missing[0] + MORE_MISSING * stand[0]
}

/// The same with no supports where they are to be avoided, and those of them that are left.
fn but(
    setting: &Setting,
    coarse: &Coarse,
    wanted: &Wanted,
    (samples, avoided): (usize, &BitGrid),
    ctx: &Ctx,
) -> Result<(Printing, BitGrid), PlanError> {
    let job = setting.job;
    let none = BitGrid::new(job.frame.dims);
    let on = OnSupports { direction: Direction::Z, avoided, slim: &none, ahead: &none };
    let first = print_on_supports(setting, coarse, wanted, on, ctx)?;
    // What stood there before stays what it was.
    let supports = first.state.minus(wanted.state).minus(&job.target);
    let supports = setting.beyond_skin(&supports, wanted.state);
    if supports.is_empty() {
        let all = print_crumbs(setting, coarse, wanted, first, leaves_none, ctx)?;
        return Ok((all, none));
    }
    let kept = setting.old_of(wanted.state);
    let printed = Job { initial: first.state.clone(), ..job.clone() };
    let next = setting.of_next_round(&printed, kept);
    let removable = first.state.minus(&job.target);
    let cuts = Cuts { removable: &removable, deep: &supports, samples, before: &[], patient: true };
    let cutting = cut_blocks(&next, coarse, &cuts, ctx)?;
    let still = Wanted { state: &cutting.state, added: &first.unreached, ..*wanted };
    let last = print_blocks(&next, coarse, &still, &[], ctx)?;
    let mut last = print_crumbs(&next, coarse, &still, last, leaves_none, ctx)?;
    last.steps = followed(followed(first.steps, cutting.steps), last.steps);
    Ok((last, supports.and(&cutting.state)))
}

#[cfg(test)]
mod tests {
    use super::super::local_tests::job_of;
    use super::super::printing::Patience;
    use super::*;
    use crate::base::DVec3;
    use crate::voxel::Frame;

    /// A nub a few voxels over the floor of a channel: what stands under it is too little for a cut.
    #[test]
    fn supports_keep_off_those_that_no_cut_takes() {
        const DIMS: [usize; 3] = [46, 40, 30];
        let within = |v: usize, range: std::ops::Range<usize>| range.contains(&v);
        let nub =
            |[x, y, z]: [usize; 3]| within(x, 18..24) && within(y, 15..21) && within(z, 10..16);
        let block =
            |[x, y, z]: [usize; 3]| within(x, 3..43) && within(y, 3..37) && within(z, 1..25);
        let channel = |[x, _, z]: [usize; 3]| within(x, 12..34) && z >= 6;
        let part = |v: [usize; 3]| block(v) && !channel(v);
        let frame = Frame { pitch: 1.0, dims: DIMS, origin: DVec3::ZERO };
        let target = BitGrid::from_fn(DIMS, |v| part(v) || nub(v));
        let job = job_of(frame, BitGrid::from_fn(DIMS, part), target, |_| true);
        let added = job.target.minus(&job.initial);
        let setting = Setting::new(&job).with_last_resort();
        let coarse = Coarse::of(&job);
        let wanted = Wanted {
            state: &job.initial,
            added: &added,
            core: &setting.beyond_skin(&added, &job.initial),
            preferred: &[Direction::Z],
            samples: 0,
            patience: Patience::Endless,
        };
        let on = |avoided: &BitGrid| {
            but(&setting, &coarse, &wanted, (0, avoided), &Ctx::quiet()).unwrap()
        };
        let stuck = on(&BitGrid::new(DIMS)).1;
        let avoided = distance_within(&stuck, NEAR_STUCK).minus(&job.target);
        let mut aside = BitGrid::new(DIMS);
        on(&avoided).0.steps.iter().for_each(|s| aside.union_with(&s.region));
        assert!((1..=FEW_STUCK).contains(&stuck.count()), "{}", stuck.count());
        assert!(avoided.count() > 10 && aside.and(&avoided).is_empty());
    }

    #[test]
    fn supports_left_standing_weigh_more_than_what_can_be_opened_yet() {
        assert!(leaves_less([3, 0], [6, 7]) && leaves_less([2, 1], [0, 20]));
        assert!(!leaves_less([3, 3], [6, 0]) && !leaves_less([2, 1], [0, 21]));
    }
}
