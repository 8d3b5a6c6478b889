//! How a job is stopped, by a person or by a fault.
//!
//! grbl and grblHAL: hold, wait until it rests, reset (the position is then kept and no alarm
//! raised), then the codes that switch off what neither hold nor reset does: the extruder on its
//! own board, and after a person's stop spindle and coolant for good measure. Marlin and
//! RepRapFirmware: quick stop, then the same codes, without numbers, since the device may be in
//! the middle of anything. A controller that raised an alarm gets a reset alone; one that began
//! anew, halted or hung up gets nothing. `$X` is never sent.

use super::{Action, Core, Device, Micros, Note, Phase};
use crate::stream::outcome::{Ending, Position};
use crate::stream::{State, Status};
use std::collections::VecDeque;

pub(super) const HOLD: u8 = b'!';
pub(super) const RESET: u8 = 0x18;

/// What a stop waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Wait {
    Rest,
    Reset,
    /// The answer of a device to a code that switches something off.
    Off(Option<Device>),
}

/// A line that tells how far a stop is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Sign {
    Alarm,
    Banner,
}

/// A stop under way.
pub(super) struct Stop {
    ending: Ending,
    wait: Wait,
    until: Micros,
    in_flight: Option<[u32; 2]>,
    position: Position,
    last: Option<Status>,
    off: VecDeque<(Device, String)>,
    not_off: Vec<String>,
    /// The controller came back from its reset.
    back: bool,
}

impl Stop {
    pub fn polls(&self) -> bool {
        self.wait == Wait::Rest
    }

    pub fn in_flight(&self) -> Option<[u32; 2]> {
        self.in_flight
    }
}

/// How the controller is brought to rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Brake {
    HoldThenReset,
    ResetNow,
    QuickStop,
    Nothing,
}

impl Core {
    /// Something ends the job early.
    pub(super) fn fail(&mut self, ending: Ending, out: &mut Vec<Action>) {
        match self.phase {
            // The first reason is the one that counts.
            Phase::Over | Phase::Stopping(_) => return,
            // Nothing of the program was written yet, or nothing moves.
            Phase::Greeting => {
                for device in Device::BOTH {
                    out.push(Action::Discard(device));
                }
                return self.end(ending, out);
            }
            _ if matches!(ending, Ending::Astray { .. }) => return self.end(ending, out),
            _ => {}
        }
        for device in Device::BOTH {
            if self.peer(device).is_some() {
                out.push(Action::Discard(device));
            }
        }
        out.push(Action::Note(Note::Stopping(ending.to_string())));
        let brake = self.brake(&ending);
        let limits = self.setup.limits;
        let (wait, until) = match brake {
            Brake::HoldThenReset => {
                out.push(Action::Realtime(Device::Control, HOLD));
                (Wait::Rest, self.now + limits.hold)
            }
            Brake::ResetNow => {
                if matches!(ending, Ending::Silent { .. }) {
                    out.push(Action::Realtime(Device::Control, HOLD));
                }
                out.push(Action::Realtime(Device::Control, RESET));
                (Wait::Reset, self.now + limits.reset)
            }
            Brake::QuickStop => {
                out.push(Action::Write(Device::Control, b"\nM410\n".to_vec()));
                (Wait::Rest, self.now + limits.off)
            }
            Brake::Nothing => (Wait::Off(None), self.now),
        };
        self.phase = Phase::Stopping(Box::new(Stop {
            ending,
            wait,
            until,
            in_flight: self.in_flight(),
            position: Position::Unknown,
            last: None,
            off: VecDeque::new(),
            not_off: Vec::new(),
            back: false,
        }));
        self.polled = 0;
        if brake == Brake::Nothing {
            self.begin_off(out);
        }
    }

    fn brake(&self, ending: &Ending) -> Brake {
        let own = ending.device() == Some(Device::Control);
        let gone =
            matches!(ending, Ending::HungUp { .. } | Ending::Reset { .. } | Ending::Halted { .. });
        if (own && gone) || self.peers[0].as_ref().is_none_or(|p| p.hung_up) {
            return Brake::Nothing;
        }
        match self.setup.control {
            d if d.is_numbered() => Brake::QuickStop,
            d if !d.is_grbl() => Brake::Nothing,
            _ if own && matches!(ending, Ending::Alarm { .. } | Ending::Silent { .. }) => {
                Brake::ResetNow
            }
            _ => Brake::HoldThenReset,
        }
    }

    fn stopping(&mut self) -> Option<&mut Stop> {
        match &mut self.phase {
            Phase::Stopping(s) => Some(s),
            _ => None,
        }
    }

    /// Time passes.
    pub(super) fn stop_step(&mut self, out: &mut Vec<Action>) {
        let now = self.now;
        let dead = self.peers[0].as_ref().is_none_or(|p| p.hung_up);
        let grbl = self.setup.control.is_grbl();
        let Some(s) = self.stopping() else { return };
        let gone = dead && matches!(s.wait, Wait::Rest | Wait::Reset);
        if now < s.until && !gone {
            return;
        }
        match s.wait {
            _ if gone => self.begin_off(out),
            Wait::Rest if grbl => self.reset(out),
            Wait::Rest => {
                // Lines that were in the queue when the first came have moved since.
                out.push(Action::Write(Device::Control, b"\nM410\n".to_vec()));
                self.begin_off(out);
            }
            Wait::Reset => self.begin_off(out),
            Wait::Off(_) => self.off_unanswered(out),
        }
    }

    fn reset(&mut self, out: &mut Vec<Action>) {
        let until = self.now + self.setup.limits.reset;
        out.push(Action::Realtime(Device::Control, RESET));
        if let Some(s) = self.stopping() {
            (s.wait, s.until) = (Wait::Reset, until);
        }
    }

    /// A status report: two that agree tell that the machine rests, and where. One alone may be
    /// damaged, and a resume would begin there.
    pub(super) fn stop_status(&mut self, status: &Status, out: &mut Vec<Action>) {
        let position = Position::Known {
            machine: self.machine_position(status),
            work: self.work_position(status),
        };
        let Some(s) = self.stopping() else { return };
        if s.wait != Wait::Rest {
            return;
        }
        let rests = matches!(
            status.state,
            State::Hold(0) | State::Idle | State::Check | State::Door | State::Tool
        );
        let place = |s: &Status| (s.state, s.machine.clone(), s.work.clone());
        let agrees = s.last.as_ref().is_some_and(|l| place(l) == place(status));
        s.last = Some(status.clone());
        if rests && agrees {
            // Where it is counts for nothing once it did what it was not told.
            if !matches!(s.ending, Ending::Departed { .. }) {
                s.position = position;
            }
            self.reset(out);
        } else if status.state == State::Alarm {
            self.reset(out);
        }
    }

    pub(super) fn stop_event(&mut self, device: Device, sign: Sign, out: &mut Vec<Action>) {
        if device != Device::Control {
            return;
        }
        let Some(s) = self.stopping() else { return };
        match (sign, s.wait) {
            (Sign::Alarm, _) => s.position = Position::Unknown,
            (Sign::Banner, Wait::Reset) => {
                s.back = true;
                self.begin_off(out);
            }
            // It reset before it was told to.
            (Sign::Banner, Wait::Rest) => {
                s.position = Position::Unknown;
                self.begin_off(out);
            }
            (Sign::Banner, Wait::Off(_)) => {}
        }
    }

    /// What must be switched off, and where that may be said.
    fn begin_off(&mut self, out: &mut Vec<Action>) {
        let (grbl, extrudes) = (self.setup.control.is_grbl(), self.setup.script.extrudes());
        let own_board = self.peers[1].is_some();
        let alive = |p: &Option<super::Peer>| p.as_ref().is_some_and(|p| !p.hung_up);
        let [control_alive, extruder_alive] = [alive(&self.peers[0]), alive(&self.peers[1])];
        let module = self.setup.module_off.clone();
        let outputs = self.setup.control.outputs_off();
        let Some(s) = self.stopping() else { return };
        let own_fault = s.ending.device() == Some(Device::Control);
        let gone = own_fault
            && matches!(
                s.ending,
                Ending::Reset { .. }
                    | Ending::Halted { .. }
                    | Ending::Alarm { .. }
                    | Ending::Silent { .. }
            );
        let control = control_alive && !gone && (s.back || !grbl);
        let mut off = VecDeque::new();
        if extrudes {
            let (device, hears) = match own_board {
                true => (Device::Extruder, extruder_alive),
                false => (Device::Control, control),
            };
            match hears {
                true => off.extend(module.into_iter().map(|c| (device, c))),
                false => s.not_off.extend(module),
            }
        }
        // The reset of a controller at fault has switched them off, and nothing more is said to it.
        let resets = grbl && own_fault;
        if control && !resets {
            off.extend(outputs.iter().map(|c| (Device::Control, c.to_string())));
        } else if !control_alive || (gone && !grbl) {
            s.not_off.extend(outputs.iter().map(ToString::to_string));
        }
        s.off = off;
        for p in self.peers.iter_mut().flatten() {
            if p.dialect.is_grbl() {
                p.link.clear();
            }
        }
        self.next_off(out);
    }

    fn next_off(&mut self, out: &mut Vec<Action>) {
        let until = self.now + self.setup.limits.off;
        let Some(s) = self.stopping() else { return };
        let Some((device, code)) = s.off.front().cloned() else {
            let (ending, position) = (s.ending.clone(), s.position.clone());
            let not_off = std::mem::take(&mut s.not_off);
            return self.end_at(ending, position, not_off, out);
        };
        (s.wait, s.until) = (Wait::Off(Some(device)), until);
        let grbl = self.peer(device).is_some_and(|p| p.dialect.is_grbl());
        // Ends what may be left of a line that was being written.
        let before = if grbl { "" } else { "\n" };
        out.push(Action::Write(device, format!("{before}{code}\n").into_bytes()));
    }

    pub(super) fn stop_answered(&mut self, device: Device, ok: bool, out: &mut Vec<Action>) {
        let Some(s) = self.stopping() else { return };
        if s.wait != Wait::Off(Some(device)) {
            return;
        }
        if let Some((_, code)) = s.off.pop_front()
            && !ok
        {
            s.not_off.push(code);
        }
        self.next_off(out);
    }

    fn off_unanswered(&mut self, out: &mut Vec<Action>) {
        let Some(s) = self.stopping() else { return };
        if let Some((_, code)) = s.off.pop_front() {
            s.not_off.push(code);
        }
        self.next_off(out);
    }

    /// Asked to stop again: resets at once; asked a third time, leaves.
    pub(super) fn stop_harder(&mut self, out: &mut Vec<Action>) {
        let grbl = self.setup.control.is_grbl();
        let extrudes = self.setup.script.extrudes();
        let module = if extrudes { self.setup.module_off.clone() } else { Vec::new() };
        let outputs = self.setup.control.outputs_off();
        let Some(s) = self.stopping() else { return };
        if s.wait == Wait::Rest {
            s.position = Position::Unknown;
            if grbl {
                return self.reset(out);
            }
            out.push(Action::Write(Device::Control, b"\nM112\n".to_vec()));
            return self.begin_off(out);
        }
        if s.wait == Wait::Reset {
            // Nothing was said yet to what must be off, and the reset itself is not confirmed.
            s.not_off.extend(module);
            s.not_off.extend(outputs.iter().map(ToString::to_string));
        }
        let rest: Vec<String> = s.off.drain(..).map(|(_, c)| c).collect();
        s.not_off.extend(rest);
        let (ending, position) = (s.ending.clone(), s.position.clone());
        let not_off = std::mem::take(&mut s.not_off);
        self.end_at(ending, position, not_off, out);
    }
}
