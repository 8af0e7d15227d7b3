//! From the command line's flags to a scenario file, and from there to an experiment.

use std::path::Path;

use rangehound_shared::scenario::{
    FilterTable, PlannerTable, RecordedSensorTable, RecordingTable, RobotsTable, ScenarioFile, TargetTable, defaults,
};

use super::{ExperimentArgs, InputArgs, PerSensor, TrackArgs};
use crate::failure::{self, Failure};
use crate::files::calibration;
use crate::files::input::{self, COMMAND_LINE, in_utf8};
use crate::run::experiment::{Experiment, Flag, Given, Naming};

impl ExperimentArgs {
    /// The user's scenario file, or the paper's, overridden by the values of the command line.
    ///
    /// # Errors
    /// [`Failure::Input`] if the file cannot be read or contradicts the flags.
    pub(super) fn given(&self) -> Result<Given, Failure> {
        let mut given = Given::read(self.scenario.as_deref())?;
        self.override_with(&mut given.file)?;
        given.flags = typed([
            ("robots.count", "--robots", self.robots.is_some()),
            ("planner.name", "--planner", self.planner.is_some()),
            ("planner.stand_off_m", "--stand-off", self.stand_off.is_some()),
            ("ticks", "--ticks", self.ticks.is_some()),
            ("timeout_s", "--timeout", self.timeout.is_some()),
        ]);
        Ok(given)
    }

    /// The experiment of `run` and `sim`.
    ///
    /// # Errors
    /// [`Failure::Input`] for any invalid input.
    pub(super) fn experiment(&self, naming: Naming) -> Result<Experiment, Failure> {
        Experiment::from_given(self.given()?, self.name.as_ref(), naming, self.out.as_deref())
    }

    /// Overrides the file's values by the command line's.
    pub(super) fn override_with(&self, file: &mut ScenarioFile) -> Result<(), Failure> {
        if self.robots.is_some() {
            if file.robot.is_some() || file.recording.is_some() {
                return Err(Failure::input(
                    "--robots is given, but the scenario has [[robot]] or [recording]: leave it out, or use a scenario with [robots]",
                ));
            }
            file.robots.get_or_insert_with(RobotsTable::default).count = self.robots;
        }
        if self.planner.is_some() {
            file.planner.get_or_insert_with(PlannerTable::default).name.clone_from(&self.planner);
        }
        if self.stand_off.is_some() {
            let planner = file.planner.get_or_insert_default();
            // Replaces either kind of stand-off in the file.
            (planner.stand_off_m, planner.stand_off_sigma) = (self.stand_off, None);
        }
        let clock = self.clock.map(|clock| clock.name().to_owned());
        file.clock = clock.or_else(|| file.clock.take());
        file.ticks = self.ticks.or(file.ticks);
        file.seed = self.seed.or(file.seed);
        file.timeout_s = self.timeout.clone().or_else(|| file.timeout_s.take());
        Ok(())
    }
}

impl TrackArgs {
    /// The experiment of `track`.
    ///
    /// # Errors
    /// [`Failure::Input`] for any invalid input.
    pub(super) fn experiment(&self) -> Result<Experiment, Failure> {
        let mut recording = RecordingTable {
            range_std_m: self.range_std,
            bearing_std_rad: self.bearing_std,
            pose_std_m: self.nuisances.pose_std,
            pose_drift_m: self.nuisances.pose_drift,
            pose_correlation_s: self.nuisances.pose_correlation,
            heading_std_rad: self.nuisances.heading_std,
            bias_std_m: self.nuisances.bias_std,
            start_m: self.start,
            start_std_m: self.start_std,
            ..self.input.table()?
        };
        let mut sensors: Vec<RecordedSensorTable> = Vec::new();
        apply(&self.range_bias, &mut recording.bias_m, &mut sensors, |sensor| &mut sensor.bias_m);
        apply(&self.range_scale, &mut recording.scale, &mut sensors, |sensor| &mut sensor.scale);
        recording.sensor = Some(sensors);
        let mut accel_psd = self.accel_psd;
        let flags = self.flags();
        let read = input::recording_of(&recording, COMMAND_LINE, Path::new(""))
            .map_err(|error| Failure::input(error.by_flag(&flags)))?;
        if let Some(path) = &self.calibration {
            let known_errors = calibration::read(path)?;
            let known: Vec<String> = read.0.sensors().iter().map(|sensor| sensor.name.to_string()).collect();
            calibration::merge(&known_errors, &known, &mut recording, &mut accel_psd);
        }
        let has_bearings = read.0.has_bearings();
        let file = ScenarioFile {
            name: Some(name_after(&self.input.ranges)),
            recording: Some(recording),
            target: Some(TargetTable { noise_psd: accel_psd, ..TargetTable::default() }),
            filter: Some(FilterTable {
                gate_sigma: self.gate.gate.clone(),
                distrust: self.gate.distrust(),
                estimate: self.nuisances.estimate.clone(),
                ..FilterTable::default()
            }),
            ..ScenarioFile::default()
        };
        let (name, out) = (self.name.as_ref(), self.out.as_deref());
        let inputs = self.calibration.iter().chain(&self.truth.truth).cloned();
        let experiment = Experiment::from_recording(file, flags, read, name, out, inputs)?;
        let assumed = [
            (
                self.range_std.is_none() && self.calibration.is_none(),
                format!("a range std of {} m (--range-std)", defaults::RECORDED_RANGE_STD_M),
            ),
            (
                has_bearings && self.bearing_std.is_none(),
                format!("a bearing std of {} rad (--bearing-std)", defaults::RECORDED_BEARING_STD_RAD),
            ),
            (
                self.accel_psd.is_none() && self.calibration.is_none(),
                format!("an acceleration psd of {} m^2/s^3 (--accel-psd)", defaults::RECORDED_ACCEL_PSD),
            ),
        ];
        let assumed: Vec<String> = assumed.into_iter().filter(|(is, _)| *is).map(|(_, what)| what).collect();
        if !assumed.is_empty() {
            failure::print_stderr(format!(
                "track: assumes {}: give {} if known, or run `rangehound calibrate`",
                assumed.join(" and "),
                if assumed.len() == 1 { "this value" } else { "these values" }
            ));
        }
        Ok(experiment)
    }

    /// The keys of the scenario that flags give.
    fn flags(&self) -> Vec<Flag> {
        let (input, nuisances) = (&self.input, &self.nuisances);
        let mut flags = input.flags();
        flags.extend(typed([
            ("recording.range_std_m", "--range-std", self.range_std.is_some()),
            ("recording.bearing_std_rad", "--bearing-std", self.bearing_std.is_some()),
            ("recording.pose_std_m", "--pose-std", nuisances.pose_std.is_some()),
            ("recording.pose_drift_m", "--pose-drift", nuisances.pose_drift.is_some()),
            ("recording.pose_correlation_s", "--pose-correlation", nuisances.pose_correlation.is_some()),
            ("recording.heading_std_rad", "--heading-std", nuisances.heading_std.is_some()),
            ("recording.bias_std_m", "--bias-std", nuisances.bias_std.is_some()),
            ("recording.bias_m", "--range-bias", !self.range_bias.is_empty()),
            ("recording.scale", "--range-scale", !self.range_scale.is_empty()),
            ("recording.start_m", "--start", self.start.is_some()),
            ("recording.start_std_m", "--start-std", self.start_std.is_some()),
            ("target.noise_psd", "--accel-psd", self.accel_psd.is_some()),
            ("filter.gate_sigma", "--gate", self.gate.gate.is_some()),
            ("filter.estimate", "--estimate", nuisances.estimate.is_some()),
            ("recording.sensor[].bias_m", "--range-bias", !self.range_bias.is_empty()),
            ("recording.sensor[].scale", "--range-scale", !self.range_scale.is_empty()),
            (
                "recording.sensor[].id",
                "--range-bias or --range-scale",
                !self.range_bias.is_empty() || !self.range_scale.is_empty(),
            ),
        ]));
        flags
    }
}

/// The keys that were typed, out of (key, flag, whether it was typed).
fn typed<const N: usize>(flags: [(&'static str, &'static str, bool); N]) -> Vec<Flag> {
    flags.into_iter().filter(|(_, _, is_typed)| *is_typed).map(|(key, flag, _)| (key, flag)).collect()
}

impl InputArgs {
    /// The keys of the scenario that flags give.
    pub fn flags(&self) -> Vec<Flag> {
        let columns = match (&self.field, &self.columns) {
            (Some(_), Some(_)) => "--field or --columns",
            (Some(_), None) => "--field",
            (None, _) => "--columns",
        };
        typed([
            ("recording.columns", columns, self.columns.is_some() || self.field.is_some()),
            ("recording.format", "--format", self.format.is_some()),
            ("recording.topic", "--topic", self.topic.is_some()),
            ("recording.position", "--position", self.position.is_some()),
            ("recording.msg", "--msg", !self.msg.is_empty()),
            ("recording.rate_hz", "--rate", self.rate.is_some()),
            ("recording.stamp_unit", "--stamp-unit", self.stamp_unit.is_some()),
            ("recording.target_height_m", "--target-height", self.target_height.is_some()),
        ])
    }

    /// The flags for reading a recording, as a scenario's table.
    ///
    /// # Errors
    /// [`Failure::Input`] for a path that is not UTF-8.
    pub(super) fn table(&self) -> Result<RecordingTable, Failure> {
        let anchors = self.anchors.as_deref().map(|path| in_utf8("--anchors", path)).transpose()?;
        let columns = match (&self.field, &self.columns) {
            (Some(field), Some(columns)) => Some(format!("range={field},{columns}")),
            (Some(field), None) => Some(format!("range={field}")),
            (None, columns) => columns.clone(),
        };
        Ok(RecordingTable {
            ranges: Some(in_utf8("RANGES", &self.ranges)?.to_owned()),
            columns,
            topic: self.topic.clone(),
            position: self.position.clone(),
            msg: (!self.msg.is_empty()).then(|| self.msg.clone()),
            anchors: anchors.map(str::to_owned),
            target: self.target.clone(),
            format: self.format.clone(),
            rate_hz: self.rate,
            stamp_unit: self.stamp_unit.clone(),
            strict: self.strict.then_some(true),
            target_height_m: self.target_height,
            ..RecordingTable::default()
        })
    }
}

/// Separates values for all sensors from those for one; the last value of each counts.
fn apply(
    values: &[PerSensor],
    all: &mut Option<f64>,
    sensors: &mut Vec<RecordedSensorTable>,
    field: impl Fn(&mut RecordedSensorTable) -> &mut Option<f64>,
) {
    for PerSensor { sensor, value } in values {
        match sensor {
            None => *all = Some(*value),
            Some(id) => {
                let index = sensors.iter().position(|known| known.id == *id).unwrap_or_else(|| {
                    sensors.push(RecordedSensorTable::new(id.clone()));
                    sensors.len() - 1
                });
                *field(&mut sensors[index]) = Some(*value);
            }
        }
    }
}

/// A run's name from its recording: the name of the file, or of its folder if the file is just called "ranges".
fn name_after(ranges: &Path) -> String {
    let stem = ranges.file_stem().and_then(|stem| stem.to_str()).unwrap_or_default();
    let folder = ranges.parent().and_then(Path::file_name).and_then(|folder| folder.to_str());
    let best = if stem == "ranges" { folder.unwrap_or(stem) } else { stem };
    let name: String = best.chars().filter(|c| c.is_ascii_alphanumeric() || *c == '-' || *c == '_').take(20).collect();
    // Standard input has no name.
    if name.contains(|c: char| c.is_ascii_alphanumeric()) { name } else { "track".to_owned() }
}
