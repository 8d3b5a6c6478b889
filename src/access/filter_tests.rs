use super::*;
use proptest::prelude::*;

fn naive(op: Op, image: &Image, at: (isize, isize), c: (usize, usize), k: &Naive) -> f32 {
    let height = (image.cells.len() / image.width) as isize;
    let mut best = if op == Op::Max { f32::NEG_INFINITY } else { f32::INFINITY };
    for &(i, j, value) in k {
        let x = at.0 + c.0 as isize + i;
        let y = at.1 + c.1 as isize + j;
        if (0..image.width as isize).contains(&x) && (0..height).contains(&y) {
            let h = image.cells[(x + y * image.width as isize) as usize] + value;
            best = if op == Op::Max { best.max(h) } else { best.min(h) };
        }
    }
    best
}

type Naive = Vec<(isize, isize, f32)>;

proptest! {
    #[test]
    fn equals_the_definition(
        width in 1usize..50, height in 1usize..20, out_width in 1usize..60,
        out_height in 1usize..12, at in (-30isize..30, -12isize..12), reach in 0usize..14,
        stride in 1usize..3, flat in 0f64..14.0, seed in any::<u64>(), max in any::<bool>(),
    ) {
        let mut state = seed;
        let mut next = || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            ((state >> 33) % 1000) as f32 / 8.0
        };
        let cells: Vec<f32> = (0..width * height).map(|_| next()).collect();
        let mask: Vec<bool> = (0..out_width * out_height).map(|_| next() < 8.0).collect();
        let image = Image { width, cells: &cells };
        let value = |d: f64| {
            (d <= reach as f64).then_some(if d <= flat { 2.0 } else { d as f32 })
        };
        let mut all = Naive::new();
        let r = reach as isize;
        for j in (-r..=r).filter(|j| j.unsigned_abs() % stride == 0) {
            for i in (-r..=r).filter(|i| i.unsigned_abs() % stride == 0) {
                if let Some(v) = value(((i * i + j * j) as f64).sqrt()) {
                    all.push((i, j, v));
                }
            }
        }
        let op = if max { Op::Max } else { Op::Min };
        let none = if max { f32::NEG_INFINITY } else { f32::INFINITY };
        let spans = Spans::of(&mask, out_width);
        let mut out = vec![none; out_width * out_height];
        let kernel = Kernel::of(reach, stride, value);
        filter(op, &image, at, out_width, &mut out, &spans, &kernel);
        for c in (0..out.len()).filter(|c| mask[*c]) {
            let place = (c % out_width, c / out_width);
            prop_assert_eq!(out[c], naive(op, &image, at, place, &all), "{:?}", place);
        }
    }
}

proptest! {
    /// Images of plateaus and ramps, and cells that hold something before.
    #[test]
    fn blocks_settled_by_bounds_have_the_values_of_the_definition(
        width in 40usize..150, height in 10usize..40, at in (-9isize..9, -9isize..9),
        reach in 0usize..8, flat in 0f64..8.0, held in -40f32..40.0, bumps in 0usize..6,
        slope in 0usize..2, seed in any::<u64>(), max in any::<bool>(),
    ) {
        let mut cells: Vec<f32> =
            (0..width * height).map(|c| (slope * (c % width / 20)) as f32).collect();
        for i in 0..bumps {
            let c = (seed >> (8 * i)) as usize % cells.len() * 37 % cells.len();
            cells[c] = if i % 2 == 0 { 25.0 } else { -25.0 };
        }
        let image = Image { width, cells: &cells };
        let (op, sign) = if max { (Op::Max, -1.0) } else { (Op::Min, 1.0) };
        let value = |d: f64| {
            (d <= reach as f64).then_some(sign * if d <= flat { 2.5 } else { d as f32 })
        };
        let mut all = Naive::new();
        let r = reach as isize;
        for (i, j) in (-r..=r).flat_map(|j| (-r..=r).map(move |i| (i, j))) {
            if let Some(v) = value(((i * i + j * j) as f64).sqrt()) {
                all.push((i, j, v));
            }
        }
        let spans = Spans::all(width, height);
        let mut out = vec![held; width * height];
        filter(op, &image, at, width, &mut out, &spans, &Kernel::of(reach, 1, value));
        for (c, found) in out.iter().enumerate() {
            let by = naive(op, &image, at, (c % width, c / width), &all);
            prop_assert_eq!(*found, if max { by.max(held) } else { by.min(held) }, "{}", c);
        }
    }
}

#[test]
fn grown_spans_hold_every_cell_within_reach() {
    let mut mask = vec![false; 40 * 9];
    mask[3 + 40 * 4] = true;
    mask[39 + 40 * 8] = true;
    let grown = Spans::of(&mask, 40).grown(2, 40);
    let rows: Vec<_> = grown.rows().cloned().collect();
    assert!(rows[1].is_empty());
    assert_eq!(rows[2], vec![1usize..6; 1]);
    assert_eq!(rows[6], [1..6, 37..40]);
    assert_eq!(rows[8], vec![37usize..40; 1]);
}
