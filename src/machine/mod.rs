//! Tools, machines and what holds the part.
//!
//! A tool T = K ∪ H has an active part K (cutter edge, bead) and a passive part H (shank, holder,
//! head); HB Sec. 3.1. Heights are mm above the tip, radii mm from the axis. What holds the part
//! never moves: a pedestal as wide as the base contact of what stays, a finite table under it.
//!
//! Guarantees: a loaded [`Tool`] has finite, positive figures. Not guaranteed: that a
//! direction can be reached; ask the machine's kinematic chain.

mod profile;
mod tool;
mod workholding;

pub use profile::Machine;
pub use tool::{InvalidTool, Section, Shape, Tool, ToolKind};
pub use workholding::{BaseKind, Holding, HoldingMode, Table, Workholding};
