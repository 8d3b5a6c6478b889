//! The Python libraries on the same voxels.

use super::scene::Part;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

const REQUIREMENTS: &str = "tests/bench/requirements.txt";

/// What `peers.py` prints of a part.
pub fn run(part: &Part) -> Result<String, String> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let python = environment(root)?;
    let [nx, ny, nz] = part.frame.dims;
    let mut bytes = vec![0u8; nx * ny * nz];
    for [x, y, z] in part.solid.iter_ones() {
        bytes[x + nx * (y + ny * z)] = 1;
    }
    let file = root.join("target/bench-part.u8");
    fs::write(&file, bytes).map_err(|e| format!("{}: {e}", file.display()))?;
    let mut command = Command::new(python);
    command.arg(root.join("tests/bench/peers.py")).arg(&file).arg(&part.name);
    command.args([nx, ny, nz].map(|n| n.to_string()));
    output_of(&mut command)
}

/// An interpreter with the requirements, made once under `target/`.
fn environment(root: &Path) -> Result<PathBuf, String> {
    let venv = root.join("target/bench-venv");
    let python = venv.join("bin/python3");
    let stamp = venv.join("requirements.installed");
    let wanted = fs::read_to_string(root.join(REQUIREMENTS)).map_err(|e| e.to_string())?;
    if fs::read_to_string(&stamp).is_ok_and(|have| have == wanted) {
        return Ok(python);
    }
    let venv_text = venv.to_string_lossy().into_owned();
    output_of(Command::new("python3").args([
        "-m",
        "venv",
        "--without-pip",
        "--clear",
        &venv_text,
    ]))?;
    let python_text = python.to_string_lossy().into_owned();
    output_of(
        Command::new("python3")
            .args(["-m", "pip", "--python", &python_text, "install", "--quiet", "-r"])
            .arg(root.join(REQUIREMENTS)),
    )?;
    fs::write(&stamp, wanted).map_err(|e| e.to_string())?;
    Ok(python)
}

fn output_of(command: &mut Command) -> Result<String, String> {
    let output = command.output().map_err(|e| format!("{command:?}: {e}"))?;
    if output.status.success() {
        return Ok(String::from_utf8_lossy(&output.stdout).into_owned());
    }
    Err(format!("{command:?}: {}", String::from_utf8_lossy(&output.stderr)))
}
