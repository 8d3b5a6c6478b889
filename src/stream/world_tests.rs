//! A sender, its devices and the lines between them, in virtual time; and what must hold of every
//! run.

use super::core::{Action, Command, Core, Device, Event, Limits, Micros, Note, SECOND, Setup};
use super::sim::{FaultScript, Faulty, SimSetup};
use super::{Dialect, Outcome, Preflight};
use std::collections::VecDeque;
use std::sync::Arc;

/// Bytes a line carries in a step, and the step: 115 200 baud.
const CHUNK: usize = 58;
const STEP: Micros = 5_000;

/// A run that takes longer has hung.
const LONGEST: Micros = 1800 * SECOND;

/// What a person does during a run.
#[derive(Clone, Copy, Debug, Default)]
pub struct Person {
    /// Stops the job at this time.
    pub stops: Option<Micros>,
    /// Stops again so long after.
    pub again: Option<Micros>,
    /// Holds the machine at this time, and lets it go on so long after.
    pub holds: Option<[Micros; 2]>,
    /// Sets an override at this time.
    pub overrides: Option<(Micros, u8)>,
}

pub struct World {
    core: Core,
    pub devices: [Option<Faulty>; 2],
    queues: [VecDeque<u8>; 2],
    due: [Micros; 2],
    now: Micros,
    /// Lines written to the control and not answered, as an onlooker counts them.
    open: VecDeque<usize>,
    part: [Vec<u8>; 2],
    pub most_open: usize,
    pub notes: Vec<Note>,
    began: bool,
    /// A stop is under way for another reason.
    stopping: bool,
    /// The control said something after which only a stop may follow.
    fallen: bool,
    pub after_fall: Vec<String>,
    control: Dialect,
    waits: Option<Micros>,
    gone: [bool; 2],
    /// Lines answered, and when that last changed.
    seen: (usize, Micros),
    /// The person stopped it because nothing happened any more.
    pub gave_up: bool,
}

impl World {
    pub fn new(
        preflight: &Preflight,
        setups: [Option<SimSetup>; 2],
        scripts: [FaultScript; 2],
        check: bool,
    ) -> World {
        World::with(preflight, setups, scripts, [check, false])
    }

    /// A world without faults, in which only a verified run may begin.
    pub fn verified(preflight: &Preflight, setups: [Option<SimSetup>; 2]) -> World {
        World::with(preflight, setups, Default::default(), [false, true])
    }

    fn with(
        preflight: &Preflight,
        setups: [Option<SimSetup>; 2],
        scripts: [FaultScript; 2],
        [check, verified]: [bool; 2],
    ) -> World {
        let dialect = |s: &Option<SimSetup>| s.as_ref().map(|s| s.dialect);
        let control = dialect(&setups[0]).unwrap();
        let core = Core::new(Setup {
            script: Arc::new(preflight.script.clone()),
            control,
            extruder: dialect(&setups[1]),
            module_off: ["M73", "M74", "M71"].map(String::from).to_vec(),
            check,
            end: preflight.end.clone(),
            verified,
            limits: Limits::default(),
        });
        let [a, b] = setups;
        let [x, y] = scripts;
        World {
            core,
            devices: [a.map(|s| Faulty::new(s, x)), b.map(|s| Faulty::new(s, y))],
            queues: Default::default(),
            due: [0; 2],
            now: 0,
            open: VecDeque::new(),
            part: Default::default(),
            most_open: 0,
            notes: Vec::new(),
            began: false,
            stopping: false,
            fallen: false,
            after_fall: Vec::new(),
            control,
            waits: None,
            gone: [false; 2],
            seen: (0, 0),
            gave_up: false,
        }
    }

    /// Runs the job to its end; None when it has none.
    pub fn run(&mut self, person: Person) -> Option<Outcome> {
        let mut stops: Vec<Micros> = person.stops.into_iter().collect();
        stops.extend(person.stops.zip(person.again).map(|(a, b)| a + b));
        stops.reverse();
        let mut asks: Vec<(Micros, Command)> = Vec::new();
        if let Some([at, takes]) = person.holds {
            asks.extend([(at, Command::Hold), (at + takes, Command::Resume)]);
        }
        asks.extend(person.overrides.map(|(at, byte)| (at, Command::Override(byte))));
        loop {
            if let Some(outcome) = self.core.outcome() {
                return Some(outcome.clone());
            }
            if self.now >= LONGEST {
                return None;
            }
            self.move_bytes();
            if stops.last().is_some_and(|t| self.now >= *t) {
                stops.pop();
                self.event(Event::Command(Command::Stop));
            }
            while let Some(i) = asks.iter().position(|(t, _)| self.now >= *t) {
                let (_, command) = asks.remove(i);
                self.event(Event::Command(command));
            }
            if self.waits.is_some_and(|t| self.now >= t) {
                self.waits = None;
                self.event(Event::Command(Command::Resume));
            }
            let confirmed = self.core.progress().1;
            if confirmed != self.seen.0 {
                self.seen = (confirmed, self.now);
            } else if self.now >= self.seen.1 + 300 * SECOND {
                // Nothing has happened for long; a person gives up.
                self.seen.1 = self.now;
                self.gave_up = true;
                self.event(Event::Command(Command::Stop));
            }
            self.event(Event::Tick);
            let mut next = self.core.wake().max(self.now + 1);
            for i in 0..2 {
                if let Some(d) = &self.devices[i] {
                    next = next.min(d.next().unwrap_or(Micros::MAX).max(self.now + 1));
                }
                if !self.queues[i].is_empty() {
                    next = next.min(self.due[i].max(self.now + 1));
                }
            }
            next = next.min(stops.last().copied().unwrap_or(Micros::MAX).max(self.now + 1));
            self.now = next;
        }
    }

    fn move_bytes(&mut self) {
        for device in Device::BOTH {
            let i = device.index();
            let Some(d) = &mut self.devices[i] else { continue };
            d.advance(self.now);
            if self.now >= self.due[i] && !self.queues[i].is_empty() {
                let n = self.queues[i].len().min(CHUNK);
                let bytes: Vec<u8> = self.queues[i].drain(..n).collect();
                d.receive(&bytes, self.now);
                self.due[i] = self.now + STEP;
            }
            let said = d.take(usize::MAX);
            let hung_up = d.hung_up;
            if !said.is_empty() {
                if device == Device::Control {
                    self.listen(&said);
                }
                self.event(Event::Received(device, &said));
            }
            if hung_up && !self.gone[i] {
                self.gone[i] = true;
                self.event(Event::HungUp(device));
            }
        }
    }

    /// What an onlooker makes of the control's words.
    fn listen(&mut self, said: &[u8]) {
        for b in said {
            if *b != b'\n' {
                self.part[0].push(*b);
                continue;
            }
            let line = String::from_utf8_lossy(&self.part[0]).trim().to_string();
            self.part[0].clear();
            if line == "ok" || line.starts_with("error:") {
                self.open.pop_front();
            }
            let banner = line.starts_with("Grbl") || line == "start" || line.starts_with("RepRap");
            if banner && !self.began {
                self.open.clear();
            }
            let fall = line.starts_with("error:") || line.starts_with("ALARM:") || banner;
            self.fallen |= self.began && !self.stopping && fall;
        }
    }

    fn event(&mut self, event: Event) {
        let mut out = Vec::new();
        let before = self.after_fall.len();
        self.core.handle(self.now, event, &mut out);
        for action in out {
            match action {
                Action::Write(device, bytes) => {
                    if device == Device::Control {
                        self.count(&bytes);
                    }
                    let i = device.index();
                    if self.queues[i].is_empty() {
                        self.due[i] = self.due[i].max(self.now + 1000);
                    }
                    self.queues[i].extend(bytes);
                }
                Action::Realtime(device, b) => {
                    let i = device.index();
                    if device == Device::Control && b == 0x18 {
                        // A reset empties the receive buffer, also when its banner is late.
                        self.open.clear();
                    }
                    if self.queues[i].is_empty() {
                        self.due[i] = self.due[i].max(self.now + 1000);
                    }
                    self.queues[i].push_front(b);
                    if device == Device::Control && self.fallen && !b"!?\x18".contains(&b) {
                        self.after_fall.push(format!("byte 0x{b:02X}"));
                    }
                }
                Action::Discard(device) => {
                    self.queues[device.index()].clear();
                    if device == Device::Control {
                        // Queued for replies that came before the fall in the same breath.
                        self.after_fall.truncate(before);
                    }
                }
                Action::Note(note) => {
                    self.began |= note == Note::Began;
                    self.stopping |= matches!(note, Note::Stopping(_));
                    if matches!(note, Note::Waits { .. }) {
                        self.waits = Some(self.now + SECOND);
                    }
                    self.notes.push(note);
                }
            }
        }
    }

    fn count(&mut self, bytes: &[u8]) {
        let text = String::from_utf8_lossy(bytes);
        if self.fallen {
            self.after_fall.push(text.trim().to_string());
        }
        if self.control.is_grbl() {
            self.open.extend(text.split_inclusive('\n').map(str::len));
            self.most_open = self.most_open.max(self.open.iter().sum());
        }
    }

    /// Lines of the program that a device ran, without the sender's own.
    pub fn ran(&self, device: Device) -> Vec<String> {
        let Some(d) = &self.devices[device.index()] else { return Vec::new() };
        let run = d.sim.record().run.iter();
        run.filter(|l| !OWN.contains(&l.as_str())).cloned().collect()
    }
}

/// Lines that programs of these tests do not have in this spelling.
pub const OWN: [&str; 11] =
    ["M108", "G4P0", "M400", "M114", "M5", "M9", "M107", "M410", "$I", "$G", ""];
