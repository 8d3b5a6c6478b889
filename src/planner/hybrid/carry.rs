//! What a layer and the one below it carry, as words of rows: rule `support` along a grid axis.
//!
//! | symbol | here |
//! |---|---|
//! | x | a voxel to be laid, at the origin |
//! | a | a neighbour in the layer below, by its offset across the direction |
//! | b | a neighbour of a one layer further down, by its offset from x |
//!
//! A voxel is carried by an a no further aside than the overhang allows, or by an a beyond that
//! which stands on a b that is not. At 50° the second way lets diagonals lean, so that an overhang
//! may go on by two voxels in two layers one way and by one the other (48°), where four neighbours
//! alone allow 35° along diagonals.
//!
//! Guarantees: what [`Carry::carried`] says is carried has a carrier by `docs/RULES.md`.

/// Overhang from which deposits may lean, degrees: up to there one neighbour carries only what lies
/// straight above it.
const CONE_DEG: f64 = 45.0;

/// Slack of the cosine, so that 45° passes at 45°: half the verifier's, which computes the same
/// angle another way and must not see less.
const COSINE_ROUNDING: f64 = 5e-10;

/// An offset across the direction, in voxels.
pub type Across = (i64, i64);

/// The offsets that carry.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Carry {
    /// Of an a that carries alone, the straightest first.
    pub direct: Vec<Across>,
    /// Of an a and of each b that does for it.
    pub chains: Vec<(Across, Vec<Across>)>,
}

impl Carry {
    /// What lies straight below (HB Sec. 3.4).
    pub fn column() -> Carry {
        Carry { direct: vec![(0, 0)], chains: Vec::new() }
    }

    /// Overhangs up to an angle, degrees; below 45 only columns.
    pub fn within(overhang_deg: f64) -> Carry {
        if overhang_deg < CONE_DEG {
            return Carry::column();
        }
        let least_cosine = overhang_deg.to_radians().cos();
        let allowed = |(i, j): Across, down: i64| {
            let length = ((i * i + j * j + down * down) as f64).sqrt();
            down as f64 >= (least_cosine - COSINE_ROUNDING) * length
        };
        let square = || (-1..=1).flat_map(|j| (-1..=1).map(move |i| (i, j)));
        let (mut direct, aside): (Vec<Across>, Vec<Across>) =
            square().partition(|a| allowed(*a, 1));
        direct.sort_by_key(|(i, j)| (i * i + j * j, *j, *i));
        let under = |a: Across| square().map(move |b| (a.0 + b.0, a.1 + b.1));
        let chain = |a| (a, under(a).filter(|b| allowed(*b, 2)).collect());
        Carry { direct, chains: aside.into_iter().map(chain).collect() }
    }

    /// Which voxels of `wanted`, a layer of rows of `words`, the two layers below it carry.
    pub fn carried(&self, wanted: &[u64], below: [&[u64]; 2], words: usize) -> Vec<u64> {
        let mut out = vec![0u64; wanted.len()];
        for (i, out) in out.iter_mut().enumerate().filter(|(i, _)| wanted[*i] != 0) {
            let mut left = wanted[i];
            for a in &self.direct {
                left &= !moved(below[0], words, i, *a);
            }
            for (a, seconds) in &self.chains {
                // Mostly nothing is left by now, or nothing on this side.
                let beside = left & moved(below[0], words, i, *a);
                if beside != 0 {
                    let second = |all, b: &Across| all | moved(below[1], words, i, *b);
                    left &= !(beside & seconds.iter().fold(0, second));
                }
            }
            *out = wanted[i] & !left;
        }
        out
    }

    /// The voxels of a layer all of whose neighbours that may carry aside are in it.
    pub fn inner(&self, layer: &[u64], words: usize) -> Vec<u64> {
        let all = |i| self.direct.iter().fold(!0, |all, a| all & moved(layer, words, i, *a));
        (0..layer.len()).map(all).collect()
    }
}

/// Word i of a layer moved so that bit x is what the voxel at an offset of at most two from it is;
/// empty outside the grid.
pub fn moved(layer: &[u64], words: usize, i: usize, (dx, dy): Across) -> u64 {
    let (row, w) = ((i / words) as i64 + dy, i % words);
    if row < 0 || row >= (layer.len() / words) as i64 {
        return 0;
    }
    let at = row as usize * words + w;
    let by = dx.unsigned_abs() as u32;
    match dx {
        0 => layer[at],
        1.. => layer[at] >> by | if w + 1 < words { layer[at + 1] << (64 - by) } else { 0 },
        _ => layer[at] << by | if w > 0 { layer[at - 1] >> (64 - by) } else { 0 },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::access::{CarrierTable, supported};
    use crate::base::Direction;
    use crate::voxel::BitGrid;

    /// On random layers, against the voxel-by-voxel table, which refuses an angle equal to the limit:
    /// so not at 45° itself.
    #[test]
    fn layers_carry_what_voxels_do() {
        let dims = [130, 7, 3];
        for deg in [46.0, 47.0, 50.0, 55.0, 60.0] {
            let (carry, table) = (Carry::within(deg), CarrierTable::new(Direction::Z, deg));
            let mut bits = 7u64;
            let cells: Vec<bool> = (0..dims.iter().product::<usize>())
                .map(|_| {
                    bits = bits.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                    bits >> 61 == 0
                })
                .collect();
            let solid = BitGrid::from_fn(dims, |[x, y, z]| z < 2 && cells[x + 130 * (y + 7 * z)]);
            let wanted = BitGrid::from_fn(dims, |v| v[2] == 2);
            let words = solid.words_per_row();
            let layer = |g: &BitGrid, z| -> Vec<u64> {
                (0..dims[1]).flat_map(|y| g.row(y, z).iter().copied()).collect()
            };
            let below = [layer(&solid, 1), layer(&solid, 0)];
            let found = carry.carried(&layer(&wanted, 2), [&below[0], &below[1]], words);
            assert_eq!(found, layer(&supported(&table, &solid, &wanted), 2), "{deg}°");
        }
    }

    #[test]
    fn below_45_degrees_only_columns_carry() {
        assert_eq!(Carry::within(44.0), Carry::column());
        assert_eq!(Carry::within(45.0).direct.len(), 5);
        // Of the nine under a corner those no further out along one axis than it is.
        assert!(Carry::within(45.0).chains.iter().all(|(_, b)| b.len() == 6));
        assert!(Carry::within(50.0).chains.iter().all(|(_, b)| b.len() == 8));
        assert_eq!(Carry::within(60.0).direct.len(), 9);
    }
}
