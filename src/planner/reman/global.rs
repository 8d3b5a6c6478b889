//! Global planes: a cover of the bases that are not plano-convex, then of what the blocks left, and
//! where that changes nothing, planes shifted toward the base (W2V Sec. 4.1, 4.2). Where nothing is printed, what
//! cutters left goes to those of the last resort before another plane gives anything up for it.
//!
//! Guarantees: the cover is of least weight. Not guaranteed: that the shift ends with a plan that
//! reaches everything.

use super::candidates::{Admissible, Element, cover};
use super::clip::Clip;
use super::coarse::Coarse;
use super::last_resort::last_resort;
use super::round::{Attempt, Mending, attempt};
use super::setting::Setting;
use super::{MENDABLE_SHARE, Options, Report, Run, Start};
use crate::plan::{Job, Plane};
use crate::planner::PlanError;
use crate::region::Volumes;
use crate::voxel::{BitGrid, Connectivity, components};

/// Rounds of cover, cut and print; the second covers what the first could not reach. A part that
/// needs more ends with its residual: on real brackets a third round never left less, since each
/// plane gives up more, and more is then hard to print.
const ROUNDS: usize = 2;

/// Share of its distance to the base by which a plane moves when a new cover changes nothing.
const SHIFT_SHARE: f64 = 0.3;

/// A choice of planes, and what its first cover gives.
pub struct Promise<'n> {
    pub admissible: Admissible<'n>,
    pub planes: Vec<Plane>,
    /// Whether the look on the coarse grid, if there was one, says that blocks alone leave more than
    /// the rules allow.
    pub is_hopeless: bool,
    /// What the cover told.
    pub notes: Vec<String>,
}

/// Of several choices of planes the one whose first cover leaves least on the coarse grid; of
/// equals the first. A single one is not looked at.
pub fn most_promising<'n>(
    run: &mut Run,
    first: &Volumes,
    of: &[Admissible<'n>],
) -> Result<Promise<'n>, PlanError> {
    let Run { start, options, report, clock, ctx, .. } = run;
    let mut covers: Vec<Promise> = Vec::new();
    for admissible in of {
        let setting = start.setting;
        let planes = choose(setting, first, &start.bad_bases, admissible, options, report)?;
        if covers.iter().all(|known| known.planes != planes) {
            let (admissible, notes) = (*admissible, report.notes.clone());
            covers.push(Promise { admissible, planes, is_hopeless: false, notes });
        }
    }
    clock.lap("set_cover");
    if covers.len() == 1 {
        return Ok(covers.remove(0));
    }
    let job = start.coarse.as_job();
    let (setting, look) = (Setting::new(&job), Coarse::of(&job));
    let mut best: Option<((u8, usize), Promise)> = None;
    for cover in covers {
        let clips = cover.planes.iter().map(|p| Clip::global(*p)).collect();
        let how = (*options, Mending::Glance);
        let made = attempt(&setting, &look, clips, &start.preferred, how, ctx)?;
        let rank = made.rank(&job);
        tracing::debug!(keeps_base = cover.admissible.keeps_base, ?rank, "cover");
        if best.as_ref().is_none_or(|(r, _)| rank < *r) {
            report.count_inaccessible(&job, &made.excess, &made.deficit);
            let is_hopeless = !made.is_valid(&job);
            best = Some((rank, Promise { is_hopeless, ..cover }));
        }
    }
    clock.lap("blocks");
    best.map(|(_, promise)| promise).ok_or(PlanError::Cancelled)
}

/// The best attempt under global planes.
pub fn global_route(
    run: &mut Run,
    first: &Volumes,
    admissible: &Admissible,
) -> Result<Attempt, PlanError> {
    let (start, options, ctx) = (run.start, run.options, run.ctx);
    let Start { setting, .. } = start;
    let job = setting.job;
    let mut elements = start.bad_bases.clone();
    let mut planes = choose(setting, first, &elements, admissible, options, &mut run.report)?;
    run.report.tell_planes(job, &planes);
    let mut best: Option<Attempt> = None;
    for round in 0..ROUNDS {
        ctx.check()?;
        let clips = planes.iter().map(|p| Clip::global(*p)).collect();
        let mut made = start.attempt(clips, options, ctx)?;
        run.clock.lap("blocks");
        made.tell("global", round);
        if round == 0 {
            run.report.count_inaccessible(job, &made.excess, &made.deficit);
        }
        // What only cutters leave is for slimmer ones, before planes give anything up for it.
        if !made.prints_anything() {
            made = last_resort(run, made, None)?;
        }
        let residual = made.residual();
        let hopeless = residual as f64 > MENDABLE_SHARE * job.target.count() as f64;
        let done = residual == 0 || hopeless;
        if best.as_ref().is_none_or(|b| made.rank(job) < b.rank(job)) {
            best = Some(made);
        }
        if done || ctx.out_of_time() {
            break;
        }
        elements
            .extend(best.iter().flat_map(|b| clusters(job, &b.excess.minus(&b.below), &b.deficit)));
        let next = choose(setting, first, &elements, admissible, options, &mut run.report)?;
        planes = if next == planes { shifted(setting, &planes) } else { next };
        run.clock.lap("set_cover");
    }
    best.ok_or(PlanError::Cancelled)
}

pub fn choose(
    setting: &Setting,
    first: &Volumes,
    elements: &[Element],
    admissible: &Admissible,
    options: &Options,
    report: &mut Report,
) -> Result<Vec<Plane>, PlanError> {
    let found = cover(setting, &first.reused, elements, admissible, options.cover)?;
    // The last cover knows all regions, so its note stands for those before it.
    report.notes.clear();
    if !found.uncovered.is_empty() {
        report.notes.push(format!(
            "No clipping plane opens {} of {} regions out of tools' reach, since they reach down to where the part is \
             held: other ways were tried for them.",
            found.uncovered.len(),
            elements.len()
        ));
    }
    Ok(found.planes)
}

/// Every plane moved toward the base by a share of its distance to it.
pub fn shifted(setting: &Setting, planes: &[Plane]) -> Vec<Plane> {
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

#[cfg(test)]
mod tests {
    use super::super::local_tests::{job_of, with_run};
    use super::super::round::volumes;
    use super::*;
    use crate::base::DVec3;
    use crate::voxel::Frame;

    /// A groove that only a cutter of the last resort fits into: planes could but give up the block beside it,
    /// and used to be planned with first.
    #[test]
    fn a_groove_is_for_slim_cutters_before_planes() {
        let frame = Frame { pitch: 0.4, dims: [44, 34, 34], origin: DVec3::ZERO };
        let block = |v: [usize; 3]| {
            (2..42).contains(&v[0]) && (2..32).contains(&v[1]) && (1..31).contains(&v[2])
        };
        let initial = BitGrid::from_fn(frame.dims, block);
        let groove = |v: [usize; 3]| (15..19).contains(&v[1]) && v[2] > 14;
        let target = BitGrid::from_fn(frame.dims, |v| block(v) && !groove(v));
        let job = job_of(frame, initial, target.clone(), |_| true);
        let (plain, made, resorted) = with_run(&job, |run| {
            let first = volumes(&job, &[]);
            let plain = run.start.attempt(Vec::new(), run.options, run.ctx).unwrap();
            let normals = run.normals;
            let made = global_route(run, &first, &Admissible::all(&job, normals)).unwrap();
            (plain, made, run.resorted.clone())
        });
        assert!(plain.excess.count() > 100, "the usual cutters leave {}", plain.excess.count());
        assert_eq!((made.left(), &made.volumes.reused), (0, &target));
        assert!(made.clips.is_empty());
        assert_eq!(resorted, [Vec::new()]);
    }
}
