//! Replays a plan: the states before and after each step, the sets every rule asks for at the
//! end, and the fixed points of the holding a step is made in.

use crate::base::{DVec3, Direction, ImagePlane};
use crate::machine::{BaseKind, Holding};
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
    contact_center: DVec3,
    /// The step taken last, which `before` does not have yet.
    last: Option<&'a Step>,
    /// Extents of `before` and `after`.
    bounds: [Slabs; 2],
}

/// Where a tool works: obstacles, grid and image plane of one step.
pub(super) struct Site<'a> {
    pub solid: &'a BitGrid,
    pub fixed: &'a [DVec3],
    pub frame: &'a Frame,
    pub direction: Direction,
    pub plane: ImagePlane,
    /// The first and the last slab across x, y, z with anything solid; none when nothing is.
    pub bounds: [Option<(usize, usize)>; 3],
}

/// How many solid voxels each slab across x, y, z holds.
#[derive(Clone)]
struct Slabs([Vec<usize>; 3]);

impl Slabs {
    fn of(solid: &BitGrid) -> Slabs {
        let mut slabs = Slabs(solid.dims().map(|n| vec![0; n]));
        for (y, z, x, n) in solid.runs() {
            slabs.0[0][x..x + n].iter_mut().for_each(|c| *c += 1);
            slabs.0[1][y] += n;
            slabs.0[2][z] += n;
        }
        slabs
    }

    fn bounds(&self) -> [Option<(usize, usize)>; 3] {
        [0, 1, 2].map(|a| {
            let held = |n: &usize| *n > 0;
            self.0[a].iter().position(held).zip(self.0[a].iter().rposition(held))
        })
    }
}

/// Applies a step whose region is on the state's grid.
fn apply(step: &Step, state: &mut BitGrid, slabs: &mut Slabs) {
    let adds = step.kind == StepKind::Additive;
    for v in step.region.iter_ones().filter(|v| state.get(*v) != adds) {
        for (slab, at) in slabs.0.iter_mut().zip(v) {
            slab[at] = if adds { slab[at] + 1 } else { slab[at] - 1 };
        }
    }
    if adds { state.union_with(&step.region) } else { state.subtract(&step.region) }
}

/// How the part stands on the machine in one holding.
#[derive(Clone, Copy, Debug)]
pub(super) struct Held {
    /// There is a base to hold it by, and nothing of it is in contact.
    pub nothing: bool,
    /// What stands over the table's centre, workpiece coordinates, mm.
    pub contact_center: DVec3,
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
            contact_center: DVec3::ZERO,
            last: None,
            bounds: [Slabs::of(&job.initial), Slabs::of(&job.initial)],
        }
    }

    /// Applies a step whose region is on the job's grid.
    pub fn take(&mut self, step: &'a Step) {
        // Step by step: a copy of the state would cost more than most steps of a long plan.
        if let Some(last) = self.last.replace(step) {
            apply(last, &mut self.before, &mut self.bounds[0]);
        }
        apply(step, &mut self.after, &mut self.bounds[1]);
        match step.kind {
            StepKind::Subtractive => self.removed.union_with(&step.region),
            StepKind::Additive => self.added.union_with(&step.region),
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
        let (job, frame) = (self.job, &self.job.frame);
        let contact = match index {
            0 => job.base_contact(),
            _ => holding.contact(&self.before, frame, job.rules.grip_mm),
        };
        self.contact_center = columns_middle(&contact, holding, frame);
        if job.rules.base == BaseKind::Pedestal {
            self.contact_is_empty = contact.is_empty();
            self.fixed = job.machine.workholding.obstacle_points(holding, &contact, frame);
        }
    }

    /// How the part of the current step stands on the machine.
    pub fn held(&self) -> Held {
        Held { nothing: self.contact_is_empty, contact_center: self.contact_center }
    }

    /// The state that the step's tool must not meet: what a cut leaves, what a deposit finds.
    pub fn site<'s>(&'s self, job: &'s Job, step: &Step) -> Site<'s> {
        let (solid, bounds) = match step.kind {
            StepKind::Subtractive => (&self.after, &self.bounds[1]),
            StepKind::Additive => (&self.before, &self.bounds[0]),
        };
        Site {
            solid,
            bounds: bounds.bounds(),
            fixed: &self.fixed,
            frame: &job.frame,
            direction: step.direction,
            plane: step.direction.image_plane(),
        }
    }
}

/// Mean of the contact's columns along `up`, as [`crate::machine::Workholding`] centres its table;
/// the middle of the grid when nothing is in contact.
fn columns_middle(contact: &BitGrid, holding: &Holding, frame: &Frame) -> DVec3 {
    let up = holding.up.vec();
    let axis = (0..3).find(|a| up[*a].abs() > 0.5).unwrap_or(2);
    let mut columns: Vec<[usize; 3]> = contact
        .iter_ones()
        .map(|mut v| {
            v[axis] = 0;
            v
        })
        .collect();
    columns.sort_unstable();
    columns.dedup();
    if columns.is_empty() {
        return frame.bounds().center();
    }
    columns.iter().map(|v| frame.center(*v)).sum::<DVec3>() / columns.len() as f64
}
