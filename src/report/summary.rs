use super::place::in_words;
use crate::plan::{Job, Plan, Seconds, StepKind, Summary};
use crate::verify::{Rule, Verdict};

/// One rule and its figure.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct RuleLine {
    pub rule: String,
    pub passed: bool,
    /// The figure that decided it, in words.
    pub figure: String,
}

/// What only the planner knows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlannerFigures {
    pub planner: String,
    pub reuse_initial: Option<f64>,
    pub base_height_ratio: Option<f64>,
    pub inaccessible_sm: Option<usize>,
    pub inaccessible_am: Option<usize>,
    pub planes_global: Option<usize>,
    pub planes_local: Option<usize>,
    pub operations: Option<usize>,
    pub support_voxels: Option<usize>,
    pub cost: Option<f64>,
    pub cost_lower_bound: Option<f64>,
    pub states_expanded: Option<usize>,
    pub notes: Vec<String>,
}

/// One line a rule, in the order of `docs/RULES.md`.
pub fn rule_lines(verdict: &Verdict) -> Vec<RuleLine> {
    Rule::ALL
        .into_iter()
        .zip(verdict.lines())
        .map(|(rule, line)| {
            let passed = !verdict.rules.iter().any(|r| r.rule == rule && !r.passed);
            let figure = line.trim_start_matches(rule.name()).trim_start();
            let figure = figure.trim_start_matches(if passed { "ok" } else { "FAILED" });
            RuleLine { rule: rule.name().into(), passed, figure: figure.trim().into() }
        })
        .collect()
}

/// Where the largest lump of the residual lies in the target, in words; none without a residual.
pub fn residual_location(job: &Job, verdict: &Verdict) -> Option<String> {
    let residual = &verdict.measures.residual;
    let lumps = [("excess", &residual.excess_place), ("missing", &residual.deficit_place)];
    let (what, lump) = lumps
        .into_iter()
        .filter_map(|(what, place)| {
            let place = place.as_ref()?;
            Some((what, place.largest.as_deref().unwrap_or(place)))
        })
        .max_by_key(|(_, lump)| lump.voxels)?;
    Some(format!(
        "{:.1} mm³ {what} at the {}",
        lump.volume_mm3,
        in_words(lump.centroid, &job.target_mesh.bounds())
    ))
}

/// The figures of a plan and its verdict. Volumes are voxel counts times the voxel volume, so that
/// fractions of the target's volume are exact on the grid.
pub fn summarise(
    job: &Job,
    verdict: &Verdict,
    planner: PlannerFigures,
    seconds: Seconds,
) -> Summary {
    let (plan, m) = (&verdict.plan, &verdict.measures);
    let target = job.target.count();
    let voxel = job.frame.voxel_volume();
    Summary {
        planner: planner.planner,
        verified: verdict.passed(),
        failed_rules: verdict.failed_rules().into_iter().map(String::from).collect(),
        target_volume_mm3: m.target_mm3,
        initial_volume_mm3: job.initial.count() as f64 * voxel,
        removed_mm3: m.removed_mm3,
        added_mm3: m.added_mm3,
        reused_mm3: m.reused_mm3,
        reuse_ideal: job.initial.count_and(&job.target) as f64 / target.max(1) as f64,
        reuse_initial: planner.reuse_initial,
        reuse_final: m.reused_mm3 / m.target_mm3,
        base_height_ratio: planner.base_height_ratio,
        inaccessible_sm: planner.inaccessible_sm,
        inaccessible_am: planner.inaccessible_am,
        planes_global: planner.planes_global,
        planes_local: planner.planes_local,
        blocks_sm: blocks(plan, StepKind::Subtractive),
        blocks_am: blocks(plan, StepKind::Additive),
        switches: plan.steps.windows(2).filter(|w| w[0].kind != w[1].kind).count(),
        holdings: plan.holdings.len(),
        operations: planner.operations,
        support_voxels: planner.support_voxels,
        cost: planner.cost,
        cost_lower_bound: planner.cost_lower_bound,
        states_expanded: planner.states_expanded,
        excess_mm3: m.excess_mm3,
        deficit_mm3: m.deficit_mm3,
        deviation_relative: m.deviation_relative,
        residual_mm3: m.residual_mm3,
        skin_mm3: m.skin_mm3,
        seconds,
        peak_memory_mib: None,
        notes: planner.notes,
    }
}

/// Positional blocks of one kind that have steps.
fn blocks(plan: &Plan, kind: StepKind) -> usize {
    let mut blocks: Vec<usize> =
        plan.steps.iter().filter(|s| s.kind == kind).map(|s| s.block).collect();
    blocks.sort_unstable();
    blocks.dedup();
    blocks.len()
}
