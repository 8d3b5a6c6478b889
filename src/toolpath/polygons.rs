//! Booleans, offsets and clipped lines of outlines, by clipper2.

use super::slice::Outline;
use crate::base::DVec2;
use clipper2_rust::{
    ClipType, ClipperD, EndType, FillRule, JoinType, PathsD, PointD, boolean_op_d, inflate_paths_d,
    simplify_paths,
};

/// Digits after the point of fixed-point coordinates, mm: a tenth of a micrometre.
const DIGITS: i32 = 4;

/// Corners sharper than this ratio of miter to offset are cut.
const MITER: f64 = 2.0;

pub(super) fn to_paths(outlines: &[Outline]) -> PathsD {
    outlines.iter().map(|o| o.iter().map(|p| PointD { x: p.x, y: p.y }).collect()).collect()
}

pub(super) fn of_paths(paths: &PathsD) -> Vec<Outline> {
    paths.iter().map(|p| p.iter().map(|q| DVec2::new(q.x, q.y)).collect()).collect()
}

/// Area below which an outline is none, mm²: 0.01 mm square, half the exactness of paths.
const SPECK_MM2: f64 = 1e-4;

/// Outlines moved outward by `by` mm (inward when negative).
///
/// Specks are left out before they are moved inward: rounding decides which way such an outline goes
/// round, and one that goes round the wrong way comes out larger.
pub(super) fn offset(paths: &PathsD, by: f64) -> PathsD {
    if by < 0.0 {
        let is_speck = |p: &Vec<PointD>| clipper2_rust::area(p).abs() < SPECK_MM2;
        if paths.iter().any(is_speck) {
            return offset(&paths.iter().filter(|p| !is_speck(p)).cloned().collect(), by);
        }
    }
    inflate_paths_d(paths, by, JoinType::Miter, EndType::Polygon, MITER, DIGITS, 0.0)
}

/// Points that lie within `eps` mm of their neighbours' chord are dropped.
pub(super) fn simple(paths: &PathsD, eps: f64) -> PathsD {
    simplify_paths(paths, eps, true)
}

pub(super) fn union(a: &PathsD, b: &PathsD) -> PathsD {
    boolean_op_d(ClipType::Union, FillRule::NonZero, a, b, DIGITS)
}

pub(super) fn intersection(a: &PathsD, b: &PathsD) -> PathsD {
    if a.is_empty() || b.is_empty() {
        return PathsD::new();
    }
    boolean_op_d(ClipType::Intersection, FillRule::NonZero, a, b, DIGITS)
}

pub(super) fn difference(a: &PathsD, b: &PathsD) -> PathsD {
    if a.is_empty() || b.is_empty() {
        return a.clone();
    }
    boolean_op_d(ClipType::Difference, FillRule::NonZero, a, b, DIGITS)
}

/// The parts of open lines inside the outlines.
pub(super) fn clip_lines(lines: &[Vec<DVec2>], outlines: &PathsD) -> Vec<Vec<DVec2>> {
    if lines.is_empty() || outlines.is_empty() {
        return Vec::new();
    }
    let mut clipper = ClipperD::new(DIGITS);
    clipper.add_open_subject(&to_paths(lines));
    clipper.add_clip(outlines);
    let (mut closed, mut open) = (PathsD::new(), PathsD::new());
    clipper.execute(ClipType::Intersection, FillRule::NonZero, &mut closed, Some(&mut open));
    of_paths(&open)
}

#[cfg(test)]
mod tests {
    use super::super::slice::area;
    use super::*;

    fn square(side: f64) -> Outline {
        [(0.0, 0.0), (side, 0.0), (side, side), (0.0, side)].map(DVec2::from).to_vec()
    }

    /// Rounding gave a layer beads that its section of next to nothing could not hold.
    #[test]
    fn a_speck_moved_inward_is_nothing_whichever_way_it_goes_round() {
        let mut reversed = square(1e-4);
        reversed.reverse();
        let flat = [(0.0, 0.0), (2e-4, 0.0), (1e-4, 0.0)].map(DVec2::from).to_vec();
        for speck in [square(1e-4), reversed.clone(), flat] {
            assert_eq!(area(&of_paths(&offset(&to_paths(&[speck]), -1.0))), 0.0);
        }
        // Beside something else it changes nothing.
        let inset = offset(&to_paths(&[square(4.0), reversed]), -1.0);
        assert!((area(&of_paths(&inset)) - 4.0).abs() < 1e-3);
    }
}
