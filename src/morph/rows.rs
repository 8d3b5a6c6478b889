//! Operations on rows of bits.
//!
//! All are inlined into callers that know the number of words, so that a row stays in registers.

/// dst |= src.
#[inline(always)]
pub fn or(dst: &mut [u64], src: &[u64]) {
    for (d, s) in dst.iter_mut().zip(src) {
        *d |= s;
    }
}

/// Word `i` of the row moved `n` bits up, 0 < n < 64.
#[inline(always)]
fn up(a: &[u64], i: usize, n: u32) -> u64 {
    a[i] << n | if i > 0 { a[i - 1] >> (64 - n) } else { 0 }
}

/// Word `i` of the row moved `n` bits down, 0 < n < 64.
#[inline(always)]
fn down(a: &[u64], i: usize, n: u32) -> u64 {
    a[i] >> n | if i + 1 < a.len() { a[i + 1] << (64 - n) } else { 0 }
}

/// Every bit b becomes b − left ..= b + right. `old` is room for a copy of the row.
#[inline(always)]
pub fn widen(a: &mut [u64], old: &mut [u64], left: u32, right: u32) {
    // Bits that leave the row are lost and must not be needed again, so a step is never longer
    // than the run on its own side.
    let both = left.min(right);
    let mut reached = 0;
    while reached < both {
        let n = (reached + 1).min(both - reached).min(63);
        old.copy_from_slice(a);
        for (i, word) in a.iter_mut().enumerate() {
            *word |= up(old, i, n) | down(old, i, n);
        }
        reached += n;
    }
    for (side, downward) in [(left, true), (right, false)] {
        let mut reached = both;
        while reached < side {
            let n = (reached + 1).min(side - reached).min(63);
            old.copy_from_slice(a);
            for (i, word) in a.iter_mut().enumerate() {
                *word |= if downward { down(old, i, n) } else { up(old, i, n) };
            }
            reached += n;
        }
    }
}

/// Rows of one length, one after the other, that are widened together.
#[derive(Default)]
pub struct Panel {
    /// The rows between a word of zeros before and behind.
    words: Vec<u64>,
    other: Vec<u64>,
    /// Per word: all ones but at the first, and at the last, of a row.
    inner: [Vec<u64>; 2],
    width: usize,
}

impl Panel {
    /// `n` empty rows of `w` words.
    pub fn clear(&mut self, n: usize, w: usize) {
        self.words.clear();
        self.words.resize(n * w + 2, 0);
        self.other.resize(n * w + 2, 0);
        // The guards; what lies between is written before it is read.
        self.other[0] = 0;
        self.other[n * w + 1] = 0;
        if self.width != w || self.inner[0].len() != n * w {
            self.width = w;
            for (end, inner) in [0, w.saturating_sub(1)].into_iter().zip(&mut self.inner) {
                inner.clear();
                inner.extend((0..n * w).map(|i| if i % w == end { 0 } else { !0u64 }));
            }
        }
    }

    pub fn rows_mut(&mut self) -> &mut [u64] {
        let n = self.words.len().saturating_sub(2);
        &mut self.words[1..][..n]
    }

    /// [`widen`] of every row.
    pub fn widen(&mut self, left: u32, right: u32) {
        let both = left.min(right);
        let mut reached = 0;
        while reached < both {
            let n = (reached + 1).min(both - reached).min(63);
            self.step(n, |c, up, down| c | up | down);
            reached += n;
        }
        for (side, downward) in [(left, true), (right, false)] {
            let mut reached = both;
            while reached < side {
                let n = (reached + 1).min(side - reached).min(63);
                if downward {
                    self.step(n, |c, _, down| c | down);
                } else {
                    self.step(n, |c, up, _| c | up);
                }
                reached += n;
            }
        }
    }

    /// Every word becomes `of` itself and the row moved `n` bits up and down, 0 < n < 64.
    #[inline(always)]
    fn step(&mut self, n: u32, of: impl Fn(u64, u64, u64) -> u64) {
        let len = self.inner[0].len();
        let (before, here, behind) =
            (&self.words[..len], &self.words[1..][..len], &self.words[2..][..len]);
        let [not_first, not_last] = [&self.inner[0][..len], &self.inner[1][..len]];
        let out = &mut self.other[1..][..len];
        for i in 0..len {
            let up = here[i] << n | (before[i] >> (64 - n) & not_first[i]);
            let down = here[i] >> n | (behind[i] << (64 - n) & not_last[i]);
            out[i] = of(here[i], up, down);
        }
        std::mem::swap(&mut self.words, &mut self.other);
    }
}

/// dst |= src moved `by` bits up (down when negative); bits that leave dst are lost.
pub fn or_shifted(dst: &mut [u64], src: &[u64], by: i64) {
    let (words, bits) = (by.div_euclid(64), by.rem_euclid(64) as u32);
    for (i, &s) in src.iter().enumerate() {
        if s == 0 {
            continue;
        }
        let at = i as i64 + words;
        if let Some(d) = usize::try_from(at).ok().and_then(|at| dst.get_mut(at)) {
            *d |= s << bits;
        }
        if bits > 0
            && let Some(d) = usize::try_from(at + 1).ok().and_then(|at| dst.get_mut(at))
        {
            *d |= s >> (64 - bits);
        }
    }
}

/// a[i] becomes a[i] | … | a[i + length − 1] over rows of `w` words; rows past the end are empty.
#[inline(always)]
pub fn run_ahead(a: &mut [u64], w: usize, length: usize) {
    let mut covered = 1;
    while covered < length {
        let step = covered.min(length - covered) * w;
        let mut rest = &mut a[..];
        while rest.len() > step {
            let (here, ahead) = rest.split_at_mut(step);
            or(here, ahead);
            rest = ahead;
        }
        covered += step / w;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn bits(a: &[u64]) -> Vec<i64> {
        (0..a.len() as i64 * 64).filter(|b| a[*b as usize / 64] >> (b % 64) & 1 == 1).collect()
    }

    proptest! {
        #[test]
        fn rows_widen_and_shift_bit_by_bit(
            set in proptest::collection::vec(0i64..256, 0..9), left in 0u32..150,
            right in 0u32..150, by in -300i64..300,
        ) {
            let mut row = vec![0u64; 4];
            set.iter().for_each(|b| row[*b as usize / 64] |= 1 << (b % 64));
            let mut moved = vec![0u64; 4];
            or_shifted(&mut moved, &row, by);
            let expected: Vec<i64> =
                bits(&row).iter().map(|b| b + by).filter(|b| (0..256).contains(b)).collect();
            prop_assert_eq!(bits(&moved), expected);
            let near = |b: i64| {
                bits(&row).iter().any(|s| b >= s - i64::from(left) && b <= s + i64::from(right))
            };
            let expected: Vec<i64> = (0..256).filter(|b| near(*b)).collect();
            let mut wide = row.clone();
            widen(&mut wide, &mut [0; 4], left, right);
            prop_assert_eq!(bits(&wide), expected);
            // The same row between full ones, which must not spill into it.
            let mut panel = Panel::default();
            panel.clear(3, 4);
            panel.rows_mut().fill(!0);
            panel.rows_mut()[4..8].copy_from_slice(&row);
            panel.widen(left, right);
            prop_assert_eq!(&panel.rows_mut()[4..8], &wide[..]);
        }

        #[test]
        fn runs_ahead_gather_the_rows_they_cover(
            rows in proptest::collection::vec(0u64..4, 1..40), length in 1usize..50,
        ) {
            let mut a: Vec<u64> = rows.iter().flat_map(|r| [*r, r * 3]).collect();
            run_ahead(&mut a, 2, length);
            for i in 0..rows.len() {
                let of = &rows[i..(i + length).min(rows.len())];
                prop_assert_eq!(a[2 * i], of.iter().fold(0, |x, y| x | y));
                prop_assert_eq!(a[2 * i + 1], of.iter().fold(0, |x, y| x | (y * 3)));
            }
        }
    }
}
