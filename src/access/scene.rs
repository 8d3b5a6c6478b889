use super::tops::axis_of;
use crate::base::{Aabb, DVec3, Direction};
use crate::voxel::{BitGrid, Frame};

/// Obstacle points for the depth engine: the boundary voxels of a state and the fixed points of
/// its holding. Inner voxels are covered by the boundary, since a tool goes up without end.
pub struct Scene {
    pub frame: Frame,
    voxels: BitGrid,
    fixed: Vec<DVec3>,
    /// Boxes of every [`GROUP`] fixed points, which come pile by pile or row by row.
    boxes: Vec<Aabb>,
}

/// Fixed points that are passed over together. Fewer fit closer, more are passed over faster.
const GROUP: usize = 32;

impl Scene {
    pub fn new(frame: &Frame, state: &BitGrid, fixed: &[DVec3]) -> Scene {
        Scene::of_points(frame, state.boundary(), fixed)
    }

    fn of_points(frame: &Frame, voxels: BitGrid, fixed: &[DVec3]) -> Scene {
        let group = |group: &[DVec3]| {
            let least = group.iter().copied().fold(DVec3::MAX, DVec3::min);
            Aabb { min: least, max: group.iter().copied().fold(DVec3::MIN, DVec3::max) }
        };
        let boxes = fixed.chunks(GROUP).map(group).collect();
        Scene { frame: *frame, voxels, fixed: fixed.to_vec(), boxes }
    }

    /// The fixed points in groups with their boxes.
    pub(super) fn groups(&self) -> impl Iterator<Item = (&Aabb, &[DVec3])> {
        self.boxes.iter().zip(self.fixed.chunks(GROUP))
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
        Scene::of_points(frame, voxels, fixed)
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
        Scene::of_points(frame, voxels, fixed)
    }

    /// The voxels whose centres are obstacle points.
    pub fn voxels(&self) -> &BitGrid {
        &self.voxels
    }

    /// All obstacle points, mm.
    pub fn points(&self) -> impl Iterator<Item = DVec3> + '_ {
        let centres = self.voxels.iter_ones().map(|v| self.frame.center(v));
        centres.chain(self.fixed.iter().copied())
    }
}
