//! The fusion centre's part in the protocol as a state machine round a [`Centre`]: no clock, no port, no file.
//!
//! A driver feeds it with messages ([`Leader::on_range`]), asks for the next [`Action`], carries it out, and asks again until there
//! is none. Nothing is fed in between. Time is an argument: monotonic, ns.
//!
//! A tick is update, plan, checkpoint, headings, estimate, record; in that order, so that robots do not wait for the rest, and a kill
//! cannot lose published state.

use std::borrow::Cow;
use std::collections::VecDeque;

use rangehound_shared::measurement::Kind;
use rangehound_shared::message::{Estimate, Header, Range, Refusal, Stages};
use rangehound_shared::protocol::timing::Suspension;
use rangehound_shared::protocol::wake::{Event, Notification, WaitGroup};
use rangehound_shared::record::Exchange;
use rangehound_shared::robot_set::RobotSet;
use rangehound_shared::scenario::{Clock, Scenario};
use rangehound_shared::sealed::SealError;
use serde::{Deserialize, Serialize};

use crate::centre::{self, Centre, Diverged};
use crate::intake::{self, Admitted, Intake, IntakeCounts, LateReport};
use crate::planner::PlannerError;

/// The driver's next action.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Action {
    /// Read the clock, and ask for the next action.
    Continue,
    /// Check that no other process has taken the lead meanwhile. A process that has lost the lead must not act any more.
    RequireLead,
    /// Write [`Leader::saved`] to the checkpoint, before all later actions.
    Save,
    /// Publish the commands of the last tick: [`Leader::centre`].
    SendHeadings,
    /// Notify another node.
    Notify(Notification),
    /// Publish [`Leader::estimate`].
    SendEstimate,
    /// Record the last tick: [`Leader::estimate`], [`Leader::exchanges`], [`Leader::late_reports`].
    Record,
    /// Report to the user.
    Report(Notice),
}

/// A message to the user.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Notice {
    /// Fusion has missed these ticks.
    Missed {
        /// The first of them.
        first: u64,
        /// The last of them.
        last: u64,
    },
    /// Most sensors of this kind fail together: the reported noise of all their measurements is multiplied by this factor,
    /// and none of them is distrusted.
    NoiseRaised(Kind, f64),
    /// Most sensors of this kind no longer fail together.
    NoiseAsStated(Kind),
    /// A robot's measurements of this kind are distrusted.
    Distrusted(Kind, usize),
    /// They are trusted again.
    Trusted(Kind, usize),
    /// Messages are refused for this cause: reported once.
    Refused(Refusal),
}

/// The step after the last action.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    Gather,
    Plan,
    Close,
    Save,
    RequireLead,
    SendHeadings,
    Wake,
    SendEstimate,
    Record,
}

/// The fusion centre of a run, in one incarnation.
#[derive(Debug)]
pub struct Leader {
    clock: Clock,
    last_tick: u64,
    pub(crate) centre: Centre,
    pub(crate) intake: Intake,
    phase: Phase,
    actions: VecDeque<Action>,
    /// The simulator has been notified of the lead.
    greeted: bool,
    /// Ticks before this one are over, whether or not all robots have reported.
    pub(crate) over_before: u64,
    /// Ticks were missed: the simulator must repeat the present one.
    asks_repeat: bool,
    /// A robot repeated a fused report: it has missed its heading.
    pub(crate) repeat_asked: bool,
    stages: Stages,
    pub(crate) counts: IntakeCounts,
    estimate: Estimate,
    distrusted: [RobotSet; Kind::COUNT],
    noise_scales: [f64; Kind::COUNT],
    /// Causes of refusal that have been reported.
    refusals_reported: [bool; Refusal::ALL.len()],
    suspension: Suspension,
}

/// State for a restarted fusion centre: borrowed for writing, owned after reading.
#[derive(Debug, Serialize, Deserialize)]
pub struct Saved<'a> {
    centre: centre::Saved<'a>,
    intake: Cow<'a, intake::IntakeState>,
    /// Of the last estimate.
    counts: IntakeCounts,
}

impl Leader {
    /// The fusion centre of a run before its first tick.
    ///
    /// # Errors
    /// [`PlannerError`] if the scenario's planner cannot serve its team.
    pub fn new(scenario: &Scenario) -> Result<Self, PlannerError> {
        Ok(Self::of_centre(scenario, Centre::new(scenario)?.with_history()))
    }

    /// The same with a given centre for this scenario, for example with another planner or without stored ticks.
    #[must_use]
    pub fn of_centre(scenario: &Scenario, centre: Centre) -> Self {
        Self {
            clock: scenario.clock,
            last_tick: scenario.ticks,
            centre,
            intake: Intake::new(scenario),
            phase: Phase::Gather,
            actions: VecDeque::with_capacity(8 + 2 * scenario.robots.len()),
            greeted: false,
            over_before: 0,
            asks_repeat: false,
            repeat_asked: false,
            stages: Stages::default(),
            counts: IntakeCounts::default(),
            estimate: Estimate::default(),
            distrusted: Default::default(),
            noise_scales: [1.0; Kind::COUNT],
            refusals_reported: [false; Refusal::ALL.len()],
            suspension: Suspension::default(),
        }
    }

    /// Continues from the saved state of a killed predecessor, which may or may not have published the last tick. A robot
    /// that missed its heading asks for it, and the tick is recorded again.
    ///
    /// # Errors
    /// If the state is invalid or belongs to another run.
    pub fn restore(&mut self, saved: Saved<'_>, now_ns: u64) -> Result<(), SealError> {
        let Saved { centre, intake, counts } = saved;
        self.centre.restore(centre)?;
        if !self.intake.restore(intake.into_owned(), now_ns) {
            return Err(SealError::Malformed);
        }
        (self.distrusted, self.noise_scales) = (self.centre.distrusted(), self.centre.noise_scales());
        // The process may be suspended before it first reads the clock: seed 52747 of `rangehound explore`.
        self.suspension.look(now_ns);
        if self.centre.next_tick() > 0 {
            self.counts = counts;
            self.estimate = self.estimate_with(Stages::default());
            self.actions.push_back(Action::Record);
        }
        Ok(())
    }

    /// State from which [`Self::restore`] continues.
    ///
    /// # Errors
    /// If the tracker cannot be encoded.
    pub fn saved(&mut self) -> Result<Saved<'_>, SealError> {
        Ok(Saved { centre: self.centre.saved()?, intake: Cow::Borrowed(self.intake.state()), counts: self.counts })
    }

    /// Takes a message of the topic `range` that arrived at `now_ns`.
    pub fn on_range(&mut self, header: &Header, message: &[Range], now_ns: u64) {
        // The intake counts refused messages.
        let Ok(admitted) = self.intake.admit(&self.centre, header, message, now_ns) else { return };
        let [range] = message else { return };
        let (tick, next) = (header.tick, self.centre.next_tick());
        self.repeat_asked |= tick + 1 == next;
        match admitted {
            Admitted::Now(report) => self.intake.gather(header, range, report, now_ns),
            Admitted::Late(report) => {
                let robot = range.robot as usize;
                let outcome = self.centre.take_late(tick, robot, report);
                let judged = self.centre.judged_at(tick, robot);
                self.intake.gather_late(next, LateReport { tick, robot, report, judged }, outcome);
            }
            Admitted::Repeat => {}
            Admitted::Ahead => self.catch_up(tick),
        }
    }

    /// Counts messages of processes that do not hold the lease of their role.
    pub fn refuse_impostors(&mut self, count: u64) {
        self.intake.refuse(Refusal::Impostor, count);
    }

    /// No more messages of the present tick will arrive.
    pub fn end_tick(&mut self) {
        self.over_before = self.over_before.max(self.centre.next_tick() + 1);
    }

    /// Ends the run: reports that never arrived in real time count as missing, but every tick gets its estimate.
    pub fn finish(&mut self) {
        self.over_before = self.last_tick + 1;
    }

    /// The next action; `None` until a message arrives or [`Self::wakes_at_ns`].
    ///
    /// # Errors
    /// [`Diverged`] if the estimate leaves all bounds.
    pub fn next_action(&mut self, now_ns: u64) -> Result<Option<Action>, Diverged> {
        if let Some(action) = self.actions.pop_front() {
            return Ok(Some(action));
        }
        let (phase, action) = match self.phase {
            Phase::Gather => return self.gather(now_ns),
            Phase::Plan => {
                self.stages.filtered_ns = now_ns;
                self.centre.plan();
                (Phase::Close, Action::Continue)
            }
            Phase::Close => {
                self.stages.planned_ns = now_ns;
                self.counts = self.intake.close(self.centre.next_tick() - 1, self.stages.filtered_ns);
                // A deposed process writes nothing that its successor could read.
                (Phase::Save, Action::RequireLead)
            }
            Phase::Save => (Phase::RequireLead, Action::Save),
            Phase::RequireLead => {
                self.stages.saved_ns = now_ns;
                (Phase::SendHeadings, Action::RequireLead)
            }
            Phase::SendHeadings => (Phase::Wake, Action::SendHeadings),
            Phase::Wake => {
                self.stages.sent_ns = now_ns;
                (Phase::SendEstimate, Action::Notify(Notification::always(WaitGroup::Robots, Event::Heading)))
            }
            Phase::SendEstimate => {
                self.estimate = self.estimate_with(self.stages);
                (Phase::Record, Action::SendEstimate)
            }
            Phase::Record => {
                self.report_trust();
                self.report_refusals();
                (Phase::Gather, Action::Record)
            }
        };
        self.phase = phase;
        Ok(Some(action))
    }

    /// When it must act even if no message arrives, monotonic ns.
    #[must_use]
    pub fn wakes_at_ns(&self) -> Option<u64> {
        self.intake.deadline_ns(self.centre.next_tick())
    }

    /// True if it waits for the next real-time tick, and no message of that tick has arrived.
    #[must_use]
    pub fn waits_for_tick(&self) -> bool {
        self.clock == Clock::Realtime && self.intake.is_empty()
    }

    /// How many robots the present tick waits for.
    #[must_use]
    pub fn expected(&self) -> usize {
        self.intake.expected()
    }

    /// When the newest tick reached each stage, as far as it has.
    #[must_use]
    pub fn stages(&self) -> &Stages {
        &self.stages
    }

    /// Filter and planner.
    #[must_use]
    pub fn centre(&self) -> &Centre {
        &self.centre
    }

    /// The last tick's estimate, with the counts since the one before.
    #[must_use]
    pub fn estimate(&self) -> &Estimate {
        &self.estimate
    }

    /// The last tick's exchange with each robot.
    pub fn exchanges(&self) -> impl Iterator<Item = Exchange> {
        self.centre.exchanges(self.centre.next_tick().saturating_sub(1), self.intake.state().reports())
    }

    /// Late reports that arrived during the last tick.
    #[must_use]
    pub fn late_reports(&self) -> &[LateReport] {
        self.intake.state().late_reports()
    }

    /// Skips to a tick that others have reached: this process was suspended or started late. It cannot gather the ticks
    /// between, and predicts through them.
    fn catch_up(&mut self, tick: u64) {
        if tick > self.over_before {
            let first = self.over_before.max(self.centre.next_tick());
            if self.intake.is_empty() {
                self.actions.push_back(Action::Report(Notice::Missed { first, last: tick - 1 }));
            }
            self.over_before = tick;
            self.asks_repeat = true;
        }
    }

    fn gather(&mut self, now_ns: u64) -> Result<Option<Action>, Diverged> {
        self.intake.extend(self.suspension.look(now_ns), now_ns);
        let next = self.centre.next_tick();
        if next < self.over_before || self.intake.is_ready(next, now_ns) {
            self.stages = Stages { last_range_ns: self.intake.last_range_ns(), began_ns: now_ns, ..Stages::default() };
            let time_s = self.intake.time_s(&self.centre);
            self.centre.update(time_s, self.intake.reports())?;
            self.phase = Phase::Plan;
            return Ok(Some(Action::Continue));
        }
        if std::mem::take(&mut self.repeat_asked) && next > 0 {
            // All robots get their headings again, once.
            self.actions.push_back(Action::SendHeadings);
            self.actions.push_back(Action::Notify(Notification::always(WaitGroup::Robots, Event::Heading)));
            return Ok(Some(Action::RequireLead));
        }
        if std::mem::take(&mut self.asks_repeat) || !std::mem::replace(&mut self.greeted, true) {
            return Ok(Some(Action::Notify(Notification::always(WaitGroup::Sim, Event::Hello))));
        }
        Ok(None)
    }

    fn estimate_with(&self, stages: Stages) -> Estimate {
        let IntakeCounts { late, fused_late, rejected_late, refused } = self.counts;
        Estimate { late, fused_late, rejected_late, refused, stages, ..self.centre.estimate() }
    }

    fn report(&mut self, notice: Notice) {
        self.actions.push_back(Action::Report(notice));
    }

    /// Reports when most sensors begin or cease to fail together; otherwise the robots that have become distrusted or
    /// trusted since the last tick.
    fn report_trust(&mut self) {
        let (now, scales) = (self.centre.distrusted(), self.centre.noise_scales());
        let before = std::mem::replace(&mut self.distrusted, now);
        let scales_before = std::mem::replace(&mut self.noise_scales, scales);
        for kind in Kind::ALL {
            let (now, before) = (&now[kind as usize], &before[kind as usize]);
            let (scale, scale_before) = (scales[kind as usize], scales_before[kind as usize]);
            if scale > 1.0 && scale_before == 1.0 {
                self.report(Notice::NoiseRaised(kind, scale));
                continue;
            }
            if scale == 1.0 && scale_before > 1.0 {
                self.report(Notice::NoiseAsStated(kind));
            }
            if now != before {
                now.iter().filter(|id| !before.contains(*id)).for_each(|id| self.report(Notice::Distrusted(kind, id)));
                before.iter().filter(|id| !now.contains(*id)).for_each(|id| self.report(Notice::Trusted(kind, id)));
            }
        }
    }

    /// Reports each cause of refusal once; the run's report has the counts.
    fn report_refusals(&mut self) {
        for refusal in Refusal::ALL {
            let is_new = self.counts.refused[refusal as usize] > 0 && !self.refusals_reported[refusal as usize];
            if is_new {
                self.refusals_reported[refusal as usize] = true;
                self.report(Notice::Refused(refusal));
            }
        }
    }
}
