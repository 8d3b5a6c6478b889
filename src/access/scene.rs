use super::tops::axis_of;
use crate::base::{Aabb, DVec3, Direction};
use crate::voxel::{BitGrid, Frame};
use std::sync::OnceLock;

/// Obstacle points for the depth engine: the boundary voxels of a state and the fixed points of
/// its holding. Inner voxels are covered by the boundary, since a tool goes up without end.
pub struct Scene {
    pub frame: Frame,
    voxels: BitGrid,
    /// Where these stand, found when it is first asked for.
    filled: OnceLock<Filled>,
    fixed: Vec<DVec3>,
    /// Boxes of every [`GROUP`] fixed points, which come pile by pile or row by row, and of every
    /// [`PILE`] of these.
    boxes: Vec<Aabb>,
    piles: Vec<Aabb>,
}

/// Fixed points that are passed over together. Fewer fit closer, more are passed over faster.
const GROUP: usize = 32;

/// Groups that are passed over together.
const PILE: usize = 16;

/// Where the obstacle voxels of a scene stand.
pub(super) struct Filled {
    /// The bars that have any, by z and then y.
    pub bars: Vec<Bar>,
    /// Of each word of the rows of each bar of the grid, the columns along x that have any in it.
    pub bricks: Vec<u64>,
}

/// The rows along x of bricks beside each other.
pub(super) struct Bar {
    /// Its number among all of the grid.
    pub number: usize,
    /// Box of its voxels.
    pub low: [usize; 3],
    pub high: [usize; 3],
    /// Those of its rows that have any.
    pub rows: Vec<Row>,
}

/// A row along x, and the first and the last voxel in it.
pub(super) struct Row {
    pub y: usize,
    pub z: usize,
    pub ends: [usize; 2],
}

/// Voxels that are passed over together, along x, y and z: of those in a word of a row four bricks have their say.
pub(super) const BRICK: [usize; 3] = [16, 8, 8];

impl Filled {
    fn of(voxels: &BitGrid) -> Filled {
        let [_, ny, nz] = voxels.dims();
        let (words, along_y) = (voxels.words_per_row(), ny.div_ceil(BRICK[1]));
        let n = along_y * nz.div_ceil(BRICK[2]);
        let mut bars: Vec<Option<Bar>> = (0..n).map(|_| None).collect();
        let mut bricks = vec![0; words * n];
        for r in voxels.stored_rows() {
            let (y, z) = (r % ny, r / ny);
            let row = voxels.row(y, z);
            let Some(ends) = ends(row) else { continue };
            let number = y / BRICK[1] + along_y * (z / BRICK[2]);
            let (low, high) = ([ends[0], y, z], [ends[1], y, z]);
            let bar = bars[number].get_or_insert(Bar { number, low, high, rows: Vec::new() });
            bar.low = std::array::from_fn(|a| bar.low[a].min(low[a]));
            bar.high = std::array::from_fn(|a| bar.high[a].max(high[a]));
            bar.rows.push(Row { y, z, ends });
            let of_bar = bricks[words * number..].iter_mut();
            of_bar.zip(row).for_each(|(all, word)| *all |= word);
        }
        Filled { bars: bars.into_iter().flatten().collect(), bricks }
    }
}

/// The first and the last voxel of a row.
fn ends(row: &[u64]) -> Option<[usize; 2]> {
    let first = row.iter().position(|w| *w != 0)?;
    let last = row.iter().rposition(|w| *w != 0)?;
    let [lo, hi] = [row[first].trailing_zeros(), 63 - row[last].leading_zeros()];
    Some([first * 64 + lo as usize, last * 64 + hi as usize])
}

impl Scene {
    pub fn new(frame: &Frame, state: &BitGrid, fixed: &[DVec3]) -> Scene {
        Scene::of_points(frame, state.boundary(), fixed)
    }

    fn of_points(frame: &Frame, voxels: BitGrid, fixed: &[DVec3]) -> Scene {
        let around = |least, most| Aabb { min: least, max: most };
        let group = |group: &[DVec3]| {
            let least = group.iter().copied().fold(DVec3::MAX, DVec3::min);
            around(least, group.iter().copied().fold(DVec3::MIN, DVec3::max))
        };
        let pile = |pile: &[Aabb]| {
            let least = pile.iter().map(|b| b.min).fold(DVec3::MAX, DVec3::min);
            around(least, pile.iter().map(|b| b.max).fold(DVec3::MIN, DVec3::max))
        };
        let boxes: Vec<Aabb> = fixed.chunks(GROUP).map(group).collect();
        let piles = boxes.chunks(PILE).map(pile).collect();
        let filled = OnceLock::new();
        Scene { frame: *frame, voxels, filled, fixed: fixed.to_vec(), boxes, piles }
    }

    /// The fixed points in groups with their boxes.
    pub(super) fn groups(&self) -> impl Iterator<Item = (&Aabb, &[DVec3])> {
        self.boxes.iter().zip(self.fixed.chunks(GROUP))
    }

    /// The same by piles with theirs.
    pub(super) fn piles(
        &self,
    ) -> impl Iterator<Item = (&Aabb, impl Iterator<Item = (&Aabb, &[DVec3])>)> {
        let boxes = self.boxes.chunks(PILE);
        let points = self.fixed.chunks(PILE * GROUP);
        let groups =
            boxes.zip(points).map(|(boxes, points)| boxes.iter().zip(points.chunks(GROUP)));
        self.piles.iter().zip(groups)
    }

    /// The obstacles as tools along one direction meet them, made in the least time. Along a grid axis
    /// the depth engine looks at the highest voxel of each column alone, and whether those within
    /// are there makes no difference.
    pub(super) fn along(
        frame: &Frame,
        state: BitGrid,
        fixed: &[DVec3],
        direction: Direction,
    ) -> Scene {
        let on_axis = axis_of(direction.vec()).is_some();
        let voxels = if on_axis { state } else { state.boundary() };
        Scene::of_points(frame, voxels, fixed)
    }

    /// The obstacles as a tool along +z meets them: of each column of voxels only the highest.
    pub fn from_above(frame: &Frame, state: &BitGrid, fixed: &[DVec3]) -> Scene {
        let mut voxels = BitGrid::new(state.dims());
        let [_, ny, nz] = state.dims();
        let mut open = vec![!0u64; state.words_per_row()];
        for y in 0..ny {
            open.fill(!0);
            for z in (0..nz).rev() {
                let tops = voxels.row_mut(y, z).iter_mut().zip(&mut open);
                for ((top, open), bits) in tops.zip(state.row(y, z)) {
                    *top = bits & *open;
                    *open &= !bits;
                }
            }
        }
        Scene::of_points(frame, voxels, fixed)
    }

    /// The voxels whose centres are obstacle points.
    pub fn voxels(&self) -> &BitGrid {
        &self.voxels
    }

    pub(super) fn filled(&self) -> &Filled {
        self.filled.get_or_init(|| Filled::of(&self.voxels))
    }

    /// All obstacle points, mm.
    pub fn points(&self) -> impl Iterator<Item = DVec3> + '_ {
        let centres = self.voxels.iter_ones().map(|v| self.frame.center(v));
        centres.chain(self.fixed.iter().copied())
    }
}
