//! The deadlines of a real-time tick, and time in which a process was suspended: pure, on stamps that others take.

/// Part of a real-time tick after which fusion goes on without the ranges that are missing.
const RANGE_DEADLINE: f64 = 0.5;

/// Part of a real-time tick after which a robot goes on without a fresh heading.
const HEADING_DEADLINE: f64 = 0.8;

/// Longest time between two looks of a process that runs: above the longest sleep.
const ROUND_MAX_NS: u64 = 250_000_000;

/// Tells how long this process was suspended: stopped, or on a machine that was. Such time is nobody's silence.
#[derive(Debug, Clone, Copy, Default)]
pub struct Suspension {
    looked_ns: Option<u64>,
}

impl Suspension {
    /// How long it was suspended since the last look, ns; to be called in each round of a node's loop with the monotonic time.
    pub fn look(&mut self, now_ns: u64) -> u64 {
        let looked_ns = self.looked_ns.replace(now_ns).unwrap_or(now_ns);
        now_ns.saturating_sub(looked_ns).saturating_sub(ROUND_MAX_NS)
    }
}

/// When fusion stops to wait for ranges of the real-time tick that began then.
#[must_use]
pub fn range_deadline_ns(tick_began_ns: u64, dt_s: f64) -> u64 {
    tick_began_ns.saturating_add((dt_s * 1e9 * RANGE_DEADLINE) as u64)
}

/// When a robot stops to wait for the heading of the real-time tick that began then.
#[must_use]
pub fn heading_deadline_ns(tick_began_ns: u64, dt_s: f64) -> u64 {
    tick_began_ns.saturating_add((dt_s * 1e9 * HEADING_DEADLINE) as u64)
}
