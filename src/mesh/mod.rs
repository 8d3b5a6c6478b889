//! Triangle meshes: reading and writing the field's file formats, and their health.
//!
//! Method: [`read`] tells the format from the content (the extension decides only where the
//! content leaves it open) and makes a [`TriMesh`] in millimetres; [`Health`] names its defects;
//! [`write_stl`] and [`write_obj`] write it, the same bytes for the same mesh.
//!
//! | format | what is read |
//! |---|---|
//! | OBJ | `v` and `f`, relative numbers, faces of any size, all groups as one mesh |
//! | STL | binary and text; corners at the very same place become one vertex |
//! | PLY | text, both byte orders; faces of any size |
//! | OFF | with or without normals, colours, comments; faces of any size |
//! | 3MF | unit, build items, components, transforms, production extension |
//!
//! The readers are written here rather than taken from crates because they must name the line of
//! a fault, keep 64-bit coordinates and one vertex list over all groups, and bound what a hostile
//! file can make them allocate; only zip and XML come from outside.
//!
//! Guarantees: a [`TriMesh`] has finite vertices within [`TriMesh`]'s bounds and indices in range.
//! Any input, however broken, gives a mesh of at least one triangle or one [`ReadError`] that says
//! which file, where in it, what is wrong and how to mend it; nothing panics, and declared counts
//! are checked against the size of the file before memory is taken. Not guaranteed: that a mesh is
//! closed, oriented or free of self-intersections; [`crate::voxel`] makes a solid of it all the
//! same.
//!
//! ```
//! use hmplan::base::DVec3;
//! use hmplan::mesh::{Health, ReadOptions, TriMesh, read, write_stl};
//!
//! let path = std::env::temp_dir().join(format!("hmplan-doc-{}.stl", std::process::id()));
//! let part = TriMesh::cuboid(DVec3::ZERO, DVec3::new(1.0, 2.0, 3.0));
//! write_stl(&part, std::fs::File::create(&path)?)?;
//!
//! let inches = ReadOptions { mm_per_unit: 25.4 };
//! let loaded = read(&path, &inches)?;
//! let health = Health::of(&loaded.mesh);
//! assert!(health.watertight && health.warnings().is_empty());
//! assert!((health.extents.z - 76.2).abs() < 1e-9);
//! # std::fs::remove_file(&path)?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod edges;
mod error;
mod health;
mod instance;
mod nearest;
mod nesting;
mod obj;
mod off;
mod package;
mod ply;
mod polygon;
mod read;
mod soup;
mod stl;
mod text;
mod tri;
mod write;

pub use error::{Defect, Place, ReadError};
pub use health::Health;
pub use nearest::{NearestTriangle, SurfacePoint, closest_on_triangle};
pub use read::{Format, LoadedMesh, ReadOptions, read};
pub use tri::{InvalidMesh, TriMesh};
pub use write::{STL_FACET, stl_facet, write_obj, write_stl, write_stl_head};
