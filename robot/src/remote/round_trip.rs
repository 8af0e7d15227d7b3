//! The round trip of a link, and the interval after which an unanswered frame is sent again.

/// The interval before the first measurement, ns.
const FIRST_NS: u64 = 20_000_000;

/// Deviations above the mean after which an answer is taken for lost. TCP waits for four; here a repeat that was not needed costs
/// one frame, and a wait that was not needed costs the whole team its time.
const DEVIATIONS: f64 = 2.0;

/// Repeats that follow the first one sooner: what was lost once is often lost in a burst, and a round trip has passed already.
const PROBES: u32 = 3;

/// Part of the interval between them.
const PROBE: f64 = 0.25;

/// Bounds of the interval, ns: below, most repeats would cross their answers; above, a tick would wait too long.
pub(super) const INTERVAL_NS: std::ops::RangeInclusive<u64> = 2_000_000..=200_000_000;

/// Mean and deviation of the round trips of a link, smoothed as RFC 6298 does for TCP.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RoundTrip {
    smoothed: Option<Smoothed>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Smoothed {
    mean_ns: f64,
    deviation_ns: f64,
}

impl RoundTrip {
    /// Takes a measured round trip, ns.
    pub fn add(&mut self, measured_ns: u64) {
        let measured_ns = measured_ns as f64;
        let smoothed = match self.smoothed {
            None => Smoothed { mean_ns: measured_ns, deviation_ns: measured_ns / 2.0 },
            Some(Smoothed { mean_ns, deviation_ns }) => Smoothed {
                mean_ns: mean_ns + (measured_ns - mean_ns) / 8.0,
                deviation_ns: deviation_ns + ((measured_ns - mean_ns).abs() - deviation_ns) / 4.0,
            },
        };
        self.smoothed = Some(smoothed);
    }

    /// The smoothed round trip, ns, if there is a measurement.
    #[must_use]
    pub fn mean_ns(&self) -> Option<u64> {
        self.smoothed.map(|smoothed| smoothed.mean_ns as u64)
    }

    /// How long to wait for an answer after this many repeats before a frame is sent again, ns: a round trip with some
    /// deviations, then three times a part of that, and then twice as long each time, because the link may be cut.
    #[must_use]
    pub fn interval_ns(&self, repeats: u32) -> u64 {
        let once_ns =
            self.smoothed.map_or(FIRST_NS as f64, |smoothed| smoothed.mean_ns + DEVIATIONS * smoothed.deviation_ns);
        let times = match repeats {
            0 => 1.0,
            1..=PROBES => PROBE,
            more => f64::from(1 << (more - PROBES - 1).min(8)),
        };
        ((once_ns * times) as u64).clamp(*INTERVAL_NS.start(), *INTERVAL_NS.end())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_interval_follows_the_round_trip_and_its_jitter() {
        let mut steady = RoundTrip::default();
        assert_eq!((steady.mean_ns(), steady.interval_ns(0)), (None, FIRST_NS));
        (0..100).for_each(|_| steady.add(5_000_000));
        assert_eq!((steady.mean_ns(), steady.interval_ns(0)), (Some(5_000_000), 5_000_000));
        let mut jittery = RoundTrip::default();
        (0..100).for_each(|i| jittery.add(if i % 2 == 0 { 1_000_000 } else { 9_000_000 }));
        assert!((10_000_000..20_000_000).contains(&jittery.interval_ns(0)), "{jittery:?}");
    }

    #[test]
    fn repeats_come_soon_then_become_rarer_and_never_stop() {
        let mut link = RoundTrip::default();
        (0..100).for_each(|_| link.add(12_000_000));
        let intervals_ms = |link: &RoundTrip| (0..40).map(|repeats| link.interval_ns(repeats) / 1_000_000).collect();
        let intervals: Vec<u64> = intervals_ms(&link);
        assert_eq!(intervals[..8], [12, 3, 3, 3, 12, 24, 48, 96]);
        assert!(intervals[1..].is_sorted() && intervals[39] == *INTERVAL_NS.end() / 1_000_000);
        let mut near = RoundTrip::default();
        near.add(100_000);
        assert_eq!(intervals_ms(&near)[..5], [*INTERVAL_NS.start() / 1_000_000; 5], "a busy process is not a loss");
        link.add(u64::MAX);
        assert_eq!(link.interval_ns(u32::MAX), *INTERVAL_NS.end());
    }
}
