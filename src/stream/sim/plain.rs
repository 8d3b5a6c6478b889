//! An Arduino with the extruder module: one line in, one answer out.

use super::{BOOTING, Record, SimSetup, run_module};
use crate::stream::core::{Micros, SECOND};
use crate::stream::modal::Module;
use std::collections::VecDeque;

/// What the module takes to do something.
const ACTING: Micros = SECOND / 50;

#[derive(Clone, Debug)]
pub struct Plain {
    setup: SimSetup,
    ring: VecDeque<u8>,
    line: Vec<u8>,
    /// Until when it acts, and the answer it then gives.
    acts: Option<(Micros, String)>,
    /// Until when it boots.
    boots: Micros,
    pub(super) out: Vec<u8>,
    pub(super) record: Record,
}

impl Plain {
    pub(super) fn new(setup: SimSetup) -> Plain {
        Plain {
            setup,
            ring: VecDeque::new(),
            line: Vec::new(),
            acts: None,
            boots: 0,
            out: b"ready\n".to_vec(),
            record: Record::default(),
        }
    }

    pub(super) fn power_cycle(&mut self, now: Micros) {
        self.boots = now + BOOTING;
        self.ring.clear();
        self.line.clear();
        self.acts = None;
        self.record.module = Module::default();
        self.out.extend_from_slice(b"ready\n");
    }

    pub(super) fn receive(&mut self, bytes: &[u8], now: Micros) {
        self.advance(now);
        for b in bytes {
            if now < self.boots {
                self.record.deaf += 1;
                continue;
            }
            if self.ring.len() >= self.setup.dialect.receive_bytes() {
                self.record.overrun += 1;
            } else {
                self.ring.push_back(*b);
            }
            self.run(now);
        }
    }

    pub(super) fn advance(&mut self, now: Micros) {
        if self.acts.as_ref().is_some_and(|(until, _)| now >= *until)
            && let Some((_, answer)) = self.acts.take()
        {
            self.out.extend_from_slice(answer.as_bytes());
            self.out.push(b'\n');
        }
        self.run(now);
    }

    pub(super) fn next(&self) -> Option<Micros> {
        self.acts.as_ref().map(|(until, _)| *until)
    }

    fn run(&mut self, now: Micros) {
        while self.acts.is_none() {
            let Some(b) = self.ring.pop_front() else { return };
            if b != b'\n' {
                self.line.push(b);
                continue;
            }
            let line = std::mem::take(&mut self.line);
            let text = String::from_utf8_lossy(&line).trim().to_string();
            if text.is_empty() {
                continue;
            }
            self.record.lines += 1;
            let code = text.strip_prefix('M').and_then(|d| d.parse().ok());
            let known = code.is_some_and(|c| run_module(&self.setup, c, &mut self.record.module));
            let answer = match (known, self.setup.echo) {
                (false, _) => format!("error: unknown '{text}'"),
                (true, true) => format!("ok {text}"),
                (true, false) => "ok".into(),
            };
            if self.setup.records {
                self.record.read.push((text.clone(), known));
                self.record.run.extend(known.then_some(text));
            }
            self.acts = Some((now + ACTING, answer));
        }
    }
}
