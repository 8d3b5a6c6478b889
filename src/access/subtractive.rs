//! What one direction can cut.

use super::{Scene, cutter_map, reachable};
use crate::base::{DVec3, Direction};
use crate::machine::Tool;
use crate::voxel::{BitGrid, Frame};

/// An over-cut: what a tool removes from a state along a direction.
pub struct Cut {
    pub region: BitGrid,
    /// Rounds until the fixed point.
    pub rounds: usize,
}

/// The largest region R ⊆ `removable` that the tool removes from `state` along `direction`, each
/// voxel accessible against the *output* state (HB Eq. 26, Alg. 6): R ⊆ A(state − R).
///
/// Starts from everything removable and takes back what the rest blocks, until nothing changes.
/// The map over-restricts, so the fixed point is a valid cut.
pub fn over_cut(
    frame: &Frame,
    state: &BitGrid,
    removable: &BitGrid,
    fixed: &[DVec3],
    tool: &Tool,
    direction: Direction,
) -> Cut {
    let mut region = removable.and(state);
    let mut rounds = 0;
    while !region.is_empty() {
        rounds += 1;
        let scene = Scene::new(frame, &state.minus(&region), fixed);
        let next = reachable(&cutter_map(&scene, &region, tool, direction), &region, frame);
        if next == region {
            break;
        }
        region = next;
    }
    Cut { region, rounds }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::machine::{Section, Shape, ToolKind};

    fn flat(radius: f64) -> Tool {
        let shape = Shape::Frustum { z0: 0.0, r0: radius, z1: 30.0, r1: radius };
        Tool::new("flat", ToolKind::Subtractive, vec![Section { shape, active: true }])
    }

    #[test]
    fn a_pocket_opens_from_above_and_not_from_below() {
        let frame = Frame { pitch: 1.0, dims: [12, 12, 8], origin: DVec3::ZERO };
        let state = BitGrid::from_fn(frame.dims, |_| true);
        let pocket = BitGrid::from_fn(frame.dims, |[x, y, z]| {
            (2..10).contains(&x) && (2..10).contains(&y) && z > 2
        });
        let cut = |d| over_cut(&frame, &state, &pocket, &[], &flat(1.5), d).region;
        // A round tool leaves the four vertical corners.
        let open = cut(Direction::Z);
        assert!(open.count() >= pocket.count() - 4 * 4 * 5, "{}", open.count());
        assert!(open.get([5, 5, 3]));
        assert!(cut(Direction::NEG_Z).is_empty());
        assert!(cut(Direction::X).is_empty());
    }

    #[test]
    fn a_slot_narrower_than_the_cutter_is_never_passed() {
        let frame = Frame { pitch: 0.5, dims: [30, 30, 20], origin: DVec3::ZERO };
        let state = BitGrid::from_fn(frame.dims, |_| true);
        let slot = BitGrid::from_fn(frame.dims, |[x, y, z]| {
            (13..17).contains(&x) && (3..27).contains(&y) && z > 4
        });
        let cut = over_cut(&frame, &state, &slot, &[], &flat(1.5), Direction::Z);
        assert!(cut.region.is_empty());
    }
}
