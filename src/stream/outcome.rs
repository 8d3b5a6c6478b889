//! How a job ended, and what a person should do next.

use super::core::{Checks, Device};

/// Why a job ended.
#[derive(Clone, Debug, PartialEq)]
pub enum Ending {
    /// Every line answered, every motion over, the machine at rest.
    Done,
    /// The person stopped it.
    Stopped,
    /// A device refused a line.
    Refused {
        device: Device,
        number: u32,
        line: String,
        code: String,
    },
    Alarm {
        device: Device,
        what: String,
    },
    /// A device began anew in mid-job.
    Reset {
        device: Device,
        banner: String,
    },
    /// Nothing was heard in time.
    Silent {
        device: Device,
        seconds: f64,
    },
    /// The machine rests, but lines were never answered.
    Unanswered {
        device: Device,
    },
    HungUp {
        device: Device,
    },
    /// What arrived cannot be what was sent.
    Garbled {
        device: Device,
        what: String,
    },
    /// A numbered line could not be brought across.
    GaveUp {
        device: Device,
        number: u32,
    },
    /// Before the first line: not in a state to begin.
    NotReady {
        device: Device,
        what: String,
    },
    /// The firmware has halted.
    Halted {
        device: Device,
        what: String,
    },
    /// The machine rests elsewhere than where the program ends.
    Astray {
        what: String,
    },
    /// The controller does what the program does not say, somewhere between two lines of the file.
    Departed {
        lines: [u32; 2],
        what: String,
    },
    /// Before the first line: a verified run was asked for, and the device cannot give one.
    Unverifiable {
        device: Device,
    },
}

/// What vouches that a device read what was written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Means {
    /// A number and a checksum a line.
    Checksum,
    /// The device repeats what it reads, and is held to every byte.
    Repeated,
    /// Nothing: one valid line in place of another would have been run.
    Unproven,
}

/// How far it is known that what was read is what was written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Delivery {
    pub control: Means,
    /// Of the extruder's own board, if any of its codes are in the program.
    pub extruder: Option<Means>,
    /// What an unproven controller was held to.
    pub checks: Checks,
}

impl Means {
    pub fn word(self) -> &'static str {
        match self {
            Means::Checksum => "checksum",
            Means::Repeated => "repeated",
            Means::Unproven => "unproven",
        }
    }
}

impl Delivery {
    /// Whether every byte was vouched for on every device.
    pub fn is_verified(&self) -> bool {
        self.control != Means::Unproven && self.extruder != Some(Means::Unproven)
    }

    /// What is known, in words.
    pub fn in_words(&self) -> String {
        let unproven: Vec<&str> = [
            (self.control == Means::Unproven).then_some("controller"),
            (self.extruder == Some(Means::Unproven)).then_some("extruder"),
        ]
        .into_iter()
        .flatten()
        .collect();
        if unproven.is_empty() {
            return "verified: every line arrived as it was written".into();
        }
        let Checks { places, rests, states } = self.checks;
        let devices = unproven.join(" and ");
        let held = match self.control {
            Means::Unproven => format!(
                "; checked instead: {places} positions on the path, {rests} at rest, {states} parser \
                 states"
            ),
            _ => String::new(),
        };
        format!(
            "NOT VERIFIED: the {devices} has neither checksum nor echo, so that a damaged line that \
             is still valid may have run{held}; for a verified run use a firmware that repeats what it \
             reads, or one with line numbers and checksums (--verified refuses any other)"
        )
    }
}

/// Where the machine stands at the end.
#[derive(Clone, Debug, PartialEq)]
pub enum Position {
    /// Machine and work coordinates, mm and degrees, as far as reported, at rest.
    Known {
        machine: Option<Vec<f64>>,
        work: Option<Vec<f64>>,
    },
    Unknown,
}

/// Everything that is known of a job that is over.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    pub ending: Ending,
    /// Lines answered, of `total`.
    pub confirmed: usize,
    /// Lines whose motion is known to be over.
    pub settled: usize,
    pub total: usize,
    /// Line of the file last answered; 0 for none.
    pub last_confirmed: u32,
    /// First and last line of the file that were written and not answered when it ended.
    pub in_flight: Option<[u32; 2]>,
    pub position: Position,
    /// Codes meant to switch something off that no device confirmed.
    pub not_off: Vec<String>,
    pub delivery: Delivery,
}

impl Ending {
    /// The process's exit code.
    pub fn exit_code(&self) -> u8 {
        match self {
            Ending::Done => 0,
            Ending::Unverifiable { .. } => 1,
            Ending::Stopped => 130,
            _ => 3,
        }
    }

    /// One word for programs that read it.
    pub fn word(&self) -> &'static str {
        match self {
            Ending::Done => "done",
            Ending::Stopped => "stopped",
            Ending::Refused { .. } => "refused",
            Ending::Alarm { .. } => "alarm",
            Ending::Reset { .. } => "reset",
            Ending::Silent { .. } => "silent",
            Ending::Unanswered { .. } => "unanswered",
            Ending::HungUp { .. } => "hung-up",
            Ending::Garbled { .. } => "garbled",
            Ending::GaveUp { .. } => "gave-up",
            Ending::NotReady { .. } => "not-ready",
            Ending::Halted { .. } => "halted",
            Ending::Astray { .. } => "astray",
            Ending::Departed { .. } => "departed",
            Ending::Unverifiable { .. } => "unverifiable",
        }
    }

    /// The device at fault.
    pub fn device(&self) -> Option<Device> {
        match self {
            Ending::Done | Ending::Stopped => None,
            Ending::Astray { .. } | Ending::Departed { .. } => Some(Device::Control),
            Ending::Refused { device, .. }
            | Ending::Alarm { device, .. }
            | Ending::Reset { device, .. }
            | Ending::Silent { device, .. }
            | Ending::Unanswered { device }
            | Ending::HungUp { device }
            | Ending::Garbled { device, .. }
            | Ending::GaveUp { device, .. }
            | Ending::NotReady { device, .. }
            | Ending::Unverifiable { device }
            | Ending::Halted { device, .. } => Some(*device),
        }
    }
}

impl std::fmt::Display for Ending {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Ending::Done => f.write_str("done"),
            Ending::Stopped => f.write_str("stopped by the person"),
            Ending::Refused { device, number, line, code } => match number {
                0 => write!(f, "the {device} refused '{line}': {code}"),
                n => write!(f, "the {device} refused line {n}, '{line}': {code}"),
            },
            Ending::Alarm { device, what } => write!(f, "alarm of the {device}: {what}"),
            Ending::Reset { device, banner } => {
                write!(f, "the {device} began anew in mid-job ('{banner}')")
            }
            Ending::Silent { device, seconds } => {
                write!(f, "nothing was heard of the {device} for {seconds:.1} s")
            }
            Ending::Unanswered { device } => write!(
                f,
                "the {device} rests, but lines were never answered: acknowledgements were lost"
            ),
            Ending::HungUp { device } => write!(f, "the {device} hung up"),
            Ending::Garbled { device, what } => {
                write!(f, "the line to the {device} is not reliable: {what}")
            }
            Ending::GaveUp { device, number } => {
                write!(f, "the {device} did not take line {number} in ten attempts")
            }
            Ending::NotReady { device, what } => write!(f, "the {device} is not ready: {what}"),
            Ending::Halted { device, what } => write!(f, "the {device} halted: {what}"),
            Ending::Astray { what } => {
                write!(f, "the machine is not where the program ends: {what}")
            }
            Ending::Departed { lines: [a, b], what } => write!(
                f,
                "the controller does not do what lines {a} to {b} of the program say: {what}"
            ),
            Ending::Unverifiable { device } => write!(
                f,
                "a verified run is not possible: the {device} has neither checksum nor echo; nothing \
                 was sent"
            ),
        }
    }
}

impl Outcome {
    /// The next safe action, in words.
    pub fn next_action(&self) -> String {
        let known = matches!(self.position, Position::Known { .. });
        let resume = if known {
            "look at the part, then continue with --resume"
        } else {
            "the position is not known: home the machine, then continue with --resume \
             --position-known"
        };
        match &self.ending {
            Ending::Done if self.delivery.is_verified() => "take the part".into(),
            Ending::Done => "measure the part, since its program's delivery is not verified".into(),
            Ending::NotReady { .. } => "mend what it says and start again; nothing was sent".into(),
            Ending::Stopped => resume.into(),
            Ending::Refused { number, .. } => format!(
                "lines already in the controller may have run after line {number}; mend the \
                 program and check the part before running any of it again"
            ),
            Ending::Alarm { .. } => format!("clear the cause, home or unlock by hand; {resume}"),
            Ending::Reset { .. } => {
                format!("find out why it reset (power, emergency stop); {resume}")
            }
            Ending::Halted { .. } => format!("reset the controller by hand; {resume}"),
            Ending::Garbled { .. } | Ending::GaveUp { .. } | Ending::Unanswered { .. } => {
                format!("mend the cable or its shielding; {resume}")
            }
            Ending::Silent { .. } | Ending::HungUp { .. } => format!(
                "make sure that spindle and extruder are off, since nothing could be sent; {resume}"
            ),
            Ending::Unverifiable { .. } => {
                "leave --verified out, or use a firmware that repeats what it reads".into()
            }
            Ending::Departed { .. } => format!(
                "a line was damaged on its way, or the controller was told otherwise by someone else; \
                 look at the part; {resume}"
            ),
            Ending::Astray { .. } => {
                "the part may be wrong: a line was damaged on its way, or a setting differs from \
                 the program's; measure it"
                    .into()
            }
        }
    }
}
