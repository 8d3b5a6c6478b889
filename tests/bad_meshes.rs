//! Every way a mesh file can be broken ends in one message that names the file and the remedy:
//! no panic, no endless memory.

use hmplan::base::DVec3;
use hmplan::mesh::{Defect, ReadOptions, TriMesh, read, write_obj, write_stl};
use proptest::prelude::*;
use std::io::{Cursor, Write};
use std::path::Path;
use zip::CompressionMethod;
use zip::write::SimpleFileOptions;

/// Name, content, and words that the message must hold besides the file's name.
type Case = (&'static str, Vec<u8>, &'static str);

const RELS: &str = r#"<?xml version="1.0"?><Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships"><Relationship Target="/3D/3dmodel.model" Id="r" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>"#;
const TRIANGLE_XML: &str = r#"<object id="1" type="model"><mesh><vertices><vertex x="0" y="0" z="0"/><vertex x="9" y="0" z="0"/><vertex x="0" y="9" z="0"/></vertices><triangles><triangle v1="0" v2="1" v3="2"/></triangles></mesh></object>"#;
const ITEM_XML: &str = r#"<item objectid="1"/>"#;
const VERTEX_XML: &[u8] = br#"<vertex x="0" y="0" z="0"/>"#;

fn model(resources: &str, build: &str) -> String {
    format!(
        r#"<model unit="millimeter" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"><resources>{resources}</resources><build>{build}</build></model>"#
    )
}

fn archive(method: CompressionMethod, parts: &[(&str, &[u8])]) -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for (name, content) in parts {
        zip.start_file(*name, SimpleFileOptions::default().compression_method(method)).unwrap();
        zip.write_all(content).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

fn deflated(parts: &[(&str, &[u8])]) -> Vec<u8> {
    archive(CompressionMethod::Deflated, parts)
}

fn package(model: &str) -> Vec<u8> {
    deflated(&[("_rels/.rels", RELS.as_bytes()), ("3D/3dmodel.model", model.as_bytes())])
}

/// An archive whose model goes on with `filler` for 80 MB.
fn bomb(filler: &[u8]) -> Vec<u8> {
    let mut content = b"<model><resources><object id=\"1\"><mesh><vertices>".to_vec();
    content.extend(filler.repeat((80 << 20) / filler.len()));
    deflated(&[("3D/3dmodel.model", &content)])
}

/// The bomb with its size understated in the central directory, so that only counting the bytes
/// as they come can stop it.
fn lying_bomb() -> Vec<u8> {
    let mut bytes = bomb(VERTEX_XML);
    let central = bytes.windows(4).rposition(|w| w == b"PK\x01\x02").unwrap();
    bytes[central + 24..central + 28].copy_from_slice(&1000u32.to_le_bytes());
    bytes
}

fn binary_stl(declared: u32, triangles: &[[f32; 9]]) -> Vec<u8> {
    let mut bytes = vec![b'x'; 80];
    bytes.extend(declared.to_le_bytes());
    for t in triangles {
        bytes.extend([0; 12]);
        t.iter().for_each(|c| bytes.extend(c.to_le_bytes()));
        bytes.extend([0; 2]);
    }
    bytes
}

fn ply(format: &str, vertices: &str, faces: &str, body: &[u8]) -> Vec<u8> {
    let header = format!(
        "ply\nformat {format} 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\n\
         property float z\nelement face {faces}\nproperty list uchar int vertex_indices\nend_header\n"
    );
    [header.as_bytes(), body].concat()
}

fn any_format_cases() -> Vec<Case> {
    let junk = b"It was a dark and stormy night.\n".repeat(9);
    let noise: Vec<u8> = (0..999u32).map(|i| (i * i % 251) as u8).collect();
    vec![
        ("empty.obj", vec![], "empty"),
        ("empty.stl", vec![], "empty"),
        ("blank.off", b" \n\r\n\t".to_vec(), "empty"),
        ("junk.obj", junk.clone(), "no faces"),
        ("junk.stl", junk.clone(), "not recognised"),
        ("junk.ply", junk.clone(), "not recognised"),
        ("junk.off", junk.clone(), "line 1"),
        ("junk.3mf", junk.clone(), "not recognised"),
        ("junk", junk, "not recognised"),
        ("noise.obj", noise, "not recognised"),
        ("utf16.obj", b"\xff\xfev\x00 \x000\x00".to_vec(), "UTF-16"),
        ("step.obj", b"ISO-10303-21;\nHEADER;\n".to_vec(), "STEP"),
        ("page.stl", b"<!DOCTYPE html><html>404</html>".to_vec(), "HTML"),
    ]
}

fn obj_cases() -> Vec<Case> {
    let after = |text: &str| format!("v 0 0 0\nv 1 0 0\nv 0 1 0\n{text}\n").into_bytes();
    let zigzag: String = (0..3000).map(|i| format!("v {} {i} 0\n", i % 2 * 5 + i / 7)).collect();
    let face: String = (1..=3000).map(|i| format!(" {i}")).collect();
    vec![
        ("cloud.obj", after(""), "no faces"),
        ("nan.obj", after("v nan 0 0\nf 1 2 3"), "line 4"),
        ("inf.obj", after("v 0 -inf 0\nf 1 2 3"), "line 4"),
        ("huge.obj", after("v 0 0 1e300\nf 1 2 4"), "line 4"),
        ("overflow.obj", after("v 0 0 1e999\nf 1 2 4"), "line 4"),
        ("word.obj", after("v 0 zero 0\nf 1 2 3"), "\"zero\""),
        ("short_vertex.obj", after("v 0 0\nf 1 2 3"), "line 4"),
        ("two_corners.obj", after("f 1 2"), "2 corners"),
        ("no_corners.obj", after("f"), "0 corners"),
        ("zero_index.obj", after("f 0 1 2"), "vertex 0"),
        ("large_index.obj", after("f 1 2 4"), "line 4"),
        ("huge_index.obj", after("f 1 2 99999999999"), "99999999999"),
        ("endless_index.obj", after("f 1 2 99999999999999999999"), "line 4"),
        ("least_index.obj", after("f 1 2 -9223372036854775808"), "line 4"),
        ("far_back.obj", after("f -1 -2 -4"), "vertex -4"),
        ("half_index.obj", after("f 1 2 /3"), "line 4"),
        ("not_utf8.obj", [&after("f 1 2 ")[..29], b"\xff\xfe\n"].concat(), "line 4"),
        ("zigzag.obj", format!("{zigzag}f{face}\n").into_bytes(), "3000 corners"),
    ]
}

fn stl_cases() -> Vec<Case> {
    const FACET: &str = "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n\
                         endloop\nendfacet\n";
    let solid = |body: &str| format!("solid a\n{body}endsolid a\n").into_bytes();
    let cut = format!("solid a\n{FACET}facet normal 0 0 1\nouter loop\nvertex 0");
    let t = [0., 0., 0., 1., 0., 0., 0., 1., 0.];
    let nan = [0., 0., 0., f32::NAN, 0., 0., 0., 1., 0.];
    let far = [0., 0., 0., 1e38, 0., 0., 0., 1., 0.];
    vec![
        ("nothing.stl", solid(""), "no faces"),
        ("cut.stl", cut.into_bytes(), "line 11"),
        ("no_end.stl", format!("solid a\n{FACET}").into_bytes(), "endsolid"),
        ("typo.stl", solid(&FACET.replace("endloop", "endlop")), "line 7"),
        ("nan.stl", solid(&FACET.replace("1 0 0", "1 NaN 0")), "line 5"),
        ("thin.stl", solid(&FACET.replace("vertex 0 1 0\n", "")), "2 corners"),
        ("after.stl", format!("solid a\n{FACET}endsolid\nhello\n").into_bytes(), "line 10"),
        ("counts.stl", binary_stl(u32::MAX, &[t; 20]), "4294967295"),
        ("cut_binary.stl", binary_stl(3, &[t; 2]), "cut short"),
        ("short.stl", vec![0; 40], "84-byte"),
        ("zeros.stl", vec![0; 4096], "declares 0"),
        ("none.stl", binary_stl(0, &[]), "no faces"),
        ("surplus.stl", binary_stl(1, &[t; 9]), "400 bytes"),
        ("nan_binary.stl", binary_stl(2, &[t, nan]), "triangle 1"),
        ("far_binary.stl", binary_stl(2, &[t, far]), "triangle 1"),
    ]
}

fn off_cases() -> Vec<Case> {
    let off = |counts: &str, face: &str| {
        format!("OFF\n{counts}\n0 0 0\n1 0 0\n0 1 0\n{face}").into_bytes()
    };
    vec![
        ("cut.off", off("4 1 0", ""), "cut short"),
        ("cut_number.off", off("3 1 0", "3 0 1"), "line 6"),
        ("counts.off", off("4294967295 4294967295 0", ""), "4294967295"),
        ("faces.off", off("3 4294967295 0", ""), "4294967295"),
        ("endless.off", off("99999999999999999999 1 0", ""), "line 2"),
        ("negative.off", off("-3 1 0", ""), "line 2"),
        ("corners.off", off("3 1 0", "4000000000 0 1 2\n"), "line 6"),
        ("minus.off", off("3 1 0", "-3 0 1 2\n"), "line 6"),
        ("index.off", off("3 1 0", "3 0 1 3\n"), "vertex 3"),
        ("back.off", off("3 1 0", "3 0 1 -1\n"), "vertex -1"),
        ("two.off", off("3 1 0", "2 0 1   \n"), "2 corners"),
        ("none.off", off("3 0 0", ""), "no faces"),
        ("binary.off", b"OFF BINARY\n\0\0\0\x03".to_vec(), "binary OFF"),
        ("four.off", b"4OFF\n1 1 0\n".to_vec(), "not three-dimensional"),
        ("header_only.off", b"OFF".to_vec(), "cut short"),
    ]
}

fn ply_cases() -> Vec<Case> {
    const BINARY: &str = "binary_little_endian";
    const TEXT: &[u8] = b"0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
    let vertices: Vec<u8> =
        [0f32, 0., 0., 1., 0., 0., 0., 1., 0.].iter().flat_map(|c| c.to_le_bytes()).collect();
    let with = |face: &[u8]| [&vertices[..], face].concat();
    let good = String::from_utf8(ply("ascii", "3", "1", TEXT)).unwrap();
    let edit = |from: &str, to: &str| good.replace(from, to).into_bytes();
    vec![
        ("header.ply", b"ply\nformat ascii 1.0\nelement vertex 3\n".to_vec(), "end_header"),
        ("format.ply", edit("ascii", "utf8"), "line 2"),
        ("no_format.ply", edit("format ascii 1.0\n", ""), "format"),
        ("type.ply", edit("float y", "quad y"), "line 5"),
        ("orphan.ply", edit("element vertex 3\n", ""), "line 3"),
        ("flat.ply", edit("property float z\n", ""), "x, y and z"),
        ("float_list.ply", edit("list uchar", "list float"), "line 8"),
        ("no_list.ply", edit("list uchar int vertex_indices", "int a"), "vertex_indices"),
        ("line.ply", edit("end_header", "begin"), "line 9"),
        ("number.ply", edit("1 0 0", "1 o 0"), "line 11"),
        ("nan.ply", edit("1 0 0", "1 nan 0"), "line 11"),
        ("index.ply", edit("3 0 1 2", "3 0 1 9"), "vertex 9"),
        ("back.ply", edit("3 0 1 2", "3 0 1 -2"), "vertex -2"),
        ("long.ply", edit("3 0 1 2", "200 0 1 2"), "line 13"),
        ("thin.ply", edit("3 0 1 2", "2 0 1   "), "2 corners"),
        ("cloud.ply", ply("ascii", "3", "0", &TEXT[..18]), "no faces"),
        ("cut.ply", edit("3 0 1 2", "3 0 10"), "cut short"),
        ("counts.ply", ply("ascii", "4294967295", "4294967295", TEXT), "4294967295"),
        ("counts_binary.ply", ply(BINARY, "4294967295", "1", &vertices), "4294967295"),
        ("faces_binary.ply", ply(BINARY, "3", "4294967295", &with(&[3, 0, 0])), "4294967295"),
        ("endless.ply", ply("ascii", "99999999999999999999", "1", TEXT), "line 3"),
        ("negative.ply", ply("ascii", "-1", "1", TEXT), "line 3"),
        ("cut_binary.ply", ply(BINARY, "3", "1", &with(&[3, 0, 0, 0, 0, 1])), "cut short"),
        ("list_binary.ply", ply(BINARY, "3", "1", &with(&[255, 0, 0, 0, 0, 1])), "face 0"),
        ("nan_binary.ply", ply(BINARY, "3", "1", &[0xff; 60]), "vertex 0"),
        ("strips.ply", edit("element face 1", "element tristrips 1"), "strips"),
    ]
}

fn package_cases() -> Vec<Case> {
    let good = package(&model(TRIANGLE_XML, ITEM_XML));
    let edit = |from: &str, to: &str| package(&model(TRIANGLE_XML, ITEM_XML).replace(from, to));
    let doubled: String = (2..60)
        .map(|i| {
            let c = format!(r#"<component objectid="{}"/>"#, i - 1);
            format!(r#"<object id="{i}"><components>{c}{c}</components></object>"#)
        })
        .collect();
    let doublings = model(&(TRIANGLE_XML.to_string() + &doubled), r#"<item objectid="59"/>"#);
    let itself = r#"<object id="1"><components><component objectid="1"/></components></object>"#;
    let other = deflated(&[("a.txt", b"hello")]);
    vec![
        ("cut.3mf", good[..good.len() / 2].to_vec(), "archive is damaged"),
        ("magic.3mf", b"PK\x03\x04".to_vec(), "archive is damaged"),
        ("other.3mf", other.clone(), "without a 3D model"),
        ("renamed.stl", other, "without a 3D model"),
        ("missing.3mf", deflated(&[("_rels/.rels", RELS.as_bytes())]), "the part is missing"),
        ("xml.3mf", package("<model></resources></model>"), "XML is damaged"),
        ("cut_xml.3mf", package("<model><resources><object id=\"1\">"), "cut short"),
        (
            "not_utf8.3mf",
            deflated(&[("a.model", b"<model><a \xff\xff=\"1\"/></model>")]),
            "a.model",
        ),
        ("nested.3mf", package(&"<a>".repeat(100_000)), "nested"),
        ("nothing.3mf", package(&model("", "")), "no faces"),
        ("no_mesh.3mf", package(&model(r#"<object id="1"/>"#, ITEM_XML)), "no faces"),
        ("unit.3mf", edit("millimeter", "furlong"), "furlong"),
        ("nan.3mf", edit("x=\"9\"", "x=\"nan\""), "finite"),
        ("far.3mf", edit("x=\"9\"", "x=\"1e300\""), "finite"),
        ("word.3mf", edit("x=\"9\"", "x=\"nine\""), "\"nine\""),
        ("no_axis.3mf", edit("x=\"9\"", ""), "missing x"),
        ("index.3mf", edit("v3=\"2\"", "v3=\"3\""), "vertex 3"),
        ("back.3mf", edit("v3=\"2\"", "v3=\"-1\""), "vertex -1"),
        ("item.3mf", edit("objectid=\"1\"", "objectid=\"7\""), "object 7"),
        ("pose.3mf", edit("objectid=\"1\"", "objectid=\"1\" transform=\"1 0 0\""), "12 numbers"),
        ("itself.3mf", package(&model(itself, ITEM_XML)), "part of itself"),
        ("doublings.3mf", package(&doublings), "triangles in all"),
        ("bomb.3mf", bomb(VERTEX_XML), "inflates"),
        ("space_bomb.3mf", bomb(b" "), "inflates"),
        ("lying_bomb.3mf", lying_bomb(), "larger than its decla"),
    ]
}

fn message(path: &Path) -> String {
    match read(path, &ReadOptions::default()) {
        Ok(loaded) => panic!("{} loads as {}", path.display(), loaded.format),
        Err(error) => error.to_string(),
    }
}

#[test]
fn every_broken_file_gets_one_clear_message() {
    let dir = tempfile::tempdir().unwrap();
    let groups = [any_format_cases, obj_cases, stl_cases, off_cases, ply_cases, package_cases];
    let mut count = 0;
    for (name, content, words) in groups.iter().flat_map(|cases| cases()) {
        count += 1;
        let path = dir.path().join(name);
        std::fs::write(&path, content).unwrap();
        let message = message(&path);
        assert!(message.contains(name) && message.contains(words), "{name}: {message}");
        // What, then how to mend; one line, short enough to read.
        assert!(message.contains(';'), "{message}");
        assert!(message.len() - dir.path().as_os_str().len() < 320, "{message}");
        assert!(!message.chars().any(char::is_control), "{message:?}");
    }
    assert!(count >= 100, "{count}");
}

#[test]
fn paths_that_are_no_files_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let missing = message(&dir.path().join("nowhere.stl"));
    assert!(missing.contains("nowhere.stl: there is no such file"), "{missing}");
    let folder = dir.path().join("folder.stl");
    std::fs::create_dir(&folder).unwrap();
    assert!(message(&folder).contains("folder.stl: is a directory"));
    #[cfg(unix)]
    assert!(message(Path::new("/dev/null")).contains("not a regular file"));
}

#[test]
fn files_too_large_are_refused_unread() {
    let dir = tempfile::tempdir().unwrap();
    // Sparse: they take no disk, and reading them would take gigabytes of memory.
    for (name, start, size, words) in [
        ("large.off", &b"OFF\n"[..], 3u64 << 30, "more than the 2147483648"),
        ("zeros.stl", &b"\0"[..], 2_000_000_000, "declares 0 triangles"),
        ("zeros.obj", &b"\0"[..], 2_000_000_000, "not recognised"),
    ] {
        let path = dir.path().join(name);
        let mut file = std::fs::File::create(&path).unwrap();
        file.write_all(start).unwrap();
        file.set_len(size).unwrap();
        assert!(message(&path).contains(words), "{}", message(&path));
    }
}

#[test]
fn factors_that_make_no_size_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("part.stl");
    let part = TriMesh::cuboid(DVec3::ZERO, DVec3::ONE);
    write_stl(&part, std::fs::File::create(&path).unwrap()).unwrap();
    for mm_per_unit in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let error = read(&path, &ReadOptions { mm_per_unit }).unwrap_err();
        assert!(matches!(error.defect, Defect::BadScale(_)), "{error}");
    }
    let error = read(&path, &ReadOptions { mm_per_unit: 1e12 }).unwrap_err();
    assert!(matches!(error.defect, Defect::Coordinate { .. }), "{error}");
}

/// Sound files of every format, to be damaged.
fn sound() -> Vec<(&'static str, Vec<u8>)> {
    const TEXT: &[u8] = b"0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
    let part = TriMesh::cuboid(DVec3::ZERO, DVec3::ONE);
    let (mut stl, mut obj) = (Vec::new(), Vec::new());
    write_stl(&part, &mut stl).unwrap();
    write_obj(&part, &mut obj).unwrap();
    let text_stl = "solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\n\
                    vertex 0 1 0\nendloop\nendfacet\nendsolid";
    let big: Vec<u8> = [0f32, 0., 0., 1., 0., 0., 0., 1., 0.]
        .iter()
        .flat_map(|c| c.to_be_bytes())
        .chain([3, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 2])
        .collect();
    let xml = model(TRIANGLE_XML, ITEM_XML);
    vec![
        ("a.stl", stl),
        ("a.obj", obj),
        ("b.stl", text_stl.into()),
        ("a.ply", ply("ascii", "3", "1", TEXT)),
        ("b.ply", ply("binary_big_endian", "3", "1", &big)),
        ("a.off", [b"OFF\n3 1 0\n", TEXT].concat()),
        ("a.3mf", package(&xml)),
        ("b.3mf", archive(CompressionMethod::Stored, &[("a.model", xml.as_bytes())])),
    ]
}

#[test]
fn undamaged_they_all_load() {
    let dir = tempfile::tempdir().unwrap();
    for (name, bytes) in sound() {
        let path = dir.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        read(&path, &ReadOptions::default()).unwrap();
    }
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 400,
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    /// Cut anywhere and with bytes changed anywhere, a file gives a mesh or a message.
    #[test]
    fn damaged_files_never_panic(
        which in 0usize..8,
        cut in 0.0f64..1.5,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6),
    ) {
        let dir = tempfile::tempdir().unwrap();
        let (name, mut bytes) = sound().swap_remove(which);
        bytes.truncate((bytes.len() as f64 * cut) as usize);
        if !bytes.is_empty() {
            changes.iter().for_each(|(i, b)| {
                let at = i.index(bytes.len());
                bytes[at] = *b;
            });
        }
        let path = dir.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        match read(&path, &ReadOptions::default()) {
            Ok(loaded) => prop_assert!(!loaded.mesh.is_empty()),
            Err(e) => prop_assert!(e.to_string().contains(name)),
        }
    }
}
