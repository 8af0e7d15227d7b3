//! Acting on a run from another terminal: `status`, `kill`, `restart`, `stop`.

use std::os::fd::OwnedFd;
use std::time::{Duration, Instant, SystemTime};

use anyhow::anyhow;
use rangehound_fusion::run::STANDBYS_MAX;
use rangehound_shared::record::WorldRecord;
use rangehound_shared::rendezvous::{Rendezvous, Role, RunName, living_runs};
use rustix::process::{Pid, PidfdFlags, Signal, pidfd_open, pidfd_send_signal};
use serde::Serialize;

use crate::cli::{RemoteArgs, RemoteNodeArgs, StatusArgs};
use crate::failure::{Failure, print};
use crate::node::input_or_running;
use crate::watch;

/// How long what was asked for may take until it is called failed.
const PATIENCE: Duration = Duration::from_secs(10);

const POLL: Duration = Duration::from_millis(10);

/// Time without a sign of life after which a process that runs is shown as hung.
const HUNG: Duration = Duration::from_secs(1);

/// A run as it is at the moment.
#[derive(Debug, Serialize)]
pub(crate) struct Status {
    name: String,
    scenario: String,
    /// Newest tick that is over, and the run's last.
    tick: u64,
    ticks: u64,
    out_dir: String,
    /// The process that leads as fusion, and how many leads there have been.
    leader: Option<i32>,
    leads: u64,
    /// Processes that stand by to lead.
    standbys: usize,
    nodes: Vec<NodeStatus>,
}

/// A node as it is at the moment.
#[derive(Debug, Serialize)]
struct NodeStatus {
    name: String,
    /// `running`, `stopped` (by a signal), `hung` (gives no sign of life) or `gone`.
    state: &'static str,
    pid: Option<i32>,
    starts: u64,
    /// Since its last sign of life, s; by the wall clock, so that a jump of it shows until the next sign.
    silent_s: Option<f64>,
    /// Resident memory, kB.
    resident_kb: Option<u64>,
}

/// `rangehound status`.
///
/// # Errors
/// [`Failure`].
pub fn status(args: &StatusArgs) -> Result<(), Failure> {
    let run = join(&args.run)?;
    let status = Status::of(&run);
    if args.json { print(serde_json::to_string(&status)? + "\n") } else { print(format!("{status}\n")) }
}

/// `rangehound kill`: SIGKILL, as a crash would end it.
///
/// # Errors
/// [`Failure`].
pub fn kill(args: &RemoteNodeArgs) -> Result<(), Failure> {
    let run = join(&args.run)?;
    let pid = signal(&run, args.node, Signal::KILL)?;
    print(format!("killed {}, process {}\n", args.node, pid.as_raw_pid()))
}

/// `rangehound restart`: asks a node to end and waits for the one that takes its place.
///
/// # Errors
/// [`Failure`].
pub fn restart(args: &RemoteNodeArgs) -> Result<(), Failure> {
    let run = join(&args.run)?;
    if run.roster().holder(Role::Supervisor).is_none() {
        let problem = format!("expected a run with a supervisor, {} was started by hand", run.name());
        return Err(Failure::input(format!("restart: {problem}: kill the node, and start it again")));
    }
    let starts = run.roster().starts(args.node);
    signal(&run, args.node, Signal::TERM)?;
    let began = Instant::now();
    loop {
        if run.roster().starts(args.node) > starts
            && let Some(pid) = run.roster().holder(args.node)
        {
            let starts = run.roster().starts(args.node);
            return print(format!("{} is now process {}, start {starts}\n", args.node, pid.as_raw_pid()));
        }
        if began.elapsed() > PATIENCE {
            let problem = format!("{} has ended, but nobody has started it again", args.node);
            return Err(Failure::Running(anyhow!("{problem}: its run's supervisor is not to")));
        }
        std::thread::sleep(POLL);
    }
}

/// `rangehound stop`: ends a run in order, as Ctrl-C would.
///
/// # Errors
/// [`Failure`].
pub fn stop(args: &RemoteArgs) -> Result<(), Failure> {
    let run = join(args)?;
    let name = run.name().clone();
    let robots = run.description().scenario.robots.len();
    if run.roster().holder(Role::Supervisor).is_some() {
        signal(&run, Role::Supervisor, Signal::TERM)?;
    } else {
        let standbys = (1..=STANDBYS_MAX).map(Role::Standby);
        for role in watch::roles(robots).chain(standbys).filter(|role| run.roster().is_held(*role)) {
            signal(&run, role, Signal::TERM)?;
            // One that is stopped hears it only when it runs; one that has ended by now needs nothing.
            let _ = signal(&run, role, Signal::CONT);
        }
    }
    // Its members leave one by one; this one must not be the last that keeps it.
    drop(run);
    let began = Instant::now();
    while living_runs().contains(&name) {
        if began.elapsed() > PATIENCE {
            return Err(Failure::Running(anyhow!("run {name} has not ended in {PATIENCE:?}")));
        }
        std::thread::sleep(POLL);
    }
    print(format!("run {name} has ended\n"))
}

/// The run that is meant: the one of this name, or the only one there is.
fn join(args: &RemoteArgs) -> Result<Rendezvous, Failure> {
    let living = living_runs();
    let name = match (&args.name, living.as_slice()) {
        (Some(name), _) => name.clone(),
        (None, [only]) => only.clone(),
        (None, []) => return Err(Failure::input("no run is going on")),
        (None, several) => {
            let names: Vec<String> = several.iter().map(RunName::to_string).collect();
            return Err(Failure::input(format!("--name: expected one of the runs {}, got none", names.join(", "))));
        }
    };
    let run = Rendezvous::join_if_alive(&name).map_err(input_or_running)?;
    run.ok_or_else(|| Failure::input(format!("--name: expected a run that goes on, {name} does not")))
}

/// Sends a signal to the process in a role.
pub(crate) fn signal(run: &Rendezvous, role: Role, signal: Signal) -> Result<Pid, Failure> {
    let (pid, process) = process_in(run, role)?;
    pidfd_send_signal(&process, signal).map_err(|_| gone(run, role))?;
    Ok(pid)
}

/// The process in a role, held so that it is never mistaken for another that may get its pid.
pub(crate) fn process_in(run: &Rendezvous, role: Role) -> Result<(Pid, OwnedFd), Failure> {
    if let Role::Robot(id) = role
        && id >= run.description().scenario.robots.len()
    {
        let last = run.description().scenario.robots.len() - 1;
        return Err(Failure::input(format!("expected robot-0 to robot-{last} in this run, got {role}")));
    }
    let pid = run.roster().holder(role).ok_or_else(|| gone(run, role))?;
    let process = pidfd_open(pid, PidfdFlags::empty()).map_err(|_| gone(run, role))?;
    // Still the holder: so what was opened is it.
    if run.roster().holder(role) != Some(pid) {
        return Err(gone(run, role));
    }
    Ok((pid, process))
}

fn gone(run: &Rendezvous, role: Role) -> Failure {
    Failure::Running(anyhow!("{role} of run {} is not there", run.name()))
}

impl Status {
    /// True while there is any process that the run is made of.
    pub(crate) fn has_processes(&self) -> bool {
        self.nodes.iter().any(|node| node.pid.is_some())
    }

    pub(crate) fn of(run: &Rendezvous) -> Self {
        let description = run.description();
        let scenario = &description.scenario;
        let log = WorldRecord::reader(&description.out_dir, description.run_id, scenario).ok();
        let tick = log.and_then(|log| log.newest_tick().ok()?).unwrap_or(0);
        let roster = run.roster();
        // One that leads now stood by before: its place then is not worth a line.
        let standbys: Vec<Role> = (1..=STANDBYS_MAX).map(Role::Standby).filter(|role| roster.is_held(*role)).collect();
        let roles = watch::roles(scenario.robots.len()).chain(standbys.iter().copied()).chain([Role::Supervisor]);
        Self {
            name: run.name().to_string(),
            scenario: scenario.name.clone(),
            tick,
            ticks: scenario.ticks,
            out_dir: description.out_dir.display().to_string(),
            leader: roster.holder(Role::Fusion).map(Pid::as_raw_pid),
            leads: roster.starts(Role::Fusion),
            standbys: standbys.len(),
            nodes: roles.map(|role| NodeStatus::of(run, role)).collect(),
        }
    }
}

impl NodeStatus {
    fn of(run: &Rendezvous, role: Role) -> Self {
        let pid = run.roster().holder(role).map(Pid::as_raw_pid);
        let told = pid.and_then(|pid| std::fs::read_to_string(format!("/proc/{pid}/status")).ok()).unwrap_or_default();
        let field = |name: &str| told.lines().find_map(|line| line.strip_prefix(name)).map(str::trim);
        let silent = run.roster().last_sign(role).filter(|_| pid.is_some());
        let silent = silent.map(|sign| SystemTime::now().duration_since(sign).unwrap_or_default());
        let state = match (pid, field("State:").and_then(|state| state.chars().next())) {
            (None, _) | (_, Some('Z' | 'X') | None) => "gone",
            (_, Some('T' | 't')) => "stopped",
            _ if silent.is_some_and(|silent| silent >= HUNG) => "hung",
            _ => "running",
        };
        let silent_s = silent.map(|silent| silent.as_secs_f64());
        let resident_kb = field("VmRSS:").and_then(|text| text.split(' ').next()?.parse().ok());
        Self { name: role.to_string(), state, pid, starts: run.roster().starts(role), silent_s, resident_kb }
    }
}

impl std::fmt::Display for Status {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { name, scenario, tick, ticks, out_dir, leader, leads, standbys, nodes } = self;
        writeln!(f, "run {name}: {scenario}, tick {tick} of {ticks}, in {out_dir}")?;
        match leader {
            Some(pid) => writeln!(f, "process {pid} leads, the lead number {leads}; {standbys} stand by")?,
            None => writeln!(f, "nobody leads; {standbys} stand by")?,
        }
        write!(f, "{:<12} {:<8} {:>8} {:>7} {:>10} {:>9}", "node", "state", "pid", "starts", "silent", "memory")?;
        for NodeStatus { name, state, pid, starts, silent_s, resident_kb } in nodes {
            let pid = pid.map_or("-".to_owned(), |pid| pid.to_string());
            let silent = silent_s.map_or("-".to_owned(), |silent_s| format!("{silent_s:.2} s"));
            let memory = resident_kb.map_or("-".to_owned(), |kb| format!("{:.1} MB", kb as f64 / 1_024.0));
            write!(f, "\n{name:<12} {state:<8} {pid:>8} {starts:>7} {silent:>10} {memory:>9}")?;
        }
        Ok(())
    }
}
