//! Which pieces of the meshes still stand.
//!
//! Method: a triangle is divided until all of a piece stands or nothing of it does, by the nearest voxel on either side
//! of it; large pieces near no voxel that stands are not divided at all.
//!
//! Guarantees: what is found stands to a voxel, on whichever side of a single triangle the solid is. Not
//! guaranteed: within a voxel of the rim of what stands.

use super::mill::Work;
use crate::base::{DVec2, DVec3};
use crate::mesh::TriMesh;
use crate::voxel::{BitGrid, Frame};
use rayon::prelude::*;

/// Pieces with shorter sides, in pitches, are judged by their corners and middle.
const JUDGED_PITCH: f64 = 4.0;

/// The solid behind a point of a surface is looked for so far from it, in pitches, in so many steps: it lies up to half a
/// voxel's diagonal from the face between voxels.
const ASIDE_PITCH: f64 = 0.9;
const LOOKS: u32 = 9;

/// Whether voxels lost what is behind a point of a surface, as they do along edges sharper than they
/// are wide: around the point some of the `whole` stands and none of it is gone.
fn lost(p: DVec3, frame: &Frame, solid: &BitGrid, whole: &BitGrid) -> bool {
    let Some(v) = frame.voxel_at(p) else { return false };
    let mut stands = false;
    for by in (0..27).map(|i| [i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1]) {
        let at: [i64; 3] = std::array::from_fn(|k| v[k] as i64 + by[k]);
        if whole.get_or_empty(at) {
            if !solid.get_or_empty(at) {
                return false;
            }
            stands = true;
        }
    }
    stands
}

/// Pieces of a mesh on whose inner side `solid`, what stands of the `whole`, has material, as (u, v,
/// height), whose box of (u, v) `is_near`.
pub(super) fn standing(
    mesh: &TriMesh,
    [solid, whole]: [&BitGrid; 2],
    work: &Work,
    is_near: &(dyn Fn(DVec2, DVec2) -> bool + Sync),
) -> Vec<[DVec3; 3]> {
    let plane = work.step.direction.image_plane();
    let h = work.frame.pitch;
    let solids = Blocks::of(solid, work.frame);
    let pieces: Vec<Vec<[DVec3; 3]>> = (0..mesh.triangles().len())
        .into_par_iter()
        .map(|t| {
            let corners = mesh.corners(t);
            let is_near = |t: &[DVec3; 3]| {
                let [a, b, c] = t.map(|p| plane.across(p));
                is_near(a.min(b).min(c), a.max(b).max(c))
            };
            if !is_near(&corners) {
                return Vec::new();
            }
            let Some(normal) = mesh.area_normal(t).try_normalize() else { return Vec::new() };
            let aside = normal * (ASIDE_PITCH * h / f64::from(LOOKS));
            // Either side: single triangles may face the wrong way.
            let stands = |p: DVec3| {
                let at = |by: f64| work.frame.voxel_at(p + aside * by);
                for k in (1..=LOOKS).map(f64::from) {
                    let near = [at(-k), at(k)].into_iter().flatten().filter(|v| whole.get(*v));
                    if let Some(stands) = near.map(|v| solid.get(v)).reduce(|a, b| a || b) {
                        return stands;
                    }
                }
                lost(p, work.frame, solid, whole)
            };
            let may_stand = |t: &[DVec3; 3]| {
                let [a, b, c] = *t;
                is_near(t) && solids.any_near(a.min(b).min(c), a.max(b).max(c))
            };
            let judge = Judge {
                judged: JUDGED_PITCH * h,
                least: h,
                stands: &stands,
                may_stand: &may_stand,
            };
            let mut out = Vec::new();
            if judge.whole(&corners, &mut out) {
                out.push(corners);
            }
            out
        })
        .collect();
    let turned = |p: DVec3| plane.across(p).extend(plane.height(p));
    pieces.into_iter().flatten().map(|t| t.map(turned)).collect()
}

/// How the pieces of a triangle are judged.
struct Judge<'a> {
    /// Sides of pieces that are judged by their corners and middle, and of those that are not divided, mm.
    judged: f64,
    least: f64,
    stands: &'a dyn Fn(DVec3) -> bool,
    /// False where no point of a piece stands.
    may_stand: &'a dyn Fn(&[DVec3; 3]) -> bool,
}

impl Judge<'_> {
    /// Adds the standing pieces of a triangle; true when all of it stands and nothing was added.
    fn whole(&self, t: &[DVec3; 3], out: &mut Vec<[DVec3; 3]>) -> bool {
        let [a, b, c] = *t;
        let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
        let middle = (a + b + c) / 3.0;
        if longest <= self.least {
            return (self.stands)(middle);
        }
        if !(self.may_stand)(t) {
            return false;
        }
        let (d, e, f) = ((a + b) / 2.0, (b + c) / 2.0, (c + a) / 2.0);
        if longest <= self.judged {
            let pull = |p: DVec3| p.lerp(middle, 0.1);
            let found = [a, b, c, d, e, f, middle].map(|p| (self.stands)(pull(p)));
            if found.iter().all(|s| *s == found[0]) {
                return found[0];
            }
        }
        let parts = [[a, d, f], [d, b, e], [f, e, c], [d, e, f]];
        let before = out.len();
        let mut all = true;
        let mut held: Vec<[DVec3; 3]> = Vec::new();
        for p in &parts {
            if self.whole(p, out) {
                held.push(*p);
            } else {
                all = false;
            }
        }
        if all && out.len() == before {
            return true;
        }
        out.extend(held);
        false
    }
}

/// Which blocks of a grid have any voxel of a set.
struct Blocks<'a> {
    frame: &'a Frame,
    any: BitGrid,
}

impl<'a> Blocks<'a> {
    /// Voxels along a block's sides.
    const SIDE: usize = 8;

    fn of(set: &BitGrid, frame: &'a Frame) -> Blocks<'a> {
        let mut any = BitGrid::new(set.dims().map(|n| n.div_ceil(Self::SIDE).max(1)));
        for (y, z, x, len) in set.runs() {
            for block in x / Self::SIDE..=(x + len - 1) / Self::SIDE {
                any.set([block, y / Self::SIDE, z / Self::SIDE], true);
            }
        }
        Blocks { frame, any }
    }

    /// False only where no voxel within two of a box is in the set.
    fn any_near(&self, low: DVec3, high: DVec3) -> bool {
        let reach = 2.0 * self.frame.pitch;
        let block = |p: DVec3| (self.frame.grid_from_world(p) / Self::SIDE as f64).floor();
        let (low, high) = (block(low - reach), block(high + reach));
        let dims = self.any.dims();
        let range =
            |a: usize| low[a].max(0.0) as usize..((high[a] + 1.0).max(0.0) as usize).min(dims[a]);
        range(2).any(|z| range(1).any(|y| range(0).any(|x| self.any.get([x, y, z]))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::RngExt;

    #[test]
    fn blocks_pass_over_no_voxel_near() {
        let frame = Frame { pitch: 0.5, dims: [40, 33, 29], origin: DVec3::new(-3.0, 1.0, 2.0) };
        let set = BitGrid::from_fn(frame.dims, |[x, y, z]| (x * 7 + y * 11 + z * 13) % 1999 == 0);
        let blocks = Blocks::of(&set, &frame);
        let mut rng = crate::base::rng(4, 0);
        let mut passed = 0;
        for _ in 0..2000 {
            let low = DVec3::from_array([0; 3].map(|_| rng.random_range(-5.0..20.0)));
            let high = low + DVec3::from_array([0; 3].map(|_| rng.random_range(0.0..4.0)));
            let reach = 2.0 * frame.pitch;
            let within = |v: [usize; 3]| {
                let p = frame.center(v);
                p.cmpge(low - reach).all() && p.cmple(high + reach).all()
            };
            let any = set.iter_ones().any(within);
            let near = blocks.any_near(low, high);
            assert!(near || !any, "{low} to {high}");
            passed += usize::from(!near);
        }
        assert!(passed > 100, "{passed}");
    }
}
