//! Defaults of a scenario's keys: the paper's experiment.

/// Scenario name.
pub const NAME: &str = "paper";
/// Time steps.
pub const TICKS: u64 = 200;
/// Length of a time step, s.
pub const DT_S: f64 = 0.1;
/// Seed.
pub const SEED: u64 = 5;
/// Clock of a simulated run.
pub const CLOCK: &str = "realtime";
/// Clock of a played-back recording: as fast as the processes can.
pub const RECORDING_CLOCK: &str = "lockstep";
/// Silence after which a robot is left out, s.
pub const TIMEOUT_S: f64 = 2.0;
/// Target model.
pub const MODEL: &str = "zero_acceleration";
/// Spectral density of the target's noise.
pub const NOISE_PSD: f64 = 10.0;
/// Target's true state at tick 0, as far as the model has one; accelerations start at zero.
pub const TARGET_START: [f64; 4] = [0.0, 0.0, -8.0, 4.0];
/// Prior mean.
pub const PRIOR_MEAN: &str = "drawn";
/// Prior variance of every state.
pub const PRIOR_VARIANCE: f64 = 10.0;
/// Robots.
pub const ROBOTS: u64 = 3;
/// Where robots start, m.
pub const ROBOT_START_M: [f64; 2] = [15.0, 0.0];
/// Robots' speed limit, m/s.
pub const SPEED_MPS: f64 = 10.0;
/// Standard deviation of a simulated range, m.
pub const RANGE_STD_M: f64 = 1.0;
/// Standard deviation of a recorded bearing, rad.
pub const RECORDED_BEARING_STD_RAD: f64 = 0.02;
/// Standard deviation of the bias of recorded ranges, if it is to be estimated, m.
pub const RECORDED_BIAS_STD_M: f64 = 0.5;
/// Planner.
pub const PLANNER: &str = "certified";
/// Node budget of the certified planner: far more than all but contrived problems need.
pub const NODES: u64 = 2_000;
/// Iterations of the relaxations.
pub const ITERATIONS: u64 = 20;
/// Relaxation factor.
pub const ALPHA: f64 = 0.5;
/// Step of the grid search, rad.
pub const GRID_STEP_RAD: f64 = std::f64::consts::PI / 200.0;
/// Steps that the horizon planner looks ahead.
pub const STEPS: u64 = 20;
/// Blocks of one heading each that the horizon planner divides them into.
pub const BLOCKS: u64 = 2;
/// Least distance of robots to the predicted target, in square roots of its predicted position trace,
/// if no distance is given. With 3, about 1 run in 10 000 loses or nearly loses the target and spoils the errors of all. With more than
/// 3.5, robots avoid a target that is poorly known at first, and the team takes longer to locate it.
pub const STAND_OFF_SIGMA: f64 = 3.5;
/// Standard deviation of a recorded range, m.
pub const RECORDED_RANGE_STD_M: f64 = 0.2;
/// Spectral density of the target's acceleration in a recording, m^2/s^3.
pub const RECORDED_ACCEL_PSD: f64 = 0.5;
/// Gate of a recording, and threshold of distrust if there is no gate: standard deviations of the innovation.
pub const RECORDED_GATE_SIGMA: f64 = 4.0;
/// Standard deviation of a start that is given without one, m: a careful tape measurement.
pub const RECORDED_START_STD_M: f64 = 0.5;
/// The target's velocity at a known start has the variance that its noise builds up in this time, s.
pub const RECORDED_START_S: f64 = 10.0;
