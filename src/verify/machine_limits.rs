//! Rule `machine`: the tool is one of the job's and of the step's kind, the holding is one the
//! rules allow, the rotary axes can point the tool along the direction, and in one such posture
//! the linear axes reach every voxel of the region with the tip.
//!
//! A cutter's tip stands up to its radius beside the voxel it cuts; the tips a program really uses
//! are checked when the program is. Here the region's own voxels stand for them.

use super::replay::Held;
use super::{Rule, RuleResult};
use crate::base::{DVec3, Direction};
use crate::machine::{Holding, HoldingMode, InvalidTool, Overtravel, Tool, ToolKind};
use crate::plan::{Job, Plan, Step, StepKind};

/// Why a machine cannot make a step.
#[derive(Debug, thiserror::Error, PartialEq)]
pub(super) enum MachineFault {
    #[error("tool '{tool}' is not among the job's {kind} tools ({known})")]
    UnknownTool { tool: String, kind: &'static str, known: String },
    #[error("tool '{tool}' is {found}, the step is {kind}")]
    WrongKind { tool: String, found: &'static str, kind: &'static str },
    #[error(transparent)]
    InvalidTool(#[from] InvalidTool),
    #[error("holding {holding} does not exist, the plan has {count}")]
    NoHolding { holding: usize, count: usize },
    #[error("the first holding must be as clamped: up = +z from z = 0")]
    FirstHolding,
    #[error("holding {holding} is used, but the rules keep the part on its base (holding 0)")]
    Refixtured { holding: usize },
    #[error(
        "holding {holding}: up = {up:?} is no grid axis, or its height {height_mm} mm no figure"
    )]
    HoldingAxis { holding: usize, up: [f64; 3], height_mm: f64 },
    #[error(
        "nothing of the part lies within the grip height of the base plane of holding {holding}"
    )]
    NothingHeld { holding: usize },
    #[error(
        "({:.3}, {:.3}, {:.3}) is {tilt:.2}° from up; no rotary angles within the machine's limits \
         point the tool there, choose another direction or holding",
        .d.vec().x, .d.vec().y, .d.vec().z
    )]
    Direction { d: Direction, tilt: f64 },
    #[error(transparent)]
    Overtravel(#[from] Overtravel),
}

pub(super) fn check(job: &Job, plan: &Plan, index: usize, held: Held) -> RuleResult {
    let step = &plan.steps[index];
    let faults: Vec<MachineFault> = [
        tool_of(job, step).err(),
        holding_of(job, plan, step).err(),
        held.nothing.then_some(MachineFault::NothingHeld { holding: step.holding }),
        pointing(job, plan, step, held).err(),
    ]
    .into_iter()
    .flatten()
    .collect();
    RuleResult {
        rule: Rule::Machine,
        step: Some(index),
        passed: faults.is_empty(),
        figure: faults.len() as f64,
        figure_means: "limits broken",
        detail: faults.iter().map(ToString::to_string).collect::<Vec<_>>().join("; "),
    }
}

fn kind_name(kind: ToolKind) -> &'static str {
    match kind {
        ToolKind::Subtractive => "subtractive",
        ToolKind::Additive => "additive",
    }
}

/// The tool a step is made with.
pub(super) fn tool_of<'a>(job: &'a Job, step: &Step) -> Result<&'a Tool, MachineFault> {
    let (own, other, kind) = match step.kind {
        StepKind::Subtractive => (&job.cutters, &job.nozzles, ToolKind::Subtractive),
        StepKind::Additive => (&job.nozzles, &job.cutters, ToolKind::Additive),
    };
    let named = |tools: &'a [Tool]| tools.iter().find(|t| t.name == step.tool);
    let Some(tool) = named(own).or_else(|| named(other)) else {
        let known = own.iter().map(|t| t.name.as_str()).collect::<Vec<_>>().join(", ");
        return Err(MachineFault::UnknownTool {
            tool: step.tool.clone(),
            kind: kind_name(kind),
            known,
        });
    };
    if tool.kind != kind {
        let found = kind_name(tool.kind);
        return Err(MachineFault::WrongKind {
            tool: step.tool.clone(),
            found,
            kind: kind_name(kind),
        });
    }
    tool.validate()?;
    Ok(tool)
}

fn holding_of(job: &Job, plan: &Plan, step: &Step) -> Result<(), MachineFault> {
    let holding = step.holding;
    let Some(h) = plan.holdings.get(holding) else {
        return Err(MachineFault::NoHolding { holding, count: plan.holdings.len() });
    };
    if plan.holdings[0] != Holding::AS_CLAMPED {
        return Err(MachineFault::FirstHolding);
    }
    if job.rules.holding == HoldingMode::Base && holding != 0 {
        return Err(MachineFault::Refixtured { holding });
    }
    if !(h.up.is_grid_axis() && h.height_mm.is_finite()) {
        let up = h.up.vec().to_array();
        return Err(MachineFault::HoldingAxis { holding, up, height_mm: h.height_mm });
    }
    Ok(())
}

fn pointing(job: &Job, plan: &Plan, step: &Step, held: Held) -> Result<(), MachineFault> {
    let (Some(holding), d) = (plan.holdings.get(step.holding), step.direction) else {
        return Ok(()); // named by `holding_of`
    };
    if !job.machine.can_point(holding.up, d) {
        let tilt = holding.up.dot(d.vec()).clamp(-1.0, 1.0).acos().to_degrees();
        return Err(MachineFault::Direction { d, tilt });
    }
    let Ok(tool) = tool_of(job, step) else { return Ok(()) }; // named by `tool_of`
    let placement = job.machine.placement(holding, held.contact_center);
    let tips = row_ends(step, job);
    let mut refused = None;
    for rotary in job.machine.solutions(&placement, d) {
        match job.machine.check_travel(&placement, rotary, tool, &tips) {
            Ok(()) => return Ok(()),
            Err(found) => refused = refused.or(Some(found)),
        }
    }
    refused.map_or(Ok(()), |found| Err(found.into()))
}

/// Centres of the first and last voxel of each row of the region: in one posture the axes move
/// linearly with the tip, so the voxels between them need no more travel.
fn row_ends(step: &Step, job: &Job) -> Vec<DVec3> {
    let mut ends: Vec<[usize; 3]> = Vec::new();
    for (y, z, x, len) in step.region.runs() {
        let last = [x + len - 1, y, z];
        match ends.last_mut() {
            Some(end) if end[1..] == last[1..] => *end = last,
            _ => ends.extend([[x, y, z], last]),
        }
    }
    ends.into_iter().map(|v| job.frame.center(v)).collect()
}
