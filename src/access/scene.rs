use super::tops::axis_of;
use crate::base::{DVec3, Direction};
use crate::voxel::{BitGrid, Frame};

/// Obstacle points for the depth engine: the boundary voxels of a state and the fixed points of
/// its holding. Inner voxels are covered by the boundary, since a tool goes up without end.
pub struct Scene {
    pub frame: Frame,
    voxels: BitGrid,
    fixed: Vec<DVec3>,
}

impl Scene {
    pub fn new(frame: &Frame, state: &BitGrid, fixed: &[DVec3]) -> Scene {
        Scene { frame: *frame, voxels: state.boundary(), fixed: fixed.to_vec() }
    }

    /// The obstacles as tools along one direction meet them, made in the least time. Along a grid axis
    /// the depth engine looks at the highest voxel of each column alone, and whether those within
    /// are there makes no difference.
    pub(super) fn along(
        frame: &Frame,
        state: BitGrid,
        fixed: &[DVec3],
        direction: Direction,
    ) -> Scene {
        let on_axis = axis_of(direction.vec()).is_some();
        let voxels = if on_axis { state } else { state.boundary() };
        Scene { frame: *frame, voxels, fixed: fixed.to_vec() }
    }

    /// The obstacles as a tool along +z meets them: of each column of voxels only the highest.
    pub fn from_above(frame: &Frame, state: &BitGrid, fixed: &[DVec3]) -> Scene {
        let mut voxels = BitGrid::new(state.dims());
        let [_, ny, nz] = state.dims();
        let mut open = vec![!0u64; state.words_per_row()];
        for y in 0..ny {
            open.fill(!0);
            for z in (0..nz).rev() {
                let tops = voxels.row_mut(y, z).iter_mut().zip(&mut open);
                for ((top, open), bits) in tops.zip(state.row(y, z)) {
                    *top = bits & *open;
                    *open &= !bits;
                }
            }
        }
        Scene { frame: *frame, voxels, fixed: fixed.to_vec() }
    }

    /// The voxels whose centres are obstacle points.
    pub fn voxels(&self) -> &BitGrid {
        &self.voxels
    }

    /// The obstacle points that are no voxels' centres, mm.
    pub fn fixed(&self) -> &[DVec3] {
        &self.fixed
    }

    /// All obstacle points, mm.
    pub fn points(&self) -> impl Iterator<Item = DVec3> + '_ {
        let centres = self.voxels.iter_ones().map(|v| self.frame.center(v));
        centres.chain(self.fixed.iter().copied())
    }
}
