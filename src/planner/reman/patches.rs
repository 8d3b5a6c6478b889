//! Patches of what a plan misses, and what has to be printed for each of them.
//!
//! Method: the pieces of what is missing are cut along a lattice of cells of a few millimetres. Along a way all
//! that is missing is gone over from below; what is carried by what stands, by the base under it, or by what else is then
//! printed, could be printed at all. The body of a patch is the patch and, voxel by voxel, the straightest carrier of each that nothing
//! carries yet.
//!
//! Guarantees: a patch has a body along a way exactly if all of it could be printed along that way by the rule of
//! overhangs alone; a body can, from below, and is made of what is missing. Not guaranteed: that it is the smallest, nor
//! that a nozzle gets at it.

use super::laying::{Way, base_layer};
use crate::access::CarrierTable;
use crate::base::{DVec3, Direction};
use crate::plan::Job;
use crate::voxel::{BitGrid, Connectivity, Frame, components};
use std::collections::BTreeMap;

/// Edge of the cells into which what is missing is divided, mm: about what one nozzle fills.
const PATCH_MM: f64 = 4.0;

/// A little of what a plan misses.
#[derive(Clone)]
pub struct Patch {
    pub voxels: Vec<[usize; 3]>,
    /// The ball about their middle that holds all of them, mm.
    pub middle: DVec3,
    pub radius: f64,
}

/// Patches of what is missing.
pub fn patches(frame: &Frame, missing: &BitGrid) -> Vec<Patch> {
    let pieces = components(missing, Connectivity::Corner26);
    let cell = (PATCH_MM / frame.pitch).ceil().max(1.0) as usize;
    let mut of: BTreeMap<(u32, [usize; 3]), Vec<[usize; 3]>> = BTreeMap::new();
    for v in missing.iter_ones() {
        if let Some(piece) = pieces.label_of(v) {
            of.entry((piece, v.map(|c| c / cell))).or_default().push(v);
        }
    }
    of.into_values().map(|voxels| Patch::of(voxels, frame)).collect()
}

/// What carries deposits along a way: what stands and, straight up as clamped, the base.
pub struct Carrying {
    along: Direction,
    carriers: CarrierTable,
    /// The layer that the base carries.
    plate: Option<usize>,
}

impl Carrying {
    pub fn of(way: &Way, job: &Job) -> Carrying {
        let plate = if way.on_base() { base_layer(&job.frame) } else { None };
        Carrying::new(way.direction, job.rules.overhang_deg, plate)
    }

    fn new(along: Direction, overhang_deg: f64, plate: Option<usize>) -> Carrying {
        Carrying { along, carriers: CarrierTable::new(along, overhang_deg), plate }
    }

    fn carries(&self, stands: &BitGrid, v: [usize; 3]) -> bool {
        self.plate == Some(v[2]) || self.carriers.carries(stands, v)
    }
}

/// What stands, and of what is missing all that would be carried were it printed along a way, from below.
pub fn carried_later(
    stands: &BitGrid,
    missing: &BitGrid,
    frame: &Frame,
    carrying: &Carrying,
) -> BitGrid {
    let along = carrying.along;
    let mut order: Vec<([usize; 3], f64)> =
        missing.iter_ones().map(|v| (v, along.dot(frame.center(v)))).collect();
    order.sort_by(|a, b| a.1.total_cmp(&b.1));
    let mut later = stands.clone();
    for (v, _) in order {
        if carrying.carries(&later, v) {
            later.set(v, true);
        }
    }
    later
}

impl Patch {
    /// Voxels, one at least.
    pub fn of(voxels: Vec<[usize; 3]>, frame: &Frame) -> Patch {
        let at = |v: &[usize; 3]| frame.center(*v);
        let middle = voxels.iter().map(at).sum::<DVec3>() / voxels.len() as f64;
        let radius = voxels.iter().map(|v| at(v).distance(middle)).fold(0.0, f64::max);
        Patch { voxels, middle, radius: radius + frame.pitch / 2.0 }
    }

    /// The patch, and what else has to be printed to carry it; none where nothing would. `later` is what
    /// [`carried_later`] says; `stands` is as it was in the end.
    pub fn body(
        &self,
        carrying: &Carrying,
        stands: &mut BitGrid,
        later: &BitGrid,
    ) -> Option<Vec<[usize; 3]>> {
        if !self.voxels.iter().all(|v| later.get(*v)) {
            return None;
        }
        let dims = stands.dims();
        let mut body = self.voxels.clone();
        body.iter().for_each(|v| stands.set(*v, true));
        let mut looked_at = 0;
        while looked_at < body.len() {
            let v = body[looked_at];
            looked_at += 1;
            if carrying.carries(stands, v) {
                continue;
            }
            let carriers = &carrying.carriers;
            let straight = carriers.under(v, dims).find(|u| later.get(*u)).map(|u| vec![u]);
            let chain = || {
                let is_there = |c: &[[usize; 3]; 2]| c.iter().all(|u| later.get(*u));
                carriers.chains_under(v, dims).find(is_there).map(Vec::from)
            };
            for u in straight.or_else(chain).unwrap_or_default() {
                if !stands.get(u) {
                    stands.set(u, true);
                    body.push(u);
                }
            }
        }
        body.iter().for_each(|v| stands.set(*v, false));
        Some(body)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::rng;
    use rand::RngExt as _;

    /// Random solids with a random part missing; what could be printed is found by going over it until nothing
    /// changes.
    #[test]
    fn bodies_are_carried_from_below_and_there_for_all_that_could_be_printed() {
        let frame = Frame { pitch: 1.0, dims: [14, 13, 12], origin: DVec3::ZERO };
        let mut rng = rng(3, 0);
        let (mut with, mut larger, mut without) = (0, 0, 0);
        for i in 0..60 {
            let share = [0.02, 0.1, 0.3][i % 3];
            let mut stands = BitGrid::from_fn(frame.dims, |_| false);
            let mut missing = stands.clone();
            for k in 0..14 * 13 * 12 {
                let v = [k % 14, k / 14 % 13, k / 182];
                let draw: f64 = rng.random_range(0.0..1.0);
                stands.set(v, draw < share);
                missing.set(v, draw > 0.6);
            }
            let d = [DVec3::Z, DVec3::X, DVec3::new(0.4, -0.5, 0.7).normalize()][i / 3 % 3];
            let along = Direction::new(d).unwrap();
            // Every other one along the z axis stands on a base.
            let plate = (d == DVec3::Z && i % 2 == 0).then_some(1);
            let carriers = Carrying::new(along, 50.0, plate);
            let later = carried_later(&stands, &missing, &frame, &carriers);
            let mut want = stands.clone();
            while let Some(v) =
                missing.iter_ones().find(|v| !want.get(*v) && carriers.carries(&want, *v))
            {
                want.set(v, true);
            }
            assert_eq!(later, want);
            assert!(plate.is_none_or(|z| missing.iter_ones().all(|v| v[2] != z || later.get(v))));
            let before = stands.clone();
            for p in patches(&frame, &missing) {
                let body = p.body(&carriers, &mut stands, &later);
                assert_eq!(stands, before);
                assert_eq!(body.is_some(), p.voxels.iter().all(|v| want.get(*v)));
                let Some(mut body) = body else {
                    without += 1;
                    continue;
                };
                (with, larger) = (with + 1, larger + usize::from(body.len() > p.voxels.len()));
                assert!(p.voxels.iter().all(|v| body.contains(v)));
                assert!(body.iter().all(|v| missing.get(*v)));
                let height = |v: &[usize; 3]| along.dot(frame.center(*v));
                body.sort_by(|a, b| height(a).total_cmp(&height(b)));
                let mut printed = stands.clone();
                for v in body {
                    assert!(!printed.get(v) && carriers.carries(&printed, v));
                    printed.set(v, true);
                }
            }
        }
        assert!(with > 50 && larger > 20 && without > 50, "{with} {larger} {without}");
    }

    #[test]
    fn patches_are_pieces_cut_along_cells() {
        let frame = Frame { pitch: 1.0, dims: [12, 9, 4], origin: DVec3::ZERO };
        let missing = BitGrid::from_fn(frame.dims, |[x, y, z]| z == 1 && y != 4 && x < 9);
        let patches = patches(&frame, &missing);
        // Two strips, each of them cut at x = 4 and x = 8; the farther one at y = 8 besides.
        assert_eq!(patches.len(), 9);
        assert_eq!(patches.iter().map(|p| p.voxels.len()).sum::<usize>(), missing.count());
        for p in &patches {
            let far = |v: &[usize; 3]| frame.center(*v).distance(p.middle);
            assert!(p.voxels.iter().all(|v| far(v) < p.radius));
        }
    }
}
