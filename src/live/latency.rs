//! Latency from range to heading, over all ticks that were read and over the last seconds.

use std::time::{Duration, Instant};

use serde::Serialize;

use crate::results::frame::Frame;
use crate::statistics::Samples;

/// Half of the time that "the last seconds" cover.
const HALF: Duration = Duration::from_secs(5);

#[derive(Debug)]
pub(super) struct Latencies {
    /// `None` if their memory could not be allocated.
    histograms: Option<Histograms>,
}

#[derive(Debug)]
struct Histograms {
    all: Samples,
    /// The previous half, which is complete, and the present half.
    before: Samples,
    now: Samples,
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
        let since = Instant::now();
        let histograms =
            Samples::new().map(|none| Histograms { all: none.clone(), before: none.clone(), now: none, since });
        Self { histograms: histograms.ok() }
    }
}

impl Latencies {
    pub(super) fn add(&mut self, frame: &Frame) {
        let Some(Histograms { all, before, now, since }) = &mut self.histograms else { return };
        if since.elapsed() >= HALF {
            std::mem::swap(before, now);
            now.clear();
            *since = Instant::now();
        }
        for latency_ns in frame.world.robots.iter().filter_map(|robot| robot.latency_ns()) {
            all.add(latency_ns);
            now.add(latency_ns);
        }
    }

    /// Adds a tick from before the page was started, which does not count as recent.
    pub(super) fn recall(&mut self, frame: &Frame) {
        let Some(Histograms { all, .. }) = &mut self.histograms else { return };
        for latency_ns in frame.world.robots.iter().filter_map(|robot| robot.latency_ns()) {
            all.add(latency_ns);
        }
    }

    pub(super) fn summary(&self) -> Latency {
        let Some(Histograms { all, before, now, .. }) = &self.histograms else { return Latency::default() };
        let mut recent = before.clone();
        recent.add_all(now);
        Latency { all: Percentiles::of(all), recent: Percentiles::of(&recent) }
    }
}

impl Percentiles {
    fn of(us: &Samples) -> Option<Self> {
        let count = us.count();
        (count > 0).then(|| Self { count, p50: us.at(0.5), p90: us.at(0.9), p99: us.at(0.99), max: us.max() })
    }
}
