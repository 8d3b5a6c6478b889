//! Obstacle points under a tool: the height at which a tip first stands free, by branch and bound.
//!
//! The points are bucketed into square cells of the image plane, highest first within a cell; over
//! the cells lies a pyramid of greatest heights. The lowest free height of a tip is
//! H(t) = max over obstacles o of o_z − f(ρ). A node whose greatest height less the bound of f at
//! its nearest distance does not exceed the best found holds no point that would.
//!
//! All solid voxels are kept, not only those of the surface. Along an oblique direction no two
//! centres share their (u, v), and a thin tool's edge can pass between surface centres and hold an
//! inner one: dropping inner voxels would accept that collision. Along a grid axis a voxel under
//! a solid voxel has the same ρ and a lesser height, so only column tops matter, exactly.

use super::profile::Profile;
use super::replay::Site;
use crate::base::{DVec2, ImagePlane};
use crate::voxel::{BitGrid, Frame};
use rayon::prelude::*;

/// (u, v, height) of an obstacle point, mm.
#[derive(Clone, Copy, Debug)]
struct Point {
    at: DVec2,
    z: f64,
}

pub(super) struct Skyline {
    corner: DVec2,
    cell: f64,
    /// From cells (level 0) to the root; −∞ where there is nothing.
    levels: Vec<Level>,
    /// Points of cell c: `points[starts[c]..starts[c + 1]]`, highest first.
    starts: Vec<usize>,
    points: Vec<Point>,
}

struct Level {
    nu: usize,
    nv: usize,
    top: Vec<f64>,
}

/// What the tips of one step may look like: a box of (u, v) and a least height. Points that cannot
/// lift any such tip above that height are left out.
#[derive(Clone, Copy, Debug)]
pub(super) struct TipBounds {
    pub min: DVec2,
    pub max: DVec2,
    pub floor: f64,
}

/// Most cells of a skyline: 32 MiB of heights. A wide table makes cells coarser, never more.
const MOST_CELLS: f64 = 4_194_304.0;

impl Skyline {
    pub fn new(site: &Site, tool: &Profile, tips: TipBounds) -> Skyline {
        let mut points = solid_points(site, tool, tips);
        let fixed = site.fixed.iter().map(|p| point(&site.plane, *p));
        points.extend(fixed.filter(|p| tips.can_meet(p, tool)));
        Skyline::of(points, site.frame.pitch)
    }

    fn of(points: Vec<Point>, pitch: f64) -> Skyline {
        let (mut lo, mut hi) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        for p in &points {
            (lo, hi) = (lo.min(p.at), hi.max(p.at));
        }
        if points.is_empty() {
            (lo, hi) = (DVec2::ZERO, DVec2::ZERO);
        }
        let span = hi - lo;
        let cell = pitch.max((span.x * span.y / MOST_CELLS).sqrt()).max(span.max_element() / 1e6);
        // Half a cell of margin: along a grid axis every column then has its cell's middle.
        let corner = lo - DVec2::splat(0.5 * cell);
        let (nu, nv) = ((span.x / cell) as usize + 2, (span.y / cell) as usize + 2);
        let cell_of = |p: &Point| {
            let c = (p.at - corner) / cell;
            (c.x as usize).min(nu - 1) + nu * (c.y as usize).min(nv - 1)
        };
        let mut starts = vec![0usize; nu * nv + 1];
        points.iter().for_each(|p| starts[cell_of(p) + 1] += 1);
        for c in 0..nu * nv {
            starts[c + 1] += starts[c];
        }
        let mut next = starts.clone();
        let mut sorted = vec![Point { at: DVec2::ZERO, z: 0.0 }; points.len()];
        for p in points {
            let slot = &mut next[cell_of(&p)];
            sorted[*slot] = p;
            *slot += 1;
        }
        sort_cells(&mut sorted, &starts, nu);
        let top = (0..nu * nv)
            .map(|c| sorted[starts[c]..starts[c + 1]].first().map_or(f64::NEG_INFINITY, |p| p.z))
            .collect();
        let levels = pyramid(Level { nu, nv, top });
        Skyline { corner, cell, levels, starts, points: sorted }
    }

    /// The lowest height, at or above `floor`, at which a tip at `at` meets nothing: the greatest
    /// of `floor` and o_z − f(ρ). Stops early with some value above `ceiling` when one is found.
    pub fn lowest_free(&self, tool: &Profile, at: DVec2, floor: f64, ceiling: f64) -> f64 {
        let mut best = floor;
        // A level pushes at most 4 and the loop pops one: 3 a level; 22 levels hold 4 M cells.
        let mut stack = [(0.0f64, 0usize, 0usize, 0usize); 128];
        let root = self.levels.len() - 1;
        stack[0] = (self.bound(tool, at, root, 0, 0), root, 0, 0);
        let mut held = 1;
        while held > 0 {
            held -= 1;
            let (bound, level, i, j) = stack[held];
            if bound <= best {
                continue;
            }
            if level == 0 {
                best = self.scan(tool, at, (i, j), bound, best);
                if best > ceiling {
                    return best;
                }
                continue;
            }
            let below = &self.levels[level - 1];
            let first = held;
            for (a, b) in
                [(2 * i, 2 * j), (2 * i + 1, 2 * j), (2 * i, 2 * j + 1), (2 * i + 1, 2 * j + 1)]
            {
                if a >= below.nu || b >= below.nv || below.top[a + below.nu * b] <= best {
                    continue;
                }
                let bound = self.bound(tool, at, level - 1, a, b);
                if bound > best {
                    stack[held] = (bound, level - 1, a, b);
                    held += 1;
                }
            }
            // Most promising last, so that it is taken first.
            stack[first..held].sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        }
        best
    }

    /// No point of the node reaches o_z − f(ρ) above this.
    fn bound(&self, tool: &Profile, at: DVec2, level: usize, i: usize, j: usize) -> f64 {
        let l = &self.levels[level];
        let side = self.cell * (1u64 << level) as f64;
        let lo = self.corner + DVec2::new(i as f64, j as f64) * side;
        let off = (lo - at).max(at - lo - DVec2::splat(side)).max(DVec2::ZERO);
        l.top[i + l.nu * j] - tool.lower_bound(off.length())
    }

    fn scan(
        &self,
        tool: &Profile,
        at: DVec2,
        (i, j): (usize, usize),
        bound: f64,
        mut best: f64,
    ) -> f64 {
        let c = i + self.levels[0].nu * j;
        let least = self.levels[0].top[c] - bound;
        for p in &self.points[self.starts[c]..self.starts[c + 1]] {
            if p.z - least <= best {
                break;
            }
            best = best.max(p.z - tool.over_obstacle(p.at.distance(at)));
        }
        best
    }
}

impl TipBounds {
    fn can_meet(&self, p: &Point, tool: &Profile) -> bool {
        if p.z <= self.floor {
            return false; // f ≥ 0
        }
        let off = (self.min - p.at).max(p.at - self.max).max(DVec2::ZERO);
        p.z - tool.lower_bound(off.length()) > self.floor
    }
}

fn point(plane: &ImagePlane, p: crate::base::DVec3) -> Point {
    Point { at: plane.across(p), z: plane.height(p) }
}

fn solid_points(site: &Site, tool: &Profile, tips: TipBounds) -> Vec<Point> {
    let layers = site.frame.dims[2];
    let up = site.direction.is_grid_axis().then(|| {
        let d = site.direction.vec();
        [d.x as i64, d.y as i64, d.z as i64]
    });
    let slabs: Vec<Vec<Point>> = (0..layers)
        .into_par_iter()
        .map(|z| {
            let mut points = Vec::new();
            for v in ones_of_layer(site.solid, z) {
                if up.is_some_and(|up| covered(site.solid, v, up)) {
                    continue;
                }
                let p = voxel_point(&site.plane, site.frame, v);
                if tips.can_meet(&p, tool) {
                    points.push(p);
                }
            }
            points
        })
        .collect();
    slabs.concat()
}

fn voxel_point(plane: &ImagePlane, frame: &Frame, v: [usize; 3]) -> Point {
    point(plane, frame.center(v))
}

fn covered(solid: &BitGrid, v: [usize; 3], up: [i64; 3]) -> bool {
    solid.get_or_empty(std::array::from_fn(|a| v[a] as i64 + up[a]))
}

/// Solid voxels of a layer in x, y order.
fn ones_of_layer(grid: &BitGrid, z: usize) -> impl Iterator<Item = [usize; 3]> + '_ {
    (0..grid.dims()[1]).flat_map(move |y| ones_of_row(grid.row(y, z)).map(move |x| [x, y, z]))
}

/// Set bits of a row in order.
pub(super) fn ones_of_row(row: &[u64]) -> impl Iterator<Item = usize> + '_ {
    row.iter().enumerate().flat_map(|(i, word)| {
        let mut rest = *word;
        std::iter::from_fn(move || {
            (rest != 0).then(|| {
                let bit = rest.trailing_zeros() as usize;
                rest &= rest - 1;
                i * 64 + bit
            })
        })
    })
}

/// Sorts the points of each cell from high to low.
fn sort_cells(points: &mut [Point], starts: &[usize], nu: usize) {
    let mut strips = Vec::new();
    let mut rest = points;
    for strip in starts[..starts.len() - 1].chunks(nu).enumerate() {
        let (row, cells) = strip;
        let end = starts[row * nu + cells.len()];
        let (head, tail) = rest.split_at_mut(end - cells[0]);
        strips.push((cells[0], row * nu, head));
        rest = tail;
    }
    strips.par_iter_mut().for_each(|(offset, first_cell, strip)| {
        for c in *first_cell..*first_cell + nu {
            let range = starts[c] - *offset..starts[c + 1] - *offset;
            strip[range].sort_unstable_by(|a, b| b.z.total_cmp(&a.z));
        }
    });
}

fn pyramid(cells: Level) -> Vec<Level> {
    let mut levels = vec![cells];
    while let Some(l) = levels.last().filter(|l| l.nu * l.nv > 1) {
        let (nu, nv) = (l.nu.div_ceil(2), l.nv.div_ceil(2));
        let mut top = vec![f64::NEG_INFINITY; nu * nv];
        for j in 0..l.nv {
            for i in 0..l.nu {
                let up = &mut top[i / 2 + nu * (j / 2)];
                *up = up.max(l.top[i + l.nu * j]);
            }
        }
        levels.push(Level { nu, nv, top });
    }
    levels
}
