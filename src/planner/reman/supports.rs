//! Deposits on supports: what nothing would carry is printed on columns that a later cut takes away
//! again (HB Sec. 5: an over-fill, then an over-cut).
//!
//! Method. From above down along the direction, a voxel that nothing carries within the overhang
//! angle gets a carrier under it, and that carrier one of its own, down to the part or the base.
//! Those columns and what is free around them are then laid like any block, and from above down
//! again the straightest of the carriers that could be laid are kept: so a support leans past
//! places that the nozzle does not get at. All supports, and whatever else stands outside the
//! target, are cut when everything is printed.
//!
//! Not guaranteed: that a cutter gets at every support. What it leaves is residual, so a plan with
//! supports is taken only where it leaves less than the plan without.

use super::laying::{Block, Layer, Way, base_layer, joined_from_below};
use crate::access::CarrierTable;
use crate::base::DVec3;
use crate::voxel::{BitGrid, distance_within};
use rayon::prelude::*;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// How far aside, mm, a support looks for a way down past places that the nozzle does not get at:
/// as far as a nozzle is thick there. More takes longer, by the volume it looks at.
const LEAN_MM: f64 = 6.0;

/// Voxels by height along a direction, the highest first; of equals the first.
struct FromAbove<'l> {
    layer: &'l Layer<'l>,
    up: DVec3,
    heap: BinaryHeap<(u64, Reverse<[usize; 3]>)>,
}

impl<'l> FromAbove<'l> {
    fn new(layer: &'l Layer<'l>, way: Way) -> Self {
        FromAbove { layer, up: way.direction.vec(), heap: BinaryHeap::new() }
    }

    fn push(&mut self, v: [usize; 3]) {
        let height = self.up.dot(self.layer.job.frame.center(v));
        // The bits of a float in the order of its value.
        let bits = height.to_bits();
        let key = if bits >> 63 == 0 { bits | 1 << 63 } else { !bits };
        self.heap.push((key, Reverse(v)));
    }

    fn pop(&mut self) -> Option<[usize; 3]> {
        self.heap.pop().map(|(_, Reverse(v))| v)
    }
}

/// All that one way lays of what is left, and the supports that this needs, none of them where they
/// are to be avoided.
pub fn lay_on_supports<'a>(layer: &Layer, way: Way<'a>, avoided: &BitGrid) -> Block<'a> {
    let columns = columns(layer, way, avoided);
    if columns.is_empty() {
        return layer.lay(way);
    }
    let frame = &layer.job.frame;
    let aside = distance_within(&columns, LEAN_MM / frame.pitch);
    let base = base_layer(frame).unwrap_or(0);
    let free = over(&aside.minus(layer.state).minus(&layer.job.target).minus(avoided), base);
    let all = layer.left.or(&columns).or(&free);
    let laid = Layer { left: &all, ..*layer }.lay(way).region;
    let useful = useful(layer, way, &laid);
    Layer { left: &useful, ..*layer }.lay(way)
}

/// Whether a voxel is carried and joined to what carries it: a chain of two carries across a corner,
/// which joins nothing.
fn stands(table: &CarrierTable, solid: &BitGrid, v: [usize; 3], way: Way) -> bool {
    table.carries(solid, v) && joined_from_below(solid, v, way.direction)
}

/// What is to be added so that a voxel is carried: the straightest single voxel that may be, else
/// what a chain of two lacks; nothing where neither may be.
fn carriers(
    table: &CarrierTable,
    solid: &BitGrid,
    v: [usize; 3],
    may_be: impl Fn(&[usize; 3]) -> bool,
) -> Vec<[usize; 3]> {
    if let Some(one) = table.under(v, solid.dims()).find(&may_be) {
        return vec![one];
    }
    let stands = |u: &[usize; 3]| solid.get(*u) || may_be(u);
    let chain = table.chains_under(v, solid.dims()).find(|c| c.iter().all(stands));
    chain.into_iter().flatten().filter(|u| !solid.get(*u)).collect()
}

/// What of a set lies no lower than a layer.
fn over(set: &BitGrid, layer: usize) -> BitGrid {
    let mut kept = set.clone();
    kept.par_rows_mut().for_each(|(_, z, row)| {
        if z < layer {
            row.fill(0);
        }
    });
    kept
}

/// Carriers for everything that is left, were all of it laid.
fn columns(layer: &Layer, way: Way, avoided: &BitGrid) -> BitGrid {
    let job = layer.job;
    let table = CarrierTable::new(way.direction, job.rules.overhang_deg);
    let plate = base_layer(&job.frame);
    let on_plate = |v: [usize; 3]| way.on_base() && plate == Some(v[2]);
    let mut solid = layer.state.or(layer.left);
    let mut added = BitGrid::new(solid.dims());
    let mut queue = FromAbove::new(layer, way);
    layer.left.iter_ones().for_each(|v| queue.push(v));
    while let Some(v) = queue.pop() {
        if on_plate(v) || stands(&table, &solid, v, way) {
            continue;
        }
        let free = |v: &[usize; 3]| {
            plate.is_none_or(|p| v[2] >= p) && !job.target.get(*v) && !avoided.get(*v)
        };
        for below in carriers(&table, &solid, v, free) {
            solid.set(below, true);
            added.set(below, true);
            queue.push(below);
        }
    }
    added
}

/// What is laid of the part, and those of the laid supports that it hangs on.
fn useful(layer: &Layer, way: Way, laid: &BitGrid) -> BitGrid {
    let job = layer.job;
    let table = CarrierTable::new(way.direction, job.rules.overhang_deg);
    let plate = if way.on_base() { base_layer(&job.frame) } else { None };
    let mut kept = laid.and(layer.left);
    let mut solid = layer.state.or(&kept);
    let mut queue = FromAbove::new(layer, way);
    kept.iter_ones().for_each(|v| queue.push(v));
    while let Some(v) = queue.pop() {
        if plate == Some(v[2]) || stands(&table, &solid, v, way) {
            continue;
        }
        let is_laid = |v: &[usize; 3]| laid.get(*v);
        for below in carriers(&table, &solid, v, is_laid) {
            solid.set(below, true);
            kept.set(below, true);
            queue.push(below);
        }
    }
    kept
}
