//! Rule `stability`: nothing falls off. In holding `base` every body reaches down to the base
//! contact; with refixturing the state is one body.

use super::bodies::Bodies;
use super::tally::Tally;
use super::{Rule, RuleResult};
use crate::machine::{Holding, HoldingMode};
use crate::plan::Job;
use crate::voxel::{BitGrid, Frame};

pub(super) fn check(job: &Job, index: usize, after: &BitGrid) -> RuleResult {
    let (tally, why) = match job.rules.holding {
        HoldingMode::Base => {
            (unheld(after, &job.frame, job.rules.grip_mm), "they hang on nothing held by the base")
        }
        HoldingMode::Refixture => (apart(after), "they are apart from the largest body"),
    };
    tally.result(Rule::Stability, index, "voxels loose", &job.frame, || why.into())
}

/// Voxels not connected to the base contact.
pub(super) fn unheld(state: &BitGrid, frame: &Frame, grip_mm: f64) -> Tally {
    let bodies = Bodies::of(state);
    let gripped = |z: usize| Holding::AS_CLAMPED.height(frame.center([0, 0, z])) <= grip_mm;
    let mut held = vec![false; bodies.runs.len()];
    for (run, body) in bodies.runs.iter().zip(&bodies.body) {
        held[*body] |= gripped(run.z);
    }
    loose(&bodies, |body| held[body])
}

/// Voxels outside the largest body.
pub(super) fn apart(state: &BitGrid) -> Tally {
    let bodies = Bodies::of(state);
    let largest = bodies.largest();
    loose(&bodies, |body| Some(body) == largest)
}

fn loose(bodies: &Bodies, held: impl Fn(usize) -> bool) -> Tally {
    Tally::joined(
        bodies
            .runs
            .iter()
            .zip(&bodies.body)
            .filter(|(_, body)| !held(**body))
            .map(|(r, _)| Tally { count: r.len, first: Some([r.x, r.y, r.z]) }),
    )
}
