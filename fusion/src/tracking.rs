//! Tracker and trust together: processes a tick's reports, and processes past ticks again when a report arrives late.

use rangehound_shared::measurement::{Kind, Measurement, Pose};
use rangehound_shared::record::{FusionDecision, GateResults};
use rangehound_shared::robot_set::RobotSet;
use rangehound_shared::scenario::{NuisanceSpec, PoseCorrelation, RobotSpec, Scenario};
use rangehound_shared::sealed::SealError;

use crate::past::PastTick;
use crate::tracker::{self, Fit, Reading, Tracker};
use crate::trust::{Decision, Policy, Trust};

/// The estimate, and the trust that decides whose measurements are fused.
#[derive(Debug)]
pub(crate) struct Tracking {
    pub(crate) tracker: Box<dyn Tracker>,
    pub(crate) trust: Trust,
    /// Growth of the standard deviation of each robot's ranges with the distance.
    stds_per_m: Vec<f64>,
    nuisances: Vec<NuisanceSpec>,
    readings: Vec<Reading>,
    /// The outcome of each robot's report in the last step.
    judged: Vec<GateResults>,
}

impl Tracking {
    pub(crate) fn new(scenario: &Scenario) -> Self {
        let robots = scenario.robots.len();
        let policy =
            Policy { distrusts: scenario.distrust, raises_noise: scenario.distrust || scenario.gate_sigma.is_some() };
        let std_per_m = |robot: &RobotSpec| robot.reported.range.map_or(0.0, |range| range.std_per_m);
        Self {
            tracker: tracker::for_scenario(scenario),
            trust: Trust::new(robots, policy),
            stds_per_m: scenario.robots.iter().map(std_per_m).collect(),
            nuisances: scenario.robots.iter().map(|robot| robot.nuisances).collect(),
            readings: Vec::with_capacity(Kind::COUNT * robots),
            judged: vec![GateResults::default(); robots],
        }
    }

    /// The outcome of each robot's report in the last step.
    pub(crate) fn judged(&self) -> &[GateResults] {
        &self.judged
    }

    /// Robots whose measurements of each kind are distrusted.
    pub(crate) fn distrusted(&self) -> [RobotSet; Kind::COUNT] {
        Kind::ALL.map(|kind| self.trust.distrusted(kind))
    }

    /// Factors on the reported standard deviations of each kind.
    pub(crate) fn noise_scales(&self) -> [f64; Kind::COUNT] {
        Kind::ALL.map(|kind| self.trust.noise_scale(kind))
    }

    /// Predicts over `dt_s` seconds, then updates with the reports in order of the robots' ids.
    pub(crate) fn step(&mut self, dt_s: f64, reports: &[Option<Measurement>]) -> Fit {
        let noise_scales = self.noise_scales();
        self.readings.clear();
        for (robot, report) in reports.iter().enumerate() {
            let Some(report) = report else { continue };
            for kind in Kind::ALL {
                let Some((value, std)) = report.of(kind) else { continue };
                let std_per_m = if kind == Kind::Range { self.stds_per_m[robot] } else { 0.0 };
                let noise_scale = noise_scales[kind as usize];
                self.readings.push(Reading {
                    robot,
                    kind,
                    pose: report.pose,
                    value,
                    std: std * noise_scale,
                    std_per_m: std_per_m * noise_scale,
                    distrusted: self.trust.distrusts(robot, kind),
                });
            }
        }
        let fit = self.tracker.step(dt_s, &self.readings);
        self.judged.fill(GateResults::default());
        for (reading, judged) in self.readings.iter().zip(self.tracker.judged()) {
            self.judged[reading.robot][reading.kind as usize] = Some(*judged);
        }
        let nuisances = &self.nuisances;
        let decisions = self.readings.iter().zip(self.tracker.judged()).map(|(reading, judged)| {
            let Reading { robot, kind, .. } = *reading;
            Decision {
                robot,
                kind,
                has_failed: fit.failed[kind as usize].contains(robot),
                normalised_square: judged.normalised_square.filter(|_| !shows_nuisance(reading, &nuisances[robot])),
            }
        });
        let factor = if self.readings.is_empty() { 1.0 } else { self.trust.judge(decisions) };
        if factor > 1.0 {
            self.tracker.widen(factor);
        }
        fit
    }

    /// Saves the state before a tick.
    ///
    /// # Errors
    /// If the tracker cannot be encoded.
    pub(crate) fn save_before(&self, past: &mut PastTick) -> Result<(), SealError> {
        past.trust.copy_from(&self.trust);
        past.tracker.clear();
        self.tracker.save(&mut past.tracker)
    }

    /// Restores the state before the first of these ticks and processes all of them again. True if anything of this
    /// robot's report was fused at the first of them.
    ///
    /// # Errors
    /// If the saved state is not this tracker's.
    pub(crate) fn reprocess<'a>(
        &mut self,
        robot: usize,
        ticks: impl Iterator<Item = &'a mut PastTick>,
    ) -> Result<bool, SealError> {
        let mut fused = None;
        for past in ticks {
            if fused.is_none() {
                self.tracker.restore(&past.tracker)?;
                self.trust.copy_from(&past.trust);
            } else {
                self.save_before(past)?;
            }
            self.step(past.dt_s, &past.reports);
            past.judged.copy_from_slice(&self.judged);
            let is_fused = || self.judged[robot].iter().flatten().any(|judged| judged.used == FusionDecision::Fused);
            fused.get_or_insert_with(is_fused);
        }
        Ok(fused.unwrap_or(false))
    }
}

/// True if errors that stay are more than half as great as the noise of a measurement. Then its innovations are alike for a
/// while, and show how great those errors are at present, not the noise.
fn shows_nuisance(reading: &Reading, spec: &NuisanceSpec) -> bool {
    let Pose { covariance_m2: [xx_m2, _, yy_m2], heading_std_rad, .. } = reading.pose;
    let stays = spec.correlation != PoseCorrelation::White;
    let (pose, bias) = match reading.kind {
        Kind::Range => (0.5 * (xx_m2 + yy_m2), spec.bias_std_m * spec.bias_std_m),
        Kind::Bearing => (heading_std_rad * heading_std_rad, 0.0),
    };
    let staying = if stays { pose } else { 0.0 } + bias;
    4.0 * staying > reading.std * reading.std
}
