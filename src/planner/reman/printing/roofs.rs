//! Roofs over pockets in which no supports may stand, since no cutter would get them out again.
//!
//! Straight up nothing carries such a roof. Along a direction that leans as far as the overhang angle lets it, it grows
//! level out of the walls around the pocket, but only while these are no higher than it is: later the nozzle does not get
//! there any more.
//!
//! Method. What the block straight up leaves though its nozzle gets there falls into bodies, the roofs. Of the one
//! that begins lowest, (1) all that lies lower is laid straight up, (2) it and what stands around it are laid along leaning
//! directions, and along the sampled ones where that is not enough, without what would hide anything that is printed
//! straight up later; (3) what of it is left has its turn again a little higher. In the end the rest follows
//! straight up, on supports.
//!
//! Guarantees: those of blocks (`laying`); not taken where it leaves as much. Not guaranteed: that a roof closes.

use super::super::around::leaning;
use super::super::laying::{Block, Layer, Way, ways_along};
use super::super::supports::lay_on_supports;
use super::{ENOUGH_SHARE, LEAST_AHEAD_MM3, MOST_CRUMBS, OnSupports, Press};
use crate::base::{Cancelled, Ctx, Direction};
use crate::region::above;
use crate::voxel::{BitGrid, Connectivity, components, distance_within};

/// How far around a roof all that is wanted may be printed with it, mm: walls for it to grow out of, wide enough that what
/// carries a bead is among them.
const AROUND_MM: f64 = 4.0;

/// How much higher what is left of a roof has its turn again, mm.
const HIGHER_MM: f64 = 1.0;

/// So many roofs, the largest, and so many turns in all: each takes about as long as the block straight up.
const MOST_ROOFS: usize = 32;
const MOST_TURNS: usize = 64;

/// So many turns of a roof in a row may come to nothing.
const MOST_IN_VAIN: usize = 2;

/// A roof that is due.
struct Roof {
    /// Turns so far that came to nothing.
    in_vain: usize,
    /// From where on it is printed, mm along the direction of the block straight up.
    from: f64,
    body: BitGrid,
}

impl<'a> Press<'_, 'a> {
    /// Lays a block straight up, on supports, and the roofs that it leaves each at the height where it begins.
    pub(super) fn print_with_roofs(
        &mut self,
        block: Block<'a>,
        on: &OnSupports,
        ctx: &Ctx,
    ) -> Result<(), Cancelled> {
        let (left, fixed) = (self.printing.unreached.clone(), self.fixed());
        let missing = left.minus(&block.region).and(self.wanted.core);
        // Crumbs get blocks of their own later, or pits: either takes fewer blocks than floors.
        let crumbs = MOST_CRUMBS * self.setting.job.target.count() as f64;
        if block.way.direction != Direction::Z || missing.count() as f64 <= crumbs {
            self.take(block, left, fixed);
            return Ok(());
        }
        let open = Layer { left: &missing, ..self.fine(&left, &fixed) };
        let open = open.clear_along_any(&[block.way], ctx)?;
        let is_open = |body: &BitGrid| 2 * body.count_and(&open) > body.count();
        let from_below = (f64::NEG_INFINITY, 0);
        let roofs = self.roofs(&missing, block.way.direction, from_below, is_open);
        if !roofs.is_empty() {
            let before = self.printing.clone();
            self.by_floors(roofs, &block, on, ctx)?;
            let after = self.printing.unreached.count_and(self.wanted.core);
            tracing::debug!(before = missing.count(), after, "roofs");
            if after < missing.count() {
                return Ok(());
            }
            self.printing = before;
        }
        self.take(block, left, fixed);
        Ok(())
    }

    /// Of the bodies of what is missing that are wanted, large enough for a block and reach up to a height, the largest.
    fn roofs(
        &self,
        missing: &BitGrid,
        up: Direction,
        (from, in_vain): (f64, usize),
        is_wanted: impl Fn(&BitGrid) -> bool,
    ) -> Vec<Roof> {
        let frame = &self.setting.job.frame;
        let least = self.least_of_roof();
        let bodies = components(missing, Connectivity::Corner26);
        let sizes = bodies.sizes();
        let mut labels: Vec<usize> = (0..sizes.len()).filter(|l| sizes[*l] >= least).collect();
        labels.sort_by_key(|l| std::cmp::Reverse(sizes[*l]));
        let due = |body: BitGrid| {
            let heights = body.iter_ones().map(|v| up.dot(frame.center(v)));
            let (lo, hi) =
                heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), z| (l.min(z), h.max(z)));
            (hi >= from).then_some(Roof { in_vain, from: from.max(lo - frame.pitch / 2.0), body })
        };
        let all = labels.into_iter().map(|l| bodies.grid_of(l as u32));
        all.filter(is_wanted).filter_map(due).take(MOST_ROOFS).collect()
    }

    /// Voxels that a block of a roof lays of it at least.
    fn least_of_roof(&self) -> usize {
        (LEAST_AHEAD_MM3 / self.setting.job.frame.voxel_volume()).ceil() as usize
    }

    /// Lays what a block would, with the roofs in their turns.
    fn by_floors(
        &mut self,
        mut roofs: Vec<Roof>,
        block: &Block<'a>,
        on: &OnSupports,
        ctx: &Ctx,
    ) -> Result<(), Cancelled> {
        let (way, up) = (block.way, block.way.direction);
        // What of the block is not laid yet, supports among it.
        let mut rest = block.region.clone();
        for _ in 0..MOST_TURNS {
            // The lowest first, of those the largest.
            roofs.sort_by(|a, b| {
                b.from.total_cmp(&a.from).then(a.body.count().cmp(&b.body.count()))
            });
            let Some(Roof { in_vain, from, body }) = roofs.pop() else { break };
            if ctx.out_of_time() {
                break;
            }
            let (before, under) = (self.printing.clone(), rest.clone());
            self.print_under(way, from, &mut rest);
            let gained = self.print_leaning((&body, from), way, &mut rest, ctx)?;
            tracing::debug!(from, size = body.count(), gained, "roof");
            if gained == 0 {
                (self.printing, rest) = (before, under);
            }
            let in_vain = if gained == 0 { in_vain + 1 } else { 0 };
            if in_vain < MOST_IN_VAIN {
                let still = body.and(&self.printing.unreached);
                roofs.extend(self.roofs(&still, up, (from + HIGHER_MM, in_vain), |_| true));
            }
        }
        let (left, fixed) = (self.printing.unreached.clone(), self.fixed());
        let all = left.or(&rest);
        let last = lay_on_supports(&self.fine(&all, &fixed), way, on);
        if !last.region.is_empty() {
            self.take(last, left, fixed);
        }
        Ok(())
    }

    /// Lays what lies lower than a height of the rest of a block, and what else of that can be.
    fn print_under(&mut self, way: Way<'a>, from: f64, rest: &mut BitGrid) {
        let fixed = self.fixed();
        let all = rest.or(&self.printing.unreached);
        let frame = &self.setting.job.frame;
        let under = all.minus(&above(&all, frame, way.direction.vec(), from));
        let block = self.fine(&under, &fixed).lay(way);
        rest.subtract(&block.region);
        if !block.region.is_empty() {
            self.put(block, fixed);
        }
    }

    /// Lays a roof and what is wanted around it, over a height, in leaning blocks; how many voxels of it they lay.
    fn print_leaning(
        &mut self,
        (body, from): (&BitGrid, f64),
        way: Way<'a>,
        rest: &mut BitGrid,
        ctx: &Ctx,
    ) -> Result<usize, Cancelled> {
        let job = self.setting.job;
        let leaning = ways_along(self.setting, &leaning(job.rules.overhang_deg), way.tool);
        let near = distance_within(body, AROUND_MM / job.frame.pitch);
        let near = above(&near, &job.frame, way.direction.vec(), from);
        let mut gained = 0;
        loop {
            ctx.check()?;
            let left = self.printing.unreached.and(&near);
            let core = body.and(&self.printing.unreached);
            let fixed = self.fixed();
            let layer = Layer { core: &core, closely: true, ..self.fine(&left, &fixed) };
            let mut best = layer.best(&leaning, ctx)?;
            let enough = ENOUGH_SHARE * core.count() as f64;
            if best.as_ref().is_none_or(|b| (b.gain as f64) < enough) {
                let other = layer.best(&self.sampled, ctx)?;
                let gain = best.as_ref().map_or(0, |b| b.gain);
                best = other.filter(|o| o.gain > gain).or(best);
            }
            let Some(block) = best else { break };
            let unlaid = self.printing.unreached.or(rest);
            let block = hiding_nothing(&layer, &block, &unlaid);
            if block.gain < self.least_of_roof() {
                break;
            }
            gained += block.gain;
            rest.subtract(&block.region);
            self.put(block, fixed);
        }
        Ok(gained)
    }
}

/// A block without what stands over anything that is not laid with it, and without what that carries.
pub(super) fn hiding_nothing<'a>(layer: &Layer, all: &Block<'a>, unlaid: &BitGrid) -> Block<'a> {
    let mut block = Block { region: all.region.clone(), ..*all };
    loop {
        let floors = lowest_of_columns(&unlaid.minus(&block.region));
        let [nx, _, _] = unlaid.dims();
        let mut kept = block.region.clone();
        for v in block.region.iter_ones().filter(|v| v[2] > floors[v[0] + nx * v[1]]) {
            kept.set(v, false);
        }
        if kept == block.region {
            return block;
        }
        block = Layer { left: &kept, ..*layer }.lay(block.way);
    }
}

/// How many voxels that are not laid with a block stand under it.
pub(super) fn hidden_by(block: &Block, unlaid: &BitGrid) -> usize {
    let [nx, ny, _] = unlaid.dims();
    let mut highest = vec![0; nx * ny];
    for [x, y, z] in block.region.iter_ones() {
        let column = &mut highest[x + nx * y];
        *column = z.max(*column);
    }
    let is_hidden = |[x, y, z]: &[usize; 3]| *z < highest[x + nx * y];
    unlaid.minus(&block.region).iter_ones().filter(is_hidden).count()
}

/// Layer of the lowest voxel of each column along z, x first; past all layers where there is none.
fn lowest_of_columns(of: &BitGrid) -> Vec<usize> {
    let [nx, ny, _] = of.dims();
    let mut lowest = vec![usize::MAX; nx * ny];
    for [x, y, z] in of.iter_ones() {
        let column = &mut lowest[x + nx * y];
        *column = z.min(*column);
    }
    lowest
}

#[cfg(test)]
mod tests {
    use super::super::super::coarse::Coarse;
    use super::super::super::local_tests::{assert_verifies, job_of};
    use super::super::super::setting::Setting;
    use super::super::{Patience, Printing, Wanted, print_on_supports};
    use super::*;
    use crate::base::DVec3;
    use crate::machine::Taken;
    use crate::plan::Job;
    use crate::voxel::Frame;

    const DIMS: [usize; 3] = [60, 44, 40];

    /// In a box over a plate, a chamber closed on all sides.
    fn chamber([x, y, z]: [usize; 3]) -> bool {
        (18..42).contains(&x) && (14..30).contains(&y) && (10..20).contains(&z)
    }

    /// The box, so many layers high and with walls so thick.
    fn boxed(height: usize, wall: usize) -> Job {
        let frame = Frame { pitch: 0.5, dims: DIMS, origin: DVec3::ZERO };
        let plate = |[x, y, z]: [usize; 3]| (6..54).contains(&x) && (6..38).contains(&y) && z < 6;
        let around = |[x, y, z]: [usize; 3]| {
            let is_within = (18 - wall..42 + wall).contains(&x);
            is_within && (14 - wall..30 + wall).contains(&y) && z < height
        };
        let initial = BitGrid::from_fn(DIMS, plate);
        let target = BitGrid::from_fn(DIMS, |v| plate(v) || around(v) && !chamber(v));
        job_of(frame, initial, target, |t| t.taken <= Taken::LastResort)
    }

    /// What is printed of it on supports that stand anywhere but in the chamber.
    fn printed(job: &Job) -> Printing {
        let (setting, coarse) = (Setting::new(job).with_last_resort(), Coarse::of(job));
        let added = job.target.minus(&job.initial);
        let wanted = Wanted {
            state: &job.initial,
            added: &added,
            core: &added,
            preferred: &[Direction::Z],
            samples: 60,
            patience: Patience::Endless,
        };
        let (none, avoided) = (BitGrid::new(DIMS), BitGrid::from_fn(DIMS, chamber));
        let on =
            OnSupports { direction: Direction::Z, avoided: &avoided, slim: &none, ahead: &none };
        print_on_supports(&setting, &coarse, &wanted, on, &Ctx::quiet()).unwrap()
    }

    #[test]
    fn a_level_roof_over_a_chamber_grows_out_of_its_walls() {
        let job = boxed(30, 8);
        let printing = printed(&job);
        assert_eq!(printing.unreached.count(), 0);
        assert!(printing.state.is_subset_of(&job.target));
        let leans = |d: Direction| d.vec().z > 0.1 && d.vec().z < 0.99;
        assert!(printing.steps.iter().any(|s| leans(s.direction)));
        assert_verifies(&job, printing.steps);
    }

    /// Where all that lies over the chamber leans, nothing is left for a block straight up.
    #[test]
    fn no_block_is_empty_where_the_roof_is_the_top() {
        let job = boxed(24, 4);
        let printing = printed(&job);
        assert_eq!(printing.unreached.count(), 0);
        assert!(printing.steps.iter().all(|s| !s.region.is_empty()));
        assert_verifies(&job, printing.steps);
    }

    /// A shelf on a wall, over a ridge that is printed later.
    #[test]
    fn what_hides_later_deposits_is_left_out_with_what_it_carries() {
        let plate = |[_, _, z]: [usize; 3]| z < 6;
        let wall = |[x, y, z]: [usize; 3]| (10..30).contains(&y) && x < 10 && z < 20;
        let ridge = |[x, y, z]: [usize; 3]| (10..30).contains(&y) && x == 14 && z == 6;
        let frame = Frame { pitch: 0.5, dims: DIMS, origin: DVec3::ZERO };
        let state = BitGrid::from_fn(DIMS, |v| plate(v) || wall(v));
        let shelf = BitGrid::from_fn(DIMS, |[x, y, z]| {
            (10..30).contains(&y) && (10..20).contains(&x) && (14..18).contains(&z)
        });
        let unlaid = BitGrid::from_fn(DIMS, ridge).or(&shelf);
        let job = job_of(frame, state.clone(), state.or(&unlaid), |_| true);
        let fixed = vec![Vec::new()];
        let layer = Layer {
            job: &job,
            state: &state,
            left: &shelf,
            core: &shelf,
            fixed: &fixed,
            closely: false,
        };
        let direction = leaning(50.0)[0];
        let tool = job.nozzles.last().unwrap();
        let block = layer.lay(Way { direction, holding: 0, tool });
        let columns = |b: &BitGrid| b.iter_ones().map(|v| v[0]).max();
        assert_eq!(columns(&block.region), Some(19));
        assert_eq!(hidden_by(&block, &unlaid), 20);
        let kept = hiding_nothing(&layer, &block, &unlaid);
        assert_eq!(hidden_by(&kept, &unlaid), 0);
        // What lies beyond the ridge has nothing left to grow out of.
        assert_eq!(columns(&kept.region), Some(13));
        assert_eq!(kept.gain, kept.region.count());
    }
}
