//! What the end of a cutter sweeps along straight moves, and how far points are from that.
//!
//! Method: moves are listed in the square cells they cross, the lowest first; along a move the distance
//! from a point to the end is a convex function, found by golden section.
//!
//! Guarantees: distances outside what is swept to [`SEARCH_MM`], as long as they are sought up to the
//! `best` given; above the edge nothing is swept. Not guaranteed: the depth inside beside the
//! edge's upper rim, which is that to the nearer of the two; the least along a move of a tapered end, whose distance is
//! only nearly convex, since its cone meets its ball at an angle.

use super::cells::Cells;
use super::drop::End;
use crate::base::{DVec2, DVec3};

/// Width at which the search along a move stops, mm.
const SEARCH_MM: f64 = 1e-3;

/// Side of the cells that moves are listed in, mm.
const CELL_MM: f64 = 1.0;

/// Cutting moves of one tool in (u, v, height).
pub(crate) struct Swept {
    end: End,
    /// Height of the edge over the tip, mm.
    edge: f64,
    cells: Cells,
    /// Moves that cross each cell, lowest first.
    lists: Vec<Vec<Across>>,
    moves: Vec<[DVec3; 2]>,
}

/// What is looked at of most moves: where one lies across, and how low.
#[derive(Clone, Copy)]
struct Across {
    from: DVec2,
    way: DVec2,
    /// 1 / length² of the way.
    inverse: f64,
    low: f64,
    index: u32,
}

impl Across {
    fn of(index: u32, [a, b]: [DVec3; 2]) -> Across {
        let way = (b - a).truncate();
        let inverse = 1.0 / way.length_squared().max(1e-18);
        Across { from: a.truncate(), way, inverse, low: a.z.min(b.z), index }
    }

    /// Squared distance of a place from the way.
    fn apart_squared(&self, at: DVec2) -> f64 {
        let by = at - self.from;
        let t = (by.dot(self.way) * self.inverse).clamp(0.0, 1.0);
        (by - self.way * t).length_squared()
    }
}

impl Swept {
    /// None without moves. `edge` is the tool's active length, mm.
    pub fn of(end: End, edge: f64, moves: Vec<[DVec3; 2]>) -> Option<Swept> {
        let corner = |pick: fn(DVec2, DVec2) -> DVec2, start: DVec2| {
            moves.iter().flatten().fold(start, |a, p| pick(a, p.truncate()))
        };
        let (lo, hi) =
            (corner(DVec2::min, DVec2::INFINITY), corner(DVec2::max, DVec2::NEG_INFINITY));
        if moves.is_empty() {
            return None;
        }
        let cells = Cells::over(lo, hi, CELL_MM);
        let lists = vec![Vec::new(); cells.count()];
        let mut swept = Swept { end, edge, cells, lists, moves };
        for i in 0..swept.moves.len() {
            swept.list(i as u32);
        }
        for list in &mut swept.lists {
            list.sort_by(|i, j| i.low.total_cmp(&j.low));
        }
        Some(swept)
    }

    /// Appends a move to the lists of the cells it crosses.
    fn list(&mut self, i: u32) {
        let [a, b] = self.moves[i as usize];
        let across = Across::of(i, [a, b]);
        let count = (2.0 * a.truncate().distance(b.truncate()) / CELL_MM).ceil().max(1.0);
        for k in 0..=count as usize {
            let list = self.cells.at(a.lerp(b, k as f64 / count).truncate());
            let list = list.and_then(|at| self.lists.get_mut(at));
            if let Some(list) = list.filter(|l| l.last().is_none_or(|m| m.index != i)) {
                list.push(across);
            }
        }
    }

    /// The lesser of `best` and the distance from a point to what is swept, negative inside.
    pub fn distance(&self, p: DVec3, best: f64) -> f64 {
        self.least(p, self.around(p, best), best, f64::NEG_INFINITY)
    }

    /// Whether a point is no farther than `enough` from what is swept; the moves over `first` are the
    /// likeliest to come that near.
    pub fn is_within(&self, p: DVec3, enough: f64, first: DVec2) -> bool {
        // No distance beyond what is enough is of interest.
        let best = enough + SEARCH_MM;
        let likely = self.cells.within(first - CELL_MM / 2.0, first + CELL_MM / 2.0);
        self.least(p, likely, best, enough) <= enough
            || self.least(p, self.around(p, best), best, enough) <= enough
    }

    /// Cells of all moves that may come nearer to a point than `best`.
    fn around(&self, p: DVec3, best: f64) -> impl Iterator<Item = usize> + use<> {
        // Half a cell for moves that cut a corner between two of their points.
        let reach = self.end.radius() + best.max(0.0) + CELL_MM;
        self.cells.within(p.truncate() - reach, p.truncate() + reach)
    }

    /// The least of `best` and the distances to the moves over some cells, or one that is `enough`.
    fn least(
        &self,
        p: DVec3,
        cells: impl Iterator<Item = usize>,
        mut best: f64,
        enough: f64,
    ) -> f64 {
        let (uv, radius) = (p.truncate(), self.end.radius());
        for at in cells {
            for m in &self.lists[at] {
                // No point of the end is lower than its tip, none farther out than its radius.
                if m.low - p.z >= best {
                    break;
                }
                let far = radius + best;
                if far > 0.0 && m.apart_squared(uv) < far * far {
                    let [a, b] = self.moves[m.index as usize];
                    best = best.min(self.along(p, a, b));
                    if best <= enough {
                        return best;
                    }
                }
            }
        }
        best
    }

    /// Least distance from a point to the edge along a move.
    fn along(&self, p: DVec3, a: DVec3, b: DVec3) -> f64 {
        const GOLDEN: f64 = 0.618_033_988_749_894_9;
        if a.z == b.z {
            // Of places at one height the nearest across is the nearest.
            let tip = nearest(p.truncate(), a.truncate(), b.truncate()).extend(a.z);
            return from_edge(self.end, self.edge, tip, p);
        }
        let (low, high) = (a.z.min(b.z), a.z.max(b.z));
        if p.z - low <= self.edge {
            // Outside, and below the edge's upper rim all along; inside, that may be nearer.
            let beside = match self.end {
                End::Ball { radius } => {
                    Some(from_upright(p, a.with_z(a.z + radius), b.with_z(b.z + radius)) - radius)
                }
                end => end
                    .cylinder_from()
                    .filter(|from| p.z - high >= *from)
                    .map(|_| apart(p.truncate(), a.truncate(), b.truncate()) - self.end.radius()),
            };
            if let Some(beside) = beside.filter(|d| *d >= 0.0) {
                return beside;
            }
        }
        let at = |t: f64| from_edge(self.end, self.edge, a.lerp(b, t), p);
        let (mut low, mut high, length) = (0.0, 1.0, a.distance(b));
        let (mut t0, mut t1) = (1.0 - GOLDEN, GOLDEN);
        let (mut d0, mut d1) = (at(t0), at(t1));
        while (high - low) * length > SEARCH_MM {
            if d0 < d1 {
                (high, t1, d1) = (t1, t0, d0);
                t0 = high - GOLDEN * (high - low);
                d0 = at(t0);
            } else {
                (low, t0, d0) = (t0, t1, d1);
                t1 = low + GOLDEN * (high - low);
                d1 = at(t1);
            }
        }
        d0.min(d1).min(at(0.0)).min(at(1.0))
    }
}

/// Signed distance from `p` to an end, of an edge so long, with its tip at `tip`.
pub(crate) fn from_edge(end: End, edge: f64, tip: DVec3, p: DVec3) -> f64 {
    let (rho, z) = (p.truncate().distance(tip.truncate()), p.z - tip.z);
    if let Some(rim) = end.rim_nearest(edge, rho, z) {
        return (rho - rim).hypot(z - edge);
    }
    let (beside, over) = (end.distance(rho, z), z - edge);
    if beside > 0.0 && over > 0.0 { beside.hypot(over) } else { beside.max(over) }
}

fn apart(p: DVec2, a: DVec2, b: DVec2) -> f64 {
    nearest(p, a, b).distance(p)
}

/// The place from a to b that is nearest to p.
fn nearest(p: DVec2, a: DVec2, b: DVec2) -> DVec2 {
    let way = b - a;
    let t = (p - a).dot(way) / way.length_squared().max(1e-18);
    a + way * t.clamp(0.0, 1.0)
}

/// Distance from a point to all that is upright over the way from a to b: a ball and the cylinder over it are
/// what lies within a radius of that.
fn from_upright(p: DVec3, a: DVec3, b: DVec3) -> f64 {
    let way = b - a;
    let across = way.truncate().length();
    if across < 1e-9 {
        let over = (p.z - a.z.min(b.z)).min(0.0);
        return p.truncate().distance(a.truncate()).hypot(over);
    }
    // In the upright plane of the way, and off it.
    let unit = way.truncate() / across;
    let from = p.truncate() - a.truncate();
    let (x, off) = (from.dot(unit), from.perp_dot(unit));
    let at = x.clamp(0.0, across);
    if p.z - a.z >= at * way.z / across {
        return off.hypot(x - at);
    }
    let t = (x * across + (p.z - a.z) * way.z) / way.length_squared();
    a.lerp(b, t.clamp(0.0, 1.0)).distance(p)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::RngExt;

    /// The definition, on points along every move.
    #[test]
    fn distances_are_those_to_the_nearest_of_many_tips() {
        let mut rng = crate::base::rng(5, 0);
        let mut point = |size: f64| {
            let mut x = || rng.random_range(-size..size);
            DVec3::new(x(), x(), x())
        };
        let moves: Vec<[DVec3; 2]> = (0..40)
            .map(|_| {
                let a = point(8.0);
                [a, a + point(1.5)]
            })
            .collect();
        let taper = End::Taper { radius: 0.6, widest: 1.5, slope: 2.5 };
        for end in [End::Ball { radius: 1.5 }, End::Bull { radius: 1.5, corner: 0.4 }, taper] {
            let swept = Swept::of(end, 2.5, moves.clone()).unwrap();
            for _ in 0..300 {
                let p = point(9.0);
                let tips = moves
                    .iter()
                    .flat_map(|[a, b]| (0..=400).map(|i| a.lerp(*b, f64::from(i) / 400.0)));
                let want = tips.map(|t| from_edge(end, 2.5, t, p)).fold(2.0, f64::min);
                let found = swept.distance(p, 2.0);
                // Tips tried are at most 6.5 µm apart.
                assert!((found - want).abs() < 0.01, "{end:?} at {p}: {found} {want}");
                let near = swept.is_within(p, 0.2, p.truncate());
                assert!(near == (found <= 0.2), "{end:?} at {p}: {found}");
            }
        }
    }

    #[test]
    fn nothing_is_swept_above_the_edge() {
        let ball = End::Ball { radius: 2.0 };
        let tip = DVec3::new(0.0, 0.0, 1.0);
        let at = |x: f64, z: f64| from_edge(ball, 6.0, tip, DVec3::new(x, 0.0, z));
        assert!((at(3.0, 5.0) - 1.0).abs() < 1e-12 && (at(1.0, 5.0) + 1.0).abs() < 1e-12);
        assert!((at(1.0, 9.0) - 2.0).abs() < 1e-12);
        assert!((at(5.0, 11.0) - 5.0).abs() < 1e-12);
        assert!(Swept::of(ball, 6.0, Vec::new()).is_none());
    }
}
