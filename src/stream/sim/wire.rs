//! What crossed a line to a device, for tests: each line as it was written and as it arrived.
//!
//! A line is *whole* when none of its bytes, and neither of the ends around it, was damaged. Only
//! devices without numbered lines are looked at; realtime bytes are left out for those that take
//! them out of the line.

use crate::stream::Dialect;

/// A line as the device could read it; empty ones are left out.
#[derive(Clone, Debug, PartialEq)]
pub struct Arrival {
    pub text: String,
    /// First and last written line of which it is, by index.
    pub lines: [usize; 2],
    pub whole: bool,
    /// How many resets came before it.
    pub era: usize,
}

/// A line to a device, watched.
#[derive(Clone, Debug)]
pub struct Wire {
    grbl: bool,
    sent: Vec<u8>,
    part: Vec<u8>,
    touched: bool,
    /// First written line of which nothing ended yet.
    from: usize,
    /// Lines as they arrived, in order.
    pub arrived: Vec<Arrival>,
    /// Lines as they were written, in order; empty ones are left out.
    pub written: Vec<String>,
    /// Resets so far, by the byte 0x18 or by the supply; what was received and not read is gone.
    pub eras: usize,
}

impl Wire {
    pub(super) fn new(dialect: Dialect) -> Wire {
        Wire {
            grbl: dialect.is_grbl(),
            sent: Vec::new(),
            part: Vec::new(),
            touched: false,
            from: 0,
            arrived: Vec::new(),
            written: Vec::new(),
            eras: 0,
        }
    }

    fn realtime(&self, b: u8) -> bool {
        self.grbl && (b >= 0x80 || b"?!~\x18".contains(&b))
    }

    /// The supply dips.
    pub(super) fn power_cycle(&mut self) {
        // The rest of the line that was cut begins the next.
        self.touched |= !self.sent.is_empty();
        self.reset();
    }

    fn reset(&mut self) {
        self.part.clear();
        self.eras += 1;
    }

    /// A byte is written, and heard as these.
    pub(super) fn carry(&mut self, b: u8, arrives: &[u8]) {
        // A status request that is lost changes no line.
        self.touched |= arrives != [b] && !(self.realtime(b) && arrives.is_empty());
        if b == 0x18 && self.grbl {
            // What was written of a line is void on both ends.
            self.sent.clear();
            self.touched = arrives != [b];
            self.from = self.written.len();
        } else if b != b'\n' && !self.realtime(b) {
            self.sent.push(b);
        }
        let mut ended = false;
        for a in arrives {
            match a {
                0x18 if self.grbl => self.reset(),
                b'\n' => {
                    self.end_arrived();
                    ended = true;
                }
                b'\r' if self.grbl => self.end_arrived(),
                a if self.realtime(*a) => {}
                a => self.part.push(*a),
            }
        }
        if b == b'\n' {
            let text = text_of(&std::mem::take(&mut self.sent));
            if !text.is_empty() {
                self.written.push(text);
            }
            // Without its end it runs into the next.
            if ended {
                (self.touched, self.from) = (false, self.written.len());
            }
        }
    }

    fn end_arrived(&mut self) {
        let text = text_of(&std::mem::take(&mut self.part));
        if !text.is_empty() {
            let next = self.written.len();
            let last = if self.sent.is_empty() { next.saturating_sub(1) } else { next };
            let lines = [self.from.min(last), last];
            let whole = !self.touched && lines[0] == last;
            self.arrived.push(Arrival { text, lines, whole, era: self.eras });
            self.from = next;
        }
    }
}

fn text_of(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).trim().to_string()
}
