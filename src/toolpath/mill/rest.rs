//! What the passes of a step left of its region.
//!
//! Method: the voxels are listed that no tip came within half a voxel of with its edge, aside and below, as
//! the program's check asks it; whatever then cuts some takes them off the list. First go the lattice's tips without
//! margin, over the meshes where the job has them, then tips between its cells. What the meshes leave no room for,
//! the voxels may, which is what the plan was made on: see [`Stage::for_a_gouge`]; what later steps cut is entered by
//! half a pitch before the target is nicked deeper, and before that becomes a gouge places are tried that have just the room they need
//! (see [`Nearness`]). A few voxels of a small region each get a tip by exact distances. Supports are cut to the middles of their
//! voxels, wherever that is no gouge.
//!
//! Guarantees: what is off the list was cut, by tips a quarter of a voxel apart on its way. Not guaranteed: an
//! empty list.

use super::super::GOUGE_MM;
use super::super::between::{Between, cuts, highest};
use super::super::cells::Cells;
use super::super::close_tip::Stays;
use super::super::exact::{Lowest, Nick};
use super::super::image::{Image, Lattice, Profile};
use super::super::moves::{Move, MoveKind};
use super::super::touch::{Touch, bounds};
use super::{FAR_CELLS, Free, SAME_HEIGHT_MM, Stage, within};
use crate::base::{Cancelled, Ctx, DVec2, DVec3};
use crate::machine::Tool;
use crate::voxel::{BitGrid, Rim};
use rayon::prelude::*;
use std::f64::consts::FRAC_1_SQRT_2;

/// Share of the region that must be swept: a little more than the program's check asks for.
const LEAST_SHARE: f64 = 0.981;

/// Of a region of so few voxels a few, even a single one, are more than may be left.
const FEW: usize = 4000;

/// Of so few voxels that are left each gets a tip of its own, by exact distances: of a crease of 23 mm³ a hundred were.
const FEWEST: usize = 256;

/// Lumps this deep, as a share of the surface tolerance, are cut at the price of a gouge: the
/// program's check finds those of the whole of it.
const LUMP_SHARE: f64 = 0.9;

/// So many voxels that are left so deep make a lump: as many as the program's check asks for.
const LEAST_LUMP: usize = 8;

/// How deep a cutter may go into a surface to get at what stands in a crevice, mm: less than what
/// counts as a gouge, rounding of three decimals included.
const NICK_MM: f64 = 0.045;

/// Where that is not enough, ever deeper, mm: in small steps, since of one that is more than enough much is cut deeper
/// than it must be. The second is a gouge less the rounding of three decimals.
const NICKS_MM: [f64; 9] = [NICK_MM, 0.049, 0.055, 0.065, 0.08, 0.1, 0.12, 0.15, 0.2];

/// How far a cutter may pass the middles of voxels that go later before it nicks the target deeper, in pitches and as
/// a share of what the program's check lets it.
const PASSING_PITCH: f64 = 0.5;
const PASSING_SHARE: f64 = 0.8;

/// Tips on a way are looked at so far apart, in pitches.
const APART_PITCH: f64 = 0.5;

/// Tips are looked through by cells so many to a cutter's reach: fewer hold tips that are out of reach, more cost looks of their
/// own. No smaller than this, mm, for the memory that cells over a whole part take.
const CELLS_PER_REACH: f64 = 8.0;
const LEAST_CELL_MM: f64 = 0.2;

/// What tips between cells keep off.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Nearness {
    /// With shank and holder what the cells around a tip do, and the target's surface to the voxels' faces.
    ToACell,
    /// What is where it is, and the target's surface to the middles of its rim's voxels, as of what has no surface: beyond
    /// them deposits come up to it again. In a pit as wide as its cutter there is no other place.
    AsItIs,
}

/// Voxels of the region that are not cut yet.
struct Left {
    /// Their middles, as (u, v, height).
    voxels: Vec<DVec3>,
    /// Moves whose cuts are taken off.
    known: usize,
    /// How far aside of the edge and under it a voxel is cut, mm.
    slack: f64,
}

impl Stage<'_> {
    /// Cuts what region is left; returns the fraction that is covered in the end.
    pub(super) fn rest(&mut self) -> Result<f64, Cancelled> {
        let all = self.work.step.region.count();
        let half = self.work.frame.pitch / 2.0 + SAME_HEIGHT_MM;
        let mut left = self.left(&self.work.step.region, half)?;
        let exact = std::mem::take(&mut self.exact.tips.data);
        let mut counts = vec![left.voxels.len()];
        self.cut_over(&mut left, &exact)?;
        counts.push(left.voxels.len());
        if self.meshes.is_some() {
            self.between_cells(&mut left, Nick::NONE, Nearness::ToACell)?;
            counts.push(left.voxels.len());
            self.for_a_gouge(&mut left, &exact)?;
            counts.push(left.voxels.len());
        }
        tracing::debug!(tool = self.work.tool.name, all, left = ?counts, "rest");
        if all <= FEW && left.share_of(all) < LEAST_SHARE && left.voxels.len() <= FEWEST {
            self.by_exact_distances(&mut left)?;
        }
        if self.meshes.is_some() {
            self.through_supports(&exact)?;
        }
        Ok(left.share_of(all))
    }

    /// Cuts to their middles what stands of supports alone, as far as that is no gouge: half of a bead that is left is a
    /// bead outside the target, where half of a voxel of stock beside it is within what finishing leaves.
    fn through_supports(&mut self, exact: &[f32]) -> Result<(), Cancelled> {
        let work = self.work;
        let supports = work.step.region.and(work.laid).minus(&work.job.target);
        if supports.is_empty() {
            return Ok(());
        }
        let mut left = self.left(&supports, SAME_HEIGHT_MM)?;
        let mut counts = vec![left.voxels.len()];
        self.cut_over(&mut left, exact)?;
        counts.push(left.voxels.len());
        self.between_cells(&mut left, Nick::NONE, Nearness::ToACell)?;
        for (nearness, nick) in self.without_gouge() {
            self.between_cells(&mut left, nick, nearness)?;
        }
        counts.push(left.voxels.len());
        let all = supports.count();
        tracing::debug!(tool = work.tool.name, all, left = ?counts, "supports");
        Ok(())
    }

    /// Cuts what is left from the nearest cells, with lowest tips `free`.
    fn cut_over(&mut self, left: &mut Left, free: &[f32]) -> Result<(), Cancelled> {
        if !left.voxels.is_empty() {
            self.lower_over(&left.voxels, free)?;
            self.take_off(left);
        }
        Ok(())
    }

    /// Cuts what the cells' tips over the meshes left from tips between them, as far as there are any that go no
    /// deeper than a nick into the meshes.
    fn between_cells(
        &mut self,
        left: &mut Left,
        nick: Nick,
        nearness: Nearness,
    ) -> Result<(), Cancelled> {
        let (work, lowest, cell) = (self.work, &self.exact, self.lattice.s);
        let is_as_it_is = nearness == Nearness::AsItIs;
        // Where nothing may be passed, a place with no more than the room it needs is one between the cells as well.
        let asks = !left.voxels.is_empty() && (nick.passing > 0.0 || !is_as_it_is);
        let Some(meshes) = self.meshes.as_ref().filter(|_| asks) else { return Ok(()) };
        let tool = work.tool;
        let (exact, free) = match nick.passing > 0.0 {
            true => {
                let (exact, free) = self.past[usize::from(is_as_it_is)].get_or_init(|| {
                    // What passes is among the obstacles that the meshes are asked besides, nicked.
                    let stays = work.after.and(&work.job.target);
                    let free = Free::around(work, &stays, tool.active_radius());
                    let rim = if is_as_it_is { Rim::Inner } else { Rim::Parted };
                    (meshes.past(work, &self.free, rim), free)
                });
                (exact, free)
            }
            false => (meshes, &self.free),
        };
        let edge_alone = Lowest::of_voxels(Image::empty(self.lattice));
        let (off, holder_off) =
            if is_as_it_is { (&edge_alone, Some(&self.free)) } else { (lowest, None) };
        let slack = left.slack;
        let between = Between { exact, lowest: off, free, tool, cell, slack, nick, holder_off };
        let tips = between.tips(&left.voxels, work.ctx)?;
        let touch = Touch { work, exact, lowest, stock: self.process.stock };
        let ways = touch.joined(tips, &|tip| free.is_clear(tool, tip))?;
        for way in ways {
            let top = self.top_within(left.slack, &way, &left.voxels);
            self.touch_along(way, top);
        }
        self.retract();
        self.take_off(left);
        Ok(())
    }

    /// Cuts what the `exact` heights, those over the meshes, leave no room for, as far as it must be: lumps deeper
    /// than half the tolerance as far as a nick lets the tool in; by ever deeper nicks, and at last at the price of
    /// a pitch's gouge, a region of which so much is left that the plan's volume is not cut, and what is deeper than
    /// the rules allow. Deep is meant to all sides: along a wall a cell's width that is left is none.
    fn for_a_gouge(&mut self, left: &mut Left, exact: &[f32]) -> Result<(), Cancelled> {
        if left.voxels.is_empty() {
            return Ok(());
        }
        let plain = self.free.heights(self.work.tool, 0.0, 0.0, self.work.ctx)?.data;
        let all = self.work.step.region.count();
        if left.share_of(all) < LEAST_SHARE {
            let deeper = self.nicks().filter(|nick| nick.meshes > GOUGE_MM);
            let deeper = deeper.map(|nick| (Nearness::ToACell, nick));
            for (nearness, nick) in self.without_gouge().chain(deeper) {
                self.between_cells(left, nick, nearness)?;
                if left.share_of(all) >= LEAST_SHARE {
                    break;
                }
            }
            if left.share_of(all) < LEAST_SHARE {
                return self.cut_over(left, &plain);
            }
        }
        let tolerance = self.work.job.rules.tolerance_mm;
        let nick = |(z, e): (&f32, &f32)| z.max(e - NICK_MM as f32);
        let nicked: Vec<f32> = plain.iter().zip(exact).map(nick).collect();
        // Nor may a lump be left that the program's check would find.
        for (share, free) in [(0.5, &nicked), (LUMP_SHARE, &plain)] {
            let slack = (share * tolerance).max(left.slack);
            let voxels = self.not_cut(left.voxels.clone(), &self.moves, slack);
            let mut lumps = Left { voxels, known: self.moves.len(), slack };
            if share == LUMP_SHARE {
                // Deeper nicks are no better than the voxels' own heights, which come next: on a bracket these cost
                // 0.06 mm, and nicks 0.1.
                for (nearness, nick) in self.without_gouge() {
                    self.between_cells(&mut lumps, nick, nearness)?;
                }
            }
            // The program's check lets fewer pass than it calls a lump: less than a gouge all along the way to them.
            if share != LUMP_SHARE || lumps.voxels.len() >= LEAST_LUMP {
                self.cut_over(&mut lumps, free)?;
            }
        }
        self.take_off(left);
        Ok(())
    }

    /// Nicks that are no gouge, first from places with all the room that cells ask for.
    fn without_gouge(&self) -> impl Iterator<Item = (Nearness, Nick)> + use<> {
        let nicks: Vec<Nick> = self.nicks().filter(|nick| nick.meshes <= GOUGE_MM).collect();
        let from = [Nearness::ToACell, Nearness::AsItIs];
        from.into_iter().flat_map(move |from| nicks.clone().into_iter().map(move |n| (from, n)))
    }

    fn nicks(&self) -> impl Iterator<Item = Nick> + use<> {
        let work = self.work;
        nicks(work.tool, work.frame.pitch, work.job.rules.tolerance_mm)
    }

    /// Cuts each of the last voxels from a tip of its own.
    fn by_exact_distances(&mut self, left: &mut Left) -> Result<(), Cancelled> {
        let stays = Stays::of(self.work, self.lattice);
        for p in left.voxels.clone() {
            self.work.ctx.check()?;
            if left.voxels.contains(&p)
                && let Some(tip) = stays.tip(p, left.slack)
            {
                let top = self.top_within(left.slack, &[tip], &left.voxels);
                self.touch_along(vec![tip], top);
                self.retract();
                self.take_off(left);
            }
        }
        Ok(())
    }

    /// What of some of the region the moves so far did not cut.
    fn left(&self, some: &BitGrid, slack: f64) -> Result<Left, Cancelled> {
        let (l, work) = (self.lattice, self.work);
        let region = some.iter_ones().map(|v| self.seen(work.frame.center(v)));
        let region: Vec<DVec3> = region.collect();
        let tips = self.cut_tips(&self.moves, l.s / 2.0);
        let voxels = hardly_cut(&region, tips, (l, work.tool, slack), work.ctx)?;
        let voxels = self.not_cut(voxels, &self.moves, slack);
        Ok(Left { voxels, known: self.moves.len(), slack })
    }

    /// Takes off what the moves since the last time cut.
    fn take_off(&self, left: &mut Left) {
        let new = &self.moves[left.known.saturating_sub(1)..];
        left.voxels = self.not_cut(std::mem::take(&mut left.voxels), new, left.slack);
        left.known = self.moves.len();
    }

    /// Those of some voxels that no tip of some moves cuts.
    fn not_cut(&self, voxels: Vec<DVec3>, moves: &[Move], slack: f64) -> Vec<DVec3> {
        if voxels.is_empty() {
            return voxels;
        }
        let tips = self.cut_tips(moves, APART_PITCH * self.work.frame.pitch);
        not_cut_from(tips, voxels, self.work.tool, slack)
    }

    /// Cuts points, as (u, v, height), each from the nearest cell over which the tip may
    /// stand low enough.
    fn lower_over(&mut self, points: &[DVec3], free: &[f32]) -> Result<(), Cancelled> {
        let (l, tool) = (self.lattice, self.work.tool);
        let h = self.work.frame.pitch as f32;
        let offsets = within(tool.active_radius().min(FAR_CELLS * l.s), l.s);
        let mut need = vec![f32::INFINITY; l.cells()];
        let mut ceiling: Vec<f32> = self.top.data.iter().map(|t| t + h).collect();
        for p in points {
            let (uv, height) = (p.truncate(), p.z as f32);
            let Some(cell) = l.cell(uv) else { continue };
            let reached = |slack: f64| {
                offsets.iter().find_map(|(di, dj)| {
                    let i = cell[0].checked_add_signed(*di as isize)?;
                    let j = cell[1].checked_add_signed(*dj as isize)?;
                    let inside = i < l.n[0] && j < l.n[1];
                    let rho = (l.uv([i, j]).distance(uv) - slack).max(0.0);
                    let z = height + slack as f32 - tool.active_lower_surface(rho) as f32;
                    let at = l.index([i, j]);
                    (inside && free[at] <= z).then_some((at, z))
                })
            };
            // The plan takes a voxel for the middle of its cell.
            if let Some((at, z)) = reached(0.0).or_else(|| reached(f64::from(h) / 2.0)) {
                let z = free[at].max(z - 0.25 * h);
                need[at] = need[at].min(z);
                // From just beside the region the edge meets none of it by the lattice.
                ceiling[at] = ceiling[at].max(height + h);
            }
        }
        let near = self.near()?;
        self.levels(&need, &ceiling, &near)
    }

    /// Height of the highest of some voxels under the edge of some tips: stock is known by cells, and may be out
    /// of reach of tips between them.
    fn top_within(&self, slack: f64, tips: &[DVec3], voxels: &[DVec3]) -> f64 {
        let reach = self.work.tool.active_radius() + slack;
        let near = |v: &&DVec3| tips.iter().any(|t| t.truncate().distance(v.truncate()) <= reach);
        voxels.iter().filter(near).map(|v| v.z).fold(f64::NEG_INFINITY, f64::max)
    }

    /// A point as (u, v, height).
    fn seen(&self, p: DVec3) -> DVec3 {
        let plane = self.lattice.plane;
        plane.across(p).extend(plane.height(p))
    }

    /// Tips on the way of the cuts, as (u, v, height), at most `apart` mm from each other.
    fn cut_tips<'m>(
        &self,
        moves: &'m [Move],
        apart: f64,
    ) -> impl Iterator<Item = DVec3> + use<'m, '_> {
        let cuts = moves.windows(2).filter(|w| w[1].kind == MoveKind::Cut);
        cuts.flat_map(move |w| {
            let (a, b) = (self.seen(w[0].tip), self.seen(w[1].tip));
            let n = (a.distance(b) / apart).ceil().max(1.0);
            (0..=n as usize).map(move |i| a.lerp(b, i as f64 / n))
        })
    }
}

/// How deep a tip between the cells may go, the least first; no deeper into the meshes than half its end's radius, by
/// which a tapered end is wide at its tip. On voxels of a pitch, for a surface tolerance, mm.
fn nicks(tool: &Tool, pitch: f64, tolerance: f64) -> impl Iterator<Item = Nick> + use<> {
    let checked = PASSING_SHARE * FRAC_1_SQRT_2 * (tolerance - pitch / 2.0);
    let passing = (PASSING_PITCH * pitch).min(checked).max(0.0);
    let most = tool.tip_radius() / 2.0;
    let alone = Nick { meshes: NICK_MM, passing: 0.0 };
    let nicks = NICKS_MM.into_iter().map(move |meshes| Nick { meshes, passing });
    let alone = (passing > 0.0).then_some(alone);
    alone.into_iter().chain(nicks).filter(move |nick| nick.meshes <= most)
}

/// Those of some voxels that none of some tips cuts, in their order; all as (u, v, height).
fn not_cut_from(
    tips: impl Iterator<Item = DVec3>,
    voxels: Vec<DVec3>,
    tool: &Tool,
    slack: f64,
) -> Vec<DVec3> {
    let reach = tool.active_radius() + slack;
    let (lo, hi) = bounds(voxels.iter().map(|p| p.truncate()));
    let (lo, hi) = (lo - reach, hi + reach);
    let top = voxels.iter().map(|p| p.z).fold(f64::NEG_INFINITY, f64::max);
    let near = |tip: &DVec3| {
        let at = tip.truncate();
        // The edge reaches nowhere below its tip.
        tip.z <= top + slack && at.cmpge(lo).all() && at.cmple(hi).all()
    };
    let tips: Vec<DVec3> = tips.filter(near).collect();
    if tips.is_empty() {
        return voxels;
    }
    let (lo, hi) = bounds(tips.iter().map(|p| p.truncate()));
    let cells = Cells::over(lo, hi, (reach / CELLS_PER_REACH).max(LEAST_CELL_MM));
    // Those of a cell after one another, the lowest first.
    let of_cell = |tip: DVec3| cells.at(tip.truncate()).map(|c| (c, tip));
    let mut tips: Vec<(usize, DVec3)> = tips.into_iter().filter_map(of_cell).collect();
    tips.par_sort_by(|a, b| a.0.cmp(&b.0).then(a.1.z.total_cmp(&b.1.z)));
    let mut starts = vec![0; cells.count() + 1];
    tips.iter().for_each(|(c, _)| starts[c + 1] += 1);
    (0..cells.count()).for_each(|c| starts[c + 1] += starts[c]);
    let is_cut = |p: &DVec3| {
        let at = p.truncate();
        cells.within(at - reach, at + reach).any(|c| {
            let tips = &tips[starts[c]..starts[c + 1]];
            if tips.first().is_none_or(|(_, tip)| tip.z > p.z + slack) {
                return false;
            }
            // Lower surfaces never fall outward, and no tip is nearer than the nearest place of its cell, but for rounding.
            let [i, j] = [c % cells.n[0], c / cells.n[0]].map(|x| x as f64);
            let low = cells.origin + DVec2::new(i, j) * cells.side;
            let nearest = at.clamp(low, low + cells.side).distance(at) - SAME_HEIGHT_MM;
            let highest = highest(tool, *p, nearest, slack);
            let mut low = tips.iter().map(|(_, tip)| *tip).take_while(|tip| tip.z <= highest);
            low.any(|tip| cuts(tool, tip, *p, slack))
        })
    };
    voxels.into_par_iter().filter(|p| !is_cut(p)).collect()
}

/// Those of some points that the lowest tip over each cell does not cut: nearly all that others cut is cut by
/// these. All as (u, v, height); a point is cut that comes within `slack` of the edge.
fn hardly_cut(
    points: &[DVec3],
    tips: impl Iterator<Item = DVec3>,
    (l, tool, slack): (Lattice, &Tool, f64),
    ctx: &Ctx,
) -> Result<Vec<DVec3>, Cancelled> {
    let mut lowest: Vec<Option<DVec3>> = vec![None; l.cells()];
    let mut heights = Image::empty(l);
    for tip in tips {
        if let Some(i) = l.cell(tip.truncate()).map(|c| l.index(c))
            && -(tip.z as f32) > heights.data[i]
        {
            heights.data[i] = -(tip.z as f32);
            lowest[i] = Some(tip);
        }
    }
    // Tips and points may be farther from each other than the middles of their cells.
    let aside = |p: &DVec3| {
        let cell = l.cell(p.truncate());
        cell.map_or(0.0, |c| l.uv(c).distance(p.truncate()))
    };
    let farther = FRAC_1_SQRT_2 * l.s + points.iter().map(aside).fold(0.0, f64::max);
    let edge = |rho: f64| tool.active_lower_surface(rho);
    let edge = Profile::new(edge, tool.active_radius(), l.s, slack - farther, 0.0);
    let reached = edge.dilate(&heights, l, f64::NEG_INFINITY, ctx)?;
    let is_doubtful = |p: &DVec3| {
        let cell = l.cell(p.truncate());
        cell.is_none_or(|c| f64::from(-reached.data[l.index(c)]) > p.z + slack)
    };
    let doubtful: Vec<DVec3> = points.iter().copied().filter(is_doubtful).collect();
    let near = within((tool.active_radius() + slack).min(FAR_CELLS * l.s) + l.s, l.s);
    let is_cut = |p: &DVec3| {
        let Some(cell) = l.cell(p.truncate()) else { return false };
        near.iter().any(|(di, dj)| {
            let i = cell[0].checked_add_signed(*di as isize);
            let j = cell[1].checked_add_signed(*dj as isize);
            let (Some(i), Some(j)) = (i, j) else { return false };
            let inside = i < l.n[0] && j < l.n[1];
            let tip = if inside { lowest[l.index([i, j])] } else { None };
            tip.is_some_and(|tip| cuts(tool, tip, *p, slack))
        })
    };
    Ok(doubtful.into_par_iter().filter(|p| !is_cut(p)).collect())
}

impl Left {
    /// The share of so many voxels that is cut.
    fn share_of(&self, all: usize) -> f64 {
        1.0 - self.voxels.len() as f64 / all.max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::{Direction, rng};
    use crate::machine::{Machine, ToolKind};
    use crate::voxel::Frame;
    use rand::RngExt as _;

    /// A tapered end was let go in by half of its widest radius, which may be more than all of its tip.
    #[test]
    fn no_end_goes_in_deeper_than_half_its_tip() {
        let machine = Machine::builtin("generic-5axis").unwrap();
        let tools = machine.tools_of(ToolKind::Subtractive);
        for tool in &tools {
            let deepest = nicks(tool, 0.5, 0.75).map(|n| n.meshes).fold(0.0, f64::max);
            assert!(deepest <= tool.tip_radius() / 2.0 && deepest >= NICK_MM, "{}", tool.name);
        }
        let finest = tools.iter().find(|t| t.is_tapered() && t.tip_radius() < 0.4).unwrap();
        assert!(nicks(finest, 0.5, 0.75).all(|n| n.meshes <= 0.15));
    }

    /// Held equal to asking every tip about every voxel.
    #[test]
    fn what_no_tip_cuts_is_what_each_tip_by_itself_leaves() {
        let machine = Machine::builtin("generic-5axis").unwrap();
        let mut rng = rng(3, 0);
        let mut some = |n: usize, size: [f64; 3]| -> Vec<DVec3> {
            let mut at = |k: usize| rng.random_range(0.0..size[k]);
            (0..n).map(|_| DVec3::new(at(0), at(1), at(2))).collect()
        };
        let (mut cut, mut left) = (0, 0);
        for tool in machine.tools_of(ToolKind::Subtractive) {
            for n in [0, 1, 40, 400] {
                let voxels = some(300, [12.0, 9.0, 4.0]);
                let mut tips = some(n, [14.0, 8.0, 6.0]);
                // At the rim of the edge's reach too.
                tips.extend(
                    voxels.iter().take(n / 10).map(|p| p + DVec3::X * tool.active_radius()),
                );
                let asked = voxels.iter().copied();
                let uncut: Vec<DVec3> =
                    asked.filter(|p| !tips.iter().any(|t| cuts(tool, *t, *p, 0.13))).collect();
                left += uncut.len();
                cut += voxels.len() - uncut.len();
                assert_eq!(not_cut_from(tips.into_iter(), voxels, tool, 0.13), uncut);
            }
        }
        assert!(cut > 1000 && left > 1000, "{cut} {left}");
    }

    /// Along a tilted direction points lie beside the middles of their cells as tips do. Where only the tips' places were
    /// reckoned with, points a third of a cell beyond the edge's reach went for cut, and their step failed
    /// the program's check.
    #[test]
    fn no_point_goes_for_cut_that_no_tip_reaches() {
        let machine = Machine::builtin("generic-5axis").unwrap();
        let frame = Frame { pitch: 0.8, dims: [24, 24, 12], origin: DVec3::ZERO };
        let mut rng = rng(1, 0);
        let (mut told, mut missed) = (0, 0);
        for (i, tool) in machine.tools_of(ToolKind::Subtractive).into_iter().enumerate().take(8) {
            let d = [DVec3::Z, DVec3::new(0.52, 0.84, -0.13)][i % 2];
            let plane = Direction::new(d.normalize()).unwrap().image_plane();
            let s = if i % 2 == 0 { frame.pitch } else { frame.pitch / 2.0 };
            let seen = |v: [usize; 3]| {
                let p = frame.center(v);
                plane.across(p).extend(plane.height(p))
            };
            let all = (0..24 * 24 * 12).map(|k| [k % 24, k / 24 % 24, k / 576]);
            let points: Vec<DVec3> = all.map(seen).collect();
            let (lo, hi) = bounds(points.iter().map(|p| p.truncate()));
            let l = Lattice::over(&frame, plane, s, lo - DVec2::splat(1.0), hi);
            let slack = frame.pitch / 2.0;
            for _ in 0..20 {
                let mut coordinate =
                    |i: usize| rng.random_range(0.0..1.0) * 12.0 - [4.0, 4.0, 8.0][i];
                let at = (lo + hi) / 2.0;
                let tips: Vec<DVec3> = (0..3)
                    .map(|_| DVec3::new(at.x + coordinate(0), at.y + coordinate(1), coordinate(2)))
                    .collect();
                let terms = (l, tool, slack);
                let listed =
                    hardly_cut(&points, tips.iter().copied(), terms, &Ctx::quiet()).unwrap();
                let uncut = |p: &&DVec3| !tips.iter().any(|t| cuts(tool, *t, **p, slack));
                missed += points.iter().filter(uncut).filter(|p| !listed.contains(p)).count();
                told += points.len() - listed.len();
            }
        }
        assert_eq!(missed, 0, "of {told}");
        assert!(told > 1000, "{told}");
    }
}
