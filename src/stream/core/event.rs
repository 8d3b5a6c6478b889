//! What goes into the core and what comes out of it.

use crate::stream::{Delivery, Dialect, Script, Status};
use std::sync::Arc;

/// Virtual time, microseconds since the ports were opened.
pub type Micros = u64;

/// One second.
pub const SECOND: Micros = 1_000_000;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Device {
    Control,
    Extruder,
}

impl Device {
    pub const BOTH: [Device; 2] = [Device::Control, Device::Extruder];

    pub fn index(self) -> usize {
        self as usize
    }
}

impl std::fmt::Display for Device {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(match self {
            Device::Control => "controller",
            Device::Extruder => "extruder",
        })
    }
}

/// What a person asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    Hold,
    Resume,
    /// The first stops in an orderly way, the second resets at once, the third leaves.
    Stop,
    /// A realtime byte that sets an override.
    Override(u8),
}

#[derive(Clone, Copy, Debug)]
pub enum Event<'a> {
    /// Time has come as far as the call says.
    Tick,
    Received(Device, &'a [u8]),
    HungUp(Device),
    Command(Command),
}

#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    /// Behind everything already queued.
    Write(Device, Vec<u8>),
    /// Ahead of everything queued.
    Realtime(Device, u8),
    /// Drop what is queued and not yet written.
    Discard(Device),
    Note(Note),
}

/// What a person, a log or a journal wants to know.
#[derive(Clone, Debug, PartialEq)]
pub enum Note {
    Began,
    /// Lines written so far.
    Written(usize),
    /// Lines answered so far.
    Confirmed(usize),
    /// Lines whose motion is over.
    Settled(usize),
    Status(Box<Status>),
    /// The program or the machine waits for a person, at this line of the file.
    Waits {
        number: u32,
        why: &'static str,
    },
    GoesOn,
    /// A numbered line is written again.
    Again {
        number: u32,
    },
    /// Every line was run; what vouches for them.
    Delivery(Delivery),
    /// A stop began.
    Stopping(String),
    Said {
        device: Device,
        text: String,
    },
    Warning(String),
}

/// How long the core waits for what, and how often it asks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// For a banner after opening: a boot loader takes about 2 s. Too short, and the first lines
    /// are lost in it.
    pub banner: Micros,
    /// Without any byte from a device that should talk. Too short, and a long memory write counts
    /// as a stall; too long, and a stall goes on unnoticed.
    pub silence: Micros,
    /// For an answer from a device that talks only when asked, besides the time its motions take.
    pub answer: Micros,
    /// Between status requests; controllers ask for no more than five a second.
    pub poll: Micros,
    /// For a hold to come to rest.
    pub hold: Micros,
    /// For a reset controller to come back.
    pub reset: Micros,
    /// For each line that switches something off.
    pub off: Micros,
}

impl Default for Limits {
    fn default() -> Self {
        Limits {
            banner: 5 * SECOND / 2,
            silence: 5 * SECOND,
            answer: 10 * SECOND,
            poll: SECOND / 5,
            hold: 10 * SECOND,
            reset: 3 * SECOND,
            off: 2 * SECOND,
        }
    }
}

/// A job as the core runs it.
#[derive(Clone, Debug)]
pub struct Setup {
    pub script: Arc<Script>,
    pub control: Dialect,
    /// The extruder's own device, where it has one.
    pub extruder: Option<Dialect>,
    /// Extrusion off, filament drawn back, module closed: the profile's codes.
    pub module_off: Vec<String>,
    /// Run the controller's check mode: nothing moves.
    pub check: bool,
    /// Where the program ends, where that can be told: axis, coordinate, whether of the machine.
    pub end: Vec<EndPoint>,
    /// Begin only where checksum or echo vouch for every byte.
    pub verified: bool,
    pub limits: Limits,
}

/// A coordinate at which the program ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EndPoint {
    /// Index of the axis in status reports.
    pub axis: usize,
    pub letter: char,
    pub at: f64,
    /// In machine coordinates; else in work coordinates.
    pub machine: bool,
}
