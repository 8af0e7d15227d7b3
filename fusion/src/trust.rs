//! Fault detection of sensors, pure. A robot whose ranges keep failing the gate is distrusted until they pass again. If
//! most sensors fail together, the filter or the assumed noise is wrong.

use rangehound_shared::robot_set::RobotSet;
use serde::{Deserialize, Serialize};

/// Number of stored gate decisions of each robot: bits of its record.
pub const RECENT: u32 = u8::BITS;

/// A robot with this many failures among them is distrusted: a tick or two with outliers are tolerated. With a gate of
/// 4 sigma, of 200 runs each with 3, 4, 5 and 8 robots and one sensor that reads 10 or 30 sigma too much, all named
/// that one, 95 % of them within five ticks, and no other. Off by 6 sigma it hides behind the gate: of 3 robots the
/// estimate follows it before the gate detects it, and in one run of five a valid sensor is distrusted instead.
pub const FAILURES_MAX: u32 = 5;

/// Median of a chi-square of one degree of freedom: half of a sensor's normalised innovations squared exceed it if the
/// sensor's noise is as reported.
const CHI_SQUARE_MEDIAN: f64 = 0.454_936_423_119_572_8;

/// Change of the logarithm of a sensor's noise variance with each range: a tracker of the median that forgets within
/// some twenty ranges, has a standard deviation of 0.34, and is moved by outliers no more than by other ranges.
const LOG_STEP: f64 = 0.1;

/// Ratio of the team's noise variance to the reported one at which its sensors count as failing together, and below
/// which they no longer do: twice, two standard deviations of one sensor's tracker, and the root of that.
const LOG_WIDENED: f64 = 0.7;
const LOG_NARROW: f64 = 0.35;

/// Limit of the logarithm's magnitude.
const LOG_MAX: f64 = 14.0;
const LOG_MIN: f64 = -1.0;

/// Ranges of a sensor before its noise is followed, and ranges of the team, in multiples of its size, after which a sensor that
/// was not heard counts no more.
const RANGES_MIN: u32 = 8;
const RECENT_ROUNDS: u64 = 8;

/// Number of valid sensors that can identify a faulty one. Two fit any position, so a sensor that they contradict may be valid.
const JURY: usize = 3;

/// Ranges of each sensor after which a team that agrees is known to: time to detect noise of twice the reported one.
const AGREED_RANGES: u32 = 24;

/// Largest inflation of the estimate's variance at once.
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
/// A robot is distrusted once [`FAILURES_MAX`] of its last [`RECENT`] ranges failed, and trusted again once all of
/// them passed. Failures count only while most of the team's newest ranges pass: if half of them or more fail, the
/// filter may be wrong. If fewer than three robots would be left, a robot is distrusted only if all of them have agreed
/// before: otherwise the others may be wrong.
///
/// The noise of each sensor is also tracked, by the median of its normalised innovations squared, which is robust to
/// outliers. If the median sensor is worse than reported, most sensors fail together: by a common bias, by more noise
/// than reported, or because the estimate is lost. Until that is over, no robot is distrusted, and the noise of all
/// ranges is assumed as large as it is observed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Trust {
    policy: Policy,
    /// Of each robot, newest lowest: 1 for a range that failed.
    records: Vec<u8>,
    distrusted: RobotSet,
    /// Which of the team's newest ranges failed, as many as it has robots; places are taken in turn.
    newest_failed: RobotSet,
    next_place: usize,
    noises: Vec<Noise>,
    /// Ranges of the team so far.
    ranges: u64,
    /// Logarithm of the factor on all variances while sensors fail together.
    widened_log: Option<f64>,
    /// True once the ranges of all robots were as good as reported.
    has_agreed: bool,
    /// Memory only.
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

    /// Becomes a copy of another of the same team, in the memory that is there.
    pub fn copy_from(&mut self, other: &Self) {
        self.policy = other.policy;
        self.records.clone_from(&other.records);
        self.noises.clone_from(&other.noises);
        (self.distrusted, self.newest_failed, self.next_place) =
            (other.distrusted, other.newest_failed, other.next_place);
        (self.ranges, self.widened_log, self.has_agreed) = (other.ranges, other.widened_log, other.has_agreed);
    }

    /// Takes what the gate said of a tick's ranges: of whom they are, with their normalised innovations squared where
    /// anything predicted them, and whose failed. Returns how many times less certain the estimate is to be taken, in
    /// variance: more than 1 where sensors fail together and most of the newest ranges fail even so, so that it may be lost.
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
            // No robot is distrusted, and none was before.
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
            let can_tell = self.has_agreed || robots - self.distrusted.len() > JURY;
            let record = &mut self.records[id];
            *record = *record << 1 | u8::from(has_failed);
            if record.count_ones() >= FAILURES_MAX && can_tell {
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
            // Squares are of the noise as it is taken at present; here they are of this sensor's own.
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
        // The lower one of a pair: with one or two sensors the faulty one cannot be identified.
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

    /// Ticks of which each tells who fails, in a team of 4 that is all heard.
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

    /// Ranges of a team of 4 that is all heard, with the same squares at each tick, failing a gate of 4 sigma.
    fn noisy(trust: &mut Trust, ticks: usize, squares: [f64; 4]) -> f64 {
        let mut failed = RobotSet::default();
        squares.iter().enumerate().for_each(|(id, square)| failed.set(id, *square > 16.0));
        (0..ticks).map(|_| trust.judge((0..4).map(|id| (id, Some(squares[id]))), &failed)).fold(1.0, f64::max)
    }

    #[test]
    fn if_most_fail_together_no_robot_is_distrusted_and_all_are_noisier() {
        let mut trust = trust(4);
        noisy(&mut trust, 40, [0.4, 0.4, 30.0, 0.4]);
        assert!(trust.distrusted().iter().eq([2]) && trust.noise_scale() == 1.0, "one of four is to blame");
        let lost = noisy(&mut trust, 40, [9.0, 9.0, 30.0, 9.0]);
        assert!(trust.distrusted().is_empty() && trust.noise_scale() > 2.2 && lost == 1.0, "{trust:?}");
        // As long as it is so, and no longer.
        noisy(&mut trust, 60, [0.4; 4]);
        assert_eq!((trust.noise_scale(), trust.distrusted().is_empty()), (1.0, true));
    }

    #[test]
    fn where_nearly_all_fail_however_noisy_they_are_taken_to_be_the_estimate_may_be_lost() {
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

    /// The same for a team of any size: who is distrusted, and how noisy the ranges are taken to be.
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
    fn an_outlier_now_and_then_is_forgiven() {
        let mut trust = trust(4);
        for _ in 0..50 {
            after(&mut trust, 1, &[1]);
            assert_eq!(after(&mut trust, 1, &[]), []);
        }
    }

    #[test]
    fn where_half_the_team_fails_the_filter_is_wrong() {
        let mut trust = trust(4);
        assert_eq!(after(&mut trust, 100, &[0, 3]), []);
        assert_eq!(after(&mut trust, 100, &[0, 1, 2, 3]), []);
        assert_eq!(after(&mut trust, 5, &[3]), [3]);
        // A second one beside it makes half of them.
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

    /// As in recordings, where ranges come one by one.
    #[test]
    fn ranges_one_at_a_time_do_as_well() {
        let mut trust = trust(4);
        let mut failed = RobotSet::default();
        failed.set(1, true);
        for tick in 0..4 * 5 {
            trust.judge(std::iter::once((tick % 4, None)), &failed);
        }
        assert!(trust.distrusted().iter().eq([1]));
    }
}
