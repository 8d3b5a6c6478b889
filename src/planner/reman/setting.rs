//! What every stage asks of the job: holdings, their fixed obstacles, directions.

use crate::base::{DVec3, Direction, fibonacci_sphere};
use crate::machine::{BaseKind, Holding, HoldingMode};
use crate::plan::Job;
use crate::voxel::BitGrid;

/// The job with what follows from it once.
pub struct Setting<'a> {
    pub job: &'a Job,
    pub holdings: Vec<Holding>,
    first_fixed: Vec<DVec3>,
}

impl<'a> Setting<'a> {
    pub fn new(job: &'a Job) -> Self {
        let mut holdings = vec![Holding::AS_CLAMPED];
        if job.rules.holding == HoldingMode::Refixture {
            let all = job.initial.or(&job.target);
            let top = all.extent().map_or(0.0, |(_, hi)| job.frame.center(hi).z);
            let height_mm = -(top + job.frame.pitch / 2.0);
            holdings.push(Holding { up: Direction::NEG_Z, height_mm });
        }
        let first_fixed = match job.rules.base {
            BaseKind::None => Vec::new(),
            BaseKind::Pedestal => job.machine.workholding.obstacle_points(
                &Holding::AS_CLAMPED,
                &job.base_contact(),
                &job.frame,
            ),
        };
        Setting { job, holdings, first_fixed }
    }

    /// Fixed obstacle points of a holding that begins in `state`.
    pub fn fixed(&self, holding: usize, state: &BitGrid) -> Vec<DVec3> {
        if holding == 0 {
            return self.first_fixed.clone();
        }
        if self.job.rules.base == BaseKind::None {
            return Vec::new();
        }
        let hold = &self.holdings[holding];
        let contact = hold.contact(state, &self.job.frame, self.job.rules.grip_mm);
        self.job.machine.workholding.obstacle_points(hold, &contact, &self.job.frame)
    }

    /// Whether the machine can work along `d` in this holding.
    pub fn can_point(&self, holding: usize, d: Direction) -> bool {
        self.job.machine.can_point(self.holdings[holding].up, d)
    }

    /// The grid axes of a holding, up first, its downward one left out.
    pub fn axes(&self, holding: usize) -> Vec<Direction> {
        let up = self.holdings[holding].up;
        let all = [up, Direction::X, Direction::NEG_X, Direction::Y, Direction::NEG_Y];
        all.into_iter().filter(|d| self.can_point(holding, *d)).collect()
    }

    /// Sampled directions of a holding: those of a lattice of `2 count` on the sphere that lie
    /// within the machine's limits, most of them on its upper half.
    pub fn sampled(&self, holding: usize, count: usize) -> Vec<Direction> {
        fibonacci_sphere(2 * count).into_iter().filter(|d| self.can_point(holding, *d)).collect()
    }
}
