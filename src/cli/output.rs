//! The output directory, whole or not at all: everything is written to a sibling, flushed to the
//! disk and swapped in by rename, so that a failed or interrupted run leaves the earlier directory
//! as it was, and no file of an earlier plan survives beside a new one.

use super::exit::Failure;
use hmplan::plan::StepKind;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

pub const PLAN: &str = "plan.json";
pub const PROGRAM: &str = "out.gcode";
pub const REPORT: &str = "report.html";
pub const STATES: &str = "states";
/// One program a step.
pub const PROGRAMS: &str = "programs";
pub const DEVIATION: &str = "deviation.ply";

pub const ANALYSIS: &str = "analysis.json";
pub const COLOURS: &str = "surface.ply";

/// What files of all steps are called.
pub const TOTALS: [&str; 3] = ["reused", "removed", "added"];

/// What files of a step of a kind are called, after its number.
pub fn kind_name(kind: StepKind) -> &'static str {
    match kind {
        StepKind::Subtractive => "subtractive",
        StepKind::Additive => "additive",
    }
}

/// A kind of output directory.
#[derive(Debug)]
pub struct Kind {
    /// What its content is called in messages.
    noun: &'static str,
    /// The file that marks a directory as one of ours.
    marker: &'static str,
    /// Everything at its top.
    ours: &'static [&'static str],
}

const PLAN_DIR: Kind = Kind {
    noun: "plan",
    marker: PLAN,
    ours: &[PLAN, PROGRAM, REPORT, STATES, PROGRAMS, DEVIATION],
};
pub const ANALYSIS_DIR: Kind =
    Kind { noun: "analysis", marker: ANALYSIS, ours: &[ANALYSIS, COLOURS] };

/// A place where an output directory may go.
#[derive(Debug)]
pub struct Destination {
    dir: PathBuf,
    parent: PathBuf,
    name: String,
    kind: &'static Kind,
}

impl Destination {
    /// Checks, before any work, that `dir` may be written or replaced.
    ///
    /// # Errors
    /// Input: it is a file, or holds something other than an earlier plan. I/O: its parent cannot
    /// be made or written.
    pub fn claim(dir: &Path) -> Result<Destination, Failure> {
        Destination::claim_as(dir, &PLAN_DIR)
    }

    /// [`Destination::claim`] for another kind of output.
    pub fn claim_as(dir: &Path, kind: &'static Kind) -> Result<Destination, Failure> {
        refuse_foreign(dir, kind)?;
        let absolute = std::path::absolute(dir).map_err(|e| Failure::writing(dir, &e))?;
        let place = absolute.canonicalize().unwrap_or(absolute);
        let (Some(parent), Some(name)) = (place.parent(), place.file_name()) else {
            return Err(Failure::Input(format!(
                "{} cannot be an output directory; name a directory inside another",
                dir.display()
            )));
        };
        fs::create_dir_all(parent).map_err(|e| Failure::writing(parent, &e))?;
        let destination = Destination {
            parent: parent.to_path_buf(),
            name: name.to_string_lossy().into_owned(),
            dir: place.clone(),
            kind,
        };
        // Better to fail now than after minutes of planning.
        drop(destination.begin()?);
        Ok(destination)
    }

    /// Fails where a file that is asked for besides would be one of the directory's own.
    ///
    /// # Errors
    /// Input.
    pub fn refuse_own(&self, file: &Path) -> Result<(), Failure> {
        let absolute = std::path::absolute(file).map_err(|e| Failure::writing(file, &e))?;
        let folder = absolute.parent().and_then(|p| p.canonicalize().ok());
        let place = match (folder, absolute.file_name()) {
            (Some(folder), Some(name)) => folder.join(name),
            _ => absolute,
        };
        let first = place.strip_prefix(&self.dir).ok().and_then(|p| p.iter().next());
        match first.is_some_and(|f| self.kind.ours.iter().any(|ours| f == *ours)) {
            true => Err(Failure::Input(format!(
                "{} is a file of the {} itself; name another",
                file.display(),
                self.kind.noun
            ))),
            false => Ok(()),
        }
    }

    /// A new, empty directory beside the destination.
    pub fn begin(&self) -> Result<Draft<'_>, Failure> {
        let path = self.sibling("new");
        // Left by a run that was killed; process numbers repeat.
        remove_tree(&path).map_err(|e| Failure::writing(&path, &e))?;
        fs::create_dir(&path).map_err(|e| Failure::writing(&path, &e))?;
        Ok(Draft { destination: self, path })
    }

    fn sibling(&self, role: &str) -> PathBuf {
        self.parent.join(format!(".{}.{role}-{}", self.name, std::process::id()))
    }
}

/// An output directory being written; removed when dropped before [`Draft::publish`].
pub struct Draft<'a> {
    destination: &'a Destination,
    path: PathBuf,
}

impl Drop for Draft<'_> {
    fn drop(&mut self) {
        // After publishing there is nothing here; otherwise the draft is litter.
        let _ = remove_tree(&self.path);
    }
}

impl Draft<'_> {
    /// Writes one file, its bytes on the disk when this returns. `name` is relative to the
    /// directory.
    pub fn write(
        &self,
        name: &str,
        content: impl FnOnce(&mut dyn Write) -> io::Result<()>,
    ) -> Result<(), Failure> {
        let path = self.path.join(name);
        // The message names the place the reader knows, not the draft's.
        let shown = self.destination.dir.join(name);
        let failed = |e: io::Error| Failure::writing(&shown, &e);
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder).map_err(failed)?;
        }
        let mut out = BufWriter::new(File::create(&path).map_err(failed)?);
        content(&mut out).map_err(failed)?;
        let file = out.into_inner().map_err(|e| failed(e.into_error()))?;
        file.sync_all().map_err(failed)
    }

    /// Puts the draft in the place of the destination.
    ///
    /// # Errors
    /// I/O; the earlier directory is then in its place.
    pub fn publish(self) -> Result<(), Failure> {
        let dir = &self.destination.dir;
        let failed = |e: io::Error| Failure::writing(dir, &e);
        // Again: the directory may have changed while the plan was made.
        let kind = self.destination.kind;
        refuse_foreign(dir, kind)?;
        sync_dir(&self.path).map_err(failed)?;
        if dir.exists() {
            exchange(&self.path, dir, &self.destination.sibling("old")).map_err(failed)?;
            keep_foreign(&self.path, dir, kind).map_err(failed)?;
        } else {
            fs::rename(&self.path, dir).map_err(failed)?;
        }
        sync_dir(&self.destination.parent).map_err(failed)
    }
}

/// Fails unless `dir` is absent, empty, or an earlier output.
fn refuse_foreign(dir: &Path, kind: &Kind) -> Result<(), Failure> {
    let entries = match fs::read_dir(dir) {
        Ok(entries) => entries,
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(()),
        Err(e) if e.kind() == io::ErrorKind::NotADirectory => {
            return Err(Failure::Input(format!(
                "{} is a file; name a directory with -o",
                dir.display()
            )));
        }
        Err(e) => return Err(Failure::writing(dir, &e)),
    };
    if entries.count() > 0 && !dir.join(kind.marker).is_file() {
        return Err(Failure::Input(format!(
            "{} is not empty and holds no earlier {}; name another directory with -o",
            dir.display(),
            kind.noun
        )));
    }
    Ok(())
}

/// Swaps two directories: at once where the system can, else by way of `aside`.
fn exchange(new: &Path, dir: &Path, aside: &Path) -> io::Result<()> {
    #[cfg(target_os = "linux")]
    {
        use rustix::fs::{CWD, RenameFlags, renameat_with};
        if renameat_with(CWD, new, CWD, dir, RenameFlags::EXCHANGE).is_ok() {
            return Ok(());
        }
    }
    exchange_by_renames(new, dir, aside)
}

fn exchange_by_renames(new: &Path, dir: &Path, aside: &Path) -> io::Result<()> {
    remove_tree(aside)?;
    fs::rename(dir, aside)?;
    if let Err(e) = fs::rename(new, dir) {
        fs::rename(aside, dir)?;
        return Err(e);
    }
    fs::rename(aside, new)
}

/// Carries over what a person put beside an earlier plan, and into its folders.
fn keep_foreign(old: &Path, dir: &Path, kind: &Kind) -> io::Result<()> {
    for entry in fs::read_dir(old)? {
        let entry = entry?;
        let name = entry.file_name();
        let (from, to) = (old.join(&name), dir.join(&name));
        if !kind.ours.iter().any(|ours| name == *ours) {
            fs::rename(from, to)?;
        } else if entry.file_type()?.is_dir() {
            for inner in fs::read_dir(&from)? {
                let inner = inner?.file_name();
                if !is_of_a_step(&inner.to_string_lossy()) {
                    fs::create_dir_all(&to)?;
                    fs::rename(from.join(&inner), to.join(&inner))?;
                }
            }
        }
    }
    Ok(())
}

/// Whether a file is named as those that are written for a step, or for all: `01-additive.stl`, `reused.stl`.
fn is_of_a_step(name: &str) -> bool {
    let Some((stem, "stl" | "gcode")) = name.rsplit_once('.') else { return false };
    let kinds = [StepKind::Subtractive, StepKind::Additive].map(kind_name);
    let is_number = |n: &str| n.len() >= 2 && n.bytes().all(|b| b.is_ascii_digit());
    match stem.split_once('-') {
        Some((number, kind)) => is_number(number) && kinds.contains(&kind),
        None => TOTALS.contains(&stem),
    }
}

fn remove_tree(path: &Path) -> io::Result<()> {
    match fs::remove_dir_all(path) {
        Err(e) if e.kind() != io::ErrorKind::NotFound => Err(e),
        _ => Ok(()),
    }
}

/// Flushes the names in a directory to the disk.
fn sync_dir(path: &Path) -> io::Result<()> {
    if cfg!(unix) { File::open(path)?.sync_all() } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn publish(dir: &Path, files: &[&str]) {
        let destination = Destination::claim(dir).unwrap();
        let draft = destination.begin().unwrap();
        for name in files {
            draft.write(name, |out| out.write_all(name.as_bytes())).unwrap();
        }
        draft.publish().unwrap();
    }

    fn names(dir: &Path) -> Vec<String> {
        let mut names: Vec<String> = fs::read_dir(dir)
            .unwrap()
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn a_new_plan_replaces_the_old_one_and_keeps_notes() {
        let home = tempfile::tempdir().unwrap();
        let dir = home.path().join("deep/out");
        publish(&dir, &[PLAN, PROGRAM, "states/01-additive.stl"]);
        fs::write(dir.join("notes.txt"), "mine").unwrap();
        publish(&dir, &[PLAN, "states/02-additive.stl"]);
        assert_eq!(names(&dir), ["notes.txt", PLAN, STATES]);
        assert_eq!(names(&dir.join(STATES)), ["02-additive.stl"]);
        assert_eq!(names(&home.path().join("deep")), ["out"], "no litter beside it");
    }

    #[test]
    fn what_a_person_put_among_the_states_is_kept() {
        let home = tempfile::tempdir().unwrap();
        let dir = home.path().join("out");
        publish(&dir, &[PLAN, "states/01-additive.stl", "states/reused.stl"]);
        for mine in ["notes.txt", "01-additive.png", "7-additive.stl", "mine.stl"] {
            fs::write(dir.join(STATES).join(mine), "mine").unwrap();
        }
        publish(&dir, &[PLAN]);
        let kept = ["01-additive.png", "7-additive.stl", "mine.stl", "notes.txt"];
        assert_eq!(names(&dir.join(STATES)), kept);
    }

    #[test]
    fn a_file_beside_is_none_of_the_plan() {
        let home = tempfile::tempdir().unwrap();
        let dir = home.path().join("out");
        publish(&dir, &[PLAN]);
        let destination = Destination::claim(&dir).unwrap();
        for own in [PLAN, PROGRAM, "states/01-additive.stl"] {
            assert_eq!(destination.refuse_own(&dir.join(own)).unwrap_err().exit() as u8, 1);
        }
        destination.refuse_own(&dir.join("schedule.txt")).unwrap();
        destination.refuse_own(&home.path().join(PLAN)).unwrap();
    }

    #[test]
    fn a_draft_that_is_dropped_changes_nothing() {
        let home = tempfile::tempdir().unwrap();
        let dir = home.path().join("out");
        publish(&dir, &[PLAN]);
        let destination = Destination::claim(&dir).unwrap();
        let draft = destination.begin().unwrap();
        let full = |_: &mut dyn Write| Err(io::Error::from(io::ErrorKind::StorageFull));
        let failure = draft.write(REPORT, full).unwrap_err();
        assert!(failure.to_string().contains(REPORT), "{failure}");
        assert_eq!(failure.exit() as u8, 3);
        drop(draft);
        assert_eq!(names(&dir), [PLAN]);
        assert_eq!(names(home.path()), ["out"]);
    }

    #[test]
    fn a_directory_of_something_else_is_refused() {
        let home = tempfile::tempdir().unwrap();
        fs::write(home.path().join("thesis.tex"), "").unwrap();
        let failure = Destination::claim(home.path()).unwrap_err();
        assert_eq!(failure.exit() as u8, 1);
        let file = home.path().join("thesis.tex");
        assert_eq!(Destination::claim(&file).unwrap_err().exit() as u8, 1);
        let below = Destination::claim(&file.join("out")).unwrap_err();
        assert!(matches!(below.exit() as u8, 1 | 3));
    }

    #[test]
    fn the_swap_without_kernel_help_works_too() {
        let home = tempfile::tempdir().unwrap();
        let [a, b] = ["a", "b"].map(|n| home.path().join(n));
        for (dir, word) in [(&a, "new"), (&b, "old")] {
            fs::create_dir(dir).unwrap();
            fs::write(dir.join("f"), word).unwrap();
        }
        exchange_by_renames(&a, &b, &home.path().join("aside")).unwrap();
        assert_eq!(fs::read_to_string(b.join("f")).unwrap(), "new");
        assert_eq!(fs::read_to_string(a.join("f")).unwrap(), "old");
    }
}
