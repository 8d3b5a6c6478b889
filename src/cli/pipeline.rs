//! The stages between the job and the files, as the command line calls them: setup, planner,
//! verifier, posting. Each turns the library's answer into what is reported.

use super::config::PlanConfig;
use super::exit::Failure;
use super::plan::Clock;
use hmplan::base::{Ctx, DAffine3};
use hmplan::machine::Machine;
use hmplan::mesh::TriMesh;
use hmplan::plan::{Job, Plan};
use hmplan::report::{Judgement, PlannerFigures, RuleLine};

/// A plan with the verifier's judgement.
pub struct Judged {
    plan: Plan,
    pub judgement: Judgement,
    /// Where most of the residual lies, in words.
    pub location: Option<String>,
}

impl Judged {
    pub fn plan(&self) -> &Plan {
        &self.plan
    }
}

/// A program and the time each step takes on the machine, s.
pub struct Posted {
    pub text: String,
    pub step_seconds: Vec<f64>,
}

pub fn layer_mm(_machine: &Machine) -> f64 {
    0.2
}

pub fn setup(_initial: &TriMesh, _target: &TriMesh, _ctx: &Ctx) -> Result<DAffine3, Failure> {
    Err(Failure::input("seam"))
}

pub fn plan(
    job: &Job,
    _config: &PlanConfig,
    _ctx: &Ctx,
    _clock: &mut Clock,
) -> Result<(Plan, PlannerFigures), Failure> {
    use hmplan::base::Direction;
    use hmplan::plan::*;
    let step = |kind, tool: &str, region, block| Step { kind, tool: tool.into(), direction: Direction::Z, holding: 0, region, block, origin: Origin::default() };
    Ok((
        Plan {
            holdings: vec![hmplan::machine::Holding::AS_CLAMPED],
            steps: vec![
                step(StepKind::Subtractive, &job.cutters[0].name, job.initial.minus(&job.target), 0),
                step(StepKind::Additive, &job.nozzles[0].name, job.target.minus(&job.initial), 0),
            ],
        },
        PlannerFigures { planner: "reman".into(), ..Default::default() },
    ))
}

pub fn judge(_job: &Job, plan: Plan, _ctx: &Ctx) -> Result<Judged, Failure> {
    Ok(Judged {
        plan,
        judgement: Judgement {
            passed: true,
            failed_rules: vec![],
            rules: vec![RuleLine { rule: "content".into(), passed: true, figure: "fine".into() }],
            excess_mm3: 0.0,
            deficit_mm3: 0.0,
            skin_mm3: 0.0,
            residual_mm3: 0.0,
        },
        location: None,
    })
}

pub fn post(_job: &Job, judged: &Judged, _unverified: bool, _ctx: &Ctx) -> Result<Posted, Failure> {
    Ok(Posted { text: "%\nG0 X0\n%\n".into(), step_seconds: vec![60.0; judged.plan.steps.len()] })
}

/// Holds a program against the plan; one line a rule.
pub fn check_program(_job: &Job, _judged: &Judged, _text: &str, _ctx: &Ctx) -> Result<Vec<RuleLine>, Failure> {
    Ok(vec![RuleLine { rule: "program".into(), passed: true, figure: "fine".into() }])
}
