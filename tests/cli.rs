//! The command line from outside: what it prints, what it writes, what it returns.

use assert_cmd::Command;
use hmplan::base::DVec3;
use hmplan::mesh::{TriMesh, write_obj};
use hmplan::plan::{PlanFile, StepKind};
use predicates::prelude::*;
use predicates::str::contains;
use std::fs;
use std::path::{Path, PathBuf};

/// Coarse, so that a plan takes a second.
const PITCH: &str = "0.8";

fn hmplan() -> Command {
    let mut command = Command::cargo_bin("hmplan").unwrap();
    command.current_dir(env!("CARGO_MANIFEST_DIR"));
    command
}

/// `hmplan plan` on the bearing, into `dir`.
fn plan(dir: &Path, more: &[&str]) -> Command {
    let mut command = hmplan();
    command
        .args(["plan", "fixtures/bearing_initial.obj", "fixtures/bearing_target.obj"])
        .args(["--setup", "keep", "--resolution", PITCH, "-o"])
        .arg(dir)
        .args(more);
    command
}

/// Fails with exit code 1 and one message that contains `words`; nothing else, no panic.
fn refused(command: &mut Command, words: &str) {
    let output = command.output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    assert!(stderr.contains(words), "'{words}' is not in: {stderr}");
    assert_eq!(stderr.matches("error:").count(), 1, "{stderr}");
    assert!(!stderr.contains("panicked") && output.stdout.is_empty(), "{stderr}");
}

fn read_plan(dir: &Path) -> PlanFile {
    PlanFile::from_json(&fs::read(dir.join("plan.json")).unwrap()).unwrap()
}

/// Every file below a directory, by its relative name.
fn files(dir: &Path) -> Vec<PathBuf> {
    fn walk(dir: &Path, top: &Path, found: &mut Vec<PathBuf>) {
        for entry in fs::read_dir(dir).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                walk(&path, top, found);
            } else {
                found.push(path.strip_prefix(top).unwrap().to_path_buf());
            }
        }
    }
    let mut found = Vec::new();
    walk(dir, dir, &mut found);
    found.sort();
    found
}

#[test]
fn help_and_version_are_no_errors() {
    hmplan().arg("--version").assert().success().stdout(contains("hmplan "));
    hmplan().args(["plan", "--help"]).assert().success().stdout(contains("--resolution"));
    hmplan().assert().code(1).stderr(contains("Usage"));
}

#[test]
fn bad_flags_are_bad_usage() {
    let out = tempfile::tempdir().unwrap();
    let dir = out.path().join("d");
    for (flags, words) in [
        (&["--resolution", "0"][..], "above 0"),
        (&["--resolution", "nan"], "above 0"),
        (&["--tolerance=-1"], "from 0 to"),
        (&["--tolerance", "1e9"], "from 0 to"),
        (&["--grip", "nan"], "from 0 to"),
        (&["--up", "w"], "possible values"),
        (&["--threads", "0"], "1..=1024"),
        (&["--machine", "no-such-machine"], "no-such-machine"),
        (&["--sm-tool", "no-such-tool"], "no-such-tool"),
        (&["--sm-tool", "w2v-nozzle"], "no cutter"),
        (&["--am-tool", "w2v-nozzle", "--am-tool", "w2v-nozzle"], "twice"),
        (&["--trace", "tree.tsv"], "only planner search"),
        (&["--planner", "search", "--rounds", "2"], "planner reman"),
        (&["--planner", "nullify", "--set-cover", "greedy"], "planner reman"),
        (&["--lambda", "0.5"], "--lambda goes with planner search"),
        (&["--tight-bound"], "planner search"),
        (&["--planner", "nullify", "--overhang", "45"], "planner search"),
        (&["--tool-length", "12"], "planner nullify"),
        (&["--planner", "search", "--supports", "none"], "planner reman"),
        (&["--planner", "nullify", "--base-tolerance", "0.5"], "planner reman"),
        (&["--planner", "nullify", "--setup-candidates", "2"], "planner reman"),
        (&["--setup", "keep", "--setup-candidates", "2"], "no placement to choose"),
        (&["--setup", "keep", "--initial-pose", "search"], "leave out --initial-pose"),
        (&["--planner", "search", "--finish"], "planner reman"),
        (&["--finish=0"], "above 0"),
        (&["--finish=0.5", "--planner", "nullify"], "planner reman"),
        (&["--planner", "search", "--rotations", "8"], "possible values"),
        (&["--planner", "search", "--tool-cost", "long-cutter"], "TOOL=F"),
        (&["--planner", "search", "--delta=-1"], "from 0 to 1"),
        (&["--planner", "search", "--overhang", "1e300"], "from 0 to 90"),
        (&["--planner", "blocks"], "planner blocks is not in version"),
        (&["--nonsense"], "--nonsense"),
        (&["-q", "-v"], "cannot be used with"),
    ] {
        let mut command = hmplan();
        command.args(["plan", "a.stl", "b.stl", "-o"]).arg(&dir).args(flags);
        refused(&mut command, words);
    }
    assert!(!dir.exists());
}

#[test]
fn bad_parts_are_bad_input() {
    let out = tempfile::tempdir().unwrap();
    let dir = out.path().join("d");
    let part = |name: &str, bytes: &[u8]| {
        let path = out.path().join(name);
        fs::write(&path, bytes).unwrap();
        path
    };
    let mut header_only = vec![0; 84];
    header_only[80..].copy_from_slice(&u32::MAX.to_le_bytes());
    let flat = b"v 0 0 0\nv 9 0 0\nv 0 9 0\nf 1 2 3\n";
    for (path, words) in [
        (out.path().join("gone.stl"), "gone.stl"),
        (part("empty.obj", b""), "empty.obj"),
        (part("huge.stl", &header_only), "huge.stl"),
        (part("points.obj", b"v 0 0 0\nv 1 0 0\n"), "points.obj"),
        (part("flat.obj", flat), "flat.obj"),
        (part("words.txt", b"not a mesh at all"), "words.txt"),
        (out.path().to_path_buf(), "directory"),
    ] {
        let mut command = hmplan();
        command.arg("plan").arg(&path).args(["fixtures/bearing_target.obj", "--setup", "keep"]);
        command.args(["--resolution", "1", "-q", "-o"]).arg(&dir);
        refused(&mut command, words);
    }
    assert!(!dir.exists());
}

#[test]
fn one_part_is_nullified_unless_told_otherwise() {
    let out = tempfile::tempdir().unwrap();
    let mut one = hmplan();
    one.args(["plan", "fixtures/bearing_target.obj", "--resolution", "2", "--json", "-o"]);
    let done = one.arg(out.path().join("d")).assert().code(0).get_output().stdout.clone();
    let summary: serde_json::Value = serde_json::from_slice(&done).unwrap();
    assert_eq!(summary["planner"], "nullify");
    assert_eq!(summary["residual_mm3"], 0.0);
    let mut command = hmplan();
    command.args(["plan", "fixtures/bearing_target.obj", "--planner", "reman", "-o"]);
    refused(command.arg(out.path().join("e")), "give INITIAL and TARGET");
}

/// A part on its tip, whose lowest layer of voxels is empty, floated a voxel above the base.
#[test]
fn a_target_on_a_tip_finer_than_the_grid_is_made_exactly() {
    let out = tempfile::tempdir().unwrap();
    let (tip, dir) = (out.path().join("tip.obj"), out.path().join("d"));
    let corners = "v 10 0 0\nv -10 0 0\nv 0 10 0\nv 0 -10 0\nv 0 0 10\nv 0 0 -10\n";
    let faces = "f 1 3 5\nf 3 2 5\nf 2 4 5\nf 4 1 5\nf 3 1 6\nf 2 3 6\nf 4 2 6\nf 1 4 6\n";
    fs::write(&tip, format!("{corners}{faces}")).unwrap();
    let mut command = hmplan();
    command.args(["plan", "fixtures/block_bracket_initial.obj"]).arg(&tip);
    command.args(["--planner", "nullify", "--resolution", "1", "--json", "-q", "-o"]);
    let done = command.arg(&dir).assert().code(0).get_output().stdout.clone();
    let summary: serde_json::Value = serde_json::from_slice(&done).unwrap();
    assert_eq!(summary["residual_mm3"], 0.0);
    hmplan().arg("verify").arg(&dir).assert().code(0);
}

#[test]
fn the_search_says_what_its_plan_costs_and_verifies() {
    let out = tempfile::tempdir().unwrap();
    let (dir, tree) = (out.path().join("d"), out.path().join("tree.tsv"));
    let search = |dir: &Path| {
        let mut command = hmplan();
        command.args(["plan", "fixtures/block_bracket_initial.obj"]);
        command.args([
            "fixtures/block_bracket_target.obj",
            "--setup",
            "keep",
            "--planner",
            "search",
        ]);
        command.args(["--resolution", "1", "--holding", "refixture", "--base", "none", "--json"]);
        command.arg("-o").arg(dir);
        command
    };
    let done = search(&dir).arg("--trace").arg(&tree).assert().code(0).get_output().stdout.clone();
    let summary: serde_json::Value = serde_json::from_slice(&done).unwrap();
    assert_eq!((&summary["planner"], &summary["verified"]), (&"search".into(), &true.into()));
    // Nothing but what is too much is cut.
    assert_eq!(summary["cost"], summary["cost_lower_bound"]);
    assert!(summary["states_expanded"].as_u64().unwrap() > 0);
    let plan: serde_json::Value =
        serde_json::from_slice(&fs::read(dir.join("plan.json")).unwrap()).unwrap();
    assert_eq!(plan["command"]["search"]["rotations"], 7);
    for step in plan["steps"].as_array().unwrap() {
        assert_eq!(step["origin"]["action"], "OC");
    }
    let tree = fs::read_to_string(&tree).unwrap();
    assert!(
        tree.starts_with("state\tfrom\taction") && tree.lines().any(|l| l.contains("\ttrue\t"))
    );
    hmplan().arg("verify").arg(&dir).assert().code(0);

    // One step does not get there: the nearest plan, and why.
    let short = out.path().join("e");
    let done =
        search(&short).args(["--max-steps", "1"]).assert().code(2).get_output().stdout.clone();
    let summary: serde_json::Value = serde_json::from_slice(&done).unwrap();
    assert!(summary["residual_mm3"].as_f64().unwrap() > 0.0);
    assert!(summary["notes"].to_string().contains("nearer"), "{}", summary["notes"]);
}

/// A cup with its opening down, held on its pedestal: what carries its floor can't be cut out from
/// below, so that it is made another way up.
#[test]
fn a_search_from_nothing_tries_the_other_ways_up() {
    let temp = tempfile::tempdir().unwrap();
    let cup = temp.path().join("cup.obj");
    let square = |half: f64, z: f64| {
        [[-half, -half], [half, -half], [half, half], [-half, half]].map(|[x, y]| [x, y, z])
    };
    let rings = [square(10.0, 0.0), square(10.0, 16.0), square(6.0, 0.0), square(6.0, 12.0)];
    let mut text = String::new();
    for [x, y, z] in rings.concat() {
        text += &format!("v {x} {y} {z}\n");
    }
    for i in 0..4 {
        let j = (i + 1) % 4;
        // Outside, inside and rim, as seen from the air.
        for [a, b, c, d] in
            [[i, j, 4 + j, 4 + i], [8 + j, 8 + i, 12 + i, 12 + j], [j, i, 8 + i, 8 + j]]
        {
            text += &format!("f {} {} {} {}\n", a + 1, b + 1, c + 1, d + 1);
        }
    }
    text += "f 5 6 7 8\nf 16 15 14 13\n";
    std::fs::write(&cup, text).unwrap();
    let search = |dir: &str, setup: &str| {
        let dir = temp.path().join(dir);
        let mut command = hmplan();
        command.arg("plan").arg(&cup).args(["--planner", "search", "--resolution", "1"]);
        command.args(["--setup", setup, "--json", "-o"]).arg(&dir);
        let output = command.output().unwrap();
        let file = read_plan(&dir);
        let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        (file, summary, output.status.code())
    };
    let (_, kept, _) = search("kept", "keep");
    assert_eq!(kept["verified"], false, "{kept}");
    let (file, found, code) = search("found", "search");
    assert_eq!(found["verified"], true, "{found}");
    let notes = found["notes"].to_string();
    assert!(notes.contains("of the file up leaves") && notes.contains("z "), "{notes}");
    // The plan is judged in the pose it was made for.
    let up = &file.inputs.target.transform[8..11];
    assert!(up[2].abs() < 1e-9, "the file's z no longer points up: {up:?}");
    let judged = hmplan().arg("verify").arg(temp.path().join("found")).output().unwrap();
    assert_eq!(judged.status.code(), code);
}

#[test]
fn a_grid_beyond_all_memory_is_refused_at_once() {
    let out = tempfile::tempdir().unwrap();
    let mut command = hmplan();
    command.args(["plan", "fixtures/bearing_initial.obj", "fixtures/bearing_target.obj"]);
    command.args(["--setup", "keep", "--unit", "m", "--resolution", "0.01", "-o"]);
    command.arg(out.path().join("d"));
    refused(&mut command, "--resolution");
}

#[test]
fn a_program_that_is_not_there_is_not_sent() {
    refused(hmplan().args(["stream", "no.gcode", "--port", "/dev/null"]), "cannot be read");
}

#[test]
fn a_slip_in_a_profile_is_named_with_its_place() {
    let home = tempfile::tempdir().unwrap();
    let path = home.path().join("mill.toml");
    let good = "name = \"mill\"\nkind = \"subtractive\"\n[[section]]\nshape = \"ball\"\n\
                radius = 2.0\nactive = true\n";
    fs::write(&path, good).unwrap();
    hmplan().args(["tool", "check"]).arg(&path).assert().success().stdout(contains("mill"));
    fs::write(&path, good.replace("radius", "radios")).unwrap();
    refused(hmplan().args(["tool", "check"]).arg(&path), "radios");
    fs::write(&path, good.replace("2.0", "-2.0")).unwrap();
    refused(hmplan().args(["tool", "check"]).arg(&path), "-2");
    fs::write(&path, "name = ").unwrap();
    refused(hmplan().args(["machine", "check"]).arg(&path), "mill.toml:1:");
}

/// The default machine without its rotary axes, or with the tilting one alone: what they can do they
/// do, and no program of theirs names an axis that is not there.
#[test]
fn machines_of_three_and_four_axes_get_their_programs() {
    let temp = tempfile::tempdir().unwrap();
    let text = fs::read_to_string("src/machine/presets/generic-5axis.toml").unwrap();
    let (linear, rest) = text.split_once("[kinematics.first]").unwrap();
    let (tilting, rest) = rest.split_once("[kinematics.second]").unwrap();
    let control = rest.split_once("[control]").unwrap().1;
    let three = format!("{linear}[control]{control}");
    let four = format!("{linear}[kinematics.first]{tilting}[control]{control}");
    for (text, pair, axes) in [(three, "flange", 0), (four, "block_bracket", 1)] {
        let file = temp.path().join(format!("{axes}.toml"));
        fs::write(&file, text).unwrap();
        hmplan().args(["machine", "check"]).arg(&file).assert().code(0).stdout(contains("rotary"));
        let dir = temp.path().join(pair);
        let mut command = hmplan();
        command.arg("plan").arg(format!("fixtures/{pair}_initial.obj"));
        command.arg(format!("fixtures/{pair}_target.obj")).args(["--setup", "keep", "-o"]);
        command.arg(&dir).arg("--machine").arg(&file).args(["--resolution", PITCH]);
        command.assert().code(0);
        hmplan().arg("verify").arg(&dir).assert().code(0);
        let program = fs::read_to_string(dir.join("out.gcode")).unwrap();
        let turns = |letter: &str| {
            program.lines().any(|l| l.starts_with('G') && l.contains(&format!(" {letter}")))
        };
        assert!(!turns("B") && !turns("C"), "{pair}");
        assert_eq!(turns("A"), axes == 1, "{pair}");
    }
}

#[test]
fn profiles_are_listed_and_shown() {
    let list = hmplan().args(["machine", "list"]).assert().success();
    list.stdout(contains("generic-5axis"));
    hmplan().args(["machine", "show", "generic-5axis"]).assert().success();
    let tools = hmplan().args(["tool", "list"]).output().unwrap();
    for name in String::from_utf8(tools.stdout).unwrap().lines() {
        hmplan().args(["tool", "show", name]).assert().success().stdout(contains(name));
    }
    refused(hmplan().args(["tool", "show", "excavator"]), "w2v-cutter");
}

#[test]
fn profiles_and_ports_are_one_json_object_if_asked() {
    for (words, key) in [
        (&["machine", "list"][..], "names"),
        (&["tool", "list"], "names"),
        (&["machine", "show", "generic-5axis"], "tool"),
        (&["tool", "show", "w2v-cutter"], "section"),
        (&["stream", "--list-ports"], "ports"),
    ] {
        let output = hmplan().args(words).arg("--json").output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{words:?}");
        let object: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert!(object[key].is_array(), "{words:?}: {object}");
    }
}

/// A log that cannot be written used to cost the plan.
#[cfg(target_os = "linux")]
#[test]
fn a_full_standard_error_costs_no_plan() {
    let out = tempfile::tempdir().unwrap();
    let dir = out.path().join("d");
    let full = fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_hmplan"));
    command.current_dir(env!("CARGO_MANIFEST_DIR")).stderr(full);
    command.args(["plan", "fixtures/same_initial.obj", "fixtures/same_target.obj", "-v", "-o"]);
    let status = command.arg(&dir).args(["--setup", "keep", "--resolution", "1"]).output();
    assert_eq!(status.unwrap().status.code(), Some(0));
    assert!(dir.join("plan.json").is_file());
}

#[test]
fn a_tool_that_is_not_there_costs_nothing_and_is_named() {
    let out = tempfile::tempdir().unwrap();
    let dir = out.path().join("d");
    let mut command = plan(&dir, &["--planner", "search", "--tool-cost", "hammer=5"]);
    refused(&mut command, "hammer");
    assert!(!dir.exists());
}

#[test]
fn a_schedule_does_not_take_the_place_of_the_plan() {
    let out = tempfile::tempdir().unwrap();
    let dir = out.path().join("d");
    let own = dir.join("plan.json");
    let mut command = plan(&dir, &["--planner", "nullify", "--schedule", own.to_str().unwrap()]);
    refused(&mut command, "plan.json");
    assert!(!dir.exists());
}

#[test]
fn schemas_and_completions_are_printed() {
    for of in ["plan", "machine", "tool"] {
        let output = hmplan().args(["schema", of]).output().unwrap();
        let schema: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        let validator = jsonschema::validator_for(&schema).unwrap();
        if of == "tool" {
            for name in ["slim-mill", "fine-nozzle"] {
                let text = fs::read_to_string(format!("fixtures/{name}.toml")).unwrap();
                let tool: serde_json::Value = toml::from_str(&text).unwrap();
                assert!(validator.is_valid(&tool), "{name}");
            }
        }
    }
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        hmplan().args(["completions", shell]).assert().success().stdout(contains("hmplan"));
    }
}

#[test]
fn a_plan_is_written_whole_and_obeys_its_schema() {
    let out = tempfile::tempdir().unwrap();
    let dir = out.path().join("d");
    let run = plan(&dir, &[]).assert().code(0);
    run.stdout(predicate::str::starts_with("reused ")).stderr("");
    let names: Vec<String> = files(&dir).iter().map(|p| p.display().to_string()).collect();
    let file = read_plan(&dir);
    for name in ["out.gcode", "plan.json", "report.html", "states/reused.stl"] {
        assert!(names.iter().any(|n| n == name), "{name} is missing in {names:?}");
    }
    assert_eq!(names.len(), 6 + file.steps.len(), "{names:?}");
    assert!(file.summary.verified && file.program.is_some());

    let schema = hmplan().args(["schema", "plan"]).output().unwrap().stdout;
    let schema: serde_json::Value = serde_json::from_slice(&schema).unwrap();
    let text = fs::read(dir.join("plan.json")).unwrap();
    let value: serde_json::Value = serde_json::from_slice(&text).unwrap();
    let validator = jsonschema::validator_for(&schema).unwrap();
    if let Some(e) = validator.iter_errors(&value).next() {
        panic!("{e} at {}", e.instance_path());
    }
    let page = fs::read_to_string(dir.join("report.html")).unwrap();
    assert!(page.matches("<svg").count() == file.steps.len() && !page.contains("http"));
}

#[test]
fn json_is_the_only_thing_on_standard_output() {
    let out = tempfile::tempdir().unwrap();
    let dir = out.path().join("d");
    let output = plan(&dir, &["--json", "-v"]).output().unwrap();
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let file = serde_json::to_value(read_plan(&dir).summary).unwrap();
    assert_eq!(summary, file);
    assert!(!output.stderr.is_empty(), "-v logs to standard error");
    let silent = plan(&dir, &["-q"]).output().unwrap();
    assert!(silent.stdout.is_empty() && silent.stderr.is_empty());
}

#[test]
fn threads_do_not_change_a_byte() {
    let out = tempfile::tempdir().unwrap();
    let [one, two] = ["1", "2"].map(|n| {
        let dir = out.path().join(n);
        plan(&dir, &["--threads", n, "-q"]).assert().code(0);
        dir
    });
    assert_eq!(files(&one), files(&two));
    for name in files(&one) {
        let same = if name == Path::new("plan.json") {
            let [a, b] = [&one, &two].map(|d| read_plan(d).canonical_without_timings());
            a == b
        } else {
            fs::read(one.join(&name)).unwrap() == fs::read(two.join(&name)).unwrap()
        };
        assert!(same, "{} differs", name.display());
    }
}

#[test]
fn the_same_part_twice_needs_no_step() {
    let out = tempfile::tempdir().unwrap();
    let dir = out.path().join("d");
    let part = "fixtures/bearing_target.obj";
    let mut command = hmplan();
    command.args(["plan", part, part, "--setup", "keep", "--resolution", PITCH, "-o"]).arg(&dir);
    // Sums of no steps are 0 min and 0 mm³, not −0.
    command.assert().code(0).stdout(contains("0 min").and(contains("-0").not()));
    let file = read_plan(&dir);
    assert!(file.steps.is_empty());
    assert_eq!((file.summary.reuse_final, file.summary.residual_mm3), (1.0, 0.0));
    hmplan().arg("verify").arg(&dir).assert().code(0);
}

/// Stock on all sides, as it is drawn in a CAM system: nothing was kept of it, and nobody said why.
#[test]
fn a_target_in_the_air_is_named_with_ways_to_keep_it() {
    let out = tempfile::tempdir().unwrap();
    let file = |name: &str, spare: f64| {
        let (low, high) = (DVec3::splat(-spare), DVec3::new(20.0, 15.0, 15.0) + spare);
        let path = out.path().join(name);
        write_obj(&TriMesh::cuboid(low, high), fs::File::create(&path).unwrap()).unwrap();
        path
    };
    let (stock, part, dir) = (file("stock.obj", 3.0), file("part.obj", 0.0), out.path().join("d"));
    let run = |more: &[&str]| {
        let mut command = hmplan();
        command.arg("plan").args([&stock, &part]).args(["--resolution", "1.5", "-o"]).arg(&dir);
        command.args(more).output().unwrap()
    };
    let said = String::from_utf8(run(&["--setup", "keep"]).stdout).unwrap();
    assert!(said.contains("3.0 mm over the base plane") && said.contains("refixture"), "{said}");
    for ways in [&["--setup", "search"][..], &["--setup", "keep", "--holding", "refixture"]] {
        let output = run(ways);
        let said = String::from_utf8(output.stdout).unwrap();
        assert_eq!(output.status.code(), Some(0), "{said}");
        assert!(!said.contains("over the base plane"), "{said}");
        assert!(read_plan(&dir).summary.reuse_final > 0.99, "{said}");
    }
}

#[test]
fn the_setup_is_searched_unless_it_is_to_be_kept() {
    let out = tempfile::tempdir().unwrap();
    let (turned, dir) = (out.path().join("turned.obj"), out.path().join("d"));
    // A quarter turn about z and away from the initial part: without a search nothing fits.
    let target = fs::read_to_string("fixtures/block_bracket_target.obj").unwrap();
    let turn = |line: &str| match line.split_whitespace().collect::<Vec<_>>()[..] {
        ["v", x, y, z] => {
            let [x, y, z] = [x, y, z].map(|c| c.parse::<f64>().unwrap());
            format!("v {} {} {}\n", 300.0 - y, x - 200.0, z + 7.0)
        }
        _ => format!("{line}\n"),
    };
    fs::write(&turned, target.lines().map(turn).collect::<String>()).unwrap();
    let mut command = hmplan();
    command.args(["plan", "fixtures/block_bracket_initial.obj"]).arg(&turned);
    command.args(["--resolution", "1.5", "-o"]).arg(&dir);
    let output = command.output().unwrap();
    let stdout = String::from_utf8(output.stdout).unwrap();
    assert!(matches!(output.status.code(), Some(0 | 2)), "{stdout}");
    assert!(stdout.contains("Setup: "), "{stdout}");
    let file = read_plan(&dir);
    assert_eq!(file.command.setup, "search");
    assert!(file.summary.notes[0].starts_with("Setup: "), "{:?}", file.summary.notes);
    assert!(file.summary.seconds.setup.is_some());
    assert!(file.summary.reuse_initial.unwrap() > 0.9, "{:?}", file.summary);
    let z = file.inputs.target.transform[11];
    assert!((z + 7.0).abs() < 1e-6, "as it stood, on the base: {z}");
    // The plan is judged in the pose that was found, without a search of its own.
    let verified = hmplan().arg("verify").arg(&dir).output().unwrap();
    assert_eq!(verified.status.code(), output.status.code());
}

#[test]
fn a_finishing_allowance_is_printed_cut_off_and_verified_from_the_files() {
    let out = tempfile::tempdir().unwrap();
    let (plain, finished) = (out.path().join("plain"), out.path().join("finished"));
    plan(&plain, &[]).assert().code(0);
    plan(&finished, &["--finish=0.8"]).assert().code(0).stdout(contains("of allowance"));
    let (plain, file) = (read_plan(&plain), read_plan(&finished));
    assert_eq!((plain.command.finish_mm, file.command.finish_mm), (0.0, 0.8));
    // Room for the allowance on every side of the parts.
    assert_eq!(file.grid.dims, plain.grid.dims.map(|n| n + 2));
    // The look on the coarse grid falls otherwise on the wider one.
    assert!((file.summary.reuse_final - plain.summary.reuse_final).abs() < 0.02);
    let last = |f: &PlanFile| f.steps.last().map(|s| s.kind);
    assert_eq!(last(&plain), Some(StepKind::Additive));
    assert_eq!(last(&file), Some(StepKind::Subtractive));
    hmplan().arg("verify").arg(&finished).assert().code(0);
    // More than any grid holds is refused, and no sum overflows.
    refused(&mut plan(&out.path().join("huge"), &["--finish=1e300"]), "voxels");
    // Less room than recorded is another grid.
    let path = finished.join("plan.json");
    let text = fs::read_to_string(&path).unwrap();
    fs::write(&path, text.replace("\"finish_mm\": 0.8", "\"finish_mm\": 0.0")).unwrap();
    hmplan()
        .arg("verify")
        .arg(&finished)
        .assert()
        .code(2)
        .stderr(contains("the grid in plan.json"));
}

#[test]
fn the_initial_part_may_be_laid_on_another_face() {
    let out = tempfile::tempdir().unwrap();
    let (stub, block, dir) =
        (out.path().join("stub.obj"), out.path().join("block.obj"), out.path().join("d"));
    let cuboid = |lo: [f64; 3], hi: [f64; 3], first: usize| {
        let corner = |i: usize, a: usize| if i >> a & 1 == 0 { lo[a] } else { hi[a] };
        let v = (0..8).map(|i| format!("v {} {} {}\n", corner(i, 0), corner(i, 1), corner(i, 2)));
        let faces =
            [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let f = faces.map(|f| f.map(|i| (i + first).to_string()).join(" "));
        v.collect::<String>() + &f.map(|f| format!("f {f}\n")).concat()
    };
    // A block on a stub, and one that only fits into the block.
    let both = cuboid([9.0, 6.0, 0.0], [21.0, 14.0, 10.0], 1)
        + &cuboid([0.0, 0.0, 10.0], [30.0, 20.0, 20.0], 9);
    fs::write(&stub, both).unwrap();
    fs::write(&block, cuboid([0.0; 3], [28.0, 18.0, 9.0], 1)).unwrap();
    let mut command = hmplan();
    command.arg("plan").arg(&stub).arg(&block);
    command.args(["--resolution", PITCH, "--initial-pose", "search", "-o"]).arg(&dir);
    let output = command.output().unwrap();
    let file = read_plan(&dir);
    assert!(file.summary.notes[0].contains("laid on another face"), "{:?}", file.summary.notes);
    assert!(file.summary.reuse_final > 0.95, "{:?}", file.summary);
    let lain = file.inputs.initial.unwrap().transform;
    assert!(lain[10] < -0.99, "the block's face is below: {lain:?}");
    let verified = hmplan().arg("verify").arg(&dir).output().unwrap();
    assert_eq!(verified.status.code(), output.status.code());
}

#[test]
fn a_failed_run_leaves_the_earlier_plan_untouched() {
    let out = tempfile::tempdir().unwrap();
    let dir = out.path().join("d");
    plan(&dir, &["-q"]).assert().code(0);
    let before: Vec<_> = files(&dir).iter().map(|n| fs::read(dir.join(n)).unwrap()).collect();
    let mut failing = hmplan();
    failing.args(["plan", "fixtures/bearing_initial.obj", "no-such.obj", "-o"]).arg(&dir);
    refused(&mut failing, "no-such.obj");
    let after: Vec<_> = files(&dir).iter().map(|n| fs::read(dir.join(n)).unwrap()).collect();
    assert!(before == after);
    assert_eq!(fs::read_dir(out.path()).unwrap().count(), 1, "no litter beside it");
    // A later plan leaves nothing of the earlier one.
    fs::write(dir.join("states/99-additive.stl"), "stale").unwrap();
    plan(&dir, &["-q"]).assert().code(0);
    assert!(!dir.join("states/99-additive.stl").exists());
}

#[test]
fn a_directory_of_something_else_is_refused() {
    let out = tempfile::tempdir().unwrap();
    fs::write(out.path().join("thesis.tex"), "years of work").unwrap();
    refused(&mut plan(out.path(), &[]), "holds no earlier plan");
    assert_eq!(files(out.path()), [Path::new("thesis.tex")]);
}

#[test]
fn verify_fails_after_any_change() {
    let out = tempfile::tempdir().unwrap();
    let dir = out.path().join("d");
    plan(&dir, &["-q"]).assert().code(0);
    let verify = || {
        let output = hmplan().arg("verify").arg(&dir).output().unwrap();
        let text = [output.stdout, output.stderr].concat();
        (output.status.code(), String::from_utf8(text).unwrap())
    };
    let (code, text) = verify();
    assert_eq!(code, Some(0), "{text}");
    for rule in ["content", "tool-access", "support", "stability", "machine", "end", "program"] {
        assert!(text.contains(rule), "{rule} is not in {text}");
    }
    let plan_text = fs::read_to_string(dir.join("plan.json")).unwrap();
    let change = |from: &str, to: &str, words: &str| {
        assert!(plan_text.contains(from), "{from}");
        fs::write(dir.join("plan.json"), plan_text.replacen(from, to, 1)).unwrap();
        let (code, text) = verify();
        fs::write(dir.join("plan.json"), &plan_text).unwrap();
        assert_eq!(code, Some(2), "{from}: {text}");
        assert!(text.contains(words), "'{words}' is not in {text}");
    };
    let file = read_plan(&dir);
    let voxels = file.steps[0].voxels;
    change("\"rows\":[[", "\"rows\":[[1", "region was altered");
    change(&format!("\"voxels\": {voxels}"), &format!("\"voxels\": {}", voxels + 1), "step 1");
    change("\"switches\": ", "\"switches\": 1", "summary.switches");
    change(&file.inputs.target.sha256, &"0".repeat(64), "bearing_target.obj");

    // A tolerance as long as the machine is only looked through as far as there is anything.
    let rule = format!("\"tolerance_mm\": {:?}", file.rules.tolerance_mm);
    for (value, want) in [("10000.0", 0), ("1e100", 1)] {
        assert!(plan_text.contains(&rule), "{rule}");
        let wide = plan_text.replacen(&rule, &format!("\"tolerance_mm\": {value}"), 1);
        fs::write(dir.join("plan.json"), wide).unwrap();
        let (code, text) = verify();
        assert_eq!(code, Some(want), "{value}: {text}");
    }
    fs::write(dir.join("plan.json"), &plan_text).unwrap();

    let program = fs::read_to_string(dir.join("out.gcode")).unwrap();
    let altered = program.replacen("G1 Z", "G1 Z-", 1);
    assert_ne!(program, altered);
    fs::write(dir.join("out.gcode"), &altered).unwrap();
    let (code, text) = verify();
    assert_eq!(code, Some(2), "{text}");
    assert!(text.contains("out.gcode was altered"), "{text}");
    // A forger who mends the digest as well is caught by what the program does.
    let forged = plan_text.replace(&sha256(program.as_bytes()), &sha256(altered.as_bytes()));
    fs::write(dir.join("plan.json"), forged).unwrap();
    let (code, text) = verify();
    assert_eq!(code, Some(2), "{text}");
    assert!(text.contains("FAILED  program-"), "{text}");
}

fn sha256(bytes: &[u8]) -> String {
    use sha2::Digest as _;
    sha2::Sha256::digest(bytes).iter().map(|b| format!("{b:02x}")).collect()
}

#[test]
fn verify_refuses_what_is_no_plan() {
    let out = tempfile::tempdir().unwrap();
    refused(hmplan().arg("verify").arg(out.path()), "plan.json");
    fs::write(out.path().join("plan.json"), "{\"schema\": \"hmplan-plan/9\"}").unwrap();
    refused(hmplan().arg("verify").arg(out.path()), "hmplan-plan/9");
    fs::write(out.path().join("plan.json"), "[".repeat(100_000)).unwrap();
    refused(hmplan().arg("verify").arg(out.path()), "line 1");
}

#[cfg(unix)]
#[test]
fn a_directory_that_cannot_be_made_is_an_io_failure() {
    let out = plan(Path::new("/proc/hmplan/d"), &[]).output().unwrap();
    assert_eq!(out.status.code(), Some(3));
    assert!(String::from_utf8(out.stderr).unwrap().contains("/proc/hmplan"));
}
