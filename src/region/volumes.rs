use crate::base::DVec3;
use crate::machine::{Holding, HoldingMode};
use crate::voxel::{BitGrid, Connectivity, Frame, components, flood};

/// The three volumes of W2V Sec. 3: they partition M ∪ M*.
#[derive(Clone, Debug)]
pub struct Volumes {
    /// Ṽ_R = M ∩ M*, less the pieces that nothing would hold, unless deposits are to.
    pub reused: BitGrid,
    /// Ṽ_S = M − Ṽ_R.
    pub removed: BitGrid,
    /// Ṽ_A = M* − Ṽ_R.
    pub added: BitGrid,
}

impl Volumes {
    /// The volumes when at most `reusable` of M ∩ M* is kept: the steady part of it is reused,
    /// what would fall off goes to removed and added at once.
    pub fn keeping(
        initial: &BitGrid,
        target: &BitGrid,
        reusable: &BitGrid,
        frame: &Frame,
        mode: HoldingMode,
        grip_mm: f64,
    ) -> Volumes {
        let mut kept = initial.and(target);
        kept.intersect_with(reusable);
        let reused = steady(&kept, frame, mode, grip_mm);
        Volumes { removed: initial.minus(&reused), added: target.minus(&reused), reused }
    }
}

/// The part of `solid` that stays where it is: connected to its base contact, or, where steps may
/// hold the part anew, its largest body (of equals the one with the first voxel).
pub fn steady(solid: &BitGrid, frame: &Frame, mode: HoldingMode, grip_mm: f64) -> BitGrid {
    match mode {
        HoldingMode::Base => {
            let contact = Holding::AS_CLAMPED.contact(solid, frame, grip_mm);
            flood(solid, &contact, Connectivity::Edge18)
        }
        HoldingMode::Refixture => {
            let bodies = components(solid, Connectivity::Edge18);
            let sizes = bodies.sizes();
            let largest = (0..sizes.len()).max_by_key(|&i| (sizes[i], std::cmp::Reverse(i)));
            largest.map_or_else(|| BitGrid::new(solid.dims()), |i| bodies.grid_of(i as u32))
        }
    }
}

/// The voxels of `solid` on the positive side of normal · x > offset.
pub fn above(solid: &BitGrid, frame: &Frame, normal: DVec3, offset: f64) -> BitGrid {
    BitGrid::from_fn(solid.dims(), |v| solid.get(v) && normal.dot(frame.center(v)) > offset)
}
