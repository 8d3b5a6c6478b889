//! Small worlds that paths and programs are tested on, and what must hold on them.

use super::*;
use crate::base::{DVec2, Direction};
use crate::machine::{Machine, Shape, ToolKind};
use crate::mesh::TriMesh;
use crate::plan::{Origin, Rules, Step};
use crate::voxel::Frame;

pub(crate) const MACHINES: [&str; 3] = ["generic-5axis", "mx220", "5xm600"];

/// A job whose regions are given as conditions on voxel centres (mm), standing on z = 0.
pub(crate) struct World {
    pub job: Job,
    pub plan: Plan,
}

pub(crate) type Part = fn(DVec3) -> bool;

pub(crate) fn world(
    machine: &str,
    h: f64,
    size: DVec3,
    start: Part,
    steps: &[(StepKind, DVec3, Part)],
) -> World {
    let machine = Machine::builtin(machine).unwrap();
    let n = (size / h).round();
    let dims = [n.x as usize, n.y as usize, n.z as usize];
    let frame = Frame { pitch: h, dims, origin: DVec3::ZERO };
    let grid = |f: Part| BitGrid::from_fn(dims, |v| f(frame.center(v)));
    let tools = |kind| machine.tools_of(kind).into_iter().cloned().collect::<Vec<Tool>>();
    let (cutters, nozzles) = (tools(ToolKind::Subtractive), tools(ToolKind::Additive));
    let mut state = grid(start);
    let initial = state.clone();
    let mut made = Vec::new();
    for (kind, d, part) in steps {
        let mut region = grid(*part);
        let tool = match kind {
            StepKind::Subtractive => {
                region.intersect_with(&state);
                state.subtract(&region);
                &cutters[0]
            }
            StepKind::Additive => {
                region.subtract(&state);
                state.union_with(&region);
                &nozzles[0]
            }
        };
        made.push(Step {
            kind: *kind,
            tool: tool.name.clone(),
            direction: Direction::new(*d).unwrap(),
            holding: 0,
            region,
            block: made.len(),
            origin: Origin::default(),
        });
    }
    let job = Job {
        frame,
        initial,
        target: state,
        initial_mesh: TriMesh::default(),
        target_mesh: TriMesh::default(),
        machine,
        cutters,
        nozzles,
        rules: Rules::for_pitch(h, 0.2),
    };
    World { job, plan: Plan { holdings: vec![Holding::AS_CLAMPED], steps: made } }
}

fn block(p: DVec3) -> bool {
    p.x > 2.0 && p.x < 22.0 && p.y > 2.0 && p.y < 18.0 && p.z < 12.0
}

/// Whether a point lies in a pocket open upward, with all lower edges rounded by 3 mm: more than
/// the ball end's radius, so that every voxel is within its reach.
fn in_pocket(p: DVec3, low: DVec3, high: DVec3) -> bool {
    const ROUND: f64 = 3.0;
    let out = (low + ROUND - p).max(p - (high - ROUND)).max(DVec3::ZERO);
    let open = DVec3::new(out.x, out.y, (low.z + ROUND - p.z).max(0.0));
    open.length() < ROUND
}

/// A pocket with a step, cut from above.
pub(crate) fn pocket(machine: &str) -> World {
    let hole: Part = |p| {
        let wide = in_pocket(p, DVec3::new(6.0, 5.0, 8.0), DVec3::new(19.0, 14.0, 12.0));
        let deep = in_pocket(p, DVec3::new(6.0, 5.0, 5.0), DVec3::new(13.0, 14.0, 12.0));
        wide || deep
    };
    let size = DVec3::new(24.0, 20.0, 14.0);
    world(machine, 0.5, size, block, &[(StepKind::Subtractive, DVec3::Z, hole)])
}

/// A world's first step, to be made with `tool`.
pub(super) fn first_step<'a>(
    w: &'a World,
    replay: &'a Replay,
    surfaces: &'a [BitGrid; 2],
    tool: &'a Tool,
    ctx: &'a Ctx,
) -> mill::Work<'a> {
    mill::Work {
        job: &w.job,
        frame: &w.job.frame,
        step: &w.plan.steps[0],
        tool,
        before: &replay.states[0],
        after: &replay.states[1],
        fixed: &replay.fixed[0],
        // Before the first step nothing was; no one who asks about it here looks at what.
        laid: &replay.states[0],
        surfaces,
        ctx,
    }
}

/// A block printed on a block.
pub(crate) fn tower(machine: &str) -> World {
    let top: Part = |p| p.x > 6.0 && p.x < 18.0 && p.y > 5.0 && p.y < 15.0 && p.z < 17.0;
    world(machine, 0.5, DVec3::new(24.0, 20.0, 20.0), block, &[(StepKind::Additive, DVec3::Z, top)])
}

/// One edge cut off at 45°, and a wedge printed on the cut face.
pub(crate) fn tilted(machine: &str) -> World {
    let slope = DVec3::new(0.0, 1.0, 1.0);
    let cut: Part = |p| p.y + p.z > 24.0;
    let wedge: Part = |p| {
        p.y + p.z > 24.0
            && p.y + p.z < 29.0
            && p.z - p.y > -8.0
            && p.z - p.y < 0.0
            && p.x > 6.0
            && p.x < 16.0
    };
    world(
        machine,
        0.5,
        DVec3::new(24.0, 24.0, 20.0),
        block,
        &[(StepKind::Subtractive, slope, cut), (StepKind::Additive, slope, wedge)],
    )
}

/// A step of a stair, and a block on each tread: of one additive step two bodies, the upper of
/// which begins where the lower has long ended.
pub(crate) fn treads(machine: &str) -> World {
    let stair: Part = |p| p.z < if p.x < 16.0 { 4.0 } else { 12.0 };
    let blocks: Part = |p| {
        let low = p.x > 1.0 && p.x < 6.0 && p.z < 7.0;
        let high = p.x > 18.0 && p.x < 23.0 && p.z < 15.0;
        (low || high) && p.y > 3.0 && p.y < 9.0
    };
    let size = DVec3::new(24.0, 12.0, 16.0);
    world(machine, 0.5, size, stair, &[(StepKind::Additive, DVec3::Z, blocks)])
}

/// Two bosses that stand alone beside each other, higher than the edge of the cutter that takes them is long.
pub(crate) fn bosses(machine: &str) -> World {
    let base: Part = |p| p.z < 2.0;
    let bosses: Part = |p| {
        let is_in = |low: f64| p.x > low && p.x < low + 4.0;
        p.z > 2.0 && p.z < 36.0 && p.y > 2.0 && p.y < 6.0 && (is_in(2.0) || is_in(8.0))
    };
    let start: Part = |p| p.x > 0.0 && p.z < 36.0;
    let size = DVec3::new(14.0, 8.0, 40.0);
    let mut w = world(machine, 0.5, size, start, &[(StepKind::Subtractive, DVec3::Z, bosses)]);
    let region = w.plan.steps[0].region.clone();
    w.job.target = BitGrid::from_fn(w.job.frame.dims, |v| base(w.job.frame.center(v)));
    w.job.initial = w.job.target.or(&region);
    w.plan.steps[0].tool = "ball-1.4x24".into();
    w
}

/// A shoulder beside a floor hardly deeper than the edge is long: the holder reaches over it, and has no room for the
/// stock that roughing leaves there.
pub(crate) fn shoulder(machine: &str) -> World {
    let start: Part = |p| p.x > 1.0 && p.x < 15.0 && p.y > 1.0 && p.y < 9.0 && p.z < 19.0;
    let cut: Part = |p| {
        let high = DVec3::splat(99.0);
        p.z > 17.9 || in_pocket(p, DVec3::new(7.0, -9.0, 5.0), high)
    };
    let size = DVec3::new(16.0, 10.0, 20.0);
    let mut w = world(machine, 0.1, size, start, &[(StepKind::Subtractive, DVec3::Z, cut)]);
    w.plan.steps[0].tool = "ball-3x13".into();
    w
}

/// Makes a world for the machine of this name.
pub(crate) type Make = fn(&str) -> World;

pub(crate) const WORLDS: [(&str, Make); 4] =
    [("pocket", pocket), ("tower", tower), ("tilted", tilted), ("treads", treads)];

fn paths(w: &World) -> Vec<Toolpath> {
    for_unverified(&w.job, &w.plan, &Ctx::quiet()).unwrap().all().to_vec()
}

/// The plain definition: no obstacle point inside the tool, to within `slack` mm.
fn touches(tool: &Tool, obstacles: &[DVec3], d: Direction, tip: DVec3, slack: f64) -> bool {
    let plane = d.image_plane();
    obstacles.iter().any(|o| {
        let rho = plane.across(*o).distance(plane.across(tip));
        plane.height(*o) - slack > plane.height(tip) + tool.lower_surface(rho + slack)
    })
}

#[test]
fn cutters_clear_what_stays_and_sweep_what_goes() {
    for w in [pocket("generic-5axis"), tilted("generic-5axis")] {
        let path = &paths(&w)[0];
        let after = w.job.initial.minus(&w.plan.steps[0].region);
        let points: Vec<DVec3> =
            after.boundary().iter_ones().map(|v| w.job.frame.center(v)).collect();
        let tool = w.job.tool(&path.tool).unwrap();
        // Tips stand on the lattice; a point is moved to its cell by at most half a pitch.
        let slack = if path.direction.is_grid_axis() { 0.01 } else { 0.5 * w.job.frame.pitch };
        for m in path.moves.iter().step_by(7) {
            assert!(!touches(tool, &points, path.direction, m.tip, slack), "{m:?}");
        }
        assert!(path.figures.coverage > 0.99, "{:?}", path.figures);
        assert!(path.figures.time_s > 20.0);
    }
}

/// Two pits were once cut level by level in turn, with a way over the safe height and back at each.
#[test]
fn a_pit_is_cut_to_its_ground_before_the_next() {
    let pits: Part = |p| {
        let high = DVec3::new(9.0, 15.0, 12.0);
        let one = in_pocket(p, DVec3::new(3.0, 5.0, 2.0), high);
        one || in_pocket(p - DVec3::X * 12.0, DVec3::new(3.0, 5.0, 2.0), high)
    };
    let size = DVec3::new(24.0, 20.0, 14.0);
    let w = world("generic-5axis", 0.5, size, block, &[(StepKind::Subtractive, DVec3::Z, pits)]);
    let path = &paths(&w)[0];
    let is_left = |m: &Move| m.tip.x < 12.0;
    let cuts: Vec<&Move> = path.moves.iter().filter(|m| m.kind == MoveKind::Cut).collect();
    // From one pit to the other by rough levels, by finer ones along the walls, over the ground, and for what is left.
    let turns = cuts.windows(2).filter(|w| is_left(w[0]) != is_left(w[1])).count();
    let levels = 10.0 / w.job.tool(&path.tool).unwrap().roughing_steps_mm()[0];
    assert!(levels > 6.0 && turns > 0 && turns <= 8, "{levels} {turns}");
    let rapids = path.moves.iter().filter(|m| m.kind == MoveKind::Rapid).count();
    assert!(rapids < 60, "{rapids}");
    assert!(path.figures.coverage > 0.99, "{:?}", path.figures);
}

/// Of two bosses beside each other, higher than the edge is long, one to its ground before the other would bring the
/// shank into that.
#[test]
fn shank_and_holder_keep_off_what_is_still_to_cut() {
    let w = bosses("generic-5axis");
    let region = &w.plan.steps[0].region;
    let path = &paths(&w)[0];
    let tool = w.job.tool(&path.tool).unwrap();
    let mut left: Vec<DVec3> = region.iter_ones().map(|v| w.job.frame.center(v)).collect();
    let edge = tool.active_length();
    let mut deepest = f64::INFINITY;
    for m in path.moves.windows(2).filter(|m| m[1].kind == MoveKind::Cut) {
        let n = (m[0].tip.distance(m[1].tip) / 0.25).ceil().max(1.0) as usize;
        for tip in (0..=n).map(|k| m[0].tip.lerp(m[1].tip, k as f64 / n as f64)) {
            deepest = tip.z.min(deepest);
            left.retain(|p| {
                let rho = p.truncate().distance(tip.truncate());
                let over = p.z - tip.z;
                let in_body = over > edge && over > tool.lower_surface(rho) + 0.25;
                assert!(!in_body, "at {tip} the shank is in {p}, {over} over it");
                over <= tool.active_lower_surface((rho - 0.25).max(0.0)) - 0.25
            });
        }
    }
    assert!(deepest < 3.0 && left.len() * 50 < region.count(), "{deepest} {}", left.len());
}

/// Ways over what stands keep clear of it, and of what is still to cut, by a millimetre.
#[test]
fn ways_over_what_stands_are_lower_than_the_safe_height_and_clear() {
    let mut hops = 0;
    for w in [pocket("generic-5axis"), tilted("generic-5axis")] {
        let path = &paths(&w)[0];
        let step = &w.plan.steps[0];
        let after = w.job.initial.minus(&step.region);
        let points: Vec<DVec3> =
            after.boundary().iter_ones().map(|v| w.job.frame.center(v)).collect();
        let tool = w.job.tool(&path.tool).unwrap();
        let plane = path.direction.image_plane();
        for m in path.moves.windows(2).filter(|m| m[1].kind == MoveKind::Approach) {
            let [a, b] = [0, 1].map(|k| m[k].tip);
            if plane.across(a).distance(plane.across(b)) < 1e-6 {
                continue;
            }
            hops += 1;
            assert!(plane.height(a) < path.safe_height - 1e-6);
            for k in 0..=20 {
                let tip = a.lerp(b, f64::from(k) / 20.0);
                assert!(!touches(tool, &points, path.direction, tip, 0.01), "{tip}");
            }
        }
    }
    assert!(hops > 0);
}

/// Of a block of a few voxels one is more than the program's check lets stand; the lattice of tips
/// takes a tip for up to a cell from where it is. Here they are the bottom of a groove in which the
/// cutter has little room.
#[test]
fn of_a_few_voxels_none_is_passed_by() {
    let normals = crate::base::fibonacci_sphere(200).into_iter().map(|d| d.vec());
    for n in normals.filter(|n| n.z > 0.6) {
        let mut w = world("generic-5axis", 0.5, DVec3::new(24.0, 20.0, 14.0), block, &[]);
        let (frame, tool) = (w.job.frame, w.job.cutters[0].clone());
        let (middle, along) = (DVec3::new(12.0, 10.0, 9.0), n.any_orthonormal_vector());
        // What a ball along a short line, and all that is over it, takes away.
        let in_groove = |p: DVec3| {
            let q = p - middle;
            let beside = q - along * along.dot(q).clamp(-1.0, 1.0);
            (beside - n * n.dot(beside).max(0.0)).length() < 1.7
        };
        let groove = BitGrid::from_fn(frame.dims, |v| in_groove(frame.center(v)));
        let is_low = |p: DVec3| n.dot(p - middle) < -0.6;
        let region = BitGrid::from_fn(frame.dims, |v| is_low(frame.center(v))).and(&groove);
        w.job.initial.subtract(&groove.minus(&region));
        w.job.target.subtract(&groove);
        w.plan.steps.push(Step {
            kind: StepKind::Subtractive,
            tool: tool.name.clone(),
            direction: Direction::new(n).unwrap(),
            holding: 0,
            region: region.clone(),
            block: 0,
            origin: Origin::default(),
        });
        let path = paths(&w).remove(0);
        let (d, slack) = (path.direction, frame.pitch / 2.0 + 0.01);
        let cuts = path.moves.windows(2).filter(|m| m[1].kind == MoveKind::Cut);
        let tips: Vec<DVec3> = cuts
            .flat_map(|m| (0..=20).map(|i| m[0].tip.lerp(m[1].tip, f64::from(i) / 20.0)))
            .collect();
        let swept = |p: DVec3| {
            tips.iter().any(|t| {
                let rho = (p - *t - d.vec() * d.dot(p - *t)).length();
                let under = tool.active_lower_surface((rho - slack).max(0.0));
                d.dot(*t) + under <= d.dot(p) + slack
            })
        };
        let left = region.iter_ones().filter(|v| !swept(frame.center(*v))).count();
        assert_eq!(left, 0, "of {} along {n}", region.count());
    }
}

/// A slot hardly wider than the cutter, whose middle runs between two rows of the lattice: tips of either row
/// are free of the voxels' middles and 0.3 mm deep in a wall.
#[test]
fn a_slot_between_two_rows_of_the_lattice_is_cut_without_a_gouge() {
    let slot: Part = |p| p.y > 8.8 && p.y < 12.0 && p.z > 4.8;
    let stock: Part = |p| p.x > 1.6 && p.x < 22.4 && p.y > 1.6 && p.y < 18.4 && p.z < 12.0;
    let cut = [(StepKind::Subtractive, DVec3::Z, slot)];
    let mut w = world("generic-5axis", 0.8, DVec3::new(24.0, 20.0, 14.4), stock, &cut);
    let part = |y0: f64, y1: f64, top: f64| {
        TriMesh::cuboid(DVec3::new(1.6, y0, 0.0), DVec3::new(22.4, y1, top))
    };
    w.job.initial_mesh = part(1.6, 18.4, 12.0);
    let walls = [part(1.6, 8.8, 12.0), part(8.8, 12.0, 4.8), part(12.0, 18.4, 12.0)];
    w.job.target_mesh = TriMesh::joined(&walls);
    let path = paths(&w).remove(0);
    assert!(path.figures.coverage > 0.99, "{:?}", path.figures);
    let tool = &w.job.cutters[0];
    let mut low = 0;
    for tip in path.moves.iter().filter(|m| m.kind == MoveKind::Cut).map(|m| m.tip) {
        let past = (1.6 - tip.x).max(tip.x - 22.4).max(0.0);
        for wall in [8.8, 12.0] {
            let over = tip.z + tool.lower_surface((tip.y - wall).hypot(past));
            assert!(over > 12.0 - 0.01, "{tip}");
        }
        assert!(tip.z + tool.lower_surface(past) > 4.79, "{tip}");
        low += usize::from(tip.z < 5.0);
    }
    assert!(low > 20, "{low}");
}

/// Of supports in a slot hardly wider than the cutter one side was left to the middle of its beads: voxels that the edge
/// comes near to count as cut.
#[test]
fn supports_in_a_slot_are_cut_to_both_sides() {
    const SLOT: [f64; 2] = [9.39, 11.01];
    let walls: Part = |p| block(p) && !(p.y > SLOT[0] && p.y < SLOT[1] && p.z > 5.0);
    let fill: Part =
        |p| p.y > SLOT[0] && p.y < SLOT[1] && p.x > 4.0 && p.x < 20.0 && p.z > 5.0 && p.z < 8.0;
    let steps = [(StepKind::Additive, DVec3::Z, fill), (StepKind::Subtractive, DVec3::Z, fill)];
    let mut w = world("generic-5axis", 0.4, DVec3::new(24.0, 20.0, 14.0), walls, &steps);
    w.plan.steps[1].tool = "ball-1.4x24".into();
    let part = |low: [f64; 3], high: [f64; 3]| TriMesh::cuboid(low.into(), high.into());
    let mesh = TriMesh::joined(&[
        part([2.0, 2.0, 0.0], [22.0, 18.0, 5.0]),
        part([2.0, 2.0, 5.0], [22.0, SLOT[0], 12.0]),
        part([2.0, SLOT[1], 5.0], [22.0, 18.0, 12.0]),
    ]);
    (w.job.initial_mesh, w.job.target_mesh) = (mesh.clone(), mesh);
    let path = &paths(&w)[1];
    let tool = w.job.cutters.iter().find(|t| t.name == path.tool).unwrap();
    let plane = path.direction.image_plane();
    let seen = |p: DVec3| plane.across(p).extend(plane.height(p));
    let moves = path.moves.windows(2).filter(|m| m[1].kind == MoveKind::Cut);
    let tips: Vec<DVec3> = moves
        .flat_map(|m| (0..=8).map(move |k| m[0].tip.lerp(m[1].tip, f64::from(k) / 8.0)))
        .map(seen)
        .collect();
    let cells = BitGrid::from_fn(w.job.frame.dims, |v| fill(w.job.frame.center(v)));
    let middles = cells.iter_ones().map(|v| w.job.frame.center(v)).filter(|p| p.z > 6.0);
    let middles: Vec<DVec3> = middles.map(seen).collect();
    let is_cut = |p: &&DVec3| tips.iter().any(|t| between::cuts(tool, *t, **p, 0.01));
    let cut = middles.iter().filter(is_cut).count();
    assert!(cut == middles.len() && cut > 300, "{cut} of {}", middles.len());
}

/// Supports beside a face of the initial part were taken for its solid, whose face they hide: nothing kept the
/// cutter off them.
#[test]
fn supports_beside_a_face_of_the_initial_part_are_not_passed_through() {
    let on_top: Part = |p| p.x > 6.0 && p.x < 18.0 && p.y > 5.0 && p.y < 15.0 && p.z < 12.5;
    let half: Part = |p| p.z > 12.0 && p.x < 12.0;
    let rest: Part = |p| p.z > 12.0;
    let (add, cut) = (StepKind::Additive, StepKind::Subtractive);
    let steps = [(add, DVec3::Z, on_top), (cut, DVec3::Z, half), (cut, DVec3::Z, rest)];
    let mut w = world("generic-5axis", 0.5, DVec3::new(24.0, 20.0, 16.0), block, &steps);
    let mesh = TriMesh::cuboid(DVec3::new(2.0, 2.0, 0.0), DVec3::new(22.0, 18.0, 12.0));
    (w.job.initial_mesh, w.job.target_mesh) = (mesh.clone(), mesh);
    let paths = paths(&w);
    let after = w.job.initial.or(&w.plan.steps[2].region);
    let points: Vec<DVec3> = after.boundary().iter_ones().map(|v| w.job.frame.center(v)).collect();
    let cuts = paths[1].moves.iter().filter(|m| m.kind == MoveKind::Cut);
    for m in cuts {
        assert!(!touches(&w.job.cutters[0], &points, Direction::Z, m.tip, 0.02), "{m:?}");
    }
}

/// A voxel at the rim of a hole as wide as the cutter: the one tip that gets at it is just within the edge's
/// reach of it, but not of the middle of its cell, around which tips are looked for. The plan cuts it by exact
/// distances; the step once got no path.
#[test]
fn what_is_cut_by_exact_distances_gets_a_path() {
    let normals = crate::base::fibonacci_sphere(60).into_iter().map(|d| d.vec());
    let mut cut = 0;
    for n in normals.filter(|n| n.z > 0.8) {
        let mut w = world("generic-5axis", 0.8, DVec3::new(24.0, 20.0, 14.4), block, &[]);
        let (frame, tool) = (w.job.frame, w.job.cutters[0].clone());
        let direction = Direction::new(n).unwrap();
        let (plane, s, reach) = (direction.image_plane(), frame.pitch / 2.0, tool.active_radius());
        let origin = plane.across(frame.center([0; 3]));
        let cell = |p: DVec3| ((plane.across(p) - origin) / s).round();
        // A voxel, and a tip that is only in reach by where the voxel is.
        let middle = DVec3::new(12.0, 10.0, 6.0);
        let tip_of = |v: [usize; 3], to: DVec2| (cell(frame.center(v)) + to) * s + origin;
        let is_rim = |v: [usize; 3], to: DVec2| {
            let rho = plane.across(frame.center(v)).distance(tip_of(v, to));
            rho < reach - 0.01 && to.length() * s > reach + 0.01
        };
        let offsets = (-5..=5).flat_map(|i| (-5..=5).map(move |j| [i, j]));
        let offsets: Vec<DVec2> =
            offsets.map(|[i, j]| DVec2::new(f64::from(i), f64::from(j))).collect();
        let near = BitGrid::from_fn(frame.dims, |v| frame.center(v).distance(middle) < 2.5);
        let at_rim = |v| Some(v).zip(offsets.iter().find(|to| is_rim(v, **to)));
        let (voxel, to) = near.iter_ones().find_map(at_rim).unwrap();
        let at = tip_of(voxel, *to);
        let rho = |p: DVec3| {
            let moved = cell(p) * s + origin;
            plane.across(p).distance(at).min(moved.distance(at))
        };
        let p = frame.center(voxel);
        let z = n.dot(p) - tool.active_lower_surface(plane.across(p).distance(at));
        // All that stands in the way of the tip is gone before.
        let hole = BitGrid::from_fn(frame.dims, |v| {
            let p = frame.center(v);
            n.dot(p) > z + tool.lower_surface(rho(p))
        });
        let few = BitGrid::from_fn(frame.dims, |v| v == voxel);
        w.job.initial.subtract(&hole.minus(&few));
        w.job.target.subtract(&hole.or(&few));
        let close = crate::access::Close::new(&frame, &w.job.initial, (&few, &few), &[]);
        let region = close.cut(&tool, direction);
        assert_eq!(region, few, "along {n}");
        cut += 1;
        w.plan.steps.push(Step {
            kind: StepKind::Subtractive,
            tool: tool.name.clone(),
            direction,
            holding: 0,
            region,
            block: 0,
            origin: Origin::default(),
        });
        let path = paths(&w).remove(0);
        assert_eq!(path.figures.coverage, 1.0, "along {n}");
        let cuts: Vec<DVec3> =
            path.moves.iter().filter(|m| m.kind == MoveKind::Cut).map(|m| m.tip).collect();
        let reaches = |tip: &DVec3| {
            let rho = plane.across(p).distance(plane.across(*tip));
            n.dot(*tip) + tool.active_lower_surface(rho - 1e-6) < n.dot(p) + 1e-6
        };
        assert!(cuts.iter().any(reaches), "along {n}");
        let obstacles: Vec<DVec3> =
            w.job.target.boundary().iter_ones().map(|v| frame.center(v)).collect();
        for tip in cuts {
            assert!(!touches(&tool, &obstacles, direction, tip, 1e-6), "along {n}");
        }
    }
    assert!(cut > 4, "{cut}");
}

#[test]
fn rapids_run_high_or_straight_up() {
    for (name, make) in WORLDS {
        for path in paths(&make("generic-5axis")) {
            let d = path.direction;
            for m in path.moves.windows(2).filter(|m| m[1].kind == MoveKind::Rapid) {
                let (a, b) = (d.dot(m[0].tip), d.dot(m[1].tip));
                let across = (m[1].tip - m[0].tip - d.vec() * (b - a)).length();
                let high = a.min(b) >= path.safe_height - 1e-3;
                assert!(high || (across < 1e-6 && b > a), "{name}: {m:?}");
            }
            let ends = [path.moves[0], path.moves[path.moves.len() - 1]];
            assert!(ends.iter().all(|m| d.dot(m.tip) >= path.safe_height - 1e-3), "{name}");
        }
    }
}

#[test]
fn no_cut_goes_deeper_than_a_level_at_once() {
    let w = pocket("generic-5axis");
    let path = &paths(&w)[0];
    let tool = w.job.tool(&path.tool).unwrap();
    let level = Milling::of(&w.job.machine, tool).step_down;
    // A column of lowest tips: each new tip may undercut what was cut beside it by one level.
    let mut lowest: std::collections::BTreeMap<(i64, i64), f64> = std::collections::BTreeMap::new();
    for m in path.moves.windows(2).filter(|m| m[1].kind == MoveKind::Cut) {
        let n = (m[0].tip.distance(m[1].tip) / 0.25).ceil().max(1.0);
        for p in (0..=n as usize).map(|i| m[0].tip.lerp(m[1].tip, i as f64 / n)) {
            let at = ((p.x / 0.5).round() as i64, (p.y / 0.5).round() as i64);
            let around = (-3..=3).flat_map(|i| (-3..=3).map(move |j| (at.0 + i, at.1 + j)));
            let near = around.filter_map(|c| lowest.get(&c)).fold(12.0f64, |a, b| a.min(*b));
            assert!(p.z >= near - level - 0.8, "{m:?} after {near}");
            let z = lowest.entry(at).or_insert(12.0);
            *z = z.min(p.z);
        }
    }
}

#[test]
fn beads_lie_in_the_region_and_layers_rise() {
    for (w, step) in [(tower("generic-5axis"), 0), (tilted("generic-5axis"), 1)] {
        let path = &paths(&w)[step];
        let d = path.direction;
        let region = &w.plan.steps[step].region;
        let mut last = f64::NEG_INFINITY;
        for m in path.moves.iter().filter(|m| m.kind == MoveKind::Deposit) {
            let z = d.dot(m.tip);
            assert!(z >= last - 1e-6);
            last = z;
            let middle = m.tip - d.vec() * 0.1;
            let near = region.iter_ones().any(|v| w.job.frame.center(v).distance(middle) < 0.75);
            assert!(near, "{m:?}");
        }
        let f = path.figures;
        let share = f.material_mm3 / f.region_mm3;
        assert!((0.5..0.98).contains(&share), "{share}");
        assert!(f.thin_mm3 < 0.02 * f.region_mm3, "{f:?}");
    }
}

#[test]
fn the_same_plan_gives_the_same_paths_at_any_thread_count() {
    let w = tilted("generic-5axis");
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| paths(&w))
    };
    assert_eq!(with(1), with(3));
}

#[test]
fn plans_that_do_not_fit_the_job_are_refused() {
    let mut w = pocket("generic-5axis");
    w.plan.steps[0].holding = 3;
    let refused = for_unverified(&w.job, &w.plan, &Ctx::quiet());
    assert!(matches!(refused, Err(ToolpathError::NoHolding { step: 0, holding: 3, holdings: 1 })));
    let mut w = pocket("generic-5axis");
    w.plan.steps[0].tool = "spoon".into();
    assert!(for_unverified(&w.job, &w.plan, &Ctx::quiet()).is_err());
    let mut w = pocket("generic-5axis");
    w.plan.steps[0].region = BitGrid::new([3, 3, 3]);
    assert!(for_unverified(&w.job, &w.plan, &Ctx::quiet()).is_err());
    let mut w = pocket("generic-5axis");
    w.plan.steps[0].region = BitGrid::new(w.job.frame.dims);
    let refused = for_unverified(&w.job, &w.plan, &Ctx::quiet());
    assert!(matches!(refused, Err(ToolpathError::NothingToDo { step: 0 })));
}

/// A rib cut off a small block and a bar printed on it: the smallest whole program.
pub(crate) fn tiny(machine: &str) -> World {
    let start: Part = |p| p.x > 1.0 && p.x < 9.0 && p.y > 1.0 && p.y < 7.0 && p.z < 4.0;
    let rib: Part = |p| p.x > 6.0 && p.z > 3.0;
    let bar: Part = |p| p.x > 2.0 && p.x < 5.0 && p.y > 2.0 && p.y < 6.0 && p.z < 4.4;
    let size = DVec3::new(10.0, 8.0, 6.0);
    let steps: [(StepKind, DVec3, Part); 2] =
        [(StepKind::Subtractive, DVec3::Z, rib), (StepKind::Additive, DVec3::Z, bar)];
    world(machine, 0.5, size, start, &steps)
}

#[test]
fn verified_plans_give_verified_paths() {
    for (name, make) in WORLDS {
        let w = make("generic-5axis");
        let verdict = crate::verify::verify(&w.job, w.plan.clone(), &Ctx::quiet()).unwrap();
        let broken: Vec<_> = verdict.rules.iter().filter(|r| !r.passed).cloned().collect();
        let Ok(verified) = verdict.into_verified() else { panic!("{name}: {broken:?}") };
        assert!(for_plan(&w.job, &verified, &Ctx::quiet()).unwrap().verified());
    }
}

#[test]
fn supports_get_beads_though_no_mesh_has_a_section_there() {
    let plate: Part = |p| p.z < 4.0 && p.x > 2.0 && p.x < 22.0 && p.y > 2.0 && p.y < 18.0;
    let both: Part = |p| {
        let tower = p.x > 4.0 && p.x < 10.0;
        let support = p.x > 15.0 && p.x < 18.0;
        p.z < 10.0 && p.y > 6.0 && p.y < 12.0 && (tower || support)
    };
    let size = DVec3::new(24.0, 20.0, 14.0);
    let mut w = world("generic-5axis", 0.5, size, plate, &[(StepKind::Additive, DVec3::Z, both)]);
    let frame = w.job.frame;
    w.job.target = BitGrid::from_fn(frame.dims, |v| {
        w.job.target.get(v) && (frame.center(v).x < 12.0 || frame.center(v).z < 4.0)
    });
    let cuboid = |lo: [f64; 3], hi: [f64; 3]| TriMesh::cuboid(lo.into(), hi.into());
    let tower = cuboid([4.0, 6.0, 3.0], [10.0, 12.0, 10.0]);
    w.job.initial_mesh = cuboid([2.0, 2.0, 0.0], [22.0, 18.0, 4.0]);
    w.job.target_mesh = TriMesh::joined(&[w.job.initial_mesh.clone(), tower]);
    let path = &paths(&w)[0];
    let beads = |low: f64, high: f64| {
        let inside = |m: &&Move| m.kind == MoveKind::Deposit && m.tip.x > low && m.tip.x < high;
        let heights: BTreeSet<i64> =
            path.moves.iter().filter(inside).map(|m| (m.tip.z * 1e3).round() as i64).collect();
        heights.len()
    };
    // As many layers as the tower has.
    assert_eq!((beads(4.0, 10.0), beads(15.0, 18.0)), (30, 30));
}

/// The meshes end above the middle of the last layer of voxels that was cut away: those voxels stand
/// for what of the mesh is over them, too. A layer there had no beads, and the next one fed for two.
#[test]
fn what_was_cut_away_is_printed_up_to_the_meshes_own_face() {
    let plate: Part = |p| p.z < 4.0 && p.x > 2.0 && p.x < 22.0 && p.y > 2.0 && p.y < 18.0;
    let cut: Part = |p| p.x > 8.0;
    let back: Part = |p| {
        let tower = p.x > 12.0 && p.x < 20.0 && p.y > 6.0 && p.y < 14.0 && p.z < 8.0;
        let plate = p.z < 4.0 && p.x < 22.0 && p.y > 2.0 && p.y < 18.0;
        p.x > 8.0 && (plate || tower)
    };
    let size = DVec3::new(24.0, 20.0, 12.0);
    let steps = [(StepKind::Subtractive, DVec3::Z, cut), (StepKind::Additive, DVec3::Z, back)];
    let mut w = world("generic-5axis", 0.5, size, plate, &steps);
    let cuboid = |lo: [f64; 3], hi: [f64; 3]| TriMesh::cuboid(lo.into(), hi.into());
    let tower = cuboid([12.0, 6.0, 0.0], [20.0, 14.0, 8.0]);
    w.job.initial_mesh = cuboid([2.0, 2.0, 0.0], [22.0, 18.0, 4.2]);
    w.job.target_mesh = TriMesh::joined(&[w.job.initial_mesh.clone(), tower]);
    let path = &paths(&w)[1];
    let beads = path.moves.iter().filter(|m| m.kind == MoveKind::Deposit);
    let heights: BTreeSet<i64> = beads.map(|m| (m.tip.z * 1e3).round() as i64).collect();
    let steps: BTreeSet<i64> =
        heights.iter().zip(heights.iter().skip(1)).map(|(a, b)| b - a).collect();
    assert_eq!((heights.len(), steps), (40, BTreeSet::from([200])));
}

/// A sharp tip leaves no ridge however fine its passes are; they once had no least distance, and
/// the levels of a steep face no end.
#[test]
fn a_sharp_cone_makes_paths_that_end() {
    let mut w = pocket("generic-5axis");
    let cutter = &mut w.job.cutters[0];
    let edge = cutter.sections.iter_mut().find(|s| s.active).unwrap();
    edge.shape = Shape::Frustum { z0: 0.0, r0: 0.0, z1: 10.0, r1: 2.0 };
    cutter.sections.retain(|s| !s.active || matches!(s.shape, Shape::Frustum { z0: 0.0, .. }));
    let made = paths(&w);
    assert!(made[0].moves.len() > 100);
    let milling = Milling::of(&w.job.machine, &w.job.cutters[0]);
    // Two flanks rising 5 mm for each mm outward meet at the scallop's height.
    let apart = milling.finishing_stepover(&w.job.cutters[0]);
    assert!((apart * 5.0 / 2.0 - milling.scallop).abs() < 1e-12);
    assert!(milling.scallop > 0.0);
}
