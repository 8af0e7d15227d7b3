//! The clock of all processes of a machine.

use std::io;
use std::time::Duration;

use rustix::io::Errno;
use rustix::thread::clock_nanosleep_absolute;
use rustix::time::{ClockId, Timespec, clock_gettime};

/// Nanoseconds of `CLOCK_BOOTTIME`: one clock for all processes, not affected by changes of the wall clock, so stamps of
/// different nodes can be subtracted. Unlike `CLOCK_MONOTONIC` it goes on while the machine is suspended: a robot that wakes up
/// must see that its heading is old. All stamps and deadlines of this project are of this clock.
#[must_use]
pub fn monotonic_ns() -> u64 {
    let now = clock_gettime(ClockId::Boottime);
    now.tv_sec.unsigned_abs() * 1_000_000_000 + now.tv_nsec.unsigned_abs()
}

/// Time left until a monotonic stamp, zero if the stamp is past.
#[must_use]
pub fn until(stamp_ns: u64) -> Duration {
    Duration::from_nanos(stamp_ns.saturating_sub(monotonic_ns()))
}

/// Sleeps until a monotonic stamp. A signal ends it early.
///
/// # Errors
/// The system's.
pub fn sleep_until(stamp_ns: u64) -> io::Result<()> {
    let seconds = (stamp_ns / 1_000_000_000).cast_signed();
    let stamp = Timespec { tv_sec: seconds, tv_nsec: (stamp_ns % 1_000_000_000).cast_signed() };
    match clock_nanosleep_absolute(ClockId::Boottime, &stamp) {
        Ok(()) | Err(Errno::INTR) => Ok(()),
        Err(error) => Err(error.into()),
    }
}
