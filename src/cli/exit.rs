//! Exit codes, one table, and what fails a run.

use std::fmt;
use std::path::Path;

/// The table of exit codes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Exit {
    /// Done and verified.
    Done = 0,
    /// Bad usage or bad input.
    Input = 1,
    /// A plan was written but does not verify or leaves a residual.
    Unverified = 2,
    /// I/O or controller failure.
    Io = 3,
    /// Stopped by the user.
    Interrupted = 130,
}

/// Why a subcommand stopped without a result; the message says what, where and how to mend.
#[derive(Debug)]
pub enum Failure {
    Input(String),
    /// A plan or program that was changed after it was written.
    Altered(String),
    Io(String),
    Interrupted,
}

impl Failure {
    pub fn exit(&self) -> Exit {
        match self {
            Failure::Input(_) => Exit::Input,
            Failure::Altered(_) => Exit::Unverified,
            Failure::Io(_) => Exit::Io,
            Failure::Interrupted => Exit::Interrupted,
        }
    }

    pub fn input(what: impl fmt::Display) -> Failure {
        Failure::Input(what.to_string())
    }

    /// A file that could not be written.
    pub fn writing(path: &Path, error: &std::io::Error) -> Failure {
        Failure::Io(format!(
            "{} cannot be written ({error}); check permissions and free space",
            path.display()
        ))
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Failure::Input(what) | Failure::Altered(what) | Failure::Io(what) => f.write_str(what),
            Failure::Interrupted => f.write_str("interrupted; nothing was changed"),
        }
    }
}

impl From<hmplan::base::Cancelled> for Failure {
    fn from(_: hmplan::base::Cancelled) -> Failure {
        Failure::Interrupted
    }
}
