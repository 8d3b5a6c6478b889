//! The search space (HB Sec. 5): states, actions, and what follows from what.

use super::Options;
use super::carry::Carry;
use super::cost::Costs;
use super::cutting::{clearable, over_cut};
use super::filling::{open, over_fill, stacked, under_fill};
use super::packed::Packed;
use super::site::{AXES, Site, View, held};
use super::undercut::{least_collateral, under_cut};
use crate::base::{Cancelled, Ctx};
use crate::machine::Tool;
use crate::plan::{self, Job, StepKind};
use crate::planner::reman::bridges::bridges;
use crate::search::{Made, Successor, World};
use crate::voxel::{BitGrid, distance_within};
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};

/// A cut that frees pieces is made again with bridges to them so often.
const BRIDGE_ROUNDS: usize = 4;

/// What is left of P₀ ∩ P, and the skin around it, where a goal may be off.
#[derive(Debug)]
pub struct Reused {
    solid: BitGrid,
    skin: BitGrid,
    key: u128,
}

impl Reused {
    fn new(solid: BitGrid, job: &Job) -> Reused {
        let skin = distance_within(&solid, job.rules.tolerance_mm / job.frame.pitch);
        // Not the workpiece's own key, which may be the same set.
        let key = Packed::of(&solid).key().wrapping_mul(KEY_FACTOR);
        Reused { solid, skin, key }
    }

    fn bytes(&self) -> usize {
        (self.solid.words().len() + self.skin.words().len()) * size_of::<u64>()
    }
}

/// An odd number without structure.
const KEY_FACTOR: u128 = 0x9E37_79B9_7F4A_7C15_F39C_C060_5CED_C835;

/// A workpiece and how the last step held it.
#[derive(Clone, Debug)]
pub struct State {
    solid: Packed,
    reused: Arc<Reused>,
    /// P_n − P and P − P_n, voxels; and how many of both are no skin.
    pub excess: usize,
    pub deficit: usize,
    off: usize,
    /// The last direction, by its place in [`AXES`]; the first where it does not matter.
    up: usize,
}

/// An action φ: what, with the job's n-th tool of its kind, along which of [`AXES`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Action {
    pub action: plan::Action,
    pub tool: usize,
    pub axis: usize,
    /// Of an over-fill: whether no support is laid but what a cutter can take away again.
    pub clearable: bool,
}

impl Action {
    pub fn kind(&self) -> StepKind {
        match self.action {
            plan::Action::OC | plan::Action::UC => StepKind::Subtractive,
            plan::Action::UF | plan::Action::OF => StepKind::Additive,
        }
    }
}

/// A workpiece after an action.
fn changed(solid: &BitGrid, action: Action, region: &BitGrid) -> BitGrid {
    match action.kind() {
        StepKind::Subtractive => solid.minus(region),
        StepKind::Additive => solid.or(region),
    }
}

/// Everything the search asks about.
pub struct Shop<'a> {
    pub job: &'a Job,
    pub costs: Costs,
    views: Vec<View>,
    carry: Carry,
    /// What of P's surroundings a cutter clears along some direction while all of P stands.
    clearable: OnceLock<BitGrid>,
    /// Seven relative rotations a step: the direction opposite to the last is none of them.
    relative: bool,
    /// Actions that move fewer voxels are none.
    least: usize,
    bytes: AtomicUsize,
    ctx: &'a Ctx,
}

impl<'a> Shop<'a> {
    pub fn new(job: &'a Job, options: &Options, ctx: &'a Ctx) -> Shop<'a> {
        let least = (options.least_share * job.target.count() as f64).ceil() as usize;
        Shop {
            job,
            costs: Costs::new(job, options),
            views: View::all(job),
            carry: Carry::within(options.overhang_deg.min(job.rules.overhang_deg)),
            clearable: OnceLock::new(),
            relative: options.rotations == super::Rotations::Seven,
            least: least.max(1),
            bytes: AtomicUsize::new(0),
            ctx,
        }
    }

    /// The state to begin with.
    pub fn start(&self) -> State {
        let reused = Reused::new(self.job.ideal_reuse(), self.job);
        self.bytes.fetch_add(reused.bytes(), Ordering::Relaxed);
        self.state(&self.job.initial, Arc::new(reused), 0)
    }

    /// What a step along the axis `up` makes of a state.
    fn after(&self, before: &State, solid: &BitGrid, up: usize) -> State {
        let mut reused = Arc::clone(&before.reused);
        if !reused.solid.is_subset_of(solid) {
            reused = Arc::new(Reused::new(reused.solid.and(solid), self.job));
            self.bytes.fetch_add(reused.bytes(), Ordering::Relaxed);
        }
        self.state(solid, reused, up)
    }

    fn state(&self, solid: &BitGrid, reused: Arc<Reused>, up: usize) -> State {
        let target = &self.job.target;
        let (excess, deficit) = (solid.minus(target), target.minus(solid));
        let packed = Packed::of(solid);
        self.bytes.fetch_add(packed.bytes(), Ordering::Relaxed);
        State {
            solid: packed,
            excess: excess.count(),
            deficit: deficit.count(),
            off: excess.minus(&reused.skin).count() + deficit.minus(&reused.skin).count(),
            reused,
            up: if self.relative { up } else { 0 },
        }
    }

    /// Follows `path` and goes on by over-cuts and under-fills with the cheapest tools, the one
    /// that moves most first, as long as one moves enough for a step or half of what is off: skin
    /// that no goal asks for, but which is there to be reached, and the little that keeps a plan
    /// from being complete. None of them costs more than h charges for what it moves.
    /// The path, what it costs and the state it ends in.
    pub fn carried_on(
        &self,
        mut path: Vec<Action>,
        most_steps: usize,
    ) -> Result<(Vec<Action>, f64, State), Cancelled> {
        let (mut state, mut paid) = (self.start(), 0.0);
        for action in &path {
            let solid = state.solid.grid();
            let Some(region) = self.apply(&solid, *action)? else { break };
            paid += self.costs.moved(action.kind(), action.tool, region.count());
            state = self.after(&state, &changed(&solid, *action, &region), action.axis);
        }
        while path.len() < most_steps && state.excess + state.deficit > 0 {
            let least = self.least.min((state.excess + state.deficit).div_ceil(2));
            let solid = state.solid.grid();
            let made: Vec<(Action, BitGrid)> = self
                .direct(&state)
                .into_par_iter()
                .map(|action| {
                    self.ctx.check()?;
                    Ok(self.apply(&solid, action)?.map(|region| (action, region)))
                })
                .filter_map(Result::transpose)
                .collect::<Result<_, Cancelled>>()?;
            let most = made.into_iter().rev().max_by_key(|(_, region)| region.count());
            let Some((action, region)) = most.filter(|(_, r)| r.count() >= least) else { break };
            path.push(action);
            paid += self.costs.moved(action.kind(), action.tool, region.count());
            state = self.after(&state, &changed(&solid, action, &region), action.axis);
        }
        Ok((path, paid, state))
    }

    /// Over-cuts and under-fills with the cheapest tools, along every direction that may follow.
    fn direct(&self, state: &State) -> Vec<Action> {
        let cheapest = |action, kind, tools: usize| {
            let tools = (0..tools).filter(move |n| self.costs.is_cheapest(kind, *n));
            tools.map(move |tool| (action, tool))
        };
        let cuts = cheapest(plan::Action::OC, StepKind::Subtractive, self.job.cutters.len())
            .filter(|_| state.excess > 0);
        let fills = cheapest(plan::Action::UF, StepKind::Additive, self.job.nozzles.len())
            .filter(|_| state.deficit > 0);
        let ways: Vec<(plan::Action, usize)> = cuts.chain(fills).collect();
        let along = |view: &View| {
            let axis = view.index;
            let ways = ways.iter().map(move |(action, tool)| (*action, *tool));
            ways.map(move |(action, tool)| Action { action, tool, axis, clearable: false })
        };
        self.views_after(state).into_iter().flat_map(along).collect()
    }

    /// The directions that may follow.
    fn views_after(&self, state: &State) -> Vec<&View> {
        let opposite = AXES[state.up].opposite();
        self.views.iter().filter(|v| !self.relative || v.direction != opposite).collect()
    }

    /// Bytes that states made so far take.
    pub fn bytes(&self) -> usize {
        self.bytes.load(Ordering::Relaxed)
    }

    pub fn views(&self) -> &[View] {
        &self.views
    }

    pub fn view(&self, axis: usize) -> Option<&View> {
        self.views.iter().find(|v| v.index == axis)
    }

    /// What an action changes in a workpiece; none when it can do nothing.
    ///
    /// # Errors
    /// [`Cancelled`] when the user has asked to stop.
    pub fn apply(&self, solid: &BitGrid, action: Action) -> Result<Option<BitGrid>, Cancelled> {
        let Some(view) = self.view(action.axis) else { return Ok(None) };
        let site = view.site(self.job, solid);
        let region = match action.action {
            plan::Action::OC => {
                let Some(tool) = self.job.cutters.get(action.tool) else { return Ok(None) };
                let excess = site.state.minus(&view.target);
                self.held_cut(solid, &site, excess, tool)
            }
            plan::Action::UC => {
                let Some(tool) = self.job.cutters.get(action.tool) else { return Ok(None) };
                match under_cut(self.job, &site, tool, self.ctx)? {
                    Some(left) => solid.minus(&view.down(&left)),
                    None => return Ok(None),
                }
            }
            plan::Action::UF | plan::Action::OF => {
                let Some(tool) = self.job.nozzles.get(action.tool) else { return Ok(None) };
                let mut open = open(&site, tool, self.job.rules.nozzle_dip_mm);
                if action.clearable {
                    open = self.clear_again(&site, &open);
                }
                self.filled(solid, &site, &open, action.action)
            }
        };
        Ok((!region.is_empty()).then_some(region))
    }

    /// The over-cut of `removable` that lets nothing come loose, in the job's coordinates.
    fn held_cut(&self, solid: &BitGrid, site: &Site, removable: BitGrid, tool: &Tool) -> BitGrid {
        let mut removable = removable;
        for _ in 0..BRIDGE_ROUNDS {
            let region = site.view.down(&over_cut(site, &removable, tool).region);
            if region.is_empty() {
                return region;
            }
            match self.loosened(solid, &region) {
                None => return region,
                Some(ways) if ways.is_empty() => break,
                Some(ways) => removable.subtract(&site.view.up(&ways)),
            }
        }
        BitGrid::new(solid.dims())
    }

    /// Bridges to what a cut would free; none when it frees nothing.
    fn loosened(&self, solid: &BitGrid, region: &BitGrid) -> Option<BitGrid> {
        let standing = solid.minus(region);
        let steady = held(self.job, &standing);
        let loose = standing.minus(&steady);
        (!loose.is_empty()).then(|| bridges(&steady, &loose, region))
    }

    /// A fill in the job's coordinates, less what would stand apart and what that carried.
    fn filled(
        &self,
        solid: &BitGrid,
        site: &Site,
        open: &BitGrid,
        action: plan::Action,
    ) -> BitGrid {
        let mut region = match action {
            plan::Action::OF => over_fill(site, open, &self.carry),
            _ => under_fill(site, open, &self.carry),
        };
        loop {
            let laid = site.view.down(&region);
            let steady = held(self.job, &solid.or(&laid)).and(&laid);
            if steady == laid {
                return laid;
            }
            region = stacked(site, &site.view.up(&steady), &self.carry);
        }
    }

    /// What of `open` is P or can be cleared again.
    fn clear_again(&self, site: &Site, open: &BitGrid) -> BitGrid {
        let clearable = self.clearable.get_or_init(|| clearable(self.job, &self.views));
        open.and(&site.view.target.or(&site.view.up(clearable)))
    }

    /// Everything that can be done along one direction.
    fn along(&self, view: &View, solid: &BitGrid, of: &State) -> Vec<Successor<State, Action>> {
        let mut out = Vec::new();
        let site = view.site(self.job, solid);
        let doing = |action, tool| Action { action, tool, axis: view.index, clearable: false };
        // A part of the target is added to; one that holds it is cut.
        if of.excess > 0 {
            let excess = site.state.minus(&view.target);
            for (n, tool) in self.job.cutters.iter().enumerate() {
                let cut = over_cut(&site, &excess, tool);
                let mut region = view.down(&cut.region);
                if !region.is_empty() && self.loosened(solid, &region).is_some() {
                    region = self.held_cut(solid, &site, excess.clone(), tool);
                }
                out.extend(self.made(doing(plan::Action::OC, n), (of, solid), &region));
                if region.count() < of.excess {
                    out.extend(self.promised(doing(plan::Action::UC, n), &site, of, &cut.hidden));
                }
            }
        }
        if of.deficit > 0 {
            for (n, tool) in self.job.nozzles.iter().enumerate() {
                let open = open(&site, tool, self.job.rules.nozzle_dip_mm);
                let under = self.filled(solid, &site, &open, plan::Action::UF);
                let over = self.filled(solid, &site, &open, plan::Action::OF);
                out.extend(self.made(doing(plan::Action::UF, n), (of, solid), &under));
                if over == under {
                    continue;
                }
                out.extend(self.made(doing(plan::Action::OF, n), (of, solid), &over));
                if self.job.cutters.is_empty() {
                    continue;
                }
                let open = self.clear_again(&site, &open);
                let clear = self.filled(solid, &site, &open, plan::Action::OF);
                if clear != over && clear != under {
                    let action = Action { clearable: true, ..doing(plan::Action::OF, n) };
                    out.extend(self.made(action, (of, solid), &clear));
                }
            }
        }
        out
    }

    fn made(
        &self,
        action: Action,
        (of, solid): (&State, &BitGrid),
        region: &BitGrid,
    ) -> Option<Successor<State, Action>> {
        let voxels = region.count();
        if voxels < self.least {
            return None;
        }
        let after = changed(solid, action, region);
        let cost = self.costs.moved(action.kind(), action.tool, voxels);
        Some(Successor::Made(Made { action, cost, state: self.after(of, &after, action.axis) }))
    }

    /// An under-cut is dear, and mostly bad: it is made only when what it takes at least does not
    /// rule it out.
    fn promised(
        &self,
        action: Action,
        site: &Site,
        of: &State,
        hidden: &BitGrid,
    ) -> Option<Successor<State, Action>> {
        let tool = self.job.cutters.get(action.tool)?;
        let least = if hidden.is_empty() { 0 } else { least_collateral(site, hidden, tool) };
        Some(Successor::Promised {
            action,
            cost_at_least: self.costs.moved(action.kind(), action.tool, of.excess + least),
            remaining_at_least: self.costs.remaining(0, of.deficit + least),
        })
    }
}

impl World for Shop<'_> {
    type State = State;
    type Action = Action;
    type Error = Cancelled;

    fn key(&self, state: &State) -> u128 {
        state.solid.key() ^ state.reused.key ^ (state.up as u128)
    }

    fn remaining(&self, state: &State) -> f64 {
        self.costs.remaining(state.excess, state.deficit)
    }

    fn is_goal(&self, state: &State) -> bool {
        self.costs.is_goal(state.off)
    }

    fn shortfall(&self, state: &State) -> f64 {
        state.off as f64
    }

    fn successors(&self, state: &State) -> Result<Vec<Successor<State, Action>>, Cancelled> {
        self.ctx.check()?;
        let solid = state.solid.grid();
        let ways: Vec<Vec<Successor<State, Action>>> = self
            .views_after(state)
            .into_par_iter()
            .map(|view| {
                self.ctx.check()?;
                Ok(self.along(view, &solid, state))
            })
            .collect::<Result<_, Cancelled>>()?;
        Ok(ways.into_iter().flatten().collect())
    }

    fn make(&self, state: &State, action: &Action) -> Result<Option<(f64, State)>, Cancelled> {
        self.ctx.check()?;
        let solid = state.solid.grid();
        let Some(region) = self.apply(&solid, *action)?.filter(|r| r.count() >= self.least) else {
            return Ok(None);
        };
        let cost = self.costs.moved(action.kind(), action.tool, region.count());
        Ok(Some((cost, self.after(state, &solid.minus(&region), action.axis))))
    }
}
