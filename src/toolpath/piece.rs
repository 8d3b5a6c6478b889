//! The exact outline of a block's layers: what of the meshes' sections belongs to the block.
//!
//! With S(M), S(M*) the sections of the initial and the target mesh, the material to add at a
//! height is S(M*) − S(M), and what the block puts back where M was cut away. The voxels say only
//! which of it is this block's:
//!
//! ```text
//! outline = (S(M*) ∪ aside) ∩ (¬S(M) ∪ back) ∩ (grown − other)
//! aside   = voxels of the block outside M*, outlined: supports
//! back    = voxels of the block inside M, or at a surface of M that was cut away, outlined
//! grown   = voxels of the block, outlined, grown by REACH
//! other   = voxels of other blocks next to it, outlined
//! ```
//!
//! Guarantees: where the block ends in a surface of M or M*, the outline is the mesh's section.
//! Not guaranteed: faces that cuts made inside M, and faces between blocks, are the voxels'. A
//! mesh with holes has no section; its block's outline is the voxels' altogether.

use super::cross::Sections;
use super::image::Lattice;
use super::mill::Work;
use super::polygons::{difference, intersection, offset, simple, to_paths, union};
use super::slice::{Outline, Slices};
use crate::base::{DVec2, ImagePlane};
use crate::voxel::{BitGrid, Frame};
use clipper2_rust::PathsD;
use std::borrow::Cow;

/// How far outside the voxels' outline the block still owns the material, in pitches: a surface
/// lies at most √3/2 from the voxels' own. More would reach into what no voxel stands for.
const REACH: f64 = 1.2;

pub(super) struct Piece<'a> {
    frame: &'a Frame,
    region: Slices<'a>,
    target: Option<Sections<'a>>,
    initial: Option<Sections<'a>>,
    /// The block is all there is to add: nothing must be told apart.
    alone: bool,
    aside: Slices<'a>,
    back: Slices<'a>,
    other: Slices<'a>,
}

impl<'a> Piece<'a> {
    /// `lattice` must reach two cells beyond the region.
    pub fn new(work: &'a Work, lattice: Lattice, plane: &ImagePlane) -> Piece<'a> {
        let (job, region) = (work.job, &work.step.region);
        let near = region.grown().grown();
        let mut other = job.target.minus(work.after);
        other.union_with(&work.before.minus(&job.initial));
        other.intersect_with(&near);
        other.subtract(region);
        let slices = |grid: Cow<'a, BitGrid>| Slices::new(grid, work.frame, lattice);
        // The mesh reaches up to a voxel farther than its voxels; where those are gone that is, too.
        let gone = job.initial.minus(work.before);
        let standing = job.initial.and(work.before);
        let surface = gone.grown().minus(&standing.grown());
        Piece {
            frame: work.frame,
            region: slices(Cow::Borrowed(region)),
            target: Sections::new(&job.target_mesh, plane),
            initial: Sections::new(&job.initial_mesh, plane),
            alone: *region == job.target,
            aside: slices(Cow::Owned(region.minus(&job.target))),
            back: slices(Cow::Owned(region.and(&job.initial.or(&surface)))),
            other: slices(Cow::Owned(other)),
        }
    }

    /// The voxels' own outline at a height.
    pub fn coarse(&self, z: f64) -> PathsD {
        to_paths(&self.region.at(z))
    }

    /// The outline at a height, holes clockwise.
    pub fn outline(&self, z: f64) -> PathsD {
        let Some(target) = self.target.as_ref().and_then(|t| t.at(z)) else {
            return to_paths(&self.region.at(z));
        };
        let initial = match &self.initial {
            None => Vec::new(),
            Some(m) => match m.at(z) {
                Some(s) => s,
                None => return to_paths(&self.region.at(z)),
            },
        };
        // Cut away again: no need to follow every stair of the voxels.
        let aside = simple(&to_paths(&self.aside.at(z)), self.frame.pitch / 4.0);
        // A slit between the two is no fault: supports are to come off.
        let mut own = union(&to_paths(&target), &aside);
        if !initial.is_empty() {
            let back = to_paths(&self.back.at(z));
            let kept = difference(&to_paths(&initial), &back);
            own = difference(&own, &kept);
        }
        if self.alone {
            return own;
        }
        let mut whole = to_paths(&self.region.at(z));
        if !aside.is_empty() {
            whole = simple(&whole, self.frame.pitch / 8.0);
        }
        let grown = offset(&whole, REACH * self.frame.pitch);
        let other = to_paths(&self.other.at(z));
        intersection(&own, &difference(&grown, &other))
    }

    /// The height of the target's top, when the region's own, `high`, stands for it.
    pub fn top(&self, high: f64, lo: DVec2, hi: DVec2) -> Option<f64> {
        let reach = REACH * self.frame.pitch;
        let margin = DVec2::splat(reach);
        let heights = self.target.as_ref()?.heights_within(lo - margin, hi + margin);
        let top = heights.filter(|z| *z <= high + reach).fold(f64::NEG_INFINITY, f64::max);
        (top >= high - reach).then_some(top)
    }
}

/// Outlines of polygons, to measure them.
pub(super) fn outlines(paths: &PathsD) -> Vec<Outline> {
    super::polygons::of_paths(paths)
}
