//! Tips between the cells of the lattice, for what no cell's own tip gets at.
//!
//! Method: a gap hardly wider than the cutter has room for it on one line, which need not run over the cells'
//! middles. Around a voxel that the lattice left, places much closer together than cells are tried, the
//! nearest first, each with the height over the meshes. Where the edge may go into them, the place from which it
//! goes least deep is looked for, ever nearer to the best one, be that too deep at first.
//!
//! Guarantees: a tip is no lower than the lowest free one over the meshes, or with a nick goes no deeper into them, its edge holds no middle of a voxel that
//! stays, and comes within the slack of the one to cut, aside and below. Not guaranteed: that a gap with no more room than the places are apart is found.

use super::exact::{Exact, Lowest, Nick};
use super::mill::Free;
use crate::base::{Cancelled, Ctx, DVec2, DVec3};
use crate::machine::Tool;
use rayon::prelude::*;

/// Places are so far apart, in cells.
const APART: f64 = 0.25;

/// Places along the edge's radius, at most.
const MOST_PER_RADIUS: f64 = 12.0;

/// How much less deep a cutter has to go into the surfaces for a place to be better than another, mm.
const SHALLOWER_MM: f64 = 0.001;

/// Looks around the best place that find nothing better, after each of which the next are closer by half, and looks at most
/// that find something: along a slanted wall the best place is far.
const CLOSER_LOOKS: usize = 6;
const MOVES: usize = 12;

/// From places where the edge goes into the meshes a voxel is met within this share of the slack: no deeper than it
/// must, but for rounding.
const NEARLY: f64 = 0.99;

/// The edge is looked at without its outermost, as a share of its end's radius no more than this.
const MOST_INSET: f64 = 0.9;

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
    /// How deep the edge may go, into the meshes less than its radius.
    pub nick: Nick,
    /// What shank and holder keep off where it is, where `lowest` does not know it for the cells around a tip.
    pub holder_off: Option<&'a Free>,
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

    /// The nearest of the places from which a voxel is met in its middle, or else within the slack; where the edge
    /// may go into the meshes, that from which it goes least deep.
    fn tip(&self, voxel: DVec3, places: &[DVec2]) -> Option<DVec3> {
        if self.nick.meshes > 0.0 {
            return self.shallowest(voxel, places);
        }
        let mut on = None;
        [0.0, self.slack].into_iter().find_map(|slack| {
            let mut tip = |by: &DVec2| self.tip_at((voxel, *by), (slack, 0.0), &mut on);
            places.iter().find_map(&mut tip)
        })
    }

    /// The tip from which a voxel is met going least deep into the meshes, of all the places and of
    /// those around the best of them; none where it goes too deep.
    fn shallowest(&self, voxel: DVec3, places: &[DVec2]) -> Option<DVec3> {
        /// A place, how deep the edge goes into the meshes there, mm, and the tip.
        type Found = (DVec2, f64, DVec3);
        let slack = NEARLY * self.slack;
        // A place from which it goes too deep may have one beside it from which it does not.
        let beside = (self.nick.meshes + self.apart()).min(MOST_INSET * self.tool.tip_radius());
        let most = beside.max(self.nick.meshes);
        let mut on = None;
        // The place if it is better than the best so far.
        let mut better = |by: DVec2, best: Option<Found>| -> Option<Found> {
            let mut going = |nick: f64| {
                let tip = self.tip_at((voxel, by), (slack, nick), &mut on);
                tip.map(|tip| (by, nick, tip))
            };
            let most = best.map_or(most, |(_, nick, _)| nick - SHALLOWER_MM);
            let mut found = if most >= 0.0 { going(most)? } else { return None };
            if let Some(not_at_all) = going(0.0) {
                return Some(not_at_all);
            }
            let mut too_little = 0.0;
            while found.1 - too_little > SHALLOWER_MM {
                let nick = (found.1 + too_little) / 2.0;
                match going(nick) {
                    Some(less) => found = less,
                    None => too_little = nick,
                }
            }
            Some(found)
        };
        let mut best = None;
        for by in places {
            best = better(*by, best).or(best);
        }
        let mut step = self.apart() / 2.0;
        let (mut looks, mut moves) = (0, 0);
        while looks < CLOSER_LOOKS && moves < MOVES {
            let (middle, ..) = best?;
            let mut moved = false;
            for (i, j) in (-2..=2).flat_map(|j| (-2..=2).map(move |i| (i, j))) {
                if let Some(found) = better(middle + DVec2::new(i.into(), j.into()) * step, best) {
                    (best, moved) = (Some(found), true);
                }
            }
            if moved {
                moves += 1;
            } else {
                (looks, step) = (looks + 1, step / 2.0);
            }
        }
        best.filter(|(_, nick, _)| *nick <= self.nick.meshes).map(|(.., tip)| tip)
    }

    /// The tip at a place beside a voxel from which its edge comes within `slack` of the voxel's middle, going no
    /// deeper than `nick` into the meshes.
    fn tip_at(
        &self,
        (voxel, by): (DVec3, DVec2),
        (slack, nick): (f64, f64),
        on: &mut Option<u32>,
    ) -> Option<DVec3> {
        let nick = Nick { meshes: nick, ..self.nick };
        let at = voxel.truncate() + by;
        let most = highest(self.tool, voxel, by.length(), slack);
        let may =
            most > f64::NEG_INFINITY && self.exact.is_free_nicked(at, most, nick, self.lowest, on);
        if !may {
            return None;
        }
        // Deeper than it must where it may, for the rounding of what is made of it.
        let lowest = self.exact.lowest_nicked(at, nick, self.lowest);
        let tip = at.extend(lowest.max(most - self.slack));
        let is_held_off = |free: &Free| free.clears_holder(self.tool, tip);
        let is_clear =
            self.free.is_clear(self.tool, tip) && self.holder_off.is_none_or(is_held_off);
        is_clear.then_some(tip)
    }

    /// How far apart places are, mm.
    fn apart(&self) -> f64 {
        let reach = self.tool.active_radius() + self.slack;
        (APART * self.cell).max(reach / MOST_PER_RADIUS)
    }

    /// Places around a voxel, the nearest first.
    fn places(&self) -> Vec<DVec2> {
        let reach = self.tool.active_radius() + self.slack;
        let apart = self.apart();
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
pub(super) fn highest(tool: &Tool, voxel: DVec3, rho: f64, slack: f64) -> f64 {
    voxel.z + slack - tool.active_lower_surface((rho - slack).max(0.0))
}

#[cfg(test)]
mod tests {
    use super::super::Replay;
    use super::super::near::voxels_near;
    use super::super::tests::{first_step, world};
    use super::*;
    use crate::base::DVec3;
    use crate::mesh::TriMesh;
    use crate::plan::StepKind;

    /// Two walls on a floor, with a gap of so many mm between them along x.
    fn walls(gap: f64) -> TriMesh {
        let boxed = |low: [f64; 3], high: [f64; 3]| TriMesh::cuboid(low.into(), high.into());
        TriMesh::joined(&[
            boxed([2.0, 2.0, 0.0], [22.0, 18.0, 5.0]),
            boxed([2.0, 2.0, 5.0], [22.0, 10.0 - gap / 2.0, 12.0]),
            boxed([2.0, 10.0 + gap / 2.0, 5.0], [22.0, 18.0, 12.0]),
        ])
    }

    /// A gap into which a cutter goes by the middles of voxels, but not by the mesh: from the places found it gouges
    /// either wall no deeper than it must, which is half of what the gap is too narrow. Once it went as deep as it might.
    #[test]
    fn a_gap_too_narrow_is_gouged_no_deeper_than_it_must_be() {
        const GAP_MM: f64 = 2.94;
        let slot = |p: DVec3| (p.y - 10.0).abs() < GAP_MM / 2.0 && p.z > 5.0;
        let block = |p: DVec3| p.x > 2.0 && p.x < 22.0 && (p.y - 10.0).abs() < 8.0 && p.z < 12.0;
        let size = DVec3::new(24.0, 20.0, 14.0);
        let mut w =
            world("generic-5axis", 0.5, size, block, &[(StepKind::Subtractive, DVec3::Z, slot)]);
        (w.job.target_mesh, w.job.initial_mesh) = (walls(GAP_MM), walls(0.0));
        let replay = Replay::of(&w.job, &w.plan).unwrap();
        let surfaces =
            [&w.job.target_mesh, &w.job.initial_mesh].map(|m| voxels_near(m, &w.job.frame));
        let tool = w.job.cutters.iter().find(|t| t.name == "ball-3x30").unwrap();
        let ctx = Ctx::quiet();
        let work = first_step(&w, &replay, &surfaces, tool, &ctx);
        let free = Free::around(&work, work.after, tool.active_radius());
        let exact = Exact::of(&work, &free).unwrap().unwrap();
        let lowest = exact.heights(&work, &free, 0.0, 0.0, 0.0).unwrap();
        let nick = |meshes: f64| Nick { meshes, passing: 0.0 };
        let between = |deep: f64| Between {
            exact: &exact,
            lowest: &lowest,
            free: &free,
            tool,
            cell: free.window.s,
            slack: 0.25,
            nick: nick(deep),
            holder_off: None,
        };
        let inside: Vec<DVec3> =
            (8..40).map(|k| DVec3::new(f64::from(k) * 0.5 + 0.25, 10.25, 6.75)).collect();
        let count = |nick: f64| between(nick).tips(&inside, &Ctx::quiet()).unwrap();
        assert!(count(0.0).is_empty() && count(0.02).is_empty());
        // From none of the places as they are it goes in less than 0.07 mm deep, but beside them.
        assert!(!count(0.035).is_empty());
        let tips = count(0.2);
        assert!(!tips.is_empty());
        for tip in tips {
            let is_free = |deep: f64| {
                exact.is_free_nicked(tip.truncate(), tip.z + 1e-6, nick(deep), &lowest, &mut None)
            };
            assert!(is_free(0.04) && !is_free(0.02), "{tip}");
        }
    }

    /// Between a wall and what a later step cuts beside it a cutter has no room but past the middles of that one's
    /// voxels; it leaves the wall whole.
    #[test]
    fn what_goes_later_is_nicked_before_the_target() {
        const WALL_MM: f64 = 8.9;
        let slot = |p: DVec3| p.y > WALL_MM && (p.y < 11.5 && p.z > 5.0 || p.z > 10.0);
        let beyond = |p: DVec3| p.y > 11.5 && p.z > 5.0 && p.z < 10.0;
        let block = |p: DVec3| p.x > 2.0 && p.x < 22.0 && (p.y - 10.0).abs() < 8.0 && p.z < 12.0;
        let size = DVec3::new(24.0, 20.0, 14.0);
        let cut = StepKind::Subtractive;
        let steps = [(cut, DVec3::Z, slot as fn(DVec3) -> bool), (cut, DVec3::Z, beyond)];
        let mut w = world("generic-5axis", 0.5, size, block, &steps);
        let boxed = |low: [f64; 3], high: [f64; 3]| TriMesh::cuboid(low.into(), high.into());
        w.job.target_mesh = TriMesh::joined(&[
            boxed([2.0, 2.0, 0.0], [22.0, 18.0, 5.0]),
            boxed([2.0, 2.0, 5.0], [22.0, WALL_MM, 12.0]),
        ]);
        w.job.initial_mesh = boxed([2.0, 2.0, 0.0], [22.0, 18.0, 12.0]);
        let replay = Replay::of(&w.job, &w.plan).unwrap();
        let surfaces =
            [&w.job.target_mesh, &w.job.initial_mesh].map(|m| voxels_near(m, &w.job.frame));
        let tool = w.job.cutters.iter().find(|t| t.name == "ball-3x30").unwrap();
        let ctx = Ctx::quiet();
        let work = first_step(&w, &replay, &surfaces, tool, &ctx);
        let free = Free::around(&work, work.after, tool.active_radius());
        let stays = Free::around(&work, &work.after.and(&w.job.target), tool.active_radius());
        let exact = Exact::of(&work, &free).unwrap().unwrap();
        let lowest = exact.heights(&work, &free, 0.0, 0.0, 0.0).unwrap();
        let beside_the_wall: Vec<DVec3> =
            (10..38).map(|k| DVec3::new(f64::from(k) * 0.5 + 0.25, 9.25, 8.75)).collect();
        let tips = |meshes: f64, passing: f64| {
            let free = if passing > 0.0 { &stays } else { &free };
            let nick = Nick { meshes, passing };
            let (exact, lowest, cell) = (&exact, &lowest, free.window.s);
            let holder_off = None;
            let between =
                Between { exact, lowest, free, tool, cell, slack: 0.25, nick, holder_off };
            between.tips(&beside_the_wall, &Ctx::quiet()).unwrap()
        };
        assert!(tips(0.045, 0.0).is_empty());
        let found = tips(0.045, 0.25);
        assert!(!found.is_empty());
        for tip in found {
            assert!(tip.y > WALL_MM + 1.5 - 0.046 && tip.y < 11.75 - 1.5 + 0.251, "{tip}");
        }
    }
}
