//! Face passes: straight rows over what is flat and square to the axis.
//!
//! Method: cells whose lowest tips lie at one height and touch each other are a face; it is cut in
//! rows along its longer side, to and fro, and its rim afterwards. Guarantees: every cell of a face is
//! within a row's distance of a row or on one. Not guaranteed: climb milling on every second row;
//! the rim is climbed.

use super::image::{Cell, Lattice};

/// Neighbouring heights that differ by less lie in one face, mm: above the rounding of drop-cutter
/// heights, far below a slope that a scallop would show.
const LEVEL_MM: f32 = 2e-3;

/// Faces among the cells of `set`, of at least `least` cells each, in scan order.
pub(super) fn faces(
    lattice: &Lattice,
    bottom: &[f32],
    set: &[bool],
    least: usize,
) -> Vec<Vec<usize>> {
    let [nx, ny] = lattice.n;
    let mut seen: Vec<bool> = set.iter().map(|s| !s).collect();
    let mut out = Vec::new();
    for start in 0..seen.len() {
        if seen[start] {
            continue;
        }
        seen[start] = true;
        let (mut face, mut at) = (vec![start], 0);
        while at < face.len() {
            let k = face[at];
            at += 1;
            let [i, j] = lattice.cell_of_index(k);
            let around = [
                (i > 0).then(|| k - 1),
                (i + 1 < nx).then(|| k + 1),
                (j > 0).then(|| k - nx),
                (j + 1 < ny).then(|| k + nx),
            ];
            for n in around.into_iter().flatten() {
                if !seen[n] && (bottom[n] - bottom[start]).abs() < LEVEL_MM {
                    seen[n] = true;
                    face.push(n);
                }
            }
        }
        if face.len() >= least {
            face.sort_unstable();
            out.push(face);
        }
    }
    out
}

/// Rows over a face's cells, `step` cells apart, every second one turned round.
pub(super) fn rows(lattice: &Lattice, face: &[usize], step: usize) -> Vec<Vec<Cell>> {
    let cells = || face.iter().map(|k| lattice.cell_of_index(*k));
    let extent = |a: usize| {
        let (low, high) = cells().fold((usize::MAX, 0), |(l, h), c| (l.min(c[a]), h.max(c[a])));
        high.saturating_sub(low)
    };
    let along = if extent(0) >= extent(1) { 0 } else { 1 };
    let mut order: Vec<(usize, usize)> = cells().map(|c| (c[1 - along], c[along])).collect();
    order.sort_unstable();
    let Some(first) = order.first().map(|c| c.0) else { return Vec::new() };
    let last = order[order.len() - 1].0;
    let mut out: Vec<Vec<Cell>> = Vec::new();
    let mut before: Option<(usize, usize)> = None;
    for (row, at) in order {
        // The last row too, however near it is.
        if !(row - first).is_multiple_of(step.max(1)) && row != last {
            continue;
        }
        let cell = if along == 0 { [at, row] } else { [row, at] };
        match out.last_mut() {
            Some(run) if before == Some((row, at.wrapping_sub(1))) => run.push(cell),
            _ => out.push(vec![cell]),
        }
        before = Some((row, at));
    }
    let (mut row, mut back) = (first, false);
    for run in &mut out {
        if run[0][1 - along] != row {
            (row, back) = (run[0][1 - along], !back);
        }
        if back {
            run.reverse();
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::{DVec2, DVec3, Direction};
    use crate::voxel::Frame;

    fn lattice(n: [usize; 2]) -> Lattice {
        let frame = Frame { pitch: 1.0, dims: [1; 3], origin: DVec3::ZERO };
        let mut l =
            Lattice::over(&frame, Direction::Z.image_plane(), 1.0, DVec2::ZERO, DVec2::ZERO);
        l.n = n;
        l
    }

    #[test]
    fn faces_are_told_apart_and_covered_by_rows() {
        let l = lattice([30, 20]);
        // Two floors of different height, a slope, and a speck.
        let height = |c: Cell| match c[0] {
            0..10 => 1.0,
            10..20 => 2.0,
            _ => 2.0 + c[0] as f32,
        };
        let bottom: Vec<f32> = (0..l.cells()).map(|k| height(l.cell_of_index(k))).collect();
        let set: Vec<bool> = (0..l.cells()).map(|k| l.cell_of_index(k)[1] > 2).collect();
        let found = faces(&l, &bottom, &set, 30);
        assert_eq!(found.iter().map(Vec::len).collect::<Vec<_>>(), [170, 170]);
        for step in [1, 3, 4] {
            let made = rows(&l, &found[1], step);
            for k in &found[1] {
                let [i, j] = l.cell_of_index(*k);
                let near = made.iter().flatten().any(|c| c[1] == j && c[0].abs_diff(i) < step);
                assert!(near, "{i} {j}");
            }
            for w in made.iter().flat_map(|r| r.windows(2)) {
                assert_eq!(w[0][1].abs_diff(w[1][1]) + w[0][0].abs_diff(w[1][0]), 1);
            }
            // To and fro: the next row begins beside the end of the last.
            for pair in made.windows(2) {
                assert_eq!(pair[0][pair[0].len() - 1][1], pair[1][0][1], "{step}");
            }
        }
    }

    #[test]
    fn a_hole_cuts_a_row_in_two() {
        let l = lattice([12, 5]);
        let set: Vec<bool> = (0..60).map(|k| !(k == 26 || k == 27)).collect();
        let found = faces(&l, &[0.0; 60], &set, 1);
        let made = rows(&l, &found[0], 1);
        assert_eq!((found.len(), made.len()), (1, 6));
        assert_eq!(made.iter().map(Vec::len).sum::<usize>(), 58);
    }
}
