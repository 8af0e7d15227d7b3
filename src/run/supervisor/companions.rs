//! Processes beside the nodes of a run that only look on, such as a recorder. The run does not depend on them.

use std::os::unix::process::CommandExt;
use std::process::{Child, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use rangehound_node::rendezvous::{Rendezvous, RoleHold};
use rangehound_node::system::signal::Termination;
use rustix::process::{Pid, Signal, kill_process};

use super::nodes::describe;
use crate::failure::with_causes;
use crate::run::node::this_program;

/// One that has ended before its run this often is left alone.
const STARTS_MAX: u32 = 5;

/// How long one may take to end once it is asked to.
const GRACE: Duration = Duration::from_secs(10);

const POLL: Duration = Duration::from_millis(10);

/// The processes that look on at a run.
pub(super) struct Companions<'a> {
    rendezvous: &'a Rendezvous,
    /// The supervisor's.
    hold: &'a RoleHold,
    all: Vec<Companion>,
}

/// One of them: a command of this program that takes `--name`, and ends by itself when the run has.
struct Companion {
    command: &'static str,
    args: Vec<String>,
    starts: u32,
    child: Option<Child>,
}

impl<'a> Companions<'a> {
    pub(super) fn of(rendezvous: &'a Rendezvous, hold: &'a RoleHold) -> Self {
        Self { rendezvous, hold, all: Vec::new() }
    }

    /// Starts one. What it has to say goes where this process's own words go.
    pub(super) fn start(&mut self, command: &'static str, args: Vec<String>) {
        let mut companion = Companion { command, args, starts: 0, child: None };
        companion.start(self.rendezvous);
        self.all.push(companion);
    }

    /// Starts those again that have been ended; one that failed has said why.
    pub(super) fn look(&mut self) {
        for companion in &mut self.all {
            if let Some(status) = companion.reap()
                && !status.success()
                && !self.rendezvous.is_finished()
            {
                let what = format!("{} {}", companion.command, describe(status));
                if status.code() == Some(2) || companion.starts >= STARTS_MAX {
                    log::warn!("{what}; the run goes on without it");
                } else {
                    log::warn!("{what}; it is started again");
                    companion.start(self.rendezvous);
                }
            }
        }
    }

    /// Waits until all have ended: by themselves after a run that came to its end, otherwise asked to.
    pub(super) fn end(&mut self, termination: &Termination) {
        let hold = self.hold;
        let sleep = || {
            // A long recording is no hang.
            hold.sign();
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

    /// Ends all at once: what they were about is begun anew.
    pub(super) fn kill(&mut self) {
        self.signal(Signal::KILL);
        for companion in &mut self.all {
            let _ = companion.child.take().map(|mut child| child.wait());
        }
    }

    fn any_is_running(&mut self) -> bool {
        self.all.iter_mut().any(Companion::is_running)
    }

    fn signal(&mut self, signal: Signal) {
        for companion in self.all.iter_mut().filter(|companion| companion.child.is_some()) {
            companion.signal(signal);
        }
    }
}

impl Companion {
    fn start(&mut self, rendezvous: &Rendezvous) {
        self.starts += 1;
        let spawned = this_program()
            .arg(self.command)
            .args(["--name", &rendezvous.name().to_string(), "--end-with", &std::process::id().to_string()])
            .args(&self.args)
            // A group of its own: Ctrl-C reaches the supervisor, which ends it in order.
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

    /// How it ended, told once.
    fn reap(&mut self) -> Option<ExitStatus> {
        let status = self.child.as_mut()?.try_wait().ok().flatten()?;
        self.child = None;
        Some(status)
    }

    fn signal(&mut self, signal: Signal) {
        if let Some(child) = &mut self.child
            && matches!(child.try_wait(), Ok(None))
        {
            // One that has just ended hears nothing, and needs nothing.
            let _ = kill_process(Pid::from_child(child), signal);
        }
    }
}
