use super::{DVec2, DVec3};
use serde::{Deserialize, Serialize};

/// A unit vector from the workpiece toward the spindle: the tool axis leaving the tip.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "[f64; 3]", into = "[f64; 3]")]
pub struct Direction(DVec3);

#[derive(Debug, thiserror::Error, PartialEq)]
#[error("({0}, {1}, {2}) is no direction: give three finite numbers that are not all zero")]
pub struct NotADirection(f64, f64, f64);

impl Direction {
    pub const X: Direction = Direction(DVec3::X);
    pub const Y: Direction = Direction(DVec3::Y);
    pub const Z: Direction = Direction(DVec3::Z);
    pub const NEG_X: Direction = Direction(DVec3::NEG_X);
    pub const NEG_Y: Direction = Direction(DVec3::NEG_Y);
    pub const NEG_Z: Direction = Direction(DVec3::NEG_Z);

    /// Normalises `v`.
    pub fn new(v: DVec3) -> Result<Self, NotADirection> {
        match v.try_normalize() {
            Some(n) if v.is_finite() => Ok(Direction(n)),
            _ => Err(NotADirection(v.x, v.y, v.z)),
        }
    }

    pub fn vec(self) -> DVec3 {
        self.0
    }

    pub fn dot(self, v: DVec3) -> f64 {
        self.0.dot(v)
    }

    pub fn opposite(self) -> Direction {
        Direction(-self.0)
    }

    /// Whether the direction is one of the six grid axes, exactly.
    pub fn is_grid_axis(self) -> bool {
        self.0.abs().to_array().iter().filter(|c| **c == 0.0).count() == 2
    }

    /// The plane across this direction in which depth images live.
    pub fn image_plane(self) -> ImagePlane {
        ImagePlane::of(self)
    }
}

impl TryFrom<[f64; 3]> for Direction {
    type Error = NotADirection;
    /// Keeps the components of an already normalised vector bit for bit, so that a direction
    /// survives a round trip through a plan file.
    fn try_from(v: [f64; 3]) -> Result<Self, NotADirection> {
        let v = DVec3::from_array(v);
        if v.is_finite() && (v.length_squared() - 1.0).abs() < 1e-12 {
            return Ok(Direction(v));
        }
        Direction::new(v)
    }
}

impl From<Direction> for [f64; 3] {
    fn from(d: Direction) -> Self {
        d.0.to_array()
    }
}

/// Right-handed orthonormal frame (u, v, d): coordinates across and along a direction.
///
/// The definition is part of the plan's meaning, since tool tips stand on a lattice in (u, v):
/// for d along ±z, u = x; otherwise u = (z × d)/|z × d|; v = d × u. For a grid axis, u and v are
/// grid axes as well.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImagePlane {
    pub u: DVec3,
    pub v: DVec3,
    pub d: DVec3,
}

impl ImagePlane {
    fn of(direction: Direction) -> Self {
        let d = direction.vec();
        let across = DVec3::Z.cross(d);
        // Below this the cross product has lost its digits; the direction is z for any purpose.
        const Z_AXIS_SINE: f64 = 1e-9;
        let u = if across.length() < Z_AXIS_SINE { DVec3::X } else { across.normalize() };
        ImagePlane { u, v: d.cross(u), d }
    }

    /// (u, v) of a point, mm.
    pub fn across(&self, p: DVec3) -> DVec2 {
        DVec2::new(self.u.dot(p), self.v.dot(p))
    }

    /// Height of a point along the direction, mm.
    pub fn height(&self, p: DVec3) -> f64 {
        self.d.dot(p)
    }

    /// The world point with coordinates (u, v) and height z.
    pub fn world(&self, uv: DVec2, z: f64) -> DVec3 {
        self.u * uv.x + self.v * uv.y + self.d * z
    }
}

/// `n` nearly uniform directions on the whole sphere (Fibonacci lattice), from +z to −z.
pub fn fibonacci_sphere(n: usize) -> Vec<Direction> {
    let golden_angle = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    (0..n)
        .map(|i| {
            let z = 1.0 - (2.0 * i as f64 + 1.0) / n as f64;
            let r = (1.0 - z * z).max(0.0).sqrt();
            let (s, c) = (golden_angle * i as f64).sin_cos();
            Direction(DVec3::new(r * c, r * s, z).normalize())
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn image_planes_are_right_handed_and_axes_map_to_axes() {
        for d in fibonacci_sphere(200).into_iter().chain([
            Direction::X,
            Direction::NEG_X,
            Direction::Y,
            Direction::NEG_Y,
            Direction::Z,
            Direction::NEG_Z,
        ]) {
            let p = d.image_plane();
            assert!((p.u.cross(p.v) - p.d).length() < 1e-12, "{d:?}");
            if d.is_grid_axis() {
                for a in [p.u, p.v] {
                    assert!(Direction::new(a).unwrap().is_grid_axis(), "{d:?} {a:?}");
                }
            }
        }
    }

    #[test]
    fn a_zero_or_infinite_vector_is_refused() {
        assert!(Direction::new(DVec3::ZERO).is_err());
        assert!(Direction::new(DVec3::new(f64::INFINITY, 0.0, 0.0)).is_err());
        assert!(Direction::try_from([f64::NAN, 0.0, 1.0]).is_err());
    }

    #[test]
    fn the_lattice_spreads_evenly() {
        let dirs = fibonacci_sphere(100);
        // A cap per direction of 4π/100 sr has half-angle 11.5°; neighbours stay within 3 of them.
        for a in &dirs {
            let nearest =
                dirs.iter().filter(|b| *b != a).map(|b| a.dot(b.vec())).fold(-1.0, f64::max);
            assert!(nearest.acos().to_degrees() < 25.0);
        }
    }
}
