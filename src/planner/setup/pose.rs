//! The setup search with the initial part's pose left open as well: on which of its own faces it is
//! clamped.
//!
//! Method. The initial part is laid on each face it can rest on (a face of its convex hull that
//! belongs to it, with the centroid over it), as it lies in its file first, and the setup is searched
//! for each. The pose whose winner has the highest Score₂ is taken; winners that reuse far less than
//! the best of them do not compete, and the pose of the file is left only for a score that is better
//! by more than noise: the rules within one search, across all of them.
//!
//! Guarantees: a pose leaves the part stable by its own weight, its lowest point on z = 0; the same
//! answer at any thread count. Not guaranteed: that a clamp finds room there, or that another pose
//! that only a vise can hold would not be better. Takes one search for each pose.

use super::{FILE_POSE_WORTH, LEAST_SHARE, RESTING, SetupOptions, SetupReport, rotations, search};
use crate::base::{Ctx, DAffine3, DVec3};
use crate::mesh::TriMesh;
use crate::planner::PlanError;

/// A pose of the initial part, and the target's places in it.
#[derive(Clone, Debug, PartialEq)]
pub struct PosedSetup {
    /// From the initial part as it stood to how it lies, its lowest point on z = 0.
    pub initial: DAffine3,
    pub report: SetupReport,
    /// Poses that were searched, and which of them this is, from 0; 0 is the one it had.
    pub poses: usize,
    pub pose: usize,
}

impl PosedSetup {
    /// One sentence for people.
    pub fn note(&self) -> String {
        if self.pose == 0 {
            return format!(
                "Initial part: as it lies in its file, the best of {} poses searched.",
                self.poses
            );
        }
        let (axis, degrees) = rotations::axis_angle(&self.initial.matrix3);
        format!(
            "Initial part: laid on another face, {degrees:.1}° about ({:.2}, {:.2}, {:.2}), the best \
             of {} poses searched.",
            axis.x, axis.y, axis.z, self.poses
        )
    }
}

/// Finds the pose of the initial part, which stands on z = 0, and the target's place in it.
///
/// # Errors
/// Those of [`search`].
pub fn search_poses(
    initial: &TriMesh,
    target: &TriMesh,
    options: &SetupOptions,
    ctx: &Ctx,
) -> Result<PosedSetup, PlanError> {
    let upright = rotations::upright(initial, RESTING);
    let middle = initial.bounds().center();
    let mut found: Vec<(DAffine3, SetupReport)> = Vec::with_capacity(upright.len());
    for rotation in &upright {
        // About its own middle, so that it stays as near the origin as it was.
        let turned = DAffine3::from_translation(middle)
            * DAffine3::from_mat3(*rotation)
            * DAffine3::from_translation(-middle);
        let lowest = initial.vertices().iter().map(|v| turned.transform_point3(*v).z);
        let floor = lowest.fold(f64::INFINITY, f64::min);
        let motion = DAffine3::from_translation(DVec3::Z * -floor) * turned;
        // Left out only where it would reach beyond the coordinates meshes may have.
        let Ok(mesh) = initial.transformed(&motion) else { continue };
        found.push((motion, search(&mesh, target, options, ctx)?));
    }
    let most = found.iter().map(|(_, r)| r.winner.reused_share).fold(0.0, f64::max);
    let worth = |i: usize| {
        let winner = &found[i].1.winner;
        let competes = winner.reused_share >= LEAST_SHARE * most;
        let own = if i == 0 { FILE_POSE_WORTH } else { 0.0 };
        if competes { winner.score_fine + own } else { f64::NEG_INFINITY }
    };
    // The first among equals.
    let best = (0..found.len()).fold(0, |best, i| if worth(i) > worth(best) { i } else { best });
    let poses = found.len();
    let (initial, report) = found.swap_remove(best);
    Ok(PosedSetup { initial, report, poses, pose: best })
}
