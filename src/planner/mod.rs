//! The planners, one folder a paper, and the setup search before them.
//!
//! Guarantees: every planner returns a [`crate::plan::Plan`] whose steps it believes valid and
//! nothing it could not reach is hidden: the verifier measures what is missing. Not guaranteed:
//! validity itself; only [`crate::verify`] says so.

pub mod hybrid;
pub mod nullify;
pub mod reman;
pub mod setup;

use crate::base::Cancelled;

#[derive(Debug, thiserror::Error, PartialEq)]
pub enum PlanError {
    #[error("interrupted")]
    Cancelled,
    #[error(
        "the {which} part is empty on the grid: it has no voxel at pitch {pitch_mm} mm; set a finer --resolution or check the units"
    )]
    EmptyPart { which: &'static str, pitch_mm: f64 },
    #[error(
        "the setup search cannot measure the {which} part: it is empty, or thinner than the {pitch_mm} mm that it sees; \
         check the part, or give --setup keep"
    )]
    Unmeasurable { which: &'static str, pitch_mm: f64 },
    #[error(
        "an allowance of {finish_mm} mm for the finishing cut is thinner than a voxel of {pitch_mm} mm; give --finish \
         more, or a finer --resolution"
    )]
    ThinAllowance { finish_mm: f64, pitch_mm: f64 },
    #[error("no {kind} tool: the machine has none and none was named")]
    NoTool { kind: &'static str },
    #[error(transparent)]
    Nullify(#[from] nullify::NullifyError),
    #[error("the set cover of the clipping planes failed: {0}")]
    Cover(#[from] crate::search::CoverError),
}

impl From<Cancelled> for PlanError {
    fn from(_: Cancelled) -> Self {
        PlanError::Cancelled
    }
}
