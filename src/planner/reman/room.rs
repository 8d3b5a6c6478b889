//! Room: whether a cutter can be where it has to be for a voxel without going into the target's surface.
//!
//! Method. By the middles of voxels a cutter fits into gaps that its surfaces are too near each other for: up to
//! a voxel narrower than it, and whatever it cuts there it gouges one side or the other. So a place is looked for on
//! the target's mesh: from the voxel's middle the ball's middle goes away from the surface that is deepest in the ball
//! or in the edge over it, again and again, until nothing is deeper in either than a gouge, and never farther off
//! than the ball and half a voxel reach. Fixed points are kept off likewise where they are given. Where all of the
//! surface leaves no room, what of it stands after the cut is asked alone: a hole through what is printed later has no
//! walls yet.
//!
//! Guarantees: where there is room, all the balls that stand for the edge have it, at most [`APART`] of their radius
//! from each other, between which a ridge is at most a hundredth of a radius deeper in it. Not guaranteed: that a place is
//! found where there is one, for steps may miss it; shank, holder and what stands outside the target are not looked
//! at.

use crate::base::{Aabb, DVec3, Direction};
use crate::machine::Tool;
use crate::mesh::{NearestTriangle, TriMesh};
use crate::plan::Job;
use crate::voxel::{BitGrid, Frame, Rim, standing};
use rayon::prelude::*;
use std::collections::HashMap;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::{Mutex, PoisonError};

/// How deep its edge may bring a cutter into a surface, mm: a little less than what counts as a gouge.
const DEEP_MM: f64 = 0.045;

/// How deep in it a fixed point may be, mm: steps to and fro between points and a surface come no nearer to a place
/// free of both.
const FIXED_MM: f64 = 0.03;

/// Fixed points lie in cells of so many pitches a side, of which there are no more than so many.
const CELL_PITCH: f64 = 2.0;
const MOST_CELLS: f64 = 1e7;

/// Balls stand for the edge so many of their radii apart.
const APART: f64 = 0.3;

/// Steps away from the nearest of the surface, the first [`FULL_STEPS`] as far as there is to go, each of the others
/// by 0.7 of the one before.
const STEPS: i32 = 16;
const FULL_STEPS: i32 = 4;

/// Answers for more voxels than this are not kept: so many take 70 MB.
const MOST_KNOWN: usize = 1_000_000;

/// A gap between voxels is up to so many voxels wider on each side than that between the surfaces: what a cutter so much
/// wider does not reach is to be asked about here.
pub const WIDER_VOXELS: f64 = 1.0;

/// Fewer voxels without room beside the whole target are not asked about again beside what of it stands.
const LEAST_ASKED: usize = 8;

/// Where cutters have room in a job.
pub struct Room<'a> {
    frame: &'a Frame,
    target: &'a BitGrid,
    mesh: &'a TriMesh,
    surface: NearestTriangle,
    known: Mutex<Known>,
}

/// A tool, its direction, and the fixed points if any are looked at.
type Question = ((String, [u64; 3]), Option<u64>);

/// What was asked before: each of several passes over the cuts of a plan asks for much the same.
#[derive(Default)]
struct Known {
    of: HashMap<Question, HashMap<[usize; 3], bool>>,
    count: usize,
}

impl<'a> Room<'a> {
    pub fn of(job: &'a Job) -> Room<'a> {
        let widest = job.cutters.iter().map(Tool::active_radius).fold(0.0, f64::max);
        Room::among((&job.frame, &job.target, &job.target_mesh), widest)
    }

    /// Beside all of a target's surface, for cutters up to so wide.
    fn among((frame, target, mesh): (&'a Frame, &'a BitGrid, &'a TriMesh), widest: f64) -> Self {
        let surface = NearestTriangle::new(mesh, widest);
        Room { frame, target, mesh, surface, known: Mutex::default() }
    }

    /// Those of some voxels around which a cutter with a ball end has room along a direction, beside what of the target's
    /// surface stands after them and any fixed points given; these are not looked at for voxels farther from
    /// them than the ball is wide. All for another cutter, of which this is not known.
    pub fn after(
        &self,
        stands: &BitGrid,
        fixed: Option<&Points>,
        some: &BitGrid,
        way: (&Tool, Direction),
    ) -> BitGrid {
        let roomy = self.of_those(fixed, some, way);
        let none = some.minus(&roomy);
        if none.count() < LEAST_ASKED {
            return roomy;
        }
        // What is printed later is in no cutter's way.
        let open = self.beside_gaps(stands, &none, way);
        if open.is_empty() {
            return roomy;
        }
        let near = self.reach(&open, way);
        let surface = self.standing(stands, near, way.0.active_radius());
        let standing = Room { surface, known: Mutex::default(), ..*self };
        roomy.or(&standing.of_those(fixed, &open, way))
    }

    /// Those of some voxels beside and over which any of the target does not stand, as far as a cutter's edge may be
    /// there.
    fn beside_gaps(
        &self,
        stands: &BitGrid,
        some: &BitGrid,
        (tool, direction): (&Tool, Direction),
    ) -> BitGrid {
        let (plane, aside) = (direction.image_plane(), self.aside(tool));
        let near = self.reach(some, (tool, direction));
        let place = |p: DVec3| (plane.across(p) / aside).floor().to_array().map(|c| c as i64);
        let mut tops: HashMap<[i64; 2], f64> = HashMap::new();
        for p in self.target.minus(stands).iter_ones().map(|v| self.frame.center(v)) {
            if p.cmpge(near.min).all() && p.cmple(near.max).all() {
                let top = tops.entry(place(p)).or_insert(f64::NEG_INFINITY);
                *top = top.max(plane.height(p));
            }
        }
        let is_open = |v: &[usize; 3]| {
            let p = self.frame.center(*v);
            let ([i, j], low) = (place(p), plane.height(p) - aside);
            let mut beside = (-1..=1).flat_map(|b| (-1..=1).map(move |a| [i + a, j + b]));
            beside.any(|at| tops.get(&at).is_some_and(|top| *top >= low))
        };
        let mut open = BitGrid::new(some.dims());
        some.iter_ones().filter(is_open).for_each(|v| open.set(v, true));
        open
    }

    /// How far from a voxel that it is at a cutter may be to any side, its own width and a voxel over.
    fn aside(&self, tool: &Tool) -> f64 {
        2.0 * (tool.active_radius() + self.frame.pitch)
    }

    /// A box of all that a cutter's edge may be in at some voxels.
    fn reach(&self, some: &BitGrid, (tool, direction): (&Tool, Direction)) -> Aabb {
        let aside = self.aside(tool);
        some.extent().map_or(Aabb::EMPTY, |(low, high)| {
            let ends = [low, high].map(|v| self.frame.center(v));
            let tops = ends.map(|p| p + direction.vec() * tool.active_length());
            let all = Aabb::of(ends.into_iter().chain(tops));
            Aabb { min: all.min - aside, max: all.max + aside }
        })
    }

    /// What stands of the target's surface within a box, for cutters so wide.
    fn standing(&self, stands: &BitGrid, near: Aabb, radius: f64) -> NearestTriangle {
        let is_near = |t: &[DVec3; 3]| {
            let its = Aabb::of(*t);
            its.min.cmple(near.max).all() && its.max.cmpge(near.min).all()
        };
        let solids = [&stands.and(self.target), self.target];
        let pieces = standing(self.mesh, solids, self.frame, &is_near, Rim::Parted);
        NearestTriangle::among(pieces, radius)
    }

    /// Whether it is known where a cutter has room: one with a ball end, tapered or not.
    pub fn is_told_of(tool: &Tool) -> bool {
        tool.has_ball_end() || tool.is_tapered()
    }

    /// As [`Room::after`], beside all of the surface.
    fn of_those(
        &self,
        fixed: Option<&Points>,
        some: &BitGrid,
        (tool, direction): (&Tool, Direction),
    ) -> BitGrid {
        let Some(edge) = Edge::of(tool, direction) else { return some.clone() };
        let key = (tool.name.clone(), direction.vec().to_array().map(f64::to_bits));
        let (frame, beside) = (self.frame, self.frame.pitch / 2.0);
        let alone = Walls { surface: &self.surface, fixed: None };
        let has = |v: &[usize; 3]| edge.has_room(alone, frame.center(*v), beside);
        let mut roomy = self.known((key.clone(), None), some, has);
        let Some(fixed) = fixed else { return roomy };
        // The ball's middle is up to its radius and half a voxel from the voxel it touches.
        let wide = 2.0 * edge.radii[0] + frame.pitch;
        let mut near = BitGrid::new(some.dims());
        let is_near = |v: &[usize; 3]| fixed.nearer(frame.center(*v), wide).is_some();
        roomy.iter_ones().filter(is_near).for_each(|v| near.set(v, true));
        if !near.is_empty() {
            let both = Walls { surface: &self.surface, fixed: Some(fixed) };
            let has = |v: &[usize; 3]| edge.has_room(both, frame.center(*v), beside);
            let its = self.known((key, Some(fixed.id)), &near, has);
            roomy.subtract(&near.minus(&its));
        }
        roomy
    }

    /// Those of some voxels of which something holds, as far as it is not known.
    fn known(
        &self,
        key: Question,
        some: &BitGrid,
        has: impl Fn(&[usize; 3]) -> bool + Sync,
    ) -> BitGrid {
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let Known { of, count } = &mut *known;
        let its = of.entry(key).or_default();
        let voxels: Vec<[usize; 3]> = some.iter_ones().collect();
        let open: Vec<bool> =
            voxels.par_iter().map(|v| its.get(v).copied().unwrap_or_else(|| has(v))).collect();
        let mut roomy = BitGrid::new(some.dims());
        for (v, open) in voxels.into_iter().zip(open) {
            roomy.set(v, open);
            if *count < MOST_KNOWN && its.insert(v, open).is_none() {
                *count += 1;
            }
        }
        roomy
    }
}

/// What an edge keeps off.
#[derive(Clone, Copy)]
struct Walls<'a> {
    surface: &'a NearestTriangle,
    fixed: Option<&'a Points>,
}

impl Walls<'_> {
    /// What is deepest in a ball, if deeper than so much, or else than it may be: how deep, mm, where, and the way out
    /// of a surface.
    fn deepest(
        &self,
        middle: DVec3,
        radius: f64,
        than: Option<f64>,
    ) -> Option<(f64, DVec3, DVec3)> {
        let near = self.surface.nearer(middle, radius - than.unwrap_or(DEEP_MM));
        let wall = near.map(|near| (radius - near.distance, near.point, near.normal));
        let least = wall.map(|(deep, ..)| deep).or(than).unwrap_or(FIXED_MM);
        let point = self.fixed.and_then(|fixed| fixed.nearer(middle, radius - least));
        point.map(|p| (radius - p.distance(middle), p, DVec3::ZERO)).or(wall)
    }
}

/// Fixed points, by the cells of a grid over them.
pub struct Points {
    /// Side of a cell, mm.
    cell: f64,
    /// Corner of the first.
    origin: DVec3,
    n: [usize; 3],
    /// For each cell the number of its first point, and at last that of all.
    first: Vec<u32>,
    points: Vec<DVec3>,
    /// Of other points another.
    id: u64,
}

impl Points {
    /// Points of pedestal and table beside voxels of a frame.
    pub fn of(points: &[DVec3], frame: &Frame) -> Points {
        let all = Aabb::of(points.iter().copied());
        let mut cell = CELL_PITCH * frame.pitch;
        let n = |cell: f64| match points.is_empty() {
            true => [0; 3],
            false => ((all.max - all.min) / cell).to_array().map(|n| n.floor() as usize + 1),
        };
        while n(cell).iter().map(|n| *n as f64).product::<f64>() > MOST_CELLS {
            cell *= 2.0;
        }
        let mut hasher = DefaultHasher::new();
        points.iter().for_each(|p| p.to_array().map(f64::to_bits).hash(&mut hasher));
        let (id, first) = (hasher.finish(), Vec::new());
        let mut it = Points { cell, origin: all.min, n: n(cell), first, points: Vec::new(), id };
        let mut held: Vec<(usize, DVec3)> =
            points.iter().map(|p| (it.index(it.at(*p)), *p)).collect();
        held.sort_by_key(|(cell, _)| *cell);
        it.first = vec![0; it.n.iter().product::<usize>() + 1];
        held.iter().for_each(|(cell, _)| it.first[cell + 1] += 1);
        (1..it.first.len()).for_each(|i| it.first[i] += it.first[i - 1]);
        it.points = held.into_iter().map(|(_, p)| p).collect();
        it
    }

    fn at(&self, p: DVec3) -> [usize; 3] {
        let at = ((p - self.origin) / self.cell).floor().to_array();
        [0, 1, 2].map(|a| at[a].clamp(0.0, self.n[a].saturating_sub(1) as f64) as usize)
    }

    fn index(&self, [i, j, k]: [usize; 3]) -> usize {
        i + self.n[0] * (j + self.n[1] * k)
    }

    /// The nearest to a place that is nearer than `most` mm.
    fn nearer(&self, place: DVec3, most: f64) -> Option<DVec3> {
        let size = DVec3::from_array(self.n.map(|n| n as f64 * self.cell));
        let apart = (place.clamp(self.origin, self.origin + size) - place).length_squared();
        if self.points.is_empty() || apart >= most.max(0.0).powi(2) {
            return None;
        }
        let (low, high) = (self.at(place - most), self.at(place + most));
        let mut nearest: (f64, Option<DVec3>) = (most * most, None);
        for k in low[2]..=high[2] {
            for j in low[1]..=high[1] {
                // Cells side by side have their points so.
                let row = [low[0], high[0]].map(|i| self.index([i, j, k]));
                let points = self.first[row[0]] as usize..self.first[row[1] + 1] as usize;
                for p in &self.points[points] {
                    let square = p.distance_squared(place);
                    if square < nearest.0 {
                        nearest = (square, Some(*p));
                    }
                }
            }
        }
        nearest.1
    }
}

/// A ball end and the edge over it.
struct Edge {
    /// Radius of the ball and of the edge's top, mm.
    radii: [f64; 2],
    /// From the ball's middle up.
    axis: DVec3,
    /// So far the edge goes up from there, mm.
    length: f64,
}

impl Edge {
    /// None of a cutter with another end.
    fn of(tool: &Tool, direction: Direction) -> Option<Edge> {
        let radii = [tool.tip_radius(), tool.active_radius()];
        let length = tool.active_length() - radii[0];
        Room::is_told_of(tool).then(|| Edge { radii, axis: direction.vec(), length })
    }

    fn radius_at(&self, s: f64) -> f64 {
        let [ball, top] = self.radii;
        ball + (top - ball) * (s / self.length).clamp(0.0, 1.0)
    }

    /// Where what it keeps off is deepest in the edge, if deeper than it may be: how far along the axis, how deep, mm,
    /// where, and the way out of a surface.
    fn deepest(&self, walls: Walls, middle: DVec3) -> Option<(f64, f64, DVec3, DVec3)> {
        let (mut s, mut deepest): (f64, Option<(f64, f64, DVec3, DVec3)>) = (0.0, None);
        while s <= self.length {
            let radius = self.radius_at(s);
            let than = deepest.map(|(_, deep, ..)| deep);
            if let Some((deep, at, out)) = walls.deepest(middle + self.axis * s, radius, than) {
                deepest = Some((s, deep, at, out));
            }
            s += APART * radius;
        }
        deepest
    }

    /// Whether it keeps off a surface somewhere where its ball touches what lies within `beside` of a point.
    fn has_room(&self, walls: Walls, p: DVec3, beside: f64) -> bool {
        let mut middle = p;
        for k in 0..STEPS {
            let Some((s, deep, at, out)) = self.deepest(walls, middle) else { return true };
            let mut away = middle + self.axis * s - at;
            if s > 0.0 {
                away -= self.axis * away.dot(self.axis);
            }
            let away = away.try_normalize().unwrap_or(out);
            // Between two walls whole steps would go to and fro.
            let share = 0.7f64.powi((k - FULL_STEPS).max(0));
            middle += away * (deep * share);
            middle = p + (middle - p).clamp_length_max(self.radii[0] + beside);
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Ctx;
    use crate::machine::Machine;
    use crate::voxel::voxelise;
    use rand::RngExt;

    fn alone(surface: &NearestTriangle) -> Walls<'_> {
        Walls { surface, fixed: None }
    }

    /// Two blocks with a gap of so many mm between them.
    fn gap(width: f64) -> TriMesh {
        let block =
            |z: f64| TriMesh::cuboid(DVec3::new(0.0, 0.0, z), DVec3::new(9.0, 9.0, z + 3.0));
        TriMesh::joined(&[block(0.0), block(3.0 + width)])
    }

    #[test]
    fn a_gap_has_room_for_what_is_narrower_than_it() {
        for width in [1.15, 1.35, 2.05] {
            let mesh = gap(width);
            let surface = NearestTriangle::new(&mesh, 1.5);
            for k in 1..10 {
                let p = DVec3::new(4.5, 4.0, 3.0 + width * f64::from(k) / 10.0);
                for radius in [0.5, 0.7, 1.0, 1.5] {
                    let fits = 2.0 * (radius - DEEP_MM) <= width;
                    let edge = Edge { radii: [radius; 2], axis: DVec3::NEG_X, length: 20.0 };
                    let found = edge.has_room(alone(&surface), p, 0.1);
                    assert!(found == fits, "{width} {k} {radius}");
                }
            }
        }
    }

    /// Into a gap of 1.2 mm an edge of 1 mm that widens to 1.4 mm over 20 mm goes as deep as it is narrow enough.
    #[test]
    fn a_tapered_edge_has_room_as_deep_as_it_is_narrow() {
        let mesh = gap(1.2);
        let surface = NearestTriangle::new(&mesh, 1.5);
        let edge = Edge { radii: [0.5, 1.5], axis: DVec3::NEG_X, length: 20.0 };
        // Gouges let it in as if the gap were 1.3 mm wide: to a radius of 0.65 mm, 3 mm over the ball.
        for (x, fits) in [(1.0, true), (2.0, true), (3.8, false), (5.0, false)] {
            assert_eq!(edge.has_room(alone(&surface), DVec3::new(x, 4.5, 3.6), 0.1), fits, "{x}");
        }
    }

    /// Over a table of points a cutter has room under a ledge that is farther from them than it is wide.
    #[test]
    fn fixed_points_are_kept_off() {
        let ledge = TriMesh::cuboid(DVec3::new(0.0, 0.0, 1.2), DVec3::new(9.0, 9.0, 4.0));
        let surface = NearestTriangle::new(&ledge, 1.5);
        let table: Vec<DVec3> = (0..100 * 60)
            .map(|k| DVec3::new(f64::from(k % 100), f64::from(k / 100), 0.0) * 0.1 + DVec3::X)
            .collect();
        let frame = Frame { pitch: 0.2, dims: [50, 50, 30], origin: DVec3::splat(-0.2) };
        let fixed = Points::of(&table, &frame);
        for (radius, fits) in [(0.5, true), (0.57, true), (0.64, false), (0.7, false)] {
            let edge = Edge { radii: [radius; 2], axis: DVec3::NEG_Y, length: 20.0 };
            let walls = Walls { surface: &surface, fixed: Some(&fixed) };
            let p = DVec3::new(5.0, 3.0, 0.6);
            assert_eq!(edge.has_room(walls, p, 0.1), fits, "{radius}");
            assert!(edge.has_room(alone(&surface), p, 0.1));
        }
    }

    /// What is known of one table is not told of another, nor of none; the nearest of its points is that of all.
    #[test]
    fn each_table_is_asked_for_itself() {
        let machine = Machine::builtin("generic-5axis").unwrap();
        let ledge = TriMesh::cuboid(DVec3::new(0.0, 0.0, 1.2), DVec3::new(9.0, 9.0, 4.0));
        let frame = Frame { pitch: 0.2, dims: [50, 50, 30], origin: DVec3::splat(-0.2) };
        let none = BitGrid::new(frame.dims);
        let room = Room::among((&frame, &none, &ledge), 1.5);
        let table = |z: f64| {
            let points = (0..100 * 60)
                .map(|k| DVec3::new(f64::from(k % 100), f64::from(k / 100), 0.0) * 0.1)
                .map(|p| p + DVec3::Z * z);
            Points::of(&points.collect::<Vec<_>>(), &frame)
        };
        let some = BitGrid::from_fn(frame.dims, |v| v == [26, 16, 4]);
        let tool = machine.tools.iter().find(|t| t.name == "ball-1x16").unwrap();
        let along = Direction::new(DVec3::NEG_Y).unwrap();
        let has = |points: Option<&Points>| !room.of_those(points, &some, (tool, along)).is_empty();
        let (low, high) = (table(0.0), table(0.4));
        for _ in 0..2 {
            assert!(has(None) && has(Some(&low)) && !has(Some(&high)));
        }
        assert!(has(Some(&Points::of(&[], &frame))));
        let mut rng = crate::base::rng(4, 0);
        for _ in 0..400 {
            let place = DVec3::from_array([0, 1, 2].map(|_| rng.random_range(-3.0..12.0)));
            let most = rng.random_range(-0.5..6.0);
            let nearest =
                low.points.iter().map(|p| p.distance(place)).fold(f64::INFINITY, f64::min);
            let found = low.nearer(place, most).map(|p| p.distance(place));
            assert_eq!(found, Some(nearest).filter(|d| *d < most), "{place} {most}");
        }
    }

    /// A gap too narrow for a cutter has room for it while one of its sides is still to be printed.
    #[test]
    fn what_does_not_stand_yet_takes_no_room() {
        let machine = Machine::builtin("generic-5axis").unwrap();
        let mesh = gap(1.2);
        let frame = Frame { pitch: 0.2, dims: [50, 50, 40], origin: DVec3::splat(-0.2) };
        let target = voxelise(&mesh, &frame, &Ctx::quiet()).unwrap();
        let room = Room::among((&frame, &target, &mesh), 1.5);
        let low = BitGrid::from_fn(frame.dims, |v| frame.center(v).z < 3.6);
        let in_gap = |v: [usize; 3]| {
            let p = frame.center(v);
            (p.x - 4.5).abs() < 0.5 && (p.y - 4.5).abs() < 0.5 && p.z > 3.0 && p.z < 4.2
        };
        let some = BitGrid::from_fn(frame.dims, in_gap);
        assert!(some.count() > 2 * LEAST_ASKED);
        let along = Direction::new(DVec3::NEG_X).unwrap();
        for (name, fits) in [("ball-1.4x24", false), ("ball-1x16", true)] {
            let tool = machine.tools.iter().find(|t| t.name == name).unwrap();
            let after = |stands: &BitGrid| room.after(stands, None, &some, (tool, along));
            assert_eq!(after(&target) == some, fits, "{name}");
            assert_eq!(after(&target).is_empty(), !fits, "{name}");
            assert_eq!(after(&target.and(&low)), some, "{name}");
            assert_eq!(after(&BitGrid::new(frame.dims)), some, "{name}");
        }
    }

    /// Before a gap there is room for the ball, not for the edge that has to go through it.
    #[test]
    fn the_edge_needs_room_too() {
        let mesh = gap(1.15);
        let surface = NearestTriangle::new(&mesh, 1.5);
        let p = DVec3::new(9.6, 4.5, 3.6);
        let edge = |axis| Edge { radii: [0.7; 2], axis, length: 20.0 };
        assert!(edge(DVec3::X).has_room(alone(&surface), p, 0.1));
        assert!(!edge(DVec3::NEG_X).has_room(alone(&surface), p, 0.1));
    }

    /// Beside a wall, on a floor and in the open there is.
    #[test]
    fn a_face_alone_leaves_room() {
        let mesh = gap(50.0);
        let surface = NearestTriangle::new(&mesh, 1.5);
        for p in [DVec3::new(4.0, 4.0, 3.01), DVec3::new(-0.05, 4.0, 1.0), DVec3::splat(-9.0)] {
            let edge = Edge { radii: [1.5; 2], axis: DVec3::Z, length: 20.0 };
            assert!(edge.has_room(alone(&surface), p, 0.1), "{p}");
        }
    }
}
