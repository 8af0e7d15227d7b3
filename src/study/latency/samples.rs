//! From stamps to latencies, the same for the system and its references, without coordinated omission.

/// When a robot published its range of one tick, and when it received the tick's heading, monotonic ns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Exchange {
    pub(super) sent_ns: Option<u64>,
    pub(super) held_ns: Option<u64>,
}

/// One robot's ranges that wait for a heading.
///
/// Each range is a sample. It waits until its robot has a heading computed from it or from a later range. If ranges
/// are due at a steady rate, ranges that were delayed wait too, each from its due time:
/// a stall counts for every range that it delayed, not only for the first.
#[derive(Debug)]
pub(super) struct Waits {
    dt_ns: Option<u64>,
    last_sent_ns: Option<u64>,
    waiting_since_ns: Vec<u64>,
}

impl Waits {
    /// No range waits; `dt_ns` is the time between two ranges, `None` if each follows the heading before.
    pub(super) fn new(dt_ns: Option<u64>) -> Self {
        Self { dt_ns, last_sent_ns: None, waiting_since_ns: Vec::new() }
    }

    /// Adds the robot's next tick; calls `sample` with the latency, ns, of each wait that it ends.
    pub(super) fn add(&mut self, exchange: Exchange, mut sample: impl FnMut(u64)) {
        if let Some(sent_ns) = exchange.sent_ns {
            if let (Some(dt_ns), Some(last_ns)) = (self.dt_ns, self.last_sent_ns) {
                let gap_ns = sent_ns.saturating_sub(last_ns);
                // Rounded to the nearest, because stamps jitter.
                let ticks = (gap_ns + dt_ns / 2) / dt_ns.max(1);
                self.waiting_since_ns.extend((1..ticks).map(|tick| last_ns + tick * dt_ns));
            }
            self.waiting_since_ns.push(sent_ns);
            self.last_sent_ns = Some(sent_ns);
        }
        if let Some(held_ns) = exchange.held_ns {
            self.end(held_ns, &mut sample);
        }
    }

    /// Ends all waits at this time, as at the end of a run.
    pub(super) fn end(&mut self, at_ns: u64, mut sample: impl FnMut(u64)) {
        for since_ns in self.waiting_since_ns.drain(..) {
            sample(at_ns.saturating_sub(since_ns));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT_NS: u64 = 100;

    fn latencies(dt_ns: Option<u64>, stamps: &[(u64, u64)], end_ns: u64) -> Vec<u64> {
        let stamp = |ns: u64| (ns > 0).then_some(ns);
        let (mut waits, mut latencies) = (Waits::new(dt_ns), Vec::new());
        for &(sent_ns, held_ns) in stamps {
            let exchange = Exchange { sent_ns: stamp(sent_ns), held_ns: stamp(held_ns) };
            waits.add(exchange, |latency_ns| latencies.push(latency_ns));
        }
        waits.end(end_ns, |latency_ns| latencies.push(latency_ns));
        latencies
    }

    #[test]
    fn a_range_waits_for_its_heading() {
        assert_eq!(latencies(Some(DT_NS), &[(100, 107), (203, 209), (298, 301)], 400), [7, 6, 3]);
    }

    #[test]
    fn a_range_without_a_heading_waits_for_the_next() {
        assert_eq!(latencies(Some(DT_NS), &[(100, 0), (200, 0), (300, 310), (400, 0)], 500), [210, 110, 10, 100]);
    }

    #[test]
    fn ranges_that_could_not_go_out_wait_from_when_they_were_due() {
        // The robot was suspended from 100 to 430, and sent its next range at 430.
        assert_eq!(latencies(Some(DT_NS), &[(100, 105), (430, 436)], 500), [5, 236, 136, 6]);
        // Published in time but reported late: the simulator has no stamp of the range.
        assert_eq!(latencies(Some(DT_NS), &[(100, 105), (0, 0), (300, 304)], 500), [5, 104, 4]);
    }

    #[test]
    fn jitter_below_half_a_tick_omits_nothing() {
        assert_eq!(latencies(Some(DT_NS), &[(100, 105), (249, 255), (300, 305)], 500), [5, 6, 5]);
    }

    #[test]
    fn in_lock_step_nothing_is_due() {
        assert_eq!(latencies(None, &[(100, 105), (1_000, 1_005)], 2_000), [5, 5]);
    }
}
