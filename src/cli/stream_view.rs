//! What a person sees of a job: one line on a terminal, a plain log elsewhere, JSON events with
//! `--json`; and the report at its end.

use super::args::OutputArgs;
use hmplan::stream::core::{Core, Micros, Note, SECOND};
use hmplan::stream::{
    Delivery, Ending, Journal, Means, Observer, Outcome, Position, Script, State, Status,
};
use serde_json::{Value, json};
use std::io::{self, IsTerminal as _, Write as _};
use std::sync::Arc;

/// Between two lines of the plain log while nothing else happens.
const LOG_EVERY: Micros = 10 * SECOND;
/// Between two redraws or two progress events.
const SHOW_EVERY: Micros = SECOND / 5;

#[derive(Clone, Copy, PartialEq, Eq)]
enum Mode {
    Quiet,
    Line,
    Log,
    Json,
}

/// Looks on and tells.
pub struct View {
    mode: Mode,
    script: Arc<Script>,
    pub journal: Option<Journal>,
    status: Option<Status>,
    offset: Option<Vec<f64>>,
    overrides: Option<[u32; 3]>,
    confirmed: usize,
    shown: Micros,
    logged: Micros,
    pub now: Micros,
    pub repeated: u64,
    pub waits: u64,
}

/// Says on standard error what a run may be worse for: a line of text, or an event among the others.
pub fn warn(json: bool, t: f64, what: &str) {
    // A log that nobody reads any more must not end a job.
    let _ = match json {
        true => writeln!(io::stderr(), "{}", warning(t, what)),
        false => writeln!(io::stderr(), "warning: {what}"),
    };
}

fn warning(t: f64, what: &str) -> Value {
    json!({"event": "warning", "t": t, "what": what})
}

impl View {
    pub fn new(output: &OutputArgs, script: Arc<Script>, journal: Option<Journal>) -> View {
        let mode = match (output.json, output.quiet) {
            (true, _) => Mode::Json,
            (_, true) => Mode::Quiet,
            _ if io::stderr().is_terminal() => Mode::Line,
            _ => Mode::Log,
        };
        View {
            mode,
            script,
            journal,
            status: None,
            offset: None,
            overrides: None,
            confirmed: 0,
            shown: 0,
            logged: 0,
            now: 0,
            repeated: 0,
            waits: 0,
        }
    }

    fn say(&self, text: &str, event: Value) {
        let mut err = io::stderr().lock();
        // A log that nobody reads any more must not end a job.
        let _ = match self.mode {
            Mode::Quiet => Ok(()),
            Mode::Line => writeln!(err, "\r\x1b[K{text}"),
            Mode::Log => writeln!(err, "{text}"),
            Mode::Json => writeln!(err, "{event}"),
        };
    }

    /// Share of the program's time that is behind, by the motion model.
    fn share(&self) -> f64 {
        let total = self.script.total_s();
        if total > 0.0 {
            self.script.seconds(self.confirmed) / total
        } else {
            self.confirmed as f64 / self.script.len().max(1) as f64
        }
    }

    fn progress(&mut self, core: &Core) {
        let share = self.share();
        let left = self.script.total_s() * (1.0 - share);
        let line = self.script.number(self.confirmed.saturating_sub(1));
        let (window, used) = core.window();
        let work = self.work();
        match self.mode {
            Mode::Quiet => {}
            Mode::Json => {
                let s = self.status.as_ref();
                self.say(
                    "",
                    json!({
                        "event": "progress", "t": seconds(self.now), "share": share,
                        "seconds_left": left, "line": line,
                        "state": s.map(|s| format!("{:?}", s.state)), "work": work,
                        "feed": s.and_then(|s| s.feed_speed).map(|f| f.0),
                        "override": self.overrides.map(|o| o[0]),
                        "buffer": used, "window": window,
                    }),
                );
            }
            Mode::Line | Mode::Log => {
                let place = work.map_or(String::new(), |w| {
                    let letters = w.iter().zip(["X", "Y", "Z", "A", "B", "C"]);
                    letters.map(|(v, l)| format!(" {l}{v:.2}")).collect()
                });
                let feed = self.status.as_ref().and_then(|s| s.feed_speed);
                let feed = feed.map_or(String::new(), |(f, _)| format!("  F{f:.0}"));
                let over = self.overrides.map_or(String::new(), |o| format!(" {} %", o[0]));
                let buffer = window.map_or(String::new(), |w| format!("  buffer {used}/{w}"));
                let text = format!(
                    "{:5.1} %  line {line}  {} left {place}{feed}{over}{buffer}",
                    100.0 * share,
                    clock(left)
                );
                if self.mode == Mode::Line {
                    let _ =
                        write!(io::stderr().lock(), "\r\x1b[K{}", text.get(..100).unwrap_or(&text));
                } else {
                    self.say(&text, Value::Null);
                }
            }
        }
    }

    fn work(&self) -> Option<Vec<f64>> {
        let s = self.status.as_ref()?;
        let minus =
            |m: &Vec<f64>| Some(m.iter().zip(self.offset.as_ref()?).map(|(m, o)| m - o).collect());
        s.work.clone().or_else(|| s.machine.as_ref().and_then(minus))
    }

    fn keep(&mut self, note: &Note) {
        match note {
            Note::Confirmed(n) => self.confirmed = *n,
            Note::Again { .. } => self.repeated += 1,
            Note::Waits { .. } => self.waits += 1,
            Note::Status(s) => {
                self.offset = s.offset.clone().or(self.offset.take());
                self.overrides = s.overrides.or(self.overrides);
                self.status = Some((**s).clone());
            }
            _ => {}
        }
    }
}

impl Observer for View {
    fn note(&mut self, at: Micros, note: &Note, core: &Core) {
        self.now = at;
        if let Some(j) = &mut self.journal {
            j.note(at, note, core);
        }
        self.keep(note);
        let t = seconds(at);
        match note {
            Note::Began => self.say(
                "the controller is ready; sending",
                json!({"event": "began", "t": t, "window": core.window().0}),
            ),
            Note::Waits { number, why } => self.say(
                &format!("line {number}: {why}; press r (or type resume) to go on"),
                json!({"event": "waits", "t": t, "line": number, "why": why}),
            ),
            Note::GoesOn => self.say("goes on", json!({"event": "goes-on", "t": t})),
            Note::Delivery(delivery) => self.say(
                &delivery.in_words(),
                json!({
                    "event": "delivery", "t": t, "verified": delivery.is_verified(),
                    "what": delivery.in_words(),
                }),
            ),
            Note::Stopping(why) => self
                .say(&format!("stopping: {why}"), json!({"event": "stopping", "t": t, "why": why})),
            Note::Warning(what) => {
                self.say(&format!("warning: {what}"), warning(t, what));
            }
            Note::Said { device, text } if text.starts_with("[MSG") => self.say(
                &format!("{device}: {text}"),
                json!({"event": "said", "t": t, "device": device.to_string(), "text": text}),
            ),
            _ => {}
        }
        let every = if self.mode == Mode::Log { LOG_EVERY } else { SHOW_EVERY };
        let last = if self.mode == Mode::Log { &mut self.logged } else { &mut self.shown };
        if at >= *last + every {
            *last = at;
            self.progress(core);
        }
    }
}

pub fn seconds(at: Micros) -> f64 {
    (at as f64 / SECOND as f64 * 1000.0).round() / 1000.0
}

fn clock(s: f64) -> String {
    let s = s.max(0.0).round() as u64;
    format!("{}:{:02}:{:02}", s / 3600, s / 60 % 60, s % 60)
}

/// The job's report as text.
pub fn report(o: &Outcome, view: &View) -> String {
    let unproven = o.ending == Ending::Done && !o.delivery.is_verified();
    let mut out = format!(
        "{}{}: {} of {} lines answered, the last is line {}; {:.1} s\n",
        o.ending,
        if unproven { ", NOT VERIFIED" } else { "" },
        o.confirmed,
        o.total,
        o.last_confirmed,
        seconds(view.now)
    );
    if let Some([first, last]) = o.in_flight {
        out += &format!("in flight    lines {first} to {last}: written, not answered\n");
    }
    if view.repeated > 0 {
        out += &format!("repeated     {} lines were damaged and written again\n", view.repeated);
    }
    let place = match &o.position {
        Position::Unknown => "not known".to_string(),
        Position::Known { machine, work } => {
            let list = |v: &Option<Vec<f64>>| {
                let v = v.as_ref()?;
                Some(v.iter().map(|c| format!("{c:.3}")).collect::<Vec<_>>().join(", "))
            };
            match (list(work), list(machine)) {
                (Some(w), Some(m)) => format!("work {w}; machine {m}"),
                (Some(w), None) => format!("work {w}"),
                (None, Some(m)) => format!("machine {m}"),
                (None, None) => "at rest, not reported".into(),
            }
        }
    };
    out += &format!("position     {place}\n");
    if !o.not_off.is_empty() {
        out += &format!("NOT OFF      nobody confirmed {}\n", o.not_off.join(", "));
    }
    if o.last_confirmed > 0 {
        out += &format!("delivery     {}\n", o.delivery.in_words());
    }
    out + &format!("next         {}\n", o.next_action())
}

/// What vouches for the lines, for programs that read it.
fn delivery(d: &Delivery) -> Value {
    json!({
        "control": d.control.word(), "extruder": d.extruder.map(Means::word),
        "positions_on_path": d.checks.places, "positions_at_rest": d.checks.rests,
        "parser_states": d.checks.states, "what": d.in_words(),
    })
}

/// The job's report as one JSON object.
pub fn report_json(o: &Outcome, view: &View) -> Value {
    let (known, machine, work) = match &o.position {
        Position::Known { machine, work } => (true, machine.clone(), work.clone()),
        Position::Unknown => (false, None, None),
    };
    json!({
        "ending": o.ending.word(), "what": o.ending.to_string(), "exit_code": o.ending.exit_code(),
        "lines": o.total, "confirmed": o.confirmed, "settled": o.settled,
        "last_confirmed_line": o.last_confirmed, "in_flight": o.in_flight,
        "position_known": known, "machine_position": machine, "work_position": work,
        "verified": o.delivery.is_verified(), "delivery": delivery(&o.delivery),
        "not_off": o.not_off, "repeated": view.repeated, "waits": view.waits,
        "seconds": seconds(view.now), "model_seconds": view.script.total_s(),
        "at_rest": view.status.as_ref().is_some_and(|s| s.state == State::Idle),
        "next_action": o.next_action(),
    })
}
