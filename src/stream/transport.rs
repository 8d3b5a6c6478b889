//! Ports: real ones and the simulated controller, each as a reader and a writer.
//!
//! A read gives up after [`PATIENCE`] and a write after as long, so that neither thread can hang
//! on a peer that stopped. A serial port is opened once, for itself alone, and never reopened:
//! opening resets an Arduino.

use super::Dialect;
use super::core::Micros;
use super::sim::{FaultScript, Faulty, SimSetup};
use crate::base::rng;
use std::io;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// How long a read or a write waits. Longer, and a stop waits for it; shorter, and idle threads
/// wake for nothing.
pub const PATIENCE: Duration = Duration::from_millis(50);

/// What simulated ports begin with.
const SIM: &str = "sim:";

pub type Reader = Box<dyn io::Read + Send>;
pub type Writer = Box<dyn io::Write + Send>;

/// Why a port cannot be had.
#[derive(Debug, thiserror::Error)]
pub enum PortError {
    #[error("{name}: there is no such port; `hmplan stream --list-ports` shows those there are")]
    Missing { name: String },
    #[error(
        "{name}: no permission to open it; add yourself to the port's group (often dialout) and \
         log in again"
    )]
    Forbidden { name: String },
    #[error("{name}: another program uses it; close that one")]
    InUse { name: String },
    #[error("{name}: not a serial port, or it cannot be set up ({source})")]
    NotASerialPort { name: String, source: io::Error },
    #[error("'{name}': {what}")]
    BadSimulation { name: String, what: String },
}

/// A port's two halves.
pub struct Port {
    pub reader: Reader,
    pub writer: Writer,
}

/// The dialect a port's name says, which only simulated ones do.
pub fn dialect_of(name: &str) -> Option<Dialect> {
    let spec = name.strip_prefix(SIM)?;
    Dialect::named(spec.split(',').next().unwrap_or(""))
}

/// Opens a port: a device's path, or `sim:DIALECT` with options behind commas.
///
/// # Errors
/// Missing, forbidden, in use, no serial port at all, or a simulation that makes no sense.
pub fn open(name: &str, baud: u32, base: &SimSetup) -> Result<Port, PortError> {
    match name.strip_prefix(SIM) {
        Some(spec) => open_sim(name, spec, base),
        None => open_serial(name, baud),
    }
}

fn open_serial(name: &str, baud: u32) -> Result<Port, PortError> {
    let owned = || name.to_string();
    let builder = serialport::new(name, baud).timeout(PATIENCE);
    let port = builder.open().map_err(|e| classify(name, &e))?;
    let copy = port.try_clone().map_err(|e| PortError::NotASerialPort {
        name: owned(),
        source: io::Error::other(e.to_string()),
    })?;
    Ok(Port { reader: Box::new(port), writer: Box::new(copy) })
}

/// What an error of opening means; the library says "no device" for several of them.
fn classify(name: &str, e: &serialport::Error) -> PortError {
    use io::ErrorKind::{NotFound, PermissionDenied, ResourceBusy};
    let owned = name.to_string();
    let probe = std::fs::metadata(name);
    match (&e.kind, probe) {
        (_, Err(m)) if m.kind() == NotFound => PortError::Missing { name: owned },
        (_, Err(m)) if m.kind() == PermissionDenied => PortError::Forbidden { name: owned },
        (serialport::ErrorKind::Io(PermissionDenied), _) => PortError::Forbidden { name: owned },
        (serialport::ErrorKind::Io(ResourceBusy), _) => PortError::InUse { name: owned },
        (serialport::ErrorKind::NoDevice, _) if is_tty(name) => PortError::InUse { name: owned },
        _ => PortError::NotASerialPort { name: owned, source: io::Error::other(e.to_string()) },
    }
}

#[cfg(unix)]
fn is_tty(name: &str) -> bool {
    use std::os::unix::fs::FileTypeExt as _;
    std::fs::metadata(name).is_ok_and(|m| m.file_type().is_char_device())
}

#[cfg(not(unix))]
fn is_tty(_: &str) -> bool {
    true
}

/// Serial ports of this computer, with what is known of each.
pub fn list() -> Vec<String> {
    let ports = serialport::available_ports().unwrap_or_default();
    let mut names: Vec<String> = ports
        .into_iter()
        .map(|p| match p.port_type {
            serialport::SerialPortType::UsbPort(usb) => {
                let product = usb.product.unwrap_or_else(|| "USB".into());
                format!("{}  {product} ({:04x}:{:04x})", p.port_name, usb.vid, usb.pid)
            }
            _ => p.port_name,
        })
        .collect();
    names.sort();
    names
}

/// A simulated device and the clock it lives by.
struct Bench {
    device: Mutex<Faulty>,
    arrived: Condvar,
    began: Instant,
}

impl Bench {
    fn lock(&self) -> MutexGuard<'_, Faulty> {
        self.device.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn now(&self) -> Micros {
        Micros::try_from(self.began.elapsed().as_micros()).unwrap_or(Micros::MAX)
    }
}

struct SimReader(Arc<Bench>);
struct SimWriter(Arc<Bench>);

/// `grblhal,speed=100,faults=7,echo`
fn open_sim(name: &str, spec: &str, base: &SimSetup) -> Result<Port, PortError> {
    let bad = |what: String| PortError::BadSimulation { name: name.into(), what };
    let mut words = spec.split(',');
    let dialect = words.next().and_then(Dialect::named).ok_or_else(|| {
        let known: Vec<&str> = Dialect::ALL.iter().map(|d| d.name()).collect();
        bad(format!("name a dialect to simulate: {}", known.join(", ")))
    })?;
    let fresh = SimSetup::new(dialect);
    let mut setup = SimSetup {
        module: fresh.module || base.module,
        drops_damaged: fresh.drops_damaged,
        dialect,
        ..base.clone()
    };
    let mut script = FaultScript::default();
    for word in words {
        let number = |v: &str| v.parse::<f64>().ok().filter(|v| (0.0..=1e9).contains(v));
        match word.split_once('=').map(|(k, v)| (k, number(v))) {
            Some(("speed", Some(v))) => setup.speed = v,
            Some(("faults", Some(v))) => {
                script = FaultScript::random(&mut rng(v as u64, 0), 3, 4000, true);
            }
            None if word == "echo" => setup.echo = true,
            _ => return Err(bad(format!("'{word}' is none of speed=F, faults=SEED, echo"))),
        }
    }
    let bench = Arc::new(Bench {
        device: Mutex::new(Faulty::new(setup, script)),
        arrived: Condvar::new(),
        began: Instant::now(),
    });
    Ok(Port { reader: Box::new(SimReader(bench.clone())), writer: Box::new(SimWriter(bench)) })
}

impl io::Read for SimReader {
    fn read(&mut self, buf: &mut [u8]) -> io::Result<usize> {
        let bench = &self.0;
        let mut device = bench.lock();
        let until = Instant::now() + PATIENCE;
        loop {
            let now = bench.now();
            device.advance(now);
            let said = device.take(buf.len());
            if !said.is_empty() {
                buf[..said.len()].copy_from_slice(&said);
                return Ok(said.len());
            }
            if device.hung_up {
                return Err(io::ErrorKind::BrokenPipe.into());
            }
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Err(io::ErrorKind::TimedOut.into());
            }
            let due = device.next().map_or(left, |t| Duration::from_micros(t.saturating_sub(now)));
            let wait = left.min(due).max(Duration::from_micros(50));
            device =
                bench.arrived.wait_timeout(device, wait).unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

impl io::Write for SimWriter {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut device = self.0.lock();
        device.receive(bytes, self.0.now());
        if device.hung_up {
            return Err(io::ErrorKind::BrokenPipe.into());
        }
        self.0.arrived.notify_all();
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Read as _;

    #[test]
    fn what_cannot_be_opened_says_why() {
        let base = SimSetup::new(Dialect::GrblHal);
        let said = |name: &str| open(name, 115_200, &base).err().map(|e| e.to_string()).unwrap();
        assert!(said("/dev/no-such-port").contains("no such port"));
        assert!(said("/dev/null").contains("not a serial port"), "{}", said("/dev/null"));
        assert!(said("sim:lathe").contains("name a dialect"));
        assert!(said("sim:grbl,fast").contains("none of"));
        assert_eq!(dialect_of("sim:rrf,echo"), Some(Dialect::Rrf));
    }

    #[test]
    fn a_simulated_port_greets() {
        let mut port = open("sim:grblhal", 0, &SimSetup::new(Dialect::GrblHal)).unwrap();
        let mut text = [0; 64];
        let n = port.reader.read(&mut text).unwrap();
        assert!(String::from_utf8_lossy(&text[..n]).contains("GrblHAL"));
        assert_eq!(port.reader.read(&mut text).unwrap_err().kind(), io::ErrorKind::TimedOut);
    }
}
