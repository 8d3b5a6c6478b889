//! What of a step's region still stands while it is cut, and whether shank, holder or head run into it.
//!
//! Method: the region's voxel centres by (u, v) cell, each cell's by height. In the order of the moves the edge takes
//! from above what it comes within a slack of; after that the parts that do not cut, shrunk by the slack, are held
//! against the highest centre that each cell still has. Blocks of cells under an upper bound of these heights, and the
//! bound over all, spare nearly all looks. Guarantees: what is reported happens at a sampled position, with a centre
//! that no earlier sample had come near. Not guaranteed: contact shallower than the slack, which is half a pitch along the
//! axes of the grid and 1.2 pitches along other directions, whose cells hold several columns.

use super::interpret::{Gait, Motion};
use super::report::{Finding, Rule};
use super::sweep::{Scene, Told, WRITTEN_MM, samples};
use crate::base::{DVec2, DVec3, Direction, ImagePlane};
use crate::machine::Tool;
use crate::toolpath::Cells;
use crate::voxel::{BitGrid, Frame};

/// Cells along a block's side.
const BLOCK: usize = 16;

struct Standing<'a> {
    tool: &'a Tool,
    plane: ImagePlane,
    cells: Cells,
    /// Heights of the centres, of each cell rising.
    heights: Vec<f64>,
    /// First and past the last that stands of `heights`, of each cell.
    stand: Vec<[u32; 2]>,
    /// The last that stands of each cell; below everything where none does.
    tops: Vec<f64>,
    blocks: Cells,
    /// Not below the highest centre that stands in each block.
    bounds: Vec<f64>,
    /// Not below any of the bounds.
    bound: f64,
    /// See the module's head, mm.
    slack: f64,
    /// Where the lowest of what does not cut begins over the tip, mm.
    clear: f64,
    /// How far from the axis that reaches, mm.
    reach: f64,
}

impl<'a> Standing<'a> {
    /// None when nothing of the tool but its edge gets down to the region with its tip no lower than `lowest_tip`.
    fn new(
        tool: &'a Tool,
        direction: Direction,
        frame: &Frame,
        region: &BitGrid,
        lowest_tip: f64,
    ) -> Option<Self> {
        let (plane, h) = (direction.image_plane(), frame.pitch);
        let idle = || tool.sections.iter().filter(|s| !s.active).map(|s| &s.shape);
        let clear = idle().map(|s| s.bottom()).fold(f64::INFINITY, f64::min);
        let seen = |v| {
            let p = frame.center(v);
            plane.across(p).extend(plane.height(p))
        };
        let centers: Vec<DVec3> = region.iter_ones().map(seen).collect();
        let bound = centers.iter().map(|p| p.z).fold(f64::NEG_INFINITY, f64::max);
        let (mut lo, mut hi) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        for p in &centers {
            (lo, hi) = (lo.min(p.truncate()), hi.max(p.truncate()));
        }
        let aside =
            if direction.is_grid_axis() { 0.0 } else { h * std::f64::consts::FRAC_1_SQRT_2 };
        let slack = h / 2.0 + WRITTEN_MM + aside;
        if bound <= lowest_tip + clear + slack {
            return None;
        }
        // Along the grid every column stands over the middle of its cell.
        let cells = Cells::over(lo - DVec2::splat(h / 2.0), hi + DVec2::splat(h / 2.0), h);
        let mut by_cell: Vec<(usize, f64)> =
            centers.iter().filter_map(|p| Some((cells.at(p.truncate())?, p.z))).collect();
        by_cell.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
        let mut stand = vec![[0u32; 2]; cells.count()];
        let mut tops = vec![f64::NEG_INFINITY; cells.count()];
        for (k, run) in by_cell.chunk_by(|a, b| a.0 == b.0).scan(0, |from, run| {
            let first = *from;
            *from += run.len();
            Some((first, run))
        }) {
            let (cell, top) = run[run.len() - 1];
            stand[cell] = [k as u32, (k + run.len()) as u32];
            tops[cell] = top;
        }
        let blocks = Cells::over(cells.origin, cells.end(), h * BLOCK as f64);
        let mut all = Standing {
            tool,
            plane,
            cells,
            heights: by_cell.into_iter().map(|(_, z)| z).collect(),
            stand,
            tops,
            blocks,
            bounds: vec![f64::NEG_INFINITY; blocks.count()],
            bound,
            slack,
            clear,
            reach: idle().map(|s| s.max_radius()).fold(0.0, f64::max),
        };
        for b in 0..blocks.count() {
            all.bounds[b] = all.highest(b);
        }
        Some(all)
    }

    fn cells_of(&self, block: usize) -> impl Iterator<Item = usize> + use<> {
        let [i, j] = [block % self.blocks.n[0], block / self.blocks.n[0]].map(|k| k * BLOCK);
        let [nu, nv] = self.cells.n;
        let past = [(i + BLOCK).min(nu), (j + BLOCK).min(nv)];
        (j..past[1]).flat_map(move |y| (i..past[0]).map(move |x| x + nu * y))
    }

    fn highest(&self, block: usize) -> f64 {
        self.cells_of(block).map(|c| self.tops[c]).fold(f64::NEG_INFINITY, f64::max)
    }

    /// Middle of a cell.
    fn middle(cells: &Cells, at: usize) -> DVec2 {
        let [i, j] = [at % cells.n[0], at / cells.n[0]].map(|k| k as f64 + 0.5);
        cells.origin + DVec2::new(i, j) * cells.side
    }

    /// Takes what the edge with its tip at a place comes near.
    fn cut(&mut self, uv: DVec2, z: f64) {
        let reach = DVec2::splat(self.tool.active_radius() + self.slack);
        for row in self.cells.rows_within(uv - reach, uv + reach) {
            for c in row {
                // No edge reaches below its tip.
                if self.tops[c] < z - self.slack {
                    continue;
                }
                self.cut_cell(c, uv, z);
            }
        }
    }

    fn cut_cell(&mut self, c: usize, uv: DVec2, z: f64) {
        let [from, mut to] = self.stand[c];
        let rho = (Self::middle(&self.cells, c).distance(uv) - self.slack).max(0.0);
        let lowest = z + self.tool.active_lower_surface(rho) - self.slack;
        while from < to && self.heights[to as usize - 1] >= lowest {
            to -= 1;
        }
        self.stand[c] = [from, to];
        let highest = (from < to).then(|| self.heights[to as usize - 1]);
        self.tops[c] = highest.unwrap_or(f64::NEG_INFINITY);
    }

    /// A centre inside what does not cut of the tool with its tip at a place.
    fn met(&mut self, uv: DVec2, z: f64) -> Option<DVec3> {
        let (slack, tool) = (self.slack, self.tool);
        if self.bound <= z + self.clear + slack {
            return None;
        }
        let idle = |rho: f64| {
            let shapes = tool.sections.iter().filter(|s| !s.active).map(|s| &s.shape);
            z + slack + shapes.map(|s| s.lower_surface(rho + slack)).fold(f64::INFINITY, f64::min)
        };
        let reach = DVec2::splat(self.reach.min((self.cells.end() - self.cells.origin).length()));
        let side = DVec2::splat(self.blocks.side);
        for b in self.blocks.within(uv - reach, uv + reach) {
            let middle = Self::middle(&self.blocks, b);
            let nearest = uv.clamp(middle - side / 2.0, middle + side / 2.0).distance(uv);
            if self.bounds[b] <= idle(nearest) {
                continue;
            }
            for c in self.cells_of(b) {
                let (at, top) = (Self::middle(&self.cells, c), self.tops[c]);
                if top <= z + self.clear + slack {
                    continue;
                }
                if top > idle(at.distance(uv)) {
                    return Some(self.plane.world(at, top));
                }
            }
            self.bounds[b] = self.highest(b);
        }
        self.bound = self.bounds.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        None
    }
}

/// What runs into the region before the edge has taken it.
pub(super) fn holders(scene: &Scene, motions: &[Motion]) -> Vec<Finding> {
    let plane = scene.step.direction.image_plane();
    let feeds = || motions.iter().filter(|m| m.gait == Gait::Feed);
    let lowest = feeds().map(|m| plane.height(m.to)).fold(f64::INFINITY, f64::min);
    let step = scene.step;
    let standing = Standing::new(scene.tool, step.direction, scene.frame, &step.region, lowest);
    let Some(mut standing) = standing else { return Vec::new() };
    let mut told = Told::new(Rule::Holder);
    for m in feeds().take_while(|_| scene.ctx.check().is_ok()) {
        let mut met = None;
        for p in samples(m, scene.frame.pitch / 2.0) {
            let (uv, z) = (plane.across(p), plane.height(p));
            standing.cut(uv, z);
            met = met.or_else(|| standing.met(uv, z));
        }
        if let Some(o) = met {
            let message = format!("shank or holder runs into ({o:.2}), which is still to be cut");
            told.tell(m.line, message);
        }
    }
    told.findings
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::machine::{Section, Shape, ToolKind};
    use rand::{RngExt, SeedableRng};
    use rand_xoshiro::Xoshiro256PlusPlus as Random;

    fn cutter() -> Tool {
        let part = |z0: f64, z1: f64, r: f64, active: bool| Section {
            shape: Shape::Frustum { z0, r0: r, z1, r1: r },
            active,
        };
        let sections = vec![
            part(0.0, 4.0, 1.0, true),
            part(4.0, 6.0, 0.8, false),
            part(6.0, 20.0, 3.0, false),
        ];
        Tool::new("cutter", ToolKind::Subtractive, sections)
    }

    /// Every centre that stands is looked at, at every place.
    fn plainly(
        tool: &Tool,
        d: Direction,
        standing: &mut Vec<DVec3>,
        tip: DVec3,
        slack: f64,
    ) -> bool {
        let plane = d.image_plane();
        let (at, z) = (plane.across(tip), plane.height(tip));
        let aside = |p: &DVec3| plane.across(*p).distance(at);
        standing.retain(|p| {
            let rho = (aside(p) - slack).max(0.0);
            plane.height(*p) < z + tool.active_lower_surface(rho) - slack
        });
        let shapes = || tool.sections.iter().filter(|s| !s.active).map(|s| &s.shape);
        standing.iter().any(|p| {
            let rho = aside(p) + slack;
            let lowest = shapes().map(|s| s.lower_surface(rho)).fold(f64::INFINITY, f64::min);
            plane.height(*p) > z + slack + lowest
        })
    }

    #[test]
    fn what_is_met_is_what_a_look_at_every_centre_finds() {
        let mut rng = Random::seed_from_u64(7);
        let tool = cutter();
        let (mut met, mut free) = (0, 0);
        for d in [Direction::Z, Direction::NEG_Y, Direction::X] {
            for _ in 0..20 {
                let frame = Frame { pitch: 0.5, dims: [40, 36, 38], origin: DVec3::splat(-9.0) };
                let depth: Vec<usize> = (0..40 * 36).map(|_| rng.random_range(0..38)).collect();
                let region = BitGrid::from_fn(frame.dims, |v| depth[v[0] + 40 * v[1]] > v[2]);
                let mut centers: Vec<DVec3> = region.iter_ones().map(|v| frame.center(v)).collect();
                let plane = d.image_plane();
                let mut all = Standing::new(&tool, d, &frame, &region, -12.0).unwrap();
                for k in 0..120 {
                    let span = |rng: &mut Random| rng.random_range(-10.0..10.0);
                    let uv = DVec2::new(span(&mut rng), span(&mut rng));
                    // Ever deeper, as a program goes.
                    let z = 9.0 - 0.15 * f64::from(k) + rng.random_range(-0.5..0.5);
                    let plain = plainly(&tool, d, &mut centers, plane.world(uv, z), all.slack);
                    all.cut(uv, z);
                    assert_eq!(all.met(uv, z).is_some(), plain, "{d:?} {k}");
                    *if plain { &mut met } else { &mut free } += 1;
                }
                let left: usize = all.stand.iter().map(|[from, to]| (to - from) as usize).sum();
                assert_eq!(left, centers.len());
            }
        }
        assert!(met > 500 && free > 500, "{met} {free}");
    }

    /// Along other directions a column's cell is only near it: what is met there is met.
    #[test]
    fn aslant_nothing_is_met_that_is_not_there() {
        let mut rng = Random::seed_from_u64(8);
        let tool = cutter();
        let d = Direction::new(DVec3::new(1.0, 2.0, 2.0)).unwrap();
        let frame = Frame { pitch: 0.5, dims: [30; 3], origin: DVec3::splat(-7.5) };
        let solid: Vec<bool> = (0..27000).map(|_| rng.random_bool(0.3)).collect();
        let region = BitGrid::from_fn(frame.dims, |v| solid[v[0] + 30 * (v[1] + 30 * v[2])]);
        let mut centers: Vec<DVec3> = region.iter_ones().map(|v| frame.center(v)).collect();
        let mut all = Standing::new(&tool, d, &frame, &region, -12.0).unwrap();
        let (mut met, mut missed) = (0, 0);
        for k in 0..150 {
            let span = |rng: &mut Random| rng.random_range(-10.0..10.0);
            let uv = DVec2::new(span(&mut rng), span(&mut rng));
            let z = 12.0 - 0.15 * f64::from(k);
            let plain = plainly(&tool, d, &mut centers, d.image_plane().world(uv, z), 0.26);
            all.cut(uv, z);
            match (all.met(uv, z).is_some(), plain) {
                (true, true) => met += 1,
                (true, false) => panic!("{k}"),
                (false, true) => missed += 1,
                (false, false) => {}
            }
        }
        assert!(met > 10 && missed < met, "{met} {missed}");
    }
}
