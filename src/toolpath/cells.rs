use crate::base::DVec2;
use std::ops::Range;

/// Square cells over a box of (u, v).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cells {
    pub origin: DVec2,
    /// Side, mm.
    pub side: f64,
    pub n: [usize; 2],
}

impl Cells {
    pub fn over(lo: DVec2, hi: DVec2, side: f64) -> Cells {
        let n = ((hi - lo) / side).floor() + DVec2::ONE;
        Cells { origin: lo, side, n: [n.x as usize, n.y as usize] }
    }

    pub fn count(&self) -> usize {
        self.n[0] * self.n[1]
    }

    /// The far corner of the last cell.
    pub fn end(&self) -> DVec2 {
        self.origin + DVec2::new(self.n[0] as f64, self.n[1] as f64) * self.side
    }

    fn coordinates(&self, uv: DVec2) -> [i64; 2] {
        let g = ((uv - self.origin) / self.side).floor();
        [g.x as i64, g.y as i64]
    }

    /// Index of the cell at these coordinates, if there is one.
    pub fn index(&self, [i, j]: [i64; 2]) -> Option<usize> {
        let inside = i >= 0 && j >= 0 && i < self.n[0] as i64 && j < self.n[1] as i64;
        inside.then(|| i as usize + self.n[0] * j as usize)
    }

    /// Coordinates of the cell that holds a point, if there is one.
    pub fn cell_of(&self, uv: DVec2) -> Option<[i64; 2]> {
        Some(self.coordinates(uv)).filter(|c| self.index(*c).is_some())
    }

    /// Index of the cell that holds a point.
    pub fn at(&self, uv: DVec2) -> Option<usize> {
        self.index(self.coordinates(uv))
    }

    /// Indices of the cells that a box meets, row by row.
    pub fn within(&self, lo: DVec2, hi: DVec2) -> impl Iterator<Item = usize> + use<> {
        self.rows_within(lo, hi).flatten()
    }

    /// The same, each row's by themselves.
    pub fn rows_within(&self, lo: DVec2, hi: DVec2) -> impl Iterator<Item = Range<usize>> + use<> {
        let (a, b, n) = (self.coordinates(lo), self.coordinates(hi), self.n);
        let clip = |x: i64, k: usize| x.clamp(0, n[k] as i64) as usize;
        let (i0, i1) = (clip(a[0], 0), clip(b[0] + 1, 0));
        (clip(a[1], 1)..clip(b[1] + 1, 1)).map(move |j| i0 + n[0] * j..i1 + n[0] * j)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_find_their_cells_and_boxes_theirs() {
        let cells = Cells::over(DVec2::new(-1.0, 2.0), DVec2::new(2.0, 4.0), 0.5);
        assert_eq!((cells.n, cells.count(), cells.end()), ([7, 5], 35, DVec2::new(2.5, 4.5)));
        assert_eq!(cells.at(DVec2::new(-1.0, 2.0)), Some(0));
        assert_eq!(cells.cell_of(DVec2::new(0.2, 3.7)), Some([2, 3]));
        assert_eq!(cells.at(DVec2::new(-1.1, 3.0)), None);
        let all: Vec<usize> = cells.within(DVec2::new(-9.0, 3.9), DVec2::new(-0.4, 99.0)).collect();
        assert_eq!(all, [21, 22, 28, 29]);
        assert_eq!(cells.within(DVec2::splat(9.0), DVec2::splat(10.0)).count(), 0);
        assert_eq!(cells.within(DVec2::splat(-9.0), DVec2::splat(-8.0)).count(), 0);
    }
}
