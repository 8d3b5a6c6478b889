//! From part files to solids on one grid: read, place, voxelise. Planning and checking share it,
//! so that a plan is checked against the same solids it was made for.

use super::config::PartConfig;
use super::exit::Failure;
use hmplan::base::{Aabb, Ctx, DAffine3, DVec3};
use hmplan::machine::{Holding, HoldingMode, Taken, Tool, VOXELS_PER_RADIUS};
use hmplan::mesh::{self, Health, ReadOptions, TriMesh};
use hmplan::plan::{Input, Job};
use hmplan::voxel::{BitGrid, Frame, blocks, parse_voxel_text, voxelise};
use std::path::Path;

/// A part as read: mesh in mm, axes of its file, and what the plan file records of it.
pub struct Part {
    pub mesh: TriMesh,
    pub record: Input,
    /// Of voxel text: its voxels, of `mm_per_unit` each, the first at the origin of the part.
    voxels: Option<BitGrid>,
}

/// Bytes of the largest voxel text: the 2³¹ voxels a grid may have take no more than twice that.
const LARGEST_TEXT: u64 = 1 << 32;

/// Whether a part is voxel text, by its name.
pub fn is_voxel_text(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("txt"))
}

/// Reads voxel text as a part of voxels of `pitch` mm.
fn read_voxel_text(name: &str, open: &Path, pitch: f64) -> Result<Part, Failure> {
    use std::io::Read as _;
    let failed = |e: std::io::Error| Failure::Input(format!("{name} cannot be read ({e})"));
    let mut bytes = Vec::new();
    let file = std::fs::File::open(open).map_err(failed)?;
    file.take(LARGEST_TEXT).read_to_end(&mut bytes).map_err(failed)?;
    let sha256 = super::plan::digest(&bytes);
    let text = String::from_utf8(bytes)
        .map_err(|_| Failure::Input(format!("{name}: is no voxel text")))?;
    let voxels = parse_voxel_text(&text).map_err(|e| Failure::Input(format!("{name}: {e}")))?;
    let frame = Frame { pitch, dims: voxels.dims(), origin: DVec3::ZERO };
    let mesh = blocks(&voxels, &frame).map_err(|e| Failure::Input(format!("{name}: {e}")))?;
    Ok(Part {
        record: Input {
            path: name.to_string(),
            sha256,
            triangles: mesh.triangles().len(),
            watertight: true,
            volume_mm3: mesh.signed_volume(),
            mm_per_unit: pitch,
            transform: Input::rows_of(&DAffine3::IDENTITY),
            warnings: Vec::new(),
        },
        mesh,
        voxels: Some(voxels),
    })
}

/// Reads the part at `open`, recorded under the name `path`.
pub fn read(path: &Path, open: &Path, mm_per_unit: f64) -> Result<Part, Failure> {
    let Some(name) = path.to_str() else {
        return Err(Failure::Input(format!(
            "{}: the name is not valid UTF-8 and cannot be recorded in a plan; rename the file",
            path.display()
        )));
    };
    if is_voxel_text(path) {
        return read_voxel_text(name, open, mm_per_unit);
    }
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
        voxels: None,
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

/// Turns up axes to z; then, as `keep` means it, one shift for all that puts the first part's
/// lowest point on the base plane.
pub fn stand(parts: &mut [(&mut Part, super::args::Axis)]) -> Result<(), Failure> {
    for (part, up) in parts.iter_mut() {
        part.place(&DAffine3::from_mat3(up.to_z()));
    }
    let Some((first, _)) = parts.first() else { return Ok(()) };
    let floor = first.placed()?.bounds().min.z;
    let shift = DAffine3::from_translation(DVec3::new(0.0, 0.0, -floor));
    for (part, up) in parts.iter_mut() {
        part.place(&(shift * DAffine3::from_mat3(up.to_z())));
    }
    Ok(())
}

/// Voxels a default grid aims at.
const DEFAULT_VOXELS: f64 = 8e6;
/// Voxels to spare around the parts, so that every surface has an outside on the grid.
const MARGIN: usize = 1;

/// The pitch when none is asked for: about [`DEFAULT_VOXELS`] in the box of both parts, and never
/// above a third of the smallest tool's radius, below which a tool is no longer round; only tools
/// that always take part count. Whole micrometres, rounded down.
pub fn default_pitch(bounds: &Aabb, tools: &[Tool]) -> f64 {
    let s = bounds.size();
    let by_count = (s.x * s.y * s.z / DEFAULT_VOXELS).cbrt();
    let pitch = tools
        .iter()
        .filter(|t| t.taken == Taken::Always)
        .map(|t| t.tip_radius() / VOXELS_PER_RADIUS)
        .fold(by_count, f64::min);
    ((pitch * 1000.0).floor() / 1000.0).max(0.001)
}

/// The grid that holds both parts, with so many millimetres to spare around them.
pub fn frame(
    initial: Option<&TriMesh>,
    target: &TriMesh,
    pitch: Option<f64>,
    tools: &[Tool],
    spare_mm: f64,
) -> Result<Frame, Failure> {
    let target = target.bounds();
    let bounds = initial.map_or(target, |i| i.bounds().union(target));
    let pitch = pitch.unwrap_or_else(|| default_pitch(&bounds, tools));
    // A spare no grid can hold saturates, and the frame refuses it.
    let margin = MARGIN.saturating_add((spare_mm / pitch).ceil() as usize);
    Frame::around(bounds, pitch, margin).map_err(Failure::input)
}

/// One part as a solid.
///
/// # Errors
/// A part of which no voxel's centre is inside.
pub fn solid(part: &Part, placed: &TriMesh, frame: &Frame, ctx: &Ctx) -> Result<BitGrid, Failure> {
    let grid = match (&part.voxels, part.record.plan_from_part()) {
        (Some(voxels), Some(motion)) => stamped(voxels, part.record.mm_per_unit, &motion, frame),
        _ => voxelise(placed, frame, ctx)?,
    };
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

/// Voxels moved onto a grid: solid where the centre of one comes to lie.
fn stamped(voxels: &BitGrid, pitch: f64, motion: &DAffine3, frame: &Frame) -> BitGrid {
    let own = Frame { pitch, dims: voxels.dims(), origin: DVec3::ZERO };
    let mut grid = BitGrid::new(frame.dims);
    for v in voxels.iter_ones() {
        if let Some(at) = frame.voxel_at(motion.transform_point3(own.center(v))) {
            grid.set(at, true);
        }
    }
    grid
}

/// Both parts on one grid.
pub struct Grids {
    pub frame: Frame,
    /// Empty without an initial part.
    pub initial: BitGrid,
    pub target: BitGrid,
    pub target_mesh: TriMesh,
}

impl Grids {
    /// The parts where they were placed.
    pub fn of(
        initial: Option<&(Part, TriMesh)>,
        target: &Part,
        pitch: Option<f64>,
        tools: &[Tool],
        spare_mm: f64,
        ctx: &Ctx,
    ) -> Result<Grids, Failure> {
        let target_mesh = target.placed()?;
        let frame = frame(initial.map(|i| &i.1), &target_mesh, pitch, tools, spare_mm)?;
        let initial = initial.map(|(part, mesh)| solid(part, mesh, &frame, ctx)).transpose()?;
        let target = solid(target, &target_mesh, &frame, ctx)?;
        let initial = initial.unwrap_or_else(|| BitGrid::new(frame.dims));
        Ok(Grids { frame, initial, target, target_mesh })
    }
}

/// How far the lowest voxel of a solid is above the base plane, mm; 0 when it stands on it.
pub fn gap_mm(solid: &BitGrid, frame: &Frame) -> f64 {
    let bottom = |v: [usize; 3]| frame.center(v).z - frame.pitch / 2.0;
    let gap = solid.extent().map_or(0.0, |(low, _)| bottom(low));
    (gap / frame.pitch).round().max(0.0) * frame.pitch
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

/// How far the target stands over the base plane, in words; nothing when it touches it, or is held anew.
pub fn above_base(job: &Job) -> Option<String> {
    let Job { frame, rules, .. } = job;
    let contact = Holding::AS_CLAMPED.contact(&job.target, frame, rules.grip_mm);
    let floats = contact.is_empty() && rules.holding == HoldingMode::Base;
    (floats && !job.target.is_empty()).then(|| {
        format!(
            "The target stands {:.1} mm over the base plane: as clamped nothing would hold it in the end, so nothing \
             of the initial part can be kept; lower it in its file, or use --setup search or --holding refixture.",
            gap_mm(&job.target, frame)
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
