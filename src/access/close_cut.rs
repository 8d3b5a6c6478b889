//! What one direction can cut near a few voxels, by the definition itself.
//!
//! Off the grid axes the depth engine takes points for wider than they are: a voxel beside a shaft
//! may count as in its way and yet as out of its reach. Where a part leaves a shaft hardly
//! more room than it needs, such voxels stand, keep others standing, and a groove that is open to
//! the tool is never cut. Here distances are exact, so what the edge meets it reaches: of a tool that
//! cuts all along, the whole groove goes at once.
//!
//! Method: an over-cut (HB Alg. 6) whose tips are those of the lattice around the few voxels. Each
//! tip's lowest height over what stays is found once, over points in squares, the highest first;
//! then what none of the tips reaches raises those that it is in the way of, until nothing
//! changes.
//!
//! Guarantees: what is removed is accessible against the output state, by the rules to the letter.
//! Not guaranteed: that it is the largest such set; tips farther from the few voxels have no say.

use super::boxes::Boxes;
use super::view::spacing;
use crate::base::{DVec2, DVec3, Direction};
use crate::machine::Tool;
use crate::voxel::{BitGrid, Frame};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::FRAC_1_SQRT_2;
use std::ops::ControlFlow;

/// Tips stand so much farther from the few voxels than the edge is wide, mm: enough to clear the way
/// of a shank that widens. More takes longer, so of hardly any voxels more are looked at.
const MARGIN_MM: f64 = 1.0;
const WIDE_MARGIN_MM: f64 = 4.0;
const HARDLY_ANY: usize = 64;

/// Side of the squares that obstacle points are sorted into, mm: smaller ones are passed over more
/// often, but there are more of them.
const SQUARE_MM: f64 = 2.0;

/// Heights must differ by this much for a verdict, mm: the rounding of coordinates of metres.
const ROUNDING_MM: f64 = 1e-7;

/// A point across a direction, the centre of the cell of the tip lattice that it lies in, and its
/// height along the direction, mm.
#[derive(Clone, Copy)]
struct Spot {
    at: DVec2,
    cell: DVec2,
    z: f64,
}

impl Spot {
    /// How near it comes to the axis of a tool, as the rules or as toolpaths see it: these move
    /// obstacles to their cells, and what they do not dare to cut is not cut.
    fn nearest(&self, tip: DVec2) -> f64 {
        self.at.distance_squared(tip).min(self.cell.distance_squared(tip)).sqrt()
    }
}

/// Points by squares, each square's highest first.
struct Squares {
    /// How far its cell may move a point, mm.
    moved: f64,
    first: [i64; 2],
    size: [usize; 2],
    of: Vec<Vec<Spot>>,
}

fn square(at: DVec2) -> [i64; 2] {
    [at.x, at.y].map(|c| (c / SQUARE_MM).floor() as i64)
}

impl Squares {
    fn new(spots: Vec<Spot>, spacing: f64) -> Squares {
        let (mut first, mut last) = ([i64::MAX; 2], [i64::MIN; 2]);
        for s in &spots {
            let [i, j] = square(s.at);
            first = [first[0].min(i), first[1].min(j)];
            last = [last[0].max(i), last[1].max(j)];
        }
        let size =
            [0, 1].map(|a| if spots.is_empty() { 0 } else { (last[a] - first[a] + 1) as usize });
        let moved = spacing * FRAC_1_SQRT_2;
        let mut squares = Squares { moved, first, size, of: vec![Vec::new(); size[0] * size[1]] };
        for s in spots {
            if let Some(i) = squares.index(square(s.at)) {
                squares.of[i].push(s);
            }
        }
        squares.of.par_iter_mut().for_each(|of| of.sort_by(|a, b| b.z.total_cmp(&a.z)));
        squares
    }

    fn index(&self, [i, j]: [i64; 2]) -> Option<usize> {
        let (i, j) = (i.checked_sub(self.first[0])?, j.checked_sub(self.first[1])?);
        let inside = i >= 0 && j >= 0 && i < self.size[0] as i64 && j < self.size[1] as i64;
        inside.then(|| i as usize + self.size[0] * j as usize)
    }

    /// The lowest height over `floor` at which a tool stands free of all points; above `ceiling`
    /// any such height will do.
    fn lowest_free(
        &self,
        tool: &Tool,
        at: DVec2,
        rings: &[[i64; 2]],
        [floor, ceiling]: [f64; 2],
    ) -> f64 {
        let [i, j] = square(at);
        let mut lowest = floor;
        for [di, dj] in rings {
            let Some(index) = self.index([i + di, j + dj]) else { continue };
            let Some(highest) = self.of[index].first() else { continue };
            let low = DVec2::new((i + di) as f64, (j + dj) as f64) * SQUARE_MM;
            let nearest = at.clamp(low, low + DVec2::splat(SQUARE_MM));
            let least =
                tool.lower_surface((nearest.distance(at) - self.moved - ROUNDING_MM).max(0.0));
            if highest.z - least <= lowest {
                continue;
            }
            for s in &self.of[index] {
                if s.z - least <= lowest {
                    break;
                }
                lowest = lowest.max(s.z - tool.lower_surface(s.nearest(at)));
            }
            if lowest > ceiling {
                break;
            }
        }
        lowest
    }
}

/// A tip and the lowest height at which it may stand, as far as is known.
struct Tip {
    at: DVec2,
    lowest: f64,
}

/// Few voxels in a state, and what may be removed around them.
pub struct Close<'a> {
    frame: &'a Frame,
    /// Voxels that stay. Between the centres of those at its surface a tool finer than the grid may pass and meet an
    /// inner one; along a grid axis it does not.
    stays: BitGrid,
    shell: BitGrid,
    /// Obstacles that are no voxels, mm.
    fixed: &'a [DVec3],
    /// What may be removed.
    soft: Vec<[usize; 3]>,
    few: &'a BitGrid,
}

impl<'a> Close<'a> {
    pub fn new(
        frame: &'a Frame,
        state: &BitGrid,
        (removable, few): (&BitGrid, &'a BitGrid),
        fixed: &'a [DVec3],
    ) -> Self {
        let stays = state.minus(removable);
        let shell = stays.boundary();
        let soft = removable.and(state).iter_ones().collect();
        Close { frame, stays, shell, fixed, soft, few }
    }

    /// A region of what may be removed that the tool removes along `direction`, each voxel of it
    /// accessible against the output state; empty if it has none of the few.
    pub fn cut(&self, tool: &Tool, direction: Direction) -> BitGrid {
        let Close { frame, few, .. } = *self;
        let mut region = BitGrid::new(few.dims());
        let reach = tool.active_radius();
        let wide = tool.max_radius();
        let ends = tool.lower_surface(wide + 1.0).is_infinite();
        let margin_mm = if few.count() <= HARDLY_ANY { WIDE_MARGIN_MM } else { MARGIN_MM };
        if few.is_empty() || !reach.is_finite() || !ends {
            return region;
        }
        let plane = direction.image_plane();
        let (origin, spacing) = (plane.across(frame.center([0; 3])), spacing(frame, direction));
        let lattice = Tips { origin, spacing };
        let spot_at = |p: DVec3| {
            let at = plane.across(p);
            Spot { at, cell: lattice.at(lattice.nearest(at)), z: plane.height(p) }
        };
        let spot = |v: [usize; 3]| spot_at(frame.center(v));
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        let (mut least, mut most) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        let mut tips: BTreeSet<[i64; 2]> = BTreeSet::new();
        for s in few.iter_ones().map(spot) {
            (low, high) = (low.min(s.z), high.max(s.z));
            (least, most) = (least.min(s.at), most.max(s.at));
            tips.extend(lattice.around(s.at, reach + margin_mm));
        }
        // The edge reaches no voxel that lies higher over its tip than it is long.
        let floor = low - tool.active_length() - ROUNDING_MM;
        let margin = DVec2::splat(wide + reach + margin_mm + spacing);
        let (least, most) = (least - margin, most + margin);
        let is_near = |p: DVec3, within: f64| {
            let (at, wide) = (plane.across(p), DVec2::splat(within));
            let beside = at.cmplt(least - wide) | at.cmpgt(most + wide);
            plane.height(p) + within > floor && !beside.any()
        };
        let is_met = |p: &DVec3| is_near(*p, 0.0);
        let stays = if direction.is_grid_axis() { &self.shell } else { &self.stays };
        let mut points: Vec<Spot> =
            self.fixed.iter().copied().filter(is_met).map(spot_at).collect();
        let _ = Boxes::new(frame, stays).visit(&is_near, &mut |v| {
            points.extend(Some(frame.center(v)).filter(is_met).map(spot_at));
            ControlFlow::Continue(())
        });
        let hard = Squares::new(points, spacing);
        let rings = rings(wide);
        let of_tip = |t: &[i64; 2]| {
            let at = lattice.at(*t);
            Tip { at, lowest: hard.lowest_free(tool, at, &rings, [floor, high]) }
        };
        let places: Vec<[i64; 2]> = tips.into_iter().collect();
        let mut tips: Vec<Tip> = places.par_iter().map(of_tip).collect();
        tips.retain(|t| t.lowest <= high);
        if tips.is_empty() {
            return region;
        }
        let soft = self.soft.iter().filter(|v| is_met(&frame.center(**v)));
        let voxels: Vec<([usize; 3], Spot)> = soft.map(|v| (*v, spot(*v))).collect();
        let mut squares: BTreeMap<[i64; 2], Vec<usize>> = BTreeMap::new();
        voxels
            .iter()
            .enumerate()
            .for_each(|(i, v)| squares.entry(square(v.1.at)).or_default().push(i));
        let n = (reach / SQUARE_MM).ceil() as i64;
        let near = |at: DVec2| -> Vec<usize> {
            let [i, j] = square(at);
            let around = (-n..=n).flat_map(|b| (-n..=n).map(move |a| [i + a, j + b]));
            around.filter_map(|s| squares.get(&s)).flatten().copied().collect()
        };
        loop {
            let reached: Vec<Vec<usize>> = tips
                .par_iter()
                .map(|t| {
                    let reaches = |i: &usize| {
                        let rho = voxels[*i].1.at.distance(t.at);
                        let over = voxels[*i].1.z - t.lowest - ROUNDING_MM;
                        rho <= reach && over >= tool.active_lower_surface(rho)
                    };
                    near(t.at).into_iter().filter(reaches).collect()
                })
                .collect();
            let mut gone = vec![false; voxels.len()];
            reached.into_iter().flatten().for_each(|i| gone[i] = true);
            let left = (0..voxels.len()).filter(|i| !gone[*i]).map(|i| voxels[i].1);
            let left = Squares::new(left.collect(), spacing);
            let raise = |t: &mut Tip| {
                let before = t.lowest;
                t.lowest = left.lowest_free(tool, t.at, &rings, [before, high]);
                t.lowest > before
            };
            if tips.par_iter_mut().map(raise).filter(|raised| *raised).count() == 0 {
                let voxels = voxels.iter().zip(&gone).filter(|(_, gone)| **gone);
                voxels.for_each(|((v, _), _)| region.set(*v, true));
                break;
            }
            tips.retain(|t| t.lowest <= high);
        }
        if region.count_and(few) == 0 { BitGrid::new(few.dims()) } else { region }
    }
}

/// The tip lattice of the rules.
struct Tips {
    origin: DVec2,
    spacing: f64,
}

impl Tips {
    fn at(&self, [i, j]: [i64; 2]) -> DVec2 {
        self.origin + DVec2::new(i as f64, j as f64) * self.spacing
    }

    fn nearest(&self, at: DVec2) -> [i64; 2] {
        let at = (at - self.origin) / self.spacing;
        [at.x.round() as i64, at.y.round() as i64]
    }

    /// Those within a radius of a place.
    fn around(&self, at: DVec2, radius: f64) -> impl Iterator<Item = [i64; 2]> + '_ {
        let [i, j] = self.nearest(at);
        let n = (radius / self.spacing).ceil() as i64;
        let all = (-n..=n).flat_map(move |b| (-n..=n).map(move |a| [i + a, j + b]));
        all.filter(move |t| self.at(*t).distance(at) <= radius)
    }
}

/// Squares around one that a tool so wide may meet points in, the nearest first.
fn rings(wide: f64) -> Vec<[i64; 2]> {
    let n = (wide / SQUARE_MM).ceil() as i64 + 1;
    let mut all: Vec<[i64; 2]> = (-n..=n).flat_map(|b| (-n..=n).map(move |a| [a, b])).collect();
    all.sort_by_key(|[a, b]| a * a + b * b);
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::access::over_cut;
    use crate::machine::{Section, Shape, ToolKind};

    const FRAME: Frame = Frame { pitch: 0.5, dims: [44, 24, 40], origin: DVec3::ZERO };

    fn slender() -> Tool {
        let ball = Shape::Ball { radius: 0.7 };
        let edge = Shape::Frustum { z0: 0.7, r0: 0.7, z1: 16.0, r1: 0.7 };
        let holder = Shape::Frustum { z0: 20.0, r0: 5.0, z1: 40.0, r1: 5.0 };
        let section = |(shape, active)| Section { shape, active };
        let sections = [(ball, true), (edge, true), (holder, false)].map(section);
        Tool::new("slender", ToolKind::Subtractive, sections.to_vec())
    }

    /// By the definition, voxel by voxel and tip by tip: the rules' access of a cut.
    fn is_allowed(state: &BitGrid, region: &BitGrid, tool: &Tool, d: Direction) -> bool {
        let (plane, s) = (d.image_plane(), spacing(&FRAME, d));
        let lattice = Tips { origin: plane.across(FRAME.center([0; 3])), spacing: s };
        let place = |v| (plane.across(FRAME.center(v)), plane.height(FRAME.center(v)));
        let standing: Vec<(DVec2, f64)> = state.minus(region).iter_ones().map(place).collect();
        region.iter_ones().map(place).all(|(x, z)| {
            lattice.around(x, tool.active_radius()).map(|t| lattice.at(t)).any(|t| {
                let low = z - tool.active_lower_surface(t.distance(x));
                standing.iter().all(|(o, h)| *h <= low + tool.lower_surface(t.distance(*o)) + 1e-6)
            })
        })
    }

    /// A voxel buried in a block: a needle passes between the centres of the block's surface, and meets those below.
    #[test]
    fn a_tool_finer_than_the_grid_does_not_pass_through_a_solid() {
        let needle = Shape::Frustum { z0: 0.0, r0: 0.1, z1: 30.0, r1: 0.1 };
        let sections = vec![Section { shape: needle, active: true }];
        let tool = Tool::new("needle", ToolKind::Subtractive, sections);
        let state = BitGrid::from_fn(FRAME.dims, |v| v[2] < 36);
        let few = BitGrid::from_fn(FRAME.dims, |v| v == [22, 12, 26]);
        let close = Close::new(&FRAME, &state, (&few, &few), &[]);
        let mut shallow = 0;
        for d in crate::base::fibonacci_sphere(60).into_iter().filter(|d| d.vec().z > 0.3) {
            let region = close.cut(&tool, d);
            assert!(is_allowed(&state, &region, &tool, d), "{d:?}");
            // What the surface alone lets by.
            let shell = state.minus(&few).boundary().or(&few);
            shallow += Close::new(&FRAME, &shell, (&few, &few), &[]).cut(&tool, d).count();
        }
        assert!(shallow > 0);
    }

    /// Leaning grooves a little wider than the cutter, down to a round bottom.
    #[test]
    fn a_groove_hardly_wider_than_the_cutter_is_cut_as_far_as_it_is_open() {
        let d = Direction::new(DVec3::new(0.38, 0.11, 0.92)).unwrap();
        let plane = d.image_plane();
        let across = d.vec().cross(DVec3::Y).normalize();
        let state = BitGrid::from_fn(FRAME.dims, |v| v[2] < 36);
        let (tool, mut more) = (slender(), 0);
        for width in [1.8, 2.0, 2.2, 2.5] {
            let groove = BitGrid::from_fn(FRAME.dims, |v| {
                let p = FRAME.center(v) - FRAME.center([22, 12, 18]);
                let along = plane.height(p) > -4.0 && p.y.abs() < 4.0;
                v[2] < 36 && along && across.dot(p).abs() < width / 2.0
            });
            let by_maps = over_cut(&FRAME, &state, &groove, &[], &tool, d).region;
            let close = Close::new(&FRAME, &state, (&groove, &groove), &[]).cut(&tool, d);
            assert!(is_allowed(&state, &close, &tool, d), "{width}");
            assert!(by_maps.is_subset_of(&close), "{width}");
            more += close.count() - by_maps.count();
        }
        assert!(more > 200, "{more}");
    }

    #[test]
    fn nothing_is_cut_where_none_of_the_few_is_reached() {
        let state = BitGrid::from_fn(FRAME.dims, |v| v[2] < 36);
        let hole = BitGrid::from_fn(FRAME.dims, |v| v[2] > 20 && v[2] < 36 && v[0] / 12 == 1);
        let few = BitGrid::from_fn(FRAME.dims, |v| v == [2, 2, 2]);
        let may = hole.or(&few);
        let close = Close::new(&FRAME, &state, (&may, &few), &[]);
        assert!(close.cut(&slender(), Direction::Z).is_empty());
    }
}
