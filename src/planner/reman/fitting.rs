//! Fitting: where a cutter has no room beside the surfaces for a cut, a slimmer one makes it.
//!
//! Method. Of each cut by a ball end what a cutter a voxel wider on each side does not reach beside the target is
//! looked at on the target's mesh; what has no room there is crowded (see `room`).
//! What of the crowded a slimmer ball end reaches and has room for is left to it, along the same direction and as held
//! for it. Of a tapered edge's cut what a wider one does not reach counts as crowded too, of a small cut all of it.
//! What neither can make of the cut before the other is done is its own cutter's again, and where little has to be
//! given back to that one for it, cut with the rest.
//!
//! Guarantees: those of cuts; the state after each of the plan's own cuts is what it was, and so are its directions
//! and holdings. Not guaranteed: that there is such a cutter, or that it is long enough; where a place is missed, a cut
//! is divided in vain.

use super::Run;
use super::cutting::held_part;
use super::room::{Room, WIDER_VOXELS};
use super::roughing::{Before, divided, with_room};
use super::round::Attempt;
use crate::access::over_cut;
use crate::base::{DVec3, Direction};
use crate::machine::Tool;
use crate::plan::Step;
use crate::planner::PlanError;
use crate::voxel::{BitGrid, Frame};

/// What is crowded is worth another cutter from this volume, mm³, and so many voxels on: what lies in creases is
/// less. A cutter's side gouges all along its way to a single voxel.
const LEAST_MM3: f64 = 0.25;
const LEAST_VOXELS: usize = 20;

/// Share of it that the other cutter has room for at least.
const LEAST_SHARE: f64 = 0.5;

/// What is left for the cut's own cutter at last is cut with the rest where what lies so many radii beside it, and
/// over it, is left to that cutter too, if this is no more than a share of the rest: paths leave a percent standing.
const BESIDE_RADII: [f64; 3] = [0.5, 1.0, 2.0];
const BACK_SHARE: f64 = 0.002;

/// A stouter cutter is taken where it has room for this share of all that is crowded, or of what a slimmer one has.
const NEARLY: f64 = 0.98;

/// Of a tapered edge's cut that is no more than so many times what a wider one does not reach, all is crowded.
const SMALL: usize = 3;

/// The plan with what its cutters have no room for cut by slimmer ones.
pub fn fitted(run: &mut Run, room: &Room, attempt: Attempt) -> Result<Attempt, PlanError> {
    divided(run, attempt, |run, before, step| {
        let parts = if run.ctx.out_of_time() { None } else { by_room(run, room, before, step)? };
        Ok(parts.unwrap_or_else(|| vec![step.clone()]))
    })
}

/// A cut as two or three: what its cutter has room for, what a slimmer one takes, what is left of it then. None
/// where no other cutter helps.
fn by_room(
    run: &Run,
    room: &Room,
    before: Before,
    step: &Step,
) -> Result<Option<Vec<Step>>, PlanError> {
    let (setting, coarse) = (run.start.setting, run.start.coarse);
    let (job, Before { state, fixed }) = (setting.job, before);
    let least = ((LEAST_MM3 / job.frame.voxel_volume()).ceil() as usize).max(LEAST_VOXELS);
    let own = job.tool(&step.tool).filter(|t| t.has_ball_end() || t.is_tapered());
    let Some(own) = own.filter(|_| step.region.count() >= least) else { return Ok(None) };
    let slimmer = setting.slimmer_cutters(own);
    if slimmer.is_empty() {
        return Ok(None);
    }
    run.ctx.check()?;
    let open = with_room(job, state, &step.region, fixed, (own, step.direction, WIDER_VOXELS));
    let tight = step.region.minus(&open);
    if tight.count() < least {
        return Ok(None);
    }
    let after = state.minus(&step.region);
    let way = (own, step.direction);
    // How wide a tapered edge is where it passes the surface is not told by its end.
    let crowded = match own.is_tapered() {
        true if step.region.count() <= SMALL * tight.count() => step.region.clone(),
        true => tight.or(&step.region.minus(&room.after(&after, None, &step.region, way))),
        false => tight.minus(&room.after(&after, None, &tight, way)),
    };
    if crowded.count() < least {
        return Ok(None);
    }
    // All of the cut but the crowded is gone when its turn comes.
    let before = state.minus(&step.region).or(&crowded);
    let mut best: Option<(&Tool, BitGrid)> = None;
    for tool in slimmer {
        let cut = over_cut(&job.frame, &before, &crowded, fixed, tool, step.direction).region;
        let its = room.after(&after, None, &cut, (tool, step.direction));
        let is_enough = its.count() as f64 >= NEARLY * crowded.count() as f64;
        let most = best.as_ref().map_or(0, |(_, b)| b.count());
        if is_enough || its.count() as f64 * NEARLY > most as f64 {
            best = Some((tool, its));
        }
        if is_enough {
            break;
        }
    }
    let Some((tool, its)) = best else { return Ok(None) };
    // The deepest of what a tapered edge cuts is deeper than others are slim: that is no reason to gouge the rest.
    let least_share = if own.is_tapered() { 0.0 } else { LEAST_SHARE };
    if its.count() < least || (its.count() as f64) < least_share * crowded.count() as f64 {
        return Ok(None);
    }
    let parts_of = |its: &BitGrid| {
        let mut state = state.clone();
        let mut cut = |tool: &Tool, region: &BitGrid| {
            let part = held_part(setting, coarse, (&state, region), fixed, (tool, step.direction));
            state.subtract(&part);
            part
        };
        let first = cut(own, &step.region.minus(its));
        let second = cut(tool, &step.region.minus(&first));
        let left = step.region.minus(&first).minus(&second);
        let last = if left.is_empty() { left.clone() } else { cut(own, &left) };
        (left == last, [first, second, last])
    };
    let (mut is_whole, mut parts) = parts_of(&its);
    let mut fewer = its.clone();
    for radii in BESIDE_RADII {
        if parts[2].is_empty() {
            break;
        }
        run.ctx.check()?;
        fewer.subtract(&over(&job.frame, &fewer, &parts[2], (own, step.direction), radii));
        let back = its.count() - fewer.count();
        if back as f64 > BACK_SHARE * parts[0].count() as f64 {
            break;
        }
        let (whole, now) = parts_of(&fewer);
        if whole && now[2].is_empty() {
            (is_whole, parts) = (whole, now);
        }
    }
    let [first, second, last] = parts;
    tracing::debug!(
        own = own.name,
        tool = tool.name,
        tight = tight.count(),
        crowded = crowded.count(),
        room = its.count(),
        parts = ?[first.count(), second.count(), last.count()],
        is_whole,
        "fitted"
    );
    let part = |tool: &Tool, region| Step { tool: tool.name.clone(), region, ..step.clone() };
    Ok(is_whole.then(|| vec![part(own, first), part(tool, second), part(own, last)]))
}

/// Those of some voxels that lie over others, or beside what does by so many radii of a cutter.
pub(super) fn over(
    frame: &Frame,
    some: &BitGrid,
    others: &BitGrid,
    (tool, direction): (&Tool, Direction),
    radii: f64,
) -> BitGrid {
    let (plane, radius) = (direction.image_plane(), tool.active_radius());
    let seen = |v: [usize; 3]| {
        let p = frame.center(v);
        plane.across(p).extend(plane.height(p))
    };
    let others: Vec<DVec3> = others.iter_ones().map(seen).collect();
    let is_over = |v: &[usize; 3]| {
        let p = seen(*v);
        let aside = |o: &DVec3| o.truncate().distance(p.truncate());
        others.iter().any(|o| p.z >= o.z - radius && aside(o) <= radii * radius)
    };
    let mut over = BitGrid::new(some.dims());
    some.iter_ones().filter(is_over).for_each(|v| over.set(v, true));
    over
}

#[cfg(test)]
mod tests {
    use super::super::local_tests::{job_of, with_run};
    use super::super::round::volumes;
    use super::*;
    use crate::base::Ctx;
    use crate::mesh::TriMesh;
    use crate::plan::{Action, Origin, StepKind};
    use crate::voxel::{Frame, voxelise};

    /// Several boxes as one mesh.
    fn boxes(all: &[[DVec3; 2]]) -> TriMesh {
        let all: Vec<TriMesh> = all.iter().map(|[a, b]| TriMesh::cuboid(*a, *b)).collect();
        TriMesh::joined(&all)
    }

    /// The tools that take most of what is cut, on voxels of so many mm, out of a slot so wide from a height up, between
    /// two blocks that are joined behind it.
    fn tools_in_a_slot(pitch: f64, low: f64, width: f64) -> Vec<String> {
        let dims = [10.5, 10.5, 9.25].map(|size| (size / pitch) as usize);
        let frame = Frame { pitch, dims, origin: DVec3::splat(-0.75) };
        let (a, b) = (DVec3::ZERO, DVec3::new(9.0, 9.0, low + width + 3.0));
        let under = [a, DVec3::new(9.0, 9.0, low)];
        let over = [DVec3::new(0.0, 0.0, low + width), b];
        let behind = [DVec3::new(8.0, 0.0, low), DVec3::new(9.0, 9.0, low + width)];
        let solid = |mesh: &TriMesh| voxelise(mesh, &frame, &Ctx::quiet()).unwrap();
        let target = boxes(&[under, over, behind]);
        let mut job = job_of(frame, solid(&boxes(&[[a, b]])), solid(&target), |_| true);
        job.target_mesh = target;
        let volumes = volumes(&job, &[]);
        let (parts, region) = with_run(&job, |run| {
            let (setting, coarse) = (run.start.setting, run.start.coarse);
            let own = job.tool("ball-1.4x24").unwrap();
            let fixed = setting.fixed(0, &job.initial);
            let of = (&job.initial, &volumes.removed);
            let region = held_part(setting, coarse, of, &fixed, (own, Direction::NEG_X));
            let step = Step {
                kind: StepKind::Subtractive,
                tool: own.name.clone(),
                direction: Direction::NEG_X,
                holding: 0,
                region: region.clone(),
                block: 0,
                origin: Origin { plane: None, action: Some(Action::OC) },
            };
            let before = Before { state: &job.initial, fixed: &fixed };
            let parts = by_room(run, &Room::of(&job), before, &step).unwrap();
            (parts.unwrap_or_else(|| vec![step]), region)
        });
        assert!(region.count() > 500, "{width}: {}", region.count());
        let mut all = BitGrid::new(region.dims());
        parts.iter().for_each(|s| all.union_with(&s.region));
        assert_eq!(all, region);
        let most = parts.iter().filter(|s| s.region.count() * 2 > region.count());
        most.map(|s| s.tool.clone()).collect()
    }

    /// Into a slot of 1.2 mm a cutter of 1.4 mm fits by the voxels, and leaves it to one of 1 mm. A slot of 1.6 mm it
    /// cuts itself.
    #[test]
    fn a_narrow_slot_is_left_to_a_slimmer_cutter() {
        assert_eq!(tools_in_a_slot(0.25, 3.0, 1.2), ["ball-1x16"]);
        assert_eq!(tools_in_a_slot(0.25, 3.0, 1.6), ["ball-1.4x24"]);
    }

    /// With three middles of voxels in 1.16 mm those beside it are 2 mm apart: a cutter half a voxel wider on each side
    /// fits by the voxels too, and the slot was gouged by a tenth of a millimetre.
    #[test]
    fn a_slot_wider_by_nearly_two_voxels_on_the_grid_is_left_to_a_slimmer_cutter() {
        assert_eq!(tools_in_a_slot(0.5, 2.97, 1.16), ["ball-1x16"]);
    }

    /// A voxel's own column and, within the radii, those beside it, from a radius under it up.
    #[test]
    fn what_lies_over_a_voxel_is_found_along_any_axis() {
        let frame = Frame { pitch: 0.5, dims: [12; 3], origin: DVec3::ZERO };
        let machine = crate::machine::Machine::builtin("generic-5axis").unwrap();
        let tool = machine.tools.iter().find(|t| t.name == "ball-2x20").unwrap();
        let all = BitGrid::from_fn(frame.dims, |_| true);
        let one = BitGrid::from_fn(frame.dims, |v| v == [5, 6, 4]);
        for (direction, axis) in [(Direction::Z, 2), (Direction::NEG_X, 0)] {
            let up = if direction == Direction::Z { 1 } else { -1 };
            for radii in [0.5, 1.0] {
                let found = over(&frame, &all, &one, (tool, direction), radii);
                let is_over = |v: [usize; 3]| {
                    let by: [i64; 3] = [0, 1, 2].map(|a| v[a] as i64 - [5, 6, 4][a]);
                    let aside: i64 = (0..3).filter(|a| *a != axis).map(|a| by[a] * by[a]).sum();
                    // The radius is two pitches.
                    by[axis] * up >= -2 && aside as f64 <= 4.0 * radii * radii
                };
                assert_eq!(found, BitGrid::from_fn(frame.dims, is_over), "{direction:?} {radii}");
            }
        }
    }
}
