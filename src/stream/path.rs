//! How far a point is from where a program leads.

/// A point of the three linear axes, mm.
pub(super) type Point = [f64; 3];

pub(super) fn distance(a: Point, b: Point) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

/// Distance of a point from a straight line between two others.
pub(super) fn off_segment(p: Point, a: Point, b: Point) -> f64 {
    let along: Point = std::array::from_fn(|i| b[i] - a[i]);
    let square: f64 = along.iter().map(|v| v * v).sum();
    if square == 0.0 {
        return distance(p, a);
    }
    let t: f64 = (0..3).map(|i| (p[i] - a[i]) * along[i]).sum::<f64>() / square;
    distance(p, std::array::from_fn(|i| a[i] + t.clamp(0.0, 1.0) * along[i]))
}
