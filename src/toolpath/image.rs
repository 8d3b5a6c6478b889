//! Height images over the plane across a direction, and the one morphology toolpaths need.
//!
//! Method: a lattice of cells of side s in (u, v); an image holds a height along the direction per
//! cell, −∞ where there is nothing. Dilating an image of obstacle tops by a tool's lower surface
//! f(ρ) gives the lowest free tip height, H(q) = max over p of img(p) − f(|p − q|); dilating an
//! image of material tops by the edge k(ρ) gives the tip height at which cutting begins.
//!
//! Guarantees: with a margin m the result is at least that of the tool grown by m to the side and
//! downward, for tools whose lower surface never falls outward. Not guaranteed: positions finer than
//! a cell; a point is moved to its cell's centre, at most s/√2 away.

use super::pyramid::{Pyramid, Rings, TILE};
use super::rowmax::row_tables;
use super::wanted::Wanted;
use crate::base::{Cancelled, Ctx, DVec2, DVec3, ImagePlane};
use crate::voxel::Frame;
use rayon::prelude::*;

/// Cells of side `s` mm; cell (i, j) is centred on `origin` + s·(i, j) in (u, v).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lattice {
    pub plane: ImagePlane,
    pub origin: DVec2,
    pub s: f64,
    pub n: [usize; 2],
}

pub(crate) type Cell = [usize; 2];

/// Most cells of one image: 2²⁶ take 256 MiB. A lattice that needs more is made coarser.
const MOST_CELLS: f64 = 67_108_864.0;

impl Lattice {
    /// The lattice of the plan's rules (tip lattice: through the centre of voxel (0, 0, 0), pitch s)
    /// over the box `lo`..`hi` in (u, v).
    pub fn over(frame: &Frame, plane: ImagePlane, s: f64, lo: DVec2, hi: DVec2) -> Lattice {
        let size = hi - lo;
        let mut s = s;
        while (size.x / s + 2.0) * (size.y / s + 2.0) > MOST_CELLS {
            s *= 2.0;
        }
        let anchor = plane.across(frame.center([0; 3]));
        let first = ((lo - anchor) / s).floor();
        let n = ((hi - anchor) / s).ceil() - first + DVec2::ONE;
        Lattice { plane, origin: anchor + first * s, s, n: [n.x as usize, n.y as usize] }
    }

    /// The part of the lattice that covers `lo`..`hi`, as a lattice of its own.
    pub fn window(&self, lo: DVec2, hi: DVec2) -> Lattice {
        let last = DVec2::new(self.n[0] as f64, self.n[1] as f64) - DVec2::ONE;
        let a = ((lo - self.origin) / self.s).floor().clamp(DVec2::ZERO, last);
        let b = ((hi - self.origin) / self.s).ceil().clamp(a, last);
        let n = b - a + DVec2::ONE;
        Lattice { origin: self.origin + a * self.s, n: [n.x as usize, n.y as usize], ..*self }
    }

    pub fn uv(&self, c: Cell) -> DVec2 {
        self.origin + DVec2::new(c[0] as f64, c[1] as f64) * self.s
    }

    pub fn world(&self, c: Cell, z: f64) -> DVec3 {
        self.plane.world(self.uv(c), z)
    }

    /// The cell whose centre is nearest, if the lattice has it.
    pub fn cell(&self, uv: DVec2) -> Option<Cell> {
        let g = ((uv - self.origin) / self.s).round();
        let inside = g.x >= 0.0 && g.y >= 0.0 && g.x < self.n[0] as f64 && g.y < self.n[1] as f64;
        inside.then_some([g.x as usize, g.y as usize])
    }

    pub fn index(&self, c: Cell) -> usize {
        c[0] + self.n[0] * c[1]
    }

    pub fn cells(&self) -> usize {
        self.n[0] * self.n[1]
    }

    pub fn cell_of_index(&self, i: usize) -> Cell {
        [i % self.n[0], i / self.n[0]]
    }
}

/// A height per cell, mm along the direction; −∞ for none.
#[derive(Clone)]
pub(crate) struct Image {
    pub lattice: Lattice,
    pub data: Vec<f32>,
}

impl Image {
    pub fn empty(lattice: Lattice) -> Image {
        Image { lattice, data: vec![f32::NEG_INFINITY; lattice.cells()] }
    }

    pub fn at(&self, c: Cell) -> f64 {
        f64::from(self.data[self.lattice.index(c)])
    }

    /// Raises the cell under a world point to the point's height; false outside the lattice.
    pub fn raise(&mut self, p: DVec3) -> bool {
        let plane = self.lattice.plane;
        self.raise_at(plane.across(p).extend(plane.height(p)))
    }

    /// The same of a point as (u, v, height).
    pub fn raise_at(&mut self, p: DVec3) -> bool {
        let Some(c) = self.lattice.cell(p.truncate()) else { return false };
        let i = self.lattice.index(c);
        self.data[i] = self.data[i].max(p.z as f32);
        true
    }

    /// The image with every height's sign turned, empty staying empty.
    pub fn negated(&self) -> Image {
        let turn = |z: &f32| if z.is_finite() { -z } else { f32::NEG_INFINITY };
        Image { lattice: self.lattice, data: self.data.iter().map(turn).collect() }
    }
}

/// A lower surface sampled on a lattice.
pub(crate) struct Profile {
    /// Offsets near the axis, each with its height over the tip.
    near: Vec<(i64, i64, f32)>,
    /// The same as rows of cells of one height.
    chords: Vec<Chord>,
    /// Flat discs beyond: radius in cells and height.
    discs: Vec<(f64, f32)>,
    /// A head without end begins here.
    platform: Option<f32>,
}

/// Cells side by side at one height: `width` of them from `first` on, `row` rows away.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Chord {
    row: i64,
    first: i64,
    width: usize,
    z: f32,
}

/// Narrower chords are lifted cell by cell: the two looks into a table that a chord takes are no
/// fewer, and the table must be made.
const LEAST_CHORD: usize = 4;

/// Rows of offsets that lie side by side and equally high.
fn chords(near: &[(i64, i64, f32)]) -> Vec<Chord> {
    let one = |&(first, row, z): &(i64, i64, f32)| Chord { row, first, width: 1, z };
    let joins =
        |a: &(i64, i64, f32), b: &(i64, i64, f32)| a.1 == b.1 && a.0 + 1 == b.0 && a.2 == b.2;
    let runs = near.chunk_by(joins);
    runs.flat_map(|run| match run.len() {
        n if n < LEAST_CHORD => run.iter().map(one).collect(),
        width => vec![Chord { width, ..one(&run[0]) }],
    })
    .collect()
}

/// Radius in cells up to which a profile is sampled cell by cell. Larger is slower without being
/// more exact where surfaces are flat; smaller turns curved ends into rings of one cell.
const NEAR_CELLS: f64 = 16.0;

/// More rings of different heights, as a ball end wider than the part has, are looked at together: a row of cells
/// for every row of every ring takes minutes.
const MOST_DISCS: usize = 48;

impl Profile {
    /// Samples the lower surface `f` of a tool whose finite radius is `radius` mm on cells of `s`
    /// mm, grown by `side` mm outward and `down` mm downward.
    pub fn new(f: impl Fn(f64) -> f64, radius: f64, s: f64, side: f64, down: f64) -> Profile {
        let height = |rho: f64| (f((rho - side).max(0.0)) - down) as f32;
        // The rim itself belongs to the tool; digits lost in i·s must not push it out.
        let rim = (radius + side) / s + 1e-9;
        let reach = rim.min(NEAR_CELLS);
        let n = reach.floor() as i64;
        let mut near = Vec::new();
        for j in -n..=n {
            for i in -n..=n {
                let cells = (i as f64).hypot(j as f64);
                let z = height((cells * s).min(radius + side));
                if cells <= reach && z.is_finite() {
                    near.push((i, j, z));
                }
            }
        }
        let mut discs: Vec<(f64, f32)> = Vec::new();
        let mut inner = reach;
        while inner < rim {
            let outer = (inner + 1.0).min(rim);
            let z = height((inner * s).min(radius + side) + 1e-9);
            match discs.last_mut() {
                Some(last) if last.1 == z => last.0 = outer,
                _ if z.is_finite() => discs.push((outer, z)),
                _ => {}
            }
            inner = outer;
        }
        let platform = Some(height(1e9)).filter(|z| z.is_finite());
        let chords = chords(&near);
        Profile { near, chords, discs, platform }
    }

    /// max over p of img(p) − f(|p − q|) for every cell q of `over`, which shares the lattice's
    /// pitch and anchor; `highest` is the top of everything, also outside the image.
    ///
    /// # Errors
    /// When the user stops the run: with tools wider than the part an image takes minutes.
    pub fn dilate(
        &self,
        img: &Image,
        over: Lattice,
        highest: f64,
        ctx: &Ctx,
    ) -> Result<Image, Cancelled> {
        self.dilate_over(img, &Wanted::all(over), highest, ctx)
    }

    /// The same for the wanted cells; the others are at +∞.
    ///
    /// # Errors
    /// When the user stops the run.
    pub fn dilate_over(
        &self,
        img: &Image,
        over: &Wanted,
        highest: f64,
        ctx: &Ctx,
    ) -> Result<Image, Cancelled> {
        if self.discs.len() > MOST_DISCS
            && let Some(rings) = Rings::of(&self.discs)
        {
            return self.dilate_by_blocks(&rings, img, over, highest, ctx);
        }
        self.dilate_by_rows(img, over, highest, ctx)
    }

    /// The same with the rings together.
    fn dilate_by_blocks(
        &self,
        rings: &Rings,
        img: &Image,
        over: &Wanted,
        highest: f64,
        ctx: &Ctx,
    ) -> Result<Image, Cancelled> {
        let near =
            Profile { near: Vec::new(), discs: Vec::new(), chords: self.chords.clone(), ..*self };
        let mut out = near.dilate_by_rows(img, over, highest, ctx)?;
        let over = over.lattice();
        let shift = ((over.origin - img.lattice.origin) / img.lattice.s).round();
        let pyramid = Pyramid::of(img);
        let nx = over.n[0].max(1);
        out.data.par_chunks_mut(nx * TILE).enumerate().try_for_each(
            |(k, rows)| -> Result<(), Cancelled> {
                ctx.check()?;
                pyramid.raise(rings, rows, k * TILE, &over, [shift.x as i64, shift.y as i64]);
                Ok(())
            },
        )?;
        Ok(out)
    }

    /// The same row by row.
    fn dilate_by_rows(
        &self,
        img: &Image,
        wanted: &Wanted,
        highest: f64,
        ctx: &Ctx,
    ) -> Result<Image, Cancelled> {
        let over = wanted.lattice();
        let shift = ((over.origin - img.lattice.origin) / img.lattice.s).round();
        let (si, sj) = (shift.x as i64, shift.y as i64);
        let floor = self.platform.map_or(f32::NEG_INFINITY, |z| highest as f32 - z);
        let tables = row_tables(img, self.widest());
        let table = |y: i64| usize::try_from(y).ok().and_then(|y| tables.get(y));
        let mut out = Image::empty(over);
        let nx = over.n[0].max(1);
        out.data.par_chunks_mut(nx).enumerate().try_for_each(
            |(j, row)| -> Result<(), Cancelled> {
                ctx.check()?;
                row.fill(f32::INFINITY);
                let y = j as i64 + sj;
                for run in wanted.runs(j) {
                    let (row, si) = (&mut row[run.clone()], si + run.start as i64);
                    row.fill(floor);
                    for c in &self.chords {
                        if let Some(t) = table(y + c.row) {
                            t.lift(row, si + c.first, c.width, c.z);
                        }
                    }
                    for &(radius, z) in &self.discs {
                        let n = radius.floor() as i64;
                        for dj in -n..=n {
                            if let Some(t) = table(y + dj) {
                                let half = radius * radius - (dj * dj) as f64;
                                let half = half.max(0.0).sqrt().floor() as i64;
                                t.lift(row, si - half, 2 * half as usize + 1, z);
                            }
                        }
                    }
                }
                Ok(())
            },
        )?;
        Ok(out)
    }

    /// The cells of the profile near its axis (all of a cutter's edge) with their heights.
    pub fn offsets(&self) -> Vec<(i64, i64, f32)> {
        self.near.clone()
    }

    fn widest(&self) -> usize {
        let discs = self.discs.iter().map(|d| 2 * d.0.floor() as usize + 1);
        self.chords.iter().map(|c| c.width).chain(discs).max().unwrap_or(1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Direction;
    use proptest::prelude::*;

    fn lattice(n: [usize; 2], at: [i64; 2]) -> Lattice {
        let frame = Frame { pitch: 1.0, dims: [1; 3], origin: DVec3::splat(-0.5) };
        let origin = DVec2::new(at[0] as f64, at[1] as f64);
        let mut l = Lattice::over(&frame, Direction::Z.image_plane(), 1.0, origin, origin);
        l.n = n;
        l
    }

    /// Ball end, cylinder, wide holder: what a mill is made of.
    fn surface(rho: f64) -> f64 {
        match rho {
            r if r <= 2.5 => 2.5 - (2.5f64.powi(2) - r * r).sqrt(),
            r if r <= 20.5 => 9.0,
            _ => f64::INFINITY,
        }
    }

    proptest! {
        #[test]
        fn dilation_is_its_definition(
            peaks in proptest::collection::vec((0usize..40, 0usize..30, 0f32..50.0), 1..12),
            side in 0f64..1.5,
            platform in any::<bool>(),
        ) {
            let mut img = Image::empty(lattice([40, 30], [0, 0]));
            for (i, j, z) in &peaks {
                let k = img.lattice.index([*i, *j]);
                img.data[k] = *z;
            }
            let f = |rho: f64| if platform { surface(rho).min(30.0) } else { surface(rho) };
            let over = lattice([25, 20], [7, 4]);
            let profile = Profile::new(f, 20.5, 1.0, side, 0.25);
            let out = profile.dilate(&img, over, 50.0, &Ctx::quiet()).unwrap();
            for c in (0..over.cells()).map(|i| over.cell_of_index(i)) {
                let mut want = if platform { 50.0 - 30.0 + 0.25 } else { f64::NEG_INFINITY };
                for (k, z) in img.data.iter().enumerate() {
                    let rho = img.lattice.uv(img.lattice.cell_of_index(k)).distance(over.uv(c));
                    let g = f((rho - side).max(0.0));
                    // The grown rim is the tool's rim moved outward.
                    if rho <= 20.5 + side + 1e-9 && z.is_finite() {
                        want = want.max(f64::from(*z) - g + 0.25);
                    }
                }
                let got = out.at(c);
                // Beyond NEAR_CELLS a ring takes the height of its inner edge: flat here.
                prop_assert!(got == want || (got - want).abs() < 1e-4, "{c:?}: {got} {want}");
            }
        }
    }
    /// A ball of 120 mm on a part of 44 mm took a quarter of an hour.
    #[test]
    fn many_rings_are_lifted_together_as_one_by_one() {
        let mut rng = crate::base::rng(5, 0);
        let mut random = |n: i32| rand::RngExt::random_range(&mut rng, 0..n);
        for (radius, every) in [(70.3, 1), (133.0, 7), (260.0, 400)] {
            let mut img = Image::empty(lattice([83, 61], [0, 0]));
            for z in img.data.iter_mut().skip(83 * 5) {
                if random(every) == 0 {
                    *z = random(400) as f32 / 8.0;
                }
            }
            let ball = |rho: f64| match rho <= radius + 1e-6 {
                true => radius - (radius * radius - rho * rho).max(0.0).sqrt(),
                false => f64::INFINITY,
            };
            let profile = Profile::new(ball, radius, 1.0, 0.2, 0.25);
            assert!(profile.discs.len() > MOST_DISCS);
            let over = lattice([190, 131], [-60, -44]);
            let got = profile.dilate(&img, over, 50.0, &Ctx::quiet()).unwrap();
            let want =
                profile.dilate_by_rows(&img, &Wanted::all(over), 50.0, &Ctx::quiet()).unwrap();
            assert!(got.data == want.data, "{radius}");
            assert!(got.data.iter().any(|z| z.is_finite()));
        }
    }

    /// Chords and discs give what every cell of the profile gives by itself, to the last bit.
    #[test]
    fn rows_of_one_height_are_lifted_as_their_cells_are() {
        let mut rng = crate::base::rng(17, 0);
        let mut img = Image::empty(lattice([61, 44], [0, 0]));
        for z in img.data.iter_mut().skip(61 * 9) {
            if rand::RngExt::random_range(&mut rng, 0..9) == 0 {
                *z = rand::RngExt::random_range(&mut rng, -20.0f32..40.0);
            }
        }
        let wavy = |rho: f64| (rho * 0.7).floor().min(6.0);
        for (radius, side) in [(0.4, 0.0), (3.0, 0.3), (12.0, 0.0), (15.9, 0.1), (90.0, 0.0)] {
            let profile = Profile::new(wavy, radius, 1.0, side, 0.25);
            assert!(radius < 9.0 || profile.chords.iter().any(|c| c.width > LEAST_CHORD));
            let over = lattice([70, 30], [-9, 5]);
            let out = profile.dilate(&img, over, f64::NEG_INFINITY, &Ctx::quiet()).unwrap();
            let mut cells = profile.near.clone();
            for (radius, z) in &profile.discs {
                let n = radius.floor() as i64;
                let all = (-n..=n).flat_map(|j| (-n..=n).map(move |i| (i, j)));
                let within = all.filter(|(i, j)| ((i * i + j * j) as f64) <= radius * radius);
                cells.extend(within.map(|(i, j)| (i, j, *z)));
            }
            for (q, got) in out.data.iter().enumerate() {
                let [i, j] = over.cell_of_index(q).map(|c| c as i64);
                let want = cells.iter().filter_map(|(di, dj, z)| {
                    let (x, y) = (i - 9 + di, j + 5 + dj);
                    let inside = (0..61).contains(&x) && (0..44).contains(&y);
                    inside.then(|| img.data[x as usize + 61 * y as usize] - z)
                });
                let platform =
                    profile.platform.map_or(f32::NEG_INFINITY, |z| f32::NEG_INFINITY - z);
                assert_eq!(*got, want.fold(platform, f32::max), "{radius} at {i}, {j}");
            }
        }
    }

    #[test]
    fn a_run_that_is_stopped_gets_no_image() {
        let stopped = std::sync::Arc::new(std::sync::atomic::AtomicBool::new(true));
        let silent = Ctx::new(stopped, None, std::sync::Arc::new(crate::base::Silent), 0);
        let img = Image::empty(lattice([8, 8], [0, 0]));
        let profile = Profile::new(surface, 20.5, 1.0, 0.0, 0.0);
        assert!(profile.dilate(&img, img.lattice, 0.0, &silent).is_err());
    }
}
