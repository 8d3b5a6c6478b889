//! What one placement of the target reuses, and where its printing bases lie.
//!
//! Either part is voxelised once, in its own axes. A placement moves the target's voxel centres
//! and looks them up in the initial part's grid, which is finer; the interface is measured at
//! points of the initial part's surface, looked up in the target's grid. So the noise of a
//! placement is that of the looked-up grid, not of the coarse one, and no mesh is cut.

use super::{Problem, SetupOptions};
use crate::base::{Aabb, Ctx, DAffine3, DMat3, DVec3, tolerance};
use crate::machine::HoldingMode;
use crate::mesh::TriMesh;
use crate::planner::PlanError;
use crate::region::steady;
use crate::voxel::{BitGrid, Connectivity, Frame, flood, voxelise};

/// Solid voxels of the target that are looked up for a placement. Fewer blur the scores (their
/// noise falls with the root of the number); more take time in proportion.
const SAMPLES: f64 = 60_000.0;

/// Most voxels in the box of a sampling grid: bounds memory where the part fills little of its box.
const MOST_BOX: f64 = 2e6;

/// Most voxels along an axis: bounds memory for needles, whose box has hardly a volume.
const MOST_ALONG: f64 = 1024.0;

/// The looked-up grid is so many times finer than the sampling grid. Odd, so that the centres of
/// the coarse one are centres of the fine one and a part kept in place meets itself exactly.
const FINER: f64 = 3.0;

/// Most voxels in the box of a looked-up grid.
const MOST_FINE_BOX: f64 = 3e7;

/// Points on the initial part's surface at which the interface is measured: areas are good to
/// about a hundredth.
const SURFACE_POINTS: usize = 20_000;

/// Area of an interface, in squares of the sampling pitch, that is no base: specks of this size
/// come and go with the grid, and the lowest of them would decide how low the bases lie.
const STRAY_SQUARES: f64 = 4.0;

/// A part is held by a contact as wide as this share of the edge of a cube of the target's volume, through the grip's
/// height. On tiptoe a voxel or two of another grid would do: a plan on its own grid then finds nothing held and
/// gives up all. By trial on one such pair: of 0.06, 0.1 and 0.13 it kept 0.50, 0.84 and 0.77 of the target.
const HOLD_SHARE: f64 = 0.1;

/// Where the initial part itself stands on less, this share of its contact is enough.
const CONTACT_SHARE: f64 = 0.5;

/// A solid on a grid in its own axes.
pub(super) struct Lattice {
    frame: Frame,
    solid: BitGrid,
    voxels: usize,
}

impl Lattice {
    fn new(
        mesh: &TriMesh,
        pitch: f64,
        which: &'static str,
        ctx: &Ctx,
    ) -> Result<Lattice, PlanError> {
        let thin = || PlanError::Unmeasurable { which, pitch_mm: pitch };
        let frame = Frame::around(mesh.bounds(), pitch, 1).map_err(|_| thin())?;
        let solid = voxelise(mesh, &frame, ctx)?;
        let voxels = solid.count();
        if voxels == 0 { Err(thin()) } else { Ok(Lattice { frame, solid, voxels }) }
    }

    /// Volume up to a height, mm³.
    fn contact_mm3(&self, height_mm: f64) -> f64 {
        let frame = &self.frame;
        let is_low = |z: &usize| frame.center([0, 0, *z]).z <= height_mm;
        let layers = (0..frame.dims[2]).take_while(is_low).count();
        let rows = self.solid.runs().filter(|(_, z, _, _)| *z < layers);
        rows.map(|(_, _, _, len)| len as f64).sum::<f64>() * frame.voxel_volume()
    }

    fn holds(&self, grid: &BitGrid, p: DVec3) -> bool {
        grid.get_or_empty(self.frame.grid_from_world(p).floor().to_array().map(|c| c as i64))
    }
}

/// The pitch (mm) that gives a solid about [`SAMPLES`] voxels, and a sheet three layers.
fn sampling_pitch(mesh: &TriMesh) -> f64 {
    let s = mesh.bounds().size();
    let in_box = s.x * s.y * s.z;
    let volume = mesh.signed_volume().abs().min(in_box);
    let wanted = (volume / SAMPLES).cbrt().min(s.min_element() / 3.0);
    wanted.max((in_box / MOST_BOX).cbrt()).max(s.max_element() / MOST_ALONG)
}

fn fine_pitch(bounds: Aabb, pitch: f64) -> f64 {
    let s = bounds.size();
    let by_box = (s.x * s.y * s.z / MOST_FINE_BOX).cbrt().max(s.max_element() / MOST_ALONG);
    (pitch / FINER).max(by_box)
}

/// Which grid of the target is looked up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Sampling {
    Coarse,
    Fine,
}

/// Both parts, ready to be measured in any placement.
pub(super) struct Pair {
    initial: Lattice,
    coarse: Lattice,
    fine: Lattice,
    /// Points of the initial part's surface with their unit normals; each stands for
    /// `point_area` mm².
    surface: Vec<(DVec3, DVec3)>,
    point_area: f64,
    /// Outward normals of the target's triangles, times their areas.
    faces: Vec<DVec3>,
    target_area: f64,
    /// Height within which the part counts as held on the sampling grid, mm.
    pub grip_mm: f64,
    /// Least volume within it that holds the part, mm³.
    hold_mm3: f64,
    holding: HoldingMode,
}

/// What Score₂ asks of the printing bases.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Measured {
    /// Volume of the kept Ṽ_R by the target's.
    pub share: f64,
    /// Highest point of the kept Ṽ_R over the base plane, mm.
    pub top_mm: f64,
    /// Lowest point of the interface, mm; none when nothing is to be printed on Ṽ_R.
    pub lowest_mm: Option<f64>,
    /// Area of the interface by the target's surface.
    pub base_share: f64,
}

impl Pair {
    pub fn new(problem: &Problem, options: &SetupOptions, ctx: &Ctx) -> Result<Pair, PlanError> {
        let Problem { initial, target } = problem;
        for (which, mesh) in [("initial", initial), ("target", target)] {
            if mesh.is_empty() || mesh.area() <= 0.0 {
                return Err(PlanError::Unmeasurable { which, pitch_mm: 0.0 });
            }
        }
        let pitch = sampling_pitch(target);
        let fine = fine_pitch(target.bounds(), pitch);
        let (surface, point_area) = surface_points(initial);
        let coarse = Lattice::new(target, pitch, "target", ctx)?;
        let grip_mm = options.grip_mm.max(tolerance::grip_mm(pitch));
        let side_mm = (coarse.voxels as f64).cbrt() * pitch;
        let lattice = Lattice::new(initial, fine_pitch(initial.bounds(), pitch), "initial", ctx)?;
        let contact_mm3 = lattice.contact_mm3(grip_mm);
        let outward = if target.signed_volume() < 0.0 { -0.5 } else { 0.5 };
        Ok(Pair {
            initial: lattice,
            coarse,
            fine: Lattice::new(target, fine, "target", ctx)?,
            surface,
            point_area,
            faces: (0..target.triangles().len()).map(|t| outward * target.area_normal(t)).collect(),
            target_area: target.area(),
            grip_mm,
            hold_mm3: (grip_mm * (HOLD_SHARE * side_mm).powi(2)).min(CONTACT_SHARE * contact_mm3),
            holding: options.holding,
        })
    }

    /// Area(T) by the target's: its faces that carry themselves when printed upward.
    pub fn self_supporting(&self, rotation: &DMat3) -> f64 {
        let up = rotation.transpose() * DVec3::Z;
        let least = -tolerance::OVERHANG_DEG.to_radians().sin();
        let area: f64 =
            self.faces.iter().filter(|n| n.dot(up) >= least * n.length()).map(|n| n.length()).sum();
        (area / self.target_area).min(1.0)
    }

    /// Volume of the kept Ṽ_R by the target's.
    pub fn share(&self, place: &DAffine3) -> f64 {
        self.kept(&self.coarse, place).count() as f64 / self.coarse.voxels as f64
    }

    pub fn measure(&self, sampling: Sampling, place: &DAffine3) -> Measured {
        let lattice = match sampling {
            Sampling::Coarse => &self.coarse,
            Sampling::Fine => &self.fine,
        };
        let kept = self.kept(lattice, place);
        let (lowest_mm, area) = self.interface(lattice, &kept, place);
        Measured {
            share: kept.count() as f64 / lattice.voxels as f64,
            top_mm: top(lattice, &kept, place),
            lowest_mm,
            base_share: (area / self.target_area).min(1.0),
        }
    }

    /// Ṽ_R in the target's axes, less the pieces that nothing would hold.
    fn kept(&self, lattice: &Lattice, place: &DAffine3) -> BitGrid {
        let h = lattice.frame.pitch;
        let first = place.transform_point3(lattice.frame.center([0; 3]));
        let to = &self.initial.frame;
        // Grid coordinates in the initial part's grid, of the first voxel and per step.
        let origin = to.grid_from_world(first);
        let step = place.matrix3 * (h / to.pitch);
        let climb = place.matrix3.transpose() * DVec3::Z * h;
        let mut reused = BitGrid::new(lattice.solid.dims());
        let mut contact = BitGrid::new(lattice.solid.dims());
        for (y, z, x, len) in lattice.solid.runs() {
            let row = origin + step.y_axis * y as f64 + step.z_axis * z as f64;
            let height = first.z + climb.y * y as f64 + climb.z * z as f64;
            for i in x..x + len {
                let p = (row + step.x_axis * i as f64).floor();
                if self.initial.solid.get_or_empty([p.x as i64, p.y as i64, p.z as i64]) {
                    reused.set([i, y, z], true);
                    if height + climb.x * i as f64 <= self.grip_mm {
                        contact.set([i, y, z], true);
                    }
                }
            }
        }
        match self.holding {
            HoldingMode::Base if (contact.count() as f64) * h.powi(3) < self.hold_mm3 => {
                BitGrid::new(lattice.solid.dims())
            }
            HoldingMode::Base => flood(&reused, &contact, Connectivity::Edge18),
            HoldingMode::Refixture => {
                steady(&reused, &lattice.frame, HoldingMode::Refixture, self.grip_mm)
            }
        }
    }

    /// Lowest point (mm) and area (mm²) of the interface of `kept` and what is to be added: the
    /// points of the initial part's surface with kept material a pitch off on one side and target
    /// that is not kept on the other. A pitch is more than half the diagonal of a voxel, so a flat
    /// interface is never missed; a layer thinner than a pitch is not seen.
    fn interface(&self, lattice: &Lattice, kept: &BitGrid, place: &DAffine3) -> (Option<f64>, f64) {
        let part_from_world = place.inverse();
        let off = self.coarse.frame.pitch;
        let mut heights = Vec::new();
        for (p, n) in &self.surface {
            let [a, b] = [1.0, -1.0].map(|s| part_from_world.transform_point3(*p + *n * (s * off)));
            let (kept_a, kept_b) = (lattice.holds(kept, a), lattice.holds(kept, b));
            let added = |q| lattice.holds(&lattice.solid, q);
            if (kept_a && !kept_b && added(b)) || (kept_b && !kept_a && added(a)) {
                heights.push(p.z);
            }
        }
        let area = heights.len() as f64 * self.point_area;
        let stray = (STRAY_SQUARES * off * off / self.point_area) as usize;
        heights.sort_unstable_by(f64::total_cmp);
        (heights.get(stray).copied(), area)
    }
}

/// Height of the highest point of a set of voxels, mm.
fn top(lattice: &Lattice, set: &BitGrid, place: &DAffine3) -> f64 {
    let ends = set.runs().flat_map(|(y, z, x, len)| [[x, y, z], [x + len - 1, y, z]]);
    let highest = ends
        .map(|v| place.transform_point3(lattice.frame.center(v)).z)
        .fold(f64::NEG_INFINITY, f64::max);
    highest + lattice.frame.pitch / 2.0
}

/// [`SURFACE_POINTS`] points of a mesh with unit normals, each standing for the same area (mm²):
/// at equal steps along the triangles' running area, inside each by a plastic-number sequence.
fn surface_points(mesh: &TriMesh) -> (Vec<(DVec3, DVec3)>, f64) {
    const PLASTIC: [f64; 2] = [0.754_877_666_246_692_8, 0.569_840_290_998_053_3];
    let each = mesh.area() / SURFACE_POINTS as f64;
    let mut points = Vec::with_capacity(SURFACE_POINTS);
    let mut passed = 0.0;
    for t in 0..mesh.triangles().len() {
        let normal = mesh.area_normal(t);
        passed += normal.length() / 2.0;
        let Some(unit) = normal.try_normalize() else { continue };
        let [a, b, c] = mesh.corners(t);
        while points.len() < SURFACE_POINTS && (points.len() as f64 + 0.5) * each < passed {
            let i = (points.len() + 1) as f64;
            let (u, v) = ((i * PLASTIC[0]).fract(), (i * PLASTIC[1]).fract());
            let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
            points.push((a + (b - a) * u + (c - a) * v, unit));
        }
    }
    (points, each)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn block(x: f64, y: f64, z: f64) -> TriMesh {
        TriMesh::cuboid(DVec3::ZERO, DVec3::new(x, y, z))
    }

    fn pair(initial: &TriMesh, target: &TriMesh) -> Pair {
        let options = SetupOptions::default();
        Pair::new(&Problem { initial, target }, &options, &Ctx::quiet()).unwrap()
    }

    #[test]
    fn a_block_made_twice_as_high_prints_on_its_top() {
        let (initial, target) = (block(40.0, 40.0, 20.0), block(40.0, 40.0, 40.0));
        let pair = pair(&initial, &target);
        // Of the six faces only the bottom does not carry itself.
        assert!((pair.self_supporting(&DMat3::IDENTITY) - 5.0 / 6.0).abs() < 1e-12);
        for sampling in [Sampling::Coarse, Sampling::Fine] {
            let m = pair.measure(sampling, &DAffine3::IDENTITY);
            assert!((m.share - 0.5).abs() < 0.02, "{m:?}");
            assert!((m.top_mm - 20.0).abs() < 0.6, "{m:?}");
            assert!((m.lowest_mm.unwrap() - 20.0).abs() < 1e-9, "{m:?}");
            assert!((m.base_share - 1.0 / 6.0).abs() < 0.005, "{m:?}");
        }
    }

    #[test]
    fn beside_the_block_the_base_reaches_the_ground() {
        // Half the target's foot is on the block; the interface is the block's side.
        let (initial, target) = (block(20.0, 40.0, 40.0), block(40.0, 40.0, 40.0));
        let m = pair(&initial, &target).measure(Sampling::Coarse, &DAffine3::IDENTITY);
        assert!((m.share - 0.5).abs() < 0.02 && m.lowest_mm.unwrap() < 2.0, "{m:?}");
        assert!((m.base_share - 1.0 / 6.0).abs() < 0.01, "{m:?}");
    }

    #[test]
    fn what_nothing_holds_is_not_reused() {
        let (initial, target) = (block(20.0, 20.0, 20.0), block(20.0, 20.0, 20.0));
        let pair = pair(&initial, &target);
        let raised = DAffine3::from_translation(DVec3::Z * 10.0);
        let m = pair.measure(Sampling::Coarse, &raised);
        assert_eq!((m.share, m.base_share, m.lowest_mm), (0.0, 0.0, None));
        let lowered = pair.measure(Sampling::Coarse, &raised.inverse());
        assert!((lowered.share - 0.5).abs() < 0.03);
    }

    /// A cube of 20 mm in a deep block, on its foot and on a corner, whose tip of 2 mm holds 7 mm³.
    #[test]
    fn what_a_tip_alone_holds_is_not_reused() {
        let (initial, target) = (block(80.0, 80.0, 80.0), block(20.0, 20.0, 20.0));
        let pair = pair(&initial, &target);
        let middle = DAffine3::from_translation(DVec3::new(40.0, 40.0, 0.0));
        let m = pair.measure(Sampling::Coarse, &middle);
        assert!(m.share > 0.97, "{m:?}");
        let up = DVec3::ONE.normalize();
        let tiptoe = middle * DAffine3::from_quat(glam::DQuat::from_rotation_arc(up, DVec3::Z));
        for (sunk, held) in [(0.0, false), (2.0, true)] {
            let place = DAffine3::from_translation(DVec3::Z * -sunk) * tiptoe;
            let m = pair.measure(Sampling::Coarse, &place);
            assert_eq!(m.share > 0.9, held, "{m:?}");
        }
    }

    /// Both on the same corner: the whole of a small contact holds.
    #[test]
    fn a_tip_holds_where_the_initial_part_stands_on_no_more() {
        let up = glam::DQuat::from_rotation_arc(DVec3::ONE.normalize(), DVec3::Z);
        let cube = block(20.0, 20.0, 20.0).transformed(&DAffine3::from_quat(up)).unwrap();
        let m = pair(&cube, &cube).measure(Sampling::Coarse, &DAffine3::IDENTITY);
        assert!(m.share > 0.97, "{m:?}");
    }

    #[test]
    fn a_part_kept_in_place_meets_itself_exactly() {
        let mut m = block(37.0, 23.0, 11.0);
        m = m.transformed(&DAffine3::from_rotation_z(0.4)).unwrap();
        let found = pair(&m, &m).measure(Sampling::Fine, &DAffine3::IDENTITY);
        assert_eq!((found.share, found.base_share, found.lowest_mm), (1.0, 0.0, None));
    }

    #[test]
    fn needles_and_sheets_ask_for_no_more_memory_than_blocks() {
        for (x, y, z) in [(1e6, 1e-3, 1e-3), (1e6, 1e6, 1e-6), (1e-6, 1e-6, 1e-6), (1e8, 1e8, 1e8)]
        {
            let m = block(x, y, z);
            let options = SetupOptions::default();
            let made = Pair::new(&Problem { initial: &m, target: &m }, &options, &Ctx::quiet());
            if let Ok(pair) = made {
                assert!(pair.fine.frame.voxel_count() < 40_000_000);
            }
        }
    }
}
