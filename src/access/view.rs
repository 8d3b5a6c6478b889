//! One direction's look at a scene: the lattice of tips, the depth images, and how low tips may
//! stand over them.
//!
//! Guarantees: the heights of tips that may serve a wanted voxel are those of the depth engine
//! ([`super::depth`]); those of other tips may be lower, never so low that they serve one.

use super::Scene;
use super::ceilings::Ceilings;
use super::cells::Cells;
use super::filter::{Image, Kernel, Op, Spans, filter};
use super::floors::Floors;
use super::image::{DepthImage, splat, spread};
use super::lattice::{Lattice, corners};
use super::tops::{NONE, axis_of, tops, voxel};
use super::wanted::Wanted;
use crate::base::{Aabb, DVec2, DVec3, Direction, ImagePlane};
use crate::machine::{Section, Shape, Tool};
use crate::voxel::Frame;
use std::borrow::Cow;
use std::f64::consts::SQRT_2;

/// Largest radius of a section in cells of the image it is treated on. Larger is slower by its
/// square; smaller makes wide sections wider than they are (by at most √2/12 at this value).
pub(super) const WIDEST_CELLS: f64 = 24.0;

/// Spacing of the tip lattice of a direction, mm.
pub(super) fn spacing(frame: &Frame, direction: Direction) -> f64 {
    if direction.is_grid_axis() { frame.pitch } else { frame.pitch / 2.0 }
}

/// Distance by which rounding a point to its cell may move it, in cells: none on the grid axes,
/// half a diagonal elsewhere.
pub(super) fn rounding_cells(direction: Direction) -> f64 {
    if direction.is_grid_axis() { 0.0 } else { std::f64::consts::FRAC_1_SQRT_2 }
}

/// Margin in mm below which a point stands surely lower than what a verdict looks at: far above
/// the rounding of f32 heights, far below a voxel.
const LOWER_MM: f64 = 0.01;

/// A direction's look at a scene, for the voxels of one set.
pub(super) struct View<'a> {
    scene: &'a Scene,
    /// The voxels asked for; none for all of the grid.
    wanted: Option<&'a Wanted<'a>>,
    pub plane: ImagePlane,
    /// Box of the wanted voxels.
    within: Aabb,
    spacing: f64,
    /// How far around them the window reaches, mm.
    margin: f64,
    /// Obstacle points that stand lower, mm, have no say: a voxel x is refused for o_z − f > x_z − k,
    /// f is nowhere negative, and no x is asked for below.
    least: f64,
    /// The largest k of the tools, mm.
    deepest: f64,
    /// The same as `least` place by place, where few voxels are asked for.
    floors: Option<Floors>,
    /// Depth images by pooling, each wide enough for every section treated on it.
    images: Vec<DepthImage>,
    /// Height of the highest obstacle point, mm, once they were looked at.
    highest: Option<f64>,
}

impl<'a> View<'a> {
    /// For the voxels of `wanted`; `deepest` is the largest k of the tools that look, mm.
    pub fn new(
        scene: &'a Scene,
        wanted: &'a Wanted<'a>,
        direction: Direction,
        margin: f64,
        deepest: f64,
    ) -> Self {
        let half = DVec3::splat(scene.frame.pitch / 2.0);
        // Of an empty set nothing is asked; one voxel stands for it.
        let (lo, hi) = wanted.extent().unwrap_or_default();
        let within =
            Aabb { min: scene.frame.center(lo) - half, max: scene.frame.center(hi) + half };
        View { wanted: Some(wanted), ..View::of_box(scene, within, direction, margin, deepest) }
    }

    /// For all voxels of the grid.
    pub fn of_grid(scene: &'a Scene, direction: Direction, margin: f64, deepest: f64) -> Self {
        View::of_box(scene, scene.frame.bounds(), direction, margin, deepest)
    }

    fn of_box(
        scene: &'a Scene,
        within: Aabb,
        direction: Direction,
        margin: f64,
        deepest: f64,
    ) -> Self {
        let plane = direction.image_plane();
        let lowest = corners(&within).map(|c| plane.height(c)).into_iter().fold(f64::MAX, f64::min);
        View {
            scene,
            wanted: None,
            plane,
            within,
            spacing: spacing(&scene.frame, direction),
            margin,
            least: lowest - deepest - LOWER_MM,
            deepest,
            floors: None,
            images: Vec::new(),
            highest: None,
        }
    }

    fn lattice(&self, margin: f64, pool: usize) -> Lattice {
        Lattice::around(&self.scene.frame, &self.within, &self.plane, self.spacing, margin, pool)
    }

    /// The cells under the wanted voxels, and how high these stand where that was looked at. Left
    /// out are voxels `dip` mm lower than an obstacle over their own cell: f never falls outward and
    /// k is nowhere below it, so G is at least as high as that wherever the tip stands.
    pub fn under(&self, lattice: &Lattice, dip: f64) -> Under {
        let Some(wanted) = self.wanted else {
            return self.under_box(lattice);
        };
        let finest = self.images.iter().find(|(pool, ..)| *pool == 1);
        let obstacle = |i: usize, j: usize| {
            let (_, image, cells) = finest?;
            let by = image.offset_of(lattice);
            let (i, j) = (i.checked_add_signed(by.0)?, j.checked_add_signed(by.1)?);
            (i < image.nu).then(|| cells.get(i + image.nu * j)).flatten()
        };
        let dip = (dip + LOWER_MM) as f32;
        let mut under = vec![false; lattice.nu * lattice.nv];
        let mut ceilings = Ceilings::none(lattice.nu, lattice.nv);
        let mut mark = |v: [usize; 3]| {
            let centre = self.scene.frame.center(v);
            let Some(c) = lattice.cell(self.plane.across(centre)) else { return };
            let (i, j, height) = (c % lattice.nu, c / lattice.nu, self.plane.height(centre) as f32);
            if obstacle(i, j).is_none_or(|o| *o - dip <= height) {
                under[c] = true;
                ceilings.raise(i, j, height);
            }
        };
        if let Some((axis, up)) = axis_of(self.plane.d) {
            // The voxels of a column share their cell, and the highest is the last to be refused.
            let width = wanted.grid().dims()[usize::from(axis == 0)].max(1);
            let tops = tops(wanted.grid(), axis, up);
            for (i, top) in tops.iter().enumerate().filter(|(_, top)| **top != NONE) {
                mark(voxel(axis, [i % width, i / width], *top as usize));
            }
        } else if wanted.count() > lattice.nu * lattice.nv {
            // To look up more voxels than there are cells takes longer than the cells in between.
            return self.under_box(lattice);
        } else {
            wanted.for_each(mark);
        }
        Under { spans: Spans::of(&under, lattice.nu), few: Some((under, ceilings)) }
    }

    fn under_box(&self, lattice: &Lattice) -> Under {
        let runs = lattice.under_box(&self.within, &self.plane);
        Under { spans: Spans::of_runs(runs), few: None }
    }

    /// The highest point per cell, mm, on the images by these poolings that are not there yet, and
    /// the highest of all, in one pass over the points.
    fn look(&mut self, pools: &[usize]) {
        let mut new: Vec<usize> = pools.to_vec();
        new.sort_unstable();
        new.dedup();
        new.retain(|pool| !self.images.iter().any(|(p, ..)| p == pool));
        if new.is_empty() && self.highest.is_some() {
            return;
        }
        if new.is_empty() {
            new.push(1);
        }
        let mut new: Vec<DepthImage> = new
            .into_iter()
            .map(|pool| {
                let wide = self.margin + (WIDEST_CELLS + 2.0) * pool as f64 * self.spacing;
                let lattice = self.lattice(wide, pool);
                (pool, lattice, Cells::filled(lattice.nu * lattice.nv, f32::NEG_INFINITY))
            })
            .collect();
        self.highest =
            Some(splat(self.scene, &self.plane, (self.least, self.floors.as_ref()), &mut new));
        self.images.append(&mut new);
    }

    /// The pooling of the image on which a section is treated; none of a platform, below which
    /// everything stands.
    fn pool_of(&self, section: &Section) -> Option<usize> {
        if matches!(section.shape, Shape::Platform { .. }) {
            return None;
        }
        let mut pool = 1;
        while section.shape.max_radius() / (self.spacing * pool as f64) > WIDEST_CELLS {
            pool *= 2;
        }
        Some(pool)
    }

    /// [`View::look`] at all that tools ask for, and at nothing that has no say for them.
    pub fn look_for(&mut self, tools: &[Tool]) {
        // Of more voxels floors take longer than they save.
        let few = self.wanted.and_then(Wanted::few);
        if let (Some(few), true) = (few, self.images.is_empty()) {
            let place = |v: &[usize; 3]| {
                let centre = self.scene.frame.center(*v);
                (self.plane.across(centre), self.plane.height(centre))
            };
            let voxels: Vec<(DVec2, f64)> = few.iter().map(place).collect();
            self.floors = Some(Floors::of(&voxels, &self.steps(tools)));
        }
        let sections = tools.iter().flat_map(|t| &t.sections);
        let pools: Vec<usize> = sections.filter_map(|s| self.pool_of(s)).collect();
        self.look(&pools);
    }

    /// The steps of f for [`Floors`]: how far from a voxel points lie that have a say at a height.
    fn steps(&self, tools: &[Tool]) -> Vec<(f64, f64)> {
        let round = |s: &&Section| !matches!(s.shape, Shape::Platform { .. });
        let mut sections: Vec<&Section> = tools.iter().flat_map(|t| &t.sections).collect();
        sections.retain(round);
        sections.sort_by(|a, b| a.shape.max_radius().total_cmp(&b.shape.max_radius()));
        // Points and tips lie up to a cell's diagonal each from where they are taken to be, the
        // kernel is as much wider, and cells are looked up along the axes.
        let slack = |s: &Section| {
            let cells = 4.0 + 2.0 * SQRT_2 * self.pool_of(s).unwrap_or(1) as f64;
            cells * self.spacing
        };
        let mut steps = Vec::new();
        let mut inner: f64 = 0.0;
        for section in &sections {
            let radius = section.shape.max_radius();
            let wider = sections.iter().filter(|s| s.shape.max_radius() >= radius);
            let lowest = |s: &&Section| lower_bound(&s.shape, (inner - slack(s)).max(0.0));
            let f = wider.map(lowest).fold(f64::INFINITY, f64::min);
            steps.push((radius + self.margin + slack(section), f - self.deepest - LOWER_MM));
            inner = radius;
        }
        steps.dedup();
        steps
    }

    /// The window in which tips may stand.
    pub fn window(&self) -> Lattice {
        self.lattice(self.margin, 1)
    }

    /// H at the `tips` of the window: max over obstacle points of o_z − f(ρ) − lift, section by
    /// section. Of tips above the ceilings some sections are left out.
    pub fn lowest_tip(
        &mut self,
        tips: &Spans,
        ceilings: Option<&Ceilings>,
        sections: &[(Section, f64)],
        rounding_cells: f64,
    ) -> Cells {
        let seen: Vec<&(Section, f64)> = sections
            .iter()
            .enumerate()
            .filter(|(i, part)| !sections[..*i].iter().any(|before| shadows(before, part)))
            .map(|(_, part)| part)
            .collect();
        let mut seen: Vec<(usize, Kernel)> = seen
            .into_iter()
            .filter_map(|(section, lift)| {
                let pool = self.pool_of(section)?;
                // A point and a tip are each up to (pool − 1) / 2 cells of the tip lattice along
                // both axes from the middle of the cell they are pooled into.
                let cells = (rounding_cells + (pool - 1) as f64 * SQRT_2) / pool as f64;
                let s = self.spacing * pool as f64;
                Some((pool, section_kernel(&section.shape, *lift, s, cells)))
            })
            .collect();
        // What costs least comes first: where one section holds the tip up high, the others need no
        // look.
        seen.sort_by_key(|(pool, kernel)| (std::cmp::Reverse(*pool), kernel.cost()));
        let pools: Vec<usize> = seen.iter().map(|(pool, _)| *pool).collect();
        self.look(&pools);
        // Everything stands below a platform.
        let highest = self.highest.unwrap_or(f64::MIN);
        let floor = |(section, lift): &(Section, f64)| match section.shape {
            Shape::Platform { z } => (highest - z - lift) as f32,
            _ => f32::NEG_INFINITY,
        };
        let floor = sections.iter().map(floor).fold(f32::NEG_INFINITY, f32::max);
        let window = self.window();
        // A cell that is not computed is closed, whoever asks.
        let mut lowest = Cells::filled(window.nu * window.nv, f32::INFINITY);
        for (row, spans) in lowest.chunks_mut(window.nu).zip(tips.rows()) {
            spans.iter().for_each(|s| row[s.clone()].fill(floor));
        }
        let mut tips = Cow::Borrowed(tips);
        for (pool, kernel) in seen {
            let Some((_, lattice, image)) = self.images.iter().find(|(p, ..)| *p == pool) else {
                continue;
            };
            if let Some(ceilings) = ceilings {
                tips = Cow::Owned(ceilings.below(&tips, &lowest, window.nu));
            }
            if tips.is_empty() {
                break;
            }
            let image = Image { width: lattice.nu, cells: image };
            if pool == 1 {
                let at = lattice.offset_of(&window);
                filter(Op::Max, &image, at, window.nu, &mut lowest, &tips, &kernel);
            } else {
                let coarse = self.lattice(self.margin + self.spacing, pool);
                let mut pooled = Cells::filled(coarse.nu * coarse.nv, f32::NEG_INFINITY);
                let over = over_tips(&coarse, &window, &tips);
                let at = lattice.offset_of(&coarse);
                filter(Op::Max, &image, at, coarse.nu, &mut pooled, &over, &kernel);
                spread(&coarse, &pooled, &window, &tips, &mut lowest);
            }
        }
        lowest
    }
}

/// The cells of a window under wanted voxels.
pub(super) struct Under {
    pub spans: Spans,
    /// Of a few voxels: which cells are under them, and how high they stand.
    few: Option<(Vec<bool>, Ceilings)>,
}

impl Under {
    /// How high tips up to `reach` cells away need be known.
    pub fn ceilings(&self, reach: usize) -> Option<Ceilings> {
        self.few.as_ref().map(|(_, ceilings)| ceilings.around(reach, LOWER_MM as f32))
    }

    /// Closes the cells between its own that were computed with them: of the voxels over these,
    /// which were left out, the heights may tell too little.
    pub fn close(&self, lowest: &mut [f32], nu: usize) {
        let Some((under, _)) = &self.few else { return };
        let rows = lowest.chunks_mut(nu.max(1)).zip(under.chunks(nu.max(1)));
        for ((row, under), spans) in rows.zip(self.spans.rows()) {
            for i in spans.iter().cloned().flatten().filter(|i| !under[*i]) {
                row[i] = f32::INFINITY;
            }
        }
    }
}

/// The cells of a coarser lattice in which any of the `tips` of a window lies.
fn over_tips(coarse: &Lattice, window: &Lattice, tips: &Spans) -> Spans {
    let [columns, rows] = coarse.pooled(window);
    let mut over = vec![false; coarse.nu * coarse.nv];
    for (row, spans) in rows.iter().zip(tips.rows()) {
        for s in spans.iter().filter(|s| !s.is_empty()) {
            over[coarse.nu * row..][columns[s.start]..=columns[s.end - 1]].fill(true);
        }
    }
    Spans::of(&over, coarse.nu)
}

/// Whether a section of a tool needs no look, since another, drawn on the same footing or a finer
/// one, is nowhere higher over it: the shank over the ball of the same radius.
fn shadows((before, lift): &(Section, f64), (section, section_lift): &(Section, f64)) -> bool {
    let rim = section.shape.max_radius();
    rim.is_finite()
        && before.shape.max_radius() <= rim
        && before.shape.lower_surface(rim) + lift <= lower_bound(&section.shape, 0.0) + section_lift
}

/// −f(ρ) − lift of a section over cells, ρ shortened by `rounding` cells.
fn section_kernel(shape: &Shape, lift: f64, s: f64, rounding: f64) -> Kernel {
    let reach = (shape.max_radius() / s + rounding).ceil() as usize;
    Kernel::of(reach, 1, |cells| {
        let f = lower_bound(shape, ((cells - rounding) * s).max(0.0));
        f.is_finite().then_some(-(f + lift) as f32)
    })
}

/// inf of the lower surface over radii ≥ ρ: the surface itself unless the section narrows upward.
fn lower_bound(shape: &Shape, rho: f64) -> f64 {
    match *shape {
        Shape::Frustum { z0, r0, r1, .. } if r1 < r0 && rho <= r0 => z0,
        _ => shape.lower_surface(rho),
    }
}
