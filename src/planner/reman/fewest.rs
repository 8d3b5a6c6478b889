//! Fewest cuts (W2V Sec. 6): the small cuts of a plan give way to as few as take the same.
//!
//! Method. Of each run of cuts the largest stay. Every way to cut (direction, cutter, holding) is
//! a set: what of the material that the small ones took it could reach at best, all of the run's
//! being gone. The least cover of that material by such sets is found exactly ([`set_cover`]); the
//! ways of the cuts that stay cost nothing. The cuts of the cover are made after the large ones of
//! their holding, and the plan's own after them, as far as they still remove anything.
//!
//! Guarantees: those of cuts, and the same state after the run, but for skin that the plan's last cuts
//! may leave as stock; a plan changes only where it gets shorter. As clamped, where the cover's cuts do it alone, no fewer of the ways do it beside the
//! cuts that stay: in no order does a cut reach beyond its set. Not guaranteed: that they do it
//! alone, or that the large cuts are the fewest.

use super::cutting::repeated;
use super::reach::{Bound, bounds};
use super::round::{Attempt, all_of};
use super::setting::Setting;
use super::{Run, Start};
use crate::access::Scene;
use crate::base::{Ctx, Direction};
use crate::machine::{Taken, Tool};
use crate::plan::{Action, Job, Origin, Step, StepKind};
use crate::planner::PlanError;
use crate::search::{WeightedSet, set_cover};
use crate::voxel::BitGrid;
use std::collections::BTreeSet;

/// The small cuts of a run took so many voxels at most, together: each of them is looked for along
/// every direction.
const SMALL_VOXELS: usize = 20_000;

/// Fewer small cuts than this are left as they are.
const LEAST_SMALL: usize = 3;

/// More small cuts than this are left as well: of a real bracket's 231 a cover took two minutes and left some of it.
const MOST_SMALL: usize = 100;

/// What a cut costs more in a holding that no other cut needs, and with the slimmest cutter: less
/// than another cut even where all of them do.
const FURTHER_HOLDING: f64 = 1e-3;
const SLIMMEST: f64 = 1e-4;

/// A way to cut.
#[derive(Clone, Copy)]
struct Way<'a> {
    holding: usize,
    direction: Direction,
    tool: &'a Tool,
}

impl Way<'_> {
    fn is_of(&self, step: &Step) -> bool {
        (self.holding, self.direction, &self.tool.name)
            == (step.holding, step.direction, &step.tool)
    }

    /// The cut this way, what it removes still open.
    fn step(&self) -> Step {
        Step {
            kind: StepKind::Subtractive,
            tool: self.tool.name.clone(),
            direction: self.direction,
            holding: self.holding,
            region: BitGrid::new([0; 3]),
            block: 0,
            origin: Origin { plane: None, action: Some(Action::OC) },
        }
    }
}

/// The plan with each run of cuts made as short as this finds.
pub fn with_fewest_cuts(run: &Run, attempt: Attempt) -> Result<Attempt, PlanError> {
    let job = run.start.setting.job;
    let is_finest = |s: &Step| job.tool(&s.tool).is_some_and(|t| t.taken == Taken::Finest);
    let setting = match attempt.steps.iter().any(is_finest) {
        true => run.start.setting.with_close_cuts(),
        false => run.start.setting.with_last_resort(),
    };
    let start = run.start.in_setting(&setting);
    let skin = setting.skin(&attempt.volumes.reused);
    let none = BitGrid::new(skin.dims());
    let mut state = setting.job.initial.clone();
    let (mut steps, mut stock, mut cuts): (Vec<Step>, _, _) = (Vec::new(), state.clone(), 0);
    let mut turns = attempt.steps.chunk_by(|a, b| a.kind == b.kind).peekable();
    while let Some(turn) = turns.next() {
        if turn[0].kind == StepKind::Additive {
            state.union_with(&all_of(setting.job, turn));
            steps.extend_from_slice(turn);
            continue;
        }
        // What comes later may need the room of the skin.
        let spare = if turns.peek().is_none() { &skin } else { &none };
        let shorter = match run.ctx.out_of_time() {
            true => None,
            false => start.shorter(&state, turn, spare, (run.options.directions, run.ctx))?,
        };
        let is_first = steps.is_empty();
        let made = shorter.unwrap_or_else(|| turn.to_vec());
        state.subtract(&all_of(setting.job, &made));
        steps.extend(made);
        if is_first {
            (cuts, stock) = (steps.len(), state.clone());
        }
    }
    for kind in [StepKind::Subtractive, StepKind::Additive] {
        let of_kind = steps.iter_mut().filter(|s| s.kind == kind);
        of_kind.enumerate().for_each(|(i, s)| s.block = i);
    }
    Ok(Attempt { steps, cuts, stock, ..attempt })
}

/// What a list of cuts costs: each of them, and each time the part is held anew.
fn cost(cuts: &[Step]) -> usize {
    cuts.len() + cuts.windows(2).filter(|w| w[0].holding != w[1].holding).count()
}

/// Which of some cuts are large: all but the smallest that took [`SMALL_VOXELS`] together.
fn large_ones(cuts: &[Step]) -> Vec<bool> {
    let sizes: Vec<usize> = cuts.iter().map(|s| s.region.count()).collect();
    let mut order: Vec<usize> = (0..cuts.len()).collect();
    order.sort_by_key(|&i| (sizes[i], i));
    let mut large = vec![true; cuts.len()];
    let mut taken = 0;
    for i in order {
        taken += sizes[i];
        if taken > SMALL_VOXELS {
            break;
        }
        large[i] = false;
    }
    large
}

impl Start<'_> {
    /// A shorter run of cuts from a state to the one that `cuts` leave, but for what of the `spare`
    /// then stands; none where none was found.
    fn shorter(
        &self,
        state: &BitGrid,
        cuts: &[Step],
        spare: &BitGrid,
        (samples, ctx): (usize, &Ctx),
    ) -> Result<Option<Vec<Step>>, PlanError> {
        let is_large = large_ones(cuts);
        let of = |large: bool| -> Vec<&Step> {
            cuts.iter().zip(&is_large).filter(|(_, l)| **l == large).map(|(s, _)| s).collect()
        };
        let (large, small) = (of(true), of(false));
        if !(LEAST_SMALL..=MOST_SMALL).contains(&small.len()) {
            return Ok(None);
        }
        let removed = all_of(self.setting.job, cuts);
        let job = Job { initial: state.clone(), ..self.setting.job.clone() };
        let setting = self.setting.of_next_round(&job, state.minus(&removed));
        let deep = removed.minus(spare);
        let chosen = cover(&setting, (&removed, &deep), (&large, &small), samples, ctx)?;
        let holdings: BTreeSet<usize> =
            large.iter().map(|s| s.holding).chain(chosen.iter().map(|w| w.holding)).collect();
        let at_best = large.len() + chosen.len() + holdings.len().saturating_sub(1);
        if at_best >= cost(cuts) {
            tracing::debug!(before = cuts.len(), at_best, "fewest cuts");
            return Ok(None);
        }
        let mut order: Vec<Step> = Vec::new();
        for (i, step) in large.iter().enumerate() {
            order.push((*step).clone());
            if large[i + 1..].iter().all(|s| s.holding != step.holding) {
                order.extend(chosen.iter().filter(|w| w.holding == step.holding).map(Way::step));
            }
        }
        let elsewhere = |w: &&Way| large.iter().all(|s| s.holding != w.holding);
        order.extend(chosen.iter().filter(elsewhere).map(Way::step));
        order.extend(small.into_iter().cloned());
        let made = repeated(&setting, self.coarse, (&removed, &deep), &order, ctx)?;
        tracing::debug!(
            before = cuts.len(),
            large = large.len(),
            cover = chosen.len(),
            after = made.steps.len(),
            left = made.unreached.count(),
            "fewest cuts"
        );
        let is_shorter = made.unreached.is_empty() && cost(&made.steps) < cost(cuts);
        Ok(is_shorter.then_some(made.steps))
    }
}

/// The fewest ways, beside those of the large cuts, that could take what the small ones took, those
/// that reach most of it first.
fn cover<'a>(
    setting: &Setting<'a>,
    (removed, deep): (&BitGrid, &BitGrid),
    (large, small): (&[&Step], &[&Step]),
    samples: usize,
    ctx: &Ctx,
) -> Result<Vec<Way<'a>>, PlanError> {
    let job = setting.job;
    let kept = job.initial.minus(removed);
    let mut wanted = BitGrid::new(kept.dims());
    small.iter().for_each(|s| wanted.union_with(&s.region));
    wanted.intersect_with(deep);
    let last_resort = |t: &&Tool| matches!(t.taken, Taken::LastResort | Taken::Finest);
    let is_resorted_to = |t: &Tool| large.iter().chain(small).any(|s| s.tool == t.name);
    let tools = match setting.cutters().iter().filter(last_resort).any(is_resorted_to) {
        true => setting.cutters(),
        false => setting.usual_cutters(),
    };
    let mut sets: Vec<(Way, Vec<usize>)> = Vec::new();
    for holding in 0..setting.holdings.len() {
        let fixed = setting.fixed(holding, &kept);
        let scene = Scene::new(&job.frame, &kept, &fixed);
        let mut directions = setting.axes(holding);
        directions.extend(setting.sampled(holding, samples));
        for r in bounds(&scene, &wanted, tools, &directions, ctx)? {
            sets.push((Way { holding, direction: r.direction, tool: r.tool }, r.bound.ids()));
        }
    }
    sets.retain(|(_, reached)| !reached.is_empty());
    let covers = sets.iter().map(|(_, reached)| reached.as_slice());
    let (elements, covers) = classes(&Bound::of(&wanted).ids(), covers.collect());
    let is_used = |holding: usize| holding == 0 || large.iter().any(|s| s.holding == holding);
    let weight = |way: &Way| {
        if large.iter().any(|s| way.is_of(s)) {
            return 0.0;
        }
        let slim = tools.iter().position(|t| t.name == way.tool.name).unwrap_or(0);
        let further = if is_used(way.holding) { 0.0 } else { FURTHER_HOLDING };
        1.0 + further + SLIMMEST * slim as f64 / tools.len() as f64
    };
    let weighted: Vec<WeightedSet> = sets
        .iter()
        .zip(covers)
        .map(|((way, _), covers)| WeightedSet { weight: weight(way), covers })
        .collect();
    let mut chosen = set_cover(elements, &weighted)?;
    chosen.retain(|&i| weighted[i].weight > 0.0);
    chosen.sort_by_key(|&i| (std::cmp::Reverse(sets[i].1.len()), i));
    Ok(chosen.into_iter().map(|i| sets[i].0).collect())
}

/// Elements that lie in the same sets are one: how many there are then, and which each set has. Those
/// in no set are left out. All ascend.
fn classes(elements: &[usize], sets: Vec<&[usize]>) -> (usize, Vec<Vec<usize>>) {
    let words = sets.len().div_ceil(64);
    let mut sets_of = vec![vec![0u64; words]; elements.len()];
    for (i, set) in sets.iter().enumerate() {
        let places = set.iter().filter_map(|e| elements.binary_search(e).ok());
        places.for_each(|at| sets_of[at][i / 64] |= 1 << (i % 64));
    }
    sets_of.retain(|of| of.iter().any(|w| *w != 0));
    sets_of.sort_unstable();
    sets_of.dedup();
    let has = |i: usize, of: &[u64]| of[i / 64] >> (i % 64) & 1 == 1;
    let covers = |i| (0..sets_of.len()).filter(|c| has(i, &sets_of[*c])).collect();
    (sets_of.len(), (0..sets.len()).map(covers).collect())
}

#[cfg(test)]
mod tests {
    use super::super::coarse::Coarse;
    use super::super::local_tests::job_of;
    use super::*;
    use crate::access::{Cut, over_cut};
    use crate::base::DVec3;
    use crate::voxel::Frame;
    use proptest::prelude::*;

    const DIMS: [usize; 3] = [30, 26, 22];

    fn block([x, y, z]: [usize; 3]) -> bool {
        (3..27).contains(&x) && (3..23).contains(&y) && (1..18).contains(&z)
    }

    /// A block with boxes to be cut out of it.
    fn job(boxes: &[[std::ops::Range<usize>; 3]]) -> Job {
        let frame = Frame { pitch: 1.0, dims: DIMS, origin: DVec3::ZERO };
        let target =
            |v: [usize; 3]| block(v) && !boxes.iter().any(|b| (0..3).all(|a| b[a].contains(&v[a])));
        let [initial, target] = [BitGrid::from_fn(DIMS, block), BitGrid::from_fn(DIMS, target)];
        job_of(frame, initial, target, |t| t.name == "ball-3x30")
    }

    /// The cuts along some directions, one after the other, of those that remove anything.
    fn cuts(job: &Job, along: &[Direction]) -> Vec<Step> {
        let setting = Setting::new(job);
        let tool = &setting.cutters()[0];
        let ways: Vec<Step> =
            along.iter().map(|d| Way { holding: 0, direction: *d, tool }.step()).collect();
        let removable = job.initial.minus(&job.target);
        let coarse = Coarse::of(job);
        repeated(&setting, &coarse, (&removable, &removable), &ways, &Ctx::quiet()).unwrap().steps
    }

    fn shorter(job: &Job, long: &[Step], spare: &BitGrid) -> Option<Vec<Step>> {
        let setting = Setting::new(job);
        let coarse = Coarse::of(job);
        let start =
            Start { setting: &setting, coarse: &coarse, preferred: vec![], bad_bases: vec![] };
        start.shorter(&job.initial, long, spare, (0, &Ctx::quiet())).unwrap()
    }

    /// Notches in three edges of the top, each cut from its side.
    #[test]
    fn what_one_direction_takes_is_not_cut_from_three() {
        let job = job(&[[3..9, 8..18, 12..18], [21..27, 8..18, 12..18], [11..19, 3..9, 12..18]]);
        let long = cuts(&job, &[Direction::NEG_X, Direction::X, Direction::NEG_Y]);
        assert_eq!(long.len(), 3);
        let none = BitGrid::new(DIMS);
        let short = shorter(&job, &long, &none).unwrap();
        assert_eq!(short.len(), 1);
        assert_eq!(short[0].direction, Direction::Z);
        assert_eq!(all_of(&job, &short), all_of(&job, &long));
        // Two are few enough, and one is the least there is.
        assert!(shorter(&job, &long[..2], &none).is_none());
    }

    /// A slot through the side that only its own direction reaches is cut for; spare, it stands.
    #[test]
    fn what_may_stand_asks_for_no_cut() {
        let slot = [3..9, 11..16, 4..9];
        let job = job(&[[21..27, 8..18, 12..18], [11..19, 3..9, 12..18], slot.clone()]);
        let long = cuts(&job, &[Direction::X, Direction::NEG_Y, Direction::NEG_X]);
        assert_eq!(long.len(), 3);
        let of = |spare: &BitGrid| shorter(&job, &long, spare).unwrap();
        assert_eq!(of(&BitGrid::new(DIMS)).len(), 2);
        let spare = BitGrid::from_fn(DIMS, |v| (0..3).all(|a| slot[a].contains(&v[a])));
        assert_eq!(of(&spare).len(), 1);
    }

    /// The least number of cuts along the axes, in any order, that remove `rest` from a state.
    fn least(job: &Job, state: &BitGrid, rest: &BitGrid, most: usize) -> Option<usize> {
        if rest.is_empty() {
            return Some(0);
        }
        if most == 0 {
            return None;
        }
        let setting = Setting::new(job);
        let fixed = setting.fixed(0, state);
        let next = |d: Direction| {
            let tool = &setting.cutters()[0];
            let Cut { region, .. } = over_cut(&job.frame, state, rest, &fixed, tool, d);
            (!region.is_empty())
                .then(|| least(job, &state.minus(&region), &rest.minus(&region), most - 1))?
        };
        setting.axes(0).into_iter().filter_map(next).min().map(|n| n + 1)
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 12, ..ProptestConfig::default() })]

        /// From cuts along all axes: as few as any order of any of them needs.
        #[test]
        fn no_fewer_would_do(
            places in prop::collection::vec((0usize..5, 4usize..16, 4usize..12), 3..7),
            turn in 0usize..5,
        ) {
            let boxes: Vec<_> = places
                .iter()
                .map(|&(side, a, b)| match side {
                    0 => [3..9, a..a + 6, b..b + 6],
                    1 => [21..27, a..a + 6, b..b + 6],
                    2 => [a..a + 6, 3..9, b..b + 6],
                    3 => [a..a + 6, 17..23, b..b + 6],
                    _ => [a..a + 6, b..b + 6, 12..18],
                })
                .collect();
            let job = job(&boxes);
            let mut axes = Setting::new(&job).axes(0);
            axes.rotate_left(turn);
            let twice: Vec<Direction> = axes.iter().chain(&axes).copied().collect();
            let long = cuts(&job, &twice);
            prop_assume!(long.len() >= LEAST_SMALL);
            let removed = all_of(&job, &long);
            let short = shorter(&job, &long, &BitGrid::new(DIMS));
            let found = short.as_ref().map_or(long.len(), Vec::len);
            if let Some(short) = short {
                prop_assert_eq!(&all_of(&job, &short), &removed);
            }
            prop_assert_eq!(Some(found), least(&job, &job.initial, &removed, found));
        }
    }

    #[test]
    fn elements_alike_are_one_and_those_in_no_set_none() {
        let (count, covers) = classes(&[3, 5, 8, 9, 12], vec![&[3, 5, 9], &[9], &[3, 5, 7]]);
        assert_eq!(count, 2);
        assert_eq!(covers.iter().map(Vec::len).collect::<Vec<_>>(), [2, 1, 1]);
        assert!(covers[0].contains(&covers[1][0]) && covers[1] != covers[2]);
    }
}
