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
use crate::run::{recorder, remote, status, watch};
use crate::study::replay::{self, Changes, Show, repair};

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

/// `replay`.
#[derive(Debug, Args)]
pub struct ReplayArgs {
    /// The recording: run.mcap of a run folder
    pub file: PathBuf,
    /// Another planner: what would it have told the robots, where they were?
    #[arg(long, value_name = "NAME", value_parser = PlannerName)]
    pub planner: Option<String>,
    /// Another gate
    #[command(flatten)]
    pub gate: GateArgs,
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
    #[arg(long, conflicts_with_all = ["planner", "gate", "distrust", "no_distrust", "accel_psd", "live"])]
    pub repair: bool,
    /// The whole file [default: FILE without .partial, or with .repaired before .mcap]
    #[arg(long, value_name = "FILE", requires = "repair")]
    pub out: Option<PathBuf>,
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

/// `kill` and `restart`.
#[derive(Debug, Args)]
pub struct RemoteNodeArgs {
    /// sim, fusion or robot-N
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
        let (out, bytes_max) = (self.out.as_deref(), recorder::bytes(self.limit.limit_mb));
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
