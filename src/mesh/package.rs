//! 3D Manufacturing Format (3MF): the objects that the build places, with their components and
//! transforms, in one mesh.
//!
//! Method: the model part is inflated as a stream and its XML read event by event; the mesh is
//! placed afterwards. Guarantees: the file's own unit is honoured; what a hostile archive can make
//! the program inflate, nest or instance is bounded (`MAX_INFLATED`, `DEEPEST`, `MAX_PLACED`); components in other parts (production extension) are followed.
//! Not read: beam lattices, slices, volumetric data; colours and materials are passed over.

use super::error::{Defect, Fault, Place, shown};
use super::instance::{Component, Model, Object, Pose, place};
use super::tri::TriMesh;
use crate::base::DVec3;
use quick_xml::events::{BytesStart, Event};
use quick_xml::{Reader, XmlVersion};
use std::collections::BTreeMap;
use std::io::{self, BufRead, BufReader, Cursor, Read};
use zip::ZipArchive;

/// Bytes of XML read in all. A triangle and its vertices take some 80 bytes, so this admits 12
/// million triangles; more lets a hostile file take minutes, less refuses fine scans.
const MAX_INFLATED: u64 = 1 << 30;
/// Ratio that no mesh's XML reaches (5 to 40 is usual, deflate's bound 1032), and the size below
/// which it does not matter. Smaller values refuse regular lattices, larger ones admit bombs.
const MAX_RATIO: u64 = 100;
const RATIO_FREE: u64 = 64 << 20;
/// Elements within elements; the format itself nests seven.
const DEEPEST_ELEMENT: usize = 256;

type Archive<'a> = ZipArchive<Cursor<&'a [u8]>>;

pub(super) fn read(bytes: &[u8], mm_per_unit: f64) -> Result<TriMesh, Fault> {
    let damaged =
        |e: zip::result::ZipError| (Place::File, Defect::Archive(shown(e.to_string().as_bytes())));
    let mut archive = ZipArchive::new(Cursor::new(bytes)).map_err(damaged)?;
    let mut budget = MAX_INFLATED;
    let root = root_part(&mut archive, &mut budget)?;
    let mut models = BTreeMap::new();
    let mut wanted = vec![root.clone()];
    while let Some(name) = wanted.pop() {
        if models.contains_key(&name) {
            continue;
        }
        let model = read_model(&mut archive, &name, &mut budget)?;
        let paths = model.objects.values().flat_map(|o| &o.components).chain(&model.items);
        wanted.extend(paths.filter_map(|c| c.path.clone()));
        models.insert(name, model);
    }
    place(&models, &root, mm_per_unit)
}

/// The part that the package's relationships name as the model; without them, the only model.
fn root_part(archive: &mut Archive, budget: &mut u64) -> Result<String, Fault> {
    const RELATIONSHIPS: &str = "_rels/.rels";
    let mut root = None;
    if find(archive, RELATIONSHIPS).is_some() {
        parse(archive, RELATIONSHIPS, budget, |element| {
            let is_model = attribute(element, "Type")?.is_some_and(|t| t.ends_with("/3dmodel"));
            if element.local_name().as_ref() == "Relationship" && is_model && root.is_none() {
                root = attribute(element, "Target")?.map(|t| part_name(&t));
            }
            Ok(())
        })?;
    }
    if let Some(root) = root {
        return Ok(root);
    }
    let names = archive.file_names().filter_map(Result::ok);
    let mut models = names.filter(|n| n.to_ascii_lowercase().ends_with(".model"));
    match (models.next(), models.next()) {
        (Some(only), None) => Ok(only.into_owned()),
        _ => Err((Place::File, Defect::NoModel)),
    }
}

/// Part names are absolute in relationships and relative in the archive.
fn part_name(target: &str) -> String {
    target.trim_start_matches('/').to_string()
}

/// The archive's index of a part; part names ignore case.
fn find(archive: &Archive, name: &str) -> Option<usize> {
    archive.index_for_name(name).or_else(|| {
        let same = |n: &str| n.eq_ignore_ascii_case(name);
        archive.file_names().position(|n| n.is_ok_and(|n| same(&n)))
    })
}

/// A reader that stops, with an error, where an inflating part becomes absurd.
struct Bounded<'a, R> {
    inner: R,
    packed: u64,
    inflated: u64,
    budget: &'a mut u64,
    /// Set when the bound was passed.
    burst: &'a std::cell::Cell<bool>,
}

impl<R: Read> Read for Bounded<'_, R> {
    fn read(&mut self, buf: &mut [u8]) -> io::Result<usize> {
        let n = self.inner.read(buf)?;
        self.inflated += n as u64;
        if n as u64 > *self.budget || is_bomb(self.packed, self.inflated) {
            self.burst.set(true);
            return Err(io::Error::other("too large"));
        }
        *self.budget -= n as u64;
        Ok(n)
    }
}

fn is_bomb(packed: u64, inflated: u64) -> bool {
    inflated > RATIO_FREE && inflated / MAX_RATIO > packed
}

/// Streams the part `name` through `visit`, which is handed each element as it opens.
fn parse(
    archive: &mut Archive,
    name: &str,
    budget: &mut u64,
    mut visit: impl FnMut(&BytesStart) -> Result<(), Defect>,
) -> Result<(), Fault> {
    let entry = |byte| Place::Entry { name: shown(name.as_bytes()), byte };
    let missing = || (entry(0), Defect::Archive("the part is missing".to_string()));
    let index = find(archive, name).ok_or_else(missing)?;
    let file = archive
        .by_index(index)
        .map_err(|e| (entry(0), Defect::Archive(shown(e.to_string().as_bytes()))))?;
    let (packed, declared) = (file.compressed_size(), file.size());
    let bomb =
        |inflated| (Place::File, Defect::Bomb { name: shown(name.as_bytes()), packed, inflated });
    if declared > *budget || is_bomb(packed, declared) {
        return Err(bomb(declared));
    }
    let burst = std::cell::Cell::new(false);
    let bounded = Bounded { inner: file, packed, inflated: 0, budget, burst: &burst };
    let mut reader = Reader::from_reader(BufReader::new(bounded));
    match events(&mut reader, &mut visit) {
        Ok(()) => Ok(()),
        Err(_) if burst.get() => Err(bomb(reader.get_ref().get_ref().inflated)),
        Err(defect) => Err((entry(reader.buffer_position()), defect)),
    }
}

fn events<R: BufRead>(
    reader: &mut Reader<R>,
    visit: &mut impl FnMut(&BytesStart) -> Result<(), Defect>,
) -> Result<(), Defect> {
    let mut buffer = Vec::new();
    let mut depth = 0;
    loop {
        buffer.clear();
        match reader.read_event_into(&mut buffer).map_err(unreadable)? {
            Event::Start(element) => {
                visit(&element)?;
                depth += 1;
                if depth > DEEPEST_ELEMENT {
                    return Err(Defect::Xml(format!(
                        "more than {DEEPEST_ELEMENT} elements nested"
                    )));
                }
            }
            Event::Empty(element) => visit(&element)?,
            Event::End(_) => depth -= 1,
            Event::Eof if depth > 0 => {
                return Err(Defect::Truncated { expecting: "a closing tag" });
            }
            Event::Eof => return Ok(()),
            _ => {}
        }
    }
}

/// Faults of the archive below come through the XML reader.
fn unreadable(e: quick_xml::Error) -> Defect {
    match e {
        quick_xml::Error::Io(e) => Defect::Archive(shown(e.to_string().as_bytes())),
        e => xml(e),
    }
}

fn xml(e: impl std::fmt::Display) -> Defect {
    Defect::Xml(shown(e.to_string().as_bytes()))
}

fn attribute(element: &BytesStart, name: &str) -> Result<Option<String>, Defect> {
    let found = element.try_get_attribute(name).map_err(xml)?;
    found
        .map(|a| a.normalized_value(XmlVersion::Implicit1_0).map(|v| v.into_owned()).map_err(xml))
        .transpose()
}

/// A required attribute parsed as a number or index.
fn parsed<T: std::str::FromStr>(
    element: &BytesStart,
    name: &str,
    expected: &'static str,
) -> Result<T, Defect> {
    let text = attribute(element, name)?
        .ok_or_else(|| Defect::Unexpected { expected, found: format!("a missing {name}") })?;
    text.trim().parse().map_err(|_| Defect::Unexpected { expected, found: shown(text.as_bytes()) })
}

fn read_model(archive: &mut Archive, name: &str, budget: &mut u64) -> Result<Model, Fault> {
    let mut model = Model { mm_per_unit: 1.0, ..Model::default() };
    let mut object: Option<String> = None;
    parse(archive, name, budget, |element| {
        let local = element.local_name();
        match local.as_ref() {
            "model" => model.mm_per_unit = unit(attribute(element, "unit")?.as_deref())?,
            "object" => {
                let id: String = parsed(element, "id", "an object's id")?;
                model.objects.insert(id.clone(), Object::default());
                object = Some(id);
            }
            "build" => object = None,
            "item" => model.items.push(component(element)?),
            inside => {
                if let Some(object) = object.as_ref().and_then(|id| model.objects.get_mut(id)) {
                    part_of(object, inside, element)?;
                }
            }
        }
        Ok(())
    })?;
    Ok(model)
}

/// Takes up an element found inside an object.
fn part_of(object: &mut Object, name: &str, element: &BytesStart) -> Result<(), Defect> {
    match name {
        "vertex" => {
            let of = |axis| parsed::<f64>(element, axis, "a coordinate");
            object.vertices.push(DVec3::new(of("x")?, of("y")?, of("z")?));
        }
        "triangle" => {
            let of = |corner| parsed::<i64>(element, corner, "a vertex number");
            let corners = [of("v1")?, of("v2")?, of("v3")?];
            let mut triangle = [0; 3];
            for (index, t) in corners.into_iter().zip(&mut triangle) {
                // The vertices of an object come before its triangles.
                let vertices = object.vertices.len();
                *t = u32::try_from(index)
                    .ok()
                    .filter(|i| (*i as usize) < vertices)
                    .ok_or(Defect::IndexOutOfRange { index, base: 0, vertices })?;
            }
            object.triangles.push(triangle);
        }
        "component" => object.components.push(component(element)?),
        _ => {}
    }
    Ok(())
}

fn unit(name: Option<&str>) -> Result<f64, Defect> {
    Ok(match name {
        None | Some("millimeter") => 1.0,
        Some("micron") => 0.001,
        Some("centimeter") => 10.0,
        Some("inch") => 25.4,
        Some("foot") => 304.8,
        Some("meter") => 1000.0,
        Some(other) => {
            let found = shown(other.as_bytes());
            return Err(Defect::Unexpected { expected: "a unit of 3MF", found });
        }
    })
}

/// A `component` or a build `item`: an object placed.
fn component(element: &BytesStart) -> Result<Component, Defect> {
    let object = parsed(element, "objectid", "an object's id")?;
    let pose = match attribute(element, "transform")? {
        Some(text) => transform(&text)?,
        None => Pose::IDENTITY,
    };
    let mut path = None;
    for a in element.attributes().with_checks(false) {
        let a = a.map_err(xml)?;
        // The prefix of the production extension is the writer's choice.
        if a.key.local_name().as_ref() == "path" {
            path = Some(part_name(&a.value));
        }
    }
    Ok(Component { object, path, pose })
}

/// Twelve numbers: the rows of a matrix that row vectors are multiplied with, so that its rows are
/// the images of the axes and the last is the translation.
fn transform(text: &str) -> Result<Pose, Defect> {
    let unexpected = || Defect::Unexpected {
        expected: "a transform of 12 numbers",
        found: shown(text.as_bytes()),
    };
    let mut m = [0.0; 12];
    let mut words = text.split_ascii_whitespace();
    for value in &mut m {
        *value = words.next().and_then(|w| w.parse().ok()).ok_or_else(unexpected)?;
        if !f64::is_finite(*value) {
            return Err(unexpected());
        }
    }
    if words.next().is_some() {
        return Err(unexpected());
    }
    Ok(Pose::from_cols_array(&m))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_transform_lists_the_images_of_the_axes_and_then_the_shift() {
        // A quarter turn about z, then a shift by (5, 6, 7).
        let pose = transform("0 1 0  -1 0 0  0 0 1  5 6 7").unwrap();
        assert_eq!(pose.transform_point3(DVec3::X), DVec3::new(5.0, 7.0, 7.0));
        assert!(transform("1 0 0 0 1 0 0 0 1 0 0").is_err());
        assert!(transform("1 0 0 0 1 0 0 0 1 0 0 nan").is_err());
    }

    #[test]
    fn only_large_parts_that_inflate_absurdly_are_bombs() {
        assert!(!is_bomb(1 << 10, 1 << 20));
        assert!(is_bomb(1 << 20, (1 << 27) + 200));
        assert!(!is_bomb(1 << 21, 1 << 27));
    }
}
