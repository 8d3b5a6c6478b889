//! What the extruder's codes, its pin and its filament do while a program runs.

use super::Interpreter;
use crate::base::DVec3;
use crate::gcode::report::Rule;
use crate::plan::{Step, StepKind};
use crate::voxel::Frame;

/// Largest relative error of a bead's feed: a hundredth more or less material.
const BEAD_FEED: f64 = 0.01;

/// Largest relative error of a bead's filament, and the rounding of an E word, mm.
const FILAMENT: (f64, f64) = (0.01, 2e-5);

/// Heights closer than this are one layer, mm: ten times the last written digit.
const SAME_LAYER_MM: f64 = 0.01;

/// Error of a layer's thickness from written positions, mm.
const WRITTEN_MM: f64 = 0.002;

/// Heights along its direction at which a step adds something wide enough, and deep enough inside
/// a body, that a bead must be laid there: a section less than two beads wide may get none, and where nothing is added at all,
/// another body begins above, on a floor of its own.
#[derive(Default)]
pub(super) struct Storeys {
    lowest: f64,
    /// Whether a bead must be laid in each stretch of `STOREY_MM`.
    filled: Vec<bool>,
}

/// Stretch of heights that is looked at as one, mm: half the thinnest layer nozzles lay.
const STOREY_MM: f64 = 0.05;

impl Storeys {
    /// Of a step whose beads are `width` mm wide.
    pub(super) fn of(step: &Step, frame: &Frame, width: f64) -> Storeys {
        let plane = step.direction.image_plane();
        let half = frame.pitch / 2.0 * plane.d.abs().element_sum();
        let around: [DVec3; 8] = std::array::from_fn(|i| {
            let (sin, cos) = (std::f64::consts::FRAC_PI_4 * i as f64).sin_cos();
            width * (cos * plane.u + sin * plane.v)
        });
        let inside = |p: DVec3| frame.voxel_at(p).is_some_and(|v| step.region.get(v));
        let wide = |p: &DVec3| around.iter().all(|a| inside(*p + *a));
        // A body's exact face lies up to half a voxel inside its voxels': only from the middle of its
        // outermost voxels on is there certainly something.
        let along = frame.pitch * plane.d;
        let stretch = |p: DVec3| {
            let reach = |side: DVec3| if inside(p + side) { half } else { 0.0 };
            let z = plane.height(p);
            (z - reach(-along), z + reach(along))
        };
        let centers = step.region.iter_ones().map(|v| frame.center(v)).filter(wide);
        let stretches: Vec<(f64, f64)> = centers.map(stretch).collect();
        let Some(lowest) = stretches.iter().map(|s| s.0).reduce(f64::min) else {
            return Storeys::default();
        };
        let at = |height: f64| ((height - lowest) / STOREY_MM).max(0.0) as usize;
        let mut filled = Vec::new();
        for (low, high) in stretches {
            let (from, to) = (at(low), at(high));
            filled.resize(filled.len().max(to + 1), false);
            filled[from..=to].fill(true);
        }
        Storeys { lowest, filled }
    }

    /// Whether in some stretch between two heights no bead need be laid.
    fn is_empty_in(&self, below: f64, above: f64) -> bool {
        let from = ((below - self.lowest) / STOREY_MM).ceil() as i64;
        let to = ((above - self.lowest) / STOREY_MM).floor() as i64;
        let filled =
            |k: i64| usize::try_from(k).is_ok_and(|k| self.filled.get(k).copied().unwrap_or(false));
        (from..to).any(|k| !filled(k))
    }
}

impl Interpreter<'_> {
    /// Filament alone: drawn back, or given again by as much.
    pub(super) fn filament(&mut self, by: f64) {
        let whole = self.machine.extruder.as_ref().map_or(0.0, |e| e.retract_mm);
        let wrong = if self.motion != Some(1) || self.feed.is_none() {
            Some("filament moves need G1 and a feed")
        } else if (by.abs() - whole).abs() > FILAMENT.1 {
            Some("filament moves by another length than the machine's retraction")
        } else if !self.open {
            Some("filament moves while the module is closed")
        } else if (by < 0.0) == self.drawn {
            Some("filament is drawn back twice, or given without being drawn back")
        } else {
            None
        };
        if let Some(wrong) = wrong {
            self.find(Rule::Extruder, wrong);
        }
        (self.drawn, self.extruding) = (by < 0.0, false);
    }

    /// The module's output pin: its level is the S of the block.
    pub(super) fn pin(&mut self, pin: Option<f64>) {
        let level = self.level.take();
        let codes = self.codes;
        match (pin, level, codes) {
            (Some(0.0), Some(1.0), Some(c)) => self.extruder_code(c.open),
            (Some(0.0), Some(0.0), Some(c)) => self.extruder_code(c.close),
            _ => self.find(Rule::Extruder, "M42 needs P0 and S0 or S1"),
        }
    }

    pub(super) fn extruder_code(&mut self, m: u32) {
        let Some(c) = self.codes else {
            return self.find(Rule::Modes, format!("unknown code M{m}"));
        };
        let (open, extruding, drawn) = (self.open, self.extruding, self.drawn);
        let wrong = if m == c.open {
            self.open = true;
            let prints = self.kind() == Some(StepKind::Additive);
            (!prints || open).then_some("the module opens in a step that does not print, or twice")
        } else if m == c.close {
            self.open = false;
            (extruding || drawn || !open)
                .then_some("the module closes while extruding or drawn back, or was not open")
        } else if m == c.on {
            (self.extruding, self.drawn) = (true, drawn);
            (!open || drawn || extruding)
                .then_some("extrusion starts while the module is closed, drawn back or extruding")
        } else if m == c.off {
            self.extruding = false;
            (!extruding).then_some("extrusion stops, but it was not on")
        } else if m == c.draw {
            self.drawn = true;
            (!open || extruding || drawn)
                .then_some("retraction while the module is closed, extruding or drawn back")
        } else if m == c.give {
            self.drawn = false;
            (!drawn).then_some("retraction ends, but the filament was not drawn back")
        } else {
            return self.find(Rule::Modes, format!("unknown code M{m}"));
        };
        if let Some(wrong) = wrong {
            self.find(Rule::Extruder, wrong);
        }
    }

    /// The filament of a bead against its section.
    pub(super) fn bead_filament(&mut self, e: f64, length: f64) {
        let (Some(extruder), Some(tool)) = (&self.machine.extruder, self.tool()) else { return };
        let nominal = extruder.feed_mm_min(&tool.process);
        let per_mm =
            extruder.filament_per_mm(&tool.process) * nominal / self.feed.unwrap_or(nominal);
        let want = length * per_mm;
        // Ends of the move are written to the dialect's digits.
        let written = 2.0 * per_mm * 10f64.powi(-(self.dialect.linear_digits as i32));
        if (e - want).abs() > FILAMENT.0 * want + FILAMENT.1 + written {
            self.find(
                Rule::Extruder,
                format!("E{e} for a bead of {length:.3} mm that takes {want:.5} mm of filament"),
            );
        }
        if !matches!(self.motion, Some(1..=3)) || !self.open || self.drawn {
            self.find(Rule::Extruder, "a bead while the module is closed or drawn back");
        }
    }

    /// The feed of a bead that ends at this height along the direction: the rate is constant, so
    /// the layer's thickness over the one below says it.
    pub(super) fn bead_feed(&mut self, height: f64) {
        let (Some(e), Some(tool), Some(feed)) = (&self.machine.extruder, self.tool(), self.feed)
        else {
            return;
        };
        let layer = tool.process.layer_mm;
        let nominal = e.feed_mm_min(&tool.process);
        if self.layers[1].is_none_or(|z| height > z + SAME_LAYER_MM) {
            let nothing_between = |below: f64| self.storeys.is_empty_in(below, height - layer);
            self.layers = [self.layers[1].filter(|z| !nothing_between(*z)), Some(height)];
        }
        let (want, within) = match self.layers {
            [Some(below), Some(z)] => {
                let thick = z - below;
                (nominal * layer / thick, BEAD_FEED + WRITTEN_MM / thick)
            }
            // The floor of a body's first layer is not in the program; a last layer may be the first.
            _ => (nominal * feed.clamp(nominal / 2.0, nominal * 2.0) / nominal, BEAD_FEED),
        };
        if (feed - want).abs() > within * want {
            self.find(
                Rule::Feed,
                format!("a bead at F{feed}, the extruder's rate needs {want:.1}"),
            );
        }
    }
}
