//! The voxel core: where voxels are ([`Frame`]), which are solid ([`BitGrid`]).
//!
//! Method: one bit a voxel, packed along x into rows of u64 words, rows ordered by y, then z, so
//! that Booleans, counts and row operations run at memory speed. A voxel is solid when its centre
//! is inside the solid.
//!
//! Guarantees: the padding bits of every row are zero after every public operation; Booleans are
//! exact. Not guaranteed: anything about the shape between voxel centres.
//!
//! ```
//! use hmplan::voxel::BitGrid;
//! let mut a = BitGrid::new([3, 2, 1]);
//! a.set([2, 1, 0], true);
//! assert_eq!(a.iter_ones().collect::<Vec<_>>(), [[2, 1, 0]]);
//! ```

mod bitgrid;
mod closure;
mod components;
mod distance;
mod frame;
mod loops;
mod repair;
mod resample;
mod runs;
mod skin;
mod standing;
mod surface;
mod text;
mod voxelise;
#[cfg(test)]
mod voxelise_tests;
mod winding;

pub use bitgrid::BitGrid;
pub use components::{Components, Connectivity, components, flood};
pub use distance::{NOWHERE, distance_squared, distance_within};
pub use frame::{Frame, FrameTooLarge};
pub use resample::{coarsened, refined};
pub use runs::{RunRows, RunsError};
pub use skin::Skin;
pub use standing::{Rim, standing};
pub use surface::surface;
pub use text::{VoxelTextError, blocks, parse_voxel_text};
pub use voxelise::voxelise;
