use super::process::{Control, Process};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum ToolKind {
    Subtractive,
    Additive,
}

/// One piece of a tool's profile; `z` mm above the tip, radii in mm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(tag = "shape", rename_all = "kebab-case")]
pub enum Shape {
    /// Lower half of a ball that touches z = 0.
    Ball { radius: f64 },
    /// A flat end at z = 0 with a rounded corner.
    BullNose { radius: f64, corner: f64 },
    /// A cone or cylinder from (z0, r0) up to (z1, r1).
    Frustum { z0: f64, r0: f64, z1: f64, r1: f64 },
    /// Everything above z: a head without end.
    Platform { z: f64 },
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Section {
    #[serde(flatten)]
    pub shape: Shape,
    /// Belongs to K: it cuts, or is the bead.
    #[serde(default)]
    pub active: bool,
}

/// An axisymmetric tool. The origin is the tip; the axis points up, away from the work.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Tool {
    pub name: String,
    pub kind: ToolKind,
    #[serde(rename = "section", deserialize_with = "super::section::numbered")]
    pub sections: Vec<Section>,
    /// What it is run with.
    #[serde(default)]
    pub process: Process,
    #[serde(default, skip_serializing_if = "Taken::is_always")]
    pub taken: Taken,
}

/// When a tool of a machine's table takes part. One that is asked for by name always does.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema,
)]
#[serde(rename_all = "kebab-case")]
pub enum Taken {
    #[default]
    Always,
    /// Only where the voxels are at most a third of its tip's radius, and it makes them no finer:
    /// see [`Tool::is_round_at`].
    FineGrids,
    /// Only for what all others leave, since it is slender and slow; it makes voxels no finer.
    LastResort,
    /// Only for what those leave standing.
    Finest,
    /// Only where another tool would make a cut but has no room beside the surfaces for it; it makes voxels no
    /// finer.
    NarrowGaps,
}

impl Taken {
    fn is_always(&self) -> bool {
        *self == Taken::Always
    }
}

#[derive(Debug, thiserror::Error, PartialEq)]
pub enum InvalidTool {
    #[error("tool '{tool}' has no sections; give at least one [[section]]")]
    NoSections { tool: String },
    #[error("tool '{tool}', section {section}: {what}")]
    BadSection { tool: String, section: usize, what: String },
    #[error("tool '{tool}' is subtractive but no section is active; mark the edge active = true")]
    NothingCuts { tool: String },
    #[error("tool '{tool}': nothing touches the tip (z = 0)")]
    NoTip { tool: String },
    #[error("tool '{tool}', process: {what}")]
    BadProcess { tool: String, what: String },
}

/// No machine tool is larger (mm); a larger figure is a wrong unit and would size images by it.
const LARGEST_MM: f64 = 10_000.0;

/// Voxels along the radius of a tip that is to count as round: with two, a ball is a plus.
pub const VOXELS_PER_RADIUS: f64 = 3.0;

impl Tool {
    pub fn new(name: &str, kind: ToolKind, sections: Vec<Section>) -> Tool {
        Tool {
            name: name.into(),
            kind,
            sections,
            process: Default::default(),
            taken: Taken::Always,
        }
    }

    /// Checks every figure; call it on whatever comes from a file.
    pub fn validate(&self) -> Result<(), InvalidTool> {
        let tool = || self.name.clone();
        if self.sections.is_empty() {
            return Err(InvalidTool::NoSections { tool: tool() });
        }
        for (i, s) in self.sections.iter().enumerate() {
            s.shape.validate().map_err(|what| InvalidTool::BadSection {
                tool: tool(),
                section: i + 1,
                what,
            })?;
        }
        if self.kind == ToolKind::Subtractive && !self.sections.iter().any(|s| s.active) {
            return Err(InvalidTool::NothingCuts { tool: tool() });
        }
        if self.lower_surface(0.0) != 0.0 {
            return Err(InvalidTool::NoTip { tool: tool() });
        }
        self.process.validate().map_err(|what| InvalidTool::BadProcess { tool: tool(), what })
    }

    /// Height over the tip of the tool's lower surface at radius `rho` (mm): f(ρ) of the depth
    /// engine; infinite where the tool has nothing.
    pub fn lower_surface(&self, rho: f64) -> f64 {
        self.sections.iter().map(|s| s.shape.lower_surface(rho)).fold(f64::INFINITY, f64::min)
    }

    /// The same for the active part alone: k(ρ).
    pub fn active_lower_surface(&self, rho: f64) -> f64 {
        self.active().map(|s| s.lower_surface(rho)).fold(f64::INFINITY, f64::min)
    }

    fn active(&self) -> impl Iterator<Item = &Shape> {
        self.sections.iter().filter(|s| s.active).map(|s| &s.shape)
    }

    /// Whether the edge widens above its tip in a straight line, as that of a tapered cutter does.
    pub fn is_tapered(&self) -> bool {
        let widens = |s: &Section| matches!(s.shape, Shape::Frustum { r0, r1, .. } if r0 < r1);
        self.sections.iter().any(|s| s.active && widens(s))
    }

    /// Whether its edge is a ball, and a cylinder over that as wide.
    pub fn has_ball_end(&self) -> bool {
        let tip = self.active().next();
        matches!(tip, Some(Shape::Ball { radius }) if self.active_radius() <= *radius)
    }

    /// The same tool, everywhere so many mm farther from its axis.
    pub fn widened(&self, by: f64) -> Tool {
        let wider = |s: &Section| {
            let shape = match s.shape {
                Shape::Ball { radius } => Shape::BullNose { radius: radius + by, corner: radius },
                Shape::BullNose { radius, corner } => {
                    Shape::BullNose { radius: radius + by, corner }
                }
                Shape::Frustum { z0, r0, z1, r1 } => {
                    Shape::Frustum { z0, r0: r0 + by, z1, r1: r1 + by }
                }
                Shape::Platform { z } => Shape::Platform { z },
            };
            Section { shape, active: s.active }
        };
        Tool { sections: self.sections.iter().map(wider).collect(), ..self.clone() }
    }

    /// Largest radius of the active part, mm; 0 without one.
    pub fn active_radius(&self) -> f64 {
        self.active().map(Shape::max_radius).fold(0.0, f64::max)
    }

    /// Depth of a roughing level and distance between its passes, mm.
    pub fn roughing_steps_mm(&self) -> [f64; 2] {
        // A cutter thinner than this has no figures that are fractions of its diameter.
        let diameter = 2.0 * self.active_radius().max(0.05);
        [self.process.step_down, self.process.step_over].map(|share| share * diameter)
    }

    /// What the tool takes away in a minute of roughing under a control, mm³/min.
    pub fn roughing_mm3_min(&self, control: &Control) -> f64 {
        let [down, over] = self.roughing_steps_mm();
        down * over * control.feed(&self.process)
    }

    /// Top of the active part over the tip, mm: how deep the edge cuts.
    pub fn active_length(&self) -> f64 {
        self.active().map(|s| s.top()).fold(0.0, f64::max)
    }

    /// Gauge length: tip to spindle nose, mm. Unless the tool says otherwise the head is its
    /// topmost section, and the nose that section's lower face.
    pub fn gauge_mm(&self) -> f64 {
        let head = self.sections.iter().max_by(|a, b| a.shape.top().total_cmp(&b.shape.top()));
        self.process.gauge_mm.unwrap_or_else(|| head.map_or(0.0, |s| s.shape.bottom()))
    }

    /// Largest finite radius, mm; a platform does not count.
    pub fn max_radius(&self) -> f64 {
        self.sections
            .iter()
            .map(|s| s.shape.max_radius())
            .filter(|r| r.is_finite())
            .fold(0.0, f64::max)
    }

    /// Smallest radius that decides a grid's pitch: that of the tip section, mm.
    pub fn tip_radius(&self) -> f64 {
        self.sections
            .iter()
            .filter(|s| s.shape.lower_surface(0.0) == 0.0)
            .map(|s| match s.shape {
                Shape::Frustum { r0, r1, .. } => r0.max(r1),
                s => s.max_radius(),
            })
            .fold(f64::INFINITY, f64::min)
    }

    /// The longest of some tools in the order of a machine's table, of those that always take part.
    pub fn longest(tools: &[Tool]) -> Option<&Tool> {
        tools.iter().rfind(|t| t.taken == Taken::Always).or(tools.last())
    }

    /// Whether voxels of this pitch (mm) show the tip as round.
    pub fn is_round_at(&self, pitch_mm: f64) -> bool {
        self.tip_radius() >= VOXELS_PER_RADIUS * pitch_mm
    }

    /// Length over the tip at which the tool first becomes wider than `radius` (mm): its reach.
    pub fn reach(&self, radius: f64) -> f64 {
        self.sections
            .iter()
            .filter(|s| s.shape.max_radius() > radius + 1e-9)
            .map(|s| s.shape.lower_surface_beyond(radius))
            .fold(f64::INFINITY, f64::min)
    }

    /// Whether a point at height `z` over the tip and radius `rho` lies in the tool.
    pub fn contains(&self, rho: f64, z: f64) -> bool {
        self.sections.iter().any(|s| s.shape.contains(rho, z))
    }
}

impl Shape {
    fn validate(&self) -> Result<(), String> {
        let figures: &[f64] = match self {
            Shape::Ball { radius } => &[*radius],
            Shape::BullNose { radius, corner } => &[*radius, *corner],
            Shape::Frustum { z0, r0, z1, r1 } => &[*z0, *r0, *z1, *r1],
            Shape::Platform { z } => &[*z],
        };
        if let Some(bad) = figures.iter().find(|f| !(0.0..=LARGEST_MM).contains(*f)) {
            return Err(format!("{bad} is not a length between 0 and {LARGEST_MM} mm"));
        }
        match *self {
            Shape::Ball { radius } if radius <= 0.0 => Err("a ball needs a radius above 0".into()),
            Shape::BullNose { radius, corner } if radius <= 0.0 || corner > radius => {
                Err(format!("corner radius {corner} must not exceed radius {radius}"))
            }
            Shape::Frustum { z0, z1, .. } if z1 <= z0 => {
                Err(format!("z1 = {z1} must lie above z0 = {z0}"))
            }
            Shape::Frustum { r0, r1, .. } if r0.max(r1) <= 0.0 => {
                Err("a frustum needs a radius above 0".into())
            }
            _ => Ok(()),
        }
    }

    /// Lowest height of the shape at radius `rho`; infinite outside it.
    pub fn lower_surface(&self, rho: f64) -> f64 {
        match *self {
            Shape::Ball { radius } if rho <= radius => {
                radius - (radius * radius - rho * rho).max(0.0).sqrt()
            }
            Shape::BullNose { radius, corner } if rho <= radius => {
                let over = (rho - (radius - corner)).max(0.0);
                corner - (corner * corner - over * over).max(0.0).sqrt()
            }
            Shape::Frustum { z0, r0, .. } if rho <= r0 => z0,
            Shape::Frustum { z0, r0, z1, r1 } if rho <= r1 => {
                z0 + (z1 - z0) * (rho - r0) / (r1 - r0)
            }
            Shape::Platform { z } => z,
            _ => f64::INFINITY,
        }
    }

    /// Lowest height at any radius above `radius`.
    fn lower_surface_beyond(&self, radius: f64) -> f64 {
        // Lower surfaces never fall outward, so the infimum lies just outside the radius.
        self.lower_surface(radius.max(0.0) + 1e-9)
    }

    pub fn max_radius(&self) -> f64 {
        match *self {
            Shape::Ball { radius } | Shape::BullNose { radius, .. } => radius,
            Shape::Frustum { r0, r1, .. } => r0.max(r1),
            Shape::Platform { .. } => f64::INFINITY,
        }
    }

    /// Radius of the shape at height `z`, mm; none where it has nothing.
    pub fn radius_at(&self, z: f64) -> Option<f64> {
        if !(self.bottom()..=self.top()).contains(&z) {
            return None;
        }
        let chord = |r: f64, below: f64| (r * r - below * below).max(0.0).sqrt();
        Some(match *self {
            Shape::Ball { radius } => chord(radius, radius - z),
            Shape::BullNose { radius, corner } => radius - corner + chord(corner, corner - z),
            Shape::Frustum { z0, r0, z1, r1 } => r0 + (r1 - r0) * (z - z0) / (z1 - z0),
            Shape::Platform { .. } => f64::INFINITY,
        })
    }

    /// Lowest height of the shape, mm.
    pub fn bottom(&self) -> f64 {
        match *self {
            Shape::Ball { .. } | Shape::BullNose { .. } => 0.0,
            Shape::Frustum { z0, .. } => z0,
            Shape::Platform { z } => z,
        }
    }

    /// Highest height of the shape, mm.
    pub fn top(&self) -> f64 {
        match *self {
            Shape::Ball { radius } => radius,
            Shape::BullNose { corner, .. } => corner,
            Shape::Frustum { z1, .. } => z1,
            Shape::Platform { .. } => f64::INFINITY,
        }
    }

    pub fn contains(&self, rho: f64, z: f64) -> bool {
        match *self {
            Shape::Frustum { z0, r0, z1, r1 } => {
                (z0..=z1).contains(&z) && rho <= r0 + (r1 - r0) * (z - z0) / (z1 - z0)
            }
            _ => z >= self.lower_surface(rho) && z <= self.top(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ball_mill() -> Tool {
        let cut = |shape| Section { shape, active: true };
        Tool {
            name: "ball".into(),
            kind: ToolKind::Subtractive,
            sections: vec![
                cut(Shape::Ball { radius: 1.5 }),
                cut(Shape::Frustum { z0: 1.5, r0: 1.5, z1: 13.0, r1: 1.5 }),
                Section {
                    shape: Shape::Frustum { z0: 13.0, r0: 25.0, z1: 43.0, r1: 25.0 },
                    active: false,
                },
                Section { shape: Shape::Platform { z: 43.0 }, active: false },
            ],
            process: Process::default(),
            taken: Taken::Always,
        }
    }

    #[test]
    fn a_ball_mill_has_the_surfaces_drawn_on_paper() {
        let t = ball_mill();
        assert_eq!(t.validate(), Ok(()));
        assert_eq!(t.lower_surface(0.0), 0.0);
        assert!((t.lower_surface(1.5) - 1.5).abs() < 1e-12);
        assert_eq!(t.lower_surface(10.0), 13.0);
        assert_eq!(t.lower_surface(26.0), 43.0);
        assert_eq!(t.active_lower_surface(10.0), f64::INFINITY);
        assert_eq!((t.active_radius(), t.active_length(), t.reach(1.5)), (1.5, 13.0, 13.0));
        assert_eq!(t.gauge_mm(), 43.0);
        assert!(t.contains(1.4, 5.0) && !t.contains(1.6, 5.0) && t.contains(100.0, 44.0));
    }

    #[test]
    fn a_widened_tool_is_as_high_so_much_farther_out() {
        let nose = Shape::BullNose { radius: 2.0, corner: 0.5 };
        let mut bull = ball_mill();
        bull.sections[0].shape = nose;
        for tool in [ball_mill(), bull] {
            let wide = tool.widened(0.3);
            for rho in (0..400).map(|i| f64::from(i) * 0.1 + 0.03) {
                let want = tool.lower_surface((rho - 0.3).max(0.0));
                let found = wide.lower_surface(rho);
                assert!(found == want || (found - want).abs() < 1e-9, "{rho}");
                let want = tool.active_lower_surface((rho - 0.3).max(0.0));
                let found = wide.active_lower_surface(rho);
                assert!(found == want || (found - want).abs() < 1e-9, "{rho}");
            }
        }
    }

    #[test]
    fn bad_figures_are_named() {
        let mut t = ball_mill();
        t.sections[1].shape = Shape::Frustum { z0: 5.0, r0: 1.0, z1: 2.0, r1: 1.0 };
        assert!(t.validate().unwrap_err().to_string().contains("section 2"));
        t.sections.iter_mut().for_each(|s| s.active = false);
        t.sections[1].shape = Shape::Platform { z: 2.0 };
        assert!(matches!(t.validate(), Err(InvalidTool::NothingCuts { .. })));
    }
}
