//! A finishing cut after the deposits (`--finish`; named as future work in W2V Sec. 8): what was
//! printed gets an allowance, and cutters take it off again, so that printed faces are machined too.
//!
//! Method. The blocks stay. Each is laid once more with what its nozzle can lay of a shell around
//! it, outside the target, that a cutter reaches while the whole target stands. Then all that
//! stands outside the target is cut, the cuts that took the supports first. Where the shell kept a later
//! block's nozzle out, or cutters left some of it, it is left out around there and all is made again;
//! so is what asks for a cut of its own and is little.
//!
//! Guarantees: those of cuts and deposits; the plan ranks no lower and leaves no more than without,
//! else it stays as it was. Not guaranteed: an allowance on every printed face. What faces down,
//! is hidden, or lies against what is reused has none.

use super::cutting::{Cuts, cut_blocks};
use super::printing::{Patience, Wanted, print_again};
use super::reach::within_reach;
use super::round::{Attempt, all_of};
use super::{Options, Run, Start};
use crate::base::{Ctx, Direction};
use crate::plan::{Job, Step, StepKind};
use crate::planner::PlanError;
use crate::voxel::{BitGrid, distance_within};

/// How often all is made again with less of the shell.
const AGAIN: usize = 4;

/// How far around what a nozzle no longer lays the shell is left out, mm: as far as nozzles are
/// thick where they pass it.
const NOZZLE_MM: f64 = 8.0;

/// How far around what cutters left of it the shell is left out, in voxels: a step of the surface.
const NEAR_LEFT: f64 = 2.0;

/// A further cut has to take this share of the shell: below, a crease here and there would ask for a
/// dozen directions. On the flange eleven of fourteen cuts took less, 3 % of the shell together.
const LEAST_CUT_SHARE: f64 = 0.03;

/// A plan's steps by their turn: cuts, deposits, cuts of what does not stay, late deposits.
struct Turns<'a> {
    deposits: &'a [Step],
    cuts: &'a [Step],
    late: &'a [Step],
}

impl<'a> Turns<'a> {
    fn of(attempt: &'a Attempt) -> Turns<'a> {
        let after = &attempt.steps[attempt.cuts..];
        let run = |steps: &'a [Step], kind| {
            steps.split_at(steps.iter().position(|s| s.kind != kind).unwrap_or(steps.len()))
        };
        let (deposits, after) = run(after, StepKind::Additive);
        let (cuts, late) = run(after, StepKind::Subtractive);
        Turns { deposits, cuts, late }
    }
}

/// The same plan with an allowance of so many mm on what it prints, and finishing cuts; what became
/// of it is told in the report's notes.
pub fn finished(run: &mut Run, plain: Attempt) -> Result<Attempt, PlanError> {
    let (options, ctx) = (run.options, run.ctx);
    let setting = run.start.setting.with_last_resort();
    let start = run.start.in_setting(&setting);
    let job = setting.job;
    let turns = Turns::of(&plain);
    let printed = all_of(job, turns.deposits);
    if printed.is_empty() {
        run.report.notes.push("No finishing cut: nothing is printed.".into());
        return Ok(plain);
    }
    let around = distance_within(&printed.and(&job.target), options.finish_mm / job.frame.pitch);
    let all = around.minus(&job.target).minus(&printed).minus(&plain.stock);
    let mut shell = within_reach(&setting, &job.target, &all, options.directions, ctx)?;
    let mut best: Option<(Attempt, BitGrid)> = None;
    for round in 0..=AGAIN {
        if shell.is_empty() || ctx.out_of_time() {
            break;
        }
        let (made, laid, mut obstacle) = start.with_shell(&plain, &turns, &shell, options, ctx)?;
        made.tell("finish", round);
        let is_no_worse = made.rank(job) <= plain.rank(job) && made.left() <= plain.left();
        let small = obstacle.is_empty().then(|| small_cuts(&made, &turns, &laid));
        if let Some(small) = small {
            obstacle = distance_within(&small, NEAR_LEFT).and(&shell);
            let is_shorter = best.as_ref().is_none_or(|(b, _)| made.steps.len() < b.steps.len());
            if is_no_worse && is_shorter {
                best = Some((made, laid));
            }
        }
        if obstacle.is_empty() {
            break;
        }
        shell.subtract(&obstacle);
    }
    run.clock.lap("blocks");
    if let Some((made, laid)) = best {
        run.report.notes.push(told(job, &all, &laid));
        return Ok(made);
    }
    run.report.notes.push(match shell.is_empty() {
        true => "No finishing cut: no tool gets at an allowance on what is printed.".into(),
        false => "No finishing cut: with an allowance the plan would leave more.".into(),
    });
    Ok(plain)
}

fn told(job: &Job, all: &BitGrid, laid: &BitGrid) -> String {
    let share = 100.0 * laid.count() as f64 / all.count().max(1) as f64;
    format!(
        "{:.1} mm³ of allowance are printed and machined off again: {share:.0} % of what it would be \
         on every printed face; the others face down, or no tool gets at them.",
        laid.count() as f64 * job.frame.voxel_volume()
    )
}

impl Start<'_> {
    /// The plan with a shell around its deposits, what of the shell was laid, and what of it is to
    /// be left out next time.
    fn with_shell(
        &self,
        plain: &Attempt,
        turns: &Turns,
        shell: &BitGrid,
        options: &Options,
        ctx: &Ctx,
    ) -> Result<(Attempt, BitGrid, BitGrid), PlanError> {
        let (setting, job) = (self.setting, self.setting.job);
        let samples = options.directions;
        let wanted = |state, added| Wanted {
            state,
            added,
            core: added,
            preferred: &[Direction::Z],
            samples,
            patience: Patience::Endless,
        };
        let stock = &plain.stock;
        let added = all_of(job, turns.deposits).or(shell);
        let radius = options.finish_mm / job.frame.pitch;
        let around = |s: &Step| distance_within(&s.region.and(&job.target), radius).and(shell);
        let again = wanted(stock, &added);
        let printing = print_again(setting, self.coarse, &again, turns.deposits, around, ctx)?;
        let laid = printing.state.and(shell);
        let missing = printing.unreached.minus(shell);

        let reused = &plain.volumes.reused;
        let next_job = Job { initial: printing.state, ..job.clone() };
        let next = setting.of_next_round(&next_job, setting.old_of(reused));
        let removable = next_job.initial.minus(&job.target);
        let skin = setting.skin(reused);
        let deep = removable.minus(&skin.minus(&laid));
        let cuts = Cuts {
            removable: &removable,
            deep: &deep,
            samples,
            before: turns.cuts,
            patient: false,
        };
        let cutting = cut_blocks(&next, self.coarse, &cuts, ctx)?;

        let late = all_of(job, turns.late).minus(&cutting.state);
        let again = wanted(&cutting.state, &late);
        let nothing = |_: &Step| BitGrid::new(job.frame.dims);
        let last = print_again(&next, self.coarse, &again, turns.late, nothing, ctx)?;

        let mut obstacle = BitGrid::new(job.frame.dims);
        if !missing.is_empty() {
            let near = distance_within(&missing, NOZZLE_MM / job.frame.pitch);
            obstacle.union_with(&near.and(shell));
        }
        let stuck = cutting.unreached.and(&laid);
        obstacle.union_with(&distance_within(&stuck, NEAR_LEFT).and(shell));

        let numbered = |first: usize| move |s: Step| Step { block: first + s.block, ..s };
        let mut steps = plain.steps[..plain.cuts].to_vec();
        let deposits = printing.steps.len();
        steps.extend(printing.steps);
        steps.extend(cutting.steps.into_iter().map(numbered(plain.cuts)));
        steps.extend(last.steps.into_iter().map(numbered(deposits)));
        let mut deficit = plain.deficit.or(&missing.and(&job.target).minus(&skin));
        deficit.union_with(&last.unreached.minus(&skin));
        let excess = cutting.unreached.minus(&skin);
        let made = Attempt {
            clips: plain.clips.clone(),
            volumes: plain.volumes.clone(),
            steps,
            cuts: plain.cuts,
            stock: stock.clone(),
            deficit,
            below: plain.below.and(&excess),
            excess,
        };
        Ok((made, laid, obstacle))
    }
}

/// What of a shell is taken by further cuts, not among those the plan has anyway, that each take
/// little of it.
fn small_cuts(made: &Attempt, turns: &Turns, laid: &BitGrid) -> BitGrid {
    let least = LEAST_CUT_SHARE * laid.count() as f64;
    let way = |s: &Step| (s.tool.clone(), s.direction, s.holding);
    let is_further = |s: &&Step| turns.cuts.iter().all(|c| way(c) != way(s));
    let mut small = BitGrid::new(laid.dims());
    let cuts = Turns::of(made).cuts.iter();
    cuts.filter(is_further)
        .filter(|s| (s.region.count_and(laid) as f64) < least)
        .for_each(|s| small.union_with(&s.region.and(laid)));
    small
}

#[cfg(test)]
mod tests {
    use super::super::local_tests::job_of;
    use super::super::{Options, plan};
    use super::*;
    use crate::base::DVec3;
    use crate::machine::Taken;
    use crate::plan::end_state;
    use crate::verify::verify;
    use crate::voxel::Frame;

    const DIMS: [usize; 3] = [44, 24, 30];

    fn plate([x, y, z]: [usize; 3]) -> bool {
        (1..43).contains(&x) && (1..23).contains(&y) && z < 4
    }

    fn block(x: std::ops::Range<usize>) -> impl Fn([usize; 3]) -> bool + Sync {
        move |v| x.contains(&v[0]) && (6..18).contains(&v[1]) && (4..14).contains(&v[2])
    }

    fn job(printed: impl Fn([usize; 3]) -> bool + Sync) -> Job {
        let frame = Frame { pitch: 1.0, dims: DIMS, origin: DVec3::ZERO };
        let initial = BitGrid::from_fn(DIMS, plate);
        let target = BitGrid::from_fn(DIMS, |v| plate(v) || printed(v));
        job_of(frame, initial, target, |t| t.taken == Taken::Always)
    }

    /// The plan with an allowance of a voxel, checked, what it prints and what it cuts after that.
    fn planned(job: &Job) -> (Vec<String>, BitGrid, BitGrid) {
        let options = Options { finish_mm: 1.0, ..Options::default() };
        let (plan, report) = plan(job, &options, &Ctx::quiet()).unwrap();
        let end = end_state(job, &plan);
        assert_eq!(end.state, job.target);
        let of = |kind| {
            let mut all = BitGrid::new(DIMS);
            let steps = plan.steps.iter().filter(|s| s.kind == kind);
            steps.for_each(|s| all.union_with(&s.region));
            all
        };
        let (printed, cut) = (of(StepKind::Additive), of(StepKind::Subtractive));
        let verdict = verify(job, plan, &Ctx::quiet()).unwrap();
        assert!(verdict.passed(), "{:?}", verdict.rules);
        (report.notes, printed, cut)
    }

    #[test]
    fn printed_faces_are_printed_thicker_and_cut_back() {
        let job = job(block(16..28));
        let (notes, printed, cut) = planned(&job);
        let aside = printed.minus(&job.target);
        assert_eq!(aside, cut, "all of the allowance comes off, nothing else");
        // Above, and on the four sides but for the layer beside the plate, whose face is as it was.
        assert!(aside.get([20, 12, 14]), "the top");
        for side in [[15, 12, 9], [28, 12, 9], [20, 5, 9], [20, 18, 9]] {
            assert!(aside.get(side), "{side:?}");
        }
        assert!(notes.iter().any(|n| n.contains("of allowance")), "{notes:?}");
    }

    /// Between two blocks a voxel apart no cutter fits: an allowance there would stay.
    #[test]
    fn where_no_cutter_gets_there_is_no_allowance() {
        let (left, right) = (block(8..20), block(22..34));
        let job = job(|v| left(v) || right(v));
        let (_, printed, _) = planned(&job);
        let slot = BitGrid::from_fn(DIMS, |v| {
            (20..22).contains(&v[0]) && (7..17).contains(&v[1]) && (4..12).contains(&v[2])
        });
        assert!(printed.and(&slot).is_empty());
        assert!(printed.get([7, 12, 9]), "but on the outside");
    }

    #[test]
    fn without_it_nothing_is_printed_aside_and_too_thin_a_one_is_refused() {
        let job = job(block(16..28));
        let (plain, _) = plan(&job, &Options::default(), &Ctx::quiet()).unwrap();
        assert!(plain.steps.iter().all(|s| s.region.is_subset_of(&job.target)));
        let thin = Options { finish_mm: 0.5, ..Options::default() };
        let refused = plan(&job, &thin, &Ctx::quiet()).unwrap_err();
        assert!(refused.to_string().contains("--finish"), "{refused}");
    }
}
