//! Where the reused volume hides what is to be added, or that hangs just over the base, and the
//! shift of the target that mends it.
//!
//! Method. Added material beyond skin that no nozzle gets at from any direction while all of the
//! reused volume stands is *hidden*, by exact distances: under a tip that hovers a voxel over the
//! base there is no room for anything. A little of it comes from where the target happens to lie on
//! the grid. *Low* is what of the target lies outside the initial part, farther than skin, in the lowest
//! millimetres over nothing: it would have to be laid downward, by a nozzle that points up from
//! below the base. A foot beside the initial part's is all low, and fits within it a little farther on.
//! The target is moved by whole voxels. Of all shifts, or every so many of them, the low voxels are counted; where
//! something is low, the least of them give the place to begin. From there it goes on by voxels as long as less
//! is hidden and low together. Where much is hidden, planes have to give up what hides it; then the target stays.
//!
//! Guarantees: after the shift next to nothing is hidden or low, at most a quarter of what was, and
//! nearly as much is reused. Not guaranteed: that what is not hidden can be carried, or that no
//! shorter shift does it.

use super::Options;
use super::round::deep;
use super::setting::Setting;
use crate::access::{CloseNozzle, Scene, nozzle_map, reachable};
use crate::base::{Cancelled, Ctx, DVec3, Direction};
use crate::machine::{HoldingMode, Tool};
use crate::plan::Job;
use crate::region::Volumes;
use crate::voxel::BitGrid;
use rayon::prelude::*;
use std::collections::BTreeSet;

/// Farthest shift along the base, mm.
const FARTHEST_MM: f64 = 5.0;

/// Farthest shift upward, voxels: what the base holds has to stay within the surface tolerance of it.
const HIGHEST: isize = 1;

/// Height over the base up to which nothing can be laid downward, mm: no nozzle is that slim along
/// its side, and within so little a deposit that leans has nothing to lean from.
const LOW_MM: f64 = 2.0;

/// Share of the target that may be low for a shift to be looked for.
const MOST_LOW: f64 = 0.01;

/// Low places of the target that are counted at each shift: of more, every so many.
const LOW_SAMPLES: usize = 4000;

/// Shifts to either side whose low voxels are counted: on fine grids not every one.
const MOST_STEPS: isize = 20;

/// Shifts with the least low that are looked at closely.
const STARTS: usize = 8;

/// What of a place may still be hidden or low after a shift.
const LEFT_SHARE: f64 = 0.25;

/// Share of the target that may be hidden for a shift to be looked for: more is no matter of a
/// voxel or two.
const MOST_HIDDEN: f64 = 1e-3;

/// Share of the reused volume that a shift must keep: one of a voxel or two, and a longer one, which could move
/// faces apart that lie flush.
const LEAST_KEPT: f64 = 0.99;
const LEAST_KEPT_FAR: f64 = 0.999;

/// Longest of the shifts that count as near, voxels along an axis.
const NEAR: isize = 2;

/// Directions that are asked at a time: the first few show nearly everything.
const AT_A_TIME: usize = 16;

/// The shift of the target, in voxels, that shows what is hidden and puts into the initial part what
/// is low; none where there is neither, where too much is hidden, or where no shift helps.
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
    if hidden.count() > most_hidden(&job.target) {
        return Ok(None);
    }
    let low = Low::of(job);
    let here = hidden.count() + low.at([0; 3]);
    if here == 0 {
        return Ok(None);
    }
    // What is hidden and low with the target moved so, no more than `least` of it; none where too little is kept.
    let cost = |shift: [isize; 3], least: usize| -> Result<Option<usize>, Cancelled> {
        let moved = moved(&job.target, shift);
        if low.at(shift) >= least || moved.count() < job.target.count() {
            // Part of it may have left the grid.
            return Ok(None);
        }
        let (still, kept) = look.hidden_of(&moved, &self::moved(&hidden, shift), ctx)?;
        let cost = still.count() + low.at(shift);
        tracing::debug!(?shift, hidden = still.count(), low = low.at(shift), kept, "shift");
        let is_near = shift.iter().all(|c| c.abs() <= NEAR);
        let least_kept = if is_near { LEAST_KEPT } else { LEAST_KEPT_FAR };
        let is_better = cost < least && kept as f64 >= least_kept * most as f64;
        Ok(is_better.then_some(cost))
    };
    let (mut at, mut least) = ([0; 3], here);
    for shift in low.starts() {
        if let Some(cost) = cost(shift, least)? {
            (at, least) = (shift, cost);
        }
    }
    let mut tried = BTreeSet::from([[0; 3], at]);
    while least > 0 {
        let before = least;
        let mut next = at;
        for shift in low.around(at) {
            if tried.insert(shift)
                && let Some(cost) = cost(shift, least)?
            {
                (next, least) = (shift, cost);
                if least == 0 {
                    break;
                }
            }
        }
        at = next;
        if least == before {
            break;
        }
    }
    Ok((least as f64 <= LEFT_SHARE * here as f64).then_some(at))
}

/// What of the target may come to hang low.
struct Low {
    /// The initial part, and beside it what is no farther than skin.
    within: BitGrid,
    /// Voxels of the target near the base, or every so many of them.
    foot: Vec<[usize; 3]>,
    /// How many each of them stands for.
    each: usize,
    /// Farthest shift along the base, voxels.
    farthest: isize,
}

impl Low {
    /// None are counted with a second holding, in which the part stands on its head, nor where so
    /// much is low that planes have to see to it.
    fn of(job: &Job) -> Low {
        let layers = (LOW_MM / job.frame.pitch).ceil() as usize;
        let lowest = job.target.iter_ones().map(|v| v[2]).min().unwrap_or(0);
        let is_low = |v: &[usize; 3]| v[2] <= lowest + layers;
        let mut foot: Vec<[usize; 3]> = match job.rules.holding {
            HoldingMode::Base => job.target.iter_ones().filter(is_low).collect(),
            HoldingMode::Refixture => Vec::new(),
        };
        let each = foot.len().div_ceil(LOW_SAMPLES).max(1);
        foot = foot.into_iter().step_by(each).collect();
        let farthest = (FARTHEST_MM / job.frame.pitch) as isize;
        let mut low = Low { within: job.initial.grown(), foot, each, farthest };
        if low.at([0; 3]) as f64 > MOST_LOW * job.target.count() as f64 {
            low.foot.clear();
        }
        low
    }

    /// Low voxels of the target moved so.
    fn at(&self, shift: [isize; 3]) -> usize {
        let over_nothing = |v: &&[usize; 3]| {
            let [x, y, z]: [i64; 3] = std::array::from_fn(|a| v[a] as i64 + shift[a] as i64);
            (0..=z).rev().all(|below| !self.within.get_or_empty([x, y, below]))
        };
        self.each * self.foot.iter().filter(over_nothing).count()
    }

    /// Shifts with less low than there is, the least first.
    fn starts(&self) -> Vec<[isize; 3]> {
        let here = self.at([0; 3]);
        if here == 0 {
            return Vec::new();
        }
        let stride = self.farthest.div_euclid(MOST_STEPS + 1) + 1;
        let most = self.farthest / stride;
        let along = || (-most..=most).map(|i| i * stride);
        let all: Vec<[isize; 3]> = (0..=HIGHEST)
            .flat_map(|z| along().flat_map(move |y| along().map(move |x| [x, y, z])))
            .collect();
        let mut counted: Vec<(usize, isize, [isize; 3])> =
            all.into_par_iter().map(|s| (self.at(s), length(s), s)).collect();
        counted.retain(|c| c.0 < here);
        counted.sort_unstable();
        counted.into_iter().take(STARTS).map(|(.., s)| s).collect()
    }

    /// The shifts a voxel along any axes from one, the shortest first.
    fn around(&self, at: [isize; 3]) -> Vec<[isize; 3]> {
        let by = || -1..=1;
        let all = by().flat_map(|z| by().flat_map(move |y| by().map(move |x| [x, y, z])));
        let mut shifts: Vec<[isize; 3]> = all
            .map(|by| std::array::from_fn(|a| at[a] + by[a]))
            .filter(|[x, y, z]| x.abs().max(y.abs()) <= self.farthest && (0..=HIGHEST).contains(z))
            .collect();
        shifts.sort_by_key(|s| length(*s));
        shifts
    }
}

/// Squared length of a shift, and with it the order in which shifts are tried.
fn length(shift: [isize; 3]) -> isize {
    shift.iter().map(|c| c * c).sum()
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

    /// A block, and in it a smaller one with a foot that comes out of it beside the base.
    fn on_a_foot(reach: usize, holding: HoldingMode) -> Job {
        let frame = Frame { pitch: 1.0, dims: [60, 50, 40], origin: DVec3::ZERO };
        let boxed = |v: &[usize; 3], x: [usize; 2], y: [usize; 2], top: usize| {
            (x[0]..x[1]).contains(&v[0]) && (y[0]..y[1]).contains(&v[1]) && v[2] < top
        };
        let initial = BitGrid::from_fn(frame.dims, |v| boxed(&v, [8, 40], [8, 40], 35));
        let target = BitGrid::from_fn(frame.dims, |v| {
            boxed(&v, [15, 38], [14, 34], 30) || boxed(&v, [38, 40 + reach], [20, 24], 2)
        });
        let mut job = job_of(frame, initial, target, |_| true);
        job.rules.holding = holding;
        job
    }

    #[test]
    fn a_foot_beside_the_initial_part_is_moved_into_it() {
        let (options, ctx) = (Options::default(), Ctx::quiet());
        let job = on_a_foot(4, HoldingMode::Base);
        // One of its four columns is skin, the others would hang.
        assert_eq!(Low::of(&job).at([0; 3]), 3 * 4 * 2);
        let shift = shift_off_hidden(&job, &options, &ctx).unwrap();
        assert_eq!(shift, Some([-3, 0, 0]));
        let within = Job { target: moved(&job.target, [-3, 0, 0]), ..job };
        assert_eq!(shift_off_hidden(&within, &options, &ctx).unwrap(), None);
    }

    /// On a fine grid far fewer shifts are counted than there are voxels to either side.
    #[test]
    fn of_fine_grids_not_every_shift_is_counted() {
        let job = on_a_foot(4, HoldingMode::Base);
        let mut low = Low::of(&job);
        for (farthest, stride) in [(5, 1), (20, 1), (21, 2), (250, 12)] {
            low.farthest = farthest;
            let starts = low.starts();
            assert!(starts.len() == STARTS || farthest == 250, "{starts:?}");
            assert!(starts.iter().all(|s| s[0] % stride == 0 && s[1] % stride == 0), "{starts:?}");
            assert!(starts.iter().all(|s| s[0].abs().max(s[1].abs()) <= farthest));
        }
    }

    #[test]
    fn feet_do_not_count_where_the_part_is_turned_over_or_much_is_low() {
        assert_eq!(Low::of(&on_a_foot(4, HoldingMode::Refixture)).at([0; 3]), 0);
        assert_eq!(Low::of(&on_a_foot(20, HoldingMode::Base)).at([0; 3]), 0);
    }

    #[test]
    fn what_a_nozzle_gets_at_moves_nothing() {
        let mut job = hovering(0);
        job.target.set([5, 9, 149], true);
        assert_eq!(shift_off_hidden(&job, &Options::default(), &Ctx::quiet()).unwrap(), None);
    }
}
