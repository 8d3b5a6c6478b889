use std::fmt;

/// What a program must obey; one name a rule.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Rule {
    /// Every line is ASCII, at most 256 bytes, and made of words with sensible numbers.
    Syntax,
    /// Only known words; units, distance mode, plane and offset are stated before anything moves.
    Modes,
    /// Cutting moves have a feed, within the control's limit; beads the one the extruder needs.
    Feed,
    /// The spindle turns while a cutter moves at feed, and stands otherwise.
    Spindle,
    /// The module is open, and extrusion and retraction are what the move needs.
    Extruder,
    /// One tool change a step, to the step's tool, with its length compensated.
    Tool,
    /// No axis leaves its limits.
    Limits,
    /// Rotary axes turn alone, at the parking height.
    Rotary,
    /// The tool points along the step's direction.
    Direction,
    /// Rapids touch neither the work nor what holds it.
    Rapid,
    /// No cutter enters what must stay deeper than the surface tolerance, no nozzle deeper than a
    /// voxel's diagonal.
    Gouge,
    /// Neither shank nor holder meets what the step itself cuts only later.
    Holder,
    /// Cutting stays over the step's region, beads in it.
    Astray,
    /// No cut takes more than half its width much deeper than a roughing level, or straight down.
    Engagement,
    /// The edge sweeps the region and leaves no lump of it deeper than the surface tolerance;
    /// beads fill it; both as much as the plan says.
    Volume,
    /// The program ends with everything off, and nothing follows.
    End,
}

impl Rule {
    pub fn name(self) -> &'static str {
        match self {
            Rule::Syntax => "syntax",
            Rule::Modes => "modes",
            Rule::Feed => "feed",
            Rule::Spindle => "spindle",
            Rule::Extruder => "extruder",
            Rule::Tool => "tool",
            Rule::Limits => "limits",
            Rule::Rotary => "rotary",
            Rule::Direction => "direction",
            Rule::Rapid => "rapid",
            Rule::Gouge => "gouge",
            Rule::Holder => "holder",
            Rule::Astray => "astray",
            Rule::Engagement => "engagement",
            Rule::Volume => "volume",
            Rule::End => "end",
        }
    }
}

impl fmt::Display for Rule {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// One broken rule.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// Line of the program, from 1.
    pub line: usize,
    pub rule: Rule,
    pub message: String,
}

impl Finding {
    /// A step that does less of its volume than it must.
    pub(super) fn too_little(
        line: usize,
        does: &str,
        share: f64,
        what: &str,
        least: f64,
    ) -> Option<Finding> {
        let percent = |share: f64| 100.0 * share;
        (share < least).then(|| Finding {
            line,
            rule: Rule::Volume,
            message: format!(
                "{does} {:.1} % of {what}, less than {:.0} %",
                percent(share),
                percent(least)
            ),
        })
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "line {}, {}: {}", self.line, self.rule, self.message)
    }
}

/// What the program does in one step, measured on the program alone.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepFigures {
    /// Length at feed with the spindle on, or of beads, mm.
    pub working_mm: f64,
    /// Bead volume: length × rate/feed, mm³.
    pub deposited_mm3: f64,
    /// Volume of the region's voxels that the edge swept, mm³; 0 for additive steps.
    pub removed_mm3: f64,
    /// Volume of the plan's region, mm³.
    pub region_mm3: f64,
    /// Fraction of the region's voxels that the edge swept, or that lie within the infill's
    /// reach of a bead.
    pub coverage: f64,
    /// Time of the step, s: its motion with acceleration, the tool change before it, the turning
    /// of the rotary axes and the waits.
    pub time_s: f64,
}

/// Everything the check found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CheckReport {
    /// In order of lines.
    pub findings: Vec<Finding>,
    /// One a step of the plan.
    pub steps: Vec<StepFigures>,
    pub lines: usize,
}

impl CheckReport {
    /// Whether no rule is broken.
    pub fn passed(&self) -> bool {
        self.findings.is_empty()
    }

    /// Seconds the whole program takes.
    pub fn time_s(&self) -> f64 {
        self.total(|s| s.time_s)
    }

    /// The sum of a figure over all steps; 0 of none, where the sum of no numbers would be −0.
    pub fn total(&self, figure: impl Fn(&StepFigures) -> f64) -> f64 {
        self.steps.iter().map(figure).fold(0.0, |all, one| all + one)
    }
}
