//! Figures of the process: what a tool is run with, and what the control and the extruder are.

use super::tool::ToolKind;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How a tool is run. Every figure has a default; those of the other kind of tool are not read.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Process {
    /// Gauge length: tip to spindle nose, mm. Without it, the lower face of the topmost section,
    /// which is the head.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gauge_mm: Option<f64>,
    /// Cutting feed, mm/min. A nozzle's feed follows from the extruder's rate and the bead.
    pub feed_mm_min: f64,
    /// Feed along the tool axis into material, mm/min.
    pub plunge_mm_min: f64,
    pub spindle_rpm: f64,
    /// Roughing depth per layer, fraction of the cutter's diameter.
    pub step_down: f64,
    /// Roughing distance between passes, fraction of the cutter's diameter.
    pub step_over: f64,
    /// What roughing leaves for finishing, mm.
    pub stock_to_leave_mm: f64,
    /// Height of the ridge between two finishing passes, mm.
    pub scallop_mm: f64,
    /// Layer height, mm.
    pub layer_mm: f64,
    /// Distance between the middles of neighbouring beads, mm.
    pub path_mm: f64,
    /// Closed beads along the contour of a layer.
    pub perimeters: u32,
    /// Share of a layer's inside that is filled, 0 to 1.
    pub infill: f64,
    /// How the inside is filled.
    pub pattern: Pattern,
    /// Layers without gaps under every face that looks up or down.
    pub skins: u32,
    /// Where closed beads begin.
    pub seam: Seam,
}

/// Lines that fill the inside of a layer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Pattern {
    /// Straight lines that turn by a quarter from layer to layer.
    #[default]
    Rectilinear,
    /// Level lines of the gyroid surface: alike in all directions.
    Gyroid,
    /// Parallel to the outline.
    Concentric,
}

/// Where a closed bead begins and ends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Seam {
    /// Where the nozzle is nearest: the shortest travels.
    #[default]
    Nearest,
    /// At the point farthest along v of the layer's plane: all seams in one line.
    Aligned,
}

impl Default for Process {
    /// 0.2 mm layers, 0.5 mm paths, 30 % infill and 0.2 mm of stock (W2V Sec. 7.4); feeds, speed
    /// and steps are those a small ball end takes in plastic and wax on a desktop machine.
    fn default() -> Self {
        Process {
            gauge_mm: None,
            feed_mm_min: 800.0,
            plunge_mm_min: 200.0,
            spindle_rpm: 10_000.0,
            step_down: 0.5,
            step_over: 0.4,
            stock_to_leave_mm: 0.2,
            scallop_mm: 0.02,
            layer_mm: 0.2,
            path_mm: 0.5,
            perimeters: 2,
            infill: 0.3,
            pattern: Pattern::Rectilinear,
            skins: 4,
            seam: Seam::Nearest,
        }
    }
}

impl Process {
    /// Checks every figure; the message names the key and its range.
    pub(super) fn validate(&self) -> Result<(), String> {
        let figures = [
            ("gauge_mm", self.gauge_mm.unwrap_or(1.0), 0.0, 10_000.0),
            ("feed_mm_min", self.feed_mm_min, 1e-3, 1e6),
            ("plunge_mm_min", self.plunge_mm_min, 1e-3, 1e6),
            ("spindle_rpm", self.spindle_rpm, 0.0, 1e6),
            ("step_down", self.step_down, 1e-3, 10.0),
            ("step_over", self.step_over, 1e-3, 1.0),
            ("stock_to_leave_mm", self.stock_to_leave_mm, 0.0, 100.0),
            ("scallop_mm", self.scallop_mm, 1e-4, 10.0),
            ("layer_mm", self.layer_mm, 1e-3, 100.0),
            ("path_mm", self.path_mm, 1e-3, 100.0),
            ("infill", self.infill, 0.0, 1.0),
        ];
        for (key, value, low, high) in figures {
            within(key, value, low, high)?;
        }
        if self.perimeters > 1000 {
            return Err(format!("perimeters = {} must be at most 1000", self.perimeters));
        }
        if self.skins > 1000 {
            return Err(format!("skins = {} must be at most 1000", self.skins));
        }
        Ok(())
    }

    /// Cross-section of one bead, mm²: layer height times path distance, since neighbouring beads
    /// must close the layer between them.
    pub fn bead_section_mm2(&self) -> f64 {
        self.layer_mm * self.path_mm
    }
}

/// `low ≤ value ≤ high` and finite, or a message naming the key.
pub(super) fn within(key: &str, value: f64, low: f64, high: f64) -> Result<(), String> {
    if (low..=high).contains(&value) {
        Ok(())
    } else {
        Err(format!("{key} = {value} must lie between {low} and {high}"))
    }
}

/// The control and what it allows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Control {
    /// Name of the G-code dialect.
    pub dialect: String,
    /// Retract height over the highest obstacle before the rotary axes are indexed, mm.
    #[serde(default = "default_clearance")]
    pub clearance_mm: f64,
    /// Rapid rate of the linear axes, mm/min.
    pub rapid_mm_min: f64,
    pub max_feed_mm_min: f64,
    pub max_spindle_rpm: f64,
    /// What the linear axes reach together, mm/s²; times follow from it.
    #[serde(default = "default_acceleration")]
    pub acceleration_mm_s2: f64,
    /// What a rotary axis reaches, degrees/s².
    #[serde(default = "default_turning")]
    pub acceleration_deg_s2: f64,
    /// Time of one tool change, s.
    #[serde(default = "default_change")]
    pub tool_change_s: f64,
    #[serde(default)]
    pub post: Writing,
}

fn default_clearance() -> f64 {
    20.0
}

/// A light machine with ball screws; routers reach less, printers ten times as much.
fn default_acceleration() -> f64 {
    500.0
}

fn default_turning() -> f64 {
    360.0
}

fn default_change() -> f64 {
    15.0
}

/// How programs are written, where the dialect leaves a choice.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Writing {
    /// Work offset the program runs in, 54 to 59.
    pub work_offset: u32,
    /// Every block gets a number; without it the dialect decides.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub line_numbers: Option<bool>,
    /// Digits after the point of X Y Z, 2 to 6; without it the dialect decides.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub linear_digits: Option<u32>,
    /// Digits after the point of rotary words, 2 to 6; without it the dialect decides.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rotary_digits: Option<u32>,
    /// Runs of short moves across the tool axis are written as arcs, G2 and G3.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub arcs: bool,
}

impl Default for Writing {
    fn default() -> Self {
        Writing {
            work_offset: 54,
            line_numbers: None,
            linear_digits: None,
            rotary_digits: None,
            arcs: false,
        }
    }
}

impl Writing {
    fn validate(&self) -> Result<(), String> {
        within("work_offset", f64::from(self.work_offset), 54.0, 59.0)?;
        for (key, digits) in
            [("linear_digits", self.linear_digits), ("rotary_digits", self.rotary_digits)]
        {
            within(key, f64::from(digits.unwrap_or(3)), 2.0, 6.0)?;
        }
        Ok(())
    }
}

impl Control {
    pub(super) fn validate(&self) -> Result<(), String> {
        let named = !self.dialect.is_empty()
            && self.dialect.len() <= 40
            && self.dialect.bytes().all(|b| b.is_ascii_alphanumeric() || b"-_.".contains(&b));
        if !named {
            return Err(format!(
                "dialect = {:?} must be a name of letters, digits, '-', '_' and '.'",
                self.dialect
            ));
        }
        within("clearance_mm", self.clearance_mm, 0.0, 10_000.0)?;
        within("rapid_mm_min", self.rapid_mm_min, 1e-3, 1e6)?;
        within("max_feed_mm_min", self.max_feed_mm_min, 1e-3, 1e6)?;
        within("acceleration_mm_s2", self.acceleration_mm_s2, 1.0, 1e6)?;
        within("acceleration_deg_s2", self.acceleration_deg_s2, 1.0, 1e6)?;
        within("tool_change_s", self.tool_change_s, 0.0, 3600.0)?;
        self.post.validate()?;
        within("max_spindle_rpm", self.max_spindle_rpm, 0.0, 1e6)
    }

    /// Feed of a cutter, capped by the control, mm/min.
    pub fn feed(&self, process: &Process) -> f64 {
        process.feed_mm_min.min(self.max_feed_mm_min)
    }

    /// Plunge feed of a cutter, capped by the control, mm/min.
    pub fn plunge(&self, process: &Process) -> f64 {
        process.plunge_mm_min.min(self.max_feed_mm_min)
    }

    /// Spindle speed of a cutter, capped by the control, 1/min.
    pub fn spindle(&self, process: &Process) -> f64 {
        process.spindle_rpm.min(self.max_spindle_rpm)
    }
}

/// Which device listens to the extruder's codes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ExtruderPort {
    /// The control passes them on.
    #[default]
    Same,
    /// A separate board on its own port; the control never sees them.
    Second,
}

/// The extruder module: no E axis, a constant volumetric rate switched by codes (W2V App. F).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Extruder {
    pub m_open: String,
    pub m_close: String,
    pub m_on: String,
    pub m_off: String,
    pub m_retract_on: String,
    pub m_retract_off: String,
    pub port: ExtruderPort,
    /// How the extruder's own board talks: plain, marlin, rrf, grbl or grblhal; plain when not
    /// said. Read only with a second port.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dialect: Option<String>,
    /// What leaves the nozzle while extrusion is on, mm³/s.
    pub volumetric_mm3_s: f64,
    pub filament_mm: f64,
    /// Length of filament drawn back where the control has an E axis, mm.
    pub retract_mm: f64,
    /// Wait after extrusion is switched on until material flows, s.
    pub prime_s: f64,
}

impl Default for Extruder {
    /// M70 to M75 as W2V App. F; the rate lays a 0.2 × 0.5 mm bead at 20 mm/s.
    fn default() -> Self {
        Extruder {
            m_open: "M70".into(),
            m_close: "M71".into(),
            m_on: "M72".into(),
            m_off: "M73".into(),
            m_retract_on: "M74".into(),
            m_retract_off: "M75".into(),
            port: ExtruderPort::Same,
            dialect: None,
            volumetric_mm3_s: 2.0,
            filament_mm: 1.75,
            retract_mm: 1.5,
            prime_s: 0.5,
        }
    }
}

impl Extruder {
    /// The six codes with their keys.
    pub fn codes(&self) -> [(&'static str, &str); 6] {
        [
            ("m_open", &self.m_open),
            ("m_close", &self.m_close),
            ("m_on", &self.m_on),
            ("m_off", &self.m_off),
            ("m_retract_on", &self.m_retract_on),
            ("m_retract_off", &self.m_retract_off),
        ]
    }

    pub(super) fn validate(&self) -> Result<(), String> {
        for (key, code) in self.codes() {
            let digits = code.strip_prefix('M').unwrap_or("");
            let whole =
                (1..=4).contains(&digits.len()) && digits.bytes().all(|b| b.is_ascii_digit());
            if !whole {
                return Err(format!("{key} = {code:?} must be one M code such as \"M70\""));
            }
        }
        let codes = self.codes();
        for (i, (key, code)) in codes.iter().enumerate() {
            if let Some((other, _)) = codes[..i].iter().find(|(_, c)| c == code) {
                return Err(format!("{key} and {other} are both {code}; give each its own code"));
            }
        }
        within("volumetric_mm3_s", self.volumetric_mm3_s, 1e-6, 1e4)?;
        within("filament_mm", self.filament_mm, 0.1, 10.0)?;
        within("retract_mm", self.retract_mm, 0.0, 100.0)?;
        within("prime_s", self.prime_s, 0.0, 600.0)
    }

    /// Filament that one mm of the tool's bead takes, mm.
    pub fn filament_per_mm(&self, process: &Process) -> f64 {
        process.bead_section_mm2() / (std::f64::consts::PI * self.filament_mm.powi(2) / 4.0)
    }

    /// Feed at which the constant rate lays the tool's bead, mm/min.
    pub fn feed_mm_min(&self, process: &Process) -> f64 {
        60.0 * self.volumetric_mm3_s / process.bead_section_mm2()
    }
}

/// Process figures of a tool by kind, as lines for a reader.
pub(super) fn describe(kind: ToolKind, p: &Process) -> String {
    match kind {
        ToolKind::Subtractive => format!(
            "feed {} mm/min, plunge {} mm/min, spindle {} rpm; roughing: step down {} and step \
             over {} of the diameter, {} mm of stock left; finishing scallop {} mm",
            p.feed_mm_min,
            p.plunge_mm_min,
            p.spindle_rpm,
            p.step_down,
            p.step_over,
            p.stock_to_leave_mm,
            p.scallop_mm
        ),
        ToolKind::Additive => format!(
            "layer {} mm, path {} mm, {} perimeters, infill {:.0} % {}, {} layers of skin",
            p.layer_mm,
            p.path_mm,
            p.perimeters,
            100.0 * p.infill,
            match p.pattern {
                Pattern::Rectilinear => "rectilinear",
                Pattern::Gyroid => "gyroid",
                Pattern::Concentric => "concentric",
            },
            p.skins
        ),
    }
}
