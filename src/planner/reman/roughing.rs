//! Roughing: what a stouter cutter takes along a cut's direction is cut with it first.
//!
//! Method. Which cutter makes a cut is decided by what it reaches, so that a slender one often takes many cubic
//! centimetres of which only the last corners need it. The time of a cut is estimated as its volume over
//! what its cutter takes away in a minute of roughing ([`Tool::roughing_mm3_min`]). Where that is worth
//! another tool, the usual cutters take what they reach of the cut before it, the fastest first,
//! along the same direction and as held for it, but for what a cutter half a voxel wider would not.
//!
//! Guarantees: those of cuts; the state after each of the plan's own cuts is what it was, and so are its directions
//! and holdings. A cut is divided only where that saves at least [`LEAST_SAVING_S`] and [`LEAST_SHARE`] of its
//! time by the estimate. Not guaranteed: that the estimate is close; it knows no finishing and no ways in air.

use super::Run;
use super::cutting::held_part;
use super::round::Attempt;
use crate::access::over_cut;
use crate::base::{DVec3, Direction};
use crate::machine::Tool;
use crate::plan::{Job, Step, StepKind};
use crate::planner::PlanError;
use crate::voxel::BitGrid;

/// Time that another tool has to save, s: a change and its ways in air take a minute or two, and a program with
/// fewer of them is easier to watch.
const LEAST_SAVING_S: f64 = 900.0;

/// The same as a share of the cut's time.
const LEAST_SHARE: f64 = 0.1;

/// How much wider on each side the first of two cutters has to fit, in voxels: half of what gaps may be narrower than
/// they are between voxels. What it leaves is the other's.
const WIDER_VOXELS: f64 = 0.5;

/// The plan with each long cut roughed by stouter cutters first, where they save time.
pub fn roughed(run: &mut Run, attempt: Attempt) -> Result<Attempt, PlanError> {
    divided(run, attempt, |run, before, step| {
        let job = run.start.setting.job;
        let mut state = before.state.clone();
        let (mut steps, mut rest) = (Vec::new(), step.clone());
        let (own, faster) = stouter(run, step);
        let seconds =
            |voxels: usize, rate: f64| voxels as f64 * job.frame.voxel_volume() / rate * 60.0;
        for (tool, rate) in faster {
            run.ctx.check()?;
            let least = LEAST_SAVING_S.max(LEAST_SHARE * seconds(step.region.count(), own));
            let saved = |voxels: usize| seconds(voxels, own) - seconds(voxels, rate);
            if saved(rest.region.count()) < least || run.ctx.out_of_time() {
                continue;
            }
            let way = (tool, step.direction, WIDER_VOXELS);
            let open = with_room(job, &state, &rest.region, before.fixed, way);
            let (of, way) = ((&state, &open), (tool, step.direction));
            let region = held_part(run.start.setting, run.start.coarse, of, before.fixed, way);
            if saved(region.count()) < least {
                continue;
            }
            tracing::debug!(tool = tool.name, saved = saved(region.count()), "roughing");
            state.subtract(&region);
            rest.region.subtract(&region);
            steps.push(Step { tool: tool.name.clone(), region, ..step.clone() });
        }
        steps.push(rest);
        Ok(steps)
    })
}

/// What a cut is made from.
pub(super) struct Before<'a> {
    pub state: &'a BitGrid,
    /// Fixed obstacle points of its holding.
    pub fixed: &'a [DVec3],
}

/// A plan with each of its cuts exchanged for those that it is divided into, which leave the same state; of those
/// that are empty none is made.
pub(super) fn divided(
    run: &mut Run,
    attempt: Attempt,
    into: impl Fn(&Run, Before, &Step) -> Result<Vec<Step>, PlanError>,
) -> Result<Attempt, PlanError> {
    let mut state = run.start.setting.job.initial.clone();
    let (mut steps, mut cuts): (Vec<Step>, usize) = (Vec::new(), 0);
    let mut fixed = Vec::new();
    let mut held = None;
    for (i, step) in attempt.steps.iter().enumerate() {
        if step.kind == StepKind::Additive {
            state.union_with(&step.region);
            steps.push(step.clone());
            held = None;
            continue;
        }
        if held != Some(step.holding) {
            held = Some(step.holding);
            fixed = run.start.setting.fixed(step.holding, &state);
        }
        let made = into(run, Before { state: &state, fixed: &fixed }, step)?;
        steps.extend(made.into_iter().filter(|s| !s.region.is_empty()));
        state.subtract(&step.region);
        if i < attempt.cuts {
            cuts = steps.len();
        }
    }
    let of_kind = steps.iter_mut().filter(|s| s.kind == StepKind::Subtractive);
    of_kind.enumerate().for_each(|(block, s)| s.block = block);
    run.clock.lap("blocks");
    Ok(Attempt { steps, cuts, ..attempt })
}

/// What of a region a cutter so many voxels wider all around reaches beside the target and the fixed points: voxels'
/// middles let it into gaps that its surfaces are too near each other for.
pub(super) fn with_room(
    job: &Job,
    state: &BitGrid,
    region: &BitGrid,
    fixed: &[DVec3],
    (tool, direction, voxels): (&Tool, Direction, f64),
) -> BitGrid {
    let wide = tool.widened(voxels * job.frame.pitch);
    let stays = state.and(&job.target).or(region);
    over_cut(&job.frame, &stays, region, fixed, &wide, direction).region
}

/// What a step's cutter takes away, mm³/min, and the usual ones that take more with what they take, the
/// fastest first.
fn stouter<'a>(run: &Run<'a>, step: &Step) -> (f64, Vec<(&'a Tool, f64)>) {
    let setting = run.start.setting;
    let rate = |t: &Tool| t.roughing_mm3_min(&setting.job.machine.control);
    let own = setting.job.tool(&step.tool).map_or(f64::INFINITY, rate);
    let usual = setting.usual_cutters().iter().map(|t| (t, rate(t)));
    let mut faster: Vec<(&Tool, f64)> = usual.filter(|(_, rate)| *rate > own).collect();
    faster.sort_by(|a, b| b.1.total_cmp(&a.1).then_with(|| a.0.name.cmp(&b.0.name)));
    (own, faster)
}

#[cfg(test)]
mod tests {
    use super::super::local_tests::{assert_verifies, job_of, with_run};
    use super::super::round::{Mending, attempt};
    use super::*;
    use crate::voxel::Frame;

    const DIMS: [usize; 3] = [60, 50, 34];

    fn block([x, y, z]: [usize; 3]) -> bool {
        (3..57).contains(&x) && (3..47).contains(&y) && (1..31).contains(&z)
    }

    /// A block of which the upper part goes, and a slot under it that is too narrow for stout cutters.
    fn job(from_z: usize) -> Job {
        let slot = |[x, y, z]: [usize; 3]| (20..24).contains(&y) && (8..50).contains(&x) && z >= 10;
        let frame = Frame { pitch: 1.0, dims: DIMS, origin: DVec3::ZERO };
        let initial = BitGrid::from_fn(DIMS, block);
        let target = BitGrid::from_fn(DIMS, |v| block(v) && v[2] < from_z && !slot(v));
        job_of(frame, initial, target, |_| true)
    }

    /// The plan with one cut from above by the slimmest of the usual cutters, and that plan roughed.
    fn cut_and_roughed(job: &Job) -> [Attempt; 2] {
        with_run(job, |run| {
            let how = (run.options, Mending::None);
            let (start, ctx) = (run.start, run.ctx);
            let plain =
                attempt(start.setting, start.coarse, Vec::new(), &start.preferred, how, ctx);
            let mut plain = plain.unwrap();
            let tool =
                start.setting.usual_cutters().iter().find(|t| t.name == "ball-3x30").unwrap();
            let removed = job.initial.minus(&job.target);
            let fixed = start.setting.fixed(0, &job.initial);
            let (state, d) = (&job.initial, Direction::Z);
            let region = over_cut(&job.frame, state, &removed, &fixed, tool, d).region;
            let tool = tool.name.clone();
            plain.steps = vec![Step { tool, region, direction: d, ..plain.steps[0].clone() }];
            plain.cuts = 1;
            let made = roughed(run, plain.clone()).unwrap();
            [plain, made]
        })
    }

    #[test]
    fn a_long_cut_is_roughed_by_a_stouter_cutter() {
        let job = job(18);
        let [plain, made] = cut_and_roughed(&job);
        let names: Vec<&str> = made.steps.iter().map(|s| s.tool.as_str()).collect();
        assert_eq!(names, ["long-cutter", "ball-3x30"]);
        assert_eq!((made.cuts, made.steps[1].block), (2, 1));
        let [first, then] = [&made.steps[0].region, &made.steps[1].region];
        assert_eq!(first.count_and(then), 0);
        assert_eq!(first.or(then), plain.steps[0].region);
        assert!(first.count() > 10 * then.count() && then.count() > 100);
        assert_verifies(&job, made.steps);
    }

    /// A channel of five voxels, narrower than the stout cutter, which has room between the middles of its walls' voxels.
    #[test]
    fn the_stout_cutter_leaves_what_it_has_no_room_for() {
        let channel =
            |[x, y, z]: [usize; 3]| (20..25).contains(&y) && (3..57).contains(&x) && z >= 8;
        let frame = Frame { pitch: 1.05, dims: DIMS, origin: DVec3::ZERO };
        let initial = BitGrid::from_fn(DIMS, block);
        let target = BitGrid::from_fn(DIMS, |v| block(v) && v[2] < 18 && !channel(v));
        let job = job_of(frame, initial, target, |_| true);
        let stout = job.cutters.iter().find(|t| t.name == "long-cutter").unwrap();
        assert_eq!(stout.active_radius(), 3.0);
        let [plain, made] = cut_and_roughed(&job);
        let deep = plain.steps[0]
            .region
            .and(&BitGrid::from_fn(DIMS, |v| channel(v) && v[2] < 14 && v[0] > 8 && v[0] < 51));
        let standing = job.target.or(&deep);
        let by_maps = over_cut(&frame, &standing, &deep, &[], stout, Direction::Z).region;
        assert!(by_maps.count() > 100, "{}", by_maps.count());
        assert_eq!(made.steps[0].tool, stout.name);
        assert_eq!(made.steps[0].region.count_and(&deep), 0);
        assert_eq!(made.steps[1].region.count_and(&deep), deep.count());
    }

    #[test]
    fn a_short_cut_keeps_its_cutter() {
        let [plain, made] = cut_and_roughed(&job(29));
        assert!(!plain.steps[0].region.is_empty());
        assert_eq!(made.steps, plain.steps);
    }
}
