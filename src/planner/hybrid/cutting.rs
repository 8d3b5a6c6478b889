//! Over-cut (HB Sec. 4.1.1, Alg. 6): as much of P_i − P as one direction reaches, nothing of P.
//!
//! P_o = P_i − A(P_o, T, K, R) (Eq. 26). The iteration starts from O₀ = P_i ∩ P, where everything
//! else is gone, and takes back what the rest blocks; each round is a depth image, the tool's two
//! grey-scale morphologies on it and one comparison a voxel.

use super::site::{Site, View};
use crate::access::{Scene, cutter_map, reachable};
use crate::base::Direction;
use crate::machine::Tool;
use crate::morph::complement;
use crate::plan::Job;
use crate::voxel::BitGrid;
use rayon::prelude::*;

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

/// What of P's surroundings some cutter reaches along some direction while all of P stands, in the
/// job's coordinates: what is laid there can be taken away again, mostly.
pub fn clearable(job: &Job, views: &[View]) -> BitGrid {
    let around = complement(&job.target);
    let along = |view: &View| {
        let (site, around) = (view.site(job, &job.target), view.up(&around));
        let mut clear = BitGrid::new(around.dims());
        for tool in &job.cutters {
            clear.union_with(&reached(&site, &site.state, &around, tool));
        }
        view.down(&clear)
    };
    let none = || BitGrid::new(job.target.dims());
    views.par_iter().map(along).reduce(none, |a, b| a.or(&b))
}
