//! The raw flags, as typed. Nothing is decided here; [`super::config`] does that.

use clap::{Args, Parser, Subcommand, ValueEnum};
use hmplan::machine::Place;
use hmplan::plan::MOST_RULE_MM;
use std::path::PathBuf;

/// Plans hybrid additive-subtractive manufacturing: from a worn part to a target part, every cut
/// and deposit checked.
#[derive(Debug, Parser)]
#[command(name = "hmplan", version, max_term_width = 100, arg_required_else_help = true)]
#[command(after_help = "Exit codes: 0 done and verified · 1 bad usage or input · 2 a plan was \
                        written but does not verify or leaves a residual · 3 I/O or controller \
                        failure · 130 interrupted")]
pub struct Cli {
    #[command(flatten)]
    pub output: OutputArgs,
    #[command(subcommand)]
    pub command: Command,
}

/// How much is said, and how many cores are used; none of it changes a result.
#[derive(Debug, Clone, Args)]
pub struct OutputArgs {
    /// Print the summary as one JSON object on standard output, and nothing else there
    #[arg(long, global = true)]
    pub json: bool,
    /// Say nothing but errors
    #[arg(short, long, global = true, conflicts_with = "verbose")]
    pub quiet: bool,
    /// Log each stage to standard error; -vv logs details
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    pub verbose: u8,
    /// Threads to use [default: one per core]; the result is the same for any number
    #[arg(long, global = true, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
}

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Plan from an initial part to a target part
    Plan(Box<PlanArgs>),
    /// Check a plan and its program, independently of what made them
    Verify(VerifyArgs),
    /// Accessible, inaccessible, collateral and support regions of a part
    Analyze(AnalyzeArgs),
    /// Send a program to a controller
    Stream(StreamArgs),
    /// Machine profiles
    Machine {
        #[command(subcommand)]
        action: ProfileAction,
    },
    /// Tool profiles
    Tool {
        #[command(subcommand)]
        action: ProfileAction,
    },
    /// Print a shell completion script
    Completions { shell: clap_complete::Shell },
    /// Print a JSON Schema
    Schema { of: SchemaOf },
}

/// What options of planner search and nullify are where they are not given.
pub const LAMBDA: f64 = 0.1;
pub const WEIGHT: f64 = 1.0;
pub const DELTA: f64 = 0.01;
pub const MAX_STEPS: u32 = 10;
pub const ROTATIONS: &str = "7";
pub const TOOL_LENGTH: u32 = 10;

#[derive(Debug, Args)]
pub struct PlanArgs {
    /// The initial part and the target part (OBJ, STL, PLY, OFF, 3MF or voxel text .txt); a single part is the
    /// target, planned from an empty base
    #[arg(required = true, num_args = 1..=2, value_name = "INITIAL TARGET")]
    pub parts: Vec<PathBuf>,
    /// Directory to write: plan.json, out.gcode, report.html, states/
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,
    /// Planner [default: reman with two parts, nullify with one]
    #[arg(long, value_enum)]
    pub planner: Option<Planner>,
    /// Search the target's pose in the initial part, or keep the poses of the files; from nothing,
    /// planner search tries the other ways up where the first leaves more than δ allows
    #[arg(long, value_enum, default_value_t = Setup::Search)]
    pub setup: Setup,

    #[command(flatten)]
    pub machine: MachineArgs,
    #[command(flatten)]
    pub units: UnitArgs,
    #[command(flatten)]
    pub rules: RuleArgs,

    /// How planner reman places local clipping planes; the others are there to compare with
    #[arg(long, value_enum, default_value_t = SearchArg::Mcts, help_heading = "Search")]
    pub search: SearchArg,
    /// How planner reman chooses global clipping planes
    #[arg(long, value_enum, default_value_t = SetCoverArg::Ilp, help_heading = "Search")]
    pub set_cover: SetCoverArg,
    /// What the setup search scores: reused volume and printing bases, or one of them alone
    #[arg(long, value_enum, default_value_t = SetupScoreArg::Both, help_heading = "Search")]
    pub setup_score: SetupScoreArg,
    /// Best placements of the setup search that planner reman plans in full; the best plan is kept
    /// [default: one of five, and where its plan keeps less than half of what both parts have in
    /// common or leaves anything, up to two more]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=11))]
    pub setup_candidates: Option<u32>,
    /// Leave the initial part as it lies in its file, or let the setup search lay it on another of
    /// the faces it can rest on, which takes as long again for each of them
    #[arg(long, value_enum, default_value_t = InitialPose::Keep)]
    pub initial_pose: InitialPose,
    /// Rounds of cuts and then deposits of planner reman: what a round leaves gets one more, as
    /// long as that leaves less
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=10))]
    pub rounds: u32,
    /// How far a printing base may be concave and still get no clipping plane of planner reman, mm
    #[arg(long, value_name = "MM", default_value_t = 0.0, value_parser = not_negative)]
    pub base_tolerance: f64,
    /// Let planner reman print an allowance of so many mm that a finishing cut takes off again
    #[arg(long, value_name = "MM", num_args = 0..=1, require_equals = true,
          default_missing_value = "0.5", value_parser = positive)]
    pub finish: Option<f64>,
    /// Whether planner reman prints on supports, to be cut away again, what nothing else carries
    #[arg(long, value_enum, default_value_t = SupportsArg::Auto)]
    pub supports: SupportsArg,
    /// Iterations of the search for local planes
    #[arg(long, default_value_t = 500, value_name = "N",
          value_parser = clap::value_parser!(u32).range(1..=10_000_000), help_heading = "Search")]
    pub iterations: u32,
    /// Stop searching after this many seconds and keep the best plan so far
    #[arg(long, value_name = "SECONDS", value_parser = positive, help_heading = "Search")]
    pub time_limit: Option<f64>,
    /// Seed of every random choice: same input and seed, same plan
    #[arg(long, default_value_t = 0, value_name = "N", help_heading = "Search")]
    pub seed: u64,
    /// What planner search pays for removing a volume, adding it being 1 (λ = c_SM/c_AM)
    #[arg(long, default_value_t = LAMBDA, value_name = "F", value_parser = not_negative, help_heading = "Search")]
    pub lambda: f64,
    /// Cost of one tool of planner search in the same measure; may be repeated
    #[arg(long, value_name = "TOOL=F", value_parser = tool_cost, help_heading = "Search")]
    pub tool_cost: Vec<(String, f64)>,
    /// How much more planner search weighs what is left than what was paid (w); 0 finds the cheapest
    #[arg(long, default_value_t = WEIGHT, value_name = "F", value_parser = not_negative, help_heading = "Search")]
    pub weight: f64,
    /// Fraction of the target by which a plan of planner search may be off (δ)
    #[arg(long, default_value_t = DELTA, value_name = "F", value_parser = share, help_heading = "Search")]
    pub delta: f64,
    /// Most steps of a plan of planner search
    #[arg(long, default_value_t = MAX_STEPS, value_name = "N",
          value_parser = clap::value_parser!(u32).range(1..=1000), help_heading = "Search")]
    pub max_steps: u32,
    /// Relative rotations from step to step of planner search: by a quarter turn at most, or all
    #[arg(long, default_value = ROTATIONS, value_name = "7|24", value_parser = ["7", "24"], help_heading = "Search")]
    pub rotations: String,
    /// Overhang that carries itself in planner search, degrees; below 45 only columns do
    #[arg(long, default_value_t = hmplan::base::tolerance::OVERHANG_DEG, value_name = "DEG",
          value_parser = angle, help_heading = "Search")]
    pub overhang: f64,
    /// Let the lower bound of planner search count what must be sacrificed
    #[arg(long, help_heading = "Search")]
    pub tight_bound: bool,
    /// Write the tree of planner search too, one line a state
    #[arg(long, value_name = "FILE", help_heading = "Search")]
    pub trace: Option<PathBuf>,
    /// What planner nullify ranks its tries within --time-limit by
    #[arg(long, value_enum, default_value_t = ObjectiveArg::Supports, help_heading = "Search")]
    pub objective: ObjectiveArg,
    /// Cutter length of planner nullify in voxels, at least 2
    #[arg(long, default_value_t = TOOL_LENGTH, value_name = "L", help_heading = "Search")]
    pub tool_length: u32,
    /// Write planner nullify's schedule too: AM and SM time of each voxel of its box
    #[arg(long, value_name = "FILE")]
    pub schedule: Option<PathBuf>,
    /// Where the part stands on the table: its base's offset from the table's centre in mm and how it
    /// is turned about z, or auto for where the axes reach most [default: as the machine says]
    #[arg(long, value_name = "auto|X,Y[,DEG]", value_parser = place, allow_hyphen_values = true)]
    pub place: Option<PlaceArg>,
    /// Write out.gcode even when the plan does not verify
    #[arg(long)]
    pub post_unverified: bool,
    /// Write besides out.gcode each step as a program of its own, programs/NN-KIND.gcode
    #[arg(long, value_enum, value_name = "HOW", default_value = "one")]
    pub program: ProgramArg,
    /// Measure what the program leaves on the target's surface or cuts out of it: deviation.ply;
    /// takes about as long as making the paths
    #[arg(long)]
    pub deviation: bool,
}

/// Where the part stands on the table.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PlaceArg {
    Auto,
    At(Place),
}

fn place(text: &str) -> Result<PlaceArg, String> {
    if text == "auto" {
        return Ok(PlaceArg::Auto);
    }
    let figures: Result<Vec<f64>, _> = text.split(',').map(|f| f.trim().parse()).collect();
    match figures.as_deref() {
        Ok([x_mm, y_mm]) => Ok(PlaceArg::At(Place { x_mm: *x_mm, y_mm: *y_mm, angle_deg: 0.0 })),
        Ok([x_mm, y_mm, angle_deg]) => {
            Ok(PlaceArg::At(Place { x_mm: *x_mm, y_mm: *y_mm, angle_deg: *angle_deg }))
        }
        _ => Err("give auto, X,Y or X,Y,DEG".into()),
    }
}

/// How many files a program goes to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ProgramArg {
    /// The whole in out.gcode
    One,
    /// Each step by itself as well
    Steps,
}

#[derive(Debug, Args)]
#[command(next_help_heading = "Machine and tools")]
pub struct MachineArgs {
    /// Machine profile: a name (see `hmplan machine list`) or a TOML file
    #[arg(long, default_value = "generic-5axis", value_name = "NAME|FILE")]
    pub machine: String,
    /// Cutter: a name or a TOML file; may be repeated [default: the machine's]
    #[arg(long, value_name = "NAME|FILE")]
    pub sm_tool: Vec<String>,
    /// Nozzle: a name or a TOML file; may be repeated [default: the machine's]
    #[arg(long, value_name = "NAME|FILE")]
    pub am_tool: Vec<String>,
}

#[derive(Debug, Args)]
#[command(next_help_heading = "Units and axes of the input")]
pub struct UnitArgs {
    /// Unit of both parts
    #[arg(long, value_enum, default_value_t = Unit::Mm)]
    pub unit: Unit,
    /// Factor on the size of both parts
    #[arg(long, default_value_t = 1.0, value_name = "F", value_parser = positive)]
    pub scale: f64,
    /// File axis that points up, of both parts
    #[arg(long, value_enum, default_value_t = Axis::Z, allow_hyphen_values = true)]
    pub up: Axis,
    /// Unit of the initial part
    #[arg(long, value_enum, value_name = "UNIT")]
    pub initial_unit: Option<Unit>,
    /// Factor on the size of the initial part
    #[arg(long, value_name = "F", value_parser = positive)]
    pub initial_scale: Option<f64>,
    /// File axis of the initial part that points up
    #[arg(long, value_enum, value_name = "AXIS", allow_hyphen_values = true)]
    pub initial_up: Option<Axis>,
    /// Unit of the target part
    #[arg(long, value_enum, value_name = "UNIT")]
    pub target_unit: Option<Unit>,
    /// Factor on the size of the target part
    #[arg(long, value_name = "F", value_parser = positive)]
    pub target_scale: Option<f64>,
    /// File axis of the target part that points up
    #[arg(long, value_enum, value_name = "AXIS", allow_hyphen_values = true)]
    pub target_up: Option<Axis>,
}

#[derive(Debug, Args)]
#[command(next_help_heading = "Grid and rules")]
pub struct RuleArgs {
    /// Voxel size in mm [default: about 8 million voxels, at most a third of the smallest tool radius]
    #[arg(long, value_name = "MM", value_parser = positive)]
    pub resolution: Option<f64>,
    /// Unreached material this close to the reused volume is skin [default: max(1.5 voxels, 0.5)]
    #[arg(long, value_name = "MM", value_parser = rule_mm)]
    pub tolerance: Option<f64>,
    /// What carries the part: a pedestal and table that tools must not touch, or nothing
    /// [default: pedestal, none for planner nullify]
    #[arg(long, value_enum)]
    pub base: Option<Base>,
    /// Hold the part on its base throughout, or allow to hold it anew
    #[arg(long, value_enum, default_value_t = HoldingArg::Base)]
    pub holding: HoldingArg,
    /// Height over the base plane that counts as held, mm [default: max(2 voxels, 2)]
    #[arg(long, value_name = "MM", value_parser = rule_mm)]
    pub grip: Option<f64>,
}

#[derive(Debug, Args)]
pub struct VerifyArgs {
    /// Directory that `hmplan plan` wrote
    pub dir: PathBuf,
    /// Check this schedule against the plan's parts as well, operation by operation
    #[arg(long, value_name = "FILE")]
    pub schedule: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub struct AnalyzeArgs {
    /// The part (OBJ, STL, PLY, OFF or 3MF)
    pub part: PathBuf,
    /// Tool: a name (see `hmplan tool list`), a TOML file, or a mesh of its active part in mm, tip
    /// at the origin, axis along +z
    #[arg(long, value_name = "NAME|FILE")]
    pub tool: String,
    /// Mesh of the passive part (shank, holder) of a tool that is a mesh
    #[arg(long, value_name = "FILE")]
    pub tool_passive: Option<PathBuf>,
    /// Direction from the part toward the spindle [default: 0,0,1]
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, conflicts_with = "directions")]
    pub direction: Option<String>,
    /// Look from this many directions, spread evenly over the sphere
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub directions: Option<u32>,
    /// Directory to write: analysis.json, surface.ply
    #[arg(short, long, value_name = "DIR")]
    pub output: Option<PathBuf>,
    /// Voxel size in mm [default: about 8 million voxels, at most a third of the tool's tip radius]
    #[arg(long, value_name = "MM", value_parser = positive)]
    pub resolution: Option<f64>,
    /// Steepest overhang that needs no support, degrees from the vertical, 0 to 60
    #[arg(long, value_name = "DEG", default_value_t = 50.0, value_parser = not_negative)]
    pub overhang: f64,
    /// Unit of the part
    #[arg(long, value_enum, default_value_t = Unit::Mm)]
    pub unit: Unit,
    /// Factor on the size of the part
    #[arg(long, default_value_t = 1.0, value_name = "F", value_parser = positive)]
    pub scale: f64,
    /// File axis that points up
    #[arg(long, value_enum, default_value_t = Axis::Z, allow_hyphen_values = true)]
    pub up: Axis,
}

#[derive(Debug, Args)]
#[command(
    after_help = "Keys while it runs: h hold, r resume, + and - feed override, 0 feed back to \
                        100 %, q stop (as Ctrl-C: hold, then reset; again resets at once). Without \
                        a terminal the words hold, resume and stop are read from standard input."
)]
pub struct StreamArgs {
    /// The program to send
    #[arg(required_unless_present = "list_ports")]
    pub file: Option<PathBuf>,
    /// The controller's port, or sim:DIALECT for a simulated one
    #[arg(long, required_unless_present = "list_ports")]
    pub port: Option<String>,
    /// The extruder's own port, where the machine has it on a second one
    #[arg(long, value_name = "PORT")]
    pub extruder_port: Option<String>,
    /// How the controller talks: grbl, grblhal, marlin, rrf or plain [default: the machine's]
    #[arg(long)]
    pub dialect: Option<String>,
    /// Machine profile: a name or a TOML file [default: the plan's, else generic-5axis]
    #[arg(long, value_name = "NAME|FILE")]
    pub machine: Option<String>,
    /// Speed of both lines, bits per second
    #[arg(long, default_value_t = 115_200, value_name = "BAUD")]
    pub baud: u32,
    /// Send a program that no verified plan vouches for
    #[arg(long)]
    pub unchecked: bool,
    /// Begin only on devices that show damage of every byte, by checksum or echo
    #[arg(long, conflicts_with = "check")]
    pub verified: bool,
    /// Let the controller read the program without moving
    #[arg(long, conflicts_with_all = ["dry_run", "resume"])]
    pub check: bool,
    /// Run in the air: Z raised, no extrusion
    #[arg(long, conflicts_with = "resume")]
    pub dry_run: bool,
    /// How far a dry run is raised, mm
    #[arg(long, default_value_t = 50.0, value_name = "MM", value_parser = positive)]
    pub raise: f64,
    /// Go on with the job that the journal says was stopped
    #[arg(long)]
    pub resume: bool,
    /// Go on at this line of the file
    #[arg(long, value_name = "LINE", requires = "resume")]
    pub from_line: Option<u32>,
    /// The machine is homed, its offsets are as before, spindle and extruder are off
    #[arg(long, requires = "resume")]
    pub position_known: bool,
    /// Go on without asking
    #[arg(long)]
    pub yes: bool,
    /// Where the journal is [default: FILE.journal]
    #[arg(long, value_name = "PATH")]
    pub journal: Option<PathBuf>,
    /// Show the serial ports there are
    #[arg(long)]
    pub list_ports: bool,
}

#[derive(Debug, Subcommand)]
pub enum ProfileAction {
    /// Names of the profiles that come with the program
    List,
    /// What a profile says, in words
    Show { name: String },
    /// Check a profile file
    Check { file: PathBuf },
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum SchemaOf {
    Plan,
    Machine,
    Tool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Planner {
    /// Reuse the initial part, by clipping planes and blocks
    Reman,
    /// Optimal sequences of over- and under-cuts and fills
    Search,
    /// Exact fabrication, voxel by voxel
    Nullify,
    /// Alternating blocks with few changes of process
    Blocks,
}

impl Planner {
    /// As it is asked for.
    pub fn name(self) -> &'static str {
        match self {
            Planner::Reman => "reman",
            Planner::Search => "search",
            Planner::Nullify => "nullify",
            Planner::Blocks => "blocks",
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum SearchArg {
    /// Local planes by Monte Carlo tree search
    Mcts,
    /// Local planes drawn at random
    Random,
    /// Global planes, shifted toward the base until everything is reached
    #[value(name = "topdown")]
    TopDown,
    /// One plane, moved outward as long as everything is reached
    #[value(name = "bottomup")]
    BottomUp,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum SetCoverArg {
    /// Least weight, proven
    Ilp,
    /// Base by base the lightest plane
    Greedy,
    /// One plane for all bases
    Single,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum SupportsArg {
    /// Where less is left with them
    Auto,
    None,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum SetupScoreArg {
    Both,
    Volume,
    Base,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ObjectiveArg {
    Supports,
    Switches,
    Operations,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Setup {
    Search,
    Keep,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum InitialPose {
    Keep,
    Search,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Unit {
    Mm,
    In,
    M,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Axis {
    X,
    Y,
    Z,
    #[value(name = "-x")]
    NegX,
    #[value(name = "-y")]
    NegY,
    #[value(name = "-z")]
    NegZ,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Base {
    Pedestal,
    None,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum HoldingArg {
    Base,
    Refixture,
}

/// A finite number above 0.
fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if v.is_finite() && v > 0.0 => Ok(v),
        _ => Err("give a number above 0".into()),
    }
}

/// A tool's name and a finite number not below 0.
fn tool_cost(text: &str) -> Result<(String, f64), String> {
    let (tool, cost) = text.rsplit_once('=').ok_or("give TOOL=F, as long-cutter=0.2")?;
    Ok((tool.into(), not_negative(cost)?))
}

/// A length of the rules, mm.
fn rule_mm(text: &str) -> Result<f64, String> {
    between(text, MOST_RULE_MM)
}

/// A share of the whole.
fn share(text: &str) -> Result<f64, String> {
    between(text, 1.0)
}

/// An angle from a direction, degrees.
fn angle(text: &str) -> Result<f64, String> {
    between(text, 90.0)
}

/// A number from 0 to `most`.
fn between(text: &str, most: f64) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if (0.0..=most).contains(&v) => Ok(v),
        _ => Err(format!("give a number from 0 to {most}")),
    }
}

/// A finite number not below 0.
fn not_negative(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if v.is_finite() && v >= 0.0 => Ok(v),
        _ => Err("give a number not below 0".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory as _;

    #[test]
    fn the_flags_are_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn negative_axes_need_no_equals_sign() {
        let cli = Cli::try_parse_from(["hmplan", "plan", "a", "b", "-o", "d", "--up", "-y"]);
        match cli.unwrap().command {
            Command::Plan(p) => assert_eq!(p.units.up, Axis::NegY),
            other => panic!("{other:?}"),
        }
    }
}
