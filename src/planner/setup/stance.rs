//! Where a turned part stands: its bottom, and the centroid of what touches the base.

use super::rotations::{about_z, tidy};
use crate::base::{DAffine3, DMat3, DVec2, DVec3};
use crate::mesh::TriMesh;

/// A part turned and put on the base; where on the base is still free.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Stance {
    pub rotation: DMat3,
    /// Height that puts the lowest point on z = 0, mm.
    pub lift: f64,
    /// Centroid of the contact after the rotation alone, mm.
    pub foot: DVec2,
}

impl Stance {
    pub fn new(mesh: &TriMesh, rotation: DMat3, grip_mm: f64) -> Stance {
        let turned: Vec<DVec3> = mesh.vertices().iter().map(|v| rotation * *v).collect();
        let corners = || mesh.triangles().iter().map(|t| t.map(|i| turned[i as usize]));
        let floor = corners().flatten().map(|v| v.z).fold(f64::INFINITY, f64::min);
        let foot = contact_centroid(corners(), floor, floor + grip_mm);
        Stance { rotation, lift: 0.0 - floor, foot }
    }

    /// The same, turned further about z by an angle in radians.
    pub fn turned(&self, angle: f64) -> Stance {
        let turn = about_z(angle);
        let foot = turn * self.foot.extend(0.0);
        Stance { rotation: tidy(turn * self.rotation), lift: self.lift, foot: foot.truncate() }
    }

    /// The motion that brings the contact's centroid to `at` on the base plane.
    pub fn standing_at(&self, at: DVec2) -> DAffine3 {
        // Where foot and place differ by rounding alone, the part keeps its coordinates.
        const ROUNDING: f64 = 1e-9;
        let shift = at - self.foot;
        let shift = DVec2::select(shift.abs().cmplt(DVec2::splat(ROUNDING)), DVec2::ZERO, shift);
        DAffine3::from_mat3_translation(self.rotation, shift.extend(self.lift))
    }
}

/// The two ways to sum the contact's volume agree this well on a mesh that is closed there.
const CLOSED_SHARE: f64 = 0.01;

/// Centroid in x and y of what lies between `floor` and `top`.
///
/// By the divergence theorem over the clipped triangles: the flux of (x, 0, 0) and of (0, y, 0)
/// both give the volume and do not see the flat cut, those of x²/2 and y²/2 its moments. A mesh
/// that is open or inconsistent there gives two volumes that differ; the centroid of the clipped
/// surface is taken then.
fn contact_centroid(corners: impl Iterator<Item = [DVec3; 3]>, floor: f64, top: f64) -> DVec2 {
    let pieces: Vec<[DVec3; 3]> = corners
        .filter(|c| c.iter().any(|p| p.z <= top))
        .flat_map(|c| {
            let polygon = below(c, top);
            (2..polygon.len()).map(|i| [polygon[0], polygon[i - 1], polygon[i]]).collect::<Vec<_>>()
        })
        .collect();
    let (lo, hi) =
        pieces.iter().flatten().fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(lo, hi), p| {
            (lo.min(p.truncate()), hi.max(p.truncate()))
        });
    // Relative to the middle, so that parts far from the origin keep their digits.
    let o = ((lo + hi) / 2.0).extend(floor);
    let (mut volume, mut moment) = (DVec2::ZERO, DVec2::ZERO);
    let (mut area, mut surface) = (0.0, DVec2::ZERO);
    for piece in &pieces {
        let [a, b, c] = piece.map(|p| p - o);
        let normal = (b - a).cross(c - a) / 2.0;
        let [a, b, c] = [a, b, c].map(DVec3::truncate);
        let n = normal.truncate();
        volume += n * (a + b + c) / 3.0;
        moment += n * (a * a + b * b + c * c + a * b + b * c + c * a) / 12.0;
        area += normal.length();
        surface += normal.length() * (a + b + c) / 3.0;
    }
    let closed = (volume.x - volume.y).abs() <= CLOSED_SHARE * volume.x.abs();
    let centroid = moment / volume;
    let beside = centroid.abs().cmpgt((hi - lo) / 2.0).any();
    if closed && centroid.is_finite() && !beside {
        return o.truncate() + centroid;
    }
    let centroid = surface / area;
    o.truncate() + if centroid.is_finite() { centroid } else { DVec2::ZERO }
}

/// The part of a triangle at or below z = top, as a convex polygon.
fn below(corners: [DVec3; 3], top: f64) -> Vec<DVec3> {
    let mut polygon = Vec::with_capacity(4);
    for i in 0..3 {
        let (p, q) = (corners[i], corners[(i + 1) % 3]);
        if p.z <= top {
            polygon.push(p);
        }
        if (p.z <= top) != (q.z <= top) {
            polygon.push(p + (q - p) * ((top - p.z) / (q.z - p.z)));
        }
    }
    polygon
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A foot of 4 × 4 × 1 with a plate above it that reaches far to +x.
    fn overhanging() -> TriMesh {
        let foot = TriMesh::cuboid(DVec3::ZERO, DVec3::new(4.0, 4.0, 3.0));
        let plate = TriMesh::cuboid(DVec3::new(0.0, 0.0, 3.0), DVec3::new(20.0, 4.0, 5.0));
        let shift = foot.vertices().len() as u32;
        let triangles = plate.triangles().iter().map(|t| t.map(|i| i + shift));
        TriMesh::new(
            foot.vertices().iter().chain(plate.vertices()).copied().collect(),
            foot.triangles().iter().copied().chain(triangles).collect(),
        )
        .unwrap()
    }

    #[test]
    fn the_foot_is_the_centroid_of_the_contact_alone() {
        let s = Stance::new(&overhanging(), DMat3::IDENTITY, 2.0);
        assert!((s.foot - DVec2::splat(2.0)).length() < 1e-12 && s.lift == 0.0);
        // Upside down it stands on the plate.
        let s = Stance::new(&overhanging(), DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0)), 1.0);
        assert!((s.foot - DVec2::new(10.0, -2.0)).length() < 1e-12 && s.lift == 5.0);
    }

    #[test]
    fn an_open_foot_still_has_a_place() {
        let m = overhanging();
        // Without the wall at x = 0 the volumes by x and y differ.
        let kept = |t: &[u32; 3]| t.iter().any(|&i| m.vertices()[i as usize].x > 0.0);
        let open: Vec<_> = m.triangles().iter().copied().filter(kept).collect();
        assert!(open.len() < m.triangles().len());
        let s =
            Stance::new(&TriMesh::new(m.vertices().to_vec(), open).unwrap(), DMat3::IDENTITY, 2.0);
        assert!((s.foot - DVec2::splat(2.0)).abs().max_element() < 1.0, "{s:?}");
    }

    #[test]
    fn turning_a_stance_is_turning_the_part() {
        let m = overhanging();
        let s = Stance::new(&m, DMat3::IDENTITY, 2.0).turned(0.7);
        let t = Stance::new(&m, about_z(0.7), 2.0);
        assert!((s.foot - t.foot).length() < 1e-12 && s.rotation == t.rotation);
        let at = s.standing_at(DVec2::new(30.0, 40.0));
        let moved = m.transformed(&at).unwrap();
        let there = Stance::new(&moved, DMat3::IDENTITY, 2.0);
        assert!((there.foot - DVec2::new(30.0, 40.0)).length() < 1e-9 && there.lift.abs() < 1e-12);
    }
}
