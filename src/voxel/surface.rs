//! A closed, oriented, smooth surface around a voxel set.
//!
//! Method: surface nets (Gibson 1998) with as many vertices at a lattice corner as sheets of
//! surface pass it. Every face between a solid and an empty voxel becomes a quad between its four
//! corners. Where four faces meet at an edge, the two of each solid voxel belong together, so
//! voxels that touch only along an edge or at a corner come apart. Taubin's λ|μ smoothing (1995),
//! which keeps volume, then moves each vertex within half a voxel of its corner. A part of a surface
//! is made the same way from a part of the voxels.
//!
//! Guarantees, for every voxel set: every directed edge is matched by exactly one opposite edge,
//! so the surface is a closed 2-manifold, counter-clockwise seen from outside; deterministic.
//! Not guaranteed: freedom from self-contact where solids touch along edges; the volume of features
//! that are one voxel thin.

use super::{BitGrid, Frame};
use crate::base::DVec3;
use crate::mesh::{InvalidMesh, TriMesh};
use rayon::prelude::*;
use std::borrow::Cow;
use std::collections::BTreeMap;

/// Taubin's pair of factors: shrink by the first, grow back by the second; −1/μ must exceed 1/λ by
/// a little (0.1 is his), or the surface shrinks or swells.
const LAMBDA: f64 = 0.5;
const MU: f64 = -0.526;

/// Shrink–grow rounds. Fewer leave the staircase visible (a ball's area is 9 % too large with 6, 50 %
/// with none), more waste what is one voxel thin (a rod keeps half its section with 6).
const ROUNDS: usize = 6;

/// How far a vertex may move along each axis, voxels: as far as the next voxel centre, where the
/// truth about the solid begins.
const FARTHEST: f64 = 0.5;

/// The surface of the solid voxels, mm.
///
/// # Errors
/// [`InvalidMesh`] when the frame puts the surface farther out than a mesh may be.
pub fn surface(grid: &BitGrid, frame: &Frame) -> Result<TriMesh, InvalidMesh> {
    Ok(smooth_net(grid, frame, None)?.0)
}

/// The smooth surface with the net that it was made of. With a scope: of its voxels alone, a rim
/// around it is not the surface's.
pub(super) fn smooth_net(
    grid: &BitGrid,
    frame: &Frame,
    scope: Option<&Scope>,
) -> Result<(TriMesh, Net), InvalidMesh> {
    let mut net = Net::of(grid, scope);
    net.smooth();
    let triangles = net.triangles();
    let points = net.points.iter().map(|p| frame.origin + *p * frame.pitch).collect();
    Ok((TriMesh::new(points, triangles)?, net))
}

/// How far from a facet's voxel another one may be that moves its corners, in voxels along an axis:
/// each step of smoothing takes a neighbour of a neighbour into account.
pub(super) const SMOOTHING_REACH: usize = 2 * ROUNDS + 2;

/// Some of a grid's voxels, in blocks.
pub(super) struct Scope {
    /// Which blocks of [`Scope::BLOCK`] voxels along each axis.
    pub blocks: BitGrid,
    /// Bits of the voxels in a row, block row by block row.
    words: Vec<u64>,
    per_row: usize,
}

impl Scope {
    /// A quarter of a word, and no less than [`SMOOTHING_REACH`].
    pub const BLOCK: usize = 16;

    /// How many blocks hold a grid.
    pub fn counts(dims: [usize; 3]) -> [usize; 3] {
        dims.map(|n| n.div_ceil(Scope::BLOCK))
    }

    pub fn of(blocks: BitGrid, grid: &BitGrid) -> Scope {
        let (per_row, [nx, ny, nz]) = (grid.words_per_row(), blocks.dims());
        let mut words = vec![0; per_row * ny * nz];
        for [x, y, z] in blocks.iter_ones().filter(|v| v[0] < nx) {
            let at = x * Scope::BLOCK;
            words[at / 64 + per_row * (y + ny * z)] |= 0xffff << (at % 64);
        }
        Scope { blocks, words, per_row }
    }

    fn row(&self, y: usize, z: usize) -> &[u64] {
        let row = y / Scope::BLOCK + self.blocks.dims()[1] * (z / Scope::BLOCK);
        &self.words[row * self.per_row..(row + 1) * self.per_row]
    }
}

/// Face number of a pair of neighbouring voxels around a corner: bits of the lower one, without
/// the bit of the axis between them.
fn face_number(axis: usize, lower: usize) -> usize {
    let low_bits = lower & ((1 << axis) - 1);
    axis * 4 + (low_bits | lower >> (axis + 1) << axis)
}

/// Voxel bits in cyclic order around the half-edge that leaves a corner along `axis`, on its low
/// or high side.
fn around_edge(axis: usize, high: bool) -> [usize; 4] {
    let (u, v) = (1 << ((axis + 1) % 3), 1 << ((axis + 2) % 3));
    let base = usize::from(high) << axis;
    [base, base | u, base | u | v, base | v]
}

/// The boundary face between two neighbouring voxels of a corner.
fn face_between(a: usize, b: usize) -> usize {
    face_number((a ^ b).trailing_zeros() as usize, a & b)
}

/// Which sheet of surface each of the twelve faces around a corner belongs to, for a pattern of
/// eight solid bits.
#[derive(Clone, Copy, Default)]
struct Sheets {
    sheet: [u8; 12],
    count: u8,
}

impl Sheets {
    fn of(pattern: usize) -> Sheets {
        let solid = |v: usize| pattern >> v & 1 == 1;
        let mut root: [usize; 12] = std::array::from_fn(|i| i);
        for axis in 0..3 {
            for high in [false, true] {
                let ring = around_edge(axis, high);
                let faces: Vec<usize> =
                    (0..4).filter(|i| solid(ring[*i]) != solid(ring[(i + 1) % 4])).collect();
                // Two faces are one sheet; of four, the two beside each solid voxel are.
                let pairs: Vec<(usize, usize)> = match faces.len() {
                    2 => vec![(faces[0], faces[1])],
                    4 => (0..4).filter(|i| solid(ring[*i])).map(|i| ((i + 3) % 4, i)).collect(),
                    _ => Vec::new(),
                };
                for (i, j) in pairs {
                    let face = |k: usize| face_between(ring[k], ring[(k + 1) % 4]);
                    let (a, b) = (root[face(i)], root[face(j)]);
                    root.iter_mut().filter(|r| **r == a.max(b)).for_each(|r| *r = a.min(b));
                }
            }
        }
        let mut sheets = Sheets::default();
        let mut number = [None; 12];
        for axis in 0..3 {
            for lower in (0..8usize).filter(|v| v >> axis & 1 == 0) {
                if solid(lower) != solid(lower | 1 << axis) {
                    let face = face_number(axis, lower);
                    let n = *number[root[face]].get_or_insert_with(|| {
                        sheets.count += 1;
                        sheets.count - 1
                    });
                    sheets.sheet[face] = n;
                }
            }
        }
        sheets
    }
}

/// First vertex and solid pattern of a lattice corner.
#[derive(Clone, Copy, Default)]
struct Corner {
    first: u32,
    pattern: u8,
}

/// Names a lattice edge as one of the solid voxels beside it sees it: voxel, axis, side bits.
type SeenEdge = ([usize; 3], usize, [usize; 3]);

#[derive(Default)]
pub(super) struct Net {
    /// Grid coordinates; vertices that come with quads first, then those that split edges.
    points: Vec<DVec3>,
    quads: Vec<[u32; 4]>,
    /// The first quad of each row of voxels in a block, with the first of these.
    pub owners: Vec<([usize; 3], u32)>,
    /// The first triangle of each quad, and where the last one's end.
    pub firsts: Vec<u32>,
    /// The edges of each quad that four faces share and whose two vertices all four share too.
    pinched: BTreeMap<(u32, u8), SeenEdge>,
}

impl Net {
    fn of(grid: &BitGrid, scope: Option<&Scope>) -> Net {
        let [nx, ny, nz] = grid.dims();
        let table: Vec<Sheets> = (0..256).map(Sheets::of).collect();
        let boundary = grid.boundary();
        let mut net = Net::default();
        if boundary.is_empty() {
            return net;
        }
        let blank = vec![Corner::default(); (nx + 1) * (ny + 1)];
        let mut layers = [blank.clone(), blank];
        net.corners(grid, scope, &table, 0, &mut layers[0]);
        for z in 0..nz {
            net.corners(grid, scope, &table, z + 1, &mut layers[1]);
            for y in 0..ny {
                let mut block = None;
                let row = boundary.row(y, z);
                let row: Cow<[u64]> = match scope {
                    None => Cow::Borrowed(row),
                    Some(s) => row.iter().zip(s.row(y, z)).map(|(a, b)| a & b).collect(),
                };
                for x in ones(&row) {
                    if block != Some(x / Scope::BLOCK) {
                        block = Some(x / Scope::BLOCK);
                        net.owners.push(([x, y, z], net.quads.len() as u32));
                    }
                    net.voxel(grid, &table, &layers, [x, y, z]);
                }
            }
            layers.swap(0, 1);
        }
        net
    }

    /// Makes the vertices of lattice layer `k`, with a scope those of its voxels.
    fn corners(
        &mut self,
        grid: &BitGrid,
        scope: Option<&Scope>,
        table: &[Sheets],
        k: usize,
        layer: &mut [Corner],
    ) {
        let [nx, ny, nz] = grid.dims();
        let empty = vec![0u64; grid.words_per_row()];
        let all = vec![!0u64; grid.words_per_row()];
        for j in 0..=ny {
            // Rows beside the corner row, by (dy, dz) bits.
            let rows: [&[u64]; 4] = std::array::from_fn(|b| {
                let (y, z) = ((j + (b & 1)).wrapping_sub(1), (k + (b >> 1)).wrapping_sub(1));
                if y < ny && z < nz { grid.row(y, z) } else { &empty[..] }
            });
            let wanted: [&[u64]; 4] = std::array::from_fn(|b| {
                let (y, z) = ((j + (b & 1)).wrapping_sub(1), (k + (b >> 1)).wrapping_sub(1));
                match scope {
                    None => &all[..],
                    Some(s) if y < ny && z < nz => s.row(y, z),
                    Some(_) => &empty[..],
                }
            });
            let line = &mut layer[j * (nx + 1)..(j + 1) * (nx + 1)];
            line.fill(Corner::default());
            let words = grid.words_per_row();
            for w in 0..=words {
                let word = |r: &[u64], w: usize| r.get(w).copied().unwrap_or(0);
                let before = |r: &[u64], w: usize| w.checked_sub(1).map_or(0, |w| word(r, w) >> 63);
                // Bit i: voxel i, and voxel i − 1, of any and of all four rows.
                let (mut any, mut all, mut own) = (0, !0, 0);
                for r in wanted {
                    own |= word(r, w) | word(r, w) << 1 | before(r, w);
                }
                for r in rows {
                    let shifted = word(r, w) << 1 | before(r, w);
                    any |= word(r, w) | shifted;
                    all &= word(r, w) & shifted;
                }
                for bit in ones(&[any & !all & own]) {
                    let i = w * 64 + bit;
                    if i > nx {
                        break;
                    }
                    let mut pattern = 0u8;
                    for (b, r) in rows.iter().enumerate() {
                        let at = |x: usize| word(r, x / 64) >> (x % 64) & 1;
                        let low = i.checked_sub(1).map_or(0, at);
                        pattern |= ((low | at(i) << 1) as u8) << (2 * b);
                    }
                    line[i] = Corner { first: self.points.len() as u32, pattern };
                    let p = DVec3::new(i as f64, j as f64, k as f64);
                    self.points
                        .extend(std::iter::repeat_n(p, table[pattern as usize].count as usize));
                }
            }
        }
    }

    /// Adds the quads of a solid voxel's open faces.
    fn voxel(&mut self, grid: &BitGrid, table: &[Sheets], l: &[Vec<Corner>; 2], v: [usize; 3]) {
        let width = grid.dims()[0] + 1;
        let corner = |d: [usize; 3]| l[d[2]][v[0] + d[0] + width * (v[1] + d[1])];
        for axis in 0..3 {
            for high in [0usize, 1] {
                let mut beyond = v.map(|c| c as i64);
                beyond[axis] += 2 * high as i64 - 1;
                if grid.get_or_empty(beyond) {
                    continue;
                }
                let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
                let mut ring = [[0, 0], [1, 0], [1, 1], [0, 1]].map(|[s, t]| {
                    let mut d = [0; 3];
                    (d[axis], d[a], d[b]) = (high, s, t);
                    d
                });
                if high == 0 {
                    ring.reverse();
                }
                let vertex = ring.map(|d| {
                    // The voxel lies on the other side of the corner than the corner of it.
                    let own = (0..3).map(|i| (1 - d[i]) << i).sum::<usize>();
                    let c = corner(d);
                    let s = table[c.pattern as usize].sheet[face_between(own, own ^ 1 << axis)];
                    c.first + u32::from(s)
                });
                let quad = self.quads.len() as u32;
                self.quads.push(vertex);
                for side in 0..4 {
                    let (p, q) = (ring[side], ring[(side + 1) % 4]);
                    if pinched(table, [p, q].map(|d| (corner(d), d))) {
                        let along = (0..3).find(|i| p[*i] != q[*i]).unwrap_or(0);
                        let sides: [usize; 3] = std::array::from_fn(|i| p[i] & q[i]);
                        self.pinched.insert((quad, side as u8), (v, along, sides));
                    }
                }
            }
        }
    }

    /// Laplacian steps over the quads' edges, each vertex kept within half a voxel of its corner.
    fn smooth(&mut self) {
        let home = self.points.clone();
        let n = home.len();
        let mut start = vec![0usize; n + 1];
        let edges = |q: &[u32; 4]| [(q[0], q[1]), (q[1], q[2]), (q[2], q[3]), (q[3], q[0])];
        self.quads.iter().flatten().for_each(|v| start[*v as usize + 1] += 1);
        (0..n).for_each(|i| start[i + 1] += start[i]);
        let mut next = start.clone();
        let mut neighbours = vec![0u32; start[n]];
        for (from, to) in self.quads.iter().flat_map(edges) {
            neighbours[next[from as usize]] = to;
            next[from as usize] += 1;
        }
        for step in 0..2 * ROUNDS {
            let factor = if step % 2 == 0 { LAMBDA } else { MU };
            let old = &self.points;
            let moved = (0..n)
                .into_par_iter()
                .with_min_len(4096)
                .map(|i| {
                    let around = &neighbours[start[i]..start[i + 1]];
                    // On the rim of a scope.
                    if around.is_empty() {
                        return old[i];
                    }
                    let sum: DVec3 = around.iter().map(|j| old[*j as usize]).sum();
                    let toward = sum / around.len() as f64 - old[i];
                    let limit = DVec3::splat(FARTHEST);
                    home[i] + (old[i] + toward * factor - home[i]).clamp(-limit, limit)
                })
                .collect();
            self.points = moved;
        }
    }

    /// Splits quads along their shorter diagonal; those with a pinched edge get a vertex on each
    /// such edge, shared only with the other face of the same voxel, and one in the middle.
    fn triangles(&mut self) -> Vec<[u32; 3]> {
        let mut triangles = Vec::with_capacity(2 * self.quads.len());
        let mut splits: BTreeMap<SeenEdge, u32> = BTreeMap::new();
        self.firsts = Vec::with_capacity(self.quads.len() + 1);
        for (i, q) in self.quads.iter().enumerate() {
            self.firsts.push(triangles.len() as u32);
            let i = i as u32;
            let rim: Vec<Option<SeenEdge>> =
                (0..4).map(|side| self.pinched.get(&(i, side)).copied()).collect();
            let p = q.map(|v| self.points[v as usize]);
            if rim.iter().all(Option::is_none) {
                if p[0].distance_squared(p[2]) <= p[1].distance_squared(p[3]) {
                    triangles.extend([[q[0], q[1], q[2]], [q[0], q[2], q[3]]]);
                } else {
                    triangles.extend([[q[1], q[2], q[3]], [q[1], q[3], q[0]]]);
                }
                continue;
            }
            let middle = self.points.len() as u32;
            self.points.push(p.iter().sum::<DVec3>() / 4.0);
            for side in 0..4 {
                let (a, b) = (q[side], q[(side + 1) % 4]);
                match rim[side] {
                    None => triangles.push([middle, a, b]),
                    Some(seen) => {
                        let points = &mut self.points;
                        let split = *splits.entry(seen).or_insert_with(|| {
                            points.push((p[side] + p[(side + 1) % 4]) / 2.0);
                            points.len() as u32 - 1
                        });
                        triangles.extend([[middle, a, split], [middle, split, b]]);
                    }
                }
            }
        }
        self.firsts.push(triangles.len() as u32);
        triangles
    }
}

/// Whether four faces meet at the lattice edge between two corners of a voxel and all four use the
/// same vertex at both.
fn pinched(table: &[Sheets], ends: [(Corner, [usize; 3]); 2]) -> bool {
    let along = (0..3).find(|i| ends[0].1[*i] != ends[1].1[*i]).unwrap_or(0);
    ends.iter().all(|(c, d)| {
        // From the corner at the low end of the edge, the edge is on its high side.
        let ring = around_edge(along, d[along] == 0);
        let solid = |v: usize| c.pattern >> v & 1 == 1;
        let sheets = &table[c.pattern as usize].sheet;
        let first = sheets[face_between(ring[0], ring[1])];
        (0..4).all(|i| {
            let (a, b) = (ring[i], ring[(i + 1) % 4]);
            solid(a) != solid(b) && sheets[face_between(a, b)] == first
        })
    })
}

/// Numbers of the set bits of a row.
fn ones(row: &[u64]) -> impl Iterator<Item = usize> + '_ {
    row.iter().enumerate().flat_map(|(w, &bits)| {
        let mut rest = bits;
        std::iter::from_fn(move || {
            (rest != 0).then(|| {
                let b = rest.trailing_zeros() as usize;
                rest &= rest - 1;
                w * 64 + b
            })
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    fn unit(dims: [usize; 3]) -> Frame {
        Frame { pitch: 1.0, dims, origin: DVec3::ZERO }
    }

    /// Every directed edge once and its opposite once, and around each vertex one fan.
    fn check_manifold(m: &TriMesh) -> Result<(), String> {
        let mut edges = BTreeSet::new();
        let mut used = BTreeSet::new();
        let mut fans: BTreeMap<u32, BTreeMap<u32, u32>> = BTreeMap::new();
        for &[a, b, c] in m.triangles() {
            for (p, q, r) in [(a, b, c), (b, c, a), (c, a, b)] {
                if p == q || !edges.insert((p, q)) {
                    return Err(format!("edge {p} {q} twice"));
                }
                fans.entry(p).or_default().insert(q, r);
                used.insert(p);
            }
        }
        if let Some((a, b)) = edges.iter().find(|(a, b)| !edges.contains(&(*b, *a))) {
            return Err(format!("edge {a} {b} open"));
        }
        if used.len() != m.vertices().len() {
            return Err("unused vertices".into());
        }
        for (v, fan) in fans {
            let first = *fan.keys().next().unwrap();
            let mut at = fan[&first];
            let mut length = 1;
            while at != first {
                at = fan[&at];
                length += 1;
            }
            if length != fan.len() {
                return Err(format!("vertex {v} has more than one fan"));
            }
        }
        Ok(())
    }

    /// The raw net, before smoothing, bounds exactly the voxels.
    fn check(g: &BitGrid) -> Result<(), String> {
        let m = surface(g, &unit(g.dims())).unwrap();
        check_manifold(&m)?;
        let mut net = Net::of(g, None);
        let triangles = net.triangles();
        let raw = TriMesh::new(net.points, triangles).unwrap();
        check_manifold(&raw)?;
        if (raw.signed_volume() - g.count() as f64).abs() > 1e-6 {
            return Err(format!("volume {} of {} voxels", raw.signed_volume(), g.count()));
        }
        Ok(())
    }

    #[test]
    fn every_set_of_eight_voxels_has_a_manifold_surface() {
        for pattern in 0..256usize {
            let g = BitGrid::from_fn([2; 3], |[x, y, z]| pattern >> (x + 2 * y + 4 * z) & 1 == 1);
            check(&g).unwrap_or_else(|e| panic!("{pattern:08b}: {e}"));
        }
    }

    /// A checkerboard around one edge, its ends joined in every way by the voxels about it.
    #[test]
    fn every_way_around_a_pinched_edge_has_a_manifold_surface() {
        let mut split = 0;
        for pattern in 0..256usize {
            let g = BitGrid::from_fn([2, 2, 3], |[x, y, z]| {
                if z == 1 { x == y } else { pattern >> (x + 2 * y + 2 * z) & 1 == 1 }
            });
            check(&g).unwrap_or_else(|e| panic!("{pattern:08b}: {e}"));
            split += Net::of(&g, None).pinched.len();
        }
        assert!(split > 0, "the case this is about never came up");
    }

    proptest! {
        #[test]
        fn random_sets_have_manifold_surfaces(
            x in 1usize..70, y in 1usize..7, z in 1usize..7, full in 1u32..10, seed in any::<u64>(),
        ) {
            let mut r = crate::base::rng(seed, 0);
            let bits: Vec<bool> = (0..x * y * z).map(|_| r.random_range(0..10) < full).collect();
            let g = BitGrid::from_fn([x, y, z], |[i, j, k]| bits[i + x * (j + y * k)]);
            prop_assert_eq!(check(&g), Ok(()));
        }
    }

    #[test]
    fn vertices_stay_within_half_a_voxel_and_a_ball_keeps_its_volume() {
        let g = BitGrid::from_fn([50; 3], |v| {
            let d = DVec3::from_array(v.map(|c| c as f64 - 24.6));
            d.length() < 22.0
        });
        let frame = Frame { pitch: 0.5, dims: [50; 3], origin: DVec3::new(1.0, 2.0, 3.0) };
        let m = surface(&g, &frame).unwrap();
        let volume = g.count() as f64 * frame.voxel_volume();
        assert!((m.signed_volume() / volume - 1.0).abs() < 0.01, "{}", m.signed_volume() / volume);
        let center = frame.center([0; 3]) + 24.6 * 0.5;
        let off = |p: &DVec3| (p.distance(center) / 0.5 - 22.0).abs();
        let worst = m.vertices().iter().map(off).fold(0.0, f64::max);
        assert!(worst < 3f64.sqrt(), "{worst}");
        // A staircase has half again the area of its ball.
        let ball = 4.0 * std::f64::consts::PI * 121.0;
        assert!((m.area() / ball - 1.0).abs() < 0.1, "{}", m.area() / ball);
    }

    #[test]
    fn smoothing_thins_a_rod_but_never_loses_it() {
        let one = BitGrid::from_fn([3; 3], |v| v == [1; 3]);
        let rod = BitGrid::from_fn([40, 3, 3], |[_, y, z]| y == 1 && z == 1);
        for (g, least) in [(one, 0.1), (rod, 18.0)] {
            let volume = surface(&g, &unit(g.dims())).unwrap().signed_volume();
            assert!(volume > least && volume < 1.02 * g.count() as f64, "{volume}");
        }
        assert!(surface(&BitGrid::new([3; 3]), &unit([3; 3])).unwrap().is_empty());
        assert!(surface(&BitGrid::new([0, 3, 3]), &unit([0, 3, 3])).unwrap().is_empty());
    }
}
