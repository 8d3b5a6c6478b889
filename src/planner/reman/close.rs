//! The last of the cuts: what depth maps say no direction takes.
//!
//! Method. A groove hardly wider than the cutter is open to it along some direction, and yet no
//! over-cut takes it: off the axes the maps count what stands beside the shaft as in its way and
//! as out of its reach. Where few voxels are left, cuts are made by exact distances instead
//! ([`Close`](crate::access::Close)), along the directions whose maps promise most while
//! just what is kept stands, then along denser ones.
//!
//! Guarantees: those of cuts. Where nothing or much is left nothing is done, so it costs nothing
//! there.

use super::cutting::{Cutter, How};
use super::reach::{Reach, bounds, choose, gains};
use crate::access::Scene;
use crate::base::{Cancelled, Ctx, DVec3};
use crate::voxel::BitGrid;

/// Voxels left up to which exact distances are asked: with more, other tools are what is missing, and
/// the time goes up with them.
const MOST_VOXELS: usize = 3000;

/// Cuts tried in vain, one after the other, before a holding ends.
const PATIENCE: usize = 12;

/// Directions are so much denser where the usual ones leave something: on a bracket four times as many
/// took 17 voxels of 1188 that the usual ones left.
const DENSER: usize = 4;

impl<'a> Cutter<'_, 'a> {
    /// Whether so little is left that exact distances are worth their time.
    pub fn few_are_left(&self) -> bool {
        (1..=MOST_VOXELS).contains(&self.cutting.unreached.count())
    }

    /// Cuts what is left of little, in the last holding first: its directions were looked at last.
    pub fn cut_closely(&mut self, samples: usize, ctx: &Ctx) -> Result<(), Cancelled> {
        for samples in [samples, DENSER * samples] {
            for holding in (0..self.setting.holdings.len()).rev() {
                if !self.few_are_left() || ctx.out_of_time() {
                    return Ok(());
                }
                let fixed = self.setting.fixed(holding, &self.cutting.state);
                let mut directions = self.setting.axes(holding);
                directions.extend(self.setting.sampled(holding, samples));
                let scene = Scene::new(&self.setting.job.frame, &self.fine_kept, &fixed);
                let left = &self.cutting.unreached;
                let reach = bounds(&scene, left, self.cutters, &directions, ctx)?;
                self.take_closely(&reach, holding, &fixed, ctx)?;
            }
        }
        Ok(())
    }

    fn take_closely(
        &mut self,
        reach: &[Reach<'a>],
        holding: usize,
        fixed: &[DVec3],
        ctx: &Ctx,
    ) -> Result<(), Cancelled> {
        let mut barren: Vec<usize> = Vec::new();
        while barren.len() < PATIENCE {
            ctx.check()?;
            let hoped = gains(reach, &self.cutting.unreached);
            let Some(next) = choose(reach, &hoped, &barren) else { return Ok(()) };
            let Reach { direction, tool, .. } = reach[next];
            let rest: BitGrid = self.removable.and(&self.cutting.state);
            let region = self.held_cut(rest, fixed, (tool, direction), How::Closely);
            let gain = region.count_and(&self.cutting.unreached);
            tracing::debug!(
                holding,
                tool = tool.name,
                ?direction,
                hoped = hoped[next],
                gain,
                left = self.cutting.unreached.count() - gain,
                "close cut"
            );
            match gain {
                0 => barren.push(next),
                _ => {
                    barren.clear();
                    self.push(region, tool, direction, holding);
                }
            }
        }
        Ok(())
    }
}
