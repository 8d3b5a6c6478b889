//! Writes meshes: binary STL and OBJ, the same bytes for the same mesh.

use super::TriMesh;
use crate::base::{DVec3, Direction};
use std::io::{self, Write};

/// Begins the header; it must not begin with "solid", which readers take for text.
const TITLE: &[u8] = b"hmplan binary STL, millimetres";

/// Writes binary STL in millimetres, normals by the order of the corners. Coordinates are rounded
/// to 32 bits. Errors: those of `out`, and `InvalidInput` for more than 2³² − 1 triangles.
pub fn write_stl(mesh: &TriMesh, mut out: impl Write) -> io::Result<()> {
    let count = u32::try_from(mesh.triangles().len()).map_err(|_| {
        io::Error::new(io::ErrorKind::InvalidInput, "more triangles than an STL file can count")
    })?;
    let mut header = [b' '; 80];
    header[..TITLE.len()].copy_from_slice(TITLE);
    out.write_all(&header)?;
    out.write_all(&count.to_le_bytes())?;
    for t in 0..mesh.triangles().len() {
        // A triangle without area has no normal; zero tells the reader to compute its own.
        let normal = Direction::new(mesh.area_normal(t)).map_or(DVec3::ZERO, Direction::vec);
        let [a, b, c] = mesh.corners(t);
        let mut facet = [0; 50];
        for (i, value) in [normal, a, b, c].iter().flat_map(|v| v.to_array()).enumerate() {
            facet[4 * i..4 * i + 4].copy_from_slice(&(value as f32).to_le_bytes());
        }
        out.write_all(&facet)?;
    }
    out.flush()
}

/// Writes OBJ with the shortest decimals that read back to the same 64-bit numbers. Errors: those
/// of `out`.
pub fn write_obj(mesh: &TriMesh, mut out: impl Write) -> io::Result<()> {
    for v in mesh.vertices() {
        writeln!(out, "v {} {} {}", v.x, v.y, v.z)?;
    }
    for t in mesh.triangles() {
        let [a, b, c] = t.map(|i| u64::from(i) + 1);
        writeln!(out, "f {a} {b} {c}")?;
    }
    out.flush()
}
