//! A run while faults are injected.

use std::time::{Duration, Instant};

use anyhow::anyhow;
use rangehound_fusion::standby::STANDBYS_MAX;
use rangehound_node::rendezvous::{Process, Rendezvous, Role};
use rustix::process::{Pid, Signal, kill_process};

use super::faults::{Kind, PlannedFault, Target};
use super::outcome::Injected;
use super::ticks::Ticks;
use crate::run::remote::process_in;
use crate::study::hosts::{Hosts, RUN_HOST};

/// A run while faults are injected.
pub(super) struct Live<'a> {
    pub(super) run: &'a Rendezvous,
    pub(super) round: usize,
    pub(super) began: Instant,
    pub(super) last_fault: Instant,
    pub(super) ticks: Ticks<'a>,
    /// The hosts of the team, if there are several.
    hosts: Option<&'a mut Hosts>,
    /// Stopped nodes to continue, and when.
    stopped: Vec<(Instant, Victim)>,
    crash_loops: Vec<CrashLoop>,
    recovering: Vec<Recovering>,
    outages: Vec<Outage>,
}

struct CrashLoop {
    hit: usize,
    target: Target,
    /// Starts of the role at the last kill.
    starts: u64,
    left: u32,
}

pub(super) struct Recovering {
    pub(super) hit: usize,
    pub(super) target: Target,
    pub(super) killed: Instant,
    pub(super) starts: u64,
    /// Newest tick with a message of the target when its successor was there.
    pub(super) heard_before: Option<u64>,
}

/// A host that is cut off or down, and until when.
struct Outage {
    hit: usize,
    host: usize,
    is_down: bool,
    until: Instant,
}

/// A process that a fault hits.
enum Victim {
    /// It holds a role of the run on this host.
    Local(Process),
    /// A robot that was started here on another host.
    Remote(Pid),
}

impl Victim {
    fn signal(&self, signal: Signal) -> bool {
        match self {
            Self::Local(process) => process.signal(signal).is_ok(),
            Self::Remote(pid) => kill_process(*pid, signal).is_ok(),
        }
    }
}

impl<'a> Live<'a> {
    pub(super) fn new(
        run: &'a Rendezvous,
        round: usize,
        recovering: Option<Recovering>,
        hosts: Option<&'a mut Hosts>,
    ) -> Self {
        let now = Instant::now();
        Self {
            run,
            round,
            began: now,
            last_fault: now,
            ticks: Ticks::of(run),
            hosts,
            stopped: Vec::new(),
            crash_loops: Vec::new(),
            recovering: recovering.into_iter().collect(),
            outages: Vec::new(),
        }
    }

    /// Injects a fault into those of its targets that are there. False if none is there, so that it is tried again.
    pub(super) fn inject(&mut self, fault: u64, what: &PlannedFault, injected: &mut Vec<Injected>) -> bool {
        let mut is_done = false;
        let everything = [Target::Node(Role::Supervisor)];
        let targets = if what.kind == Kind::TotalOutage { &everything[..] } else { &what.targets };
        for target in targets {
            let Some(target) = self.present(*target) else { continue };
            let hit = injected.len();
            let is_hit = match (what.kind, target) {
                (Kind::Stop, _) => self.stop(target, what.lasts),
                (Kind::Kill | Kind::Several | Kind::CrashLoop, _) => self.kill(target, hit),
                // The caller does this, without the run.
                (Kind::TotalOutage, _) => true,
                (Kind::Cut | Kind::OneWay | Kind::Reboot, Target::Host(host)) => self.cut_off(host, what, hit),
                (Kind::Cut | Kind::OneWay | Kind::Reboot, _) => false,
            };
            if !is_hit {
                continue;
            }
            is_done = true;
            if what.kind == Kind::CrashLoop {
                let starts = self.recovering.last().map_or(0, |last| last.starts);
                self.crash_loops.push(CrashLoop { hit, target, starts, left: what.kills - 1 });
            }
            let (at_s, tick) = (self.began.elapsed().as_secs_f64(), self.ticks.newest);
            let round = self.round;
            let lasts_s = (what.kind == Kind::Stop || what.kind.is_of_hosts()).then_some(what.lasts.as_secs_f64());
            injected.push(Injected {
                fault,
                round,
                at_s,
                tick,
                kind: what.kind,
                target,
                lasts_s,
                restart_ms: None,
                recovery_ms: None,
            });
        }
        if is_done {
            self.last_fault = Instant::now();
        }
        is_done
    }

    /// The actual target: standbys are numbered by the numbers that are free when they start.
    fn present(&self, target: Target) -> Option<Target> {
        let Target::Node(Role::Standby(number)) = target else { return Some(target) };
        let numbers = (number..=STANDBYS_MAX).chain(1..number);
        let mut roles = numbers.map(Role::Standby);
        roles.find(|role| self.run.roster().is_held(*role)).map(Target::Node)
    }

    fn victim(&self, target: Target) -> Option<Victim> {
        match (target, &self.hosts) {
            (Target::Node(Role::Robot(robot)), Some(hosts)) if hosts.host_of(robot) != RUN_HOST => {
                hosts.process(robot).map(Victim::Remote)
            }
            (Target::Node(role), _) => process_in(self.run, role).ok().map(Victim::Local),
            (Target::Host(_), _) => None,
        }
    }

    /// Stops a node for a while: the process may have lost its role when it continues.
    fn stop(&mut self, target: Target, lasts: Duration) -> bool {
        let Some(victim) = self.victim(target) else { return false };
        let is_stopped = victim.signal(Signal::STOP);
        self.stopped.push((Instant::now() + lasts, victim));
        is_stopped
    }

    /// Kills a node, for the hit of this number. An earlier hit from which it has not recovered no longer counts.
    fn kill(&mut self, target: Target, hit: usize) -> bool {
        let starts = self.starts(target);
        if !self.victim(target).is_some_and(|victim| victim.signal(Signal::KILL)) {
            return false;
        }
        self.recovering.retain(|earlier| earlier.target != target);
        self.recovering.push(Recovering { hit, target, killed: Instant::now(), starts, heard_before: None });
        true
    }

    /// How often the target has been started.
    fn starts(&self, target: Target) -> u64 {
        match target {
            Target::Node(role) => self.run.roster().starts(role),
            Target::Host(_) => 0,
        }
    }

    /// Cuts a host off, or switches it off.
    fn cut_off(&mut self, host: usize, what: &PlannedFault, hit: usize) -> bool {
        let Some(hosts) = self.hosts.as_deref_mut() else { return false };
        if self.outages.iter().any(|outage| outage.host == host) {
            return false;
        }
        let is_down = what.kind == Kind::Reboot;
        match what.kind {
            Kind::Reboot => {
                self.stopped.retain(|(_, victim)| !matches!(victim, Victim::Remote(pid) if hosts.is_on(host, *pid)));
                hosts.switch_off(host);
            }
            Kind::OneWay => hosts.cut(host, what.is_up, !what.is_up),
            _ => hosts.cut(host, true, true),
        }
        self.recovering.retain(|earlier| earlier.target != Target::Host(host));
        self.outages.push(Outage { hit, host, is_down, until: Instant::now() + what.lasts });
        true
    }

    /// Completes the due parts of earlier faults, and records recoveries.
    ///
    /// # Errors
    /// If a robot or a host cannot be started again.
    pub(super) fn update(&mut self, injected: &mut [Injected]) -> anyhow::Result<()> {
        let now = Instant::now();
        self.ticks.update();
        self.stopped.retain(|(due, victim)| {
            let is_due = now >= *due;
            if is_due {
                victim.signal(Signal::CONT);
            }
            !is_due
        });
        if let Some(hosts) = self.hosts.as_deref_mut() {
            hosts.look()?;
        }
        for outage in self.outages.extract_if(.., |outage| now >= outage.until).collect::<Vec<_>>() {
            self.end_outage(&outage)?;
        }
        for mut crash_loop in std::mem::take(&mut self.crash_loops) {
            let successor = self.starts(crash_loop.target);
            if successor > crash_loop.starts && self.kill(crash_loop.target, crash_loop.hit) {
                (crash_loop.starts, crash_loop.left) = (successor, crash_loop.left - 1);
                self.last_fault = now;
            }
            if crash_loop.left > 0 {
                self.crash_loops.push(crash_loop);
            }
        }
        for mut node in std::mem::take(&mut self.recovering) {
            let heard = self.ticks.heard(node.target, self.hosts.as_deref());
            match node.heard_before {
                None if self.starts(node.target) > node.starts => {
                    node.heard_before = Some(heard);
                    injected[node.hit].restart_ms = Some(1e3 * node.killed.elapsed().as_secs_f64());
                }
                Some(before) if heard > before => {
                    injected[node.hit].recovery_ms = Some(1e3 * node.killed.elapsed().as_secs_f64());
                    continue;
                }
                _ => {}
            }
            self.recovering.push(node);
        }
        Ok(())
    }

    fn end_outage(&mut self, outage: &Outage) -> anyhow::Result<()> {
        let Outage { hit, host, is_down, .. } = *outage;
        let hosts = self.hosts.as_deref_mut().ok_or_else(|| anyhow!("no hosts"))?;
        if is_down {
            hosts.switch_on(host)?;
        }
        hosts.cut(host, false, false);
        let (target, killed) = (Target::Host(host), Instant::now());
        let heard_before = Some(self.ticks.heard(target, self.hosts.as_deref()));
        self.recovering.push(Recovering { hit, target, killed, starts: 0, heard_before });
        self.last_fault = killed;
        Ok(())
    }

    /// Ends all faults that last.
    ///
    /// # Errors
    /// If a host cannot be started again.
    pub(super) fn continue_all(&mut self) -> anyhow::Result<()> {
        for (_, victim) in self.stopped.drain(..) {
            victim.signal(Signal::CONT);
        }
        std::mem::take(&mut self.outages).iter().try_for_each(|outage| self.end_outage(outage))
    }
}
