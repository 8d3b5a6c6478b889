//! Support along directions that are no grid axes: U and V of the part as it is on a grid of the
//! same pitch across the direction.
//!
//! Guarantees: a voxel of that grid has the state of a voxel of the part's grid whose centre is at
//! most √3/2 pitches from its own, so that no surface moves further. Along the grid axes the counts
//! are those of the part's own grid.
//!
//! Not guaranteed: that walls thinner than two voxels stay whole.

use super::support::{Overhang, self_supported, supporting};
use crate::base::{DVec3, Direction};
use crate::morph::Axis;
use crate::voxel::{BitGrid, Frame};
use rayon::prelude::*;

/// How many voxels of a part stand by themselves along a direction, U(P), and how many of support
/// the others need, V(P) − P (HB Eqs. 20–25). The part stands on its own lowest layer.
pub fn support_along(
    part: &BitGrid,
    frame: &Frame,
    direction: Direction,
    overhang: Overhang,
) -> (usize, usize) {
    let upright = match Axis::of(direction) {
        Some(axis) => axis.up(part),
        None => turned(part, frame, direction),
    };
    let Some(up) = Axis::of(Direction::Z) else { return (0, 0) };
    let plate = upright.extent().map_or(0, |(lo, _)| lo[2]);
    let stands = self_supported(&upright, up, plate, overhang);
    let whole = supporting(&upright, up, plate, overhang);
    (stands.count(), whole.count() - upright.count())
}

/// The part on a grid of its own pitch whose z runs along a direction, cut to its voxels.
fn turned(part: &BitGrid, frame: &Frame, direction: Direction) -> BitGrid {
    let Some((lo, hi)) = part.extent() else { return BitGrid::new([1; 3]) };
    let plane = direction.image_plane();
    let h = frame.pitch;
    let across = |p: DVec3| plane.across(p).extend(plane.height(p));
    let (mut least, mut most) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for corner in 0..8 {
        let end = std::array::from_fn(|a| if corner >> a & 1 == 0 { lo[a] } else { hi[a] });
        let p = across(frame.center(end));
        (least, most) = (least.min(p), most.max(p));
    }
    let n = ((most - least) / h).ceil().to_array().map(|n| n as usize + 1);
    let mut out = BitGrid::new(n);
    out.par_rows_mut().for_each(|(y, z, row)| {
        let at = least + DVec3::new(0.0, y as f64, z as f64) * h;
        let world = plane.world(at.truncate(), at.z);
        let (first, step) = ((world - frame.origin) / h, plane.u);
        for x in 0..n[0] {
            let voxel = (first + step * x as f64).floor().to_array().map(|c| c as i64);
            row[x / 64] |= u64::from(part.get_or_empty(voxel)) << (x % 64);
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::fibonacci_sphere;

    const FRAME: Frame = Frame { pitch: 0.5, dims: [70, 70, 70], origin: DVec3::ZERO };

    #[test]
    fn a_ball_needs_the_same_support_along_every_direction() {
        let (middle, r) = (DVec3::splat(17.5), 12.0);
        let ball = BitGrid::from_fn(FRAME.dims, |v| FRAME.center(v).distance(middle) <= r);
        // Below the ball, down to the plate it touches: a cylinder without half of the ball.
        let (disk, voxel) = (std::f64::consts::PI * r * r, FRAME.voxel_volume());
        let support = disk * r / 3.0;
        // What stands is nearly nothing: what rests on the patch that the lowest layer makes.
        let bound = (disk * 4.0) * FRAME.pitch * 3f64.sqrt() / 2.0;
        fibonacci_sphere(12).into_par_iter().chain([Direction::Z, Direction::NEG_X]).for_each(
            |d| {
                let (stands, below) = support_along(&ball, &FRAME, d, Overhang::NONE);
                let found = below as f64 * voxel;
                assert!((found - support).abs() < bound, "{d:?}: {found} {support} ± {bound}");
                assert!((stands as f64) * voxel < bound, "{d:?}: {stands}");
                // A cone of 60° carries more of it.
                let wide = Overhang::degrees(60.0).unwrap();
                assert!(support_along(&ball, &FRAME, d, wide).0 > 2 * stands, "{d:?}");
            },
        );
    }

    #[test]
    fn a_block_tilted_onto_its_edge_hangs_over_on_both_sides() {
        // 20 × 20 × 20 mm along y, on an edge: half of it and half of its square's shadow.
        let inside = 5..45usize;
        let block = BitGrid::from_fn([50, 50, 50], |v| v.iter().all(|c| inside.contains(c)));
        let frame = Frame { dims: [50, 50, 50], ..FRAME };
        let d = Direction::new(DVec3::new(1.0, 0.0, 1.0)).unwrap();
        let (stands, below) = support_along(&block, &frame, d, Overhang::NONE);
        // Support: the two triangles under a square on its corner, a quarter of its box each half.
        let (side, voxel) = (20.0, frame.voxel_volume());
        let bound = 6.0 * side * side * frame.pitch * 3f64.sqrt() / 2.0;
        let found = below as f64 * voxel;
        assert!((found - side * side * side / 2.0).abs() < bound, "{found}");
        assert!((stands as f64) * voxel < bound);
        // Over 45° its faces carry themselves.
        let steep = Overhang::degrees(50.0).unwrap();
        let (stands, _) = support_along(&block, &frame, d, steep);
        assert!(stands as f64 * voxel > side * side * side - bound, "{stands}");
    }

    #[test]
    fn an_empty_part_needs_nothing() {
        let none = BitGrid::new([3, 4, 5]);
        let d = Direction::new(DVec3::ONE).unwrap();
        assert_eq!(support_along(&none, &FRAME, d, Overhang::NONE), (0, 0));
    }
}
