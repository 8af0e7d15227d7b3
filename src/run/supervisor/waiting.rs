//! Robots on other hosts without which a run does not go on: the user is told which ones.

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use rangehound_node::rendezvous::{Rendezvous, Role};

use super::{Gateway, Supervision};
use crate::failure;
use crate::run::status::names_of_robots;
use crate::run::watch::Newest;

/// A run without a new tick for this long waits for something; and the interval between two looks.
const WAITS: Duration = Duration::from_secs(1);

/// What a run with robots on other hosts waits for.
pub(super) struct Waiting<'a> {
    rendezvous: &'a Rendezvous,
    /// The robots that join through the gateway, and where it listens.
    remote: Vec<usize>,
    listen: Option<SocketAddr>,
    newest: Newest,
    since: Instant,
    reported: Vec<usize>,
}

impl<'a> Waiting<'a> {
    pub(super) fn new(rendezvous: &'a Rendezvous, supervision: &Supervision, gateway: Option<&Gateway>) -> Self {
        let robots = rendezvous.description().scenario.robots.len();
        Self {
            rendezvous,
            remote: (0..robots).filter(|robot| supervision.is_remote(*robot)).collect(),
            listen: gateway.map(|gateway| gateway.listen),
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
        let Some(listen) = self.listen else { return };
        let ticks = Duration::from_secs_f64(2.0 * self.rendezvous.description().scenario.dt_s);
        if self.since.elapsed() < WAITS.max(ticks) {
            return;
        }
        let is_missing = |robot: &usize| !self.rendezvous.roster().is_held(Role::Robot(*robot));
        let missing: Vec<usize> = self.remote.iter().copied().filter(is_missing).collect();
        if let Some(first) = missing.first()
            && missing != self.reported
        {
            let host = if listen.ip().is_unspecified() { "HOST".to_owned() } else { listen.ip().to_string() };
            let host = if listen.is_ipv6() && host != "HOST" { format!("[{host}]") } else { host };
            failure::print_stderr(format!(
                "run {} waits for {} from other hosts: `rangehound robot --id {first} --connect {host}:{}`",
                self.rendezvous.name(),
                names_of_robots(missing.iter().copied()),
                listen.port()
            ));
        }
        self.reported = missing;
        // A look costs an open file for each robot.
        self.since = Instant::now();
    }
}
