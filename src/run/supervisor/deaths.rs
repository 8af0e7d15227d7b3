//! The reaction to the end of a node's process, pure: it depends on how the process ended, and how long it had run.

use std::time::Duration;

use super::restart::Policy;

/// A node that fails by itself this often in a row has a cause that a restart does not remove.
const FAILURES_MAX: u32 = 5;

/// After this time, the cause of the last end is over.
const SETTLED: Duration = Duration::from_secs(1);

/// Wait before the second restart in a row of a node that has not settled. It doubles with each further failure. A kill
/// comes from outside and does not make it longer.
const BACK_OFF: Duration = Duration::from_millis(10);

const BACK_OFF_MAX: Duration = Duration::from_secs(1);

/// How a node's process ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum End {
    /// By itself, in order.
    InOrder,
    /// By itself, or by a fault of its own.
    Failed,
    /// By itself, for a reason that only the user can remove.
    Refused,
    /// It was killed.
    Killed,
}

/// How much a run needs a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Need {
    /// The run cannot go on without it.
    Cannot,
    /// The run goes on without it, but not if it fails again and again.
    Can,
    /// The run goes on without it, however it ended.
    Spare,
}

/// The next action.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Next {
    /// The node is started again after this time.
    StartAgain(Duration),
    /// The other nodes go on without it.
    GoOnWithout,
    /// The run ends.
    EndRun,
}

/// The deaths of one node since it last settled.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Deaths {
    all: u32,
    /// Those without kills: exits and crashes.
    failures: u32,
}

impl Deaths {
    /// Counts a death and returns what is done next. `is_taken` means that another process has its role by now; then
    /// that is why it failed.
    pub(crate) fn after(&mut self, end: End, lived: Duration, policy: Policy, is_taken: bool, need: Need) -> Next {
        if lived >= SETTLED {
            *self = Self::default();
        }
        self.all += 1;
        self.failures += u32::from(matches!(end, End::Failed | End::Refused));
        let is_own = end != End::Killed && !is_taken;
        let is_hopeless = is_own && (end == End::Refused || self.failures >= FAILURES_MAX);
        let is_replaced = match policy {
            Policy::Always => true,
            Policy::OnFailure => end != End::InOrder,
            Policy::Never => false,
        };
        match need {
            _ if is_replaced && !is_hopeless => Next::StartAgain(self.back_off()),
            Need::Spare => Next::GoOnWithout,
            Need::Can if !is_hopeless => Next::GoOnWithout,
            Need::Cannot | Need::Can => Next::EndRun,
        }
    }

    /// Counts a start that the system refused, and returns the wait before the next try. `None` after too many.
    pub(crate) fn after_failed_start(&mut self) -> Option<Duration> {
        (self.all, self.failures) = (self.all + 1, self.failures + 1);
        (self.failures < FAILURES_MAX).then(|| self.back_off())
    }

    /// No wait after one death; then longer and longer while the node fails before it has settled.
    fn back_off(&self) -> Duration {
        if self.all <= 1 {
            return Duration::ZERO;
        }
        BACK_OFF.saturating_mul(1 << self.failures.saturating_sub(1).min(16)).min(BACK_OFF_MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHORT: Duration = Duration::from_millis(20);

    fn again(ms: u64) -> Next {
        Next::StartAgain(Duration::from_millis(ms))
    }

    #[test]
    fn a_node_that_fails_again_and_again_waits_longer_and_ends_the_run_at_last() {
        let mut deaths = Deaths::default();
        let mut fail = |end| deaths.after(end, SHORT, Policy::Always, false, Need::Cannot);
        assert_eq!([(); 4].map(|()| fail(End::Failed)), [again(0), again(20), again(40), again(80)]);
        assert_eq!(fail(End::Failed), Next::EndRun);
    }

    #[test]
    fn kills_neither_end_a_run_nor_cause_long_waits_and_a_settled_node_starts_afresh() {
        let mut deaths = Deaths::default();
        for kill in 0..100 {
            let next = deaths.after(End::Killed, SHORT, Policy::Always, false, Need::Cannot);
            assert_eq!(next, again(if kill == 0 { 0 } else { 10 }));
        }
        assert_eq!(deaths.after(End::Failed, SETTLED, Policy::OnFailure, false, Need::Cannot), again(0));
    }

    #[test]
    fn a_refused_node_is_not_tried_again_unless_another_has_the_role() {
        let refused = |is_taken, need| Deaths::default().after(End::Refused, SHORT, Policy::Always, is_taken, need);
        assert_eq!(refused(false, Need::Cannot), Next::EndRun);
        assert_eq!(refused(false, Need::Can), Next::EndRun);
        assert_eq!(refused(false, Need::Spare), Next::GoOnWithout);
        assert_eq!(refused(true, Need::Cannot), again(0));
    }

    #[test]
    fn policies_decide_which_nodes_are_started_again() {
        let next = |end, policy, need| Deaths::default().after(end, SHORT, policy, false, need);
        assert_eq!(next(End::InOrder, Policy::OnFailure, Need::Can), Next::GoOnWithout);
        assert_eq!(next(End::Killed, Policy::OnFailure, Need::Can), again(0));
        assert_eq!(next(End::Killed, Policy::Never, Need::Can), Next::GoOnWithout);
        assert_eq!(next(End::Killed, Policy::Never, Need::Cannot), Next::EndRun);
    }

    #[test]
    fn a_start_that_is_refused_is_tried_a_few_times() {
        let mut deaths = Deaths::default();
        let waits: Vec<Option<u64>> =
            (0..5).map(|_| deaths.after_failed_start().map(|wait| wait.as_millis() as u64)).collect();
        assert_eq!(waits, [Some(0), Some(20), Some(40), Some(80), None]);
    }
}
