//! Beads of one additive step.
//!
//! Method: layers across the direction from low to high; in each the region's section at mid height is
//! outlined, perimeters run parallel to the outline, straight infill turns by a quarter from layer to
//! layer. The tip rides on the top of its layer. Travels draw the filament back and rise where the nozzle
//! would meet the state before the step.
//!
//! Guarantees: every bead centre line lies inside the section, half a bead from its outline (less
//! [`INSET_SLACK`]). Not guaranteed: what is thinner than a bead gets none, and its volume is
//! reported; closed top and bottom skins are not added to the infill.

use super::image::{Image, Lattice};
use super::mill::{Free, Work};
use super::moves::{Figures, Move, MoveKind};
use super::process::{CLEARANCE_MM, Printing};
use super::slice::{Outline, area, section};
use crate::base::{DVec2, DVec3};
use clipper2_rust::{EndType, JoinType, PathsD, PointD, inflate_paths_d, simplify_paths};
use rayon::prelude::*;

/// By how much of its width a bead may stand out of its outline. Zero would lose every wall that is
/// exactly one bead wide to rounding; more would print past the region.
pub const INSET_SLACK: f64 = 0.01;

/// Outlines are simplified by this fraction of the pitch, which takes the ripple of the voxels out
/// of them. Above a quarter it would move walls visibly; at zero programs are three times as long.
const SIMPLIFY_PITCH: f64 = 0.1;

/// Digits after the point of the polygon offsets' fixed-point coordinates, mm.
const CLIPPER_DIGITS: i32 = 4;

/// Corners sharper than this ratio of miter to offset are cut.
const MITER: f64 = 2.0;

pub(super) struct Printed {
    pub moves: Vec<Move>,
    pub safe_height: f64,
    pub figures: Figures,
}

/// A bead's centre line in (u, v); closed lines repeat their first point.
type Line = Vec<DVec2>;

struct Layer {
    /// Height of the tip.
    z: f64,
    loops: Vec<Line>,
    fill: Vec<Line>,
    thin_mm2: f64,
}

pub(super) fn print(work: &Work, process: &Printing) -> Printed {
    let plane = work.step.direction.image_plane();
    let h = work.frame.pitch;
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    let (mut lo, mut hi) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
    for v in work.step.region.iter_ones() {
        let p = work.frame.center(v);
        low = low.min(plane.height(p) - h / 2.0);
        high = high.max(plane.height(p) + h / 2.0);
        (lo, hi) = (lo.min(plane.across(p)), hi.max(plane.across(p)));
    }
    let margin = DVec2::splat(2.0 * h);
    let lattice = Lattice::over(work.frame, plane, h, lo - margin, hi + margin);
    let count = ((high - low) / process.layer - 1e-6).ceil().max(0.0) as usize;
    let layers: Vec<Layer> = (0..count)
        .into_par_iter()
        .map(|k| {
            let bottom = low + k as f64 * process.layer;
            let outline =
                section(&work.step.region, work.frame, &lattice, bottom + process.layer / 2.0);
            beads(&outline, process, h, bottom + process.layer, k)
        })
        .collect();
    let thin_mm3 = layers.iter().map(|l| l.thin_mm2).sum::<f64>() * process.layer;
    let free = Free::around(work, work.before, h);
    let heights = free.heights(work.tool, 0.0, 0.0);
    let blocked = heights.data.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let top = high + process.layer;
    let safe = free.state_top.max(f64::from(blocked)).max(top) + CLEARANCE_MM;
    let mut head = Head { heights, safe, process: *process, at: None, moves: Vec::new() };
    for layer in layers {
        head.lay(layer.loops, layer.z);
        head.lay(layer.fill, layer.z);
    }
    head.leave();
    let figures = Figures { thin_mm3, ..Figures::default() };
    Printed { moves: head.moves, safe_height: safe, figures }
}

fn to_paths(outlines: &[Outline]) -> PathsD {
    outlines.iter().map(|o| o.iter().map(|p| PointD { x: p.x, y: p.y }).collect()).collect()
}

fn of_paths(paths: &PathsD) -> Vec<Outline> {
    paths.iter().map(|p| p.iter().map(|q| DVec2::new(q.x, q.y)).collect()).collect()
}

fn offset(paths: &PathsD, by: f64) -> PathsD {
    let join = JoinType::Miter;
    inflate_paths_d(paths, by, join, EndType::Polygon, MITER, CLIPPER_DIGITS, 0.0)
}

fn beads(outline: &[Outline], process: &Printing, h: f64, z: f64, layer: usize) -> Layer {
    let w = process.width;
    let first = w * (0.5 - INSET_SLACK);
    let section = to_paths(outline);
    let eps = SIMPLIFY_PITCH * h;
    let inset = |by: f64| simplify_paths(&offset(&section, -by), eps, true);
    let mut loops: Vec<Line> = Vec::new();
    let rims = process.perimeters.max(1);
    for k in 0..rims {
        for mut line in of_paths(&inset(first + k as f64 * w)) {
            if line.len() >= 2 {
                line.push(line[0]);
                loops.push(line);
            }
        }
    }
    let inner = of_paths(&inset(first + (rims - 1) as f64 * w + w / 2.0));
    let fill = if process.infill > 0.0 {
        hatch(&inner, w / process.infill.min(1.0), layer % 2 == 1, w / 2.0)
    } else {
        Vec::new()
    };
    let opened = offset(&offset(&section, -first), first);
    let thin_mm2 = (area(outline) - area(&of_paths(&opened))).max(0.0);
    Layer { z, loops, fill, thin_mm2 }
}

/// Parallel lines `spacing` apart inside the outlines (even–odd), along v when `turned`, else
/// along u; pieces shorter than `shortest` are left out.
fn hatch(outlines: &[Outline], spacing: f64, turned: bool, shortest: f64) -> Vec<Line> {
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
            let from = ((a.y / spacing).ceil() as i64).max(first);
            let mut k = from;
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

/// Lays lines one after the other, nearest first.
struct Head {
    heights: Image,
    safe: f64,
    process: Printing,
    at: Option<(DVec2, f64)>,
    moves: Vec<Move>,
}

impl Head {
    fn lay(&mut self, mut lines: Vec<Line>, z: f64) {
        /// Beyond this the quadratic search costs more than the travel it saves.
        const MOST: usize = 2000;
        let greedy = lines.len() <= MOST;
        lines.reverse();
        while !lines.is_empty() {
            let here = self.at.map(|(uv, _)| uv);
            let gap = |l: &Line| here.map_or(0.0, |p| entry(l, p).1);
            let pick = if greedy {
                (0..lines.len()).min_by(|a, b| gap(&lines[*a]).total_cmp(&gap(&lines[*b])))
            } else {
                Some(lines.len() - 1)
            };
            let Some(pick) = pick else { return };
            let line = lines.remove(pick);
            self.bead(line, z);
        }
    }

    fn bead(&mut self, mut line: Line, z: f64) {
        if let Some((here, _)) = self.at {
            let (start, _) = entry(&line, here);
            if line[0] == line[line.len() - 1] && line.len() > 2 {
                line.pop();
                line.rotate_left(start);
                line.push(line[0]);
            } else if start > 0 {
                line.reverse();
            }
        }
        self.travel(line[0], z);
        let feed = self.process.feed;
        for p in &line[1..] {
            self.push(MoveKind::Deposit, *p, z, feed);
        }
    }

    fn travel(&mut self, to: DVec2, z: f64) {
        let feed = self.process.travel_feed;
        let Some((from, z0)) = self.at else {
            self.push(MoveKind::Rapid, to, self.safe, 0.0);
            self.push(MoveKind::Approach, to, z, feed);
            return;
        };
        let lattice = self.heights.lattice;
        let n = (from.distance(to) / (lattice.s / 2.0)).ceil().max(1.0);
        let blocked = (0..=n as usize)
            .filter_map(|i| lattice.cell(from.lerp(to, i as f64 / n)))
            .map(|c| self.heights.at(c))
            .fold(f64::NEG_INFINITY, f64::max);
        let level = z.max(z0);
        let over = if blocked > level { (blocked + CLEARANCE_MM).min(self.safe) } else { level };
        self.push(MoveKind::Travel, from, over, feed);
        self.push(MoveKind::Travel, to, over, feed);
        self.push(MoveKind::Travel, to, z, feed);
    }

    fn leave(&mut self) {
        if let Some((uv, _)) = self.at {
            self.push(MoveKind::Rapid, uv, self.safe, 0.0);
        }
        self.at = None;
    }

    fn push(&mut self, kind: MoveKind, uv: DVec2, z: f64, feed: f64) {
        if self.at == Some((uv, z)) {
            return;
        }
        let tip: DVec3 = self.heights.lattice.plane.world(uv, z);
        self.moves.push(Move { kind, tip, feed });
        self.at = Some((uv, z));
    }
}

/// Where to start a line from `here`: the index (any point of a closed line, an end of an open
/// one) and its distance.
fn entry(line: &Line, here: DVec2) -> (usize, f64) {
    let last = line.len() - 1;
    let closed = line[0] == line[last] && line.len() > 2;
    let at = |i: usize| (i, line[i].distance(here));
    if closed {
        let mut best = at(0);
        for i in 1..last {
            if at(i).1 < best.1 {
                best = at(i);
            }
        }
        best
    } else if at(last).1 < at(0).1 {
        at(last)
    } else {
        at(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn figures() -> Printing {
        Printing {
            layer: 0.2,
            width: 0.5,
            perimeters: 2,
            infill: 0.3,
            feed: 1200.0,
            travel_feed: 3000.0,
        }
    }

    fn square(a: f64, b: f64) -> Outline {
        vec![DVec2::new(a, a), DVec2::new(b, a), DVec2::new(b, b), DVec2::new(a, b)]
    }

    #[test]
    fn hatching_fills_a_frame_with_pairs() {
        let hole: Outline = square(3.0, 7.0).into_iter().rev().collect();
        let lines = hatch(&[square(0.0, 10.0), hole], 1.5, false, 0.1);
        let total: f64 = lines.iter().map(|l| l[0].distance(l[1])).sum();
        // 7 lines of 10 mm (0, 1.5 … 9), of which 3, 4.5 and 6 lose 4 mm to the hole.
        assert!((total - (70.0 - 12.0)).abs() < 1e-9, "{total}");
    }

    #[test]
    fn a_square_layer_has_its_perimeters_and_a_third_of_infill() {
        let p = Printing { infill: 0.3, ..figures() };
        let layer = beads(&[square(0.0, 20.0)], &p, 0.5, 0.2, 0);
        assert_eq!(layer.loops.len(), 2);
        let fill: f64 = layer.fill.iter().map(|l| l[0].distance(l[1])).sum();
        let inner = 20.0f64 - 2.0 * (0.245 + 0.5 + 0.25);
        let share = fill * p.width / (inner * inner);
        assert!((share - 0.3).abs() < 0.03, "{share}");
        assert!(layer.thin_mm2 < 0.01);
        let wall =
            vec![DVec2::ZERO, DVec2::new(10.0, 0.0), DVec2::new(10.0, 0.3), DVec2::new(0.0, 0.3)];
        let thin = beads(&[wall], &p, 0.5, 0.2, 0);
        assert!(thin.loops.is_empty() && (thin.thin_mm2 - 3.0).abs() < 1e-6);
    }
}
