//! Hangs: processes that send no heartbeat while others do.

use std::time::Duration;

use rangehound_fusion::standby::step_max;
use rangehound_shared::scenario::{Scenario, Timeout};

/// Interval between two looks at the heartbeats. Silence is counted in looks, and only in those in which another
/// process has sent a heartbeat. So no process becomes silent because the supervisor or the whole run was stopped, the
/// machine was suspended, or a clock jumped.
pub(crate) const POLL_INTERVAL: Duration = Duration::from_millis(100);

/// Shortest silence that is a hang, however short the time-out: on a busy machine every process may have to wait.
const HANG_MIN: Duration = Duration::from_millis(500);

/// Time that each node of a run adds to the time in which a node must have started.
const START: Duration = Duration::from_millis(100);

/// Silence after which a deposed fusion is killed, even without a time-out.
const DEPOSED: Duration = Duration::from_secs(2);

/// How long a process has sent no heartbeat. `S` is a heartbeat, of which only changes matter.
#[derive(Debug)]
pub(crate) struct Silence<S> {
    last_heartbeat: Option<S>,
    looks: u32,
}

impl<S> Default for Silence<S> {
    fn default() -> Self {
        Self { last_heartbeat: None, looks: 0 }
    }
}

impl<S: PartialEq> Silence<S> {
    /// Takes the newest heartbeat; true if it has changed since the last look.
    pub(crate) fn hear(&mut self, heartbeat: Option<S>) -> bool {
        let is_new = heartbeat != self.last_heartbeat;
        self.last_heartbeat = heartbeat;
        if is_new {
            self.looks = 0;
        }
        is_new
    }

    /// Counts a look in which some process has sent a heartbeat.
    pub(crate) fn count(&mut self) {
        self.looks += 1;
    }

    /// False until the process has taken its role.
    pub(crate) fn has_started(&self) -> bool {
        self.last_heartbeat.is_some()
    }

    pub(crate) fn is_longer_than(&self, limit: Duration) -> bool {
        POLL_INTERVAL.saturating_mul(self.looks.saturating_sub(1)) > limit
    }
}

/// The silence after which a process counts as hung, in a run of this many nodes; `None` if never.
pub(crate) fn limit(scenario: &Scenario, nodes: usize, has_started: bool, is_deposed: bool) -> Option<Duration> {
    let Timeout::After(timeout) = scenario.timeout else { return is_deposed.then_some(DEPOSED) };
    let start = if has_started { Duration::ZERO } else { START.saturating_mul(nodes.try_into().unwrap_or(u32::MAX)) };
    Some(timeout.max(HANG_MIN).saturating_add(start).saturating_add(step_max(scenario)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn after_looks(heartbeats: impl Iterator<Item = Option<u64>>) -> Silence<u64> {
        let mut silence = Silence::default();
        for heartbeat in heartbeats {
            silence.hear(heartbeat);
            silence.count();
        }
        silence
    }

    #[test]
    fn only_a_heartbeat_that_stays_the_same_is_silence() {
        let second = Duration::from_secs(1);
        assert!(after_looks((0..12).map(|_| Some(7))).is_longer_than(second));
        assert!(!after_looks((0..11).map(|_| Some(7))).is_longer_than(second));
        assert!(!after_looks((0..99).map(|look| Some(look / 9))).is_longer_than(second));
    }

    #[test]
    fn a_wall_clock_that_jumps_back_makes_no_process_silent() {
        let silence = after_looks((0..60).map(|look| Some(if look < 30 { 1_000_000 + look } else { look })));
        assert!(!silence.is_longer_than(Duration::from_millis(500)));
    }

    #[test]
    fn a_process_without_its_role_is_silent_too() {
        let silence = after_looks((0..12).map(|_| None));
        assert!(!silence.has_started() && silence.is_longer_than(Duration::from_secs(1)));
    }
}
