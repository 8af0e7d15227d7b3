//! `run`, `resume` and `track`: starts the nodes of a run, watches them, ends them, and reports.

mod cleaner;
pub(crate) mod deaths;
mod losses;
pub(crate) mod machine;
mod nodes;
mod removal;
pub mod restart;
mod sidecars;
pub(crate) mod silence;
mod waiting;

use std::collections::BTreeSet;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use anyhow::anyhow;
use rangehound_node::rendezvous::{Rendezvous, Role};
use rangehound_node::system::signal::Termination;
use rangehound_shared::run_name::RunName;
use rangehound_shared::scenario::Scenario;
use serde::{Deserialize, Serialize};

use crate::failure::Failure;
use crate::files::out_folder::{self, Claim};
use crate::results::made::{self, Keep};
use crate::run::experiment::{Experiment, name_of};
use crate::run::external::External;
use crate::run::folder;
use crate::run::gateway;
use crate::run::in_process::{self, TeamError};
use crate::run::node::input_or_running;
use crate::run::pin::Pin;
use crate::run::port;
use crate::run::recorder::{self, Out};
use crate::run::watch::Progress;
use removal::run_to_the_end;
use restart::Rule;

/// The processes that are started beside the nodes of a run, and the policy for nodes that end.
#[derive(Debug, Clone, Default)]
pub struct Supervision {
    /// Number of standbys of fusion.
    pub standbys: usize,
    /// Which nodes are started again.
    pub rules: Vec<Rule>,
    /// Processors for all processes of the run.
    pub pin: Pin,
    /// The live page: `None` without one, `Some(None)` at any free port, else at this port.
    pub live: Option<Option<u16>>,
    /// Largest size of the recording, MB; `None` without a recording.
    pub record_limit_mb: Option<u64>,
    /// Robots on other hosts.
    pub hosts: Option<Hosts>,
    /// Nodes of this host whose processes others start; kept in the run folder, for `resume`.
    pub external: Option<External>,
}

/// The gateway for robots on other hosts; kept in the run folder, for `resume`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Hosts {
    /// Where it listens.
    pub listen: SocketAddr,
    /// Folder with the keys of this host.
    pub keys: Option<PathBuf>,
    /// The robots that join through it; `None` for all.
    pub remote: Option<BTreeSet<usize>>,
}

impl Hosts {
    /// These values where they are given, and those of the run before otherwise.
    fn or(self, before: Option<Self>) -> Self {
        let Some(before) = before else { return self };
        Self { listen: self.listen, keys: self.keys.or(before.keys), remote: self.remote.or(before.remote) }
    }
}

/// The program of the gateway, and its arguments.
#[derive(Debug, Clone)]
struct Gateway {
    program: PathBuf,
    listen: SocketAddr,
    keys: Option<PathBuf>,
}

impl Supervision {
    /// True if a robot joins from another host.
    fn is_remote(&self, robot: usize) -> bool {
        let remote = self.hosts.as_ref().map(|hosts| hosts.remote.as_ref());
        remote.is_some_and(|remote| remote.is_none_or(|remote| remote.contains(&robot)))
    }

    /// True if others start the process of a role: on this host, or on another one.
    fn leaves_to_others(&self, role: Role) -> bool {
        let is_remote = role.robot().is_some_and(|robot| self.is_remote(robot));
        is_remote || self.external.as_ref().is_some_and(|external| external.has(role))
    }

    /// The gateway for robots on other hosts. Robots that the run does not have and a gateway that could not start are
    /// refused before anything is made.
    fn gateway(&self, scenario: &Scenario) -> Result<Option<Gateway>, Failure> {
        let last = scenario.robots.len() - 1;
        let remote = self.hosts.as_ref().and_then(|hosts| hosts.remote.as_ref()?.last().copied());
        let external = self.external.as_ref().and_then(|external| external.robots.last().copied());
        for (flag, id) in [("--remote", remote), ("--external", external)] {
            if let Some(id) = id.filter(|id| *id > last) {
                return Err(Failure::input(format!("robot {id} ({flag}) is not in this run: expected 0 to {last}")));
            }
        }
        let is_simulated = |id: &usize| !self.leaves_to_others(Role::Robot(*id));
        if scenario.has_real_target
            && let Some(id) = (0..=last).find(is_simulated)
        {
            return Err(Failure::input(format!(
                "robot {id} would be simulated, and cannot measure the real target (target.real): start all robots yourself \
                 (--external 0-{last}), or on other hosts (--listen)"
            )));
        }
        let Some(hosts) = &self.hosts else { return Ok(None) };
        let listen = gateway::check(hosts.listen, hosts.keys.as_deref())?;
        Ok(Some(Gateway { program: gateway::program()?, listen, keys: hosts.keys.clone() }))
    }

    /// The copy of them in the run folder: with the port at which the gateway listens, and keys that are found from any folder.
    fn hosts_at(&self, gateway: Option<&Gateway>) -> Option<Hosts> {
        let (hosts, gateway) = (self.hosts.clone()?, gateway?);
        let keys = hosts.keys.map(|keys| std::path::absolute(&keys).unwrap_or(keys));
        Some(Hosts { listen: gateway.listen, keys, ..hosts })
    }
}

/// Continues a run that has no processes any more.
///
/// # Errors
/// [`Failure`].
pub fn resume(folder: &Path, name: Option<&RunName>, supervision: &Supervision, keep: &Keep) -> Result<(), Failure> {
    let description = folder::read_description(folder)?;
    folder::look_for_states(&description)?;
    let name = match name {
        Some(name) => name.clone(),
        None => name_of(&description.scenario)?,
    };
    // Robots that were on other hosts wait there, at the address where they had a link.
    let hosts_before = folder::read_hosts(folder)?;
    let hosts = match supervision.hosts.clone() {
        Some(given) => Some(given.or(hosts_before.clone())),
        None => hosts_before.clone(),
    };
    let external_before = folder::read_external(folder)?;
    let external = supervision.external.clone().or_else(|| external_before.clone());
    let supervision = &Supervision { hosts, external, ..supervision.clone() };
    let gateway = supervision.gateway(&description.scenario)?;
    let found = || {
        let created = Rendezvous::create_closed(&name, description.clone()).map_err(input_or_running)?;
        let claim = folder::look_for_writable(&description)?;
        let hosts = supervision.hosts_at(gateway.as_ref());
        if hosts != hosts_before {
            folder::write_hosts(folder, hosts)?;
        }
        if supervision.external != external_before {
            folder::write_external(folder, supervision.external.as_ref())?;
        }
        Ok((created.open().map_err(input_or_running)?, claim))
    };
    supervise(supervision, gateway.as_ref(), keep, found)
}

/// Runs an experiment with a process for each node.
///
/// # Errors
/// [`Failure`].
pub fn run(mut experiment: Experiment, supervision: &Supervision, keep: &Keep) -> Result<(), Failure> {
    let gateway = supervision.gateway(&experiment.description.scenario)?;
    let hosts = supervision.hosts_at(gateway.as_ref());
    // The experiment is moved in, so that its recording is freed once its copy is written.
    supervise(supervision, gateway.as_ref(), keep, move || {
        // Only the process that has the run's name may change the folder, and nodes write to it as soon as they have joined.
        let created = experiment.create()?;
        let claim = folder::prepare_folder(&experiment)?;
        folder::write_hosts(&experiment.description.out_dir, hosts)?;
        folder::write_external(&experiment.description.out_dir, supervision.external.as_ref())?;
        Ok((created.open().map_err(input_or_running)?, claim))
    })
}

/// Runs an experiment in this process, and records it if `record_limit_mb` is given.
///
/// # Errors
/// [`Failure`].
pub fn run_in_process(experiment: &Experiment, record_limit_mb: Option<u64>, keep: &Keep) -> Result<(), Failure> {
    let description = &experiment.description;
    if description.scenario.has_real_target {
        return Err(Failure::input(TeamError::RealTarget));
    }
    let _folder = folder::prepare_folder(experiment)?;
    let mut progress = Progress::new("tick", description.scenario.ticks);
    in_process::run(description, |tick| {
        if tick > 0 && tick % 4_096 == 0 {
            progress.show(tick, "in one process");
        }
    })?;
    progress.finish();
    if let Some(limit_mb) = record_limit_mb {
        recorder::record_logs(description, Out::Default, recorder::bytes(limit_mb), &Termination::listen()?)?;
    }
    let reported = made::report_and_tables(description, keep, Vec::new());
    out_folder::seal(&description.out_dir);
    reported.map(drop)
}

/// Creates a run in its folder, starts its processes, supervises them until the run ends, and writes the report.
fn supervise(
    supervision: &Supervision,
    gateway: Option<&Gateway>,
    keep: &Keep,
    found: impl FnOnce() -> Result<(Rendezvous, Claim), Failure>,
) -> Result<(), Failure> {
    let termination = Termination::listen()?;
    supervision.pin.apply().map_err(Failure::input)?;
    if let Some(Some(port)) = supervision.live {
        port::listen(Some(port))?;
    }
    let (rendezvous, _folder) = found()?;
    let description = &rendezvous.description().clone();
    let (summaries, outcome) = run_to_the_end(rendezvous, supervision, gateway, &termination)?;
    let reported = made::report_and_tables(description, keep, summaries);
    out_folder::seal(&description.out_dir);
    // The reason why the run ended early is reported first.
    outcome?;
    let ticks = reported?.ticks;
    if ticks < description.scenario.ticks {
        return Err(Failure::Running(anyhow!(
            "the logs end at tick {ticks} of {}: see logs/ in the run folder",
            description.scenario.ticks
        )));
    }
    Ok(())
}
