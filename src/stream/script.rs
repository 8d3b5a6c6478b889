//! A program as it is sent: bare lines with what each needs around it.

/// What the extruder's codes do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ModuleCode {
    Open,
    Close,
    On,
    Off,
    Draw,
    Give,
}

/// What a line needs around it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
    Ordinary,
    /// Writes the controller's memory, during which received bytes may be lost.
    Store,
    /// M0, M1: the answer comes when the person goes on.
    Pause,
    ToolChange,
    Extruder(ModuleCode),
    /// M2, M30.
    End,
}

impl Class {
    /// Every earlier motion must be over before the line is written.
    pub fn drain_before(self) -> bool {
        !matches!(self, Class::Ordinary | Class::End)
    }

    /// The line must be answered before the next is written.
    pub fn wait_after(self) -> bool {
        self != Class::Ordinary
    }

    /// May wait for a person.
    pub fn waits_for_person(self) -> bool {
        matches!(self, Class::Pause | Class::ToolChange)
    }
}

/// One line of a script.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line {
    /// Where it stands in the file, from 1.
    pub number: u32,
    pub class: Class,
    /// Whether it may set axes in motion.
    pub moves: bool,
    /// Seconds from the start of the program to the end of this line, by the motion model.
    pub done_s: f64,
    /// Seconds of dwell in this line.
    pub dwell_s: f32,
    start: usize,
    length: usize,
}

/// The lines to send, in one piece of text.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Script {
    text: String,
    lines: Vec<Line>,
}

impl Script {
    /// Adds a line that takes `seconds`, of which `dwell_s` are a dwell.
    pub fn push(
        &mut self,
        number: u32,
        text: &str,
        class: Class,
        moves: bool,
        [seconds, dwell_s]: [f64; 2],
    ) {
        let done_s = self.total_s() + seconds;
        let start = self.text.len();
        self.text.push_str(text);
        let dwell_s = dwell_s as f32;
        self.lines.push(Line { number, class, moves, done_s, dwell_s, start, length: text.len() });
    }

    pub fn len(&self) -> usize {
        self.lines.len()
    }

    pub fn is_empty(&self) -> bool {
        self.lines.is_empty()
    }

    pub fn line(&self, i: usize) -> Option<&Line> {
        self.lines.get(i)
    }

    pub fn lines(&self) -> &[Line] {
        &self.lines
    }

    /// Text of line `i`; empty beyond the end.
    pub fn text(&self, i: usize) -> &str {
        self.lines.get(i).map_or("", |l| &self.text[l.start..l.start + l.length])
    }

    /// Line of the file, from 1; 0 beyond the end.
    pub fn number(&self, i: usize) -> u32 {
        self.lines.get(i).map_or(0, |l| l.number)
    }

    /// Seconds until the end of the first `n` lines.
    pub fn seconds(&self, n: usize) -> f64 {
        n.checked_sub(1).and_then(|i| self.lines.get(i)).map_or(0.0, |l| l.done_s)
    }

    pub fn total_s(&self) -> f64 {
        self.lines.last().map_or(0.0, |l| l.done_s)
    }

    /// Whether any line is for the extruder.
    pub fn extrudes(&self) -> bool {
        self.lines.iter().any(|l| matches!(l.class, Class::Extruder(_)))
    }

    /// Index of the first line at or after a line of the file.
    pub fn index_of(&self, number: u32) -> usize {
        self.lines.partition_point(|l| l.number < number)
    }
}
