//! What controllers differ in when they are fed: buffers, line lengths, how lines are numbered,
//! how motion is waited for, and what their error and alarm numbers mean.

use super::codes;

/// A controller's way of talking.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Dialect {
    Grbl,
    GrblHal,
    Marlin,
    Rrf,
    /// A board that takes one line and answers it, such as an Arduino with an extruder.
    Plain,
}

impl Dialect {
    pub const ALL: [Dialect; 5] =
        [Dialect::Grbl, Dialect::GrblHal, Dialect::Marlin, Dialect::Rrf, Dialect::Plain];

    pub fn name(self) -> &'static str {
        match self {
            Dialect::Grbl => "grbl",
            Dialect::GrblHal => "grblhal",
            Dialect::Marlin => "marlin",
            Dialect::Rrf => "rrf",
            Dialect::Plain => "plain",
        }
    }

    pub fn named(name: &str) -> Option<Dialect> {
        Dialect::ALL.into_iter().find(|d| d.name() == name)
    }

    /// grbl and its heirs: realtime bytes, status reports, a window counted in bytes.
    pub fn is_grbl(self) -> bool {
        matches!(self, Dialect::Grbl | Dialect::GrblHal)
    }

    /// Lines carry a number and a checksum, and bad ones are asked for again.
    pub fn is_numbered(self) -> bool {
        matches!(self, Dialect::Marlin | Dialect::Rrf)
    }

    /// Longest line, bytes as written, without the line end.
    pub fn longest_line(self) -> usize {
        match self {
            // grbl's buffer of 80 holds the terminating zero too.
            Dialect::Grbl => 79,
            Dialect::GrblHal | Dialect::Rrf => 255,
            Dialect::Marlin => 95,
            Dialect::Plain => 60,
        }
    }

    /// Bytes the receive buffer takes before more are lost without a word.
    pub fn receive_bytes(self) -> usize {
        match self {
            Dialect::Grbl => 128,
            Dialect::GrblHal => 1023,
            Dialect::Marlin | Dialect::Rrf => 128,
            Dialect::Plain => 64,
        }
    }

    /// Most lines written and not yet answered, besides the window in bytes.
    pub fn lines_ahead(self) -> usize {
        match self {
            Dialect::Grbl | Dialect::GrblHal => usize::MAX,
            Dialect::Marlin | Dialect::Rrf => 4,
            Dialect::Plain => 1,
        }
    }

    /// Motions that may be answered with `ok` and still lie ahead.
    pub fn planner_blocks(self) -> usize {
        match self {
            Dialect::Grbl => 16,
            Dialect::GrblHal => 100,
            Dialect::Marlin => 16,
            // Its queue is 40 moves and a ring of look-ahead as long.
            Dialect::Rrf => 80,
            Dialect::Plain => 1,
        }
    }

    /// Lines after whose answers every earlier motion is over.
    pub fn drain(self) -> &'static [&'static str] {
        match self {
            Dialect::Grbl | Dialect::GrblHal => &["G4P0"],
            // The answer to M114 is more than an `ok`, which a repeated line may have left over.
            Dialect::Marlin | Dialect::Rrf => &["M400", "M114"],
            Dialect::Plain => &[],
        }
    }

    /// Lines that switch off spindle and coolant.
    pub fn outputs_off(self) -> &'static [&'static str] {
        match self {
            Dialect::Grbl | Dialect::GrblHal => &["M5", "M9"],
            Dialect::Marlin | Dialect::Rrf => &["M5", "M107"],
            Dialect::Plain => &[],
        }
    }

    /// What `error:N` means.
    pub fn error_meaning(self, code: u32) -> Option<&'static str> {
        match self {
            Dialect::Grbl => codes::find(codes::GRBL_ERRORS, code),
            Dialect::GrblHal => codes::find(codes::GRBLHAL_ERRORS, code)
                .or_else(|| codes::find(codes::GRBL_ERRORS, code)),
            _ => None,
        }
    }

    /// What `ALARM:N` means. The numbers of grbl and grblHAL differ from 10 on.
    pub fn alarm_meaning(self, code: u32) -> Option<&'static str> {
        match self {
            Dialect::Grbl => {
                codes::find(codes::ALARMS, code).or_else(|| codes::find(codes::GRBL_ALARMS, code))
            }
            Dialect::GrblHal => codes::find(codes::ALARMS, code)
                .or_else(|| codes::find(codes::GRBLHAL_ALARMS, code)),
            _ => None,
        }
    }
}

impl std::fmt::Display for Dialect {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_come_back() {
        for d in Dialect::ALL {
            assert_eq!(Dialect::named(d.name()), Some(d));
        }
        assert_eq!(Dialect::named("linuxcnc"), None);
    }

    #[test]
    fn alarm_ten_is_the_dialects_own() {
        let grbl = Dialect::Grbl.alarm_meaning(10).unwrap();
        let hal = Dialect::GrblHal.alarm_meaning(10).unwrap();
        assert!(grbl.contains("dual-axis") && hal.contains("emergency stop"));
        assert_eq!(Dialect::Marlin.alarm_meaning(1), None);
        assert_eq!(Dialect::Grbl.error_meaning(20), Dialect::GrblHal.error_meaning(20));
    }
}
