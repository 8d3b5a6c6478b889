//! Why material was left standing or missing, in words for the person who reads the plan.

use super::coarse::Coarse;
use super::setting::Setting;
use crate::access::{Scene, Wanted, cutter_maps, reachable};
use crate::base::{Cancelled, Ctx, Direction, fibonacci_sphere};
use crate::machine::HoldingMode;
use crate::voxel::BitGrid;
use rayon::prelude::*;

/// Shares below this of what is left are not worth a line of their own.
const WORTH_SAYING: f64 = 0.01;

/// Directions tried from below, over the half sphere.
const FROM_BELOW: usize = 40;

/// One line a reason; none where nothing is left. `below` is the part of the excess that is open
/// only below.
pub fn reasons(
    setting: &Setting,
    excess: &BitGrid,
    below: &BitGrid,
    deficit: &BitGrid,
) -> Vec<String> {
    let job = setting.job;
    let voxel = job.frame.pitch.powi(3);
    let tolerance = format!("{:.2}", job.rules.tolerance_mm);
    let turned = match job.rules.holding {
        HoldingMode::Base => "--holding refixture, ",
        HoldingMode::Refixture => "",
    };
    let mut lines = Vec::new();
    let mut standing = excess.count();
    let below = below.count();
    if below > 0 && below as f64 >= WORTH_SAYING * standing as f64 {
        lines.push(format!(
            "{:.1} mm³ left standing lies in pockets that are open only below: no direction of \
             this holding reaches it; --holding refixture turns the part over and does",
            below as f64 * voxel
        ));
        standing -= below;
    }
    if standing as f64 >= WORTH_SAYING * excess.count() as f64 && standing > 0 {
        lines.push(format!(
            "{:.1} mm³ left standing is out of every cutter's reach: corners sharper than the \
             cutters are round, or deeper than they are long; a slimmer or a longer one (--sm-tool) or \
             a --tolerance above {tolerance} mm may leave less",
            standing as f64 * voxel
        ));
    }
    if !deficit.is_empty() {
        lines.push(format!(
            "{:.1} mm³ is missing: when its turn comes, no nozzle gets at it or nothing carries it; \
             {turned}a slimmer nozzle (--am-tool) or a --tolerance above {tolerance} mm may leave less",
            deficit.count() as f64 * voxel
        ));
    }
    lines
}

/// Voxels of the excess that cutters would reach from below were the part held in mid-air: none
/// where steps may hold it anew, since then they have been reached or not. `kept` is what stands
/// at the end.
pub fn open_below(
    setting: &Setting,
    coarse: &Coarse,
    kept: &BitGrid,
    excess: &BitGrid,
    ctx: &Ctx,
) -> Result<BitGrid, Cancelled> {
    let frame = &coarse.job.frame;
    if excess.is_empty() || setting.job.rules.holding == HoldingMode::Refixture {
        return Ok(BitGrid::new(excess.dims()));
    }
    let scene = Scene::new(frame, &coarse.most(kept), &[]);
    let any = coarse.any(excess);
    let wanted = Wanted::of(&any);
    let mut directions = vec![Direction::NEG_Z];
    let sphere = fibonacci_sphere(2 * FROM_BELOW);
    directions.extend(sphere.into_iter().filter(|d| d.vec().z < 0.0));
    let reached: Vec<Vec<BitGrid>> = directions
        .into_par_iter()
        .map(|d| {
            ctx.check()?;
            let maps = cutter_maps(&scene, &wanted, setting.cutters(), d);
            Ok(maps.iter().map(|m| reachable(m, &any, frame)).collect())
        })
        .collect::<Result<_, Cancelled>>()?;
    let mut open = BitGrid::new(frame.dims);
    reached.iter().flatten().for_each(|r| open.union_with(r));
    Ok(coarse.refined(&open, excess.dims()).and(excess))
}
