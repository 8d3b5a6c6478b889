//! One round of the planner: planes are given; cut, then print.

use super::around::print_around;
use super::backward::print_backward;
use super::clip::Clip;
use super::coarse::Coarse;
use super::cutting::{Cuts, cut_blocks};
use super::locals::WORTH_SHARE;
use super::printing::{
    MOST_CRUMBS, Patience, Printing, Share, Wanted, leaves_none, print_along_axes, print_blocks,
    print_crumbs,
};
use super::reasons::{open_below, reasons};
use super::setting::Setting;
use super::{MENDABLE_SHARE, Options, Standing, Start};
use crate::base::{Ctx, Direction};
use crate::plan::{Job, Plan, Step, StepKind, end_state};
use crate::planner::PlanError;
use crate::region::Volumes;
use crate::voxel::{BitGrid, Connectivity, components};

/// Printing is tried again, with some space left free, while all tries together lay at most so
/// many voxels: seconds on two cores. Large parts get none, they would wait for minutes.
const MENDING_VOXELS: usize = 400_000;

/// Where little is left, up to so many voxels are printed once more along the axes first whatever else may be tried: that
/// halved what was missing on a thread and took two seconds.
const AXES_VOXELS: usize = 4_000_000;

/// What is left standing or missing counts as much as so many times its volume printed anew: it is
/// work by hand, or scrap. At 1 a plan would rather miss the tip of an ear than print it.
pub const RESIDUAL_WEIGHT: usize = 10;

/// Share of the target that may be given up to leave nothing at all.
pub const COMPLETION_SHARE: f64 = 0.05;

/// One round: planes, and the blocks made under them.
#[derive(Clone)]
pub struct Attempt {
    pub clips: Vec<Clip>,
    pub volumes: Volumes,
    pub steps: Vec<Step>,
    /// The steps that come before the first deposit, and what they leave.
    pub cuts: usize,
    pub stock: BitGrid,
    /// Deep material left standing or missing.
    pub excess: BitGrid,
    pub deficit: BitGrid,
    /// The part of the excess that is open only below: no plane mends that, another holding does.
    pub below: BitGrid,
}

impl Attempt {
    /// Voxels left that a plane could mend.
    pub fn residual(&self) -> usize {
        self.excess.count() - self.below.count() + self.deficit.count()
    }

    /// All voxels left.
    pub fn left(&self) -> usize {
        self.excess.count() + self.deficit.count()
    }

    /// What stands after all its steps.
    pub fn end(&self, job: &Job) -> BitGrid {
        let plan = Plan { holdings: Vec::new(), steps: self.steps.clone() };
        end_state(job, &plan).state
    }

    /// Why it left what it left.
    pub fn reasons(&self, setting: &Setting) -> Vec<String> {
        reasons(setting, &self.excess, &self.below, &self.deficit)
    }

    /// Says how it went.
    pub fn tell(&self, route: &str, round: usize) {
        tracing::debug!(
            route,
            round,
            planes = self.clips.len(),
            reused = self.volumes.reused.count(),
            excess = self.excess.count(),
            deficit = self.deficit.count(),
            steps = self.steps.len(),
            "round"
        );
    }

    /// Complete before valid before neither; complete ones by what they give up, valid ones by what
    /// they give up and, [`RESIDUAL_WEIGHT`] times, by what they leave, the others by what they
    /// leave. What is open only below counts against what the rules allow unless it is more than that by itself,
    /// where no plan is valid.
    pub fn rank(&self, job: &Job) -> (u8, usize) {
        let (allowed, below) = (allowed(job), self.below.count());
        let allowed = allowed.checked_sub(below).unwrap_or(allowed);
        ranked(job, self.volumes.reused.count(), self.residual(), allowed)
    }

    /// What it gives up and, [`RESIDUAL_WEIGHT`] times, what it leaves, in voxels.
    pub fn loss(&self, job: &Job) -> usize {
        let given_up = job.target.count().saturating_sub(self.volumes.reused.count());
        given_up + RESIDUAL_WEIGHT * self.residual()
    }

    /// How it stands beside the plans of other placements of the target when so many voxels are
    /// reused. Another placement may have no pockets that are open only below, so here all that is
    /// left counts.
    pub fn standing(&self, job: &Job, reused: usize) -> Standing {
        let (class, _) = ranked(job, reused, self.left(), allowed(job));
        let given_up = job.target.count().saturating_sub(reused);
        let [given_up_mm3, left_mm3] =
            [given_up, self.left()].map(|n| n as f64 * job.frame.voxel_volume());
        Standing { class, given_up_mm3, left_mm3 }
    }

    /// Whether it is a better plan of the same parts than another, whatever may be held of what is open only below.
    pub fn comes_before(&self, other: &Attempt, job: &Job) -> bool {
        let standing = |a: &Attempt| a.standing(job, a.volumes.reused.count());
        standing(self) < standing(other)
    }

    /// Voxels of its additive steps and those it misses.
    pub fn printed(&self) -> usize {
        let additive = self.steps.iter().filter(|s| s.kind == StepKind::Additive);
        additive.map(|s| s.region.count()).sum::<usize>() + self.deficit.count()
    }

    /// Whether it leaves so little that no plane is worth giving anything up for it.
    pub fn leaves_crumbs(&self, job: &Job) -> bool {
        self.left() as f64 <= MOST_CRUMBS * job.target.count() as f64
    }

    /// Whether it keeps more than another by what makes other planes worth a try.
    pub fn keeps_more_than(&self, other: &Attempt, job: &Job) -> bool {
        let more = self.volumes.reused.count() as f64 - other.volumes.reused.count() as f64;
        more >= WORTH_SHARE * job.target.count() as f64
    }

    /// Whether what it leaves is within the rules' deviation.
    pub fn is_valid(&self, job: &Job) -> bool {
        self.rank(job).0 < 2
    }

    /// The same with what is open only below left out: exact distances may yet show a way to it.
    pub fn may_be_valid(&self, job: &Job) -> bool {
        self.residual() <= allowed(job)
    }

    /// Voxels that a plan with less residual may give up more and still be worth a try; none where
    /// it may give up all.
    pub fn worth(&self, job: &Job) -> Option<usize> {
        let (rank, residual) = (self.rank(job).0, self.residual());
        let share = (COMPLETION_SHARE * job.target.count() as f64) as usize;
        (rank < 2).then_some(share.max(RESIDUAL_WEIGHT * residual))
    }
}

/// How many voxels the rules allow to be left.
fn allowed(job: &Job) -> usize {
    (job.rules.deviation * job.target.count() as f64) as usize
}

/// What [`Attempt::rank`] says of so many voxels reused and left where so many may be left.
fn ranked(job: &Job, reused: usize, left: usize, allowed: usize) -> (u8, usize) {
    let given_up = job.target.count().saturating_sub(reused);
    match left {
        0 => (0, given_up),
        n if n <= allowed => (1, given_up + RESIDUAL_WEIGHT * n),
        n => (2, n),
    }
}

/// Planes, and the volumes under them.
#[derive(Clone)]
pub struct UnderPlanes {
    pub clips: Vec<Clip>,
    pub volumes: Volumes,
}

impl UnderPlanes {
    /// Those of an attempt, and what it makes of them.
    pub fn of_attempt(made: &Attempt) -> Self {
        UnderPlanes { clips: made.clips.clone(), volumes: made.volumes.clone() }
    }

    pub fn of(job: &Job, clips: Vec<Clip>) -> Self {
        UnderPlanes { volumes: volumes(job, &clips), clips }
    }
}

/// How often printing is tried again where it leaves a little.
#[derive(Clone, Copy, PartialEq)]
pub enum Mending {
    /// As long as [`MENDING_VOXELS`] allow.
    Some,
    /// Never: for a look at what planes are worth.
    None,
    /// Nor are small blocks made where more is left than the rules allow: for a look at which of
    /// several choices of planes is the best.
    Glance,
}

impl Start<'_> {
    /// Makes the blocks under some planes on the job's own grid, printing again where a little is
    /// left.
    pub fn attempt(
        &self,
        clips: Vec<Clip>,
        options: &Options,
        ctx: &Ctx,
    ) -> Result<Attempt, PlanError> {
        let how = (options, Mending::Some);
        attempt(self.setting, self.coarse, clips, &self.preferred, how, ctx)
    }
}

/// Makes the blocks under some planes.
pub fn attempt(
    setting: &Setting,
    coarse: &Coarse,
    clips: Vec<Clip>,
    preferred: &[Direction],
    how: (&Options, Mending),
    ctx: &Ctx,
) -> Result<Attempt, PlanError> {
    let under = UnderPlanes::of(setting.job, clips);
    attempt_under(setting, coarse, under, preferred, how, ctx)
}

/// Makes the blocks of some volumes.
pub fn attempt_under(
    setting: &Setting,
    coarse: &Coarse,
    under: UnderPlanes,
    preferred: &[Direction],
    (options, mending): (&Options, Mending),
    ctx: &Ctx,
) -> Result<Attempt, PlanError> {
    let job = setting.job;
    let UnderPlanes { clips, volumes } = under;
    let (deep_removed, added) = deep(setting, &volumes);
    let along = along(&clips, preferred);
    let cuts = Cuts {
        removable: &volumes.removed,
        deep: &deep_removed,
        samples: options.directions,
        before: &[],
        patient: !added.is_empty(),
    };
    let cutting = cut_blocks(setting, coarse, &cuts, ctx)?;
    // Material given up because nothing would hold it may be skin that no cut took: it stands.
    let added = added.minus(&cutting.state);
    let skin = setting.skin(&volumes.reused);
    let wanted = Wanted {
        state: &cutting.state,
        added: &added,
        core: &added.minus(&skin),
        preferred: &along,
        samples: options.directions,
        patience: match mending {
            Mending::Glance => Patience::AtAGlance,
            Mending::None | Mending::Some => Patience::Endless,
        },
    };
    let printing = printed(setting, coarse, &wanted, mending, ctx)?;
    let deficit = printing.unreached.minus(&skin);
    let excess = cutting.unreached.minus(&job.target);
    let below = open_below(setting, coarse, &volumes.reused, &excess, ctx)?;
    let cuts = cutting.steps.len();
    let mut steps = cutting.steps;
    steps.extend(printing.steps);
    Ok(Attempt { clips, volumes, steps, cuts, stock: cutting.state, excess, deficit, below })
}

/// Directions in which blocks are tried first: the planes' normals before the others.
pub fn along(clips: &[Clip], preferred: &[Direction]) -> Vec<Direction> {
    clips.iter().map(|c| c.plane.normal).chain(preferred.iter().copied()).collect()
}

/// Prints, the largest block first; where that leaves anything, along the axes first, and where that leaves more than
/// crumbs, in an order found from its end, and all around where that leaves anything; while the best of these leaves a
/// little, once more with the space of some later block left free from the beginning, and so on with the best of these;
/// what little that leaves in the end, in blocks however small.
pub fn printed(
    setting: &Setting,
    coarse: &Coarse,
    wanted: &Wanted,
    mending: Mending,
    ctx: &Ctx,
) -> Result<Printing, PlanError> {
    let left = |p: &Printing| p.unreached.count_and(wanted.core);
    let mut shares: Vec<Share> = Vec::new();
    let mut best = print_blocks(setting, coarse, wanted, &shares, ctx)?;
    let most = (MENDABLE_SHARE * setting.job.target.count() as f64) as usize;
    let most_voxels = match mending {
        Mending::Some => MENDING_VOXELS,
        Mending::None | Mending::Glance => 0,
    };
    let mut tries = most_voxels / wanted.core.count().max(1);
    let little = (1..=most).contains(&left(&best));
    let is_small = mending == Mending::Some && wanted.core.count() <= AXES_VOXELS;
    if left(&best) > 0 && tries > 0 || little && is_small && !ctx.out_of_time() {
        tries = tries.saturating_sub(1);
        let other = print_along_axes(setting, coarse, wanted, ctx)?;
        tracing::debug!(left = left(&other), best = left(&best), "along axes");
        if left(&other) < left(&best) {
            best = other;
        }
    }
    // Crumbs are asked singly later, which takes less.
    let more_than_crumbs = left(&best) as f64 > MOST_CRUMBS * setting.job.target.count() as f64;
    if more_than_crumbs && (tries > 0 || little && is_small) && !ctx.out_of_time() {
        tries = tries.saturating_sub(1);
        let other = print_backward(setting, coarse, wanted, ctx)?;
        if let Some(other) = other.filter(|o| left(o) < left(&best)) {
            tracing::debug!(left = left(&other), best = left(&best), "backward");
            best = other;
        }
        if left(&best) > 0 && !ctx.out_of_time() {
            let other = print_around(setting, coarse, wanted, ctx)?;
            if let Some(other) = other.filter(|o| left(o) < left(&best)) {
                tracing::debug!(left = left(&other), best = left(&best), "around");
                best = other;
            }
        }
    }
    'mending: while (1..=most).contains(&left(&best)) {
        for share in best.shares.iter().skip(1) {
            if tries == 0 || ctx.out_of_time() {
                break 'mending;
            }
            tries -= 1;
            let mut more = shares.clone();
            more.push(share.clone());
            let other = print_blocks(setting, coarse, wanted, &more, ctx)?;
            tracing::debug!(
                shares = more.len(),
                left = left(&other),
                best = left(&best),
                "mending"
            );
            if left(&other) < left(&best) {
                (best, shares) = (other, more);
                continue 'mending;
            }
        }
        break;
    }
    if mending == Mending::Some {
        best = print_crumbs(setting, coarse, wanted, best, leaves_none, ctx)?;
    }
    Ok(best)
}

/// What some steps cut, or lay, in all.
pub fn all_of(job: &Job, steps: &[Step]) -> BitGrid {
    let mut all = BitGrid::new(job.frame.dims);
    steps.iter().for_each(|s| all.union_with(&s.region));
    all
}

/// The volumes when everything above the planes is given up.
pub fn volumes(job: &Job, clips: &[Clip]) -> Volumes {
    let ideal = job.ideal_reuse();
    let mut reusable = ideal.clone();
    clips.iter().for_each(|c| reusable.subtract(&c.clipped(&ideal, &job.frame)));
    let rules = &job.rules;
    Volumes::keeping(&job.initial, &job.target, &reusable, &job.frame, rules.holding, rules.grip_mm)
}

/// Removed and added material that counts: the removed beyond skin, and every body of the added
/// that has some beyond skin.
pub fn deep(setting: &Setting, volumes: &Volumes) -> (BitGrid, BitGrid) {
    let job = setting.job;
    let skin = setting.skin(&volumes.reused);
    let removed = volumes.removed.minus(&skin);
    let core = volumes.added.minus(&skin);
    let bodies = components(&volumes.added, Connectivity::Corner26);
    let mut counts = vec![false; bodies.count()];
    for v in core.iter_ones() {
        if let Some(l) = bodies.label_of(v) {
            counts[l as usize] = true;
        }
    }
    let mut added = BitGrid::new(job.frame.dims);
    for v in volumes.added.iter_ones() {
        if bodies.label_of(v).is_some_and(|l| counts[l as usize]) {
            added.set(v, true);
        }
    }
    (removed, added)
}
