//! Which pieces of a mesh still stand, where voxels tell what of its solid does.
//!
//! Method: a triangle is divided until all of a piece stands or nothing of it does, by the nearest voxel on either side
//! of it; large pieces near no voxel that stands are not divided at all. Along the rim of what stands half a
//! voxel more counts as standing, or what the nearest voxel tells, or only what lies within the outermost voxels' middles.
//!
//! Guarantees: what is found stands to a voxel, on whichever side of a single triangle the solid is; with its rim, all
//! that stands is found but for islands under a quarter of a voxel wide. Not guaranteed: how far beyond the rim, within a
//! voxel; without it, within a voxel of the rim either way.

use super::{BitGrid, Frame};
use crate::base::DVec3;
use crate::mesh::TriMesh;
use rayon::prelude::*;

/// Pieces with shorter sides, in pitches, are judged by their corners and middle.
const JUDGED_PITCH: f64 = 4.0;

/// Pieces with shorter sides, in pitches, are not divided. Of what goes later a piece reaches beyond the rim by up to two
/// thirds of that, and keeps cutters off the walls beside it.
const LEAST_KEPT: f64 = 0.5;
const LEAST_PARTED: f64 = 0.25;

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

/// What counts as standing along the rim of what stands.
#[derive(Clone, Copy, PartialEq)]
pub enum Rim {
    /// All pieces of which any part stands: what is to be kept.
    Kept,
    /// Pieces of which the middle stands: what goes later, beside which something else is to be cut.
    Parted,
    /// Pieces of which the middle stands with half a voxel around it: as far as the middles of the outermost voxels.
    Inner,
}

/// Pieces of a mesh on whose inner side `solid`, what stands of the `whole`, has material, of those that are near: no
/// piece of one that is not may be. World coordinates, mm.
pub fn standing(
    mesh: &TriMesh,
    [solid, whole]: [&BitGrid; 2],
    frame: &Frame,
    is_near: &(dyn Fn(&[DVec3; 3]) -> bool + Sync),
    rim: Rim,
) -> Vec<[DVec3; 3]> {
    let h = frame.pitch;
    let solids = Blocks::of(solid, frame);
    let pieces: Vec<Vec<[DVec3; 3]>> = (0..mesh.triangles().len())
        .into_par_iter()
        .map(|t| {
            let corners = mesh.corners(t);
            if !is_near(&corners) {
                return Vec::new();
            }
            let Some(normal) = mesh.area_normal(t).try_normalize() else { return Vec::new() };
            let aside = normal * (ASIDE_PITCH * h / f64::from(LOOKS));
            // Either side: single triangles may face the wrong way.
            let behind = |p: DVec3| -> Option<bool> {
                let at = |by: f64| frame.voxel_at(p + aside * by);
                (1..=LOOKS).map(f64::from).find_map(|k| {
                    let near = [at(-k), at(k)].into_iter().flatten().filter(|v| whole.get(*v));
                    near.map(|v| solid.get(v)).reduce(|a, b| a || b)
                })
            };
            let (u, v) = normal.any_orthonormal_pair();
            let stands = |p: DVec3| {
                let is_gone = |by: DVec3| behind(p + by * (h / 2.0)) == Some(false);
                behind(p).unwrap_or_else(|| lost(p, frame, solid, whole))
                    && (rim != Rim::Inner || ![u, -u, v, -v].into_iter().any(is_gone))
            };
            let may_stand = |t: &[DVec3; 3]| {
                let [a, b, c] = *t;
                is_near(t) && solids.any_near(a.min(b).min(c), a.max(b).max(c))
            };
            let judge = Judge {
                judged: JUDGED_PITCH * h,
                least: h * if rim == Rim::Kept { LEAST_KEPT } else { LEAST_PARTED },
                rim,
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
    pieces.into_iter().flatten().collect()
}

/// How the pieces of a triangle are judged.
struct Judge<'a> {
    /// Sides of pieces that are judged by their corners and middle, and of those that are not divided, mm.
    judged: f64,
    least: f64,
    rim: Rim,
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
        if longest <= self.least && self.rim != Rim::Kept {
            return (self.stands)(middle);
        }
        if !(self.may_stand)(t) {
            return false;
        }
        let (d, e, f) = ((a + b) / 2.0, (b + c) / 2.0, (c + a) / 2.0);
        if longest <= self.judged {
            let pull = |p: DVec3| p.lerp(middle, 0.1);
            let found = [a, b, c, d, e, f, middle].map(|p| (self.stands)(pull(p)));
            // Of a larger piece the rim may cross a part that no point was asked of.
            let is_told = self.rim != Rim::Kept || found[0] || longest <= self.least;
            if is_told && found.iter().all(|s| *s == found[0]) {
                return found[0];
            }
            if longest <= self.least {
                return true;
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
    use super::super::voxelise;
    use super::*;
    use crate::base::{Ctx, DAffine3};
    use crate::mesh::closest_on_triangle;
    use rand::RngExt;

    /// A box that leans, in its own coordinates.
    const BOX: [DVec3; 2] = [DVec3::new(-6.0, -7.0, -4.0), DVec3::new(6.0, 7.0, 4.0)];
    const PIT_MM: f64 = 4.0;

    fn leaning() -> DAffine3 {
        let turned = DAffine3::from_axis_angle(DVec3::new(2.0, 4.0, 1.0).normalize(), 0.9);
        DAffine3::from_translation(DVec3::splat(12.0)) * turned
    }

    /// From the middle of its upper face.
    fn off_the_pit(p: DVec3) -> f64 {
        p.distance(leaning().transform_point3(DVec3::Z * BOX[1].z))
    }

    /// Parts of a triangle whose sides are no longer than so much.
    fn facets([a, b, c]: [DVec3; 3], side: f64) -> Vec<[DVec3; 3]> {
        let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
        if longest <= side {
            return vec![[a, b, c]];
        }
        let (d, e, f) = ((a + b) / 2.0, (b + c) / 2.0, (c + a) / 2.0);
        let parts = [[a, d, f], [d, b, e], [f, e, c], [d, e, f]];
        parts.into_iter().flat_map(|p| facets(p, side)).collect()
    }

    /// Along the rim of a pit in a slanted face what stands between what was cut used to be lost, a voxel wide and more,
    /// and paths cut into it.
    #[test]
    fn all_that_stands_along_the_rim_of_a_pit_is_kept() {
        let frame = Frame { pitch: 0.5, dims: [48; 3], origin: DVec3::ZERO };
        let mesh = TriMesh::cuboid(BOX[0], BOX[1]).transformed(&leaning()).unwrap();
        let target = voxelise(&mesh, &frame, &Ctx::quiet()).unwrap();
        let pit = BitGrid::from_fn(frame.dims, |v| off_the_pit(frame.center(v)) < PIT_MM);
        let after = target.minus(&pit);
        let found = |rim: Rim| standing(&mesh, [&after, &target], &frame, &|_| true, rim);
        let kept = found(Rim::Kept);
        let lost = |normal: DVec3, p: DVec3| -> Option<f64> {
            let behind = |k: u32| frame.voxel_at(p - normal * (0.05 * f64::from(k)));
            let inner = (1..=9).filter_map(behind).find(|v| target.get(*v))?;
            let off = |t: &[DVec3; 3]| closest_on_triangle(p, *t).distance(p);
            after.get(inner).then(|| kept.iter().map(off).fold(f64::INFINITY, f64::min))
        };
        let mut looked_at = 0;
        for t in 0..mesh.triangles().len() {
            let normal = mesh.area_normal(t).normalize();
            for c in facets(mesh.corners(t), 0.25) {
                let p = (c[0] + c[1] + c[2]) / 3.0;
                if (off_the_pit(p) - PIT_MM).abs() < 1.5 {
                    let off = lost(normal, p);
                    assert!(off.is_none_or(|off| off < 0.1), "{p}: {off:?}");
                    looked_at += usize::from(off.is_some());
                }
            }
        }
        assert!(looked_at > 1000, "{looked_at}");
        // Nor is much beyond it.
        let area = |all: &[[DVec3; 3]]| -> f64 {
            all.iter().map(|t| (t[1] - t[0]).cross(t[2] - t[0]).length() / 2.0).sum()
        };
        let parted = found(Rim::Parted);
        // What goes later reaches hardly beyond what stands, and covers nearly all of it.
        let beyond = |t: &[DVec3; 3]| -> f64 {
            let stands = |p: DVec3| {
                let normal = (t[1] - t[0]).cross(t[2] - t[0]).normalize();
                let at = |k: i32| p - normal * (0.05 * f64::from(k));
                let near = (1..=9).flat_map(|k| [at(k), at(-k)]).filter_map(|p| frame.voxel_at(p));
                near.filter(|v| target.get(*v)).map(|v| after.get(v)).next()
            };
            let pieces = facets(*t, 0.1);
            let gone = pieces.iter().filter(|c| stands((c[0] + c[1] + c[2]) / 3.0) == Some(false));
            gone.map(|c| (c[1] - c[0]).cross(c[2] - c[0]).length() / 2.0).sum()
        };
        let all: f64 = parted.iter().map(beyond).sum();
        assert!(all < 0.3, "{all}");
        // To the middles of the outermost voxels that is half a voxel less all along the rim.
        let inner = found(Rim::Inner);
        let nearest = |all: &[[DVec3; 3]]| -> f64 {
            let off = |t: &[DVec3; 3]| off_the_pit((t[0] + t[1] + t[2]) / 3.0);
            all.iter().map(off).fold(f64::INFINITY, f64::min)
        };
        assert!(nearest(&inner) > nearest(&parted) + 0.3 * frame.pitch, "{}", nearest(&inner));
        let round = std::f64::consts::TAU * PIT_MM * frame.pitch / 2.0;
        let lost = area(&parted) - area(&inner);
        assert!(lost > 0.8 * round && lost < 2.0 * round, "{lost} of {round}");
        let (kept, parted) = (area(&kept), area(&parted));
        assert!(kept > parted && kept < parted + 12.0, "{kept} {parted}");
    }

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
