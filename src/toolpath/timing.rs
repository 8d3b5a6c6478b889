//! Time that motion takes when the machine accelerates.
//!
//! Method: trapezoids of speed with one acceleration along the path, looked ahead over all legs. A
//! corner is taken at the speed at which an arc that leaves it by [`CORNER_MM`] at most needs no
//! more than that acceleration across: v² = a δ s/(1 − s), s the sine of half the angle between
//! the legs. That is what grbl and its heirs do; others differ by a few per cent.
//!
//! Guarantees: never less than length over speed. Not guaranteed: jerk limits, unequal axes.

use crate::base::DVec3;

/// How far a corner may be rounded in time, mm: grbl's default. At zero every corner is a stop;
/// at a tenth of a millimetre corners would be cut visibly.
const CORNER_MM: f64 = 0.01;

/// One straight piece of motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Leg {
    /// mm.
    pub by: DVec3,
    /// Programmed speed, mm/s.
    pub speed: f64,
    /// Whether the machine stands still before it.
    pub stops: bool,
}

/// Seconds from rest to rest over a length (mm or degrees) at a speed and acceleration per second.
pub fn rest_to_rest(length: f64, speed: f64, acceleration: f64) -> f64 {
    ramped(length, 0.0, 0.0, speed, acceleration)
}

/// Seconds that a run of legs takes, from rest to rest; acceleration in mm/s².
pub fn motion_s(legs: &[Leg], acceleration: f64) -> f64 {
    let legs: Vec<(f64, Leg)> = legs
        .iter()
        .map(|l| (l.by.length(), *l))
        .filter(|(n, l)| *n > 0.0 && l.speed > 0.0)
        .collect();
    // Squares of the speeds at the beginning of each leg, and at the end of the last.
    let mut entry = vec![0.0f64; legs.len() + 1];
    for i in 1..legs.len() {
        let ((_, a), (_, b)) = (legs[i - 1], legs[i]);
        let most = a.speed.min(b.speed).powi(2);
        entry[i] = if b.stops { 0.0 } else { most.min(corner(a.by, b.by, acceleration)) };
    }
    for i in (0..legs.len()).rev() {
        entry[i] = entry[i].min(entry[i + 1] + 2.0 * acceleration * legs[i].0);
    }
    for i in 0..legs.len() {
        entry[i + 1] = entry[i + 1].min(entry[i] + 2.0 * acceleration * legs[i].0);
    }
    let seconds = |(i, (n, l)): (usize, &(f64, Leg))| {
        ramped(*n, entry[i].sqrt(), entry[i + 1].sqrt(), l.speed, acceleration)
    };
    legs.iter().enumerate().map(seconds).sum()
}

/// Square of the speed at which the corner between two legs is taken.
fn corner(a: DVec3, b: DVec3, acceleration: f64) -> f64 {
    let cos = -a.dot(b) / (a.length() * b.length());
    let half_sine = (0.5 * (1.0 - cos)).max(0.0).sqrt();
    if half_sine >= 1.0 - 1e-9 {
        return f64::INFINITY;
    }
    acceleration * CORNER_MM * half_sine / (1.0 - half_sine)
}

/// Seconds over `length` from speed `v0` to `v1`, no faster than `speed`; both are reachable.
fn ramped(length: f64, v0: f64, v1: f64, speed: f64, acceleration: f64) -> f64 {
    if length <= 0.0 || speed <= 0.0 {
        return 0.0;
    }
    let squares = v0 * v0 + v1 * v1;
    let top = (acceleration * length + squares / 2.0).sqrt().min(speed);
    let ramps = (2.0 * top * top - squares) / (2.0 * acceleration);
    ((2.0 * top - v0 - v1) / acceleration) + (length - ramps).max(0.0) / top
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn leg(x: f64, y: f64, speed: f64) -> Leg {
        Leg { by: DVec3::new(x, y, 0.0), speed, stops: false }
    }

    #[test]
    fn one_move_is_a_trapezoid_or_a_triangle() {
        // 20 mm/s at 500 mm/s²: 0.04 s and 0.4 mm at either end.
        assert!((rest_to_rest(10.0, 20.0, 500.0) - (0.08 + 9.2 / 20.0)).abs() < 1e-12);
        // Too short to get there: two ramps of √(L/a) each.
        assert!((rest_to_rest(0.2, 20.0, 500.0) - 2.0 * (0.2f64 / 500.0).sqrt()).abs() < 1e-12);
        assert_eq!(motion_s(&[], 500.0), 0.0);
    }

    #[test]
    fn a_straight_run_cut_in_pieces_takes_as_long_as_whole() {
        let whole = motion_s(&[leg(10.0, 0.0, 20.0)], 500.0);
        let pieces = motion_s(&[leg(0.01, 0.0, 20.0); 1000], 500.0);
        assert!((whole - pieces).abs() < 1e-9, "{whole} {pieces}");
    }

    #[test]
    fn corners_and_stops_cost_time() {
        let straight = motion_s(&[leg(10.0, 0.0, 20.0), leg(10.0, 0.0, 20.0)], 500.0);
        let square = motion_s(&[leg(10.0, 0.0, 20.0), leg(0.0, 10.0, 20.0)], 500.0);
        let back = motion_s(&[leg(10.0, 0.0, 20.0), leg(-10.0, 0.0, 20.0)], 500.0);
        let stops = Leg { stops: true, ..leg(10.0, 0.0, 20.0) };
        assert!(straight < square && square < back);
        assert!((back - 2.0 * rest_to_rest(10.0, 20.0, 500.0)).abs() < 1e-9);
        assert!((motion_s(&[leg(10.0, 0.0, 20.0), stops], 500.0) - back).abs() < 1e-9);
        // v² = 500 · 0.01 · s/(1 − s) with s = sin 45°.
        let v = (5.0 * 0.5f64.sqrt() / (1.0 - 0.5f64.sqrt())).sqrt();
        let one = ramped(10.0, 0.0, v, 20.0, 500.0);
        assert!((square - 2.0 * one).abs() < 1e-9);
    }

    proptest! {
        #[test]
        fn never_faster_than_the_feed_nor_slower_than_stopping_everywhere(
            legs in proptest::collection::vec((-20f64..20.0, -20f64..20.0, 1f64..100.0), 1..40),
        ) {
            let legs: Vec<Leg> = legs.into_iter().map(|(x, y, v)| leg(x, y, v)).collect();
            let least: f64 = legs.iter().map(|l| l.by.length() / l.speed).sum();
            let most: f64 =
                legs.iter().map(|l| rest_to_rest(l.by.length(), l.speed, 500.0)).sum();
            let t = motion_s(&legs, 500.0);
            prop_assert!(t >= least - 1e-9 && t <= most + 1e-9, "{least} {t} {most}");
        }
    }
}
