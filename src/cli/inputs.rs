//! From part files to solids on one grid: read, place, voxelise. Planning and checking share it,
//! so that a plan is checked against the same solids it was made for.

use super::config::PartConfig;
use super::exit::Failure;
use hmplan::base::{Aabb, Ctx, DAffine3, DVec3};
use hmplan::machine::Tool;
use hmplan::mesh::{self, Health, ReadOptions, TriMesh};
use hmplan::plan::{Input, Job};
use hmplan::voxel::{BitGrid, Frame, voxelise};
use std::path::Path;

/// A part as read: mesh in mm, axes of its file, and what the plan file records of it.
pub struct Part {
    pub mesh: TriMesh,
    pub record: Input,
}

/// Reads the part at `open`, recorded under the name `path`.
pub fn read(path: &Path, open: &Path, mm_per_unit: f64) -> Result<Part, Failure> {
    let Some(name) = path.to_str() else {
        return Err(Failure::Input(format!(
            "{}: the name is not valid UTF-8 and cannot be recorded in a plan; rename the file",
            path.display()
        )));
    };
    let loaded = mesh::read(open, &ReadOptions { mm_per_unit }).map_err(Failure::input)?;
    let health = Health::of(&loaded.mesh);
    let warnings: Vec<String> = health.warnings();
    Ok(Part {
        record: Input {
            path: name.to_string(),
            sha256: loaded.sha256,
            triangles: loaded.mesh.triangles().len(),
            watertight: health.watertight,
            volume_mm3: loaded.mesh.signed_volume(),
            mm_per_unit,
            transform: Input::rows_of(&DAffine3::IDENTITY),
            warnings,
        },
        mesh: loaded.mesh,
    })
}

impl Part {
    pub fn read(config: &PartConfig) -> Result<Part, Failure> {
        read(&config.path, &config.path, config.mm_per_unit)
    }

    /// Moves the part and records the motion.
    pub fn place(&mut self, plan_from_part: &DAffine3) {
        self.record.transform = Input::rows_of(plan_from_part);
    }

    /// The mesh in plan coordinates, by the recorded motion.
    pub fn placed(&self) -> Result<TriMesh, Failure> {
        let name = &self.record.path;
        let Some(motion) = self.record.plan_from_part() else {
            return Err(Failure::Input(format!("{name}: its placement is no rigid motion")));
        };
        self.mesh
            .transformed(&motion)
            .map_err(|e| Failure::Input(format!("{name}: {e}; check --unit and --scale")))
    }
}

/// Turns up axes to z; then, as `keep` means it, one shift for both that puts the initial part's
/// lowest point on the base plane.
pub fn stand(
    initial: &mut Part,
    up: [super::args::Axis; 2],
    target: &mut Part,
) -> Result<(), Failure> {
    initial.place(&DAffine3::from_mat3(up[0].to_z()));
    let floor = initial.placed()?.bounds().min.z;
    let shift = DAffine3::from_translation(DVec3::new(0.0, 0.0, -floor));
    initial.place(&(shift * DAffine3::from_mat3(up[0].to_z())));
    target.place(&(shift * DAffine3::from_mat3(up[1].to_z())));
    Ok(())
}

/// Voxels a default grid aims at.
const DEFAULT_VOXELS: f64 = 8e6;
/// Voxels to spare around the parts, so that every surface has an outside on the grid.
const MARGIN: usize = 1;

/// The pitch when none is asked for: about [`DEFAULT_VOXELS`] in the box of both parts, and never
/// above a third of the smallest tool's radius, below which a tool is no longer round. Whole
/// micrometres, rounded down.
pub fn default_pitch(bounds: &Aabb, tools: &[Tool]) -> f64 {
    let s = bounds.size();
    let by_count = (s.x * s.y * s.z / DEFAULT_VOXELS).cbrt();
    let pitch = tools.iter().map(|t| t.tip_radius() / 3.0).fold(by_count, f64::min);
    ((pitch * 1000.0).floor() / 1000.0).max(0.001)
}

/// The grid that holds both parts.
pub fn frame(parts: [&TriMesh; 2], pitch: Option<f64>, tools: &[Tool]) -> Result<Frame, Failure> {
    let bounds = parts[0].bounds().union(parts[1].bounds());
    let pitch = pitch.unwrap_or_else(|| default_pitch(&bounds, tools));
    Frame::around(bounds, pitch, MARGIN).map_err(Failure::input)
}

/// One part as a solid.
///
/// # Errors
/// A part of which no voxel's centre is inside.
pub fn solid(part: &Part, placed: &TriMesh, frame: &Frame, ctx: &Ctx) -> Result<BitGrid, Failure> {
    let grid = voxelise(placed, frame, ctx)?;
    if grid.is_empty() {
        let s = placed.bounds().size();
        return Err(Failure::Input(format!(
            "{}: no voxel of {} mm lies inside the part, which is {:.3} × {:.3} × {:.3} mm; set a \
             finer --resolution, check --unit, or close the mesh",
            part.record.path, frame.pitch, s.x, s.y, s.z
        )));
    }
    Ok(grid)
}

/// How far the target reaches below the base plane, in words; nothing when it does not.
pub fn below_base(job: &Job) -> Option<String> {
    let lowest = job.target.iter_ones().map(|v| job.frame.center(v).z).fold(f64::MAX, f64::min);
    (lowest < 0.0).then(|| {
        format!(
            "The target reaches {:.1} mm below the base plane, where pedestal and table are; \
             raise it in its file or use --setup search.",
            -lowest + job.frame.pitch / 2.0
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_pitch_obeys_both_bounds() {
        let cube = |side: f64| Aabb { min: DVec3::ZERO, max: DVec3::splat(side) };
        let tools = [Tool::builtin("w2v-cutter").expect("a preset")];
        assert_eq!(default_pitch(&cube(20.0), &tools), 0.1);
        assert_eq!(default_pitch(&cube(1000.0), &tools), 0.5);
        assert_eq!(default_pitch(&cube(1e-9), &tools), 0.001, "never zero");
    }
}
