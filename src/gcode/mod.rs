//! Programs: written for a machine, read back, run forward and judged.
//!
//! Method: `post` turns paths into 3+2 blocks (rotary axes are indexed at the parking height, then
//! only linear axes move); `check` parses the text with a reader of its own, runs it through the
//! machine's kinematics and holds every sampled tool position against the plan's voxel states.
//!
//! Guarantees: the same paths give the same bytes; a [`Checked`] program broke no [`Rule`], and
//! only [`check_program`] makes one. Not guaranteed: that a control's own settings match
//! the profile (tool lengths, G54 at zero); the way of the tool while rotary axes turn, beyond
//! that it stands parked; helices, which are neither written nor read.

mod arcs;
mod beads;
mod check;
mod deviation;
mod dialect;
mod interpret;
mod module;
mod post;
mod program;
mod reach;
mod report;
mod skyline;
mod standing;
mod sweep;
#[cfg(test)]
mod dialect_tests;
#[cfg(test)]
mod mutation_tests;
#[cfg(test)]
mod tests;
mod words;

pub use beads::{LEAST_FILLED, MOST_FILLED};
pub use check::{check, check_program};
pub use deviation::{Deviation, Facet, Gouge, deviation};
pub use dialect::{Comments, Dialect, Dwell, Extrusion, RS274};
pub use post::{PostError, post};
pub use program::{Checked, Program};
pub use report::{CheckReport, Finding, Rule, StepFigures};
pub use sweep::LEAST_SWEPT;
pub use words::{BadBlock, LONGEST, Word, read as read_block};
