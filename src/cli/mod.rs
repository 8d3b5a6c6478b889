//! The command line: raw flags ([`args`]) → resolved configuration ([`config`]) → one function a
//! subcommand. Belongs to the binary alone.

mod analysis;
mod analyze;
mod args;
mod config;
mod exit;
mod inputs;
mod output;
mod paint;
mod pipeline;
mod placing;
mod plan;
mod keys;
mod profiles;
mod progress;
mod stream;
mod stream_view;
mod summary;
mod verify;

use args::{Cli, Command, OutputArgs, SchemaOf};
use clap::{CommandFactory as _, Parser as _};
use exit::{Exit, Failure};
use std::io::{IsTerminal as _, Write as _};
use std::process::ExitCode;

/// Parses, runs and turns the outcome into an exit code.
pub fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(e) => {
            // Help and version are no errors; everything else is bad usage. A closed pipe changes
            // neither.
            let _ = e.print();
            let exit = if e.use_stderr() { Exit::Input } else { Exit::Done };
            return ExitCode::from(exit as u8);
        }
    };
    let exit = match start(&cli.output).and_then(|()| run(cli)) {
        Ok(exit) => exit,
        Err(failure) => {
            let _ = writeln!(std::io::stderr(), "error: {failure}");
            failure.exit()
        }
    };
    ExitCode::from(exit as u8)
}

fn run(cli: Cli) -> Result<Exit, Failure> {
    match cli.command {
        Command::Plan(args) => plan::run(&config::resolve(&args)?, &cli.output),
        Command::Verify(args) => verify::run(&args.dir, args.schedule.as_deref(), &cli.output),
        Command::Machine { action } => profiles::machine(&action, &cli.output),
        Command::Tool { action } => profiles::tool(&action, &cli.output),
        Command::Completions { shell } => completions(shell),
        Command::Schema { of } => schema(of),
        Command::Analyze(args) => analyze::run(&args, &cli.output),
        Command::Stream(args) => stream::run(&args, &cli.output),
    }
}

/// Sets up logs and threads before any work begins.
fn start(output: &OutputArgs) -> Result<(), Failure> {
    let level = match (output.quiet, output.verbose) {
        (true, _) => "off",
        (_, 0) => "warn",
        (_, 1) => "info",
        _ => "debug",
    };
    tracing_subscriber::fmt()
        .with_env_filter(tracing_subscriber::EnvFilter::new(format!("hmplan={level}")))
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .with_target(false)
        // It would report a log that cannot be written there, and panic: a lost line is no reason to lose the plan.
        .log_internal_errors(false)
        .without_time()
        .init();
    let threads = output.threads.map_or(0, usize::from);
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build_global()
        .map_err(|e| Failure::Io(format!("threads cannot be started ({e}); try --threads 1")))
}

fn completions(shell: clap_complete::Shell) -> Result<Exit, Failure> {
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut Cli::command(), "hmplan", &mut script);
    print(&script)
}

fn schema(of: SchemaOf) -> Result<Exit, Failure> {
    let schema = match of {
        SchemaOf::Plan => schemars::schema_for!(hmplan::plan::PlanFile),
        SchemaOf::Machine => schemars::schema_for!(hmplan::machine::Machine),
        SchemaOf::Tool => schemars::schema_for!(hmplan::machine::ToolFile),
    };
    let text = serde_json::to_string_pretty(&schema).map_err(|e| Failure::Io(e.to_string()))?;
    print(format!("{text}\n").as_bytes())
}

/// One JSON object.
fn print_json(object: &serde_json::Value) -> Result<Exit, Failure> {
    print(format!("{object:#}\n").as_bytes())
}

/// Writes to standard output. A reader that went away (`| head`) is no failure.
fn print(bytes: &[u8]) -> Result<Exit, Failure> {
    let mut out = std::io::stdout().lock();
    match out.write_all(bytes).and_then(|()| out.flush()) {
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => {
            Err(Failure::Io(format!("standard output cannot be written ({e})")))
        }
        _ => Ok(Exit::Done),
    }
}
