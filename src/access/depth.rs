//! The depth engine.
//!
//! Symbols: s spacing of the tip lattice (h along grid axes, h/2 otherwise), c a lattice cell,
//! f(ρ) the tool's lower surface, k(ρ) that of its active part (mm over the tip).
//!
//! Every rounding is on the safe side. A point is stored in the cell nearest to it, at most
//! s/√2 away, so a tip at a cell's centre is at least |c − c′| − s/√2 from it; since f never
//! falls outward, f at that smaller radius is a lower bound. Along grid axes points and tips
//! coincide with cell centres and nothing is lost. Sections wider than [`WIDEST_CELLS`] cells are
//! treated on an image pooled by a power of two, where both the point and the tip may be
//! anywhere in their cell (a tip in the middle of any cell of the lattice in it).
//!
//! A map is made for the voxels of one set and answers for these alone: only the cells under them
//! are computed, so that a handful of voxels scattered over a part costs a handful of kernels.

use super::Scene;
use super::cells::Cells;
use super::filter::{Image, Kernel, Op, Spans, filter};
use super::image::{DepthImage, splat, spread};
use super::lattice::{DepthMap, Lattice, corners};
use super::tops::{NONE, axis_of, tops, voxel};
use crate::base::{Aabb, DVec3, Direction, ImagePlane};
use crate::machine::{Section, Shape, Tool};
use crate::voxel::{BitGrid, Frame};
use std::f64::consts::SQRT_2;

/// Largest radius of a section in cells of the image it is treated on. Larger is slower by its
/// square; smaller makes wide sections wider than they are (by at most √2/12 at this value).
const WIDEST_CELLS: f64 = 24.0;

/// Spacing of the tip lattice of a direction, mm.
fn spacing(frame: &Frame, direction: Direction) -> f64 {
    if direction.is_grid_axis() { frame.pitch } else { frame.pitch / 2.0 }
}

/// Distance by which rounding a point to its cell may move it, in cells: none on the grid axes,
/// half a diagonal elsewhere.
fn rounding_cells(direction: Direction) -> f64 {
    if direction.is_grid_axis() { 0.0 } else { std::f64::consts::FRAC_1_SQRT_2 }
}

/// Margin in mm below which a point stands surely lower than what a verdict looks at: far above
/// the rounding of f32 heights, far below a voxel.
const LOWER_MM: f64 = 0.01;

/// A direction's look at a scene, for the voxels of one set.
struct View<'a> {
    scene: &'a Scene,
    /// The voxels asked for; none for all of the grid.
    wanted: Option<&'a BitGrid>,
    plane: ImagePlane,
    /// Box of the wanted voxels.
    within: Aabb,
    spacing: f64,
    /// How far around them the window reaches, mm.
    margin: f64,
    /// Obstacle points that stand lower, mm, have no say: a voxel x is refused for o_z − f > x_z − k,
    /// f is nowhere negative, and no x is asked for below.
    least: f64,
    /// Depth images by pooling, each wide enough for every section treated on it.
    images: Vec<DepthImage>,
    /// Height of the highest obstacle point, mm, once they were looked at.
    highest: Option<f64>,
}

impl<'a> View<'a> {
    /// For the voxels of `wanted`; `deepest` is the largest k of the tools that look, mm.
    fn new(
        scene: &'a Scene,
        wanted: &'a BitGrid,
        direction: Direction,
        margin: f64,
        deepest: f64,
    ) -> Self {
        let half = DVec3::splat(scene.frame.pitch / 2.0);
        // Of an empty set nothing is asked; one voxel stands for it.
        let (lo, hi) = wanted.extent().unwrap_or_default();
        let within =
            Aabb { min: scene.frame.center(lo) - half, max: scene.frame.center(hi) + half };
        View { wanted: Some(wanted), ..View::of_box(scene, within, direction, margin, deepest) }
    }

    /// For all voxels of the grid.
    fn of_grid(scene: &'a Scene, direction: Direction, margin: f64, deepest: f64) -> Self {
        View::of_box(scene, scene.frame.bounds(), direction, margin, deepest)
    }

    fn of_box(
        scene: &'a Scene,
        within: Aabb,
        direction: Direction,
        margin: f64,
        deepest: f64,
    ) -> Self {
        let plane = direction.image_plane();
        let lowest = corners(&within).map(|c| plane.height(c)).into_iter().fold(f64::MAX, f64::min);
        View {
            scene,
            wanted: None,
            plane,
            within,
            spacing: spacing(&scene.frame, direction),
            margin,
            least: lowest - deepest - LOWER_MM,
            images: Vec::new(),
            highest: None,
        }
    }

    fn lattice(&self, margin: f64, pool: usize) -> Lattice {
        Lattice::around(&self.scene.frame, &self.within, &self.plane, self.spacing, margin, pool)
    }

    /// The cells under the wanted voxels.
    fn under(&self, lattice: &Lattice) -> Spans {
        let Some(wanted) = self.wanted else {
            return Spans::of_runs(lattice.under_box(&self.within, &self.plane));
        };
        let mut under = vec![false; lattice.nu * lattice.nv];
        let mut mark = |v: [usize; 3]| {
            if let Some(c) = lattice.cell(self.plane.across(self.scene.frame.center(v))) {
                under[c] = true;
            }
        };
        if let Some((axis, up)) = axis_of(self.plane.d) {
            // The voxels of a column share their cell.
            let width = wanted.dims()[usize::from(axis == 0)].max(1);
            let tops = tops(wanted, axis, up);
            for (i, _) in tops.iter().enumerate().filter(|(_, top)| **top != NONE) {
                mark(voxel(axis, [i % width, i / width], 0));
            }
        } else if wanted.count() > lattice.nu * lattice.nv {
            // To look up more voxels than there are cells takes longer than the cells in between.
            return Spans::of_runs(lattice.under_box(&self.within, &self.plane));
        } else {
            wanted.iter_ones().for_each(mark);
        }
        Spans::of(&under, lattice.nu)
    }

    /// The highest point per cell, mm, on the images by these poolings that are not there yet, and
    /// the highest of all, in one pass over the points.
    fn look(&mut self, pools: &[usize]) {
        let mut new: Vec<usize> = pools.to_vec();
        new.sort_unstable();
        new.dedup();
        new.retain(|pool| !self.images.iter().any(|(p, ..)| p == pool));
        if new.is_empty() && self.highest.is_some() {
            return;
        }
        if new.is_empty() {
            new.push(1);
        }
        let mut new: Vec<DepthImage> = new
            .into_iter()
            .map(|pool| {
                let wide = self.margin + (WIDEST_CELLS + 2.0) * pool as f64 * self.spacing;
                let lattice = self.lattice(wide, pool);
                (pool, lattice, Cells::filled(lattice.nu * lattice.nv, f32::NEG_INFINITY))
            })
            .collect();
        self.highest = Some(splat(self.scene, &self.plane, self.least, &mut new));
        self.images.append(&mut new);
    }

    /// The window in which tips may stand.
    fn window(&self) -> Lattice {
        self.lattice(self.margin, 1)
    }

    /// H at the `tips` of the window: max over obstacle points of o_z − f(ρ) − lift, section by
    /// section.
    fn lowest_tip(
        &mut self,
        tips: &Spans,
        sections: &[(Section, f64)],
        rounding_cells: f64,
    ) -> Cells {
        let seen: Vec<&(Section, f64)> = sections
            .iter()
            .enumerate()
            .filter(|(i, part)| !sections[..*i].iter().any(|before| shadows(before, part)))
            .map(|(_, part)| part)
            .collect();
        let spacing = self.spacing;
        let pool_of = |shape: &Shape| {
            let mut pool = 1;
            while shape.max_radius() / (spacing * pool as f64) > WIDEST_CELLS {
                pool *= 2;
            }
            pool
        };
        let round = |s: &Section| !matches!(s.shape, Shape::Platform { .. });
        let mut seen: Vec<(usize, &(Section, f64))> = seen
            .into_iter()
            .filter(|(s, _)| round(s))
            .map(|part| (pool_of(&part.0.shape), part))
            .collect();
        // The coarse images cost least, and where a wide section holds the tip up high the narrow
        // ones need no look.
        seen.sort_by_key(|(pool, _)| std::cmp::Reverse(*pool));
        let pools: Vec<usize> = seen.iter().map(|(pool, _)| *pool).collect();
        self.look(&pools);
        // Everything stands below a platform.
        let highest = self.highest.unwrap_or(f64::MIN);
        let floor = |(section, lift): &(Section, f64)| match section.shape {
            Shape::Platform { z } => (highest - z - lift) as f32,
            _ => f32::NEG_INFINITY,
        };
        let floor = sections.iter().map(floor).fold(f32::NEG_INFINITY, f32::max);
        let window = self.window();
        // A cell that is not computed is closed, whoever asks.
        let mut lowest = Cells::filled(window.nu * window.nv, f32::INFINITY);
        for (row, spans) in lowest.chunks_mut(window.nu).zip(tips.rows()) {
            spans.iter().for_each(|s| row[s.clone()].fill(floor));
        }
        for (pool, (section, lift)) in seen {
            let Some((_, lattice, image)) = self.images.iter().find(|(p, ..)| *p == pool) else {
                continue;
            };
            // A point and a tip are each up to (pool − 1) / 2 cells of the tip lattice along both
            // axes from the middle of the cell they are pooled into.
            let cells = (rounding_cells + (pool - 1) as f64 * SQRT_2) / pool as f64;
            let kernel = section_kernel(&section.shape, *lift, lattice.spacing, cells);
            let image = Image { width: lattice.nu, cells: image };
            if pool == 1 {
                let at = lattice.offset_of(&window);
                filter(Op::Max, &image, at, window.nu, &mut lowest, tips, &kernel);
            } else {
                let coarse = self.lattice(self.margin + self.spacing, pool);
                let mut pooled = Cells::filled(coarse.nu * coarse.nv, f32::NEG_INFINITY);
                let over = over_tips(&coarse, &window, tips);
                let at = lattice.offset_of(&coarse);
                filter(Op::Max, &image, at, coarse.nu, &mut pooled, &over, &kernel);
                spread(&coarse, &pooled, &window, tips, &mut lowest);
            }
        }
        lowest
    }
}

/// The cells of a coarser lattice in which any of the `tips` of a window lies.
fn over_tips(coarse: &Lattice, window: &Lattice, tips: &Spans) -> Spans {
    let [columns, rows] = coarse.pooled(window);
    let mut over = vec![false; coarse.nu * coarse.nv];
    for (row, spans) in rows.iter().zip(tips.rows()) {
        for s in spans.iter().filter(|s| !s.is_empty()) {
            over[coarse.nu * row..][columns[s.start]..=columns[s.end - 1]].fill(true);
        }
    }
    Spans::of(&over, coarse.nu)
}

/// Whether a section of a tool needs no look, since another, drawn on the same footing or a finer
/// one, is nowhere higher over it: the shank over the ball of the same radius.
fn shadows((before, lift): &(Section, f64), (section, section_lift): &(Section, f64)) -> bool {
    let rim = section.shape.max_radius();
    rim.is_finite()
        && before.shape.max_radius() <= rim
        && before.shape.lower_surface(rim) + lift <= lower_bound(&section.shape, 0.0) + section_lift
}

/// G of the depth engine: a voxel x of `wanted` can be cut along `direction` when x_z ≥ G at its
/// cell.
pub fn cutter_map(scene: &Scene, wanted: &BitGrid, tool: &Tool, direction: Direction) -> DepthMap {
    let cutter = Cutter::of(scene, tool, direction);
    let mut view = View::new(scene, wanted, direction, cutter.margin, cutter.deepest());
    let under = view.under(&view.window());
    cutter.map(&mut view, &under, direction)
}

/// [`cutter_map`] of several tools along one direction; the scene is looked at only once.
pub fn cutter_maps(
    scene: &Scene,
    wanted: &BitGrid,
    tools: &[Tool],
    direction: Direction,
) -> Vec<DepthMap> {
    let cutters: Vec<Cutter> = tools.iter().map(|t| Cutter::of(scene, t, direction)).collect();
    let most = |of: fn(&Cutter) -> f64| cutters.iter().map(of).fold(0.0, f64::max);
    let (margin, deepest) = (most(|c| c.margin), most(|c| c.deepest()));
    let mut view = View::new(scene, wanted, direction, margin, deepest);
    let under = view.under(&view.window());
    cutters.iter().map(|c| c.map(&mut view, &under, direction)).collect()
}

/// [`cutter_map`] for all voxels of the grid.
pub(super) fn cutter_map_of_grid(scene: &Scene, tool: &Tool, direction: Direction) -> DepthMap {
    let cutter = Cutter::of(scene, tool, direction);
    let mut view = View::of_grid(scene, direction, cutter.margin, cutter.deepest());
    let under = view.under(&view.window());
    cutter.map(&mut view, &under, direction)
}

/// [`nozzle_map`] for all voxels of the grid, nothing standing lower than allowed.
pub(super) fn nozzle_map_of_grid(scene: &Scene, tool: &Tool, direction: Direction) -> DepthMap {
    let view = View::of_grid(scene, direction, spacing(&scene.frame, direction), 0.0);
    nozzle_map_in(view, tool, direction, 0.0)
}

/// A cutter as one direction's lattice meets it.
struct Cutter<'a> {
    tool: &'a Tool,
    /// Cells that its active part spans.
    reach: usize,
    /// k over them.
    active: Kernel,
    /// How far around the voxels its tip may stand, mm.
    margin: f64,
}

impl<'a> Cutter<'a> {
    fn of(scene: &Scene, tool: &'a Tool, direction: Direction) -> Self {
        let s = spacing(&scene.frame, direction);
        let rounding = rounding_cells(direction);
        let reach = (tool.active_radius() / s).floor() as usize;
        // A face mill spans hundreds of cells; every n-th tip of them suffices, since missing a tip
        // only misses a position.
        let stride = (reach as f64 / WIDEST_CELLS).ceil().max(1.0) as usize;
        let active = Kernel::of(reach, stride, |cells| {
            let k = tool.active_lower_surface((cells + rounding) * s);
            k.is_finite().then_some(k as f32)
        });
        Cutter { tool, reach, active, margin: tool.active_radius() + s }
    }

    /// The largest k, mm.
    fn deepest(&self) -> f64 {
        f64::from(self.active.largest()).max(0.0)
    }

    fn map(&self, view: &mut View, under: &Spans, direction: Direction) -> DepthMap {
        let rounding = rounding_cells(direction);
        let lattice = view.window();
        let sections: Vec<(Section, f64)> =
            self.tool.sections.iter().map(|sec| (*sec, 0.0)).collect();
        let tips = under.grown(self.reach, lattice.nu);
        let free = view.lowest_tip(&tips, &sections, rounding);
        let free = Image { width: lattice.nu, cells: &free };
        let mut lowest = Cells::filled(lattice.nu * lattice.nv, f32::INFINITY);
        filter(Op::Min, &free, (0, 0), lattice.nu, &mut lowest, under, &self.active);
        DepthMap { plane: view.plane, lattice, lowest }
    }
}

/// H of a nozzle whose tip stands at the deposited voxel: x of `wanted` can be deposited when
/// x_z ≥ H at its cell. Sections that reach the tip may stand `dip_mm` lower than the obstacles
/// allow.
pub fn nozzle_map(
    scene: &Scene,
    wanted: &BitGrid,
    tool: &Tool,
    direction: Direction,
    dip_mm: f64,
) -> DepthMap {
    let view = View::new(scene, wanted, direction, spacing(&scene.frame, direction), 0.0);
    nozzle_map_in(view, tool, direction, dip_mm)
}

fn nozzle_map_in(mut view: View, tool: &Tool, direction: Direction, dip_mm: f64) -> DepthMap {
    // Here the tip too is anywhere in its cell.
    let rounding = 2.0 * rounding_cells(direction);
    let sections: Vec<(Section, f64)> = tool
        .sections
        .iter()
        .map(|sec| (*sec, if sec.shape.lower_surface(0.0) == 0.0 { dip_mm } else { 0.0 }))
        .collect();
    let lattice = view.window();
    let under = view.under(&lattice);
    let lowest = view.lowest_tip(&under, &sections, rounding);
    DepthMap { plane: view.plane, lattice, lowest }
}

/// −f(ρ) − lift of a section over cells, ρ shortened by `rounding` cells.
fn section_kernel(shape: &Shape, lift: f64, s: f64, rounding: f64) -> Kernel {
    let reach = (shape.max_radius() / s + rounding).ceil() as usize;
    Kernel::of(reach, 1, |cells| {
        let f = lower_bound(shape, ((cells - rounding) * s).max(0.0));
        f.is_finite().then_some(-(f + lift) as f32)
    })
}

/// inf of the lower surface over radii ≥ ρ: the surface itself unless the section narrows upward.
fn lower_bound(shape: &Shape, rho: f64) -> f64 {
    match *shape {
        Shape::Frustum { z0, r0, r1, .. } if r1 < r0 && rho <= r0 => z0,
        _ => shape.lower_surface(rho),
    }
}

#[cfg(test)]
#[path = "depth_tests.rs"]
mod tests;
