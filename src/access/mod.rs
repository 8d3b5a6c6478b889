//! Where tools reach: accessibility of milling and of deposition along any direction, and what
//! a direction can remove or add from a given state.
//!
//! Method: the *depth* engine. For a tool that goes up without end, an obstacle is no more than
//! its depth image h(u, v) across the direction. The tip may stand at (u, v, z) exactly when
//! z ≥ H(u, v) = max (h − f), and the edge touches x exactly when x_z ≥ G = min (H + k): two
//! grey-scale morphologies on an image instead of two Minkowski sums in space.
//!
//! Guarantees: along the grid axes the answer equals the definition; along any other direction it
//! is never larger (what it calls reachable is reachable, with a tip on the lattice of the rules).
//! Not guaranteed: off the axes it may miss positions within one voxel of an obstacle, and wide
//! sections (holders, heads) count up to 12 % wider than they are.

mod additive;
mod collateral;
mod columns;
mod depth;
mod filter;
mod regions;
mod scene;
mod subtractive;
mod support;
#[cfg(test)]
mod tests;
mod voxel_tool;

pub use additive::{CarrierTable, supported};
pub use collateral::{Collateral, collateral};
pub use depth::{DepthMap, cutter_map, cutter_maps, nozzle_map};
pub use regions::{Engine, EngineChoice, accessible, choose, inaccessible, obstacle};
pub use scene::Scene;
pub use subtractive::{Cut, over_cut, reachable};
pub use support::{Overhang, grounded, self_supported, supported_access, supporting};
pub use voxel_tool::{NoVoxelTool, VoxelTool};
