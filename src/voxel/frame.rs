use crate::base::{Aabb, DVec3};
use serde::{Deserialize, Serialize};

/// Where a grid lies in the world: cubes of side `pitch` (mm), the first with its lowest corner at
/// `origin` (mm), `dims` of them along x, y, z.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct Frame {
    #[serde(rename = "pitch_mm")]
    pub pitch: f64,
    pub dims: [usize; 3],
    #[serde(rename = "origin_mm")]
    #[schemars(with = "[f64; 3]")]
    pub origin: DVec3,
}

#[derive(Debug, thiserror::Error, PartialEq)]
#[error(
    "a grid of {x} × {y} × {z} mm at pitch {pitch} mm needs {voxels:.1e} voxels, more than \
     {limit:.1e}; set a coarser --resolution or check the units"
)]
pub struct FrameTooLarge {
    pub x: f64,
    pub y: f64,
    pub z: f64,
    pub pitch: f64,
    pub voxels: f64,
    pub limit: f64,
}

/// 2³¹ voxels are 256 MiB a grid; a plan holds about a dozen grids.
pub(super) const MOST_VOXELS: f64 = 2_147_483_648.0;

impl Frame {
    /// The smallest frame of whole pitches, aligned to z = 0 and to multiples of the pitch, that
    /// holds `bounds` with `margin` voxels to spare on every side.
    pub fn around(bounds: Aabb, pitch: f64, margin: usize) -> Result<Frame, FrameTooLarge> {
        let first = (bounds.min / pitch).floor() - DVec3::splat(margin as f64);
        let last = (bounds.max / pitch).ceil() + DVec3::splat(margin as f64);
        let n = (last - first).max(DVec3::ONE);
        let voxels = n.x * n.y * n.z;
        if !(voxels <= MOST_VOXELS && pitch > 0.0) {
            let s = bounds.size();
            return Err(FrameTooLarge {
                x: s.x,
                y: s.y,
                z: s.z,
                pitch,
                voxels,
                limit: MOST_VOXELS,
            });
        }
        Ok(Frame { pitch, dims: [n.x as usize, n.y as usize, n.z as usize], origin: first * pitch })
    }

    /// World position of a voxel's centre, mm.
    pub fn center(&self, voxel: [usize; 3]) -> DVec3 {
        let [x, y, z] = voxel.map(|c| c as f64 + 0.5);
        self.origin + DVec3::new(x, y, z) * self.pitch
    }

    /// Grid coordinates of a world point: voxel (i, j, k) spans [i, i+1) × [j, j+1) × [k, k+1).
    pub fn grid_from_world(&self, p: DVec3) -> DVec3 {
        (p - self.origin) / self.pitch
    }

    /// The voxel that holds a world point, if the grid has it.
    pub fn voxel_at(&self, p: DVec3) -> Option<[usize; 3]> {
        let g = self.grid_from_world(p).floor();
        let inside = g.cmpge(DVec3::ZERO).all()
            && g.x < self.dims[0] as f64
            && g.y < self.dims[1] as f64
            && g.z < self.dims[2] as f64;
        inside.then_some([g.x as usize, g.y as usize, g.z as usize])
    }

    /// Volume of one voxel, mm³.
    pub fn voxel_volume(&self) -> f64 {
        self.pitch.powi(3)
    }

    pub fn voxel_count(&self) -> usize {
        self.dims.iter().product()
    }

    pub fn bounds(&self) -> Aabb {
        let [x, y, z] = self.dims.map(|n| n as f64 * self.pitch);
        Aabb { min: self.origin, max: self.origin + DVec3::new(x, y, z) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_base_plane_is_a_layer_boundary() {
        let b = Aabb { min: DVec3::new(-1.2, 0.3, 0.0), max: DVec3::new(2.0, 2.9, 7.0) };
        let f = Frame::around(b, 0.4, 1).unwrap();
        let layers = -f.origin.z / f.pitch;
        assert!((layers - layers.round()).abs() < 1e-9);
        assert!(f.bounds().min.cmple(b.min).all() && f.bounds().max.cmpge(b.max).all());
    }

    #[test]
    fn centres_and_voxels_invert_each_other() {
        let f = Frame { pitch: 0.7, dims: [5, 4, 3], origin: DVec3::new(-2.0, 1.0, 0.5) };
        for v in [[0, 0, 0], [4, 3, 2], [2, 1, 1]] {
            assert_eq!(f.voxel_at(f.center(v)), Some(v));
        }
        assert_eq!(f.voxel_at(f.origin - DVec3::X), None);
    }

    #[test]
    fn absurd_grids_are_refused_before_memory_is_asked_for() {
        let b = Aabb { min: DVec3::ZERO, max: DVec3::splat(1e6) };
        assert!(Frame::around(b, 0.1, 1).is_err());
        assert!(Frame::around(b, 0.0, 1).is_err());
        assert!(Frame::around(b, f64::NAN, 1).is_err());
    }
}
