//! Machine and tool profiles: by name or by file; list, show and check.

use super::args::ProfileAction;
use super::exit::{Exit, Failure};
use super::print;
use hmplan::machine::{self, Machine, Tool};
use std::path::Path;

/// A machine by the name of a built-in profile, or a TOML file.
pub fn find_machine(name: &str) -> Result<Machine, Failure> {
    if let Some(machine) = Machine::builtin(name) {
        return Ok(machine);
    }
    if !is_file_name(name) {
        return Err(Failure::Input(format!(
            "there is no machine '{name}'; `hmplan machine list` names them, or give a TOML file"
        )));
    }
    Machine::load(Path::new(name)).map_err(Failure::input)
}

/// A tool of the machine, a built-in tool, or a TOML file.
pub fn find_tool(machine: &Machine, name: &str) -> Result<Tool, Failure> {
    if let Some(tool) = machine.tools.iter().find(|t| t.name == name) {
        return Ok(tool.clone());
    }
    tool_by_name(name)
}

fn tool_by_name(name: &str) -> Result<Tool, Failure> {
    if let Some(tool) = Tool::builtin(name) {
        return Ok(tool);
    }
    if !is_file_name(name) {
        return Err(Failure::Input(format!(
            "there is no tool '{name}'; `hmplan tool list` names them, or give a TOML file"
        )));
    }
    Tool::load(Path::new(name)).map_err(Failure::input)
}

/// Whether a word is meant as a file: it has an extension or a separator, or the file is there.
fn is_file_name(name: &str) -> bool {
    let path = Path::new(name);
    path.extension().is_some() || path.components().count() > 1 || path.exists()
}

pub fn machine(action: &ProfileAction) -> Result<Exit, Failure> {
    match action {
        ProfileAction::List => list(Machine::BUILTIN),
        ProfileAction::Show { name } => print_lines(&machine::describe(&find_machine(name)?)),
        ProfileAction::Check { file } => {
            let machine = Machine::load(file).map_err(Failure::input)?;
            report(file, &machine.name, &machine::check(&machine))
        }
    }
}

pub fn tool(action: &ProfileAction) -> Result<Exit, Failure> {
    match action {
        ProfileAction::List => list(Tool::BUILTIN),
        ProfileAction::Show { name } => print_lines(&machine::describe_tool(&tool_by_name(name)?)),
        ProfileAction::Check { file } => {
            let tool = Tool::load(file).map_err(Failure::input)?;
            report(file, &tool.name, &[])
        }
    }
}

fn list(names: &[&str]) -> Result<Exit, Failure> {
    print_lines(&names.join("\n"))
}

fn print_lines(text: &str) -> Result<Exit, Failure> {
    print(format!("{}\n", text.trim_end()).as_bytes())
}

/// The outcome of a check: every complaint on a line, or that there is none.
fn report(file: &Path, name: &str, complaints: &[String]) -> Result<Exit, Failure> {
    if complaints.is_empty() {
        return print_lines(&format!("{}: '{name}' is fine", file.display()));
    }
    Err(Failure::Input(format!("{}: {}", file.display(), complaints.join("; "))))
}
