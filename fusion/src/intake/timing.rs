//! Starts and deadlines of ticks, pure: from the senders' and the caller's time stamps.

use rangehound_shared::message::{Header, Range};
use rangehound_shared::protocol::timing::range_deadline_ns;
use rangehound_shared::scenario::{Clock, Scenario, Timeout};

/// Ticks by which a robot may be ahead of the tick that the time since the last start allows: one for a tick that the
/// simulator catches up on after a suspension, one for a tick whose start was stamped at its repeat.
pub(super) const AHEAD_TICKS_MAX: u64 = 2;

/// The times of the tick that is being gathered, monotonic ns.
#[derive(Debug)]
pub(super) struct Timing {
    clock: Clock,
    timeout: Timeout,
    dt_s: f64,
    last_tick: u64,
    robots: usize,
    /// The tick's start according to each report.
    began_ns: Vec<u64>,
    first_ns: Option<u64>,
    last_range_ns: u64,
}

impl Timing {
    pub(super) fn new(scenario: &Scenario) -> Self {
        let robots = scenario.robots.len();
        Self {
            clock: scenario.clock,
            timeout: scenario.timeout,
            dt_s: scenario.dt_s,
            last_tick: scenario.ticks,
            robots,
            began_ns: Vec::with_capacity(robots),
            first_ns: None,
            last_range_ns: 0,
        }
    }

    /// Records the arrival of a message of the present tick.
    pub(super) fn add_message(&mut self, now_ns: u64) {
        self.first_ns.get_or_insert(now_ns);
    }

    /// Records the time stamps of a report of the present tick.
    pub(super) fn add_report(&mut self, header: &Header, range: &Range, now_ns: u64) {
        self.began_ns.push(range.tick_began_ns.min(now_ns));
        self.last_range_ns = self.last_range_ns.max(header.sent_ns.min(now_ns));
    }

    /// True if no message of the present tick has arrived.
    pub(super) fn is_silent(&self) -> bool {
        self.first_ns.is_none()
    }

    /// When the last report of the present tick was sent, by its robot's stamp; 0 without any.
    pub(super) fn last_range_ns(&self) -> u64 {
        self.last_range_ns
    }

    /// Extends the deadline by the time for which this process was suspended: it is not the robots' silence.
    pub(super) fn extend(&mut self, suspended_ns: u64) {
        self.first_ns = self.first_ns.map(|first_ns| first_ns.saturating_add(suspended_ns));
    }

    /// The newest tick that can have begun. In lock step a tick begins after fusion has answered the one before. In
    /// real time ticks begin at fixed intervals, and fusion may be behind because it was suspended or started late.
    pub(super) fn newest_tick(&self, next: u64, last_began_ns: u64, now_ns: u64) -> u64 {
        let newest = match (self.clock, next.checked_sub(1)) {
            (Clock::Realtime, Some(last)) => {
                let elapsed = now_ns.saturating_sub(last_began_ns) / self.dt_ns();
                last.saturating_add(elapsed + AHEAD_TICKS_MAX)
            }
            _ => next,
        };
        newest.min(self.last_tick)
    }

    /// The present tick's deadline, if it has one: tick 0 waits for the complete team.
    pub(super) fn deadline_ns(&self, next: u64, last_began_ns: u64) -> Option<u64> {
        let first_ns = self.first_ns?;
        if next == 0 {
            return None;
        }
        match (self.clock, self.timeout) {
            // A robot that sends too early, or reports too early a start, must not shorten the tick.
            (Clock::Realtime, _) => {
                let reported_ns = self.began_ns.iter().copied().max().unwrap_or(first_ns);
                // The earliest start is a step after the last tick's, but not later than a step after the first
                // message: the ticks that the simulator catches up on begin in quick succession.
                let earliest_ns = self.after(last_began_ns).min(first_ns.saturating_add(self.dt_ns()));
                Some(range_deadline_ns(reported_ns.max(earliest_ns), self.dt_s))
            }
            (Clock::Lockstep, Timeout::Forever) => None,
            (Clock::Lockstep, Timeout::After(limit)) => Some(first_ns.saturating_add(limit.as_nanos() as u64)),
        }
    }

    /// Ends the present tick, processed at `now_ns`; returns its start: the lower median of the reports if most robots
    /// have reported, else a step after the previous start.
    pub(super) fn close(&mut self, next: u64, last_began_ns: u64, now_ns: u64) -> u64 {
        let is_majority = 2 * self.began_ns.len() > self.robots;
        let reported_ns = lower_median(&mut self.began_ns, u64::cmp).filter(|_| is_majority);
        (self.first_ns, self.last_range_ns) = (None, 0);
        self.began_ns.clear();
        // The end of tick 0 counts as its start, because tick 1 waits for the answer to tick 0.
        if next == 0 { now_ns } else { reported_ns.unwrap_or_else(|| self.after(last_began_ns)) }
    }

    /// The start of a real-time tick, one step after that of the tick before.
    fn after(&self, last_began_ns: u64) -> u64 {
        last_began_ns.saturating_add(self.dt_ns())
    }

    fn dt_ns(&self) -> u64 {
        ((self.dt_s * 1e9) as u64).max(1)
    }
}

/// The lower median: the value of the majority if more than half agree, whatever the others are.
pub(super) fn lower_median<T: Copy>(values: &mut [T], order: impl Fn(&T, &T) -> std::cmp::Ordering) -> Option<T> {
    let middle = values.len().checked_sub(1)? / 2;
    Some(*values.select_nth_unstable_by(middle, order).1)
}
