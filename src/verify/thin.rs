//! Access of tools that are narrower than a voxel but for a half-space, along a grid axis.
//!
//! Of such a tool f(ρ) is f(0) over its own column of voxel centres and one height over all others.
//! So with the tip at a voxel's centre it meets something exactly when its own column has a voxel
//! more than f(0) higher, or the highest voxel of all is more than that height above: the rule of
//! `docs/RULES.md` read off the column and the part's extent, without any skyline.

use super::ROUNDING_MM;
use super::profile::Profile;
use super::replay::Site;
use super::tally::Tally;
use crate::base::{Cancelled, Ctx};
use crate::plan::Step;

/// f at the axis and at every other voxel's centre, mm.
#[derive(Clone, Copy, Debug)]
pub(super) struct Thin {
    own: f64,
    others: f64,
}

impl Thin {
    /// None when the tool or the site asks for more.
    pub fn of(profile: &Profile, site: &Site) -> Option<Thin> {
        let narrow = profile.is_flat_from(site.frame.pitch - 2.0 * ROUNDING_MM);
        (narrow && site.direction.is_grid_axis() && site.fixed.is_empty()).then(|| Thin {
            own: profile.over_obstacle(0.0),
            others: profile.over_obstacle(site.frame.pitch),
        })
    }

    /// The voxels of a step's region at which the tool, its tip at their centres, meets the site's
    /// solid.
    pub fn tally(&self, step: &Step, site: &Site, ctx: &Ctx) -> Result<Tally, Cancelled> {
        ctx.check()?;
        let d = site.direction.vec();
        let axis = (0..3).find(|a| d[*a].abs() > 0.5).unwrap_or(2);
        let up = d[axis] > 0.0;
        let mut tally = Tally::default();
        let Some((first, last)) = site.bounds[axis] else { return Ok(tally) };
        let height = |v: [usize; 3]| site.plane.height(site.frame.center(v));
        for v in step.region.iter_ones() {
            let tip = height(v) + ROUNDING_MM;
            let mut far = v;
            far[axis] = if up { last } else { first };
            let mut meets = height(far) - self.others > tip;
            // What is not above the tip meets nothing: f is at least 0.
            let mut at = v;
            while !meets && at[axis] != far[axis] && (at[axis] < far[axis]) == up {
                at[axis] = if up { at[axis] + 1 } else { at[axis] - 1 };
                meets = site.solid.get(at) && height(at) - self.own > tip;
            }
            if meets {
                tally.add(v);
            }
        }
        Ok(tally)
    }
}
