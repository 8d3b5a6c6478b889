//! Touching up what the passes of a finished step leave on the target's surface.
//!
//! Method: the target's triangles where the step cuts are divided into facets about a voxel wide. Where
//! more than a share of the stock to leave stands over the middle of one, the position at which the end
//! comes nearest to it is looked for: where the surface's normal would have the end, off it as far as
//! material is left, and around the best of these in halving steps. Over a wall the tip goes as low as the edge is long. Positions
//! a step apart are joined into ways.
//!
//! Guarantees: a tip is never below the lowest free one, and between joined ones no more than [`SINK_MM`]
//! below it; a position is taken only when it takes off [`GAIN_MM`] at least. Not guaranteed: facets
//! that shank or holder keep every position from; the very best position.

use super::cells::Cells;
use super::exact::{Exact, Lowest};
use super::mill::Work;
use super::swept::{Swept, from_edge};
use crate::base::{Cancelled, DVec2, DVec3};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Positions on the way off a surface that the search begins at, besides the contact: shank or holder may
/// allow one of them.
const SEEDS: u32 = 4;

/// Positions around a point that are tried besides, at these radii in the end's: just clear of the point,
/// and off it.
const RING: u32 = 16;
const RING_RADII: [f64; 3] = [0.8, 1.02, 1.15];

/// Step at which the search begins, as a share of the end's radius.
const SEED_STEP: f64 = 0.25;

/// Step at which the search ends, mm: a tenth of what counts as left.
const LEAST_STEP_MM: f64 = 0.02;

/// The eight ways to go on from a place.
const AROUND: [(i8, i8); 8] =
    [(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)];

/// Facets have no longer sides than this many pitches: half of what deviations are measured on.
const FACET_PITCH: f64 = 1.0;

/// How far aside of its facet a voxel is looked up, in pitches: the surface lies up to half a
/// voxel's diagonal from the face between voxels.
const ASIDE_PITCH: f64 = 0.9;

/// Share of the stock to leave beyond which a facet is touched up. More leaves single points
/// between the facets above the whole of it, less cuts what finishing's own lattice leaves anyway.
const LEFT_SHARE: f64 = 0.6;

/// More left than this share of the stock is not told apart: looking for how much takes time.
const FAR_SHARE: f64 = 2.0;

/// What a position has to take off, mm; less is not worth its way.
const GAIN_MM: f64 = 0.02;

/// So many facets beside a point that no position helps, none is looked for where no more is left.
const BARREN_FACETS: f64 = 1.5;

/// Points that are looked at together: more keep more threads busy, fewer know more of what helped those
/// before them.
const AT_A_TIME: usize = 16;

/// Cosine of the angle between the normals of two such points, 18°.
const ALIKE: f64 = 0.95;

/// Positions farther apart than this many facets are reached over the safe height.
const JOINED_FACETS: f64 = 2.5;

/// Positions between two joined ones are tried this far apart, mm.
const BETWEEN_MM: f64 = 0.05;

/// How far a joined way may pass under the lowest free tip, mm: the sagitta of a way round a
/// cylinder of 10 mm radius is half of it. What counts as a gouge is ten times as much.
const SINK_MM: f64 = 0.005;

/// A triangle, halved along its longest side until no side is longer than `side`, mm; pieces of
/// which nothing is `wanted` are left out.
pub(crate) fn facets(
    corners: [DVec3; 3],
    side: f64,
    wanted: impl Fn(&[DVec3; 3]) -> bool,
) -> Vec<[DVec3; 3]> {
    let (mut out, mut open) = (Vec::new(), vec![corners]);
    while let Some(c) = open.pop() {
        if !wanted(&c) {
            continue;
        }
        let sides = [0, 1, 2].map(|i| c[i].distance(c[(i + 1) % 3]));
        let i = (0..3).max_by(|a, b| sides[*a].total_cmp(&sides[*b])).unwrap_or(0);
        if sides[i] <= side {
            out.push(c);
            continue;
        }
        let (a, b, far) = (c[i], c[(i + 1) % 3], c[(i + 2) % 3]);
        let middle = (a + b) / 2.0;
        open.push([a, middle, far]);
        open.push([middle, b, far]);
    }
    out
}

/// A finished step, and what its passes are held against.
pub(super) struct Touch<'a> {
    pub work: &'a Work<'a>,
    pub exact: &'a Exact,
    pub lowest: &'a Lowest,
    /// Stock to leave, mm.
    pub stock: f64,
}

/// A point of the target's surface and its outward normal, as (u, v, height).
#[derive(Clone, Copy)]
struct Point {
    at: DVec3,
    normal: DVec3,
}

impl Touch<'_> {
    /// Ways of tips (u, v, height) that take off what the cuts so far, as (u, v, height), left.
    ///
    /// # Errors
    /// When the user stops the run.
    pub fn ways(&self, cuts: Vec<[DVec3; 2]>) -> Result<Vec<Vec<DVec3>>, Cancelled> {
        let (end, edge) = (self.exact.end(), self.work.tool.active_length());
        let Some(swept) = Swept::of(end, edge, cuts) else { return Ok(Vec::new()) };
        let least = LEFT_SHARE * self.stock;
        let far = end.radius() + least;
        let most = FAR_SHARE * self.stock;
        let mut left: Vec<Point> = self
            .points()
            .into_par_iter()
            .filter(|p| {
                let axis = p.at.truncate() + end.contact_to_axis(p.normal.truncate());
                !swept.is_within(p.at, least, axis)
            })
            .collect();
        // From below: the edge reaches up a wall, not down.
        left.sort_by(|a, b| a.at.z.total_cmp(&b.at.z));
        let (lo, hi) = bounds(left.iter().map(|p| p.at.truncate()));
        if left.is_empty() {
            return Ok(Vec::new());
        }
        let margin = DVec2::splat(2.0 * far);
        let cells = Cells::over(lo - margin, hi + margin, far.max(1.0));
        let (mut tips, mut barren) = (Listed::over(cells), Listed::over(cells));
        let beside = BARREN_FACETS * FACET_PITCH * self.work.frame.pitch;
        let off_tips = |tips: &Listed<DVec3>, p: &Point| {
            let near = tips.around(p.at, far).map(|t| from_edge(end, edge, t, p.at));
            near.fold(most, f64::min)
        };
        let in_vain = |barren: &Listed<(f64, Point)>, p: &Point, off: f64| {
            let like = |q: &Point| q.at.distance(p.at) < beside && q.normal.dot(p.normal) > ALIKE;
            barren.around(p.at, beside).any(|(more, q)| off <= more && like(&q))
        };
        for some in left.chunks(AT_A_TIME) {
            self.work.ctx.check()?;
            let look = |p: &Point| {
                let off = off_tips(&tips, p);
                if off <= least {
                    return None;
                }
                let off = swept.distance(p.at, off);
                (!in_vain(&barren, p, off)).then(|| (off, self.nearest(*p, off)))
            };
            let found: Vec<_> = some.par_iter().map(look).collect();
            // Those before it in the same turn may have helped a point, or shown that nothing does.
            for (p, (off, found)) in some.iter().zip(found).filter_map(|(p, f)| Some((p, f?))) {
                let off = off.min(off_tips(&tips, p));
                if off <= least || in_vain(&barren, p, off) {
                    continue;
                }
                match found.filter(|(at, _)| *at <= off - GAIN_MM) {
                    Some((_, tip)) => tips.add(tip, tip),
                    None => barren.add(p.at, (off + GAIN_MM, *p)),
                }
            }
        }
        self.joined(tips.items, &|_| true)
    }

    /// The tip from which the edge comes nearest to a point and how near it comes, when that is nearer than
    /// `off`.
    fn nearest(&self, p: Point, off: f64) -> Option<(f64, DVec3)> {
        let (end, edge) = (self.exact.end(), self.work.tool.active_length());
        // Nothing of the edge is lower than its tip.
        let reach = end.radius() + off;
        if self.exact.least_guard(p.at.truncate(), reach, self.lowest) > p.at.z + off {
            return None;
        }
        let (normal, uv, lowest) = (p.normal.truncate(), p.at.truncate(), p.at.z - edge);
        let mut best = (f64::INFINITY, uv.extend(lowest));
        let mut on = None;
        // Takes the lowest tip over a place where it comes nearer than the best so far.
        let mut look = |best: &mut (f64, DVec3), q: DVec2| {
            let most = match best.0 {
                f64::INFINITY => Some(f64::INFINITY),
                far => end.highest_tip(q.distance(uv), p.at.z, far),
            };
            // Most places are no better, which is told sooner than how low the tip may go there.
            if most.is_some_and(|z| self.exact.is_free(q, z, self.lowest, &mut on)) {
                let tip = q.extend(self.exact.lowest(q, self.lowest).max(lowest));
                let at = from_edge(end, edge, tip, p.at).max(0.0);
                if at < best.0 {
                    *best = (at, tip);
                }
            }
        };
        let contact = uv + end.contact_to_axis(normal);
        for k in 0..=SEEDS {
            look(&mut best, contact + normal * (off * f64::from(k) / f64::from(SEEDS)));
        }
        if best.0 > off - GAIN_MM {
            // In a corner the other wall keeps the end from all of these.
            for a in (0..RING).map(|k| TAU * f64::from(k) / f64::from(RING)) {
                for r in RING_RADII {
                    look(&mut best, uv + DVec2::from_angle(a) * (r * end.radius()));
                }
            }
        }
        let mut step = SEED_STEP * end.radius();
        while step > LEAST_STEP_MM && best.0 > LEAST_STEP_MM {
            let (from, at) = (best.0, best.1.truncate());
            for (i, j) in AROUND {
                look(&mut best, at + DVec2::new(f64::from(i), f64::from(j)) * step);
            }
            if best.0 >= from {
                step /= 2.0;
            }
        }
        (best.0 <= off - GAIN_MM).then_some(best)
    }

    /// Middles of facets in front of which the step cuts and behind which the target stands.
    fn points(&self) -> Vec<Point> {
        let Work { job, frame, step, after, .. } = self.work;
        let mesh = &job.target_mesh;
        let Some((low, high)) = step.region.extent() else { return Vec::new() };
        let aside = ASIDE_PITCH * frame.pitch;
        let (low, high) = (frame.center(low) - 2.0 * aside, frame.center(high) + 2.0 * aside);
        let wanted = |c: &[DVec3; 3]| {
            let (least, most) = (c[0].min(c[1]).min(c[2]), c[0].max(c[1]).max(c[2]));
            least.cmple(high).all() && most.cmpge(low).all()
        };
        let plane = step.direction.image_plane();
        let turned = |p: DVec3| plane.across(p).extend(plane.height(p));
        let point = |c: [DVec3; 3]| {
            let normal = (c[1] - c[0]).cross(c[2] - c[0]).try_normalize()?;
            let p = (c[0] + c[1] + c[2]) / 3.0;
            let cut = |q: DVec3| frame.voxel_at(q).is_some_and(|v| step.region.get(v));
            let stands =
                |q: DVec3| frame.voxel_at(q).is_some_and(|v| job.target.get(v) && after.get(v));
            // Single triangles may face the wrong way.
            let faces = |n: DVec3| cut(p + n * aside) && stands(p - n * aside);
            let normal = [normal, -normal].into_iter().find(|n| faces(*n))?;
            Some(Point { at: turned(p), normal: turned(normal) })
        };
        let pieces = |t: usize| facets(mesh.corners(t), FACET_PITCH * frame.pitch, wanted);
        let triangles = (0..mesh.triangles().len()).into_par_iter();
        triangles.flat_map_iter(pieces).filter_map(point).collect()
    }

    /// Tips near each other as ways, as far as they can be joined over places that `may` be gone to besides.
    ///
    /// # Errors
    /// When the user stops the run.
    pub fn joined(
        &self,
        tips: Vec<DVec3>,
        may: &dyn Fn(DVec3) -> bool,
    ) -> Result<Vec<Vec<DVec3>>, Cancelled> {
        let apart = JOINED_FACETS * FACET_PITCH * self.work.frame.pitch;
        if tips.is_empty() {
            return Ok(Vec::new());
        }
        let (lo, hi) = bounds(tips.iter().map(|t| t.truncate()));
        let mut listed = Listed::over(Cells::over(lo, hi, apart.max(1.0)));
        tips.into_iter().for_each(|t| listed.add(t, t));
        let tips = listed;
        let mut gone = vec![false; tips.items.len()];
        let mut ways = Vec::new();
        for first in 0..gone.len() {
            self.work.ctx.check()?;
            if std::mem::replace(&mut gone[first], true) {
                continue;
            }
            let mut way = vec![tips.items[first]];
            loop {
                let at = way[way.len() - 1];
                let mut next: Vec<(f64, usize)> = tips
                    .indices(at, apart)
                    .filter(|i| !gone[*i])
                    .map(|i| (tips.items[i].distance(at), i))
                    .filter(|(d, _)| *d <= apart)
                    .collect();
                next.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
                let clear = |i: &usize| self.clear(at, tips.items[*i], may);
                let Some(i) = next.into_iter().map(|(_, i)| i).find(clear) else { break };
                gone[i] = true;
                way.push(tips.items[i]);
            }
            ways.push(way);
        }
        Ok(ways)
    }

    /// Whether the tip may go straight from one place to another.
    fn clear(&self, a: DVec3, b: DVec3, may: &dyn Fn(DVec3) -> bool) -> bool {
        let n = (a.distance(b) / BETWEEN_MM).ceil() as usize;
        let mut on = None;
        (1..n).map(|k| a.lerp(b, k as f64 / n as f64)).all(|p| {
            self.exact.is_free(p.truncate(), p.z + SINK_MM, self.lowest, &mut on) && may(p)
        })
    }
}

/// Box of points; empty of none.
pub(super) fn bounds(uv: impl Iterator<Item = DVec2>) -> (DVec2, DVec2) {
    uv.fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(lo, hi), p| (lo.min(p), hi.max(p)))
}

/// Things in the cells that they lie over.
struct Listed<T> {
    cells: Cells,
    lists: Vec<Vec<u32>>,
    items: Vec<T>,
}

impl<T: Copy> Listed<T> {
    fn over(cells: Cells) -> Listed<T> {
        Listed { cells, lists: vec![Vec::new(); cells.count()], items: Vec::new() }
    }

    fn add(&mut self, at: DVec3, item: T) {
        if let Some(c) = self.cells.at(at.truncate()) {
            self.lists[c].push(self.items.len() as u32);
            self.items.push(item);
        }
    }

    /// Indices of what lies over a square around a point.
    fn indices(&self, at: DVec3, reach: f64) -> impl Iterator<Item = usize> {
        let cells = self.cells.within(at.truncate() - reach, at.truncate() + reach);
        cells.flat_map(|c| self.lists[c].iter().map(|i| *i as usize))
    }

    fn around(&self, at: DVec3, reach: f64) -> impl Iterator<Item = T> {
        self.indices(at, reach).map(|i| self.items[i])
    }
}
