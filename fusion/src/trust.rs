//! Fault detection of sensors, pure. A robot whose ranges keep failing the gate is distrusted until they pass again. If
//! most sensors fail together, the filter or the assumed noise is wrong.

use rangehound_shared::robot_set::RobotSet;
use serde::{Deserialize, Serialize};

/// Number of stored gate decisions of each robot: bits of its record.
pub const RECENT: u32 = u8::BITS;

/// A robot with this many failures among them is distrusted; fewer failures are taken to be outliers. Measured with a
/// gate of 4 sigma in 200 runs for each of 3, 4, 5 and 8 robots, with one sensor that reads 10 or 30 sigma too much:
/// every run distrusts that sensor and no other, 95 % of the runs within five ticks. An error of 6 sigma is harder to
/// detect: with 3 robots the estimate follows the faulty sensor before the gate rejects it, and in one run of five a
/// valid sensor is distrusted instead.
pub const FAILURES_MAX: u32 = 5;

/// Median of a chi-square of one degree of freedom: half of a sensor's normalised innovations squared exceed it if the
/// sensor's noise is as reported.
const CHI_SQUARE_MEDIAN: f64 = 0.454_936_423_119_572_8;

/// Change of the estimated noise of a sensor with each range, in the logarithm of the variance. Steps of equal size
/// make the estimate follow the median, so an outlier moves it no more than any other range. It forgets within about
/// twenty ranges, and its standard deviation is 0.34.
const LOG_STEP: f64 = 0.1;

/// Logarithms of the ratio of the median sensor's noise variance to the reported one. From the first on, sensors count
/// as failing together: twice the reported variance, two standard deviations of one sensor's estimate. Below the second
/// they no longer do: the square root of twice.
const LOG_WIDENED: f64 = 0.7;
const LOG_NARROW: f64 = 0.35;

/// Limits of the logarithm.
const LOG_MAX: f64 = 14.0;
const LOG_MIN: f64 = -1.0;

/// Ranges of a sensor before its noise is estimated, and ranges of the team, in multiples of its size, after which a
/// sensor without a range no longer counts.
const RANGES_MIN: u32 = 8;
const RECENT_ROUNDS: u64 = 8;

/// Number of other sensors that can identify a faulty one. Two are not enough: their ranges fit some position even if
/// one of the two is faulty.
const OTHERS_MIN: usize = 3;

/// Ranges of each sensor that establish that the team agrees: enough to detect twice the reported variance.
const AGREED_RANGES: u32 = 24;

/// Largest factor by which the estimate's variance is inflated at one tick.
const LOST_MAX: f64 = 1e6;

/// Measures against ranges that fail.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Policy {
    /// Robots are distrusted.
    pub distrusts: bool,
    /// If most sensors fail together, ranges are assumed noisier than reported.
    pub widens: bool,
}

/// The gate's decisions on each robot's ranges.
///
/// A robot is distrusted once [`FAILURES_MAX`] of its last [`RECENT`] ranges failed, and trusted again once all of them
/// passed. A failure counts only while more than half of the team's newest ranges pass: otherwise the filter may be
/// wrong. If fewer than three other robots are trusted, a robot is distrusted only if the whole team has agreed before:
/// otherwise the others may be wrong.
///
/// The noise of each sensor is also estimated, from the median of its normalised innovations squared, which is robust
/// to outliers. If the median sensor is noisier than reported, most sensors fail together: because of a common bias,
/// more noise than reported, or a lost estimate. Until that is over, no robot is distrusted, and all ranges are assumed
/// to be as much noisier than reported as the median sensor's.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Trust {
    policy: Policy,
    /// For each robot, the newest decision in the lowest bit: 1 for a range that failed.
    records: Vec<u8>,
    distrusted: RobotSet,
    /// Which of the team's newest ranges failed: a circular buffer with as many places as robots.
    newest_failed: RobotSet,
    next_place: usize,
    noises: Vec<Noise>,
    /// Ranges of the team so far.
    ranges: u64,
    /// Logarithm of the factor on all variances while sensors fail together.
    widened_log: Option<f64>,
    /// True once the ranges of all robots were as good as reported.
    has_agreed: bool,
    /// Reused memory.
    #[serde(skip)]
    scratch: Vec<f64>,
}

/// Noise of one sensor.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
struct Noise {
    /// Logarithm of the ratio of its ranges' variance to the reported one.
    log: f64,
    /// Ranges so far, and the team's count at the last of them.
    ranges: u32,
    last: u64,
}

impl Trust {
    /// Trusts all robots of a team.
    #[must_use]
    pub fn new(robots: usize, policy: Policy) -> Self {
        let (distrusted, newest_failed) = (RobotSet::default(), RobotSet::default());
        Self {
            policy,
            records: vec![0; robots],
            distrusted,
            newest_failed,
            next_place: 0,
            noises: vec![Noise::default(); robots],
            ranges: 0,
            widened_log: None,
            has_agreed: false,
            scratch: Vec::with_capacity(robots),
        }
    }

    /// The distrusted robots.
    #[must_use]
    pub fn distrusted(&self) -> RobotSet {
        self.distrusted
    }

    /// True if a robot is distrusted.
    #[must_use]
    pub fn distrusts(&self, id: usize) -> bool {
        self.distrusted.contains(id)
    }

    /// The size of the team.
    #[must_use]
    pub fn robots(&self) -> usize {
        self.records.len()
    }

    /// Factor on the reported standard deviations of ranges: 1 unless most sensors fail together.
    #[must_use]
    pub fn noise_scale(&self) -> f64 {
        self.widened_log.map_or(1.0, |log| (0.5 * log).exp())
    }

    /// Copies the trust of the same team without allocating.
    pub fn copy_from(&mut self, other: &Self) {
        self.policy = other.policy;
        self.records.clone_from(&other.records);
        self.noises.clone_from(&other.noises);
        (self.distrusted, self.newest_failed, self.next_place) =
            (other.distrusted, other.newest_failed, other.next_place);
        (self.ranges, self.widened_log, self.has_agreed) = (other.ranges, other.widened_log, other.has_agreed);
    }

    /// Takes the gate's decisions on a tick's ranges: for each range its robot, and its normalised innovation squared
    /// if it was predicted; and the robots whose ranges failed. Returns a factor for the estimate's variance. It is
    /// more than 1 if sensors fail together and at least half of the newest ranges fail although more noise is assumed:
    /// then the estimate may be lost.
    pub fn judge(&mut self, heard: impl Iterator<Item = (usize, Option<f64>)> + Clone, failed: &RobotSet) -> f64 {
        let robots = self.records.len();
        for (id, _) in heard.clone() {
            self.newest_failed.set(self.next_place, failed.contains(id));
            self.next_place = (self.next_place + 1) % robots;
        }
        let filter_is_wrong = 2 * self.newest_failed.len() >= robots;
        if self.policy.widens {
            self.follow_noise(heard.clone());
        }
        if self.widened_log.is_some() {
            // All robots are trusted, and their failures so far do not count.
            self.distrusted = RobotSet::default();
            self.records.fill(0);
            let squares = heard.filter_map(|(_, square)| square);
            let (sum, count) = squares.fold((0.0, 0.0), |(sum, count), square| (sum + square, count + 1.0));
            return if filter_is_wrong && count > 0.0 { (sum / count).clamp(1.0, LOST_MAX) } else { 1.0 };
        }
        if self.policy.distrusts {
            self.count_failures(heard.map(|(id, _)| id), failed, filter_is_wrong);
        }
        1.0
    }

    fn count_failures(&mut self, heard: impl Iterator<Item = usize>, failed: &RobotSet, filter_is_wrong: bool) {
        let robots = self.records.len();
        for id in heard {
            let has_failed = failed.contains(id);
            if has_failed && filter_is_wrong {
                continue;
            }
            let can_identify = self.has_agreed || robots - self.distrusted.len() > OTHERS_MIN;
            let record = &mut self.records[id];
            *record = *record << 1 | u8::from(has_failed);
            if record.count_ones() >= FAILURES_MAX && can_identify {
                self.distrusted.set(id, true);
            } else if *record == 0 {
                self.distrusted.set(id, false);
            }
        }
    }

    /// Tracks each sensor's noise, and checks whether most sensors are worse than reported.
    fn follow_noise(&mut self, heard: impl Iterator<Item = (usize, Option<f64>)>) {
        for (id, square) in heard {
            let Some(square) = square else { continue };
            self.ranges += 1;
            let Noise { log, ranges, .. } = self.noises[id];
            // The square is normalised by the noise that is assumed at present; here it is normalised by this sensor's
            // own.
            let taken_log = self.widened_log.unwrap_or(0.0);
            let step = match square * (taken_log - log).exp() > CHI_SQUARE_MEDIAN {
                // The first squares reflect the initial uncertainty, not the noise.
                _ if ranges < RANGES_MIN => 0.0,
                true => LOG_STEP,
                false => -LOG_STEP,
            };
            let log = (log + step).clamp(LOG_MIN, LOG_MAX);
            self.noises[id] = Noise { log, ranges: ranges.saturating_add(1), last: self.ranges };
        }
        let oldest = self.ranges.saturating_sub(RECENT_ROUNDS * self.noises.len() as u64);
        let distrusted = self.distrusted;
        let counts = |(_, noise): &(usize, &Noise)| noise.ranges >= RANGES_MIN && noise.last >= oldest;
        let heard = || self.noises.iter().enumerate().filter(counts);
        self.scratch.clear();
        self.scratch.extend(heard().filter(|(id, _)| !distrusted.contains(*id)).map(|(_, noise)| noise.log));
        let Some(last) = self.scratch.len().checked_sub(1) else {
            self.widened_log = None;
            return;
        };
        // The lower one of two middle values: of two sensors the faulty one cannot be identified.
        let median = *self.scratch.select_nth_unstable_by(last / 2, f64::total_cmp).1;
        self.scratch.clear();
        let threshold = if self.widened_log.is_some() { LOG_NARROW } else { LOG_WIDENED };
        self.widened_log = (median >= threshold).then_some(median);
        let agrees = |noise: &Noise| noise.ranges >= AGREED_RANGES && noise.log < LOG_WIDENED;
        self.has_agreed |= self.widened_log.is_none() && self.noises.iter().all(agrees);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trust(robots: usize) -> Trust {
        Trust::new(robots, Policy { distrusts: true, widens: true })
    }

    /// Ticks at which these robots of a team of 4 fail; all 4 report. Returns the distrusted robots.
    fn after(trust: &mut Trust, ticks: usize, failing: &[usize]) -> Vec<usize> {
        let mut failed = RobotSet::default();
        failing.iter().for_each(|id| failed.set(*id, true));
        for _ in 0..ticks {
            trust.judge((0..4).map(|id| (id, None)), &failed);
        }
        trust.distrusted().iter().collect()
    }

    #[test]
    fn a_robot_that_keeps_failing_is_distrusted_until_it_passes_eight_in_a_row() {
        let mut trust = trust(4);
        assert_eq!(after(&mut trust, 4, &[2]), []);
        assert_eq!(after(&mut trust, 3, &[]), []);
        assert_eq!(after(&mut trust, 1, &[2]), [2], "five of the last eight");
        assert_eq!(after(&mut trust, 7, &[]), [2]);
        assert_eq!(after(&mut trust, 1, &[2]), [2]);
        assert_eq!(after(&mut trust, 7, &[]), [2], "the count starts anew");
        assert_eq!(after(&mut trust, 1, &[]), []);
    }

    /// Ticks at which all 4 robots report, with the same squares each time and a gate of 4 sigma. Returns the largest
    /// factor.
    fn noisy(trust: &mut Trust, ticks: usize, squares: [f64; 4]) -> f64 {
        let mut failed = RobotSet::default();
        squares.iter().enumerate().for_each(|(id, square)| failed.set(id, *square > 16.0));
        (0..ticks).map(|_| trust.judge((0..4).map(|id| (id, Some(squares[id]))), &failed)).fold(1.0, f64::max)
    }

    #[test]
    fn if_most_fail_together_no_robot_is_distrusted_and_all_are_noisier() {
        let mut trust = trust(4);
        noisy(&mut trust, 40, [0.4, 0.4, 30.0, 0.4]);
        assert!(trust.distrusted().iter().eq([2]) && trust.noise_scale() == 1.0, "one of four is faulty");
        let lost = noisy(&mut trust, 40, [9.0, 9.0, 30.0, 9.0]);
        assert!(trust.distrusted().is_empty() && trust.noise_scale() > 2.2 && lost == 1.0, "{trust:?}");
        // It ends when the noise is as reported again.
        noisy(&mut trust, 60, [0.4; 4]);
        assert_eq!((trust.noise_scale(), trust.distrusted().is_empty()), (1.0, true));
    }

    #[test]
    fn if_all_fail_with_widened_noise_too_the_estimate_may_be_lost() {
        let mut trust = trust(4);
        assert_eq!(noisy(&mut trust, 60, [900.0; 4]), 900.0);
        assert!(trust.distrusted().is_empty());
    }

    #[test]
    fn without_the_switch_no_noise_is_widened_and_no_robot_distrusted() {
        let mut trust = Trust::new(4, Policy { distrusts: false, widens: false });
        assert_eq!(noisy(&mut trust, 60, [900.0, 900.0, 900.0, 0.4]), 1.0);
        noisy(&mut trust, 60, [0.4, 0.4, 30.0, 0.4]);
        assert!(trust.distrusted().is_empty() && trust.noise_scale() == 1.0);
    }

    /// The same for a team of any size; returns the distrusted robots and the noise scale.
    fn steady(trust: &mut Trust, ticks: usize, squares: &[f64]) -> (Vec<usize>, f64) {
        let mut failed = RobotSet::default();
        squares.iter().enumerate().for_each(|(id, square)| failed.set(id, *square > 16.0));
        for _ in 0..ticks {
            trust.judge(squares.iter().enumerate().map(|(id, square)| (id, Some(*square))), &failed);
        }
        (trust.distrusted().iter().collect(), trust.noise_scale())
    }

    #[test]
    fn a_little_more_than_the_reported_noise_does_not_accumulate() {
        assert_eq!(steady(&mut trust(4), 500, &[0.6; 4]), (vec![], 1.0));
    }

    #[test]
    fn small_teams_fail_together_too() {
        for robots in 1..=3 {
            let (distrusted, noise_scale) = steady(&mut trust(robots), 40, &vec![9.0; robots]);
            assert!(distrusted.is_empty() && noise_scale > 1.5, "{robots}: {noise_scale}");
        }
    }

    #[test]
    fn no_robot_of_three_that_never_agreed_is_distrusted() {
        let mut trust = trust(3);
        assert_eq!(steady(&mut trust, 40, &[0.4, 0.4, 30.0]), (vec![], 1.0));
        let mut trust = self::trust(3);
        steady(&mut trust, 30, &[0.4; 3]);
        assert_eq!(steady(&mut trust, 40, &[0.4, 0.4, 30.0]), (vec![2], 1.0));
    }

    #[test]
    fn occasional_outliers_are_tolerated() {
        let mut trust = trust(4);
        for _ in 0..50 {
            after(&mut trust, 1, &[1]);
            assert_eq!(after(&mut trust, 1, &[]), []);
        }
    }

    #[test]
    fn if_half_the_team_fails_the_filter_is_wrong() {
        let mut trust = trust(4);
        assert_eq!(after(&mut trust, 100, &[0, 3]), []);
        assert_eq!(after(&mut trust, 100, &[0, 1, 2, 3]), []);
        assert_eq!(after(&mut trust, 5, &[3]), [3]);
        // If a second robot fails too, half of the team fails.
        assert_eq!(after(&mut trust, 100, &[0, 3]), [3]);
    }

    #[test]
    fn one_or_two_robots_cannot_identify_a_faulty_sensor() {
        for robots in [1, 2] {
            let mut trust = trust(robots);
            let mut failed = RobotSet::default();
            failed.set(0, true);
            (0..100).for_each(|_| {
                trust.judge((0..robots).map(|id| (id, None)), &failed);
            });
            assert!(trust.distrusted().is_empty(), "{robots}");
        }
    }

    /// Recordings often have one range at a time.
    #[test]
    fn ranges_one_at_a_time_have_the_same_effect() {
        let mut trust = trust(4);
        let mut failed = RobotSet::default();
        failed.set(1, true);
        for tick in 0..4 * 5 {
            trust.judge(std::iter::once((tick % 4, None)), &failed);
        }
        assert!(trust.distrusted().iter().eq([1]));
    }
}
