//! Where tools reach: accessibility of milling and of deposition, what reaching more would cost,
//! what stands by itself, and what a direction can remove or add from a given state.
//!
//! Method. For a tool that goes up without end, an obstacle is no more than its depth image h(u, v)
//! across the direction: the *depth* engine. The tip may stand at (u, v, z) exactly when
//! z ≥ H(u, v) = max (h − f), and the edge touches x exactly when x_z ≥ G = min (H + k): two
//! grey-scale morphologies on an image instead of two Minkowski sums in space. It works with real
//! heights along any direction ([`cutter_map`], [`reached_along`]) and on voxels along the grid
//! axes. Tools of other shapes are sets of voxels ([`VoxelTool`]) and go through [`crate::morph`];
//! [`choose`] says which engine is cheapest. Which cells of a part stand in the way of which points,
//! once and for all states to come, is the [`DependencyGraph`].
//!
//! Guarantees: the engines of [`accessible`] agree voxel for voxel. With real heights the answer
//! equals the definition along the grid axes; along any other direction it is never larger (what
//! it calls reachable is reachable, with a tip on the lattice of the rules). Not guaranteed: off
//! the axes it may miss positions within one voxel of an obstacle, and wide sections (holders,
//! heads) count up to 12 % wider than they are.

mod additive;
#[cfg(test)]
mod allowance_tests;
mod boxes;
mod ceilings;
mod cells;
mod close_cut;
mod close_nozzle;
mod collateral;
mod columns;
mod depend;
mod depth;
mod filter;
mod floors;
mod image;
mod lattice;
mod mesh_tool;
mod open;
mod regions;
mod scene;
mod subtractive;
mod support;
mod survey;
#[cfg(test)]
mod tests;
mod tiles;
mod tilted;
mod tops;
mod view;
mod voxel_tool;
mod wanted;

pub use additive::{CarrierTable, supported};
pub use close_cut::Close;
pub use close_nozzle::CloseNozzle;
pub use collateral::{Collateral, collateral};
pub use depend::{CellSet, Cells, Demand, DependencyGraph, Reachers};
pub use depth::{cutter_map, cutter_maps, nozzle_map};
pub use lattice::DepthMap;
pub use mesh_tool::{MeshTool, MeshToolError};
pub use open::{reachable, reached_along};
pub use regions::{Engine, EngineChoice, accessible, choose, inaccessible, obstacle};
pub use scene::Scene;
pub use subtractive::{Cut, over_cut};
pub use support::{Overhang, grounded, self_supported, supported_access, supporting};
pub use survey::{AnyTool, Damage, Reach, Survey, damage, reached, survey};
pub use tilted::support_along;
pub use voxel_tool::{NoVoxelTool, VoxelTool};
pub use wanted::Wanted;
