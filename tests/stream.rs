//! `hmplan stream` from outside: simulated controllers on pseudo-terminals, the binary on the other
//! end.
#![cfg(target_os = "linux")]

use hmplan::machine::Machine;
use hmplan::stream::sim::{Record, Sim, SimSetup};
use hmplan::stream::{Dialect, Rates};
use std::fs::{self, File};
use std::io::{Read as _, Write as _};
use std::os::fd::{AsFd as _, OwnedFd};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

/// A simulated device on a pseudo-terminal.
struct Bench {
    path: PathBuf,
    sim: Arc<Mutex<Sim>>,
    /// Neither reads nor talks.
    stalled: Arc<AtomicBool>,
    over: Arc<AtomicBool>,
    /// Realtime bytes it received, but for status requests.
    urgent: Arc<Mutex<Vec<u8>>>,
}

impl Drop for Bench {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
    }
}

fn terminal() -> (OwnedFd, PathBuf) {
    use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
    use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};
    let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
    grantpt(&master).unwrap();
    unlockpt(&master).unwrap();
    let mut raw = tcgetattr(&master).unwrap();
    raw.make_raw();
    tcsetattr(&master, OptionalActions::Now, &raw).unwrap();
    let name = ptsname(&master, Vec::new()).unwrap();
    (master, PathBuf::from(name.to_str().unwrap()))
}

impl Bench {
    fn new(setup: SimSetup) -> Bench {
        let (master, path) = terminal();
        // Keeps the terminal up while no sender has it open.
        let held = File::options().read(true).write(true).open(&path).unwrap();
        let bench = Bench {
            path,
            sim: Arc::new(Mutex::new(Sim::new(setup))),
            stalled: Arc::default(),
            over: Arc::default(),
            urgent: Arc::default(),
        };
        let urgent = bench.urgent.clone();
        let mut reads = File::from(master.as_fd().try_clone_to_owned().unwrap());
        let mut writes = File::from(master);
        let began = Instant::now();
        let now = move || u64::try_from(began.elapsed().as_micros()).unwrap();
        let (sim, stalled, over) = (bench.sim.clone(), bench.stalled.clone(), bench.over.clone());
        thread::spawn(move || {
            let mut buf = [0; 4096];
            while let Ok(n) = reads.read(&mut buf) {
                while stalled.load(Ordering::Relaxed) {
                    thread::sleep(Duration::from_millis(20));
                }
                let is_urgent = |b: &&u8| **b >= 0x80 || b"!~\x18".contains(b);
                urgent.lock().unwrap().extend(buf[..n].iter().filter(is_urgent));
                sim.lock().unwrap().receive(&buf[..n], now());
            }
        });
        let (sim, stalled) = (bench.sim.clone(), bench.stalled.clone());
        thread::spawn(move || {
            let _held = held;
            while !over.load(Ordering::Relaxed) {
                let said = {
                    let mut sim = sim.lock().unwrap();
                    sim.advance(now());
                    sim.take()
                };
                if !said.is_empty() && !stalled.load(Ordering::Relaxed) {
                    let _ = writes.write_all(&said);
                } else {
                    thread::sleep(Duration::from_micros(200));
                }
            }
        });
        bench
    }

    fn record(&self) -> Record {
        self.sim.lock().unwrap().record().clone()
    }
}

fn sim(dialect: Dialect, speed: f64) -> SimSetup {
    let rates = Rates::of(&Machine::builtin("generic-5axis").unwrap());
    SimSetup { speed, rates, records: true, ..SimSetup::new(dialect) }
}

fn hmplan(file: &Path, port: &Path, more: &[&str]) -> Child {
    let mut command = Command::new(env!("CARGO_BIN_EXE_hmplan"));
    command.arg("stream").arg(file).arg("--port").arg(port).args(["--unchecked"]).args(more);
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

fn finished(child: Child) -> (i32, String, String) {
    let Output { status, stdout, stderr } = child.wait_with_output().unwrap();
    let text = |b: Vec<u8>| String::from_utf8(b).unwrap();
    (status.code().unwrap_or(-1), text(stdout), text(stderr))
}

/// Waits until a device has come so far.
fn until(what: &str, mut is: impl FnMut() -> bool) {
    let began = Instant::now();
    while !is() {
        assert!(began.elapsed() < Duration::from_secs(300), "{what} never happens");
        thread::sleep(Duration::from_millis(5));
    }
}

fn interrupt(child: &Child) {
    let status = Command::new("kill").args(["-INT", &child.id().to_string()]).status();
    assert!(status.unwrap().success());
}

fn write(dir: &Path, text: &str) -> PathBuf {
    let path = dir.join("part.gcode");
    fs::write(&path, text).unwrap();
    path
}

/// A winding path without two equal points; every motion line differs.
fn winding(lines: usize) -> String {
    let mut text = String::from("G21\nG90\nG94\nG17\nG54\nM3 S8000\nG0 X0 Y0 Z5\nG1 Z1 F3000\n");
    for i in 0..lines {
        let (row, at) = (i / 100, i % 100);
        let x = if row % 2 == 0 { at } else { 99 - at } as f64;
        text += &format!("X{:.2} Y{:.3}\n", x / 2.0, row as f64 / 20.0 + x / 1e3);
    }
    text + "G53 G0 Z700\nM30\n"
}

fn resident_kib(child: &Child) -> Option<u64> {
    let status = fs::read_to_string(format!("/proc/{}/status", child.id())).ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmRSS:"))?;
    line.trim().strip_suffix("kB")?.trim().parse().ok()
}

#[test]
fn a_hundred_thousand_lines_reach_the_machine_in_flat_memory() {
    let dir = tempfile::tempdir().unwrap();
    let file = write(dir.path(), &winding(100_000));
    let bench = Bench::new(SimSetup { records: false, ..sim(Dialect::GrblHal, 0.0) });
    let began = Instant::now();
    let child = hmplan(&file, &bench.path, &["--json"]);
    let lines = |n: u64| {
        while bench.record().lines < n && began.elapsed() < Duration::from_secs(600) {
            thread::sleep(Duration::from_millis(5));
        }
        resident_kib(&child).unwrap_or(0)
    };
    let (early, late) = (lines(20_000), lines(95_000));
    let (code, stdout, stderr) = finished(child);
    let took = began.elapsed().as_secs_f64();
    assert_eq!(code, 0, "{stderr}");
    println!("100 000 lines: {took:.1} s, {early} KiB after 20 000, {late} KiB after 95 000");
    let report: serde_json::Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!(report["confirmed"], 100_010);
    let r = bench.record();
    assert_eq!((r.overrun, r.spindle), (0, false));
    assert!(late <= early + 2048, "memory grows: {early} to {late} KiB");
}

#[test]
fn an_interrupted_job_stops_in_order_and_resume_finishes_the_same_part() {
    let dir = tempfile::tempdir().unwrap();
    let mut profile = Machine::builtin("generic-5axis").unwrap();
    let extruder = profile.extruder.as_mut().unwrap();
    extruder.port = hmplan::machine::ExtruderPort::Second;
    let machine = dir.path().join("machine.toml");
    fs::write(&machine, toml::to_string(&profile).unwrap()).unwrap();
    let text = winding(1500).replace("G1 Z1 F3000\n", "M70\nG1 Z1 F3000\nM72\nG4 P0.5\n");
    let text = text.replace("G53 G0 Z700", "M73\nM71\nG53 G0 Z700");
    let file = write(dir.path(), &text);
    let control = Bench::new(sim(Dialect::GrblHal, 20.0));
    let module = Bench::new(sim(Dialect::Plain, 1.0));
    let more =
        ["--machine", machine.to_str().unwrap(), "--extruder-port", module.path.to_str().unwrap()];

    let child = hmplan(&file, &control.path, &more);
    while control.record().moved.len() < 400 {
        thread::sleep(Duration::from_millis(5));
    }
    assert!(control.record().spindle && module.record().module.on);
    interrupt(&child);
    let (code, stdout, stderr) = finished(child);
    assert_eq!(code, 130, "{stdout}{stderr}");
    let stopped = control.record();
    assert!(!stopped.spindle && !stopped.lost_position, "{stdout}");
    let m = module.record().module;
    assert!(!m.on && !m.open && m.drawn, "{m:?}");
    assert!(stdout.contains("next         look at the part"), "{stdout}");

    // Nobody agrees to the way back.
    let (code, _, stderr) =
        finished(hmplan(&file, &control.path, &[&more[..], &["--resume"]].concat()));
    assert_eq!(code, 1);
    assert!(stderr.contains("--yes") && stderr.contains("G53 G0 Z750"), "{stderr}");

    // A job that cannot begin does not hide the one that was stopped.
    let nowhere = hmplan(&file, Path::new("/dev/no-such-port"), &more);
    assert_eq!(finished(nowhere).0, 3);

    let child = hmplan(&file, &control.path, &[&more[..], &["--resume", "--yes"]].concat());
    let (code, stdout, stderr) = finished(child);
    assert_eq!(code, 0, "{stdout}{stderr}");
    let motions = |l: &&str| l.contains(['X', 'Z']) && !l.starts_with("M3");
    let want: Vec<&str> = text.lines().filter(motions).collect();
    let moved = control.record().moved;
    let (first, second) = moved.split_at(stopped.moved.len());
    let rest = want.len() - first.len();
    assert_eq!(first, &want[..first.len()]);
    assert_eq!(second[second.len() - rest..], want[first.len()..], "the same part");
    let way = &second[..second.len() - rest];
    assert!(way.len() == 3 && way[0] == "G53 G0 Z750" && way[1].starts_with("G0 X"), "{way:?}");
    let codes: Vec<String> = module.record().run;
    let off = ["M73", "M74", "M71"];
    let want = [&["M70", "M72"][..], &off, &["M70", "M75", "M72", "M73", "M71"]].concat();
    assert_eq!(codes, want);
    let m = module.record().module;
    assert!(!m.on && !m.open && !m.drawn);
    let (code, _, stderr) =
        finished(hmplan(&file, &control.path, &[&more[..], &["--resume", "--yes"]].concat()));
    assert!(code == 1 && stderr.contains("the job is done"), "{stderr}");
}

#[test]
fn a_stalled_peer_ends_the_job() {
    let dir = tempfile::tempdir().unwrap();
    let file = write(dir.path(), &winding(20_000));
    let bench = Bench::new(sim(Dialect::GrblHal, 0.0));
    let child = hmplan(&file, &bench.path, &[]);
    while bench.record().lines < 500 {
        thread::sleep(Duration::from_millis(5));
    }
    let began = Instant::now();
    bench.stalled.store(true, Ordering::Relaxed);
    let (code, stdout, stderr) = finished(child);
    println!("a stalled peer: {:.1} s", began.elapsed().as_secs_f64());
    bench.stalled.store(false, Ordering::Relaxed);
    assert_eq!(code, 3, "{stdout}{stderr}");
    assert!(stderr.contains("error: nothing was heard of the controller"), "{stderr}");
    assert_eq!(stderr.matches("error:").count(), 1, "{stderr}");
}

#[test]
fn a_mute_peer_ends_the_job_before_it_begins() {
    let dir = tempfile::tempdir().unwrap();
    let file = write(dir.path(), "G0 X1\nM30\n");
    for dialect in ["grbl", "marlin"] {
        let (_master, path) = terminal();
        let (code, _, stderr) = finished(hmplan(&file, &path, &["--dialect", dialect]));
        assert_eq!(code, 3, "{dialect}: {stderr}");
    }
}

#[test]
fn ports_that_cannot_be_had_say_why() {
    let dir = tempfile::tempdir().unwrap();
    let file = write(dir.path(), "G0 X1\nM30\n");
    let refused = |port: &Path, words: &str| {
        let (code, stdout, stderr) = finished(hmplan(&file, port, &[]));
        assert_eq!(code, 3, "{stderr}");
        assert!(stderr.contains(words), "{stderr}");
        assert_eq!((stderr.matches("error:").count(), stdout.as_str()), (1, ""), "{stderr}");
    };
    refused(Path::new("/dev/no-such-port"), "there is no such port");
    refused(&file, "not a serial port");
    let (_master, path) = terminal();
    let taken = serialport::new(path.to_str().unwrap(), 115_200).open().unwrap();
    refused(&path, "another program uses it");
    drop(taken);
}

#[test]
fn a_port_without_permission_says_so() {
    use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _};
    let dir = tempfile::tempdir().unwrap();
    let file = write(dir.path(), "G0 X1\nM30\n");
    let open_to_all = fs::Permissions::from_mode(0o777);
    fs::set_permissions(dir.path(), open_to_all).unwrap();
    let (_master, path) = terminal();
    fs::set_permissions(&path, fs::Permissions::from_mode(0o000)).unwrap();
    let binary = env!("CARGO_BIN_EXE_hmplan");
    // Root may open anything, so it steps down.
    let root = fs::metadata("/proc/self").unwrap().uid() == 0;
    let nobody = |args: &[&str]| {
        let mut command = Command::new(if root { "setpriv" } else { binary });
        if root {
            command.args(["--reuid=65534", "--regid=65534", "--clear-groups", "--", binary]);
        }
        command.args(args).stdin(Stdio::null()).output()
    };
    if !nobody(&["--version"]).is_ok_and(|o| o.status.success()) {
        println!("skipped: setpriv is missing, or others may not run {binary}");
        return;
    }
    let [file, port] = [&file, &path].map(|p| p.to_str().unwrap());
    for more in [&[][..], &["--json"]] {
        let output =
            nobody(&[&["stream", file, "--port", port, "--unchecked"], more].concat()).unwrap();
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(3), "{stderr}");
        let want = format!("error: {port}: no permission to open it; add yourself to");
        assert!(stderr.contains(&want) && !stderr.contains("another program"), "{stderr}");
        assert_eq!((stderr.matches("error:").count(), output.stdout.len()), (1, 0), "{stderr}");
    }
}

#[test]
fn keys_hold_resume_override_and_stop() {
    use rustix::termios::{LocalModes, tcgetattr};
    let dir = tempfile::tempdir().unwrap();
    let file = write(dir.path(), &winding(3000));
    let bench = Bench::new(sim(Dialect::GrblHal, 20.0));
    let (keyboard, seat) = terminal();
    let seat = File::options().read(true).write(true).open(seat).unwrap();
    {
        use rustix::termios::{OptionalActions, tcsetattr};
        let mut cooked = tcgetattr(&seat).unwrap();
        cooked.local_modes.insert(LocalModes::ICANON | LocalModes::ECHO);
        tcsetattr(&seat, OptionalActions::Now, &cooked).unwrap();
    }
    let mut keyboard = File::from(keyboard);
    let mut command = Command::new(env!("CARGO_BIN_EXE_hmplan"));
    command.arg("stream").arg(&file).arg("--port").arg(&bench.path).arg("--unchecked");
    command.stdin(seat.try_clone().unwrap()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let child = command.spawn().unwrap();
    let moved = || bench.record().moved.len();
    let heard = |byte: u8| bench.urgent.lock().unwrap().contains(&byte);
    until("motion", || moved() > 50);
    assert!(!tcgetattr(&seat).unwrap().local_modes.contains(LocalModes::ICANON));
    for (key, byte) in [(b'+', 0x91), (b'-', 0x92), (b'0', 0x90), (b'h', b'!')] {
        keyboard.write_all(&[key]).unwrap();
        until("a key's byte", || heard(byte));
    }
    // Rest: the motion under way ends in a hold.
    thread::sleep(Duration::from_millis(300));
    let held = moved();
    thread::sleep(Duration::from_millis(700));
    assert_eq!(moved(), held, "it moves in a hold");
    assert!(bench.record().spindle && !heard(b'~'));
    keyboard.write_all(b"r").unwrap();
    until("motion again", || moved() > held + 50);
    assert!(heard(b'~') && !heard(0x18));
    keyboard.write_all(b"xq").unwrap();
    let (code, stdout, stderr) = finished(child);
    assert_eq!(code, 130, "{stdout}{stderr}");
    let r = bench.record();
    assert!(!r.spindle && !r.lost_position && heard(0x18), "{stdout}");
    let modes = tcgetattr(&seat).unwrap().local_modes;
    assert!(modes.contains(LocalModes::ICANON | LocalModes::ECHO), "the terminal is put back");
}

#[test]
fn a_verified_plan_is_sent_as_it_is_and_nothing_else_is() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("plan");
    let mut command = Command::new(env!("CARGO_BIN_EXE_hmplan"));
    command.current_dir(env!("CARGO_MANIFEST_DIR"));
    command.args(["plan", "fixtures/bearing_initial.obj", "fixtures/bearing_target.obj"]);
    let planned =
        command.args(["--setup", "keep", "--resolution", "0.8", "-o"]).arg(&out).output().unwrap();
    assert!(planned.status.success(), "{}", String::from_utf8_lossy(&planned.stderr));
    let program = out.join("out.gcode");
    let send = || {
        let mut command = Command::new(env!("CARGO_BIN_EXE_hmplan"));
        // In check mode: a program with a tool change waits for a person.
        command.arg("stream").arg(&program).args(["--port", "sim:grblhal", "--check"]);
        finished(command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap())
    };
    let (code, stdout, stderr) = send();
    assert_eq!(code, 0, "{stdout}{stderr}");
    let text = fs::read_to_string(&program).unwrap();
    fs::write(&program, text + "G4 P1\n").unwrap();
    let (code, stdout, stderr) = send();
    assert!(code == 1 && stdout.is_empty() && stderr.contains("--unchecked"), "{stderr}");
}

#[test]
fn an_unchecked_program_needs_a_flag() {
    let dir = tempfile::tempdir().unwrap();
    let file = write(dir.path(), "G21\nG0 X1\nM30\n");
    let mut command = Command::new(env!("CARGO_BIN_EXE_hmplan"));
    command.arg("stream").arg(&file).args(["--port", "sim:grblhal"]);
    let output = command.output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.code() == Some(1) && stderr.contains("--unchecked"), "{stderr}");
    assert!(!dir.path().join("part.gcode.journal").exists());
    for dialect in ["grbl", "grblhal", "marlin", "rrf"] {
        let port = format!("sim:{dialect}");
        let (code, stdout, stderr) = finished(hmplan(&file, Path::new(&port), &[]));
        assert_eq!(code, 0, "{dialect}: {stdout}{stderr}");
    }
    let (code, ..) = finished(hmplan(&file, Path::new("sim:grbl"), &["--check"]));
    assert_eq!(code, 0);
    let (code, ..) = finished(hmplan(&file, Path::new("sim:grbl"), &["--dry-run"]));
    assert_eq!(code, 0);
}

#[test]
fn what_a_run_may_be_worse_for_is_an_event_among_the_others() {
    let dir = tempfile::tempdir().unwrap();
    let file = write(dir.path(), "G21\nG90\nG54\nG1 X9 F900\n");
    let send = |more: &[&str]| finished(hmplan(&file, Path::new("sim:grbl,speed=1"), more));
    let (code, _, stderr) = send(&[]);
    assert!(code == 0 && stderr.contains("warning: the program does not end with M2"), "{stderr}");
    let (code, _, stderr) = send(&["--json"]);
    let event = |line: &str| serde_json::from_str::<serde_json::Value>(line).expect(line);
    let events: Vec<serde_json::Value> = stderr.lines().map(event).collect();
    let is_it = |e: &serde_json::Value| {
        e["event"] == "warning" && e["what"].as_str().unwrap().contains("does not end with M2")
    };
    assert!(code == 0 && events.iter().any(is_it), "{stderr}");
}

#[test]
fn a_job_says_whether_its_delivery_is_verified() {
    let dir = tempfile::tempdir().unwrap();
    let file = write(dir.path(), "G21\nG90\nG54\nG0 X1 Y1\nG1 X9 F900\nM30\n");
    let send = |port: &str, more: &[&str]| finished(hmplan(&file, Path::new(port), more));
    let (code, stdout, stderr) = send("sim:grbl,speed=1", &[]);
    assert!(code == 0 && stdout.starts_with("done, NOT VERIFIED:"), "{stdout}{stderr}");
    for (port, verified, means) in [
        ("sim:grbl", false, "unproven"),
        ("sim:grblhal", false, "unproven"),
        ("sim:grblhal,echo", true, "repeated"),
        ("sim:marlin", true, "checksum"),
    ] {
        let (code, stdout, stderr) = send(port, &["--json"]);
        let report: serde_json::Value = serde_json::from_str(&stdout).unwrap();
        assert_eq!((code, &report["ending"]), (0, &"done".into()), "{port}: {stderr}");
        assert_eq!(report["verified"], verified, "{port}: {stdout}");
        assert_eq!(report["delivery"]["control"], means, "{port}: {stdout}");
        let event = stderr.lines().find(|l| l.contains("\"event\":\"delivery\"")).unwrap();
        assert!(event.contains(&format!("\"verified\":{verified}")), "{event}");
        let asked = report["delivery"]["parser_states"].as_u64().unwrap();
        assert_eq!(asked > 5, !verified, "{port}: {stdout}");

        let (code, _, stderr) = send(port, &["--verified"]);
        assert_eq!(code, i32::from(!verified), "{port}: {stderr}");
        assert_eq!(stderr.contains("a verified run is not possible"), !verified, "{stderr}");
    }
}
