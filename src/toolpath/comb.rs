//! Ways of the nozzle that stay inside the part.
//!
//! Method: where the straight way leaves the outlines, it follows the outline it crossed, the shorter way
//! round, to where it comes in again. Guarantees: of a way between two points of one island every
//! part lies inside the outlines or on them. Not guaranteed: the shortest such way; ways between
//! islands, and those more than [`LONGEST`] times as long as the straight one, stay straight.

use super::slice::Outline;
use crate::base::DVec2;

/// Detours longer than this many times the straight way cost more time than their ooze is worth.
const LONGEST: f64 = 3.0;

/// Crossing of the way with an outline.
#[derive(Clone, Copy)]
struct Crossing {
    /// Share of the way.
    t: f64,
    outline: usize,
    /// Index of the edge that is crossed.
    edge: usize,
}

/// What travels keep inside of.
pub(super) struct Islands {
    outlines: Vec<Outline>,
    boxes: Vec<(DVec2, DVec2)>,
}

/// A way whose box is farther than this from that of an outline does not cross it, mm: far above
/// what a crossing's place is rounded by.
const ASIDE_MM: f64 = 1e-3;

impl Islands {
    pub fn new(outlines: Vec<Outline>) -> Islands {
        let empty = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        let bounds = |o: &Outline| o.iter().fold(empty, |(lo, hi), p| (lo.min(*p), hi.max(*p)));
        let boxes = outlines.iter().map(bounds).collect();
        Islands { outlines, boxes }
    }

    /// Points to go through between `from` and `to`; none when the straight way will do.
    pub fn comb(&self, from: DVec2, to: DVec2) -> Vec<DVec2> {
        let crossings = self.crossings(from, to);
        if crossings.is_empty() {
            return Vec::new();
        }
        let mut via = Vec::new();
        let mut at = 0;
        while at < crossings.len() {
            let out = crossings[at];
            // The last time the same outline is met: all between is a way round it.
            let back = crossings.iter().rposition(|c| c.outline == out.outline).unwrap_or(at);
            if back == at {
                // Into another island.
                return Vec::new();
            }
            let point = |c: Crossing| from.lerp(to, c.t);
            via.push(point(out));
            via.extend(around(&self.outlines[out.outline], out, crossings[back], point));
            via.push(point(crossings[back]));
            at = back + 1;
        }
        let whole = [&[from][..], &via, &[to]].concat();
        let length: f64 = whole.windows(2).map(|w| w[0].distance(w[1])).sum();
        if length > LONGEST * from.distance(to) { Vec::new() } else { via }
    }

    fn crossings(&self, from: DVec2, to: DVec2) -> Vec<Crossing> {
        let low = from.min(to) - ASIDE_MM;
        let high = from.max(to) + ASIDE_MM;
        let mut found = Vec::new();
        for (outline, (lo, hi)) in self.boxes.iter().enumerate() {
            if lo.cmple(high).all() && hi.cmpge(low).all() {
                crossed(from, to, outline, &self.outlines[outline], &mut found);
            }
        }
        found.sort_by(|a, b| a.t.total_cmp(&b.t).then(a.outline.cmp(&b.outline)));
        found
    }
}

/// Adds the crossings of a way with one outline.
fn crossed(from: DVec2, to: DVec2, outline: usize, o: &Outline, found: &mut Vec<Crossing>) {
    let way = to - from;
    for edge in 0..o.len() {
        let (a, b) = (o[edge], o[(edge + 1) % o.len()]);
        // Which side of the way the corners lie on; half-open, so that a corner counts once.
        let (sa, sb) = (way.perp_dot(a - from), way.perp_dot(b - from));
        if (sa > 0.0) == (sb > 0.0) {
            continue;
        }
        let q = a.lerp(b, sa / (sa - sb));
        let t = (q - from).dot(way) / way.length_squared();
        // Ends lie on the outline itself: what meets them there is no crossing.
        if (1e-6..=1.0 - 1e-6).contains(&t) {
            found.push(Crossing { t, outline, edge });
        }
    }
}

/// Corners of an outline between two crossings, the shorter way round.
fn around(
    o: &Outline,
    first: Crossing,
    last: Crossing,
    point: impl Fn(Crossing) -> DVec2,
) -> Vec<DVec2> {
    let n = o.len();
    let count = (last.edge + n - first.edge) % n;
    let forward: Vec<DVec2> = (1..=count).map(|i| o[(first.edge + i) % n]).collect();
    let backward: Vec<DVec2> = (0..n - count).map(|i| o[(first.edge + n - i) % n]).collect();
    let length = |via: &[DVec2]| {
        let whole = [&[point(first)][..], via, &[point(last)]].concat();
        whole.windows(2).map(|w| w[0].distance(w[1])).sum::<f64>()
    };
    // On one edge the forward way is the straight one; the backward way goes all round.
    if length(&forward) <= length(&backward) { forward } else { backward }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn horseshoe() -> Outline {
        let points = [(0., 0.), (10., 0.), (10., 10.), (6., 10.), (6., 4.), (4., 4.), (4., 10.)];
        points.into_iter().chain([(0.0, 10.0)]).map(DVec2::from).collect()
    }

    fn inside(p: DVec2, o: &Outline) -> bool {
        let crossed = |i: usize| {
            let (a, b) = (o[i], o[(i + 1) % o.len()]);
            (a.y > p.y) != (b.y > p.y) && p.x < a.x + (p.y - a.y) / (b.y - a.y) * (b.x - a.x)
        };
        (0..o.len()).filter(|i| crossed(*i)).count() % 2 == 1
    }

    fn comb(from: DVec2, to: DVec2, outlines: &[Outline]) -> Vec<DVec2> {
        Islands::new(outlines.to_vec()).comb(from, to)
    }

    #[test]
    fn outlines_that_are_passed_over_are_not_crossed() {
        let mut rng = crate::base::rng(5, 0);
        let mut number = |far: f64| rand::RngExt::random_range(&mut rng, -far..far);
        let outline = |number: &mut dyn FnMut(f64) -> f64| -> Outline {
            let middle = DVec2::new(number(9.0), number(9.0));
            (0..7).map(|_| middle + DVec2::new(number(3.0), number(3.0))).collect()
        };
        let islands = Islands::new((0..40).map(|_| outline(&mut number)).collect());
        for _ in 0..300 {
            let (from, to) = (DVec2::new(number(9.0), number(9.0)), DVec2::new(number(9.0), 1.0));
            let mut all = Vec::new();
            for (i, o) in islands.outlines.iter().enumerate() {
                crossed(from, to, i, o, &mut all);
            }
            all.sort_by(|a, b| a.t.total_cmp(&b.t).then(a.outline.cmp(&b.outline)));
            let key = |c: &Crossing| (c.t, c.outline, c.edge);
            let found = islands.crossings(from, to);
            assert!(found.iter().map(key).eq(all.iter().map(key)));
        }
    }

    #[test]
    fn a_way_across_a_gap_goes_round_it() {
        let shoe = horseshoe();
        let (from, to) = (DVec2::new(2.0, 6.0), DVec2::new(8.0, 6.5));
        let via = comb(from, to, std::slice::from_ref(&shoe));
        let whole = [&[from][..], &via, &[to]].concat();
        assert!(whole.len() > 3, "{whole:?}");
        for w in whole.windows(2) {
            for k in 0..=20 {
                let p = w[0].lerp(w[1], f64::from(k) / 20.0);
                let shifted = [(1., 1.), (-1., 1.), (1., -1.), (-1., -1.)];
                let near = shifted.iter().any(|s| inside(p + DVec2::from(*s) * 1e-6, &shoe));
                assert!(near, "{p} is outside: {whole:?}");
            }
        }
        // A way that is free stays straight, and so does one that would be four times as long.
        assert!(
            comb(DVec2::new(1.0, 1.0), DVec2::new(9.0, 2.0), std::slice::from_ref(&shoe))
                .is_empty()
        );
        let (a, b) = (DVec2::new(3.9, 9.9), DVec2::new(6.1, 9.9));
        assert!(comb(a, b, std::slice::from_ref(&shoe)).is_empty());
    }

    #[test]
    fn islands_are_reached_straight() {
        let square = |x: f64| -> Outline {
            [(0., 0.), (2., 0.), (2., 2.), (0., 2.)].map(|(a, b)| DVec2::new(a + x, b)).to_vec()
        };
        let via = comb(DVec2::new(1.0, 1.0), DVec2::new(6.0, 1.0), &[square(0.0), square(5.0)]);
        assert!(via.is_empty());
    }
}
