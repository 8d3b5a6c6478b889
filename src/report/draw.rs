//! One drawing per step: the workpiece and the region that goes or comes, seen at an angle.
//!
//! Surface voxels are projected into a small depth image; slopes of the image shade it; equal
//! neighbours of a row become one stroke of an SVG path. No raster file, no script.

use crate::base::{DVec3, Direction};
use crate::plan::StepKind;
use crate::voxel::{BitGrid, Frame};
use rayon::prelude::*;
use std::fmt::Write as _;

/// Longer side of a drawing in cells: legible at 2 to 3 screen pixels a cell, and below 60 kB.
const CELLS: f64 = 170.0;
/// Shades of one colour. More make longer files; fewer make flat drawings.
const SHADES: usize = 6;
/// Half-width of a voxel's mark in pitches: a cube seen at an angle is 1.4 to 1.7 pitches wide.
const MARK: f64 = 0.8;

/// An SVG element and what it shows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Drawing {
    pub svg: String,
    /// The side it is seen from: "front left, above".
    pub view: &'static str,
}

/// Draws `stays` in grey and `region` in the colour of its kind, with an arrow along the tool's
/// way in. The view is the one of eight that shows most of the region; the first of equals.
pub fn draw_step(
    frame: &Frame,
    stays: &BitGrid,
    region: &BitGrid,
    kind: StepKind,
    direction: Direction,
) -> Drawing {
    let marks = Marks::of(frame, stays, region);
    let images: Vec<Image> = VIEWS.par_iter().map(|view| marks.image(view)).collect();
    let best =
        images.into_iter().reduce(|a, b| if b.region_cells() > a.region_cells() { b } else { a });
    match best {
        Some(image) => Drawing { svg: image.svg(kind, direction), view: image.view.name },
        None => Drawing { svg: String::new(), view: "" },
    }
}

struct View {
    name: &'static str,
    /// From the part toward the eye.
    eye: [f64; 3],
}

const VIEWS: [View; 8] = [
    View { name: "front left, above", eye: [-1.0, -1.6, 1.1] },
    View { name: "front right, above", eye: [1.0, -1.6, 1.1] },
    View { name: "back right, above", eye: [1.0, 1.6, 1.1] },
    View { name: "back left, above", eye: [-1.0, 1.6, 1.1] },
    View { name: "front left, below", eye: [-1.0, -1.6, -1.1] },
    View { name: "front right, below", eye: [1.0, -1.6, -1.1] },
    View { name: "back right, below", eye: [1.0, 1.6, -1.1] },
    View { name: "back left, below", eye: [-1.0, 1.6, -1.1] },
];

/// Centres of the surface voxels, and whether each is of the region.
struct Marks {
    points: Vec<(DVec3, bool)>,
    pitch: f64,
    /// Centre of the region, mm; of everything when the region is empty.
    focus: DVec3,
}

impl Marks {
    fn of(frame: &Frame, stays: &BitGrid, region: &BitGrid) -> Marks {
        let points: Vec<(DVec3, bool)> = stays
            .or(region)
            .boundary()
            .iter_ones()
            .map(|v| (frame.center(v), region.get(v)))
            .collect();
        let mean = |only: bool| {
            let (sum, n) = points
                .iter()
                .filter(|(_, r)| *r || !only)
                .fold((DVec3::ZERO, 0.0), |(s, n), (p, _)| (s + *p, n + 1.0));
            (n > 0.0).then(|| sum / n)
        };
        let focus = mean(true).or_else(|| mean(false)).unwrap_or(DVec3::ZERO);
        Marks { pitch: frame.pitch, focus, points }
    }

    fn image(&self, view: &'static View) -> Image {
        let toward = DVec3::from_array(view.eye).normalize();
        let right = DVec3::Z.cross(toward).normalize();
        let up = toward.cross(right);
        let flat = |p: DVec3| (right.dot(p), -up.dot(p));
        let (mut lo, mut hi) = ((f64::MAX, f64::MAX), (f64::MIN, f64::MIN));
        for (p, _) in &self.points {
            let (u, v) = flat(*p);
            lo = (lo.0.min(u), lo.1.min(v));
            hi = (hi.0.max(u), hi.1.max(v));
        }
        if self.points.is_empty() {
            (lo, hi) = ((0.0, 0.0), (0.0, 0.0));
        }
        let pad = 2.0 * self.pitch;
        let (wide, tall) = (hi.0 - lo.0 + 2.0 * pad, hi.1 - lo.1 + 2.0 * pad);
        let cell = (wide.max(tall) / CELLS).max(self.pitch);
        let size = [(wide / cell).ceil() as usize, (tall / cell).ceil() as usize];
        let mut image = Image {
            view,
            size,
            depth: vec![f64::NEG_INFINITY; size[0] * size[1]],
            region: vec![false; size[0] * size[1]],
            cell,
            origin: (lo.0 - pad, lo.1 - pad),
            axes: [right, up, toward],
            focus: self.focus,
        };
        self.points.iter().for_each(|(p, r)| image.mark(flat(*p), toward.dot(*p), *r, self.pitch));
        image
    }
}

struct Image {
    view: &'static View,
    size: [usize; 2],
    /// Height toward the eye, mm; −∞ where nothing is.
    depth: Vec<f64>,
    region: Vec<bool>,
    cell: f64,
    origin: (f64, f64),
    axes: [DVec3; 3],
    focus: DVec3,
}

impl Image {
    fn mark(&mut self, (u, v): (f64, f64), depth: f64, region: bool, pitch: f64) {
        // Cells whose centre lies within the mark, and always the one under it.
        let span = |x: f64, n: usize| {
            let at = x / self.cell - 0.5;
            let half = MARK * pitch / self.cell;
            let first = (at - half).ceil().min(at.round()).max(0.0) as usize;
            let last = (at + half).floor().max(at.round()).max(0.0) as usize;
            first..(last + 1).min(n)
        };
        let columns = span(u - self.origin.0, self.size[0]);
        for row in span(v - self.origin.1, self.size[1]) {
            for column in columns.clone() {
                let i = row * self.size[0] + column;
                if depth > self.depth[i] {
                    self.depth[i] = depth;
                    self.region[i] = region;
                }
            }
        }
    }

    fn region_cells(&self) -> usize {
        self.region.iter().filter(|r| **r).count()
    }

    /// Brightness 0..SHADES from the slope of the depth image.
    fn shade(&self, column: usize, row: usize) -> usize {
        // Two cells either way smooth the voxel staircase.
        const REACH: isize = 2;
        let here = self.depth[row * self.size[0] + column];
        let at = |dc: isize, dr: isize| {
            let (c, r) = (column as isize + dc, row as isize + dr);
            let inside =
                c >= 0 && r >= 0 && (c as usize) < self.size[0] && (r as usize) < self.size[1];
            let d = if inside {
                self.depth[r as usize * self.size[0] + c as usize]
            } else {
                f64::NEG_INFINITY
            };
            // Past an edge the slope is that of the near side.
            let step = 6.0 * self.cell;
            if (d - here).abs() <= step { d } else { here }
        };
        let run = 2.0 * REACH as f64 * self.cell;
        let du = (at(REACH, 0) - at(-REACH, 0)) / run;
        let dv = (at(0, REACH) - at(0, -REACH)) / run;
        let normal = DVec3::new(-du, dv, 1.0).normalize();
        let light = DVec3::new(-0.45, 0.65, 0.6).normalize();
        let bright = 0.25 + 0.75 * normal.dot(light).max(0.0);
        ((bright * SHADES as f64) as usize).min(SHADES - 1)
    }

    /// One path per shade and colour; each run of a row is one horizontal stroke.
    fn svg(&self, kind: StepKind, direction: Direction) -> String {
        let [w, h] = self.size;
        let colour = match kind {
            StepKind::Subtractive => 'c',
            StepKind::Additive => 'a',
        };
        let mut paths = vec![String::new(); 2 * SHADES];
        for row in 0..h {
            let mut column = 0;
            while column < w {
                let Some(class) = self.class(column, row) else {
                    column += 1;
                    continue;
                };
                let start = column;
                while column < w && self.class(column, row) == Some(class) {
                    column += 1;
                }
                // Writing into a String cannot fail.
                let _ = write!(paths[class], "M{start} {row}h{}", column - start);
            }
        }
        let mut svg = format!("<svg viewBox=\"0 0 {w} {h}\" role=\"img\"><g class=\"px\">");
        for (class, path) in paths.iter().enumerate().filter(|(_, p)| !p.is_empty()) {
            let letter = if class < SHADES { 's' } else { colour };
            let _ = write!(svg, "<path class=\"{letter}{}\" d=\"{path}\"/>", class % SHADES);
        }
        svg.push_str("</g>");
        svg.push_str(&self.arrow(direction));
        svg.push_str("</svg>");
        svg
    }

    fn class(&self, column: usize, row: usize) -> Option<usize> {
        let i = row * self.size[0] + column;
        (self.depth[i] > f64::NEG_INFINITY)
            .then(|| self.shade(column, row) + if self.region[i] { SHADES } else { 0 })
    }

    /// From where the tool comes down to the middle of the region.
    fn arrow(&self, direction: Direction) -> String {
        let d = direction.vec();
        let (dx, dy) = (self.axes[0].dot(d), -self.axes[1].dot(d));
        let length = 0.3 * self.size[0].max(self.size[1]) as f64;
        let (x, y) = (
            (self.axes[0].dot(self.focus) - self.origin.0) / self.cell,
            (-self.axes[1].dot(self.focus) - self.origin.1) / self.cell,
        );
        let (fx, fy) = (x + dx * length, y + dy * length);
        // A head of two strokes, 4 cells long, at 150° to the shaft.
        let (s, c) = (0.5, 0.866);
        let n = dx.hypot(dy).max(1e-9);
        let (ex, ey) = (4.0 * dx / n, 4.0 * dy / n);
        format!(
            "<path class=\"way\" d=\"M{fx:.1} {fy:.1}L{x:.1} {y:.1}M{:.1} {:.1}L{x:.1} {y:.1}L{:.1} \
             {:.1}\"/>",
            x + c * ex - s * ey,
            y + s * ex + c * ey,
            x + c * ex + s * ey,
            y - s * ex + c * ey,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ball(n: usize) -> (Frame, BitGrid) {
        let frame = Frame { pitch: 1.0, dims: [n, n, n], origin: DVec3::ZERO };
        let middle = DVec3::splat(n as f64 / 2.0);
        let r = n as f64 * 0.45;
        let solid = BitGrid::from_fn([n; 3], |v| (frame.center(v) - middle).length() < r);
        (frame, solid)
    }

    #[test]
    fn the_view_turns_to_the_side_of_the_region() {
        let (frame, solid) = ball(40);
        let half = |f: &(dyn Fn([usize; 3]) -> bool + Sync)| {
            let mut part = BitGrid::from_fn([40; 3], f);
            part.intersect_with(&solid);
            part
        };
        let low = half(&|v| v[2] < 8);
        let back = half(&|v| v[1] > 32 && v[0] > 22);
        let draw = |region: &BitGrid| {
            draw_step(&frame, &solid.minus(region), region, StepKind::Subtractive, Direction::Z)
        };
        assert!(draw(&low).view.ends_with("below"));
        assert!(draw(&back).view.starts_with("back right"));
        assert!(draw(&back).svg.contains("class=\"c"));
    }

    #[test]
    fn a_large_drawing_stays_small_in_bytes() {
        let (frame, solid) = ball(200);
        let region = BitGrid::from_fn([200; 3], |v| solid.get(v) && v[0] > 100);
        let stays = solid.minus(&region);
        let svg = draw_step(&frame, &stays, &region, StepKind::Additive, Direction::X).svg;
        assert!(svg.len() < 60_000, "{} bytes", svg.len());
        assert!(svg.len() > 2_000, "{} bytes", svg.len());
    }

    #[test]
    fn nothing_at_all_still_draws() {
        let frame = Frame { pitch: 1.0, dims: [3, 3, 3], origin: DVec3::ZERO };
        let none = BitGrid::new([3; 3]);
        let d = draw_step(&frame, &none, &none, StepKind::Additive, Direction::Z);
        assert!(d.svg.starts_with("<svg"));
    }
}
