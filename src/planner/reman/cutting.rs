//! Subtractive blocks (W2V Sec. 6): V_S into few directions, the grid axes first.
//!
//! A block is one over-cut on the state left by the one before it, so its order is valid by
//! construction. Which direction comes next is decided by an upper bound computed once per
//! direction and tool: what it could reach if everything removable were gone. Bounds come from the
//! coarse grid; what the blocks chosen by them leave is looked for again on the job's own, along
//! the axes and then, what those leave, along the samples. A bridge that holds a loose tip is of skin where that does: skin
//! may stand. Greedy as all that is, the small cuts of the plan that wins are then
//! chosen anew (`fewest`). Cuts that an earlier plan for nearly the same took come first.

use super::MENDABLE_SHARE;
use super::bridges::{bridges, bridges_or_feet};
use super::coarse::Coarse;
use super::reach::{Reach, SHORTER_TOOL_SHARE, bounds, bounds_along, choose, gains};
use super::setting::Setting;
use crate::access::{Close, Scene, Wanted, over_cut};
use crate::base::{Cancelled, Ctx, DVec3, Direction};
use crate::machine::{Holding, HoldingMode, Tool};
use crate::plan::{Action, Origin, Step, StepKind};
use crate::region::steady;
use crate::voxel::{BitGrid, distance_within};
use rayon::prelude::*;

/// The subtractive steps, the state they leave, and what of the deep material they left standing.
pub struct Cutting {
    pub steps: Vec<Step>,
    pub state: BitGrid,
    pub unreached: BitGrid,
}

/// A block chosen on the coarse grid removes at least this share of the deep material: below it
/// the coarse look misjudges, and the fine one that follows chooses better.
const COARSE_GAIN_SHARE: f64 = 0.002;

/// Blocks tried in vain, one after the other, before a stage ends: each costs an over-cut, and
/// the bounds are close enough that the first few tell.
const COARSE_PATIENCE: usize = 3;
const PATIENCE: usize = 5;

/// With patience, one more for every so many voxels that are left, and so many more at most: the bounds of some
/// directions, which see all of it, hide those along which a little can be had. On a bracket 4,700 voxels were left
/// after five in vain, 2,700 this way. Where nothing is printed, the slimmer cutters that follow need fewer.
const VOXELS_A_TRY: usize = 100;
const MOST_MORE: usize = 60;

/// Voxels left up to which the coarse look, which slender tools mislead, has no say: so few cost
/// hardly more along every direction than along some. With none, a real bracket kept its last voxel.
const FEW: usize = 1000;

/// A block that removes this share of what is left may have opened the way for others that were
/// tried in vain.
const RETRY_SHARE: f64 = 0.05;

/// A cut that frees pieces is made again with bridges to them so often: bridges may free others,
/// which is rare twice in a row.
const BRIDGE_ROUNDS: usize = 6;

/// A tip is so many voxels at most, and its bridge of skin is so near to it, in voxels: target that touches the rest of
/// it by a corner, as the tip of an ear does.
const LOOSE_TIP_VOXELS: usize = 100;
const TIP_NEAR: f64 = 3.0;

/// What is to be cut, and from how many directions at most.
pub struct Cuts<'a> {
    pub removable: &'a BitGrid,
    /// The material that decides which directions are taken; the rest (skin) goes along.
    pub deep: &'a BitGrid,
    /// Sampled directions per hemisphere.
    pub samples: usize,
    /// Cuts of an earlier plan for nearly the same, made first as far as they still remove anything:
    /// few others are then left to look for.
    pub before: &'a [Step],
    /// Whether more directions are tried while much is left, as where anything is printed.
    pub patient: bool,
}

/// Cuts what is removable from the initial part as far as tools reach while the rest of it stands.
pub fn cut_blocks(
    setting: &Setting,
    coarse: &Coarse,
    cuts: &Cuts,
    ctx: &Ctx,
) -> Result<Cutting, Cancelled> {
    let Cuts { removable, deep, samples, before, patient } = *cuts;
    let mut cutter = Cutter::new(setting, coarse, removable, deep);
    cutter.is_patient = patient;
    cutter.repeat(before, false, ctx)?;
    // Where others follow, the usual cutters need not be looked at closely before them.
    let alone = cutter.cutters.len() == setting.all_but_finest().len();
    // Nor again where an earlier plan looked along every direction with them.
    if alone || before.is_empty() {
        cutter.cut(samples, alone, ctx)?;
    }
    for cutters in [setting.all_but_finest(), setting.cutters()] {
        if cutter.cutters.len() == cutters.len() || cutter.cutting.unreached.is_empty() {
            continue;
        }
        cutter.cutters = cutters;
        cutter.cut(samples, true, ctx)?;
        if setting.cuts_closely() {
            cutter.cut_closely(samples, ctx)?;
        }
    }
    Ok(cutter.cutting)
}

/// Cuts from the initial part, in the ways of some steps and in their order, as far as each still
/// removes any of the deep material of what is removable.
pub fn repeated(
    setting: &Setting,
    coarse: &Coarse,
    (removable, deep): (&BitGrid, &BitGrid),
    ways: &[Step],
    ctx: &Ctx,
) -> Result<Cutting, Cancelled> {
    let mut cutter = Cutter::new(setting, coarse, removable, deep);
    cutter.repeat(ways, true, ctx)?;
    Ok(cutter.cutting)
}

/// One cut from the initial part along a direction, as held: with the slimmest cutter that does not
/// taper, or with the longest of the usual ones where that takes nearly as much.
pub fn cut_along(
    setting: &Setting,
    coarse: &Coarse,
    removable: &BitGrid,
    (direction, holding): (Direction, usize),
    ctx: &Ctx,
) -> Result<Cutting, Cancelled> {
    let mut cutter = Cutter::new(setting, coarse, removable, removable);
    let fixed = setting.fixed(holding, &cutter.cutting.state);
    let cut = |tool: &&Tool| {
        ctx.check()?;
        Ok(cutter.held_cut(removable.clone(), &fixed, (*tool, direction), How::ByMaps))
    };
    let longest = Tool::longest(setting.usual_cutters());
    let slimmest = setting.cutters().iter().rfind(|t| !t.is_tapered());
    let tools: Vec<&Tool> = longest.into_iter().chain(slimmest).collect();
    let cuts: Vec<BitGrid> = tools.par_iter().map(cut).collect::<Result<_, Cancelled>>()?;
    let most = cuts.iter().map(BitGrid::count).max().unwrap_or(0);
    let enough = |c: &BitGrid| c.count() as f64 >= SHORTER_TOOL_SHARE * most as f64;
    if let Some((tool, region)) = tools.into_iter().zip(cuts).find(|(_, c)| most > 0 && enough(c)) {
        cutter.push(region, tool, direction, holding);
    }
    Ok(cutter.cutting)
}

/// What of a region a cutter takes away from a state along a direction with nothing coming loose.
pub fn held_part(
    setting: &Setting,
    coarse: &Coarse,
    (state, region): (&BitGrid, &BitGrid),
    fixed: &[DVec3],
    way: (&Tool, Direction),
) -> BitGrid {
    let mut cutter = Cutter::new(setting, coarse, region, region);
    cutter.cutting.state = state.clone();
    cutter.held_cut(region.clone(), fixed, way, How::ByMaps)
}

/// How a cut is found: by depth maps, or near what is left by exact distances.
#[derive(Clone, Copy)]
pub(super) enum How {
    ByMaps,
    Closely,
}

pub(super) struct Cutter<'s, 'a> {
    pub setting: &'s Setting<'a>,
    coarse: &'s Coarse,
    pub removable: &'s BitGrid,
    deep: &'s BitGrid,
    /// What stands at the end, on the coarse grid and on the job's.
    kept: BitGrid,
    pub fine_kept: BitGrid,
    /// Those in use: the usual ones, then all.
    pub cutters: &'a [Tool],
    /// Voxels that a block chosen on the coarse grid removes at least.
    least: usize,
    is_patient: bool,
    pub cutting: Cutting,
}

impl<'s, 'a> Cutter<'s, 'a> {
    fn new(
        setting: &'s Setting<'a>,
        coarse: &'s Coarse,
        removable: &'s BitGrid,
        deep: &'s BitGrid,
    ) -> Self {
        let kept = setting.job.initial.minus(removable);
        let unreached = removable.and(deep);
        Cutter {
            setting,
            coarse,
            removable,
            deep,
            kept: coarse.most(&kept),
            least: (COARSE_GAIN_SHARE * unreached.count() as f64) as usize,
            fine_kept: kept,
            is_patient: false,
            cutters: setting.usual_cutters(),
            cutting: Cutting { steps: Vec::new(), state: setting.job.initial.clone(), unreached },
        }
    }

    /// Makes the cuts of an earlier plan that still remove anything; `again`, also those that were
    /// made by exact distances.
    fn repeat(&mut self, before: &[Step], again: bool, ctx: &Ctx) -> Result<(), Cancelled> {
        let setting = self.setting;
        for of_holding in before.chunk_by(|a, b| a.holding == b.holding) {
            let holding = of_holding[0].holding;
            let fixed = setting.fixed(holding, &self.cutting.state);
            for step in of_holding {
                ctx.check()?;
                let Some(tool) = setting.cutters().iter().find(|t| t.name == step.tool) else {
                    continue;
                };
                let rest = self.removable.and(&self.cutting.state);
                let how = (tool, step.direction);
                let mut region = self.held_cut(rest.clone(), &fixed, how, How::ByMaps);
                if again && region.count_and(&self.cutting.unreached) == 0 && self.few_are_left() {
                    region = self.held_cut(rest, &fixed, how, How::Closely);
                }
                if region.count_and(&self.cutting.unreached) > 0 {
                    self.push(region, tool, step.direction, holding);
                }
            }
        }
        Ok(())
    }

    /// All blocks, holding by holding: along the axes, along the samples that reach what the axes
    /// left, then, if `closely`, whatever the coarse look missed. Only the axes look at what a later
    /// holding reaches too: a pocket open below is left to the holding that has it open above.
    fn cut(&mut self, samples: usize, closely: bool, ctx: &Ctx) -> Result<(), Cancelled> {
        let setting = self.setting;
        let mut ahead: Option<(Vec<Reach<'a>>, Vec<Reach<'a>>)> = None;
        let mut past: Vec<Vec<Reach<'a>>> = Vec::new();
        for holding in 0..setting.holdings.len() {
            let wanted = self.coarse.any(&self.cutting.unreached);
            if wanted.is_empty() {
                return Ok(());
            }
            let fixed = setting.fixed(holding, &self.cutting.state);
            let axes = match ahead.as_mut() {
                Some((axes, _)) => std::mem::take(axes),
                None => self.coarse_bounds(&wanted, &fixed, &setting.axes(holding), ctx)?,
            };
            let none = BitGrid::new(setting.job.frame.dims);
            self.take(&axes, holding, &fixed, Some(self.coarse), &none, ctx)?;
            let wanted = self.coarse.any(&self.cutting.unreached);
            let samples_here = match ahead.take() {
                Some((_, sampled)) => sampled,
                None => {
                    let sampled = setting.sampled(holding, samples);
                    self.coarse_bounds(&wanted, &fixed, &sampled, ctx)?
                }
            };
            let mut later = none;
            if holding + 1 < setting.holdings.len() {
                let next = holding + 1;
                let fixed = setting.fixed(next, &self.cutting.state);
                let axes = self.coarse_bounds(&wanted, &fixed, &setting.axes(next), ctx)?;
                let directions = setting.sampled(next, samples);
                let sampled = self.coarse_bounds(&wanted, &fixed, &directions, ctx)?;
                let mut reached = BitGrid::new(wanted.dims());
                axes.iter().chain(&sampled).for_each(|r| r.bound.add_to(&mut reached));
                later = self.coarse.refined(&reached, setting.job.frame.dims);
                ahead = Some((axes, sampled));
            }
            self.take(&samples_here, holding, &fixed, Some(self.coarse), &later, ctx)?;
            if !closely {
                continue;
            }
            // What no coarse bound is near is looked for last of all, when nothing else stands.
            let few = if holding + 1 < setting.holdings.len() { 0 } else { FEW };
            // What the axes take asks for no look along a hundred directions.
            for some in [&axes, &samples_here] {
                let fine = self.fine_bounds(some, &fixed, &later, few, ctx)?;
                self.take(&fine, holding, &fixed, None, &later, ctx)?;
            }
            past.push(axes.into_iter().chain(samples_here).collect());
        }
        // What was left to a later holding in vain, once more in the earlier ones.
        let none = BitGrid::new(setting.job.frame.dims);
        for holding in (0..past.len().saturating_sub(1)).rev() {
            let fixed = setting.fixed(holding, &self.cutting.state);
            let fine = self.fine_bounds(&past[holding], &fixed, &none, FEW, ctx)?;
            self.take(&fine, holding, &fixed, None, &none, ctx)?;
        }
        Ok(())
    }

    /// Upper bounds of every direction and tool on the coarse grid.
    fn coarse_bounds(
        &self,
        wanted: &BitGrid,
        fixed: &[DVec3],
        directions: &[Direction],
        ctx: &Ctx,
    ) -> Result<Vec<Reach<'a>>, Cancelled> {
        let scene = Scene::new(&self.coarse.job.frame, &self.kept, fixed);
        bounds(&scene, wanted, self.cutters, directions, ctx)
    }

    /// Upper bounds on the job's own grid, for what is left near each coarse bound; of up to `few`
    /// voxels for all.
    fn fine_bounds(
        &self,
        coarse: &[Reach<'a>],
        fixed: &[DVec3],
        later: &BitGrid,
        few: usize,
        ctx: &Ctx,
    ) -> Result<Vec<Reach<'a>>, Cancelled> {
        let frame = &self.setting.job.frame;
        let scene = Scene::new(frame, &self.fine_kept, fixed);
        let left = &self.cutting.unreached.minus(later);
        let wanted = self.coarse.any(left);
        let all_left = Wanted::of(left);
        let few = all_left.count() <= few;
        let cutters = self.cutters;
        // The bounds of one direction stand together, one a tool.
        let fine: Vec<Vec<Reach<'a>>> = coarse
            .par_chunks(cutters.len())
            .map(|of_direction| {
                ctx.check()?;
                let mut doubtful = BitGrid::new(wanted.dims());
                of_direction.iter().for_each(|r| r.bound.add_to(&mut doubtful));
                // A coarse bound may be wrong by a coarse voxel.
                doubtful = doubtful.grown();
                doubtful.intersect_with(&wanted);
                if left.is_empty() || !few && doubtful.is_empty() {
                    return Ok(Vec::new());
                }
                let direction = of_direction[0].direction;
                if few {
                    return Ok(bounds_along(&scene, &all_left, cutters, direction));
                }
                let near = self.coarse.refined(&doubtful, frame.dims).and(left);
                Ok(bounds_along(&scene, &Wanted::of(&near), cutters, direction))
            })
            .collect::<Result<_, Cancelled>>()?;
        Ok(fine.into_iter().flatten().collect())
    }

    /// The over-cut along a direction that lets nothing come loose; empty where none does.
    pub(super) fn held_cut(
        &self,
        mut rest: BitGrid,
        fixed: &[DVec3],
        (tool, direction): (&Tool, Direction),
        how: How,
    ) -> BitGrid {
        let job = self.setting.job;
        let state = &self.cutting.state;
        for _ in 0..BRIDGE_ROUNDS {
            let region = match how {
                How::ByMaps => over_cut(&job.frame, state, &rest, fixed, tool, direction).region,
                How::Closely => {
                    let few = &self.cutting.unreached;
                    Close::new(&job.frame, state, (&rest, few), fixed).cut(tool, direction)
                }
            };
            if region.is_empty() {
                return region;
            }
            let standing = state.minus(&region);
            let held = steady(&standing, &job.frame, job.rules.holding, job.rules.grip_mm);
            let loose = standing.minus(&held);
            if loose.is_empty() {
                return region;
            }
            let feet = || match job.rules.holding {
                HoldingMode::Base => {
                    Holding::AS_CLAMPED.contact(&region, &job.frame, job.rules.grip_mm)
                }
                HoldingMode::Refixture => BitGrid::new(region.dims()),
            };
            let aside = self.spare_near(&loose).and(&region);
            let mut bridges = bridges(&held, &loose, &aside);
            if bridges.is_empty() {
                bridges = bridges_or_feet(&held, &loose, &region, feet);
            }
            tracing::debug!(loose = loose.count(), bridges = bridges.count(), "bridge");
            if bridges.is_empty() {
                break;
            }
            rest.subtract(&bridges);
        }
        BitGrid::new(state.dims())
    }

    /// What may stand at the end beside a loose tip: skin. A bridge of it is no residual.
    fn spare_near(&self, loose: &BitGrid) -> BitGrid {
        match loose.count() <= LOOSE_TIP_VOXELS {
            true => distance_within(loose, TIP_NEAR).and(self.removable).minus(self.deep),
            false => BitGrid::new(loose.dims()),
        }
    }

    /// Takes directions greedily until none of them removes any more of the deep material. With
    /// `coarse`, bounds are on the coarse grid and blocks that gain little are left alone. What
    /// a `later` holding reaches counts for no gain.
    fn take(
        &mut self,
        reach: &[Reach<'a>],
        holding: usize,
        fixed: &[DVec3],
        coarse: Option<&Coarse>,
        later: &BitGrid,
        ctx: &Ctx,
    ) -> Result<(), Cancelled> {
        let least = if coarse.is_some() { self.least.max(1) } else { 1 };
        // Directions that removed too little since the last success.
        let mut barren: Vec<usize> = Vec::new();
        loop {
            ctx.check()?;
            let left = self.cutting.unreached.minus(later);
            let patience = match coarse {
                Some(_) => COARSE_PATIENCE,
                None => self.patience(left.count()),
            };
            let left = coarse.map_or(left.clone(), |c| c.any(&left));
            let Some(next) = choose(reach, &gains(reach, &left), &barren) else { return Ok(()) };
            let chosen = &reach[next];
            let rest = self.removable.and(&self.cutting.state).minus(later);
            let region = self.held_cut(rest, fixed, (chosen.tool, chosen.direction), How::ByMaps);
            let gain = region.count_and(&self.cutting.unreached);
            tracing::debug!(
                holding,
                tool = chosen.tool.name,
                direction = ?chosen.direction,
                on = if coarse.is_some() { "coarse" } else { "fine" },
                gain,
                left = self.cutting.unreached.count() - gain,
                "cut"
            );
            if gain < least {
                barren.push(next);
                if barren.len() >= patience {
                    return Ok(());
                }
                continue;
            }
            if gain as f64 >= RETRY_SHARE * self.cutting.unreached.count() as f64 {
                barren.clear();
            }
            self.push(region, chosen.tool, chosen.direction, holding);
        }
    }

    /// Tries in vain before an end on the job's own grid while so much is left.
    fn patience(&self, left: usize) -> usize {
        let share = left as f64 / self.setting.job.target.count().max(1) as f64;
        let takes_more = self.is_patient && share <= MENDABLE_SHARE;
        PATIENCE + if takes_more { (left / VOXELS_A_TRY).min(MOST_MORE) } else { 0 }
    }

    /// Makes a cut.
    pub(super) fn push(
        &mut self,
        region: BitGrid,
        tool: &Tool,
        direction: Direction,
        holding: usize,
    ) {
        let cutting = &mut self.cutting;
        cutting.state.subtract(&region);
        cutting.unreached.subtract(&region);
        cutting.steps.push(Step {
            kind: StepKind::Subtractive,
            tool: tool.name.clone(),
            direction,
            holding,
            region,
            block: cutting.steps.len(),
            origin: Origin { plane: None, action: Some(Action::OC) },
        });
    }
}

#[cfg(test)]
mod tests {
    use super::super::local_tests::job_of;
    use super::*;
    use crate::voxel::Frame;

    /// A leg on a block of its own, which stood because its cut would have freed the leg from all sides.
    #[test]
    fn what_carries_a_piece_apart_is_cut_but_for_a_foot() {
        let frame = Frame { pitch: 1.0, dims: [34, 26, 24], origin: DVec3::ZERO };
        let main = |[x, y, z]: [usize; 3]| x < 12 && (4..22).contains(&y) && z < 20;
        let apart = |[x, y, z]: [usize; 3]| (20..32).contains(&x) && (8..18).contains(&y) && z < 20;
        let initial = BitGrid::from_fn(frame.dims, |v| main(v) || apart(v));
        let target = BitGrid::from_fn(frame.dims, |v| main(v) || apart(v) && v[2] >= 12);
        let job = job_of(frame, initial, target, |t| t.name == "ball-3x30");
        let (setting, coarse) = (Setting::new(&job), Coarse::of(&job));
        let removable = job.initial.minus(&job.target);
        let cuts = Cuts {
            removable: &removable,
            deep: &removable,
            samples: 20,
            before: &[],
            patient: false,
        };
        let cut = cut_blocks(&setting, &coarse, &cuts, &Ctx::quiet()).unwrap();
        let left = cut.unreached.count();
        assert!(left > 0 && 4 * left < removable.count(), "{left} of {}", removable.count());
        let held = |solid: &BitGrid| steady(solid, &frame, job.rules.holding, job.rules.grip_mm);
        assert_eq!(held(&cut.state), cut.state);
    }

    /// The tip of a cow's ear touches the rest of it by a corner; the stock beside it stood for good.
    #[test]
    fn a_tip_hangs_on_skin_rather_than_on_what_has_to_go() {
        let frame = Frame { pitch: 1.0, dims: [30, 30, 24], origin: DVec3::ZERO };
        let tip = [20, 20, 10];
        let block = |[x, y, z]: [usize; 3]| (4..20).contains(&x) && (4..20).contains(&y) && z < 10;
        let stock = |[x, y, z]: [usize; 3]| {
            (17..25).contains(&x) && (17..25).contains(&y) && (7..14).contains(&z)
        };
        let initial = BitGrid::from_fn(frame.dims, |v| block(v) || stock(v));
        let target = BitGrid::from_fn(frame.dims, |v| block(v) || v == tip);
        let job = job_of(frame, initial, target, |_| true);
        let (setting, coarse) = (Setting::new(&job), Coarse::of(&job));
        let removable = job.initial.minus(&job.target);
        let deep = removable.minus(&distance_within(&job.target, 1.0));
        let cuts =
            Cuts { removable: &removable, deep: &deep, samples: 20, before: &[], patient: false };
        let cut = cut_blocks(&setting, &coarse, &cuts, &Ctx::quiet()).unwrap();
        assert_eq!(cut.unreached.count(), 0);
        let held = steady(&cut.state, &frame, job.rules.holding, job.rules.grip_mm);
        assert!(held.get(tip) && held == cut.state);
    }

    /// On a bracket five directions in vain hid those along which half of the supports could be had.
    #[test]
    fn patience_grows_with_what_is_left_where_anything_is_printed() {
        let frame = Frame { pitch: 1.0, dims: [100, 100, 40], origin: DVec3::ZERO };
        let block = BitGrid::from_fn(frame.dims, |[x, y, z]| {
            (2..98).contains(&x) && (2..98).contains(&y) && (1..37).contains(&z)
        });
        let job = job_of(frame, block.clone(), block, |_| true);
        let (setting, coarse) = (Setting::new(&job), Coarse::of(&job));
        let none = BitGrid::new(job.frame.dims);
        let mut cutter = Cutter::new(&setting, &coarse, &none, &none);
        let plain = |n| cutter.patience(n);
        assert_eq!([0, 1000, 5000, 200_000].map(plain), [PATIENCE; 4]);
        cutter.is_patient = true;
        let patient = |n| cutter.patience(n);
        let want = [5, 15, 25, 65, 5];
        assert_eq!([0, 1000, 2000, 6500, 200_000].map(patient), want);
    }
}
