//! Subtractive blocks (W2V Sec. 6): V_S into few directions, the grid axes first.
//!
//! A block is one over-cut on the state left by the one before it, so its order is valid by
//! construction. Which direction comes next is decided by an upper bound computed once per
//! direction and tool: what it could reach if everything removable were gone.

use super::setting::Setting;
use crate::access::{Cut, Scene, cutter_map, over_cut, reachable, world_extent};
use crate::base::{Cancelled, Ctx, DVec3, Direction};
use crate::machine::Tool;
use crate::plan::{Action, Origin, Step, StepKind};
use crate::voxel::BitGrid;
use rayon::prelude::*;

/// The subtractive steps, the state they leave, and what of the deep material they left standing.
pub struct Cutting {
    pub steps: Vec<Step>,
    pub state: BitGrid,
    pub unreached: BitGrid,
    /// Samples of the deep material that no direction reaches even past everything removable.
    pub inaccessible: usize,
}

/// A direction with a tool and the deep material it could reach at best.
struct Reach<'a> {
    direction: Direction,
    tool: &'a Tool,
    bound: BitGrid,
}

/// A shorter tool is taken when it reaches this share of what the best tool reaches; the rest is
/// left to a later block. Lower means more tool changes, higher means longer tools everywhere.
const SHORTER_TOOL_SHARE: f64 = 0.97;

/// Cuts `removable` from `state` as far as tools reach while `kept` = state − removable stands.
/// Only material in `deep` decides which directions are taken; the rest (skin) goes along.
pub fn cut_blocks(
    setting: &Setting,
    removable: &BitGrid,
    deep: &BitGrid,
    samples: usize,
    ctx: &Ctx,
) -> Result<Cutting, Cancelled> {
    let mut cutting = Cutting {
        steps: Vec::new(),
        state: setting.job.initial.clone(),
        unreached: removable.and(deep),
        inaccessible: 0,
    };
    let kept = setting.job.initial.minus(removable);
    for holding in 0..setting.holdings.len() {
        let fixed = setting.fixed(holding, &cutting.state);
        let axes = setting.axes(holding);
        // Sampled directions look only at what the axes left.
        for directions in [axes, setting.sampled(holding, samples)] {
            if cutting.unreached.is_empty() {
                break;
            }
            let reach = bounds(setting, &kept, &cutting.unreached, &fixed, &directions, ctx)?;
            take(setting, removable, holding, &fixed, reach, &mut cutting, ctx)?;
        }
    }
    cutting.inaccessible = cutting.unreached.count();
    Ok(cutting)
}

/// Upper bounds of every direction and tool.
fn bounds<'a>(
    setting: &Setting<'a>,
    kept: &BitGrid,
    wanted: &BitGrid,
    fixed: &[DVec3],
    directions: &[Direction],
    ctx: &Ctx,
) -> Result<Vec<Reach<'a>>, Cancelled> {
    let frame = &setting.job.frame;
    let scene = Scene::new(frame, kept, fixed);
    let Some(within) = world_extent(wanted, frame) else { return Ok(Vec::new()) };
    let pairs: Vec<(Direction, &Tool)> =
        directions.iter().flat_map(|d| setting.job.cutters.iter().map(move |t| (*d, t))).collect();
    pairs
        .into_par_iter()
        .map(|(direction, tool)| {
            ctx.check()?;
            let map = cutter_map(&scene, &within, tool, direction);
            Ok(Reach { direction, tool, bound: reachable(&map, wanted, frame) })
        })
        .collect()
}

/// Takes directions greedily until none of them removes any more of the deep material.
fn take(
    setting: &Setting,
    removable: &BitGrid,
    holding: usize,
    fixed: &[DVec3],
    mut reach: Vec<Reach>,
    cutting: &mut Cutting,
    ctx: &Ctx,
) -> Result<(), Cancelled> {
    let job = setting.job;
    // Directions that removed nothing since the last success.
    let mut barren: Vec<usize> = Vec::new();
    loop {
        ctx.check()?;
        let gains: Vec<usize> =
            reach.par_iter().map(|r| r.bound.count_and(&cutting.unreached)).collect();
        let Some(next) = choose(&reach, &gains, &barren) else { return Ok(()) };
        let chosen = &reach[next];
        let rest = removable.and(&cutting.state);
        let Cut { region, .. } =
            over_cut(&job.frame, &cutting.state, &rest, fixed, chosen.tool, chosen.direction);
        if region.count_and(&cutting.unreached) == 0 {
            barren.push(next);
            continue;
        }
        barren.clear();
        cutting.state.subtract(&region);
        cutting.unreached.subtract(&region);
        cutting.steps.push(Step {
            kind: StepKind::Subtractive,
            tool: chosen.tool.name.clone(),
            direction: chosen.direction,
            holding,
            region,
            block: cutting.steps.len(),
            origin: Origin { plane: None, action: Some(Action::OC) },
        });
        reach.retain(|r| r.bound.intersects(&cutting.unreached));
    }
}

/// The direction with the largest gain, and for it the first tool (they come shortest first) that
/// reaches nearly as much as the best.
fn choose(reach: &[Reach], gains: &[usize], barren: &[usize]) -> Option<usize> {
    let open = |i: &usize| gains[*i] > 0 && !barren.contains(i);
    let best = (0..reach.len()).filter(open).max_by_key(|&i| (gains[i], std::cmp::Reverse(i)))?;
    let enough = SHORTER_TOOL_SHARE * gains[best] as f64;
    (0..reach.len())
        .filter(open)
        .find(|&i| reach[i].direction == reach[best].direction && gains[i] as f64 >= enough)
}
