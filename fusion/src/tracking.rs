//! Tracker and trust together: processes a tick's reports, and processes past ticks again when a report arrives late.

use rangehound_shared::measurement::Measurement;
use rangehound_shared::record::{Judged, RangeUse};
use rangehound_shared::scenario::Scenario;
use rangehound_shared::sealed::SealError;

use crate::past::PastTick;
use crate::tracker::{self, Fit, Reading, Tracker};
use crate::trust::{Policy, Trust};

/// The estimate, and the trust that decides whose ranges are fused.
#[derive(Debug)]
pub(crate) struct Tracking {
    pub(crate) tracker: Box<dyn Tracker>,
    pub(crate) trust: Trust,
    readings: Vec<Reading>,
    /// What the last step did with each robot's range.
    judged: Vec<Option<Judged>>,
}

impl Tracking {
    pub(crate) fn new(scenario: &Scenario) -> Self {
        let robots = scenario.robots.len();
        let tracker = tracker::for_scenario(scenario);
        let policy =
            Policy { distrusts: scenario.distrust, widens: scenario.distrust || scenario.gate_sigma.is_some() };
        Self {
            tracker,
            trust: Trust::new(robots, policy),
            readings: Vec::with_capacity(robots),
            judged: vec![None; robots],
        }
    }

    /// What the last step did with each robot's range.
    pub(crate) fn judged(&self) -> &[Option<Judged>] {
        &self.judged
    }

    /// Predicts over `dt_s` seconds, then updates with the reports' ranges in order of the robots' ids.
    pub(crate) fn step(&mut self, dt_s: f64, reports: &[Option<Measurement>]) -> Fit {
        let (distrusted, noise_scale) = (self.trust.distrusted(), self.trust.noise_scale());
        self.readings.clear();
        for (robot, report) in reports.iter().enumerate() {
            let range = report.and_then(|report| Some((report.pose, report.range()?)));
            if let Some((pose, (range_m, range_std_m))) = range {
                let (position_m, height_m) = (pose.position_m(), pose.height_m);
                let distrusted = distrusted.contains(robot);
                let range_std_m = range_std_m * noise_scale;
                self.readings.push(Reading { robot, position_m, height_m, range_m, range_std_m, distrusted });
            }
        }
        let fit = self.tracker.step(dt_s, &self.readings);
        self.judged.fill(None);
        for (reading, judged) in self.readings.iter().zip(self.tracker.judged()) {
            self.judged[reading.robot] = Some(*judged);
        }
        let squares = self.readings.iter().zip(self.tracker.judged());
        let squares = squares.map(|(reading, judged)| (reading.robot, judged.normalised_square));
        let factor = self.trust.judge(squares, &fit.failed);
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

    /// Restores the state before the first of these ticks and processes all of them again. True if this robot's range
    /// was fused at the first of them.
    ///
    /// # Errors
    /// If the saved state is not this tracker's.
    pub(crate) fn process_again<'a>(
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
            fused.get_or_insert(self.judged[robot].is_some_and(|judged| judged.used == RangeUse::Fused));
        }
        Ok(fused.unwrap_or(false))
    }
}
