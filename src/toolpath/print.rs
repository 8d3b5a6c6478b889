//! Beads of one additive step.
//!
//! Method: layers across the direction from the block's base to its top, the last one as high as
//! what is left; in each the block's exact outline at mid height (see `piece`) is inset for the
//! perimeters; where the layers above or below leave it bare it is filled whole, elsewhere by the
//! pattern. Where a step's outlines are so narrow that its perimeters would lie half on each other,
//! they leave out what is narrower than a bead and a half, or than two; of a small region lines that lie mostly
//! on others are left out as well (`lapped`). The tip rides on the top of its layer.
//! Travels draw the filament back and rise where
//! the nozzle would meet the state before the step.
//!
//! Guarantees: every bead's centre line lies inside the section, half a bead from its outline (less
//! [`INSET_SLACK`]), but for those of `specks`; outlines deviate from the section by at most [`CHORD_MM`].
//! Not guaranteed: what is thinner than a bead gets none where others are near, and its volume is
//! reported.

use super::comb::Islands;
use super::image::{Image, Lattice};
use super::infill::{Fill, Line, fill, hatch, length as length_of};
use super::lapped::{laid_and_covered, without_lapped};
use super::mill::{Free, Work};
use super::moves::{Figures, Move, MoveKind};
use super::piece::{Piece, outlines};
use super::polygons::{clip_lines, difference, intersection, of_paths, offset, simple};
use super::process::{CLEARANCE_MM, Printing};
use super::slice::area;
use super::specks::{in_bare_layers, specks};
use crate::base::{Cancelled, DVec2, DVec3};
use crate::machine::Seam;
use clipper2_rust::{PathD, PathsD, PointD};
use rayon::prelude::*;

/// By how much of its width a bead may stand out of its outline. Zero would lose every wall that is
/// exactly one bead wide to rounding; more would print past the region.
pub const INSET_SLACK: f64 = 0.01;

/// How far a simplified outline may leave the section, mm. Programs are then a third as long as with
/// every triangle's corner; at 0.02 the bound on the whole path would be used up.
pub const CHORD_MM: f64 = 0.005;

/// Least height of the last layer, in layers; the most is one more. Lower ones would ask for more
/// than twice the feed, higher ones would not bond.
const LAST_LAYER: f64 = 0.5;

/// Least mean width of a piece that gets a single bead, in beads: below, more would be laid than
/// twice what is wanted.
const LEAST_WIDTH: f64 = 0.5;

/// What loops may lay on the whole, as a multiple of what they cover: more, and narrow places get
/// single beads in place of two that lie half on each other. Below what the program's check allows.
const MOST_LAPPED: f64 = 1.1;

/// Half widths, in beads, up to which perimeters leave out necks then, one after the other as long as it is too much.
const NECKS: [f64; 2] = [0.25, 0.5];

/// A region of so few voxels, or with this share of it too thin for a bead, is looked over for what
/// beads stay away from: elsewhere that is no part of it that counts.
const FEW: usize = 4000;
const MUCH_THIN: f64 = 0.02;

/// Corners of a straight thin piece at most; the search for its ends is quadratic.
const MOST_CORNERS: usize = 200;

/// How far the outline that travels follow may be simplified, mm: nothing is laid on it.
const COMB_MM: f64 = 0.05;

pub(super) struct Printed {
    pub moves: Vec<Move>,
    pub safe_height: f64,
    pub figures: Figures,
}

struct Layer {
    /// Height of the tip.
    z: f64,
    feed: f64,
    loops: Vec<Line>,
    fill: Vec<Line>,
    thin_mm3: f64,
    /// What the loops lay and the area that they cover at most, mm².
    laid: f64,
    room: f64,
    /// What travels keep inside of.
    around: Islands,
}

impl Layer {
    /// Whether no bead is laid in it.
    fn is_bare(&self) -> bool {
        self.loops.is_empty() && self.fill.is_empty()
    }
}

/// Height of the middle of a layer, its tip's height and its thickness.
#[derive(Clone, Copy)]
struct Slab {
    tip: f64,
    height: f64,
}

impl Slab {
    fn middle(&self) -> f64 {
        self.tip - self.height / 2.0
    }
}

/// Layers from `low` to `high`.
fn slabs(low: f64, high: f64, process: &Printing) -> Vec<Slab> {
    let layer = process.layer;
    let whole = high - low;
    // The feed of a low last layer must not pass what the machine can.
    let least = LAST_LAYER.max(process.feed / process.travel_feed);
    let count = (whole / layer + 1.0 - least + 1e-6).floor().max(1.0);
    let slab = |k: f64| {
        let tip = if k + 1.0 < count { low + (k + 1.0) * layer } else { high };
        let height = if k + 1.0 < count { layer } else { high - low - k * layer };
        Slab { tip, height: height.max(least * layer) }
    };
    (0..count as usize).map(|k| slab(k as f64)).collect()
}

pub(super) fn print(work: &Work, process: &Printing) -> Result<Printed, Cancelled> {
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
    let margin = DVec2::splat(3.0 * h);
    let lattice = Lattice::over(work.frame, plane, h, lo - margin, hi + margin);
    let piece = Piece::new(work, lattice, &plane);
    let high = piece.top(high, lo, hi).unwrap_or(high);
    let slabs = slabs(low, high, process);
    let mut sections = Sections::new(&slabs, process, |z| piece.outline(z));
    let mut layers = sections.layers(&slabs, process);
    if layers.iter().all(Layer::is_bare) {
        // A speck of which the meshes leave nothing as wide as a bead: the plan has it all the same.
        sections = Sections::new(&slabs, process, |z| piece.coarse(z));
        layers = sections.layers(&slabs, process);
    }
    let voxels = work.step.region.count();
    let is_too_much = |layers: &[Layer]| match voxels <= FEW {
        true => is_lapped(layers, process.width),
        false => may_be_lapped(layers),
    };
    for neck in NECKS.map(|share| share * process.width) {
        if !is_too_much(&layers) {
            break;
        }
        layers = sections.layers(&slabs, &Printing { neck, ..*process });
    }
    let thin_mm3 = layers.iter().map(|l| l.thin_mm3).sum::<f64>();
    let middles: Vec<f64> = slabs.iter().map(Slab::middle).collect();
    if voxels <= FEW || thin_mm3 > MUCH_THIN * voxels as f64 * work.frame.voxel_volume() {
        let lines = layers.iter().zip(&middles);
        let lines = lines.flat_map(|(l, z)| l.loops.iter().chain(&l.fill).map(|line| (*z, line)));
        for (k, bead) in specks(work, process, &plane, &middles, lines) {
            layers[k].fill.push(bead);
        }
    }
    if voxels <= FEW && is_too_much(&layers) {
        layers.iter_mut().for_each(|l| {
            l.fill = without_lapped(&l.loops, std::mem::take(&mut l.fill), process.width);
        });
    }
    let is_bare = |k: usize| layers[k].is_bare();
    for (k, bead) in in_bare_layers(work, process, &plane, &middles, is_bare) {
        layers[k].fill.push(bead);
    }
    let free = Free::around(work, work.before, h);
    let heights = free.heights(work.tool, 0.0, 0.0, work.ctx)?;
    let blocked = heights.data.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let top = high + process.layer;
    let safe = free.state_top.max(f64::from(blocked)).max(top) + CLEARANCE_MM;
    let around = Islands::new(Vec::new());
    let mut head = Head { heights, safe, process: *process, at: None, moves: Vec::new(), around };
    for layer in layers {
        head.process.feed = layer.feed;
        head.around = layer.around;
        head.lay(layer.loops, layer.z);
        head.lay(layer.fill, layer.z);
    }
    head.leave();
    let figures = Figures { thin_mm3, ..Figures::default() };
    Ok(Printed { moves: head.moves, safe_height: safe, figures })
}

/// Whether loops lay too much for what they enclose. What they leave bare inside of it is not looked at.
fn may_be_lapped(layers: &[Layer]) -> bool {
    let total = |of: fn(&Layer) -> f64| layers.iter().map(of).sum::<f64>();
    total(|l| l.laid) > MOST_LAPPED * total(|l| l.room)
}

/// Whether loops and lines together lie too much on each other.
fn is_lapped(layers: &[Layer], width: f64) -> bool {
    let each = layers.iter().map(|l| laid_and_covered(&l.loops, &l.fill, width));
    let [laid, covered] = each.fold([0.0; 2], |[a, b], [laid, covered]| [a + laid, b + covered]);
    laid > MOST_LAPPED * covered
}

/// What of the layers does not depend on how their beads are laid.
struct Sections {
    whole: Vec<PathsD>,
    inner: Vec<PathsD>,
    /// What the insides of as many layers as a skin counts, and one more, from the k-th on, share.
    shared: Vec<PathsD>,
}

impl Sections {
    fn new(slabs: &[Slab], process: &Printing, outline: impl Fn(f64) -> PathsD + Sync) -> Sections {
        let whole: Vec<PathsD> =
            slabs.par_iter().map(|s| simple(&outline(s.middle()), CHORD_MM)).collect();
        let inner: Vec<PathsD> = whole.par_iter().map(|s| inside(s, process)).collect();
        let shared = match has_skins(process) {
            true => shared(&inner, process.skins + 1),
            false => Vec::new(),
        };
        Sections { whole, inner, shared }
    }

    fn layers(&self, slabs: &[Slab], process: &Printing) -> Vec<Layer> {
        let layer = |k: usize| {
            let bare = self.bare(k, process);
            beads(&self.whole[k], &self.inner[k], &bare, process, slabs[k], k)
        };
        (0..slabs.len()).into_par_iter().map(layer).collect()
    }

    /// The part of a layer's inside that some of the next layers above or below do not cover.
    fn bare(&self, k: usize, process: &Printing) -> PathsD {
        let inner = &self.inner[k];
        if !has_skins(process) || inner.is_empty() {
            return PathsD::new();
        }
        let above = self.shared.get(k);
        let below = k.checked_sub(process.skins).and_then(|first| self.shared.get(first));
        let bare = match (above, below) {
            (Some(above), Some(below)) => difference(inner, &intersection(above, below)),
            _ => inner.clone(),
        };
        // Slivers narrower than a bead are the infill's; what is left overlaps it by half a bead.
        let w = process.width;
        intersection(&offset(&offset(&bare, -w / 2.0), w), inner)
    }
}

/// What the perimeters leave to fill.
fn inside(section: &PathsD, process: &Printing) -> PathsD {
    let w = process.width;
    let rims = process.perimeters.max(1) as f64;
    simple(&offset(section, -w * (rims - INSET_SLACK)), CHORD_MM)
}

/// Whether some of what the perimeters leave is filled whole, not by the pattern.
fn has_skins(process: &Printing) -> bool {
    process.skins > 0 && process.infill < 1.0
}

/// What each run of `n` layers shares, by the first of them. Runs twice as long are made of two, so
/// that each costs few intersections.
fn shared(layers: &[PathsD], n: usize) -> Vec<PathsD> {
    let runs = |from: &[PathsD], apart: usize| -> Vec<PathsD> {
        let pairs = from.par_iter().zip(&from[apart.min(from.len())..]);
        pairs.map(|(a, b)| intersection(a, b)).collect()
    };
    let (mut all, mut long) = (layers.to_vec(), 1);
    while long < n {
        // The two may lie half on each other.
        let apart = long.min(n - long);
        all = runs(&all, apart);
        long += apart;
    }
    all
}

fn beads(
    section: &PathsD,
    inner: &PathsD,
    bare: &PathsD,
    process: &Printing,
    slab: Slab,
    layer: usize,
) -> Layer {
    let w = process.width;
    let first = w * (0.5 - INSET_SLACK);
    let outermost = opened(section, first, process.neck);
    let mut loops: Vec<Line> = Vec::new();
    for k in 0..process.perimeters.max(1) {
        let inset = match k {
            0 => simple(&outermost, CHORD_MM),
            _ => simple(&opened(section, first + k as f64 * w, process.neck), CHORD_MM),
        };
        for mut line in of_paths(&inset).into_iter().filter(|l| l.len() >= 2) {
            line.push(line[0]);
            loops.push(line);
        }
    }
    let how = Fill {
        pattern: process.pattern,
        width: w,
        density: process.infill,
        layer,
        z: slab.middle(),
    };
    // Lines end on the edge of the innermost perimeter, into which their round ends bond.
    let mut lines = fill(&difference(inner, bare), &how);
    if !bare.is_empty() {
        lines.extend(hatch(&of_paths(bare), w, !layer.is_multiple_of(2), w / 2.0));
    }
    let wide = offset(&outermost, first);
    let laid = w * loops.iter().map(length_of).sum::<f64>();
    let room = area(&outlines(&wide));
    let thin = difference(section, &wide);
    let (single, alone) = spines(&thin, w);
    lines.extend(single);
    let thin = area(&outlines(&thin)) - alone;
    let scale = process.layer / slab.height;
    let feed = process.feed * scale;
    // Just outside the outermost bead, so that its ends lie within.
    let around = simple(&offset(section, -0.8 * first), COMB_MM);
    let thin_mm3 = thin.max(0.0) * slab.height;
    let around = Islands::new(of_paths(&around));
    Layer { z: slab.tip, feed, loops, fill: lines, thin_mm3, laid, room, around }
}

/// A section inset by `by` mm, without what is narrower than two necks then.
fn opened(section: &PathsD, by: f64, neck: f64) -> PathsD {
    let inset = offset(section, -(by + neck));
    if neck > 0.0 { offset(&inset, neck) } else { inset }
}

/// Single beads along straight pieces too thin for a perimeter, and the area they stand for.
fn spines(thin: &PathsD, w: f64) -> (Vec<Line>, f64) {
    let (mut lines, mut sum) = (Vec::new(), 0.0);
    for o in of_paths(thin) {
        let filled = area(std::slice::from_ref(&o));
        let mut ends = (DVec2::ZERO, DVec2::ZERO, 0.0);
        // Pieces with more corners are not straight.
        for (i, p) in o.iter().enumerate().take(MOST_CORNERS) {
            for q in &o[..i] {
                if p.distance(*q) > ends.2 {
                    ends = (*q, *p, p.distance(*q));
                }
            }
        }
        let (a, b, length) = ends;
        if o.len() > MOST_CORNERS || length < w || filled < LEAST_WIDTH * w * length {
            continue;
        }
        let back = (b - a) * (w / 2.0 / length).min(0.25);
        let line = vec![a + back, b - back];
        // Thousands of pieces lie elsewhere.
        let near: PathsD = thin.iter().filter(|path| reaches(path, &line)).cloned().collect();
        let within: f64 =
            clip_lines(std::slice::from_ref(&line), &near).iter().map(length_of).sum();
        if within > 0.9 * length_of(&line) {
            lines.push(line);
            sum += filled;
        }
    }
    (lines, sum)
}

/// Whether the boxes of a path and of a line's ends meet.
fn reaches(path: &PathD, line: &Line) -> bool {
    let (low, high) = (line[0].min(line[1]), line[0].max(line[1]));
    let over = |by: &dyn Fn(&PointD) -> bool| path.iter().all(by);
    !(over(&|p| p.x < low.x)
        || over(&|p| p.x > high.x)
        || over(&|p| p.y < low.y)
        || over(&|p| p.y > high.y))
}

/// Lays lines one after the other, nearest first.
struct Head {
    heights: Image,
    safe: f64,
    process: Printing,
    at: Option<(DVec2, f64)>,
    moves: Vec<Move>,
    /// Outlines of the running layer, half a bead inside.
    around: Islands,
}

impl Head {
    fn lay(&mut self, mut lines: Vec<Line>, z: f64) {
        /// Beyond this the quadratic search costs more than the travel it saves.
        const MOST: usize = 2000;
        let greedy = lines.len() <= MOST;
        lines.reverse();
        let mut boxes: Vec<(DVec2, DVec2)> = lines.iter().map(bounds).collect();
        while !lines.is_empty() {
            let here = self.at.map(|(uv, _)| uv);
            let pick = match here {
                _ if !greedy => lines.len() - 1,
                None => 0,
                Some(here) => nearest(&lines, &boxes, here),
            };
            boxes.remove(pick);
            let line = lines.remove(pick);
            self.bead(line, z);
        }
    }

    fn bead(&mut self, mut line: Line, z: f64) {
        let aligned = (self.process.seam == Seam::Aligned).then(|| farthest(&line)).flatten();
        let nearest = self.at.map(|(here, _)| entry(&line, here).0);
        if let Some(start) = aligned.or(nearest) {
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
        let Some((from, z0)) = self.at else {
            let feed = self.process.travel_feed;
            self.push(MoveKind::Rapid, to, self.safe, 0.0);
            self.push(MoveKind::Approach, to, z, feed);
            return;
        };
        if z == z0 && from.distance(to) > 2.0 * self.process.width {
            // Over what is already laid, where the ooze of a long travel does no harm.
            for via in self.around.comb(from, to) {
                self.leg(via, z);
            }
        }
        self.leg(to, z);
    }

    /// Straight to a point, over what would be met on the way.
    fn leg(&mut self, to: DVec2, z: f64) {
        let Some((from, z0)) = self.at else { return };
        let feed = self.process.travel_feed;
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

/// The corner of a closed line that lies farthest along v.
fn farthest(line: &Line) -> Option<usize> {
    let last = line.len() - 1;
    let closed = line[0] == line[last] && line.len() > 2;
    (0..last).filter(|_| closed).max_by(|a, b| {
        let key = |i: usize| (line[i].y, line[i].x);
        key(*a).partial_cmp(&key(*b)).unwrap_or(std::cmp::Ordering::Equal)
    })
}

fn bounds(line: &Line) -> (DVec2, DVec2) {
    let empty = (DVec2::INFINITY, DVec2::NEG_INFINITY);
    line.iter().fold(empty, |(lo, hi), p| (lo.min(*p), hi.max(*p)))
}

/// Index of the line that can be entered nearest to `here`, the first of those as near. Lines whose
/// box is no nearer than the best need no look: rounding keeps order, so their points are not
/// nearer either.
fn nearest(lines: &[Line], boxes: &[(DVec2, DVec2)], here: DVec2) -> usize {
    let (mut best, mut pick) = (f64::INFINITY, 0);
    for (i, (line, (lo, hi))) in lines.iter().zip(boxes).enumerate() {
        if (*lo - here).max(here - *hi).max(DVec2::ZERO).length() >= best {
            continue;
        }
        let gap = entry(line, here).1;
        if gap < best {
            (best, pick) = (gap, i);
        }
    }
    pick
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
    use super::super::infill::length;
    use super::super::polygons::to_paths;
    use super::super::slice::Outline;
    use super::*;
    use crate::machine::Pattern;

    fn figures() -> Printing {
        Printing {
            layer: 0.2,
            width: 0.5,
            perimeters: 2,
            infill: 0.3,
            pattern: Pattern::Rectilinear,
            skins: 3,
            seam: Seam::Nearest,
            feed: 1200.0,
            travel_feed: 3000.0,
            neck: 0.0,
        }
    }

    fn square(a: f64, b: f64) -> Outline {
        vec![DVec2::new(a, a), DVec2::new(b, a), DVec2::new(b, b), DVec2::new(a, b)]
    }

    fn layer(outline: &[Outline], k: usize, of: usize) -> Layer {
        let p = figures();
        let slabs = vec![Slab { tip: 0.2, height: 0.2 }; of];
        let sections = Sections::new(&slabs, &p, |_| to_paths(outline));
        sections.layers(&slabs, &p).swap_remove(k)
    }

    #[test]
    fn a_square_layer_has_its_perimeters_and_a_third_of_infill() {
        let middle = layer(&[square(0.0, 20.0)], 5, 11);
        assert_eq!(middle.loops.len(), 2);
        let inner = 20.0f64 - 2.0 * 0.995;
        let share = |l: &Layer| l.fill.iter().map(length).sum::<f64>() * 0.5 / (inner * inner);
        assert!((share(&middle) - 0.3).abs() < 0.03, "{}", share(&middle));
        for skin in [0, 2, 8, 10] {
            let s = share(&layer(&[square(0.0, 20.0)], skin, 11));
            assert!((s - 1.0).abs() < 0.06, "{skin}: {s}");
        }
        assert!(middle.thin_mm3 < 0.002);
        let wall = |w: f64| {
            vec![DVec2::ZERO, DVec2::new(10.0, 0.0), DVec2::new(10.0, w), DVec2::new(0.0, w)]
        };
        // A wall of more than half a bead gets one along it, a thinner one none.
        let thin = layer(&[wall(0.3)], 0, 1);
        assert!(thin.loops.is_empty() && thin.thin_mm3 < 1e-6);
        assert!(thin.fill.len() == 1 && (length(&thin.fill[0]) - 9.5).abs() < 0.01);
        let thin = layer(&[wall(0.2)], 0, 1);
        assert!(thin.loops.is_empty() && thin.fill.is_empty());
        assert!((thin.thin_mm3 - 0.4).abs() < 1e-6);
    }

    #[test]
    fn what_runs_of_layers_share_is_what_all_of_each_do() {
        let layers: Vec<PathsD> =
            (0..9).map(|k| to_paths(&[square(f64::from(k % 4), f64::from(9 - k % 3))])).collect();
        for n in 1..=9 {
            let runs = shared(&layers, n);
            assert_eq!(runs.len(), layers.len() + 1 - n);
            for (run, first) in runs.iter().zip(0..) {
                let all = layers[first..first + n].iter().cloned();
                let plain = all.reduce(|a, b| intersection(&a, &b)).unwrap();
                let beside = [difference(run, &plain), difference(&plain, run)];
                assert!(beside.iter().all(|p| area(&outlines(p)) < 1e-6), "{n} {first}");
                assert!(area(&outlines(run)) > 1.0, "{n} {first}");
            }
        }
        assert!(shared(&layers, 10).is_empty());
    }

    #[test]
    fn boxes_do_not_change_which_line_is_nearest() {
        let mut rng = crate::base::rng(11, 0);
        let mut number = |far: f64| rand::RngExt::random_range(&mut rng, -far..far);
        let mut lines: Vec<Line> = Vec::new();
        for k in 0..60 {
            let middle = DVec2::new(number(20.0), number(20.0));
            let mut line: Line =
                (0..2 + k % 5).map(|_| middle + DVec2::new(number(3.0), number(3.0))).collect();
            if k % 2 == 0 {
                line.push(line[0]);
            }
            lines.push(line);
        }
        // As near as another: the first is taken.
        lines.extend_from_within(..20);
        let boxes: Vec<_> = lines.iter().map(bounds).collect();
        for _ in 0..400 {
            let here = DVec2::new(number(30.0), number(30.0));
            let gap = |i: &usize| entry(&lines[*i], here).1;
            let plain = (0..lines.len()).min_by(|a, b| gap(a).total_cmp(&gap(b)));
            assert_eq!(Some(nearest(&lines, &boxes, here)), plain);
        }
    }

    #[test]
    fn the_last_layer_is_what_is_left() {
        let p = figures();
        for high in [0.03, 0.2, 0.29, 0.31, 1.0, 1.05, 1.09, 1.11, 1.15, 7.33] {
            let all = slabs(0.0, high, &p);
            let last = all[all.len() - 1];
            assert!((last.tip - high).abs() < 1e-9, "{high}");
            let floor = last.tip - last.height;
            assert!(all.len() == 1 || (floor - all[all.len() - 2].tip).abs() < 1e-9, "{high}");
            assert!(all.iter().all(|s| (0.0999..=0.3001).contains(&s.height)), "{high}");
            assert!(all[..all.len() - 1].iter().all(|s| s.height == 0.2));
        }
    }

    #[test]
    fn an_aligned_seam_begins_at_the_farthest_corner() {
        let mut line = square(0.0, 4.0);
        line.push(line[0]);
        assert_eq!(farthest(&line), Some(2));
        assert_eq!(farthest(&line[..2].to_vec()), None);
    }
}
