//! Accessible and inaccessible regions (HB Sec. 3.2) by four engines, and the choice among them.

use super::{VoxelTool, columns};
use crate::morph::{self, Engine as Minkowski, Window};
use crate::voxel::BitGrid;

/// How an accessible region is computed; the answer is the same for every tool that both take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Engine {
    /// The definition, for tests.
    Naive,
    /// Heights of columns: tools that go up without end and never narrow.
    Depth,
    /// Bit-parallel: round tools along a grid axis, undercutting ones included.
    Bits,
    /// Fourier transform: tools of any shape.
    Fft,
}

/// An engine with what each would cost, milliseconds of one core.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EngineChoice {
    pub engine: Engine,
    /// None for a tool that narrows upward.
    pub depth_ms: Option<f64>,
    pub bits_ms: f64,
    pub fft_ms: f64,
}

/// Nanoseconds of one core per column and chord (a running extreme along the row).
const DEPTH_NS_PER_CHORD: f64 = 2.0;
/// Nanoseconds of one core per word of the grid to read heights from it and write them back.
const DEPTH_NS_PER_WORD: f64 = 2.0;

/// The cheapest engine for a tool on a grid of `dims`; never the naive one.
pub fn choose(dims: [usize; 3], tool: &VoxelTool) -> EngineChoice {
    let dims = tool.axis().map_or(dims, |a| a.dims_up(dims));
    let grid = Window::of(dims);
    let edge = tool.touching();
    let tips = edge.bounds().map_or(grid, |b| grid.minus(&b));
    let obstacle = morph::choose(dims, &tool.body().reflected(), &tips);
    let touched = morph::choose(tips.dims(), &edge, &grid);
    let (bits_ms, fft_ms) = (obstacle.bits_ms + touched.bits_ms, obstacle.fft_ms + touched.fft_ms);
    let depth_ms = tool.never_narrows().then(|| {
        let chords: usize = tool
            .body()
            .layers()
            .iter()
            .map(|l| match &l.plane {
                morph::Plane::Whole => 1,
                morph::Plane::Chords(c) => c.len(),
            })
            .sum();
        let columns = (dims[0] * dims[1]) as f64;
        let words = columns / 64.0 * dims[2] as f64;
        let touching = edge.count() as f64;
        (columns * (chords as f64 + touching) * DEPTH_NS_PER_CHORD + words * DEPTH_NS_PER_WORD)
            * 1e-6
    });
    let engine = match depth_ms {
        Some(ms) if ms <= bits_ms.min(fft_ms) => Engine::Depth,
        _ if bits_ms <= fft_ms => Engine::Bits,
        _ => Engine::Fft,
    };
    let choice = EngineChoice { engine, depth_ms, bits_ms, fft_ms };
    tracing::debug!(
        "engine {engine:?}: depth {} ms, bits {bits_ms:.1} ms, FFT {fft_ms:.0} ms expected",
        depth_ms.map_or("–".into(), |ms| format!("{ms:.1}"))
    );
    choice
}

/// O(O, T) = O ⊕ (−T) (HB Eq. 2): the tip positions of `window` at which the body meets an
/// obstacle. The tool's +z is the grid's.
pub fn obstacle(engine: Minkowski, set: &BitGrid, tool: &VoxelTool, window: &Window) -> BitGrid {
    morph::dilate(engine, set, &tool.body().reflected(), window)
}

/// A(O, T, K) (HB Eq. 3, Alg. 1): what the edge touches from positions at which the tool meets
/// nothing. Positions outside the grid count.
///
/// Of [`Engine::Depth`] a tool that narrows upward gets the answer of the bits engine, since heights
/// cannot tell it.
pub fn accessible(engine: Engine, obstacles: &BitGrid, tool: &VoxelTool) -> BitGrid {
    let Some(axis) = tool.axis() else { return accessible_upright(engine, obstacles, tool) };
    axis.down(&accessible_upright(engine, &axis.up(obstacles), tool))
}

fn accessible_upright(engine: Engine, obstacles: &BitGrid, tool: &VoxelTool) -> BitGrid {
    let (minkowski, edge) = match engine {
        Engine::Depth if tool.never_narrows() => return columns::accessible(obstacles, tool),
        Engine::Naive => (Minkowski::Naive, tool.edge().clone()),
        Engine::Fft => (Minkowski::Fft, tool.touching()),
        Engine::Depth | Engine::Bits => (Minkowski::Bits, tool.touching()),
    };
    let grid = Window::of(obstacles.dims());
    let Some(reach) = edge.bounds() else { return BitGrid::new(obstacles.dims()) };
    let tips = grid.minus(&reach);
    let free = morph::complement(&obstacle(minkowski, obstacles, tool, &tips));
    let shifted = Window {
        lo: std::array::from_fn(|a| grid.lo[a] - tips.lo[a]),
        hi: std::array::from_fn(|a| grid.hi[a] - tips.lo[a]),
    };
    morph::dilate(minkowski, &free, &edge, &shifted)
}

/// I(O, T, K) = Oᶜ − A (HB Eq. 6, Alg. 2).
pub fn inaccessible(engine: Engine, obstacles: &BitGrid, tool: &VoxelTool) -> BitGrid {
    let mut out = morph::complement(obstacles);
    out.subtract(&accessible(engine, obstacles, tool));
    out
}
