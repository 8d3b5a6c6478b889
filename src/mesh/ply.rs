//! Polygon File Format (Stanford PLY): text and binary of either byte order.
//!
//! Method: the header says what follows; vertices are the `x`, `y`, `z` of element `vertex`, faces
//! the list `vertex_indices` or `vertex_index` of element `face`, all else is stepped over.
//! Guarantees: every declared count is checked against the bytes that follow before it is used.
//! Not read: triangle strips.

use super::error::{Defect, Fault, Place, shown};
use super::soup::Soup;
use super::text::{Tokens, check_count, integer, number};
use super::tri::TriMesh;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn named(name: &[u8]) -> Option<Self> {
        Some(match name {
            b"char" | b"int8" => Scalar::I8,
            b"uchar" | b"uint8" => Scalar::U8,
            b"short" | b"int16" => Scalar::I16,
            b"ushort" | b"uint16" => Scalar::U16,
            b"int" | b"int32" => Scalar::I32,
            b"uint" | b"uint32" => Scalar::U32,
            b"float" | b"float32" => Scalar::F32,
            b"double" | b"float64" => Scalar::F64,
            _ => return None,
        })
    }

    fn bytes(self) -> u64 {
        match self {
            Scalar::I8 | Scalar::U8 => 1,
            Scalar::I16 | Scalar::U16 => 2,
            Scalar::I32 | Scalar::U32 | Scalar::F32 => 4,
            Scalar::F64 => 8,
        }
    }

    fn is_integer(self) -> bool {
        !matches!(self, Scalar::F32 | Scalar::F64)
    }

    /// The value of little-endian `b`; integers of 32 bits are exact in `f64`.
    fn value(self, b: [u8; 8]) -> f64 {
        let [b0, b1, b2, b3, ..] = b;
        match self {
            Scalar::I8 => f64::from(b0 as i8),
            Scalar::U8 => f64::from(b0),
            Scalar::I16 => f64::from(i16::from_le_bytes([b0, b1])),
            Scalar::U16 => f64::from(u16::from_le_bytes([b0, b1])),
            Scalar::I32 => f64::from(i32::from_le_bytes([b0, b1, b2, b3])),
            Scalar::U32 => f64::from(u32::from_le_bytes([b0, b1, b2, b3])),
            Scalar::F32 => f64::from(f32::from_le_bytes([b0, b1, b2, b3])),
            Scalar::F64 => f64::from_le_bytes(b),
        }
    }
}

/// What is done with a property's values.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Role {
    Axis(usize),
    Corners,
    Ignored,
}

struct Property {
    /// The type of the list's length, when it is a list.
    count: Option<Scalar>,
    scalar: Scalar,
    role: Role,
}

struct Element {
    name: String,
    count: u64,
    properties: Vec<Property>,
    place: Place,
}

#[derive(Clone, Copy, PartialEq)]
enum Encoding {
    Text,
    Little,
    Big,
}

pub(super) fn looks_like(start: &[u8]) -> bool {
    start.starts_with(b"ply\n") || start.starts_with(b"ply\r") || start.starts_with(b"ply ")
}

pub(super) fn read(bytes: &[u8], mm_per_unit: f64) -> Result<TriMesh, Fault> {
    let Header { encoding, elements, body, body_line } = header(bytes)?;
    let mut source = match encoding {
        Encoding::Text => Source::Text(Tokens::at_line(body, body_line)),
        _ => Source::Binary { bytes: body, at: 0, big: encoding == Encoding::Big },
    };
    let mut soup = Soup::new(mm_per_unit, 0);
    let mut strips = false;
    for element in &elements {
        strips |= element.name == "tristrips";
        read_element(element, &mut source, &mut soup)?;
    }
    soup.finish().map_err(|(place, defect)| match defect {
        Defect::NoFaces { .. } if strips => {
            let what = "the faces are triangle strips, which are not read".to_string();
            (place, Defect::Unsupported { what, mend: "export the mesh with single faces" })
        }
        defect => (place, defect),
    })
}

struct Header<'a> {
    encoding: Encoding,
    elements: Vec<Element>,
    /// What follows the header, and the number of its first line.
    body: &'a [u8],
    body_line: usize,
}

fn header(bytes: &[u8]) -> Result<Header<'_>, Fault> {
    // A binary body may begin with any byte, so the first line decides what ends a header line.
    let newline: &[u8] = match bytes.iter().position(|b| matches!(b, b'\n' | b'\r')) {
        Some(i) if bytes[i..].starts_with(b"\r\n") => b"\r\n",
        Some(i) => &bytes[i..=i],
        None => b"\n",
    };
    let (mut encoding, mut elements) = (None, Vec::<Element>::new());
    let mut rest = bytes;
    let mut line = 0;
    loop {
        line += 1;
        let place = Place::Line(line);
        let Some(end) = rest.windows(newline.len()).position(|w| w == newline) else {
            return Err((place, Defect::Truncated { expecting: "\"end_header\"" }));
        };
        let words: Vec<&[u8]> =
            rest[..end].split(u8::is_ascii_whitespace).filter(|w| !w.is_empty()).collect();
        rest = &rest[end + newline.len()..];
        let at = |d| (place.clone(), d);
        match words[..] {
            [b"ply"] if line == 1 => {}
            [] | [b"comment" | b"obj_info", ..] => {}
            [b"format", name, ..] => encoding = Some(format_named(name).map_err(at)?),
            [b"element", name, count] => {
                let n = integer(count, "a count").map_err(at)?;
                let unexpected = Defect::Unexpected { expected: "a count", found: shown(count) };
                let count = u64::try_from(n).map_err(|_| at(unexpected))?;
                let name = String::from_utf8_lossy(name).into_owned();
                elements.push(Element { name, count, properties: Vec::new(), place });
            }
            [b"property", ..] => {
                let found = || shown(&words.join(&b' '));
                let expected = "a property of an element";
                let element = elements
                    .last_mut()
                    .ok_or_else(|| at(Defect::Unexpected { expected, found: found() }))?;
                let p = property(&words, &element.name).ok_or_else(|| {
                    at(Defect::Unexpected {
                        expected: "a property this format has",
                        found: found(),
                    })
                })?;
                element.properties.push(p);
            }
            [b"end_header"] => {
                let missing = Defect::Truncated { expecting: "the \"format\" line" };
                let encoding = encoding.ok_or_else(|| at(missing))?;
                return Ok(Header { encoding, elements, body: rest, body_line: line + 1 });
            }
            _ => {
                let found = shown(&words.join(&b' '));
                return Err(at(Defect::Unexpected { expected: "a line of a PLY header", found }));
            }
        }
    }
}

fn format_named(name: &[u8]) -> Result<Encoding, Defect> {
    match name {
        b"ascii" => Ok(Encoding::Text),
        b"binary_little_endian" => Ok(Encoding::Little),
        b"binary_big_endian" => Ok(Encoding::Big),
        _ => Err(Defect::Unexpected { expected: "a PLY format", found: shown(name) }),
    }
}

fn property(words: &[&[u8]], element: &str) -> Option<Property> {
    let (count, scalar, name) = match words {
        [_, b"list", count, scalar, name] => {
            let count = Scalar::named(count).filter(|c| c.is_integer())?;
            (Some(count), Scalar::named(scalar)?, *name)
        }
        [_, scalar, name] => (None, Scalar::named(scalar)?, *name),
        _ => return None,
    };
    let role = match (element, name, count) {
        ("vertex", b"x", None) => Role::Axis(0),
        ("vertex", b"y", None) => Role::Axis(1),
        ("vertex", b"z", None) => Role::Axis(2),
        ("face", b"vertex_indices" | b"vertex_index", Some(_)) if scalar.is_integer() => {
            Role::Corners
        }
        _ => Role::Ignored,
    };
    Some(Property { count, scalar, role })
}

/// The body, as text or bytes.
enum Source<'a> {
    Text(Tokens<'a>),
    Binary { bytes: &'a [u8], at: usize, big: bool },
}

impl Source<'_> {
    fn remaining(&self) -> u64 {
        match self {
            Source::Text(tokens) => tokens.remaining() + 1,
            Source::Binary { bytes, at, .. } => (bytes.len() - at) as u64,
        }
    }

    /// The fewest bytes a value can take; in text a digit and a space.
    fn least_bytes(&self, scalar: Scalar) -> u64 {
        match self {
            Source::Text(_) => 2,
            Source::Binary { .. } => scalar.bytes(),
        }
    }

    fn place(&self, what: &'static str, item: u64) -> Place {
        match self {
            Source::Text(tokens) => tokens.place(),
            Source::Binary { .. } => Place::Item(what, item as usize),
        }
    }

    fn value(&mut self, scalar: Scalar) -> Result<f64, Defect> {
        let truncated = Defect::Truncated { expecting: "a property's value" };
        match self {
            Source::Text(tokens) => {
                let token = tokens.next().ok_or(truncated)?;
                if scalar.is_integer() {
                    // Beyond 2^53 rounding would make a wrong number look right.
                    integer(token, "a whole number").map(|i| i.clamp(-(1 << 53), 1 << 53) as f64)
                } else {
                    number(token, "a number")
                }
            }
            Source::Binary { bytes, at, big } => {
                let n = scalar.bytes() as usize;
                let raw = bytes.get(*at..*at + n).ok_or(truncated)?;
                let mut b = [0; 8];
                b[..n].copy_from_slice(raw);
                if *big {
                    b[..n].reverse();
                }
                *at += n;
                Ok(scalar.value(b))
            }
        }
    }
}

fn read_element(element: &Element, source: &mut Source, soup: &mut Soup) -> Result<(), Fault> {
    let what = match element.name.as_str() {
        "vertex" => "vertex",
        "face" => "face",
        _ => "element",
    };
    check_roles(element)?;
    // An element without properties takes no bytes, and stepping over it no time.
    if element.properties.is_empty() {
        return Ok(());
    }
    let least = element.properties.iter().map(|p| source.least_bytes(p.count.unwrap_or(p.scalar)));
    check_count(
        &format!("elements \"{}\"", element.name),
        element.count,
        least.sum(),
        source.remaining(),
        element.place.clone(),
    )?;
    match what {
        "vertex" => soup.reserve(element.count, 0),
        "face" => soup.reserve(0, element.count),
        _ => {}
    }
    let mut corners = Vec::new();
    for item in 0..element.count {
        let mut xyz = [0.0; 3];
        corners.clear();
        for p in &element.properties {
            let values = match p.count {
                None => 1,
                Some(count) => list_length(count, p.scalar, source, what, item)?,
            };
            for _ in 0..values {
                let value = source.value(p.scalar).map_err(|d| (source.place(what, item), d))?;
                match p.role {
                    Role::Axis(axis) => xyz[axis] = value,
                    Role::Corners => {
                        corners.push(soup.number(value as i64, &source.place(what, item))?);
                    }
                    Role::Ignored => {}
                }
            }
        }
        match what {
            "vertex" => drop(soup.vertex(xyz, source.place(what, item))?),
            "face" => soup.face(&corners, source.place(what, item))?,
            _ => {}
        }
    }
    Ok(())
}

/// Refuses vertices without the three axes and faces without corners.
fn check_roles(element: &Element) -> Result<(), Fault> {
    let has = |role| element.properties.iter().any(|p| p.role == role);
    let complete = match element.name.as_str() {
        "vertex" => (0..3).all(|axis| has(Role::Axis(axis))),
        "face" => has(Role::Corners),
        _ => true,
    };
    if complete || element.count == 0 {
        return Ok(());
    }
    let what = match element.name.as_str() {
        "vertex" => "the vertices lack one of the properties x, y and z",
        _ => "the faces lack the list vertex_indices of whole numbers",
    };
    let mend = "export the mesh again, or in another format";
    Err((element.place.clone(), Defect::Unsupported { what: what.to_string(), mend }))
}

fn list_length(
    count: Scalar,
    scalar: Scalar,
    source: &mut Source,
    what: &'static str,
    item: u64,
) -> Result<u64, Fault> {
    let length = source.value(count).map_err(|d| (source.place(what, item), d))?;
    let place = source.place(what, item);
    if length < 0.0 {
        let found = length.to_string();
        return Err((place, Defect::Unexpected { expected: "the length of a list", found }));
    }
    let least = source.least_bytes(scalar);
    check_count("list values", length as u64, least, source.remaining(), place)?;
    Ok(length as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADER: &str = "comment \u{e9}\nelement vertex 4\nproperty uchar red\nproperty float x\n\
        property float y\nproperty double z\nelement face 2\nproperty list uchar int vertex_indices\n\
        property float quality\nend_header\n";

    #[test]
    fn text_and_both_byte_orders_give_the_same_mesh() {
        let text = "ply\nformat ascii 1.0\n".to_string()
            + HEADER
            + "9 0 0 0\n9 1 0 0\n9 1 1 0\n9 0 1 0\n3 0 1 2 0.5\n4 0 1 2 3 0.5\n";
        let expected = read(text.as_bytes(), 3.0).unwrap();
        assert_eq!(expected.triangles(), [[0, 1, 2], [0, 1, 2], [0, 2, 3]]);
        assert_eq!(expected.vertices()[2].to_array(), [3.0, 3.0, 0.0]);
        for big in [false, true] {
            let order = |mut b: Vec<u8>| {
                if big {
                    b.reverse();
                }
                b
            };
            let name = if big { "big" } else { "little" };
            let mut bytes = format!("ply\nformat binary_{name}_endian 1.0\n{HEADER}").into_bytes();
            for (x, y) in [(0f32, 0f32), (1., 0.), (1., 1.), (0., 1.)] {
                bytes.push(9);
                bytes.extend(order(x.to_le_bytes().to_vec()));
                bytes.extend(order(y.to_le_bytes().to_vec()));
                bytes.extend(order(0f64.to_le_bytes().to_vec()));
            }
            for face in [&[0i32, 1, 2][..], &[0, 1, 2, 3]] {
                bytes.push(face.len() as u8);
                face.iter().for_each(|i| bytes.extend(order(i.to_le_bytes().to_vec())));
                bytes.extend(order(0.5f32.to_le_bytes().to_vec()));
            }
            assert_eq!(read(&bytes, 3.0).unwrap(), expected);
        }
    }

    #[test]
    fn a_list_longer_than_the_file_is_refused_before_it_is_read() {
        let text = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n\
            property float z\nelement face 1\nproperty list uint uint vertex_index\nend_header\n\
            0 0 0\n4000000000 0 0 0\n";
        let (place, defect) = read(text.as_bytes(), 1.0).unwrap_err();
        assert_eq!(place, Place::Line(11));
        assert!(matches!(defect, Defect::CountTooLarge { declared: 4_000_000_000, .. }));
    }
}
