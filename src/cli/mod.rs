//! The command line, as clap reads it, and its commands.
//!
//! | module | what |
//! |---|---|
//! | `run` | commands that start runs |
//! | `node` | commands that run one node |
//! | `hosts` | commands for robots on other hosts |
//! | `observe` | commands that observe or control runs |
//! | `study` | commands that measure and compare |
//! | `shell`, [`complete`] | for the shell: completions, names, manual pages |
//! | `experiment` | from flags to a scenario file |
//! | `input` | flags for reading a recording and a true track |
//! | `values` | the values of flags |
//! | `examples` | the examples in `--help` and the manual |

pub mod complete;
mod examples;
mod experiment;
mod hosts;
mod input;
mod node;
mod observe;
mod run;
mod shell;
mod study;
mod values;

use clap::error::{ContextKind, ErrorKind};
use clap::{CommandFactory, Parser, Subcommand};

use crate::terminal;
pub use hosts::{GatewayArgs, KeysArgs};
pub use input::{InputArgs, TruthArgs};
pub use node::{FusionArgs, LatencyNodeArgs, NodeArgs, ParentArgs, RobotArgs, SimArgs};
pub use observe::{LiveArgs, RecordArgs, RemoteArgs, RemoteNodeArgs, ReplayArgs, StatusArgs, WatchArgs};
pub use run::{
    ExperimentArgs, GateArgs, RecordLimitArgs, RecordingArgs, ResumeArgs, RunArgs, ShowArgs, SupervisionArgs, TrackArgs,
};
pub use shell::{CompletionsArgs, ManArgs, NamesArgs, NamesOf};
pub use study::{CalibrateArgs, ChaosArgs, CompareArgs, ExploreArgs, LatencyArgs, PlanArgs};
pub use values::PerSensor;

/// A team of robots tracks a moving target. Each robot measures its distance (a range), its bearing, or both. Each robot, the
/// fusion centre (filter and planner) and the simulator is a process; they communicate over shared memory.
///
/// Without a command it runs the paper's experiment, as `rangehound run` does.
#[derive(Debug, Parser)]
#[command(name = "rangehound", version, max_term_width = terminal::WIDTH, after_help = examples::ALL)]
pub struct Cli {
    /// The command.
    #[command(subcommand)]
    pub command: Option<Command>,
}

/// The commands.
#[derive(Debug, Subcommand)]
#[allow(clippy::large_enum_variant, reason = "one for each process")]
pub enum Command {
    /// Run an experiment: start simulator, fusion centre and robots, show the progress, print a report
    Run(RunArgs),
    /// Run the simulator alone: it starts a run that other nodes join by --name
    Sim(SimArgs),
    /// Run the fusion centre alone
    Fusion(FusionArgs),
    /// Run one robot alone, on this host or, with --connect, of a run on another host
    Robot(RobotArgs),
    /// Let robots on other hosts take part in a run of this host
    Gateway(GatewayArgs),
    /// Make keys and certificates for the hosts of a team
    Keys(KeysArgs),
    /// Show the progress of a run started by hand, and report when it ends
    Watch(WatchArgs),
    /// Show a run on a page in the browser, with buttons to kill its processes and see the run recover
    Live(LiveArgs),
    /// Plan one step for each line of JSON, for use by other programs
    Plan(PlanArgs),
    /// Record a run in one file, run.mcap, during the run or after it; `run` and `track` do this by default
    Record(RecordArgs),
    /// Feed a recording's ranges to a fresh fusion centre: check that all estimates are bit-identical, or compare settings
    Replay(ReplayArgs),
    /// Continue a run from its checkpoints after all of its processes have ended
    Resume(ResumeArgs),
    /// Show the state of a run: its tick, and which nodes are running, stopped, hung, gone or elsewhere
    Status(StatusArgs),
    /// Kill a node of a run, as a crash would; the run starts it again
    Kill(RemoteNodeArgs),
    /// Ask a node of a run to end, and wait until its successor has started
    Restart(RemoteNodeArgs),
    /// End a run, as Ctrl-C in its terminal does
    Stop(RemoteArgs),
    /// Test fault tolerance: kill and suspend nodes of runs at random, and check the results
    Chaos(ChaosArgs),
    /// Test fault tolerance in simulated time: run a whole team in one process with random faults, thousands of seeds a second
    Explore(ExploreArgs),
    /// Measure the time from range to heading, and compare it with that of the transport alone
    Latency(LatencyArgs),
    /// One node of a reference that `latency` measures
    #[command(hide = true)]
    LatencyNode(LatencyNodeArgs),
    /// Print the default scenario file, as a start for your own
    Scenario,
    /// Track a target from recorded ranges and bearings, with a process for each sensor
    Track(TrackArgs),
    /// Compare the planners over many simulated runs: tables and pictures
    Compare(CompareArgs),
    /// Estimate noise, bias and scale of each sensor from a recording, for `track --calibration`
    Calibrate(CalibrateArgs),
    /// Print a script that makes a shell complete commands, flags and names
    Completions(CompletionsArgs),
    /// Print the names that a shell completes, one per line
    #[command(hide = true)]
    Names(NamesArgs),
    /// Print the manual page, or write a page for each command to a folder
    Man(ManArgs),
}

/// Earlier names of flags, which still work.
const HIDDEN_ALIASES: [&str; 1] = ["--patience"];

/// The command line with the examples of `--help`.
#[must_use]
pub fn command() -> clap::Command {
    examples::add(Cli::command())
}

/// A usage error as one line: what is wrong, and what was expected.
#[must_use]
pub fn one_line(error: &clap::Error) -> String {
    let text = error.to_string();
    // After an empty line clap adds advice and usage.
    let message: Vec<&str> = text.lines().take_while(|line| !line.is_empty()).map(str::trim).collect();
    let message = message.join(" ");
    let message = message.strip_prefix("error: ").unwrap_or(&message);
    let suggestions = [ContextKind::SuggestedArg, ContextKind::SuggestedSubcommand, ContextKind::SuggestedValue];
    // Hidden aliases are for those who know them.
    let is_shown = |suggested: &String| !HIDDEN_ALIASES.contains(&suggested.trim_matches('\''));
    let suggested = suggestions.into_iter().find_map(|kind| error.get(kind)).map(ToString::to_string).filter(is_shown);
    let expected = match error.kind() {
        ErrorKind::ValueValidation => return message.to_owned(),
        ErrorKind::InvalidValue if message.contains("[possible values:") => {
            return message.replace("[possible values:", "[expected one of:");
        }
        ErrorKind::ArgumentConflict if message.contains("multiple times") => {
            return format!("{message}: expected it once");
        }
        ErrorKind::ArgumentConflict => return format!("{message}: expected only one of them"),
        ErrorKind::InvalidValue => "a value",
        ErrorKind::InvalidSubcommand => "a command",
        ErrorKind::MissingRequiredArgument => {
            let missing = message.rsplit_once("provided: ").map_or(message, |(_, missing)| missing);
            return format!("{missing} is missing: expected this argument; see --help");
        }
        _ => "arguments",
    };
    let expected = suggested.as_deref().unwrap_or(expected);
    format!("{message}: expected {expected}; see --help")
}
