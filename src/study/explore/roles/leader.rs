//! The leading fusion in simulated time.

use std::rc::Rc;

use rangehound_fusion::leader::{Action, Notice};
use rangehound_shared::message::Command;
use rangehound_shared::protocol::wake::{Event, WaitGroup};

use crate::study::explore::checker::timing::{Closing, Missing};
use crate::study::explore::cluster::{Cluster, SimEvent, Violation};
use crate::study::explore::message::Message;
use crate::study::explore::node::{FaultEffect, Leading, Node, Process};
use crate::study::explore::plan::SIM;

/// Ticks after a fault from which on no robot may be missing because of it.
const CALM_TICKS: u64 = 6;

impl Cluster<'_> {
    pub(in crate::study::explore) fn run_leader(
        &mut self,
        node: usize,
        mut leading: Box<Leading>,
    ) -> Result<Process, Violation> {
        let now_ns = self.local_ns(node);
        for message in self.take_inbox(node) {
            let Message::Range(header, range) = message else { continue };
            let is_of_team = range.robot < self.plan.robots as u64;
            if is_of_team && header.tick == leading.machine.centre().next_tick() {
                let is_other = |first: Option<(u64, u64)>| first.is_none_or(|(tick, _)| tick != header.tick);
                if is_other(leading.first_range) {
                    leading.first_range = Some((header.tick, now_ns));
                }
                if is_other(leading.ran_at_first_ns) {
                    leading.ran_at_first_ns = Some((header.tick, self.now_ns - self.nodes[node].suspended_ns));
                }
            }
            if header.tick <= self.plan.ticks {
                leading.newest_heard = leading.newest_heard.max(header.tick);
            }
            leading.machine.on_range(&header, &[range], now_ns);
        }
        let began_at = leading.machine.centre().next_tick();
        let mut finishes = self.is_finished;
        loop {
            let action = leading.machine.next_action(now_ns);
            let Some(action) = action.map_err(|error| self.violation(Some(node), error.to_string()))? else {
                if !std::mem::take(&mut finishes) {
                    break;
                }
                leading.machine.finish();
                continue;
            };
            let effect = self.before_action(node)?;
            if let FaultEffect::Dies { written } = effect {
                if action == Action::Save {
                    self.save_leader(node, &mut leading, written)?;
                }
                return Ok(Process::None);
            }
            if action == Action::RequireLead && !self.holds_lead(&leading) {
                return Ok(self.is_deposed(node, &leading));
            }
            if action == Action::SendHeadings && !std::mem::take(&mut leading.has_looked) {
                return Err(self.violation(Some(node), "it sent headings without checking that it leads".to_owned()));
            }
            leading.has_looked |= action == Action::RequireLead;
            self.act_leader(node, &mut leading, action)?;
            if let FaultEffect::Stops = effect {
                return Ok(Process::Leader(leading));
            }
        }
        if leading.machine.centre().next_tick() == began_at && !self.holds_lead(&leading) {
            return Ok(self.is_deposed(node, &leading));
        }
        self.sleep_until(node, leading.machine.wakes_at_ns())?;
        Ok(Process::Leader(leading))
    }

    /// True while it holds the lead; then it sends a heartbeat.
    fn holds_lead(&mut self, leading: &Leading) -> bool {
        let holds = self.lead.is_current(leading.lease);
        if holds {
            self.lead.send_heartbeat(self.now_ns);
        }
        holds
    }

    /// A deposed leader releases its lock and stands by.
    fn is_deposed(&mut self, node: usize, leading: &Leading) -> Process {
        self.trace(Some(node), || "sees that it was deposed; stands by".to_owned());
        self.nodes[node].heartbeat_ns = Some(self.now_ns);
        // It connects anew, and finds no old message.
        self.nodes[node].inbox.clear();
        self.free(leading.lease.lock);
        self.after(0, SimEvent::Wakes { node, event: Some(Event::Range) });
        self.stand_by()
    }

    fn act_leader(&mut self, node: usize, leading: &mut Leading, action: Action) -> Result<(), Violation> {
        let machine = &leading.machine;
        let tick = machine.centre().next_tick().saturating_sub(1);
        match action {
            Action::Continue | Action::RequireLead => {}
            Action::Save => self.save_leader(node, leading, 1.0)?,
            Action::SendHeadings => {
                let commands = machine.centre().commands();
                let is_current = self.lead.is_current(leading.lease);
                let checked = self.checker.headings(tick, commands, is_current);
                checked.map_err(|what| self.violation(Some(node), what))?;
                self.trace(Some(node), || format!("heading({tick})"));
                let header = self.header(node, tick, machine.centre().time_s());
                let commands: Rc<[Command]> = commands.into();
                for receiver in self.plan.commanded() {
                    self.send(node, receiver, || Message::Heading(header, Rc::clone(&commands)));
                }
            }
            Action::Notify(notification) => self.notify(node, notification),
            Action::SendEstimate => {
                let checked = self.checker.estimate(tick, machine.estimate());
                checked.map_err(|what| self.violation(Some(node), what))?;
            }
            Action::Record => {
                let missing = self.record(node, leading, tick).map_err(|what| self.violation(Some(node), what))?;
                let closed = self.checker.timing.closes(&self.closing(node, leading, tick, missing));
                closed.map_err(|what| self.violation(Some(node), what))?;
                self.groups[WaitGroup::Fusion as usize].expected = leading.machine.expected();
            }
            Action::Report(notice) => {
                if let Notice::Missed { first, last } = notice {
                    self.trace(Some(node), || format!("missed ticks {first} to {last}"));
                }
            }
        }
        Ok(())
    }

    /// A tick is recorded. Robots may be missing only if there was a recent fault.
    fn record(&mut self, node: usize, leading: &Leading, tick: u64) -> Result<Missing, String> {
        let calm_ns = CALM_TICKS * (self.scenario.dt_s * 1e9) as u64;
        let robot_nodes = self.plan.robot_nodes().zip(0..);
        let are_linked: Vec<bool> =
            robot_nodes.map(|(node, id)| self.is_linked_for(id, &self.nodes[node], calm_ns)).collect();
        let Self { checker, nodes, plan, .. } = self;
        let now_ns = self.now_ns;
        let is_well = |node: usize| nodes[node].well_for_ns(now_ns) > calm_ns;
        let calm_from_ns = self.calm_from_ns.max(leading.since_ns);
        let has_one_rate = plan.has_one_rate();
        let is_calm = has_one_rate && now_ns > calm_from_ns + calm_ns && is_well(SIM) && is_well(node);
        let robots_from = plan.robot_nodes().start;
        checker.record(tick, &leading.machine, |id| is_calm && is_well(robots_from + id) && are_linked[id])
    }

    /// How a tick was closed.
    fn closing(&self, node: usize, leading: &Leading, tick: u64, missing: Missing) -> Closing {
        let began_ns = leading.machine.stages().began_ns;
        let of_tick = |first: Option<(u64, u64)>| first.filter(|(first, _)| *first == tick).map(|(_, at_ns)| at_ns);
        let ran_ns = self.now_ns - self.nodes[node].suspended_ns;
        // A wake-up may come before a slow message, which is then read at the next wake-up.
        let is_seen_at_once = self.plan.network.wakes_on_arrival || self.plan.network.slow == 0.0;
        let [sim, fusion] = [SIM, node].map(|node| &self.nodes[node]);
        // A robot that is stopped or killed just after it has sent its range does not notify fusion.
        let first_arrival = fusion.first_arrival.filter(|(.., from)| {
            let (sender, dt_ns) = (&self.nodes[*from], (self.scenario.dt_s * 1e9) as u64);
            let robot = from - self.plan.robot_nodes().start;
            is_seen_at_once && sender.well_for_ns(self.now_ns) > dt_ns && self.is_linked_for(robot, sender, dt_ns)
        });
        let first_arrival = first_arrival.map(|(first, at_ns, _)| (first, at_ns));
        Closing {
            tick,
            missing,
            is_cut: leading.newest_heard > tick || self.is_finished,
            at_ns: fusion.clock.global_ns(began_ns),
            arrived_ns: of_tick(first_arrival),
            held_ns: of_tick(leading.first_range).map(|first_ns| began_ns.saturating_sub(first_ns)),
            ran_ns: of_tick(leading.ran_at_first_ns).map(|first_ns| ran_ns - first_ns),
            well_for_ns: sim
                .well_for_ns(self.now_ns)
                .min(fusion.well_for_ns(self.now_ns))
                .min(self.now_ns - leading.since_ns),
            late_ns: self.late_ns(),
            slowest_ns: self.plan.network.slowest_ns() + self.links_slowest_ns(),
        }
    }

    fn save_leader(&mut self, node: usize, leading: &mut Leading, share: f64) -> Result<(), Violation> {
        let Some(disk) = leading.disk else { return Ok(()) };
        let shares = |other: &Node| match &other.process {
            Process::Leader(other) => other.disk == Some(disk) && self.lead.is_current(other.lease),
            _ => false,
        };
        if self.nodes.iter().any(shares) {
            return Err(self.violation(Some(node), "a deposed fusion writes to its successor's checkpoint".to_owned()));
        }
        let saved = leading.machine.saved().map_err(|error| self.violation(Some(node), error.to_string()))?;
        let written = self.disks[disk].write(&mut leading.writer, &saved, share);
        written.map_err(|what| self.violation(Some(node), what))
    }
}
