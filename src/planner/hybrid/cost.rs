//! What material costs (HB Sec. 6.1, Eqs. 38–41).
//!
//! Costs are per voxel moved, of additive tools c_AM and of subtractive ones c_SM. The estimate of
//! Eq. 39 takes the cheapest tool of either kind, so that it never exceeds what is to be paid. It
//! is charged for what a goal leaves as well: within δ the rest, and skin, count as if they were moved.

use super::Options;
use crate::plan::{Job, StepKind};

/// Costs a voxel.
pub struct Costs {
    cutters: Vec<f64>,
    nozzles: Vec<f64>,
    least_cutter: f64,
    least_nozzle: f64,
    /// Voxels of the target, and those that a goal may be off by (Eq. 38).
    target: usize,
    delta: f64,
}

impl Costs {
    pub fn new(job: &Job, options: &Options) -> Costs {
        let of = |name: &str, usual: f64| {
            let own = options.tool_costs.iter().find(|(tool, _)| tool == name);
            own.map_or(usual, |(_, c)| *c)
        };
        let cutters: Vec<f64> = job.cutters.iter().map(|t| of(&t.name, options.lambda)).collect();
        let nozzles: Vec<f64> = job.nozzles.iter().map(|t| of(&t.name, 1.0)).collect();
        // Without a tool there is nothing to pay it for; infinite would spoil sums.
        let least = |all: &[f64]| all.iter().copied().reduce(f64::min).unwrap_or(0.0);
        Costs {
            least_cutter: least(&cutters),
            least_nozzle: least(&nozzles),
            cutters,
            nozzles,
            target: job.target.count(),
            delta: options.delta,
        }
    }

    /// Cost of an action that moves some voxels with the job's n-th tool of a kind.
    pub fn moved(&self, kind: StepKind, tool: usize, voxels: usize) -> f64 {
        let of = match kind {
            StepKind::Subtractive => &self.cutters,
            StepKind::Additive => &self.nozzles,
        };
        of.get(tool).copied().unwrap_or(0.0) * voxels as f64
    }

    /// Whether no other tool of its kind is cheaper.
    pub fn is_cheapest(&self, kind: StepKind, tool: usize) -> bool {
        let (all, least) = match kind {
            StepKind::Subtractive => (&self.cutters, self.least_cutter),
            StepKind::Additive => (&self.nozzles, self.least_nozzle),
        };
        all.get(tool).is_some_and(|c| *c == least)
    }

    /// h (Eq. 39) of a state with so much too much and too little.
    pub fn remaining(&self, excess: usize, deficit: usize) -> f64 {
        self.least_nozzle * deficit as f64 + self.least_cutter * excess as f64
    }

    /// What it costs at least to remove and add again so many voxels.
    pub fn sacrificed(&self, voxels: usize) -> f64 {
        (self.least_cutter + self.least_nozzle) * voxels as f64
    }

    /// Voxels that a goal may be off by, skin aside.
    pub fn slack(&self) -> usize {
        (self.delta * self.target as f64).floor() as usize
    }

    /// Eq. 38 of a state that is so many voxels off, skin aside.
    pub fn is_goal(&self, off: usize) -> bool {
        off == 0 || (off as f64) < self.delta * self.target as f64
    }
}
