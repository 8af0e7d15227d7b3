//! Processes beside the nodes of a run that only observe it, such as a recorder. The run does not depend on them.

use std::os::unix::process::CommandExt;
use std::process::{Child, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use rangehound_node::rendezvous::{Rendezvous, RoleLease};
use rangehound_node::system::clock;
use rangehound_node::system::signal::Termination;
use rustix::process::{Pid, Signal, kill_process};

use super::nodes::describe;
use crate::failure::with_causes;
use crate::run::node::this_program;

/// A sidecar that has ended before its run this often is not started again.
const STARTS_MAX: u32 = 5;

/// Time in which a sidecar must end once it is asked to.
const GRACE: Duration = Duration::from_secs(10);

const POLL: Duration = Duration::from_millis(10);

/// The sidecars of a run.
pub(super) struct Sidecars<'a> {
    rendezvous: &'a Rendezvous,
    /// The supervisor's lease.
    lease: &'a RoleLease,
    all: Vec<Sidecar>,
}

/// A command of this program that takes `--name`, and ends by itself after the run.
struct Sidecar {
    command: &'static str,
    args: Vec<String>,
    starts: u32,
    child: Option<Child>,
}

impl<'a> Sidecars<'a> {
    pub(super) fn of(rendezvous: &'a Rendezvous, lease: &'a RoleLease) -> Self {
        Self { rendezvous, lease, all: Vec::new() }
    }

    /// Starts a sidecar. It writes its messages to the standard error of this process.
    pub(super) fn start(&mut self, command: &'static str, args: Vec<String>) {
        let mut sidecar = Sidecar { command, args, starts: 0, child: None };
        sidecar.start(self.rendezvous);
        self.all.push(sidecar);
    }

    /// Starts sidecars again that have failed or were killed. One that failed has reported the reason itself.
    pub(super) fn look(&mut self) {
        for sidecar in &mut self.all {
            if let Some(status) = sidecar.reap()
                && !status.success()
                && !self.rendezvous.is_finished()
            {
                let what = format!("{} {}", sidecar.command, describe(status));
                if status.code() == Some(2) || sidecar.starts >= STARTS_MAX {
                    log::warn!("{what}; the run goes on without it");
                } else {
                    log::warn!("{what}; it is started again");
                    sidecar.start(self.rendezvous);
                }
            }
        }
    }

    /// Waits until all have ended: by themselves if the run is finished, otherwise on a signal.
    pub(super) fn end(&mut self, termination: &Termination) {
        let lease = self.lease;
        let sleep = || {
            // While a long recording is written, the supervisor must not seem to hang.
            lease.renew(clock::monotonic_ns());
            std::thread::sleep(POLL);
        };
        while self.rendezvous.is_finished() && self.any_is_running() && !termination.requested() {
            sleep();
        }
        self.signal(Signal::TERM);
        let began = Instant::now();
        while self.any_is_running() && began.elapsed() < GRACE {
            sleep();
        }
        self.kill();
    }

    /// Kills all at once; their work starts anew with the next life of the run.
    pub(super) fn kill(&mut self) {
        self.signal(Signal::KILL);
        for sidecar in &mut self.all {
            let _ = sidecar.child.take().map(|mut child| child.wait());
        }
    }

    fn any_is_running(&mut self) -> bool {
        self.all.iter_mut().any(Sidecar::is_running)
    }

    fn signal(&mut self, signal: Signal) {
        for sidecar in self.all.iter_mut().filter(|sidecar| sidecar.child.is_some()) {
            sidecar.signal(signal);
        }
    }
}

impl Sidecar {
    fn start(&mut self, rendezvous: &Rendezvous) {
        self.starts += 1;
        let spawned = this_program()
            .arg(self.command)
            .args(["--name", &rendezvous.name().to_string(), "--end-with", &std::process::id().to_string()])
            .args(&self.args)
            // Its own process group: Ctrl-C reaches the supervisor, which ends the sidecar in order.
            .process_group(0)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .spawn();
        match spawned {
            Ok(child) => self.child = Some(child),
            Err(error) => {
                let reason = with_causes(&error.into());
                log::warn!("goes on without {}, which cannot be started: {reason}", self.command);
            }
        }
    }

    fn is_running(&mut self) -> bool {
        self.child.as_mut().is_some_and(|child| matches!(child.try_wait(), Ok(None)))
    }

    /// How it ended; returned once.
    fn reap(&mut self) -> Option<ExitStatus> {
        let status = self.child.as_mut()?.try_wait().ok().flatten()?;
        self.child = None;
        Some(status)
    }

    fn signal(&mut self, signal: Signal) {
        if let Some(child) = &mut self.child
            && matches!(child.try_wait(), Ok(None))
        {
            // It may have just ended: then the signal is not needed.
            let _ = kill_process(Pid::from_child(child), signal);
        }
    }
}
