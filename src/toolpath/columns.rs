//! Points over the cells of a lattice, where they are, and how low a tip may go beside them.
//!
//! Method: an image of heights moves every point to the middle of its cell. Here a cell keeps its points, the highest
//! first, and blocks of cells the height of their highest; blocks and points too low to lift a tip beyond what others
//! did are passed over.
//!
//! Guarantee: the lift is that of all points. Lengths in mm.

use super::image::{Image, Lattice};
use super::pyramid::Maxima;
use crate::base::{DVec2, DVec3};

pub(super) struct Columns {
    lattice: Lattice,
    blocks: Maxima,
    /// For each cell the number of its first point, and at last that of all points.
    first: Vec<u32>,
    /// As (u, v, height).
    points: Vec<DVec3>,
    /// How far a point lies from the middle of its cell, at most.
    aside: f64,
}

impl Columns {
    /// Of points as (u, v, height); those outside the lattice are left out.
    pub fn over(lattice: Lattice, points: &[DVec3]) -> Columns {
        let cells: Vec<Option<usize>> =
            points.iter().map(|p| lattice.cell(p.truncate()).map(|c| lattice.index(c))).collect();
        let mut image = Image::empty(lattice);
        let mut first = vec![0u32; lattice.cells() + 1];
        let mut aside: f64 = 0.0;
        for (p, i) in points.iter().zip(&cells).filter_map(|(p, i)| Some((p, (*i)?))) {
            first[i + 1] += 1;
            image.data[i] = image.data[i].max(p.z as f32);
            aside = aside.max(lattice.uv(lattice.cell_of_index(i)).distance(p.truncate()));
        }
        for i in 1..first.len() {
            first[i] += first[i - 1];
        }
        let mut held = vec![DVec3::ZERO; first[lattice.cells()] as usize];
        let mut next = first.clone();
        for (p, i) in points.iter().zip(&cells).filter_map(|(p, i)| Some((p, (*i)?))) {
            held[next[i] as usize] = *p;
            next[i] += 1;
        }
        for cell in first.windows(2) {
            held[cell[0] as usize..cell[1] as usize].sort_by(|p, q| q.z.total_cmp(&p.z));
        }
        if aside <= MIDDLE_MM {
            // The others of a cell are in the same place, and lower.
            let highest = first.windows(2).filter(|cell| cell[0] < cell[1]);
            held = highest.map(|cell| held[cell[0] as usize]).collect();
            let mut count = 0;
            for i in 0..lattice.cells() {
                let has_any = first[i] < first[i + 1];
                first[i] = count;
                count += u32::from(has_any);
            }
            first[lattice.cells()] = count;
        }
        Columns { lattice, blocks: Maxima::of(&image), first, points: held, aside }
    }

    /// The lowest tip over a place, no lower than `from`, at which a tool holds no point; of those above `enough` any.
    /// `lower` is the tool's lower surface over its tip at a distance from its axis: it falls nowhere outward and is +∞
    /// beyond `radius`.
    pub fn lift(
        &self,
        at: DVec2,
        radius: f64,
        lower: impl Fn(f64) -> f64,
        [from, enough]: [f64; 2],
    ) -> f64 {
        let (l, reach) = (&self.lattice, radius + self.aside);
        let (low, high) = ((at - reach - l.origin) / l.s, (at + reach - l.origin) / l.s);
        let range = |low: f64, high: f64, n: usize| {
            low.ceil().max(0.0) as usize..((high.floor() + 1.0).max(0.0) as usize).min(n)
        };
        let (us, vs) = (range(low.x, high.x, l.n[0]), range(low.y, high.y, l.n[1]));
        let tip = lower(0.0);
        let mut lowest = from;
        for (us, vs, most) in self.blocks.each(us, vs) {
            let first = l.uv([us.start, vs.start]);
            let last = l.uv([us.end - 1, vs.end - 1]);
            let gap = (first - at).max(at - last).max(DVec2::ZERO).length();
            // Heights of blocks are rounded.
            if most + ROUNDING_MM - lower((gap - self.aside - ROUNDING_MM).max(0.0)) <= lowest {
                continue;
            }
            for j in vs {
                for i in us.clone() {
                    let cell = self.of_cell(l.index([i, j]));
                    let Some(highest) = cell.first().filter(|p| p.z - tip > lowest) else {
                        continue;
                    };
                    // No point of the cell lifts to more than the highest would from here.
                    let middle = l.uv([i, j]).distance(at);
                    let least = lower((middle - self.aside).max(0.0));
                    if highest.z - least <= lowest {
                        continue;
                    }
                    for p in cell {
                        if p.z - least <= lowest {
                            break;
                        }
                        lowest = lowest.max(p.z - lower(p.truncate().distance(at)));
                        if lowest > enough {
                            return lowest;
                        }
                    }
                }
            }
        }
        lowest
    }

    fn of_cell(&self, cell: usize) -> &[DVec3] {
        &self.points[self.first[cell] as usize..self.first[cell + 1] as usize]
    }
}

/// Rounding of heights in f32, of parts up to metres.
const ROUNDING_MM: f64 = 1e-4;

/// Points no farther from the middles of their cells are there, mm: along the grid's axes.
const MIDDLE_MM: f64 = 1e-9;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Direction;
    use crate::voxel::Frame;
    use rand::RngExt;

    /// Every point lifts as much as where it is, not where its cell's middle is.
    #[test]
    fn a_lift_is_that_of_all_points() {
        let frame = Frame { pitch: 0.5, dims: [1; 3], origin: DVec3::splat(-0.25) };
        let plane = Direction::Z.image_plane();
        let l = Lattice::over(&frame, plane, 0.5, DVec2::ZERO, DVec2::new(20.0, 14.0));
        let mut rng = crate::base::rng(11, 0);
        for (number, radius) in [(0, 1.0), (1, 2.0), (60, 0.4), (900, 1.5), (9000, 7.0)] {
            let mut point = || {
                let [u, v] = [21.0, 15.0].map(|n| rng.random_range(-1.0..n));
                DVec3::new(u, v, rng.random_range(-5.0..5.0))
            };
            let mut points: Vec<DVec3> = (0..number).map(|_| point()).collect();
            if number % 2 == 1 || number == 900 {
                // As along the grid's axes.
                let middle = |p: &mut DVec3| {
                    *p = l.cell(p.truncate()).map_or(*p, |c| l.uv(c).extend(p.z));
                };
                points.iter_mut().for_each(middle);
            }
            let columns = Columns::over(l, &points);
            let inside = |p: &&DVec3| l.cell(p.truncate()).is_some();
            let lower = |rho: f64| match rho {
                rho if rho > radius => f64::INFINITY,
                rho => (1.3 * rho - 0.2).max(0.0) - 0.1,
            };
            for _ in 0..300 {
                let [u, v] = [24.0, 18.0].map(|n| rng.random_range(-4.0..n));
                let at = DVec2::new(u, v);
                let from = [f64::NEG_INFINITY, rng.random_range(-5.0..6.0)][usize::from(u > 10.0)];
                let lifts = points.iter().filter(inside).map(|p| {
                    let rho = p.truncate().distance(at);
                    p.z - lower(rho)
                });
                let want = lifts.fold(from, f64::max);
                assert_eq!(columns.lift(at, radius, lower, [from, f64::INFINITY]), want, "{at}");
                let some = columns.lift(at, radius, lower, [from, 1.0]);
                assert!(some == want || some > 1.0 && some <= want, "{at}: {some}, {want}");
            }
        }
    }
}
