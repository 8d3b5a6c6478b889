//! Tool and machine files: TOML in, checked figures out.
//!
//! Guarantees: every error names the file, the line and column and what is allowed there; unknown
//! keys are refused; every figure is finite and in range. Files above [`LARGEST_FILE`] are
//! refused unread.

use super::process::within;
use super::section::{Flat, Written};
use super::{Chain, InvalidTool, Linear, Machine, Process, Rotary, Table, Taken, Tool, ToolKind};
use schemars::JsonSchema;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use std::fmt::Display;
use std::io::Read;
use std::ops::Range;
use std::path::{Path, PathBuf};
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// Largest tool or machine file, bytes. A profile with a hundred tools has some 50 kB.
pub const LARGEST_FILE: u64 = 1 << 20;

/// Most tools of a machine and most sections of a tool. Real tables hold some tens; a file with
/// tens of thousands would only make every search over them crawl.
const MOST_ENTRIES: usize = 256;

/// Why a tool or machine cannot be had.
#[derive(Debug, thiserror::Error)]
pub enum ProfileError {
    #[error("cannot read {}: {source}", .path.display())]
    Io { path: PathBuf, source: std::io::Error },
    #[error("{} is larger than {limit} bytes; this is no tool or machine file", .path.display())]
    TooLarge { path: PathBuf, limit: u64 },
    #[error("{} is not UTF-8 text; this is no tool or machine file", .path.display())]
    NotText { path: PathBuf },
    #[error("{file}:{line}:{column}: {what}")]
    Invalid { file: String, line: usize, column: usize, what: String },
    #[error("no {kind} is called '{name}'; there are: {}", .known.join(", "))]
    Unknown { kind: &'static str, name: String, known: Vec<&'static str> },
}

/// A figure out of range and where it stands: `kinematics.x.limits_mm`, `tool[2].section[1]`.
#[derive(Debug, PartialEq)]
pub(super) struct BadFigure {
    at: Vec<Step>,
    what: String,
}

#[derive(Clone, Debug, PartialEq)]
enum Step {
    Key(&'static str),
    Index(usize),
}

fn bad(at: &[Step], what: impl Display) -> BadFigure {
    BadFigure { at: at.to_vec(), what: what.to_string() }
}

impl Machine {
    /// Reads and checks a machine file.
    pub fn load(path: &Path) -> Result<Machine, ProfileError> {
        Machine::parse(&path.display().to_string(), &read_text(path)?)
    }

    /// Parses and checks a machine profile; `file` is what errors call it.
    pub fn parse(file: &str, text: &str) -> Result<Machine, ProfileError> {
        let machine: Machine = from_toml(file, text)?;
        machine.find_bad_figure().map_err(|bad| bad.located(file, text))?;
        Ok(machine)
    }

    fn find_bad_figure(&self) -> Result<(), BadFigure> {
        use Step::{Index, Key};
        check_name(&self.name).map_err(|e| bad(&[Key("name")], e))?;
        let holding = |e| bad(&[Key("workholding")], e);
        within("pedestal_mm", self.workholding.pedestal_mm, 0.0, 10_000.0).map_err(holding)?;
        match self.workholding.table {
            Table::Disc { radius_mm } => within("radius_mm", radius_mm, 1.0, 10_000.0),
            Table::Box { x_mm, y_mm } => {
                within("x_mm", x_mm, 1.0, 10_000.0).and(within("y_mm", y_mm, 1.0, 10_000.0))
            }
        }
        .map_err(|e| bad(&[Key("workholding"), Key("table")], e))?;
        self.workholding
            .place_on_table()
            .map_err(|e| bad(&[Key("workholding"), Key("place")], e))?;
        self.kinematics.find_bad_figure()?;
        self.control.validate().map_err(|e| bad(&[Key("control")], e))?;
        if let Some(extruder) = &self.extruder {
            extruder.validate().map_err(|e| bad(&[Key("extruder")], e))?;
        }
        few("tools", self.tools.len()).map_err(|e| bad(&[Key("tool")], e))?;
        for (i, tool) in self.tools.iter().enumerate() {
            let here = [Key("tool"), Index(i)];
            tool.find_bad_figure(&here)?;
            if self.tools[..i].iter().any(|t| t.name == tool.name) {
                let what = format!("two tools are called '{}'; names must differ", tool.name);
                return Err(bad(&[Key("tool"), Index(i), Key("name")], what));
            }
        }
        Ok(())
    }
}

impl Chain {
    fn find_bad_figure(&self) -> Result<(), BadFigure> {
        use Step::Key;
        let here = |key| [Key("kinematics"), Key(key)];
        for value in self.table_center_mm {
            within("table_center_mm", value, -1e5, 1e5)
                .map_err(|e| bad(&here("table_center_mm"), e))?;
        }
        for (key, axis) in [("x", &self.x), ("y", &self.y), ("z", &self.z)] {
            axis.validate().map_err(|e| bad(&here(key), e))?;
        }
        let rotary = [("first", &self.first), ("second", &self.second)];
        for (key, axis) in rotary.into_iter().filter(|(_, r)| !r.is_absent()) {
            axis.validate().map_err(|e| bad(&here(key), e))?;
        }
        if self.first.letter == self.second.letter && !self.first.is_absent() {
            let what = format!("both rotary axes are called {}", self.first.letter);
            return Err(bad(&[Key("kinematics"), Key("second"), Key("letter")], what));
        }
        self.orientable().map_err(|e| bad(&here("second"), e))?;
        self.movable().map_err(|(key, e)| bad(&here(key), e))
    }
}

impl Linear {
    fn validate(&self) -> Result<(), String> {
        ordered("limits_mm", self.limits_mm, 1e5)?;
        within("home_mm", self.home_mm, self.limits_mm[0], self.limits_mm[1])
    }
}

impl Rotary {
    fn validate(&self) -> Result<(), String> {
        if !matches!(self.letter, 'A' | 'B' | 'C') {
            return Err(format!("letter = {:?} must be A, B or C", self.letter));
        }
        for value in self.pivot_mm {
            within("pivot_mm", value, -1e5, 1e5)?;
        }
        let [low, high] = self.limits_deg.unwrap_or([-36_000.0, 36_000.0]);
        ordered("limits_deg", [low, high], 36_000.0)?;
        within("home_deg", self.home_deg, low, high)?;
        within("rapid_deg_min", self.rapid_deg_min, 1e-3, 1e7)
    }
}

fn ordered(key: &str, [low, high]: [f64; 2], largest: f64) -> Result<(), String> {
    within(key, low, -largest, largest)?;
    within(key, high, -largest, largest)?;
    if low < high {
        Ok(())
    } else {
        Err(format!("{key} = [{low}, {high}]: the first must be less than the second"))
    }
}

impl Tool {
    /// Reads and checks a tool file and the meshes it names.
    pub fn load(path: &Path) -> Result<Tool, ProfileError> {
        let (file, text) = (path.display().to_string(), read_text(path)?);
        let written: ToolFile = from_toml(&file, &text)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        written.tool(folder).map_err(|bad| bad.located(&file, &text))
    }

    /// Parses and checks a tool; `file` is what errors call it.
    pub fn parse(file: &str, text: &str) -> Result<Tool, ProfileError> {
        let tool: Tool = from_toml(file, text)?;
        tool.find_bad_figure(&[]).map_err(|bad| bad.located(file, text))?;
        Ok(tool)
    }

    /// The same checks for a tool that was built, not read.
    pub(super) fn checked(self, name: &str) -> Result<Tool, ProfileError> {
        self.find_bad_figure(&[]).map_err(|bad| bad.located(name, ""))?;
        Ok(self)
    }

    fn find_bad_figure(&self, here: &[Step]) -> Result<(), BadFigure> {
        let within_tool = |steps: &[Step]| [here, steps].concat();
        check_name(&self.name).map_err(|e| bad(&within_tool(&[Step::Key("name")]), e))?;
        few("sections", self.sections.len())
            .map_err(|e| bad(&within_tool(&[Step::Key("section")]), e))?;
        self.validate().map_err(|e| {
            let steps = match &e {
                InvalidTool::BadSection { section, .. } => {
                    vec![Step::Key("section"), Step::Index(section.saturating_sub(1))]
                }
                InvalidTool::BadProcess { .. } => vec![Step::Key("process")],
                _ => vec![Step::Key("section")],
            };
            bad(&within_tool(&steps), e)
        })
    }
}

/// A tool as its file says it: sections may be meshes, for which the tool has the solids that they
/// sweep about its axis.
#[derive(Deserialize, JsonSchema)]
#[serde(rename = "Tool", deny_unknown_fields)]
pub struct ToolFile {
    name: String,
    kind: ToolKind,
    #[schemars(with = "Vec<Written>")]
    section: Vec<Flat>,
    /// What it is run with.
    #[serde(default)]
    process: Process,
    #[serde(default)]
    taken: Taken,
}

impl ToolFile {
    fn tool(self, folder: &Path) -> Result<Tool, BadFigure> {
        let at = |i: usize| [Step::Key("section"), Step::Index(i)];
        few("sections", self.section.len()).map_err(|e| bad(&[Step::Key("section")], e))?;
        // Of each section of the tool, the one of the file it comes from.
        let (mut sections, mut from) = (Vec::new(), Vec::new());
        for (i, written) in self.section.iter().enumerate() {
            let own = written.sections(folder).map_err(|e| bad(&at(i), e))?;
            from.extend(own.iter().map(|_| i));
            sections.extend(own);
        }
        let is_mesh: Vec<bool> = self.section.iter().map(Flat::is_mesh).collect();
        let ToolFile { name, kind, process, taken, .. } = self;
        let tool = Tool { name, kind, sections, process, taken };
        // In the words of the file: its own sections, not those that a mesh became.
        if let Err(InvalidTool::BadSection { tool, section, what }) = tool.validate()
            && let Some(own) = from.get(section.saturating_sub(1))
        {
            let section = own + 1;
            return Err(bad(&at(*own), InvalidTool::BadSection { tool, section, what }));
        }
        let top = |i: usize| tool.sections[i].shape.top();
        let topmost = (0..from.len()).max_by(|a, b| top(*a).total_cmp(&top(*b)));
        let is_drawn = topmost.is_some_and(|t| is_mesh[from[t]]);
        if is_drawn && tool.process.gauge_mm.is_none() {
            let what = "the topmost section is a mesh, which does not say where the spindle's nose \
                        is; give process.gauge_mm, its height over the tip";
            return Err(bad(&[Step::Key("section")], what));
        }
        tool.find_bad_figure(&[])?;
        Ok(tool)
    }
}

fn few(what: &str, count: usize) -> Result<(), String> {
    if count <= MOST_ENTRIES {
        return Ok(());
    }
    Err(format!("{count} {what}; give at most {MOST_ENTRIES}"))
}

/// Names go into file names, reports and comments of programs.
fn check_name(name: &str) -> Result<(), String> {
    let plain = name.bytes().all(|b| b.is_ascii_alphanumeric() || b"-_.+".contains(&b));
    if plain && (1..=64).contains(&name.len()) {
        return Ok(());
    }
    let shown: String = name.chars().take(64).collect();
    Err(format!("name = {shown:?} must be 1 to 64 letters, digits, '-', '_', '.' or '+'"))
}

fn read_text(path: &Path) -> Result<String, ProfileError> {
    let io = |source| ProfileError::Io { path: path.into(), source };
    let mut bytes = Vec::new();
    let file = std::fs::File::open(path).map_err(io)?;
    // One byte more than allowed tells a file at the limit from one above it.
    file.take(LARGEST_FILE + 1).read_to_end(&mut bytes).map_err(io)?;
    if bytes.len() as u64 > LARGEST_FILE {
        return Err(ProfileError::TooLarge { path: path.into(), limit: LARGEST_FILE });
    }
    String::from_utf8(bytes).map_err(|_| ProfileError::NotText { path: path.into() })
}

fn from_toml<T: DeserializeOwned>(file: &str, text: &str) -> Result<T, ProfileError> {
    toml::from_str(text).map_err(|e| invalid(file, text, e.span(), e.message().to_string()))
}

/// An error at a byte span of the text; without one, at its beginning.
fn invalid(file: &str, text: &str, span: Option<Range<usize>>, what: String) -> ProfileError {
    let start = span.map_or(0, |s| s.start).min(text.len());
    let before = text.get(..start).unwrap_or("");
    let line = before.matches('\n').count() + 1;
    let column = before.rsplit('\n').next().unwrap_or("").chars().count() + 1;
    ProfileError::Invalid { file: file.into(), line, column, what }
}

impl BadFigure {
    /// The same with the line on which the figure stands, as far as the path leads.
    fn located(self, file: &str, text: &str) -> ProfileError {
        let span = DeTable::parse(text).ok().and_then(|root| {
            let mut span: Option<Range<usize>> = None;
            let mut value: Option<&Spanned<DeValue<'_>>> = None;
            for step in &self.at {
                let next = match (step, value.map(Spanned::get_ref)) {
                    (Step::Key(key), None) => root.get_ref().get(*key),
                    (Step::Key(key), Some(v)) => v.get(*key),
                    (Step::Index(i), Some(v)) => v.get(*i),
                    (Step::Index(_), None) => None,
                };
                let Some(next) = next else { break };
                span = Some(next.span());
                value = Some(next);
            }
            // A message that begins with `key =` belongs on the line of that key.
            let key = self.what.split(" = ").next().unwrap_or("");
            let exact = value.and_then(|v| v.get_ref().get(key)).map(Spanned::span);
            exact.or(span)
        });
        let path = self.at.iter().fold(String::new(), |path, step| match step {
            Step::Key(key) if path.is_empty() => (*key).into(),
            Step::Key(key) => format!("{path}.{key}"),
            Step::Index(i) => format!("{path}[{}]", i + 1),
        });
        invalid(file, text, span, format!("{path}: {}", self.what))
    }
}
#[cfg(test)]
mod tests {
    use super::super::Shape;
    use super::*;
    use crate::base::DVec3;
    use crate::mesh::TriMesh;

    const TOOL: &str = include_str!("presets/w2v-cutter.toml");
    const MACHINE: &str = include_str!("presets/generic-5axis.toml");

    /// Line on which `needle` first stands.
    fn line_of(text: &str, needle: &str) -> usize {
        text[..text.find(needle).unwrap()].matches('\n').count() + 1
    }

    #[test]
    fn a_bad_tool_file_is_answered_with_place_and_remedy() {
        for (good, wrong, says) in [
            (
                "active = true",
                "actve = true",
                "unknown field `actve`, expected one of `shape`, `active`",
            ),
            ("kind", "knd", "unknown field `knd`, expected one of `name`, `kind`"),
            ("\"ball\"", "\"bal\"", "unknown variant `bal`, expected one of `ball`"),
            ("radius = 1.5", "radius = \"x\"", "expected f64"),
            ("radius = 1.5", "radius = nan", "NaN is not a length between"),
            ("section = [", "section = [{ shape = \"ball\", z0 = 3.0 },", "1: key `z0` does not"),
            (
                "section = [",
                "section = [{ shape = \"ball\" },",
                "`radius` is missing; a ball takes",
            ),
            ("z1 = 13.0", "z1 = 1.0", "z1 = 1 must lie above z0 = 1.5"),
            ("name = \"w2v-cutter\"", "name = \"\"", "must be 1 to 64 letters"),
        ] {
            let text = TOOL.replacen(good, wrong, 1);
            let said = Tool::parse("my.toml", &text).unwrap_err().to_string();
            let place = format!("my.toml:{}:", line_of(TOOL, good));
            assert!(said.starts_with(&place) && said.contains(says), "{said}");
        }
    }

    #[test]
    fn a_bad_machine_file_is_answered_with_place_and_remedy() {
        for (good, wrong, says) in [
            ("[control]", "[contrl]", "expected one of `name`, `description`, `workholding`"),
            ("radius_mm", "radus_mm", "unknown field `radus_mm`, expected `radius_mm`"),
            ("radius_mm = 150.0", "radius_mm = 0.0", "radius_mm = 0 must lie between"),
            ("limits_mm = [-400.0, 400.0]", "limits_mm = [1.0]", "invalid length 1"),
            ("[-400.0, 400.0]", "[400.0, -400.0]", "the first must be less than the second"),
            ("[-400.0, 400.0]", "[-inf, 400.0]", "limits_mm = -inf must lie between"),
            ("axis = [-1.0, 0.0, 0.0]", "axis = [0.0, 0.0, 0.0]", "is no direction"),
            ("\"grblhal\"", "\"a b\"", "must be a name of letters"),
            ("step_down", "stepdown", "unknown field `stepdown`, expected one of `gauge_mm`"),
            ("step_down = 0.35", "step_down = -1", "tool[2].process: tool 'ball-3x30'"),
            ("\"ball-3x30\"", "\"ball-3x13\"", "two tools are called 'ball-3x13'"),
        ] {
            let text = MACHINE.replacen(good, wrong, 1);
            let said = Machine::parse("my.toml", &text).unwrap_err().to_string();
            let place = format!("my.toml:{}:", line_of(MACHINE, good));
            assert!(said.starts_with(&place) && said.contains(says), "{said}");
        }
    }

    #[test]
    fn axes_that_cannot_orient_a_tool_are_refused() {
        for (first, second, says) in [
            ("[0.0, 0.0, 1.0]", "[0.0, 0.0, 1.0]", "parallel"),
            ("[0.0, 0.0, 1.0]", "[1.0, 0.0, 0.0]", "never tilts it"),
        ] {
            let text = MACHINE.replacen("axis = [-1.0, 0.0, 0.0]", &format!("axis = {first}"), 1);
            let text = text.replacen("axis = [0.0, 0.0, -1.0]", &format!("axis = {second}"), 1);
            let said = Machine::parse("my.toml", &text).unwrap_err().to_string();
            assert!(said.contains("kinematics.second") && said.contains(says), "{said}");
        }
    }

    #[test]
    fn oversized_missing_and_binary_files_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("tool.toml");
        assert!(matches!(Tool::load(&path), Err(ProfileError::Io { .. })));
        std::fs::write(&path, TOOL).unwrap();
        assert_eq!(Tool::load(&path).unwrap().name, "w2v-cutter");
        std::fs::write(&path, [0xff, 0xfe, 0x00]).unwrap();
        assert!(matches!(Tool::load(&path), Err(ProfileError::NotText { .. })));
        std::fs::write(&path, vec![b'#'; LARGEST_FILE as usize + 1]).unwrap();
        assert!(matches!(Tool::load(&path), Err(ProfileError::TooLarge { .. })));
    }

    /// Square rods as OBJ, each (half its width, lower end, upper end).
    fn rods(sizes: &[[f64; 3]]) -> String {
        let rod = |[half, z0, z1]: &[f64; 3]| {
            TriMesh::cuboid(DVec3::new(-half, -half, *z0), DVec3::new(*half, *half, *z1))
        };
        let mesh = TriMesh::joined(&sizes.iter().map(rod).collect::<Vec<_>>());
        let vertices = mesh.vertices().iter().map(|v| format!("v {} {} {}\n", v.x, v.y, v.z));
        let faces = mesh.triangles().iter().map(|t| t.map(|i| i + 1));
        vertices.chain(faces.map(|[a, b, c]| format!("f {a} {b} {c}\n"))).collect()
    }

    #[test]
    fn a_section_may_be_a_mesh_beside_the_file() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("tool.toml");
        let load = |sections: &str| {
            let text = format!("name = \"t\"\nkind = \"additive\"\nsection = [\n{sections}]\n");
            std::fs::write(&path, text).unwrap();
            Tool::load(&path)
        };
        let (rod, head) = ([1.0, 0.0, 30.0], [4.0, 30.0, 50.0]);
        let text = rods(&[rod]);
        let whole = text.trim_end().rsplit_once('\n').map_or("", |lines| lines.0);
        for (name, text) in
            [("rod.obj", &text[..]), ("open.obj", whole), ("stepped.obj", &rods(&[rod, head]))]
        {
            std::fs::write(dir.path().join(name), text).unwrap();
        }
        let head = "{ shape = \"platform\", z = 30.0 }";
        let tool = load(&format!("{{ shape = \"mesh\", file = \"rod.obj\" }},\n{head}")).unwrap();
        let r = 2.0_f64.sqrt();
        assert_eq!(tool.sections[0].shape, Shape::Frustum { z0: 0.0, r0: r, z1: 30.0, r1: r });
        assert_eq!((tool.sections.len(), tool.gauge_mm()), (2, 30.0));
        for (sections, line, says) in [
            ("{ shape = \"mesh\" },\n", 4, "key `file` is missing"),
            ("{ shape = \"mesh\", file = \"rod.obj\", z = 1.0 },\n", 4, "takes file, and nothing"),
            ("{ shape = \"platform\", z = 0.0, file = \"a\" },\n", 4, "`file` does not belong"),
            ("{ shape = \"mesh\", file = \"open.obj\" },\n", 4, "not closed"),
            ("{ shape = \"mesh\", file = \"none.obj\" },\n", 4, "none.obj"),
            (
                "{ shape = \"mesh\", file = \"rod.obj\", active = true },\n",
                4,
                "an edge is drawn as",
            ),
            ("{ shape = \"mesh\", file = \"rod.obj\" },\n", 3, "give process.gauge_mm"),
            // The second section of the file, though the third of the tool.
            (
                "{ shape = \"mesh\", file = \"stepped.obj\" },\n{ shape = \"ball\", radius = -1.0 },\n",
                5,
                "section 2: -1 is not a length",
            ),
        ] {
            let said = load(sections).unwrap_err().to_string();
            assert!(said.contains(&format!("tool.toml:{line}:")) && said.contains(says), "{said}");
        }
        let text = MACHINE.replacen(
            "{ shape = \"ball\"",
            "{ shape = \"mesh\", file = \"rod.obj\" }, { shape = \"ball\"",
            1,
        );
        let said = Machine::parse("my.toml", &text).unwrap_err().to_string();
        assert!(said.contains("a tool file of its own"), "{said}");
    }

    #[test]
    fn endless_tables_are_refused() {
        let platform = "[[section]]\nshape = \"platform\"\nz = 0.0\n";
        let text = format!("name = \"t\"\nkind = \"additive\"\n{}", platform.repeat(257));
        let said = Tool::parse("my.toml", &text).unwrap_err().to_string();
        assert!(said.contains("section: 257 sections; give at most 256"), "{said}");
    }

    #[test]
    fn deep_nesting_and_empty_texts_are_errors() {
        for text in ["", "section = ", &"[".repeat(100_000), &"a.".repeat(50_000)] {
            assert!(Tool::parse("f", text).is_err() && Machine::parse("f", text).is_err());
        }
    }
}
