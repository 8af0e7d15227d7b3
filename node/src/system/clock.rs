//! Monotonic time, shared by all processes of a machine.

use std::time::Duration;

use rustix::time::{ClockId, clock_gettime};

/// Nanoseconds of `CLOCK_MONOTONIC`: one clock for all processes, not affected by changes of the wall
/// clock, so stamps of different nodes can be subtracted.
#[must_use]
pub fn monotonic_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec.unsigned_abs() * 1_000_000_000 + now.tv_nsec.unsigned_abs()
}

/// Time left until a monotonic stamp, zero if the stamp is past.
#[must_use]
pub fn until(stamp_ns: u64) -> Duration {
    Duration::from_nanos(stamp_ns.saturating_sub(monotonic_ns()))
}
