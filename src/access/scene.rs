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

    /// The obstacles as a tool along +z meets them: of each column of voxels only the highest.
    pub fn from_above(frame: &Frame, state: &BitGrid, fixed: &[DVec3]) -> Scene {
        let mut points = fixed.to_vec();
        let [_, ny, nz] = state.dims();
        let mut open = vec![!0u64; state.words_per_row()];
        for y in 0..ny {
            open.fill(!0);
            for z in (0..nz).rev() {
                for (w, (open, bits)) in open.iter_mut().zip(state.row(y, z)).enumerate() {
                    let mut new = bits & *open;
                    *open &= !bits;
                    while new != 0 {
                        let x = w * 64 + new.trailing_zeros() as usize;
                        points.push(frame.center([x, y, z]));
                        new &= new - 1;
                    }
                }
            }
        }
        Scene { frame: *frame, points }
    }

    pub fn points(&self) -> &[DVec3] {
        &self.points
    }
}
