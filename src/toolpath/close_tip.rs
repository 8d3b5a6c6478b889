//! Tips by exact distances, for the last voxels of a small region.
//!
//! Method: of the tips of the plan's lattice around a point, the nearest one is taken that is free of all that
//! stays and whose edge meets the point, both where they are; if none does, one whose edge comes near it. Height
//! maps move both to the middles of their cells: a tip within reach of a point may be out of reach of its cell, off
//! the grid's axes. What a plan cuts by exact distances ([`crate::access::Close`]) is found here again.
//!
//! Guarantees: a tip is free of every point that stays, with shank and holder, and so is the way straight down to it
//! and up. Not guaranteed: a tip for an edge that is wider than `FAR_CELLS`. What stays is looked at for each
//! tip: for a few points.

use super::image::Lattice;
use super::mill::{FAR_CELLS, Work, within};
use crate::base::{DVec2, DVec3};

/// Heights must differ by this much for a verdict, mm: the rounding of coordinates of metres.
const ROUNDING_MM: f64 = 1e-7;

/// What stays, as (u, v, height), the highest first.
pub(super) struct Stays<'a> {
    work: &'a Work<'a>,
    lattice: Lattice,
    points: Vec<DVec3>,
}

impl<'a> Stays<'a> {
    pub fn of(work: &'a Work<'a>, lattice: Lattice) -> Self {
        let plane = lattice.plane;
        let shell = work.after.boundary();
        let centers = shell.iter_ones().map(|v| work.frame.center(v));
        let all = centers.chain(work.fixed.iter().copied());
        let mut points: Vec<DVec3> = all.map(|p| plane.across(p).extend(plane.height(p))).collect();
        points.sort_by(|a, b| b.z.total_cmp(&a.z));
        Stays { work, lattice, points }
    }

    /// The nearest tip whose edge meets a point (u, v, height), or else comes within `slack` of it.
    pub fn tip(&self, p: DVec3, slack: f64) -> Option<DVec3> {
        self.nearest(p, 0.0).or_else(|| self.nearest(p, slack))
    }

    /// The nearest tip whose edge comes within `slack` of a point.
    fn nearest(&self, p: DVec3, slack: f64) -> Option<DVec3> {
        let (l, tool) = (self.lattice, self.work.tool);
        let from = l.cell(p.truncate())?;
        // The point may lie nearer to a tip than the middle of its cell does.
        let reach = (tool.active_radius() + slack).min(FAR_CELLS * l.s) + l.s;
        within(reach, l.s).into_iter().find_map(|(i, j)| {
            let i = from[0].checked_add_signed(i as isize)?;
            let j = from[1].checked_add_signed(j as isize)?;
            let at = (i < l.n[0] && j < l.n[1]).then(|| l.uv([i, j]))?;
            let rho = (at.distance(p.truncate()) - slack).max(0.0);
            let most = p.z + slack - tool.active_lower_surface(rho);
            // Deeper than it must where it may, for the rounding of what is made of it.
            let lowest = self.lowest(at, [most - slack, most])?;
            Some(at.extend(lowest))
        })
    }

    /// The lowest height over `floor` at which a tip is free, if it is no higher than `most`.
    fn lowest(&self, at: DVec2, [floor, most]: [f64; 2]) -> Option<f64> {
        let mut lowest = floor;
        for p in self.points.iter() {
            // No tool is lower than its tip.
            if p.z <= lowest {
                break;
            }
            lowest = lowest.max(p.z - self.work.tool.lower_surface(p.truncate().distance(at)));
            if lowest > most + ROUNDING_MM {
                return None;
            }
        }
        most.is_finite().then_some(lowest)
    }
}
