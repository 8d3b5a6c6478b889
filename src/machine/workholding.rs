//! What holds the part: the fixed obstacles every step must respect, as points.
//!
//! The pedestal is the base contact swept away from the part; the table is a finite disc or box
//! under it. Both are given as sample points, because the rules ask whether a tool holds a point:
//! pedestal points are voxel centres of the plan's grid continued below the base plane, table
//! points a square lattice. Only the shells are sampled: a tool that goes up without end cannot
//! hold an inner point without holding one of the shell.

use super::place::Place;
use super::placement::Placement;
use crate::base::{DVec3, Direction};
use crate::voxel::{BitGrid, Frame};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::ops::Range;

/// How the part may be held through a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum HoldingMode {
    /// On its base through the whole plan.
    Base,
    /// A step may hold it anew.
    Refixture,
}

/// Whether pedestal and table are obstacles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum BaseKind {
    Pedestal,
    None,
}

/// One way of holding the part: which way is up, and where the base plane lies along it (mm).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Holding {
    /// A grid axis, in workpiece coordinates.
    #[schemars(with = "[f64; 3]")]
    pub up: Direction,
    /// The part rests on the plane up · x = height_mm.
    pub height_mm: f64,
}

impl Holding {
    /// As clamped: standing on z = 0.
    pub const AS_CLAMPED: Holding = Holding { up: Direction::Z, height_mm: 0.0 };

    /// Height of a point over the base plane, mm.
    pub fn height(&self, p: DVec3) -> f64 {
        self.up.dot(p) - self.height_mm
    }

    /// Base contact of a state: everything within the grip height (mm) over the base plane.
    pub fn contact(&self, state: &BitGrid, frame: &Frame, grip_mm: f64) -> BitGrid {
        let mut contact = BitGrid::new(state.dims());
        for v in state.iter_ones() {
            let height = self.height(frame.center(v));
            if height <= grip_mm {
                contact.set(v, true);
            }
        }
        contact
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "shape", rename_all = "lowercase", deny_unknown_fields)]
pub enum Table {
    Disc { radius_mm: f64 },
    Box { x_mm: f64, y_mm: f64 },
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Workholding {
    /// Height of the pedestal between table and part, mm.
    pub pedestal_mm: f64,
    pub table: Table,
    /// Where the part stands on it.
    #[serde(default, skip_serializing_if = "Place::is_centre")]
    pub place: Place,
}

/// Spacing of table samples, mm: far below any head's radius, coarse enough to stay cheap.
const TABLE_SAMPLE_MM: f64 = 2.0;

/// Cells across the pedestal and layers of it whose points come together: points that are looked up by groups lie
/// near each other.
const TILE: usize = 16;
const TILE_LAYERS: usize = 32;

impl Workholding {
    /// Sample points of pedestal and table for a part whose base contact is `contact`.
    ///
    /// The table is centred under the contact. Points near each other mostly come near each other. Empty when nothing
    /// is in contact.
    pub fn obstacle_points(
        &self,
        holding: &Holding,
        contact: &BitGrid,
        frame: &Frame,
    ) -> Vec<DVec3> {
        let up = holding.up.vec();
        let axis = (0..3).find(|a| up[*a].abs() > 0.5).unwrap_or(2);
        let (s, t) = ((axis + 1) % 3, (axis + 2) % 3);
        let (ns, nt) = (contact.dims()[s], contact.dims()[t]);
        let mut footprint = vec![false; ns * nt];
        contact.iter_ones().for_each(|v| footprint[v[s] + ns * v[t]] = true);
        let cells: Vec<(usize, usize)> =
            (0..ns * nt).filter(|i| footprint[*i]).map(|i| (i % ns, i / ns)).collect();
        if cells.is_empty() {
            return Vec::new();
        }
        let inside = |a: isize, b: isize| {
            a >= 0
                && b >= 0
                && a < ns as isize
                && b < nt as isize
                && footprint[a as usize + ns * b as usize]
        };
        let on_plane = |a: usize, b: usize| {
            let mut v = [0; 3];
            (v[s], v[t]) = (a, b);
            let p = frame.center(v);
            p + up * (holding.height_mm - up.dot(p))
        };
        let layers = (self.pedestal_mm / frame.pitch).ceil() as usize;
        let at_rim = |&(a, b): &(usize, usize)| {
            let (i, j) = (a as isize, b as isize);
            !(inside(i - 1, j) && inside(i + 1, j) && inside(i, j - 1) && inside(i, j + 1))
        };
        let mut tiles: BTreeMap<[usize; 2], Vec<(usize, usize)>> = BTreeMap::new();
        cells.iter().for_each(|c| tiles.entry([c.1, c.0].map(|i| i / TILE)).or_default().push(*c));
        let mut points = Vec::new();
        let mut put = |(a, b): (usize, usize), layers: Range<usize>| {
            let top = on_plane(a, b);
            points.extend(layers.map(|i| top - up * (i as f64 + 0.5) * frame.pitch));
        };
        for tile in tiles.values() {
            let (rim, inner): (Vec<_>, Vec<_>) = tile.iter().copied().partition(at_rim);
            inner.iter().for_each(|c| put(*c, 0..1));
            rim.iter().for_each(|c| put(*c, 0..layers.min(1)));
            for first in (1..layers).step_by(TILE_LAYERS) {
                rim.iter().for_each(|c| put(*c, first..(first + TILE_LAYERS).min(layers)));
            }
        }
        let middle = cells.iter().map(|&(a, b)| on_plane(a, b)).sum::<DVec3>() / cells.len() as f64;
        let foot = middle - up * self.pedestal_mm;
        if self.place.is_centre() {
            self.table_points(foot, s, t, &mut points);
        } else {
            self.moved_table_points(foot, holding.up, &mut points);
        }
        points
    }

    /// The same for a part that does not stand on the table's centre, `foot` below it.
    fn moved_table_points(&self, foot: DVec3, up: Direction, points: &mut Vec<DVec3>) {
        let machine_from_work = self.place.rotation() * Placement::rotation_of(up);
        let work_from_machine = machine_from_work.transpose();
        let mut flat = Vec::new();
        self.table_points(DVec3::ZERO, 0, 1, &mut flat);
        points.extend(flat.iter().map(|p| foot + work_from_machine * (*p - self.place.offset())));
    }

    /// Samples of the table's top face around `centre`; `s` and `t` are the axes across it.
    fn table_points(&self, centre: DVec3, s: usize, t: usize, points: &mut Vec<DVec3>) {
        let (half_s, half_t) = match self.table {
            Table::Disc { radius_mm } => (radius_mm, radius_mm),
            Table::Box { x_mm, y_mm } => (x_mm / 2.0, y_mm / 2.0),
        };
        let steps = |half: f64| (half / TABLE_SAMPLE_MM).floor() as i64;
        let [rows, columns] =
            [half_s, half_t].map(|half| (-steps(half)..=steps(half)).collect::<Vec<_>>());
        let tiles = rows.chunks(TILE).flat_map(|rows| columns.chunks(TILE).map(move |c| (rows, c)));
        for (rows, columns) in tiles {
            for (i, j) in rows.iter().flat_map(|i| columns.iter().map(move |j| (*i, *j))) {
                let (a, b) = (i as f64 * TABLE_SAMPLE_MM, j as f64 * TABLE_SAMPLE_MM);
                if matches!(self.table, Table::Disc { radius_mm } if a.hypot(b) > radius_mm) {
                    continue;
                }
                let mut p = centre;
                p[s] += a;
                p[t] += b;
                points.push(p);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pedestal_hangs_under_the_contact_and_the_table_under_it() {
        let frame = Frame { pitch: 1.0, dims: [4, 4, 4], origin: DVec3::ZERO };
        let state = BitGrid::from_fn([4, 4, 4], |[x, _, _]| x < 2);
        let grip = 2.0;
        let contact = Holding::AS_CLAMPED.contact(&state, &frame, grip);
        assert_eq!(contact.count(), 2 * 4 * 2);
        let hold = Workholding {
            pedestal_mm: 10.0,
            table: Table::Disc { radius_mm: 6.0 },
            place: Place::default(),
        };
        let points = hold.obstacle_points(&Holding::AS_CLAMPED, &contact, &frame);
        assert!(points.iter().all(|p| p.z < 0.0));
        let pedestal = points.iter().filter(|p| p.z > -10.0).count();
        assert_eq!(pedestal, 2 * 4 * 10, "every column of a 2-wide footprint is rim");
        assert!(points.iter().any(|p| p.z == -10.0 && (p.x - 1.0).hypot(p.y - 2.0) > 5.0));
    }

    #[test]
    fn a_flipped_part_hangs_from_its_top() {
        let frame = Frame { pitch: 1.0, dims: [3, 3, 3], origin: DVec3::ZERO };
        let full = BitGrid::from_fn([3, 3, 3], |_| true);
        let flipped = Holding { up: Direction::NEG_Z, height_mm: -3.0 };
        let contact = flipped.contact(&full, &frame, 1.0);
        assert!(contact.iter_ones().all(|v| v[2] == 2));
        let table = Table::Box { x_mm: 10.0, y_mm: 10.0 };
        let hold = Workholding { pedestal_mm: 5.0, table, place: Place::default() };
        let points = hold.obstacle_points(&flipped, &contact, &frame);
        assert!(points.iter().all(|p| p.z > 3.0));
    }
}
