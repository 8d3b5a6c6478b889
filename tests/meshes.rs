//! Meshes that must load: what is written reads back, other readers agree, and real parts keep
//! their known properties.

use hmplan::base::{Ctx, DAffine3, DMat3, DVec2, DVec3, Direction};
use hmplan::machine::{Holding, Machine, ToolKind};
use hmplan::mesh::{Format, Health, LoadedMesh, ReadOptions, TriMesh, read, write_obj, write_stl};
use hmplan::plan::{Job, Origin, Plan, Rules, Step, StepKind};
use hmplan::toolpath::{INSET_SLACK, MoveKind, for_unverified};
use hmplan::voxel::{BitGrid, Frame, voxelise};
use std::io::Write;
use std::path::{Path, PathBuf};
use zip::write::SimpleFileOptions;

fn load(path: &Path) -> LoadedMesh {
    read(path, &ReadOptions::default()).unwrap_or_else(|e| panic!("{e}"))
}

/// Triangles as corner positions, each from its smallest corner on, in a fixed order: what two
/// readers must agree on whatever order they number vertices in.
fn positions(mesh: &TriMesh) -> Vec<[[u32; 3]; 3]> {
    let mut all: Vec<_> = (0..mesh.triangles().len())
        .map(|t| {
            let mut c = mesh.corners(t).map(|p| p.to_array().map(|x| (x as f32 + 0.0).to_bits()));
            let first = (0..3).min_by_key(|i| c[*i]).unwrap_or(0);
            c.rotate_left(first);
            c
        })
        .collect();
    all.sort_unstable();
    all
}

fn shared_meshes() -> Option<PathBuf> {
    // Beside the project, or beside the folder that holds its worktrees.
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let found = ["../shared/meshes", "../../shared/meshes"].map(|p| root.join(p));
    let found = found.into_iter().find(|p| p.is_dir());
    if found.is_none() {
        eprintln!("skipped: no ../shared/meshes here");
    }
    found
}

#[test]
fn what_is_written_reads_back() {
    let dir = tempfile::tempdir().unwrap();
    let part = TriMesh::cuboid(DVec3::new(0.1, -1e-7, 1.0 / 3.0), DVec3::new(12.5, 7.0, 1e5));
    let (stl, obj) = (dir.path().join("a.stl"), dir.path().join("a.obj"));
    write_stl(&part, std::fs::File::create(&stl).unwrap()).unwrap();
    write_obj(&part, std::fs::File::create(&obj).unwrap()).unwrap();

    let from_obj = load(&obj);
    assert_eq!((from_obj.format, &from_obj.mesh), (Format::Obj, &part));
    let from_stl = load(&stl);
    assert_eq!(from_stl.format, Format::StlBinary);
    assert_eq!(from_stl.mesh.vertices().len(), 8);
    assert_eq!(positions(&from_stl.mesh), positions(&part));

    let bytes = std::fs::read(&stl).unwrap();
    let mut again = Vec::new();
    write_stl(&part, &mut again).unwrap();
    assert_eq!(bytes, again);
    assert_eq!(bytes.len(), 84 + 50 * 12);
    let oracle = stl_io::read_stl(&mut std::io::Cursor::new(bytes)).unwrap();
    assert_eq!(oracle.faces.len(), 12);
    assert!(oracle.faces.iter().all(|f| (f.normal[0] + f.normal[1] + f.normal[2]).abs() == 1.0));
}

#[test]
fn the_digest_is_of_the_file_and_the_factor_scales() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.off");
    std::fs::write(&path, "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n").unwrap();
    let loaded = read(&path, &ReadOptions { mm_per_unit: 25.4 }).unwrap();
    assert_eq!(loaded.mesh.bounds().max.x, 25.4);
    // sha256sum of the line above.
    let known = "fb24d942999fec35fed007b5f84ca44064f763225bc01c58ef70e281a1eff083";
    assert_eq!(loaded.sha256, known);
}

#[test]
fn the_content_outranks_the_extension() {
    let dir = tempfile::tempdir().unwrap();
    let part = TriMesh::cuboid(DVec3::ZERO, DVec3::ONE);
    let path = dir.path().join("part.obj");
    write_stl(&part, std::fs::File::create(&path).unwrap()).unwrap();
    assert_eq!(load(&path).format, Format::StlBinary);
    let path = dir.path().join("part.stl");
    write_obj(&part, std::fs::File::create(&path).unwrap()).unwrap();
    assert_eq!(load(&path).format, Format::Obj);
}

/// A package in inches with a component of another part, placed twice.
fn assembly() -> Vec<u8> {
    const RELS: &str = r#"<Relationships><Relationship Target="/3D/root.model" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>"#;
    const ROOT: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
        <model unit="inch" xmlns:p="http://schemas.microsoft.com/3dmanufacturing/production/2015/06">
        <metadata name="Title">a &amp; b</metadata>
        <resources><basematerials id="9"><base name="x"/></basematerials>
        <object id="2" type="model"><components>
        <component objectid="1" p:path="/3D/Parts/Box.model" transform="2 0 0 0 1 0 0 0 1 0 0 0"/>
        </components></object></resources>
        <build><item objectid="2"/><item objectid="2" transform="-1 0 0 0 1 0 0 0 1 10 0 0"/></build>
        </model>"#;
    let cube = TriMesh::cuboid(DVec3::ZERO, DVec3::ONE);
    let mut part = "<model unit=\"inch\"><resources><object id=\"1\"><mesh><vertices>".to_string();
    for v in cube.vertices() {
        part += &format!("<vertex x=\"{}\" y=\"{}\" z=\"{}\"/>", v.x, v.y, v.z);
    }
    part += "</vertices><triangles>";
    for [a, b, c] in cube.triangles() {
        part += &format!("<triangle v1=\"{a}\" v2=\"{b}\" v3=\"{c}\" pid=\"9\"></triangle>");
    }
    part += "</triangles></mesh></object></resources><build/></model>";
    let mut zip = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for (name, content) in
        [("_rels/.rels", RELS), ("3D/root.model", ROOT), ("3D/parts/box.model", part.as_str())]
    {
        zip.start_file(name, SimpleFileOptions::default()).unwrap();
        zip.write_all(content.as_bytes()).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

#[test]
fn a_3mf_places_its_components_in_its_own_unit() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.3mf");
    std::fs::write(&path, assembly()).unwrap();
    let loaded = read(&path, &ReadOptions { mm_per_unit: 2.0 }).unwrap();
    assert_eq!(loaded.format, Format::ThreeMf);
    let health = Health::of(&loaded.mesh);
    let inch = 25.4 * 2.0;
    assert_eq!((health.bodies, health.triangles, health.inside_out), (2, 24, 0));
    assert!(health.watertight);
    assert!((health.extents - DVec3::new(10.0, 1.0, 1.0) * inch).length() < 1e-9);
    assert!((health.signed_volume - 4.0 * inch.powi(3)).abs() < 1e-6);
}

#[test]
fn another_3mf_writer_and_reader_agree() {
    let cube = TriMesh::cuboid(DVec3::ZERO, DVec3::new(3.0, 4.0, 5.0));
    let vertex = |v: &DVec3| threemf::model::Vertex { x: v.x, y: v.y, z: v.z };
    let triangle = |t: &[u32; 3]| {
        let [v1, v2, v3] = t.map(|i| i as usize);
        threemf::model::Triangle { v1, v2, v3 }
    };
    let mesh = threemf::Mesh {
        vertices: threemf::model::Vertices { vertex: cube.vertices().iter().map(vertex).collect() },
        triangles: threemf::model::Triangles {
            triangle: cube.triangles().iter().map(triangle).collect(),
        },
    };
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.3mf");
    threemf::write(std::fs::File::create(&path).unwrap(), mesh).unwrap();
    assert_eq!(load(&path).mesh, cube);
}

#[test]
fn other_readers_agree_on_real_meshes() {
    let Some(dir) = shared_meshes() else { return };
    let (models, _) = tobj::load_obj_buf(
        &mut std::io::BufReader::new(std::fs::File::open(dir.join("simjeb_411.obj")).unwrap()),
        &tobj::LoadOptions { triangulate: true, ..Default::default() },
        |_| Ok(Default::default()),
    )
    .unwrap();
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for model in models {
        let first = vertices.len() as u32;
        let p = |c: &[f32]| DVec3::new(c[0].into(), c[1].into(), c[2].into());
        vertices.extend(model.mesh.positions.chunks_exact(3).map(p));
        triangles
            .extend(model.mesh.indices.chunks_exact(3).map(|t| [0, 1, 2].map(|k| t[k] + first)));
    }
    let oracle = TriMesh::new(vertices, triangles).unwrap();
    assert_eq!(positions(&load(&dir.join("simjeb_411.obj")).mesh), positions(&oracle));

    let path = dir.join("ge_bracket.stl");
    let oracle = stl_io::read_stl(&mut std::fs::File::open(&path).unwrap()).unwrap();
    let p = |v: &stl_io::Vertex| DVec3::new(v[0].into(), v[1].into(), v[2].into());
    let oracle = TriMesh::new(
        oracle.vertices.iter().map(p).collect(),
        oracle.faces.iter().map(|f| f.vertices.map(|i| i as u32)).collect(),
    )
    .unwrap();
    assert_eq!(positions(&load(&path).mesh), positions(&oracle));
}

#[test]
fn real_meshes_have_their_known_health() {
    let Some(dir) = shared_meshes() else { return };
    for (name, triangles, extents) in [
        ("simjeb_101.obj", 57_000, Some([106.0, 180.0, 62.0])),
        ("simjeb_14.obj", 79_000, Some([106.0, 180.0, 62.0])),
        ("simjeb_331.obj", 85_000, Some([106.0, 180.0, 62.0])),
        ("simjeb_411.obj", 38_000, Some([106.0, 180.0, 62.0])),
        ("ge_bracket.stl", 9_500, Some([177.0, 107.0, 62.0])),
        ("fertility.off", 9_000, Some([199.0, 144.0, 73.0])),
        ("rocker_arm.obj", 20_000, None),
        ("fandisk.off", 14_000, None),
        ("bunny.off", 7_000, None),
        ("cow.obj", 5_800, None),
        ("elephant.obj", 12_000, Some([113.0, 128.0, 74.0])),
    ] {
        let health = Health::of(&load(&dir.join(name)).mesh);
        println!("{name}: {health:?} {:#?}", health.warnings());
        assert!(health.watertight, "{name}");
        assert!(health.triangles.abs_diff(triangles) <= triangles / 20, "{name}");
        assert!(health.signed_volume > 0.0 && health.inside_out == 0, "{name}");
        if let Some(e) = extents {
            let off = (health.extents - DVec3::from(e)).abs().max_element();
            assert!(off < 6.0, "{name}: {}", health.extents);
        }
    }
    let open = Health::of(&load(&dir.join("stanford_bunny_open.obj")).mesh);
    println!("{open:?} {:#?}", open.warnings());
    assert!(!open.watertight && open.holes >= 1 && open.boundary_edges >= 3);
    assert!(open.warnings().iter().any(|w| w.contains("holes")));
    assert!(open.warnings().iter().any(|w| w.contains("--unit m")));
}

/// A piece of a section's outline, and the unit normal to its inside.
struct Wall {
    a: DVec2,
    b: DVec2,
    inward: DVec2,
}

/// Where triangles cross the plane at `z`.
fn section_walls(mesh: &TriMesh, z: f64) -> Vec<Wall> {
    let cut = |t: usize| {
        let c = mesh.corners(t);
        let mut ends = Vec::new();
        for i in 0..3 {
            let (a, b) = (c[i], c[(i + 1) % 3]);
            if (a.z > z) != (b.z > z) {
                ends.push(a.lerp(b, (z - a.z) / (b.z - a.z)).truncate());
            }
        }
        let inward = -mesh.area_normal(t).truncate().normalize_or_zero();
        (ends.len() == 2).then(|| Wall { a: ends[0], b: ends[1], inward })
    };
    (0..mesh.triangles().len()).filter_map(cut).collect()
}

/// Distance of a point from the outline, negative outside.
fn depth(p: DVec2, walls: &[Wall]) -> f64 {
    let mut best = (f64::INFINITY, 0.0);
    for w in walls {
        let gap = apart(p, (w.a, w.b));
        let side = (p - (w.a + w.b) / 2.0).dot(w.inward);
        // At a corner two walls are equally far: the one that is seen less aslant tells the side.
        if gap < best.0 - 1e-9 || (gap < best.0 + 1e-9 && side.abs() > f64::abs(best.1)) {
            best = (gap, side);
        }
    }
    best.0.copysign(best.1)
}

/// Least distance from `p`, below `most`, of a place whose depth is at least `inset`.
fn nearest_place(p: DVec2, inset: f64, most: f64, walls: &[Wall]) -> f64 {
    let near: Vec<Wall> = walls
        .iter()
        .filter(|w| apart(p, (w.a, w.b)) < most + inset)
        .map(|w| Wall { ..*w })
        .collect();
    let step = 0.01;
    let mut radius = inset;
    while radius < most {
        for k in 0..90 {
            let (sin, cos) = (f64::from(k) * 4.0).to_radians().sin_cos();
            if depth(p + DVec2::new(cos, sin) * radius, &near) >= inset {
                return radius;
            }
        }
        radius += step;
    }
    most
}

fn apart(p: DVec2, (a, b): (DVec2, DVec2)) -> f64 {
    let way = b - a;
    let t = (p - a).dot(way) / way.length_squared().max(1e-18);
    (a + way * t.clamp(0.0, 1.0)).distance(p)
}

/// One block printed from an empty base: material as slicers lay it, beads on the exact sections.
#[test]
fn fertility_is_printed_on_its_exact_sections() {
    let Some(dir) = shared_meshes() else { return };
    let raw = load(&dir.join("fertility.off")).mesh;
    let size = raw.bounds().size();
    let scale = DMat3::from_diagonal(DVec3::splat(100.0 / size.max_element()));
    let down = DVec3::Z * -raw.bounds().min.z * (100.0 / size.max_element());
    let mesh = raw.transformed(&DAffine3::from_mat3_translation(scale, down)).unwrap();
    let frame = Frame::around(mesh.bounds(), 0.4, 2).unwrap();
    let target = voxelise(&mesh, &frame, &Ctx::quiet()).unwrap();
    let machine = Machine::builtin("generic-5axis").unwrap();
    let nozzles: Vec<_> = machine.tools_of(ToolKind::Additive).into_iter().cloned().collect();
    let step = Step {
        kind: StepKind::Additive,
        tool: nozzles[0].name.clone(),
        direction: Direction::Z,
        holding: 0,
        region: target.clone(),
        block: 0,
        origin: Origin::default(),
    };
    let job = Job {
        initial: BitGrid::new(frame.dims),
        target,
        frame,
        initial_mesh: TriMesh::default(),
        target_mesh: mesh.clone(),
        machine,
        cutters: Vec::new(),
        nozzles,
        rules: Rules::for_pitch(0.4, 0.2),
    };
    let plan = Plan { holdings: vec![Holding::AS_CLAMPED], steps: vec![step] };
    let cpu = cpu_seconds();
    let paths = for_unverified(&job, &plan, &Ctx::quiet()).unwrap();
    let cpu = cpu_seconds() - cpu;
    let path = &paths.all()[0];
    let cm3 = path.figures.material_mm3 / 1000.0;
    let volume = mesh.signed_volume() / 1000.0;
    println!("{cm3:.2} cm³ of beads in a part of {volume:.2} cm³, {cpu:.2} s of processor time");
    println!("{:?}", path.figures);
    assert!((26.0..=30.0).contains(&cm3), "{cm3} cm³");

    // Centre lines lie half a bead (less the slack of a hundredth) inside the exact section, and a
    // wall has one at that distance, or as near to it as one has room: where the outline turns
    // sharper than a bead there is none nearer.
    let inset = 0.5 * (0.5 - INSET_SLACK);
    let mut tips: Vec<f64> = Vec::new();
    for m in path.moves.iter().filter(|m| m.kind == MoveKind::Deposit) {
        if tips.last().is_none_or(|z| m.tip.z > z + 1e-6) {
            tips.push(m.tip.z);
        }
    }
    let (mut at_wall, mut all, mut least) = (0, 0, f64::INFINITY);
    for k in (3..tips.len() - 3).step_by(tips.len() / 12) {
        let z = tips[k];
        let walls = section_walls(&mesh, z - 0.1);
        let beads: Vec<(DVec2, DVec2)> = path
            .moves
            .windows(2)
            .filter(|w| w[1].kind == MoveKind::Deposit && (w[1].tip.z - z).abs() < 1e-6)
            .map(|w| (w[0].tip.truncate(), w[1].tip.truncate()))
            .collect();
        for b in &beads {
            let gap = walls.iter().map(|w| apart(b.1, (w.a, w.b))).fold(f64::INFINITY, f64::min);
            least = least.min(gap);
        }
        for w in &walls {
            let middle = (w.a + w.b) / 2.0;
            let gap = beads.iter().map(|b| apart(middle, *b)).fold(f64::INFINITY, f64::min);
            all += 1;
            assert!(gap >= inset - 0.02, "{middle} at {z}: {gap}");
            if gap <= inset + 0.02 {
                at_wall += 1;
                continue;
            }
            let nearest = nearest_place(middle, inset, gap, &walls);
            assert!(gap <= nearest + 0.02, "{middle} at {z}: {gap}, there is room at {nearest}");
        }
    }
    let share = f64::from(at_wall) / f64::from(all);
    println!(
        "least inset {least:.4} mm of {inset}; {share:.4} of {all} walls within 0.02 mm of it"
    );
    assert!(least > inset - 0.02, "{least}");
    assert!(share > 0.99, "{share}");
}

/// Processor seconds of this process so far, where the system tells.
fn cpu_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields: Vec<&str> = stat.rsplit(") ").next().unwrap_or("").split(' ').collect();
    fields.get(11).and_then(|t| t.parse::<f64>().ok()).unwrap_or(0.0) / 100.0
}
