//! A seeded script of faults between a sender and a simulated device.

use super::{Sim, SimSetup, Wire};
use crate::base::Rng;
use crate::stream::core::{Micros, SECOND};
use rand::RngExt as _;

/// Which way bytes go.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    ToDevice,
    FromDevice,
}

/// One thing that goes wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// The n-th byte of a way is lost.
    Drop(Way, u64),
    /// One bit of it turns over.
    Flip(Way, u64, u8),
    /// It arrives twice.
    Double(Way, u64),
    /// The n-th `ok` never arrives.
    LoseOk(u64),
    /// The device begins anew when the n-th byte reaches it.
    Reset(u64),
    /// The device is gone from then on.
    HangUp(u64),
    /// From the n-th byte on the device neither reads nor talks; for good, or for so long.
    Stall(u64, Option<Micros>),
}

/// The faults of one run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Script {
    pub faults: Vec<Fault>,
}

/// Bytes of the longest line of the programs that are damaged, number and checksum included.
const LONGEST_LINE: u64 = 48;

impl Script {
    /// Up to `most` faults among the first `bytes` bytes. With `damage`, bytes may be damaged,
    /// on both ways; else only what leaves bytes as they are happens.
    pub fn random(rng: &mut Rng, most: u32, bytes: u64, damage: bool) -> Script {
        let mut faults = Vec::new();
        for _ in 0..rng.random_range(0..=most) {
            let n = rng.random_range(0..bytes);
            let way = if rng.random_bool(0.5) { Way::ToDevice } else { Way::FromDevice };
            let kinds = if damage { 0..=7 } else { 3..=7 };
            faults.push(match rng.random_range(kinds) {
                0 => Fault::Drop(way, n),
                1 => Fault::Flip(way, n, rng.random_range(0..8)),
                2 => Fault::Double(way, n),
                3 => Fault::LoseOk(n / 12),
                4 => Fault::Reset(n),
                5 => Fault::HangUp(n),
                6 => Fault::Stall(n, None),
                _ => Fault::Stall(n, Some(rng.random_range(0..4 * SECOND))),
            });
        }
        Script { faults }
    }

    /// One damaged byte in each line with probability `rate`, for the first `lines` lines of
    /// about `length` bytes; never two within a line.
    pub fn damage(rng: &mut Rng, rate: f64, lines: u64, length: u64) -> Script {
        let mut faults = Vec::new();
        let mut free = 0;
        for line in 0..lines {
            if rng.random_bool(rate) {
                let n = line * length + rng.random_range(0..length);
                if n < free {
                    continue;
                }
                free = n + LONGEST_LINE;
                faults.push(match rng.random_range(0..3) {
                    0 => Fault::Drop(Way::ToDevice, n),
                    1 => Fault::Flip(Way::ToDevice, n, rng.random_range(0..8)),
                    _ => Fault::Double(Way::ToDevice, n),
                });
            }
        }
        Script { faults }
    }
}

/// A device behind a line with faults.
#[derive(Clone, Debug)]
pub struct Faulty {
    pub sim: Sim,
    script: Script,
    /// Bytes seen on each way.
    seen: [u64; 2],
    oks: u64,
    out: Vec<u8>,
    line: Vec<u8>,
    stalled: Option<Option<Micros>>,
    /// What the stalled device has not read.
    unread: Vec<u8>,
    /// It has begun anew, and says so at once: no stall hides that.
    boots: bool,
    pub hung_up: bool,
    /// What crossed the line to the device; kept only where it records.
    pub wire: Option<Wire>,
}

impl Faulty {
    pub fn new(setup: SimSetup, script: Script) -> Faulty {
        let counted = setup.records && !setup.dialect.is_numbered();
        Faulty {
            wire: counted.then(|| Wire::new(setup.dialect)),
            sim: Sim::new(setup),
            script,
            seen: [0; 2],
            oks: 0,
            out: Vec::new(),
            line: Vec::new(),
            stalled: None,
            unread: Vec::new(),
            boots: false,
            hung_up: false,
        }
    }

    /// The sender writes.
    pub fn receive(&mut self, bytes: &[u8], now: Micros) {
        for b in bytes {
            if self.hung_up {
                return;
            }
            let n = self.seen[0];
            self.seen[0] += 1;
            for i in 0..self.script.faults.len() {
                match self.script.faults[i] {
                    Fault::Reset(at) if at == n => {
                        // What was on its way meets a boot loader.
                        self.unread.clear();
                        self.stalled = None;
                        self.boots = true;
                        self.sim.power_cycle(now);
                        if let Some(wire) = &mut self.wire {
                            wire.power_cycle();
                        }
                    }
                    Fault::HangUp(at) if at == n => self.hung_up = true,
                    Fault::Stall(at, takes) if at == n && !self.boots => {
                        self.stalled = Some(takes.map(|t| now + t));
                    }
                    _ => {}
                }
            }
            let arrives = self.damaged(Way::ToDevice, n, *b);
            let mut heard = Vec::new();
            for a in arrives {
                let deaf = self.sim.record().deaf;
                if self.stalled.is_some() {
                    self.unread.push(a);
                } else {
                    self.sim.receive(&[a], now);
                }
                if self.sim.record().deaf == deaf {
                    heard.push(a);
                }
            }
            if let Some(wire) = &mut self.wire {
                wire.carry(*b, &heard);
            }
        }
        self.collect();
    }

    fn damaged(&self, way: Way, n: u64, b: u8) -> Vec<u8> {
        for fault in &self.script.faults {
            match *fault {
                Fault::Drop(w, at) if w == way && at == n => return Vec::new(),
                Fault::Double(w, at) if w == way && at == n => return vec![b, b],
                Fault::Flip(w, at, bit) if w == way && at == n => return vec![b ^ (1 << bit)],
                _ => {}
            }
        }
        vec![b]
    }

    pub fn advance(&mut self, now: Micros) {
        if let Some(Some(until)) = self.stalled
            && now >= until
        {
            self.stalled = None;
            let unread = std::mem::take(&mut self.unread);
            self.sim.receive(&unread, now);
        }
        if self.stalled.is_none() {
            self.sim.advance(now);
        }
        self.collect();
    }

    pub fn next(&self) -> Option<Micros> {
        match self.stalled {
            Some(until) => until,
            None => self.sim.next(),
        }
    }

    /// Takes the device's words, whole lines at a time so that an `ok` can be lost.
    fn collect(&mut self) {
        for b in self.sim.take() {
            self.line.push(b);
            if b != b'\n' {
                continue;
            }
            let line = std::mem::take(&mut self.line);
            if line.starts_with(b"ok") {
                self.oks += 1;
                if self.script.faults.contains(&Fault::LoseOk(self.oks)) {
                    continue;
                }
            }
            for b in line {
                let n = self.seen[1];
                self.seen[1] += 1;
                let arrives = self.damaged(Way::FromDevice, n, b);
                self.out.extend(arrives);
            }
        }
    }

    /// What reaches the sender, at most so many bytes.
    pub fn take(&mut self, most: usize) -> Vec<u8> {
        if self.hung_up || self.stalled.is_some() {
            return Vec::new();
        }
        let rest = self.out.split_off(most.min(self.out.len()));
        std::mem::replace(&mut self.out, rest)
    }
}
