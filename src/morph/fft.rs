//! The FFT engine: elements of any shape at a cost that hardly depends on them.
//!
//! Method (HB Alg. 1): the indicator functions are convolved by fast Fourier transforms and the
//! counts compared with ½. Real transforms along x, complex ones along y and z; sizes of the
//! factors 2, 3 and 5, large enough that nothing wraps. Platforms are projected, not transformed.
//! Set and element are cut into slabs along z so that a transform stays within
//! [`SPECTRUM_BYTES`]; the dilation by a union of pairs of slabs is the union of their dilations,
//! and counts add up.
//!
//! # Why ½ is a safe threshold
//!
//! Let u be the unit roundoff, N the transform's size, A and B the numbers of voxels in set and
//! element. In a transform of factors 2, 3 and 5 every output is a sum of its inputs times roots
//! of unity, each term passing through one twiddle factor and one small sum a stage. With the
//! factor's own arithmetic bounded by 10 u for each doubling of N (a stage of 2: one addition and
//! one complex product by a root accurate to u, (1 + 2√2 + 1) u < 5 u; a stage of 3: 1.58
//! doublings, 3 terms, < 13 u; a stage of 5: 2.32 doublings, 5 terms, < 20 u), an output is off
//! by at most ε Σ|input|, ε = 10 u log₂ N, to first order. In l₂ the same ε bounds the relative
//! error. So a spectrum is off by at most ε√N·√A (Parseval), the product by
//! (2 ε + 4 u) N √A√B in l₁ (Cauchy–Schwarz), and each count after the inverse by
//!
//! |error| ≤ (3 ε + 4 u) √(A B).
//!
//! Counts are whole numbers, so a bound below ½ separates 0 from 1. Single precision is used where
//! the bound, with a factor 2 for the orders left out, allows it, double precision elsewhere: there
//! the bound stays below ½ up to √(A B) ≈ 10¹², more than any grid holds.

use super::{Chord, Element, Layer, Plane, Window};
use crate::voxel::BitGrid;
use rayon::prelude::*;
use realfft::{ComplexToReal, FftNum, RealFftPlanner, RealToComplex};
use rustfft::num_traits::ToPrimitive;
use rustfft::{Fft, FftPlanner, num_complex::Complex};
use std::sync::Arc;

/// Largest memory of one spectrum, bytes; two of them are held at once. Smaller cuts tall elements
/// into more slabs and costs time; larger costs memory.
const SPECTRUM_BYTES: usize = 192 << 20;

/// Lines of a spectrum that are transformed side by side: enough to use whole cache lines.
const LINES: usize = 16;

/// S ⊕ B within `window`.
pub fn dilate(set: &BitGrid, element: &Element, window: &Window) -> BitGrid {
    let platforms: Vec<Layer> =
        element.layers().iter().filter(|l| l.plane == Plane::Whole).cloned().collect();
    let mut out = super::bits::dilate(set, &Element::from_layers(platforms), window);
    convolve(set, element, window, |z, y, counts| {
        let row = out.row_mut(y, z);
        for (x, c) in counts.iter().enumerate() {
            row[x / 64] |= u64::from(*c > 0) << (x % 64);
        }
    });
    out
}

/// |S ∩ (B + t)| for every t of `window`, x fastest, then y, then z.
pub fn overlaps(set: &BitGrid, element: &Element, window: &Window) -> Vec<u32> {
    let [nx, ny, nz] = window.dims();
    let mut counts = vec![0u32; nx * ny * nz];
    let turned = element.reflected();
    for l in turned.layers().iter().filter(|l| l.plane == Plane::Whole) {
        add_platform(set, l, window, &mut counts);
    }
    convolve(set, &turned, window, |z, y, row| {
        let at = nx * (y + ny * z);
        counts[at..at + nx].iter_mut().zip(row).for_each(|(c, n)| *c += n);
    });
    counts
}

/// Adds the voxels of every slice that a platform covers.
fn add_platform(set: &BitGrid, layer: &Layer, window: &Window, counts: &mut [u32]) {
    let [_, ny, nz] = set.dims();
    let in_slice = |s: usize| (0..ny).flat_map(move |y| set.row(y, s)).map(|w| w.count_ones());
    let of: Vec<u32> = (0..nz).map(|s| in_slice(s).sum()).collect();
    let [wx, wy, _] = window.dims();
    for (t, slice) in (window.lo[2]..).zip(counts.chunks_mut((wx * wy).max(1))) {
        // s + o = t, o in z..end.
        let covered = (0..nz).filter(|s| (layer.z..layer.end).contains(&(t - *s as i64)));
        let n: u32 = covered.map(|s| of[s]).sum();
        slice.iter_mut().for_each(|c| *c += n);
    }
}

/// Calls `row` with (z, y, counts) of S ⊕ B over the rows of the window, for each pair of slabs.
fn convolve(
    set: &BitGrid,
    element: &Element,
    window: &Window,
    mut row: impl FnMut(usize, usize, &[u32]),
) {
    let Some((lo, hi)) = set.extent() else { return };
    let set_box = Window { lo: lo.map(|c| c as i64), hi: hi.map(|c| c as i64 + 1) };
    let finite: Vec<Layer> =
        element.layers().iter().filter(|l| l.plane != Plane::Whole).cloned().collect();
    let element = Element::from_layers(finite).clipped(&window.minus(&set_box));
    let (Some(b), false) = (element.bounds(), window.is_empty()) else { return };
    let span = |w: &Window, a: usize| (w.hi[a] - w.lo[a]) as usize;
    let size = [0, 1].map(|a| good_size(span(&set_box, a) + span(&b, a) - 1));
    let plane = (size[0] / 2 + 1) * size[1] * size_of::<Complex<f64>>();
    let deep = (SPECTRUM_BYTES / plane).max(2);
    let (set_deep, element_deep) = shares(deep, span(&set_box, 2), span(&b, 2));
    let mut from = b.lo[2];
    while from < b.hi[2] {
        let to = (from + element_deep as i64).min(b.hi[2]);
        let part =
            element.clipped(&Window { lo: [b.lo[0], b.lo[1], from], hi: [b.hi[0], b.hi[1], to] });
        if !part.is_empty() {
            let nz = good_size(set_deep + (to - from) as usize - 1);
            let pair = Pair { set, part: &part, set_box, corner: [b.lo[0], b.lo[1], from] };
            let most = set_deep as f64 * (size[0] * size[1]) as f64;
            let counts = (set.count() as f64).min(most) * part.count() as f64;
            let levels = ((size[0] * size[1] * nz) as f64).log2();
            let single = error_bound(f64::from(f32::EPSILON) / 2.0, levels, counts) < 0.25;
            if single {
                pair.run::<f32>([size[0], size[1], nz], set_deep, window, &mut row);
            } else {
                pair.run::<f64>([size[0], size[1], nz], set_deep, window, &mut row);
            }
        }
        from = to;
    }
}

/// The bound of the module's head: `u` roundoff, `levels` log₂ N, `product` A B.
fn error_bound(u: f64, levels: f64, product: f64) -> f64 {
    (30.0 * levels + 4.0) * u * product.sqrt()
}

/// Slab depths for set and element whose sum stays within `deep`, the shorter one whole if it can.
fn shares(deep: usize, set: usize, element: usize) -> (usize, usize) {
    if set + element <= deep {
        return (set, element);
    }
    let half = (deep / 2).max(1);
    if element <= half {
        (deep - element, element)
    } else if set <= half {
        (set, deep - set)
    } else {
        (half, half)
    }
}

/// The least number not below `n` of the factors 2, 3 and 5, even.
pub fn good_size(n: usize) -> usize {
    let smooth = |mut m: usize| {
        for p in [2, 3, 5] {
            while m.is_multiple_of(p) {
                m /= p;
            }
        }
        m == 1
    };
    (n.max(2)..).find(|m| m.is_multiple_of(2) && smooth(*m)).unwrap_or(n)
}

/// A set and one slab of an element.
struct Pair<'a> {
    set: &'a BitGrid,
    part: &'a Element,
    set_box: Window,
    /// Offset that lies at the transform's origin.
    corner: [i64; 3],
}

impl Pair<'_> {
    fn run<T: FftNum + ToPrimitive>(
        &self,
        size: [usize; 3],
        set_deep: usize,
        window: &Window,
        row: &mut impl FnMut(usize, usize, &[u32]),
    ) {
        let plan = Plan::<T>::new(size);
        let chords: Vec<(i64, Chord)> = self.part.chords().collect();
        let kernel = plan.forward(|y, z, line| {
            let row = (z as i64 + self.corner[2], y as i64 + self.corner[1]);
            let first = chords.partition_point(|(z, c)| (*z, c.y) < row);
            for (_, c) in chords[first..].iter().take_while(|(z, c)| (*z, c.y) == row) {
                let at = (c.x - self.corner[0]) as usize;
                line[at..at + c.len as usize].fill(T::one());
            }
        });
        let mut from = self.set_box.lo[2];
        while from < self.set_box.hi[2] {
            let to = (from + set_deep as i64).min(self.set_box.hi[2]);
            let mut spectrum = plan.forward(|y, z, line| self.set_line(y, z, from, to, line));
            plan.multiply(&mut spectrum, &kernel);
            let at = [
                self.set_box.lo[0] + self.corner[0] - window.lo[0],
                self.set_box.lo[1] + self.corner[1] - window.lo[1],
                from + self.corner[2] - window.lo[2],
            ];
            plan.inverse(spectrum, at, window.dims(), row);
            from = to;
        }
    }

    /// One row of the slab from..to of the set.
    fn set_line<T: FftNum + ToPrimitive>(
        &self,
        y: usize,
        z: usize,
        from: i64,
        to: i64,
        line: &mut [T],
    ) {
        let (y, z) = (y as i64 + self.set_box.lo[1], z as i64 + from);
        if y >= self.set_box.hi[1] || z >= to {
            return;
        }
        let bits = self.set.row(y as usize, z as usize);
        for x in self.set_box.lo[0] as usize..self.set_box.hi[0] as usize {
            if bits[x / 64] >> (x % 64) & 1 == 1 {
                line[x - self.set_box.lo[0] as usize] = T::one();
            }
        }
    }
}

/// Transforms of one size.
struct Plan<T: FftNum + ToPrimitive> {
    size: [usize; 3],
    /// Complex numbers a row holds.
    width: usize,
    x: Arc<dyn RealToComplex<T>>,
    x_back: Arc<dyn ComplexToReal<T>>,
    /// Along y and z, there and back.
    yz: [[Arc<dyn Fft<T>>; 2]; 2],
}

type Spectrum<T> = Vec<Complex<T>>;

impl<T: FftNum + ToPrimitive> Plan<T> {
    fn new(size: [usize; 3]) -> Self {
        let mut real = RealFftPlanner::new();
        let mut planner = FftPlanner::new();
        let mut both = |n: usize| [planner.plan_fft_forward(n), planner.plan_fft_inverse(n)];
        Plan {
            size,
            width: size[0] / 2 + 1,
            x: real.plan_fft_forward(size[0]),
            x_back: real.plan_fft_inverse(size[0]),
            yz: [both(size[1]), both(size[2])],
        }
    }

    /// The spectrum of a volume given by rows: `fill` is handed each (y, z) and a row of zeros.
    fn forward(&self, fill: impl Fn(usize, usize, &mut [T]) + Sync) -> Spectrum<T> {
        let [nx, ny, nz] = self.size;
        let zero = Complex::new(T::zero(), T::zero());
        let mut data = vec![zero; self.width * ny * nz];
        data.par_chunks_mut(self.width * ny).enumerate().for_each_init(
            || (vec![T::zero(); nx], self.x.make_scratch_vec(), Vec::new()),
            |(line, scratch, lines), (z, slice)| {
                for (y, out) in slice.chunks_mut(self.width).enumerate() {
                    line.fill(T::zero());
                    fill(y, z, line);
                    if line.iter().all(|v| v.is_zero()) {
                        continue;
                    }
                    // Lengths are the plan's own.
                    let done = self.x.process_with_scratch(line, out, scratch);
                    debug_assert!(done.is_ok());
                }
                let mut rows: Vec<&mut [Complex<T>]> = slice.chunks_mut(self.width).collect();
                across(&mut rows, self.width, &*self.yz[0][0], lines);
            },
        );
        self.columns(&mut data, |rows, lines| {
            across(rows, self.width, &*self.yz[1][0], lines);
        });
        data
    }

    /// Works on the planes of constant y: their rows in order of z.
    fn columns(
        &self,
        data: &mut Spectrum<T>,
        work: impl Fn(&mut [&mut [Complex<T>]], &mut Vec<Complex<T>>) + Sync,
    ) {
        let [_, ny, nz] = self.size;
        let mut planes: Vec<Vec<&mut [Complex<T>]>> =
            (0..ny).map(|_| Vec::with_capacity(nz)).collect();
        for (r, row) in data.chunks_mut(self.width).enumerate() {
            planes[r % ny].push(row);
        }
        planes
            .par_iter_mut()
            .for_each_init(Vec::new, |lines, rows| work(rows.as_mut_slice(), lines));
    }

    fn multiply(&self, a: &mut Spectrum<T>, b: &Spectrum<T>) {
        let n = self.width * self.size[1];
        a.par_chunks_mut(n).zip(b.par_chunks(n)).for_each(|(a, b)| {
            a.iter_mut().zip(b).for_each(|(a, b)| *a = *a * *b);
        });
    }

    /// Rounds the volume of a spectrum to counts and hands out the rows inside the window of
    /// `dims`, the volume's voxel 0 lying at `at` of it.
    fn inverse(
        &self,
        mut data: Spectrum<T>,
        at: [i64; 3],
        dims: [usize; 3],
        row: &mut impl FnMut(usize, usize, &[u32]),
    ) {
        let [nx, ny, nz] = self.size;
        self.columns(&mut data, |rows, lines| {
            across(rows, self.width, &*self.yz[1][1], lines);
        });
        let scale = 1.0 / (nx * ny * nz) as f64;
        let inside =
            |i: usize, a: usize| usize::try_from(at[a] + i as i64).ok().filter(|p| *p < dims[a]);
        let slices: Vec<Vec<(usize, usize, Vec<u32>)>> = data
            .par_chunks_mut(self.width * ny)
            .enumerate()
            .map_init(
                || (vec![T::zero(); nx], self.x_back.make_scratch_vec(), Vec::new()),
                |(line, scratch, lines), (k, slice)| {
                    let Some(z) = inside(k, 2) else { return Vec::new() };
                    let mut rows: Vec<&mut [Complex<T>]> = slice.chunks_mut(self.width).collect();
                    across(&mut rows, self.width, &*self.yz[0][1], lines);
                    let mut found = Vec::new();
                    for (j, input) in rows.iter_mut().enumerate() {
                        let Some(y) = inside(j, 1) else { continue };
                        // Rounding leaves a trace in parts that a real signal does not have.
                        input[0].im = T::zero();
                        input[self.width - 1].im = T::zero();
                        let done = self.x_back.process_with_scratch(input, line, scratch);
                        debug_assert!(done.is_ok());
                        let mut counts = vec![0u32; dims[0]];
                        let first = (-at[0]).max(0) as usize;
                        let last = (dims[0] as i64 - at[0]).clamp(0, nx as i64) as usize;
                        for i in first..last {
                            let v = line[i].to_f64().unwrap_or(0.0) * scale;
                            counts[(at[0] + i as i64) as usize] = (v + 0.5) as u32;
                        }
                        if counts.iter().any(|c| *c > 0) {
                            found.push((z, y, counts));
                        }
                    }
                    found
                },
            )
            .collect();
        for (z, y, counts) in slices.into_iter().flatten() {
            row(z, y, &counts);
        }
    }
}

/// Transforms across rows: the numbers at each place of all rows are one line.
fn across<T: FftNum + ToPrimitive>(
    rows: &mut [&mut [Complex<T>]],
    width: usize,
    fft: &dyn Fft<T>,
    room: &mut Vec<Complex<T>>,
) {
    let n = rows.len();
    let zero = Complex::new(T::zero(), T::zero());
    room.resize(LINES * n + fft.get_inplace_scratch_len(), zero);
    let (lines, scratch) = room.split_at_mut(LINES * n);
    for from in (0..width).step_by(LINES) {
        let count = LINES.min(width - from);
        for (i, row) in rows.iter().enumerate() {
            for c in 0..count {
                lines[c * n + i] = row[from + c];
            }
        }
        fft.process_with_scratch(&mut lines[..count * n], scratch);
        for (i, row) in rows.iter_mut().enumerate() {
            for c in 0..count {
                row[from + c] = lines[c * n + i];
            }
        }
    }
}
