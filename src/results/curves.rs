//! The curves and paths that are drawn of a run: the logs of its nodes, thinned.

use std::ops::Range;

use nalgebra::Vector2;
use rangehound_fusion::LATE_TICKS_MAX;
use rangehound_shared::message::Estimate;
use rangehound_shared::record::{FusionRecord, Heading, WorldRecord};
use rangehound_shared::robot_set::RobotSet;
use rangehound_shared::scenario::Scenario;

use crate::draw::belief::Belief;
use crate::draw::field::Paths;
use crate::results::frame::LoggedTick;
use crate::results::report::{Truth, position_covariance};

/// Most points of a curve; more could not be distinguished.
const POINTS_MAX: u64 = 1_500;

/// Most points of all robots' paths together, so that the page stays small enough to send.
const ROBOT_POINTS_MAX: u64 = 50_000;

/// Most buckets that a run is cut into.
const BUCKETS_MAX: u64 = 300;

/// Largest number that axes can be made for.
pub const DRAWABLE_MAX: f64 = 1e15;

/// The drawn ticks, at a regular interval.
#[derive(Debug, Clone, Default)]
pub struct Curves {
    /// Their times, s.
    pub times_s: Vec<f64>,
    /// Positions of the target, the estimate and the robots.
    pub paths: Paths,
    /// The proven lower bound of the trace: time and trace, s and m^2.
    pub least_traces_m2: Vec<(f64, f64)>,
    /// Sums over all ticks, in buckets.
    pub buckets: Vec<Bucket>,
    /// End times of ticks, monotonic ns, and their run times, s.
    ended_ns: Vec<(u64, f64)>,
}

/// Sums over some consecutive ticks.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Bucket {
    first_tick: u64,
    /// Time of its first tick, s.
    pub time_s: f64,
    /// Ticks.
    pub ticks: u64,
    /// Normalised innovation squared.
    pub nis: f64,
    /// Ranges fused in time: degrees of freedom of the NIS.
    pub fused: u64,
    /// Robots whose range was missing or too late to be used.
    pub missing: u64,
    /// Ranges that came after their tick.
    pub late: u64,
    /// Robots that were distrusted.
    pub distrusted: u64,
    /// Robots that drove without a heading.
    pub without_heading: u64,
}

impl Bucket {
    fn add(&mut self, estimate: &Estimate) {
        // A damaged log may hold any number.
        let add = |sum: &mut u64, count: u64| *sum = sum.saturating_add(count);
        self.ticks += 1;
        self.nis += estimate.nis;
        add(&mut self.fused, estimate.fused);
        add(&mut self.missing, estimate.missing);
        add(&mut self.late, estimate.late);
        add(&mut self.distrusted, estimate.distrusted.map(|bits| RobotSet::from_bits(bits).len() as u64).iter().sum());
    }
}

/// Collects the curves of a run tick by tick; `truth` is the target's true track if the run does not know it.
#[derive(Debug)]
pub struct CurvesBuilder<'a> {
    curves: Curves,
    scenario: &'a Scenario,
    thinning: Thinning,
    truth: Option<&'a Truth>,
}

impl<'a> CurvesBuilder<'a> {
    /// Curves before their first tick.
    #[must_use]
    pub fn new(scenario: &'a Scenario, truth: Option<&'a Truth>) -> Self {
        let curves = Curves { paths: Paths::of_team(scenario), ..Curves::default() };
        Self { curves, scenario, thinning: Thinning::of(scenario), truth }
    }

    /// Adds the next tick.
    pub fn add(&mut self, logged: LoggedTick<'_>) {
        if logged.tick > 0 {
            self.curves.add(logged, self.scenario, self.thinning, self.truth);
        }
    }

    /// The curves of all ticks that were added.
    ///
    /// # Errors
    /// If the logs hold numbers that cannot be drawn.
    pub fn finish(self) -> anyhow::Result<Curves> {
        if !self.curves.can_be_drawn() {
            anyhow::bail!(
                "the logs have numbers that cannot be drawn (not finite, or too large): check noise and units of the scenario"
            );
        }
        Ok(self.curves)
    }
}

impl Curves {
    fn add(&mut self, logged: LoggedTick<'_>, scenario: &Scenario, thinning: Thinning, truth: Option<&Truth>) {
        let LoggedTick { tick, fusion, world } = logged;
        if let Some(FusionRecord { time_s, estimate, .. }) = fusion {
            self.add_to_bucket(tick, *time_s, estimate, thinning);
            if thinning.keeps(tick) {
                self.times_s.push(*time_s);
                self.paths.estimates_m.push(Vector2::new(estimate.state[0], estimate.state[1]));
                self.paths.covariances_m2.push(position_covariance(estimate));
                self.paths.truths_m.push(logged.target_m().or_else(|| truth.and_then(|truth| truth.at(*time_s))));
                let least_m2 = estimate.least_trace_m2;
                if least_m2 > 0.0 && least_m2 <= DRAWABLE_MAX {
                    self.least_traces_m2.push((time_s + scenario.dt_s, least_m2));
                }
            }
        }
        if let Some(WorldRecord { time_s, ended_ns, robots, .. }) = world {
            if let Some(bucket) = self.buckets.last_mut() {
                let without = robots.iter().filter(|robot| robot.heading == Heading::None);
                bucket.without_heading += without.count() as u64;
            }
            if thinning.keeps(tick) {
                self.ended_ns.push((*ended_ns, *time_s));
                for (path, robot) in self.paths.robots_m.iter_mut().zip(robots) {
                    path.push(robot.pose.position_m());
                }
            }
        }
        if let (Some(fusion), Some(world)) = (fusion, world)
            && thinning.keeps(tick)
        {
            for (beliefs, belief) in self.paths.beliefs.iter_mut().zip(Belief::all(&scenario.robots, fusion, world)) {
                beliefs.extend(belief.filter(|belief| !belief.is_plain()));
            }
        }
    }

    fn add_to_bucket(&mut self, tick: u64, time_s: f64, estimate: &Estimate, thinning: Thinning) {
        let Self { buckets, .. } = self;
        if buckets.last().is_none_or(|last| tick - last.first_tick >= thinning.bucket) {
            buckets.push(Bucket { first_tick: tick, time_s, ..Bucket::default() });
        }
        if let Some(bucket) = buckets.last_mut() {
            bucket.add(estimate);
        }
        // A late range was counted as missing at its own tick: in this bucket or shortly before. Correct that here.
        let mut came = estimate.fused_late.saturating_add(estimate.rejected_late);
        for bucket in buckets.iter_mut().rev().take(LATE_TICKS_MAX + 1) {
            let found = came.min(bucket.missing);
            bucket.missing -= found;
            came -= found;
        }
    }

    /// True if all numbers are finite and small enough: otherwise the loops that draw axes and ellipses would not end.
    fn can_be_drawn(&self) -> bool {
        let Paths { estimates_m, covariances_m2, beliefs, .. } = &self.paths;
        let rays_m = beliefs.iter().flatten().filter_map(|belief| belief.ray_end_m.as_ref());
        let own_m2 = beliefs.iter().flatten().filter_map(|belief| belief.covariance_m2.as_ref());
        let places = estimates_m.iter().chain(self.paths.bodies()).chain(rays_m).flat_map(|place| place.iter());
        let buckets = self.buckets.iter().map(|bucket| &bucket.time_s);
        let numbers = places.chain(covariances_m2.iter().chain(own_m2).flat_map(|covariance| covariance.iter()));
        let ends = self.ended_ns.iter().map(|(_, time_s)| time_s);
        numbers.chain(&self.times_s).chain(buckets).chain(ends).all(|number| number.abs() <= DRAWABLE_MAX)
            && self.times_s.is_sorted()
    }

    /// True if at least one tick was added.
    #[must_use]
    pub fn has_length(&self) -> bool {
        self.times_s.len() >= 2
    }

    /// Times of the first and the last tick, s.
    #[must_use]
    pub fn span_s(&self) -> Range<f64> {
        let first = self.times_s.first().copied().unwrap_or_default();
        let last = self.times_s.last().copied().unwrap_or_default();
        first..last.max(first + first.abs() * 1e-9 + 1e-3)
    }

    /// Position errors where the truth is known: time and error, s and m.
    pub fn errors_m(&self) -> impl Iterator<Item = (f64, Vector2<f64>)> {
        let errors = self.times_s.iter().zip(&self.paths.estimates_m).zip(&self.paths.truths_m);
        errors.filter_map(|((time_s, estimate_m), truth_m)| Some((*time_s, estimate_m - truth_m.as_ref()?)))
    }

    /// Traces of the position covariance: time and trace, s and m^2.
    pub fn traces_m2(&self) -> impl Iterator<Item = (f64, f64)> {
        self.times_s.iter().zip(&self.paths.covariances_m2).map(|(time_s, p)| (*time_s, p.trace()))
    }

    /// The run time at a monotonic time: that of the tick in progress, or of the nearest tick. `None` without ticks.
    #[must_use]
    pub fn time_s_at(&self, monotonic_ns: u64) -> Option<f64> {
        let after = self.ended_ns.partition_point(|(ended_ns, _)| *ended_ns < monotonic_ns);
        let before = after.checked_sub(1).and_then(|before| self.ended_ns.get(before));
        match (before, self.ended_ns.get(after)) {
            (Some((from_ns, from_s)), Some((to_ns, to_s))) => {
                let passed = monotonic_ns.saturating_sub(*from_ns) as f64;
                let part = passed / to_ns.saturating_sub(*from_ns).max(1) as f64;
                Some(from_s + (to_s - from_s) * part.clamp(0.0, 1.0))
            }
            (Some((_, time_s)), None) | (None, Some((_, time_s))) => Some(*time_s),
            (None, None) => None,
        }
    }
}

/// Which ticks of a run are drawn.
#[derive(Debug, Clone, Copy)]
struct Thinning {
    /// The interval between drawn ticks.
    every: u64,
    /// The last tick, which is always drawn.
    last: u64,
    /// Ticks of a bucket.
    bucket: u64,
}

impl Thinning {
    fn of(scenario: &Scenario) -> Self {
        let points = (ROBOT_POINTS_MAX / scenario.robots.len().max(1) as u64).clamp(1, POINTS_MAX);
        let last = scenario.ticks;
        Self { every: last / points + 1, last, bucket: last / BUCKETS_MAX + 1 }
    }

    fn keeps(self, tick: u64) -> bool {
        tick.is_multiple_of(self.every) || tick == self.last
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_event_between_two_ticks_gets_a_time_between_them() {
        let curves = Curves { ended_ns: vec![(1_000, 0.1), (3_000, 0.2), (9_000, 0.3)], ..Curves::default() };
        let near = |at_ns, expected: f64| (curves.time_s_at(at_ns).unwrap() - expected).abs() < 1e-12;
        assert!(near(0, 0.1) && near(2_000, 0.15) && near(3_000, 0.2) && near(6_000, 0.25) && near(u64::MAX, 0.3));
        assert_eq!(Curves::default().time_s_at(5), None);
    }

    #[test]
    fn long_runs_and_large_teams_are_thinned_down_to_the_last_tick() {
        for (ticks, every) in [(1, 1), (1_499, 1), (1_500, 2), (200_000, 134)] {
            let thinning = Thinning { every: ticks / POINTS_MAX + 1, last: ticks, bucket: 1 };
            assert_eq!(thinning.every, every);
            let kept = (1..=ticks).filter(|tick| thinning.keeps(*tick)).count() as u64;
            assert!(thinning.keeps(ticks) && kept <= POINTS_MAX + 1, "{ticks} {kept}");
        }
    }
}
