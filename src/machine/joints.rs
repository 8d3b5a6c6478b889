//! Linear axes: along any direction, on either body, before or behind the rotaries they share it with.
//!
//! With v the axis values, sᵢ the direction in which the tool moves relative to the work for growing vᵢ
//! while the rotaries stand at zero, and Rᵢ the turning of the rotaries that carry axis i,
//!
//! ```text
//! head:   nose moves by   Rᵢ sᵢ vᵢ            table:  work moves by  −Rᵢ sᵢ vᵢ
//! T_h(v, θ) · (−L z) = T_t(v, θ) · machine_from_work · work_tip       linear in v: J v = −gap
//! ```
//!
//! The columns of J are the Rᵢ sᵢ. Angles at which they lie in one plane are singular: the tip
//! cannot go every way, and such postures are no solutions. Tool lengths are compensated along Z:
//! the programmed word is v_z − L.

use super::kinematics::{Chain, Mount, RotaryAngles};
use super::placement::Placement;
use crate::base::{DAffine3, DMat3, DVec3, Direction};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A linear axis. Limits hold for the spindle nose while the head's rotaries stand at zero.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Linear {
    pub limits_mm: [f64; 2],
    /// Where the axis parks (spindle nose), mm.
    pub home_mm: f64,
    /// The body it moves.
    #[serde(default = "on_head", skip_serializing_if = "is_on_head")]
    pub on: Mount,
    /// The way the tool moves relative to the work for growing values, machine coordinates, all
    /// rotaries at zero; without it that of its letter.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(with = "Option<[f64; 3]>")]
    pub axis: Option<Direction>,
    /// How many of its body's rotaries stand between it and the machine's frame.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub carried_by: u8,
}

fn on_head() -> Mount {
    Mount::Head
}

fn is_on_head(on: &Mount) -> bool {
    *on == Mount::Head
}

fn is_zero(count: &u8) -> bool {
    *count == 0
}

/// Least volume that the directions of the three linear axes span. Below it a motion of a
/// millimetre asks an axis for fifty; 1 is square.
const LEAST_VOLUME: f64 = 0.02;

impl Chain {
    fn linears(&self) -> [(&Linear, DVec3); 3] {
        let of = |axis: &Linear, own: DVec3| axis.axis.map_or(own, |d| d.vec());
        [
            (&self.x, of(&self.x, DVec3::X)),
            (&self.y, of(&self.y, DVec3::Y)),
            (&self.z, of(&self.z, DVec3::Z)),
        ]
    }

    /// Whether X Y Z carry the head square, before any rotary: then they are coordinates.
    pub(super) fn is_cartesian(&self) -> bool {
        let plain = |a: &Linear, own: DVec3| {
            a.on == Mount::Head && a.carried_by == 0 && a.axis.is_none_or(|d| d.vec() == own)
        };
        let [x, y, z] = [(&self.x, DVec3::X), (&self.y, DVec3::Y), (&self.z, DVec3::Z)];
        plain(x.0, x.1) && plain(y.0, y.1) && plain(z.0, z.1)
    }

    /// Motion of a body with the linear axes at `v` (spindle nose).
    fn moved(&self, body: Mount, v: DVec3, angles: RotaryAngles) -> DAffine3 {
        let sign = if body == Mount::Head { 1.0 } else { -1.0 };
        let slide = |carried_by: u8| {
            let by = self.linears().iter().zip(v.to_array()).fold(DVec3::ZERO, |by, (l, v)| {
                let here = l.0.on == body && l.0.carried_by == carried_by;
                if here { by + l.1 * (sign * v) } else { by }
            });
            DAffine3::from_translation(by)
        };
        let mut motion = slide(0);
        let own = self.rotaries(angles).filter(|(axis, _)| axis.on == body);
        for (k, (axis, angle)) in own.enumerate() {
            motion = motion * axis.motion(angle) * slide(k as u8 + 1);
        }
        motion
    }

    /// The ways in which the tool moves relative to the work, one column an axis.
    fn slides(&self, angles: RotaryAngles) -> DMat3 {
        let columns = self.linears().map(|(axis, way)| {
            let own = self.rotaries(angles).filter(|(r, _)| r.on == axis.on && !r.is_absent());
            let carriers = own.take(usize::from(axis.carried_by));
            carriers.fold(DMat3::IDENTITY, |m, (r, angle)| m * r.rotation(angle)) * way
        });
        DMat3::from_cols(columns[0], columns[1], columns[2])
    }

    /// Whether the linear axes can move the tip every way with the rotaries at these angles.
    pub(super) fn spans(&self, angles: RotaryAngles) -> bool {
        self.is_cartesian() || self.slides(angles).determinant().abs() >= LEAST_VOLUME
    }

    /// What stands against the linear axes.
    pub(super) fn movable(&self) -> Result<(), (&'static str, String)> {
        for ((axis, _), key) in self.linears().into_iter().zip(["x", "y", "z"]) {
            let carriers = self.rotary_axes().filter(|r| r.on == axis.on);
            let (count, most) = (axis.carried_by, carriers.count());
            if usize::from(count) > most {
                let what = format!("carried_by = {count}, but its body has {most} rotary axes");
                return Err((key, what));
            }
        }
        if !self.spans(self.home()) {
            let what = "the three linear axes lie in one plane with the rotaries at home; turn one";
            return Err(("z", what.into()));
        }
        Ok(())
    }

    /// Axis values (spindle nose) that put the tip of a tool on a point of the work; not numbers
    /// where the posture is singular.
    pub(super) fn nose(
        &self,
        placement: &Placement,
        angles: RotaryAngles,
        tip: DVec3,
        gauge_mm: f64,
    ) -> DVec3 {
        if !self.spans(angles) {
            return DVec3::NAN;
        }
        let head = self.moved(Mount::Head, DVec3::ZERO, angles);
        let table = self.moved(Mount::Table, DVec3::ZERO, angles) * placement.machine_from_work;
        let gap = head.transform_point3(DVec3::Z * -gauge_mm) - table.transform_point3(tip);
        self.slides(angles).inverse() * -gap
    }

    /// The tip of a tool in work coordinates, and the way from it to the spindle.
    pub(super) fn tip_of_nose(
        &self,
        placement: &Placement,
        angles: RotaryAngles,
        nose: DVec3,
        gauge_mm: f64,
    ) -> (DVec3, DVec3) {
        let head = self.moved(Mount::Head, nose, angles);
        let table = self.moved(Mount::Table, nose, angles) * placement.machine_from_work;
        let work_from_machine = table.inverse();
        let tip = head.transform_point3(DVec3::Z * -gauge_mm);
        let spindle = work_from_machine.transform_vector3(head.transform_vector3(DVec3::Z));
        (work_from_machine.transform_point3(tip), spindle)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::fibonacci_sphere;
    use crate::machine::{Holding, Machine, Place, Rotary};

    fn direction(x: f64, y: f64, z: f64) -> Option<Direction> {
        Some(Direction::new(DVec3::new(x, y, z)).unwrap())
    }

    fn rotary(letter: char, on: Mount, axis: DVec3, pivot_mm: [f64; 3]) -> Rotary {
        let axis = Direction::new(axis).unwrap();
        let limits_deg = Some([-200.0, 200.0]);
        Rotary { letter, on, axis, pivot_mm, limits_deg, home_deg: 0.0, rapid_deg_min: 3600.0 }
    }

    /// One chain of each arrangement, its linear axes askew, on the table and behind rotaries.
    fn chains() -> Vec<Machine> {
        let base = Machine::builtin("generic-5axis").unwrap();
        let with = |name: &str, change: &dyn Fn(&mut Chain)| {
            let mut machine = Machine { name: name.into(), ..base.clone() };
            change(&mut machine.kinematics);
            machine
        };
        vec![
            with("table/table on a cross slide", &|c| {
                c.first = rotary('A', Mount::Table, DVec3::NEG_X, [0.0, 3.0, 60.0]);
                c.second = rotary('C', Mount::Table, DVec3::NEG_Z, [1.0, 0.0, 0.0]);
                c.x.on = Mount::Table;
                c.y.on = Mount::Table;
                c.y.axis = direction(0.1, 1.0, 0.0);
            }),
            with("table/table, x between the tables", &|c| {
                c.first = rotary('B', Mount::Table, DVec3::NEG_Y, [0.0, 0.0, 40.0]);
                c.second = rotary('C', Mount::Table, DVec3::NEG_Z, [0.0, 0.0, 0.0]);
                (c.x.on, c.x.carried_by) = (Mount::Table, 1);
            }),
            with("head/table with a quill", &|c| {
                c.first = rotary('B', Mount::Head, DVec3::Y, [0.0, 0.0, 70.0]);
                c.second = rotary('C', Mount::Table, DVec3::NEG_Z, [0.5, 0.25, 0.0]);
                c.z.carried_by = 1;
                c.y.on = Mount::Table;
            }),
            with("head/head on a slanted column", &|c| {
                c.first = rotary('C', Mount::Head, DVec3::Z, [0.0, 0.0, 0.0]);
                c.second = rotary('B', Mount::Head, DVec3::new(0.0, 1.0, 0.2), [5.0, 0.0, 120.0]);
                c.z.axis = direction(0.0, 0.3, 1.0);
                c.x.carried_by = 1;
            }),
        ]
    }

    #[test]
    fn forward_undoes_inverse_in_ten_thousand_directions_on_every_chain() {
        for mut machine in chains() {
            machine.workholding.place = Place { x_mm: 30.0, y_mm: -12.0, angle_deg: 25.0 };
            let (mut reached, mut pointed) = (0, 0);
            for (i, d) in fibonacci_sphere(10_000).into_iter().enumerate() {
                let holding = Holding { up: Direction::Z, height_mm: 4.0 };
                let placement = machine.placement(&holding, DVec3::new(12.0, -7.0, 3.0));
                let tip = DVec3::new((i % 211) as f64, -((i % 97) as f64), (i % 31) as f64);
                let chain = &machine.kinematics;
                let found = machine.solutions(&placement, d);
                reached += usize::from(!found.is_empty());
                for angles in found {
                    let axes = chain.axes(&placement, angles, tip, 60.0);
                    let (again, way) = chain.tip(&placement, axes, 60.0);
                    // Near a singular posture the axes go far, and their digits with them.
                    let far = axes.linear().length().max(1000.0) / 1000.0;
                    let off = (again - tip).length();
                    assert!(off < 1e-9 * far, "{}: {d:?} {off}", machine.name);
                    let turned = way.vec().cross(d.vec()).length();
                    assert!(turned < 1e-7 && way.dot(d.vec()) > 0.0, "{}", machine.name);
                }
                let all = Chain { z: base_z(), x: base_z(), y: base_z(), ..*chain };
                pointed += usize::from(!all.solutions(&placement, d).is_empty());
            }
            assert!(reached > 8_000 && reached <= pointed, "{}: {reached}", machine.name);
        }
    }

    fn base_z() -> Linear {
        Machine::builtin("generic-5axis").unwrap().kinematics.z
    }

    #[test]
    fn poses_by_hand_and_a_singular_one() {
        let [_, _, quill, _] = <[Machine; 4]>::try_from(chains()).unwrap();
        let chain = &quill.kinematics;
        let placement = Placement::turned(Direction::Z);
        // B = 90° lays the spindle along +x, its pivot 70 mm behind the nose: the nose stands at
        // (70, 0, 70), the tip 60 mm before it. The quill's z has become x.
        let angles = RotaryAngles { first_deg: 90.0, second_deg: 0.0 };
        assert!(!chain.spans(angles), "z along x leaves nothing to lift the tip");
        let angles = RotaryAngles { first_deg: -30.0, second_deg: 0.0 };
        let (sin, cos) = 30f64.to_radians().sin_cos();
        // With everything at zero the tip hangs 70 + 60 below the pivot at z = 70.
        let (tip, way) = chain.tip_of_nose(&placement, angles, DVec3::ZERO, 60.0);
        assert!((tip - DVec3::new(130.0 * sin, 0.0, 70.0 - 130.0 * cos)).length() < 1e-12, "{tip}");
        assert!((way - DVec3::new(-sin, 0.0, cos)).length() < 1e-12);
        // The quill drives along the spindle, y moves the work the other way.
        let (moved, _) = chain.tip_of_nose(&placement, angles, DVec3::new(1.0, 2.0, 3.0), 60.0);
        let by = DVec3::new(1.0 - 3.0 * sin, 2.0, 3.0 * cos);
        assert!((moved - tip - by).length() < 1e-12, "{moved}");
        // Level with the table the quill cannot lift: no solution.
        assert!(quill.solutions(&placement, Direction::X).is_empty());
        assert!(quill.can_point(Direction::Z, Direction::new(DVec3::new(1.0, 0.0, 0.5)).unwrap()));
    }

    #[test]
    fn presets_are_cartesian_and_go_the_same_way_either_way() {
        for name in Machine::builtin_names() {
            let machine = Machine::builtin(name).unwrap();
            let chain = &machine.kinematics;
            assert!(chain.is_cartesian());
            let placement = machine.placement(&Holding::AS_CLAMPED, DVec3::ZERO);
            for d in fibonacci_sphere(300) {
                for angles in machine.solutions(&placement, d) {
                    let tip = DVec3::new(3.0, -20.0, 17.0);
                    let axes = chain.axes(&placement, angles, tip, 60.0);
                    let nose = chain.nose(&placement, angles, tip, 60.0);
                    assert!((axes.linear() + DVec3::Z * 60.0 - nose).length() < 1e-9);
                }
            }
        }
    }

    #[test]
    fn profiles_may_put_their_linear_axes_anywhere() {
        let text = include_str!("presets/5xm600.toml");
        let z = "z = { limits_mm = [-50.0, 550.0], home_mm = 540.0";
        let y = "y = { limits_mm = [-300.0, 300.0], home_mm = 0.0";
        let quill = text.replacen(z, &format!("{z}, carried_by = 1"), 1).replacen(
            y,
            &format!("{y}, on = \"table\", axis = [0.0, 2.0, 0.1]"),
            1,
        );
        let machine = Machine::parse("quill.toml", &quill).unwrap();
        assert_eq!((machine.kinematics.z.carried_by, machine.kinematics.y.on), (1, Mount::Table));
        let again = toml::to_string(&machine).unwrap();
        assert_eq!(Machine::parse("again", &again).unwrap(), machine);
        for (bad, says) in [
            (text.replacen(z, &format!("{z}, carried_by = 2"), 1), "its body has 1 rotary axes"),
            (text.replacen(z, &format!("{z}, axis = [0.0, 1.0, 0.0]"), 1), "lie in one plane"),
            (text.replacen(z, &format!("{z}, on = \"floor\""), 1), "unknown variant `floor`"),
        ] {
            let said = Machine::parse("bad.toml", &bad).unwrap_err().to_string();
            assert!(said.contains(says), "{said}");
        }
    }
}
