//! Voxel sets on disk: run-length rows with a digest.
//!
//! `{"rows": [[y, z, x, length, x, length, …], …], "sha256": "…"}`: rows ordered by z, then y,
//! only those with solid voxels; runs ordered by x, each as long as it can be. One set has exactly
//! one such text. The digest is SHA-256 over little-endian 32-bit words: the grid's three dims,
//! then y, z, x, length of every run.
//!
//! Guarantees: [`RunRows::to_grid`] accepts what [`RunRows::from_grid`] writes and nothing else,
//! whatever the file says, and allocates the rows of [`RunRows::span`] alone, no more than a grid
//! of the largest allowed size.

use super::BitGrid;
use super::frame::MOST_VOXELS;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

/// A voxel set as run-length rows.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct RunRows {
    /// Each row: y, z, then x and length of every run of solid voxels.
    rows: Vec<Vec<u32>>,
    /// SHA-256 over dims and runs as little-endian 32-bit words, lower-case hexadecimal.
    sha256: String,
}

/// Why run-length rows are no voxel set. `row` counts from 0 in the file.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum RunsError {
    #[error("a grid of {0} × {1} × {2} voxels is larger than any this program makes")]
    GridTooLarge(usize, usize, usize),
    #[error(
        "row {row} has {length} numbers; it needs y, z and then pairs of x and length, at least one"
    )]
    RowLength { row: usize, length: usize },
    #[error("row {row} lies at y = {y}, z = {z}, outside the grid of {ny} × {nz} rows")]
    RowOutside { row: usize, y: u32, z: u32, ny: usize, nz: usize },
    #[error("row {row} (y = {y}, z = {z}) does not come after the row before it (z first, then y)")]
    RowOrder { row: usize, y: u32, z: u32 },
    #[error("row {row} has a run of length 0 at x = {x}")]
    EmptyRun { row: usize, x: u32 },
    #[error(
        "row {row}: the run of {length} voxels at x = {x} overlaps, touches or precedes the run before it"
    )]
    RunOrder { row: usize, x: u32, length: u32 },
    #[error("row {row}: the run of {length} voxels at x = {x} leaves the grid, {nx} voxels wide")]
    RunOutside { row: usize, x: u32, length: u32, nx: usize },
    #[error("the runs' digest is {found}, but the file says {stated}: it was changed or cut short")]
    Digest { stated: String, found: String },
}

impl RunRows {
    pub fn from_grid(grid: &BitGrid) -> RunRows {
        let mut rows: Vec<Vec<u32>> = Vec::new();
        let mut last = None;
        for (y, z, x, length) in grid.runs() {
            if last != Some((y, z)) {
                rows.push(vec![y as u32, z as u32]);
                last = Some((y, z));
            }
            if let Some(row) = rows.last_mut() {
                row.extend([x as u32, length as u32]);
            }
        }
        let sha256 = digest(grid.dims(), &rows);
        RunRows { rows, sha256 }
    }

    /// The digest as the file states it.
    pub fn sha256(&self) -> &str {
        &self.sha256
    }

    /// The rows a grid of these dims has from the first to the last that is named, counted
    /// y + ny z: what [`RunRows::to_grid`] stores. All of them when the rows are out of order.
    pub fn span(&self, dims: [usize; 3]) -> std::ops::Range<usize> {
        let [_, ny, nz] = dims;
        let all = 0..ny.saturating_mul(nz);
        let place = |row: Option<&Vec<u32>>| match row.map(|r| &r[..]) {
            Some([y, z, ..]) => (*z as usize).checked_mul(ny)?.checked_add(*y as usize),
            _ => None,
        };
        match (place(self.rows.first()), place(self.rows.last())) {
            (Some(first), Some(last)) if first <= last && last < all.end => first..last + 1,
            _ if self.rows.is_empty() => 0..0,
            _ => all,
        }
    }

    /// Checks everything and makes the grid, which stores the rows from the first to the last.
    ///
    /// # Errors
    /// [`RunsError`] names the first row that is wrong, or the digest.
    pub fn to_grid(&self, dims: [usize; 3]) -> Result<BitGrid, RunsError> {
        let [nx, ny, nz] = dims;
        let most = MOST_VOXELS as usize;
        // Rows take whole words: an axis of 0 or a narrow grid must not hide a huge one.
        let cells = nx.max(1).checked_mul(ny.max(1)).and_then(|n| n.checked_mul(nz.max(1)));
        if cells.is_none_or(|n| n > most) {
            return Err(RunsError::GridTooLarge(nx, ny, nz));
        }
        let mut grid = BitGrid::with_rows(dims, self.span(dims));
        let mut last = None;
        for (row, numbers) in self.rows.iter().enumerate() {
            let [y, z, runs @ ..] = &numbers[..] else {
                return Err(RunsError::RowLength { row, length: numbers.len() });
            };
            if runs.is_empty() || runs.len() % 2 != 0 {
                return Err(RunsError::RowLength { row, length: numbers.len() });
            }
            let (y, z) = (*y, *z);
            if y as usize >= ny || z as usize >= nz {
                return Err(RunsError::RowOutside { row, y, z, ny, nz });
            }
            if last.is_some_and(|l| (z, y) <= l) {
                return Err(RunsError::RowOrder { row, y, z });
            }
            last = Some((z, y));
            let mut free_from = 0;
            for run in runs.chunks_exact(2) {
                let (x, length) = (run[0], run[1]);
                if length == 0 {
                    return Err(RunsError::EmptyRun { row, x });
                }
                if (x as usize) < free_from {
                    return Err(RunsError::RunOrder { row, x, length });
                }
                if (x as usize).checked_add(length as usize).is_none_or(|end| end > nx) {
                    return Err(RunsError::RunOutside { row, x, length, nx });
                }
                grid.fill_run(y as usize, z as usize, x as usize, length as usize);
                // Two runs that touch would be one.
                free_from = x as usize + length as usize + 1;
            }
        }
        let found = digest(dims, &self.rows);
        if found != self.sha256 {
            return Err(RunsError::Digest { stated: self.sha256.clone(), found });
        }
        Ok(grid)
    }
}

fn digest(dims: [usize; 3], rows: &[Vec<u32>]) -> String {
    let mut hash = Sha256::new();
    for n in dims {
        hash.update((n as u32).to_le_bytes());
    }
    for row in rows {
        if let [y, z, runs @ ..] = &row[..] {
            for run in runs.chunks_exact(2) {
                for n in [y, z, &run[0], &run[1]] {
                    hash.update(n.to_le_bytes());
                }
            }
        }
    }
    hash.finalize().iter().map(|b| format!("{b:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn grid() -> impl Strategy<Value = BitGrid> {
        (1usize..140, 1usize..5, 1usize..4).prop_flat_map(|(x, y, z)| {
            proptest::collection::vec(any::<bool>(), x * y * z).prop_map(move |bits| {
                BitGrid::from_fn([x, y, z], |[i, j, k]| bits[i + x * (j + y * k)])
            })
        })
    }

    proptest! {
        #[test]
        fn a_set_survives_its_file(g in grid()) {
            let text = serde_json::to_string(&RunRows::from_grid(&g)).unwrap();
            let back: RunRows = serde_json::from_str(&text).unwrap();
            prop_assert_eq!(back.to_grid(g.dims()), Ok(g.clone()));
            let [x, y, z] = g.dims();
            prop_assert!(back.to_grid([x + 1, y, z]).is_err());
        }

        #[test]
        fn one_changed_number_is_noticed(g in grid(), by in 1u32..) {
            let runs = RunRows::from_grid(&g);
            for row in 0..runs.rows.len().min(3) {
                for i in 0..runs.rows[row].len() {
                    for by in [1, u32::MAX, by] {
                        let mut bad = runs.clone();
                        bad.rows[row][i] = bad.rows[row][i].wrapping_add(by);
                        prop_assert!(bad.to_grid(g.dims()).is_err());
                    }
                    let mut bad = runs.clone();
                    bad.rows[row].remove(i);
                    prop_assert!(bad.to_grid(g.dims()).is_err());
                }
                let mut bad = runs.clone();
                bad.rows.remove(row);
                prop_assert!(bad.to_grid(g.dims()).is_err());
            }
        }
    }

    #[test]
    fn every_fault_is_named() {
        let dims = [10, 4, 3];
        let faulty = |rows: &[&[u32]]| {
            let rows: Vec<Vec<u32>> = rows.iter().map(|r| r.to_vec()).collect();
            let sha256 = digest(dims, &rows);
            RunRows { rows, sha256 }.to_grid(dims)
        };
        assert!(faulty(&[&[3, 2, 0, 4, 5, 5]]).is_ok());
        use RunsError::*;
        assert_eq!(faulty(&[&[1]]), Err(RowLength { row: 0, length: 1 }));
        assert_eq!(faulty(&[&[1, 1]]), Err(RowLength { row: 0, length: 2 }));
        assert_eq!(faulty(&[&[1, 1, 2]]), Err(RowLength { row: 0, length: 3 }));
        let outside = RowOutside { row: 0, y: 4, z: 2, ny: 4, nz: 3 };
        assert_eq!(faulty(&[&[4, 2, 0, 1]]), Err(outside));
        let twice: [&[u32]; 2] = [&[1, 1, 0, 1], &[1, 1, 4, 1]];
        assert_eq!(faulty(&twice), Err(RowOrder { row: 1, y: 1, z: 1 }));
        let back: [&[u32]; 2] = [&[0, 1, 0, 1], &[3, 0, 4, 1]];
        assert_eq!(faulty(&back), Err(RowOrder { row: 1, y: 3, z: 0 }));
        assert_eq!(faulty(&[&[0, 0, 3, 0]]), Err(EmptyRun { row: 0, x: 3 }));
        assert_eq!(faulty(&[&[0, 0, 3, 2, 4, 2]]), Err(RunOrder { row: 0, x: 4, length: 2 }));
        assert_eq!(faulty(&[&[0, 0, 3, 2, 5, 2]]), Err(RunOrder { row: 0, x: 5, length: 2 }));
        let long = RunOutside { row: 0, x: 8, length: 3, nx: 10 };
        assert_eq!(faulty(&[&[0, 0, 8, 3]]), Err(long));
        let wide = RunOutside { row: 0, x: u32::MAX, length: u32::MAX, nx: 10 };
        assert_eq!(faulty(&[&[0, 0, u32::MAX, u32::MAX]]), Err(wide));
        let runs = RunRows { rows: vec![], sha256: "no".into() };
        assert!(matches!(runs.to_grid(dims), Err(Digest { .. })));
        assert!(matches!(runs.to_grid([usize::MAX, 2, 2]), Err(GridTooLarge(..))));
        assert!(matches!(runs.to_grid([0, usize::MAX, 1]), Err(GridTooLarge(..))));
    }

    #[test]
    fn hostile_text_is_refused_by_the_reader() {
        for text in [
            r#"{"rows": [[-1, 0, 0, 1]], "sha256": ""}"#,
            r#"{"rows": [[0.5, 0, 0, 1]], "sha256": ""}"#,
            r#"{"rows": [[4294967296, 0, 0, 1]], "sha256": ""}"#,
            r#"{"rows": {"0": 1}, "sha256": ""}"#,
            r#"{"rows": []}"#,
        ] {
            assert!(serde_json::from_str::<RunRows>(text).is_err(), "{text}");
        }
    }
}
