//! Whose ranges are fused, pure: a robot whose ranges keep failing the gate is distrusted until it mends.

use rangehound_shared::robot_set::RobotSet;
use serde::{Deserialize, Serialize};

/// Verdicts of the gate that are remembered of each robot: bits of its record.
pub const RECENT: u32 = u8::BITS;

/// Failures among them from which on a robot is distrusted: a tick or two with outliers are forgiven. With a gate of
/// 4 sigma, of 200 runs each with 3, 4, 5 and 8 robots and one sensor that reads 10 or 30 sigma too much, all named
/// that one, 95 % of them within five ticks, and no other. Off by 6 sigma it hides behind the gate: of 3 robots the
/// estimate follows it before the gate tells, and in one run of five it is a sound one that is named.
pub const FAILURES_MAX: u32 = 5;

/// What the gate has said of each robot's ranges.
///
/// A robot is distrusted once [`FAILURES_MAX`] of its last [`RECENT`] ranges failed, and trusted again once all of
/// them passed. Failures count only while most of the team's newest ranges pass: where half of them or more fail, it
/// is the filter that is wrong, or nobody can tell.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Trust {
    /// Of each robot, newest lowest: 1 for a range that failed.
    records: Vec<u8>,
    distrusted: RobotSet,
    /// Which of the team's newest ranges failed, as many as it has robots; places are taken in turn.
    newest_failed: RobotSet,
    next_place: usize,
}

impl Trust {
    /// Trusts all of a team.
    #[must_use]
    pub fn new(robots: usize) -> Self {
        let (distrusted, newest_failed) = (RobotSet::default(), RobotSet::default());
        Self { records: vec![0; robots], distrusted, newest_failed, next_place: 0 }
    }

    /// Who is distrusted.
    #[must_use]
    pub fn distrusted(&self) -> RobotSet {
        self.distrusted
    }

    /// The size of the team.
    #[must_use]
    pub fn robots(&self) -> usize {
        self.records.len()
    }

    /// Becomes a copy of another of the same team, in the memory that is there.
    pub fn copy_from(&mut self, other: &Self) {
        self.records.clone_from(&other.records);
        (self.distrusted, self.newest_failed, self.next_place) =
            (other.distrusted, other.newest_failed, other.next_place);
    }

    /// Takes what the gate said of a tick's ranges: of whom they are, and whose failed.
    pub fn judge(&mut self, heard: impl Iterator<Item = usize> + Clone, failed: &RobotSet) {
        let robots = self.records.len();
        for id in heard.clone() {
            self.newest_failed.set(self.next_place, failed.contains(id));
            self.next_place = (self.next_place + 1) % robots;
        }
        let filter_is_wrong = 2 * self.newest_failed.len() >= robots;
        for id in heard {
            let has_failed = failed.contains(id);
            if has_failed && filter_is_wrong {
                continue;
            }
            let record = &mut self.records[id];
            *record = *record << 1 | u8::from(has_failed);
            if record.count_ones() >= FAILURES_MAX {
                self.distrusted.set(id, true);
            } else if *record == 0 {
                self.distrusted.set(id, false);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ticks of which each tells who fails, in a team of 4 that is all heard.
    fn after(trust: &mut Trust, ticks: usize, failing: &[usize]) -> Vec<usize> {
        let mut failed = RobotSet::default();
        failing.iter().for_each(|id| failed.set(*id, true));
        for _ in 0..ticks {
            trust.judge(0..4, &failed);
        }
        trust.distrusted().iter().collect()
    }

    #[test]
    fn a_robot_that_keeps_failing_is_distrusted_until_it_passes_eight_in_a_row() {
        let mut trust = Trust::new(4);
        assert_eq!(after(&mut trust, 4, &[2]), []);
        assert_eq!(after(&mut trust, 3, &[]), []);
        assert_eq!(after(&mut trust, 1, &[2]), [2], "five of the last eight");
        assert_eq!(after(&mut trust, 7, &[]), [2]);
        assert_eq!(after(&mut trust, 1, &[2]), [2]);
        assert_eq!(after(&mut trust, 7, &[]), [2], "the count starts anew");
        assert_eq!(after(&mut trust, 1, &[]), []);
    }

    #[test]
    fn an_outlier_now_and_then_is_forgiven() {
        let mut trust = Trust::new(4);
        for _ in 0..50 {
            after(&mut trust, 1, &[1]);
            assert_eq!(after(&mut trust, 1, &[]), []);
        }
    }

    #[test]
    fn where_half_the_team_fails_the_filter_is_wrong() {
        let mut trust = Trust::new(4);
        assert_eq!(after(&mut trust, 100, &[0, 3]), []);
        assert_eq!(after(&mut trust, 100, &[0, 1, 2, 3]), []);
        assert_eq!(after(&mut trust, 5, &[3]), [3]);
        // A second one beside it makes half of them.
        assert_eq!(after(&mut trust, 100, &[0, 3]), [3]);
    }

    #[test]
    fn alone_or_in_a_pair_nobody_can_tell_who_is_wrong() {
        for robots in [1, 2] {
            let mut trust = Trust::new(robots);
            let mut failed = RobotSet::default();
            failed.set(0, true);
            (0..100).for_each(|_| trust.judge(0..robots, &failed));
            assert!(trust.distrusted().is_empty(), "{robots}");
        }
    }

    /// As in recordings, where ranges come one by one.
    #[test]
    fn ranges_one_at_a_time_do_as_well() {
        let mut trust = Trust::new(4);
        let mut failed = RobotSet::default();
        failed.set(1, true);
        for tick in 0..4 * 5 {
            trust.judge(std::iter::once(tick % 4), &failed);
        }
        assert!(trust.distrusted().iter().eq([1]));
    }
}
