//! The bit-parallel engine: 64 voxels an operation.
//!
//! Method. A layer of the element is a cross-section and a run of heights. The cross-section of a
//! disk is a stack of chords that contain one another, so a row is gathered from its neighbours
//! widest chord first, widening by the difference before the next is added: one pass for all
//! chords (after van Droogenbroeck & Talbot 1996), for all slices of a panel at once, so that each
//! step is one loop over a block of memory. A run of heights takes doubling shifts over a
//! panel of constant y, which fits a core's first cache; an endless run is a running OR, and a
//! whole plane a projection. Cross-sections that are no such stack go chord by chord.
//!
//! Rows are handled in a frame wide enough that no bit that comes back to the window is lost.

use super::element::{ENDLESS_DOWN, ENDLESS_UP};
use super::rows::{Panel, or, or_shifted, run_ahead, widen};
use super::{Chord, Element, Layer, Plane, Window};
use crate::voxel::BitGrid;
use rayon::prelude::*;

/// S ⊕ B within `window`.
pub fn dilate(set: &BitGrid, element: &Element, window: &Window) -> BitGrid {
    let mut out = BitGrid::new(window.dims());
    if window.is_empty() || set.dims().contains(&0) {
        return out;
    }
    let full = whole_slices(set, element, window);
    let sections: Vec<Section> = element
        .layers()
        .iter()
        .filter_map(|l| Section::of(l, set, window))
        .filter(|s| !s.rows_in.is_empty())
        .collect();
    // x range of the work frame: every place that a bit passes on its way into the window.
    let grid_x = (0, set.dims()[0] as i64);
    let (lo, hi) = sections
        .iter()
        .fold((grid_x.0.min(window.lo[0]), grid_x.1.max(window.hi[0])), |(lo, hi), s| {
            (lo.min(s.hull.0), hi.max(s.hull.1))
        });
    let placed = placed(set, lo, (hi - lo) as usize);
    let work = Work { set: &placed, sections: &sections, window, full: &full };
    let panels: Vec<Vec<u64>> = (window.lo[1]..window.hi[1])
        .into_par_iter()
        .map_init(Scratch::default, |scratch, y| work.panel_of_width(y, scratch))
        .collect();
    let (w, last, shift) = (placed.words_per_row(), out.last_word_mask(), lo - window.lo[0]);
    out.par_rows_mut().for_each(|(y, z, row)| {
        if full[z] {
            row.fill(!0);
        } else if !panels[y].is_empty() {
            let from = &panels[y][z * w..(z + 1) * w];
            if shift == 0 { or(row, from) } else { or_shifted(row, from, shift) }
        }
        if let Some(word) = row.last_mut() {
            *word &= last;
        }
    });
    out
}

/// The slices of the window that platforms fill.
fn whole_slices(set: &BitGrid, element: &Element, window: &Window) -> Vec<bool> {
    let mut full = vec![false; window.dims()[2]];
    let whole: Vec<&Layer> = element.layers().iter().filter(|l| l.plane == Plane::Whole).collect();
    if whole.is_empty() {
        return full;
    }
    let slice = set.words_per_row() * set.dims()[1];
    for (s, words) in set.words().chunks(slice).enumerate() {
        if words.iter().all(|w| *w == 0) {
            continue;
        }
        for l in &whole {
            let from = (s as i64 + l.z).max(window.lo[2]);
            let to = (s as i64 + l.end).min(window.hi[2]);
            (from..to).for_each(|t| full[(t - window.lo[2]) as usize] = true);
        }
    }
    full
}

/// The set with its rows moved to start at `lo`, `n` voxels long.
fn placed(set: &BitGrid, lo: i64, n: usize) -> std::borrow::Cow<'_, BitGrid> {
    let [nx, ny, nz] = set.dims();
    if lo == 0 && n.div_ceil(64) == nx.div_ceil(64) && set.is_whole() {
        return std::borrow::Cow::Borrowed(set);
    }
    let mut out = BitGrid::new([n, ny, nz]);
    out.par_rows_mut().for_each(|(y, z, row)| or_shifted(row, set.row(y, z), -lo));
    std::borrow::Cow::Owned(out)
}

/// One step of a stack of chords: rows to take in, then how far to widen.
struct Step {
    dys: Vec<i64>,
    left: u32,
    right: u32,
}

enum Shape {
    /// Chords that contain one another, widest first, about x = `centre`.
    Stack {
        centre: i64,
        steps: Vec<Step>,
    },
    Free(Vec<Chord>),
}

/// A layer, prepared.
struct Section {
    shape: Shape,
    z: i64,
    end: i64,
    /// x range that the work frame must hold for it.
    hull: (i64, i64),
    /// Slices of the set that can matter.
    rows_in: std::ops::Range<usize>,
}

impl Section {
    fn of(layer: &Layer, set: &BitGrid, window: &Window) -> Option<Section> {
        let Plane::Chords(chords) = &layer.plane else { return None };
        let [nx, _, nz] = set.dims().map(|n| n as i64);
        let link = window.minus(&Window::of(set.dims()));
        let stack = stack_of(chords);
        let (shape, hull) = match stack {
            Some((centre, steps)) => {
                let hull = ((window.lo[0] - centre).min(0), (window.hi[0] - centre).max(nx));
                (Shape::Stack { centre, steps }, hull)
            }
            None => {
                let clip = |c: &Chord| {
                    let (x, end) = (c.x.max(link.lo[0]), (c.x + c.len).min(link.hi[0]));
                    (x < end).then_some(Chord { y: c.y, x, len: end - x })
                };
                let chords: Vec<Chord> = chords.iter().filter_map(clip).collect();
                let lo = chords.iter().map(|c| c.x).min()?;
                let hi = chords.iter().map(|c| c.x + c.len).max()?;
                (Shape::Free(chords), (lo.min(0), (nx + hi).max(nx)))
            }
        };
        // s + o = t with o in z..end: the slices s that meet the window.
        let first = (window.lo[2] - (layer.end - 1)).clamp(0, nz) as usize;
        let last = (window.hi[2] - layer.z).clamp(0, nz) as usize;
        Some(Section { shape, z: layer.z, end: layer.end, hull, rows_in: first..last.max(first) })
    }
}

/// The chords as a stack, if they are one: one a row, each containing the next shorter one.
fn stack_of(chords: &[Chord]) -> Option<(i64, Vec<Step>)> {
    let mut sorted = chords.to_vec();
    sorted.sort_by_key(|c| (std::cmp::Reverse(c.len), c.x, c.y));
    let contains = |a: &Chord, b: &Chord| a.x <= b.x && b.x + b.len <= a.x + a.len;
    let nested = sorted.windows(2).all(|p| contains(&p[0], &p[1]));
    let single = chords.windows(2).all(|p| p[0].y != p[1].y);
    if !nested || !single || chords.is_empty() {
        return None;
    }
    let smallest = sorted.last()?;
    let centre = smallest.x + (smallest.len - 1) / 2;
    let mut steps: Vec<Step> = Vec::new();
    let mut i = 0;
    while i < sorted.len() {
        let a = sorted[i];
        let same = sorted[i..].iter().take_while(|c| (c.x, c.len) == (a.x, a.len)).count();
        let dys = sorted[i..i + same].iter().map(|c| c.y).collect();
        i += same;
        let (left, right) = match sorted.get(i) {
            Some(b) => (b.x - a.x, a.x + a.len - b.x - b.len),
            None => (centre - a.x, a.x + a.len - 1 - centre),
        };
        steps.push(Step {
            dys,
            left: u32::try_from(left).ok()?,
            right: u32::try_from(right).ok()?,
        });
    }
    Some((centre, steps))
}

/// Room that panels of one thread share.
#[derive(Default)]
struct Scratch {
    rows: Vec<u64>,
    gathered: Panel,
}

struct Work<'a> {
    set: &'a BitGrid,
    sections: &'a [Section],
    window: &'a Window,
    full: &'a [bool],
}

impl Work<'_> {
    /// [`Work::panel`] with the number of words known to the compiler where rows are short.
    fn panel_of_width(&self, y: i64, scratch: &mut Scratch) -> Vec<u64> {
        match self.set.words_per_row() {
            1 => self.panel::<1>(y, scratch),
            2 => self.panel::<2>(y, scratch),
            3 => self.panel::<3>(y, scratch),
            4 => self.panel::<4>(y, scratch),
            5 => self.panel::<5>(y, scratch),
            6 => self.panel::<6>(y, scratch),
            7 => self.panel::<7>(y, scratch),
            8 => self.panel::<8>(y, scratch),
            9 => self.panel::<9>(y, scratch),
            _ => self.panel::<0>(y, scratch),
        }
    }

    /// All rows of the window at one y; empty when there is nothing in them.
    fn panel<const W: usize>(&self, y: i64, scratch: &mut Scratch) -> Vec<u64> {
        let w = if W == 0 { self.set.words_per_row() } else { W };
        let mut acc: Vec<u64> = Vec::new();
        let n = self.full.len();
        let Scratch { rows: scratch, gathered } = scratch;
        for s in self.sections {
            // Runs read ahead, so the rows of the set follow as many empty ones as a run is long.
            let i_end = (self.window.hi[2] - s.z).max(0);
            let length = (s.end - s.z).min(i_end).max(1) as usize;
            let finite = s.z > ENDLESS_DOWN && s.end < ENDLESS_UP;
            let pad = if finite { length - 1 } else { 0 };
            let nz = self.set.dims()[2];
            let rows = if finite { pad + (i_end as usize).max(nz) } else { nz };
            scratch.clear();
            scratch.resize(rows * w, 0);
            let of_set = &mut scratch[(pad + s.rows_in.start) * w..(pad + s.rows_in.end) * w];
            let any = match &s.shape {
                Shape::Stack { centre, steps } => {
                    self.stack_rows::<W>(s, steps, *centre, y, gathered, of_set)
                }
                Shape::Free(chords) => self.free_rows(s, chords, y, of_set),
            };
            if !any {
                continue;
            }
            acc.resize(n * w, 0);
            if finite {
                run_ahead(scratch, w, length);
                self.add(
                    &mut acc,
                    w,
                    |t| {
                        let i = t - s.z;
                        (0..i_end).contains(&i).then_some(i as usize)
                    },
                    scratch,
                );
            } else {
                self.add_endless(s, &mut acc, w, scratch);
            }
        }
        acc
    }

    /// acc[t] |= rows[of(t)] for the slices that are not full.
    fn add(&self, acc: &mut [u64], w: usize, of: impl Fn(i64) -> Option<usize>, rows: &[u64]) {
        for (k, row) in acc.chunks_exact_mut(w).enumerate() {
            if !self.full[k]
                && let Some(i) = of(self.window.lo[2] + k as i64)
            {
                or(row, &rows[i * w..(i + 1) * w]);
            }
        }
    }

    /// Layers that go up or down without end: running ORs.
    fn add_endless(&self, s: &Section, acc: &mut [u64], w: usize, rows: &mut [u64]) {
        let nz = rows.len() / w;
        let up = s.end == ENDLESS_UP;
        let down = s.z == ENDLESS_DOWN;
        if up {
            for i in 1..nz {
                let (before, here) = rows.split_at_mut(i * w);
                or(&mut here[..w], &before[(i - 1) * w..]);
            }
        }
        if down {
            for i in (1..nz).rev() {
                let (before, here) = rows.split_at_mut(i * w);
                or(&mut before[(i - 1) * w..], &here[..w]);
            }
        }
        let last = nz as i64 - 1;
        self.add(
            acc,
            w,
            |t| match (up, down) {
                (true, true) => Some(0),
                // Every slice up to t − z.
                (true, false) => usize::try_from((t - s.z).min(last)).ok(),
                // Every slice from t − end + 1 on.
                _ => {
                    let i = (t - s.end + 1).max(0);
                    (i <= last).then_some(i as usize)
                }
            },
            rows,
        );
    }

    /// Row `y` of slice `z` of the set; none outside it.
    #[inline(always)]
    fn row(&self, y: i64, z: usize, w: usize) -> Option<&[u64]> {
        let [_, ny, nz] = self.set.dims();
        let y = usize::try_from(y).ok().filter(|y| *y < ny && z < nz)?;
        self.set.row(y, z).get(..w)
    }

    /// The rows at `y` of a section's slices, dilated by a stack of chords: all slices take each
    /// step together. Says whether anything is in them.
    #[inline(always)]
    fn stack_rows<const W: usize>(
        &self,
        s: &Section,
        steps: &[Step],
        centre: i64,
        y: i64,
        gathered: &mut Panel,
        out: &mut [u64],
    ) -> bool {
        let w = if W == 0 { self.set.words_per_row() } else { W };
        gathered.clear(s.rows_in.len(), w);
        let mut any = 0;
        let slice = self.set.dims()[1] * w;
        let words = self.set.words();
        let slices = &words[s.rows_in.start * slice..s.rows_in.end * slice];
        for step in steps {
            for dy in &step.dys {
                let from = match usize::try_from(y - dy) {
                    Ok(from) if from * w < slice => from * w,
                    _ => continue,
                };
                let rows = gathered.rows_mut().chunks_exact_mut(w);
                for (here, layer) in rows.zip(slices.chunks_exact(slice)) {
                    or(&mut here[..w], &layer[from..][..w]);
                }
            }
            if any == 0 {
                any = gathered.rows_mut().iter().fold(0, |a, word| a | word);
            }
            if any != 0 {
                gathered.widen(step.left, step.right);
            }
        }
        if any == 0 {
            return false;
        }
        if centre == 0 {
            out.copy_from_slice(gathered.rows_mut());
        } else {
            let rows = gathered.rows_mut().chunks_exact(w);
            out.chunks_exact_mut(w).zip(rows).for_each(|(o, r)| or_shifted(o, r, centre));
        }
        true
    }

    /// The same by a cross-section that is no stack, chord by chord.
    fn free_rows(&self, s: &Section, chords: &[Chord], y: i64, out: &mut [u64]) -> bool {
        let w = self.set.words_per_row();
        let (mut wide, mut room) = (vec![0u64; w], vec![0u64; w]);
        for (z, out) in s.rows_in.clone().zip(out.chunks_exact_mut(w)) {
            for c in chords {
                let Some(r) = self.row(y - c.y, z, w) else { continue };
                wide.fill(0);
                or_shifted(&mut wide, r, c.x);
                widen(&mut wide, &mut room, 0, (c.len - 1) as u32);
                or(out, &wide);
            }
        }
        out.iter().any(|word| *word != 0)
    }
}
