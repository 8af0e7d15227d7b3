//! Commands that start runs: `run`, `track`, `resume`.

use std::net::SocketAddr;
use std::path::PathBuf;

use clap::Args;
use rangehound_shared::robot_set::RobotSet;
use rangehound_shared::run_name::RunName;
use rangehound_shared::scenario::{Clock, GateKey, TimeoutKey};

use super::ParentArgs;
use super::input::{InputArgs, TruthArgs};
use super::values::{CLOCKS, PerSensor, PlannerName, gate, megabytes, number, place, port, standbys, timeout, whole};
use crate::failure::Failure;
use crate::results::made::Keep;
use crate::run::experiment::{Experiment, Naming};
use crate::run::external::External;
use crate::run::node::end_with;
use crate::run::pin::Pin;
use crate::run::supervisor::restart::Rule;
use crate::run::supervisor::{self, Hosts, Supervision};

/// The experiment, its name and its folder.
#[derive(Debug, Default, Args)]
pub struct ExperimentArgs {
    /// Scenario file [default: the paper's experiment, see `rangehound scenario`]
    pub scenario: Option<PathBuf>,
    /// Number of robots, all with the same properties
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub robots: Option<u64>,
    /// Number of time steps
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub ticks: Option<u64>,
    /// Seed of all random numbers
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub seed: Option<u64>,
    /// Start of the next tick: by wall time (realtime), or by the answers of all robots (lockstep)
    #[arg(long, value_parser = CLOCKS)]
    pub clock: Option<Clock>,
    /// Planner: how headings are chosen
    #[arg(long, value_name = "NAME", value_parser = PlannerName)]
    pub planner: Option<String>,
    /// Least distance of the robots to the predicted target, m
    #[arg(long, value_name = "M", value_parser = number, allow_negative_numbers = true)]
    pub stand_off: Option<f64>,
    /// Time-out: seconds of silence after which a run continues without a robot and replaces a silent process, or
    /// "forever"
    #[arg(long, value_name = "SECONDS", alias = "patience", value_parser = timeout, allow_negative_numbers = true)]
    pub timeout: Option<TimeoutKey>,
    /// Name of the run, by which nodes find each other [default: the scenario's name, numbered if taken]
    #[arg(long)]
    pub name: Option<RunName>,
    /// Folder for report, tables and logs [default: runs/NAME]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

/// `run`.
#[derive(Debug, Default, Args)]
pub struct RunArgs {
    /// The experiment
    #[command(flatten)]
    pub experiment: ExperimentArgs,
    /// Run all nodes in this one process, without shared memory: same estimates, same digest
    #[arg(long, conflicts_with_all = ["live", "listen", "external"])]
    pub in_process: bool,
    /// The processes, and their restart
    #[command(flatten)]
    pub supervision: SupervisionArgs,
    /// Also write ranges.csv and truth.csv to the run folder: a recording that `rangehound track` reads
    #[arg(long)]
    pub write_recording: bool,
    /// Exit with 1 if the verdict of the report is "not valid"
    #[arg(long)]
    pub strict: bool,
    /// Print the report as one line of JSON, with the keys of report.json
    #[arg(long)]
    pub json: bool,
    /// The recording
    #[command(flatten)]
    pub recording: RecordingArgs,
    /// The process to end with
    #[command(flatten)]
    pub parent: ParentArgs,
}

/// `track`.
#[derive(Debug, Args)]
pub struct TrackArgs {
    /// The recording to read
    #[command(flatten)]
    pub input: InputArgs,
    /// Position of the target at the first range, m, if known
    #[arg(long, value_name = "X,Y", value_parser = place, allow_hyphen_values = true)]
    pub start: Option<[f64; 2]>,
    /// Standard deviation of each coordinate of --start, m [default: 0.5]
    #[arg(long, value_name = "M", value_parser = number, allow_negative_numbers = true, requires = "start")]
    pub start_std: Option<f64>,
    /// Standard deviation of a range, m
    #[arg(long, value_name = "M", value_parser = number, allow_negative_numbers = true)]
    pub range_std: Option<f64>,
    /// Standard deviation of a bearing, rad
    #[arg(long, value_name = "RAD", value_parser = number, allow_negative_numbers = true)]
    pub bearing_std: Option<f64>,
    /// Spectral density of the target's acceleration, m^2/s^3: larger for a target that manoeuvres harder
    #[arg(long, value_name = "Q", value_parser = number, allow_negative_numbers = true)]
    pub accel_psd: Option<f64>,
    /// Uncertain properties of the sensors
    #[command(flatten)]
    pub nuisances: NuisanceArgs,
    /// Bias B in `measured = (1+S) true + B`, m; SENSOR=B for one sensor, repeatable
    #[arg(long, value_name = "[SENSOR=]B", allow_hyphen_values = true)]
    pub range_bias: Vec<PerSensor>,
    /// Scale error S in `measured = (1+S) true + B`; SENSOR=S for one sensor, repeatable
    #[arg(long, value_name = "[SENSOR=]S", allow_hyphen_values = true)]
    pub range_scale: Vec<PerSensor>,
    /// The gate
    #[command(flatten)]
    pub gate: GateArgs,
    /// Calibration file of `rangehound calibrate`: bias, scale and noise of the sensors; flags override it
    #[arg(long, value_name = "FILE")]
    pub calibration: Option<PathBuf>,
    /// The processes, and their restart
    #[command(flatten)]
    pub supervision: SupervisionArgs,
    /// The true track
    #[command(flatten)]
    pub truth: TruthArgs,
    /// Run all nodes in this one process, without shared memory
    #[arg(long, conflicts_with_all = ["live", "listen", "external"])]
    pub in_process: bool,
    /// The recording
    #[command(flatten)]
    pub recording: RecordingArgs,
    /// Name of the run [default: the name of the file, numbered if taken]
    #[arg(long)]
    pub name: Option<RunName>,
    /// Folder for estimate.csv, report and logs [default: runs/NAME]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print the report as one line of JSON, with the keys of report.json
    #[arg(long)]
    pub json: bool,
}

/// Errors of the sensors that stay from one measurement to the next.
#[derive(Debug, Default, Args)]
pub struct NuisanceArgs {
    /// Standard deviation of the error of each coordinate of a sensor's position, m. Alone: a new error in each measurement.
    /// With --pose-correlation: an error that changes slowly. With --pose-drift: the error at the start
    #[arg(long, value_name = "M", value_parser = number, allow_negative_numbers = true)]
    pub pose_std: Option<f64>,
    /// Drift of each coordinate of a sensor's position, as of odometry, m per square root of a second
    #[arg(long, value_name = "M", value_parser = number, allow_negative_numbers = true)]
    pub pose_drift: Option<f64>,
    /// Correlation time of the errors of a sensor's position and heading, s, as of GPS
    #[arg(long, value_name = "S", value_parser = number, allow_negative_numbers = true, conflicts_with = "pose_drift")]
    pub pose_correlation: Option<f64>,
    /// Standard deviation of a sensor's heading, rad
    #[arg(long, value_name = "RAD", value_parser = number, allow_negative_numbers = true)]
    pub heading_std: Option<f64>,
    /// Standard deviation of the unknown bias of a sensor's ranges, m
    #[arg(long, value_name = "M", value_parser = number, allow_negative_numbers = true)]
    pub bias_std: Option<f64>,
    /// Estimate these errors with the target, instead of only allowing for them: bias, pose, or both with a comma
    #[arg(long, value_name = "WHAT", value_delimiter = ',', value_parser = ["bias", "pose"])]
    pub estimate: Option<Vec<String>>,
}

/// The gate for single ranges, and the distrust of sensors.
#[derive(Debug, Default, Args)]
pub struct GateArgs {
    /// Gate: reject a range whose innovation exceeds this many standard deviations; "none" fuses all ranges
    #[arg(long, value_name = "SIGMA", value_parser = gate, allow_negative_numbers = true)]
    pub gate: Option<GateKey>,
    /// Leave out a sensor whose ranges keep failing the gate while most others pass [default: on if there is a gate]
    #[arg(long, overrides_with = "no_distrust")]
    distrust: bool,
    /// Fuse every range that passes the gate, even if its sensor has failed often
    #[arg(long, overrides_with = "distrust")]
    no_distrust: bool,
}

impl GateArgs {
    /// Whether sensors are distrusted, if given.
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
    /// Name of the run [default: the scenario's name]
    #[arg(long)]
    pub name: Option<RunName>,
    /// The processes, and their restart
    #[command(flatten)]
    pub supervision: SupervisionArgs,
    /// Print the report as one line of JSON, with the keys of report.json
    #[arg(long)]
    pub json: bool,
    /// The recording
    #[command(flatten)]
    pub recording: RecordingArgs,
}

/// The processes that a supervisor starts, and their restart.
#[derive(Debug, Default, Args)]
pub struct SupervisionArgs {
    /// Number of standby fusion processes, which take over when the leading one dies or hangs
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = standbys)]
    pub standby: usize,
    /// When to restart nodes that have ended: always, on-failure or never; sim=POLICY, fusion=POLICY or robot=POLICY for
    /// one kind of node, repeatable [default: always]
    #[arg(long = "restart", value_name = "[KIND=]POLICY")]
    pub rules: Vec<Rule>,
    /// Processors for all processes of the run: none (any processor), one-core, or numbers as in 0,1
    #[arg(long, value_name = "CPUS", default_value_t)]
    pub pin: Pin,
    /// The live page
    #[command(flatten)]
    pub show: ShowArgs,
    /// Robots on other hosts
    #[command(flatten)]
    pub hosts: HostsArgs,
    /// Robots whose processes you start yourself on this host, as in 0,2-5: drivers, or a node of ROS 2; the others are
    /// started here. Add fusion to the list if you start the fusion centre too
    #[arg(long, value_name = "IDS")]
    pub external: Option<External>,
}

/// Robots on other hosts.
#[derive(Debug, Default, Args)]
pub struct HostsArgs {
    /// Start a gateway at this address: robots join from other hosts by `rangehound robot --connect`. Every address
    /// except the loopback (127.0.0.1 or ::1) requires --keys
    #[arg(long, value_name = "ADDRESS:PORT")]
    pub listen: Option<SocketAddr>,
    /// With --listen: folder with the keys of this host, from `rangehound keys`
    #[arg(long, value_name = "DIR", requires = "listen")]
    pub keys: Option<PathBuf>,
    /// With --listen: the robots that join from other hosts, as in 0,2-5; the others are started here [default: all]
    #[arg(long, value_name = "IDS", requires = "listen")]
    pub remote: Option<RobotSet>,
}

/// Whether a run is shown.
#[derive(Debug, Default, Args)]
pub struct ShowArgs {
    /// Show the run on a page in the browser, as `rangehound live` does; --live=PORT chooses the port
    #[arg(long, value_name = "PORT", num_args = 0..=1, require_equals = true, value_parser = port)]
    pub live: Option<Option<u16>>,
}

/// Whether a run is recorded.
#[derive(Debug, Default, Args)]
pub struct RecordingArgs {
    /// Record the run in run.mcap in its folder, for viewers and `rangehound replay` [default: on]
    #[arg(long, overrides_with = "no_record")]
    pub record: bool,
    /// Do not write run.mcap
    #[arg(long, overrides_with = "record")]
    pub no_record: bool,
    /// Its largest size
    #[command(flatten)]
    pub limit: RecordLimitArgs,
}

/// The largest size of a recording.
#[derive(Debug, Clone, Copy, Args)]
pub struct RecordLimitArgs {
    /// Largest size of the recording in megabytes; beyond it the run continues without recording
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
        // Before the folder is made.
        let truth = self.truth.read(&self.input)?;
        let keep = Keep { ranges: false, truth, json: self.json, strict: self.input.strict };
        execute(self.experiment()?, self.in_process, &self.supervision.with(&self.recording), &keep)
    }
}

impl ResumeArgs {
    /// Continues the run.
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
            hosts: self.hosts.listen.map(|listen| Hosts {
                listen,
                keys: self.hosts.keys.clone(),
                remote: self.hosts.remote.map(|remote| remote.iter().collect()),
            }),
            external: self.external.clone(),
            record_limit_mb: (!recording.no_record).then_some(recording.limit.limit_mb),
        }
    }
}
