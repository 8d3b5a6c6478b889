//! Kinematic chains of five-axis machines: three linear and two rotary axes.
//!
//! **Frames.** Machine coordinates are fixed to the frame of the machine, mm, z along the tool axis
//! of a head at zero. The work is carried by the rotaries mounted on the table, the tool by those
//! mounted on the head; of two on the same body the first carries the second. A rotary turns the
//! body it carries right-handed about its `axis` for growing angles. On a table, ISO 841 counts
//! the motion of the tool relative to the work, so such an axis has a vector like (−1, 0, 0).
//!
//! **Programmed positions.** X Y Z say where the tip stands when the head's rotaries are at zero;
//! that is what a control with tool length compensation along z and no rotary compensation does.
//! With L the gauge length (tip to spindle nose), T_t and T_h the table's and the head's motion,
//! and head pivots relative to the spindle nose,
//!
//! ```text
//! machine_tip = T_t(angles) · machine_from_work · work_tip            (the table carries the work)
//! machine_tip = XYZ + L z + T_h(angles) · (−L z)                      (the head carries the tool)
//! R_h z       = R_t · R_placement · d                                 (d: from the work to the spindle)
//! ```
//!
//! Guarantees: forward ∘ inverse is the identity to 10⁻⁹ mm. Not guaranteed: nothing here knows
//! obstacles; that a pose is free of collision is decided elsewhere.

use super::placement::Placement;
use crate::base::{DAffine3, DMat3, DVec3, Direction};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Which body a rotary axis carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Mount {
    Table,
    Head,
}

/// A rotary axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Rotary {
    /// The word that commands it: A, B or C.
    pub letter: char,
    pub on: Mount,
    /// Right-handed turning vector of the carried body, machine coordinates, all axes at zero.
    #[schemars(with = "[f64; 3]")]
    pub axis: Direction,
    /// A point on the axis with all axes at zero, mm: machine coordinates for a table, relative to
    /// the spindle nose for a head.
    pub pivot_mm: [f64; 3],
    /// Smallest and largest angle; without it the axis turns without end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub limits_deg: Option<[f64; 2]>,
    #[serde(default)]
    pub home_deg: f64,
    /// Rapid rate, degrees per minute.
    #[serde(default = "default_rotary_rapid")]
    pub rapid_deg_min: f64,
}

fn default_rotary_rapid() -> f64 {
    3600.0
}

/// A linear axis. Limits hold for the spindle nose while the head's rotaries stand at zero.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Linear {
    pub limits_mm: [f64; 2],
    /// Where the axis parks (spindle nose), mm.
    pub home_mm: f64,
}

/// Three linear axes and two rotary ones.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Chain {
    /// Centre of the table's surface with all axes at zero, machine coordinates, mm.
    #[serde(default)]
    pub table_center_mm: [f64; 3],
    pub x: Linear,
    pub y: Linear,
    pub z: Linear,
    /// The rotary nearest the machine's frame, when both are on the same body.
    pub first: Rotary,
    pub second: Rotary,
}

/// Angles of the two rotary axes, degrees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RotaryAngles {
    pub first_deg: f64,
    pub second_deg: f64,
}

/// Programmed axis values: mm and degrees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct AxisValues {
    pub x: f64,
    pub y: f64,
    pub z: f64,
    pub first_deg: f64,
    pub second_deg: f64,
}

impl AxisValues {
    pub fn new(xyz: DVec3, rotary: RotaryAngles) -> AxisValues {
        let RotaryAngles { first_deg, second_deg } = rotary;
        AxisValues { x: xyz.x, y: xyz.y, z: xyz.z, first_deg, second_deg }
    }

    pub fn linear(&self) -> DVec3 {
        DVec3::new(self.x, self.y, self.z)
    }

    pub fn rotary(&self) -> RotaryAngles {
        RotaryAngles { first_deg: self.first_deg, second_deg: self.second_deg }
    }
}

/// Sine and cosine of an angle in degrees, exact at the quarter turns, so that an indexed table
/// does not smear 10⁻¹⁷ over coordinates that are zero.
fn sin_cos_deg(angle_deg: f64) -> (f64, f64) {
    let turns = angle_deg.rem_euclid(360.0);
    match turns {
        0.0 => (0.0, 1.0),
        90.0 => (1.0, 0.0),
        180.0 => (0.0, -1.0),
        270.0 => (-1.0, 0.0),
        _ => turns.to_radians().sin_cos(),
    }
}

impl Rotary {
    /// Rotation of the carried body (Rodrigues).
    pub(super) fn rotation(&self, angle_deg: f64) -> DMat3 {
        let (s, c) = sin_cos_deg(angle_deg);
        let k = self.axis.vec();
        let column = |e: DVec3| e * c + k.cross(e) * s + k * (k.dot(e) * (1.0 - c));
        DMat3::from_cols(column(DVec3::X), column(DVec3::Y), column(DVec3::Z))
    }

    /// Motion of the carried body: the rotation about the axis through its pivot.
    fn motion(&self, angle_deg: f64) -> DAffine3 {
        let r = self.rotation(angle_deg);
        let pivot = DVec3::from_array(self.pivot_mm);
        DAffine3::from_mat3_translation(r, pivot - r * pivot)
    }

    /// Whether an angle lies within the limits.
    pub fn allows(&self, angle_deg: f64) -> bool {
        self.limits_deg.is_none_or(|[low, high]| {
            (low - ROUNDING_DEG..=high + ROUNDING_DEG).contains(&angle_deg)
        })
    }

    /// The angle equal to `angle_deg` up to whole turns that lies within the limits and nearest
    /// `previous_deg`.
    pub(super) fn turn_nearest(&self, angle_deg: f64, previous_deg: f64) -> Option<f64> {
        let turn = ((previous_deg - angle_deg) / 360.0).round();
        let Some([low, high]) = self.limits_deg else {
            return Some(angle_deg + 360.0 * turn);
        };
        let least = ((low - ROUNDING_DEG - angle_deg) / 360.0).ceil();
        let most = ((high + ROUNDING_DEG - angle_deg) / 360.0).floor();
        (least <= most).then(|| angle_deg + 360.0 * turn.clamp(least, most))
    }

    /// The angle within the limits nearest to `previous_deg`, when the axis is free to choose.
    pub(super) fn free_nearest(&self, previous_deg: f64) -> f64 {
        match self.limits_deg {
            Some([low, high]) => previous_deg.max(low).min(high),
            None => previous_deg,
        }
    }
}

/// How far over a limit an angle may lie and still count as at it, degrees: the rounding of the
/// inverse must not decide. Far below what an encoder resolves (0.001°).
pub(super) const ROUNDING_DEG: f64 = 1e-6;

impl Chain {
    fn motion_of(&self, body: Mount, rotary: RotaryAngles) -> DAffine3 {
        self.rotaries(rotary)
            .filter(|(axis, _)| axis.on == body)
            .fold(DAffine3::IDENTITY, |m, (axis, angle)| m * axis.motion(angle))
    }

    /// Both rotaries with their angles, the carrying one first.
    fn rotaries(&self, angles: RotaryAngles) -> impl Iterator<Item = (&Rotary, f64)> {
        [(&self.first, angles.first_deg), (&self.second, angles.second_deg)].into_iter()
    }

    /// Where the tip stands relative to the programmed X Y Z for a tool of this gauge length.
    fn tip_from_program(&self, rotary: RotaryAngles, gauge_mm: f64) -> DVec3 {
        let tip_at_home = DVec3::Z * -gauge_mm;
        self.motion_of(Mount::Head, rotary).transform_point3(tip_at_home) - tip_at_home
    }

    /// Where a point of the work is in machine coordinates with the rotaries at these angles.
    pub fn machine_point(
        &self,
        placement: &Placement,
        rotary: RotaryAngles,
        work_point: DVec3,
    ) -> DVec3 {
        self.machine_from_work(placement, rotary).transform_point3(work_point)
    }

    /// The work's frame in machine coordinates with the rotaries at these angles.
    pub fn machine_from_work(&self, placement: &Placement, rotary: RotaryAngles) -> DAffine3 {
        self.motion_of(Mount::Table, rotary) * placement.machine_from_work
    }

    /// Programmed axis values that put the tip of a tool of gauge length `gauge_mm` on `tip`
    /// (work coordinates, mm).
    pub fn axes(
        &self,
        placement: &Placement,
        rotary: RotaryAngles,
        tip: DVec3,
        gauge_mm: f64,
    ) -> AxisValues {
        let machine_tip = self.machine_point(placement, rotary, tip);
        AxisValues::new(machine_tip - self.tip_from_program(rotary, gauge_mm), rotary)
    }

    /// The forward map: tip (work coordinates, mm) and tool axis for programmed axis values.
    pub fn tip(
        &self,
        placement: &Placement,
        axes: AxisValues,
        gauge_mm: f64,
    ) -> (DVec3, Direction) {
        let rotary = axes.rotary();
        let machine_tip = axes.linear() + self.tip_from_program(rotary, gauge_mm);
        let work_from_machine = self.machine_from_work(placement, rotary).inverse();
        let spindle = self.motion_of(Mount::Head, rotary).transform_vector3(DVec3::Z);
        let direction = Direction::new(work_from_machine.transform_vector3(spindle));
        // A rotation of z is never zero; only angles that are not finite get here, and they are
        // refused by every limit check.
        (work_from_machine.transform_point3(machine_tip), direction.unwrap_or(Direction::Z))
    }
}
