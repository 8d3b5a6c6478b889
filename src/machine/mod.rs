//! Tools, machines and what holds the part.
//!
//! A tool T = K ∪ H has an active part K (cutter edge, bead) and a passive part H (shank, holder,
//! head); HB Sec. 3.1. Heights are mm above the tip, radii mm from the axis. What holds the part
//! never moves: a pedestal as wide as the base contact of what stays, a finite table under it.
//! A machine's [`Chain`] turns directions into rotary angles and tips into axis values.
//!
//! Tools are round about their axis; a section that is drawn as a mesh stands for what it sweeps
//! (`revolved`).
//!
//! Guarantees: a loaded [`Tool`] or [`Machine`] has finite figures in range. Not guaranteed: that
//! a direction or a position can be reached; ask the machine's kinematic chain.
//!
//! ```
//! use hmplan::base::{DVec3, Direction};
//! use hmplan::machine::{Holding, Machine};
//!
//! let machine = Machine::builtin(Machine::DEFAULT)?;
//! let tool = machine.tool("ball-3x30").ok_or("no such tool")?;
//! let placement = machine.placement(&Holding::AS_CLAMPED, DVec3::ZERO);
//! let tips = [DVec3::new(0.0, 0.0, 20.0), DVec3::new(10.0, 0.0, 20.0)];
//! let home = machine.kinematics.home();
//! let rotary = machine.posture(&placement, Direction::X, home, tool, &tips)?;
//! let axes = machine.axes(&placement, rotary, tips[0], tool);
//! let (tip, direction) = machine.tip(&placement, axes, tool);
//! assert!((tip - tips[0]).length() < 1e-9 && direction.dot(DVec3::X) > 1.0 - 1e-12);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod check;
mod describe;
mod file;
mod joints;
mod kinematics;
mod orient;
mod place;
mod placement;
mod presets;
mod process;
mod profile;
mod revolved;
mod section;
mod tool;
mod travel;
mod workholding;

pub use check::check;
pub use describe::{describe, describe_tool};
pub use file::{LARGEST_FILE, ProfileError, ToolFile};
pub use joints::Linear;
pub use kinematics::{AxisValues, Chain, Indexed, Mount, Rotary, RotaryAngles};
pub use orient::Unreachable;
pub use place::Place;
pub use placement::Placement;
pub use presets::INV_LENGTH_VOXELS;
pub use process::{Control, Extruder, ExtruderPort, Pattern, Process, Seam, Writing};
pub use profile::Machine;
pub use tool::{InvalidTool, Section, Shape, Taken, Tool, ToolKind, VOXELS_PER_RADIUS};
pub use travel::{NoPosture, Overtravel};
pub use workholding::{BaseKind, Holding, HoldingMode, Table, Workholding};
