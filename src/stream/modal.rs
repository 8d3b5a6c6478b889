//! A program's modal state and the time its motions take, line after line.
//!
//! Times are lengths over feeds, with the profile's rapid rates; acceleration is left out, so they
//! are a lower bound. Positions are what the program says; after a move in machine coordinates the
//! work position of its axes is not known, and the other way round.

use super::script::ModuleCode;
use crate::gcode::Word;
use crate::machine::Machine;

/// Letters of the axes, in the order of the arrays below.
pub const AXES: [char; 6] = ['X', 'Y', 'Z', 'A', 'B', 'C'];

/// Rates of motions whose speed the program does not say.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates {
    pub rapid_mm_min: f64,
    pub max_feed_mm_min: f64,
    pub rapid_deg_min: f64,
}

impl Rates {
    pub fn of(machine: &Machine) -> Rates {
        let k = &machine.kinematics;
        Rates {
            rapid_mm_min: machine.control.rapid_mm_min,
            max_feed_mm_min: machine.control.max_feed_mm_min,
            rapid_deg_min: k.first.rapid_deg_min.min(k.second.rapid_deg_min),
        }
    }
}

/// How axis words move the tool.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    Rapid,
    Feed,
    Arc { clockwise: bool },
    Probe,
    Cycle,
    None,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Spindle {
    Off,
    Clockwise,
    Counter,
}

/// The extruder module as the program's codes leave it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Module {
    pub open: bool,
    pub on: bool,
    pub drawn: bool,
}

impl Module {
    /// What a code does to it.
    pub fn run(&mut self, code: ModuleCode) {
        match code {
            ModuleCode::Open => self.open = true,
            ModuleCode::Close => self.open = false,
            ModuleCode::On => self.on = true,
            ModuleCode::Off => self.on = false,
            ModuleCode::Draw => self.drawn = true,
            ModuleCode::Give => self.drawn = false,
        }
    }
}

/// What holds at some line of a program.
#[derive(Clone, Debug, PartialEq)]
pub struct Modal {
    pub way: Way,
    pub plane: u32,
    pub inches: bool,
    pub relative: bool,
    pub inverse_time: bool,
    /// Work coordinate system, 54 to 59.
    pub system: u32,
    /// Offsets set by G92 or G10 in the program itself, which a resume cannot set again.
    pub shifted: bool,
    /// H word of G43.
    pub length: Option<u32>,
    /// mm/min.
    pub feed: Option<f64>,
    pub speed: Option<f64>,
    pub spindle: Spindle,
    pub mist: bool,
    pub flood: bool,
    pub tool: Option<u32>,
    /// Tool in the spindle after M6.
    pub loaded: Option<u32>,
    pub module: Module,
    /// Programmed work position, mm and degrees.
    pub work: [Option<f64>; 6],
    /// Position in machine coordinates where G53 set it.
    pub machine: [Option<f64>; 6],
}

impl Default for Modal {
    fn default() -> Self {
        Modal {
            way: Way::None,
            plane: 17,
            inches: false,
            relative: false,
            inverse_time: false,
            system: 54,
            shifted: false,
            length: None,
            feed: None,
            speed: None,
            spindle: Spindle::Off,
            mist: false,
            flood: false,
            tool: None,
            loaded: None,
            module: Module::default(),
            work: [None; 6],
            machine: [None; 6],
        }
    }
}

/// What one block does.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Effect {
    pub seconds: f64,
    /// Part of `seconds` that is a dwell.
    pub dwell_s: f64,
    pub moves: bool,
}

/// A code in tenths: G38.2 is 382.
pub fn tenths(value: f64) -> Option<u32> {
    let t = (value * 10.0).round();
    ((t / 10.0 - value).abs() < 1e-6 && (0.0..100_000.0).contains(&t)).then_some(t as u32)
}

impl Modal {
    /// Runs one block.
    pub fn apply(&mut self, words: &[Word], rates: &Rates) -> Effect {
        let value = |letter| words.iter().find(|w| w.letter == letter).map(|w| w.value);
        let (mut in_machine, mut dwell, mut sets, mut home) = (false, false, false, false);
        for w in words {
            let Some(code) = tenths(w.value) else { continue };
            match w.letter {
                'G' => match code {
                    530 => in_machine = true,
                    40 => dwell = true,
                    280 | 300 => home = true,
                    100 | 920 | 921 | 922 | 923 | 281 | 301 => {
                        sets = true;
                        self.shifted |= !matches!(code, 281 | 301);
                    }
                    _ => self.g_code(code, value('H')),
                },
                'M' => self.m_code(code),
                _ => {}
            }
        }
        if let Some(f) = value('F').filter(|f| *f > 0.0) {
            self.feed = Some(f * if self.inches { 25.4 } else { 1.0 });
        }
        self.speed = value('S').or(self.speed);
        if let Some(t) = value('T').and_then(tenths) {
            self.tool = Some(t / 10);
        }
        if words.iter().any(|w| w.letter == 'M' && w.value == 6.0) {
            self.loaded = self.tool;
        }
        // The tool that is in the spindle already is told, not changed.
        if words.iter().any(|w| w.letter == 'M' && w.value == 61.0)
            && let Some(q) = value('Q').and_then(tenths)
        {
            (self.tool, self.loaded) = (Some(q / 10), Some(q / 10));
        }
        if dwell {
            let s = value('P').unwrap_or(0.0).max(0.0);
            return Effect { seconds: s, dwell_s: s, moves: false };
        }
        if sets {
            return Effect::default();
        }
        if home {
            (self.work, self.machine) = ([None; 6], [None; 6]);
            return Effect { moves: true, ..Effect::default() };
        }
        self.travel(words, in_machine, rates)
    }

    fn g_code(&mut self, code: u32, h: Option<f64>) {
        match code {
            0 => self.way = Way::Rapid,
            10 => self.way = Way::Feed,
            20 => self.way = Way::Arc { clockwise: true },
            30 => self.way = Way::Arc { clockwise: false },
            382..=385 => self.way = Way::Probe,
            730 | 760 | 810..=890 => self.way = Way::Cycle,
            50 | 51 | 330 => self.way = Way::Cycle,
            800 => self.way = Way::None,
            170 | 180 | 190 => self.plane = code / 10,
            200 => self.inches = true,
            210 => self.inches = false,
            430 => self.length = h.and_then(tenths).map(|t| t / 10).or(self.tool),
            490 => self.length = None,
            540..=599 if code.is_multiple_of(10) => self.system = code / 10,
            900 => self.relative = false,
            910 => self.relative = true,
            930 => self.inverse_time = true,
            940 => self.inverse_time = false,
            _ => {}
        }
    }

    fn m_code(&mut self, code: u32) {
        match code {
            30 => self.spindle = Spindle::Clockwise,
            40 => self.spindle = Spindle::Counter,
            50 => self.spindle = Spindle::Off,
            70 => self.mist = true,
            80 => self.flood = true,
            90 => (self.mist, self.flood) = (false, false),
            20 | 300 => {
                (self.spindle, self.mist, self.flood) = (Spindle::Off, false, false);
            }
            _ => {}
        }
    }

    fn travel(&mut self, words: &[Word], in_machine: bool, rates: &Rates) -> Effect {
        let unit = if self.inches { 25.4 } else { 1.0 };
        let before = if in_machine { self.machine } else { self.work };
        let (mut linear, mut turn, mut moves) = ([0.0; 3], 0.0f64, false);
        let mut to = before;
        for (i, letter) in AXES.iter().enumerate() {
            let Some(w) = words.iter().find(|w| w.letter == *letter) else { continue };
            moves = true;
            let value = w.value * if i < 3 { unit } else { 1.0 };
            to[i] = match (self.relative && !in_machine, before[i]) {
                (true, from) => from.map(|f| f + value),
                (false, _) => Some(value),
            };
            let by = match (before[i], to[i]) {
                (Some(a), Some(b)) => (b - a).abs(),
                _ if self.relative && !in_machine => value.abs(),
                _ => 0.0,
            };
            match linear.get_mut(i) {
                Some(l) => *l = by,
                None => turn = turn.max(by),
            }
            if in_machine { self.work[i] = None } else { self.machine[i] = None }
        }
        if !moves && !matches!(self.way, Way::Arc { .. }) {
            return Effect::default();
        }
        let length = match self.way {
            Way::Arc { clockwise } => {
                match arc_length(self.plane, &before, &to, words, unit, clockwise) {
                    Some(length) => length,
                    None if !moves => return Effect::default(),
                    None => hypot(&linear),
                }
            }
            _ => hypot(&linear),
        };
        if in_machine {
            self.machine = to
        } else {
            self.work = to
        }
        let rapid = (length / rates.rapid_mm_min).max(turn / rates.rapid_deg_min);
        let minutes = match (self.way, self.inverse_time, self.feed) {
            (Way::Rapid | Way::None, ..) | (_, _, None) => rapid,
            (_, true, Some(f)) => unit / f,
            // With rotary axes the feed holds for degrees where nothing linear moves.
            (_, false, Some(f)) if length > 0.0 => length / f.min(rates.max_feed_mm_min),
            (_, false, Some(f)) => turn / f,
        };
        Effect { seconds: 60.0 * minutes, dwell_s: 0.0, moves: true }
    }
}

fn hypot(v: &[f64; 3]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// Length of an arc with centre words or a radius, mm; the helix included.
fn arc_length(
    plane: u32,
    from: &[Option<f64>; 6],
    to: &[Option<f64>; 6],
    words: &[Word],
    unit: f64,
    clockwise: bool,
) -> Option<f64> {
    let [a, b, c] = match plane {
        17 => [0, 1, 2],
        18 => [2, 0, 1],
        _ => [1, 2, 0],
    };
    let word = |letter| words.iter().find(|w| w.letter == letter).map(|w| w.value * unit);
    let centre = ['I', 'J', 'K'].map(word);
    let (from_a, from_b) = (from[a]?, from[b]?);
    let (to_a, to_b) = (to[a]?, to[b]?);
    let along = match (from[c], to[c]) {
        (Some(f), Some(t)) => t - f,
        _ => 0.0,
    };
    let (radius, angle) = if let Some(r) = word('R') {
        let chord = (to_a - from_a).hypot(to_b - from_b);
        let half = 2.0 * (chord / (2.0 * r.abs())).clamp(-1.0, 1.0).asin();
        (r.abs(), if r < 0.0 { std::f64::consts::TAU - half } else { half })
    } else {
        if centre[a].is_none() && centre[b].is_none() {
            return None;
        }
        let (i, j) = (centre[a].unwrap_or(0.0), centre[b].unwrap_or(0.0));
        let start = (-j).atan2(-i);
        let end = (to_b - from_b - j).atan2(to_a - from_a - i);
        let turn = if clockwise { start - end } else { end - start };
        let turn = turn.rem_euclid(std::f64::consts::TAU);
        (i.hypot(j), if turn < 1e-9 { std::f64::consts::TAU } else { turn })
    };
    Some((radius * angle).hypot(along))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gcode::read_block;

    const RATES: Rates =
        Rates { rapid_mm_min: 6000.0, max_feed_mm_min: 3000.0, rapid_deg_min: 3600.0 };

    fn run(text: &str) -> (Modal, f64) {
        let mut m = Modal::default();
        let s = text.lines().map(|l| m.apply(&read_block(l).unwrap(), &RATES).seconds).sum();
        (m, s)
    }

    #[test]
    fn lines_arcs_dwells_and_turns_take_their_time() {
        let near = |text, s: f64| {
            let (_, got) = run(text);
            assert!((got - s).abs() < 1e-9, "{text}: {got}");
        };
        near("G21 G90\nG0 X0 Y0 Z0\nG1 X60 F600", 6.0);
        near("G0 X0 Y0\nG0 X100", 1.0);
        near("G4 P2.5", 2.5);
        near("G0 A0\nG0 A90", 1.5);
        near("G0 X10 Y0\nG3 X-10 Y0 I-10 J0 F60", 10.0 * std::f64::consts::PI);
        near("G0 X10 Y0\nG2 X10 Y0 I-10 J0 F60", 20.0 * std::f64::consts::PI);
        near("G20\nG0 X0\nG1 X1 F1", 60.0);
        near("G0 X0 Y0\nG91\nG1 X3 Y4 F60", 5.0);
    }

    #[test]
    fn the_state_is_what_the_words_say() {
        let (m, _) = run("T1 M6\nM61 Q4");
        assert_eq!((m.tool, m.loaded), (Some(4), Some(4)), "told, not changed");
        let (m, _) = run("G21\nG90\nT3 M6\nG43 H3\nS8000 M3\nM8\nG53 G0 Z700\nG0 X1 Y2\nF500");
        assert_eq!((m.loaded, m.length, m.spindle), (Some(3), Some(3), Spindle::Clockwise));
        assert_eq!((m.machine[2], m.work[2], m.work[0]), (Some(700.0), None, Some(1.0)));
        assert!(m.flood && !m.relative && m.feed == Some(500.0));
        let (m, _) = run("G91\nG83 X1\nM30");
        assert_eq!((m.way, m.relative, m.spindle), (Way::Cycle, true, Spindle::Off));
    }
}
