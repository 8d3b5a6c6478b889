//! From plan to paths: what the tip of each step's tool does, in plan coordinates.
//!
//! Method: additive steps are sliced across their direction into layers of contour-parallel
//! perimeters and infill; subtractive steps are roughed in levels, finished and rest-cut over the lattice of lowest
//! free tip heights (see `print` and `mill`). Every step stays in its own frame (u, v, d).
//!
//! Guarantees: a path never goes below the tip heights free of the output state and the fixed
//! obstacles; beads lie inside the step's region; rapids run only at the safe height or straight up;
//! the same plan gives the same paths at any thread count. Not guaranteed: machine limits, which
//! the post checks; surfaces finer than the voxels.

mod between;
mod cells;
mod close_tip;
mod columns;
mod comb;
mod contour;
mod cross;
mod drop;
mod exact;
mod faces;
mod image;
mod infill;
mod lapped;
mod mill;
mod moves;
mod near;
mod piece;
mod polygons;
mod print;
mod process;
mod pyramid;
mod ramp;
mod rowmax;
mod slice;
mod specks;
mod swept;
mod timing;
mod touch;
mod wanted;
#[cfg(test)]
pub(crate) mod tests;

pub(crate) use cells::Cells;
pub use drop::{DropCutter, End};
pub use moves::{Figures, Move, MoveKind, Toolpath};
pub use print::{CHORD_MM, INSET_SLACK};
pub(crate) use swept::Swept;
pub use timing::{Leg, motion_s, rest_to_rest};
pub(crate) use touch::facets;

use crate::base::{Cancelled, Ctx, DVec3};
use crate::machine::{BaseKind, Holding, Tool};
use crate::plan::{Job, Plan, StepKind};
use crate::verify::Verified;
use crate::voxel::BitGrid;
use mill::Work;
use moves::{legs, merge_collinear};
use process::{Milling, Printing};
use rayon::prelude::*;
use std::collections::BTreeSet;

/// Deeper cuts into the target are gouges, mm.
pub const GOUGE_MM: f64 = 0.05;

/// Why a step has no paths.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum ToolpathError {
    #[error("step {step} uses tool '{tool}', which the job does not have; add it or plan anew")]
    NoTool { step: usize, tool: String },
    #[error("step {step} names holding {holding}, but the plan has {holdings}")]
    NoHolding { step: usize, holding: usize, holdings: usize },
    #[error("step {step}'s region is on a grid of {found:?} voxels, the job's is {expected:?}")]
    WrongGrid { step: usize, found: [usize; 3], expected: [usize; 3] },
    #[error("step {step} prints, but machine '{machine}' has no extruder; add [extruder]")]
    NoExtruder { step: usize, machine: String },
    #[error("step {step} has an empty region; leave it out of the plan")]
    NothingToDo { step: usize },
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// A plan's states and obstacles as its steps see them.
pub struct Replay {
    /// P₀ … P_n.
    pub states: Vec<BitGrid>,
    /// Pedestal and table points of each step.
    pub fixed: Vec<Vec<DVec3>>,
    /// The middle of the base contact of each step's holding, plan coordinates, mm.
    pub contact_center: Vec<DVec3>,
}

impl Replay {
    /// Applies the steps in order.
    pub fn of(job: &Job, plan: &Plan) -> Result<Replay, ToolpathError> {
        let mut states = vec![job.initial.clone()];
        let (mut fixed, mut contact_center) = (Vec::new(), Vec::new());
        let mut held: Option<(usize, Vec<DVec3>, DVec3)> = None;
        for (i, step) in plan.steps.iter().enumerate() {
            let holdings = plan.holdings.len();
            let holding = plan.holdings.get(step.holding).ok_or(ToolpathError::NoHolding {
                step: i,
                holding: step.holding,
                holdings,
            })?;
            let (found, expected) = (step.region.dims(), job.frame.dims);
            if found != expected {
                return Err(ToolpathError::WrongGrid { step: i, found, expected });
            }
            if step.region.is_empty() {
                return Err(ToolpathError::NothingToDo { step: i });
            }
            let state = &states[i];
            if held.as_ref().is_none_or(|h| h.0 != step.holding) {
                let contact = if step.holding == 0 {
                    job.base_contact()
                } else {
                    holding.contact(state, &job.frame, job.rules.grip_mm)
                };
                let points = match job.rules.base {
                    BaseKind::Pedestal => {
                        job.machine.workholding.obstacle_points(holding, &contact, &job.frame)
                    }
                    BaseKind::None => Vec::new(),
                };
                held = Some((step.holding, points, middle(job, holding, &contact)));
            }
            if let Some((_, points, center)) = &held {
                fixed.push(points.clone());
                contact_center.push(*center);
            }
            let mut next = state.clone();
            match step.kind {
                StepKind::Subtractive => next.subtract(&step.region),
                StepKind::Additive => next.union_with(&step.region),
            }
            states.push(next);
        }
        Ok(Replay { states, fixed, contact_center })
    }
}

/// Mean of the contact's columns along `up`, as the table is centred; the middle of the grid when
/// nothing is in contact.
fn middle(job: &Job, holding: &Holding, contact: &BitGrid) -> DVec3 {
    let axis = (0..3).find(|a| holding.up.vec()[*a].abs() > 0.5).unwrap_or(2);
    let mut columns: BTreeSet<[usize; 3]> = BTreeSet::new();
    for mut v in contact.iter_ones() {
        v[axis] = 0;
        columns.insert(v);
    }
    let sum: DVec3 = columns.iter().map(|v| job.frame.center(*v)).sum();
    if columns.is_empty() { job.frame.bounds().center() } else { sum / columns.len() as f64 }
}

/// The paths of a plan's steps, in order, and whether the plan was verified.
#[derive(Clone, Debug, PartialEq)]
pub struct Toolpaths {
    paths: Vec<Toolpath>,
    verified: bool,
}

impl Toolpaths {
    pub fn all(&self) -> &[Toolpath] {
        &self.paths
    }

    /// False for paths of [`for_unverified`].
    pub fn verified(&self) -> bool {
        self.verified
    }
}

/// Paths of every step of a verified plan.
///
/// # Errors
/// When a step cannot be driven on the job's machine, or the user stops the run.
pub fn for_plan(job: &Job, plan: &Verified<Plan>, ctx: &Ctx) -> Result<Toolpaths, ToolpathError> {
    Ok(Toolpaths { paths: plan_paths(job, plan.get(), ctx)?, verified: true })
}

/// Paths of every step of a plan that nobody has verified: they are only as sound as it is.
///
/// # Errors
/// As [`for_plan`].
pub fn for_unverified(job: &Job, plan: &Plan, ctx: &Ctx) -> Result<Toolpaths, ToolpathError> {
    Ok(Toolpaths { paths: plan_paths(job, plan, ctx)?, verified: false })
}

fn plan_paths(job: &Job, plan: &Plan, ctx: &Ctx) -> Result<Vec<Toolpath>, ToolpathError> {
    let replay = Replay::of(job, plan)?;
    let meshes = [&job.target_mesh, &job.initial_mesh];
    let surfaces = meshes.map(|m| near::voxels_near(m, &job.frame));
    ctx.begin("toolpaths", plan.steps.len() as u64);
    let paths = (0..plan.steps.len())
        .into_par_iter()
        .map(|i| {
            ctx.check()?;
            let path = step_path(job, plan, &replay, &surfaces, i, ctx)?;
            ctx.advance(1);
            Ok(path)
        })
        .collect();
    ctx.end();
    paths
}

fn step_path(
    job: &Job,
    plan: &Plan,
    replay: &Replay,
    surfaces: &[BitGrid; 2],
    i: usize,
    ctx: &Ctx,
) -> Result<Toolpath, ToolpathError> {
    let step = &plan.steps[i];
    let mut laid = BitGrid::new(job.frame.dims);
    let before = plan.steps[..i].iter().filter(|s| s.kind == StepKind::Additive);
    before.for_each(|s| laid.union_with(&s.region));
    let no_tool = || ToolpathError::NoTool { step: i, tool: step.tool.clone() };
    let tool: &Tool = job.tool(&step.tool).ok_or_else(no_tool)?;
    let work = Work {
        job,
        frame: &job.frame,
        step,
        tool,
        before: &replay.states[i],
        after: &replay.states[i + 1],
        fixed: &replay.fixed[i],
        laid: &laid,
        surfaces,
        ctx,
    };
    let (moves, safe_height, mut figures, bead_mm2, nominal) = match step.kind {
        StepKind::Subtractive => {
            let m = mill::mill(&work, &Milling::of(&job.machine, tool))?;
            (m.moves, m.safe_height, m.figures, 0.0, 0.0)
        }
        StepKind::Additive => {
            let machine = job.machine.name.clone();
            let no_extruder = || ToolpathError::NoExtruder { step: i, machine };
            let extruder = job.machine.extruder.as_ref().ok_or_else(no_extruder)?;
            let process = Printing::of(&job.machine, extruder, tool);
            let p = print::print(&work, &process)?;
            let section = tool.process.bead_section_mm2();
            (p.moves, p.safe_height, p.figures, section, process.feed)
        }
    };
    let moves = merge_collinear(moves);
    figures.region_mm3 = step.region.count() as f64 * job.frame.voxel_volume();
    figures.time_s =
        motion_s(&legs(&moves, &job.machine.control), job.machine.control.acceleration_mm_s2);
    let mut path = Toolpath {
        step: i,
        kind: step.kind,
        tool: step.tool.clone(),
        direction: step.direction,
        holding: step.holding,
        safe_height,
        bead_mm2,
        moves,
        figures,
    };
    let working = match step.kind {
        StepKind::Subtractive => MoveKind::Cut,
        StepKind::Additive => MoveKind::Deposit,
    };
    path.figures.working_mm = path.length(working);
    path.figures.material_mm3 = path.laid_mm3(nominal);
    Ok(path)
}
