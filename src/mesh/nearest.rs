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

impl NearestTriangle {
    /// `reach` (mm) is the largest distance at which a triangle is looked for.
    pub fn new(mesh: &TriMesh, reach: f64) -> Self {
        let bounds = mesh.bounds();
        let bounds = if bounds.is_empty() { Aabb::of([DVec3::ZERO]) } else { bounds };
        let cell = reach.max(bounds.size().max_element() / MOST_CELLS).max(1e-9);
        let dims = (bounds.size() / cell).floor().to_array().map(|n| n as usize + 1);
        let face = |t: usize| {
            let corners = mesh.corners(t);
            let normal = mesh.area_normal(t).try_normalize();
            Face { corners, within: Aabb::of(corners), normal }
        };
        let mut index = NearestTriangle {
            faces: (0..mesh.triangles().len()).map(face).collect(),
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
        for t in 0..mesh.triangles().len() {
            let (lo, hi) = cells_of(&index, t);
            index.each_cell(lo, hi).for_each(|c| index.starts[c + 1] += 1);
        }
        for c in 1..index.starts.len() {
            index.starts[c] += index.starts[c - 1];
        }
        index.triangles = vec![0; index.starts[index.starts.len() - 1] as usize];
        let mut next = index.starts.clone();
        for t in 0..mesh.triangles().len() {
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
