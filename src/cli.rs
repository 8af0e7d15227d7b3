//! The command line, as clap reads it.

mod examples;

use std::ffi::OsStr;
use std::path::PathBuf;

use clap::builder::{PossibleValue, TypedValueParser};
use clap::error::ErrorKind;
use clap::{Arg, Args, CommandFactory, Parser, Subcommand, ValueEnum};
use rangehound_shared::rendezvous::{Role, RunName};
use rangehound_shared::scenario::{PLANNERS, PatienceKey};

use crate::latency::reference::Reference;
use crate::pin::Pin;
use crate::supervisor::restart::Rule;
use crate::terminal;
use rangehound_fusion::run::STANDBYS_MAX;

/// A team of robots tracks a moving target by ranges alone: one process per robot, a fusion centre
/// that filters and plans, a simulator, all talking over shared memory.
///
/// Without a command it runs the paper's experiment (as `rangehound run`).
#[derive(Debug, Parser)]
#[command(name = "rangehound", version, max_term_width = terminal::WIDTH, after_help = examples::ALL)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Option<Command>,
}

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Start simulator, fusion centre and robots, watch them, report
    Run(RunArgs),
    /// Run the simulator alone; it founds the run that others join by --name
    Sim(SimArgs),
    /// Run the fusion centre alone
    Fusion(FusionArgs),
    /// Run one robot alone
    Robot(RobotArgs),
    /// Show the progress of a run started by hand, and report when it ends
    Watch(WatchArgs),
    /// Show a run on a page in the browser, with buttons to kill its processes and watch it go on
    Live(LiveArgs),
    /// Plan one step for each JSON line, for programs of any language
    Plan(PlanArgs),
    /// Write a run into one file, run.mcap, while it goes on or after it; `run` and `track` start this by themselves
    Record(RecordArgs),
    /// Feed a recording's ranges to a fresh fusion: are all estimates the same to the bit, what would be different?
    Replay(ReplayArgs),
    /// Go on from its checkpoints with a run all of whose processes are gone
    Resume(ResumeArgs),
    /// Show a run: where it is, and who is running, stopped, hung or gone
    Status(StatusArgs),
    /// Kill a node as a crash would: its run starts it again
    Kill(RemoteNodeArgs),
    /// End a node of a run in order and wait for its successor
    Restart(RemoteNodeArgs),
    /// End a run in order, as Ctrl-C in its terminal would
    Stop(RemoteArgs),
    /// Kill and stop nodes of its own runs at random, and judge the outcome
    Chaos(ChaosArgs),
    /// Measure the time from range to heading, beside the bare transport
    Latency(LatencyArgs),
    /// One node of a reference that `latency` measures
    #[command(hide = true)]
    LatencyNode(LatencyNodeArgs),
    /// Print the default scenario file, to start your own from
    Scenario,
    /// Track recorded ranges, one robot process for each sensor
    Track(TrackArgs),
    /// Compare the planners over many runs: tables and pictures
    Compare(CompareArgs),
    /// Print the script by which a shell completes commands and flags
    Completions(CompletionsArgs),
    /// Print the names that a shell completes, one a line
    #[command(hide = true)]
    Names(NamesArgs),
    /// Print the manual page, or write one for each command to a folder
    Man(ManArgs),
}

/// The command line with all that `--help` tells.
#[must_use]
pub fn command() -> clap::Command {
    examples::add(Cli::command())
}

/// `run`.
#[derive(Debug, Default, Args)]
pub struct RunArgs {
    /// The experiment, as a whole
    #[command(flatten)]
    pub experiment: ExperimentArgs,
    /// Take all steps in this one process, without shared memory: same estimates, same digest
    #[arg(long, conflicts_with = "live")]
    pub in_process: bool,
    /// Who is started, and started again
    #[command(flatten)]
    pub supervision: SupervisionArgs,
    /// Also write ranges.csv and truth.csv to the run folder: a recording that `rangehound track` reads
    #[arg(long)]
    pub write_recording: bool,
    /// Print the report as one line of JSON, with the keys of report.json
    #[arg(long)]
    pub json: bool,
    /// Whether it is recorded
    #[command(flatten)]
    pub recording: RecordingArgs,
    /// Who to end with
    #[command(flatten)]
    pub parent: ParentArgs,
}

/// `replay`.
#[derive(Debug, Args)]
pub struct ReplayArgs {
    /// The recording: run.mcap of a run folder
    pub file: PathBuf,
    /// Another planner: what would it have told the robots, where they were?
    #[arg(long, value_name = "NAME", value_parser = PlannerName)]
    pub planner: Option<String>,
    /// Another gate, in standard deviations of an innovation
    #[arg(long, value_name = "SIGMA", value_parser = number, allow_negative_numbers = true)]
    pub gate: Option<f64>,
    /// Another spectral density of the target's noise, such as of its acceleration, m^2/s^3
    #[arg(long, value_name = "Q", value_parser = number, allow_negative_numbers = true)]
    pub accel_psd: Option<f64>,
    /// Print one line of JSON
    #[arg(long)]
    pub json: bool,
    /// Whether it is shown, after it was compared
    #[command(flatten)]
    pub show: ShowArgs,
    /// Seconds of the run in a second on the page
    #[arg(long, value_name = "X", requires = "live", value_parser = speed, allow_negative_numbers = true, default_value_t = 1.0)]
    pub speed: f64,
    /// Make a whole file of one that was cut short or damaged, with all ticks up to there
    #[arg(long, conflicts_with_all = ["planner", "gate", "accel_psd", "live"])]
    pub repair: bool,
    /// The whole file [default: FILE without .partial, or with .repaired before .mcap]
    #[arg(long, value_name = "FILE", requires = "repair")]
    pub out: Option<PathBuf>,
}

/// Whether a run is recorded.
#[derive(Debug, Default, Args)]
pub struct RecordingArgs {
    /// Write run.mcap to the run folder, which viewers and `rangehound replay` open: on unless --no-record is given
    #[arg(long, overrides_with = "no_record")]
    pub record: bool,
    /// Do not write run.mcap
    #[arg(long, overrides_with = "record")]
    pub no_record: bool,
    /// How large it may become
    #[command(flatten)]
    pub limit: RecordLimitArgs,
}

/// How large a recording may become.
#[derive(Debug, Clone, Copy, Args)]
pub struct RecordLimitArgs {
    /// End the recording, not the run, when it has so many megabytes
    #[arg(long = "record-limit", value_name = "MB", value_parser = megabytes, allow_negative_numbers = true, default_value_t = RECORD_LIMIT_MB)]
    pub limit_mb: u64,
}

/// Enough for hours of the paper's experiment.
const RECORD_LIMIT_MB: u64 = 1_000;

impl Default for RecordLimitArgs {
    fn default() -> Self {
        Self { limit_mb: RECORD_LIMIT_MB }
    }
}

impl RecordLimitArgs {
    /// The same in bytes.
    #[must_use]
    pub fn bytes(self) -> u64 {
        self.limit_mb.saturating_mul(1_000_000)
    }
}

/// `record`.
#[derive(Debug, Args)]
pub struct RecordArgs {
    /// Folder of a run that is over [default: the run of --name, while it goes on]
    #[arg(value_name = "DIR", conflicts_with = "name")]
    pub folder: Option<PathBuf>,
    /// The run, while it goes on
    #[command(flatten)]
    pub node: NodeArgs,
    /// The file [default: run.mcap in the run folder]
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// How large it may become
    #[command(flatten)]
    pub limit: RecordLimitArgs,
    /// Print what has been recorded as one line of JSON
    #[arg(long)]
    pub json: bool,
}

/// What is run, under which name, and where its folder is.
#[derive(Debug, Default, Args)]
pub struct ExperimentArgs {
    /// Scenario file [default: the paper's experiment, see `rangehound scenario`]
    pub scenario: Option<PathBuf>,
    /// Number of robots, all alike
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub robots: Option<u64>,
    /// Number of time steps
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub ticks: Option<u64>,
    /// Seed of all random numbers
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub seed: Option<u64>,
    /// What starts the next tick: wall time, or all answers
    #[arg(long)]
    pub clock: Option<ClockArg>,
    /// How headings are chosen
    #[arg(long, value_name = "NAME", value_parser = PlannerName)]
    pub planner: Option<String>,
    /// Least distance of the robots to the predicted target, m
    #[arg(long, value_name = "M", value_parser = number, allow_negative_numbers = true)]
    pub stand_off: Option<f64>,
    /// Silence after which lock step goes on without a robot, and a silent process is killed and started again: seconds or
    /// "forever"
    #[arg(long, value_name = "SECONDS", value_parser = patience, allow_negative_numbers = true)]
    pub patience: Option<PatienceKey>,
    /// Name of the run: nodes find each other by it [default: the scenario's name, numbered if taken]
    #[arg(long)]
    pub name: Option<RunName>,
    /// Run folder: report, tables, logs [default: runs/NAME]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

/// What starts the next tick.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum ClockArg {
    /// Every dt of wall time, whatever is missing
    Realtime,
    /// As soon as all have answered
    Lockstep,
}

/// `sim`.
#[derive(Debug, Args)]
pub struct SimArgs {
    /// The experiment, if this process founds the run
    #[command(flatten)]
    pub experiment: ExperimentArgs,
    /// Who to end with
    #[command(flatten)]
    pub parent: ParentArgs,
}

/// `fusion`.
#[derive(Debug, Args)]
pub struct FusionArgs {
    /// Which run
    #[command(flatten)]
    pub node: NodeArgs,
    /// Stand by: follow the run, and lead as soon as nobody does or who leads hangs
    #[arg(long)]
    pub standby: bool,
}

/// `watch`.
#[derive(Debug, Args)]
pub struct WatchArgs {
    /// Which run
    #[command(flatten)]
    pub node: NodeArgs,
    /// Print the report as one line of JSON, with the keys of report.json
    #[arg(long)]
    pub json: bool,
}

/// What the nodes and who watches them have in common.
#[derive(Debug, Args)]
pub struct NodeArgs {
    /// Name of the run to join; waits for it to be founded
    #[arg(long, default_value = rangehound_shared::scenario::defaults::NAME)]
    pub name: RunName,
    /// Who to end with
    #[command(flatten)]
    pub parent: ParentArgs,
}

/// `live`.
#[derive(Debug, Args)]
pub struct LiveArgs {
    /// The run
    #[command(flatten)]
    pub node: NodeArgs,
    /// Port on 127.0.0.1 [default: any that is free]
    #[arg(long, value_name = "PORT", value_parser = port, allow_negative_numbers = true)]
    pub port: Option<u16>,
    /// Print the address as one line of JSON
    #[arg(long)]
    pub json: bool,
}

/// Whether a run is shown.
#[derive(Debug, Default, Args)]
pub struct ShowArgs {
    /// Show it on a page in the browser, as `rangehound live` does; --live=PORT to choose the port
    #[arg(long, value_name = "PORT", num_args = 0..=1, require_equals = true, value_parser = port)]
    pub live: Option<Option<u16>>,
}

/// What a supervisor starts, and starts again.
#[derive(Debug, Default, Args)]
pub struct SupervisionArgs {
    /// Fusion processes that stand by to take over from the one that leads
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = standbys)]
    pub standby: usize,
    /// Start nodes again that have ended: always, on-failure or never; sim=POLICY, fusion=POLICY or robot=POLICY for one
    /// kind, repeatable [default: always]
    #[arg(long = "restart", value_name = "[KIND=]POLICY")]
    pub rules: Vec<Rule>,
    /// Processors for all processes of the run: none (any), one-core, or their numbers as in 0,1
    #[arg(long, value_name = "CPUS", default_value_t)]
    pub pin: Pin,
    /// Who looks on
    #[command(flatten)]
    pub show: ShowArgs,
}

/// `resume`.
#[derive(Debug, Args)]
pub struct ResumeArgs {
    /// Folder of the run
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
    /// Name of the run [default: the scenario's]
    #[arg(long)]
    pub name: Option<RunName>,
    /// Who is started, and started again
    #[command(flatten)]
    pub supervision: SupervisionArgs,
    /// Print the report as one line of JSON, with the keys of report.json
    #[arg(long)]
    pub json: bool,
    /// Whether it is recorded
    #[command(flatten)]
    pub recording: RecordingArgs,
}

/// A run to act on from another terminal.
#[derive(Debug, Args)]
pub struct RemoteArgs {
    /// Name of the run [default: the only one that goes on]
    #[arg(long)]
    pub name: Option<RunName>,
    /// Print one line of JSON
    #[arg(long)]
    pub json: bool,
}

/// `status`.
#[derive(Debug, Args)]
pub struct StatusArgs {
    /// The run
    #[command(flatten)]
    pub run: RemoteArgs,
    /// Show robots one by one, however many are well
    #[arg(long)]
    pub all: bool,
    /// Show it again every second, until the run ends or Ctrl-C
    #[arg(long)]
    pub watch: bool,
}

/// `kill` and `restart`.
#[derive(Debug, Args)]
pub struct RemoteNodeArgs {
    /// sim, fusion or robot-N
    pub node: Role,
    /// The run
    #[command(flatten)]
    pub run: RemoteArgs,
}

/// `chaos`.
#[derive(Debug, Args)]
pub struct ChaosArgs {
    /// The experiment; in lock step, the default here, with endless patience
    #[command(flatten)]
    pub experiment: ExperimentArgs,
    /// Number of faults; a run that ends before them is followed by one of the next seed
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true, default_value_t = 50)]
    pub faults: u64,
    /// Kinds of faults, separated by commas
    #[arg(long, value_name = "KINDS", value_delimiter = ',', default_value = "all")]
    pub kinds: Vec<KindArg>,
    /// Who is hurt: sim, fusion (whoever leads), robot, standby, separated by commas
    #[arg(long, value_name = "ROLES", value_delimiter = ',', default_value = "sim,fusion,robot")]
    pub roles: Vec<RoleArg>,
    /// Fusion processes that stand by in the runs
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = standbys)]
    pub standby: usize,
    /// Longest stop, s
    #[arg(long, value_name = "SECONDS", value_parser = number, allow_negative_numbers = true, default_value_t = 0.5)]
    pub longest_stop: f64,
    /// Faults a second in the mean; the gaps are exponential
    #[arg(long, value_name = "PER_S", value_parser = number, allow_negative_numbers = true, default_value_t = 10.0)]
    pub rate: f64,
    /// Seed of the faults
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true, default_value_t = 1)]
    pub chaos_seed: u64,
    /// Print the outcome as one line of JSON, with the keys of chaos.json
    #[arg(long)]
    pub json: bool,
}

/// A kind of fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum KindArg {
    /// One node is killed
    Kill,
    /// One node is stopped for 10 ms up to the longest stop
    Stop,
    /// One node is killed, and its successors as soon as they have its role, 3 to 5 times
    Storm,
    /// Two or more nodes are killed at once
    Several,
    /// Everything is killed at once, whatever the roles, and the supervisor too; then the run is resumed
    Blackout,
    /// All of these; without blackout if not sim, fusion and robot are to be hurt
    All,
}

/// A kind of node.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum RoleArg {
    /// The simulator
    Sim,
    /// The fusion centre
    Fusion,
    /// Any robot
    Robot,
    /// Any fusion that stands by
    Standby,
}

/// `robot`.
#[derive(Debug, Args)]
pub struct RobotArgs {
    /// Which robot of the team, counted from 0
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub id: u64,
    /// The run
    #[command(flatten)]
    pub node: NodeArgs,
}

/// Set by `run` for the nodes that it starts, and by `latency` for what it measures.
#[derive(Debug, Default, Args)]
pub struct ParentArgs {
    /// End when this process, the parent, ends
    #[arg(long, value_name = "PID", hide = true)]
    pub end_with: Option<u32>,
}

/// `track`.
#[derive(Debug, Args)]
pub struct TrackArgs {
    /// Recorded ranges: CSV with time_s,sensor_id,sensor_x_m,sensor_y_m,range_m
    pub ranges: PathBuf,
    /// Standard deviation of a range, m
    #[arg(long, value_name = "M", value_parser = number, allow_negative_numbers = true)]
    pub range_std: Option<f64>,
    /// Spectral density of the target's acceleration, m^2/s^3
    #[arg(long, value_name = "Q", value_parser = number, allow_negative_numbers = true)]
    pub accel_psd: Option<f64>,
    /// Bias B in `measured = (1+S) true + B`, m; SENSOR=B for one sensor, repeatable
    #[arg(long, value_name = "[SENSOR=]B", allow_hyphen_values = true)]
    pub range_bias: Vec<PerSensor>,
    /// Scale error S in `measured = (1+S) true + B`; SENSOR=S for one sensor, repeatable
    #[arg(long, value_name = "[SENSOR=]S", allow_hyphen_values = true)]
    pub range_scale: Vec<PerSensor>,
    /// Reject a range whose innovation is more than this many standard deviations
    #[arg(long, value_name = "SIGMA", value_parser = number, allow_negative_numbers = true)]
    pub gate: Option<f64>,
    /// Who is started, and started again
    #[command(flatten)]
    pub supervision: SupervisionArgs,
    /// True track to compare with: CSV with time_s,x_m,y_m; never seen by the tracker
    #[arg(long, value_name = "FILE")]
    pub truth: Option<PathBuf>,
    /// Take all steps in this one process, without shared memory
    #[arg(long, conflicts_with = "live")]
    pub in_process: bool,
    /// Whether it is recorded
    #[command(flatten)]
    pub recording: RecordingArgs,
    /// Name of the run [default: after the file, numbered if taken]
    #[arg(long)]
    pub name: Option<RunName>,
    /// Run folder: estimate.csv, report, logs [default: runs/NAME]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print the report as one line of JSON, with the keys of report.json
    #[arg(long)]
    pub json: bool,
}

/// `plan`.
#[derive(Debug, Default, Args)]
pub struct PlanArgs {
    /// Problems, one JSON object a line; - or nothing for standard input
    pub file: Option<PathBuf>,
    /// Planner of the lines that name none [default: certified]
    #[arg(long, value_name = "NAME", value_parser = PlannerName)]
    pub planner: Option<String>,
    /// Node budget of the certified planner
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub nodes: Option<u64>,
    /// Iterations of the relaxations
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub iterations: Option<u64>,
    /// Relaxation factor of the adaptive relaxation, 0 to 1
    #[arg(long, value_name = "A", value_parser = number, allow_negative_numbers = true)]
    pub alpha: Option<f64>,
    /// Step of the grid search on the bearing, rad
    #[arg(long, value_name = "RAD", value_parser = number, allow_negative_numbers = true)]
    pub step_rad: Option<f64>,
    /// Seed of the random planner, whose headings depend on it and on the line's number
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub seed: Option<u64>,
}

/// `compare`.
#[derive(Debug, Args)]
pub struct CompareArgs {
    /// Scenario file [default: the paper's experiment, see `rangehound scenario`]
    pub scenario: Option<PathBuf>,
    /// The same scenario file, as a flag
    #[arg(long = "scenario", value_name = "FILE", conflicts_with = "scenario")]
    pub scenario_flag: Option<PathBuf>,
    /// Planners to compare, separated by commas
    #[arg(
        long,
        value_name = "NAMES",
        value_delimiter = ',',
        value_parser = PlannerName,
        default_value = "certified,adaptive,standard,greedy,pursue,random"
    )]
    pub planners: Vec<String>,
    /// Runs of each planner; run i has the same target, noise and prior for all planners
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true, default_value_t = 1_000)]
    pub runs: u64,
    /// Time steps of a run
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true, default_value_t = 300)]
    pub ticks: u64,
    /// Seed of the first run; each next run has the next seed [default: the scenario's]
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub seed: Option<u64>,
    /// Number of robots, all alike [default: the scenario's]
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub robots: Option<u64>,
    /// Least distance that robots keep to where the target is predicted, m; 0 as in the paper
    /// [default: the scenario's]
    #[arg(long, value_name = "M", value_parser = number, allow_negative_numbers = true)]
    pub stand_off: Option<f64>,
    /// Threads to run on; no figure but the timings depends on it [default: one for each core]
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub threads: Option<u64>,
    /// Folder for compare.json and the pictures; what it holds of an earlier comparison is replaced
    #[arg(long, value_name = "DIR", default_value = "runs/compare")]
    pub out: PathBuf,
    /// Print the figures as one line of JSON, with the keys of compare.json
    #[arg(long)]
    pub json: bool,
}

/// `latency`.
#[derive(Debug, Args)]
pub struct LatencyArgs {
    /// Scenario file [default: the paper's experiment, see `rangehound scenario`]
    pub scenario: Option<PathBuf>,
    /// Number of robots, all alike [default: the scenario's]
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub robots: Option<u64>,
    /// Time steps of each round [default: 5000 in lock step, 10 s in real time]
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub ticks: Option<u64>,
    /// What starts the next tick: wall time, or all answers [default: lockstep, realtime if a rate is given]
    #[arg(long)]
    pub clock: Option<ClockArg>,
    /// Ticks a second in real time [default: the scenario's]
    #[arg(long, value_name = "HZ", value_parser = number, allow_negative_numbers = true)]
    pub rate: Option<f64>,
    /// How headings are chosen [default: the scenario's]
    #[arg(long, value_name = "NAME", value_parser = PlannerName)]
    pub planner: Option<String>,
    /// Processors for all processes: none (any), one-core, or their numbers as in 0,1
    #[arg(long, value_name = "CPUS", default_value_t)]
    pub pin: Pin,
    /// How often each is measured, in turns
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true, default_value_t = 5)]
    pub rounds: u64,
    /// Name of the runs [default: latency, numbered if taken]
    #[arg(long)]
    pub name: Option<RunName>,
    /// Folder for latency.json, latency.svg and the folders of the system's runs; those of an earlier call are replaced
    #[arg(long, value_name = "DIR", default_value = "runs/latency")]
    pub out: PathBuf,
    /// Print the figures as one line of JSON, with the keys of latency.json
    #[arg(long)]
    pub json: bool,
}

/// `completions`.
#[derive(Debug, Args)]
pub struct CompletionsArgs {
    /// The shell
    pub shell: clap_complete::Shell,
}

/// `names`.
#[derive(Debug, Args)]
pub struct NamesArgs {
    /// Of what
    pub of: NamesOf,
}

/// What has names that only the moment knows.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum NamesOf {
    /// Runs that go on
    Runs,
    /// Nodes of any of them
    Nodes,
}

/// `man`.
#[derive(Debug, Args)]
pub struct ManArgs {
    /// Folder for the pages of all commands [default: that of rangehound, to a pipe or file]
    #[arg(value_name = "DIR")]
    pub folder: Option<PathBuf>,
}

/// `latency-node`.
#[derive(Debug, Args)]
pub struct LatencyNodeArgs {
    /// How it talks
    #[arg(long)]
    pub reference: Reference,
    /// fusion, who is the centre, or robot-N
    #[arg(long)]
    pub role: Role,
    /// The run
    #[command(flatten)]
    pub node: NodeArgs,
}

/// What each planner does, in the order of [`PLANNERS`].
const PLANNERS_DO: [&str; PLANNERS.len()] = [
    "The global optimum of each step, with a proof",
    "The paper's adaptive relaxation",
    "Standard relaxation",
    "Exhaustive search, for up to 4 robots",
    "Each robot by itself",
    "Straight to the predicted target",
    "Random headings",
];

/// Completes the names of planners, but takes any: who plans says what is wrong with it.
#[derive(Debug, Clone, Copy)]
struct PlannerName;

impl TypedValueParser for PlannerName {
    type Value = String;

    fn parse_ref(&self, command: &clap::Command, _: Option<&Arg>, value: &OsStr) -> Result<String, clap::Error> {
        let refused = || clap::Error::new(ErrorKind::InvalidUtf8).with_cmd(command);
        value.to_str().map(|name| name.trim().to_owned()).ok_or_else(refused)
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        let planners = PLANNERS.into_iter().zip(PLANNERS_DO);
        Some(Box::new(planners.map(|(name, does)| PossibleValue::new(name).help(does))))
    }
}

/// A value for all sensors, or for one: `0.1` or `105=0.1`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PerSensor {
    /// The sensor, if not all.
    pub sensor: Option<u64>,
    /// The value.
    pub value: f64,
}

impl std::str::FromStr for PerSensor {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = || "expected a number or SENSOR=NUMBER".to_owned();
        let (sensor, value) = match text.split_once('=') {
            Some((sensor, value)) => (Some(sensor.parse().map_err(|_| expected())?), value),
            None => (None, text),
        };
        Ok(Self { sensor, value: value.parse().map_err(|_| expected())? })
    }
}

fn whole(text: &str) -> Result<u64, String> {
    text.parse().map_err(|_| "expected a whole number from 0".to_owned())
}

fn port(text: &str) -> Result<u16, String> {
    text.parse().map_err(|_| "expected a port from 1 to 65535, or 0 for any that is free".to_owned())
}

fn standbys(text: &str) -> Result<usize, String> {
    let expected = || format!("expected a whole number from 0 to {STANDBYS_MAX}");
    text.parse().ok().filter(|count| *count <= STANDBYS_MAX).ok_or_else(expected)
}

fn number(text: &str) -> Result<f64, String> {
    text.parse().map_err(|_| "expected a number".to_owned())
}

fn megabytes(text: &str) -> Result<u64, String> {
    text.parse().ok().filter(|megabytes| *megabytes > 0).ok_or_else(|| "expected a whole number from 1".to_owned())
}

fn speed(text: &str) -> Result<f64, String> {
    let speed = text.parse().ok().filter(|speed| (1e-3..=1e6).contains(speed));
    speed.ok_or_else(|| "expected a number from 0.001 to 1e6".to_owned())
}

fn patience(text: &str) -> Result<PatienceKey, String> {
    Ok(match text.parse() {
        Ok(seconds) => PatienceKey::Seconds(seconds),
        Err(_) => PatienceKey::Word(text.to_owned()),
    })
}

/// A usage error as one line that says what was expected.
#[must_use]
pub fn one_line(error: &clap::Error) -> String {
    let text = error.to_string();
    // What clap adds after an empty line is advice and usage.
    let said: Vec<&str> = text.lines().take_while(|line| !line.is_empty()).map(str::trim).collect();
    let said = said.join(" ");
    let said = said.strip_prefix("error: ").unwrap_or(&said);
    let expected = match error.kind() {
        ErrorKind::ValueValidation => return said.to_owned(),
        ErrorKind::InvalidValue if said.contains("[possible values:") => {
            return said.replace("[possible values:", "[expected one of:");
        }
        ErrorKind::InvalidValue => "one",
        ErrorKind::InvalidSubcommand => "a command",
        ErrorKind::MissingRequiredArgument => "all of them",
        _ => "arguments",
    };
    format!("{said}: expected {expected} as in --help")
}
