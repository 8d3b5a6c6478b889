use super::draw::{Drawing, draw_step};
use super::summary::RuleLine;
use crate::plan::{Input, Job, Plan, PlanFile, Step, StepKind};
use crate::voxel::BitGrid;
use minijinja::value::Serde;
use minijinja::{AutoEscape, Environment, Value, context};
use rayon::prelude::*;

const TEMPLATE: &str = include_str!("page.html");

/// The report of a plan as one HTML page. `plan` is the plan that `file` records.
///
/// # Errors
/// Only those of the template itself.
pub fn page(
    file: &PlanFile,
    job: &Job,
    plan: &Plan,
    rules: &[RuleLine],
) -> Result<String, minijinja::Error> {
    let mut env = Environment::new();
    env.set_auto_escape_callback(|_| AutoEscape::Html);
    env.add_filter("mm3", |v: f64| mm3(v));
    env.add_filter("percent", |v: f64| format!("{:.1} %", 100.0 * v));
    env.add_filter("figure", |v: f64| format!("{v:.3}"));
    env.add_template("page", TEMPLATE)?;
    let s = &file.summary;
    env.get_template("page")?.render(context! {
        version => &file.hmplan_version,
        inputs => file
            .inputs
            .initial
            .iter()
            .map(|i| input("Initial", i))
            .chain([input("Target", &file.inputs.target)])
            .collect::<Vec<_>>(),
        grid => context! {
            pitch => file.grid.pitch,
            dims => file.grid.dims,
            voxels => thousands(file.grid.voxel_count()),
        },
        machine => &file.machine.name,
        tools => file.tools.iter().map(|t| t.name.clone()).collect::<Vec<_>>(),
        summary => Value::from(Serde(s)),
        rules => Value::from(Serde(rules)),
        steps => steps(file, job, plan),
        program => Value::from(Serde(&file.program)),
    })
}

fn input(role: &str, input: &Input) -> Value {
    context! {
        role,
        path => &input.path,
        triangles => thousands(input.triangles),
        watertight => input.watertight,
        volume => input.volume_mm3,
        warnings => &input.warnings,
        sha256 => &input.sha256,
    }
}

/// Steps drawn at most; of longer plans every n-th. All drawings together look at no more voxels
/// than this, a minute's work.
const MOST_DRAWN: usize = 200;
const MOST_DRAWN_VOXELS: usize = 1 << 29;

fn steps(file: &PlanFile, job: &Job, plan: &Plan) -> Vec<Value> {
    let drawings = drawings(job, plan);
    let row = |i: usize, step: &Step, drawing: &Drawing| {
        let (record, d) = (&file.steps[i], step.direction.vec());
        context! {
            index => record.index,
            kind => Value::from(Serde(step.kind)),
            tool => &step.tool,
            direction => format!("{:.3}, {:.3}, {:.3}", d.x + 0.0, d.y + 0.0, d.z + 0.0),
            holding => step.holding + 1,
            block => step.block + 1,
            volume => record.volume_mm3,
            voxels => thousands(record.voxels),
            minutes => record.time_s.map(|t| format!("{:.1}", t / 60.0)),
            plane => step.origin.plane.is_some(),
            view => drawing.view,
            svg => Value::from_safe_string(drawing.svg.clone()),
        }
    };
    plan.steps.iter().zip(&drawings).enumerate().map(|(i, (step, d))| row(i, step, d)).collect()
}

/// A drawing of each step, on what it leaves of the workpiece when it cuts, on what it finds when
/// it prints; empty for those left out.
fn drawings(job: &Job, plan: &Plan) -> Vec<Drawing> {
    let most = (MOST_DRAWN_VOXELS / job.frame.voxel_count().max(1)).clamp(1, MOST_DRAWN);
    let stride = plan.steps.len().div_ceil(most).max(1);
    let mut state = job.initial.clone();
    let mut shown = Vec::with_capacity(plan.steps.len());
    for (i, step) in plan.steps.iter().enumerate() {
        if step.kind == StepKind::Subtractive {
            state.subtract(&step.region);
        }
        let drawn = (i + 1) % stride == 0 || i + 1 == plan.steps.len();
        shown.push((step, drawn.then(|| state.clone())));
        if step.kind == StepKind::Additive {
            state.union_with(&step.region);
        }
    }
    let draw = |(step, state): (&Step, Option<BitGrid>)| match state {
        Some(state) => draw_step(&job.frame, &state, &step.region, step.kind, step.direction),
        None => Drawing::default(),
    };
    shown.into_par_iter().map(draw).collect()
}

/// A volume in mm³ as people read it: cm³ above a tenth of one, mm³ below.
pub fn mm3(v: f64) -> String {
    match v.abs() {
        a if a >= 100.0 => format!("{:.2} cm³", v / 1000.0),
        // A voxel of a fine grid is not nothing.
        a if a > 0.0 && a < 0.05 => format!("{v:.3} mm³"),
        _ => format!("{v:.1} mm³"),
    }
}

fn thousands(n: usize) -> String {
    let digits = n.to_string();
    let mut out = String::new();
    for (i, c) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push('\u{202f}');
        }
        out.push(c);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_read_well() {
        assert_eq!(thousands(1234567), "1\u{202f}234\u{202f}567");
        assert_eq!(thousands(12), "12");
        assert_eq!((mm3(12.34), mm3(5432.1)), ("12.3 mm³".into(), "5.43 cm³".into()));
    }
}
