//! Where the part stands on the table: on its centre, at a given place, or where the axes reach most.
//!
//! Method: places on a coarse grid of the table, in quarter turns, are tried in order of their distance from
//! the centre; the one from which most pairs of direction and tool have the part's whole box, and
//! a clearance above it, within travel is taken, the nearest of equals. Guarantees: the centre is
//! kept unless another place is better. Not guaranteed: anything about the plan, which is not
//! made yet: it is verified where the part then stands.

use super::kinematics::sin_cos_deg;
use super::travel::corners;
use super::workholding::{Table, Workholding};
use super::{Holding, Machine};
use crate::base::{Aabb, DMat3, DVec3, Direction};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Offset of the part's base from the table's centre, mm, and how it is turned about z, degrees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Place {
    #[serde(default)]
    pub x_mm: f64,
    #[serde(default)]
    pub y_mm: f64,
    #[serde(default)]
    pub angle_deg: f64,
}

/// Steps from the table's centre to its rim at which places are tried: with four a machine whose
/// travel ends between two of them loses an eighth of the table at most.
const STEPS: i32 = 4;

/// Directions on the sphere that count: neighbours 12° apart.
const DIRECTIONS: usize = 250;

impl Place {
    /// Whether this is where the part stands without asking.
    pub fn is_centre(&self) -> bool {
        *self == Place::default()
    }

    pub(super) fn offset(&self) -> DVec3 {
        DVec3::new(self.x_mm, self.y_mm, 0.0)
    }

    pub(super) fn rotation(&self) -> DMat3 {
        let (s, c) = sin_cos_deg(self.angle_deg);
        DMat3::from_cols(DVec3::new(c, s, 0.0), DVec3::new(-s, c, 0.0), DVec3::Z)
    }
}

impl Workholding {
    /// What stands against the part's place.
    ///
    /// # Errors
    /// A place beside the table, or no number.
    pub fn place_on_table(&self) -> Result<(), String> {
        let Place { x_mm: x, y_mm: y, angle_deg } = self.place;
        let on = match self.table {
            Table::Disc { radius_mm } => x.hypot(y) <= radius_mm,
            Table::Box { x_mm, y_mm } => x.abs() <= x_mm / 2.0 && y.abs() <= y_mm / 2.0,
        };
        if !on {
            return Err(format!("the place ({x}, {y}) mm from the centre is not on the table"));
        }
        if !(-360.0..=360.0).contains(&angle_deg) {
            return Err(format!("angle_deg = {angle_deg} must lie between -360 and 360"));
        }
        Ok(())
    }

    fn half_extent(&self) -> DVec3 {
        match self.table {
            Table::Disc { radius_mm } => DVec3::new(radius_mm, radius_mm, 0.0),
            Table::Box { x_mm, y_mm } => DVec3::new(x_mm / 2.0, y_mm / 2.0, 0.0),
        }
    }
}

impl Machine {
    /// The place on the table from which a part whose box is given (work coordinates, mm), standing as
    /// clamped on the point under `contact_center`, is within travel most often.
    pub fn find_place(&self, part: Aabb, contact_center: DVec3) -> Place {
        let axes = [Direction::Z, Direction::X, Direction::NEG_X, Direction::Y, Direction::NEG_Y];
        let axes = axes.into_iter().filter(|d| self.can_point(Direction::Z, *d));
        let sampled = self.sampled(Direction::Z, DIRECTIONS / 2);
        let directions: Vec<Direction> = sampled.into_iter().chain(axes).collect();
        let served = |place: Place| {
            let workholding = Workholding { place, ..self.workholding };
            let machine = Machine { workholding, ..self.clone() };
            let placement = machine.placement(&Holding::AS_CLAMPED, contact_center);
            let serves = |d: &Direction| {
                let away = d.vec() * self.control.clearance_mm;
                let mut tips = corners(part).to_vec();
                tips.extend(corners(part).map(|p| p + away));
                let home = self.kinematics.home();
                let ok = |t| machine.posture(&placement, *d, home, t, &tips).is_ok();
                self.tools.iter().filter(|t| ok(t)).count()
            };
            directions.iter().map(serves).sum::<usize>()
        };
        let most = directions.len() * self.tools.len();
        let centre = served(Place::default());
        if centre == most {
            return Place::default();
        }
        let step = self.workholding.half_extent() / f64::from(STEPS);
        let grid = (-STEPS..=STEPS).flat_map(|i| (-STEPS..=STEPS).map(move |j| (i, j)));
        let mut places: Vec<Place> = grid
            .flat_map(|(i, j)| [0.0, 90.0, 180.0, 270.0].map(|angle_deg| (i, j, angle_deg)))
            .map(|(i, j, angle_deg)| {
                let (x_mm, y_mm) = (f64::from(i) * step.x, f64::from(j) * step.y);
                Place { x_mm, y_mm, angle_deg }
            })
            .filter(|place| {
                Workholding { place: *place, ..self.workholding }.place_on_table().is_ok()
            })
            .collect();
        places.sort_by(|a, b| a.offset().length().total_cmp(&b.offset().length()));
        let counts: Vec<usize> = places.par_iter().map(|p| served(*p)).collect();
        let mut best = (centre, Place::default());
        for (place, count) in places.into_iter().zip(counts) {
            if count > best.0 {
                best = (count, place);
            }
        }
        best.1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::voxel::{BitGrid, Frame};

    fn part() -> Aabb {
        Aabb { min: DVec3::new(-10.0, -20.0, 0.0), max: DVec3::new(10.0, 20.0, 30.0) }
    }

    #[test]
    fn the_centre_is_kept_where_it_serves_and_left_where_it_does_not() {
        let mut machine = Machine::builtin("5xm600").unwrap();
        assert!(machine.find_place(part(), DVec3::ZERO).is_centre());
        // The gantry reaches no farther than x = 0: only the other half of the table serves.
        machine.kinematics.x.limits_mm = [-300.0, 0.0];
        machine.kinematics.second.limits_deg = Some([-1.0, 1.0]);
        let place = machine.find_place(part(), DVec3::ZERO);
        assert!(place.x_mm < 0.0, "{place:?}");
        let reached = |place| {
            let mut m = machine.clone();
            m.workholding.place = place;
            let placement = m.placement(&Holding::AS_CLAMPED, DVec3::ZERO);
            let tips = corners(part());
            m.posture(&placement, Direction::Z, m.kinematics.home(), &m.tools[0], &tips)
        };
        assert!(reached(place).is_ok());
        let refused = reached(Place::default()).unwrap_err().to_string();
        assert!(refused.contains("axis X would go to 10.000 mm"), "{refused}");
    }

    #[test]
    fn the_table_stays_where_it_is_when_the_part_moves() {
        let frame = Frame { pitch: 1.0, dims: [4, 4, 4], origin: DVec3::ZERO };
        let state = BitGrid::from_fn([4, 4, 4], |_| true);
        let mut machine = Machine::builtin("mx220").unwrap();
        machine.workholding.table = Table::Box { x_mm: 40.0, y_mm: 20.0 };
        machine.workholding.place = Place { x_mm: 7.0, y_mm: -3.0, angle_deg: 30.0 };
        for up in [Direction::Z, Direction::X, Direction::NEG_Y] {
            let holding =
                Holding { up, height_mm: if up == Direction::NEG_Y { -4.0 } else { 0.0 } };
            let contact = holding.contact(&state, &frame, 1.0);
            let n = contact.count() as f64;
            let center = contact.iter_ones().map(|v| frame.center(v)).sum::<DVec3>() / n;
            let points = machine.workholding.obstacle_points(&holding, &contact, &frame);
            let map = machine.placement(&holding, center).machine_from_work;
            let table = DVec3::from_array(machine.kinematics.table_center_mm);
            let flat: Vec<DVec3> = points
                .iter()
                .map(|p| map.transform_point3(*p) - table)
                .filter(|p| p.z.abs() < 1e-9)
                .collect();
            assert_eq!(flat.len(), 21 * 11);
            assert!(flat.iter().all(|p| p.x.abs() < 20.001 && p.y.abs() < 10.001));
        }
    }

    #[test]
    fn a_place_beside_the_table_is_refused() {
        let text = include_str!("presets/mx220.toml");
        let at = |place: &str| {
            let with = format!("[workholding]\nplace = {place}");
            Machine::parse("my.toml", &text.replacen("[workholding]", &with, 1))
        };
        assert_eq!(at("{ x_mm = 10.0 }").unwrap().workholding.place.x_mm, 10.0);
        for (place, says) in [
            ("{ x_mm = 1000.0 }", "not on the table"),
            ("{ y_mm = nan }", "not on the table"),
            ("{ angle_deg = 400.0 }", "between -360 and 360"),
            ("{ z_mm = 1.0 }", "unknown field"),
        ] {
            let said = at(place).unwrap_err().to_string();
            assert!(said.contains(says), "{said}");
        }
    }
}
