//! Machine and tool profiles: by name or by file; list, show and check.

use super::args::ProfileAction;
use super::exit::{Exit, Failure};
use super::print;
use hmplan::machine::{self, Machine, Tool};
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

pub fn machine(action: &ProfileAction) -> Result<Exit, Failure> {
    match action {
        ProfileAction::List => list(&Machine::builtin_names()),
        ProfileAction::Show { name } => print_lines(&machine::describe(&find_machine(name)?)),
        ProfileAction::Check { file } => {
            let machine = Machine::load(file).map_err(Failure::input)?;
            report(file, &machine.name, &machine::check(&machine))
        }
    }
}

pub fn tool(action: &ProfileAction) -> Result<Exit, Failure> {
    match action {
        ProfileAction::List => list(&Tool::builtin_names()),
        ProfileAction::Show { name } => print_lines(&machine::describe_tool(
            &Tool::named_or_load(name).map_err(Failure::input)?,
        )),
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

/// The outcome of a check: its findings, one a line, or that there are none.
fn report(file: &Path, name: &str, findings: &[String]) -> Result<Exit, Failure> {
    let head = format!("{}: '{name}' can be used", file.display());
    print_lines(&[&[head], findings].concat().join("\n"))
}
