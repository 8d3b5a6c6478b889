//! Triangle meshes: reading and writing the field's file formats, and their health.
//!
//! Guarantees: a [`TriMesh`] has finite vertices and indices in range. Not guaranteed: that it is
//! closed, oriented or free of self-intersections; [`crate::voxel`] makes a solid of it all the
//! same, and `health` names the defects.

mod tri;

pub use tri::{InvalidMesh, TriMesh};
