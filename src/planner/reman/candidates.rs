//! Candidate clipping planes and their choice (W2V Sec. 4.1, Eq. 2).

use super::CoverMethod;
use super::setting::Setting;
use crate::base::{DVec3, Direction};
use crate::machine::HoldingMode;
use crate::plan::{Job, Plane};
use crate::planner::PlanError;
use crate::search::{WeightedSet, set_cover};
use crate::voxel::BitGrid;
use rayon::prelude::*;

/// Something a plane must cover wholly: a base that is not plano-convex, or a cluster of material
/// that no tool reaches while the reused volume above it stands.
#[derive(Clone, Debug)]
pub struct Element {
    pub points: Vec<DVec3>,
}

/// A candidate plane with what it costs and covers.
struct Candidate {
    plane: Plane,
    set: WeightedSet,
}

/// Only every n-th voxel along each axis weighs in when a plane's volume is estimated: a cover's
/// weights need three digits, and millions of voxels times a hundred normals would need seconds.
const WEIGHT_STRIDE: usize = 2;

/// Cells of the height histogram per normal; one cell of a 200 mm part is 0.05 mm.
const HISTOGRAM: usize = 4096;

/// The least-weight set of planes that covers every element, proven optimal, and its weight.
pub struct Cover {
    pub planes: Vec<Plane>,
    /// Elements that no admissible plane covers: they lie beside the base contact.
    pub uncovered: Vec<usize>,
}

/// Which planes may be chosen.
#[derive(Clone, Copy)]
pub struct Admissible<'n> {
    pub normals: &'n [Direction],
    /// Whether none may cut away any of the base contact.
    pub keeps_base: bool,
}

impl<'n> Admissible<'n> {
    /// All that the job allows.
    pub fn all(job: &Job, normals: &'n [Direction]) -> Self {
        Admissible { normals, keeps_base: job.rules.holding == HoldingMode::Base }
    }
}

/// Chooses planes for `elements` over `reused` (W2V Eq. 2): a plane with each of `normals`
/// through the lowest point of each element.
pub fn cover(
    setting: &Setting,
    reused: &BitGrid,
    elements: &[Element],
    admissible: &Admissible,
    method: CoverMethod,
) -> Result<Cover, PlanError> {
    if elements.is_empty() {
        return Ok(Cover { planes: Vec::new(), uncovered: Vec::new() });
    }
    let Admissible { normals, keeps_base } = *admissible;
    let contact = if keeps_base { base_contact(setting, reused) } else { Vec::new() };
    let sample = sampled(setting, reused);
    let candidates: Vec<Candidate> = normals
        .par_iter()
        .flat_map_iter(|n| along(*n, elements, &sample, &contact, setting.job.frame.pitch))
        .collect();
    let coverable: Vec<usize> = (0..elements.len())
        .filter(|e| candidates.iter().any(|c| c.set.covers.binary_search(e).is_ok()))
        .collect();
    let uncovered = (0..elements.len()).filter(|e| coverable.binary_search(e).is_err()).collect();
    let sets: Vec<WeightedSet> = candidates
        .iter()
        .map(|c| WeightedSet {
            weight: c.set.weight,
            covers: c.set.covers.iter().filter_map(|e| coverable.binary_search(e).ok()).collect(),
        })
        .collect();
    let chosen = match method {
        CoverMethod::Ilp => set_cover(coverable.len(), &sets)?,
        CoverMethod::Greedy => greedy(coverable.len(), &sets),
        CoverMethod::Single => match single(coverable.len(), &sets) {
            Some(i) => vec![i],
            None => set_cover(coverable.len(), &sets)?,
        },
    };
    Ok(Cover { planes: chosen.iter().map(|i| candidates[*i].plane).collect(), uncovered })
}

/// Element by element, of those not covered yet, the lightest set that has it.
fn greedy(elements: usize, sets: &[WeightedSet]) -> Vec<usize> {
    let mut chosen: Vec<usize> = Vec::new();
    for e in 0..elements {
        let has = |i: &usize| sets[*i].covers.binary_search(&e).is_ok();
        if !chosen.iter().any(has) {
            chosen.extend(lightest(sets, (0..sets.len()).filter(has)));
        }
    }
    chosen.sort_unstable();
    chosen
}

/// The lightest set that has all elements.
fn single(elements: usize, sets: &[WeightedSet]) -> Option<usize> {
    lightest(sets, (0..sets.len()).filter(|i| sets[*i].covers.len() == elements))
}

fn lightest(sets: &[WeightedSet], of: impl Iterator<Item = usize>) -> Option<usize> {
    of.reduce(|a, b| if sets[b].weight < sets[a].weight { b } else { a })
}

/// Voxel centres that a plane must not cut away: the base contact in the holding that keeps it.
fn base_contact(setting: &Setting, reused: &BitGrid) -> Vec<DVec3> {
    let frame = &setting.job.frame;
    let contact = setting.holdings[0].contact(reused, frame, setting.job.rules.grip_mm);
    contact.boundary().iter_ones().map(|v| frame.center(v)).collect()
}

fn sampled(setting: &Setting, reused: &BitGrid) -> Vec<DVec3> {
    reused
        .iter_ones()
        .filter(|v| v.iter().all(|c| c % WEIGHT_STRIDE == 0))
        .map(|v| setting.job.frame.center(v))
        .collect()
}

/// Candidates with one normal: one per element, each covering all that lies wholly above it.
fn along(
    normal: Direction,
    elements: &[Element],
    sample: &[DVec3],
    contact: &[DVec3],
    pitch: f64,
) -> Vec<Candidate> {
    let lowest: Vec<f64> = elements
        .iter()
        .map(|e| e.points.iter().map(|p| normal.dot(*p)).fold(f64::INFINITY, f64::min))
        .collect();
    let highest_contact = contact.iter().map(|p| normal.dot(*p)).fold(f64::MIN, f64::max);
    let share_above = share_above(normal, sample);
    // Points of an element are surface points or centres; half a voxel below them is below the
    // voxels they stand for.
    let mut offsets: Vec<f64> = lowest.iter().map(|z| z - pitch / 2.0).collect();
    offsets.sort_by(f64::total_cmp);
    offsets.dedup();
    offsets
        .into_iter()
        .filter(|offset| *offset >= highest_contact)
        .map(|offset| Candidate {
            plane: Plane { normal, offset },
            set: WeightedSet {
                weight: share_above(offset),
                covers: (0..elements.len()).filter(|k| lowest[*k] > offset).collect(),
            },
        })
        .collect()
}

/// Share of the sample above an offset along a normal, by one histogram.
fn share_above(normal: Direction, sample: &[DVec3]) -> impl Fn(f64) -> f64 + use<> {
    let heights: Vec<f64> = sample.iter().map(|p| normal.dot(*p)).collect();
    let lo = heights.iter().copied().fold(f64::INFINITY, f64::min);
    let hi = heights.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let scale = HISTOGRAM as f64 / (hi - lo).max(1e-9);
    let mut above = vec![0u32; HISTOGRAM + 2];
    for z in &heights {
        above[(((z - lo) * scale) as usize).min(HISTOGRAM)] += 1;
    }
    for i in (0..=HISTOGRAM).rev() {
        above[i] += above[i + 1];
    }
    let total = heights.len().max(1) as f64;
    move |offset: f64| {
        let cell = ((offset - lo) * scale).ceil().clamp(0.0, (HISTOGRAM + 1) as f64);
        f64::from(above[cell as usize]) / total
    }
}
