//! Whether the linear axes reach: limits hold for the spindle nose, so a longer tool needs more z.

use super::kinematics::{AxisValues, Chain, RotaryAngles};
use super::orient::Unreachable;
use super::placement::Placement;
use crate::base::{Aabb, DVec3, Direction};

/// An axis would leave its limits.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "axis {axis} would go to {value:.3} {unit}, {overtravel:.3} beyond its limit of {limit:.3}; \
     move the part, take a shorter tool or another direction",
    unit = unit(.axis)
)]
pub struct Overtravel {
    /// X, Y, Z, or the letter of a rotary (then the figures are degrees).
    pub axis: char,
    /// What the motion needs: position of the spindle nose in mm, or an angle in degrees.
    pub value: f64,
    pub limit: f64,
    /// How far beyond the limit.
    pub overtravel: f64,
}

fn unit(axis: &char) -> &'static str {
    if matches!(axis, 'X' | 'Y' | 'Z') { "mm (spindle nose)" } else { "degrees" }
}

/// Why no posture serves.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum NoPosture {
    #[error(transparent)]
    Unreachable(#[from] Unreachable),
    #[error(transparent)]
    Overtravel(#[from] Overtravel),
}

/// How far over a limit a position may lie and still count as at it, mm: rounding of the
/// kinematics, far below what an axis resolves.
const ROUNDING_MM: f64 = 1e-6;

impl Chain {
    /// Whether programmed axis values of a tool of gauge length `gauge_mm` stay within all limits.
    /// Returns the worst violation.
    pub fn check_axes(&self, axes: AxisValues, gauge_mm: f64) -> Result<(), Overtravel> {
        for (rotary, angle) in [(&self.first, axes.first_deg), (&self.second, axes.second_deg)] {
            if !rotary.allows(angle) || !angle.is_finite() {
                let [low, high] = rotary.limits_deg.unwrap_or([angle, angle]);
                return Err(Overtravel::of(rotary.letter, angle, [low, high]));
            }
        }
        let nose = axes.linear() + DVec3::Z * gauge_mm;
        let mut worst: Option<Overtravel> = None;
        for (letter, axis, value) in
            [('X', self.x, nose.x), ('Y', self.y, nose.y), ('Z', self.z, nose.z)]
        {
            let [low, high] = axis.limits_mm;
            if (low - ROUNDING_MM..=high + ROUNDING_MM).contains(&value) {
                continue;
            }
            let found = Overtravel::of(letter, value, [low, high]);
            if worst.is_none_or(|w| found.worse_than(&w)) {
                worst = Some(found);
            }
        }
        worst.map_or(Ok(()), Err)
    }

    /// Whether the tips (work coordinates, mm) can all be reached in one posture. Returns the
    /// worst violation. No tips are always within reach.
    pub fn check_travel(
        &self,
        placement: &Placement,
        rotary: RotaryAngles,
        gauge_mm: f64,
        tips: &[DVec3],
    ) -> Result<(), Overtravel> {
        let indexed = self.indexed(placement, rotary, gauge_mm);
        let mut worst: Option<Overtravel> = None;
        for tip in tips {
            if let Err(found) = self.check_axes(indexed.axes(*tip), gauge_mm)
                && worst.is_none_or(|w| found.worse_than(&w))
            {
                worst = Some(found);
            }
        }
        worst.map_or(Ok(()), Err)
    }

    /// As [`Chain::check_travel`] for every point of a box of tips in work coordinates: within
    /// one posture the axes move linearly with the tip, so the corners decide.
    pub fn check_travel_box(
        &self,
        placement: &Placement,
        rotary: RotaryAngles,
        gauge_mm: f64,
        tips: Aabb,
    ) -> Result<(), Overtravel> {
        if tips.is_empty() {
            return Ok(());
        }
        self.check_travel(placement, rotary, gauge_mm, &corners(tips))
    }

    /// The posture nearest to `previous` in which the tool points along `d` and all `tips` (work
    /// coordinates, mm) are within travel.
    pub fn posture(
        &self,
        placement: &Placement,
        d: Direction,
        previous: RotaryAngles,
        gauge_mm: f64,
        tips: &[DVec3],
    ) -> Result<RotaryAngles, NoPosture> {
        let mut refused: Option<Overtravel> = None;
        for rotary in self.nearest_first(placement, d, previous) {
            match self.check_travel(placement, rotary, gauge_mm, tips) {
                Ok(()) => return Ok(rotary),
                Err(found) => {
                    refused = Some(refused.map_or(found, |r| r.lesser(found)));
                }
            }
        }
        Err(refused.map_or(self.unreachable(d).into(), NoPosture::from))
    }
}

impl Overtravel {
    fn of(axis: char, value: f64, [low, high]: [f64; 2]) -> Overtravel {
        let limit = if value < low { low } else { high };
        Overtravel { axis, value, limit, overtravel: (value - limit).abs() }
    }

    /// A figure that is no number is worse than any other.
    fn worse_than(&self, other: &Overtravel) -> bool {
        self.overtravel.is_nan() || self.overtravel > other.overtravel
    }

    fn lesser(self, other: Overtravel) -> Overtravel {
        if self.worse_than(&other) { other } else { self }
    }
}

/// The eight corners of a box.
pub(super) fn corners(b: Aabb) -> [DVec3; 8] {
    std::array::from_fn(|i| {
        let pick = |bit: usize, low: f64, high: f64| if i >> bit & 1 == 0 { low } else { high };
        DVec3::new(pick(0, b.min.x, b.max.x), pick(1, b.min.y, b.max.y), pick(2, b.min.z, b.max.z))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::machine::{Holding, Machine};

    #[test]
    fn the_worst_axis_is_named_with_its_figures() {
        let machine = Machine::builtin("mx220").unwrap();
        let placement = machine.placement(&Holding::AS_CLAMPED, DVec3::ZERO);
        let chain = &machine.kinematics;
        let check = |tips: &[DVec3], gauge| {
            chain.check_travel(&placement, RotaryAngles::default(), gauge, tips)
        };
        assert_eq!(check(&[], 55.0), Ok(()));
        assert_eq!(check(&[DVec3::new(110.0, -60.0, 0.0)], 55.0), Ok(()));
        let found = check(&[DVec3::new(111.0, 0.0, 0.0), DVec3::new(0.0, -64.0, 0.0)], 55.0);
        let worst = Overtravel { axis: 'Y', value: -64.0, limit: -60.0, overtravel: 4.0 };
        assert_eq!(found, Err(worst));
        // The nose: pedestal 45 + tip 100 + gauge 95 is the limit of 240 exactly, 96 is above it.
        assert_eq!(check(&[DVec3::Z * 100.0], 95.0), Ok(()));
        let found = check(&[DVec3::Z * 100.0], 96.0).unwrap_err();
        assert_eq!((found.axis, found.limit), ('Z', 240.0));
        assert!(found.to_string().contains("1.000 beyond its limit of 240.000"), "{found}");
        assert!(check(&[DVec3::NAN], 55.0).is_err());
    }

    #[test]
    fn angles_are_checked_too() {
        let chain = Machine::builtin("mx220").unwrap().kinematics;
        let at = |first_deg| {
            let rotary = RotaryAngles { first_deg, second_deg: 1e4 };
            chain.check_axes(AxisValues::new(DVec3::ZERO, rotary), 55.0)
        };
        assert_eq!(at(-95.0), Ok(()));
        assert!(at(96.0).unwrap_err().to_string().starts_with("axis A would go to 96.000 degrees"));
        assert!(at(f64::NAN).is_err());
    }

    #[test]
    fn a_box_is_within_travel_exactly_when_its_points_are() {
        let machine = Machine::builtin("mx220").unwrap();
        let placement = machine.placement(&Holding::AS_CLAMPED, DVec3::ZERO);
        let rotary = RotaryAngles { first_deg: 50.0, second_deg: 33.0 };
        let chain = &machine.kinematics;
        for edge in [10.0, 40.0, 60.0, 90.0, 150.0] {
            let tips = Aabb { min: DVec3::new(-edge, -edge, 0.0), max: DVec3::splat(edge) };
            let inside: Vec<DVec3> = (0..11 * 11 * 11)
                .map(|i| DVec3::new((i % 11) as f64, (i / 11 % 11) as f64, (i / 121) as f64))
                .map(|v| tips.min + tips.size() * v / 10.0)
                .collect();
            let whole = chain.check_travel_box(&placement, rotary, 55.0, tips);
            let each = chain.check_travel(&placement, rotary, 55.0, &inside);
            assert_eq!(whole.is_ok(), each.is_ok(), "{edge}");
        }
        assert_eq!(chain.check_travel_box(&placement, rotary, 55.0, Aabb::EMPTY), Ok(()));
    }

    #[test]
    fn the_other_posture_serves_when_the_nearest_overtravels() {
        let mut machine = Machine::builtin("5xm600").unwrap();
        let placement = machine.placement(&Holding::AS_CLAMPED, DVec3::ZERO);
        let chain = &mut machine.kinematics;
        let tips = [DVec3::new(0.0, 0.0, 30.0)];
        let find =
            |chain: &Chain| chain.posture(&placement, Direction::X, chain.home(), 80.0, &tips);
        assert_eq!(find(chain).unwrap().first_deg, 90.0);
        // B = 90 needs x = 150, B = −90 needs x = −150.
        chain.x.limits_mm = [-300.0, 140.0];
        assert_eq!(find(chain).unwrap().first_deg, -90.0);
        chain.x.limits_mm = [-145.0, 140.0];
        let refused = find(chain).unwrap_err();
        assert!(matches!(refused, NoPosture::Overtravel(o) if o.axis == 'X' && o.limit == -145.0));
        chain.first.limits_deg = Some([-80.0, 80.0]);
        assert!(matches!(find(chain), Err(NoPosture::Unreachable(_))));
    }
}
