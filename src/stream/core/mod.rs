//! The sender as a pure state machine: events and the time go in, actions come out.
//!
//! A job goes through greeting (what are you, are you at rest), running, finishing (everything
//! answered, every motion over) and, when anything goes wrong or a person says so, stopping
//! (`stop`). Each device has a `Link` that knows which lines are unanswered. Nothing
//! here reads a clock or does I/O, so that a fault takes microseconds to play through.

mod event;
mod hear;
mod link;
mod numbered;
mod stop;
mod vouch;
mod watch;

pub use event::{Action, Command, Device, EndPoint, Event, Limits, Micros, Note, SECOND, Setup};

use super::outcome::{Delivery, Ending, Means, Outcome, Position};
use super::reply::Lines;
use super::{Class, Dialect, State, Status};
use link::{Link, Tag};
use stop::Stop;
pub use vouch::Checks;
use vouch::{REST_TOLERANCE, Vouch};

/// One device as the core sees it.
struct Peer {
    dialect: Dialect,
    link: Link,
    lines: Lines,
    /// When anything was last heard of it, and last written to it.
    heard: Micros,
    wrote: Micros,
    hung_up: bool,
    /// Whether it told its receive buffer when asked before, and since it was asked last.
    told: [bool; 2],
    greeting: Greeting,
    /// The parser's state, told and not yet looked at.
    parser: Option<String>,
}

/// How far the greeting is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Greeting {
    /// Waits for the banner, or for time to show that none comes.
    Banner,
    /// Waits for the state (grbl).
    State,
    /// Waits for the answers; counts the questions asked.
    Asking(u8),
    /// Waits for the parser's state.
    Modes,
    Ready,
}

/// Whether motion was waited for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Drain {
    /// Lines were written since.
    Dirty,
    Asked,
    Clean,
}

enum Phase {
    Greeting,
    Running,
    /// Everything written; counts the idle reports since.
    Finishing {
        idle: u8,
    },
    /// Leaves the check mode.
    Leaving {
        until: Micros,
    },
    Stopping(Box<Stop>),
    Over,
}

/// The sender of one job.
pub struct Core {
    setup: Setup,
    peers: [Option<Peer>; 2],
    phase: Phase,
    now: Micros,
    /// Next line to write.
    next: usize,
    confirmed: usize,
    settled: usize,
    /// Nothing more is written until every line is answered.
    wait_all: bool,
    drain: Drain,
    polled: Micros,
    status: Option<Status>,
    /// Last known work coordinate offset.
    offset: Option<Vec<f64>>,
    /// Since when the controller reports rest while lines are unanswered.
    resting: Option<Micros>,
    held_by_person: bool,
    waits: bool,
    /// The person said to go on; the answer is now due.
    told_to_go_on: bool,
    vouch: Vouch,
    /// A line behind which the parser's state is still to be asked.
    question: Option<u32>,
    outcome: Option<Outcome>,
}

/// Idle reports in a row, without anything else, that end a job.
const IDLE_REPORTS: u8 = 2;

/// How often the build information is asked for: a damaged figure is then seen as the larger.
const ASKS: u8 = 2;

/// Asks for the parser's state: modes, feed, speed and tool as they are behind the line before.
const ASK_STATE: &str = "$G";

impl Core {
    /// A job that begins when its ports have just been opened.
    pub fn new(setup: Setup) -> Core {
        let peer = |dialect: Dialect| Peer {
            dialect,
            link: Link::new(dialect),
            lines: Lines::default(),
            heard: 0,
            wrote: 0,
            hung_up: false,
            told: [false; 2],
            greeting: Greeting::Banner,
            parser: None,
        };
        Core {
            peers: [Some(peer(setup.control)), setup.extruder.map(peer)],
            vouch: Vouch::new(setup.control.planner_blocks()),
            question: None,
            setup,
            phase: Phase::Greeting,
            now: 0,
            next: 0,
            confirmed: 0,
            settled: 0,
            wait_all: false,
            drain: Drain::Dirty,
            polled: 0,
            status: None,
            offset: None,
            resting: None,
            held_by_person: false,
            waits: false,
            told_to_go_on: false,
            outcome: None,
        }
    }

    pub fn outcome(&self) -> Option<&Outcome> {
        self.outcome.as_ref()
    }

    /// Lines written and answered.
    pub fn progress(&self) -> (usize, usize) {
        (self.next, self.confirmed)
    }

    /// Bytes of the controller's window, and those written and not answered.
    pub fn window(&self) -> (Option<usize>, usize) {
        self.peers[0].as_ref().map_or((None, 0), |p| p.link.window())
    }

    /// When the core wants to be called again if nothing happens.
    pub fn wake(&self) -> Micros {
        let poll = self.setup.limits.poll;
        if self.polled + poll > self.now { self.polled + poll } else { self.now + poll }
    }

    /// Takes one event at time `now`, which never runs backwards.
    pub fn handle(&mut self, now: Micros, event: Event, out: &mut Vec<Action>) {
        self.now = self.now.max(now);
        if matches!(self.phase, Phase::Over) {
            return;
        }
        match event {
            Event::Tick => {}
            Event::Received(device, bytes) => self.receive(device, bytes, out),
            Event::HungUp(device) => {
                if let Some(p) = &mut self.peers[device.index()] {
                    p.hung_up = true;
                }
                self.fail(Ending::HungUp { device }, out);
            }
            Event::Command(command) => self.command(command, out),
        }
        self.step(out);
    }

    fn peer(&mut self, device: Device) -> Option<&mut Peer> {
        self.peers[device.index()].as_mut()
    }

    fn step(&mut self, out: &mut Vec<Action>) {
        self.poll(out);
        match self.phase {
            Phase::Greeting => self.greet(out),
            Phase::Running => self.pump(out),
            Phase::Finishing { .. } => self.finish(out),
            Phase::Leaving { until } if self.now >= until => self.end(Ending::Done, out),
            Phase::Stopping(_) => self.stop_step(out),
            Phase::Leaving { .. } | Phase::Over => {}
        }
        if !matches!(self.phase, Phase::Over | Phase::Stopping(_) | Phase::Leaving { .. }) {
            self.watch(out);
        }
    }

    /// Asks the controller for its status, as often as it may be asked.
    fn poll(&mut self, out: &mut Vec<Action>) {
        let asks = match &self.phase {
            Phase::Stopping(s) => s.polls(),
            Phase::Leaving { .. } | Phase::Over => false,
            _ => true,
        };
        let Some(p) = &self.peers[0] else { return };
        let due = self.now >= self.polled + self.setup.limits.poll;
        if asks && due && p.dialect.is_grbl() && !p.hung_up && p.greeting != Greeting::Banner {
            self.polled = self.now;
            out.push(Action::Realtime(Device::Control, b'?'));
        }
    }

    fn write(&mut self, device: Device, tag: Tag, text: &str, out: &mut Vec<Action>) {
        let now = self.now;
        if let Some(p) = self.peer(device) {
            p.wrote = now;
            let bytes = p.link.push(tag, text);
            out.push(Action::Write(device, bytes));
        }
    }

    /// Brings both devices to where lines can be sent.
    fn greet(&mut self, out: &mut Vec<Action>) {
        for device in Device::BOTH {
            let (now, until) = (self.now, self.setup.limits.banner);
            let Some(p) = self.peer(device) else { continue };
            if p.greeting == Greeting::Banner && now >= until {
                self.begin_talk(device, out);
            }
        }
        if self.peers.iter().flatten().all(|p| p.greeting == Greeting::Ready) {
            if let Some(device) = self.unverifiable() {
                return self.fail(Ending::Unverifiable { device }, out);
            }
            self.phase = Phase::Running;
            out.push(Action::Note(Note::Began));
            self.pump(out);
        }
    }

    /// The banner came, or none will: the first question.
    fn begin_talk(&mut self, device: Device, out: &mut Vec<Action>) {
        let now = self.now;
        let off = self.setup.module_off.first().filter(|_| self.setup.verified).cloned();
        let Some(p) = self.peer(device) else { return };
        p.heard = now;
        p.link.clear();
        match (p.dialect, off) {
            // Whether it repeats its codes shows with the first: one that switches off does no harm.
            (Dialect::Plain, Some(off)) => {
                p.greeting = Greeting::Asking(1);
                self.write(device, Tag::Ask, &off, out);
            }
            (Dialect::Plain, None) => p.greeting = Greeting::Ready,
            (d, _) if d.is_numbered() => {
                p.greeting = Greeting::Asking(1);
                self.write(device, Tag::Ask, "", out);
            }
            _ => {
                p.greeting = Greeting::State;
                self.polled = 0;
                self.poll(out);
            }
        }
    }

    fn all_idle(&self) -> bool {
        self.peers.iter().flatten().all(|p| p.link.is_idle())
    }

    /// Writes as many lines as fit.
    fn pump(&mut self, out: &mut Vec<Action>) {
        loop {
            if self.held_by_person || (self.wait_all && !self.all_idle()) {
                return;
            }
            self.wait_all = false;
            if !self.put_question(out) {
                return;
            }
            let Some(line) = self.setup.script.line(self.next).copied() else {
                if self.drained(out) {
                    self.phase = Phase::Finishing { idle: 0 };
                    self.finish(out);
                }
                return;
            };
            if line.class.drain_before() && !self.drained(out) {
                return;
            }
            let device = match line.class {
                Class::Extruder(_) if self.peers[1].is_some() => Device::Extruder,
                _ => Device::Control,
            };
            let length = self.setup.script.text(self.next).len();
            if !self.peer(device).is_some_and(|p| p.link.room(length)) {
                return;
            }
            let script = self.setup.script.clone();
            self.write(device, Tag::Line(self.next), script.text(self.next), out);
            if device == Device::Control {
                self.drain = Drain::Dirty;
                let asks =
                    self.vouch.wrote(self.next, line.number, script.text(self.next), line.class);
                self.question = asks.then_some(line.number);
            }
            self.wait_all = line.class.wait_after();
            self.next += 1;
            out.push(Action::Note(Note::Written(self.next)));
        }
    }

    /// Asks for the parser's state where that is due; false when it does not fit yet.
    fn put_question(&mut self, out: &mut Vec<Action>) -> bool {
        let Some(number) = self.question else { return true };
        // grblHAL forgets a refusal with the next of these questions, and would run what is behind
        // it: so nothing may be unanswered.
        let alone = self.setup.control == Dialect::GrblHal;
        let fits = |p: &mut Peer| p.link.room(ASK_STATE.len()) && (!alone || p.link.is_idle());
        if !self.peer(Device::Control).is_some_and(fits) {
            return false;
        }
        self.write(Device::Control, Tag::Modes, ASK_STATE, out);
        self.vouch.ask(number);
        self.question = None;
        true
    }

    /// Whether every motion is over; asks for it when it is not known.
    fn drained(&mut self, out: &mut Vec<Action>) -> bool {
        let lines = self.setup.control.drain();
        if self.drain == Drain::Dirty {
            if lines.is_empty() {
                self.drain = Drain::Asked;
            } else {
                // All of its lines or none.
                let room = self.peer(Device::Control).is_some_and(|p| match lines {
                    [one] => p.link.room(one.len()),
                    _ => p.link.is_idle(),
                });
                if !room {
                    return false;
                }
                for (i, text) in lines.iter().enumerate() {
                    let last = i + 1 == lines.len();
                    self.write(Device::Control, Tag::Drain { last }, text, out);
                }
                self.drain = Drain::Asked;
            }
        }
        if self.drain == Drain::Asked && lines.is_empty() && self.all_idle() {
            self.settle(out);
        }
        self.drain == Drain::Clean && self.all_idle()
    }

    fn settle(&mut self, out: &mut Vec<Action>) {
        self.drain = Drain::Clean;
        self.vouch.settled();
        if self.settled != self.next {
            self.settled = self.next;
            out.push(Action::Note(Note::Settled(self.settled)));
        }
    }

    /// The end, once the machine says that it rests.
    fn finish(&mut self, out: &mut Vec<Action>) {
        let Phase::Finishing { idle } = self.phase else { return };
        if !self.all_idle() || (self.setup.control.is_grbl() && idle < IDLE_REPORTS) {
            return;
        }
        if self.setup.check {
            let until = self.now + self.setup.limits.reset;
            self.phase = Phase::Leaving { until };
            out.push(Action::Realtime(Device::Control, stop::RESET));
            return;
        }
        match self.astray() {
            Some(what) => self.fail(Ending::Astray { what }, out),
            None => self.end(Ending::Done, out),
        }
    }

    /// Where the machine rests otherwise than the program says.
    fn astray(&self) -> Option<String> {
        let status = self.status.as_ref()?;
        self.setup.end.iter().find_map(|e| {
            let found = if e.machine {
                *self.machine_position(status)?.get(e.axis)?
            } else {
                *self.work_position(status)?.get(e.axis)?
            };
            // Some are set to report inches.
            let off = [1.0, 25.4].iter().all(|u| (found * u - e.at).abs() > REST_TOLERANCE);
            off.then(|| format!("{} is at {found:.3}, the program ends at {:.3}", e.letter, e.at))
        })
    }

    fn work_position(&self, s: &Status) -> Option<Vec<f64>> {
        let minus = |m: &Vec<f64>, o: &Vec<f64>| m.iter().zip(o).map(|(m, o)| m - o).collect();
        s.work.clone().or_else(|| Some(minus(s.machine.as_ref()?, self.offset.as_ref()?)))
    }

    fn machine_position(&self, s: &Status) -> Option<Vec<f64>> {
        let plus = |w: &Vec<f64>, o: &Vec<f64>| w.iter().zip(o).map(|(w, o)| w + o).collect();
        s.machine.clone().or_else(|| Some(plus(s.work.as_ref()?, self.offset.as_ref()?)))
    }

    fn command(&mut self, command: Command, out: &mut Vec<Action>) {
        let grbl = self.setup.control.is_grbl();
        if let Phase::Stopping(_) = self.phase {
            if command == Command::Stop {
                self.stop_harder(out);
            }
            return;
        }
        match command {
            Command::Stop => self.fail(Ending::Stopped, out),
            Command::Hold => {
                self.held_by_person = true;
                if grbl {
                    out.push(Action::Realtime(Device::Control, b'!'));
                }
            }
            Command::Resume => {
                self.held_by_person = false;
                self.waits = false;
                self.told_to_go_on = true;
                self.resting = None;
                if grbl {
                    out.push(Action::Realtime(Device::Control, b'~'));
                } else if self.setup.control.is_numbered() {
                    // Goes without a number, since the device reads no further than the pause.
                    out.push(Action::Write(Device::Control, b"M108\n".to_vec()));
                }
                out.push(Action::Note(Note::GoesOn));
            }
            Command::Override(byte) => {
                if grbl && (0x90..=0xA1).contains(&byte) {
                    if byte >= 0xA0 {
                        self.vouch.coolant_switched();
                    }
                    out.push(Action::Realtime(Device::Control, byte));
                }
            }
        }
    }

    /// The file's line of a tag; 0 for lines of the sender's own.
    fn number(&self, tag: Tag) -> u32 {
        match tag {
            Tag::Line(i) => self.setup.script.number(i),
            _ => 0,
        }
    }

    /// Text of a tag's line.
    fn text(&self, tag: Tag) -> String {
        match tag {
            Tag::Line(i) => self.setup.script.text(i).into(),
            Tag::Clear => "".into(),
            Tag::Ask => "$I".into(),
            Tag::Check => "$C".into(),
            Tag::Modes => ASK_STATE.into(),
            Tag::Drain { .. } => self.setup.control.drain().join(" "),
        }
    }

    fn in_flight(&self) -> Option<[u32; 2]> {
        let script = &self.setup.script;
        (self.confirmed < self.next)
            .then(|| [script.number(self.confirmed), script.number(self.next - 1)])
    }

    /// The job is over.
    fn end(&mut self, ending: Ending, out: &mut Vec<Action>) {
        let position = match (&self.status, &ending) {
            (Some(s), Ending::Done) if s.state == State::Idle => {
                Position::Known { machine: self.machine_position(s), work: self.work_position(s) }
            }
            _ => Position::Unknown,
        };
        self.end_at(ending, position, Vec::new(), out);
    }

    fn end_at(
        &mut self,
        ending: Ending,
        position: Position,
        not_off: Vec<String>,
        out: &mut Vec<Action>,
    ) {
        let script = &self.setup.script;
        let in_flight = match &self.phase {
            Phase::Stopping(s) => s.in_flight(),
            _ => self.in_flight(),
        };
        if ending == Ending::Done && !self.setup.check {
            out.push(Action::Note(Note::Delivery(self.delivery())));
        }
        self.outcome = Some(Outcome {
            ending,
            confirmed: self.confirmed,
            settled: self.settled,
            total: script.len(),
            last_confirmed: self.confirmed.checked_sub(1).map_or(0, |i| script.number(i)),
            in_flight,
            position,
            not_off,
            delivery: self.delivery(),
        });
        self.phase = Phase::Over;
    }

    /// A device that cannot give the verified run that was asked for.
    fn unverifiable(&self) -> Option<Device> {
        let delivery = self.delivery();
        match (self.setup.verified, delivery.control, delivery.extruder) {
            (true, Means::Unproven, _) => Some(Device::Control),
            (true, _, Some(Means::Unproven)) => Some(Device::Extruder),
            _ => None,
        }
    }

    /// What vouches for the lines that were written.
    fn delivery(&self) -> Delivery {
        let means = |p: &Peer| p.link.means();
        let sent = self.setup.script.extrudes();
        Delivery {
            control: self.peers[0].as_ref().map_or(Means::Unproven, means),
            extruder: self.peers[1].as_ref().filter(|_| sent).map(means),
            checks: self.vouch.checks,
        }
    }
}
