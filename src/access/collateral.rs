//! Collateral: the least of a part that must go so that a tool reaches what it cannot (HB Sec. 3.3,
//! Alg. 3).
//!
//! | symbol | here |
//! |---|---|
//! | P | the part, of which as little as possible is hit |
//! | I | what the tool cannot reach |
//! | K, ∂K | the edge, and those of its offsets with a neighbour outside the tool |
//! | F(t) | μ(P ∩ (T + t)), the measure of a collision |
//!
//! For every x of I the contact k of ∂K with the least F(x − k) is taken, of equals the first in
//! order of height, y, x; the collateral is what the tool hits of P from all the tips x − k.
//!
//! Differs from the paper: the measure of contact k at x is that of the tool at the tip x − k
//! whatever k, so one correlation F serves all contacts instead of one each, and one dilation of
//! the chosen tips replaces one each.

use super::VoxelTool;
use crate::base::{Cancelled, Ctx};
use crate::morph::{Element, Engine, Window, choose, dilate, overlaps};
use crate::voxel::BitGrid;
use rayon::prelude::*;

/// What reaching the inaccessible costs.
pub struct Collateral {
    /// C ⊆ P.
    pub region: BitGrid,
    /// The largest collision of a chosen contact, voxels.
    pub worst: u32,
}

/// C(O, P, T, K) for the voxels `inaccessible` of the part's grid; the tool's offsets are finite in
/// effect, since only those matter that link two voxels of the grid.
///
/// # Errors
/// [`Cancelled`] when the user has asked to stop.
pub fn collateral(
    part: &BitGrid,
    inaccessible: &BitGrid,
    tool: &VoxelTool,
    ctx: &Ctx,
) -> Result<Collateral, Cancelled> {
    let Some(axis) = tool.axis() else { return upright(part, inaccessible, tool, ctx, None) };
    let found = upright(&axis.up(part), &axis.up(inaccessible), tool, ctx, None)?;
    Ok(Collateral { region: axis.down(&found.region), ..found })
}

/// [`collateral`] by one engine, of a tool whose +z is the grid's.
pub(super) fn upright(
    part: &BitGrid,
    inaccessible: &BitGrid,
    tool: &VoxelTool,
    ctx: &Ctx,
    engine: Option<Engine>,
) -> Result<Collateral, Cancelled> {
    let contacts = contacts(tool);
    let edge = Element::from_offsets(&contacts);
    let grid = Window::of(part.dims());
    let nothing = Collateral { region: BitGrid::new(part.dims()), worst: 0 };
    let (Some(reach), Some((lo, hi))) = (edge.bounds(), inaccessible.extent()) else {
        return Ok(nothing);
    };
    ctx.check()?;
    let asked = Window { lo: lo.map(|c| c as i64), hi: hi.map(|c| c as i64 + 1) };
    let tips = asked.minus(&reach);
    let measure = overlaps(engine.unwrap_or(Engine::Fft), part, tool.body(), &tips);
    ctx.check()?;
    let (chosen, worst) = choose_tips(&measure, &tips, inaccessible, &contacts);
    ctx.check()?;
    // The tips' grid starts at tips.lo; the part's window in its coordinates:
    let window = Window {
        lo: std::array::from_fn(|a| grid.lo[a] - tips.lo[a]),
        hi: std::array::from_fn(|a| grid.hi[a] - tips.lo[a]),
    };
    let engine = engine.unwrap_or_else(|| choose(tips.dims(), tool.body(), &window).engine);
    let mut region = dilate(engine, &chosen, tool.body(), &window);
    region.intersect_with(part);
    Ok(Collateral { region, worst })
}

/// ∂K: offsets of the edge with a face neighbour outside the tool, by z, y, x. An edge that is
/// wholly inside its own body has no boundary; then all of it counts.
fn contacts(tool: &VoxelTool) -> Vec<[i64; 3]> {
    let all: Vec<[i64; 3]> = tool
        .edge()
        .chords()
        .flat_map(|(z, c)| (c.x..c.x + c.len).map(move |x| [x, c.y, z]))
        .collect();
    let near =
        tool.edge().bounds().map(|b| Window { lo: b.lo.map(|c| c - 1), hi: b.hi.map(|c| c + 1) });
    let body = near.map_or_else(Element::default, |n| tool.body().clipped(&n));
    let solid = near.map(|n| (n, dilated_point(&body, &n)));
    let inside = |o: [i64; 3]| {
        solid.as_ref().is_some_and(|(n, g)| g.get_or_empty(std::array::from_fn(|a| o[a] - n.lo[a])))
    };
    let exposed: Vec<[i64; 3]> = all
        .iter()
        .copied()
        .filter(|o| {
            (0..6).any(|i| {
                let mut q = *o;
                q[i / 2] += if i % 2 == 0 { 1 } else { -1 };
                !inside(q)
            })
        })
        .collect();
    if exposed.is_empty() { all } else { exposed }
}

/// An element as a grid over a window.
fn dilated_point(element: &Element, window: &Window) -> BitGrid {
    let mut point = BitGrid::new([1, 1, 1]);
    point.set([0, 0, 0], true);
    dilate(Engine::Bits, &point, element, window)
}

/// The best tip of every inaccessible voxel, as a set over the window of tips, and the largest of
/// their measures.
fn choose_tips(
    measure: &[u32],
    tips: &Window,
    inaccessible: &BitGrid,
    contacts: &[[i64; 3]],
) -> (BitGrid, u32) {
    let [nx, ny, _] = tips.dims();
    // Indices are linear, so the tip x − k lies a fixed step from x, which itself may lie outside
    // the window.
    let linear = |o: [i64; 3]| (o[0] + nx as i64 * (o[1] + ny as i64 * o[2])) as isize;
    let origin = linear(tips.lo);
    let steps: Vec<isize> = contacts.iter().map(|k| -linear(*k)).collect();
    let nz = inaccessible.dims()[2];
    let best: Vec<(Vec<usize>, u32)> = (0..nz)
        .into_par_iter()
        .map(|z| {
            let (mut found, mut worst) = (Vec::new(), 0);
            for y in 0..inaccessible.dims()[1] {
                for (w, bits) in inaccessible.row(y, z).iter().enumerate() {
                    let mut rest = *bits;
                    while rest != 0 {
                        let x = w * 64 + rest.trailing_zeros() as usize;
                        rest &= rest - 1;
                        let at = linear([x as i64, y as i64, z as i64]) - origin;
                        let mut least = (u32::MAX, 0);
                        for step in &steps {
                            let tip = (at + step) as usize;
                            if measure[tip] < least.0 {
                                least = (measure[tip], tip);
                            }
                        }
                        worst = worst.max(least.0);
                        found.push(least.1);
                    }
                }
            }
            found.sort_unstable();
            found.dedup();
            (found, worst)
        })
        .collect();
    let mut chosen = BitGrid::new(tips.dims());
    for i in best.iter().flat_map(|(found, _)| found) {
        chosen.set([i % nx, i / nx % ny, i / nx / ny], true);
    }
    (chosen, best.iter().map(|(_, worst)| *worst).max().unwrap_or(0))
}
