//! What a whole plan's program leaves on the target's surface.

use std::path::PathBuf;
use std::process::Command;

/// The note of a plan with `--deviation`, as its figures.
fn measured(pair: &str, resolution: &str) -> Vec<f64> {
    let fixtures = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("fixtures");
    let dir = tempfile::tempdir().unwrap();
    let out = Command::new(env!("CARGO_BIN_EXE_hmplan"))
        .args(["plan", "--setup", "keep", "--deviation", "--resolution", resolution, "-o"])
        .arg(dir.path().join("out"))
        .arg(fixtures.join(format!("{pair}_initial.obj")))
        .arg(fixtures.join(format!("{pair}_target.obj")))
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&out.stdout).into_owned();
    assert_eq!(out.status.code(), Some(0), "{text}{}", String::from_utf8_lossy(&out.stderr));
    let note = text.lines().find(|l| l.contains("Deviation of the program")).expect("a note");
    let words = note.split([' ', '(', ')', ';', ',']);
    words.filter_map(|w| w.parse().ok()).collect()
}

#[test]
fn machined_surfaces_are_neither_gouged_nor_left_thick() {
    // Shares in per cent, depths in mm: gouged, 0.05, deepest, left, most, out of reach, beads.
    let found = measured("cross", "0.3");
    let [gouged, limit, deepest, left, most, _, outside] = found[..] else { panic!("{found:?}") };
    assert_eq!((gouged, limit), (0.0, 0.05), "{found:?}");
    assert!(deepest <= 0.05 && outside <= 0.5, "{found:?}");
    // Nothing more than roughing's 0.2 mm is left.
    assert!(left == 0.0 && most <= 0.2, "{found:?}");
}

/// In the corner of a gap hardly wider than its cutter, cells' own tips went 0.23 mm into its roof.
#[test]
fn a_narrow_gap_is_not_gouged_by_more_than_a_nick() {
    let found = measured("staircase", "0.3");
    let [gouged, _, deepest, left, ..] = found[..] else { panic!("{found:?}") };
    assert!(gouged == 0.0 && deepest <= 0.1 && left == 0.0, "{found:?}");
}

/// With this machine's cutters a hundred voxels of a crease are left to tips of their own; for as many there were none, and
/// the program was refused.
#[test]
fn a_crease_of_which_a_hundred_voxels_are_left_gets_a_program() {
    plans(&["--machine", "mx220"], "block_bracket_initial.obj", "block_bracket_target.obj");
}

/// The needle was Ø 1.4 mm: along the walls of the flange's bore it left a film a voxel thicker than the skin, which
/// nothing reached later. 117 mm³ were missing.
#[test]
fn a_deep_bore_is_filled_up_to_its_walls() {
    plans(&[], "flange_initial.obj", "blade_target.obj");
}

/// A pair of fixtures gets a plan that leaves nothing, and a program.
fn plans(options: &[&str], initial: &str, target: &str) {
    let fixtures = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("fixtures");
    let dir = tempfile::tempdir().unwrap();
    let out = Command::new(env!("CARGO_BIN_EXE_hmplan"))
        .args(["plan", "--setup", "keep"])
        .args(options)
        .arg("-o")
        .arg(dir.path().join("out"))
        .args([fixtures.join(initial), fixtures.join(target)])
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&out.stdout).into_owned();
    assert_eq!(out.status.code(), Some(0), "{text}{}", String::from_utf8_lossy(&out.stderr));
    assert!(dir.path().join("out/out.gcode").is_file());
}
