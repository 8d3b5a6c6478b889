use super::{Holding, Machine};
use crate::base::{DAffine3, DMat3, DVec3, Direction};

/// How the work stands on the table: a rigid map from work to machine coordinates (mm) with all
/// axes at zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    pub machine_from_work: DAffine3,
}

impl Placement {
    /// The rotation that turns `up` to +z. Its rows are the image plane of `up`, so it is exact
    /// for grid axes and the identity for up = +z.
    pub(super) fn rotation_of(up: Direction) -> DMat3 {
        let plane = up.image_plane();
        DMat3::from_cols(plane.u, plane.v, plane.d).transpose()
    }

    /// The work turned so that `up` points away from the table, wherever it stands.
    pub fn turned(up: Direction) -> Placement {
        Placement { machine_from_work: DAffine3::from_mat3(Placement::rotation_of(up)) }
    }
}

impl Machine {
    /// The work held with `holding.up` away from the table, the point of the base plane under
    /// `contact_center` (work coordinates, mm) one pedestal above the table's centre.
    pub fn placement(&self, holding: &Holding, contact_center: DVec3) -> Placement {
        let rotation = Placement::rotation_of(holding.up);
        let on_base = contact_center - holding.up.vec() * holding.height(contact_center);
        let stands_at = DVec3::from_array(self.kinematics.table_center_mm)
            + DVec3::Z * self.workholding.pedestal_mm;
        let translation = stands_at - rotation * on_base;
        Placement { machine_from_work: DAffine3::from_mat3_translation(rotation, translation) }
    }
}
