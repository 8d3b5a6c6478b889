//! Object File Format (Geomview): `OFF` and its spellings with normals, colours or texture
//! coordinates (`NOFF`, `COFF`, `STOFF` …), whose extra values are passed over.
//!
//! Guarantees: comments anywhere, counts on the line of `OFF` or run together with it, faces of
//! any number of corners. Not read: binary, four-dimensional and n-dimensional files.

use super::error::{Defect, Fault, shown};
use super::soup::Soup;
use super::text::{Tokens, check_count, integer};
use super::tri::TriMesh;

/// The rest of the header word after `OFF`, when `word` is one of its spellings.
fn after_keyword(word: &[u8]) -> Option<&[u8]> {
    let at = word.windows(3).position(|w| w == b"OFF")?;
    let (prefix, rest) = (&word[..at], &word[at + 3..]);
    let known = [&b""[..], b"C", b"N", b"CN", b"NC", b"ST", b"STC", b"STN", b"STCN"];
    (known.contains(&prefix) && rest.iter().all(u8::is_ascii_digit)).then_some(rest)
}

/// Whether the file begins as an OFF file does.
pub(super) fn looks_like(bytes: &[u8]) -> bool {
    let first = Tokens::new(bytes, Some(b'#')).next();
    first.is_some_and(|w| after_keyword(w).is_some() || matches!(w, b"4OFF" | b"nOFF"))
}

pub(super) fn read(bytes: &[u8], mm_per_unit: f64) -> Result<TriMesh, Fault> {
    let mut tokens = Tokens::new(bytes, Some(b'#'));
    let (vertices, faces) = counts(&mut tokens)?;
    // The shortest vertex line is "0 0 0\n", the shortest face line "3 0 0 0\n".
    check_count("vertices", vertices, 6, tokens.remaining() + 1, tokens.place())?;
    check_count("faces", faces, 8, tokens.remaining() + 1, tokens.place())?;
    let mut soup = Soup::new(mm_per_unit, 0);
    soup.reserve(vertices, faces);
    for _ in 0..vertices {
        let mut xyz = [0.0; 3];
        for c in &mut xyz {
            *c = tokens.number("a coordinate")?;
        }
        soup.vertex(xyz, tokens.place())?;
        tokens.next_line();
    }
    let mut corners = Vec::new();
    for _ in 0..faces {
        let n = tokens.integer("a face's number of corners")?;
        let n = u64::try_from(n).map_err(|_| (tokens.place(), Defect::ShortFace { corners: 0 }))?;
        check_count("corners", n, 2, tokens.remaining() + 1, tokens.place())?;
        corners.clear();
        for _ in 0..n {
            let index = tokens.integer("a face's vertex number")?;
            corners.push(soup.number(index, &tokens.place())?);
        }
        soup.face(&corners, tokens.place())?;
        tokens.next_line();
    }
    soup.finish()
}

/// The numbers of vertices and faces; a count of edges, when given, is passed over.
fn counts(tokens: &mut Tokens) -> Result<(u64, u64), Fault> {
    const EXPECTED: &str = "the number of vertices";
    let missing = |t: &Tokens| (t.place(), Defect::Truncated { expecting: EXPECTED });
    let mut word = tokens.next().ok_or_else(|| missing(tokens))?;
    if matches!(word, b"4OFF" | b"nOFF") {
        let what = format!("{} is not three-dimensional", shown(word));
        let mend = "export the mesh as plain OFF";
        return Err((tokens.place(), Defect::Unsupported { what, mend }));
    }
    if let Some(rest) = after_keyword(word) {
        word = match rest {
            b"" => tokens.next().ok_or_else(|| missing(tokens))?,
            _ => rest,
        };
    }
    if word == b"BINARY" {
        let what = "this is a binary OFF file".to_string();
        let mend = "export it as text OFF or as binary STL";
        return Err((tokens.place(), Defect::Unsupported { what, mend }));
    }
    let count = |n: i64, t: &Tokens| {
        let found = n.to_string();
        u64::try_from(n).map_err(|_| (t.place(), Defect::Unexpected { expected: "a count", found }))
    };
    let vertices = integer(word, EXPECTED).map_err(|d| (tokens.place(), d))?;
    let vertices = count(vertices, tokens)?;
    let faces = tokens.integer("the number of faces")?;
    let faces = count(faces, tokens)?;
    tokens.next_line();
    Ok((vertices, faces))
}

#[cfg(test)]
mod tests {
    use super::*;

    const BODY: &str =
        "# c\n0 0 0\n1 0 0 255 0 0 # red\n\n1 1 0\n0 1 0\n4 0 1 2 3 0.5 0.5 0.5\n3 0 2 3\n";

    #[test]
    fn every_spelling_of_the_header_is_read() {
        for header in [
            "OFF\n4 2 0\n",
            "OFF 4 2 0\n",
            "OFF4 2 0\n",
            "# top\n\nCOFF # colours\n4 2\n",
            "OFF\r\n4 2 5\r\n",
            "4 2 0\n",
        ] {
            let mesh = read((header.to_string() + BODY).as_bytes(), 1.0).expect(header);
            assert_eq!(mesh.triangles(), [[0, 2, 3], [0, 1, 2], [0, 2, 3]], "{header}");
        }
    }
}
