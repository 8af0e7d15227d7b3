//! A run while faults are injected.

use std::time::{Duration, Instant};

use rangehound_fusion::standby::STANDBYS_MAX;
use rangehound_node::rendezvous::{Process, Rendezvous, Role};
use rustix::process::Signal;

use super::faults::{Kind, PlannedFault};
use super::outcome::Injected;
use super::ticks::Ticks;
use crate::run::remote::{process_in, signal};

/// A run while faults are injected.
pub(super) struct Live<'a> {
    pub(super) run: &'a Rendezvous,
    pub(super) round: usize,
    pub(super) began: Instant,
    pub(super) last_fault: Instant,
    pub(super) ticks: Ticks<'a>,
    /// Stopped nodes to continue, and when.
    pub(super) stopped: Vec<(Instant, Process)>,
    pub(super) crash_loops: Vec<CrashLoop>,
    pub(super) recovering: Vec<Recovering>,
}

pub(super) struct CrashLoop {
    pub(super) hit: usize,
    pub(super) role: Role,
    /// Starts of the role at the last kill.
    pub(super) starts: u64,
    pub(super) left: u32,
}

pub(super) struct Recovering {
    pub(super) hit: usize,
    pub(super) role: Role,
    pub(super) killed: Instant,
    pub(super) starts: u64,
    /// Newest tick with a message of the role when its successor was there.
    pub(super) heard_before: Option<u64>,
}

impl<'a> Live<'a> {
    pub(super) fn new(run: &'a Rendezvous, round: usize, recovering: Option<Recovering>) -> Self {
        let now = Instant::now();
        let (stopped, crash_loops, recovering) = (Vec::new(), Vec::new(), recovering.into_iter().collect());
        Self { run, round, began: now, last_fault: now, ticks: Ticks::of(run), stopped, crash_loops, recovering }
    }

    /// Injects a fault into those of its nodes that are there. False if none is there, so that it is tried again.
    pub(super) fn inject(&mut self, fault: u64, what: &PlannedFault, injected: &mut Vec<Injected>) -> bool {
        let mut is_done = false;
        let everything = [Role::Supervisor];
        let roles = if what.kind == Kind::TotalOutage { &everything[..] } else { &what.roles };
        for role in roles {
            let Some(role) = self.present(*role) else { continue };
            let hit = injected.len();
            let is_hit = match what.kind {
                Kind::Stop => self.stop(role, what.stop),
                Kind::Kill | Kind::Several | Kind::CrashLoop => self.kill(role, hit),
                // The caller does this, without the run.
                Kind::TotalOutage => true,
            };
            if !is_hit {
                continue;
            }
            is_done = true;
            match what.kind {
                Kind::CrashLoop => {
                    let starts = self.recovering.last().map_or(0, |last| last.starts);
                    self.crash_loops.push(CrashLoop { hit, role, starts, left: what.kills - 1 });
                }
                Kind::Kill | Kind::Stop | Kind::Several | Kind::TotalOutage => {}
            }
            let (at_s, tick) = (self.began.elapsed().as_secs_f64(), self.ticks.newest);
            let round = self.round;
            injected.push(Injected {
                fault,
                round,
                at_s,
                tick,
                kind: what.kind,
                role,
                restart_ms: None,
                recovery_ms: None,
            });
        }
        if is_done {
            self.last_fault = Instant::now();
        }
        is_done
    }

    /// The actual role: standbys are numbered by the numbers that are free when they start.
    pub(super) fn present(&self, role: Role) -> Option<Role> {
        let Role::Standby(number) = role else { return Some(role) };
        let numbers = (number..=STANDBYS_MAX).chain(1..number);
        let mut roles = numbers.map(Role::Standby);
        roles.find(|role| self.run.roster().is_held(*role))
    }

    /// Stops a node for a while: the process may have lost its role when it continues.
    pub(super) fn stop(&mut self, role: Role, duration: Duration) -> bool {
        let Ok(process) = process_in(self.run, role) else { return false };
        let is_stopped = process.signal(Signal::STOP).is_ok();
        self.stopped.push((Instant::now() + duration, process));
        is_stopped
    }

    /// Kills a node, for the hit of this number. An earlier hit from which it has not recovered no longer counts.
    pub(super) fn kill(&mut self, role: Role, hit: usize) -> bool {
        let starts = self.run.roster().starts(role);
        if signal(self.run, role, Signal::KILL).is_err() {
            return false;
        }
        self.recovering.retain(|earlier| earlier.role != role);
        self.recovering.push(Recovering { hit, role, killed: Instant::now(), starts, heard_before: None });
        true
    }

    /// Completes the due parts of earlier faults, and records recoveries.
    pub(super) fn update(&mut self, injected: &mut [Injected]) {
        let now = Instant::now();
        self.ticks.update();
        let run = self.run;
        self.stopped.retain(|(due, process)| {
            let is_due = now >= *due;
            if is_due {
                let _ = process.signal(Signal::CONT);
            }
            !is_due
        });
        for mut crash_loop in std::mem::take(&mut self.crash_loops) {
            let successor = run.roster().starts(crash_loop.role);
            if successor > crash_loop.starts && self.kill(crash_loop.role, crash_loop.hit) {
                (crash_loop.starts, crash_loop.left) = (successor, crash_loop.left - 1);
                self.last_fault = now;
            }
            if crash_loop.left > 0 {
                self.crash_loops.push(crash_loop);
            }
        }
        let ticks = &self.ticks;
        self.recovering.retain_mut(|node| {
            let heard = ticks.heard(node.role);
            match node.heard_before {
                None if run.roster().starts(node.role) > node.starts => {
                    node.heard_before = Some(heard);
                    injected[node.hit].restart_ms = Some(1e3 * node.killed.elapsed().as_secs_f64());
                }
                Some(before) if heard > before => {
                    injected[node.hit].recovery_ms = Some(1e3 * node.killed.elapsed().as_secs_f64());
                    return false;
                }
                _ => {}
            }
            true
        });
    }

    pub(super) fn continue_all(&mut self) {
        for (_, process) in self.stopped.drain(..) {
            let _ = process.signal(Signal::CONT);
        }
    }
}
