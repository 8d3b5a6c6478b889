//! Runs a program forward: modal state, then where the axes go.
//!
//! Each `M6` begins the plan's next step. Blocks are executed word group by word group; a block that
//! mixes what a control would have to order (codes and motion, turning and travelling) is refused.

mod arc;
mod extruder;

use crate::base::{DVec3, Direction};
use crate::gcode::dialect::{Dialect, Dwell, Extrusion, ModuleCodes, RS274};
use crate::gcode::report::{Finding, Rule};
use crate::gcode::words::{Word, read};
use crate::machine::{AxisValues, Indexed, Machine, Placement, RotaryAngles, Tool};
use crate::plan::{Job, Plan, StepKind};
use crate::toolpath::rest_to_rest;
use extruder::Storeys;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::gcode) enum Gait {
    Rapid,
    /// At feed; with a cutter it cuts.
    Feed,
    /// At feed while the bead is laid.
    Deposit,
}

/// One straight move of the tip, work coordinates.
#[derive(Clone, Copy, Debug)]
pub(in crate::gcode) struct Motion {
    pub line: usize,
    pub step: usize,
    pub gait: Gait,
    /// None when the program has not said where the tip stands before.
    pub from: Option<DVec3>,
    pub to: DVec3,
    pub feed: f64,
}

pub(in crate::gcode) struct Run {
    pub motions: Vec<Motion>,
    pub findings: Vec<Finding>,
    /// Line of each step's tool change.
    pub step_lines: Vec<usize>,
    /// Seconds that rotary axes turn and that the program waits, with the number of tool changes
    /// before.
    pub idle: Vec<(usize, f64)>,
}

/// What the interpreter knows of the plan.
pub(in crate::gcode) struct Setting<'a> {
    pub job: &'a Job,
    pub plan: &'a Plan,
    /// How the work stands in each step.
    pub placements: &'a [Placement],
}

/// How far below the parking height the nose may stand and still count as there, mm: the last
/// written digit.
const PARKED_MM: f64 = 0.01;

/// Largest angle between tool and step direction: rotary words have four digits, and a hundred
/// times that is still a tenth of what moves a tip by 0.01 mm at 60 mm.
const POINTING_RAD: f64 = 2e-4;

/// Findings of one rule in one step that are told; a broken step would bury the others.
pub(in crate::gcode) const MOST_FINDINGS: usize = 5;

pub(in crate::gcode) fn run(text: &str, setting: &Setting) -> Run {
    let mut it = Interpreter::new(setting);
    for (i, line) in text.lines().enumerate() {
        it.line = i + 1;
        if line.len() > it.dialect.longest_line {
            let (n, most) = (line.len(), it.dialect.longest_line);
            it.find(Rule::Syntax, format!("{n} bytes, the control takes {most}"));
        }
        if it.dialect.marks.is_some() && it.mark(line) {
            continue;
        }
        match read(line) {
            Ok(words) if words.is_empty() => {}
            Ok(words) => it.block(&words),
            Err(e) => it.find(Rule::Syntax, e.to_string()),
        }
    }
    it.finish();
    let idle = [it.turned, it.dwelt].concat();
    Run { motions: it.motions, findings: it.findings, step_lines: it.step_lines, idle }
}

struct Interpreter<'a> {
    setting: &'a Setting<'a>,
    machine: &'a Machine,
    dialect: Dialect,
    codes: Option<ModuleCodes>,
    /// Percent signs so far, where the dialect has them.
    marks: usize,
    line: usize,
    findings: Vec<Finding>,
    motions: Vec<Motion>,
    step_lines: Vec<usize>,
    turned: Vec<(usize, f64)>,
    dwelt: Vec<(usize, f64)>,
    // Modal state.
    modes: Vec<u32>,
    motion: Option<u32>,
    feed: Option<f64>,
    speed: Option<f64>,
    spindle: bool,
    open: bool,
    extruding: bool,
    drawn: bool,
    chosen: Option<f64>,
    /// Heights of the last two layers of beads in this step, mm.
    layers: [Option<f64>; 2],
    storeys: Storeys,
    /// S word of an M42 block.
    level: Option<f64>,
    compensated: bool,
    held_anew: bool,
    ended: bool,
    // Position: the spindle nose with the head at zero, machine coordinates.
    nose: [Option<f64>; 3],
    rotary: [Option<f64>; 2],
    /// The chain as it stands, and the step it stands so for.
    indexed: Option<(usize, Indexed<'a>)>,
}

/// G codes of which the others of their group cancel what a program relies on, but which do nothing
/// here: no cutter compensation, no length, no cycle, path blending.
const IDLE: [u32; 4] = [40, 49, 64, 80];

impl<'a> Interpreter<'a> {
    fn new(setting: &'a Setting<'a>) -> Self {
        let machine = &setting.job.machine;
        let dialect = Dialect::of(&machine.control);
        let unknown = Finding {
            line: 1,
            rule: Rule::Modes,
            message: format!("dialect '{}' is unknown", machine.control.dialect),
        };
        let findings = if dialect.is_some() { Vec::new() } else { vec![unknown] };
        let dialect = dialect.unwrap_or(RS274);
        Interpreter {
            setting,
            machine,
            dialect,
            codes: machine.extruder.as_ref().and_then(|e| dialect.module_codes(e)),
            marks: 0,
            line: 0,
            findings,
            motions: Vec::new(),
            step_lines: Vec::new(),
            turned: Vec::new(),
            dwelt: Vec::new(),
            modes: Vec::new(),
            motion: None,
            feed: None,
            speed: None,
            spindle: false,
            open: false,
            extruding: false,
            drawn: false,
            chosen: None,
            layers: [None; 2],
            storeys: Storeys::default(),
            level: None,
            compensated: false,
            held_anew: false,
            ended: false,
            nose: [None; 3],
            // An axis that is not there stands at zero from the beginning.
            rotary: [machine.kinematics.first, machine.kinematics.second]
                .map(|r| r.is_absent().then_some(0.0)),
            indexed: None,
        }
    }

    fn find(&mut self, rule: Rule, message: impl Into<String>) {
        let since = self.step_lines.last().copied().unwrap_or(0);
        let alike = self.findings.iter().rev().take_while(|f| f.line >= since);
        if alike.filter(|f| f.rule == rule).count() < MOST_FINDINGS {
            self.findings.push(Finding { line: self.line, rule, message: message.into() });
        }
    }

    /// Index of the running step.
    fn step(&self) -> Option<usize> {
        let n = self.step_lines.len();
        (n > 0 && n <= self.setting.plan.steps.len()).then(|| n - 1)
    }

    fn tool(&self) -> Option<&'a Tool> {
        self.setting.job.tool(&self.setting.plan.steps[self.step()?].tool)
    }

    fn parked(&self) -> bool {
        self.nose[2].is_some_and(|z| z >= self.machine.kinematics.z.home_mm - PARKED_MM)
    }

    /// A percent sign or the number of the program between them; true when the line was one.
    fn mark(&mut self, line: &str) -> bool {
        let line = line.trim();
        if line == "%" {
            self.marks += 1;
            if self.marks > 2 || (self.marks == 2) != self.ended {
                self.find(Rule::End, "a percent sign inside the program");
            }
            return true;
        }
        let number = line.strip_prefix('O').map(|n| n.bytes().all(|b| b.is_ascii_digit()));
        number == Some(true) && self.line == 2
    }

    fn block(&mut self, words: &[Word]) {
        if self.dialect.marks.is_some() && self.marks != 1 {
            return self.find(Rule::End, "a block outside the percent signs");
        }
        if self.ended {
            return self.find(Rule::End, "a block after the end of the program");
        }
        let chain = &self.machine.kinematics;
        let rotary = [chain.first.letter, chain.second.letter];
        let mut axes = [None; 3];
        let mut turns = [None; 2];
        let (mut gs, mut ms) = (Vec::new(), Vec::new());
        let (mut dwell, mut length, mut filament) = (None, None, None);
        let mut center = [None; 2];
        for w in words {
            match w.letter {
                'G' | 'M' => match code(w.value) {
                    Some(c) if w.letter == 'G' => gs.push(c),
                    Some(c) => ms.push(c),
                    None => {
                        return self
                            .find(Rule::Modes, format!("unknown code {}{}", w.letter, w.value));
                    }
                },
                'X' => axes[0] = Some(w.value),
                'Y' => axes[1] = Some(w.value),
                'Z' => axes[2] = Some(w.value),
                'F' => self.set_feed(w.value),
                'S' if words.iter().any(|w| w.letter == 'M' && w.value == 42.0) => {
                    self.level = Some(w.value);
                }
                'S' => self.speed = Some(w.value),
                'T' => self.chosen = Some(w.value),
                'P' => dwell = Some(w.value),
                'H' => length = Some(w.value),
                'I' if self.dialect.arcs => center[0] = Some(w.value),
                'J' if self.dialect.arcs => center[1] = Some(w.value),
                'E' if self.dialect.extrusion == Extrusion::Axis => filament = Some(w.value),
                'N' => {}
                l if l == rotary[0] => turns[0] = Some(w.value),
                l if l == rotary[1] => turns[1] = Some(w.value),
                l => return self.find(Rule::Modes, format!("unknown word {l}")),
            }
        }
        let moves = axes.iter().chain(&turns).any(Option::is_some);
        if !ms.is_empty() && (moves || ms.len() > 1 || !gs.is_empty()) {
            return self.find(Rule::Syntax, "an M code stands with motion or another code");
        }
        for m in ms {
            self.m_code(m, dwell);
        }
        if !self.dialect.m6 && words.iter().any(|w| w.letter == 'T') {
            self.change_tool();
            self.compensated = true;
        }
        let absolute = gs.contains(&53);
        for g in &gs {
            match g {
                0 | 1 => self.motion = Some(*g),
                2 | 3 if self.dialect.arcs => self.motion = Some(*g),
                4 => {
                    let unit = match self.dialect.dwell {
                        Dwell::Seconds => 1.0,
                        Dwell::Milliseconds => 1e-3,
                    };
                    match dwell.map(|p| p * unit).filter(|s| (0.0..=600.0).contains(s)) {
                        Some(s) => self.dwelt.push((self.step_lines.len(), s)),
                        None => self.find(Rule::Syntax, "G4 needs P, up to ten minutes"),
                    }
                }
                43 if self.dialect.m6 => self.compensate(length),
                53 => {}
                g if self.dialect.needed.contains(g) || (54..=59).contains(g) => {
                    self.modes.push(*g);
                }
                g if IDLE.contains(g) => {}
                g => return self.find(Rule::Modes, format!("unknown code G{g}")),
            }
        }
        if gs.iter().filter(|g| **g <= 4).count() > 1 {
            return self.find(Rule::Syntax, "two motion codes in one block");
        }
        if moves && gs.contains(&4) {
            return self.find(Rule::Syntax, "a dwell with motion");
        }
        if center != [None; 2] && (!moves || !matches!(self.motion, Some(2 | 3))) {
            return self.find(Rule::Syntax, "a centre (I, J) without an arc");
        }
        if moves {
            self.travel(axes, turns, absolute, filament, center);
        } else if let Some(e) = filament {
            self.filament(e);
        }
    }

    fn set_feed(&mut self, value: f64) {
        if !(value > 0.0 && value <= self.machine.control.max_feed_mm_min + 0.05) {
            let limit = self.machine.control.max_feed_mm_min;
            self.find(Rule::Feed, format!("F{value} is not within 0 and {limit} mm/min"));
        }
        self.feed = Some(value);
    }

    fn compensate(&mut self, length: Option<f64>) {
        if length.is_none() || length != self.chosen {
            self.find(Rule::Tool, "G43 needs the H of the tool in the spindle");
        }
        self.compensated = true;
    }

    fn m_code(&mut self, m: u32, p: Option<f64>) {
        match m {
            m if m == self.dialect.end => {
                self.quiet(&format!("M{m}"));
                self.ended = true;
            }
            m if m == self.dialect.pause => {
                self.quiet(&format!("M{m}"));
                self.held_anew = true;
            }
            3 => {
                let limit = self.machine.control.max_spindle_rpm;
                if !self.speed.is_some_and(|s| s > 0.0 && s <= limit) {
                    self.find(Rule::Spindle, format!("M3 needs a speed S up to {limit}"));
                }
                if self.kind() != Some(StepKind::Subtractive) {
                    self.find(Rule::Spindle, "the spindle starts in a step that does not cut");
                }
                self.spindle = true;
            }
            5 => self.spindle = false,
            6 if self.dialect.m6 => self.change_tool(),
            83 if self.dialect.extrusion == Extrusion::Axis => self.modes.push(83),
            42 if self.dialect.extrusion == Extrusion::Axis => self.pin(p),
            m => self.extruder_code(m),
        }
    }

    fn kind(&self) -> Option<StepKind> {
        self.step().map(|s| self.setting.plan.steps[s].kind)
    }

    /// Spindle and extruder must be off, the nose parked.
    fn quiet(&mut self, at: &str) {
        if self.spindle {
            self.find(Rule::Spindle, format!("{at} while the spindle turns"));
        }
        if self.open || self.extruding {
            self.find(Rule::Extruder, format!("{at} while the extruder module is open"));
        }
        if !self.parked() {
            self.find(Rule::Rotary, format!("{at} below the parking height"));
        }
    }

    fn change_tool(&mut self) {
        self.quiet("M6");
        self.step_lines.push(self.line);
        (self.compensated, self.feed, self.motion) = (false, None, None);
        self.layers = [None; 2];
        let n = self.step_lines.len();
        let Some(step) = self.setting.plan.steps.get(n - 1) else {
            let most = self.setting.plan.steps.len();
            return self
                .find(Rule::Tool, format!("tool change {n}, but the plan has {most} steps"));
        };
        let job = self.setting.job;
        self.storeys = match (step.kind, job.tool(&step.tool)) {
            (StepKind::Additive, Some(tool)) => Storeys::of(step, &job.frame, tool.process.path_mm),
            _ => Storeys::default(),
        };
        let tools = job.cutters.iter().chain(&job.nozzles);
        let want = tools.map(|t| &t.name).position(|t| *t == step.tool).map(|i| i as f64 + 1.0);
        if want.is_none() || self.chosen != want {
            let want = want.map_or("none of the job's".into(), |w| format!("T{w}"));
            self.find(Rule::Tool, format!("step {n} needs {want} ({})", step.tool));
        }
        let before = n.checked_sub(2).map_or(0, |i| self.setting.plan.steps[i].holding);
        if before != step.holding && !self.held_anew {
            self.find(Rule::Tool, "the part must be held anew, but no M0 stops for it");
        }
        self.held_anew = false;
    }

    fn travel(
        &mut self,
        axes: [Option<f64>; 3],
        turns: [Option<f64>; 2],
        absolute: bool,
        filament: Option<f64>,
        center: [Option<f64>; 2],
    ) {
        let offset = self.machine.control.post.work_offset;
        let mut needed = self.dialect.needed.iter().chain([&offset]);
        if let Some(missing) = needed.find(|m| !self.modes.contains(m)) {
            return self.find(Rule::Modes, format!("motion before G{missing}"));
        }
        if self.modes.iter().any(|m| (54..=59).contains(m) && *m != offset) {
            return self.find(Rule::Modes, format!("another work offset than G{offset}"));
        }
        if self.dialect.extrusion == Extrusion::Axis {
            if !self.modes.contains(&83) {
                return self.find(Rule::Modes, "motion before M83");
            }
            self.extruding = filament.is_some();
        }
        let Some(motion) = self.motion else {
            return self.find(Rule::Modes, "axis words without G0 or G1");
        };
        if absolute {
            return self.park(axes, turns, motion);
        }
        let (Some(step), Some(tool)) = (self.step(), self.tool()) else {
            return self.find(Rule::Tool, "motion without a step's tool in the spindle");
        };
        if !self.compensated {
            self.find(Rule::Tool, "motion without length compensation (G43)");
        }
        let gauge = tool.gauge_mm();
        if turns.iter().any(Option::is_some) {
            return self.turn(axes, turns, motion, step);
        }
        if matches!(motion, 2 | 3) {
            return self.arc(axes, center, motion, filament);
        }
        let before = self.tip(step, gauge);
        let lift = [0.0, 0.0, gauge];
        for (a, value) in axes.iter().enumerate() {
            self.nose[a] = value.map(|v| v + lift[a]).or(self.nose[a]);
        }
        if let Some(axes) = self.axes(gauge)
            && let Err(e) = self.machine.kinematics.check_axes(axes, gauge)
        {
            self.find(Rule::Limits, e.to_string());
        }
        self.states(motion, step);
        let Some((to, _)) = self.tip(step, gauge) else {
            if !self.parked() {
                self.find(Rule::Modes, "moves below the parking height before all axes are known");
            }
            return;
        };
        if before.is_none() && !self.parked() {
            self.find(Rule::Modes, "leaves the parking height from an unknown position");
        }
        let gait = match (motion, self.extruding) {
            (0, _) => Gait::Rapid,
            (_, true) => Gait::Deposit,
            _ => Gait::Feed,
        };
        let (from, feed) = (before.map(|b| b.0), self.feed.unwrap_or(0.0));
        if gait == Gait::Deposit {
            self.bead_feed(self.setting.plan.steps[step].direction.dot(to));
        }
        if let (Some(e), Some(from)) = (filament, from) {
            self.bead_filament(e, from.distance(to));
        }
        self.motions.push(Motion { line: self.line, step, gait, from, to, feed });
    }

    /// Programmed axis values, once all are known.
    fn axes(&self, gauge: f64) -> Option<AxisValues> {
        let [Some(x), Some(y), Some(z)] = self.nose else { return None };
        let [Some(first_deg), Some(second_deg)] = self.rotary else { return None };
        let rotary = RotaryAngles { first_deg, second_deg };
        Some(AxisValues::new(DVec3::new(x, y, z - gauge), rotary))
    }

    fn tip(&mut self, step: usize, gauge: f64) -> Option<(DVec3, Direction)> {
        let axes = self.axes(gauge)?;
        let kept = self.indexed.filter(|(of, at)| *of == step && at.is_at(axes.rotary(), gauge));
        let (_, at) = kept.unwrap_or_else(|| {
            let placement = &self.setting.placements[step];
            (step, self.machine.kinematics.indexed(placement, axes.rotary(), gauge))
        });
        self.indexed = Some((step, at));
        Some(at.tip(axes.linear()))
    }

    /// `G53 G0 Z`: to a height of the nose in machine coordinates.
    fn park(&mut self, axes: [Option<f64>; 3], turns: [Option<f64>; 2], motion: u32) {
        let only_z = axes[0].is_none() && axes[1].is_none() && turns == [None; 2];
        let (Some(z), true, 0) = (axes[2], only_z, motion) else {
            return self.find(Rule::Modes, "G53 is taken only with G0 and Z");
        };
        if self.extruding {
            self.find(Rule::Extruder, "a rapid while extruding");
        }
        let [low, high] = self.machine.kinematics.z.limits_mm;
        if !(low..=high).contains(&z) {
            self.find(Rule::Limits, format!("Z{z} is not within {low} and {high} mm"));
        }
        let at = self.step().zip(self.tool().map(Tool::gauge_mm));
        let before = at.and_then(|(s, g)| self.tip(s, g));
        self.nose[2] = Some(z);
        if let Some((step, gauge)) = at
            && let (Some((from, _)), Some((to, _))) = (before, self.tip(step, gauge))
        {
            let gait = Gait::Rapid;
            self.motions.push(Motion {
                line: self.line,
                step,
                gait,
                from: Some(from),
                to,
                feed: 0.0,
            });
        }
    }

    fn turn(&mut self, axes: [Option<f64>; 3], turns: [Option<f64>; 2], motion: u32, step: usize) {
        if axes.iter().any(Option::is_some) || motion != 0 {
            self.find(Rule::Rotary, "rotary axes turn with linear ones, or at feed");
        }
        if !self.parked() {
            self.find(Rule::Rotary, "rotary axes turn below the parking height");
        }
        if self.spindle || self.open {
            self.find(Rule::Rotary, "rotary axes turn while the spindle or the extruder is on");
        }
        let before = self.rotary;
        for (axis, turn) in self.rotary.iter_mut().zip(turns) {
            *axis = turn.or(*axis);
        }
        self.turning(before);
        let chain = &self.machine.kinematics;
        for (rotary, angle) in [(&chain.first, self.rotary[0]), (&chain.second, self.rotary[1])] {
            if let Some(a) = angle.filter(|a| !rotary.allows(*a)) {
                self.find(
                    Rule::Limits,
                    format!("{}{a} is beyond the axis's limits", rotary.letter),
                );
            }
        }
        let [Some(first_deg), Some(second_deg)] = self.rotary else { return };
        let axes = AxisValues::new(DVec3::ZERO, RotaryAngles { first_deg, second_deg });
        let (_, d) = chain.tip(&self.setting.placements[step], axes, 0.0);
        let want = self.setting.plan.steps[step].direction;
        let off = d.vec().cross(want.vec()).length();
        if off > POINTING_RAD || d.dot(want.vec()) < 0.0 {
            let (d, want) = (d.vec(), want.vec());
            self.find(
                Rule::Direction,
                format!("the tool points along {d:.4}, step {} needs {want:.4}", step + 1),
            );
        }
    }

    /// Notes how long the rotary axes turn, both at once, from rest to rest.
    fn turning(&mut self, before: [Option<f64>; 2]) {
        let chain = &self.machine.kinematics;
        let acceleration = self.machine.control.acceleration_deg_s2;
        let home = [chain.first.home_deg, chain.second.home_deg];
        let rates = [chain.first.rapid_deg_min, chain.second.rapid_deg_min];
        let seconds = (0..2).map(|i| {
            let to = self.rotary[i].unwrap_or(home[i]);
            let angle = (to - before[i].unwrap_or(home[i])).abs();
            rest_to_rest(angle, rates[i] / 60.0, acceleration)
        });
        self.turned.push((self.step_lines.len(), seconds.fold(0.0, f64::max)));
    }

    /// Feed, spindle and extruder against what the move is.
    fn states(&mut self, motion: u32, step: usize) {
        if self.rotary.contains(&None) {
            self.find(Rule::Direction, "linear motion before both rotary axes are indexed");
        }
        if motion == 0 {
            if self.extruding {
                self.find(Rule::Extruder, "a rapid while extruding");
            }
            return;
        }
        if self.feed.is_none() {
            self.find(Rule::Feed, "G1 before this step has stated a feed");
        }
        match self.setting.plan.steps[step].kind {
            StepKind::Subtractive if !self.spindle => {
                self.find(Rule::Spindle, "the cutter moves at feed while the spindle stands");
            }
            StepKind::Additive if !self.open => {
                self.find(Rule::Extruder, "the nozzle moves at feed while the module is closed");
            }
            StepKind::Additive if !self.extruding && !self.drawn => {
                self.find(Rule::Extruder, "the nozzle travels neither extruding nor drawn back");
            }
            _ => {}
        }
    }

    fn finish(&mut self) {
        self.line = self.line.max(1);
        if !self.ended {
            let end = self.dialect.end;
            self.find(Rule::End, format!("the program does not end with M{end}"));
        } else if self.dialect.marks.is_some() && self.marks != 2 {
            self.find(Rule::End, "the program does not end with a percent sign");
        }
        let (changes, steps) = (self.step_lines.len(), self.setting.plan.steps.len());
        if changes < steps {
            self.find(Rule::Tool, format!("{changes} tool changes for {steps} steps"));
        }
    }
}

/// The whole number a G or M word stands for.
fn code(value: f64) -> Option<u32> {
    (value.fract() == 0.0 && (0.0..10_000.0).contains(&value)).then_some(value as u32)
}
