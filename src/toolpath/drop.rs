//! Drop-cutter: the lowest tip at which a cutter's end touches triangles from above.
//!
//! Method: for a tip at (u, v) every triangle within the end's radius is met by its face, its
//! edges and its corners, each in closed form for ball and flat ends and cones; along an edge a bull-nose end
//! is met by golden section, since height less the convex end is concave there. A tapered end is its ball and
//! its cone, each met by itself. The greatest of all contact heights is the answer.
//!
//! Guarantees: ball and flat ends to rounding, bull-nose ends to [`EDGE_MM`] along the edge.
//! Not guaranteed: what lies outside the end's radius; shank and holder are somebody else's.

use crate::base::{DVec2, DVec3};
use crate::machine::{Shape, Tool};

/// Width at which the search along an edge stops, mm: the height is then exact to its square.
const EDGE_MM: f64 = 1e-6;

/// Steeper faces are met by their edges: the z of their unit normals is smaller.
const UPRIGHT: f64 = 1e-9;

/// Margin of bounds, mm: above their rounding, which is largest at the rim, where an end is steep.
const BOUND_MM: f64 = 1e-5;

/// The end of a cutter, up to its radius.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum End {
    Ball {
        radius: f64,
    },
    Flat {
        radius: f64,
    },
    Bull {
        radius: f64,
        corner: f64,
    },
    /// A ball from whose equator the edge widens up to `widest`, `slope` mm higher for each mm.
    Taper {
        radius: f64,
        widest: f64,
        slope: f64,
    },
}

impl End {
    /// The end of a tool's active part; none for tools without an edge, and for edges of other forms.
    pub fn of(tool: &Tool) -> Option<End> {
        let edges = || tool.sections.iter().filter(|s| s.active).map(|s| s.shape);
        if let Some(taper) = End::tapered(tool) {
            return Some(taper);
        }
        let nose = edges().find(|s| s.lower_surface(0.0) == 0.0)?;
        let end = match nose {
            Shape::Ball { radius } => End::Ball { radius },
            Shape::BullNose { radius, corner } => End::Bull { radius, corner },
            Shape::Frustum { r0, r1, .. } if r0 == r1 => End::Flat { radius: r0 },
            _ => return None,
        };
        // An edge that widens above its end meets more than the end does.
        (tool.active_radius() <= end.radius() + 1e-9).then_some(end)
    }

    /// That of an edge of a ball and a cone on its equator.
    fn tapered(tool: &Tool) -> Option<End> {
        let mut edges = tool.sections.iter().filter(|s| s.active).map(|s| s.shape);
        let (ball, cone, None) = (edges.next()?, edges.next()?, edges.next()) else { return None };
        let same = |a: f64, b: f64| (a - b).abs() < 1e-9;
        match (ball, cone) {
            (Shape::Ball { radius }, Shape::Frustum { z0, r0, z1, r1 })
                if same(z0, radius) && same(r0, radius) && r1 > r0 =>
            {
                Some(End::Taper { radius, widest: r1, slope: (z1 - z0) / (r1 - r0) })
            }
            _ => None,
        }
    }

    /// The end without its outermost `by` mm, less than its radius: what it meets, this one meets no deeper
    /// than that. Its tip is as much higher.
    pub fn inset(&self, by: f64) -> End {
        match *self {
            End::Ball { radius } => End::Ball { radius: radius - by },
            End::Flat { radius } => End::Flat { radius: radius - by },
            End::Bull { radius, corner } => {
                End::Bull { radius: radius - by, corner: (corner - by).max(0.0) }
            }
            End::Taper { radius, widest, slope } => {
                End::Taper { radius: radius - by, widest: widest - by, slope }
            }
        }
    }

    /// The radius within which points are met.
    pub fn radius(&self) -> f64 {
        match *self {
            End::Ball { radius } | End::Flat { radius } | End::Bull { radius, .. } => radius,
            End::Taper { widest, .. } => widest,
        }
    }

    /// Height over the tip from which on the edge is a cylinder, if it ever is.
    pub fn cylinder_from(&self) -> Option<f64> {
        (!matches!(self, End::Taper { .. })).then(|| self.torus().1)
    }

    /// (radius of the flat part, radius of the rounding): a ball has none of the first, a flat
    /// end none of the second. Of a tapered end those of its ball.
    fn torus(&self) -> (f64, f64) {
        match *self {
            End::Ball { radius } | End::Taper { radius, .. } => (0.0, radius),
            End::Flat { radius } => (radius, 0.0),
            End::Bull { radius, corner } => (radius - corner, corner),
        }
    }

    /// Signed distance from a point at radius `rho` and `z` over the tip to the end and the cylinder or cone
    /// above it, negative inside.
    pub fn distance(&self, rho: f64, z: f64) -> f64 {
        let (flat, round) = self.torus();
        let (out, down) = (rho - flat, round - z);
        let to_torus = out.max(0.0).hypot(down.max(0.0)) + out.max(down).min(0.0) - round;
        match *self {
            // Below the equator the ball is nearer. What is inside both is no less deep than it is in one.
            End::Taper { radius, slope, .. } if z > radius => {
                let beside = (slope * (rho - radius) - (z - radius)) / slope.hypot(1.0);
                to_torus.min(beside)
            }
            _ => to_torus,
        }
    }

    /// Of an edge so high over the tip, the radius of its upper rim where that is nearest to a point outside: on a
    /// cone, from below it too.
    pub(super) fn rim_nearest(&self, edge: f64, rho: f64, z: f64) -> Option<f64> {
        let End::Taper { radius, slope, .. } = *self else { return None };
        let rim = radius + (edge - radius) / slope;
        (rho > rim && (rho - rim) + slope * (z - edge) > 0.0).then_some(rim)
    }

    /// The tips no farther than `within` mm over a point at `z`, beside it by `rho`, are lower than this; none
    /// where every tip is farther. The inverse of [`End::distance`].
    pub(super) fn highest_tip(&self, rho: f64, z: f64, within: f64) -> Option<f64> {
        let (flat, round) = self.torus();
        let (out, far) = ((rho - flat).max(0.0), round + within);
        let over = (out < far).then(|| z - round + (far * far - out * out).sqrt());
        match *self {
            End::Taper { radius, slope, .. } => {
                let beside = slope * (rho - radius) - within * slope.hypot(1.0);
                Some(over.unwrap_or(f64::NEG_INFINITY).max(z - radius - beside.max(0.0)))
                    .filter(|tip| self.distance(rho, z - tip) <= within + BOUND_MM)
            }
            _ => over,
        }
    }

    /// From a contact on a surface to the axis, across it; `across` is the part of the surface's
    /// unit normal that lies across.
    pub fn contact_to_axis(&self, across: DVec2) -> DVec2 {
        let (flat, round) = self.torus();
        across.normalize_or_zero() * flat + across * round
    }

    /// Height of the end's surface over the tip at a distance from the axis, within the radius.
    pub(super) fn lower(&self, rho: f64) -> f64 {
        if let End::Taper { radius, slope, .. } = *self
            && rho > radius
        {
            return radius + slope * (rho - radius);
        }
        let (flat, round) = self.torus();
        let over = (rho - flat).max(0.0);
        round - (round * round - over * over).max(0.0).sqrt()
    }

    /// Whether the tip over what lies in a box across and no higher than `top` is no higher than
    /// `best`, beyond rounding: there the end is as high as at the box's nearest point, or higher.
    fn stays_under(&self, best: f64, top: f64, at: DVec2, low: DVec2, high: DVec2) -> bool {
        let apart = (low - at).max(at - high).max(DVec2::ZERO).length_squared();
        if let End::Taper { widest, .. } = *self {
            let near = apart.sqrt();
            let lower = || self.lower((near - BOUND_MM).max(0.0));
            return near > widest + BOUND_MM || top - lower() <= best - BOUND_MM;
        }
        let (flat, round) = self.torus();
        let far = flat + round + BOUND_MM;
        if apart > far * far {
            return true;
        }
        // top − lower(apart) ≤ best, without the root in it.
        let rise = best - top + round - BOUND_MM;
        let over = if flat == 0.0 { apart } else { (apart.sqrt() - flat).max(0.0).powi(2) };
        rise >= 0.0 && (round * round - over).max(0.0) <= rise * rise
    }

    /// Tip height at which the end, its axis through `at`, touches the triangle of this normal (see
    /// [`upward`]); none when it passes by. Edges below `above` are passed over.
    fn touch(&self, at: DVec2, t: &[DVec3; 3], normal: DVec3, above: f64) -> Option<f64> {
        let mut best = match *self {
            End::Ball { radius } => return ball_on(at, t, normal, radius, above),
            End::Taper { radius, .. } => {
                ball_on(at, t, normal, radius, above).unwrap_or(f64::NEG_INFINITY)
            }
            _ => f64::NEG_INFINITY,
        };
        if let Some(z) = self.on_face(at, t, normal) {
            best = best.max(z);
        }
        for i in 0..3 {
            let (a, b) = (t[i], t[(i + 1) % 3]);
            if a.z.max(b.z) <= above.max(best) {
                continue;
            }
            if let Some(z) = self.on_edge(at, a, b) {
                best = best.max(z);
            }
        }
        best.is_finite().then_some(best)
    }

    /// Of ends that are no ball.
    fn on_face(&self, at: DVec2, [a, b, c]: &[DVec3; 3], normal: DVec3) -> Option<f64> {
        if normal.z < UPRIGHT {
            return None;
        }
        if let End::Taper { widest, slope, .. } = *self {
            // Less steep faces are met by the ball, others by the cone's upper rim.
            let across = normal.truncate();
            let contact = at - across.normalize_or_zero() * widest;
            let steep = across.length() > slope * normal.z;
            let met = steep && inside(contact, a.truncate(), b.truncate(), c.truncate());
            let z = a.z - (contact - a.truncate()).dot(across) / normal.z;
            return met.then(|| z - self.lower(widest));
        }
        let (_, round) = self.torus();
        let contact = at - self.contact_to_axis(normal.truncate());
        if !inside(contact, a.truncate(), b.truncate(), c.truncate()) {
            return None;
        }
        let z = a.z - (contact - a.truncate()).dot(normal.truncate()) / normal.z;
        Some(z - round + round * normal.z)
    }

    /// Height of the end's surface over the tip, of a tapered end that of its cone and the disc under it.
    fn convex(&self, rho: f64) -> f64 {
        match *self {
            End::Taper { radius, slope, .. } => radius + slope * (rho - radius).max(0.0),
            _ => self.lower(rho),
        }
    }

    /// The corners are the ends of the edges. Of a tapered end this meets the cone alone.
    fn on_edge(&self, at: DVec2, a: DVec3, b: DVec3) -> Option<f64> {
        let radius = self.radius();
        let (p, way) = (a.truncate() - at, (b - a).truncate());
        let length = way.length();
        if length < 1e-12 {
            let rho = p.length();
            return (rho <= radius).then(|| a.z.max(b.z) - self.convex(rho));
        }
        let unit = way / length;
        // Along the edge from the foot of the axis: the part within the radius.
        let (start, apart) = (p.dot(unit), p.perp_dot(unit).abs());
        if apart > radius {
            return None;
        }
        let half = (radius * radius - apart * apart).sqrt();
        let (low, high) = (start.max(-half), (start + length).min(half));
        if low > high {
            return None;
        }
        let slope = (b.z - a.z) / length;
        let height =
            |x: f64| a.z + slope * (x - start) - self.convex((x * x + apart * apart).sqrt());
        let x = match *self {
            End::Flat { .. } => return Some(height_flat(a.z, slope, start, low, high)),
            End::Ball { .. } | End::Bull { .. } => highest(&height, low, high),
            // The same for the hyperbola that the cone cuts in it, or the rim of the disc below that.
            End::Taper { radius: disc, slope: steep, .. } => {
                let fall = (steep * steep - slope * slope).max(0.0).sqrt();
                let rim = (disc * disc - apart * apart).max(0.0).sqrt();
                let met = apart * slope.abs() / fall;
                slope.signum() * if met.is_nan() { rim } else { met.max(rim) }
            }
        };
        // At the ends the height may be steeper than the search is fine.
        Some(height(x.clamp(low, high)).max(height(low)).max(height(high)))
    }
}

/// [`End::touch`] of a ball, the end of most: without the roots that other ends ask for.
fn ball_on(at: DVec2, t: &[DVec3; 3], normal: DVec3, radius: f64, above: f64) -> Option<f64> {
    let mut best = f64::NEG_INFINITY;
    if normal.z >= UPRIGHT {
        let contact = at - normal.truncate() * radius;
        let [a, b, c] = t.map(DVec3::truncate);
        if inside(contact, a, b, c) {
            let rise = (contact - a).dot(normal.truncate()) / normal.z;
            best = t[0].z - rise - radius + radius * normal.z;
        }
    }
    for i in 0..3 {
        let (a, b) = (t[i], t[(i + 1) % 3]);
        if let Some(z) = ball_on_edge(at, a, b, radius, above.max(best)) {
            best = best.max(z);
        }
    }
    best.is_finite().then_some(best)
}

/// Height of a ball's tip that touches an edge, if it is above some height.
fn ball_on_edge(at: DVec2, a: DVec3, b: DVec3, radius: f64, above: f64) -> Option<f64> {
    let (p, way, rise) = (a.truncate() - at, (b - a).truncate(), b.z - a.z);
    let (r2, length2) = (radius * radius, way.length_squared());
    // A corner, or the upper one of an upright edge.
    let corner = |from: DVec2, z: f64| {
        let over = r2 - from.length_squared();
        (over >= 0.0).then(|| z - radius + over.sqrt())
    };
    if length2 < 1e-24 {
        return corner(p, a.z.max(b.z)).filter(|z| *z > above);
    }
    let aside = p.perp_dot(way);
    let half2 = r2 - aside * aside / length2;
    // The circle that the ball cuts in the edge's upright plane is nowhere higher than this over it.
    let room = above - a.z.max(b.z) + radius;
    if half2 < 0.0 || room >= 0.0 && half2 <= room * room {
        return None;
    }
    // It touches a line of this slope where its own slope is the same.
    let (half, space2) = (half2.sqrt(), length2 + rise * rise);
    let along = half * rise / (length2 * space2).sqrt() - p.dot(way) / length2;
    if along <= 0.0 {
        corner(p, a.z)
    } else if along >= 1.0 {
        corner(p + way, b.z)
    } else {
        Some(a.z + rise * along - radius + half * (length2 / space2).sqrt())
    }
}

/// Unit normal of a triangle that does not look down; zero where it has no area.
fn upward([a, b, c]: &[DVec3; 3]) -> DVec3 {
    let normal = (*b - *a).cross(*c - *a).normalize_or_zero();
    if normal.z < 0.0 { -normal } else { normal }
}

fn height_flat(z: f64, slope: f64, start: f64, low: f64, high: f64) -> f64 {
    z + slope * (if slope > 0.0 { high } else { low } - start)
}

/// Where a concave function is highest, by golden section.
fn highest(f: &dyn Fn(f64) -> f64, mut low: f64, mut high: f64) -> f64 {
    let golden = (5f64.sqrt() - 1.0) / 2.0;
    while high - low > EDGE_MM {
        let (x, y) = (high - golden * (high - low), low + golden * (high - low));
        if f(x) < f(y) { low = x } else { high = y }
    }
    (low + high) / 2.0
}

fn inside(p: DVec2, a: DVec2, b: DVec2, c: DVec2) -> bool {
    let side = |a: DVec2, b: DVec2| (b - a).perp_dot(p - a);
    let (s, t, u) = (side(a, b), side(b, c), side(c, a));
    (s >= 0.0 && t >= 0.0 && u >= 0.0) || (s <= 0.0 && t <= 0.0 && u <= 0.0)
}

/// Triangles under a grid of cells in (u, v).
pub struct DropCutter {
    triangles: Vec<[DVec3; 3]>,
    /// Height of the highest corner of each.
    tops: Vec<f64>,
    normals: Vec<DVec3>,
    origin: DVec2,
    cell: f64,
    n: [usize; 2],
    starts: Vec<u32>,
    /// Of each cell the highest first.
    lists: Vec<u32>,
}

/// Cells along one axis: more only cost memory, fewer hold too many triangles each, which matters
/// to ends as wide as the part.
const MOST_CELLS: f64 = 1024.0;
const LEAST_CELLS: f64 = 32.0;

impl DropCutter {
    /// Triangles given as (u, v, height), for ends of about this `radius`, mm.
    pub fn new(triangles: Vec<[DVec3; 3]>, radius: f64) -> DropCutter {
        let (mut lo, mut hi) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        for p in triangles.iter().flatten() {
            (lo, hi) = (lo.min(p.truncate()), hi.max(p.truncate()));
        }
        if triangles.is_empty() {
            (lo, hi) = (DVec2::ZERO, DVec2::ZERO);
        }
        let extent = (hi - lo).max_element();
        let cell = radius.min(extent / LEAST_CELLS).max(extent / MOST_CELLS).max(1e-6);
        let n = ((hi - lo) / cell).floor();
        let n = [n.x as usize + 1, n.y as usize + 1];
        let tops: Vec<f64> = triangles.iter().map(|[a, b, c]| a.z.max(b.z).max(c.z)).collect();
        let mut order: Vec<u32> = (0..triangles.len() as u32).collect();
        let top = |t: u32| tops[t as usize];
        order.sort_unstable_by(|a, b| top(*b).total_cmp(&top(*a)).then(a.cmp(b)));
        let normals = triangles.iter().map(upward).collect();
        let (starts, lists) = (Vec::new(), Vec::new());
        let mut drop = DropCutter { triangles, tops, normals, origin: lo, cell, n, starts, lists };
        let mut starts = vec![0u32; n[0] * n[1] + 1];
        for &t in &order {
            drop.cells_under(t).for_each(|c| starts[c + 1] += 1);
        }
        for c in 1..starts.len() {
            starts[c] += starts[c - 1];
        }
        let mut next = starts.clone();
        let mut lists = vec![0u32; starts[starts.len() - 1] as usize];
        for &t in &order {
            for c in drop.cells_under(t) {
                lists[next[c] as usize] = t;
                next[c] += 1;
            }
        }
        (drop.starts, drop.lists) = (starts, lists);
        drop
    }

    fn clamped(&self, p: DVec2) -> [usize; 2] {
        let g = ((p - self.origin) / self.cell).floor().max(DVec2::ZERO);
        [(g.x as usize).min(self.n[0] - 1), (g.y as usize).min(self.n[1] - 1)]
    }

    fn cells(&self, lo: DVec2, hi: DVec2) -> impl Iterator<Item = usize> + use<> {
        let ([i0, j0], [i1, j1], nx) = (self.clamped(lo), self.clamped(hi), self.n[0]);
        (j0..=j1).flat_map(move |j| (i0..=i1).map(move |i| i + nx * j))
    }

    fn cells_under(&self, t: u32) -> impl Iterator<Item = usize> + use<> {
        let [a, b, c] = self.triangles[t as usize].map(DVec3::truncate);
        self.cells(a.min(b).min(c), a.max(b).max(c))
    }

    /// Height of the tip that rests on the triangles with its axis through `at`; none where there
    /// is no triangle within the radius.
    pub fn height(&self, end: End, at: DVec2) -> Option<f64> {
        self.height_from(end, at, &mut None)
    }

    /// The same, with the triangle that a tip nearby rests on, which is likely to be this one's or
    /// nearly as high; then the one that this tip rests on.
    pub fn height_from(&self, end: End, at: DVec2, on: &mut Option<u32>) -> Option<f64> {
        let reach = DVec2::splat(end.radius());
        let ([i0, j0], [i1, j1]) = (self.clamped(at - reach), self.clamped(at + reach));
        let mut best = f64::NEG_INFINITY;
        if let Some(t) = *on {
            let (corners, normal) = (&self.triangles[t as usize], self.normals[t as usize]);
            best = end.touch(at, corners, normal, best).unwrap_or(best);
        }
        // Under the axis the tip is likely to touch; the others then need no look, most of them.
        let [i, j] = self.clamped(at);
        best = self.height_over([i, j], end, at, best, on);
        for other in (j0..=j1).flat_map(|j| (i0..=i1).map(move |i| [i, j])) {
            if other != [i, j] {
                best = self.height_over(other, end, at, best, on);
            }
        }
        best.is_finite().then_some(best)
    }

    /// Whether the tip that rests on the triangles is higher than `most`; what [`DropCutter::height`] says,
    /// sooner. `on` is a triangle that is likely to hold it up, then one that does.
    pub fn rests_over(&self, end: End, at: DVec2, most: f64, on: &mut Option<u32>) -> bool {
        if let Some(t) = *on {
            let (corners, normal) = (&self.triangles[t as usize], self.normals[t as usize]);
            if end.touch(at, corners, normal, most).is_some_and(|z| z > most) {
                return true;
            }
        }
        let reach = DVec2::splat(end.radius());
        let ([i0, j0], [i1, j1]) = (self.clamped(at - reach), self.clamped(at + reach));
        let mut cells = (j0..=j1).flat_map(|j| (i0..=i1).map(move |i| [i, j]));
        cells.any(|c| self.height_over(c, end, at, most, on) > most)
    }

    /// The greatest of a height and those of the triangles under a cell, and whose it is.
    fn height_over(
        &self,
        [i, j]: [usize; 2],
        end: End,
        at: DVec2,
        mut best: f64,
        on: &mut Option<u32>,
    ) -> f64 {
        let c = i + self.n[0] * j;
        let list = &self.lists[self.starts[c] as usize..self.starts[c + 1] as usize];
        let Some(&first) = list.first() else { return best };
        let from = self.origin + DVec2::new(i as f64, j as f64) * self.cell;
        if end.stays_under(best, self.tops[first as usize], at, from, from + self.cell) {
            return best;
        }
        for &t in list {
            let top = self.tops[t as usize];
            // The tip is never above the triangle's top; the others are lower still.
            if top <= best {
                break;
            }
            let corners = &self.triangles[t as usize];
            let [a, b, c] = corners.map(DVec3::truncate);
            if end.stays_under(best, top, at, a.min(b).min(c), a.max(b).max(c)) {
                continue;
            }
            let touched = end.touch(at, corners, self.normals[t as usize], best);
            if let Some(z) = touched.filter(|z| *z > best) {
                (best, *on) = (z, Some(t));
            }
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const ENDS: [End; 5] = [
        End::Ball { radius: 2.0 },
        End::Flat { radius: 2.0 },
        End::Bull { radius: 2.0, corner: 0.5 },
        End::Bull { radius: 2.0, corner: 2.0 },
        End::Taper { radius: 0.8, widest: 2.0, slope: 3.0 },
    ];

    /// What the end without its outside does not meet, the end meets no deeper than that.
    #[test]
    fn an_inset_end_leaves_what_is_met_no_deeper() {
        for end in ENDS {
            for by in [0.0, 0.045, 0.2, 0.6] {
                let inset = end.inset(by);
                let mut deepest: f64 = 0.0;
                for (i, j) in (0..=60).flat_map(|i| (0..=60).map(move |j| (i, j))) {
                    let (rho, z) = (f64::from(i) * 0.04, f64::from(j) * 0.04);
                    if rho > inset.radius() || z - by < inset.lower(rho) {
                        deepest = deepest.max(-end.distance(rho, z));
                    }
                }
                assert!(deepest <= by + 1e-9, "{end:?} less {by}: {deepest}");
                // All of it is given, to what the points tell.
                assert!(deepest >= 0.7 * by - 0.04, "{end:?} less {by}: {deepest}");
            }
        }
    }

    /// The definition: the greatest height less the end over points of the triangle.
    fn by_points(end: End, at: DVec2, [a, b, c]: &[DVec3; 3], n: usize) -> f64 {
        let mut best = f64::NEG_INFINITY;
        for i in 0..=n {
            for j in 0..=n - i {
                let (s, t) = (i as f64 / n as f64, j as f64 / n as f64);
                let p = *a + (*b - *a) * s + (*c - *a) * t;
                let rho = p.truncate().distance(at);
                if rho <= end.radius() {
                    best = best.max(p.z - end.lower(rho));
                }
            }
        }
        best
    }

    proptest! {
        #[test]
        fn the_height_is_the_greatest_over_the_points(
            v in prop::array::uniform9(-4.0f64..4.0), x in -2.0f64..2.0, y in -2.0f64..2.0,
        ) {
            let t = [DVec3::new(v[0], v[1], v[2]), DVec3::new(v[3], v[4], v[5]),
                DVec3::new(v[6], v[7], v[8])];
            let drop = DropCutter::new(vec![t], 1.0);
            for end in ENDS {
                let at = DVec2::new(x, y);
                let sampled = by_points(end, at, &t, 160);
                let exact = drop.height(end, at).unwrap_or(f64::NEG_INFINITY);
                prop_assert!(exact >= sampled - 1e-7, "{end:?}: {exact} {sampled}");
                // Points are at most 0.07 mm apart across; at the rim of a steep face they miss.
                if exact.is_finite() && sampled.is_finite() && end != ENDS[1] {
                    let steep = (t[1] - t[0]).cross(t[2] - t[0]).normalize_or_zero().z.abs() < 0.3;
                    prop_assert!(steep || exact - sampled < 0.35, "{end:?}: {exact} {sampled}");
                }
            }
        }
    }

    /// Whatever the bounds pass over is lower: the height is that of all triangles, to the last bit.
    #[test]
    fn the_height_is_that_of_every_triangle_looked_at() {
        let mut rng = crate::base::rng(7, 0);
        let mut number = |from: f64, to: f64| rand::RngExt::random_range(&mut rng, from..to);
        let triangles: Vec<[DVec3; 3]> = (0..300)
            .map(|_| {
                let middle = DVec3::new(number(-20.0, 20.0), number(-9.0, 9.0), number(-3.0, 3.0));
                [0; 3].map(|_| {
                    middle + DVec3::new(number(-2.0, 2.0), number(-2.0, 2.0), number(-2.0, 2.0))
                })
            })
            .collect();
        for radius in [0.4, 2.0, 9.0, 60.0] {
            let drop = DropCutter::new(triangles.clone(), radius);
            let bull = End::Bull { radius, corner: radius / 3.0 };
            let taper = End::Taper { radius: radius / 3.0, widest: radius, slope: 5.0 };
            for end in [End::Ball { radius }, End::Flat { radius }, bull, taper] {
                let mut on = None;
                for _ in 0..60 {
                    let at = DVec2::new(number(-30.0, 30.0), number(-12.0, 12.0));
                    let touch = |t: &[DVec3; 3]| end.touch(at, t, upward(t), f64::NEG_INFINITY);
                    let all = triangles.iter().filter_map(touch);
                    let all = all.reduce(f64::max);
                    assert_eq!(drop.height(end, at), all, "{end:?} at {at}");
                    // Whatever tip the search begins with.
                    assert_eq!(drop.height_from(end, at, &mut on), all, "{end:?} at {at}");
                    let z = all.unwrap_or(0.0);
                    for most in [z - 2.0, z - 1e-9, z, z + 1e-9, z + 2.0, f64::INFINITY] {
                        let over = drop.rests_over(end, at, most, &mut on);
                        assert_eq!(over, all.is_some_and(|z| z > most), "{end:?} at {at}");
                    }
                }
            }
        }
    }

    #[test]
    fn the_highest_tip_within_a_distance_is_at_that_distance() {
        for end in ENDS {
            for (rho, within) in [(0.0, 0.1), (0.7, 0.2), (1.9, 0.3), (2.1, 0.3), (2.1, 0.05)] {
                let found = end.highest_tip(rho, 5.0, within);
                // A cone widens on and on.
                let widens = matches!(end, End::Taper { .. });
                assert_eq!(found.is_some(), widens || rho < 2.0 + within);
                let Some(tip) = found else { continue };
                assert!((end.distance(rho, 5.0 - tip) - within).abs() < 1e-12, "{end:?} {rho}");
                assert!(end.distance(rho, 5.0 - tip + 0.01) < within);
            }
        }
    }

    #[test]
    fn a_triangle_without_area_is_touched_along_its_edge() {
        let top = DVec3::new(0.0, 0.4387769796140071, 2.4203529793814607);
        let t = [DVec3::ZERO, top, DVec3::ZERO];
        let drop = DropCutter::new(vec![t], 1.0);
        for end in ENDS {
            let sampled = by_points(end, DVec2::ZERO, &t, 2000);
            let exact = drop.height(end, DVec2::ZERO).expect("it is under the end");
            assert!((exact - sampled).abs() < 0.01, "{end:?}: {exact} {sampled}");
        }
    }

    #[test]
    fn contacts_by_hand() {
        let ball = End::Ball { radius: 2.0 };
        // A plane at 45°: the ball's centre is r away, r√2 above it along the axis.
        let far = 50.0;
        let slope = [
            DVec3::new(-far, -far, -far),
            DVec3::new(far, -far, far),
            DVec3::new(0.0, 2.0 * far, 0.0),
        ];
        let on = DropCutter::new(vec![slope], 5.0).height(ball, DVec2::ZERO).unwrap();
        assert!((on - (2.0 * 2f64.sqrt() - 2.0)).abs() < 1e-12, "{on}");
        let flat = DropCutter::new(vec![slope], 5.0).height(End::Flat { radius: 2.0 }, DVec2::ZERO);
        assert!((flat.unwrap() - 2.0).abs() < 1e-12);
        // A corner 1 mm off the axis: 2 − √3 above the tip.
        let spike =
            [DVec3::new(1.0, 0.0, 5.0), DVec3::new(1.0, 0.1, 0.0), DVec3::new(1.1, 0.0, 0.0)];
        let drop = DropCutter::new(vec![spike], 1.0);
        assert!((drop.height(ball, DVec2::ZERO).unwrap() - (3.0 + 3f64.sqrt())).abs() < 1e-12);
        assert_eq!(drop.height(ball, DVec2::new(9.0, 0.0)), None);
        assert_eq!(DropCutter::new(Vec::new(), 1.0).height(ball, DVec2::ZERO), None);
    }

    /// Greatest height that a ball at these tips leaves over a surface, in their middle third.
    fn ridge(radius: f64, surface: impl Fn(f64) -> f64, tips: &[(f64, f64)]) -> f64 {
        let left = |x: f64| {
            let swept = tips
                .iter()
                .filter(|(u, _)| (x - u).abs() <= radius)
                .map(|(u, z)| z + radius - (radius * radius - (x - u).powi(2)).sqrt());
            swept.fold(f64::INFINITY, f64::min) - surface(x)
        };
        let third = tips.len() / 3;
        let (a, b) = (tips[third].0, tips[tips.len() - third].0);
        (0..=4000).map(|i| left(a + (b - a) * f64::from(i) / 4000.0)).fold(0.0, f64::max)
    }

    #[test]
    fn scallops_on_planes_and_spheres_match_the_formula() {
        let (radius, step) = (1.5, 0.4);
        let end = End::Ball { radius };
        // c = r − √(r² − (s/2)²) across a plane; s is measured along the surface.
        let want = |s: f64| radius - (radius * radius - s * s / 4.0).sqrt();
        for degrees in [0.0f64, 20.0, 45.0] {
            let slope = degrees.to_radians().tan();
            let f = 60.0;
            let plane = [
                DVec3::new(-f, -f, -f * slope),
                DVec3::new(f, -f, f * slope),
                DVec3::new(0.0, 3.0 * f, 0.0),
            ];
            let drop = DropCutter::new(vec![plane], 5.0);
            let across = step * degrees.to_radians().cos();
            let tips: Vec<(f64, f64)> = (-30..=30)
                .map(|i| f64::from(i) * across)
                .map(|u| (u, drop.height(end, DVec2::new(u, 0.0)).unwrap()))
                .collect();
            let upright = ridge(radius, |x| x * slope, &tips);
            let found = upright * degrees.to_radians().cos();
            assert!((found - want(step)).abs() < 2e-4, "{degrees}°: {found} {}", want(step));
        }
        // A sphere of radius R: the ball's centres lie on R + r, and the ridge between two of them,
        // an angle t apart, at (R + r) cos t/2 − √(r² − (R + r)² sin² t/2) − R.
        let big = 20.0f64;
        let at = |i: i32, j: i32| {
            let (u, v) = (f64::from(i) * 0.05, f64::from(j) * 0.1);
            DVec3::new(u, v, (big * big - u * u - v * v).sqrt())
        };
        let mut triangles = Vec::new();
        for (i, j) in (-100..100).flat_map(|i| (-20..20).map(move |j| (i, j))) {
            triangles.push([at(i, j), at(i + 1, j), at(i, j + 1)]);
            triangles.push([at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]);
        }
        let drop = DropCutter::new(triangles, 1.0);
        let turn = step / big;
        let tips: Vec<(f64, f64)> = (-10..=10)
            .map(|i| (big + radius) * (f64::from(i) * turn).sin())
            .map(|u| (u, drop.height(end, DVec2::new(u, 0.0)).unwrap()))
            .collect();
        let found = ridge(radius, |x| (big * big - x * x).sqrt(), &tips);
        let (sin, cos) = (turn / 2.0).sin_cos();
        let centre = big + radius;
        let wanted = centre * cos - (radius.powi(2) - (centre * sin).powi(2)).sqrt() - big;
        assert!((found - wanted).abs() < 5e-4, "{found} {wanted}");
    }
}
