//! Kinematic chains of machines with three linear axes and up to two rotary ones.
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
//! That is for linear axes that carry the head square before any rotary; others are in [`Linear`].
//!
//! A rotary axis that a machine does not have is one that stands at 0 for good: a chain always has
//! two, and all that follows holds for it. Files leave it out, and programs never name it.
//!
//! Guarantees: forward ∘ inverse is the identity to 10⁻⁹ mm. Not guaranteed: nothing here knows
//! obstacles; that a pose is free of collision is decided elsewhere.

use super::joints::Linear;
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
    /// The word that commands it: A, B or C; [`Rotary::ABSENT`] of an axis that is not there.
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

/// Three linear axes and two rotary ones, one or both of which may be absent.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(from = "Written", into = "Written")]
pub struct Chain {
    /// Centre of the table's surface with all axes at zero, machine coordinates, mm.
    pub table_center_mm: [f64; 3],
    pub x: Linear,
    pub y: Linear,
    pub z: Linear,
    /// The rotary nearest the machine's frame, when both are on the same body.
    pub first: Rotary,
    pub second: Rotary,
}

/// A chain as files have it.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(rename = "Chain", deny_unknown_fields)]
struct Written {
    /// Centre of the table's surface with all axes at zero, machine coordinates, mm.
    #[serde(default)]
    table_center_mm: [f64; 3],
    x: Linear,
    y: Linear,
    z: Linear,
    /// The rotary nearest the machine's frame, when both are on the same body. A machine of four axes
    /// has one rotary, one of three none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    first: Option<Rotary>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    second: Option<Rotary>,
}

impl From<Written> for Chain {
    fn from(written: Written) -> Chain {
        let Written { table_center_mm, x, y, z, first, second } = written;
        let turns_about_z = |r: &Rotary| r.axis.vec().cross(DVec3::Z).length() < PARALLEL_SINE;
        let (first, second) = match (first, second) {
            (Some(first), Some(second)) => (first, second),
            // A turntable under a tool that nothing tilts.
            (Some(one), None) | (None, Some(one)) if turns_about_z(&one) => {
                (Rotary::absent(Direction::X), one)
            }
            (Some(one), None) | (None, Some(one)) => (one, Rotary::absent(Direction::Z)),
            (None, None) => (Rotary::absent(Direction::X), Rotary::absent(Direction::Z)),
        };
        Chain { table_center_mm, x, y, z, first, second }
    }
}

impl From<Chain> for Written {
    fn from(chain: Chain) -> Written {
        let Chain { table_center_mm, x, y, z, first, second } = chain;
        let there = |r: Rotary| (!r.is_absent()).then_some(r);
        Written { table_center_mm, x, y, z, first: there(first), second: there(second) }
    }
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
pub(super) fn sin_cos_deg(angle_deg: f64) -> (f64, f64) {
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
    /// Letter of an axis that is not there; no file and no program can name it.
    pub const ABSENT: char = '-';

    /// An axis that a machine does not have.
    fn absent(axis: Direction) -> Rotary {
        Rotary {
            letter: Rotary::ABSENT,
            on: Mount::Table,
            axis,
            pivot_mm: [0.0; 3],
            limits_deg: Some([0.0, 0.0]),
            home_deg: 0.0,
            rapid_deg_min: default_rotary_rapid(),
        }
    }

    pub fn is_absent(&self) -> bool {
        self.letter == Rotary::ABSENT
    }

    /// Rotation of the carried body (Rodrigues).
    pub(super) fn rotation(&self, angle_deg: f64) -> DMat3 {
        let (s, c) = sin_cos_deg(angle_deg);
        let k = self.axis.vec();
        let column = |e: DVec3| e * c + k.cross(e) * s + k * (k.dot(e) * (1.0 - c));
        DMat3::from_cols(column(DVec3::X), column(DVec3::Y), column(DVec3::Z))
    }

    /// Motion of the carried body: the rotation about the axis through its pivot.
    pub(super) fn motion(&self, angle_deg: f64) -> DAffine3 {
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
        (least <= most).then(|| (angle_deg + 360.0 * turn.clamp(least, most)).max(low).min(high))
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

/// Axes this nearly parallel turn the tool one way only; 1° still resolves.
pub(super) const PARALLEL_SINE: f64 = 0.017;

impl Chain {
    /// The rotary axes that are there.
    pub fn rotary_axes(&self) -> impl Iterator<Item = &Rotary> {
        [&self.first, &self.second].into_iter().filter(|r| !r.is_absent())
    }

    fn motion_of(&self, body: Mount, rotary: RotaryAngles) -> DAffine3 {
        self.rotaries(rotary)
            .filter(|(axis, _)| axis.on == body)
            .fold(DAffine3::IDENTITY, |m, (axis, angle)| m * axis.motion(angle))
    }

    /// Both rotaries with their angles, the carrying one first.
    pub(super) fn rotaries(&self, angles: RotaryAngles) -> impl Iterator<Item = (&Rotary, f64)> {
        [(&self.first, angles.first_deg), (&self.second, angles.second_deg)].into_iter()
    }

    /// Where the tip stands relative to the programmed X Y Z for a tool of this gauge length.
    fn tip_from_program(&self, rotary: RotaryAngles, gauge_mm: f64) -> DVec3 {
        let tip_at_home = DVec3::Z * -gauge_mm;
        self.motion_of(Mount::Head, rotary).transform_point3(tip_at_home) - tip_at_home
    }

    /// Where a point of the work is in machine coordinates with the rotaries at these angles and
    /// linear axes of the table at zero.
    pub fn machine_point(
        &self,
        placement: &Placement,
        rotary: RotaryAngles,
        work_point: DVec3,
    ) -> DVec3 {
        self.machine_from_work(placement, rotary).transform_point3(work_point)
    }

    /// The work's frame in machine coordinates, likewise.
    pub fn machine_from_work(&self, placement: &Placement, rotary: RotaryAngles) -> DAffine3 {
        self.motion_of(Mount::Table, rotary) * placement.machine_from_work
    }

    /// The chain with its rotaries at rest, for all that goes on between two turns of them. The
    /// tool's gauge length is in mm.
    pub fn indexed(
        &self,
        placement: &Placement,
        rotary: RotaryAngles,
        gauge_mm: f64,
    ) -> Indexed<'_> {
        let machine_from_work = self.machine_from_work(placement, rotary);
        let work_from_machine = machine_from_work.inverse();
        let spindle = self.motion_of(Mount::Head, rotary).transform_vector3(DVec3::Z);
        let direction = Direction::new(work_from_machine.transform_vector3(spindle));
        Indexed {
            chain: self,
            placement: *placement,
            rotary,
            gauge_mm,
            machine_from_work,
            work_from_machine,
            tip_from_program: self.tip_from_program(rotary, gauge_mm),
            // A rotation of z is never zero; only angles that are not finite get here, and they
            // are refused by every limit check.
            direction: direction.unwrap_or(Direction::Z),
        }
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
        self.indexed(placement, rotary, gauge_mm).axes(tip)
    }

    /// The forward map: tip (work coordinates, mm) and tool axis for programmed axis values.
    pub fn tip(
        &self,
        placement: &Placement,
        axes: AxisValues,
        gauge_mm: f64,
    ) -> (DVec3, Direction) {
        let indexed = self.indexed(placement, axes.rotary(), gauge_mm);
        indexed.tip(axes.linear())
    }
}

/// A chain with its rotaries at rest; what follows from their angles alone is worked out once.
#[derive(Clone, Copy, Debug)]
pub struct Indexed<'a> {
    chain: &'a Chain,
    placement: Placement,
    rotary: RotaryAngles,
    gauge_mm: f64,
    machine_from_work: DAffine3,
    work_from_machine: DAffine3,
    tip_from_program: DVec3,
    /// Of a chain with three linear axes.
    direction: Direction,
}

impl Indexed<'_> {
    /// Whether this is the chain with its rotaries at `rotary` and a tool of this gauge length.
    pub fn is_at(&self, rotary: RotaryAngles, gauge_mm: f64) -> bool {
        self.rotary == rotary && self.gauge_mm == gauge_mm
    }

    /// See [`Chain::axes`].
    pub fn axes(&self, tip: DVec3) -> AxisValues {
        if !self.chain.is_cartesian() {
            let nose = self.chain.nose(&self.placement, self.rotary, tip, self.gauge_mm);
            return AxisValues::new(nose - DVec3::Z * self.gauge_mm, self.rotary);
        }
        let machine_tip = self.machine_from_work.transform_point3(tip);
        AxisValues::new(machine_tip - self.tip_from_program, self.rotary)
    }

    /// See [`Chain::tip`]; the linear axes' values.
    pub fn tip(&self, linear: DVec3) -> (DVec3, Direction) {
        if !self.chain.is_cartesian() {
            let nose = linear + DVec3::Z * self.gauge_mm;
            let (tip, way) =
                self.chain.tip_of_nose(&self.placement, self.rotary, nose, self.gauge_mm);
            return (tip, Direction::new(way).unwrap_or(Direction::Z));
        }
        let machine_tip = linear + self.tip_from_program;
        (self.work_from_machine.transform_point3(machine_tip), self.direction)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::fibonacci_sphere;
    use crate::machine::{Holding, Machine};
    use proptest::prelude::*;

    /// All three arrangements, and one whose axes are neither square nor through the centre.
    fn chains() -> Vec<Machine> {
        let mut machines: Vec<Machine> =
            Machine::builtin_names().iter().map(|n| Machine::builtin(n).unwrap()).collect();
        let mut head_head = machines[0].clone();
        head_head.name = "head-head".into();
        let axis = |letter, axis, pivot_mm| Rotary {
            letter,
            on: Mount::Head,
            axis,
            pivot_mm,
            limits_deg: Some([-200.0, 200.0]),
            home_deg: 0.0,
            rapid_deg_min: 3600.0,
        };
        head_head.kinematics.first = axis('C', Direction::Z, [0.0, 0.0, 0.0]);
        head_head.kinematics.second = axis('B', Direction::Y, [5.0, 0.0, 120.0]);
        let mut nutating = machines[0].clone();
        nutating.name = "nutating".into();
        let tilted = Direction::new(DVec3::new(0.1, 1.0, 1.0)).unwrap();
        nutating.kinematics.first =
            Rotary { on: Mount::Table, ..axis('B', tilted, [3.0, -20.0, 9.0]) };
        nutating.kinematics.second.pivot_mm = [0.5, 0.25, 0.0];
        machines.extend([head_head, nutating]);
        machines
    }

    fn angle_between(a: Direction, b: Direction) -> f64 {
        a.vec().cross(b.vec()).length().atan2(a.dot(b.vec()))
    }

    /// Tip and direction come back from the axis values of every posture.
    fn round_trip(machine: &Machine, holding: &Holding, d: Direction, tip: DVec3, gauge: f64) {
        let placement = machine.placement(holding, DVec3::new(12.0, -7.0, 3.0));
        let chain = &machine.kinematics;
        let found = machine.solutions(&placement, d);
        assert!(found.len() <= 2);
        assert_eq!(found.is_empty(), !machine.can_point(holding.up, d));
        for rotary in found {
            let axes = chain.axes(&placement, rotary, tip, gauge);
            let (again, pointed) = chain.tip(&placement, axes, gauge);
            assert!((again - tip).length() < 1e-9, "{}: {tip} came back as {again}", machine.name);
            // Near the rim of the reachable cone the angle follows the square root of rounding.
            assert!(angle_between(pointed, d) < 1e-7, "{}: {d:?} {pointed:?}", machine.name);
            assert!(chain.first.allows(rotary.first_deg));
            assert!(chain.second.allows(rotary.second_deg));
        }
    }

    const UPS: [Direction; 6] = [
        Direction::Z,
        Direction::NEG_Z,
        Direction::X,
        Direction::NEG_X,
        Direction::Y,
        Direction::NEG_Y,
    ];

    #[test]
    fn forward_undoes_inverse_in_ten_thousand_directions_on_every_machine() {
        for machine in chains() {
            for (i, d) in fibonacci_sphere(10_000).into_iter().enumerate() {
                let holding = Holding { up: UPS[i % 6], height_mm: 4.0 };
                let tip = DVec3::new((i % 211) as f64, -((i % 97) as f64), (i % 31) as f64);
                round_trip(&machine, &holding, d, tip, 60.0);
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(200))]
        #[test]
        fn forward_undoes_inverse(
            v in prop::array::uniform3(-1.0f64..1.0), p in prop::array::uniform3(-200.0f64..200.0),
            gauge in 0.0f64..300.0, up in 0usize..6, height_mm in -50.0f64..50.0,
        ) {
            let d = Direction::new(DVec3::from_array(v)).unwrap_or(Direction::Z);
            for machine in chains() {
                round_trip(&machine, &Holding { up: UPS[up], height_mm }, d, p.into(), gauge);
            }
        }
    }

    #[test]
    fn grid_axes_and_directions_nearly_along_an_axis_come_back() {
        let tiny = [0.0, 1e-12, 1e-10, 1e-8, 1e-6, 1e-3];
        for machine in chains() {
            for up in UPS {
                let holding = Holding { up, height_mm: 0.0 };
                for d in UPS {
                    for t in tiny {
                        let near = Direction::new(d.vec() + DVec3::new(t, -2.0 * t, t)).unwrap();
                        round_trip(&machine, &holding, near, DVec3::new(1.0, 2.0, 30.0), 50.0);
                    }
                }
            }
        }
    }

    fn pose(name: &str, d: [f64; 3], tip: [f64; 3]) -> AxisValues {
        let machine = Machine::builtin(name).unwrap();
        let placement = machine.placement(&Holding::AS_CLAMPED, DVec3::ZERO);
        let d = Direction::new(DVec3::from_array(d)).unwrap();
        let rotary = machine.nearest(&placement, d, RotaryAngles::default()).unwrap();
        machine.kinematics.axes(&placement, rotary, DVec3::from_array(tip), 60.0)
    }

    fn assert_pose(found: AxisValues, x: f64, y: f64, z: f64, first: f64, second: f64) {
        let want = [x, y, z, first, second];
        let have = [found.x, found.y, found.z, found.first_deg, found.second_deg];
        for (a, b) in want.iter().zip(have) {
            assert!((a - b).abs() < 1e-9, "{have:?} instead of {want:?}");
        }
    }

    #[test]
    fn poses_computed_by_hand() {
        // mx220: pedestal 45, tilting axis 60 above the table. Upright nothing turns.
        assert_pose(pose("mx220", [0.0, 0.0, 1.0], [1.0, 2.0, 10.0]), 1.0, 2.0, 55.0, 0.0, 0.0);
        // From −y: A = 90 turns the table by −90° about x: (x, y, z) → (x, z, −y) about z = 60.
        // (1, 2, 10 + 45 − 60 = −5) → (1, −5, −2) → z = 60 − 2.
        assert_pose(pose("mx220", [0.0, -1.0, 0.0], [1.0, 2.0, 10.0]), 1.0, -5.0, 58.0, 90.0, 0.0);
        // From +x: of A ±90 the larger; C = 90 turns the table by −90° about z: (x, y) → (y, −x):
        // (1, 2) → (2, −1), then as above (2, −1, −5) → (2, −5, 1).
        assert_pose(pose("mx220", [1.0, 0.0, 0.0], [1.0, 2.0, 10.0]), 2.0, -5.0, 61.0, 90.0, 90.0);
        // generic: pedestal 90, tilting axis 50 above the table. (0, 0, 110 − 50 = 60) → (0, 60, 0).
        let found = pose("generic-5axis", [0.0, -1.0, 0.0], [0.0, 0.0, 20.0]);
        assert_pose(found, 0.0, 60.0, 50.0, 90.0, 0.0);
        // Half way: A = 45 turns (0, 60) by −45° about x: y = 60 sin 45°, z = 50 + 60 cos 45°.
        let found = pose("generic-5axis", [0.0, -1.0, 1.0], [0.0, 0.0, 20.0]);
        let half = 60.0 * 0.5f64.sqrt();
        assert_pose(found, 0.0, half, 50.0 + half, 45.0, 0.0);
        // 5xm600: head, pivot 70 above the nose, gauge 60, so 130 from pivot to tip. From +x: B = 90
        // swings the tip from 130 below the pivot to 130 on its −x side; the programmed point is
        // where the tip stands at B = 0: 130 further in x and 130 lower in z.
        let found = pose("5xm600", [1.0, 0.0, 0.0], [1.0, 2.0, 10.0]);
        assert_pose(found, 131.0, 2.0, 110.0 - 130.0, 90.0, 0.0);
        // From +y: C = 90 turns the table by −90° about z: (1, 2) → (2, −1).
        let found = pose("5xm600", [0.0, 1.0, 0.0], [1.0, 2.0, 10.0]);
        assert_pose(found, 132.0, -1.0, 110.0 - 130.0, 90.0, 90.0);
    }

    /// The default machine without its rotary axes, or with one of them.
    fn with_rotaries(keep: &[&str]) -> Machine {
        let text = include_str!("presets/generic-5axis.toml");
        let (linear, rest) = text.split_once("[kinematics.first]").unwrap();
        let (first, rest) = rest.split_once("[kinematics.second]").unwrap();
        let (second, control) = rest.split_once("[control]").unwrap();
        let axes = keep.iter().map(|k| match *k {
            "A" => format!("[kinematics.first]{first}"),
            _ => format!("[kinematics.second]{second}"),
        });
        let text = format!("{linear}{}[control]{control}", axes.collect::<String>());
        Machine::parse("fewer.toml", &text).unwrap()
    }

    #[test]
    fn machines_of_three_and_four_axes_point_where_they_can() {
        for (keep, ways, there) in [
            (&[][..], 1, vec![Direction::Z]),
            (&["A"][..], 45, vec![Direction::Z, Direction::Y, Direction::NEG_Y]),
            (&["C"][..], 1, vec![Direction::Z]),
        ] {
            let machine = with_rotaries(keep);
            let chain = &machine.kinematics;
            assert_eq!(chain.rotary_axes().count(), keep.len());
            let sampled = machine.sampled(Direction::Z, 200);
            assert_eq!(sampled.len(), ways, "{keep:?}");
            assert!(sampled.iter().all(|d| machine.can_point(Direction::Z, *d)));
            for d in [Direction::Z, Direction::X, Direction::NEG_X, Direction::Y, Direction::NEG_Y]
            {
                assert_eq!(
                    machine.can_point(Direction::Z, d),
                    there.contains(&d),
                    "{keep:?} {d:?}"
                );
            }
            let placement = machine.placement(&Holding::AS_CLAMPED, DVec3::ZERO);
            for d in sampled {
                let angles = machine.nearest(&placement, d, chain.home()).unwrap();
                let tip = DVec3::new(3.0, -20.0, 17.0);
                let axes = chain.axes(&placement, angles, tip, 60.0);
                let (again, way) = chain.tip(&placement, axes, 60.0);
                assert!(again.distance(tip) < 1e-9 && way.vec().distance(d.vec()) < 1e-9);
                for r in [(&chain.first, angles.first_deg), (&chain.second, angles.second_deg)] {
                    assert!(!r.0.is_absent() || r.1 == 0.0);
                }
            }
            // What is not there is neither written nor asked for.
            let text = serde_json::to_string(&machine).unwrap();
            assert!(!text.contains("\"letter\":\"-\""));
            assert_eq!(serde_json::from_str::<Machine>(&text).unwrap(), machine);
        }
        let said = with_rotaries(&[]).nearest(
            &Placement::turned(Direction::Z),
            Direction::X,
            RotaryAngles::default(),
        );
        assert!(said.unwrap_err().to_string().starts_with("without rotary axes nothing points"));
        let said = with_rotaries(&["A"]).nearest(
            &Placement::turned(Direction::Z),
            Direction::X,
            RotaryAngles::default(),
        );
        assert!(said.unwrap_err().to_string().starts_with("no A within the limits points"));
    }
}
