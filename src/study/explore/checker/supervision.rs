//! The supervisor's actions on nodes.

use std::ops::Range;

use crate::run::supervisor::deaths::End;
use crate::study::explore::faults::FaultKind;
use crate::study::explore::lead::Lead;
use crate::study::explore::node::{Node, Process};
use crate::study::explore::plan::Plan;

/// Silence that is not a hang, ns: the time-out, or that of a deposed fusion, less the first look.
const SILENCE_MIN_NS: u64 = 1_900_000_000;

/// SupervisorLooks within which a hung process must be killed; one that has not started has one more for each node.
const LOOKS_MAX: u64 = 32;

/// A process that has taken part for this long has sent heartbeats, ns.
const HEARTBEATS_NS: u64 = 500_000_000;

/// Before a process is killed as hung, others must have sent heartbeats in at least this many looks.
const OTHERS_HEARD_MIN: u64 = 5;

/// Time that each node adds to the time that a node may take to start, ns.
const START_NS: u64 = 100_000_000;

/// A process that has run for this long is started again at once, ns.
const SETTLED_NS: u64 = 1_000_000_000;

/// Longest wait before a start, ns: at once, after kills only, and in any case.
const WAIT_AT_ONCE_NS: u64 = 1_000_000;
const WAIT_AFTER_KILLS_NS: u64 = 11_000_000;
const WAIT_MAX_NS: u64 = 1_001_000_000;

/// A node that fails this often in a row is given up.
const FAILURES_MAX: u32 = 5;

/// The supervisor's observations and actions.
#[derive(Debug)]
pub(in crate::study::explore) struct Supervision {
    is_endless: bool,
    leaves_robots: bool,
    robots: Range<usize>,
    /// True if it is stopped at times: then it may be late.
    is_stopped_at_times: bool,
    /// Nodes of which every process fails.
    broken: Vec<usize>,
    nodes: Vec<Record>,
}

#[derive(Debug, Clone, Copy, Default)]
struct Record {
    own_failures: u32,
    started_ns: u64,
    /// It had not ended before, or had run for long.
    is_settled: bool,
    has_ended: bool,
    /// When the end of its last process was noticed, or its start refused.
    down_since_ns: u64,
    /// The life of the process that was seen to lead.
    led: Option<u32>,
    /// Its newest heartbeat, and the looks since then in which others sent heartbeats.
    silent: (Option<u64>, u64),
    /// Since when it hangs, whether it was deposed, and the looks in which it hung while others did not.
    hung: (u64, bool, u64),
}

impl Supervision {
    pub(in crate::study::explore) fn new(plan: &Plan) -> Self {
        let is_stop = |kind: &FaultKind| matches!(kind, FaultKind::StopAll { .. } | FaultKind::StopSupervisor { .. });
        let kinds = || plan.faults.iter().map(|fault| fault.kind);
        Self {
            is_endless: plan.is_endless,
            leaves_robots: plan.leaves_robots,
            robots: plan.robot_nodes(),
            is_stopped_at_times: kinds().any(|kind| is_stop(&kind)),
            broken: kinds()
                .filter_map(|kind| if let FaultKind::Break { node, .. } = kind { Some(node) } else { None })
                .collect(),
            nodes: vec![Record::default(); plan.all_nodes().len()],
        }
    }

    /// The supervisor checks heartbeats: no process may hang that it should have killed.
    pub(in crate::study::explore) fn looks(
        &mut self,
        nodes: &[Node],
        lead: &Lead,
        now_ns: u64,
    ) -> Result<(), (usize, String)> {
        let heartbeats = nodes.iter().enumerate().map(|(index, node)| {
            let leads = lead.last == Some((index, node.life));
            if leads { lead.heartbeat() } else { node.heartbeat_ns }
        });
        let mut has_any_heartbeat = false;
        for (record, heartbeat) in self.nodes.iter_mut().zip(heartbeats) {
            let is_new = record.silent.0 != heartbeat;
            has_any_heartbeat |= is_new && heartbeat.is_some();
            record.silent = (heartbeat, if is_new { 0 } else { record.silent.1 });
        }
        self.nodes.iter_mut().for_each(|record| record.silent.1 += u64::from(has_any_heartbeat));
        let well = nodes.iter().filter(|node| node.well_for_ns(now_ns) > HEARTBEATS_NS).count();
        for (index, node) in nodes.iter().enumerate() {
            let leads = lead.last == Some((index, node.life));
            let record = &mut self.nodes[index];
            if leads {
                record.led = Some(node.life);
            }
            let is_deposed = record.led == Some(node.life) && !leads;
            let is_starting = matches!(node.process, Process::Starting);
            let hangs = node.is_stopped || is_starting;
            let (since_ns, was_deposed, looks) = record.hung;
            let goes_on = hangs && (since_ns, was_deposed) == (node.state_since_ns, is_deposed);
            let looks = if goes_on { looks } else { 0 } + u64::from(hangs && well > 0);
            record.hung = (node.state_since_ns, is_deposed, looks);
            let looks_max = LOOKS_MAX + if is_starting { nodes.len() as u64 } else { 0 };
            let may_hang = self.leaves_robots && self.robots.contains(&index) || self.is_endless && !is_deposed;
            if looks > looks_max && !may_hang {
                return Err((index, "it hangs, and is not killed".to_owned()));
            }
        }
        Ok(())
    }

    /// The supervisor kills a node as hung.
    pub(in crate::study::explore) fn kills(
        &self,
        nodes: &[Node],
        lead: &Lead,
        index: usize,
        now_ns: u64,
    ) -> Result<(), String> {
        let node = &nodes[index];
        if matches!(node.process, Process::None) {
            return Ok(());
        }
        let leads = lead.last == Some((index, node.life));
        let is_deposed = self.nodes[index].led == Some(node.life) && !leads;
        let heartbeat_ns = if leads { lead.heartbeat() } else { node.heartbeat_ns };
        let is_starting = matches!(node.process, Process::Starting);
        let silence_min_ns = SILENCE_MIN_NS + if is_starting { nodes.len() as u64 * START_NS } else { 0 };
        if node.well_for_ns(now_ns) > HEARTBEATS_NS {
            Err("it was killed as hung, but sends heartbeats".to_owned())
        } else if now_ns - heartbeat_ns.unwrap_or(node.state_since_ns) < silence_min_ns {
            Err("it was killed as hung before its time".to_owned())
        } else if self.nodes[index].silent.1 < OTHERS_HEARD_MIN {
            Err("it was killed as hung, though no other node sent heartbeats".to_owned())
        } else if self.is_endless && !is_deposed {
            Err("it was killed as hung, though there is no time-out".to_owned())
        } else if self.leaves_robots && self.robots.contains(&index) {
            Err("it was killed as hung, though it is not started again".to_owned())
        } else {
            Ok(())
        }
    }

    /// The supervisor notices that a node's process has ended.
    pub(in crate::study::explore) fn ends(&mut self, node: usize, end: End, now_ns: u64) {
        let record = &mut self.nodes[node];
        record.own_failures += u32::from(end != End::Killed);
        record.down_since_ns = now_ns;
        let had_ended = std::mem::replace(&mut record.has_ended, true);
        record.is_settled = !had_ended || now_ns - record.started_ns > SETTLED_NS;
    }

    /// The system refuses to start a process.
    pub(in crate::study::explore) fn refused(&mut self, node: usize, now_ns: u64) {
        self.ends(node, End::Failed, now_ns);
        self.nodes[node].is_settled = false;
    }

    /// The supervisor starts a node again.
    pub(in crate::study::explore) fn starts(&mut self, nodes: &[Node], node: usize, now_ns: u64) -> Result<(), String> {
        if !matches!(nodes[node].process, Process::None) {
            return Err("it was started twice".to_owned());
        }
        let Record { own_failures, is_settled, down_since_ns, .. } = self.nodes[node];
        self.nodes[node].started_ns = now_ns;
        let longest_ns = match own_failures {
            _ if is_settled => WAIT_AT_ONCE_NS,
            0 => WAIT_AFTER_KILLS_NS,
            _ => WAIT_MAX_NS,
        };
        if !self.is_stopped_at_times && now_ns - down_since_ns > longest_ns {
            return Err("it was not started again in time".to_owned());
        }
        Ok(())
    }

    /// The supervisor lets the others go on without a node.
    pub(in crate::study::explore) fn loses(&self, node: usize) -> Result<(), String> {
        let may_leave = self.leaves_robots && self.robots.contains(&node);
        let is_hopeless = self.broken.contains(&node) && self.nodes[node].own_failures >= FAILURES_MAX;
        if may_leave || is_hopeless { Ok(()) } else { Err("it was not started again".to_owned()) }
    }

    /// The supervisor ends the run because of a node: it must not if another node can take its place.
    pub(in crate::study::explore) fn gives_up(&self, nodes: &[Node], node: usize) -> Result<(), String> {
        let is_hopeless = self.broken.contains(&node) && self.nodes[node].own_failures >= FAILURES_MAX;
        let can_lead = 1..self.robots.start;
        let is_spare = can_lead.contains(&node)
            && can_lead.into_iter().any(|other| other != node && !matches!(nodes[other].process, Process::None));
        if is_hopeless && !is_spare { Ok(()) } else { Err("the run was ended for it".to_owned()) }
    }
}
