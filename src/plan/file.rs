//! The plan file: `plan.json`, schema [`SCHEMA`].
//!
//! What another program needs to repeat or judge a plan without asking anything else: inputs with
//! digests and transforms, the grid, machine, tools, rules, every step with its region, and the
//! figures the plan claims. Lengths mm, volumes mm³, times s.
//!
//! Guarantees: [`PlanFile::from_json`] and [`PlanFile::plan`] take any bytes without panic, and
//! with memory bounded by the size of the file and [`MOST_STATE_BITS`]; a region comes out only
//! when it fits the grid and its digest. Two runs on the same input write the same bytes but for
//! the measured times and memory, which [`PlanFile::canonical_without_timings`] leaves out.
//! Not guaranteed: that the plan is valid or its figures true; the verifier says so.

use super::{Origin, Plan, Rules, Step, StepKind};
use crate::base::{DAffine3, DMat3, DVec3, Direction};
use crate::machine::{Holding, InvalidTool, Machine, Tool, ToolKind};
use crate::voxel::{BitGrid, Frame, RunRows, RunsError};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Name and version of the layout. It changes when a field changes its meaning or goes.
pub const SCHEMA: &str = "hmplan-plan/1";

/// Largest length among the rules of a plan, mm: as large as a tool may be.
pub const MOST_RULE_MM: f64 = 1e4;

/// Bits that all regions of one plan may take together, each from its first row to its last: 4 GiB.
/// A plan of 8 million voxels may have 4,000 steps that span all layers, or 100,000 of some layers
/// each; a larger bound would let a few bytes of file claim all memory.
pub const MOST_STATE_BITS: u64 = 1 << 35;

/// Voxels of the largest grid, as [`Frame::around`] makes it.
const MOST_VOXELS: u64 = 1 << 31;

/// The whole file, in the order in which it is written.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PlanFile {
    /// Always "hmplan-plan/1".
    pub schema: String,
    pub hmplan_version: String,
    pub seed: u64,
    pub command: Command,
    pub inputs: Inputs,
    pub grid: Frame,
    pub machine: Machine,
    /// The tools the plan may use.
    pub tools: Vec<Tool>,
    pub rules: Rules,
    pub holdings: Vec<Holding>,
    pub steps: Vec<StepRecord>,
    /// The posted program; null when none was written.
    pub program: Option<ProgramRecord>,
    pub summary: Summary,
}

/// What was asked for, resolved. Thread count, output directory and verbosity are left out on
/// purpose: they do not change the plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Command {
    pub planner: String,
    /// "search" or "keep".
    pub setup: String,
    /// As asked for; null lets the program choose (`grid.pitch_mm`).
    pub resolution_mm: Option<f64>,
    pub iterations: usize,
    pub time_limit_s: Option<f64>,
    /// What planner search was told; absent for the others.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub search: Option<SearchCommand>,
    /// Whether a program is written for a plan that does not verify.
    pub post_unverified: bool,
    /// Allowance on what is printed that a finishing cut takes off, mm, by which the grid is wider;
    /// absent for none.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub finish_mm: f64,
}

fn is_zero(x: &f64) -> bool {
    *x == 0.0
}

/// Options of planner search.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SearchCommand {
    /// What removing a volume costs, adding it being 1.
    pub lambda: f64,
    pub weight: f64,
    pub delta: f64,
    pub most_steps: usize,
    /// Relative rotations a step: 7 or 24.
    pub rotations: usize,
    /// Overhang that carries itself, degrees.
    pub overhang_deg: f64,
    /// Costs of single tools by name.
    pub tool_costs: Vec<(String, f64)>,
    /// Whether the lower bound counts what must be sacrificed.
    pub tight_bound: bool,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Inputs {
    /// Null when the target is planned from an empty base.
    pub initial: Option<Input>,
    pub target: Input,
}

/// One part as it was read.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Input {
    /// As given on the command line.
    pub path: String,
    /// Of the file's bytes, lower-case hexadecimal.
    pub sha256: String,
    pub triangles: usize,
    pub watertight: bool,
    /// By the divergence theorem on the mesh; trust it only when the mesh is watertight.
    pub volume_mm3: f64,
    /// Millimetres of one unit of the file.
    pub mm_per_unit: f64,
    /// 4×4 matrix, row by row: plan coordinates = transform · part coordinates in mm.
    pub transform: [f64; 16],
    /// Defects of the mesh in words; empty when there are none.
    pub warnings: Vec<String>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct StepRecord {
    /// Counted from 1: step i leads from state i−1 to state i.
    pub index: usize,
    pub kind: StepKind,
    pub tool: String,
    /// From the workpiece toward the spindle, unit length, plan coordinates.
    #[schemars(with = "[f64; 3]")]
    pub direction: Direction,
    /// Index into `holdings`, counted from 0.
    pub holding: usize,
    pub volume_mm3: f64,
    pub voxels: usize,
    /// Counted from 0 within the kind.
    pub block: usize,
    pub origin: Origin,
    pub region: RunRows,
    /// Machining time of the step's toolpaths; null when none were made.
    pub time_s: Option<f64>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ProgramRecord {
    /// Relative to the plan file.
    pub path: String,
    pub sha256: String,
    pub lines: usize,
    /// Time on the machine, tool changes and indexing included, s.
    #[serde(default)]
    pub time_s: f64,
    /// What the extruder lays, mm³: beads, not the regions they fill.
    #[serde(default)]
    pub deposited_mm3: f64,
    /// What the edges sweep of the regions to remove, mm³.
    #[serde(default)]
    pub removed_mm3: f64,
}

/// The figures of a plan. A figure that another planner defines is null.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Summary {
    pub planner: String,
    pub verified: bool,
    pub failed_rules: Vec<String>,
    pub target_volume_mm3: f64,
    pub initial_volume_mm3: f64,
    pub removed_mm3: f64,
    pub added_mm3: f64,
    pub reused_mm3: f64,
    /// R_V: what the two parts share, as a fraction of the target volume.
    pub reuse_ideal: f64,
    /// R_I: reuse at the feasible start of the search, as a fraction of the target volume.
    pub reuse_initial: Option<f64>,
    /// R_F: what the plan reuses, as a fraction of the target volume.
    pub reuse_final: f64,
    /// B.
    pub base_height_ratio: Option<f64>,
    /// #P_S.
    pub inaccessible_sm: Option<usize>,
    /// #P_A.
    pub inaccessible_am: Option<usize>,
    /// #C_b.
    pub planes_global: Option<usize>,
    /// #C_a.
    pub planes_local: Option<usize>,
    /// #B_S.
    pub blocks_sm: usize,
    /// #B_A.
    pub blocks_am: usize,
    /// Changes between subtractive and additive along the steps.
    pub switches: usize,
    pub holdings: usize,
    pub operations: Option<usize>,
    pub support_voxels: Option<usize>,
    pub cost: Option<f64>,
    pub cost_lower_bound: Option<f64>,
    pub states_expanded: Option<usize>,
    pub excess_mm3: f64,
    pub deficit_mm3: f64,
    /// (excess + deficit − skin)/target volume.
    pub deviation_relative: f64,
    pub residual_mm3: f64,
    pub skin_mm3: f64,
    pub seconds: Seconds,
    /// Largest resident memory of the run; null where the system does not tell.
    pub peak_memory_mib: Option<f64>,
    /// What a reader of the plan should know, in words.
    #[serde(default)]
    pub notes: Vec<String>,
}

/// Measured seconds of the stages; null for a stage that did not run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Seconds {
    pub load: Option<f64>,
    pub voxelise: Option<f64>,
    pub setup: Option<f64>,
    pub graph: Option<f64>,
    pub set_cover: Option<f64>,
    pub search: Option<f64>,
    pub blocks: Option<f64>,
    pub toolpaths: Option<f64>,
    pub verify: Option<f64>,
    pub total: Option<f64>,
}

impl Summary {
    /// Takes over what every rule said, those of the program included.
    pub fn take_rules<'a>(&mut self, rules: impl IntoIterator<Item = (&'a str, bool)>) {
        let failed = rules.into_iter().filter(|(_, passed)| !passed);
        self.failed_rules = failed.map(|(rule, _)| rule.to_string()).collect();
        self.verified = self.failed_rules.is_empty();
    }
}

impl Seconds {
    /// Adds the time of a stage by its name in the file; false for a name the file does not have.
    pub fn add(&mut self, stage: &str, seconds: f64) -> bool {
        let slot = match stage {
            "load" => &mut self.load,
            "voxelise" => &mut self.voxelise,
            "setup" => &mut self.setup,
            "graph" => &mut self.graph,
            "set_cover" => &mut self.set_cover,
            "search" => &mut self.search,
            "blocks" => &mut self.blocks,
            "toolpaths" => &mut self.toolpaths,
            "verify" => &mut self.verify,
            "total" => &mut self.total,
            _ => return false,
        };
        // Milliseconds are more than a measured time can hold.
        *slot = Some(((slot.unwrap_or(0.0) + seconds) * 1000.0).round() / 1000.0);
        true
    }
}

/// Why a plan file is not taken.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    #[error("line {line}, column {column}: {what}; it was not written by hmplan, or was cut")]
    Json { line: usize, column: usize, what: String },
    #[error("its schema is '{found}', this version reads '{SCHEMA}'; plan again with this version")]
    Schema { found: String },
    #[error("its grid of {dims:?} voxels at pitch {pitch} mm is none this program makes")]
    Grid { dims: [usize; 3], pitch: f64 },
    #[error("{steps} steps on {voxels} voxels need more than {MOST_STATE_BITS} bits")]
    TooLarge { steps: usize, voxels: usize },
    #[error("step {step}: {what}")]
    Step { step: usize, what: String },
    #[error("step {step}: its region was altered ({source})")]
    Region { step: usize, source: RunsError },
    #[error("the transform of the {part} part is no rotation with a shift")]
    Transform { part: &'static str },
    #[error("the {part} part's mm_per_unit is {value}; it must be finite and above 0")]
    Scale { part: &'static str, value: f64 },
    #[error(transparent)]
    Tool(#[from] InvalidTool),
    #[error("its machine: {0}")]
    Machine(String),
    #[error("rules.{name} is {value}; it must be from 0 to {most}")]
    Rule { name: &'static str, value: f64, most: f64 },
    #[error("holding {holding}: its up direction is no grid axis, or its height is not finite")]
    Holding { holding: usize },
}

impl FileError {
    /// Whether the file is a plan file whose content was changed, rather than no plan file.
    pub fn is_alteration(&self) -> bool {
        matches!(self, FileError::Region { .. })
    }
}

impl PlanFile {
    /// Reads and checks everything but the regions, which [`PlanFile::plan`] unpacks.
    ///
    /// # Errors
    /// The first thing that is not as this program writes it.
    pub fn from_json(bytes: &[u8]) -> Result<PlanFile, FileError> {
        /// The schema alone, so that a file of another version is named as such.
        #[derive(Deserialize)]
        struct Head {
            schema: String,
        }
        let json = |e: serde_json::Error| FileError::Json {
            line: e.line(),
            column: e.column(),
            what: without_position(&e.to_string()),
        };
        let head: Head = serde_json::from_slice(bytes).map_err(json)?;
        if head.schema != SCHEMA {
            return Err(FileError::Schema { found: head.schema });
        }
        let file: PlanFile = serde_json::from_slice(bytes).map_err(json)?;
        file.check()?;
        Ok(file)
    }

    fn check(&self) -> Result<(), FileError> {
        self.check_grid()?;
        for tool in &self.tools {
            tool.validate()?;
        }
        self.check_machine()?;
        let initial = self.inputs.initial.iter().map(|i| ("initial", i));
        for (part, input) in initial.chain([("target", &self.inputs.target)]) {
            if !(input.mm_per_unit.is_finite() && input.mm_per_unit > 0.0) {
                return Err(FileError::Scale { part, value: input.mm_per_unit });
            }
            if input.plan_from_part().is_none() {
                return Err(FileError::Transform { part });
            }
        }
        let r = &self.rules;
        for (name, value, most) in [
            ("tolerance_mm", r.tolerance_mm, MOST_RULE_MM),
            ("grip_mm", r.grip_mm, MOST_RULE_MM),
            ("nozzle_dip_mm", r.nozzle_dip_mm, MOST_RULE_MM),
            ("overhang_deg", r.overhang_deg, 90.0),
            ("deviation", r.deviation, 1.0),
        ] {
            if !(0.0..=most).contains(&value) {
                return Err(FileError::Rule { name, value, most });
            }
        }
        for (holding, h) in self.holdings.iter().enumerate() {
            if !(h.up.is_grid_axis() && h.height_mm.is_finite()) {
                return Err(FileError::Holding { holding });
            }
        }
        self.steps.iter().enumerate().try_for_each(|(i, s)| self.check_step(i + 1, s))
    }

    /// Holds the machine against every check of a machine file.
    fn check_machine(&self) -> Result<(), FileError> {
        let text = toml::to_string(&self.machine).map_err(|e| FileError::Machine(e.to_string()))?;
        match Machine::parse("machine", &text) {
            Ok(_) => Ok(()),
            Err(e) => Err(FileError::Machine(e.to_string())),
        }
    }

    fn check_grid(&self) -> Result<(), FileError> {
        let Frame { pitch, dims, origin } = self.grid;
        let bad = FileError::Grid { dims, pitch };
        if !(pitch.is_finite() && pitch > 0.0 && origin.is_finite()) || dims.contains(&0) {
            return Err(bad);
        }
        let voxels = dims.iter().try_fold(1usize, |n, d| n.checked_mul(*d));
        let Some(voxels) = voxels.filter(|n| *n as u64 <= MOST_VOXELS) else {
            return Err(bad);
        };
        // Rows are padded to whole words, so a thin grid takes more than its voxels.
        let row_bits = dims[0].div_ceil(64) as u64 * 64;
        let rows = |s: &StepRecord| s.region.span(dims).len() as u64;
        let bits = self.steps.iter().map(|s| rows(s) * row_bits).fold(0, u64::saturating_add);
        if bits > MOST_STATE_BITS {
            return Err(FileError::TooLarge { steps: self.steps.len(), voxels });
        }
        Ok(())
    }

    fn check_step(&self, step: usize, s: &StepRecord) -> Result<(), FileError> {
        let bad = |what| Err(FileError::Step { step, what });
        if s.index != step {
            return bad(format!("its index is {}", s.index));
        }
        if s.holding >= self.holdings.len() {
            let n = self.holdings.len();
            return bad(format!("it names holding {} of {n}", s.holding));
        }
        let kind = match s.kind {
            StepKind::Subtractive => ToolKind::Subtractive,
            StepKind::Additive => ToolKind::Additive,
        };
        if !self.tools.iter().any(|t| t.name == s.tool && t.kind == kind) {
            return bad(format!("no tool of its kind is named '{}'", s.tool));
        }
        Ok(())
    }

    /// The plan itself, each region unpacked and held against its digest.
    ///
    /// # Errors
    /// [`FileError::Region`] naming the first step whose rows or digest were changed.
    pub fn plan(&self) -> Result<Plan, FileError> {
        let mut steps = Vec::with_capacity(self.steps.len());
        for s in &self.steps {
            let region = self.region(s)?;
            steps.push(Step {
                kind: s.kind,
                tool: s.tool.clone(),
                direction: s.direction,
                holding: s.holding,
                region,
                block: s.block,
                origin: s.origin,
            });
        }
        Ok(Plan { holdings: self.holdings.clone(), steps })
    }

    fn region(&self, s: &StepRecord) -> Result<BitGrid, FileError> {
        s.region
            .to_grid(self.grid.dims)
            .map_err(|source| FileError::Region { step: s.index, source })
    }

    /// The records of a plan's steps on a grid; `time_s` holds a time for each step, or nothing.
    pub fn step_records(plan: &Plan, grid: &Frame, time_s: &[f64]) -> Vec<StepRecord> {
        let record = |(i, s): (usize, &Step)| {
            let voxels = s.region.count();
            StepRecord {
                index: i + 1,
                kind: s.kind,
                tool: s.tool.clone(),
                direction: s.direction,
                holding: s.holding,
                volume_mm3: voxels as f64 * grid.voxel_volume(),
                voxels,
                block: s.block,
                origin: s.origin,
                region: RunRows::from_grid(&s.region),
                time_s: time_s.get(i).copied(),
            }
        };
        plan.steps.iter().enumerate().map(record).collect()
    }

    /// The file's bytes: indented where a person reads, one line for each region.
    pub fn to_json(&self) -> Vec<u8> {
        super::layout::to_json(self)
    }

    /// The file's bytes with every measured time and the memory set to null: equal for equal
    /// input, whatever the machine and its load.
    pub fn canonical_without_timings(&self) -> Vec<u8> {
        let mut copy = self.clone();
        copy.summary.seconds = Seconds::default();
        copy.summary.peak_memory_mib = None;
        copy.to_json()
    }
}

impl Input {
    /// The transform, if it is a rigid motion (a rotation and a shift).
    pub fn plan_from_part(&self) -> Option<DAffine3> {
        // Rounding of a product of rotations stays far below; a scale or shear does not.
        const ROUNDING: f64 = 1e-9;
        let t = &self.transform;
        let row = |i: usize| DVec3::new(t[4 * i], t[4 * i + 1], t[4 * i + 2]);
        let shift = DVec3::new(t[3], t[7], t[11]);
        let m = DMat3::from_cols(row(0), row(1), row(2)).transpose();
        let off = m * m.transpose() - DMat3::IDENTITY;
        let rigid = m.is_finite()
            && shift.is_finite()
            && off.to_cols_array().iter().all(|c| c.abs() < ROUNDING)
            && m.determinant() > 0.0
            && t[12..] == [0.0, 0.0, 0.0, 1.0];
        rigid.then(|| DAffine3::from_mat3_translation(m, shift))
    }

    /// The sixteen figures of a transform, row by row.
    pub fn rows_of(plan_from_part: &DAffine3) -> [f64; 16] {
        let m = plan_from_part.matrix3;
        let t = plan_from_part.translation;
        let row = |i: usize| [m.x_axis[i], m.y_axis[i], m.z_axis[i], t[i]];
        let mut rows = [0.0; 16];
        for i in 0..3 {
            rows[4 * i..4 * i + 4].copy_from_slice(&row(i));
        }
        rows[15] = 1.0;
        rows
    }
}

/// serde_json's message without the " at line … column …" it ends in.
fn without_position(message: &str) -> String {
    message.rsplit_once(" at line ").map_or(message, |(what, _)| what).to_string()
}

#[cfg(test)]
#[path = "file_tests.rs"]
mod tests;
