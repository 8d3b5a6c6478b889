//! Connected pieces of a voxel set, and floods.
//!
//! Method: union-find over the runs of solid voxels along x; rows are compared with their already
//! seen neighbours by a merge of two sorted run lists (He, Chao & Suzuki 2008). Cost: linear in
//! the runs, not the voxels.
//!
//! Guarantees: pieces are numbered by their first voxel in x, y, z order. Not guaranteed: anything
//! about memory on a grid whose every second voxel is solid, where runs are as many as voxels.

use super::BitGrid;

/// Which voxels count as touching.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Connectivity {
    /// Those that share a face.
    Face6,
    /// Those that share a face or an edge.
    Edge18,
    /// Those that share a face, an edge or a corner.
    Corner26,
}

impl Connectivity {
    /// The neighbouring rows that come before a row, as (dy, dz), each with how far along x its
    /// voxels still touch.
    fn rows_before(self) -> &'static [(isize, isize, u32)] {
        match self {
            Connectivity::Face6 => &[(-1, 0, 0), (0, -1, 0)],
            Connectivity::Edge18 => &[(-1, 0, 1), (0, -1, 1), (-1, -1, 0), (1, -1, 0)],
            Connectivity::Corner26 => &[(-1, 0, 1), (0, -1, 1), (-1, -1, 1), (1, -1, 1)],
        }
    }
}

#[derive(Clone, Copy)]
struct Run {
    x: u32,
    end: u32,
}

/// The pieces of a voxel set, labelled 0.. by their first voxel.
pub struct Components {
    dims: [usize; 3],
    runs: Vec<Run>,
    /// First run of each row, and one past the last.
    row_start: Vec<usize>,
    labels: Vec<u32>,
    sizes: Vec<usize>,
}

/// Splits a voxel set into connected pieces.
pub fn components(grid: &BitGrid, connectivity: Connectivity) -> Components {
    let [_, ny, nz] = grid.dims();
    let (mut runs, mut row_start) = (Vec::new(), Vec::with_capacity(ny * nz + 1));
    let mut filled = 0;
    for (y, z, x, len) in grid.runs() {
        let row = y + ny * z;
        while filled <= row {
            row_start.push(runs.len());
            filled += 1;
        }
        runs.push(Run { x: x as u32, end: (x + len) as u32 });
    }
    row_start.resize(ny * nz + 1, runs.len());

    let mut parent: Vec<u32> = (0..runs.len() as u32).collect();
    for row in 0..ny * nz {
        let mine = row_start[row]..row_start[row + 1];
        if mine.is_empty() {
            continue;
        }
        let (y, z) = (row % ny, row / ny);
        for &(dy, dz, reach) in connectivity.rows_before() {
            let (Some(y), Some(z)) = (y.checked_add_signed(dy), z.checked_add_signed(dz)) else {
                continue;
            };
            if y < ny {
                let other = y + ny * z;
                let theirs = row_start[other]..row_start[other + 1];
                join_rows(&runs, &mut parent, mine.clone(), theirs, reach);
            }
        }
    }
    let (mut labels, mut sizes) = (vec![0; runs.len()], Vec::new());
    for i in 0..runs.len() {
        // A root is its piece's first run, so it has its label before any other run asks.
        let root = find(&mut parent, i as u32) as usize;
        if root == i {
            labels[i] = sizes.len() as u32;
            sizes.push(0);
        }
        labels[i] = labels[root];
        sizes[labels[i] as usize] += (runs[i].end - runs[i].x) as usize;
    }
    Components { dims: grid.dims(), runs, row_start, labels, sizes }
}

/// Joins the touching runs of two rows.
fn join_rows(
    runs: &[Run],
    parent: &mut [u32],
    mine: std::ops::Range<usize>,
    theirs: std::ops::Range<usize>,
    reach: u32,
) {
    let (mut i, mut j) = (mine.start, theirs.start);
    while i < mine.end && j < theirs.end {
        let (a, b) = (runs[i], runs[j]);
        if a.x < b.end + reach && b.x < a.end + reach {
            let (ra, rb) = (find(parent, i as u32), find(parent, j as u32));
            parent[ra.max(rb) as usize] = ra.min(rb);
        }
        if a.end < b.end { i += 1 } else { j += 1 }
    }
}

fn find(parent: &mut [u32], mut i: u32) -> u32 {
    while parent[i as usize] != i {
        parent[i as usize] = parent[parent[i as usize] as usize];
        i = parent[i as usize];
    }
    i
}

impl Components {
    /// Number of pieces.
    pub fn count(&self) -> usize {
        self.sizes.len()
    }

    /// Voxels of each piece, by label.
    pub fn sizes(&self) -> &[usize] {
        &self.sizes
    }

    /// The label of a voxel; None for an empty voxel or one outside the grid.
    pub fn label_of(&self, [x, y, z]: [usize; 3]) -> Option<u32> {
        if x >= self.dims[0] || y >= self.dims[1] || z >= self.dims[2] {
            return None;
        }
        let row = y + self.dims[1] * z;
        let runs = self.row_start[row]..self.row_start[row + 1];
        let i = runs.start + self.runs[runs.clone()].partition_point(|r| r.end as usize <= x);
        (i < runs.end && self.runs[i].x as usize <= x).then(|| self.labels[i])
    }

    /// The voxels of one piece; none for a label that no piece has.
    pub fn grid_of(&self, label: u32) -> BitGrid {
        self.grid_where(|l| l == label)
    }

    /// The voxels of all pieces whose label passes.
    pub fn grid_where(&self, wanted: impl Fn(u32) -> bool) -> BitGrid {
        let mut grid = BitGrid::new(self.dims);
        let ny = self.dims[1];
        for row in 0..self.row_start.len() - 1 {
            for i in self.row_start[row]..self.row_start[row + 1] {
                if wanted(self.labels[i]) {
                    let r = self.runs[i];
                    grid.fill_run(row % ny, row / ny, r.x as usize, (r.end - r.x) as usize);
                }
            }
        }
        grid
    }
}

/// The voxels of `grid` that are connected to a voxel of `seeds` within `grid`; seeds outside
/// `grid` reach nothing.
///
/// # Panics
/// When the grids differ in size, as all pairs of grids do.
pub fn flood(grid: &BitGrid, seeds: &BitGrid, connectivity: Connectivity) -> BitGrid {
    let pieces = components(grid, connectivity);
    let mut reached = vec![false; pieces.count()];
    for (y, z, x, _) in grid.and(seeds).runs() {
        if let Some(l) = pieces.label_of([x, y, z]) {
            reached[l as usize] = true;
        }
    }
    pieces.grid_where(|l| reached[l as usize])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const ALL: [Connectivity; 3] =
        [Connectivity::Face6, Connectivity::Edge18, Connectivity::Corner26];

    /// Labels by breadth-first search from each unlabelled voxel in order.
    fn naive(grid: &BitGrid, connectivity: Connectivity) -> (Vec<Option<u32>>, Vec<usize>) {
        let [nx, ny, nz] = grid.dims();
        let farthest = match connectivity {
            Connectivity::Face6 => 1,
            Connectivity::Edge18 => 2,
            Connectivity::Corner26 => 3,
        };
        let at = |[x, y, z]: [usize; 3]| x + nx * (y + ny * z);
        let (mut labels, mut sizes) = (vec![None; nx * ny * nz], Vec::new());
        for first in grid.iter_ones() {
            if labels[at(first)].is_some() {
                continue;
            }
            let label = sizes.len() as u32;
            labels[at(first)] = Some(label);
            let mut queue = vec![first];
            let mut head = 0;
            while head < queue.len() {
                let p = queue[head].map(|c| c as i64);
                head += 1;
                for n in 0..27 {
                    let d = [n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1];
                    let q = [p[0] + d[0], p[1] + d[1], p[2] + d[2]];
                    if d.iter().map(|c| c.abs()).sum::<i64>() <= farthest && grid.get_or_empty(q) {
                        let q = q.map(|c| c as usize);
                        if labels[at(q)].is_none() {
                            labels[at(q)] = Some(label);
                            queue.push(q);
                        }
                    }
                }
            }
            sizes.push(queue.len());
        }
        (labels, sizes)
    }

    fn pair() -> impl Strategy<Value = (BitGrid, BitGrid)> {
        (1usize..70, 1usize..6, 1usize..6, 1u32..10, any::<u64>()).prop_map(|(x, y, z, full, s)| {
            let mut r = crate::base::rng(s, 0);
            let mut draw = |share: u32| {
                let bits: Vec<bool> =
                    (0..x * y * z).map(|_| r.random_range(0..10) < share).collect();
                BitGrid::from_fn([x, y, z], |[i, j, k]| bits[i + x * (j + y * k)])
            };
            (draw(full), draw(1))
        })
    }

    proptest! {
        #[test]
        fn pieces_and_floods_agree_with_breadth_first_search((grid, seeds) in pair()) {
            let [nx, ny, nz] = grid.dims();
            for c in ALL {
                let (labels, sizes) = naive(&grid, c);
                let pieces = components(&grid, c);
                prop_assert_eq!(pieces.sizes(), &sizes[..]);
                prop_assert_eq!(pieces.count(), sizes.len());
                let voxels = || (0..nx * ny * nz).map(|i| [i % nx, i / nx % ny, i / nx / ny]);
                for (v, l) in voxels().zip(&labels) {
                    prop_assert_eq!(pieces.label_of(v), *l);
                }
                let of_first = pieces.grid_of(0);
                let mut reached = vec![false; sizes.len()];
                for (v, l) in voxels().zip(&labels) {
                    prop_assert_eq!(of_first.get(v), *l == Some(0));
                    if let (Some(l), true) = (l, seeds.get(v)) {
                        reached[*l as usize] = true;
                    }
                }
                let flooded = flood(&grid, &seeds, c);
                for (v, l) in voxels().zip(&labels) {
                    prop_assert_eq!(flooded.get(v), l.is_some_and(|l| reached[l as usize]));
                }
            }
        }
    }

    #[test]
    fn nothing_has_no_pieces() {
        for dims in [[0, 3, 3], [3, 0, 3], [3, 3, 0], [3, 3, 3]] {
            let pieces = components(&BitGrid::new(dims), Connectivity::Corner26);
            assert_eq!(pieces.count(), 0);
            assert_eq!(pieces.label_of([0, 0, 0]), None);
            assert_eq!(pieces.grid_of(0), BitGrid::new(dims));
        }
    }
}
