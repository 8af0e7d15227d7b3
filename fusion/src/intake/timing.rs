//! Starts and deadlines of ticks, pure: from the times at which fusion received messages, on its own clock.

use rangehound_shared::message::Header;
use rangehound_shared::protocol::timing::range_deadline_ns;
use rangehound_shared::scenario::{Clock, Scenario, Timeout};

/// Ticks by which a robot may be ahead of the tick that the time since the last start allows: one for a tick that the
/// simulator catches up on after a suspension, one for a tick whose messages were received late.
pub(super) const AHEAD_TICKS_MAX: u64 = 2;

/// If a tick's messages arrive later than expected, one part in this many of the delay is taken for a later start: it
/// follows a slower clock and a pause of the simulator, and one slow tick changes little. A start that is taken too early
/// is harmless; one that is taken too late makes valid messages seem to come from the future.
const FOLLOWED_PARTS: u64 = 16;

/// The times of the tick that is being gathered, monotonic ns.
#[derive(Debug)]
pub(super) struct Timing {
    clock: Clock,
    timeout: Timeout,
    dt_s: f64,
    last_tick: u64,
    robots: usize,
    /// When each report was received.
    received_ns: Vec<u64>,
    first_ns: Option<u64>,
    last_range_ns: u64,
    /// Messages received before this may have waited while this process was suspended or not in the lead.
    prompt_from_ns: u64,
    /// The newest tick of each robot's messages, whether or not it can have begun.
    claimed: Vec<u64>,
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
            received_ns: Vec::with_capacity(robots),
            first_ns: None,
            last_range_ns: 0,
            prompt_from_ns: 0,
            claimed: vec![0; robots],
        }
    }

    /// Records the arrival of a message of the present tick.
    pub(super) fn add_message(&mut self, now_ns: u64) {
        self.first_ns.get_or_insert(now_ns);
    }

    /// Records the arrival of a valid report of the present tick.
    pub(super) fn add_report(&mut self, header: &Header, now_ns: u64) {
        self.received_ns.push(now_ns);
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
    pub(super) fn extend(&mut self, suspended_ns: u64, now_ns: u64) {
        self.first_ns = self.first_ns.map(|first_ns| first_ns.saturating_add(suspended_ns));
        if suspended_ns > 0 {
            self.resume(now_ns);
        }
    }

    /// This process has begun to read messages that may have waited.
    pub(super) fn resume(&mut self, now_ns: u64) {
        self.prompt_from_ns = now_ns.saturating_add(self.dt_ns());
    }

    /// True if a tick of which a robot has sent a message can have begun. In lock step a tick begins after fusion has
    /// answered the one before. In real time ticks begin at fixed intervals, and fusion may be behind because it was
    /// suspended or started late. Most robots are believed whatever the time: then no wrong time can last.
    pub(super) fn can_have_begun(
        &mut self,
        (robot, tick): (usize, u64),
        next: u64,
        last_began_ns: u64,
        now_ns: u64,
    ) -> bool {
        let newest = match (self.clock, next.checked_sub(1)) {
            (Clock::Realtime, Some(last)) => {
                let elapsed = now_ns.saturating_sub(last_began_ns) / self.dt_ns();
                last.saturating_add(elapsed + AHEAD_TICKS_MAX)
            }
            _ => next,
        };
        if tick > self.last_tick {
            return false;
        }
        self.claimed[robot] = tick;
        let claims = || self.claimed.iter().filter(|claimed| **claimed >= tick).count();
        tick <= newest || self.clock == Clock::Realtime && 2 * claims() > self.robots
    }

    /// The present tick's deadline, if it has one: tick 0 waits for the complete team.
    pub(super) fn deadline_ns(&self, next: u64, last_began_ns: u64) -> Option<u64> {
        let first_ns = self.first_ns?;
        if next == 0 {
            return None;
        }
        match (self.clock, self.timeout) {
            (Clock::Realtime, _) => {
                // A robot that sends too early must not shorten the tick: the earliest start is a step after the last
                // tick's. But it is not later than a step after the first message: the ticks that the simulator catches
                // up on begin in quick succession.
                let earliest_ns = self.after(last_began_ns).min(first_ns.saturating_add(self.dt_ns()));
                Some(range_deadline_ns(first_ns.max(earliest_ns), self.dt_s))
            }
            (Clock::Lockstep, Timeout::Forever) => None,
            (Clock::Lockstep, Timeout::After(limit)) => Some(first_ns.saturating_add(limit.as_nanos() as u64)),
        }
    }

    /// Ends the present tick, processed at `now_ns`; returns its start: a step after the previous start, corrected by the
    /// lower median of the reports' arrivals if most robots have reported.
    pub(super) fn close(&mut self, next: u64, last_began_ns: u64, now_ns: u64) -> u64 {
        let is_majority = 2 * self.received_ns.len() > self.robots;
        let received_ns = lower_median(&mut self.received_ns, u64::cmp).filter(|_| is_majority);
        let expected_ns = self.after(last_began_ns);
        let began_ns = received_ns.map_or(expected_ns, |received_ns| match received_ns.checked_sub(expected_ns) {
            Some(_) if received_ns < self.prompt_from_ns => expected_ns,
            Some(later_ns) => expected_ns + later_ns / FOLLOWED_PARTS,
            None => received_ns,
        });
        (self.first_ns, self.last_range_ns) = (None, 0);
        self.received_ns.clear();
        // The end of tick 0 counts as its start, because tick 1 waits for the answer to tick 0.
        if next == 0 { now_ns } else { began_ns }
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
