//! The command line, as clap reads it, and its commands.
//!
//! | module | what |
//! |---|---|
//! | `run` | commands that start runs |
//! | `node` | one node |
//! | `look` | commands that observe or control runs |
//! | `study` | commands that measure and compare |
//! | `shell`, [`complete`] | for the shell: completions, names, manual pages |
//! | `experiment` | from flags to a scenario file |
//! | `input` | how a recording is read |
//! | `values` | values as they are written behind flags |
//! | `examples` | what `--help` and the manual add to each command |

pub mod complete;
mod examples;
mod experiment;
mod input;
mod look;
mod node;
mod run;
mod shell;
mod study;
mod values;

use clap::error::ErrorKind;
use clap::{CommandFactory, Parser, Subcommand};

use crate::terminal;
pub use input::InputArgs;
pub use look::{LiveArgs, RecordArgs, RemoteArgs, RemoteNodeArgs, ReplayArgs, StatusArgs, WatchArgs};
pub use node::{FusionArgs, LatencyNodeArgs, NodeArgs, ParentArgs, RobotArgs, SimArgs};
pub use run::{
    ExperimentArgs, GateArgs, RecordLimitArgs, RecordingArgs, ResumeArgs, RunArgs, ShowArgs, SupervisionArgs, TrackArgs,
};
pub use shell::{CompletionsArgs, ManArgs, NamesArgs, NamesOf};
pub use study::{CalibrateArgs, ChaosArgs, CompareArgs, ExploreArgs, LatencyArgs, PlanArgs};
pub use values::PerSensor;

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
#[allow(clippy::large_enum_variant, reason = "one for each process")]
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
    /// Explore faults in simulated time, thousands of seeds a second: every promise is checked as a whole team goes on in one process
    Explore(ExploreArgs),
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
    /// Find noise, bias and scale of each sensor from a recording, for `track --calibration`
    Calibrate(CalibrateArgs),
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

/// A usage error as one line that says what was expected.
#[must_use]
pub fn one_line(error: &clap::Error) -> String {
    let text = error.to_string();
    // What clap adds after an empty line is advice and usage.
    let message: Vec<&str> = text.lines().take_while(|line| !line.is_empty()).map(str::trim).collect();
    let message = message.join(" ");
    let message = message.strip_prefix("error: ").unwrap_or(&message);
    let expected = match error.kind() {
        ErrorKind::ValueValidation => return message.to_owned(),
        ErrorKind::InvalidValue if message.contains("[possible values:") => {
            return message.replace("[possible values:", "[expected one of:");
        }
        ErrorKind::InvalidValue => "one",
        ErrorKind::InvalidSubcommand => "a command",
        ErrorKind::MissingRequiredArgument => {
            let missing = message.rsplit_once("provided: ").map_or(message, |(_, missing)| missing);
            return format!("expected {missing} too, as in --help");
        }
        _ => "arguments",
    };
    format!("{message}: expected {expected} as in --help")
}
