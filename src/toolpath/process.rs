use crate::machine::{Shape, Tool};

/// How a cutter is driven. Lengths mm, feeds mm/min.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Milling {
    /// Depth of one roughing level along the axis.
    pub step_down: f64,
    /// Distance between roughing passes.
    pub stepover: f64,
    /// Left by roughing for finishing (W2V Sec. 7.4).
    pub stock: f64,
    /// Height of the ridge a ball end leaves between finishing passes.
    pub scallop: f64,
    pub feed: f64,
    pub plunge_feed: f64,
    /// Down the axis through cleared space.
    pub approach_feed: f64,
    /// Distance at which an approach ends and the cut begins, and over everything when retracted.
    pub clearance: f64,
}

impl Milling {
    /// Figures for a cutter: level half its diameter, stepover 40 % of it. Mild for steel-free
    /// hybrid work (plastics, wax, aluminium); a profile states better ones.
    pub fn for_tool(tool: &Tool) -> Milling {
        let radius = tool.active_radius().max(0.05);
        Milling {
            step_down: radius,
            stepover: 0.8 * radius,
            stock: 0.2,
            scallop: 0.02,
            feed: 800.0,
            plunge_feed: 300.0,
            approach_feed: 1500.0,
            clearance: 2.0,
        }
    }

    /// Distance between finishing passes: two arcs of the nose radius r leave a ridge of height c
    /// at 2·√(2rc − c²); a flat part of the end adds half its width.
    pub fn finishing_stepover(&self, tool: &Tool) -> f64 {
        let ridge = |r: f64| 2.0 * (2.0 * r * self.scallop - self.scallop.powi(2)).max(0.0).sqrt();
        let at_tip = tool.sections.iter().filter(|s| s.active).map(|s| s.shape);
        let nose = at_tip.filter(|s| s.lower_surface(0.0) == 0.0).map(|s| match s {
            Shape::Ball { radius } => ridge(radius),
            Shape::BullNose { radius, corner } => ridge(corner) + (radius - corner),
            Shape::Frustum { r0, .. } => r0,
            Shape::Platform { .. } => self.stepover,
        });
        nose.fold(f64::INFINITY, f64::min).min(self.stepover)
    }
}

/// How a nozzle is driven. Lengths mm, feeds mm/min.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Printing {
    pub layer: f64,
    /// Width of one bead.
    pub width: f64,
    /// Contour-parallel beads along every outline.
    pub perimeters: usize,
    /// Fraction of the inner area that infill covers.
    pub infill: f64,
    /// Volume the extruder delivers, mm³/s: with no E axis the feed follows from it.
    pub rate_mm3_s: f64,
    pub travel_feed: f64,
    pub clearance: f64,
}

impl Printing {
    /// W2V Sec. 7.4: 0.2 mm layers, 0.5 mm paths, 30 % infill.
    pub fn for_tool(_: &Tool) -> Printing {
        Printing {
            layer: 0.2,
            width: 0.5,
            perimeters: 2,
            infill: 0.3,
            rate_mm3_s: 2.5,
            travel_feed: 3000.0,
            clearance: 2.0,
        }
    }

    /// Section of a bead, mm².
    pub fn bead_mm2(&self) -> f64 {
        self.layer * self.width
    }

    /// Feed at which the extruder's volume fills the bead, mm/min.
    pub fn feed(&self) -> f64 {
        self.rate_mm3_s / self.bead_mm2() * 60.0
    }
}
