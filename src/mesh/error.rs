//! What can be wrong with a mesh file, said as: which file, where in it, what, how to mend.

use super::InvalidMesh;
use std::fmt;
use std::path::PathBuf;

/// A mesh file that was not loaded. Its message is one line: file, place, defect, remedy.
#[derive(Debug, thiserror::Error)]
#[error("{}{place}: {defect}", .path.display())]
pub struct ReadError {
    pub path: PathBuf,
    pub place: Place,
    #[source]
    pub defect: Defect,
}

/// Where in the file a defect was found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Place {
    /// The file as a whole.
    File,
    /// A line of a text file, counted from 1.
    Line(usize),
    /// An item of a binary file ("triangle", "vertex", …), counted from 0.
    Item(&'static str, usize),
    /// A byte of a file inside an archive.
    Entry { name: String, byte: u64 },
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Place::File => Ok(()),
            Place::Line(n) => write!(f, ", line {n}"),
            Place::Item(what, n) => write!(f, ", {what} {n}"),
            Place::Entry { name, byte } => write!(f, ", {name}, byte {byte}"),
        }
    }
}

/// What is wrong, and what to do about it.
#[derive(Debug, thiserror::Error)]
pub enum Defect {
    #[error("there is no such file; check the path")]
    Missing,
    #[error("is a directory, not a mesh; name a file inside it")]
    Directory,
    #[error("is not a regular file; save the mesh to disk and name that file")]
    NotRegular,
    #[error("cannot be read ({0}); check its permissions and the disk")]
    Io(std::io::Error),
    #[error(
        "has {bytes} bytes, more than the {limit} this program reads; simplify the mesh (a part \
         rarely needs over a million triangles)"
    )]
    TooLarge { bytes: u64, limit: u64 },
    #[error("is empty; export the mesh again")]
    Empty,
    #[error("a unit factor of {0} mm makes no size; give `--scale` a positive number")]
    BadScale(f64),
    #[error("is {what}, which is not read; convert it to OBJ, STL, PLY, OFF or 3MF")]
    Foreign { what: &'static str },
    #[error(
        "is not recognised as OBJ, STL, PLY, OFF or 3MF (its name ends in \"{extension}\"); \
         export the mesh in one of these formats"
    )]
    Unrecognised { extension: String },
    #[error("ends while {expecting} was expected: the file is cut short; copy or export it again")]
    Truncated { expecting: &'static str },
    #[error(
        "declares {declared} {what}, which need at least {needed} bytes, but only {available} \
         follow: the file is cut short or its header is damaged; export it again"
    )]
    CountTooLarge { what: String, declared: u64, needed: u64, available: u64 },
    #[error(
        "declares {declared} triangles, but {surplus} bytes follow them: the header is damaged \
         or two files were joined; export it again"
    )]
    Surplus { declared: u64, surplus: u64 },
    #[error("\"{found}\" is not {expected}; correct that or export the mesh again")]
    Unexpected { expected: &'static str, found: String },
    #[error(
        "the coordinate {value:?} is not a finite number within 1e9 mm; correct the vertex, or the \
         unit if the whole part is too large (`--unit`, `--scale`)"
    )]
    Coordinate { value: f64 },
    #[error(
        "a face names vertex {index}, but the {vertices} vertices are numbered from {base}; the \
         file is cut short or damaged, export it again"
    )]
    IndexOutOfRange { index: i64, base: i64, vertices: usize },
    #[error("a face has {corners} corners and needs three; remove it or export the mesh again")]
    ShortFace { corners: u64 },
    #[error(
        "a face that is not convex has {corners} corners, more than the {limit} this program \
         splits; triangulate the mesh before exporting it"
    )]
    PolygonTooLarge { corners: usize, limit: usize },
    #[error(
        "has {vertices} vertices but no faces: a point cloud or wire frame is no part; export a \
         surface mesh"
    )]
    NoFaces { vertices: usize },
    #[error("{what}; {mend}")]
    Unsupported { what: String, mend: &'static str },
    #[error("the archive is damaged ({0}); export the 3MF file again")]
    Archive(String),
    #[error("is a zip archive without a 3D model; unpack it, or export the mesh as 3MF")]
    NoModel,
    #[error("the XML is damaged ({0}); export the 3MF file again")]
    Xml(String),
    #[error(
        "{name} inflates from {packed} to over {inflated} bytes, which no mesh does: the archive \
         is damaged or hostile; export the 3MF file again"
    )]
    Bomb { name: String, packed: u64, inflated: u64 },
    #[error(
        "the object {object} is missing, part of itself, or nested deeper than {limit}; export \
         the 3MF file again"
    )]
    BadComponent { object: String, limit: usize },
    #[error(
        "its components place {triangles} triangles in all, more than the {limit} this program \
         holds; simplify the mesh"
    )]
    TooManyInstances { triangles: u64, limit: u64 },
    #[error("the mesh is not valid: {0}; export it again")]
    Invalid(#[from] InvalidMesh),
}

/// A defect and its place, before the file's name is added at the edge.
pub(super) type Fault = (Place, Defect);

/// A token as it may be shown: lossy text, short, no control characters.
pub(super) fn shown(token: &[u8]) -> String {
    const LONGEST: usize = 40;
    let text = String::from_utf8_lossy(&token[..token.len().min(LONGEST)]);
    let mut text: String = text.chars().filter(|c| !c.is_control()).collect();
    if token.len() > LONGEST {
        text.push('…');
    }
    text
}
