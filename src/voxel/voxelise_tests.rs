use super::repair::repair;
use super::winding::winding_number;
use super::{BitGrid, Frame, voxelise};
use crate::base::{Aabb, Ctx, DAffine3, DVec3, rng};
use crate::mesh::TriMesh;
use proptest::prelude::*;
use std::path::PathBuf;

fn solid(mesh: &TriMesh, frame: &Frame) -> BitGrid {
    voxelise(mesh, frame, &Ctx::quiet()).unwrap()
}

fn join(meshes: &[TriMesh]) -> TriMesh {
    let (mut v, mut t) = (Vec::new(), Vec::new());
    for m in meshes {
        let base = v.len() as u32;
        v.extend_from_slice(m.vertices());
        t.extend(m.triangles().iter().map(|t| t.map(|i| i + base)));
    }
    TriMesh::new(v, t).unwrap()
}

fn with_triangles(m: &TriMesh, triangles: Vec<[u32; 3]>) -> TriMesh {
    TriMesh::new(m.vertices().to_vec(), triangles).unwrap()
}

fn reversed(m: &TriMesh) -> TriMesh {
    with_triangles(m, m.triangles().iter().map(|[a, b, c]| [*a, *c, *b]).collect())
}

/// Reverses about a third of the faces.
fn shuffled(m: &TriMesh, seed: u64) -> TriMesh {
    let mut r = rng(seed, 0);
    let flip = |[a, b, c]: &[u32; 3], yes: bool| if yes { [*a, *c, *b] } else { [*a, *b, *c] };
    with_triangles(m, m.triangles().iter().map(|t| flip(t, r.random_range(0..3) == 0)).collect())
}

fn cube(lo: f64, hi: f64) -> TriMesh {
    TriMesh::cuboid(DVec3::splat(lo), DVec3::splat(hi))
}

/// A geodesic sphere of 8·4ⁿ triangles.
fn sphere(center: DVec3, radius: f64, n: usize) -> TriMesh {
    let mut faces: Vec<[DVec3; 3]> = Vec::new();
    for s in 0..8 {
        let sign = |b: usize| if s >> b & 1 == 0 { 1.0 } else { -1.0 };
        let (x, y, z) = (DVec3::X * sign(0), DVec3::Y * sign(1), DVec3::Z * sign(2));
        let even = (s as u32).count_ones().is_multiple_of(2);
        faces.push(if even { [x, y, z] } else { [x, z, y] });
    }
    for _ in 0..n {
        faces = faces
            .iter()
            .flat_map(|&[a, b, c]| {
                let (ab, bc, ca) = ((a + b).normalize(), (b + c).normalize(), (c + a).normalize());
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            })
            .collect();
    }
    let v: Vec<DVec3> = faces.iter().flatten().map(|p| center + *p * radius).collect();
    let t = (0..faces.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    TriMesh::new(v, t).unwrap()
}

/// 20³ voxels of side 1 over [0, 20)³.
const TWENTY: Frame = Frame { pitch: 1.0, dims: [20; 3], origin: DVec3::ZERO };

fn boxes(list: &[(f64, f64)]) -> usize {
    list.iter().map(|(a, b)| (b - a).powi(3) as usize).sum()
}

#[test]
fn a_cuboid_on_voxel_faces_is_exact() {
    let m = TriMesh::cuboid(DVec3::new(1.0, 2.0, 3.0), DVec3::new(19.0, 5.0, 7.0));
    let expected = BitGrid::from_fn(TWENTY.dims, |[x, y, z]| {
        (1..19).contains(&x) && (2..5).contains(&y) && (3..7).contains(&z)
    });
    assert_eq!(solid(&m, &TWENTY), expected);
}

#[test]
fn faces_through_centres_own_their_low_side() {
    let expected = BitGrid::from_fn(TWENTY.dims, |v| v.iter().all(|c| (2..9).contains(c)));
    assert_eq!(solid(&cube(2.5, 9.5), &TWENTY), expected);
}

#[test]
fn a_mesh_larger_than_its_grid_fills_it() {
    assert_eq!(solid(&cube(-50.0, 50.0), &TWENTY).count(), 8000);
    assert_eq!(solid(&cube(-50.0, -20.0), &TWENTY).count(), 0);
    assert_eq!(solid(&TriMesh::default(), &TWENTY).count(), 0);
    let none = Frame { dims: [0, 5, 5], ..TWENTY };
    assert_eq!(solid(&cube(0.0, 5.0), &none).count(), 0);
}

#[test]
fn shells_within_shells() {
    let outer = cube(2.0, 18.0);
    let inner = cube(6.0, 14.0);
    let innermost = cube(8.0, 12.0);
    let all = boxes(&[(2.0, 18.0)]);
    let hollow = all - boxes(&[(6.0, 14.0)]);
    let cases = [
        ("inner body", join(&[outer.clone(), inner.clone()]), all),
        ("void", join(&[outer.clone(), reversed(&inner)]), hollow),
        ("void, whole file reversed", join(&[reversed(&outer), inner.clone()]), hollow),
        (
            "body in a void",
            join(&[outer.clone(), reversed(&inner), innermost.clone()]),
            hollow + boxes(&[(8.0, 12.0)]),
        ),
        ("inside out", reversed(&outer), all),
        (
            "two bodies, one inside out",
            join(&[cube(1.0, 5.0), reversed(&cube(10.0, 15.0))]),
            boxes(&[(1.0, 5.0), (10.0, 15.0)]),
        ),
        ("overlapping bodies", join(&[cube(2.0, 10.0), cube(6.0, 14.0)]), 2 * 512 - 64),
    ];
    for (name, mesh, expected) in cases {
        assert_eq!(solid(&mesh, &TWENTY).count(), expected, "{name}");
    }
}

#[test]
fn doubled_sheets_count_once() {
    let c = cube(3.0, 11.0);
    let expected = solid(&c, &TWENTY);
    let part = |from: &TriMesh, n| with_triangles(from, from.triangles()[..n].to_vec());
    let cases = [
        ("whole", join(&[c.clone(), c.clone()])),
        ("whole, opposed", join(&[c.clone(), reversed(&c)])),
        ("thrice", join(&[c.clone(), c.clone(), reversed(&c)])),
        ("one side", join(&[c.clone(), part(&c, 2)])),
        ("one side, opposed", join(&[c.clone(), part(&reversed(&c), 2)])),
        ("one triangle", join(&[c.clone(), part(&c, 1)])),
    ];
    for (name, mesh) in cases {
        assert_eq!(solid(&mesh, &TWENTY), expected, "{name}");
        for seed in 0..20 {
            assert_eq!(solid(&shuffled(&mesh, seed), &TWENTY), expected, "{name} {seed}");
        }
    }
}

#[test]
fn a_wall_between_two_bodies_vanishes() {
    let a = TriMesh::cuboid(DVec3::splat(2.0), DVec3::new(8.0, 8.0, 8.0));
    let b = TriMesh::cuboid(DVec3::new(8.0, 2.0, 2.0), DVec3::new(14.0, 8.0, 8.0));
    let whole = TriMesh::cuboid(DVec3::splat(2.0), DVec3::new(14.0, 8.0, 8.0));
    let both = join(&[a, b]);
    assert_eq!(solid(&both, &TWENTY), solid(&whole, &TWENTY));
    for seed in 0..20 {
        assert_eq!(solid(&shuffled(&both, seed), &TWENTY), solid(&whole, &TWENTY), "{seed}");
    }
}

#[test]
fn an_enclosed_shell_whose_faces_disagree_is_a_void() {
    let mesh = join(&[cube(2.0, 18.0), reversed(&cube(6.0, 14.0))]);
    let expected = solid(&mesh, &TWENTY);
    let mut triangles = mesh.triangles().to_vec();
    (0..24).step_by(2).for_each(|t| triangles[t].swap(0, 1));
    assert_eq!(solid(&with_triangles(&mesh, triangles), &TWENTY), expected);
}

#[test]
fn an_open_box_is_closed_where_w_passes_a_half() {
    let c = cube(3.3, 15.3);
    for side in 0..6 {
        let mut t = c.triangles().to_vec();
        t.drain(2 * side..2 * side + 2);
        let open = with_triangles(&c, t);
        // A flat hole takes up half the sphere of view from its own plane: w = ½ closes it flat.
        assert_eq!(solid(&open, &TWENTY), solid(&c, &TWENTY), "side {side}");
        assert_eq!(solid(&reversed(&open), &TWENTY), solid(&open, &TWENTY), "side {side}");
        assert_eq!(solid(&shuffled(&open, 3), &TWENTY), solid(&open, &TWENTY), "side {side}");
    }
}

#[test]
fn cracked_sheets_all_reversed_are_a_solid() {
    // Six sides that do not touch.
    let c = cube(3.0, 15.0);
    let v: Vec<DVec3> = (0..12)
        .flat_map(|t| {
            let side = c.area_normal(t).normalize() * 0.01;
            c.corners(t).map(|p| p + side)
        })
        .collect();
    let t = (0..12).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    let m = TriMesh::new(v, t).unwrap();
    assert_eq!(solid(&m, &TWENTY), solid(&c, &TWENTY));
    assert_eq!(solid(&reversed(&m), &TWENTY), solid(&c, &TWENTY));
}

#[test]
fn threads_do_not_change_a_bit() {
    let whole = sphere(DVec3::splat(10.1), 8.0, 4);
    let mut t = whole.triangles().to_vec();
    t.drain(..300);
    let m = shuffled(&with_triangles(&whole, t), 1);
    let frame = Frame { pitch: 0.25, dims: [80; 3], origin: DVec3::ZERO };
    let on = |n| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
        pool.install(|| solid(&m, &frame))
    };
    let one = on(1);
    assert!(one == on(2) && one == on(5));
}

#[test]
fn cancelling_is_heard() {
    let flag = std::sync::Arc::new(std::sync::atomic::AtomicBool::new(true));
    let ctx = Ctx::new(flag, None, std::sync::Arc::new(crate::base::Silent), 0);
    assert!(voxelise(&cube(0.0, 1.0), &TWENTY, &ctx).is_err());
}

/// Compares with the sum of solid angles over the repaired triangles, voxel by voxel.
fn agrees_with_the_definition(mesh: &TriMesh, frame: &Frame, margin: f64) -> Result<(), String> {
    let fast = solid(mesh, frame);
    let repaired = repair(mesh);
    let mut faces = repaired.triangles.iter().map(|t| t.map(|i| repaired.vertices[i as usize]));
    let faces: Vec<_> = faces.by_ref().collect();
    for z in 0..frame.dims[2] {
        for y in 0..frame.dims[1] {
            for x in 0..frame.dims[0] {
                let p = frame.center([x, y, z]);
                let height = |[a, b, c]: [DVec3; 3]| (a - p).dot((b - p).cross(c - p)).abs();
                if faces.iter().any(|t| height(*t) < 1e-9) {
                    continue; // In the plane of a face, maybe on it, where w jumps.
                }
                let w = winding_number(faces.iter().copied(), p);
                if (w - 0.5).abs() > margin && fast.get([x, y, z]) != (w > 0.5) {
                    return Err(format!("voxel {x} {y} {z}: w = {w}"));
                }
            }
        }
    }
    Ok(())
}

fn random_triangles(corners: &[[f64; 3]], triangles: &[[u32; 3]]) -> TriMesh {
    let v: Vec<DVec3> = corners.iter().map(|p| DVec3::from_array(*p)).collect();
    let n = v.len() as u32;
    TriMesh::new(v, triangles.iter().map(|t| t.map(|i| i % n)).collect()).unwrap()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn soups_agree_with_the_definition(
        corners in proptest::collection::vec(proptest::array::uniform3(-1.0f64..11.0), 4..12),
        triangles in proptest::collection::vec(proptest::array::uniform3(0u32..12), 1..40),
    ) {
        let frame = Frame { pitch: 1.0, dims: [11, 10, 9], origin: DVec3::ZERO };
        let mesh = random_triangles(&corners, &triangles);
        prop_assert_eq!(agrees_with_the_definition(&mesh, &frame, 0.01), Ok(()));
    }

    /// Corners and edges on voxel centres, where rows pass through them.
    #[test]
    fn corners_on_centres_leave_no_streaks(
        corners in proptest::array::uniform4(proptest::array::uniform3(0i32..10)),
    ) {
        let corners = corners.map(|p| p.map(|c| f64::from(c) + 0.5));
        let mesh = random_triangles(&corners, &[[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]);
        prop_assert_eq!(agrees_with_the_definition(&mesh, &TWENTY, 1e-6), Ok(()));
    }
}

proptest! {
    // Each case sums 2.5 million solid angles, twice.
    #![proptest_config(ProptestConfig::with_cases(8))]

    #[test]
    fn pierced_overlapping_spheres_agree_with_the_definition(seed in any::<u64>()) {
        let mut r = rng(seed, 0);
        let mut coordinate = || r.random_range(3.0..9.0);
        let spheres: Vec<TriMesh> = (0..3)
            .map(|_| {
                let c = DVec3::new(coordinate(), coordinate(), coordinate());
                sphere(c, coordinate() / 2.5, 2)
            })
            .collect();
        let all = join(&spheres);
        let mut t = all.triangles().to_vec();
        t.retain(|_| r.random_range(0..12) != 0);
        let frame = Frame { pitch: 0.7, dims: [17, 17, 17], origin: DVec3::ZERO };
        prop_assert_eq!(agrees_with_the_definition(&all, &frame, 1e-9), Ok(()));
        prop_assert_eq!(agrees_with_the_definition(&with_triangles(&all, t), &frame, 0.01), Ok(()));
    }
}

pub(super) fn meshes() -> Option<PathBuf> {
    let here = env!("CARGO_MANIFEST_DIR");
    let found = ["/../shared/meshes", "/../../shared/meshes"]
        .iter()
        .map(|p| PathBuf::from(format!("{here}{p}")))
        .find(|p| p.is_dir());
    if found.is_none() {
        eprintln!("skipped: no shared meshes beside the project");
    }
    found
}

/// Reads just what the shared meshes need, scaled.
pub(super) fn read(path: PathBuf, scale: f64) -> TriMesh {
    let bytes = std::fs::read(&path).unwrap();
    let (mut v, mut t) = (Vec::new(), Vec::new());
    if path.extension().unwrap() == "stl" {
        for facet in bytes[84..].chunks_exact(50) {
            let f = |i: usize| f32::from_le_bytes(facet[12 + 4 * i..][..4].try_into().unwrap());
            let base = v.len() as u32;
            v.extend(
                (0..3)
                    .map(|c| DVec3::new(f(3 * c).into(), f(3 * c + 1).into(), f(3 * c + 2).into())),
            );
            t.push([base, base + 1, base + 2]);
        }
    } else {
        let text = String::from_utf8_lossy(&bytes);
        let off = text.starts_with("OFF");
        for line in text.lines().skip(if off { 2 } else { 0 }) {
            let words: Vec<&str> = line.split_whitespace().collect();
            let number = |w: &str| w.parse::<f64>().unwrap();
            let index = |w: &str| w.split('/').next().unwrap().parse::<u32>().unwrap();
            let (vertex, face) = match words.first() {
                Some(&"v") => (Some(&words[1..4]), None),
                Some(&"f") => (None, Some(words[1..].iter().map(|w| index(w) - 1).collect())),
                Some(_) if off && words.len() == 3 => (Some(&words[..]), None),
                Some(_) if off => (None, Some(words[1..].iter().map(|w| index(w)).collect())),
                _ => continue,
            };
            v.extend(vertex.map(|w| DVec3::new(number(w[0]), number(w[1]), number(w[2]))));
            let face: Vec<u32> = face.unwrap_or_default();
            t.extend((2..face.len()).map(|i| [face[0], face[i - 1], face[i]]));
        }
    }
    let m = TriMesh::new(v, t).unwrap();
    m.transformed(&DAffine3::from_scale(DVec3::splat(scale))).unwrap()
}

fn across(bounds: Aabb, n: f64) -> Frame {
    Frame::around(bounds, bounds.size().max_element() / n, 1).unwrap()
}

fn volume(mesh: &TriMesh, frame: &Frame) -> f64 {
    solid(mesh, frame).count() as f64 * frame.voxel_volume()
}

#[test]
fn watertight_parts_keep_their_volume() {
    let Some(dir) = meshes() else { return };
    for name in [
        "simjeb_101.obj",
        "simjeb_14.obj",
        "simjeb_331.obj",
        "simjeb_411.obj",
        "ge_bracket.stl",
        "fertility.off",
        "rocker_arm.obj",
        "fandisk.off",
        "bunny.off",
        "cow.obj",
        "elephant.obj",
    ] {
        let m = read(dir.join(name), 1.0);
        let exact = m.signed_volume();
        // Where centres fall between the sides of a plate is luck: the same bracket, shifted by
        // parts of a voxel, counts −2.7 to +3.6 %. So the coarse grid starts at the part's corner,
        // and a finer one that is aligned like any other bounds the method's own error.
        let coarse = across(m.bounds(), 100.0);
        let coarse = Frame {
            origin: m.bounds().min - coarse.pitch,
            dims: coarse.dims.map(|n| n + 1),
            ..coarse
        };
        for (frame, tolerance) in [(coarse, 0.01), (across(m.bounds(), 600.0), 0.002)] {
            let error = volume(&m, &frame) / exact - 1.0;
            assert!(error.abs() < tolerance, "{name} at {} mm: {error}", frame.pitch);
        }
    }
}

#[test]
fn damaged_bunnies_keep_their_volume() {
    let Some(dir) = meshes() else { return };
    let closed = read(dir.join("bunny.off"), 1000.0);
    let exact = closed.signed_volume();
    let frame = across(closed.bounds(), 100.0);
    let whole = solid(&closed, &frame);
    for seed in 0..3 {
        assert_eq!(solid(&shuffled(&closed, seed), &frame), whole);
    }
    let open = read(dir.join("stanford_bunny_open.obj"), 1000.0);
    let frame = across(open.bounds(), 100.0);
    for (name, m) in [("open", open.clone()), ("open, shuffled", shuffled(&open, 1))] {
        let got = volume(&m, &frame);
        assert!((got / exact - 1.0).abs() < 0.02, "{name}: {got} against {exact}");
    }
    // Every fiftieth face missing and a third reversed.
    let mut r = rng(5, 0);
    let mut torn = closed.triangles().to_vec();
    torn.retain(|_| r.random_range(0..50) != 0);
    let torn = shuffled(&with_triangles(&closed, torn), 5);
    let got = volume(&torn, &across(closed.bounds(), 100.0));
    assert!((got / exact - 1.0).abs() < 0.01, "torn: {got} against {exact}");
}
