//! Replays a plan: the states before and after each step, the sets every rule asks for at the
//! end, and the fixed points of the holding a step is made in.

use crate::base::{DVec3, Direction, ImagePlane};
use crate::machine::BaseKind;
use crate::plan::{Job, Plan, Step, StepKind};
use crate::voxel::{BitGrid, Frame};

pub(super) struct Replay<'a> {
    job: &'a Job,
    plan: &'a Plan,
    /// P_{i−1} of the step taken last.
    pub before: BitGrid,
    /// P_i of the step taken last.
    pub after: BitGrid,
    pub removed: BitGrid,
    pub added: BitGrid,
    holding: Option<usize>,
    fixed: Vec<DVec3>,
    contact_is_empty: bool,
}

/// Where a tool works: obstacles, grid and image plane of one step.
pub(super) struct Site<'a> {
    pub solid: &'a BitGrid,
    pub fixed: &'a [DVec3],
    pub frame: &'a Frame,
    pub direction: Direction,
    pub plane: ImagePlane,
}

impl<'a> Replay<'a> {
    pub fn new(job: &'a Job, plan: &'a Plan) -> Self {
        let empty = BitGrid::new(job.frame.dims);
        Replay {
            job,
            plan,
            before: job.initial.clone(),
            after: job.initial.clone(),
            removed: empty.clone(),
            added: empty,
            holding: None,
            fixed: Vec::new(),
            contact_is_empty: false,
        }
    }

    /// Applies a step whose region is on the job's grid.
    pub fn take(&mut self, step: &Step) {
        std::mem::swap(&mut self.before, &mut self.after);
        self.after = self.before.clone();
        match step.kind {
            StepKind::Subtractive => {
                self.after.subtract(&step.region);
                self.removed.union_with(&step.region);
            }
            StepKind::Additive => {
                self.after.union_with(&step.region);
                self.added.union_with(&step.region);
            }
        }
        if self.holding != Some(step.holding) {
            self.hold(step.holding);
        }
    }

    /// Begins a holding with the state before the current step.
    fn hold(&mut self, index: usize) {
        self.holding = Some(index);
        self.fixed = Vec::new();
        self.contact_is_empty = false;
        // A holding the plan does not have is refused by the machine rule.
        let Some(holding) = self.plan.holdings.get(index) else { return };
        if self.job.rules.base == BaseKind::None {
            return;
        }
        let frame = &self.job.frame;
        let contact = match index {
            0 => self.job.base_contact(),
            _ => holding.contact(&self.before, frame, self.job.rules.grip_mm),
        };
        self.contact_is_empty = contact.is_empty();
        self.fixed = self.job.machine.workholding.obstacle_points(holding, &contact, frame);
    }

    /// Whether the current holding has a base to hold the part by, but nothing touches it.
    pub fn nothing_held(&self) -> bool {
        self.contact_is_empty
    }

    pub fn site<'s>(&'s self, job: &'s Job, step: &Step, solid: &'s BitGrid) -> Site<'s> {
        Site {
            solid,
            fixed: &self.fixed,
            frame: &job.frame,
            direction: step.direction,
            plane: step.direction.image_plane(),
        }
    }
}
