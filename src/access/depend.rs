//! The collision dependency graph (W2V App. B): which cells of the reused volume stand in the way
//! of which points, so that a state is judged without any geometry.
//!
//! Method. The reused volume is a set of *cells* (voxels of a coarse grid). For every sampled point
//! and every *pose* of a tool at it (direction, and where the edge touches the point) the graph
//! holds the cells that the tool would meet there. A point is free once some pose of it has no
//! blocker left. A point may belong to a cell: it counts only once that cell is given up, since
//! only then is there something to cut and to print.
//!
//! What differs from the paper: it keeps the blockers of the best contact of a direction; here
//! every contact is a pose, so that the verdict equals the full analysis whatever is given up. It
//! keeps counters; here a pose is a few words of bits, tested until the first blocker that still
//! stands, and nothing is to be undone between two states.
//!
//! Guarantees: [`DependencyGraph::inaccessible`] equals placing every tool at every pose against
//! the cells that are left (tested). Not guaranteed: anything between the sampled points and
//! directions, nor that free points can be reached one after the other.
//!
//! Units: mm. A tool is taken as going up without end, as in the depth engine.

use crate::base::{DVec3, Direction};
use crate::machine::{Tool, ToolKind};
use crate::voxel::{BitGrid, Frame};
use rayon::prelude::*;

/// The cells of a solid, numbered in the order of [`BitGrid::iter_ones`].
#[derive(Clone, Debug)]
pub struct Cells {
    pub frame: Frame,
    voxels: Vec<[usize; 3]>,
}

/// A set of cells, one bit each.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CellSet(Vec<u64>);

impl Cells {
    pub fn of(frame: &Frame, solid: &BitGrid) -> Cells {
        Cells { frame: *frame, voxels: solid.iter_ones().collect() }
    }

    pub fn len(&self) -> usize {
        self.voxels.len()
    }

    pub fn is_empty(&self) -> bool {
        self.voxels.is_empty()
    }

    pub fn center(&self, cell: usize) -> DVec3 {
        self.frame.center(self.voxels[cell])
    }

    /// The cells that lie in `grid`.
    pub fn set_of(&self, grid: &BitGrid) -> CellSet {
        let mut set = CellSet::none(self.len());
        for (i, v) in self.voxels.iter().enumerate() {
            if grid.get(*v) {
                set.insert(i);
            }
        }
        set
    }

    pub fn grid_of(&self, set: &CellSet) -> BitGrid {
        let mut grid = BitGrid::new(self.frame.dims);
        for (i, v) in self.voxels.iter().enumerate() {
            if set.contains(i) {
                grid.set(*v, true);
            }
        }
        grid
    }
}

impl CellSet {
    pub fn none(cells: usize) -> CellSet {
        CellSet(vec![0; cells.div_ceil(64)])
    }

    pub fn insert(&mut self, cell: usize) {
        self.0[cell / 64] |= 1 << (cell % 64);
    }

    pub fn contains(&self, cell: usize) -> bool {
        self.0[cell / 64] >> (cell % 64) & 1 == 1
    }

    pub fn count(&self) -> usize {
        self.0.iter().map(|w| w.count_ones() as usize).sum()
    }

    pub fn union_with(&mut self, other: &CellSet) {
        self.0.iter_mut().zip(&other.0).for_each(|(a, b)| *a |= b);
    }
}

/// A point that a tool must reach.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Demand {
    pub point: DVec3,
    pub kind: ToolKind,
    /// The cell whose giving up makes the point count; none for one that always counts.
    pub owner: Option<usize>,
}

/// What all poses of a graph have in common.
pub struct Reachers<'a> {
    pub cutters: &'a [Tool],
    pub nozzles: &'a [Tool],
    pub directions: &'a [Direction],
    /// Whether the obstacles that never move (table, pedestal) leave a point open to a tool along
    /// the direction of that index.
    pub open: &'a (dyn Fn(&Demand, usize, &Tool) -> bool + Sync),
    /// How far an obstacle's centre may lie inside a tool before it counts: half a cell lets a tool
    /// touch what it rides on.
    pub slack_mm: f64,
}

/// A pose's blockers, word by word of a [`CellSet`].
#[derive(Clone, Debug)]
struct Pose(Vec<(u32, u64)>);

#[derive(Clone, Debug)]
struct Node {
    demand: usize,
    owner: Option<usize>,
    /// Fewest blockers first.
    poses: Vec<Pose>,
}

/// Points with their poses; those that are free whatever stands are left out.
#[derive(Clone, Debug)]
pub struct DependencyGraph {
    nodes: Vec<Node>,
}

/// Sideways contacts of a cutter's edge per direction, evenly round the axis, beside the tip.
const FLANK_CONTACTS: usize = 4;

/// Words of blockers in a graph (16 bytes each): about half a gigabyte. Points beyond it are left
/// out, every n-th stays, so that the sample thins evenly.
const MOST_WORDS: usize = 1 << 25;

impl DependencyGraph {
    /// Poses every tool at every demand along every direction against all cells.
    pub fn new(cells: &Cells, demands: &[Demand], reachers: &Reachers) -> DependencyGraph {
        let node = |i: usize| node(cells, i, &demands[i], reachers);
        let all = 0..demands.len();
        // A first few tell how many words a point takes.
        let probe = demands.len().div_ceil(32).max(1);
        let sample: Vec<Node> =
            all.clone().into_par_iter().step_by(probe).filter_map(node).collect();
        let words: usize = sample.iter().flat_map(|n| &n.poses).map(|p| p.0.len()).sum();
        let stride = (words * probe).div_ceil(MOST_WORDS).max(1);
        let nodes = all.into_par_iter().step_by(stride).filter_map(node).collect();
        DependencyGraph { nodes }
    }

    /// The graph without the points that always count and that no pose reaches whatever is given
    /// up: they are no reason to prefer one state to another.
    pub fn without_hopeless(mut self) -> DependencyGraph {
        self.nodes.retain(|n| n.owner.is_some() || !n.poses.is_empty());
        self
    }

    /// Points in the graph, whether they count or not.
    pub fn len(&self) -> usize {
        self.nodes.len()
    }

    pub fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    /// Points that count and that nothing reaches once the cells of `given_up` are gone.
    pub fn inaccessible(&self, given_up: &CellSet) -> usize {
        self.nodes.iter().filter(|n| n.is_stuck(given_up)).count()
    }

    /// Indices of the demands of those points, ascending.
    pub fn stuck(&self, given_up: &CellSet) -> Vec<usize> {
        self.nodes.iter().filter(|n| n.is_stuck(given_up)).map(|n| n.demand).collect()
    }

    /// Whether there is no such point; stops at the first.
    pub fn all_accessible(&self, given_up: &CellSet) -> bool {
        !self.nodes.iter().any(|n| n.is_stuck(given_up))
    }
}

impl Node {
    fn is_stuck(&self, given_up: &CellSet) -> bool {
        self.owner.is_none_or(|c| given_up.contains(c))
            && !self.poses.iter().any(|p| p.is_free(given_up))
    }
}

impl Pose {
    fn is_free(&self, given_up: &CellSet) -> bool {
        self.0.iter().all(|(word, bits)| bits & !given_up.0[*word as usize] == 0)
    }
}

/// The poses of one demand; none when one of them is free whatever stands.
fn node(cells: &Cells, index: usize, demand: &Demand, reachers: &Reachers) -> Option<Node> {
    let tools = match demand.kind {
        ToolKind::Subtractive => reachers.cutters,
        ToolKind::Additive => reachers.nozzles,
    };
    let mut poses = Vec::new();
    for (along, direction) in reachers.directions.iter().enumerate() {
        let plane = direction.image_plane();
        for tool in tools.iter().filter(|t| (reachers.open)(demand, along, t)) {
            for (across, above) in contacts(tool) {
                let tip = demand.point
                    - plane.world(crate::base::DVec2::from(across), 0.0)
                    - direction.vec() * above;
                let meets = |o: DVec3| blocks(tool, tip, *direction, reachers.slack_mm, o);
                let mut words: Vec<(u32, u64)> = Vec::new();
                for cell in 0..cells.len() {
                    if Some(cell) != demand.owner && meets(cells.center(cell)) {
                        let (word, bit) = ((cell / 64) as u32, 1 << (cell % 64));
                        match words.last_mut() {
                            Some((w, bits)) if *w == word => *bits |= bit,
                            _ => words.push((word, bit)),
                        }
                    }
                }
                if words.is_empty() {
                    return None;
                }
                poses.push(Pose(words));
            }
        }
    }
    poses.sort_by_key(|p| p.0.len());
    Some(Node { demand: index, owner: demand.owner, poses })
}

/// Where a tool touches a point: (across the axis, above the tip). A nozzle prints under its tip; a
/// cutter cuts there and with its flank.
fn contacts(tool: &Tool) -> Vec<([f64; 2], f64)> {
    let mut contacts = vec![([0.0, 0.0], 0.0)];
    if tool.kind == ToolKind::Subtractive {
        let (radius, height) = (tool.active_radius(), tool.active_length() / 2.0);
        contacts.extend((0..FLANK_CONTACTS).map(|i| {
            let (s, c) = (i as f64 * std::f64::consts::TAU / FLANK_CONTACTS as f64).sin_cos();
            ([radius * c, radius * s], height)
        }));
    }
    contacts
}

/// Whether a tool with its tip at `tip` along `direction` meets an obstacle point by more than the
/// slack.
fn blocks(tool: &Tool, tip: DVec3, direction: Direction, slack: f64, o: DVec3) -> bool {
    let from_tip = o - tip;
    let height = direction.dot(from_tip);
    if height <= slack {
        return false;
    }
    let rho = (from_tip - direction.vec() * height).length();
    height > tool.lower_surface(rho) + slack
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::{fibonacci_sphere, rng};
    use rand::RngExt;

    fn frame() -> Frame {
        Frame { pitch: 2.0, dims: [14, 12, 10], origin: DVec3::new(-3.0, 1.0, 0.5) }
    }

    /// Boulders on a plate.
    fn solid(rng: &mut crate::base::Rng) -> BitGrid {
        let balls: Vec<(DVec3, f64)> = (0..5)
            .map(|_| {
                let at = DVec3::new(rng.random(), rng.random(), rng.random());
                (at * DVec3::new(14.0, 12.0, 8.0), 1.5 + 2.0 * rng.random::<f64>())
            })
            .collect();
        BitGrid::from_fn(frame().dims, |v| {
            let p = DVec3::from(v.map(|c| c as f64));
            v[2] == 0 || balls.iter().any(|(c, r)| (p - *c).length() <= *r)
        })
    }

    /// A demand is stuck when no pose is clear of what stands: every pose placed anew.
    fn stuck_in_full(demand: &Demand, standing: &[DVec3], reachers: &Reachers) -> bool {
        let tools = match demand.kind {
            ToolKind::Subtractive => reachers.cutters,
            ToolKind::Additive => reachers.nozzles,
        };
        !reachers.directions.iter().enumerate().any(|(i, d)| {
            tools.iter().filter(|t| (reachers.open)(demand, i, t)).any(|tool| {
                contacts(tool).iter().any(|(across, above)| {
                    let plane = d.image_plane();
                    let tip = demand.point
                        - plane.world(crate::base::DVec2::from(*across), 0.0)
                        - d.vec() * *above;
                    let hit = |o: &DVec3| {
                        let z = (*o - tip).dot(d.vec());
                        let rho = ((*o - tip) - d.vec() * z).length();
                        z > reachers.slack_mm && z > tool.lower_surface(rho) + reachers.slack_mm
                    };
                    !standing.iter().any(hit)
                })
            })
        })
    }

    #[test]
    fn the_verdict_equals_full_analysis_on_random_plane_sets() {
        let mut rng = rng(41, 0);
        let cutters = [Tool::builtin("w2v-cutter").unwrap()];
        let nozzles = [Tool::builtin("w2v-nozzle").unwrap()];
        let frame = frame();
        let mut verdicts = [0usize; 2];
        for _ in 0..20 {
            let solid = solid(&mut rng);
            let cells = Cells::of(&frame, &solid);
            let upper: Vec<Direction> =
                fibonacci_sphere(24).into_iter().filter(|d| d.vec().z > 0.0).collect();
            // Low points are shut to leaning tools, as a table would have it.
            let open = |d: &Demand, i: usize, _: &Tool| d.point.z > 4.0 || upper[i].vec().z > 0.4;
            let reachers = Reachers {
                cutters: &cutters,
                nozzles: &nozzles,
                directions: &upper,
                open: &open,
                slack_mm: 1.0,
            };
            let free: Vec<[usize; 3]> = BitGrid::from_fn(frame.dims, |_| true)
                .minus(&solid)
                .iter_ones()
                .filter(|v| v.iter().sum::<usize>() % 7 == 0)
                .collect();
            let kinds = [ToolKind::Subtractive, ToolKind::Additive];
            let outside = free.iter().enumerate().map(|(i, v)| Demand {
                point: frame.center(*v),
                kind: kinds[i % 2],
                owner: None,
            });
            let inside = (0..cells.len()).step_by(9).map(|c| Demand {
                point: cells.center(c),
                kind: kinds[c % 2],
                owner: Some(c),
            });
            let demands: Vec<Demand> = outside.chain(inside).collect();
            let graph = DependencyGraph::new(&cells, &demands, &reachers);
            for _ in 0..25 {
                let mut given_up = CellSet::none(cells.len());
                for _ in 0..rng.random_range(0..3) {
                    let normal = upper[rng.random_range(0..upper.len())];
                    let through = cells.center(rng.random_range(0..cells.len()));
                    let over = |c: &usize| normal.dot(cells.center(*c) - through) > 0.0;
                    (0..cells.len()).filter(over).for_each(|c| given_up.insert(c));
                }
                let standing: Vec<DVec3> = (0..cells.len())
                    .filter(|c| !given_up.contains(*c))
                    .map(|c| cells.center(c))
                    .collect();
                let counts = |d: &&Demand| d.owner.is_none_or(|c| given_up.contains(c));
                let stuck = demands
                    .iter()
                    .filter(counts)
                    .filter(|d| stuck_in_full(d, &standing, &reachers))
                    .count();
                assert_eq!(graph.inaccessible(&given_up), stuck);
                assert_eq!(graph.all_accessible(&given_up), stuck == 0);
                verdicts[usize::from(stuck == 0)] += 1;
            }
        }
        assert!(verdicts.iter().all(|n| *n > 20), "one-sided: {verdicts:?}");
    }

    #[test]
    fn cells_and_grids_convert_back_and_forth() {
        let solid = solid(&mut rng(3, 0));
        let cells = Cells::of(&frame(), &solid);
        let half = BitGrid::from_fn(frame().dims, |[x, ..]| x < 6);
        let set = cells.set_of(&half);
        assert_eq!(cells.grid_of(&set), solid.and(&half));
        assert_eq!(set.count(), solid.count_and(&half));
    }
}
