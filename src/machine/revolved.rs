//! Tools drawn as meshes: what a closed surface sweeps when it turns about the tool's axis.
//!
//! Method. Between two heights the radius of the swept solid is that of the outermost edge of the
//! mesh there, since the radius is convex along every edge and every face; along an edge a chord of
//! it lies outside, so that frusta between the heights of all vertices enclose the solid. Neighbours
//! are then joined as long as that adds no more than [`JOINED_MM`] of radius.
//!
//! Guarantees: the frusta enclose a closed mesh, to a micrometre of height, whichever way its triangles are
//! oriented; what is thinner than that is not seen. They are filled to the axis: more than the tool,
//! never less, which is right for what must not touch and wrong for what cuts, so an edge is never drawn as
//! a mesh. Not guaranteed: that a mesh lies where it should; its axis is z and points up.

use super::tool::Shape;
use crate::base::DVec3;
use crate::mesh::TriMesh;

/// Radius that joining two pieces may add, mm: below what any machine holds.
const JOINED_MM: f64 = 0.01;

/// Pieces of one mesh: each costs time wherever the tool is drawn. A real holder has some ten; threads and
/// knurls have hundreds, and are better left out.
const MOST_PIECES: usize = 48;

/// Slices of one mesh: a finer one is cut into so many of equal height.
const MOST_SLICES: usize = 4096;

/// Triangles of a tool. More show no more of it.
const MOST_TRIANGLES: usize = 500_000;

/// Heights closer than this are the same, mm: those of one plane differ so in single precision.
const SAME_HEIGHT_MM: f64 = 1e-3;

/// A slice of the swept solid: heights and radii of its lower and its upper end, mm.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Slice {
    z: [f64; 2],
    r: [f64; 2],
}

/// The solid that a closed mesh (mm, tip at the origin, axis +z) sweeps about z, as frusta from the
/// tip upward.
///
/// # Errors
/// What is wrong with the mesh: below the tip, beside the axis, flat, or too fine.
pub fn frusta(mesh: &TriMesh) -> Result<Vec<Shape>, String> {
    let count = mesh.triangles().len();
    if count > MOST_TRIANGLES {
        return Err(format!("{count} triangles; give at most {MOST_TRIANGLES}"));
    }
    let lowest = mesh.bounds().min.z;
    if lowest < -SAME_HEIGHT_MM {
        return Err(format!(
            "the mesh reaches down to z = {lowest} mm; the tip is at z = 0 and the axis points up"
        ));
    }
    let bounds = mesh.bounds();
    if bounds.min.truncate().max_element() > 0.0 || bounds.max.truncate().min_element() < 0.0 {
        return Err("the mesh lies beside x = y = 0, the tool's axis".into());
    }
    let slices = slices(mesh);
    if slices.is_empty() {
        return Err("the mesh has no height along z, the tool's axis".into());
    }
    let pieces = joined(&slices);
    if pieces.len() > MOST_PIECES {
        return Err(format!(
            "its outline has {} steps; give at most {MOST_PIECES}, leave out threads and knurls",
            pieces.len()
        ));
    }
    let frustum = |s: &Slice| Shape::Frustum { z0: s.z[0], r0: s.r[0], z1: s.z[1], r1: s.r[1] };
    Ok(pieces.iter().map(frustum).collect())
}

/// Heights between which every edge is cut, from the lowest; the first is 0 if it is that of the tip.
fn heights(mesh: &TriMesh) -> Vec<f64> {
    let corners = (0..mesh.triangles().len()).flat_map(|t| mesh.corners(t));
    let mut all: Vec<f64> = corners.map(|v| v.z.max(0.0)).collect();
    all.sort_by(f64::total_cmp);
    all.dedup_by(|next, kept| *next - *kept <= SAME_HEIGHT_MM);
    if let Some(first) = all.first_mut().filter(|z| **z <= SAME_HEIGHT_MM) {
        *first = 0.0;
    }
    match (all.first().copied(), all.last().copied()) {
        (Some(low), Some(high)) if all.len() > MOST_SLICES + 1 => {
            let step = (high - low) / MOST_SLICES as f64;
            (0..=MOST_SLICES).map(|i| low + step * i as f64).collect()
        }
        _ => all,
    }
}

fn slices(mesh: &TriMesh) -> Vec<Slice> {
    let heights = heights(mesh);
    let mut slices: Vec<Slice> =
        heights.windows(2).map(|z| Slice { z: [z[0], z[1]], r: [0.0; 2] }).collect();
    for t in 0..mesh.triangles().len() {
        let corners = mesh.corners(t).map(|c| snapped(c, &heights));
        for (a, b) in [(0, 1), (1, 2), (2, 0)] {
            let (low, high) = match corners[a].z < corners[b].z {
                true => (corners[a], corners[b]),
                false => (corners[b], corners[a]),
            };
            if low.z < high.z {
                widen(&mut slices, low, high);
            }
        }
    }
    slices.retain(|s| s.r[0].max(s.r[1]) > 0.0);
    slices
}

/// The point at the height that its own was counted as.
fn snapped(p: DVec3, heights: &[f64]) -> DVec3 {
    let above = heights.partition_point(|z| *z < p.z);
    let near = |i: usize| heights.get(i).filter(|z| (**z - p.z).abs() <= SAME_HEIGHT_MM);
    let z = near(above).or_else(|| near(above.wrapping_sub(1))).copied().unwrap_or(p.z);
    DVec3::new(p.x, p.y, z)
}

/// Takes in an edge from `a` up to `b`.
fn widen(slices: &mut [Slice], a: DVec3, b: DVec3) {
    let radius = |z: f64| a.lerp(b, (z - a.z) / (b.z - a.z)).truncate().length();
    let first = slices.partition_point(|s| s.z[1] <= a.z);
    for slice in slices[first..].iter_mut().take_while(|s| s.z[0] < b.z) {
        let own = [slice.z[0].max(a.z), slice.z[1].min(b.z)];
        let mut r = own.map(radius);
        if own != slice.z {
            // It ends in between: the slice is that wide throughout.
            r = [r[0].max(r[1]); 2];
        }
        (0..2).for_each(|i| slice.r[i] = slice.r[i].max(r[i]));
    }
}

/// Fewer slices that enclose the given ones, nowhere wider by more than [`JOINED_MM`].
fn joined(slices: &[Slice]) -> Vec<Slice> {
    let mut out = Vec::new();
    let mut first = 0;
    while first < slices.len() {
        let mut piece = slices[first];
        let mut next = first + 1;
        while next < slices.len() {
            let Some(wider) = enclosing(&slices[first..=next]) else { break };
            piece = wider;
            next += 1;
        }
        out.push(piece);
        first = next;
    }
    out
}

/// One slice around several; none where it would be wider than one of them by more than [`JOINED_MM`]
/// somewhere, or where they do not follow on one another.
fn enclosing(slices: &[Slice]) -> Option<Slice> {
    let (low, high) = (slices.first()?, slices.last()?);
    if slices.windows(2).any(|s| s[0].z[1] != s[1].z[0]) {
        return None;
    }
    let (z, r) = ([low.z[0], high.z[1]], [low.r[0], high.r[1]]);
    let line = |at: f64| r[0] + (r[1] - r[0]) * (at - z[0]) / (z[1] - z[0]);
    let over = slices.iter().flat_map(|s| [0, 1].map(|i| line(s.z[i]) - s.r[i]));
    let (least, largest) =
        over.fold((0.0_f64, 0.0_f64), |(least, largest), o| (least.min(o), largest.max(o)));
    (largest - least <= JOINED_MM).then(|| Slice { z, r: r.map(|r| r - least) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A surface through rings of points, closed by a fan at either end.
    fn lathe(rings: &[(f64, Vec<f64>)]) -> TriMesh {
        let n = rings[0].1.len();
        let mut vertices = Vec::new();
        for (z, radii) in rings {
            for (i, r) in radii.iter().enumerate() {
                let a = std::f64::consts::TAU * i as f64 / n as f64;
                vertices.push(DVec3::new(r * a.cos(), r * a.sin(), *z));
            }
        }
        let at = |ring: usize, i: usize| (ring * n + i % n) as u32;
        let mut triangles = Vec::new();
        for ring in 1..rings.len() {
            for i in 0..n {
                let [a, b, c, d] =
                    [at(ring - 1, i), at(ring - 1, i + 1), at(ring, i), at(ring, i + 1)];
                triangles.extend([[a, b, d], [a, d, c]]);
            }
        }
        for i in 1..n - 1 {
            triangles.push([at(0, 0), at(0, i + 1), at(0, i)]);
            let top = rings.len() - 1;
            triangles.push([at(top, 0), at(top, i), at(top, i + 1)]);
        }
        TriMesh::new(vertices, triangles).unwrap()
    }

    fn round(z: f64, r: f64) -> (f64, Vec<f64>) {
        (z, vec![r; 24])
    }

    #[test]
    fn a_turned_nozzle_is_the_frusta_it_was_made_of() {
        let mesh = lathe(&[
            round(0.0, 0.3),
            round(12.0, 1.0),
            round(40.0, 1.0),
            round(40.0, 20.0),
            round(100.0, 20.0),
        ]);
        let near = |a: f64, b: f64| (a - b).abs() < 1e-9;
        let pieces = frusta(&mesh).unwrap();
        let wanted = [(0.0, 0.3, 12.0, 1.0), (12.0, 1.0, 40.0, 1.0), (40.0, 20.0, 100.0, 20.0)];
        assert_eq!(pieces.len(), 3);
        for (p, w) in pieces.iter().zip(wanted) {
            let Shape::Frustum { z0, r0, z1, r1 } = *p else { panic!("{p:?}") };
            assert!(near(z0, w.0) && near(r0, w.1) && near(z1, w.2) && near(r1, w.3), "{p:?}");
        }
    }

    #[test]
    fn a_hexagon_takes_the_room_of_its_corners() {
        let hexagon = |z: f64| (z, vec![2.0; 6]);
        let pieces = frusta(&lathe(&[hexagon(0.0), hexagon(5.0)])).unwrap();
        assert_eq!(pieces.len(), 1);
        assert!((pieces[0].max_radius() - 2.0).abs() < 1e-12);
    }

    #[test]
    fn fine_balls_become_few_pieces() {
        let ring = |i: usize| {
            let a = std::f64::consts::PI * (i as f64 + 0.5) / 6000.0;
            round(1.5 - 1.5 * a.cos(), 1.5 * a.sin())
        };
        let mesh = lathe(&(0..6000).map(ring).collect::<Vec<_>>());
        let pieces = frusta(&mesh).unwrap();
        assert!((2..=MOST_PIECES).contains(&pieces.len()), "{}", pieces.len());
        for z in (1..300).map(|i| i as f64 * 0.01) {
            let r = pieces.iter().filter_map(|p| p.radius_at(z)).fold(0.0, f64::max);
            let ball = (1.5_f64.powi(2) - (1.5 - z).powi(2)).sqrt();
            assert!((ball - 1e-3..ball + 0.02).contains(&r), "at {z}: {r}, a ball has {ball}");
        }
    }

    /// Seventy discs apart, and a comb: outlines that no few pieces enclose closely.
    #[test]
    fn combs_are_refused() {
        let disc = |i: usize| {
            let z = 2.0 * i as f64;
            TriMesh::cuboid(DVec3::new(-3.0, -3.0, z), DVec3::new(3.0, 3.0, z + 1.0))
        };
        let discs = TriMesh::joined(&(0..70).map(disc).collect::<Vec<_>>());
        assert!(frusta(&discs).unwrap_err().contains("70 steps"));
        let teeth = (0..200).map(|i| round(i as f64, if i % 2 == 0 { 1.0 } else { 4.0 }));
        assert!(frusta(&lathe(&teeth.collect::<Vec<_>>())).unwrap_err().contains("steps"));
    }

    #[test]
    fn what_is_no_tool_is_refused() {
        let below = TriMesh::cuboid(DVec3::splat(-1.0), DVec3::ONE);
        assert!(frusta(&below).unwrap_err().contains("reaches down to z = -1"));
        let beside = TriMesh::cuboid(DVec3::new(5.0, 5.0, 0.0), DVec3::new(7.0, 7.0, 9.0));
        assert!(frusta(&beside).unwrap_err().contains("beside x = y = 0"));
        let flat = TriMesh::new(vec![DVec3::ZERO, DVec3::X, DVec3::Y], vec![[0, 1, 2]]).unwrap();
        assert!(frusta(&flat).unwrap_err().contains("no height"));
    }

    proptest! {
        #[test]
        fn every_point_of_the_surface_is_enclosed(
            // Rings nearer than that may be a flange thinner than what is seen.
            rings in prop::collection::vec((2e-3..3.0_f64, prop::collection::vec(0.1..5.0_f64, 5)), 2..12),
            weights in prop::array::uniform3(0.01..1.0_f64),
            flipped in any::<u64>(),
        ) {
            let mut z = 0.0;
            let rings: Vec<_> = rings.into_iter().map(|(dz, radii)| { z += dz; (z, radii) }).collect();
            let mesh = lathe(&rings);
            let turned = mesh.triangles().iter().enumerate().map(|(i, [a, b, c])| {
                if flipped >> (i % 64) & 1 == 0 { [*a, *b, *c] } else { [*a, *c, *b] }
            });
            let mesh = TriMesh::new(mesh.vertices().to_vec(), turned.collect()).unwrap();
            let Ok(pieces) = frusta(&mesh) else { return Ok(()) };
            let sum: f64 = weights.iter().sum();
            for t in 0..mesh.triangles().len() {
                let [a, b, c] = mesh.corners(t);
                let p = (a * weights[0] + b * weights[1] + c * weights[2]) / sum;
                let rho = p.truncate().length();
                let near = |dz: f64| pieces.iter().any(|s| s.contains(rho - 1e-2, p.z + dz));
                prop_assert!([-2e-3, 0.0, 2e-3].into_iter().any(near), "{p}");
            }
        }
    }
}
