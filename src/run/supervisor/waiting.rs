//! Robots that others start and without which a run does not go on: the user is told which ones.

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use rangehound_node::rendezvous::{Rendezvous, Role};

use super::{Gateway, Supervision};
use crate::failure;
use crate::run::status::names_of_robots;
use crate::run::watch::Newest;

/// A run without a new tick for this long waits for something; and the interval between two looks.
const WAITS: Duration = Duration::from_secs(1);

/// What a run waits for, some of whose robots others start.
pub(super) struct Waiting<'a> {
    rendezvous: &'a Rendezvous,
    /// The robots that join through the gateway, and where it listens.
    remote: Vec<usize>,
    listen: Option<SocketAddr>,
    /// The robots whose processes the user starts on this host.
    external: Vec<usize>,
    newest: Newest,
    since: Instant,
    reported: Vec<usize>,
}

impl<'a> Waiting<'a> {
    pub(super) fn new(rendezvous: &'a Rendezvous, supervision: &Supervision, gateway: Option<&Gateway>) -> Self {
        let robots = 0..rendezvous.description().scenario.robots.len();
        let left = robots.filter(|robot| supervision.leaves_to_others(*robot));
        let (remote, external) = left.partition(|robot| supervision.is_remote(*robot));
        Self {
            rendezvous,
            remote,
            listen: gateway.map(|gateway| gateway.listen),
            external,
            newest: Newest { fusion: None, sim: None },
            since: Instant::now(),
            reported: Vec::new(),
        }
    }

    /// Reports the robots that are not there while no tick ends, once for each set of them.
    pub(super) fn look(&mut self, newest: Newest) {
        if newest != self.newest {
            self.newest = newest;
            self.since = Instant::now();
            self.reported.clear();
        }
        let ticks = Duration::from_secs_f64(2.0 * self.rendezvous.description().scenario.dt_s);
        if self.remote.is_empty() && self.external.is_empty() || self.since.elapsed() < WAITS.max(ticks) {
            return;
        }
        let is_missing = |robot: &usize| !self.rendezvous.roster().is_held(Role::Robot(*robot));
        let missing: Vec<usize> = self.remote.iter().chain(&self.external).copied().filter(is_missing).collect();
        if missing != self.reported {
            let (remote, external): (Vec<usize>, Vec<usize>) = missing.iter().partition(|id| self.remote.contains(id));
            let name = self.rendezvous.name();
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
