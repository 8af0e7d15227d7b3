//! A robot on another host in simulated time: its machine, and its end of the link to the gateway.

use rangehound_robot::machine::{Action, Machine};
use rangehound_robot::remote::{Rejoin, RobotEnd, RunIncarnation, silence_max_ns};
use rangehound_shared::scenario::{Clock, Scenario};

use crate::study::explore::checker::robot::RobotChecker;
use crate::study::explore::cluster::{Cluster, Violation};
use crate::study::explore::gateway::RUN_ID;
use crate::study::explore::links::{LINK_NS, Way};
use crate::study::explore::message::Message;
use crate::study::explore::node::{FaultEffect, Process, Robot};

/// Time between two attempts to join, ns.
const BETWEEN_NS: u64 = 100_000_000;

/// Longest sleep, ns.
const LONGEST_SLEEP_NS: u64 = 50_000_000;

/// Without a fault, a robot has a link after this time at the latest, ns: it notices that the gateway is silent, and the gateway
/// that its predecessor is.
const JOINS_NS: u64 = 1_500_000_000;

/// A robot's end of its link.
#[derive(Debug)]
pub(in crate::study::explore) struct RemoteEnd {
    pub(in crate::study::explore) robot_end: RobotEnd,
    session: Option<Session>,
    /// When it next tries to join, by its own clock, ns.
    attempt_ns: u64,
    /// The run life that it has joined last.
    of: Option<RunIncarnation>,
}

/// An open link.
#[derive(Debug, Clone, Copy)]
struct Session {
    connection: u64,
    /// When it was opened, by the robot's clock, ns.
    joined_ns: u64,
}

impl RemoteEnd {
    pub(in crate::study::explore) fn new(scenario: &Scenario) -> Self {
        Self { robot_end: RobotEnd::new(RUN_ID, scenario.clock), session: None, attempt_ns: 0, of: None }
    }

    /// The number of its open link.
    pub(in crate::study::explore) fn connection(&self) -> Option<u64> {
        self.session.map(|session| session.connection)
    }

    /// Takes what the machine sends.
    pub(in crate::study::explore) fn keep(&mut self, machine: &Machine, action: &Action) {
        match action {
            Action::SendRange => machine.range().iter().for_each(|message| self.robot_end.on_range(message)),
            Action::SendDrive(message) => self.robot_end.on_drive(message),
            Action::Measure { .. } | Action::CarryOut(_) | Action::Notify(_) => {}
        }
    }
}

impl Cluster<'_> {
    pub(in crate::study::explore) fn run_remote(
        &mut self,
        node: usize,
        mut robot: Box<Robot>,
        mut end: RemoteEnd,
    ) -> Result<Process, Violation> {
        let is_well = !self.nodes[node].is_interrupted;
        let awake = robot.checker.wakes(self.now_ns, self.nodes[node].well_for_ns(self.now_ns), self.late_ns());
        awake.map_err(|what| self.violation(Some(node), what))?;
        // Like the real process, it acts after each frame.
        if let Some(Message::Downlink { connection, frame }) = self.take_frame(node)
            && end.connection() == Some(connection)
        {
            let now_ns = self.local_ns(node);
            end.robot_end.on_downlink(&frame, now_ns);
            if let Some(world) = &frame.world {
                let (header, entry) = world.message(RUN_ID);
                robot.machine.on_own_world(&header, &entry, now_ns);
                robot.checker.world(header.incarnation);
            }
            if let Some(heading) = &frame.heading {
                let (header, command) = heading.message(RUN_ID);
                robot.machine.on_own_heading(&header, Some(&command));
                robot.checker.heading(header.incarnation, header.tick, command);
            }
        }
        robot.remote = Some(end);
        self.watch_link(node, &mut robot)?;
        if robot.remote.as_ref().is_some_and(|end| end.of.is_some()) {
            match self.act_all(node, &mut robot)? {
                FaultEffect::Dies { .. } => return Ok(Process::None),
                FaultEffect::Stops => return Ok(Process::Robot(robot)),
                FaultEffect::Lives => {}
            }
            if is_well {
                let slept = robot.checker.sleeps(self.now_ns, self.late_ns());
                slept.map_err(|what| self.violation(Some(node), what))?;
            }
        }
        match self.send_up(node, &mut robot)? {
            FaultEffect::Dies { .. } => return Ok(Process::None),
            FaultEffect::Stops => return Ok(Process::Robot(robot)),
            FaultEffect::Lives => {}
        }
        let wakes_at_ns = self.wakes_at_ns(node, &robot);
        self.sleep_until(node, Some(wakes_at_ns))?;
        Ok(Process::Robot(robot))
    }

    /// A robot on another host wakes up: in real time what it measured must have come, unless its link or itself was disturbed.
    pub(in crate::study::explore) fn check_arrivals(&self, node: usize) -> Result<(), Violation> {
        let Some(id) = node.checked_sub(self.plan.robot_nodes().start).filter(|id| self.plan.is_remote(*id)) else {
            return Ok(());
        };
        let sender = &self.nodes[node];
        let good_for_ns = self.link_good_for_ns(id, sender).min(sender.well_for_ns(self.now_ns));
        let arrived = self.checker.links.arrive(id, self.now_ns, good_for_ns);
        if self.plan.clock == Clock::Realtime {
            arrived.map_err(|what| self.violation(Some(node), what))
        } else {
            Ok(())
        }
    }

    /// Sends every frame that is due.
    fn send_up(&mut self, node: usize, robot: &mut Robot) -> Result<FaultEffect, Violation> {
        let (id, to) = (node - self.plan.robot_nodes().start, self.plan.gateway());
        let now_ns = self.local_ns(node);
        while let Some(end) = &mut robot.remote
            && let Some(Session { connection, .. }) = end.session
            && let Some(frame) = end.robot_end.next_frame(now_ns)
        {
            let effect = self.before_action(node)?;
            if let FaultEffect::Dies { .. } = effect {
                return Ok(effect);
            }
            self.send_frame(id, Way::Up, to, || Message::Uplink {
                robot: id,
                connection,
                frame: Box::new(frame.clone()),
            });
            if let FaultEffect::Stops = effect {
                return Ok(effect);
            }
        }
        Ok(FaultEffect::Lives)
    }

    /// Gives up a link over which nothing comes, and tries to open another one.
    fn watch_link(&mut self, node: usize, robot: &mut Robot) -> Result<(), Violation> {
        let id = node - self.plan.robot_nodes().start;
        let now_ns = self.local_ns(node);
        let Some(end) = &mut robot.remote else { return Ok(()) };
        if let Some(Session { joined_ns, .. }) = end.session {
            let silent_ns = now_ns.saturating_sub(joined_ns);
            if end.robot_end.silence_ns(now_ns).unwrap_or(u64::MAX).min(silent_ns) <= silence_max_ns(2 * LINK_NS) {
                return Ok(());
            }
            end.session = None;
            self.trace(Some(node), || "hears nothing of the gateway".to_owned());
        }
        if now_ns < end.attempt_ns {
            return Ok(());
        }
        end.attempt_ns = now_ns + BETWEEN_NS;
        if let Some(connection) = self.join(id, self.nodes[node].life) {
            end.session = Some(Session { connection, joined_ns: now_ns });
            let of = RunIncarnation { run_id: RUN_ID, life: self.incarnation };
            if of.after(end.of.replace(of)) != Rejoin::Continue
                && let Some(machine) = Machine::new(self.scenario, id, self.lead.starts())
            {
                robot.machine = machine;
                robot.checker = RobotChecker::new(self.scenario, self.lead.starts());
                end.robot_end = RobotEnd::new(RUN_ID, self.scenario.clock);
                self.checker.links.forget(id);
                self.checker.robots[id].starts_anew();
            }
            return Ok(());
        }
        let well_ns = self.nodes[node].well_for_ns(self.now_ns).min(self.now_ns.saturating_sub(self.calm_from_ns));
        let gateway_ns = self.nodes[self.plan.gateway()].well_for_ns(self.now_ns);
        if well_ns.min(gateway_ns) > JOINS_NS + self.late_ns() {
            return Err(self.violation(Some(node), "it does not join again".to_owned()));
        }
        Ok(())
    }

    /// When it must act even if no frame comes, by its own clock, ns.
    fn wakes_at_ns(&self, node: usize, robot: &Robot) -> u64 {
        let look_ns = self.local_ns(node) + LONGEST_SLEEP_NS;
        let Some(end) = &robot.remote else { return look_ns };
        let of_link = if end.session.is_some() { end.robot_end.wakes_at_ns() } else { Some(end.attempt_ns) };
        let of_machine = robot.machine.wakes_at_ns().filter(|_| end.of.is_some());
        of_link.into_iter().chain(of_machine).fold(look_ns, u64::min)
    }
}
