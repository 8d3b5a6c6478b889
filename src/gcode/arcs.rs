//! Arcs in place of runs of short straight moves.
//!
//! Method: a run is taken as far as one circle through its first, middle and last point passes all of its
//! points and the middles of all its chords within [`ARC_MM`]. Guarantees: the arc deviates from the
//! run by no more; it turns one way, by less than half a turn. Not guaranteed: the fewest arcs.

use crate::base::DVec2;

/// How far an arc may lie from the straight moves it stands for, mm: with the chords' own 0.005 a
/// quarter of what paths may be off in all.
pub(super) const ARC_MM: f64 = 0.005;

/// Fewest moves that are worth an arc: two points lie on any circle.
const LEAST_MOVES: usize = 3;

/// Moves in one arc at most: the search is quadratic in it.
pub(super) const MOST_MOVES: usize = 200;

/// Radii of arcs, mm: controls round smaller ones away, larger ones are straight.
const RADII: (f64, f64) = (0.2, 500.0);

/// An arc from the first point of a run to its last.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Arc {
    /// Moves of the run that it stands for.
    pub moves: usize,
    pub center: DVec2,
    pub anticlockwise: bool,
    /// Length, mm.
    pub length: f64,
}

/// The longest arc that begins at the first of the points; none when a straight move is as good.
pub(super) fn fit(points: &[DVec2]) -> Option<Arc> {
    let mut best = None;
    for n in LEAST_MOVES..points.len().min(MOST_MOVES + 1) {
        match through(&points[..=n]) {
            Some(arc) => best = Some(arc),
            None => break,
        }
    }
    best
}

/// One circle through all of the points, if there is one.
fn through(points: &[DVec2]) -> Option<Arc> {
    let last = points.len() - 1;
    let (a, b, c) = (points[0], points[last / 2], points[last]);
    let (ab, ac) = (b - a, c - a);
    let twice = 2.0 * ab.perp_dot(ac);
    if twice.abs() < 1e-12 {
        return None;
    }
    let (lb, lc) = (ab.length_squared(), ac.length_squared());
    let center = a + DVec2::new(ac.y * lb - ab.y * lc, ab.x * lc - ac.x * lb) / twice;
    let radius = a.distance(center);
    if !(RADII.0..=RADII.1).contains(&radius) {
        return None;
    }
    let sense = twice.signum();
    let mut turned = 0.0;
    for w in points.windows(2) {
        let (p, q) = (w[0] - center, w[1] - center);
        let turn = sense * p.perp_dot(q).atan2(p.dot(q));
        let near = |r: DVec2| (r.length() - radius).abs() <= ARC_MM;
        if turn <= 0.0 || !near(q) || !near((p + q) / 2.0) {
            return None;
        }
        turned += turn;
    }
    (turned < std::f64::consts::PI * 0.99).then_some(Arc {
        moves: last,
        center,
        anticlockwise: sense > 0.0,
        length: turned * radius,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn circle(n: usize, radius: f64, step: f64) -> Vec<DVec2> {
        (0..n).map(|i| DVec2::from_angle(i as f64 * step) * radius + DVec2::new(3.0, 4.0)).collect()
    }

    #[test]
    fn points_of_a_circle_are_one_arc_and_others_none() {
        let points = circle(20, 5.0, 0.05);
        let arc = fit(&points).unwrap();
        assert_eq!(arc.moves, 19);
        assert!(arc.anticlockwise && arc.center.distance(DVec2::new(3.0, 4.0)) < 1e-6);
        assert!((arc.length - 0.95 * 5.0).abs() < 1e-6);
        let back: Vec<DVec2> = points.iter().rev().copied().collect();
        assert!(!fit(&back).unwrap().anticlockwise);
        // Chords whose middles lie 0.4 mm off the circle are a polygon, not an arc.
        assert_eq!(fit(&circle(5, 5.0, 0.8)), None);
        let straight: Vec<DVec2> = (0..9).map(|i| DVec2::new(f64::from(i), 0.0)).collect();
        assert_eq!(fit(&straight), None);
        assert_eq!(fit(&points[..3]), None);
    }

    #[test]
    fn an_arc_ends_where_the_run_leaves_it() {
        let mut points = circle(20, 5.0, 0.05);
        let last = points[19];
        points.extend((1..9).map(|i| last + DVec2::new(-0.3 * f64::from(i), 0.0)));
        let arc = fit(&points).unwrap();
        assert!((19..=20).contains(&arc.moves), "{arc:?}");
        // Never more than half a turn.
        let whole = circle(200, 5.0, 0.04);
        assert!(fit(&whole).unwrap().length < std::f64::consts::PI * 5.0);
    }
}
