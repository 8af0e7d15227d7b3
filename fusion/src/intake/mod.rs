//! Classification of robots' messages, pure: each is for the present tick, late, a repeat, or refused.
//!
//! Messages come from processes that may be broken or hostile. An impossible message is refused and counted by
//! [`Refusal`]. A report that was received before is a repeat; a report of a past tick is late. Memory does not grow
//! with the number of messages, and no message can delay a tick.

mod timing;
mod validation;

use std::cmp::Ordering;

use rangehound_shared::measurement::{Measurement, Pose};
use rangehound_shared::message::{Header, Range, Refusal};
use rangehound_shared::record::{GateResults, Heard};
use rangehound_shared::scenario::{Clock, Scenario};
use serde::{Deserialize, Serialize};

use crate::centre::{Centre, Late};
use timing::{Timing, lower_median};
use validation::Validation;

/// Past ticks for which the robots that reported are known: the bits of a `u64`.
const HEARD_TICKS: u64 = 64;

/// Late and refused messages between two estimates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct IntakeCounts {
    /// Ranges of earlier ticks.
    pub late: u64,
    /// Of those, how many were fused at their own time.
    pub fused_late: u64,
    /// Of those, how many were rejected at their own time.
    pub rejected_late: u64,
    /// Messages refused, in the order of [`Refusal::ALL`].
    pub refused: [u64; Refusal::ALL.len()],
}

/// The intake's state beyond the present tick: part of fusion's checkpoint.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct IntakeState {
    robots: Vec<RobotState>,
    /// When the last tick began, monotonic ns.
    began_ns: u64,
    /// Reports of the last tick, by robot; the last tick's record needs them and the late ones.
    reports: Vec<Option<Measurement>>,
    late_reports: Vec<LateReport>,
}

/// A report that arrived after its tick and was used.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LateReport {
    /// Its own tick.
    pub tick: u64,
    /// The robot that sent it.
    pub robot: usize,
    /// The measurement.
    pub report: Measurement,
    /// The gate's decision on its range.
    pub judged: GateResults,
}

/// The class of an admitted message, relative to the present tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Admitted {
    /// A report of the present tick: for [`Intake::gather`].
    Now(Measurement),
    /// A report of a past tick: for [`Centre::take_late`], whose outcome is for [`Intake::gather_late`].
    Late(Measurement),
    /// A report that was received before.
    Repeat,
    /// A report of a later tick: the ticks before it are over.
    Ahead,
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct RobotState {
    /// Consecutive ticks without a message.
    misses: u32,
    /// The ticks at which the robot reported: bit i for the i-th before the present one.
    heard: u64,
    /// The newest tick whose reported position was accepted, and the position.
    place: (u64, Pose),
    /// The newest incarnation of the robot whose report was accepted.
    incarnation: u64,
}

impl RobotState {
    fn new([x_m, y_m]: [f64; 2]) -> Self {
        Self { misses: 0, heard: 0, place: (0, Pose::at([x_m, y_m])), incarnation: 0 }
    }

    fn was_heard_at(&self, age: u64) -> bool {
        age < HEARD_TICKS && self.heard >> age & 1 == 1
    }
}

impl IntakeState {
    /// Reports of the last tick, by robot.
    #[must_use]
    pub fn reports(&self) -> &[Option<Measurement>] {
        &self.reports
    }

    /// Reports of earlier ticks that arrived during the last tick.
    #[must_use]
    pub fn late_reports(&self) -> &[LateReport] {
        &self.late_reports
    }
}

impl LateReport {
    /// The entry for the record; `tick` is the first tick whose estimate includes the report.
    #[must_use]
    pub fn heard_at(&self, tick: u64) -> Heard {
        Heard { measurement: self.report, taken_at: tick, judged: self.judged }
    }
}

/// Gathers the reports of the present tick.
#[derive(Debug)]
pub struct Intake {
    /// Consecutive misses after which a tick does not wait for a robot until it sends a message again.
    misses_max: u32,
    validation: Validation,
    timing: Timing,
    state: IntakeState,
    reports: Vec<Option<Measurement>>,
    /// Robots that have sent a message of this tick, even a refused one: the tick does not wait for them.
    has_sent: Vec<bool>,
    /// The tick's time according to each report, s.
    times_s: Vec<f64>,
    counts: IntakeCounts,
    late: Vec<LateReport>,
}

impl Intake {
    /// The intake of a run before its first tick.
    #[must_use]
    pub fn new(scenario: &Scenario) -> Self {
        let robots = scenario.robots.len();
        let misses_max = match scenario.clock {
            // A busy robot may miss a deadline now and then; waiting for a dead one costs all robots latency.
            Clock::Realtime => 3,
            Clock::Lockstep => 1,
        };
        Self {
            misses_max,
            validation: Validation::new(scenario),
            timing: Timing::new(scenario),
            state: IntakeState {
                robots: scenario.robots.iter().map(|robot| RobotState::new(robot.start_m)).collect(),
                began_ns: 0,
                reports: vec![None; robots],
                late_reports: Vec::new(),
            },
            reports: vec![None; robots],
            has_sent: vec![false; robots],
            times_s: Vec::with_capacity(robots),
            counts: IntakeCounts::default(),
            late: Vec::new(),
        }
    }

    /// State from which [`Self::restore`] continues after the last [`Self::close`].
    #[must_use]
    pub fn state(&self) -> &IntakeState {
        &self.state
    }

    /// Continues from the state of an intake of the same scenario; false if the state does not fit. `now_ns` is monotonic.
    pub fn restore(&mut self, state: IntakeState, now_ns: u64) -> bool {
        let fits = [state.robots.len(), state.reports.len()] == [self.reports.len(); 2];
        if fits {
            self.state = state;
            self.timing.resume(now_ns);
            if self.state.began_ns > now_ns {
                // The computer was restarted, and the monotonic clock with it: the old time has no meaning.
                self.state.began_ns = 0;
            }
        }
        fits
    }

    /// Counts messages that were refused.
    pub fn refuse(&mut self, refusal: Refusal, count: u64) {
        self.counts.refused[refusal as usize] += count;
    }

    /// Classifies a message that arrived at `now_ns`, monotonic. The caller delivers the report.
    ///
    /// # Errors
    /// The [`Refusal`] of an invalid message, which is counted.
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
            self.has_sent[id] = true;
            self.timing.add_message(now_ns);
        }
        let report = self.validation.measurement(centre, header, range)?;
        if !self.timing.can_have_begun((id, tick), next, self.state.began_ns, now_ns) {
            return Err(Refusal::Future);
        }
        let robot = &mut self.state.robots[id];
        let before = if tick == next { self.reports[id] } else { centre.report_at(tick, id) };
        // A robot that restarted within the tick measures again. Its first report counts, and it needs its heading.
        let is_restarted = header.incarnation > robot.incarnation;
        if before.is_some_and(|before| before != report) && !is_restarted {
            return Err(Refusal::Contradiction);
        }
        robot.misses = 0;
        if before.is_some() || tick < next && robot.was_heard_at(next - tick - 1) {
            return Ok(Admitted::Repeat);
        }
        // Each report is compared with the last accepted position. The older that is, the farther the robot may have moved.
        let place = (tick, report.pose);
        if !self.validation.can_reach(id, robot.place, place) {
            return Err(Refusal::Jump);
        }
        if tick >= robot.place.0 {
            robot.place = place;
        }
        Ok(match tick.cmp(&next) {
            Ordering::Greater => Admitted::Ahead,
            Ordering::Equal => Admitted::Now(report),
            Ordering::Less => Admitted::Late(report),
        })
    }

    /// Adds a report of the present tick, with its message.
    pub fn gather(&mut self, header: &Header, range: &Range, report: Measurement, now_ns: u64) {
        let id = range.robot as usize;
        let Some((slot, robot)) = self.reports.get_mut(id).zip(self.state.robots.get_mut(id)) else { return };
        *slot = Some(report);
        robot.incarnation = robot.incarnation.max(header.incarnation);
        self.timing.add_report(header, now_ns);
        self.times_s.push(header.valid_at_s);
    }

    /// Counts a late report and its outcome.
    pub fn gather_late(&mut self, next: u64, late: LateReport, outcome: Late) {
        let age = next.wrapping_sub(late.tick + 1);
        if let Some(robot) = self.state.robots.get_mut(late.robot).filter(|_| age < HEARD_TICKS) {
            robot.heard |= 1 << age;
        }
        self.counts.late += u64::from(late.report.count() > 0);
        match outcome {
            Late::Fused => self.counts.fused_late += 1,
            Late::Rejected => self.counts.rejected_late += 1,
            Late::Nothing => {}
            Late::Missed => return,
        }
        self.late.push(late);
    }

    /// When the last report of the present tick was sent, by its robot's stamp, monotonic ns; 0 without any.
    #[must_use]
    pub fn last_range_ns(&self) -> u64 {
        self.timing.last_range_ns()
    }

    /// True if no message of the present tick has arrived.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.timing.is_silent()
    }

    /// The present tick's deadline, monotonic ns, if it has one.
    #[must_use]
    pub fn deadline_ns(&self, next: u64) -> Option<u64> {
        self.timing.deadline_ns(next, self.state.began_ns)
    }

    /// True if all expected reports of the present tick have arrived, or its deadline has passed.
    #[must_use]
    pub fn is_ready(&self, next: u64, now_ns: u64) -> bool {
        let is_done = |(has_sent, robot): (&bool, &RobotState)| *has_sent || !self.is_waited_for(robot);
        !self.is_empty()
            && (self.has_sent.iter().zip(&self.state.robots).all(is_done)
                || self.deadline_ns(next).is_some_and(|deadline_ns| deadline_ns <= now_ns))
    }

    /// Extends the deadline by the time for which this process was suspended: it is not the robots' silence.
    pub fn extend(&mut self, suspended_ns: u64, now_ns: u64) {
        self.timing.extend(suspended_ns, now_ns);
    }

    /// How many robots the present tick waits for.
    #[must_use]
    pub fn expected(&self) -> usize {
        self.state.robots.iter().filter(|robot| self.is_waited_for(robot)).count()
    }

    fn is_waited_for(&self, robot: &RobotState) -> bool {
        robot.misses < self.misses_max
    }

    /// The reports of the present tick, by robot.
    #[must_use]
    pub fn reports(&self) -> &[Option<Measurement>] {
        &self.reports
    }

    /// The time of the present tick, s: the lower median of its reports' times.
    pub fn time_s(&mut self, centre: &Centre) -> f64 {
        let reported_s = |times_s: &mut [f64]| lower_median(times_s, f64::total_cmp).unwrap_or(centre.time_s());
        self.validation.time_s(centre.next_tick()).unwrap_or_else(|| reported_s(&mut self.times_s))
    }

    /// Ends the present tick, processed at `now_ns`, and returns the counts since the last one.
    pub fn close(&mut self, next: u64, now_ns: u64) -> IntakeCounts {
        self.state.began_ns = self.timing.close(next, self.state.began_ns, now_ns);
        for ((robot, report), has_sent) in self.state.robots.iter_mut().zip(&self.reports).zip(&mut self.has_sent) {
            robot.misses = if *has_sent { 0 } else { robot.misses.saturating_add(1) };
            robot.heard = robot.heard << 1 | u64::from(report.is_some());
            *has_sent = false;
        }
        self.state.reports.copy_from_slice(&self.reports);
        self.reports.fill(None);
        self.state.late_reports.clear();
        self.state.late_reports.append(&mut self.late);
        self.times_s.clear();
        std::mem::take(&mut self.counts)
    }
}

#[cfg(test)]
mod tests;
