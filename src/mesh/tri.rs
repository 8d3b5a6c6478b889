use crate::base::{Aabb, DAffine3, DVec3};

/// An indexed triangle mesh in millimetres. Counter-clockwise seen from outside.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TriMesh {
    vertices: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
}

#[derive(Debug, thiserror::Error, PartialEq)]
pub enum InvalidMesh {
    #[error("vertex {index} is not finite ({value})")]
    NotFinite { index: usize, value: DVec3 },
    #[error("vertex {index} lies {value:?} mm from the origin, beyond any part this program plans")]
    TooFar { index: usize, value: f64 },
    #[error("triangle {triangle} names vertex {vertex}, but there are only {vertices}")]
    IndexOutOfRange { triangle: usize, vertex: u32, vertices: usize },
}

/// Coordinates beyond this (mm) make squared lengths and grid sizes overflow long before they
/// could be a part; a kilometre is a thousand times the largest machine.
const FARTHEST_MM: f64 = 1e9;

/// Whether a vertex may have this coordinate (mm).
pub(super) fn is_placeable(mm: f64) -> bool {
    mm.is_finite() && mm.abs() <= FARTHEST_MM
}

impl TriMesh {
    /// Checks that every vertex is finite and every index in range.
    pub fn new(vertices: Vec<DVec3>, triangles: Vec<[u32; 3]>) -> Result<Self, InvalidMesh> {
        for (index, v) in vertices.iter().enumerate() {
            if !v.is_finite() {
                return Err(InvalidMesh::NotFinite { index, value: *v });
            }
            if v.abs().max_element() > FARTHEST_MM {
                return Err(InvalidMesh::TooFar { index, value: v.abs().max_element() });
            }
        }
        for (triangle, t) in triangles.iter().enumerate() {
            if let Some(&vertex) = t.iter().find(|i| **i as usize >= vertices.len()) {
                return Err(InvalidMesh::IndexOutOfRange {
                    triangle,
                    vertex,
                    vertices: vertices.len(),
                });
            }
        }
        Ok(TriMesh { vertices, triangles })
    }

    pub fn vertices(&self) -> &[DVec3] {
        &self.vertices
    }

    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    pub fn is_empty(&self) -> bool {
        self.triangles.is_empty()
    }

    /// The three corners of triangle `t`.
    pub fn corners(&self, t: usize) -> [DVec3; 3] {
        self.triangles[t].map(|i| self.vertices[i as usize])
    }

    /// Twice the area times the unit normal of triangle `t`, mm².
    pub fn area_normal(&self, t: usize) -> DVec3 {
        let [a, b, c] = self.corners(t);
        (b - a).cross(c - a)
    }

    /// Box of the vertices that triangles use.
    pub fn bounds(&self) -> Aabb {
        Aabb::of(self.triangles.iter().flatten().map(|&i| self.vertices[i as usize]))
    }

    /// Signed volume by the divergence theorem, mm³; the solid's volume when the mesh is closed,
    /// oriented and its bodies do not overlap.
    pub fn signed_volume(&self) -> f64 {
        // Relative to the box centre, so that parts far from the origin keep their digits.
        if self.is_empty() {
            return 0.0;
        }
        let o = self.bounds().center();
        (0..self.triangles.len())
            .map(|t| {
                let [a, b, c] = self.corners(t).map(|p| p - o);
                a.dot(b.cross(c))
            })
            .sum::<f64>()
            / 6.0
    }

    /// Surface area, mm².
    pub fn area(&self) -> f64 {
        (0..self.triangles.len()).map(|t| self.area_normal(t).length()).sum::<f64>() / 2.0
    }

    /// Volume centroid, falling back to the box centre when the volume vanishes.
    pub fn centroid(&self) -> DVec3 {
        let o = self.bounds().center();
        let (mut volume, mut moment) = (0.0, DVec3::ZERO);
        for t in 0..self.triangles.len() {
            let [a, b, c] = self.corners(t).map(|p| p - o);
            let v = a.dot(b.cross(c));
            volume += v;
            moment += v * (a + b + c) / 4.0;
        }
        let c = moment / volume;
        if c.is_finite() { o + c } else { o }
    }

    /// The mesh moved by `world_from_mesh`; a mirroring transform flips the triangles so that
    /// they stay oriented.
    pub fn transformed(&self, world_from_mesh: &DAffine3) -> Result<TriMesh, InvalidMesh> {
        let vertices = self.vertices.iter().map(|v| world_from_mesh.transform_point3(*v)).collect();
        let mut triangles = self.triangles.clone();
        if world_from_mesh.matrix3.determinant() < 0.0 {
            triangles.iter_mut().for_each(|t| t.swap(1, 2));
        }
        TriMesh::new(vertices, triangles)
    }

    /// An axis-aligned box as twelve triangles.
    pub fn cuboid(min: DVec3, max: DVec3) -> TriMesh {
        let vertices = (0..8)
            .map(|i| {
                DVec3::new(
                    if i & 1 == 0 { min.x } else { max.x },
                    if i & 2 == 0 { min.y } else { max.y },
                    if i & 4 == 0 { min.z } else { max.z },
                )
            })
            .collect();
        let quads =
            [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let triangles = quads
            .iter()
            .flat_map(|q: &[u32; 4]| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]])
            .collect();
        TriMesh { vertices, triangles }
    }

    /// The triangles of several meshes in one, none of them cut where they meet.
    #[cfg(test)]
    pub(crate) fn joined(parts: &[TriMesh]) -> TriMesh {
        let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
        for p in parts {
            let first = vertices.len() as u32;
            vertices.extend_from_slice(&p.vertices);
            triangles.extend(p.triangles.iter().map(|t| t.map(|i| i + first)));
        }
        TriMesh { vertices, triangles }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cuboid_has_its_volume_area_and_centroid() {
        let m = TriMesh::cuboid(DVec3::new(100.0, 1.0, 2.0), DVec3::new(102.0, 4.0, 7.0));
        assert!((m.signed_volume() - 30.0).abs() < 1e-9);
        assert!((m.area() - 62.0).abs() < 1e-9);
        assert!((m.centroid() - DVec3::new(101.0, 2.5, 4.5)).length() < 1e-9);
    }

    #[test]
    fn mirroring_keeps_the_orientation() {
        let m = TriMesh::cuboid(DVec3::ZERO, DVec3::ONE);
        let mirrored = m.transformed(&DAffine3::from_scale(DVec3::new(-1.0, 1.0, 1.0))).unwrap();
        assert!((mirrored.signed_volume() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn bad_vertices_and_indices_are_named() {
        let nan = TriMesh::new(vec![DVec3::NAN], vec![]);
        assert!(matches!(nan, Err(InvalidMesh::NotFinite { index: 0, .. })));
        let far = TriMesh::new(vec![DVec3::splat(1e300)], vec![]);
        assert!(matches!(far, Err(InvalidMesh::TooFar { index: 0, .. })));
        let range = TriMesh::new(vec![DVec3::ZERO], vec![[0, 0, 1]]);
        assert!(matches!(range, Err(InvalidMesh::IndexOutOfRange { vertex: 1, .. })));
    }
}
