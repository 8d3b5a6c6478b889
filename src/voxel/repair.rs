//! Makes a triangle soup ready for winding numbers: welded, without coincident copies, oriented.
//!
//! 1. Vertices at the same position become one; triangles that lose a corner by it are dropped.
//! 2. Coincident triangles become one. A wall that two adjoining bodies share is dropped wholly:
//!    that leaves two faces at every edge where keeping it would leave three.
//! 3. Orientation is carried over every edge with exactly two triangles; each patch so connected
//!    then keeps the orientation most of its area came with.
//! 4. Patches that need one another to close form a body. A body that no other body encloses is
//!    turned outward, by the signed volume of the body with its holes coned shut, and what it
//!    encloses turns with it. An enclosed shell otherwise keeps its orientation: inward it is a
//!    void, outward an inner body. Where the faces themselves disagree about it, it is a void.
//! 5. Open sheets without a volume of their own keep their orientation, unless together they
//!    close a volume that is inside out.
//!
//! Not mended: a lobe that a self-intersection of one closed surface turns inside out (its winding
//! number is −1, so it is empty), and separate open sheets of which only some are reversed.

use super::loops::{Edge, boundary_loops, cone};
use super::winding::{crossings_beyond, solid_angle};
use crate::base::{Aabb, DVec3};
use crate::mesh::TriMesh;
use rayon::prelude::*;
use std::f64::consts::PI;

/// A welded triangle soup whose orientation has been decided.
pub(super) struct Oriented {
    pub vertices: Vec<DVec3>,
    pub triangles: Vec<[u32; 3]>,
}

impl Oriented {
    fn corners(&self, t: u32) -> [DVec3; 3] {
        self.triangles[t as usize].map(|i| self.vertices[i as usize])
    }
}

/// Below this share of area^1.5 a volume closed by cones says nothing about which side is outside
/// (a sphere has 0.094). Too small and the bend of a nearly flat sheet decides; too large and
/// shallow open shells stay inside out.
const FLAT: f64 = 1e-3;

/// Share of a shell's area that must agree before its own orientation is believed. Faces reversed
/// at random leave about two thirds in agreement; a half means nothing.
const BELIEVED: f64 = 0.6;

/// Points of a body tested to see whether another body encloses it: one alone would take two
/// overlapping bodies for nested ones.
const ENCLOSURE_SAMPLES: usize = 8;

/// One use of an undirected edge by a triangle, ordered by edge.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct EdgeUse {
    edge: (u32, u32),
    triangle: u32,
    forward: bool,
}

pub(super) fn repair(mesh: &TriMesh) -> Oriented {
    let mut soup = weld(mesh);
    drop_copies(&mut soup.triangles);
    let uses = edge_uses(&soup.triangles);
    let patches = Patches::of(&soup, &uses);
    for (t, tri) in soup.triangles.iter_mut().enumerate() {
        if patches.flipped[t] {
            tri.swap(1, 2);
        }
    }
    let mut bodies = Bodies::of(&soup, &uses, &patches);
    bodies.turn_outward(&soup);
    for (body, turn) in bodies.list.iter().zip(&bodies.turned) {
        if *turn {
            for &t in &body.triangles {
                soup.triangles[t as usize].swap(1, 2);
            }
        }
    }
    soup
}

/// One vertex a position (−0 and 0 are one); triangles with two corners in one are gone.
fn weld(mesh: &TriMesh) -> Oriented {
    let at = |i: u32| (mesh.vertices()[i as usize] + DVec3::ZERO).to_array();
    let order = |a: &u32, b: &u32| {
        let (p, q) = (at(*a), at(*b));
        p[0].total_cmp(&q[0]).then(p[1].total_cmp(&q[1])).then(p[2].total_cmp(&q[2])).then(a.cmp(b))
    };
    let mut ids: Vec<u32> = (0..mesh.vertices().len() as u32).collect();
    ids.par_sort_unstable_by(order);
    let mut first = vec![0u32; ids.len()];
    for group in ids.chunk_by(|a, b| at(*a) == at(*b)) {
        group.iter().for_each(|&i| first[i as usize] = group[0]);
    }
    let triangles = mesh
        .triangles()
        .iter()
        .map(|t| t.map(|i| first[i as usize]))
        .filter(|[a, b, c]| a != b && b != c && c != a)
        .collect();
    Oriented { vertices: mesh.vertices().to_vec(), triangles }
}

fn edge_uses(triangles: &[[u32; 3]]) -> Vec<EdgeUse> {
    let mut uses: Vec<EdgeUse> = (0..triangles.len())
        .into_par_iter()
        .flat_map_iter(|t| {
            let [a, b, c] = triangles[t];
            [(a, b), (b, c), (c, a)].map(|(u, v)| EdgeUse {
                edge: (u.min(v), u.max(v)),
                triangle: t as u32,
                forward: u < v,
            })
        })
        .collect();
    uses.par_sort_unstable();
    uses
}

/// Leaves one of each set of coincident triangles, or none where the set is a shared wall.
fn drop_copies(triangles: &mut Vec<[u32; 3]>) {
    let key = |t: [u32; 3]| {
        let mut k = t;
        k.sort_unstable();
        k
    };
    let mut order: Vec<([u32; 3], u32)> =
        triangles.par_iter().enumerate().map(|(i, t)| (key(*t), i as u32)).collect();
    order.par_sort_unstable();
    if order.windows(2).all(|w| w[0].0 != w[1].0) {
        return;
    }
    // One representative a set; `even` sets may be walls.
    let mut kept: Vec<(u32, bool)> =
        order.chunk_by(|a, b| a.0 == b.0).map(|g| (g[0].1, g.len() % 2 == 0)).collect();
    kept.sort_unstable();
    let unique: Vec<[u32; 3]> = kept.iter().map(|k| triangles[k.0 as usize]).collect();
    let uses = edge_uses(&unique);
    let mut sets = UnionFind::new(unique.len());
    let edges = || uses.chunk_by(|a, b| a.edge == b.edge);
    for e in edges() {
        if let [a, b] = e
            && kept[a.triangle as usize].1
            && kept[b.triangle as usize].1
        {
            sets.union(a.triangle, b.triangle, false);
        }
    }
    // At its rim a wall meets an even number of other faces, a doubled piece of skin an odd one.
    let mut wall_votes = vec![0i64; unique.len()];
    for e in edges() {
        let single = e.iter().filter(|u| !kept[u.triangle as usize].1).count();
        if single > 0 {
            for u in e.iter().filter(|u| kept[u.triangle as usize].1) {
                let root = sets.find(u.triangle).0 as usize;
                wall_votes[root] += if single % 2 == 0 { 1 } else { -1 };
            }
        }
    }
    *triangles = unique
        .iter()
        .enumerate()
        .filter(|(t, _)| !kept[*t].1 || wall_votes[sets.find(*t as u32).0 as usize] <= 0)
        .map(|(_, t)| *t)
        .collect();
}

/// Union-find whose members know whether they are reversed against their root.
struct UnionFind {
    parent: Vec<(u32, bool)>,
}

impl UnionFind {
    fn new(n: usize) -> Self {
        UnionFind { parent: (0..n as u32).map(|i| (i, false)).collect() }
    }

    fn find(&mut self, i: u32) -> (u32, bool) {
        let (mut root, mut reversed) = (i, false);
        while self.parent[root as usize].0 != root {
            let (p, r) = self.parent[root as usize];
            reversed ^= r;
            root = p;
        }
        let (mut at, mut rest) = (i, reversed);
        while at != root {
            let (p, r) = self.parent[at as usize];
            self.parent[at as usize] = (root, rest);
            rest ^= r;
            at = p;
        }
        (root, reversed)
    }

    /// Joins the sets of a and b, with b reversed against a where `reversed`; the smaller index
    /// becomes the root. A contradiction (a one-sided surface) is left as it is.
    fn union(&mut self, a: u32, b: u32, reversed: bool) {
        let ((ra, fa), (rb, fb)) = (self.find(a), self.find(b));
        if ra != rb {
            self.parent[ra.max(rb) as usize] = (ra.min(rb), fa ^ fb ^ reversed);
        }
    }
}

/// Triangles connected over two-triangle edges, consistently oriented.
struct Patches {
    root: Vec<u32>,
    flipped: Vec<bool>,
}

impl Patches {
    fn of(soup: &Oriented, uses: &[EdgeUse]) -> Patches {
        let n = soup.triangles.len();
        let mut sets = UnionFind::new(n);
        for e in uses.chunk_by(|a, b| a.edge == b.edge) {
            if let [a, b] = e {
                sets.union(a.triangle, b.triangle, a.forward == b.forward);
            }
        }
        let mut area = vec![[0.0f64; 2]; n];
        let found: Vec<(u32, bool)> = (0..n as u32).map(|t| sets.find(t)).collect();
        for (t, &(root, reversed)) in found.iter().enumerate() {
            area[root as usize][reversed as usize] += triangle_area(soup.corners(t as u32));
        }
        let flipped = found
            .iter()
            .map(|&(root, reversed)| {
                let [as_is, against] = area[root as usize];
                reversed ^ (against > as_is)
            })
            .collect();
        Patches { root: found.iter().map(|f| f.0).collect(), flipped }
    }
}

fn triangle_area([a, b, c]: [DVec3; 3]) -> f64 {
    (b - a).cross(c - a).length() / 2.0
}

/// Patches that close one another.
struct Body {
    triangles: Vec<u32>,
    bounds: Aabb,
    area: f64,
    /// Share of the area whose orientation was left as it came.
    agreement: f64,
    closed: bool,
    /// mm³, holes coned shut.
    volume: f64,
}

struct Bodies {
    list: Vec<Body>,
    turned: Vec<bool>,
}

impl Bodies {
    fn of(soup: &Oriented, uses: &[EdgeUse], patches: &Patches) -> Bodies {
        let n = soup.triangles.len();
        let mut sets = UnionFind::new(n);
        let mut rims: Vec<(u32, Edge)> = Vec::new();
        let mut nets: Vec<(u32, i64)> = Vec::new();
        for e in uses.chunk_by(|a, b| a.edge == b.edge) {
            nets.clear();
            for u in e {
                let t = u.triangle as usize;
                let sign = if u.forward != patches.flipped[t] { 1 } else { -1 };
                match nets.iter_mut().find(|p| p.0 == patches.root[t]) {
                    Some(p) => p.1 += sign,
                    None => nets.push((patches.root[t], sign)),
                }
            }
            // Patches that are not balanced along this edge by themselves need one another.
            nets.retain(|p| p.1 != 0);
            for w in nets.windows(2) {
                sets.union(w[0].0, w[1].0, false);
            }
            let net: i64 = nets.iter().map(|p| p.1).sum();
            if net != 0 {
                let (u, v) = if net > 0 { e[0].edge } else { (e[0].edge.1, e[0].edge.0) };
                let patch = nets[0].0;
                rims.extend((0..net.unsigned_abs()).map(|_| (patch, Edge { from: u, to: v })));
            }
        }
        let mut members: Vec<(u32, u32)> =
            (0..n as u32).map(|t| (sets.find(patches.root[t as usize]).0, t)).collect();
        members.sort_unstable();
        for r in &mut rims {
            r.0 = sets.find(r.0).0;
        }
        rims.sort_unstable();
        let list: Vec<Body> = members
            .chunk_by(|a, b| a.0 == b.0)
            .map(|group| {
                let lo = rims.partition_point(|r| r.0 < group[0].0);
                let hi = rims.partition_point(|r| r.0 <= group[0].0);
                let rim: Vec<Edge> = rims[lo..hi].iter().map(|r| r.1).collect();
                body(soup, patches, group.iter().map(|m| m.1).collect(), rim)
            })
            .collect();
        let turned = vec![false; list.len()];
        Bodies { list, turned }
    }

    /// Step 4 and 5 of the module's head.
    fn turn_outward(&mut self, soup: &Oriented) {
        let list = &self.list;
        let mut by_size: Vec<usize> = (0..list.len()).collect();
        let extent = |i: usize| list[i].bounds.size().length_squared();
        by_size.sort_by(|&a, &b| extent(b).total_cmp(&extent(a)).then(a.cmp(&b)));
        // Who encloses the bodies whose orientation is in question, or whose keeper may turn.
        let questionable = |i: usize| {
            let b = &list[i];
            b.inside_out() || (b.has_volume() && b.agreement < BELIEVED)
        };
        let any_inside_out = list.iter().any(Body::inside_out);
        let keepers: Vec<Vec<usize>> = (0..list.len())
            .into_par_iter()
            .map(|i| {
                if !questionable(i) && !any_inside_out {
                    return Vec::new();
                }
                by_size
                    .iter()
                    .copied()
                    .take_while(|&j| extent(j) >= extent(i))
                    .filter(|&j| j != i && encloses(soup, &list[j], &list[i]))
                    .collect()
            })
            .collect();
        for &i in &by_size {
            let b = &list[i];
            self.turned[i] = if keepers[i].is_empty() {
                b.inside_out()
            } else if b.has_volume() && b.agreement < BELIEVED {
                b.inside_out() != (keepers[i].len() % 2 == 1)
            } else {
                // The outermost keeper tells which way the file counts.
                self.turned[keepers[i][0]]
            };
        }
        self.turn_sheets(soup);
    }

    fn turn_sheets(&mut self, soup: &Oriented) {
        let sheets: Vec<usize> =
            (0..self.list.len()).filter(|&i| !self.list[i].has_volume()).collect();
        let bounds = sheets.iter().fold(Aabb::EMPTY, |b, &i| b.union(self.list[i].bounds));
        let area: f64 = sheets.iter().map(|&i| self.list[i].area).sum();
        let volume: f64 = sheets
            .iter()
            .flat_map(|&i| &self.list[i].triangles)
            .map(|&t| signed_volume(soup.corners(t), bounds.center()))
            .sum();
        if volume < -FLAT * area.powf(1.5) {
            sheets.iter().for_each(|&i| self.turned[i] = true);
        }
    }
}

impl Body {
    /// Whether the sign of its volume means anything.
    fn has_volume(&self) -> bool {
        self.closed || self.volume.abs() > FLAT * self.area.powf(1.5)
    }

    fn inside_out(&self) -> bool {
        self.volume < 0.0 && self.has_volume()
    }
}

fn signed_volume([a, b, c]: [DVec3; 3], o: DVec3) -> f64 {
    (a - o).dot((b - o).cross(c - o)) / 6.0
}

fn body(soup: &Oriented, patches: &Patches, triangles: Vec<u32>, rim: Vec<Edge>) -> Body {
    let bounds = Aabb::of(triangles.iter().flat_map(|&t| soup.corners(t)));
    let o = bounds.center();
    let (mut area, mut kept, mut volume) = (0.0, 0.0, 0.0);
    for &t in &triangles {
        let a = triangle_area(soup.corners(t));
        area += a;
        kept += if patches.flipped[t as usize] { 0.0 } else { a };
        volume += signed_volume(soup.corners(t), o);
    }
    let closed = rim.is_empty();
    for l in boundary_loops(rim) {
        let points: Vec<DVec3> = l.iter().map(|&i| soup.vertices[i as usize]).collect();
        volume += cone(&points, DVec3::ZERO).map(|t| signed_volume(t, o)).sum::<f64>();
    }
    let agreement = if area > 0.0 { kept / area } else { 1.0 };
    Body { triangles, bounds, area, agreement, closed, volume }
}

/// Whether `outer`, turned either way, winds around every sampled point of `inner`.
fn encloses(soup: &Oriented, outer: &Body, inner: &Body) -> bool {
    let (o, i) = (outer.bounds, inner.bounds);
    if !(outer.has_volume() && o.min.cmple(i.min).all() && o.max.cmpge(i.max).all()) {
        return false;
    }
    let step = inner.triangles.len().div_ceil(ENCLOSURE_SAMPLES);
    inner.triangles.iter().step_by(step).all(|&t| {
        let [a, b, c] = soup.corners(t);
        let p = (a + b + c) / 3.0;
        let around = outer.triangles.iter().map(|&t| soup.corners(t));
        if outer.closed {
            around.map(|t| crossings_beyond(t, p)).sum::<i32>() != 0
        } else {
            around.map(|t| solid_angle(t, p)).sum::<f64>().abs() > 2.0 * PI
        }
    })
}
