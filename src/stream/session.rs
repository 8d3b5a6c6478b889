//! Runs a job on real ports: one reader and one writer a device, and the core between them.
//!
//! Realtime bytes go ahead of queued ones. What is queued never exceeds the core's window, so
//! memory does not grow with the program. A peer that stops reading blocks its writer alone; the
//! core notices the silence, and the session ends whether or not the writer ever returns.

use super::Outcome;
use super::core::{Action, Command, Core, Device, Event, Micros, Note};
use super::transport::{Port, Reader, Writer};
use std::collections::VecDeque;
use std::io;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, channel, sync_channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// Most bytes of one write: a blocking descriptor takes them even when only that much is free.
const CHUNK: usize = 64;

/// How long what is still queued may take to leave at the end.
const LEAVING: Duration = Duration::from_millis(500);

/// Messages that may wait for the core.
const BACKLOG: usize = 256;

/// Someone who looks on.
pub trait Observer {
    fn note(&mut self, at: Micros, note: &Note, core: &Core);
}

enum Message {
    Bytes(Device, Vec<u8>),
    HungUp(Device),
    Command(Command),
}

/// Bytes on their way to a device.
#[derive(Default)]
struct Queue {
    urgent: VecDeque<u8>,
    lines: VecDeque<u8>,
    /// Counts discards, so that the rest of a partly written chunk is not put back after one.
    epoch: u64,
    closed: bool,
    writing: bool,
}

#[derive(Default)]
struct Outbox {
    queue: Mutex<Queue>,
    filled: Condvar,
}

impl Outbox {
    fn with<R>(&self, f: impl FnOnce(&mut Queue) -> R) -> R {
        let r = f(&mut self.lock());
        self.filled.notify_all();
        r
    }

    fn lock(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The next bytes to write, whether they are urgent, and the epoch; None when closed.
    fn next(&self) -> Option<(Vec<u8>, bool, u64)> {
        let mut q = self.lock();
        loop {
            q.writing = false;
            if q.closed {
                return None;
            }
            let urgent = !q.urgent.is_empty();
            if urgent || !q.lines.is_empty() {
                let from = if urgent { &mut q.urgent } else { &mut q.lines };
                let n = from.len().min(CHUNK);
                let chunk: Vec<u8> = from.drain(..n).collect();
                q.writing = true;
                return Some((chunk, urgent, q.epoch));
            }
            q = self.filled.wait(q).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Puts back what was not written.
    fn put_back(&self, rest: &[u8], urgent: bool, epoch: u64) {
        let mut q = self.lock();
        if urgent {
            rest.iter().rev().for_each(|b| q.urgent.push_front(*b));
        } else if q.epoch == epoch {
            rest.iter().rev().for_each(|b| q.lines.push_front(*b));
        }
    }
}

/// Sends commands into a running session; may be cloned and used from a signal handler's thread.
#[derive(Clone)]
pub struct Remote(Sender<Command>);

impl Remote {
    /// The session may be over already; then nothing happens.
    pub fn send(&self, command: Command) {
        let _ = self.0.send(command);
    }
}

/// A session that has not begun, and the remote control of it.
pub struct Session {
    commands: Receiver<Command>,
}

impl Session {
    pub fn new() -> (Session, Remote) {
        let (send, commands) = channel();
        (Session { commands }, Remote(send))
    }

    /// Runs a job to its end. The ports must have just been opened.
    pub fn run(
        self,
        mut core: Core,
        ports: [Option<Port>; 2],
        observer: &mut dyn Observer,
    ) -> Outcome {
        let began = Instant::now();
        let (send, messages) = sync_channel(BACKLOG);
        let mut outboxes: [Option<Arc<Outbox>>; 2] = [None, None];
        let mut writers = Vec::new();
        for (device, port) in Device::BOTH.into_iter().zip(ports) {
            let Some(port) = port else { continue };
            let outbox = Arc::new(Outbox::default());
            outboxes[device.index()] = Some(outbox.clone());
            let to_core = send.clone();
            let own = outbox.clone();
            thread::spawn(move || read(port.reader, device, &own, &to_core));
            let (own, to_core) = (outbox, send.clone());
            writers.push(thread::spawn(move || write(port.writer, device, &own, &to_core)));
        }
        let commands = self.commands;
        thread::spawn(move || {
            for command in commands {
                if send.send(Message::Command(command)).is_err() {
                    return;
                }
            }
        });
        let now = || Micros::try_from(began.elapsed().as_micros()).unwrap_or(Micros::MAX);
        let mut actions = Vec::new();
        loop {
            if let Some(outcome) = core.outcome() {
                let outcome = outcome.clone();
                leave(&outboxes, &writers);
                return outcome;
            }
            let wait = Duration::from_micros(core.wake().saturating_sub(now()));
            match messages.recv_timeout(wait) {
                Ok(Message::Bytes(device, bytes)) => {
                    core.handle(now(), Event::Received(device, &bytes), &mut actions);
                }
                Ok(Message::HungUp(device)) => {
                    core.handle(now(), Event::HungUp(device), &mut actions);
                }
                Ok(Message::Command(command)) => {
                    core.handle(now(), Event::Command(command), &mut actions);
                }
                Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => {
                    core.handle(now(), Event::Tick, &mut actions);
                }
            }
            for action in actions.drain(..) {
                act(action, &outboxes, &core, now(), observer);
            }
        }
    }
}

fn act(
    action: Action,
    outboxes: &[Option<Arc<Outbox>>; 2],
    core: &Core,
    now: Micros,
    observer: &mut dyn Observer,
) {
    let outbox = |device: Device| outboxes[device.index()].as_ref();
    match action {
        Action::Write(device, bytes) => {
            if let Some(o) = outbox(device) {
                o.with(|q| q.lines.extend(bytes));
            }
        }
        Action::Realtime(device, byte) => {
            if let Some(o) = outbox(device) {
                // One request on its way asks as much as two.
                o.with(|q| {
                    if byte != b'?' || !q.urgent.contains(&byte) {
                        q.urgent.push_back(byte);
                    }
                });
            }
        }
        Action::Discard(device) => {
            if let Some(o) = outbox(device) {
                o.with(|q| {
                    q.lines.clear();
                    q.epoch += 1;
                });
            }
        }
        Action::Note(note) => observer.note(now, &note, core),
    }
}

/// Lets the last bytes go, then lets go of the threads.
fn leave(outboxes: &[Option<Arc<Outbox>>; 2], writers: &[JoinHandle<()>]) {
    let until = Instant::now() + LEAVING;
    let busy = || {
        outboxes.iter().flatten().any(|o| {
            let q = o.lock();
            q.writing || !q.urgent.is_empty() || !q.lines.is_empty()
        })
    };
    while busy() && Instant::now() < until && !writers.iter().all(JoinHandle::is_finished) {
        thread::sleep(Duration::from_millis(2));
    }
    for o in outboxes.iter().flatten() {
        o.with(|q| q.closed = true);
    }
}

fn read(mut port: Reader, device: Device, outbox: &Outbox, to_core: &SyncSender<Message>) {
    let mut buf = [0; 1024];
    loop {
        match port.read(&mut buf) {
            Ok(0) => break,
            Ok(n) => {
                if to_core.send(Message::Bytes(device, buf[..n].to_vec())).is_err() {
                    return;
                }
            }
            Err(e) if is_patience(&e) => {
                if outbox.lock().closed {
                    return;
                }
            }
            Err(_) => break,
        }
    }
    let _ = to_core.send(Message::HungUp(device));
}

fn write(mut port: Writer, device: Device, outbox: &Outbox, to_core: &SyncSender<Message>) {
    while let Some((chunk, urgent, epoch)) = outbox.next() {
        match port.write(&chunk) {
            Ok(n) if n == chunk.len() => {}
            Ok(n) => outbox.put_back(&chunk[n..], urgent, epoch),
            Err(e) if is_patience(&e) => outbox.put_back(&chunk, urgent, epoch),
            Err(_) => {
                let _ = to_core.send(Message::HungUp(device));
                return;
            }
        }
    }
}

/// Nothing to read, no room to write, or interrupted: try again.
fn is_patience(e: &io::Error) -> bool {
    use io::ErrorKind::{Interrupted, TimedOut, WouldBlock};
    matches!(e.kind(), Interrupted | TimedOut | WouldBlock)
}
