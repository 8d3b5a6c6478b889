use super::file::ProfileError;
use super::process::Process;
use super::tool::{Section, Shape, Taken};
use super::{Machine, Tool, ToolKind};

macro_rules! presets {
    ($($name:literal),* $(,)?) => {
        &[$(($name, include_str!(concat!("presets/", $name, ".toml")))),*]
    };
}

const MACHINES: &[(&str, &str)] = presets!["generic-5axis", "mx220", "5xm600"];

const TOOLS: &[(&str, &str)] = presets![
    "w2v-cutter",
    "w2v-nozzle",
    "vasco-cutter",
    "vasco-nozzle",
    "long-cutter",
    "long-nozzle",
];

/// Presets whose figures are voxels, so that they depend on the pitch.
const VOXEL_TOOLS: [&str; 2] = ["inv-cutter", "inv-nozzle"];

/// Length of `inv-cutter` in voxels (INV's L).
pub const INV_LENGTH_VOXELS: u32 = 10;

impl Machine {
    /// The machine a plan is made for when none is named.
    pub const DEFAULT: &'static str = "generic-5axis";

    /// Names of the built-in machines, the default first.
    pub fn builtin_names() -> Vec<&'static str> {
        MACHINES.iter().map(|(name, _)| *name).collect()
    }

    /// A built-in machine.
    pub fn builtin(name: &str) -> Result<Machine, ProfileError> {
        match MACHINES.iter().find(|(known, _)| *known == name) {
            Some((name, text)) => Machine::parse(name, text),
            None => Err(ProfileError::Unknown {
                kind: "machine",
                name: name.into(),
                known: Machine::builtin_names(),
            }),
        }
    }

    /// A built-in machine, or one from a file when no built-in one has this name.
    pub fn named_or_load(name_or_path: &str) -> Result<Machine, ProfileError> {
        named_or_load(name_or_path, Machine::builtin, Machine::load)
    }
}

impl Tool {
    /// Names of the built-in tools.
    pub fn builtin_names() -> Vec<&'static str> {
        TOOLS.iter().map(|(name, _)| *name).chain(VOXEL_TOOLS).collect()
    }

    /// A built-in tool; the two that are as wide as a voxel for a pitch of 1 mm.
    pub fn builtin(name: &str) -> Result<Tool, ProfileError> {
        Tool::builtin_for_pitch(name, 1.0)
    }

    /// A built-in tool for a grid of `pitch_mm`; only `inv-cutter` and `inv-nozzle` depend on it.
    pub fn builtin_for_pitch(name: &str, pitch_mm: f64) -> Result<Tool, ProfileError> {
        match name {
            "inv-cutter" => {
                return Tool::inv_cutter(pitch_mm, INV_LENGTH_VOXELS).checked("inv-cutter");
            }
            "inv-nozzle" => return Tool::inv_nozzle(pitch_mm).checked("inv-nozzle"),
            _ => {}
        }
        match TOOLS.iter().find(|(known, _)| *known == name) {
            Some((name, text)) => Tool::parse(name, text),
            None => Err(ProfileError::Unknown {
                kind: "tool",
                name: name.into(),
                known: Tool::builtin_names(),
            }),
        }
    }

    /// A built-in tool, or one from a file when no built-in one has this name.
    pub fn named_or_load(name_or_path: &str) -> Result<Tool, ProfileError> {
        named_or_load(name_or_path, Tool::builtin, Tool::load)
    }

    /// Whether a built-in tool's figures are voxels: build it with [`Tool::builtin_for_pitch`].
    pub fn is_voxel_sized(name: &str) -> bool {
        VOXEL_TOOLS.contains(&name)
    }

    /// INV's cutter (Def. 2.4): one voxel wide, `length_voxels` long, a half-space beyond. Its tip
    /// stands at a voxel's centre; what is `length_voxels` above that voxel collides, hence the
    /// half-space begins half a voxel below those centres.
    pub fn inv_cutter(pitch_mm: f64, length_voxels: u32) -> Tool {
        let radius = pitch_mm / 2.0;
        let length = pitch_mm * (f64::from(length_voxels.max(1)) - 0.5);
        let edge = Shape::Frustum { z0: 0.0, r0: radius, z1: length, r1: radius };
        Tool {
            name: "inv-cutter".into(),
            kind: ToolKind::Subtractive,
            sections: vec![
                Section { shape: edge, active: true },
                Section { shape: Shape::Platform { z: length }, active: false },
            ],
            process: voxel_process(pitch_mm),
            taken: Taken::Always,
        }
    }

    /// INV's nozzle (Def. 2.3): nothing solid may stand higher than the deposited voxel, anywhere.
    /// Its tip stands at that voxel's centre, its half-space begins at the voxel's upper face.
    pub fn inv_nozzle(pitch_mm: f64) -> Tool {
        let half = pitch_mm / 2.0;
        let bead = Shape::Frustum { z0: 0.0, r0: half, z1: half, r1: half };
        Tool {
            name: "inv-nozzle".into(),
            kind: ToolKind::Additive,
            sections: vec![
                Section { shape: bead, active: false },
                Section { shape: Shape::Platform { z: half }, active: false },
            ],
            process: voxel_process(pitch_mm),
            taken: Taken::Always,
        }
    }
}

/// One voxel a pass and a bead as high and wide as a voxel.
fn voxel_process(pitch_mm: f64) -> Process {
    Process {
        step_down: 1.0,
        step_over: 1.0,
        stock_to_leave_mm: 0.0,
        layer_mm: pitch_mm,
        path_mm: pitch_mm,
        infill: 1.0,
        ..Process::default()
    }
}

fn named_or_load<T>(
    name_or_path: &str,
    builtin: impl Fn(&str) -> Result<T, ProfileError>,
    load: impl Fn(&std::path::Path) -> Result<T, ProfileError>,
) -> Result<T, ProfileError> {
    let path = std::path::Path::new(name_or_path);
    match builtin(name_or_path) {
        // A bare misspelt name is more useful answered with the names there are.
        Err(ProfileError::Unknown { .. }) if path.exists() || looks_like_path(name_or_path) => {
            load(path)
        }
        found => found,
    }
}

fn looks_like_path(text: &str) -> bool {
    text.contains(['/', '\\']) || text.ends_with(".toml")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_preset_loads_and_survives_a_round_trip() {
        for name in Machine::builtin_names() {
            let machine = Machine::builtin(name).unwrap();
            assert_eq!(machine.name, name);
            let text = toml::to_string(&machine).unwrap();
            assert_eq!(Machine::parse("again", &text).unwrap(), machine);
        }
        for name in Tool::builtin_names() {
            let tool = Tool::builtin(name).unwrap();
            assert_eq!(tool.name, name);
            let text = toml::to_string(&tool).unwrap();
            assert_eq!(Tool::parse("again", &text).unwrap(), tool);
            assert_eq!(tool.validate(), Ok(()));
        }
    }

    #[test]
    fn presets_obey_the_published_schemas() {
        let machine = serde_json::to_value(schemars::schema_for!(Machine)).unwrap();
        let tool = serde_json::to_value(schemars::schema_for!(Tool)).unwrap();
        let (machine, tool) = (
            jsonschema::validator_for(&machine).unwrap(),
            jsonschema::validator_for(&tool).unwrap(),
        );
        for (name, text) in MACHINES.iter().chain(TOOLS) {
            let value: serde_json::Value = toml::from_str(text).unwrap();
            let is_tool = TOOLS.iter().any(|(n, _)| n == name);
            let found = if is_tool { tool.validate(&value) } else { machine.validate(&value) };
            assert!(found.is_ok(), "{name}: {}", found.unwrap_err());
            let wrong = text.replacen("radius = 1.5", "radios = 1.5", 1);
            let value: serde_json::Value = toml::from_str(&wrong).unwrap();
            if wrong != *text {
                assert!(!if is_tool { tool.is_valid(&value) } else { machine.is_valid(&value) });
            }
        }
    }

    #[test]
    fn the_papers_tools_have_the_papers_figures() {
        let tool = |name| Tool::builtin(name).unwrap();
        // (radius from the axis, height of the lower surface there)
        for (name, surface) in [
            ("w2v-cutter", [(1.5, 1.5), (1.6, 13.0), (25.0, 13.0), (25.1, 43.0), (1e6, 43.0)]),
            ("w2v-nozzle", [(2.0, 0.0), (2.1, 5.0), (4.5, 5.0), (4.6, 10.0), (1e6, 10.0)]),
            ("vasco-cutter", [(1.5, 1.5), (1.6, 26.5), (25.0, 26.5), (25.1, 56.5), (1e6, 56.5)]),
            ("vasco-nozzle", [(1.0, 0.0), (2.75, 12.5), (4.5, 20.0), (4.6, 20.0), (1e6, 20.0)]),
            ("long-cutter", [(3.0, 3.0), (3.1, 60.0), (16.0, 60.0), (16.1, 120.0), (40.0, 120.0)]),
            ("long-nozzle", [(2.0, 0.0), (2.1, 5.0), (4.5, 5.0), (4.6, 30.0), (25.0, 30.0)]),
        ] {
            for (rho, height) in surface {
                assert_eq!(tool(name).lower_surface(rho), height, "{name} at {rho}");
            }
        }
        assert_eq!(tool("long-cutter").lower_surface(40.1), f64::INFINITY);
        assert_eq!(tool("long-nozzle").lower_surface(25.1), f64::INFINITY);
    }

    #[test]
    fn voxel_tools_hold_exactly_the_voxels_of_the_definition() {
        let pitch = 0.7;
        let cutter = Tool::builtin_for_pitch("inv-cutter", pitch).unwrap();
        let nozzle = Tool::builtin_for_pitch("inv-nozzle", pitch).unwrap();
        for across in 0..4 {
            for up in 1..30 {
                let (rho, z) = (pitch * f64::from(across), pitch * f64::from(up));
                let in_cutter = across == 0 || up >= INV_LENGTH_VOXELS;
                assert_eq!(cutter.contains(rho, z), in_cutter, "{across} {up}");
                assert!(nozzle.contains(rho, z));
            }
            let beside = pitch * f64::from(across + 1);
            assert!(!cutter.contains(beside, 0.0) && !nozzle.contains(beside, 0.0));
        }
        for pitch in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            for name in VOXEL_TOOLS {
                assert!(Tool::builtin_for_pitch(name, pitch).is_err());
            }
        }
    }

    #[test]
    fn machine_tables_have_finite_heads_and_keep_the_presets_figures() {
        for name in Machine::builtin_names() {
            let machine = Machine::builtin(name).unwrap();
            assert!(machine.tools_of(ToolKind::Subtractive).len() >= 3);
            assert!(machine.tools_of(ToolKind::Additive).len() >= 2);
            for tool in &machine.tools {
                assert!(tool.sections.iter().all(|s| s.shape.max_radius().is_finite()));
                if let Ok(preset) = Tool::builtin(&tool.name) {
                    assert_eq!(tool.sections, preset.sections, "{name}: {}", tool.name);
                }
            }
        }
    }

    #[test]
    fn an_unknown_name_is_answered_with_the_names_there_are() {
        let said = Machine::named_or_load("mx221").unwrap_err().to_string();
        assert!(said.contains("'mx221'") && said.contains("mx220"), "{said}");
        let said = Tool::named_or_load("./none.toml").unwrap_err().to_string();
        assert!(said.contains("cannot read ./none.toml"), "{said}");
    }
}
