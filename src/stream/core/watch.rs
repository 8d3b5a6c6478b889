//! Silence and lost answers: what did not come, and for how long it may not.

use super::link::Tag;
use super::{Action, Core, Device, Drain, Greeting, Micros, Note, SECOND};
use crate::stream::outcome::Ending;

/// Seconds a controller may rest with a line unanswered, besides its dwell.
const REST: Micros = 3 * SECOND;

/// Quiet after which a numbered line is written again.
const LATE: Micros = 2 * SECOND;

/// Homing may be silent.
const HOMING: Micros = 120 * SECOND;

impl Core {
    /// Whether the oldest unanswered line of the controller waits for a person.
    pub(super) fn waits_in_flight(&self) -> bool {
        let oldest = self.peers[0].as_ref().and_then(|p| p.link.oldest());
        matches!(oldest, Some(Tag::Line(i))
            if self.setup.script.line(i).is_some_and(|l| l.class.waits_for_person()))
    }

    /// Time the outstanding lines may take: those unanswered, and those answered whose motions
    /// may still lie ahead.
    pub(super) fn allowance(&self) -> Micros {
        let from = self.confirmed.saturating_sub(self.setup.control.planner_blocks());
        let script = &self.setup.script;
        let seconds = script.seconds(self.next) - script.seconds(from);
        // Acceleration and overrides stretch them.
        (2.0 * seconds * SECOND as f64) as Micros
    }

    /// Looks for silence and lost answers.
    pub(super) fn watch(&mut self, out: &mut Vec<Action>) {
        for device in Device::BOTH {
            let Some(p) = &self.peers[device.index()] else { continue };
            if p.greeting == Greeting::Banner {
                continue;
            }
            let quiet = self.now - p.heard;
            if p.dialect.is_grbl() {
                let homing = matches!(p.link.oldest(), Some(Tag::Line(i))
                    if self.setup.script.text(i) == "$H");
                let most = self.setup.limits.silence + if homing { HOMING } else { 0 };
                if quiet >= most {
                    return self.fail(silent(device, quiet), out);
                }
                if device == Device::Control && self.unanswered_at_rest() {
                    return self.fail(Ending::Unanswered { device }, out);
                }
                continue;
            }
            let oldest = p.link.oldest();
            if device == Device::Control && self.waits_in_flight() && !self.waits {
                self.waits = true;
                let number = oldest.map_or(0, |t| self.number(t));
                out.push(Action::Note(Note::Waits { number, why: "the program pauses" }));
            }
            let waiting = !p.link.is_idle() || self.drain_unanswered(device);
            let pauses = self.waits_in_flight() && !self.told_to_go_on;
            if !waiting || self.held_by_person || pauses {
                continue;
            }
            let since = quiet.min(self.now - p.wrote);
            let allowance = if device == Device::Control { self.allowance() } else { 0 };
            if quiet >= self.setup.limits.answer + allowance
                && self.now - p.heard.max(p.wrote) >= LATE
            {
                return self.fail(silent(device, quiet), out);
            }
            if since >= LATE + allowance && p.dialect.is_numbered() {
                self.late(device, out);
            }
        }
    }

    pub(super) fn drain_unanswered(&self, device: Device) -> bool {
        device == Device::Control && self.drain == Drain::Asked
    }

    /// A numbered device owes an answer: writes again what it may not have got.
    pub(super) fn late(&mut self, device: Device, out: &mut Vec<Action>) {
        let now = self.now;
        let Some(p) = self.peer(device) else { return };
        p.wrote = now;
        if p.link.is_idle() {
            // Everything is answered but the position, which was damaged on its way.
            self.write(device, Tag::Drain { last: true }, "M114", out);
            return;
        }
        let mut again = Vec::new();
        let heard = p.link.late(&mut again);
        if !again.is_empty() {
            out.push(Action::Write(device, again));
        }
        self.take(device, heard, out);
    }

    /// Whether the controller rests although lines are unanswered: their answers were lost.
    pub(super) fn unanswered_at_rest(&self) -> bool {
        let Some(since) = self.resting else { return false };
        let script = &self.setup.script;
        let lines = script.lines();
        let dwell: f32 =
            lines[self.confirmed.min(self.next)..self.next].iter().map(|l| l.dwell_s).sum();
        self.now - since >= REST + (f64::from(dwell) * SECOND as f64) as Micros
    }
}

fn silent(device: Device, quiet: Micros) -> Ending {
    Ending::Silent { device, seconds: quiet as f64 / SECOND as f64 }
}
