//! How many voxels a pit would give up: those in a cone that opens upward from what it is dug for.
//!
//! Method: voxels in bricks; a brick that lies wholly in the cone, or wholly out of it, is told by its ball.
//!
//! Guarantees: the counts of a look at every voxel.

use crate::base::{DVec3, Direction};
use crate::voxel::{BitGrid, Frame};
use std::collections::BTreeMap;

/// What opens upward along a direction from a ball, as a pit does from a patch.
pub struct Cone {
    pub from: DVec3,
    /// Of the ball, mm.
    pub radius: f64,
    pub along: Direction,
    /// How much wider it gets for each mm up.
    pub opening: f64,
}

/// Voxels near each other, some of them old, the others printed.
pub struct Brick {
    /// All of it lies within a radius of this, mm.
    middle: DVec3,
    radius: f64,
    /// Old ones, and printed ones.
    count: [usize; 2],
    /// Their middles, and which of the two each is.
    cells: Vec<(DVec3, usize)>,
}

/// Voxels along the side of a brick.
const BRICK: usize = 8;

impl Brick {
    /// The voxels of a solid in bricks.
    pub fn all_of(solid: &BitGrid, old: &BitGrid, frame: &Frame) -> Vec<Brick> {
        let mut bricks: BTreeMap<[usize; 3], Brick> = BTreeMap::new();
        let half = (BRICK - 1) as f64 / 2.0 * frame.pitch;
        for v in solid.iter_ones() {
            let at = v.map(|c| c / BRICK);
            let brick = bricks.entry(at).or_insert_with(|| Brick {
                middle: frame.center(at.map(|c| c * BRICK)) + half,
                radius: half * 3f64.sqrt(),
                count: [0; 2],
                cells: Vec::new(),
            });
            let which = usize::from(!old.get(v));
            brick.count[which] += 1;
            brick.cells.push((frame.center(v), which));
        }
        bricks.into_values().collect()
    }
}

impl Cone {
    /// Old and printed voxels in it.
    pub fn holds(&self, bricks: &[Brick]) -> [usize; 2] {
        // How far up and aside.
        let place = |q: DVec3| {
            let by = q - self.from;
            (self.along.dot(by) + self.radius, by.cross(self.along.vec()).length())
        };
        let wide = |up: f64| self.radius + up * self.opening;
        let mut held = [0; 2];
        for b in bricks {
            let ((up, aside), r) = (place(b.middle), b.radius);
            if up + r <= 0.0 || aside - r > wide(up + r) {
                continue;
            }
            if up - r > 0.0 && aside + r <= wide(up - r) {
                (0..2).for_each(|k| held[k] += b.count[k]);
                continue;
            }
            for (q, which) in &b.cells {
                let (up, aside) = place(*q);
                held[*which] += usize::from(up > 0.0 && aside <= wide(up));
            }
        }
        held
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::fibonacci_sphere;

    #[test]
    fn a_cone_holds_what_a_look_at_every_voxel_says() {
        let frame = Frame { pitch: 0.7, dims: [31, 22, 27], origin: DVec3::new(1.0, -4.0, 0.5) };
        let solid = BitGrid::from_fn(frame.dims, |[x, y, z]| (x + 2 * y + 3 * z) % 7 < 5);
        let old = BitGrid::from_fn(frame.dims, |[x, _, z]| x < 17 && z < 14);
        let bricks = Brick::all_of(&solid, &old, &frame);
        let mut some = 0;
        for (i, along) in fibonacci_sphere(24).into_iter().enumerate() {
            let from = frame.center([i % 31, 3 * i % 22, 5 * i % 27]);
            for opening in [0.0, 1.0, 5.7] {
                let cone = Cone { from, radius: 1.3, along, opening };
                let is_in = |q: DVec3| {
                    let up = along.dot(q - from) + 1.3;
                    up > 0.0 && (q - from).cross(along.vec()).length() <= 1.3 + up * opening
                };
                let within = solid.iter_ones().filter(|v| is_in(frame.center(*v)));
                let (of_old, printed): (Vec<_>, Vec<_>) = within.partition(|v| old.get(*v));
                assert_eq!(
                    cone.holds(&bricks),
                    [of_old.len(), printed.len()],
                    "{along:?} {opening}"
                );
                some += of_old.len().min(printed.len());
            }
        }
        assert!(some > 1000, "{some}");
    }
}
