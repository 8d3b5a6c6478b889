use super::carry::Carry;
use super::cutting::{over_cut, reached};
use super::filling::{open, over_fill, stacked, under_fill};
use super::packed::Packed;
use super::site::{AXES, Site, View, held};
use super::undercut::{least_collateral, under_cut};
use super::world::{Action, Shop};
use super::*;
use crate::access::{self, Overhang, VoxelTool, collateral};
use crate::base::{DVec3, Direction};
use crate::machine::{HoldingMode, Machine, Section, Shape, Tool, ToolKind};
use crate::mesh::TriMesh;
use crate::morph::{Axis, complement};
use crate::plan::{self, Rules};
use crate::search::{Successor, World};
use crate::verify::verify;
use crate::voxel::{BitGrid, Frame};
use proptest::prelude::*;
use std::collections::HashMap;

fn column(z0: f64, z1: f64, r: f64) -> Shape {
    Shape::Frustum { z0, r0: r, z1, r1: r }
}

/// A flat cutter with a holder, mm. Lengths lie between layers: at equal heights the engines differ
/// by a rounding margin.
fn cutter(name: &str, radius: f64, length: f64, holder: f64) -> Tool {
    let sections = vec![
        Section { shape: column(0.0, length, radius), active: true },
        Section { shape: column(length, 60.0, holder), active: false },
    ];
    Tool::new(name, ToolKind::Subtractive, sections)
}

fn nozzle(name: &str, radius: f64, length: f64, head: f64) -> Tool {
    let sections = vec![
        Section { shape: column(0.0, length, radius), active: false },
        Section { shape: column(length, 60.0, head), active: false },
    ];
    Tool::new(name, ToolKind::Additive, sections)
}

fn job(initial: BitGrid, target: BitGrid) -> Job {
    let frame = Frame { pitch: 1.0, dims: target.dims(), origin: DVec3::ZERO };
    let mut rules = Rules::for_pitch(1.0, 0.2);
    rules.holding = HoldingMode::Refixture;
    rules.base = BaseKind::None;
    rules.nozzle_dip_mm = 0.0;
    // On so small a world all would be skin.
    rules.tolerance_mm = 0.0;
    Job {
        frame,
        initial,
        target,
        initial_mesh: TriMesh::default(),
        target_mesh: TriMesh::default(),
        machine: Machine::builtin("generic-5axis").unwrap(),
        cutters: vec![cutter("short", 0.4, 3.5, 2.2), cutter("long", 0.4, 30.5, 2.2)],
        nozzles: vec![nozzle("fine", 0.4, 2.5, 2.2)],
        rules,
    }
}

fn exact() -> Options {
    Options { least_share: 0.0, delta: 0.0, patience: None, ..Options::default() }
}

fn noise(dims: [usize; 3], seed: u64, share: u64) -> BitGrid {
    let mut state = seed | 1;
    let mut cells = vec![false; dims.iter().product()];
    for c in &mut cells {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        *c = (state >> 33) % 10 < share;
    }
    BitGrid::from_fn(dims, |[x, y, z]| cells[x + dims[0] * (y + dims[1] * z)])
}

/// A solid of boxes, connected and standing on the floor.
fn blocky(dims: [usize; 3], seed: u64) -> BitGrid {
    let coarse = noise([3, 3, 3], seed, 5);
    let raw = BitGrid::from_fn(dims, |v| {
        v[2] == 0 || coarse.get(std::array::from_fn(|a| v[a] * 3 / dims[a]))
    });
    let floor = BitGrid::from_fn(dims, |v| v[2] == 0);
    crate::voxel::flood(&raw, &floor, crate::voxel::Connectivity::Edge18)
}

fn sites(job: &Job, state: &BitGrid, each: impl Fn(&View, &Site)) {
    for view in View::all(job) {
        let site = view.site(job, state);
        each(&view, &site);
    }
}

/// A(O, T, K) by the definition on voxels, in turned coordinates.
fn accessible(tool: &Tool, obstacle: &BitGrid) -> BitGrid {
    let voxels = match tool.kind {
        ToolKind::Subtractive => VoxelTool::along(tool, Direction::Z, 1.0),
        ToolKind::Additive => VoxelTool::depositing(tool, Direction::Z, 1.0),
    };
    access::accessible(access::Engine::Naive, obstacle, &voxels.unwrap())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn packed_sets_come_back(x in 1usize..140, seed in any::<u64>(), share in 0u64..11) {
        let grid = noise([x, 3, 4], seed, share);
        let packed = Packed::of(&grid);
        prop_assert_eq!(packed.grid(), grid.clone());
        let mut other = grid;
        other.set([x - 1, 2, 3], !other.get([x - 1, 2, 3]));
        prop_assert!(Packed::of(&other).key() != packed.key());
    }

    /// Eq. 26: P_o = P_i − A(P_o), of what the action may remove; and P_o is the least such state.
    #[test]
    fn an_over_cut_is_what_is_reached_in_its_output(a in any::<u64>(), b in any::<u64>()) {
        let dims = [9, 8, 7];
        let (state, target) = (blocky(dims, a), blocky(dims, b));
        let job = job(state.clone(), target);
        sites(&job, &state, |view, site| {
            let excess = site.state.minus(&view.target);
            for tool in &job.cutters {
                let cut = over_cut(site, &excess, tool);
                let after = site.state.minus(&cut.region);
                assert!(site.state.and(&view.target).is_subset_of(&after));
                // Flat tools on whole voxels: heights and voxels agree.
                let free = accessible(tool, &after);
                assert_eq!(site.state.minus(&free.and(&excess)), after, "{:?}", view.direction);
                let hidden = excess.minus(&accessible(tool, &site.state.and(&view.target)));
                assert_eq!(cut.hidden, hidden);
            }
        });
    }

    /// Eq. 29: nothing is left to sacrifice, the output is part of P, all that goes is reached, and
    /// no less goes than the bound says.
    #[test]
    fn an_under_cut_removes_all_and_leaves_what_it_reaches(a in any::<u64>(), b in any::<u64>()) {
        let dims = [9, 8, 7];
        let (state, target) = (blocky(dims, a), blocky(dims, b));
        let job = job(state.clone(), target);
        sites(&job, &state, |view, site| {
            for tool in &job.cutters {
                let keep = site.state.and(&view.target);
                let excess = site.state.minus(&view.target);
                let hidden = over_cut(site, &excess, tool).hidden;
                let Some(left) = under_cut(&job, site, tool, &Ctx::quiet()).unwrap() else { continue };
                assert!(left.is_subset_of(&keep));
                let gone = site.state.minus(&left);
                assert!(gone.is_subset_of(&accessible(tool, &left)));
                assert_eq!(reached(site, &left, &gone, tool), gone);
                let sacrificed = keep.count() - left.count();
                if !hidden.is_empty() {
                    assert!(sacrificed >= least_collateral(site, &hidden, tool));
                }
                let stable = view.down(&left);
                assert_eq!(held(&job, &stable), stable);
            }
        });
    }

    /// Eqs. 31, 34, 36 as they are written, with columns.
    #[test]
    fn fills_are_those_of_the_equations(
        a in any::<u64>(), b in any::<u64>(), empty in any::<bool>(),
    ) {
        let dims = [9, 8, 7];
        let target = blocky(dims, b);
        let state = if empty { BitGrid::new(dims) } else { blocky(dims, a) };
        let job = job(state.clone(), target);
        sites(&job, &state, |view, site| {
            let up = Axis::of(Direction::Z).unwrap();
            let tool = &job.nozzles[0];
            let air = complement(&site.state);
            let access = accessible(tool, &site.state).and(&air);
            let found = open(site, tool, 0.0);
            // What a nozzle reaches has nothing over it.
            assert_eq!(found, access);
            let (u, v) = (access::self_supported, access::supporting);
            let none = Overhang::NONE;
            // The plate lies below the grid where nothing may stand on it: one more layer of air.
            let lift = |g: &BitGrid| {
                let [x, y, z] = g.dims();
                BitGrid::from_fn([x, y, z + 1], |[x, y, z]| z > 0 && g.get([x, y, z - 1]))
            };
            let drop = |g: &BitGrid| {
                BitGrid::from_fn(site.state.dims(), |[x, y, z]| g.get([x, y, z + 1]))
            };
            let plate = usize::from(view.plate.is_some());
            let held = v(&lift(&site.state), up, plate, none);
            let star = access::supported_access(
                &lift(&site.state), &lift(&access), up, plate, none);
            let target = lift(&view.target);
            let under = u(&star.and(&target).or(&held), up, plate, none).minus(&held);
            let over = v(&star.and(&target).or(&held), up, plate, none).minus(&held);
            assert_eq!(drop(&star), stacked(site, &found, &Carry::column()), "A*");
            assert_eq!(drop(&under), under_fill(site, &found, &Carry::column()), "UF");
            assert_eq!(drop(&over), over_fill(site, &found, &Carry::column()), "OF");
        });
    }

    /// With overhangs: more than columns, within A, all carried, and OF holds what UF does.
    #[test]
    fn fills_that_lean_are_carried(
        a in any::<u64>(), b in any::<u64>(), empty in any::<bool>(), lean in 45.0f64..60.0,
    ) {
        let dims = [12, 11, 9];
        let target = noise(dims, b, 4);
        let state = if empty { BitGrid::new(dims) } else { blocky(dims, a) };
        let job = job(state.clone(), target);
        sites(&job, &state, |view, site| {
            let open = open(site, &job.nozzles[0], 0.0);
            let carry = Carry::within(lean);
            let star = stacked(site, &open, &carry);
            let under = under_fill(site, &open, &carry);
            let over = over_fill(site, &open, &carry);
            assert!(under_fill(site, &open, &Carry::column()).is_subset_of(&under));
            assert!(under.is_subset_of(&over) && over.is_subset_of(&star));
            assert!(star.and(&view.target).is_subset_of(&over));
            for fill in [&under, &over] {
                assert_eq!(&stacked(site, fill, &carry), fill, "{:?}", view.direction);
            }
        });
    }
}

/// A shelf over the floor and a lidded pit: what stands under the shelf is cut again, what would stand
/// in the pit is not.
#[test]
fn supports_that_can_be_cleared_are_cut_again() {
    let dims = [24, 12, 14];
    let target = BitGrid::from_fn(dims, |[x, y, z]| {
        let pit = (3..8).contains(&x) && (3..9).contains(&y) && (3..9).contains(&z);
        x < 11 && !pit || !(2..10).contains(&z)
    });
    let mut job = job(BitGrid::new(dims), target.clone());
    job.cutters.remove(0);
    let ctx = Ctx::quiet();
    let shop = Shop::new(&job, &Options { overhang_deg: 0.0, ..exact() }, &ctx);
    let fill = |clearable| {
        let action = Action { action: plan::Action::OF, tool: 0, axis: 0, clearable };
        shop.apply(&job.initial, action).unwrap().unwrap()
    };
    let (all, clear) = (fill(false), fill(true));
    assert!(target.is_subset_of(&all) && clear.is_subset_of(&all));
    // The lid of the pit is missing, and nothing else.
    let lid = |[x, y, z]: [usize; 3]| (3..8).contains(&x) && (3..9).contains(&y) && z >= 9;
    assert_eq!(target.minus(&clear), BitGrid::from_fn(dims, lid));
    let cut = Action { action: plan::Action::OC, tool: 0, axis: 1, clearable: false };
    assert_eq!(clear.minus(&shop.apply(&clear, cut).unwrap().unwrap()), target.and(&clear));
}

/// A slit under a shelf: the greedy cover shares its contacts.
#[test]
fn contacts_that_are_shared_cost_no_more_than_each_point_its_own() {
    let dims = [16, 12, 12];
    let target = BitGrid::from_fn(dims, |[x, _, z]| !(3..=7).contains(&z) || x < 3);
    let state = BitGrid::from_fn(dims, |_| true);
    let job = job(state.clone(), target.clone());
    let view = &View::all(&job)[0];
    let site = view.site(&job, &state);
    let tool = &job.cutters[1];
    let left = under_cut(&job, &site, tool, &Ctx::quiet()).unwrap().unwrap();
    let sacrificed = target.count() - left.count();
    let voxels = VoxelTool::along(tool, Direction::Z, 1.0).unwrap();
    let hidden = over_cut(&site, &state.minus(&target), tool).hidden;
    let own = collateral(&target, &hidden, &voxels, &Ctx::quiet()).unwrap().region.count();
    assert!(sacrificed > 0 && own > 0);
    assert!(sacrificed <= own, "{sacrificed} for {own}");
}

/// The least cost to go from a state in so many steps, by trying every plan; what follows from a
/// state is remembered by it.
#[derive(Default)]
struct Trials {
    ways: HashMap<u128, Vec<(f64, super::world::State)>>,
    to_go: HashMap<(u128, usize), Option<f64>>,
}

impl Trials {
    fn cheapest(&mut self, shop: &Shop, state: &super::world::State, depth: usize) -> Option<f64> {
        if shop.is_goal(state) {
            return Some(shop.remaining(state));
        }
        if depth == 0 {
            return None;
        }
        let key = shop.key(state);
        if let Some(known) = self.to_go.get(&(key, depth)) {
            return *known;
        }
        let ways = self.ways.entry(key).or_insert_with(|| all_ways(shop, state)).clone();
        let mut best: Option<f64> = None;
        for (cost, next) in &ways {
            if let Some(found) = self.cheapest(shop, next, depth - 1) {
                best = Some(best.map_or(cost + found, |b| b.min(cost + found)));
            }
        }
        self.to_go.insert((key, depth), best);
        best
    }
}

fn all_ways(shop: &Shop, state: &super::world::State) -> Vec<(f64, super::world::State)> {
    let made = |way| match way {
        Successor::Made(m) => Some((m.cost, m.state)),
        Successor::Promised { action, cost_at_least, remaining_at_least } => {
            let (cost, next) = shop.make(state, &action).unwrap()?;
            assert!(cost_at_least <= cost && remaining_at_least <= shop.remaining(&next));
            Some((cost, next))
        }
    };
    shop.successors(state).unwrap().into_iter().filter_map(made).collect()
}

fn equals_trying_all(
    dims: [usize; 3],
    seeds: std::ops::Range<u64>,
    depth: usize,
    tools: usize,
    skin: f64,
) {
    let mut goals = 0;
    for seed in seeds {
        let target = blocky(dims, seed);
        let initial = match seed % 3 {
            0 => BitGrid::new(dims),
            1 => BitGrid::from_fn(dims, |_| true),
            _ => blocky(dims, seed + 100),
        };
        let mut job = job(initial, target);
        job.cutters.truncate(tools);
        job.rules.tolerance_mm = skin;
        let options =
            Options { weight: 0.0, most_steps: depth, delta: 0.05, tight_bound: true, ..exact() };
        let ctx = Ctx::quiet();
        let (plan, report) = super::plan(&job, &options, &ctx).unwrap();
        assert!(plan.steps.len() <= depth);
        let shop = Shop::new(&job, &options, &ctx);
        let start = shop.start();
        let all = Trials::default().cheapest(&shop, &start, depth);
        assert_eq!(report.goal, all.is_some(), "seed {seed}");
        if let Some(all) = all {
            goals += 1;
            assert!((report.cost - all).abs() < 1e-6 * all.max(1.0), "seed {seed}");
            assert!(report.bound <= all + 1e-9, "seed {seed}: {} above {all}", report.bound);
            let verdict = verify(
                &Job { rules: Rules { deviation: 0.05, ..job.rules }, ..job.clone() },
                plan,
                &ctx,
            );
            let verdict = verdict.unwrap();
            assert!(verdict.passed(), "seed {seed}: {:?}", verdict.failed_rules());
        }
    }
    assert!(goals > 0);
}

#[test]
fn without_weight_the_cost_is_that_of_trying_every_plan_of_a_slab() {
    equals_trying_all([8, 3, 8], 0..9, 4, 1, 0.0);
}

#[test]
fn without_weight_the_cost_is_that_of_trying_every_plan_of_a_cube() {
    equals_trying_all([8, 8, 8], 0..6, 3, 2, 0.0);
}

#[test]
fn with_skin_it_is_so_as_well() {
    equals_trying_all([8, 3, 8], 0..9, 4, 1, 1.0);
    equals_trying_all([8, 8, 8], 0..6, 3, 1, 1.0);
}

/// Stock all round within the surface tolerance is no residual, but it is there to be cut; and what is
/// worn off to be filled.
#[test]
fn skin_that_can_be_reached_is_cut_and_filled() {
    let dims = [12, 11, 10];
    let inner = |v: [usize; 3], by: usize| {
        (0..2).all(|a| (2 - by..dims[a] - 2 + by).contains(&v[a])) && v[2] < dims[2] - 3 + by
    };
    let (small, large) =
        (BitGrid::from_fn(dims, |v| inner(v, 0)), BitGrid::from_fn(dims, |v| inner(v, 1)));
    for (initial, target, kind) in
        [(large.clone(), small.clone(), StepKind::Subtractive), (small, large, StepKind::Additive)]
    {
        let mut job = job(initial, target);
        job.rules.tolerance_mm = 1.5;
        job.cutters.remove(0);
        let (plan, report) = super::plan(&job, &exact(), &Ctx::quiet()).unwrap();
        assert!(report.goal && !plan.steps.is_empty());
        assert!(plan.steps.iter().all(|s| s.kind == kind));
        let moved: usize = plan.steps.iter().map(|s| s.region.count()).sum();
        let off = job.initial.count().abs_diff(job.target.count());
        // At the foot a few voxels have nothing to lean on.
        assert!(moved <= off && moved * 100 >= off * 98, "{kind:?}: {moved} of {off}");
        assert!((report.cost - report.bound).abs() < 1e-9);
    }
}

/// What keeps a plan from being complete is taken though it is less than a step's least share: a tab
/// that only its own side reaches.
#[test]
fn the_little_that_is_left_of_a_goal_is_taken_as_well() {
    let dims = [12, 10, 12];
    let body = |v: [usize; 3]| v[0] < 10;
    let target = BitGrid::from_fn(dims, |v| body(v) && v[2] < 10);
    let tab = |v: [usize; 3]| v == [10, 5, 4];
    let job = job(BitGrid::from_fn(dims, |v| body(v) || tab(v)), target);
    let options = Options { delta: 0.01, ..Options::default() };
    let options = Options { least_share: 0.01, ..options };
    let (plan, report) = super::plan(&job, &options, &Ctx::quiet()).unwrap();
    assert!(report.goal && report.left_mm3 == 0.0, "{} mm³", report.left_mm3);
    let moved: Vec<usize> = plan.steps.iter().map(|s| s.region.count()).collect();
    assert_eq!(moved.iter().sum::<usize>(), 10 * 10 * 2 + 1);
}

/// A cutter a hundred times as wide as the part touches it in more places than can be tried: its bound
/// looks at fewer cells, and bounds from below all the same.
#[test]
fn the_bound_of_a_cutter_larger_than_the_part_is_found_and_a_bound() {
    let dims = [6, 6, 8];
    let pocket = |v: [usize; 3]| v[0] > 1 && (2..4).contains(&v[2]);
    let target = BitGrid::from_fn(dims, |v| !pocket(v));
    let job = job(BitGrid::from_fn(dims, |_| true), target);
    let tool = cutter("wide", 200.5, 300.5, 400.0);
    let view = View::all(&job).into_iter().find(|v| v.direction == Direction::Z).unwrap();
    let site = view.site(&job, &job.initial);
    let least = least_collateral(&site, &BitGrid::from_fn(dims, pocket), &tool);
    // Of every hidden column what the best contact meets over it, by definition: four voxels a column
    // under the disc, two more where there is no pocket.
    let met = |[x, y]: [i64; 2]| {
        let columns = (0..36).map(|c| [c % 6, c / 6]);
        let under = columns.filter(|[i, j]| {
            DVec3::new((i - x) as f64, (j - y) as f64, 0.0).length() <= tool.active_radius()
        });
        under.map(|[i, _]| if i > 1 { 4 } else { 6 }).sum::<usize>()
    };
    let around = || (-200..=200).flat_map(|j| (-200..=200).map(move |i| [i, j]));
    let touching = |[i, j]: &[i64; 2]| ((i * i + j * j) as f64).sqrt() <= tool.active_radius();
    let best = |x: i64, y: i64| around().filter(touching).map(|[i, j]| met([x + i, y + j])).min();
    let want =
        (2..6).flat_map(|x| (0..6).map(move |y| (x, y))).filter_map(|(x, y)| best(x, y)).max();
    assert!(least <= want.unwrap(), "{least} of {want:?}");
}

/// What holds the part stands in the way of a contact as often as each of its points says, though
/// only the highest of each place are kept.
#[test]
fn the_highest_fixed_points_stand_for_all() {
    let tool = cutter("c", 1.4, 6.5, 3.2);
    let foot = super::undercut::Footprint::new(&tool, 1.0, [20, 20, 20]);
    let points: Vec<DVec3> = (0..400u64)
        .map(|i| {
            let of = |k: u64, n: u64| (i.wrapping_mul(k) >> 3) % n;
            DVec3::new(of(2654435761, 9) as f64, of(40503, 9) as f64, of(97, 14) as f64)
        })
        .collect();
    let all = super::undercut::Fixed::of(&points);
    let mut met = 0;
    for (x, y, tip) in (-3..12).flat_map(|x| (-3..12).map(move |y| (x, y, (x * y) as f64 / 9.0))) {
        let clear = |f: &super::undercut::Fixed| f.is_clear_of([x, y], tip, &foot, 1.0);
        let each = points.iter().all(|p| clear(&super::undercut::Fixed::of(&[*p])));
        assert_eq!(clear(&all), each, "{x} {y} {tip}");
        met += usize::from(!each);
    }
    assert!(met > 20 && met < 220, "{met} of 225");
}

/// A box closed on all sides: whoever empties it cuts through its lid.
#[test]
fn a_closed_box_costs_its_lid() {
    let dims = [9, 9, 9];
    let inner = |v: [usize; 3]| v.iter().all(|c| (3..6).contains(c));
    let target = BitGrid::from_fn(dims, |v| !inner(v));
    let job = job(BitGrid::from_fn(dims, |_| true), target);
    let options = Options { tight_bound: true, ..exact() };
    let ctx = Ctx::quiet();
    let shop = Shop::new(&job, &options, &ctx);
    assert_eq!(super::sacrifice::least_sacrifice(&shop, &job.initial, 0), 3);
    assert_eq!(super::sacrifice::least_sacrifice(&shop, &job.initial, 26), 3);
    assert_eq!(super::sacrifice::least_sacrifice(&shop, &job.initial, 27), 0);
    let (_, report) = super::plan(&job, &Options { most_steps: 1, ..options }, &ctx).unwrap();
    assert!((report.bound - (0.1 * 27.0 + 1.1 * 3.0)).abs() < 1e-9, "{}", report.bound);
}

#[test]
fn every_action_of_a_state_verifies() {
    let dims = [10, 9, 8];
    for (seed, mode) in
        (0..8).map(|s| (s, if s % 2 == 0 { HoldingMode::Base } else { HoldingMode::Refixture }))
    {
        for base in [BaseKind::None, BaseKind::Pedestal] {
            let (initial, target) = (blocky(dims, seed), blocky(dims, seed + 50));
            let mut job = job(initial, target);
            (job.rules.holding, job.rules.base) = (mode, base);
            job.rules.nozzle_dip_mm = 0.2;
            let ctx = Ctx::quiet();
            let shop = Shop::new(&job, &exact(), &ctx);
            let mut tried = 0;
            for axis in 0..AXES.len() {
                use plan::Action::{OC, OF, UC, UF};
                for (action, tool, clearable) in [
                    (OC, 0, false),
                    (OC, 1, false),
                    (UC, 0, false),
                    (UC, 1, false),
                    (UF, 0, false),
                    (OF, 0, false),
                    (OF, 0, true),
                ] {
                    let plan =
                        super::steps(&shop, &[Action { action, tool, axis, clearable }]).unwrap();
                    if plan.steps.is_empty() {
                        continue;
                    }
                    tried += 1;
                    let verdict = verify(&job, plan, &ctx).unwrap();
                    let failed: Vec<_> = verdict
                        .failed_rules()
                        .into_iter()
                        .filter(|r| *r != "end" && *r != "machine")
                        .collect();
                    assert!(
                        failed.is_empty(),
                        "{action:?} {axis} {mode:?} {base:?}: {:?}",
                        verdict.rules
                    );
                }
            }
            assert!(tried > 0);
        }
    }
}

#[test]
fn an_unreachable_target_gives_the_nearest_plan_and_says_so() {
    // A closed box in the middle of a block: no tool comes there.
    let dims = [9, 9, 9];
    let inner = |v: [usize; 3]| v.iter().all(|c| (3..6).contains(c));
    let target = BitGrid::from_fn(dims, |v| !inner(v));
    let full = BitGrid::from_fn(dims, |_| true);
    let mut job = job(full, target);
    job.nozzles.clear();
    let options = Options { most_steps: 3, ..exact() };
    let (plan, report) = super::plan(&job, &options, &Ctx::quiet()).unwrap();
    assert!(plan.steps.is_empty() && !report.goal);
    assert!(report.notes.iter().any(|n| n.contains("nearer")), "{:?}", report.notes);
    assert_eq!(report.trace.lines().next().unwrap().split('\t').count(), 10);
}

/// A tool no axis of which it is round about: an L, turned all 24 ways.
#[test]
fn tools_of_any_shape_cut_what_the_equations_say() {
    let dims = [9, 8, 7];
    let ctx = Ctx::quiet();
    let passive: Vec<[i64; 3]> = (2..7).map(|z| [0, 0, z]).chain([[1, 0, 6], [2, 0, 6]]).collect();
    let active = [[0, 0, 0], [0, 0, 1]];
    for (seed, turn) in crate::morph::cardinal_rotations().iter().enumerate() {
        let (state, target) = (blocky(dims, seed as u64), blocky(dims, seed as u64 + 40));
        let body = crate::morph::Element::from_offsets(&[&passive[..], &active[..]].concat());
        let edge = crate::morph::Element::from_offsets(&active);
        let tool = VoxelTool::of_elements(
            crate::morph::turned(&body, turn),
            crate::morph::turned(&edge, turn),
            None,
        );
        let naive = |o: &BitGrid| access::accessible(access::Engine::Naive, o, &tool);
        let region = over_cut_by(&tool, &state, &target, &ctx).unwrap();
        let after = state.minus(&region);
        let excess = state.minus(&target);
        assert_eq!(state.minus(&naive(&after).and(&excess)), after, "{turn:?}");
        if let Some(left) = under_cut_by(&tool, &state, &target, &ctx).unwrap() {
            assert!(left.is_subset_of(&target));
            assert!(state.minus(&left).is_subset_of(&naive(&left)), "{turn:?}");
        }
    }
}

/// The depth engine and voxels agree on tools that both take.
#[test]
fn cuts_by_columns_are_those_by_voxels() {
    let dims = [9, 8, 7];
    for seed in 0..6 {
        let (state, target) = (blocky(dims, seed), blocky(dims, seed + 70));
        let job = job(state.clone(), target.clone());
        sites(&job, &state, |view, site| {
            for tool in &job.cutters {
                let voxels = VoxelTool::along(tool, view.direction, 1.0).unwrap();
                let own = over_cut(site, &site.state.minus(&view.target), tool).region;
                let by = over_cut_by(&voxels, &state, &target, &Ctx::quiet()).unwrap();
                assert_eq!(view.down(&own), by, "{:?}", view.direction);
            }
        });
    }
}
