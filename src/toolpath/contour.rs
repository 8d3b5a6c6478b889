//! Contour-parallel paths over a set of lattice cells.
//!
//! Method: the distance of every cell to the set's outside (chamfer, in cells) is cut into bands
//! one cell thick, a stepover apart, the first along the rim; each band is traced into chains of
//! neighbouring cells, turned so that what lies outside the set is on the right: with a spindle that
//! turns clockwise, that is climb milling. Guarantees: every cell of the set is within a stepover
//! plus one cell of a chain; chains never leave the set. Not guaranteed: the sense of chains that
//! have the outside on both sides.

use super::image::{Cell, Lattice};

/// Cost of a diagonal step in the chamfer distance; 1 for a straight one.
const DIAGONAL: f32 = std::f32::consts::SQRT_2;

/// Distance to the nearest cell outside the set, in cells: 1 on the rim, 0 outside.
fn distance(lattice: &Lattice, set: &[bool], window: [Cell; 2]) -> Vec<f32> {
    let [nx, ny] = lattice.n;
    let mut d = vec![0.0f32; set.len()];
    let get = |d: &[f32], i: i64, j: i64| {
        let inside = i >= 0 && j >= 0 && i < nx as i64 && j < ny as i64;
        if inside { d[i as usize + nx * j as usize] } else { 0.0 }
    };
    let of_set = |k: &usize| set[*k];
    within(lattice, window).filter(of_set).for_each(|k| d[k] = f32::INFINITY);
    let mut sweep = |k: usize, sign: i64| {
        let (i, j) = ((k % nx) as i64, (k / nx) as i64);
        let back =
            [(sign, 0, 1.0), (0, sign, 1.0), (sign, sign, DIAGONAL), (-sign, sign, DIAGONAL)];
        let best = back.iter().map(|(di, dj, c)| get(&d, i + di, j + dj) + c);
        d[k] = best.fold(d[k], f32::min);
    };
    within(lattice, window).filter(of_set).for_each(|k| sweep(k, -1));
    within(lattice, window).rev().filter(of_set).for_each(|k| sweep(k, 1));
    d
}

/// First and last column and row that a set has cells in: mostly few of a lattice's.
fn window(lattice: &Lattice, set: &[bool]) -> Option<[Cell; 2]> {
    let nx = lattice.n[0].max(1);
    let mut found: Option<[Cell; 2]> = None;
    for (j, row) in set.chunks(nx).enumerate() {
        let Some(first) = row.iter().position(|s| *s) else { continue };
        let last = row.iter().rposition(|s| *s).unwrap_or(first);
        let [low, high] = found.get_or_insert([[first, j], [last, j]]);
        (low[0], high[0], high[1]) = (low[0].min(first), high[0].max(last), j);
    }
    found
}

/// Indices of the cells of a window, row by row.
fn within(
    lattice: &Lattice,
    [low, high]: [Cell; 2],
) -> impl DoubleEndedIterator<Item = usize> + use<> {
    let nx = lattice.n[0];
    (low[1]..=high[1]).flat_map(move |j| (low[0] + nx * j)..=(high[0] + nx * j))
}

/// A lattice's part around some of its cells and one more on each side.
struct Part {
    /// As a lattice of its own.
    lattice: Lattice,
    low: Cell,
    /// The cells, as indices of the part, in their order.
    cells: Vec<usize>,
}

impl Part {
    fn around(lattice: &Lattice, cells: &[usize]) -> Part {
        let (mut low, mut high) = ([usize::MAX; 2], [0; 2]);
        for c in cells.iter().map(|k| lattice.cell_of_index(*k)) {
            low = [0, 1].map(|a| c[a].min(low[a]));
            high = [0, 1].map(|a| c[a].max(high[a]));
        }
        let low = [0, 1].map(|a| low[a].saturating_sub(1).min(high[a]));
        let n = [0, 1].map(|a| (high[a] + 2).min(lattice.n[a]) - low[a]);
        let part = Lattice { origin: lattice.uv(low), n, ..*lattice };
        let moved = |k: &usize| {
            let c = lattice.cell_of_index(*k);
            part.index([c[0] - low[0], c[1] - low[1]])
        };
        Part { cells: cells.iter().map(moved).collect(), lattice: part, low }
    }
}

/// The same as [`chains`] over a set that is given by its cells, without a look at the others.
pub(super) fn chains_over(lattice: &Lattice, cells: &[usize], stepover: f64) -> Vec<Vec<Cell>> {
    if cells.is_empty() {
        return Vec::new();
    }
    let Part { lattice: part, low, cells } = Part::around(lattice, cells);
    let mut set = vec![false; part.cells()];
    cells.iter().for_each(|k| set[*k] = true);
    let mut all = chains(&part, &set, stepover);
    all.iter_mut().flatten().for_each(|c| *c = [c[0] + low[0], c[1] + low[1]]);
    all
}

/// The connected parts of some cells, in the order of their first ones; of each its cells in their order.
pub(super) fn parts(lattice: &Lattice, cells: &[usize]) -> Vec<Vec<usize>> {
    const NONE: u32 = u32::MAX;
    if cells.is_empty() {
        return Vec::new();
    }
    let Part { lattice: part, cells: moved, .. } = Part::around(lattice, cells);
    // Which part a cell is of; that of none is one more than there can be.
    let mut of = vec![NONE; part.cells()];
    moved.iter().for_each(|k| of[*k] = NONE - 1);
    let (mut count, mut open) = (0u32, Vec::new());
    for first in moved.iter().copied() {
        if of[first] != NONE - 1 {
            continue;
        }
        of[first] = count;
        open.push(first);
        while let Some(k) = open.pop() {
            let c = part.cell_of_index(k);
            for (di, dj) in AROUND {
                if let Some(n) = neighbour(&part, c, di, dj).filter(|n| of[*n] == NONE - 1) {
                    of[n] = count;
                    open.push(n);
                }
            }
        }
        count += 1;
    }
    let mut all = vec![Vec::new(); count as usize];
    cells.iter().zip(&moved).for_each(|(k, at)| all[of[*at] as usize].push(*k));
    all
}

/// Chains of neighbouring cells, a `stepover` (cells) apart, that cover the set.
pub(super) fn chains(lattice: &Lattice, set: &[bool], stepover: f64) -> Vec<Vec<Cell>> {
    let stepover = stepover.max(1.0) as f32;
    let Some(window) = window(lattice, set) else { return Vec::new() };
    let d = distance(lattice, set, window);
    // Which band a cell belongs to, counted from 1; 0 for none.
    let band = |d: f32| {
        let k = ((d - 1.0) / stepover).floor();
        if d > 0.0 && d - 1.0 - k * stepover < 1.0 { k as u32 + 1 } else { 0 }
    };
    let mut bands = vec![0u32; d.len()];
    within(lattice, window).for_each(|k| bands[k] = band(d[k]));
    let mut out = Vec::new();
    for k in within(lattice, window) {
        if bands[k] != 0 {
            let mut chain = trace(lattice, &mut bands, k);
            if outside_is_left(lattice, &d, &chain) {
                chain.reverse();
            }
            out.push(chain);
        }
    }
    out
}

/// Whether most of a chain has the nearer outside on its left: the distance grows to the right.
fn outside_is_left(lattice: &Lattice, d: &[f32], chain: &[Cell]) -> bool {
    let [nx, ny] = lattice.n;
    let at = |i: usize, j: usize| d[i.min(nx - 1) + nx * j.min(ny - 1)];
    let turn = |w: &[Cell]| {
        let way = [w[1][0] as f32 - w[0][0] as f32, w[1][1] as f32 - w[0][1] as f32];
        let [i, j] = w[0];
        let grow =
            [at(i + 1, j) - at(i.saturating_sub(1), j), at(i, j + 1) - at(i, j.saturating_sub(1))];
        way[0] * grow[1] - way[1] * grow[0]
    };
    chain.windows(2).map(turn).fold(0.0, |a, b| a + b) < 0.0
}

/// Straight neighbours first, so that thick spots do not split a chain.
const AROUND: [(i64, i64); 8] =
    [(1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, 1), (-1, -1), (1, -1)];

/// Walks from cell `start` through its band both ways; what was walked, and the band's cells beside
/// it, are taken out of the band.
fn trace(lattice: &Lattice, bands: &mut [u32], start: usize) -> Vec<Cell> {
    let band = bands[start];
    let first = lattice.cell_of_index(start);
    bands[start] = 0;
    let mut chain = walk(lattice, bands, first, band);
    let tail = walk(lattice, bands, first, band);
    if !tail.is_empty() {
        chain.reverse();
        chain.push(first);
        chain.extend(tail);
    } else {
        chain.insert(0, first);
    }
    // A ring closes where it began.
    let (a, b) = (chain[0], chain[chain.len() - 1]);
    if chain.len() > 3 && a[0].abs_diff(b[0]) <= 1 && a[1].abs_diff(b[1]) <= 1 {
        chain.push(a);
    }
    for c in &chain {
        for (di, dj) in AROUND {
            if let Some(k) = neighbour(lattice, *c, di, dj).filter(|k| bands[*k] == band) {
                bands[k] = 0;
            }
        }
    }
    chain
}

fn neighbour(lattice: &Lattice, c: Cell, di: i64, dj: i64) -> Option<usize> {
    let i = c[0].checked_add_signed(di as isize).filter(|i| *i < lattice.n[0])?;
    let j = c[1].checked_add_signed(dj as isize).filter(|j| *j < lattice.n[1])?;
    Some(lattice.index([i, j]))
}

fn walk(lattice: &Lattice, bands: &mut [u32], from: Cell, band: u32) -> Vec<Cell> {
    let mut chain = Vec::new();
    let (mut at, mut heading) = (from, (0, 0));
    loop {
        let ahead = std::iter::once(heading).chain(AROUND).filter(|h| *h != (0, 0));
        let next = ahead
            .filter_map(|h| neighbour(lattice, at, h.0, h.1).map(|k| (h, k)))
            .find(|(_, k)| bands[*k] == band);
        let Some((h, k)) = next else { return chain };
        bands[k] = 0;
        (at, heading) = (lattice.cell_of_index(k), h);
        chain.push(at);
    }
}

/// Orders chains by the nearest next beginning, starting from `at`; rings begin where they are
/// nearest. The sense of cutting stays.
pub(super) fn nearest_order(mut chains: Vec<Vec<Cell>>, mut at: Option<Cell>) -> Vec<Vec<Cell>> {
    // Beyond this the quadratic search costs more than the travel it saves; scan order is kept.
    const MOST: usize = 1000;
    if chains.len() > MOST {
        return chains;
    }
    let gap = |a: Cell, b: Cell| a[0].abs_diff(b[0]).pow(2) + a[1].abs_diff(b[1]).pow(2);
    let ring = |c: &[Cell]| c.len() > 3 && c[0] == c[c.len() - 1];
    let entry = |c: &[Cell], here: Cell| {
        let cells = if ring(c) { &c[..c.len() - 1] } else { &c[..1] };
        // Sixteen looks along a ring are near enough.
        let looks = (0..cells.len()).step_by(cells.len() / 16 + 1);
        let nearest = looks.min_by_key(|i| (gap(here, cells[*i]), *i)).unwrap_or(0);
        (gap(here, cells[nearest]), nearest)
    };
    let mut out = Vec::with_capacity(chains.len());
    while !chains.is_empty() {
        let here = at.unwrap_or(chains[0][0]);
        let best = (0..chains.len()).min_by_key(|i| (entry(&chains[*i], here).0, *i)).unwrap_or(0);
        let mut chain = chains.remove(best);
        if ring(&chain) {
            let start = entry(&chain, here).1;
            chain.pop();
            chain.rotate_left(start);
            chain.push(chain[0]);
        }
        at = chain.last().copied();
        out.push(chain);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::{DVec2, DVec3, Direction};
    use crate::voxel::Frame;
    use proptest::prelude::*;

    fn lattice(n: [usize; 2]) -> Lattice {
        let frame = Frame { pitch: 1.0, dims: [1; 3], origin: DVec3::ZERO };
        let mut l =
            Lattice::over(&frame, Direction::Z.image_plane(), 1.0, DVec2::ZERO, DVec2::ZERO);
        l.n = n;
        l
    }

    #[test]
    fn walls_are_on_the_right() {
        let l = lattice([30, 30]);
        let within = |c: Cell, a: usize, b: usize| c.iter().all(|x| (a..b).contains(x));
        // A frame: its outer rim is walked anticlockwise, the rim of its island clockwise.
        let set: Vec<bool> = (0..l.cells())
            .map(|k| within(l.cell_of_index(k), 2, 28) && !within(l.cell_of_index(k), 11, 19))
            .collect();
        let area = |c: &[Cell]| {
            let cross =
                |w: &[Cell]| w[0][0] as f64 * w[1][1] as f64 - w[1][0] as f64 * w[0][1] as f64;
            c.windows(2).map(cross).sum::<f64>()
        };
        let found = nearest_order(chains(&l, &set, 3.0), Some([0, 0]));
        let rings: Vec<f64> = found.iter().filter(|c| c.len() > 20).map(|c| area(c)).collect();
        assert!(rings.iter().any(|a| *a > 1000.0), "{rings:?}");
        assert!(rings.iter().any(|a| *a < -100.0), "{rings:?}");
        let rim = |a: f64| a.abs() > 1200.0;
        assert!(rings.iter().filter(|a| rim(**a)).all(|a| *a > 0.0), "{rings:?}");
    }

    proptest! {
        #[test]
        fn a_window_leaves_no_distance_out(
            boxes in proptest::collection::vec((0usize..40, 0usize..40, 1usize..9, 1usize..9), 1..5),
        ) {
            let l = lattice([40, 40]);
            let set: Vec<bool> = (0..l.cells()).map(|k| {
                let [i, j] = l.cell_of_index(k);
                boxes.iter().any(|(a, b, w, h)| (*a..a + w).contains(&i) && (*b..b + h).contains(&j))
            }).collect();
            let found = window(&l, &set).unwrap();
            prop_assert_eq!(distance(&l, &set, found), distance(&l, &set, [[0, 0], [39, 39]]));
            let out = |k: usize| {
                let c = l.cell_of_index(k);
                (0..2).any(|a| c[a] < found[0][a] || c[a] > found[1][a])
            };
            prop_assert!((0..l.cells()).all(|k| !set[k] || !out(k)));
        }

        #[test]
        fn of_a_set_and_of_its_cells_the_chains_are_the_same(
            boxes in proptest::collection::vec((0usize..40, 0usize..40, 1usize..9, 1usize..9), 1..6),
            stepover in 1f64..5.0,
        ) {
            let l = lattice([40, 40]);
            let is_in = |k: &usize| {
                let [i, j] = l.cell_of_index(*k);
                boxes.iter().any(|(a, b, w, h)| (*a..a + w).contains(&i) && (*b..b + h).contains(&j))
            };
            let set: Vec<bool> = (0..l.cells()).map(|k| is_in(&k)).collect();
            let cells: Vec<usize> = (0..l.cells()).filter(is_in).collect();
            prop_assert_eq!(chains_over(&l, &cells, stepover), chains(&l, &set, stepover));
        }

        #[test]
        fn parts_are_connected_and_apart(
            some in proptest::collection::btree_set(0usize..400, 0..120),
        ) {
            let l = lattice([20, 20]);
            let cells: Vec<usize> = some.into_iter().collect();
            let all = parts(&l, &cells);
            let beside = |a: &usize, b: &usize| {
                let [a, b] = [a, b].map(|k| l.cell_of_index(*k));
                a[0].abs_diff(b[0]) <= 1 && a[1].abs_diff(b[1]) <= 1
            };
            let mut sorted: Vec<usize> = all.iter().flatten().copied().collect();
            sorted.sort_unstable();
            prop_assert_eq!(sorted, cells);
            for (i, part) in all.iter().enumerate() {
                prop_assert!(part.is_sorted());
                let others = all[i + 1..].iter().flatten();
                prop_assert!(others.clone().all(|o| !part.iter().any(|k| beside(k, o))));
                let mut reached = vec![part[0]];
                let mut next = 0;
                while next < reached.len() {
                    let from = reached[next];
                    let new = part.iter().filter(|k| beside(&from, k) && !reached.contains(k));
                    let new: Vec<usize> = new.copied().collect();
                    reached.extend(new);
                    next += 1;
                }
                prop_assert_eq!(reached.len(), part.len());
            }
        }

        #[test]
        fn chains_stay_in_the_set_and_cover_it(
            boxes in proptest::collection::vec((0usize..30, 0usize..30, 1usize..18, 1usize..18), 1..5),
            stepover in 1f64..5.0,
        ) {
            let l = lattice([40, 40]);
            let set: Vec<bool> = (0..l.cells()).map(|k| {
                let [i, j] = l.cell_of_index(k);
                boxes.iter().any(|(a, b, w, h)| (*a..a + w).contains(&i) && (*b..b + h).contains(&j))
            }).collect();
            let chains = nearest_order(chains(&l, &set, stepover), None);
            for c in chains.iter().flatten() {
                prop_assert!(set[l.index(*c)]);
            }
            for w in chains.iter().flat_map(|c| c.windows(2)) {
                prop_assert!(w[0][0].abs_diff(w[1][0]) <= 1 && w[0][1].abs_diff(w[1][1]) <= 1);
            }
            for k in (0..l.cells()).filter(|k| set[*k]) {
                let c = l.cell_of_index(k);
                let near = chains.iter().flatten().any(|p| {
                    let (a, b) = (p[0].abs_diff(c[0]) as f64, p[1].abs_diff(c[1]) as f64);
                    // Chamfer bands are at most √2 cells apart where 1 is meant.
                    a.hypot(b) <= (stepover + 1.0) * 1.5
                });
                prop_assert!(near, "{c:?} is uncovered");
            }
        }
    }
}
