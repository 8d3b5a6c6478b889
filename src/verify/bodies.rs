//! Connected bodies of a grid: voxels joined through faces and edges (18 neighbours).
//!
//! Rows are run-length coded and runs of neighbouring rows united: work per run, not per voxel.

use crate::voxel::BitGrid;

#[derive(Clone, Copy, Debug)]
pub(super) struct Run {
    pub y: usize,
    pub z: usize,
    pub x: usize,
    pub len: usize,
}

pub(super) struct Bodies {
    /// In x, y, z order.
    pub runs: Vec<Run>,
    /// The body of each run, named by its first run.
    pub body: Vec<usize>,
}

impl Bodies {
    pub fn of(grid: &BitGrid) -> Bodies {
        let [_, ny, nz] = grid.dims();
        let runs: Vec<Run> = grid.runs().map(|(y, z, x, len)| Run { y, z, x, len }).collect();
        let mut row_start = vec![0usize; ny * nz + 1];
        runs.iter().for_each(|r| row_start[r.y + ny * r.z + 1] += 1);
        for r in 0..ny * nz {
            row_start[r + 1] += row_start[r];
        }
        let mut parent: Vec<usize> = (0..runs.len()).collect();
        for (y, z) in (0..nz).flat_map(|z| (0..ny).map(move |y| (y, z))) {
            let own = row_start[y + ny * z]..row_start[y + ny * z + 1];
            if own.is_empty() {
                continue;
            }
            // Of the eight neighbouring rows the four that come earlier: a face neighbour along y
            // or z is met with x off by one as well (an edge), the two diagonal rows only with
            // the same x (with x off by one it would be a corner).
            for (dy, dz, slack) in [(-1, 0, 1), (0, -1, 1), (-1, -1, 0), (1, -1, 0)] {
                let (Some(y), Some(z)) = (y.checked_add_signed(dy), z.checked_add_signed(dz))
                else {
                    continue;
                };
                if y < ny {
                    let other = row_start[y + ny * z]..row_start[y + ny * z + 1];
                    unite_rows(&runs, &mut parent, own.clone(), other, slack);
                }
            }
        }
        let body = (0..runs.len()).map(|r| root(&mut parent, r)).collect();
        Bodies { runs, body }
    }

    /// Voxels of each body, at the place of its first run; 0 elsewhere.
    pub fn sizes(&self) -> Vec<usize> {
        let mut sizes = vec![0; self.runs.len()];
        self.runs.iter().zip(&self.body).for_each(|(r, b)| sizes[*b] += r.len);
        sizes
    }

    /// The body with most voxels, the first of equals; None without any.
    pub fn largest(&self) -> Option<usize> {
        let sizes = self.sizes();
        (0..sizes.len()).max_by_key(|b| (sizes[*b], std::cmp::Reverse(*b)))
    }
}

fn unite_rows(
    runs: &[Run],
    parent: &mut [usize],
    own: std::ops::Range<usize>,
    other: std::ops::Range<usize>,
    slack: usize,
) {
    let (mut a, mut b) = (own.start, other.start);
    while a < own.end && b < other.end {
        let (p, q) = (runs[a], runs[b]);
        if p.x < q.x + q.len + slack && q.x < p.x + p.len + slack {
            unite(parent, a, b);
        }
        if p.x + p.len <= q.x + q.len { a += 1 } else { b += 1 }
    }
}

fn root(parent: &mut [usize], mut r: usize) -> usize {
    while parent[r] != r {
        parent[r] = parent[parent[r]];
        r = parent[r];
    }
    r
}

fn unite(parent: &mut [usize], a: usize, b: usize) {
    let (a, b) = (root(parent, a), root(parent, b));
    // The first run names the body.
    parent[a.max(b)] = a.min(b);
}
