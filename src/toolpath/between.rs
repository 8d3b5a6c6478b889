//! Tips between the cells of the lattice, for what no cell's own tip gets at.
//!
//! Method: a gap hardly wider than the cutter has room for it on one line, which need not run over the cells'
//! middles. Around a voxel that the lattice left, places much closer together than cells are tried, the
//! nearest first, each with the height over the meshes.
//!
//! Guarantees: a tip is no lower than the lowest free one over the meshes, or with a nick goes no deeper into them, its edge holds no middle of a voxel that
//! stays, moved to its cell, and comes within the slack of the one to cut, aside and below. Not guaranteed: that a gap with no more room than the places are apart is found.

use super::exact::{Exact, Lowest};
use super::mill::Free;
use crate::base::{Cancelled, Ctx, DVec2, DVec3};
use crate::machine::Tool;
use rayon::prelude::*;

/// Places are so far apart, in cells.
const APART: f64 = 0.25;

/// Places along the edge's radius, at most.
const MOST_PER_RADIUS: f64 = 12.0;

/// Voxels looked at together: more keep more threads busy, fewer know more of the tips found before.
const AT_A_TIME: usize = 64;

pub(super) struct Between<'a> {
    pub exact: &'a Exact,
    pub lowest: &'a Lowest,
    pub free: &'a Free,
    pub tool: &'a Tool,
    /// Side of the lattice's cells, mm.
    pub cell: f64,
    /// How far under the edge and beside it a voxel counts as cut, mm.
    pub slack: f64,
    /// How deep the edge may go into the meshes, mm; less than its radius.
    pub nick: f64,
}

impl Between<'_> {
    /// Tips that cut voxels whose middles are given, as (u, v, height) both, as few as one look at each tells.
    ///
    /// # Errors
    /// When the user stops the run.
    pub fn tips(&self, voxels: &[DVec3], ctx: &Ctx) -> Result<Vec<DVec3>, Cancelled> {
        let places = self.places();
        let mut tips: Vec<DVec3> = Vec::new();
        for some in voxels.chunks(AT_A_TIME) {
            ctx.check()?;
            let is_cut = |p: &DVec3, tips: &[DVec3]| {
                tips.iter().rev().any(|t| cuts(self.tool, *t, *p, self.slack))
            };
            let look = |p: &DVec3| (!is_cut(p, &tips)).then(|| self.tip(*p, &places)).flatten();
            let found: Vec<Option<DVec3>> = some.par_iter().map(look).collect();
            let before = tips.len();
            for (p, tip) in some.iter().zip(found) {
                if let Some(tip) = tip.filter(|_| !is_cut(p, &tips[before..])) {
                    tips.push(tip);
                }
            }
        }
        Ok(tips)
    }

    /// The nearest of the places from which a voxel is met in its middle, or else within the slack.
    fn tip(&self, voxel: DVec3, places: &[DVec2]) -> Option<DVec3> {
        let mut on = None;
        [0.0, self.slack].into_iter().find_map(|slack| {
            places.iter().find_map(|by| {
                let (at, most) =
                    (voxel.truncate() + *by, highest(self.tool, voxel, by.length(), slack));
                let may = most > f64::NEG_INFINITY;
                if !may || !self.exact.is_free_nicked(at, most, self.nick, self.lowest, &mut on) {
                    return None;
                }
                // Deeper than it must where it may, for the rounding of what is made of it.
                let lowest = self.exact.lowest_nicked(at, self.nick, self.lowest);
                let tip = at.extend(lowest.max(most - self.slack));
                self.free.is_clear(self.tool, tip).then_some(tip)
            })
        })
    }

    /// Places around a voxel, the nearest first.
    fn places(&self) -> Vec<DVec2> {
        let reach = self.tool.active_radius() + self.slack;
        let apart = (APART * self.cell).max(reach / MOST_PER_RADIUS);
        let n = (reach / apart).floor() as i64;
        let all = (-n..=n).flat_map(|j| (-n..=n).map(move |i| (i, j)));
        let mut cells: Vec<(i64, i64)> = all.collect();
        cells.sort_by_key(|(i, j)| (i * i + j * j, *j, *i));
        let places = cells.into_iter().map(|(i, j)| DVec2::new(i as f64, j as f64) * apart);
        places.filter(|p| p.length() <= reach).collect()
    }
}

/// Whether a tip's edge comes within `slack` mm of a voxel's middle, aside and below; (u, v, height) both.
pub(super) fn cuts(tool: &Tool, tip: DVec3, voxel: DVec3, slack: f64) -> bool {
    // The edge reaches nowhere below its tip.
    tip.z <= voxel.z + slack
        && tip.z <= highest(tool, voxel, tip.truncate().distance(voxel.truncate()), slack)
}

/// The highest tip that cuts a voxel from `rho` mm aside; −∞ from too far.
fn highest(tool: &Tool, voxel: DVec3, rho: f64, slack: f64) -> f64 {
    voxel.z + slack - tool.active_lower_surface((rho - slack).max(0.0))
}
