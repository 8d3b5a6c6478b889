//! Fitting: where a cutter has no room beside the surfaces for a cut, a slimmer one makes it.
//!
//! Method. By the middles of voxels a cutter fits into gaps that its surfaces are too near each other for: up to
//! a voxel narrower than it, and whatever it cuts there it gouges one side or the other. Of each cut by a ball end
//! of radius r, what a cutter half a voxel wider does not reach beside the target is looked at on the target's
//! mesh: a voxel is crowded where nowhere around it, r and half a voxel off, is a place for the ball's middle that
//! keeps it and the edge over it r from the surface, looked for by going away from the nearest of it again and again.
//! What of the crowded a slimmer ball end reaches and has room for is left to it, along the same direction and as held
//! for it. Of a tapered edge's cut what a wider one does not reach counts as crowded, of a small cut all of it.
//! What neither can make of the cut before the other is done is its own cutter's again, and where little has to be
//! given back to that one for it, cut with the rest.
//!
//! Guarantees: those of cuts; the state after each of the plan's own cuts is what it was, and so are its directions
//! and holdings. Not guaranteed: that there is such a cutter, or that it is long enough; that a place is found where
//! there is one, for voxels are looked at two by two by two, and steps may miss it: a cut is then divided in vain.

use super::Run;
use super::cutting::held_part;
use super::roughing::{Before, divided, with_room};
use super::round::Attempt;
use crate::access::over_cut;
use crate::base::{DVec3, Direction};
use crate::machine::Tool;
use crate::mesh::{NearestTriangle, SurfacePoint};
use crate::plan::{Job, Step};
use crate::planner::PlanError;
use crate::voxel::{BitGrid, Frame};
use rayon::prelude::*;
use std::collections::BTreeMap;

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

/// How near to a surface its radius may bring a cutter, mm: what counts as a gouge.
const GOUGE_MM: f64 = 0.05;

/// Along an edge the surface is asked for so many radii apart.
const APART: f64 = 1.5;

/// Steps away from the nearest of the surface, the first [`FULL_STEPS`] as far as there is to go, each of the others
/// by 0.7 of the one before.
const STEPS: i32 = 16;
const FULL_STEPS: i32 = 4;

/// The plan with what its cutters have no room for cut by slimmer ones.
pub fn fitted(run: &mut Run, attempt: Attempt) -> Result<Attempt, PlanError> {
    divided(run, attempt, |run, before, step| {
        let parts = if run.ctx.out_of_time() { None } else { by_room(run, before, step)? };
        Ok(parts.unwrap_or_else(|| vec![step.clone()]))
    })
}

/// A cut as two or three: what its cutter has room for, what a slimmer one takes, what is left of it then. None
/// where no other cutter helps.
fn by_room(run: &Run, before: Before, step: &Step) -> Result<Option<Vec<Step>>, PlanError> {
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
    let room = with_room(job, state, &step.region, fixed, (own, step.direction));
    let tight = step.region.minus(&room);
    if tight.count() < least {
        return Ok(None);
    }
    // How wide a tapered edge is where it passes the surface is not told by its end.
    let crowded = match own.is_tapered() {
        true if step.region.count() <= SMALL * tight.count() => step.region.clone(),
        true => tight.clone(),
        false => tight.minus(&roomy(job, &tight, (own, step.direction))),
    };
    if crowded.count() < least {
        return Ok(None);
    }
    // All of the cut but the crowded is gone when its turn comes.
    let before = state.minus(&step.region).or(&crowded);
    let mut best: Option<(&Tool, BitGrid)> = None;
    for tool in slimmer {
        let cut = over_cut(&job.frame, &before, &crowded, fixed, tool, step.direction).region;
        let its = roomy(job, &cut, (tool, step.direction));
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
    if its.count() < least || (its.count() as f64) < LEAST_SHARE * crowded.count() as f64 {
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
fn over(
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

/// Those of some voxels around which a ball end and its edge over that have room beside the target's surface.
fn roomy(job: &Job, some: &BitGrid, (tool, direction): (&Tool, Direction)) -> BitGrid {
    let (frame, radius) = (&job.frame, tool.active_radius());
    let surface = NearestTriangle::new(&job.target_mesh, radius);
    let edge = Edge { radius, axis: direction.vec(), length: tool.active_length() - radius };
    // Voxels two by two by two have room or not together.
    let mut groups: BTreeMap<[usize; 3], Vec<[usize; 3]>> = BTreeMap::new();
    some.iter_ones().for_each(|v| groups.entry(v.map(|c| c / 2)).or_default().push(v));
    let groups: Vec<Vec<[usize; 3]>> = groups.into_values().collect();
    let has = |g: &Vec<[usize; 3]>| edge.has_room(&surface, frame.center(g[0]), frame.pitch / 2.0);
    let open: Vec<bool> = groups.par_iter().map(has).collect();
    let mut roomy = BitGrid::new(some.dims());
    let of_open = groups.into_iter().zip(open).filter(|(_, open)| *open);
    of_open.flat_map(|(g, _)| g).for_each(|v| roomy.set(v, true));
    roomy
}

/// A ball end and the cylinder over it.
struct Edge {
    radius: f64,
    /// From the ball's middle up.
    axis: DVec3,
    /// So far the cylinder goes up from there, mm.
    length: f64,
}

impl Edge {
    /// Whether it keeps off a surface somewhere where its ball touches what lies within `beside` of a point.
    fn has_room(&self, surface: &NearestTriangle, p: DVec3, beside: f64) -> bool {
        let mut middle = p;
        for k in 0..STEPS {
            let apart = APART * self.radius;
            let along = (0..).map(|i| f64::from(i) * apart).take_while(|s| *s <= self.length);
            let nearest = along.fold(None, |nearest: Option<(f64, SurfacePoint)>, s| {
                let most = nearest.map_or(f64::INFINITY, |n| n.1.distance);
                surface.nearer(middle + self.axis * s, most).map(|n| (s, n)).or(nearest)
            });
            let Some((s, near)) = nearest else { return true };
            if near.distance >= self.radius - GOUGE_MM {
                return true;
            }
            let mut away = middle + self.axis * s - near.point;
            if s > 0.0 {
                away -= self.axis * away.dot(self.axis);
            }
            let away = away.try_normalize().unwrap_or(near.normal);
            // Between two walls whole steps would go to and fro.
            let share = 0.7f64.powi((k - FULL_STEPS).max(0));
            middle += away * ((self.radius - near.distance) * share);
            middle = p + (middle - p).clamp_length_max(self.radius + beside);
        }
        false
    }
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

    /// Two blocks with a gap of so many mm between them.
    fn gap(width: f64) -> TriMesh {
        let block = |z: f64| [DVec3::new(0.0, 0.0, z), DVec3::new(9.0, 9.0, z + 3.0)];
        boxes(&[block(0.0), block(3.0 + width)])
    }

    /// A slot of 1.2 mm between two blocks, joined behind it: a cutter of 1.4 mm fits by the voxels, and leaves
    /// it to one of 1 mm. A slot of 1.6 mm it cuts itself.
    #[test]
    fn a_narrow_slot_is_left_to_a_slimmer_cutter() {
        for (width, tools) in [(1.2, &["ball-1x16"][..]), (1.6, &["ball-1.4x24"])] {
            let frame = Frame { pitch: 0.25, dims: [42, 42, 37], origin: DVec3::splat(-0.75) };
            let (a, b) = (DVec3::ZERO, DVec3::new(9.0, 9.0, 6.0 + width));
            let under = [a, DVec3::new(9.0, 9.0, 3.0)];
            let over = [DVec3::new(0.0, 0.0, 3.0 + width), b];
            let behind = [DVec3::new(8.0, 0.0, 3.0), DVec3::new(9.0, 9.0, 3.0 + width)];
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
                (by_room(run, before, &step).unwrap().unwrap_or_else(|| vec![step]), region)
            });
            assert!(region.count() > 1000, "{width}: {}", region.count());
            let mut all = BitGrid::new(region.dims());
            parts.iter().for_each(|s| all.union_with(&s.region));
            assert_eq!(all, region);
            let named: Vec<&str> = parts
                .iter()
                .filter(|s| s.region.count() * 2 > region.count())
                .map(|s| s.tool.as_str())
                .collect();
            assert_eq!(named, tools, "{width}");
        }
    }

    #[test]
    fn a_gap_has_room_for_what_is_narrower_than_it() {
        for width in [1.15, 1.35, 2.05] {
            let mesh = gap(width);
            let surface = NearestTriangle::new(&mesh, 1.5);
            for k in 1..10 {
                let p = DVec3::new(4.5, 4.0, 3.0 + width * f64::from(k) / 10.0);
                for radius in [0.5, 0.7, 1.0, 1.5] {
                    let fits = 2.0 * (radius - GOUGE_MM) <= width;
                    let edge = Edge { radius, axis: DVec3::NEG_X, length: 20.0 };
                    let found = edge.has_room(&surface, p, 0.1);
                    assert!(found == fits, "{width} {k} {radius}");
                }
            }
        }
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

    /// Before a gap there is room for the ball, not for the edge that has to go through it.
    #[test]
    fn the_edge_needs_room_too() {
        let mesh = gap(1.15);
        let surface = NearestTriangle::new(&mesh, 1.5);
        let p = DVec3::new(9.6, 4.5, 3.6);
        let edge = |axis| Edge { radius: 0.7, axis, length: 20.0 };
        assert!(edge(DVec3::X).has_room(&surface, p, 0.1));
        assert!(!edge(DVec3::NEG_X).has_room(&surface, p, 0.1));
    }

    /// Beside a wall, on a floor and in the open there is.
    #[test]
    fn a_face_alone_leaves_room() {
        let mesh = gap(50.0);
        let surface = NearestTriangle::new(&mesh, 1.5);
        for p in [DVec3::new(4.0, 4.0, 3.01), DVec3::new(-0.05, 4.0, 1.0), DVec3::splat(-9.0)] {
            let edge = Edge { radius: 1.5, axis: DVec3::Z, length: 20.0 };
            assert!(edge.has_room(&surface, p, 0.1), "{p}");
        }
    }
}
