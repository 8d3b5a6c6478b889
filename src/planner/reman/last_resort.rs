//! What planes alone leave: tools of the last resort, and supports for what nothing carries.
//!
//! Method. The planes stay. What is to be removed below them can stand until everything is printed:
//! raw stock carries deposits as supports do, so a pocket under a dome needs no columns, and the
//! first block begins on the face that a plane leaves. Then come deposits straight up, on supports
//! where neither part nor stock carries them (`supports`), cuts of all that stands outside the
//! target, and deposits of what is still missing. Where the cutters leave some of the supports, all
//! is tried again, the same cuts first, with none that they would not reach and slim ones near the
//! others; where crumbs are missing in creases that close before their turn, what lies around them
//! is printed ahead of all else. If this way leaves something, the stock is cut before anything is printed, once
//! without supports and once with them; these come first where much is missing that hangs in the open. After all steps of the best of these come cuts by all tools and by exact
//! distances, where it leaves something standing, and deposits of what those open; where nothing is printed they are
//! all there is to do. What tools do not get at then is opened in the stock, and all made once more (`opened`).
//!
//! Guarantees: those of cuts and deposits. A plan is made this way only if it ranks higher and
//! leaves less. Not guaranteed: that nothing is left.

mod opened;

use super::cutting::{Cuts, cut_blocks};
use super::laying::{Layer, ways_along};
use super::printing::{
    MOST_CRUMBS, OnSupports, Patience, Printing, Wanted, leaves_none, print_blocks, print_crumbs,
    print_on_supports,
};
use super::reach::within_reach;
use super::reasons::open_below;
use super::round::{Attempt, Mending, UnderPlanes, along, deep, printed};
use super::{MENDABLE_SHARE, Options, Run, Start, followed};
use crate::base::{Ctx, Direction};
use crate::plan::{Job, Step, StepKind};
use crate::planner::PlanError;
use crate::voxel::{BitGrid, distance_within};
use opened::opened_first;
pub use opened::{with_missing_opened, with_standing_opened};

/// How often all is tried again without the supports that the cutters left, and with what was missing
/// printed first: each time costs as much as the first, and the third leaves few.
const AGAIN: usize = 5;

/// So often in a row a round may leave hardly less than the one before it, or more: on the cow one did before the last
/// left nothing, on a bracket all five did.
const MOST_RISES: usize = 2;

/// Hardly less is more than this share of what the round before left: on a bracket such rounds took a fiftieth each at most,
/// and as long as the first.
const HARDLY_LESS: f64 = 0.95;

/// Up to so many voxels that are open only below, by a coarse look, are cut for all the same: from a cow's belly
/// ten cuts from the sides took all of 19.
pub const FEW_BELOW: usize = 100;

/// Where a nozzle gets straight down at this share of what is missing, supports come before other ways to print it;
/// at a bracket's shelf it gets at all of it, below a roof at none.
const HANGS_SHARE: f64 = 0.9;

/// Voxels left standing, and nothing missing, for which close cuts come before another way to print: a cut or two.
const TIP_VOXELS: usize = 10;

/// Share of the target up to which what was missing is printed first in the next round: twice what counts as crumbs. On a worn
/// figure a needle that laid nearly all straight up closed the way from the side to a seven-hundredth of the target.
const MOST_AHEAD: f64 = 2.0 * MOST_CRUMBS;

/// How far around what was missing is printed first, mm: enough for a block with a bead in it.
const AHEAD_MM: f64 = 1.5;

/// How far, in voxels, from what the cutters left of a support others are looked at: carriers of the
/// same voxel and what carries them.
pub const NEAR_STUCK: f64 = 4.0;

/// How far, in voxels, from what the cutters left the supports are as slim as they can be: so the
/// trunks next to it are slim as well, on grids down to 0.2 mm.
const SLIM_NEAR: f64 = 10.0;

/// What stands when the first deposit is made, and the cuts that leave it.
#[derive(Clone)]
struct Stock {
    cuts: Vec<Step>,
    state: BitGrid,
}

/// What a plan begins with, and what its rounds learned.
struct Grounds {
    stock: Stock,
    care: Care,
}

impl Grounds {
    /// Those of a plan in one round.
    fn of(plain: &Attempt, job: &Job) -> Grounds {
        Grounds { stock: finished_stock(plain), care: Care::none(job) }
    }
}

/// The best of an attempt and what the last resort makes of its planes, if that was not looked at before;
/// `on_supports` is what [`on_supports`] made, where that is known.
pub fn last_resort(
    run: &mut Run,
    plain: Attempt,
    on_supports: Option<Attempt>,
) -> Result<Attempt, PlanError> {
    if run.resorted.contains(&plain.clips) {
        return Ok(plain);
    }
    run.resorted.push(plain.clips.clone());
    let known = on_supports.filter(|o| o.clips == plain.clips);
    let under = UnderPlanes::of_attempt(&plain);
    let (best, grounds) = match plain.prints_anything() {
        true => resorted(run, &under, plain, known)?,
        false => {
            let grounds = Grounds::of(&plain, run.start.setting.job);
            (plain, grounds)
        }
    };
    // Close cuts are many and small. Where anything is printed, other supports may do without.
    let best = closely_cut(run, &under, best)?;
    opened_first(run, under, grounds, best)
}

/// The best of an attempt and what all tools make of its planes, and what it begins with.
fn resorted(
    run: &mut Run,
    under: &UnderPlanes,
    mut best: Attempt,
    mut known: Option<Attempt>,
) -> Result<(Attempt, Grounds), PlanError> {
    let setting = &run.start.setting.with_last_resort();
    let start = run.start.in_setting(setting);
    let finished = &finished_stock(&best);
    let mut grounds = Grounds::of(&best, setting.job);
    // Slimmer nozzles rarely lay what hangs in the open.
    let hangs =
        run.options.supports && start.mostly_hangs(&finished.state, &best.deficit, run.ctx)?;
    let last =
        if hangs { [(false, true), (false, false)] } else { [(false, false), (false, true)] };
    for (waits, supports) in [(true, true), last[0], last[1]] {
        if best.residual() == 0 || run.ctx.out_of_time() {
            break;
        }
        let unlike_before = if supports { run.options.supports } else { setting.has_last_resort() };
        if !unlike_before || waits && under.clips.is_empty() {
            continue;
        }
        let how = (run.options, run.ctx);
        let mut care = Care::none(setting.job);
        let (made, stock) = match (waits, known.take()) {
            (true, Some(known)) => (is_better(&known, &best, setting.job).then_some(known), None),
            (true, None) => {
                let stock = start.stock_under_planes(under, run.options, run.ctx)?;
                let than = Some(&best);
                (rounds(&start, (under, &stock), (supports, &mut care), than, how)?, Some(stock))
            }
            (false, _) => {
                let than = Some(&best);
                let made = rounds(&start, (under, finished), (supports, &mut care), than, how)?;
                (made, Some(finished.clone()))
            }
        };
        run.clock.lap("blocks");
        if let Some(made) = made {
            best = made;
            let stock = stock.unwrap_or_else(|| finished_stock(&best));
            grounds = Grounds { stock, care };
        }
        // A tip that close cuts take is no reason to plan all anew.
        if best.deficit.is_empty() && best.excess.count() <= TIP_VOXELS {
            let closely = closely_cut(run, under, best.clone())?;
            if closely.left() == 0 {
                return Ok((closely, grounds));
            }
        }
    }
    Ok((best, grounds))
}

/// An attempt and, after all its steps, cuts of what it leaves standing by all tools and exact distances,
/// and deposits of what those open; itself where that leaves no less.
pub fn closely_cut(
    run: &mut Run,
    under: &UnderPlanes,
    best: Attempt,
) -> Result<Attempt, PlanError> {
    let (standing, below) = (best.excess.count(), best.below.count());
    if standing == 0 || standing == below && below > FEW_BELOW || run.ctx.out_of_time() {
        return Ok(best);
    }
    let setting = run.start.setting.with_close_cuts();
    let start = run.start.in_setting(&setting);
    let job = setting.job;
    let so_far = Printing::before_any(best.end(job), best.deficit.clone());
    let after = (best.steps.clone(), best.cuts, best.stock.clone());
    let made = start.ended(under, after, (so_far, &best.deficit), &[], run.options, run.ctx)?;
    run.clock.lap("blocks");
    made.tell("close cuts", 0);
    Ok(if is_better(&made, &best, job) { made } else { best })
}

/// What comes of planes when the stock below them waits and deposits stand on supports. The setting
/// has the tools of the last resort.
pub fn on_supports(
    start: &Start,
    under: &UnderPlanes,
    options: &Options,
    ctx: &Ctx,
) -> Result<Attempt, PlanError> {
    let stock = start.stock_under_planes(under, options, ctx)?;
    let mut care = Care::none(start.setting.job);
    let made = rounds(start, (under, &stock), (true, &mut care), None, (options, ctx))?;
    made.ok_or(PlanError::Cancelled)
}

/// What comes of all cuts made first and then deposits on supports; where a few supports are left, with
/// none near them if that leaves fewer. The setting has the tools of the last resort.
pub fn cut_first(
    start: &Start,
    under: &UnderPlanes,
    options: &Options,
    ctx: &Ctx,
) -> Result<Attempt, PlanError> {
    let setting = start.setting;
    let (deep, _) = deep(setting, &under.volumes);
    let removable = &under.volumes.removed;
    let cuts =
        Cuts { removable, deep: &deep, samples: options.directions, before: &[], patient: false };
    let cutting = cut_blocks(setting, start.coarse, &cuts, ctx)?;
    let stock = Stock { cuts: cutting.steps, state: cutting.state };
    let mut care = Care::none(setting.job);
    let with = (Some(care.of_supports()), Patience::Endless);
    let made = start.finished(under, &stock, with, &[], options, ctx)?;
    let made = made.ok_or(PlanError::Cancelled)?;
    // A few voxels of supports that no cutter gets at are in the way of a plan that leaves nothing.
    let few_stand = (1..=FEW_BELOW).contains(&made.excess.count());
    if !few_stand || ctx.out_of_time() || !care.learn(start, &made, options, ctx)? {
        return Ok(made);
    }
    let with = (Some(care.of_supports()), Patience::Endless);
    let again = start.finished(under, &stock, with, &care.before, options, ctx)?;
    let stand = |a: &Attempt| (a.excess.count(), a.deficit.count());
    Ok(again.filter(|a| stand(a) < stand(&made)).unwrap_or(made))
}

/// Deposits on a stock and cuts of what then stands outside the target, again and again while that
/// may leave less; the best of them, if it is better than `than`, which then leaves the care with which it was made.
fn rounds(
    start: &Start,
    (under, stock): (&UnderPlanes, &Stock),
    (supports, care): (bool, &mut Care),
    than: Option<&Attempt>,
    (options, ctx): (&Options, &Ctx),
) -> Result<Option<Attempt>, PlanError> {
    let job = start.setting.job;
    let mut better: Option<(Attempt, Care)> = None;
    // How much the round before left, and how often in a row one left hardly less than the one before it.
    let (mut left, mut rises) = (usize::MAX, 0);
    for round in 0..=AGAIN {
        let on = supports.then_some(care.of_supports());
        let best = better.as_ref().map(|(made, _)| made).or(than);
        let patience = best.map_or(Patience::Endless, |b| Patience::UpTo(b.left()));
        let with = (on, patience);
        let Some(made) = start.finished(under, stock, with, &care.before, options, ctx)? else {
            tracing::debug!(supports, "last resort given up");
            break;
        };
        tracing::debug!(supports, "last resort");
        made.tell("last resort", round);
        let is_worse = best.is_some_and(|b| made.left() > b.left()) && !few_crumbs(&made, job);
        rises = if made.left() as f64 > HARDLY_LESS * left as f64 { rises + 1 } else { 0 };
        left = made.left();
        let ends = !supports || is_worse || rises == MOST_RISES || ctx.out_of_time();
        let with_which = care.clone();
        let again = !ends && care.learn(start, &made, options, ctx)?;
        if best.is_none_or(|b| is_better(&made, b, job)) {
            better = Some((made, with_which));
        }
        if !again {
            break;
        }
    }
    // What later rounds learned left more.
    Ok(better.map(|(made, with_which)| {
        *care = with_which;
        made
    }))
}

/// Whether one attempt ranks no lower than another and leaves less.
fn is_better(one: &Attempt, other: &Attempt, job: &Job) -> bool {
    one.rank(job) <= other.rank(job) && one.left() < other.left()
}

/// Whether so little is missing that printing it first may help.
fn few_crumbs(made: &Attempt, job: &Job) -> bool {
    made.deficit.count() as f64 <= MOST_AHEAD * job.target.count() as f64
}

/// What the rounds before tell the next one to heed.
#[derive(Clone)]
struct Care {
    /// No supports stand here.
    avoided: BitGrid,
    /// They are slim here.
    slim: BitGrid,
    /// This is printed ahead of all else.
    ahead: BitGrid,
    /// Cuts of the last round, made first as far as they still remove anything.
    before: Vec<Step>,
}

impl Care {
    fn none(job: &Job) -> Care {
        let none = BitGrid::new(job.frame.dims);
        Care { avoided: none.clone(), slim: none.clone(), ahead: none, before: Vec::new() }
    }

    fn of_supports(&self) -> OnSupports<'_> {
        let Care { avoided, slim, ahead, .. } = self;
        OnSupports { direction: Direction::Z, avoided, slim, ahead }
    }

    /// Takes in what a round left; whether the next one may leave less.
    fn learn(
        &mut self,
        start: &Start,
        made: &Attempt,
        options: &Options,
        ctx: &Ctx,
    ) -> Result<bool, PlanError> {
        let job = start.setting.job;
        self.before = made.cuts_after();
        // A support in a pocket that is open only below stands for good.
        let stuck = made.excess.and(&made.printed_aside(job));
        let near = distance_within(&stuck, NEAR_STUCK).minus(&job.target);
        // Slim as they are, they were left again.
        let again = near.and(&self.slim);
        let mut changed = !stuck.is_empty() && !again.is_subset_of(&self.avoided);
        if !near.is_subset_of(&self.slim) {
            self.slim.union_with(&distance_within(&stuck, SLIM_NEAR));
            changed = true;
        }
        self.avoided.union_with(&again);
        let open = within_reach(start.setting, &job.target, &near, options.directions, ctx)?;
        self.avoided.union_with(&near.minus(&open));
        tracing::debug!(
            stuck = stuck.count(),
            hopeless = stuck.minus(&open).count(),
            again = again.count(),
            "supports left"
        );
        if few_crumbs(made, job) && !made.deficit.is_subset_of(&self.ahead) {
            self.ahead.union_with(&distance_within(&made.deficit, AHEAD_MM / job.frame.pitch));
            changed = true;
        }
        Ok(changed)
    }
}

impl Attempt {
    /// Whether any of it is printed, or would be.
    pub fn prints_anything(&self) -> bool {
        !self.deficit.is_empty() || self.steps.iter().any(|s| s.kind == StepKind::Additive)
    }

    /// Its cuts, those that are no longer of the stock alone.
    fn cuts_after(&self) -> Vec<Step> {
        let cuts = self.steps.iter().filter(|s| s.kind == StepKind::Subtractive);
        cuts.skip(self.cuts).cloned().collect()
    }

    /// Deposits outside the target.
    pub fn printed_aside(&self, job: &Job) -> BitGrid {
        let mut printed = BitGrid::new(job.frame.dims);
        let additive = self.steps.iter().filter(|s| s.kind == StepKind::Additive);
        additive.for_each(|s| printed.union_with(&s.region));
        printed.minus(&job.target)
    }
}

/// All cuts of an attempt are made.
fn finished_stock(plain: &Attempt) -> Stock {
    Stock { cuts: plain.steps[..plain.cuts].to_vec(), state: plain.stock.clone() }
}

impl Start<'_> {
    /// Whether so much is missing that a plan is not mended any more, and a nozzle gets straight down at nearly all of it
    /// as long as nothing is printed: what it lacks is something to lie on.
    fn mostly_hangs(
        &self,
        state: &BitGrid,
        missing: &BitGrid,
        ctx: &Ctx,
    ) -> Result<bool, PlanError> {
        let (setting, job) = (self.setting, self.setting.job);
        let count = missing.count() as f64;
        let Some(nozzle) = setting.nozzles().last() else { return Ok(false) };
        if count <= MENDABLE_SHARE * job.target.count() as f64 {
            return Ok(false);
        }
        let fixed: Vec<_> = (0..setting.holdings.len()).map(|h| setting.fixed(h, state)).collect();
        let down =
            Layer { job, state, left: missing, core: missing, fixed: &fixed, closely: false };
        let ways = ways_along(setting, &[Direction::Z], nozzle);
        Ok(down.clear_along_any(&ways, ctx)?.count() as f64 >= HANGS_SHARE * count)
    }

    /// What is removed above the planes is cut, the rest stands.
    fn stock_under_planes(
        &self,
        under: &UnderPlanes,
        options: &Options,
        ctx: &Ctx,
    ) -> Result<Stock, PlanError> {
        let (setting, frame) = (self.setting, &self.setting.job.frame);
        let removed = &under.volumes.removed;
        let mut first = BitGrid::new(removed.dims());
        under.clips.iter().for_each(|c| first.union_with(&c.clipped(removed, frame)));
        let deep = first.minus(&setting.skin(&under.volumes.reused));
        let samples = options.directions;
        let cuts = Cuts { removable: &first, deep: &deep, samples, before: &[], patient: true };
        let cutting = cut_blocks(setting, self.coarse, &cuts, ctx)?;
        Ok(Stock { cuts: cutting.steps, state: cutting.state })
    }

    /// From a stock: deposits on supports, none of which stands where they are to be avoided, cuts
    /// of what stands outside the target, those of a round before first, and deposits of what is
    /// still missing. None where patience with the first deposits was lost.
    fn finished(
        &self,
        under: &UnderPlanes,
        stock: &Stock,
        (on, patience): (Option<OnSupports>, Patience),
        before: &[Step],
        options: &Options,
        ctx: &Ctx,
    ) -> Result<Option<Attempt>, PlanError> {
        let setting = self.setting;
        let skin = setting.skin(&under.volumes.reused);
        let (_, added) = deep(setting, &under.volumes);
        let added = added.minus(&stock.state);
        let preferred = along(&under.clips, &self.preferred);
        let wanted = Wanted {
            state: &stock.state,
            added: &added,
            core: &added.minus(&skin),
            preferred: &preferred,
            samples: options.directions,
            patience,
        };
        let printing = match on {
            Some(on) => print_on_supports(setting, self.coarse, &wanted, on, ctx)?,
            None => printed(setting, self.coarse, &wanted, Mending::Some, ctx)?,
        };
        if printing.was_given_up {
            return Ok(None);
        }
        let after = (stock.cuts.clone(), stock.cuts.len(), stock.state.clone());
        self.ended(under, after, (printing, wanted.core), before, options, ctx).map(Some)
    }

    /// After some steps (so many of them cuts of the stock, and what those leave) and what is printed next: cuts
    /// of what stands outside the target, those of a round before first, and deposits of what is still
    /// missing.
    pub fn ended(
        &self,
        under: &UnderPlanes,
        (mut steps, cuts, stock): (Vec<Step>, usize, BitGrid),
        (printing, core): (Printing, &BitGrid),
        before: &[Step],
        options: &Options,
        ctx: &Ctx,
    ) -> Result<Attempt, PlanError> {
        let (setting, job) = (self.setting, self.setting.job);
        let reused = &under.volumes.reused;
        let skin = setting.skin(reused);
        let next_job = Job { initial: printing.state, ..job.clone() };
        let next = setting.of_next_round(&next_job, setting.old_of(reused));
        let removed = next_job.initial.minus(&job.target);
        let deep = removed.minus(&skin);
        let samples = options.directions;
        let is_printed = |s: &Step| s.kind == StepKind::Additive;
        let patient = steps.iter().chain(&printing.steps).any(is_printed);
        let way = Cuts { removable: &removed, deep: &deep, samples, before, patient };
        let cutting = cut_blocks(&next, self.coarse, &way, ctx)?;
        let still = Wanted {
            state: &cutting.state,
            added: &printing.unreached,
            core,
            preferred: &along(&under.clips, &self.preferred),
            samples,
            patience: Patience::Endless,
        };
        let last = print_blocks(&next, self.coarse, &still, &[], ctx)?;
        let last = print_crumbs(&next, self.coarse, &still, last, leaves_none, ctx)?;
        for part in [printing.steps, cutting.steps, last.steps] {
            steps = followed(steps, part);
        }
        let excess = cutting.unreached;
        let below = open_below(setting, self.coarse, reused, &excess, ctx)?;
        Ok(Attempt {
            clips: under.clips.clone(),
            volumes: under.volumes.clone(),
            steps,
            cuts,
            stock,
            excess,
            deficit: last.unreached.minus(&skin),
            below,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::local_tests::{job_of, with_run};
    use super::*;
    use crate::base::DVec3;
    use crate::voxel::Frame;

    /// A post on the base and what is added to it, as a job.
    fn job(initial: impl Fn([usize; 3]) -> bool + Sync, more: fn([usize; 3]) -> bool) -> Job {
        const DIMS: [usize; 3] = [46, 40, 30];
        let frame = Frame { pitch: 1.0, dims: DIMS, origin: DVec3::ZERO };
        let target = BitGrid::from_fn(DIMS, |v| initial(v) || more(v));
        job_of(frame, BitGrid::from_fn(DIMS, &initial), target, |_| true)
    }

    fn hangs(job: &Job) -> bool {
        let missing = job.target.minus(&job.initial);
        with_run(job, |run| run.start.mostly_hangs(&job.initial, &missing, run.ctx).unwrap())
    }

    #[test]
    fn what_hangs_in_the_open_asks_for_supports_first() {
        let post = |[x, y, z]: [usize; 3]| x < 14 && (4..36).contains(&y) && z < 24;
        let shelf = |[x, y, z]: [usize; 3]| {
            (14..36).contains(&x) && (10..30).contains(&y) && (16..20).contains(&z)
        };
        assert!(hangs(&job(post, shelf)));
        // Under a roof it is not the lack of supports alone.
        let roof = |v: [usize; 3]| post(v) || v[2] >= 22 && v[2] < 24 && v[0] < 40;
        assert!(!hangs(&job(roof, shelf)));
        // And a little is mended otherwise.
        let nub = |[x, y, z]: [usize; 3]| {
            (14..18).contains(&x) && (18..22).contains(&y) && (16..18).contains(&z)
        };
        assert!(!hangs(&job(post, nub)));
    }
}
