//! `hmplan verify DIR`: everything again from the files. The inputs are read by their digests and
//! voxelised on the recorded grid, the steps replayed and judged, the program checked, and every
//! figure that can be recomputed is compared with what the file claims.

use super::args::OutputArgs;
use super::exit::{Exit, Failure};
use super::inputs::{self, Part};
use super::output::{PLAN, PROGRAM};
use super::pipeline;
use super::plan::{context, digest, outcome};
use super::{print, summary};
use hmplan::base::Ctx;
use hmplan::machine::{Tool, ToolKind};
use hmplan::plan::{Input, Job, Plan, PlanFile, Schedule, Seconds, StepRecord, Summary};
use hmplan::report::{self, PlannerFigures, RuleLine};
use hmplan::verify::{verify, verify_operations};
use hmplan::voxel::BitGrid;
use std::fmt::Write as _;
use std::io::Read as _;
use std::path::{Path, PathBuf};

/// Bytes of the largest plan file or program read; ten times what the largest plans need.
const LARGEST_FILE: u64 = 1 << 30;

pub fn run(dir: &Path, schedule: Option<&Path>, output: &OutputArgs) -> Result<Exit, Failure> {
    let path = dir.join(PLAN);
    let bytes = read_bounded(&path)?;
    let in_file = |e: hmplan::plan::FileError| {
        let message = format!("{}: {e}", path.display());
        if e.is_alteration() { Failure::Altered(message) } else { Failure::Input(message) }
    };
    let file = PlanFile::from_json(&bytes).map_err(in_file)?;
    drop(bytes);
    let program = read_program(dir, &file)?;
    let ctx = context(output, None, file.seed)?;
    let plan = file.plan().map_err(in_file)?;
    let job = rebuild(dir, &file, &ctx)?;

    let scheduled = schedule.map(|path| schedule_rule(&job, path)).transpose()?;
    let verdict = verify(&job, plan, &ctx)?;
    let mut rules = report::rule_lines(&verdict);
    rules.extend(scheduled);
    match &program {
        Some(text) => rules.extend(pipeline::check_program(&job, &verdict.plan, text, &ctx)?),
        None => rules.extend(withheld(&file)),
    }
    let mut again = report::summarise(&job, &verdict, claimed(&file.summary), Seconds::default());
    again.take_rules(rules.iter().map(|r| (r.rule.as_str(), r.passed)));
    rules.push(file_rule(&file, &again, &verdict.plan, &job));
    again.take_rules(rules.iter().map(|r| (r.rule.as_str(), r.passed)));
    let location = report::residual_location(&job, &verdict);
    report(file, again, &rules, location.as_deref(), output)
}

/// Rule `schedule`: every operation of a schedule file obeys its rule at its moment, and the last
/// leaves the target.
fn schedule_rule(job: &Job, path: &Path) -> Result<RuleLine, Failure> {
    let said = |e: &dyn std::fmt::Display| Failure::Input(format!("{}: {e}", path.display()));
    let text = String::from_utf8(read_bounded(path)?).map_err(|e| said(&e))?;
    let Some(cutter) = job.cutters.first().filter(|t| Tool::is_voxel_sized(&t.name)) else {
        return Err(said(&"the plan has no inv-cutter, so no schedule is of it"));
    };
    // The half-space begins half a voxel below the L-th voxel.
    let length = (cutter.active_length() / job.frame.pitch + 0.5).round() as u32;
    let Some([initial, target]) = pair_in_box(job) else {
        return Err(said(&"the parts of the plan are empty"));
    };
    let schedule = Schedule::parse(&text, target.dims()).map_err(|e| said(&e))?;
    let operations = schedule.operations();
    let fault = verify_operations(&initial, &target, &operations, length).err();
    Ok(RuleLine {
        rule: "schedule".into(),
        passed: fault.is_none(),
        figure: fault
            .map_or(format!("all {} operations hold", operations.len()), |e| e.to_string()),
    })
}

/// Both solids in the box of the two, from the base plane up: the box a schedule counts in.
fn pair_in_box(job: &Job) -> Option<[BitGrid; 2]> {
    let (mut low, high) = job.initial.or(&job.target).extent()?;
    low[2] = (-job.frame.origin.z / job.frame.pitch).round().max(0.0) as usize;
    let dims = std::array::from_fn(|a| (high[a] + 1).saturating_sub(low[a]).max(1));
    let cut = |g: &BitGrid| {
        BitGrid::from_fn(dims, |v| g.get_or_empty(std::array::from_fn(|a| (v[a] + low[a]) as i64)))
    };
    Some([cut(&job.initial), cut(&job.target)])
}

/// The rules for which a plan says its program was kept back.
fn withheld(file: &PlanFile) -> Vec<RuleLine> {
    let of_program = |r: &&String| r.starts_with("program");
    let line = |rule: &String| RuleLine {
        rule: rule.clone(),
        passed: false,
        figure: "no program was written for this reason".into(),
    };
    file.summary.failed_rules.iter().filter(of_program).map(line).collect()
}

/// Prints the rules, or the recomputed summary as JSON, and gives the exit code.
fn report(
    mut file: PlanFile,
    again: Summary,
    rules: &[RuleLine],
    location: Option<&str>,
    output: &OutputArgs,
) -> Result<Exit, Failure> {
    let exit = outcome(&again);
    if !output.json && !output.quiet {
        let mut text = String::new();
        for r in rules {
            let word = if r.passed { "ok" } else { "FAILED" };
            // Writing into a String cannot fail.
            let _ = writeln!(text, "{word:<7} {:<24} {}", r.rule, r.figure);
        }
        print(text.as_bytes())?;
    }
    file.summary = again;
    summary::show(&file, rules, location, output)?;
    Ok(exit)
}

/// Reads a file whole, unless it is larger than any this program writes.
pub fn read_bounded(path: &Path) -> Result<Vec<u8>, Failure> {
    let unreadable =
        |e: std::io::Error| Failure::Input(format!("{} cannot be read ({e})", path.display()));
    let file = std::fs::File::open(path).map_err(unreadable)?;
    let mut bytes = Vec::new();
    file.take(LARGEST_FILE + 1).read_to_end(&mut bytes).map_err(unreadable)?;
    if bytes.len() as u64 > LARGEST_FILE {
        return Err(Failure::Input(format!(
            "{} is larger than {LARGEST_FILE} bytes, which no plan is",
            path.display()
        )));
    }
    Ok(bytes)
}

/// The program the plan names, its digest checked. A program that no plan names is an alteration
/// as well, since nobody vouches for it.
fn read_program(dir: &Path, file: &PlanFile) -> Result<Option<String>, Failure> {
    let path = dir.join(PROGRAM);
    let Some(record) = &file.program else {
        return if path.exists() {
            let path = path.display();
            Err(Failure::Altered(format!("{path} is there, but the plan records no program")))
        } else {
            Ok(None)
        };
    };
    if record.path != PROGRAM {
        return Err(Failure::Altered(format!(
            "the plan names the program '{}', not {PROGRAM}",
            record.path
        )));
    }
    let bytes = read_bounded(&path)?;
    if digest(&bytes) != record.sha256 {
        return Err(Failure::Altered(format!(
            "{} was altered: its SHA-256 is not the one in {PLAN}; plan again",
            path.display()
        )));
    }
    String::from_utf8(bytes)
        .map(Some)
        .map_err(|_| Failure::Altered(format!("{} is no text", path.display())))
}

/// The job the plan was made for, from its inputs.
fn rebuild(dir: &Path, file: &PlanFile, ctx: &Ctx) -> Result<Job, Failure> {
    let read = |input: &Input| -> Result<Part, Failure> {
        let recorded = Path::new(&input.path);
        let mut part = inputs::read(recorded, &locate(dir, recorded), input.mm_per_unit)?;
        if part.record.sha256 != input.sha256 {
            return Err(Failure::Altered(format!(
                "{} is not the part the plan was made for: its SHA-256 differs from the one in \
                 {PLAN}; restore the file or plan again",
                input.path
            )));
        }
        part.record.transform = input.transform;
        Ok(part)
    };
    let initial = file.inputs.initial.as_ref().map(read).transpose()?;
    let target = read(&file.inputs.target)?;
    let both = initial.iter().zip(&file.inputs.initial).chain([(&target, &file.inputs.target)]);
    for (now, recorded) in both.map(|(part, recorded)| (&part.record, recorded)) {
        if now != recorded {
            return Err(Failure::Altered(format!(
                "{}: what {PLAN} says of it (triangles, volume, warnings) is not what it has",
                recorded.path
            )));
        }
    }
    let initial_mesh = initial.as_ref().map(Part::placed).transpose()?;
    let target_mesh = target.placed()?;
    let pitch = Some(file.grid.pitch);
    // Made again rather than taken: a grid that misses a part, or is far larger, is no grid of
    // this plan.
    let spare_mm = file.command.finish_mm;
    let frame = inputs::frame(initial_mesh.as_ref(), &target_mesh, pitch, &file.tools, spare_mm)?;
    if frame != file.grid {
        return Err(Failure::Altered(format!(
            "the grid in {PLAN} is not the one its inputs and pitch make"
        )));
    }
    let of_kind = |kind| file.tools.iter().filter(|t| t.kind == kind).cloned().collect::<Vec<_>>();
    let solid = initial.as_ref().zip(initial_mesh.as_ref());
    let solid = solid.map(|(part, mesh)| inputs::solid(part, mesh, &frame, ctx)).transpose()?;
    Ok(Job {
        frame,
        initial: solid.unwrap_or_else(|| BitGrid::new(frame.dims)),
        target: inputs::solid(&target, &target_mesh, &frame, ctx)?,
        initial_mesh: initial_mesh.unwrap_or_default(),
        target_mesh,
        machine: file.machine.clone(),
        cutters: of_kind(ToolKind::Subtractive),
        nozzles: of_kind(ToolKind::Additive),
        rules: file.rules,
    })
}

/// A recorded path against the current directory, else against the plan's.
fn locate(dir: &Path, recorded: &Path) -> PathBuf {
    let beside = dir.join(recorded);
    if !recorded.exists() && beside.exists() { beside } else { recorded.to_path_buf() }
}

/// The figures that only the planner knows, taken from the file.
fn claimed(s: &Summary) -> PlannerFigures {
    PlannerFigures {
        planner: s.planner.clone(),
        reuse_initial: s.reuse_initial,
        base_height_ratio: s.base_height_ratio,
        inaccessible_sm: s.inaccessible_sm,
        inaccessible_am: s.inaccessible_am,
        planes_global: s.planes_global,
        planes_local: s.planes_local,
        operations: s.operations,
        support_voxels: s.support_voxels,
        cost: s.cost,
        cost_lower_bound: s.cost_lower_bound,
        states_expanded: s.states_expanded,
        notes: s.notes.clone(),
    }
}

/// Rule `file`: every figure of the file that the steps define is the one they define.
fn file_rule(file: &PlanFile, again: &Summary, plan: &Plan, job: &Job) -> RuleLine {
    let mut wrong = Vec::new();
    for (record, step) in file.steps.iter().zip(&plan.steps) {
        let voxels = step.region.count();
        compare_step(record, voxels, voxels as f64 * job.frame.voxel_volume(), &mut wrong);
    }
    let mut expected = again.clone();
    // Measured, not defined by the steps.
    expected.seconds = file.summary.seconds.clone();
    expected.peak_memory_mib = file.summary.peak_memory_mib;
    wrong.extend(differences(&expected, &file.summary));
    let figure = match wrong.first() {
        None => format!("{} steps and the summary agree with their regions", file.steps.len()),
        Some(first) => format!(
            "{first}{}",
            match wrong.len() - 1 {
                0 => String::new(),
                n => format!(" (and {n} more)"),
            }
        ),
    };
    RuleLine { rule: "file".into(), passed: wrong.is_empty(), figure }
}

fn compare_step(record: &StepRecord, voxels: usize, volume: f64, wrong: &mut Vec<String>) {
    if record.voxels != voxels {
        wrong.push(format!("step {}: {} voxels, not {}", record.index, voxels, record.voxels));
    } else if !close(record.volume_mm3, volume) {
        wrong.push(format!("step {}: {volume} mm³, not {}", record.index, record.volume_mm3));
    }
}

/// Names of the summary's fields that differ, with both values.
fn differences(expected: &Summary, found: &Summary) -> Vec<String> {
    let object = |s: &Summary| match serde_json::to_value(s) {
        Ok(serde_json::Value::Object(map)) => map,
        _ => serde_json::Map::new(),
    };
    let found = object(found);
    object(expected)
        .iter()
        .filter(|(name, value)| {
            !found.get(*name).is_some_and(|f| match (value.as_f64(), f.as_f64()) {
                (Some(a), Some(b)) => close(a, b),
                _ => *value == f,
            })
        })
        .map(|(name, value)| {
            let claimed = found.get(name).map_or("nothing".into(), ToString::to_string);
            format!("summary.{name}: the file claims {claimed}, the steps give {value}")
        })
        .collect()
}

/// Equal but for the last digits, which another machine's arithmetic may round differently.
fn close(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1e-9 * a.abs().max(b.abs())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_changed_figure_is_named() {
        let a = Summary { reused_mm3: 10.0, ..Summary::default() };
        assert!(differences(&a, &a).is_empty());
        let b = Summary { reused_mm3: 10.1, verified: true, ..a.clone() };
        let found = differences(&a, &b);
        assert_eq!(found.len(), 2);
        assert!(found.iter().any(|d| d.starts_with("summary.reused_mm3")), "{found:?}");
    }
}
