//! The depth engine.
//!
//! Symbols: s spacing of the tip lattice (h along grid axes, h/2 otherwise), c a lattice cell,
//! f(ρ) the tool's lower surface, k(ρ) that of its active part (mm over the tip).
//!
//! Every rounding is on the safe side. A point is stored in the cell nearest to it, at most
//! s/√2 away, so a tip at a cell's centre is at least |c − c′| − s/√2 from it; since f never
//! falls outward, f at that smaller radius is a lower bound. Along grid axes points and tips
//! coincide with cell centres and nothing is lost. Sections wider than [`WIDEST_CELLS`] cells are
//! treated on an image pooled by a power of two, where both the point and the tip may be
//! anywhere in their cell.

use super::Scene;
use crate::base::{Aabb, DVec2, DVec3, Direction, ImagePlane};
use crate::machine::{Section, Shape, Tool};
use crate::voxel::Frame;
use rayon::prelude::*;

/// Largest radius of a section in cells of the image it is treated on. Larger is slower by its
/// square; smaller makes wide sections wider than they are (by at most √2/12 at this value).
const WIDEST_CELLS: f64 = 24.0;

/// Margin in mm that hides the rounding of f32 heights (parts up to metres) from the verdict.
const ROUNDING_MM: f32 = 1e-4;

/// Lowest height per lattice cell at which something holds; see [`cutter_map`], [`nozzle_map`].
pub struct DepthMap {
    plane: ImagePlane,
    lattice: Lattice,
    lowest: Vec<f32>,
}

impl DepthMap {
    /// Whether the point at `p` may be cut (or deposited) along the map's direction.
    pub fn reaches(&self, p: DVec3) -> bool {
        match self.lattice.cell(self.plane.across(p)) {
            Some(c) => self.plane.height(p) as f32 >= self.lowest[c] + ROUNDING_MM,
            None => false,
        }
    }
}

/// A window of the tip lattice of a direction.
#[derive(Clone, Copy)]
struct Lattice {
    spacing: f64,
    /// (u, v) of cell (0, 0).
    first: DVec2,
    nu: usize,
    nv: usize,
}

impl Lattice {
    /// Cells that hold every point of the box `b` and `margin` mm around it. `pool` cells of
    /// the tip lattice, which is anchored to the frame, make one cell along each axis.
    fn around(
        frame: &Frame,
        b: &Aabb,
        plane: &ImagePlane,
        spacing: f64,
        margin: f64,
        pool: usize,
    ) -> Self {
        let anchor = plane.across(frame.center([0, 0, 0]));
        let (mut lo, mut hi) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        for i in 0..8 {
            let pick = |bit: usize, lo: f64, hi: f64| if i >> bit & 1 == 0 { lo } else { hi };
            let corner = DVec3::new(
                pick(0, b.min.x, b.max.x),
                pick(1, b.min.y, b.max.y),
                pick(2, b.min.z, b.max.z),
            );
            let uv = plane.across(corner);
            (lo, hi) = (lo.min(uv), hi.max(uv));
        }
        let spacing = spacing * pool as f64;
        let first = ((lo - anchor - DVec2::splat(margin)) / spacing).floor();
        let last = ((hi - anchor + DVec2::splat(margin)) / spacing).ceil();
        let n = last - first + DVec2::ONE;
        Lattice { spacing, first: anchor + first * spacing, nu: n.x as usize, nv: n.y as usize }
    }

    /// The cell nearest to (u, v).
    #[inline]
    fn cell(&self, uv: DVec2) -> Option<usize> {
        let i = ((uv.x - self.first.x) / self.spacing + 0.5).floor();
        let j = ((uv.y - self.first.y) / self.spacing + 0.5).floor();
        let inside = i >= 0.0 && j >= 0.0 && i < self.nu as f64 && j < self.nv as f64;
        inside.then(|| i as usize + self.nu * j as usize)
    }
}

/// Spacing of the tip lattice of a direction, mm.
fn spacing(frame: &Frame, direction: Direction) -> f64 {
    if direction.is_grid_axis() { frame.pitch } else { frame.pitch / 2.0 }
}

/// Distance by which rounding a point to its cell may move it, in cells: none on the grid axes,
/// half a diagonal elsewhere.
fn rounding_cells(direction: Direction) -> f64 {
    if direction.is_grid_axis() { 0.0 } else { std::f64::consts::FRAC_1_SQRT_2 }
}

/// G of the depth engine: a voxel x in the box `within` can be cut along `direction` when
/// x_z ≥ G at its cell.
pub fn cutter_map(scene: &Scene, within: &Aabb, tool: &Tool, direction: Direction) -> DepthMap {
    let plane = direction.image_plane();
    let s = spacing(&scene.frame, direction);
    let rounding = rounding_cells(direction);
    let radius = tool.active_radius();
    let lift: Vec<(Section, f64)> = tool.sections.iter().map(|sec| (*sec, 0.0)).collect();
    let (window, free) = lowest_tip(scene, within, &plane, s, radius + s, &lift, rounding);
    let mut kernel = Vec::new();
    let reach = (radius / s).floor() as isize;
    // A face mill spans hundreds of cells; every n-th tip of them suffices, since missing a tip
    // only misses a position.
    let stride = (reach as f64 / WIDEST_CELLS).ceil().max(1.0) as isize;
    for j in (-reach..=reach).filter(|j| j % stride == 0) {
        for i in (-reach..=reach).filter(|i| i % stride == 0) {
            let rho = ((i * i + j * j) as f64).sqrt() * s + rounding * s;
            let k = tool.active_lower_surface(rho);
            if k.is_finite() {
                kernel.push((i, j, k as f32));
            }
        }
    }
    let mut lowest = vec![f32::INFINITY; window.nu * window.nv];
    filter(&window, &free, &window, &mut lowest, &kernel, |best, h, k| {
        let g = h + k;
        if g < *best {
            *best = g
        }
    });
    DepthMap { plane, lattice: window, lowest }
}

/// H of a nozzle whose tip stands at the deposited voxel: x in the box `within` can be deposited
/// when x_z ≥ H at its cell. Sections that reach the tip may stand `dip_mm` lower than the
/// obstacles allow.
pub fn nozzle_map(
    scene: &Scene,
    within: &Aabb,
    tool: &Tool,
    direction: Direction,
    dip_mm: f64,
) -> DepthMap {
    let plane = direction.image_plane();
    let s = spacing(&scene.frame, direction);
    // Here the tip too is anywhere in its cell.
    let rounding = 2.0 * rounding_cells(direction);
    let lift: Vec<(Section, f64)> = tool
        .sections
        .iter()
        .map(|sec| (*sec, if sec.shape.lower_surface(0.0) == 0.0 { dip_mm } else { 0.0 }))
        .collect();
    let (lattice, lowest) = lowest_tip(scene, within, &plane, s, s, &lift, rounding);
    DepthMap { plane, lattice, lowest }
}

/// H over the box `within` and `margin` mm around it: max over obstacle points of
/// o_z − f(ρ) − lift, section by section.
fn lowest_tip(
    scene: &Scene,
    within: &Aabb,
    plane: &ImagePlane,
    spacing: f64,
    margin: f64,
    sections: &[(Section, f64)],
    rounding_cells: f64,
) -> (Lattice, Vec<f32>) {
    let window = Lattice::around(&scene.frame, within, plane, spacing, margin, 1);
    let mut lowest = vec![f32::NEG_INFINITY; window.nu * window.nv];
    let mut images: Vec<(usize, Lattice, Vec<f32>)> = Vec::new();
    for &(section, lift) in sections {
        if let Shape::Platform { z } = section.shape {
            let top = scene.points().iter().map(|p| plane.height(*p)).fold(f64::MIN, f64::max);
            let floor = (top - z - lift) as f32;
            lowest.iter_mut().for_each(|h| *h = h.max(floor));
            continue;
        }
        let radius = section.shape.max_radius();
        let mut pool = 1;
        while radius / (spacing * pool as f64) > WIDEST_CELLS {
            pool *= 2;
        }
        if !images.iter().any(|(p, ..)| *p == pool) {
            // One image per pooling, wide enough for every section treated on it.
            let wide = margin + (WIDEST_CELLS + 2.0) * pool as f64 * spacing;
            let lattice = Lattice::around(&scene.frame, within, plane, spacing, wide, pool);
            images.push((pool, lattice, depth_image(scene, plane, &lattice)));
        }
        let Some((_, lattice, image)) = images.iter().find(|(p, ..)| *p == pool) else { continue };
        let cells = if pool == 1 {
            rounding_cells
        } else {
            // Point and tip may each be half a diagonal from their cell's centre.
            std::f64::consts::SQRT_2
        };
        let kernel = section_kernel(&section.shape, lift, lattice.spacing, cells);
        if pool == 1 {
            filter(lattice, image, &window, &mut lowest, &kernel, raise);
        } else {
            let over = margin + spacing;
            let coarse_window = Lattice::around(&scene.frame, within, plane, spacing, over, pool);
            let mut coarse = vec![f32::NEG_INFINITY; coarse_window.nu * coarse_window.nv];
            filter(lattice, image, &coarse_window, &mut coarse, &kernel, raise);
            spread(&coarse_window, &coarse, &window, &mut lowest);
        }
    }
    (window, lowest)
}

fn raise(best: &mut f32, h: f32, minus_f: f32) {
    let z = h + minus_f;
    if z > *best {
        *best = z
    }
}

/// Offsets (cells) of a section with −f(ρ) − lift, ρ shortened by `rounding` cells.
fn section_kernel(shape: &Shape, lift: f64, s: f64, rounding: f64) -> Vec<(isize, isize, f32)> {
    let reach = (shape.max_radius() / s + rounding).ceil() as isize;
    let mut kernel = Vec::new();
    for j in -reach..=reach {
        for i in -reach..=reach {
            let rho = ((((i * i + j * j) as f64).sqrt() - rounding) * s).max(0.0);
            let f = lower_bound(shape, rho);
            if f.is_finite() {
                kernel.push((i, j, -(f + lift) as f32));
            }
        }
    }
    kernel
}

/// inf of the lower surface over radii ≥ ρ: the surface itself unless the section narrows upward.
fn lower_bound(shape: &Shape, rho: f64) -> f64 {
    match *shape {
        Shape::Frustum { z0, r0, r1, .. } if r1 < r0 && rho <= r0 => z0,
        _ => shape.lower_surface(rho),
    }
}

/// Highest point per cell, mm.
fn depth_image(scene: &Scene, plane: &ImagePlane, lattice: &Lattice) -> Vec<f32> {
    let mut image = vec![f32::NEG_INFINITY; lattice.nu * lattice.nv];
    for p in scene.points() {
        if let Some(c) = lattice.cell(plane.across(*p)) {
            let z = plane.height(*p) as f32;
            if z > image[c] {
                image[c] = z;
            }
        }
    }
    image
}

/// out(c) = op over the kernel of image(c + offset), for every cell c of `out_lattice`; offsets
/// that leave the image are skipped. Both lattices have the same spacing and phase.
fn filter(
    lattice: &Lattice,
    image: &[f32],
    out_lattice: &Lattice,
    out: &mut [f32],
    kernel: &[(isize, isize, f32)],
    op: impl Fn(&mut f32, f32, f32) + Sync + Copy,
) {
    let shift = ((out_lattice.first - lattice.first) / lattice.spacing).round();
    let (du, dv) = (shift.x as isize, shift.y as isize);
    let (nu, nv) = (lattice.nu as isize, lattice.nv as isize);
    out.par_chunks_mut(out_lattice.nu).enumerate().for_each(|(row, out)| {
        let len = out.len() as isize;
        for &(i, j, value) in kernel {
            let src_row = row as isize + dv + j;
            if src_row < 0 || src_row >= nv {
                continue;
            }
            let start = du + i;
            let from = (-start).clamp(0, len);
            let to = (nu - start).clamp(from, len);
            let src = (src_row * nu + start + from) as usize;
            let n = (to - from) as usize;
            let source = &image[src.min(image.len())..][..n];
            for (o, h) in out[from as usize..to as usize].iter_mut().zip(source) {
                op(o, *h, value);
            }
        }
    });
}

/// Raises every fine cell to the value of the coarse cell it lies in.
fn spread(coarse_lattice: &Lattice, coarse: &[f32], lattice: &Lattice, out: &mut [f32]) {
    out.par_chunks_mut(lattice.nu).enumerate().for_each(|(j, row)| {
        for (i, o) in row.iter_mut().enumerate() {
            let uv = lattice.first + DVec2::new(i as f64, j as f64) * lattice.spacing;
            if let Some(c) = coarse_lattice.cell(uv) {
                *o = o.max(coarse[c]);
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::fibonacci_sphere;
    use crate::machine::ToolKind;
    use crate::voxel::BitGrid;
    use proptest::prelude::*;

    fn cutter(radius: f64, length: f64, holder: f64) -> Tool {
        let frustum = |z0, r0, z1, r1| Shape::Frustum { z0, r0, z1, r1 };
        let sections = vec![
            Section { shape: Shape::Ball { radius }, active: true },
            Section { shape: frustum(radius, radius, length, radius), active: true },
            Section { shape: frustum(length, holder, 2.0 * length, holder), active: false },
        ];
        Tool::new("t", ToolKind::Subtractive, sections)
    }

    /// The definition: is there a lattice tip within the edge's radius that collides with nothing?
    fn naive_cut(scene: &Scene, tool: &Tool, d: Direction, x: DVec3) -> bool {
        let plane = d.image_plane();
        let s = spacing(&scene.frame, d);
        let anchor = plane.across(scene.frame.center([0, 0, 0]));
        let uv = (plane.across(x) - anchor) / s;
        let n = (tool.active_radius() / s).ceil() as i64 + 1;
        (-n..=n).any(|j| {
            (-n..=n).any(|i| {
                let tip = anchor + (uv.round() + DVec2::new(i as f64, j as f64)) * s;
                let k = tool.active_lower_surface(tip.distance(plane.across(x)));
                let z = plane.height(x) - k;
                k.is_finite()
                    && scene.points().iter().all(|o| {
                        let rho = tip.distance(plane.across(*o));
                        plane.height(*o) <= z + tool.lower_surface(rho) + 1e-9
                    })
            })
        })
    }

    fn naive_deposit(scene: &Scene, tool: &Tool, d: Direction, dip: f64, x: DVec3) -> bool {
        let plane = d.image_plane();
        scene.points().iter().all(|o| {
            let rho = plane.across(x).distance(plane.across(*o));
            tool.sections.iter().all(|sec| {
                let lift = if sec.shape.lower_surface(0.0) == 0.0 { dip } else { 0.0 };
                plane.height(*o) <= plane.height(x) + sec.shape.lower_surface(rho) + lift + 1e-9
            })
        })
    }

    fn world() -> impl Strategy<Value = (BitGrid, f64, f64, f64)> {
        (proptest::collection::vec(0u8..6, 7 * 8 * 6), 1.0f64..2.5, 3.0f64..6.0, 0.0f64..40.0)
            .prop_map(|(cells, r, length, holder)| {
                let g = BitGrid::from_fn([7, 8, 6], |[x, y, z]| cells[x + 7 * (y + 8 * z)] == 0);
                (g, r, length.max(r + 0.5), holder.max(r))
            })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn reachable_is_reachable_by_definition_and_equal_on_axes(
            (state, radius, length, holder) in world(), pick in 0usize..40,
        ) {
            let frame = Frame { pitch: 0.7, dims: state.dims(), origin: DVec3::new(-1.0, 2.0, 0.0) };
            let scene = Scene::new(&frame, &state, &[]);
            let tool = cutter(radius, length, holder);
            let axes = [Direction::X, Direction::NEG_X, Direction::Y, Direction::NEG_Y, Direction::Z];
            let d = axes.get(pick).copied().unwrap_or_else(|| fibonacci_sphere(40)[pick]);
            let cut = cutter_map(&scene, &frame.bounds(), &tool, d);
            let print = nozzle_map(&scene, &frame.bounds(), &tool, d, 0.2);
            // Ties at equal height are decided by a rounding margin: the exact engine is asked
            // again a hair lower and a hair higher.
            let hair = d.vec() * 1e-3;
            let narrow = holder <= WIDEST_CELLS * 0.7;
            for v in BitGrid::from_fn(state.dims(), |_| true).iter_ones() {
                let x = frame.center(v);
                if cut.reaches(x) {
                    prop_assert!(naive_cut(&scene, &tool, d, x), "cut {d:?} {v:?}");
                } else if d.is_grid_axis() && narrow {
                    prop_assert!(!naive_cut(&scene, &tool, d, x - hair), "missed {d:?} {v:?}");
                }
                if print.reaches(x) {
                    prop_assert!(naive_deposit(&scene, &tool, d, 0.2, x), "print {d:?} {v:?}");
                } else if d.is_grid_axis() && narrow {
                    prop_assert!(!naive_deposit(&scene, &tool, d, 0.2, x - hair));
                }
            }
        }
    }
}
