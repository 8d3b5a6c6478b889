//! Names the defects of a mesh: holes, edges shared by too many triangles, flipped and degenerate
//! triangles, bodies turned inside out, a size that suggests another unit.
//!
//! Method: the edges, sorted, tell which triangles meet; a consistent orientation is carried over
//! every edge that exactly two triangles share, and in each patch so reached the smaller party is
//! the flipped one. Near-linear time.
//!
//! Not told: self-intersections. [`crate::voxel`] makes a solid of a defective mesh all the same;
//! a person should know where it had to guess.

use super::TriMesh;
use super::edges::{Sets, Shared, Use};
use super::nesting::count_inside_out;
use crate::base::DVec3;

/// Twice a triangle's area over its longest edge squared, below which it is degenerate. Larger
/// calls the needles of fine CAD tessellation degenerate, smaller misses what rounding leaves of
/// collinear corners stored in 32 bits.
const DEGENERATE: f64 = 1e-10;
/// Millimetres. Parts of this process are held and cut in a machine: smaller than the first is a
/// part in metres or inches, larger than the second one in micrometres or scaled twice.
const SUSPICIOUSLY_SMALL_MM: f64 = 2.0;
const SUSPICIOUSLY_LARGE_MM: f64 = 5000.0;

/// What is known of a mesh without voxelising it.
#[derive(Clone, Debug, PartialEq)]
pub struct Health {
    pub triangles: usize,
    /// Vertices that triangles use.
    pub vertices: usize,
    /// Components connected over shared vertices.
    pub bodies: usize,
    /// Edges of one triangle only.
    pub boundary_edges: usize,
    /// Loops that the boundary edges form.
    pub holes: usize,
    /// Edges of more than two triangles.
    pub non_manifold_edges: usize,
    /// Edges that their two triangles traverse in the same direction.
    pub inconsistent_edges: usize,
    /// Triangles to flip so that neighbours agree: the smaller party of each connected patch.
    pub flipped: usize,
    /// Closed bodies whose outside faces in, other than cavities inside a body. Of the bodies that
    /// may be either, only the 256 largest are examined.
    pub inside_out: usize,
    /// Triangles without area.
    pub degenerate: usize,
    /// Triangles with the corners of an earlier one.
    pub duplicate: usize,
    /// Edge lengths of the bounding box, mm.
    pub extents: DVec3,
    /// Volume as the triangles are oriented now, mm³; see [`TriMesh::signed_volume`].
    pub signed_volume: f64,
    /// Every edge has an even number of triangles, so that inside and outside are defined; this
    /// says nothing of orientation.
    pub watertight: bool,
}

impl Health {
    /// Examines a mesh.
    pub fn of(mesh: &TriMesh) -> Health {
        let shared = Shared::of(mesh);
        let body_of = bodies(mesh);
        let distinct = |mut bodies: Vec<u32>| {
            bodies.sort_unstable();
            bodies.dedup();
            bodies
        };
        let odd = shared.edges().filter(|(_, uses)| uses.len() % 2 == 1);
        let open = distinct(odd.map(|(_, uses)| body_of[uses[0].triangle as usize]).collect());
        let closed: Vec<bool> = body_of.iter().map(|b| open.binary_search(b).is_err()).collect();
        let flipped = flipped(&shared, mesh.triangles().len());
        let edges = |wanted: fn(&[Use]) -> bool| shared.edges().filter(|(_, u)| wanted(u)).count();
        Health {
            triangles: mesh.triangles().len(),
            vertices: used_vertices(mesh),
            bodies: distinct(body_of.clone()).len(),
            boundary_edges: edges(|u| u.len() == 1),
            holes: holes(&shared, mesh.vertices().len()),
            non_manifold_edges: edges(|u| u.len() > 2),
            inconsistent_edges: edges(|u| u.len() == 2 && u[0].forward == u[1].forward),
            flipped: flipped.iter().filter(|f| **f).count(),
            inside_out: count_inside_out(mesh, &body_of, &closed, &flipped),
            degenerate: (0..mesh.triangles().len()).filter(|t| is_degenerate(mesh, *t)).count(),
            duplicate: duplicates(mesh),
            extents: if mesh.is_empty() { DVec3::ZERO } else { mesh.bounds().size() },
            signed_volume: mesh.signed_volume(),
            watertight: shared.edges().next().is_some() && open.is_empty(),
        }
    }

    /// One sentence for each thing a person should look at, with what to do about it; none for a
    /// sound mesh of plausible size.
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings = Vec::new();
        let mut warn = |applies: bool, text: String| {
            if applies {
                warnings.push(text);
            }
        };
        warn(
            self.boundary_edges > 0,
            format!(
                "the surface is open (holes: {}, boundary edges: {}), so the solid is guessed \
                 there; fill the holes in a mesh editor if that matters",
                self.holes, self.boundary_edges
            ),
        );
        warn(
            self.non_manifold_edges > 0,
            format!(
                "more than two triangles meet at some edges ({}); unite or separate the bodies \
                 that touch there",
                self.non_manifold_edges
            ),
        );
        warn(
            self.flipped + self.inconsistent_edges > 0,
            format!(
                "neighbouring triangles disagree on which side is out (flipped triangles: {}, \
                 edges concerned: {}); recompute the normals in a mesh editor",
                self.flipped, self.inconsistent_edges
            ),
        );
        warn(
            self.inside_out > 0,
            format!(
                "closed bodies are inside out ({} of {}); flip their normals in a mesh editor",
                self.inside_out, self.bodies
            ),
        );
        warn(
            self.duplicate > 0,
            format!("triangles are given twice ({}); remove duplicate faces", self.duplicate),
        );
        warn(
            self.degenerate > 0,
            format!("triangles have no area ({}); they do no harm", self.degenerate),
        );
        warnings.extend(self.unit_warning());
        warnings
    }

    fn unit_warning(&self) -> Option<String> {
        let DVec3 { x, y, z } = self.extents;
        let largest = self.extents.max_element();
        if largest < SUSPICIOUSLY_SMALL_MM {
            Some(format!(
                "the part is only {x:.4} × {y:.4} × {z:.4} mm; if its file is in metres or inches \
                 say `--unit m` or `--unit in`, or enlarge it with `--scale`"
            ))
        } else if largest > SUSPICIOUSLY_LARGE_MM {
            Some(format!(
                "the part is {x:.0} × {y:.0} × {z:.0} mm, larger than five metres; check `--unit`, \
                 or shrink it with `--scale` (0.001 for a file in micrometres)"
            ))
        } else {
            None
        }
    }
}

fn used_vertices(mesh: &TriMesh) -> usize {
    let mut used = vec![false; mesh.vertices().len()];
    mesh.triangles().iter().flatten().for_each(|i| used[*i as usize] = true);
    used.iter().filter(|u| **u).count()
}

/// The body of each triangle, named by one of its vertices.
fn bodies(mesh: &TriMesh) -> Vec<u32> {
    let mut sets = Sets::new(mesh.vertices().len());
    for [a, b, c] in mesh.triangles() {
        sets.join(*a, *b, false);
        sets.join(*b, *c, false);
    }
    mesh.triangles().iter().map(|t| sets.find(t[0]).0).collect()
}

/// Loops of boundary edges: the independent cycles of their graph, so that two holes that touch at
/// a vertex count as two. A boundary that an edge of three triangles interrupts counts as one.
fn holes(shared: &Shared, vertices: usize) -> usize {
    let boundary = || shared.edges().filter(|(_, uses)| uses.len() == 1).map(|(ends, _)| ends);
    let mut sets = Sets::new(vertices);
    let mut on_boundary: Vec<u32> = boundary().flatten().collect();
    on_boundary.sort_unstable();
    on_boundary.dedup();
    boundary().for_each(|[a, b]| sets.join(a, b, false));
    let components = on_boundary.iter().filter(|v| sets.find(**v).0 == **v).count();
    components + boundary().count().saturating_sub(on_boundary.len())
}

/// Which triangles to flip so that all agree over the edges that two share.
fn flipped(shared: &Shared, triangles: usize) -> Vec<bool> {
    let mut sets = Sets::new(triangles);
    for (_, uses) in shared.edges() {
        if let [a, b] = uses {
            sets.join(a.triangle, b.triangle, a.forward == b.forward);
        }
    }
    let found: Vec<(u32, bool)> = (0..triangles as u32).map(|t| sets.find(t)).collect();
    // Per patch, how many triangles are oriented against its root.
    let mut against = vec![(0usize, 0usize); triangles];
    for (root, opposite) in &found {
        against[*root as usize].0 += 1;
        against[*root as usize].1 += usize::from(*opposite);
    }
    let minority = |(root, opposite): &(u32, bool)| {
        let (all, against) = against[*root as usize];
        *opposite != (2 * against > all)
    };
    found.iter().map(minority).collect()
}

fn is_degenerate(mesh: &TriMesh, t: usize) -> bool {
    let [a, b, c] = mesh.corners(t);
    let longest =
        (b - a).length_squared().max((c - b).length_squared()).max((a - c).length_squared());
    // Not "less", so that a point counts.
    mesh.area_normal(t).length() <= DEGENERATE * longest
}

fn duplicates(mesh: &TriMesh) -> usize {
    let mut sorted = mesh.triangles().to_vec();
    sorted.iter_mut().for_each(|t| t.sort_unstable());
    sorted.sort_unstable();
    sorted.windows(2).filter(|w| w[0] == w[1]).count()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn cube() -> TriMesh {
        TriMesh::cuboid(DVec3::ZERO, DVec3::splat(10.0))
    }

    fn edited(mesh: &TriMesh, edit: impl FnOnce(&mut Vec<[u32; 3]>)) -> TriMesh {
        let mut triangles = mesh.triangles().to_vec();
        edit(&mut triangles);
        TriMesh::new(mesh.vertices().to_vec(), triangles).unwrap()
    }

    /// Both meshes in one, sharing no vertices.
    fn joined(a: &TriMesh, b: &TriMesh) -> TriMesh {
        let shift = a.vertices().len() as u32;
        let vertices = [a.vertices(), b.vertices()].concat();
        let moved = b.triangles().iter().map(|t| t.map(|i| i + shift));
        TriMesh::new(vertices, a.triangles().iter().copied().chain(moved).collect()).unwrap()
    }

    fn inverted(mesh: &TriMesh) -> TriMesh {
        edited(mesh, |t| t.iter_mut().for_each(|t| t.swap(1, 2)))
    }

    #[test]
    fn a_cube_is_sound() {
        let h = Health::of(&cube());
        assert_eq!(h.warnings(), Vec::<String>::new());
        assert!(h.watertight);
        assert_eq!((h.triangles, h.vertices, h.bodies, h.signed_volume), (12, 8, 1, 1000.0));
        assert_eq!(h.extents, DVec3::splat(10.0));
    }

    #[test]
    fn holes_that_touch_at_a_vertex_count_as_two() {
        // Each triangle of a cube is a hole of three edges; 0 and 2 share only the vertex 0.
        let open = edited(&cube(), |t| {
            t.remove(0);
        });
        let h = Health::of(&open);
        assert_eq!((h.boundary_edges, h.holes, h.watertight), (3, 1, false));
        let (first, rest) = (cube().triangles()[0], cube().triangles().to_vec());
        let touching =
            rest.iter().position(|t| t.iter().filter(|i| first.contains(i)).count() == 1);
        let open = edited(&cube(), |t| {
            t.remove(touching.unwrap());
            t.remove(0);
        });
        let h = Health::of(&open);
        assert_eq!((h.boundary_edges, h.holes), (6, 2));
        assert!(h.warnings()[0].contains("holes: 2"), "{:?}", h.warnings());
    }

    #[test]
    fn an_inverted_body_is_told_from_a_cavity() {
        assert_eq!(Health::of(&inverted(&cube())).inside_out, 1);
        let core = TriMesh::cuboid(DVec3::splat(3.0), DVec3::splat(5.0));
        let hollow = joined(&cube(), &inverted(&core));
        let h = Health::of(&hollow);
        assert_eq!((h.inside_out, h.bodies, h.signed_volume), (0, 2, 992.0));
        let beside = TriMesh::cuboid(DVec3::splat(13.0), DVec3::splat(15.0));
        assert_eq!(Health::of(&joined(&cube(), &inverted(&beside))).inside_out, 1);
    }

    #[test]
    fn degenerate_duplicate_and_non_manifold_triangles_are_counted() {
        let mesh = edited(&cube(), |t| {
            t.push(t[0]);
            t.push([3, 3, 4]);
        });
        let h = Health::of(&mesh);
        assert_eq!((h.duplicate, h.degenerate, h.non_manifold_edges), (1, 1, 3));
        assert!(!h.watertight);
        assert_eq!(h.warnings().len(), 3, "{:?}", h.warnings());
    }

    #[test]
    fn an_unlikely_size_asks_for_the_unit() {
        let small = TriMesh::cuboid(DVec3::ZERO, DVec3::splat(0.15));
        assert!(Health::of(&small).warnings()[0].contains("`--unit m`"));
        let large = TriMesh::cuboid(DVec3::ZERO, DVec3::splat(6000.0));
        assert!(Health::of(&large).warnings()[0].contains("`--scale`"));
    }

    #[test]
    fn an_empty_mesh_has_no_health_worth_speaking_of() {
        let h = Health::of(&TriMesh::default());
        assert!(!h.watertight && h.extents == DVec3::ZERO && h.bodies == 0);
    }

    /// A closed grid of quads round a box, n by n on each side.
    fn fine_cube(n: u32) -> TriMesh {
        let mut seen = std::collections::HashMap::new();
        let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
        for (axis, side) in (0..3).flat_map(|axis| [(axis, 0), (axis, n)]) {
            for (u, v) in (0..n).flat_map(|u| (0..n).map(move |v| (u, v))) {
                let quad = [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(du, dv)| {
                    let mut p = [0; 3];
                    p[axis] = side;
                    p[(axis + 1) % 3] = u + du;
                    p[(axis + 2) % 3] = v + dv;
                    *seen.entry(p).or_insert_with(|| {
                        vertices.push(DVec3::from(p.map(f64::from)));
                        vertices.len() as u32 - 1
                    })
                });
                let [a, b, c, d] = quad;
                let (b, d) = if side == 0 { (d, b) } else { (b, d) };
                triangles.extend([[a, b, c], [a, c, d]]);
            }
        }
        TriMesh::new(vertices, triangles).unwrap()
    }

    proptest! {
        /// Whichever minority of a closed patch is flipped, exactly it is counted, and the body
        /// is not called inside out.
        #[test]
        fn exactly_the_flipped_minority_is_counted(
            chosen in prop::collection::btree_set(0usize..192, 0..95),
        ) {
            let mesh = edited(&fine_cube(4), |t| chosen.iter().for_each(|i| t[*i].swap(1, 2)));
            let h = Health::of(&mesh);
            prop_assert_eq!(h.flipped, chosen.len());
            prop_assert_eq!(h.inside_out, 0);
            prop_assert!(h.watertight);
            prop_assert_eq!(h.inconsistent_edges == 0, chosen.is_empty());
        }
    }
}
