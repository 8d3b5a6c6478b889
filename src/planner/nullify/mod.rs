//! INV: any stable voxel model, made exactly, by nullification.

mod bottleneck;
mod detour;
mod forest;
mod layer;
#[cfg(test)]
mod naive_tests;
mod operation;
mod workpiece;

pub use operation::{Deed, Operation, Orientation};

use super::PlanError;
use crate::base::Ctx;
use crate::voxel::BitGrid;
use layer::Nullifier;
use workpiece::Workpiece;

#[derive(Debug, PartialEq)]
pub enum NullifyError {
    Stuck { layer: i32, left: usize },
}

/// How to nullify.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// L: voxels of the cutter below its half-space, at least 2.
    pub length: u32,
    /// M: voxels that are deposited together where possible.
    pub minimum_feature: usize,
    /// Order of equal choices.
    pub seed: u64,
}

impl Default for Options {
    fn default() -> Options {
        Options { length: 10, minimum_feature: 10, seed: 0 }
    }
}

/// Operations that make `target` from nothing, in the order of fabrication.
pub fn operations(
    target: &BitGrid,
    options: &Options,
    ctx: &Ctx,
) -> Result<Vec<Operation>, PlanError> {
    let w = Workpiece::new(target, options.length);
    let top = w.top;
    let mut n = Nullifier::new(w, options.minimum_feature, options.seed);
    for z in (0..=top).rev() {
        ctx.check()?;
        if let Err(e) = n.strip(z) {
            return Err(NullifyError::Stuck { layer: e.layer, left: e.left }.into());
        }
    }
    let w = &n.w;
    Ok(n.deeds
        .iter()
        .rev()
        .map(|(cell, deed)| Operation { voxel: w.voxel(*cell).map(|c| c as u16), deed: *deed })
        .collect())
}
