//! Room: whether a cutter can be where it has to be for a voxel without going into the target's surface.
//!
//! Method. By the middles of voxels a cutter fits into gaps that its surfaces are too near each other for: up to
//! a voxel narrower than it, and whatever it cuts there it gouges one side or the other. So a place is looked for on
//! the target's mesh: from the voxel's middle the ball's middle goes away from the surface that is deepest in the ball
//! or in the edge over it, again and again, until nothing is deeper in either than a gouge, and never farther off
//! than the ball and half a voxel reach.
//!
//! Guarantees: where there is room, all the balls that stand for the edge have it, at most [`APART`] of their radius
//! from each other, between which a ridge is at most a hundredth of a radius deeper in it. Not guaranteed: that a place is
//! found where there is one, for steps may miss it; shank, holder and what stands outside the target are not looked
//! at.

use crate::base::{DVec3, Direction};
use crate::machine::Tool;
use crate::mesh::{NearestTriangle, SurfacePoint};
use crate::plan::Job;
use crate::voxel::{BitGrid, Frame};
use rayon::prelude::*;
use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};

/// How deep its edge may bring a cutter into a surface, mm: a little less than what counts as a gouge.
const GOUGE_MM: f64 = 0.045;

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

/// Where cutters have room in a job.
pub struct Room<'a> {
    frame: &'a Frame,
    surface: NearestTriangle,
    known: Mutex<Known>,
}

/// What was asked before, tool by tool and direction by direction: each of several passes over the cuts of a plan asks
/// for much the same.
#[derive(Default)]
struct Known {
    of: HashMap<(String, [u64; 3]), HashMap<[usize; 3], bool>>,
    count: usize,
}

impl<'a> Room<'a> {
    pub fn of(job: &'a Job) -> Room<'a> {
        let widest = job.cutters.iter().map(Tool::active_radius).fold(0.0, f64::max);
        let surface = NearestTriangle::new(&job.target_mesh, widest);
        Room { frame: &job.frame, surface, known: Mutex::default() }
    }

    /// Whether it is known where a cutter has room: one with a ball end, tapered or not.
    pub fn is_told_of(tool: &Tool) -> bool {
        tool.has_ball_end() || tool.is_tapered()
    }

    /// Those of some voxels around which a cutter with a ball end has room along a direction; all of them for
    /// another cutter, of which this is not known.
    pub fn of_those(&self, some: &BitGrid, (tool, direction): (&Tool, Direction)) -> BitGrid {
        let Some(edge) = Edge::of(tool, direction) else { return some.clone() };
        let (frame, beside) = (self.frame, self.frame.pitch / 2.0);
        let has = |v: &[usize; 3]| edge.has_room(&self.surface, frame.center(*v), beside);
        let key = (tool.name.clone(), direction.vec().to_array().map(f64::to_bits));
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

    /// Where the surface is deepest in the edge, if deeper than a gouge: how far along the axis, how deep, mm.
    fn deepest(
        &self,
        surface: &NearestTriangle,
        middle: DVec3,
    ) -> Option<(f64, f64, SurfacePoint)> {
        let (mut s, mut deepest) = (0.0, None);
        while s <= self.length {
            let radius = self.radius_at(s);
            let least = deepest.map_or(GOUGE_MM, |(_, deep, _)| deep);
            if let Some(near) = surface.nearer(middle + self.axis * s, radius - least) {
                deepest = Some((s, radius - near.distance, near));
            }
            s += APART * radius;
        }
        deepest
    }

    /// Whether it keeps off a surface somewhere where its ball touches what lies within `beside` of a point.
    fn has_room(&self, surface: &NearestTriangle, p: DVec3, beside: f64) -> bool {
        let mut middle = p;
        for k in 0..STEPS {
            let Some((s, deep, near)) = self.deepest(surface, middle) else { return true };
            let mut away = middle + self.axis * s - near.point;
            if s > 0.0 {
                away -= self.axis * away.dot(self.axis);
            }
            let away = away.try_normalize().unwrap_or(near.normal);
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
    use crate::mesh::TriMesh;

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
                    let fits = 2.0 * (radius - GOUGE_MM) <= width;
                    let edge = Edge { radii: [radius; 2], axis: DVec3::NEG_X, length: 20.0 };
                    let found = edge.has_room(&surface, p, 0.1);
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
            assert_eq!(edge.has_room(&surface, DVec3::new(x, 4.5, 3.6), 0.1), fits, "{x}");
        }
    }

    /// Before a gap there is room for the ball, not for the edge that has to go through it.
    #[test]
    fn the_edge_needs_room_too() {
        let mesh = gap(1.15);
        let surface = NearestTriangle::new(&mesh, 1.5);
        let p = DVec3::new(9.6, 4.5, 3.6);
        let edge = |axis| Edge { radii: [0.7; 2], axis, length: 20.0 };
        assert!(edge(DVec3::X).has_room(&surface, p, 0.1));
        assert!(!edge(DVec3::NEG_X).has_room(&surface, p, 0.1));
    }

    /// Beside a wall, on a floor and in the open there is.
    #[test]
    fn a_face_alone_leaves_room() {
        let mesh = gap(50.0);
        let surface = NearestTriangle::new(&mesh, 1.5);
        for p in [DVec3::new(4.0, 4.0, 3.01), DVec3::new(-0.05, 4.0, 1.0), DVec3::splat(-9.0)] {
            let edge = Edge { radii: [1.5; 2], axis: DVec3::Z, length: 20.0 };
            assert!(edge.has_room(&surface, p, 0.1), "{p}");
        }
    }
}
