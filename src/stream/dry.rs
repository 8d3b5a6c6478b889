//! A program for a run in the air: everything higher by some millimetres, no extrusion.

use super::modal::{Modal, Rates};
use super::preflight::Fault;
use crate::gcode::read_block;
use crate::machine::Machine;

/// The program with every Z in work coordinates raised and without the extruder's codes. Lines keep
/// their numbers. Moves in machine coordinates stay as they are: they are the retracts.
///
/// # Errors
/// What cannot be raised: relative motion, offsets set by the program, canned cycles.
pub(super) fn raised(text: &[u8], raise_mm: f64, machine: &Machine) -> Result<Vec<u8>, Fault> {
    let codes: Vec<&str> =
        machine.extruder.iter().flat_map(|e| e.codes()).map(|(_, c)| c).collect();
    let rates = Rates::of(machine);
    let mut modal = Modal::default();
    let mut out = String::new();
    for (i, raw) in text.split(|b| *b == b'\n').enumerate() {
        let number = u32::try_from(i + 1).unwrap_or(u32::MAX);
        let fault = |what: &str| Fault { number, what: what.into() };
        let line = String::from_utf8_lossy(raw);
        let code = without_comments(&line);
        let Ok(words) = read_block(&code) else {
            // The preflight says what is wrong with it.
            out.push_str(&code);
            out.push('\n');
            continue;
        };
        let in_machine = words.iter().any(|w| w.letter == 'G' && w.value == 53.0);
        modal.apply(&words, &rates);
        if modal.relative || modal.shifted || modal.way == super::Way::Cycle {
            return Err(fault(
                "a dry run raises absolute coordinates; relative motion, offsets set by the \
                 program and canned cycles cannot be raised",
            ));
        }
        if codes.contains(&code.trim()) {
            out.push('\n');
            continue;
        }
        let raise = if modal.inches { raise_mm / 25.4 } else { raise_mm };
        let lifts = words.iter().any(|w| w.letter == 'Z') && !in_machine;
        if !lifts {
            out.push_str(code.trim());
        } else {
            let words: Vec<String> = words
                .iter()
                .map(|w| match w.letter {
                    'Z' => format!("Z{:.4}", w.value + raise),
                    l => format!("{l}{}", w.value),
                })
                .collect();
            out.push_str(&words.join(" "));
        }
        out.push('\n');
    }
    Ok(out.into_bytes())
}

fn without_comments(line: &str) -> String {
    let mut open = false;
    let code = line.split(';').next().unwrap_or("");
    code.chars()
        .filter(|c| {
            let inside = open || *c == '(';
            open = inside && *c != ')';
            !inside
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_heights_rise_and_the_extruder_is_silent() {
        let machine = Machine::builtin("generic-5axis").unwrap();
        let up = |text: &str| raised(text.as_bytes(), 50.0, &machine);
        let text = "G21 (Z1)\nM72\nG1 X1 Z-2.5 F100\nG53 G0 Z700\nG20\nG0 Z1";
        let got = String::from_utf8(up(text).unwrap()).unwrap();
        assert_eq!(got, "G21\n\nG1 X1 Z47.5000 F100\nG53 G0 Z700\nG20\nG0 Z2.9685\n");
        assert_eq!(up("G90\nG91").unwrap_err().number, 2);
    }
}
