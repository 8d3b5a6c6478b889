//! How far what a program leaves is from the target's own surface.
//!
//! Method: the target mesh is divided into facets; over each the signed distance to what the cutters
//! sweep is the least, over all cutting moves, of the distance to the edge of the tool. Beads are
//! held against the mesh at the middle of their layer.
//!
//! ```text
//! gouge(p)  = max over moves after p was last laid of −d(p, tool)   where positive,
//!             no more than a bead of a later step is away from p
//! excess(p) = min over moves of d(p, tool) − reach(p)               where p was cut free
//! reach(p)  = the least d(p, tool) of an end that does not enter the target
//! outside   = max over beads of the distance from the target + half a bead
//! ```
//!
//! What lies behind a facet when the plan ends is what the program answers for: facets behind which the
//! plan itself leaves nothing (skin) are not looked at, and of a face that is laid only what is
//! cut after it was. Cuts reach beyond the voxels of a pit at its rim: what is laid in it comes up to the mesh
//! there again, and where it does nothing is missing. Beads of supports fill nothing. Beads that a later cutter
//! sweeps are gone. Of the deepest gouge the move is named that makes it: of each move alone the distance is
//! asked for.
//!
//! Guarantees: gouges and excess to a micrometre at the middle of each facet. Not guaranteed: between
//! the middles; moves of tools whose edge is no ball, flat or bull-nose end and no cone on the equator of its
//! ball, which are left out; what beads leave open inside.

use super::check::motions;
use super::interpret::{Gait, Motion};
use super::reach::Reach;
use super::sweep::samples;
use crate::base::{Ctx, DVec3, Direction, ImagePlane};
use crate::machine::Tool;
use crate::mesh::{NearestTriangle, TriMesh};
use crate::plan::{Job, Plan, Step, StepKind};
use crate::toolpath::{End, GOUGE_MM, Replay, Swept, ToolpathError, facets};
use crate::voxel::BitGrid;
use rayon::prelude::*;
use std::io::{self, Write};

/// Facets have no longer sides than this many pitches; smaller ones cost time alone.
const FACET_PITCH: f64 = 2.0;

/// Facets at most: the sides grow where a mesh is finer or larger.
const MOST_FACETS: f64 = 400_000.0;

/// Distances beyond this are not told apart, mm: a surface this far off was not meant to be cut.
const FAR_MM: f64 = 2.0;

/// How far aside of its facet a voxel is looked up, in pitches: the surface lies up to half a
/// voxel's diagonal from the face between voxels.
const ASIDE_PITCH: f64 = 0.9;

/// Places looked at on the way there, for what is nearest.
const LOOKS: u32 = 9;

/// One facet of the target.
#[derive(Clone, Copy, Debug)]
pub struct Facet {
    pub corners: [DVec3; 3],
    /// Outward.
    pub normal: DVec3,
    /// mm²
    pub area: f64,
    /// Material left on the surface (positive) or cut out of it (negative), mm; 0 where no cutter
    /// came.
    pub off_mm: f64,
    /// How near the end of a cutter that cuts in front of it can come, mm; looked for only where
    /// more is left than roughing leaves.
    pub reach_mm: f64,
    /// Whether a step cuts the space in front of it.
    pub machined: bool,
    /// Steps before this one may have cut here: what stands was laid after them.
    from: usize,
}

fn middle(corners: [DVec3; 3]) -> DVec3 {
    (corners[0] + corners[1] + corners[2]) / 3.0
}

/// What a program does to the target's surface.
#[derive(Clone, Debug, Default)]
pub struct Deviation {
    pub facets: Vec<Facet>,
    /// Deepest cut into the target, mm.
    pub gouge_mm: f64,
    /// Where that is and the line of the program that makes it, where it is a gouge.
    pub deepest: Option<Gouge>,
    /// Most material left on a machined surface beyond what no end of the cutter's form reaches, mm.
    pub excess_mm: f64,
    /// Shares of the machined surface's area that are cut deeper than 0.05 mm, that keep more
    /// than what roughing leaves though the cutter could come nearer, and that keep it because no
    /// cutter of that form can.
    pub gouged: f64,
    pub left: f64,
    pub unreached: f64,
    /// How far the outside of a bead that stays lies from the target, mm.
    pub outside_mm: f64,
}

/// A cut into the target: the middle of the facet, and the line of the program, counted from 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gouge {
    pub at: DVec3,
    pub line: usize,
}

/// Measures a program's text; it should have passed its check.
///
/// # Errors
/// As [`super::check`].
pub fn deviation(
    text: &str,
    job: &Job,
    plan: &Plan,
    ctx: &Ctx,
) -> Result<Deviation, ToolpathError> {
    let replay = Replay::of(job, plan)?;
    let motions = motions(text, job, plan, &replay);
    let of_step = |i: usize| {
        let from = motions.partition_point(|m| m.step < i);
        &motions[from..motions.partition_point(|m| m.step <= i)]
    };
    let mut found = Deviation::default();
    let mut made: Vec<Made> = Vec::new();
    let mut end = job.initial.clone();
    for (i, step) in plan.steps.iter().enumerate() {
        ctx.check()?;
        let no_tool = || ToolpathError::NoTool { step: i, tool: step.tool.clone() };
        let tool = job.tool(&step.tool).ok_or_else(no_tool)?;
        match step.kind {
            StepKind::Subtractive => {
                end.subtract(&step.region);
                let plane = step.direction.image_plane();
                let sweep = Sweep::of(of_step(i), plane, tool, &job.target_mesh);
                made.push(sweep.map_or(Made::Nothing, |s| Made::Cut(Box::new(s))));
            }
            StepKind::Additive => {
                end.union_with(&step.region);
                let beads = Beads::of(of_step(i), step.direction, tool, job);
                made.push(beads.map_or(Made::Nothing, Made::Laid));
            }
        }
    }
    for (i, step) in plan.steps.iter().enumerate() {
        ctx.check()?;
        if let Some(tool) = job.tool(&step.tool).filter(|_| step.kind == StepKind::Additive) {
            let out = outside(job, &made[i..], of_step(i), (tool, step.direction));
            found.outside_mm = found.outside_mm.max(out);
        }
    }
    end.intersect_with(&job.target);
    let stock = job.cutters.iter().map(|t| t.process.stock_to_leave_mm).fold(0.0, f64::max);
    let mesh = &job.target_mesh;
    let area: f64 = (0..mesh.triangles().len()).map(|t| mesh.area_normal(t).length() / 2.0).sum();
    let side = (FACET_PITCH * job.frame.pitch).max((4.0 * area / MOST_FACETS).sqrt());
    let triangles = 0..mesh.triangles().len();
    let facets: Vec<[DVec3; 3]> =
        triangles.flat_map(|t| facets(mesh.corners(t), side, |_| true)).collect();
    found.facets = facets
        .into_par_iter()
        .filter_map(|corners| facet(corners, job, (plan, &end), &made, stock))
        .map(|f| if f.off_mm < -GOUGE_MM { filled(f, &made) } else { f })
        .collect();
    ctx.check()?;
    let (mut machined, mut gouged, mut left, mut unreached) = (0.0, 0.0, 0.0, 0.0);
    for f in &found.facets {
        found.gouge_mm = found.gouge_mm.max(-f.off_mm);
        gouged += if f.off_mm < -GOUGE_MM { f.area } else { 0.0 };
        if f.machined {
            let excess = f.off_mm - f.reach_mm;
            found.excess_mm = found.excess_mm.max(excess);
            machined += f.area;
            left += if excess > stock { f.area } else { 0.0 };
            unreached += if excess <= stock && f.off_mm > stock { f.area } else { 0.0 };
        }
    }
    let share = |part: f64| if machined > 0.0 { part / machined } else { 0.0 };
    (found.gouged, found.left, found.unreached) = (share(gouged), share(left), share(unreached));
    if let Some(f) = found.facets.iter().min_by(|a, b| a.off_mm.total_cmp(&b.off_mm))
        && f.off_mm < -GOUGE_MM
    {
        let steps = (0..plan.steps.len()).map(|i| (&plan.steps[i], of_step(i)));
        found.deepest = deepest(f, job, steps.skip(f.from), ctx)?;
    }
    Ok(found)
}

/// The move of some steps that cuts deepest at a facet.
fn deepest<'p>(
    facet: &Facet,
    job: &Job,
    steps: impl Iterator<Item = (&'p Step, &'p [Motion])>,
    ctx: &Ctx,
) -> Result<Option<Gouge>, ToolpathError> {
    let at = middle(facet.corners);
    let mut best: (f64, Option<Gouge>) = (0.0, None);
    for (step, motions) in steps.filter(|(s, _)| s.kind == StepKind::Subtractive) {
        ctx.check()?;
        let Some(tool) = job.tool(&step.tool) else { continue };
        for m in motions {
            let plane = step.direction.image_plane();
            let alone = swept(std::slice::from_ref(m), plane, tool);
            let off = alone.map_or(0.0, |s| s.distance(turned(plane, at), 0.0));
            if off < best.0 {
                best = (off, Some(Gouge { at, line: m.line }));
            }
        }
    }
    Ok(best.1)
}

fn turned(plane: ImagePlane, p: DVec3) -> DVec3 {
    plane.across(p).extend(plane.height(p))
}

/// What the cutting moves among some sweep; none without any, or of a tool that is left out.
fn swept(motions: &[Motion], plane: ImagePlane, tool: &Tool) -> Option<Swept> {
    let cuts = motions.iter().filter(|m| m.gait == Gait::Feed);
    let ends = |m: &Motion| [turned(plane, m.from.unwrap_or(m.to)), turned(plane, m.to)];
    Swept::of(End::of(tool)?, tool.active_length(), cuts.map(ends).collect())
}

/// A facet's deviation; none for one without area, whose sides the voxels do not tell apart, or
/// behind which nothing of the target stands at the end of the plan.
fn facet(
    corners: [DVec3; 3],
    job: &Job,
    (plan, end): (&Plan, &BitGrid),
    made: &[Made],
    stock: f64,
) -> Option<Facet> {
    let doubled = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
    let normal = doubled.try_normalize()?;
    let p = middle(corners);
    let aside = ASIDE_PITCH * job.frame.pitch;
    let voxel = |q: DVec3| job.frame.voxel_at(q);
    let solid = |q: DVec3| voxel(q).is_some_and(|v| job.target.get(v));
    // Single triangles may face the wrong way.
    let turned = solid(p + normal * aside) && !solid(p - normal * aside);
    let normal = if turned { -normal } else { normal };
    if solid(p + normal * aside) == solid(p - normal * aside) {
        return None;
    }
    // What is nearest behind it is what the facet is a face of: along the rim of a pit that is filled again, deposit.
    let behind = (1..=LOOKS).map(|k| voxel(p - normal * (aside * f64::from(k) / f64::from(LOOKS))));
    let inner = behind.flatten().find(|v| job.target.get(*v));
    let outer = voxel(p + normal * aside);
    if !inner.is_some_and(|v| end.get(v)) {
        return None;
    }
    let in_step = |v: Option<[usize; 3]>, kind: StepKind, i: usize| {
        let step = &plan.steps[i];
        step.kind == kind && v.is_some_and(|v| step.region.get(v))
    };
    // What is laid after a cut was not there to be cut into.
    let laid = (0..plan.steps.len()).rev().find(|i| in_step(inner, StepKind::Additive, *i));
    let from = laid.map_or(0, |l| l + 1);
    let steps = from..plan.steps.len();
    let cuts = |i: &usize| in_step(outer, StepKind::Subtractive, *i);
    let machined = steps.clone().any(|i| cuts(&i));
    let mut off = FAR_MM;
    for i in steps.clone() {
        if let Some(sweep) = made[i].sweep() {
            off = sweep.distance(p, off);
        }
    }
    let off_mm = if machined || off < 0.0 { off } else { 0.0 };
    let mut reach_mm = 0.0;
    if machined && off > stock {
        let ends = steps.filter(cuts).filter_map(|i| made[i].sweep());
        reach_mm = ends.map(|s| s.reach.least(p, normal)).fold(FAR_MM, f64::min);
    }
    let area = doubled.length() / 2.0;
    Some(Facet { corners, normal, area, off_mm, reach_mm, machined, from })
}

/// A gouged facet with what later steps lay on it: as deep as no bead comes nearer.
fn filled(facet: Facet, made: &[Made]) -> Facet {
    let p = middle(facet.corners);
    let (mut depth, mut from) = (0.0f64, facet.from);
    for (i, made) in made.iter().enumerate().skip(facet.from) {
        match made {
            Made::Cut(sweep) => depth = depth.max(-sweep.distance(p, FAR_MM)),
            Made::Laid(beads) if depth > GOUGE_MM => {
                depth = depth.min(beads.distance(p, depth).max(0.0));
                from = if depth > GOUGE_MM { from } else { i + 1 };
            }
            Made::Laid(_) | Made::Nothing => {}
        }
    }
    Facet { off_mm: -depth, from, ..facet }
}

/// What one step makes of the part.
enum Made {
    Cut(Box<Sweep>),
    Laid(Beads),
    Nothing,
}

impl Made {
    fn sweep(&self) -> Option<&Sweep> {
        match self {
            Made::Cut(sweep) => Some(sweep),
            Made::Laid(_) | Made::Nothing => None,
        }
    }
}

/// What one step lays.
struct Beads {
    plane: ImagePlane,
    laid: Swept,
}

impl Beads {
    /// Beads as wide as a path, one layer high under the tip, of which the middle is target; none where none is laid.
    fn of(motions: &[Motion], up: Direction, tool: &Tool, job: &Job) -> Option<Beads> {
        let (process, plane) = (&tool.process, up.image_plane());
        let under = DVec3::Z * process.layer_mm;
        let from = |m: &Motion| m.from.unwrap_or(m.to);
        let is_of_target = |m: &&Motion| {
            let middle = (from(m) + m.to) / 2.0 - up.vec() * (process.layer_mm / 2.0);
            job.frame.voxel_at(middle).is_some_and(|v| job.target.get(v))
        };
        let laid = motions.iter().filter(|m| m.gait == Gait::Deposit).filter(is_of_target);
        let ends = |m: &Motion| [from(m), m.to].map(|tip| turned(plane, tip) - under);
        let end = End::Flat { radius: process.path_mm / 2.0 };
        let laid = Swept::of(end, process.layer_mm, laid.map(ends).collect())?;
        Some(Beads { plane, laid })
    }

    /// The lesser of `best` and the distance from a point to a bead, negative inside.
    fn distance(&self, p: DVec3, best: f64) -> f64 {
        self.laid.distance(turned(self.plane, p), best)
    }
}

/// What one step's edge sweeps, and what its end could.
struct Sweep {
    plane: ImagePlane,
    swept: Swept,
    reach: Reach,
}

impl Sweep {
    fn of(motions: &[Motion], plane: ImagePlane, tool: &Tool, target: &TriMesh) -> Option<Sweep> {
        let swept = swept(motions, plane, tool)?;
        Some(Sweep { plane, swept, reach: Reach::new(target, plane, End::of(tool)?) })
    }

    /// The lesser of `best` and the distance from a point to what is swept, negative inside.
    fn distance(&self, p: DVec3, best: f64) -> f64 {
        self.swept.distance(turned(self.plane, p), best)
    }
}

/// How far the outside of beads that no later cutter sweeps lies from the target, mm.
fn outside(job: &Job, later: &[Made], motions: &[Motion], (tool, up): (&Tool, Direction)) -> f64 {
    let process = &tool.process;
    let (reach, half) = (4.0 * process.path_mm, process.path_mm / 2.0);
    let nearest = NearestTriangle::new(&job.target_mesh, reach);
    let down = up.vec() * (process.layer_mm / 2.0);
    let aside = ASIDE_PITCH * job.frame.pitch;
    let beads: Vec<&Motion> = motions.iter().filter(|m| m.gait == Gait::Deposit).collect();
    let of_bead = |m: &&Motion| {
        let mut worst: f64 = 0.0;
        for p in samples(m, job.frame.pitch) {
            let middle = p - down;
            let near = nearest.query(middle);
            let away = near.map_or(reach, |q| q.distance);
            // A point may be inside the mesh and its voxel's middle outside, and the other way round.
            let within = match near.filter(|_| away <= aside) {
                Some(q) => nearest.is_inside(middle, &q),
                None => job.frame.voxel_at(middle).is_some_and(|v| job.target.get(v)),
            };
            let out = half + if within { -away } else { away };
            // Most beads are inside; what is swept takes longer to tell.
            let is_cut =
                || later.iter().filter_map(Made::sweep).any(|s| s.distance(middle, FAR_MM) < 0.0);
            if out > worst && !is_cut() {
                worst = out;
            }
        }
        worst
    };
    beads.par_iter().map(of_bead).collect::<Vec<_>>().into_iter().fold(0.0, f64::max)
}

impl Deviation {
    /// Writes binary PLY, millimetres, a colour for every facet: grey where no cutter came, green within
    /// 0.05 mm, blue for material left, red for material cut out, full at 0.5 mm.
    ///
    /// # Errors
    /// Whatever the writer answers.
    pub fn write_ply(&self, out: &mut dyn Write) -> io::Result<()> {
        writeln!(out, "ply\nformat binary_little_endian 1.0")?;
        writeln!(out, "comment deviation from the target, mm: property off of each face")?;
        writeln!(out, "element vertex {}", 3 * self.facets.len())?;
        writeln!(out, "property float x\nproperty float y\nproperty float z")?;
        let colour = "property uchar red\nproperty uchar green\nproperty uchar blue";
        writeln!(out, "element face {}", self.facets.len())?;
        writeln!(out, "property list uchar uint vertex_indices\n{colour}")?;
        writeln!(out, "property float off\nend_header")?;
        for p in self.facets.iter().flat_map(|f| f.corners) {
            for c in p.to_array() {
                out.write_all(&(c as f32).to_le_bytes())?;
            }
        }
        for (i, f) in self.facets.iter().enumerate() {
            out.write_all(&[3])?;
            for k in 0..3 {
                out.write_all(&((3 * i + k) as u32).to_le_bytes())?;
            }
            out.write_all(&f.colour())?;
            out.write_all(&(f.off_mm as f32).to_le_bytes())?;
        }
        Ok(())
    }
}

impl Facet {
    fn colour(&self) -> [u8; 3] {
        /// Deviation of the full colour, mm.
        const FULL_MM: f64 = 0.5;
        if !self.machined && self.off_mm == 0.0 {
            return [160, 160, 160];
        }
        let share = ((self.off_mm.abs() - GOUGE_MM) / (FULL_MM - GOUGE_MM)).clamp(0.0, 1.0);
        let to = if self.off_mm < 0.0 { [213.0, 94.0, 0.0] } else { [0.0, 114.0, 178.0] };
        let from = [0.0, 158.0, 115.0];
        std::array::from_fn(|c| (from[c] + share * (to[c] - from[c])) as u8)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gcode::post;
    use crate::toolpath::for_unverified;
    use crate::toolpath::tests::{World, world};

    fn faced() -> (World, String) {
        let block = |p: DVec3| p.x > 2.0 && p.x < 22.0 && p.y > 2.0 && p.y < 18.0 && p.z < 12.0;
        let size = DVec3::new(24.0, 20.0, 14.0);
        let mut w = world(
            "generic-5axis",
            0.5,
            size,
            block,
            &[(StepKind::Subtractive, DVec3::Z, |p| p.z > 8.2)],
        );
        // The face lies where no voxel's face does.
        w.job.target_mesh = TriMesh::cuboid(DVec3::new(2.0, 2.0, 0.0), DVec3::new(22.0, 18.0, 8.2));
        let paths = for_unverified(&w.job, &w.plan, &Ctx::quiet()).unwrap();
        let text = post(&w.job, &w.plan, &paths, "sha256:0").unwrap().text().to_string();
        (w, text)
    }

    #[test]
    fn a_face_is_left_within_the_scallop_and_a_low_cut_is_seen() {
        let (w, text) = faced();
        let d = deviation(&text, &w.job, &w.plan, &Ctx::quiet()).unwrap();
        let scallop = w.job.cutters[0].process.scallop_mm;
        assert!(d.gouge_mm < 0.01, "{}", d.gouge_mm);
        assert!(d.excess_mm < 1.5 * scallop + 0.01, "{} for {scallop}", d.excess_mm);
        assert!(d.facets.iter().any(|f| f.machined) && d.facets.iter().any(|f| !f.machined));
        // Every height that is not a rapid's, 0.3 mm lower.
        let lower = |word: &str| match word.strip_prefix('Z').and_then(|z| z.parse::<f64>().ok()) {
            Some(z) => format!("Z{:.3} ", z - 0.3),
            None => format!("{word} "),
        };
        let low = |l: &str| match l.starts_with("G0") || l.starts_with("G53") {
            true => format!("{l}\n"),
            false => l.split(' ').map(lower).collect::<String>() + "\n",
        };
        let text: String = text.lines().map(low).collect();
        let d = deviation(&text, &w.job, &w.plan, &Ctx::quiet()).unwrap();
        assert!((d.gouge_mm - 0.3).abs() < 0.05 && d.gouged > 0.0, "{}", d.gouge_mm);
        // Its line is one of those that cut.
        let gouge = d.deepest.expect("a line");
        let line = text.lines().nth(gouge.line - 1).expect("within the program");
        assert!(!line.starts_with("G0") && line.contains(['X', 'Y', 'Z']), "{line}");
        assert!((gouge.at.z - 8.2).abs() < 1e-9, "{gouge:?}");
        let mut ply = Vec::new();
        d.write_ply(&mut ply).unwrap();
        let header = ply.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
        assert_eq!(ply.len(), header + d.facets.len() * (3 * 12 + 13 + 3 + 4));
    }

    fn measured(w: &World) -> Deviation {
        let paths = for_unverified(&w.job, &w.plan, &Ctx::quiet()).unwrap();
        let text = post(&w.job, &w.plan, &paths, "sha256:0").unwrap().text().to_string();
        deviation(&text, &w.job, &w.plan, &Ctx::quiet()).unwrap()
    }

    /// What a cut leaves is not asked of a face that is laid on it later, nor of a bead that a later cut
    /// sweeps that it be near the target: both once counted as 2 mm off.
    #[test]
    fn what_is_laid_after_a_cut_or_swept_after_it_was_laid_is_not_held_against_them() {
        let block = |p: DVec3| p.x > 2.0 && p.x < 22.0 && p.y > 2.0 && p.y < 18.0 && p.z < 12.0;
        let top: fn(DVec3) -> bool = |p| p.z > 6.0;
        let again: fn(DVec3) -> bool =
            |p| p.x > 2.0 && p.x < 22.0 && p.y > 2.0 && p.y < 18.0 && p.z > 6.0 && p.z < 9.0;
        let away: fn(DVec3) -> bool = |p| p.x > 12.0 && p.z > 6.0;
        let steps = [
            (StepKind::Subtractive, DVec3::Z, top),
            (StepKind::Additive, DVec3::Z, again),
            (StepKind::Subtractive, DVec3::Z, away),
        ];
        let mut w = world("generic-5axis", 0.5, DVec3::new(24.0, 20.0, 14.0), block, &steps);
        let part = |low: [f64; 3], high: [f64; 3]| TriMesh::cuboid(low.into(), high.into());
        w.job.target_mesh = TriMesh::joined(&[
            part([2.0, 2.0, 0.0], [22.0, 18.0, 6.0]),
            part([2.0, 2.0, 6.0], [12.0, 18.0, 9.0]),
        ]);
        let d = measured(&w);
        let laid = |f: &&Facet| f.normal.z > 0.9 && f.corners[0].z > 8.0;
        assert!(d.facets.iter().filter(laid).count() > 100);
        assert!(!d.facets.iter().filter(laid).any(|f| f.machined));
        assert!(d.facets.iter().any(|f| f.machined) && d.left == 0.0, "{} left", d.left);
        assert!(d.outside_mm < 1.0, "{} mm", d.outside_mm);
    }

    /// A cut goes beyond its voxels at their rim. What is laid there later comes up to the mesh again, and the rim
    /// counted as gouged all the same; where nothing is laid on it, it is.
    #[test]
    fn a_rim_that_beads_fill_again_is_not_gouged() {
        let block = |p: DVec3| p.x > 2.0 && p.x < 22.0 && p.y > 2.0 && p.y < 18.0 && p.z < 9.0;
        let top: fn(DVec3) -> bool =
            |p| p.x > 2.0 && p.x < 22.0 && p.y > 2.0 && p.y < 18.0 && p.z > 6.0 && p.z < 9.0;
        let steps = [(StepKind::Subtractive, DVec3::Z, top), (StepKind::Additive, DVec3::Z, top)];
        let mut w = world("generic-5axis", 0.5, DVec3::new(24.0, 20.0, 11.0), block, &steps);
        w.job.target_mesh = TriMesh::cuboid(DVec3::new(2.0, 2.0, 0.0), DVec3::new(22.0, 18.0, 9.0));
        let paths = for_unverified(&w.job, &w.plan, &Ctx::quiet()).unwrap();
        let text = post(&w.job, &w.plan, &paths, "sha256:0").unwrap().text().to_string();
        // Heights that are no rapid's 0.3 mm lower, in so many of the two steps.
        let lowered = |steps: usize| {
            let mut step = 0;
            let line = |l: &str| {
                step += usize::from(l.starts_with("(step "));
                if !(1..=steps).contains(&step) || l.starts_with("G0") || l.starts_with("G53") {
                    return format!("{l}\n");
                }
                let word = |w: &str| match w.strip_prefix('Z').and_then(|z| z.parse::<f64>().ok()) {
                    Some(z) => format!("Z{:.3} ", z - 0.3),
                    None => format!("{w} "),
                };
                l.split(' ').map(word).collect::<String>() + "\n"
            };
            deviation(&text.lines().map(line).collect::<String>(), &w.job, &w.plan, &Ctx::quiet())
        };
        let [right, cut, both] = [0, 1, 2].map(|steps| lowered(steps).unwrap());
        assert!(right.gouge_mm <= GOUGE_MM, "{}", right.gouge_mm);
        assert!(cut.gouge_mm > 0.1 && cut.deepest.is_some(), "{}", cut.gouge_mm);
        assert!(both.gouge_mm <= GOUGE_MM, "{}", both.gouge_mm);
        assert_eq!((both.gouged, both.deepest), (0.0, None));
    }

    /// What fills a slot in a wall goes with a later step; meanwhile it kept the cutter off the wall
    /// under it by half a voxel and a column of the lattice.
    #[test]
    fn stock_that_a_later_step_cuts_keeps_no_cutter_off_a_wall() {
        let block = |p: DVec3| p.x > 2.0 && p.x < 22.0 && p.y > 2.0 && p.y < 18.0 && p.z < 12.0;
        let beside: fn(DVec3) -> bool = |p| p.x > 12.4 && p.z > 4.0;
        let slot: fn(DVec3) -> bool = |p| p.y > 8.0 && p.y < 12.0 && p.z > 7.0;
        let cuts =
            [(StepKind::Subtractive, DVec3::Z, beside), (StepKind::Subtractive, DVec3::X, slot)];
        let mut w = world("generic-5axis", 0.5, DVec3::new(24.0, 20.0, 14.0), block, &cuts);
        let part = |low: [f64; 3], high: [f64; 3]| TriMesh::cuboid(low.into(), high.into());
        w.job.target_mesh = TriMesh::joined(&[
            part([2.0, 2.0, 0.0], [22.0, 18.0, 4.0]),
            part([2.0, 2.0, 4.0], [12.4, 8.0, 12.0]),
            part([2.0, 12.0, 4.0], [12.4, 18.0, 12.0]),
            part([2.0, 8.0, 4.0], [12.4, 12.0, 7.0]),
        ]);
        let d = measured(&w);
        let wall = |f: &&Facet| {
            let [c, ..] = f.corners;
            f.machined && f.normal.x > 0.9 && c.x < 13.0 && c.z < 6.0
        };
        let under: Vec<&Facet> = d.facets.iter().filter(wall).collect();
        let left = under.iter().map(|f| f.off_mm - f.reach_mm).fold(0.0, f64::max);
        let gouged = under.iter().find(|f| f.off_mm < -GOUGE_MM);
        assert!(gouged.is_none(), "{gouged:?}");
        assert!(under.len() > 100 && left <= 0.2, "{} of {}", left, under.len());
    }

    /// Between a wall that stays and the old part's own wall, which goes later, there is room for the cutter by the
    /// voxels but not by the surfaces: it went 0.08 mm into the one so as not to go into the other.
    #[test]
    fn the_old_parts_surface_that_goes_later_is_nicked_before_the_targets() {
        const WALLS: [f64; 2] = [10.1, 12.95];
        let block = |p: DVec3| {
            let slot = p.x > WALLS[0] && p.x < WALLS[1] && p.z > 6.0;
            p.x > 2.0 && p.x < 22.0 && p.y > 2.0 && p.y < 18.0 && p.z < 12.0 && !slot
        };
        let under: fn(DVec3) -> bool = |p| p.x > WALLS[0] && p.x < WALLS[1] && p.z > 3.0;
        let beside: fn(DVec3) -> bool = |p| p.x > WALLS[0] && p.z > 3.0;
        let cuts =
            [(StepKind::Subtractive, DVec3::Z, under), (StepKind::Subtractive, DVec3::X, beside)];
        let mut w = world("generic-5axis", 0.5, DVec3::new(24.0, 20.0, 14.0), block, &cuts);
        w.plan.steps[0].tool = "ball-3x30".into();
        let part = |low: [f64; 3], high: [f64; 3]| TriMesh::cuboid(low.into(), high.into());
        w.job.target_mesh = TriMesh::joined(&[
            part([2.0, 2.0, 0.0], [22.0, 18.0, 3.0]),
            part([2.0, 2.0, 3.0], [WALLS[0], 18.0, 12.0]),
        ]);
        w.job.initial_mesh = TriMesh::joined(&[
            part([2.0, 2.0, 0.0], [22.0, 18.0, 6.0]),
            part([2.0, 2.0, 6.0], [WALLS[0], 18.0, 12.0]),
            part([WALLS[1], 2.0, 6.0], [22.0, 18.0, 12.0]),
        ]);
        let d = measured(&w);
        assert!(d.gouge_mm <= GOUGE_MM, "{}", d.gouge_mm);
    }

    /// Through a hole in a roof that is as wide as the cutter, and is closed again, a shaft goes down beside a wall. By the
    /// middles of voxels the cutter reaches over the wall's face by 0.2 mm; that much off it the hole's rim was in its way
    /// by half a voxel, so it went down all the same.
    #[test]
    fn through_a_hole_as_wide_as_the_cutter_no_wall_is_gouged() {
        const AXIS: [f64; 2] = [12.2, 10.2];
        const WALL: f64 = AXIS[0] - 1.3;
        fn off(p: DVec3, aside: f64) -> f64 {
            (p.x - AXIS[0] - aside).hypot(p.y - AXIS[1])
        }
        fn is_roof(p: DVec3) -> bool {
            p.z > 9.2
        }
        fn is_hole(p: DVec3) -> bool {
            is_roof(p) && p.z < 12.0 && (off(p, 0.0) < 1.5 || off(p, 0.2) < 1.5)
        }
        let block = |p: DVec3| p.x > 2.0 && p.x < 22.0 && p.y > 2.0 && p.y < 18.0 && p.z < 12.0;
        let shaft: fn(DVec3) -> bool = |p| {
            let end = 5.0 + 1.5 - (2.25 - off(p, 0.0).powi(2)).max(0.0).sqrt();
            is_hole(p) || off(p, 0.0) < 1.5 && p.z > end
        };
        let beside: fn(DVec3) -> bool = |p| p.x > WALL && p.z > 3.2 && !is_roof(p);
        let steps = [
            (StepKind::Subtractive, DVec3::Z, shaft),
            (StepKind::Subtractive, DVec3::X, beside),
            (StepKind::Additive, DVec3::Z, is_hole as fn(DVec3) -> bool),
        ];
        let mut w = world("generic-5axis", 0.4, DVec3::new(24.0, 20.0, 14.0), block, &steps);
        w.plan.steps[0].tool = "ball-3x30".into();
        let part = |low: [f64; 3], high: [f64; 3]| TriMesh::cuboid(low.into(), high.into());
        w.job.target_mesh = TriMesh::joined(&[
            part([2.0, 2.0, 0.0], [22.0, 18.0, 3.2]),
            part([2.0, 2.0, 3.2], [WALL, 18.0, 9.2]),
            part([2.0, 2.0, 9.2], [22.0, 18.0, 12.0]),
        ]);
        w.job.initial_mesh = part([2.0, 2.0, 0.0], [22.0, 18.0, 12.0]);
        let d = measured(&w);
        let wall = |f: &&Facet| f.normal.x > 0.9 && (f.corners[0].x - WALL).abs() < 1e-6;
        let deepest = d.facets.iter().filter(wall).map(|f| -f.off_mm).fold(0.0, f64::max);
        assert!(deepest <= GOUGE_MM, "{deepest}");
        // Beads come up to the roof again, within what is between their ends.
        assert!(d.gouge_mm < 0.1, "{}", d.gouge_mm);
        // The shaft is cut.
        let paths = for_unverified(&w.job, &w.plan, &Ctx::quiet()).unwrap();
        let covered = paths.all()[0].figures.coverage;
        assert!(covered > 0.98, "{covered}");
    }

    /// Along an upright edge that runs between the voxels, both the mesh's pieces that voxels had
    /// lost and straight ways around it cost up to 0.1 mm of the edge.
    #[test]
    fn upright_edges_between_voxels_are_not_gouged() {
        fn turned(p: DVec3) -> DVec3 {
            let (sin, cos) = 0.43f64.sin_cos();
            let q = p - DVec3::new(12.0, 10.0, 0.0);
            DVec3::new(cos * q.x + sin * q.y, cos * q.y - sin * q.x, q.z)
        }
        let block = |p: DVec3| p.x > 2.0 && p.x < 22.0 && p.y > 2.0 && p.y < 18.0 && p.z < 10.0;
        let around: fn(DVec3) -> bool =
            |p| p.z > 3.0 && !(turned(p).x.abs() < 5.1 && turned(p).y.abs() < 1.3);
        let cuts = [(StepKind::Subtractive, DVec3::Z, around)];
        let mut w = world("generic-5axis", 0.5, DVec3::new(24.0, 20.0, 12.0), block, &cuts);
        let fin = TriMesh::cuboid(DVec3::new(-5.1, -1.3, 3.0), DVec3::new(5.1, 1.3, 10.0));
        let back = |p: &DVec3| {
            let (sin, cos) = 0.43f64.sin_cos();
            DVec3::new(12.0 + cos * p.x - sin * p.y, 10.0 + sin * p.x + cos * p.y, p.z)
        };
        let fin = TriMesh::new(fin.vertices().iter().map(back).collect(), fin.triangles().to_vec());
        let floor = TriMesh::cuboid(DVec3::new(2.0, 2.0, 0.0), DVec3::new(22.0, 18.0, 3.0));
        w.job.target_mesh = TriMesh::joined(&[floor, fin.unwrap()]);
        let d = measured(&w);
        assert!(d.gouge_mm <= GOUGE_MM, "{}", d.gouge_mm);
        assert!(d.left <= 0.002, "{} up to {}", d.left, d.excess_mm);
    }

    /// From the end of one pass to the next, a way at one height led over a sharp edge between the lattice's cells and
    /// took some of it.
    #[test]
    fn ways_from_pass_to_pass_clear_edges_between_cells() {
        const SPIRES: [[f64; 3]; 4] =
            [[7.1, 6.3, 0.43], [16.4, 5.9, 0.2], [8.2, 13.7, 0.61], [16.7, 13.2, 0.33]];
        const SIDE: f64 = 2.2;
        const FLOOR: f64 = 3.0;
        const TOP: f64 = 7.3;
        /// Around a spire's axis.
        fn turned(p: DVec3, [x, y, by]: [f64; 3]) -> DVec3 {
            let (sin, cos) = by.sin_cos();
            let q = p - DVec3::new(x, y, 0.0);
            DVec3::new(cos * q.x + sin * q.y, cos * q.y - sin * q.x, q.z)
        }
        fn is_in_a_spire(p: DVec3) -> bool {
            let half = SIDE * (TOP - p.z) / (TOP - FLOOR);
            SPIRES.iter().any(|s| turned(p, *s).truncate().abs().max_element() < half)
        }
        let block = |p: DVec3| p.x > 2.0 && p.x < 22.0 && p.y > 2.0 && p.y < 18.0 && p.z < 9.0;
        let around: fn(DVec3) -> bool = |p| p.z > FLOOR && !is_in_a_spire(p);
        let cuts = [(StepKind::Subtractive, DVec3::Z, around)];
        let mut w = world("generic-5axis", 0.5, DVec3::new(24.0, 20.0, 11.0), block, &cuts);
        let mut parts =
            vec![TriMesh::cuboid(DVec3::new(2.0, 2.0, 0.0), DVec3::new(22.0, 18.0, FLOOR))];
        for [x, y, by] in SPIRES {
            let (sin, cos) = by.sin_cos();
            let corner = |a: f64, b: f64| {
                DVec3::new(x + SIDE * (cos * a - sin * b), y + SIDE * (sin * a + cos * b), FLOOR)
            };
            let base = [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
            let points = base.into_iter().chain([DVec3::new(x, y, TOP)]).collect();
            let sides = [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4], [0, 2, 1], [0, 3, 2]];
            parts.push(TriMesh::new(points, sides.to_vec()).unwrap());
        }
        w.job.target_mesh = TriMesh::joined(&parts);
        let d = measured(&w);
        assert!(d.gouge_mm <= GOUGE_MM, "{}", d.gouge_mm);
    }
}
