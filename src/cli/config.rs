//! From flags to a resolved configuration: everything a plan depends on, checked, before any part
//! is read.

use super::args::{self, Axis, InitialPose, PlanArgs, Planner, Setup, Unit, UnitArgs};
use super::exit::Failure;
use super::profiles;
use hmplan::base::DMat3;
use hmplan::machine::{BaseKind, HoldingMode, Machine, Taken, Tool, ToolKind};
use hmplan::plan::{Command, SearchCommand};
use hmplan::planner::{hybrid, nullify, reman, setup};
use std::path::{Path, PathBuf};

/// Placements that are looked at where no number is asked for (W2V Sec. 5 carries five).
pub const LOOKED_AT: usize = 5;

/// One part as it is to be read.
#[derive(Clone, Debug, PartialEq)]
pub struct PartConfig {
    pub path: PathBuf,
    /// Millimetres of one unit of the file, times the scale.
    pub mm_per_unit: f64,
    /// Turns the file's up axis to +z.
    pub up: Axis,
}

/// Overrides of the rules' defaults, which depend on the grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RuleConfig {
    pub holding: HoldingMode,
    pub base: BaseKind,
    pub tolerance_mm: Option<f64>,
    pub grip_mm: Option<f64>,
}

/// A planning run, resolved.
#[derive(Clone, Debug)]
pub struct PlanConfig {
    /// None: from an empty base.
    pub initial: Option<PartConfig>,
    pub target: PartConfig,
    pub output: PathBuf,
    pub setup: Setup,
    pub machine: Machine,
    pub cutters: Vec<Tool>,
    pub nozzles: Vec<Tool>,
    pub resolution_mm: Option<f64>,
    pub rules: RuleConfig,
    /// What planner reman is told.
    pub reman: reman::Options,
    pub setup_score: setup::Score,
    /// Placements that are planned in full; None: the best, and if its plan keeps little the most
    /// promising of [`LOOKED_AT`].
    pub setup_candidates: Option<usize>,
    /// Whether the initial part may be laid on another of its faces.
    pub initial_pose_search: bool,
    pub time_limit_s: Option<f64>,
    pub seed: u64,
    pub post_unverified: bool,
    /// Whether what the program leaves is measured against the target's surface.
    pub deviation_map: bool,
    /// The part's place on the table is looked for when the part is known.
    pub find_place: bool,
    /// Each step is written as a program of its own as well.
    pub program_steps: bool,
    /// What planner nullify is told; None for the others.
    pub nullify: Option<nullify::Options>,
    /// What planner search is told; None for the others.
    pub search: Option<hybrid::Options>,
    /// Where planner search writes its tree.
    pub trace: Option<PathBuf>,
    pub schedule: Option<PathBuf>,
}

impl PlanConfig {
    /// Whether planner reman is asked.
    pub fn is_reman(&self) -> bool {
        self.nullify.is_none() && self.search.is_none()
    }

    /// What the plan file records of it.
    pub fn command(&self) -> Command {
        Command {
            planner: match (&self.nullify, &self.search) {
                (Some(_), _) => "nullify",
                (None, Some(_)) => "search",
                (None, None) => "reman",
            }
            .into(),
            search: self.search.as_ref().map(|s| SearchCommand {
                lambda: s.lambda,
                weight: s.weight,
                delta: s.delta,
                most_steps: s.most_steps,
                rotations: s.rotations.count(),
                overhang_deg: s.overhang_deg,
                tool_costs: s.tool_costs.clone(),
                tight_bound: s.tight_bound,
            }),
            setup: match self.setup {
                Setup::Search => "search",
                Setup::Keep => "keep",
            }
            .into(),
            resolution_mm: self.resolution_mm,
            iterations: self.reman.iterations,
            time_limit_s: self.time_limit_s,
            post_unverified: self.post_unverified,
            finish_mm: self.reman.finish_mm,
        }
    }
}

/// # Errors
/// A planner this build lacks, a machine or tool that does not load, a tool of the wrong kind.
pub fn resolve(args: &PlanArgs) -> Result<PlanConfig, Failure> {
    let (initial, target, nullified) = match (args.planner, args.parts.as_slice()) {
        (None | Some(Planner::Reman | Planner::Search), [initial, target]) => {
            (Some(initial), target, false)
        }
        (Some(Planner::Search), [target]) => (None, target, false),
        (Some(Planner::Nullify), [initial, target]) => (Some(initial), target, true),
        (None | Some(Planner::Nullify), [target]) => (None, target, true),
        (Some(Planner::Reman), _) => {
            return Err(Failure::input(
                "planner reman reuses an initial part, but a single part was given; give INITIAL \
                 and TARGET",
            ));
        }
        (None | Some(Planner::Nullify | Planner::Search), _) => {
            return Err(Failure::input("give TARGET, or INITIAL and TARGET"));
        }
        (Some(planner), _) => return Err(no_such_planner(planner)),
    };
    of_this_planner(args, nullified)?;
    let mut machine = profiles::find_machine(&args.machine.machine)?;
    if let Some(args::PlaceArg::At(place)) = args.place {
        machine.workholding.place = place;
        let wrong = |e| Failure::input(format!("--place: {e}; give one on the table"));
        machine.workholding.place_on_table().map_err(wrong)?;
    }
    let [cutters, nozzles] = if nullified {
        voxel_tools_only(args)?;
        // As wide as a voxel: made when the pitch is known.
        [Vec::new(), Vec::new()]
    } else {
        [
            tools(&machine, &args.machine.sm_tool, ToolKind::Subtractive)?,
            tools(&machine, &args.machine.am_tool, ToolKind::Additive)?,
        ]
    };
    let (u, resolution) = (&args.units, args.rules.resolution);
    Ok(PlanConfig {
        initial: initial
            .map(|p| part(p, u, (u.initial_unit, u.initial_scale, u.initial_up), resolution))
            .transpose()?,
        target: part(target, u, (u.target_unit, u.target_scale, u.target_up), resolution)?,
        output: args.output.clone(),
        setup: args.setup,
        machine,
        cutters,
        nozzles,
        resolution_mm: args.rules.resolution,
        rules: RuleConfig {
            holding: match args.rules.holding {
                args::HoldingArg::Base => HoldingMode::Base,
                args::HoldingArg::Refixture => HoldingMode::Refixture,
            },
            base: match args.rules.base {
                Some(args::Base::Pedestal) => BaseKind::Pedestal,
                Some(args::Base::None) => BaseKind::None,
                // The half-space of INV's tools would forbid every cut beside a table.
                None if nullified => BaseKind::None,
                None => BaseKind::Pedestal,
            },
            tolerance_mm: args.rules.tolerance,
            grip_mm: args.rules.grip,
        },
        reman: reman::Options {
            iterations: args.iterations as usize,
            rounds: args.rounds as usize,
            base_tolerance_mm: args.base_tolerance,
            finish_mm: args.finish.unwrap_or(0.0),
            supports: args.supports == args::SupportsArg::Auto,
            search: match args.search {
                args::SearchArg::Mcts => reman::Search::Mcts,
                args::SearchArg::Random => reman::Search::Random,
                args::SearchArg::TopDown => reman::Search::TopDown,
                args::SearchArg::BottomUp => reman::Search::BottomUp,
            },
            cover: match args.set_cover {
                args::SetCoverArg::Ilp => reman::CoverMethod::Ilp,
                args::SetCoverArg::Greedy => reman::CoverMethod::Greedy,
                args::SetCoverArg::Single => reman::CoverMethod::Single,
            },
            seed: args.seed,
            ..reman::Options::default()
        },
        setup_score: match args.setup_score {
            args::SetupScoreArg::Both => setup::Score::Both,
            args::SetupScoreArg::Volume => setup::Score::Volume,
            args::SetupScoreArg::Base => setup::Score::Base,
        },
        setup_candidates: candidates(args, nullified)?,
        initial_pose_search: initial_pose_search(args, initial.is_some())?,
        time_limit_s: args.time_limit,
        seed: args.seed,
        post_unverified: args.post_unverified,
        deviation_map: args.deviation,
        find_place: args.place == Some(args::PlaceArg::Auto),
        program_steps: args.program == args::ProgramArg::Steps,
        nullify: nullified.then(|| nullify::Options {
            length: args.tool_length,
            objective: match args.objective {
                args::ObjectiveArg::Supports => nullify::Objective::Supports,
                args::ObjectiveArg::Switches => nullify::Objective::Switches,
                args::ObjectiveArg::Operations => nullify::Objective::Operations,
            },
            support_ahead: args.objective == args::ObjectiveArg::Switches,
            seed: args.seed,
            ..nullify::Options::default()
        }),
        search: search(args)?,
        trace: args.trace.clone(),
        schedule: schedule(args, nullified)?,
    })
}

/// What planner search is told.
///
/// # Errors
/// A tree asked of a planner that has none.
fn search(args: &PlanArgs) -> Result<Option<hybrid::Options>, Failure> {
    if args.planner != Some(Planner::Search) {
        return match &args.trace {
            Some(_) => {
                Err(Failure::input("only planner search has a tree to write; add --planner search"))
            }
            None => Ok(None),
        };
    }
    let usual = hybrid::Options::default();
    Ok(Some(hybrid::Options {
        lambda: args.lambda,
        weight: args.weight,
        delta: args.delta,
        most_steps: args.max_steps as usize,
        rotations: match args.rotations.as_str() {
            "24" => hybrid::Rotations::All,
            _ => hybrid::Rotations::Seven,
        },
        overhang_deg: args.overhang,
        tool_costs: args.tool_cost.clone(),
        tight_bound: args.tight_bound,
        least_share: hybrid::LEAST_SHARE * args.delta,
        patience: usual.patience.filter(|_| args.time_limit.is_none()),
        ..usual
    }))
}

/// # Errors
/// Options of one planner asked of another one, which would pass them over.
fn of_this_planner(args: &PlanArgs, nullified: bool) -> Result<(), Failure> {
    let this = if nullified { Planner::Nullify } else { args.planner.unwrap_or(Planner::Reman) };
    let overhang = hmplan::base::tolerance::OVERHANG_DEG;
    let asked = [
        ("--rounds", Planner::Reman, args.rounds > 1),
        ("--base-tolerance", Planner::Reman, args.base_tolerance > 0.0),
        ("--finish", Planner::Reman, args.finish.is_some()),
        ("--supports", Planner::Reman, args.supports != args::SupportsArg::Auto),
        ("--search", Planner::Reman, args.search != args::SearchArg::Mcts),
        ("--set-cover", Planner::Reman, args.set_cover != args::SetCoverArg::Ilp),
        ("--lambda", Planner::Search, args.lambda != args::LAMBDA),
        ("--tool-cost", Planner::Search, !args.tool_cost.is_empty()),
        ("--weight", Planner::Search, args.weight != args::WEIGHT),
        ("--delta", Planner::Search, args.delta != args::DELTA),
        ("--max-steps", Planner::Search, args.max_steps != args::MAX_STEPS),
        ("--rotations", Planner::Search, args.rotations != args::ROTATIONS),
        ("--overhang", Planner::Search, args.overhang != overhang),
        ("--tight-bound", Planner::Search, args.tight_bound),
        ("--objective", Planner::Nullify, args.objective != args::ObjectiveArg::Supports),
        ("--tool-length", Planner::Nullify, args.tool_length != args::TOOL_LENGTH),
    ];
    match asked.iter().find(|(_, planner, is_asked)| *planner != this && *is_asked) {
        Some((option, planner, _)) => Err(Failure::Input(format!(
            "{option} goes with planner {}; leave it out for the others",
            planner.name()
        ))),
        None => Ok(()),
    }
}

/// # Errors
/// Several placements asked for where none is searched, or of a planner that takes one.
fn candidates(args: &PlanArgs, nullified: bool) -> Result<Option<usize>, Failure> {
    let reman = !nullified && args.planner != Some(Planner::Search);
    match args.setup_candidates {
        None if reman => Ok(None),
        None | Some(1) => Ok(Some(1)),
        _ if !reman => Err(Failure::input(
            "--setup-candidates goes with planner reman; the others choose by themselves",
        )),
        _ if args.setup == Setup::Keep => Err(Failure::input(
            "--setup keep leaves no placement to choose; leave out --setup-candidates",
        )),
        n => Ok(n.map(|n| n as usize)),
    }
}

/// # Errors
/// Another pose of the initial part asked for where there is none to choose.
fn initial_pose_search(args: &PlanArgs, has_initial: bool) -> Result<bool, Failure> {
    match args.initial_pose {
        InitialPose::Keep => Ok(false),
        InitialPose::Search if !has_initial => Err(Failure::input(
            "--initial-pose search goes with an initial part, but only a target was given",
        )),
        InitialPose::Search if args.setup == Setup::Keep => Err(Failure::input(
            "--setup keep keeps both parts where they are; leave out --initial-pose search",
        )),
        InitialPose::Search => Ok(true),
    }
}

/// # Errors
/// A schedule asked of a planner that makes none.
fn schedule(args: &PlanArgs, nullified: bool) -> Result<Option<PathBuf>, Failure> {
    match &args.schedule {
        Some(_) if !nullified => {
            Err(Failure::input("only planner nullify makes a schedule; add --planner nullify"))
        }
        schedule => Ok(schedule.clone()),
    }
}

/// Planner nullify takes INV's tools alone.
fn voxel_tools_only(args: &PlanArgs) -> Result<(), Failure> {
    let named = args.machine.sm_tool.iter().chain(&args.machine.am_tool);
    match named.into_iter().find(|n| !Tool::is_voxel_sized(n)) {
        None => Ok(()),
        Some(name) => Err(Failure::Input(format!(
            "planner nullify plans for inv-cutter and inv-nozzle, not '{name}'; leave the tool out \
             and set --tool-length"
        ))),
    }
}

fn no_such_planner(planner: Planner) -> Failure {
    Failure::Input(format!(
        "planner {} is not in version {}; use --planner reman, search or nullify",
        planner.name(),
        env!("CARGO_PKG_VERSION")
    ))
}

fn part(
    path: &Path,
    both: &UnitArgs,
    (unit, scale, up): (Option<Unit>, Option<f64>, Option<Axis>),
    resolution: Option<f64>,
) -> Result<PartConfig, Failure> {
    if super::inputs::is_voxel_text(path) {
        let Some(pitch) = resolution else {
            return Err(Failure::Input(format!(
                "{}: voxel text has no size of its own; give the voxel size with --resolution",
                path.display()
            )));
        };
        let up = up.unwrap_or(both.up);
        return Ok(PartConfig { path: path.to_path_buf(), mm_per_unit: pitch, up });
    }
    let mm = unit.unwrap_or(both.unit).mm();
    Ok(PartConfig {
        path: path.to_path_buf(),
        mm_per_unit: mm * scale.unwrap_or(both.scale),
        up: up.unwrap_or(both.up),
    })
}

/// The named tools, or all of the machine's of that kind, in the order in which they are tried.
fn tools(machine: &Machine, names: &[String], kind: ToolKind) -> Result<Vec<Tool>, Failure> {
    let (word, flag) = match kind {
        ToolKind::Subtractive => ("cutter", "--sm-tool"),
        ToolKind::Additive => ("nozzle", "--am-tool"),
    };
    let tools: Vec<Tool> = if names.is_empty() {
        machine.tools_of(kind).into_iter().cloned().collect()
    } else {
        // A tool that is asked for by name takes part.
        let named =
            |n: &String| Ok(Tool { taken: Taken::Always, ..profiles::find_tool(machine, n)? });
        names.iter().map(named).collect::<Result<_, Failure>>()?
    };
    if tools.is_empty() {
        return Err(Failure::Input(format!(
            "machine '{}' has no {word}; name one with {flag}",
            machine.name
        )));
    }
    for (i, tool) in tools.iter().enumerate() {
        if tool.kind != kind {
            return Err(Failure::Input(format!(
                "{flag} {}: that tool is no {word}; see `hmplan tool list`",
                tool.name
            )));
        }
        if Tool::is_voxel_sized(&tool.name) {
            return Err(Failure::Input(format!(
                "{flag} {}: that tool is one voxel wide; it goes with --planner nullify",
                tool.name
            )));
        }
        if tools[..i].iter().any(|t| t.name == tool.name) {
            return Err(Failure::Input(format!("{flag} names '{}' twice", tool.name)));
        }
    }
    Ok(tools)
}

impl Unit {
    /// Millimetres of one unit.
    pub fn mm(self) -> f64 {
        match self {
            Unit::Mm => 1.0,
            Unit::In => 25.4,
            Unit::M => 1000.0,
        }
    }
}

impl Axis {
    /// The rotation that turns this axis to +z, exact.
    pub fn to_z(self) -> DMat3 {
        use hmplan::base::DVec3 as V;
        // Rows of each rotation, written as columns of its transpose.
        let rows = match self {
            Axis::Z => [V::X, V::Y, V::Z],
            Axis::NegZ => [V::X, V::NEG_Y, V::NEG_Z],
            Axis::X => [V::Y, V::Z, V::X],
            Axis::NegX => [V::NEG_Y, V::Z, V::NEG_X],
            Axis::Y => [V::X, V::NEG_Z, V::Y],
            Axis::NegY => [V::X, V::Z, V::NEG_Y],
        };
        DMat3::from_cols(rows[0], rows[1], rows[2]).transpose()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use hmplan::base::DVec3;

    #[test]
    fn every_axis_turns_to_z_without_mirroring() {
        for (axis, v) in [
            (Axis::X, DVec3::X),
            (Axis::Y, DVec3::Y),
            (Axis::Z, DVec3::Z),
            (Axis::NegX, DVec3::NEG_X),
            (Axis::NegY, DVec3::NEG_Y),
            (Axis::NegZ, DVec3::NEG_Z),
        ] {
            let m = axis.to_z();
            assert_eq!(m * v, DVec3::Z, "{axis:?}");
            assert_eq!(m.determinant(), 1.0, "{axis:?}");
        }
    }

    #[test]
    fn flags_for_one_part_win_over_flags_for_both() {
        use clap::Parser as _;
        let cli = args::Cli::try_parse_from([
            "hmplan",
            "plan",
            "a",
            "b",
            "-o",
            "d",
            "--unit",
            "in",
            "--scale",
            "2",
            "--target-unit",
            "m",
        ]);
        let args::Command::Plan(args) = cli.unwrap().command else { panic!("a plan") };
        let u = &args.units;
        let a =
            part(Path::new("a"), u, (u.initial_unit, u.initial_scale, u.initial_up), None).unwrap();
        let b =
            part(Path::new("b"), u, (u.target_unit, u.target_scale, u.target_up), None).unwrap();
        assert_eq!((a.mm_per_unit, b.mm_per_unit), (50.8, 2000.0));
    }
}
