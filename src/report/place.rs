use crate::base::{Aabb, DVec3};

/// Where a point lies in a box, as one would say it at the machine: "top, back left
/// (x 12.0, y 40.5, z 31.0 mm)". Left is −x, front is −y, seen from the operator's side.
pub fn in_words(p: DVec3, bounds: &Aabb) -> String {
    let t = (p - bounds.min) / bounds.size().max(DVec3::splat(f64::MIN_POSITIVE));
    let third = |t: f64, low: &'static str, high: &'static str| match t {
        t if t < 1.0 / 3.0 => Some(low),
        t if t > 2.0 / 3.0 => Some(high),
        _ => None,
    };
    let height = third(t.z, "bottom", "top").unwrap_or("middle");
    let side: Vec<&str> =
        [third(t.y, "front", "back"), third(t.x, "left", "right")].into_iter().flatten().collect();
    let side = if side.is_empty() { "centre".to_string() } else { side.join(" ") };
    format!("{height}, {side} (x {:.1}, y {:.1}, z {:.1} mm)", p.x, p.y, p.z)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corners_and_centre_have_their_names() {
        let b = Aabb { min: DVec3::ZERO, max: DVec3::new(30.0, 30.0, 60.0) };
        assert!(in_words(DVec3::new(1.0, 29.0, 59.0), &b).starts_with("top, back left ("));
        assert_eq!(
            in_words(DVec3::new(15.0, 15.0, 30.0), &b),
            "middle, centre (x 15.0, y 15.0, z 30.0 mm)"
        );
    }
}
