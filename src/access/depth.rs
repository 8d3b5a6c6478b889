//! The depth engine.
//!
//! Symbols: s spacing of the tip lattice (h along grid axes, h/2 otherwise), c a lattice cell,
//! f(ρ) the tool's lower surface, k(ρ) that of its active part (mm over the tip).
//!
//! Every rounding is on the safe side. A point is stored in the cell nearest to it, at most
//! s/√2 away, so a tip at a cell's centre is at least |c − c′| − s/√2 from it; since f never
//! falls outward, f at that smaller radius is a lower bound. Along grid axes points and tips
//! coincide with cell centres and nothing is lost. Sections wider than `WIDEST_CELLS` cells are
//! treated on an image pooled by a power of two, where both the point and the tip may be
//! anywhere in their cell (a tip in the middle of any cell of the lattice in it).
//!
//! A map is made for the voxels of one set and answers for these alone: only the cells under them
//! are computed, and of these only as many sections as it takes to refuse them (`ceilings`), so
//! that a handful of voxels scattered over a part costs a handful of kernels.

use super::Scene;
use super::cells::Cells;
use super::filter::{Image, Kernel, Op, filter};
use super::lattice::DepthMap;
use super::view::{Under, View, WIDEST_CELLS, rounding_cells, spacing};
use super::wanted::Wanted;
use crate::base::Direction;
use crate::machine::{Section, Tool};
use crate::voxel::BitGrid;

/// G of the depth engine: a voxel x of `wanted` can be cut along `direction` when x_z ≥ G at its
/// cell.
pub fn cutter_map(scene: &Scene, wanted: &BitGrid, tool: &Tool, direction: Direction) -> DepthMap {
    let cutter = Cutter::of(scene, tool, direction);
    let wanted = Wanted::of(wanted);
    let mut view = View::new(scene, &wanted, direction, cutter.margin, cutter.deepest());
    view.look_for(std::slice::from_ref(tool));
    let under = view.under(&view.window(), 0.0);
    cutter.map(&mut view, &under, direction)
}

/// [`cutter_map`] of several tools along one direction; the scene is looked at only once.
pub fn cutter_maps(
    scene: &Scene,
    wanted: &Wanted,
    tools: &[Tool],
    direction: Direction,
) -> Vec<DepthMap> {
    let cutters: Vec<Cutter> = tools.iter().map(|t| Cutter::of(scene, t, direction)).collect();
    let most = |of: fn(&Cutter) -> f64| cutters.iter().map(of).fold(0.0, f64::max);
    let (margin, deepest) = (most(|c| c.margin), most(|c| c.deepest()));
    let mut view = View::new(scene, wanted, direction, margin, deepest);
    view.look_for(tools);
    let under = view.under(&view.window(), 0.0);
    cutters.iter().map(|c| c.map(&mut view, &under, direction)).collect()
}

/// [`cutter_map`] for all voxels of the grid.
pub(super) fn cutter_map_of_grid(scene: &Scene, tool: &Tool, direction: Direction) -> DepthMap {
    let cutter = Cutter::of(scene, tool, direction);
    let mut view = View::of_grid(scene, direction, cutter.margin, cutter.deepest());
    let under = view.under(&view.window(), 0.0);
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

    fn map(&self, view: &mut View, under: &Under, direction: Direction) -> DepthMap {
        let rounding = rounding_cells(direction);
        let lattice = view.window();
        let sections: Vec<(Section, f64)> =
            self.tool.sections.iter().map(|sec| (*sec, 0.0)).collect();
        let tips = under.spans.grown(self.reach, lattice.nu);
        let ceilings = under.ceilings(self.reach);
        let free = view.lowest_tip(&tips, ceilings.as_ref(), &sections, rounding);
        let free = Image { width: lattice.nu, cells: &free };
        let mut lowest = Cells::filled(lattice.nu * lattice.nv, f32::INFINITY);
        filter(Op::Min, &free, (0, 0), lattice.nu, &mut lowest, &under.spans, &self.active);
        under.close(&mut lowest, lattice.nu);
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
    let wanted = Wanted::of(wanted);
    let view = View::new(scene, &wanted, direction, spacing(&scene.frame, direction), 0.0);
    nozzle_map_in(view, tool, direction, dip_mm)
}

/// A nozzle's sections, each with how much lower than the obstacles allow it may stand, mm: those that
/// reach the tip.
pub(super) fn dipped(tool: &Tool, dip_mm: f64) -> Vec<(Section, f64)> {
    let dip = |s: &Section| if s.shape.lower_surface(0.0) == 0.0 { dip_mm } else { 0.0 };
    tool.sections.iter().map(|s| (*s, dip(s))).collect()
}

fn nozzle_map_in(mut view: View, tool: &Tool, direction: Direction, dip_mm: f64) -> DepthMap {
    // Here the tip too is anywhere in its cell.
    let rounding = 2.0 * rounding_cells(direction);
    let sections = dipped(tool, dip_mm);
    let lattice = view.window();
    view.look_for(std::slice::from_ref(tool));
    let under = view.under(&lattice, tool.lower_surface(0.0) + dip_mm);
    let mut lowest = view.lowest_tip(&under.spans, under.ceilings(0).as_ref(), &sections, rounding);
    under.close(&mut lowest, lattice.nu);
    DepthMap { plane: view.plane, lattice, lowest }
}

#[cfg(test)]
#[path = "depth_tests.rs"]
mod tests;
