//! Over which cells of a lattice tips are looked for.
//!
//! Method: a cut's region is often a few specks far from each other, whose box is most of the part. Cells within a
//! reach of the columns of the region, as runs in each row; over the others there is no tip. Runs with little
//! between them are one.
//!
//! Guarantees: every cell within the reach of a column is wanted. Not guaranteed: that others are not.

use super::image::Lattice;
use crate::base::DVec2;
use std::ops::Range;

/// Fewer cells between two runs are wanted too: each run of a row costs a look at every chord of a tool.
const LEAST_GAP: usize = 16;

pub(crate) struct Wanted {
    lattice: Lattice,
    /// Of each row, in order.
    runs: Vec<Vec<Range<usize>>>,
    /// How many are wanted of the rows before a row and the cells before a cell; one more each way than cells.
    sums: Vec<u32>,
}

impl Wanted {
    /// All cells.
    pub fn all(lattice: Lattice) -> Wanted {
        let row = if lattice.n[0] == 0 { Vec::new() } else { vec![0..lattice.n[0]; 1] };
        Wanted::of(lattice, vec![row; lattice.n[1]])
    }

    /// Those within `reach` mm of a column at some places, as (u, v).
    pub fn around(lattice: Lattice, columns: impl Iterator<Item = DVec2>, reach: f64) -> Wanted {
        let [nx, ny] = lattice.n;
        let mut is_column = vec![false; lattice.cells()];
        for uv in columns {
            if let Some(c) = lattice.cell(uv) {
                is_column[lattice.index(c)] = true;
            }
        }
        // A column may lie half a cell's diagonal from its cell's middle.
        let reach = reach / lattice.s + std::f64::consts::FRAC_1_SQRT_2;
        let far = reach.floor() as usize;
        // How many more runs begin than end at a cell.
        let mut begin = vec![0i32; (nx + 1) * ny];
        for (j, row) in is_column.chunks(nx.max(1)).enumerate() {
            let mut i = 0usize;
            for run in row.chunk_by(|a, b| a == b) {
                if run[0] {
                    for to in j.saturating_sub(far)..(j + far + 1).min(ny) {
                        let aside = to.abs_diff(j) as f64;
                        let half = (reach * reach - aside * aside).max(0.0).sqrt() as usize;
                        let at = to * (nx + 1);
                        begin[at + i.saturating_sub(half)] += 1;
                        begin[at + (i + run.len() + half).min(nx)] -= 1;
                    }
                }
                i += run.len();
            }
        }
        let runs = |row: &[i32]| {
            let mut runs: Vec<Range<usize>> = Vec::new();
            let mut open = 0;
            for (i, by) in row.iter().take(nx).enumerate() {
                open += by;
                if open > 0 {
                    match runs.last_mut() {
                        Some(last) if i < last.end + LEAST_GAP => last.end = i + 1,
                        _ => runs.push(i..i + 1),
                    }
                }
            }
            runs
        };
        let runs = begin.chunks(nx + 1).map(runs).collect();
        Wanted::of(lattice, runs)
    }

    fn of(lattice: Lattice, runs: Vec<Vec<Range<usize>>>) -> Wanted {
        let across = lattice.n[0] + 1;
        let mut sums = vec![0u32; across * (lattice.n[1] + 1)];
        for (j, runs) in runs.iter().enumerate() {
            let (before, row) = sums[j * across..].split_at_mut(across);
            for run in runs {
                run.clone().for_each(|i| row[i + 1] = 1);
            }
            let mut sum = 0;
            for (here, before) in row.iter_mut().zip(before) {
                sum += *here;
                *here = sum + *before;
            }
        }
        Wanted { lattice, runs, sums }
    }

    pub fn lattice(&self) -> Lattice {
        self.lattice
    }

    /// Those of a row.
    pub fn runs(&self, row: usize) -> &[Range<usize>] {
        self.runs.get(row).map_or(&[], Vec::as_slice)
    }

    /// Whether any lies in a box of (u, v).
    pub fn any_within(&self, low: DVec2, high: DVec2) -> bool {
        let l = &self.lattice;
        let (low, high) = ((low - l.origin) / l.s, (high - l.origin) / l.s);
        let range = |low: f64, high: f64, n: usize| {
            let to = ((high.floor() + 1.0).max(0.0) as usize).min(n);
            [(low.ceil().max(0.0) as usize).min(to), to]
        };
        let ([a, b], [c, d]) = (range(low.x, high.x, l.n[0]), range(low.y, high.y, l.n[1]));
        let sum = |i: usize, j: usize| self.sums[j * (l.n[0] + 1) + i];
        sum(b, d) + sum(a, c) > sum(a, d) + sum(b, c)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Direction;
    use rand::RngExt;

    fn lattice(n: [usize; 2], s: f64) -> Lattice {
        Lattice { plane: Direction::Z.image_plane(), origin: DVec2::new(-3.0, 1.5), s, n }
    }

    #[test]
    fn what_is_near_a_column_is_wanted_and_a_box_knows_it() {
        let mut rng = crate::base::rng(11, 0);
        for (n, s, reach, columns) in
            [([90, 70], 0.5, 2.3, 3), ([200, 31], 0.25, 0.1, 5), ([40, 90], 1.0, 9.0, 1)]
        {
            let l = lattice(n, s);
            let size = DVec2::new(n[0] as f64, n[1] as f64) * s;
            let mut place = || {
                l.origin + DVec2::new(rng.random_range(0.0..1.0), rng.random_range(0.0..1.0)) * size
            };
            let columns: Vec<DVec2> = (0..columns).map(|_| place()).collect();
            let wanted = Wanted::around(l, columns.iter().copied(), reach);
            let inside = |[i, j]: [usize; 2]| wanted.runs(j).iter().any(|r| r.contains(&i));
            let mut count = 0;
            for c in (0..l.cells()).map(|i| l.cell_of_index(i)) {
                let in_lattice = columns.iter().filter(|p| l.cell(**p).is_some());
                let apart = in_lattice.map(|p| p.distance(l.uv(c)));
                let near = apart.fold(f64::INFINITY, f64::min);
                assert!(inside(c) || near > reach, "{c:?} {near}");
                assert!(!inside(c) || near <= reach + (2.0 + LEAST_GAP as f64) * s, "{c:?} {near}");
                count += usize::from(inside(c));
            }
            assert!(count > 0 && count < l.cells(), "{count}");
            for _ in 0..500 {
                let (a, b) = (place() - 2.0 * s, place() + 2.0 * s);
                let (low, high) = (a.min(b), a.max(b));
                let within = |p: DVec2| p.cmpge(low).all() && p.cmple(high).all();
                let mut cells = (0..l.cells()).map(|i| l.cell_of_index(i));
                let any = cells.any(|c| inside(c) && within(l.uv(c)));
                assert_eq!(wanted.any_within(low, high), any, "{low} {high}");
            }
        }
    }

    #[test]
    fn all_are_all() {
        let l = lattice([7, 5], 1.0);
        let all = Wanted::all(l);
        assert!((0..5).all(|j| all.runs(j).len() == 1 && all.runs(j)[0] == (0..7)));
        assert!(all.runs(5).is_empty());
        assert!(all.any_within(l.uv([3, 2]), l.uv([3, 2])));
        assert!(!all.any_within(l.uv([0, 0]) - 2.0, l.uv([0, 0]) - 0.1));
    }
}
