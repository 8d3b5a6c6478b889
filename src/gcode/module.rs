//! How the extruder is driven in a program: by the module's codes, or by an E axis.

use super::dialect::{Dialect, Extrusion, ModuleCodes};
use crate::machine::{Extruder, Tool};

/// What the nozzle does just now.
#[derive(Clone, Copy, Default)]
pub(super) struct Bead {
    pub on: bool,
    pub drawn: bool,
    pub primed: bool,
}

/// The filament of a control with an E axis.
#[derive(Clone, Copy)]
pub(super) struct Axis {
    pub retract_mm: f64,
    pub per_mm: f64,
}

/// How the extruder is driven in this program.
#[derive(Clone, Copy)]
pub(super) struct Module {
    pub codes: ModuleCodes,
    pub prime_s: f64,
    /// At which the rate lays the nominal bead, mm/min.
    pub feed: f64,
    pub axis: Option<Axis>,
}

impl Module {
    pub fn of(dialect: &Dialect, e: &Extruder, tool: &Tool) -> Option<Module> {
        let per_mm = e.filament_per_mm(&tool.process);
        let axis = Axis { retract_mm: e.retract_mm, per_mm };
        Some(Module {
            codes: dialect.module_codes(e)?,
            prime_s: e.prime_s,
            feed: e.feed_mm_min(&tool.process),
            axis: (dialect.extrusion == Extrusion::Axis).then_some(axis),
        })
    }

    pub fn open(&self) -> String {
        self.axis.map_or_else(|| format!("M{}", self.codes.open), |_| "M42 P0 S1".into())
    }

    pub fn close(&self) -> String {
        self.axis.map_or_else(|| format!("M{}", self.codes.close), |_| "M42 P0 S0".into())
    }

    /// Filament for a bead of this length at this feed, where the program must say it.
    pub fn filament(&self, length: f64, feed: f64) -> Option<f64> {
        self.axis.map(|a| length * a.per_mm * self.feed / feed)
    }
}
