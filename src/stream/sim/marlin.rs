//! Marlin and RepRapFirmware, simulated: a queue of lines, numbers, checksums, requests.

use super::motion::Motion;
use super::{BOOTING, Record, SimSetup, run_module};
use crate::gcode::{Word, read_block};
use crate::stream::core::{Micros, SECOND};
use crate::stream::modal::{Modal, Spindle, tenths};
use crate::stream::{Dialect, codes};
use std::collections::VecDeque;

/// Lines it keeps before it stops reading.
const QUEUE: usize = 4;
/// Between two signs of life while a line takes long.
const KEEPALIVE: Micros = 2 * SECOND;

#[derive(Clone, Debug, PartialEq)]
enum Wait {
    Room { text: String, to: [f64; 6], seconds: f64 },
    Rest,
    Dwell(Micros),
    Until(Micros),
    Person,
}

#[derive(Clone, Debug)]
pub struct Marlin {
    setup: SimSetup,
    ring: VecDeque<u8>,
    line: Vec<u8>,
    /// What the emergency parser has seen of the line.
    urgent: Vec<u8>,
    /// Lines, and whether they had a number.
    queue: VecDeque<(String, bool)>,
    last: u32,
    wait: Option<Wait>,
    busy_at: Micros,
    motion: Motion,
    modal: Modal,
    halted: bool,
    /// Until when it boots.
    boots: Micros,
    pub(super) out: Vec<u8>,
    pub(super) record: Record,
}

impl Marlin {
    pub(super) fn new(setup: SimSetup) -> Marlin {
        let mut sim = Marlin {
            motion: Motion::new(setup.dialect.planner_blocks(), setup.speed),
            setup,
            ring: VecDeque::new(),
            line: Vec::new(),
            urgent: Vec::new(),
            queue: VecDeque::new(),
            last: 0,
            wait: None,
            busy_at: 0,
            modal: Modal { work: [Some(0.0); 6], ..Modal::default() },
            halted: false,
            boots: 0,
            out: Vec::new(),
            record: Record::default(),
        };
        sim.banner();
        sim
    }

    fn rrf(&self) -> bool {
        self.setup.dialect == Dialect::Rrf
    }

    fn say(&mut self, text: &str) {
        self.out.extend_from_slice(text.as_bytes());
        self.out.push(b'\n');
    }

    fn banner(&mut self) {
        if self.rrf() {
            self.say("RepRapFirmware for Duet 3 MB6HC is up and running.");
        } else {
            self.say("start");
            self.say("echo:Marlin bugfix-2.1.x");
        }
    }

    pub(super) fn power_cycle(&mut self, now: Micros) {
        self.advance(now);
        self.record.lost_position |= self.motion.moves(now);
        self.motion.clear(now);
        self.ring.clear();
        self.line.clear();
        self.urgent.clear();
        self.queue.clear();
        (self.last, self.wait, self.halted) = (0, None, false);
        self.modal = Modal { work: self.motion.at(now).map(Some), ..Modal::default() };
        (self.record.spindle, self.record.coolant) = (false, false);
        if self.setup.module {
            self.record.module = Default::default();
        }
        self.boots = now + BOOTING;
        self.banner();
    }

    pub(super) fn receive(&mut self, bytes: &[u8], now: Micros) {
        self.advance(now);
        for b in bytes.iter().filter(|_| now >= self.boots).copied().collect::<Vec<u8>>() {
            self.urgently(b, now);
            if self.ring.len() >= self.setup.dialect.receive_bytes() {
                self.record.overrun += 1;
            } else {
                self.ring.push_back(b);
            }
            self.run(now);
        }
    }

    /// M108, M112 and M410 act when they arrive, whatever waits.
    fn urgently(&mut self, b: u8, now: Micros) {
        if b != b'\n' {
            if self.urgent.len() < 16 {
                self.urgent.push(b);
            }
            return;
        }
        match std::mem::take(&mut self.urgent).as_slice() {
            b"M108" if self.wait == Some(Wait::Person) => self.wait = Some(Wait::Until(now)),
            b"M410" => {
                self.motion.clear(now);
                self.modal.work = self.motion.at(now).map(Some);
                if matches!(self.wait, Some(Wait::Room { .. })) {
                    self.wait = Some(Wait::Until(now));
                }
            }
            b"M112" => {
                self.motion.clear(now);
                self.halted = true;
                (self.record.spindle, self.record.coolant) = (false, false);
                self.say("Error:Printer halted. kill() called!");
            }
            _ => {}
        }
    }

    pub(super) fn advance(&mut self, now: Micros) {
        let (record, keep) = (&mut self.record, self.setup.records);
        self.motion.advance(now, |text| {
            if keep {
                record.moved.push(text);
            }
        });
        self.run(now);
        if self.wait.is_some() && now >= self.busy_at + KEEPALIVE && !self.rrf() && !self.halted {
            self.busy_at = now;
            let person = self.wait == Some(Wait::Person);
            self.say(if person { "echo:busy: paused for user" } else { "echo:busy: processing" });
        }
    }

    pub(super) fn next(&self) -> Option<Micros> {
        let wait = match self.wait {
            Some(Wait::Until(t)) => Some(t),
            Some(_) if !self.rrf() && !self.halted => Some(self.busy_at + KEEPALIVE),
            _ => None,
        };
        match (self.motion.next(), wait) {
            (Some(a), Some(b)) => Some(a.min(b)),
            (a, b) => a.or(b),
        }
    }

    fn run(&mut self, now: Micros) {
        while !self.halted {
            self.read(now);
            if let Some(wait) = self.wait.take() {
                self.wait = self.waited(wait, now);
                if self.wait.is_some() {
                    return;
                }
                continue;
            }
            let Some((line, numbered)) = self.queue.pop_front() else { return };
            self.busy_at = now;
            self.execute(&line, numbered);
        }
    }

    /// Fills the queue from what has arrived.
    fn read(&mut self, _now: Micros) {
        while self.queue.len() < QUEUE {
            let Some(b) = self.ring.pop_front() else { return };
            match b {
                b'\n' | b'\r' => {
                    let line = std::mem::take(&mut self.line);
                    let text = String::from_utf8_lossy(&line).trim().to_string();
                    if !text.is_empty() {
                        self.record.lines += 1;
                        self.take(&text);
                    }
                }
                _ if self.line.len() >= self.setup.dialect.longest_line() => {}
                b => self.line.push(b),
            }
        }
    }

    /// Checks number and checksum; what is right goes into the queue.
    fn take(&mut self, text: &str) {
        let Some(rest) = text.strip_prefix('N') else {
            self.queue.push_back((text.to_string(), false));
            return;
        };
        let digits = rest.bytes().take_while(u8::is_ascii_digit).count();
        let number: Option<u32> = rest[..digits].parse().ok();
        let begins = rest[digits..].trim_start().starts_with("M110");
        let Some((body, sum)) = text.rsplit_once('*') else {
            return self.ask_again("No Checksum with line number", false);
        };
        let found = body.bytes().fold(0u8, |a, b| a ^ b);
        if sum.trim().parse() != Ok(found) {
            return self.ask_again("checksum mismatch", self.setup.drops_damaged);
        }
        let Some(number) = number.filter(|n| begins || *n == self.last + 1) else {
            return self.ask_again("Line Number is not Last Line Number+1", false);
        };
        self.last = number;
        let command = body[1 + digits..].trim().to_string();
        self.queue.push_back((command, true));
    }

    fn ask_again(&mut self, why: &str, silently: bool) {
        if self.setup.flushes {
            self.ring.clear();
            self.line.clear();
        }
        if silently {
            return;
        }
        let (last, next) = (self.last, self.last + 1);
        if self.rrf() {
            self.say(&format!("rs N{next}"));
        } else {
            self.say(&format!("Error:{why}, Last Line: {last}"));
            self.say(&format!("Resend: {next}"));
        }
        if self.setup.ok_after_resend {
            self.say("ok");
        }
    }

    fn execute(&mut self, line: &str, numbered: bool) {
        if line.starts_with("M110") {
            return self.say("ok");
        }
        let Some(words) = read_block(line).ok().filter(|w| self.knows(w)) else {
            self.say(&format!("echo:Unknown command: \"{line}\""));
            return self.say("ok");
        };
        // The sender's own words without a number are no lines of a program.
        if self.setup.records && (numbered || !line.starts_with('M')) {
            self.record.run.push(line.into());
        }
        let effect = self.modal.apply(&words, &self.setup.rates);
        self.record.spindle = self.modal.spindle != Spindle::Off;
        self.record.coolant = self.modal.flood || self.modal.mist;
        let code = words.iter().find(|w| w.letter == 'M').and_then(|w| tenths(w.value));
        if let Some(code) = code {
            run_module(&self.setup, code / 10, &mut self.record.module);
        }
        self.wait = Some(match code {
            Some(0 | 10) => Wait::Person,
            Some(4000) => Wait::Rest,
            Some(1140) => {
                let [x, y, z, ..] = self.motion.at(self.busy_at);
                self.say(&format!("X:{x:.3} Y:{y:.3} Z:{z:.3} E:0.000 Count X:0 Y:0 Z:0"));
                Wait::Until(0)
            }
            _ if words.iter().any(|w| w.letter == 'G' && w.value == 4.0) => {
                Wait::Dwell(self.scaled(effect.seconds))
            }
            _ if effect.moves => {
                let to = std::array::from_fn(|i| self.modal.work[i].unwrap_or(0.0));
                Wait::Room { text: line.into(), to, seconds: effect.seconds }
            }
            _ => Wait::Until(0),
        });
    }

    fn scaled(&self, seconds: f64) -> Micros {
        if self.setup.speed <= 0.0 {
            return 0;
        }
        (seconds / self.setup.speed * SECOND as f64) as Micros
    }

    fn knows(&self, words: &[Word]) -> bool {
        let Some(first) = words.first() else { return false };
        let Some(code) = tenths(first.value) else { return false };
        match first.letter {
            'G' => codes::knows_g(self.setup.dialect, code),
            'M' if (700..=750).contains(&code) => self.setup.module,
            'M' => {
                codes::knows_m(self.setup.dialect, code)
                    || matches!(code, 1140 | 1080 | 4100 | 1120 | 1070)
            }
            'T' => true,
            // A move goes on with the code of the last.
            'X' | 'Y' | 'Z' | 'S' | 'F' => self.rrf(),
            _ => false,
        }
    }

    fn waited(&mut self, wait: Wait, now: Micros) -> Option<Wait> {
        match wait {
            Wait::Room { text, to, seconds } => {
                if self.motion.is_full() {
                    return Some(Wait::Room { text, to, seconds });
                }
                let done = self.motion.push(&text, to, seconds, now);
                if let Some(text) = done.filter(|_| self.setup.records) {
                    self.record.moved.push(text);
                }
            }
            Wait::Rest if !self.motion.is_empty() => return Some(wait),
            Wait::Dwell(_) if !self.motion.is_empty() => return Some(wait),
            Wait::Dwell(takes) => return Some(Wait::Until(now + takes)),
            Wait::Until(t) if now < t => return Some(wait),
            Wait::Person => return Some(wait),
            Wait::Rest | Wait::Until(_) => {}
        }
        self.say("ok");
        None
    }
}
