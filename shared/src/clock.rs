//! Monotonic time, shared by all processes of a machine, and the deadlines of a real-time tick.

use std::time::Duration;

use rustix::time::{ClockId, clock_gettime};

/// Part of a real-time tick after which fusion goes on without the ranges that are missing.
const RANGE_DEADLINE: f64 = 0.5;

/// Part of a real-time tick after which a robot goes on without a fresh heading.
const HEADING_DEADLINE: f64 = 0.8;

/// Nanoseconds of `CLOCK_MONOTONIC`: one clock for all processes, unmoved by changes of the wall
/// clock, so stamps of different nodes can be subtracted.
#[must_use]
pub fn monotonic_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec.unsigned_abs() * 1_000_000_000 + now.tv_nsec.unsigned_abs()
}

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

/// Time left until a monotonic stamp, zero if it is past.
#[must_use]
pub fn until(stamp_ns: u64) -> Duration {
    Duration::from_nanos(stamp_ns.saturating_sub(monotonic_ns()))
}
