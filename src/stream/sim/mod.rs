//! Simulated controllers, in virtual time.
//!
//! They do what real ones were seen to do, the unpleasant parts above all: a receive buffer that
//! loses bytes without a word when it is overrun, line limits, realtime bytes that act inside
//! comments, holds that take time, memory writes that make them deaf, errors that stick.
//! [`Faulty`] puts a seeded script of faults between one of them and the sender.
//!
//! Not modelled: acceleration, arcs as curves (they go straight in the time the arc takes), and
//! most settings.

mod faults;
mod grbl;
mod marlin;
mod motion;
mod plain;
mod wire;

pub use faults::{Fault, Faulty, Script as FaultScript, Way as FaultWay};
pub use wire::{Arrival, Wire};

use super::core::{Micros, SECOND};
use super::modal::{Module, Rates};
use super::{Dialect, ModuleCode};

/// What a boot loader takes, during which received bytes are lost.
const BOOTING: Micros = SECOND;

/// What is simulated.
#[derive(Clone, Debug, PartialEq)]
pub struct SimSetup {
    pub dialect: Dialect,
    /// How many times faster than real motions go; 0 for motions that take no time.
    pub speed: f64,
    /// Repeats each line it reads.
    pub echo: bool,
    /// Says `ok` after a request to send a line again.
    pub ok_after_resend: bool,
    /// Drops a damaged line without a word, as RepRapFirmware may.
    pub drops_damaged: bool,
    /// Throws away what it has received when a line is damaged.
    pub flushes: bool,
    /// Runs the extruder's codes itself.
    pub module: bool,
    /// M codes of the module: open, close, on, off, draw, give.
    pub module_codes: [u32; 6],
    /// Axes in status reports.
    pub axes: usize,
    pub rates: Rates,
    /// Keeps every line it ran, for tests.
    pub records: bool,
}

impl SimSetup {
    pub fn new(dialect: Dialect) -> SimSetup {
        SimSetup {
            dialect,
            speed: 0.0,
            echo: false,
            ok_after_resend: true,
            drops_damaged: dialect == Dialect::Rrf,
            flushes: false,
            module: dialect == Dialect::Plain,
            module_codes: [70, 71, 72, 73, 74, 75],
            axes: 5,
            rates: Rates { rapid_mm_min: 6000.0, max_feed_mm_min: 6000.0, rapid_deg_min: 3600.0 },
            records: false,
        }
    }
}

/// What a simulated controller did.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Record {
    /// Lines taken to be run, in order.
    pub run: Vec<String>,
    /// Lines read, whether they were taken or refused, in order.
    pub read: Vec<(String, bool)>,
    /// Lines whose motion is over.
    pub moved: Vec<String>,
    /// Bytes lost because the receive buffer was full.
    pub overrun: u64,
    /// Bytes lost while it was deaf.
    pub deaf: u64,
    pub lines: u64,
    pub spindle: bool,
    pub coolant: bool,
    pub module: Module,
    /// Resets while something moved.
    pub lost_position: bool,
}

/// One simulated controller.
#[derive(Clone, Debug)]
pub enum Sim {
    Grbl(Box<grbl::Grbl>),
    Marlin(Box<marlin::Marlin>),
    Plain(Box<plain::Plain>),
}

impl Sim {
    /// Switched on at time 0.
    pub fn new(setup: SimSetup) -> Sim {
        match setup.dialect {
            Dialect::Grbl | Dialect::GrblHal => Sim::Grbl(Box::new(grbl::Grbl::new(setup))),
            Dialect::Marlin | Dialect::Rrf => Sim::Marlin(Box::new(marlin::Marlin::new(setup))),
            Dialect::Plain => Sim::Plain(Box::new(plain::Plain::new(setup))),
        }
    }

    /// Bytes arrive.
    pub fn receive(&mut self, bytes: &[u8], now: Micros) {
        match self {
            Sim::Grbl(s) => s.receive(bytes, now),
            Sim::Marlin(s) => s.receive(bytes, now),
            Sim::Plain(s) => s.receive(bytes, now),
        }
    }

    /// Time passes.
    pub fn advance(&mut self, now: Micros) {
        match self {
            Sim::Grbl(s) => s.advance(now),
            Sim::Marlin(s) => s.advance(now),
            Sim::Plain(s) => s.advance(now),
        }
    }

    /// When something happens next, if nothing arrives.
    pub fn next(&self) -> Option<Micros> {
        match self {
            Sim::Grbl(s) => s.next(),
            Sim::Marlin(s) => s.next(),
            Sim::Plain(s) => s.next(),
        }
    }

    /// What it has said since.
    pub fn take(&mut self) -> Vec<u8> {
        match self {
            Sim::Grbl(s) => std::mem::take(&mut s.out),
            Sim::Marlin(s) => std::mem::take(&mut s.out),
            Sim::Plain(s) => std::mem::take(&mut s.out),
        }
    }

    /// Its reset button, or a dip of its supply.
    pub fn power_cycle(&mut self, now: Micros) {
        match self {
            Sim::Grbl(s) => s.power_cycle(now),
            Sim::Marlin(s) => s.power_cycle(now),
            Sim::Plain(s) => s.power_cycle(now),
        }
    }

    pub fn record(&self) -> &Record {
        match self {
            Sim::Grbl(s) => &s.record,
            Sim::Marlin(s) => &s.record,
            Sim::Plain(s) => &s.record,
        }
    }
}

/// What a module code does to the module; false when it is none.
fn run_module(setup: &SimSetup, code: u32, module: &mut Module) -> bool {
    const CODES: [ModuleCode; 6] = {
        use ModuleCode::{Close, Draw, Give, Off, On, Open};
        [Open, Close, On, Off, Draw, Give]
    };
    let found = setup.module_codes.iter().position(|c| *c == code).map(|i| CODES[i]);
    if let Some(code) = found {
        module.run(code);
    }
    found.is_some()
}
