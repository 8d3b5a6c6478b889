//! Dilation, erosion and overlap of voxel sets by structuring elements.
//!
//! Method: three engines behind one [`dilate`]. The *naive* one is the definition, for tests; the
//! *bits* engine works on 64 voxels at a time and takes round tools and small sets of offsets; the
//! *fft* engine takes any element at a cost that hardly depends on its shape.
//!
//! An [`Element`] is a set of offsets: layers of chords, layers without end, whole planes. A
//! [`Window`] says at which positions the answer is wanted; they may lie outside the grid, where
//! the set is empty. Nothing wraps and nothing is cut off at the grid's faces.
//!
//! Guarantees: all engines give the same bits, at any number of threads (the FFT's threshold is
//! proved in its head). Not guaranteed: speed for elements of many scattered offsets in the bits
//! engine; [`dilate`] leaves those to the FFT.
//!
//! ```
//! use hmplan::morph::{Element, Engine, Layer, Window, dilate};
//! use hmplan::voxel::BitGrid;
//! let mut set = BitGrid::new([5, 5, 1]);
//! set.set([2, 2, 0], true);
//! let disk = Layer { z: 0, end: 1, plane: Element::disk(1.0) };
//! let cross = dilate(Engine::Bits, &set, &Element::from_layers(vec![disk]), &Window::of([5, 5, 1]));
//! assert_eq!(cross.count(), 5);
//! ```

mod bits;
mod cost;
mod element;
mod fft;
mod naive;
mod rows;
#[cfg(test)]
mod tests;
mod turn;

pub use cost::{Choice, choose};
pub use element::{Chord, ENDLESS_DOWN, ENDLESS_UP, Element, Layer, Plane, Window};
pub use turn::{Axis, Rotation, cardinal_rotations, turned};

use crate::voxel::BitGrid;

/// How a Minkowski sum is computed; the answer is the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Engine {
    /// The definition.
    Naive,
    /// Bit-parallel rows.
    Bits,
    /// Fast Fourier transform.
    Fft,
}

/// S ⊕ B = {s + b}, at the positions of `window`.
pub fn dilate(engine: Engine, set: &BitGrid, element: &Element, window: &Window) -> BitGrid {
    match engine {
        Engine::Naive => naive::dilate(set, element, window),
        Engine::Bits => bits::dilate(set, element, window),
        Engine::Fft => fft::dilate(set, element, window),
    }
}

/// S ⊖ B = {t : B + t ⊆ S}, at the positions of `window`; outside its grid S is empty. Endless
/// elements fit nowhere.
pub fn erode(engine: Engine, set: &BitGrid, element: &Element, window: &Window) -> BitGrid {
    let Some(bounds) = element.bounds() else {
        return BitGrid::from_fn(window.dims(), |_| true);
    };
    let grid = Window::of(set.dims());
    if window.is_empty() || bounds.lo.iter().chain(&bounds.hi).any(|c| c.abs() >= ENDLESS_UP) {
        return BitGrid::new(window.dims());
    }
    // (Sᶜ ⊕ −B)ᶜ with as much of the outside as B can touch from the window.
    let touched = window.plus(&bounds).hull(&grid);
    let outside = BitGrid::from_fn(touched.dims(), |p| {
        let p: [i64; 3] = std::array::from_fn(|a| p[a] as i64 + touched.lo[a]);
        !set.get_or_empty(p)
    });
    let shifted = Window {
        lo: std::array::from_fn(|a| window.lo[a] - touched.lo[a]),
        hi: std::array::from_fn(|a| window.hi[a] - touched.lo[a]),
    };
    complement(&dilate(engine, &outside, &element.reflected(), &shifted))
}

/// |S ∩ (B + t)| for every t of `window`, x fastest, then y, then z.
///
/// By the definition for [`Engine::Naive`], by FFT otherwise; a bit-parallel engine cannot count.
pub fn overlaps(engine: Engine, set: &BitGrid, element: &Element, window: &Window) -> Vec<u32> {
    match engine {
        Engine::Naive => naive::overlaps(set, element, window),
        _ => fft::overlaps(set, element, window),
    }
}

/// The voxels of the grid that are not in the set.
pub fn complement(set: &BitGrid) -> BitGrid {
    let mut out = BitGrid::new(set.dims());
    let last = out.last_word_mask();
    use rayon::prelude::*;
    out.par_rows_mut().for_each(|(y, z, row)| {
        row.iter_mut().zip(set.row(y, z)).for_each(|(o, s)| *o = !s);
        if let Some(word) = row.last_mut() {
            *word &= last;
        }
    });
    out
}
