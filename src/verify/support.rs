//! Rule `support`: every deposited voxel has a carrier within the overhang angle, directly or
//! over one voxel between. Heights strictly fall from voxel to carrier, so the carriers of
//! carriers end in the input state.

use super::tally::Tally;
use super::{Rule, RuleResult};
use crate::base::{DVec3, Direction};
use crate::plan::{Job, Step};
use crate::voxel::BitGrid;

/// Lower by more than this many pitches counts as below (`docs/RULES.md`).
const BELOW_PITCHES: f64 = 1e-6;

/// Slack of the cosine, so that 45° passes at 45°: about 1e-7 degrees.
const COSINE_ROUNDING: f64 = 1e-9;

/// Offsets from a voxel to its carriers along one direction.
struct Carriers {
    /// One solid voxel carries.
    direct: Vec<[i64; 3]>,
    /// Two solid voxels carry together: the neighbour, and the one under it.
    chains: Vec<([i64; 3], [i64; 3])>,
}

impl Carriers {
    fn new(d: Direction, overhang_deg: f64) -> Carriers {
        let least_cosine = overhang_deg.clamp(0.0, 180.0).to_radians().cos() - COSINE_ROUNDING;
        let drop = |o: [i64; 3]| -d.dot(DVec3::new(o[0] as f64, o[1] as f64, o[2] as f64));
        let carries = |o: [i64; 3]| {
            let length = (o.iter().map(|c| c * c).sum::<i64>() as f64).sqrt();
            drop(o) >= least_cosine * length
        };
        let below: Vec<[i64; 3]> = (0..27)
            .map(|i| [i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1])
            .filter(|o| drop(*o) > BELOW_PITCHES)
            .collect();
        let (direct, rest): (Vec<_>, Vec<_>) = below.iter().copied().partition(|o| carries(*o));
        let chains = rest
            .iter()
            .flat_map(|a| below.iter().map(move |b| (*a, std::array::from_fn(|i| a[i] + b[i]))))
            .filter(|(_, b)| carries(*b))
            .collect();
        Carriers { direct, chains }
    }
}

pub(super) fn check(job: &Job, index: usize, step: &Step, before: &BitGrid) -> RuleResult {
    let mut tally = unsupported(step, before, job.rules.overhang_deg);
    if tally.count > 0 && step.holding == 0 && step.direction == Direction::Z {
        tally = without_first_layer(job, step, before);
    }
    tally.result(Rule::Support, index, "voxels without support", &job.frame, || {
        format!("nothing carries them within {}°", job.rules.overhang_deg)
    })
}

/// The same without the layer that rests on the base plane, in the holding as clamped: its lower
/// faces are at z = 0.
fn without_first_layer(job: &Job, step: &Step, before: &BitGrid) -> Tally {
    let half = job.frame.pitch / 2.0;
    let on_base =
        |z: usize| (job.frame.center([0, 0, z]).z - half).abs() <= BELOW_PITCHES * job.frame.pitch;
    let mut solid = before.clone();
    let mut above = step.clone();
    let [_, ny, nz] = solid.dims();
    for z in (0..nz).filter(|z| on_base(*z)) {
        for y in 0..ny {
            let row = above.region.row(y, z).to_vec();
            solid.row_mut(y, z).iter_mut().zip(&row).for_each(|(s, r)| *s |= r);
            above.region.row_mut(y, z).fill(0);
        }
    }
    unsupported(&above, &solid, job.rules.overhang_deg)
}

/// The voxels of the region without a carrier.
pub(super) fn unsupported(step: &Step, before: &BitGrid, overhang_deg: f64) -> Tally {
    let solid = Solid { before, region: &step.region };
    let carriers = Carriers::new(step.direction, overhang_deg);
    let ny = before.dims()[1];
    let mut tally = Tally::default();
    for (y, z) in step.region.stored_rows().map(|r| (r % ny, r / ny)) {
        for (w, bits) in step.region.row(y, z).iter().enumerate().filter(|(_, b)| **b != 0) {
            let mut left = uncarried(&solid, &carriers, (y, z, w), *bits);
            while left != 0 {
                tally.add([w * 64 + left.trailing_zeros() as usize, y, z]);
                left &= left - 1;
            }
        }
    }
    tally
}

/// What is there and what is added, together.
struct Solid<'a> {
    before: &'a BitGrid,
    region: &'a BitGrid,
}

/// Those of the voxels `bits` of word w of a row that nothing carries.
fn uncarried(solid: &Solid, carriers: &Carriers, word: (usize, usize, usize), bits: u64) -> u64 {
    let mut left = bits;
    for a in &carriers.direct {
        left &= !shifted(solid, word, *a);
        if left == 0 {
            return 0;
        }
    }
    for (a, b) in &carriers.chains {
        left &= !(shifted(solid, word, *a) & shifted(solid, word, *b));
        if left == 0 {
            return 0;
        }
    }
    left
}

/// The word whose bit x is the voxel at offset `o` from voxel x of word w; empty outside the grid.
fn shifted(solid: &Solid, (y, z, w): (usize, usize, usize), o: [i64; 3]) -> u64 {
    let [_, ny, nz] = solid.before.dims();
    let (y, z) = (y as i64 + o[1], z as i64 + o[2]);
    if y < 0 || z < 0 || y >= ny as i64 || z >= nz as i64 {
        return 0;
    }
    let rows = [solid.before, solid.region].map(|g| g.row(y as usize, z as usize));
    let at = |i: usize| rows.iter().fold(0, |bits, row| bits | row.get(i).copied().unwrap_or(0));
    let left = |w: usize| w.checked_sub(1).map_or(0, at);
    match o[0] {
        0 => at(w),
        s if s > 0 => at(w) >> s | at(w + 1) << (64 - s),
        s => at(w) << -s | left(w) >> (64 + s),
    }
}
