//! How low obstacles may stand and still have a say about the voxels asked about.
//!
//! An obstacle point o bears on a tip t at o_z − f(ρ_ot), and a tip bears on a voxel x at most
//! `reach` away, from at most the largest k below it: o has a say about x only where
//! o_z ≥ x_z − k + f(ρ_ox − reach). f is bounded from below by its steps, section by section: a
//! pedestal stands far too low for all but the holder, and that is far away.
//!
//! Guarantees: a point that is called too low for a voxel has no say about it. Floors are kept by
//! squares of a few millimetres and distances along the axes, so some that have none are called so not.

use super::tiles::{Extreme, Least, running_extreme};
use crate::base::DVec2;

/// Side of the squares, mm. Larger ones pass over fewer points, smaller ones take longer to make.
const SQUARE_MM: f64 = 4.0;

/// Lowest heights, mm, at which points over squares across a direction have a say.
pub struct Floors {
    /// Corner of square (0, 0), mm.
    first: DVec2,
    n: [usize; 2],
    heights: Vec<f32>,
}

impl Floors {
    /// For voxels at (u, v) and a height, mm; `steps` are (r, h): what lies up to r from a voxel along
    /// both axes has a say only h higher than it. What lies farther than all r has none.
    pub fn of(voxels: &[(DVec2, f64)], steps: &[(f64, f64)]) -> Floors {
        let widest = steps.iter().map(|s| s.0).fold(0.0, f64::max);
        let (mut lo, mut hi) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        for (uv, _) in voxels {
            (lo, hi) = (lo.min(*uv), hi.max(*uv));
        }
        if voxels.is_empty() {
            return Floors { first: DVec2::ZERO, n: [0; 2], heights: Vec::new() };
        }
        // A square to spare on either side.
        let first = lo - DVec2::splat(widest + SQUARE_MM);
        let n = ((hi - first + DVec2::splat(widest)) / SQUARE_MM).ceil() + DVec2::ONE;
        let n = [n.x as usize, n.y as usize];
        let mut of_voxels = vec![Least::NONE; n[0] * n[1]];
        for (uv, z) in voxels {
            let at = (*uv - first) / SQUARE_MM;
            let square = &mut of_voxels[at.x as usize + n[0] * at.y as usize];
            *square = Least::of(*z as f32, *square);
        }
        let mut heights = vec![Least::NONE; n[0] * n[1]];
        let room = &mut Vec::new();
        for (r, h) in steps {
            let by = (r / SQUARE_MM).ceil() as usize;
            // Runs begin `by` squares before: what runs on from a row's end only lowers the floor.
            let pad = vec![Least::NONE; by * (n[0] + 1)];
            let mut near = [&pad[..], &of_voxels].concat();
            running_extreme::<Least>(&mut near, room, 1, 2 * by + 1);
            running_extreme::<Least>(&mut near, room, n[0], 2 * by + 1);
            for (floor, near) in heights.iter_mut().zip(&near) {
                *floor = Least::of(near + *h as f32, *floor);
            }
        }
        Floors { first, n, heights }
    }

    /// Whether a point at most `spread` from (u, v), mm, may have a say if it stands no higher than
    /// `top`.
    pub fn may_matter(&self, uv: DVec2, spread: DVec2, top: f64) -> bool {
        let [lo, hi] = [uv - spread, uv + spread].map(|p| ((p - self.first) / SQUARE_MM).floor());
        let range = |lo: f64, hi: f64, n: usize| {
            lo.max(0.0) as usize..((hi + 1.0).max(0.0) as usize).min(n)
        };
        let across = range(lo.x, hi.x, self.n[0]);
        range(lo.y, hi.y, self.n[1]).any(|j| {
            let row = &self.heights[self.n[0] * j..][..self.n[0]];
            row.get(across.clone()).is_some_and(|r| r.iter().any(|floor| f64::from(*floor) <= top))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn no_point_that_has_a_say_is_too_low(
            voxels in prop::collection::vec((-30.0f64..30.0, -30.0f64..30.0, -9.0f64..9.0), 1..6),
            points in prop::collection::vec((-60.0f64..60.0, -60.0f64..60.0, -9.0f64..40.0), 60),
            spread in (0.0f64..9.0, 0.0f64..9.0),
            radii in (0.0f64..5.0, 0.0f64..30.0),
        ) {
            let voxels: Vec<_> = voxels.iter().map(|v| (DVec2::new(v.0, v.1), v.2)).collect();
            let steps = [(radii.0, -1.0), (radii.0 + radii.1, 14.0)];
            let floors = Floors::of(&voxels, &steps);
            let spread = DVec2::from(spread);
            let mut low = 0;
            for (u, v, z) in points {
                let p = DVec2::new(u, v);
                let says = voxels.iter().any(|(uv, x)| {
                    let far = (p - *uv).abs() - spread;
                    steps.iter().any(|(r, h)| far.max_element() <= *r && z >= x + h)
                });
                let may = floors.may_matter(p, spread, z + 1e-4);
                prop_assert!(!says || may, "{p} {z}");
                low += usize::from(!may);
            }
            prop_assert!(low > 0);
        }
    }
}
