//! Where a nozzle stands clear at a few voxels, by the definition itself.
//!
//! Off the grid axes the depth engine takes obstacle points for up to 0.7 voxels wider than they are, and a
//! needle between two of them for stuck: a crease that it gets into is then never filled. Here distances
//! are exact.
//!
//! Method: with its tip at voxel x a nozzle meets the obstacle o if (o − x)·d > f(|(o − x) × d|), f the nozzle's lower
//! surface. Obstacles next to the voxel come first, since they mostly are what is in the way; for the few
//! voxels that pass, boxes of obstacles are entered where any point in them might meet the nozzle.
//!
//! Guarantees: what is called clear is clear by the rules to the letter, and what [`nozzle_map`](super::nozzle_map)
//! calls clear is so here. Not guaranteed: speed; each pair of a voxel that is clear and a direction costs a look at
//! the surroundings of the whole nozzle.

use super::Scene;
use super::boxes::Boxes;
use super::depth::dipped;
use crate::base::{Aabb, DVec3, Direction};
use crate::machine::{Section, Tool};
use crate::voxel::BitGrid;
use std::ops::ControlFlow;
use std::sync::OnceLock;

/// Obstacles up to so many voxels away along each axis are looked at first.
const NEAR: i64 = 4;

/// A scene that nozzles are held against at a few voxels.
pub struct CloseNozzle<'a> {
    scene: &'a Scene,
    solid: &'a BitGrid,
    /// Of the solid, made when first asked for: most voxels are not open nearby.
    boxes: OnceLock<Boxes<'a>>,
}

impl<'a> CloseNozzle<'a> {
    /// `solid` is what the scene's voxels are the surface of.
    pub fn new(scene: &'a Scene, solid: &'a BitGrid) -> Self {
        CloseNozzle { scene, solid, boxes: OnceLock::new() }
    }

    pub fn scene(&self) -> &'a Scene {
        self.scene
    }

    /// Of some voxels those at which a nozzle meets nothing of the solid within a few voxels: no others are clear.
    pub fn open_nearby(
        &self,
        some: &[[usize; 3]],
        tool: &Tool,
        direction: Direction,
        dip_mm: f64,
    ) -> Vec<[usize; 3]> {
        let sections = dipped(tool, dip_mm);
        let side = 2 * NEAR + 1;
        let offset = |i: i64| [i % side, i / side % side, i / (side * side)].map(|c| c - NEAR);
        let is_met = |o: &[i64; 3]| {
            let from_tip = DVec3::from_array(o.map(|c| c as f64)) * self.scene.frame.pitch;
            may_meet(&sections, direction, from_tip, 0.0)
        };
        let mut near: Vec<[i64; 3]> = (0..side.pow(3)).map(offset).filter(is_met).collect();
        near.sort_by_key(|o| o.iter().map(|c| c * c).sum::<i64>());
        let is_open = |v: &&[usize; 3]| {
            let beside = |o: &[i64; 3]| std::array::from_fn(|a| v[a] as i64 + o[a]);
            !near.iter().any(|o| self.solid.get_or_empty(beside(o)))
        };
        some.iter().filter(is_open).copied().collect()
    }

    /// Of `few` the voxels at which a nozzle stands clear of the scene, inner voxels of its solid included, along a
    /// direction. Sections that reach the tip may stand `dip_mm` lower than the obstacles allow.
    pub fn clear(
        &self,
        few: &[[usize; 3]],
        tool: &Tool,
        direction: Direction,
        dip_mm: f64,
    ) -> Vec<[usize; 3]> {
        let (scene, frame) = (self.scene, &self.scene.frame);
        let sections = dipped(tool, dip_mm);
        let may_meet =
            |from_tip: DVec3, within: f64| may_meet(&sections, direction, from_tip, within);
        let is_met = |from_tip: DVec3| may_meet(from_tip, 0.0);
        let open = self.open_nearby(few, tool, direction, dip_mm);
        let mut open: Vec<([usize; 3], DVec3)> =
            open.into_iter().map(|v| (v, frame.center(v))).collect();
        if open.is_empty() {
            return Vec::new();
        }
        let boxes = self.boxes.get_or_init(|| Boxes::new(frame, self.solid));
        // What one nozzle meets the next one, beside it, mostly meets as well.
        let mut met: Option<DVec3> = None;
        open.retain(|(_, tip)| {
            if met.is_some_and(|o| is_met(o - *tip)) {
                return false;
            }
            let may = |centre: DVec3, within: f64| may_meet(centre - *tip, within);
            let each = &mut |v| {
                let at = frame.center(v);
                if !is_met(at - *tip) {
                    return ControlFlow::Continue(());
                }
                met = Some(at);
                ControlFlow::Break(())
            };
            boxes.visit(&may, each).is_continue()
        });
        // Most fixed points are a base plate's, out of the way of all the few.
        let around = Aabb {
            min: open.iter().fold(DVec3::INFINITY, |least, (_, tip)| least.min(*tip)),
            max: open.iter().fold(DVec3::NEG_INFINITY, |most, (_, tip)| most.max(*tip)),
        };
        let (middle, spread) = (around.center(), around.size().length() / 2.0);
        let fixed: Vec<(DVec3, f64, &[DVec3])> = scene
            .groups()
            .map(|(b, points)| (b.center(), b.size().length() / 2.0, points))
            .filter(|(centre, within, _)| may_meet(*centre - middle, within + spread))
            .collect();
        open.retain(|(_, tip)| {
            !fixed.iter().any(|(centre, within, points)| {
                may_meet(*centre - *tip, *within) && points.iter().any(|p| is_met(*p - *tip))
            })
        });
        open.into_iter().map(|(v, _)| v).collect()
    }
}

/// Whether a nozzle of such sections may meet any point up to `within` mm from one so far from its tip.
fn may_meet(
    sections: &[(Section, f64)],
    direction: Direction,
    from_tip: DVec3,
    within: f64,
) -> bool {
    let over = direction.dot(from_tip) + within;
    if over <= 0.0 {
        return false;
    }
    let aside = (from_tip.cross(direction.vec()).length() - within).max(0.0);
    sections.iter().any(|(s, lift)| over > s.shape.lower_surface(aside) + lift)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::access::{nozzle_map, reachable};
    use crate::base::fibonacci_sphere;
    use crate::machine::{Shape, ToolKind};
    use crate::voxel::Frame;

    const FRAME: Frame = Frame { pitch: 0.5, dims: [30, 26, 24], origin: DVec3::ZERO };

    /// A needle under a cone under a head.
    fn needle() -> Tool {
        let frustum = |z0, r0, z1, r1| Shape::Frustum { z0, r0, z1, r1 };
        let shapes =
            [frustum(0.0, 0.2, 2.0, 0.2), frustum(2.0, 0.2, 6.0, 2.0), Shape::Platform { z: 8.0 }];
        let section = |(i, shape)| Section { shape, active: i == 0 };
        Tool::new(
            "needle",
            ToolKind::Additive,
            shapes.into_iter().enumerate().map(section).collect(),
        )
    }

    /// Two blocks with a crease between them, and a pin beside.
    fn state() -> BitGrid {
        BitGrid::from_fn(FRAME.dims, |[x, y, z]| {
            z < 3
                || z < 14 && x + z / 3 < 11
                || z < 11 && x > 14 + z / 4
                || (x, y) == (13, 5) && z < 20
        })
    }

    /// Every voxel, held against the definition, and against the maps, which are on the safe side.
    #[test]
    fn a_nozzle_is_clear_where_it_meets_nothing() {
        let (state, tool, dip) = (state(), needle(), 0.3);
        let fixed = [DVec3::new(4.0, 9.0, 9.5)];
        let scene = Scene::new(&FRAME, &state, &fixed);
        let air = BitGrid::from_fn(FRAME.dims, |v| !state.get(v) && v[0] % 2 == v[2] % 2);
        let mut more = 0;
        for d in fibonacci_sphere(24).into_iter().chain([Direction::Z, Direction::X]) {
            let all: Vec<[usize; 3]> = air.iter_ones().collect();
            let mut clear = BitGrid::new(FRAME.dims);
            let found = CloseNozzle::new(&scene, &state).clear(&all, &tool, d, dip);
            found.into_iter().for_each(|v| clear.set(v, true));
            let plane = d.image_plane();
            let is_clear = |v: [usize; 3]| {
                let (tip, z) = (plane.across(FRAME.center(v)), plane.height(FRAME.center(v)));
                let solid = state.iter_ones().map(|o| FRAME.center(o));
                solid.chain(fixed).all(|o| {
                    let (rho, over) = (plane.across(o).distance(tip), plane.height(o) - z);
                    let lift = |s: &Shape| if s.lower_surface(0.0) == 0.0 { dip } else { 0.0 };
                    let is_under =
                        |s: &Section| over <= s.shape.lower_surface(rho) + lift(&s.shape) + 1e-9;
                    over <= 0.0 || tool.sections.iter().all(is_under)
                })
            };
            let want = BitGrid::from_fn(FRAME.dims, |v| air.get(v) && is_clear(v));
            assert!(clear.minus(&want).is_empty(), "{d:?}");
            // Points on the very edge of a section go either way.
            assert!(want.minus(&clear).count() <= 2, "{d:?}: {}", want.minus(&clear).count());
            let map = nozzle_map(&scene, &air, &tool, d, dip);
            let mapped = reachable(&map, &air, &FRAME);
            assert!(mapped.minus(&clear).count() <= 2, "{d:?}: {}", mapped.minus(&clear).count());
            more += clear.minus(&mapped).count();
        }
        assert!(more > 100, "{more}");
    }
}
