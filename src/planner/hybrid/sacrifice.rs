//! A lower bound of a plan's cost beyond Eq. 39: what must be sacrificed. It holds for plans of
//! cuts that the depth engine calls reached, as all of this planner are.
//!
//! Let O = P₀ ∩ P be what the start has of the target and X what of P₀ − P no cutter reaches along
//! any direction while O stands, without the skin of O (what is reused in the end is part of O, and
//! its skin part of O's). A voxel x is removed at some step by a tool at a position free of
//! that step's output. Tools go up without end and never narrow, so the tool holds all that lies
//! straight above x along its direction, and all n_d(x) voxels of O there have been removed by then;
//! at least one of O has, or x were reached while O stands. Each of them is paid for: c_SM when it
//! went, and c_AM when it is added again or, missing at the end, is charged. The estimate of Eq. 39
//! charges P₀ − P and P − P₀ alone, so this comes on top of it. A goal may leave at most ⌊δ |P|⌋
//! voxels off, hence of X at least |X| − ⌊δ |P|⌋ are removed, and with m(x) the least
//! max(n_d(x), 1) over all directions, at least as many voxels are sacrificed as the
//! (|X| − ⌊δ |P|⌋)-th smallest m(x) says.

use super::cutting::reached;
use super::world::Shop;
use crate::voxel::{BitGrid, distance_within};

/// Voxels that any plan from `solid` to a goal removes from the target, at least; `off` is what a
/// goal may be off by.
pub fn least_sacrifice(shop: &Shop, solid: &BitGrid, off: usize) -> usize {
    let target = &shop.job.target;
    let kept = solid.and(target);
    let tolerance = shop.job.rules.tolerance_mm / shop.job.frame.pitch;
    let mut hidden = solid.minus(target).minus(&distance_within(&kept, tolerance));
    for view in shop.views() {
        let site = view.site(shop.job, solid);
        for tool in &shop.job.cutters {
            if hidden.count() <= off {
                return 0;
            }
            let standing = site.state.and(&view.target);
            let found = reached(&site, &standing, &view.up(&hidden), tool);
            hidden.subtract(&view.down(&found));
        }
    }
    if hidden.count() <= off {
        return 0;
    }
    let mut least: Vec<usize> = hidden.iter_ones().map(|v| least_above(shop, &kept, v)).collect();
    let at = least.len() - off - 1;
    *least.select_nth_unstable(at).1
}

/// m(x).
fn least_above(shop: &Shop, kept: &BitGrid, voxel: [usize; 3]) -> usize {
    let above = |step: [i64; 3]| {
        let mut p = voxel.map(|c| c as i64);
        let mut sum = 0;
        loop {
            (0..3).for_each(|a| p[a] += step[a]);
            if (0..3).any(|a| p[a] < 0 || p[a] >= kept.dims()[a] as i64) {
                return sum;
            }
            sum += usize::from(kept.get_or_empty(p));
        }
    };
    let along = shop.views().iter().map(|v| above(v.direction.vec().to_array().map(|c| c as i64)));
    along.min().unwrap_or(0).max(1)
}
