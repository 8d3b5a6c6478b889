//! What replies do to the job.

use super::link::{Heard, Link, Tag};
use super::{ASK_STATE, ASKS, Core, Drain, Greeting, IDLE_REPORTS, Phase, stop};
use super::{Action, Device, Note};
use crate::gcode::read_block;
use crate::stream::outcome::{Ending, Means};
use crate::stream::reply::Lines;
use crate::stream::{Class, Dialect, Reply, State, Status};

impl Core {
    /// Bytes from a device.
    pub(super) fn receive(&mut self, device: Device, bytes: &[u8], out: &mut Vec<Action>) {
        let now = self.now;
        let Some(p) = self.peer(device) else { return };
        p.heard = now;
        let dialect = p.dialect;
        let mut lines: Lines = std::mem::take(&mut p.lines);
        let mut replies = Vec::new();
        lines.push(bytes, |line| replies.push(Reply::read(dialect, line)));
        if let Some(p) = self.peer(device) {
            p.lines = lines;
        }
        for reply in replies {
            self.hear(device, reply, out);
        }
    }

    fn hear(&mut self, device: Device, reply: Reply, out: &mut Vec<Action>) {
        match (&self.phase, &reply) {
            (Phase::Over, _) => return,
            (Phase::Stopping(_), _) => return self.hear_stopping(device, &reply, out),
            (Phase::Leaving { .. }, Reply::Banner(_)) => return self.end(Ending::Done, out),
            (Phase::Leaving { .. }, _) => return,
            _ => {}
        }
        let greeting = self.peer(device).map(|p| p.greeting);
        if greeting == Some(Greeting::Banner) {
            // A boot loader's noise and what is left of earlier talk count for nothing.
            if let Reply::Banner(text) = reply {
                self.banner_at_start(device, &text, out);
            }
            return;
        }
        match &reply {
            Reply::Banner(text) if greeting == Some(Greeting::Ready) => {
                let banner = text.clone();
                return self.fail(Ending::Reset { device, banner }, out);
            }
            // The device was slower than the wait for it.
            Reply::Banner(text) => return self.banner_at_start(device, text, out),
            Reply::Alarm(code) => {
                let what = self.alarm(device, *code);
                return self.fail(Ending::Alarm { device, what }, out);
            }
            Reply::Fatal(text) => {
                return self.fail(Ending::Halted { device, what: text.clone() }, out);
            }
            Reply::Status(status) => return self.status(status, out),
            Reply::Build { blocks, bytes } => {
                let dialect = self.setup.control;
                // The larger figure keeps more of the path.
                self.vouch.blocks = self.vouch.blocks.max(blocks.unwrap_or(0));
                if let Some(p) = self.peer(device) {
                    p.link.receive_buffer(dialect, *bytes);
                    p.told[1] = true;
                }
            }
            Reply::Paused if !self.waits => {
                self.waits = true;
                let oldest = self.peer(device).and_then(|p| p.link.oldest());
                let number = oldest.map_or(0, |t| self.number(t));
                out.push(Action::Note(Note::Waits { number, why: "the program pauses" }));
            }
            Reply::Parser(state) => {
                let Some(p) = self.peer(device) else { return };
                p.parser = Some(state.clone());
                // Everything before the question must have been answered.
                if p.link.oldest() != Some(Tag::Modes) {
                    return self.out_of_step(device, out);
                }
            }
            Reply::Position(at) => self.position(device, at.clone(), out),
            Reply::Info(text) => {
                out.push(Action::Note(Note::Said { device, text: text.clone() }));
            }
            _ => {}
        }
        self.resting = None;
        let mut again = Vec::new();
        let Some(p) = self.peer(device) else { return };
        let heard = p.link.hear(&reply, &mut again);
        if !again.is_empty() {
            let now = self.now;
            if let Some(p) = self.peer(device) {
                p.wrote = now;
            }
            out.push(Action::Write(device, again));
        }
        self.take(device, heard, out);
    }

    fn banner_at_start(&mut self, device: Device, text: &str, out: &mut Vec<Action>) {
        let Some(p) = self.peer(device) else { return };
        let hal = text.to_ascii_lowercase().contains("grblhal");
        let other = match p.dialect {
            Dialect::Grbl if hal => Some("grblhal"),
            Dialect::GrblHal if !hal => Some("grbl"),
            _ => None,
        };
        if let Some(other) = other {
            let what = format!("it says '{text}'; use --dialect {other}");
            return self.fail(Ending::NotReady { device, what }, out);
        }
        self.begin_talk(device, out);
    }

    pub(super) fn alarm(&self, device: Device, code: Option<u32>) -> String {
        let dialect = self.peers[device.index()].as_ref().map_or(self.setup.control, |p| p.dialect);
        match code {
            Some(c) => {
                let meaning = dialect.alarm_meaning(c).unwrap_or("not in the table");
                format!("{c}, {meaning}")
            }
            None => "its number could not be read".into(),
        }
    }

    /// What an answer did to the lines of a device.
    pub(super) fn take(&mut self, device: Device, heard: Heard, out: &mut Vec<Action>) {
        match heard {
            Heard::Nothing => {}
            Heard::Answered(tag) => self.answered(device, tag, out),
            Heard::Again(tag) => {
                // Lines counted as answered by an ok that was another's.
                if let Tag::Line(i) = tag {
                    self.confirmed = self.confirmed.min(i);
                }
                out.push(Action::Note(Note::Again { number: self.number(tag) }));
            }
            Heard::GaveUp(tag) => {
                let number = self.number(tag);
                self.fail(Ending::GaveUp { device, number }, out);
            }
            Heard::Garbled(what) => self.fail(Ending::Garbled { device, what }, out),
            Heard::Refused { tag: Tag::Modes, .. } if !self.vouch.is_on() => {
                self.write(device, Tag::Modes, "", out);
            }
            Heard::Refused { tag: Tag::Clear, .. } => self.answered(device, Tag::Clear, out),
            Heard::Refused { tag, code, text } => {
                let dialect = self.peers[device.index()].as_ref().map(|p| p.dialect);
                let meaning = code.and_then(|c| dialect?.error_meaning(c));
                let code = meaning.map_or(text.clone(), |m| format!("{text}, {m}"));
                let (number, line) = (self.number(tag), self.text(tag));
                self.fail(Ending::Refused { device, number, line, code }, out);
            }
        }
    }

    fn answered(&mut self, device: Device, tag: Tag, out: &mut Vec<Action>) {
        match tag {
            Tag::Line(i) => {
                // A named answer, or one found by asking again, stands for those before it.
                self.confirmed = self.confirmed.max(i + 1);
                self.vouch.confirmed(self.confirmed);
                if self.passed_a_pause(device, i) {
                    let number = self.setup.script.number(i);
                    let what = "it went on where it should have paused".into();
                    return self.fail(Ending::Departed { lines: [number; 2], what }, out);
                }
                self.told_to_go_on = false;
                if self.waits {
                    self.waits = false;
                    out.push(Action::Note(Note::GoesOn));
                }
                out.push(Action::Note(Note::Confirmed(self.confirmed)));
            }
            Tag::Drain { last: true } if self.setup.control.is_grbl() => {
                // Lines written behind it would still move.
                if self.all_idle() {
                    self.settle(out);
                } else {
                    self.drain = Drain::Dirty;
                }
            }
            Tag::Clear => self.ask(device, 1, out),
            Tag::Ask if self.setup.control.is_grbl() && device == Device::Control => {
                let asked = match self.peer(device).map(|p| p.greeting) {
                    Some(Greeting::Asking(n)) => n,
                    _ => return,
                };
                // Counted on, one answer too many would let the window run over.
                if self.peer(device).is_some_and(|p| p.told == [true, false]) {
                    let what = "an answer to nothing it was asked".into();
                    return self.fail(Ending::Garbled { device, what }, out);
                }
                if asked < ASKS {
                    self.ask(device, asked + 1, out);
                } else if self.setup.check {
                    self.write(device, Tag::Check, "$C", out);
                } else {
                    self.ask_modes(device, out);
                }
            }
            Tag::Modes => self.modes(device, out),
            Tag::Ask | Tag::Check => self.ready(device),
            Tag::Drain { .. } => {}
        }
    }

    /// Whether an M0 was answered that neither held the machine nor waited for a person.
    fn passed_a_pause(&self, device: Device, i: usize) -> bool {
        let pauses = self.setup.script.line(i).is_some_and(|l| l.class == Class::Pause);
        let m0 = || {
            let words = read_block(self.setup.script.text(i)).unwrap_or_default();
            words.iter().any(|w| w.letter == 'M' && w.value == 0.0)
        };
        let by_hand = self.told_to_go_on || self.waits;
        let grbl = device == Device::Control && self.setup.control.is_grbl();
        pauses && grbl && !self.setup.check && !by_hand && m0()
    }

    fn ask(&mut self, device: Device, n: u8, out: &mut Vec<Action>) {
        if let Some(p) = self.peer(device) {
            p.greeting = Greeting::Asking(n);
            p.told = [p.told[0] || p.told[1], false];
        }
        self.write(device, Tag::Ask, "$I", out);
    }

    /// Asks for the parser's state before the first line, unless the device repeats every line.
    fn ask_modes(&mut self, device: Device, out: &mut Vec<Action>) {
        let Some(p) = self.peer(device) else { return };
        if p.link.means() != Means::Unproven {
            return self.ready(device);
        }
        p.greeting = Greeting::Modes;
        self.write(device, Tag::Modes, ASK_STATE, out);
    }

    /// The parser's state was told, or was not.
    fn modes(&mut self, device: Device, out: &mut Vec<Action>) {
        let Some(p) = self.peer(device) else { return };
        let (told, greets) = (p.parser.take(), p.greeting == Greeting::Modes);
        if greets {
            if let Some(state) = told {
                let rests = self.status.as_ref().filter(|s| s.state == State::Idle);
                let at = rests.and_then(|s| self.work_position(s));
                self.vouch.begin(&state, at.as_deref());
            }
            return self.ready(device);
        }
        let Some(told) = told else { return self.out_of_step(device, out) };
        if let Some((number, what)) = self.vouch.told(&told) {
            self.fail(Ending::Departed { lines: [number; 2], what }, out);
        }
    }

    fn out_of_step(&mut self, device: Device, out: &mut Vec<Action>) {
        let what = "answers are out of step with the lines".into();
        self.fail(Ending::Garbled { device, what }, out);
    }

    /// Holds a status report against the path.
    fn vouch_for(&mut self, status: &Status, out: &mut Vec<Action>) {
        let Some(at) = self.work_position(status) else { return };
        let over = self.drain == Drain::Clean && self.all_idle();
        let wrong = match status.state {
            State::Idle if over => {
                let line = self.setup.script.number(self.next.saturating_sub(1));
                self.vouch.rest(&at).map(|what| ([line; 2], what))
            }
            State::Run if over => {
                let line = self.setup.script.number(self.next.saturating_sub(1));
                Some(([line; 2], "it moves although every motion should be over".into()))
            }
            State::Idle | State::Run | State::Hold(_) => self.vouch.place(&at, self.confirmed),
            _ => None,
        };
        if let Some((lines, what)) = wrong {
            self.fail(Ending::Departed { lines, what }, out);
        }
    }

    fn ready(&mut self, device: Device) {
        if let Some(p) = self.peer(device) {
            p.greeting = Greeting::Ready;
        }
    }

    /// The answer to M114, behind M400: every motion is over.
    fn position(&mut self, device: Device, at: Vec<f64>, out: &mut Vec<Action>) {
        if device != Device::Control || self.drain != Drain::Asked {
            return;
        }
        self.status = Some(Status {
            state: State::Idle,
            machine: None,
            work: Some(at),
            offset: None,
            feed_speed: None,
            overrides: None,
            buffer: None,
            line: None,
        });
        self.settle(out);
    }

    fn status(&mut self, status: &Status, out: &mut Vec<Action>) {
        if status.offset.is_some() {
            self.offset = status.offset.clone();
        }
        self.status = Some(status.clone());
        out.push(Action::Note(Note::Status(Box::new(status.clone()))));
        let device = Device::Control;
        match status.state {
            State::Alarm | State::Sleep => {
                let what = "its status says so".to_string();
                let ending = match self.phase {
                    Phase::Greeting => Ending::NotReady {
                        device,
                        what: "it is locked by an alarm; home it, or unlock it by hand".into(),
                    },
                    _ => Ending::Alarm { device, what },
                };
                return self.fail(ending, out);
            }
            State::Idle | State::Check => {}
            _ => {
                self.resting = None;
                if let Phase::Finishing { idle } = &mut self.phase {
                    *idle = 0;
                }
            }
        }
        let open = self.peers[0].as_ref().is_some_and(|p| !p.link.is_idle());
        if matches!(status.state, State::Idle | State::Check) && open {
            self.resting = self.resting.or(Some(self.now));
        }
        match self.phase {
            Phase::Greeting => self.status_at_start(status.state, out),
            Phase::Running | Phase::Finishing { .. } => {
                self.status_in_job(status.state, out);
                self.vouch_for(status, out);
            }
            _ => {}
        }
    }

    fn status_at_start(&mut self, state: State, out: &mut Vec<Action>) {
        let device = Device::Control;
        if self.peer(device).map(|p| p.greeting) != Some(Greeting::State) {
            return;
        }
        if state == State::Idle {
            // What an earlier sender left in the line buffer must not begin our first line.
            if let Some(p) = self.peer(device) {
                p.greeting = Greeting::Asking(0);
            }
            self.write(device, Tag::Clear, "", out);
        } else {
            let what = format!("it is not at rest but in state {state:?}");
            self.fail(Ending::NotReady { device, what }, out);
        }
    }

    fn status_in_job(&mut self, state: State, out: &mut Vec<Action>) {
        match state {
            State::Idle | State::Check => {
                let quiet = self.all_idle();
                if let Phase::Finishing { idle } = &mut self.phase
                    && quiet
                {
                    *idle = (*idle + 1).min(IDLE_REPORTS);
                }
            }
            State::Hold(_) | State::Door | State::Tool if !self.waits => {
                self.waits = true;
                let oldest = self.peers[0].as_ref().and_then(|p| p.link.oldest());
                let number = oldest.map_or(0, |t| self.number(t));
                let why = match state {
                    State::Door => "the safety door is open",
                    State::Tool => "a tool change",
                    _ if self.waits_in_flight() => "the program pauses",
                    _ => "the machine is held",
                };
                out.push(Action::Note(Note::Waits { number, why }));
            }
            State::Run if self.waits && !self.waits_in_flight() => {
                self.waits = false;
                out.push(Action::Note(Note::GoesOn));
            }
            _ => {}
        }
    }

    /// Replies while stopping: only what tells how far the stop is.
    fn hear_stopping(&mut self, device: Device, reply: &Reply, out: &mut Vec<Action>) {
        let mut ignored = Vec::new();
        match reply {
            Reply::Ok { .. } | Reply::Error { .. } | Reply::Resend(_) => {
                let Some(p) = self.peer(device) else { return };
                let heard = match &mut p.link {
                    Link::Counted(_) => p.link.hear(reply, &mut ignored),
                    Link::Numbered(_) => match reply {
                        Reply::Ok { .. } => p.link.hear(reply, &mut ignored),
                        _ => Heard::Nothing,
                    },
                };
                if let Heard::Answered(Tag::Line(i)) = heard {
                    self.confirmed = self.confirmed.max(i + 1);
                }
                let ok = matches!(reply, Reply::Ok { .. });
                self.stop_answered(device, ok, out);
            }
            Reply::Status(s) => {
                if s.offset.is_some() {
                    self.offset = s.offset.clone();
                }
                self.status = Some((**s).clone());
                out.push(Action::Note(Note::Status(s.clone())));
                self.stop_status(s, out);
            }
            Reply::Alarm(_) => self.stop_event(device, stop::Sign::Alarm, out),
            Reply::Banner(_) => self.stop_event(device, stop::Sign::Banner, out),
            _ => {}
        }
    }
}
