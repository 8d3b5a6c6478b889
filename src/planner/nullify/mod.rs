//! INV: any stable voxel model, made exactly, by nullification (Chen, Liu, Huang, Wang, Zhang,
//! Qian, Shi, Wang: Inverse operation based planning for hybrid additive–subtractive
//! manufacturing, ACM TOG 2025).
//!
//! | symbol | meaning | here |
//! |---|---|---|
//! | M | state | `workpiece` |
//! | 𝒩(v) | face and edge neighbours | `Workpiece::neighbours` |
//! | 𝒯_A, 𝒯_S | occupancy of nozzle and cutter | `Workpiece::ways` |
//! | L | cutter length in voxels | [`Options::length`] |
//! | K | the top layer | `Workpiece::top` |
//! | M (Sec. 5.2) | minimum feature | [`Options::minimum_feature`] |
//!
//! Stages: from the finished model backward, layer by layer from the top (`layer`); supports as
//! trees (`forest`), ledges (`ledge`) and ways (`detour`); a non-empty beginning
//! (`initial`, `hinges`); what turned out needless left out (`prune`), deposits and cuts gathered (`order`),
//! cuts sorted by orientation (`turns`);
//! operations into steps (`patches`).
//!
//! What differs from the paper: stability is exact for the whole model (`bottleneck`) instead of
//! within a window Δ; a layer is eroded as far as it goes before supports are grown, since erosion
//! opens the way for the cutter; supports are trees chosen by what they cover instead of rings.
//!
//! Guarantees: a stable model with L ≥ 2 is planned exactly (INV Sec. 3.3), within its own box.
//! Same input and seed, same operations. Not guaranteed: that supports are fewest.

mod bottleneck;
mod detour;
mod forest;
mod hinges;
mod initial;
mod layer;
mod ledge;
#[cfg(test)]
mod naive_tests;
mod order;
mod patches;
mod prune;
mod turns;
mod workpiece;
#[cfg(test)]
mod world_tests;

use super::PlanError;
use crate::base::Ctx;
use crate::plan::{Deed, Job, Operation, Plan};
use crate::voxel::BitGrid;
use layer::{Nullifier, Stuck, Undoing};
use workpiece::{Cell, Ways, Workpiece};

/// Largest extent along an axis; a voxel's height and grid index are 16-bit numbers.
const LONGEST: usize = 65_000;
/// Cells of the largest padded grid, which are counted in 31 bits.
const MOST_CELLS: usize = i32::MAX as usize;

/// Why a model cannot be nullified.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NullifyError {
    #[error("the target is empty: it has no voxel; set a finer --resolution or check the file")]
    Empty,
    #[error(
        "the target is not stable: {loose} of its {solid} voxels are not connected to the base \
         layer, the first at voxel {first:?}; remove them, or stand the part on them"
    )]
    Unstable { loose: usize, solid: usize, first: [usize; 3] },
    #[error(
        "a cutter of L = {length} voxels cannot undercut anything; nullification needs L ≥ 2, set \
         a longer --tool-length"
    )]
    ShortTool { length: u32 },
    #[error("a box of {dims:?} voxels is too large for this planner; set a coarser --resolution")]
    TooLarge { dims: [usize; 3] },
    #[error("{voxels} voxels of the target lie below the base plane; raise it in its file")]
    BelowBase { voxels: usize },
    #[error(
        "the plan has {steps} steps on a grid of {dims:?} voxels, more than a plan file holds; set \
         a coarser --resolution"
    )]
    TooManySteps { steps: usize, dims: [usize; 3] },
    #[error(
        "the initial part is not stable: {loose} of its voxels are not connected to the base layer, \
         the first at voxel {first:?}; remove them, or stand the part on them"
    )]
    InitialUnstable { loose: usize, first: [usize; 3] },
    #[error(
        "the initial part is locked: {left} voxels of it cannot be cut away, whatever is kept; with \
         L = {length} the cutter reaches {reached} of them, and each of these holds others up. Set \
         a longer --tool-length, or take the part off and plan the target alone"
    )]
    Locked { left: usize, reached: usize, length: u32 },
    #[error(
        "layer {layer} could not be undone, {left} of its voxels are left: a defect of the \
         planner, since every stable model can be made; please report the input"
    )]
    Stuck { layer: i32, left: usize },
}

/// What a plan should have little of: by this the tries within a time limit are ranked. A single
/// try is the same for all three.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Objective {
    #[default]
    Supports,
    /// Changes between deposits and cuts.
    Switches,
    Operations,
}

/// How to nullify.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// L: voxels of the cutter below its half-space, at least 2.
    pub length: u32,
    /// M: patches of fewer voxels are eroded only when nothing else helps. INV takes 10; 1 saves an
    /// eighth of the supports on large models, and gathering joins patches afterwards.
    pub minimum_feature: usize,
    /// Whether supports that the finished model leaves room for are grown first (Sec. 4.2). They
    /// are cut last, so there are fewer tool changes; later they might have been fewer.
    pub support_ahead: bool,
    pub objective: Objective,
    /// Order of equal choices.
    pub seed: u64,
}

impl Default for Options {
    fn default() -> Options {
        Options {
            length: 10,
            minimum_feature: 1,
            support_ahead: false,
            objective: Objective::Supports,
            seed: 0,
        }
    }
}

/// A planned sequence and its figures.
#[derive(Clone, Debug, PartialEq)]
pub struct Sequence {
    /// Corner of the planning box in the job's grid, and its dimensions.
    pub corner: [usize; 3],
    pub dims: [usize; 3],
    /// In the order of fabrication; voxels count from the corner.
    pub operations: Vec<Operation>,
    /// Voxels that are deposited and cut again.
    pub supports: usize,
    pub switches: usize,
    /// Old material that is kept.
    pub reused: usize,
    /// Sequences tried with other seeds.
    pub tries: usize,
}

/// Operations that make `target` from nothing, in the order of fabrication.
///
/// # Errors
/// [`NullifyError`]: a model that is empty or not stable, or L < 2; or cancelled.
pub fn operations(
    target: &BitGrid,
    options: &Options,
    ctx: &Ctx,
) -> Result<Vec<Operation>, PlanError> {
    check(target, options)?;
    let deeds = match nullified(target, None, options, ctx)? {
        Ok(deeds) => deeds,
        Err(Stuck { layer, left }) => return Err(NullifyError::Stuck { layer, left }.into()),
    };
    Ok(deeds)
}

fn check(target: &BitGrid, options: &Options) -> Result<(), NullifyError> {
    if options.length < 2 {
        return Err(NullifyError::ShortTool { length: options.length });
    }
    if target.is_empty() {
        return Err(NullifyError::Empty);
    }
    let dims = target.dims();
    let cells = dims.iter().try_fold(1usize, |n, d| n.checked_mul(d + 2));
    if dims.iter().any(|d| *d > LONGEST) || cells.is_none_or(|n| n > MOST_CELLS) {
        return Err(NullifyError::TooLarge { dims });
    }
    Ok(())
}

/// What is kept of an initial part: nothing above layer `floor`, everything below it.
struct Kept<'a> {
    floor: usize,
    solid: &'a BitGrid,
}

/// Nullifies `target` down to what is kept; the operations in the order of fabrication.
fn nullified(
    target: &BitGrid,
    kept: Option<&Kept>,
    options: &Options,
    ctx: &Ctx,
) -> Result<Result<Vec<Operation>, Stuck>, PlanError> {
    let w = Workpiece::new(target, options.length);
    let top = w.top;
    let mut n = Nullifier::new(w, options.minimum_feature, options.seed);
    let cell = |v: [usize; 3], n: &Nullifier| n.w.cell(v.map(|c| c as i32));
    let loose: Vec<[usize; 3]> =
        target.iter_ones().filter(|v| !n.b.is_connected(cell(*v, &n))).collect();
    if let Some(&first) = loose.first() {
        let (loose, solid) = (loose.len(), target.count());
        return Err(NullifyError::Unstable { loose, solid, first }.into());
    }
    n.w.floor = kept.map_or(0, |k| k.floor as i32);
    let bare = n.b.clone();
    if options.support_ahead {
        n.support_ahead();
    }
    ctx.begin("nullify", top as u64 + 1);
    for z in (n.w.floor..=top).rev() {
        ctx.check()?;
        let stripped = match kept {
            Some(kept) if z == n.w.floor => {
                let keep: Vec<Cell> = kept.solid.iter_ones().map(|v| cell(v, &n)).collect();
                n.strip_to(z, |c| keep.binary_search(&c).is_ok())
            }
            _ => n.strip(z),
        };
        if let Err(stuck) = stripped {
            return Ok(Err(stuck));
        }
        ctx.advance(1);
    }
    ctx.end();
    let deeds = prune::pruned(&n.w, &bare, &n.deeds);
    let floor = n.w.floor;
    drop((n, bare));
    let mut w = Workpiece::new(target, options.length);
    w.floor = floor;
    let deeds = order::gathered(&mut w, &deeds);
    Ok(Ok(forward(&w, &deeds)))
}

/// The operations in the order of fabrication, cuts in as few turns of the cutter as possible.
fn forward(w: &Workpiece, deeds: &[(Cell, Undoing)]) -> Vec<Operation> {
    let mut operations: Vec<Operation> = Vec::with_capacity(deeds.len());
    // Cuts since the last turn, and the orientations that serve all of them.
    let (mut run, mut common) = (0, Ways::ALL);
    let turn = |operations: &mut Vec<Operation>, run: usize, common: Ways| {
        let Some(way) = common.any() else { return };
        let from = operations.len() - run;
        operations[from..].iter_mut().for_each(|op| op.deed = Deed::Cut(way));
    };
    for (cell, undoing) in deeds.iter().rev() {
        let voxel = w.voxel(*cell).map(|c| c as u16);
        match undoing {
            Undoing::Eroded => {
                turn(&mut operations, run, common);
                (run, common) = (0, Ways::ALL);
                operations.push(Operation { voxel, deed: Deed::Add });
            }
            Undoing::Accreted(ways) => {
                if common.and(*ways).is_empty() {
                    turn(&mut operations, run, common);
                    (run, common) = (0, Ways::ALL);
                }
                common = common.and(*ways);
                run += 1;
                operations.push(Operation { voxel, deed: Deed::CutAnyhow });
            }
        }
    }
    turn(&mut operations, run, common);
    operations
}

/// Plans a job: the largest reusable part of its initial solid is freed, then built upon.
///
/// # Errors
/// As [`operations`].
pub fn plan(job: &Job, options: &Options, ctx: &Ctx) -> Result<(Plan, Sequence), PlanError> {
    let mut best = initial::sequence(job, options, ctx)?;
    // Without a time limit one try is the answer; with one, other orders of equal choices follow.
    let mut tries = 1;
    while ctx.is_limited() && !ctx.out_of_time() {
        let seed = options.seed.wrapping_add(tries as u64);
        let other = initial::sequence(job, &Options { seed, ..options.clone() }, ctx)?;
        tries += 1;
        if figure(&other, options.objective) < figure(&best, options.objective) {
            best = other;
        }
    }
    best.tries = tries;
    let plan = patches::steps(job, &best)?;
    Ok((plan, best))
}

/// What is to be small, most important first.
fn figure(s: &Sequence, objective: Objective) -> (usize, usize) {
    match objective {
        Objective::Supports => (s.supports, s.switches),
        Objective::Switches => (s.switches, s.supports),
        Objective::Operations => (s.operations.len(), s.switches),
    }
}
