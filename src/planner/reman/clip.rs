//! Clipping planes, global and local (W2V Sec. 3.1, 4.2).
//!
//! A global plane gives up all of the reused volume on its positive side. A local one gives up only
//! those connected pieces of it that contain its seeds.

use crate::plan::Plane;
use crate::region::above;
use crate::voxel::{BitGrid, Connectivity, Frame, flood};

#[derive(Clone, Debug, PartialEq)]
pub struct Clip {
    pub plane: Plane,
    /// Voxels of the pieces to give up; none for a global plane.
    pub seeds: Option<BitGrid>,
}

impl Clip {
    pub fn global(plane: Plane) -> Clip {
        Clip { plane, seeds: None }
    }

    /// What of `reusable` it gives up.
    pub fn clipped(&self, reusable: &BitGrid, frame: &Frame) -> BitGrid {
        let over = above(reusable, frame, self.plane.normal.vec(), self.plane.offset);
        match &self.seeds {
            None => over,
            Some(seeds) => flood(&over, &over.and(seeds), Connectivity::Edge18),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::{DVec3, Direction};

    #[test]
    fn a_local_plane_leaves_the_other_pieces_of_its_positive_side() {
        let frame = Frame { pitch: 1.0, dims: [12, 4, 8], origin: DVec3::ZERO };
        // Two posts on a plate.
        let part = BitGrid::from_fn(frame.dims, |[x, _, z]| z < 2 || !(3..=8).contains(&x));
        let plane = Plane { normal: Direction::Z, offset: 4.0 };
        let seeds = BitGrid::from_fn(frame.dims, |v| v == [0, 0, 7]);
        let local = Clip { plane, seeds: Some(seeds) }.clipped(&part, &frame);
        let global = Clip::global(plane).clipped(&part, &frame);
        assert_eq!(local, BitGrid::from_fn(frame.dims, |[x, _, z]| x < 3 && z >= 4));
        assert_eq!(global.count(), 2 * local.count());
    }
}
