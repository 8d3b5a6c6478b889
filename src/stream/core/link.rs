//! One device's line: which lines were written and not answered, and whether another fits.

use super::numbered::Numbered;
use crate::stream::{Dialect, Means, Reply};
use std::collections::VecDeque;

/// Bytes of the receive buffer that are left free: a realtime byte or a doubled byte must not be
/// the one that overruns it.
const SPARE_BYTES: usize = 8;

/// What a written line is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Tag {
    /// Line of the script, by index.
    Line(usize),
    /// Clears what an earlier sender may have left behind; may be refused.
    Clear,
    /// Asks for the build information.
    Ask,
    /// Switches the check mode.
    Check,
    /// Asks for the parser's state.
    Modes,
    /// Waits for motion; the last of its lines.
    Drain { last: bool },
}

/// What an answer means for the lines.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Heard {
    Answered(Tag),
    Refused {
        tag: Tag,
        code: Option<u32>,
        text: String,
    },
    /// A line was written again; everything from it on is unanswered.
    Again(Tag),
    /// The device cannot be brought to take a line.
    GaveUp(Tag),
    /// The talk cannot be right.
    Garbled(String),
    Nothing,
}

#[derive(Clone, Debug)]
struct Sent {
    tag: Tag,
    text: String,
}

/// Lines counted in bytes: what is written and not answered never exceeds the window.
#[derive(Clone, Debug)]
pub(super) struct Counted {
    /// Bytes; None while only one line at a time is safe.
    window: Option<usize>,
    most: usize,
    used: usize,
    sent: VecDeque<Sent>,
    /// Whether the device repeats what it reads, once that is known.
    echoes: bool,
    /// How many of `sent` were repeated.
    echoed: usize,
    /// Answers, and those that repeated their line.
    answers: [u64; 2],
}

impl Counted {
    fn new(dialect: Dialect) -> Counted {
        let window = (dialect == Dialect::Plain).then(|| dialect.receive_bytes());
        Counted {
            window,
            most: dialect.lines_ahead(),
            used: 0,
            sent: VecDeque::new(),
            echoes: false,
            echoed: 0,
            answers: [0; 2],
        }
    }

    /// Whether every line is repeated, so that a damaged one cannot go unseen.
    fn repeats(&self) -> bool {
        self.echoes || (self.answers[0] > 0 && self.answers[0] == self.answers[1])
    }

    fn room(&self, bytes: usize) -> bool {
        match self.window {
            Some(window) => self.used + bytes <= window && self.sent.len() < self.most,
            None => self.sent.is_empty(),
        }
    }

    fn push(&mut self, tag: Tag, text: &str) -> Vec<u8> {
        self.used += text.len() + 1;
        self.sent.push_back(Sent { tag, text: text.into() });
        format!("{text}\n").into_bytes()
    }

    fn pop(&mut self) -> Option<Sent> {
        let sent = self.sent.pop_front()?;
        self.used -= sent.text.len() + 1;
        Some(sent)
    }

    fn ok(&mut self, text: Option<&str>) -> Heard {
        let unread = self.echoes && self.echoed == 0;
        let Some(sent) = self.pop() else {
            return Heard::Garbled("an acknowledgement too many".into());
        };
        self.echoed = self.echoed.saturating_sub(1);
        if unread {
            return Heard::Garbled(format!("'{}' was answered without being repeated", sent.text));
        }
        self.answers[0] += 1;
        self.answers[1] += u64::from(text.is_some());
        match text.filter(|t| squeezed(t) != squeezed(&sent.text)) {
            Some(other) => Heard::Garbled(format!("'{}' arrived as '{other}'", sent.text)),
            None => Heard::Answered(sent.tag),
        }
    }

    fn error(&mut self, code: Option<u32>, text: String) -> Heard {
        self.echoed = self.echoed.saturating_sub(1);
        match self.pop() {
            Some(sent) => Heard::Refused { tag: sent.tag, code, text },
            None => Heard::Garbled(format!("'{text}' with no line outstanding")),
        }
    }

    fn echo(&mut self, text: &str) -> Heard {
        self.echoes = true;
        match self.sent.get(self.echoed) {
            Some(sent) if squeezed(&sent.text) == squeezed(text) => {
                self.echoed += 1;
                Heard::Nothing
            }
            Some(sent) => Heard::Garbled(format!("'{}' arrived as '{text}'", sent.text)),
            None => Heard::Garbled(format!("'{text}' is repeated, which was never written")),
        }
    }
}

/// Without spaces and in capitals, as controllers keep a line.
fn squeezed(text: &str) -> String {
    text.bytes().filter(|b| *b != b' ').map(|b| char::from(b.to_ascii_uppercase())).collect()
}

#[derive(Clone, Debug)]
pub(super) enum Link {
    Counted(Counted),
    Numbered(Numbered),
}

impl Link {
    pub fn new(dialect: Dialect) -> Link {
        if dialect.is_numbered() {
            Link::Numbered(Numbered::new(dialect.lines_ahead()))
        } else {
            Link::Counted(Counted::new(dialect))
        }
    }

    /// Whether a line of so many bytes may be written now, its end not counted.
    pub fn room(&self, length: usize) -> bool {
        match self {
            Link::Counted(c) => c.room(length + 1),
            Link::Numbered(n) => n.room(),
        }
    }

    /// Takes a line as written; returns its bytes.
    pub fn push(&mut self, tag: Tag, text: &str) -> Vec<u8> {
        match self {
            Link::Counted(c) => c.push(tag, text),
            Link::Numbered(n) => n.push(tag, text),
        }
    }

    /// What an answer means; bytes that must be written in return go to `again`.
    pub fn hear(&mut self, reply: &Reply, again: &mut Vec<u8>) -> Heard {
        match self {
            Link::Numbered(n) => n.hear(reply, again),
            Link::Counted(c) => match reply {
                Reply::Ok { text, .. } => c.ok(text.as_deref()),
                Reply::Error { code, text } => c.error(*code, text.clone()),
                Reply::Echo(text) => c.echo(text),
                Reply::Garbled => Heard::Garbled("a reply could not be read".into()),
                _ => Heard::Nothing,
            },
        }
    }

    /// Sets the window by the size of the receive buffer. The least ever told counts, since the
    /// number itself may have been damaged on its way.
    pub fn receive_buffer(&mut self, dialect: Dialect, bytes: usize) {
        if let Link::Counted(c) = self {
            // Some advertise one byte more than they hold; none is larger than any real one.
            let window = bytes.min(4096).saturating_sub(SPARE_BYTES);
            // A buffer that cannot hold the longest line is a misreading.
            let window = (window > dialect.longest_line()).then_some(window);
            c.window = match (c.window, window) {
                (Some(a), Some(b)) => Some(a.min(b)),
                (a, b) => a.or(b),
            };
        }
    }

    /// Bytes of the window and those of it in use.
    pub fn window(&self) -> (Option<usize>, usize) {
        match self {
            Link::Counted(c) => (c.window, c.used),
            Link::Numbered(_) => (None, 0),
        }
    }

    /// What vouches for the lines written so far.
    pub fn means(&self) -> Means {
        match self {
            Link::Numbered(_) => Means::Checksum,
            Link::Counted(c) if c.repeats() => Means::Repeated,
            Link::Counted(_) => Means::Unproven,
        }
    }

    /// Whether every line was answered.
    pub fn is_idle(&self) -> bool {
        match self {
            Link::Counted(c) => c.sent.is_empty(),
            Link::Numbered(n) => n.is_idle(),
        }
    }

    /// The oldest line not answered.
    pub fn oldest(&self) -> Option<Tag> {
        match self {
            Link::Counted(c) => c.sent.front().map(|s| s.tag),
            Link::Numbered(n) => n.oldest(),
        }
    }

    /// No answer came in time: writes the oldest line again, where lines have numbers.
    pub fn late(&mut self, again: &mut Vec<u8>) -> Heard {
        match self {
            Link::Counted(_) => Heard::Nothing,
            Link::Numbered(n) => n.late(again),
        }
    }

    /// Forgets what was written: the device did.
    pub fn clear(&mut self) {
        match self {
            Link::Counted(c) => {
                c.sent.clear();
                (c.used, c.echoed) = (0, 0);
            }
            Link::Numbered(n) => n.clear(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ok() -> Reply {
        Reply::Ok { number: None, text: None }
    }

    #[test]
    fn the_window_counts_every_byte_and_each_answer_frees_its_line() {
        let mut link = Link::new(Dialect::Grbl);
        assert!(link.room(79));
        link.push(Tag::Ask, "$I");
        assert!(!link.room(1), "one line at a time until the size is known");
        link.receive_buffer(Dialect::Grbl, 128);
        assert_eq!(link.hear(&ok(), &mut Vec::new()), Heard::Answered(Tag::Ask));
        for i in 0..12 {
            assert!(link.room(9));
            link.push(Tag::Line(i), "G1X100000");
        }
        assert_eq!(link.window(), (Some(120), 120));
        assert!(!link.room(0));
        assert_eq!(link.hear(&ok(), &mut Vec::new()), Heard::Answered(Tag::Line(0)));
        assert!(link.room(9) && !link.room(10));
    }

    #[test]
    fn a_damaged_size_cannot_widen_the_window() {
        let mut link = Link::new(Dialect::Grbl);
        for told in [928, 128, 28] {
            link.receive_buffer(Dialect::Grbl, told);
        }
        assert_eq!(link.window().0, Some(120));
    }

    #[test]
    fn echoes_are_held_against_what_was_written() {
        let mut link = Link::new(Dialect::GrblHal);
        link.receive_buffer(Dialect::GrblHal, 1024);
        link.push(Tag::Line(0), "G1 x1");
        link.push(Tag::Line(1), "G1 x2");
        let mut hear = |r: Reply| link.hear(&r, &mut Vec::new());
        assert_eq!(hear(Reply::Echo("G1X1".into())), Heard::Nothing);
        assert_eq!(hear(ok()), Heard::Answered(Tag::Line(0)));
        assert!(matches!(hear(Reply::Echo("G1X3".into())), Heard::Garbled(_)));
        assert!(matches!(hear(ok()), Heard::Garbled(_)), "not repeated");
        assert!(matches!(hear(ok()), Heard::Garbled(_)), "one too many");
    }
}
