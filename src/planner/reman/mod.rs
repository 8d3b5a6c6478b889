//! Remanufacturing an initial part M into a target part M* (W2V: *Waste-to-Value: Reutilized
//! Material Maximization for Additive and Subtractive Hybrid Remanufacturing*).
//!
//! | symbol | here | meaning |
//! |---|---|---|
//! | Ṽ_R, Ṽ_S, Ṽ_A | [`crate::region::Volumes`] | M ∩ M*, M − M*, M* − M |
//! | V_T | target material above the planes | removed first, added again |
//! | B̃, b_i | [`PrintingBase`] | the interface of Ṽ_R and Ṽ_A, its components |
//! | c̃_ij, W_ij, ℂ | `candidates` | candidate planes, their weights, the chosen ones |
//! | V_S, V_A | `cutting`, `printing` | Ṽ_S + V_T in blocks, Ṽ_A + V_T in blocks |
//! | c_i^L, ℂ^L | `clip`, `local`, `refine` | local planes, and their choice |
//!
//! Stages, in the paper's order: volumes and bases (Sec. 3.1; [`crate::region`]), candidate planes
//! and set cover (Sec. 4.1; `candidates`), global planes that make every region accessible (Sec.
//! 4.2; `global`), local planes by Monte Carlo tree search over the collision dependency graph
//! (Sec. 4.2, App. B, C; `locals`, `local`, `refine`), blocks (Sec. 6; `cutting`, `printing`).
//! `compared` has the strategies of its Fig. 14.
//!
//! What differs from the paper, and why:
//! - Volumes are voxel sets, so no Boolean can fail on nearly coincident surfaces (its Sec. 7.5).
//! - Accessibility is judged by making the blocks, not by sampled points: what the blocks leave
//!   becomes a further element to cover, and the set cover is solved anew. Only when that changes
//!   nothing do the planes move, by 30 % of their distance to the base as in the paper.
//! - Local planes are looked for where blocks left something, not by splitting the global planes,
//!   and only where those gave up more than half a per cent of the target or left something: a base
//!   that is not plano-convex can often be printed all the same, in several blocks.
//! - A plan with nothing left comes before one with a residual within the rules, and of the latter
//!   a voxel left counts as ten printed anew.
//! - Additive blocks are what one direction lays from below on the state before it, the largest
//!   first; the paper takes two decompositions from elsewhere.
//!   While little is left, printing is tried again with a later block's space left free.
//! - On request (`rounds`) what a round of cuts and deposits left gets a round of its own: the
//!   state it ends in is the initial part of the next, in which only what still stands of the real
//!   one counts as reused. The paper names such rounds as future work.
//! - Where something would be left, raw stock under the planes stands until all is printed, the part
//!   is printed on supports, and both are cut at the end, with slender tools if need be, if that
//!   leaves less (`last_resort`); of large parts at once, where a coarse look says that the rules'
//!   deviation cannot be met without. The paper does without supports, to save their material.
//! - Over pockets out of which no supports could be cut, roofs grow out of the walls along leaning directions
//!   (`printing::roofs`).
//! - Where global planes leave more than the rules allow and give something up, and supports would not
//!   mend that, all is printed on the part as it is, before any cut (`printed_first`).
//! - What of Ṽ_R hangs on nothing is not given up where deposits can hold it before the last of what carries it is cut
//!   (`hanging`); the paper gives it up.
//! - Where so much stock stands that no plan is valid, it is opened by slim cones from above before planes give more up
//!   (`last_resort::opened`).
//! - The small cuts of a plan give way to an exact cover of what they took (`fewest`).
//! - What a plan still misses beside reused material is opened by pits and printed with it (`pits`). Where planes
//!   give up much, all is planned that way with nothing given up at first (`keeping`); where that turns out well,
//!   no plan under planes is made.
//! - What a cutter has no room for beside the surfaces (`room`) is left to a slimmer one (`fitting`) or cut
//!   along another direction (`tilting`); of skin that is left to none, what need not go stands (`spared`).
//! - A long cut by a slender cutter is roughed with a stouter one first (`roughing`).
//! - Which of several placements is worth a plan is judged by blocks on the coarse grid (`glance`).
//! - On request (`finish_mm`) deposits get an allowance that cutters take off again (`finish`); the
//!   paper names a finishing cut as future work.
//! - A placement found by search is moved on where the reused volume would hide a little of what is to
//!   be printed, or a little of it would hang just over the base (`hidden`).
//! - With a second holding, planes that leave the part on its base are looked at beside all others:
//!   deposits from straight above may then begin on the bare base.
//! - What of the initial part hangs on nothing on the grid goes with a first cut (`loose`).
//! - A cut that would free a piece it does not reach leaves a bridge to it (`bridges`).
//! - Additive blocks have a least size, but where crumbs are all that is missing they get blocks of
//!   their own, however small (`crumbs`).
//! - Directions are ranked on a coarser grid (`coarse`), and the blocks made on the job's own.
//!
//! Guarantees: each step's voxels are accessible, carried and clear when the step is made, by the
//! conservative maps of [`crate::access`]. Not guaranteed: that the residual is zero, or that the
//! reused volume is the largest possible.

mod around;
mod aside;
mod backward;
pub(super) mod bridges;
mod candidates;
mod clip;
mod close;
mod coarse;
mod crumbs;
mod compared;
mod cone;
mod cutting;
mod fewest;
mod finish;
mod fitting;
mod glance;
mod global;
mod hanging;
mod hidden;
mod keeping;
mod last_resort;
mod laying;
mod local;
#[cfg(test)]
mod local_tests;
mod locals;
mod loose;
mod patches;
mod pits;
mod printed_first;
mod printing;
mod reach;
mod reasons;
mod refine;
mod report;
mod room;
mod roughing;
mod round;
mod setting;
mod spared;
mod supports;
mod tilting;
#[cfg(test)]
mod supports_tests;

use crate::base::{Ctx, Direction, fibonacci_sphere};
use crate::machine::HoldingMode;
use crate::plan::{Job, Plan, Plane, Step, StepKind, end_state};
use crate::planner::PlanError;
use crate::region::{PrintingBase, Volumes, printing_bases};
pub use glance::glance;
pub use hidden::shift_off_hidden;

use candidates::{Admissible, Element};
use clip::Clip;
use coarse::Coarse;
use compared::{bottom_up, top_down};
use crumbs::with_crumbs;
use fewest::with_fewest_cuts;
use finish::finished;
use fitting::fitted;
use global::{choose, global_route, most_promising};
use hanging::with_what_hangs;
use keeping::{keeping_more, kept_at_first};
use last_resort::{last_resort, on_supports, with_standing_opened};
use locals::{improved, is_complete, local_route};
use loose::first_cut;
use pits::with_pits;
use printed_first::{Leaves, glimpse, printed_first};
use report::Clock;
pub use report::Report;
use room::Room;
use roughing::roughed;
pub use round::COMPLETION_SHARE;
use round::{Attempt, RESIDUAL_WEIGHT, UnderPlanes, deep, volumes};
use setting::Setting;
use spared::spared;
use std::cmp::Ordering;
use tilting::tilted;

#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Sampled directions per hemisphere, and normals of candidate planes (W2V Sec. 7.1: 100).
    pub directions: usize,
    /// Choices of local planes that a search judges (W2V Sec. 7.1: 500).
    pub iterations: usize,
    pub search: Search,
    pub cover: CoverMethod,
    /// Rounds of cuts and then deposits, as long as one leaves less than the one before.
    pub rounds: usize,
    /// Whether deposits may stand on supports that are cut away again.
    pub supports: bool,
    /// How far a printing base may be concave, mm, and still get no clipping plane.
    pub base_tolerance_mm: f64,
    /// Allowance on what is printed that cutters take off again, mm; 0 for none.
    pub finish_mm: f64,
    pub seed: u64,
}

/// How planes are placed (W2V Fig. 14, 16).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Search {
    /// Local planes by Monte Carlo tree search.
    #[default]
    Mcts,
    /// Local planes drawn at random.
    Random,
    /// The global planes of the set cover, all shifted toward the base until everything is reached.
    TopDown,
    /// One global plane, moved outward from nothing reused as long as everything is reached.
    BottomUp,
}

/// How clipping planes are chosen for the bases (W2V Fig. 15).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CoverMethod {
    /// Least weight, proven.
    #[default]
    Ilp,
    /// Base by base the lightest plane that covers it.
    Greedy,
    /// The lightest plane that covers them all; where there is none, of least weight.
    Single,
}

impl Default for Options {
    fn default() -> Self {
        Options {
            directions: 100,
            iterations: 500,
            search: Search::Mcts,
            cover: CoverMethod::Ilp,
            rounds: 1,
            supports: true,
            base_tolerance_mm: 0.0,
            finish_mm: 0.0,
            seed: 0,
        }
    }
}

/// How a plan stands beside others of the same parts: of two the lesser is the better one, complete
/// before within the rules' deviation before neither.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Standing {
    /// 0 complete, 1 within the rules, 2 neither.
    pub class: u8,
    /// Volume of the target that is not reused, mm³.
    pub given_up_mm3: f64,
    /// Volume left standing or missing, mm³.
    pub left_mm3: f64,
}

impl Standing {
    /// What is given up and, ten times, what is left, mm³.
    pub fn loss_mm3(&self) -> f64 {
        self.given_up_mm3 + RESIDUAL_WEIGHT as f64 * self.left_mm3
    }
}

impl PartialOrd for Standing {
    /// Of those that are neither the one that leaves less, of all others the one that loses less.
    fn partial_cmp(&self, other: &Standing) -> Option<Ordering> {
        let key = |s: &Standing| (s.class, if s.class < 2 { s.loss_mm3() } else { s.left_mm3 });
        key(self).partial_cmp(&key(other))
    }
}

/// A round of global planes that leaves more than this share of the target is the last: on real
/// brackets such a plan is not mended by another plane, and the round costs as much as the first.
/// Nor is printing tried again then with some space left free, or cutting more patient.
const MENDABLE_SHARE: f64 = 0.02;

/// Voxels that the plan under global planes prints, above which no local planes are looked for:
/// every trial prints about as many again, which takes a minute there.
const LOCAL_VOXELS: usize = 400_000;

/// What every route starts from.
struct Start<'a> {
    setting: &'a Setting<'a>,
    coarse: &'a Coarse,
    /// Directions in which blocks are tried first.
    preferred: Vec<Direction>,
    /// Printing bases that are not plano-convex.
    bad_bases: Vec<Element>,
}

impl Start<'_> {
    /// The same with other tools or holdings.
    fn in_setting<'b>(&'b self, setting: &'b Setting<'b>) -> Start<'b> {
        let (preferred, bad_bases) = (self.preferred.clone(), self.bad_bases.clone());
        Start { setting, coarse: self.coarse, preferred, bad_bases }
    }
}

/// What a route is handed.
struct Run<'a> {
    start: &'a Start<'a>,
    /// Normals of candidate planes.
    normals: &'a [Direction],
    options: &'a Options,
    /// What supports made of the first planes, where that was looked at before all else.
    on_supports: Option<Attempt>,
    /// What came of printing first, where that was tried and is within the rules.
    printed_first: Option<Attempt>,
    /// What came of cutting first with nothing given up, where that was looked at.
    all_kept: Option<Option<Attempt>>,
    /// What pits made of that, and what is to be told of it, where nothing is left but much was given up.
    all_opened: Option<(Attempt, Vec<String>)>,
    /// The planes of attempts that the last resort was taken to.
    resorted: Vec<Vec<Clip>>,
    report: Report,
    clock: Clock,
    ctx: &'a Ctx,
}

/// Plans the job; what could not be reached is left for the verifier to measure.
pub fn plan(job: &Job, options: &Options, ctx: &Ctx) -> Result<(Plan, Report), PlanError> {
    check(job, options)?;
    let whole = Setting::new(job);
    let (mut steps, report) = match first_cut(&whole, options, ctx)? {
        None => all_rounds(&whole, Vec::new(), options, ctx)?,
        Some(cut) => {
            let initial = job.initial.minus(&cut.region);
            let old = job.ideal_reuse().minus(&cut.region);
            let rest = Job { initial, ..job.clone() };
            all_rounds(&whole.of_next_round(&rest, old), vec![cut], options, ctx)?
        }
    };
    let holdings = whole.numbered(&mut steps);
    Ok((Plan { holdings, steps }, report))
}

/// The steps of all rounds after those of `before`.
fn all_rounds(
    setting: &Setting,
    before: Vec<Step>,
    options: &Options,
    ctx: &Ctx,
) -> Result<(Vec<Step>, Report), PlanError> {
    let job = setting.job;
    let (first, mut report) = one_round(setting, options, ctx)?;
    let mut left = first.residual();
    let mut worth = first.worth(job);
    let mut standing = first.standing(job, first.volumes.reused.count());
    let mut reasons = first.reasons(setting);
    let mut steps = first.steps;
    for round in 2..=options.rounds {
        if left == 0 || ctx.out_of_time() {
            break;
        }
        let so_far = end_state(job, &Plan { holdings: Vec::new(), steps: steps.clone() });
        let kept = so_far.reused.count();
        // What stands now has the surface of the target, but for what is left to do.
        let initial_mesh = job.target_mesh.clone();
        let next_job = Job { initial: so_far.state, initial_mesh, ..job.clone() };
        let next = setting.of_next_round(&next_job, so_far.reused);
        let (made, told) = one_round(&next, options, ctx)?;
        report.add_seconds(&told);
        let lost = kept - next.old_of(&made.volumes.reused).count();
        made.tell("round", round);
        if made.residual() >= left || worth.is_some_and(|w| lost > w) {
            break;
        }
        left = made.residual();
        worth = made.worth(job);
        // What counts as given up is what does not stand of the real initial part.
        standing = made.standing(job, next.old_of(&made.volumes.reused).count());
        reasons = made.reasons(&next);
        report.planes_global += told.planes_global;
        report.planes_local += told.planes_local;
        report.notes.push(format!(
            "Round {round} of cuts and deposits gives up another {:.1} mm³ of the initial part.",
            lost as f64 * job.frame.voxel_volume()
        ));
        steps = followed(steps, made.steps);
    }
    report.notes.extend(reasons);
    report.standing = standing;
    Ok((followed(before, steps), report))
}

/// Steps and those after them, whose blocks are numbered on.
fn followed(mut steps: Vec<Step>, after: Vec<Step>) -> Vec<Step> {
    let of_kind = |kind| steps.iter().filter(|s| s.kind == kind).count();
    let [cuts, deposits] = [StepKind::Subtractive, StepKind::Additive].map(of_kind);
    let first = |kind| if kind == StepKind::Subtractive { cuts } else { deposits };
    steps.extend(after.into_iter().map(|s| Step { block: first(s.kind) + s.block, ..s }));
    steps
}

/// The printing bases, and what follows from them.
struct Bases {
    all: Vec<PrintingBase>,
    /// Directions in which blocks are tried first.
    preferred: Vec<Direction>,
    /// Those that are not plano-convex.
    bad: Vec<Element>,
}

fn bases_of(setting: &Setting, first: &Volumes, options: &Options) -> Bases {
    let job = setting.job;
    let (_, added) = deep(setting, first);
    let tolerance_mm = options.base_tolerance_mm;
    let all = printing_bases(&first.reused, &added, &job.initial_mesh, &job.frame, tolerance_mm);
    let (good, bad): (Vec<_>, Vec<_>) = all.iter().partition(|b| b.plano_convex);
    let mut preferred = vec![Direction::Z];
    preferred.extend(good.iter().flat_map(|b| b.facets.iter().map(|f| f.normal)));
    let bad = bad.iter().map(|b| Element { points: b.points.clone() }).collect();
    Bases { all, preferred, bad }
}

/// One round of cuts and then deposits.
fn one_round(
    setting: &Setting,
    options: &Options,
    ctx: &Ctx,
) -> Result<(Attempt, Report), PlanError> {
    let job = setting.job;
    let coarse = Coarse::of(job);
    let mut report = Report::default();
    let mut clock = Clock::default();
    let first = volumes(job, &[]);
    let Bases { all: bases, preferred, bad: bad_bases } = bases_of(setting, &first, options);
    report.base_height_ratio = base_height_ratio(job, &bases);
    clock.lap("graph");
    let normals = plane_normals(job, options.directions);
    let all = Admissible::all(job, &normals);
    let planes = choose(setting, &first, &bad_bases, &all, options, &mut report)?;
    report.tell_planes(job, &planes);
    clock.lap("set_cover");
    let start = Start { setting, coarse: &coarse, preferred, bad_bases };
    let mut run = Run {
        start: &start,
        normals: &normals,
        options,
        on_supports: None,
        printed_first: None,
        all_kept: None,
        all_opened: None,
        resorted: Vec::new(),
        report,
        clock,
        ctx,
    };
    // The strategies of Fig. 14 are there to compare what planes alone keep.
    let is_compared = matches!(options.search, Search::TopDown | Search::BottomUp);
    let keeps_more = options.finish_mm == 0.0 && !is_compared;
    let clips: Vec<Clip> = planes.iter().map(|p| Clip::global(*p)).collect();
    let under_planes = volumes(job, &clips).reused.count();
    // With little time a plan of what is held comes first.
    let is_first = keeps_more && !ctx.is_limited();
    let mut hanging = if is_first { with_what_hangs(&mut run)? } else { None };
    let kept = match hanging.take_if(|h| h.made.left() == 0) {
        Some(hanging) => Some(hanging.taken(&mut run)?),
        None if keeps_more => kept_at_first(&mut run, under_planes)?,
        None => None,
    };
    let (mut best, mut why, mut aside) = match kept {
        Some(kept) => nothing_given_up(kept, job),
        None => {
            let under = under_planes_or_not(&mut run, planes, &first)?;
            let more = if keeps_more { keeping_more(&mut run, &under.0)? } else { None };
            more.map_or(under, |more| nothing_given_up(more, job))
        }
    };
    if keeps_more && ctx.is_limited() {
        hanging = with_what_hangs(&mut run)?;
    }
    if let Some(hanging) = hanging.filter(|h| h.made.comes_before(&best, job)) {
        (best, why, aside) = nothing_given_up(hanging.taken(&mut run)?, job);
    }
    best = roughed(&mut run, best)?;
    let room = Room::of(job);
    best = fitted(&mut run, &room, best)?;
    best = tilted(&mut run, &room, best)?;
    best = spared(&mut run, &room, best)?;
    run.report.note_supports(job, aside, why);
    let Run { mut report, clock, .. } = run;
    report.planes_local = best.clips.iter().filter(|c| c.seeds.is_some()).count();
    report.seconds = clock.laps;
    Ok((best, report))
}

/// A plan that gave nothing up at first, why it prints supports, and how many voxels of them.
fn nothing_given_up(made: Attempt, job: &Job) -> (Attempt, &'static str, usize) {
    let aside = made.printed_aside(job).count();
    (made, "to carry what nothing else does", aside)
}

/// The best attempt under planes, or with all printed first, why it prints supports, and how many voxels of them.
fn under_planes_or_not(
    run: &mut Run,
    planes: Vec<Plane>,
    first: &Volumes,
) -> Result<(Attempt, &'static str, usize), PlanError> {
    let (job, options) = (run.start.setting.job, run.options);
    let attempts = match options.search {
        Search::Mcts | Search::Random => searched(run, first)?,
        Search::TopDown => vec![top_down(run, planes)?],
        Search::BottomUp => vec![bottom_up(run)?],
    };
    // None printed outside the target but where the plan without supports was passed over.
    let why = match attempts.iter().all(|a| a.printed_aside(job).is_empty()) {
        true => "since without them more is left",
        false => "since by a look on a coarser grid without them more is left",
    };
    let mut best = run.printed_first.take();
    for attempt in attempts {
        // One that leaves more than the rules allow is no way on from one that does not.
        let is_no_way_on = |b: &Attempt| b.is_valid(job) && !attempt.is_valid(job);
        if best.as_ref().is_some_and(|b| is_complete(b, job) || is_no_way_on(b)) {
            break;
        }
        let known = run.on_supports.take();
        let made = last_resort(run, attempt, known)?;
        if best.as_ref().is_none_or(|b| made.rank(job) < b.rank(job)) {
            best = Some(made);
        }
    }
    let mut best = best.ok_or(PlanError::Cancelled)?;
    let aside = best.printed_aside(job).count();
    best = with_fewest_cuts(run, best)?;
    if options.finish_mm > 0.0 {
        best = finished(run, best)?;
    }
    best = with_pits(run, best, None)?;
    Ok((with_crumbs(run, best)?, why, aside))
}

/// Attempts, the best first: with stock opened where much of it stands, else with global planes, and with local ones where
/// those gave up much or left something; none where printing first is enough.
fn searched(run: &mut Run, first: &Volumes) -> Result<Vec<Attempt>, PlanError> {
    let job = run.start.setting.job;
    let normals = run.normals;
    let upright: Vec<Direction> = normals.iter().copied().filter(|n| n.vec().z >= 0.0).collect();
    let mut admissible = vec![Admissible::all(job, normals)];
    if job.rules.holding == HoldingMode::Refixture {
        // Where the part still stands on the base, deposits can begin there as well.
        admissible.push(Admissible { normals: &upright, keeps_base: true });
    }
    let promise = most_promising(run, first, &admissible)?;
    if promise.is_hopeless {
        let clips = promise.planes.iter().map(|p| Clip::global(*p)).collect();
        let under = UnderPlanes::of(job, clips);
        let waits = run.options.supports && !under.clips.is_empty();
        if waits && under.volumes.added.count() > LOCAL_VOXELS {
            run.report.tell_planes(job, &promise.planes);
            run.report.notes = promise.notes;
            let setting = run.start.setting.with_last_resort();
            let start = run.start.in_setting(&setting);
            run.on_supports = Some(on_supports(&start, &under, run.options, run.ctx)?);
            run.clock.lap("blocks");
            if run.on_supports.as_ref().is_some_and(|made| is_complete(made, job)) {
                run.report.note_too_large(under.volumes.added.count());
                return Ok(run.on_supports.take().into_iter().collect());
            }
        }
    }
    let global = global_route(run, first, &promise.admissible)?;
    if let Some(opened) = with_standing_opened(run, &global)?.filter(|o| o.is_valid(job)) {
        return Ok(vec![opened]);
    }
    let kept = global.volumes.reused.count() as f64;
    let most = first.reused.count() as f64;
    let more = most - kept > locals::WORTH_SHARE * job.target.count() as f64;
    if more && run.options.supports && !global.is_valid(job) && !run.ctx.out_of_time() {
        // Where supports under the planes may leave nothing, that is for the last resort.
        let is_hopeful = glimpse(run, &global.clips)? == Leaves::Nothing;
        let made = if is_hopeful { None } else { printed_first(run)? };
        run.printed_first = made.filter(|m| m.is_valid(job));
        if run.printed_first.is_some() {
            return Ok(Vec::new());
        }
    }
    let too_large = global.printed() > LOCAL_VOXELS;
    if too_large && !is_complete(&global, job) {
        run.report.note_too_large(global.printed());
    }
    let enough = too_large || is_complete(&global, job) && !more;
    let local = match !enough && !run.ctx.out_of_time() {
        true => local_route(run, &global)?,
        false => None,
    };
    Ok(match local {
        Some((local, for_supports)) if for_supports || comes_first(&local, &global, job) => {
            vec![local, global]
        }
        _ if enough => vec![global],
        _ => vec![improved(run, global)?],
    })
}

/// Whether a plan with local planes goes on before one with global planes: where it ranks higher, or where it leaves
/// crumbs for more that it keeps. Crumbs are no reason to give more up; the tools of the last resort may leave none.
fn comes_first(local: &Attempt, global: &Attempt, job: &Job) -> bool {
    let is_worth_it = local.leaves_crumbs(job) && local.keeps_more_than(global, job);
    local.rank(job) < global.rank(job) || is_worth_it
}

fn check(job: &Job, options: &Options) -> Result<(), PlanError> {
    let pitch_mm = job.frame.pitch;
    let finish_mm = options.finish_mm;
    if finish_mm > 0.0 && finish_mm < pitch_mm {
        return Err(PlanError::ThinAllowance { finish_mm, pitch_mm });
    }
    for (which, part) in [("initial", &job.initial), ("target", &job.target)] {
        if part.is_empty() {
            return Err(PlanError::EmptyPart { which, pitch_mm });
        }
    }
    if job.cutters.is_empty() {
        return Err(PlanError::NoTool { kind: "subtractive" });
    }
    if job.nozzles.is_empty() {
        return Err(PlanError::NoTool { kind: "additive" });
    }
    Ok(())
}

/// Normals of candidate planes: the upper hemisphere, or the sphere where steps may refixture.
fn plane_normals(job: &Job, count: usize) -> Vec<Direction> {
    let all = fibonacci_sphere(2 * count);
    let mut normals =
        vec![Direction::Z, Direction::X, Direction::NEG_X, Direction::Y, Direction::NEG_Y];
    match job.rules.holding {
        HoldingMode::Base => normals.extend(all.into_iter().filter(|d| d.vec().z >= 0.0)),
        HoldingMode::Refixture => {
            normals.push(Direction::NEG_Z);
            normals.extend(all);
        }
    }
    normals
}

fn base_height_ratio(job: &Job, bases: &[PrintingBase]) -> Option<f64> {
    let lowest = bases.iter().flat_map(|b| &b.points).map(|p| p.z).reduce(f64::min)?;
    let (_, top) = job.initial.extent()?;
    Some(lowest / (job.frame.center(top).z + job.frame.pitch / 2.0))
}
