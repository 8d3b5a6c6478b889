//! Deposits on supports: what nothing would carry is printed on columns that a later cut takes away
//! again (HB Sec. 5: an over-fill, then an over-cut).
//!
//! Method. From above down along the direction, a voxel that nothing carries within the overhang
//! angle gets a carrier under it, and that carrier one of its own, down to the part or the base;
//! carriers lean toward a lattice of trunks, so that columns grow together. Those columns and what
//! is free around them are then laid like any block, and from above down again the carriers that
//! could be laid are kept: so a support leans past places that the nozzle does not get at. Trunks
//! are made as wide as a bead. All supports, and whatever else stands outside the
//! target, are cut when everything is printed.
//!
//! Not guaranteed: that a cutter gets at every support. What it leaves is residual, so a plan with
//! supports is taken only where it leaves less than the plan without.

use super::laying::{Block, Layer, Way, base_layer, joined_from_below};
use super::printing::OnSupports;
use crate::access::CarrierTable;
use crate::base::DVec3;
use crate::voxel::{BitGrid, distance_within};
use rayon::prelude::*;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// How far aside, mm, a support looks for a way down past places that the nozzle does not get at:
/// as far as a nozzle is thick there. More takes longer, by the volume it looks at.
const LEAN_MM: f64 = 6.0;

/// Distance between the trunks into which supports grow together, mm: wide enough apart for a cutter
/// to take them one by one, near enough to carry what lies between.
const TRUNK_MM: f64 = 2.0;

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
/// are to be avoided, and as wide as a bead but where they are to be slim.
pub fn lay_on_supports<'a>(layer: &Layer, way: Way<'a>, on: &OnSupports) -> Block<'a> {
    let columns = columns(layer, way, on);
    if columns.is_empty() {
        return layer.lay(way);
    }
    let frame = &layer.job.frame;
    let aside = distance_within(&columns, LEAN_MM / frame.pitch);
    let base = base_layer(frame).unwrap_or(0);
    let free = over(&aside.minus(layer.state).minus(&layer.job.target).minus(on.avoided), base);
    let all = layer.left.or(&columns).or(&free);
    let laid = Layer { left: &all, ..*layer }.lay(way).region;
    let useful = useful(layer, way, on, &laid);
    // A column thinner than a bead has no path.
    let supports = useful.minus(layer.left);
    let wide = distance_within(&supports, way.tool.process.path_mm / frame.pitch);
    let wide = wide.and(&laid).minus(on.slim);
    Layer { left: &useful.or(&wide), ..*layer }.lay(way)
}

/// Whether a voxel is carried and joined to what carries it: a chain of two carries across a corner,
/// which joins nothing.
fn stands(table: &CarrierTable, solid: &BitGrid, v: [usize; 3], way: Way) -> bool {
    table.carries(solid, v) && joined_from_below(solid, v, way.direction)
}

/// Where supports grow together: a lattice across their direction.
struct Trunks<'o> {
    spacing: usize,
    across: [usize; 2],
    /// Where they go straight down instead.
    slim: &'o BitGrid,
}

impl<'o> Trunks<'o> {
    fn new(layer: &Layer, way: Way, slim: &'o BitGrid) -> Trunks<'o> {
        let up = way.direction.vec().abs();
        let along = (0..3).fold(0, |best, a| if up[a] > up[best] { a } else { best });
        let spacing = (TRUNK_MM / layer.job.frame.pitch).round().max(1.0) as usize;
        Trunks { spacing, across: [(along + 1) % 3, (along + 2) % 3], slim }
    }

    /// How far a voxel is from the next trunk, voxels squared.
    fn apart(&self, v: [usize; 3]) -> usize {
        if self.slim.get(v) {
            return 0;
        }
        let off = |a: usize| {
            let past = v[a] % self.spacing;
            past.min(self.spacing - past)
        };
        self.across.iter().map(|a| off(*a) * off(*a)).sum()
    }
}

/// What is to be added so that a voxel is carried: of the single voxels that may be the one nearest
/// a trunk, of equals the straightest, else what a chain of two lacks; nothing where neither may be.
fn carriers(
    table: &CarrierTable,
    solid: &BitGrid,
    v: [usize; 3],
    trunks: &Trunks,
    may_be: impl Fn(&[usize; 3]) -> bool,
) -> Vec<[usize; 3]> {
    let single = table.under(v, solid.dims()).filter(&may_be);
    if let Some(one) = single.min_by_key(|u| trunks.apart(*u)) {
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
fn columns(layer: &Layer, way: Way, on: &OnSupports) -> BitGrid {
    let job = layer.job;
    let table = CarrierTable::new(way.direction, job.rules.overhang_deg);
    let trunks = Trunks::new(layer, way, on.slim);
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
            plate.is_none_or(|p| v[2] >= p) && !job.target.get(*v) && !on.avoided.get(*v)
        };
        for below in carriers(&table, &solid, v, &trunks, free) {
            solid.set(below, true);
            added.set(below, true);
            queue.push(below);
        }
    }
    added
}

/// What is laid of the part, and those of the laid supports that it hangs on.
fn useful(layer: &Layer, way: Way, on: &OnSupports, laid: &BitGrid) -> BitGrid {
    let job = layer.job;
    let table = CarrierTable::new(way.direction, job.rules.overhang_deg);
    let trunks = Trunks::new(layer, way, on.slim);
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
        for below in carriers(&table, &solid, v, &trunks, is_laid) {
            solid.set(below, true);
            kept.set(below, true);
            queue.push(below);
        }
    }
    kept
}
