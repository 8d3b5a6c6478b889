use rayon::prelude::*;
use std::borrow::Cow;

/// A set of voxels: one bit each, rows of u64 words along x, rows ordered by y, then z.
///
/// A grid made by [`BitGrid::with_rows`] stores some consecutive rows alone, the others being
/// empty, and asks time and memory for those only; written to elsewhere it stores all.
#[derive(Clone)]
pub struct BitGrid {
    dims: [usize; 3],
    words_per_row: usize,
    /// Place in the whole grid of the first word stored.
    first: usize,
    words: Vec<u64>,
}

impl PartialEq for BitGrid {
    fn eq(&self, other: &BitGrid) -> bool {
        // Most grids store all rows.
        if self.dims == other.dims && self.is_whole() && other.is_whole() {
            return self.words == other.words;
        }
        self.dims == other.dims && self.is_subset_of(other) && other.is_subset_of(self)
    }
}

impl Eq for BitGrid {}

/// A row that is not stored; grids with longer rows store all of theirs.
static EMPTY_ROW: [u64; 1024] = [0; 1024];

impl std::fmt::Debug for BitGrid {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [x, y, z] = self.dims;
        write!(f, "BitGrid {x}×{y}×{z}, {} solid", self.count())
    }
}

/// Words per parallel task: 256 KiB, about a core's second-level cache.
const CHUNK: usize = 32 * 1024;

impl BitGrid {
    /// An empty grid.
    pub fn new(dims: [usize; 3]) -> Self {
        let words_per_row = dims[0].div_ceil(64);
        BitGrid { dims, words_per_row, first: 0, words: vec![0; words_per_row * dims[1] * dims[2]] }
    }

    /// An empty grid that stores only these rows, counted y + ny z.
    pub fn with_rows(dims: [usize; 3], rows: std::ops::Range<usize>) -> Self {
        let words_per_row = dims[0].div_ceil(64);
        let rows = if words_per_row > EMPTY_ROW.len() { 0..dims[1] * dims[2] } else { rows };
        let end = rows.end.min(dims[1] * dims[2]);
        let words = vec![0; words_per_row * end.saturating_sub(rows.start)];
        BitGrid { dims, words_per_row, first: words_per_row * rows.start.min(end), words }
    }

    /// The rows that are stored, counted y + ny z; all others are empty.
    pub fn stored_rows(&self) -> std::ops::Range<usize> {
        let w = self.words_per_row.max(1);
        self.first / w..(self.first + self.words.len()) / w
    }

    /// Whether all rows are stored.
    pub(crate) fn is_whole(&self) -> bool {
        self.words.len() == self.words_per_row * self.dims[1] * self.dims[2]
    }

    /// Stores all rows from now on.
    fn make_whole(&mut self) {
        if !self.is_whole() {
            let mut whole = BitGrid::new(self.dims);
            whole.words[self.first..self.first + self.words.len()].copy_from_slice(&self.words);
            *self = whole;
        }
    }

    /// A grid that is solid where `f(x, y, z)` holds.
    pub fn from_fn(dims: [usize; 3], f: impl Fn([usize; 3]) -> bool + Sync) -> Self {
        let mut g = BitGrid::new(dims);
        g.par_rows_mut().for_each(|(y, z, row)| {
            for x in 0..dims[0] {
                if f([x, y, z]) {
                    row[x / 64] |= 1 << (x % 64);
                }
            }
        });
        g
    }

    pub fn dims(&self) -> [usize; 3] {
        self.dims
    }

    /// Words a row takes; the bits past `dims[0]` are zero.
    pub fn words_per_row(&self) -> usize {
        self.words_per_row
    }

    /// All words, copied when the grid stores some rows alone.
    pub fn words(&self) -> Cow<'_, [u64]> {
        if self.is_whole() {
            return Cow::Borrowed(&self.words);
        }
        let mut whole = self.clone();
        whole.make_whole();
        Cow::Owned(whole.words)
    }

    /// Valid bits of the last word of a row.
    pub fn last_word_mask(&self) -> u64 {
        match self.dims[0] % 64 {
            0 => !0,
            n => (1 << n) - 1,
        }
    }

    fn row_start(&self, y: usize, z: usize) -> usize {
        debug_assert!(y < self.dims[1] && z < self.dims[2]);
        (y + self.dims[1] * z) * self.words_per_row
    }

    /// Where a word is stored, which it is from now on.
    fn stored(&mut self, word: usize) -> usize {
        if word < self.first || word - self.first >= self.words.len() {
            self.make_whole();
        }
        word - self.first
    }

    pub fn row(&self, y: usize, z: usize) -> &[u64] {
        let s = self.row_start(y, z).wrapping_sub(self.first);
        match self.words.get(s..s.wrapping_add(self.words_per_row)) {
            Some(row) => row,
            None => &EMPTY_ROW[..self.words_per_row],
        }
    }

    /// A row to write to; the caller keeps the bits past `dims[0]` zero.
    pub fn row_mut(&mut self, y: usize, z: usize) -> &mut [u64] {
        let s = self.stored(self.row_start(y, z));
        &mut self.words[s..s + self.words_per_row]
    }

    /// All rows with their (y, z), in parallel; the bits past `dims[0]` must stay zero.
    pub fn par_rows_mut(
        &mut self,
    ) -> impl IndexedParallelIterator<Item = (usize, usize, &mut [u64])> {
        self.make_whole();
        let ny = self.dims[1];
        // A grid with an empty axis has no rows; chunks of at least one word keep rayon content.
        self.words
            .par_chunks_mut(self.words_per_row.max(1))
            .with_min_len(16)
            .enumerate()
            .map(move |(r, row)| (r % ny, r / ny, row))
    }

    /// Slabs of up to `slices` slices with their first z, in parallel; the bits past `dims[0]` of
    /// every row must stay zero.
    pub(crate) fn par_slabs_mut(
        &mut self,
        slices: usize,
    ) -> impl IndexedParallelIterator<Item = (usize, &mut [u64])> {
        self.make_whole();
        let words = self.words_per_row * self.dims[1] * slices;
        self.words.par_chunks_mut(words.max(1)).enumerate().map(move |(i, w)| (i * slices, w))
    }

    pub fn get(&self, [x, y, z]: [usize; 3]) -> bool {
        debug_assert!(x < self.dims[0]);
        let word = (self.row_start(y, z) + x / 64).wrapping_sub(self.first);
        self.words.get(word).is_some_and(|w| w >> (x % 64) & 1 == 1)
    }

    /// False outside the grid.
    pub fn get_or_empty(&self, p: [i64; 3]) -> bool {
        let inside = (0..3).all(|a| p[a] >= 0 && p[a] < self.dims[a] as i64);
        inside && self.get(p.map(|c| c as usize))
    }

    /// Which of the 27 places around a voxel, its own among them, are solid: the one at offset (i, j, k) is bit
    /// (i + 1) + 3 (j + 1) + 9 (k + 1). None outside the grid is.
    pub fn around(&self, [x, y, z]: [usize; 3]) -> u32 {
        let (word, bit) = (x / 64, x % 64);
        let mut around = 0;
        for k in 0..3 {
            for j in 0..3 {
                let [y, z] = [(y + j).wrapping_sub(1), (z + k).wrapping_sub(1)];
                if y >= self.dims[1] || z >= self.dims[2] {
                    continue;
                }
                let row = self.row(y, z);
                let three = match bit {
                    0 => row[word] << 1 | word.checked_sub(1).map_or(0, |w| row[w] >> 63),
                    63 => row[word] >> 62 | row.get(word + 1).map_or(0, |w| w << 2),
                    _ => row[word] >> (bit - 1),
                };
                around |= ((three & 7) as u32) << (3 * j + 9 * k);
            }
        }
        around
    }

    pub fn set(&mut self, [x, y, z]: [usize; 3], solid: bool) {
        debug_assert!(x < self.dims[0]);
        let i = self.stored(self.row_start(y, z) + x / 64);
        let bit = 1 << (x % 64);
        if solid { self.words[i] |= bit } else { self.words[i] &= !bit }
    }

    /// Number of solid voxels.
    pub fn count(&self) -> usize {
        self.words
            .par_chunks(CHUNK)
            .map(|c| c.iter().map(|w| w.count_ones() as usize).sum::<usize>())
            .sum()
    }

    pub fn is_empty(&self) -> bool {
        self.words.iter().all(|w| *w == 0)
    }

    /// Applies `f` where both grids store words.
    fn zip_words(&mut self, other: &BitGrid, f: impl Fn(&mut u64, u64) + Sync) {
        assert_eq!(self.dims, other.dims, "grids of one plan share one frame");
        let (own, others) = self.shared(other);
        self.words[own]
            .par_chunks_mut(CHUNK)
            .zip(other.words[others].par_chunks(CHUNK))
            .for_each(|(a, b)| a.iter_mut().zip(b).for_each(|(a, b)| f(a, *b)));
    }

    /// Where the words that both grids store are in either.
    fn shared(&self, other: &BitGrid) -> (std::ops::Range<usize>, std::ops::Range<usize>) {
        let start = self.first.max(other.first);
        let end = (self.first + self.words.len()).min(other.first + other.words.len());
        if start >= end {
            return (0..0, 0..0);
        }
        (start - self.first..end - self.first, start - other.first..end - other.first)
    }

    /// The words that both grids store, in pairs.
    fn pairs<'a>(&'a self, other: &'a BitGrid) -> (&'a [u64], &'a [u64]) {
        assert_eq!(self.dims, other.dims, "grids of one plan share one frame");
        let (own, others) = self.shared(other);
        (&self.words[own], &other.words[others])
    }

    pub fn union_with(&mut self, other: &BitGrid) {
        let (own, _) = self.shared(other);
        if own.len() < other.words.len() {
            self.make_whole();
        }
        self.zip_words(other, |a, b| *a |= b);
    }

    pub fn intersect_with(&mut self, other: &BitGrid) {
        let (own, _) = self.shared(other);
        self.zip_words(other, |a, b| *a &= b);
        self.words[..own.start].fill(0);
        self.words[own.end..].fill(0);
    }

    pub fn subtract(&mut self, other: &BitGrid) {
        self.zip_words(other, |a, b| *a &= !b);
    }

    /// A ∪ B.
    pub fn or(&self, other: &BitGrid) -> BitGrid {
        self.zipped(other, |a, b| a | b).unwrap_or_else(|| {
            let mut g = self.clone();
            g.union_with(other);
            g
        })
    }

    /// A ∩ B.
    pub fn and(&self, other: &BitGrid) -> BitGrid {
        self.zipped(other, |a, b| a & b).unwrap_or_else(|| {
            let mut g = self.clone();
            g.intersect_with(other);
            g
        })
    }

    /// A − B.
    pub fn minus(&self, other: &BitGrid) -> BitGrid {
        self.zipped(other, |a, b| a & !b).unwrap_or_else(|| {
            let mut g = self.clone();
            g.subtract(other);
            g
        })
    }

    /// The grid of `f` of both words, when both store all of theirs: in one pass, without a copy
    /// first.
    fn zipped(&self, other: &BitGrid, f: impl Fn(u64, u64) -> u64 + Sync) -> Option<BitGrid> {
        assert_eq!(self.dims, other.dims, "grids of one plan share one frame");
        if !self.is_whole() || !other.is_whole() {
            return None;
        }
        let mut out = BitGrid::new(self.dims);
        out.words
            .par_chunks_mut(CHUNK)
            .zip(self.words.par_chunks(CHUNK).zip(other.words.par_chunks(CHUNK)))
            .for_each(|(o, (a, b))| {
                o.iter_mut().zip(a.iter().zip(b)).for_each(|(o, (a, b))| *o = f(*a, *b));
            });
        Some(out)
    }

    /// |A ∩ B| without making it.
    pub fn count_and(&self, other: &BitGrid) -> usize {
        let (a, b) = self.pairs(other);
        a.par_chunks(CHUNK)
            .zip(b.par_chunks(CHUNK))
            .map(|(a, b)| {
                a.iter().zip(b).map(|(a, b)| (a & b).count_ones() as usize).sum::<usize>()
            })
            .sum()
    }

    pub fn is_subset_of(&self, other: &BitGrid) -> bool {
        let (own, _) = self.shared(other);
        let (a, b) = self.pairs(other);
        a.iter().zip(b).all(|(a, b)| a & !b == 0)
            && self.words[..own.start].iter().chain(&self.words[own.end..]).all(|w| *w == 0)
    }

    pub fn intersects(&self, other: &BitGrid) -> bool {
        let (a, b) = self.pairs(other);
        a.iter().zip(b).any(|(a, b)| a & b != 0)
    }

    /// Solid voxels in x, y, z order.
    pub fn iter_ones(&self) -> impl Iterator<Item = [usize; 3]> + '_ {
        let (w, ny) = (self.words_per_row.max(1), self.dims[1]);
        let skipped = self.first / w;
        self.words.iter().enumerate().filter(|(_, bits)| **bits != 0).flat_map(move |(i, &bits)| {
            let (r, base) = (skipped + i / w, i % w * 64);
            let mut rest = bits;
            std::iter::from_fn(move || {
                (rest != 0).then(|| {
                    let x = base + rest.trailing_zeros() as usize;
                    rest &= rest - 1;
                    [x, r % ny, r / ny]
                })
            })
        })
    }

    /// Runs of solid voxels as (y, z, x, length), in order.
    pub fn runs(&self) -> impl Iterator<Item = (usize, usize, usize, usize)> + '_ {
        let (nx, ny) = (self.dims[0], self.dims[1]);
        self.stored_rows().map(move |r| (r % ny, r / ny)).flat_map(move |(y, z)| {
            let row = self.row(y, z);
            let mut x = 0;
            std::iter::from_fn(move || {
                let start = next_bit(row, nx, x, true)?;
                let end = next_bit(row, nx, start, false).unwrap_or(nx);
                x = end;
                Some((y, z, start, end - start))
            })
        })
    }

    /// Sets voxels x..x+len of a row.
    pub fn fill_run(&mut self, y: usize, z: usize, x: usize, len: usize) {
        assert!(x + len <= self.dims[0]);
        set_bits(self.row_mut(y, z), x, x + len);
    }

    /// Inclusive box of the solid voxels.
    pub fn extent(&self) -> Option<([usize; 3], [usize; 3])> {
        let (ny, mut all) = (self.dims[1], vec![0u64; self.words_per_row]);
        let mut span: Option<([usize; 2], [usize; 2])> = None;
        for r in self.stored_rows() {
            let (y, z) = (r % ny, r / ny);
            let row = self.row(y, z);
            if row.iter().fold(0, |any, w| any | w) == 0 {
                continue;
            }
            all.iter_mut().zip(row).for_each(|(all, w)| *all |= w);
            span = Some(match span {
                None => ([y, z], [y, z]),
                Some(([a, b], [c, _])) => ([a.min(y), b], [c.max(y), z]),
            });
        }
        let ([y, z], [last_y, last_z]) = span?;
        let (first, last) = (all.iter().position(|w| *w != 0)?, all.iter().rposition(|w| *w != 0)?);
        let x = first * 64 + all[first].trailing_zeros() as usize;
        let last_x = last * 64 + 63 - all[last].leading_zeros() as usize;
        Some(([x, y, z], [last_x, last_y, last_z]))
    }

    /// The voxels that are solid or have a solid face, edge or corner neighbour.
    pub fn grown(&self) -> BitGrid {
        let mut out = BitGrid::new(self.dims);
        let (ny, nz, w) = (self.dims[1], self.dims[2], self.words_per_row);
        let last = self.last_word_mask();
        out.par_rows_mut().for_each(|(y, z, o)| {
            for z in z.saturating_sub(1)..(z + 2).min(nz) {
                for y in y.saturating_sub(1)..(y + 2).min(ny) {
                    let row = self.row(y, z);
                    for i in 0..w {
                        o[i] |= row[i]
                            | row[i] << 1
                            | row[i] >> 1
                            | if i > 0 { row[i - 1] >> 63 } else { 0 }
                            | if i + 1 < w { row[i + 1] << 63 } else { 0 };
                    }
                }
            }
            if let Some(word) = o.last_mut() {
                *word &= last;
            }
        });
        out
    }

    /// Solid voxels with an empty face neighbour (outside the grid counts as empty).
    pub fn boundary(&self) -> BitGrid {
        let mut out = BitGrid::new(self.dims);
        let (ny, nz, w) = (self.dims[1], self.dims[2], self.words_per_row);
        out.par_rows_mut().for_each(|(y, z, o)| {
            let row = self.row(y, z);
            let side = |dy: isize, dz: isize| {
                let (y, z) = (y.checked_add_signed(dy), z.checked_add_signed(dz));
                match (y, z) {
                    (Some(y), Some(z)) if y < ny && z < nz => Some(self.row(y, z)),
                    _ => None,
                }
            };
            let sides = [side(-1, 0), side(1, 0), side(0, -1), side(0, 1)];
            for i in 0..w {
                let mut inner = (row[i] << 1 | if i > 0 { row[i - 1] >> 63 } else { 0 })
                    & (row[i] >> 1 | if i + 1 < w { row[i + 1] << 63 } else { 0 });
                for s in &sides {
                    inner &= s.map_or(0, |s| s[i]);
                }
                o[i] = row[i] & !inner;
            }
        });
        out
    }
}

/// Sets bits from..end of a row.
pub(super) fn set_bits(row: &mut [u64], from: usize, end: usize) {
    let mut at = from;
    while at < end {
        let (w, b) = (at / 64, at % 64);
        let n = (64 - b).min(end - at);
        row[w] |= (if n == 64 { !0 } else { (1u64 << n) - 1 }) << b;
        at += n;
    }
}

fn next_bit(row: &[u64], nx: usize, from: usize, value: bool) -> Option<usize> {
    let mut i = from / 64;
    if from >= nx {
        return None;
    }
    let flip = if value { 0 } else { !0 };
    let mut word = (row[i] ^ flip) & (!0 << (from % 64));
    loop {
        if word != 0 {
            let x = i * 64 + word.trailing_zeros() as usize;
            return (x < nx).then_some(x);
        }
        i += 1;
        if i == row.len() {
            return None;
        }
        word = row[i] ^ flip;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn grid() -> impl Strategy<Value = BitGrid> {
        (1usize..140, 1usize..5, 1usize..4).prop_flat_map(|(x, y, z)| {
            proptest::collection::vec(any::<bool>(), x * y * z).prop_map(move |bits| {
                BitGrid::from_fn([x, y, z], |[i, j, k]| bits[i + x * (j + y * k)])
            })
        })
    }

    proptest! {
        #[test]
        fn what_is_around_a_voxel_is_what_stands_at_each_place(g in grid()) {
            let [nx, ny, nz] = g.dims();
            for i in 0..nx * ny * nz {
                let v = [i % nx, i / nx % ny, i / nx / ny];
                let at = |b: u32| {
                    let o = [b % 3, b / 3 % 3, b / 9];
                    g.get_or_empty(std::array::from_fn(|a| v[a] as i64 + i64::from(o[a]) - 1))
                };
                let want = (0..27).filter(|b| at(*b)).fold(0, |all, b| all | 1 << b);
                prop_assert_eq!(g.around(v), want);
            }
        }

        #[test]
        fn runs_and_ones_tell_the_same_story(g in grid()) {
            let mut again = BitGrid::new(g.dims());
            for (y, z, x, n) in g.runs() {
                again.fill_run(y, z, x, n);
            }
            prop_assert_eq!(&again, &g);
            let mut ones = BitGrid::new(g.dims());
            g.iter_ones().for_each(|v| ones.set(v, true));
            prop_assert_eq!(&ones, &g);
            prop_assert_eq!(g.iter_ones().count(), g.count());
        }

        #[test]
        fn a_grid_of_some_rows_has_the_words_of_the_whole(g in grid()) {
            let first = g.stored_rows().start..g.dims()[1];
            let mut some = BitGrid::with_rows(g.dims(), first);
            let whole = BitGrid::from_fn(g.dims(), |v| v[2] == 0 && g.get(v));
            whole.iter_ones().for_each(|v| some.set(v, true));
            prop_assert_eq!(some.words(), whole.words());
            prop_assert_eq!(&some, &whole);
        }

        #[test]
        fn the_extent_is_that_of_the_voxels(g in grid(), keep in 0usize..1000) {
            let some = BitGrid::from_fn(g.dims(), |v| {
                g.get(v) && (v[0] * 7 + v[1] * 5 + v[2] * 3) % 97 <= keep / 10
            });
            let ones: Vec<_> = some.iter_ones().collect();
            let of = |a: usize, last: bool| {
                let all = ones.iter().map(|v| v[a]);
                if last { all.max() } else { all.min() }.unwrap_or_default()
            };
            let all = [false, true].map(|last| [0, 1, 2].map(|a| of(a, last)));
            prop_assert_eq!(some.extent(), (!ones.is_empty()).then_some((all[0], all[1])));
        }

        #[test]
        fn grown_is_the_neighbourhood_of_every_voxel(g in grid()) {
            let naive = BitGrid::from_fn(g.dims(), |v| {
                let p = v.map(|c| c as i64);
                (0..27i64).any(|i| {
                    g.get_or_empty([p[0] + i % 3 - 1, p[1] + i / 3 % 3 - 1, p[2] + i / 9 - 1])
                })
            });
            prop_assert_eq!(g.grown(), naive);
        }

        #[test]
        fn boundary_is_what_the_definition_says(g in grid()) {
            let naive = BitGrid::from_fn(g.dims(), |v| {
                let p = v.map(|c| c as i64);
                g.get(v) && (0..3).any(|a| [-1, 1].iter().any(|s| {
                    let mut q = p;
                    q[a] += s;
                    !g.get_or_empty(q)
                }))
            });
            prop_assert_eq!(g.boundary(), naive);
        }

        #[test]
        fn booleans_obey_their_laws(a in grid(), seed in any::<u64>()) {
            let b = BitGrid::from_fn(a.dims(), |[x, y, z]| (seed >> ((x * 7 + y * 3 + z) % 64)) & 1 == 1);
            prop_assert_eq!(a.minus(&b).or(&a.and(&b)), a.clone());
            prop_assert_eq!(a.count_and(&b), a.and(&b).count());
            prop_assert!(a.and(&b).is_subset_of(&a) && !a.minus(&b).intersects(&b));
        }
    }
}
