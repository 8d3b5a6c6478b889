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

/// Outlines moved outward by `by` mm (inward when negative).
pub(super) fn offset(paths: &PathsD, by: f64) -> PathsD {
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
