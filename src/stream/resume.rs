//! Where a stopped job goes on, and how the machine gets there.
//!
//! `ok` means read, not done: between the last line known to be done and the last one written lie
//! the planner and the window. Where a hold brought the machine to rest is known to the digit, so
//! the block it rests in is found by its path; the job goes on from that very point, and no motion
//! is done twice or left out. Without such a point a job goes on at the first line that may not be
//! done, which repeats motions: harmless for a cutter, not for a nozzle, hence refused there.

use super::journal::{Entry, Last};
use super::modal::{AXES, Modal, Rates, Spindle, Way};
use super::path::{distance, off_segment};
use super::preflight::look_at;
use super::{Class, Cleared, Dialect, Fault, Preflight, Script, Setting};
use crate::gcode::read_block;

/// How near a path a machine at rest must be to be on it, mm: some steps and the report's last
/// digit. Larger, and neighbouring blocks are confused.
const ON_PATH_MM: f64 = 0.02;

/// Feed at which the tool goes down to where it stopped, at most, mm/min.
const PLUNGE_MM_MIN: f64 = 200.0;

/// Time for a spindle to come up to speed, s.
const SPIN_UP_S: f64 = 3.0;

/// What a person says about the machine.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Said {
    /// It is homed, its offsets are as before, spindle and extruder are off.
    pub position_known: bool,
    /// Go on at this line of the file.
    pub from_line: Option<u32>,
}

/// Why a job cannot go on.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Refusal {
    #[error("the journal is of another program; a changed file must be started anew")]
    OtherProgram,
    #[error("the job is done; start it anew without --resume")]
    Done,
    #[error(
        "the position is not known; home the machine, make sure that its offsets are as before \
         and that spindle and extruder are off, then add --position-known"
    )]
    PositionUnknown,
    #[error(
        "the extruder's state is not known ({0}); close the module by hand, then add \
         --position-known and --from-line"
    )]
    ExtruderUnknown(String),
    #[error("line {line}: {what}; name a line before it with --from-line")]
    Unsafe { line: u32, what: &'static str },
    #[error(
        "the machine rests at X{0:.3} Y{1:.3} Z{2:.3}, which lies on none, or on several, of the \
         blocks it may have been in; name the line to go on at with --from-line"
    )]
    NotOnPath(f64, f64, f64),
    #[error("line {0} is beyond what the job has written; the lines between would be left out")]
    TooFar(u32),
    #[error("the way back is refused: {0}")]
    WayBack(Fault),
}

/// A job that goes on.
#[derive(Clone, Debug, PartialEq)]
pub struct Resumed {
    pub preflight: Preflight,
    /// Line of the file at which it goes on.
    pub line: u32,
    /// What is sent before it.
    pub preamble: Vec<String>,
    /// The very point where the machine came to rest, if it goes on there; work coordinates, mm.
    pub at: Option<[f64; 3]>,
}

/// Plans how a job goes on.
///
/// # Errors
/// When that is not safe.
pub fn resume(
    program: &Cleared,
    full: &Preflight,
    setting: &Setting,
    last: &Last,
    said: Said,
) -> Result<Resumed, Refusal> {
    if last.sha256 != program.sha256() {
        return Err(Refusal::OtherProgram);
    }
    let on_way_back = last.at.is_some() && last.counts.written < last.from;
    let (mut held, mut rests) = (None, false);
    let mut unconfirmed = Some("the job was cut off".to_string());
    if let Some(Entry::End { ending, work, machine, not_off, .. }) = &last.end {
        if ending == "done" {
            return Err(Refusal::Done);
        }
        held = work.clone().filter(|w| w.len() >= 3);
        // On the way back no point of the program is looked for: any coordinates will do.
        rests = held.is_some() || (on_way_back && machine.is_some());
        unconfirmed = (!not_off.is_empty()).then(|| format!("{} unconfirmed", not_off.join(", ")));
    }
    if !rests && !said.position_known {
        return Err(Refusal::PositionUnknown);
    }
    let script = &full.script;
    let extrudes = script.extrudes();
    if let Some(what) = unconfirmed.filter(|_| extrudes && !said.position_known) {
        return Err(Refusal::ExtruderUnknown(what));
    }
    // First line that may not be done, and the first not written.
    let planner = setting.control.planner_blocks() as u32;
    let sure = last.counts.settled.max(last.counts.confirmed.saturating_sub(planner));
    let first = script.lines().partition_point(|l| l.number <= sure);
    let beyond = script.lines().partition_point(|l| l.number <= last.counts.written);
    let rates = Rates::of(setting.machine);
    let (index, at) = match (said.from_line, &held) {
        (Some(line), _) if line > last.counts.written.saturating_add(1) => {
            return Err(Refusal::TooFar(line));
        }
        (Some(line), _) => (script.index_of(line), None),
        // Stopped on its way back: where the job before it was stopped still holds.
        (None, _) if on_way_back => (script.index_of(last.from), last.at),
        (None, Some(at)) => {
            let point = [at[0], at[1], at[2]];
            (find(script, &rates, [first, beyond], point)?, Some(point))
        }
        (None, None) => (first, None),
    };
    let before = state_before(script, &rates, index);
    let line = script.number(index).max(1);
    safe(script, index, &before, line)?;
    if at.is_none()
        && said.from_line.is_none()
        && (before.module.on || laid(script, [index, beyond]))
    {
        return Err(Refusal::ExtruderUnknown(
            "how much was extruded behind the last wait is not recorded".into(),
        ));
    }
    let preamble = preamble(setting, &before, at);
    let text = preamble.join("\n");
    let way = look_at(text.as_bytes(), setting).map_err(|f| {
        Refusal::WayBack(f.into_iter().next().unwrap_or(Fault { number: 0, what: String::new() }))
    })?;
    let preflight = Preflight {
        script: joined(&way.script, script, index),
        warnings: full.warnings.clone(),
        end: full.end.clone(),
    };
    Ok(Resumed { preflight, line, preamble, at })
}

/// Whether lines switch extrusion on.
fn laid(script: &Script, [from, to]: [usize; 2]) -> bool {
    let lines = &script.lines()[from.min(to)..to];
    lines.iter().any(|l| matches!(l.class, Class::Extruder(_)))
}

fn step(modal: &mut Modal, script: &Script, rates: &Rates, i: usize) {
    if let Ok(words) = read_block(script.text(i)) {
        modal.apply(&words, rates);
    }
    if let Some(l) = script.line(i)
        && let Class::Extruder(code) = l.class
    {
        modal.module.run(code);
    }
}

/// What holds before line `index`.
fn state_before(script: &Script, rates: &Rates, index: usize) -> Modal {
    let mut modal = Modal::default();
    for i in 0..index {
        step(&mut modal, script, rates, i);
    }
    modal
}

/// The one block among those that may be under way on which the machine rests.
fn find(
    script: &Script,
    rates: &Rates,
    [first, beyond]: [usize; 2],
    at: [f64; 3],
) -> Result<usize, Refusal> {
    let none = Refusal::NotOnPath(at[0], at[1], at[2]);
    let mut modal = state_before(script, rates, first);
    let (mut found, mut ended) = (Vec::new(), None);
    for i in first..beyond {
        let from = known(&modal);
        step(&mut modal, script, rates, i);
        if !script.line(i).is_some_and(|l| l.moves) {
            continue;
        }
        let (Some(from), Some(to)) = (from, known(&modal)) else { continue };
        if matches!(modal.way, Way::Arc { .. }) {
            if distance(at, from) > ON_PATH_MM && near_arc(at, from, to) {
                return Err(Refusal::Unsafe {
                    line: script.number(i),
                    what: "the machine may rest inside an arc",
                });
            }
            continue;
        }
        if distance(at, to) <= ON_PATH_MM {
            ended = Some(i + 1);
        } else if off_segment(at, from, to) <= ON_PATH_MM {
            found.push(i);
        }
    }
    match (found.as_slice(), ended) {
        // At the end of one block and the beginning of the next it is the next.
        ([one], _) => Ok(*one),
        ([], Some(next)) => Ok(next),
        // It has not begun the first.
        ([], None) if first < beyond => {
            let start = known(&state_before(script, rates, first));
            let at_start = start.is_none_or(|s| distance(at, s) <= ON_PATH_MM);
            if at_start { Ok(first) } else { Err(none) }
        }
        ([], None) => Ok(first),
        _ => Err(none),
    }
}

fn known(m: &Modal) -> Option<[f64; 3]> {
    Some([m.work[0]?, m.work[1]?, m.work[2]?])
}

/// Whether a point may lie on some arc between two points, generously.
fn near_arc(p: [f64; 3], a: [f64; 3], b: [f64; 3]) -> bool {
    let reach = 2.0 * distance(a, b) + 1.0;
    distance(p, a) <= reach || distance(p, b) <= reach
}

fn safe(script: &Script, index: usize, m: &Modal, line: u32) -> Result<(), Refusal> {
    let mut at = m.clone();
    if let Ok(words) = read_block(script.text(index)) {
        let rates = Rates { rapid_mm_min: 1.0, max_feed_mm_min: 1.0, rapid_deg_min: 1.0 };
        at.apply(&words, &rates);
    }
    let moves = script.line(index).is_some_and(|l| l.moves);
    let refuse = |what| Err(Refusal::Unsafe { line, what });
    match (m.way, at.way) {
        (_, Way::Arc { .. }) if moves => return refuse("an arc needs its true start point"),
        (Way::Cycle, _) | (_, Way::Cycle) => return refuse("it lies in a canned cycle"),
        _ => {}
    }
    if m.relative || at.relative {
        return refuse("positions are relative there (G91)");
    }
    if m.inverse_time {
        return refuse("feeds are inverse times there (G93)");
    }
    if m.shifted {
        return refuse("the program has set offsets before it (G92, G10)");
    }
    Ok(())
}

/// Retract, rotary axes, XY, spindle, coolant, extruder, dwell or prime, plunge, go.
fn preamble(setting: &Setting, m: &Modal, at: Option<[f64; 3]>) -> Vec<String> {
    let machine = setting.machine;
    let mut out: Vec<String> = Vec::new();
    let numbered = setting.control.is_numbered();
    out.push("G21".into());
    out.push("G90".into());
    if !numbered {
        out.push("G94".into());
        out.push(format!("G{}", m.plane));
    }
    if m.system != 54 || !numbered {
        out.push(format!("G{}", m.system));
    }
    out.push(format!("G53 G0 Z{}", machine.kinematics.z.home_mm));
    if let (Dialect::GrblHal, Some(tool)) = (setting.control, m.loaded) {
        out.push(format!("M61 Q{tool}"));
    }
    if let Some(h) = m.length {
        out.push(format!("G43 H{h}"));
    }
    let place = |i: usize| at.and_then(|p| p.get(i).copied()).or(m.work[i]);
    let word = |i: usize| place(i).map(|v| format!(" {}{}", AXES[i], number(v)));
    for axes in [&[3, 4, 5][..], &[0, 1]] {
        let words: String = axes.iter().filter_map(|i| word(*i)).collect();
        if !words.is_empty() {
            out.push(format!("G0{words}"));
        }
    }
    if let Some(s) = m.speed.filter(|_| m.spindle != Spindle::Off) {
        let code = if m.spindle == Spindle::Clockwise { 3 } else { 4 };
        out.push(format!("M{code} S{}", number(s)));
    }
    if m.mist {
        out.push("M7".into());
    }
    if m.flood {
        out.push("M8".into());
    }
    let mut wait = if m.spindle == Spindle::Off { 0.0 } else { SPIN_UP_S };
    if let Some(e) = machine.extruder.as_ref().filter(|_| m.module.open) {
        out.push(e.m_open.clone());
        // The stop has drawn the filament back.
        if !m.module.drawn {
            out.push(e.m_retract_off.clone());
        }
        if m.module.on {
            out.push(e.m_on.clone());
            wait = e.prime_s;
        }
    }
    if wait > 0.0 {
        out.push(format!("G4 P{}", number(wait)));
    }
    let feed = m.feed.unwrap_or(PLUNGE_MM_MIN);
    if let Some(z) = word(2) {
        out.push(format!("G1{z} F{}", number(feed.min(PLUNGE_MM_MIN))));
    }
    if m.inches {
        out.push("G20".into());
    }
    if m.feed.is_some() {
        out.push(format!("G1 F{}", number(if m.inches { feed / 25.4 } else { feed })));
    }
    if m.way != Way::Feed {
        out.push("G0".into());
    }
    out
}

fn number(v: f64) -> String {
    let text = format!("{v:.4}");
    text.trim_end_matches('0').trim_end_matches('.').to_string()
}

/// The way back, then the rest of the program.
fn joined(way: &Script, rest: &Script, index: usize) -> Script {
    let mut out = Script::default();
    for (script, range) in [(way, 0..way.len()), (rest, index..rest.len())] {
        for i in range {
            let Some(l) = script.line(i) else { continue };
            let number = if std::ptr::eq(script, way) { 0 } else { l.number };
            let seconds = l.done_s - script.seconds(i);
            let dwell = f64::from(l.dwell_s);
            out.push(number, script.text(i), l.class, l.moves, [seconds, dwell]);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::machine::Machine;
    use crate::stream::Counts;

    const PROGRAM: &str = "G21\nG90\nG94\nG17\nG54\nG43 H1\nG0 A30 C45\nS9000 M3\nG0 X0 Y0 Z50\n\
                           G1 Z10 F300\nG1 X20 F600\nY20\nX0\nG2 X5 Y5 I5 J0\nG53 G0 Z750\nM30\n";

    fn told(counts: [u32; 3], work: Option<[f64; 3]>, not_off: &[&str]) -> Last {
        let [written, confirmed, settled] = counts;
        let counts = Counts { written, confirmed, settled };
        let work = work.map(|w| w.to_vec());
        let not_off = not_off.iter().map(ToString::to_string).collect();
        let (ending, what) = ("stopped".into(), String::new());
        let end = Entry::End { ending, what, code: 130, counts, machine: None, work, not_off };
        Last {
            sha256: Cleared::unchecked(PROGRAM.into()).sha256().into(),
            from: 1,
            at: None,
            counts,
            end: Some(end),
        }
    }

    fn go(last: &Last, said: Said) -> Result<Resumed, Refusal> {
        let machine = Machine::builtin("generic-5axis").unwrap();
        let setting = Setting { machine: &machine, control: Dialect::GrblHal, extruder: None };
        let program = Cleared::unchecked(PROGRAM.into());
        let full = super::super::preflight(&program, &setting).unwrap();
        resume(&program, &full, &setting, last, said)
    }

    #[test]
    fn it_goes_on_where_the_machine_rests() {
        let r = go(&told([13, 13, 2], Some([20.0, 7.5, 10.0]), &[]), Said::default()).unwrap();
        assert_eq!((r.line, r.at), (12, Some([20.0, 7.5, 10.0])));
        assert_eq!(
            r.preamble,
            [
                "G21",
                "G90",
                "G94",
                "G17",
                "G54",
                "G53 G0 Z750",
                "G43 H1",
                "G0 A30 C45",
                "G0 X20 Y7.5",
                "M3 S9000",
                "G4 P3",
                "G1 Z10 F200",
                "G1 F600"
            ]
        );
        let s = &r.preflight.script;
        assert_eq!((s.text(13), s.number(13), s.number(12)), ("Y20", 12, 0));
        assert_eq!(s.text(s.len() - 1), "M30");
    }

    #[test]
    fn stopped_on_the_way_back_it_goes_on_where_the_job_before_was_stopped() {
        let at = Some([20.0, 7.5, 10.0]);
        let whole = go(&told([13, 13, 2], at, &[]), Said::default()).unwrap();
        let on_the_way = |end: [f64; 3], not_off: &[&str]| Last {
            from: 12,
            at,
            ..told([11, 11, 11], Some(end), not_off)
        };
        let again = on_the_way([3.0, 1.0, 600.0], &[]);
        assert_eq!(go(&again, Said::default()).unwrap(), whole);
        // So short a job may never have been told its offset.
        let mut told = again.clone();
        if let Some(Entry::End { work, machine, .. }) = &mut told.end {
            *machine = work.take();
        }
        assert_eq!(go(&told, Said::default()).unwrap(), whole);
        let cut = Last { end: None, ..again.clone() };
        assert_eq!(go(&cut, Said::default()), Err(Refusal::PositionUnknown));
        let said = Said { position_known: true, from_line: None };
        assert_eq!(go(&cut, said).unwrap(), whole);
        // Once a line of the file was written, the point is behind.
        let further = Last { counts: Counts { written: 13, confirmed: 13, settled: 12 }, ..again };
        assert!(matches!(go(&further, Said::default()), Err(Refusal::NotOnPath(..))));
    }

    #[test]
    fn at_a_corner_it_is_the_next_block() {
        let r = go(&told([13, 13, 2], Some([20.0, 20.0, 10.0]), &[]), Said::default()).unwrap();
        assert_eq!(r.line, 13);
    }

    #[test]
    fn what_is_not_safe_is_refused() {
        let at = Some([20.0, 7.5, 10.0]);
        let with = |f: &dyn Fn(&mut Last)| {
            let mut l = told([13, 13, 2], at, &[]);
            f(&mut l);
            go(&l, Said::default())
        };
        assert_eq!(with(&|l| l.sha256 = "0".into()), Err(Refusal::OtherProgram));
        assert_eq!(with(&|l| l.end = None), Err(Refusal::PositionUnknown));
        let away = told([13, 13, 9], Some([7.0, 7.0, 7.0]), &[]);
        assert!(matches!(go(&away, Said::default()), Err(Refusal::NotOnPath(..))));
        let said = |line| Said { position_known: true, from_line: Some(line) };
        let cut = told([14, 14, 2], None, &[]);
        assert!(matches!(go(&cut, said(14)), Err(Refusal::Unsafe { line: 14, .. })));
        assert!(matches!(go(&cut, said(16)), Err(Refusal::TooFar(16))));
        assert_eq!(go(&cut, said(11)).unwrap().line, 11);
        assert_eq!(go(&cut, Said { position_known: true, from_line: None }).unwrap().line, 3);
    }
}
