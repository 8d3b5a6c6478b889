//! The depth engine against its definition.

use super::*;
use crate::access::reached_along;
use crate::base::{Ctx, DVec2, DVec3, fibonacci_sphere};
use crate::machine::{Shape, ToolKind};
use crate::mesh::{ReadOptions, read};
use crate::morph::complement;
use crate::voxel::{BitGrid, Frame, voxelise};
use proptest::prelude::*;

fn cutter(radius: f64, length: f64, holder: f64) -> Tool {
    let frustum = |z0, r0, z1, r1| Shape::Frustum { z0, r0, z1, r1 };
    let sections = vec![
        Section { shape: Shape::Ball { radius }, active: true },
        Section { shape: frustum(radius, radius, length, radius), active: true },
        Section { shape: frustum(length, holder, 2.0 * length, holder), active: false },
    ];
    Tool::new("t", ToolKind::Subtractive, sections)
}

/// The definition: is there a lattice tip within the edge's radius that collides with nothing?
fn naive_cut(scene: &Scene, tool: &Tool, d: Direction, x: DVec3) -> bool {
    let plane = d.image_plane();
    let s = spacing(&scene.frame, d);
    let anchor = plane.across(scene.frame.center([0, 0, 0]));
    let uv = (plane.across(x) - anchor) / s;
    let n = (tool.active_radius() / s).ceil() as i64 + 1;
    (-n..=n).any(|j| {
        (-n..=n).any(|i| {
            let tip = anchor + (uv.round() + DVec2::new(i as f64, j as f64)) * s;
            let k = tool.active_lower_surface(tip.distance(plane.across(x)));
            let z = plane.height(x) - k;
            k.is_finite()
                && scene.points().all(|o| {
                    let rho = tip.distance(plane.across(o));
                    plane.height(o) <= z + tool.lower_surface(rho) + 1e-9
                })
        })
    })
}

fn naive_deposit(scene: &Scene, tool: &Tool, d: Direction, dip: f64, x: DVec3) -> bool {
    let plane = d.image_plane();
    scene.points().all(|o| {
        let rho = plane.across(x).distance(plane.across(o));
        tool.sections.iter().all(|sec| {
            let lift = if sec.shape.lower_surface(0.0) == 0.0 { dip } else { 0.0 };
            plane.height(o) <= plane.height(x) + sec.shape.lower_surface(rho) + lift + 1e-9
        })
    })
}

fn world() -> impl Strategy<Value = (BitGrid, f64, f64, f64)> {
    (proptest::collection::vec(0u8..6, 7 * 8 * 6), 1.0f64..2.5, 3.0f64..6.0, 0.0f64..40.0).prop_map(
        |(cells, r, length, holder)| {
            let g = BitGrid::from_fn([7, 8, 6], |[x, y, z]| cells[x + 7 * (y + 8 * z)] == 0);
            (g, r, length.max(r + 0.5), holder.max(r))
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn reachable_is_reachable_by_definition_and_equal_on_axes(
        (state, radius, length, holder) in world(), pick in 0usize..40,
    ) {
        let frame = Frame { pitch: 0.7, dims: state.dims(), origin: DVec3::new(-1.0, 2.0, 0.0) };
        let scene = Scene::new(&frame, &state, &[]);
        let tool = cutter(radius, length, holder);
        let axes = [Direction::X, Direction::NEG_X, Direction::Y, Direction::NEG_Y, Direction::Z];
        let d = axes.get(pick).copied().unwrap_or_else(|| fibonacci_sphere(40)[pick]);
        let all = BitGrid::from_fn(state.dims(), |_| true);
        let cut = cutter_map(&scene, &all, &tool, d);
        let print = nozzle_map(&scene, &all, &tool, d, 0.2);
        // Ties at equal height are decided by a rounding margin: the exact engine is asked
        // again a hair lower and a hair higher.
        let hair = d.vec() * 1e-3;
        let narrow = holder <= WIDEST_CELLS * 0.7;
        for v in all.iter_ones() {
            let x = frame.center(v);
            if cut.reaches(x) {
                prop_assert!(naive_cut(&scene, &tool, d, x), "cut {d:?} {v:?}");
            } else if d.is_grid_axis() && narrow {
                prop_assert!(!naive_cut(&scene, &tool, d, x - hair), "missed {d:?} {v:?}");
            }
            if print.reaches(x) {
                prop_assert!(naive_deposit(&scene, &tool, d, 0.2, x), "print {d:?} {v:?}");
            } else if d.is_grid_axis() && narrow {
                prop_assert!(!naive_deposit(&scene, &tool, d, 0.2, x - hair));
            }
        }
    }
}

/// Every so many voxels of a real part are asked singly.
const SAMPLE: usize = 61;

/// A map of few voxels is drawn on small images, of which wide sections have larger ones, and without
/// the points that stand too low: of these voxels it says what the map of the whole grid says.
#[test]
fn a_map_of_few_voxels_says_what_that_of_the_grid_says() {
    let frame = Frame { pitch: 0.5, dims: [70, 60, 40], origin: DVec3::ZERO };
    let solid = BitGrid::from_fn(frame.dims, |[x, y, z]| {
        (z < 9 || x / 11 % 2 == 0 && y / 13 % 2 == 1 && z < 20 + x / 4) && !(x > 40 && y < 12)
    });
    // None lies midway between two cells: it may be stored in either.
    let below = (0..400).map(|i| {
        let [a, b] = [i % 20, i / 20].map(|t| f64::from(t) * 2.03 - 3.1);
        DVec3::new(a, b, -0.25 - f64::from(i % 7) * 6.0)
    });
    let scene = Scene::new(&frame, &solid, &below.collect::<Vec<_>>());
    let tools = [cutter(1.5, 9.0, 18.0), cutter(1.0, 4.0, 7.0)];
    let mut taken = 0;
    for d in fibonacci_sphere(24).into_iter().chain([Direction::X, Direction::Z]) {
        for corner in [[0, 0, 9], [44, 0, 10], [22, 26, 14], [60, 50, 30]] {
            let few = BitGrid::from_fn(frame.dims, |v| {
                (0..3).all(|a| (corner[a]..corner[a] + 9).contains(&v[a])) && !solid.get(v)
            });
            for (tool, map) in tools.iter().zip(cutter_maps(&scene, &Wanted::of(&few), &tools, d)) {
                let all = reached_along(&scene, &solid, tool, d).and(&few);
                assert_eq!(crate::access::reachable(&map, &few, &frame), all, "{d:?} {corner:?}");
                taken += all.count();
            }
        }
    }
    assert!(taken > 1000, "{taken}");
    // Voxels far apart, most of them under others of their own cell's or beside runs that are
    // computed as one.
    let nozzle = Tool { kind: ToolKind::Additive, ..cutter(1.5, 9.0, 18.0) };
    let mut taken = [0; 2];
    for (i, d) in fibonacci_sphere(24).into_iter().chain([Direction::X, Direction::Z]).enumerate() {
        let few = BitGrid::from_fn(frame.dims, |v @ [x, y, z]| {
            (x * 7919 + y * 104_729 + z * 1299 + i * 31) % 131 == 0 && !solid.get(v)
        });
        for (tool, map) in tools.iter().zip(cutter_maps(&scene, &Wanted::of(&few), &tools, d)) {
            let all = reached_along(&scene, &solid, tool, d).and(&few);
            assert_eq!(crate::access::reachable(&map, &few, &frame), all, "{d:?}");
            taken[0] += all.count();
        }
        let all = reached_along(&scene, &solid, &nozzle, d).and(&few);
        let map = nozzle_map(&scene, &few, &nozzle, d, 0.0);
        assert_eq!(crate::access::reachable(&map, &few, &frame), all, "{d:?}");
        taken[1] += all.count();
    }
    assert!(taken.iter().all(|t| *t > 1000), "{taken:?}");
}

#[test]
fn a_real_part_is_confirmed_at_a_coarse_pitch() {
    use rayon::prelude::*;
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/meshes/ge_bracket.stl");
    let Ok(loaded) = read(std::path::Path::new(path), &ReadOptions { mm_per_unit: 1.0 }) else {
        println!("skipped: {path} is not there");
        return;
    };
    let frame = Frame::around(loaded.mesh.bounds(), 2.0, 1).unwrap();
    let solid = voxelise(&loaded.mesh, &frame, &Ctx::quiet()).unwrap();
    let (scene, air) = (Scene::new(&frame, &solid, &[]), complement(&solid));
    let tool = Tool::builtin("w2v-cutter").unwrap();
    let asked: Vec<[usize; 3]> = air.iter_ones().step_by(SAMPLE).collect();
    let axes = [Direction::Z, Direction::NEG_Y, Direction::X];
    let tilted = fibonacci_sphere(100).into_iter().step_by(29);
    for d in axes.into_iter().chain(tilted) {
        let region = reached_along(&scene, &solid, &tool, d);
        assert!(!region.is_empty() && !region.intersects(&solid));
        let wrong = asked.par_iter().find_first(|v| {
            let x = frame.center(**v);
            let hair = d.vec() * 1e-3;
            if region.get(**v) {
                !naive_cut(&scene, &tool, d, x)
            } else {
                d.is_grid_axis() && naive_cut(&scene, &tool, d, x - hair)
            }
        });
        assert_eq!(wrong, None, "{d:?}");
    }
}
