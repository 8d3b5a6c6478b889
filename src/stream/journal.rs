//! What happened, line by line, in a file that only grows.
//!
//! One JSON object a line, each with the seconds since the ports were opened. Every transition is on
//! the disk before the job goes on, and the counts at least once a second, so that a power cut
//! costs a second of knowledge. Lines are those of the file, so that a later job can read them.

use super::core::{Core, Micros, Note, SECOND};
use super::session::Observer;
use super::{Outcome, Position, Script};
use serde::{Deserialize, Serialize};
use std::fs::{File, OpenOptions};
use std::io::{self, Read as _, Write as _};
use std::path::Path;
use std::sync::Arc;

/// A journal is not read beyond this size, bytes: a year of one job.
const MOST_BYTES: u64 = 1 << 30;

/// How far a job is, in lines of the file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counts {
    pub written: u32,
    /// Answered: read by the controller, not necessarily done.
    pub confirmed: u32,
    /// Motion over.
    pub settled: u32,
}

/// One entry.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "entry", rename_all = "kebab-case")]
pub enum Entry {
    Begin {
        sha256: String,
        file: String,
        dialect: String,
        /// First line of the file this job runs.
        from: u32,
        lines: usize,
        /// Where in that line it begins, in work coordinates, mm; None for the line's start.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        at: Option<[f64; 3]>,
    },
    At(Counts),
    Event {
        what: String,
    },
    End {
        ending: String,
        what: String,
        code: u8,
        counts: Counts,
        machine: Option<Vec<f64>>,
        work: Option<Vec<f64>>,
        not_off: Vec<String>,
    },
}

#[derive(Serialize, Deserialize)]
struct Timed {
    t: f64,
    #[serde(flatten)]
    entry: Entry,
}

/// A journal being written.
pub struct Journal {
    file: File,
    /// What is written when the job begins.
    begin: Option<Entry>,
    script: Arc<Script>,
    /// First line of the file this job runs.
    from: u32,
    counts: Counts,
    synced: Micros,
    dirty: bool,
    /// The first write that failed; the job goes on, and the report says so.
    pub failed: Option<io::Error>,
}

impl Journal {
    /// Opens a journal to append to. The job begins in it with its first line, so that one which
    /// never came that far does not hide the job before. It runs the file from a line on, from a
    /// point within it if one is given.
    ///
    /// # Errors
    /// The file cannot be opened for writing.
    pub fn open(
        path: &Path,
        script: Arc<Script>,
        (from, at): (u32, Option<[f64; 3]>),
        [sha256, file, dialect]: [&str; 3],
    ) -> io::Result<Journal> {
        let lines = script.len();
        let [sha256, name, dialect] = [sha256, file, dialect].map(String::from);
        Ok(Journal {
            file: OpenOptions::new().create(true).append(true).open(path)?,
            begin: Some(Entry::Begin { sha256, file: name, dialect, from, lines, at }),
            script,
            from,
            counts: Counts::default(),
            synced: 0,
            dirty: false,
            failed: None,
        })
    }

    fn append(&mut self, at: Micros, entry: Entry) -> io::Result<()> {
        let timed = Timed { t: at as f64 / SECOND as f64, entry };
        let mut text = serde_json::to_string(&timed).map_err(io::Error::other)?;
        text.push('\n');
        self.file.write_all(text.as_bytes())?;
        self.file.sync_data()
    }

    fn record(&mut self, at: Micros, entry: Entry) {
        if let Err(e) = self.append(at, entry) {
            self.failed.get_or_insert(e);
        }
        self.synced = at;
        self.dirty = false;
    }

    /// The file's line up to which `n` lines of the script reach.
    fn line(&self, n: usize) -> u32 {
        let number = n.checked_sub(1).map_or(0, |i| self.script.number(i));
        // Lines that lead to a resume have no number.
        number.max(self.from.saturating_sub(1))
    }

    /// The end of the job.
    pub fn end(&mut self, at: Micros, outcome: &Outcome) {
        if self.begin.is_some() {
            return;
        }
        let (machine, work) = match &outcome.position {
            Position::Known { machine, work } => (machine.clone(), work.clone()),
            Position::Unknown => (None, None),
        };
        let counts = Counts {
            confirmed: self.line(outcome.confirmed),
            settled: self.line(outcome.settled),
            ..self.counts
        };
        let ending = outcome.ending.word().to_string();
        let (what, code) = (outcome.ending.to_string(), outcome.ending.exit_code());
        let not_off = outcome.not_off.clone();
        self.record(at, Entry::End { ending, what, code, counts, machine, work, not_off });
    }
}

impl Observer for Journal {
    fn note(&mut self, at: Micros, note: &Note, _: &Core) {
        if self.begin.is_some() && *note != Note::Began {
            return;
        }
        match note {
            Note::Written(n) => self.counts.written = self.line(*n),
            Note::Confirmed(n) => self.counts.confirmed = self.line(*n),
            Note::Settled(n) => self.counts.settled = self.line(*n),
            Note::Began => {
                if let Some(begin) = self.begin.take() {
                    self.record(at, begin);
                }
            }
            Note::Waits { number, why } => {
                let what = format!("waits at line {number}: {why}");
                self.record(at, Entry::Event { what });
            }
            Note::GoesOn => self.record(at, Entry::Event { what: "goes on".into() }),
            Note::Stopping(what) => {
                let counts = self.counts;
                self.record(at, Entry::At(counts));
                self.record(at, Entry::Event { what: format!("stopping: {what}") });
            }
            Note::Warning(what) => self.record(at, Entry::Event { what: what.clone() }),
            Note::Delivery(delivery) => self.record(at, Entry::Event { what: delivery.in_words() }),
            Note::Again { .. } | Note::Status(_) | Note::Said { .. } => {}
        }
        self.dirty |= matches!(note, Note::Written(_) | Note::Confirmed(_) | Note::Settled(_));
        if self.dirty && at >= self.synced + SECOND {
            let counts = self.counts;
            self.record(at, Entry::At(counts));
        }
    }
}

/// The last job of a journal.
#[derive(Clone, Debug, PartialEq)]
pub struct Last {
    pub sha256: String,
    pub from: u32,
    /// Where in that line it began, if not at its start.
    pub at: Option<[f64; 3]>,
    pub counts: Counts,
    /// None when the job was cut off.
    pub end: Option<Entry>,
}

/// Reads the last job of a journal. A last entry that is cut off is left out: the power went while
/// it was written.
///
/// # Errors
/// The file cannot be read, or is no journal.
pub fn last(path: &Path) -> io::Result<Last> {
    let mut text = String::new();
    File::open(path)?.take(MOST_BYTES).read_to_string(&mut text)?;
    let not = |what: &str| io::Error::new(io::ErrorKind::InvalidData, what.to_string());
    let mut last: Option<Last> = None;
    let mut lines = text.lines().peekable();
    while let Some(line) = lines.next() {
        let entry = match serde_json::from_str::<Timed>(line) {
            Ok(timed) => timed.entry,
            Err(_) if lines.peek().is_none() => break,
            Err(_) => return Err(not("it holds what is no entry of a journal")),
        };
        match (entry, &mut last) {
            (Entry::Begin { sha256, from, at, .. }, _) => {
                let before = from.saturating_sub(1);
                let counts = Counts { written: before, confirmed: before, settled: before };
                last = Some(Last { sha256, from, at, counts, end: None });
            }
            (Entry::At(counts), Some(job)) => job.counts = counts,
            (end @ Entry::End { .. }, Some(job)) => {
                if let Entry::End { counts, .. } = &end {
                    job.counts = *counts;
                }
                job.end = Some(end);
            }
            _ => {}
        }
    }
    last.ok_or_else(|| not("it holds no job"))
}
