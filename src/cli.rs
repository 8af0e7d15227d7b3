//! The command line, as clap reads it.

use std::path::PathBuf;

use clap::error::ErrorKind;
use clap::{Args, Parser, Subcommand, ValueEnum};
use rangehound_shared::rendezvous::{Role, RunName};
use rangehound_shared::scenario::PatienceKey;

use crate::latency::reference::Reference;
use crate::pin::Pin;
use crate::supervisor::restart::Rule;
use rangehound_fusion::run::STANDBYS_MAX;

/// A team of robots tracks a moving target by ranges alone: one process per robot, a fusion centre
/// that filters and plans, a simulator, all talking over shared memory.
///
/// Without a command it runs the paper's experiment (as `rangehound run`).
#[derive(Debug, Parser)]
#[command(name = "rangehound", version, after_help = EXAMPLES)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Option<Command>,
}

const EXAMPLES: &str = "Examples:
  rangehound                                     the paper's experiment, 20 s in real time
  rangehound run --clock lockstep --robots 10    ten robots, as fast as the processes can
  rangehound scenario > mine.toml                a scenario file to start from
  rangehound track ranges.csv --range-std 0.12   recorded ranges through the same processes
  rangehound compare --robots 5                  all planners on the same 1000 targets, with pictures
  rangehound latency --robots 10 --pin one-core  how long a heading takes, beside the bare transport

Exit codes: 0 done, 1 failed while running or ended by Ctrl-C, 2 bad usage or bad input.";

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Start simulator, fusion centre and robots, watch them, and write the run folder
    Run(RunArgs),
    /// Run the simulator alone: founds the run if nobody has (other nodes join it by --name)
    Sim(SimArgs),
    /// Run the fusion centre alone
    Fusion(FusionArgs),
    /// Run one robot alone
    Robot(RobotArgs),
    /// Attach to a run: show its progress, and write its report when it ends
    Watch(NodeArgs),
    /// Plan one step for each JSON line of a file or of standard input, for programs of any language
    Plan(PlanArgs),
    /// Go on with a run all of whose processes are gone, from its checkpoints
    Resume(ResumeArgs),
    /// Show a run: where it is, and each node's state, process and starts
    Status(StatusArgs),
    /// Kill a node of a run, as a crash would: its supervisor starts it again
    Kill(RemoteNodeArgs),
    /// End a node of a run in order and wait for its successor
    Restart(RemoteNodeArgs),
    /// End a run in order, as Ctrl-C in its terminal would
    Stop(RemoteArgs),
    /// Hurt a run of its own at random times, by a seed, and judge whether it kept its promises
    Chaos(ChaosArgs),
    /// Measure the time from range to heading, beside raw iceoryx2 and futexes doing the same exchange
    Latency(LatencyArgs),
    /// One node of a reference that `latency` measures
    #[command(hide = true)]
    LatencyNode(LatencyNodeArgs),
    /// Print the default scenario file, to start one's own from
    Scenario,
    /// Track recorded ranges: the same processes, one robot process for each sensor
    Track(TrackArgs),
    /// Compare the planners: many runs of each in this one process, a table and pictures
    Compare(CompareArgs),
}

/// `run`.
#[derive(Debug, Default, Args)]
pub struct RunArgs {
    /// The experiment, as a whole
    #[command(flatten)]
    pub experiment: ExperimentArgs,
    /// Compose the same steps in this one process, without shared memory: same estimates, same digest
    #[arg(long)]
    pub in_process: bool,
    /// Who is started, and started again
    #[command(flatten)]
    pub supervision: SupervisionArgs,
    /// Also write ranges.csv and truth.csv to the run folder: a recording that `rangehound track` reads
    #[arg(long)]
    pub write_recording: bool,
    /// Who to end with
    #[command(flatten)]
    pub parent: ParentArgs,
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
    /// How headings are chosen: certified, adaptive, standard, grid, greedy, pursue or random
    #[arg(long, value_name = "NAME")]
    pub planner: Option<String>,
    /// Least distance of the robots to the predicted target, m
    #[arg(long, value_name = "M", value_parser = number, allow_negative_numbers = true)]
    pub stand_off: Option<f64>,
    /// Silence after which lock step goes on without a robot: seconds or "forever"
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

/// `watch`, and what the nodes have in common.
#[derive(Debug, Args)]
pub struct NodeArgs {
    /// Name of the run to join; waits for it to be founded
    #[arg(long, default_value = rangehound_shared::scenario::defaults::NAME)]
    pub name: RunName,
    /// Who to end with
    #[command(flatten)]
    pub parent: ParentArgs,
}

/// What a supervisor starts, and starts again.
#[derive(Debug, Default, Args)]
pub struct SupervisionArgs {
    /// Fusion processes that stand by to take over from the one that leads
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = standbys)]
    pub standby: usize,
    /// Start nodes again that have ended: always, on-failure or never; KIND=POLICY for sim, fusion or robot
    /// only, repeatable [default: always]
    #[arg(long = "restart", value_name = "[KIND=]POLICY")]
    pub rules: Vec<Rule>,
    /// Processors for all processes of the run: none (any), one-core, or their numbers as in 0,1
    #[arg(long, value_name = "CPUS", default_value_t)]
    pub pin: Pin,
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
}

/// A run to act on from another terminal.
#[derive(Debug, Args)]
pub struct RemoteArgs {
    /// Name of the run [default: the only one that goes on]
    #[arg(long)]
    pub name: Option<RunName>,
}

/// `status`.
#[derive(Debug, Args)]
pub struct StatusArgs {
    /// The run
    #[command(flatten)]
    pub run: RemoteArgs,
    /// Print one line of JSON
    #[arg(long)]
    pub json: bool,
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
#[command(after_help = CHAOS_EXITS)]
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
}

const CHAOS_EXITS: &str = "Exit codes: 0 all promises kept, 1 one broken or ended by Ctrl-C, 2 bad usage or bad input.";

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
    /// Compose the same steps in this one process, without shared memory
    #[arg(long)]
    pub in_process: bool,
    /// Name of the run [default: after the file, numbered if taken]
    #[arg(long)]
    pub name: Option<RunName>,
    /// Run folder: estimate.csv, report, logs [default: runs/NAME]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

/// `plan`.
#[derive(Debug, Default, Args)]
#[command(after_help = PLAN_EXAMPLE)]
pub struct PlanArgs {
    /// Problems, one JSON object a line; - or nothing for standard input
    pub file: Option<PathBuf>,
    /// Planner of the lines that name none: certified, adaptive, standard, grid, greedy, pursue or random
    /// [default: certified]
    #[arg(long, value_name = "NAME")]
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

const PLAN_EXAMPLE: &str =
    "A line holds the predicted position covariance (m^2), the predicted target (m), the time that robots move
before they measure, and the team:

  {\"prior_position_covariance\":[[4,0.5],[0.5,2]],\"target\":[0,0],\"time_step_s\":0.1,\"robots\":
   [{\"position\":[20,0],\"max_speed\":10,\"range_std\":1},{\"position\":[0,15],\"max_speed\":10,\"range_std\":1}]}

(in one line). It may add stand_off_m, stand_off_sigma, separation_m (clearances, 0 if absent) and planner (a name).
Its answer is one line, in the same order:

  {\"planner\":..,\"headings_rad\":[..],\"speeds_mps\":[..],\"objective\":..,\"lower_bound\":..,\"certified\":..,
   \"position_trace_m2\":..,\"plan_us\":..}

objective is |S|, no headings reach less than lower_bound; certified: none are better but for rounding. A line that
makes no sense is answered by {\"line\":N,\"error\":\"..\"}, told on standard error too, and the next one is read; lines
count from 1, blank ones are skipped. Answers come at once when no more input is there.

Exit codes: 0 done, 1 failed while running, 2 bad usage or a line that makes no sense.";

/// `compare`.
#[derive(Debug, Args)]
pub struct CompareArgs {
    /// Scenario file [default: the paper's experiment, see `rangehound scenario`]
    pub scenario: Option<PathBuf>,
    /// The same as a flag
    #[arg(long = "scenario", value_name = "FILE", conflicts_with = "scenario")]
    pub scenario_flag: Option<PathBuf>,
    /// Planners to compare, separated by commas: certified, adaptive, standard, greedy, pursue, random,
    /// and grid, which is for small teams only
    #[arg(
        long,
        value_name = "NAMES",
        value_delimiter = ',',
        value_parser = trimmed,
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
}

/// `latency`.
#[derive(Debug, Args)]
#[command(after_help = LATENCY_EXAMPLES)]
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
    /// How headings are chosen: certified, adaptive, standard, grid, greedy, pursue or random [default: the scenario's]
    #[arg(long, value_name = "NAME")]
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
}

const LATENCY_EXAMPLES: &str =
    "It runs the whole system (simulator, fusion with filter, planner and checkpoints, robots) and, in turns, the bare
exchange of the same messages over raw iceoryx2 and over futexes, on this machine, now; a ratio below 1 means that the
system was faster than that reference.

Examples:
  rangehound latency --robots 10 --pin one-core      software alone, without wake-ups across processors
  rangehound latency --robots 10 --rate 100          in real time, all asleep between ticks";

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

#[expect(clippy::unnecessary_wraps, reason = "the shape that the parser asks for")]
fn trimmed(text: &str) -> Result<String, String> {
    Ok(text.trim().to_owned())
}

fn whole(text: &str) -> Result<u64, String> {
    text.parse().map_err(|_| "expected a whole number from 0".to_owned())
}

fn standbys(text: &str) -> Result<usize, String> {
    let expected = || format!("expected a whole number from 0 to {STANDBYS_MAX}");
    text.parse().ok().filter(|count| *count <= STANDBYS_MAX).ok_or_else(expected)
}

fn number(text: &str) -> Result<f64, String> {
    text.parse().map_err(|_| "expected a number".to_owned())
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
