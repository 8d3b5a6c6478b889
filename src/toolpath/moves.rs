use super::timing::Leg;
use crate::base::{DVec3, Direction};
use crate::machine::Control;
use crate::plan::StepKind;

/// What a move does to the workpiece.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MoveKind {
    /// As fast as the axes go: at the safe height, or straight away from the work along the axis.
    Rapid,
    /// At feed through cleared space: straight up or down the axis, or across over what stands.
    Approach,
    /// The edge cuts.
    Cut,
    /// The bead is laid.
    Deposit,
    /// At feed without depositing; the filament is drawn back.
    Travel,
}

/// One straight move of the tool's tip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Move {
    pub kind: MoveKind,
    /// Where the tip ends, plan coordinates, mm.
    pub tip: DVec3,
    /// mm/min; 0 for rapids.
    pub feed: f64,
}

/// What a step's paths do, in figures.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Figures {
    /// Volume of the plan's region, mm³.
    pub region_mm3: f64,
    /// Length cut or deposited, mm.
    pub working_mm: f64,
    /// Bead volume laid: length × bead section, mm³; 0 for subtractive steps.
    pub material_mm3: f64,
    /// Fraction of the region's voxels within half a pitch of the swept edge; 0 for additive steps.
    pub coverage: f64,
    /// Part of the region too thin for a bead, which gets none, mm³; 0 for subtractive steps.
    pub thin_mm3: f64,
    /// Time the moves take, acceleration included, s.
    pub time_s: f64,
}

/// The paths of one step. The first move starts at the safe height; so does the last one end.
#[derive(Clone, Debug, PartialEq)]
pub struct Toolpath {
    /// Index of the plan's step.
    pub step: usize,
    pub kind: StepKind,
    pub tool: String,
    /// From the workpiece toward the spindle.
    pub direction: Direction,
    pub holding: usize,
    /// Height along the direction at or above which the tip may go anywhere, mm.
    pub safe_height: f64,
    /// Section of the bead at the nominal feed, mm²; 0 for subtractive steps.
    pub bead_mm2: f64,
    pub moves: Vec<Move>,
    pub figures: Figures,
}

impl Toolpath {
    /// Volume of the beads, mm³: the extruder's rate is constant, so a bead at another feed than
    /// the nominal one has another section.
    pub(super) fn laid_mm3(&self, nominal: f64) -> f64 {
        let beads = self.moves.windows(2).filter(|w| w[1].kind == MoveKind::Deposit);
        let volume = |w: &[Move]| {
            w[0].tip.distance(w[1].tip) * self.bead_mm2 * nominal / w[1].feed.max(1e-9)
        };
        beads.map(volume).fold(0.0, |a, b| a + b)
    }

    /// Length of all moves of a kind, mm.
    pub fn length(&self, kind: MoveKind) -> f64 {
        self.moves
            .windows(2)
            .filter(|w| w[1].kind == kind)
            .fold(0.0, |sum, w| sum + w[0].tip.distance(w[1].tip))
    }
}

/// The moves as legs of motion; the machine stands still where the bead begins or ends.
pub(super) fn legs(moves: &[Move], control: &Control) -> Vec<Leg> {
    let leg = |w: &[Move]| {
        let feed = if w[1].feed > 0.0 { w[1].feed } else { control.rapid_mm_min };
        let stops = (w[0].kind == MoveKind::Deposit) != (w[1].kind == MoveKind::Deposit);
        Leg { by: w[1].tip - w[0].tip, speed: feed / 60.0, stops }
    };
    moves.windows(2).map(leg).collect()
}

/// How far a dropped point may lie from the straight move that replaces it, mm: a tenth of the
/// finest lattice in use. Larger cuts corners, smaller keeps needless lines.
const COLLINEAR_MM: f64 = 0.005;

/// Joins runs of moves of one kind and feed that lie on one straight line in one sense.
pub(super) fn merge_collinear(moves: Vec<Move>) -> Vec<Move> {
    let mut out: Vec<Move> = Vec::with_capacity(moves.len());
    // Points dropped since the last kept one: all must stay near the merged line.
    let mut dropped: Vec<DVec3> = Vec::new();
    for m in moves {
        if out.last().is_some_and(|l| l.tip == m.tip) {
            continue;
        }
        if let [.., a, b] = out.as_slice() {
            let same = b.kind == m.kind && b.feed == m.feed && dropped.len() < 256;
            let near = |p: &DVec3| on_segment(a.tip, m.tip, *p);
            if same && near(&b.tip) && dropped.iter().all(near) {
                dropped.push(b.tip);
                let last = out.len() - 1;
                out[last] = m;
                continue;
            }
        }
        dropped.clear();
        out.push(m);
    }
    out
}

fn on_segment(a: DVec3, b: DVec3, p: DVec3) -> bool {
    let (ab, ap) = (b - a, p - a);
    let len2 = ab.length_squared();
    let t = ap.dot(ab);
    t > 0.0 && t < len2 && (ap - ab * (t / len2)).length() <= COLLINEAR_MM
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn straight_runs_merge_and_turns_stay() {
        let m =
            |x: f64, y: f64| Move { kind: MoveKind::Cut, tip: DVec3::new(x, y, 0.0), feed: 100.0 };
        let merged = merge_collinear(vec![m(0., 0.), m(1., 0.), m(2., 0.), m(2., 0.), m(1., 0.)]);
        assert_eq!(merged, [m(0., 0.), m(2., 0.), m(1., 0.)]);
        // A shallow arc must not be swallowed point by point.
        let arc: Vec<Move> = (0..200)
            .map(|i| m((i as f64 * 0.01).cos() * 50., (i as f64 * 0.01).sin() * 50.))
            .collect();
        for w in merge_collinear(arc.clone()).windows(2) {
            let middle = (w[0].tip + w[1].tip) / 2.0;
            assert!(50.0 - middle.length() < 2.0 * COLLINEAR_MM);
        }
    }
}
