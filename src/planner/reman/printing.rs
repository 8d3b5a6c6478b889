//! Additive blocks (W2V Sec. 6): V_A in blocks along few directions.
//!
//! Method. The way (direction, holding, nozzle) that lays most comes first, then the one that lays
//! most of the rest; which one that is, is judged on the coarse grid, and the block itself is laid
//! on the job's own (`laying`). A large block may close in on what is left: on the slope where it
//! ends, the first layers of the next block fit no direction. So shares can be left free: what
//! lies over a plane across the direction of a later block. All else is printed first, and that
//! block then begins on a clean plane with nothing over it. Or all goes along the axes first
//! (`print_along_axes`). Blocks have a least size, since a change of direction for a crumb helps nobody; but where crumbs
//! are all that is missing in the end, they get blocks as small as they are (`print_crumbs`). On supports, roofs
//! over pockets that are to have none come in their turn (`roofs`).
//!
//! Guarantees: each block's voxels are carried, clear and connected when they are laid. Not
//! guaranteed: that every voxel finds its turn; what no block reaches is returned.

mod roofs;

use super::coarse::Coarse;
use super::laying::{Block, Layer, Way, ways_along};
use super::setting::Setting;
use super::supports::lay_on_supports;
use crate::base::{Cancelled, Ctx, DVec3, Direction};
use crate::machine::Tool;
use crate::plan::{Origin, Plane, Step, StepKind};
use crate::region::above;
use crate::voxel::{BitGrid, Connectivity, Frame, distance_within, flood};
use roofs::{hidden_by, hiding_nothing};

/// The additive steps, the state they leave, what of V_A they could not add, and what they added
/// beside it to carry it.
#[derive(Clone)]
pub struct Printing {
    pub steps: Vec<Step>,
    pub state: BitGrid,
    pub unreached: BitGrid,
    /// What each block would have had, had all before it left that free.
    pub shares: Vec<Share>,
    /// Whether patience was lost while much was left.
    pub was_given_up: bool,
    /// The holding in use and its fixed points: it stays as it began until another takes its place.
    held: Option<(usize, Vec<DVec3>)>,
}

impl Printing {
    /// Nothing printed yet: what stands, and what is missing.
    pub fn before_any(state: BitGrid, missing: BitGrid) -> Printing {
        Printing {
            steps: Vec::new(),
            state,
            unreached: missing,
            shares: Vec::new(),
            was_given_up: false,
            held: None,
        }
    }
}

/// What is to be printed.
pub struct Wanted<'w> {
    /// What stands before anything is printed.
    pub state: &'w BitGrid,
    pub added: &'w BitGrid,
    /// The part of `added` beyond skin, the only one that asks for blocks.
    pub core: &'w BitGrid,
    /// Directions tried before the sampled ones.
    pub preferred: &'w [Direction],
    /// Sampled directions per hemisphere.
    pub samples: usize,
    pub patience: Patience,
}

/// When blocks that lay little of much that is left are no longer looked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Patience {
    /// Never.
    Endless,
    /// When fifty like one would not bring what is left of the core down to so many voxels: a plan is known that leaves
    /// no more.
    UpTo(usize),
    /// When more is left than the rules allow and ten like one are wanted: how much is left is told from how much is.
    AtAGlance,
}

impl Patience {
    /// Whether it is lost after a block, of what is `left` over and `allowed` by the rules, lays so many.
    fn is_lost(self, left: usize, allowed: f64, gain: usize) -> bool {
        match self {
            Patience::Endless => false,
            Patience::UpTo(known) => left > known.saturating_add(MANY_BLOCKS * gain),
            Patience::AtAGlance => {
                left as f64 > allowed + gain as f64 && (gain as f64) < LITTLE_SHARE * left as f64
            }
        }
    }
}

/// A part of what is wanted that is left free until the rest is printed, then printed along one
/// direction: what lies over a plane, so that its block finds the space over the plane empty.
#[derive(Clone)]
pub struct Share {
    pub direction: Direction,
    pub region: BitGrid,
}

/// A preferred direction (plane or facet normal, up) is taken without a look at the samples when
/// it prints this share of what is left.
const ENOUGH_SHARE: f64 = 0.9;

/// A block prints at least this share of the core: less is left to a plane or to the residual,
/// since a change of direction for a crumb helps nobody.
const LEAST_SHARE: f64 = 5e-4;

/// And at least this much, mm³: a deposit smaller than a few millimetres of bead has no path.
const LEAST_MM3: f64 = 2.0;

/// The same for what is printed ahead of all else, mm³: a few beads in a crease that nothing gets at
/// later. Found on small parts: with 0.6 the beads of such a block lie half on each other, with 1 too
/// few creases get one.
const LEAST_AHEAD_MM3: f64 = 0.8;

/// Of so many voxels that are printed ahead of all else one was missing before: with each comes what lies around it. As many
/// are given up rather than hide one that would be laid. On two parts 5 to 7 for one were worth it and 8 for one were not.
const AROUND_MISSING: usize = 7;

/// A block that lays less than this share of what is left is little of it: half a dozen more
/// like it would leave half.
const LITTLE_SHARE: f64 = 0.1;

/// So many blocks are more than anybody wants.
const MANY_BLOCKS: usize = 50;

/// Share of the target that may be missing for blocks as small as what is missing; of small parts
/// no more than so many blocks of the usual least size.
pub const MOST_CRUMBS: f64 = 1e-3;
const FEW_BLOCKS: f64 = 4.0;

/// With a crumb, all that is missing so far around it is printed, mm: a bead or two.
const WITH_CRUMB_MM: f64 = 1.5;

/// So many voxels of the crumbs are asked first, all along every way, whether a nozzle gets at them.
const FIRST_CRUMBS: usize = 16;

/// Of so many voxels it is kept which of some hundred ways lay them: 160 MB.
const MOST_SCARCE: usize = 200_000;

/// Ways that are looked at closely after the coarse ranking, of the preferred and of the sampled
/// ones: more costs time, fewer trusts a staircase of coarse voxels too much.
const FINALISTS: usize = 3;

/// Prints what is wanted, block by block.
pub fn print_blocks(
    setting: &Setting,
    coarse: &Coarse,
    wanted: &Wanted,
    shares: &[Share],
    ctx: &Ctx,
) -> Result<Printing, Cancelled> {
    let Some(mut press) = Press::new(setting, coarse, wanted) else {
        return Ok(wanted.unprinted());
    };
    if !shares.is_empty() {
        press.print_shares(shares, ctx)?;
    }
    press.print_among(wanted.added, ctx)?;
    Ok(press.printing)
}

/// The same, but along the preferred directions and the axes as long as they lay enough: blocks along tilted ones
/// may lay more at first and close in on what is left.
pub fn print_along_axes(
    setting: &Setting,
    coarse: &Coarse,
    wanted: &Wanted,
    ctx: &Ctx,
) -> Result<Printing, Cancelled> {
    let Some(mut press) = Press::new(setting, coarse, wanted) else {
        return Ok(wanted.unprinted());
    };
    let longest = setting.nozzles().last();
    let axes: Vec<Direction> = (0..setting.holdings.len()).flat_map(|h| setting.axes(h)).collect();
    let all = press.preferred.clone();
    press.preferred.extend(longest.into_iter().flat_map(|tool| ways_along(setting, &axes, tool)));
    let sampled = std::mem::take(&mut press.sampled);
    press.print_among(wanted.added, ctx)?;
    (press.preferred, press.sampled) = (all, sampled);
    press.print_among(wanted.added, ctx)?;
    Ok(press.printing)
}

/// What was printed, and after it what little is missing, in blocks however small, if `enough` of it has its turn:
/// told from how many voxels of the core are missing before and after.
pub fn print_crumbs(
    setting: &Setting,
    coarse: &Coarse,
    wanted: &Wanted,
    printing: Printing,
    enough: impl Fn(usize, usize) -> bool,
    ctx: &Ctx,
) -> Result<Printing, Cancelled> {
    let missing = printing.unreached.and(wanted.core);
    let before = missing.count();
    let share = MOST_CRUMBS * setting.job.target.count() as f64;
    let most = share.max(FEW_BLOCKS * LEAST_MM3 / setting.job.frame.voxel_volume());
    if before == 0 || before as f64 > most || wanted.patience == Patience::AtAGlance {
        return Ok(printing);
    }
    let Some(mut press) = Press::new(setting, coarse, wanted) else { return Ok(printing) };
    (press.printing, press.closely) = (printing.clone(), true);
    let near = distance_within(&missing, WITH_CRUMB_MM / setting.job.frame.pitch);
    let ways: Vec<Way> = press.preferred.iter().chain(&press.sampled).copied().collect();
    let fixed = press.fixed();
    // Deposits take room from nozzles and never give any. A few from all over mostly tell that it is in vain.
    let hopeless = |some: &BitGrid| -> Result<usize, Cancelled> {
        let open = press.fine(some, &fixed).clear_along_any(&ways, ctx)?;
        Ok(some.count() - open.count())
    };
    let mut in_vain = hopeless(&every(before.div_ceil(FIRST_CRUMBS), &missing))?;
    if enough(before, in_vain) {
        in_vain = hopeless(&missing)?;
    }
    if enough(before, in_vain) {
        press.print_small(&near, &ways, ctx)?;
    }
    let after = press.printing.unreached.count_and(wanted.core);
    tracing::debug!(before, in_vain, after, "crumbs");
    Ok(if enough(before, after) { press.printing } else { printing })
}

/// Every so manieth voxel, the first one first.
fn every(step: usize, all: &BitGrid) -> BitGrid {
    let mut some = BitGrid::new(all.dims());
    all.iter_ones().step_by(step).for_each(|v| some.set(v, true));
    some
}

/// Whether crumbs are printed for the sake of leaving nothing.
pub fn leaves_none(_before: usize, after: usize) -> bool {
    after == 0
}

/// The same, but first what is to be printed ahead of all else, then all that goes along one
/// direction, with supports where nothing carries it.
pub fn print_on_supports(
    setting: &Setting,
    coarse: &Coarse,
    wanted: &Wanted,
    on: OnSupports,
    ctx: &Ctx,
) -> Result<Printing, Cancelled> {
    let Some(mut press) = Press::new(setting, coarse, wanted) else {
        return Ok(wanted.unprinted());
    };
    // What is printed ahead is no use where it closes the way straight down to more than was missing.
    press.shown = (on.direction == Direction::Z).then(|| wanted.added.minus(on.ahead));
    press.print_ahead(on.ahead, ctx)?;
    press.shown = None;
    if let Some(way) = press.way_along(on.direction) {
        let fixed = press.fixed();
        let left = press.printing.unreached.clone();
        let block = lay_on_supports(&press.fine(&left, &fixed), way, &on);
        if block.gain >= press.least {
            press.print_with_roofs(block, &on, ctx)?;
        }
    }
    press.print_among(wanted.added, ctx)?;
    Ok(press.printing)
}

/// Blocks that were made before once more, each along its own way, with what it can lay of what is
/// `around` it besides; they have to be among what is wanted.
pub fn print_again(
    setting: &Setting,
    coarse: &Coarse,
    wanted: &Wanted,
    blocks: &[Step],
    around: impl Fn(&Step) -> BitGrid,
    ctx: &Ctx,
) -> Result<Printing, Cancelled> {
    let Some(mut press) = Press::new(setting, coarse, wanted) else {
        return Ok(wanted.unprinted());
    };
    for step in blocks {
        ctx.check()?;
        let Some(tool) = setting.nozzles().iter().find(|t| t.name == step.tool) else {
            continue;
        };
        let way = Way { direction: step.direction, holding: step.holding, tool };
        let fixed = press.fixed();
        let left = step.region.or(&around(step)).and(&press.printing.unreached);
        let block = press.fine(&left, &fixed).lay(way);
        if !block.region.is_empty() {
            press.put(block, fixed);
        }
    }
    Ok(press.printing)
}

/// First what is to be printed ahead of all else, what few ways lay before what many do; then blocks in an order that
/// is given, each with what those before it left of theirs; then what is left.
pub fn print_in_order(
    setting: &Setting,
    coarse: &Coarse,
    wanted: &Wanted,
    (ahead, order): (&BitGrid, &[(Way, BitGrid)]),
    ctx: &Ctx,
) -> Result<Printing, Cancelled> {
    let Some(mut press) = Press::new(setting, coarse, wanted) else {
        return Ok(wanted.unprinted());
    };
    press.print_scarcest(ahead, ctx)?;
    let mut due = ahead.clone();
    for (way, region) in order {
        ctx.check()?;
        due.union_with(region);
        press.print_one(way, &due);
        press.print_scarcest(&due, ctx)?;
    }
    press.print_among(wanted.added, ctx)?;
    Ok(press.printing)
}

/// Some of what is wanted along few ways, whatever their blocks' sizes, the largest first.
pub fn print_closely<'a>(
    setting: &Setting<'a>,
    coarse: &Coarse,
    wanted: &Wanted,
    (some, ways): (&BitGrid, &[Way<'a>]),
    ctx: &Ctx,
) -> Result<Printing, Cancelled> {
    let Some(mut press) = Press::new(setting, coarse, wanted) else {
        return Ok(wanted.unprinted());
    };
    press.closely = true;
    loop {
        let left = press.printing.unreached.and(some);
        let fixed = press.fixed();
        match press.fine(&left, &fixed).best(ways, ctx)? {
            Some(block) => press.put(block, fixed),
            None => return Ok(press.printing),
        }
    }
}

/// After what is printed, blocks just as they are given.
pub fn print_each(
    setting: &Setting,
    coarse: &Coarse,
    wanted: &Wanted,
    (before, blocks): (&Printing, &[(Way, BitGrid)]),
    ctx: &Ctx,
) -> Result<Printing, Cancelled> {
    let Some(mut press) = Press::new(setting, coarse, wanted) else {
        return Ok(wanted.unprinted());
    };
    (press.printing, press.closely) = (before.clone(), true);
    for (way, region) in blocks {
        ctx.check()?;
        press.print_one(way, region);
    }
    Ok(press.printing)
}

/// Which supports may be printed.
#[derive(Clone, Copy)]
pub struct OnSupports<'o> {
    /// Along which they, and what stands on them, are printed.
    pub direction: Direction,
    /// Where none may be.
    pub avoided: &'o BitGrid,
    /// Where they go straight down, no wider than a voxel.
    pub slim: &'o BitGrid,
    /// What is printed before them.
    pub ahead: &'o BitGrid,
}

impl Wanted<'_> {
    fn unprinted(&self) -> Printing {
        Printing::before_any(self.state.clone(), self.added.clone())
    }
}

struct Press<'s, 'a> {
    setting: &'s Setting<'a>,
    coarse: &'s Coarse,
    wanted: &'s Wanted<'s>,
    /// The core on the coarse grid.
    core: BitGrid,
    preferred: Vec<Way<'a>>,
    sampled: Vec<Way<'a>>,
    shorter: &'a [Tool],
    /// Voxels of the core that a block lays at least.
    least: usize,
    printing: Printing,
    /// See [`Layer::closely`].
    closely: bool,
    /// What blocks leave open from straight above, if they lose no more by that; where there is none, they may hide all.
    shown: Option<BitGrid>,
}

impl<'s, 'a> Press<'s, 'a> {
    /// None without a nozzle. Shorter nozzles reach less: they are asked once the direction is
    /// known.
    fn new(setting: &'s Setting<'a>, coarse: &'s Coarse, wanted: &'s Wanted<'s>) -> Option<Self> {
        let (longest, shorter) = setting.nozzles().split_last()?;
        let sampled: Vec<Direction> =
            (0..setting.holdings.len()).flat_map(|h| setting.sampled(h, wanted.samples)).collect();
        let core = coarse.most(wanted.core);
        let share = LEAST_SHARE * wanted.core.count() as f64;
        Some(Press {
            setting,
            coarse,
            wanted,
            core,
            preferred: ways_along(setting, wanted.preferred, longest),
            sampled: ways_along(setting, &sampled, longest),
            shorter,
            least: share.max(LEAST_MM3 / setting.job.frame.voxel_volume()).ceil() as usize,
            printing: wanted.unprinted(),
            closely: false,
            shown: None,
        })
    }
}
impl<'a> Press<'_, 'a> {
    /// Blocks among some of what is wanted, until none of them lays enough.
    fn print_among(&mut self, some: &BitGrid, ctx: &Ctx) -> Result<(), Cancelled> {
        loop {
            let left = self.printing.unreached.and(some);
            let left_over = left.count_and(self.wanted.core);
            if left_over < self.least {
                return Ok(());
            }
            let fixed = self.fixed();
            let mut best = self.best(&self.preferred, &left, &fixed, ctx)?;
            if best.as_ref().is_none_or(|b| (b.gain as f64) < ENOUGH_SHARE * left_over as f64) {
                let other = self.best(&self.sampled, &left, &fixed, ctx)?;
                let gain = best.as_ref().map_or(0, |b| b.gain);
                best = other.filter(|o| o.gain > gain).or(best);
            }
            if best.as_ref().is_none_or(|b| b.gain < self.least) {
                // Too small or too tight for the coarse grid.
                let all: Vec<Way> = self.preferred.iter().chain(&self.sampled).copied().collect();
                let fine = self.fine(&left, &fixed);
                best = fine.best(&fine.clearest(&all, self.least, ctx)?, ctx)?;
            }
            let Some(block) = best.filter(|b| b.gain >= self.least) else { return Ok(()) };
            let allowed = self.allowed();
            if self.wanted.patience.is_lost(left_over, allowed, block.gain) {
                self.printing.was_given_up = true;
                return Ok(());
            }
            let fine = self.fine(&left, &fixed);
            let mut block = fine.with_shorter(block, self.shorter);
            if let Some(shown) = &self.shown {
                let hidden = hidden_by(&block, shown);
                let showing = hiding_nothing(&fine, &block, shown);
                if block.gain < showing.gain + AROUND_MISSING * hidden {
                    block = showing;
                }
                if block.gain < self.least {
                    return Ok(());
                }
            }
            self.take(block, left, fixed);
        }
    }

    /// Voxels that the rules allow to be off.
    fn allowed(&self) -> f64 {
        let job = self.setting.job;
        job.rules.deviation * job.target.count() as f64
    }

    /// Small blocks among what is to be printed before all else.
    fn print_ahead(&mut self, ahead: &BitGrid, ctx: &Ctx) -> Result<(), Cancelled> {
        let least = (LEAST_AHEAD_MM3 / self.setting.job.frame.voxel_volume()).ceil() as usize;
        let usual = std::mem::replace(&mut self.least, least);
        self.print_among(&self.wanted.added.and(ahead), ctx)?;
        self.least = usual;
        Ok(())
    }

    /// Small blocks among some of what is wanted: that one first which lays most of what few ways lay, as long as that is
    /// asked of no more voxels than [`MOST_SCARCE`].
    fn print_scarcest(&mut self, some: &BitGrid, ctx: &Ctx) -> Result<(), Cancelled> {
        let least = (LEAST_AHEAD_MM3 / self.setting.job.frame.voxel_volume()).ceil() as usize;
        let ways: Vec<Way<'a>> = self.preferred.iter().chain(&self.sampled).copied().collect();
        loop {
            let left = self.printing.unreached.and(some);
            let left_over = left.count_and(self.wanted.core);
            if left_over > MOST_SCARCE {
                return self.print_ahead(some, ctx);
            }
            if left_over < least {
                return Ok(());
            }
            let fixed = self.fixed();
            let fine = self.fine(&left, &fixed);
            let Some(block) = fine.scarcest(&ways, least, ctx)? else { return Ok(()) };
            self.take(block, left, fixed);
        }
    }

    /// Blocks of any size among some of what is wanted.
    fn print_small(
        &mut self,
        some: &BitGrid,
        ways: &[Way<'a>],
        ctx: &Ctx,
    ) -> Result<(), Cancelled> {
        loop {
            let left = self.printing.unreached.and(some);
            let fixed = self.fixed();
            let fine = self.fine(&left, &fixed);
            let Some(block) = fine.best(&fine.clearest(ways, 1, ctx)?, ctx)? else { return Ok(()) };
            let block = fine.with_shorter(block, self.shorter);
            self.take(block, left, fixed);
        }
    }

    /// What one way lays of some of what is wanted, if any of that counts; with the setting's own nozzle of that name.
    fn print_one(&mut self, way: &Way, some: &BitGrid) {
        let Some(tool) = self.setting.nozzles().iter().find(|t| t.name == way.tool.name) else {
            return;
        };
        let fixed = self.fixed();
        let left = some.and(&self.printing.unreached);
        let block = self.fine(&left, &fixed).lay(Way { tool, ..*way });
        if block.gain > 0 {
            self.put(block, fixed);
        }
    }

    fn print_shares(&mut self, shares: &[Share], ctx: &Ctx) -> Result<(), Cancelled> {
        let mut others = self.wanted.added.clone();
        shares.iter().for_each(|s| others.subtract(&s.region));
        self.print_among(&others, ctx)?;
        for (i, share) in shares.iter().enumerate() {
            let mut own = share.region.clone();
            shares[i + 1..].iter().for_each(|later| own.subtract(&later.region));
            self.print_share(share.direction, &own, ctx)?;
        }
        Ok(())
    }

    /// The first of the ways along a direction.
    fn way_along(&self, direction: Direction) -> Option<Way<'a>> {
        let ways = self.preferred.iter().chain(&self.sampled);
        ways.copied().find(|w| w.direction == direction)
    }

    fn print_share(
        &mut self,
        direction: Direction,
        share: &BitGrid,
        ctx: &Ctx,
    ) -> Result<(), Cancelled> {
        let left = share.and(&self.printing.unreached);
        let fixed = self.fixed();
        let own: Vec<Way<'a>> = self.way_along(direction).into_iter().collect();
        if let Some(block) = self.fine(&left, &fixed).best(&own, ctx)? {
            let block = self.fine(&left, &fixed).with_shorter(block, self.shorter);
            self.take(block, left, fixed);
        }
        Ok(())
    }

    /// The way that lays most of `left`: ranked on the coarse grid, the best laid on the job's.
    fn best(
        &self,
        ways: &[Way<'a>],
        left: &BitGrid,
        fixed: &[Vec<DVec3>],
        ctx: &Ctx,
    ) -> Result<Option<Block<'a>>, Cancelled> {
        let state = self.coarse.most(&self.printing.state);
        let left_there = self.coarse.most(&self.printing.state.or(left)).minus(&state);
        let quick = Layer {
            job: &self.coarse.job,
            state: &state,
            left: &left_there,
            core: &self.core,
            fixed,
            closely: false,
        };
        let ranked = quick.ranked(ways, ctx)?;
        let some: Vec<Way<'a>> = ranked.into_iter().take(FINALISTS).map(|i| ways[i]).collect();
        self.fine(left, fixed).best(&some, ctx)
    }

    fn fine<'l>(&'l self, left: &'l BitGrid, fixed: &'l [Vec<DVec3>]) -> Layer<'l> {
        Layer {
            job: self.setting.job,
            state: &self.printing.state,
            left,
            core: self.wanted.core,
            fixed,
            closely: self.closely,
        }
    }

    /// Fixed points of every holding, were it to begin or go on now.
    fn fixed(&self) -> Vec<Vec<DVec3>> {
        (0..self.setting.holdings.len())
            .map(|h| match &self.printing.held {
                Some((now, fixed)) if *now == h => fixed.clone(),
                _ => self.setting.fixed(h, &self.printing.state),
            })
            .collect()
    }

    /// What would have been left free for a block: of the bodies that it lays any of, all that
    /// lies over the lowest of them along its direction.
    fn share(&self, block: &Block, left: &BitGrid) -> Share {
        let frame = &self.setting.job.frame;
        let direction = block.way.direction;
        let core = left.and(self.wanted.core);
        let near = flood(&core, &block.region, Connectivity::Corner26);
        let heights = near.iter_ones().map(|v| direction.dot(frame.center(v)));
        let lowest = heights.fold(f64::INFINITY, f64::min) - frame.pitch / 2.0;
        let over = above(self.wanted.added, frame, direction.vec(), lowest);
        Share { direction, region: flood(&over, &near, Connectivity::Corner26) }
    }

    /// Lays a block, and what it would have had of what was left is kept as a share.
    fn take(&mut self, block: Block, left: BitGrid, fixed: Vec<Vec<DVec3>>) {
        let share = self.share(&block, &left);
        self.printing.shares.push(share);
        self.put(block, fixed);
    }

    /// Lays a block.
    fn put(&mut self, block: Block, fixed: Vec<Vec<DVec3>>) {
        let holding = block.way.holding;
        let printing = &mut self.printing;
        printing.held = Some((holding, fixed.into_iter().nth(holding).unwrap_or_default()));
        printing.state.union_with(&block.region);
        printing.unreached.subtract(&block.region);
        tracing::debug!(
            direction = ?block.way.direction,
            tool = block.way.tool.name,
            gain = block.gain,
            left = printing.unreached.count_and(self.wanted.core),
            "print"
        );
        let number = printing.steps.len();
        printing.steps.push(deposit(block, number, &self.setting.job.frame));
    }
}

/// The step that lays a block.
fn deposit(block: Block, number: usize, frame: &Frame) -> Step {
    let Way { direction, holding, tool } = block.way;
    let heights = block.region.iter_ones().map(|v| direction.dot(frame.center(v)));
    let lowest = heights.fold(f64::INFINITY, f64::min);
    let plane = Plane { normal: direction, offset: lowest - frame.pitch / 2.0 };
    Step {
        kind: StepKind::Additive,
        tool: tool.name.clone(),
        direction,
        holding,
        region: block.region,
        block: number,
        origin: Origin { plane: Some(plane), action: None },
    }
}

#[cfg(test)]
mod tests {
    use super::super::local_tests::job_of;
    use super::super::setting::Setting;
    use super::*;
    use crate::machine::Taken;

    /// A block that grows on all sides but below: tilted blocks lay more at first and leave more.
    #[test]
    fn along_the_axes_a_shell_leaves_less() {
        let frame = Frame { pitch: 0.6, dims: [62, 46, 42], origin: DVec3::ZERO };
        let inner = |[x, y, z]: [usize; 3]| (6..56).contains(&x) && (6..40).contains(&y) && z < 34;
        let outer = |[x, y, z]: [usize; 3]| (3..59).contains(&x) && (3..43).contains(&y) && z < 37;
        let [initial, target] =
            [BitGrid::from_fn(frame.dims, inner), BitGrid::from_fn(frame.dims, outer)];
        let job = job_of(frame, initial, target, |t| t.taken == Taken::Always);
        let (setting, coarse) = (Setting::new(&job), Coarse::of(&job));
        let added = job.target.minus(&job.initial);
        let wanted = Wanted {
            state: &job.initial,
            added: &added,
            core: &added,
            preferred: &[],
            samples: 100,
            patience: Patience::Endless,
        };
        let ctx = Ctx::quiet();
        let greedy = print_blocks(&setting, &coarse, &wanted, &[], &ctx).unwrap();
        let axes = print_along_axes(&setting, &coarse, &wanted, &ctx).unwrap();
        let left = |p: &Printing| p.unreached.count();
        assert!(4 * left(&axes) < 3 * left(&greedy), "{} of {}", left(&axes), left(&greedy));
        assert!(axes.steps.len() <= greedy.steps.len() + 2, "{}", axes.steps.len());
    }

    #[test]
    fn patience_is_lost_where_many_such_blocks_would_not_do() {
        let is_lost = |p: Patience, left, gain| p.is_lost(left, 100.0, gain);
        assert!(!is_lost(Patience::Endless, 1_000_000, 1));
        // Fifty like it bring it down to what the known plan leaves, or just not.
        assert!(!is_lost(Patience::UpTo(1000), 6000, 100));
        assert!(is_lost(Patience::UpTo(1000), 6001, 100));
        assert!(!is_lost(Patience::UpTo(usize::MAX), 6001, 100));
        assert!(is_lost(Patience::AtAGlance, 1001, 100));
        assert!(!is_lost(Patience::AtAGlance, 1000, 100));
        // What the rules allow may be left.
        assert!(!is_lost(Patience::AtAGlance, 100, 1));
    }
}
