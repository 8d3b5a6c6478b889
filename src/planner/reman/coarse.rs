//! A quick look: the job on a coarser grid.
//!
//! Which direction and tool come next is decided among hundreds; that choice needs two digits, not
//! the last voxel. It is made here at an eighth of the voxels or fewer; what is then cut or printed
//! is computed on the job's own grid, and what the quick look missed is looked for there.

use crate::base::tolerance;
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

/// Voxels of the grid on which local planes are looked for, and solid ones of them (the graph's
/// cells): a hundred planes are tried there in a second. At 150 mm a voxel is as large as the 2 mm
/// at which the paper samples; a massive part gets larger ones.
const CELL_VOXELS: usize = 150_000;
const SOLID_CELLS: usize = 10_000;

impl Coarse {
    pub fn of(job: &Job) -> Coarse {
        Coarse::within(job, QUICK_VOXELS, usize::MAX)
    }

    /// The grid of the dependency graph's cells.
    pub fn cells(job: &Job) -> Coarse {
        Coarse::within(job, CELL_VOXELS, SOLID_CELLS)
    }

    fn within(job: &Job, most: usize, most_solid: usize) -> Coarse {
        let solid = job.target.count_and(&job.initial);
        let voxels = job.frame.dims.iter().product::<usize>();
        let mut factor = 1;
        let fits = |f: usize| voxels / f.pow(3) <= most && solid / f.pow(3) <= most_solid;
        while !fits(factor) {
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

    /// The coarse job to plan on, not only to look at: with the allowances of its own pitch.
    pub fn as_job(&self) -> Job {
        let mut job = self.job.clone();
        let pitch = job.frame.pitch;
        job.rules.tolerance_mm = job.rules.tolerance_mm.max(tolerance::surface_mm(pitch));
        job.rules.grip_mm = job.rules.grip_mm.max(tolerance::grip_mm(pitch));
        job
    }

    /// Whether it is coarser than the job's own grid.
    pub fn is_coarser(&self) -> bool {
        self.factor > 1
    }

    /// Solid where half of the voxels are: for what stands.
    pub fn most(&self, grid: &BitGrid) -> BitGrid {
        coarsened(grid, self.factor, self.factor.pow(3).div_ceil(2))
    }

    /// The coarse voxel that a voxel of the job's grid lies in.
    pub fn voxel_of(&self, voxel: [usize; 3]) -> [usize; 3] {
        voxel.map(|c| c / self.factor)
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
