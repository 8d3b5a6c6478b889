//! The simulated planner: blocks that take time, and holds that come to rest.

use crate::stream::core::{Micros, SECOND};
use std::collections::VecDeque;

/// How long a hold takes to come to rest: some 50 mm/s at 1 m/s².
const SLOWING: Micros = SECOND / 20;

#[derive(Clone, Debug)]
struct Block {
    text: String,
    from: [f64; 6],
    to: [f64; 6],
    takes: Micros,
}

/// Motions to come and where the machine is.
#[derive(Clone, Debug)]
pub(super) struct Motion {
    blocks: VecDeque<Block>,
    capacity: usize,
    /// When the first block began, its held time not counted.
    began: Micros,
    at: [f64; 6],
    /// When a hold comes to rest.
    rests: Option<Micros>,
    speed: f64,
}

impl Motion {
    pub fn new(capacity: usize, speed: f64) -> Motion {
        let blocks = VecDeque::new();
        Motion { blocks, capacity, began: 0, at: [0.0; 6], rests: None, speed }
    }

    pub fn is_empty(&self) -> bool {
        self.blocks.is_empty()
    }

    pub fn is_full(&self) -> bool {
        self.blocks.len() >= self.capacity
    }

    pub fn free(&self) -> usize {
        self.capacity - self.blocks.len()
    }

    /// Whether a hold was asked for, and whether it has come to rest.
    pub fn held(&self, now: Micros) -> Option<bool> {
        self.rests.map(|t| now >= t)
    }

    pub fn at(&self, now: Micros) -> [f64; 6] {
        let Some(b) = self.blocks.front() else { return self.at };
        let until = self.rests.map_or(now, |t| t.min(now));
        let spent = until.saturating_sub(self.began).min(b.takes);
        let f = if b.takes == 0 { 1.0 } else { spent as f64 / b.takes as f64 };
        std::array::from_fn(|i| b.from[i] + f * (b.to[i] - b.from[i]))
    }

    /// Adds a motion; returns its text at once when it takes no time.
    pub fn push(&mut self, text: &str, to: [f64; 6], seconds: f64, now: Micros) -> Option<String> {
        if self.speed <= 0.0 {
            self.at = to;
            return Some(text.into());
        }
        let from = self.blocks.back().map_or(self.at, |b| b.to);
        if self.blocks.is_empty() {
            self.began = now;
        }
        let takes = (seconds / self.speed * SECOND as f64) as Micros;
        self.blocks.push_back(Block { text: text.into(), from, to, takes });
        None
    }

    /// Lets time pass; calls `done` with each line whose motion is over.
    pub fn advance(&mut self, now: Micros, mut done: impl FnMut(String)) {
        let until = self.rests.map_or(now, |t| t.min(now));
        while let Some(b) = self.blocks.front() {
            let end = self.began + b.takes;
            if end > until {
                break;
            }
            self.at = b.to;
            self.began = end;
            if let Some(b) = self.blocks.pop_front() {
                done(b.text);
            }
        }
    }

    pub fn next(&self) -> Option<Micros> {
        let end = self.blocks.front().map(|b| self.began + b.takes);
        match (end, self.rests) {
            (Some(e), Some(r)) => Some(e.min(r)),
            (e, None) => e,
            (None, r) => r,
        }
    }

    pub fn hold(&mut self, now: Micros) {
        if self.rests.is_none() {
            self.rests = Some(if self.blocks.is_empty() { now } else { now + SLOWING });
        }
    }

    pub fn resume(&mut self, now: Micros) {
        if let Some(rests) = self.rests.take() {
            // The time at rest does not count.
            self.began += now.saturating_sub(rests);
        }
    }

    /// Whether anything turns right now.
    pub fn moves(&self, now: Micros) -> bool {
        !self.blocks.is_empty() && self.rests.is_none_or(|t| now < t)
    }

    /// Drops all motions; the machine stays where it is.
    pub fn clear(&mut self, now: Micros) {
        self.at = self.at(now);
        self.blocks.clear();
        self.rests = None;
    }

    pub fn set(&mut self, at: [f64; 6]) {
        self.at = at;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hold_keeps_place_and_time() {
        let mut m = Motion::new(4, 1.0);
        let to = [10.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        m.push("a", to, 1.0, 0);
        m.hold(450_000);
        assert_eq!(m.held(460_000), Some(false));
        assert_eq!(m.at(SECOND)[0], 5.0);
        assert_eq!(m.held(500_000), Some(true));
        m.advance(9 * SECOND, |_| panic!("it is held"));
        m.resume(10 * SECOND);
        let mut done = Vec::new();
        m.advance(10 * SECOND + 499_999, |t| done.push(t));
        assert!(done.is_empty());
        m.advance(10 * SECOND + 500_000, |t| done.push(t));
        assert_eq!((done, m.at(11 * SECOND)[0]), (vec!["a".to_string()], 10.0));
    }
}
