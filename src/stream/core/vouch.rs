//! What a controller says of itself, held against the program.
//!
//! Method: the program is run along with the lines that are written, so that its modal state behind
//! each and the path of those that may be under way are known. Every status report must place the
//! machine on that path; at rest behind a barrier, where the path ends. The parser's state (`$G`),
//! asked behind each line that has more than coordinates, must be the program's behind that line.
//!
//! Guarantees: no false alarm from holds, overrides, pauses, tool changes, homing or jogs, since only
//! what a controller reports in motion or at rest of the program counts, and since the path is kept
//! for as many motions as its planner may hold. Reports are heard in the order they were made in
//! among the answers, so that none is older than the answers before it.
//!
//! Not guaranteed: a wrong coordinate is seen only when a report falls on its detour and the detour is
//! larger than the tolerance. Dwells, probing, canned cycles and stored offsets show in neither.
//! Nothing is compared behind a change of the work coordinate system or of what scales it, and Z
//! not behind a tool length offset: reports do not say with which offset they were made. A tool
//! counts once it was changed for.
//!
//! Lengths mm, feeds mm/min.

use crate::gcode::{Word, read_block};
use crate::stream::Class;
use crate::stream::modal::{Modal, Rates, Spindle, Way, tenths};
use crate::stream::path::{Point, distance, off_segment};
use std::collections::VecDeque;

/// How far off its path a machine in motion may be reported, mm: steps of three axes, chords of arcs
/// and the report's last digit. Smaller, and coarse steps count as a fault; larger, and more damage
/// goes unseen.
const PATH_TOLERANCE: f64 = 0.05;

/// How far from where motions end it may rest, mm: a step and the last digit of a report. Smaller,
/// and rounding counts as a fault; larger, and more damage goes unseen.
pub(super) const REST_TOLERANCE: f64 = 0.02;

/// How far a feed or a speed may be from the program's: controllers report them without decimals.
const RATE_TOLERANCE: f64 = 0.51;

/// Millimetres of the units that reports may be in; which one is a setting of the controller.
const UNITS: [f64; 2] = [1.0, 25.4];

/// Pieces beyond which those that must be over are dropped between reports too.
const MANY: usize = 2048;

/// Rates, which only tell times here.
const RATES: Rates = Rates { rapid_mm_min: 1.0, max_feed_mm_min: 1.0, rapid_deg_min: 1.0 };

/// How often what was held against the program.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Checks {
    /// Reports whose place lay on the path.
    pub places: usize,
    /// Those of them at rest where the motions so far end.
    pub rests: usize,
    /// Parser states that were the program's.
    pub states: usize,
}

/// A coordinate that a line begins or ends at.
#[derive(Clone, Copy, Debug, PartialEq)]
enum At {
    Mm(f64),
    /// Where the machine was before the first line, in the units of its reports.
    Start(f64),
    Lost,
}

impl At {
    fn mm(self, unit: f64) -> Option<f64> {
        match self {
            At::Mm(v) => Some(v),
            At::Start(v) => Some(v * unit),
            At::Lost => None,
        }
    }
}

/// Where one line leads.
#[derive(Clone, Debug)]
enum Course {
    Straight([At; 3], [At; 3]),
    /// Somewhere in a ball: the disc of an arc.
    Within(Point, f64),
    Anywhere,
}

#[derive(Clone, Debug)]
struct Piece {
    line: usize,
    number: u32,
    course: Course,
}

/// What the parser must say.
#[derive(Clone, Debug)]
struct Wanted {
    number: u32,
    modal: Modal,
    outputs: Outputs,
}

/// What of the modal state can be told.
#[derive(Clone, Copy, Debug)]
struct Outputs {
    spindle: bool,
    coolant: bool,
    /// Everything else.
    modes: bool,
}

/// The program run along with what is written, for one controller.
#[derive(Clone, Debug)]
pub(super) struct Vouch {
    /// The controller tells its parser's state, and nothing better vouches for its lines.
    on: bool,
    modal: Modal,
    outputs: Outputs,
    /// Work coordinates of reports are those of the program.
    same_frame: bool,
    /// So is Z.
    z_known: bool,
    path: VecDeque<Piece>,
    /// Where the machine was before the first line, axes that it has not left since.
    start: [Option<f64>; 3],
    wanted: VecDeque<Wanted>,
    /// Units that reports may be in, as far as they have told.
    units: [bool; 2],
    /// Motions that may be answered and still lie ahead.
    pub blocks: usize,
    pub checks: Checks,
}

impl Vouch {
    pub fn new(blocks: usize) -> Vouch {
        Vouch {
            on: false,
            modal: Modal::default(),
            outputs: Outputs { spindle: true, coolant: true, modes: true },
            same_frame: true,
            z_known: true,
            path: VecDeque::new(),
            start: [None; 3],
            wanted: VecDeque::new(),
            units: [true; 2],
            blocks,
            checks: Checks::default(),
        }
    }

    pub fn is_on(&self) -> bool {
        self.on
    }

    /// The parser's state before the first line, and where the machine rests.
    pub fn begin(&mut self, parser: &str, at: Option<&[f64]>) {
        self.start = std::array::from_fn(|i| at?.get(i).copied());
        let m = &mut self.modal;
        for word in parser.split_whitespace() {
            let code = word.get(1..).and_then(|d| d.parse().ok());
            match (word.get(..1), code) {
                (Some("G"), Some(system @ 54..=59)) => m.system = system,
                (Some("G"), Some(plane @ 17..=19)) => m.plane = plane,
                (Some("G"), Some(units @ 20..=21)) => m.inches = units == 20,
                (Some("G"), Some(distance @ 90..=91)) => m.relative = distance == 91,
                (Some("G"), Some(feed @ 93..=94)) => m.inverse_time = feed == 93,
                (Some("G"), Some(0)) => m.way = Way::Rapid,
                (Some("G"), Some(1)) => m.way = Way::Feed,
                (Some("G"), Some(way @ 2..=3)) => m.way = Way::Arc { clockwise: way == 2 },
                (Some("M"), Some(3)) => m.spindle = Spindle::Clockwise,
                (Some("M"), Some(4)) => m.spindle = Spindle::Counter,
                (Some("M"), Some(7)) => m.mist = true,
                (Some("M"), Some(8)) => m.flood = true,
                _ => {}
            }
        }
        self.on = true;
    }

    /// A person may have switched the coolant over the program's head.
    pub fn coolant_switched(&mut self) {
        self.outputs.coolant = false;
    }

    /// A line was written; whether the parser's state is worth asking behind it.
    pub fn wrote(&mut self, line: usize, number: u32, text: &str, class: Class) -> bool {
        if !self.on {
            return false;
        }
        let words = read_block(text).unwrap_or_default();
        if text.starts_with('$') {
            // Homing, or a setting: steps, units of reports, limits.
            self.same_frame &= text == "$H";
            self.outputs.modes &= text == "$H";
            self.lost(line, number);
            return false;
        }
        let (before, from) = (self.modal.clone(), self.now_at());
        for w in &words {
            self.look_at(w);
        }
        let effect = self.modal.apply(&words, &RATES);
        for (i, letter) in ['X', 'Y', 'Z'].into_iter().enumerate() {
            if words.iter().any(|w| w.letter == letter) {
                self.start[i] = None;
            }
        }
        self.same_frame &= self.modal.system == before.system && !self.shifts(&words);
        self.z_known &= self.modal.length.is_none();
        match class {
            Class::ToolChange => {
                // The machine may go to a place of its own, and the person move it.
                self.lost(line, number);
                (self.outputs.spindle, self.outputs.coolant) = (false, false);
            }
            Class::End => {
                // It selects the first system again.
                self.same_frame &= self.modal.system == 54;
                self.outputs.modes = false;
            }
            _ if matches!(self.modal.way, Way::Probe | Way::Cycle) && effect.moves => {
                self.lost(line, number);
            }
            // To a stored position.
            _ if words.iter().any(|w| w.letter == 'G' && matches!(w.value, 28.0 | 30.0)) => {
                self.lost(line, number);
            }
            _ if effect.moves => {
                let course = self.course(&words, from);
                self.path.push_back(Piece { line, number, course });
            }
            _ => {}
        }
        words.iter().any(|w| !"XYZABCIJKRN".contains(w.letter))
    }

    /// Whether a block sets the offset that holds; others that are stored do not matter.
    fn shifts(&self, words: &[Word]) -> bool {
        let code = |w: &Word| (w.letter == 'G').then(|| tenths(w.value)).flatten();
        let system = words.iter().find(|w| w.letter == 'P').and_then(|w| tenths(w.value));
        words.iter().filter_map(code).any(|c| match c {
            100 => system.is_none_or(|p| p == 0 || p / 10 + 53 == self.modal.system),
            920..=923 => true,
            _ => false,
        })
    }

    fn look_at(&mut self, w: &Word) {
        let Some(code) = tenths(w.value) else { return };
        match (w.letter, code) {
            ('G', 50 | 51 | 70 | 80 | 330 | 500 | 510 | 591..=593 | 680 | 690 | 950 | 960) => {
                // Scaling, diameters, further systems, feeds and speeds of other kinds.
                (self.same_frame, self.outputs.modes) = (false, false);
            }
            ('G', 430..=439 | 490) => self.z_known = false,
            ('M', 30 | 40 | 50) => self.outputs.spindle = true,
            ('M', 70 | 80 | 90) => self.outputs.coolant = true,
            // State saved, restored and overridden.
            ('M', 480..=560 | 700..=730) => {}
            _ => {}
        }
    }

    /// Where the machine goes is not the program's to say.
    fn lost(&mut self, line: usize, number: u32) {
        (self.modal.work, self.start) = ([None; 6], [None; 3]);
        self.path.push_back(Piece { line, number, course: Course::Anywhere });
    }

    /// Where the lines so far lead.
    fn now_at(&self) -> [At; 3] {
        std::array::from_fn(|i| match (self.modal.work[i], self.start[i]) {
            (Some(v), _) => At::Mm(v),
            (None, Some(v)) => At::Start(v),
            (None, None) => At::Lost,
        })
    }

    fn course(&self, words: &[Word], from: [At; 3]) -> Course {
        let to = self.now_at();
        if !matches!(self.modal.way, Way::Arc { .. }) {
            return Course::Straight(from, to);
        }
        let all = |v: [At; 3]| {
            let v = v.map(|at| if let At::Mm(v) = at { Some(v) } else { None });
            Some([v[0]?, v[1]?, v[2]?])
        };
        let (Some(a), Some(b)) = (all(from), all(to)) else { return Course::Anywhere };
        let unit = if self.modal.inches { 25.4 } else { 1.0 };
        let word = |l| words.iter().find(|w| w.letter == l).map(|w| w.value * unit);
        let centre = match word('R') {
            Some(_) => std::array::from_fn(|i| (a[i] + b[i]) / 2.0),
            None => {
                let i = ['I', 'J', 'K'].map(|l| word(l).unwrap_or(0.0));
                std::array::from_fn(|k| a[k] + i[k])
            }
        };
        // The far side of an arc by its radius is no more than twice that from its chord.
        let reach = distance(a, centre).max(distance(b, centre));
        Course::Within(centre, reach.max(2.0 * word('R').unwrap_or(0.0).abs()))
    }

    /// Asked for the parser's state, as it is behind everything written.
    pub fn ask(&mut self, number: u32) {
        let (modal, outputs) = (self.modal.clone(), self.outputs);
        self.wanted.push_back(Wanted { number, modal, outputs });
    }

    /// The answer: the line behind which it was asked, and what is not as it should be.
    pub fn told(&mut self, parser: &str) -> Option<(u32, String)> {
        let wanted = self.wanted.pop_front()?;
        let wrong = wanted.differs(parser);
        self.checks.states += usize::from(wrong.is_none());
        wrong.map(|what| (wanted.number, what))
    }

    /// All motions are over.
    pub fn settled(&mut self) {
        self.path.clear();
    }

    /// Drops motions that must be over: as many later ones were answered as the planner holds.
    fn prune(&mut self, confirmed: usize) {
        let answered = self.path.partition_point(|p| p.line < confirmed);
        let counts = |p: &Piece| match p.course {
            // A motion to where the machine is takes no room in the planner.
            Course::Straight(from, to) => {
                let moves = |(a, b): (&At, &At)| matches!((a, b), (At::Mm(a), At::Mm(b)) if a != b);
                from.iter().zip(&to).any(moves)
            }
            Course::Within(..) | Course::Anywhere => false,
        };
        let mut ahead = 0;
        for i in (0..answered).rev() {
            if ahead > self.blocks {
                self.path.drain(..=i);
                return;
            }
            ahead += usize::from(counts(&self.path[i]));
        }
    }

    /// Lines were answered.
    pub fn confirmed(&mut self, confirmed: usize) {
        if self.path.len() > MANY {
            self.prune(confirmed);
        }
    }

    /// A report in motion: the lines between which the machine should be, and where it is.
    pub fn place(&mut self, at: &[f64], confirmed: usize) -> Option<([u32; 2], String)> {
        let &[x, y, z, ..] = at else { return None };
        if !self.on || !self.same_frame {
            return None;
        }
        self.prune(confirmed);
        let first = self.path.front()?;
        let lines = [first.number, self.path.back()?.number];
        if self.path.iter().any(|p| matches!(p.course, Course::Anywhere)) {
            return None;
        }
        let off = |unit: f64| {
            let p = [x, y, z].map(|v| v * unit);
            let all = self.path.iter().map(|piece| piece.off(p, unit, self.z_known));
            all.fold(f64::INFINITY, f64::min)
        };
        self.checks.places += 1;
        let offs = UNITS.map(off);
        let off = self.in_units(offs, PATH_TOLERANCE)?;
        Some((lines, format!("it is at X{x:.3} Y{y:.3} Z{z:.3}, {off:.3} mm off the path")))
    }

    /// A report at rest with every motion over: what is wrong with its place.
    pub fn rest(&mut self, at: &[f64]) -> Option<String> {
        if !self.on || !self.same_frame || at.len() < 3 {
            return None;
        }
        let ends = self.now_at();
        let axes = if self.z_known { 3 } else { 2 };
        let off = |unit: f64| {
            let each = (0..axes).filter_map(|i| Some((at[i] * unit - ends[i].mm(unit)?).abs()));
            each.fold(0.0, f64::max)
        };
        self.checks.rests += 1;
        let offs = UNITS.map(off);
        let off = self.in_units(offs, REST_TOLERANCE)?;
        let [x, y, z] = [at[0], at[1], at[2]];
        Some(format!("it rests at X{x:.3} Y{y:.3} Z{z:.3}, {off:.3} mm from where it should"))
    }

    /// How far off a place is, if it is in all units that reports may be in.
    fn in_units(&mut self, offs: [f64; 2], tolerance: f64) -> Option<f64> {
        let fits: [bool; 2] = std::array::from_fn(|i| self.units[i] && offs[i] <= tolerance);
        if fits == [false; 2] {
            let known = (0..2).filter(|i| self.units[*i]).map(|i| offs[i]);
            return Some(known.fold(f64::INFINITY, f64::min));
        }
        self.units = fits;
        None
    }
}

impl Piece {
    /// Distance of a point; axes that are not known do not count.
    fn off(&self, p: Point, unit: f64, z_known: bool) -> f64 {
        match self.course {
            Course::Anywhere => 0.0,
            Course::Within(centre, reach) => {
                let mut c = centre;
                if !z_known {
                    c[2] = p[2];
                }
                (distance(p, c) - reach).max(0.0)
            }
            Course::Straight(from, to) => {
                let (mut a, mut b, mut p) = (p, p, p);
                for i in 0..3 {
                    match (from[i].mm(unit), to[i].mm(unit)) {
                        (Some(f), Some(t)) if i < 2 || z_known => (a[i], b[i]) = (f, t),
                        _ => (a[i], b[i], p[i]) = (0.0, 0.0, 0.0),
                    }
                }
                off_segment(p, a, b)
            }
        }
    }
}

impl Wanted {
    /// What of a parser's state is not as the program has it.
    fn differs(&self, parser: &str) -> Option<String> {
        let told: Vec<&str> = parser.split_whitespace().collect();
        let m = &self.modal;
        let mut words: Vec<&str> = Vec::new();
        if self.outputs.spindle {
            words.push(match m.spindle {
                Spindle::Clockwise => "M3",
                Spindle::Counter => "M4",
                Spindle::Off => "M5",
            });
        }
        if self.outputs.coolant {
            words.extend(m.mist.then_some("M7"));
            words.extend(m.flood.then_some("M8"));
            words.extend((!m.mist && !m.flood).then_some("M9"));
        }
        let system = format!("G{}", m.system);
        let plane = format!("G{}", m.plane);
        if self.outputs.modes {
            words.extend(match m.way {
                Way::Rapid => Some("G0"),
                Way::Feed => Some("G1"),
                Way::Arc { clockwise } => Some(if clockwise { "G2" } else { "G3" }),
                Way::Probe | Way::Cycle | Way::None => None,
            });
            words.extend([&*system, &plane]);
            words.push(if m.inches { "G20" } else { "G21" });
            words.push(if m.relative { "G91" } else { "G90" });
            words.push(if m.inverse_time { "G93" } else { "G94" });
        }
        if let Some(missing) = words.into_iter().find(|w| !told.contains(w)) {
            return Some(format!("{missing} does not hold, '{parser}' does"));
        }
        if !self.outputs.modes {
            return None;
        }
        let figure =
            |letter: char| told.iter().find_map(|w| w.strip_prefix(letter)?.parse::<f64>().ok());
        let feed = m.feed.filter(|_| !m.inverse_time);
        let is = |told: f64, want: f64| {
            UNITS.iter().any(|u| (told * u - want).abs() <= RATE_TOLERANCE * u)
        };
        // Some name the tool in the spindle, others the one that was selected.
        let tool = m.tool.filter(|t| m.loaded == Some(*t)).map(f64::from);
        match (figure('F').zip(feed), figure('S').zip(m.speed), figure('T').zip(tool)) {
            (Some((told, want)), ..) if !is(told, want) => {
                Some(format!("the feed is {told}, it should be {want}"))
            }
            (_, Some((told, want)), _) if (told - want).abs() > RATE_TOLERANCE => {
                Some(format!("the speed is {told}, it should be {want}"))
            }
            (.., Some((told, want))) if told != want => {
                Some(format!("the tool is {told}, it should be {want}"))
            }
            _ => None,
        }
    }
}
