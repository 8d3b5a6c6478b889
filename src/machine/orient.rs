//! Which rotary angles point the tool along a direction: the inverse of the rotary axes.
//!
//! Whatever body the two rotaries are on, the condition R_h z = R_t w (w the direction in machine
//! coordinates) has the form R(a, α) p = R(b, β) q with known axes a, b and unit vectors p, q.
//! Both sides are one unit vector x with a · x = a · p and b · x = b · q: two planes and the unit
//! sphere meet in two points, one or none. Then α turns p to x and β turns q to x. This is
//! the second of the Paden–Kahan subproblems.

use super::kinematics::{Chain, Mount, PARALLEL_SINE, Rotary, RotaryAngles};
use super::placement::Placement;
use crate::base::{DVec3, Direction};

/// No angles within the limits point the tool along the direction.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "{} the tool along ({:.6}, {:.6}, {:.6}); choose another direction or holding",
    nothing_points(*.first, *.second),
    .direction.vec().x, .direction.vec().y, .direction.vec().z
)]
pub struct Unreachable {
    pub direction: Direction,
    pub first: char,
    pub second: char,
}

fn nothing_points(first: char, second: char) -> String {
    let axes: Vec<String> =
        [first, second].into_iter().filter(|l| *l != Rotary::ABSENT).map(String::from).collect();
    match &axes[..] {
        [] => "without rotary axes nothing points".into(),
        [one] => format!("no {one} within the limits points"),
        _ => format!("no {} within the limits point", axes.join(" and ")),
    }
}

/// Below this sine a vector lies on a rotary axis and the angle about it is free. Larger values
/// would treat directions apart as one; smaller ones would take an angle out of rounding noise.
const SINGULAR_SINE: f64 = 1e-9;

/// Largest negative square that counts as rounding of zero: two planes that touch the sphere.
const TANGENT_SQUARE: f64 = 1e-14;

/// Angles of one branch in degrees; `None` where any angle does.
#[derive(Clone, Copy, Debug)]
struct Branch {
    alpha: Option<f64>,
    beta: Option<f64>,
}

/// R(a, α) p = R(b, β) q.
fn common_vector(a: DVec3, p: DVec3, b: DVec3, q: DVec3) -> Vec<Branch> {
    let k = a.dot(b);
    let normal = a.cross(b);
    let sine = normal.length();
    if sine < SINGULAR_SINE {
        return Vec::new();
    }
    // x in the basis a, e₁ = part of b across a, e₂ = a × e₁. The square of the part of x across
    // a is |a × p|²; taking it from the cross product keeps its digits where p nears a.
    let e1 = (b - a * k) / sine;
    let e2 = normal / sine;
    let across = a.cross(p).length();
    let c1 = (b.dot(q) - k * a.dot(p)) / sine;
    let square = (across - c1) * (across + c1);
    if square < -TANGENT_SQUARE {
        return Vec::new();
    }
    let c2 = square.max(0.0).sqrt();
    let signs: &[f64] = if c2 < SINGULAR_SINE { &[0.0] } else { &[1.0, -1.0] };
    signs
        .iter()
        .map(|sign| {
            let x = a * a.dot(p) + e1 * c1 + e2 * (sign * c2);
            Branch { alpha: turn_deg(a, p, x), beta: turn_deg(b, q, x) }
        })
        .collect()
}

/// The angle about `axis` that turns `from` to `to`; `None` when `from` lies on the axis.
fn turn_deg(axis: DVec3, from: DVec3, to: DVec3) -> Option<f64> {
    let from_across = from - axis * axis.dot(from);
    let to_across = to - axis * axis.dot(to);
    if from_across.length() < SINGULAR_SINE {
        return None;
    }
    let angle = axis.dot(from_across.cross(to_across)).atan2(from_across.dot(to_across));
    // −0° and 0° are the same posture and must print the same.
    Some(angle.to_degrees() + 0.0)
}

impl Chain {
    fn branches(&self, placement: &Placement, d: Direction) -> Vec<[Option<f64>; 2]> {
        let w = placement.machine_from_work.transform_vector3(d.vec()).normalize();
        let (one, two) = (self.first.axis.vec(), self.second.axis.vec());
        let neg = |angle: Option<f64>| angle.map(|a| 0.0 - a);
        match (self.first.on, self.second.on) {
            // R₁ R₂ w = z  ⇔  R₂(θ₂) w = R₁(−θ₁) z
            (Mount::Table, Mount::Table) => common_vector(two, w, one, DVec3::Z)
                .into_iter()
                .map(|b| [neg(b.beta), b.alpha])
                .collect(),
            // R₂(θ₂) w = R₁(θ₁) z
            (Mount::Head, Mount::Table) => common_vector(two, w, one, DVec3::Z)
                .into_iter()
                .map(|b| [b.beta, b.alpha])
                .collect(),
            (Mount::Table, Mount::Head) => common_vector(one, w, two, DVec3::Z)
                .into_iter()
                .map(|b| [b.alpha, b.beta])
                .collect(),
            // w = R₁ R₂ z  ⇔  R₁(−θ₁) w = R₂(θ₂) z
            (Mount::Head, Mount::Head) => common_vector(one, w, two, DVec3::Z)
                .into_iter()
                .map(|b| [neg(b.alpha), b.beta])
                .collect(),
        }
    }

    /// As [`Chain::solutions`], but nearest to `previous` first, whole turns and free axes chosen
    /// by it as well.
    pub fn nearest_first(
        &self,
        placement: &Placement,
        d: Direction,
        previous: RotaryAngles,
    ) -> Vec<RotaryAngles> {
        let pick = |axis: &Rotary, angle: Option<f64>, previous: f64| match angle {
            Some(angle) => axis.turn_nearest(angle, previous),
            None => Some(axis.free_nearest(previous)),
        };
        let mut found: Vec<RotaryAngles> = self
            .branches(placement, d)
            .into_iter()
            .filter_map(|[first, second]| {
                Some(RotaryAngles {
                    first_deg: pick(&self.first, first, previous.first_deg)?,
                    second_deg: pick(&self.second, second, previous.second_deg)?,
                })
            })
            .filter(|angles| self.spans(*angles))
            .collect();
        found.sort_by(|a, b| {
            let key = |s: &RotaryAngles| self.turning_cost(previous, *s);
            let ((ta, sa, fa), (tb, sb, fb)) = (key(a), key(b));
            ta.total_cmp(&tb).then(sa.total_cmp(&sb)).then(fb.total_cmp(&fa))
        });
        found
    }

    /// Minutes both axes need at rapid rate, their summed turning, and the first angle, rounded so
    /// that mirror-image postures tie: less is nearer, and of ties the larger first angle wins.
    fn turning_cost(&self, from: RotaryAngles, to: RotaryAngles) -> (f64, f64, f64) {
        let round = |v: f64| (v * 1e6).round();
        let first = (to.first_deg - from.first_deg).abs();
        let second = (to.second_deg - from.second_deg).abs();
        let minutes = (first / self.first.rapid_deg_min).max(second / self.second.rapid_deg_min);
        (round(minutes), round(first + second), round(to.first_deg))
    }

    /// All postures within the limits that point the tool along `d` (work coordinates), at most
    /// one a branch, nearest to home first. An axis that `d` leaves free stays at home.
    pub fn solutions(&self, placement: &Placement, d: Direction) -> Vec<RotaryAngles> {
        self.nearest_first(placement, d, self.home())
    }

    /// The posture of `d` that takes the least turning time from `previous`; an axis that `d`
    /// leaves free stays where it is.
    pub fn nearest(
        &self,
        placement: &Placement,
        d: Direction,
        previous: RotaryAngles,
    ) -> Result<RotaryAngles, Unreachable> {
        let found = self.nearest_first(placement, d, previous);
        found.first().copied().ok_or(self.unreachable(d))
    }

    /// Whether the two axes can turn a tool two ways: `Err` says what stands against it.
    pub(super) fn orientable(&self) -> Result<(), String> {
        let (one, two) = (&self.first, &self.second);
        if one.axis.vec().cross(two.axis.vec()).length() < PARALLEL_SINE {
            return Err("the two rotary axes are parallel; the tool cannot turn two ways".into());
        }
        // The axis next to the tool, or the table axis farthest from the work, must tilt it.
        let tilting = if two.on == Mount::Head { two } else { one };
        if tilting.axis.vec().cross(DVec3::Z).length() < PARALLEL_SINE {
            return Err(format!(
                "axis {} turns about the tool itself (z) and never tilts it; for two axes on one \
                 body, first is the one that carries second",
                tilting.letter
            ));
        }
        Ok(())
    }

    pub(super) fn unreachable(&self, direction: Direction) -> Unreachable {
        Unreachable { direction, first: self.first.letter, second: self.second.letter }
    }

    /// Where the rotary axes park.
    pub fn home(&self) -> RotaryAngles {
        RotaryAngles { first_deg: self.first.home_deg, second_deg: self.second.home_deg }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::machine::Machine;

    fn tilted(sin_x: f64, cos_z: f64) -> Direction {
        Direction::new(DVec3::new(sin_x, 0.0, cos_z)).unwrap()
    }

    fn upright() -> Placement {
        Placement::turned(Direction::Z)
    }

    #[test]
    fn both_postures_are_found_and_the_limits_leave_one() {
        let mut machine = Machine::builtin("generic-5axis").unwrap();
        let d = tilted(1.0, 1.0);
        let found = machine.solutions(&upright(), d);
        let angles: Vec<_> =
            found.iter().map(|r| (r.first_deg.round(), r.second_deg.round())).collect();
        assert_eq!(angles, [(45.0, 90.0), (-45.0, -90.0)]);
        machine.kinematics.first.limits_deg = Some([-110.0, 5.0]);
        assert_eq!(machine.solutions(&upright(), d).len(), 1);
        machine.kinematics.first.limits_deg = Some([-5.0, 5.0]);
        assert!(!machine.can_point(Direction::Z, d));
        let said = machine.nearest(&upright(), d, Default::default()).unwrap_err().to_string();
        assert!(said.contains("no A and C") && said.contains("0.707107"), "{said}");
    }

    #[test]
    fn along_the_turning_axis_the_table_stays_where_it_is() {
        for name in Machine::builtin_names() {
            let machine = Machine::builtin(name).unwrap();
            let previous = RotaryAngles { first_deg: 20.0, second_deg: 123.0 };
            let found = machine.nearest(&upright(), Direction::Z, previous).unwrap();
            assert_eq!(found, RotaryAngles { first_deg: 0.0, second_deg: 123.0 });
            let home = machine.solutions(&upright(), Direction::Z);
            assert_eq!(home, [machine.kinematics.home()]);
        }
    }

    #[test]
    fn the_nearest_posture_counts_whole_turns_and_keeps_to_the_limits() {
        let mut machine = Machine::builtin("generic-5axis").unwrap();
        let d = tilted(1.0, 1.0);
        let previous = RotaryAngles { first_deg: 40.0, second_deg: 700.0 };
        let near = |m: &Machine| {
            let found = m.nearest(&upright(), d, previous).unwrap();
            (found.first_deg.round(), found.second_deg.round())
        };
        // 90° + 2 turns is 110° away; the other posture −90° + 2 turns = 630° only 70°, but A
        // then needs 85° at half the rate: 85/3600 > 110/7200 minutes.
        assert_eq!(near(&machine), (45.0, 810.0));
        machine.kinematics.first.rapid_deg_min = 36_000.0;
        assert_eq!(near(&machine), (-45.0, 630.0));
        machine.kinematics.second.limits_deg = Some([0.0, 360.0]);
        assert_eq!(near(&machine), (-45.0, 270.0));
        machine.kinematics.second.limits_deg = Some([-100.0, 100.0]);
        assert_eq!(near(&machine), (45.0, 90.0));
    }

    #[test]
    fn what_can_be_pointed_at_is_the_cap_of_the_tilting_axis() {
        let machine = Machine::builtin("generic-5axis").unwrap();
        for up in [Direction::Z, Direction::NEG_Y] {
            for d in crate::base::fibonacci_sphere(2000) {
                let tilt = up.dot(d.vec()).clamp(-1.0, 1.0).acos().to_degrees();
                assert_eq!(machine.can_point(up, d), tilt <= 110.0, "{tilt}");
            }
        }
        // At the limit itself the rounding of the inverse does not decide.
        for turn in 0..360 {
            let (s, c) = f64::from(turn).to_radians().sin_cos();
            let (sin, cos) = 110f64.to_radians().sin_cos();
            let d = Direction::new(DVec3::new(s * sin, c * sin, cos)).unwrap();
            assert!(machine.can_point(Direction::Z, d), "{turn}");
        }
    }
}
