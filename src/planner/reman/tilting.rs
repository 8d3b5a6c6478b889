//! Tilting: what a cut's cutter has no room for is cut along another direction.
//!
//! Method. Slimmer cutters have no more room than a cut's own where it is the edge or the shank that a wall
//! or an overhang beside the voxels leaves none (see `room`, `fitting`). Of each cut of which paths could not leave
//! as much, what is crowded is left to later cuts of the same run, each of which takes what it has room for along its
//! own direction; and what these do not take to cuts of their own right after it, along the directions and with
//! the cutters that have room for most.
//!
//! Guarantees: those of cuts: each cut between that and the one to which it is left is asked again while it stands, but
//! for those whose tool comes nowhere near it, and what it does not reach then goes with it. The state after the run is what it was. Not guaranteed: that there is
//! such a direction; that all cuts are looked at where there are many; that all that goes with the crowded has room:
//! of it a quarter as many as those may have none.

use super::Run;
use super::cutting::held_part;
use super::fitting::over;
use super::reach::{Reach, bounds};
use super::room::{Points, Room, WIDER_VOXELS};
use super::roughing::with_room;
use super::round::Attempt;
use crate::access::{Close, Scene};
use crate::base::DVec3;
use crate::machine::Tool;
use crate::plan::{Action, Origin, Step, StepKind};
use crate::planner::PlanError;
use crate::region::steady;
use crate::voxel::BitGrid;
use std::cell::Cell;
use std::cmp::Reverse;

/// Paths may leave two percent of a cut: so much of it is no reason to cut it otherwise.
const SPARE_SHARE: f64 = 0.01;

/// Fewer are left with their cut.
const LEAST_VOXELS: usize = 8;

/// A cut of its own takes at least this share of what is left then.
const LEAST_SHARE: f64 = 0.25;

/// What has no room in the later cut either is no more than one in so many of those left to it.
const STILL_CROWDED: usize = 4;

/// So many voxels may go with those left to a later cut, and as many as all of their cut.
const MOST_BEHIND: usize = 1000;

/// What lies over what is out of a later cut's reach, and so many radii beside that, stays with its own cut.
pub(super) const BESIDE_RADII: [f64; 2] = [1.0, 2.0];

/// Later cuts are asked so far ahead.
const AHEAD: usize = 16;

/// Of those so many are tried for the crowded of one cut, and so many along directions of their own.
const MOST_HOMES: usize = 6;
const MOST_TRIES: usize = 3;

/// Later cuts farther ahead than this are asked by themselves before all between.
const FAR: usize = 2;

/// So many cuts are made again at most, where a search of directions counts as [`SEARCH`]: a bracket of
/// hundreds of small cuts would take as long as its plan.
const MOST_MADE: usize = 400;
const SEARCH: usize = 10;

/// What stands is near a cut that is so many voxels beside it, and in a tool's way so many voxels beside that.
const NEAR_VOXELS: f64 = 2.0;

/// Cuts of so few voxels are asked by exact distances where maps say no.
const MOST_CLOSELY: usize = 3000;

/// The plan with what its cutters have no room for cut along other directions; one that the rules refuse as it is, since
/// no paths are made of it.
pub fn tilted(run: &mut Run, room: &Room, attempt: Attempt) -> Result<Attempt, PlanError> {
    let setting = run.start.setting;
    if !attempt.is_valid(setting.job) {
        return Ok(attempt);
    }
    let mut state = setting.job.initial.clone();
    let (mut steps, mut cuts, mut at): (Vec<Step>, usize, usize) = (Vec::new(), 0, 0);
    let made_again = Cell::new(0);
    let turns = attempt.steps.chunk_by(|a, b| (a.kind, a.holding) == (b.kind, b.holding));
    for turn in turns {
        let mut made = turn.to_vec();
        if turn[0].kind == StepKind::Subtractive {
            let fixed = setting.fixed(turn[0].holding, &state);
            let points = Points::of(&fixed, &setting.job.frame);
            let turn = Turn { run, room, fixed: &fixed, points: &points, made_again: &made_again };
            made = turn.tilted(&state, made)?;
        }
        for step in &made {
            match step.kind {
                StepKind::Subtractive => state.subtract(&step.region),
                StepKind::Additive => state.union_with(&step.region),
            }
        }
        steps.extend(made);
        at += turn.len();
        if at <= attempt.cuts {
            cuts = steps.len();
        }
    }
    let of_kind = steps.iter_mut().filter(|s| s.kind == StepKind::Subtractive);
    of_kind.enumerate().for_each(|(block, s)| s.block = block);
    run.clock.lap("blocks");
    Ok(Attempt { steps, cuts, ..attempt })
}

/// Whether so many voxels are more of a cut than paths may leave.
pub(super) fn is_too_much(crowded: &BitGrid, step: &Step) -> bool {
    crowded.count() as f64 > SPARE_SHARE * step.region.count() as f64
}

/// Whether they are more than that, and enough to cut them otherwise.
fn is_worth_it(crowded: &BitGrid, step: &Step) -> bool {
    crowded.count() >= LEAST_VOXELS && is_too_much(crowded, step)
}

/// What comes of cuts while voxels of the first stand.
struct Standing {
    new: Vec<Step>,
    /// After them.
    state: BitGrid,
    /// Those voxels, and what the cuts do not reach for them.
    taken: BitGrid,
}

/// Cuts of one holding after each other.
pub(super) struct Turn<'r, 'a> {
    pub run: &'r Run<'a>,
    pub room: &'r Room<'a>,
    pub fixed: &'r [DVec3],
    /// The same for [`Room`].
    pub points: &'r Points,
    /// Cuts made again so far.
    pub made_again: &'r Cell<usize>,
}

impl<'a> Turn<'_, 'a> {
    fn tilted(&self, state: &BitGrid, mut steps: Vec<Step>) -> Result<Vec<Step>, PlanError> {
        let mut state = state.clone();
        let mut i = 0;
        while i < steps.len() {
            self.run.ctx.check()?;
            if !self.run.ctx.out_of_time() && self.made_again.get() < MOST_MADE {
                let crowded = self.crowded(&state, &steps[i]);
                if is_worth_it(&crowded, &steps[i]) {
                    let left = self.left_to_later(&state, &mut steps[i..], crowded)?;
                    let left = self.crowded_by_target(&state, &left, &steps[i]);
                    if is_worth_it(&left, &steps[i]) {
                        let more = self.tilted_cuts(&state, &mut steps[i], left)?;
                        steps.splice(i + 1..i + 1, more);
                    }
                }
            }
            state.subtract(&steps[i].region);
            i += 1;
        }
        steps.retain(|s| !s.region.is_empty());
        Ok(steps)
    }

    pub fn tool(&self, step: &Step) -> Option<&'a Tool> {
        self.run.start.setting.job.cutters.iter().find(|t| t.name == step.tool)
    }

    /// What of a cut its own cutter has no room for.
    pub fn crowded(&self, state: &BitGrid, step: &Step) -> BitGrid {
        let job = self.run.start.setting.job;
        let Some(tool) = self.tool(step) else { return BitGrid::new(state.dims()) };
        let way = (tool, step.direction);
        let wide = (tool, step.direction, WIDER_VOXELS);
        let tight = step.region.minus(&with_room(job, state, &step.region, self.fixed, wide));
        let after = state.minus(&step.region);
        tight.minus(&self.room.after(&after, Some(self.points), &tight, way))
    }

    /// What of the crowded of a cut has no room beside the target alone. Beside pedestal and table other directions
    /// seldom have more, and looking for them takes seconds.
    fn crowded_by_target(&self, state: &BitGrid, crowded: &BitGrid, step: &Step) -> BitGrid {
        let Some(tool) = self.tool(step) else { return crowded.clone() };
        let (after, way) = (state.minus(&step.region), (tool, step.direction));
        crowded.minus(&self.room.after(&after, None, crowded, way))
    }

    /// Leaves what is crowded of the first of some cuts to those after it, as far as they have room; returns the rest.
    fn left_to_later(
        &self,
        state: &BitGrid,
        steps: &mut [Step],
        mut crowded: BitGrid,
    ) -> Result<BitGrid, PlanError> {
        let mut homes: Vec<(usize, BitGrid)> = Vec::new();
        let mut after = state.minus(&steps[0].region);
        for (j, step) in steps.iter().enumerate().skip(1).take(AHEAD) {
            self.run.ctx.check()?;
            after.subtract(&step.region);
            // Of other ends it is not known whether they have room.
            if let Some(tool) = self.tool(step).filter(|t| Room::is_told_of(t)) {
                let way = (tool, step.direction);
                homes.push((j, self.room.after(&after, Some(self.points), &crowded, way)));
            }
        }
        for _ in 0..MOST_HOMES {
            homes.iter_mut().for_each(|(_, its)| its.intersect_with(&crowded));
            homes.retain(|(_, its)| !its.is_empty());
            let most = homes.iter().enumerate().max_by_key(|(_, h)| (h.1.count(), Reverse(h.0)));
            let Some(next) = most.map(|(k, _)| k) else { break };
            let (j, its) = homes.swap_remove(next);
            if let Some(taken) = self.left_to(state, &mut steps[..=j], its)? {
                crowded.subtract(&taken);
            }
        }
        Ok(crowded)
    }

    /// Leaves some voxels of the first of some cuts to the last, and with them what those before the last do not
    /// reach while they stand; returns what the last takes then, none where it does not or has no room either.
    /// Where little of it is out of the last one's reach, what is over that stays with the first.
    fn left_to(
        &self,
        state: &BitGrid,
        steps: &mut [Step],
        mut its: BitGrid,
    ) -> Result<Option<BitGrid>, PlanError> {
        let last = steps.len() - 1;
        let Some(first) = self.tool(&steps[0]) else { return Ok(None) };
        let way = (first, steps[0].direction);
        if last > FAR {
            // With nothing else left standing it is soon told that the last one does not get at them.
            let mut before = state.clone();
            steps[..last].iter().for_each(|s| before.subtract(&s.region));
            before.union_with(&its);
            let region = steps[last].region.or(&its);
            let missed = region.minus(&self.made(&before, &steps[last], &region));
            if STILL_CROWDED * missed.count() > its.count() {
                return Ok(None);
            }
        }
        for radii in BESIDE_RADII.map(Some).into_iter().chain([None]) {
            let Some(made) = self.while_standing(state, &steps[..last], &its)? else { break };
            let Standing { mut new, state: before, taken } = made;
            let home = &steps[last];
            let still_crowded = self.tool(home).map_or(taken.count(), |tool| {
                let after = before.minus(&home.region).minus(&taken);
                let way = (tool, home.direction);
                let its = self.room.after(&after, Some(self.points), &taken, way);
                taken.count() - its.count()
            });
            if STILL_CROWDED * still_crowded > its.count() {
                break;
            }
            let region = home.region.or(&taken);
            let missed = region.minus(&self.made(&before, home, &region));
            if missed.is_empty() {
                new.push(Step { region, ..home.clone() });
                steps.clone_from_slice(&new);
                return Ok(Some(taken));
            }
            let Some(radii) = radii else { break };
            its.subtract(&over(&self.run.start.setting.job.frame, &its, &missed, way, radii));
            if its.count() < LEAST_VOXELS {
                break;
            }
        }
        Ok(None)
    }

    /// Some cuts while voxels of the first are left standing; none where they are in the way of too much.
    fn while_standing(
        &self,
        state: &BitGrid,
        steps: &[Step],
        its: &BitGrid,
    ) -> Result<Option<Standing>, PlanError> {
        let most = MOST_BEHIND.max(its.count()) + steps[0].region.count();
        let (mut state, mut taken, mut new) = (state.clone(), its.clone(), Vec::new());
        for step in steps {
            self.run.ctx.check()?;
            let rest = step.region.minus(&taken);
            let region = self.made_beside(&state, step, &rest, &taken);
            taken.union_with(&rest.minus(&region));
            if taken.count() > most {
                return Ok(None);
            }
            state.subtract(&region);
            new.push(Step { region, ..step.clone() });
        }
        Ok(Some(Standing { new, state, taken }))
    }

    /// Cuts right after one that take what is crowded of it, as far as any have room.
    fn tilted_cuts(
        &self,
        state: &BitGrid,
        step: &mut Step,
        mut crowded: BitGrid,
    ) -> Result<Vec<Step>, PlanError> {
        let setting = self.run.start.setting;
        let job = setting.job;
        let after = state.minus(&step.region);
        let scene = Scene::new(&job.frame, &after, self.fixed);
        let mut directions = setting.axes(step.holding);
        directions.extend(setting.sampled(step.holding, self.run.options.directions));
        // A stouter end seldom has room where its own has none.
        let own = self.tool(step).map_or(0.0, Tool::tip_radius);
        let is_slim = |t: &&Tool| t.tip_radius() <= own && Room::is_told_of(t);
        let slim: Vec<Tool> = job.cutters.iter().filter(is_slim).cloned().collect();
        self.count(SEARCH);
        let mut ways = bounds(&scene, &crowded, &slim, &directions, self.run.ctx)?;
        let mut cuts = vec![step.clone()];
        for _ in 0..MOST_TRIES {
            if !is_worth_it(&crowded, &cuts[0]) {
                break;
            }
            self.run.ctx.check()?;
            let Some((way, its)) = self.roomiest(&after, &mut ways, &crowded) else { break };
            cuts.push(Step {
                kind: StepKind::Subtractive,
                tool: way.tool.name.clone(),
                direction: way.direction,
                holding: step.holding,
                region: BitGrid::new(its.dims()),
                block: 0,
                origin: Origin { plane: None, action: Some(Action::OC) },
            });
            match self.left_to(state, &mut cuts, its)? {
                Some(taken) => crowded.subtract(&taken),
                None => cuts.truncate(cuts.len() - 1),
            }
        }
        *step = cuts.remove(0);
        Ok(cuts)
    }

    /// The way that has room for most of some voxels beside what stands after them, taken out of the ways, and that much of them; none where
    /// none has for a share of them. Ways that reach less than that are dropped.
    fn roomiest<'t>(
        &self,
        after: &BitGrid,
        ways: &mut Vec<Reach<'t>>,
        crowded: &BitGrid,
    ) -> Option<(Reach<'t>, BitGrid)> {
        let least = (LEAST_SHARE * crowded.count() as f64).ceil() as usize;
        let words = crowded.words();
        let reached = |way: &Reach| way.bound.count_and(&words);
        ways.retain(|way| reached(way) >= least);
        ways.sort_by_cached_key(|way| Reverse(reached(way)));
        let mut best: Option<(usize, BitGrid)> = None;
        for (i, way) in ways.iter().enumerate() {
            let most = best.as_ref().map_or(least.saturating_sub(1), |(_, its)| its.count());
            if reached(way) <= most {
                break;
            }
            let mut its = BitGrid::new(crowded.dims());
            way.bound.add_to(&mut its);
            its.intersect_with(crowded);
            let its = self.room.after(after, Some(self.points), &its, (way.tool, way.direction));
            if its.count() > most {
                best = Some((i, its));
            }
        }
        best.map(|(i, its)| (ways.remove(i), its))
    }

    fn count(&self, made: usize) {
        self.made_again.set(self.made_again.get() + made);
    }

    /// The same of a cut that is made without `standing`, while that stands besides: all of it where that is
    /// nowhere near the tool.
    pub fn made_beside(
        &self,
        state: &BitGrid,
        step: &Step,
        region: &BitGrid,
        standing: &BitGrid,
    ) -> BitGrid {
        match *region != step.region || self.is_near(standing, step) {
            true => self.made(state, step, region),
            false => region.clone(),
        }
    }

    /// Whether any of some voxels is beside a cut, or where its tool may be for a voxel of the cut's box.
    fn is_near(&self, some: &BitGrid, step: &Step) -> bool {
        let job = self.run.start.setting.job;
        let (Some(tool), Some((low, high))) = (self.tool(step), step.region.extent()) else {
            return true;
        };
        let (frame, plane) = (&job.frame, step.direction.image_plane());
        let spare = DVec3::splat(NEAR_VOXELS * frame.pitch);
        let (low, high) = (frame.center(low) - spare, frame.center(high) + spare);
        let corner = |i: usize| {
            let p = DVec3::from_array([0, 1, 2].map(|a| [low, high][i >> a & 1][a]));
            plane.across(p).extend(plane.height(p))
        };
        let (mut least, mut most) = (corner(0), corner(0));
        (1..8).map(corner).for_each(|c| (least, most) = (least.min(c), most.max(c)));
        // The tip may be beside what its edge cuts, and below it.
        let (aside, below) = (tool.active_radius(), tool.active_length());
        some.iter_ones().map(|v| frame.center(v)).any(|p| {
            let at = plane.across(p);
            let apart = at.distance(at.clamp(least.truncate(), most.truncate()));
            let over = plane.height(p) - (least.z - below);
            let is_beside = p.cmpge(low).all() && p.cmple(high).all();
            is_beside || tool.lower_surface((apart - aside).max(0.0)) <= over
        })
    }

    /// What of a region a step's cutter takes away along its direction.
    pub fn made(&self, state: &BitGrid, step: &Step, region: &BitGrid) -> BitGrid {
        let (setting, coarse) = (self.run.start.setting, self.run.start.coarse);
        let (job, Some(tool)) = (setting.job, self.tool(step)) else {
            return BitGrid::new(region.dims());
        };
        if region.is_empty() {
            return region.clone();
        }
        self.count(1);
        let way = (tool, step.direction);
        let by_maps = held_part(setting, coarse, (state, region), self.fixed, way);
        if by_maps == *region || region.count() > MOST_CLOSELY {
            return by_maps;
        }
        // What was cut by exact distances is asked by them again.
        let closely = Close::new(&job.frame, state, (region, region), self.fixed);
        let closely = closely.cut(tool, step.direction);
        let after = state.minus(&closely);
        match closely.count() > by_maps.count()
            && steady(&after, &job.frame, job.rules.holding, job.rules.grip_mm) == after
        {
            true => closely,
            false => by_maps,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::local_tests::{assert_verifies, job_of, with_run};
    use super::*;
    use crate::base::{Ctx, Direction};
    use crate::mesh::TriMesh;
    use crate::plan::Job;
    use crate::voxel::{Frame, voxelise};

    const CUTTER: &str = "ball-1.4x24";

    /// A block with a pocket 3 mm wide that is open at x = 0, and a slot of 1.2 mm from above into it. By the middles
    /// of voxels a cutter of 1.4 mm fits into the slot; it is the only one.
    fn job() -> Job {
        let boxed = |low: [f64; 3], high: [f64; 3]| TriMesh::cuboid(low.into(), high.into());
        let target = TriMesh::joined(&[
            boxed([0.0, 0.0, 0.0], [9.0, 9.0, 2.0]),
            boxed([0.0, 0.0, 2.0], [9.0, 3.0, 5.0]),
            boxed([0.0, 6.0, 2.0], [9.0, 9.0, 5.0]),
            boxed([6.0, 3.0, 2.0], [9.0, 6.0, 5.0]),
            boxed([0.0, 0.0, 5.0], [9.0, 4.0, 8.0]),
            boxed([0.0, 5.2, 5.0], [9.0, 9.0, 8.0]),
            boxed([6.0, 4.0, 5.0], [9.0, 5.2, 8.0]),
        ]);
        let frame = Frame { pitch: 0.25, dims: [42, 42, 40], origin: DVec3::splat(-0.75) };
        let solid = |mesh: &TriMesh| voxelise(mesh, &frame, &Ctx::quiet()).unwrap();
        let initial = solid(&boxed([0.0, 0.0, 0.0], [9.0, 9.0, 8.0]));
        let mut job = job_of(frame, initial, solid(&target), |t| t.name == CUTTER);
        job.target_mesh = target;
        job
    }

    /// Cuts of all that is to be removed along some directions, each of what those before it left, then made by
    /// `tilted`.
    fn made(job: &Job, along: &[Direction]) -> [Vec<Step>; 2] {
        with_run(job, |run| {
            let room = Room::of(job);
            let fixed = run.start.setting.fixed(0, &job.initial);
            let made_again = Cell::new(0);
            let points = Points::of(&fixed, &job.frame);
            let turn =
                Turn { run, room: &room, fixed: &fixed, points: &points, made_again: &made_again };
            let mut state = job.initial.clone();
            let mut steps = Vec::new();
            for direction in along {
                let mut step = Step {
                    kind: StepKind::Subtractive,
                    tool: CUTTER.into(),
                    direction: *direction,
                    holding: 0,
                    region: BitGrid::new(job.frame.dims),
                    block: steps.len(),
                    origin: Origin { plane: None, action: Some(Action::OC) },
                };
                step.region = turn.made(&state, &step, &state.minus(&job.target));
                state.subtract(&step.region);
                steps.push(step);
            }
            let tilted = turn.tilted(&job.initial, steps.clone()).unwrap();
            [steps, tilted]
        })
    }

    /// How many voxels of some cuts along a direction lie well inside the pocket.
    fn in_pocket(job: &Job, steps: &[Step], along: Direction) -> usize {
        let inside = |v: &[usize; 3]| {
            let p = job.frame.center(*v);
            p.z < 4.0 && (1.0..5.0).contains(&p.x)
        };
        let along = steps.iter().filter(|s| s.direction == along);
        along.map(|s| s.region.iter_ones().filter(inside).count()).sum()
    }

    fn removed(job: &Job, steps: &[Step]) -> BitGrid {
        let mut all = BitGrid::new(job.frame.dims);
        steps.iter().for_each(|s| all.union_with(&s.region));
        all
    }

    /// The edge has no room in the slot for what lies under it in the pocket, which a cut from the pocket's
    /// open side takes.
    #[test]
    fn what_the_edge_has_no_room_for_is_cut_from_another_side() {
        let mut job = job();
        // Beside that the pocket is there already.
        let aside = BitGrid::from_fn(job.frame.dims, |v| {
            let p = job.frame.center(v);
            p.z < 5.0 && !(4.0..5.2).contains(&p.y)
        });
        job.initial.subtract(&aside.minus(&job.target));
        let [before, after] = made(&job, &[Direction::Z]);
        let [many, few] = [&before, &after].map(|s| in_pocket(&job, s, Direction::Z));
        // A voxel in a corner stays with its cut, and what is over it.
        assert!(many > 500 && 8 * few < many, "{few} of {many}");
        assert_eq!(removed(&job, &after), removed(&job, &before));
        assert!(after.len() == 2, "{}", after.len());
        let end = Job { target: job.initial.minus(&removed(&job, &after)), ..job.clone() };
        assert_verifies(&end, after);
    }

    /// A later cut along that direction takes it with its own.
    #[test]
    fn a_later_cut_that_has_room_takes_it() {
        let job = job();
        let [before, after] = made(&job, &[Direction::Z, Direction::NEG_X]);
        assert!(in_pocket(&job, &before, Direction::Z) > 500);
        assert_eq!(in_pocket(&job, &after, Direction::Z), 0);
        assert_eq!(removed(&job, &after), removed(&job, &before));
        assert_eq!(after.len(), 2);
        assert_verifies(&job, after);
    }

    /// Along the pocket there is room, so nothing changes.
    #[test]
    fn what_has_room_stays_in_its_cut() {
        let job = job();
        let [before, after] = made(&job, &[Direction::NEG_X, Direction::Z]);
        assert_eq!(in_pocket(&job, &after, Direction::Z), in_pocket(&job, &before, Direction::Z));
        assert_eq!(removed(&job, &after), removed(&job, &before));
    }

    /// What stands aside of a cut leaves it as it is and is not asked about; what stands over it is in its way.
    #[test]
    fn only_what_is_near_a_cut_is_in_its_way() {
        let job = job();
        with_run(&job, |run| {
            let room = Room::of(&job);
            let fixed = run.start.setting.fixed(0, &job.initial);
            let made_again = Cell::new(0);
            let points = Points::of(&fixed, &job.frame);
            let turn =
                Turn { run, room: &room, fixed: &fixed, points: &points, made_again: &made_again };
            let slot = BitGrid::from_fn(job.frame.dims, |v| job.frame.center(v).z > 5.0);
            let mut step = Step {
                kind: StepKind::Subtractive,
                tool: CUTTER.into(),
                direction: Direction::Z,
                holding: 0,
                region: BitGrid::new(job.frame.dims),
                block: 0,
                origin: Origin { plane: None, action: Some(Action::OC) },
            };
            step.region =
                turn.made(&job.initial, &step, &slot.and(&job.initial.minus(&job.target)));
            assert!(step.region.count() > 1000);
            // A ledge of three voxels on the block.
            for (at, is_near) in [([8.5, 8.0, 8.1], false), ([3.0, 3.9, 8.1], true)] {
                let mut standing = BitGrid::new(job.frame.dims);
                for k in [0.0, 1.0, 2.0] {
                    let p = DVec3::from(at) + DVec3::Y * k * job.frame.pitch;
                    standing.set(job.frame.voxel_at(p).unwrap(), true);
                }
                assert_eq!(turn.is_near(&standing, &step), is_near);
                let state = job.initial.or(&standing);
                let asked = turn.made(&state, &step, &step.region);
                assert_eq!(asked == step.region, !is_near, "{at:?}");
                assert_eq!(turn.made_beside(&state, &step, &step.region, &standing), asked);
            }
        });
    }
}
