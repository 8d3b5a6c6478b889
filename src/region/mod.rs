//! The volumes of remanufacturing and their interfaces: what is reused, removed and added, the
//! printing bases between them, and clipping planes.
//!
//! Guarantees: the volumes partition M ∪ M*; a base's normals are those of the nearest triangles,
//! never of voxel faces. Not guaranteed: that a volume can be made; see [`crate::access`].

mod base_surface;
mod volumes;

pub use base_surface::{Facet, PrintingBase, printing_bases};
pub use volumes::{Volumes, above, steady};
