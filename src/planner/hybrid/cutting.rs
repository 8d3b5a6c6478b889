//! Over-cut (HB Sec. 4.1.1, Alg. 6): as much of P_i − P as one direction reaches, nothing of P.
//!
//! P_o = P_i − A(P_o, T, K, R) (Eq. 26). The iteration starts from O₀ = P_i ∩ P, where everything
//! else is gone, and takes back what the rest blocks; each round is a depth image, the tool's two
//! grey-scale morphologies on it and one comparison a voxel.

use super::site::Site;
use crate::access::{Scene, cutter_map, reachable};
use crate::base::Direction;
use crate::machine::Tool;
use crate::voxel::BitGrid;

/// An over-cut, in turned coordinates.
pub struct OverCut {
    pub region: BitGrid,
    /// What of P_i − P the tool does not reach even were all the rest of it gone.
    pub hidden: BitGrid,
}

/// The largest part of `removable` that the tool removes, each voxel reached in the state that is
/// left.
pub fn over_cut(site: &Site, removable: &BitGrid, tool: &Tool) -> OverCut {
    let mut region = removable.and(&site.state);
    let mut hidden = None;
    while !region.is_empty() {
        let next = reached(site, &site.state.minus(&region), &region, tool);
        hidden.get_or_insert_with(|| region.minus(&next));
        if next == region {
            break;
        }
        region = next;
    }
    let hidden = hidden.unwrap_or_else(|| BitGrid::new(region.dims()));
    OverCut { region, hidden }
}

/// The voxels of `wanted` that the tool touches from somewhere free while `standing` stands.
pub fn reached(site: &Site, standing: &BitGrid, wanted: &BitGrid, tool: &Tool) -> BitGrid {
    let frame = &site.view.frame;
    let scene = Scene::from_above(frame, standing, &site.fixed);
    reachable(&cutter_map(&scene, wanted, tool, Direction::Z), wanted, frame)
}
