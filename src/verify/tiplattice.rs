//! The tip lattice of a step and the lowest free height of each tip, computed once when asked for.

use super::profile::Profile;
use super::replay::Site;
use super::skyline::{Skyline, TipBounds};
use super::{ROUNDING_MM, skyline::ones_of_row};
use crate::base::{Cancelled, Ctx, DVec2};
use crate::plan::Step;
use crate::voxel::BitGrid;
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};

use super::tally::Tally;

/// A place of the lattice, counted from the centre of voxel (0, 0, 0).
pub(super) type Tip = [i64; 2];

pub(super) struct TipLattice<'a> {
    skyline: Skyline,
    tool: &'a Profile,
    origin: DVec2,
    pub spacing: f64,
    floor: f64,
    ceiling: f64,
    first: Tip,
    size: [usize; 2],
    /// Bits of H, or [`UNKNOWN`]. H is a pure function of its tip, so it does not matter which
    /// thread writes it, or that two do.
    known: Vec<AtomicU64>,
}

/// A NaN that no computation here yields.
const UNKNOWN: u64 = u64::MAX;

/// Most remembered tips (64 MiB); beyond them heights are computed anew each time.
const MOST_REMEMBERED: u128 = 1 << 23;

/// Heights and (u, v) box of a region.
#[derive(Clone, Copy, Debug)]
pub(super) struct Span {
    pub min: DVec2,
    pub max: DVec2,
    pub low: f64,
    pub high: f64,
}

/// None for an empty region.
pub(super) fn span(region: &BitGrid, site: &Site) -> Option<Span> {
    let mut span: Option<Span> = None;
    for (y, z, x, n) in region.runs() {
        // Coordinates are linear along a run: its ends bound it.
        for x in [x, x + n - 1] {
            let p = site.frame.center([x, y, z]);
            let (at, h) = (site.plane.across(p), site.plane.height(p));
            let s = span.unwrap_or(Span { min: at, max: at, low: h, high: h });
            span = Some(Span {
                min: s.min.min(at),
                max: s.max.max(at),
                low: s.low.min(h),
                high: s.high.max(h),
            });
        }
    }
    span
}

impl<'a> TipLattice<'a> {
    /// For tips within `reach` mm of a region's span. Heights below `depth` mm under the region
    /// are all the same to the caller, as are heights above it.
    pub fn new(site: &Site, tool: &'a Profile, span: Span, reach: f64, depth: f64) -> Self {
        let spacing = if site.direction.is_grid_axis() { 1.0 } else { 0.5 } * site.frame.pitch;
        let origin = site.plane.across(site.frame.center([0, 0, 0]));
        let floor = span.low - depth - 1.0;
        let margin = DVec2::splat(reach + spacing);
        let (min, max) = (span.min - margin, span.max + margin);
        let skyline = Skyline::new(site, tool, TipBounds { min, max, floor });
        let index = |p: DVec2| {
            let c = (p - origin) / spacing;
            [c.x.floor() as i64, c.y.floor() as i64]
        };
        let (first, last) = (index(min), index(max));
        let mut size = [0, 1].map(|a| last[a].abs_diff(first[a]) as usize + 2);
        if size[0] as u128 * size[1] as u128 > MOST_REMEMBERED {
            size = [0, 0];
        }
        let known = (0..size[0] * size[1]).map(|_| AtomicU64::new(UNKNOWN)).collect();
        let ceiling = span.high + 1.0;
        TipLattice { skyline, tool, origin, spacing, floor, ceiling, first, size, known }
    }

    pub fn nearest(&self, at: DVec2) -> Tip {
        let c = (at - self.origin) / self.spacing;
        [c.x.round() as i64, c.y.round() as i64]
    }

    pub fn at(&self, tip: Tip) -> DVec2 {
        self.origin + DVec2::new(tip[0] as f64, tip[1] as f64) * self.spacing
    }

    /// H(t): exact between the lattice's floor and ceiling, on the right side of them otherwise.
    pub fn lowest_free(&self, tip: Tip) -> f64 {
        let compute =
            || self.skyline.lowest_free(self.tool, self.at(tip), self.floor, self.ceiling);
        let [i, j] = [0, 1].map(|a| tip[a].checked_sub(self.first[a]).unwrap_or(-1));
        let inside = i >= 0
            && j >= 0
            && (i as u64) < self.size[0] as u64
            && (j as u64) < self.size[1] as u64;
        if !inside {
            return compute();
        }
        let slot = &self.known[i as usize + self.size[0] * j as usize];
        match slot.load(Ordering::Relaxed) {
            UNKNOWN => {
                let h = compute();
                slot.store(h.to_bits(), Ordering::Relaxed);
                h
            }
            bits => f64::from_bits(bits),
        }
    }

    /// Whether a tip may stand at a height.
    pub fn free(&self, tip: Tip, z: f64) -> bool {
        z >= self.lowest_free(tip) - ROUNDING_MM
    }
}

/// Tallies the voxels of a step's region that fail a test, rows in parallel, in voxel order. Each
/// row starts with a fresh `State`, so that what it remembers depends on the row alone.
pub(super) fn tally_rows<State: Default>(
    step: &Step,
    ctx: &Ctx,
    fails: impl Fn(&mut State, [usize; 3]) -> Result<bool, Cancelled> + Sync,
) -> Result<Tally, Cancelled> {
    let ny = step.region.dims()[1];
    let tallies: Vec<Tally> = step
        .region
        .stored_rows()
        .into_par_iter()
        .with_min_len(8)
        .map(|r| {
            let (y, z) = (r % ny, r / ny);
            let (mut state, mut tally) = (State::default(), Tally::default());
            let row = step.region.row(y, z);
            if row.iter().any(|w| *w != 0) {
                ctx.check()?;
            }
            for x in ones_of_row(row) {
                if fails(&mut state, [x, y, z])? {
                    tally.add([x, y, z]);
                }
            }
            Ok(tally)
        })
        .collect::<Result<_, Cancelled>>()?;
    Ok(Tally::joined(tallies))
}
