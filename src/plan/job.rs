use crate::base::tolerance;
use crate::machine::{BaseKind, Holding, HoldingMode, Machine, Tool};
use crate::mesh::TriMesh;
use crate::voxel::{BitGrid, Frame};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The rules a plan is made under and judged by (all lengths mm).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Rules {
    pub holding: HoldingMode,
    pub base: BaseKind,
    /// Surface tolerance τ: unreached material this close to the reused volume is skin.
    pub tolerance_mm: f64,
    /// Height over the base plane that counts as base contact.
    pub grip_mm: f64,
    /// How much lower than its depth image allows the tip section of a nozzle may stand.
    pub nozzle_dip_mm: f64,
    /// Largest overhang from the build direction, degrees.
    pub overhang_deg: f64,
    /// Largest (excess + deficit − skin)/target volume at the end.
    pub deviation: f64,
}

impl Rules {
    /// The defaults for a grid of `pitch` mm and a nozzle layer of `layer_mm`.
    pub fn for_pitch(pitch_mm: f64, layer_mm: f64) -> Rules {
        Rules {
            holding: HoldingMode::Base,
            base: BaseKind::Pedestal,
            tolerance_mm: tolerance::surface_mm(pitch_mm),
            grip_mm: tolerance::grip_mm(pitch_mm),
            nozzle_dip_mm: tolerance::nozzle_dip_mm(pitch_mm, layer_mm),
            overhang_deg: tolerance::OVERHANG_DEG,
            deviation: tolerance::DEVIATION,
        }
    }
}

/// What is asked: two solids on one grid, a machine, its tools and the rules.
#[derive(Clone, Debug)]
pub struct Job {
    pub frame: Frame,
    /// M, empty when the target is planned from nothing.
    pub initial: BitGrid,
    /// M*.
    pub target: BitGrid,
    /// The meshes the solids came from, in plan coordinates (transforms applied).
    pub initial_mesh: TriMesh,
    pub target_mesh: TriMesh,
    pub machine: Machine,
    /// Tools a planner may use, in the order in which it tries them.
    pub cutters: Vec<Tool>,
    pub nozzles: Vec<Tool>,
    pub rules: Rules,
}

impl Job {
    /// The tool of this name, if the job has it.
    pub fn tool(&self, name: &str) -> Option<&Tool> {
        self.cutters.iter().chain(&self.nozzles).find(|t| t.name == name)
    }

    /// Ṽ_R = M ∩ M*.
    pub fn ideal_reuse(&self) -> BitGrid {
        self.initial.and(&self.target)
    }

    /// Base contact in the first holding: that of the target, which ends up standing on it whether
    /// it stood there from the beginning or was printed onto the bare base; of the initial part
    /// when the target has none. The pedestal is as wide as this and stays so through the whole
    /// plan.
    pub fn base_contact(&self) -> BitGrid {
        let of = |solid| Holding::AS_CLAMPED.contact(solid, &self.frame, self.rules.grip_mm);
        let contact = of(&self.target);
        if contact.is_empty() { of(&self.initial) } else { contact }
    }
}
