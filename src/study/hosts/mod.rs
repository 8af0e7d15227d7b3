//! A team on several hosts, all of them on this machine: namespaces with networks and clocks of their own.
//!
//! | module | what |
//! |---|---|
//! | `network` | the hosts |
//! | `link` | what the network does to packets |
//!
//! Host 0 is the run's. The robots are spread over all hosts, or over all but this one.

pub mod link;
mod network;

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::{Child, Command};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use rangehound_shared::run_name::RunName;
use rustix::process::{Pid, Signal, kill_process};

use crate::failure::Failure;
use crate::run::gateway;
use crate::run::node::start_logged;
use link::{Conditions, Link};
use network::{Network, address};

/// The host of the run.
pub const RUN_HOST: usize = 0;

/// Most hosts: their number is a byte of their address.
pub const HOSTS_MAX: usize = 200;

/// The gateway's port, and the first one of links.
const PORT: u16 = 7_400;

/// A robot that has ended is not started again before this time, as by a service manager.
const RESTART_AFTER: Duration = Duration::from_millis(20);

/// The hosts of a team.
#[derive(Debug)]
pub struct Hosts {
    program: PathBuf,
    keys: PathBuf,
    name: RunName,
    robots: Vec<Robot>,
    /// File for the robots' messages.
    log: PathBuf,
    /// One for each robot's host; none of them if packets are only routed.
    links: Vec<Link>,
    /// Hosts that are down.
    down: Vec<usize>,
    /// The first host with robots, and the number of hosts.
    first: usize,
    count: usize,
    // The last to be dropped: processes and links use it.
    network: Network,
}

/// A robot on a host that is not the run's.
#[derive(Debug)]
struct Robot {
    id: usize,
    host: usize,
    child: Option<Child>,
    ended: Option<Instant>,
}

impl Hosts {
    /// Hosts whose links do this to packets, for a run with this many robots: they are spread over all hosts. Keys go to a
    /// folder in `folder`.
    ///
    /// # Errors
    /// [`Failure`] if hosts, keys or links cannot be made.
    pub fn with_links(
        count: usize,
        robots: usize,
        name: &RunName,
        folder: &Path,
        (conditions, seed): (Conditions, u64),
    ) -> Result<Self, Failure> {
        let mut hosts = Self::new(count, RUN_HOST, robots, name, folder)?;
        let gateway = hosts.gateway();
        let link = |host| Link::new(host, PORT + host as u16, gateway, conditions, seed);
        let links = (1..count).map(link).collect::<Result<_, _>>();
        hosts.links = links.context("cannot make the links between hosts")?;
        Ok(hosts)
    }

    /// The same with packets that take the shortest way, and all robots on other hosts than the run's.
    ///
    /// # Errors
    /// [`Failure`] if hosts or keys cannot be made.
    pub fn all_remote(count: usize, robots: usize, name: &RunName, folder: &Path) -> Result<Self, Failure> {
        Self::new(count, RUN_HOST + 1, robots, name, folder)
    }

    fn new(count: usize, first: usize, robots: usize, name: &RunName, folder: &Path) -> Result<Self, Failure> {
        gateway::program()?;
        let program = std::env::current_exe().context("cannot find this program's own file")?;
        // With the number of this process: no folder that was there before is removed.
        let own = |what: &str| folder.join(format!("{what}.{}", std::process::id()));
        let network = Network::new(count, own("memory"));
        let network = network.map_err(|error| Failure::input(format!("{error:#} (--hosts)")))?;
        let keys = own("keys");
        let hosts = Self {
            program,
            keys,
            name: name.clone(),
            robots: Vec::new(),
            log: PathBuf::new(),
            links: Vec::new(),
            down: Vec::new(),
            first,
            count,
            network,
        };
        hosts.make_keys(robots)?;
        Ok(hosts)
    }

    /// The gateway's address.
    #[must_use]
    pub fn gateway(&self) -> SocketAddr {
        (address(RUN_HOST), PORT).into()
    }

    /// The keys of a host.
    #[must_use]
    pub fn keys(&self, host: usize) -> PathBuf {
        self.keys.join(host_name(host))
    }

    /// The host of a robot.
    #[must_use]
    pub fn host_of(&self, robot: usize) -> usize {
        self.first + robot % (self.count - self.first)
    }

    /// The start of a program on a host. The process has the number of the child.
    #[must_use]
    pub fn command(&self, host: usize, program: &Path) -> Command {
        self.network.command(host, program)
    }

    /// The start of this program on the run's host.
    #[must_use]
    pub fn on_run_host(&self) -> Command {
        self.command(RUN_HOST, &self.program)
    }

    /// The arguments of a run of this many robots: its gateway, and which robots it does not start itself.
    #[must_use]
    pub fn arguments(&self, robots: usize) -> Vec<String> {
        let listen = self.gateway().to_string();
        let keys = self.keys(RUN_HOST).display().to_string();
        let flags = ["--listen", &listen, "--keys", &keys, "--remote"].map(str::to_owned);
        flags.into_iter().chain([self.remote(robots)]).collect()
    }

    fn remote(&self, robots: usize) -> String {
        let remote = (0..robots).filter(|robot| self.host_of(*robot) != RUN_HOST);
        remote.map(|robot| robot.to_string()).collect::<Vec<_>>().join(",")
    }

    /// Starts the robots of the other hosts, with a file for their messages.
    ///
    /// # Errors
    /// If one cannot be started.
    pub fn start(&mut self, robots: usize, log: &Path) -> anyhow::Result<()> {
        log.clone_into(&mut self.log);
        let remote = (0..robots).filter(|robot| self.host_of(*robot) != RUN_HOST);
        self.robots = remote.map(|id| Robot { id, host: self.host_of(id), child: None, ended: None }).collect();
        self.look()
    }

    /// Starts robots again that have ended, as the service manager of their host would. Those that have left in order stay away.
    ///
    /// # Errors
    /// If one cannot be started.
    pub fn look(&mut self) -> anyhow::Result<()> {
        let shortest = self.gateway();
        let Self { program, keys, name, robots, log, links, down, network, .. } = self;
        for robot in robots {
            if let Some(child) = &mut robot.child {
                match child.try_wait()? {
                    Some(status) if !status.success() => (robot.child, robot.ended) = (None, Some(Instant::now())),
                    _ => continue,
                }
            }
            let rests = robot.ended.is_some_and(|ended| ended.elapsed() < RESTART_AFTER);
            if rests || down.contains(&robot.host) {
                continue;
            }
            let gateway = links.get(robot.host - 1).map_or(shortest, Link::address);
            let mut command = network.command(robot.host, program);
            command
                .args(["robot", "--id", &robot.id.to_string(), "--name", &name.to_string()])
                .args(["--connect", &gateway.to_string(), "--keys"])
                .arg(keys.join(host_name(robot.host)));
            robot.child = Some(start_logged(&mut command, log)?);
        }
        Ok(())
    }

    /// An authority, and the keys of all hosts.
    fn make_keys(&self, robots: usize) -> anyhow::Result<()> {
        let mut command = Command::new(&self.program);
        command.arg("keys").arg("--out").arg(&self.keys).args(["--gateway", &host_name(RUN_HOST)]);
        for host in 1..self.count {
            let own = (0..robots).filter(|robot| self.host_of(*robot) == host);
            let own: Vec<String> = own.map(|robot| robot.to_string()).collect();
            command.args(["--host", &format!("{}={}", host_name(host), own.join(","))]);
        }
        let output = command.output().context("cannot make keys")?;
        if !output.status.success() {
            bail!("cannot make keys: {}", String::from_utf8_lossy(&output.stderr).trim());
        }
        Ok(())
    }

    /// The process of a robot on another host than the run's, if it runs.
    #[must_use]
    pub fn process(&self, robot: usize) -> Option<Pid> {
        let robot = self.robots.iter().find(|other| other.id == robot)?;
        robot.child.as_ref().map(Pid::from_child)
    }

    /// True if this is a process of a robot on this host.
    #[must_use]
    pub fn is_on(&self, host: usize, pid: Pid) -> bool {
        let mut own = self.robots.iter().filter(|robot| robot.host == host);
        own.any(|robot| robot.child.as_ref().is_some_and(|child| Pid::from_child(child) == pid))
    }

    /// The files in the shared memory of the robots' hosts: a robot on another host than the run's needs none.
    #[must_use]
    pub fn files_left(&self) -> Vec<String> {
        let on =
            |host| self.network.files_on(host).into_iter().map(move |file| format!("{file} on {}", host_name(host)));
        (RUN_HOST + 1..self.count).flat_map(on).collect()
    }

    /// Cuts packets from a host, to it, or both; or lets all pass.
    pub fn cut(&self, host: usize, up: bool, down: bool) {
        if let Some(link) = self.links.get(host - 1) {
            link.cut(up, down);
        }
    }

    /// Switches a host off: its robots die, and so does its network.
    pub fn switch_off(&mut self, host: usize) {
        for robot in self.robots.iter_mut().filter(|robot| robot.host == host) {
            if let Some(mut child) = robot.child.take() {
                let _ = child.kill();
                let _ = child.wait();
            }
        }
        self.network.remove(host);
        self.down.push(host);
    }

    /// Switches it on again: it gets a network, and its robots start.
    ///
    /// # Errors
    /// If its network or a robot cannot be made.
    pub fn switch_on(&mut self, host: usize) -> anyhow::Result<()> {
        self.network.connect(host)?;
        self.down.retain(|other| *other != host);
        self.look()
    }

    /// Waits until all robots have left the finished run, and ends those that do not within this time. Returns how many did
    /// not end when they were asked to.
    pub fn end(&mut self, timeout: Duration) -> Vec<i32> {
        let mut left = Vec::new();
        for signal in [None, Some(Signal::TERM)] {
            let began = Instant::now();
            for robot in &mut self.robots {
                let Some(child) = &mut robot.child else { continue };
                let pid = Pid::from_child(child);
                if let Some(signal) = signal {
                    let _ = kill_process(pid, signal);
                }
                while began.elapsed() < timeout && matches!(child.try_wait(), Ok(None)) {
                    std::thread::sleep(Duration::from_millis(1));
                }
                if matches!(child.try_wait(), Ok(None)) {
                    if signal.is_some() {
                        left.push(pid.as_raw_pid());
                        let _ = child.kill();
                        let _ = child.wait();
                    }
                } else {
                    robot.child = None;
                }
            }
        }
        self.robots.clear();
        left
    }
}

impl Drop for Hosts {
    fn drop(&mut self) {
        for child in self.robots.iter_mut().filter_map(|robot| robot.child.as_mut()) {
            let _ = child.kill();
            let _ = child.wait();
        }
        // Keys of hosts that are no more.
        let _ = std::fs::remove_dir_all(&self.keys);
    }
}

fn host_name(host: usize) -> String {
    format!("host-{host}")
}
