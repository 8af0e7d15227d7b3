//! When a standby takes the lead or deposes a silent leader, pure. Silence is counted in looks.

use std::time::Duration;

use rangehound_shared::scenario::{PlannerSpec, Scenario};

/// Most standbys of a run.
pub const STANDBYS_MAX: usize = 8;

/// How often a standby checks the leader's heartbeat.
pub const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// Consecutive looks without a heartbeat after which the leader is deposed. Looks are counted so that neither a
/// suspension of the standby itself nor a clock jump deposes a leader.
const SILENT_LOOKS_MAX: u32 = 10;

/// Longest step of the grid planner without a heartbeat.
const GRID_STEP_MAX: Duration = Duration::from_secs(30);

/// Longest silence that is not a hang: one step of the scenario's planner may take this long.
#[must_use]
pub fn step_max(scenario: &Scenario) -> Duration {
    if matches!(scenario.planner, PlannerSpec::Grid { .. }) { GRID_STEP_MAX } else { Duration::ZERO }
}

/// One standby's view of the leader. `S` is a heartbeat, of which only changes matter. `L` names the leader's lock, if
/// there is one; after a leader was deposed there is a new lock.
#[derive(Debug, Clone, Copy)]
pub struct Standby<S, L> {
    last_heartbeat: Option<S>,
    /// The lock that it waits for.
    awaited: Option<L>,
    silent_looks: u32,
    silent_looks_max: u32,
}

impl<S: Copy + PartialEq, L: Copy + PartialEq> Standby<S, L> {
    /// A standby that sees this heartbeat first, and waits for this lock.
    #[must_use]
    pub fn new(scenario: &Scenario, last_heartbeat: Option<S>, awaited: Option<L>) -> Self {
        let silent_looks_max = SILENT_LOOKS_MAX + step_max(scenario).div_duration_f64(POLL_INTERVAL) as u32;
        Self { last_heartbeat, awaited, silent_looks: 0, silent_looks_max }
    }

    /// Takes the newest heartbeat; called once every [`POLL_INTERVAL`]. Returns the heartbeat if the leader is to be deposed.
    /// The caller deposes it only if it has sent no newer one meanwhile.
    pub fn look(&mut self, heartbeat: Option<S>) -> Option<S> {
        self.silent_looks = if heartbeat == self.last_heartbeat { self.silent_looks + 1 } else { 0 };
        self.last_heartbeat = heartbeat;
        heartbeat.filter(|_| self.silent_looks >= self.silent_looks_max)
    }

    /// True if the standby must wait for this lock from now on, because the lock that it waits for belongs to a deposed
    /// leader. `None` means that the run is being removed: then no standby takes the lead.
    pub fn restart_wait(&mut self, lock: Option<L>) -> bool {
        let is_other = lock.is_some() && lock != self.awaited;
        if is_other {
            self.awaited = lock;
        }
        is_other
    }

    /// The silence after which the leader is deposed.
    #[must_use]
    pub fn silence_max(&self) -> Duration {
        POLL_INTERVAL * self.silent_looks_max
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn standby(planner: &str) -> Standby<u64, u64> {
        let text = format!("[planner]\nname = \"{planner}\"\n");
        let file = rangehound_shared::scenario::ScenarioFile::parse(&text, "test").unwrap();
        Standby::new(&Scenario::from_file(&file, "test").unwrap(), Some(7), Some(1))
    }

    #[test]
    fn only_consecutive_silent_looks_depose() {
        let mut standby = standby("greedy");
        assert!((1..SILENT_LOOKS_MAX).all(|_| standby.look(Some(7)).is_none()));
        assert_eq!(standby.look(Some(8)), None, "a heartbeat, just in time");
        assert!((1..SILENT_LOOKS_MAX).all(|_| standby.look(Some(8)).is_none()));
        assert_eq!(standby.look(Some(8)), Some(8));
    }

    #[test]
    fn a_standby_waits_for_the_leaders_lock() {
        let mut standby = standby("greedy");
        assert!(!standby.restart_wait(Some(1)) && !standby.restart_wait(None));
        assert!(standby.restart_wait(Some(2)) && !standby.restart_wait(Some(2)));
    }

    #[test]
    fn a_process_that_never_led_is_not_deposed() {
        let mut standby = standby("greedy");
        assert!((0..99).all(|_| standby.look(None).is_none()));
    }
}
