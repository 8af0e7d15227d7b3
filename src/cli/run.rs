//! Commands that start runs: `run`, `track`, `resume`.

use std::path::PathBuf;

use clap::Args;
use rangehound_shared::run_name::RunName;
use rangehound_shared::scenario::{Clock, GateKey, TimeoutKey};

use super::ParentArgs;
use super::input::InputArgs;
use super::values::{CLOCKS, PerSensor, PlannerName, gate, megabytes, number, place, port, standbys, timeout, whole};
use crate::failure::Failure;
use crate::results::made::Keep;
use crate::results::report::Truth;
use crate::run::experiment::{Experiment, Naming};
use crate::run::node::end_with;
use crate::run::pin::Pin;
use crate::run::supervisor::restart::Rule;
use crate::run::supervisor::{self, Supervision};

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
    #[arg(long, value_parser = CLOCKS)]
    pub clock: Option<Clock>,
    /// How headings are chosen
    #[arg(long, value_name = "NAME", value_parser = PlannerName)]
    pub planner: Option<String>,
    /// Least distance of the robots to the predicted target, m
    #[arg(long, value_name = "M", value_parser = number, allow_negative_numbers = true)]
    pub stand_off: Option<f64>,
    /// Silence after which lock step goes on without a robot, and a silent process is killed and started again: seconds or
    /// "forever"
    #[arg(long, value_name = "SECONDS", alias = "patience", value_parser = timeout, allow_negative_numbers = true)]
    pub timeout: Option<TimeoutKey>,
    /// Name of the run: nodes find each other by it [default: the scenario's name, numbered if taken]
    #[arg(long)]
    pub name: Option<RunName>,
    /// Run folder: report, tables, logs [default: runs/NAME]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
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
    /// Exit with 1 if the report's verdict is that the result is not sound
    #[arg(long)]
    pub strict: bool,
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

/// `track`.
#[derive(Debug, Args)]
pub struct TrackArgs {
    /// What is read, and how
    #[command(flatten)]
    pub input: InputArgs,
    /// Where the target is at the first range, m
    #[arg(long, value_name = "X,Y", value_parser = place, allow_hyphen_values = true)]
    pub start: Option<[f64; 2]>,
    /// Standard deviation of each coordinate of --start, m [default: 0.5]
    #[arg(long, value_name = "M", value_parser = number, allow_negative_numbers = true, requires = "start")]
    pub start_std: Option<f64>,
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
    /// Which ranges are fused
    #[command(flatten)]
    pub gate: GateArgs,
    /// What `rangehound calibrate` found: bias, scale and noise of the sensors; flags win over it
    #[arg(long, value_name = "FILE")]
    pub calibration: Option<PathBuf>,
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

/// Which ranges are fused: two switches.
#[derive(Debug, Default, Args)]
pub struct GateArgs {
    /// Reject a range whose innovation is more than this many standard deviations, or "none": fuse all
    #[arg(long, value_name = "SIGMA", value_parser = gate, allow_negative_numbers = true)]
    pub gate: Option<GateKey>,
    /// Test but do not fuse the ranges of a sensor that keeps failing while most do not [default: where there is a gate]
    #[arg(long, overrides_with = "no_distrust")]
    distrust: bool,
    /// Fuse every range that passes the gate, whatever its sensor did before
    #[arg(long, overrides_with = "distrust")]
    no_distrust: bool,
}

impl GateArgs {
    /// Whether sensors are distrusted, if that was said.
    #[must_use]
    pub fn distrust(&self) -> Option<bool> {
        (self.distrust || self.no_distrust).then_some(self.distrust)
    }
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

/// Whether a run is shown.
#[derive(Debug, Default, Args)]
pub struct ShowArgs {
    /// Show it on a page in the browser, as `rangehound live` does; --live=PORT to choose the port
    #[arg(long, value_name = "PORT", num_args = 0..=1, require_equals = true, value_parser = port)]
    pub live: Option<Option<u16>>,
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

impl Default for RecordLimitArgs {
    fn default() -> Self {
        Self { limit_mb: RECORD_LIMIT_MB }
    }
}

/// Enough for hours of the paper's experiment.
const RECORD_LIMIT_MB: u64 = 1_000;

impl RunArgs {
    /// Runs the experiment.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn carry_out(&self) -> Result<(), Failure> {
        end_with(self.parent.end_with)?;
        let experiment = self.experiment.experiment(Naming::Numbered)?;
        let keep = Keep { ranges: self.write_recording, truth: None, json: self.json, strict: self.strict };
        execute(experiment, self.in_process, &self.supervision.with(&self.recording), &keep)
    }
}

impl TrackArgs {
    /// Tracks the recording.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn carry_out(&self) -> Result<(), Failure> {
        // Before a folder is made for the name.
        let truth = self.truth.as_deref().map(Truth::read).transpose()?;
        let keep = Keep { ranges: false, truth, json: self.json, strict: self.input.strict };
        execute(self.experiment()?, self.in_process, &self.supervision.with(&self.recording), &keep)
    }
}

impl ResumeArgs {
    /// Goes on with the run.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn carry_out(&self) -> Result<(), Failure> {
        let keep = Keep { json: self.json, ..Keep::default() };
        supervisor::resume(&self.folder, self.name.as_ref(), &self.supervision.with(&self.recording), &keep)
    }
}

fn execute(experiment: Experiment, in_process: bool, supervision: &Supervision, keep: &Keep) -> Result<(), Failure> {
    if in_process {
        return supervisor::run_in_process(&experiment, supervision.record_limit_mb, keep);
    }
    supervisor::run(experiment, supervision, keep)
}

impl SupervisionArgs {
    fn with(&self, recording: &RecordingArgs) -> Supervision {
        Supervision {
            standbys: self.standby,
            rules: self.rules.clone(),
            pin: self.pin.clone(),
            live: self.show.live,
            record_limit_mb: (!recording.no_record).then_some(recording.limit.limit_mb),
        }
    }
}
