//! Machine and tool profiles: by name or by file; list, show and check.

use super::args::{OutputArgs, ProfileAction};
use super::exit::{Exit, Failure};
use super::{print, print_json};
use hmplan::machine::{self, Machine, Tool};
use serde::Serialize;
use serde_json::json;
use std::path::Path;

/// A built-in machine, or one from a file.
pub fn find_machine(name: &str) -> Result<Machine, Failure> {
    Machine::named_or_load(name).map_err(Failure::input)
}

/// A tool of the machine, a built-in tool, or one from a file.
pub fn find_tool(machine: &Machine, name: &str) -> Result<Tool, Failure> {
    match machine.tool(name) {
        Some(tool) => Ok(tool.clone()),
        None => Tool::named_or_load(name).map_err(Failure::input),
    }
}

pub fn machine(action: &ProfileAction, output: &OutputArgs) -> Result<Exit, Failure> {
    match action {
        ProfileAction::List => list(&Machine::builtin_names(), output),
        ProfileAction::Show { name } => {
            let machine = find_machine(name)?;
            show(&machine, || machine::describe(&machine), output)
        }
        ProfileAction::Check { file } => {
            let machine = Machine::load(file).map_err(Failure::input)?;
            report(file, &machine.name, &machine::check(&machine), output)
        }
    }
}

pub fn tool(action: &ProfileAction, output: &OutputArgs) -> Result<Exit, Failure> {
    match action {
        ProfileAction::List => list(&Tool::builtin_names(), output),
        ProfileAction::Show { name } => {
            let tool = Tool::named_or_load(name).map_err(Failure::input)?;
            show(&tool, || machine::describe_tool(&tool), output)
        }
        ProfileAction::Check { file } => {
            let tool = Tool::load(file).map_err(Failure::input)?;
            report(file, &tool.name, &[], output)
        }
    }
}

fn list(names: &[&str], output: &OutputArgs) -> Result<Exit, Failure> {
    match output.json {
        true => print_json(&json!({ "names": names })),
        false => print_lines(&names.join("\n")),
    }
}

/// A profile, in words or as it is.
fn show(
    profile: &impl Serialize,
    in_words: impl FnOnce() -> String,
    output: &OutputArgs,
) -> Result<Exit, Failure> {
    match output.json {
        true => print_json(&serde_json::to_value(profile).map_err(|e| Failure::Io(e.to_string()))?),
        false => print_lines(&in_words()),
    }
}

fn print_lines(text: &str) -> Result<Exit, Failure> {
    print(format!("{}\n", text.trim_end()).as_bytes())
}

/// The outcome of a check: its findings, one a line, or that there are none.
fn report(
    file: &Path,
    name: &str,
    findings: &[String],
    output: &OutputArgs,
) -> Result<Exit, Failure> {
    if output.json {
        return print_json(&json!({ "file": file, "name": name, "findings": findings }));
    }
    let head = format!("{}: '{name}' can be used", file.display());
    print_lines(&[&[head], findings].concat().join("\n"))
}
