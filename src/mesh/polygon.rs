//! Splits the faces of a file that have more than three corners.
//!
//! Method: a convex face becomes a fan; any other is ear-clipped in the plane of its area normal
//! (Newell). Guarantees: n corners give n − 2 triangles whose outline is the face's, so that a
//! closed mesh stays closed. Not guaranteed: a face that crosses itself has no splitting without
//! overlap; what is left of it when no ear remains is fanned.

use crate::base::{DVec2, DVec3, Direction};

/// Ear clipping takes quadratic time, cubic at worst. CAD exports stay in the hundreds of corners;
/// a larger limit lets one hostile face stall the program, a smaller one refuses gear outlines.
pub(super) const MAX_CONCAVE_CORNERS: usize = 2048;

/// Twice the signed area of a, b, c.
fn turn(a: DVec2, b: DVec2, c: DVec2) -> f64 {
    (b - a).perp_dot(c - a)
}

/// Appends the triangles of the face `corners`; `false` when it is neither convex nor small
/// enough to clip.
pub(super) fn split(vertices: &[DVec3], corners: &[u32], out: &mut Vec<[u32; 3]>) -> bool {
    let flat = flatten(vertices, corners);
    if is_convex(&flat) {
        out.extend((1..corners.len() - 1).map(|i| [corners[0], corners[i], corners[i + 1]]));
        return true;
    }
    if corners.len() > MAX_CONCAVE_CORNERS {
        return false;
    }
    clip_ears(&flat, |t| out.push(t.map(|i| corners[i])));
    true
}

/// The corners in the plane of the face, counter-clockwise; relative to the first corner, so that
/// faces far from the origin keep their digits.
fn flatten(vertices: &[DVec3], corners: &[u32]) -> Vec<DVec2> {
    let at =
        |i: usize| vertices[corners[i % corners.len()] as usize] - vertices[corners[0] as usize];
    let normal: DVec3 = (0..corners.len()).map(|i| at(i).cross(at(i + 1))).sum();
    // A face without area may be split along any plane.
    let z = Direction::new(normal).unwrap_or(Direction::Z).vec();
    let x = z.any_orthonormal_vector();
    let y = z.cross(x);
    (0..corners.len()).map(|i| DVec2::new(at(i).dot(x), at(i).dot(y))).collect()
}

/// Whether no corner turns right and the outline goes round once (a star turns left throughout).
fn is_convex(p: &[DVec2]) -> bool {
    let n = p.len();
    let mut x_reversals = 0;
    let mut last_x = 0.0;
    for i in 0..=n {
        if turn(p[i % n], p[(i + 1) % n], p[(i + 2) % n]) < 0.0 {
            return false;
        }
        let dx = p[(i + 1) % n].x - p[i % n].x;
        if dx != 0.0 {
            x_reversals += usize::from(dx * last_x < 0.0);
            last_x = dx;
        }
    }
    x_reversals <= 2
}

/// Cuts ears until a triangle is left. Corners at the place of an ear's corner do not block it:
/// the bridge of a face with a hole touches itself there.
fn clip_ears(p: &[DVec2], mut emit: impl FnMut([usize; 3])) {
    let mut left: Vec<usize> = (0..p.len()).collect();
    let mut at = 0;
    let mut refused = 0;
    while left.len() > 3 {
        let n = left.len();
        let ear = [left[(at + n - 1) % n], left[at % n], left[(at + 1) % n]];
        // With no ear left the outline crosses itself; cutting any corner keeps it closed.
        if refused >= n || is_ear(p, &left, ear) {
            emit(ear);
            left.remove(at % n);
            at %= n - 1;
            refused = 0;
        } else {
            at = (at + 1) % n;
            refused += 1;
        }
    }
    emit([left[0], left[1], left[2]]);
}

fn is_ear(p: &[DVec2], left: &[usize], ear: [usize; 3]) -> bool {
    let [a, b, c] = ear.map(|i| p[i]);
    if turn(a, b, c) <= 0.0 {
        return false;
    }
    left.iter().map(|&i| p[i]).all(|q| {
        let outside = turn(a, b, q) < 0.0 || turn(b, c, q) < 0.0 || turn(c, a, q) < 0.0;
        outside || q == a || q == b || q == c
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn areas(points: &[(f64, f64)]) -> (usize, f64, f64) {
        let v: Vec<DVec3> = points.iter().map(|p| DVec3::new(p.0, 7.0, p.1)).collect();
        let corners: Vec<u32> = (0..v.len() as u32).collect();
        let mut out = Vec::new();
        assert!(split(&v, &corners, &mut out));
        let normal = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|i| v[i as usize]);
            (b - a).cross(c - a) / 2.0
        };
        let signed: DVec3 = out.iter().map(normal).sum();
        (out.len(), signed.length(), out.iter().map(|t| normal(t).length()).sum())
    }

    #[test]
    fn concave_faces_are_covered_once() {
        let l = [(0., 0.), (2., 0.), (2., 1.), (1., 1.), (1., 2.), (0., 2.)];
        assert_eq!(areas(&l), (4, 3.0, 3.0));
        // A square with a square hole, joined by a bridge walked twice.
        let keyhole = [
            (0., 0.),
            (4., 0.),
            (4., 4.),
            (0., 4.),
            (0., 0.),
            (1., 1.),
            (1., 3.),
            (3., 3.),
            (3., 1.),
            (1., 1.),
        ];
        let (n, signed, unsigned) = areas(&keyhole);
        assert_eq!(n, 8);
        assert!((signed - 12.0).abs() < 1e-12 && (unsigned - 12.0).abs() < 1e-12);
    }

    #[test]
    fn a_large_concave_face_is_refused_and_a_large_convex_one_is_not() {
        let ring = |n: u32, dent: f64| -> Vec<DVec3> {
            let angle = |i: u32| std::f64::consts::TAU * f64::from(i) / f64::from(n);
            let radius = |i: u32| if i == 0 { dent } else { 1.0 };
            (0..n)
                .map(|i| DVec3::new(angle(i).cos() * radius(i), angle(i).sin() * radius(i), 0.0))
                .collect()
        };
        let corners: Vec<u32> = (0..5000).collect();
        assert!(split(&ring(5000, 1.0), &corners, &mut Vec::new()));
        assert!(!split(&ring(5000, 0.5), &corners, &mut Vec::new()));
    }

    proptest! {
        /// A star-shaped outline is simple, so its triangles cover it once: the sum of the
        /// unsigned areas equals the signed area up to rounding (n terms of size ≤ 8).
        #[test]
        fn star_shaped_outlines_are_covered_once(radii in prop::collection::vec(0.2f64..2.0, 4..40)) {
            let n = radii.len() as f64;
            let points: Vec<(f64, f64)> = radii.iter().enumerate().map(|(i, r)| {
                let a = std::f64::consts::TAU * i as f64 / n;
                (r * a.cos(), r * a.sin())
            }).collect();
            let (count, signed, unsigned) = areas(&points);
            prop_assert_eq!(count, radii.len() - 2);
            prop_assert!((signed - unsigned).abs() < 1e-12 * 8.0 * n, "{} {}", signed, unsigned);
        }
    }
}
