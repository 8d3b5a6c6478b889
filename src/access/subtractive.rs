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

/// Rounds in which only what is not reached is taken back. Cuts of tools smaller than the part end
/// long before; an edge as wide as the part may come down a voxel a round, for hours.
const PATIENT_ROUNDS: usize = 32;

/// Rounds after which, beyond those, twice as much around it is taken back as well.
const DOUBLING_ROUNDS: usize = 4;

/// The largest region R ⊆ `removable` that the tool removes from `state` along `direction`, each
/// voxel accessible against the *output* state (HB Eq. 26, Alg. 6): R ⊆ A(state − R).
///
/// Starts from everything removable and takes back what the rest blocks, until nothing changes.
/// The map over-restricts, so the fixed point is a valid cut. After 32 rounds more and more
/// is taken back around it, and the fixed point need no longer be the largest.
pub fn over_cut(
    frame: &Frame,
    state: &BitGrid,
    removable: &BitGrid,
    fixed: &[DVec3],
    tool: &Tool,
    direction: Direction,
) -> Cut {
    let mut region = removable.and(state);
    let mut rounds: usize = 0;
    while !region.is_empty() {
        rounds += 1;
        let scene = Scene::along(frame, state.minus(&region), fixed, direction);
        let mut next = reachable(&cutter_map(&scene, &region, tool, direction), &region, frame);
        if next == region {
            break;
        }
        if let Some(late) = rounds.checked_sub(PATIENT_ROUNDS) {
            let mut back = region.minus(&next);
            // No grid is wider than what ten doublings reach.
            (0..1usize << (late / DOUBLING_ROUNDS).min(10)).for_each(|_| back = back.grown());
            next.subtract(&back);
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

    /// A ball wider than the part came down a voxel a round.
    #[test]
    fn the_cut_of_a_ball_wider_than_the_part_ends() {
        let frame = Frame { pitch: 0.5, dims: [60, 60, 60], origin: DVec3::ZERO };
        let state = BitGrid::from_fn(frame.dims, |_| true);
        let wanted = BitGrid::from_fn(frame.dims, |[x, y, z]| z > 4 && x + y < 70);
        let ball = Shape::Ball { radius: 40.0 };
        let shank = Shape::Frustum { z0: 40.0, r0: 40.0, z1: 90.0, r1: 40.0 };
        let sections = [ball, shank].map(|shape| Section { shape, active: true });
        let tool = Tool::new("big", ToolKind::Subtractive, sections.to_vec());
        for d in
            [Direction::Z, Direction::NEG_X, Direction::new(DVec3::new(0.2, -0.3, 1.0)).unwrap()]
        {
            let cut = over_cut(&frame, &state, &wanted, &[], &tool, d);
            assert!(cut.rounds < PATIENT_ROUNDS + 10 * DOUBLING_ROUNDS, "{}", cut.rounds);
            let scene = Scene::new(&frame, &state.minus(&cut.region), &[]);
            let map = cutter_map(&scene, &cut.region, &tool, d);
            assert_eq!(reachable(&map, &cut.region, &frame), cut.region);
        }
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
