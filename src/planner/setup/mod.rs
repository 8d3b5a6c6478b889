//! The setup search: where the target part M* is put in the initial part M, which stays as it is
//! clamped (W2V Sec. 5, App. D) unless its pose is searched as well ([`search_poses`]).
//!
//! | symbol | here | meaning |
//! |---|---|---|
//! | Ṽ_R | `kept` | M ∩ M*, less the pieces that nothing would hold, or the tip of one |
//! | T | [`Candidate::score_coarse`] | faces of M* with n · d_v ≥ −sin 50°, d_v = +z |
//! | B | `interface` | what of Ṽ_R's surface material is added on: the initial printing bases |
//! | Min_B, Max_V | `lowest_mm`, `top_mm` | lowest point of B, highest of Ṽ_R, over the base plane |
//!
//! Method. *Coarse*: each rotation is put on z = 0 with the centroid of its contact (everything
//! within the grip height) over that of M, and scored by
//! Score₁ = 0.4 Vol(Ṽ_R) + 0.6 Area(T) (Eq. 6). *Fine*: the five best are shifted by −2..2 tenths
//! of their extent along x and y and scored by
//! Score₂ = 0.4 Vol(Ṽ_R) + 0.6 (Min_B / Max_V + (1 − Area(B) / Area(M*))²) (Eq. 7).
//! Volumes and areas are those of M* = 1, so every term lies in 0..1 and Score₂ in 0..1.6. Where
//! nothing has to be printed on Ṽ_R, B is empty and both terms of the bases are 1; where nothing
//! of Ṽ_R is held, both scores' volume is 0 and Score₂ is 0 as a whole.
//!
//! What differs from the paper, and why:
//! - Its 100 directions leave the turn about each open; here 100 rotations are spread over all
//!   rotations. Beside them stand the rotation of the file and up to eight flat faces the target
//!   can rest on, each at twelve headings, with contacts, boxes or centroids over each other, of
//!   which the best is ranked; five of these are carried beside the five of the spread. A spread
//!   of 100 has gaps of 40°, parts stand on faces, a bracket lies in its block with box over box,
//!   and Score₁ alone prefers any part on tiptoe, where every face carries itself.
//! - The pose of the files, lowered or raised onto the base, always takes part in the fine stage:
//!   files often come aligned. It is left only for a score that is better by more than noise.
//! - The best placement of each carried rotation is shifted and turned about z by ever halved
//!   steps while Score₂ gains, the winner (and as many more as are asked for) on a finer grid: a
//!   tenth of the extent is coarser than any tool.
//! - Placements that reuse far less than the best found do not compete, whatever their Score₂.
//! - Min_B leaves out a speck of the interface, which would decide it by the grid alone.
//!
//! Guarantees: the same answer at any thread count; the target's lowest point is on z = 0, to a
//! micrometre; of equal poses that of the files wins. Not guaranteed: the best of all poses, or that the plan
//! reuses what the pose allows. A mesh whose triangles face at random has no Area(T) to speak of.
//! Millimetres and radians; the target stands in the pose of its file when it comes in.

mod measure;
mod pose;
mod rotations;
mod stance;
#[cfg(test)]
mod tests;

use crate::base::{Aabb, Cancelled, Ctx, DAffine3, DMat3, DVec2};
use crate::machine::HoldingMode;
use crate::mesh::TriMesh;
use crate::planner::PlanError;
use measure::{Measured, Pair, Sampling};
pub use pose::{PosedSetup, search_poses};
use rayon::prelude::*;
use stance::Stance;
use std::ops::Range;

/// What both scores look at; the weights of the volume and of the printing bases (W2V App. D, and
/// Fig. 17 for one of them alone).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Score {
    #[default]
    Both,
    Volume,
    Base,
}

impl Score {
    fn weights(self) -> (f64, f64) {
        match self {
            Score::Both => (0.4, 0.6),
            Score::Volume => (1.0, 0.0),
            Score::Base => (0.0, 1.0),
        }
    }
}

/// Faces to rest on that are tried beside the spread.
const RESTING: usize = 8;

/// Headings at which a face to rest on is tried: 30° steps, so that quarter turns are among them
/// and the refinement's first turn of 15° closes the gaps.
const HEADINGS: usize = 12;

/// Shifts of the fine stage, in tenths of the extent along an axis; none first, so that it wins
/// among equals.
const TENTHS: [f64; 5] = [0.0, -1.0, 1.0, -2.0, 2.0];

/// A placement competes with this share of the largest Ṽ_R found, or more. Ṽ_R bounds what a plan
/// can reuse, and ten of the twelve parts in W2V Table 1 keep 0.7 of it; Score₂ alone would give up
/// 0.96 for 0.05 of a target on tiptoe, whose bases are small and high. Near 1, the bases would no
/// longer have a say.
const LEAST_SHARE: f64 = 0.7;

/// Halvings of the refinement's steps, which begin at half a fine shift and half a heading: those
/// of every carried rotation on the coarse grid, and those of the winner on the fine one, down to
/// below a thousandth of the extent and a quarter of a degree.
const NUDGES: Range<i32> = 0..4;
const REFINEMENTS: Range<i32> = 2..7;

/// Most moves at one step, which bounds the time where the score climbs slowly.
const MOST_MOVES: usize = 4;

/// What Score₂ must gain for the pose of the files to be left. Files that come aligned are so to a
/// micrometre, the search only to its grid: without this, a part would be skimmed all over for a
/// tenth of a millimetre. Much more would keep poses that are worth leaving.
const FILE_POSE_WORTH: f64 = 0.01;

/// A part that stands this close to the base in its file stands on it, mm: files round their
/// coordinates, no machine is set up finer, and moved by that much it would only come to lie otherwise
/// on the grid.
const ROUNDING_MM: f64 = 1e-3;

/// What Score₂ must gain for a move. Below, the staircase of the grid moves an aligned part; far
/// above, half a per cent of the extent stays unrefined.
const LEAST_GAIN: f64 = 1e-3;

#[derive(Clone, Debug, PartialEq)]
pub struct SetupOptions {
    /// Rotations of the spread (W2V: 100).
    pub rotations: usize,
    /// Best rotations of the spread that are shifted (W2V: 5), and of the faces to rest on.
    pub carried: usize,
    /// Height over the base plane up to which the part counts as held, mm; never less than the
    /// search's own grid can see.
    pub grip_mm: f64,
    pub holding: HoldingMode,
    pub score: Score,
    /// Placements that are refined, the best first: each may then be planned.
    pub refined: usize,
}

impl Default for SetupOptions {
    fn default() -> Self {
        SetupOptions {
            rotations: 100,
            carried: 5,
            grip_mm: 2.0,
            holding: HoldingMode::Base,
            score: Score::Both,
            refined: 1,
        }
    }
}

/// A placement of the target and what it scores.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// From the standing target to its place.
    pub transform: DAffine3,
    /// From the centroid of the initial part's contact to that of the target's, mm.
    pub shift: DVec2,
    /// Score₁ of the rotation, before it was shifted.
    pub score_coarse: f64,
    pub score_fine: f64,
    /// Volume of Ṽ_R by the target's.
    pub reused_share: f64,
}

#[derive(Clone, Debug, PartialEq)]
pub struct SetupReport {
    pub winner: Candidate,
    /// The pose of the files and the next best, these refined as the winner is, as many as were asked
    /// for: no two the same.
    pub others: Vec<Candidate>,
    /// The carried rotations and the pose of the files, each at its best place on the coarse grid,
    /// best first; those that reuse too little to compete come last.
    pub best: Vec<Candidate>,
    /// Placements measured.
    pub tried: usize,
}

/// Placements are one and the same when no point of a part as large as its shift differs by more
/// than these, mm and radians: below what a person could set up.
const SAME_MM: f64 = 0.1;
const SAME_TURN: f64 = 2e-3;

impl Candidate {
    fn is_same(&self, other: &Candidate) -> bool {
        let (a, b) = (&self.transform, &other.transform);
        let (_, degrees) = rotations::axis_angle(&(a.matrix3.transpose() * b.matrix3));
        a.translation.distance(b.translation) < SAME_MM && degrees.to_radians() < SAME_TURN
    }
}

impl SetupReport {
    /// One sentence on one of the placements, for people.
    pub fn note(&self, w: &Candidate) -> String {
        if w.reused_share == 0.0 {
            return format!(
                "Setup: in none of {} poses is any of the initial part reused; the target keeps \
                 the pose of its file.",
                self.tried
            );
        }
        let (axis, degrees) = rotations::axis_angle(&w.transform.matrix3);
        let rotation = match degrees {
            0.0 => "as in its file".to_string(),
            _ => format!("{degrees:.1}° about ({:.2}, {:.2}, {:.2})", axis.x, axis.y, axis.z),
        };
        let t = w.transform.translation;
        format!(
            "Setup: target's rotation {rotation}, shift ({:.2}, {:.2}, {:.2}) mm, {:.1} % of it \
             inside the initial part; Score1 {:.3}, Score2 {:.3}; {} poses tried.",
            t.x,
            t.y,
            t.z,
            100.0 * w.reused_share,
            w.score_coarse,
            w.score_fine,
            self.tried
        )
    }
}

/// Both parts: the initial one clamped on z = 0, the target in the pose of its file.
struct Problem<'a> {
    initial: &'a TriMesh,
    target: &'a TriMesh,
}

/// A placement on its way through the stages.
#[derive(Clone, Copy)]
struct Trial {
    stance: Stance,
    /// Where the centroid of its contact is put, mm.
    at: DVec2,
    score_coarse: f64,
    score_fine: f64,
    share: f64,
    /// Still the pose of the files.
    is_file_pose: bool,
}

/// Finds the target's place in the initial part, which stands on z = 0 as it is clamped.
///
/// # Errors
/// [`PlanError::Unmeasurable`] for a part without a voxel on the search's grid,
/// [`PlanError::Cancelled`] when the user has asked to stop.
pub fn search(
    initial: &TriMesh,
    target: &TriMesh,
    options: &SetupOptions,
    ctx: &Ctx,
) -> Result<SetupReport, PlanError> {
    let problem = Problem { initial, target };
    let pair = Pair::new(&problem, options, ctx)?;
    let stage = Stage { pair: &pair, target, score: options.score, ctx };
    let anchor = Stance::new(initial, DMat3::IDENTITY, pair.grip_mm).foot;

    let families = families(&problem, options.rotations, anchor, pair.grip_mm);
    let (carried, rotations) = stage.coarse(&families, options.carried)?;
    let file_pose = carried[0];
    let (mut carried, floor, shifts) = stage.fine(&carried)?;
    let nudges = stage.nudge(&mut carried, floor)?;
    let most = carried.iter().map(|t| t.share).fold(0.0, f64::max);
    let floor = floor.max(LEAST_SHARE * most);
    // Stable: among equals the pose of the files, which comes first.
    carried.sort_by(|a, b| b.rank(floor).total_cmp(&a.rank(floor)));
    let best = carried.iter().map(|t| t.candidate(anchor)).collect();
    let (winner, moves) = stage.refine(carried[0], floor)?;
    let mut tried = rotations + shifts + nudges + moves;
    let winner = winner.candidate(anchor);
    let mut others: Vec<Candidate> = Vec::new();
    if options.refined > 1 {
        // As it stands in its file, when the search has moved it: files often come aligned.
        let kept = stage.scored(Sampling::Fine, &file_pose);
        let candidate = kept.candidate(anchor);
        if kept.share >= floor && !candidate.is_same(&winner) {
            others.push(candidate);
        }
    }
    for trial in carried.iter().skip(1).filter(|t| t.share >= floor) {
        if others.len() + 1 >= options.refined {
            break;
        }
        let (trial, moves) = stage.refine(*trial, floor)?;
        tried += moves;
        let candidate = trial.candidate(anchor);
        if !others.iter().chain([&winner]).any(|o| o.is_same(&candidate)) {
            others.push(candidate);
        }
    }
    Ok(SetupReport { winner, others, best, tried })
}

/// Starts of which the best is ranked.
struct Family {
    /// Each with where the centroid of its contact is put, mm.
    starts: Vec<(Stance, DVec2)>,
    /// On a face of the target's own, or as in the file.
    rests: bool,
}

/// The pose of the file and the faces to rest on, then the spread.
fn families(problem: &Problem, spread: usize, anchor: DVec2, grip_mm: f64) -> Vec<Family> {
    let Problem { initial, target } = problem;
    let (middle, centroid) = (initial.bounds().center().truncate(), initial.centroid().truncate());
    let own_centroid = target.centroid();
    let upright = rotations::upright(target, RESTING);
    let resting = upright.par_iter().map(|r| {
        let first = Stance::new(target, *r, grip_mm);
        let headings = (0..HEADINGS).map(|i| {
            let angle = std::f64::consts::TAU * i as f64 / HEADINGS as f64;
            if i == 0 { first } else { first.turned(angle) }
        });
        let starts = headings.flat_map(|s| {
            let own_middle = turned_bounds(target, &s.rotation).center().truncate();
            let own_centroid = (s.rotation * own_centroid).truncate();
            [anchor, middle + s.foot - own_middle, centroid + s.foot - own_centroid]
                .map(|at| (s, at))
        });
        Family { starts: starts.collect(), rests: true }
    });
    let mut families: Vec<Family> = resting.collect();
    let spread = rotations::spread(spread);
    families.par_extend(spread.par_iter().map(|r| {
        let start = (Stance::new(target, *r, grip_mm), anchor);
        Family { starts: vec![start], rests: false }
    }));
    families
}

/// Box of the turned mesh, mm.
fn turned_bounds(mesh: &TriMesh, rotation: &DMat3) -> Aabb {
    let used = mesh.triangles().iter().flatten();
    Aabb::of(used.map(|&i| *rotation * mesh.vertices()[i as usize]))
}

/// The stages of one search.
struct Stage<'a> {
    pair: &'a Pair,
    target: &'a TriMesh,
    score: Score,
    ctx: &'a Ctx,
}

impl Stage<'_> {
    /// The pose of the files, then the best of the families that rest, then those of the spread;
    /// and how many were tried.
    fn coarse(
        &self,
        families: &[Family],
        carried: usize,
    ) -> Result<(Vec<Trial>, usize), Cancelled> {
        let of_family = |(f, family): (usize, &Family)| {
            family.starts.iter().map(move |(s, at)| (f, *s, *at)).collect::<Vec<_>>()
        };
        let flat: Vec<(usize, Stance, DVec2)> =
            families.iter().enumerate().flat_map(of_family).collect();
        let facing: Vec<f64> = families
            .par_iter()
            .map(|f| self.pair.self_supporting(&f.starts[0].0.rotation))
            .collect();
        let trial = |stance: Stance, at: DVec2, facing: f64| {
            let share = self.pair.share(&stance.standing_at(at));
            let (of_volume, of_bases) = self.score.weights();
            let score_coarse = of_volume * share + of_bases * facing;
            Trial { stance, at, score_coarse, score_fine: 0.0, share, is_file_pose: false }
        };
        let trials = self.each("setup: rotations", &flat, |(f, stance, at)| {
            (*f, trial(*stance, *at, facing[*f]))
        })?;
        let file = families[0].starts[0].0;
        let kept = trial(file, file.foot, facing[0]);
        let mut chosen = vec![Trial { is_file_pose: true, ..kept }];
        for rests in [true, false] {
            let mut ranked: Vec<Trial> = trials
                .chunk_by(|a, b| a.0 == b.0)
                .filter(|family| families[family[0].0].rests == rests)
                .filter_map(|family| {
                    let held = family.iter().map(|(_, t)| *t).filter(|t| t.share > 0.0);
                    held.reduce(|best, t| if t.score_coarse > best.score_coarse { t } else { best })
                })
                .collect();
            ranked.sort_by(|a, b| b.score_coarse.total_cmp(&a.score_coarse));
            chosen.extend(ranked.into_iter().take(carried));
        }
        Ok((chosen, flat.len() + 1))
    }

    /// Each trial at its best shift, the least share that competes, and how many were tried.
    fn fine(&self, trials: &[Trial]) -> Result<(Vec<Trial>, f64, usize), Cancelled> {
        let shifted: Vec<(usize, Trial)> = trials
            .iter()
            .enumerate()
            .flat_map(|(i, t)| {
                let tenth = self.extent(t) / 10.0;
                let shifts = TENTHS.iter().flat_map(|x| TENTHS.iter().map(|y| DVec2::new(*x, *y)));
                shifts.map(move |s| (i, if s == DVec2::ZERO { *t } else { t.shifted(s * tenth) }))
            })
            .collect();
        let scored =
            self.each("setup: shifts", &shifted, |(i, t)| (*i, self.scored(Sampling::Coarse, t)))?;
        let floor = LEAST_SHARE * scored.iter().map(|(_, t)| t.share).fold(0.0, f64::max);
        let of_each = scored.chunk_by(|a, b| a.0 == b.0);
        let best =
            of_each.map(|shifts| *best_of(&shifts[0].1, shifts.iter().map(|(_, t)| t), floor));
        Ok((best.collect(), floor, shifted.len()))
    }

    /// Refines each trial on the coarse grid, so that none loses by the width of a step, and
    /// scores it on the fine one; and how many moves were tried.
    fn nudge(&self, trials: &mut [Trial], floor: f64) -> Result<usize, Cancelled> {
        let nudged = self.each("setup: carried", trials, |t| {
            let (t, moves) = self.climb(Sampling::Coarse, *t, NUDGES, floor)?;
            Ok((self.scored(Sampling::Fine, &t), moves + 1))
        })?;
        let mut tried = 0;
        for (trial, nudged) in trials.iter_mut().zip(nudged) {
            let (t, moves) = nudged?;
            (*trial, tried) = (t, tried + moves);
        }
        Ok(tried)
    }

    /// Refines the winner on the fine grid; and how many moves were tried.
    fn refine(&self, trial: Trial, floor: f64) -> Result<(Trial, usize), Cancelled> {
        self.ctx.begin("setup: refine", REFINEMENTS.len() as u64);
        let refined = self.climb(Sampling::Fine, trial, REFINEMENTS, floor);
        self.ctx.end();
        refined
    }

    /// Shifts and turns a trial while Score₂ gains, by steps halved so many times; and how many
    /// moves were tried.
    fn climb(
        &self,
        sampling: Sampling,
        trial: Trial,
        halvings: Range<i32>,
        floor: f64,
    ) -> Result<(Trial, usize), Cancelled> {
        let step = self.extent(&trial) / 20.0;
        let turn = std::f64::consts::PI / HEADINGS as f64;
        let (mut best, mut tried) = (trial, 0);
        for halving in halvings {
            let scale = 0.5f64.powi(halving);
            for _ in 0..MOST_MOVES {
                self.ctx.check()?;
                let moves = moves(&best, step * scale, turn * scale);
                tried += moves.len();
                let scored: Vec<Trial> =
                    moves.par_iter().map(|t| self.scored(sampling, t)).collect();
                let next = best_of(&scored[0], scored.iter(), floor);
                if next.rank(floor) < best.rank(floor) + LEAST_GAIN {
                    break;
                }
                best = *next;
            }
            if sampling == Sampling::Fine {
                self.ctx.advance(1);
            }
        }
        Ok((best, tried))
    }

    fn scored(&self, sampling: Sampling, t: &Trial) -> Trial {
        let measured = self.pair.measure(sampling, &t.stance.standing_at(t.at));
        Trial { score_fine: score_fine(&measured, self.score), share: measured.share, ..*t }
    }

    /// Extent of the turned target along x and y, mm.
    fn extent(&self, t: &Trial) -> DVec2 {
        turned_bounds(self.target, &t.stance.rotation).size().truncate()
    }

    /// Applies `f` to all in parallel, in order, as one stage of the progress.
    fn each<T: Sync, R: Send>(
        &self,
        stage: &str,
        items: &[T],
        f: impl Fn(&T) -> R + Sync,
    ) -> Result<Vec<R>, Cancelled> {
        self.ctx.begin(stage, items.len() as u64);
        let done = items
            .par_iter()
            .map(|item| {
                self.ctx.check()?;
                let result = f(item);
                self.ctx.advance(1);
                Ok(result)
            })
            .collect();
        self.ctx.end();
        done
    }
}

/// The best ranked of some trials, the first among equals.
fn best_of<'a>(first: &'a Trial, rest: impl Iterator<Item = &'a Trial>, floor: f64) -> &'a Trial {
    rest.fold(first, |best, t| if t.rank(floor) > best.rank(floor) { t } else { best })
}

/// The placements one step away.
fn moves(t: &Trial, step: DVec2, turn: f64) -> [Trial; 6] {
    let (x, y) = (DVec2::X * step.x, DVec2::Y * step.y);
    let turned = |angle| Trial { stance: t.stance.turned(angle), is_file_pose: false, ..*t };
    [t.shifted(x), t.shifted(-x), t.shifted(y), t.shifted(-y), turned(turn), turned(-turn)]
}

/// Score₂ (Eq. 7); 0 when nothing is reused.
fn score_fine(m: &Measured, score: Score) -> f64 {
    if m.share == 0.0 {
        return 0.0;
    }
    let height = m.lowest_mm.map_or(1.0, |z| (z / m.top_mm).clamp(0.0, 1.0));
    let clear = 1.0 - m.base_share;
    let (of_volume, of_bases) = score.weights();
    of_volume * m.share + of_bases * (height + clear * clear)
}

impl Trial {
    fn shifted(&self, by: DVec2) -> Trial {
        Trial { at: self.at + by, is_file_pose: false, ..*self }
    }

    /// Score₂ among those that compete; below all of them, but by what is reused, otherwise.
    fn rank(&self, floor: f64) -> f64 {
        if self.share < floor {
            return self.share - 1.0;
        }
        self.score_fine + if self.is_file_pose { FILE_POSE_WORTH } else { 0.0 }
    }

    fn candidate(&self, anchor: DVec2) -> Candidate {
        let transform = self.stance.standing_at(self.at);
        let stands = self.is_file_pose && transform.translation.length() < ROUNDING_MM;
        Candidate {
            transform: if stands { DAffine3::IDENTITY } else { transform },
            shift: self.at - anchor,
            score_coarse: self.score_coarse,
            score_fine: self.score_fine,
            reused_share: self.share,
        }
    }
}
