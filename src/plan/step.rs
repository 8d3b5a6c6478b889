use crate::base::{DVec3, Direction};
use crate::machine::Holding;
use crate::voxel::BitGrid;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum StepKind {
    Subtractive,
    Additive,
}

/// The four actions of HB Sec. 4.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Action {
    OC,
    UC,
    UF,
    OF,
}

/// The half-space normal · x > offset (mm).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Plane {
    #[schemars(with = "[f64; 3]")]
    pub normal: Direction,
    /// mm; earlier files call it `offset_mm`.
    #[serde(alias = "offset_mm")]
    pub offset: f64,
}

impl Plane {
    /// Signed distance of a point, positive on the side the plane cuts away, mm.
    pub fn distance(&self, p: DVec3) -> f64 {
        self.normal.dot(p) - self.offset
    }
}

/// Where a step came from; planner specific.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Origin {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub plane: Option<Plane>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub action: Option<Action>,
}

/// One step: a region removed from, or added to, the state before it.
#[derive(Clone, Debug, PartialEq)]
pub struct Step {
    pub kind: StepKind,
    pub tool: String,
    /// From the workpiece toward the spindle.
    pub direction: Direction,
    /// Index into [`Plan::holdings`].
    pub holding: usize,
    pub region: BitGrid,
    /// Positional block this step belongs to, counted from 0 within its kind.
    pub block: usize,
    pub origin: Origin,
}

/// What a planner emits. It says nothing about validity.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    pub holdings: Vec<Holding>,
    pub steps: Vec<Step>,
}
