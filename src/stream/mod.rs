//! Sends programs to controllers.

mod clearance;
mod codes;
pub mod core;
mod dialect;
mod dry;
mod journal;
mod modal;
mod outcome;
mod preflight;
mod reply;
mod resume;
mod script;
mod session;
pub mod sim;
mod transport;

pub use clearance::{Cleared, Ground, NotVouched, digest};
pub use dialect::Dialect;
pub use journal::{Counts, Entry, Journal, Last, last};
pub use modal::{Modal, Module, Rates, Spindle, Way};
pub use outcome::{Ending, Outcome, Position};
pub use preflight::{Fault, Preflight, Setting, preflight};
pub use reply::{Lines, Reply, State, Status};
pub use resume::{Refusal, Resumed, Said, resume};
pub use script::{Class, Line, ModuleCode, Script};
pub use session::{Observer, Remote, Session};
pub use transport::{PATIENCE, Port, PortError, Reader, Writer, dialect_of, list, open};

#[cfg(test)]
mod fault_tests;
#[cfg(test)]
mod world_tests;
