use crate::base::DVec3;
use crate::voxel::{BitGrid, Frame};

/// Obstacle points for the depth engine: the boundary voxels of a state and the fixed points of
/// its holding. Inner voxels are covered by the boundary, since a tool goes up without end.
pub struct Scene {
    pub frame: Frame,
    points: Vec<DVec3>,
}

impl Scene {
    pub fn new(frame: &Frame, state: &BitGrid, fixed: &[DVec3]) -> Scene {
        let mut points: Vec<DVec3> =
            state.boundary().iter_ones().map(|v| frame.center(v)).collect();
        points.extend_from_slice(fixed);
        Scene { frame: *frame, points }
    }

    pub fn points(&self) -> &[DVec3] {
        &self.points
    }
}
