//! Numbered lines with a checksum, and lines asked for again.
//!
//! ```text
//! N<n> text*<c>      c: exclusive or of all bytes before the star
//! ```
//!
//! The device takes line n only after n − 1 and only undamaged, so each is run once and in order
//! whatever the answers say; answers only tell how many lines it has room for. `answered` may
//! therefore be one too many for a while, when an `ok` belonged to a request: the request for a
//! line that was counted as answered takes it back.

use super::link::{Heard, Tag};
use crate::stream::Reply;
use std::collections::VecDeque;

/// Lines kept to be written again: many times what a device holds.
const HISTORY: usize = 64;

/// How often one line is written again before the link is given up.
const MOST_REPEATS: u32 = 10;

/// Lines already counted as taken that may still be refused: more than any device queues.
const REFUSED_LATE: u32 = 8;

/// Sets the device's count to zero.
const BEGIN: &[u8] = b"\nN0 M110 N0*125\n";

#[derive(Clone, Debug)]
struct Sent {
    tag: Tag,
    wire: Vec<u8>,
}

#[derive(Clone, Debug)]
pub(super) struct Numbered {
    most: u32,
    /// Whether the count was set and answered.
    begun: bool,
    /// Number of the next new line.
    next: u32,
    /// Every line up to this one is answered.
    answered: u32,
    /// Number of the next line to write; behind `next` while lines are repeated.
    cursor: u32,
    /// Lines `next − history.len()` to `next − 1`.
    history: VecDeque<Sent>,
    /// The last request: its line, and how many more requests for it lines already written may
    /// still cause.
    asked: Option<(u32, u32)>,
    repeats: u32,
    /// Whether this device sends an `ok` after a request, once that is known.
    ok_follows: Option<bool>,
    /// The last reply was a request, which an `ok` may follow.
    just_asked: bool,
    /// The oldest line was written again because no answer came.
    probing: bool,
}

/// The line as it is written.
fn framed(number: u32, text: &str) -> Vec<u8> {
    let body = format!("N{number} {text}");
    let sum = body.bytes().fold(0, |a, b| a ^ b);
    format!("{body}*{sum}\n").into_bytes()
}

impl Numbered {
    pub fn new(most: usize) -> Numbered {
        Numbered {
            most: u32::try_from(most).unwrap_or(1).max(1),
            begun: false,
            next: 1,
            answered: 0,
            cursor: 1,
            history: VecDeque::new(),
            asked: None,
            repeats: 0,
            ok_follows: None,
            just_asked: false,
            probing: false,
        }
    }

    pub fn clear(&mut self) {
        *self = Numbered::new(self.most as usize);
    }

    pub fn room(&self) -> bool {
        self.begun && self.cursor == self.next && self.next - 1 - self.answered < self.most
    }

    pub fn is_idle(&self) -> bool {
        self.begun && self.answered + 1 == self.next
    }

    pub fn push(&mut self, tag: Tag, text: &str) -> Vec<u8> {
        if tag == Tag::Ask {
            return BEGIN.to_vec();
        }
        let wire = framed(self.next, text);
        self.history.push_back(Sent { tag, wire: wire.clone() });
        if self.history.len() > HISTORY {
            self.history.pop_front();
        }
        self.next += 1;
        self.cursor = self.next;
        wire
    }

    pub fn oldest(&self) -> Option<Tag> {
        if self.begun { self.sent(self.answered + 1).map(|s| s.tag) } else { Some(Tag::Ask) }
    }

    fn sent(&self, number: u32) -> Option<&Sent> {
        let back = self.next.checked_sub(number)? as usize;
        self.history.get(self.history.len().checked_sub(back)?)
    }

    pub fn hear(&mut self, reply: &Reply, again: &mut Vec<u8>) -> Heard {
        let just_asked = std::mem::take(&mut self.just_asked);
        match reply {
            Reply::Ok { number, .. } => self.ok(*number, just_asked, again),
            Reply::Resend(Some(n)) => self.resend(*n, just_asked, again),
            Reply::Resend(None) => {
                self.just_asked = true;
                Heard::Nothing
            }
            Reply::Unknown(text) => self.unknown(text),
            _ => Heard::Nothing,
        }
    }

    fn ok(&mut self, number: Option<u32>, just_asked: bool, again: &mut Vec<u8>) -> Heard {
        if !self.begun {
            // After a request the count may not have been set.
            if just_asked {
                again.extend_from_slice(BEGIN);
                return Heard::Nothing;
            }
            self.begun = true;
            return Heard::Answered(Tag::Ask);
        }
        if just_asked && self.ok_follows == Some(true) {
            return Heard::Nothing;
        }
        // Nothing undamaged is outstanding, so it can only be the request's.
        if just_asked && self.asked.is_some_and(|(n, _)| self.answered + 1 >= n) {
            self.ok_follows = Some(true);
            return Heard::Nothing;
        }
        let next = match number {
            // Some name the line they answer; the number itself may be damaged.
            Some(n) if n <= self.answered || n >= self.cursor => return Heard::Nothing,
            Some(n) => n,
            None => self.answered + 1,
        };
        if next >= self.cursor {
            return Heard::Nothing;
        }
        // Lines skipped by a named answer were taken before it.
        self.answered = next;
        self.probing = false;
        self.repeats = 0;
        let tag = self.sent(next).map(|s| s.tag);
        self.write_on(again);
        tag.map_or(Heard::Nothing, Heard::Answered)
    }

    fn resend(&mut self, n: u32, just_asked: bool, again: &mut Vec<u8>) -> Heard {
        if just_asked && self.ok_follows.is_none() {
            self.ok_follows = Some(false);
        }
        self.just_asked = true;
        if !self.begun {
            return Heard::Nothing;
        }
        // The number itself can be damaged: only lines that were written can be asked for. The
        // one after the last is what a device that has them all asks for.
        let has_all = n == self.next && self.probing;
        if n == 0 || (self.sent(n).is_none() && !has_all) {
            return Heard::Nothing;
        }
        if let Some((asked, stale)) = self.asked
            && asked == n
            && stale > 0
        {
            self.asked = Some((n, stale - 1));
            return Heard::Nothing;
        }
        if self.asked.is_none_or(|(asked, _)| asked != n) {
            self.repeats = 0;
        }
        self.repeats += 1;
        if self.repeats > MOST_REPEATS {
            return self.sent(n).map_or(Heard::Nothing, |s| Heard::GaveUp(s.tag));
        }
        // Lines written after n are refused as well, each with a request of its own.
        let stale = self.cursor.saturating_sub(n + 1);
        self.asked = Some((n, stale));
        let before = self.answered;
        if self.probing || n <= self.answered {
            self.answered = n - 1;
        }
        self.probing = false;
        self.cursor = n;
        self.write_on(again);
        if self.answered > before {
            // Taken long ago, with the answers lost.
            return self.sent(self.answered).map_or(Heard::Nothing, |s| Heard::Answered(s.tag));
        }
        self.sent(n).map_or(Heard::Nothing, |s| Heard::Again(s.tag))
    }

    /// An unknown command is the fault of its line only when it is one of ours: a damaged line
    /// that lost its number reads as one, and is asked for again.
    fn unknown(&mut self, text: &str) -> Heard {
        let plain = |wire: &[u8]| -> String {
            let line = String::from_utf8_lossy(wire);
            let body = line.split_once(' ').map_or("", |(_, b)| b);
            body.rsplit_once('*').map_or(body, |(b, _)| b).to_string()
        };
        // A request for a later line may have come first and counted this one as taken.
        let from = (self.answered + 1).saturating_sub(REFUSED_LATE);
        let mut open = (from..self.cursor).filter_map(|n| self.sent(n));
        let ours = |line: String| {
            // A lost line end makes two lines one, and the sum agrees once in 256.
            !text.is_empty() && (line.starts_with(text) || text.starts_with(&format!("{line}*")))
        };
        match open.find(|s| ours(plain(&s.wire))) {
            Some(s) => {
                let text = format!("unknown command {text}");
                Heard::Refused { tag: s.tag, code: None, text }
            }
            None => Heard::Nothing,
        }
    }

    /// Repeats lines while the device has room for them.
    fn write_on(&mut self, again: &mut Vec<u8>) {
        while self.cursor < self.next && self.cursor - 1 - self.answered < self.most {
            let Some(sent) = self.sent(self.cursor) else { return };
            again.extend_from_slice(&sent.wire);
            self.cursor += 1;
        }
    }

    pub fn late(&mut self, again: &mut Vec<u8>) -> Heard {
        self.repeats += 1;
        let oldest = self.oldest();
        if self.repeats > MOST_REPEATS {
            return oldest.map_or(Heard::Nothing, Heard::GaveUp);
        }
        if !self.begun {
            again.extend_from_slice(BEGIN);
            return Heard::Nothing;
        }
        let Some(sent) = self.sent(self.answered + 1) else { return Heard::Nothing };
        // What is left of a damaged line must not spoil the repeat.
        again.push(b'\n');
        again.extend_from_slice(&sent.wire);
        self.probing = true;
        self.asked = None;
        Heard::Nothing
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn begun() -> Numbered {
        let mut n = Numbered::new(4);
        assert_eq!(n.push(Tag::Ask, ""), b"\nN0 M110 N0*125\n");
        assert_eq!(hear(&mut n, "ok"), (Heard::Answered(Tag::Ask), String::new()));
        n
    }

    fn hear(n: &mut Numbered, line: &str) -> (Heard, String) {
        let mut again = Vec::new();
        let reply = Reply::read(crate::stream::Dialect::Marlin, Some(line));
        let heard = n.hear(&reply, &mut again);
        (heard, String::from_utf8(again).unwrap())
    }

    #[test]
    fn a_request_rewinds_and_repeats_of_it_are_ignored() {
        let mut n = begun();
        for i in 0..4 {
            assert!(n.room());
            n.push(Tag::Line(i), &format!("G1 X{i}"));
        }
        assert!(!n.room());
        assert_eq!(hear(&mut n, "ok").0, Heard::Answered(Tag::Line(0)));
        let (heard, again) = hear(&mut n, "Resend: 2");
        assert_eq!(heard, Heard::Again(Tag::Line(1)));
        assert_eq!(again.matches('N').count(), 3);
        assert_eq!(hear(&mut n, "ok"), (Heard::Nothing, String::new()), "the request's own");
        for _ in 0..2 {
            assert_eq!(hear(&mut n, "Resend: 2"), (Heard::Nothing, String::new()));
            assert_eq!(hear(&mut n, "ok"), (Heard::Nothing, String::new()));
        }
        for i in 1..4 {
            assert_eq!(hear(&mut n, "ok").0, Heard::Answered(Tag::Line(i)));
        }
        assert!(n.is_idle());
    }

    #[test]
    fn absurd_numbers_are_ignored_and_ten_repeats_end_it() {
        let mut n = begun();
        n.push(Tag::Line(0), "G1 X0");
        for line in ["Resend: 0", "Resend: 2", "Resend: 77", "rs N9999999", "Resend: x"] {
            assert_eq!(hear(&mut n, line), (Heard::Nothing, String::new()), "{line}");
        }
        for _ in 0..10 {
            assert_eq!(hear(&mut n, "rs 1").0, Heard::Again(Tag::Line(0)));
        }
        assert_eq!(hear(&mut n, "rs 1").0, Heard::GaveUp(Tag::Line(0)));
    }

    #[test]
    fn lost_answers_are_found_by_asking_again() {
        let mut n = begun();
        for i in 0..3 {
            n.push(Tag::Line(i), "G1 X1");
        }
        let mut again = Vec::new();
        assert_eq!(n.late(&mut again), Heard::Nothing);
        assert_eq!(again, [b"\n".to_vec(), framed(1, "G1 X1")].concat());
        // The device has all three and asks for the fourth.
        assert_eq!(hear(&mut n, "Resend: 4").0, Heard::Answered(Tag::Line(2)));
        assert!(n.is_idle());
    }

    #[test]
    fn only_a_command_of_ours_is_refused_as_unknown() {
        let mut n = begun();
        n.push(Tag::Line(0), "M72");
        assert_eq!(hear(&mut n, "echo:Unknown command: \"1 M72*33\"").0, Heard::Nothing);
        assert!(matches!(hear(&mut n, "echo:Unknown command: \"M72\"").0, Heard::Refused { .. }));
    }
}
