//! Rule `stability`: nothing falls off. In holding `base` every body reaches down to the base
//! contact; with refixturing the state is one body.

use super::bodies::Bodies;
use super::standing::Standing;
use super::tally::Tally;
use super::{Rule, RuleResult};
use crate::machine::{Holding, HoldingMode};
use crate::plan::{Job, Step, StepKind};
use crate::voxel::{BitGrid, Frame};

/// Steps from which on what stands is kept up from step to step instead of found anew.
const MANY_STEPS: usize = 100;

/// Judges the states of a plan one after the other.
pub(super) struct Watch {
    /// Of the state before; none for a short plan, and once something was loose.
    standing: Option<Standing>,
}

impl Watch {
    pub fn new(job: &Job, steps: usize) -> Watch {
        let gripped = gripped(&job.frame, job.rules.grip_mm);
        let ground = (0..job.frame.dims[2]).map(gripped).collect();
        let kept = steps >= MANY_STEPS && job.rules.holding == HoldingMode::Base;
        let standing = kept.then(|| Standing::new(job.frame.dims, ground));
        let standing = standing.and_then(|mut s| {
            let stands = s.added(job.initial.iter_ones());
            stands.then_some(s)
        });
        Watch { standing }
    }

    /// The verdict on the state after a step.
    pub fn check(&mut self, job: &Job, index: usize, step: &Step, after: &BitGrid) -> RuleResult {
        if let Some(standing) = &mut self.standing {
            let stands = match step.kind {
                StepKind::Additive => standing.added(step.region.iter_ones()),
                StepKind::Subtractive => standing.removed(step.region.iter_ones()),
            };
            if stands {
                let none = Tally::default();
                return none.result(Rule::Stability, index, MEANS, &job.frame, String::new);
            }
            self.standing = None;
        }
        check(job, index, after)
    }
}

const MEANS: &str = "voxels loose";

fn gripped(frame: &Frame, grip_mm: f64) -> impl Fn(usize) -> bool {
    let frame = *frame;
    move |z| Holding::AS_CLAMPED.height(frame.center([0, 0, z])) <= grip_mm
}

pub(super) fn check(job: &Job, index: usize, after: &BitGrid) -> RuleResult {
    let (tally, why) = match job.rules.holding {
        HoldingMode::Base => {
            (unheld(after, &job.frame, job.rules.grip_mm), "they hang on nothing held by the base")
        }
        HoldingMode::Refixture => (apart(after), "they are apart from the largest body"),
    };
    tally.result(Rule::Stability, index, MEANS, &job.frame, || why.into())
}

/// Voxels not connected to the base contact.
pub(super) fn unheld(state: &BitGrid, frame: &Frame, grip_mm: f64) -> Tally {
    let bodies = Bodies::of(state);
    let gripped = gripped(frame, grip_mm);
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
