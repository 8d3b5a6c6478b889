//! What both parts have in common and nothing would hold: deposits may.
//!
//! Method. W2V gives up what of Ṽ_R hangs on nothing once Ṽ_S is cut (Sec. 4.2): it would fall. But it falls only when
//! the last of what carries it goes, and until then deposits can be laid that carry it after that. So here all bodies of
//! Ṽ_R are reused but crumbs, nothing is given up, and three ways of making that are looked at on the coarse grid: print on the part as
//! it is and then cut (`printed_first`), or cut first, but for bridges to what would come loose (`bridges`), and print on supports or
//! as it stands (`keeping`). Where other deposits hide what carried the bodies, it is cut as soon as they are held and the rest printed
//! then, if that leaves less. Those ways that leave no more than the rules allow, or nothing but what pits may open, are made, the best
//! first, until one leaves nothing.
//!
//! Guarantees: those of cuts and deposits; no step lets anything come loose. Not guaranteed: that a bridge bears a load; that what
//! some of the bodies ask for is not what hinders a plan that would keep the others.

use super::aside::MORE_MISSING;
use super::fewest::with_fewest_cuts;
use super::keeping::{KEEPING_SHARE, Printed, kept_and, opened};
use super::last_resort::{closely_cut, on_supports};
use super::pits::leaves_little_enough;
use super::printed_first::on_coarse_grid;
use super::printing::Printing;
use super::round::{Attempt, UnderPlanes, volumes};
use super::{Options, Run, Start};
use crate::base::Ctx;
use crate::plan::{Job, StepKind};
use crate::planner::PlanError;
use crate::region::{Volumes, steady};
use crate::voxel::{BitGrid, Connectivity, components};

/// Bodies below this share of the target are crumbs, where surfaces cross: each would ask for a deposit of its own. Only
/// this share was tried.
const LEAST_BODY_SHARE: f64 = 2e-3;

/// How what hangs is held until deposits hold it.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Way {
    /// By what is to go, which is cut when all is printed.
    PrintedFirst,
    /// By bridges, all that is left of it when printing begins.
    CutFirst(Printed),
}

/// In the order in which they bear more: of equals the first is taken.
const WAYS: [Way; 3] =
    [Way::PrintedFirst, Way::CutFirst(Printed::OnSupports), Way::CutFirst(Printed::AsItStands)];

impl UnderPlanes {
    /// The volumes when all is reused that the parts have in common, but for crumbs that hang on nothing.
    fn of_all_in_common(job: &Job) -> UnderPlanes {
        let mut reused = volumes(job, &[]).reused;
        let bodies = components(&job.ideal_reuse(), Connectivity::Edge18);
        let least = LEAST_BODY_SHARE * job.target.count() as f64;
        let sizes = bodies.sizes();
        let counts = (0..sizes.len()).filter(|l| sizes[*l] as f64 >= least);
        counts.for_each(|label| reused.union_with(&bodies.grid_of(label as u32)));
        let (removed, added) = (job.initial.minus(&reused), job.target.minus(&reused));
        UnderPlanes { clips: Vec::new(), volumes: Volumes { reused, removed, added } }
    }
}

/// A plan that reuses what hangs as well.
pub struct Hanging {
    pub made: Attempt,
    /// What is to be told of it.
    notes: Vec<String>,
}

impl Hanging {
    /// The plan, in the place of what was planned and told so far.
    pub fn taken(self, run: &mut Run) -> Result<Attempt, PlanError> {
        run.report.notes = self.notes;
        let made = with_fewest_cuts(run, self.made)?;
        run.clock.lap("blocks");
        Ok(made)
    }
}

/// The best plan that reuses what hangs as well; none where little hangs, or where every way leaves too much on the
/// coarse grid.
pub fn with_what_hangs(run: &mut Run) -> Result<Option<Hanging>, PlanError> {
    let (start, options, ctx) = (run.start, run.options, run.ctx);
    let job = start.setting.job;
    let under = UnderPlanes::of_all_in_common(job);
    let hanging = under.volumes.reused.count() - volumes(job, &[]).reused.count();
    let is_worth_it = hanging as f64 > KEEPING_SHARE * job.target.count() as f64;
    if !is_worth_it || !options.supports || ctx.out_of_time() {
        return Ok(None);
    }
    let setting = start.setting.with_last_resort();
    let start = start.in_setting(&setting);
    let looks = match start.coarse.is_coarser() {
        true => on_coarse_grid(&start, |look| looks(look, options, ctx))?,
        false => looks(&start, options, ctx)?,
    };
    run.clock.lap("blocks");
    let told_before = std::mem::take(&mut run.report.notes);
    let mut best: Option<Hanging> = None;
    for (way, look) in looks {
        if ctx.out_of_time() || best.as_ref().is_some_and(|b| b.made.left() == 0) {
            break;
        }
        run.report.notes = vec![format!(
            "{:.1} mm³ of what both parts have in common would hang on nothing once the rest of the initial part is \
             cut away, so material that holds it is printed before that.",
            hanging as f64 * job.frame.voxel_volume()
        )];
        let made = match start.coarse.is_coarser() {
            true => way.made(&start, &under, options, ctx)?,
            false => look,
        };
        made.tell("hanging", 0);
        let made = closely_cut(run, &under, made)?;
        let made = opened(run, made, None)?;
        let notes = std::mem::take(&mut run.report.notes);
        if best.as_ref().is_none_or(|b| made.comes_before(&b.made, job)) {
            best = Some(Hanging { made, notes });
        }
    }
    run.report.notes = told_before;
    run.clock.lap("blocks");
    Ok(best)
}

/// What comes of the ways that leave no more than the rules allow, or only what pits may open, the least first.
fn looks(start: &Start, options: &Options, ctx: &Ctx) -> Result<Vec<(Way, Attempt)>, PlanError> {
    let job = start.setting.job;
    let under = UnderPlanes::of_all_in_common(job);
    let mut looks = Vec::new();
    for way in WAYS {
        let look = way.made(start, &under, options, ctx)?;
        look.tell("hanging, by a look", 0);
        let pits_may_mend_it = look.excess.is_empty() && leaves_little_enough(&look, job);
        if look.is_valid(job) || pits_may_mend_it {
            looks.push((way, look));
        }
    }
    looks.sort_by_key(|(_, look)| hindrance(look));
    Ok(looks)
}

/// How much of what an attempt leaves is in the way of one that leaves nothing: pits open what is missing, not what stands.
fn hindrance(made: &Attempt) -> usize {
    MORE_MISSING * made.excess.count() + made.deficit.count()
}

impl Way {
    /// What comes of it. The setting has the tools of the last resort.
    fn made(
        self,
        start: &Start,
        under: &UnderPlanes,
        options: &Options,
        ctx: &Ctx,
    ) -> Result<Attempt, PlanError> {
        let made = match self {
            Way::PrintedFirst => on_supports(start, under, options, ctx)?,
            Way::CutFirst(printed) => kept_and(printed, start, under, options, ctx)?,
        };
        start.cut_once_held(under, made, options, ctx)
    }
}

impl Start<'_> {
    /// An attempt with what carried pieces that hang cut as soon as deposits hold them, before other deposits hide it, and
    /// what is then missing printed; itself where that is no better.
    fn cut_once_held(
        &self,
        under: &UnderPlanes,
        made: Attempt,
        options: &Options,
        ctx: &Ctx,
    ) -> Result<Attempt, PlanError> {
        let job = self.setting.job;
        if made.left() == 0 || ctx.out_of_time() {
            return Ok(made);
        }
        let mut printed = BitGrid::new(job.frame.dims);
        let reused = &under.volumes.reused;
        let is_held = |printed: &BitGrid| {
            let stands = reused.or(printed);
            let held = steady(&stands, &job.frame, job.rules.holding, job.rules.grip_mm);
            reused.is_subset_of(&held)
        };
        let mut count = made.cuts;
        for step in &made.steps[made.cuts..] {
            if step.kind == StepKind::Subtractive {
                return Ok(made);
            }
            count += 1;
            printed.union_with(&step.region);
            if is_held(&printed) {
                break;
            }
        }
        let state = made.stock.or(&printed);
        let missing = job.target.minus(&state);
        let core = missing.minus(&self.setting.skin(reused));
        let after = (made.steps[..count].to_vec(), made.cuts, made.stock.clone());
        let so_far = Printing::before_any(state, missing);
        let sooner = self.ended(under, after, (so_far, &core), &[], options, ctx)?;
        tracing::debug!(deposits = count - made.cuts, "held");
        sooner.tell("cut once held", 0);
        Ok(if hindrance(&sooner) < hindrance(&made) { sooner } else { made })
    }
}

#[cfg(test)]
mod tests {
    use super::super::local_tests::{assert_verifies, job_of, with_run};
    use super::*;
    use crate::base::{DVec3, Direction};
    use crate::plan::{Action, Origin, Plan, Step, end_state};
    use crate::verify::verify;
    use crate::voxel::Frame;

    const DIMS: [usize; 3] = [44, 40, 32];

    fn within([x, y, z]: [usize; 3], least: [usize; 3], end: [usize; 3]) -> bool {
        let is_in = |v: usize, a: usize| (least[a]..end[a]).contains(&v);
        is_in(x, 0) && is_in(y, 1) && is_in(z, 2)
    }

    fn slab(v: [usize; 3]) -> bool {
        within(v, [10, 10, 14], [26, 30, 20])
    }

    /// What carries the slab at the end.
    fn post(v: [usize; 3]) -> bool {
        within(v, [26, 10, 0], [34, 30, 20])
    }

    /// A slab that is carried by something, and comes to be carried by the post.
    fn job(carrier: impl Fn([usize; 3]) -> bool + Sync, target: fn([usize; 3]) -> bool) -> Job {
        let frame = Frame { pitch: 1.0, dims: DIMS, origin: DVec3::ZERO };
        let initial = BitGrid::from_fn(DIMS, |v| slab(v) || carrier(v));
        let target = BitGrid::from_fn(DIMS, |v| slab(v) || post(v) || target(v));
        job_of(frame, initial, target, |_| true)
    }

    fn leg(v: [usize; 3]) -> bool {
        within(v, [4, 10, 0], [10, 30, 20])
    }

    fn kept(job: &Job) -> Attempt {
        with_run(job, |run| with_what_hangs(run).unwrap().map(|h| h.taken(run).unwrap()))
            .expect("what hangs can be held")
    }

    fn is_whole(made: &Attempt, job: &Job) {
        assert_eq!(volumes(job, &[]).reused.count(), 0, "nothing holds it without deposits");
        assert_eq!(made.left(), 0, "{} {}", made.excess.count(), made.deficit.count());
        let plan = Plan { holdings: Vec::new(), steps: made.steps.clone() };
        assert_eq!(end_state(job, &plan).reused, job.ideal_reuse());
        assert_verifies(job, made.steps.clone());
    }

    /// A quarter of the pairs drawn at random kept nothing, as what they had in common did not touch the base.
    #[test]
    fn what_hangs_is_held_by_what_is_printed_before_its_leg_is_cut() {
        let job = job(leg, |_| false);
        let made = kept(&job);
        is_whole(&made, &job);
        let kinds: Vec<StepKind> = made.steps.iter().map(|s| s.kind).collect();
        assert_eq!(kinds[0], StepKind::Additive);
        // The planner as a whole takes it.
        let (plan, report) = super::super::plan(&job, &Options::default(), &Ctx::quiet()).unwrap();
        assert_eq!(end_state(&job, &plan).reused, job.ideal_reuse());
        assert!(report.notes.iter().any(|n| n.contains("hang on nothing")), "{:?}", report.notes);
        assert!(verify(&job, plan, &Ctx::quiet()).unwrap().passed());
    }

    /// A roof over where the post comes: printed first, nothing gets there.
    #[test]
    fn a_bridge_holds_what_hangs_where_something_has_to_go_first() {
        let roof = |v| within(v, [4, 6, 22], [40, 34, 26]);
        let job = job(|v| leg(v) || roof(v) || within(v, [4, 10, 20], [10, 30, 22]), |_| false);
        let made = kept(&job);
        is_whole(&made, &job);
        assert_eq!(made.steps[0].kind, StepKind::Subtractive);
        assert_eq!(made.steps.last().map(|s| s.kind), Some(StepKind::Subtractive));
    }

    /// Walls all round a leg hide it: they are printed when it is cut.
    #[test]
    fn a_leg_is_cut_as_soon_as_deposits_hold_what_it_carried() {
        fn walls(v: [usize; 3]) -> bool {
            within(v, [4, 4, 0], [34, 36, 20]) && !within(v, [10, 10, 0], [26, 30, 20]) && !post(v)
        }
        let job = job(|v| within(v, [14, 16, 0], [20, 22, 14]), walls);
        let deposit = |of: fn([usize; 3]) -> bool, block| Step {
            kind: StepKind::Additive,
            tool: "needle-nozzle".into(),
            direction: Direction::Z,
            holding: 0,
            region: BitGrid::from_fn(DIMS, of),
            block,
            origin: Origin { plane: None, action: Some(Action::OF) },
        };
        let none = BitGrid::new(DIMS);
        let hidden = Attempt {
            clips: Vec::new(),
            volumes: UnderPlanes::of_all_in_common(&job).volumes,
            steps: vec![deposit(post, 0), deposit(walls, 1)],
            cuts: 0,
            stock: job.initial.clone(),
            excess: job.initial.minus(&job.target),
            deficit: none.clone(),
            below: none,
        };
        let made = with_run(&job, |run| {
            let (under, setting) =
                (UnderPlanes::of_attempt(&hidden), run.start.setting.with_last_resort());
            let start = run.start.in_setting(&setting);
            start.cut_once_held(&under, hidden.clone(), run.options, run.ctx).unwrap()
        });
        is_whole(&made, &job);
        let kinds: Vec<StepKind> = made.steps.iter().map(|s| s.kind).collect();
        assert_eq!(kinds[..2], [StepKind::Additive, StepKind::Subtractive]);
        assert_eq!(kinds.last(), Some(&StepKind::Additive));
    }

    #[test]
    fn where_all_is_held_nothing_is_looked_for() {
        let job = job(|v| within(v, [26, 10, 0], [30, 30, 20]), |_| false);
        assert!(with_run(&job, |run| with_what_hangs(run).unwrap().is_none()));
    }
}
