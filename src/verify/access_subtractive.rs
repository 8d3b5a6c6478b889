//! Rule `tool-access` for cuts: every voxel of the region is touched by the cutting edge from some
//! tip of the lattice at which the tool meets neither the output state nor what holds the part.

use super::profile::Profile;
use super::replay::Site;
use super::tally::Tally;
use super::thin::Thin;
use super::tiplattice::{Tip, TipLattice, span, tally_rows};
use super::{ROUNDING_MM, Rule, RuleResult};
use crate::base::{Cancelled, Ctx, DVec2};
use crate::machine::Tool;
use crate::plan::Step;

pub(super) fn result(
    index: usize,
    step: &Step,
    tool: &Tool,
    site: &Site,
    ctx: &Ctx,
) -> Result<RuleResult, Cancelled> {
    let tally = unreachable(step, tool, site, ctx)?;
    Ok(tally.result(Rule::ToolAccess, index, "voxels not reachable", site.frame, || {
        let d = step.direction.vec();
        let why = if tool.active_radius().is_finite() {
            "no tip position of the cutter touches them without collision"
        } else {
            "the cutting edge has no end, so its reach cannot be judged"
        };
        format!("'{}' along ({:.3}, {:.3}, {:.3}): {why}", tool.name, d.x, d.y, d.z)
    }))
}

/// The voxels of the region that the tool cannot cut.
pub(super) fn unreachable(
    step: &Step,
    tool: &Tool,
    site: &Site,
    ctx: &Ctx,
) -> Result<Tally, Cancelled> {
    let Some(span) = span(&step.region, site) else { return Ok(Tally::default()) };
    let reach = tool.active_radius() + ROUNDING_MM;
    if !reach.is_finite() {
        return Ok(Tally { count: step.region.count(), first: step.region.iter_ones().next() });
    }
    let profile = Profile::new(tool.sections.iter().map(|s| (s, 0.0)));
    let edge = Profile::new(tool.sections.iter().filter(|s| s.active).map(|s| (s, 0.0)));
    // An edge that ends short of the next tip reaches a voxel from its own column alone, and one
    // with k(0) = 0 with its tip at the voxel's centre.
    let single = reach < site.frame.pitch - ROUNDING_MM && edge.at(0.0) == 0.0;
    if let Some(thin) = Thin::of(&profile, site).filter(|_| single) {
        return thin.tally(step, site, ctx);
    }
    // k(ρ) is at most the active length wherever it is finite: no tip lies lower than that.
    let lattice = TipLattice::new(site, &profile, span, reach, tool.active_length());
    let search = Search { lattice, edge, reach, ctx };
    tally_rows(step, ctx, |last: &mut Option<Found>, v| {
        let p = site.frame.center(v);
        let x = Target { at: site.plane.across(p), z: site.plane.height(p) };
        Ok(!search.reaches(x, last)?)
    })
}

struct Search<'a> {
    lattice: TipLattice<'a>,
    edge: Profile,
    reach: f64,
    ctx: &'a Ctx,
}

#[derive(Clone, Copy)]
struct Target {
    at: DVec2,
    z: f64,
}

/// Where the voxel before was cut from: its tip, and that tip as an offset from the voxel.
#[derive(Clone, Copy)]
struct Found {
    tip: Tip,
    offset: Tip,
}

impl Search<'_> {
    /// Tries what served the voxel before, then all tips in rings around the voxel. The order
    /// decides how soon a tip is found, never whether one is.
    fn reaches(&self, x: Target, last: &mut Option<Found>) -> Result<bool, Cancelled> {
        let near = self.lattice.nearest(x.at);
        if let Some(found) = last {
            let shifted = [near[0] + found.offset[0], near[1] + found.offset[1]];
            for tip in [found.tip, shifted] {
                if self.cuts(x, tip) {
                    found.tip = tip;
                    return Ok(true);
                }
            }
        }
        // The voxel lies within half a spacing of its nearest tip along u and along v, so a tip of
        // ring r is at least (r − ½) spacings away.
        let rings = (self.reach / self.lattice.spacing + 0.5 + ROUNDING_MM).floor() as i64;
        for r in 0..=rings {
            if r % 64 == 63 {
                self.ctx.check()?;
            }
            for offset in ring(r) {
                let tip = [near[0] + offset[0], near[1] + offset[1]];
                if self.cuts(x, tip) {
                    *last = Some(Found { tip, offset });
                    return Ok(true);
                }
            }
        }
        Ok(false)
    }

    /// Whether the edge touches x with the tip at this place, at a height free of collision.
    ///
    /// The highest tip at which K touches x stands at x_z − k(ρ); a tool that goes up without end
    /// meets the more the lower it stands, so no other height need be tried.
    fn cuts(&self, x: Target, tip: Tip) -> bool {
        let rho = x.at.distance(self.lattice.at(tip));
        if rho > self.reach {
            return false;
        }
        let k = self.edge.at((rho - ROUNDING_MM).max(0.0));
        k.is_finite() && self.lattice.free(tip, x.z - k)
    }
}

/// The offsets at Chebyshev distance r, those nearest the middle of a side among them.
fn ring(r: i64) -> impl Iterator<Item = Tip> {
    let side = move |s: i64| [[s, -r], [r, s], [-s, r], [-r, -s]];
    // r = 0 has one offset; otherwise s from −r up to r − 1 visits each of the 8 r once.
    let sides = (-r..r.max(-r + 1)).flat_map(side);
    sides.take(if r == 0 { 1 } else { usize::MAX })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn rings_cover_the_square_once() {
        for n in 0..6i64 {
            let all: Vec<Tip> = (0..=n).flat_map(ring).collect();
            let unique: BTreeSet<Tip> = all.iter().copied().collect();
            assert_eq!(all.len(), ((2 * n + 1) * (2 * n + 1)) as usize);
            assert_eq!(unique.len(), all.len());
            assert!(unique.iter().all(|t| t[0].abs().max(t[1].abs()) <= n));
        }
    }
}
