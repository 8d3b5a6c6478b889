//! A Python environment with the reference libraries, made once under `target/`.
//!
//! Method: under a file lock, `python3 -m venv` and `pip install -r requirements.txt`; a copy of
//! the requirements is written last, so that a half-made environment is made anew. Where Python
//! came without ensurepip, the environment is made without pip and the system's pip fills it.
//!
//! Guarantees: safe under tests that run at once, in one process or several. Not guaranteed: that
//! somebody who edits the environment by hand is noticed.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::Command;

/// Set to 1 to do without the reference checks.
pub const SKIP_VARIABLE: &str = "HMPLAN_SKIP_REFERENCE";

const REQUIREMENTS: &str = "tests/reference/requirements.txt";

/// Whether the user asked to do without the reference checks.
pub fn is_skipped() -> bool {
    std::env::var_os(SKIP_VARIABLE).is_some_and(|v| v == "1")
}

/// Runs a script of `tests/reference/` and gives what it prints.
pub fn run(script: &str, arguments: &[&Path]) -> Result<String, String> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut command = Command::new(ready_python(root)?);
    command.arg(root.join("tests/reference").join(script)).args(arguments);
    output_of(&mut command)
}

/// The interpreter of an environment that holds the requirements.
fn ready_python(root: &Path) -> Result<PathBuf, String> {
    let requirements = root.join(REQUIREMENTS);
    let wanted = fs::read_to_string(&requirements).map_err(|e| format!("{REQUIREMENTS}: {e}"))?;
    let tmp = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let target = tmp.parent().expect("cargo's temporary folder lies in its target folder");
    let environment = target.join("reference-venv");
    let lock = File::create(target.join("reference-venv.lock")).map_err(|e| e.to_string())?;
    lock.lock().map_err(|e| format!("reference-venv.lock: {e}"))?; // held until dropped

    let python = environment.join("bin").join("python3");
    let stamp = environment.join("requirements.installed");
    let is_installed = fs::read_to_string(&stamp).is_ok_and(|have| have == wanted);
    // An interpreter that was upgraded or removed leaves a broken link behind.
    if !is_installed || output_of(Command::new(&python).arg("--version")).is_err() {
        if environment.exists() {
            fs::remove_dir_all(&environment).map_err(|e| e.to_string())?;
        }
        make(&environment, &python, &requirements).map_err(|why| mend(&why))?;
        fs::write(&stamp, wanted).map_err(|e| e.to_string())?;
    }
    Ok(python)
}

/// Makes the environment and installs the requirements in it.
fn make(environment: &Path, python: &Path, requirements: &Path) -> Result<(), String> {
    let venv = |options: &[&str]| {
        output_of(Command::new("python3").args(["-m", "venv"]).args(options).arg(environment))
    };
    let mut pip = Command::new(python);
    pip.args(["-m", "pip"]);
    if let Err(why) = venv(&[]) {
        // Debian's python3 has no ensurepip; its pip can fill an environment from outside.
        venv(&["--without-pip", "--clear"]).map_err(|e| format!("{why}\n{e}"))?;
        pip = Command::new("python3");
        pip.args(["-m", "pip", "--python"]).arg(python);
        output_of(Command::new("python3").args(["-m", "pip", "--version"]))
            .map_err(|e| format!("{why}\n{e}"))?;
    }
    pip.args(["install", "--quiet", "--disable-pip-version-check", "-r"]).arg(requirements);
    output_of(&mut pip).map(drop)
}

/// Standard output of a command that succeeds; otherwise what was run and what it said.
fn output_of(command: &mut Command) -> Result<String, String> {
    let output = command.output().map_err(|e| format!("{command:?}: {e}"))?;
    let said = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    if output.status.success() {
        Ok(said(&output.stdout))
    } else {
        let (out, err) = (said(&output.stdout), said(&output.stderr));
        Err(format!("{command:?} failed ({}):\n{out}{err}", output.status))
    }
}

fn mend(why: &str) -> String {
    format!(
        "{why}\nThe reference checks need Python 3.11 or later with venv and pip, and the packages \
         of {REQUIREMENTS} from a package index. Mend: install them (Debian: `apt install python3 \
         python3-venv`) and see that pip reaches its index; or set {SKIP_VARIABLE}=1 to do without \
         these checks."
    )
}
