//! Progress of a run, read from its logs while they grow.

use std::time::Instant;

use rangehound_node::logs;
use rangehound_node::rendezvous::{Rendezvous, Role, RunDescription};
use rangehound_node::tick_log::TickLogReader;
use rangehound_shared::record::{FusionRecord, Heading, Record, WorldRecord};

use super::faults::Target;
use super::outcome::is_repeatable;
use crate::study::hosts::Hosts;

/// Progress of a run, read from its logs while they grow.
pub(super) struct Ticks<'a> {
    pub(super) description: &'a RunDescription,
    pub(super) world: Option<TickLogReader<WorldRecord>>,
    pub(super) estimate: Option<TickLogReader<FusionRecord>>,
    /// Newest tick that has ended.
    pub(super) newest: u64,
    /// When it was first seen.
    pub(super) since: Instant,
    pub(super) newest_estimate: u64,
    /// Newest tick that was read, and for each robot its newest tick with a range.
    pub(super) read: Option<u64>,
    pub(super) heard: Vec<u64>,
    /// The same for its newest tick with a fresh heading.
    led: Vec<u64>,
}

impl<'a> Ticks<'a> {
    pub(super) fn of(run: &'a Rendezvous) -> Self {
        let description = run.description();
        let heard = vec![0; description.scenario.robots.len()];
        let led = heard.clone();
        let (newest, newest_estimate, since) = (0, 0, Instant::now());
        Self { description, world: None, estimate: None, newest, since, newest_estimate, read: None, heard, led }
    }

    pub(super) fn update(&mut self) {
        // A log exists once its node has started.
        if self.world.is_none() {
            self.world = logs::read_worlds(self.description).ok();
        }
        if self.estimate.is_none() {
            self.estimate = logs::read_estimates(self.description).ok();
        }
        fn newest<R: Record>(log: &TickLogReader<R>) -> Option<u64> {
            log.newest_tick().ok().flatten()
        }
        if let Some(tick) = self.estimate.as_ref().and_then(newest::<FusionRecord>) {
            self.newest_estimate = tick;
        }
        let Some(log) = &mut self.world else { return };
        let Some(tick) = newest(log) else { return };
        if tick > self.newest {
            (self.newest, self.since) = (tick, Instant::now());
        }
        // Only complete records are read.
        while self.read.is_none_or(|read| read < tick) {
            let Some(Ok((read, record))) = log.next() else { break };
            self.read = Some(read);
            for (id, robot) in record.robots.iter().enumerate().take(self.heard.len()) {
                if robot.range_sent_ns.is_some() {
                    self.heard[id] = read;
                }
                if robot.heading == Heading::Fresh {
                    self.led[id] = read;
                }
            }
        }
    }

    /// The newest tick that shows this target at work. In lock step no tick ends without all nodes. The gateway is at work if
    /// all robots on other hosts are led, a host if those on it are.
    pub(super) fn heard(&self, target: Target, hosts: Option<&Hosts>) -> u64 {
        let led = |is_of: &dyn Fn(usize) -> bool| {
            let host_of = |robot: usize| hosts.map_or(0, |hosts| hosts.host_of(robot));
            let led = self.led.iter().enumerate().filter(|(robot, _)| is_of(host_of(*robot)));
            led.map(|(_, tick)| *tick).min().unwrap_or(self.newest)
        };
        match target {
            _ if is_repeatable(&self.description.scenario) => self.newest,
            Target::Node(Role::Robot(id)) => self.heard.get(id).copied().unwrap_or(0),
            Target::Node(Role::Fusion | Role::Standby(_)) => self.newest_estimate,
            Target::Node(Role::Sim | Role::Supervisor) => self.newest,
            Target::Node(Role::Gateway) => led(&|host| host != 0),
            Target::Host(number) => led(&|host| host == number),
        }
    }
}
