//! The data of the page's curves: the complete run in a bounded number of points.

use rangehound_shared::record::FusionRecord;
use serde::Serialize;
use serde::ser::SerializeTuple;

use crate::results::frame::Frame;
use crate::results::report::position_covariance;
use crate::statistics::{Interval, chi_square_mean_bounds, median};

/// Number of points at which neighbours are merged: more would not be visible.
const POINTS_MAX: usize = 600;

/// The run so far. When the number of points reaches its limit, neighbours are merged: each point then covers twice as
/// many ticks.
#[derive(Debug)]
pub(super) struct History {
    /// Ticks of one point.
    stride: u64,
    points: Vec<Point>,
}

/// Some consecutive ticks, as far as they were read.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Point {
    tick: u64,
    time_s: f64,
    /// Of the newest tick; NaN if the truth is unknown.
    error_m: f64,
    trace_m2: f64,
    /// The proven lower bound of the trace at the next tick; NaN if there is none.
    least_next_m2: f64,
    /// Sum of the normalised innovations squared, and their number.
    nis: f64,
    fused: u64,
    /// Range to heading, us: the newest tick's median, and the maximum over all ticks; NaN if unknown.
    latency_us: f64,
    latency_max_us: f64,
}

/// The part of the history that a viewer has.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Known {
    stride: u64,
    points: usize,
}

/// The part that a viewer does not have yet: points from an index on, which replace the viewer's from there.
#[derive(Debug, Serialize)]
pub(super) struct News<'a> {
    from: usize,
    stride: u64,
    points: &'a [Point],
}

impl Default for History {
    fn default() -> Self {
        Self { stride: 1, points: Vec::new() }
    }
}

impl History {
    pub(super) fn add(&mut self, frame: &Frame) {
        // Tick 0 has no range.
        if frame.tick == 0 {
            return;
        }
        let point = Point::of(frame);
        match self.points.last_mut() {
            Some(last) if last.tick / self.stride == point.tick / self.stride => last.add(&point),
            _ => self.points.push(point),
        }
        if self.points.len() >= POINTS_MAX {
            self.halve();
        }
    }

    fn halve(&mut self) {
        self.stride *= 2;
        let mut halved: Vec<Point> = Vec::with_capacity(POINTS_MAX);
        for point in self.points.drain(..) {
            match halved.last_mut() {
                Some(last) if last.tick / self.stride == point.tick / self.stride => last.add(&point),
                _ => halved.push(point),
            }
        }
        self.points = halved;
        // If only few of many ticks were read, no two of them may have merged.
        if self.points.len() >= POINTS_MAX {
            self.halve();
        }
    }

    /// The points that are new to a viewer.
    pub(super) fn news(&self, known: &mut Known) -> News<'_> {
        // The last point may have changed; after a change of the stride all points have.
        let from = if known.stride == self.stride { known.points.saturating_sub(1) } else { 0 };
        *known = Known { stride: self.stride, points: self.points.len() };
        News { from, stride: self.stride, points: self.points.get(from..).unwrap_or_default() }
    }
}

impl Point {
    fn of(frame: &Frame) -> Self {
        let Frame { tick, fusion: FusionRecord { time_s, estimate, .. }, world } = frame;
        let error_m = match *world.truth.as_slice() {
            [x_m, y_m, ..] => (estimate.state[0] - x_m).hypot(estimate.state[1] - y_m),
            _ => f64::NAN,
        };
        let latencies_ns = world.robots.iter().filter_map(|robot| robot.latency_ns());
        let mut latencies_us: Vec<f64> = latencies_ns.map(|ns| ns as f64 / 1e3).collect();
        Self {
            tick: *tick,
            time_s: *time_s,
            error_m,
            trace_m2: position_covariance(estimate).trace(),
            least_next_m2: Some(estimate.least_trace_m2).filter(|least_m2| *least_m2 > 0.0).unwrap_or(f64::NAN),
            nis: estimate.nis,
            fused: estimate.fused,
            latency_us: median(&mut latencies_us).unwrap_or(f64::NAN),
            latency_max_us: latencies_us.into_iter().fold(f64::NAN, f64::max),
        }
    }

    /// Merges the point of later ticks into this one.
    fn add(&mut self, later: &Self) {
        let (nis, fused) = (self.nis + later.nis, self.fused.saturating_add(later.fused));
        let latency_max_us = self.latency_max_us.max(later.latency_max_us);
        let latency_us = if later.latency_us.is_nan() { self.latency_us } else { later.latency_us };
        *self = Self { nis, fused, latency_us, latency_max_us, ..*later };
    }
}

impl Serialize for Point {
    /// As an array, which is short: tick, s, error m, trace m^2, NIS per range with its 95 % bounds, median and largest
    /// latency us, lower bound of the next tick's trace m^2. Unknown values are `null`.
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let Self { tick, time_s, error_m, trace_m2, least_next_m2, nis, fused, latency_us, latency_max_us } = *self;
        let (nis, Interval { low, high }) = match usize::try_from(fused) {
            Ok(fused @ 1..) => (nis / fused as f64, chi_square_mean_bounds(1, fused)),
            _ => (f64::NAN, Interval { low: f64::NAN, high: f64::NAN }),
        };
        let mut point = serializer.serialize_tuple(10)?;
        point.serialize_element(&tick)?;
        for value in [time_s, error_m, trace_m2, nis, low, high, latency_us, latency_max_us, least_next_m2] {
            point.serialize_element(&short(value))?;
        }
        point.end()
    }
}

/// A number rounded to the digits that a picture can show.
fn short(value: f64) -> f64 {
    let digits = 6 - value.abs().log10().ceil().clamp(-9.0, 6.0) as i32;
    let scale = 10f64.powi(digits);
    (value * scale).round() / scale
}

#[cfg(test)]
mod tests {
    use rangehound_shared::message::Estimate;
    use rangehound_shared::record::{FusionRecord, WorldRecord};

    use super::*;

    fn frame(tick: u64) -> Frame {
        let estimate = Estimate { state_dim: 4, nis: 2.0, fused: 2, ..Estimate::default() };
        let fusion = FusionRecord { time_s: tick as f64 * 0.1, estimate, exchanges: Vec::new() };
        Frame { tick, fusion, world: WorldRecord::default() }
    }

    #[test]
    fn a_run_of_any_length_has_few_points_and_loses_no_tick() {
        let mut history = History::default();
        for tick in 1..=100_000 {
            history.add(&frame(tick));
            assert!(history.points.len() < POINTS_MAX);
        }
        assert!(history.points.len() >= POINTS_MAX / 2 - 1 && history.points.is_sorted_by_key(|point| point.tick));
        assert_eq!(history.points.iter().map(|point| point.fused).sum::<u64>(), 200_000);
        assert_eq!(history.points.last().map(|point| point.tick), Some(100_000));
    }

    #[test]
    fn ticks_that_lie_far_apart_are_few_points_too() {
        let mut history = History::default();
        (1..5_000).for_each(|tick| history.add(&frame(tick * 1_000)));
        assert!(history.points.len() < POINTS_MAX);
    }

    #[test]
    fn early_and_late_viewers_have_the_same_points() {
        let (mut history, mut known, mut points) = (History::default(), Known::default(), Vec::new());
        for tick in 1..=3_000 {
            history.add(&frame(tick));
            // The viewer misses some looks.
            if tick % 7 != 0 {
                let News { from, points: new, .. } = history.news(&mut known);
                points.truncate(from);
                points.extend_from_slice(new);
                assert!(from == 0 || new.len() <= 3, "{from} {}", new.len());
            }
        }
        history.news(&mut known).points.iter().for_each(|_| {});
        assert_eq!(points.len(), history.points.len());
        assert_eq!(points.first().map(|point| point.tick), history.points.first().map(|point| point.tick));
    }

    #[test]
    fn numbers_are_as_long_as_they_need_be() {
        assert_eq!(short(123.456_789_1), 123.457);
        assert_eq!(short(0.000_123_456_789), 0.000_123_457);
        assert_eq!((short(0.0), short(-2.0), short(1e12)), (0.0, -2.0, 1e12));
        assert!(short(f64::NAN).is_nan());
    }
}
