//! A quick look: the job on a coarser grid.
//!
//! Which direction and tool come next is decided among hundreds; that choice needs two digits, not
//! the last voxel. It is made here at an eighth of the voxels or fewer; what is then cut or printed
//! is computed on the job's own grid, and what the quick look missed is looked for there.

use crate::plan::Job;
use crate::voxel::{BitGrid, coarsened, refined};

/// Voxels of the solids' box above which the grid is coarsened: the sweep of all directions over
/// this many takes about a second on two cores. Lower misjudges small parts, higher waits longer.
const QUICK_VOXELS: usize = 800_000;

/// The dip of a nozzle may be this share of a coarse pitch: a coarse staircase is as high.
const COARSE_DIP_PITCHES: f64 = 0.75;

pub struct Coarse {
    pub job: Job,
    factor: usize,
}

impl Coarse {
    pub fn of(job: &Job) -> Coarse {
        let voxels = job.frame.dims.iter().product::<usize>();
        let mut factor = 1;
        while voxels / (factor * factor * factor) > QUICK_VOXELS {
            factor += 1;
        }
        let mut coarse = Coarse { job: job.clone(), factor };
        if factor > 1 {
            coarse.job.frame = job.frame.coarsened(factor);
            coarse.job.initial = coarse.most(&job.initial);
            coarse.job.target = coarse.most(&job.target);
            let dip = COARSE_DIP_PITCHES * coarse.job.frame.pitch;
            coarse.job.rules.nozzle_dip_mm = job.rules.nozzle_dip_mm.max(dip);
        }
        coarse
    }

    /// Solid where half of the voxels are: for what stands.
    pub fn most(&self, grid: &BitGrid) -> BitGrid {
        coarsened(grid, self.factor, self.factor.pow(3).div_ceil(2))
    }

    /// Solid where any voxel is: for what is to be reached.
    pub fn any(&self, grid: &BitGrid) -> BitGrid {
        coarsened(grid, self.factor, 1)
    }

    /// The voxels of the job's grid that lie in a coarse set.
    pub fn refined(&self, coarse: &BitGrid, dims: [usize; 3]) -> BitGrid {
        refined(coarse, self.factor, dims)
    }
}
