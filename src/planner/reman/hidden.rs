//! Where the reused volume hides what is to be added, and the least shift of the target that shows
//! it.
//!
//! Method. Added material beyond skin that no nozzle gets at from any direction while all of the
//! reused volume stands is *hidden*, by exact distances: under a tip that hovers a voxel over the
//! base there is no room for anything. A little of it comes from where the target happens to lie on
//! the grid, so the target is moved by whole voxels, the nearest first, until nothing is hidden.
//! Where much is hidden, planes have to give up what hides it; then the target stays.
//!
//! Guarantees: after the shift nothing is hidden and nearly as much is reused. Not guaranteed: that
//! what is not hidden can be carried.

use super::Options;
use super::round::deep;
use super::setting::Setting;
use crate::access::{CloseNozzle, Scene, nozzle_map, reachable};
use crate::base::{Cancelled, Ctx, DVec3, Direction};
use crate::machine::Tool;
use crate::plan::Job;
use crate::region::Volumes;
use crate::voxel::BitGrid;
use rayon::prelude::*;
use std::collections::BTreeSet;

/// Shifts tried, voxels along an axis; upward half as many, since what the base holds has to stay
/// within the surface tolerance of it.
const FARTHEST: isize = 2;

/// Share of the target that may be hidden for a shift to be looked for: more is no matter of a
/// voxel or two.
const MOST_HIDDEN: f64 = 1e-3;

/// Share of the reused volume that a shift must keep.
const LEAST_KEPT: f64 = 0.99;

/// Directions that are asked at a time: the first few show nearly everything.
const AT_A_TIME: usize = 16;

/// The shift of the target, in voxels, that hides nothing; none where nothing is hidden, where too
/// much is, or where no shift helps.
///
/// # Errors
/// When the user stops the run.
pub fn shift_off_hidden(
    job: &Job,
    options: &Options,
    ctx: &Ctx,
) -> Result<Option<[isize; 3]>, Cancelled> {
    let look = Look::new(job, options);
    let (hidden, most) = look.hidden(&job.target, ctx)?;
    if !(1..=most_hidden(&job.target)).contains(&hidden.count()) {
        return Ok(None);
    }
    let reach = || -FARTHEST..=FARTHEST;
    let mut shifts: Vec<[isize; 3]> = (0..=FARTHEST / 2)
        .flat_map(|z| reach().flat_map(move |y| reach().map(move |x| [x, y, z])))
        .filter(|s| *s != [0, 0, 0])
        .collect();
    shifts.sort_by_key(|s| s.iter().map(|c| c * c).sum::<isize>());
    for shift in shifts {
        let moved = moved(&job.target, shift);
        if moved.count() < job.target.count() {
            // Part of it has left the grid.
            continue;
        }
        let (still, kept) = look.hidden_of(&moved, &self::moved(&hidden, shift), ctx)?;
        tracing::debug!(?shift, still = still.count(), kept, "shift of the target");
        if still.is_empty() && kept as f64 >= LEAST_KEPT * most as f64 {
            return Ok(Some(shift));
        }
    }
    Ok(None)
}

/// Hidden voxels for which a shift is looked for.
fn most_hidden(target: &BitGrid) -> usize {
    (MOST_HIDDEN * target.count() as f64) as usize
}

/// A set moved by whole voxels.
fn moved(set: &BitGrid, by: [isize; 3]) -> BitGrid {
    BitGrid::from_fn(set.dims(), |v| {
        set.get_or_empty(std::array::from_fn(|a| v[a] as i64 - by[a] as i64))
    })
}

/// What stays the same while the target moves.
struct Look<'a> {
    setting: Setting<'a>,
    /// Directions and the holding in which a nozzle points there.
    ways: Vec<(usize, Direction)>,
    fixed: Vec<Vec<DVec3>>,
}

impl<'a> Look<'a> {
    fn new(job: &'a Job, options: &Options) -> Self {
        let setting = Setting::new(job).with_last_resort();
        let holdings = 0..setting.holdings.len();
        let of_holding = |h: usize| {
            let all = setting.axes(h).into_iter().chain(setting.sampled(h, options.directions));
            all.map(move |d| (h, d)).collect::<Vec<_>>()
        };
        let ways = holdings.clone().flat_map(of_holding).collect();
        let fixed = holdings.map(|h| setting.fixed(h, &job.initial)).collect();
        Look { setting, ways, fixed }
    }

    /// Hidden voxels of a target that lies so, and how many voxels are reused.
    fn hidden(&self, target: &BitGrid, ctx: &Ctx) -> Result<(BitGrid, usize), Cancelled> {
        self.hidden_of(target, &BitGrid::new(target.dims()), ctx)
    }

    /// The same, but no more than those among the `suspects` if there are any of these. Those of an
    /// unmoved target mostly are still hidden, and so few are told closely in no time.
    fn hidden_of(
        &self,
        target: &BitGrid,
        suspects: &BitGrid,
        ctx: &Ctx,
    ) -> Result<(BitGrid, usize), Cancelled> {
        let job = self.setting.job;
        let both = job.initial.and(target);
        let (rules, frame) = (&job.rules, &job.frame);
        let volumes =
            Volumes::keeping(&job.initial, target, &both, frame, rules.holding, rules.grip_mm);
        let (_, added) = deep(&self.setting, &volumes);
        let wanted = added.minus(&self.setting.skin(&volumes.reused));
        let scenes: Vec<Scene> =
            self.fixed.iter().map(|f| Scene::new(frame, &volumes.reused, f)).collect();
        let close: Vec<CloseNozzle> =
            scenes.iter().map(|s| CloseNozzle::new(s, &volumes.reused)).collect();
        let dip = rules.nozzle_dip_mm;
        let closely = |few: BitGrid| {
            let mut few: Vec<[usize; 3]> = few.iter_ones().collect();
            let shown = |few: &Vec<[usize; 3]>, tool: &Tool, (h, d): (usize, Direction)| {
                close[h].clear(few, tool, d, dip).into_iter().collect()
            };
            let take = |few: &mut Vec<_>, shown: &BTreeSet<_>| few.retain(|v| !shown.contains(v));
            self.show(&mut few, Vec::is_empty, shown, take, ctx)?;
            let mut left = BitGrid::new(frame.dims);
            few.into_iter().for_each(|v| left.set(v, true));
            Ok(left)
        };
        let kept = volumes.reused.count();
        let hidden = closely(wanted.and(suspects))?;
        if !hidden.is_empty() {
            return Ok((hidden, kept));
        }
        let mut left = wanted;
        let shown = |left: &BitGrid, tool: &Tool, (h, d): (usize, Direction)| {
            reachable(&nozzle_map(&scenes[h], left, tool, d, dip), left, frame)
        };
        self.show(&mut left, BitGrid::is_empty, shown, BitGrid::subtract, ctx)?;
        let is_many = left.count() > most_hidden(target);
        Ok((if is_many { left } else { closely(left)? }, kept))
    }

    /// Takes from `left` what any nozzle shows in any way, until nothing is left.
    fn show<L: Sync, S: Send>(
        &self,
        left: &mut L,
        is_empty: impl Fn(&L) -> bool,
        shown: impl Fn(&L, &Tool, (usize, Direction)) -> S + Sync,
        take: impl Fn(&mut L, &S),
        ctx: &Ctx,
    ) -> Result<(), Cancelled> {
        for ways in self.ways.chunks(AT_A_TIME) {
            if is_empty(left) {
                break;
            }
            let open: Vec<Vec<S>> = ways
                .par_iter()
                .map(|way| {
                    ctx.check()?;
                    Ok(self.setting.nozzles().iter().map(|tool| shown(left, tool, *way)).collect())
                })
                .collect::<Result<_, Cancelled>>()?;
            open.iter().flatten().for_each(|open| take(left, open));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::planner::reman::local_tests::job_of;
    use crate::voxel::Frame;

    /// A tall block with a recess in its bottom, two voxels deeper than what stands in it: a tip of
    /// the target, so thick.
    fn hovering(tip: usize) -> Job {
        let frame = Frame { pitch: 1.0, dims: [40, 40, 150], origin: DVec3::ZERO };
        let part = |[x, y, z]: [usize; 3]| {
            let inside =
                |low: usize, high: usize| (low..high).contains(&x) && (low..high).contains(&y);
            inside(5, 35) && z < 148 && !(inside(14, 26) && z < 3)
        };
        let initial = BitGrid::from_fn(frame.dims, part);
        let target = BitGrid::from_fn(frame.dims, |v| {
            part(v) || (20..20 + tip).contains(&v[0]) && v[1] == 20 && (1..3).contains(&v[2])
        });
        job_of(frame, initial, target, |_| true)
    }

    #[test]
    fn a_tip_that_hovers_over_the_base_is_lifted_into_the_skin() {
        let (options, ctx) = (Options::default(), Ctx::quiet());
        let job = hovering(1);
        let shift = shift_off_hidden(&job, &options, &ctx).unwrap();
        assert_eq!(shift, Some([0, 0, 1]));
        let lifted = Job { target: moved(&job.target, [0, 0, 1]), ..job };
        assert_eq!(shift_off_hidden(&lifted, &options, &ctx).unwrap(), None);
    }

    #[test]
    fn what_a_nozzle_gets_at_moves_nothing() {
        let mut job = hovering(0);
        job.target.set([5, 9, 149], true);
        assert_eq!(shift_off_hidden(&job, &Options::default(), &Ctx::quiet()).unwrap(), None);
    }
}
