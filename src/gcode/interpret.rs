//! Runs a program forward: modal state, then where the axes go.
//!
//! Each `M6` begins the plan's next step. Blocks are executed word group by word group; a block that
//! mixes what a control would have to order (codes and motion, turning and travelling) is refused.

use super::report::{Finding, Rule};
use super::words::{Word, read};
use crate::base::{DVec3, Direction};
use crate::machine::{AxisValues, Extruder, Machine, Placement, RotaryAngles, Tool};
use crate::plan::{Job, Plan, StepKind};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Gait {
    Rapid,
    /// At feed; with a cutter it cuts.
    Feed,
    /// At feed while the bead is laid.
    Deposit,
}

/// One straight move of the tip, work coordinates.
#[derive(Clone, Copy, Debug)]
pub(super) struct Motion {
    pub line: usize,
    pub step: usize,
    pub gait: Gait,
    /// None when the program has not said where the tip stands before.
    pub from: Option<DVec3>,
    pub to: DVec3,
    pub feed: f64,
}

pub(super) struct Run {
    pub motions: Vec<Motion>,
    pub findings: Vec<Finding>,
    /// Line of each step's tool change.
    pub step_lines: Vec<usize>,
}

/// What the interpreter knows of the plan.
pub(super) struct Setting<'a> {
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

/// Largest relative error of a bead's feed: a hundredth more or less material.
const BEAD_FEED: f64 = 0.01;

/// Findings of one rule in one step that are told; a broken step would bury the others.
pub(super) const MOST_FINDINGS: usize = 5;

pub(super) fn run(text: &str, setting: &Setting) -> Run {
    let mut it = Interpreter::new(setting);
    for (i, line) in text.lines().enumerate() {
        it.line = i + 1;
        match read(line) {
            Ok(words) if words.is_empty() => {}
            Ok(words) => it.block(&words),
            Err(e) => it.find(Rule::Syntax, e.to_string()),
        }
    }
    it.finish();
    Run { motions: it.motions, findings: it.findings, step_lines: it.step_lines }
}

struct Codes {
    open: f64,
    close: f64,
    on: f64,
    off: f64,
    draw: f64,
    give: f64,
}

impl Codes {
    fn of(e: &Extruder) -> Option<Codes> {
        let code = |text: &str| text.strip_prefix('M')?.parse::<u16>().ok().map(f64::from);
        Some(Codes {
            open: code(&e.m_open)?,
            close: code(&e.m_close)?,
            on: code(&e.m_on)?,
            off: code(&e.m_off)?,
            draw: code(&e.m_retract_on)?,
            give: code(&e.m_retract_off)?,
        })
    }
}

struct Interpreter<'a> {
    setting: &'a Setting<'a>,
    machine: &'a Machine,
    codes: Option<Codes>,
    line: usize,
    findings: Vec<Finding>,
    motions: Vec<Motion>,
    step_lines: Vec<usize>,
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
    compensated: bool,
    held_anew: bool,
    ended: bool,
    // Position: the spindle nose with the head at zero, machine coordinates.
    nose: [Option<f64>; 3],
    rotary: [Option<f64>; 2],
}

/// Codes that must have been said before anything moves.
const NEEDED: [u32; 5] = [17, 21, 54, 90, 94];

impl<'a> Interpreter<'a> {
    fn new(setting: &'a Setting<'a>) -> Self {
        let machine = &setting.job.machine;
        Interpreter {
            setting,
            machine,
            codes: machine.extruder.as_ref().and_then(Codes::of),
            line: 0,
            findings: Vec::new(),
            motions: Vec::new(),
            step_lines: Vec::new(),
            modes: Vec::new(),
            motion: None,
            feed: None,
            speed: None,
            spindle: false,
            open: false,
            extruding: false,
            drawn: false,
            chosen: None,
            compensated: false,
            held_anew: false,
            ended: false,
            nose: [None; 3],
            rotary: [None; 2],
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

    fn block(&mut self, words: &[Word]) {
        if self.ended {
            return self.find(Rule::End, "a block after the end of the program");
        }
        let chain = &self.machine.kinematics;
        let rotary = [chain.first.letter, chain.second.letter];
        let mut axes = [None; 3];
        let mut turns = [None; 2];
        let (mut gs, mut ms) = (Vec::new(), Vec::new());
        let (mut dwell, mut length) = (None, None);
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
                'S' => self.speed = Some(w.value),
                'T' => self.chosen = Some(w.value),
                'P' => dwell = Some(w.value),
                'H' => length = Some(w.value),
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
            self.m_code(m);
        }
        let absolute = gs.contains(&53);
        for g in &gs {
            match g {
                0 | 1 => self.motion = Some(*g),
                4 => {
                    if !dwell.is_some_and(|p| (0.0..=600.0).contains(&p)) {
                        self.find(Rule::Syntax, "G4 needs P, seconds up to 600");
                    }
                }
                43 => self.compensate(length),
                53 => {}
                g if NEEDED.contains(g) => self.modes.push(*g),
                g => return self.find(Rule::Modes, format!("unknown code G{g}")),
            }
        }
        if gs.iter().filter(|g| **g <= 4).count() > 1 {
            return self.find(Rule::Syntax, "two motion codes in one block");
        }
        if moves && gs.contains(&4) {
            return self.find(Rule::Syntax, "a dwell with motion");
        }
        if moves {
            self.travel(axes, turns, absolute);
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

    fn m_code(&mut self, m: u32) {
        match m {
            0 => {
                self.quiet("M0");
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
            6 => self.change_tool(),
            30 => {
                self.quiet("M30");
                self.ended = true;
            }
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
        let n = self.step_lines.len();
        let Some(step) = self.setting.plan.steps.get(n - 1) else {
            let most = self.setting.plan.steps.len();
            return self
                .find(Rule::Tool, format!("tool change {n}, but the plan has {most} steps"));
        };
        let job = self.setting.job;
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

    fn extruder_code(&mut self, m: u32) {
        let Some(c) = &self.codes else {
            return self.find(Rule::Modes, format!("unknown code M{m}"));
        };
        let m = f64::from(m);
        let (open, extruding, drawn) = (self.open, self.extruding, self.drawn);
        let wrong = if m == c.open {
            self.open = true;
            let prints = self.kind() == Some(StepKind::Additive);
            (!prints || open).then_some("the module opens in a step that does not print, or twice")
        } else if m == c.close {
            self.open = false;
            (extruding || drawn || !open)
                .then_some("the module closes while extruding or drawn back, or was not open")
        } else if m == c.on {
            (self.extruding, self.drawn) = (true, drawn);
            (!open || drawn || extruding)
                .then_some("extrusion starts while the module is closed, drawn back or extruding")
        } else if m == c.off {
            self.extruding = false;
            (!extruding).then_some("extrusion stops, but it was not on")
        } else if m == c.draw {
            self.drawn = true;
            (!open || extruding || drawn)
                .then_some("retraction while the module is closed, extruding or drawn back")
        } else if m == c.give {
            self.drawn = false;
            (!drawn).then_some("retraction ends, but the filament was not drawn back")
        } else {
            return self.find(Rule::Modes, format!("unknown code M{m}"));
        };
        if let Some(wrong) = wrong {
            self.find(Rule::Extruder, wrong);
        }
    }

    fn travel(&mut self, axes: [Option<f64>; 3], turns: [Option<f64>; 2], absolute: bool) {
        if let Some(missing) = NEEDED.iter().find(|m| !self.modes.contains(m)) {
            return self.find(Rule::Modes, format!("motion before G{missing}"));
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
        self.motions.push(Motion { line: self.line, step, gait, from, to, feed });
    }

    /// Programmed axis values, once all are known.
    fn axes(&self, gauge: f64) -> Option<AxisValues> {
        let [Some(x), Some(y), Some(z)] = self.nose else { return None };
        let [Some(first_deg), Some(second_deg)] = self.rotary else { return None };
        let rotary = RotaryAngles { first_deg, second_deg };
        Some(AxisValues::new(DVec3::new(x, y, z - gauge), rotary))
    }

    fn tip(&self, step: usize, gauge: f64) -> Option<(DVec3, Direction)> {
        let placement = &self.setting.placements[step];
        Some(self.machine.kinematics.tip(placement, self.axes(gauge)?, gauge))
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
        for (axis, turn) in self.rotary.iter_mut().zip(turns) {
            *axis = turn.or(*axis);
        }
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
            StepKind::Additive if self.extruding => self.bead_feed(),
            StepKind::Additive if !self.drawn => {
                self.find(Rule::Extruder, "the nozzle travels neither extruding nor drawn back");
            }
            _ => {}
        }
    }

    fn bead_feed(&mut self) {
        let (Some(e), Some(tool), Some(feed)) = (&self.machine.extruder, self.tool(), self.feed)
        else {
            return;
        };
        let want = e.feed_mm_min(&tool.process);
        if (feed - want).abs() > BEAD_FEED * want {
            self.find(
                Rule::Feed,
                format!("a bead at F{feed}, the extruder's rate needs {want:.1}"),
            );
        }
    }

    fn finish(&mut self) {
        self.line = self.line.max(1);
        if !self.ended {
            self.find(Rule::End, "the program does not end with M30");
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
