//! Lines that fill the inside of a layer.
//!
//! Every pattern lays `density` · area/width of line, so that beads of that width cover the share
//! of the area the process asks for.

use super::polygons::{clip_lines, of_paths, offset, simple};
use super::slice::Outline;
use crate::base::DVec2;
use crate::machine::Pattern;
use clipper2_rust::PathsD;
use std::f64::consts::{PI, TAU};

/// A bead's centre line in (u, v); closed lines repeat their first point.
pub(super) type Line = Vec<DVec2>;

/// What to fill with.
#[derive(Clone, Copy)]
pub(super) struct Fill {
    pub pattern: Pattern,
    /// Width of a bead, mm.
    pub width: f64,
    /// Share of the area that beads cover.
    pub density: f64,
    /// Number of the layer, and the height of its middle, mm.
    pub layer: usize,
    pub z: f64,
}

/// Lines over the inside of the outlines; they may end on them.
pub(super) fn fill(inside: &PathsD, f: &Fill) -> Vec<Line> {
    if inside.is_empty() || f.density <= 0.0 {
        return Vec::new();
    }
    let spacing = f.width / f.density.min(1.0);
    match f.pattern {
        Pattern::Rectilinear => {
            hatch(&of_paths(inside), spacing, !f.layer.is_multiple_of(2), f.width / 2.0)
        }
        Pattern::Concentric => concentric(inside, spacing, f.width),
        Pattern::Gyroid => gyroid(inside, f),
    }
}

/// Parallel lines `spacing` apart inside the outlines (even–odd), along v when `turned`, else
/// along u; pieces shorter than `shortest` are left out.
pub(super) fn hatch(outlines: &[Outline], spacing: f64, turned: bool, shortest: f64) -> Vec<Line> {
    let swap = |p: DVec2| if turned { DVec2::new(p.y, p.x) } else { p };
    let ys = outlines.iter().flatten().map(|p| swap(*p).y);
    let (low, high) = ys.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), y| (a.min(y), b.max(y)));
    if low >= high {
        return Vec::new();
    }
    // Multiples of the spacing from the plane's origin: lines of every second layer coincide.
    let (first, last) = ((low / spacing).ceil() as i64, (high / spacing).floor() as i64);
    let mut crossings: Vec<Vec<f64>> = vec![Vec::new(); (last - first + 1).max(0) as usize];
    for o in outlines {
        for i in 0..o.len() {
            let (a, b) = (swap(o[i]), swap(o[(i + 1) % o.len()]));
            let (a, b) = if a.y <= b.y { (a, b) } else { (b, a) };
            // Half-open in y, so that a vertex is crossed once.
            let mut k = ((a.y / spacing).ceil() as i64).max(first);
            while k <= last && (k as f64 * spacing) < b.y {
                let t = (k as f64 * spacing - a.y) / (b.y - a.y);
                crossings[(k - first) as usize].push(a.x + t * (b.x - a.x));
                k += 1;
            }
        }
    }
    let mut lines = Vec::new();
    for (k, mut xs) in crossings.into_iter().enumerate() {
        let y = (first + k as i64) as f64 * spacing;
        xs.sort_by(f64::total_cmp);
        for pair in xs.chunks_exact(2).filter(|p| p[1] - p[0] >= shortest) {
            lines.push(vec![swap(DVec2::new(pair[0], y)), swap(DVec2::new(pair[1], y))]);
        }
    }
    lines
}

/// Loops parallel to the outline, the first half a spacing inside it.
fn concentric(inside: &PathsD, spacing: f64, width: f64) -> Vec<Line> {
    // Rings are offset one from the other; without dropping points in between they would multiply.
    let eps = 0.01 * width;
    let mut lines = Vec::new();
    let mut ring = simple(&offset(inside, -spacing / 2.0), eps);
    while !ring.is_empty() {
        for mut line in of_paths(&ring).into_iter().filter(|l| l.len() >= 3) {
            line.push(line[0]);
            lines.push(line);
        }
        ring = simple(&offset(&ring, -spacing), eps);
    }
    lines
}

/// Surface of the gyroid in one period's cube, in squares of the period.
const GYROID_AREA: f64 = 3.0915;

/// Steps of a gyroid's level line in one period: the chord then leaves the line by less than a
/// hundredth of the period.
const GYROID_STEPS: f64 = 24.0;

/// Level lines of sin x cos y + sin y cos z + sin z cos x = 0 at the layer's height.
///
/// A surface of area S in a volume cuts a plane in lines of length (π/4) S per volume on average,
/// so a period of (π/4) · 3.0915 · width/density lays the density.
fn gyroid(inside: &PathsD, f: &Fill) -> Vec<Line> {
    let period = PI / 4.0 * GYROID_AREA * f.width / f.density.min(1.0);
    let k = TAU / period;
    let all = of_paths(inside);
    let (lo, hi) = all
        .iter()
        .flatten()
        .fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(a, b), p| (a.min(*p), b.max(*p)));
    let step = period / GYROID_STEPS;
    let (sz, cz) = (k * f.z).sin_cos();
    // Where |sin z| is large the lines run along one axis, else along the other: solve for it.
    let along_u = sz.abs() <= cz.abs();
    let (lo, hi) = if along_u { (lo, hi) } else { (swapped(lo), swapped(hi)) };
    // For fixed a the left side is A sin(k b) + B cos(k b) + C, with |C| ≤ √(A² + B²).
    let coefficients = |a: f64| {
        let (s, c) = (k * a).sin_cos();
        if along_u { (cz, s, sz * c) } else { (c, sz, s * cz) }
    };
    // A line strays by less than a period from where it starts.
    let first = (lo.y / period).floor() as i64 - 2;
    let last = (hi.y / period).ceil() as i64 + 2;
    let n = ((hi.x - lo.x) / step).ceil().max(1.0) as usize;
    let mut lines = Vec::new();
    for half in 0..2 {
        let zero = |a: f64| {
            let (sine, cosine, free) = coefficients(a);
            let angle = (-free / sine.hypot(cosine)).clamp(-1.0, 1.0).asin();
            let angle = if half == 0 { angle } else { PI - angle };
            (angle - cosine.atan2(sine)) / k
        };
        for row in first..=last {
            let mut line: Line = Vec::new();
            let mut before: Option<f64> = None;
            for i in 0..=n {
                let a = lo.x + (hi.x - lo.x) * i as f64 / n as f64;
                let b = zero(a);
                // Unwrap: the same branch as at the last step.
                let b = match before {
                    Some(c) => b + ((c - b) / period).round() * period,
                    None => b + period * row as f64,
                };
                before = Some(b);
                let p = DVec2::new(a, b);
                line.push(if along_u { p } else { swapped(p) });
            }
            lines.push(line);
        }
    }
    lines.retain(|l| l.len() >= 2);
    let mut inside_lines = clip_lines(&lines, inside);
    inside_lines.retain(|l| length(l) >= f.width / 2.0);
    inside_lines
}

fn swapped(p: DVec2) -> DVec2 {
    DVec2::new(p.y, p.x)
}

/// Length of a line, mm.
pub(super) fn length(line: &Line) -> f64 {
    line.windows(2).map(|w| w[0].distance(w[1])).sum()
}

#[cfg(test)]
mod tests {
    use super::super::polygons::to_paths;
    use super::*;

    fn square(a: f64, b: f64) -> Outline {
        vec![DVec2::new(a, a), DVec2::new(b, a), DVec2::new(b, b), DVec2::new(a, b)]
    }

    #[test]
    fn hatching_fills_a_frame_with_pairs() {
        let hole: Outline = square(3.0, 7.0).into_iter().rev().collect();
        let lines = hatch(&[square(0.0, 10.0), hole], 1.5, false, 0.1);
        let total: f64 = lines.iter().map(length).sum();
        // 7 lines of 10 mm (0, 1.5 … 9), of which 3, 4.5 and 6 lose 4 mm to the hole.
        assert!((total - (70.0 - 12.0)).abs() < 1e-9, "{total}");
    }

    #[test]
    fn every_pattern_lays_its_density_inside_the_outline() {
        let hole: Outline = square(20.0, 30.0).into_iter().rev().collect();
        let inside = to_paths(&[square(0.0, 60.0), hole]);
        let area = 3600.0 - 100.0;
        for pattern in [Pattern::Rectilinear, Pattern::Gyroid, Pattern::Concentric] {
            for density in [0.15, 0.3, 0.6] {
                let mut laid = 0.0;
                for layer in 0..40 {
                    let z = 0.1 + 0.2 * layer as f64;
                    let lines = fill(&inside, &Fill { pattern, width: 0.5, density, layer, z });
                    laid += lines.iter().map(length).sum::<f64>() / 40.0;
                    for p in lines.iter().flatten() {
                        let out = p.min_element() < -1e-3 || p.max_element() > 60.001;
                        let hole = p.cmpgt(DVec2::splat(20.001)).all()
                            && p.cmplt(DVec2::splat(29.999)).all();
                        assert!(!out && !hole, "{pattern:?} leaves at {p}");
                    }
                }
                let share = laid * 0.5 / area;
                assert!((share / density - 1.0).abs() < 0.08, "{pattern:?} {density}: {share}");
            }
        }
    }

    #[test]
    fn a_gyroid_lies_on_its_surface() {
        let inside = to_paths(&[square(0.0, 30.0)]);
        for z in [0.1, 0.9, 1.7, 2.3] {
            let f = Fill { pattern: Pattern::Gyroid, width: 0.5, density: 0.3, layer: 0, z };
            let k = TAU / (PI / 4.0 * GYROID_AREA * f.width / f.density);
            let lines = fill(&inside, &f);
            assert!(!lines.is_empty());
            for p in lines.iter().flat_map(|l| &l[1..l.len() - 1]) {
                let (u, v, w) = (k * p.x, k * p.y, k * z);
                let value = u.sin() * v.cos() + v.sin() * w.cos() + w.sin() * u.cos();
                assert!(value.abs() < 0.01, "{value} at {p}, {z}");
            }
        }
    }
}
