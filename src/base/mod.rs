//! What three or more modules need: directions, boxes, named tolerances, seeded randomness and the
//! context (budget, cancel, progress) that long computations are handed.
//!
//! Guarantees: a [`Direction`] is a unit vector; [`rng`] gives the same numbers for the same seed
//! and stream on every machine. Not guaranteed: nothing here knows voxels, meshes or machines.

mod bounds;
mod ctx;
mod direction;
mod random;
pub mod tolerance;

pub use bounds::Aabb;
pub use ctx::{Cancelled, Ctx, Progress, Silent};
pub use direction::{Direction, ImagePlane, NotADirection, fibonacci_sphere};
pub use glam::{DAffine3, DMat3, DVec2, DVec3};
pub use random::{Rng, rng};
