//! From a part that is there already.
//!
//! The nozzle is a half-space: while layer k is deposited nothing may stand above it. So of the
//! material common to both parts, V_R, everything below some layer h must be whole, layer h may be
//! begun, and nothing is above it. The largest such V_R that the cutter can free from the initial
//! part, and from which the target can be finished without supports below h, is taken; with V_R
//! empty the part is taken off and the target made from nothing.
//!
//! The cut to V_R removes voxels one by one. In what is left every voxel keeps a neighbour of lower
//! rank, by a search from V_R and the base, so it stays stable. Where the cutter comes to nothing
//! that may go, ranks are taken anew; where that does not help either, each voxel that the cutter
//! reaches is asked exactly whether something hangs on it ([`super::hinges`]).
//!
//! Guarantees: with nothing kept the target itself can always be made, so a job fails only when its
//! initial part cannot be cut away, and then ends in a part of it that no cut leaves stable: all
//! that the cutter reaches holds something up. Such parts exist, and no deposit opens them, since
//! deposits go on top of everything: a rod that runs along all sides of its own box and ends deeper
//! in it than L, as the test `a_coil_deeper_than_the_cutter_is_locked` shows by trying every order
//! of cuts. Not guaranteed: that another order of cuts would not have got further.

use super::hinges::hinges;
use super::workpiece::{Cell, Workpiece};
use super::{Kept, NullifyError, Options, PlanError, Sequence, check, nullified, patches};
use crate::base::Ctx;
use crate::plan::{Deed, Job, Operation};
use crate::voxel::{BitGrid, Connectivity, flood};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// The box that planning needs of a job's grid: both parts, from the base plane up.
struct Region {
    corner: [usize; 3],
    dims: [usize; 3],
}

impl Region {
    fn of(job: &Job) -> Result<Region, NullifyError> {
        let Some((mut low, high)) = job.initial.or(&job.target).extent() else {
            return Err(NullifyError::Empty);
        };
        let base = (-job.frame.origin.z / job.frame.pitch).round().max(0.0) as usize;
        let voxels = job.target.iter_ones().take_while(|v| v[2] < base).count();
        if voxels > 0 {
            return Err(NullifyError::BelowBase { voxels });
        }
        low[2] = base;
        let dims = std::array::from_fn(|a| (high[a] + 1).saturating_sub(low[a]).max(1));
        Ok(Region { corner: low, dims })
    }

    fn cut(&self, grid: &BitGrid) -> BitGrid {
        let inside = |v: [usize; 3]| {
            let p = std::array::from_fn(|a| (v[a] + self.corner[a]) as i64);
            grid.get_or_empty(p)
        };
        BitGrid::from_fn(self.dims, inside)
    }
}

/// The sequence for a job from its initial part.
pub(super) fn sequence(job: &Job, options: &Options, ctx: &Ctx) -> Result<Sequence, PlanError> {
    let region = Region::of(job)?;
    let target = region.cut(&job.target);
    let initial = region.cut(&job.initial);
    let (operations, reused) = if initial.is_empty() {
        (super::operations(&target, options, ctx)?, 0)
    } else {
        from_initial(&initial, &target, options, ctx)?
    };
    let deposited = operations.iter().filter(|op| op.deed == Deed::Add).count();
    Ok(Sequence {
        corner: region.corner,
        dims: region.dims,
        supports: (deposited + reused).saturating_sub(target.count()),
        switches: patches::switches(&operations),
        operations,
        reused,
        tries: 1,
    })
}

/// Operations from `initial`, and how much of it they keep.
pub(super) fn from_initial(
    initial: &BitGrid,
    target: &BitGrid,
    options: &Options,
    ctx: &Ctx,
) -> Result<(Vec<Operation>, usize), PlanError> {
    check(target, options)?;
    let common = initial.and(target);
    let mut layer = Some(target.dims()[2]);
    while let Some(most) = layer {
        let (floor, kept) = largest_below(&common, target, most);
        if let Some(operations) =
            through(initial, target, &Kept { floor, solid: &kept }, options, ctx)?
        {
            return Ok((operations, kept.count()));
        }
        layer = floor.checked_sub(1);
    }
    let mut operations = freed(initial, &BitGrid::new(target.dims()), options, ctx)??;
    operations.extend(super::operations(target, options, ctx)?);
    Ok((operations, 0))
}

/// The cut to what is kept, then the way from there to the target; none when either fails.
fn through(
    initial: &BitGrid,
    target: &BitGrid,
    kept: &Kept,
    options: &Options,
    ctx: &Ctx,
) -> Result<Option<Vec<Operation>>, PlanError> {
    let Ok(mut operations) = freed(initial, kept.solid, options, ctx)? else { return Ok(None) };
    Ok(match nullified(target, Some(kept), options, ctx)? {
        Ok(built) => {
            operations.extend(built);
            Some(operations)
        }
        Err(_) => None,
    })
}

/// The largest stable part of `common` with nothing above layer h ≤ `layer` and all of the
/// target below it, with its h.
fn largest_below(common: &BitGrid, target: &BitGrid, layer: usize) -> (usize, BitGrid) {
    let mut h = layer;
    loop {
        let below = |g: &BitGrid| {
            let mut cut = g.clone();
            g.iter_ones().filter(|v| v[2] > h).for_each(|v| cut.set(v, false));
            cut
        };
        let mut base = common.clone();
        common.iter_ones().filter(|v| v[2] > 0).for_each(|v| base.set(v, false));
        let kept = flood(&below(common), &base, Connectivity::Edge18);
        let missing = target.minus(&kept);
        let first = missing.extent().map_or(h, |(low, _)| low[2]);
        if first >= h {
            return (h, kept);
        }
        h = first;
    }
}

/// Cuts that leave `kept` of `initial`; what is locked when they do not come to everything.
fn freed(
    initial: &BitGrid,
    kept: &BitGrid,
    options: &Options,
    ctx: &Ctx,
) -> Result<Result<Vec<Operation>, NullifyError>, PlanError> {
    let mut w = Workpiece::new(initial, options.length);
    let mut left: Vec<Cell> =
        initial.minus(kept).iter_ones().map(|v| w.cell(v.map(|c| c as i32))).collect();
    let mut operations = Vec::with_capacity(left.len());
    while !left.is_empty() {
        ctx.check()?;
        // What stands changes what hangs on what, so ranks are taken anew whenever none will do.
        let rank = ranks(&w, kept);
        left.sort_unstable_by_key(|c| (Reverse(rank[*c as usize]), *c));
        if let Some(first) = left.first().filter(|c| rank[**c as usize] == LOOSE) {
            let first = w.voxel(*first).map(|c| c as usize);
            let loose = left.iter().filter(|c| rank[**c as usize] == LOOSE).count();
            return Ok(Err(NullifyError::InitialUnstable { loose, first }));
        }
        let since = operations.len();
        loop {
            let before = left.len();
            left.retain(|&cell| !(spare(&w, &rank, cell) && cut(&mut w, cell, &mut operations)));
            if left.len() == before {
                break;
            }
        }
        if operations.len() > since {
            continue;
        }
        let hinge = hinges(&w, |c| keeps(&w, kept, c));
        let free = |c: &Cell| !hinge[*c as usize] && w.access(*c);
        let Some(at) = left.iter().position(free) else {
            let reached = left.iter().filter(|c| w.access(**c)).count();
            let left = left.len();
            return Ok(Err(NullifyError::Locked { left, reached, length: options.length }));
        };
        cut(&mut w, left.remove(at), &mut operations);
    }
    Ok(Ok(operations))
}

/// Cuts a voxel if the cutter reaches it; whether it did.
fn cut(w: &mut Workpiece, cell: Cell, operations: &mut Vec<Operation>) -> bool {
    let Some(way) = w.ways(cell).any() else { return false };
    w.remove(cell);
    operations.push(Operation { voxel: w.voxel(cell).map(|c| c as u16), deed: Deed::Cut(way) });
    true
}

fn keeps(w: &Workpiece, kept: &BitGrid, cell: Cell) -> bool {
    kept.get_or_empty(w.voxel(cell).map(i64::from))
}

/// Whether every neighbour of higher rank keeps another of lower rank than its own.
fn spare(w: &Workpiece, rank: &[u32], cell: Cell) -> bool {
    let r = |c: Cell| rank[c as usize];
    w.neighbours(cell)
        .into_iter()
        .filter(|n| w.solid(*n) && r(*n) > r(cell))
        .all(|n| w.neighbours(n).into_iter().any(|m| m != cell && w.solid(m) && r(m) < r(n)))
}

/// Rank of what does not hang together with the base or what is kept.
const LOOSE: u32 = u32::MAX;

/// In which order Dijkstra's search from `kept` and the base layer, both of rank 0, comes to the
/// solid cells: by the fewest cells on the way that the cutter reaches now, then by the fewest at
/// all. So what lies deep hangs, where it can, on what is deep too, and what is reached is free.
fn ranks(w: &Workpiece, kept: &BitGrid) -> Vec<u32> {
    let mut rank = vec![LOOSE; w.len()];
    let mut best = vec![(u32::MAX, u32::MAX); w.len()];
    let mut heap = BinaryHeap::new();
    for cell in (0..w.dims()[2]).flat_map(|z| w.layer(z)) {
        if w.height(cell) == 0 || keeps(w, kept, cell) {
            best[cell as usize] = (0, 0);
            heap.push(Reverse(((0, 0), cell)));
        }
    }
    let mut next = 0;
    while let Some(Reverse((cost, cell))) = heap.pop() {
        if rank[cell as usize] != LOOSE {
            continue;
        }
        if cost != (0, 0) {
            next += 1;
        }
        rank[cell as usize] = next;
        for n in w.neighbours(cell) {
            if w.solid(n) && rank[n as usize] == LOOSE {
                let reached = u32::from(w.access(n));
                let new = (cost.0 + reached, cost.1 + 1);
                if new < best[n as usize] {
                    best[n as usize] = new;
                    heap.push(Reverse((new, n)));
                }
            }
        }
    }
    rank
}
