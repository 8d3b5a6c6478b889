//! Where the parts are put, and which of several placements of the target is planned.
//!
//! Method. `--setup keep` takes the poses of the files; else the setup search ranks placements of
//! the target in the initial part, which stays as it stands or, on request, is laid on another of
//! its faces. The best placement is planned. Asked for so many candidates, that many are planned in
//! full and the best plan is kept. Where planner search begins with nothing, the candidates are the six
//! ways of putting the target on the table, its file's first; those from which a first over-fill misses
//! most come last. They are planned until a search ends within δ of the target. Asked for none in
//! particular, the best is looked at on a coarse grid first. Where it promises to leave nothing and to keep
//! enough of what both parts have in common there, it is planned; else the others are looked at as well and the
//! most promising is. Where that plan keeps little or leaves anything, of those that promise more than it came to
//! (of all, where it leaves more than the rules allow), the most promising first, at
//! most two are planned as well, or one where it leaves no more than the rules allow, until one does neither.
//!
//! Guarantees: the same choice at any thread count; of plans made on the job's grid the best is
//! kept. Not guaranteed: that no other placement has a better plan. Millimetres.

use super::args::{Axis, Setup};
use super::config::PlanConfig;
use super::exit::Failure;
use super::inputs::{self, Grids, Part};
use super::pipeline;
use super::plan::Clock;
use hmplan::base::{Ctx, DAffine3, DVec3};
use hmplan::machine::{Holding, Taken, Tool};
use hmplan::mesh::TriMesh;
use hmplan::plan::{Inputs, Job, Rules, end_state};
use hmplan::planner::setup::Candidate;
use hmplan::planner::{hybrid, reman};

/// A plan that keeps this share of what both parts have in common at its place is not compared with
/// those of other placements: that would take twice as long. Of the twelve
/// parts of W2V Table 1 one keeps less (R_F / R_V of Holder: 0.48).
const ENOUGH_SHARE: f64 = 0.5;

/// Placements planned after the first where none keeps enough: each takes as long as the first.
const MOST_MORE: usize = 2;

/// The parts as they stand.
pub struct Parts {
    initial: Option<(Part, TriMesh)>,
    target: Part,
}

pub fn load(config: &PlanConfig, clock: &mut Clock) -> Result<Parts, Failure> {
    let (mut initial, mut target) = clock.time("load", || -> Result<_, Failure> {
        Ok((config.initial.as_ref().map(Part::read).transpose()?, Part::read(&config.target)?))
    })?;
    for part in initial.iter().chain([&target]) {
        for warning in &part.record.warnings {
            tracing::warn!("{}: {warning}", part.record.path);
        }
    }
    let mut standing: Vec<_> =
        initial.iter_mut().zip(&config.initial).map(|(p, c)| (p, c.up)).collect();
    standing.push((&mut target, config.target.up));
    inputs::stand(&mut standing)?;
    let placed = |part: Part| part.placed().map(|mesh| (part, mesh));
    Ok(Parts { initial: initial.map(placed).transpose()?, target })
}

/// A place of the target, and what to say of it.
#[derive(Clone)]
pub struct Place {
    motion: DAffine3,
    notes: Vec<String>,
    reused_share: f64,
}

/// Where the target may stand, the best place first: as in its file, or as the setup search finds,
/// which may lay the initial part on another face besides.
pub fn places(
    parts: &mut Parts,
    config: &PlanConfig,
    ctx: &Ctx,
    clock: &mut Clock,
) -> Result<Vec<Place>, Failure> {
    if parts.initial.is_none() && config.search.is_some() && config.setup == Setup::Search {
        return ways_up(&mut parts.target);
    }
    let (Some((initial, initial_mesh)), Setup::Search) = (&mut parts.initial, config.setup) else {
        let kept = parts.target.record.plan_from_part().unwrap_or(DAffine3::IDENTITY);
        return Ok(vec![Place { motion: kept, notes: Vec::new(), reused_share: 0.0 }]);
    };
    let turned = DAffine3::from_mat3(config.target.up.to_z());
    parts.target.place(&turned);
    let standing = parts.target.placed()?;
    let posed =
        clock.time("setup", || pipeline::search_setup(initial_mesh, &standing, config, ctx))?;
    let found = &posed.report;
    if posed.pose > 0 {
        let stood = initial.record.plan_from_part().unwrap_or(DAffine3::IDENTITY);
        initial.place(&(posed.initial * stood));
        *initial_mesh = initial.placed()?;
    }
    let of_initial = config.initial_pose_search.then(|| posed.note());
    let place = |c: &Candidate| {
        let notes = of_initial.iter().cloned().chain([found.note(c)]);
        let motion = c.transform * turned;
        Place { motion, notes: notes.collect(), reused_share: c.reused_share }
    };
    Ok([&found.winner].into_iter().chain(&found.others).map(place).collect())
}

/// The six ways up of a part that is made from nothing, the one it stands in first.
fn ways_up(target: &mut Part) -> Result<Vec<Place>, Failure> {
    let stood = target.record.plan_from_part().unwrap_or(DAffine3::IDENTITY);
    let floor = target.placed()?.bounds().min.z;
    let mut places = Vec::new();
    for up in [Axis::Z, Axis::X, Axis::NegX, Axis::Y, Axis::NegY, Axis::NegZ] {
        let turned = DAffine3::from_mat3(up.to_z()) * stood;
        target.place(&turned);
        let sunk = floor - target.placed()?.bounds().min.z;
        let motion = DAffine3::from_translation(DVec3::Z * sunk) * turned;
        places.push(Place { motion, notes: Vec::new(), reused_share: 0.0 });
    }
    target.place(&stood);
    Ok(places)
}

/// A plan, and what it was made for.
pub struct Made {
    pub prepared: Prepared,
    pub planned: pipeline::Planned,
    pub notes: Vec<String>,
}

impl Made {
    fn standing(&self) -> reman::Standing {
        self.planned.standing
    }

    /// Whether it leaves nothing and keeps [`ENOUGH_SHARE`].
    fn is_enough(&self) -> bool {
        self.standing().class == 0 && self.keeps_enough()
    }

    /// Whether it ranks higher than another plan; one that leaves nothing above one that leaves little only as
    /// long as it gives up no more than [`reman::COMPLETION_SHARE`] for that, or loses less.
    fn is_worth_more_than(&self, other: &Made) -> bool {
        let job = &self.prepared.job;
        let target_mm3 = job.target.count() as f64 * job.frame.voxel_volume();
        ranks_higher(&self.standing(), &other.standing(), reman::COMPLETION_SHARE * target_mm3)
    }

    fn keeps_enough(&self) -> bool {
        let job = &self.prepared.job;
        let kept = end_state(job, &self.planned.plan).reused.count() as f64;
        kept >= ENOUGH_SHARE * job.ideal_reuse().count() as f64
    }
}

/// What every placement is planned with.
pub struct Placing<'a> {
    pub parts: &'a mut Parts,
    pub config: &'a PlanConfig,
    pub ctx: &'a Ctx,
    pub clock: &'a mut Clock,
}

impl Placing<'_> {
    /// Plans the places, as long as there is time, and keeps the best plan.
    pub fn best_of(&mut self, places: &[Place]) -> Result<Made, Failure> {
        let Some((first, others)) = places.split_first() else {
            return Err(Failure::input("the setup search found no placement"));
        };
        if self.parts.initial.is_none() && !others.is_empty() {
            return self.best_way_up(places);
        }
        if others.is_empty() {
            return self.plan_at(first);
        }
        if self.config.setup_candidates.is_some() {
            return self.best_of_all(places);
        }
        let mut glances = Vec::new();
        if self.config.is_reman() {
            let glance = self.look_at(first)?;
            let promises_enough = glance.promises_enough();
            glances.push(glance);
            if !promises_enough {
                self.look_at_more(&mut glances, places)?;
            }
        }
        let mut planned = vec![most_promising(&glances)];
        let mut best = self.plan_at(&places[planned[0]])?;
        let (mut kept, mut standings) = (planned[0], vec![best.standing()]);
        if !best.is_enough() {
            self.look_at_more(&mut glances, places)?;
        }
        let mut is_late = false;
        while !best.is_enough()
            && let Some(next) = next_to_plan(&glances, &planned, &best.standing())
        {
            if self.ctx.out_of_time() {
                is_late = true;
                break;
            }
            planned.push(next);
            let made = self.plan_at(&places[next])?;
            standings.push(made.standing());
            if made.is_worth_more_than(&best) {
                (best, kept) = (made, next);
            }
        }
        if planned.len().max(glances.len()) > 1 {
            for (i, standing) in planned.iter().zip(&standings) {
                let how = if *i == kept { ", this plan" } else { ", planned as well" };
                best.notes.push(told(places, *i, standing, how));
            }
            let others = glances.iter().enumerate().filter(|(i, _)| !planned.contains(i));
            best.notes.extend(others.map(|(i, glance)| promised(places, i, &glance.standing)));
        }
        best.notes.extend(is_late.then(|| LATE.into()));
        Ok(best)
    }

    /// Plans all places in full, as long as there is time.
    fn best_of_all(&mut self, places: &[Place]) -> Result<Made, Failure> {
        let mut best: Option<Made> = None;
        let mut lines = Vec::new();
        for (i, place) in places.iter().enumerate() {
            if best.is_some() && self.ctx.out_of_time() {
                lines.push(LATE.into());
                break;
            }
            let made = self.plan_at(place)?;
            lines.push(told(places, i, &made.standing(), ", planned"));
            if best.as_ref().is_none_or(|b| made.standing() < b.standing()) {
                best = Some(made);
            }
        }
        let mut best = best.ok_or_else(|| Failure::input("the setup search found no placement"))?;
        best.notes.extend(lines);
        Ok(best)
    }

    /// Looks at the places that were not looked at yet, as long as there is time.
    fn look_at_more(&mut self, glances: &mut Vec<Glance>, places: &[Place]) -> Result<(), Failure> {
        for place in &places[glances.len()..] {
            if self.ctx.out_of_time() {
                break;
            }
            glances.push(self.look_at(place)?);
        }
        Ok(())
    }

    /// Plans one way up after the other, as long as there is time, until one ends within δ of the target. A way
    /// that cannot be planned counts only where it is the first.
    fn best_way_up(&mut self, places: &[Place]) -> Result<Made, Failure> {
        let mut best: Option<(Made, String)> = None;
        let mut others = Vec::new();
        for place in self.most_promising_first(places) {
            if best.is_some() && self.ctx.out_of_time() {
                others.push("no time for the rest".to_string());
                break;
            }
            let up = axis_up(&place.motion);
            let made = match self.plan_at(place) {
                Err(e) if best.is_some() && !matches!(e, Failure::Interrupted) => {
                    others.push(format!("{up} cannot be planned: {e}"));
                    continue;
                }
                made => made?,
            };
            let standing = made.standing();
            let left = |up: &str, m: &Made| format!("{up} {:.1} mm³", m.standing().left_mm3);
            match &best {
                Some((b, _)) if standing >= b.standing() => others.push(left(&up, &made)),
                _ => {
                    let before = best.replace((made, up));
                    others.extend(before.map(|(m, up)| left(&up, &m)));
                }
            }
            if standing.class < 2 {
                break;
            }
        }
        let Some((mut best, up)) = best else {
            return Err(Failure::input("the setup search found no placement"));
        };
        let files = places.first().map_or_else(String::new, |p| axis_up(&p.motion));
        if others.is_empty() && up != files {
            others.push(format!("{files} up, as in the file, promised less"));
        }
        if !others.is_empty() {
            let own = best.standing().left_mm3;
            best.notes.push(format!(
                "Setup: {up} of the file up leaves {own:.1} mm³; {}.",
                others.join(", ")
            ));
        }
        Ok(best)
    }

    /// The places by what a first over-fill from there misses; within δ all are as good. Those that
    /// cannot be prepared keep their turn, to be complained of.
    fn most_promising_first<'p>(&mut self, places: &'p [Place]) -> Vec<&'p Place> {
        let Placing { parts, config, ctx, clock } = self;
        let Some(options) = &config.search else { return places.iter().collect() };
        let mut misses = |place: &Place| {
            let prepared = prepare(parts, &place.motion, config, ctx, clock).ok()?;
            let job = &prepared.job;
            let missed = clock.time("search", || hybrid::glance(job, options, ctx)).ok()?;
            let enough = options.delta * job.target.count() as f64 * job.frame.voxel_volume();
            Some(if missed <= enough { 0.0 } else { missed })
        };
        let mut known: Vec<(f64, &Place)> =
            places.iter().map(|p| (misses(p).unwrap_or(0.0), p)).collect();
        known.sort_by(|a, b| a.0.total_cmp(&b.0));
        known.into_iter().map(|(_, place)| place).collect()
    }

    /// How a plan may stand with the target at a place.
    fn look_at(&mut self, place: &Place) -> Result<Glance, Failure> {
        let Placing { parts, config, ctx, clock } = self;
        clock.time("setup", || {
            let Prepared { job, .. } =
                prepare(parts, &place.motion, config, ctx, &mut Clock::start())?;
            let standing = reman::glance(&job, &config.reman, ctx).map_err(pipeline::failure)?;
            let [target, common] = [&job.target, &job.ideal_reuse()]
                .map(|s| s.count() as f64 * job.frame.voxel_volume());
            let kept_mm3 = target - standing.given_up_mm3;
            Ok(Glance { standing, keeps_enough: kept_mm3 >= ENOUGH_SHARE * common })
        })
    }

    /// Plans with the target at a place.
    fn plan_at(&mut self, place: &Place) -> Result<Made, Failure> {
        let Placing { parts, config, ctx, clock } = self;
        let mut notes = place.notes.clone();
        let mut prepared = prepare(parts, &place.motion, config, ctx, clock)?;
        if config.setup == Setup::Search && config.is_reman() {
            let looked = || reman::shift_off_hidden(&prepared.job, &config.reman, ctx);
            if let Some(shift) = clock.time("setup", looked)? {
                let by = DVec3::from_array(shift.map(|n| n as f64 * prepared.job.frame.pitch));
                let motion = DAffine3::from_translation(by) * place.motion;
                prepared = prepare(parts, &motion, config, ctx, clock)?;
                notes.push(format!(
                    "The target was moved on by ({:.2}, {:.2}, {:.2}) mm, so that next to nothing of what \
                     is printed is hidden by the reused volume or hangs just over the base.",
                    by.x, by.y, by.z
                ));
            }
        }
        let planned = pipeline::plan(&prepared.job, config, ctx, clock)?;
        Ok(Made { prepared, planned, notes })
    }
}

/// Whether a plan ranks higher than another, where leaving nothing at all is worth so many mm³ given up.
fn ranks_higher(one: &reman::Standing, other: &reman::Standing, worth_mm3: f64) -> bool {
    let completes = (one.class, other.class) == (0, 1);
    let is_dear = one.given_up_mm3 > other.given_up_mm3 + worth_mm3;
    if completes && is_dear { one.loss_mm3() < other.loss_mm3() } else { one < other }
}

/// How a plan may stand with the target at a place.
#[derive(Clone, Copy, Debug)]
struct Glance {
    standing: reman::Standing,
    /// Whether it keeps [`ENOUGH_SHARE`]; of nothing in common nothing is enough.
    keeps_enough: bool,
}

impl Glance {
    /// Whether a plan that turns out so is not compared with those of other placements.
    fn promises_enough(&self) -> bool {
        self.standing.class == 0 && self.keeps_enough
    }
}

/// The placement that loses least at a glance, the first of equals; the first where none was looked at.
fn most_promising(glances: &[Glance]) -> usize {
    let losses = glances.iter().map(|g| g.standing.loss_mm3()).enumerate();
    losses.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |(i, _)| i)
}

/// Which placement to plan after those that were: the one that loses least at a glance, if that is less than the
/// best plan loses; where that one fails, whatever it promises, since its glance did not show why. Where the best
/// leaves little, one more is enough.
fn next_to_plan(glances: &[Glance], planned: &[usize], best: &reman::Standing) -> Option<usize> {
    let most = if best.class == 1 { 1 } else { MOST_MORE };
    if planned.len() > most {
        return None;
    }
    let losses = glances.iter().map(|g| g.standing.loss_mm3()).enumerate();
    let promising = |&(i, loss): &(usize, f64)| {
        !planned.contains(&i) && (best.class == 2 || loss < best.loss_mm3())
    };
    losses.filter(promising).min_by(|a, b| a.1.total_cmp(&b.1)).map(|(i, _)| i)
}

/// What is said where not all could be planned.
const LATE: &str = "The time limit came before the other placements.";

/// One line on what a place promised by a look on the coarse grid, which tells places apart and judges none.
fn promised(places: &[Place], i: usize, s: &reman::Standing) -> String {
    format!(
        "{}, looked at on a coarse grid only: some {:.0} mm³ given up, {:.0} mm³ left.",
        named(places, i),
        s.given_up_mm3,
        s.left_mm3
    )
}

/// Which of some places it is.
fn named(places: &[Place], i: usize) -> String {
    let share = 100.0 * places[i].reused_share;
    format!("Placement {} of {}, {share:.1} % inside", i + 1, places.len())
}

/// One line on how a plan of a place stands.
fn told(places: &[Place], i: usize, s: &reman::Standing, how: &str) -> String {
    let what = match s.class {
        0 => format!("a complete plan that gives up {:.1} mm³", s.given_up_mm3),
        1 => format!("{:.1} mm³ given up, {:.1} mm³ left", s.given_up_mm3, s.left_mm3),
        _ => format!(
            "{:.1} mm³ given up, {:.1} mm³ left, more than the rules allow",
            s.given_up_mm3, s.left_mm3
        ),
    };
    format!("{}{how}: {what}.", named(places, i))
}

/// Which axis of its file a part has up: "-x".
fn axis_up(plan_from_part: &DAffine3) -> String {
    let up = plan_from_part.matrix3.transpose() * DVec3::Z;
    let [x, y, z] = up.abs().to_array();
    let (name, along) = match () {
        () if x > y.max(z) => ("x", up.x),
        () if y > z => ("y", up.y),
        () => ("z", up.z),
    };
    format!("{}{name}", if along < 0.0 { "-" } else { "" })
}

/// What there is before planning begins.
pub struct Prepared {
    pub job: Job,
    pub inputs: Inputs,
}

/// Both parts on one grid, with the tools and rules that go with its pitch.
fn prepare(
    parts: &mut Parts,
    motion: &DAffine3,
    config: &PlanConfig,
    ctx: &Ctx,
    clock: &mut Clock,
) -> Result<Prepared, Failure> {
    let tools: Vec<Tool> = config.cutters.iter().chain(&config.nozzles).cloned().collect();
    let mut sampled = |motion: &DAffine3| {
        parts.target.place(motion);
        let (initial, pitch) = (parts.initial.as_ref(), config.resolution_mm);
        clock.time("voxelise", || {
            Grids::of(initial, &parts.target, pitch, &tools, config.reman.finish_mm, ctx)
        })
    };
    let mut grids = sampled(motion)?;
    // What is made voxel by voxel stands on the base with voxels. A place found by search may put
    // a tip on it that is finer than these; whole voxels lower, the solid is the same.
    let gap_mm = inputs::gap_mm(&grids.target, &grids.frame);
    if config.nullify.is_some() && config.setup == Setup::Search && gap_mm > 0.0 {
        let lower = DAffine3::from_translation(DVec3::Z * -gap_mm) * *motion;
        grids = sampled(&lower)?;
    }
    let Grids { frame, initial: initial_solid, target: target_solid, target_mesh } = grids;
    let (initial, target) = (parts.initial.as_ref(), &parts.target);
    let (mut cutters, mut nozzles) = (config.cutters.clone(), config.nozzles.clone());
    if let Some(options) = &config.nullify {
        cutters = vec![Tool::inv_cutter(frame.pitch, options.length)];
        nozzles = vec![Tool::inv_nozzle(frame.pitch)];
    }
    for tools in [&mut cutters, &mut nozzles] {
        tools.retain(|t| match t.taken {
            Taken::Always => true,
            Taken::FineGrids => t.is_round_at(frame.pitch),
            // Planner search weighs all its tools against each other at every step.
            Taken::LastResort | Taken::Finest | Taken::NarrowGaps => config.search.is_none(),
        });
    }
    let costs = config.search.iter().flat_map(|s| &s.tool_costs);
    for (name, _) in costs {
        let tools = cutters.iter().chain(&nozzles);
        if tools.clone().all(|t| t.name != *name) {
            let names: Vec<&str> = tools.map(|t| t.name.as_str()).collect();
            return Err(Failure::Input(format!(
                "--tool-cost {name}: planner search has no such tool here; it has {}",
                names.join(", ")
            )));
        }
    }
    let mut rules = Rules::for_pitch(frame.pitch, layer_mm(&nozzles));
    rules.holding = config.rules.holding;
    rules.base = config.rules.base;
    rules.tolerance_mm = config.rules.tolerance_mm.unwrap_or(rules.tolerance_mm);
    rules.grip_mm = config.rules.grip_mm.unwrap_or(rules.grip_mm);
    rules.deviation = config.search.as_ref().map_or(rules.deviation, |s| s.delta);
    let mut machine = config.machine.clone();
    if config.find_place {
        let contact = Holding::AS_CLAMPED.contact(&target_solid, &frame, rules.grip_mm);
        let sum: DVec3 = contact.iter_ones().map(|v| frame.center(v)).sum();
        let foot = sum / contact.count().max(1) as f64;
        machine.workholding.place = machine.find_place(frame.bounds(), foot);
    }
    let job = Job {
        frame,
        initial: initial_solid,
        target: target_solid,
        initial_mesh: initial.map(|i| i.1.clone()).unwrap_or_default(),
        target_mesh,
        machine,
        cutters,
        nozzles,
        rules,
    };
    let inputs =
        Inputs { initial: initial.map(|i| i.0.record.clone()), target: target.record.clone() };
    Ok(Prepared { job, inputs })
}

/// The thinnest layer of the nozzles used, mm: how deep any of them may ride into its own layer.
fn layer_mm(nozzles: &[Tool]) -> f64 {
    nozzles.iter().map(|t| t.process.layer_mm).fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;
    use hmplan::base::DMat3;

    fn standing(class: u8, given_up_mm3: f64, left_mm3: f64) -> reman::Standing {
        reman::Standing { class, given_up_mm3, left_mm3 }
    }

    #[test]
    fn what_promises_more_than_the_best_plan_keeps_has_a_turn() {
        let glances: Vec<Glance> = [5.0, 9.0, 4.0, 7.0, 3.0]
            .map(|loss| Glance { standing: standing(0, loss, 0.0), keeps_enough: false })
            .to_vec();
        assert_eq!(most_promising(&glances), 4);
        assert_eq!(most_promising(&[]), 0);
        let next = |planned: &[usize], best| next_to_plan(&glances, planned, &best);
        let complete = standing(0, 4.5, 0.0);
        assert_eq!(next(&[4], complete), Some(2));
        assert_eq!(next(&[4, 2], complete), None);
        assert_eq!(next(&[4], standing(1, 4.5, 1.0)), Some(2));
        assert_eq!(next(&[4, 2], standing(1, 4.5, 1.0)), None);
        // A plan that fails, whatever the others promise, but no more than three in all.
        assert_eq!(next(&[4], standing(2, 0.0, 0.1)), Some(2));
        assert_eq!(next(&[4, 2], standing(2, 0.0, 0.1)), Some(0));
        assert_eq!(next(&[4, 2, 0], standing(2, 0.0, 0.1)), None);
    }

    #[test]
    fn a_glance_that_keeps_enough_and_leaves_nothing_is_planned_at_once() {
        let promises = |class: u8, keeps_enough: bool| {
            Glance { standing: standing(class, 1.0, 0.0), keeps_enough }.promises_enough()
        };
        assert!(promises(0, true) && !promises(0, false) && !promises(1, true));
    }

    #[test]
    fn leaving_nothing_is_worth_some_of_the_target_not_most_of_it() {
        let (little, none) = (standing(1, 100.0, 7.0), |given_up| standing(0, given_up, 0.0));
        assert!(ranks_higher(&none(150.0), &little, 50.0));
        assert!(!ranks_higher(&none(171.0), &little, 50.0));
        // It loses less all the same.
        assert!(ranks_higher(&none(160.0), &little, 50.0));
        assert!(ranks_higher(&none(900.0), &standing(2, 0.0, 80.0), 50.0));
        assert!(ranks_higher(&standing(1, 90.0, 7.0), &little, 50.0));
        assert!(!ranks_higher(&little, &none(900.0), 50.0));
    }

    #[test]
    fn the_axis_that_points_up_is_told_by_its_name_in_the_file() {
        for (axis, name) in [
            (Axis::X, "x"),
            (Axis::Y, "y"),
            (Axis::Z, "z"),
            (Axis::NegX, "-x"),
            (Axis::NegY, "-y"),
            (Axis::NegZ, "-z"),
        ] {
            let shift = DAffine3::from_translation(DVec3::new(3.0, -2.0, 1.0));
            assert_eq!(axis_up(&(shift * DAffine3::from_mat3(axis.to_z()))), name);
        }
        let around = DMat3::from_rotation_z(0.3) * Axis::NegY.to_z();
        assert_eq!(axis_up(&DAffine3::from_mat3(around)), "-y");
    }
}
