//! Rule `tool-access` for deposits: with its tip at a voxel of the region the nozzle meets neither
//! the input state, nor what holds the part, nor the region's own voxels that lie lower.
//!
//! The last need no test. A voxel o of the region lower than x has o_z ≤ x_z; every section's
//! lower surface is at least 0, the dip only adds to it, so o_z ≤ x_z + f(ρ): o never collides.
//! [`Tool::validate`] refuses the negative heights that would break this.

use super::profile::Profile;
use super::replay::Site;
use super::skyline::{Skyline, TipBounds};
use super::tally::Tally;
use super::thin::Thin;
use super::tiplattice::{TipLattice, span, tally_rows};
use super::{ROUNDING_MM, Rule, RuleResult};
use crate::base::{Cancelled, Ctx};
use crate::machine::Tool;
use crate::plan::Step;

pub(super) fn result(
    index: usize,
    step: &Step,
    tool: &Tool,
    dip_mm: f64,
    site: &Site,
    ctx: &Ctx,
) -> Result<RuleResult, Cancelled> {
    if !(dip_mm >= 0.0 && dip_mm.is_finite()) {
        return Ok(RuleResult {
            rule: Rule::ToolAccess,
            step: Some(index),
            passed: false,
            figure: dip_mm,
            figure_means: "mm nozzle dip",
            detail: "the nozzle dip must be 0 mm or more, and finite".into(),
        });
    }
    let tally = colliding(step, tool, dip_mm, site, ctx)?;
    Ok(tally.result(Rule::ToolAccess, index, "voxels not printable", site.frame, || {
        let d = step.direction.vec();
        format!("'{}' along ({:.3}, {:.3}, {:.3}) collides there", tool.name, d.x, d.y, d.z)
    }))
}

/// The voxels of the region at which the nozzle collides.
pub(super) fn colliding(
    step: &Step,
    tool: &Tool,
    dip_mm: f64,
    site: &Site,
    ctx: &Ctx,
) -> Result<Tally, Cancelled> {
    let Some(span) = span(&step.region, site) else { return Ok(Tally::default()) };
    let profile = Profile::new(tool.sections.iter().map(|s| {
        let reaches_tip = s.shape.lower_surface(0.0) == 0.0;
        (s, if reaches_tip { dip_mm } else { 0.0 })
    }));
    if let Some(thin) = Thin::of(&profile, site) {
        return thin.tally(step, site, ctx);
    }
    if site.direction.is_grid_axis() {
        // The centres of a column share one place of the tip lattice, and its height.
        let lattice = TipLattice::new(site, &profile, span, 0.0, 0.0);
        return tally_rows(step, ctx, |(): &mut (), v| {
            let p = site.frame.center(v);
            let tip = lattice.nearest(site.plane.across(p));
            Ok(!lattice.free(tip, site.plane.height(p)))
        });
    }
    let tips = TipBounds { min: span.min, max: span.max, floor: span.low };
    let skyline = Skyline::new(site, &profile, tips);
    tally_rows(step, ctx, |(): &mut (), v| {
        let p = site.frame.center(v);
        let z = site.plane.height(p) + ROUNDING_MM;
        Ok(skyline.lowest_free(&profile, site.plane.across(p), z, z) > z)
    })
}
