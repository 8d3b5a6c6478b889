//! Obstacle points seen along a direction, and whether a tool touches one.
//!
//! Method: the highest point of every (u, v) cell, under a pyramid of maxima; a query descends
//! where the tool's lower surface at the nearest radius of a block lies under the block's maximum.
//! Guarantees: a point that is kept is tested exactly. Not guaranteed: along other directions than
//! the grid's, a lower point of a cell may touch from up to a cell's diagonal away.

use crate::base::{DVec2, DVec3, ImagePlane};
use crate::machine::Tool;

pub(super) struct Skyline {
    plane: ImagePlane,
    origin: DVec2,
    cell: f64,
    /// Finest first; each level halves both counts.
    levels: Vec<Level>,
    /// Highest point of each finest cell.
    points: Vec<Option<DVec3>>,
}

struct Level {
    n: [usize; 2],
    max: Vec<f64>,
}

/// Most cells of the finest level; coarser cells only make the test of a cell's lower points less
/// exact.
const MOST_CELLS: f64 = 3e7;

/// Level and coordinates of blocks to look at, kept from query to query.
pub(super) type Blocks = Vec<(usize, [usize; 2])>;

impl Skyline {
    /// `anchor` is the centre of some cell; `cell` its side, mm.
    pub fn new(points: &[DVec3], plane: ImagePlane, anchor: DVec3, cell: f64) -> Skyline {
        let (mut lo, mut hi) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        for p in points {
            let uv = plane.across(*p);
            (lo, hi) = (lo.min(uv), hi.max(uv));
        }
        if points.is_empty() {
            (lo, hi) = (DVec2::ZERO, DVec2::ZERO);
        }
        let mut cell = cell;
        while ((hi.x - lo.x) / cell + 2.0) * ((hi.y - lo.y) / cell + 2.0) > MOST_CELLS {
            cell *= 2.0;
        }
        // The lowest corner of the cell that is centred on a multiple of cells from the anchor.
        let start = plane.across(anchor) - DVec2::splat(cell / 2.0);
        let origin = start + ((lo - start) / cell).floor() * cell;
        let n = ((hi - origin) / cell).floor() + DVec2::ONE;
        let n = [n.x as usize, n.y as usize];
        let mut top: Vec<Option<DVec3>> = vec![None; n[0] * n[1]];
        for p in points {
            let uv = plane.across(*p);
            // Not below the origin: cutting off the fraction is the floor.
            let g = (uv - origin) / cell;
            let at = g.x as usize + n[0] * g.y as usize;
            let q = uv.extend(plane.height(*p));
            if top[at].is_none_or(|t| t.z < q.z) {
                top[at] = Some(q);
            }
        }
        let max = top.iter().map(|p| p.map_or(f64::NEG_INFINITY, |p| p.z)).collect();
        let mut levels = vec![Level { n, max }];
        while let Some(last) = levels.last().filter(|l| l.n[0] * l.n[1] > 1) {
            let coarser = last.halved();
            levels.push(coarser);
        }
        Skyline { plane, origin, cell, levels, points: top }
    }

    /// A point inside the tool that stands with its tip on `tip`, when the tool is shrunk by `side`
    /// (mm) inward and the points are lowered by `down` (negative: grown, raised); none when it is
    /// free. `stack` may hold anything.
    pub fn touched(
        &self,
        tool: &Tool,
        tip: DVec3,
        [side, down]: [f64; 2],
        stack: &mut Blocks,
    ) -> Option<DVec3> {
        let (uv, z) = (self.plane.across(tip), self.plane.height(tip));
        stack.clear();
        stack.push((self.levels.len() - 1, [0usize; 2]));
        while let Some((k, c)) = stack.pop() {
            let level = &self.levels[k];
            let top = level.max[c[0] + level.n[0] * c[1]];
            if top - down <= z {
                continue;
            }
            if k == 0 {
                if let Some(p) = self.points[c[0] + level.n[0] * c[1]] {
                    let rho = (p.truncate().distance(uv) + side).max(0.0);
                    if p.z - down > z + tool.lower_surface(rho) {
                        return Some(self.plane.world(p.truncate(), p.z));
                    }
                }
                continue;
            }
            let size = self.cell * (1u64 << k) as f64;
            let low = self.origin + DVec2::new(c[0] as f64, c[1] as f64) * size;
            let nearest = uv.clamp(low, low + DVec2::splat(size));
            if top - down <= z + tool.lower_surface((nearest.distance(uv) + side).max(0.0)) {
                continue;
            }
            let finer = self.levels[k - 1].n;
            for (i, j) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                let child = [2 * c[0] + i, 2 * c[1] + j];
                if child[0] < finer[0] && child[1] < finer[1] {
                    stack.push((k - 1, child));
                }
            }
        }
        None
    }
}

impl Level {
    fn halved(&self) -> Level {
        let n = [self.n[0].div_ceil(2), self.n[1].div_ceil(2)];
        let mut max = vec![f64::NEG_INFINITY; n[0] * n[1]];
        for (i, z) in self.max.iter().enumerate() {
            let at = (i % self.n[0]) / 2 + n[0] * ((i / self.n[0]) / 2);
            max[at] = max[at].max(*z);
        }
        Level { n, max }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Direction;
    use crate::machine::Tool;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_query_is_the_plain_loop(
            cells in proptest::collection::vec((0i32..40, 0i32..40, 0f64..60.0), 1..60),
            tip in (-10f64..50.0, -10f64..50.0, -20f64..60.0),
        ) {
            let tool = Tool::builtin("w2v-cutter").unwrap();
            // One point a cell: nothing is hidden.
            let mut points: Vec<DVec3> = Vec::new();
            for (x, y, z) in cells {
                let p = DVec3::new(f64::from(x), f64::from(y), z);
                if !points.iter().any(|q| q.truncate() == p.truncate()) {
                    points.push(p);
                }
            }
            let plane = Direction::Z.image_plane();
            let sky = Skyline::new(&points, plane, DVec3::ZERO, 1.0);
            let tip = DVec3::new(tip.0, tip.1, tip.2);
            let plain = points.iter().any(|p| {
                let rho = p.truncate().distance(tip.truncate());
                p.z - 0.3 > tip.z + tool.lower_surface(rho + 0.2)
            });
            prop_assert_eq!(sky.touched(&tool, tip, [0.2, 0.3], &mut Vec::new()).is_some(), plain);
        }
    }
}
