//! From the file's keys to a [`Scenario`]: fills in defaults and checks every value.

mod planner;
mod recorded;
mod target;
mod team;
mod values;

use std::time::Duration;

use super::bounds::{DT_S, ESTIMATED_ROBOTS_MAX, GATE_SIGMA, NOISE_PSD, STD_M, TICKS_MAX, TIMEOUT_S};
use super::{
    Clearance, Clock, FilterTable, GRID_INSTEAD, GateKey, PlannerSpec, PlannerTable, Prior, RecordingTable, Scenario,
    ScenarioError, ScenarioFile, Source, Timeout, TimeoutKey, Treatment, defaults,
};
use crate::motion::MotionModel;
use crate::recording::{ReadSummary, Recording};
use crate::run_name::RunName;
use values::quoted;

impl Scenario {
    /// Checks the scenario file of a simulated run. `file` names it in errors.
    ///
    /// # Errors
    /// [`ScenarioError`] for the first fault; also for a recording, which needs [`Self::from_file_with`].
    pub fn from_file(raw: &ScenarioFile, file: &str) -> Result<Self, ScenarioError> {
        Self::from_file_with(raw, file, |_| {
            Err(Checker { file }.refuse("recording", "a simulated run, without this key", "given"))
        })
    }

    /// Checks a scenario file. `file` names it in errors. A recording is read last, after all other
    /// checks: reading may take long, and a pipe can be read only once.
    ///
    /// # Errors
    /// [`ScenarioError`] for the first fault.
    pub fn from_file_with(
        raw: &ScenarioFile,
        file: &str,
        read: impl FnOnce(&RecordingTable) -> Result<(Recording, ReadSummary), ScenarioError>,
    ) -> Result<Self, ScenarioError> {
        Checker { file }.scenario(raw, read)
    }
}

impl PlannerSpec {
    /// Checks the planner itself in a `[planner]` table. `file` names it in errors.
    ///
    /// # Errors
    /// [`ScenarioError`] for the first fault.
    pub fn from_table(table: &PlannerTable, file: &str) -> Result<Self, ScenarioError> {
        Checker { file }.planner(table)
    }
}

impl Clearance {
    /// Checks the clearances in a `[planner]` table. `file` names it in errors.
    ///
    /// # Errors
    /// [`ScenarioError`] for the first fault.
    pub fn from_table(table: &PlannerTable, file: &str) -> Result<Self, ScenarioError> {
        Checker { file }.clearance(table)
    }
}

/// Checks values and adds the file's name to errors.
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
            return Err(self.refuse("name", problem.expected(), quoted(&name)));
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
            timeout: self.timeout(raw.timeout_s.as_ref())?,
            filter_motion: motion.clone(),
            motion,
            source: Source::Simulated { target_start: Vec::new() },
            has_real_target: raw.target.as_ref().and_then(|table| table.real).unwrap_or(false),
            prior: Prior::FromRanges,
            robots: Vec::new(),
            planner: self.planner(&planner)?,
            clearance: self.clearance(&planner)?,
            gate_sigma,
            treatment: self.treatment(&raw.filter.clone().unwrap_or_default())?,
            criterion: self.criterion(planner.criterion.as_deref())?,
            distrust: raw.filter.as_ref().and_then(|table| table.distrust).unwrap_or(gate_sigma.is_some()),
        };
        if let Some(recording) = &raw.recording {
            self.recorded(raw, recording, read, &mut scenario)?;
        } else {
            let n = scenario.motion.state_dim();
            let target_start = self.target_start(raw.target.as_ref().and_then(|table| table.start.as_ref()), n)?;
            let mut prior = raw.prior.clone().unwrap_or_default();
            if scenario.has_real_target {
                prior.mean = Some(self.mean_for_real_target(prior.mean)?);
            }
            scenario.prior = self.prior(&prior, &target_start, seed)?;
            scenario.source = Source::Simulated { target_start };
            scenario.robots = self.team(raw)?;
            self.set_filter_noise(&raw.filter.clone().unwrap_or_default(), &mut scenario)?;
        }
        let robots = scenario.robots.len();
        if matches!(scenario.treatment, Treatment::Estimated { .. }) && robots > ESTIMATED_ROBOTS_MAX {
            let expected = format!(
                "at most {ESTIMATED_ROBOTS_MAX}: leave it out, and the filter takes account of these errors without estimating them"
            );
            return Err(self.refuse("filter.estimate", expected, format!("given for {robots} robots or sensors")));
        }
        if matches!(scenario.planner, PlannerSpec::Grid { .. }) && !scenario.is_range_only() {
            return Err(self.refuse("planner.name", GRID_INSTEAD, quoted("grid")));
        }
        Ok(scenario)
    }

    /// Gives the filter of a simulation a noise that differs from the truth.
    fn set_filter_noise(&self, table: &FilterTable, scenario: &mut Scenario) -> Result<(), ScenarioError> {
        if let Some(psd) = table.noise_psd {
            let psd = self.number("filter.noise_psd", Some(psd), psd, NOISE_PSD)?;
            let MotionModel::IntegratorChain { noise_psd, .. } = &mut scenario.filter_motion else {
                return Err(self.refuse("filter.noise_psd", "only target.qd", "given together with target.qd"));
            };
            *noise_psd = psd;
        }
        if let Some(std_m) = table.range_std_m {
            let std_m = self.number("filter.range_std_m", Some(std_m), std_m, STD_M)?;
            let reported = scenario.robots.iter_mut().filter_map(|robot| robot.reported.range.as_mut());
            reported.for_each(|range| range.std_m = std_m);
        }
        Ok(())
    }

    fn treatment(&self, table: &FilterTable) -> Result<Treatment, ScenarioError> {
        let (mut bias, mut pose) = (false, false);
        for name in table.estimate.iter().flatten() {
            match name.as_str() {
                "bias" => bias = true,
                "pose" => pose = true,
                other => return Err(self.refuse("filter.estimate", "a list of \"bias\" and \"pose\"", quoted(other))),
            }
        }
        let treatment = match table.nuisances.as_deref() {
            Some("ignored") => Treatment::Ignored,
            Some("inflated") => Treatment::Inflated,
            None | Some("schmidt") if bias || pose => return Ok(Treatment::Estimated { bias, pose }),
            None | Some("schmidt") => return Ok(Treatment::Schmidt),
            Some(other) => {
                let expected = "\"ignored\", \"inflated\" or \"schmidt\"";
                return Err(self.refuse("filter.nuisances", expected, quoted(other)));
            }
        };
        if bias || pose {
            let got = "given together with another filter.nuisances than \"schmidt\"";
            return Err(self.refuse("filter.estimate", "only one of the two keys", got));
        }
        Ok(treatment)
    }

    fn clock(&self, raw: &ScenarioFile) -> Result<Clock, ScenarioError> {
        let default = if raw.recording.is_some() { defaults::RECORDING_CLOCK } else { defaults::CLOCK };
        match raw.clock.as_deref().unwrap_or(default) {
            "realtime" => Ok(Clock::Realtime),
            "lockstep" => Ok(Clock::Lockstep),
            other => Err(self.refuse("clock", "\"realtime\" or \"lockstep\"", quoted(other))),
        }
    }

    fn timeout(&self, key: Option<&TimeoutKey>) -> Result<Timeout, ScenarioError> {
        match key {
            None => Ok(Timeout::After(Duration::from_secs_f64(defaults::TIMEOUT_S))),
            Some(TimeoutKey::Word(word)) if word == "forever" => Ok(Timeout::Forever),
            Some(TimeoutKey::Seconds(seconds)) if TIMEOUT_S.contains(seconds) => {
                Ok(Timeout::After(Duration::from_secs_f64(*seconds)))
            }
            Some(TimeoutKey::Word(word)) => Err(self.refuse("timeout_s", timeout_expected(), quoted(word))),
            Some(TimeoutKey::Seconds(seconds)) => Err(self.refuse("timeout_s", timeout_expected(), seconds)),
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
}

fn timeout_expected() -> String {
    format!("seconds from {} to {} or \"forever\"", TIMEOUT_S.start(), TIMEOUT_S.end())
}
