//! Range to heading, over all ticks that were looked at and over the last seconds.

use std::time::{Duration, Instant};

use hdrhistogram::Histogram;
use serde::Serialize;

use crate::frame::Frame;

/// Half of what "the last seconds" are.
const HALF: Duration = Duration::from_secs(5);

#[derive(Debug)]
pub(super) struct Latencies {
    /// `None` where the system gives no memory for it.
    histograms: Option<Histograms>,
}

#[derive(Debug)]
struct Histograms {
    all: Histogram<u64>,
    /// The half before, full, and the half that is being filled.
    before: Histogram<u64>,
    now: Histogram<u64>,
    since: Instant,
}

/// Percentiles, us.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub(super) struct Latency {
    all: Option<Percentiles>,
    recent: Option<Percentiles>,
}

#[derive(Debug, Clone, Copy, Serialize)]
struct Percentiles {
    count: u64,
    p50: f64,
    p90: f64,
    p99: f64,
    max: f64,
}

impl Default for Latencies {
    fn default() -> Self {
        let histogram = || Histogram::new(3).ok();
        let histograms = histogram().zip(histogram()).zip(histogram());
        let since = Instant::now();
        Self { histograms: histograms.map(|((all, before), now)| Histograms { all, before, now, since }) }
    }
}

impl Latencies {
    pub(super) fn add(&mut self, frame: &Frame) {
        let Some(Histograms { all, before, now, since }) = &mut self.histograms else { return };
        if since.elapsed() >= HALF {
            std::mem::swap(before, now);
            now.reset();
            *since = Instant::now();
        }
        for latency_ns in frame.world.robots.iter().filter_map(|robot| robot.latency_ns()) {
            // They resize as needed, so nothing can be out of their bounds.
            let _ = (all.record(latency_ns), now.record(latency_ns));
        }
    }

    /// Adds a tick of before anybody looked, which is not of the last seconds.
    pub(super) fn recall(&mut self, frame: &Frame) {
        let Some(Histograms { all, .. }) = &mut self.histograms else { return };
        for latency_ns in frame.world.robots.iter().filter_map(|robot| robot.latency_ns()) {
            let _ = all.record(latency_ns);
        }
    }

    pub(super) fn summary(&self) -> Latency {
        let Some(Histograms { all, before, now, .. }) = &self.histograms else { return Latency::default() };
        let mut recent = before.clone();
        // They are alike, so that it cannot fail.
        let _ = recent.add(now);
        Latency { all: Percentiles::of(all), recent: Percentiles::of(&recent) }
    }
}

impl Percentiles {
    fn of(histogram: &Histogram<u64>) -> Option<Self> {
        let at = |quantile| histogram.value_at_quantile(quantile) as f64 / 1e3;
        let max = histogram.max() as f64 / 1e3;
        (!histogram.is_empty()).then(|| Self { count: histogram.len(), p50: at(0.5), p90: at(0.9), p99: at(0.99), max })
    }
}
