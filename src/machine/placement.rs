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
    /// `contact_center` (work coordinates, mm) one pedestal above the part's place on the table.
    pub fn placement(&self, holding: &Holding, contact_center: DVec3) -> Placement {
        let rotation = Placement::rotation_of(holding.up);
        let on_base = contact_center - holding.up.vec() * holding.height(contact_center);
        let place = self.workholding.place;
        let rotation = if place.is_centre() { rotation } else { place.rotation() * rotation };
        let stands_at = DVec3::from_array(self.kinematics.table_center_mm)
            + place.offset()
            + DVec3::Z * self.workholding.pedestal_mm;
        let translation = stands_at - rotation * on_base;
        Placement { machine_from_work: DAffine3::from_mat3_translation(rotation, translation) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_contact_stands_one_pedestal_above_the_tables_centre() {
        let mut machine = Machine::builtin("mx220").unwrap();
        machine.kinematics.table_center_mm = [1.0, 2.0, 3.0];
        for up in [Direction::Z, Direction::NEG_Z, Direction::X, Direction::NEG_Y] {
            let holding = Holding { up, height_mm: -4.0 };
            let contact = DVec3::new(7.0, -8.0, 9.0);
            let map = machine.placement(&holding, contact).machine_from_work;
            // The contact is higher over the base plane than the point it stands on.
            let above = DVec3::Z * holding.height(contact);
            let stands = DVec3::new(1.0, 2.0, 3.0 + machine.workholding.pedestal_mm);
            assert!((map.transform_point3(contact) - stands - above).length() < 1e-12);
            assert_eq!(map.transform_vector3(up.vec()), DVec3::Z);
            assert_eq!(map.matrix3.determinant(), 1.0, "no reflection");
        }
        assert_eq!(Placement::turned(Direction::Z).machine_from_work, DAffine3::IDENTITY);
    }
}
