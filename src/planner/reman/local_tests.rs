//! Candidate planes and their choice on worlds small enough to know the answer.

use super::clip::Clip;
use super::coarse::Coarse;
use super::local::{Element, Scope};
use super::refine::refine;
use super::round::{Attempt, volumes};
use super::setting::Setting;
use super::{Clock, Options, Report, Run, Start, comes_first, plane_normals};
use crate::base::{Ctx, DVec3, Direction};
use crate::machine::{Machine, Tool, ToolKind};
use crate::mesh::TriMesh;
use crate::plan::{Job, Plan, Plane, Rules, Step};
use crate::verify::verify;
use crate::voxel::{BitGrid, Frame};

const DIMS: [usize; 3] = [40, 24, 30];

/// Two posts on a plate; the target has a cap on the first of them.
fn job() -> Job {
    let frame = Frame { pitch: 1.0, dims: DIMS, origin: DVec3::ZERO };
    let posts = |x: usize, z: usize| (4..12).contains(&x) || (26..36).contains(&x) && z < 26;
    let initial = BitGrid::from_fn(DIMS, |[x, y, z]| {
        (2..22).contains(&y) && (1..39).contains(&x) && (z < 4 || posts(x, z) && z < 20)
    });
    let target = BitGrid::from_fn(DIMS, |[x, y, z]| {
        initial.get([x, y, z])
            || (4..12).contains(&x) && (2..22).contains(&y) && (20..26).contains(&z)
    });
    job_of(frame, initial, target, |_| true)
}

/// Two solids, the preset machine and those of its tools that are wanted.
pub(super) fn job_of(
    frame: Frame,
    initial: BitGrid,
    target: BitGrid,
    wanted: impl Fn(&Tool) -> bool,
) -> Job {
    let machine = Machine::builtin("generic-5axis").unwrap();
    let tools = |kind| -> Vec<Tool> {
        machine.tools_of(kind).into_iter().filter(|t| wanted(t)).cloned().collect()
    };
    let (cutters, nozzles) = (tools(ToolKind::Subtractive), tools(ToolKind::Additive));
    Job {
        frame,
        initial,
        target,
        initial_mesh: TriMesh::default(),
        target_mesh: TriMesh::default(),
        machine,
        cutters,
        nozzles,
        rules: Rules::for_pitch(frame.pitch, 0.2),
    }
}

/// The grid of [`block`].
pub(super) const BLOCK_DIMS: [usize; 3] = [34, 30, 26];

pub(super) fn block(v: [usize; 3]) -> bool {
    (3..31).contains(&v[0]) && (3..27).contains(&v[1]) && (1..18).contains(&v[2])
}

/// A bowl in its top.
pub(super) fn bowl(v: [usize; 3]) -> bool {
    let r2 = (v[0] as f64 - 14.0).powi(2) + (v[1] as f64 - 14.0).powi(2);
    v[2] as f64 >= 11.0 + r2 / 12.0
}

/// A job on that grid, its voxels 1 mm.
pub(super) fn block_job(
    initial: impl Fn([usize; 3]) -> bool + Sync,
    target: impl Fn([usize; 3]) -> bool + Sync,
    wanted: impl Fn(&Tool) -> bool,
) -> Job {
    let frame = Frame { pitch: 1.0, dims: BLOCK_DIMS, origin: DVec3::ZERO };
    let [initial, target] =
        [BitGrid::from_fn(BLOCK_DIMS, initial), BitGrid::from_fn(BLOCK_DIMS, target)];
    job_of(frame, initial, target, wanted)
}

/// Holds steps to every rule that has to do with no program.
pub(super) fn assert_verifies(job: &Job, mut steps: Vec<Step>) {
    let holdings = Setting::new(job).numbered(&mut steps);
    let verdict = verify(job, Plan { holdings, steps }, &Ctx::quiet()).unwrap();
    assert!(verdict.passed(), "{:?}", verdict.rules);
}

/// Asks what a run would on a job, with nothing done yet.
pub(super) fn with_run<R>(job: &Job, ask: impl Fn(&mut Run) -> R) -> R {
    let (setting, coarse, ctx) = (Setting::new(job), Coarse::of(job), Ctx::quiet());
    let (normals, options) = (plane_normals(job, 20), Options::default());
    let preferred = vec![Direction::Z];
    let start = Start { setting: &setting, coarse: &coarse, preferred, bad_bases: Vec::new() };
    ask(&mut Run {
        start: &start,
        normals: &normals,
        options: &options,
        on_supports: None,
        printed_first: None,
        all_kept: None,
        all_opened: None,
        resorted: Vec::new(),
        report: Report::default(),
        clock: Clock::default(),
        ctx: &ctx,
    })
}

/// A slice of the first post, and the voxels beside it.
fn slice(job: &Job, z: std::ops::Range<usize>) -> BitGrid {
    BitGrid::from_fn(job.frame.dims, |v| v[0] == 12 && (2..22).contains(&v[1]) && z.contains(&v[2]))
}

#[test]
fn a_candidate_gives_up_the_pieces_beside_its_element_alone() {
    let job = job();
    let setting = Setting::new(&job);
    let cells = Coarse::cells(&job);
    let scope = Scope::new(&setting, &cells, &job.ideal_reuse());
    let elements = [Element { region: slice(&job, 14..16), must: true }];
    let of = scope.candidates(&elements, &plane_normals(&job, 40));
    let best = &of[0][0];
    assert!(of[0].windows(2).all(|w| w[0].lost_count <= w[1].lost_count));
    // Never the second post, never the plate it stands on.
    assert!(of[0].iter().all(|c| c.seeds.iter_ones().all(|v| v[0] < 20)));
    assert!(best.lost_count <= 8 * 20 * 6, "{}", best.lost_count);
    let clip = Clip { plane: best.plane, seeds: Some(best.seeds.clone()) };
    let kept = volumes(&job, &[clip]).reused;
    assert_eq!(kept.count(), job.ideal_reuse().count() - best.lost_count);
}

#[test]
fn a_plane_that_takes_the_base_contact_is_no_candidate() {
    let job = job();
    let setting = Setting::new(&job);
    let cells = Coarse::cells(&job);
    let scope = Scope::new(&setting, &cells, &job.ideal_reuse());
    let elements = [Element { region: slice(&job, 0..20), must: true }];
    let plane = Plane { normal: Direction::Z, offset: 0.2 };
    assert!(scope.at(&elements, 0, plane).is_none());
}

#[test]
fn what_must_be_cleared_is_cleared_at_the_least_loss() {
    let job = job();
    let setting = Setting::new(&job);
    let cells = Coarse::cells(&job);
    let scope = Scope::new(&setting, &cells, &job.ideal_reuse());
    let nothing = BitGrid::new(job.frame.dims);
    let regions = vec![slice(&job, 16..18), slice(&job, 12..14)];
    let normals = plane_normals(&job, 40);
    let options = Options::default();
    let found = refine(&scope, regions.clone(), &normals, &nothing, &options, &Ctx::quiet());
    let found = found.unwrap().expect("a plane clears them");
    assert!(found.is_valid);
    let lost = found.chosen.iter().fold(nothing.clone(), |all, c| all.or(&c.seeds));
    for region in &regions {
        let beside = region.grown().and(&job.ideal_reuse());
        assert!(beside.and(&lost).count() > 0);
    }
    // The level plane under the lower one clears both.
    assert!(lost.count() <= 8 * 20 * 8, "{}", lost.count());
}

#[test]
fn a_pocket_open_below_counts_beside_other_placements() {
    let job = job();
    let nothing = BitGrid::new(job.frame.dims);
    let excess = slice(&job, 1..2);
    let made = Attempt {
        clips: Vec::new(),
        volumes: volumes(&job, &[]),
        steps: Vec::new(),
        cuts: 0,
        stock: job.initial.clone(),
        excess: excess.clone(),
        deficit: nothing,
        below: excess,
    };
    assert_eq!(made.rank(&job).0, 0, "no plane mends it");
    assert!(made.standing(&job, made.volumes.reused.count()).class > 0);
}

/// With what stands in pockets open only below it broke the rules that it kept without, and went for valid.
#[test]
fn a_pocket_open_below_counts_against_what_the_rules_allow() {
    let mut job = job();
    let few = |from: usize, n: usize| {
        let mut some = BitGrid::new(job.frame.dims);
        job.target.iter_ones().skip(from).take(n).for_each(|v| some.set(v, true));
        some
    };
    let made = |below: usize, missing: usize| Attempt {
        clips: Vec::new(),
        volumes: volumes(&job, &[]),
        steps: Vec::new(),
        cuts: 0,
        stock: job.initial.clone(),
        excess: few(0, below),
        deficit: few(below, missing),
        below: few(0, below),
    };
    let attempts =
        [(10, 10, true), (11, 10, false), (20, 1, false), (21, 20, true), (21, 21, false)];
    let attempts = attempts.map(|(below, missing, valid)| (made(below, missing), valid));
    job.rules.deviation = 20.5 / job.target.count() as f64;
    for (made, valid) in attempts {
        let (below, missing) = (made.below.count(), made.deficit.count());
        // Where it is more than that by itself, only what planes and pits mend is told apart.
        assert_eq!(made.is_valid(&job), valid, "{below} below, {missing} missing");
        assert_eq!(made.may_be_valid(&job), missing <= 20);
    }
}

/// A blade gave up a slice of itself because of twenty voxels in a crease, which the needle nozzle fills.
#[test]
fn crumbs_are_no_reason_to_give_more_up() {
    let job = job();
    let whole = volumes(&job, &[]);
    let missing = |n: usize| {
        let mut deficit = BitGrid::new(job.frame.dims);
        job.target.iter_ones().take(n).for_each(|v| deficit.set(v, true));
        deficit
    };
    let made = |offset: f64, deficit: BitGrid| {
        let clip = Clip::global(Plane { normal: Direction::Z, offset });
        Attempt {
            volumes: volumes(&job, std::slice::from_ref(&clip)),
            clips: vec![clip],
            steps: Vec::new(),
            cuts: 0,
            stock: job.initial.clone(),
            excess: BitGrid::new(job.frame.dims),
            deficit,
            below: BitGrid::new(job.frame.dims),
        }
    };
    let few = job.target.count() / 1000;
    let high = |n: usize| made(100.0, missing(n));
    assert_eq!(high(0).volumes.reused, whole.reused);
    let low = made(18.0, missing(0));
    assert!(comes_first(&high(few), &low, &job));
    assert!(!comes_first(&high(few + 1), &low, &job), "more than crumbs");
    assert!(!comes_first(&high(few), &high(0), &job), "nothing more is kept");
}
