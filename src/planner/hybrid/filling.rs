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
//! is. With an overhang of 45° a voxel is carried by the one below it or one of that one's four
//! neighbours, and support narrows downward as far as that carries it.
//!
//! Guarantees: every voxel laid is clear of P_i and carried by P_i, the plate or what the same
//! action lays; UF adds nothing outside P; OF leaves nothing of P ∩ A* out. Not guaranteed: that
//! support with an overhang is the least there is.

use super::site::Site;
use crate::access::{Scene, nozzle_map, reachable};
use crate::base::Direction;
use crate::machine::Tool;
use crate::morph::complement;
use crate::voxel::BitGrid;

/// How a layer carries the next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Carry {
    /// What lies straight above (HB Sec. 3.4).
    Column,
    /// That and its four neighbours: overhangs up to 45°.
    Cone,
}

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
pub fn stacked(site: &Site, wanted: &BitGrid, carry: Carry) -> BitGrid {
    let [_, ny, nz] = wanted.dims();
    let words = wanted.words_per_row();
    let mut out = BitGrid::new(wanted.dims());
    let mut solid = vec![0u64; words * ny];
    let mut carried = vec![0u64; words * ny];
    for z in 0..nz {
        match site.view.plate {
            Some(plate) if plate == z => carried.fill(!0),
            _ => spread(&solid, &mut carried, words, carry),
        }
        for y in 0..ny {
            let row = y * words..(y + 1) * words;
            let (state, want) = (site.state.row(y, z), wanted.row(y, z));
            let laid = out.row_mut(y, z);
            for (i, at) in row.enumerate() {
                laid[i] = want[i] & carried[at] & !state[i];
                solid[at] = laid[i] | state[i];
            }
        }
    }
    out
}

/// UF: what it adds.
pub fn under_fill(site: &Site, open: &BitGrid, carry: Carry) -> BitGrid {
    stacked(site, &open.and(&site.view.target), carry)
}

/// OF: what it adds.
pub fn over_fill(site: &Site, open: &BitGrid, carry: Carry) -> BitGrid {
    let standing = stacked(site, open, carry);
    let mut out = standing.and(&site.view.target);
    let [_, ny, nz] = out.dims();
    let words = out.words_per_row();
    let layer = |grid: &BitGrid, z: usize| -> Vec<u64> {
        (0..ny).flat_map(|y| grid.row(y, z).iter().copied()).collect()
    };
    let mut carried = vec![0u64; words * ny];
    for z in (1..nz).rev() {
        if site.view.plate == Some(z) {
            continue;
        }
        let mut below = layer(&out, z - 1);
        let state = layer(&site.state, z - 1);
        let may = layer(&standing, z - 1);
        let mut left = layer(&out, z);
        let mut settle = |left: &mut [u64], below: &[u64]| {
            let solid: Vec<u64> = below.iter().zip(&state).map(|(b, s)| b | s).collect();
            spread(&solid, &mut carried, words, carry);
            left.iter_mut().zip(&carried).for_each(|(l, c)| *l &= !c);
            left.iter().any(|l| *l != 0)
        };
        if !settle(&mut left, &below) {
            continue;
        }
        if carry == Carry::Cone {
            // The inner part of what is open carries its rim.
            let inner = shrunk(&left, words);
            below.iter_mut().zip(&inner).zip(&may).for_each(|((b, i), m)| *b |= i & m);
            settle(&mut left, &below);
        }
        below.iter_mut().zip(&left).zip(&may).for_each(|((b, l), m)| *b |= l & m);
        if settle(&mut left, &below) {
            // Nothing may lie straight below, but beside it.
            let mut near = vec![0u64; left.len()];
            spread(&left, &mut near, words, carry);
            below.iter_mut().zip(&near).zip(&may).for_each(|((b, n), m)| *b |= n & m);
        }
        for y in 0..ny {
            out.row_mut(y, z - 1).copy_from_slice(&below[y * words..(y + 1) * words]);
        }
    }
    out
}

/// What a layer, rows of `words`, carries. Bits past the end of a row may be set.
fn spread(layer: &[u64], out: &mut [u64], words: usize, carry: Carry) {
    out.copy_from_slice(layer);
    if carry == Carry::Column {
        return;
    }
    let n = layer.len();
    for i in 0..n {
        let at = i % words;
        let mut bits = layer[i] << 1 | layer[i] >> 1;
        if at > 0 {
            bits |= layer[i - 1] >> 63;
        }
        if at + 1 < words {
            bits |= layer[i + 1] << 63;
        }
        if i >= words {
            bits |= layer[i - words];
        }
        if i + words < n {
            bits |= layer[i + words];
        }
        out[i] |= bits;
    }
}

/// The voxels of a layer whose four neighbours are in it.
fn shrunk(layer: &[u64], words: usize) -> Vec<u64> {
    let n = layer.len();
    let get = |i: Option<usize>| i.and_then(|i| layer.get(i)).copied().unwrap_or(0);
    (0..n)
        .map(|i| {
            let at = i % words;
            let left = layer[i] << 1 | if at > 0 { layer[i - 1] >> 63 } else { 0 };
            let right = layer[i] >> 1 | if at + 1 < words { layer[i + 1] << 63 } else { 0 };
            layer[i] & left & right & get(i.checked_sub(words)) & get(Some(i + words))
        })
        .collect()
}
