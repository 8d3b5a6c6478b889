//! grbl 1.1 and grblHAL, simulated.

use super::motion::Motion;
use super::{BOOTING, Record, SimSetup, run_module};
use crate::gcode::{BadBlock, Word, read_block};
use crate::stream::core::{Micros, SECOND};
use crate::stream::modal::{Modal, Spindle, Way, tenths};
use crate::stream::{Dialect, codes};
use std::collections::VecDeque;

/// A memory write; received bytes are lost meanwhile.
const STORING: Micros = SECOND / 50;
const HOMING: Micros = SECOND;
/// Every so many status reports tell the work coordinate offset.
const OFFSET_EVERY: u32 = 10;

/// What a line waits for before it is answered.
#[derive(Clone, Debug, PartialEq)]
enum Wait {
    /// Room for its motion.
    Room { text: String, to: [f64; 6], seconds: f64 },
    /// Rest, then this.
    Rest(Then),
    /// A time.
    Until(Micros),
    /// A time during which nothing is received.
    Deaf(Micros),
    /// The person.
    Person { tool: bool },
}

#[derive(Clone, Debug, PartialEq)]
enum Then {
    Answer,
    Dwell(Micros),
    Store,
    Person { tool: bool },
    End,
    Module(u32),
}

#[derive(Clone, Debug)]
pub struct Grbl {
    setup: SimSetup,
    ring: VecDeque<u8>,
    line: Vec<u8>,
    too_long: bool,
    after_return: bool,
    wait: Option<Wait>,
    motion: Motion,
    modal: Modal,
    alarm: bool,
    door: bool,
    check: bool,
    /// grblHAL answers every line with it until a blank one.
    sticky: Option<u32>,
    asked: u32,
    /// Until when it boots.
    boots: Micros,
    pub(super) out: Vec<u8>,
    pub(super) record: Record,
}

impl Grbl {
    pub(super) fn new(setup: SimSetup) -> Grbl {
        let mut sim = Grbl {
            motion: Motion::new(setup.dialect.planner_blocks(), setup.speed),
            setup,
            ring: VecDeque::new(),
            line: Vec::new(),
            too_long: false,
            after_return: false,
            wait: None,
            modal: Modal { work: [Some(0.0); 6], ..Modal::default() },
            alarm: false,
            door: false,
            check: false,
            sticky: None,
            asked: 0,
            boots: 0,
            out: Vec::new(),
            record: Record::default(),
        };
        sim.banner();
        sim
    }

    fn hal(&self) -> bool {
        self.setup.dialect == Dialect::GrblHal
    }

    fn say(&mut self, text: &str) {
        self.out.extend_from_slice(text.as_bytes());
        self.out.extend_from_slice(b"\r\n");
    }

    fn banner(&mut self) {
        let name = if self.hal() { "GrblHAL 1.1f" } else { "Grbl 1.1h" };
        self.say(&format!("\r\n{name} ['$' for help]"));
        if self.alarm {
            self.say("[MSG:'$H'|'$X' to unlock]");
        }
    }

    pub(super) fn receive(&mut self, bytes: &[u8], now: Micros) {
        self.advance(now);
        for b in bytes {
            let storing = matches!(self.wait, Some(Wait::Deaf(until)) if now < until);
            if storing || now < self.boots {
                self.record.deaf += 1;
                continue;
            }
            match b {
                b'?' => self.report(now),
                b'!' => {
                    if !self.alarm {
                        self.motion.hold(now);
                    }
                }
                b'~' => self.go_on(now),
                0x18 => self.reset(now),
                0x84 => {
                    self.door = true;
                    self.motion.hold(now);
                }
                0xA0 => self.record.coolant = !self.record.coolant,
                0x80.. => {}
                _ if self.ring.len() >= self.setup.dialect.receive_bytes() => {
                    self.record.overrun += 1;
                }
                b => self.ring.push_back(*b),
            }
            self.run(now);
        }
    }

    fn go_on(&mut self, now: Micros) {
        self.door = false;
        self.motion.resume(now);
        if matches!(self.wait, Some(Wait::Person { .. })) {
            self.wait = None;
            self.say("ok");
        }
    }

    fn reset(&mut self, now: Micros) {
        if self.motion.moves(now) {
            self.say("ALARM:3");
            self.alarm = true;
            self.record.lost_position = true;
        }
        self.begin_anew(now);
    }

    pub(super) fn power_cycle(&mut self, now: Micros) {
        self.advance(now);
        self.record.lost_position |= self.motion.moves(now);
        self.begin_anew(now);
        // The boot loader swallows what arrives.
        self.boots = now + BOOTING;
    }

    fn begin_anew(&mut self, now: Micros) {
        self.motion.clear(now);
        let at = self.motion.at(now);
        self.modal = Modal { work: at.map(Some), ..Modal::default() };
        self.ring.clear();
        self.line.clear();
        (self.too_long, self.after_return, self.wait) = (false, false, None);
        (self.door, self.check, self.sticky) = (false, false, None);
        (self.record.spindle, self.record.coolant) = (false, false);
        if self.setup.module {
            self.record.module = Default::default();
        }
        self.banner();
    }

    pub(super) fn advance(&mut self, now: Micros) {
        let (record, keep) = (&mut self.record, self.setup.records);
        self.motion.advance(now, |text| {
            if keep {
                record.moved.push(text);
            }
        });
        self.run(now);
    }

    pub(super) fn next(&self) -> Option<Micros> {
        let wait = match self.wait {
            Some(Wait::Until(t) | Wait::Deaf(t)) => Some(t),
            _ => None,
        };
        match (self.motion.next(), wait) {
            (Some(a), Some(b)) => Some(a.min(b)),
            (a, b) => a.or(b),
        }
    }

    /// Reads lines until one has to wait.
    fn run(&mut self, now: Micros) {
        loop {
            // Nothing is read in a hold.
            if self.motion.held(now).is_some() {
                return;
            }
            if let Some(wait) = self.wait.take() {
                match self.waited(wait, now) {
                    Some(wait) => {
                        self.wait = Some(wait);
                        return;
                    }
                    None => continue,
                }
            }
            let Some(b) = self.ring.pop_front() else { return };
            self.byte(b, now);
        }
    }

    /// A wait that is not over is handed back.
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
            Wait::Rest(then) => {
                if !self.motion.is_empty() {
                    return Some(Wait::Rest(then));
                }
                match then {
                    Then::Answer => {}
                    Then::Dwell(takes) => return Some(Wait::Until(now + takes)),
                    Then::Store => return Some(Wait::Deaf(now + STORING)),
                    Then::Person { tool } => return Some(Wait::Person { tool }),
                    Then::End => {
                        (self.record.spindle, self.record.coolant) = (false, false);
                        self.say("[MSG:Pgm End]");
                    }
                    Then::Module(code) => {
                        run_module(&self.setup, code, &mut self.record.module);
                    }
                }
            }
            Wait::Until(t) | Wait::Deaf(t) if now < t => return Some(wait),
            Wait::Person { .. } => return Some(wait),
            Wait::Until(_) | Wait::Deaf(_) => {}
        }
        self.say("ok");
        None
    }

    fn byte(&mut self, b: u8, now: Micros) {
        let after_return = std::mem::replace(&mut self.after_return, b == b'\r');
        match b {
            b'\n' if after_return && self.hal() => {}
            b'\r' | b'\n' => {
                let line = std::mem::take(&mut self.line);
                let too_long = std::mem::take(&mut self.too_long);
                self.record.lines += 1;
                let text = String::from_utf8_lossy(&line).into_owned();
                if too_long {
                    self.read(&text);
                    return self.refuse(11);
                }
                self.block(&text, now);
            }
            // Comments count towards the line on none of them; spaces neither.
            _ if self.line.len() >= self.setup.dialect.longest_line() => self.too_long = true,
            b => self.line.push(b),
        }
    }

    fn read(&mut self, text: &str) {
        if self.setup.records {
            self.record.read.push((text.into(), true));
        }
    }

    fn refuse(&mut self, code: u32) {
        if self.hal() {
            self.sticky = Some(code);
        }
        if let Some(last) = self.record.read.last_mut() {
            last.1 = false;
        }
        self.say(&format!("error:{code}"));
    }

    fn block(&mut self, text: &str, now: Micros) {
        let text = text.trim();
        if self.setup.echo {
            let squeezed: String = text.split_whitespace().collect();
            self.say(&format!("[echo: {}]", squeezed.to_ascii_uppercase()));
        }
        if text.is_empty() {
            self.sticky = None;
            return self.say("ok");
        }
        self.read(text);
        if text.starts_with('$') {
            // What it makes of this takes the place of an earlier error.
            self.sticky = None;
            return self.dollar(text, now);
        }
        if let Some(code) = self.sticky {
            return self.refuse(code);
        }
        if self.alarm {
            return self.refuse(9);
        }
        match self.take(text) {
            Ok(wait) => {
                if self.setup.records {
                    self.record.run.push(text.into());
                }
                self.wait = Some(wait);
            }
            Err(code) => self.refuse(code),
        }
    }

    fn dollar(&mut self, text: &str, now: Micros) {
        match text {
            "$I" => {
                let (version, option) = match self.hal() {
                    true => ("[VER:1.1f.20260801:]", "[OPT:VNMGL,100,1024,5,0]"),
                    false => ("[VER:1.1h.20190825:]", "[OPT:V,15,128]"),
                };
                self.say(version);
                self.say(option);
                self.say("ok");
            }
            "$G" => {
                let state = self.parser_state();
                self.say(&state);
                self.say("ok");
            }
            "$C" if !self.check && (!self.motion.is_empty() || self.motion.held(now).is_some()) => {
                self.refuse(8);
            }
            "$C" if self.check => self.begin_anew(now),
            "$C" => {
                self.check = true;
                self.say("[MSG:Enabled]");
                self.say("ok");
            }
            "$X" => {
                self.alarm = false;
                self.say("[MSG:Caution: Unlocked]");
                self.say("ok");
            }
            "$H" => {
                self.alarm = false;
                self.motion.set([0.0; 6]);
                self.modal.work = [Some(0.0); 6];
                self.record_dollar(text);
                self.wait = Some(Wait::Until(now + HOMING));
            }
            _ if text.contains('=') => {
                self.record_dollar(text);
                self.wait = Some(Wait::Rest(Then::Store));
            }
            _ => self.refuse(3),
        }
    }

    /// Modes, feed, speed and tool behind the last block that was taken.
    fn parser_state(&self) -> String {
        let m = &self.modal;
        let hal = self.hal();
        let mut out = match m.way {
            Way::Rapid | Way::None => "[GC:G0".to_string(),
            Way::Feed => "[GC:G1".into(),
            Way::Arc { clockwise: true } => "[GC:G2".into(),
            Way::Arc { clockwise: false } => "[GC:G3".into(),
            Way::Probe => "[GC:G38.2".into(),
            Way::Cycle => "[GC:G81".into(),
        };
        let units = if m.inches { 20 } else { 21 };
        let distance = if m.relative { 91 } else { 90 };
        let feed = if m.inverse_time { 93 } else { 94 };
        out += &format!(" G{} G{} G{units} G{distance} G{feed}", m.system, m.plane);
        if hal {
            out += if m.length.is_some() { " G40 G43 G98 G50" } else { " G40 G49 G98 G50" };
        }
        out += match m.spindle {
            Spindle::Clockwise => " M3",
            Spindle::Counter => " M4",
            Spindle::Off => " M5",
        };
        for (on, word) in [(m.mist, " M7"), (m.flood, " M8"), (!m.mist && !m.flood, " M9")] {
            out += if on { word } else { "" };
        }
        // grblHAL names the tool in the spindle, grbl the one that was selected.
        let tool = if hal { m.loaded } else { m.tool };
        let (feed, speed) = (m.feed.unwrap_or(0.0), m.speed.unwrap_or(0.0));
        out + &format!(" T{} F{feed:.0} S{speed:.0}]", tool.unwrap_or(0))
    }

    fn record_dollar(&mut self, text: &str) {
        if self.setup.records {
            self.record.run.push(text.into());
        }
    }

    /// Checks a block and says what its answer waits for.
    fn take(&mut self, text: &str) -> Result<Wait, u32> {
        let words = read_block(text).map_err(|e| -> u32 {
            match e {
                BadBlock::NotAWord(_) | BadBlock::NotAscii(_) => 1,
                BadBlock::Twice(_) => 25,
                BadBlock::TooLong(_) => 11,
                BadBlock::Number(_) | BadBlock::Comment => 2,
            }
        })?;
        let module = self.check_words(&words)?;
        let effect = self.modal.apply(&words, &self.setup.rates);
        let has = |letter, value| words.iter().any(|w| w.letter == letter && w.value == value);
        if self.check {
            return Ok(Wait::Rest(Then::Answer));
        }
        self.record.spindle = self.modal.spindle != Spindle::Off;
        self.record.coolant = self.modal.flood || self.modal.mist;
        if let Some(code) = module {
            return Ok(Wait::Rest(Then::Module(code)));
        }
        let then = if has('G', 4.0) {
            Then::Dwell(self.scaled(effect.seconds))
        } else if has('M', 0.0) || (self.hal() && has('M', 60.0)) {
            Then::Person { tool: false }
        } else if has('M', 6.0) {
            Then::Person { tool: true }
        } else if has('M', 2.0) || has('M', 30.0) {
            Then::End
        } else if ['G'].iter().any(|g| has(*g, 10.0) || has(*g, 28.1) || has(*g, 30.1)) {
            Then::Store
        } else if effect.moves {
            let to: [f64; 6] = std::array::from_fn(|i| {
                self.modal.work[i].or(self.modal.machine[i]).unwrap_or(0.0)
            });
            return Ok(Wait::Room { text: text.into(), to, seconds: effect.seconds });
        } else {
            // Spindle and coolant change where the motion is.
            Then::Answer
        };
        let waits = matches!(then, Then::Answer)
            && !words.iter().any(|w| matches!((w.letter, w.value as u32), ('M', 3..=9)));
        if waits { Ok(Wait::Until(0)) } else { Ok(Wait::Rest(then)) }
    }

    fn scaled(&self, seconds: f64) -> Micros {
        if self.setup.speed <= 0.0 {
            return 0;
        }
        (seconds / self.setup.speed * SECOND as f64) as Micros
    }

    /// The module code, when it is one.
    fn check_words(&self, words: &[Word]) -> Result<Option<u32>, u32> {
        let (mut module, mut motions) = (None, 0);
        for w in words {
            let Some(code) = tenths(w.value) else {
                if matches!(w.letter, 'G' | 'M') {
                    return Err(20);
                }
                continue;
            };
            match w.letter {
                'G' if !codes::knows_g(self.setup.dialect, code) => return Err(20),
                'G' => motions += usize::from(matches!(code, 0 | 10 | 20 | 30)),
                'M' if self.hal() && self.setup.module && (700..=750).contains(&code) => {
                    module = Some(code / 10);
                }
                // Modal state saved and restored: an ok that proves no extruder.
                'M' if self.hal() && (700..=730).contains(&code) => {}
                'M' if !codes::knows_m(self.setup.dialect, code) => return Err(20),
                'M' => {}
                'A' | 'B' | 'C' if !self.hal() => return Err(20),
                'N' | 'X' | 'Y' | 'Z' | 'A' | 'B' | 'C' | 'I' | 'J' | 'K' | 'R' | 'F' | 'S'
                | 'T' | 'P' | 'L' | 'H' => {}
                'Q' if self.hal() => {}
                _ => return Err(20),
            }
        }
        let moves = words.iter().any(|w| "XYZABC".contains(w.letter));
        let feeds = words.iter().any(|w| w.letter == 'G' && matches!(w.value as u32, 1..=3));
        let fed = self.modal.feed.is_some() || words.iter().any(|w| w.letter == 'F');
        match () {
            () if motions > 1 => Err(21),
            () if feeds && moves && !fed => Err(22),
            () => self.needs(words, moves).map(|()| module),
        }
    }

    /// Refuses a block that lacks words its code needs, or has some that none of its codes takes.
    fn needs(&self, words: &[Word], moves: bool) -> Result<(), u32> {
        let has = |letter| words.iter().any(|w| w.letter == letter);
        let code = |wanted: &[u32]| {
            let mut codes =
                words.iter().filter(|w| w.letter == 'G').filter_map(|w| tenths(w.value));
            codes.any(|c| wanted.contains(&c))
        };
        let any = |letters: &str| words.iter().any(|w| letters.contains(w.letter));
        let (dwell, stores, lengths) = (code(&[40]), code(&[100]), code(&[430, 431, 432]));
        let other =
            code(&[730, 760, 810, 820, 830, 850, 860, 890, 330]) || code(&[382, 383, 384, 385]);
        let names_way = code(&[0, 10, 20, 30]);
        let arc = match names_way {
            true => code(&[20, 30]),
            false => matches!(self.modal.way, Way::Arc { .. }) && moves,
        };
        let names_tool = words.iter().any(|w| w.letter == 'M' && w.value == 61.0);
        let mine = |letter: char| match letter {
            'P' => dwell || stores || other || arc,
            'L' => stores || other,
            'H' => lengths,
            'Q' => other || names_tool,
            'I' | 'J' | 'K' | 'R' => arc || stores || other,
            'X' | 'Y' | 'Z' | 'A' | 'B' | 'C' => !dwell,
            _ => true,
        };
        match () {
            () if dwell && !has('P') => Err(28),
            () if stores && !(has('P') && has('L')) => Err(28),
            () if names_tool && !has('Q') => Err(28),
            () if code(&[50, 51]) && !any("IJ") => Err(35),
            () if arc && !moves => Err(26),
            () if arc && !any("IJKR") => Err(35),
            () if words.iter().any(|w| !mine(w.letter)) => Err(36),
            () => Ok(()),
        }
    }

    fn state(&self, now: Micros) -> &'static str {
        match (self.motion.held(now), &self.wait) {
            _ if self.alarm => "Alarm",
            _ if self.door => "Door:0",
            (Some(true), _) => "Hold:0",
            (Some(false), _) => "Hold:1",
            _ if self.check => "Check",
            (_, Some(Wait::Person { tool: true })) => "Tool",
            (_, Some(Wait::Person { tool: false })) => "Hold:0",
            _ if !self.motion.is_empty() => "Run",
            _ => "Idle",
        }
    }

    fn report(&mut self, now: Micros) {
        let at = self.motion.at(now);
        let axes = if self.hal() { self.setup.axes } else { 3 };
        let numbers: Vec<String> = at.iter().take(axes).map(|v| format!("{v:.3}")).collect();
        let mut text = format!("<{}|MPos:{}", self.state(now), numbers.join(","));
        let rx = self.setup.dialect.receive_bytes() - self.ring.len();
        text +=
            &format!("|Bf:{},{rx}|FS:{:.0},0", self.motion.free(), self.modal.feed.unwrap_or(0.0));
        if self.asked.is_multiple_of(OFFSET_EVERY) {
            text += &format!("|WCO:{}", vec!["0.000"; axes].join(","));
        }
        self.asked += 1;
        text.push('>');
        self.say(&text);
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Sim, SimSetup};
    use crate::stream::Dialect;

    /// A stopped job is gone on with by a line that the controller refused: M61 takes its tool from Q.
    #[test]
    fn the_tool_in_the_spindle_can_be_told() {
        let answer = |line: &str| {
            let mut sim = Sim::new(SimSetup::new(Dialect::GrblHal));
            sim.advance(0);
            sim.take();
            sim.receive(line.as_bytes(), 0);
            sim.advance(1_000_000);
            String::from_utf8(sim.take()).unwrap().trim().to_string()
        };
        assert_eq!(answer("M61 Q2\n"), "ok");
        assert_eq!(answer("M61\n"), "error:28");
        assert_eq!(answer("G0 Q2\n"), "error:36");
    }
}
