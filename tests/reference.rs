//! Volumes and Booleans of the fixtures against manifold3d, which shares no code with us.
//!
//! Needs Python and its package index the first time; see `reference/venv.rs`. With
//! `HMPLAN_SKIP_REFERENCE=1` the checks say that they were skipped, and pass.

#[path = "reference/venv.rs"]
mod venv;

use hmplan::base::{Ctx, DVec2, DVec3};
use hmplan::mesh::{self, ReadOptions, TriMesh};
use hmplan::toolpath::{DropCutter, End};
use hmplan::voxel::{Frame, voxelise};
use serde::Deserialize;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// What `check_fixtures.py` prints.
#[derive(Deserialize)]
struct Reference {
    pairs: Vec<Pair>,
}

#[derive(Deserialize)]
struct Pair {
    name: String,
    #[serde(flatten)]
    volumes: Volumes,
    reuse_ideal: f64,
}

/// Volumes of the parts, of M ∩ M*, M − M* and M* − M, mm³.
#[derive(Clone, Copy, Debug, Default, Deserialize)]
struct Volumes {
    initial: f64,
    target: f64,
    common: f64,
    removed: f64,
    added: f64,
}

impl Volumes {
    fn named(&self) -> [(&'static str, f64); 5] {
        [
            ("initial", self.initial),
            ("target", self.target),
            ("common", self.common),
            ("removed", self.removed),
            ("added", self.added),
        ]
    }
}

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures")
}

/// The reference figures, computed once; nothing when the user asked to skip them.
fn reference() -> Option<&'static Reference> {
    static ONCE: OnceLock<Result<Reference, String>> = OnceLock::new();
    if venv::is_skipped() {
        println!("skipped: {} is set", venv::SKIP_VARIABLE);
        return None;
    }
    let outcome = ONCE.get_or_init(|| {
        let printed = venv::run("check_fixtures.py", &[&folder()])?;
        serde_json::from_str(&printed).map_err(|e| format!("check_fixtures.py printed: {e}"))
    });
    Some(outcome.as_ref().unwrap_or_else(|why| panic!("{why}")))
}

fn read(pair: &Pair, role: &str) -> TriMesh {
    let path = folder().join(format!("{}_{role}.obj", pair.name));
    match mesh::read(&path, &ReadOptions { mm_per_unit: 1.0 }) {
        Ok(loaded) => loaded.mesh,
        Err(e) => panic!("{e}"),
    }
}

#[test]
fn mesh_volumes_agree_with_manifold() {
    let Some(reference) = reference() else { return };
    assert!(!reference.pairs.is_empty());
    for pair in &reference.pairs {
        for (role, theirs) in [("initial", pair.volumes.initial), ("target", pair.volumes.target)] {
            let ours = read(pair, role).signed_volume();
            let name = &pair.name;
            assert!((ours - theirs).abs() <= 1e-6 * theirs, "{name} {role}: {ours} for {theirs}");
        }
    }
}

/// Grids per pair, each shifted by a further part of the pitch. A flat face between two layers of
/// centres makes one grid err by up to half a pitch times its area (1.4 % on these parts), whatever
/// the voxeliser; over evenly shifted grids that averages out, and what is left (0.4 %) is not.
const SHIFTS: usize = 4;

/// Volumes by counting voxels at a pitch of the largest extent over 120.
fn voxel_volumes(initial: &TriMesh, target: &TriMesh) -> Volumes {
    let bounds = initial.bounds().union(target.bounds());
    let pitch = bounds.size().max_element() / 120.0;
    let aligned = Frame::around(bounds, pitch, 1).expect("120 voxels an axis fit");
    let mut volumes = Volumes::default();
    for i in 0..SHIFTS {
        let shift = ((i as f64 + 0.5) / SHIFTS as f64 - 0.5) * pitch;
        let frame = Frame { origin: aligned.origin + DVec3::splat(shift), ..aligned };
        let [m, m_star] = [initial, target]
            .map(|mesh| voxelise(mesh, &frame, &Ctx::quiet()).expect("nobody cancels a test"));
        let volume = |voxels: usize| voxels as f64 * frame.voxel_volume() / SHIFTS as f64;
        volumes.initial += volume(m.count());
        volumes.target += volume(m_star.count());
        volumes.common += volume(m.and(&m_star).count());
        volumes.removed += volume(m.minus(&m_star).count());
        volumes.added += volume(m_star.minus(&m).count());
    }
    volumes
}

#[test]
fn voxel_booleans_agree_with_manifold() {
    let Some(reference) = reference() else { return };
    for pair in &reference.pairs {
        let ours = voxel_volumes(&read(pair, "initial"), &read(pair, "target"));
        let allowed = 0.01 * pair.volumes.target;
        for ((what, ours), (_, theirs)) in ours.named().into_iter().zip(pair.volumes.named()) {
            let name = &pair.name;
            assert!((ours - theirs).abs() <= allowed, "{name} {what}: {ours} for {theirs} mm³");
        }
        let reuse_ideal = ours.common / ours.target;
        assert!((reuse_ideal - pair.reuse_ideal).abs() <= 0.01, "{}: R_V {reuse_ideal}", pair.name);
    }
}

/// What `drop_cutter.py` prints.
#[derive(Deserialize)]
struct Dropped {
    cases: Vec<Case>,
}

#[derive(Deserialize)]
struct Case {
    part: String,
    ball: bool,
    diameter: f64,
    points: Vec<(f64, f64, Option<f64>)>,
}

/// Largest difference of a tip's height, mm.
const DROP_MM: f64 = 0.005;

#[test]
fn drop_cutter_heights_agree_with_opencamlib() {
    if venv::is_skipped() {
        println!("skipped: {} is set", venv::SKIP_VARIABLE);
        return;
    }
    let printed = venv::run("drop_cutter.py", &[&folder()]).unwrap_or_else(|why| panic!("{why}"));
    let dropped: Dropped = serde_json::from_str(&printed).unwrap();
    assert_eq!(dropped.cases.len(), 18, "three parts, three ball and three flat ends");
    let mut worst = 0.0f64;
    for case in &dropped.cases {
        let path = folder().join(format!("{}.obj", case.part));
        let mesh = mesh::read(&path, &ReadOptions { mm_per_unit: 1.0 }).unwrap().mesh;
        let triangles = (0..mesh.triangles().len()).map(|t| mesh.corners(t)).collect();
        let radius = case.diameter / 2.0;
        let drop = DropCutter::new(triangles, radius);
        let end = if case.ball { End::Ball { radius } } else { End::Flat { radius } };
        let mut met = 0;
        for &(x, y, theirs) in &case.points {
            let ours = drop.height(end, DVec2::new(x, y));
            let what = format!("{} {end:?} at ({x}, {y}): {ours:?} for {theirs:?}", case.part);
            assert_eq!(ours.is_some(), theirs.is_some(), "{what}");
            if let (Some(ours), Some(theirs)) = (ours, theirs) {
                assert!((ours - theirs).abs() <= DROP_MM, "{what}");
                worst = worst.max((ours - theirs).abs());
                met += 1;
            }
        }
        assert!(met > 500, "{} {end:?}: only {met} of {} met", case.part, case.points.len());
    }
    println!("largest difference {worst:.6} mm");
}
