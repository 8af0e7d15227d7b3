//! The scenario file: TOML with every key optional.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::recording::SensorName;

/// A scenario file, parsed but not yet checked; [`super::Scenario::from_file`] checks it.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScenarioFile {
    /// Name of the scenario and of the run folder.
    pub name: Option<String>,
    /// Time steps of the run.
    pub ticks: Option<u64>,
    /// Length of a time step, s.
    pub dt_s: Option<f64>,
    /// Seed of all random numbers.
    pub seed: Option<u64>,
    /// `"realtime"` or `"lockstep"`.
    pub clock: Option<String>,
    /// Silence after which a robot is left out, s, or `"forever"`.
    #[serde(alias = "patience_s")]
    pub timeout_s: Option<TimeoutKey>,
    /// The target's motion.
    pub target: Option<TargetTable>,
    /// Fusion's knowledge before the first range.
    pub prior: Option<PriorTable>,
    /// The team, if its robots are alike.
    pub robots: Option<RobotsTable>,
    /// The team, robot by robot.
    pub robot: Option<Vec<RobotTable>>,
    /// Sensors by name, for robots to have.
    pub sensor: Option<BTreeMap<String, SensorTable>>,
    /// Localisers by name, for robots to have.
    pub localiser: Option<BTreeMap<String, LocaliserTable>>,
    /// The choice of headings.
    pub planner: Option<PlannerTable>,
    /// The filter's gate and its assumed noise.
    pub filter: Option<FilterTable>,
    /// Recorded ranges instead of a simulation.
    pub recording: Option<RecordingTable>,
}

/// `timeout_s`: seconds or `"forever"`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged, expecting = "expected seconds above 0 or \"forever\"")]
pub enum TimeoutKey {
    /// Seconds of silence.
    Seconds(f64),
    /// `"forever"`.
    Word(String),
}

/// `[target]`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TargetTable {
    /// `"random_walk"`, `"zero_acceleration"`, `"constant_acceleration"` or `"custom"`.
    pub model: Option<String>,
    /// Spectral density of the built-in models' noise.
    pub noise_psd: Option<f64>,
    /// State at tick 0: the true one of a simulated target, the expected one of a real target.
    pub start: Option<Vec<f64>>,
    /// True if the target is a real one, which real robots measure.
    pub real: Option<bool>,
    /// Custom model: state transition.
    pub phi: Option<Vec<Vec<f64>>>,
    /// Custom model: noise Jacobian.
    pub g: Option<Vec<Vec<f64>>>,
    /// Custom model: noise covariance.
    pub qd: Option<Vec<Vec<f64>>>,
}

/// `[prior]`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PriorTable {
    /// `"drawn"` from N(start, covariance), `"start"`, or the state itself.
    pub mean: Option<MeanKey>,
    /// P_0|0.
    pub covariance: Option<CovarianceKey>,
}

/// `prior.mean`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged, expecting = "expected \"drawn\", \"start\" or a list of numbers, one for each state")]
pub enum MeanKey {
    /// `"drawn"` or `"start"`.
    Word(String),
    /// The mean.
    State(Vec<f64>),
}

/// `prior.covariance`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged, expecting = "expected one variance, a list of variances or a matrix as a list of rows")]
pub enum CovarianceKey {
    /// The same variance for every state.
    Scalar(f64),
    /// A variance for each state.
    Diagonal(Vec<f64>),
    /// The complete matrix by rows.
    Rows(Vec<Vec<f64>>),
}

/// `[robots]`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotsTable {
    /// Number of robots.
    pub count: Option<u64>,
    /// Start of the robots, `[x, y]` in m.
    pub start_m: Option<[f64; 2]>,
    /// Radius of a circle around the start on which they are evenly spread, m; 0: all at one point.
    pub ring_radius_m: Option<f64>,
    /// Speed limit, m/s.
    pub speed_mps: Option<f64>,
    /// Standard deviation of a range, m, of robots without a named sensor.
    pub range_std_m: Option<f64>,
    /// Name of their sensor: a table `[sensor.NAME]`.
    pub sensor: Option<String>,
    /// Name of their localiser: a table `[localiser.NAME]`.
    pub localiser: Option<String>,
}

/// One `[[robot]]`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotTable {
    /// Id, 0 to the number of robots - 1; default: its position in the list.
    pub id: Option<u64>,
    /// Start, `[x, y]` in m.
    pub start_m: Option<[f64; 2]>,
    /// Speed limit, m/s.
    pub speed_mps: Option<f64>,
    /// Standard deviation of its range, m, if it has no named sensor.
    pub range_std_m: Option<f64>,
    /// Name of its sensor: a table `[sensor.NAME]`.
    pub sensor: Option<String>,
    /// Name of its localiser: a table `[localiser.NAME]`.
    pub localiser: Option<String>,
}

/// One `[sensor.NAME]`: what a robot with this sensor measures. It has ranges, bearings or both.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorTable {
    /// Standard deviation of a range, m; without it there are no ranges.
    pub range_std_m: Option<f64>,
    /// Growth of that with the distance.
    pub range_std_per_m: Option<f64>,
    /// Standard deviation of a range's bias, m.
    pub range_bias_std_m: Option<f64>,
    /// Time after which the bias is another, s; without it the bias is constant.
    pub range_bias_correlation_s: Option<f64>,
    /// Standard deviation of a bearing, rad; without it there are no bearings.
    pub bearing_std_rad: Option<f64>,
    /// Distance up to which it measures, m.
    pub max_range_m: Option<f64>,
    /// Angle in which it measures, centred on the robot's heading, rad.
    pub field_of_view_rad: Option<f64>,
}

/// One `[localiser.NAME]`: how well a robot with this localiser knows its own pose.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LocaliserTable {
    /// Standard deviation of each coordinate, m; at the start, if it drifts.
    pub std_m: Option<f64>,
    /// Drift of each coordinate, m per square root of a second.
    pub drift_m: Option<f64>,
    /// Time for which an error stays, s; without it each pose has an error of its own.
    pub correlation_s: Option<f64>,
    /// Standard deviation of the heading, rad.
    pub heading_std_rad: Option<f64>,
}

/// `[planner]`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlannerTable {
    /// `"certified"`, `"adaptive"`, `"standard"`, `"grid"`, `"greedy"`, `"pursue"`, `"random"` or `"horizon"`.
    pub name: Option<String>,
    /// Node budget of the certified planner.
    pub nodes: Option<u64>,
    /// Iterations of the relaxations.
    pub iterations: Option<u64>,
    /// Relaxation factor of the adaptive relaxation.
    pub alpha: Option<f64>,
    /// Step of the grid search on the bearing, rad.
    pub step_rad: Option<f64>,
    /// Steps that the horizon planner looks ahead.
    pub steps: Option<u64>,
    /// Blocks of one heading each that the horizon planner divides them into.
    pub blocks: Option<u64>,
    /// Least distance of robots to the predicted target, m.
    pub stand_off_m: Option<f64>,
    /// The same as a multiple of the square root of the predicted position trace; the larger distance counts.
    pub stand_off_sigma: Option<f64>,
    /// Least distance of robots to each other, m.
    pub separation_m: Option<f64>,
    /// The quantity that planners minimise: `"trace"`, `"eigenvalue"` or `"determinant"` of the position covariance.
    pub criterion: Option<String>,
}

/// `[filter]`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FilterTable {
    /// A range is rejected when its innovation is more than this many standard deviations; `"none"` fuses all.
    pub gate_sigma: Option<GateKey>,
    /// Whether a robot whose ranges keep failing is distrusted; default: true if there is a gate.
    pub distrust: Option<bool>,
    /// Spectral density of the target's noise that the filter assumes; default: the target's own.
    pub noise_psd: Option<f64>,
    /// Standard deviation of a range that robots report to the filter, m; default: the robots' own.
    pub range_std_m: Option<f64>,
    /// Treatment of the errors of the robots' poses and biases: `"ignored"`, `"inflated"` or `"schmidt"`.
    pub nuisances: Option<String>,
    /// Which of them it estimates beside the target: `"bias"`, `"pose"`.
    pub estimate: Option<Vec<String>>,
}

/// `filter.gate_sigma`: standard deviations or `"none"`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged, expecting = "expected a number of standard deviations or \"none\"")]
pub enum GateKey {
    /// Standard deviations of the innovation.
    Sigma(f64),
    /// `"none"`.
    Word(String),
}

impl std::str::FromStr for GateKey {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let text = text.trim();
        if text == "none" {
            return Ok(Self::Word(text.to_owned()));
        }
        text.parse().map(Self::Sigma).map_err(|_| "expected a number of standard deviations or none".to_owned())
    }
}

/// `[recording]`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecordingTable {
    /// The ranges: a file, relative to the scenario file, a pipe, or `-` for standard input.
    pub ranges: Option<String>,
    /// Role and unit of each column: `time=stamp_ns:ns,sensor=anchor_id,range=dist:mm`.
    pub columns: Option<String>,
    /// Places of the sensors, a file relative to the scenario file: `sensor_id,x_m,y_m[,z_m]`.
    pub anchors: Option<String>,
    /// The target to read, if a log has several.
    pub target: Option<String>,
    /// The topics of a ROS 2 bag that have measurements: `/uwb/range`, `/robot_*/range,/robot_*/bearing`.
    pub topic: Option<String>,
    /// The topic of a ROS 2 bag that has the sensors' positions, and their field: `/odom`, `/robot_*/pose:pose.pose`.
    pub position: Option<String>,
    /// Message types that a bag does not define, each with the file of its definition: `my_msgs/msg/Uwb=Uwb.msg`.
    pub msg: Option<Vec<String>>,
    /// The radio's format, if the file is a log of its port.
    pub format: Option<String>,
    /// Reports per second of such a log, if it has no stamps.
    pub rate_hz: Option<f64>,
    /// The unit of such a log's stamps: `"s"`, `"ms"`, `"us"` or `"ns"`.
    pub stamp_unit: Option<String>,
    /// Refuse the file at its first faulty row.
    pub strict: Option<bool>,
    /// Height of the target in the recording's frame, m: ranges are then slant ranges.
    pub target_height_m: Option<f64>,
    /// Place of the target at the first range, `[x, y]` in m, if known.
    pub start_m: Option<[f64; 2]>,
    /// Standard deviation of each coordinate of this place, m.
    pub start_std_m: Option<f64>,
    /// Standard deviation of a range, m.
    pub range_std_m: Option<f64>,
    /// Standard deviation of a bearing, rad.
    pub bearing_std_rad: Option<f64>,
    /// Standard deviation of each coordinate of a sensor's position, m; at the start, if it drifts.
    pub pose_std_m: Option<f64>,
    /// Drift of each coordinate of a sensor's position, m per square root of a second.
    pub pose_drift_m: Option<f64>,
    /// Time for which an error of a sensor's pose stays, s.
    pub pose_correlation_s: Option<f64>,
    /// Standard deviation of a sensor's heading, rad.
    pub heading_std_rad: Option<f64>,
    /// Standard deviation of the bias that is left in a sensor's ranges, m.
    pub bias_std_m: Option<f64>,
    /// Bias B of all sensors in `measured = (1 + S) true + B`, m.
    pub bias_m: Option<f64>,
    /// Scale error S of all sensors.
    pub scale: Option<f64>,
    /// Sensors that differ from the rest.
    pub sensor: Option<Vec<RecordedSensorTable>>,
}

/// One `[[recording.sensor]]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecordedSensorTable {
    /// Name of the sensor in the recording: text or integer.
    pub id: SensorName,
    /// Its range standard deviation, m.
    pub range_std_m: Option<f64>,
    /// Its bias, m.
    pub bias_m: Option<f64>,
    /// Its scale error.
    pub scale: Option<f64>,
}

impl RecordedSensorTable {
    /// A sensor without differences from the rest.
    #[must_use]
    pub fn new(id: SensorName) -> Self {
        Self { id, range_std_m: None, bias_m: None, scale: None }
    }
}
