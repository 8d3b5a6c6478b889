//! Tools given as meshes: an active and a passive part, the tip at the origin, the axis along +z,
//! millimetres.
//!
//! Method: the meshes themselves are turned to the direction and voxelised with a voxel's centre on
//! the tip, so that nothing is resampled; regions then go through the FFT engine.
//!
//! Guarantees: along the grid axes a voxel belongs to the tool when its centre lies in a mesh.
//! Elsewhere the passive part also takes in every centre within √3/2 of a pitch of it, half the
//! diagonal of a voxel, so that no obstacle voxel is touched between centres. Not guaranteed: parts
//! thinner than a voxel.

use super::VoxelTool;
use super::voxel_tool::NoVoxelTool;
use crate::base::{Cancelled, Ctx, DAffine3, DMat3, DVec3, Direction};
use crate::mesh::{InvalidMesh, NearestTriangle, TriMesh};
use crate::morph::Element;
use crate::voxel::{BitGrid, Frame, FrameTooLarge, voxelise};

/// A tool of meshes.
#[derive(Clone, Debug)]
pub struct MeshTool {
    pub active: TriMesh,
    pub passive: Option<TriMesh>,
}

#[derive(Debug, thiserror::Error)]
pub enum MeshToolError {
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    #[error("the tool: {0}")]
    TooLarge(#[from] FrameTooLarge),
    #[error("the tool: {0}")]
    Mesh(#[from] InvalidMesh),
    #[error(transparent)]
    Nothing(#[from] NoVoxelTool),
}

impl MeshTool {
    /// The tool pointing along a direction, on a grid of `pitch` mm.
    ///
    /// # Errors
    /// A tool of more voxels than a grid may have, or with none in its active part.
    pub fn along(
        &self,
        direction: Direction,
        pitch: f64,
        ctx: &Ctx,
    ) -> Result<VoxelTool, MeshToolError> {
        let plane = direction.image_plane();
        let turn = DAffine3::from_mat3(DMat3::from_cols(plane.u, plane.v, plane.d));
        let edge = element(&self.active.transformed(&turn)?, pitch, 0.0, ctx)?;
        if edge.is_empty() {
            return Err(NoVoxelTool::NothingCuts { pitch }.into());
        }
        let spare = if direction.is_grid_axis() { 0.0 } else { 3f64.sqrt() / 2.0 };
        let mut body = edge.clone();
        if let Some(passive) = &self.passive {
            let passive = element(&passive.transformed(&turn)?, pitch, spare, ctx)?;
            body = body.union(&passive);
        }
        Ok(VoxelTool::of_elements(body, edge, None))
    }
}

/// The offsets whose centres lie in a mesh or within `spare` voxels of its surface.
fn element(mesh: &TriMesh, pitch: f64, spare: f64, ctx: &Ctx) -> Result<Element, MeshToolError> {
    let bounds = mesh.bounds();
    // Checked before any arithmetic on whole numbers.
    Frame::around(bounds, pitch, 2)?;
    let first = (bounds.min / pitch).floor() - DVec3::splat(2.0);
    let last = (bounds.max / pitch).ceil() + DVec3::splat(2.0);
    let dims = (last - first + DVec3::ONE).to_array().map(|n| n as usize);
    // Voxel 0 of the grid has its centre at first · pitch.
    let frame = Frame { pitch, dims, origin: (first - DVec3::splat(0.5)) * pitch };
    let mut solid = voxelise(mesh, &frame, ctx)?;
    if spare > 0.0 {
        let surface = NearestTriangle::new(mesh, spare * pitch);
        let inside = solid.clone();
        solid = BitGrid::from_fn(dims, |v| {
            let near = || surface.query(frame.center(v)).map(|p| p.distance);
            inside.get(v) || near().is_some_and(|d| d <= spare * pitch)
        });
    }
    Ok(Element::from_grid(&solid, first.to_array().map(|c| -c as i64)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::access::{Engine, accessible};
    use crate::base::fibonacci_sphere;

    fn tool() -> MeshTool {
        MeshTool {
            active: TriMesh::cuboid(DVec3::new(-1.0, -1.0, -0.2), DVec3::new(1.0, 1.0, 6.0)),
            passive: Some(TriMesh::cuboid(DVec3::new(-3.0, -2.0, 6.0), DVec3::new(3.0, 2.0, 14.0))),
        }
    }

    #[test]
    fn an_upright_tool_has_the_voxels_of_its_boxes() {
        let v = tool().along(Direction::Z, 0.73, &Ctx::quiet()).unwrap();
        for z in -3..25i64 {
            for y in -6..7i64 {
                for x in -6..7i64 {
                    let p = DVec3::new(x as f64, y as f64, z as f64) * 0.73;
                    let q = p.abs();
                    let active = q.x < 1.0 && q.y < 1.0 && p.z > -0.2 && p.z < 6.0;
                    let passive = q.x < 3.0 && q.y < 2.0 && p.z > 6.0 && p.z < 14.0;
                    assert_eq!(v.edge().contains([x, y, z]), active, "{p}");
                    assert_eq!(v.body().contains([x, y, z]), active || passive, "{p}");
                }
            }
        }
    }

    #[test]
    fn a_tilted_tool_keeps_clear_by_half_a_diagonal() {
        let pitch = 0.8;
        for d in fibonacci_sphere(7) {
            let v = tool().along(d, pitch, &Ctx::quiet()).unwrap();
            let plane = d.image_plane();
            let spare = 3f64.sqrt() / 2.0 * pitch;
            for z in -20..21i64 {
                for y in -20..21i64 {
                    for x in -20..21i64 {
                        let p = DVec3::new(x as f64, y as f64, z as f64) * pitch;
                        let q = DVec3::new(plane.u.dot(p), plane.v.dot(p), plane.d.dot(p));
                        let out = (q - q
                            .clamp(DVec3::new(-3.0, -2.0, 6.0), DVec3::new(3.0, 2.0, 14.0)))
                        .length();
                        if out < spare {
                            assert!(v.body().contains([x, y, z]), "{d:?} {p} {out}");
                        }
                        if v.body().contains([x, y, z]) && q.z > 6.0 + 3.0 * spare {
                            assert!(out < 1.001 * spare, "{d:?} {p} {out}");
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn the_transform_gives_the_regions_of_the_definition() {
        let solid = BitGrid::from_fn([14, 13, 12], |[x, y, z]| {
            z < 6 && !((4..9).contains(&x) && (3..9).contains(&y) && z > 1)
        });
        let d = fibonacci_sphere(9)[1];
        for d in [Direction::Z, Direction::X, d] {
            let v = tool().along(d, 1.0, &Ctx::quiet()).unwrap();
            let expected = accessible(Engine::Naive, &solid, &v);
            assert_eq!(accessible(Engine::Fft, &solid, &v), expected, "{d:?}");
            assert_eq!(accessible(Engine::Bits, &solid, &v), expected, "{d:?}");
        }
    }
}
