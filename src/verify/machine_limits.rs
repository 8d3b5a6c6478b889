//! Rule `machine`: the tool is one of the job's and of the step's kind, the holding is one the
//! rules allow, and the machine can point the tool along the direction.

use super::{Rule, RuleResult};
use crate::base::Direction;
use crate::machine::{Holding, HoldingMode, InvalidTool, Tool, ToolKind};
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
    #[error("({0:.3}, {1:.3}, {2:.3}) is {tilt:.2}° from up, more than the machine's {limit:.2}°",
        d.vec().x, d.vec().y, d.vec().z)]
    Direction { d: Direction, tilt: f64, limit: f64 },
}

/// `nothing_held`: a base is asked for and no part of the state that the holding began with
/// touches it.
pub(super) fn check(job: &Job, plan: &Plan, index: usize, nothing_held: bool) -> RuleResult {
    let step = &plan.steps[index];
    let faults: Vec<MachineFault> = [
        tool_of(job, step).err(),
        holding_of(job, plan, step).err(),
        nothing_held.then_some(MachineFault::NothingHeld { holding: step.holding }),
        pointing(job, plan, step).err(),
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

fn pointing(job: &Job, plan: &Plan, step: &Step) -> Result<(), MachineFault> {
    let (Some(holding), d) = (plan.holdings.get(step.holding), step.direction) else {
        return Ok(()); // named by `holding_of`
    };
    if job.machine.can_point(holding.up, d) {
        return Ok(());
    }
    let tilt = holding.up.dot(d.vec()).clamp(-1.0, 1.0).acos().to_degrees();
    Err(MachineFault::Direction { d, tilt, limit: job.machine.max_tilt_deg })
}
