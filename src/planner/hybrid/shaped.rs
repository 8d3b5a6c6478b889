//! Cuts by tools of any shape, as sets of voxels (HB Alg. 6, 7 to the letter).
//!
//! The region engines of [`crate::access`] take any [`VoxelTool`], a mesh turned any way among
//! them; a direction is a turn of the tool, 24 of which are exact. Tips stand at voxel centres.
//!
//! Guarantees: [`over_cut_by`] solves Eq. 26 on voxels, [`under_cut_by`] Eq. 29 with the contacts of
//! Alg. 3. Not guaranteed: speed; each round is two or three Minkowski sums in space. The search
//! itself uses tools of revolution alone, since the rules of a plan know no others; a tool drawn as
//! a mesh takes part in it as what it sweeps about its axis ([`crate::machine::ToolFile`]).

use crate::access::{VoxelTool, accessible, choose, collateral};
use crate::base::{Cancelled, Ctx};
use crate::voxel::BitGrid;

/// P_o = P_i − A(P_o) from P_i ∩ P up: what of `state` − `target` the tool removes.
///
/// # Errors
/// [`Cancelled`] when the user has asked to stop.
pub fn over_cut_by(
    tool: &VoxelTool,
    state: &BitGrid,
    target: &BitGrid,
    ctx: &Ctx,
) -> Result<BitGrid, Cancelled> {
    let engine = choose(state.dims(), tool).engine;
    let mut region = state.minus(target);
    loop {
        ctx.check()?;
        let next = region.and(&accessible(engine, &state.minus(&region), tool));
        if next == region {
            return Ok(region);
        }
        region = next;
    }
}

/// P_o = P_o − C(P_o, P) from P_i ∩ P down: what an under-cut leaves; none when nothing would be.
///
/// # Errors
/// [`Cancelled`] when the user has asked to stop.
pub fn under_cut_by(
    tool: &VoxelTool,
    state: &BitGrid,
    target: &BitGrid,
    ctx: &Ctx,
) -> Result<Option<BitGrid>, Cancelled> {
    let engine = choose(state.dims(), tool).engine;
    let mut left = state.and(target);
    while !left.is_empty() {
        ctx.check()?;
        let hidden = state.minus(&left).minus(&accessible(engine, &left, tool));
        if hidden.is_empty() {
            return Ok(Some(left));
        }
        let hit = collateral(&left, &hidden, tool, ctx)?.region;
        if hit.is_empty() {
            // Nothing stands in the way and yet it is not reached: the tool's edge is inside its
            // body.
            return Ok(None);
        }
        left.subtract(&hit);
    }
    Ok(None)
}
