//! Vertices and faces as a file lists them, gathered into a [`TriMesh`].
//!
//! Guarantees: coordinates are scaled to millimetres and checked as they come, so that a fault
//! names its place; faces may name vertices that come later.

use super::TriMesh;
use super::error::{Defect, Fault, Place};
use super::polygon::{self, MAX_CONCAVE_CORNERS};
use super::tri::is_placeable;
use crate::base::DVec3;

pub(super) struct Soup {
    mm_per_unit: f64,
    /// The number the format gives to its first vertex: 1 in OBJ, 0 elsewhere.
    base: i64,
    vertices: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    /// Corners of the faces with more than three, end to end, with each face's end and place.
    polygon_corners: Vec<u32>,
    polygons: Vec<(usize, Place)>,
    /// The largest vertex number named so far, and by whom.
    largest: Option<(u32, Place)>,
}

impl Soup {
    pub fn new(mm_per_unit: f64, base: i64) -> Self {
        Soup {
            mm_per_unit,
            base,
            vertices: Vec::new(),
            triangles: Vec::new(),
            polygon_corners: Vec::new(),
            polygons: Vec::new(),
            largest: None,
        }
    }

    /// Makes room for counts already checked against the size of the file.
    pub fn reserve(&mut self, vertices: u64, triangles: u64) {
        self.vertices.reserve(vertices as usize);
        self.triangles.reserve(triangles as usize);
    }

    pub fn vertex_count(&self) -> usize {
        self.vertices.len()
    }

    /// Adds a vertex in the file's unit.
    pub fn vertex(&mut self, xyz: [f64; 3], place: Place) -> Result<u32, Fault> {
        // Adding zero turns -0 into 0: the same point must have the same bits.
        let p = DVec3::from(xyz) * self.mm_per_unit + DVec3::ZERO;
        for (mm, value) in p.to_array().into_iter().zip(xyz) {
            if !is_placeable(mm) {
                return Err((place, Defect::Coordinate { value }));
            }
        }
        let index = self.number(self.vertices.len() as i64, &place)?;
        self.vertices.push(p);
        Ok(index)
    }

    /// A vertex number counted from 0; a negative or absurd one is out of range.
    pub fn number(&self, index: i64, place: &Place) -> Result<u32, Fault> {
        u32::try_from(index).map_err(|_| self.out_of_range(index, place.clone()))
    }

    fn out_of_range(&self, index: i64, place: Place) -> Fault {
        let (base, vertices) = (self.base, self.vertices.len());
        (place, Defect::IndexOutOfRange { index: index.saturating_add(base), base, vertices })
    }

    /// Adds a face by vertex numbers counted from 0.
    pub fn face(&mut self, corners: &[u32], place: Place) -> Result<(), Fault> {
        let Some(&largest) = corners.iter().max() else {
            return Err((place, Defect::ShortFace { corners: 0 }));
        };
        if self.largest.as_ref().is_none_or(|(l, _)| *l < largest) {
            self.largest = Some((largest, place.clone()));
        }
        match corners {
            [a, b, c] => self.triangles.push([*a, *b, *c]),
            [_, _] | [_] => {
                return Err((place, Defect::ShortFace { corners: corners.len() as u64 }));
            }
            _ => {
                self.polygon_corners.extend_from_slice(corners);
                self.polygons.push((self.polygon_corners.len(), place));
            }
        }
        Ok(())
    }

    /// The mesh; faces of more than three corners come after the triangles, each split.
    pub fn finish(mut self) -> Result<TriMesh, Fault> {
        if let Some((largest, place)) = self.largest.take()
            && largest as usize >= self.vertices.len()
        {
            return Err(self.out_of_range(largest.into(), place));
        }
        let mut start = 0;
        for (end, place) in std::mem::take(&mut self.polygons) {
            let corners = &self.polygon_corners[start..end];
            if !polygon::split(&self.vertices, corners, &mut self.triangles) {
                let (corners, limit) = (corners.len(), MAX_CONCAVE_CORNERS);
                return Err((place, Defect::PolygonTooLarge { corners, limit }));
            }
            start = end;
        }
        if self.triangles.is_empty() {
            return Err((Place::File, Defect::NoFaces { vertices: self.vertices.len() }));
        }
        TriMesh::new(self.vertices, self.triangles).map_err(|e| (Place::File, e.into()))
    }
}
