//! The gateway in simulated time: it takes part for the robots on other hosts.

use rand::RngExt as _;
use rangehound_robot::remote::Publication;
use rangehound_robot::remote::wire::Downlink;
use rangehound_shared::message::{Header, Outgoing};
use rangehound_shared::protocol::wake::Event;

use crate::run::supervisor::deaths::End;
use crate::study::explore::cluster::{Cluster, SimEvent, Violation};
use crate::study::explore::gateway::{Applicant, RUN_ID};
use crate::study::explore::links::{GatewayKill, LINK_NS, Links, Way};
use crate::study::explore::message::Message;
use crate::study::explore::network::WAKE_NS;
use crate::study::explore::node::{Node, Process};
use crate::study::explore::plan::SIM;

/// Longest sleep of a gateway, ns: then it reads everything.
const LONGEST_SLEEP_NS: u64 = 50_000_000;

/// Time after the last disturbance within which ticks are gathered as if there had been none, ns.
const SETTLED_NS: u64 = 1_000_000_000;

/// Longer than any run.
const UNBOUNDED_NS: u64 = 1_000_000_000_000;

impl Cluster<'_> {
    /// Schedules what is planned for the gateway of a team that has robots on other hosts, for its links and its host.
    pub(in crate::study::explore) fn start_links(&mut self) {
        let Some(Links { cuts, kills, stops, reboots, .. }) = &self.plan.links else { return };
        for (index, cut) in cuts.iter().enumerate() {
            self.after(cut.at_ns, SimEvent::CutBegins(index));
        }
        for (index, kill) in kills.iter().enumerate() {
            self.after(kill.at_ns, SimEvent::GatewayKillBegins(index));
        }
        for (index, reboot) in reboots.iter().enumerate() {
            self.after(reboot.at_ns, SimEvent::Reboots(index));
        }
        for (index, stop) in stops.iter().enumerate() {
            self.after(stop.at_ns, SimEvent::GatewayStops(index));
        }
    }

    /// It does nothing until it is continued, and then reads whatever has arrived; or until it is killed as hung.
    pub(in crate::study::explore) fn stop_gateway(&mut self, index: usize) {
        let stop = self.plan.links.as_ref().and_then(|links| links.stops.get(index));
        let node = self.plan.gateway();
        if let Some(stop) = stop
            && self.gateway_runs()
        {
            self.counts.faults += 1;
            self.stop(node, stop.for_ns);
        }
    }

    fn gateway_runs(&self) -> bool {
        let gateway = &self.nodes[self.plan.gateway()];
        matches!(gateway.process, Process::Gateway) && !gateway.is_stopped
    }

    pub(in crate::study::explore) fn begin_gateway_kill(&mut self, index: usize) {
        let after_actions = self.plan.links.as_ref().and_then(|links| links.kills.get(index));
        self.gateway.pending_kill = after_actions.map(|kill| (index, kill.after_actions));
    }

    pub(in crate::study::explore) fn begin_cut(&mut self, index: usize) {
        let Some(cut) = self.plan.links.as_ref().and_then(|links| links.cuts.get(index)) else { return };
        self.counts.faults += 1;
        let way = match cut.only {
            None => "",
            Some(Way::Down) => ", only to them",
            Some(Way::Up) => ", only from them",
        };
        let for_ms = cut.for_ns / 1_000_000;
        self.trace(Some(self.plan.gateway()), || {
            format!("the links to robots {:#b} are cut for {for_ms} ms{way}", cut.robots)
        });
    }

    /// Lets it read its messages and frames, and send what is due.
    pub(in crate::study::explore) fn run_gateway(&mut self, index: usize) -> Result<Process, Violation> {
        for message in std::mem::take(&mut self.gateway.inbox) {
            let taken = self.gateway.take(&message, self.plan.robots, self.now_ns);
            let publications =
                taken.map_err(|(robot, what)| self.violation(Some(index), format!("for robot-{robot} {what}")))?;
            for (robot, publication) in publications {
                if !self.publish(robot, publication)? {
                    return Ok(Process::None);
                }
            }
        }
        for robot in self.gateway.release_silent(self.now_ns) {
            self.trace(Some(index), || format!("robot-{robot} is silent: its role is free"));
        }
        for robot in self.plan.robot_ids() {
            let Some(remote) = self.gateway.remote_robots.get_mut(&robot) else { continue };
            let Some(frame) = remote.relay.next_frame(self.now_ns) else { continue };
            let (connection, sent) = (remote.connection, remote.checker.sends(&frame, self.now_ns));
            sent.map_err(|what| self.violation(Some(index), format!("for robot-{robot} {what}")))?;
            if !self.gateway_lives() {
                return Ok(Process::None);
            }
            self.send_down(robot, connection, frame);
        }
        self.sleep(index, self.gateway.frame_due_ns().saturating_sub(self.now_ns).clamp(1, LONGEST_SLEEP_NS));
        Ok(Process::Gateway)
    }

    /// Publishes a robot's message, and notifies the node that waits for it. False if the gateway dies meanwhile.
    fn publish(&mut self, robot: usize, publication: Publication) -> Result<bool, Violation> {
        let Some(incarnation) = self.gateway.remote_robots.get(&robot).map(|remote| remote.incarnation) else {
            return Ok(true);
        };
        if !self.gateway_lives() {
            return Ok(false);
        }
        let index = self.plan.gateway();
        let notification = match publication {
            Publication::Range(Outgoing { tick, valid_at_s, entry }, notification) => {
                self.trace(Some(index), || format!("range({tick}) of robot-{robot}"));
                self.checker.links.publishes(robot, tick);
                let header = Header { run_id: RUN_ID, incarnation, tick, valid_at_s, sent_ns: self.now_ns };
                for fusion in self.plan.fusion_nodes() {
                    self.send(index, fusion, || Message::Range(header, entry));
                }
                Some(notification)
            }
            Publication::Drive(Outgoing { tick, entry, .. }, notification) => {
                let drove = self.checker.links.drove(robot, tick, &entry);
                drove.map_err(|what| self.violation(Some(index), what))?;
                self.send(index, SIM, || Message::Drive(tick, entry));
                notification
            }
        };
        let Some(notification) = notification else { return Ok(true) };
        let lives = self.gateway_lives();
        if lives {
            self.notify(index, notification);
        }
        Ok(lives)
    }

    /// Counts an action of the gateway. False if it is killed before it.
    fn gateway_lives(&mut self) -> bool {
        let Some((index, after_actions)) = &mut self.gateway.pending_kill else { return true };
        if let Some(fewer) = after_actions.checked_sub(1) {
            *after_actions = fewer;
            return true;
        }
        let kill = self.plan.links.as_ref().and_then(|links| links.kills.get(*index));
        let up_ns = kill.map_or(0, |kill: &GatewayKill| kill.up_ns);
        self.counts.faults += 1;
        let node = self.plan.gateway();
        self.nodes[node].up_ns = up_ns;
        self.die(node, End::Killed);
        false
    }

    /// A robot's process asks for its role: the number of its link, if it has joined.
    pub(in crate::study::explore) fn join(&mut self, robot: usize, process: u32) -> Option<u64> {
        let is_open = self.gateway_runs() && ![Way::Down, Way::Up].into_iter().any(|way| self.is_cut(robot, way));
        if !is_open {
            return None;
        }
        let applicant = Applicant { robot, process };
        let joined = self.gateway.welcome(self.scenario, applicant, self.lead.starts(), self.now_ns)?;
        let again = if joined.is_new { "" } else { " again" };
        self.trace(Some(self.plan.gateway()), || format!("robot-{robot} joins{again}"));
        if joined.is_new {
            self.after(WAKE_NS, SimEvent::Wakes { node: SIM, event: Some(Event::Hello) });
        }
        self.after(0, SimEvent::Wakes { node: self.plan.gateway(), event: Some(Event::Hello) });
        Some(joined.connection)
    }

    fn send_down(&mut self, robot: usize, connection: u64, frame: Downlink) {
        let to = self.plan.robot_nodes().start + robot;
        self.send_frame(robot, Way::Down, to, || Message::Downlink { connection, frame: Box::new(frame) });
    }

    /// Sends a frame over a link with its disturbances.
    pub(in crate::study::explore) fn send_frame(
        &mut self,
        robot: usize,
        way: Way,
        to: usize,
        message: impl Fn() -> Message,
    ) {
        let Some(links) = &self.plan.links else { return };
        if self.is_cut(robot, way) {
            return;
        }
        let quality = links.quality;
        let is_good = quality.is_good() || self.since_start_ns() >= quality.until_ns;
        if !is_good && self.random.random_bool(quality.loss) {
            return;
        }
        let copies = if !is_good && self.random.random_bool(quality.duplicates) { 2 } else { 1 };
        for _ in 0..copies {
            let late_ns = if is_good { 0 } else { self.random.random_range(0..=quality.jitter_ns) };
            self.after(LINK_NS + late_ns, SimEvent::Arrival { to, message: message(), is_garbled: false });
        }
    }

    fn is_cut(&self, robot: usize, way: Way) -> bool {
        let at_ns = self.since_start_ns();
        self.plan.links.as_ref().is_some_and(|links| links.is_cut(robot, way, at_ns))
    }

    /// The longest time that links add to the time in which fusion learns when a tick began, ns.
    pub(in crate::study::explore) fn links_slowest_ns(&self) -> u64 {
        let Some(links) = &self.plan.links else { return 0 };
        let is_calm = links.is_undisturbed() || self.now_ns > self.calm_from_ns + SETTLED_NS;
        if is_calm { 4 * LINK_NS } else { UNBOUNDED_NS }
    }

    /// Time for which a robot on another host has had a link without disturbances, ns.
    pub(in crate::study::explore) fn link_good_for_ns(&self, robot: usize, node: &Node) -> u64 {
        let Some(links) = &self.plan.links else { return 0 };
        let good_ns = self.since_start_ns().saturating_sub(links.bad_until_ns(robot, self.since_start_ns()));
        self.gateway.linked_for_ns(robot, node, self.now_ns).min(good_ns)
    }

    /// True unless the robot is on another host and has been without a link within this time.
    pub(in crate::study::explore) fn is_linked_for(&self, robot: usize, node: &Node, for_ns: u64) -> bool {
        !self.plan.is_remote(robot) || self.gateway.linked_for_ns(robot, node, self.now_ns) > for_ns
    }
}
