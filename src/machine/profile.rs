use super::{Tool, ToolKind, Workholding};
use crate::base::Direction;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A machine: what holds the part, which tools it has and how its axes move.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Machine {
    pub name: String,
    pub workholding: Workholding,
    #[serde(rename = "tool", default)]
    pub tools: Vec<Tool>,
    /// Largest angle between the tool axis and the holding's up direction, degrees.
    pub max_tilt_deg: f64,
}

impl Machine {
    /// Tools of one kind, shortest reach first: the order in which a planner tries them.
    pub fn tools_of(&self, kind: ToolKind) -> Vec<&Tool> {
        let mut tools: Vec<&Tool> = self.tools.iter().filter(|t| t.kind == kind).collect();
        tools.sort_by(|a, b| a.reach(a.tip_radius()).total_cmp(&b.reach(b.tip_radius())));
        tools
    }

    /// Whether the rotary axes can point the tool along `d` (workpiece frame) while the part is
    /// held with `up` away from the table.
    pub fn can_point(&self, up: Direction, d: Direction) -> bool {
        // The lattice's own rounding must not decide a limit.
        const ROUNDING_DEG: f64 = 1e-6;
        up.dot(d.vec()).clamp(-1.0, 1.0).acos().to_degrees() <= self.max_tilt_deg + ROUNDING_DEG
    }
}
