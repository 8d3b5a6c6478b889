//! INV's voxel text: line 1 `nx,ny,nz`, line 2 `0,0,0`, line 3 the values 0 or 1 with commas
//! between, x fastest, then y, then z.
//!
//! Guarantees: counts are checked against the text before memory is taken. Not guaranteed: that
//! the solid is stable or in one piece.

use super::{BitGrid, Frame};
use crate::base::DVec3;
use crate::mesh::{InvalidMesh, TriMesh};
use std::collections::HashMap;

#[derive(Debug, thiserror::Error, PartialEq)]
pub enum VoxelTextError {
    #[error("line 1 is \"{found}\", not the three voxel counts nx,ny,nz")]
    Header { found: String },
    #[error("the header says {x} × {y} × {z} = {expected} voxels, but {found} values follow")]
    Count { x: usize, y: usize, z: usize, expected: usize, found: usize },
    #[error("value {index} is \"{found}\", not 0 or 1")]
    Value { index: usize, found: String },
    #[error("there is no line {line}; the file is cut short")]
    Missing { line: usize },
    #[error("no voxel is solid: the part is empty")]
    Empty,
}

/// Reads the solid.
///
/// # Errors
/// A header that is none, a count that is not the header's, a value other than 0 and 1, no solid
/// voxel.
pub fn parse_voxel_text(text: &str) -> Result<BitGrid, VoxelTextError> {
    let mut lines = text.lines();
    let header = lines.next().unwrap_or_default();
    let dims: Vec<usize> = header.split(',').filter_map(|n| n.trim().parse().ok()).collect();
    let counts = <[usize; 3]>::try_from(dims).ok().filter(|d| !d.contains(&0));
    let expected = counts.and_then(|d| d.iter().try_fold(1usize, |n, d| n.checked_mul(*d)));
    let (Some(dims @ [x, y, z]), Some(expected)) = (counts, expected) else {
        return Err(VoxelTextError::Header { found: header.chars().take(40).collect() });
    };
    let values = lines.nth(1).ok_or(VoxelTextError::Missing { line: 3 })?;
    let values = values.trim().trim_end_matches(',');
    let found = if values.is_empty() { 0 } else { values.split(',').count() };
    if found != expected {
        return Err(VoxelTextError::Count { x, y, z, expected, found });
    }
    let mut grid = BitGrid::new(dims);
    for (index, value) in values.split(',').enumerate() {
        match value.trim() {
            "0" => {}
            "1" => grid.set([index % x, index / x % y, index / x / y], true),
            other => {
                return Err(VoxelTextError::Value {
                    index,
                    found: other.chars().take(20).collect(),
                });
            }
        }
    }
    if grid.is_empty() { Err(VoxelTextError::Empty) } else { Ok(grid) }
}

/// The faces between solid and empty voxels as they are, two triangles each.
///
/// # Errors
/// [`InvalidMesh`] when the frame puts them farther out than a mesh may be.
pub fn blocks(grid: &BitGrid, frame: &Frame) -> Result<TriMesh, InvalidMesh> {
    let mut numbers: HashMap<[usize; 3], u32> = HashMap::new();
    let mut points = Vec::new();
    let mut triangles = Vec::new();
    let mut number = |corner: [usize; 3]| {
        *numbers.entry(corner).or_insert_with(|| {
            let [x, y, z] = corner.map(|c| c as f64);
            points.push(frame.origin + DVec3::new(x, y, z) * frame.pitch);
            points.len() as u32 - 1
        })
    };
    for v in grid.iter_ones() {
        for axis in 0..3 {
            for high in [false, true] {
                let mut beside = v.map(|c| c as i64);
                beside[axis] += if high { 1 } else { -1 };
                if grid.get_or_empty(beside) {
                    continue;
                }
                let quad = [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(a, b)| {
                    let mut corner = v;
                    corner[axis] += usize::from(high);
                    corner[(axis + 1) % 3] += a;
                    corner[(axis + 2) % 3] += b;
                    number(corner)
                });
                let [a, b, c, d] = quad;
                triangles.extend(match high {
                    true => [[a, b, c], [a, c, d]],
                    false => [[a, c, b], [a, d, c]],
                });
            }
        }
    }
    TriMesh::new(points, triangles)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_run_along_x_then_y_then_z() {
        let grid = parse_voxel_text("2,1,2\n0,0,0\n1,0,0,1,\n").unwrap();
        assert_eq!(grid.iter_ones().collect::<Vec<_>>(), [[0, 0, 0], [1, 0, 1]]);
    }

    #[test]
    fn what_is_no_voxel_text_is_said() {
        for (text, word) in [
            ("", "line 1"),
            ("2,2\n0,0,0\n1,1,1,1\n", "line 1"),
            ("2,0,1\n0,0,0\n\n", "line 1"),
            ("99999999999,99999999999,9\n0,0,0\n1\n", "line 1"),
            ("2,2,1\n0,0,0\n1,1,1\n", "4 voxels, but 3 values"),
            ("2,2,9000000\n0,0,0\n1,1,1\n", "3 values"),
            ("2,1,1\n0,0,0\n", "line 3"),
            ("2,1,1\n0,0,0\n1,2\n", "\"2\""),
            ("2,1,1\n0,0,0\n0,0\n", "empty"),
        ] {
            let said = parse_voxel_text(text).unwrap_err().to_string();
            assert!(said.contains(word), "{text:?}: {said}");
        }
    }

    #[test]
    fn blocks_enclose_the_volume_of_the_voxels() {
        let grid = parse_voxel_text("2,2,2\n0,0,0\n1,0,0,1,1,1,0,1\n").unwrap();
        let frame = Frame { pitch: 0.5, dims: grid.dims(), origin: DVec3::ZERO };
        let mesh = blocks(&grid, &frame).unwrap();
        assert!((mesh.signed_volume() - 5.0 * 0.125).abs() < 1e-12);
    }
}
