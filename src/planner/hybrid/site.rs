//! The work seen along one direction: turned so that the direction is +z and every action is a
//! matter of columns.
//!
//! The turn swaps and flips grid axes. It may mirror, which tools that are round about their axis
//! do not notice; tips stand over the same voxels before and after.

use crate::base::{DVec3, Direction};
use crate::machine::{BaseKind, Holding, HoldingMode};
use crate::morph::Axis;
use crate::plan::Job;
use crate::voxel::{BitGrid, Connectivity, Frame, components, flood};

/// The six grid axes; a direction is known by its place here.
pub const AXES: [Direction; 6] = [
    Direction::Z,
    Direction::X,
    Direction::NEG_X,
    Direction::Y,
    Direction::NEG_Y,
    Direction::NEG_Z,
];

/// How close a layer's lower face must be to the base plane to rest on it, in pitches.
const ON_PLANE: f64 = 1e-6;

/// A direction the job allows.
pub struct View {
    /// Place in [`AXES`].
    pub index: usize,
    pub direction: Direction,
    axis: Axis,
    /// Of turned grids: origin 0.
    pub frame: Frame,
    pub target: BitGrid,
    /// The layer that rests on the base plane, where deposits along this direction may begin.
    pub plate: Option<usize>,
    /// Fixed points of the one holding; empty where each step holds the part anew.
    fixed: Vec<DVec3>,
}

/// A state turned to a direction.
pub struct Site<'v> {
    pub view: &'v View,
    pub state: BitGrid,
    pub fixed: Vec<DVec3>,
}

impl View {
    /// The directions along which the machine can work in some holding.
    pub fn all(job: &Job) -> Vec<View> {
        let fixed = match (job.rules.holding, job.rules.base) {
            (HoldingMode::Base, BaseKind::Pedestal) => job.machine.workholding.obstacle_points(
                &Holding::AS_CLAMPED,
                &job.base_contact(),
                &job.frame,
            ),
            _ => Vec::new(),
        };
        let up = |d| match job.rules.holding {
            HoldingMode::Base => Direction::Z,
            HoldingMode::Refixture => d,
        };
        let possible = |(_, d): &(usize, Direction)| job.machine.can_point(up(*d), *d);
        let views = AXES.into_iter().enumerate().filter(possible);
        views.filter_map(|(index, d)| View::along(job, index, d, &fixed)).collect()
    }

    fn along(job: &Job, index: usize, direction: Direction, fixed: &[DVec3]) -> Option<View> {
        let axis = Axis::of(direction)?;
        let frame = Frame {
            pitch: job.frame.pitch,
            dims: axis.dims_up(job.frame.dims),
            origin: DVec3::ZERO,
        };
        let rests = |z: &usize| {
            let low = job.frame.center([0, 0, *z]).z - job.frame.pitch / 2.0;
            low.abs() <= ON_PLANE * job.frame.pitch
        };
        let plate = (direction == Direction::Z).then(|| (0..job.frame.dims[2]).find(rests));
        let target = axis.up(&job.target);
        let mut view = View {
            index,
            direction,
            axis,
            frame,
            target,
            plate: plate.flatten(),
            fixed: Vec::new(),
        };
        view.fixed = fixed.iter().map(|p| view.turned(*p, &job.frame)).collect();
        Some(view)
    }

    /// A point of the work in turned coordinates.
    fn turned(&self, p: DVec3, frame: &Frame) -> DVec3 {
        let d = self.direction.vec();
        let a = (0..3).find(|a| d[*a] != 0.0).unwrap_or(2);
        let mut q = p - frame.origin;
        if d[a] < 0.0 {
            q[a] = frame.dims[a] as f64 * frame.pitch - q[a];
        }
        let (along, last) = (q[a], q[2]);
        q[a] = last;
        q[2] = along;
        q
    }

    pub fn up(&self, grid: &BitGrid) -> BitGrid {
        self.axis.up(grid)
    }

    pub fn down(&self, grid: &BitGrid) -> BitGrid {
        self.axis.down(grid)
    }

    /// The state with what holds it for a step along this direction.
    pub fn site(&self, job: &Job, state: &BitGrid) -> Site<'_> {
        let held_anew =
            job.rules.holding == HoldingMode::Refixture && job.rules.base == BaseKind::Pedestal;
        let fixed = if held_anew {
            let holding = self.holding(job, state);
            let contact = match self.direction == Direction::Z {
                true => job.base_contact(),
                false => holding.contact(state, &job.frame, job.rules.grip_mm),
            };
            let points = job.machine.workholding.obstacle_points(&holding, &contact, &job.frame);
            points.iter().map(|p| self.turned(*p, &job.frame)).collect()
        } else {
            self.fixed.clone()
        };
        Site { view: self, state: self.up(state), fixed }
    }

    /// How the part is held for a step along this direction: as clamped, or lying on what is then
    /// its lowest side.
    pub fn holding(&self, job: &Job, state: &BitGrid) -> Holding {
        if job.rules.holding == HoldingMode::Base || self.direction == Direction::Z {
            return Holding::AS_CLAMPED;
        }
        let half = job.frame.pitch / 2.0;
        let lowest = state.extent().map(|(lo, hi)| {
            let ends = [lo, hi].map(|v| self.direction.dot(job.frame.center(v)));
            ends[0].min(ends[1]) - half
        });
        Holding { up: self.direction, height_mm: lowest.unwrap_or(0.0) }
    }
}

/// The part of a state that stays where it is: connected to what lies within the grip height, or,
/// where steps may hold the part anew, its largest body.
pub fn held(job: &Job, state: &BitGrid) -> BitGrid {
    match job.rules.holding {
        HoldingMode::Base => {
            let mut seeds = BitGrid::new(state.dims());
            let [_, ny, nz] = state.dims();
            let height = |z: usize| Holding::AS_CLAMPED.height(job.frame.center([0, 0, z]));
            for z in (0..nz).filter(|z| height(*z) <= job.rules.grip_mm) {
                for y in 0..ny {
                    seeds.row_mut(y, z).copy_from_slice(state.row(y, z));
                }
            }
            flood(state, &seeds, Connectivity::Edge18)
        }
        HoldingMode::Refixture => {
            let bodies = components(state, Connectivity::Edge18);
            let sizes = bodies.sizes();
            if sizes.len() <= 1 {
                return state.clone();
            }
            let largest = (0..sizes.len()).max_by_key(|&i| (sizes[i], std::cmp::Reverse(i)));
            largest.map_or_else(|| BitGrid::new(state.dims()), |i| bodies.grid_of(i as u32))
        }
    }
}
