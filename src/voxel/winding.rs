//! Winding numbers of triangles: solid angles, and crossings of rays along x.

use crate::base::DVec3;

/// Solid angle of a triangle seen from `p`, steradians, positive when its front faces away from
/// `p` (Van Oosterom & Strackee 1983). Zero from a corner.
pub(super) fn solid_angle([a, b, c]: [DVec3; 3], p: DVec3) -> f64 {
    let (a, b, c) = (a - p, b - p, c - p);
    let (la, lb, lc) = (a.length(), b.length(), c.length());
    let volume = a.dot(b.cross(c));
    let denominator = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
    2.0 * volume.atan2(denominator)
}

/// The generalised winding number of a triangle soup around `p` (Jacobson et al. 2013), summed
/// triangle by triangle: the reference for everything faster.
#[cfg(test)]
pub(super) fn winding_number(triangles: impl Iterator<Item = [DVec3; 3]>, p: DVec3) -> f64 {
    triangles.map(|t| solid_angle(t, p)).sum::<f64>() / (4.0 * std::f64::consts::PI)
}

/// The stretch in which a triangle meets the plane z = `z`: where its downward and its upward edge
/// cross it, as (x, y). An edge owns its lower end and not its upper one, and its crossing is
/// computed from the lower end whichever way it runs, so triangles that share an edge get the
/// same bits.
pub(super) fn slice([a, b, c]: &[DVec3; 3], z: f64) -> Option<[(f64, f64); 2]> {
    let (mut down, mut up) = (None, None);
    for (u, v) in [(a, b), (b, c), (c, a)] {
        if (u.z <= z) == (v.z <= z) {
            continue;
        }
        let (lo, hi) = if u.z < v.z { (u, v) } else { (v, u) };
        let t = (z - lo.z) / (hi.z - lo.z);
        let at = Some((lo.x + t * (hi.x - lo.x), lo.y + t * (hi.y - lo.y)));
        if u.z < v.z { up = at } else { down = at }
    }
    Some([down?, up?])
}

/// Signed crossings of the ray from `p` toward −x with a triangle: +1 where it enters a solid
/// going toward +x. Summed over a closed mesh they are the winding number around `p`.
pub(super) fn crossings_beyond(t: [DVec3; 3], p: DVec3) -> i32 {
    let Some([down, up]) = slice(&t, p.z) else { return 0 };
    let (lo, hi, sign) = if up.1 > down.1 { (down, up, -1) } else { (up, down, 1) };
    if !(lo.1 <= p.y && p.y < hi.1) {
        return 0;
    }
    let x = lo.0 + (p.y - lo.1) / (hi.1 - lo.1) * (hi.0 - lo.0);
    if x <= p.x { sign } else { 0 }
}
