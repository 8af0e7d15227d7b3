//! Observing and controlling a run from another terminal: the data of `status`; `kill`, `restart`, `stop`.

use std::time::{Duration, Instant, SystemTime};

use anyhow::anyhow;
use rangehound_fusion::standby::STANDBYS_MAX;
use rangehound_node::gateway_note::{GatewayNote, RemoteRobotNote, RobotOrder};
use rangehound_node::logs;
use rangehound_node::rendezvous::{Holder, Process, Rendezvous, Role, living_runs};
use rangehound_shared::run_name::RunName;
use rustix::process::{Pid, Signal};
use serde::Serialize;
use serde_json::json;

use crate::failure::{Failure, print, print_json};
use crate::run::gateway;
use crate::run::node::input_or_running;
use crate::run::watch;
use crate::terminal::counted;

/// Time-out of a request.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(10);

const POLL: Duration = Duration::from_millis(10);

/// Time in which a gateway tells what has become of an order: longer than it waits for the robot.
const ORDER_TIMEOUT: Duration = Duration::from_secs(3);

/// Time without a heartbeat after which a process that runs is shown as hung.
const HUNG: Duration = Duration::from_secs(1);

/// State of a node in another PID namespace, which cannot be observed.
pub(crate) const ELSEWHERE: &str = "elsewhere";

/// The present state of a run.
#[derive(Debug, Serialize)]
pub struct Status {
    pub(crate) name: String,
    pub(crate) scenario: String,
    /// `running`, or `finishing`: the nodes are ending or have ended, and the results are being written.
    pub(crate) phase: &'static str,
    /// Newest tick that is over, and the run's last.
    pub(crate) tick: u64,
    pub(crate) ticks: u64,
    pub(crate) out_dir: String,
    /// The process that leads as fusion, and how many leads there have been.
    pub(crate) leader: Option<i32>,
    pub(crate) leads: u64,
    /// Processes that stand by to lead.
    pub(crate) standbys: usize,
    pub(crate) nodes: Vec<NodeStatus>,
    /// The gateway to robots on other hosts, if there is one.
    pub(crate) gateway: Option<GatewayNote>,
}

/// The present state of a node.
#[derive(Debug, Serialize)]
pub(crate) struct NodeStatus {
    pub(crate) name: String,
    /// The name of a robot's sensor in the recording.
    pub(crate) sensor: Option<String>,
    /// `running`, `stopped` (by a signal), `hung` (sends no heartbeat), `gone`, or `elsewhere` (in another PID namespace).
    pub(crate) state: &'static str,
    pub(crate) pid: Option<i32>,
    pub(crate) starts: u64,
    /// Since its last heartbeat, s; by the wall clock, so that a jump of that clock shows until the next heartbeat.
    pub(crate) silent_s: Option<f64>,
    /// Resident memory, kB.
    pub(crate) resident_kb: Option<u64>,
}

/// `rangehound kill`: sends SIGKILL, which acts like a crash.
///
/// # Errors
/// [`Failure`].
pub fn kill(name: Option<&RunName>, node: Role, json: bool) -> Result<(), Failure> {
    let run = join(name)?;
    let hit = signal(&run, node, Signal::KILL)?;
    if json {
        let pid = hit.pid().map(Pid::as_raw_pid);
        return print_json(&json!({ "name": run.name().to_string(), "node": node.to_string(), "pid": pid }));
    }
    print(match hit {
        Signalled::Here(_) => format!("killed {node}, {hit}\n"),
        Signalled::On(host) => format!("asked the host {host} to kill {node}\n"),
    })
}

/// `rangehound restart`: asks a node to end and waits for its successor.
///
/// # Errors
/// [`Failure`].
pub fn restart(name: Option<&RunName>, node: Role, json: bool) -> Result<(), Failure> {
    let run = join(name)?;
    let starts = run.roster().starts(node);
    ask_for_successor(&run, node)?;
    let began = Instant::now();
    loop {
        if run.roster().starts(node) > starts
            && let Some(pid) = run.roster().holder(node)
        {
            let now = match gateway::remote_robot(&run, node) {
                Some(remote) => Signalled::On(remote.host),
                None => Signalled::Here(pid),
            };
            let (starts, node) = (run.roster().starts(node), node.to_string());
            if json {
                let (name, pid) = (run.name().to_string(), now.pid().map(Pid::as_raw_pid));
                return print_json(&json!({ "name": name, "node": node, "pid": pid, "starts": starts }));
            }
            return print(format!("{node} is now {now}, started {} so far\n", counted(starts, "time")));
        }
        if began.elapsed() > REQUEST_TIMEOUT {
            return Err(Failure::Running(anyhow!(
                "no new process of {node} of run {} has started: check --restart of the run, or on another host its service \
                 manager",
                run.name()
            )));
        }
        std::thread::sleep(POLL);
    }
}

/// `rangehound stop`: ends a run in order, as Ctrl-C would.
///
/// # Errors
/// [`Failure`].
pub fn stop(name: Option<&RunName>, json: bool) -> Result<(), Failure> {
    let run = join(name)?;
    let name = run.name().clone();
    let robots = run.description().scenario.robots.len();
    if run.roster().is_held(Role::Supervisor) {
        signal(&run, Role::Supervisor, Signal::TERM)?;
    } else {
        let standbys = (1..=STANDBYS_MAX).map(Role::Standby);
        let mut processes = Vec::new();
        // All nodes or none: a run without some of its nodes has not ended.
        for role in watch::roles(robots).chain(standbys) {
            match run.roster().process(role) {
                Holder::Here(process) => processes.push(process),
                Holder::Nobody => {}
                Holder::Elsewhere => return Err(elsewhere(&run, role)),
            }
        }
        for process in processes {
            // An error means that it has ended already. A stopped process receives the signal only after it is continued.
            let _ = process.signal(Signal::TERM);
            let _ = process.signal(Signal::CONT);
        }
    }
    // The members leave one by one. This process must not be the last member.
    drop(run);
    let began = Instant::now();
    while living_runs().contains(&name) {
        if began.elapsed() > REQUEST_TIMEOUT {
            return Err(Failure::Running(anyhow!(
                "run {name} has not ended within {REQUEST_TIMEOUT:?}: see `rangehound status --name {name}`"
            )));
        }
        std::thread::sleep(POLL);
    }
    if json {
        return print_json(&json!({ "name": name.to_string() }));
    }
    print(format!("run {name} has ended\n"))
}

/// The run of this name, or the only run.
pub(crate) fn run_named(name: Option<&RunName>) -> Result<RunName, Failure> {
    let living = living_runs();
    match (name, living.as_slice()) {
        (Some(name), _) => Ok(name.clone()),
        (None, [only]) => Ok(only.clone()),
        (None, []) => Err(Failure::input("no run is running: start one with `rangehound run`")),
        (None, several) => {
            let names: Vec<String> = several.iter().map(RunName::to_string).collect();
            Err(Failure::input(format!(
                "--name is missing, and several runs are running: expected one of {}",
                names.join(", ")
            )))
        }
    }
}

/// The error for a run that is not running.
pub(super) fn not_running(name: &RunName) -> Failure {
    Failure::input(format!(
        "run {name} (--name) is not running: expected the name of a running run; `rangehound run --name {name}` starts one"
    ))
}

fn join(name: Option<&RunName>) -> Result<Rendezvous, Failure> {
    let name = run_named(name)?;
    let run = Rendezvous::join_if_alive(&name).map_err(input_or_running)?;
    run.ok_or_else(|| not_running(&name))
}

/// A process that has got a signal.
#[derive(Debug)]
pub(crate) enum Signalled {
    /// On this host.
    Here(Pid),
    /// A robot's, on this host.
    On(String),
}

impl Signalled {
    fn pid(&self) -> Option<Pid> {
        match self {
            Self::Here(pid) => Some(*pid),
            Self::On(_) => None,
        }
    }
}

impl std::fmt::Display for Signalled {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Here(pid) => write!(f, "process {}", pid.as_raw_pid()),
            Self::On(host) => write!(f, "on the host {host}"),
        }
    }
}

/// Sends a signal to the process in a role. A robot on another host gets it through the gateway, if its host allows that.
pub(crate) fn signal(run: &Rendezvous, role: Role, signal: Signal) -> Result<Signalled, Failure> {
    if let Some(remote) = gateway::remote_robot(run, role).filter(|remote| remote.allows_control) {
        let order = match signal {
            Signal::KILL => RobotOrder::Kill,
            Signal::TERM => RobotOrder::End,
            _ => {
                return Err(Failure::input(format!(
                    "{role} runs on the host {}: expected kill or restart; nothing can be stopped or continued there",
                    remote.host
                )));
            }
        };
        return give_order(run, &remote, order).map(|()| Signalled::On(remote.host));
    }
    let process = process_in(run, role)?;
    process.signal(signal).map_err(|_| gone(run, role))?;
    Ok(Signalled::Here(process.pid()))
}

/// Asks the process in a role to end, so that another one is started: by the supervisor or, on another host, by what starts its
/// robots.
pub(crate) fn ask_for_successor(run: &Rendezvous, role: Role) -> Result<Signalled, Failure> {
    if !run.roster().is_held(Role::Supervisor) && gateway::remote_robot(run, role).is_none() {
        return Err(Failure::input(format!(
            "run {} was started by hand: expected a run with a supervisor: kill {role}, and start it again",
            run.name()
        )));
    }
    let hit = signal(run, role, Signal::TERM)?;
    if matches!(hit, Signalled::Here(_)) {
        // A stopped process receives the signal only after it is continued. An error means that the process has ended already.
        let _ = signal(run, role, Signal::CONT);
    }
    Ok(hit)
}

/// Gives an order to a robot on another host, and waits until it has arrived.
fn give_order(run: &Rendezvous, remote: &RemoteRobotNote, order: RobotOrder) -> Result<(), Failure> {
    let robot = remote.robot;
    order.write(run, robot).map_err(input_or_running)?;
    let began = Instant::now();
    while began.elapsed() < ORDER_TIMEOUT {
        match RobotOrder::has_arrived(run, robot) {
            Some(true) => return Ok(()),
            Some(false) => break,
            None => std::thread::sleep(POLL),
        }
    }
    // Nor may it arrive later.
    let _ = RobotOrder::take(run, robot);
    Err(Failure::Running(anyhow!(
        "the order did not reach robot-{robot} on the host {}: its link is cut, see `rangehound status`",
        remote.host
    )))
}

/// The process in a role, as the kernel identifies it.
pub(crate) fn process_in(run: &Rendezvous, role: Role) -> Result<Process, Failure> {
    if let Role::Robot(id) = role
        && id >= run.description().scenario.robots.len()
    {
        let last = run.description().scenario.robots.len() - 1;
        return Err(Failure::input(format!("{role} is not in run {}: expected robot-0 to robot-{last}", run.name())));
    }
    if let Some(remote) = gateway::remote_robot(run, role) {
        return Err(Failure::input(format!(
            "{role} runs on the host {} ({}): end its process there, or start it with --allow-remote-control",
            remote.host, remote.address
        )));
    }
    match run.roster().process(role) {
        // The gateway holds the roles of robots on other hosts. It tells of a new one some time later.
        Holder::Here(process)
            if role.robot().is_some() && run.roster().holder(Role::Gateway) == Some(process.pid()) =>
        {
            Err(Failure::input(format!(
                "{role} has just joined from another host: see `rangehound status`, and try again"
            )))
        }
        Holder::Here(process) => Ok(process),
        Holder::Nobody => Err(gone(run, role)),
        Holder::Elsewhere => Err(elsewhere(run, role)),
    }
}

/// The error for a process in another PID namespace: its PID means another process here.
fn elsewhere(run: &Rendezvous, role: Role) -> Failure {
    let what = if role == Role::Supervisor { "the supervisor".to_owned() } else { role.to_string() };
    Failure::input(format!(
        "{what} of run {} runs in another PID namespace (container), or /proc here does not show it: run this command there",
        run.name()
    ))
}

fn gone(run: &Rendezvous, role: Role) -> Failure {
    Failure::Running(anyhow!("{role} of run {} is not running: see `rangehound status`", run.name()))
}

impl Status {
    /// True while any process of the run exists.
    pub(crate) fn has_processes(&self) -> bool {
        self.nodes.iter().any(|node| node.pid.is_some() || node.state == ELSEWHERE)
    }

    /// Reads it from the files of the run and of the kernel; no node is contacted.
    #[must_use]
    pub fn of(run: &Rendezvous) -> Self {
        let description = run.description();
        let scenario = &description.scenario;
        let log = logs::read_worlds(description).ok();
        let tick = log.and_then(|log| log.newest_tick().ok()?).unwrap_or(0);
        let roster = run.roster();
        let is_ending = run.is_finished() || run.is_ending();
        // One that leads now stood by before: its place then is not worth a line.
        let standbys: Vec<Role> = (1..=STANDBYS_MAX).map(Role::Standby).filter(|role| roster.is_held(*role)).collect();
        let gateway = Some(Role::Gateway).filter(|role| roster.starts(*role) > 0);
        let roles = watch::roles(scenario.robots.len()).chain(standbys.iter().copied());
        let roles = roles.chain(gateway).chain([Role::Supervisor]);
        Self {
            name: run.name().to_string(),
            scenario: scenario.name.clone(),
            phase: if is_ending { "finishing" } else { "running" },
            tick,
            ticks: scenario.ticks,
            out_dir: description.out_dir.display().to_string(),
            leader: roster.holder(Role::Fusion).map(Pid::as_raw_pid),
            leads: roster.starts(Role::Fusion),
            standbys: standbys.len(),
            nodes: roles.map(|role| NodeStatus::of(run, role)).collect(),
            gateway: GatewayNote::read(run),
        }
    }
}

impl NodeStatus {
    fn of(run: &Rendezvous, role: Role) -> Self {
        let holder = run.roster().process(role);
        let (pid, proc_text) = match &holder {
            Holder::Here(process) => (Some(process.pid().as_raw_pid()), process.proc_text("status")),
            Holder::Nobody | Holder::Elsewhere => (None, String::new()),
        };
        let field = |name: &str| proc_text.lines().find_map(|line| line.strip_prefix(name)).map(str::trim);
        let silent = run.roster().last_heartbeat(role).filter(|_| !matches!(holder, Holder::Nobody));
        let silent = silent.map(|heartbeat| SystemTime::now().duration_since(heartbeat).unwrap_or_default());
        let state = match (pid, field("State:").and_then(|state| state.chars().next())) {
            _ if matches!(holder, Holder::Elsewhere) => ELSEWHERE,
            (None, _) | (_, Some('Z' | 'X') | None) => "gone",
            (_, Some('T' | 't')) => "stopped",
            _ if silent.is_some_and(|silent| silent >= HUNG) => "hung",
            _ => "running",
        };
        let silent_s = silent.map(|silent| silent.as_secs_f64());
        let resident_kb = field("VmRSS:").and_then(|text| text.split(' ').next()?.parse().ok());
        let sensor = role.robot().and_then(|id| run.description().scenario.sensor_of(id)).map(str::to_owned);
        Self { name: role.to_string(), sensor, state, pid, starts: run.roster().starts(role), silent_s, resident_kb }
    }
}
