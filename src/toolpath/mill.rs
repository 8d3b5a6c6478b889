//! Roughing, finishing and rest cutting of one subtractive step.
//!
//! Method: over the tip lattice of the plan's rules, H(u, v) is the lowest height at which the whole
//! tool is free of the output state and the fixed points, `top` the height at which its edge first meets
//! the region, `floor` the lowest height worth going to. Roughing takes levels a step-down apart, contour
//! parallel, at z = max(level, H + stock, floor), one pocket down to its ground before the next, but none deeper under
//! what is still to cut beside it than the edge is long; finishing, of what lies above ever lower floors an edge's length apart, follows
//! max(H, floor) a scallop stepover apart; rest cutting (`rest`) goes once more where region is still uncovered. Into
//! material the tip goes by a ramp along the pass (see `ramp`). From one place to the next it goes through what is cut
//! where that is near, over what stands where that is sooner than over the safe height.
//!
//! H is told over cells within reach of the region alone (`wanted`); over others no tip goes but at the safe height.
//!
//! Guarantees: no tip on the lattice is below H of the exact obstacle points (moved to their cells), but for
//! those between its cells and those of a region's last voxels, which are free of the points where they are (see `between`
//! and `close_tip`);
//! no pass is deeper than a step-down under what was cut beside it; rapids only at the safe height
//! or straight up; over surfaces of the meshes heights are the meshes' (see `exact`), but for crevices
//! that only the voxels leave room for. Not guaranteed: a constant engagement.

mod linking;
mod pockets;
mod rest;

use super::columns::Columns;
use super::contour::{chains, nearest_order};
use super::exact::{Exact, Lowest, steepness};
use super::faces::{faces, rows};
use super::image::{Cell, Image, Lattice, Profile};
use super::moves::{Figures, Move, MoveKind};
use super::process::{CLEARANCE_MM, ENTRY_MM, Milling};
use super::ramp::{LEAST_MM, Stock, ramp};
use super::touch::Touch;
use super::wanted::Wanted;
use crate::base::{Cancelled, Ctx, DVec2, DVec3};
use crate::machine::Tool;
use crate::plan::{Job, Step};
use crate::voxel::{BitGrid, Frame};
use std::cell::OnceCell;
use std::sync::OnceLock;

/// Heights closer than this are the same, mm: far above the rounding of f32 heights, far below
/// what a machine resolves.
const SAME_HEIGHT_MM: f64 = 1e-3;

/// Cosine of the slope at which passes across and levels along the axis are equally far apart.
const DIAGONAL: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// Steps down are no finer than this share of a cell: a sharp tip's own, which would leave no ridge,
/// has no lower bound.
const LEAST_STEP_SHARE: f64 = 0.1;

/// How much lower than the lowest free tip a way from cell to cell may pass, mm: below
/// a wall's edge that is far exceeded, over a slope hardly ever, and less than half of what counts as a gouge.
const CORNER_MM: f64 = 0.02;

/// Positions of a touched-up way so near each other are one, mm: what one takes off beyond the other is
/// less than what a position is worth, and programs need not tell apart moves shorter than this.
const NO_MOVE_MM: f64 = 0.02;

/// Tips are looked for up to so many cells beside what they are to reach: a tapered edge 2 mm wide on
/// cells of 0.03 mm. Wider edges reach from nearer by, and a point that none reaches costs a look at
/// every cell.
pub(super) const FAR_CELLS: f64 = 64.0;

/// Tips are taken up to so many cells beside those over which an edge meets the region: a pass goes to a wall within
/// a cell, and what a cell leaves may be cut from as far as a voxel beside it.
const BESIDE_CELLS: f64 = 6.0;

/// What a step works on.
pub(super) struct Work<'a> {
    pub job: &'a Job,
    pub frame: &'a Frame,
    pub step: &'a Step,
    pub tool: &'a Tool,
    pub before: &'a BitGrid,
    pub after: &'a BitGrid,
    /// Pedestal and table.
    pub fixed: &'a [DVec3],
    /// What the steps before laid, whether it stands or not.
    pub laid: &'a BitGrid,
    /// Voxels at the surface of M* and at that of M.
    pub surfaces: &'a [BitGrid; 2],
    pub ctx: &'a Ctx,
}

pub(super) struct Milled {
    pub moves: Vec<Move>,
    pub safe_height: f64,
    pub figures: Figures,
}

/// # Errors
/// When the user stops the run.
pub(super) fn mill(work: &Work, process: &Milling) -> Result<Milled, Cancelled> {
    let mut stage = Stage::new(work, *process)?;
    stage.rough()?;
    stage.finish()?;
    let covered = stage.rest()?;
    stage.touch_up()?;
    let safe_height = stage.safe;
    let moves = stage.moves;
    let figures = Figures { coverage: covered, ..Figures::default() };
    Ok(Milled { moves, safe_height, figures })
}

/// Pitch of the tip lattice: the plan's rule.
fn tip_pitch(frame: &Frame, step: &Step) -> f64 {
    if step.direction.is_grid_axis() { frame.pitch } else { frame.pitch / 2.0 }
}

/// (u, v) box of the region's voxel centres.
fn region_box(work: &Work) -> (DVec2, DVec2) {
    let plane = work.step.direction.image_plane();
    let empty = (DVec2::INFINITY, DVec2::NEG_INFINITY);
    work.step.region.iter_ones().fold(empty, |(lo, hi), v| {
        let p = plane.across(work.frame.center(v));
        (lo.min(p), hi.max(p))
    })
}

/// Lowest free tip heights over a window of tips, for several margins, and the height over which
/// nothing of the state before the step stands. Where none are wanted they are +∞.
pub(super) struct Free {
    pub window: Lattice,
    /// Those of its cells over which there are tips.
    pub wanted: Wanted,
    obstacles: Image,
    /// The obstacles where they are, as (u, v, height).
    points: Vec<DVec3>,
    columns: OnceLock<Columns>,
    highest: f64,
    pub state_top: f64,
}

impl Free {
    /// Tips within `reach` mm of the region's box; obstacles of `state` and the fixed points.
    pub fn around(work: &Work, state: &BitGrid, reach: f64) -> Free {
        let plane = work.step.direction.image_plane();
        let s = tip_pitch(work.frame, work.step);
        let (lo, hi) = region_box(work);
        // A margin and a cell's half-diagonal may widen a tool by this much.
        let tool = DVec2::splat(work.tool.max_radius() + 2.0 * work.frame.pitch + 1.0);
        let tips = DVec2::splat(reach + 2.0 * s);
        let all = Lattice::over(work.frame, plane, s, lo - tips - tool, hi + tips + tool);
        let mut obstacles = Image::empty(all);
        let mut highest = f64::NEG_INFINITY;
        let shell = state.boundary();
        let points = shell.iter_ones().map(|v| work.frame.center(v));
        let mut seen = Vec::new();
        for p in points.chain(work.fixed.iter().copied()) {
            let p = plane.across(p).extend(plane.height(p));
            highest = highest.max(p.z);
            if obstacles.raise_at(p) {
                seen.push(p);
            }
        }
        let heights = work.before.boundary();
        let tops = heights.iter_ones().map(|v| plane.height(work.frame.center(v)));
        let state_top = tops.fold(f64::NEG_INFINITY, f64::max) + work.frame.pitch;
        let window = all.window(lo - tips, hi + tips);
        let (wanted, columns) = (Wanted::all(window), OnceLock::new());
        Free { window, wanted, obstacles, points: seen, columns, highest, state_top }
    }

    /// The same with tips only over what is within `reach` mm of the region's columns.
    pub fn beside(self, work: &Work, reach: f64) -> Free {
        let across = |v| self.window.plane.across(work.frame.center(v));
        let columns = work.step.region.iter_ones().map(across);
        Free { wanted: Wanted::around(self.window, columns, reach), ..self }
    }

    /// Height of the highest tip over the window, wanted or not, at which fixed points are as far off as the tool grown
    /// by `side` and `down` is: of each point over the nearest place of the window.
    fn highest_over(&self, work: &Work, side: f64, down: f64) -> f64 {
        let (l, plane) = (self.window, self.window.plane);
        let last = l.uv(l.n.map(|n| n.saturating_sub(1)));
        let over = |p: &DVec3| {
            let at = plane.across(*p);
            let apart = at.distance(at.clamp(l.origin, last));
            plane.height(*p) + down - work.tool.lower_surface((apart - side).max(0.0))
        };
        work.fixed.iter().map(over).fold(f64::NEG_INFINITY, f64::max)
    }

    /// H with the tool grown by `side` and `down`, mm.
    pub fn heights(
        &self,
        tool: &Tool,
        side: f64,
        down: f64,
        ctx: &Ctx,
    ) -> Result<Image, Cancelled> {
        let s = self.window.s;
        let profile = Profile::new(|rho| tool.lower_surface(rho), tool.max_radius(), s, side, down);
        self.dilated(&profile, ctx)
    }

    /// The obstacles dilated by any profile.
    pub fn dilated(&self, profile: &Profile, ctx: &Ctx) -> Result<Image, Cancelled> {
        profile.dilate_over(&self.obstacles, &self.wanted, self.highest, ctx)
    }

    /// Whether the edge of a tool at a tip holds no obstacle, each where it is; shank and holder are not looked at.
    pub fn is_clear(&self, tool: &Tool, tip: DVec3) -> bool {
        let most = tip.z + SAME_HEIGHT_MM;
        let lower = |rho: f64| tool.active_lower_surface(rho);
        self.columns().lift(tip.truncate(), tool.active_radius(), lower, [most, most]) <= most
    }

    /// Whether shank and holder of a tool at a tip hold no obstacle, each where it is; the edge is not looked at.
    pub fn clears_holder(&self, tool: &Tool, tip: DVec3) -> bool {
        let most = tip.z + SAME_HEIGHT_MM;
        let edge = tool.active_radius() + SAME_HEIGHT_MM;
        let lower = |rho: f64| tool.lower_surface(rho.max(edge));
        self.columns().lift(tip.truncate(), tool.max_radius(), lower, [most, most]) <= most
    }

    fn columns(&self) -> &Columns {
        self.columns.get_or_init(|| Columns::over(self.obstacles.lattice, &self.points))
    }

    /// An image as large as the obstacles', without any.
    pub fn empty(&self) -> Image {
        Image::empty(self.obstacles.lattice)
    }

    /// Height of the highest obstacle, mm.
    pub fn highest(&self) -> f64 {
        self.highest
    }
}

struct Stage<'a> {
    work: &'a Work<'a>,
    process: Milling,
    lattice: Lattice,
    free: Free,
    /// Tip height at which the edge first meets the region.
    top: Image,
    /// Lowest tip height worth going to.
    floor: Image,
    /// H for finishing: half a voxel off the voxel centres.
    fine: Lowest,
    /// H without margin.
    exact: Lowest,
    /// Heights over the meshes, where the job has them.
    meshes: Option<Exact>,
    /// The same where what goes later may be passed, and all that is not to go.
    past: [OnceCell<(Exact, Free)>; 2],
    /// What is still to cut.
    stock: Stock,
    /// Lowest tip height cut so far, per cell; +∞ where nothing was.
    done: Vec<f32>,
    safe: f64,
    at: Option<(Cell, f64)>,
    /// Whether passes go up to the walls beside their cells.
    to_walls: bool,
    /// How far from its cell the tip stands.
    aside: DVec2,
    /// The move that ended at the beginning of the chain that is cut, while the tip has not left it.
    chain: Option<usize>,
    moves: Vec<Move>,
}

impl<'a> Stage<'a> {
    fn new(work: &'a Work<'a>, process: Milling) -> Result<Self, Cancelled> {
        let h = work.frame.pitch;
        let radius = work.tool.active_radius();
        let free = Free::around(work, work.after, radius);
        let lattice = free.window;
        let free = free.beside(work, radius + BESIDE_CELLS * lattice.s);
        let edge =
            Profile::new(|rho| work.tool.active_lower_surface(rho), radius, lattice.s, 0.0, 0.0);
        let (mut tops, mut bottoms) = (Image::empty(lattice), Image::empty(lattice));
        let plane = lattice.plane;
        let meshes = Exact::of(work, &free)?;
        // A voxel's face lies up to half a pitch from the surface that the meshes tell exactly.
        let under = if meshes.is_some() { h } else { h / 2.0 };
        for v in work.step.region.iter_ones() {
            let p = work.frame.center(v);
            tops.raise(p);
            if let Some(c) = lattice.cell(plane.across(p)) {
                let i = lattice.index(c);
                bottoms.data[i] = bottoms.data[i].max(-(plane.height(p) - under) as f32);
            }
        }
        let disc = Profile::new(
            |rho| if rho <= radius { 0.0 } else { f64::INFINITY },
            radius,
            lattice.s,
            0.0,
            0.0,
        );
        let half = h / 2.0 + rounding(work, lattice.s);
        let heights = |side: f64, down: f64| match &meshes {
            Some(m) => m.heights(work, &free, side, down, 0.0),
            None => free.heights(work.tool, side, down, work.ctx).map(Lowest::of_voxels),
        };
        let (fine, exact) = (heights(half, h / 2.0)?, heights(0.0, 0.0)?);
        let safe = free.state_top.max(free.highest_over(work, half, h / 2.0)) + CLEARANCE_MM;
        let stock = Stock::new(&tops, &edge, h / 2.0);
        let over = |profile: &Profile, img: &Image| {
            profile.dilate(img, lattice, f64::NEG_INFINITY, work.ctx)
        };
        Ok(Stage {
            stock,
            top: over(&edge, &tops)?,
            floor: over(&disc, &bottoms)?.negated(),
            fine,
            exact,
            meshes,
            past: Default::default(),
            done: vec![f32::INFINITY; lattice.cells()],
            work,
            process,
            lattice,
            free,
            safe,
            at: None,
            to_walls: false,
            aside: DVec2::ZERO,
            chain: None,
            moves: Vec::new(),
        })
    }

    fn rough(&mut self) -> Result<(), Cancelled> {
        let stock = self.process.stock;
        let h = self.work.frame.pitch;
        let half = h / 2.0 + rounding(self.work, self.lattice.s);
        let (side, down) = (half + stock, h / 2.0 + stock);
        let coarse = self.free.heights(self.work.tool, side, down, self.work.ctx)?;
        let coarse = match &self.meshes {
            None => coarse,
            // The voxels' margin is the stock's to the side; over the meshes it is exact below.
            Some(m) => m.raised(self.work, &self.free, coarse, [side, down, stock])?,
        };
        let bottom = self.bottoms(&coarse);
        let near = vec![f32::INFINITY; bottom.len()];
        let ceiling = self.top.data.clone();
        self.levels(&bottom, &ceiling, &near)
    }

    /// max(H, floor) per cell; +∞ where the edge meets no region at any height.
    fn bottoms(&self, free: &Image) -> Vec<f32> {
        let pick = |((h, f), t): ((&f32, &f32), &f32)| {
            if t.is_finite() && f.is_finite() { h.max(*f) } else { f32::INFINITY }
        };
        free.data.iter().zip(&self.floor.data).zip(&self.top.data).map(pick).collect()
    }

    /// Finishes what lies above ever lower floors, an edge's length apart: where the tip goes below one, all that could
    /// meet shank or holder is gone, the stock that roughing left included.
    fn finish(&mut self) -> Result<(), Cancelled> {
        self.to_walls = true;
        let bottom = self.bottoms(&self.fine.tips);
        let finite = |heights: &[f32]| -> Vec<f32> {
            heights.iter().copied().filter(|z| z.is_finite()).collect()
        };
        let highest = finite(&self.top.data).into_iter().fold(f32::NEG_INFINITY, f32::max);
        let deepest = finite(&bottom).into_iter().fold(f32::INFINITY, f32::min);
        // Material reaches half a voxel over its middle. Of an edge of no length to speak of a floor per level.
        let length = self.work.tool.active_length() - self.work.frame.pitch / 2.0;
        let apart = length.max(self.process.step_down) as f32;
        let floors = ((highest - deepest) / apart).ceil().max(1.0) as usize;
        for k in 1..floors {
            self.finish_above(&bottom, highest - k as f32 * apart)?;
        }
        self.finish_above(&bottom, f32::NEG_INFINITY)?;
        self.to_walls = false;
        Ok(())
    }

    /// Finishes what is due of `bottom` down to a floor.
    fn finish_above(&mut self, bottom: &[f32], floor: f32) -> Result<(), Cancelled> {
        let near = self.near()?;
        let same = SAME_HEIGHT_MM as f32;
        let down_to: Vec<f32> = bottom.iter().map(|z| z.max(floor)).collect();
        let due: Vec<bool> = (0..bottom.len())
            .map(|i| down_to[i] < self.top.data[i].min(self.done[i]) - same)
            .collect();
        // Where roughing could not enter, finishing must not plunge either.
        let deep: Vec<f32> = (0..bottom.len())
            .map(|i| {
                let open = self.top.data[i].min(near[i]) - down_to[i];
                let rough = due[i] && open > self.process.step_down as f32;
                if rough { down_to[i] } else { f32::INFINITY }
            })
            .collect();
        let ceiling = self.top.data.clone();
        self.levels(&deep, &ceiling, &near)?;
        // Steep faces level by level, the others by passes as far apart: up to 45° either leaves
        // ridges no higher than the scallop.
        let ridge = self.process.finishing_stepover(self.work.tool) * DIAGONAL;
        let steep: Vec<f32> = steepness(&self.lattice, bottom)
            .iter()
            .enumerate()
            .map(|(i, s)| if due[i] && *s > 1.0 { down_to[i] } else { f32::INFINITY })
            .collect();
        let near = self.near()?;
        let rough = self.process.step_down;
        self.process.step_down = ridge.min(rough);
        self.levels(&steep, &ceiling, &near)?;
        self.process.step_down = rough;
        // What lies below the floor is flat down there.
        let mut flat: Vec<bool> = (0..due.len())
            .map(|i| due[i] && steep[i].is_infinite() && bottom[i] >= floor)
            .collect();
        let stepover = ridge / self.lattice.s;
        let z = |i: usize| bottom[i];
        let radius = self.work.tool.active_radius() / self.lattice.s;
        let least = (std::f64::consts::PI * radius * radius).ceil() as usize;
        for face in faces(&self.lattice, bottom, &flat, least) {
            self.face(&face, bottom)?;
            for i in face {
                flat[i] = false;
                self.done[i] = self.done[i].min(bottom[i]);
            }
        }
        self.passes(&flat, stepover, &z, self.process.feed)?;
        for i in (0..bottom.len()).filter(|i| flat[*i]) {
            self.done[i] = self.done[i].min(bottom[i]);
        }
        Ok(())
    }

    /// Rows over a flat face and once around its rim.
    fn face(&mut self, face: &[usize], bottom: &[f32]) -> Result<(), Cancelled> {
        let apart = self.process.finishing_stepover(self.work.tool) / self.lattice.s;
        let step = apart.floor().max(1.0) as usize;
        let z = |i: usize| bottom[i];
        let feed = self.process.feed;
        self.follow(rows(&self.lattice, face, step), apart, &z, feed)?;
        self.retract();
        let mut rim = vec![false; bottom.len()];
        face.iter().for_each(|i| rim[*i] = true);
        // The first ring of a set is its rim; a second one would be this many cells inside it.
        const NO_OTHER: f64 = 1e9;
        self.follow(chains(&self.lattice, &rim, NO_OTHER), apart, &z, feed)?;
        self.retract();
        Ok(())
    }

    /// Lowest height cut within a stock's width and two cells of each cell.
    fn near(&self) -> Result<Vec<f32>, Cancelled> {
        let s = self.lattice.s;
        let reach = ((self.process.stock / s).ceil() + 2.0) * s;
        let box_of = |rho: f64| if rho <= reach { 0.0 } else { f64::INFINITY };
        let done = Image { lattice: self.lattice, data: self.done.clone() };
        let disc = Profile::new(box_of, reach, s, 0.0, 0.0);
        let low = disc.dilate(&done.negated(), self.lattice, f64::NEG_INFINITY, self.work.ctx)?;
        Ok(low.data.iter().map(|z| if z.is_finite() { -z } else { f32::INFINITY }).collect())
    }

    /// The cuts so far, as (u, v, height).
    fn cuts_so_far(&self) -> Vec<[DVec3; 2]> {
        let plane = self.lattice.plane;
        let turned = |p: DVec3| plane.across(p).extend(plane.height(p));
        let cuts = self.moves.windows(2).filter(|w| w[1].kind == MoveKind::Cut);
        cuts.map(|w| [turned(w[0].tip), turned(w[1].tip)]).collect()
    }

    /// Goes to points of the target's surface that the passes left too far off. A tapered edge only takes what
    /// others left, and is slow: it is not made to finish the faces around that.
    fn touch_up(&mut self) -> Result<(), Cancelled> {
        let Some(exact) = self.meshes.as_ref().filter(|_| !self.work.tool.is_tapered()) else {
            return Ok(());
        };
        let cuts = self.cuts_so_far();
        let (work, lowest, stock) = (self.work, &self.fine, self.process.stock);
        let ways = Touch { work, exact, lowest, stock }.ways(cuts)?;
        for way in ways {
            self.touch_along(way, f64::NEG_INFINITY);
        }
        self.retract();
        Ok(())
    }

    /// Along a way and back in levels, from where material may still stand beside what was cut, or from
    /// `top` if that is higher.
    fn touch_along(&mut self, mut way: Vec<DVec3>, top: f64) {
        let top = way.iter().map(|t| self.stands_over(*t)).fold(top, f64::max);
        let deepest = way.iter().map(|t| t.z).fold(f64::INFINITY, f64::min);
        let step = self.process.step_down.max(LEAST_STEP_SHARE * self.lattice.s);
        let mut level = top;
        let (mut last, mut is_first): (Option<DVec3>, _) = (None, true);
        loop {
            level = (level - step).max(deepest);
            for (k, tip) in way.iter().enumerate() {
                let Some(cell) = self.lattice.cell(tip.truncate()) else { continue };
                let (aside, z) = (tip.truncate() - self.lattice.uv(cell), tip.z.max(level));
                let to = tip.truncate().extend(z);
                if last.is_some_and(|l| l.distance(to) < NO_MOVE_MM) {
                    continue;
                }
                last = Some(to);
                if is_first {
                    self.enter((cell, aside), (top + ENTRY_MM).max(z));
                    is_first = false;
                }
                let feed = if k == 0 { self.process.plunge_feed } else { self.process.feed };
                self.go(MoveKind::Cut, cell, aside, z, feed);
            }
            if level <= deepest {
                break;
            }
            way.reverse();
        }
        self.chain = None;
    }

    /// Height at which a tip over the cells around a place meets material.
    fn stands_over(&self, tip: DVec3) -> f64 {
        let over =
            self.cells_around(tip.truncate()).map(|c| self.stock.over(self.lattice.index(c)));
        f64::from(over.fold(f32::NEG_INFINITY, f32::max))
    }

    /// Contour-parallel passes over a set of cells.
    fn passes(
        &mut self,
        set: &[bool],
        stepover: f64,
        z: &dyn Fn(usize) -> f32,
        feed: f64,
    ) -> Result<(), Cancelled> {
        if !set.contains(&true) {
            return Ok(());
        }
        self.follow(chains(&self.lattice, set, stepover), stepover, z, feed)?;
        self.retract();
        Ok(())
    }

    fn follow(
        &mut self,
        lines: Vec<Vec<Cell>>,
        stepover: f64,
        z: &dyn Fn(usize) -> f32,
        feed: f64,
    ) -> Result<(), Cancelled> {
        let at = self.at.map(|(c, _)| c);
        for (i, chain) in nearest_order(lines, at).into_iter().enumerate() {
            self.work.ctx.check()?;
            let to = chain[0];
            let linked = self.link(to, stepover, z, i == 0)
                || (i == 0 && self.go_back(to, stepover) && self.link(to, stepover, z, true));
            if !linked {
                let way = ramp(&self.lattice, &chain, z, &|i| self.stock.over(i), self.safe);
                let end = f64::from(z(self.lattice.index(to)));
                self.enter((to, DVec2::ZERO), (way.from + ENTRY_MM).max(end));
            }
            self.sink(&chain, z, feed);
            self.chain = self.moves.len().checked_sub(1);
            for k in 1..chain.len() {
                self.cut_to(&chain[k..], z, feed);
            }
        }
        Ok(())
    }

    /// From above the first cell of a pass down to its height, by a ramp through material.
    fn sink(&mut self, pass: &[Cell], z: &dyn Fn(usize) -> f32, feed: f64) {
        let Some((_, high)) = self.at else { return };
        let end = f64::from(z(self.lattice.index(pass[0])));
        if high - end <= LEAST_MM {
            return self.land(pass[0], end, feed);
        }
        let down = ramp(&self.lattice, pass, z, &|i| self.stock.over(i), high);
        self.push(MoveKind::Cut, pass[0], down.from, self.process.plunge_feed);
        for (c, h) in down.way {
            self.push(MoveKind::Cut, c, h, feed);
        }
        self.push(MoveKind::Cut, pass[0], end, self.process.plunge_feed);
        self.land(pass[0], end, feed);
    }

    /// Cuts to the neighbouring cell at which the rest of a pass begins. On steep ground the tip first
    /// rises, then crosses, then falls: a slanted move would pass through the step that the lattice
    /// resolves only at its cells.
    fn cut_to(&mut self, rest: &[Cell], z: &dyn Fn(usize) -> f32, feed: f64) {
        let Some((from, z0)) = self.at else { return };
        let to = f64::from(z(self.lattice.index(rest[0])));
        if (to - z0).abs() > 2.0 * self.lattice.s {
            let over = to.max(z0);
            self.push(MoveKind::Cut, from, over, feed);
            self.push(MoveKind::Cut, rest[0], over, feed);
            self.sink(rest, z, feed);
        } else {
            self.land(rest[0], to, feed);
        }
    }

    /// Cuts to a cell at the height of its pass, or to the wall beside it.
    fn land(&mut self, cell: Cell, z: f64, feed: f64) {
        let (aside, z) = match &self.meshes {
            Some(m) if self.to_walls => m.aside(cell, z, &self.fine),
            _ => (DVec2::ZERO, z),
        };
        if self.cuts_a_corner(cell, aside, z)
            && let Some((from, high)) = self.at
        {
            let high = high.max(z);
            self.go(MoveKind::Cut, from, DVec2::ZERO, high, feed);
            self.go(MoveKind::Cut, cell, DVec2::ZERO, high, feed);
        }
        self.go(MoveKind::Cut, cell, aside, z, feed);
    }

    /// Whether the tip, on its straight way from one wall to another, would pass through the edge
    /// between them.
    fn cuts_a_corner(&self, to: Cell, aside: DVec2, z: f64) -> bool {
        let (Some(meshes), Some((from, z0))) = (&self.meshes, self.at) else { return false };
        if !self.to_walls || (aside == DVec2::ZERO && self.aside == DVec2::ZERO) {
            return false;
        }
        let (a, b) = (self.lattice.uv(from) + self.aside, self.lattice.uv(to) + aside);
        let mut on = None;
        [0.25, 0.5, 0.75].into_iter().any(|t| {
            let most = z0 + t * (z - z0) + CORNER_MM;
            !meshes.is_free(a.lerp(b, t), most, &self.fine, &mut on)
        })
    }

    /// To a cell's middle; straight up from where the tip stands aside of it.
    fn push(&mut self, kind: MoveKind, cell: Cell, z: f64, feed: f64) {
        let up = self.at.is_some_and(|(c, from)| c == cell && z >= from);
        let aside = if up { self.aside } else { DVec2::ZERO };
        self.go(kind, cell, aside, z, feed);
    }

    fn go(&mut self, kind: MoveKind, cell: Cell, aside: DVec2, z: f64, feed: f64) {
        if self.at == Some((cell, z)) && self.aside == aside {
            return;
        }
        if kind == MoveKind::Cut {
            self.stock.cut(cell, z);
        }
        let tip = self.lattice.plane.world(self.lattice.uv(cell) + aside, z);
        self.moves.push(Move { kind, tip, feed });
        (self.at, self.aside) = (Some((cell, z)), aside);
    }
}

/// Cells within a radius of one, the nearest first.
pub(super) fn within(radius: f64, s: f64) -> Vec<(i64, i64)> {
    let cells = radius / s + 1e-9;
    let n = cells.floor() as i64;
    let all = (-n..=n).flat_map(|j| (-n..=n).map(move |i| (i, j)));
    let is_within = |(i, j): &(i64, i64)| (*i as f64).hypot(*j as f64) <= cells;
    let mut offsets: Vec<(i64, i64)> = all.filter(is_within).collect();
    offsets.sort_by_key(|(i, j)| (i * i + j * j, *j, *i));
    offsets
}

/// How far a point may lie from the centre of its cell, mm: nothing along the grid axes.
fn rounding(work: &Work, s: f64) -> f64 {
    if work.step.direction.is_grid_axis() { 0.0 } else { s * std::f64::consts::FRAC_1_SQRT_2 }
}

#[cfg(test)]
mod tests {
    use super::super::Replay;
    use super::super::tests::{first_step, tilted};
    use super::*;
    use rand::RngExt;

    /// Along a tilted direction obstacles lie beside the middles of their cells. Where they were looked for in these, a
    /// cutter that hardly fits between the part and the table found no room and gouged the part.
    #[test]
    fn an_edge_is_clear_of_obstacles_where_they_are() {
        let w = tilted("generic-5axis");
        let replay = Replay::of(&w.job, &w.plan).unwrap();
        let surfaces = [(); 2].map(|()| BitGrid::new(w.job.frame.dims));
        let tool = w.job.cutters.iter().find(|t| t.name == "ball-3x30").unwrap();
        let ctx = Ctx::quiet();
        let work = first_step(&w, &replay, &surfaces, tool, &ctx);
        assert!(!work.step.direction.is_grid_axis());
        let free = Free::around(&work, work.after, 3.0);
        let (l, plane) = (free.window, free.window.plane);
        let shell = work.after.boundary();
        let centers = shell.iter_ones().map(|v| work.frame.center(v));
        let points: Vec<DVec3> = centers
            .chain(work.fixed.iter().copied())
            .map(|p| plane.across(p).extend(plane.height(p)))
            .collect();
        let moved = |p: &DVec3| match free.obstacles.lattice.cell(p.truncate()) {
            Some(c) => free.obstacles.lattice.uv(c).extend(p.z),
            None => *p,
        };
        let moved: Vec<DVec3> = points.iter().map(moved).collect();
        let clear = |points: &[DVec3], tip: DVec3| {
            let lower =
                |p: &DVec3| tool.active_lower_surface(p.truncate().distance(tip.truncate()));
            points.iter().all(|p| p.z - SAME_HEIGHT_MM - tip.z <= lower(p))
        };
        let mut rng = crate::base::rng(7, 0);
        let (mut count, mut otherwise) = ([0, 0], 0);
        let size = l.uv(l.n.map(|n| n - 1)) - l.origin;
        for _ in 0..3000 {
            let at = l.origin
                + size * DVec2::new(rng.random_range(0.0..1.0), rng.random_range(0.0..1.0));
            let near = points.iter().filter(|p| p.truncate().distance(at) < 0.5);
            let top = near.map(|p| p.z).fold(f64::NEG_INFINITY, f64::max);
            if top.is_finite() {
                let tip = at.extend(top + rng.random_range(-0.7..0.7));
                let want = clear(&points, tip);
                assert_eq!(free.is_clear(tool, tip), want, "{tip}");
                count[usize::from(want)] += 1;
                otherwise += usize::from(clear(&moved, tip) != want);
            }
        }
        assert!(count.iter().all(|n| *n > 200) && otherwise > 50, "{count:?} {otherwise}");
    }

    /// On fine grids a tapered edge takes off by its side what lies farther from its axis than the cells
    /// that a profile samples one by one; no tip was looked for there once.
    #[test]
    fn tips_are_looked_for_as_far_off_as_the_edge_is_wide() {
        let machine = crate::machine::Machine::builtin("generic-5axis").unwrap();
        let taper = machine.tools.iter().find(|t| t.is_tapered()).unwrap();
        let s = 0.1;
        let cells = within(taper.active_radius(), s);
        let edge = |rho: f64| taper.active_lower_surface(rho);
        let sampled = Profile::new(edge, taper.active_radius(), s, 0.0, 0.0).offsets();
        assert!(cells.len() > sampled.len(), "{} {}", cells.len(), sampled.len());
        assert!(sampled.iter().all(|(i, j, _)| cells.contains(&(*i, *j))));
        let far = cells.iter().map(|(i, j)| (*i as f64).hypot(*j as f64) * s).fold(0.0, f64::max);
        assert!(far <= taper.active_radius() + 1e-9 && far > taper.active_radius() - 2.0 * s);
        assert!(cells.is_sorted_by_key(|(i, j)| i * i + j * j));
        assert_eq!(cells[0], (0, 0));
    }
}
