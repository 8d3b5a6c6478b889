//! The definition: a union of translates.

use super::{Element, Window};
use crate::voxel::BitGrid;

/// S ⊕ B within `window`: every s + b, one by one.
pub fn dilate(set: &BitGrid, element: &Element, window: &Window) -> BitGrid {
    let mut out = BitGrid::new(window.dims());
    // Offsets outside this box link no voxel of the grid to the window.
    let element = element.clipped(&window.minus(&Window::of(set.dims())));
    for (z, c) in element.chords() {
        for x in c.x..c.x + c.len {
            for s in set.iter_ones() {
                let t = [s[0] as i64 + x, s[1] as i64 + c.y, s[2] as i64 + z];
                if (0..3).all(|a| (window.lo[a]..window.hi[a]).contains(&t[a])) {
                    out.set(std::array::from_fn(|a| (t[a] - window.lo[a]) as usize), true);
                }
            }
        }
    }
    out
}

/// |S ∩ (B + t)| for every t of `window`, x fastest, then y, then z.
pub fn overlaps(set: &BitGrid, element: &Element, window: &Window) -> Vec<u32> {
    let [nx, ny, nz] = window.dims();
    let element = element.clipped(&Window::of(set.dims()).minus(window));
    let mut counts = vec![0u32; nx * ny * nz];
    for (z, c) in element.chords() {
        for x in c.x..c.x + c.len {
            for s in set.iter_ones() {
                let t = [s[0] as i64 - x, s[1] as i64 - c.y, s[2] as i64 - z];
                if (0..3).all(|a| (window.lo[a]..window.hi[a]).contains(&t[a])) {
                    let [i, j, k] = std::array::from_fn(|a| (t[a] - window.lo[a]) as usize);
                    counts[i + nx * (j + ny * k)] += 1;
                }
            }
        }
    }
    counts
}
