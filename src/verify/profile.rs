//! A tool's lower surface, exact and bounded from below.

use super::ROUNDING_MM;
use crate::machine::{Section, Shape};

/// The lower surface f(ρ) of a set of sections, each lifted by some mm.
///
/// Every [`Shape`]'s lower surface is non-decreasing where it is finite and infinite beyond its
/// radius: a ball and a rounded corner rise outward; a frustum is flat to r0, rises to (z1, r1)
/// when r1 > r0 and ends at r0 otherwise; a platform is flat. A minimum of non-decreasing functions
/// is non-decreasing, so f(ρ) ≥ f(ρ₀) for all ρ ≥ ρ₀: what [`Profile::lower_bound`] rests on.
/// (A part that narrows upward bounds nothing: tools count as going up without end.)
pub(super) struct Profile {
    parts: Vec<(Shape, f64)>,
    /// `bounds[i]` = f(i · cell); f at larger radii than the table is at least the last.
    bounds: Vec<f64>,
    cells_per_mm: f64,
}

/// Cells of the bound's table. Fewer loosen the bound near edges and cost point tests; many more
/// fall out of the first-level cache (32 KiB).
const BOUND_CELLS: usize = 1024;

impl Profile {
    pub fn new<'s>(sections: impl IntoIterator<Item = (&'s Section, f64)>) -> Profile {
        let parts: Vec<(Shape, f64)> =
            sections.into_iter().map(|(s, lift)| (s.shape, lift)).collect();
        let widest = parts
            .iter()
            .map(|(s, _)| s.max_radius())
            .filter(|r| r.is_finite())
            .fold(ROUNDING_MM, f64::max);
        let cells_per_mm = (BOUND_CELLS - 2) as f64 / widest;
        let mut profile = Profile { parts, bounds: Vec::new(), cells_per_mm };
        profile.bounds = (0..BOUND_CELLS).map(|i| profile.at(i as f64 / cells_per_mm)).collect();
        profile
    }

    /// f(ρ), mm over the tip; infinite where the tool has nothing.
    pub fn at(&self, rho: f64) -> f64 {
        self.parts.iter().map(|(s, lift)| s.lower_surface(rho) + lift).fold(f64::INFINITY, f64::min)
    }

    /// Whether f is one height from this radius on: nothing reaches so far but platforms.
    pub fn is_flat_from(&self, radius: f64) -> bool {
        let flat = |s: &Shape| matches!(s, Shape::Platform { .. }) || s.max_radius() < radius;
        self.parts.iter().all(|(s, _)| flat(s))
    }

    /// f for obstacles: an obstacle on the very edge of a section does not meet it.
    pub fn over_obstacle(&self, rho: f64) -> f64 {
        self.at(rho + ROUNDING_MM)
    }

    /// At most f(ρ′) for every ρ′ ≥ ρ − [`ROUNDING_MM`].
    pub fn lower_bound(&self, rho: f64) -> f64 {
        // A float below 0 casts to 0.
        let cell = ((rho - 2.0 * ROUNDING_MM) * self.cells_per_mm) as usize;
        // The product may round up to the next cell: one cell down is always safe.
        self.bounds[cell.saturating_sub(1).min(BOUND_CELLS - 1)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    pub fn shape() -> impl Strategy<Value = Shape> {
        let mm = 0.01f64..20.0;
        (0..4, mm.clone(), mm.clone(), mm.clone(), mm).prop_map(|(kind, a, b, c, d)| {
            let shape = match kind {
                0 => Shape::Ball { radius: a },
                1 => Shape::BullNose { radius: a.max(b), corner: a.min(b) },
                2 => Shape::Frustum { z0: a.min(b), z1: a.max(b) + 0.1, r0: c, r1: d },
                _ => Shape::Platform { z: a },
            };
            // A shape added later must join this test: the bound stands on its monotony.
            match shape {
                Shape::Ball { .. }
                | Shape::BullNose { .. }
                | Shape::Frustum { .. }
                | Shape::Platform { .. } => shape,
            }
        })
    }

    proptest! {
        #[test]
        fn the_bound_is_below_the_surface_at_every_larger_radius(
            shapes in proptest::collection::vec(shape(), 1..4),
            rho in 0.0f64..30.0,
            more in 0.0f64..10.0,
        ) {
            let sections: Vec<Section> =
                shapes.into_iter().map(|shape| Section { shape, active: true }).collect();
            let p = Profile::new(sections.iter().map(|s| (s, 0.25)));
            prop_assert!(p.lower_bound(rho) <= p.at(rho) + 1e-12);
            prop_assert!(p.lower_bound(rho) <= p.at(rho + more) + 1e-12);
            prop_assert!(p.at(rho) <= p.at(rho + more) + 1e-12);
        }
    }
}
