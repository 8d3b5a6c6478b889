//! What a run tells beside its plan, and how long its stages took.

use super::clip::Clip;
use super::round::volumes;
use super::{LOCAL_VOXELS, Standing};
use crate::plan::{Job, Plane};
use crate::voxel::BitGrid;
use std::time::Instant;

/// Edge in mm of the cells in which inaccessible material is counted (W2V samples every 2 mm).
const COUNT_CELL_MM: f64 = 2.0;

/// What a run tells beside its plan; names as in W2V Tables 1 and 2.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Report {
    /// B: height of the lowest point of the bases over the base plane, by M's height.
    pub base_height_ratio: Option<f64>,
    /// #P_S, #P_A: cells of 2 mm with deep material out of reach while all of V_R^C stands; by the
    /// look on the coarse grid where no blocks were made for that on the job's own.
    pub inaccessible_sm: usize,
    pub inaccessible_am: usize,
    /// R_I: volume of V_R^C by the target's.
    pub reuse_initial: f64,
    /// #C_b.
    pub planes_global: usize,
    /// #C_a.
    pub planes_local: usize,
    /// Choices of local planes judged.
    pub judged: usize,
    /// How good the plan is, to compare it with that of another placement of the target.
    pub standing: Standing,
    /// Stage names and wall seconds.
    pub seconds: Vec<(&'static str, f64)>,
    pub notes: Vec<String>,
}

impl Report {
    /// Adds the times of a further round.
    pub fn add_seconds(&mut self, further: &Report) {
        for (stage, seconds) in &further.seconds {
            match self.seconds.iter_mut().find(|(s, _)| s == stage) {
                Some(l) => l.1 += seconds,
                None => self.seconds.push((stage, *seconds)),
            }
        }
    }

    /// Says that so many voxels are printed outside the target, and why.
    pub fn note_supports(&mut self, job: &Job, voxels: usize, why: &str) {
        if voxels > 0 {
            self.notes.push(format!(
                "{:.1} mm³ of supports are printed and cut away again, {why}.",
                voxels as f64 * job.frame.voxel_volume()
            ));
        }
    }

    /// Says that so many printed voxels are too many to look for local planes.
    pub fn note_too_large(&mut self, voxels: usize) {
        self.notes.push(format!(
            "Clipping planes for single regions, which may keep more of the initial part, were not searched for: \
             {voxels} voxels are to be printed, and the search takes no more than {LOCAL_VOXELS}; a coarser \
             grid (--resolution) allows it"
        ));
    }

    /// R_I and #C_b.
    pub fn tell_planes(&mut self, job: &Job, planes: &[Plane]) {
        let clips: Vec<Clip> = planes.iter().map(|p| Clip::global(*p)).collect();
        let initial = volumes(job, &clips).reused.count();
        self.reuse_initial = initial as f64 / job.target.count() as f64;
        self.planes_global = planes.len();
    }

    /// #P_S and #P_A, from what blocks leave while all that the global planes keep stands.
    pub fn count_inaccessible(&mut self, job: &Job, excess: &BitGrid, deficit: &BitGrid) {
        self.inaccessible_sm = cells(job, excess);
        self.inaccessible_am = cells(job, deficit);
    }
}

/// Number of 2 mm cells that hold any of `set`.
fn cells(job: &Job, set: &BitGrid) -> usize {
    let n = (COUNT_CELL_MM / job.frame.pitch).round().max(1.0) as usize;
    let mut seen = std::collections::BTreeSet::new();
    set.iter_ones().for_each(|v| {
        seen.insert(v.map(|c| c / n));
    });
    seen.len()
}

/// Wall seconds per stage, summed over rounds.
pub struct Clock {
    since: Instant,
    pub laps: Vec<(&'static str, f64)>,
}

impl Default for Clock {
    fn default() -> Self {
        Clock { since: Instant::now(), laps: Vec::new() }
    }
}

impl Clock {
    pub fn lap(&mut self, stage: &'static str) {
        let now = Instant::now();
        let seconds = (now - self.since).as_secs_f64();
        self.since = now;
        match self.laps.iter_mut().find(|(s, _)| *s == stage) {
            Some(l) => l.1 += seconds,
            None => self.laps.push((stage, seconds)),
        }
    }
}
