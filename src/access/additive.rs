//! What carries a deposit along a direction (self-support).

use crate::base::{DVec3, Direction};
use crate::voxel::BitGrid;
use rayon::prelude::*;

/// The neighbours that can carry a voxel along a direction within an overhang angle.
///
/// A bead needs material below it, no further aside than the overhang angle allows. On a grid one
/// neighbour alone allows only a few angles, so a chain of two counts when the angle of the whole
/// chain is small enough: near 45–48° instead of 35–45° for a limit of 50° along z.
#[derive(Clone, Debug)]
pub struct CarrierTable {
    direct: Vec<[i64; 3]>,
    /// The same as bits of [`BitGrid::around`].
    direct_bits: u32,
    /// (first, second) offsets of a chain.
    chains: Vec<([i64; 3], [i64; 3])>,
}

/// Neighbours count as lower when they are so by more than this share of a pitch.
const BELOW: f64 = 1e-6;

impl CarrierTable {
    pub fn new(direction: Direction, overhang_deg: f64) -> CarrierTable {
        let as_vec = |o: [i64; 3]| DVec3::new(o[0] as f64, o[1] as f64, o[2] as f64);
        let drop = |o: [i64; 3]| -direction.dot(as_vec(o));
        let least_cosine = overhang_deg.to_radians().cos();
        // The verifier computes the same angle another way; equal angles must not split them.
        let within = |o: [i64; 3]| drop(o) >= (least_cosine + 1e-9) * as_vec(o).length();
        let mut below: Vec<[i64; 3]> = Vec::new();
        for z in -1..=1 {
            for y in -1..=1 {
                for x in -1..=1 {
                    if drop([x, y, z]) > BELOW {
                        below.push([x, y, z]);
                    }
                }
            }
        }
        let mut direct: Vec<_> = below.iter().copied().filter(|o| within(*o)).collect();
        // The one straight below first.
        let aside = |o: &[i64; 3]| -drop(*o) / as_vec(*o).length();
        direct.sort_by(|a, b| aside(a).total_cmp(&aside(b)));
        let mut chains = Vec::new();
        for &a in below.iter().filter(|a| !within(**a)) {
            for &b in &below {
                let whole = [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
                if within(whole) {
                    chains.push((a, whole));
                }
            }
        }
        let direct_bits = direct.iter().map(bit).fold(0, |all, b| all | b);
        CarrierTable { direct, direct_bits, chains }
    }

    /// Whether `solid` carries the voxel.
    pub fn carries(&self, solid: &BitGrid, voxel: [usize; 3]) -> bool {
        self.carries_among(solid.around(voxel), solid, voxel)
    }

    /// The same where it is known what of the solid is around the voxel: see [`BitGrid::around`].
    pub fn carries_among(&self, around: u32, solid: &BitGrid, voxel: [usize; 3]) -> bool {
        let p = voxel.map(|c| c as i64);
        let at = |o: &[i64; 3]| solid.get_or_empty([p[0] + o[0], p[1] + o[1], p[2] + o[2]]);
        let is_chain = |(a, b): &([i64; 3], [i64; 3])| around & bit(a) != 0 && at(b);
        around & self.direct_bits != 0 || self.chains.iter().any(is_chain)
    }

    /// The places within the grid at which one voxel would carry this one, the straightest first.
    pub fn under(
        &self,
        voxel: [usize; 3],
        dims: [usize; 3],
    ) -> impl Iterator<Item = [usize; 3]> + '_ {
        self.direct.iter().filter_map(move |o| moved(voxel, *o, dims))
    }

    /// The places within the grid at which two voxels would carry this one together.
    pub fn chains_under(
        &self,
        voxel: [usize; 3],
        dims: [usize; 3],
    ) -> impl Iterator<Item = [[usize; 3]; 2]> + '_ {
        self.chains
            .iter()
            .filter_map(move |(a, b)| Some([moved(voxel, *a, dims)?, moved(voxel, *b, dims)?]))
    }
}

/// The bit of an offset to a neighbour in [`BitGrid::around`].
fn bit(o: &[i64; 3]) -> u32 {
    1 << ((o[0] + 1) + 3 * (o[1] + 1) + 9 * (o[2] + 1))
}

/// A voxel moved by an offset, where that stays within the grid.
fn moved(voxel: [usize; 3], offset: [i64; 3], dims: [usize; 3]) -> Option<[usize; 3]> {
    let at: [usize; 3] = std::array::from_fn(|a| voxel[a].wrapping_add_signed(offset[a] as isize));
    (0..3).all(|a| at[a] < dims[a]).then_some(at)
}

/// The voxels of `candidates` that `solid` carries.
pub fn supported(table: &CarrierTable, solid: &BitGrid, candidates: &BitGrid) -> BitGrid {
    let mut out = BitGrid::new(candidates.dims());
    out.par_rows_mut().for_each(|(y, z, row)| {
        for (w, &bits) in candidates.row(y, z).iter().enumerate() {
            let mut rest = bits;
            while rest != 0 {
                let bit = rest.trailing_zeros() as usize;
                rest &= rest - 1;
                if table.carries(solid, [w * 64 + bit, y, z]) {
                    row[w] |= 1 << bit;
                }
            }
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn slope(deg: f64) -> (BitGrid, BitGrid) {
        let dims = [40, 12, 16];
        // A wall that leans outward along x by `deg` from the vertical, over a plate.
        let lean = deg.to_radians().tan();
        let all = BitGrid::from_fn(dims, |[x, _, z]| (x as f64) <= 8.0 + lean * z as f64);
        let plate = BitGrid::from_fn(dims, |[x, _, z]| z == 0 && x <= 8);
        (all.clone(), all.minus(&plate))
    }

    #[test]
    fn overhangs_carry_themselves_up_to_the_angle() {
        let table = CarrierTable::new(Direction::Z, 50.0);
        for (deg, carried) in
            [(0.0, true), (30.0, true), (44.0, true), (60.0, false), (80.0, false)]
        {
            let (all, above) = slope(deg);
            assert_eq!(supported(&table, &all, &above) == above, carried, "{deg}°");
        }
    }

    #[test]
    fn a_chain_of_two_carries_where_no_single_voxel_may_be() {
        let table = CarrierTable::new(Direction::Z, 50.0);
        let (dims, v) = ([5, 5, 5], [2, 2, 3]);
        let chains: Vec<[[usize; 3]; 2]> = table.chains_under(v, dims).collect();
        assert!(!chains.is_empty());
        for chain in chains {
            let mut solid = BitGrid::new(dims);
            assert!(table.under(v, dims).all(|u| u != chain[0]));
            solid.set(chain[0], true);
            assert!(!table.carries(&solid, v), "{chain:?}");
            solid.set(chain[1], true);
            assert!(table.carries(&solid, v), "{chain:?}");
        }
    }

    /// Random solids, and carriers looked for one by one.
    #[test]
    fn a_look_at_all_that_is_around_finds_the_carriers_that_are_there() {
        use rand::RngExt as _;
        let mut rng = crate::base::rng(11, 0);
        let (dims, mut carried) = ([7, 6, 5], 0);
        for i in 0..200 {
            let share = [0.02, 0.1, 0.3][i % 3];
            let mut solid = BitGrid::new(dims);
            for k in 0..7 * 6 * 5 {
                solid.set([k % 7, k / 7 % 6, k / 42], rng.random_range(0.0..1.0) < share);
            }
            let d = DVec3::from_array([0; 3].map(|_: i32| rng.random_range(-1.0..1.0)));
            let table = CarrierTable::new(Direction::new(d).unwrap(), 50.0);
            for k in 0..7 * 6 * 5 {
                let v = [k % 7, k / 7 % 6, k / 42];
                let alone = table.under(v, dims).any(|u| solid.get(u));
                let both = |chain: [[usize; 3]; 2]| chain.iter().all(|u| solid.get(*u));
                let want = alone || table.chains_under(v, dims).any(both);
                assert_eq!(table.carries(&solid, v), want, "{v:?}");
                carried += usize::from(want);
            }
        }
        assert!(carried > 1000 && carried < 40_000, "{carried}");
    }

    #[test]
    fn nothing_carries_from_above_or_beside() {
        let table = CarrierTable::new(Direction::Z, 50.0);
        let mut solid = BitGrid::new([3, 3, 3]);
        for v in BitGrid::from_fn([3, 3, 3], |v| v[2] >= 1 && v != [1, 1, 1]).iter_ones() {
            solid.set(v, true);
        }
        assert!(!table.carries(&solid, [1, 1, 1]));
        solid.set([1, 1, 0], true);
        assert!(table.carries(&solid, [1, 1, 1]));
    }
}
