//! Under-fill and over-fill (HB Sec. 4.2, Alg. 8, 9), layer by layer.
//!
//! | symbol | here |
//! |---|---|
//! | A(P_i, H) | `open`: where the nozzle stands clear of P_i, and nothing of P_i lies over it |
//! | A* (Eq. 31) | [`stacked`] of everything in A |
//! | UF (Eq. 34) | [`under_fill`]: what stands, layer on layer, of P ∩ A on P_i or on the plate |
//! | OF (Eq. 36) | [`over_fill`]: P ∩ A* and the support below it |
//!
//! With columns alone this is the paper's: a voxel over V(P_i) is laid when all between it and P_i
//! is. With an overhang a voxel is carried as rule `support` says ([`Carry`]), and support narrows
//! downward as far as that carries it.
//!
//! Guarantees: every voxel laid is clear of P_i and carried by P_i, the plate or what the same
//! action lays; UF adds nothing outside P; OF leaves nothing of P ∩ A* out. Not guaranteed: that
//! support with an overhang is the least there is.

use super::carry::{Across, Carry, moved};
use super::site::Site;
use crate::access::{Scene, nozzle_map, reachable};
use crate::base::Direction;
use crate::machine::Tool;
use crate::morph::complement;
use crate::voxel::BitGrid;

/// A: the free voxels at which the nozzle stands clear of the state, none of it above them.
pub fn open(site: &Site, tool: &Tool, dip_mm: f64) -> BitGrid {
    let frame = &site.view.frame;
    let air = complement(&site.state);
    let scene = Scene::from_above(frame, &site.state, &site.fixed);
    let mut open = reachable(&nozzle_map(&scene, &air, tool, Direction::Z, dip_mm), &air, frame);
    // A nozzle that may dip into its own layer could otherwise fill a gap from above its lid.
    let [_, ny, nz] = open.dims();
    let mut over = vec![0u64; open.words_per_row()];
    for y in 0..ny {
        over.fill(0);
        for z in (0..nz).rev() {
            for ((over, o), s) in over.iter_mut().zip(open.row_mut(y, z)).zip(site.state.row(y, z))
            {
                *o &= !*over;
                *over |= s;
            }
        }
    }
    open
}

/// The largest part of `wanted` that stands, layer on layer, on the state or on the plate.
pub fn stacked(site: &Site, wanted: &BitGrid, carry: &Carry) -> BitGrid {
    let [_, ny, nz] = wanted.dims();
    let words = wanted.words_per_row();
    let mut out = BitGrid::new(wanted.dims());
    let mut below = [vec![0u64; words * ny], vec![0u64; words * ny]];
    for z in 0..nz {
        let (state, mut laid) = (layer(&site.state, z), layer(wanted, z));
        laid.iter_mut().zip(&state).for_each(|(l, s)| *l &= !s);
        if site.view.plate != Some(z) {
            laid = carry.carried(&laid, [&below[0], &below[1]], words);
        }
        put(&mut out, z, &laid);
        below.swap(0, 1);
        below[0] = either(&laid, &state);
    }
    out
}

/// UF: what it adds.
pub fn under_fill(site: &Site, open: &BitGrid, carry: &Carry) -> BitGrid {
    stacked(site, &open.and(&site.view.target), carry)
}

/// OF: what it adds.
pub fn over_fill(site: &Site, open: &BitGrid, carry: &Carry) -> BitGrid {
    let standing = stacked(site, open, carry);
    let mut out = standing.and(&site.view.target);
    let words = out.words_per_row();
    for z in (1..out.dims()[2]).rev() {
        let top = layer(&out, z);
        if site.view.plate == Some(z) || top.iter().all(|l| *l == 0) {
            continue;
        }
        let of = |grid: &BitGrid, down: usize| match z.checked_sub(down) {
            Some(z) => layer(grid, z),
            None => vec![0; top.len()],
        };
        let mut below = [1, 2].map(|down| {
            let laid = of(&out, down);
            let solid = either(&laid, &of(&site.state, down));
            Below { may: of(&standing, down), solid, laid }
        });
        hold(&top, &mut below, carry, words);
        for (down, below) in (1..=z.min(2)).zip(&below) {
            put(&mut out, z - down, &below.laid);
        }
    }
    out
}

/// A layer below the one that is to be held.
struct Below {
    /// What the fill may lay, what it lays, and that with what is there.
    may: Vec<u64>,
    laid: Vec<u64>,
    solid: Vec<u64>,
}

impl Below {
    /// Lays bits of a word.
    fn lay(&mut self, i: usize, bits: u64) {
        self.laid[i] |= bits;
        self.solid[i] |= bits;
    }
}

/// Lays in the two layers below, the next first, what holds a layer: as little of it as it takes.
fn hold(top: &[u64], below: &mut [Below; 2], carry: &Carry, words: usize) {
    let uncarried = |below: &[Below; 2]| -> Vec<u64> {
        let carried = carry.carried(top, [&below[0].solid, &below[1].solid], words);
        top.iter().zip(&carried).map(|(t, c)| t & !c).collect()
    };
    let left = uncarried(below);
    if left.iter().all(|l| *l == 0) {
        return;
    }
    // The inner part of what is open carries its rim.
    for (i, inner) in carry.inner(&left, words).into_iter().enumerate() {
        let bits = inner & below[0].may[i];
        below[0].lay(i, bits);
    }
    let left = uncarried(below);
    // What will be the inner part of that, a layer further down.
    let inner = carry.inner(&below[0].solid, words);
    for (i, mut bits) in left.into_iter().enumerate() {
        while bits != 0 {
            let x = Voxel { i, bit: bits.trailing_zeros(), words };
            bits &= bits - 1;
            x.hold(below, &inner, carry);
        }
    }
}

/// A voxel of a layer of rows of `words`.
#[derive(Clone, Copy)]
struct Voxel {
    i: usize,
    bit: u32,
    words: usize,
}

impl Voxel {
    fn is_in(self, layer: &[u64], at: Across) -> bool {
        moved(layer, self.words, self.i, at) >> self.bit & 1 == 1
    }

    fn lay(self, below: &mut Below, (dx, dy): Across) {
        let x = (self.i % self.words * 64) as i64 + i64::from(self.bit) + dx;
        let row = (self.i / self.words) as i64 + dy;
        below.lay(row as usize * self.words + x as usize / 64, 1 << (x % 64));
    }

    /// Gives the voxel a carrier where it has none.
    fn hold(self, [next, second]: &mut [Below; 2], inner: &[u64], carry: &Carry) {
        let direct = &carry.direct;
        let chains = || carry.chains.iter().flat_map(|(a, all)| all.iter().map(move |b| (*a, *b)));
        let stands =
            |a: Across, b: Across| self.is_in(&next.solid, a) && self.is_in(&second.solid, b);
        if direct.iter().any(|a| self.is_in(&next.solid, *a)) || chains().any(|(a, b)| stands(a, b))
        {
            return;
        }
        // A corner leans on the rim and on what the inner part of that will be.
        let leans = |(a, b): &(Across, Across)| {
            self.is_in(&next.solid, *a) && self.is_in(inner, *b) && self.is_in(&second.may, *b)
        };
        if let Some((_, b)) = chains().find(leans) {
            return self.lay(second, b);
        }
        // What is too small to lean stands beside what is laid or, where that may not be, straight
        // or aside,
        let beside = |a: &&Across| {
            let around = |b: &Across| self.is_in(&next.solid, (a.0 + b.0, a.1 + b.1));
            self.is_in(&next.may, **a) && direct[1..].iter().any(around)
        };
        let may = |a: &&Across| self.is_in(&next.may, **a);
        let aside = direct.get(1..).unwrap_or(&[]).iter();
        if let Some(a) = aside.clone().find(beside).or_else(|| direct.iter().find(may)) {
            return self.lay(next, *a);
        }
        // and the rest as A* does.
        let both = |(a, b): &(Across, Across)| {
            (self.is_in(&next.may, *a) || self.is_in(&next.solid, *a))
                && (self.is_in(&second.may, *b) || self.is_in(&second.solid, *b))
        };
        if let Some((a, b)) = chains().find(both) {
            for (below, at) in [(next, a), (second, b)] {
                if self.is_in(&below.may, at) {
                    self.lay(below, at);
                }
            }
        }
    }
}

fn layer(grid: &BitGrid, z: usize) -> Vec<u64> {
    (0..grid.dims()[1]).flat_map(|y| grid.row(y, z).iter().copied()).collect()
}

fn put(grid: &mut BitGrid, z: usize, layer: &[u64]) {
    for (y, row) in layer.chunks_exact(grid.words_per_row()).enumerate() {
        grid.row_mut(y, z).copy_from_slice(row);
    }
}

fn either(one: &[u64], other: &[u64]) -> Vec<u64> {
    one.iter().zip(other).map(|(a, b)| a | b).collect()
}
