//! What an additive step of a program lays: where, how much, and how much of it twice.
//!
//! Method: every bead is sampled half a pitch apart and held against the region's voxels; layer by layer
//! the area that beads cover is measured on rows across them, exact along a row, and the material
//! laid is held against it. Guarantees: a bead is found astray at any sampled point; material laid
//! twice is found however sparse the infill. Not guaranteed: what a bead does above the layer it lies in.

use super::interpret::{Gait, Motion};
use super::report::{Finding, Rule, StepFigures};
use super::sweep::{Scene, Told, WRITTEN_MM, samples};
use crate::base::{DVec2, DVec3};
use crate::voxel::{BitGrid, Frame};

/// Smallest fraction of an additive region within reach of a bead. Specks and walls thinner than
/// a bead get none.
pub const LEAST_FILLED: f64 = 0.90;

/// Beads may hold this many times what they cover: lanes overlap where outlines are narrow, infill
/// ends in the perimeters. Twice the same lines, or half the feed, is far beyond it.
pub const MOST_FILLED: f64 = 1.15;

/// How far a bead's centre line may lie from the region's voxels, in pitches: the exact surface lies
/// up to 1.2 pitches outside their outline, which itself bulges 0.3 out of them in concave corners.
const OUTSIDE_PITCH: f64 = 1.5;

/// Rows in a bead's width on which the covered area is measured: with five its error is a few per
/// cent of a single bead, and no lane falls between two of them.
const ROWS: f64 = 5.0;

/// Beads that end within this height of each other lie in one layer, mm.
const SAME_LAYER_MM: f64 = 0.01;

pub(super) fn beads(scene: &Scene, motions: &[Motion]) -> (StepFigures, Vec<Finding>) {
    let overlap = || overlap(scene, motions);
    let ((figures, mut findings), overlap) = rayon::join(|| reach(scene, motions), overlap);
    findings.extend(overlap);
    (figures, findings)
}

/// What of the region the beads reach, and which of them lie outside it.
fn reach(scene: &Scene, motions: &[Motion]) -> (StepFigures, Vec<Finding>) {
    let (h, frame, d) = (scene.frame.pitch, scene.frame, scene.step.direction.vec());
    let process = &scene.tool.process;
    let region = &scene.step.region;
    let volume = region.count() as f64 * frame.voxel_volume();
    let mut figures = StepFigures { region_mm3: volume, ..StepFigures::default() };
    let mut laid = BitGrid::new(frame.dims);
    let mut astray = Told::new(Rule::Astray);
    // A last layer may be half as high again: its middle is a quarter of a layer lower.
    let within = OUTSIDE_PITCH * h + process.layer_mm / 4.0 + WRITTEN_MM;
    let rate = rate(scene);
    for m in motions.iter().filter(|m| m.gait == Gait::Deposit) {
        let length = m.from.map_or(0.0, |f| f.distance(m.to));
        figures.working_mm += length;
        figures.deposited_mm3 += if m.feed > 0.0 { length * rate / m.feed } else { 0.0 };
        let mut away = None;
        for p in samples(m, h / 2.0) {
            let middle = p - d * (process.layer_mm / 2.0);
            if let Some(v) = frame.voxel_at(middle) {
                laid.set(v, true);
            }
            if !any_near(region, frame, middle, within, h / 2.0) {
                away = away.or(Some(p));
            }
        }
        if let Some(p) = away {
            astray.tell(m.line, format!("a bead at ({p:.2}), outside the step's region"));
        }
    }
    let infill = process.infill.clamp(0.05, 1.0);
    // Half the distance between infill lines, plus what sampling on the grid can lose.
    let reach = process.path_mm / infill / 2.0 + process.layer_mm + 2.0 * h;
    let near = |v: &[usize; 3]| any_near(&laid, frame, frame.center(*v), reach, 0.0);
    let filled = region.iter_ones().filter(near).count();
    figures.coverage = filled as f64 / region.count().max(1) as f64;
    let mut findings = astray.findings;
    let what = format!("the {volume:.0} mm³ to add");
    let share = figures.coverage;
    findings.extend(Finding::too_little(scene.line, "beads reach", share, &what, LEAST_FILLED));
    (figures, findings)
}

/// What leaves the nozzle, mm³/min: constant, so that a slower bead is a thicker one.
fn rate(scene: &Scene) -> f64 {
    scene.machine.extruder.as_ref().map_or(0.0, |e| 60.0 * e.volumetric_mm3_s)
}

/// Material laid on material: more than [`MOST_FILLED`] of what the beads of the step cover. The
/// finding names the line at which the worst layer begins.
fn overlap(scene: &Scene, motions: &[Motion]) -> Option<Finding> {
    let plane = scene.step.direction.image_plane();
    let (width, rate) = (scene.tool.process.path_mm, rate(scene));
    let mut beads: Vec<(f64, &Motion)> = motions
        .iter()
        .filter(|m| m.gait == Gait::Deposit && m.feed > 0.0 && m.from.is_some())
        .map(|m| (plane.height(m.to), m))
        .collect();
    // Stable: within a layer the order stays the program's.
    beads.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (mut held, mut covered, mut worst) = (0.0, 0.0, (0.0, scene.line));
    let mut rest = &beads[..];
    while let Some((z, first)) = rest.first() {
        let n = rest.partition_point(|(other, _)| *other <= z + SAME_LAYER_MM);
        let (layer, later) = rest.split_at(n);
        rest = later;
        let mut area = Area::new(width);
        let (mut length, mut volume) = (0.0, 0.0);
        for (_, m) in layer {
            let (a, b) = (plane.across(m.from.unwrap_or(m.to)), plane.across(m.to));
            area.cover(a, b);
            length += a.distance(b);
            volume += a.distance(b) * rate / m.feed;
        }
        if length == 0.0 {
            continue;
        }
        let holds = area.total() * volume / (length * width);
        (held, covered) = (held + volume, covered + holds);
        let excess = volume - MOST_FILLED * holds;
        if excess > worst.0 {
            worst = (excess, layer.iter().map(|(_, m)| m.line).min().unwrap_or(first.line));
        }
    }
    (held > MOST_FILLED * covered).then(|| Finding {
        line: worst.1,
        rule: Rule::Volume,
        message: format!("beads hold {held:.1} mm³ where they cover {covered:.1} mm³"),
    })
}

/// Area covered by discs drawn along segments, as intervals on rows.
struct Area {
    radius: f64,
    row: f64,
    /// (row, from, to)
    intervals: Vec<(i64, f64, f64)>,
}

impl Area {
    fn new(width: f64) -> Area {
        Area { radius: width / 2.0, row: width / ROWS, intervals: Vec::new() }
    }

    fn cover(&mut self, a: DVec2, b: DVec2) {
        let r = self.radius;
        let first = ((a.y.min(b.y) - r) / self.row).ceil() as i64;
        let last = ((a.y.max(b.y) + r) / self.row).floor() as i64;
        for k in first..=last {
            let y = k as f64 * self.row;
            let (mut from, mut to) = (f64::INFINITY, f64::NEG_INFINITY);
            let mut take = |x0: f64, x1: f64| (from, to) = (from.min(x0), to.max(x1));
            for p in [a, b] {
                let half = r * r - (y - p.y) * (y - p.y);
                if half >= 0.0 {
                    take(p.x - half.sqrt(), p.x + half.sqrt());
                }
            }
            if let Some((x0, x1)) = band(a, b, r, y) {
                take(x0, x1);
            }
            if from < to {
                self.intervals.push((k, from, to));
            }
        }
    }

    fn total(mut self) -> f64 {
        self.intervals.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
        let (mut sum, mut row, mut reached) = (0.0, i64::MIN, f64::NEG_INFINITY);
        for (k, from, to) in self.intervals {
            if k != row {
                (row, reached) = (k, f64::NEG_INFINITY);
            }
            sum += (to - from.max(reached)).max(0.0);
            reached = reached.max(to);
        }
        sum * self.row
    }
}

/// Where the row at height `y` crosses the rectangle of half-width `r` around a segment.
fn band(a: DVec2, b: DVec2, r: f64, y: f64) -> Option<(f64, f64)> {
    let length = a.distance(b);
    let along = (b - a).try_normalize()?;
    // Along the row, x enters both conditions linearly: 0 ≤ t ≤ length and −r ≤ n ≤ r.
    let limits = [
        (along.x, (y - a.y) * along.y - a.x * along.x, 0.0, length),
        (-along.y, (y - a.y) * along.x + a.x * along.y, -r, r),
    ];
    let (mut from, mut to) = (f64::NEG_INFINITY, f64::INFINITY);
    for (slope, offset, low, high) in limits {
        if slope.abs() < 1e-12 {
            if offset < low || offset > high {
                return None;
            }
            continue;
        }
        let (x0, x1) = ((low - offset) / slope, (high - offset) / slope);
        (from, to) = (from.max(x0.min(x1)), to.min(x0.max(x1)));
    }
    (from < to).then_some((from, to))
}

/// Whether a voxel lies within `reach` mm of a point: its centre, or with `half` its box of that
/// half-width.
fn any_near(grid: &BitGrid, frame: &Frame, p: DVec3, reach: f64, half: f64) -> bool {
    let g = frame.grid_from_world(p).floor();
    let at = [g.x as i64, g.y as i64, g.z as i64];
    if grid.get_or_empty(at) && (half > 0.0 || reach >= frame.pitch) {
        return true;
    }
    let n = ((reach + half) / frame.pitch).ceil() as i64;
    for k in -n..=n {
        for j in -n..=n {
            for i in -n..=n {
                let v = [at[0] + i, at[1] + j, at[2] + k];
                if !grid.get_or_empty(v) {
                    continue;
                }
                let away = (frame.center(v.map(|c| c as usize)) - p).abs() - DVec3::splat(half);
                if away.max(DVec3::ZERO).length_squared() <= reach * reach {
                    return true;
                }
            }
        }
    }
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    fn covered(lines: &[(DVec2, DVec2)]) -> f64 {
        let mut area = Area::new(0.5);
        lines.iter().for_each(|(a, b)| area.cover(*a, *b));
        area.total()
    }

    #[test]
    fn a_bead_covers_its_stadium_and_its_double_no_more() {
        let disc = std::f64::consts::PI / 16.0;
        for way in [(7.0, 0.0), (0.0, 7.0), (4.0, 5.0), (-3.0, 0.2)] {
            let b = DVec2::from(way);
            let one = covered(&[(DVec2::ZERO, b)]);
            assert!((one - (0.5 * b.length() + disc)).abs() < 0.03 * one, "{b}: {one}");
            let two = covered(&[(DVec2::ZERO, b), (b, DVec2::ZERO)]);
            assert!((one - two).abs() < 1e-9, "{b}: {two}");
        }
        // Lanes side by side cover both of them, lanes half a bead apart three quarters.
        let lane = |y: f64| (DVec2::new(0.0, y), DVec2::new(100.0, y));
        assert!((covered(&[lane(0.0), lane(0.5)]) - 100.0).abs() < 1.0);
        assert!((covered(&[lane(0.0), lane(0.2)]) - 70.0).abs() < 1.0);
    }
}
