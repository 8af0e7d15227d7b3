"""The clock of a run's stamps. Unlike `time.monotonic` it goes on while the machine is suspended: what is old then must show it."""

import time


def now_ns() -> int:
    """The time of the clock, ns."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME)


def now_s() -> float:
    """The time of the clock, s."""
    return now_ns() * 1e-9
