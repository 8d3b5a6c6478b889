//! How near the end of a cutter can come to a point of the target without entering it.
//!
//! Method: over every position across, the end rests on the target's triangles by drop-cutter; the
//! least distance from the point to the resting end is looked for where the point's normal would
//! have it, on a grid over the end's radius, and around the best of these in halving steps.
//!
//! Guarantees: the answer is the distance of an end that enters no triangle, so a point that it
//! calls out of reach by less than it says is never excused. Not guaranteed: the very least, to
//! [`LEAST_STEP_MM`]; shank, holder and what else stands are not asked: they could only excuse more.

use crate::base::{DVec2, DVec3, ImagePlane};
use crate::mesh::TriMesh;
use crate::toolpath::{DropCutter, End};

/// Steps of the first grid in the end's radius: coarser ones miss the way into a groove.
const STEPS: f64 = 8.0;

/// Step at which the search ends, mm: far below what counts as left.
const LEAST_STEP_MM: f64 = 0.005;

pub(super) struct Reach {
    plane: ImagePlane,
    end: End,
    drop: DropCutter,
}

impl Reach {
    pub fn new(target: &TriMesh, plane: ImagePlane, end: End) -> Reach {
        let turned = |p: DVec3| plane.across(p).extend(plane.height(p));
        let corners = (0..target.triangles().len()).map(|t| target.corners(t).map(turned));
        let drop = DropCutter::new(corners.collect(), end.radius());
        Reach { plane, end, drop }
    }

    /// Least distance from a point of the target, whose outward normal is given, to an end that
    /// rests on the target, mm.
    pub fn least(&self, p: DVec3, normal: DVec3) -> f64 {
        let (uv, z) = (self.plane.across(p), self.plane.height(p));
        let away = |q: DVec2| {
            let tip = self.drop.height(self.end, q).unwrap_or(f64::NEG_INFINITY);
            self.end.distance(q.distance(uv), z - tip).max(0.0)
        };
        let radius = self.end.radius();
        let mut best = (away(uv), uv);
        let look = |q: DVec2, best: &mut (f64, DVec2)| {
            let d = away(q);
            let nearer = d < best.0;
            if nearer {
                *best = (d, q);
            }
            nearer
        };
        look(uv + self.end.contact_to_axis(self.plane.across(normal)), &mut best);
        // One step beyond the radius: an end beside a wall stands just clear of it.
        let n = STEPS as i32 + 1;
        for (i, j) in (-n..=n).flat_map(|i| (-n..=n).map(move |j| (i, j))) {
            if best.0 < LEAST_STEP_MM {
                return best.0;
            }
            let q = DVec2::new(f64::from(i), f64::from(j)) * (radius / STEPS);
            if q.length() <= radius * (1.0 + 1.0 / STEPS) {
                look(uv + q, &mut best);
            }
        }
        let mut step = radius / STEPS / 2.0;
        while step > LEAST_STEP_MM {
            let from = best.1;
            let mut nearer = false;
            for (i, j) in (-1..=1).flat_map(|i| (-1..=1).map(move |j| (i, j))) {
                nearer |= look(from + DVec2::new(f64::from(i), f64::from(j)) * step, &mut best);
            }
            if !nearer {
                step /= 2.0;
            }
        }
        best.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Direction;

    #[test]
    fn a_ball_comes_to_floors_and_walls_but_not_into_the_edge_between() {
        // A step: floor at z = 0 for x > 0, wall at x = 0 up to 10.
        let low = TriMesh::cuboid(DVec3::new(-20.0, -20.0, -5.0), DVec3::new(20.0, 20.0, 0.0));
        let high = TriMesh::cuboid(DVec3::new(-20.0, -20.0, 0.0), DVec3::new(0.0, 20.0, 10.0));
        let mut vertices = low.vertices().to_vec();
        let shift = vertices.len() as u32;
        vertices.extend(high.vertices());
        let mut triangles = low.triangles().to_vec();
        triangles.extend(high.triangles().iter().map(|t| t.map(|v| v + shift)));
        let mesh = TriMesh::new(vertices, triangles).unwrap();
        let up = Direction::Z.image_plane();
        let ball = Reach::new(&mesh, up, End::Ball { radius: 2.0 });
        let flat = Reach::new(&mesh, up, End::Flat { radius: 2.0 });
        assert!(ball.least(DVec3::new(5.0, 1.0, 0.0), DVec3::Z) < 0.01);
        assert!(ball.least(DVec3::new(0.0, 1.0, 6.0), DVec3::X) < 0.01);
        assert!(ball.least(DVec3::new(2.1, 1.0, 0.0), DVec3::Z) < 0.01);
        // The corner is r (√2 − 1) from the ball that touches both.
        let corner = ball.least(DVec3::new(0.0, 1.0, 0.0), DVec3::Z);
        assert!((corner - 2.0 * (2f64.sqrt() - 1.0)).abs() < 0.02, "{corner}");
        assert!(flat.least(DVec3::new(0.0, 1.0, 0.0), DVec3::Z) < 0.02);
        // From below, the top of the wall is out of reach altogether.
        let below = Reach::new(&mesh, Direction::NEG_Z.image_plane(), End::Ball { radius: 2.0 });
        assert!(below.least(DVec3::new(-9.0, 1.0, 10.0), DVec3::Z) > 2.0);
    }
}
