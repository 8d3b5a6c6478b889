//! Tip heights over the meshes themselves, where the voxels know which of them still stand.
//!
//! Method: of the output state's surface, what lies on M* is taken from M*'s triangles and what lies
//! outside M* on M from M's; triangles that only partly stand are divided until their pieces do or
//! do not. The end of the cutter rests on those by drop-cutter. Faces that cuts leave inside M
//! have no triangles: there the voxels are the obstacle, with their margin. So are they, without one,
//! where material stands that later steps cut, supports among it; and, for ends narrower than voxels may be away from
//! the surface beside them, where what was over such voxels is cut. The tips of cells keep off the middles of the cells
//! that these obstacles lie in, tips between them off the obstacles where they are. Where the target would be nicked else,
//! tips may pass M's surface outside M*, which goes later, as far as its voxels' middles and a nick let them.
//! Shank and holder are held against the voxels alone.
//!
//! Guarantees: over a surface of M or M* that stands, the tip is exact to rounding at every wanted cell of
//! the lattice. Not guaranteed: within a voxel of the rim between two surfaces.

use super::columns::Columns;
use super::drop::{DropCutter, End};
use super::image::{Cell, Image, Lattice, Profile};
use super::mill::{Free, Work};
use super::near::NEAR_PITCH;
use crate::base::{Cancelled, DVec2, DVec3};
use crate::voxel::{BitGrid, Rim, standing};
use rayon::prelude::*;
pub(super) struct Exact {
    end: End,
    drop: DropCutter,
    /// Heights at which the end rests on what stands of the meshes.
    resting: Image,
    /// What rests higher than this does not stand.
    bound: Image,
    /// Obstacles that no mesh stands for: faces that cuts leave inside the target, with pedestal and
    /// table.
    faces: Bare,
    /// The same of material outside the target, which goes later: there is no surface to keep.
    passing: Bare,
    /// Voxels of the target that have a surface beside them, but that a slender end may be in without touching it, since
    /// what was over them is gone.
    uncovered: Bare,
    /// Half a pitch, mm.
    half: f64,
}

/// Lowest free tips at the lattice's cells.
pub(super) struct Lowest {
    pub tips: Image,
    /// What of it shank and holder ask for.
    guard: Image,
    /// How far the end keeps off faces that no mesh stands for, to the side and downward, mm.
    margin: [f64; 2],
}

/// How deep the edge may go, mm.
#[derive(Clone, Copy)]
pub(super) struct Nick {
    /// Into the meshes.
    pub meshes: f64,
    /// Past the middles of voxels outside the target that later steps cut, where no mesh stands for them or tips may
    /// pass it (see [`Exact::past`]): none of their surface is to be kept.
    pub passing: f64,
}

impl Nick {
    pub const NONE: Nick = Nick { meshes: 0.0, passing: 0.0 };
}

impl Lowest {
    /// Of voxels alone.
    pub fn of_voxels(tips: Image) -> Lowest {
        Lowest { guard: Image::empty(tips.lattice), tips, margin: [0.0; 2] }
    }
}

/// Obstacles that no mesh stands for: as the lattice's cells have them, and where they are.
struct Bare {
    image: Image,
    columns: Columns,
}

impl Bare {
    fn of(mut image: Image, points: &[DVec3]) -> Bare {
        points.iter().for_each(|p| {
            image.raise(*p);
        });
        let plane = image.lattice.plane;
        let seen = |p: &DVec3| plane.across(*p).extend(plane.height(*p));
        let seen: Vec<DVec3> = points.iter().map(seen).collect();
        Bare { columns: Columns::over(image.lattice, &seen), image }
    }
}

impl Exact {
    /// None when the job has no meshes or the cutter's end is not one of [`End`].
    pub fn of(work: &Work, free: &Free) -> Result<Option<Exact>, Cancelled> {
        let Some(end) = End::of(work.tool) else { return Ok(None) };
        if [&work.job.target_mesh, &work.job.initial_mesh].iter().all(|m| m.is_empty()) {
            return Ok(None);
        }
        // No point of the surface is farther from its voxel.
        let far = NEAR_PITCH * work.frame.pitch + free.window.s;
        let bound = free.heights(work.tool, far, far, work.ctx)?;
        let [target, initial] = work.surfaces;
        let told = [Some((Rim::Kept, target)), Some((Rim::Parted, initial))];
        let mut exact = Exact::standing(work, free, (end, bound), told);
        let (lattice, drop) = (free.window, &exact.drop);
        let rows = exact.resting.data.par_chunks_mut(lattice.n[0].max(1)).enumerate();
        rows.try_for_each(|(j, row)| -> Result<(), Cancelled> {
            // Next to it the end mostly rests on the same triangle.
            let mut on = None;
            for i in free.wanted.runs(j).iter().cloned().flatten() {
                work.ctx.check()?;
                let height = drop.height_from(end, lattice.uv([i, j]), &mut on);
                row[i] = height.map_or(f32::NEG_INFINITY, |z| z as f32);
            }
            Ok(())
        })?;
        Ok(Some(exact))
    }

    /// For tips between the lattice's cells that may pass what goes later: over the target's surface alone, to its `rim`.
    /// Of what goes later the middles of voxels are kept, whether they have a surface or not.
    pub fn past(&self, work: &Work, free: &Free, rim: Rim) -> Exact {
        let told = [Some((rim, &work.surfaces[0])), None];
        Exact::standing(work, free, (self.end, self.bound.clone()), told)
    }

    /// Over what stands of M* and M, of each along a rim or nothing of it, with obstacles where no surface tells of
    /// voxels: which these are is told with the rim. Nothing rests at the cells yet.
    fn standing(
        work: &Work,
        free: &Free,
        (end, bound): (End, Image),
        told: [Option<(Rim, &BitGrid)>; 2],
    ) -> Exact {
        let h = work.frame.pitch;
        let (target, meshes) = (&work.job.target, [&work.job.target_mesh, &work.job.initial_mesh]);
        // What stands of either mesh's solid on its own side. Supports are of neither.
        let outside = work.job.initial.minus(target);
        let stands = [work.after.and(target), work.after.and(&outside)];
        let lattice = free.window;
        // A tip may stand up to a cell from those that are wanted.
        let margin = DVec2::splat(end.radius() + h.max(2.0 * lattice.s));
        let is_near = |low: DVec2, high: DVec2| free.wanted.any_within(low - margin, high + margin);
        let mut triangles = Vec::new();
        let plane = lattice.plane;
        let turned = |p: DVec3| plane.across(p).extend(plane.height(p));
        let is_piece_near = |t: &[DVec3; 3]| {
            let [a, b, c] = t.map(|p| plane.across(p));
            is_near(a.min(b).min(c), a.max(b).max(c))
        };
        let wholes = [target, &outside];
        for (((mesh, solid), whole), told) in meshes.iter().zip(&stands).zip(wholes).zip(told) {
            if let Some((rim, _)) = told {
                let pieces = standing(mesh, [solid, whole], work.frame, &is_piece_near, rim);
                triangles.extend(pieces.into_iter().map(|t| t.map(turned)));
            }
        }
        let above = neighbours_above(work.step.direction.vec());
        let is_slender = work.tool.tip_radius() < NEAR_PITCH * h;
        let is_uncovered = |v: [usize; 3], side: usize| {
            let is_gone = |at| wholes[side].get_or_empty(at) && !stands[side].get_or_empty(at);
            is_slender && above.iter().any(|by| is_gone([0, 1, 2].map(|a| v[a] as i64 + by[a])))
        };
        // Which voxels are obstacles themselves, and whether a surface is beside them.
        let shell: Vec<[usize; 3]> = work.after.boundary().iter_ones().collect();
        let bare: Vec<([usize; 3], DVec3, bool)> = shell
            .par_iter()
            .filter_map(|v| {
                let p = work.frame.center(*v);
                if !is_near(plane.across(p), plane.across(p)) {
                    return None;
                }
                let side = wholes.iter().position(|whole| whole.get(*v));
                let told = side.filter(|side| told[*side].is_some_and(|(_, near)| near.get(*v)));
                let is_bare = told.is_none_or(|side| is_uncovered(*v, side));
                is_bare.then_some((*v, p, told.is_some()))
            })
            .collect();
        let (mut faces, mut passing) = (work.fixed.to_vec(), Vec::new());
        let mut uncovered = Vec::new();
        for (v, p, is_told) in &bare {
            let points = match target.get(*v) {
                true if *is_told => &mut uncovered,
                true => &mut faces,
                false => &mut passing,
            };
            points.push(*p);
        }
        let drop = DropCutter::new(triangles, end.radius());
        let bare = [faces, passing, uncovered];
        let [faces, passing, uncovered] = bare.map(|points| Bare::of(free.empty(), &points));
        let resting = Image::empty(lattice);
        Exact { end, drop, resting, bound, faces, passing, uncovered, half: h / 2.0 }
    }

    pub fn end(&self) -> End {
        self.end
    }

    /// Lowest free tips: the end over the meshes, the rest of the tool over the voxels; with the
    /// tool grown by `side` and `down` where voxels are the obstacle, by `over` over the meshes.
    pub fn heights(
        &self,
        work: &Work,
        free: &Free,
        side: f64,
        down: f64,
        over: f64,
    ) -> Result<Lowest, Cancelled> {
        let tool = work.tool;
        let (edge, s) = (tool.active_radius(), free.window.s);
        let upper = |rho: f64| if rho <= edge { f64::INFINITY } else { tool.lower_surface(rho) };
        let holder = Profile::new(upper, tool.max_radius(), s, side, down);
        let guard = free.dilated(&holder, work.ctx)?;
        let mut tips = guard.clone();
        self.bare(work, free, [side, down], &mut tips)?;
        self.rest_on(over, &mut tips);
        Ok(Lowest { tips, guard, margin: [side, down] })
    }

    /// Lowest free tips where `whole` are those of the whole tool, grown, over the voxels: shank and
    /// holder, grown as much, ask for nothing more than it does.
    pub fn raised(
        &self,
        work: &Work,
        free: &Free,
        mut whole: Image,
        [side, down, over]: [f64; 3],
    ) -> Result<Image, Cancelled> {
        self.bare(work, free, [side, down], &mut whole)?;
        self.rest_on(over, &mut whole);
        Ok(whole)
    }

    /// Obstacles that no mesh stands for, and what an end grown by `margin` keeps off them: of what
    /// passes only the centres have to stay, which are half a pitch inside, but for a nick; of what is uncovered too, since
    /// beside it the surface tells.
    fn bare_with(&self, margin: [f64; 2], nick: Nick) -> [(&Bare, [f64; 2]); 3] {
        let passing = margin.map(|m| (m - self.half).max(0.0) - nick.passing);
        [(&self.faces, margin), (&self.passing, passing), (&self.uncovered, [-nick.meshes; 2])]
    }

    /// Raises tips to where the grown end is free of obstacles that no mesh stands for.
    fn bare(
        &self,
        work: &Work,
        free: &Free,
        margin: [f64; 2],
        tips: &mut Image,
    ) -> Result<(), Cancelled> {
        let (edge, s) = (work.tool.active_radius(), free.window.s);
        for (obstacles, [side, down]) in self.bare_with(margin, Nick::NONE) {
            let end = Profile::new(|rho| work.tool.active_lower_surface(rho), edge, s, side, down);
            let bare = end.dilate_over(&obstacles.image, &free.wanted, free.highest(), work.ctx)?;
            tips.data.iter_mut().zip(&bare.data).for_each(|(z, b)| *z = z.max(*b));
        }
        Ok(())
    }

    /// Lowest tip anywhere at which the grown end is free of obstacles that no mesh stands for, but for a nick into
    /// what passes; of those above `enough` any.
    fn passed(&self, at: DVec2, (margin, nick): ([f64; 2], Nick), enough: f64) -> f64 {
        let mut lowest = f64::NEG_INFINITY;
        for (obstacles, [side, down]) in self.bare_with(margin, nick) {
            let radius = self.end.radius() - TOUCHING_MM;
            let lower = |rho: f64| match (rho - side).max(0.0) {
                rho if rho < radius => self.end.lower(rho) - down,
                _ => f64::INFINITY,
            };
            lowest = obstacles.columns.lift(at, radius + side, lower, [lowest, enough]);
            if lowest > enough {
                return lowest;
            }
        }
        lowest
    }

    /// Raises tips to `over` above where the end rests on the meshes.
    fn rest_on(&self, over: f64, tips: &mut Image) {
        let resting = self.resting.data.iter().zip(&self.bound.data).map(|(r, b)| r.min(*b));
        tips.data.iter_mut().zip(resting).for_each(|(z, r)| *z = z.max(r + over as f32));
    }

    /// Lowest free tip anywhere within the lattice: over the meshes exact, over the voxels that of
    /// the highest cell around.
    pub fn lowest(&self, at: DVec2, of: &Lowest) -> f64 {
        self.lowest_nicked(at, Nick::NONE, of)
    }

    /// The same where the end may go so deep into the meshes, mm, to all sides.
    pub fn lowest_nicked(&self, at: DVec2, nick: Nick, of: &Lowest) -> f64 {
        let Some([guard, bound]) = self.around(at, of) else { return f64::INFINITY };
        let height = self.drop.height(self.end.inset(nick.meshes), at);
        let resting = height.map_or(f64::NEG_INFINITY, |z| z - nick.meshes);
        let past = self.passed(at, (of.margin, nick), f64::INFINITY);
        guard.max(resting.min(bound)).max(past)
    }

    /// Whether [`Exact::lowest`] is at most `z`, told sooner; `on` as for [`DropCutter::rests_over`].
    pub fn is_free(&self, at: DVec2, z: f64, of: &Lowest, on: &mut Option<u32>) -> bool {
        self.is_free_nicked(at, z, Nick::NONE, of, on)
    }

    /// Whether [`Exact::lowest_nicked`] is at most `z`, told sooner.
    pub fn is_free_nicked(
        &self,
        at: DVec2,
        z: f64,
        nick: Nick,
        of: &Lowest,
        on: &mut Option<u32>,
    ) -> bool {
        let Some([guard, bound]) = self.around(at, of) else { return z == f64::INFINITY };
        let (end, deep) = (self.end.inset(nick.meshes), nick.meshes);
        let rests = |on: &mut Option<u32>| self.drop.rests_over(end, at, z + deep, on);
        let past = || self.passed(at, (of.margin, nick), z);
        guard <= z && (bound <= z || !rests(on)) && past() <= z
    }

    /// A height under which shank and holder let no tip within `reach` of a place, across.
    pub fn least_guard(&self, at: DVec2, reach: f64, of: &Lowest) -> f64 {
        let lattice = of.guard.lattice;
        // Every tip has its nearest cell among those around it.
        let (low, high) = (at - reach - lattice.s, at + reach + lattice.s);
        let cell = |p: DVec2| ((p - lattice.origin) / lattice.s).round().max(DVec2::ZERO);
        let (low, high) = (cell(low), cell(high));
        let range = |low: f64, high: f64, n: usize| low as usize..(high as usize + 1).min(n);
        range(low.y, high.y, lattice.n[1])
            .flat_map(|j| range(low.x, high.x, lattice.n[0]).map(move |i| [i, j]))
            .map(|c| of.guard.at(c))
            .fold(f64::INFINITY, f64::min)
    }

    /// The highest of the cells around: what shank and holder ask for, and above which nothing rests. None
    /// outside the lattice.
    fn around(&self, at: DVec2, of: &Lowest) -> Option<[f64; 2]> {
        let lattice = of.guard.lattice;
        let g = (at - lattice.origin) / lattice.s;
        // A tip on a cell's centre has that cell alone around it, rounding or not.
        let (low, high) = ((g + ON_CELL).floor(), (g - ON_CELL).ceil());
        let (last_u, last_v) = (lattice.n[0] as f64 - 1.0, lattice.n[1] as f64 - 1.0);
        if low.min_element() < 0.0 || high.x > last_u || high.y > last_v {
            return None;
        }
        let (mut guard, mut bound) = (f64::NEG_INFINITY, f64::NEG_INFINITY);
        for j in low.y as usize..=high.y as usize {
            for i in low.x as usize..=high.x as usize {
                guard = guard.max(of.guard.at([i, j]));
                bound = bound.max(self.bound.at([i, j]));
            }
        }
        Some([guard, bound])
    }

    /// Moves a tip at height `z` from the cell `c` aside, by less than a cell, until it meets the
    /// wall next to it: walls lie between the columns of the lattice. Over a foot that is not level
    /// the tip rises on the way. The offset and the height, mm.
    pub fn aside(&self, c: Cell, z: f64, of: &Lowest) -> (DVec2, f64) {
        let lattice = of.tips.lattice;
        let mut to = DVec2::ZERO;
        for (i, j) in (-1..=1).flat_map(|i| (-1..=1).map(move |j| (i, j))) {
            let at = (c[0].checked_add_signed(i), c[1].checked_add_signed(j));
            let (Some(a), Some(b)) = at else { return (DVec2::ZERO, z) };
            if a >= lattice.n[0] || b >= lattice.n[1] {
                return (DVec2::ZERO, z);
            }
            let by = DVec2::new(i as f64, j as f64);
            if of.tips.at([a, b]) > z + TOUCH_MM + RISE * by.length() * lattice.s {
                to += by.normalize_or_zero();
            }
        }
        // Between two walls a cell apart there is no side to go to.
        if to.length() < LEAST_PULL {
            return (DVec2::ZERO, z);
        }
        let from = lattice.uv(c);
        let on = std::cell::Cell::new(None);
        let clear = |by: DVec2| {
            let mut hint = on.get();
            let most = z + TOUCH_MM + RISE * by.length();
            let is_free = self.is_free(from + by, most, of, &mut hint);
            on.set(hint);
            is_free
        };
        let way = to / to.abs().max_element() * lattice.s;
        let mut by = farthest(DVec2::ZERO, way, &clear);
        if to.abs().min_element() > 0.0 {
            // Into a corner: along one wall to the other.
            for axis in [DVec2::X, DVec2::Y] {
                by = farthest(by, axis * (way - by), &clear);
            }
        }
        if by == DVec2::ZERO {
            return (by, z);
        }
        (by, z.max(self.lowest(from + by, of)))
    }
}

/// Offsets of the neighbours of a voxel that lie above it along a direction.
fn neighbours_above(direction: DVec3) -> Vec<[i64; 3]> {
    let all = (0..27).map(|i| [i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1]);
    let is_above = |by: &[i64; 3]| DVec3::from_array(by.map(|a| a as f64)).dot(direction) > ABOVE;
    all.filter(is_above).collect()
}

/// A neighbour lies above a voxel by more than this, in pitches: the rounding of directions.
const ABOVE: f64 = 1e-6;

/// How much nearer than a cell's centre two positions are one, in cells.
const ON_CELL: f64 = 1e-6;

/// An edge so near a point touches it and does not cut it, mm.
const TOUCHING_MM: f64 = 1e-6;

/// Sum of the unit vectors to the steep cells around below which they lie on either side.
const LEAST_PULL: f64 = 0.5;

/// What rises more steeply is a wall, 56°: what rises less the lattice finishes by itself, with
/// ridges of its own cells.
const RISE: f64 = 1.5;

/// How much higher than its surface a tip may find it aside, mm: the rounding of heights.
const TOUCH_MM: f64 = 1e-3;

/// Halvings of the way aside: less than a micrometre is left of a cell of 0.5 mm.
const HALVINGS: usize = 9;

/// How far one can go from `by` along `way` while it is clear.
fn farthest(by: DVec2, way: DVec2, clear: &dyn Fn(DVec2) -> bool) -> DVec2 {
    let (mut low, mut high) = (0.0, 1.0);
    // Mostly there is nothing to gain.
    if !clear(by + way * 0.03) {
        return by;
    }
    for _ in 0..HALVINGS {
        let middle = (low + high) / 2.0;
        if clear(by + way * middle) { low = middle } else { high = middle }
    }
    by + way * low
}

/// A lattice's image of steepness: the tangent of the slope at each finite cell.
pub(super) fn steepness(lattice: &Lattice, bottom: &[f32]) -> Vec<f32> {
    let [nx, ny] = lattice.n;
    let at = |i: i64, j: i64| {
        let inside = i >= 0 && j >= 0 && i < nx as i64 && j < ny as i64;
        inside.then(|| bottom[i as usize + nx * j as usize]).filter(|z| z.is_finite())
    };
    (0..bottom.len())
        .map(|k| {
            let (i, j) = ((k % nx) as i64, (k / nx) as i64);
            let Some(z) = at(i, j) else { return 0.0 };
            let rise = |a: Option<f32>, b: Option<f32>| match (a, b) {
                (Some(a), Some(b)) => (b - a).abs() / 2.0,
                (Some(a), None) | (None, Some(a)) => (a - z).abs(),
                (None, None) => 0.0,
            };
            let (u, v) = (rise(at(i - 1, j), at(i + 1, j)), rise(at(i, j - 1), at(i, j + 1)));
            u.hypot(v) / lattice.s as f32
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::Replay;
    use super::super::near::voxels_near;
    use super::super::tests::{first_step, pocket, world};
    use super::*;
    use crate::base::Ctx;
    use crate::mesh::TriMesh;
    use crate::plan::StepKind;
    use crate::voxel::surface;
    use rand::RngExt;

    /// The pocket's first step for each cutter that has an [`End`].
    fn with_each_end(check: impl Fn(&Work)) {
        let mut w = pocket("generic-5axis");
        let frame = w.job.frame;
        w.job.target_mesh = surface(&w.job.target, &frame).unwrap();
        w.job.initial_mesh = surface(&w.job.initial, &frame).unwrap();
        let replay = Replay::of(&w.job, &w.plan).unwrap();
        let meshes = [&w.job.target_mesh, &w.job.initial_mesh];
        let surfaces = meshes.map(|m| voxels_near(m, &frame));
        for tool in w.job.cutters.iter().filter(|t| End::of(t).is_some()) {
            let ctx = Ctx::quiet();
            let work = first_step(&w, &replay, &surfaces, tool, &ctx);
            check(&work);
        }
    }

    /// A thin wall whose top is gone, with all its voxels near its surfaces, but their middles farther from them than a
    /// slender end is wide: such an end went down into it, between surfaces that it did not touch.
    #[test]
    fn a_slender_end_does_not_go_down_into_a_wall_without_its_top() {
        const WALL_MM: [f64; 2] = [9.1, 10.15];
        let in_wall = |x: f64| x > WALL_MM[0] && x < WALL_MM[1];
        let block = |p: DVec3| p.x > 2.0 && p.x < 14.0 && (p.y - 5.0).abs() < 3.0 && p.z < 12.0;
        let cut = |p: DVec3| (p.x > 5.0 && p.z > 8.0) || (p.x > WALL_MM[1] && p.z > 4.0);
        let size = DVec3::new(16.0, 10.0, 13.0);
        let mut w =
            world("generic-5axis", 0.5, size, block, &[(StepKind::Subtractive, DVec3::Z, cut)]);
        let frame = w.job.frame;
        w.job.target = BitGrid::from_fn(frame.dims, |v| {
            let p = frame.center(v);
            block(p) && (in_wall(p.x) || p.z < 4.0)
        });
        let boxed = |x: [f64; 2], z: f64| {
            TriMesh::cuboid(DVec3::new(x[0], 2.0, 0.0), DVec3::new(x[1], 8.0, z))
        };
        w.job.initial_mesh = boxed([2.0, 14.0], 12.0);
        w.job.target_mesh = TriMesh::joined(&[boxed([2.0, 14.0], 4.0), boxed(WALL_MM, 12.0)]);
        let replay = Replay::of(&w.job, &w.plan).unwrap();
        let surfaces = [&w.job.target_mesh, &w.job.initial_mesh].map(|m| voxels_near(m, &frame));
        let tool = w.job.cutters.iter().find(|t| t.name == "taper-0.6x30").unwrap();
        let ctx = Ctx::quiet();
        let work = first_step(&w, &replay, &surfaces, tool, &ctx);
        let free = Free::around(&work, work.after, tool.active_radius());
        let exact = Exact::of(&work, &free).unwrap().unwrap();
        let lowest = exact.heights(&work, &free, 0.25, 0.25, 0.0).unwrap();
        for x in [9.5, 9.6, 9.7, 9.75, 9.8] {
            let z = exact.lowest(DVec2::new(x, 5.25), &lowest);
            assert!(z > 7.6, "{x}: {z}");
        }
        // Beside the wall it goes down to the floor.
        let z = exact.lowest(DVec2::new(WALL_MM[1] + 0.9, 5.25), &lowest);
        assert!((z - 4.0).abs() < 0.01, "{z}");
    }

    #[test]
    fn whether_a_tip_is_free_is_what_the_lowest_says() {
        with_each_end(|work| {
            let free = Free::around(work, work.after, work.tool.active_radius());
            let exact = Exact::of(work, &free).unwrap().unwrap();
            let lowest = exact.heights(work, &free, 0.25, 0.25, 0.0).unwrap();
            let mut rng = crate::base::rng(3, 0);
            let (mut on, mut free_ones) = (None, 0);
            for _ in 0..2000 {
                let at = DVec2::new(rng.random_range(3.0..21.0), rng.random_range(2.0..17.0));
                let z = exact.lowest(at, &lowest);
                for most in [z - 0.5, z - 1e-9, z, z + 1e-9, z + 0.5, 3.0, 9.0, f64::INFINITY] {
                    let is_free = exact.is_free(at, most, &lowest, &mut on);
                    assert_eq!(is_free, z <= most, "{} at {at}: {z}, {most}", work.tool.name);
                    free_ones += usize::from(is_free);
                }
                let by = DVec2::new(rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0));
                assert!(
                    exact.least_guard(at + by, 1.5, &lowest) <= z,
                    "{} at {at}",
                    work.tool.name
                );
            }
            assert!(free_ones > 8000, "{free_ones}");
        });
    }

    /// Beside the region's columns the tips are those of the whole window; farther off there are none.
    #[test]
    fn tips_that_are_wanted_are_those_of_all() {
        with_each_end(|work| {
            let tips = |free: &Free| {
                let exact = Exact::of(work, free).unwrap().unwrap();
                exact.heights(work, free, 0.25, 0.25, 0.0).unwrap().tips
            };
            let all = tips(&Free::around(work, work.after, 12.0));
            let free = Free::around(work, work.after, 12.0).beside(work, 1.0);
            let some = tips(&free);
            let mut count = [0, 0];
            for c in (0..some.lattice.cells()).map(|i| some.lattice.cell_of_index(i)) {
                let is_wanted = free.wanted.runs(c[1]).iter().any(|r| r.contains(&c[0]));
                let apart = (some.at(c) - all.at(c)).abs();
                let want = if is_wanted { apart < 1e-5 } else { some.at(c) == f64::INFINITY };
                assert!(want, "{} {c:?}: {} {}", work.tool.name, some.at(c), all.at(c));
                count[usize::from(is_wanted)] += 1;
            }
            assert!(count.iter().all(|n| *n > 500), "{count:?}");
        });
    }
}
