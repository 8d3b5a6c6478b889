use super::kinematics::{AxisValues, Chain, RotaryAngles};
use super::orient::Unreachable;
use super::placement::Placement;
use super::process::{Control, Extruder};
use super::travel::{NoPosture, Overtravel};
use super::{Tool, ToolKind, Workholding};
use crate::base::{DVec3, Direction};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A machine: what holds the part, which tools it has and how its axes move.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Machine {
    pub name: String,
    #[serde(default)]
    pub description: String,
    pub workholding: Workholding,
    pub kinematics: Chain,
    pub control: Control,
    /// Without one the machine only cuts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub extruder: Option<Extruder>,
    #[serde(rename = "tool", default)]
    pub tools: Vec<Tool>,
}

impl Machine {
    /// Tools of one kind, shortest reach first, equal reaches in the order of the file, after
    /// those that always take part the others: the order in which a planner tries them.
    pub fn tools_of(&self, kind: ToolKind) -> Vec<&Tool> {
        let mut tools: Vec<&Tool> = self.tools.iter().filter(|t| t.kind == kind).collect();
        let reach = |t: &Tool| t.reach(t.tip_radius());
        tools.sort_by(|a, b| a.taken.cmp(&b.taken).then(reach(a).total_cmp(&reach(b))));
        tools
    }

    /// The tool of this name in the machine's table.
    pub fn tool(&self, name: &str) -> Option<&Tool> {
        self.tools.iter().find(|t| t.name == name)
    }

    /// Whether the rotary axes can point the tool along `d` (workpiece frame) while the part is
    /// held with `up` away from the table.
    pub fn can_point(&self, up: Direction, d: Direction) -> bool {
        !self.kinematics.solutions(&Placement::turned(up), d).is_empty()
    }

    /// See [`Chain::solutions`].
    pub fn solutions(&self, placement: &Placement, d: Direction) -> Vec<RotaryAngles> {
        self.kinematics.solutions(placement, d)
    }

    /// See [`Chain::nearest`].
    pub fn nearest(
        &self,
        placement: &Placement,
        d: Direction,
        previous: RotaryAngles,
    ) -> Result<RotaryAngles, Unreachable> {
        self.kinematics.nearest(placement, d, previous)
    }

    /// See [`Chain::posture`]; the gauge length is the tool's.
    pub fn posture(
        &self,
        placement: &Placement,
        d: Direction,
        previous: RotaryAngles,
        tool: &Tool,
        tips: &[DVec3],
    ) -> Result<RotaryAngles, NoPosture> {
        self.kinematics.posture(placement, d, previous, tool.gauge_mm(), tips)
    }

    /// See [`Chain::axes`]; the gauge length is the tool's.
    pub fn axes(
        &self,
        placement: &Placement,
        rotary: RotaryAngles,
        tip: DVec3,
        tool: &Tool,
    ) -> AxisValues {
        self.kinematics.axes(placement, rotary, tip, tool.gauge_mm())
    }

    /// See [`Chain::tip`]; the gauge length is the tool's.
    pub fn tip(&self, placement: &Placement, axes: AxisValues, tool: &Tool) -> (DVec3, Direction) {
        self.kinematics.tip(placement, axes, tool.gauge_mm())
    }

    /// See [`Chain::check_travel`]; the gauge length is the tool's.
    pub fn check_travel(
        &self,
        placement: &Placement,
        rotary: RotaryAngles,
        tool: &Tool,
        tips: &[DVec3],
    ) -> Result<(), Overtravel> {
        self.kinematics.check_travel(placement, rotary, tool.gauge_mm(), tips)
    }
}
