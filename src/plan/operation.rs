//! Operations on single voxels: what nullification plans in, finer than steps.

use crate::base::Direction;

/// The five orientations of the cutter (INV Prerequisite 2.2), named by the way the tool feeds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Orientation {
    /// −z: from above.
    Down,
    /// +x: from low x.
    PlusX,
    /// −x: from high x.
    MinusX,
    /// +y: from low y.
    PlusY,
    /// −y: from high y.
    MinusY,
}

impl Orientation {
    pub const ALL: [Orientation; 5] = [
        Orientation::Down,
        Orientation::PlusX,
        Orientation::MinusX,
        Orientation::PlusY,
        Orientation::MinusY,
    ];

    /// From the workpiece toward the spindle: against the feed.
    pub fn spindle(self) -> Direction {
        match self {
            Orientation::Down => Direction::Z,
            Orientation::PlusX => Direction::NEG_X,
            Orientation::MinusX => Direction::X,
            Orientation::PlusY => Direction::NEG_Y,
            Orientation::MinusY => Direction::Y,
        }
    }

    /// The orientation whose spindle points along this direction; none along −z or off the axes.
    pub fn with_spindle(d: Direction) -> Option<Orientation> {
        Orientation::ALL.into_iter().find(|o| o.spindle() == d)
    }
}

/// What happens to one voxel, in the order of fabrication.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Deed {
    /// AM (Def. 2.5).
    Add,
    /// SM (Def. 2.6).
    Cut(Orientation),
    /// SM in whichever orientation will do; a schedule file does not say which.
    CutAnyhow,
}

/// One operation on one voxel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Operation {
    /// Grid index along x, y, z.
    pub voxel: [u16; 3],
    pub deed: Deed,
}
