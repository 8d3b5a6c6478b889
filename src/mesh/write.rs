//! Writes meshes: binary STL and OBJ, the same bytes for the same mesh.

use super::TriMesh;
use crate::base::{DVec3, Direction};
use std::io::{self, Write};

/// Begins the header; it must not begin with "solid", which readers take for text.
const TITLE: &[u8] = b"hmplan binary STL, millimetres";

/// Bytes of a triangle in binary STL.
pub const STL_FACET: usize = 50;

/// A triangle as binary STL has it, the normal by the order of the corners, coordinates rounded to
/// 32 bits.
pub fn stl_facet([a, b, c]: [DVec3; 3]) -> [u8; STL_FACET] {
    // A triangle without area has no normal; zero tells the reader to compute its own.
    let normal = Direction::new((b - a).cross(c - a)).map_or(DVec3::ZERO, Direction::vec);
    let mut facet = [0; STL_FACET];
    for (i, value) in [normal, a, b, c].iter().flat_map(|v| v.to_array()).enumerate() {
        facet[4 * i..4 * i + 4].copy_from_slice(&(value as f32).to_le_bytes());
    }
    facet
}

/// Writes the head of a binary STL file of so many triangles, in millimetres. Errors: those of
/// `out`, and `InvalidInput` for more than 2³² − 1 triangles.
pub fn write_stl_head(triangles: usize, mut out: impl Write) -> io::Result<()> {
    let count = u32::try_from(triangles).map_err(|_| {
        io::Error::new(io::ErrorKind::InvalidInput, "more triangles than an STL file can count")
    })?;
    let mut header = [b' '; 80];
    header[..TITLE.len()].copy_from_slice(TITLE);
    out.write_all(&header)?;
    out.write_all(&count.to_le_bytes())
}

/// Writes binary STL in millimetres. Errors: those of [`write_stl_head`].
pub fn write_stl(mesh: &TriMesh, mut out: impl Write) -> io::Result<()> {
    write_stl_head(mesh.triangles().len(), &mut out)?;
    for t in 0..mesh.triangles().len() {
        out.write_all(&stl_facet(mesh.corners(t)))?;
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
