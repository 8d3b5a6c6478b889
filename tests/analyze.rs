//! `hmplan analyze` from outside: what it prints, what it writes, what it refuses.

use assert_cmd::Command;
use hmplan::base::{Ctx, DVec2, DVec3, Direction};
use hmplan::machine::Tool;
use hmplan::mesh::{ReadOptions, read};
use hmplan::voxel::{BitGrid, Frame, voxelise};
use predicates::prelude::*;
use predicates::str::contains;
use rayon::prelude::*;
use std::fs;
use std::path::Path;

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

/// Voxels outside a solid that the edge of a tool touches from some tip of a lattice of spacing
/// `step` mm, by the definition: no obstacle point lies within the tool. The body is `by` mm wider
/// and the edge as much narrower; the voxels are asked `hair` mm lower than they are.
fn by_definition(
    (frame, solid): (&Frame, &BitGrid),
    tool: &Tool,
    direction: Direction,
    [step, by, hair]: [f64; 3],
) -> usize {
    let plane = direction.image_plane();
    let place = |p: DVec3| (plane.across(p), plane.height(p));
    let points: Vec<(DVec2, f64)> =
        solid.boundary().iter_ones().map(|v| place(frame.center(v))).collect();
    let anchor = plane.across(frame.center([0, 0, 0]));
    let n = (tool.active_radius() / step).ceil() as i64 + 1;
    let touches = |v: [usize; 3]| {
        let (uv, height) = place(frame.center(v));
        let near = ((uv - anchor) / step).round();
        (-n..=n).flat_map(|j| (-n..=n).map(move |i| DVec2::new(i as f64, j as f64))).any(|o| {
            let tip = anchor + (near + o) * step;
            let k = tool.active_lower_surface(tip.distance(uv) + by);
            let z = height - hair - k;
            let free = |(o, top): &(DVec2, f64)| {
                *top <= z + tool.lower_surface((tip.distance(*o) - by).max(0.0)) + 1e-9
            };
            k.is_finite() && points.iter().all(free)
        })
    };
    let air = BitGrid::from_fn(frame.dims, |v| !solid.get(v));
    air.iter_ones().par_bridge().filter(|v| touches(*v)).count()
}

/// Runs `hmplan analyze` and asks the definition about every `stride`-th of its directions. Both
/// bounds, in voxels, summed with what was reached between them: the lower one says something only
/// of an edge that is wider than the bound.
fn confirm(path: &Path, name: &str, pitch: f64, more: &[&str], stride: usize) -> [usize; 3] {
    let mut command = hmplan();
    command.arg("analyze").arg(path).args(["--tool", name, "--json", "--resolution"]);
    let output = command.arg(pitch.to_string()).args(more).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let record: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let frame: Frame = serde_json::from_value(record["grid"].clone()).unwrap();
    let mesh = read(path, &ReadOptions { mm_per_unit: 1.0 }).unwrap().mesh;
    let solid = voxelise(&mesh, &frame, &Ctx::quiet()).unwrap();
    let voxels = |mm3: &serde_json::Value| (mm3.as_f64().unwrap() / frame.voxel_volume()).round();
    assert_eq!(voxels(&record["part_mm3"]) as usize, solid.count());
    let tool = Tool::builtin(name).unwrap();
    let (h, part) = (frame.pitch, (&frame, &solid));
    let mut sums = [0; 3];
    for told in record["directions"].as_array().unwrap().iter().step_by(stride) {
        let direction: Direction = serde_json::from_value(told["direction"].clone()).unwrap();
        let reached = voxels(&told["accessible_mm3"]) as usize;
        // On the axes the definition itself; elsewhere within the bound, on the safe side.
        let (step, by) =
            if direction.is_grid_axis() { (h, 0.0) } else { (h / 2.0, h / 2f64.sqrt() + 1e-6) };
        let fine = if by == 0.0 { step } else { step / 2.0 };
        let least = by_definition(part, &tool, direction, [fine, by, 1e-3]);
        let most = by_definition(part, &tool, direction, [step, 0.0, 0.0]);
        assert!((least..=most).contains(&reached), "{direction:?}: {least} {reached} {most}");
        sums.iter_mut().zip([least, reached, most]).for_each(|(s, n)| *s += n);
    }
    sums
}

#[test]
fn the_definition_confirms_the_regions_of_a_made_part() {
    let part = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/bearing_initial.obj");
    for direction in ["0,0,1", "-1,0,0", "0.31,-0.42,0.85"] {
        let [least, _, _] = confirm(&part, "long-cutter", 3.5, &["--direction", direction], 1);
        assert!(least > 0, "the bound says nothing of {direction}");
    }
}

#[test]
fn the_definition_confirms_the_regions_of_a_bracket_from_a_hundred_directions() {
    let part = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/meshes/ge_bracket.stl");
    if !part.exists() {
        println!("skipped: {} is not there", part.display());
        return;
    }
    let [_, reached, most] = confirm(&part, "w2v-cutter", 4.0, &["--directions", "100"], 25);
    assert!(reached > 0 && reached <= most, "{reached} {most}");
}
