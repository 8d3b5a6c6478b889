//! Which engine computes a Minkowski sum: the cheaper one by a model of its operations.

use super::fft::good_size;
use super::{Element, Engine, Plane, Window};

/// Nanoseconds of one core per word of a row and step (gather, widen or shift) of the bits engine.
/// Measured on rows of four words; off by a factor of two it moves the choice only where both
/// engines cost about the same.
const BITS_NS_PER_STEP: f64 = 0.6;

/// Nanoseconds of one core per number of the padded volume and doubling of its size, for the three
/// transforms of a convolution in double precision.
const FFT_NS_PER_LEVEL: f64 = 1.6;

/// An engine and what each would cost, milliseconds of one core.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Choice {
    pub engine: Engine,
    pub bits_ms: f64,
    pub fft_ms: f64,
}

/// The cheaper engine for a set of `dims` voxels, an element and a window.
pub fn choose(dims: [usize; 3], element: &Element, window: &Window) -> Choice {
    let link = window.minus(&Window::of(dims));
    let [wx, wy, wz] = window.dims().map(|n| n as f64);
    let words = (wx.max(dims[0] as f64) / 64.0).ceil();
    // What lies beyond the window meets nothing, and no engine looks at it.
    let finite = element.layers().iter().filter(|l| l.plane != Plane::Whole).cloned().collect();
    let solid = Element::from_layers(finite).clipped(&link);
    let steps: f64 = solid
        .layers()
        .iter()
        .map(|l| match &l.plane {
            Plane::Whole => 0.0,
            Plane::Chords(c) => {
                let length = (l.end - l.z).max(0) as f64;
                c.iter().map(gather).sum::<f64>() + (length + 1.0).log2() + 1.0
            }
        })
        .sum();
    let bits_ms = BITS_NS_PER_STEP * words * wy * wz.max(dims[2] as f64) * steps * 1e-6;
    let fft_ms = match solid.bounds() {
        None => 0.0,
        Some(b) => {
            let size = |a: usize| good_size(dims[a] + (b.hi[a] - b.lo[a]) as usize - 1) as f64;
            let n = size(0) * size(1) * size(2);
            FFT_NS_PER_LEVEL * n * n.log2() * 1e-6
        }
    };
    let engine = if bits_ms <= fft_ms || solid.is_empty() { Engine::Bits } else { Engine::Fft };
    Choice { engine, bits_ms, fft_ms }
}

/// Steps that a chord takes: its row, and its share of the widening.
fn gather(c: &super::Chord) -> f64 {
    1.0 + 0.25 * (c.len as f64).log2()
}
