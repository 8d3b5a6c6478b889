//! Tools, machines and what holds the part.
//!
//! A tool T = K ∪ H has an active part K (cutter edge, bead) and a passive part H (shank, holder,
//! head); HB Sec. 3.1. Heights are mm above the tip, radii mm from the axis. What holds the part
//! never moves: a pedestal as wide as the base contact of what stays, a finite table under it.
//! A machine's [`Chain`] turns directions into rotary angles and tips into axis values.
//!
//! Guarantees: a loaded [`Tool`] or [`Machine`] has finite figures in range. Not guaranteed: that
//! a direction or a position can be reached; ask the machine's kinematic chain.

mod file;
mod kinematics;
mod orient;
mod placement;
mod presets;
mod process;
mod profile;
mod section;
mod tool;
mod travel;
mod workholding;

pub use file::{LARGEST_FILE, ProfileError};
pub use kinematics::{AxisValues, Chain, Linear, Mount, Rotary, RotaryAngles};
pub use orient::Unreachable;
pub use placement::Placement;
pub use presets::INV_LENGTH_VOXELS;
pub use process::{Control, Extruder, ExtruderPort, Process};
pub use profile::Machine;
pub use tool::{InvalidTool, Section, Shape, Tool, ToolKind};
pub use travel::{NoPosture, Overtravel};
pub use workholding::{BaseKind, Holding, HoldingMode, Table, Workholding};
