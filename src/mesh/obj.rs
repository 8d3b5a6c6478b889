//! Wavefront OBJ: `v` and `f` lines; all other statements (normals, textures, groups, materials,
//! curves) say nothing about the surface and are passed over.
//!
//! Guarantees: relative (negative) indices, faces of any number of corners, lines continued with
//! a backslash. All groups share one vertex list, so that seams between groups stay closed.
//! Not guaranteed: free-form surfaces are not meshed.

use super::error::{Defect, Fault, Place};
use super::soup::Soup;
use super::text::{Tokens, integer, number};
use super::tri::TriMesh;

/// Whether a line of text begins as an OBJ vertex does.
pub(super) fn looks_like(start: &[u8]) -> bool {
    let mut tokens = Tokens::new(start, Some(b'#'));
    let mut line = Vec::new();
    loop {
        let more = statement(&mut tokens, &mut line);
        if line.first() == Some(&&b"v"[..]) && coordinates(&line[1..]).is_ok() {
            return true;
        }
        if !more {
            return false;
        }
    }
}

pub(super) fn read(bytes: &[u8], mm_per_unit: f64) -> Result<TriMesh, Fault> {
    let mut soup = Soup::new(mm_per_unit, 1);
    let mut tokens = Tokens::new(bytes, Some(b'#'));
    let mut line = Vec::new();
    let mut corners = Vec::new();
    loop {
        let place = tokens.place();
        let more = statement(&mut tokens, &mut line);
        match line.split_first() {
            Some((&b"v", values)) => {
                let xyz = coordinates(values).map_err(|d| (place.clone(), d))?;
                soup.vertex(xyz, place)?;
            }
            // "fo" is the old spelling.
            Some((&(b"f" | b"fo"), references)) => {
                corners.clear();
                for reference in references {
                    corners.push(corner(reference, &soup, &place)?);
                }
                soup.face(&corners, place)?;
            }
            _ => {}
        }
        if !more {
            return soup.finish();
        }
    }
}

/// Gathers one statement, which a trailing backslash continues on the next line; `false` when the
/// file ends with it.
fn statement<'a>(tokens: &mut Tokens<'a>, line: &mut Vec<&'a [u8]>) -> bool {
    line.clear();
    loop {
        let mut continued = false;
        while let Some(token) = tokens.on_line() {
            let kept = token.strip_suffix(b"\\");
            continued = kept.is_some();
            if !kept.unwrap_or(token).is_empty() {
                line.push(kept.unwrap_or(token));
            }
        }
        let more = tokens.next_line();
        if !(continued && more) {
            return more;
        }
    }
}

/// The first three values; weights and colours may follow.
fn coordinates(values: &[&[u8]]) -> Result<[f64; 3], Defect> {
    let [x, y, z, ..] = values else {
        let found = format!("v with {} values", values.len());
        return Err(Defect::Unexpected { expected: "a vertex of three coordinates", found });
    };
    let of = |t| number(t, "a coordinate");
    Ok([of(x)?, of(y)?, of(z)?])
}

/// The vertex number, counted from 0, of `7`, `7/1`, `7//3` or, counted back, `-1`.
fn corner(reference: &[u8], soup: &Soup, place: &Place) -> Result<u32, Fault> {
    let vertex = reference.split(|b| *b == b'/').next().unwrap_or(reference);
    let index = integer(vertex, "a vertex number").map_err(|d| (place.clone(), d))?;
    let vertices = soup.vertex_count() as i64;
    let from_zero = match index {
        1.. => index - 1,
        0 => -1,
        back if -back.max(-i64::MAX) <= vertices => vertices + back,
        _ => {
            let vertices = vertices as usize;
            return Err((place.clone(), Defect::IndexOutOfRange { index, base: 1, vertices }));
        }
    };
    soup.number(from_zero, place)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_polygons_groups_relative_numbers_and_continued_lines() {
        let text = "# \u{fc} caf\u{e9}\r\nmtllib a.mtl\no a\nv 0 0 0\nv 1 0 0 1 0.5 0\nv 1 1 0\n\
                    v 0 1 \\\n 0\nvn 0 0 1\ng left\nf 1//1 2//1 3//1\nusemtl red\nf -4/1 -2/2 \\\n-1\n\
                    f 1 2 3 4\nl 1 2";
        let mesh = read(text.as_bytes(), 2.0).unwrap();
        assert_eq!(mesh.vertices().len(), 4);
        assert_eq!(mesh.triangles(), [[0, 1, 2], [0, 2, 3], [0, 1, 2], [0, 2, 3]]);
        assert_eq!(mesh.vertices()[3].to_array(), [0.0, 2.0, 0.0]);
    }

    #[test]
    fn a_bad_number_names_its_line() {
        let text = "v 0 0 0\nv 1 0 0\n\nv 1 x 0\nf 1 2 3\n";
        assert_eq!(read(text.as_bytes(), 1.0).unwrap_err().0, Place::Line(4));
        let text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 -4\n";
        let (place, defect) = read(text.as_bytes(), 1.0).unwrap_err();
        assert_eq!(place, Place::Line(4));
        assert!(defect.to_string().contains("vertex -4"), "{defect}");
    }
}
