//! The scenario: one experiment, checked once, then trusted everywhere.
//!
//! [`ScenarioFile`] is the user's file; [`Scenario`] is what the nodes use. All its values
//! are within bounds that keep later arithmetic finite. No later code checks again.

pub mod bounds;
pub mod defaults;
mod error;
mod file;
mod recorded;
mod sensor;
#[cfg(test)]
mod tests;
mod validate;

use std::time::Duration;

use serde::{Deserialize, Serialize};

pub use error::ScenarioError;
pub use file::*;
pub use recorded::{COPY, RecordedRanges};
pub use sensor::{Calibration, EXACT, NuisanceSpec, OWN, PoseCorrelation, RangeNoise, SensorSpec, Treatment};

use crate::ROBOTS_MAX;
use crate::motion::MotionModel;
use crate::motion::matrix::Matrix;

/// A validated experiment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Scenario {
    /// Name, for display.
    pub name: String,
    /// Time steps after tick 0.
    pub ticks: u64,
    /// Length of a time step, s; a recording brings its own time stamps.
    pub dt_s: f64,
    /// Seed of all random numbers.
    pub seed: u64,
    /// The condition for the next tick.
    pub clock: Clock,
    /// How long to wait for a silent robot.
    pub timeout: Timeout,
    /// The target's motion model.
    pub motion: MotionModel,
    /// The motion model of the filter: the target's own, unless the scenario gives the filter another noise.
    pub filter_motion: MotionModel,
    /// The source of the measurements.
    pub source: Source,
    /// True if robots with drivers of their own measure a real target. Nobody knows the truth then.
    pub has_real_target: bool,
    /// Fusion's knowledge before the first range.
    pub prior: Prior,
    /// The team, by id.
    pub robots: Vec<RobotSpec>,
    /// The planner.
    pub planner: PlannerSpec,
    /// The clearances that robots keep.
    pub clearance: Clearance,
    /// Gate on a single range: rejected when its innovation is more than this many of its standard
    /// deviations, that is when its chi-square statistic (one degree of freedom) is above the
    /// square. `None`: every range is fused, as in the paper.
    pub gate_sigma: Option<f64>,
    /// Whether a robot whose ranges keep failing is distrusted: its ranges are only tested, against the default gate if there is none.
    pub distrust: bool,
    /// The filter's treatment of the robots' nuisances.
    pub treatment: Treatment,
    /// The criterion that a planner minimises.
    pub criterion: Criterion,
}

/// The condition for the next tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Clock {
    /// Every dt of wall time, even if messages are missing.
    Realtime,
    /// As soon as all robots have answered.
    Lockstep,
}

/// How long to wait for a silent robot in lock step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Timeout {
    /// The robot is left out after this silence, until it sends again.
    After(Duration),
    /// The robot is never left out.
    Forever,
}

/// The source of the ranges.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[allow(clippy::large_enum_variant, reason = "one for each run")]
pub enum Source {
    /// A simulated target.
    Simulated {
        /// Its true state at tick 0.
        target_start: Vec<f64>,
    },
    /// Recorded ranges.
    Recorded(RecordedRanges),
}

/// Fusion's knowledge before the first range.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Prior {
    /// N(mean, covariance).
    Gaussian {
        /// Mean of the state.
        mean: Vec<f64>,
        /// P_0|0.
        covariance: Matrix,
    },
    /// No prior: the first ranges initialise the filter.
    FromRanges,
}

/// One robot (or recorded sensor).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RobotSpec {
    /// Name for display: its id, or its sensor's id in the recording.
    pub label: String,
    /// Start, m.
    pub start_m: [f64; 2],
    /// Speed limit, m/s.
    pub speed_mps: f64,
    /// Its sensor, with the noise after calibration.
    pub sensor: SensorSpec,
    /// The same as reported to the filter: the true one, unless the scenario gives the filter another.
    pub reported: SensorSpec,
    /// Its sensor's systematic error.
    pub calibration: Calibration,
    /// The errors of its pose, and those of its sensor that stay from one measurement to the next.
    pub nuisances: NuisanceSpec,
}

/// The planner.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum PlannerSpec {
    /// The global optimum, with a certificate.
    Certified {
        /// Most nodes of the branch and bound.
        nodes: u32,
    },
    /// The paper's adaptive relaxation (28)-(29).
    Adaptive {
        /// Cycles over all robots.
        iterations: u32,
        /// Relaxation factor, 0 to 1.
        alpha: f64,
    },
    /// Standard relaxation: adaptive with factor 0.
    Standard {
        /// Cycles over all robots.
        iterations: u32,
    },
    /// Exhaustive search on a grid of bearings.
    Grid {
        /// Step, rad.
        step_rad: f64,
    },
    /// Each robot by itself, with its teammates at their current places.
    Greedy,
    /// Straight to the predicted target.
    Pursue,
    /// Uniformly random headings.
    Random,
    /// Headings that are best over several steps.
    Horizon {
        /// Steps that it looks ahead.
        steps: u32,
        /// Blocks of steps, each of which has one heading.
        blocks: u32,
    },
}

/// The clearances that robots keep; zero means none, as in the paper.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Clearance {
    /// Least distance to the predicted target, m.
    pub stand_off_m: f64,
    /// The same as a multiple of the square root of the predicted position trace; the larger distance counts.
    pub stand_off_sigma: f64,
    /// Least distance of robots to each other, m.
    pub separation_m: f64,
}

/// The criterion that a planner minimises, of the covariance of the target's position after the next measurements.
///
/// Teams that measure ranges of constant noise alone have the same best plans by all three.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Criterion {
    /// Its trace, m^2.
    #[default]
    Trace,
    /// Its largest eigenvalue, m^2.
    Eigenvalue,
    /// Its determinant, m^4.
    Determinant,
}

impl Criterion {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Trace, Self::Eigenvalue, Self::Determinant];

    /// The name in problems.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Trace => "trace",
            Self::Eigenvalue => "eigenvalue",
            Self::Determinant => "determinant",
        }
    }
}

/// The planners' names.
pub const PLANNERS: [&str; 8] = ["certified", "adaptive", "standard", "grid", "greedy", "pursue", "random", "horizon"];

/// The alternative to the grid search for teams that are not [range-only](Scenario::is_range_only).
pub const GRID_INSTEAD: &str = "another planner, such as certified: grid serves only ranges of constant noise, measured by \
                                robots that know where they are";

impl Scenario {
    /// True if all robots measure ranges of constant noise alone, and the filter takes their positions as exact: the problem
    /// of the paper.
    #[must_use]
    pub fn is_range_only(&self) -> bool {
        self.robots.iter().all(|robot| {
            let NuisanceSpec { pose_std_m, pose_drift_m, .. } = robot.nuisances;
            let is_exact = pose_std_m == 0.0 && pose_drift_m == 0.0 || self.treatment == Treatment::Ignored;
            robot.reported.constant_range_std_m().is_some() && is_exact
        })
    }
}

impl PlannerSpec {
    /// The name in scenarios and on the command line.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Certified { .. } => "certified",
            Self::Adaptive { .. } => "adaptive",
            Self::Standard { .. } => "standard",
            Self::Grid { .. } => "grid",
            Self::Greedy => "greedy",
            Self::Pursue => "pursue",
            Self::Random => "random",
            Self::Horizon { .. } => "horizon",
        }
    }
}

impl Clock {
    /// The name in scenarios and on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Realtime => "realtime",
            Self::Lockstep => "lockstep",
        }
    }
}

/// The displayed name of a robot, or of a recording's sensor.
#[must_use]
pub fn name_of(robot: usize, sensor: Option<&str>) -> String {
    sensor.map_or_else(|| format!("robot {robot}"), |sensor| format!("sensor {}", printable(sensor)))
}

/// A node's name with its sensor's name, if it has one: `robot-0 (2938)`.
#[must_use]
pub fn title_of(node: &str, sensor: Option<&str>) -> String {
    sensor.map_or_else(|| node.to_owned(), |sensor| format!("{node} ({})", printable(sensor)))
}

/// A name that is safe in a line of text: characters that move the cursor or change the writing direction are escaped.
#[must_use]
pub fn printable(name: &str) -> String {
    let is_unseen = |c: char| {
        let marks = ['\u{61c}', '\u{feff}'];
        let ranges = ['\u{200b}'..='\u{200f}', '\u{2028}'..='\u{202e}', '\u{2060}'..='\u{206f}'];
        c.is_control() || marks.contains(&c) || ranges.iter().any(|range| range.contains(&c))
    };
    let mut text = String::with_capacity(name.len());
    for c in name.chars() {
        if is_unseen(c) { text.extend(c.escape_unicode()) } else { text.push(c) }
    }
    text
}

impl Scenario {
    /// The displayed name of a robot: `robot 0`, or `sensor NAME` by its name in the recording.
    #[must_use]
    pub fn name_of(&self, id: usize) -> String {
        name_of(id, self.sensor_of(id))
    }

    /// A robot's name in the recording, as in the file; `None` in a simulated run.
    #[must_use]
    pub fn sensor_of(&self, id: usize) -> Option<&str> {
        let robot = self.robots.get(id)?;
        matches!(self.source, Source::Recorded(_)).then_some(&robot.label)
    }

    /// True if the simulator knows where the target is.
    #[must_use]
    pub fn has_truth(&self) -> bool {
        matches!(self.source, Source::Simulated { .. }) && !self.has_real_target
    }

    /// True if all sizes are consistent and all divisors and clamps are within their bounds. Code that uses a
    /// scenario from an untrusted file then does not panic.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        let n = self.motion.state_dim();
        let knows_its_start = match &self.source {
            Source::Simulated { target_start } => target_start.len() == n,
            Source::Recorded { .. } => true,
        };
        let knows_its_prior = match &self.prior {
            Prior::Gaussian { mean, covariance } => {
                mean.len() == n && mean.iter().all(|value| value.is_finite()) && covariance.is_complete(n)
            }
            Prior::FromRanges => true,
        };
        let is_valid = |robot: &RobotSpec| {
            bounds::SPEED_MPS.contains(&robot.speed_mps)
                && robot.sensor.is_complete()
                && robot.reported.is_complete()
                && robot.nuisances.is_complete()
                && robot.start_m.iter().all(|value| value.is_finite())
                && bounds::BIAS_M.contains(&robot.calibration.bias_m)
                && bounds::SCALE.contains(&robot.calibration.scale)
        };
        self.motion.is_complete()
            && self.filter_motion.is_complete()
            && self.filter_motion.state_dim() == n
            && knows_its_start
            && knows_its_prior
            && (1..=ROBOTS_MAX).contains(&self.robots.len())
            && self.robots.iter().all(is_valid)
            && bounds::DT_S.contains(&self.dt_s)
            && self.ticks <= bounds::TICKS_MAX
    }
}

/// The problem and the expected text, from a message such as "unknown field `a`, expected `b`".
fn split_message(error: &toml::de::Error) -> (String, Option<String>) {
    let message = error.message().lines().collect::<Vec<_>>().join("; ");
    let (problem, expected) = match message.strip_prefix("expected ") {
        Some(expected) => ("invalid value", Some(expected)),
        None => message.split_once(", expected ").map_or((message.as_str(), None), |(a, b)| (a, Some(b))),
    };
    let expected = expected.map(|expected| match expected {
        "u64" => "a whole number".to_owned(),
        "f64" => "a number".to_owned(),
        // An earlier name, which still works.
        other => other.replace("`patience_s`, ", ""),
    });
    (problem.to_owned(), expected)
}

impl ScenarioFile {
    /// Parses the text of a scenario file without checking its values; `file` names it in errors.
    ///
    /// # Errors
    /// If it is not TOML, has an unknown key or a value of the wrong type.
    pub fn parse(text: &str, file: &str) -> Result<Self, ScenarioError> {
        let file = file.to_owned();
        let line_of = |error: &toml::de::Error| {
            error.span().map_or(1, |span| 1 + text[..span.start.min(text.len())].matches('\n').count())
        };
        let document = toml::Deserializer::parse(text).map_err(|error| {
            let (problem, expected) = split_message(&error);
            let expected = expected.map_or("valid TOML".to_owned(), |expected| format!("valid TOML, {expected}"));
            ScenarioError::NotToml { file: file.clone(), line: line_of(&error), problem, expected }
        })?;
        serde_path_to_error::deserialize(document).map_err(|error| {
            let key = error.path().to_string();
            let key = if key == "." { "top level".to_owned() } else { key };
            let (problem, expected) = split_message(error.inner());
            let expected = expected.unwrap_or_else(|| "another value".to_owned());
            ScenarioError::WrongKey { file: file.clone(), line: line_of(error.inner()), key, problem, expected }
        })
    }

    /// The file's text.
    ///
    /// # Errors
    /// If a value cannot be written as TOML.
    pub fn to_toml(&self) -> Result<String, toml::ser::Error> {
        toml::to_string(self)
    }
}
