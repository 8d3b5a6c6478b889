//! Local planes, found round by round for what the blocks left (W2V Sec. 4.2).
//!
//! Method. Blocks are first made with nothing given up; what they leave are the elements of the
//! first search for local planes (`refine`), blocks are made again, and so on. The rounds are made
//! on a coarse grid, where one takes a second; if the best choice promises to keep more than the
//! global planes do, it is made on the job's own grid, and what that leaves gets rounds of its own.
//! Where that grid's rounds all leave more than the rules allow, planes are looked for once more,
//! for what would be left with supports (`last_resort`); these are made as they are. Of such planes
//! none is steep or looks down, since what stands on supports is printed straight up beside them.
//!
//! What differs from the paper: it splits the global planes of the set cover into local ones and
//! turns those. A base that is not plano-convex can often be printed all the same, in several
//! blocks along several directions; only what could not is worth a plane.

use super::clip::Clip;
use super::coarse::Coarse;
use super::last_resort::on_supports;
use super::local::{Candidate, Scope};
use super::refine::refine;
use super::round::{Attempt, Mending, UnderPlanes, attempt, volumes};
use super::setting::Setting;
use super::{Clock, Options, Report, Run, Start};
use crate::base::{Ctx, Direction};
use crate::plan::Job;
use crate::planner::PlanError;
use crate::voxel::{BitGrid, Connectivity, components};

/// Rounds on the coarse grid, and on the job's own: each adds planes for what the last one left.
const COARSE_ROUNDS: usize = 4;
const FINE_ROUNDS: usize = 2;

/// Share of the target that local planes must promise to keep more, to be made on the job's grid.
pub const WORTH_SHARE: f64 = 0.005;

/// Regions that a round looks at, the largest first: each is a layer of the search.
const MOST_ELEMENTS: usize = 10;

/// Least height of the normal of a plane meant for supports: what stands on them is printed straight up, and beside a
/// steeper face, or under one that looks down, there is no room for a nozzle, the slimmest of which widen by 20°.
const LEAST_LEAN: f64 = 0.35;

/// A region on the coarse grid below this volume (mm³) is its staircase, not the part's.
const LEAST_COARSE_MM3: f64 = 8.0;

/// The best attempt under local planes, and whether these are meant for supports, without which it may be
/// worse than `best`; none where they promise to keep no more than that does.
pub fn local_route(run: &mut Run, best: &Attempt) -> Result<Option<(Attempt, bool)>, PlanError> {
    let Run { start, normals, options, report, clock, ctx, .. } = run;
    let job = start.setting.job;
    let cells = Coarse::cells(job);
    let ideal = job.ideal_reuse();
    let scope = Scope::new(start.setting, &cells, &ideal);
    let route = Route { start, scope: &scope, cells: &cells, normals, options };
    let (chosen, need_supports) = match start.coarse.is_coarser() {
        true => route.chosen(report, clock, ctx)?,
        false => (Vec::new(), false),
    };
    let dims = job.frame.dims;
    let clips: Vec<Clip> = chosen.iter().map(|c| fine_clip(c, &cells, dims)).collect();
    let promised = volumes(job, &clips).reused.count() as f64;
    let least = best.volumes.reused.count() as f64 + WORTH_SHARE * job.target.count() as f64;
    if (promised < least && best.is_valid(job)) || clips == best.clips {
        return Ok(None);
    }
    let made = start.attempt(clips, options, ctx)?;
    clock.lap("blocks");
    made.tell("local", 0);
    // Planes more would be chosen for what the blocks leave without supports.
    match need_supports {
        true => Ok(Some((made, true))),
        false => improved(run, made).map(|made| Some((made, false))),
    }
}

/// An attempt with local planes added for what it left, as long as that makes it better.
pub fn improved(run: &mut Run, mut best: Attempt) -> Result<Attempt, PlanError> {
    let Run { start, normals, options, report, clock, ctx, .. } = run;
    let job = start.setting.job;
    let cells = Coarse::cells(job);
    let scope = Scope::new(start.setting, &cells, &job.ideal_reuse());
    let route = Route { start, scope: &scope, cells: &cells, normals, options };
    let voxels = job.frame.pitch.recip() * cells.job.frame.pitch;
    for round in 1..=FINE_ROUNDS {
        if best.residual() == 0 || ctx.out_of_time() {
            break;
        }
        let left = [best.excess.minus(&best.below), best.deficit.clone()];
        let before = route.cells.most(&job.ideal_reuse().minus(&best.volumes.reused));
        let regions = route.regions(&left, 0.0);
        let more = route.refined(&before, regions, report, ctx)?;
        clock.lap("search");
        let lost = more.iter().fold(before.clone(), |all, c| all.or(&c.seeds)).count();
        let lost = ((lost - before.count()) as f64 * voxels.powi(3)) as usize;
        if more.is_empty() || best.worth(job).is_some_and(|worth| lost > worth) {
            break;
        }
        let mut clips = best.clips.clone();
        clips.extend(more.iter().map(|c| fine_clip(c, &cells, job.frame.dims)));
        let made = start.attempt(clips, options, ctx)?;
        clock.lap("blocks");
        made.tell("improved", round);
        // Planes that are not enough would go on to give up the whole part for a little less that is left:
        // then the last resort does better under those before.
        let gains = made.is_valid(job) || made.loss(job) < best.loss(job);
        if made.rank(job) >= best.rank(job) || !gains {
            break;
        }
        best = made;
    }
    Ok(best)
}

/// A candidate on the job's own grid.
fn fine_clip(candidate: &Candidate, cells: &Coarse, dims: [usize; 3]) -> Clip {
    Clip { plane: candidate.plane, seeds: Some(cells.refined(&candidate.seeds, dims)) }
}

struct Route<'a> {
    start: &'a Start<'a>,
    scope: &'a Scope<'a>,
    cells: &'a Coarse,
    normals: &'a [Direction],
    options: &'a Options,
}

impl Route<'_> {
    /// The planes that do best on the coarse grid, and whether only supports make them do so.
    fn chosen(
        &self,
        report: &mut Report,
        clock: &mut Clock,
        ctx: &Ctx,
    ) -> Result<(Vec<Candidate>, bool), PlanError> {
        let (start, options) = (self.start, self.options);
        let job = start.coarse.as_job();
        let (setting, look) = (Setting::new(&job), Coarse::of(&job));
        let make = |clips| {
            attempt(&setting, &look, clips, &start.preferred, (options, Mending::None), ctx)
        };
        let (plain, chosen) = self.on_coarse_grid(make, report, clock, ctx)?;
        if plain.is_valid(&job) || !options.supports || ctx.out_of_time() {
            return Ok((chosen, false));
        }
        let setting = setting.with_last_resort();
        let preferred = start.preferred.clone();
        let of_look = Start { setting: &setting, coarse: &look, preferred, bad_bases: Vec::new() };
        let make = |clips| on_supports(&of_look, &UnderPlanes::of(&job, clips), options, ctx);
        let normals = leaning(self.normals);
        let route = Route { normals: &normals, ..*self };
        let (supported, others) = route.on_coarse_grid(make, report, clock, ctx)?;
        match supported.rank(&job) < plain.rank(&job) {
            true => Ok((others, true)),
            false => Ok((chosen, false)),
        }
    }

    /// Rounds on the coarse grid, blocks made by `make`; the choice that did best there.
    fn on_coarse_grid(
        &self,
        make: impl Fn(Vec<Clip>) -> Result<Attempt, PlanError>,
        report: &mut Report,
        clock: &mut Clock,
        ctx: &Ctx,
    ) -> Result<(Attempt, Vec<Candidate>), PlanError> {
        let coarse = &self.start.coarse;
        let job = coarse.as_job();
        let dims = self.start.setting.job.frame.dims;
        let mut chosen: Vec<Candidate> = Vec::new();
        let mut best: Option<(Attempt, Vec<Candidate>)> = None;
        for round in 0..COARSE_ROUNDS {
            let clips = chosen.iter().map(|c| {
                let seeds = coarse.any(&self.cells.refined(&c.seeds, dims));
                Clip { plane: c.plane, seeds: Some(seeds) }
            });
            let made = make(clips.collect())?;
            clock.lap("blocks");
            made.tell("coarse", round);
            let left = [made.excess.minus(&made.below), made.deficit.clone()];
            let left = left.map(|l| coarse.refined(&l, dims));
            if best.as_ref().is_none_or(|(b, _)| made.rank(&job) < b.rank(&job)) {
                best = Some((made, chosen.clone()));
            }
            let regions = self.regions(&left, LEAST_COARSE_MM3);
            if regions.is_empty() || ctx.out_of_time() {
                break;
            }
            let mut before = BitGrid::new(self.cells.job.frame.dims);
            chosen.iter().for_each(|c| before.union_with(&self.scope.cells.grid_of(&c.lost)));
            let more = self.refined(&before, regions, report, ctx)?;
            clock.lap("search");
            if more.is_empty() {
                break;
            }
            chosen.extend(more);
        }
        best.ok_or(PlanError::Cancelled)
    }

    /// The pieces of what is left (on the job's grid) as regions of cells, the largest first.
    fn regions(&self, left: &[BitGrid; 2], least_mm3: f64) -> Vec<BitGrid> {
        let voxel = self.start.setting.job.frame.voxel_volume();
        let mut regions: Vec<(usize, BitGrid)> = Vec::new();
        for some in left {
            let parts = components(&self.cells.any(some), Connectivity::Corner26);
            let mut sizes = vec![0usize; parts.count()];
            for v in some.iter_ones() {
                if let Some(p) = parts.label_of(self.cells.voxel_of(v)) {
                    sizes[p as usize] += 1;
                }
            }
            let large = (0..sizes.len()).filter(|p| sizes[*p] as f64 * voxel >= least_mm3);
            regions.extend(large.map(|p| (sizes[p], parts.grid_of(p as u32))));
        }
        regions.sort_by_key(|(size, _)| std::cmp::Reverse(*size));
        regions.truncate(MOST_ELEMENTS);
        regions.into_iter().map(|(_, region)| region).collect()
    }

    /// The planes that a search adds when the cells of `before` are given up already.
    fn refined(
        &self,
        before: &BitGrid,
        regions: Vec<BitGrid>,
        report: &mut Report,
        ctx: &Ctx,
    ) -> Result<Vec<Candidate>, PlanError> {
        let found = refine(self.scope, regions, self.normals, before, self.options, ctx)?;
        let Some(found) = found else { return Ok(Vec::new()) };
        tracing::debug!(
            planes = found.chosen.len(),
            judged = found.judged,
            per_second = found.per_second.round(),
            points = found.points,
            valid = found.is_valid,
            lost = ?found.chosen.iter().map(|c| c.lost_count).collect::<Vec<_>>(),
            cells = self.scope.cells.len(),
            "refine"
        );
        report.judged += found.judged;
        let before = self.scope.cells.set_of(before);
        let adds = |c: &Candidate| {
            let mut all = before.clone();
            all.union_with(&c.lost);
            all != before
        };
        Ok(found.chosen.into_iter().filter(adds).collect())
    }
}

/// The normals of planes beside which deposits come straight up.
fn leaning(normals: &[Direction]) -> Vec<Direction> {
    normals.iter().copied().filter(|n| n.vec().z >= LEAST_LEAN).collect()
}

/// Whether nothing is left that a plane could mend.
pub fn is_complete(attempt: &Attempt, job: &Job) -> bool {
    attempt.rank(job).0 == 0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::machine::HoldingMode;
    use crate::planner::reman::local_tests::{block, block_job};
    use crate::planner::reman::plane_normals;

    /// On a bracket a plane that looks down left a seam open, a voxel or two wide, that no nozzle got into from below.
    #[test]
    fn planes_for_supports_leave_room_for_a_nozzle_beside_them() {
        let mut job = block_job(block, block, |_| true);
        job.rules.holding = HoldingMode::Refixture;
        let all = plane_normals(&job, 100);
        let those = leaning(&all);
        assert!(all.contains(&Direction::NEG_Z) && those.contains(&Direction::Z));
        assert!((40..100).contains(&those.len()), "{}", those.len());
        // The face leaves more room, the higher, than the slimmest nozzles need.
        for n in those {
            let recedes = n.vec().z / n.vec().truncate().length().max(1e-9);
            assert!(recedes > 20.0_f64.to_radians().tan(), "{n:?}");
        }
    }
}
