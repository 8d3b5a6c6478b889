//! How controls differ in the programs they take. A new control is a new value of [`Dialect`].
//!
//! The extruder's codes come from the machine's profile. LinuxCNC takes M70 to M73 itself (saving
//! and restoring modal state), so there they are written as user-defined codes a hundred higher,
//! M170 to M175, each a script of that name. RepRapFirmware has an E axis instead.

use crate::machine::{Control, Extruder, ExtruderPort};

/// A remark's delimiters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Comments {
    Parentheses,
    Semicolon,
}

/// How a wait of some seconds is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Dwell {
    /// `G4 P` in seconds.
    Seconds,
    /// `G4 P` in whole milliseconds.
    Milliseconds,
}

/// How the bead is switched.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extrusion {
    /// By the profile's M codes.
    Codes,
    /// The same, those that collide with the control's own a hundred higher.
    UserCodes,
    /// By an E axis in relative mode; the module opens and closes by an output pin.
    Axis,
}

/// How a control wants its programs written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dialect {
    pub name: &'static str,
    /// First and last line of the file, where the control wants them.
    pub marks: Option<(&'static str, &'static str)>,
    /// Lines after the header; the work offset follows them.
    pub preamble: &'static [&'static str],
    /// G codes that must have been said before anything moves, besides the work offset.
    pub needed: &'static [u32],
    /// Digits after the point of linear words: 0.001 mm is finer than these machines move.
    pub linear_digits: usize,
    /// Digits of rotary words: 0.0001° is 0.35 µm at 200 mm.
    pub rotary_digits: usize,
    /// Longest line the control takes, bytes.
    pub longest_line: usize,
    pub comments: Comments,
    pub dwell: Dwell,
    /// Whether every block has a number.
    pub numbered: bool,
    /// Whether a motion code holds until the next one; else it is written in every block.
    pub modal: bool,
    /// `T M6` and `G43 H`; else `T` alone changes the tool and applies its length.
    pub m6: bool,
    pub extrusion: Extrusion,
    /// Whether runs of short moves may be written as arcs (`G2`, `G3` with I and J).
    pub arcs: bool,
    /// Waits for a person.
    pub pause: u32,
    pub end: u32,
}

/// Plain RS-274 with tool length compensation (G43) and moves in machine coordinates (G53).
pub const RS274: Dialect = Dialect {
    name: "rs274",
    marks: None,
    preamble: &["G21", "G90", "G94", "G17"],
    needed: &[17, 21, 90, 94],
    linear_digits: 3,
    rotary_digits: 4,
    longest_line: 256,
    comments: Comments::Parentheses,
    dwell: Dwell::Seconds,
    numbered: false,
    modal: true,
    m6: true,
    extrusion: Extrusion::Codes,
    arcs: false,
    pause: 0,
    end: 30,
};

/// LinuxCNC: exact path with a small blending tolerance, user-defined codes for the extruder.
const LINUXCNC: Dialect = Dialect {
    name: "linuxcnc",
    preamble: &["G21", "G90", "G94", "G17", "G40", "G49", "G64 P0.01"],
    longest_line: 255,
    extrusion: Extrusion::UserCodes,
    ..RS274
};

/// RepRapFirmware 3: an E axis in relative mode; M30 would delete a file there, so M0 ends.
const RRF: Dialect = Dialect {
    name: "rrf",
    preamble: &["G21", "G90", "M83"],
    needed: &[21, 90],
    comments: Comments::Semicolon,
    dwell: Dwell::Milliseconds,
    modal: false,
    m6: false,
    extrusion: Extrusion::Axis,
    pause: 226,
    end: 0,
    ..RS274
};

/// Fanuc and those who follow it: a program number between percent signs, numbered blocks.
const FANUC: Dialect = Dialect {
    name: "fanuc",
    marks: Some(("%\nO0001", "%")),
    preamble: &["G21", "G90", "G94", "G17", "G40", "G49", "G80"],
    dwell: Dwell::Milliseconds,
    numbered: true,
    ..RS274
};

/// Names under which machine profiles ask for a dialect.
const NAMES: [(&str, Dialect); 6] = [
    ("rs274", RS274),
    ("linuxcnc", LINUXCNC),
    ("grblhal", Dialect { name: "grblhal", ..RS274 }),
    ("rrf", RRF),
    ("fanuc", FANUC),
    ("mx220", Dialect { name: "mx220", ..RS274 }),
];

/// The six codes of the extruder module as numbers of M words.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ModuleCodes {
    pub open: u32,
    pub close: u32,
    pub on: u32,
    pub off: u32,
    pub draw: u32,
    pub give: u32,
}

impl Dialect {
    pub fn named(name: &str) -> Option<Dialect> {
        NAMES.iter().find(|(n, _)| *n == name).map(|(_, d)| *d)
    }

    /// The names [`Dialect::named`] knows.
    pub fn names() -> impl Iterator<Item = &'static str> {
        NAMES.iter().map(|(n, _)| *n)
    }

    /// The dialect a control's profile names, with what the profile changes of it.
    pub fn of(control: &Control) -> Option<Dialect> {
        let mut d = Dialect::named(&control.dialect)?;
        let post = &control.post;
        d.numbered = post.line_numbers.unwrap_or(d.numbered);
        d.arcs = post.arcs;
        d.linear_digits = post.linear_digits.map_or(d.linear_digits, |n| n as usize);
        d.rotary_digits = post.rotary_digits.map_or(d.rotary_digits, |n| n as usize);
        Some(d)
    }

    /// The M codes that drive the module; none when a profile's code is not one.
    pub(super) fn module_codes(&self, e: &Extruder) -> Option<ModuleCodes> {
        // A board on a port of its own never meets the control's meaning of a code.
        let shift = self.extrusion == Extrusion::UserCodes && e.port == ExtruderPort::Same;
        let code = |text: &str| {
            let m = text.strip_prefix('M')?.parse::<u32>().ok()?;
            Some(if shift && (70..=75).contains(&m) { m + 100 } else { m })
        };
        Some(ModuleCodes {
            open: code(&e.m_open)?,
            close: code(&e.m_close)?,
            on: code(&e.m_on)?,
            off: code(&e.m_off)?,
            draw: code(&e.m_retract_on)?,
            give: code(&e.m_retract_off)?,
        })
    }
}

/// A number with fixed decimals and without a negative zero.
pub(super) fn number(value: f64, digits: usize) -> String {
    if let Some(text) = plainly(value, digits) {
        return text;
    }
    let text = format!("{value:.digits$}");
    match text.strip_prefix('-') {
        Some(rest) if rest.bytes().all(|b| b == b'0' || b == b'.') => rest.to_string(),
        _ => text,
    }
}

/// The same by whole numbers, for all that a program has millions of; none where the last digit
/// hangs on what lies beyond the 53 bits of the product, or the number is larger than any length.
fn plainly(value: f64, digits: usize) -> Option<String> {
    const TENS: [u32; 7] = [1, 10, 100, 1000, 10_000, 100_000, 1_000_000];
    /// The product is off by less than 10⁻⁶ as long as it is smaller than this.
    const LARGEST: f64 = 4e9;
    let unit = *TENS.get(digits)?;
    let scaled = value.abs() * f64::from(unit);
    if scaled.is_nan() || scaled >= LARGEST {
        return None;
    }
    let whole = scaled as u64;
    let rest = scaled - whole as f64;
    if (rest - 0.5).abs() < 1e-5 {
        return None;
    }
    let whole = whole + u64::from(rest > 0.5);
    let mut text = [b'0'; 24];
    let (mut at, mut left, mut written) = (text.len(), whole, 0);
    while left > 0 || written <= digits {
        if written == digits && digits > 0 {
            at -= 1;
            text[at] = b'.';
        }
        at -= 1;
        text[at] = b'0' + (left % 10) as u8;
        left /= 10;
        written += 1;
    }
    if value < 0.0 && whole > 0 {
        at -= 1;
        text[at] = b'-';
    }
    std::str::from_utf8(&text[at..]).ok().map(str::to_string)
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

    #[test]
    fn whole_numbers_write_what_the_formatter_does() {
        let mut rng = crate::base::rng(23, 0);
        let mut values = vec![0.0005, 0.0015, 2.5, 0.5, 1e-9, -1e-9, 0.9996, 999.9995, 1e12, 0.1];
        for far in [1e-3, 1.0, 50.0, 4e3, 1e7] {
            values.extend((0..2000).map(|_| rand::RngExt::random_range(&mut rng, -far..far)));
        }
        // Ties, and what three decimals round to.
        values.extend((0..4000).map(|k| f64::from(k) / 16.0));
        values.extend((0..4000).map(|k| f64::from(k) * 0.0005));
        for (v, digits) in values.iter().flat_map(|v| (0..=7).map(move |d| (*v, d))) {
            let mut want = format!("{v:.digits$}");
            if want.trim_start_matches('-').bytes().all(|b| b == b'0' || b == b'.') {
                want = want.trim_start_matches('-').to_string();
            }
            assert_eq!(number(v, digits), want, "{v:e} with {digits}");
        }
        assert!(plainly(-12.25, 3).is_some() && plainly(f64::NAN, 3).is_none());
    }

    #[test]
    fn codes_that_collide_move_up_by_a_hundred_on_the_same_port_only() {
        let linuxcnc = Dialect::named("linuxcnc").unwrap();
        let mut e = Extruder::default();
        assert_eq!(linuxcnc.module_codes(&e).unwrap().on, 172);
        assert_eq!(RS274.module_codes(&e).unwrap().on, 72);
        e.m_on = "M112".into();
        assert_eq!(linuxcnc.module_codes(&e).unwrap().on, 112);
        e.port = ExtruderPort::Second;
        assert_eq!(linuxcnc.module_codes(&e).unwrap().open, 70);
        e.m_on = "72".into();
        assert_eq!(linuxcnc.module_codes(&e), None);
    }
}
