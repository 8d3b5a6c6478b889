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

use crate::base::{DVec2, DVec3, ImagePlane};
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
        inside.then(|| [g.x as usize, g.y as usize])
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
        let Some(c) = self.lattice.cell(plane.across(p)) else { return false };
        let (i, z) = (self.lattice.index(c), plane.height(p) as f32);
        self.data[i] = self.data[i].max(z);
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
    /// Flat discs beyond: radius in cells and height.
    discs: Vec<(f64, f32)>,
    /// A head without end begins here.
    platform: Option<f32>,
}

/// Radius in cells up to which a profile is sampled cell by cell. Larger is slower without being
/// more exact where surfaces are flat; smaller turns curved ends into rings of one cell.
const NEAR_CELLS: f64 = 16.0;

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
        Profile { near, discs, platform }
    }

    /// max over p of img(p) − f(|p − q|) for every cell q of `over`, which shares the lattice's
    /// pitch and anchor; `highest` is the top of everything, also outside the image.
    pub fn dilate(&self, img: &Image, over: Lattice, highest: f64) -> Image {
        let shift = ((over.origin - img.lattice.origin) / img.lattice.s).round();
        let (si, sj) = (shift.x as i64, shift.y as i64);
        let floor = self.platform.map_or(f32::NEG_INFINITY, |z| highest as f32 - z);
        let tables: Vec<RowMax> =
            if self.discs.is_empty() { Vec::new() } else { row_tables(img, self.widest()) };
        let mut out = Image::empty(over);
        let nx = over.n[0].max(1);
        out.data.par_chunks_mut(nx).enumerate().for_each(|(j, row)| {
            row.fill(floor);
            let y = j as i64 + sj;
            for &(di, dj, z) in &self.near {
                if let Some(src) = img_row(img, y + dj) {
                    lift(row, src, si + di, z);
                }
            }
            for &(radius, z) in &self.discs {
                let n = radius.floor() as i64;
                for dj in -n..=n {
                    let Some(y) = usize::try_from(y + dj).ok().filter(|y| *y < img.lattice.n[1])
                    else {
                        continue;
                    };
                    let half = (radius * radius - (dj * dj) as f64).max(0.0).sqrt().floor() as i64;
                    tables[y].lift(row, si, half, z);
                }
            }
        });
        out
    }

    /// The cells of the profile near its axis (all of a cutter's edge) with their heights.
    pub fn offsets(&self) -> Vec<(i64, i64, f32)> {
        self.near.clone()
    }

    fn widest(&self) -> usize {
        self.discs.iter().map(|d| 2 * d.0.floor() as usize + 1).max().unwrap_or(1)
    }
}

fn img_row(img: &Image, y: i64) -> Option<&[f32]> {
    let [nx, ny] = img.lattice.n;
    let y = usize::try_from(y).ok().filter(|y| *y < ny)?;
    Some(&img.data[y * nx..(y + 1) * nx])
}

/// row[i] = max(row[i], src[i + shift] − z) where both exist.
fn lift(row: &mut [f32], src: &[f32], shift: i64, z: f32) {
    let from = (-shift).clamp(0, row.len() as i64);
    let to = (src.len() as i64 - shift).clamp(from, row.len() as i64);
    if from == to {
        return;
    }
    let src = &src[(from + shift) as usize..(to + shift) as usize];
    for (r, s) in row[from as usize..to as usize].iter_mut().zip(src) {
        *r = r.max(s - z);
    }
}

/// Sparse table of one row: level k holds maxima over 2ᵏ cells to the right.
struct RowMax(Vec<Vec<f32>>);

fn row_tables(img: &Image, widest: usize) -> Vec<RowMax> {
    let nx = img.lattice.n[0].max(1);
    let build = |row: &[f32]| {
        let mut levels = vec![row.to_vec()];
        let mut span = 1;
        while 2 * span <= widest && 2 * span <= nx {
            let last = &levels[levels.len() - 1];
            let next = (0..=nx - 2 * span).map(|i| last[i].max(last[i + span])).collect();
            levels.push(next);
            span *= 2;
        }
        RowMax(levels)
    };
    img.data.par_chunks(nx).map(build).collect()
}

impl RowMax {
    /// row[i] = max(row[i], max of the table's cells within `half` of i + shift, less z).
    fn lift(&self, row: &mut [f32], shift: i64, half: i64, z: f32) {
        let n = self.0[0].len() as i64;
        for (i, r) in row.iter_mut().enumerate() {
            let c = i as i64 + shift;
            let (a, b) = ((c - half).max(0), (c + half).min(n - 1));
            if a > b {
                continue;
            }
            let len = (b - a + 1) as usize;
            let k = (len.ilog2() as usize).min(self.0.len() - 1);
            let level = &self.0[k];
            let span = 1usize << k;
            let (mut at, last) = (a as usize, b as usize + 1 - span);
            let mut m = level[at].max(level[last]);
            while at + span < last {
                at += span;
                m = m.max(level[at]);
            }
            *r = r.max(m - z);
        }
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
            let out = Profile::new(f, 20.5, 1.0, side, 0.25).dilate(&img, over, 50.0);
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
}
