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
            if worst.is_none_or(|w| !(found.overtravel <= w.overtravel)) {
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
        let mut worst: Option<Overtravel> = None;
        for tip in tips {
            let axes = self.axes(placement, rotary, *tip, gauge_mm);
            if let Err(found) = self.check_axes(axes, gauge_mm)
                && worst.is_none_or(|w| !(found.overtravel <= w.overtravel))
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

    fn lesser(self, other: Overtravel) -> Overtravel {
        if other.overtravel < self.overtravel { other } else { self }
    }
}

/// The eight corners of a box.
pub(super) fn corners(b: Aabb) -> [DVec3; 8] {
    std::array::from_fn(|i| {
        let pick = |bit: usize, low: f64, high: f64| if i >> bit & 1 == 0 { low } else { high };
        DVec3::new(pick(0, b.min.x, b.max.x), pick(1, b.min.y, b.max.y), pick(2, b.min.z, b.max.z))
    })
}
