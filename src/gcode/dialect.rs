/// How a control wants its programs written. A new control is a new value of this struct.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dialect {
    pub name: &'static str,
    /// First lines after the header: units, distance, feed mode, plane, work offset.
    pub preamble: &'static [&'static str],
    /// Digits after the point of linear words: 0.001 mm is finer than these machines move.
    pub linear_digits: usize,
    /// Digits of rotary words: 0.0001° is 0.35 µm at 200 mm.
    pub rotary_digits: usize,
    /// Longest line the control takes, bytes.
    pub longest_line: usize,
}

/// Plain RS-274 with tool length compensation (G43) and moves in machine coordinates (G53).
/// Extruder codes come from the machine's profile: LinuxCNC itself and grblHAL take M70 to M73
/// for modal state, so there they must be other codes or go to a second port.
pub const RS274: Dialect = Dialect {
    name: "rs274",
    preamble: &["G21", "G90", "G94", "G17", "G54"],
    linear_digits: 3,
    rotary_digits: 4,
    longest_line: 256,
};

/// Names under which machine profiles ask for a dialect.
const NAMES: [(&str, Dialect); 4] = [
    ("rs274", RS274),
    ("linuxcnc", Dialect { name: "linuxcnc", ..RS274 }),
    ("grblhal", Dialect { name: "grblhal", ..RS274 }),
    ("mx220", Dialect { name: "mx220", ..RS274 }),
];

impl Dialect {
    pub fn named(name: &str) -> Option<Dialect> {
        NAMES.iter().find(|(n, _)| *n == name).map(|(_, d)| *d)
    }

    /// The names [`Dialect::named`] knows.
    pub fn names() -> impl Iterator<Item = &'static str> {
        NAMES.iter().map(|(n, _)| *n)
    }
}

/// A number with fixed decimals and without a negative zero.
pub(super) fn number(value: f64, digits: usize) -> String {
    let text = format!("{value:.digits$}");
    match text.strip_prefix('-') {
        Some(rest) if rest.bytes().all(|b| b == b'0' || b == b'.') => rest.to_string(),
        _ => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zero_has_no_sign_and_decimals_are_fixed() {
        assert_eq!(number(-0.0001, 3), "0.000");
        assert_eq!(number(-0.0, 3), "0.000");
        assert_eq!(number(-1.5, 3), "-1.500");
        assert_eq!(number(12.34567, 4), "12.3457");
    }
}
