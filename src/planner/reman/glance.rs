//! A look at what a placement of the target is worth, in a fraction of the time that a plan takes.
//!
//! Method. On the coarse grid, blocks are made without planes and under the first cover of the
//! printing bases, with the usual tools and without supports; the better of the two stands for what a
//! plan would keep and leave. Guarantees: none; it is there to choose what is planned.

use super::candidates::Admissible;
use super::clip::Clip;
use super::coarse::Coarse;
use super::global::choose;
use super::round::{Mending, attempt, volumes};
use super::setting::Setting;
use super::{Options, Report, Standing, bases_of, check, plane_normals};
use crate::base::Ctx;
use crate::plan::Job;
use crate::planner::PlanError;

/// How a plan of the job may stand beside those of other placements.
///
/// # Errors
/// Those of [`super::plan`].
pub fn glance(job: &Job, options: &Options, ctx: &Ctx) -> Result<Standing, PlanError> {
    check(job, options)?;
    let job = Coarse::of(job).as_job();
    let (setting, coarse) = (Setting::new(&job), Coarse::of(&job));
    let first = volumes(&job, &[]);
    let bases = bases_of(&setting, &first, options);
    let normals = plane_normals(&job, options.directions);
    let all = Admissible::all(&job, &normals);
    let mut told = Report::default();
    let planes = choose(&setting, &first, &bases.bad, &all, options, &mut told)?;
    let mut covers = vec![planes];
    if !covers[0].is_empty() {
        covers.push(Vec::new());
    }
    let mut best: Option<Standing> = None;
    for planes in covers {
        let clips = planes.into_iter().map(Clip::global).collect();
        let how = (options, Mending::Glance);
        let made = attempt(&setting, &coarse, clips, &bases.preferred, how, ctx)?;
        let standing = made.standing(&job, made.volumes.reused.count());
        if best.is_none_or(|b| standing.loss_mm3() < b.loss_mm3()) {
            best = Some(standing);
        }
    }
    best.ok_or(PlanError::Cancelled)
}
