//! What directions and tools could reach at best, and which of them comes next.

use super::setting::Setting;
use crate::access::{DepthMap, Scene, Wanted, cutter_maps, reachable};
use crate::base::{Cancelled, Ctx, Direction};
use crate::machine::Tool;
use crate::voxel::{BitGrid, Frame};
use rayon::prelude::*;

/// A shorter tool is taken when it reaches this share of what the best tool reaches; the rest is
/// left to a later block. Lower means more tool changes, higher means longer tools everywhere.
pub const SHORTER_TOOL_SHARE: f64 = 0.97;

/// Directions looked at together, without what those before them reach: more leave more to each,
/// fewer keep threads waiting for the last.
const AT_A_TIME: usize = 16;

/// A direction with a tool and the deep material it could reach at best.
pub struct Reach<'a> {
    pub direction: Direction,
    pub tool: &'a Tool,
    pub bound: Bound,
}

/// A set of voxels, mostly few, of which hundreds are kept: the words of a grid that have any.
pub struct Bound {
    words: Vec<(u32, u64)>,
}

impl Bound {
    pub fn of(grid: &BitGrid) -> Bound {
        let all = grid.words();
        let any = |word: &&u64| **word != 0;
        let mut words = Vec::with_capacity(all.iter().filter(any).count());
        words.extend((0..).zip(all.iter().copied()).filter(|(_, word)| *word != 0));
        Bound { words }
    }

    /// What of some voxels a map reaches.
    fn reached(map: &DepthMap, wanted: &Wanted, frame: &Frame) -> Bound {
        let (grid, Some(few)) = (wanted.grid(), wanted.few()) else {
            return Bound::of(&reachable(map, wanted.grid(), frame));
        };
        let (per_row, ny) = (grid.words_per_row(), grid.dims()[1]);
        let mut words: Vec<(u32, u64)> = Vec::new();
        for [x, y, z] in few.iter().copied().filter(|v| map.reaches(frame.center(*v))) {
            let (i, bit) = ((per_row * (y + ny * z) + x / 64) as u32, 1 << (x % 64));
            match words.last_mut().filter(|(last, _)| *last == i) {
                Some((_, word)) => *word |= bit,
                None => words.push((i, bit)),
            }
        }
        Bound { words }
    }

    /// Voxels of it that a grid has too, whose words these are.
    pub fn count_and(&self, grid: &[u64]) -> usize {
        let both = |(i, word): &(u32, u64)| word & grid.get(*i as usize).copied().unwrap_or(0);
        self.words.iter().map(|w| both(w).count_ones() as usize).sum()
    }

    /// Numbers of its voxels, the same in all bounds on grids of one size; they ascend.
    pub fn ids(&self) -> Vec<usize> {
        let of_word = |(i, word): &(u32, u64)| {
            let (first, word) = (*i as usize * 64, *word);
            (0..64).filter(move |b| word >> b & 1 == 1).map(move |b| first + b)
        };
        self.words.iter().flat_map(of_word).collect()
    }

    /// Adds them to a grid.
    pub fn add_to(&self, grid: &mut BitGrid) {
        let (per_row, ny) = (grid.words_per_row().max(1), grid.dims()[1].max(1));
        for (i, word) in &self.words {
            let row = *i as usize / per_row;
            grid.row_mut(row % ny, row / ny)[*i as usize % per_row] |= word;
        }
    }
}

/// What of `wanted` each direction could reach with each cutter, in a scene where just what stays
/// stands. The cutters of one direction stand together.
pub fn bounds<'a>(
    scene: &Scene,
    wanted: &BitGrid,
    cutters: &'a [Tool],
    directions: &[Direction],
    ctx: &Ctx,
) -> Result<Vec<Reach<'a>>, Cancelled> {
    let wanted = Wanted::of(wanted);
    let along = |direction: &Direction| {
        ctx.check()?;
        Ok(bounds_along(scene, &wanted, cutters, *direction))
    };
    let reach: Vec<Vec<Reach<'a>>> =
        directions.par_iter().map(along).collect::<Result<_, Cancelled>>()?;
    Ok(reach.into_iter().flatten().collect())
}

/// The same along one direction.
pub fn bounds_along<'a>(
    scene: &Scene,
    wanted: &Wanted,
    cutters: &'a [Tool],
    direction: Direction,
) -> Vec<Reach<'a>> {
    let maps = cutter_maps(scene, wanted, cutters, direction);
    let reach = |(tool, map)| {
        let bound = Bound::reached(map, wanted, &scene.frame);
        Reach { direction, tool, bound }
    };
    cutters.iter().zip(&maps).map(reach).collect()
}

/// What of some voxels any cutter reaches along any direction while just `kept` stands.
pub fn within_reach(
    setting: &Setting,
    kept: &BitGrid,
    some: &BitGrid,
    samples: usize,
    ctx: &Ctx,
) -> Result<BitGrid, Cancelled> {
    let frame = &setting.job.frame;
    let mut left = some.clone();
    for holding in 0..setting.holdings.len() {
        let fixed = setting.fixed(holding, kept);
        let scene = Scene::new(frame, kept, &fixed);
        let mut directions = setting.axes(holding);
        directions.extend(setting.sampled(holding, samples));
        for directions in directions.chunks(AT_A_TIME) {
            if left.is_empty() {
                return Ok(some.clone());
            }
            let wanted = Wanted::of(&left);
            let along: Vec<BitGrid> = directions
                .par_iter()
                .map(|d| {
                    ctx.check()?;
                    let mut any = BitGrid::new(some.dims());
                    for map in cutter_maps(&scene, &wanted, setting.cutters(), *d) {
                        Bound::reached(&map, &wanted, frame).add_to(&mut any);
                    }
                    Ok(any)
                })
                .collect::<Result<_, Cancelled>>()?;
            along.iter().for_each(|a| left.subtract(a));
        }
    }
    Ok(some.minus(&left))
}

/// Voxels of `left` that each could reach.
pub fn gains(reach: &[Reach], left: &BitGrid) -> Vec<usize> {
    let words = left.words();
    reach.par_iter().map(|r| r.bound.count_and(&words)).collect()
}

/// The direction with the largest gain, and for it the first tool (they come shortest first) that
/// reaches nearly as much as the best.
pub fn choose(reach: &[Reach], gains: &[usize], barren: &[usize]) -> Option<usize> {
    let open = |i: &usize| gains[*i] > 0 && !barren.contains(i);
    let best = (0..reach.len()).filter(open).max_by_key(|&i| (gains[i], std::cmp::Reverse(i)))?;
    let enough = SHORTER_TOOL_SHARE * gains[best] as f64;
    (0..reach.len())
        .filter(open)
        .find(|&i| reach[i].direction == reach[best].direction && gains[i] as f64 >= enough)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bound_is_the_set_it_was_made_of() {
        let grid = |n: usize| {
            BitGrid::from_fn([70, 9, 11], |[x, y, z]| (x * 7 + y * 13 + z * 29) % n == 0 && y != 5)
        };
        let (a, b) = (grid(23), grid(4));
        let bound = Bound::of(&a);
        assert_eq!(bound.count_and(&b.words()), a.count_and(&b));
        let mut sum = b.clone();
        bound.add_to(&mut sum);
        assert_eq!(sum, a.or(&b));
        assert!(Bound::of(&BitGrid::new([70, 9, 11])).words.is_empty());
    }

    #[test]
    fn a_few_voxels_looked_at_one_by_one_are_what_a_map_reaches() {
        let frame = Frame { pitch: 0.5, dims: [70, 30, 24], origin: crate::base::DVec3::ZERO };
        let kept = BitGrid::from_fn(frame.dims, |[x, y, z]| z < 6 + x / 8 && y > 3 && y < 26);
        let air = BitGrid::from_fn(frame.dims, |[_, y, z]| z < 22 && y > 3 && y < 26).minus(&kept);
        let few = BitGrid::from_fn(frame.dims, |[x, y, z]| (x + 3 * y + 7 * z) % 11 == 0).and(&air);
        let of = crate::machine::Machine::builtin("generic-5axis").unwrap();
        let cutters = of.tools_of(crate::machine::ToolKind::Subtractive);
        let cutters: Vec<Tool> = cutters.into_iter().cloned().collect();
        let scene = Scene::new(&frame, &kept, &[]);
        let mut most = 0;
        for d in [
            Direction::Z,
            Direction::NEG_X,
            Direction::new(crate::base::DVec3::new(0.3, -0.2, 0.9)).unwrap(),
        ] {
            let wanted = Wanted::of(&few);
            assert!(wanted.few().is_some());
            for map in cutter_maps(&scene, &wanted, &cutters, d) {
                let want = reachable(&map, &few, &frame);
                let got = Bound::reached(&map, &wanted, &frame);
                assert_eq!(got.words, Bound::of(&want).words, "{d:?}");
                most = most.max(want.count());
            }
        }
        assert!(most > 300, "{most}");
    }

    #[test]
    fn the_shortest_tool_that_reaches_nearly_as_much_is_taken() {
        let tools = ["ball-3x13", "ball-3x30"].map(|n| {
            let of = crate::machine::Machine::builtin("mx220").unwrap();
            of.tools.iter().find(|t| t.name == n).unwrap().clone()
        });
        let along = |direction, tool| Reach { direction, tool, bound: Bound { words: Vec::new() } };
        let reach = [
            along(Direction::Z, &tools[0]),
            along(Direction::Z, &tools[1]),
            along(Direction::X, &tools[0]),
        ];
        assert_eq!(choose(&reach, &[98, 100, 99], &[]), Some(0));
        assert_eq!(choose(&reach, &[90, 100, 99], &[]), Some(1));
        assert_eq!(choose(&reach, &[90, 100, 99], &[1]), Some(2));
        assert_eq!(choose(&reach, &[0, 0, 0], &[]), None);
    }
}
