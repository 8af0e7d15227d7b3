//! Hosts on this machine: a network namespace for each, and one in the middle that connects them.

use std::net::Ipv4Addr;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, anyhow, bail};
use rustix::process::{Pid, test_kill_process};

use super::RUN_HOST;

/// How far the monotonic clock of a robot's host is ahead of that of the host before it, s.
const AHEAD_S: usize = 3_600;

/// Folder of the names of namespaces, as `ip netns` has it.
const NAMES: &str = "/run/netns";

/// The prefix of all names of namespaces; the number of the process that made them follows.
const PREFIX: &str = "rangehound-";

/// Hosts, each with a network of its own. They are removed with this value.
#[derive(Debug)]
pub(super) struct Network {
    hosts: usize,
    /// Folder with the shared memory of each robots' host.
    memory: PathBuf,
}

impl Network {
    /// Makes this many hosts. Their shared memory is in this folder, which is removed with them.
    ///
    /// # Errors
    /// If this process may not make them, or `ip`, `nsenter` or `unshare` are missing.
    pub(super) fn new(hosts: usize, memory: PathBuf) -> anyhow::Result<Self> {
        remove_those_of_dead_processes();
        let network = Self { hosts, memory };
        ip(&format!("netns add {}", middle()))
            .map_err(|error| anyhow!("cannot make network namespaces (--hosts): {error:#}: run as root"))?;
        // Packets between hosts pass through the middle.
        let forward = network_of(&middle()).args(["sh", "-c", "echo 1 > /proc/sys/net/ipv4/ip_forward"]).output();
        match forward {
            Ok(output) if output.status.success() => {}
            Ok(output) => bail!("cannot set up the network between hosts: {}", first_line(&output.stderr)),
            Err(error) => bail!("cannot start nsenter: {error}: install util-linux"),
        }
        (0..hosts).try_for_each(|host| network.connect(host))?;
        let clocks = network.command(hosts - 1, Path::new("true")).output();
        match clocks {
            Ok(output) if output.status.success() => Ok(network),
            Ok(output) => Err(anyhow!("cannot give a host its own clock: {}", first_line(&output.stderr))),
            Err(error) => Err(anyhow!("cannot start nsenter: {error}: install util-linux")),
        }
    }

    /// Makes a host, with a cable to the middle.
    ///
    /// # Errors
    /// The report of `ip`.
    pub(super) fn connect(&self, host: usize) -> anyhow::Result<()> {
        let (name, middle) = (name(host), middle());
        let memory = self.memory(host);
        std::fs::create_dir_all(&memory).with_context(|| format!("cannot make the folder {}", memory.display()))?;
        let (own, gateway) = (address(host), next_hop(host));
        ip(&format!("netns add {name}"))?;
        ip(&format!("-n {middle} link add host{host} type veth peer name net netns {name}"))?;
        ip(&format!("-n {middle} addr add {gateway}/30 dev host{host}"))?;
        ip(&format!("-n {middle} link set host{host} up"))?;
        ip(&format!("-n {name} addr add {own}/30 dev net"))?;
        ip(&format!("-n {name} link set net up"))?;
        ip(&format!("-n {name} link set lo up"))?;
        ip(&format!("-n {name} route add default via {gateway}"))
    }

    /// Removes a host. Its processes must have ended.
    pub(super) fn remove(&self, host: usize) {
        // The kernel removes the cable with the host, but some time later.
        let _ = ip(&format!("-n {} link del host{host}", middle()));
        let _ = ip(&format!("netns del {}", name(host)));
        let _ = std::fs::remove_dir_all(self.memory(host));
    }

    fn memory(&self, host: usize) -> PathBuf {
        self.memory.join(host.to_string())
    }

    /// Names of what is in the shared memory of a robots' host.
    pub(super) fn files_on(&self, host: usize) -> Vec<String> {
        let entries = std::fs::read_dir(self.memory(host)).into_iter().flatten().flatten();
        entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect()
    }

    /// The start of a program on a host. A robot's host has its own clock and its own shared memory.
    /// The process has the number of the child, and ends with the process that starts it.
    #[must_use]
    pub(super) fn command(&self, host: usize, program: &Path) -> Command {
        let mut command = network_of(&name(host));
        if host != RUN_HOST {
            let ahead_s = (host * AHEAD_S).to_string();
            command.args(["setpriv", "--pdeathsig", "KILL"]);
            command.args(["unshare", "--mount", "--time", "--monotonic", &ahead_s, "--boottime", &ahead_s]);
            command.args(["sh", "-c", "mount --bind \"$0\" /dev/shm && exec \"$@\""]).arg(self.memory(host));
        }
        command.arg(program);
        command
    }
}

impl Drop for Network {
    fn drop(&mut self) {
        (0..self.hosts).for_each(|host| self.remove(host));
        let _ = ip(&format!("netns del {}", middle()));
        let _ = std::fs::remove_dir_all(&self.memory);
    }
}

/// The address of a host. The range is reserved for measurements of networks (RFC 2544).
#[must_use]
pub(super) fn address(host: usize) -> Ipv4Addr {
    Ipv4Addr::new(198, 18, host as u8, 2)
}

/// The address of the middle, as a host sees it.
#[must_use]
pub(super) fn next_hop(host: usize) -> Ipv4Addr {
    Ipv4Addr::new(198, 18, host as u8, 1)
}

/// The file of the namespace in the middle.
#[must_use]
pub(super) fn middle_file() -> PathBuf {
    Path::new(NAMES).join(middle())
}

fn middle() -> String {
    format!("{PREFIX}{}-middle", std::process::id())
}

fn name(host: usize) -> String {
    format!("{PREFIX}{}-{host}", std::process::id())
}

fn network_of(namespace: &str) -> Command {
    let mut command = Command::new("nsenter");
    command.arg(format!("--net={NAMES}/{namespace}"));
    command
}

/// Carries out a command of `ip`, split at spaces.
fn ip(args: &str) -> anyhow::Result<()> {
    let output = Command::new("ip").args(args.split(' ')).stdin(Stdio::null()).output();
    let output = output.map_err(|error| anyhow!("cannot start ip: {error}: install iproute2"))?;
    if output.status.success() {
        return Ok(());
    }
    Err(anyhow!("ip {args}: {}", first_line(&output.stderr)))
}

fn first_line(text: &[u8]) -> String {
    String::from_utf8_lossy(text).lines().next().unwrap_or("failed").to_owned()
}

/// A process that was killed has left its hosts.
fn remove_those_of_dead_processes() {
    let names = std::fs::read_dir(NAMES).into_iter().flatten().flatten();
    for name in names.filter_map(|entry| entry.file_name().into_string().ok()) {
        let maker = name.strip_prefix(PREFIX).and_then(|rest| rest.split('-').next()?.parse().ok());
        let is_dead = maker.and_then(Pid::from_raw).is_some_and(|pid| test_kill_process(pid).is_err());
        if is_dead {
            let _ = ip(&format!("netns del {name}"));
        }
    }
}
