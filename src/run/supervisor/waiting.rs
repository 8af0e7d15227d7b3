//! Nodes that others start and without which a run does not go on: the supervisor reports which ones.

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use rangehound_node::rendezvous::{Rendezvous, Role};

use super::{Gateway, Supervision};
use crate::failure;
use crate::run::status::names_of_robots;
use crate::run::watch::Newest;

/// A run without a new tick for this long waits for something; and the interval between two looks.
const WAITS: Duration = Duration::from_secs(1);

/// The nodes that a run waits for, if others start some of them.
pub(super) struct Waiting<'a> {
    rendezvous: &'a Rendezvous,
    /// The robots that join through the gateway, and where it listens.
    remote: Vec<usize>,
    listen: Option<SocketAddr>,
    /// The robots whose processes the user starts on this host, and whether fusion is one of these too.
    external: Vec<usize>,
    leaves_fusion: bool,
    newest: Newest,
    since: Instant,
    reported: Vec<Role>,
}

impl<'a> Waiting<'a> {
    pub(super) fn new(rendezvous: &'a Rendezvous, supervision: &Supervision, gateway: Option<&Gateway>) -> Self {
        let robots = 0..rendezvous.description().scenario.robots.len();
        let left = robots.filter(|robot| supervision.leaves_to_others(Role::Robot(*robot)));
        let (remote, external) = left.partition(|robot| supervision.is_remote(*robot));
        Self {
            rendezvous,
            remote,
            listen: gateway.map(|gateway| gateway.listen),
            external,
            leaves_fusion: supervision.leaves_to_others(Role::Fusion),
            newest: Newest { fusion: None, sim: None },
            since: Instant::now(),
            reported: Vec::new(),
        }
    }

    /// Reports the nodes that are not there while no tick ends, once for each set of them.
    pub(super) fn look(&mut self, newest: Newest) {
        if newest != self.newest {
            self.newest = newest;
            self.since = Instant::now();
            self.reported.clear();
        }
        let ticks = Duration::from_secs_f64(2.0 * self.rendezvous.description().scenario.dt_s);
        let leaves_none = self.remote.is_empty() && self.external.is_empty() && !self.leaves_fusion;
        if leaves_none || self.since.elapsed() < WAITS.max(ticks) {
            return;
        }
        let robots = self.remote.iter().chain(&self.external).map(|robot| Role::Robot(*robot));
        let all = robots.chain(Some(Role::Fusion).filter(|_| self.leaves_fusion));
        let missing: Vec<Role> = all.filter(|role| !self.rendezvous.roster().is_held(*role)).collect();
        if missing != self.reported {
            let robots = missing.iter().filter_map(|role| role.robot());
            let (remote, external): (Vec<usize>, Vec<usize>) = robots.partition(|id| self.remote.contains(id));
            let name = self.rendezvous.name();
            if missing.contains(&Role::Fusion) {
                failure::print_stderr(format!(
                    "run {name} waits for fusion (--external): one of yours, or `rangehound fusion --name {name}`"
                ));
            }
            if let (Some(first), Some(listen)) = (remote.first(), self.listen) {
                let host = if listen.ip().is_unspecified() { "HOST".to_owned() } else { listen.ip().to_string() };
                let host = if listen.is_ipv6() && host != "HOST" { format!("[{host}]") } else { host };
                failure::print_stderr(format!(
                    "run {name} waits for {} from other hosts: `rangehound robot --id {first} --connect {host}:{}`",
                    names_of_robots(remote.iter().copied()),
                    listen.port()
                ));
            }
            if let Some(first) = external.first() {
                failure::print_stderr(format!(
                    "run {name} waits for {} (--external): a driver of yours, or `rangehound robot --id {first} --name {name}`",
                    names_of_robots(external.iter().copied()),
                ));
            }
        }
        self.reported = missing;
        // A look costs an open file for each robot.
        self.since = Instant::now();
    }
}
