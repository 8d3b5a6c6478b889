//! What a tool reaches of the space around a part from a list of directions.
//!
//! Directions are looked at in parallel, as many at once as there are threads, so that no more
//! regions are held than that; what each adds is counted in the order of the list.

use super::{Engine, MeshTool, MeshToolError, Scene, accessible, choose, collateral};
use super::{VoxelTool, reached_along};
use crate::base::{Ctx, Direction};
use crate::machine::{Tool, ToolKind};
use crate::morph::{Window, complement};
use crate::voxel::{BitGrid, Frame, coarsened, refined};
use rayon::prelude::*;

/// A tool to look with.
#[derive(Clone, Debug)]
pub enum AnyTool {
    /// Axisymmetric, by the depth engine.
    Round(Tool),
    /// Of any shape, by voxels.
    Mesh(MeshTool),
}

/// What one direction reaches.
#[derive(Clone, Debug, PartialEq)]
pub struct Reach {
    pub direction: Direction,
    /// Voxels of the grid outside the part.
    pub voxels: usize,
    /// Those that no direction before it in the list reaches.
    pub new_voxels: usize,
    /// Of the probed voxels those that it reaches.
    pub probes: Vec<u32>,
}

/// The outcome of a survey.
pub struct Survey {
    pub reaches: Vec<Reach>,
    /// What any of the directions reaches.
    pub accessible: BitGrid,
}

/// A ∖ O of one direction.
pub fn reached(
    frame: &Frame,
    part: &BitGrid,
    tool: &AnyTool,
    direction: Direction,
    ctx: &Ctx,
) -> Result<BitGrid, MeshToolError> {
    match tool {
        AnyTool::Round(tool) => {
            let scene = Scene::new(frame, part, &[]);
            Ok(reached_along(&scene, part, tool, direction))
        }
        AnyTool::Mesh(tool) => {
            let tool = tool.along(direction, frame.pitch, ctx)?;
            let engine = match choose(part.dims(), &tool).engine {
                // A mesh ends where it ends, so its columns have tops.
                Engine::Depth | Engine::Naive => Engine::Fft,
                engine => engine,
            };
            let mut found = accessible(engine, part, &tool);
            found.subtract(part);
            Ok(found)
        }
    }
}

/// Looks at a part from every direction. `probes` are voxels about which each direction is asked
/// singly.
///
/// # Errors
/// [`MeshToolError`]: stopped by the user, or a mesh tool that fits no grid.
pub fn survey(
    frame: &Frame,
    part: &BitGrid,
    tool: &AnyTool,
    directions: &[Direction],
    probes: &[[usize; 3]],
    ctx: &Ctx,
) -> Result<Survey, MeshToolError> {
    ctx.begin("directions", directions.len() as u64);
    let result = survey_batches(frame, part, tool, directions, probes, ctx);
    ctx.end();
    result
}

fn survey_batches(
    frame: &Frame,
    part: &BitGrid,
    tool: &AnyTool,
    directions: &[Direction],
    probes: &[[usize; 3]],
    ctx: &Ctx,
) -> Result<Survey, MeshToolError> {
    let scene = Scene::new(frame, part, &[]);
    let mut survey = Survey { reaches: Vec::new(), accessible: BitGrid::new(part.dims()) };
    for batch in directions.chunks(rayon::current_num_threads().max(1)) {
        let regions: Vec<Result<BitGrid, MeshToolError>> = batch
            .par_iter()
            .map(|d| {
                ctx.check()?;
                let region = match tool {
                    AnyTool::Round(tool) => reached_along(&scene, part, tool, *d),
                    AnyTool::Mesh(_) => reached(frame, part, tool, *d, ctx)?,
                };
                ctx.advance(1);
                Ok(region)
            })
            .collect();
        for (direction, region) in batch.iter().zip(regions) {
            let region = region?;
            let voxels = region.count();
            let new_voxels = voxels - region.count_and(&survey.accessible);
            let seen = (0u32..).zip(probes).filter(|(_, p)| region.get(**p)).map(|(i, _)| i);
            let probes = seen.collect();
            survey.accessible.union_with(&region);
            survey.reaches.push(Reach { direction: *direction, voxels, new_voxels, probes });
        }
    }
    Ok(survey)
}

/// Most voxels of the grid on which collateral along a grid axis is found.
const AXIS_VOXELS: usize = 1_000_000;
/// The same along another direction, where a platform is no plane of the grid and the transform
/// spans twice the grid along each axis.
const TILTED_VOXELS: usize = 150_000;

/// Collateral of reaching everything from one direction, and the pitch at which it was found.
pub struct Damage {
    pub region: BitGrid,
    pub pitch: f64,
}

/// What of the part must go so that the tool reaches all the space around it from `direction`.
/// Found on a grid coarse enough for the transform; a coarse voxel is solid when half of it is.
///
/// # Errors
/// As [`survey`]; and a round tool none of whose edge is as wide as a coarse voxel.
pub fn damage(
    frame: &Frame,
    part: &BitGrid,
    tool: &AnyTool,
    direction: Direction,
    ctx: &Ctx,
) -> Result<Damage, MeshToolError> {
    let most = if direction.is_grid_axis() { AXIS_VOXELS } else { TILTED_VOXELS };
    let mut factor = 1;
    while frame.coarsened(factor).voxel_count() > most {
        factor += 1;
    }
    ctx.begin("collateral", 0);
    let found = damage_at(frame, part, tool, direction, factor, ctx);
    ctx.end();
    found
}

fn damage_at(
    frame: &Frame,
    part: &BitGrid,
    tool: &AnyTool,
    direction: Direction,
    factor: usize,
    ctx: &Ctx,
) -> Result<Damage, MeshToolError> {
    let coarse = frame.coarsened(factor);
    let solid = coarsened(part, factor, factor.pow(3).div_ceil(2));
    let mut blocked = complement(&solid);
    blocked.subtract(&reached(&coarse, &solid, tool, direction, ctx)?);
    let voxels = match tool {
        AnyTool::Mesh(tool) => tool.along(direction, coarse.pitch, ctx)?,
        AnyTool::Round(tool) if direction.is_grid_axis() => match tool.kind {
            ToolKind::Subtractive => VoxelTool::along(tool, direction, coarse.pitch)?,
            ToolKind::Additive => VoxelTool::depositing(tool, direction, coarse.pitch)?,
        },
        AnyTool::Round(tool) => {
            let n = coarse.dims.map(|n| n as i64);
            let within = Window { lo: n.map(|n| -n), hi: n.map(|n| n + 1) };
            VoxelTool::turned(tool, direction, coarse.pitch, 0.0, &within).with_tip()
        }
    };
    let hit = collateral(&solid, &blocked, &voxels, ctx)?;
    let mut region = refined(&hit.region, factor, part.dims());
    region.intersect_with(part);
    Ok(Damage { region, pitch: coarse.pitch })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::{DVec3, fibonacci_sphere};

    fn pocket() -> (Frame, BitGrid) {
        let frame = Frame { pitch: 0.5, dims: [40, 36, 30], origin: DVec3::ZERO };
        let part = BitGrid::from_fn(frame.dims, |[x, y, z]| {
            let body = (2..38).contains(&x) && (2..34).contains(&y) && z < 24;
            let pocket = (10..24).contains(&x) && (9..25).contains(&y) && z > 7;
            body && !pocket
        });
        (frame, part)
    }

    #[test]
    fn directions_add_up_whatever_the_threads() {
        let (frame, part) = pocket();
        let tool = AnyTool::Round(Tool::builtin("w2v-cutter").unwrap());
        let directions = fibonacci_sphere(9);
        let probes = [[16, 16, 10], [0, 0, 0]];
        let run = || survey(&frame, &part, &tool, &directions, &probes, &Ctx::quiet()).unwrap();
        let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap().install(run);
        let three = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap().install(run);
        assert_eq!(one.reaches, three.reaches);
        assert_eq!(one.accessible, three.accessible);
        let added: usize = one.reaches.iter().map(|r| r.new_voxels).sum();
        assert_eq!(added, one.accessible.count());
        assert!(!one.accessible.intersects(&part));
        assert!(one.reaches[0].probes.contains(&0), "the pocket opens upward");
        assert!(!one.reaches[8].probes.contains(&0), "and not downward");
    }

    #[test]
    fn a_pocket_from_below_costs_its_floor_at_least() {
        let (frame, part) = pocket();
        let tool = AnyTool::Round(Tool::builtin("w2v-cutter").unwrap());
        let ctx = Ctx::quiet();
        let above = damage(&frame, &part, &tool, Direction::Z, &ctx).unwrap();
        let below = damage(&frame, &part, &tool, Direction::NEG_Z, &ctx).unwrap();
        assert!(below.region.is_subset_of(&part) && below.pitch == frame.pitch);
        let floor = |g: &BitGrid| g.iter_ones().filter(|v| v[2] < 8).count();
        assert!(floor(&below.region) > 100 && floor(&above.region) < floor(&below.region));
        let tilted = damage(&frame, &part, &tool, fibonacci_sphere(9)[1], &ctx).unwrap();
        assert!(tilted.region.is_subset_of(&part));
    }
}
