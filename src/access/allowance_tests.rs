//! What the depth engine may and may not do along directions that are no grid axes.

use super::*;
use crate::base::{Ctx, DVec2, DVec3, Direction, fibonacci_sphere, tolerance};
use crate::machine::{Section, Shape, Tool, ToolKind};
use crate::morph::complement;
use crate::voxel::{BitGrid, Frame, distance_within, voxelise};
use rayon::prelude::*;

fn cutter() -> Tool {
    Tool::builtin("w2v-cutter").unwrap()
}

/// What any of `n` directions reaches.
fn reached_from(n: usize, frame: &Frame, solid: &BitGrid, tool: &Tool) -> BitGrid {
    let tool = AnyTool::Round(tool.clone());
    survey(frame, solid, &tool, &fibonacci_sphere(n), &[], &Ctx::quiet()).unwrap().accessible
}

#[test]
fn a_closed_box_with_thin_walls_is_never_entered() {
    // Walls of 1 mm, two voxels.
    let frame = Frame { pitch: 0.5, dims: [44, 40, 36], origin: DVec3::ZERO };
    let wall = |c: usize, n: usize| (2..4).contains(&c) || (n - 4..n - 2).contains(&c);
    let hull = |c: usize, n: usize| (2..n - 2).contains(&c);
    let [a, b, c] = frame.dims;
    let solid = BitGrid::from_fn(frame.dims, |[x, y, z]| {
        hull(x, a) && hull(y, b) && hull(z, c) && (wall(x, a) || wall(y, b) || wall(z, c))
    });
    let inside = BitGrid::from_fn(frame.dims, |[x, y, z]| {
        (4..a - 4).contains(&x) && (4..b - 4).contains(&y) && (4..c - 4).contains(&z)
    });
    let reached = reached_from(100, &frame, &solid, &cutter());
    assert!(!reached.intersects(&inside) && !reached.is_empty());
}

#[test]
fn a_slot_narrower_than_the_cutter_is_never_passed() {
    // A plate of 6 mm with a slot of 2.5 mm through it; the cutter has 3 mm.
    let frame = Frame { pitch: 0.5, dims: [50, 44, 34], origin: DVec3::ZERO };
    let solid =
        BitGrid::from_fn(frame.dims, |[x, _, z]| (10..22).contains(&z) && !(22..27).contains(&x));
    let slot = BitGrid::from_fn(frame.dims, |[x, y, z]| {
        (12..20).contains(&z) && (22..27).contains(&x) && (4..40).contains(&y)
    });
    // All directions but those within the slot's plane, which enter it from its open ends.
    let tool = cutter();
    let scene = Scene::new(&frame, &solid, &[]);
    for d in fibonacci_sphere(100).into_iter().filter(|d| d.vec().y.abs() < 0.8) {
        assert!(!reached_along(&scene, &solid, &tool, d).intersects(&slot), "{d:?}");
    }
}

#[test]
fn the_inside_of_a_fillet_counts_as_skin() {
    // A groove along y with flanks and a bottom rounded by the ball's own radius, 4 mm wide.
    let frame = Frame { pitch: 0.5, dims: [40, 24, 24], origin: DVec3::ZERO };
    let solid = BitGrid::from_fn(frame.dims, |v| {
        let p = frame.center(v);
        let in_groove = (p.x - 10.0).abs() < 2.0 && p.z > 5.5;
        let (over, r) = ((p.x - 10.0).abs() - 0.5, 1.5);
        let fillet = over > 0.0 && p.z < 7.0 && over.hypot(7.0 - p.z) > r;
        p.z < 11.0 && (!in_groove || fillet)
    });
    let scene = Scene::new(&frame, &solid, &[]);
    let reached = reached_along(&scene, &solid, &cutter(), Direction::Z);
    let skin = distance_within(&solid, tolerance::surface_mm(frame.pitch) / frame.pitch);
    let missed = complement(&solid).minus(&reached);
    assert!(missed.is_subset_of(&skin), "{} voxels deep", missed.minus(&skin).count());
    // Tilted in the groove's plane, rounding loses no more than a voxel on top.
    let d = Direction::new(DVec3::new(0.0, 0.2, 1.0)).unwrap();
    let missed = complement(&solid).minus(&reached_along(&scene, &solid, &cutter(), d));
    let inner = BitGrid::from_fn(frame.dims, |[x, y, z]| {
        (17..23).contains(&x) && (8..16).contains(&y) && z > 14
    });
    assert!(!missed.intersects(&inner));
}

/// Whether the edge touches `x` from a tip of a lattice of spacing `step` about the frame's anchor,
/// the body grown and the edge shrunk by `by` mm aside.
fn by_definition(
    scene: &Scene,
    tool: &Tool,
    direction: Direction,
    x: DVec3,
    step: f64,
    by: f64,
) -> bool {
    let plane = direction.image_plane();
    let anchor = plane.across(scene.frame.center([0, 0, 0]));
    let n = (tool.active_radius() / step).ceil() as i64 + 1;
    let near = ((plane.across(x) - anchor) / step).round();
    (-n..=n).any(|j| {
        (-n..=n).any(|i| {
            let tip = anchor + (near + DVec2::new(i as f64, j as f64)) * step;
            let k = tool.active_lower_surface(tip.distance(plane.across(x)) + by);
            let z = plane.height(x) - k;
            k.is_finite()
                && scene.points().all(|o| {
                    let rho = (tip.distance(plane.across(o)) - by).max(0.0);
                    plane.height(o) <= z + tool.lower_surface(rho) + 1e-9
                })
        })
    })
}

/// Off the axes points and tips are each rounded by up to s/√2 aside, s = h/2. So what a finely
/// sampled tip reaches with a tool that is wider by 2 · s/√2 = h/√2, and an edge narrower by as
/// much, the engine reaches; and what the engine reaches is reached.
#[test]
fn the_engine_keeps_within_its_bound_and_on_the_safe_side() {
    let frustum = |z0, r0, z1, r1| Shape::Frustum { z0, r0, z1, r1 };
    let section = |shape, active| Section { shape, active };
    let tool = Tool::new(
        "stub",
        ToolKind::Subtractive,
        vec![
            section(Shape::Ball { radius: 2.0 }, true),
            section(frustum(2.0, 2.0, 4.0, 2.0), true),
            section(frustum(4.0, 4.0, 9.0, 4.0), false),
        ],
    );
    let frame = Frame { pitch: 1.0, dims: [9, 8, 7], origin: DVec3::new(0.3, -1.0, 0.0) };
    let (s, bound) = (frame.pitch / 2.0, frame.pitch / 2f64.sqrt());
    let directions = fibonacci_sphere(14);
    let counts: Vec<(usize, usize)> = directions
        .par_iter()
        .enumerate()
        .map(|(i, d)| {
            let solid = BitGrid::from_fn(frame.dims, |[x, y, z]| {
                (x * 7 + y * 5 + z * 11 + i) % 37 == 0 || z == 0 && x < 4
            });
            let scene = Scene::new(&frame, &solid, &[]);
            let reached = reached_along(&scene, &solid, &tool, *d);
            let mut sure = 0;
            for v in complement(&solid).iter_ones() {
                let x = frame.center(v);
                // A hair off in height hides the rounding of heights to 32 bits.
                let hair = d.vec() * 1e-3;
                if by_definition(&scene, &tool, *d, x - hair, s / 2.0, bound + 1e-6) {
                    sure += 1;
                    assert!(reached.get(v), "missed {d:?} {v:?}");
                }
                if reached.get(v) {
                    assert!(by_definition(&scene, &tool, *d, x, s, 0.0), "unsafe {d:?} {v:?}");
                }
            }
            (sure, reached.count())
        })
        .collect();
    let (sure, reached) = counts.iter().fold((0, 0), |(a, b), (c, d)| (a + c, b + d));
    assert!(sure * 3 > reached && reached > 1000, "the bound says something: {sure} {reached}");
}

#[test]
fn the_definition_confirms_what_is_reached_of_a_part() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/bearing_initial.obj");
    let options = crate::mesh::ReadOptions { mm_per_unit: 1.0 };
    let mesh = crate::mesh::read(path.as_ref(), &options).unwrap().mesh;
    let pitch = mesh.bounds().size().max_element() / 12.0;
    let frame = Frame::around(mesh.bounds(), pitch, 1).unwrap();
    let solid = voxelise(&mesh, &frame, &Ctx::quiet()).unwrap();
    let scene = Scene::new(&frame, &solid, &[]);
    fibonacci_sphere(10).par_iter().for_each(|d| {
        let reached = reached_along(&scene, &solid, &cutter(), *d);
        for v in reached.iter_ones() {
            let x = frame.center(v);
            assert!(by_definition(&scene, &cutter(), *d, x, pitch / 2.0, 0.0), "{d:?} {v:?}");
        }
    });
}
