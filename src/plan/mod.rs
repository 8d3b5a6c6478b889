//! The job (what is asked), the plan (what is answered), and the plan file.
//!
//! A plan is a list of steps; step i turns the state P_{i−1} into P_i by removing or adding a
//! region with one tool from one direction in one holding. Every planner emits this one type and
//! one independent verifier judges it.
//!
//! Guarantees: a [`Plan`] read from a file has regions that fit its grid and match their digests.
//! Not guaranteed: that it is valid; only the verifier can say so.

mod file;
mod job;
mod layout;
mod operation;
mod schedule;
mod state;
mod step;

pub use file::{
    Command, FileError, Input, Inputs, MOST_RULE_MM, MOST_STATE_BITS, PlanFile, ProgramRecord,
    SCHEMA, SearchCommand, Seconds, StepRecord, Summary,
};
pub use job::{Job, Rules};
pub use operation::{Deed, Operation, Orientation};
pub use schedule::{Schedule, ScheduleError};
pub use state::{End, end_state};
pub use step::{Action, Origin, Plan, Plane, Step, StepKind};
