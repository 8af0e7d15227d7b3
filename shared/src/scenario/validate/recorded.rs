//! Checks the recording in a scenario.

use super::Checker;
use crate::motion::MotionModel;
use crate::motion::matrix::Matrix;
use crate::recording::{ReadSummary, Recording};
use crate::scenario::bounds::{BEARING_STD_RAD, BIAS_M, COORDINATE, NUISANCE_STD_M, SCALE, START_STD_M, STD_M};
use crate::scenario::{
    Calibration, LocaliserTable, NuisanceSpec, PoseCorrelation, Prior, RangeNoise, RecordedRanges, RecordingTable,
    RobotSpec, Scenario, ScenarioError, ScenarioFile, SensorSpec, Source, Treatment, defaults,
};

impl Checker<'_> {
    pub(super) fn recorded(
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
            ("sensor", raw.sensor.is_some()),
            ("localiser", raw.localiser.is_some()),
            ("planner", raw.planner.is_some()),
            ("target.start", raw.target.as_ref().is_some_and(|target| target.start.is_some())),
            ("target.real", raw.target.as_ref().is_some_and(|target| target.real.is_some())),
        ];
        if let Some((key, _)) = simulated_only.iter().find(|(_, present)| *present) {
            return Err(self.refuse(key, "only one of them", "given together with [recording]"));
        }
        let filter = raw.filter.as_ref();
        for (key, instead, present) in [
            ("filter.noise_psd", "target.noise_psd", filter.is_some_and(|filter| filter.noise_psd.is_some())),
            ("filter.range_std_m", "recording.range_std_m", filter.is_some_and(|filter| filter.range_std_m.is_some())),
        ] {
            if present {
                return Err(self.refuse(key, format!("{instead} instead"), "given together with [recording]"));
            }
        }
        let height = |height_m| self.number("recording.target_height_m", Some(height_m), height_m, COORDINATE);
        let target_height_m = table.target_height_m.map(height).transpose()?;
        let prior = self.known_start(table, &scenario.motion)?;
        let (recording, summary) = read(table)?;
        if target_height_m.is_some() {
            self.require_heights(&recording)?;
        }
        scenario.prior = prior;
        let std_m = self.number("recording.range_std_m", table.range_std_m, defaults::RECORDED_RANGE_STD_M, STD_M)?;
        let bearing_std_rad = self.number(
            "recording.bearing_std_rad",
            table.bearing_std_rad,
            defaults::RECORDED_BEARING_STD_RAD,
            BEARING_STD_RAD,
        )?;
        let sensor = SensorSpec {
            range: recording.has_ranges().then_some(RangeNoise { std_m, std_per_m: 0.0 }),
            bearing_std_rad: recording.has_bearings().then_some(bearing_std_rad),
            ..SensorSpec::range(std_m)
        };
        let estimates_bias = matches!(scenario.treatment, Treatment::Estimated { bias: true, .. });
        let nuisances = self.recorded_nuisances(table, estimates_bias)?;
        let bias_m = self.number("recording.bias_m", table.bias_m, 0.0, BIAS_M)?;
        let scale = self.number("recording.scale", table.scale, 0.0, SCALE)?;
        scenario.robots = recording
            .sensors()
            .iter()
            .map(|known| RobotSpec {
                label: known.name.to_string(),
                start_m: known.first_position_m,
                speed_mps: 0.0,
                sensor,
                reported: sensor,
                calibration: Calibration { bias_m, scale },
                nuisances,
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
                return Err(self.refuse(&key("id"), "each sensor once", format!("{} for the second time", sensor.id)));
            }
            let robot = &mut scenario.robots[robot];
            let std_m = self.number(&key("range_std_m"), sensor.range_std_m, std_m, STD_M)?;
            robot.sensor.range = robot.sensor.range.map(|range| RangeNoise { std_m, ..range });
            robot.reported = robot.sensor;
            robot.calibration.bias_m = self.number(&key("bias_m"), sensor.bias_m, bias_m, BIAS_M)?;
            robot.calibration.scale = self.number(&key("scale"), sensor.scale, scale, SCALE)?;
        }
        scenario.ticks = raw.ticks.map_or(u64::MAX, |_| scenario.ticks).min(recording.len() as u64);
        scenario.source = Source::Recorded(RecordedRanges::new(recording, summary, target_height_m));
        Ok(())
    }

    /// The nuisances of all sensors.
    fn recorded_nuisances(&self, table: &RecordingTable, estimates_bias: bool) -> Result<NuisanceSpec, ScenarioError> {
        let localiser = LocaliserTable {
            std_m: table.pose_std_m,
            drift_m: table.pose_drift_m,
            correlation_s: table.pose_correlation_s,
            heading_std_rad: table.heading_std_rad,
        };
        let key = |key: &str| match key {
            "heading_std_rad" => "recording.heading_std_rad".to_owned(),
            of_pose => format!("recording.pose_{of_pose}"),
        };
        let mut pose = self.pose_nuisances(key, &localiser)?;
        if [table.pose_std_m, table.pose_drift_m, table.pose_correlation_s] == [None; 3] {
            // Only the rows say how well positions are known, if at all.
            pose.correlation = PoseCorrelation::Inferred;
        }
        let default_m = if estimates_bias { defaults::RECORDED_BIAS_STD_M } else { 0.0 };
        let bias_std_m = self.number("recording.bias_std_m", table.bias_std_m, default_m, NUISANCE_STD_M)?;
        Ok(NuisanceSpec { bias_std_m, ..pose })
    }

    /// The knowledge before the first range: the given start, or nothing.
    pub(super) fn known_start(&self, table: &RecordingTable, motion: &MotionModel) -> Result<Prior, ScenarioError> {
        let Some(start_m) = table.start_m else {
            return match table.start_std_m {
                None => Ok(Prior::FromRanges),
                Some(_) => {
                    Err(self.refuse("recording.start_std_m", "both of them, or neither", "given without start_m"))
                }
            };
        };
        self.point("recording.start_m", Some(start_m))?;
        let std_m =
            self.number("recording.start_std_m", table.start_std_m, defaults::RECORDED_START_STD_M, START_STD_M)?;
        let n = motion.state_dim();
        // As wide as a start from ranges: the variance that the noise builds up in a manoeuvre's time, at least a walking speed's.
        let noise_psd = match motion {
            MotionModel::IntegratorChain { noise_psd, .. } => *noise_psd,
            MotionModel::Custom { .. } => 0.0,
        };
        let rate_variance = (noise_psd * defaults::RECORDED_START_S).max(1.0);
        // Position first, then its derivatives.
        let variance = |i: usize| if i < 2 { std_m * std_m } else { rate_variance };
        Ok(Prior::Gaussian {
            mean: (0..n).map(|i| start_m.get(i).copied().unwrap_or(0.0)).collect(),
            covariance: Matrix::from_diagonal(&(0..n).map(variance).collect::<Vec<f64>>()),
        })
    }

    /// A height of the target needs a height of every sensor.
    pub(super) fn require_heights(&self, recording: &Recording) -> Result<(), ScenarioError> {
        let mut readings = (0..recording.len()).filter_map(|index| recording.instant(index)).flat_map(|(_, of)| of);
        match readings.find(|reading| reading.height_m.is_none()) {
            None => Ok(()),
            Some(reading) => {
                let name = recording.sensors().get(reading.sensor).map_or("?", |sensor| sensor.name.as_str());
                let expected = "the height of every sensor (a column sensor_z_m, or z_m in the anchors file)";
                let got = format!("given without a height of sensor {name}");
                Err(self.refuse("recording.target_height_m", expected, got))
            }
        }
    }
}
