//! `hmplan analyze` from outside: what it prints, what it writes, what it refuses.

use assert_cmd::Command;
use predicates::prelude::*;
use predicates::str::contains;
use std::fs;

fn hmplan() -> Command {
    let mut command = Command::cargo_bin("hmplan").unwrap();
    command.current_dir(env!("CARGO_MANIFEST_DIR"));
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

/// `hmplan analyze` on the bearing, coarse.
fn analyze(more: &[&str]) -> Command {
    let mut command = hmplan();
    command.args(["analyze", "fixtures/bearing_initial.obj", "--resolution", "1.0"]).args(more);
    command
}

#[test]
fn analyze_tells_regions_and_paints_the_surface() {
    let home = tempfile::tempdir().unwrap();
    let dir = home.path().join("a");
    let mut command = analyze(&["--tool", "w2v-cutter", "--directions", "12", "--json", "-o"]);
    let output = command.arg(&dir).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let record: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let figure = |name: &str| record[name].as_f64().unwrap();
    let grid: f64 =
        record["grid"]["dims"].as_array().unwrap().iter().map(|n| n.as_f64().unwrap()).product();
    let sum = figure("part_mm3") + figure("accessible_mm3") + figure("inaccessible_mm3");
    assert!((sum - grid).abs() < 1e-6 * grid, "regions make up the grid: {sum} {grid}");
    let directions = record["directions"].as_array().unwrap();
    assert_eq!(directions.len(), 12);
    let new: f64 = directions.iter().map(|d| d["new_mm3"].as_f64().unwrap()).sum();
    assert!((new - figure("accessible_mm3")).abs() < 1e-6 * grid);
    assert!(figure("accessible_surface_mm2") <= figure("surface_mm2"));
    let ply = hmplan::mesh::read(
        &dir.join("surface.ply"),
        &hmplan::mesh::ReadOptions { mm_per_unit: 1.0 },
    )
    .unwrap();
    assert!((ply.mesh.area() - figure("surface_mm2")).abs() < 1e-3 * figure("surface_mm2"));
    // The record on the disk is the same at any number of threads.
    let again = home.path().join("b");
    let mut command =
        analyze(&["--tool", "w2v-cutter", "--directions", "12", "--threads", "1", "-q", "-o"]);
    let output = command.arg(&again).output().unwrap();
    assert!(output.status.success() && output.stdout.is_empty());
    for name in ["analysis.json", "surface.ply"] {
        assert_eq!(
            fs::read(dir.join(name)).unwrap(),
            fs::read(again.join(name)).unwrap(),
            "{name}"
        );
    }
}

#[test]
fn analyze_takes_one_direction_and_mesh_tools() {
    let home = tempfile::tempdir().unwrap();
    let block = |name: &str, lo: [f64; 3], hi: [f64; 3]| {
        let path = home.path().join(name);
        let cuboid = hmplan::mesh::TriMesh::cuboid(lo.into(), hi.into());
        hmplan::mesh::write_stl(&cuboid, fs::File::create(&path).unwrap()).unwrap();
        path.into_os_string().into_string().unwrap()
    };
    let active = block("active.stl", [-1.6, -1.6, -0.1], [1.6, 1.6, 12.0]);
    let passive = block("passive.stl", [-8.0, -5.0, 12.0], [8.0, 5.0, 40.0]);
    for direction in ["0,0,1", "-1,0,0.4"] {
        analyze(&["--tool", &active, "--tool-passive", &passive, "--direction", direction])
            .assert()
            .success()
            .stdout(contains("accessible").and(contains("collateral")));
        analyze(&["--tool", "w2v-nozzle", "--direction", direction, "-q"]).assert().success();
    }
    refused(&mut analyze(&["--tool", "w2v-cutter", "--tool-passive", &passive]), "--tool-passive");
}

#[test]
fn analyze_refuses_with_one_message() {
    refused(&mut analyze(&["--tool", "no-such-tool"]), "no-such-tool");
    refused(&mut analyze(&["--tool", "w2v-cutter", "--direction", "0,0"]), "--direction 0,0");
    refused(&mut analyze(&["--tool", "w2v-cutter", "--direction", "0,0,0"]), "no direction");
    refused(&mut analyze(&["--tool", "w2v-cutter", "--overhang", "75"]), "75");
    refused(&mut analyze(&["--tool", "missing.stl"]), "missing.stl");
    let file = tempfile::NamedTempFile::new().unwrap();
    let path = file.path().to_str().unwrap();
    refused(&mut analyze(&["--tool", "w2v-cutter", "-o", path]), path);
    let home = tempfile::tempdir().unwrap();
    fs::write(home.path().join("thesis.tex"), "mine").unwrap();
    let dir = home.path().to_str().unwrap();
    refused(&mut analyze(&["--tool", "w2v-cutter", "-o", dir]), "no earlier analysis");
}
