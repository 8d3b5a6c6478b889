use crate::machine::{Extruder, Machine, Pattern, Seam, Shape, Tool};

/// How a cutter is driven. Lengths mm, feeds mm/min.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Milling {
    /// Depth of one roughing level along the axis.
    pub step_down: f64,
    /// Distance between roughing passes.
    pub stepover: f64,
    /// Left by roughing for finishing.
    pub stock: f64,
    /// Height of the ridge a ball end leaves between finishing passes.
    pub scallop: f64,
    pub feed: f64,
    pub plunge_feed: f64,
    /// Down the axis through cleared space.
    pub approach_feed: f64,
}

/// Approaches through cleared space go this many times as fast as the cut and at least at this feed, mm/min: fast
/// enough not to count, slow enough that a mistake of the setup can be stopped by hand.
const APPROACH_FACTOR: f64 = 2.0;
const LEAST_APPROACH: f64 = 2000.0;

/// Height over everything at which the tool goes across, mm. Below a millimetre, errors of clamping would touch;
/// above a few, programs lose time in air.
pub(super) const CLEARANCE_MM: f64 = 2.0;

/// Distance from the work at which an approach ends and the cut begins, mm: from there on it goes as slow as into material.
pub(super) const ENTRY_MM: f64 = 1.0;

impl Milling {
    /// The tool's own figures, capped by what the control allows.
    pub fn of(machine: &Machine, tool: &Tool) -> Milling {
        let (p, control) = (&tool.process, &machine.control);
        let [step_down, stepover] = tool.roughing_steps_mm();
        let feed = control.feed(p);
        Milling {
            step_down,
            stepover,
            stock: p.stock_to_leave_mm,
            scallop: p.scallop_mm,
            feed,
            plunge_feed: control.plunge(p),
            approach_feed: (APPROACH_FACTOR * feed)
                .max(LEAST_APPROACH)
                .min(control.max_feed_mm_min),
        }
    }

    /// Distance between finishing passes: two arcs of the nose radius r leave a ridge of height c
    /// at 2·√(2rc − c²), two cones that rise by m one at 2·c/m; a flat part of the end adds its
    /// half-width.
    pub fn finishing_stepover(&self, tool: &Tool) -> f64 {
        let ridge = |r: f64| 2.0 * (2.0 * r * self.scallop - self.scallop.powi(2)).max(0.0).sqrt();
        let edges = tool.sections.iter().filter(|s| s.active).map(|s| s.shape);
        let nose = edges.filter(|s| s.lower_surface(0.0) == 0.0).map(|s| match s {
            Shape::Ball { radius } => ridge(radius),
            Shape::BullNose { radius, corner } => ridge(corner) + (radius - corner),
            Shape::Frustum { z0, z1, r0, r1 } => {
                r0 + 2.0 * self.scallop * (r1 - r0).max(0.0) / (z1 - z0)
            }
            Shape::Platform { .. } => self.stepover,
        });
        nose.fold(f64::INFINITY, f64::min).min(self.stepover)
    }
}

/// How a nozzle is driven. Lengths mm, feeds mm/min.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Printing {
    pub layer: f64,
    /// Width of one bead.
    pub width: f64,
    /// Contour-parallel beads along every outline.
    pub perimeters: usize,
    /// Fraction of the inner area that infill covers.
    pub infill: f64,
    pub pattern: Pattern,
    /// Layers without gaps under faces that look up or down.
    pub skins: usize,
    pub seam: Seam,
    /// Follows from the extruder's volumetric rate and the bead.
    pub feed: f64,
    pub travel_feed: f64,
    /// Half the width of what is too narrow for a perimeter around it, mm, over that of the bead.
    pub neck: f64,
}

impl Printing {
    pub fn of(machine: &Machine, extruder: &Extruder, tool: &Tool) -> Printing {
        let p = &tool.process;
        Printing {
            layer: p.layer_mm,
            width: p.path_mm,
            perimeters: p.perimeters as usize,
            infill: p.infill,
            pattern: p.pattern,
            skins: p.skins as usize,
            seam: p.seam,
            feed: extruder.feed_mm_min(p),
            travel_feed: machine.control.max_feed_mm_min.min(machine.control.rapid_mm_min),
            neck: 0.0,
        }
    }
}
