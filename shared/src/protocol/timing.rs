//! The deadlines of a real-time tick, and detection of suspended processes: pure, on the caller's own clock.

/// Part of a real-time tick after which fusion goes on without the missing ranges.
const RANGE_DEADLINE: f64 = 0.5;

/// Part of a real-time tick after which a robot goes on without a fresh heading.
const HEADING_DEADLINE: f64 = 0.8;

/// Longest time between two checks of a running process: above the longest sleep.
pub const ROUND_MAX_NS: u64 = 250_000_000;

/// Measures how long this process was suspended: stopped, or on a suspended machine. Such time does not count as silence.
#[derive(Debug, Clone, Copy, Default)]
pub struct Suspension {
    looked_ns: Option<u64>,
}

impl Suspension {
    /// Suspended time since the last check, ns. Call it in each round of a node's loop with the monotonic time.
    pub fn look(&mut self, now_ns: u64) -> u64 {
        let looked_ns = self.looked_ns.replace(now_ns).unwrap_or(now_ns);
        now_ns.saturating_sub(looked_ns).saturating_sub(ROUND_MAX_NS)
    }
}

/// When fusion stops waiting for ranges of the real-time tick with this start on its clock.
#[must_use]
pub fn range_deadline_ns(tick_began_ns: u64, dt_s: f64) -> u64 {
    tick_began_ns.saturating_add((dt_s * 1e9 * RANGE_DEADLINE) as u64)
}

/// When a robot stops waiting for the heading of the real-time tick with this start on its clock.
#[must_use]
pub fn heading_deadline_ns(tick_began_ns: u64, dt_s: f64) -> u64 {
    tick_began_ns.saturating_add((dt_s * 1e9 * HEADING_DEADLINE) as u64)
}
