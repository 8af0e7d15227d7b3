//! `run` and `track`: starts the nodes of a run, watches them, ends them, and reports.

use std::fs::File;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{self, Sender};
use std::thread::Scope;
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow};
use rangehound_shared::bus::Bus;
use rangehound_shared::rendezvous::{Rendezvous, Role, RunDescription};
use rangehound_shared::signal::Termination;
use rustix::process::{Pid, Signal, kill_process};

use crate::cli::{RunArgs, TrackArgs};
use crate::experiment::{Experiment, Naming};
use crate::failure::Failure;
use crate::node::input_or_running;
use crate::report::{self, NodeSummary, Report, Truth};
use crate::watch::{self, Progress, Watch};
use crate::{in_process, picture, tables};

/// How long nodes may take to end by themselves once the run is over, and once they are asked to.
const GRACE: Duration = Duration::from_secs(3);

/// A robot that ends by itself this often has a reason that starting it again does not mend.
const EXITS_MAX: u64 = 5;

/// For this long after a death, what the dead left half-made is looked for: whoever waits for it
/// holds it open now and then, as its maker would.
const HALF_MADE: Duration = Duration::from_secs(1);

/// A robot that dies is started again after this long.
const RESTART_DELAY: Duration = Duration::from_millis(20);

/// `rangehound run`.
///
/// # Errors
/// [`Failure`].
pub fn run(args: &RunArgs) -> Result<(), Failure> {
    let experiment = Experiment::from_run(&args.experiment, Naming::Numbered)?;
    let keep = Keep { recording: args.write_recording, truth: None };
    execute(experiment, args.in_process, &keep)
}

/// `rangehound track`.
///
/// # Errors
/// [`Failure`].
pub fn track(args: &TrackArgs) -> Result<(), Failure> {
    let experiment = Experiment::from_track(args)?;
    let truth = args.truth.as_deref().map(tables::read_truth).transpose()?;
    execute(experiment, args.in_process, &Keep { recording: false, truth })
}

/// What is done with a run's logs beyond the report.
struct Keep {
    recording: bool,
    truth: Option<Truth>,
}

fn execute(experiment: Experiment, in_process: bool, keep: &Keep) -> Result<(), Failure> {
    let Experiment { name, description, .. } = &experiment;
    if in_process {
        tables::prepare_folder(&experiment)?;
        let mut progress = Progress::new("tick", description.scenario.ticks);
        in_process::run(description, |tick| {
            if tick > 0 && tick % 4_096 == 0 {
                progress.show(tick, "in one process");
            }
        })?;
        progress.finish();
        report_and_tables(description, keep, Vec::new())?;
        return Ok(());
    }
    let termination = Termination::listen()?;
    // Only who has the name may touch the folder.
    let rendezvous = Rendezvous::found(name, description.clone()).map_err(input_or_running)?;
    tables::prepare_folder(&experiment)?;
    let _role = rendezvous.take_role(Role::Supervisor).map_err(input_or_running)?;
    let (summaries, outcome) = std::thread::scope(|scope| {
        let bus = Bus::observe(&rendezvous)?;
        let mut watch = Watch::new(&bus, description.scenario.ticks)?;
        let mut nodes = Nodes::start(&rendezvous, Cleaner::start(&rendezvous, scope))?;
        let outcome = nodes.supervise(&termination, || watch.look());
        nodes.end(rendezvous.is_finished());
        watch.finish();
        Ok::<_, Failure>((nodes.summaries(), outcome))
    })?;
    drop(rendezvous);
    let ticks = report_and_tables(description, keep, summaries)?.ticks;
    outcome?;
    if ticks < description.scenario.ticks {
        return Err(Failure::Running(anyhow!("the logs end at tick {ticks}: see logs/ in the run folder")));
    }
    Ok(())
}

fn report_and_tables(description: &RunDescription, keep: &Keep, nodes: Vec<NodeSummary>) -> Result<Report, Failure> {
    let report = report::from_logs(description, keep.truth.as_ref(), nodes)?;
    tables::write_estimate_csv(description)?;
    if keep.recording {
        tables::write_recording(description)?;
    }
    report::write(&report, &description.out_dir)?;
    println!("{report}\n  run folder       {}", description.out_dir.display());
    picture::draw_if_possible(description, keep.truth.as_ref());
    Ok(report)
}

/// The processes of a run.
struct Nodes<'a> {
    rendezvous: &'a Rendezvous,
    cleaner: Cleaner,
    nodes: Vec<Node>,
    last_death: Option<Instant>,
}

/// A thread that cleans up after killed nodes: it takes tens of milliseconds for each, which nobody
/// should wait for who watches the living. Ends when dropped.
struct Cleaner {
    requests: Sender<()>,
}

impl Cleaner {
    fn start<'scope>(rendezvous: &'scope Rendezvous, scope: &'scope Scope<'scope, '_>) -> Self {
        let (requests, received) = mpsc::channel();
        scope.spawn(move || {
            // A node of its own: ports do not move between threads.
            let Ok(bus) = Bus::observe(rendezvous) else { return };
            while received.recv().is_ok() {
                // One round for all deaths so far.
                while received.try_recv().is_ok() {}
                bus.clean_up_after_the_dead();
            }
        });
        Self { requests }
    }

    fn request(&self) {
        // An error means that the bus refused the cleaner, as it will refuse the nodes.
        let _ = self.requests.send(());
    }
}

/// One process, and what has become of its forerunners.
struct Node {
    role: Role,
    child: Option<Child>,
    summary: NodeSummary,
    restart_at: Option<Instant>,
}

impl<'a> Nodes<'a> {
    fn start(rendezvous: &'a Rendezvous, cleaner: Cleaner) -> Result<Self, Failure> {
        let roles = watch::roles(rendezvous.description().scenario.robots.len());
        let nodes = roles.map(Node::new).collect();
        let mut all = Self { rendezvous, cleaner, nodes, last_death: None };
        for node in &mut all.nodes {
            if let Err(error) = node.start(rendezvous) {
                all.end(false);
                return Err(Failure::Running(error));
            }
        }
        Ok(all)
    }

    /// Watches until the run is finished, a node that cannot be replaced dies, or an end is asked for.
    fn supervise<E: Into<anyhow::Error>>(
        &mut self,
        termination: &Termination,
        mut look: impl FnMut() -> Result<(), E>,
    ) -> anyhow::Result<()> {
        while !self.rendezvous.is_finished() {
            if termination.requested() {
                return Err(anyhow!("ended before its last tick, as asked"));
            }
            std::thread::sleep(watch::LOOK);
            look().map_err(Into::into)?;
            self.replace_the_dead()?;
        }
        look().map_err(Into::into)
    }

    /// Starts robots again that have died; sim and fusion hold what a new process would not know.
    fn replace_the_dead(&mut self) -> anyhow::Result<()> {
        for node in &mut self.nodes {
            if let Some(status) = node.reap(self.rendezvous)? {
                let message = format!("{} {}", node.role, describe(status));
                let hopeless = status.code() == Some(2) || node.summary.exits >= EXITS_MAX;
                if !matches!(node.role, Role::Robot(_)) || hopeless {
                    let log = node.log_path(self.rendezvous);
                    let said = std::fs::read_to_string(&log).unwrap_or_default();
                    let last = said.lines().last().map_or(String::new(), |line| format!(": {line}"));
                    return Err(anyhow!("{message}{last}"));
                }
                log::warn!("{message}; it is started again");
                node.restart_at = Some(Instant::now() + RESTART_DELAY);
                self.last_death = Some(Instant::now());
                self.rendezvous.remove_half_made();
                self.cleaner.request();
            }
            if node.restart_at.is_some_and(|at| Instant::now() >= at) {
                node.start(self.rendezvous)?;
            }
        }
        if self.last_death.is_some_and(|at| at.elapsed() < HALF_MADE) {
            self.rendezvous.remove_half_made();
        }
        Ok(())
    }

    /// Lets the nodes end by themselves if the run is over, asks those that do not, and kills those
    /// that will not.
    fn end(&mut self, finished: bool) {
        if finished {
            self.wait_for_all();
        }
        self.signal(Signal::TERM);
        self.wait_for_all();
        self.signal(Signal::KILL);
        self.wait_for_all();
        self.rendezvous.remove_half_made();
        self.cleaner.request();
    }

    fn wait_for_all(&mut self) {
        let began = Instant::now();
        while self.nodes.iter_mut().any(Node::is_running) && began.elapsed() < GRACE {
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    fn signal(&mut self, signal: Signal) {
        for child in self.nodes.iter_mut().filter_map(|node| node.child.as_mut()) {
            // Reaped or not: only a child that runs still has this pid.
            if matches!(child.try_wait(), Ok(None)) {
                let _ = kill_process(Pid::from_child(child), signal);
            }
        }
    }

    fn summaries(&self) -> Vec<NodeSummary> {
        self.nodes.iter().map(|node| node.summary.clone()).collect()
    }
}

impl Node {
    fn new(role: Role) -> Self {
        let summary = NodeSummary { name: role.to_string(), starts: 0, kills: 0, exits: 0 };
        Self { role, child: None, summary, restart_at: None }
    }

    fn log_path(&self, rendezvous: &Rendezvous) -> std::path::PathBuf {
        rendezvous.description().out_dir.join("logs").join(format!("{}.log", self.role))
    }

    fn start(&mut self, rendezvous: &Rendezvous) -> anyhow::Result<()> {
        let program = std::env::current_exe().context("where this program is")?;
        let log_path = self.log_path(rendezvous);
        let log = File::options().create(true).append(true).open(&log_path);
        let stderr = log.map_or_else(|_| Stdio::null(), Stdio::from);
        let mut command = Command::new(program);
        match self.role {
            Role::Robot(id) => command.args(["robot", "--id", &id.to_string()]),
            role => command.arg(role.to_string()),
        };
        command
            .args(["--name", &rendezvous.name().to_string(), "--end-with", &std::process::id().to_string()])
            // A group of its own: Ctrl-C reaches the supervisor, which ends the nodes in order.
            .process_group(0)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(stderr);
        let child = command.spawn().with_context(|| format!("cannot start {}", self.role))?;
        self.child = Some(child);
        self.summary.starts += 1;
        self.restart_at = None;
        Ok(())
    }

    fn is_running(&mut self) -> bool {
        self.child.as_mut().is_some_and(|child| matches!(child.try_wait(), Ok(None)))
    }

    /// The end of the process before the run's, told once.
    fn reap(&mut self, rendezvous: &Rendezvous) -> anyhow::Result<Option<ExitStatus>> {
        let Some(child) = &mut self.child else { return Ok(None) };
        let Some(status) = child.try_wait()? else { return Ok(None) };
        self.child = None;
        // The run is marked as finished before any node ends by itself, so the mark is looked at after.
        if rendezvous.is_finished() {
            return Ok(None);
        }
        if status.signal().is_some() {
            self.summary.kills += 1;
        } else {
            self.summary.exits += 1;
        }
        Ok(Some(status))
    }
}

fn describe(status: ExitStatus) -> String {
    match (status.signal(), status.code()) {
        (Some(signal), _) => format!("was killed by signal {signal}"),
        (None, Some(code)) => format!("exited with code {code}"),
        (None, None) => "ended".to_owned(),
    }
}
