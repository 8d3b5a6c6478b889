//! Sends programs to controllers, and says at any end what is known.
//!
//! Method: `preflight` looks at the whole program before the first byte; [`core`] is a state machine
//! without clock or I/O that counts what each device has been sent and not answered, waits for
//! motion where the program needs it, and stops in order; `session` moves bytes between it and the
//! ports; `journal` and `resume` let a stopped job go on. [`sim`] has simulated controllers.
//!
//! Guarantees: bytes written and not answered never exceed the window; nothing is written ahead of
//! a pause, a tool change or the extruder's codes; after an error, an alarm or a banner only what
//! stops the machine is written; a job is done only when every line is answered and the machine is
//! at rest; a peer that stops talking ends the job in bounded time. Lines with numbers and checksums
//! are run once each and in order, as far as a checksum of eight bits tells.
//!
//! Not guaranteed: grbl, grblHAL and plain boards have no checksum, so that a damaged block which is
//! still valid is seen only when the device repeats what it reads, or when its parser's state or a
//! position it reports departs from the program; a job that only those vouch for is not called
//! verified. Bytes already on the wire cannot be called back; an `ok` to an extruder's code proves no
//! extruder. Settings of the controller are not compared with the profile.
//!
//! Times are microseconds since the ports were opened, lengths mm, angles degrees.
//!
//! ```
//! use hmplan::machine::Machine;
//! use hmplan::stream::{Cleared, Dialect, Setting, preflight};
//!
//! let machine = Machine::builtin(Machine::DEFAULT)?;
//! let setting = Setting { machine: &machine, control: Dialect::Grbl, extruder: None };
//! let program = Cleared::unchecked(b"G21 (mm)\nG0 X1\nM30\n".to_vec());
//! let looked_at = preflight(&program, &setting).map_err(|f| f[0].to_string())?;
//! assert_eq!(looked_at.script.text(0), "G21");
//! let program = Cleared::unchecked(b"G0 X1 ?".to_vec());
//! assert!(preflight(&program, &setting).is_err());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod clearance;
mod codes;
pub mod core;
mod dialect;
mod dry;
mod journal;
mod modal;
mod outcome;
mod path;
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
pub use outcome::{Delivery, Ending, Means, Outcome, Position};
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
