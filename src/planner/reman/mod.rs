//! Remanufacturing an initial part M into a target part M* (W2V: *Waste-to-Value: Reutilized
//! Material Maximization for Additive and Subtractive Hybrid Remanufacturing*).
//!
//! | symbol | here | meaning |
//! |---|---|---|
//! | Ṽ_R, Ṽ_S, Ṽ_A | [`Volumes`] | M ∩ M*, M − M*, M* − M |
//! | V_T | target material above the planes | removed first, added again |
//! | B̃, b_i | [`PrintingBase`] | the interface of Ṽ_R and Ṽ_A, its components |
//! | c̃_ij, W_ij, ℂ | `candidates` | candidate planes, their weights, the chosen ones |
//! | V_S, V_A | `cutting`, `printing` | Ṽ_S + V_T in blocks, Ṽ_A + V_T in blocks |
//!
//! Stages, in the paper's order: volumes and bases (Sec. 3.1; [`crate::region`]), candidate planes
//! and set cover (Sec. 4.1; `candidates`), planes that make every region accessible (Sec. 4.2;
//! here), blocks (Sec. 6; `cutting`, `printing`). Local planes and the Monte Carlo tree search of
//! Sec. 4.2 belong between the last two and are not built yet: every plane is global.
//!
//! What differs from the paper, and why:
//! - Volumes are voxel sets, so no Boolean can fail on nearly coincident surfaces (its Sec. 7.5).
//! - Accessibility is judged by making the blocks, not by sampled points: what the blocks leave
//!   becomes a further element to cover, and the set cover is solved anew. Only when that changes
//!   nothing do the planes move, by 30 % of their distance to the base as in the paper.
//! - Additive blocks are what one direction lays from below on the state before it, the largest
//!   first; the paper takes two decompositions from elsewhere.
//!   While little is left, printing is tried again with a later block's space left free.
//! - A cut that would free a piece it does not reach leaves a bridge to it (`bridges`).
//! - Directions are ranked on a coarser grid (`coarse`), and the blocks made on the job's own.
//!
//! Guarantees: each step's voxels are accessible, carried and clear when the step is made, by the
//! conservative maps of [`crate::access`]. Not guaranteed: that the residual is zero, or that the
//! reused volume is the largest possible.

pub(super) mod bridges;
mod candidates;
mod coarse;
mod cutting;
mod laying;
mod printing;
mod reasons;
mod round;
mod setting;

use crate::base::{Ctx, Direction, fibonacci_sphere};
use crate::machine::HoldingMode;
use crate::plan::{Job, Plan, Plane};
use crate::planner::PlanError;
use crate::region::{PrintingBase, Volumes, printing_bases};
use crate::voxel::{BitGrid, Connectivity, components};
use candidates::{Element, cover};
use coarse::Coarse;
use reasons::reasons;
use round::{Attempt, attempt, deep, volumes};
use setting::Setting;
use std::time::Instant;

#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Sampled directions per hemisphere, and normals of candidate planes (W2V Sec. 7.1: 100).
    pub directions: usize,
}

impl Default for Options {
    fn default() -> Self {
        Options { directions: 100 }
    }
}

/// What a run tells beside its plan; names as in W2V Tables 1 and 2.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Report {
    /// B: height of the lowest point of the bases over the base plane, by M's height.
    pub base_height_ratio: Option<f64>,
    /// #P_S, #P_A: cells of 2 mm with deep material out of reach while all of V_R^C stands.
    pub inaccessible_sm: usize,
    pub inaccessible_am: usize,
    /// R_I: volume of V_R^C by the target's.
    pub reuse_initial: f64,
    /// #C_b.
    pub planes_global: usize,
    /// #C_a.
    pub planes_local: usize,
    /// Stage names and wall seconds.
    pub seconds: Vec<(&'static str, f64)>,
    pub notes: Vec<String>,
}

/// Rounds of cover, cut and print; the second covers what the first could not reach. A part that
/// needs more ends with its residual: on real brackets a third round never left less, since each
/// plane gives up more, and more is then hard to print.
const ROUNDS: usize = 2;

/// A round that leaves more than this share of the target is the last: on real brackets such a
/// plan is not mended by another plane, and the round costs as much as the first.
const MENDABLE_SHARE: f64 = 0.02;

/// Share of its distance to the base by which a plane moves when a new cover changes nothing.
const SHIFT_SHARE: f64 = 0.3;

/// Edge in mm of the cells in which inaccessible material is counted (W2V samples every 2 mm).
const COUNT_CELL_MM: f64 = 2.0;

/// Plans the job; what could not be reached is left for the verifier to measure.
pub fn plan(job: &Job, options: &Options, ctx: &Ctx) -> Result<(Plan, Report), PlanError> {
    check(job)?;
    let setting = Setting::new(job);
    let coarse = Coarse::of(job);
    let mut report = Report::default();
    let mut clock = Clock::default();
    let first = volumes(job, &[]);
    let (_, added) = deep(job, &first);
    let bases = printing_bases(&first.reused, &added, &job.initial_mesh, &job.frame);
    report.base_height_ratio = base_height_ratio(job, &bases);
    let mut preferred = vec![Direction::Z];
    let good = bases.iter().filter(|b| b.plano_convex);
    preferred.extend(good.flat_map(|b| b.facets.iter().map(|f| f.normal)));
    let mut elements: Vec<Element> = bases
        .iter()
        .filter(|b| !b.plano_convex)
        .map(|b| Element { points: b.points.clone() })
        .collect();
    clock.lap("graph");
    let normals = plane_normals(job, options.directions);
    let mut planes = choose(&setting, &first, &elements, &normals, &mut report)?;
    clock.lap("set_cover");
    let mut best: Option<Attempt> = None;
    for round in 0..ROUNDS {
        ctx.check()?;
        let attempt = attempt(&setting, &coarse, planes.clone(), &preferred, options, ctx)?;
        clock.lap("blocks");
        if round == 0 {
            let share = attempt.volumes.reused.count() as f64 / job.target.count() as f64;
            report.reuse_initial = share;
            report.inaccessible_sm = cells(job, &attempt.excess);
            report.inaccessible_am = cells(job, &attempt.deficit);
        }
        tracing::debug!(
            round,
            planes = attempt.planes.len(),
            reused = attempt.volumes.reused.count(),
            excess = attempt.excess.count(),
            deficit = attempt.deficit.count(),
            steps = attempt.steps.len(),
            laps = ?clock.laps,
            "round"
        );
        let residual = attempt.residual();
        let hopeless = residual as f64 > MENDABLE_SHARE * job.target.count() as f64;
        let done = residual == 0 || hopeless;
        if best.as_ref().is_none_or(|b| attempt.rank(job) < b.rank(job)) {
            best = Some(attempt);
        }
        if done || ctx.out_of_time() {
            break;
        }
        elements
            .extend(best.iter().flat_map(|b| clusters(job, &b.excess.minus(&b.below), &b.deficit)));
        let next = choose(&setting, &first, &elements, &normals, &mut report)?;
        planes = if next == planes { shifted(&setting, &planes) } else { next };
        clock.lap("set_cover");
    }
    let Some(best) = best else { return Err(PlanError::Cancelled) };
    report.planes_global = best.planes.len();
    let (excess, deficit) = (&best.excess, &best.deficit);
    report.notes.extend(reasons(&setting, excess, &best.below, deficit));
    report.seconds = clock.laps;
    let mut steps = best.steps;
    let holdings = setting.numbered(&mut steps);
    Ok((Plan { holdings, steps }, report))
}

fn check(job: &Job) -> Result<(), PlanError> {
    let pitch_mm = job.frame.pitch;
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

fn choose(
    setting: &Setting,
    first: &Volumes,
    elements: &[Element],
    normals: &[Direction],
    report: &mut Report,
) -> Result<Vec<Plane>, PlanError> {
    let found = cover(setting, &first.reused, elements, normals)?;
    // The last cover knows all regions, so its note stands for those before it.
    report.notes.clear();
    if !found.uncovered.is_empty() {
        report.notes.push(format!(
            "{} of {} regions lie beside the base contact and no clipping plane clears them",
            found.uncovered.len(),
            elements.len()
        ));
    }
    Ok(found.planes)
}

/// Every plane moved toward the base by a share of its distance to it.
fn shifted(setting: &Setting, planes: &[Plane]) -> Vec<Plane> {
    let job = setting.job;
    let contact = setting.holdings[0].contact(&job.ideal_reuse(), &job.frame, job.rules.grip_mm);
    planes
        .iter()
        .map(|p| {
            let base = contact
                .iter_ones()
                .map(|v| p.normal.dot(job.frame.center(v)))
                .fold(f64::NEG_INFINITY, f64::max);
            let distance = (p.offset - base).max(0.0);
            Plane { normal: p.normal, offset: p.offset - SHIFT_SHARE * distance }
        })
        .collect()
}

/// Each connected piece of what is left, as an element to cover.
fn clusters(job: &Job, excess: &BitGrid, deficit: &BitGrid) -> Vec<Element> {
    let mut elements = Vec::new();
    for left in [excess, deficit] {
        let parts = components(left, Connectivity::Corner26);
        let mut points = vec![Vec::new(); parts.count()];
        for v in left.boundary().iter_ones() {
            if let Some(l) = parts.label_of(v) {
                points[l as usize].push(job.frame.center(v));
            }
        }
        elements.extend(points.into_iter().map(|points| Element { points }));
    }
    elements
}

fn base_height_ratio(job: &Job, bases: &[PrintingBase]) -> Option<f64> {
    let lowest = bases.iter().flat_map(|b| &b.points).map(|p| p.z).reduce(f64::min)?;
    let (_, top) = job.initial.extent()?;
    Some(lowest / (job.frame.center(top).z + job.frame.pitch / 2.0))
}

/// Number of 2 mm cells that hold any of `set`.
fn cells(job: &Job, set: &BitGrid) -> usize {
    let n = (COUNT_CELL_MM / job.frame.pitch).round().max(1.0) as usize;
    let mut seen = std::collections::BTreeSet::new();
    set.iter_ones().for_each(|v| {
        seen.insert(v.map(|c| c / n));
    });
    seen.len()
}

/// Wall seconds per stage, summed over rounds.
struct Clock {
    since: Instant,
    laps: Vec<(&'static str, f64)>,
}

impl Default for Clock {
    fn default() -> Self {
        Clock { since: Instant::now(), laps: Vec::new() }
    }
}

impl Clock {
    fn lap(&mut self, stage: &'static str) {
        let now = Instant::now();
        let seconds = (now - self.since).as_secs_f64();
        self.since = now;
        match self.laps.iter_mut().find(|(s, _)| *s == stage) {
            Some(l) => l.1 += seconds,
            None => self.laps.push((stage, seconds)),
        }
    }
}
