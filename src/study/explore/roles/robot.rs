//! A robot in simulated time.

use rangehound_robot::machine::{Action, Machine};
use rangehound_robot::pose;
use rangehound_robot::sensor::{self, measure};
use rangehound_shared::message::{Command, Outgoing};

use crate::study::explore::checker::robot::RobotChecker;
use crate::study::explore::cluster::{Cluster, Violation};
use crate::study::explore::message::Message;
use crate::study::explore::node::{FaultEffect, Process, Robot};
use crate::study::explore::plan::SIM;
use crate::study::explore::roles::remote::RemoteEnd;

/// Change of the range of a robot that measures anew, m.
const ANEW_M: f64 = 0.01;

impl Cluster<'_> {
    pub(in crate::study::explore) fn start_robot(&mut self, node: usize) -> Process {
        let id = node - self.plan.robot_nodes().start;
        self.checker.links.forget(id);
        // Like the real process, it reads how often the lead has been taken.
        let fusion_incarnation = self.lead.starts();
        let machine = Machine::new(self.scenario, id, fusion_incarnation);
        let equipment = (sensor::of_scenario(self.scenario, id), pose::of_scenario(self.scenario, id));
        let (Some(machine), (Some(sensor), Some(poses))) = (machine, equipment) else { return Process::None };
        let checker = RobotChecker::new(self.scenario, fusion_incarnation);
        self.nodes[node].incarnation += 1;
        let remote = self.plan.is_remote(id).then(|| RemoteEnd::new(self.scenario));
        Process::Robot(Box::new(Robot { machine, sensor, poses, checker, remote }))
    }

    pub(in crate::study::explore) fn run_robot(
        &mut self,
        node: usize,
        mut robot: Box<Robot>,
    ) -> Result<Process, Violation> {
        if let Some(end) = robot.remote.take() {
            return self.run_remote(node, robot, end);
        }
        let id = node - self.plan.robot_nodes().start;
        let is_well = !self.nodes[node].is_interrupted;
        let awake = robot.checker.wakes(self.now_ns, self.nodes[node].well_for_ns(self.now_ns), self.late_ns());
        awake.map_err(|what| self.violation(Some(node), what))?;
        let now_ns = self.local_ns(node);
        for message in self.take_inbox(node) {
            match message {
                Message::World(header, entries) => {
                    robot.machine.on_world(&header, &entries, now_ns);
                    robot.checker.world(header.incarnation);
                }
                Message::Heading(header, commands) => {
                    robot.machine.on_heading(&header, &commands);
                    if commands.len() == self.plan.robots {
                        robot.checker.heading(header.incarnation, header.tick, commands[id]);
                    }
                }
                _ => {}
            }
        }
        match self.act_all(node, &mut robot)? {
            FaultEffect::Dies { .. } => return Ok(Process::None),
            FaultEffect::Stops => return Ok(Process::Robot(robot)),
            FaultEffect::Lives => {}
        }
        if is_well {
            let slept = robot.checker.sleeps(self.now_ns, self.late_ns());
            slept.map_err(|what| self.violation(Some(node), what))?;
        }
        self.sleep_until(node, robot.machine.wakes_at_ns())?;
        Ok(Process::Robot(robot))
    }

    /// Does all that the machine has to do now, unless a fault ends that.
    pub(in crate::study::explore) fn act_all(
        &mut self,
        node: usize,
        robot: &mut Robot,
    ) -> Result<FaultEffect, Violation> {
        let now_ns = self.local_ns(node);
        let mut provides = true;
        loop {
            let Some(action) = robot.machine.next_action(now_ns) else {
                if !std::mem::take(&mut provides) {
                    return Ok(FaultEffect::Lives);
                }
                robot.machine.before_sleep();
                continue;
            };
            let effect = self.before_action(node)?;
            if let FaultEffect::Dies { .. } = effect {
                return Ok(effect);
            }
            self.act_robot(node, robot, action)?;
            if let FaultEffect::Stops = effect {
                return Ok(effect);
            }
        }
    }

    fn act_robot(&mut self, node: usize, robot: &mut Robot, action: Action) -> Result<(), Violation> {
        let Robot { machine, sensor, poses, checker, remote } = robot;
        if let Some(end) = remote {
            end.keep(machine, &action);
        }
        let id = node - self.plan.robot_nodes().start;
        let (now_ns, late_ns) = (self.local_ns(node), self.late_ns());
        match action {
            Action::Measure { tick, time_s, entry } => {
                let checked = checker.measures(tick, self.now_ns);
                checked.map_err(|what| self.violation(Some(node), what))?;
                let mut measurement = measure(sensor.as_mut(), poses.as_mut(), (tick, time_s), &entry);
                if self.plan.measures_anew && measurement.range().is_some() {
                    measurement.range_m += ANEW_M * (self.nodes[node].incarnation - 1) as f64;
                }
                machine.measured(measurement, now_ns);
            }
            Action::CarryOut(command) => {
                checker.carries_out(command, self.now_ns, late_ns);
                machine.carried_out(command);
            }
            Action::SendRange => {
                let Some(Outgoing { tick, valid_at_s, entry }) = machine.range() else { return Ok(()) };
                self.checker.range(tick, &entry).map_err(|what| self.violation(Some(node), what))?;
                if remote.is_some() {
                    self.checker.links.measures(id, tick, self.now_ns);
                    return Ok(());
                }
                let header = self.header(node, tick, valid_at_s);
                for fusion in self.plan.fusion_nodes() {
                    self.send(node, fusion, || Message::Range(header, entry));
                }
            }
            Action::SendDrive(Outgoing { tick, entry, .. }) => {
                let command = Command { heading_rad: entry.heading_rad, speed_mps: entry.speed_mps };
                let history = &mut self.checker.robots[id];
                let driven = checker.drives(history, tick, command, entry.heading_held_ns);
                if driven.map_err(|what| self.violation(Some(node), what))? {
                    self.trace(Some(node), || format!("obeys heading({tick})"));
                }
                if remote.is_some() {
                    self.checker.links.drives(id, tick, &entry);
                } else {
                    self.send(node, SIM, || Message::Drive(tick, entry));
                }
            }
            // The gateway notifies the nodes on the run's host.
            Action::Notify(_) if remote.is_some() => {}
            Action::Notify(notification) => self.notify(node, notification),
        }
        Ok(())
    }
}
