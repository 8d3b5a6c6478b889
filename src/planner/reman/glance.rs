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

#[cfg(test)]
mod tests {
    use super::super::local_tests::job_of;
    use super::*;
    use crate::base::DVec3;
    use crate::machine::Taken;
    use crate::voxel::{BitGrid, Frame};

    const DIMS: [usize; 3] = [30, 24, 24];

    fn glanced(target: impl Fn([usize; 3]) -> bool + Sync) -> (Standing, usize) {
        let frame = Frame { pitch: 1.0, dims: DIMS, origin: DVec3::ZERO };
        let block = |v: [usize; 3]| (2..28).contains(&v[0]) && (2..22).contains(&v[1]) && v[2] < 16;
        let (initial, target) = (BitGrid::from_fn(DIMS, block), BitGrid::from_fn(DIMS, target));
        let solid = target.count();
        let job = job_of(frame, initial, target, |t| t.taken == Taken::Always);
        (glance(&job, &Options::default(), &Ctx::quiet()).unwrap(), solid)
    }

    #[test]
    fn what_is_reached_from_outside_is_complete_and_a_hidden_hollow_is_left() {
        let small = |v: [usize; 3]| (6..24).contains(&v[0]) && (6..18).contains(&v[1]) && v[2] < 12;
        let (open, _) = glanced(small);
        assert_eq!((open.class, open.given_up_mm3, open.left_mm3), (0, 0.0, 0.0));
        // The same with a closed hollow: no cutter gets there.
        let hollow = |v: [usize; 3]| {
            (10..20).contains(&v[0]) && (9..15).contains(&v[1]) && (3..9).contains(&v[2])
        };
        let (closed, solid) = glanced(|v| small(v) && !hollow(v));
        assert!(closed.left_mm3 > 0.0 && closed.class > 0, "{closed:?}");
        assert!(closed.loss_mm3() > open.loss_mm3() && closed.given_up_mm3 <= solid as f64);
    }
}
