//! Printing bases: the interface between reused and added volume (W2V Sec. 3.1).
//!
//! A component b of the interface is *plano-convex* when it is a union of planar facets, convex
//! across every facet edge as the nozzle sees it. Voxel faces know six normals only, so points
//! and normals come from the nearest triangle of M: the interface lies on its surface.
//!
//! With a tolerance, a base that is concave by no more counts as plano-convex too: across an edge it
//! may rise so far over a facet, and a shallow dish as deep as that is one facet. (The paper names
//! slightly concave bases as future work.)

use crate::base::{DVec3, Direction};
use crate::mesh::{NearestTriangle, TriMesh};
use crate::voxel::{BitGrid, Connectivity, Frame, components};
use std::collections::VecDeque;

/// Normals of one facet lie this close, degrees. Coarser would hide an edge on which a flat
/// nozzle rides (2 mm radius × tan 5° ≈ one layer of 0.2 mm); finer splits scanned planes.
const FACET_ANGLE_DEG: f64 = 5.0;

/// Points of one facet lie this close to its plane, in pitches: the surface of M is exact, so
/// this only absorbs tessellation.
const FACET_DISTANCE_PITCHES: f64 = 0.5;

/// Share of a base that may belong to no facet of useful size: the rim of a base straddles
/// neighbouring faces by a voxel or two.
const STRAY_SHARE: f64 = 0.1;

/// Smallest facet in voxels that a nozzle could tell from its rim.
const SMALLEST_FACET: usize = 6;

/// A planar piece of a base.
#[derive(Clone, Debug)]
pub struct Facet {
    /// Outward of the reused volume: the direction to print along.
    pub normal: Direction,
    /// normal · x on the facet, mm.
    pub offset: f64,
    /// Number of base voxels on it.
    pub voxels: usize,
}

/// One connected component of the interface.
#[derive(Clone, Debug)]
pub struct PrintingBase {
    /// Points on M's surface, one per base voxel, mm.
    pub points: Vec<DVec3>,
    /// Facets of useful size, largest first.
    pub facets: Vec<Facet>,
    pub plano_convex: bool,
}

/// The bases between `reused` and `added`, by the surface of the initial part; they may be concave
/// by `tolerance_mm`.
pub fn printing_bases(
    reused: &BitGrid,
    added: &BitGrid,
    surface: &TriMesh,
    frame: &Frame,
    tolerance_mm: f64,
) -> Vec<PrintingBase> {
    let h = frame.pitch;
    let contact = touching(reused, added);
    let labels = components(&contact, Connectivity::Corner26);
    let index = NearestTriangle::new(surface, 2.0 * h);
    let mut voxels: Vec<Vec<[usize; 3]>> = vec![Vec::new(); labels.count()];
    for v in contact.iter_ones() {
        if let Some(l) = labels.label_of(v) {
            voxels[l as usize].push(v);
        }
    }
    voxels.iter().map(|vs| base_of(vs, &index, frame, tolerance_mm)).collect()
}

/// Voxels of `a` with a face neighbour in `b`.
fn touching(a: &BitGrid, b: &BitGrid) -> BitGrid {
    let mut out = BitGrid::new(a.dims());
    for v in b.boundary().iter_ones() {
        for axis in 0..3 {
            for step in [-1i64, 1] {
                let mut q = v.map(|c| c as i64);
                q[axis] += step;
                if a.get_or_empty(q) {
                    out.set(q.map(|c| c as usize), true);
                }
            }
        }
    }
    out
}

fn base_of(
    voxels: &[[usize; 3]],
    index: &NearestTriangle,
    frame: &Frame,
    tolerance_mm: f64,
) -> PrintingBase {
    let samples: Vec<(DVec3, DVec3)> = voxels
        .iter()
        .map(|v| {
            let c = frame.center(*v);
            // A base voxel without a triangle nearby lies on a cut of M's own voxelisation (an
            // inner wall): its normal is unknown and it joins no facet.
            index.query(c).map_or((c, DVec3::ZERO), |s| (s.point, s.normal))
        })
        .collect();
    let facet_of = segment(voxels, &samples, frame.pitch);
    let count = facet_of.iter().flatten().max().map_or(0, |m| m + 1);
    let mut members: Vec<Vec<usize>> = vec![Vec::new(); count];
    for (i, f) in facet_of.iter().enumerate() {
        if let Some(f) = f {
            members[*f].push(i);
        }
    }
    members.retain(|m| m.len() >= SMALLEST_FACET);
    members.sort_by_key(|m| (std::cmp::Reverse(m.len()), m[0]));
    let facets: Vec<Facet> = members.iter().filter_map(|m| fit(m, &samples)).collect();
    let on_facets: usize = members.iter().map(Vec::len).sum();
    let planar = (voxels.len() - on_facets) as f64 <= STRAY_SHARE * voxels.len() as f64;
    let slack = (FACET_DISTANCE_PITCHES + 0.5) * frame.pitch + tolerance_mm;
    let convex = facets
        .iter()
        .all(|f| members.iter().flatten().all(|&i| f.normal.dot(samples[i].0) - f.offset <= slack));
    let plano_convex = planar && convex && !facets.is_empty();
    let points = samples.iter().map(|s| s.0).collect();
    match shallow(&samples, slack) {
        Some(facet) if !plano_convex && tolerance_mm > 0.0 => {
            PrintingBase { points, facets: vec![facet], plano_convex: true }
        }
        _ => PrintingBase { points, facets, plano_convex },
    }
}

/// All of a base as one facet, if it lies within a layer so thick (mm) across its mean normal.
fn shallow(samples: &[(DVec3, DVec3)], thickness: f64) -> Option<Facet> {
    let all: Vec<usize> = (0..samples.len()).collect();
    let facet = fit(&all, samples)?;
    let heights = samples.iter().map(|s| facet.normal.dot(s.0));
    let (low, high) = heights
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), h| (low.min(h), high.max(h)));
    (high - low <= thickness).then_some(facet)
}

/// Grows facets over neighbouring base voxels; None where a voxel's normal is unknown.
fn segment(voxels: &[[usize; 3]], samples: &[(DVec3, DVec3)], pitch: f64) -> Vec<Option<usize>> {
    let at: std::collections::HashMap<[usize; 3], usize> =
        voxels.iter().enumerate().map(|(i, v)| (*v, i)).collect();
    let least_cosine = FACET_ANGLE_DEG.to_radians().cos();
    let mut facet_of: Vec<Option<usize>> = vec![None; voxels.len()];
    let mut facets = 0;
    for seed in 0..voxels.len() {
        if facet_of[seed].is_some() || samples[seed].1 == DVec3::ZERO {
            continue;
        }
        let (origin, normal) = samples[seed];
        facet_of[seed] = Some(facets);
        let mut queue = VecDeque::from([seed]);
        while let Some(i) = queue.pop_front() {
            for n in neighbours(voxels[i]) {
                let Some(&j) = at.get(&n) else { continue };
                let flat = samples[j].1.dot(normal) >= least_cosine
                    && (samples[j].0 - origin).dot(normal).abs() <= FACET_DISTANCE_PITCHES * pitch;
                if facet_of[j].is_none() && flat {
                    facet_of[j] = Some(facets);
                    queue.push_back(j);
                }
            }
        }
        facets += 1;
    }
    facet_of
}

fn neighbours(v: [usize; 3]) -> impl Iterator<Item = [usize; 3]> {
    (0..27).filter(|i| *i != 13).map(move |i| {
        let d = [i % 3, i / 3 % 3, i / 9];
        // Wraps to a coordinate no grid has when it would go below zero.
        std::array::from_fn(|a| (v[a] + d[a]).wrapping_sub(1))
    })
}

/// The facet through its members: mean normal, highest offset (nothing of it stands above).
fn fit(members: &[usize], samples: &[(DVec3, DVec3)]) -> Option<Facet> {
    let normal = Direction::new(members.iter().map(|&i| samples[i].1).sum()).ok()?;
    let offset =
        members.iter().map(|&i| normal.dot(samples[i].0)).sum::<f64>() / members.len() as f64;
    Some(Facet { normal, offset, voxels: members.len() })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bases of a solid given as mesh, with `added` above it.
    fn bases(
        mesh: &TriMesh,
        solid: impl Fn(DVec3) -> bool + Sync,
        added: impl Fn(DVec3) -> bool + Sync,
    ) -> Vec<PrintingBase> {
        bases_within(0.0, mesh, solid, added)
    }

    fn bases_within(
        tolerance_mm: f64,
        mesh: &TriMesh,
        solid: impl Fn(DVec3) -> bool + Sync,
        added: impl Fn(DVec3) -> bool + Sync,
    ) -> Vec<PrintingBase> {
        let frame = Frame { pitch: 0.5, dims: [44, 44, 44], origin: DVec3::splat(-1.0) };
        let reused = BitGrid::from_fn(frame.dims, |v| solid(frame.center(v)));
        let added =
            BitGrid::from_fn(frame.dims, |v| added(frame.center(v)) && !solid(frame.center(v)));
        printing_bases(&reused, &added, mesh, &frame, tolerance_mm)
    }

    /// A block of 20 mm whose top is a valley of two planes, `depth` mm deep in its middle.
    fn valley(depth: f64) -> TriMesh {
        let top = |x: f64| 10.0 - depth * (1.0 - (x - 10.0).abs() / 10.0);
        let corners = [(0.0, 0.0), (20.0, 0.0), (20.0, 20.0), (0.0, 20.0)];
        let at = |(x, y): (f64, f64), z: f64| DVec3::new(x, y, z);
        let mut v: Vec<DVec3> = corners.iter().map(|c| at(*c, 0.0)).collect();
        v.extend(corners.iter().map(|c| at(*c, top(c.0))));
        v.extend([at((10.0, 0.0), top(10.0)), at((10.0, 20.0), top(10.0))]);
        let triangles = vec![
            [0, 2, 1],
            [0, 3, 2], // bottom
            [4, 8, 9],
            [4, 9, 7],
            [8, 5, 6],
            [8, 6, 9], // the two planes
            [0, 1, 5],
            [0, 5, 8],
            [0, 8, 4],
            [2, 3, 7],
            [2, 7, 9],
            [2, 9, 6], // y = 0, y = 20
            [1, 2, 6],
            [1, 6, 5],
            [3, 0, 4],
            [3, 4, 7], // x = 20, x = 0
        ];
        TriMesh::new(v, triangles).unwrap()
    }

    #[test]
    fn a_shallow_valley_is_a_base_within_the_tolerance_alone() {
        let depth = 1.5;
        let top = move |p: DVec3| 10.0 - depth * (1.0 - (p.x - 10.0).abs() / 10.0);
        let inside =
            move |p: DVec3| p.cmpgt(DVec3::ZERO).all() && p.x < 20.0 && p.y < 20.0 && p.z < top(p);
        let over = |p: DVec3| p.z > 5.0 && p.x > 1.0 && p.x < 19.0 && p.y > 4.0 && p.y < 16.0;
        let mesh = valley(depth);
        let of = |tolerance| {
            let bases = bases_within(tolerance, &mesh, inside, over);
            assert_eq!(bases.len(), 1);
            bases[0].plano_convex
        };
        assert!(!of(0.0), "a valley is not convex");
        assert!(!of(0.3), "nor by so little");
        assert!(of(1.5));
    }

    #[test]
    fn a_plane_is_plano_convex_with_its_own_normal() {
        let m = TriMesh::cuboid(DVec3::ZERO, DVec3::new(20.0, 20.0, 10.0));
        let b = bases(
            &m,
            |p| p.cmpgt(DVec3::ZERO).all() && p.cmplt(DVec3::new(20.0, 20.0, 10.0)).all(),
            |p| p.z > 10.0 && p.x > 4.0 && p.x < 12.0 && p.y > 4.0 && p.y < 12.0,
        );
        assert_eq!(b.len(), 1);
        assert!(b[0].plano_convex);
        assert!((b[0].facets[0].normal.vec() - DVec3::Z).length() < 1e-9);
        assert!((b[0].facets[0].offset - 10.0).abs() < 1e-9);
    }

    #[test]
    fn two_separate_bases_are_two_and_an_inner_corner_is_not_convex() {
        let m = TriMesh::cuboid(DVec3::ZERO, DVec3::new(20.0, 20.0, 10.0));
        let inside =
            |p: DVec3| p.cmpgt(DVec3::ZERO).all() && p.cmplt(DVec3::new(20.0, 20.0, 10.0)).all();
        let two = bases(&m, inside, |p| {
            p.z > 10.0
                && p.y > 2.0
                && p.y < 8.0
                && ((2.0..6.0).contains(&p.x) || (12.0..16.0).contains(&p.x))
        });
        assert_eq!(two.len(), 2);
        assert!(two.iter().all(|b| b.plano_convex));
        // A step: a low floor and a wall beside it, filled.
        let mut step = TriMesh::cuboid(DVec3::ZERO, DVec3::new(20.0, 20.0, 6.0));
        let wall = TriMesh::cuboid(DVec3::new(10.0, 0.0, 0.0), DVec3::new(20.0, 20.0, 14.0));
        let shift = step.vertices().len() as u32;
        step = TriMesh::new(
            step.vertices().iter().chain(wall.vertices()).copied().collect(),
            step.triangles()
                .iter()
                .copied()
                .chain(wall.triangles().iter().map(|t| t.map(|i| i + shift)))
                .collect(),
        )
        .unwrap();
        let solid = |p: DVec3| {
            p.cmpgt(DVec3::ZERO).all()
                && p.x < 20.0
                && p.y < 20.0
                && (p.z < 6.0 || (p.x > 10.0 && p.z < 14.0))
        };
        let corner = bases(&step, solid, |p| {
            p.z > 6.0 && p.z < 12.0 && p.x > 4.0 && p.x < 10.0 && p.y > 4.0 && p.y < 16.0
        });
        assert_eq!(corner.len(), 1);
        assert!(!corner[0].plano_convex, "a valley is not convex");
        let roof = bases(&step, solid, |p| {
            // Around the outer edge of the wall: top and side, seen from outside convex.
            (p.z > 14.0 || p.x > 20.0)
                && p.z < 16.0
                && p.x > 15.0
                && p.z > 11.0
                && p.y > 4.0
                && p.y < 16.0
        });
        assert_eq!(roof.len(), 1);
        assert!(roof[0].plano_convex && roof[0].facets.len() == 2, "{roof:?}");
    }
}
