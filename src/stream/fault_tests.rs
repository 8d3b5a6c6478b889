//! Seeded fault runs, thousands a dialect.
//!
//! Of every run: it ends, in a defined exit code; the window is never exceeded; after an error, an
//! alarm or a banner only stop bytes are written; what the device ran is exactly a prefix of the
//! program as far as bytes reached it undamaged; and a run that reports success has run every
//! line, once, in order.
//!
//! Numbered dialects see every damaged byte, so there the prefix is exact whatever happens (one
//! damaged byte a line: the exclusive or is blind to two that cancel). Once in 256 the sum of two
//! lines that lost the end between them agrees: then the job ends with that line named as refused,
//! and what was on the wire behind it has run.
//!
//! grbl, grblHAL and the plain dialect have no checksum. What is asked there of every run, damaged
//! or not: the lines written are exactly a prefix of the program, then codes that switch off; the
//! device read what arrived, each line in its place, none left out, doubled or moved; every line
//! whose bytes arrived whole ran as the program has it, unless one before it was refused or changed or
//! the device began anew. So what ran is exactly a prefix of the program but for lines that the wire
//! itself changed. A device that repeats what it reads gives each of these away; any other hides
//! those that are still valid blocks, one answer each, with the parser's state and every reported
//! position as the program has them: a success in spite of these is allowed but counted, must stay
//! as rare as it was measured, and is never called verified. A device that begins anew loses
//! what arrives while it boots; one that is reset without booting may run what was on the wire,
//! which no sender can call back.

use super::core::{Device, SECOND};
use super::modal::Rates;
use super::sim::{Arrival, Fault, FaultScript, FaultWay, Faulty, SimSetup, Wire};
use super::world_tests::{OWN, Person, World};
use super::{Cleared, Dialect, Ending, Outcome, Position, Preflight, Setting, preflight};
use crate::base::{Rng, rng};
use crate::gcode::read_block;
use crate::machine::Machine;
use rand::RngExt as _;
use rayon::prelude::*;

/// Runs a dialect: enough to break what a change breaks; `HMPLAN_FAULT_RUNS` asks for more.
const RUNS: u64 = 2_000;

fn runs_wanted() -> u64 {
    std::env::var("HMPLAN_FAULT_RUNS").ok().and_then(|n| n.parse().ok()).unwrap_or(RUNS)
}

/// What a kind of run is made of.
#[derive(Clone, Copy)]
struct Kind {
    control: Dialect,
    extruder: Option<Dialect>,
    /// The control runs the extruder's codes itself.
    same: bool,
    /// Where the faults are.
    faulty: Device,
    damage: bool,
    echo: bool,
}

fn program(rng: &mut Rng, kind: Kind) -> String {
    let grbl = kind.control.is_grbl();
    let head = if grbl { "G21\nG90\nG94\nG17\nG54\nF3000\n" } else { "G21\nG90\nG1 F3000\n" };
    let mut text = String::from(head);
    let (mut x, mut open) = (0.0f64, false);
    if kind.extruder.is_some() || kind.same {
        text += "M70\n";
        open = true;
    }
    for i in 0..rng.random_range(10..40) {
        x = (x + rng.random_range(-8.0..9.0)).clamp(-60.0, 60.0);
        let y = f64::from(i) / 10.0;
        text += &match rng.random_range(0..24) {
            0 => format!("G4 P0.{}\n", 1 + i % 9),
            1 if grbl => "G10 L2 P2 X0 Y0 Z0\n".to_string(),
            2 => "M0\n".into(),
            3 => "M3 S8000\n".into(),
            4 => "M5 S8000\n".into(),
            5 | 6 if open => "M72\n".into(),
            7 | 8 if open => "M73\n".into(),
            9 if kind.control == Dialect::GrblHal => "T1 M6\n".into(),
            10 => format!("G0 X{x:.3} Y{y:.3} Z{:.2}\n", 5.0 + y),
            _ => format!("G1 X{x:.3} Y{y:.3}\n"),
        };
    }
    if open {
        text += "M73\nM71\n";
    }
    text + "G0 X0 Y0\nM30\n"
}

fn looked_at(text: &str, kind: Kind, machine: &Machine) -> Preflight {
    let setting = Setting { machine, control: kind.control, extruder: kind.extruder };
    preflight(&Cleared::unchecked(text.into()), &setting)
        .unwrap_or_else(|f| panic!("{}\n{text}", f[0]))
}

/// How much faster than real the machine moves; 0 takes no time.
const SPEEDS: [f64; 3] = [0.0, 1.0, 20.0];

fn world(rng: &mut Rng, kind: Kind, machine: &Machine) -> (World, Preflight, FaultScript, usize) {
    let mut speed = None;
    let text = program(rng, kind);
    let p = looked_at(&text, kind, machine);
    let mut sim = |dialect, rng: &mut Rng| SimSetup {
        speed: SPEEDS[*speed.get_or_insert(rng.random_range(0..3))],
        echo: kind.echo,
        ok_after_resend: rng.random_bool(0.7),
        flushes: rng.random_bool(0.3),
        records: true,
        module: kind.same || dialect == Dialect::Plain,
        rates: Rates::of(machine),
        ..SimSetup::new(dialect)
    };
    let setups = [Some(sim(kind.control, rng)), kind.extruder.map(|d| sim(d, rng))];
    let bytes = if kind.faulty == Device::Control { text.len() as u64 * 2 } else { 60 };
    let mut scripts = [FaultScript::default(), FaultScript::default()];
    scripts[kind.faulty.index()] = if kind.control.is_numbered() && kind.damage {
        let mut s = FaultScript::damage(rng, 0.03, 60, 20);
        let other = FaultScript::random(rng, 1, bytes, false).faults;
        s.faults.extend(other);
        s
    } else {
        FaultScript::random(rng, 3, bytes, kind.damage)
    };
    let faults = scripts[kind.faulty.index()].clone();
    (World::new(&p, setups, scripts, false), p, faults, speed.unwrap_or(0))
}

/// Fails a run with what happened.
macro_rules! must {
    ($what:expr, $told:expr, $($text:tt)*) => {
        if !$what {
            return Err(format!("{}\n  {}", format!($($text)*), $told()));
        }
    };
}

/// One run; whether it reported success in spite of damage that no one could see, and if so how
/// fast its machine was.
fn run(seed: u64, kind: Kind, machine: &Machine) -> Result<Option<usize>, String> {
    let mut rng = rng(seed, kind.control as u64);
    let (mut w, p, faults, speed) = world(&mut rng, kind, machine);
    let person = Person {
        stops: rng.random_bool(0.15).then(|| rng.random_range(0..30 * SECOND)),
        again: rng.random_bool(0.3).then(|| rng.random_range(0..SECOND)),
        ..Person::default()
    };
    let Some(outcome) = w.run(person) else {
        let last: Vec<_> = w.notes.iter().rev().take(4).collect();
        return Err(format!("seed {seed}, {}, {faults:?} does not end: {last:?}", kind.control));
    };
    let told = || format!("seed {seed}, {}, {faults:?}, {outcome:?}", kind.control);
    let code = outcome.ending.exit_code();
    must!(matches!(code, 0 | 3 | 130), told, "exit code {code}");
    must!((code == 130) == (outcome.ending == Ending::Stopped), told, "exit code {code}");
    must!(code != 130 || person.stops.is_some() || w.gave_up, told, "nobody stopped it");
    let all = p.script.len();
    must!(outcome.confirmed <= all && outcome.settled <= all, told, "counts");
    if kind.control.is_grbl() {
        let window = kind.control.receive_bytes() + usize::from(kind.control == Dialect::GrblHal);
        must!(w.most_open <= window - 8, told, "{} bytes outstanding", w.most_open);
    }
    // The extruder's codes go to its own board; spindle and coolant ended with the reset.
    let stops: &[&str] =
        if kind.control.is_numbered() { &["M410", "M112", "M5", "M107"] } else { &[] };
    for line in w.after_fall.iter().flat_map(|t| t.lines()) {
        let off = kind.same && OFF.contains(&line);
        must!(off || stops.contains(&line), told, "'{line}' after a fall");
    }
    if kind.same && code != 0 && outcome.not_off.is_empty() && outcome.confirmed > 0 {
        let module = w.devices[0].as_ref().map(|d| d.sim.record().module);
        must!(module.is_some_and(|m| !m.on && !m.open), told, "said to be off: {module:?}");
    }
    // What left bytes as they are never looks like a machine that does something else.
    let departed = matches!(outcome.ending, Ending::Departed { .. } | Ending::Astray { .. });
    must!(kind.damage || !departed, told, "a false alarm");
    let unseen = prefix(&w, &p, kind, &outcome, &told)?;
    let verified = outcome.delivery.is_verified();
    must!(!(verified && unseen), told, "called verified in spite of damage");
    let proves = kind.echo || kind.control.is_numbered();
    must!(code != 0 || verified == proves, told, "called verified: {verified}");
    Ok(unseen.then_some(speed))
}

/// What ran against the program; whether success was reported in spite of unseen damage.
fn prefix(
    w: &World,
    p: &Preflight,
    kind: Kind,
    outcome: &Outcome,
    told: &dyn Fn() -> String,
) -> Result<bool, String> {
    let mut unseen = false;
    let code = outcome.ending.exit_code();
    for device in Device::BOTH {
        let Some(d) = &w.devices[device.index()] else { continue };
        let extruder = kind.same || device == Device::Extruder;
        let of_device = |i: &usize| {
            let extrudes = matches!(p.script.lines()[*i].class, super::Class::Extruder(_));
            kind.same || extrudes == (device == Device::Extruder)
        };
        let lines: Vec<&str> =
            (0..p.script.len()).filter(of_device).map(|i| p.script.text(i)).collect();
        let want: Vec<String> = lines.iter().map(|l| squeezed(l)).collect();
        let ran = w.ran(device).into_iter().map(|l| squeezed(&l));
        let ran: Vec<String> = ran.filter(|l| !OWN.contains(&l.as_str())).collect();
        let mut n = ran.len();
        if let Some(wire) = &d.wire {
            written(wire, &lines, code, told)?;
            let harm = in_place(d, wire, code, told)?;
            unseen |= code == 0 && harm.is_some();
            must!(!(kind.echo && unseen), told, "{device}: a success hides damage it repeated");
            n = harm.map_or(n, |reads| {
                let program =
                    |(l, taken): &&(String, bool)| *taken && !OWN.contains(&&*squeezed(l));
                d.sim.record().read[..reads].iter().filter(program).count()
            });
        } else if let Ending::Refused { device: at, number, .. } = &outcome.ending
            && *at == device
        {
            // The line that swallowed its neighbour is named; what was on the wire behind it ran.
            n = n.min((*number as usize).saturating_sub(1));
        }
        let exact = n <= want.len() && ran[..n] == want[..n];
        // The codes that switch the module off come behind what ran of the program.
        let then_off = extruder && code != 0 && {
            let k = ran.iter().zip(&want).take_while(|(a, b)| a == b).count();
            (0..=k.min(n)).any(|k| {
                let mut rest = OFF.iter();
                ran[k..n].iter().all(|l| rest.any(|o| o == l))
            })
        };
        must!(exact || then_off, told, "{device} ran {:?} of {want:?}", &ran[..n]);
        let all = code != 0 || unseen || ran == want;
        must!(all, told, "success, but {device} ran {ran:?} of {want:?}");
    }
    Ok(unseen)
}

/// What a stop switches off on the extruder's board.
const OFF: [&str; 3] = ["M73", "M74", "M71"];

/// What was written is exactly a prefix of the program and then, of a job that did not end well,
/// the rest of the line that was being written and what switches off.
fn written(wire: &Wire, want: &[&str], code: u8, told: &dyn Fn() -> String) -> Result<(), String> {
    let (mut k, mut cut, mut off) = (0, false, &OFF[..]);
    for line in wire.written.iter().filter(|l| !OWN.contains(&l.as_str())) {
        let at = off.iter().position(|o| o == line);
        if !cut && want.get(k) == Some(&line.as_str()) {
            k += 1;
        } else if let Some(i) = at.filter(|_| code != 0) {
            (cut, off) = (true, &off[i + 1..]);
        } else {
            let part = code != 0 && !cut && want.get(k).is_some_and(|w| w.starts_with(line));
            must!(part, told, "wrote '{line}' behind {k} lines of {want:?}");
            cut = true;
        }
    }
    must!(code != 0 || k == want.len(), told, "success with {k} lines written of {want:?}");
    Ok(())
}

/// What the device read is what arrived, in order and in place. Lines it read before the first
/// that is not as it was written, or that is behind a reset; None when there is none such.
fn in_place(
    d: &Faulty,
    wire: &Wire,
    code: u8,
    told: &dyn Fn() -> String,
) -> Result<Option<usize>, String> {
    let record = d.sim.record();
    // What is damaged or lost before the job begins is asked again.
    let begins = wire.written.iter().position(|l| !OWN.contains(&l.as_str()));
    let in_job = |a: &Arrival| begins.is_some_and(|b| a.lines[1] >= b);
    let base = wire.arrived.iter().find(|a| in_job(a)).map_or(wire.eras, |a| a.era);
    let (mut next, mut before, mut harm, mut refused) = (0, None::<&Arrival>, None, false);
    for (i, (text, taken)) in record.read.iter().enumerate() {
        // A line too long for it was cut.
        let is = |a: &Arrival| a.text == text.trim() || (!taken && a.text.starts_with(text));
        // Only what came before the job, or before a reset, may be left out.
        let follows = |j: usize, a: &Arrival| {
            wire.arrived[next..j].iter().all(|b| !in_job(b) || b.era < a.era)
        };
        let mut after = (next..wire.arrived.len()).map(|j| (j, &wire.arrived[j]));
        let found = after.find(|(j, a)| is(a) && follows(*j, a)).map(|(j, _)| j);
        let Some(j) = found else {
            let rest = &wire.arrived[next..];
            return Err(format!("read {i} '{text}', which is not next of {rest:?}\n  {}", told()));
        };
        let a = &wire.arrived[j];
        next = j + 1;
        if let Some(b) = before.filter(|b| b.era == a.era && in_job(b)) {
            let joins = a.lines[0] == b.lines[1] + 1 || (a.lines[0] == b.lines[1] && !a.whole);
            must!(joins, told, "read {i} '{text}' is out of place: {b:?}, {a:?}");
        }
        let sent = wire.written.get(a.lines[1]).map_or("", String::as_str);
        if a.whole && is(a) {
            must!(a.text == sent, told, "read {i} '{text}' was written as '{sent}'");
            must!(
                *taken || refused || harm.is_some() || a.era > base,
                told,
                "read {i} '{text}' was refused"
            );
        }
        refused |= !taken && in_job(a);
        let same = a.lines[0] == a.lines[1] && squeezed(text) == squeezed(sent);
        if harm.is_none() && in_job(a) && (!same || a.era > base) {
            harm = Some(i);
        }
        before = Some(a);
    }
    must!(record.overrun == 0, told, "{} bytes overran the buffer", record.overrun);
    let good = next == wire.arrived.len() && !refused && wire.eras == base;
    must!(code != 0 || good, told, "success with {next} of {:?} read", wire.arrived);
    Ok(harm)
}

/// As controllers read it: words and their values. A lost or doubled space, a letter of the other
/// case and a nought that does not count change nothing.
fn squeezed(line: &str) -> String {
    match read_block(line) {
        Ok(words) if !words.is_empty() => {
            words.iter().map(|w| format!("{}{}", w.letter, w.value)).collect()
        }
        _ => line.split_whitespace().collect::<String>().to_ascii_uppercase(),
    }
}

/// All runs of a kind; the number of unseen damages for each speed.
fn runs(kind: Kind, from: u64, n: u64) -> [usize; 3] {
    let machine = Machine::builtin("generic-5axis").unwrap();
    let results: Vec<Result<Option<usize>, String>> =
        (from..from + n).into_par_iter().map(|seed| run(seed, kind, &machine)).collect();
    let failed: Vec<&String> = results.iter().filter_map(|r| r.as_ref().err()).collect();
    let first: Vec<&str> = failed.iter().take(3).map(|s| s.as_str()).collect();
    assert!(failed.is_empty(), "{} of {n} runs failed:\n{}", failed.len(), first.join("\n"));
    let at = |i| results.iter().filter(|r| **r == Ok(Some(i))).count();
    [at(0), at(1), at(2)]
}

/// A third of the runs leave bytes as they are; in a third they are damaged and the device repeats
/// what it reads; in a third they are damaged and it does not.
///
/// `most_unseen` is the share of the last third that ended well in 10,000 runs, rounded up; three
/// standard deviations above it are taken, so that fewer runs may be asked for.
fn dialect(control: Dialect, extruder: Option<Dialect>, faulty: Device, most_unseen: f64) {
    let same = extruder.is_none() && control == Dialect::GrblHal;
    let kind = Kind { control, extruder, same, faulty, damage: false, echo: false };
    let all = runs_wanted();
    let third = all / 3;
    assert_eq!(runs(kind, 0, third), [0; 3]);
    if control.is_numbered() {
        assert_eq!(runs(Kind { damage: true, ..kind }, third, all - third), [0; 3]);
        return;
    }
    assert_eq!(runs(Kind { damage: true, echo: true, ..kind }, third, third), [0; 3]);
    let blind = all - 2 * third;
    let unseen = runs(Kind { damage: true, ..kind }, 2 * third, blind);
    let total: usize = unseen.iter().sum();
    eprintln!(
        "{control}, {faulty}: {total} of {blind} runs with damage ended well unseen, none of them \
         called verified; {} with motion that takes no time, {} at real speed, {} at 20 times that",
        unseen[0], unseen[1], unseen[2]
    );
    let most = most_unseen * blind as f64 + 3.0 * (most_unseen * blind as f64).sqrt();
    assert!(total as f64 <= most, "{total} of {blind}, at most {most:.0}");
}

#[test]
fn grbl_keeps_its_promises() {
    dialect(Dialect::Grbl, None, Device::Control, 0.015);
}

#[test]
fn grblhal_keeps_its_promises() {
    dialect(Dialect::GrblHal, Some(Dialect::Plain), Device::Control, 0.015);
}

#[test]
fn grblhal_with_its_own_extruder_keeps_its_promises() {
    dialect(Dialect::GrblHal, None, Device::Control, 0.015);
}

#[test]
fn marlin_keeps_its_promises() {
    dialect(Dialect::Marlin, None, Device::Control, 0.0);
}

#[test]
fn rrf_keeps_its_promises() {
    dialect(Dialect::Rrf, None, Device::Control, 0.0);
}

#[test]
fn plain_keeps_its_promises() {
    dialect(Dialect::GrblHal, Some(Dialect::Plain), Device::Extruder, 0.002);
}

/// A run of a program on a device that is as it should be, but for what a script damages.
fn one_run(
    text: &str,
    control: Dialect,
    speed: f64,
    script: FaultScript,
    person: Person,
) -> (Outcome, World, Preflight) {
    let machine = Machine::builtin("generic-5axis").unwrap();
    let (extruder, faulty) = (None, Device::Control);
    let kind = Kind { control, extruder, same: false, faulty, damage: false, echo: false };
    let p = looked_at(text, kind, &machine);
    let sim =
        SimSetup { speed, records: true, rates: Rates::of(&machine), ..SimSetup::new(control) };
    let mut w = World::new(&p, [Some(sim), None], [script, FaultScript::default()], false);
    let outcome = w.run(person).unwrap();
    (outcome, w, p)
}

/// Moves of several report intervals each; a bit that turns over in a coordinate, a feed or a speed
/// is never a success. (The lines before them ask for what holds anyway.)
#[test]
fn no_damage_of_a_slow_program_goes_unseen() {
    let mut text = String::from("G21\nG90\nG94\nG17\nG54\nF1200\nM3 S8000\n");
    for i in 0..12 {
        text += &format!("G1 X{} Y{}\n", 10 + 37 * i % 50, 10 + 23 * i % 40);
    }
    text += "G0 X0 Y0\nM30\n";
    let mut departed = 0;
    for control in [Dialect::Grbl, Dialect::GrblHal] {
        for n in (48..400).step_by(2) {
            let flip = Fault::Flip(FaultWay::ToDevice, n, (n / 2 % 7) as u8);
            let script = FaultScript { faults: vec![flip] };
            let (outcome, w, p) = one_run(&text, control, 1.0, script, Person::default());
            let ran = w.ran(Device::Control).into_iter().map(|l| squeezed(&l));
            let want = (0..p.script.len()).map(|i| squeezed(p.script.text(i)));
            let same = ran.eq(want);
            assert!(outcome.ending != Ending::Done || same, "{control}, {flip:?}: {outcome:?}");
            if matches!(outcome.ending, Ending::Departed { .. }) {
                departed += 1;
                assert_eq!(outcome.position, Position::Unknown, "{outcome:?}");
                let record = w.devices[0].as_ref().unwrap().sim.record();
                assert!(!record.spindle && !record.lost_position, "held, then reset: {outcome:?}");
            }
        }
    }
    assert!(departed > 40, "{departed}");
}

/// Everything that moves the machine otherwise than by lines from where it is.
const RICH: &str = "G21\nG90\nG94\nG17\nG54\nT1 M6\nS9000 M3\nM8\nG0 X0 Y0 Z5\nG1 Z1 F600\n\
                    X30 Y4\nG2 X40 Y14 I0 J10\nG3 X30 Y24 R10\nG4 P0.4\nG91\nG1 X-5 Y-5\nX-5\nG90\n\
                    G20\nG1 X1 Y1 F20\nG21\nG1 X20 Y20 F1500\nM0\nG1 X1 Y1\nG10 L2 P2 X1 Y1 Z1\n\
                    G1 X9 Y2\nM5\nM9\nG53 G0 Z700\nG0 X12 Y3\nG28\nG0 X1 Y1\nG55\nG0 X7 Y7\nG54\n\
                    G92 X0 Y0\nG1 X5 Y5\nG92.1\nG1 X3 Y3\nM30\n";

#[test]
fn nothing_a_person_or_a_program_does_is_a_false_alarm() {
    for seed in 0..300 {
        let mut rng = rng(seed, 77);
        let control = [Dialect::Grbl, Dialect::GrblHal][rng.random_range(0..2)];
        let text = match control {
            Dialect::Grbl => RICH.replace("T1 M6", "T1"),
            _ => RICH.replace("G55", "G43 H1\nG1 Z2\nG49\nG55"),
        };
        let overrides = [0x90, 0x91, 0x92, 0x95, 0x96, 0x97, 0x9A, 0xA0];
        let person = Person {
            holds: Some([rng.random_range(0..30 * SECOND), rng.random_range(0..3 * SECOND)]),
            overrides: Some((
                rng.random_range(0..30 * SECOND),
                overrides[rng.random_range(0..overrides.len())],
            )),
            ..Person::default()
        };
        let speed = SPEEDS[rng.random_range(0..3)];
        let (outcome, w, p) = one_run(&text, control, speed, FaultScript::default(), person);
        assert_eq!(outcome.ending, Ending::Done, "seed {seed}, {person:?}: {outcome:?}");
        assert_eq!(w.ran(Device::Control).len(), p.script.len() - OWN_LINES, "seed {seed}");
        let checks = outcome.delivery.checks;
        assert!(checks.states > 10, "{checks:?}");
        assert!(speed != 1.0 || checks.places > 5, "{checks:?}");
    }
}

/// Lines of that program which are spelled like the sender's own.
const OWN_LINES: usize = 2;

#[test]
fn a_verified_run_begins_only_where_every_byte_is_vouched_for() {
    let machine = Machine::builtin("generic-5axis").unwrap();
    let run = |control, extruder: Option<Dialect>, echoes: [bool; 2]| {
        let (same, faulty) = (false, Device::Control);
        let kind = Kind { control, extruder, same, faulty, damage: false, echo: false };
        let codes = if extruder.is_some() { "M70\nM72\nG1 X9\nM73\nM71\n" } else { "" };
        let p = looked_at(&format!("G21\nG1 X1 F900\n{codes}M30\n"), kind, &machine);
        let sim = |(d, echo)| SimSetup { echo, records: true, ..SimSetup::new(d) };
        let setups = [Some(sim((control, echoes[0]))), extruder.map(|d| sim((d, echoes[1])))];
        let mut w = World::verified(&p, setups);
        let outcome = w.run(Person::default()).unwrap();
        (outcome, w.ran(Device::Control).len())
    };
    use Dialect::{Grbl, GrblHal, Marlin, Plain, Rrf};
    for (control, extruder, echoes) in [
        (Grbl, None, [true, false]),
        (GrblHal, Some(Plain), [true, true]),
        (Marlin, None, [false; 2]),
        (Rrf, Some(Plain), [false, true]),
    ] {
        let (outcome, _) = run(control, extruder, echoes);
        assert_eq!(outcome.ending, Ending::Done, "{control}");
        assert!(outcome.delivery.is_verified() && outcome.next_action() == "take the part");
    }
    for (control, extruder, echoes, device) in [
        (Grbl, None, [false, false], Device::Control),
        (GrblHal, Some(Plain), [false, true], Device::Control),
        (GrblHal, Some(Plain), [true, false], Device::Extruder),
        (Rrf, Some(Plain), [false, false], Device::Extruder),
    ] {
        let (outcome, ran) = run(control, extruder, echoes);
        assert_eq!(outcome.ending, Ending::Unverifiable { device }, "{control}");
        assert_eq!((outcome.ending.exit_code(), ran), (1, 0), "{control}");
    }
}

#[test]
fn five_per_cent_damaged_lines_run_once_each_on_marlin() {
    let machine = Machine::builtin("generic-5axis").unwrap();
    let kind = Kind {
        control: Dialect::Marlin,
        extruder: None,
        same: false,
        faulty: Device::Control,
        damage: true,
        echo: false,
    };
    let text: String = (0..2000).map(|i| format!("G1 X{}.{} F3000\n", i % 50, i % 10)).collect();
    let p = looked_at(&format!("{text}M30\n"), kind, &machine);
    for (seed, ok_after_resend, flushes) in [(1, true, false), (2, false, false), (3, true, true)] {
        let script = FaultScript::damage(&mut rng(seed, 5), 0.05, 3000, 24);
        let damaged = script.faults.len();
        assert!(script.faults.iter().all(|f| !matches!(f, Fault::Drop(FaultWay::FromDevice, _))));
        let sim =
            SimSetup { ok_after_resend, flushes, records: true, ..SimSetup::new(kind.control) };
        let mut w = World::new(&p, [Some(sim), None], [script, FaultScript::default()], false);
        let outcome = w.run(Person::default()).unwrap();
        assert_eq!(outcome.ending, Ending::Done, "{outcome:?}");
        let want: Vec<&str> = (0..p.script.len()).map(|i| p.script.text(i)).collect();
        assert_eq!(w.ran(Device::Control), want, "of {damaged} damaged lines");
        assert_eq!(outcome.confirmed, 2001);
    }
}
