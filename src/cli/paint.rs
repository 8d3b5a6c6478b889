//! The surface of a part, coloured by what can be done to it.

use hmplan::access::{Damage, Overhang, Survey};
use hmplan::base::{DVec3, Direction};
use hmplan::mesh::TriMesh;
use hmplan::voxel::{BitGrid, Frame};
use std::io::{self, Write};

/// What a facet is, the more telling one where two hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    Accessible,
    Inaccessible,
    Overhanging,
    Collateral,
}

impl Kind {
    pub const ALL: [Kind; 4] =
        [Kind::Accessible, Kind::Inaccessible, Kind::Overhanging, Kind::Collateral];

    pub fn name(self) -> &'static str {
        match self {
            Kind::Accessible => "accessible",
            Kind::Inaccessible => "inaccessible",
            Kind::Overhanging => "overhanging",
            Kind::Collateral => "collateral",
        }
    }

    /// Red, green, blue: distinct to the colour-blind as well.
    fn colour(self) -> [u8; 3] {
        match self {
            Kind::Accessible => [0, 158, 115],
            Kind::Inaccessible => [213, 94, 0],
            Kind::Overhanging => [86, 180, 233],
            Kind::Collateral => [204, 121, 167],
        }
    }
}

/// The voxels beside each facet of a surface.
pub struct Probes {
    /// Distinct voxels outside, in order.
    pub outside: Vec<[usize; 3]>,
    /// Of each facet its place in that list; none where the facet faces solid or leaves the grid.
    of_facet: Vec<Option<u32>>,
}

/// How far in front of a facet the space is looked at, in pitches: on through what is empty up to
/// the surface tolerance of the default pitch, since what is unreached closer to the surface counts
/// as skin. The surface itself lies within half a voxel of the faces between voxels.
const ASIDE: [f64; 4] = [0.6, 0.9, 1.2, 1.5];

/// Where a facet's middle lies and which way it faces; none for one without area.
fn facet(surface: &TriMesh, t: usize) -> Option<(DVec3, DVec3)> {
    let [a, b, c] = surface.corners(t);
    Some(((a + b + c) / 3.0, surface.area_normal(t).try_normalize()?))
}

/// The empty voxel in front of every facet.
pub fn probes(surface: &TriMesh, solid: &BitGrid, frame: &Frame) -> Probes {
    let found: Vec<Option<[usize; 3]>> = (0..surface.triangles().len())
        .map(|t| {
            let (middle, normal) = facet(surface, t)?;
            let at = |s: &f64| frame.voxel_at(middle + normal * (s * frame.pitch));
            let beyond = ASIDE.iter().filter_map(at).skip_while(|v| solid.get(*v));
            beyond.take_while(|v| !solid.get(*v)).last()
        })
        .collect();
    let mut outside: Vec<[usize; 3]> = found.iter().flatten().copied().collect();
    outside.sort_unstable();
    outside.dedup();
    let place = |v: &[usize; 3]| outside.binary_search(v).ok().and_then(|i| u32::try_from(i).ok());
    let of_facet = found.iter().map(|v| v.as_ref().and_then(place)).collect();
    Probes { outside, of_facet }
}

/// The kinds of a surface's facets.
pub struct Paint {
    kinds: Vec<Kind>,
    /// mm² of all facets and of each kind that holds, alone or not.
    pub area: f64,
    pub reached: f64,
    pub overhanging: f64,
    /// mm² that each direction of the survey reaches.
    pub by_direction: Vec<f64>,
}

impl Paint {
    #[allow(clippy::too_many_arguments)]
    pub fn of(
        surface: &TriMesh,
        probes: &Probes,
        survey: &Survey,
        damage: &Damage,
        solid: &BitGrid,
        frame: &Frame,
        build: Direction,
        overhang: Overhang,
    ) -> Paint {
        let plate = lowest(solid, frame, build) + frame.pitch;
        let mut paint = Paint {
            kinds: Vec::new(),
            area: 0.0,
            reached: 0.0,
            overhanging: 0.0,
            by_direction: Vec::new(),
        };
        let mut area_of_probe = vec![0.0; probes.outside.len()];
        for t in 0..surface.triangles().len() {
            let area = surface.area_normal(t).length() / 2.0;
            paint.area += area;
            let Some((middle, normal)) = facet(surface, t) else {
                paint.kinds.push(Kind::Inaccessible);
                continue;
            };
            let probe = probes.of_facet[t].map(|i| i as usize);
            let reached = probe.is_some_and(|i| survey.accessible.get(probes.outside[i]));
            if let Some(i) = probe {
                area_of_probe[i] += area;
            }
            // The plate carries what lies on it.
            let hangs = build.dot(normal) < -overhang.sine() && build.dot(middle) > plate;
            let inside = frame.voxel_at(middle - normal * (0.6 * frame.pitch));
            let hit = inside.is_some_and(|v| damage.region.get(v));
            paint.reached += if reached { area } else { 0.0 };
            paint.overhanging += if hangs { area } else { 0.0 };
            paint.kinds.push(match (hit, hangs, reached) {
                (true, _, _) => Kind::Collateral,
                (_, true, _) => Kind::Overhanging,
                (_, _, false) => Kind::Inaccessible,
                _ => Kind::Accessible,
            });
        }
        let area = |probes: &[u32]| probes.iter().map(|p| area_of_probe[*p as usize]).sum();
        paint.by_direction = survey.reaches.iter().map(|r| area(&r.probes)).collect();
        paint
    }

    /// Writes binary PLY, millimetres, a colour for every face and, of the more telling kind beside
    /// it, every vertex.
    pub fn write_ply(&self, surface: &TriMesh, out: &mut dyn Write) -> io::Result<()> {
        let mut vertex = vec![Kind::Accessible; surface.vertices().len()];
        for (t, kind) in surface.triangles().iter().zip(&self.kinds) {
            for v in t {
                let v = &mut vertex[*v as usize];
                *v = (*v).max(*kind);
            }
        }
        writeln!(out, "ply\nformat binary_little_endian 1.0")?;
        for kind in Kind::ALL {
            let [r, g, b] = kind.colour();
            writeln!(out, "comment {} {r} {g} {b}", kind.name())?;
        }
        let colour = "property uchar red\nproperty uchar green\nproperty uchar blue";
        writeln!(out, "element vertex {}", vertex.len())?;
        writeln!(out, "property float x\nproperty float y\nproperty float z\n{colour}")?;
        writeln!(out, "element face {}", self.kinds.len())?;
        writeln!(out, "property list uchar uint vertex_indices\n{colour}\nend_header")?;
        for (p, kind) in surface.vertices().iter().zip(&vertex) {
            for c in p.to_array() {
                out.write_all(&(c as f32).to_le_bytes())?;
            }
            out.write_all(&kind.colour())?;
        }
        for (t, kind) in surface.triangles().iter().zip(&self.kinds) {
            out.write_all(&[3])?;
            for v in t {
                out.write_all(&v.to_le_bytes())?;
            }
            out.write_all(&kind.colour())?;
        }
        Ok(())
    }
}

/// The lowest place of a solid along a direction, mm.
fn lowest(solid: &BitGrid, frame: &Frame, direction: Direction) -> f64 {
    let height = |v| direction.dot(frame.center(v));
    let ends = |(y, z, x, n): (usize, usize, usize, usize)| {
        height([x, y, z]).min(height([x + n - 1, y, z]))
    };
    solid.runs().map(ends).fold(f64::INFINITY, f64::min) - frame.pitch / 2.0
}
