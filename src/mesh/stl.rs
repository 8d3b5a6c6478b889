//! STL, binary and text. Corners at the very same place become one vertex.
//!
//! Guarantees: a file whose size fits its triangle count is binary whatever its header says (some
//! exporters begin binary headers with "solid"); text in any case, several solids in one file,
//! facets with more than three corners. Stored normals are ignored: the order of the corners says
//! which side is out. Colours in attribute bytes are ignored.

use super::error::{Defect, Fault, Place, shown};
use super::soup::Soup;
use super::text::{Tokens, number};
use super::tri::TriMesh;
use std::collections::HashMap;

const HEADER: u64 = 84;
const TRIANGLE: u64 = 50;

/// The triangle count that a binary header declares.
fn declared(start: &[u8]) -> Option<u32> {
    let count = start.get(80..84)?;
    Some(u32::from_le_bytes([count[0], count[1], count[2], count[3]]))
}

/// Whether what would be a triangle count is nothing that text has.
pub(super) fn has_binary_count(start: &[u8]) -> bool {
    start.get(80..84).is_some_and(|count| !count.is_ascii())
}

/// Whether the declared triangles fill a file of `len` bytes exactly.
pub(super) fn is_binary(start: &[u8], len: u64) -> bool {
    declared(start).is_some_and(|n| HEADER + TRIANGLE * u64::from(n) == len)
}

/// Whether a text file begins as an STL file does.
pub(super) fn looks_like_text(start: &[u8]) -> bool {
    let mut tokens = Tokens::new(start, None);
    if !tokens.next().is_some_and(|w| w.eq_ignore_ascii_case(b"solid")) {
        return false;
    }
    tokens.next_line();
    tokens
        .next()
        .is_none_or(|w| w.eq_ignore_ascii_case(b"facet") || w.eq_ignore_ascii_case(b"endsolid"))
}

/// Adds vertices, each place once.
struct Welder {
    soup: Soup,
    seen: HashMap<[u64; 3], u32>,
}

impl Welder {
    fn new(mm_per_unit: f64) -> Self {
        Welder { soup: Soup::new(mm_per_unit, 0), seen: HashMap::new() }
    }

    fn vertex(&mut self, xyz: [f64; 3], place: &Place) -> Result<u32, Fault> {
        // Adding zero turns -0 into 0.
        let key = xyz.map(|c| (c + 0.0).to_bits());
        if let Some(&index) = self.seen.get(&key) {
            return Ok(index);
        }
        let index = self.soup.vertex(xyz, place.clone())?;
        self.seen.insert(key, index);
        Ok(index)
    }
}

/// The triangle count of a binary file of `len` bytes, when its header and size agree.
pub(super) fn binary_count(start: &[u8], len: u64) -> Result<u64, Fault> {
    let whole = |d| (Place::File, d);
    let truncated = Defect::Truncated { expecting: "the 84-byte STL header" };
    let declared = u64::from(declared(start).ok_or_else(|| whole(truncated))?);
    let available = len - HEADER;
    let needed = declared * TRIANGLE;
    if needed > available {
        let what = "triangles".to_string();
        return Err(whole(Defect::CountTooLarge { what, declared, needed, available }));
    }
    // Padding is harmless; whole triangles that the header does not count are a loss.
    let surplus = available - needed;
    if surplus >= TRIANGLE {
        return Err(whole(Defect::Surplus { declared, surplus }));
    }
    Ok(declared)
}

pub(super) fn read_binary(bytes: &[u8], mm_per_unit: f64) -> Result<TriMesh, Fault> {
    let count = binary_count(bytes, bytes.len() as u64)?;
    let mut welder = Welder::new(mm_per_unit);
    welder.soup.reserve(count / 2, count);
    let facets = bytes[HEADER as usize..].chunks_exact(TRIANGLE as usize).take(count as usize);
    for (i, facet) in facets.enumerate() {
        let place = Place::Item("triangle", i);
        let f32_at = |at: usize| {
            let b = [facet[at], facet[at + 1], facet[at + 2], facet[at + 3]];
            f64::from(f32::from_le_bytes(b))
        };
        let mut corners = [0; 3];
        for (k, corner) in corners.iter_mut().enumerate() {
            // The normal takes the first twelve bytes.
            let at = 12 + 12 * k;
            let xyz = [f32_at(at), f32_at(at + 4), f32_at(at + 8)];
            *corner = welder.vertex(xyz, &place)?;
        }
        welder.soup.face(&corners, place)?;
    }
    welder.soup.finish()
}

pub(super) fn read_text(bytes: &[u8], mm_per_unit: f64) -> Result<TriMesh, Fault> {
    let mut tokens = Tokens::new(bytes, None);
    let mut welder = Welder::new(mm_per_unit);
    expect(&mut tokens, "solid")?;
    let mut inside = true;
    // The rest of a "solid" or "endsolid" line is a name, which may hold anything.
    tokens.next_line();
    while let Some(word) = tokens.next() {
        let is = |keyword: &str| word.eq_ignore_ascii_case(keyword.as_bytes());
        if inside && is("facet") {
            facet(&mut tokens, &mut welder)?;
        } else if inside && is("endsolid") || !inside && is("solid") {
            inside = !inside;
            tokens.next_line();
        } else {
            let expected = if inside { "\"facet\" or \"endsolid\"" } else { "\"solid\"" };
            return Err((tokens.place(), Defect::Unexpected { expected, found: shown(word) }));
        }
    }
    if inside {
        return Err((tokens.place(), Defect::Truncated { expecting: "\"endsolid\"" }));
    }
    welder.soup.finish()
}

fn expect(tokens: &mut Tokens, keyword: &'static str) -> Result<(), Fault> {
    match tokens.next() {
        Some(word) if word.eq_ignore_ascii_case(keyword.as_bytes()) => Ok(()),
        Some(word) => {
            let defect = Defect::Unexpected { expected: keyword, found: shown(word) };
            Err((tokens.place(), defect))
        }
        None => Err((tokens.place(), Defect::Truncated { expecting: keyword })),
    }
}

/// What follows the word "facet", through "endfacet".
fn facet(tokens: &mut Tokens, welder: &mut Welder) -> Result<(), Fault> {
    expect(tokens, "normal")?;
    // The normal's numbers may be anything, even absent: they are not used.
    tokens.next_line();
    let place = tokens.place();
    expect(tokens, "outer")?;
    expect(tokens, "loop")?;
    let mut corners = Vec::with_capacity(3);
    loop {
        let expecting = "\"vertex\" or \"endloop\"";
        let word = tokens.next().ok_or((tokens.place(), Defect::Truncated { expecting }))?;
        if word.eq_ignore_ascii_case(b"endloop") {
            break;
        }
        if !word.eq_ignore_ascii_case(b"vertex") {
            let defect = Defect::Unexpected { expected: expecting, found: shown(word) };
            return Err((tokens.place(), defect));
        }
        let mut xyz = [0.0; 3];
        for c in &mut xyz {
            let expecting = "a coordinate";
            let word = tokens.next().ok_or((tokens.place(), Defect::Truncated { expecting }))?;
            *c = number(word, expecting).map_err(|d| (tokens.place(), d))?;
        }
        corners.push(welder.vertex(xyz, &tokens.place())?);
    }
    expect(tokens, "endfacet")?;
    welder.soup.face(&corners, place)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_in_any_case_with_several_solids_is_read_and_welded() {
        let facet = |z: f64| {
            format!(
                "FACET NORMAL nan nan nan\nouter loop\nvertex -0 0 {z}\nvertex 1 0 {z}\n\
                 Vertex 1 1 {z}\nendloop\nendfacet\n"
            )
        };
        let text = format!(
            "Solid\n{}{}endsolid\nsolid two words\n{}endsolid two words\n",
            facet(0.0),
            facet(0.0),
            facet(1.0).replace("-0 0", "0 0")
        );
        let mesh = read_text(text.as_bytes(), 1.0).unwrap();
        assert_eq!((mesh.vertices().len(), mesh.triangles().len()), (6, 3));
    }

    #[test]
    fn a_binary_file_may_call_itself_solid() {
        let mut bytes = b"solid made by someone".to_vec();
        bytes.resize(80, b' ');
        bytes.extend(1u32.to_le_bytes());
        for v in [0f32, 0., 1., 0., 0., 0., 1., 0., 0., 0., 1., -0.] {
            bytes.extend(v.to_le_bytes());
        }
        bytes.extend([0, 0]);
        assert!(is_binary(&bytes, bytes.len() as u64));
        assert_eq!(read_binary(&bytes, 1.0).unwrap().vertices().len(), 3);
    }
}
