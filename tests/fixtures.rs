//! The shipped pairs are what the generator makes, closed, oriented and of known volume.

#[path = "fixtures/parts.rs"]
mod parts;
#[path = "fixtures/plane.rs"]
mod plane;
#[path = "fixtures/prisms.rs"]
mod prisms;
#[path = "fixtures/shipped.rs"]
mod shipped;
#[path = "fixtures/tools.rs"]
mod tools;

use hmplan::machine::Tool;
use hmplan::mesh::TriMesh;
use parts::Pair;
use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::PI;

const MEND: &str = "run `cargo run --example make-fixtures`";

fn meshes(pair: &Pair) -> [TriMesh; 2] {
    [pair.complex.mesh(&pair.initial), pair.complex.mesh(&pair.target)]
}

#[test]
fn the_generator_makes_the_shipped_bytes() {
    let mut made = BTreeSet::new();
    for (name, text) in parts::pairs().iter().flat_map(shipped::files).chain(shipped::tools()) {
        let shipped = std::fs::read_to_string(shipped::folder().join(&name))
            .unwrap_or_else(|e| panic!("fixtures/{name}: {e}; {MEND}"));
        assert!(shipped == text, "fixtures/{name} differs from what the generator makes; {MEND}");
        made.insert(name);
    }
    let entries = std::fs::read_dir(shipped::folder()).expect("the fixtures folder is there");
    for name in entries.map(|e| e.unwrap().file_name().into_string().unwrap()) {
        assert!(
            !name.ends_with(".obj") || made.contains(&name),
            "fixtures/{name} is not made by the generator; remove it or add it there"
        );
    }
}

#[test]
fn the_readme_shows_the_known_volumes() {
    let readme = std::fs::read_to_string(shipped::folder().join("README.md")).unwrap();
    let table = shipped::volume_table(&parts::pairs());
    assert!(readme.contains(&table), "fixtures/README.md should hold this table:\n{table}");
}

/// Every edge has two triangles, once in each direction, and the triangles around every vertex
/// are one fan: a closed surface that touches itself nowhere.
fn assert_closed_surface(name: &str, mesh: &TriMesh) {
    let mut next_around: Vec<BTreeMap<u32, u32>> = vec![BTreeMap::new(); mesh.vertices().len()];
    for &[a, b, c] in mesh.triangles() {
        for (at, from, to) in [(a, b, c), (b, c, a), (c, a, b)] {
            let twice = next_around[at as usize].insert(from, to);
            assert_eq!(twice, None, "{name}: edge {at}–{from} is used twice one way");
        }
    }
    for (vertex, next) in next_around.iter().enumerate() {
        let start = *next.keys().next().expect("no vertex is without triangles");
        let (mut at, mut steps) = (start, 0);
        loop {
            at = *next.get(&at).unwrap_or_else(|| panic!("{name}: edge {vertex}–{at} is open"));
            steps += 1;
            if at == start {
                break;
            }
        }
        assert_eq!(steps, next.len(), "{name}: surfaces touch at vertex {vertex}");
    }
}

#[test]
fn every_mesh_is_a_closed_surface_on_the_base_plane() {
    for pair in parts::pairs() {
        for mesh in meshes(&pair) {
            assert_closed_surface(pair.name, &mesh);
            let flat = (0..mesh.triangles().len()).find(|&t| mesh.area_normal(t).length() < 1e-9);
            assert_eq!(flat, None, "{}: a triangle without area", pair.name);
            let (bounds, size) = (mesh.bounds(), mesh.bounds().size());
            assert_eq!(bounds.min.z, 0.0, "{}", pair.name);
            assert!(size.max_element() <= 63.0 && size.min_element() >= 5.0, "{}", pair.name);
            assert!((100..5000).contains(&mesh.triangles().len()), "{}", pair.name);
        }
    }
}

#[test]
fn signed_volumes_are_the_sums_over_the_prisms() {
    for pair in parts::pairs() {
        let [initial, target] = meshes(&pair).map(|m| m.signed_volume());
        let known = shipped::KnownVolumes::of(&pair);
        for (got, known) in [(initial, known.initial), (target, known.target)] {
            assert!((got - known).abs() < 1e-10 * known, "{}: {got} for {known}", pair.name);
        }
        assert!((known.common + known.removed - known.initial).abs() < 1e-9 * known.initial);
        assert!((known.common + known.added - known.target).abs() < 1e-9 * known.target);
    }
}

/// Area of a regular polygon over the square of the radius of its corners.
fn polygon_factor(sides: f64) -> f64 {
    sides / 2.0 * (2.0 * PI / sides).sin()
}

/// Corners are rounded to 1e-4 mm: over a perimeter of P and an area A that is at most 1e-4·P/A,
/// below 1e-5 for these parts.
fn assert_formula(got: f64, formula: f64) {
    assert!((got - formula).abs() < 1e-5 * formula, "{got} for {formula}");
}

#[test]
fn the_flange_has_the_volume_of_its_formula() {
    let known = shipped::KnownVolumes::of(&by_name("flange"));
    let k = polygon_factor(60.0);
    let initial = k * (25f64.powi(2) * 8.0 + 12f64.powi(2) * 8.0 - 5f64.powi(2) * 16.0);
    // The flare: radius 25 + (z − 8)/2 from z = 8 to 16, less the ring's inside.
    let flare = 2.0 / 3.0 * (29f64.powi(3) - 25f64.powi(3)) - 19f64.powi(2) * 8.0;
    let hub = (12f64.powi(2) - 5f64.powi(2)) * 10.0;
    assert_formula(known.initial, initial);
    assert_formula(known.target, initial + k * (flare + hub));
    assert_formula(known.common, initial);
}

#[test]
fn the_bracket_has_the_volume_of_its_formula() {
    let known = shipped::KnownVolumes::of(&by_name("block_bracket"));
    let k = polygon_factor(24.0);
    let half_disc = k * 8f64.powi(2) / 2.0;
    let fillet = 6f64.powi(2) - k * 6f64.powi(2) / 4.0;
    let hole = k * 4f64.powi(2);
    let profile = 50.0 * 10.0 + 16.0 * 26.0 + half_disc + fillet - hole;
    let slot = 14.0 * (16.0 * 13.0 + half_disc - hole) + 16.0 * 3.0 * (14.0 + 8.0) / 2.0;
    assert_formula(known.initial, 50.0 * 40.0 * 44.0);
    assert_formula(known.target, 40.0 * profile - slot);
    assert_formula(known.common, known.target);
}

#[test]
fn the_bearing_has_the_volume_of_its_formula() {
    let known = shipped::KnownVolumes::of(&by_name("bearing"));
    let (k, hole) = (polygon_factor(60.0), polygon_factor(24.0) * 3.75f64.powi(2));
    let foot = 60.0 * 44.0 - (256.0 - polygon_factor(24.0) * 64.0) - 2.0 * hole;
    let square = |r: f64| k * r * r;
    let ring = 12.0 * square(18.0) + 8.0 * square(18.0);
    let chamfer = k * ((20f64.powi(3) - 18f64.powi(3)) / 3.0) - 2.0 * square(18.0);
    let target = 8.0 * foot + chamfer + 2.0 * square(18.0) + ring
        - 4.0 * square(18.0)
        - 14.0 * square(8.0)
        - 12.0 * square(12.0);
    assert_formula(known.target, target);
    assert_formula(known.removed, 2.0 * (foot - square(18.0)) - chamfer);
}

fn by_name(name: &str) -> Pair {
    parts::pairs().into_iter().find(|p| p.name == name).expect("a pair of this name")
}

#[test]
fn the_same_part_twice_is_the_same_file_twice() {
    let [(_, initial), (_, target)] = shipped::files(&by_name("same"));
    assert_eq!(initial, target);
}

#[test]
fn the_nozzle_that_is_a_mesh_takes_the_room_of_its_corners() {
    let mesh = tools::fine_nozzle();
    assert_closed_surface("fine nozzle", &mesh);
    let tool = Tool::load(&shipped::folder().join("fine-nozzle.toml")).unwrap();
    let corner = 0.52 / (PI / 6.0).cos();
    let wanted = [
        (0.0, 0.15, 6.0, 0.18),
        (6.0, 0.18, 12.0, 0.6),
        (12.0, corner, 40.0, corner),
        (40.0, 20.0, 100.0, 20.0),
    ];
    assert_eq!(tool.sections.len(), wanted.len());
    for (section, (z0, r0, z1, r1)) in tool.sections.iter().zip(wanted) {
        let shape = section.shape;
        let ends = [shape.bottom(), shape.top()];
        assert_eq!(ends, [z0, z1]);
        let radii = ends.map(|z| shape.radius_at(z).unwrap());
        assert!((radii[0] - r0).abs() < 1e-3 && (radii[1] - r1).abs() < 1e-3, "{shape:?}");
    }
}
