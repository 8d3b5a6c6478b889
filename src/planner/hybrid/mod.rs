//! From any state to any target with arbitrary tools (HB: Harabin & Behandish, *Hybrid
//! Manufacturing Process Planning for Arbitrary Part and Tool Shapes*).
//!
//! | symbol | here | meaning |
//! |---|---|---|
//! | P_i, P | `site::Site` | the state, the target |
//! | T = H ∪ K, R | tool, direction | the whole tool, its rotation |
//! | A, O_k | `cutting` | accessible region, iterates of an obstacle |
//! | C | `undercut` | collateral |
//! | U, V, A* | `filling` | what stands by itself, what supports, what is accessible and stands |
//! | φ: OC, UC, UF, OF | `world::Action` | over-/under-cut, under-/over-fill |
//! | λ, w, δ | [`Options`] | c_SM/c_AM, weight of the estimate, deviation of a goal |
//! | f = g + (1 + w) h | [`crate::search::ida()`] | cost so far and estimate |
//!
//! Stages, in the paper's order: actions (Sec. 4: `cutting`, `undercut`, `filling`; cuts by tools of
//! any shape: `shaped`), the space of
//! plans (Sec. 5: `world`), costs (Sec. 6.1: `cost`), search (Sec. 6: [`crate::search::ida()`]), and
//! the plan's steps (here).
//!
//! What differs from the paper, and why:
//! - Actions go along the six grid axes, where the depth engine is exact, and are computed on
//!   columns instead of by convolutions in space.
//! - A step must leave nothing loose: an over-cut leaves bridges to what it would free, an
//!   under-cut takes it along, a fill leaves it out.
//! - A plate carries deposits in the first pose only, along +z; elsewhere the part must.
//! - Of the seven relative rotations two end in a direction that others end in as well, and no tool
//!   of revolution tells them apart: five directions a step, six with all 24.
//! - An under-cut is not made before a lower bound of its cost lets it pass.
//! - Overhangs carry themselves up to the angle of the rules unless [`Options::overhang_deg`] says
//!   less; the paper has columns.
//! - There are two over-fills: the paper's, and one that stands on nothing but what a cutter can
//!   take away again (`cutting::clearable`). What needs other supports it leaves out, where the
//!   paper's leaves supports behind in cavities that no tool looks into.
//! - The goal test (Eq. 38) does not count skin: the rules of a plan do not either. What of it can
//!   be reached is cut and filled after the goal, as long as that is worth a step or half of what is
//!   off.
//! - The cost of a plan charges what it leaves within δ, and skin, as if it were moved, which makes
//!   w = 0 exact.
//!
//! Guarantees: each step is valid by the maps of [`crate::access`]; with w = 0 the plan found is a
//! cheapest one of these actions within the steps allowed. The same job gives the same plan, time
//! limits aside. Not guaranteed: that a goal is found where one exists; the notes say why a search
//! ended.

mod carry;
mod cost;
mod cutting;
mod filling;
mod packed;
mod sacrifice;
mod shaped;
mod site;
#[cfg(test)]
mod tests;
mod trace;
mod undercut;
mod world;

pub use shaped::{over_cut_by, under_cut_by};

use crate::base::{Cancelled, Ctx};
use crate::machine::{BaseKind, Holding};
use crate::plan::{self, Job, Origin, Plan, Step, StepKind};
use crate::planner::PlanError;
use crate::search::{Ending, IdaOptions, Status, World, ida};
use world::{Action, Shop};

/// Relative rotations between two steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rotations {
    /// By a quarter at most (HB Sec. 5).
    Seven,
    /// Any.
    All,
}

impl Rotations {
    /// How many they are.
    pub fn count(self) -> usize {
        match self {
            Rotations::Seven => 7,
            Rotations::All => 24,
        }
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// λ: what removing a volume costs, adding it being 1.
    pub lambda: f64,
    /// w.
    pub weight: f64,
    /// δ: deviation by which a goal may miss the target, a fraction of its volume.
    pub delta: f64,
    pub most_steps: usize,
    pub rotations: Rotations,
    /// Overhang that carries itself, degrees; below 45 only columns do.
    pub overhang_deg: f64,
    /// Actions that move less than this share of the target are none.
    pub least_share: f64,
    /// Costs of single tools by name, where they differ: adding with the usual nozzle is 1.
    pub tool_costs: Vec<(String, f64)>,
    /// Whether the bound counts what must be sacrificed (`sacrifice`), beyond Eq. 39.
    pub tight_bound: bool,
    /// States expanded in vain, one after the other, before the search ends; none without limit.
    pub patience: Option<usize>,
    /// Bytes that states may take.
    pub most_bytes: usize,
}

impl Default for Options {
    fn default() -> Self {
        Options {
            lambda: 0.1,
            weight: 1.0,
            delta: crate::base::tolerance::DEVIATION,
            most_steps: 10,
            rotations: Rotations::Seven,
            overhang_deg: crate::base::tolerance::OVERHANG_DEG,
            least_share: LEAST_SHARE * crate::base::tolerance::DEVIATION,
            tool_costs: Vec::new(),
            tight_bound: false,
            patience: Some(PATIENCE),
            most_bytes: 1 << 30,
        }
    }
}

/// Share of δ that an action moves at least: smaller ones make many plans and none better.
pub const LEAST_SHARE: f64 = 0.1;

/// Expansions without a state nearer to the target: a plan that gets there mostly does within a
/// dozen.
const PATIENCE: usize = 40;

/// Expansions without coming nearer before the search tries another first step: a first step that
/// leads into a dead end would otherwise be turned over for long.
const BRANCH_PATIENCE: usize = 6;

/// What a run tells beside its plan.
#[derive(Clone, Debug, PartialEq)]
pub struct Report {
    /// g + h of the plan, and what any plan costs at least: h of Eq. 39 at the start, or the tighter
    /// bound; mm³, adding being 1.
    pub cost: f64,
    pub bound: f64,
    pub expanded: usize,
    pub rounds: usize,
    /// What the plan leaves beyond skin, mm³.
    pub left_mm3: f64,
    /// Whether a goal was found.
    pub goal: bool,
    /// The tree of the run, one line a state.
    pub trace: String,
    pub notes: Vec<String>,
}

/// Plans the job. Where no plan within δ is found it is the one that ends nearest to the target.
///
/// # Errors
/// An empty target, no tool at all, or the user's wish to stop.
pub fn plan(job: &Job, options: &Options, ctx: &Ctx) -> Result<(Plan, Report), PlanError> {
    if job.target.is_empty() {
        return Err(PlanError::EmptyPart { which: "target", pitch_mm: job.frame.pitch });
    }
    if job.cutters.is_empty() && job.nozzles.is_empty() {
        return Err(PlanError::NoTool { kind: "subtractive or additive" });
    }
    let shop = Shop::new(job, options, ctx);
    let start = shop.start();
    let limits = IdaOptions {
        weight: options.weight,
        most_steps: options.most_steps,
        most_expanded: usize::MAX,
        // A cheapest plan asks for all of every branch.
        branch_patience: (options.weight > 0.0).then_some(BRANCH_PATIENCE),
    };
    ctx.begin("searching", 0);
    let mut why = None;
    let mut nearest = (f64::INFINITY, 0);
    let mut go_on = |s: &Status| {
        tracing::debug!(
            round = s.round,
            limit = s.limit,
            depth = s.depth,
            states = s.states,
            expanded = s.expanded,
            off = s.shortfall,
            "search"
        );
        ctx.advance(1);
        if s.shortfall < nearest.0 {
            nearest = (s.shortfall, s.expanded);
        }
        if ctx.out_of_time() {
            why = Some("the time limit was reached".to_string());
        } else if options.patience.is_some_and(|p| s.expanded > nearest.1 + p) {
            let vain = s.expanded - nearest.1;
            why = Some(format!("{vain} states led no nearer; --time-limit lets it go on"));
        } else if shop.bytes() > options.most_bytes {
            why = Some("the states take too much memory".to_string());
        }
        why.is_none()
    };
    let found = ida(&shop, start, &limits, &mut go_on)?;
    ctx.end();
    let trace = trace::text(job, &found);
    let voxel = job.frame.voxel_volume();
    let mut notes = Vec::new();
    match (found.ending, why) {
        (Ending::Goal, _) => {}
        (_, Some(why)) => notes.push(format!("The best plan so far: {why}.")),
        (_, None) => notes.push(format!(
            "No plan of {} steps or fewer comes nearer to the target.",
            options.most_steps
        )),
    }
    let mut bound = found.bound;
    if options.tight_bound {
        let voxels = sacrifice::least_sacrifice(&shop, &job.initial, shop.costs.slack());
        bound += shop.costs.sacrificed(voxels);
    }
    let mut path = found.path;
    let (mut cost, mut left) = (found.cost, found.shortfall);
    if found.ending == Ending::Goal {
        let (longer, paid, end) = shop.carried_on(path, options.most_steps)?;
        (cost, left) = (paid + shop.remaining(&end), shop.shortfall(&end));
        path = longer;
    }
    let plan = steps(&shop, &path)?;
    let report = Report {
        cost: cost * voxel,
        bound: bound * voxel,
        expanded: found.expanded,
        rounds: found.rounds,
        left_mm3: left * voxel,
        goal: found.ending == Ending::Goal,
        trace,
        notes,
    };
    Ok((plan, report))
}

/// What of the target, mm³, no over-fill of the start lays on supports that can be cleared again:
/// a hint at how near a plan gets from there, for the price of one step.
///
/// # Errors
/// The user's wish to stop.
pub fn glance(job: &Job, options: &Options, ctx: &Ctx) -> Result<f64, PlanError> {
    let shop = Shop::new(job, options, ctx);
    let missing = job.target.minus(&job.initial);
    let mut least = missing.count();
    for axis in shop.views().iter().map(|v| v.index) {
        for tool in 0..job.nozzles.len() {
            ctx.check()?;
            let fill = Action { action: plan::Action::OF, tool, axis, clearable: true };
            let laid = shop.apply(&job.initial, fill)?;
            least = least.min(laid.map_or(least, |l| missing.minus(&l).count()));
        }
    }
    Ok(least as f64 * job.frame.voxel_volume())
}

/// The actions of a path as steps, made again one after the other.
fn steps(shop: &Shop, path: &[Action]) -> Result<Plan, Cancelled> {
    let job = shop.job;
    let mut plan = Plan { holdings: vec![Holding::AS_CLAMPED], steps: Vec::new() };
    let mut state = job.initial.clone();
    let mut blocks = [0; 2];
    let mut before: Option<(usize, usize)> = None;
    for action in path {
        let (Some(view), Some(region)) = (shop.view(action.axis), shop.apply(&state, *action)?)
        else {
            break;
        };
        let kind = action.kind();
        let held = view.holding(job, &state);
        // Standing on a table the part is held by what it has when it is put there.
        let again =
            before.filter(|(axis, _)| *axis == action.axis && job.rules.base == BaseKind::None);
        let holding = if held == Holding::AS_CLAMPED {
            0
        } else if let Some((_, holding)) = again {
            holding
        } else {
            plan.holdings.push(held);
            plan.holdings.len() - 1
        };
        before = Some((action.axis, holding));
        let (tools, block) = match kind {
            StepKind::Subtractive => {
                state.subtract(&region);
                (&job.cutters, &mut blocks[0])
            }
            StepKind::Additive => {
                state.union_with(&region);
                (&job.nozzles, &mut blocks[1])
            }
        };
        let Some(tool) = tools.get(action.tool) else { break };
        tracing::debug!(
            action = ?action.action,
            tool = tool.name,
            direction = ?view.direction,
            voxels = region.count(),
            "step"
        );
        plan.steps.push(Step {
            kind,
            tool: tool.name.clone(),
            direction: view.direction,
            holding,
            region,
            block: *block,
            origin: Origin { plane: None, action: Some(action.action) },
        });
        *block += 1;
    }
    Ok(plan)
}
