//! What stands by itself along a grid axis: the largest self-supported subset U, the least
//! self-supporting superset V (HB Sec. 3.4, Alg. 4, 5), the accessible region that stands (A*, Eq.
//! 31), and what is held by the base.
//!
//! Without overhang U and V are columns. With an overhang angle they grow by a cone, layer by
//! layer: what layer z − 1 holds carries the voxels of layer z that lie within r(z) of it, where
//! r(z) = ⌊z tan α⌋ − ⌊(z − 1) tan α⌋, so that over many layers the cone has the angle asked for.
//! Steps by disks of whole radii make an octagonal cone inside the round one: it carries less,
//! never more.
//!
//! HB swaps the letters in places; here U ⊆ P ⊆ V throughout.
//!
//! Guarantees: U(P) ⊆ P ⊆ V(P), both self-supported; U is the largest such subset. Not
//! guaranteed: that V is the least with an overhang angle, where no least one exists.

use crate::morph::{Axis, Element, Engine, Layer, Window, dilate, erode};
use crate::voxel::{BitGrid, Connectivity, flood};

/// Largest angle of an overhang, degrees: beyond it a bead has nothing below it.
const STEEPEST_DEG: f64 = 60.0;

/// How far a layer may reach beyond the one below it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Overhang {
    tangent: f64,
}

#[derive(Debug, thiserror::Error, PartialEq)]
#[error("an overhang angle of {0}° is not between 0° and 60°")]
pub struct NoOverhang(f64);

impl Overhang {
    /// Columns only.
    pub const NONE: Overhang = Overhang { tangent: 0.0 };

    /// # Errors
    /// An angle outside 0° … 60°.
    pub fn degrees(angle: f64) -> Result<Overhang, NoOverhang> {
        if (0.0..=STEEPEST_DEG).contains(&angle) {
            Ok(Overhang { tangent: angle.to_radians().tan() })
        } else {
            Err(NoOverhang(angle))
        }
    }

    /// Sine of the angle: a surface whose normal leans below the horizon by more hangs over.
    pub fn sine(self) -> f64 {
        self.tangent / (1.0 + self.tangent * self.tangent).sqrt()
    }

    /// r(z): by how many voxels layer z may exceed layer z − 1. The hair keeps 45° at 1.
    fn step(&self, z: usize) -> f64 {
        let reach = |z: usize| (z as f64 * self.tangent + 1e-9).floor();
        if z == 0 { 0.0 } else { reach(z) - reach(z - 1) }
    }
}

/// U(P): the voxels that stand on the plate or, through material of the set, on it. The plate lies
/// under layer `plate` along the axis; what is below it does not stand.
pub fn self_supported(set: &BitGrid, up: Axis, plate: usize, overhang: Overhang) -> BitGrid {
    let set = up.up(set);
    let nz = set.dims()[2];
    let mut out = BitGrid::new(set.dims());
    for z in plate..nz {
        let mut layer = slice(&set, z);
        if z > plate {
            layer.intersect_with(&carried(&slice(&out, z - 1), overhang.step(z - plate)));
        }
        put(&mut out, z, &layer);
    }
    up.down(&out)
}

/// V(P): the set and the support below it, down to the plate.
pub fn supporting(set: &BitGrid, up: Axis, plate: usize, overhang: Overhang) -> BitGrid {
    let mut out = up.up(set);
    for z in (plate + 1..out.dims()[2]).rev() {
        let below = slice(&out, z - 1);
        let r = overhang.step(z - plate);
        let mut open = slice(&out, z);
        open.subtract(&carried(&below, r));
        if open.is_empty() {
            continue;
        }
        // A smaller foot carries the middle of what is open; what it does not carry gets a column.
        let grid = Window::of(open.dims());
        let mut foot = erode(Engine::Bits, &open, &disk(r), &grid);
        let rest = open.minus(&carried(&foot, r));
        foot.union_with(&rest);
        foot.union_with(&below);
        put(&mut out, z - 1, &foot);
    }
    up.down(&out)
}

/// A* = U(V(O) ∪ A) − V(O) (HB Eq. 31): the largest part of the accessible region that stands by
/// itself on the obstacle, counted as supported throughout, or on the plate.
pub fn supported_access(
    obstacle: &BitGrid,
    accessible: &BitGrid,
    up: Axis,
    plate: usize,
    overhang: Overhang,
) -> BitGrid {
    let held = supporting(obstacle, up, plate, overhang);
    let mut out = self_supported(&held.or(accessible), up, plate, overhang);
    out.subtract(&held);
    out
}

/// The voxels connected through faces and edges to the base, that is to voxels of `base` (INV Def.
/// 2.2). The state is stable when that is all of it.
pub fn grounded(state: &BitGrid, base: &BitGrid) -> BitGrid {
    flood(state, base, Connectivity::Edge18)
}

fn disk(r: f64) -> Element {
    Element::from_layers(vec![Layer { z: 0, end: 1, plane: Element::disk(r) }])
}

/// What a layer carries on the next one.
fn carried(layer: &BitGrid, r: f64) -> BitGrid {
    if r == 0.0 {
        return layer.clone();
    }
    dilate(Engine::Bits, layer, &disk(r), &Window::of(layer.dims()))
}

fn slice(grid: &BitGrid, z: usize) -> BitGrid {
    let [nx, ny, _] = grid.dims();
    let mut out = BitGrid::new([nx, ny, 1]);
    for y in 0..ny {
        out.row_mut(y, 0).copy_from_slice(grid.row(y, z));
    }
    out
}

fn put(grid: &mut BitGrid, z: usize, layer: &BitGrid) {
    for y in 0..layer.dims()[1] {
        grid.row_mut(y, z).copy_from_slice(layer.row(y, 0));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Direction;
    use proptest::prelude::*;

    fn z() -> Axis {
        Axis::of(Direction::Z).unwrap()
    }

    #[test]
    fn columns_on_every_solid_of_a_small_grid() {
        let dims = [2, 2, 3];
        for bits in 0..1u32 << 12 {
            let p = BitGrid::from_fn(dims, |[x, y, z]| bits >> (x + 2 * (y + 2 * z)) & 1 == 1);
            let u = BitGrid::from_fn(dims, |[x, y, z]| (0..=z).all(|k| p.get([x, y, k])));
            let v = BitGrid::from_fn(dims, |[x, y, z]| (z..3).any(|k| p.get([x, y, k])));
            assert_eq!(self_supported(&p, z(), 0, Overhang::NONE), u);
            assert_eq!(supporting(&p, z(), 0, Overhang::NONE), v);
        }
    }

    #[test]
    fn a_cone_of_the_angle_carries_itself_and_a_wider_one_does_not() {
        let dims = [81, 81, 24];
        for deg in [0.0f64, 20.0, 45.0, 60.0] {
            let overhang = Overhang::degrees(deg).unwrap();
            let cone = |t: f64| {
                BitGrid::from_fn(dims, |[x, y, z]| {
                    let d = (x as f64 - 40.0).abs() + (y as f64 - 40.0).abs();
                    d <= (z as f64 * t + 1e-9).floor()
                })
            };
            let t = deg.to_radians().tan();
            // A pyramid of whole steps along x and y.
            assert_eq!(self_supported(&cone(t), z(), 0, overhang), cone(t), "{deg}");
            let wide = cone(t + 0.4);
            assert!(self_supported(&wide, z(), 0, overhang).count() < wide.count(), "{deg}");
        }
        assert!(Overhang::degrees(61.0).is_err() && Overhang::degrees(f64::NAN).is_err());
    }

    #[test]
    fn a_part_stands_on_a_plate_above_the_grids_floor() {
        let p = BitGrid::from_fn([4, 4, 6], |[x, _, z]| z >= 2 && (z >= 4 || x < 2));
        let u = self_supported(&p, z(), 2, Overhang::NONE);
        assert_eq!(u, BitGrid::from_fn([4, 4, 6], |[x, _, z]| z >= 2 && x < 2));
        assert_eq!(supporting(&p, z(), 2, Overhang::NONE).count(), 4 * 4 * 4);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]
        #[test]
        fn subset_and_superset_stand(
            deg in 0.0f64..60.0, share in 1u8..9, seed in any::<u64>(), pick in 0usize..6,
        ) {
            use Direction as D;
            let d = [D::X, D::NEG_X, D::Y, D::NEG_Y, D::Z, D::NEG_Z][pick];
            let up = Axis::of(d).unwrap();
            let overhang = Overhang::degrees(deg).unwrap();
            let mut state = seed | 1;
            let mut cells = vec![false; 12 * 11 * 10];
            for c in &mut cells {
                state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                *c = (state >> 60) as u8 <= share;
            }
            let p = BitGrid::from_fn([12, 11, 10], |[x, y, z]| cells[x + 12 * (y + 11 * z)]);
            let (u, v) = (self_supported(&p, up, 0, overhang), supporting(&p, up, 0, overhang));
            prop_assert!(u.is_subset_of(&p) && p.is_subset_of(&v));
            prop_assert_eq!(&self_supported(&u, up, 0, overhang), &u);
            prop_assert_eq!(&self_supported(&v, up, 0, overhang), &v);
            prop_assert!(v.is_subset_of(&supporting(&p, up, 0, Overhang::NONE)));
            prop_assert!(self_supported(&p, up, 0, Overhang::NONE).is_subset_of(&u));
            // A*: within A, and standing on V(O).
            let o = BitGrid::from_fn(p.dims(), |[x, y, z]| (x + y * 5 + z * 3) % 11 == 0);
            let a = p.minus(&o);
            let star = supported_access(&o, &a, up, 0, overhang);
            prop_assert!(star.is_subset_of(&a));
            let held = supporting(&o, up, 0, overhang);
            let stands = self_supported(&held.or(&star), up, 0, overhang);
            prop_assert!(star.is_subset_of(&stands));
        }
    }
}
