//! `hmplan analyze`: what a tool reaches of the space around a part, and what stands by itself.

use super::analysis::{self, Analysis};
use super::args::{AnalyzeArgs, OutputArgs};
use super::exit::{Exit, Failure};
use super::inputs::{self, Part};
use super::output::{ANALYSIS_DIR, Destination};
use super::paint::{self, Paint};
use super::{plan, print, profiles};
use hmplan::access::{self, AnyTool, MeshTool, Overhang};
use hmplan::base::{Ctx, DAffine3, DVec3, Direction, fibonacci_sphere};
use hmplan::machine::{Machine, Tool};
use hmplan::mesh;
use hmplan::voxel::{BitGrid, Frame, surface};
use std::path::Path;
use std::time::Instant;

/// Extensions of mesh files; a tool of any other name is a preset or a TOML file.
const MESHES: [&str; 5] = ["obj", "stl", "ply", "off", "3mf"];

/// A mesh tool goes through the transform, which takes seconds on a full grid: its default pitch
/// is this many times that of a round tool.
const MESH_PITCH_FACTOR: f64 = 2.0;

pub fn run(args: &AnalyzeArgs, output: &OutputArgs) -> Result<Exit, Failure> {
    let began = Instant::now();
    let directions = directions(args)?;
    let overhang = Overhang::degrees(args.overhang).map_err(Failure::input)?;
    let tool = ToolChoice::read(args)?;
    let destination =
        args.output.as_deref().map(|dir| Destination::claim_as(dir, &ANALYSIS_DIR)).transpose()?;
    let ctx = plan::context(output, None, 0)?;

    let mm = args.unit.mm() * args.scale;
    let mut part = inputs::read(&args.part, &args.part, mm)?;
    for warning in &part.record.warnings {
        tracing::warn!("{}: {warning}", args.part.display());
    }
    part.place(&DAffine3::from_mat3(args.up.to_z()));
    let placed = part.placed()?;
    let pitch = args.resolution.unwrap_or_else(|| tool.default_pitch(&placed));
    let frame = inputs::frame(None, &placed, Some(pitch), &[], 0.0)?;
    let solid = inputs::solid(&part, &placed, &frame, &ctx)?;
    let tool = tool.at_pitch(pitch)?;
    let analysis = analyse(&part, &frame, &solid, &tool, &directions, overhang, &ctx)?;
    if let Some(destination) = &destination {
        analysis::write(destination, &analysis, tool.name(), &ctx)?;
    }
    let record = analysis.record(tool.name(), began.elapsed().as_secs_f64());
    if output.json {
        let text = serde_json::to_string(&record).map_err(|e| Failure::Io(e.to_string()))?;
        print(format!("{text}\n").as_bytes())
    } else if output.quiet {
        Ok(Exit::Done)
    } else {
        print(analysis::table(&record).as_bytes())
    }
}

fn directions(args: &AnalyzeArgs) -> Result<Vec<Direction>, Failure> {
    match (&args.direction, args.directions) {
        (Some(text), _) => Ok(vec![parse_direction(text)?]),
        (None, Some(n)) => Ok(fibonacci_sphere(n as usize)),
        (None, None) => Ok(vec![Direction::Z]),
    }
}

fn parse_direction(text: &str) -> Result<Direction, Failure> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|c| c.trim().parse().ok()).collect();
    let Some([x, y, z]) = numbers.as_deref().and_then(|n| <[f64; 3]>::try_from(n).ok()) else {
        return Err(Failure::Input(format!(
            "--direction {text}: give three numbers with commas, such as 0,0,1"
        )));
    };
    Direction::new(DVec3::new(x, y, z))
        .map_err(|e| Failure::Input(format!("--direction {text}: {e}")))
}

/// A tool whose voxels may wait for the pitch.
enum ToolChoice {
    Round(Box<Tool>),
    VoxelSized(String),
    Mesh(String, Box<MeshTool>),
}

/// A tool and the name it goes by.
struct NamedTool {
    name: String,
    tool: AnyTool,
}

impl NamedTool {
    fn name(&self) -> &str {
        &self.name
    }
}

impl ToolChoice {
    fn read(args: &AnalyzeArgs) -> Result<ToolChoice, Failure> {
        let is_mesh = |path: &str| {
            let extension = Path::new(path).extension().and_then(|e| e.to_str());
            extension.is_some_and(|e| MESHES.iter().any(|m| m.eq_ignore_ascii_case(e)))
        };
        if is_mesh(&args.tool) {
            let read = |path: &Path| {
                let options = mesh::ReadOptions { mm_per_unit: 1.0 };
                mesh::read(path, &options).map(|m| m.mesh).map_err(Failure::input)
            };
            let active = read(Path::new(&args.tool))?;
            let passive = args.tool_passive.as_deref().map(read).transpose()?;
            return Ok(ToolChoice::Mesh(args.tool.clone(), Box::new(MeshTool { active, passive })));
        }
        if let Some(passive) = &args.tool_passive {
            return Err(Failure::Input(format!(
                "--tool-passive {}: goes with a --tool that is a mesh; {} is none",
                passive.display(),
                args.tool
            )));
        }
        if Tool::is_voxel_sized(&args.tool) {
            return Ok(ToolChoice::VoxelSized(args.tool.clone()));
        }
        let machine = Machine::builtin(Machine::DEFAULT).map_err(Failure::input)?;
        Ok(ToolChoice::Round(Box::new(profiles::find_tool(&machine, &args.tool)?)))
    }

    fn default_pitch(&self, part: &mesh::TriMesh) -> f64 {
        match self {
            ToolChoice::Round(tool) => {
                inputs::default_pitch(&part.bounds(), std::slice::from_ref(tool))
            }
            ToolChoice::VoxelSized(_) => inputs::default_pitch(&part.bounds(), &[]),
            ToolChoice::Mesh(..) => MESH_PITCH_FACTOR * inputs::default_pitch(&part.bounds(), &[]),
        }
    }

    fn at_pitch(self, pitch: f64) -> Result<NamedTool, Failure> {
        Ok(match self {
            ToolChoice::Round(tool) => {
                NamedTool { name: tool.name.clone(), tool: AnyTool::Round(*tool) }
            }
            ToolChoice::VoxelSized(name) => {
                let tool = Tool::builtin_for_pitch(&name, pitch).map_err(Failure::input)?;
                NamedTool { name, tool: AnyTool::Round(tool) }
            }
            ToolChoice::Mesh(name, tool) => NamedTool { name, tool: AnyTool::Mesh(*tool) },
        })
    }
}

fn analyse<'a>(
    part: &'a Part,
    frame: &Frame,
    solid: &'a BitGrid,
    tool: &NamedTool,
    directions: &[Direction],
    overhang: Overhang,
    ctx: &Ctx,
) -> Result<Analysis<'a>, Failure> {
    let surface = surface(solid, frame).map_err(Failure::input)?;
    let probes = paint::probes(&surface, solid, frame);
    let survey = access::survey(frame, solid, &tool.tool, directions, &probes.outside, ctx)
        .map_err(stopped)?;
    // Of the first among equals: the list decides, not chance.
    let best = survey.reaches.iter().rev().max_by_key(|r| r.voxels);
    let best = best.map_or(Direction::Z, |r| r.direction);
    let damage = access::damage(frame, solid, &tool.tool, best, ctx).map_err(stopped)?;
    // Parts are printed along the direction asked for, and along z where there are many.
    let build = if directions.len() == 1 { directions[0] } else { Direction::Z };
    let support = access::support_along(solid, frame, build, overhang);
    ctx.check()?;
    let paint = Paint::of(&surface, &probes, &survey, &damage, solid, frame, build, overhang);
    Ok(Analysis {
        part,
        frame: *frame,
        solid,
        surface,
        paint,
        survey,
        best,
        damage,
        build,
        support,
    })
}

/// Stopped by the user is no fault of the input.
fn stopped(e: access::MeshToolError) -> Failure {
    match e {
        access::MeshToolError::Cancelled(_) => Failure::Interrupted,
        e => Failure::input(e),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_are_three_numbers() {
        assert_eq!(parse_direction("0, 0,-2").unwrap(), Direction::NEG_Z);
        for bad in ["", "1,2", "a,b,c", "0,0,0", "1,2,3,4", "inf,0,0", "nan,1,1"] {
            assert_eq!(parse_direction(bad).unwrap_err().exit(), Exit::Input, "{bad}");
        }
    }
}
