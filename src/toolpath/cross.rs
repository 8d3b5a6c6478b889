//! Plane sections of a triangle mesh as polygons.
//!
//! Method: vertices are measured once in (u, v, d); a plane d = z cuts every triangle with vertices on
//! both sides (one at z counts as below) in a segment between two mesh edges, and segments that
//! share an edge are joined. Each loop is turned so that most of its length has the mesh's inside
//! on its left, so single triangles facing the wrong way do not matter.
//!
//! Guarantees: points lie on the mesh to rounding; loops close. Not guaranteed: a section of a
//! mesh with holes, which is none: its loops do not close, and the caller must do without.

use super::slice::{Outline, area};
use crate::base::{DVec2, ImagePlane};
use crate::mesh::TriMesh;

/// A mesh made ready to be cut across one direction.
pub(super) struct Sections<'a> {
    mesh: &'a TriMesh,
    /// (u, v) and height of each vertex.
    points: Vec<(DVec2, f64)>,
    /// Triangles by the slabs of height that they reach into.
    slabs: Vec<Vec<u32>>,
    low: f64,
    slab: f64,
}

/// Slabs over the height of a mesh: finer only costs memory.
const SLABS: usize = 512;

impl<'a> Sections<'a> {
    /// None for an empty mesh.
    pub fn new(mesh: &'a TriMesh, plane: &ImagePlane) -> Option<Sections<'a>> {
        let points: Vec<(DVec2, f64)> =
            mesh.vertices().iter().map(|p| (plane.across(*p), plane.height(*p))).collect();
        if mesh.is_empty() {
            return None;
        }
        let used = || mesh.triangles().iter().flatten().map(|v| points[*v as usize].1);
        let (low, high) = (used().fold(f64::INFINITY, f64::min), used().fold(f64::MIN, f64::max));
        let slab = ((high - low) / SLABS as f64).max(1e-9);
        let mut sections = Sections { mesh, points, slabs: vec![Vec::new(); SLABS], low, slab };
        for (t, corners) in mesh.triangles().iter().enumerate() {
            let z = corners.map(|v| sections.points[v as usize].1);
            let at = |z: f64| sections.slab_of(z);
            let (first, last) = (at(z[0].min(z[1]).min(z[2])), at(z[0].max(z[1]).max(z[2])));
            for s in first..=last {
                sections.slabs[s].push(t as u32);
            }
        }
        Some(sections)
    }

    fn slab_of(&self, z: f64) -> usize {
        (((z - self.low) / self.slab).max(0.0) as usize).min(SLABS - 1)
    }

    /// Heights of the mesh's corners within a box of (u, v).
    pub fn heights_within(&self, lo: DVec2, hi: DVec2) -> impl Iterator<Item = f64> + '_ {
        let inside = move |p: DVec2| p.cmpge(lo).all() && p.cmple(hi).all();
        self.points.iter().filter(move |(p, _)| inside(*p)).map(|(_, z)| *z)
    }

    /// Outlines at height `z`, to be filled where the winding number is not zero; none where the
    /// mesh has a hole.
    pub fn at(&self, z: f64) -> Option<Vec<Outline>> {
        let segments = self.segments(z);
        // Both ends of every segment, by the mesh edge they lie on.
        let mut ends: Vec<(u64, u32)> = segments
            .iter()
            .enumerate()
            .flat_map(|(i, s)| [(s.edges[0], 2 * i as u32), (s.edges[1], 2 * i as u32 + 1)])
            .collect();
        ends.sort_unstable();
        let mut partner = vec![u32::MAX; ends.len()];
        let mut at = 0;
        while at < ends.len() {
            if at + 1 == ends.len() || ends[at].0 != ends[at + 1].0 {
                return None;
            }
            let (a, b) = (ends[at].1, ends[at + 1].1);
            (partner[a as usize], partner[b as usize]) = (b, a);
            at += 2;
        }
        let mut seen = vec![false; segments.len()];
        let mut out = Vec::new();
        for first in 0..segments.len() {
            if seen[first] {
                continue;
            }
            let (mut outline, mut facing) = (Outline::new(), 0.0);
            let mut end = 2 * first as u32;
            while !seen[(end / 2) as usize] {
                let s = &segments[(end / 2) as usize];
                seen[(end / 2) as usize] = true;
                let (from, to) = ((end % 2) as usize, 1 - (end % 2) as usize);
                outline.push(s.points[from]);
                facing += (s.points[to] - s.points[from]).dot(s.left);
                end = partner[(end ^ 1) as usize];
            }
            if facing < 0.0 {
                outline.reverse();
            }
            if outline.len() >= 3 && area(std::slice::from_ref(&outline)) != 0.0 {
                out.push(outline);
            }
        }
        Some(out)
    }

    fn segments(&self, z: f64) -> Vec<Segment> {
        let mut out = Vec::new();
        for &t in &self.slabs[self.slab_of(z)] {
            let corners = self.mesh.triangles()[t as usize];
            let p = corners.map(|v| self.points[v as usize]);
            let above = p.map(|q| q.1 > z);
            let Some(lone) =
                (0..3).find(|i| above[*i] != above[(i + 1) % 3] && above[*i] != above[(i + 2) % 3])
            else {
                continue;
            };
            let cut = |j: usize| {
                // Always from the lower corner's number, so that both triangles of an edge agree.
                let (a, b) = if corners[lone] < corners[j] { (lone, j) } else { (j, lone) };
                let t = (z - p[a].1) / (p[b].1 - p[a].1);
                let edge = u64::from(corners[a]) << 32 | u64::from(corners[b]);
                (p[a].0.lerp(p[b].0, t), edge)
            };
            let (a, b) = (cut((lone + 1) % 3), cut((lone + 2) % 3));
            // The outward normal's part in the plane, turned a quarter to the left.
            let (e1, e2) = (p[1].0 - p[0].0, p[2].0 - p[0].0);
            let (h1, h2) = (p[1].1 - p[0].1, p[2].1 - p[0].1);
            let normal = DVec2::new(e1.y * h2 - h1 * e2.y, h1 * e2.x - e1.x * h2);
            let left = normal.perp().normalize_or_zero();
            out.push(Segment { points: [a.0, b.0], edges: [a.1, b.1], left });
        }
        out
    }
}

struct Segment {
    points: [DVec2; 2],
    /// Mesh edges its ends lie on.
    edges: [u64; 2],
    /// The way along which the inside is on the left.
    left: DVec2,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::{DVec3, Direction};

    fn cut(mesh: &TriMesh, d: DVec3, z: f64) -> Vec<Outline> {
        let plane = Direction::new(d).unwrap().image_plane();
        Sections::new(mesh, &plane).unwrap().at(z).unwrap()
    }

    #[test]
    fn a_cuboid_is_cut_in_its_rectangle_from_any_side() {
        let mesh = TriMesh::cuboid(DVec3::ZERO, DVec3::new(3.0, 4.0, 5.0));
        for (d, want) in [(DVec3::Z, 12.0), (DVec3::NEG_X, 20.0), (DVec3::Y, 15.0)] {
            let plane = Direction::new(d).unwrap();
            let found = cut(&mesh, d, plane.dot(DVec3::new(1.0, 1.0, 1.0)));
            assert!((area(&found) - want).abs() < 1e-12, "{d}: {}", area(&found));
        }
        // On a face: a corner at z counts as below.
        assert!(cut(&mesh, DVec3::Z, 5.0).is_empty());
        assert!((area(&cut(&mesh, DVec3::Z, 0.0)) - 12.0).abs() < 1e-12);
        assert!(cut(&mesh, DVec3::Z, 9.0).is_empty());
        // Across a body diagonal's middle: a hexagon.
        let cube = TriMesh::cuboid(DVec3::ZERO, DVec3::ONE);
        let found = area(&cut(&cube, DVec3::ONE, 0.75f64.sqrt()));
        assert!((found - 0.75 * 3f64.sqrt()).abs() < 1e-12, "{found}");
    }

    #[test]
    fn triangles_that_face_the_wrong_way_do_not_turn_the_outline() {
        let whole = TriMesh::cuboid(DVec3::ZERO, DVec3::ONE);
        let flip = |(i, t): (usize, &[u32; 3])| if i % 4 == 0 { [t[0], t[2], t[1]] } else { *t };
        let triangles = whole.triangles().iter().enumerate().map(flip).collect();
        let mesh = TriMesh::new(whole.vertices().to_vec(), triangles).unwrap();
        assert!((area(&cut(&mesh, DVec3::Z, 0.5)) - 1.0).abs() < 1e-12);
        let open =
            TriMesh::new(whole.vertices().to_vec(), whole.triangles()[1..].to_vec()).unwrap();
        let cuts = [DVec3::X, DVec3::Y, DVec3::Z].map(|d| {
            let plane = Direction::new(d).unwrap().image_plane();
            Sections::new(&open, &plane).unwrap().at(0.5).is_none()
        });
        assert!(cuts.contains(&true), "a hole has no section");
    }
}
