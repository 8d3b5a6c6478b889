//! `hmplan stream FILE --port P`: look at the whole program, open the ports, send, report.

use super::args::{OutputArgs, StreamArgs};
use super::exit::{Exit, Failure};
use super::keys::Keys;
use super::output::PLAN;
use super::stream_view::{View, report, report_json, seconds, warn};
use super::{print, profiles};
use hmplan::machine::{ExtruderPort, Machine};
use hmplan::plan::PlanFile;
use hmplan::stream::core::{Command, Core, Limits, Setup};
use hmplan::stream::sim::SimSetup;
use hmplan::stream::{self, Cleared, Dialect, Journal, Preflight, Rates, Said, Session, Setting};
use std::io::{IsTerminal as _, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;

pub fn run(args: &StreamArgs, output: &OutputArgs) -> Result<Exit, Failure> {
    if args.list_ports {
        let ports = stream::list();
        if output.json {
            return super::print_json(&serde_json::json!({ "ports": ports }));
        }
        let text =
            if ports.is_empty() { "no serial ports\n".into() } else { ports.join("\n") + "\n" };
        return print(text.as_bytes());
    }
    let (Some(file), Some(port)) = (&args.file, &args.port) else {
        return Err(Failure::input("give a program and --port"));
    };
    let (cleared, of_plan) = clear(file, args.unchecked)?;
    let machine = match (&args.machine, of_plan) {
        (Some(name), _) => profiles::find_machine(name)?,
        (None, Some(machine)) => machine,
        (None, None) => profiles::find_machine(Machine::DEFAULT)?,
    };
    let control = control_dialect(args, port, &machine)?;
    let extruder = match &args.extruder_port {
        Some(port) => Some(extruder_dialect(port, &machine)?),
        None => None,
    };
    let sent = if args.dry_run {
        cleared.raised(args.raise, &machine).map_err(|f| at(file, &f.to_string()))?
    } else {
        cleared.clone()
    };
    let setting = Setting { machine: &machine, control, extruder };
    let mut look = preflight(file, &sent, &setting)?;
    if args.check && !control.is_grbl() {
        return Err(Failure::Input(format!("{control} has no check mode; use --dry-run")));
    }
    for warning in look.warnings.iter().filter(|_| output.json || !output.quiet) {
        warn(output.json, 0.0, warning);
    }
    let journal_path = journal_path(args, file);
    let mut from = (1, None);
    if args.resume {
        (look, from) = go_on(args, &journal_path, &cleared, &look, &setting)?;
    }
    let script = Arc::new(look.script);
    let journal = if args.check || args.dry_run {
        None
    } else {
        let name = file.display().to_string();
        let names = [cleared.sha256(), &name, control.name()];
        let begun = Journal::open(&journal_path, script.clone(), from, names);
        Some(begun.map_err(|e| Failure::writing(&journal_path, &e))?)
    };
    let setup = Setup {
        script: script.clone(),
        control,
        extruder,
        module_off: module_off(&machine),
        check: args.check,
        // In check mode nothing moves.
        end: if args.check { Vec::new() } else { look.end },
        verified: args.verified,
        limits: Limits::default(),
    };
    job(args, port, &machine, setup, View::new(output, script, journal), output)
}

/// Opens the ports, runs the job and reports.
fn job(
    args: &StreamArgs,
    port: &str,
    machine: &Machine,
    setup: Setup,
    mut view: View,
    output: &OutputArgs,
) -> Result<Exit, Failure> {
    let simulated = simulation(machine, setup.control, args.extruder_port.is_some());
    let open = |name: &str| {
        stream::open(name, args.baud, &simulated).map_err(|e| match e {
            stream::PortError::BadSimulation { .. } => Failure::input(e),
            e => Failure::Io(e.to_string()),
        })
    };
    let ports = [Some(open(port)?), args.extruder_port.as_deref().map(open).transpose()?];
    let (session, remote) = Session::new();
    let interrupted = remote.clone();
    ctrlc::set_handler(move || interrupted.send(Command::Stop))
        .map_err(|e| Failure::Io(format!("Ctrl-C cannot be caught ({e})")))?;
    let keys = Keys::listen(remote);
    let outcome = session.run(Core::new(setup), ports, &mut view);
    drop(keys);
    let now = view.now;
    if let Some(journal) = &mut view.journal {
        journal.end(now, &outcome);
    }
    if output.json {
        print(format!("{}\n", report_json(&outcome, &view)).as_bytes())?;
    } else if !output.quiet {
        if std::io::stderr().is_terminal() {
            let _ = write!(std::io::stderr(), "\r\x1b[K");
        }
        print(report(&outcome, &view).as_bytes())?;
    }
    if let Some(e) = view.journal.as_ref().and_then(|j| j.failed.as_ref()) {
        let what = format!("the journal could not be written ({e})");
        warn(output.json, seconds(view.now), &what);
    }
    match outcome.ending.exit_code() {
        0 => Ok(Exit::Done),
        130 => Ok(Exit::Interrupted),
        1 => Err(Failure::Input(format!("{}; {}", outcome.ending, outcome.next_action()))),
        _ => Err(Failure::Io(format!("{}; {}", outcome.ending, outcome.next_action()))),
    }
}

fn at(file: &Path, what: &str) -> Failure {
    Failure::Input(format!("{}: {what}", file.display()))
}

/// The program, if something vouches for it, and the machine of its plan.
fn clear(file: &Path, unchecked: bool) -> Result<(Cleared, Option<Machine>), Failure> {
    let text = super::verify::read_bounded(file)?;
    let plan_path = file.parent().unwrap_or(Path::new("")).join(PLAN);
    let plan = match plan_path.is_file() {
        true => PlanFile::from_json(&super::verify::read_bounded(&plan_path)?).ok(),
        false => None,
    };
    let (why, text) = match &plan {
        Some(plan) => match Cleared::by_plan(text, plan) {
            Ok(cleared) => {
                return Ok((cleared, plan.program.as_ref().map(|_| plan.machine.clone())));
            }
            Err((why, text)) => (why.to_string(), text),
        },
        None => (format!("no readable {PLAN} lies beside it"), text),
    };
    if unchecked {
        return Ok((Cleared::unchecked(text), plan.map(|p| p.machine)));
    }
    Err(at(
        file,
        &format!(
            "nothing vouches for this program ({why}); send one that `hmplan plan` wrote, from its \
             directory, or take the blame with --unchecked"
        ),
    ))
}

fn control_dialect(args: &StreamArgs, port: &str, machine: &Machine) -> Result<Dialect, Failure> {
    let known = || Dialect::ALL.map(Dialect::name).join(", ");
    if let Some(name) = &args.dialect {
        return Dialect::named(name)
            .ok_or_else(|| Failure::Input(format!("--dialect {name}: there are {}", known())));
    }
    let profile = &machine.control.dialect;
    stream::dialect_of(port).or_else(|| Dialect::named(profile)).ok_or_else(|| {
        Failure::Input(format!(
            "machine '{}' is written for dialect '{profile}', which does not say how its controller \
             talks; add --dialect with one of {}",
            machine.name,
            known()
        ))
    })
}

fn extruder_dialect(port: &str, machine: &Machine) -> Result<Dialect, Failure> {
    let Some(extruder) = &machine.extruder else {
        return Err(Failure::Input(format!(
            "machine '{}' has no extruder; leave --extruder-port out",
            machine.name
        )));
    };
    if extruder.port == ExtruderPort::Same {
        return Err(Failure::Input(format!(
            "machine '{}' has its extruder on the controller's port; say port = \"second\" in its \
             [extruder], or leave --extruder-port out",
            machine.name
        )));
    }
    let name = extruder.dialect.as_deref().unwrap_or("plain");
    stream::dialect_of(port).or_else(|| Dialect::named(name)).ok_or_else(|| {
        Failure::Input(format!(
            "machine '{}': extruder.dialect = {name:?} is unknown",
            machine.name
        ))
    })
}

fn preflight(file: &Path, program: &Cleared, setting: &Setting) -> Result<Preflight, Failure> {
    stream::preflight(program, setting).map_err(|faults| {
        let list: Vec<String> = faults.iter().map(ToString::to_string).collect();
        at(file, &format!("not sent, nothing was written: {}", list.join("; ")))
    })
}

fn journal_path(args: &StreamArgs, file: &Path) -> PathBuf {
    args.journal.clone().unwrap_or_else(|| {
        let mut name = file.as_os_str().to_owned();
        name.push(".journal");
        name.into()
    })
}

/// A line of the file, and the point within it where the machine came to rest.
type Start = (u32, Option<[f64; 3]>);

/// The rest of a stopped job, once the person agrees to the way back.
fn go_on(
    args: &StreamArgs,
    journal: &Path,
    program: &Cleared,
    full: &Preflight,
    setting: &Setting,
) -> Result<(Preflight, Start), Failure> {
    let last = stream::last(journal).map_err(|e| {
        Failure::Input(format!("{}: no job to go on with ({e})", journal.display()))
    })?;
    let said = Said { position_known: args.position_known, from_line: args.from_line };
    let resumed = stream::resume(program, full, setting, &last, said)
        .map_err(|e| Failure::Input(format!("--resume is refused: {e}")))?;
    let mut err = std::io::stderr();
    let exact = if resumed.at.is_some() { ", where the machine came to rest" } else { "" };
    let _ = writeln!(err, "goes on at line {}{exact}; before it:", resumed.line);
    for line in &resumed.preamble {
        let _ = writeln!(err, "    {line}");
    }
    if !args.yes {
        if !std::io::stdin().is_terminal() {
            return Err(Failure::input("nobody is there to agree to this; add --yes"));
        }
        let _ = write!(err, "send this? [y/N] ");
        let mut answer = String::new();
        let _ = std::io::stdin().read_line(&mut answer);
        if !answer.trim().eq_ignore_ascii_case("y") {
            return Err(Failure::input("not agreed to; nothing was sent"));
        }
    }
    Ok((resumed.preflight, (resumed.line, resumed.at)))
}

/// Extrusion off, filament drawn back, module closed.
fn module_off(machine: &Machine) -> Vec<String> {
    let Some(e) = &machine.extruder else { return Vec::new() };
    [&e.m_off, &e.m_retract_on, &e.m_close].map(Clone::clone).to_vec()
}

/// What simulated ports are like: this machine's rates and codes.
fn simulation(machine: &Machine, control: Dialect, second: bool) -> SimSetup {
    let mut setup = SimSetup::new(control);
    setup.rates = Rates::of(machine);
    if let Some(e) = &machine.extruder {
        setup.module = e.port == ExtruderPort::Same && !second;
        let number = |code: &str| code.trim_start_matches('M').parse().unwrap_or(0);
        setup.module_codes = e.codes().map(|(_, code)| number(code));
    }
    setup
}
