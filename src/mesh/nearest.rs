use super::TriMesh;
use crate::base::{Aabb, DVec3};

/// Finds the triangle nearest to a point among those within a search distance.
///
/// Triangles are listed in the cells of a uniform grid that their boxes touch, so a query looks at
/// a handful of cells, at the point's own first and then at none that is farther than what it found. Built for queries
/// close to the surface.
pub struct NearestTriangle {
    /// Of each triangle its corners, box and unit normal; no normal of one without area.
    faces: Vec<Face>,
    cell: f64,
    origin: DVec3,
    dims: [usize; 3],
    /// CSR lists of triangles per cell.
    starts: Vec<u32>,
    triangles: Vec<u32>,
}

struct Face {
    corners: [DVec3; 3],
    within: Aabb,
    normal: Option<DVec3>,
}

/// A point of the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    pub triangle: usize,
    pub point: DVec3,
    /// Unit normal of the triangle, outward on an oriented mesh.
    pub normal: DVec3,
    pub distance: f64,
}

/// Cells per axis; more only costs memory once cells are smaller than triangles.
const MOST_CELLS: f64 = 160.0;

/// Boxes are passed over only where they are farther than the nearest point by more than rounding, mm.
const ROUNDING_MM: f64 = 1e-9;

/// How far from the nearest point of a triangle towards its middle one is looked at, to tell sides.
const AIM: f64 = 1e-3;

impl NearestTriangle {
    /// `reach` (mm) is the largest distance at which a triangle is looked for.
    pub fn new(mesh: &TriMesh, reach: f64) -> Self {
        Self::among((0..mesh.triangles().len()).map(|t| mesh.corners(t)), reach)
    }

    /// Among triangles by their corners, numbered as they come.
    pub fn among(triangles: impl IntoIterator<Item = [DVec3; 3]>, reach: f64) -> Self {
        let face = |corners: [DVec3; 3]| {
            let [a, b, c] = corners;
            let normal = (b - a).cross(c - a).try_normalize();
            Face { corners, within: Aabb::of(corners), normal }
        };
        let faces: Vec<Face> = triangles.into_iter().map(face).collect();
        let bounds = Aabb::of(faces.iter().flat_map(|f| f.corners));
        let bounds = if bounds.is_empty() { Aabb::of([DVec3::ZERO]) } else { bounds };
        let cell = reach.max(bounds.size().max_element() / MOST_CELLS).max(1e-9);
        let dims = (bounds.size() / cell).floor().to_array().map(|n| n as usize + 1);
        let count = faces.len();
        let mut index = NearestTriangle {
            faces,
            cell,
            origin: bounds.min,
            dims,
            starts: vec![0; dims.iter().product::<usize>() + 1],
            triangles: Vec::new(),
        };
        let cells_of = |index: &Self, t: usize| {
            let b = index.faces[t].within;
            (index.cell_of(b.min), index.cell_of(b.max))
        };
        for t in 0..count {
            let (lo, hi) = cells_of(&index, t);
            index.each_cell(lo, hi).for_each(|c| index.starts[c + 1] += 1);
        }
        for c in 1..index.starts.len() {
            index.starts[c] += index.starts[c - 1];
        }
        index.triangles = vec![0; index.starts[index.starts.len() - 1] as usize];
        let mut next = index.starts.clone();
        for t in 0..count {
            let (lo, hi) = cells_of(&index, t);
            for c in index.each_cell(lo, hi) {
                index.triangles[next[c] as usize] = t as u32;
                next[c] += 1;
            }
        }
        index
    }

    fn cell_of(&self, p: DVec3) -> [usize; 3] {
        let g = ((p - self.origin) / self.cell).to_array();
        std::array::from_fn(|a| (g[a].max(0.0) as usize).min(self.dims[a] - 1))
    }

    fn each_cell(&self, lo: [usize; 3], hi: [usize; 3]) -> impl Iterator<Item = usize> + use<> {
        let [nx, ny, _] = self.dims;
        (lo[2]..=hi[2]).flat_map(move |z| {
            (lo[1]..=hi[1]).flat_map(move |y| (lo[0]..=hi[0]).map(move |x| x + nx * (y + ny * z)))
        })
    }

    /// The nearest surface point within one cell (at least `reach`) of `p`; of equals the first.
    pub fn query(&self, p: DVec3) -> Option<SurfacePoint> {
        self.nearer(p, f64::INFINITY)
    }

    /// The same if it is nearer than `most` mm.
    pub fn nearer(&self, p: DVec3, most: f64) -> Option<SurfacePoint> {
        let mut far = self.cell.min(most);
        let (lo, hi) = (self.cell_of(p - DVec3::splat(far)), self.cell_of(p + DVec3::splat(far)));
        let mut best: Option<SurfacePoint> = None;
        // How far it is still worth to look after that, mm².
        let mut look_into = |[x, y, z]: [usize; 3]| {
            let c = x + self.dims[0] * (y + self.dims[1] * z);
            for &t in &self.triangles[self.starts[c] as usize..self.starts[c + 1] as usize] {
                let t = t as usize;
                let face = &self.faces[t];
                let reach = far + ROUNDING_MM;
                let apart = (p.clamp(face.within.min, face.within.max) - p).length_squared();
                let Some(normal) = face.normal.filter(|_| apart <= reach * reach) else { continue };
                // The box of a slanted one tells little.
                if (p - face.corners[0]).dot(normal).abs() > reach {
                    continue;
                }
                let point = closest_on_triangle(p, face.corners);
                let distance = point.distance(p);
                let better = best.is_none_or(|b| {
                    distance < b.distance || (distance == b.distance && t < b.triangle)
                });
                if better && distance <= self.cell && distance < most {
                    best = Some(SurfacePoint { triangle: t, point, normal, distance });
                    far = distance;
                }
            }
            (far + ROUNDING_MM).powi(2)
        };
        let own = self.cell_of(p);
        let mut far2 = look_into(own);
        let apart2 = |a: usize, c: usize| {
            let low = self.origin[a] + c as f64 * self.cell;
            (low - p[a]).max(p[a] - low - self.cell).max(0.0).powi(2)
        };
        for z in lo[2]..=hi[2] {
            for y in lo[1]..=hi[1] {
                let across = apart2(2, z) + apart2(1, y);
                for x in lo[0]..=hi[0] {
                    if across + apart2(0, x) <= far2 && [x, y, z] != own {
                        far2 = look_into([x, y, z]);
                    }
                }
            }
        }
        best
    }
}

impl NearestTriangle {
    /// Whether `p` lies inside the mesh, given what [`NearestTriangle::query`] answers for it.
    ///
    /// Looks from `p` at a point of the nearest triangle and asks for the side of the first face on the way: of the
    /// two faces of an edge the nearest alone may show its other side. The mesh must be closed and oriented there.
    pub fn is_inside(&self, p: DVec3, near: &SurfacePoint) -> bool {
        let [a, b, c] = self.faces[near.triangle].corners;
        // Within the triangle, so that the line goes through no edge of it.
        let aim = near.point.lerp((a + b + c) / 3.0, AIM);
        let (lo, hi) = (self.cell_of(p.min(aim)), self.cell_of(p.max(aim)));
        let mut first = (1.0, (aim - p).dot(near.normal) > 0.0);
        for cell in self.each_cell(lo, hi) {
            let listed = self.starts[cell] as usize..self.starts[cell + 1] as usize;
            for t in self.triangles[listed].iter().map(|t| *t as usize) {
                let Some(normal) = self.faces[t].normal.filter(|_| t != near.triangle) else {
                    continue;
                };
                let along = (aim - p).dot(normal);
                let share = (self.faces[t].corners[0] - p).dot(normal) / along;
                if (0.0..first.0).contains(&share)
                    && is_over(p.lerp(aim, share), normal, self.faces[t].corners)
                {
                    first = (share, along > 0.0);
                }
            }
        }
        first.1
    }
}

/// Whether a point in the plane of a triangle lies in it.
fn is_over(p: DVec3, normal: DVec3, [a, b, c]: [DVec3; 3]) -> bool {
    [(a, b), (b, c), (c, a)].iter().all(|(u, v)| (*v - *u).cross(p - *u).dot(normal) >= 0.0)
}

/// Closest point of a triangle, by the region of the barycentric plane the point falls into.
pub fn closest_on_triangle(p: DVec3, [a, b, c]: [DVec3; 3]) -> DVec3 {
    let n = (b - a).cross(c - a);
    let inside = |u: DVec3, v: DVec3| (v - u).cross(p - u).dot(n) >= 0.0;
    if inside(a, b) && inside(b, c) && inside(c, a) && n.length_squared() > 0.0 {
        return p - n * ((p - a).dot(n) / n.length_squared());
    }
    let on = |u: DVec3, v: DVec3| {
        let e = v - u;
        let t = if e.length_squared() > 0.0 { (p - u).dot(e) / e.length_squared() } else { 0.0 };
        u + e * t.clamp(0.0, 1.0)
    };
    [on(a, b), on(b, c), on(c, a)]
        .into_iter()
        .min_by(|x, y| x.distance_squared(p).total_cmp(&y.distance_squared(p)))
        .unwrap_or(a)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::DAffine3;

    #[test]
    fn faces_edges_and_corners_of_a_box() {
        let m = TriMesh::cuboid(DVec3::ZERO, DVec3::splat(10.0));
        let index = NearestTriangle::new(&m, 2.0);
        let q = |x, y, z| index.query(DVec3::new(x, y, z));
        let top = q(5.0, 4.0, 11.0).unwrap();
        assert!((top.normal - DVec3::Z).length() < 1e-12 && (top.distance - 1.0).abs() < 1e-12);
        let corner = q(11.0, 11.0, 11.0).unwrap();
        assert!((corner.point - DVec3::splat(10.0)).length() < 1e-12);
        assert!(q(5.0, 5.0, 5.0).is_none());
    }

    /// On slanted faces as well, whose boxes tell little, and where less than the reach is asked for.
    #[test]
    fn agrees_with_a_full_search() {
        let upright = TriMesh::cuboid(DVec3::ZERO, DVec3::new(3.0, 2.0, 5.0));
        agrees(&upright);
        let axis = DVec3::new(0.4, 0.8, 0.3).normalize();
        agrees(&upright.transformed(&DAffine3::from_axis_angle(axis, 0.7)).unwrap());
    }

    /// Beside edges and corners, inner and outer, the nearest face alone would tell the wrong side.
    #[test]
    fn sides_are_those_of_the_winding_number() {
        // A slanted tetrahedron of sharp edges, and a notched block with an edge that goes in.
        let at = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
        let tetra = [at(0.0, 0.0, 0.0), at(4.0, 0.0, 0.0), at(0.3, 0.2, 3.0), at(0.5, 2.5, 0.4)];
        let star: Vec<[u32; 3]> = vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]];
        let m = TriMesh::new(tetra.to_vec(), star).unwrap();
        let flip = m.signed_volume() < 0.0;
        let turned = m.triangles().iter().map(|t| if flip { [t[0], t[2], t[1]] } else { *t });
        let m = TriMesh::new(tetra.to_vec(), turned.collect()).unwrap();
        let l = [(0.0, 0.0), (4.0, 0.0), (4.0, 1.0), (1.0, 1.2), (1.1, 3.0), (0.0, 3.0)];
        let n = l.len() as u32;
        let mut vertices: Vec<DVec3> = l.iter().map(|(x, y)| at(*x, *y, 0.0)).collect();
        vertices.extend(l.iter().map(|(x, y)| at(*x, *y, 2.0)));
        let caps = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]];
        let mut faces: Vec<[u32; 3]> = caps.iter().map(|[a, b, c]| [*a, *c, *b]).collect();
        faces.extend(caps.iter().map(|t| t.map(|i| i + n)));
        for i in 0..n {
            let j = (i + 1) % n;
            faces.push([i, j, j + n]);
            faces.push([i, j + n, i + n]);
        }
        let notched = TriMesh::new(vertices, faces).unwrap();
        for m in [m, notched] {
            let index = NearestTriangle::new(&m, 0.8);
            let (mut told, mut wrong) = ([0; 2], 0);
            for i in 0..20_000_usize {
                let f = |k: usize, n: usize| (i * k % n) as f64 / n as f64;
                let p =
                    at(f(37, 1009) * 5.0 - 0.5, f(53, 1013) * 4.0 - 0.5, f(71, 1019) * 4.0 - 0.5);
                let Some(near) = index.query(p) else { continue };
                let whole: f64 = (0..m.triangles().len())
                    .map(|t| {
                        let [a, b, c] = m.corners(t).map(|q| q - p);
                        let [x, y, z] = [a, b, c].map(DVec3::length);
                        let below = x * y * z + a.dot(b) * z + b.dot(c) * x + c.dot(a) * y;
                        2.0 * a.dot(b.cross(c)).atan2(below)
                    })
                    .sum();
                let inside = whole > std::f64::consts::TAU;
                assert_eq!(index.is_inside(p, &near), inside, "{p} {near:?}");
                told[usize::from(inside)] += 1;
                wrong += usize::from(((near.point - p).dot(near.normal) > 0.0) != inside);
            }
            assert!(told.iter().all(|n| *n > 1000), "{told:?}");
            assert!(wrong > 0);
        }
    }

    fn agrees(m: &TriMesh) {
        let index = NearestTriangle::new(m, 1.0);
        for i in 0..1000 {
            let f = |k: usize, n: usize| (i * k % n) as f64 / n as f64;
            let p =
                DVec3::new(f(37, 101) * 4.0 - 0.5, f(53, 103) * 3.0 - 0.5, f(71, 107) * 6.0 - 0.5);
            let full = (0..m.triangles().len())
                .map(|t| closest_on_triangle(p, m.corners(t)).distance(p))
                .fold(f64::INFINITY, f64::min);
            if full <= 1.0 {
                assert!((index.query(p).unwrap().distance - full).abs() < 1e-12);
            }
            for most in [0.2, 0.6] {
                let found = index.nearer(p, most).map_or(most, |near| near.distance);
                assert!((found - full.min(most)).abs() < 1e-12, "{p} {most}");
            }
        }
    }
}
