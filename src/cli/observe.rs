//! Commands that observe or control runs: `watch`, `live`, `record`, `replay`, `status`, `kill`, `restart`, `stop`.

use std::path::PathBuf;

use clap::Args;
use rangehound_node::rendezvous::Role;
use rangehound_shared::run_name::RunName;
use rangehound_shared::scenario::{GateKey, bounds};

use super::values::{PlannerName, number, port, speed, within};
use super::{GateArgs, NodeArgs, RecordLimitArgs, ShowArgs};
use crate::failure::Failure;
use crate::live;
use crate::run::node::end_with;
use crate::run::recorder::{self, Out};
use crate::run::{remote, status, watch};
use crate::study::replay::{self, Changes, Show, repair};

/// `watch`.
#[derive(Debug, Args)]
pub struct WatchArgs {
    /// The run
    #[command(flatten)]
    pub node: NodeArgs,
    /// Print the report as one line of JSON, with the keys of report.json
    #[arg(long)]
    pub json: bool,
}

/// `live`.
#[derive(Debug, Args)]
pub struct LiveArgs {
    /// The run
    #[command(flatten)]
    pub node: NodeArgs,
    /// Port on 127.0.0.1 [default: any free port]
    #[arg(long, value_name = "PORT", value_parser = port, allow_negative_numbers = true)]
    pub port: Option<u16>,
    /// Print the address as one line of JSON
    #[arg(long)]
    pub json: bool,
}

/// `record`.
#[derive(Debug, Args)]
pub struct RecordArgs {
    /// Folder of a finished run [default: the running run of --name]
    #[arg(value_name = "DIR", conflicts_with = "name")]
    pub folder: Option<PathBuf>,
    /// The running run
    #[command(flatten)]
    pub node: NodeArgs,
    /// File to write [default: run.mcap in the run folder]
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Write a ROS 2 bag (rosbag2, MCAP) to this new folder instead
    #[arg(long, value_name = "BAG", conflicts_with = "out")]
    pub ros2: Option<PathBuf>,
    /// Its largest size
    #[command(flatten)]
    pub limit: RecordLimitArgs,
    /// Print the result as one line of JSON
    #[arg(long)]
    pub json: bool,
}

/// `replay`.
#[derive(Debug, Args)]
pub struct ReplayArgs {
    /// The recording: run.mcap of a run folder
    pub file: PathBuf,
    /// Use another planner: which headings would it have chosen?
    #[arg(long, value_name = "NAME", value_parser = PlannerName)]
    pub planner: Option<String>,
    /// Use another gate
    #[command(flatten)]
    pub gate: GateArgs,
    /// Use another spectral density of the target's noise (of its acceleration, m^2/s^3)
    #[arg(long, value_name = "Q", value_parser = number, allow_negative_numbers = true)]
    pub accel_psd: Option<f64>,
    /// Print the result as one line of JSON
    #[arg(long)]
    pub json: bool,
    /// Whether the replay is shown on the page after the comparison
    #[command(flatten)]
    pub show: ShowArgs,
    /// Speed on the page: seconds of the run per second
    #[arg(long, value_name = "X", requires = "live", value_parser = speed, allow_negative_numbers = true, default_value_t = 1.0)]
    pub speed: f64,
    /// Write a complete file with all ticks before the place where this one was cut short or damaged
    #[arg(long, conflicts_with_all = ["planner", "gate", "distrust", "no_distrust", "accel_psd", "live"])]
    pub repair: bool,
    /// File to write with --repair [default: FILE without .partial, or with .repaired before .mcap]
    #[arg(long, value_name = "FILE", requires = "repair")]
    pub out: Option<PathBuf>,
}

/// `status`.
#[derive(Debug, Args)]
pub struct StatusArgs {
    /// The run
    #[command(flatten)]
    pub run: RemoteArgs,
    /// Show a line for each robot
    #[arg(long)]
    pub all: bool,
    /// Repeat every second, until the run ends or Ctrl-C
    #[arg(long)]
    pub watch: bool,
}

/// A run to act on from another terminal.
#[derive(Debug, Args)]
pub struct RemoteArgs {
    /// Name of the run [default: the only running one]
    #[arg(long)]
    pub name: Option<RunName>,
    /// Print the result as one line of JSON
    #[arg(long)]
    pub json: bool,
}

/// `kill` and `restart`.
#[derive(Debug, Args)]
pub struct RemoteNodeArgs {
    /// The node: sim, fusion, gateway or robot-N
    pub node: Role,
    /// The run
    #[command(flatten)]
    pub run: RemoteArgs,
}

impl WatchArgs {
    /// Shows the progress.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn carry_out(&self) -> Result<(), Failure> {
        watch::watch(&self.node.name, self.json)
    }
}

impl LiveArgs {
    /// Shows the page.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn carry_out(&self) -> Result<(), Failure> {
        end_with(self.node.parent.end_with)?;
        live::live(&self.node.name, self.port, self.json)
    }
}

impl RecordArgs {
    /// Records the run.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn carry_out(&self) -> Result<(), Failure> {
        end_with(self.node.parent.end_with)?;
        let bytes_max = recorder::bytes(self.limit.limit_mb);
        let out = match (&self.out, &self.ros2) {
            (_, Some(folder)) => Out::Bag(folder),
            (Some(file), None) => Out::File(file),
            (None, None) => Out::Default,
        };
        let recorded = match &self.folder {
            Some(folder) => Some(recorder::record_folder(folder, out, bytes_max)?),
            None => recorder::record_run(&self.node.name, out, bytes_max)?,
        };
        recorded.map_or(Ok(()), |recorded| recorded.print(self.json))
    }
}

impl ReplayArgs {
    /// Replays the recording, or repairs it.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn carry_out(&self) -> Result<(), Failure> {
        if self.repair {
            return repair::repair(&self.file, self.out.as_deref(), self.json);
        }
        let gate = self.gate.gate.clone();
        if let Some(GateKey::Sigma(sigma)) = gate {
            within("--gate", bounds::GATE_SIGMA, "a number from 1 to 1e6 or none", sigma)?;
        }
        if let Some(psd) = self.accel_psd {
            within("--accel-psd", bounds::NOISE_PSD, "a number from 0 to 1e9", psd)?;
        }
        let (planner, distrust) = (self.planner.clone(), self.gate.distrust());
        let changes = Changes { planner, gate, distrust, accel_psd: self.accel_psd };
        let show = self.show.live.map(|port| Show { port, speed: self.speed });
        replay::replay(&self.file, &changes, show, self.json)
    }
}

impl RemoteNodeArgs {
    /// Kills the node.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn kill(&self) -> Result<(), Failure> {
        remote::kill(self.run.name.as_ref(), self.node, self.run.json)
    }

    /// Ends the node and waits for its successor.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn restart(&self) -> Result<(), Failure> {
        remote::restart(self.run.name.as_ref(), self.node, self.run.json)
    }
}

impl RemoteArgs {
    /// Ends the run.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn stop(&self) -> Result<(), Failure> {
        remote::stop(self.name.as_ref(), self.json)
    }
}

impl StatusArgs {
    /// Shows the run.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn carry_out(&self) -> Result<(), Failure> {
        status::status(self.run.name.as_ref(), self.all, self.watch, self.run.json)
    }
}
