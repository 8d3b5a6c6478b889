//! Lines of a layer that lie mostly on others: left out where too much is laid on the whole.
//!
//! Method: a raster of an eighth of a bead tells what loops and lines cover. Line after line is kept if at least half of
//! what it covers is bare so far. In small narrow regions lines that end on perimeters, round ends and all, are
//! mostly laid on these.
//!
//! Guarantees: a line that is left out lies to at least half on beads of its layer. Loops stay as they are, however
//! they lap. Not guaranteed: that the rest is within any share of what it covers.

use super::infill::{Line, length};
use crate::base::DVec2;
use std::collections::BTreeSet;

/// Cells of the raster across a bead.
const CELLS: f64 = 8.0;

/// A line is kept if this share of what it covers is bare.
const LEAST_BARE: f64 = 0.5;

/// What lines a bead wide cover.
struct Cover {
    width: f64,
    cells: BTreeSet<[i64; 2]>,
}

impl Cover {
    fn none(width: f64) -> Cover {
        Cover { width, cells: BTreeSet::new() }
    }

    /// Cells whose middles a line covers.
    fn of(&self, line: &Line) -> BTreeSet<[i64; 2]> {
        let (cell, radius) = (self.width / CELLS, self.width / 2.0);
        let mut cells = BTreeSet::new();
        for ends in line.windows(2) {
            let (a, b) = (ends[0], ends[1]);
            let low = ((a.min(b) - radius) / cell).floor();
            let high = ((a.max(b) + radius) / cell).ceil();
            for j in low.y as i64..=high.y as i64 {
                for i in low.x as i64..=high.x as i64 {
                    let p = DVec2::new(i as f64, j as f64) * cell;
                    let along =
                        (p - a).dot(b - a) / (b - a).length_squared().max(f64::MIN_POSITIVE);
                    if p.distance(a.lerp(b, along.clamp(0.0, 1.0))) <= radius {
                        cells.insert([i, j]);
                    }
                }
            }
        }
        cells
    }

    fn add(&mut self, cells: BTreeSet<[i64; 2]>) {
        self.cells.extend(cells);
    }

    fn area(&self) -> f64 {
        self.cells.len() as f64 * (self.width / CELLS).powi(2)
    }
}

/// What the loops and lines of a layer lay and what they cover, mm².
pub(super) fn laid_and_covered(loops: &[Line], fill: &[Line], width: f64) -> [f64; 2] {
    let mut cover = Cover::none(width);
    let all = || loops.iter().chain(fill);
    all().for_each(|line| cover.add(cover.of(line)));
    [width * all().map(length).sum::<f64>(), cover.area()]
}

/// Lines without those that lie mostly on loops or on lines before them.
pub(super) fn without_lapped(loops: &[Line], fill: Vec<Line>, width: f64) -> Vec<Line> {
    let mut cover = Cover::none(width);
    loops.iter().for_each(|line| cover.add(cover.of(line)));
    let is_worth_it = |line: &Line| {
        let cells = cover.of(line);
        let bare = cells.difference(&cover.cells).count();
        let keep = bare as f64 >= LEAST_BARE * cells.len() as f64;
        if keep {
            cover.add(cells);
        }
        keep
    };
    fill.into_iter().filter(is_worth_it).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: f64 = 0.5;

    fn line(from: [f64; 2], to: [f64; 2]) -> Line {
        vec![DVec2::from_array(from), DVec2::from_array(to)]
    }

    #[test]
    fn a_line_covers_its_length_and_two_half_discs() {
        let [laid, covered] = laid_and_covered(&[], &[line([1.0, 2.0], [4.0, 6.0])], WIDTH);
        assert!((laid - 2.5).abs() < 1e-9);
        let want = 2.5 + std::f64::consts::PI * WIDTH * WIDTH / 4.0;
        assert!((covered - want).abs() < 0.02 * want, "{covered} {want}");
    }

    /// A rim and lines between its sides, which are as far apart as a bead and a half.
    #[test]
    fn short_lines_between_narrow_walls_are_left_out_and_others_stay() {
        let rim = [line([0.0, 0.0], [6.0, 0.0]), line([0.0, 0.75], [6.0, 0.75])];
        let across: Vec<Line> =
            (1..11).map(|k| line([0.5 * k as f64, 0.25], [0.5 * k as f64, 0.5])).collect();
        let out = line([2.0, 1.0], [2.0, 4.0]);
        let fill: Vec<Line> = across.into_iter().chain([out.clone(), out.clone()]).collect();
        assert_eq!(without_lapped(&rim, fill.clone(), WIDTH), vec![out]);
        let [laid, covered] = laid_and_covered(&rim, &fill, WIDTH);
        assert!(laid > covered, "{laid} {covered}");
    }
}
