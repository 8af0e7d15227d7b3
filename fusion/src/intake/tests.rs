use rangehound_shared::measurement::{Kind, Pose};

use super::timing::AHEAD_TICKS_MAX;
use super::*;
use crate::leader::Leader;
use rangehound_shared::scenario::ScenarioFile;

const DT_NS: u64 = 100_000_000;

/// A team of three at (15, 0) and its fusion centre; the test sets the clock.
struct Team {
    leader: Leader,
    now_ns: u64,
}

impl Team {
    fn new(clock: &str) -> Self {
        let text = format!("clock = \"{clock}\"\nticks = 100\n");
        let file = ScenarioFile::parse(&text, "test").unwrap();
        let scenario = Scenario::from_file(&file, "test").unwrap();
        let mut team = Self { leader: Leader::new(&scenario).unwrap(), now_ns: 1_000 * DT_NS };
        team.tick(&[0, 1, 2]);
        team
    }

    fn next(&self) -> u64 {
        self.leader.centre.next_tick()
    }

    fn send(&mut self, tick: u64, range: Range) {
        let header = Header { tick, valid_at_s: tick as f64 * 0.1, ..Header::default() };
        self.leader.on_range(&header, &[range], self.now_ns);
    }

    /// Ends the tick that is being gathered, with the reports that have arrived.
    fn process(&mut self) -> IntakeCounts {
        self.leader.end_tick();
        while self.leader.next_action(self.now_ns).unwrap().is_some() {}
        self.leader.counts
    }

    fn asks_repeat(&mut self) -> bool {
        std::mem::take(&mut self.leader.repeat_asked)
    }

    /// The tick that other nodes have reached, if they are ahead.
    fn ahead(&self) -> Option<u64> {
        Some(self.leader.over_before).filter(|tick| *tick > self.next())
    }

    /// A tick at which these robots send valid reports.
    fn tick(&mut self, senders: &[u64]) -> IntakeCounts {
        let tick = self.next();
        senders.iter().for_each(|robot| self.send(tick, valid(tick, *robot)));
        let counts = self.process();
        self.now_ns += DT_NS;
        counts
    }
}

fn valid(tick: u64, robot: u64) -> Range {
    let measurement = Measurement::new(Pose::at([15.0, 0.0]), (tick > 0).then_some((15.0, 1.0)));
    Range { robot, measurement }
}

/// The same message with a changed measurement.
fn with(mut range: Range, change: impl FnOnce(&mut Measurement)) -> Range {
    change(&mut range.measurement);
    range
}

fn refused(counts: &IntakeCounts) -> Vec<(Refusal, u64)> {
    Refusal::ALL.into_iter().zip(counts.refused).filter(|(_, count)| *count > 0).collect()
}

#[test]
fn invalid_messages_are_refused_and_counted_by_cause() {
    for clock in ["lockstep", "realtime"] {
        let mut team = Team::new(clock);
        let ok = valid(1, 1);
        team.send(1, Range { robot: 3, ..ok });
        team.send(1, Range { robot: u64::MAX, ..ok });
        for invalid in [
            with(ok, |it| it.kinds = 1 << Kind::COUNT),
            with(ok, |it| it.pose.covariance_m2 = [1.0, 2.0, 1.0]),
            with(ok, |it| it.pose.covariance_m2 = [-1.0, 0.0, 1.0]),
            with(ok, |it| it.pose.heading_std_rad = -0.1),
            with(ok, |it| *it = it.with_bearing(Some((1e3, 0.1)))),
            with(ok, |it| *it = it.with_bearing(Some((1.0, 0.0)))),
            with(ok, |it| it.pose.x_m = f64::NAN),
            with(ok, |it| it.pose.y_m = f64::INFINITY),
            with(ok, |it| it.pose.height_m = f64::NAN),
            with(ok, |it| it.range_m = f64::NAN),
            with(ok, |it| it.range_m = -11.0),
            with(ok, |it| it.range_m = 1e300),
            with(ok, |it| it.range_std_m = 0.0),
            with(ok, |it| it.range_std_m = -1.0),
            with(ok, |it| it.range_std_m = 1e-300),
        ] {
            team.send(1, invalid);
        }
        let header = Header { tick: 1, valid_at_s: 0.1, ..Header::default() };
        let Team { leader, now_ns } = &mut team;
        leader.on_range(&header, &[], *now_ns);
        leader.on_range(&header, &[ok, ok], *now_ns);
        leader.on_range(&Header { valid_at_s: f64::NAN, ..header }, &[ok], *now_ns);
        leader.on_range(&Header { valid_at_s: 0.2, ..header }, &[ok], *now_ns);
        leader.refuse_impostors(1);
        let counts = team.tick(&[0, 2]);
        let expected = [(Refusal::Impostor, 1), (Refusal::OutOfRange, 2), (Refusal::Malformed, 19)];
        assert_eq!(refused(&counts), expected, "{clock}");
        let estimate = team.leader.centre.estimate();
        assert_eq!((estimate.fused, estimate.missing), (2, 1), "{clock}");
    }
}

/// A close target and noise: the paper's own robots sometimes measure a negative range.
#[test]
fn a_range_a_little_below_zero_is_noise() {
    let mut team = Team::new("lockstep");
    team.send(1, with(valid(1, 1), |it| it.range_m = -2.5));
    assert_eq!(team.tick(&[0, 2]), IntakeCounts::default());
    assert_eq!(team.leader.centre.estimate().fused, 3);
}

#[test]
fn the_first_report_counts_and_a_contradiction_is_refused() {
    let mut team = Team::new("lockstep");
    let first = valid(1, 1);
    team.send(1, first);
    team.send(1, first);
    team.send(1, with(first, |it| it.range_m = 99.0));
    assert_eq!(team.leader.intake.reports()[1].unwrap().range(), Some((15.0, 1.0)));
    assert_eq!(refused(&team.tick(&[0, 2])), [(Refusal::Contradiction, 1)]);
    assert!(!team.asks_repeat());
    // The same for a tick that is over: a repeat asks for the heading, a contradiction is refused.
    team.send(1, first);
    assert!(team.asks_repeat());
    team.send(1, with(first, |it| it.pose.x_m = 15.5));
    assert!(!team.asks_repeat());
    let counts = team.tick(&[0, 1, 2]);
    assert_eq!((refused(&counts), counts.late), (vec![(Refusal::Contradiction, 1)], 0));
}

/// Its sensor has new noise at each measurement, unlike a simulated one.
#[test]
fn a_robot_started_again_that_measures_anew_gets_its_heading() {
    let mut team = Team::new("lockstep");
    let first = valid(1, 1);
    team.send(1, first);
    let anew = with(first, |it| it.range_m = 15.5);
    let header = Header { tick: 1, valid_at_s: 0.1, incarnation: 1, ..Header::default() };
    let Team { leader, now_ns } = &mut team;
    leader.on_range(&header, &[anew], *now_ns);
    assert_eq!(leader.intake.reports()[1].unwrap().range(), Some((15.0, 1.0)));
    assert_eq!(refused(&team.tick(&[0, 2])), []);
    assert!(!team.asks_repeat());
    team.leader.on_range(&header, &[anew], team.now_ns);
    assert!(team.asks_repeat());
    assert_eq!(refused(&team.tick(&[0, 1, 2])), []);
}

#[test]
fn a_jump_is_refused_until_the_robot_can_have_moved_that_far() {
    let mut team = Team::new("lockstep");
    // 10 m/s and 0.1 s: a metre each tick.
    let away = |tick| with(valid(tick, 1), |it| it.pose.x_m = 19.5);
    for tick in 1..5 {
        team.send(tick, away(tick));
        assert_eq!(refused(&team.tick(&[0, 2])), [(Refusal::Jump, 1)], "tick {tick}");
        assert_eq!(team.leader.centre.estimate().missing, 1);
    }
    team.send(5, away(5));
    assert_eq!(team.tick(&[0, 2]), IntakeCounts::default());
    assert_eq!(team.leader.centre.estimate().fused, 3);
}

#[test]
fn in_lock_step_no_robot_is_ahead() {
    let mut team = Team::new("lockstep");
    team.now_ns += 1_000 * DT_NS;
    for tick in [2, 3, 50, 101, u64::MAX] {
        team.send(tick, valid(1, 1));
    }
    assert_eq!(team.ahead(), None);
    let counts = team.tick(&[0, 1, 2]);
    assert_eq!(counts.refused[Refusal::Future as usize] + counts.refused[Refusal::Malformed as usize], 5);
    assert!(counts.refused[Refusal::Future as usize] >= 4, "{counts:?}");
    assert_eq!(team.next(), 2);
}

#[test]
fn in_real_time_no_robot_is_further_ahead_than_the_elapsed_time() {
    let mut team = Team::new("realtime");
    (1..5).for_each(|_| _ = team.tick(&[0, 1, 2]));
    assert_eq!(team.next(), 5);
    let newest = |team: &Team| 5 + AHEAD_TICKS_MAX + (team.now_ns - 1_005 * DT_NS) / DT_NS;
    for elapsed in [0, 7] {
        team.now_ns += elapsed * DT_NS;
        let newest = newest(&team);
        let before = team.ahead();
        team.send(newest + 1, valid(newest + 1, 1));
        assert_eq!(team.ahead(), before);
        team.send(newest, valid(newest, 1));
        assert_eq!(team.ahead(), Some(newest));
    }
    // The run has no tick after its last, however long it takes.
    team.now_ns += 1_000 * DT_NS;
    team.send(101, valid(101, 1));
    assert_eq!(team.ahead(), Some(14));
}

/// One robot is always as far ahead as is accepted: fusion stays close to the others.
#[test]
fn a_robot_that_is_always_ahead_does_not_drive_fusion_away_from_the_others() {
    let mut team = Team::new("realtime");
    for tick in 1..50 {
        for ahead in (tick..tick + 10).rev() {
            team.send(ahead, valid(ahead, 2));
        }
        while team.leader.next_action(team.now_ns).unwrap().is_some() {}
        for robot in [0, 1] {
            team.send(tick, valid(tick, robot));
        }
        while team.leader.next_action(team.now_ns + DT_NS * 6 / 10).unwrap().is_some() {}
        assert!(team.next() <= tick + 1 + AHEAD_TICKS_MAX, "tick {tick}: at {}", team.next());
        team.now_ns += DT_NS;
    }
}

#[test]
fn a_tick_does_not_wait_for_a_robot_that_sends_only_nonsense() {
    for clock in ["lockstep", "realtime"] {
        let mut team = Team::new(clock);
        for tick in 1..4 {
            team.send(tick, valid(tick, 0));
            team.send(tick, valid(tick, 2));
            assert!(!team.leader.intake.is_ready(tick, team.now_ns), "{clock}: robot 1 is waited for");
            team.send(tick, with(valid(tick, 1), |it| it.range_std_m = f64::NAN));
            assert!(team.leader.intake.is_ready(tick, team.now_ns), "{clock}");
            // A valid report after it still counts.
            team.send(tick, valid(tick, 1));
            team.tick(&[]);
            assert_eq!(team.leader.centre.estimate().fused, 3);
        }
    }
}

/// Deadlines count from the arrival of messages. Whatever a sender's clock shows, no tick ends early or waits for ever.
#[test]
fn no_time_stamp_of_another_clock_moves_a_deadline() {
    for sent_ns in [0, u64::MAX] {
        let mut team = Team::new("realtime");
        team.tick(&[0, 1, 2]);
        let header = Header { tick: 2, valid_at_s: 0.2, sent_ns, ..Header::default() };
        team.leader.on_range(&header, &[valid(2, 1)], team.now_ns);
        let deadline_ns = team.leader.intake.deadline_ns(2).unwrap();
        assert_eq!(deadline_ns, team.now_ns + DT_NS / 2);
    }
}

/// A robot that sends a tick's message before the tick does not shorten it for the others.
#[test]
fn an_early_message_does_not_end_a_tick_early() {
    let mut team = Team::new("realtime");
    team.tick(&[0, 1, 2]);
    team.tick(&[0, 1, 2]);
    let starts_ns = team.now_ns;
    team.now_ns -= DT_NS / 2;
    team.send(3, valid(3, 1));
    assert_eq!(team.leader.intake.deadline_ns(3), Some(starts_ns + DT_NS / 2));
}

#[test]
fn a_late_range_is_counted_once_and_fused_if_its_tick_is_kept() {
    let mut team = Team::new("realtime");
    team.tick(&[0, 2]);
    (2..9).for_each(|_| _ = team.tick(&[0, 1, 2]));
    team.tick(&[0, 2]);
    team.tick(&[0, 1, 2]);
    for _ in 0..3 {
        team.send(9, valid(9, 1));
        team.send(1, valid(1, 1));
    }
    team.send(9, with(valid(9, 1), |it| it.range_m = 14.0));
    let counts = team.tick(&[0, 1, 2]);
    assert_eq!((counts.late, counts.fused_late, counts.rejected_late), (2, 1, 0));
    assert_eq!(refused(&counts), [(Refusal::Contradiction, 1)]);
    assert_eq!(team.tick(&[0, 1, 2]), IntakeCounts::default());
}

#[test]
fn a_restored_intake_knows_reports_and_positions() {
    let mut team = Team::new("lockstep");
    team.tick(&[0, 1, 2]);
    let (record, now_ns) = (team.leader.intake.state().clone(), team.now_ns);
    let mut after = Team::new("lockstep");
    after.tick(&[]);
    assert!(after.leader.intake.restore(record, now_ns));
    after.send(1, valid(1, 1));
    assert!(after.asks_repeat());
    after.send(2, with(valid(2, 2), |it| it.pose.x_m = 17.0));
    let counts = after.tick(&[]);
    assert_eq!((counts.late, refused(&counts)), (0, vec![(Refusal::Jump, 1)]));
}

/// Seed 52747 of `rangehound explore`: a successor that was suspended before it first read the clock left robots out at
/// once.
#[test]
fn the_suspension_of_a_successor_is_no_silence() {
    let mut team = Team::new("lockstep");
    let file = ScenarioFile::parse("clock = \"lockstep\"\nticks = 100\ntimeout_s = 2.0\n", "test").unwrap();
    let scenario = Scenario::from_file(&file, "test").unwrap();
    let mut successor = Leader::new(&scenario).unwrap();
    successor.restore(team.leader.saved().unwrap(), team.now_ns).unwrap();
    team.leader = successor;
    team.send(1, valid(1, 0));
    // It is suspended for three times the time-out.
    team.now_ns += 60 * DT_NS;
    while team.leader.next_action(team.now_ns).unwrap().is_some() {}
    assert_eq!(team.next(), 1, "the others have not been silent");
    for _ in 0..21 {
        team.now_ns += DT_NS;
        while team.leader.next_action(team.now_ns).unwrap().is_some() {}
    }
    assert_eq!(team.next(), 2, "now they have");
}
