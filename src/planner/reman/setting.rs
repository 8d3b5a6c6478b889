//! What every stage asks of the job: holdings, their fixed obstacles, directions.

use crate::base::{DVec3, Direction};
use crate::machine::{BaseKind, Holding, HoldingMode, Taken, Tool};
use crate::plan::{Job, Step, StepKind};
use crate::voxel::{BitGrid, Frame, distance_within};

/// The job with what follows from it once.
pub struct Setting<'a> {
    pub job: &'a Job,
    /// As clamped and, where steps may hold the part anew, turned over. How high the turned part
    /// stands is known only when its turn comes: see [`Setting::held`].
    pub holdings: Vec<Holding>,
    first_fixed: Vec<DVec3>,
    /// In a later round of cuts and deposits, what stands of the initial part: skin lies near that
    /// alone. None in the first, where all that is kept is old.
    old: Option<BitGrid>,
    /// Whether tools of the last resort take part.
    last_resort: bool,
    /// Whether what little they leave is cut by exact distances.
    closely: bool,
}

impl<'a> Setting<'a> {
    pub fn new(job: &'a Job) -> Self {
        let first_fixed = match job.rules.base {
            BaseKind::None => Vec::new(),
            BaseKind::Pedestal => job.machine.workholding.obstacle_points(
                &Holding::AS_CLAMPED,
                &job.base_contact(),
                &job.frame,
            ),
        };
        let holdings = holdings(job);
        Setting { job, holdings, first_fixed, old: None, last_resort: false, closely: false }
    }

    /// The setting of a further round: `job` starts from what the rounds before left, `old` is what
    /// they kept of the initial part. The pedestal stays as wide as it was.
    pub fn of_next_round(&self, job: &'a Job, old: BitGrid) -> Self {
        let first_fixed = self.first_fixed.clone();
        let (last_resort, closely) = (self.last_resort, self.closely);
        let holdings = holdings(job);
        Setting { job, holdings, first_fixed, old: Some(old), last_resort, closely }
    }

    /// The same with the tools of the last resort.
    pub fn with_last_resort(&self) -> Setting<'a> {
        let (job, holdings) = (self.job, self.holdings.clone());
        let (first_fixed, old) = (self.first_fixed.clone(), self.old.clone());
        Setting { job, holdings, first_fixed, old, last_resort: true, closely: self.closely }
    }

    /// The same with all tools of the job, the finest too, and cuts by exact distances: see `close`.
    pub fn with_close_cuts(&self) -> Setting<'a> {
        Setting { closely: true, ..self.with_last_resort() }
    }

    pub fn cuts_closely(&self) -> bool {
        self.closely
    }

    /// The cutters that take part, shortest first.
    pub fn cutters(&self) -> &'a [Tool] {
        if self.closely { but_for_gaps(&self.job.cutters) } else { self.all_but_finest() }
    }

    /// Those of them that take more than what the others leave.
    pub fn all_but_finest(&self) -> &'a [Tool] {
        if self.last_resort { but_for_finest(&self.job.cutters) } else { self.usual_cutters() }
    }

    /// All ball ends that are slimmer than a cutter, the stoutest first, then the tapered ones whose ball is.
    pub fn slimmer_cutters(&self, than: &Tool) -> Vec<&'a Tool> {
        let is_slimmer = |t: &&Tool| match t.is_tapered() {
            true => t.tip_radius() < than.tip_radius(),
            false => t.has_ball_end() && t.active_radius() < than.active_radius(),
        };
        let mut slimmer: Vec<&Tool> = self.job.cutters.iter().filter(is_slimmer).collect();
        slimmer.sort_by(|a, b| {
            let radius = b.tip_radius().total_cmp(&a.tip_radius());
            a.is_tapered().cmp(&b.is_tapered()).then(radius).then_with(|| a.name.cmp(&b.name))
        });
        slimmer
    }

    /// Those of them that are no last resort.
    pub fn usual_cutters(&self) -> &'a [Tool] {
        usual(&self.job.cutters)
    }

    /// Whether the job has tools that only the last resort takes.
    pub fn has_last_resort(&self) -> bool {
        let Job { cutters, nozzles, .. } = self.job;
        [cutters, nozzles].into_iter().any(|tools| usual(tools).len() < but_for_finest(tools).len())
    }

    /// The nozzles that take part, shortest first.
    pub fn nozzles(&self) -> &'a [Tool] {
        if self.last_resort { but_for_finest(&self.job.nozzles) } else { usual(&self.job.nozzles) }
    }

    /// What of a set stands of the initial part.
    pub fn old_of(&self, kept: &BitGrid) -> BitGrid {
        self.old.as_ref().map_or_else(|| kept.clone(), |old| kept.and(old))
    }

    /// Everything within the surface tolerance of what is kept of the initial part.
    pub fn skin(&self, kept: &BitGrid) -> BitGrid {
        distance_within(&self.old_of(kept), self.job.rules.tolerance_mm / self.job.frame.pitch)
    }

    /// What of a set lies beyond the skin, found voxel by voxel: for sets that are small beside the grid.
    pub fn beyond_skin(&self, some: &BitGrid, kept: &BitGrid) -> BitGrid {
        let radius = self.job.rules.tolerance_mm / self.job.frame.pitch;
        let old = self.old_of(kept);
        let n = radius.floor() as i64;
        let all =
            (-n..=n).flat_map(|x| (-n..=n).flat_map(move |y| (-n..=n).map(move |z| [x, y, z])));
        let near: Vec<[i64; 3]> = all
            .filter(|o| (o.iter().map(|c| c * c).sum::<i64>() as f64) <= radius * radius)
            .collect();
        let mut beyond = some.clone();
        for v in some.iter_ones() {
            let at = |o: &[i64; 3]| std::array::from_fn(|a| v[a] as i64 + o[a]);
            if near.iter().any(|o| old.get_or_empty(at(o))) {
                beyond.set(v, false);
            }
        }
        beyond
    }

    /// A holding that begins in `state`: turned over, the part stands on what is then its top.
    pub fn held(&self, holding: usize, state: &BitGrid) -> Holding {
        if holding == 0 { self.holdings[0] } else { turned_over(state, &self.job.frame) }
    }

    /// The holdings of a plan, numbered in the order in which they begin, and written into its
    /// steps. Turned over, cutting and printing hold the part separately, since each stands it on
    /// the top it finds.
    pub fn numbered(&self, steps: &mut [Step]) -> Vec<Holding> {
        let mut holdings = vec![self.holdings[0]];
        let mut state = self.job.initial.clone();
        let mut before: Option<(usize, StepKind, usize)> = None;
        for step in steps {
            let (which, kind) = (step.holding, step.kind);
            step.holding = match before {
                _ if which == 0 => 0,
                Some((w, k, number)) if (w, k) == (which, kind) => number,
                _ => {
                    holdings.push(self.held(which, &state));
                    holdings.len() - 1
                }
            };
            before = Some((which, kind, step.holding));
            match kind {
                StepKind::Subtractive => state.subtract(&step.region),
                StepKind::Additive => state.union_with(&step.region),
            }
        }
        holdings
    }

    /// Fixed obstacle points of a holding that begins in `state`.
    pub fn fixed(&self, holding: usize, state: &BitGrid) -> Vec<DVec3> {
        if holding == 0 {
            return self.first_fixed.clone();
        }
        if self.job.rules.base == BaseKind::None {
            return Vec::new();
        }
        let hold = self.held(holding, state);
        let contact = hold.contact(state, &self.job.frame, self.job.rules.grip_mm);
        self.job.machine.workholding.obstacle_points(&hold, &contact, &self.job.frame)
    }

    /// Whether the machine can work along `d` in this holding.
    pub fn can_point(&self, holding: usize, d: Direction) -> bool {
        self.job.machine.can_point(self.holdings[holding].up, d)
    }

    /// The grid axes of a holding, up first, its downward one left out.
    pub fn axes(&self, holding: usize) -> Vec<Direction> {
        let up = self.holdings[holding].up;
        let all = [up, Direction::X, Direction::NEG_X, Direction::Y, Direction::NEG_Y];
        all.into_iter().filter(|d| self.can_point(holding, *d)).collect()
    }

    /// Sampled directions of a holding: see [`crate::machine::Machine::sampled`].
    pub fn sampled(&self, holding: usize, count: usize) -> Vec<Direction> {
        self.job.machine.sampled(self.holdings[holding].up, count)
    }
}

/// The tools that are no last resort; those that are where there are no others. Tools stand in a job in the
/// order of [`Taken`].
fn usual(tools: &[Tool]) -> &[Tool] {
    match tools.partition_point(|t| t.taken < Taken::LastResort) {
        0 => but_for_finest(tools),
        others => &tools[..others],
    }
}

/// The tools that do not only take what those of the last resort leave; those that do where there are no others.
fn but_for_finest(tools: &[Tool]) -> &[Tool] {
    match tools.partition_point(|t| t.taken < Taken::Finest) {
        0 => but_for_gaps(tools),
        others => &tools[..others],
    }
}

/// Those that are not only for narrow gaps; all where there are no others.
fn but_for_gaps(tools: &[Tool]) -> &[Tool] {
    match tools.partition_point(|t| t.taken < Taken::NarrowGaps) {
        0 => tools,
        others => &tools[..others],
    }
}

/// As clamped and, where the rules allow it, standing on its top.
fn holdings(job: &Job) -> Vec<Holding> {
    let mut holdings = vec![Holding::AS_CLAMPED];
    if job.rules.holding == HoldingMode::Refixture {
        holdings.push(turned_over(&job.initial.or(&job.target), &job.frame));
    }
    holdings
}

/// Standing on its top.
fn turned_over(solid: &BitGrid, frame: &Frame) -> Holding {
    let top = solid.extent().map_or(0.0, |(_, hi)| frame.center(hi).z + frame.pitch / 2.0);
    Holding { up: Direction::NEG_Z, height_mm: -top }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::planner::reman::local_tests::job_of;

    #[test]
    fn what_lies_beyond_the_skin_is_found_voxel_by_voxel() {
        let frame = Frame { pitch: 0.3, dims: [24, 20, 17], origin: DVec3::ZERO };
        let part = BitGrid::from_fn(frame.dims, |v| (v[0] * 7 + v[1] * 5 + v[2] * 3) % 83 == 0);
        let some = BitGrid::from_fn(frame.dims, |v| (v[0] + v[1] * 2 + v[2]) % 3 != 0);
        for tolerance_mm in [0.2, 0.3, 0.55, 0.9] {
            let mut job = job_of(frame, part.clone(), part.clone(), |_| true);
            job.rules.tolerance_mm = tolerance_mm;
            let setting = Setting::new(&job);
            let want = some.minus(&setting.skin(&part));
            assert!(!want.is_empty() && want != some || tolerance_mm < 0.3);
            assert_eq!(setting.beyond_skin(&some, &part), want, "{tolerance_mm}");
        }
    }

    #[test]
    fn tools_of_the_last_resort_take_part_only_there() {
        let frame = Frame { pitch: 1.0, dims: [8, 8, 8], origin: DVec3::ZERO };
        let part = BitGrid::from_fn(frame.dims, |v| v[2] < 4);
        let job = job_of(frame, part.clone(), part.clone(), |_| true);
        let names = |tools: &[Tool]| -> Vec<String> {
            let resort = tools.iter().filter(|t| t.taken == Taken::LastResort);
            resort.map(|t| t.name.clone()).collect()
        };
        let usual = Setting::new(&job);
        assert!(usual.has_last_resort());
        assert!(names(usual.cutters()).is_empty() && names(usual.nozzles()).is_empty());
        let all = usual.with_last_resort();
        assert_eq!(names(all.cutters()), ["ball-1.4x24", "taper-1x50"]);
        assert_eq!(names(all.nozzles()), ["needle-nozzle"]);
        assert_eq!(all.usual_cutters(), usual.cutters());
        let finest = |s: &Setting| s.cutters().iter().any(|t| t.taken == Taken::Finest);
        assert!(!finest(&all) && finest(&usual.with_close_cuts()));
        // A job that has no others has these.
        let only = job_of(frame, part.clone(), part, |t| t.taken == Taken::LastResort);
        assert_eq!(names(Setting::new(&only).cutters()), ["ball-1.4x24", "taper-1x50"]);
    }
}
