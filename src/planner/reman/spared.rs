//! Sparing: what need not go and no cutter has room for is left standing.
//!
//! Method. A slender cutter takes along what it reaches by the middles of voxels, skin too, which need not go. In
//! corners its edge has no room for that on the target's mesh (see `room`): paths nick the walls beside it, or leave
//! it. Of this what is left by slimmer cutters and along other directions is taken out of its cut, but for what
//! stands over the rest of the cut, or so near it that this is out of reach then. Every later
//! cut whose tool comes near it is then made again while it stands, and every later deposit laid again. A cut of which
//! nothing is left is none.
//!
//! Guarantees: those of cuts and deposits; nothing but skin and target is left standing beside what stood before, so a
//! plan leaves no more and reuses no less. Where a later step does not get past it, what is near goes after all; where
//! that is of no use, all stays as it was. Not guaranteed: that all without room is found.

use super::Run;
use super::fitting::over;
use super::laying::{Layer, Way};
use super::room::{Points, Room};
use super::round::Attempt;
use super::tilting::{BESIDE_RADII, Turn, is_too_much};
use crate::base::DVec3;
use crate::machine::Tool;
use crate::plan::{Step, StepKind};
use crate::planner::PlanError;
use crate::voxel::{BitGrid, distance_within};
use std::cell::Cell;

/// Fewer voxels are left with their cut, but where they are more of it than paths may leave.
const LEAST_VOXELS: usize = 8;

/// So many times as much may stand with what has no room, as what lies under it.
const MOST_BEHIND: usize = 4;

/// All is made again so often without what was in the way of a later step: what lies within so many radii of its tool,
/// and so many voxels, of what it missed. On a bracket with pits five steps were in the way before one was not.
const TRIES: usize = 9;
const NEAR_RADII: f64 = 2.0;
const NEAR_VOXELS: f64 = 2.0;

/// The plan with what has no room left standing where it may; the plan as it is where the rules refuse it, or nothing is
/// spared.
pub fn spared(run: &mut Run, room: &Room, attempt: Attempt) -> Result<Attempt, PlanError> {
    let job = run.start.setting.job;
    if !attempt.is_valid(job) {
        return Ok(attempt);
    }
    let may_stand = may_stand(run, &attempt.volumes.reused);
    let mut spare = may_stand.clone();
    for _ in 0..TRIES {
        if run.ctx.out_of_time() {
            break;
        }
        match sparing(run, room, &attempt.steps, (&may_stand, &spare))? {
            Sparing::Nothing => break,
            Sparing::Blocked(by) => spare.subtract(&by),
            Sparing::Made(steps) => {
                let mut stock = job.initial.clone();
                steps[..attempt.cuts].iter().for_each(|s| stock.subtract(&s.region));
                let (steps, cuts) = without_empty(steps, attempt.cuts);
                run.clock.lap("blocks");
                return Ok(Attempt { steps, cuts, stock, ..attempt });
            }
        }
    }
    run.clock.lap("blocks");
    Ok(attempt)
}

/// What need not go: skin of what is reused, and what of the target a pit took away.
fn may_stand(run: &Run, reused: &BitGrid) -> BitGrid {
    run.start.setting.skin(reused).or(&run.start.setting.job.target)
}

/// Steps but for those of which nothing is left to make, and how many of the first so many these are.
fn without_empty(steps: Vec<Step>, first: usize) -> (Vec<Step>, usize) {
    let has_any = |s: &Step| !s.region.is_empty();
    let first = steps[..first].iter().filter(|s| has_any(s)).count();
    let mut steps: Vec<Step> = steps.into_iter().filter(has_any).collect();
    for kind in [StepKind::Subtractive, StepKind::Additive] {
        let of_kind = steps.iter_mut().filter(|s| s.kind == kind);
        of_kind.enumerate().for_each(|(block, s)| s.block = block);
    }
    (steps, first)
}

/// What comes of steps while what need not go stands.
enum Sparing {
    Made(Vec<Step>),
    /// All that need not go has room.
    Nothing,
    /// A step does not get past this, or something else that stands.
    Blocked(BitGrid),
}

/// Steps with what of the `spare` has no room left standing, of what may stand.
fn sparing(
    run: &Run,
    room: &Room,
    steps: &[Step],
    (may_stand, spare): (&BitGrid, &BitGrid),
) -> Result<Sparing, PlanError> {
    let setting = run.start.setting;
    let made_again = Cell::new(0);
    let (mut state, mut made): (_, Vec<Step>) = (setting.job.initial.clone(), Vec::new());
    let mut standing = BitGrid::new(state.dims());
    for turn in steps.chunk_by(|a, b| (a.kind, a.holding) == (b.kind, b.holding)) {
        let fixed = setting.fixed(turn[0].holding, &state);
        let points = Points::of(&fixed, &setting.job.frame);
        let cuts = Turn { run, room, fixed: &fixed, points: &points, made_again: &made_again };
        for step in turn {
            run.ctx.check()?;
            let region = match step.kind {
                StepKind::Additive => {
                    let region = step.region.minus(&standing);
                    if !standing.is_empty() {
                        let missed = region.minus(&laid(run, &state, step, (&region, &fixed)));
                        if !missed.is_empty() {
                            return Ok(blocked(run, &standing, &missed, step));
                        }
                    }
                    state.union_with(&region);
                    region
                }
                StepKind::Subtractive => {
                    let region = cuts.sparing(&state, step, spare, &standing);
                    let lost = step.region.minus(&region);
                    let missed = lost.minus(may_stand);
                    if !missed.is_empty() {
                        return Ok(blocked(run, &standing, &missed, step));
                    }
                    standing.union_with(&lost);
                    standing.subtract(&region);
                    state.subtract(&region);
                    region
                }
            };
            made.push(Step { region, ..step.clone() });
        }
    }
    tracing::debug!(voxels = standing.count(), "spared");
    Ok(match !standing.is_empty() {
        true => Sparing::Made(made),
        false => Sparing::Nothing,
    })
}

/// What of the standing is near enough to be in a tool's way to what it missed; all where none is.
fn blocked(run: &Run, standing: &BitGrid, missed: &BitGrid, step: &Step) -> Sparing {
    let job = run.start.setting.job;
    let radius = job.tool(&step.tool).map_or(0.0, Tool::active_radius);
    let far = NEAR_RADII * radius / job.frame.pitch + NEAR_VOXELS;
    let near = distance_within(missed, far).and(standing);
    tracing::debug!(
        tool = step.tool,
        missed = missed.count(),
        standing = standing.count(),
        near = near.count(),
        "sparing blocked"
    );
    Sparing::Blocked(if near.is_empty() { standing.clone() } else { near })
}

/// What of a region a step's nozzle lays on a state.
fn laid(
    run: &Run,
    state: &BitGrid,
    step: &Step,
    (region, fixed): (&BitGrid, &Vec<DVec3>),
) -> BitGrid {
    let job = run.start.setting.job;
    let Some(tool) = job.tool(&step.tool) else { return BitGrid::new(region.dims()) };
    let fixed = vec![fixed.clone(); step.holding + 1];
    let layer = Layer { job, state, left: region, core: region, fixed: &fixed, closely: true };
    layer.lay(Way { direction: step.direction, holding: step.holding, tool }).region
}

impl Turn<'_, '_> {
    /// What a cut takes with the `spare` that has no room left standing, while what others spared stands.
    fn sparing(
        &self,
        state: &BitGrid,
        step: &Step,
        spare: &BitGrid,
        standing: &BitGrid,
    ) -> BitGrid {
        let mut its = self.without_room(state, step).and(spare);
        let is_worth_it = |its: &BitGrid| its.count() >= LEAST_VOXELS || is_too_much(its, step);
        for radii in BESIDE_RADII.map(Some).into_iter().chain([None]) {
            if !is_worth_it(&its) {
                break;
            }
            let region = self.made(state, step, &step.region.minus(&its));
            let lost = step.region.minus(&region);
            let missed = lost.minus(spare);
            if missed.is_empty() {
                if lost.count() <= MOST_BEHIND * its.count() {
                    return region;
                }
                break;
            }
            let (Some(tool), Some(radii)) = (self.tool(step), radii) else { break };
            let (frame, way) = (&self.run.start.setting.job.frame, (tool, step.direction));
            its.subtract(&over(frame, &its, &missed, way, radii));
        }
        match standing.is_empty() {
            true => step.region.clone(),
            false => self.made_beside(state, step, &step.region, standing),
        }
    }

    /// What of a slender cutter's cut it has no room for; of what the usual ones take only more than paths may leave.
    fn without_room(&self, state: &BitGrid, step: &Step) -> BitGrid {
        let is_usual = |t: &str| self.run.start.setting.usual_cutters().iter().any(|u| u.name == t);
        match self.tool(step).filter(|t| Room::is_told_of(t)) {
            None => BitGrid::new(state.dims()),
            Some(tool) if is_usual(&tool.name) => {
                let crowded = self.crowded(state, step);
                match is_too_much(&crowded, step) {
                    true => crowded,
                    false => BitGrid::new(state.dims()),
                }
            }
            // How wide a tapered edge is where it passes the surface is not told by its end.
            Some(tool) if tool.is_tapered() => {
                let (after, way) = (state.minus(&step.region), (tool, step.direction));
                let roomy = self.room.after(&after, Some(self.points), &step.region, way);
                step.region.minus(&roomy)
            }
            Some(_) => self.crowded(state, step),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::local_tests::{assert_verifies, job_of, with_run};
    use super::*;
    use crate::base::{Ctx, Direction};
    use crate::mesh::TriMesh;
    use crate::plan::{Action, Job, Origin};
    use crate::voxel::{Frame, voxelise};

    /// A block with a slot of 1.2 mm along x into which a cutter of 1.4 mm fits by the middles of voxels, 3 mm deep; under
    /// it, up to some x, a pocket 3 mm wide and 3 mm high that is open nowhere else. The tolerance makes skin of all of
    /// the slot.
    fn job(pocket_to: Option<f64>) -> Job {
        let boxed = |low: [f64; 3], high: [f64; 3]| TriMesh::cuboid(low.into(), high.into());
        let beside = |low: f64, high: f64, [y, to]: [f64; 2], x_to: f64| {
            [
                boxed([0.0, 0.0, low], [9.0, y, high]),
                boxed([0.0, to, low], [9.0, 9.0, high]),
                boxed([0.0, y, low], [2.0, to, high]),
                boxed([x_to, y, low], [9.0, to, high]),
            ]
        };
        let mut all = vec![boxed([0.0, 0.0, 0.0], [9.0, 9.0, 2.0])];
        match pocket_to {
            Some(x_to) => all.extend(beside(2.0, 5.0, [3.0, 6.0], x_to)),
            None => all.push(boxed([0.0, 0.0, 2.0], [9.0, 9.0, 5.0])),
        }
        all.extend(beside(5.0, 8.0, [4.0, 5.2], 7.0));
        let target = TriMesh::joined(&all);
        let frame = Frame { pitch: 0.25, dims: [42, 42, 40], origin: DVec3::splat(-0.75) };
        let solid = |mesh: &TriMesh| voxelise(mesh, &frame, &Ctx::quiet()).unwrap();
        let initial = solid(&boxed([0.0, 0.0, 0.0], [9.0, 9.0, 8.0]));
        let slim = |name: &str| ["ball-1.4x24", "ball-3x13"].contains(&name);
        let mut job = job_of(frame, initial, solid(&target), |t| slim(&t.name));
        job.target_mesh = target;
        job.rules.tolerance_mm = 0.75;
        job
    }

    /// The cuts from above of what is to go over each of some heights, one after the other, and what comes of them.
    fn made(job: &Job, heights: &[f64]) -> (Vec<Step>, Sparing) {
        made_of(job, &job.initial.minus(&job.target), heights)
    }

    fn made_of(job: &Job, goes: &BitGrid, heights: &[f64]) -> (Vec<Step>, Sparing) {
        with_run(job, |run| {
            let room = Room::of(job);
            let fixed = run.start.setting.fixed(0, &job.initial);
            let made_again = Cell::new(0);
            let points = Points::of(&fixed, &job.frame);
            let turn =
                Turn { run, room: &room, fixed: &fixed, points: &points, made_again: &made_again };
            let (mut state, mut steps) = (job.initial.clone(), Vec::new());
            for height in heights {
                let over = BitGrid::from_fn(job.frame.dims, |v| job.frame.center(v).z > *height);
                let part = state.and(goes).and(&over);
                let mut step = Step {
                    kind: StepKind::Subtractive,
                    tool: "ball-1.4x24".into(),
                    direction: Direction::Z,
                    holding: 0,
                    region: BitGrid::new(job.frame.dims),
                    block: steps.len(),
                    origin: Origin { plane: None, action: Some(Action::OC) },
                };
                step.region = turn.made(&state, &step, &part);
                if !step.region.is_empty() {
                    state.subtract(&step.region);
                    steps.push(step);
                }
            }
            let may = may_stand(run, &job.target);
            let sparing = sparing(run, &room, &steps, (&may, &may)).unwrap();
            (steps, sparing)
        })
    }

    /// Of a slot narrower than its cutter the lower part used to be cut at the price of its walls.
    #[test]
    fn skin_in_a_slot_without_room_stands() {
        let mut job = job(None);
        // Half of the slot is open, so the cut has something to take.
        let wide = BitGrid::from_fn(job.frame.dims, |v| {
            let p = job.frame.center(v);
            (2.0..4.0).contains(&p.x) && (2.5..6.5).contains(&p.y) && (5.0..8.0).contains(&p.z)
        });
        job.target.subtract(&wide);
        let (steps, made) = made(&job, &[5.0, 0.0]);
        let Sparing::Made(after) = made else { panic!("nothing was spared") };
        let slot = |v: &[usize; 3]| (4.5..6.5).contains(&job.frame.center(*v).x);
        let in_slot = |s: &[Step]| -> usize {
            s.iter().map(|s| s.region.iter_ones().filter(slot).count()).sum()
        };
        assert!(in_slot(&steps) > 100, "{}", in_slot(&steps));
        assert!(4 * in_slot(&after) < in_slot(&steps), "{}", in_slot(&after));
        assert_verifies(&job, after);
    }

    /// A pit that goes down along a slot's walls took of the target what its cutter has no room for.
    #[test]
    fn target_in_a_pit_without_room_stands() {
        let mut job = job(None);
        job.rules.tolerance_mm = 0.25;
        let goes = job.initial.minus(&job.target);
        let low = BitGrid::from_fn(job.frame.dims, |v| job.frame.center(v).z < 7.0);
        let pit = goes.and(&low);
        job.target.union_with(&pit);
        let (steps, made) = made_of(&job, &goes, &[5.0, 0.0]);
        let Sparing::Made(after) = made else { panic!("nothing was spared") };
        let in_pit = |s: &[Step]| s.iter().map(|s| s.region.and(&pit).count()).sum::<usize>();
        assert!(in_pit(&steps) > 100, "{}", in_pit(&steps));
        assert!(4 * in_pit(&after) < in_pit(&steps), "{}", in_pit(&after));
    }

    /// What lies under it has to go, and only through it.
    #[test]
    fn skin_in_the_way_of_a_later_cut_goes() {
        let (steps, made) = made(&job(Some(7.0)), &[5.0, 0.0]);
        assert!(steps.len() == 2 && steps[1].region.count() > 100);
        let Sparing::Blocked(by) = made else { panic!("it is not in the way") };
        assert!(!by.is_empty());
    }

    /// What stands over the rest of its cut goes, the others stand: once all of it went.
    #[test]
    fn skin_over_the_rest_of_its_cut_goes_alone() {
        let job = job(Some(4.5));
        let (steps, made) = made(&job, &[0.0]);
        let Sparing::Made(after) = made else { panic!("nothing was spared") };
        let count = |s: &[Step], is_in: &dyn Fn(DVec3) -> bool| -> usize {
            let its =
                |s: &Step| s.region.iter_ones().filter(|v| is_in(job.frame.center(*v))).count();
            s.iter().map(its).sum()
        };
        let (over, beside) = (|p: DVec3| p.z > 5.0 && p.x < 4.0, |p: DVec3| p.x > 5.5);
        assert!(count(&steps, &over) > 100 && count(&steps, &beside) > 100);
        assert!(2 * count(&after, &over) > count(&steps, &over));
        assert!(4 * count(&after, &beside) < count(&steps, &beside));
        assert_verifies(&job, after);
    }

    /// A cut of which all is skin without room is none; what is left is numbered anew.
    #[test]
    fn a_cut_of_which_nothing_is_left_is_none() {
        let region = |any: bool| {
            let mut region = BitGrid::new([2, 1, 1]);
            region.set([0, 0, 0], any);
            region
        };
        let step = |kind: StepKind, block: usize, any: bool| Step {
            kind,
            tool: "ball-1.4x24".into(),
            direction: Direction::Z,
            holding: 0,
            region: region(any),
            block,
            origin: Origin { plane: None, action: None },
        };
        let (cut, laid) = (StepKind::Subtractive, StepKind::Additive);
        let all =
            [(cut, 0, true), (cut, 1, false), (cut, 2, true), (laid, 0, true), (cut, 3, true)];
        let all = all.map(|(kind, block, any)| step(kind, block, any));
        let (left, first) = without_empty(all.to_vec(), 3);
        assert_eq!(first, 2);
        assert_eq!(left.iter().map(|s| s.block).collect::<Vec<_>>(), [0, 1, 0, 2]);
    }
}
