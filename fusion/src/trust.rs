//! Fault detection of sensors, pure. A robot whose measurements of a kind keep failing the gate is distrusted until they
//! pass again. If most sensors fail together, the filter or the assumed noise is wrong.

use rangehound_shared::measurement::Kind;
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

/// Change of the estimated noise of a sensor with each measurement, in the logarithm of the variance. Steps of equal size
/// make the estimate follow the median, so an outlier moves it no more than any other measurement. It forgets within about
/// twenty measurements, and its standard deviation is 0.34.
const LOG_STEP: f64 = 0.1;

/// Logarithms of the ratio of the median sensor's noise variance to the reported one. From the first on, sensors count
/// as failing together: twice the reported variance, two standard deviations of one sensor's estimate. Below the second
/// they no longer do: the square root of twice.
const LOG_WIDENED: f64 = 0.7;
const LOG_NARROW: f64 = 0.35;

/// Limits of the logarithm.
const LOG_MAX: f64 = 14.0;
const LOG_MIN: f64 = -1.0;

/// Measurements of a sensor before its noise is estimated, and measurements of the team, in multiples of its size, after
/// which a sensor without one no longer counts.
const MEASUREMENTS_MIN: u32 = 8;
const RECENT_ROUNDS: u64 = 8;

/// Number of other sensors that can identify a faulty one. Two are not enough: their ranges fit some position even if
/// one of the two is faulty.
const OTHERS_MIN: usize = 3;

/// Fewest sensors of a kind whose median tells whether they fail together.
const ALIKE_MIN: usize = 3;

/// Measurements of each sensor that establish that the team agrees: enough to detect twice the reported variance.
const AGREED_MEASUREMENTS: u32 = 24;

/// Largest factor by which the estimate's variance is inflated at one tick.
const LOST_MAX: f64 = 1e6;

/// Measures against ranges that fail.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Policy {
    /// Robots are distrusted.
    pub distrusts: bool,
    /// If most sensors fail together, ranges are assumed noisier than reported.
    pub raises_noise: bool,
}

/// The gate's decisions on the measurements of each sensor. A sensor is what measures one kind for one robot.
///
/// A sensor is distrusted once [`FAILURES_MAX`] of its last [`RECENT`] measurements failed, and trusted again once all of
/// them passed. A failure counts only while more than half of the team's newest measurements, of all kinds, pass:
/// otherwise the filter may be wrong. If fewer than three other sensors are trusted, a sensor is distrusted only if the
/// whole team has agreed before: otherwise the others may be wrong.
///
/// The noise of each sensor is also estimated, from the median of its normalised innovations squared, which is robust
/// to outliers. If the median sensor of a kind is noisier than reported, most of them fail together: because of a common
/// bias, more noise than reported, or a lost estimate. Until that is over, none of them is distrusted, and all
/// measurements of that kind are assumed to be as much noisier than reported as the median sensor's. Fewer than three
/// sensors of a kind have no median that tells a faulty one: there the median of all kinds decides.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Trust {
    policy: Policy,
    robots: usize,
    kinds: [OfKind; Kind::COUNT],
    /// Which of the team's newest measurements failed: a circular buffer with a place for each sensor.
    newest_failed: Vec<bool>,
    next_place: usize,
    /// Measurements of the team so far.
    measurements: u64,
    /// True once the measurements of all sensors were as good as reported.
    has_agreed: bool,
    /// Reused memory.
    #[serde(skip)]
    scratch: Vec<f64>,
}

/// The sensors of one kind, by robot.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
struct OfKind {
    /// The newest decision in the lowest bit: 1 for a measurement that failed.
    records: Vec<u8>,
    noises: Vec<Noise>,
    distrusted: RobotSet,
    /// Logarithm of the factor on all variances while the sensors fail together.
    widened_log: Option<f64>,
}

/// Noise of one sensor.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
struct Noise {
    /// Logarithm of the ratio of its measurements' variance to the reported one.
    log: f64,
    /// Measurements so far, and the team's count at the last of them.
    measurements: u32,
    last: u64,
}

/// The gate's decision on one measurement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Decision {
    /// The robot.
    pub robot: usize,
    /// Its measurement.
    pub kind: Kind,
    /// True if the measurement failed the gate.
    pub has_failed: bool,
    /// Its normalised innovation squared, if it was predicted and shows the noise of the sensor.
    pub normalised_square: Option<f64>,
}

impl Trust {
    /// Trusts all robots of a team.
    #[must_use]
    pub fn new(robots: usize, policy: Policy) -> Self {
        let of_kind =
            || OfKind { records: vec![0; robots], noises: vec![Noise::default(); robots], ..OfKind::default() };
        Self {
            policy,
            robots,
            kinds: std::array::from_fn(|_| of_kind()),
            newest_failed: vec![false; Kind::COUNT * robots],
            next_place: 0,
            measurements: 0,
            has_agreed: false,
            scratch: Vec::with_capacity(Kind::COUNT * robots),
        }
    }

    /// The robots whose measurements of a kind are distrusted.
    #[must_use]
    pub fn distrusted(&self, kind: Kind) -> RobotSet {
        self.kinds[kind as usize].distrusted
    }

    /// True if a robot's measurements of a kind are distrusted.
    #[must_use]
    pub fn distrusts(&self, robot: usize, kind: Kind) -> bool {
        self.distrusted(kind).contains(robot)
    }

    /// True if this is the trust of a team of this size.
    #[must_use]
    pub fn is_of(&self, robots: usize) -> bool {
        let of_team = |of_kind: &OfKind| [of_kind.records.len(), of_kind.noises.len()] == [robots; 2];
        self.robots == robots && self.newest_failed.len() == Kind::COUNT * robots && self.kinds.iter().all(of_team)
    }

    /// Factor on the reported standard deviations of a kind: 1 unless most sensors fail together.
    #[must_use]
    pub fn noise_scale(&self, kind: Kind) -> f64 {
        self.kinds[kind as usize].widened_log.map_or(1.0, |log| (0.5 * log).exp())
    }

    /// Copies the trust of the same team without allocating.
    pub fn copy_from(&mut self, other: &Self) {
        for (into, from) in self.kinds.iter_mut().zip(&other.kinds) {
            into.records.clone_from(&from.records);
            into.noises.clone_from(&from.noises);
            (into.distrusted, into.widened_log) = (from.distrusted, from.widened_log);
        }
        self.newest_failed.clone_from(&other.newest_failed);
        (self.policy, self.next_place) = (other.policy, other.next_place);
        (self.measurements, self.has_agreed) = (other.measurements, other.has_agreed);
    }

    /// Takes the gate's decisions of a tick. Returns a factor for the estimate's variance. It is more than 1 if sensors of
    /// a kind fail together and at least half of the newest measurements fail although more noise is assumed: then the
    /// estimate may be lost.
    pub fn judge(&mut self, decisions: impl Iterator<Item = Decision> + Clone) -> f64 {
        let sensors = self.sensors();
        for decision in decisions.clone() {
            self.newest_failed[self.next_place % sensors] = decision.has_failed;
            self.next_place = (self.next_place + 1) % sensors;
        }
        let failures = self.newest_failed[..sensors].iter().filter(|has_failed| **has_failed).count();
        let filter_is_wrong = 2 * failures >= sensors;
        if self.policy.raises_noise {
            self.follow_noise(decisions.clone(), sensors);
        }
        let mut factor = 1.0_f64;
        for (kind, of_kind) in Kind::ALL.into_iter().zip(&mut self.kinds) {
            if of_kind.widened_log.is_none() {
                continue;
            }
            // All robots are trusted, and their failures so far do not count.
            of_kind.distrusted = RobotSet::default();
            of_kind.records.fill(0);
            let of_this = decisions.clone().filter(|decision| decision.kind == kind);
            let squares = of_this.filter_map(|decision| decision.normalised_square);
            let (sum, count) = squares.fold((0.0, 0.0), |(sum, count), square| (sum + square, count + 1.0));
            if filter_is_wrong && count > 0.0 {
                factor = factor.max((sum / count).clamp(1.0, LOST_MAX));
            }
        }
        if self.policy.distrusts {
            self.count_failures(decisions, sensors, filter_is_wrong);
        }
        factor
    }

    fn count_failures(&mut self, decisions: impl Iterator<Item = Decision>, sensors: usize, filter_is_wrong: bool) {
        for Decision { robot, kind, has_failed, .. } in decisions {
            if self.kinds[kind as usize].widened_log.is_some() || has_failed && filter_is_wrong {
                continue;
            }
            let distrusted: usize = self.kinds.iter().map(|of_kind| of_kind.distrusted.len()).sum();
            let can_identify = self.has_agreed || sensors.saturating_sub(distrusted) > OTHERS_MIN;
            let OfKind { records, distrusted, .. } = &mut self.kinds[kind as usize];
            let record = &mut records[robot];
            *record = *record << 1 | u8::from(has_failed);
            if record.count_ones() >= FAILURES_MAX && can_identify {
                distrusted.set(robot, true);
            } else if *record == 0 {
                distrusted.set(robot, false);
            }
        }
    }

    /// Tracks each sensor's noise, and checks whether most sensors of a kind are worse than reported.
    fn follow_noise(&mut self, decisions: impl Iterator<Item = Decision>, sensors: usize) {
        for Decision { robot, kind, normalised_square, .. } in decisions {
            let Some(square) = normalised_square else { continue };
            self.measurements += 1;
            let OfKind { noises, widened_log, .. } = &mut self.kinds[kind as usize];
            let Noise { log, measurements, .. } = noises[robot];
            // The square is normalised by the noise that is assumed at present; here it is normalised by this sensor's
            // own.
            let taken_log = widened_log.unwrap_or(0.0);
            let step = match square * (taken_log - log).exp() > CHI_SQUARE_MEDIAN {
                // The first squares reflect the initial uncertainty, not the noise.
                _ if measurements < MEASUREMENTS_MIN => 0.0,
                true => LOG_STEP,
                false => -LOG_STEP,
            };
            let log = (log + step).clamp(LOG_MIN, LOG_MAX);
            noises[robot] = Noise { log, measurements: measurements.saturating_add(1), last: self.measurements };
        }
        let oldest = self.measurements.saturating_sub(RECENT_ROUNDS * sensors as u64);
        let widened = Kind::ALL.map(|kind| {
            let OfKind { noises, widened_log, .. } = &self.kinds[kind as usize];
            let threshold = if widened_log.is_some() { LOG_NARROW } else { LOG_WIDENED };
            let median = match noises.iter().filter(|noise| noise.counts(oldest)).count() {
                0 => None,
                known if known < ALIKE_MIN => self.median(&Kind::ALL, oldest),
                _ => self.median(&[kind], oldest),
            };
            median.filter(|median| *median >= threshold)
        });
        self.kinds.iter_mut().zip(widened).for_each(|(of_kind, log)| of_kind.widened_log = log);
        let agrees = |noise: &Noise| noise.measurements >= AGREED_MEASUREMENTS && noise.log < LOG_WIDENED;
        self.has_agreed |=
            widened.iter().all(Option::is_none) && self.heard().count() >= self.robots && self.heard().all(agrees);
    }

    /// The number of sensors. A robot counts as one before it has measured anything.
    fn sensors(&self) -> usize {
        self.heard().count().max(self.robots)
    }

    /// The noises of all sensors that have measured.
    fn heard(&self) -> impl Iterator<Item = &Noise> {
        self.kinds.iter().flat_map(|of_kind| &of_kind.noises).filter(|noise| noise.measurements > 0)
    }

    /// The median noise of the trusted sensors of these kinds that have measured since then.
    fn median(&mut self, kinds: &[Kind], oldest: u64) -> Option<f64> {
        self.scratch.clear();
        for kind in kinds {
            let OfKind { noises, distrusted, .. } = &self.kinds[*kind as usize];
            let trusted = noises.iter().enumerate().filter(|(robot, _)| !distrusted.contains(*robot));
            self.scratch.extend(trusted.filter(|(_, noise)| noise.counts(oldest)).map(|(_, noise)| noise.log));
        }
        // The lower one of two middle values: of two sensors the faulty one cannot be identified.
        let last = self.scratch.len().checked_sub(1)?;
        Some(*self.scratch.select_nth_unstable_by(last / 2, f64::total_cmp).1)
    }
}

impl Noise {
    /// True if the sensor has measured often, and since then.
    fn counts(&self, oldest: u64) -> bool {
        self.measurements >= MEASUREMENTS_MIN && self.last >= oldest
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const POLICY: Policy = Policy { distrusts: true, raises_noise: true };

    fn trust(robots: usize) -> Trust {
        Trust::new(robots, POLICY)
    }

    fn of(kind: Kind, robot: usize, has_failed: bool, normalised_square: Option<f64>) -> Decision {
        Decision { robot, kind, has_failed, normalised_square }
    }

    /// The robots whose ranges are distrusted.
    fn distrusted(trust: &Trust) -> Vec<usize> {
        trust.distrusted(Kind::Range).iter().collect()
    }

    fn scale(trust: &Trust) -> f64 {
        trust.noise_scale(Kind::Range)
    }

    /// A tick at which all robots report ranges with these squares; those of more than 4 sigma fail. Returns the factor.
    fn tick(trust: &mut Trust, squares: &[f64]) -> f64 {
        let ranges = squares.iter().enumerate();
        trust.judge(ranges.map(|(id, square)| of(Kind::Range, id, *square > 16.0, Some(*square))))
    }

    /// Ticks at which these robots of a team of 4 fail; all 4 report. Returns the distrusted robots.
    fn after(trust: &mut Trust, ticks: usize, failing: &[usize]) -> Vec<usize> {
        for _ in 0..ticks {
            trust.judge((0..4).map(|id| of(Kind::Range, id, failing.contains(&id), None)));
        }
        distrusted(trust)
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
        (0..ticks).map(|_| tick(trust, &squares)).fold(1.0, f64::max)
    }

    #[test]
    fn if_most_fail_together_no_robot_is_distrusted_and_all_are_noisier() {
        let mut trust = trust(4);
        noisy(&mut trust, 40, [0.4, 0.4, 30.0, 0.4]);
        assert!(distrusted(&trust) == [2] && scale(&trust) == 1.0, "one of four is faulty");
        let lost = noisy(&mut trust, 40, [9.0, 9.0, 30.0, 9.0]);
        assert!(distrusted(&trust).is_empty() && scale(&trust) > 2.2 && lost == 1.0, "{trust:?}");
        // It ends when the noise is as reported again.
        noisy(&mut trust, 60, [0.4; 4]);
        assert_eq!((scale(&trust), distrusted(&trust).is_empty()), (1.0, true));
    }

    #[test]
    fn if_all_fail_with_widened_noise_too_the_estimate_may_be_lost() {
        let mut trust = trust(4);
        assert_eq!(noisy(&mut trust, 60, [900.0; 4]), 900.0);
        assert!(distrusted(&trust).is_empty());
    }

    #[test]
    fn without_the_switch_no_noise_is_widened_and_no_robot_distrusted() {
        let mut trust = Trust::new(4, Policy { distrusts: false, raises_noise: false });
        assert_eq!(noisy(&mut trust, 60, [900.0, 900.0, 900.0, 0.4]), 1.0);
        noisy(&mut trust, 60, [0.4, 0.4, 30.0, 0.4]);
        assert!(distrusted(&trust).is_empty() && scale(&trust) == 1.0);
    }

    /// The same for a team of any size; returns the distrusted robots and the noise scale.
    fn steady(trust: &mut Trust, ticks: usize, squares: &[f64]) -> (Vec<usize>, f64) {
        for _ in 0..ticks {
            tick(trust, squares);
        }
        (distrusted(trust), scale(trust))
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
            (0..100).for_each(|_| {
                trust.judge((0..robots).map(|id| of(Kind::Range, id, id == 0, None)));
            });
            assert_eq!(distrusted(&trust), [], "{robots}");
        }
    }

    /// Recordings often have one range at a time.
    #[test]
    fn ranges_one_at_a_time_have_the_same_effect() {
        let mut trust = trust(4);
        for tick in 0..4 * 5 {
            trust.judge(std::iter::once(of(Kind::Range, tick % 4, tick % 4 == 1, None)));
        }
        assert_eq!(distrusted(&trust), [1]);
    }

    /// Ticks at which three robots report ranges and some of them also bearings, with these squares.
    fn mixed(trust: &mut Trust, ticks: usize, ranges: &[f64], bearings: &[f64]) {
        let of_kind = |kind: Kind, squares: &[f64]| {
            let decision = move |(id, square): (usize, &f64)| of(kind, id, *square > 16.0, Some(*square));
            squares.iter().enumerate().map(decision).collect::<Vec<_>>()
        };
        let decisions = [of_kind(Kind::Range, ranges), of_kind(Kind::Bearing, bearings)].concat();
        for _ in 0..ticks {
            trust.judge(decisions.iter().copied());
        }
    }

    #[test]
    fn a_faulty_camera_is_distrusted_alone_even_if_it_is_the_only_one() {
        for bearings in [vec![900.0], vec![900.0, 0.4], vec![900.0, 0.4, 0.4]] {
            let mut trust = trust(3);
            mixed(&mut trust, 30, &[0.4; 3], &vec![0.4; bearings.len()]);
            mixed(&mut trust, 60, &[0.4; 3], &bearings);
            assert!(trust.distrusted(Kind::Bearing).iter().eq([0]), "{trust:?}");
            assert!(distrusted(&trust).is_empty() && Kind::ALL.iter().all(|kind| trust.noise_scale(*kind) == 1.0));
            mixed(&mut trust, 8, &[0.4; 3], &vec![0.4; bearings.len()]);
            assert!(trust.distrusted(Kind::Bearing).is_empty(), "{trust:?}");
        }
    }

    #[test]
    fn a_kind_that_is_noisier_than_reported_is_so_alone() {
        let mut trust = trust(3);
        mixed(&mut trust, 60, &[0.4; 3], &[9.0; 3]);
        assert!(trust.noise_scale(Kind::Bearing) > 2.0 && scale(&trust) == 1.0, "{trust:?}");
        assert!(Kind::ALL.iter().all(|kind| trust.distrusted(*kind).is_empty()));
    }

    #[test]
    fn one_robot_that_measures_both_kinds_cannot_identify_the_faulty_one() {
        let mut trust = trust(1);
        mixed(&mut trust, 30, &[0.4], &[0.4]);
        mixed(&mut trust, 60, &[0.4], &[900.0]);
        assert!(Kind::ALL.iter().all(|kind| trust.distrusted(*kind).is_empty()), "{trust:?}");
    }
}
