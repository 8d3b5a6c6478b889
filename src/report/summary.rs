use crate::plan::{End, Job, Plan, Seconds, StepKind, Summary};

/// What the verifier found, as it is reported.
#[derive(Clone, Debug, PartialEq)]
pub struct Judgement {
    pub passed: bool,
    pub failed_rules: Vec<String>,
    pub rules: Vec<RuleLine>,
    pub excess_mm3: f64,
    pub deficit_mm3: f64,
    pub skin_mm3: f64,
    pub residual_mm3: f64,
}

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
    pub notes: Vec<String>,
}

/// The figures of a plan. Volumes are voxel counts times the voxel volume, so that fractions of
/// the target's volume are exact on the grid; `deviation_relative` is excess and deficit together,
/// skin included.
pub fn summarise(
    job: &Job,
    plan: &Plan,
    end: &End,
    judgement: &Judgement,
    planner: PlannerFigures,
    seconds: Seconds,
) -> Summary {
    let voxel = job.frame.voxel_volume();
    let target = job.target.count();
    let fraction = |voxels: usize| voxels as f64 / target.max(1) as f64;
    let volume = |voxels: usize| voxels as f64 * voxel;
    let reused = end.reused.count();
    let target_volume_mm3 = volume(target);
    Summary {
        planner: planner.planner,
        verified: judgement.passed,
        failed_rules: judgement.failed_rules.clone(),
        target_volume_mm3,
        initial_volume_mm3: volume(job.initial.count()),
        removed_mm3: volume(end.removed.count()),
        added_mm3: volume(end.added.count()),
        reused_mm3: volume(reused),
        reuse_ideal: fraction(job.initial.count_and(&job.target)),
        reuse_initial: planner.reuse_initial,
        reuse_final: fraction(reused),
        base_height_ratio: planner.base_height_ratio,
        inaccessible_sm: planner.inaccessible_sm,
        inaccessible_am: planner.inaccessible_am,
        planes_global: planner.planes_global,
        planes_local: planner.planes_local,
        blocks_sm: blocks(plan, StepKind::Subtractive),
        blocks_am: blocks(plan, StepKind::Additive),
        switches: plan.steps.windows(2).filter(|w| w[0].kind != w[1].kind).count(),
        holdings: plan.holdings.len(),
        operations: None,
        support_voxels: None,
        cost: None,
        cost_lower_bound: None,
        states_expanded: None,
        excess_mm3: judgement.excess_mm3,
        deficit_mm3: judgement.deficit_mm3,
        deviation_relative: if target == 0 {
            0.0
        } else {
            (judgement.excess_mm3 + judgement.deficit_mm3) / target_volume_mm3
        },
        residual_mm3: judgement.residual_mm3,
        skin_mm3: judgement.skin_mm3,
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
