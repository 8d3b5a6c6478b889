//! Pits: what no nozzle gets at beside that which stands is opened up and printed with it.
//!
//! Method. What a finished plan misses falls into patches of a few millimetres. For a patch P and a grid
//! axis d along which something carries it, the pit is all that stands over the patch within a cone of
//! half angle α:
//!
//! ```text
//! pit(P, d, α) = { q : (q − p)·d tan α > |(q − p) × d| − r for some p in P },  r: room for the tip
//! ```
//!
//! To a patch P that only what else is missing would carry, be it within the skin, belongs that which carries it
//! (see `patches`).
//! Patches that ask for little along the same axis get their pits together, by one cut; then what is
//! missing there is printed, along the same axis first, where the nozzle stands in the open. Pits that
//! cost little come before large ones, narrow before wide. Where not all of them help, those that do are
//! made once more alone. In the end all is made again with those of one axis together, which takes fewer
//! blocks.
//!
//! Where pits are to outdo a complete plan, they may give up all that it does, and what nothing carries straight up is
//! opened from above and printed on supports, which are cut away before what is still missing is printed (`aside`).
//!
//! This is a local plane (W2V Sec. 4.2) bent into a cone: a plane through a patch in a crease gives up
//! a slice of the part, a pit a few beads, and mostly of what was printed.
//!
//! Along other directions what tools reach is told with a margin of half a voxel, which leaves crumbs on
//! a pit's walls: of forty tried on a real part one helped.
//!
//! Guarantees: those of cuts and deposits; a plan with pits ranks higher and leaves less than the one
//! without, and where that one is within the rules it gives up at most a fifth of the target for it. What stood
//! within the tolerance of material given up is cut with it or counts as left. Not guaranteed: that the pits are
//! the smallest, or their order the best.

use super::aside::on_supports_and_cut;
use super::coarse::Coarse;
use super::cone::{Brick, Cone};
use super::cutting::{Cutting, cut_along};
use super::laying::{Way, ways_along};
use super::patches::{Carrying, Patch, carried_later, patches};
use super::printing::{Patience, Wanted, leaves_none, print_blocks, print_crumbs};
use super::round::Attempt;
use super::setting::Setting;
use super::{Options, Run, Start, followed};
use crate::base::{Cancelled, Ctx, DVec2, DVec3, Direction};
use crate::plan::Job;
use crate::planner::PlanError;
use crate::region::Volumes;
use crate::voxel::{BitGrid, Connectivity, Frame, components, flood};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Tangents of the cones' half angles, 27° to 80°: the slimmest nozzle widens by 20°, but a deposit on a
/// pit's wall mostly wants room beside its tip as well. Without the slimmest a bracket gave up three times as much.
const OPENINGS: [f64; 4] = [0.5, 1.0, 2.1, 5.7];

/// What a pit may give up for a voxel that is missing: small pits of every opening come before large
/// ones.
const PRICES: [f64; 5] = [10.0, 100.0, 1e3, 1e4, f64::INFINITY];

/// A patch's pit may be so many times as large as its least one to be made with others.
const NEARLY_LEAST: f64 = 1.5;

/// Material printed anew counts so much of what is given up.
const PRINTED_WEIGHT: f64 = 0.1;

/// A plan that leaves more than so many times what the rules allow gets no pits: on real pairs they open half of
/// what is missing or a little more, which would not make it valid.
const WITHIN: f64 = 2.5;

/// Tries in vain, one after the other, before what pits may give up is raised, and as many again at each height:
/// small pits that bring nothing say little of large ones.
const PATIENCE: usize = 8;
const PATIENCE_RAISED: usize = 4;

/// Tries at most: each costs a cut and a block or two.
const MOST_TRIES: usize = 60;

/// Share of the target that pits may give up to leave nothing at all. Further planes may cost less: one of them
/// gives up a slice of the part at once, pits a little each, and none that does not leave less.
const PITS_SHARE: f64 = 0.2;

/// Share of the target that a plan with fewer pits may give up more.
const MORE_SHARE: f64 = 2e-3;

/// Patches nearer each other than this are one that was tried before, mm.
const SAME_PLACE_MM: f64 = 1.0;

/// A pit that was made, over what was missing.
#[derive(Clone)]
struct Pit {
    way: usize,
    opening: usize,
    over: Vec<[usize; 3]>,
}

/// The plan with pits for what it misses, where they leave less.
///
/// `rival` is what a complete plan keeps, where one is known: then pits may give up all that it does.
pub fn with_pits(
    run: &mut Run,
    plain: Attempt,
    rival: Option<usize>,
) -> Result<Attempt, PlanError> {
    let job = run.start.setting.job;
    if plain.deficit.is_empty() || !leaves_little_enough(&plain, job) {
        return Ok(plain);
    }
    let setting = run.start.setting.with_last_resort();
    let start = run.start.in_setting(&setting);
    let kept = plain.volumes.reused.count();
    let terms = Terms { rival, options: run.options };
    let (mut best, pits) = dug(&start, plain.clone(), &[], terms, run.ctx)?;
    if pits.len() > along_each(&pits).len() {
        let (again, _) = dug(&start, plain, &pits, terms, run.ctx)?;
        let more = (MORE_SHARE * job.target.count() as f64) as usize;
        let keeps = again.volumes.reused.count() + more >= best.volumes.reused.count();
        let is_no_worse = again.rank(job) <= best.rank(job) || again.left() <= best.left() && keeps;
        if is_no_worse && again.steps.len() < best.steps.len() {
            best = again;
        }
    }
    run.clock.lap("blocks");
    let given_up = kept.saturating_sub(best.volumes.reused.count());
    if given_up > 0 {
        run.report.notes.push(format!(
            "{:.1} mm³ of the initial part are given up in pits, so that nozzles get at what was \
             missing.",
            given_up as f64 * job.frame.voxel_volume()
        ));
    }
    Ok(best)
}

/// Whether a plan leaves so little that pits may mend it, if no stock stands.
pub fn leaves_little_enough(plain: &Attempt, job: &Job) -> bool {
    plain.left() as f64 <= WITHIN * job.rules.deviation * job.target.count() as f64
}

/// The best of a plan and those with more and more pits, and the pits of the best. First come those that an
/// earlier try for the same made, all along one way together.
fn dug(
    start: &Start,
    plain: Attempt,
    before: &[Pit],
    terms: Terms,
    ctx: &Ctx,
) -> Result<(Attempt, Vec<Pit>), PlanError> {
    let job = start.setting.job;
    let mut digging = Digging::new(start, plain.clone(), terms);
    let (mut best, mut pits) = ((plain, Vec::new()), Vec::new());
    let mut before = along_each(before).into_iter();
    while !digging.now.deficit.is_empty() && !ctx.out_of_time() {
        let next = match before.next() {
            Some(together) => digging.again(together, ctx)?,
            None => match digging.next(ctx)? {
                None => break,
                some => some,
            },
        };
        let Some((made, of_it)) = next else { continue };
        pits.extend(of_it);
        // A complete plan is outdone by what is complete alone.
        let is_on_the_way = terms.rival.is_some() || made.rank(job) < best.0.rank(job);
        if is_on_the_way && made.left() < best.0.left() {
            best = (made.clone(), pits.clone());
        }
        digging.go_on(made);
    }
    Ok(best)
}

/// Pits way by way, in the order in which the ways come first.
fn along_each(pits: &[Pit]) -> Vec<Vec<Pit>> {
    let mut each: Vec<Vec<Pit>> = Vec::new();
    for pit in pits {
        match each.iter_mut().find(|e| e[0].way == pit.way) {
            Some(of_way) => of_way.push(pit.clone()),
            None => each.push(vec![pit.clone()]),
        }
    }
    each
}

/// What pits are made for, and how.
#[derive(Clone, Copy)]
struct Terms<'o> {
    /// What a complete plan keeps, in voxels, where one is known.
    rival: Option<usize>,
    options: &'o Options,
}

/// A plan, and what was tried to have it miss less.
struct Digging<'s, 'a> {
    start: &'s Start<'a>,
    ways: Vec<Way<'a>>,
    carrying: Vec<Carrying>,
    now: Attempt,
    state: BitGrid,
    patches: Vec<Patch>,
    /// Of [`OPENINGS`] and [`PRICES`].
    opening: usize,
    price: usize,
    /// By patch and way what has to be printed for it; empty before it is asked for.
    bodies: Vec<Vec<Option<Patch>>>,
    /// By opening, patch and way; empty before they are asked for.
    costs: [Vec<Vec<f64>>; OPENINGS.len()],
    /// Opening, way and place of what was tried.
    tried: Vec<(usize, usize, DVec3)>,
    /// Tries in all, and in vain since the last that left less.
    tries: usize,
    vain: usize,
    /// The least that may be kept of the initial part, in voxels.
    least_kept: usize,
    terms: Terms<'s>,
    /// The way straight up on supports, which are cut away again.
    supported: Option<usize>,
}

impl<'s, 'a> Digging<'s, 'a> {
    fn new(start: &'s Start<'a>, plain: Attempt, terms: Terms<'s>) -> Self {
        let setting: &Setting<'a> = start.setting;
        let holdings = 0..setting.holdings.len();
        let mut directions: Vec<Direction> = Vec::new();
        for d in holdings.flat_map(|h| setting.axes(h)) {
            if !directions.contains(&d) {
                directions.push(d);
            }
        }
        let mut ways: Vec<Way<'a>> = match setting.nozzles().last() {
            Some(nozzle) => ways_along(setting, &directions, nozzle),
            None => Vec::new(),
        };
        let up = ways.iter().find(|w| w.direction == Direction::Z).copied();
        // In place of other pits they left more on a thread: they are for outdoing a complete plan.
        let takes = terms.options.supports && terms.rival.is_some();
        let supported = up.filter(|_| takes).map(|up| {
            ways.push(up);
            ways.len() - 1
        });
        let share = (PITS_SHARE * setting.job.target.count() as f64) as usize;
        let worth = plain.worth(setting.job).map_or(usize::MAX, |w| w.max(share));
        let carrying = ways.iter().map(|w| Carrying::of(w, setting.job)).collect();
        let state = BitGrid::new(setting.job.frame.dims);
        let (patches, tried) = (Vec::new(), Vec::new());
        let mut digging = Digging {
            start,
            ways,
            carrying,
            now: plain.clone(),
            state,
            patches,
            opening: 0,
            price: 0,
            bodies: Vec::new(),
            costs: Default::default(),
            tried,
            tries: 0,
            vain: 0,
            least_kept: terms
                .rival
                .unwrap_or_else(|| plain.volumes.reused.count().saturating_sub(worth)),
            terms,
            supported,
        };
        digging.go_on(plain);
        digging
    }

    /// Goes on from a plan, narrow pits first.
    fn go_on(&mut self, now: Attempt) {
        let job = self.start.setting.job;
        self.state = now.end(job);
        self.patches = patches(&job.frame, &now.deficit);
        self.now = now;
        (self.opening, self.price) = (0, 0);
        self.bodies.clear();
        self.costs = Default::default();
    }

    /// The plan with the next pits that leave less; none when all were tried.
    fn next(&mut self, ctx: &Ctx) -> Result<Option<(Attempt, Vec<Pit>)>, PlanError> {
        while self.price < PRICES.len() && !self.is_enough(ctx) {
            if self.bodies.is_empty() {
                self.bodies = self.all_bodies(ctx)?;
            }
            if self.costs[self.opening].is_empty() {
                self.costs[self.opening] = self.costs_of(OPENINGS[self.opening], ctx)?;
            }
            let is_patient = self.vain < PATIENCE;
            let Some((way, chosen)) = self.choose().filter(|_| is_patient) else {
                self.opening += 1;
                if self.opening == OPENINGS.len() || !is_patient {
                    // Large pits are for leaving nothing at all, or no more than the rules allow.
                    let is_for_all = self.terms.rival.is_none();
                    if is_for_all && self.now.is_valid(self.start.setting.job) && self.is_hopeless()
                    {
                        return Ok(None);
                    }
                    (self.opening, self.price) = (0, self.price + 1);
                    self.vain = self.vain.min(PATIENCE - PATIENCE_RAISED);
                }
                continue;
            };
            let places = chosen.iter().map(|p| (self.opening, way, self.patches[*p].middle));
            self.tried.extend(places.collect::<Vec<_>>());
            let mut chosen = chosen;
            // Those that leave less are made once more without the others.
            while !chosen.is_empty() && self.vain < PATIENCE && !self.is_enough(ctx) {
                (self.tries, self.vain) = (self.tries + 1, self.vain + 1);
                let (made, good) = self.with_pits_over(way, &chosen, ctx)?;
                match made {
                    Some(made) if good.len() == chosen.len() => {
                        self.vain = 0;
                        let pit = Pit { way, opening: self.opening, over: self.over(way, &chosen) };
                        return Ok(Some((made, vec![pit])));
                    }
                    _ => chosen = good,
                }
            }
        }
        Ok(None)
    }

    /// The plan with some pits along one way made together, if it leaves less.
    fn again(
        &mut self,
        together: Vec<Pit>,
        ctx: &Ctx,
    ) -> Result<Option<(Attempt, Vec<Pit>)>, PlanError> {
        let way = together[0].way;
        let mut pit = BitGrid::new(self.state.dims());
        for p in &together {
            pit.union_with(&self.pit(&p.over, self.ways[way].direction, OPENINGS[p.opening]));
        }
        let over: Vec<[usize; 3]> = together.iter().flat_map(|p| p.over.iter().copied()).collect();
        self.tries += 1;
        let made = self.made((&pit, &over), way, ctx)?;
        tracing::debug!(
            direction = ?self.ways[way].direction,
            pits = together.len(),
            before = self.now.deficit.count(),
            after = made.as_ref().map(|m| m.deficit.count()),
            reused = made.as_ref().map(|m| m.volumes.reused.count()),
            "pits together"
        );
        let made = made.filter(|m| self.is_less(m));
        Ok(made.map(|m| (m, together)))
    }

    /// Whether a plan leaves less than this one and keeps as much as it must.
    fn is_less(&self, made: &Attempt) -> bool {
        made.deficit.count() < self.now.deficit.count()
            && made.left() < self.now.left()
            && made.volumes.reused.count() >= self.least_kept
    }

    /// The voxels to print along a way for some patches.
    fn over(&self, way: usize, chosen: &[usize]) -> Vec<[usize; 3]> {
        let of = |p: &usize| self.bodies[*p][way].iter().flat_map(|b| b.voxels.iter().copied());
        let mut over: Vec<[usize; 3]> = chosen.iter().flat_map(of).collect();
        over.sort_unstable();
        over.dedup();
        over
    }

    /// Whether something hangs over nothing that stands, along every way. Together with what it hangs over it may be
    /// opened all the same, but seldom all of it: on a thread that took four times as long for a tenth of what was left.
    fn is_hopeless(&self) -> bool {
        let is_alone = |(p, bodies): (&Patch, &Vec<Option<Patch>>)| {
            let stands = |b: &Patch| b.voxels.len() == p.voxels.len();
            bodies.iter().flatten().any(stands)
        };
        !self.patches.iter().zip(&self.bodies).all(is_alone)
    }

    fn is_enough(&self, ctx: &Ctx) -> bool {
        self.tries >= MOST_TRIES || ctx.out_of_time()
    }

    /// Pits over some patches: the plan with them, if it leaves less, and the patches near which it does.
    fn with_pits_over(
        &self,
        way: usize,
        chosen: &[usize],
        ctx: &Ctx,
    ) -> Result<(Option<Attempt>, Vec<usize>), PlanError> {
        let over = self.over(way, chosen);
        let pit = self.pit(&over, self.ways[way].direction, OPENINGS[self.opening]);
        let Some(made) = self.made((&pit, &over), way, ctx)? else { return Ok((None, Vec::new())) };
        let mut around = pit.clone();
        over.iter().for_each(|v| around.set(*v, true));
        let around = components(&around.grown(), Connectivity::Corner26);
        let mut counts = vec![[0usize; 2]; around.count()];
        for (k, deficit) in [&self.now.deficit, &made.deficit].into_iter().enumerate() {
            for v in deficit.iter_ones() {
                if let Some(l) = around.label_of(v) {
                    counts[l as usize][k] += 1;
                }
            }
        }
        let is_good = |p: &usize| {
            let label = self.patches[*p].voxels.first().and_then(|v| around.label_of(*v));
            label.is_some_and(|l| counts[l as usize][1] < counts[l as usize][0])
        };
        let good: Vec<usize> = chosen.iter().copied().filter(is_good).collect();
        let (before, after) = (self.now.deficit.count(), made.deficit.count());
        tracing::debug!(
            direction = ?self.ways[way].direction,
            opening = OPENINGS[self.opening], price = PRICES[self.price],
            patches = chosen.len(),
            good = good.len(),
            pit = pit.count(),
            before,
            after,
            excess = made.excess.count(),
            reused = made.volumes.reused.count(),
            "pit"
        );
        let made = self.is_less(&made).then_some(made);
        // None of it can be told apart.
        let good = if good.len() == chosen.len() && made.is_none() { Vec::new() } else { good };
        Ok((made, good))
    }

    /// The way along which most is missing in patches whose pits are hardly larger than their least,
    /// and these.
    fn choose(&self) -> Option<(usize, Vec<usize>)> {
        let costs = &self.costs[self.opening];
        let is_new = |p: usize, way: usize| {
            let at = self.patches[p].middle;
            let is_there = |(opening, w, place): &(usize, usize, DVec3)| {
                (*opening, *w) == (self.opening, way) && place.distance(at) < SAME_PLACE_MM
            };
            !self.tried.iter().any(is_there)
        };
        // Of each patch the ways that are left to try, at no more than the price.
        let open: Vec<Vec<(usize, f64)>> = (0..costs.len())
            .map(|p| {
                let most = PRICES[self.price] * self.patches[p].voxels.len() as f64;
                let is_open = |way: usize| {
                    let cost = costs[p][way];
                    cost.is_finite() && cost <= most && is_new(p, way)
                };
                (0..self.ways.len()).filter(|w| is_open(*w)).map(|w| (w, costs[p][w])).collect()
            })
            .collect();
        let budget = (self.now.volumes.reused.count().saturating_sub(self.least_kept)) as f64;
        let along = |way: usize| -> Vec<usize> {
            let near = |p: usize| {
                let least = open[p].iter().map(|(_, c)| *c).fold(f64::INFINITY, f64::min);
                let of_way = open[p].iter().find(|(w, _)| *w == way);
                of_way.filter(|(_, c)| *c <= NEARLY_LEAST * least + 1.0).map(|(_, c)| (*c, p))
            };
            let mut near: Vec<(f64, usize)> = (0..costs.len()).filter_map(near).collect();
            near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            // As many as may be given up together.
            let together = near.iter().scan(0.0, |sum, (cost, p)| {
                *sum += cost;
                (*sum <= budget).then_some(*p)
            });
            together.collect()
        };
        let value = |chosen: &[usize]| -> usize {
            chosen.iter().map(|p| self.patches[*p].voxels.len()).sum()
        };
        let mut best: Option<(usize, Vec<usize>)> = None;
        for way in 0..self.ways.len() {
            let chosen = along(way);
            if value(&chosen) > best.as_ref().map_or(0, |(_, c)| value(c)) {
                best = Some((way, chosen));
            }
        }
        best
    }

    /// About how many voxels a patch's pit along every way would give up; infinite where nothing
    /// carries the patch.
    fn costs_of(&self, opening: f64, ctx: &Ctx) -> Result<Vec<Vec<f64>>, PlanError> {
        let coarse = self.start.coarse;
        let frame = &coarse.job.frame;
        let scale = (frame.pitch / self.start.setting.job.frame.pitch).powi(3);
        let old = coarse.most(&self.now.volumes.reused);
        let solid = coarse.most(&self.state);
        let bricks = Brick::all_of(&solid, &old, frame);
        let cost = |(way, body): (&Way, &Option<Patch>)| {
            let Some(body) = body else { return f64::INFINITY };
            let along = way.direction;
            let cone = Cone { from: body.middle, radius: body.radius, along, opening };
            let [old, printed] = cone.holds(&bricks).map(|n| n as f64);
            (old + PRINTED_WEIGHT * printed) * scale
        };
        let of_patch = |bodies: &Vec<Option<Patch>>| {
            ctx.check()?;
            Ok(self.ways.iter().zip(bodies).map(cost).collect())
        };
        self.bodies.par_iter().map(of_patch).collect()
    }

    /// By patch and way what has to be printed for it.
    fn all_bodies(&self, ctx: &Ctx) -> Result<Vec<Vec<Option<Patch>>>, PlanError> {
        let frame = &self.start.setting.job.frame;
        // What is missing within the skin carries as well.
        let missing = self.start.setting.job.target.minus(&self.state);
        let along = |carrying: &Carrying| carried_later(&self.state, &missing, frame, carrying);
        let later: Vec<BitGrid> = self.carrying.par_iter().map(along).collect();
        let of_patch = |stands: &mut BitGrid, p: &Patch| {
            ctx.check()?;
            let along = |(i, carrying): (usize, &Carrying)| {
                let body = p.body(carrying, stands, &later[i]);
                // Supports are for what nothing carries straight up: there they reuse more than pits so deep.
                let body = body.filter(|b| self.supported.is_none() || b.len() == p.voxels.len());
                match self.supported == Some(i) {
                    true if body.is_none() => Some(p.clone()),
                    true => None,
                    false => body.map(|voxels| Patch::of(voxels, frame)),
                }
            };
            Ok(self.carrying.iter().enumerate().map(along).collect())
        };
        self.patches.par_iter().map_init(|| self.state.clone(), of_patch).collect()
    }

    /// What stands over some voxels within their cones.
    fn pit(&self, over: &[[usize; 3]], d: Direction, opening: f64) -> BitGrid {
        let frame = &self.start.setting.job.frame;
        let tip = self.ways.first().map_or(0.0, |w| w.tool.tip_radius());
        pit_over((&self.state, frame), over, d, cone(tip + frame.pitch / 2.0, opening))
    }

    /// The plan with a pit cut along a way, and with what is then missing there printed; none where
    /// nothing is cut or laid.
    fn made(
        &self,
        (pit, patches): (&BitGrid, &[[usize; 3]]),
        way: usize,
        ctx: &Ctx,
    ) -> Result<Option<Attempt>, PlanError> {
        let (now, state) = (&self.now, &self.state);
        let (setting, coarse) = (self.start.setting, self.start.coarse);
        let job = setting.job;
        let Way { direction, holding, .. } = self.ways[way];
        let next_job = Job { initial: state.clone(), ..job.clone() };
        let next = setting.of_next_round(&next_job, setting.old_of(&now.volumes.reused));
        let kept = (&now.volumes.reused, &now.excess);
        let cutting = cut_with_skin(&next, coarse, (pit, kept), (direction, holding), ctx)?;
        let cut = state.minus(&cutting.state);
        let mut seeds = cut.clone();
        patches.iter().for_each(|v| seeds.set(*v, true));
        let reused = now.volumes.reused.minus(&cut);
        let missing = job.target.minus(&cutting.state);
        let added = flood(&missing, &seeds.and(&missing), Connectivity::Corner26);
        let volumes = Volumes {
            reused,
            removed: now.volumes.removed.or(&cut),
            added: now.volumes.added.or(&cut.and(&job.target)),
        };
        let preferred: Vec<Direction> =
            std::iter::once(direction).chain(self.start.preferred.iter().copied()).collect();
        let wanted = Wanted {
            state: &cutting.state,
            added: &added,
            core: &setting.beyond_skin(&added, &volumes.reused),
            preferred: &preferred,
            samples: 0,
            patience: Patience::Endless,
        };
        let printing = match self.supported == Some(way) {
            true => {
                on_supports_and_cut(&next, coarse, &wanted, self.terms.options.directions, ctx)?
            }
            false => {
                let printing = print_blocks(&next, coarse, &wanted, &[], ctx)?;
                print_crumbs(&next, coarse, &wanted, printing, leaves_none, ctx)?
            }
        };
        if printing.steps.is_empty() {
            return Ok(None);
        }
        let steps = followed(followed(now.steps.clone(), cutting.steps), printing.steps);
        let left = job.target.minus(&printing.state);
        let deficit = setting.beyond_skin(&left, &volumes.reused);
        let over = printing.state.minus(&job.target);
        Ok(Some(Attempt {
            steps,
            excess: setting.beyond_skin(&over, &volumes.reused),
            below: now.below.minus(&cut),
            deficit,
            volumes,
            ..now.clone()
        }))
    }
}

/// How high a cone rises at some distance aside, mm, that is so wide at its foot, mm, and gets so much wider for each mm up.
pub fn cone(foot: f64, opening: f64) -> impl Fn(f64) -> f64 + Sync {
    move |aside| (aside - foot).max(0.0) / opening
}

/// What of a state stands over some voxels along a direction: all that is no lower over one of them than `rise` says for how far
/// aside it is, both in mm.
pub fn pit_over(
    (state, frame): (&BitGrid, &Frame),
    over: &[[usize; 3]],
    d: Direction,
    rise: impl Fn(f64) -> f64 + Sync,
) -> BitGrid {
    let plane = d.image_plane();
    let h = frame.pitch;
    let mut pit = BitGrid::new(frame.dims);
    let Some((low, high)) = state.extent() else { return pit };
    // The box of the state across the direction.
    let corner = |k: usize| {
        let pick = |a: usize| if k >> a & 1 == 0 { low[a] } else { high[a] };
        plane.across(frame.center([pick(0), pick(1), pick(2)]))
    };
    let (lo, hi) = (0..8)
        .map(corner)
        .fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(lo, hi), p| (lo.min(p), hi.max(p)));
    let n = ((hi - lo) / h).ceil() + DVec2::ONE;
    let (nu, nv) = (n.x as usize, n.y as usize);
    // Of those over each other the lowest alone counts.
    let mut lowest: BTreeMap<[i64; 2], (DVec2, f64)> = BTreeMap::new();
    for p in over.iter().map(|v| frame.center(*v)) {
        let (uv, height) = (plane.across(p), plane.height(p));
        let cell = ((uv - lo) / h).round();
        let end = lowest.entry([cell.x as i64, cell.y as i64]).or_insert((uv, height));
        end.1 = end.1.min(height);
    }
    let ends: Vec<(DVec2, f64)> = lowest.into_values().collect();
    // Lowest height of the pit in each cell.
    let mut floor = vec![f64::INFINITY; nu * nv];
    floor.par_chunks_mut(nu).enumerate().for_each(|(j, row)| {
        for (i, z) in row.iter_mut().enumerate() {
            let at = lo + DVec2::new(i as f64, j as f64) * h;
            for (uv, height) in &ends {
                *z = z.min(height + rise(uv.distance(at)));
            }
        }
    });
    for v in state.iter_ones() {
        let p = frame.center(v);
        let g = ((plane.across(p) - lo) / h).round().max(DVec2::ZERO);
        let (i, j) = ((g.x as usize).min(nu - 1), (g.y as usize).min(nv - 1));
        if plane.height(p) > floor[i + nu * j] - h / 4.0 {
            pit.set(v, true);
        }
    }
    pit
}

/// A pit cut along a direction, as held, from the initial part of the setting's job, of which so much is kept before, and with it
/// what stood within the tolerance of that which it takes: that has no skin to be part of any more. What was too much before
/// may stay.
pub fn cut_with_skin(
    setting: &Setting,
    coarse: &Coarse,
    (pit, (kept, excess)): (&BitGrid, (&BitGrid, &BitGrid)),
    along: (Direction, usize),
    ctx: &Ctx,
) -> Result<Cutting, Cancelled> {
    let job = setting.job;
    let state = &job.initial;
    let too_much = |stands: &BitGrid, kept: &BitGrid| {
        setting.beyond_skin(&stands.minus(&job.target), kept).minus(excess)
    };
    let bare = |pit: &BitGrid| too_much(state, &kept.minus(pit));
    let cutting = cut_along(setting, coarse, &pit.or(&bare(pit)), along, ctx)?;
    let stuck = too_much(&cutting.state, &kept.and(&cutting.state));
    if stuck.is_empty() {
        return Ok(cutting);
    }
    // What is not cut with it stays skin where the pit leaves out what is near.
    let pit = setting.beyond_skin(pit, &stuck);
    cut_along(setting, coarse, &pit.or(&bare(&pit)), along, ctx)
}

#[cfg(test)]
mod tests {
    use super::super::local_tests::{assert_verifies, job_of, with_run};
    use super::super::round::{Mending, attempt};
    use super::*;
    use crate::plan::{Plan, end_state};

    const DIMS: [usize; 3] = [46, 40, 30];

    fn block([x, y, z]: [usize; 3]) -> bool {
        (3..43).contains(&x) && (3..37).contains(&y) && (1..25).contains(&z)
    }

    /// A block with something missing.
    fn job(missing: impl Fn([usize; 3]) -> bool + Sync) -> Job {
        let frame = Frame { pitch: 1.0, dims: DIMS, origin: DVec3::ZERO };
        let target = BitGrid::from_fn(DIMS, block);
        let initial = BitGrid::from_fn(DIMS, |v| block(v) && !missing(v));
        job_of(frame, initial, target, |_| true)
    }

    /// A blind hole in a side, deeper than it is wide.
    fn hole([x, y, z]: [usize; 3]) -> bool {
        x < 13 && (18..22).contains(&y) && (16..20).contains(&z)
    }

    /// With nothing given up, as a plan that ends so.
    fn plain(run: &Run) -> Attempt {
        let how = (run.options, Mending::None);
        let (start, ctx) = (run.start, run.ctx);
        attempt(start.setting, start.coarse, Vec::new(), &start.preferred, how, ctx).unwrap()
    }

    #[test]
    fn a_hole_that_no_nozzle_gets_into_is_opened_and_filled() {
        let mut job = job(hole);
        // The hole is less than what the rules allow, so the plan without pits is valid.
        job.rules.deviation = 0.02;
        let (without, made, notes) = with_run(&job, |run| {
            let without = plain(run);
            let made = with_pits(run, without.clone(), None).unwrap();
            (without, made, run.report.notes.clone())
        });
        assert!(without.deficit.count() > 30, "{}", without.deficit.count());
        assert_eq!(made.left(), 0);
        let lost = without.volumes.reused.minus(&made.volumes.reused).count();
        assert!((1..4000).contains(&lost), "{lost} of {}", without.volumes.reused.count());
        assert!(notes.iter().any(|n| n.contains("given up in pits")), "{notes:?}");
        assert_verifies(&job, made.steps);
    }

    /// Small pits in vain, one after the other, once ended the search before a large one was tried.
    #[test]
    fn after_small_pits_in_vain_larger_ones_are_tried() {
        let mut job = job(hole);
        job.rules.deviation = 0.02;
        let (made, raised) = with_run(&job, |run| {
            let terms = Terms { rival: Some(0), options: run.options };
            let mut digging = Digging::new(run.start, plain(run), terms);
            digging.vain = PATIENCE;
            let before = digging.now.left();
            let made = digging.next(run.ctx).unwrap();
            (made.map(|(m, _)| (m.left(), before)), digging.price)
        });
        let (left, before) = made.expect("a pit at a higher price");
        assert!(left < before && raised > 0, "{left} of {before}, {raised}");
    }

    /// What is missing next to what stands is skin and no deficit: what hangs over it alone went for what nothing carries,
    /// and got no pit.
    #[test]
    fn what_is_missing_within_the_skin_carries_what_is_missing_beyond() {
        let mut job = job(hole);
        job.rules.tolerance_mm = 1.2;
        let (bodies, deficit, missing) = with_run(&job, |run| {
            let terms = Terms { rival: None, options: run.options };
            let digging = Digging::new(run.start, plain(run), terms);
            let up = digging.ways.iter().position(|w| w.direction == Direction::Z).unwrap();
            let bodies = digging.all_bodies(run.ctx).unwrap();
            let bodies: Vec<_> = bodies.into_iter().map(|b| b[up].clone()).collect();
            let missing = job.target.minus(&digging.state);
            (bodies, digging.now.deficit.clone(), missing)
        });
        assert!(bodies.len() > 1, "{}", bodies.len());
        let mut of_skin = 0;
        for body in bodies {
            let body = body.expect("printed along with what is under it");
            assert!(body.voxels.iter().all(|v| missing.get(*v)));
            of_skin += body.voxels.iter().filter(|v| !deficit.get(**v)).count();
        }
        assert!(of_skin > 0);
    }

    /// What is missing on the base had no body straight up, since nothing stands under it, and got pits from the sides
    /// alone.
    #[test]
    fn the_base_carries_what_is_missing_on_it() {
        let low = |[x, y, z]: [usize; 3]| block([x, y, z + 1]) && z < 24;
        let notch = |[x, y, z]: [usize; 3]| x < 13 && (18..22).contains(&y) && z < 4;
        let frame = Frame { pitch: 1.0, dims: DIMS, origin: DVec3::ZERO };
        let target = BitGrid::from_fn(DIMS, low);
        let initial = BitGrid::from_fn(DIMS, |v| low(v) && !notch(v));
        let job = job_of(frame, initial, target, |_| true);
        let with_bodies = with_run(&job, |run| {
            let terms = Terms { rival: None, options: run.options };
            let digging = Digging::new(run.start, plain(run), terms);
            let up = digging.ways.iter().position(|w| w.direction == Direction::Z).unwrap();
            let bodies = digging.all_bodies(run.ctx).unwrap();
            let is_on_base = |p: &Patch| p.voxels.iter().any(|v| v[2] == 0);
            let low = digging.patches.iter().zip(&bodies).filter(|(p, _)| is_on_base(p));
            low.map(|(_, b)| b[up].is_some()).collect::<Vec<bool>>()
        });
        assert!(!with_bodies.is_empty() && with_bodies.iter().all(|has| *has), "{with_bodies:?}");
    }

    /// A thin layer on what a pit gives up was within the tolerance of it: left standing, it counted as skin
    /// still, and the plan as complete.
    #[test]
    fn skin_of_what_a_pit_gives_up_is_cut_with_it_or_counts_as_left() {
        let corner = |[x, y, z]: [usize; 3]| x < 12 && (14..26).contains(&y) && z >= 16;
        let mut job = job(hole);
        for x in 3..16 {
            (3..37).for_each(|y| job.initial.set([x, y, 25], true));
        }
        let pit = BitGrid::from_fn(DIMS, |v| block(v) && corner(v) && !hole(v));
        let (made, cut) = with_run(&job, |run| {
            let digging =
                Digging::new(run.start, plain(run), Terms { rival: None, options: run.options });
            let way = digging.ways.iter().position(|w| w.direction.vec().x < -0.9);
            let over: Vec<[usize; 3]> = digging.now.deficit.iter_ones().collect();
            let made = digging.made((&pit, &over), way.unwrap(), run.ctx).unwrap().unwrap();
            let cut = digging.now.volumes.reused.minus(&made.volumes.reused).count();
            (made, cut)
        });
        assert!(cut > 400, "{cut}");
        let end = end_state(&job, &Plan { holdings: Vec::new(), steps: made.steps.clone() });
        let setting = Setting::new(&job);
        assert_eq!(made.excess, setting.beyond_skin(&end.excess, &end.reused));
        assert_eq!(made.deficit, setting.beyond_skin(&end.deficit, &end.reused));
        assert!(made.excess.is_empty());
    }

    /// A nub under a bridge is missing, two layers and more deep: nothing carries it along any axis, so the bridge over it
    /// is opened and both are printed on supports, which go again.
    #[test]
    fn what_hangs_over_nothing_is_printed_on_supports() {
        let missing = |[x, y, z]: [usize; 3]| {
            (18..28).contains(&x) && (15..25).contains(&y) && (10..15).contains(&z)
        };
        let bridge = |v: [usize; 3]| block(v) && (!(12..34).contains(&v[0]) || v[2] >= 15);
        let frame = Frame { pitch: 1.0, dims: DIMS, origin: DVec3::ZERO };
        let target = BitGrid::from_fn(DIMS, |v| bridge(v) || missing(v));
        let mut job = job_of(frame, BitGrid::from_fn(DIMS, bridge), target, |_| true);
        // The nub is less than what the rules allow, so the plan without pits is valid.
        job.rules.deviation = 0.05;
        let pits = |rival| {
            with_run(&job, |run| {
                let without = plain(run);
                let made = with_pits(run, without.clone(), rival).unwrap();
                (without, made)
            })
        };
        let (without, made) = pits(None);
        assert!(without.deficit.count() > 200, "{}", without.deficit.count());
        assert_eq!(made.left(), without.left(), "no pit alone opens it");
        let (_, made) = pits(Some(0));
        assert_eq!(made.left(), 0, "{} {}", made.excess.count(), made.deficit.count());
        let aside = made.printed_aside(&job).count();
        assert!(aside > 10, "{aside} voxels of supports");
        assert_verifies(&job, made.steps);
    }

    /// What nothing would carry asks for no large pits, and a complete plan for none.
    #[test]
    fn a_plan_without_hope_or_need_stays_as_it_is() {
        let whole = job(|_| false);
        let none = |job: &Job| {
            with_run(job, |run| {
                let without = plain(run);
                let made = with_pits(run, without.clone(), None).unwrap();
                (without, made)
            })
        };
        let (without, made) = none(&whole);
        assert_eq!((without.steps.len(), made.steps.len()), (0, 0));
        // Under the part there is the table alone.
        let mut hollow = job(|[x, y, z]| z < 6 && (12..34).contains(&x) && (12..28).contains(&y));
        hollow.rules.deviation = 0.1;
        let (without, made) = none(&hollow);
        assert!(!without.deficit.is_empty());
        assert_eq!(without.volumes.reused, made.volumes.reused);
    }

    #[test]
    fn a_pit_is_the_cone_over_what_is_missing() {
        let job = job(hole);
        let (pit, room, state) = with_run(&job, |run| {
            let digging =
                Digging::new(run.start, plain(run), Terms { rival: None, options: run.options });
            let over = [[20, 20, 10], [23, 20, 12], [20, 20, 13]];
            let room = digging.ways[0].tool.tip_radius() + 0.5;
            (digging.pit(&over, Direction::Z, 2.0), room, digging.state.clone())
        });
        let ends = [[20.0, 20.0, 10.0], [23.0, 20.0, 12.0]].map(DVec3::from_array);
        let want = BitGrid::from_fn(DIMS, |v| {
            let q = DVec3::from_array(v.map(|c| c as f64));
            let over = |p: &DVec3| {
                let aside = ((q - *p).truncate().length() - room).max(0.0);
                q.z - p.z > aside / 2.0 - 0.25
            };
            state.get(v) && ends.iter().any(over)
        });
        assert_eq!(pit, want);
        assert!(pit.count() > 500);
    }
}
