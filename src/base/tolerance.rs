//! Tolerances named by the quantity they bound. Each states its unit, what breaks when it is too
//! small or too large, and where its value comes from.

/// Surface tolerance τ in mm for a pitch in mm: how deep unreached material may lie from the
/// reused volume and still count as skin that finishing removes. Below 1.5 voxels the staircase of
/// the grid itself would count as residual; much above 0.5 mm real defects would hide in it.
pub fn surface_mm(pitch_mm: f64) -> f64 {
    (1.5 * pitch_mm).max(0.5)
}

/// How much lower than its depth image allows a nozzle's tip may stand, mm: it rides on the layer
/// it prints, so it may touch its own layer and the voxel staircase, never more.
pub fn nozzle_dip_mm(pitch_mm: f64, layer_mm: f64) -> f64 {
    (1.5 * pitch_mm).min(layer_mm)
}

/// Height in mm over the base plane up to which the part counts as held.
pub fn grip_mm(pitch_mm: f64) -> f64 {
    (2.0 * pitch_mm).max(2.0)
}

/// Largest overhang from the build direction that a bead carries itself, degrees (W2V Sec. 7.1).
pub const OVERHANG_DEG: f64 = 50.0;

/// Deviation δ = (excess + deficit)/target volume at which a plan ends (HB Sec. 6, Eq. 38);
/// skin does not count against it.
pub const DEVIATION: f64 = 0.01;
