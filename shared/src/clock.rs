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
