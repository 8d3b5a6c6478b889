//! What allows a program to be sent.
//!
//! A program is cleared by the plan that records it, verified and with the program's digest, by
//! having been checked in this process, or by someone saying in so many words that it may go
//! unchecked. There is no fourth way: only a [`Cleared`] program passes [`super::preflight`].

use super::Fault;
use super::dry::raised;
use crate::gcode::{Checked, Program};
use crate::machine::Machine;
use crate::plan::PlanFile;
use sha2::{Digest as _, Sha256};

/// How a program was cleared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ground {
    /// A verified plan records these very bytes.
    Plan,
    /// Checked in this process.
    Check,
    /// Someone takes the blame.
    Unchecked,
}

/// A program that may be sent.
#[derive(Clone, Debug, PartialEq)]
pub struct Cleared {
    text: Vec<u8>,
    sha256: String,
    ground: Ground,
}

/// Why a plan does not vouch for a program.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NotVouched {
    #[error("its plan did not verify")]
    NotVerified,
    #[error("its plan records no program")]
    NoProgram,
    #[error("it is not the program its plan records: the SHA-256 differs")]
    OtherProgram,
}

/// SHA-256 of bytes, in hexadecimal.
pub fn digest(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|b| format!("{b:02x}")).collect()
}

impl Cleared {
    /// Cleared by the plan that records it.
    ///
    /// # Errors
    /// Why the plan does not vouch for it; the bytes are handed back.
    pub fn by_plan(text: Vec<u8>, plan: &PlanFile) -> Result<Cleared, (NotVouched, Vec<u8>)> {
        let sha256 = digest(&text);
        let why = match &plan.program {
            _ if !plan.summary.verified => NotVouched::NotVerified,
            None => NotVouched::NoProgram,
            Some(p) if p.sha256 != sha256 => NotVouched::OtherProgram,
            Some(_) => return Ok(Cleared { text, sha256, ground: Ground::Plan }),
        };
        Err((why, text))
    }

    /// Cleared by the check of this process.
    pub fn by_check(program: Checked<Program>) -> Cleared {
        let text = program.into_inner().text().as_bytes().to_vec();
        Cleared { sha256: digest(&text), text, ground: Ground::Check }
    }

    /// Sent although nothing vouches for it.
    pub fn unchecked(text: Vec<u8>) -> Cleared {
        Cleared { sha256: digest(&text), text, ground: Ground::Unchecked }
    }

    /// The same for a run in the air; Z raised, no extrusion.
    ///
    /// # Errors
    /// What cannot be raised.
    pub fn raised(&self, raise_mm: f64, machine: &Machine) -> Result<Cleared, Fault> {
        let text = raised(&self.text, raise_mm, machine)?;
        Ok(Cleared { text, sha256: self.sha256.clone(), ground: self.ground })
    }

    pub fn text(&self) -> &[u8] {
        &self.text
    }

    /// SHA-256 of the text, hexadecimal.
    pub fn sha256(&self) -> &str {
        &self.sha256
    }

    pub fn ground(&self) -> Ground {
        self.ground
    }
}
