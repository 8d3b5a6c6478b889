//! The summary on standard output: a table for people, or one JSON object.

use super::args::OutputArgs;
use super::exit::Failure;
use super::print;
use hmplan::plan::PlanFile;
use hmplan::report::{RuleLine, mm3};
use std::fmt::Write as _;

/// Prints the summary in the form the flags ask for; nothing with -q.
pub fn show(
    file: &PlanFile,
    rules: &[RuleLine],
    location: Option<&str>,
    output: &OutputArgs,
) -> Result<(), Failure> {
    if output.json {
        let text = serde_json::to_string(&file.summary).map_err(|e| Failure::Io(e.to_string()))?;
        print(format!("{text}\n").as_bytes())?;
    } else if !output.quiet {
        print(table(file, rules, location).as_bytes())?;
    }
    Ok(())
}

/// The reused volume first, then what went wrong, then the rest.
fn table(file: &PlanFile, rules: &[RuleLine], location: Option<&str>) -> String {
    let s = &file.summary;
    let mut out = String::new();
    let mut row = |name: &str, value: String| {
        // Writing into a String cannot fail.
        let _ = writeln!(out, "{name:<10} {value}");
    };
    row(
        "reused",
        format!(
            "{} = {:.1} % of the target ({:.1} % is common to both parts)",
            mm3(s.reused_mm3),
            100.0 * s.reuse_final,
            100.0 * s.reuse_ideal
        ),
    );
    for rule in rules.iter().filter(|r| !r.passed) {
        row("FAILED", format!("{}: {}", rule.rule, rule.figure));
    }
    if s.residual_mm3 > 0.0 {
        let place = location.map_or(String::new(), |l| format!(", most of it at the {l}"));
        row("RESIDUAL", format!("{} that no step reaches{place}", mm3(s.residual_mm3)));
    }
    if s.verified {
        row("verified", format!("all {} rules hold", rules.len()));
    }
    row("removed", format!("{} in {}", mm3(s.removed_mm3), count(s.blocks_sm, "block")));
    row("added", format!("{} in {}", mm3(s.added_mm3), count(s.blocks_am, "block")));
    row(
        "steps",
        format!(
            "{}, {} of process, {}",
            file.steps.len(),
            count(s.switches, "change"),
            count(s.holdings, "holding")
        ),
    );
    row("skin", format!("{} left for finishing", mm3(s.skin_mm3)));
    match &file.program {
        Some(p) => {
            row("program", format!("{}, {} lines", p.path, p.lines));
            row(
                "machine",
                format!(
                    "{:.0} min; {} deposited, {} swept away",
                    p.time_s / 60.0,
                    mm3(p.deposited_mm3),
                    mm3(p.removed_mm3)
                ),
            );
        }
        None => row("program", "none".into()),
    }
    let [x, y, z] = file.grid.dims;
    row("grid", format!("{x} × {y} × {z} voxels of {} mm", file.grid.pitch));
    if let Some(total) = s.seconds.total {
        row("time", format!("{total:.1} s"));
    }
    for note in &s.notes {
        row("note", note.clone());
    }
    out
}

fn count(n: usize, noun: &str) -> String {
    format!("{n} {noun}{}", if n == 1 { "" } else { "s" })
}
