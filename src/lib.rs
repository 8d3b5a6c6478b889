//! Plans hybrid additive–subtractive manufacturing: a worn part and a target part go in; out comes
//! a plan that reuses the old material, with every cut and every deposit checked, and the G-code
//! that makes it on a five-axis machine.
//!
//! Data flows one way through the modules, and a module imports only from those listed before it
//! (a test reads the sources and fails when an import points the other way):
//!
//! ```text
//! mesh → voxel → morph → region → job ─planner→ plan ─verify→ verified plan → toolpath → program → stream
//! ```
//!
//! Lengths are millimetres, angles radians unless a name ends in `_deg`; frames are right-handed,
//! z up, and the fabrication base is the plane z = 0.

pub mod base;
pub mod mesh;
pub mod voxel;
pub mod morph;
pub mod machine;
pub mod region;
pub mod access;
pub mod search;
pub mod plan;
pub mod planner;
pub mod verify;
pub mod toolpath;
pub mod gcode;
pub mod stream;
pub mod report;
