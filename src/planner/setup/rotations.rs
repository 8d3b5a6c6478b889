//! The rotations that are tried: an even spread over all rotations, and the ways the target can
//! stand on a flat face of its own.

use crate::base::{DMat3, DVec2, DVec3, Direction};
use crate::mesh::TriMesh;
use std::collections::BTreeMap;

/// `n` rotations spread evenly over all rotations, by super-Fibonacci spirals (Alexa 2022): no
/// randomness, any `n`, and no two close together.
pub(super) fn spread(n: usize) -> Vec<DMat3> {
    // The two constants of the spirals: √2, and the real root above 1 of ψ⁴ = ψ + 4.
    const PHI: f64 = std::f64::consts::SQRT_2;
    const PSI: f64 = 1.533_751_168_755_204_3;
    (0..n)
        .map(|i| {
            let s = i as f64 + 0.5;
            let (t, d) = (s / n as f64, std::f64::consts::TAU * s);
            let (r, q) = (t.sqrt(), (1.0 - t).sqrt());
            let ((a, b), (c, e)) = ((d / PHI).sin_cos(), (d / PSI).sin_cos());
            of_quaternion([r * a, r * b, q * c, q * e])
        })
        .collect()
}

/// The rotation of a unit quaternion (x, y, z, w).
fn of_quaternion([x, y, z, w]: [f64; 4]) -> DMat3 {
    DMat3::from_cols(
        DVec3::new(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + z * w), 2.0 * (x * z - y * w)),
        DVec3::new(2.0 * (x * y - z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + x * w)),
        DVec3::new(2.0 * (x * z + y * w), 2.0 * (y * z - x * w), 1.0 - 2.0 * (x * x + y * y)),
    )
}

/// The turn about z by an angle in radians; quarter turns are exact.
pub(super) fn about_z(angle: f64) -> DMat3 {
    tidy(DMat3::from_rotation_z(angle))
}

/// Rounds away what is left of sines of right angles, so that a part turned by them keeps its
/// coordinates. Below any pose's meaning: 1e-12 of a metre is a billionth of a millimetre.
pub(super) fn tidy(m: DMat3) -> DMat3 {
    const ROUNDING: f64 = 1e-12;
    let whole = |c: f64| if (c - c.round()).abs() < ROUNDING { c.round() + 0.0 } else { c };
    DMat3::from_cols_array(&m.to_cols_array().map(whole))
}

/// Axis and angle (degrees, 0 to 180) of a rotation; z for none.
pub(super) fn axis_angle(m: &DMat3) -> (DVec3, f64) {
    let [x, y, z] = [m.x_axis, m.y_axis, m.z_axis];
    // Twice the sine times the axis, and twice the cosine.
    let sine = DVec3::new(y.z - z.y, z.x - x.z, x.y - y.x);
    let angle = sine.length().atan2(x.x + y.y + z.z - 1.0);
    // Near a half turn the sine has no digits left: (m + 1) / 2 is then the axis times itself.
    let squared = (*m + DMat3::IDENTITY) * 0.5;
    let columns = [squared.x_axis, squared.y_axis, squared.z_axis];
    let largest = (1..3).fold(columns[0], |best, i| {
        if columns[i].length_squared() > best.length_squared() { columns[i] } else { best }
    });
    const SMALL_SINE: f64 = 1e-6;
    let axis = if sine.length() > SMALL_SINE { sine } else { largest };
    let axis = if angle < SMALL_SINE { DVec3::Z } else { axis.try_normalize().unwrap_or(DVec3::Z) };
    (axis, angle.to_degrees())
}

/// Faces this close in direction are one face, degrees: tessellated planes are exact, scanned ones
/// waver by about a degree. Wider would merge a face with its draft.
const FACE_ANGLE_DEG: f64 = 2.0;

/// A face's corners reach this close to the supporting plane, as a share of the largest extent.
const FACE_DEPTH: f64 = 1e-3;

/// Least area of a face to stand on, as a share of the surface.
const LEAST_FACE: f64 = 2e-3;

/// Directions that are tried for a face; each costs a pass over the mesh. A face with less surface
/// facing its way than this many others is not found.
const MOST_DIRECTIONS: usize = 64;

/// The rotations that put the target on one of its own flat faces, at most `most`, those with the
/// largest contact first: faces of the convex hull that belong to the part, with the centroid over
/// them. The face the part stands on already comes as the identity.
pub(super) fn resting(mesh: &TriMesh, most: usize) -> Vec<DMat3> {
    let depth = FACE_DEPTH * mesh.bounds().size().max_element();
    let least = LEAST_FACE * mesh.area();
    let centroid = mesh.centroid();
    let outward = if mesh.signed_volume() < 0.0 { -1.0 } else { 1.0 };
    let mut found: Vec<(f64, Direction)> = Vec::new();
    for normal in face_directions(mesh, outward) {
        let Some((area, normal)) = contact(mesh, normal, outward, depth) else { continue };
        let known = found.iter().any(|(_, n)| is_one_face(n.vec(), normal.vec()));
        if area >= least && !known && carries(mesh, normal, depth, centroid) {
            found.push((area, normal));
        }
    }
    // A stable sort: equal faces stay in the order of the mesh.
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.into_iter().take(most).map(|(_, n)| onto(n.vec(), DVec3::NEG_Z)).collect()
}

/// As the part stands, then on the other faces it can rest on, at most `most` of these.
pub(super) fn upright(mesh: &TriMesh, most: usize) -> Vec<DMat3> {
    const SAME: f64 = 1e-3;
    let is_other = |r: &DMat3| r.transpose().z_axis.z <= 1.0 - SAME;
    let mut all = vec![DMat3::IDENTITY];
    all.extend(resting(mesh, most).into_iter().filter(is_other));
    all
}

fn is_one_face(a: DVec3, b: DVec3) -> bool {
    a.dot(b) >= FACE_ANGLE_DEG.to_radians().cos()
}

/// The directions most of the surface faces, each once. Normals are gathered in the cells of a
/// lattice, by area: the largest triangles of a turned part are on its many-sided round faces.
fn face_directions(mesh: &TriMesh, outward: f64) -> Vec<DVec3> {
    let cell = FACE_ANGLE_DEG.to_radians();
    let mut cells: BTreeMap<[i64; 3], DVec3> = BTreeMap::new();
    for t in 0..mesh.triangles().len() {
        let normal = outward * mesh.area_normal(t);
        if let Some(unit) = normal.try_normalize() {
            let key = (unit / cell).round().to_array().map(|c| c as i64);
            *cells.entry(key).or_default() += normal;
        }
    }
    let mut gathered: Vec<DVec3> = cells.into_values().collect();
    gathered.sort_by(|a, b| b.length().total_cmp(&a.length()));
    let mut directions: Vec<DVec3> = Vec::new();
    for n in gathered.into_iter().filter_map(|n| n.try_normalize()) {
        if directions.len() == MOST_DIRECTIONS {
            break;
        }
        if !directions.iter().any(|d| is_one_face(*d, n)) {
            directions.push(n);
        }
    }
    directions
}

/// Area (mm²) and mean normal of the triangles on the supporting plane across `normal`.
fn contact(mesh: &TriMesh, normal: DVec3, outward: f64, depth: f64) -> Option<(f64, Direction)> {
    let reach = used(mesh).map(|v| normal.dot(v)).fold(f64::NEG_INFINITY, f64::max) - depth;
    let sum: DVec3 = (0..mesh.triangles().len())
        .filter(|t| mesh.corners(*t).iter().all(|c| normal.dot(*c) >= reach))
        .map(|t| outward * mesh.area_normal(t))
        .filter(|n| n.try_normalize().is_some_and(|n| is_one_face(n, normal)))
        .sum();
    Some((sum.length() / 2.0, Direction::new(sum).ok()?))
}

/// Whether the centroid lies over the hull of what touches the supporting plane.
fn carries(mesh: &TriMesh, normal: Direction, depth: f64, centroid: DVec3) -> bool {
    let plane = normal.image_plane();
    let reach = used(mesh).map(|v| plane.height(v)).fold(f64::NEG_INFINITY, f64::max) - depth;
    let touching = used(mesh).filter(|v| plane.height(*v) >= reach).map(|v| plane.across(v));
    let hull = convex_hull(touching.collect());
    let c = plane.across(centroid);
    hull.len() > 2
        && (0..hull.len()).all(|i| {
            let (a, b) = (hull[i], hull[(i + 1) % hull.len()]);
            (b - a).perp_dot(c - a) >= 0.0
        })
}

/// Corners of the convex hull, counter-clockwise (Andrew's monotone chain).
fn convex_hull(mut points: Vec<DVec2>) -> Vec<DVec2> {
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    points.dedup();
    let chain = |points: &mut dyn Iterator<Item = DVec2>| {
        let mut hull: Vec<DVec2> = Vec::new();
        for p in points {
            while let [.., a, b] = hull[..] {
                if (b - a).perp_dot(p - a) > 0.0 {
                    break;
                }
                hull.pop();
            }
            hull.push(p);
        }
        hull.pop();
        hull
    };
    let mut hull = chain(&mut points.iter().copied());
    hull.extend(chain(&mut points.iter().rev().copied()));
    hull
}

fn used(mesh: &TriMesh) -> impl Iterator<Item = DVec3> + '_ {
    mesh.triangles().iter().flatten().map(|&i| mesh.vertices()[i as usize])
}

/// The smallest rotation that turns one unit vector onto another; about x when they oppose.
fn onto(from: DVec3, to: DVec3) -> DMat3 {
    let (cross, cosine) = (from.cross(to), from.dot(to));
    let axis = cross.try_normalize().unwrap_or_else(|| from.any_orthonormal_vector());
    let axis = if from == -to && from.x == 0.0 { DVec3::X } else { axis };
    tidy(DMat3::from_axis_angle(axis, cross.length().atan2(cosine)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_spread_is_of_rotations_and_reaches_every_rotation() {
        let all = spread(100);
        for m in &all {
            assert!((m.determinant() - 1.0).abs() < 1e-12);
            let off = *m * m.transpose() - DMat3::IDENTITY;
            assert!(off.to_cols_array().iter().all(|c| c.abs() < 1e-12));
        }
        let apart = |a: &DMat3, b: &DMat3| axis_angle(&(a.transpose() * *b)).1;
        // 100 balls of 40° radius would fill all rotations about twice.
        for probe in spread(37) {
            let nearest = all.iter().map(|m| apart(m, &probe)).fold(f64::MAX, f64::min);
            assert!(nearest < 50.0, "{nearest}");
        }
        for (i, a) in all.iter().enumerate() {
            assert!(all[..i].iter().all(|b| apart(a, b) > 20.0), "{i}");
        }
    }

    #[test]
    fn axis_and_angle_give_the_rotation_back() {
        for m in spread(50).into_iter().chain([
            DMat3::IDENTITY,
            about_z(std::f64::consts::PI),
            onto(DVec3::Z, DVec3::NEG_Z),
            onto(DVec3::X, DVec3::NEG_Z),
        ]) {
            let (axis, degrees) = axis_angle(&m);
            let off = DMat3::from_axis_angle(axis, degrees.to_radians()) - m;
            assert!(off.to_cols_array().iter().all(|c| c.abs() < 1e-9), "{m}");
        }
    }

    #[test]
    fn a_box_rests_on_six_faces_the_largest_first_exactly() {
        let m = TriMesh::cuboid(DVec3::ZERO, DVec3::new(10.0, 20.0, 5.0));
        let all = resting(&m, 8);
        assert_eq!(all.len(), 6);
        assert_eq!(all[0], DMat3::IDENTITY);
        let height = |r: &DMat3| (*r * DVec3::new(10.0, 20.0, 5.0)).z.abs();
        assert_eq!(all.iter().map(height).collect::<Vec<_>>(), [5.0, 5.0, 10.0, 10.0, 20.0, 20.0]);
    }

    #[test]
    fn the_ends_of_a_finely_cut_bar_are_found_among_its_many_sides() {
        const SIDES: u32 = 200;
        const RINGS: u32 = 12;
        // Ends in rings of small triangles, sides in large ones.
        let mut vertices = Vec::new();
        for (level, z) in [(0, 0.0), (1, 40.0)] {
            for ring in 0..=RINGS {
                let r = 10.0 * f64::from(ring) / f64::from(RINGS);
                let angle = |i: u32| std::f64::consts::TAU * f64::from(i) / f64::from(SIDES);
                vertices.extend(
                    (0..SIDES).map(|i| DVec3::new(r * angle(i).cos(), r * angle(i).sin(), z)),
                );
            }
            assert_eq!(vertices.len() as u32, (level + 1) * (RINGS + 1) * SIDES);
        }
        let at = |level: u32, ring: u32, i: u32| (level * (RINGS + 1) + ring) * SIDES + i % SIDES;
        let mut triangles = Vec::new();
        for i in 0..SIDES {
            let (a, b) = (at(0, RINGS, i), at(0, RINGS, i + 1));
            let (c, d) = (at(1, RINGS, i), at(1, RINGS, i + 1));
            triangles.extend([[a, b, d], [a, d, c]]);
            for ring in 0..RINGS {
                let quad = |l| {
                    [at(l, ring, i), at(l, ring + 1, i), at(l, ring + 1, i + 1), at(l, ring, i + 1)]
                };
                let ([p, q, r, s], [t, u, v, w]) = (quad(0), quad(1));
                triangles.extend([[p, r, q], [p, s, r], [t, u, v], [t, v, w]]);
            }
        }
        let m = TriMesh::new(vertices, triangles).unwrap();
        let all = resting(&m, 8);
        assert_eq!(all[0], DMat3::IDENTITY);
        assert_eq!(all[1], onto(DVec3::Z, DVec3::NEG_Z));
    }

    #[test]
    fn a_leaning_tower_does_not_stand_on_its_foot() {
        // A sheared box whose centroid is beside its foot.
        let sheared = TriMesh::cuboid(DVec3::ZERO, DVec3::new(2.0, 2.0, 10.0));
        let lean = sheared.vertices().iter().map(|v| *v + DVec3::X * v.z).collect();
        let m = TriMesh::new(lean, sheared.triangles().to_vec()).unwrap();
        assert!(resting(&m, 8).iter().all(|r| *r != DMat3::IDENTITY));
    }
}
