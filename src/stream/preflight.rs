//! Everything that can be said of a program before its first byte is written.
//!
//! Comments go first, with whatever they hold; what is left must be printable ASCII, since
//! controllers act on single bytes even inside a block. Then every block must be one the dialect
//! knows, short enough as it is written, and within the machine's travel as far as it can be told
//! without knowing the work offset: rotary angles and G53 moves exactly, others by their span.

use super::core::EndPoint;
use super::modal::{AXES, Modal, Rates, tenths};
use super::script::{Class, ModuleCode, Script};
use super::{Cleared, Dialect, codes};
use crate::gcode::{Word, read_block};
use crate::machine::{ExtruderPort, Machine};

/// Faults that are told; the rest of a broken file would bury them.
const MOST_FAULTS: usize = 5;

/// How far beyond the travel counts as within, mm or degrees: the last digit programs are written
/// with.
const TRAVEL_SLACK: f64 = 0.001;

/// Longest dwell, s. A longer one is a typing error: some controls count milliseconds.
const LONGEST_DWELL_S: f64 = 600.0;

/// Room that the number and the checksum of a numbered line take: `N1234567 ` and `*255`.
const NUMBERING: usize = 13;

/// Why a program is not sent.
#[derive(Clone, Debug, PartialEq)]
pub struct Fault {
    /// Line of the file, from 1; 0 when it is of the whole file.
    pub number: u32,
    pub what: String,
}

impl std::fmt::Display for Fault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.number {
            0 => f.write_str(&self.what),
            n => write!(f, "line {n}: {}", self.what),
        }
    }
}

/// Who will read the lines.
#[derive(Clone, Copy, Debug)]
pub struct Setting<'a> {
    pub machine: &'a Machine,
    pub control: Dialect,
    /// Dialect of the extruder's own device, where it has one.
    pub extruder: Option<Dialect>,
}

/// A program that may be sent, and what should be known of it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Preflight {
    pub script: Script,
    pub warnings: Vec<String>,
    /// Where the program ends, as far as it can be told.
    pub end: Vec<EndPoint>,
}

/// Looks at a whole program.
///
/// # Errors
/// The first faults, in the order of the lines.
pub fn preflight(program: &Cleared, setting: &Setting) -> Result<Preflight, Vec<Fault>> {
    look_at(program.text(), setting)
}

/// As [`preflight`], for lines of the sender's own too.
pub(super) fn look_at(text: &[u8], setting: &Setting) -> Result<Preflight, Vec<Fault>> {
    let mut run = Run {
        setting,
        rates: Rates::of(setting.machine),
        modal: Modal::default(),
        span: [None; 6],
        script: Script::default(),
        faults: Vec::new(),
        ended: None,
    };
    for (i, line) in text.split(|b| *b == b'\n').enumerate() {
        let number = u32::try_from(i + 1).unwrap_or(u32::MAX);
        if let Err(what) = run.line(number, line) {
            run.faults.push(Fault { number, what });
        }
        if run.faults.len() >= MOST_FAULTS {
            break;
        }
    }
    if run.script.is_empty() && run.faults.is_empty() {
        run.faults.push(Fault { number: 0, what: "there is nothing to send in it".into() });
    }
    if !run.faults.is_empty() {
        return Err(run.faults);
    }
    let warnings = warnings(&run.script, setting, run.ended);
    let end = end_points(&run.modal);
    Ok(Preflight { script: run.script, warnings, end })
}

fn warnings(script: &Script, setting: &Setting, ended: Option<u32>) -> Vec<String> {
    let mut out = Vec::new();
    if ended.is_none() {
        out.push(
            "the program does not end with M2 or M30; spindle and coolant stay as they are".into(),
        );
    }
    let modal_codes = setting.extruder.is_none()
        && setting.control == Dialect::GrblHal
        && setting.machine.extruder.as_ref().is_some_and(|e| {
            e.codes().iter().any(|(_, c)| matches!(*c, "M70" | "M71" | "M72" | "M73"))
        });
    if modal_codes && script.extrudes() {
        out.push(
            "grblHAL built with expressions takes M70 to M73 as saving and restoring its modal \
             state and answers ok: an ok does not prove that an extruder listens"
                .into(),
        );
    }
    out
}

/// Linear coordinates at the end that a controller's report can be held against. A work coordinate
/// system other than the first, or an offset the program sets, is undone by M30 on some controls.
fn end_points(modal: &Modal) -> Vec<EndPoint> {
    let plain = modal.system == 54 && !modal.shifted;
    let of = |axis: usize| {
        let letter = AXES[axis];
        let machine = modal.machine[axis].map(|at| EndPoint { axis, letter, at, machine: true });
        let lifted = axis == 2 && modal.length.is_some();
        let work = modal.work[axis].filter(|_| plain && !lifted);
        machine.or(work.map(|at| EndPoint { axis, letter, at, machine: false }))
    };
    (0..3).filter_map(of).collect()
}

struct Run<'a> {
    setting: &'a Setting<'a>,
    rates: Rates,
    modal: Modal,
    /// Least and greatest programmed coordinate of each axis.
    span: [Option<[f64; 2]>; 6],
    script: Script,
    faults: Vec<Fault>,
    ended: Option<u32>,
}

impl Run<'_> {
    fn line(&mut self, number: u32, raw: &[u8]) -> Result<(), String> {
        let Some(text) = bare(raw)? else { return Ok(()) };
        if text == "%" {
            return Ok(());
        }
        if let Some(end) = self.ended {
            return Err(format!("a block after the end of the program in line {end}"));
        }
        let dialect = self.setting.control;
        if text.starts_with('$') {
            self.fits(&text, dialect)?;
            return self.setting_line(number, &text);
        }
        let words = read_block(&text).map_err(|e| e.to_string())?;
        if words.is_empty() {
            return Ok(());
        }
        let class = self.class(&words)?;
        let device = match (class, self.setting.extruder) {
            (Class::Extruder(_), Some(own)) => own,
            _ => dialect,
        };
        self.fits(&text, device)?;
        if !matches!(class, Class::Extruder(_)) {
            known(dialect, &words)?;
        }
        if words.iter().any(|w| w.letter == 'G' && w.value == 4.0) {
            let p = words.iter().find(|w| w.letter == 'P').map_or(0.0, |w| w.value);
            if !(0.0..=LONGEST_DWELL_S).contains(&p) {
                return Err(format!("a dwell of {p} s; at most {LONGEST_DWELL_S} s are taken"));
            }
        }
        let effect = self.modal.apply(&words, &self.rates);
        if let Class::Extruder(code) = class {
            self.modal.module.run(code);
        }
        self.travel(&words)?;
        self.script.push(number, &text, class, effect.moves, [effect.seconds, effect.dwell_s]);
        if class == Class::End {
            self.ended = Some(number);
        }
        Ok(())
    }

    /// The length the device will see.
    fn fits(&self, text: &str, dialect: Dialect) -> Result<(), String> {
        let extra = if dialect.is_numbered() { NUMBERING } else { 0 };
        let longest = dialect.longest_line();
        if text.len() + extra > longest {
            let of = if extra > 0 { " with its number and checksum" } else { "" };
            return Err(format!(
                "{} bytes{of}, {dialect} takes {longest}; split the block",
                text.len() + extra
            ));
        }
        Ok(())
    }

    fn setting_line(&mut self, number: u32, text: &str) -> Result<(), String> {
        let known = self.setting.control.is_grbl() && is_setting(text);
        if !known {
            return Err(format!(
                "'{text}': of $ commands a program may hold only settings ($N=V) and homing ($H)"
            ));
        }
        self.script.push(number, text, Class::Store, text == "$H", [0.0, 0.0]);
        Ok(())
    }

    fn class(&self, words: &[Word]) -> Result<Class, String> {
        let mut class = Class::Ordinary;
        for w in words {
            let Some(code) = tenths(w.value) else { continue };
            let found = match (w.letter, code) {
                ('M', _) if self.module_code(code).is_some() => {
                    if words.iter().any(|o| !matches!(o.letter, 'M' | 'N')) || words.len() > 2 {
                        return Err(format!("M{} must stand alone in its block", code / 10));
                    }
                    if self.setting.extruder.is_none() {
                        self.same_port()?;
                    }
                    self.module_code(code).map_or(Class::Ordinary, Class::Extruder)
                }
                ('G', 281 | 301) => Class::Store,
                ('G', 100) => Class::Store,
                ('M', 0 | 10 | 600) => Class::Pause,
                ('M', 60) => Class::ToolChange,
                ('M', 20 | 300) => Class::End,
                _ => continue,
            };
            if class != Class::Ordinary && class != found {
                return Err("two codes in one block that must be waited for; split it".into());
            }
            class = found;
        }
        Ok(class)
    }

    /// What an M code in tenths does to the extruder, by the profile.
    fn module_code(&self, code: u32) -> Option<ModuleCode> {
        use ModuleCode::{Close, Draw, Give, Off, On, Open};
        let extruder = self.setting.machine.extruder.as_ref()?;
        let is = |(_, text): &(&str, &str)| {
            text.strip_prefix('M').and_then(|d| d.parse::<u32>().ok()).map(|d| d * 10) == Some(code)
        };
        let at = extruder.codes().iter().position(is)?;
        [Open, Close, On, Off, Draw, Give].get(at).copied()
    }

    /// Whether the control itself may take the extruder's codes.
    fn same_port(&self) -> Result<(), String> {
        let machine = self.setting.machine;
        let second = machine.extruder.as_ref().is_some_and(|e| e.port == ExtruderPort::Second);
        if second {
            return Err(format!(
                "machine '{}' has its extruder on a second port; name it with --extruder-port",
                machine.name
            ));
        }
        if self.setting.control == Dialect::Grbl {
            return Err(format!(
                "grbl knows no extruder codes; machine '{}' must say port = \"second\" and the \
                 extruder needs its own board",
                machine.name
            ));
        }
        Ok(())
    }

    fn travel(&mut self, words: &[Word]) -> Result<(), String> {
        let chain = &self.setting.machine.kinematics;
        let in_machine = words.iter().any(|w| w.letter == 'G' && w.value == 53.0);
        for (i, letter) in AXES.iter().enumerate() {
            if !words.iter().any(|w| w.letter == *letter) {
                continue;
            }
            let place = if in_machine { self.modal.machine[i] } else { self.modal.work[i] };
            let Some(at) = place else { continue };
            let limits = match letter {
                'X' => Some(chain.x.limits_mm),
                'Y' => Some(chain.y.limits_mm),
                'Z' => Some(chain.z.limits_mm),
                l => {
                    let own = [chain.first, chain.second].into_iter().find(|r| r.letter == *l);
                    let Some(rotary) = own else {
                        return Err(format!("the machine has no axis {letter}"));
                    };
                    if !rotary.allows(at) {
                        return Err(format!("{letter}{at} is beyond the axis's limits"));
                    }
                    None
                }
            };
            let Some([low, high]) = limits else { continue };
            if in_machine {
                if at < low - TRAVEL_SLACK || at > high + TRAVEL_SLACK {
                    return Err(format!("{letter}{at} is not within {low} and {high} mm"));
                }
                continue;
            }
            let [a, b] = self.span[i].map_or([at, at], |[a, b]| [a.min(at), b.max(at)]);
            self.span[i] = Some([a, b]);
            if b - a > high - low + TRAVEL_SLACK {
                return Err(format!(
                    "with {letter}{at} the program spans {:.3} mm, the axis travels {:.3}",
                    b - a,
                    high - low
                ));
            }
        }
        Ok(())
    }
}

fn is_setting(text: &str) -> bool {
    let Some((name, value)) = text[1..].split_once('=') else { return text == "$H" };
    let digits = |s: &str| !s.is_empty() && s.bytes().all(|b| b.is_ascii_digit());
    digits(name) && value.parse::<f64>().is_ok_and(f64::is_finite)
}

/// A line without comments and spaces around; None when nothing is left.
///
/// # Errors
/// A byte that controllers would act on or cannot read, or a comment that is not closed.
fn bare(raw: &[u8]) -> Result<Option<String>, String> {
    let (mut out, mut open) = (String::new(), false);
    for b in raw {
        match (b, open) {
            (b';', false) => break,
            (b'(', false) => open = true,
            (b'(', true) | (b')', false) => {
                return Err("a comment is not closed or opens another".into());
            }
            (b')', true) => open = false,
            (_, true) | (b'\r', false) => {}
            (b'\t', false) => out.push(' '),
            (0x20..0x7F, false) => out.push(char::from(*b)),
            (b, false) => {
                return Err(format!(
                    "byte 0x{b:02X} outside a comment; controllers act on such bytes at once"
                ));
            }
        }
    }
    if open {
        return Err("a comment is not closed or opens another".into());
    }
    let text = out.trim();
    if let Some(c) = text.chars().find(|c| matches!(c, '?' | '!' | '~')) {
        return Err(format!("'{c}' is a realtime command and cannot stand in a block"));
    }
    Ok((!text.is_empty()).then(|| text.to_string()))
}

/// Refuses codes the dialect does not have.
fn known(dialect: Dialect, words: &[Word]) -> Result<(), String> {
    let codes = words.iter().filter(|w| matches!(w.letter, 'G' | 'M')).count();
    let begins = words.iter().find(|w| w.letter != 'N').map_or(' ', |w| w.letter);
    if dialect == Dialect::Marlin && (codes > 1 || !matches!(begins, 'G' | 'M' | 'T')) {
        return Err("marlin takes one code a block, in front: G, M or T".into());
    }
    for w in words.iter().filter(|w| matches!(w.letter, 'G' | 'M')) {
        let code = tenths(w.value);
        let listed = code.is_some_and(|c| match w.letter {
            'G' => codes::knows_g(dialect, c),
            _ => codes::knows_m(dialect, c),
        });
        if !listed {
            return Err(format!("{dialect} does not know {}{}", w.letter, w.value));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn with(text: &[u8], control: Dialect, extruder: Option<Dialect>) -> Result<Preflight, String> {
        let machine = Machine::builtin("generic-5axis").unwrap();
        let setting = Setting { machine: &machine, control, extruder };
        look_at(text, &setting).map_err(|f| f[0].to_string())
    }

    fn hal(text: &str) -> Result<Preflight, String> {
        with(text.as_bytes(), Dialect::GrblHal, Some(Dialect::Plain))
    }

    #[test]
    fn comments_go_and_lines_keep_their_numbers() {
        let p = hal("%\r\n(what? ok! Ą)\r\n\r\nG1 X1 F100 ; go\r\nM72\r\nM30\r\n").unwrap();
        let s = &p.script;
        assert_eq!((s.len(), s.text(0), s.number(0)), (3, "G1 X1 F100", 4));
        assert_eq!(s.line(1).unwrap().class, Class::Extruder(ModuleCode::On));
        assert_eq!(p.warnings, [""; 0]);
    }

    #[test]
    fn what_must_not_be_sent_is_refused() {
        for (text, words) in [
            ("G1 X\u{104}", "0xC4"),
            ("G1 X1?", "realtime"),
            ("G1 X1 (open", "comment"),
            ("G99.9", "does not know G99.9"),
            ("M98", "does not know M98"),
            ("G1 X1\nM30\nG0 X1", "line 3: a block after the end"),
            ("$X", "settings"),
            ("G0 A200", "limits"),
            ("G53 G0 Z900", "within"),
            ("G0 X-500\nG0 X500", "spans"),
            ("M72 G4", "alone"),
            ("M72 M73", "split"),
            ("G4 P9000", "dwell"),
            ("M0 M6", "split"),
            ("(nothing)", "nothing to send"),
        ] {
            let said = hal(text).unwrap_err();
            assert!(said.contains(words), "{text}: {said}");
        }
        let long = format!("G1 X1{} Y1", " ".repeat(80));
        assert!(with(long.as_bytes(), Dialect::Grbl, None).unwrap_err().contains("grbl takes 79"));
        assert!(with(b"G43 H1", Dialect::Grbl, None).unwrap_err().contains("G43"));
    }

    #[test]
    fn extruder_codes_need_a_device_that_takes_them() {
        assert!(with(b"M70", Dialect::Grbl, None).unwrap_err().contains("its own board"));
        let p = with(b"M70\nM30", Dialect::GrblHal, None).unwrap();
        assert!(p.warnings[0].contains("does not prove"));
        assert!(with(b"M70\nM30", Dialect::Grbl, Some(Dialect::Plain)).is_ok());
    }

    proptest! {
        #[test]
        fn nothing_panics_and_only_ascii_is_sent(bytes in proptest::collection::vec(any::<u8>(), 0..120)) {
            for d in Dialect::ALL {
                if let Ok(p) = with(&bytes, d, None) {
                    let script = p.script;
                    for i in 0..script.len() {
                        prop_assert!(script.text(i).bytes().all(|b| (0x20..0x7F).contains(&b)));
                    }
                }
            }
        }
    }
}
