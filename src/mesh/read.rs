//! Finds out which format a file is in, and reads it.

use super::error::{Defect, Fault, Place, ReadError};
use super::{TriMesh, obj, off, package, ply, stl};
use sha2::{Digest, Sha256};
use std::fmt;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Bytes of the largest file read; it is held in memory while it is parsed. Forty million binary
/// STL triangles; a smaller limit refuses no part worth planning, a larger one fills the memory.
const MAX_FILE: u64 = 2 << 30;
/// Bytes from which the format is told: enough to pass an exporter's comments before the first
/// statement, little enough that a huge file of another kind is refused without reading it.
const START: u64 = 64 << 10;

/// How the numbers in a file are understood.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReadOptions {
    /// Millimetres of one unit of the file. A 3MF file states its own unit; this factor is then
    /// applied on top of that unit.
    pub mm_per_unit: f64,
}

impl Default for ReadOptions {
    fn default() -> Self {
        ReadOptions { mm_per_unit: 1.0 }
    }
}

/// The formats that are read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    Obj,
    StlBinary,
    StlText,
    Ply,
    Off,
    ThreeMf,
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Format::Obj => "OBJ",
            Format::StlBinary => "binary STL",
            Format::StlText => "text STL",
            Format::Ply => "PLY",
            Format::Off => "OFF",
            Format::ThreeMf => "3MF",
        })
    }
}

/// A mesh and the file it came from.
#[derive(Clone, Debug, PartialEq)]
pub struct LoadedMesh {
    pub mesh: TriMesh,
    /// SHA-256 of the file's bytes, lower-case hexadecimal.
    pub sha256: String,
    pub format: Format,
}

/// Reads a mesh into millimetres. The content tells the format, the extension only where the
/// content leaves it open. At least one triangle is there when this succeeds; whether the mesh is
/// closed is for [`super::Health`] to say.
pub fn read(path: &Path, options: &ReadOptions) -> Result<LoadedMesh, ReadError> {
    load(path, options).map_err(|(place, defect)| ReadError {
        path: path.to_path_buf(),
        place,
        defect,
    })
}

fn load(path: &Path, options: &ReadOptions) -> Result<LoadedMesh, Fault> {
    let whole = |d| (Place::File, d);
    let mm = options.mm_per_unit;
    if !(mm.is_finite() && mm > 0.0) {
        return Err(whole(Defect::BadScale(mm)));
    }
    let metadata = std::fs::metadata(path).map_err(|e| whole(io(e)))?;
    if metadata.is_dir() {
        return Err(whole(Defect::Directory));
    }
    // A pipe or device may never end.
    if !metadata.is_file() {
        return Err(whole(Defect::NotRegular));
    }
    let len = metadata.len();
    let mut file = File::open(path).map_err(|e| whole(io(e)))?;
    let mut bytes = Vec::new();
    (&mut file).take(START).read_to_end(&mut bytes).map_err(|e| whole(io(e)))?;
    if bytes.iter().all(u8::is_ascii_whitespace) {
        return Err(whole(Defect::Empty));
    }
    let extension = path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    let format = recognise(&bytes, len, &extension).map_err(whole)?;
    if len > MAX_FILE {
        return Err(whole(Defect::TooLarge { bytes: len, limit: MAX_FILE }));
    }
    if format == Format::StlBinary {
        // Refused by its size, a file of nothing but zeros is not read at all.
        stl::binary_count(&bytes, len)?;
    }
    bytes.reserve_exact((len as usize).saturating_sub(bytes.len()));
    // The limit holds even when the file grows meanwhile.
    file.take(MAX_FILE).read_to_end(&mut bytes).map_err(|e| whole(io(e)))?;
    let mesh = parse(format, &bytes, mm)?;
    let sha256 = Sha256::digest(&bytes).iter().map(|b| format!("{b:02x}")).collect();
    Ok(LoadedMesh { mesh, sha256, format })
}

fn io(e: std::io::Error) -> Defect {
    match e.kind() {
        std::io::ErrorKind::NotFound => Defect::Missing,
        _ => Defect::Io(e),
    }
}

fn parse(format: Format, bytes: &[u8], mm_per_unit: f64) -> Result<TriMesh, Fault> {
    let text = bytes.strip_prefix(BYTE_ORDER_MARK).unwrap_or(bytes);
    match format {
        Format::Obj => obj::read(text, mm_per_unit),
        Format::StlBinary => stl::read_binary(bytes, mm_per_unit),
        Format::StlText => stl::read_text(text, mm_per_unit),
        Format::Ply => ply::read(text, mm_per_unit),
        Format::Off => off::read(text, mm_per_unit),
        Format::ThreeMf => package::read(bytes, mm_per_unit),
    }
}

const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";

/// Formats a person may name by mistake, by how they begin.
const FOREIGN: [(&[u8], &str); 17] = [
    (b"ISO-10303-21", "a STEP file"),
    (b"glTF", "a binary glTF file"),
    (b"\x1f\x8b", "a gzip archive"),
    (b"7z\xbc\xaf", "a 7-zip archive"),
    (b"Rar!", "a RAR archive"),
    (b"# vtk DataFile", "a VTK file"),
    (b"Kaydara FBX", "an FBX file"),
    (b"BLENDER", "a Blender file"),
    (b"%PDF", "a PDF document"),
    (b"\x89PNG", "a PNG image"),
    (b"\xff\xd8\xff", "a JPEG image"),
    (b"\xff\xfe", "UTF-16 text"),
    (b"\xfe\xff", "UTF-16 text"),
    (b"\x7fELF", "a program"),
    (b"<", "an XML or HTML file"),
    (b"{", "a JSON file"),
    (b"#VRML", "a VRML file"),
];

/// The format of a file of `len` bytes that begins with `start`.
fn recognise(start: &[u8], len: u64, extension: &str) -> Result<Format, Defect> {
    // First what proves itself, whatever the name says.
    if stl::is_binary(start, len) && !start.starts_with(b"PK") {
        return Ok(Format::StlBinary);
    }
    if start.starts_with(b"PK\x03\x04") || start.starts_with(b"PK\x05\x06") {
        return Ok(Format::ThreeMf);
    }
    let text = start.strip_prefix(BYTE_ORDER_MARK).unwrap_or(start);
    if ply::looks_like(text) {
        return Ok(Format::Ply);
    }
    if off::looks_like(text) {
        return Ok(Format::Off);
    }
    if stl::looks_like_text(text) {
        return Ok(Format::StlText);
    }
    if let Some((_, what)) = FOREIGN.iter().find(|(magic, _)| start.starts_with(magic)) {
        return Err(Defect::Foreign { what });
    }
    if obj::looks_like(text) {
        return Ok(Format::Obj);
    }
    // Then what the name claims, so that the reader can say what is wrong.
    let unrecognised = || Defect::Unrecognised { extension: extension.to_string() };
    let is_text = !text.contains(&0);
    match extension {
        // A count of four bytes with no zero among them, and nothing after it, may be all there is.
        "stl" if !is_text || stl::has_binary_count(start) => Ok(Format::StlBinary),
        "stl" if text.trim_ascii_start().to_ascii_lowercase().starts_with(b"solid") => {
            Ok(Format::StlText)
        }
        "off" if is_text => Ok(Format::Off),
        "obj" if is_text => Ok(Format::Obj),
        _ => Err(unrecognised()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn content_goes_before_the_name() {
        let of = |text: &[u8], extension| recognise(text, text.len() as u64, extension).ok();
        assert_eq!(of(b"ply\nformat ascii 1.0\n", "stl"), Some(Format::Ply));
        assert_eq!(of(b"# hi\nOFF\n", "obj"), Some(Format::Off));
        assert_eq!(of(b"solid a\n facet normal", "obj"), Some(Format::StlText));
        assert_eq!(of(b"# x\nmtllib a\nv 0 0 0\n", "stl"), Some(Format::Obj));
        assert_eq!(of(b"PK\x03\x04", "stl"), Some(Format::ThreeMf));
        assert_eq!(of(b"hello", "stl"), None);
        let header_alone = [[b'x'; 80].as_slice(), &[0xff; 4]].concat();
        assert_eq!(of(&header_alone, "stl"), Some(Format::StlBinary));
        assert_eq!(of(&header_alone, "obj"), Some(Format::Obj));
        assert_eq!(of(&[b'x'; 84], "stl"), None);
        assert_eq!(of(b"8 12 0\n", "off"), Some(Format::Off));
        assert_eq!(of(b"8 12 0\n", ""), None);
    }
}
