//! Rule `end`: the last state is the target within δ, skin aside; and the measures of a plan.

use super::bodies::Bodies;
use super::replay::Replay;
use super::{ROUNDING_MM, Rule, RuleResult};
use crate::base::{Aabb, DVec3};
use crate::plan::Job;
use crate::voxel::{BitGrid, Frame};
use rayon::iter::ParallelIterator;

/// What a plan leaves and moves; volumes in mm³.
#[derive(Clone, Debug)]
pub struct Measures {
    pub target_mm3: f64,
    /// In the last state but not in the target.
    pub excess_mm3: f64,
    /// In the target but not in the last state.
    pub deficit_mm3: f64,
    /// Excess and deficit within τ of the reused volume.
    pub skin_mm3: f64,
    /// Excess and deficit beyond skin.
    pub residual_mm3: f64,
    /// (excess + deficit − skin)/target volume; infinite for an empty target that is not met.
    pub deviation_relative: f64,
    /// Old material of the target that no step removed.
    pub reused_mm3: f64,
    /// Everything that any step removed.
    pub removed_mm3: f64,
    /// Everything that any step added.
    pub added_mm3: f64,
    pub residual: Residual,
}

/// Excess and deficit beyond skin, and where they are.
#[derive(Clone, Debug)]
pub struct Residual {
    pub excess: BitGrid,
    pub deficit: BitGrid,
    /// None when there is no residual excess.
    pub excess_place: Option<Place>,
    /// None when there is no residual deficit.
    pub deficit_place: Option<Place>,
}

impl Residual {
    pub fn is_empty(&self) -> bool {
        self.excess_place.is_none() && self.deficit_place.is_none()
    }
}

/// Where a set of voxels is.
#[derive(Clone, Debug, PartialEq)]
pub struct Place {
    pub voxels: usize,
    pub volume_mm3: f64,
    /// Mean of the voxel centres, mm.
    pub centroid: DVec3,
    /// Box of the voxels, their corners included, mm.
    pub bounds: Aabb,
    /// The largest connected body alone; None in a `Place` that is one itself.
    pub largest: Option<Box<Place>>,
}

impl Measures {
    /// Of a plan that cannot be replayed: every figure is NaN.
    pub(super) fn unknown(dims: [usize; 3]) -> Measures {
        let none = BitGrid::new(dims);
        Measures {
            target_mm3: f64::NAN,
            excess_mm3: f64::NAN,
            deficit_mm3: f64::NAN,
            skin_mm3: f64::NAN,
            residual_mm3: f64::NAN,
            deviation_relative: f64::NAN,
            reused_mm3: f64::NAN,
            removed_mm3: f64::NAN,
            added_mm3: f64::NAN,
            residual: Residual {
                excess: none.clone(),
                deficit: none,
                excess_place: None,
                deficit_place: None,
            },
        }
    }
}

pub(super) fn measure(job: &Job, replay: &Replay) -> Measures {
    let (frame, target) = (&job.frame, &job.target);
    let excess = replay.after.minus(target);
    let deficit = target.minus(&replay.after);
    let reused = job.initial.minus(&replay.removed).and(target);
    let near = Nearness::new(frame, job.rules.tolerance_mm);
    let (deep_excess, deep_deficit) =
        (near.beyond(&excess, &reused), near.beyond(&deficit, &reused));
    let (off, deep) =
        (excess.count() + deficit.count(), deep_excess.count() + deep_deficit.count());
    let mm3 = |voxels: usize| voxels as f64 * frame.voxel_volume();
    let wanted = target.count();
    Measures {
        target_mm3: mm3(wanted),
        excess_mm3: mm3(excess.count()),
        deficit_mm3: mm3(deficit.count()),
        skin_mm3: mm3(off - deep),
        residual_mm3: mm3(deep),
        deviation_relative: match (deep, wanted) {
            (0, _) => 0.0,
            (_, 0) => f64::INFINITY,
            _ => deep as f64 / wanted as f64,
        },
        reused_mm3: mm3(reused.count()),
        removed_mm3: mm3(replay.removed.count()),
        added_mm3: mm3(replay.added.count()),
        residual: Residual {
            excess_place: Place::of(&deep_excess, frame),
            deficit_place: Place::of(&deep_deficit, frame),
            excess: deep_excess,
            deficit: deep_deficit,
        },
    }
}

pub(super) fn check(job: &Job, m: &Measures) -> RuleResult {
    let passed = m.deviation_relative <= job.rules.deviation;
    let places = [("excess", &m.residual.excess_place), ("deficit", &m.residual.deficit_place)];
    let detail = if passed {
        String::new()
    } else {
        let describe = |(name, place): (&str, &Option<Place>)| {
            let (p, name) = (place.as_ref()?, name);
            let at = p.largest.as_ref().map_or(p.centroid, |l| l.centroid);
            Some(format!(
                "{:.3} mm³ of {name}, the largest piece around ({:.2}, {:.2}, {:.2}) mm",
                p.volume_mm3, at.x, at.y, at.z
            ))
        };
        let left: Vec<String> = places.into_iter().filter_map(describe).collect();
        format!("at most {} is allowed; left are {}", job.rules.deviation, left.join(" and "))
    };
    RuleResult {
        rule: Rule::End,
        step: None,
        passed,
        figure: m.deviation_relative,
        figure_means: "of the target volume off",
        detail,
    }
}

impl Place {
    /// None for an empty grid.
    pub fn of(grid: &BitGrid, frame: &Frame) -> Option<Place> {
        let bodies = Bodies::of(grid);
        let largest = bodies.largest()?;
        let mut place = Place::of_runs(&bodies, frame, |_| true);
        place.largest = Some(Box::new(Place::of_runs(&bodies, frame, |b| b == largest)));
        Some(place)
    }

    fn of_runs(bodies: &Bodies, frame: &Frame, take: impl Fn(usize) -> bool) -> Place {
        let (mut voxels, mut sum, mut bounds) = (0usize, DVec3::ZERO, Aabb::EMPTY);
        let half = DVec3::splat(frame.pitch / 2.0);
        for (r, _) in bodies.runs.iter().zip(&bodies.body).filter(|(_, b)| take(**b)) {
            let (a, b) = (frame.center([r.x, r.y, r.z]), frame.center([r.x + r.len - 1, r.y, r.z]));
            voxels += r.len;
            sum += (a + b) * (0.5 * r.len as f64);
            bounds = bounds.union(Aabb { min: a - half, max: b + half });
        }
        let volume_mm3 = voxels as f64 * frame.voxel_volume();
        Place { voxels, volume_mm3, centroid: sum / voxels as f64, bounds, largest: None }
    }
}

/// Voxels within a distance of others, a word of 64 at a time.
struct Nearness {
    /// (dy, dz, most |dx|), nearest first.
    chords: Vec<(i64, i64, usize)>,
}

impl Nearness {
    fn new(frame: &Frame, distance_mm: f64) -> Nearness {
        let r = (distance_mm + ROUNDING_MM) / frame.pitch;
        let r2 = if r >= 0.0 { r * r } else { f64::NEG_INFINITY }; // NaN: nothing is near
        // No offset longer than the grid leads into it.
        let [nx, ny, nz] = frame.dims.map(|n| n as i64);
        let most = |n: i64| (r.floor().max(0.0) as i64).min(n);
        let mut chords: Vec<(i64, i64, usize)> = (-most(nz)..=most(nz))
            .flat_map(|dz| (-most(ny)..=most(ny)).map(move |dy| (dy, dz)))
            .filter_map(|(dy, dz)| {
                let rest = r2 - (dy * dy + dz * dz) as f64;
                let chord = || (rest.sqrt().floor() as i64).min(nx) as usize;
                (rest >= 0.0).then(|| (dy, dz, chord()))
            })
            .collect();
        chords.sort_by_key(|(dy, dz, _)| (dy * dy + dz * dz, *dy, *dz));
        Nearness { chords }
    }

    /// The voxels of `grid` with none of `others` near.
    fn beyond(&self, grid: &BitGrid, others: &BitGrid) -> BitGrid {
        let [_, ny, nz] = grid.dims();
        let mut far = grid.clone();
        far.par_rows_mut().for_each(|(y, z, row)| {
            for (w, left) in row.iter_mut().enumerate() {
                for (dy, dz, dx) in &self.chords {
                    if *left == 0 {
                        break;
                    }
                    let (y, z) = (y as i64 + dy, z as i64 + dz);
                    if (0..ny as i64).contains(&y) && (0..nz as i64).contains(&z) {
                        *left &= !spread(others.row(y as usize, z as usize), w, *dx);
                    }
                }
            }
        });
        far
    }
}

/// Word w of a row in which every set bit is spread by `reach` to both sides.
fn spread(row: &[u64], w: usize, reach: usize) -> u64 {
    let at = |i: i64| usize::try_from(i).ok().and_then(|i| row.get(i)).copied().unwrap_or(0);
    let w = w as i64;
    if reach < 64 {
        return (1..=reach).fold(at(w), |bits, s| {
            bits | at(w) << s | at(w) >> s | at(w - 1) >> (64 - s) | at(w + 1) << (64 - s)
        });
    }
    // Only absurd tolerances come here: bit by bit.
    let (words, below) =
        ((reach / 64 + 1) as i64, |n: i64| if n == 64 { !0 } else { (1u64 << n) - 1 });
    (0..64).fold(0, |bits, b| {
        let (lo, hi) = (w * 64 + b - reach as i64, w * 64 + b + reach as i64);
        let hit = (w - words..=w + words).any(|i| {
            let (first, last) = ((lo - i * 64).clamp(0, 64), (hi + 1 - i * 64).clamp(0, 64));
            at(i) & below(last) & !below(first) != 0
        });
        bits | (hit as u64) << b
    })
}
