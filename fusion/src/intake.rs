//! Which messages count, pure: robots' messages in, what each is to the present tick out.
//!
//! Messages come from processes that may be broken or hostile. What cannot be true is refused and counted by
//! [`Refusal`]; what says again what was said is a repeat; what is of a tick that is over is late. Nothing here grows
//! with the number of messages, and no robot can hold up a tick by what it says.

use std::cmp::Ordering;

use rangehound_shared::measurement::Measurement;
use rangehound_shared::message::{Header, Range, Refusal};
use rangehound_shared::protocol::timing::range_deadline_ns;
use rangehound_shared::record::{Heard, Judged};
use rangehound_shared::scenario::bounds;
use rangehound_shared::scenario::{Clock, Patience, Scenario, Source};
use serde::{Deserialize, Serialize};

use crate::centre::{Centre, Late};
use crate::vector::Vector;

/// A range this many standard deviations below zero is no noise of a target close by.
const NEGATIVE_SIGMA_MAX: f64 = 10.0;

/// Nothing here is farther from anything, m: the filter's arithmetic stays far within bounds.
const DISTANCE_MAX_M: f64 = 1e12;

/// Rounding of positions: a share of their coordinates, and of the way.
const JUMP_ROUNDING: f64 = 1e-9;

/// Ticks that a robot may be ahead of what the time since the last tick began makes possible: one for the tick that
/// the simulator catches up on after it was stopped, one for a tick whose beginning was stamped at its repeat.
const AHEAD_TICKS_MAX: u64 = 2;

/// What came between two estimates besides the present tick's ranges.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Tally {
    /// Ranges of earlier ticks.
    pub late: u64,
    /// Of those, how many were fused at their own time.
    pub fused_late: u64,
    /// Of those, how many were rejected at their own time.
    pub rejected_late: u64,
    /// Messages refused, in the order of [`Refusal::ALL`].
    pub refused: [u64; Refusal::ALL.len()],
}

/// What the intake knows beyond the tick that it gathers: part of fusion's checkpoint.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Record {
    robots: Vec<RobotRecord>,
    /// When the last tick began, monotonic ns: what most say, or a step after the one before.
    began_ns: u64,
    /// What was said of the last tick, by robot, and since the one before of earlier ones: what is put down of it.
    said: Vec<Option<Measurement>>,
    said_late: Vec<LateReport>,
}

/// A report that came after its tick and was used all the same.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LateReport {
    /// Its own tick.
    pub tick: u64,
    /// Whose it is.
    pub robot: usize,
    /// What it says.
    pub report: Measurement,
    /// What became of its range.
    pub judged: Option<Judged>,
}

/// What an admitted message is to the tick that is being gathered.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Admitted {
    /// A report of that tick: for [`Intake::gather`].
    Now(Measurement),
    /// A report of a tick that is over: for [`Centre::take_late`], and what became of it for [`Intake::gather_late`].
    Late(Measurement),
    /// What was said before.
    Repeat,
    /// Of a later tick: the ticks before it are over.
    Ahead,
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct RobotRecord {
    /// Ticks in a row at which it said nothing.
    misses: u32,
    /// The ticks at which it was heard: bit i for the i-th before the present one.
    heard: u64,
    /// The newest tick at which its place was believed, and the place.
    place: (u64, Vector),
}

impl Record {
    /// What was said of the last tick, by robot.
    #[must_use]
    pub fn said(&self) -> &[Option<Measurement>] {
        &self.said
    }

    /// What was said of earlier ticks since the one before the last.
    #[must_use]
    pub fn said_late(&self) -> &[LateReport] {
        &self.said_late
    }
}

/// Gathers the reports of the present tick.
#[derive(Debug)]
pub struct Intake {
    ticks: u64,
    dt_s: f64,
    clock: Clock,
    patience: Patience,
    /// The most that each robot moves in a tick, m; `None` for recordings, whose sensors move as they please.
    steps_m: Option<Vec<f64>>,
    record: Record,
    reports: Vec<Option<Measurement>>,
    /// Who has said something of this tick, even if it was refused: nobody waits for them.
    spoke: Vec<bool>,
    /// When the tick began and which time it has, as each report says.
    began_ns: Vec<u64>,
    times_s: Vec<f64>,
    first_ns: Option<u64>,
    last_range_ns: u64,
    tally: Tally,
    late: Vec<LateReport>,
}

impl LateReport {
    /// As it is put down, with the first tick whose estimate knows of it.
    #[must_use]
    pub fn heard_at(&self, tick: u64) -> Heard {
        Heard { measurement: self.report, taken_at: tick, judged: self.judged }
    }
}

impl Intake {
    /// The intake of a run before its first tick.
    #[must_use]
    pub fn new(scenario: &Scenario) -> Self {
        let robots = scenario.robots.len();
        let of_robot = |[x, y]: [f64; 2]| RobotRecord { misses: 0, heard: 0, place: (0, Vector::new(x, y)) };
        let simulated = matches!(scenario.source, Source::Simulated { .. });
        Self {
            ticks: scenario.ticks,
            dt_s: scenario.dt_s,
            clock: scenario.clock,
            patience: scenario.patience,
            steps_m: simulated.then(|| scenario.robots.iter().map(|robot| robot.speed_mps * scenario.dt_s).collect()),
            record: Record {
                robots: scenario.robots.iter().map(|robot| of_robot(robot.start_m)).collect(),
                began_ns: 0,
                said: vec![None; robots],
                said_late: Vec::new(),
            },
            reports: vec![None; robots],
            spoke: vec![false; robots],
            began_ns: Vec::with_capacity(robots),
            times_s: Vec::with_capacity(robots),
            first_ns: None,
            last_range_ns: 0,
            tally: Tally::default(),
            late: Vec::new(),
        }
    }

    /// What [`Self::restore`] needs to go on after the last [`Self::close`].
    #[must_use]
    pub fn record(&self) -> &Record {
        &self.record
    }

    /// Goes on from the record of an intake of the same scenario; false if it is not such. `now_ns` is monotonic.
    pub fn restore(&mut self, record: Record, now_ns: u64) -> bool {
        let fits = [record.robots.len(), record.said.len()] == [self.reports.len(); 2];
        if fits {
            self.record = record;
            if self.record.began_ns > now_ns {
                // The clock of before the machine was started again says nothing.
                self.record.began_ns = 0;
            }
        }
        fits
    }

    /// Counts messages that were refused.
    pub fn refuse(&mut self, refusal: Refusal, count: u64) {
        self.tally.refused[refusal as usize] += count;
    }

    /// Judges a message that came at `now_ns`, monotonic. A report is the caller's to deliver.
    ///
    /// # Errors
    /// The [`Refusal`] of a message that counts for nothing; it is counted.
    pub fn admit(
        &mut self,
        centre: &Centre,
        header: &Header,
        message: &[Range],
        now_ns: u64,
    ) -> Result<Admitted, Refusal> {
        self.judge(centre, header, message, now_ns).inspect_err(|refusal| self.refuse(*refusal, 1))
    }

    fn judge(&mut self, centre: &Centre, header: &Header, message: &[Range], now_ns: u64) -> Result<Admitted, Refusal> {
        let [range] = message else { return Err(Refusal::Malformed) };
        let id = usize::try_from(range.robot).ok().filter(|id| *id < self.reports.len()).ok_or(Refusal::OutOfRange)?;
        let (tick, next) = (header.tick, centre.next_tick());
        if tick == next {
            self.spoke[id] = true;
            self.first_ns.get_or_insert(now_ns);
        }
        let report = self.sound(centre, header, range)?;
        if tick > self.newest_tick(next, now_ns) {
            return Err(Refusal::Future);
        }
        let said = if tick == next { self.reports[id] } else { centre.report_at(tick, id) };
        if said.is_some_and(|said| said != report) {
            return Err(Refusal::Contradiction);
        }
        self.record.robots[id].misses = 0;
        let age = next.wrapping_sub(tick + 1);
        let is_repeat = said.is_some() || tick < next && age < 64 && self.record.robots[id].heard >> age & 1 == 1;
        if is_repeat {
            return Ok(Admitted::Repeat);
        }
        self.follow(id, tick, report.pose.into())?;
        Ok(match tick.cmp(&next) {
            Ordering::Greater => Admitted::Ahead,
            Ordering::Equal => Admitted::Now(report),
            Ordering::Less => Admitted::Late(report),
        })
    }

    /// Takes a report of the present tick, from the message that brought it.
    pub fn gather(&mut self, header: &Header, range: &Range, report: Measurement, now_ns: u64) {
        let Some(slot) = self.reports.get_mut(range.robot as usize) else { return };
        *slot = Some(report);
        self.began_ns.push(range.tick_began_ns.min(now_ns));
        self.last_range_ns = self.last_range_ns.max(header.sent_ns.min(now_ns));
        self.times_s.push(header.valid_at_s);
    }

    /// Takes note of a report of a tick that is over, and of what became of it.
    pub fn gather_late(&mut self, next: u64, late: LateReport, outcome: Late) {
        let age = next.wrapping_sub(late.tick + 1);
        if let Some(record) = self.record.robots.get_mut(late.robot).filter(|_| age < 64) {
            record.heard |= 1 << age;
        }
        self.tally.late += u64::from(late.report.range().is_some());
        match outcome {
            Late::Fused => self.tally.fused_late += 1,
            Late::Rejected => self.tally.rejected_late += 1,
            Late::NoRange => {}
            Late::Missed => return,
        }
        self.late.push(late);
    }

    /// What a message says, if its numbers make sense.
    fn sound(&self, centre: &Centre, header: &Header, range: &Range) -> Result<Measurement, Refusal> {
        let Measurement { pose, has_range, .. } = range.measurement;
        let near = |value: f64| value.abs() <= DISTANCE_MAX_M;
        let is_range = |(range_m, std_m): (f64, f64)| {
            near(range_m) && bounds::STD_M.contains(&std_m) && range_m >= -NEGATIVE_SIGMA_MAX * std_m
        };
        let said = range.measurement.range();
        let is_sound = pose.numbers().into_iter().all(near) && said.is_none_or(is_range);
        // Steps of a simulation are all alike; those of a recording never go back.
        let is_timely = match self.steps_m {
            Some(_) => header.valid_at_s == header.tick as f64 * self.dt_s,
            None => {
                let earliest_s = if header.tick < centre.next_tick() { f64::MIN } else { centre.time_s() };
                header.valid_at_s.is_finite() && (header.valid_at_s >= earliest_s || centre.next_tick() == 0)
            }
        };
        if !is_sound || !is_timely || has_range > 1 {
            return Err(Refusal::Malformed);
        }
        Ok(Measurement::new(pose, said))
    }

    /// The newest tick that can have begun. In lock step none begins before fusion has answered the last; in real
    /// time each takes its time, but fusion may have been stopped or started late.
    fn newest_tick(&self, next: u64, now_ns: u64) -> u64 {
        let newest = match (self.clock, next.checked_sub(1)) {
            (Clock::Realtime, Some(last)) => {
                let elapsed = now_ns.saturating_sub(self.record.began_ns) / self.dt_ns();
                last.saturating_add(elapsed + AHEAD_TICKS_MAX)
            }
            _ => next,
        };
        newest.min(self.ticks)
    }

    /// When the present real-time tick can have begun, if the one before began when it is taken to have.
    fn earliest_ns(&self) -> u64 {
        self.record.began_ns.saturating_add(self.dt_ns())
    }

    fn dt_ns(&self) -> u64 {
        ((self.dt_s * 1e9) as u64).max(1)
    }

    /// Believes that a robot is at a place if it can have come there. One that is refused goes on being measured
    /// against where it was last believed to be: the longer ago, the more it may have moved.
    fn follow(&mut self, id: usize, tick: u64, position_m: Vector) -> Result<(), Refusal> {
        let place = &mut self.record.robots[id].place;
        if let Some(steps_m) = &self.steps_m {
            let reach_m = steps_m[id] * place.0.abs_diff(tick) as f64;
            let rounding_m = JUMP_ROUNDING * (1.0 + place.1.norm() + position_m.norm() + reach_m);
            if (position_m - place.1).norm() > reach_m + rounding_m {
                return Err(Refusal::Jump);
            }
        }
        if tick >= place.0 {
            *place = (tick, position_m);
        }
        Ok(())
    }

    /// When the last report of the present tick was sent, as its robot says, monotonic ns; 0 without any.
    #[must_use]
    pub fn last_range_ns(&self) -> u64 {
        self.last_range_ns
    }

    /// True if nothing has come of the present tick.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.first_ns.is_none()
    }

    /// When waiting for the rest of the tick ends, monotonic ns, if it ever does: tick 0 waits for the whole team.
    #[must_use]
    pub fn deadline_ns(&self, next: u64) -> Option<u64> {
        let first_ns = self.first_ns?;
        if next == 0 {
            return None;
        }
        match (self.clock, self.patience) {
            // Who speaks before the tick has begun, or says that it began long ago, shall not cut it short.
            (Clock::Realtime, _) => {
                let told_ns = self.began_ns.iter().copied().max().unwrap_or(first_ns);
                // A tick has begun a step after its first range at the latest, even if the ticks before it began in quick succession,
                // as those do that the simulator catches up on.
                let earliest_ns = self.earliest_ns().min(first_ns.saturating_add(self.dt_ns()));
                Some(range_deadline_ns(told_ns.max(earliest_ns), self.dt_s))
            }
            (Clock::Lockstep, Patience::Forever) => None,
            (Clock::Lockstep, Patience::After(limit)) => Some(first_ns.saturating_add(limit.as_nanos() as u64)),
        }
    }

    /// True if the present tick has all it will wait for.
    #[must_use]
    pub fn is_ready(&self, next: u64, now_ns: u64) -> bool {
        let misses_max = self.misses_max();
        let waited_for = |(spoke, record): (&bool, &RobotRecord)| !*spoke && record.misses < misses_max;
        !self.is_empty()
            && (!self.spoke.iter().zip(&self.record.robots).any(waited_for)
                || self.deadline_ns(next).is_some_and(|deadline_ns| deadline_ns <= now_ns))
    }

    /// Time for which this process stood still is nobody's silence.
    pub fn forgive(&mut self, suspended_ns: u64) {
        self.first_ns = self.first_ns.map(|first_ns| first_ns.saturating_add(suspended_ns));
    }

    /// How many robots the present tick waits for.
    #[must_use]
    pub fn expected(&self) -> usize {
        self.record.robots.iter().filter(|record| record.misses < self.misses_max()).count()
    }

    /// Misses in a row after which a robot is not waited for until it speaks again.
    fn misses_max(&self) -> u32 {
        match self.clock {
            // The deadline has cut short a busy robot now and then; a dead one costs all of them latency.
            Clock::Realtime => 3,
            Clock::Lockstep => 1,
        }
    }

    /// The reports of the present tick, by robot.
    #[must_use]
    pub fn reports(&self) -> &[Option<Measurement>] {
        &self.reports
    }

    /// The time of the present tick, s: what most of its reports say.
    pub fn time_s(&mut self, centre: &Centre) -> f64 {
        match self.steps_m {
            Some(_) => centre.next_tick() as f64 * self.dt_s,
            None => median(&mut self.times_s, f64::total_cmp).unwrap_or(centre.time_s()),
        }
    }

    /// Ends the present tick, processed at `now_ns`, and returns what came besides since the last one.
    pub fn close(&mut self, next: u64, now_ns: u64) -> Tally {
        let robots = self.reports.len();
        self.record.began_ns = if next == 0 {
            // No tick begins before the simulator has its answer.
            now_ns
        } else {
            let is_majority = 2 * self.began_ns.len() > robots;
            let told_ns = median(&mut self.began_ns, u64::cmp).filter(|_| is_majority);
            told_ns.unwrap_or_else(|| self.earliest_ns())
        };
        for ((record, report), spoke) in self.record.robots.iter_mut().zip(&self.reports).zip(&mut self.spoke) {
            record.misses = if *spoke { 0 } else { record.misses.saturating_add(1) };
            record.heard = record.heard << 1 | u64::from(report.is_some());
            *spoke = false;
        }
        self.record.said.copy_from_slice(&self.reports);
        self.reports.fill(None);
        self.record.said_late.clear();
        self.record.said_late.append(&mut self.late);
        self.began_ns.clear();
        self.times_s.clear();
        self.first_ns = None;
        self.last_range_ns = 0;
        std::mem::take(&mut self.tally)
    }
}

/// The lower median: what most say is there, whatever a few say.
fn median<T: Copy>(values: &mut [T], order: impl Fn(&T, &T) -> std::cmp::Ordering) -> Option<T> {
    let middle = values.len().checked_sub(1)? / 2;
    Some(*values.select_nth_unstable_by(middle, order).1)
}

#[cfg(test)]
mod tests {
    use rangehound_shared::measurement::Pose;

    use super::*;
    use crate::leader::Leader;
    use rangehound_shared::scenario::ScenarioFile;

    const DT_NS: u64 = 100_000_000;

    /// A team of three at (15, 0) and its fusion centre; ticks pass as the clock of the test says.
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

        fn say(&mut self, tick: u64, range: Range) {
            let header = Header { tick, valid_at_s: tick as f64 * 0.1, ..Header::default() };
            self.leader.on_range(&header, &[range], self.now_ns);
        }

        /// The tick that is being gathered, with what has come of it.
        fn process(&mut self) -> Tally {
            self.leader.end_tick();
            while self.leader.next_action(self.now_ns).unwrap().is_some() {}
            self.leader.tally
        }

        fn asks_repeat(&mut self) -> bool {
            std::mem::take(&mut self.leader.repeat_asked)
        }

        /// The tick that others are ahead at.
        fn ahead(&self) -> Option<u64> {
            Some(self.leader.over_before).filter(|tick| *tick > self.next())
        }

        /// A tick at which these robots say what is sound.
        fn tick(&mut self, heard: &[u64]) -> Tally {
            let tick = self.next();
            heard.iter().for_each(|robot| self.say(tick, sound(tick, *robot)));
            let tally = self.process();
            self.now_ns += DT_NS;
            tally
        }
    }

    fn sound(tick: u64, robot: u64) -> Range {
        let tick_began_ns = (1_000 + tick) * DT_NS;
        let measurement = Measurement::new(Pose::at([15.0, 0.0]), (tick > 0).then_some((15.0, 1.0)));
        Range { robot, measurement, tick_began_ns }
    }

    /// The same message with something else in its measurement.
    fn with(mut range: Range, change: impl FnOnce(&mut Measurement)) -> Range {
        change(&mut range.measurement);
        range
    }

    fn refused(tally: &Tally) -> Vec<(Refusal, u64)> {
        Refusal::ALL.into_iter().zip(tally.refused).filter(|(_, count)| *count > 0).collect()
    }

    #[test]
    fn what_makes_no_sense_is_refused_and_counted_by_cause() {
        for clock in ["lockstep", "realtime"] {
            let mut team = Team::new(clock);
            let ok = sound(1, 1);
            team.say(1, Range { robot: 3, ..ok });
            team.say(1, Range { robot: u64::MAX, ..ok });
            for nonsense in [
                with(ok, |it| it.has_range = 2),
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
                team.say(1, nonsense);
            }
            let header = Header { tick: 1, valid_at_s: 0.1, ..Header::default() };
            let Team { leader, now_ns } = &mut team;
            leader.on_range(&header, &[], *now_ns);
            leader.on_range(&header, &[ok, ok], *now_ns);
            leader.on_range(&Header { valid_at_s: f64::NAN, ..header }, &[ok], *now_ns);
            leader.on_range(&Header { valid_at_s: 0.2, ..header }, &[ok], *now_ns);
            leader.refuse_impostors(1);
            let tally = team.tick(&[0, 2]);
            let expected = [(Refusal::Impostor, 1), (Refusal::OutOfRange, 2), (Refusal::Malformed, 14)];
            assert_eq!(refused(&tally), expected, "{clock}");
            let estimate = team.leader.centre.estimate();
            assert_eq!((estimate.fused, estimate.missing), (2, 1), "{clock}");
        }
    }

    /// A target close by, and noise: the paper's own robots measure less than nothing now and then.
    #[test]
    fn a_range_a_little_below_zero_is_noise() {
        let mut team = Team::new("lockstep");
        team.say(1, with(sound(1, 1), |it| it.range_m = -2.5));
        assert_eq!(team.tick(&[0, 2]), Tally::default());
        assert_eq!(team.leader.centre.estimate().fused, 3);
    }

    #[test]
    fn the_first_word_counts_and_what_contradicts_it_is_refused() {
        let mut team = Team::new("lockstep");
        let first = sound(1, 1);
        team.say(1, first);
        team.say(1, first);
        team.say(1, with(first, |it| it.range_m = 99.0));
        assert_eq!(team.leader.intake.reports()[1].unwrap().range(), Some((15.0, 1.0)));
        assert_eq!(refused(&team.tick(&[0, 2])), [(Refusal::Contradiction, 1)]);
        assert!(!team.asks_repeat());
        // The same of a tick that is over: a repeat asks for the heading, another word is refused.
        team.say(1, first);
        assert!(team.asks_repeat());
        team.say(1, with(first, |it| it.pose.x_m = 15.5));
        assert!(!team.asks_repeat());
        let tally = team.tick(&[0, 1, 2]);
        assert_eq!((refused(&tally), tally.late), (vec![(Refusal::Contradiction, 1)], 0));
    }

    #[test]
    fn a_jump_is_refused_until_the_robot_can_have_come_there() {
        let mut team = Team::new("lockstep");
        // 10 m/s and 0.1 s: a metre each tick.
        let away = |tick| with(sound(tick, 1), |it| it.pose.x_m = 19.5);
        for tick in 1..5 {
            team.say(tick, away(tick));
            assert_eq!(refused(&team.tick(&[0, 2])), [(Refusal::Jump, 1)], "tick {tick}");
            assert_eq!(team.leader.centre.estimate().missing, 1);
        }
        team.say(5, away(5));
        assert_eq!(team.tick(&[0, 2]), Tally::default());
        assert_eq!(team.leader.centre.estimate().fused, 3);
    }

    #[test]
    fn in_lock_step_nobody_is_ahead() {
        let mut team = Team::new("lockstep");
        team.now_ns += 1_000 * DT_NS;
        for tick in [2, 3, 50, 101, u64::MAX] {
            team.say(tick, sound(1, 1));
        }
        assert_eq!(team.ahead(), None);
        let tally = team.tick(&[0, 1, 2]);
        assert_eq!(tally.refused[Refusal::Future as usize] + tally.refused[Refusal::Malformed as usize], 5);
        assert!(tally.refused[Refusal::Future as usize] >= 4, "{tally:?}");
        assert_eq!(team.next(), 2);
    }

    #[test]
    fn in_real_time_nobody_is_further_ahead_than_the_time_that_went_by() {
        let mut team = Team::new("realtime");
        (1..5).for_each(|_| _ = team.tick(&[0, 1, 2]));
        assert_eq!(team.next(), 5);
        let newest = |team: &Team| 5 + AHEAD_TICKS_MAX + (team.now_ns - 1_005 * DT_NS) / DT_NS;
        for elapsed in [0, 7] {
            team.now_ns += elapsed * DT_NS;
            let newest = newest(&team);
            let before = team.ahead();
            team.say(newest + 1, sound(newest + 1, 1));
            assert_eq!(team.ahead(), before);
            team.say(newest, sound(newest, 1));
            assert_eq!(team.ahead(), Some(newest));
        }
        // The run has no tick after its last, however long it takes.
        team.now_ns += 1_000 * DT_NS;
        team.say(101, sound(101, 1));
        assert_eq!(team.ahead(), Some(14));
    }

    /// One robot that is as far ahead as it may be, over and over: fusion stays within reach of the others.
    #[test]
    fn a_robot_that_is_always_ahead_does_not_drive_fusion_away_from_the_others() {
        let mut team = Team::new("realtime");
        for tick in 1..50 {
            for ahead in (tick..tick + 10).rev() {
                team.say(ahead, sound(ahead, 2));
            }
            while team.leader.next_action(team.now_ns).unwrap().is_some() {}
            for robot in [0, 1] {
                team.say(tick, sound(tick, robot));
            }
            while team.leader.next_action(team.now_ns + DT_NS * 6 / 10).unwrap().is_some() {}
            assert!(team.next() <= tick + 1 + AHEAD_TICKS_MAX, "tick {tick}: at {}", team.next());
            team.now_ns += DT_NS;
        }
    }

    #[test]
    fn who_only_talks_nonsense_is_not_waited_for() {
        for clock in ["lockstep", "realtime"] {
            let mut team = Team::new(clock);
            for tick in 1..4 {
                team.say(tick, sound(tick, 0));
                team.say(tick, sound(tick, 2));
                assert!(!team.leader.intake.is_ready(tick, team.now_ns), "{clock}: robot 1 is waited for");
                team.say(tick, with(sound(tick, 1), |it| it.range_std_m = f64::NAN));
                assert!(team.leader.intake.is_ready(tick, team.now_ns), "{clock}");
                // What makes sense after all still counts.
                team.say(tick, sound(tick, 1));
                team.tick(&[]);
                assert_eq!(team.leader.centre.estimate().fused, 3);
            }
        }
    }

    /// However a robot lies about the beginning of a tick, the tick neither ends before its time nor waits for ever.
    #[test]
    fn a_lie_about_the_beginning_of_a_tick_moves_no_deadline_far() {
        for lie_ns in [0, u64::MAX] {
            let mut team = Team::new("realtime");
            team.tick(&[0, 1, 2]);
            team.say(2, Range { tick_began_ns: lie_ns, ..sound(2, 1) });
            let deadline_ns = team.leader.intake.deadline_ns(2).unwrap();
            assert_eq!(deadline_ns, team.now_ns + DT_NS / 2);
        }
    }

    #[test]
    fn a_late_range_is_counted_once_and_fused_if_its_tick_is_kept() {
        let mut team = Team::new("realtime");
        team.tick(&[0, 2]);
        (2..9).for_each(|_| _ = team.tick(&[0, 1, 2]));
        team.tick(&[0, 2]);
        team.tick(&[0, 1, 2]);
        for _ in 0..3 {
            team.say(9, sound(9, 1));
            team.say(1, sound(1, 1));
        }
        team.say(9, with(sound(9, 1), |it| it.range_m = 14.0));
        let tally = team.tick(&[0, 1, 2]);
        assert_eq!((tally.late, tally.fused_late, tally.rejected_late), (2, 1, 0));
        assert_eq!(refused(&tally), [(Refusal::Contradiction, 1)]);
        assert_eq!(team.tick(&[0, 1, 2]), Tally::default());
    }

    #[test]
    fn a_restored_intake_knows_who_was_heard_and_where() {
        let mut team = Team::new("lockstep");
        team.tick(&[0, 1, 2]);
        let (record, now_ns) = (team.leader.intake.record().clone(), team.now_ns);
        let mut after = Team::new("lockstep");
        after.tick(&[]);
        assert!(after.leader.intake.restore(record, now_ns));
        after.say(1, sound(1, 1));
        assert!(after.asks_repeat());
        after.say(2, with(sound(2, 2), |it| it.pose.x_m = 17.0));
        let tally = after.tick(&[]);
        assert_eq!((tally.late, refused(&tally)), (0, vec![(Refusal::Jump, 1)]));
    }
}
