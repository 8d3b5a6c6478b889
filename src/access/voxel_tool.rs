//! Tools as sets of voxel offsets from the tip.
//!
//! A voxel belongs to the passive part when the tool holds it with a hair to spare below, since a
//! tool that only touches does not collide, and to the active part when the tool holds it at all.
//! The whole tool is both (HB Sec. 3.1: T = H ∪ K). Tips stand at voxel centres, which is a
//! restriction an analysis accepts, never a licence.

use crate::base::{DMat3, DVec3, Direction};
use crate::machine::{Shape, Tool};
use crate::morph::{Axis, Chord, ENDLESS_UP, Element, Layer, Plane, Window};
use rayon::prelude::*;

/// How far, in mm, a passive part is lowered to let it touch.
const TOUCH_MM: f64 = 1e-9;

/// A tool on a grid: T = H ∪ K and K as offsets from the tip.
#[derive(Clone, Debug, PartialEq)]
pub struct VoxelTool {
    body: Element,
    edge: Element,
    /// The grid axis that the offsets' +z stands for; none when they lie in the grid's own axes.
    axis: Option<Axis>,
}

#[derive(Debug, thiserror::Error, PartialEq)]
pub enum NoVoxelTool {
    #[error("({0}, {1}, {2}) is no grid axis; tools along other directions are sampled in a box")]
    NotAnAxis(f64, f64, f64),
    #[error("no voxel of {pitch} mm lies in the tool's active part; set a finer pitch")]
    NothingCuts { pitch: f64 },
    #[error("the tool's active part has no end; only a passive part may be a platform")]
    EndlessEdge,
}

impl VoxelTool {
    /// A tool of any offsets, in the axes of the grid. The body takes in the edge.
    pub fn of_offsets(passive: &[[i64; 3]], active: &[[i64; 3]]) -> VoxelTool {
        let body = Element::from_offsets(&[passive, active].concat());
        VoxelTool { body, edge: Element::from_offsets(active), axis: None }
    }

    /// A tool of elements; the body holds the edge, and +z points along `axis`.
    pub fn of_elements(body: Element, edge: Element, axis: Option<Axis>) -> VoxelTool {
        VoxelTool { body, edge, axis }
    }

    /// An axisymmetric tool along a grid axis. A tool that never narrows upward goes up without
    /// end, as it does on a spindle; of any other the topmost section does.
    ///
    /// # Errors
    /// Another direction; a pitch at which nothing cuts.
    pub fn along(tool: &Tool, direction: Direction, pitch: f64) -> Result<VoxelTool, NoVoxelTool> {
        let v = direction.vec();
        let axis = Axis::of(direction).ok_or(NoVoxelTool::NotAnAxis(v.x, v.y, v.z))?;
        let edge = layers(tool, pitch, true);
        if edge.last().is_some_and(|l| l.end == ENDLESS_UP) {
            return Err(NoVoxelTool::EndlessEdge);
        }
        let mut body = layers(tool, pitch, false);
        if let Some(last) = body.last_mut() {
            last.end = ENDLESS_UP;
        }
        let edge = Element::from_layers(edge);
        if edge.is_empty() {
            return Err(NoVoxelTool::NothingCuts { pitch });
        }
        Ok(VoxelTool { body: Element::from_layers(body), edge, axis: Some(axis) })
    }

    /// A nozzle along a grid axis: the tip stands at the deposited voxel, which alone is its edge
    /// (HB Sec. 4.2.1: A(P, H, {0})).
    ///
    /// # Errors
    /// Another direction.
    pub fn depositing(
        tool: &Tool,
        direction: Direction,
        pitch: f64,
    ) -> Result<VoxelTool, NoVoxelTool> {
        let v = direction.vec();
        let axis = Axis::of(direction).ok_or(NoVoxelTool::NotAnAxis(v.x, v.y, v.z))?;
        let mut body = layers(tool, pitch, false);
        if let Some(last) = body.last_mut() {
            last.end = ENDLESS_UP;
        }
        let body = Element::from_layers(body);
        Ok(VoxelTool { body, edge: Element::point([0; 3]), axis: Some(axis) })
    }

    /// An axisymmetric tool along any direction, sampled at the offsets within `within`. Spheres
    /// of `spare` mm about a passive offset must be clear of obstacles: √3/2 of the pitch makes up
    /// for sampling, 0 gives the tool itself.
    pub fn turned(
        tool: &Tool,
        direction: Direction,
        pitch: f64,
        spare: f64,
        within: &Window,
    ) -> VoxelTool {
        let d = direction.vec();
        let place = |o: DVec3| {
            let p = o * pitch;
            let z = d.dot(p);
            ((p - d * z).length(), z)
        };
        let edge = |o: DVec3| {
            let (rho, z) = place(o);
            tool.sections.iter().any(|s| s.active && s.shape.contains(rho, z))
        };
        let passive = |o: DVec3| {
            let (rho, z) = place(o);
            tool.sections.iter().any(|s| holds(&s.shape, rho, z, spare))
        };
        VoxelTool {
            body: sampled(within, |o| edge(o) || passive(o)),
            edge: sampled(within, edge),
            axis: None,
        }
    }

    /// A tool given by what it holds: `active` and `passive` say whether a point (mm from the tip,
    /// the tool upright) belongs to it. It is turned by `grid_from_tool`.
    pub fn of_solid(
        active: impl Fn(DVec3) -> bool + Sync,
        passive: impl Fn(DVec3) -> bool + Sync,
        grid_from_tool: DMat3,
        pitch: f64,
        within: &Window,
    ) -> Result<VoxelTool, NoVoxelTool> {
        let back = grid_from_tool.transpose();
        let edge = sampled(within, |o| active(back * o * pitch));
        if edge.is_empty() {
            return Err(NoVoxelTool::NothingCuts { pitch });
        }
        let body = sampled(within, |o| {
            let p = back * o * pitch;
            active(p) || passive(p)
        });
        Ok(VoxelTool { body, edge, axis: None })
    }

    /// The tool with its tip as edge when it has no edge of its own, as a nozzle or a cutter finer
    /// than the grid.
    pub fn with_tip(self) -> VoxelTool {
        if self.edge.is_empty() { VoxelTool { edge: Element::point([0; 3]), ..self } } else { self }
    }

    pub fn body(&self) -> &Element {
        &self.body
    }

    pub fn edge(&self) -> &Element {
        &self.edge
    }

    pub fn axis(&self) -> Option<Axis> {
        self.axis
    }

    /// Whether the body goes up without end and never narrows: the depth engine's tools.
    pub fn never_narrows(&self) -> bool {
        let layers = self.body.layers();
        let holds = |upper: &Plane, lower: &Plane| match (upper, lower) {
            (Plane::Whole, _) => true,
            (_, Plane::Whole) => false,
            (Plane::Chords(upper), Plane::Chords(lower)) => lower.iter().all(|c| {
                let within = |u: &Chord| u.y == c.y && u.x <= c.x && c.x + c.len <= u.x + u.len;
                upper.iter().any(within)
            }),
        };
        layers.last().is_some_and(|l| l.end == ENDLESS_UP)
            && layers.windows(2).all(|p| p[0].end == p[1].z && holds(&p[1].plane, &p[0].plane))
    }

    /// The part of the edge that decides what is touched. What a tool that never narrows touches
    /// with a higher offset it also touches, standing higher, with a lower one of the same column;
    /// so of a last layer of one cross-section the lowest slice suffices.
    pub(super) fn touching(&self) -> Element {
        if !self.never_narrows() {
            return self.edge.clone();
        }
        let mut layers = self.edge.layers().to_vec();
        layers.iter_mut().for_each(|l| l.end = l.z + 1);
        Element::from_layers(layers)
    }
}

/// Whether a shape, lowered by a hair or grown by `spare`, holds a point.
fn holds(shape: &Shape, rho: f64, z: f64, spare: f64) -> bool {
    if spare == 0.0 {
        return shape.contains(rho, z - TOUCH_MM) || shape.contains(rho, z) && z > shape.bottom();
    }
    // The tool's lower surface never falls outward by more than its own height, so a box of
    // heights and radii about the point holds the sphere about it.
    let inner = (rho - spare).max(0.0);
    shape.lower_surface(inner) <= z + spare && shape.top() >= z - spare
}

/// Layers of the sections (the active ones alone, or all) by height.
fn layers(tool: &Tool, pitch: f64, active_only: bool) -> Vec<Layer> {
    let sections = || tool.sections.iter().filter(move |s| s.active || !active_only);
    // One layer beyond the highest finite figure, where an endless section shows.
    let highest = sections()
        .flat_map(|s| [s.shape.bottom(), s.shape.top()])
        .filter(|z| z.is_finite())
        .fold(0.0, f64::max);
    let n = (highest / pitch).floor() as i64 + 1;
    let radius = |z: f64| {
        sections()
            .filter_map(|s| {
                let touching = s.shape.radius_at(z - TOUCH_MM).filter(|_| z > s.shape.bottom());
                if s.active { s.shape.radius_at(z).or(touching) } else { touching }
            })
            .fold(f64::NEG_INFINITY, f64::max)
    };
    let mut layers = Vec::new();
    for k in 0..=n {
        let plane = Element::disk(radius(k as f64 * pitch) / pitch);
        let end = if k == n && plane == Plane::Whole { ENDLESS_UP } else { k + 1 };
        layers.push(Layer { z: k, end, plane });
    }
    layers.retain(|l| l.plane != Plane::Chords(Vec::new()));
    layers
}

/// The offsets of a box that pass.
fn sampled(within: &Window, holds: impl Fn(DVec3) -> bool + Sync) -> Element {
    let [lo, hi] = [within.lo, within.hi];
    let layers: Vec<Layer> = (lo[2]..hi[2])
        .into_par_iter()
        .map(|z| {
            let mut chords: Vec<Chord> = Vec::new();
            for y in lo[1]..hi[1] {
                let mut open = false;
                for x in lo[0]..hi[0] {
                    let solid = holds(DVec3::new(x as f64, y as f64, z as f64));
                    match chords.last_mut() {
                        Some(c) if solid && open => c.len += 1,
                        _ if solid => chords.push(Chord { y, x, len: 1 }),
                        _ => {}
                    }
                    open = solid;
                }
            }
            Layer { z, end: z + 1, plane: Plane::Chords(chords) }
        })
        .collect();
    Element::from_layers(layers)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_become_the_voxels_drawn_on_paper() {
        let tool = Tool::builtin("w2v-cutter").unwrap();
        let v = VoxelTool::along(&tool, Direction::Z, 0.5).unwrap();
        assert!(v.never_narrows());
        // The tip touches, the shank is 3 voxels in radius and ends at 13 mm, where the carriage
        // begins to collide one voxel higher, and the platform fills everything above 43 mm.
        assert!(v.edge().contains([0, 0, 0]) && v.edge().contains([3, 0, 26]));
        assert!(!v.edge().contains([1, 0, 0]) && !v.edge().contains([0, 0, 27]));
        assert!(!v.body().contains([50, 0, 26]) && v.body().contains([50, 0, 27]));
        assert!(!v.body().contains([51, 0, 27]) && v.body().contains([900, 0, 87]));
        assert!(v.body().contains([-900, 12, 1 << 40]));
        let touching = v.touching();
        assert!(touching.count() < v.edge().count() / 3);
        for (name, narrows) in [("w2v-nozzle", false), ("vasco-cutter", false)] {
            let tool = Tool::builtin(name).unwrap();
            let made = VoxelTool::along(&tool, Direction::X, 0.5);
            assert_eq!(made.map(|v| !v.never_narrows()).unwrap_or(narrows), narrows, "{name}");
        }
    }

    #[test]
    fn sampling_along_an_axis_gives_the_layers() {
        let tool = Tool::builtin("vasco-cutter").unwrap();
        let near = Window { lo: [-40; 3], hi: [41; 3] };
        let layered = VoxelTool::along(&tool, Direction::Z, 0.83).unwrap();
        let sampled = VoxelTool::turned(&tool, Direction::Z, 0.83, 0.0, &near);
        assert_eq!(sampled.body(), &layered.body().clipped(&near));
        assert_eq!(sampled.edge(), &layered.edge().clipped(&near));
        let wider = VoxelTool::turned(&tool, Direction::Z, 0.83, 0.8, &near);
        for (z, c) in sampled.body().chords() {
            assert!((c.x..c.x + c.len).all(|x| wider.body().contains([x, c.y, z])));
        }
    }
}
