//! Writes paths as a 3+2 program.
//!
//! Per step: spindle and extruder off, retract to the parking height in machine coordinates, tool
//! change, rotary axes indexed there, then down to the safe height of the step, and its moves.

use super::arcs::{Arc, MOST_MOVES, fit};
use super::dialect::{Comments, Dialect, Dwell, number};
use super::module::{Bead, Module};
use super::program::Program;
use crate::base::{DVec2, DVec3};
use crate::machine::{AxisValues, NoPosture, Overtravel, Placement, RotaryAngles, Tool};
use crate::plan::{Job, Plan, StepKind};
use crate::toolpath::{Move, MoveKind, Replay, Toolpath, ToolpathError, Toolpaths};
use rayon::prelude::*;
use std::fmt::Write;

/// Why a plan's paths cannot be written for the machine.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum PostError {
    #[error("dialect '{name}' is unknown; the machine profile may name one of: {known}")]
    UnknownDialect { name: String, known: String },
    #[error("step {step} prints, but machine '{machine}' has no extruder; add [extruder]")]
    NoExtruder { step: usize, machine: String },
    #[error(
        "step {step}: the extruder's rate asks for {feed:.0} mm/min, the control allows {limit:.0}; \
         lower volumetric_mm3_s or widen the bead"
    )]
    TooFast { step: usize, feed: f64, limit: f64 },
    #[error("step {step}: {source}")]
    Posture { step: usize, source: NoPosture },
    #[error("step {step}: {source}")]
    Travel { step: usize, source: Overtravel },
    #[error(transparent)]
    Paths(#[from] ToolpathError),
    #[error("the paths are not of this plan: {paths} paths for {steps} steps")]
    OtherPlan { paths: usize, steps: usize },
}

/// Writes the program. `digest` names the plan in the header (plain ASCII is kept of it).
///
/// # Errors
/// When the machine cannot make a step as the paths want it.
pub fn post(job: &Job, plan: &Plan, paths: &Toolpaths, digest: &str) -> Result<Program, PostError> {
    let name = &job.machine.control.dialect;
    let dialect = Dialect::of(&job.machine.control).ok_or_else(|| PostError::UnknownDialect {
        name: name.clone(),
        known: Dialect::names().collect::<Vec<_>>().join(", "),
    })?;
    let steps = plan.steps.len();
    if paths.all().len() != steps {
        return Err(PostError::OtherPlan { paths: paths.all().len(), steps });
    }
    let replay = Replay::of(job, plan)?;
    let mut whole = Writer::new(job, dialect, job.machine.kinematics.home(), 0);
    whole.header(plan, paths, digest);
    let placement = |(path, center): (&Toolpath, &DVec3)| {
        job.machine.placement(&plan.holdings[path.holding], *center)
    };
    let all = paths.all();
    let placements: Vec<Placement> =
        all.iter().zip(&replay.contact_center).map(placement).collect();
    let (postures, failed) = postures(job, &dialect, all, &placements);
    // Parked between them, steps know nothing of each other but the rotary axes and the number of
    // the last block.
    let step = |i: usize, block: u32| -> Result<Writer, PostError> {
        let mut writer = Writer::new(job, dialect, postures[i], block);
        if all[i].holding != i.checked_sub(1).map_or(0, |before| all[before].holding) {
            writer.refixture(&all[i]);
        }
        writer.step(&all[i], &placements[i])?;
        Ok(writer)
    };
    let mut starts = Vec::new();
    let mut add = |writer: Writer, whole: &mut Writer| {
        starts.push(whole.out.len());
        whole.out.push_str(&writer.out);
        whole.block = writer.block;
    };
    if dialect.numbered {
        for i in 0..postures.len() {
            add(step(i, whole.block)?, &mut whole);
        }
    } else {
        let written: Vec<_> = (0..postures.len()).into_par_iter().map(|i| step(i, 0)).collect();
        for writer in written {
            add(writer?, &mut whole);
        }
    }
    if let Some(e) = failed {
        return Err(e);
    }
    let end = whole.out.len();
    whole.epilogue();
    Ok(Program::of_steps(whole.out, starts, end))
}

/// Rotary angles of the steps, each as near as can be to the last, up to the first step that has
/// none, and why.
fn postures(
    job: &Job,
    dialect: &Dialect,
    paths: &[Toolpath],
    placements: &[Placement],
) -> (Vec<RotaryAngles>, Option<PostError>) {
    let mut found = Vec::new();
    let mut last = job.machine.kinematics.home();
    for (path, placement) in paths.iter().zip(placements) {
        match posture(job, dialect, path, placement, last) {
            Ok(angles) => last = angles,
            Err(e) => return (found, Some(e)),
        }
        found.push(last);
    }
    (found, None)
}

/// Rotary angles of a step, rounded as they are written, with all its tips within travel.
fn posture(
    job: &Job,
    dialect: &Dialect,
    path: &Toolpath,
    placement: &Placement,
    last: RotaryAngles,
) -> Result<RotaryAngles, PostError> {
    let no_tool = || ToolpathError::NoTool { step: path.step, tool: path.tool.clone() };
    let tool = job.tool(&path.tool).ok_or_else(no_tool)?;
    let plane = path.direction.image_plane();
    let mut low = DVec3::INFINITY;
    let mut high = DVec3::NEG_INFINITY;
    for m in &path.moves {
        let p = DVec3::new(plane.u.dot(m.tip), plane.v.dot(m.tip), plane.d.dot(m.tip));
        (low, high) = (low.min(p), high.max(p));
    }
    let corner = |i: usize| {
        let pick = |b: usize, l: f64, h: f64| if i >> b & 1 == 0 { l } else { h };
        plane.u * pick(0, low.x, high.x)
            + plane.v * pick(1, low.y, high.y)
            + plane.d * pick(2, low.z, high.z)
    };
    let tips: Vec<DVec3> =
        if path.moves.is_empty() { Vec::new() } else { (0..8).map(corner).collect() };
    let found = job
        .machine
        .posture(placement, path.direction, last, tool, &tips)
        .map_err(|source| PostError::Posture { step: path.step, source })?;
    let unit = 10f64.powi(dialect.rotary_digits as i32);
    let round = |a: f64| (a * unit).round() / unit + 0.0;
    Ok(RotaryAngles { first_deg: round(found.first_deg), second_deg: round(found.second_deg) })
}

/// Number of a tool: its place in the job's table, from 1.
pub(super) fn tool_number(job: &Job, name: &str) -> Option<usize> {
    job.cutters.iter().chain(&job.nozzles).position(|t| t.name == name).map(|i| i + 1)
}

/// What need not be said again.
#[derive(Default)]
struct Modal {
    motion: Option<u8>,
    words: [Option<String>; 3],
    feed: Option<String>,
}

struct Writer<'a> {
    job: &'a Job,
    dialect: Dialect,
    out: String,
    /// Of the step.
    rotary: RotaryAngles,
    last: Modal,
    /// Number of the last numbered block.
    block: u32,
}

/// Block numbers go up by this and begin anew where they would outgrow five digits.
const NUMBER_STEP: u32 = 10;
const LAST_NUMBER: u32 = 99_990;

/// How fast filament is drawn back and given again where there is an E axis, mm/min.
const RETRACT_FEED: f64 = 1800.0;

/// Keeps what may stand in a comment of any control.
fn plain(text: &str) -> String {
    let keep = |c: &char| c.is_ascii_alphanumeric() || " .,:;-_+/=".contains(*c);
    text.chars().filter(keep).take(120).collect()
}

impl<'a> Writer<'a> {
    fn new(job: &'a Job, dialect: Dialect, rotary: RotaryAngles, block: u32) -> Writer<'a> {
        Writer { job, dialect, out: String::new(), rotary, last: Modal::default(), block }
    }

    /// One block.
    fn line(&mut self, text: &str) {
        if self.dialect.numbered {
            self.block = if self.block >= LAST_NUMBER { 0 } else { self.block } + NUMBER_STEP;
            let _ = write!(self.out, "N{} ", self.block);
        }
        self.raw(text);
    }

    fn raw(&mut self, text: &str) {
        self.out.push_str(text);
        self.out.push('\n');
    }

    fn comment(&mut self, text: &str) {
        let text = plain(text);
        match self.dialect.comments {
            Comments::Parentheses => self.raw(&format!("({text})")),
            Comments::Semicolon => self.raw(&format!("; {text}")),
        }
    }

    fn header(&mut self, plan: &Plan, paths: &Toolpaths, digest: &str) {
        let job = self.job;
        if let Some((first, _)) = self.dialect.marks {
            self.raw(first);
        }
        self.comment(&format!("hmplan {}", env!("CARGO_PKG_VERSION")));
        self.comment(&format!("plan {digest}"));
        self.comment(if paths.verified() { "plan verified" } else { "PLAN NOT VERIFIED" });
        self.comment(&format!("machine {}, dialect {}", job.machine.name, self.dialect.name));
        let offset = job.machine.control.post.work_offset;
        self.comment(&format!(
            "X Y Z: tip in machine coordinates with the head at zero, G{offset} offset zero"
        ));
        let [x, y, z] = job.machine.kinematics.table_center_mm;
        let pedestal = job.machine.workholding.pedestal_mm;
        self.comment(&format!("table centre {x:.3} {y:.3} {z:.3}, pedestal {pedestal:.3} mm"));
        let tools: Vec<&Tool> = job.cutters.iter().chain(&job.nozzles).collect();
        for (i, t) in tools.iter().enumerate() {
            if plan.steps.iter().any(|s| s.tool == t.name) {
                self.comment(&format!("T{} {} gauge {:.3} mm", i + 1, t.name, t.gauge_mm()));
            }
        }
        let time: f64 = paths.all().iter().map(|p| p.figures.time_s).sum();
        self.comment(&format!("{} steps, {:.0} min at full feed", plan.steps.len(), time / 60.0));
        for l in self.dialect.preamble {
            self.line(l);
        }
        self.line(&format!("G{offset}"));
    }

    fn refixture(&mut self, path: &Toolpath) {
        self.park();
        self.comment(&format!("hold the part anew: holding {}", path.holding));
        self.line(&format!("M{}", self.dialect.pause));
    }

    fn epilogue(&mut self) {
        self.park();
        self.line(&format!("M{}", self.dialect.end));
        if let Some((_, last)) = self.dialect.marks {
            self.raw(last);
        }
    }

    /// To the parking height in machine coordinates; what was modal is said anew afterwards.
    fn park(&mut self) {
        let z = number(self.job.machine.kinematics.z.home_mm, self.dialect.linear_digits);
        self.line(&format!("G53 G0 Z{z}"));
        self.last = Modal::default();
    }

    fn step(&mut self, path: &Toolpath, placement: &Placement) -> Result<(), PostError> {
        let (job, step) = (self.job, path.step);
        let no_tool = || ToolpathError::NoTool { step, tool: path.tool.clone() };
        let tool = job.tool(&path.tool).ok_or_else(no_tool)?;
        let number_of_tool = tool_number(job, &path.tool).ok_or_else(no_tool)?;
        let d = path.direction.vec();
        let kind = match path.kind {
            StepKind::Subtractive => "subtractive",
            StepKind::Additive => "additive",
        };
        self.comment(&format!("step {}: {kind}, tool {}", step + 1, path.tool));
        self.comment(&format!("direction {:.6} {:.6} {:.6}", d.x, d.y, d.z));
        self.park();
        if self.dialect.m6 {
            self.line(&format!("T{number_of_tool} M6"));
            self.line(&format!("G43 H{number_of_tool}"));
        } else {
            self.line(&format!("T{number_of_tool}"));
        }
        self.index();
        match path.kind {
            StepKind::Subtractive => {
                self.line(&format!("M3 S{:.0}", job.machine.control.spindle(&tool.process)));
                self.moves(path, placement, tool, None)?;
                self.park();
                self.line("M5");
            }
            StepKind::Additive => {
                let machine = job.machine.name.clone();
                let no_extruder = || PostError::NoExtruder { step, machine: machine.clone() };
                let extruder = job.machine.extruder.as_ref().ok_or_else(no_extruder)?;
                let (feed, limit) =
                    (extruder.feed_mm_min(&tool.process), job.machine.control.max_feed_mm_min);
                if feed > limit {
                    return Err(PostError::TooFast { step, feed, limit });
                }
                let module = Module::of(&self.dialect, extruder, tool).ok_or_else(no_extruder)?;
                self.line(&module.open());
                self.moves(path, placement, tool, Some(module))?;
                self.park();
                self.line(&module.close());
            }
        }
        Ok(())
    }

    /// Turns the rotary axes; the tool stands at the parking height.
    fn index(&mut self) {
        let to = self.rotary;
        let chain = &self.job.machine.kinematics;
        let digits = self.dialect.rotary_digits;
        let mut block = String::from("G0");
        for (axis, angle) in [(&chain.first, to.first_deg), (&chain.second, to.second_deg)] {
            if !axis.is_absent() {
                block += &format!(" {}{}", axis.letter, number(angle, digits));
            }
        }
        if chain.rotary_axes().next().is_some() {
            self.line(&block);
            self.last.motion = Some(0);
        }
    }

    fn moves(
        &mut self,
        path: &Toolpath,
        placement: &Placement,
        tool: &Tool,
        module: Option<Module>,
    ) -> Result<(), PostError> {
        let job = self.job;
        let digits = self.dialect.linear_digits;
        let mut state = Bead::default();
        let mut before: Option<DVec3> = None;
        let (chain, gauge) = (&job.machine.kinematics, tool.gauge_mm());
        let indexed = chain.indexed(placement, self.rotary, gauge);
        let places: Vec<_> = path.moves.iter().map(|m| indexed.axes(m.tip)).collect();
        let mut arc: Option<(usize, Arc)> = None;
        for (i, m) in path.moves.iter().enumerate() {
            let axes = places[i];
            chain
                .check_axes(axes, gauge)
                .map_err(|source| PostError::Travel { step: path.step, source })?;
            let lay = m.kind == MoveKind::Deposit;
            if let Some(e) = &module {
                self.switch(e, &mut state, lay);
            }
            if let Some((last, a)) = &arc {
                if i == *last {
                    self.arc(m, &places, i, a, module.as_ref());
                    (before, arc) = (Some(m.tip), None);
                }
                continue;
            }
            if self.dialect.arcs && i > 0 {
                let run = arcs_run(&path.moves, &places, i);
                arc = fit(&run).map(|a| (i - 1 + a.moves, a));
                if arc.is_some() {
                    continue;
                }
            }
            let words = [axes.x, axes.y, axes.z].map(|v| number(v, digits));
            if i == 0 {
                // Across at the parking height first, then along the machine's z.
                self.motion(m, &[Some(&words[0]), Some(&words[1]), None], None);
            }
            let length = before.map_or(0.0, |b| b.distance(m.tip));
            let filament = module.as_ref().filter(|_| lay).and_then(|e| e.filament(length, m.feed));
            self.motion(m, &[Some(&words[0]), Some(&words[1]), Some(&words[2])], filament);
            before = Some(m.tip);
        }
        if let Some(e) = &module {
            self.switch(e, &mut state, false);
            if state.drawn {
                self.give(e);
            }
        }
        Ok(())
    }

    /// Puts the bead into the state the next move needs.
    fn switch(&mut self, e: &Module, state: &mut Bead, lay: bool) {
        if lay == state.on && (lay || state.drawn) {
            return;
        }
        if !lay {
            if state.on && e.axis.is_none() {
                self.line(&format!("M{}", e.codes.off));
            }
            self.draw(e);
            (state.on, state.drawn) = (false, true);
            return;
        }
        if state.drawn {
            self.give(e);
        }
        if e.axis.is_none() {
            self.line(&format!("M{}", e.codes.on));
            if !state.primed && e.prime_s > 0.0 {
                self.dwell(e.prime_s);
            }
        }
        *state = Bead { on: true, drawn: false, primed: true };
    }

    fn dwell(&mut self, seconds: f64) {
        let text = match self.dialect.dwell {
            Dwell::Seconds => format!("G4 P{}", number(seconds, 3)),
            Dwell::Milliseconds => format!("G4 P{}", number(1000.0 * seconds, 0)),
        };
        self.line(&text);
    }

    fn draw(&mut self, e: &Module) {
        match e.axis {
            Some(axis) => self.filament(-axis.retract_mm),
            None => self.line(&format!("M{}", e.codes.draw)),
        }
    }

    fn give(&mut self, e: &Module) {
        match e.axis {
            Some(axis) => self.filament(axis.retract_mm),
            None => self.line(&format!("M{}", e.codes.give)),
        }
    }

    fn filament(&mut self, by: f64) {
        self.line(&format!("G1 E{} F{}", number(by, E_DIGITS), number(RETRACT_FEED, 1)));
        (self.last.motion, self.last.feed) = (Some(1), None);
    }

    /// An arc to the place of move `i`, about its centre relative to where it begins.
    fn arc(
        &mut self,
        m: &Move,
        places: &[AxisValues],
        i: usize,
        arc: &Arc,
        module: Option<&Module>,
    ) {
        let digits = self.dialect.linear_digits;
        let (from, to) = (places[i - arc.moves], places[i]);
        let code = if arc.anticlockwise { 3 } else { 2 };
        let (x, y) = (number(to.x, digits), number(to.y, digits));
        let middle = [number(arc.center.x - from.x, digits), number(arc.center.y - from.y, digits)];
        let mut text = format!("G{code} X{x} Y{y} I{} J{}", middle[0], middle[1]);
        let lays = m.kind == MoveKind::Deposit;
        if let Some(e) = module.filter(|_| lays).and_then(|e| e.filament(arc.length, m.feed)) {
            let _ = write!(text, " E{}", number(e, E_DIGITS));
        }
        self.feed_word(m, &mut text);
        (self.last.words[0], self.last.words[1]) = (Some(x), Some(y));
        // Said anew every time: a control that lost one must not go straight.
        self.last.motion = Some(code);
        self.line(&text);
    }

    fn feed_word(&mut self, m: &Move, text: &mut String) {
        let feed = number(m.feed.min(self.job.machine.control.max_feed_mm_min), 1);
        if self.last.feed.as_ref() != Some(&feed) {
            let _ = write!(text, " F{feed}");
            self.last.feed = Some(feed);
        }
    }

    /// One block; words that repeat the last value are left out, a block without words too.
    fn motion(&mut self, m: &Move, words: &[Option<&String>; 3], filament: Option<f64>) {
        let code = if m.kind == MoveKind::Rapid { 0 } else { 1 };
        let mut text = String::new();
        for ((letter, word), last) in "XYZ".chars().zip(words).zip(&mut self.last.words) {
            if let Some(w) = word
                && last.as_ref() != Some(*w)
            {
                let _ = write!(text, " {letter}{w}");
                *last = Some((*w).clone());
            }
        }
        if text.is_empty() {
            return;
        }
        if let Some(e) = filament {
            let _ = write!(text, " E{}", number(e, E_DIGITS));
        }
        if code == 1 {
            self.feed_word(m, &mut text);
        }
        let text = if self.dialect.modal && self.last.motion == Some(code) {
            text.trim_start().to_string()
        } else {
            format!("G{code}{text}")
        };
        self.last.motion = Some(code);
        self.line(&text);
    }
}

/// Where an arc that ends the move before `i` might lead: the points of a run of moves of one kind,
/// at one feed and one height.
fn arcs_run(moves: &[Move], places: &[AxisValues], i: usize) -> Vec<DVec2> {
    let (first, z) = (&moves[i], places[i - 1].z);
    let alike = |k: &usize| {
        let m = &moves[*k];
        m.kind == first.kind && m.feed == first.feed && (places[*k].z - z).abs() < LEVEL_MM
    };
    let works = matches!(first.kind, MoveKind::Cut | MoveKind::Deposit);
    let run = (i..moves.len()).take_while(|k| works && alike(k)).take(MOST_MOVES);
    std::iter::once(i - 1).chain(run).map(|k| DVec2::new(places[k].x, places[k].y)).collect()
}

/// Heights closer than this are one, mm: far below the last written digit.
const LEVEL_MM: f64 = 1e-6;

/// Digits of E words: 10⁻⁵ mm of filament are 2·10⁻⁴ mm of a fine bead.
const E_DIGITS: usize = 5;
