//! From the file's keys to a [`Scenario`]: defaults filled in, every value checked.

use std::fmt::Display;
use std::ops::RangeInclusive;
use std::time::Duration;

use super::bounds::{
    BIAS_M, CLEARANCE, COORDINATE, DT_S, GATE_SIGMA, MATRIX_ENTRY, NOISE_PSD, PATIENCE_S, RELATIVE_EIGENVALUE_MIN,
    SCALE, SPEED_MPS, START_STD_M, STATE, STD_M, TICKS_MAX, VARIANCE,
};
use super::{
    Calibration, Clearance, Clock, CovarianceKey, FilterTable, GateKey, MeanKey, PLANNERS, Patience, PatienceKey,
    PlannerSpec, PlannerTable, Prior, PriorTable, RecordedRanges, RecordingTable, RobotSpec, RobotTable, RobotsTable,
    Scenario, ScenarioError, ScenarioFile, Source, TargetTable, defaults,
};
use crate::draws::{Draws, Stream};
use crate::matrix::{Matrix, square_root};
use crate::motion::MotionModel;
use crate::recording::{ReadSummary, Recording};
use crate::run_name::RunName;
use crate::{ROBOTS_MAX, STATE_DIM_MAX, with_state_dim};

impl Scenario {
    /// Checks the scenario file of a simulated run. `file` names it in errors.
    ///
    /// # Errors
    /// [`ScenarioError`] for the first thing that is wrong; a recording, which [`Self::from_file_with`] takes, among it.
    pub fn from_file(raw: &ScenarioFile, file: &str) -> Result<Self, ScenarioError> {
        Self::from_file_with(raw, file, |_| {
            Err(Checker { file }.refuse("recording", "a simulated run", "a recorded one"))
        })
    }

    /// Checks a scenario file. `file` names it in errors. If it names a recording, that is read once all is checked that
    /// can be without it: reading may take long, and a pipe can be read once.
    ///
    /// # Errors
    /// [`ScenarioError`] for the first thing that is wrong.
    pub fn from_file_with(
        raw: &ScenarioFile,
        file: &str,
        read: impl FnOnce(&RecordingTable) -> Result<(Recording, ReadSummary), ScenarioError>,
    ) -> Result<Self, ScenarioError> {
        Checker { file }.scenario(raw, read)
    }
}

impl PlannerSpec {
    /// Checks what a `[planner]` table says of the planner itself. `file` names it in errors.
    ///
    /// # Errors
    /// [`ScenarioError`] for the first thing that is wrong.
    pub fn from_table(table: &PlannerTable, file: &str) -> Result<Self, ScenarioError> {
        Checker { file }.planner(table)
    }
}

impl Clearance {
    /// Checks what a `[planner]` table says of clearances. `file` names it in errors.
    ///
    /// # Errors
    /// [`ScenarioError`] for the first thing that is wrong.
    pub fn from_table(table: &PlannerTable, file: &str) -> Result<Self, ScenarioError> {
        Checker { file }.clearance(table)
    }
}

/// Checks values and names the file in what it refuses.
struct Checker<'a> {
    file: &'a str,
}

impl Checker<'_> {
    fn scenario(
        &self,
        raw: &ScenarioFile,
        read: impl FnOnce(&RecordingTable) -> Result<(Recording, ReadSummary), ScenarioError>,
    ) -> Result<Scenario, ScenarioError> {
        let name = raw.name.clone().unwrap_or_else(|| defaults::NAME.to_owned());
        if let Err(problem) = name.parse::<RunName>() {
            return Err(self.refuse("name", problem.expected(), name));
        }
        let seed = raw.seed.unwrap_or(defaults::SEED);
        let dt_s = self.number("dt_s", raw.dt_s, defaults::DT_S, DT_S)?;
        let motion = self.motion(&raw.target.clone().unwrap_or_default(), raw.recording.is_some())?;
        let planner = raw.planner.clone().unwrap_or_default();
        let gate_sigma = self.gate(raw)?;
        let mut scenario = Scenario {
            name,
            ticks: self.whole("ticks", raw.ticks, defaults::TICKS, 1..=TICKS_MAX)?,
            dt_s,
            seed,
            clock: self.clock(raw)?,
            patience: self.patience(raw.patience_s.as_ref())?,
            filter_motion: motion.clone(),
            motion,
            source: Source::Simulated { target_start: Vec::new() },
            prior: Prior::FromRanges,
            robots: Vec::new(),
            planner: self.planner(&planner)?,
            clearance: self.clearance(&planner)?,
            gate_sigma,
            distrust: raw.filter.as_ref().and_then(|table| table.distrust).unwrap_or(gate_sigma.is_some()),
        };
        if let Some(recording) = &raw.recording {
            self.recorded(raw, recording, read, &mut scenario)?;
        } else {
            let n = scenario.motion.state_dim();
            let target_start = self.target_start(raw.target.as_ref().and_then(|table| table.start.as_ref()), n)?;
            scenario.prior = self.prior(&raw.prior.clone().unwrap_or_default(), &target_start, seed)?;
            scenario.source = Source::Simulated { target_start };
            scenario.robots = self.team(raw.robots.as_ref(), raw.robot.as_deref())?;
            self.tell_filter(&raw.filter.clone().unwrap_or_default(), &mut scenario)?;
        }
        Ok(scenario)
    }

    /// Gives the filter of a simulation another noise than the truth has.
    fn tell_filter(&self, table: &FilterTable, scenario: &mut Scenario) -> Result<(), ScenarioError> {
        if let Some(psd) = table.noise_psd {
            let psd = self.number("filter.noise_psd", Some(psd), psd, NOISE_PSD)?;
            let MotionModel::IntegratorChain { noise_psd, .. } = &mut scenario.filter_motion else {
                return Err(self.refuse("filter.noise_psd", "no spectral density beside target.qd", "one"));
            };
            *noise_psd = psd;
        }
        if let Some(std_m) = table.range_std_m {
            let std_m = self.number("filter.range_std_m", Some(std_m), std_m, STD_M)?;
            scenario.robots.iter_mut().for_each(|robot| robot.told_std_m = std_m);
        }
        Ok(())
    }

    fn recorded(
        &self,
        raw: &ScenarioFile,
        table: &RecordingTable,
        read: impl FnOnce(&RecordingTable) -> Result<(Recording, ReadSummary), ScenarioError>,
        scenario: &mut Scenario,
    ) -> Result<(), ScenarioError> {
        let simulated_only = [
            ("robots", raw.robots.is_some()),
            ("robot", raw.robot.is_some()),
            ("prior", raw.prior.is_some()),
            ("planner", raw.planner.is_some()),
            ("target.start", raw.target.as_ref().is_some_and(|target| target.start.is_some())),
        ];
        if let Some((key, _)) = simulated_only.iter().find(|(_, present)| *present) {
            return Err(self.refuse(key, "no such key beside [recording], whose ranges tell", "one"));
        }
        let filter = raw.filter.as_ref();
        for (key, instead, present) in [
            ("filter.noise_psd", "target.noise_psd", filter.is_some_and(|filter| filter.noise_psd.is_some())),
            ("filter.range_std_m", "recording.range_std_m", filter.is_some_and(|filter| filter.range_std_m.is_some())),
        ] {
            if present {
                return Err(self.refuse(key, format!("{instead} in a scenario with [recording]"), "this key"));
            }
        }
        let height = |height_m| self.number("recording.target_height_m", Some(height_m), height_m, COORDINATE);
        let target_height_m = table.target_height_m.map(height).transpose()?;
        let prior = self.known_start(table, &scenario.motion)?;
        let (recording, summary) = read(table)?;
        if target_height_m.is_some() {
            self.look_for_heights(&recording)?;
        }
        scenario.prior = prior;
        let std_m = self.number("recording.range_std_m", table.range_std_m, defaults::RECORDED_RANGE_STD_M, STD_M)?;
        let bias_m = self.number("recording.bias_m", table.bias_m, 0.0, BIAS_M)?;
        let scale = self.number("recording.scale", table.scale, 0.0, SCALE)?;
        scenario.robots = recording
            .sensors()
            .iter()
            .map(|sensor| RobotSpec {
                label: sensor.name.to_string(),
                start_m: sensor.first_position_m,
                speed_mps: 0.0,
                range_std_m: std_m,
                told_std_m: std_m,
                calibration: Calibration { bias_m, scale },
            })
            .collect();
        let special = table.sensor.as_deref().unwrap_or_default();
        for (index, sensor) in special.iter().enumerate() {
            let key = |name: &str| format!("recording.sensor[{index}].{name}");
            let Some(robot) = recording.sensors().iter().position(|known| known.name == sensor.id) else {
                let known: Vec<String> = recording.sensors().iter().map(|known| known.name.to_string()).collect();
                let expected = format!("a sensor of the recording ({})", known.join(", "));
                return Err(self.refuse(&key("id"), expected, &sensor.id));
            };
            if special[..index].iter().any(|before| before.id == sensor.id) {
                return Err(self.refuse(&key("id"), "each sensor once", format!("{} twice", sensor.id)));
            }
            let robot = &mut scenario.robots[robot];
            robot.range_std_m = self.number(&key("range_std_m"), sensor.range_std_m, std_m, STD_M)?;
            robot.told_std_m = robot.range_std_m;
            robot.calibration.bias_m = self.number(&key("bias_m"), sensor.bias_m, bias_m, BIAS_M)?;
            robot.calibration.scale = self.number(&key("scale"), sensor.scale, scale, SCALE)?;
        }
        scenario.ticks = raw.ticks.map_or(u64::MAX, |_| scenario.ticks).min(recording.len() as u64);
        scenario.source = Source::Recorded(RecordedRanges::new(recording, summary, target_height_m));
        Ok(())
    }

    /// What is known before the first range: the start that is given, or nothing.
    fn known_start(&self, table: &RecordingTable, motion: &MotionModel) -> Result<Prior, ScenarioError> {
        let Some(start_m) = table.start_m else {
            return match table.start_std_m {
                None => Ok(Prior::FromRanges),
                Some(_) => Err(self.refuse("recording.start_m", "a place [x, y] beside start_std_m", "nothing")),
            };
        };
        self.point("recording.start_m", Some(start_m))?;
        let std_m =
            self.number("recording.start_std_m", table.start_std_m, defaults::RECORDED_START_STD_M, START_STD_M)?;
        let n = motion.state_dim();
        // As wide as the start from ranges has it: what the noise drives up in a manoeuvre's time, a walk at the least.
        let noise_psd = match motion {
            MotionModel::IntegratorChain { noise_psd, .. } => *noise_psd,
            MotionModel::Custom { .. } => 0.0,
        };
        let rate_variance = (noise_psd * defaults::RECORDED_START_S).max(1.0);
        // Position first, then its rates of change.
        let variance = |i: usize| if i < 2 { std_m * std_m } else { rate_variance };
        Ok(Prior::Gaussian {
            mean: (0..n).map(|i| start_m.get(i).copied().unwrap_or(0.0)).collect(),
            covariance: Matrix::from_diagonal(&(0..n).map(variance).collect::<Vec<f64>>()),
        })
    }

    /// A height of the target needs one of every sensor.
    fn look_for_heights(&self, recording: &Recording) -> Result<(), ScenarioError> {
        let mut readings = (0..recording.len()).filter_map(|index| recording.instant(index)).flat_map(|(_, of)| of);
        match readings.find(|reading| reading.height_m.is_none()) {
            None => Ok(()),
            Some(reading) => {
                let name = recording.sensors().get(reading.sensor).map_or("?", |sensor| sensor.name.as_str());
                let expected = "the height of every sensor beside it (a column sensor_z_m, or z_m in the anchors file)";
                let got = format!("none for sensor {name}");
                Err(self.refuse("recording.target_height_m", expected, got))
            }
        }
    }

    fn clock(&self, raw: &ScenarioFile) -> Result<Clock, ScenarioError> {
        let default = if raw.recording.is_some() { defaults::RECORDING_CLOCK } else { defaults::CLOCK };
        match raw.clock.as_deref().unwrap_or(default) {
            "realtime" => Ok(Clock::Realtime),
            "lockstep" => Ok(Clock::Lockstep),
            other => Err(self.refuse("clock", "\"realtime\" or \"lockstep\"", quoted(other))),
        }
    }

    fn patience(&self, key: Option<&PatienceKey>) -> Result<Patience, ScenarioError> {
        match key {
            None => Ok(Patience::After(Duration::from_secs_f64(defaults::PATIENCE_S))),
            Some(PatienceKey::Word(word)) if word == "forever" => Ok(Patience::Forever),
            Some(PatienceKey::Seconds(seconds)) if PATIENCE_S.contains(seconds) => {
                Ok(Patience::After(Duration::from_secs_f64(*seconds)))
            }
            Some(PatienceKey::Word(word)) => Err(self.refuse("patience_s", patience_expected(), quoted(word))),
            Some(PatienceKey::Seconds(seconds)) => Err(self.refuse("patience_s", patience_expected(), seconds)),
        }
    }

    fn gate(&self, raw: &ScenarioFile) -> Result<Option<f64>, ScenarioError> {
        let default = raw.recording.as_ref().map(|_| defaults::RECORDED_GATE_SIGMA);
        let key = "filter.gate_sigma";
        match raw.filter.as_ref().and_then(|table| table.gate_sigma.as_ref()) {
            None => Ok(default),
            Some(GateKey::Word(word)) if word == "none" => Ok(None),
            Some(GateKey::Word(word)) => {
                let expected = format!("a number from {} to {} or \"none\"", GATE_SIGMA.start(), GATE_SIGMA.end());
                Err(self.refuse(key, expected, quoted(word)))
            }
            Some(GateKey::Sigma(sigma)) => self.number(key, Some(*sigma), *sigma, GATE_SIGMA).map(Some),
        }
    }

    fn motion(&self, table: &TargetTable, recorded: bool) -> Result<MotionModel, ScenarioError> {
        let name = table.model.as_deref().unwrap_or(defaults::MODEL);
        let order = match name {
            "random_walk" => 1,
            "zero_acceleration" => 2,
            "constant_acceleration" => 3,
            "custom" if !recorded => return self.custom_motion(table),
            other => {
                let custom = if recorded { "" } else { ", \"custom\"" };
                let known = format!("\"random_walk\", \"zero_acceleration\", \"constant_acceleration\"{custom}");
                return Err(self.refuse("target.model", format!("one of {known}"), quoted(other)));
            }
        };
        for (key, given) in [("phi", table.phi.is_some()), ("g", table.g.is_some()), ("qd", table.qd.is_some())] {
            if given {
                return Err(self.refuse(&format!("target.{key}"), "no matrix unless model = \"custom\"", "one"));
            }
        }
        let default = if recorded { defaults::RECORDED_ACCEL_PSD } else { defaults::NOISE_PSD };
        let noise_psd = self.number("target.noise_psd", table.noise_psd, default, NOISE_PSD)?;
        Ok(MotionModel::IntegratorChain { order, noise_psd })
    }

    fn custom_motion(&self, table: &TargetTable) -> Result<MotionModel, ScenarioError> {
        if table.noise_psd.is_some() {
            return Err(self.refuse("target.noise_psd", "no spectral density beside target.qd", "one"));
        }
        let phi = self.matrix("target.phi", table.phi.as_deref())?;
        let n = phi.shape().0;
        if phi.shape().1 != n || !(2..=STATE_DIM_MAX).contains(&n) {
            let (rows, columns) = phi.shape();
            let expected = format!("a square matrix of size 2 to {STATE_DIM_MAX}");
            return Err(self.refuse("target.phi", expected, format!("{rows} x {columns}")));
        }
        let qd = self.matrix("target.qd", table.qd.as_deref())?;
        if qd.relative_min_eigenvalue().is_none_or(|minimum| minimum < -1e-12) {
            return Err(self.refuse("target.qd", "a symmetric positive semi-definite matrix", "another"));
        }
        let g = match table.g.as_deref() {
            None => Matrix::from_diagonal(&vec![1.0; n]),
            rows => self.matrix("target.g", rows)?,
        };
        if g.shape() != (n, qd.shape().0) {
            let expected = format!("{n} rows (as phi) of {} numbers (as qd)", qd.shape().0);
            return Err(self.refuse("target.g", expected, format!("{} x {}", g.shape().0, g.shape().1)));
        }
        Ok(MotionModel::Custom { phi, process_noise: qd.congruence(&g) })
    }

    fn target_start(&self, start: Option<&Vec<f64>>, n: usize) -> Result<Vec<f64>, ScenarioError> {
        match start {
            Some(state) => self.state("target.start", state, n),
            None => Ok((0..n).map(|i| defaults::TARGET_START.get(i).copied().unwrap_or(0.0)).collect()),
        }
    }

    fn prior(&self, table: &PriorTable, target_start: &[f64], seed: u64) -> Result<Prior, ScenarioError> {
        let n = target_start.len();
        let key = "prior.covariance";
        let covariance = match table.covariance.as_ref().unwrap_or(&CovarianceKey::Scalar(defaults::PRIOR_VARIANCE)) {
            CovarianceKey::Scalar(variance) => {
                Matrix::from_diagonal(&vec![self.number(key, Some(*variance), *variance, VARIANCE)?; n])
            }
            CovarianceKey::Diagonal(variances) if variances.len() == n => {
                for variance in variances {
                    self.number(key, Some(*variance), *variance, VARIANCE)?;
                }
                Matrix::from_diagonal(variances)
            }
            CovarianceKey::Rows(rows) if rows.len() == n => self.matrix(key, Some(rows))?,
            CovarianceKey::Diagonal(list) => return Err(self.refuse(key, per_state(n, "variance"), list.len())),
            CovarianceKey::Rows(rows) => return Err(self.refuse(key, per_state(n, "row"), rows.len())),
        };
        match covariance.relative_min_eigenvalue() {
            Some(minimum) if minimum > RELATIVE_EIGENVALUE_MIN => {}
            Some(_) => return Err(self.refuse(key, "a positive definite matrix", "an indefinite or singular one")),
            None => return Err(self.refuse(key, "a symmetric matrix", "an asymmetric one")),
        }
        let mean = match table.mean.as_ref().unwrap_or(&MeanKey::Word(defaults::PRIOR_MEAN.to_owned())) {
            MeanKey::Word(word) if word == "start" => target_start.to_vec(),
            MeanKey::Word(word) if word == "drawn" => drawn_mean(target_start, &covariance, seed),
            MeanKey::Word(word) => {
                return Err(self.refuse("prior.mean", "\"drawn\", \"start\" or a list of numbers", quoted(word)));
            }
            MeanKey::State(state) => self.state("prior.mean", state, n)?,
        };
        Ok(Prior::Gaussian { mean, covariance })
    }

    fn team(&self, alike: Option<&RobotsTable>, each: Option<&[RobotTable]>) -> Result<Vec<RobotSpec>, ScenarioError> {
        match (alike, each) {
            (Some(_), Some(_)) => {
                Err(self.refuse("robots", "either [robots] with a count or a [[robot]] for each", "both"))
            }
            (alike, None) => self.alike_team(&alike.cloned().unwrap_or_default()),
            (None, Some(tables)) => self.mixed_team(tables),
        }
    }

    fn alike_team(&self, table: &RobotsTable) -> Result<Vec<RobotSpec>, ScenarioError> {
        let count = self.whole("robots.count", table.count, defaults::ROBOTS, 1..=ROBOTS_MAX as u64)?;
        let centre_m = self.point("robots.start_m", table.start_m)?;
        let radius_m = self.number("robots.ring_radius_m", table.ring_radius_m, 0.0, 0.0..=1e6)?;
        let speed_mps = self.number("robots.speed_mps", table.speed_mps, defaults::SPEED_MPS, SPEED_MPS)?;
        let range_std_m = self.number("robots.range_std_m", table.range_std_m, defaults::RANGE_STD_M, STD_M)?;
        Ok((0..count)
            .map(|id| {
                let (sin, cos) = (std::f64::consts::TAU * id as f64 / count as f64).sin_cos();
                RobotSpec {
                    label: id.to_string(),
                    start_m: [centre_m[0] + radius_m * cos, centre_m[1] + radius_m * sin],
                    speed_mps,
                    range_std_m,
                    told_std_m: range_std_m,
                    calibration: Calibration::default(),
                }
            })
            .collect())
    }

    fn mixed_team(&self, tables: &[RobotTable]) -> Result<Vec<RobotSpec>, ScenarioError> {
        let count = tables.len();
        if !(1..=ROBOTS_MAX).contains(&count) {
            return Err(self.refuse("robot", format!("1 to {ROBOTS_MAX} robots"), count));
        }
        let mut robots: Vec<Option<RobotSpec>> = vec![None; count];
        for (index, table) in tables.iter().enumerate() {
            let key = |name: &str| format!("robot[{index}].{name}");
            let id = table.id.unwrap_or(index as u64);
            let Some(slot) = usize::try_from(id).ok().and_then(|id| robots.get_mut(id)) else {
                return Err(self.refuse(&key("id"), format!("an id from 0 to {}", count - 1), id));
            };
            if slot.is_some() {
                return Err(self.refuse(&key("id"), "each id once", format!("{id} twice")));
            }
            let range_std_m = self.number(&key("range_std_m"), table.range_std_m, defaults::RANGE_STD_M, STD_M)?;
            *slot = Some(RobotSpec {
                label: id.to_string(),
                start_m: self.point(&key("start_m"), table.start_m)?,
                speed_mps: self.number(&key("speed_mps"), table.speed_mps, defaults::SPEED_MPS, SPEED_MPS)?,
                range_std_m,
                told_std_m: range_std_m,
                calibration: Calibration::default(),
            });
        }
        Ok(robots.into_iter().flatten().collect())
    }

    fn planner(&self, table: &PlannerTable) -> Result<PlannerSpec, ScenarioError> {
        let iterations =
            self.whole("planner.iterations", table.iterations, defaults::ITERATIONS, 1..=1_000_000)? as u32;
        let alpha = self.number("planner.alpha", table.alpha, defaults::ALPHA, 0.0..=1.0)?;
        let step_rad =
            self.number("planner.step_rad", table.step_rad, defaults::GRID_STEP_RAD, 1e-6..=std::f64::consts::PI)?;
        let nodes = self.whole("planner.nodes", table.nodes, defaults::NODES, 1..=1_000_000)? as u32;
        match table.name.as_deref().unwrap_or(defaults::PLANNER) {
            "certified" => Ok(PlannerSpec::Certified { nodes }),
            "adaptive" => Ok(PlannerSpec::Adaptive { iterations, alpha }),
            "standard" => Ok(PlannerSpec::Standard { iterations }),
            "grid" => Ok(PlannerSpec::Grid { step_rad }),
            "greedy" => Ok(PlannerSpec::Greedy),
            "pursue" => Ok(PlannerSpec::Pursue),
            "random" => Ok(PlannerSpec::Random),
            other => {
                let known = PLANNERS.map(quoted).join(", ");
                Err(self.refuse("planner.name", format!("one of {known}"), quoted(other)))
            }
        }
    }

    fn clearance(&self, table: &PlannerTable) -> Result<Clearance, ScenarioError> {
        let least = |key: &str, value, default| self.number(key, value, default, CLEARANCE);
        // Who asks for one measure does not get the default of the other on top.
        let stand_off_sigma = if table.stand_off_m.is_some() { 0.0 } else { defaults::STAND_OFF_SIGMA };
        Ok(Clearance {
            stand_off_m: least("planner.stand_off_m", table.stand_off_m, 0.0)?,
            stand_off_sigma: least("planner.stand_off_sigma", table.stand_off_sigma, stand_off_sigma)?,
            separation_m: least("planner.separation_m", table.separation_m, 0.0)?,
        })
    }

    fn point(&self, key: &str, value: Option<[f64; 2]>) -> Result<[f64; 2], ScenarioError> {
        let point = value.unwrap_or(defaults::ROBOT_START_M);
        for coordinate in point {
            self.number(key, Some(coordinate), coordinate, COORDINATE)?;
        }
        Ok(point)
    }

    fn state(&self, key: &str, state: &[f64], n: usize) -> Result<Vec<f64>, ScenarioError> {
        if state.len() != n {
            return Err(self.refuse(key, per_state(n, "number"), state.len()));
        }
        for value in state {
            self.number(key, Some(*value), *value, STATE)?;
        }
        Ok(state.to_vec())
    }

    fn matrix(&self, key: &str, rows: Option<&[Vec<f64>]>) -> Result<Matrix, ScenarioError> {
        let Some(rows) = rows else {
            return Err(self.refuse(key, "a matrix as a list of rows", "nothing"));
        };
        for value in rows.iter().flatten() {
            self.number(key, Some(*value), *value, MATRIX_ENTRY)?;
        }
        Matrix::from_rows(rows).ok_or_else(|| self.refuse(key, "a matrix with rows of one length", "none"))
    }

    fn number(
        &self,
        key: &str,
        value: Option<f64>,
        default: f64,
        bounds: RangeInclusive<f64>,
    ) -> Result<f64, ScenarioError> {
        let value = value.unwrap_or(default);
        if bounds.contains(&value) {
            Ok(value)
        } else {
            let expected = format!("a number from {} to {}", bounds.start(), bounds.end());
            Err(self.refuse(key, expected, value))
        }
    }

    fn whole(
        &self,
        key: &str,
        value: Option<u64>,
        default: u64,
        bounds: RangeInclusive<u64>,
    ) -> Result<u64, ScenarioError> {
        let value = value.unwrap_or(default);
        if bounds.contains(&value) {
            Ok(value)
        } else {
            let expected = format!("a whole number from {} to {}", bounds.start(), bounds.end());
            Err(self.refuse(key, expected, value))
        }
    }

    fn refuse(&self, key: &str, expected: impl Display, got: impl Display) -> ScenarioError {
        ScenarioError::Senseless {
            file: self.file.to_owned(),
            key: key.to_owned(),
            expected: expected.to_string(),
            got: got.to_string(),
        }
    }
}

fn patience_expected() -> String {
    format!("seconds from {} to {} or \"forever\"", PATIENCE_S.start(), PATIENCE_S.end())
}

fn per_state(n: usize, what: &str) -> String {
    format!("{n} of them, one {what} for each state of the model")
}

fn quoted(text: &str) -> String {
    format!("{text:?}")
}

/// The prior mean drawn from N(start, covariance): a filter that is consistent from the first tick.
fn drawn_mean(start: &[f64], covariance: &Matrix, seed: u64) -> Vec<f64> {
    with_state_dim!(start.len(), N => {
        let root = square_root(&covariance.to_static::<N, N>());
        let mut normal = nalgebra::SVector::<f64, N>::zeros();
        Draws::new(seed, Stream::PriorMean).standard_normal(0, normal.as_mut_slice());
        let error = root * normal;
        start.iter().zip(error.iter()).map(|(start, error)| start + error).collect()
    })
}
