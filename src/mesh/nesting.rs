//! Tells bodies turned inside out from cavities.
//!
//! Method: a closed body of negative volume is a cavity when an odd number of the other closed
//! bodies' walls lie between it and infinity along a ray, and inside out otherwise.

use super::TriMesh;
use crate::base::{Aabb, DVec3};
use std::collections::BTreeMap;

/// Bodies of negative volume that are told from cavities, largest first. Each takes a ray through
/// the bodies round it; more makes a scan full of specks take quadratic time.
pub(super) const MAX_EXAMINED: usize = 256;

/// The ray's direction: slanted to all axes, so that it does not run along the edges of machined
/// parts.
const RAY: DVec3 = DVec3::new(0.816_496_6, 0.517_638_1, 0.256_604_7);

struct Body {
    triangles: Vec<u32>,
    bounds: Aabb,
    volume: f64,
}

/// How many closed bodies are inside out once the triangles marked `flipped` are turned.
pub(super) fn count_inside_out(
    mesh: &TriMesh,
    body_of: &[u32],
    closed: &[bool],
    flipped: &[bool],
) -> usize {
    let mut bodies = BTreeMap::<u32, Vec<u32>>::new();
    for (t, body) in (0u32..).zip(body_of).filter(|(t, _)| closed[*t as usize]) {
        bodies.entry(*body).or_default().push(t);
    }
    let bodies: Vec<Body> =
        bodies.into_values().map(|triangles| Body::of(mesh, triangles, flipped)).collect();
    let mut negative: Vec<usize> = (0..bodies.len()).filter(|i| bodies[*i].volume < 0.0).collect();
    negative.sort_by(|a, b| bodies[*a].volume.total_cmp(&bodies[*b].volume));
    negative.truncate(MAX_EXAMINED);
    negative.into_iter().filter(|i| depth(mesh, &bodies, *i).is_multiple_of(2)).count()
}

impl Body {
    fn of(mesh: &TriMesh, triangles: Vec<u32>, flipped: &[bool]) -> Body {
        let corners = |t: &u32| mesh.corners(*t as usize);
        let bounds = Aabb::of(triangles.iter().flat_map(corners));
        let o = bounds.center();
        let signed = |t: &u32| {
            let [a, b, c] = corners(t).map(|p| p - o);
            let v = a.dot(b.cross(c));
            if flipped[*t as usize] { -v } else { v }
        };
        let six_volumes: f64 = triangles.iter().map(signed).sum();
        // What rounding leaves of a flat body is no volume.
        let noise = 1e-12 * bounds.size().length().powi(3);
        let volume = if six_volumes.abs() > noise { six_volumes / 6.0 } else { 0.0 };
        Body { triangles, bounds, volume }
    }

    fn may_hold(&self, other: &Body) -> bool {
        self.bounds.min.cmple(other.bounds.min).all()
            && self.bounds.max.cmpge(other.bounds.max).all()
    }
}

/// Walls of other bodies between body `inner` and infinity.
fn depth(mesh: &TriMesh, bodies: &[Body], inner: usize) -> usize {
    let from = mesh.corners(bodies[inner].triangles[0] as usize)[0];
    bodies
        .iter()
        .enumerate()
        .filter(|(i, body)| *i != inner && body.may_hold(&bodies[inner]))
        .flat_map(|(_, body)| &body.triangles)
        .filter(|t| crosses(mesh.corners(**t as usize), from))
        .count()
}

/// Whether the ray from `from` crosses the triangle (Möller and Trumbore 1997).
fn crosses([a, b, c]: [DVec3; 3], from: DVec3) -> bool {
    let (u_edge, v_edge) = (b - a, c - a);
    let p = RAY.cross(v_edge);
    let determinant = u_edge.dot(p);
    if determinant == 0.0 {
        return false;
    }
    let to_start = from - a;
    let u = to_start.dot(p) / determinant;
    let q = to_start.cross(u_edge);
    let v = RAY.dot(q) / determinant;
    u >= 0.0 && v >= 0.0 && u + v <= 1.0 && v_edge.dot(q) / determinant > 0.0
}
