use super::kinematics::{AxisValues, Chain, Rotary, RotaryAngles};
use super::orient::Unreachable;
use super::placement::Placement;
use super::process::{Control, Extruder};
use super::travel::{NoPosture, Overtravel};
use super::{Tool, ToolKind, Workholding};
use crate::base::{DVec3, Direction, fibonacci_sphere};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Turn of the one rotary axis of a machine of four axes from a sampled direction to the next, degrees:
/// as close as those of five axes are. It divides a quarter.
const TURN_DEG: f64 = 5.0;

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
    /// those that always take part the others, tapered ones last: the order in which a planner tries
    /// them.
    pub fn tools_of(&self, kind: ToolKind) -> Vec<&Tool> {
        let mut tools: Vec<&Tool> = self.tools.iter().filter(|t| t.kind == kind).collect();
        let reach = |t: &Tool| t.reach(t.tip_radius());
        tools.sort_by(|a, b| {
            let rank = |t: &Tool| (t.taken, t.is_tapered());
            rank(a).cmp(&rank(b)).then(reach(a).total_cmp(&reach(b)))
        });
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

    /// Directions (workpiece frame) along which the tool can be pointed while the part is held with
    /// `up` away from the table: those of a lattice of `2 count` on the sphere that lie within the
    /// limits. With one rotary axis, all that a turn by 5° after the other gives; with
    /// none, the one there is.
    pub fn sampled(&self, up: Direction, count: usize) -> Vec<Direction> {
        let chain = &self.kinematics;
        if chain.rotary_axes().count() == 2 {
            let sphere = fibonacci_sphere(2 * count).into_iter();
            return sphere.filter(|d| self.can_point(up, *d)).collect();
        }
        let placement = Placement::turned(up);
        let steps = (360.0 / TURN_DEG) as i32;
        let allowed = |r: &Rotary, angle: f64| if r.is_absent() { 0.0 } else { angle };
        let mut found: Vec<Direction> = Vec::new();
        for step in 0..steps {
            let angle = (step - steps / 2) as f64 * TURN_DEG;
            let rotary = RotaryAngles {
                first_deg: allowed(&chain.first, angle),
                second_deg: allowed(&chain.second, angle),
            };
            let d = chain.indexed(&placement, rotary, 0.0).tip(DVec3::ZERO).1;
            let is_new = found.iter().all(|f| f.vec().distance(d.vec()) > 1e-9);
            if is_new && self.can_point(up, d) {
                found.push(d);
            }
        }
        found
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
