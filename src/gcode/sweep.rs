//! One step of a program against the workpiece: what its tool touches, sweeps and fills.
//!
//! Method: every move is sampled at most half a pitch apart; at each sample the analytic tool is
//! held against the voxel centres that must stay; what the step itself removes later is `standing`'s. Guarantees: what is
//! reported happens at a sampled position. Not guaranteed: contact shallower than the stated depth.

use super::beads::beads;
use super::interpret::{Gait, MOST_FINDINGS, Motion};
use super::report::{Finding, Rule, StepFigures};
use super::skyline::Skyline;
use super::standing::holders;
use crate::base::{Ctx, DVec2, DVec3, ImagePlane};
use crate::machine::{Machine, Tool};
use crate::plan::{Step, StepKind};
use crate::toolpath::{Cells, Leg, motion_s};
use crate::voxel::{BitGrid, Frame};
use rayon::prelude::*;

/// Smallest fraction of a subtractive region that the edge must sweep. Every voxel has a tip that
/// reaches it; passes a stepover apart leave ridges and corners, which the surface tolerance covers.
pub const LEAST_SWEPT: f64 = 0.98;

/// Fewest voxels that count as a lump left over: single ones are corners of the staircase.
const LEAST_LUMP: usize = 8;

/// Roughing levels that a cut may be deep: one, and terraces and corners that another pass left.
const LEVELS: f64 = 2.0;

/// Slack in mm for positions written with three decimals.
pub(super) const WRITTEN_MM: f64 = 0.01;

/// Moves that one thread follows; what it finds does not hang on where a run begins, so tests have
/// many of them in small programs.
const RUN: usize = if cfg!(test) { 50 } else { 1 << 14 };

/// Everything a step is judged against.
pub(super) struct Scene<'a> {
    pub frame: &'a Frame,
    pub machine: &'a Machine,
    pub step: &'a Step,
    pub tool: &'a Tool,
    pub before: &'a BitGrid,
    pub after: &'a BitGrid,
    pub fixed: &'a [DVec3],
    /// Surface tolerance of the plan, mm.
    pub tolerance: f64,
    /// Line of the step's tool change.
    pub line: usize,
    pub ctx: &'a Ctx,
}

/// What is said of a step when the user stopped the run meanwhile is only part of it.
pub(super) fn judge(scene: &Scene, motions: &[Motion]) -> (StepFigures, Vec<Finding>) {
    let volume = || match scene.step.kind {
        StepKind::Subtractive => cuts(scene, motions),
        StepKind::Additive => beads(scene, motions),
    };
    let (mut findings, (mut figures, more)) = rayon::join(|| touches(scene, motions), volume);
    findings.extend(more);
    let control = &scene.machine.control;
    let mut bead = false;
    let leg = |m: &Motion| {
        let rapid = m.gait == Gait::Rapid || m.feed <= 0.0;
        let speed = if rapid { control.rapid_mm_min } else { m.feed } / 60.0;
        let lays = m.gait == Gait::Deposit;
        let stops = std::mem::replace(&mut bead, lays) != lays;
        Leg { by: m.from.map_or(DVec3::ZERO, |f| m.to - f), speed, stops }
    };
    let legs: Vec<Leg> = motions.iter().map(leg).collect();
    figures.time_s = motion_s(&legs, control.acceleration_mm_s2);
    (figures, findings)
}

/// Positions along a move, at most `apart` mm from each other, both ends included.
pub(super) fn samples(m: &Motion, apart: f64) -> impl Iterator<Item = DVec3> + use<> {
    let from = m.from.unwrap_or(m.to);
    let n = (from.distance(m.to) / apart).ceil().max(1.0) as usize;
    let (first, to) = (if m.from.is_some() { 0 } else { n }, m.to);
    (first..=n).map(move |i| from.lerp(to, i as f64 / n as f64))
}

pub(super) struct Told {
    pub findings: Vec<Finding>,
    rule: Rule,
}

impl Told {
    pub fn new(rule: Rule) -> Told {
        Told { findings: Vec::new(), rule }
    }

    pub fn tell(&mut self, line: usize, message: String) {
        if self.findings.len() < MOST_FINDINGS {
            self.findings.push(Finding { line, rule: self.rule, message });
        }
    }
}

/// Rapids touch nothing at all, cutters nothing that stays deeper than the tolerance, nozzles nothing
/// deeper than a voxel's diagonal.
fn touches(scene: &Scene, motions: &[Motion]) -> Vec<Finding> {
    let plane = scene.step.direction.image_plane();
    let h = scene.frame.pitch;
    let cell = if scene.step.direction.is_grid_axis() { h } else { h / 2.0 };
    let points = |a: &BitGrid, b: Option<&BitGrid>| {
        let mut shell = a.boundary();
        if let Some(b) = b {
            shell.union_with(&b.boundary());
        }
        let mut all = Vec::with_capacity(shell.count() + scene.fixed.len());
        all.extend(shell.iter_ones().map(|v| scene.frame.center(v)));
        all.extend(scene.fixed);
        all
    };
    let anchor = scene.frame.center([0; 3]);
    let stays = match scene.step.kind {
        StepKind::Subtractive => points(scene.after, None),
        StepKind::Additive => points(scene.before, None),
    };
    let stays = Skyline::new(&stays, plane, anchor, cell);
    let whole = points(scene.before, Some(scene.after));
    let whole = Skyline::new(&whole, plane, anchor, cell);
    // A cutter deeper than the tolerance under a surface is half a voxel less deep over the centres, and
    // by the way of shrinking it √2 as deep in a corner. A nozzle rides on the staircase.
    let slack = match scene.step.kind {
        StepKind::Subtractive => (scene.tolerance - h / 2.0) * std::f64::consts::FRAC_1_SQRT_2,
        StepKind::Additive => h * 3f64.sqrt(),
    };
    let run = |motions: &[Motion]| {
        let (mut rapid, mut gouge) = (Told::new(Rule::Rapid), Told::new(Rule::Gouge));
        // Where the last move at feed ended without touching: the next begins there.
        let mut clear: Option<DVec3> = None;
        let mut blocks = Vec::new();
        for m in motions.iter().take_while(|_| scene.ctx.check().is_ok()) {
            if m.gait == Gait::Rapid {
                clear = None;
                if leaves_straight(&plane, m) {
                    continue;
                }
                let touch = |p| whole.touched(scene.tool, p, [0.0, WRITTEN_MM], &mut blocks);
                if let Some(o) = samples(m, h).find_map(touch) {
                    rapid.tell(m.line, format!("a rapid runs the tool into ({o:.2})"));
                }
            } else {
                let touch = |p| stays.touched(scene.tool, p, [slack; 2], &mut blocks);
                let begun = usize::from(m.from.is_some() && m.from == clear);
                let found = samples(m, h / 2.0).skip(begun).find_map(touch);
                clear = found.is_none().then_some(m.to);
                if let Some(o) = found {
                    let message = format!("the tool enters ({o:.2}) more than {slack:.2} mm deep");
                    gouge.tell(m.line, message);
                }
            }
        }
        [rapid, gouge]
    };
    let runs: Vec<[Told; 2]> = motions.par_chunks(RUN).map(run).collect();
    let first = |rule: usize| {
        let all = runs.iter().flat_map(move |told| &told[rule].findings);
        all.take(MOST_FINDINGS).cloned()
    };
    first(0).chain(first(1)).collect()
}

/// Straight away from the work along the tool axis.
fn leaves_straight(plane: &ImagePlane, m: &Motion) -> bool {
    m.from.is_some_and(|from| {
        let across = plane.across(m.to - from).length();
        plane.height(m.to - from) >= 0.0 && across <= WRITTEN_MM
    })
}

/// Straight down along the tool axis.
fn sinks_straight(plane: &ImagePlane, from: DVec3, to: DVec3) -> bool {
    plane.height(to - from) < 0.0 && plane.across(to - from).length() <= WRITTEN_MM
}

/// Whether the tool might have come down beside itself: where it has no room, straight is the
/// only way.
fn has_room(scene: &Scene, tip: DVec3) -> bool {
    let plane = scene.step.direction.image_plane();
    let h = scene.frame.pitch;
    let shell = scene.after.boundary();
    let mut stays: Vec<DVec3> = shell.iter_ones().map(|v| scene.frame.center(v)).collect();
    stays.extend(scene.fixed);
    let sky = Skyline::new(&stays, plane, scene.frame.center([0; 3]), h);
    // The surface that paths keep off lies up to half a voxel's diagonal from the centres.
    let off = h * 3f64.sqrt() / 2.0;
    (0..8).any(|k| {
        let (sin, cos) = (std::f64::consts::FRAC_PI_4 * f64::from(k)).sin_cos();
        let aside = tip + (plane.u * cos + plane.v * sin) * (2.0 * h);
        sky.touched(scene.tool, aside, [-off; 2], &mut Vec::new()).is_none()
    })
}

/// The lowest tip in each (u, v) cell.
struct Lowest {
    plane: ImagePlane,
    cells: Cells,
    tips: Vec<Option<DVec3>>,
}

impl Lowest {
    fn over(lo: DVec2, hi: DVec2, side: f64, plane: ImagePlane) -> Lowest {
        let cells = Cells::over(lo, hi, side);
        Lowest { plane, cells, tips: vec![None; cells.count()] }
    }

    /// False when the tip is outside.
    fn note(&mut self, tip: DVec3) -> bool {
        let uv = self.plane.across(tip);
        let Some(c) = self.cells.at(uv) else { return false };
        let at = &mut self.tips[c];
        let z = self.plane.height(tip);
        if at.is_none_or(|t| z < t.z) {
            *at = Some(uv.extend(z));
        }
        true
    }

    /// Whether the edge of `tool` at some tip came within `slack` under the point.
    fn swept(&self, p: DVec3, tool: &Tool, near: &[(i64, i64)], slack: f64) -> bool {
        let (uv, z) = (self.plane.across(p), self.plane.height(p));
        let Some(c) = self.cells.cell_of(uv) else { return false };
        near.iter().any(|(i, j)| {
            let at = self.cells.index([c[0] + i, c[1] + j]);
            at.and_then(|at| self.tips[at]).is_some_and(|t| {
                let rho = (t.truncate().distance(uv) - slack).max(0.0);
                t.z + tool.active_lower_surface(rho) <= z + slack
            })
        })
    }
}

/// Cell offsets within `cells`, nearest first.
fn offsets(cells: f64) -> Vec<(i64, i64)> {
    let n = cells.ceil() as i64;
    let mut all: Vec<(i64, i64)> = (-n..=n).flat_map(|i| (-n..=n).map(move |j| (i, j))).collect();
    all.sort_by_key(|(i, j)| (i * i + j * j, *j, *i));
    all.retain(|(i, j)| ((i * i + j * j) as f64).sqrt() <= cells + 1.5);
    all
}

fn cuts(scene: &Scene, motions: &[Motion]) -> (StepFigures, Vec<Finding>) {
    let plane = scene.step.direction.image_plane();
    let (h, radius) = (scene.frame.pitch, scene.tool.active_radius());
    let centers: Vec<DVec3> =
        scene.step.region.iter_ones().map(|v| scene.frame.center(v)).collect();
    let (mut lo, mut hi) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
    for p in &centers {
        (lo, hi) = (lo.min(plane.across(*p)), hi.max(plane.across(*p)));
    }
    let volume = centers.len() as f64 * scene.frame.voxel_volume();
    let mut figures = StepFigures { region_mm3: volume, ..StepFigures::default() };
    if centers.is_empty() {
        return (figures, Vec::new());
    }
    let margin = DVec2::splat(radius + 4.0 * h);
    let mut lowest = Lowest::over(lo - margin, hi + margin, h / 2.0, plane);
    let over = footprint(&lowest.cells, plane, &centers, radius + 2.0 * h);
    let mut astray = Told::new(Rule::Astray);
    let goes_on = || scene.ctx.check().is_ok();
    for m in motions.iter().filter(|m| m.gait == Gait::Feed).take_while(|_| goes_on()) {
        figures.working_mm += m.from.map_or(0.0, |f| f.distance(m.to));
        let mut away = None;
        for p in samples(m, h / 2.0) {
            if !lowest.cells.at(plane.across(p)).is_some_and(|c| over[c]) {
                away = away.or(Some(p));
            }
            lowest.note(p);
        }
        if let Some(p) = away {
            astray
                .tell(m.line, format!("the cutter works at ({p:.2}), away from the step's region"));
        }
    }
    // Half a voxel: a ridge or a corner that a voxel's centre stands in, but not its far side.
    let slack = h / 2.0 + WRITTEN_MM;
    let left = |points: &[DVec3], slack| {
        let feeds = motions.iter().filter(|m| m.gait == Gait::Feed);
        let tips = feeds.take_while(|_| goes_on()).flat_map(|m| samples(m, h / 2.0));
        unswept(points, &lowest, scene.tool, tips, slack)
    };
    let (near, (too_much, met)) = rayon::join(
        || left(&centers, slack),
        || {
            rayon::join(
                || engagement(scene, motions, &centers, &lowest),
                || holders(scene, motions),
            )
        },
    );
    let swept = centers.len() - near.len();
    figures.coverage = swept as f64 / centers.len() as f64;
    figures.removed_mm3 = swept as f64 * scene.frame.voxel_volume();
    let mut findings = astray.findings;
    findings.extend(too_much.into_iter().chain(met));
    // What is missed by more is missed by less.
    let missed = left(if scene.tolerance >= slack { &near } else { &centers }, scene.tolerance);
    if missed.len() >= LEAST_LUMP {
        findings.push(lump(scene, motions, &missed));
    }
    let what = format!("the {volume:.0} mm³ to remove");
    let share = figures.coverage;
    findings.extend(Finding::too_little(scene.line, "the edge sweeps", share, &what, LEAST_SWEPT));
    (figures, findings)
}

/// The points that the edge at none of the tips came within `slack` of; `lowest` knows the tips.
fn unswept(
    points: &[DVec3],
    lowest: &Lowest,
    tool: &Tool,
    tips: impl Iterator<Item = DVec3>,
    slack: f64,
) -> Vec<DVec3> {
    let plane = lowest.plane;
    // No two of them are farther apart across the direction; more would only be looked through.
    let slack = slack.min((lowest.cells.end() - lowest.cells.origin).length());
    let reach = tool.active_radius() + slack;
    let near = offsets(reach / lowest.cells.side);
    let seen = |p: DVec3| (plane.across(p), plane.height(p));
    // What is over a point that is swept is swept as well: of each column the lowest that is known.
    let mut columns: Vec<Option<(DVec2, f64)>> = vec![None; lowest.cells.count()];
    let mut is_missed = vec![false; points.len()];
    let mut look = |(p, is_missed): (&DVec3, &mut bool)| {
        let (uv, z) = seen(*p);
        let column = lowest.cells.at(uv).map(|c| &mut columns[c]);
        if column.as_ref().is_some_and(|c| c.is_some_and(|(at, low)| at == uv && low <= z)) {
            return;
        }
        *is_missed = !lowest.swept(*p, tool, &near, slack);
        if let Some(column) = column.filter(|_| !*is_missed) {
            *column = Some((uv, z));
        }
    };
    // From below, which along an axis of the grid is the points' order or its reverse.
    let all = points.iter().zip(&mut is_missed);
    match plane.d.element_sum() >= 0.0 {
        true => all.for_each(&mut look),
        false => all.rev().for_each(&mut look),
    }
    let missed = points.iter().zip(&is_missed).filter(|(_, missed)| **missed);
    let missed: Vec<DVec3> = missed.map(|(p, _)| *p).collect();
    // The lowest tip of a cell may pass by what a higher one, nearer to it, takes.
    let cells = Cells::over(lowest.cells.origin, lowest.cells.end(), reach);
    let mut waiting: Vec<Vec<usize>> = vec![Vec::new(); cells.count()];
    // No edge reaches below its tip.
    let mut tops = vec![f64::NEG_INFINITY; cells.count()];
    for (i, p) in missed.iter().enumerate() {
        if let Some(c) = cells.at(plane.across(*p)) {
            waiting[c].push(i);
            tops[c] = tops[c].max(plane.height(*p));
        }
    }
    if missed.is_empty() {
        return missed;
    }
    let mut is_swept = vec![false; missed.len()];
    for tip in tips {
        let (at, z) = seen(tip);
        for c in cells.within(at - DVec2::splat(reach), at + DVec2::splat(reach)) {
            if z > tops[c] + slack {
                continue;
            }
            waiting[c].retain(|i| {
                let (uv, height) = seen(missed[*i]);
                if z > height + slack {
                    return true;
                }
                let rho = (at.distance(uv) - slack).max(0.0);
                is_swept[*i] = z + tool.active_lower_surface(rho) <= height + slack;
                !is_swept[*i]
            });
        }
    }
    let left = missed.iter().zip(&is_swept).filter(|(_, swept)| !**swept);
    left.map(|(p, _)| *p).collect()
}

/// What is left of the region deeper than the tolerance, at the line that passes nearest.
fn lump(scene: &Scene, motions: &[Motion], missed: &[DVec3]) -> Finding {
    let middle = missed.iter().copied().sum::<DVec3>() / missed.len() as f64;
    let apart = |m: &Motion| {
        let (from, way) = (m.from.unwrap_or(m.to), m.to - m.from.unwrap_or(m.to));
        let t = (middle - from).dot(way) / way.length_squared().max(1e-12);
        (from + way * t.clamp(0.0, 1.0)).distance_squared(middle)
    };
    let cuts = motions.iter().filter(|m| m.gait == Gait::Feed);
    let nearest = cuts.min_by(|a, b| apart(a).total_cmp(&apart(b)));
    let message = format!(
        "{:.1} mm³ around ({middle:.2}) are left deeper than {:.2} mm",
        missed.len() as f64 * scene.frame.voxel_volume(),
        scene.tolerance
    );
    Finding { line: nearest.map_or(scene.line, |m| m.line), rule: Rule::Volume, message }
}

/// An end that rises by no more than this up to half its radius is flat.
const FLAT_MM: f64 = 1e-6;

/// Cuts that take more than half the cutter's width deeper than the roughing levels allow, and
/// ways of a flat end straight down into material with more than half of it by more than a level:
/// pits as wide as the cutter take no ramp, and a ball end cuts over its centre.
fn engagement(scene: &Scene, motions: &[Motion], centers: &[DVec3], over: &Lowest) -> Vec<Finding> {
    let (h, tool) = (scene.frame.pitch, scene.tool);
    let radius = tool.active_radius();
    let level = tool.process.step_down * 2.0 * radius;
    let most = LEVELS * level + 2.0 * h;
    let plane = over.plane;
    let cells = Cells::over(over.cells.origin, over.cells.end(), h);
    let mut tops = vec![f64::NEG_INFINITY; cells.count()];
    for p in centers {
        if let Some(c) = cells.at(plane.across(*p)) {
            tops[c] = tops[c].max(plane.height(*p) + h / 2.0);
        }
    }
    let reach = (radius / h).floor() as i64;
    let lower = |i: i64, j: i64| tool.active_lower_surface((i as f64).hypot(j as f64) * h);
    // Row by row the first cell along u and the heights of the edge over the tip from there on.
    let rows: Vec<(i64, i64, Vec<f64>)> = (-reach..=reach)
        .filter_map(|j| {
            let first = (-reach..=reach).find(|i| lower(*i, j).is_finite())?;
            Some((j, first, (first..=-first).map(|i| lower(i, j)).collect()))
        })
        .collect();
    let cells_under = rows.iter().map(|(.., row)| row.len()).sum::<usize>();
    let flat = tool.active_lower_surface(radius / 2.0) < FLAT_MM;
    let mut told = Told::new(Rule::Engagement);
    let goes_on = || scene.ctx.check().is_ok();
    for m in motions.iter().filter(|m| m.gait == Gait::Feed).take_while(|_| goes_on()) {
        if flat && m.from.is_some_and(|from| sinks_straight(&plane, from, m.to)) {
            let (uv, z) = (plane.across(m.to), plane.height(m.to));
            let deep = |(i, j, lower): &(i64, i64, f64)| {
                let c = cells.at(uv + DVec2::new(*i as f64, *j as f64) * h);
                c.is_some_and(|c| tops[c] - z - lower > h + level)
            };
            let edge = rows
                .iter()
                .flat_map(|(j, first, row)| (*first..).zip(row).map(|(i, lower)| (i, *j, *lower)));
            if 2 * edge.filter(deep).count() > cells_under && has_room(scene, m.to) {
                told.tell(m.line, "the cutter goes straight down into material".into());
            }
        }
        let (mut deepest, mut area) = (0.0f64, 0.0);
        for p in samples(m, h / 2.0) {
            let (uv, z) = (plane.across(p), plane.height(p));
            let Some(c) = cells.cell_of(uv) else { continue };
            for (j, first, row) in &rows {
                let Some((tops, row)) = under(&cells, &mut tops, [c[0] + first, c[1] + j], row)
                else {
                    continue;
                };
                // Most passes go through air for the most part.
                let depths = tops.iter().zip(row).map(|(top, lower)| top - z - lower);
                if !depths.fold(false, |any, depth| any | (depth > 0.0)) {
                    continue;
                }
                for (top, lower) in tops.iter_mut().zip(row) {
                    let depth = *top - z - lower;
                    if depth > 0.0 {
                        deepest = deepest.max(depth);
                        area += if depth > most { h * h } else { 0.0 };
                        *top = z + lower;
                    }
                }
            }
        }
        // A wall is finished over its whole height in a thin skin; a slot takes the whole width.
        let length = m.from.map_or(0.0, |f| f.distance(m.to));
        if area > (radius + h) * (length + 2.0 * radius) {
            told.tell(m.line, format!("a cut {deepest:.2} mm deep, more than {most:.2} mm"));
        }
    }
    told.findings
}

/// The cells of a row from one at `[i, j]` on and what of `values` lies over them, of both what is within the grid.
fn under<'t, 'v>(
    cells: &Cells,
    tops: &'t mut [f64],
    [i, j]: [i64; 2],
    values: &'v [f64],
) -> Option<(&'t mut [f64], &'v [f64])> {
    let n = cells.n.map(|n| n as i64);
    let (from, to) = (i.max(0), (i + values.len() as i64).min(n[0]));
    if j < 0 || j >= n[1] || from >= to {
        return None;
    }
    let at = |i: i64| (i + n[0] * j) as usize;
    Some((&mut tops[at(from)..at(to)], &values[(from - i) as usize..(to - i) as usize]))
}

/// Cells within `reach` mm of a point's cell.
fn footprint(cells: &Cells, plane: ImagePlane, points: &[DVec3], reach: f64) -> Vec<bool> {
    let mut seeds = vec![false; cells.count()];
    for p in points {
        if let Some(c) = cells.at(plane.across(*p)) {
            seeds[c] = true;
        }
    }
    // Exact squared distance would be overkill: two passes of chords along u, then the disc in v.
    let r = (reach / cells.side).ceil() as usize;
    let [nx, ny] = cells.n;
    let mut gap = vec![usize::MAX; seeds.len()];
    for j in 0..ny {
        let row = &seeds[j * nx..(j + 1) * nx];
        let mut last: Option<usize> = None;
        for i in 0..nx {
            if row[i] {
                last = Some(i);
            }
            gap[i + nx * j] = last.map_or(usize::MAX, |l| i - l);
        }
        let mut next: Option<usize> = None;
        for i in (0..nx).rev() {
            if row[i] {
                next = Some(i);
            }
            gap[i + nx * j] = gap[i + nx * j].min(next.map_or(usize::MAX, |l| l - i));
        }
    }
    (0..seeds.len())
        .map(|k| {
            let (i, j) = (k % nx, k / nx);
            (j.saturating_sub(r)..(j + r + 1).min(ny)).any(|y| {
                let (g, dv) = (gap[i + nx * y], y.abs_diff(j));
                g <= r && g * g + dv * dv <= r * r
            })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Direction;
    use crate::machine::ToolKind;

    /// The lowest tip of a cell stands for all of its tips only where it is near enough.
    #[test]
    fn a_deeper_tip_does_not_hide_a_nearer_one() {
        let machine = Machine::builtin("generic-5axis").unwrap();
        let tool = machine.tools_of(ToolKind::Subtractive)[0].clone();
        let (low, high) = (DVec2::splat(-5.0), DVec2::splat(5.0));
        let mut lowest = Lowest::over(low, high, 0.25, Direction::Z.image_plane());
        let tips = [DVec3::new(0.2, 0.0, -0.5), DVec3::new(0.01, 0.0, 0.0)];
        tips.iter().for_each(|t| assert!(lowest.note(*t)));
        let left = |x: f64, tips: &[DVec3]| {
            let point = DVec3::new(x, 0.0, 1.5);
            !unswept(&[point], &lowest, &tool, tips.iter().copied(), 0.25).is_empty()
        };
        assert_eq!(tool.active_radius(), 1.5);
        assert!(left(-1.6, &tips[..1]));
        assert!(!left(-1.6, &tips));
        assert!(left(-1.8, &tips));
    }

    /// Points over one that is swept are taken for swept without a look of their own: the same are left
    /// as when each is looked at alone, in whatever order they come.
    #[test]
    fn columns_are_swept_as_their_points_are() {
        let machine = Machine::builtin("generic-5axis").unwrap();
        let tool = machine.tools_of(ToolKind::Subtractive)[0].clone();
        let way = |x, y, z| Direction::new(DVec3::new(x, y, z)).unwrap();
        for d in
            [Direction::Z, Direction::NEG_Z, Direction::X, Direction::NEG_Y, way(1.0, 2.0, 2.0)]
        {
            let plane = d.image_plane();
            let (low, high) = (DVec2::splat(-12.0), DVec2::splat(12.0));
            let mut lowest = Lowest::over(low, high, 0.25, plane);
            let tip = |i: usize| {
                let a = i as f64;
                plane.world(
                    DVec2::new(3.0 * (a * 0.7).cos(), 4.0 * (a * 0.3).sin()),
                    (a * 0.2).sin(),
                )
            };
            let tips: Vec<DVec3> = (0..60).map(tip).collect();
            tips.iter().for_each(|t| assert!(lowest.note(*t)));
            let frame = Frame { pitch: 0.5, dims: [24, 24, 24], origin: DVec3::splat(-6.0) };
            let all = BitGrid::from_fn(frame.dims, |_| true);
            let points: Vec<DVec3> = all.iter_ones().map(|v| frame.center(v)).collect();
            let left =
                |points: &[DVec3]| unswept(points, &lowest, &tool, tips.iter().copied(), 0.25);
            let together = left(&points);
            let alone: Vec<DVec3> = points.iter().flat_map(|p| left(&[*p])).collect();
            assert_eq!(together, alone, "{d:?}");
            assert!(together.len() > 1000 && together.len() + 500 < points.len());
            let reversed: Vec<DVec3> = points.iter().rev().copied().collect();
            assert_eq!(left(&reversed).len(), together.len());
        }
    }
}
