//! Sends programs to controllers.

mod codes;
pub mod core;
mod dialect;
mod modal;
mod outcome;
mod preflight;
mod reply;
mod script;
pub mod sim;

pub use dialect::Dialect;
pub use modal::{Modal, Module, Rates, Spindle, Way};
pub use outcome::{Ending, Outcome, Position};
pub use preflight::{Fault, Preflight, Setting, preflight};
pub use reply::{Lines, Reply, State, Status};
pub use script::{Class, Line, ModuleCode, Script};

#[cfg(test)]
mod fault_tests;
#[cfg(test)]
mod world_tests;
