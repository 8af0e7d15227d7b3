//! Progress of a run for observers: no node notifies or waits for them.

use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};
use rangehound_node::bus::{Bus, BusError, Subscriber};
use rangehound_node::rendezvous::{Rendezvous, Role};
use rangehound_node::system::signal::Termination;
use rangehound_shared::message::{Estimate, Truth};
use rangehound_shared::run_name::RunName;

use crate::failure::{self, Failure};
use crate::results::made::{self, Keep};
use crate::results::report::{NodeSummary, position_covariance};
use crate::run::node;
use crate::run::node::input_or_running;
use crate::terminal;

/// Interval at which an observer polls.
pub const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// Interval between printed lines without a terminal.
const LINE: Duration = Duration::from_secs(2);

/// How long fusion may take to record its last tick after the run's end. By then a supervisor has killed a hung fusion.
const END_WAIT: Duration = Duration::from_secs(10);

/// The same if an end is requested before the run's end: the request may concern only this process.
const EARLY_END_WAIT: Duration = Duration::from_secs(1);

/// Time without a supervisor after which a supervised run has ended: one that makes its shared memory again takes its role a
/// moment after the run is there.
const UNSUPERVISED: Duration = Duration::from_millis(500);

const END_WAIT_POLL: Duration = Duration::from_millis(5);

/// The newest ticks of the two nodes that write logs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Newest {
    /// Tick of the newest estimate.
    pub fusion: Option<u64>,
    /// The simulator's newest tick, where there is a truth.
    pub sim: Option<u64>,
}

/// An observer's newest messages of a run.
#[derive(Debug)]
pub struct Watch {
    estimates: Subscriber<Estimate>,
    truths: Subscriber<Truth>,
    progress: Progress,
    estimate: Option<(u64, Estimate)>,
    /// The last few ticks' true positions: truth and estimate of a tick come at different times.
    recent_truths: [(u64, [f64; 2]); 8],
    latency_ns: u64,
    error_m: Option<f64>,
}

impl Watch {
    /// Starts to watch a run.
    ///
    /// # Errors
    /// [`BusError`] if the bus refuses.
    pub fn new(bus: &Bus, ticks: u64) -> Result<Self, BusError> {
        Ok(Self {
            estimates: bus.subscriber()?,
            truths: bus.subscriber()?,
            progress: Progress::new("tick", ticks),
            estimate: None,
            recent_truths: [(u64::MAX, [0.0; 2]); 8],
            latency_ns: 0,
            error_m: None,
        })
    }

    /// The newest tick that fusion and the simulator have published.
    #[must_use]
    pub fn newest_ticks(&self) -> Newest {
        let truths = self.recent_truths.iter().map(|(tick, _)| *tick).filter(|tick| *tick != u64::MAX);
        Newest { fusion: self.estimate.as_ref().map(|(tick, _)| *tick), sim: truths.max() }
    }

    /// Polls once, and shows the changes.
    ///
    /// # Errors
    /// [`BusError`] if the bus fails.
    pub fn look(&mut self) -> Result<(), BusError> {
        let Self { estimates, truths, recent_truths, latency_ns, estimate, error_m, .. } = self;
        truths.drain(|header, message| {
            if let [truth] = message {
                *latency_ns = truth.latency_ns;
                if truth.state_dim >= 2 {
                    let slot = (header.tick % recent_truths.len() as u64) as usize;
                    recent_truths[slot] = (header.tick, [truth.state[0], truth.state[1]]);
                }
            }
        })?;
        estimates.drain(|header, message| {
            if let [newest] = message {
                *estimate = Some((header.tick, *newest));
                let known = recent_truths.iter().find(|(tick, _)| *tick == header.tick);
                if let Some((_, [x_m, y_m])) = known {
                    *error_m = Some((newest.state[0] - x_m).hypot(newest.state[1] - y_m));
                }
            }
        })?;
        if let Some((tick, estimate)) = &self.estimate {
            let trace_m2 = position_covariance(estimate).trace();
            let error = self.error_m.map_or(String::new(), |error_m| format!("error {error_m:.2} m  "));
            let latency = match self.latency_ns {
                0 => String::new(),
                ns => format!("  latency {} us", ns / 1_000),
            };
            self.progress.show(*tick, &format!("{error}trace {trace_m2:.3} m^2{latency}"));
        }
        Ok(())
    }

    /// Ends the display.
    pub fn finish(&mut self) {
        self.progress.finish();
    }
}

/// A progress bar on a terminal; a line at intervals elsewhere.
#[derive(Debug)]
pub struct Progress {
    bar: ProgressBar,
    is_drawn: bool,
    step: &'static str,
    steps: u64,
    last_line: Option<Instant>,
}

impl Progress {
    /// A display for this many steps; `step` is the name of one.
    #[must_use]
    pub fn new(step: &'static str, steps: u64) -> Self {
        let bar = ProgressBar::new(steps).with_prefix(step);
        if let Ok(style) = ProgressStyle::with_template("{bar:16} {prefix} {pos}/{len}  {wide_msg}") {
            bar.set_style(style);
        }
        let is_drawn = terminal::draws_on_stderr();
        terminal::set_bar(is_drawn.then(|| bar.clone()));
        Self { bar, is_drawn, step, steps, last_line: None }
    }

    /// Removes the bar before the report is printed.
    pub fn finish(&self) {
        if self.is_drawn {
            self.bar.finish_and_clear();
            terminal::set_bar(None);
        }
    }

    /// Shows how many steps are done.
    pub fn show(&mut self, done: u64, message: &str) {
        if self.is_drawn {
            if self.bar.is_finished() {
                // It was removed for other output, as between the runs of a campaign.
                self.bar.reset();
                terminal::set_bar(Some(self.bar.clone()));
            }
            self.bar.set_position(done);
            self.bar.set_message(message.to_owned());
        } else if self.last_line.is_none_or(|last| last.elapsed() >= LINE) {
            let line = format!("{} {done}/{}  {message}", self.step, self.steps);
            failure::print_stderr(line.trim_end());
            self.last_line = Some(Instant::now());
        }
    }
}

impl Drop for Progress {
    /// Removes the bar also after an error.
    fn drop(&mut self) {
        self.finish();
    }
}

/// `rangehound watch`: attaches to a run started by hand, and reports when it ends.
///
/// # Errors
/// [`Failure`].
pub fn watch(name: &RunName, json: bool) -> Result<(), Failure> {
    let termination = Termination::listen()?;
    while !watch_until_removed(name, json, &termination)? {
        failure::print_stderr(format_args!("the shared memory of run {name} was removed: joining it again"));
    }
    Ok(())
}

/// Watches a run until its end. False if the shared memory of a supervised run was removed: the supervisor makes it again.
fn watch_until_removed(name: &RunName, json: bool, termination: &Termination) -> Result<bool, Failure> {
    let rendezvous = node::join(name, termination)?;
    let bus = Bus::connect(&rendezvous, "observer")?;
    let description = rendezvous.description();
    let mut watch = Watch::new(&bus, description.scenario.ticks)?;
    let roster = rendezvous.roster();
    let is_supervised = roster.is_held(Role::Supervisor);
    let has_lost_its_supervisor = || roster.starts(Role::Supervisor) > 0 && !roster.is_held(Role::Supervisor);
    let mut supervised = Instant::now();
    while !rendezvous.is_finished() && !termination.requested() {
        if rendezvous.is_removed() {
            watch.finish();
            return if is_supervised { Ok(false) } else { Err(input_or_running(rendezvous.removed())) };
        }
        // A run that is ended before its last tick is not marked as finished.
        if !has_lost_its_supervisor() {
            supervised = Instant::now();
        } else if supervised.elapsed() > UNSUPERVISED && !rendezvous.is_finished() {
            watch.finish();
            return Err(Failure::Running(anyhow::anyhow!(
                "run {name} was ended before its last tick: `rangehound resume {}` may continue it",
                made::from_here(&description.out_dir).display()
            )));
        }
        std::thread::sleep(POLL_INTERVAL);
        watch.look()?;
    }
    watch.finish();
    if !rendezvous.is_finished() {
        return Ok(true);
    }
    wait_for_last_estimate(&rendezvous);
    let nodes = roles(description.scenario.robots.len())
        .map(|role| NodeSummary::new(role, &description.scenario, rendezvous.roster().starts(role)))
        .collect();
    let keep = Keep { json, ..Keep::default() };
    if roster.starts(Role::Supervisor) > 0 {
        // The supervisor writes the report: it has more data on the nodes.
        return made::print_report(description, &keep, nodes).map(|_| true);
    }
    made::report_and_tables(description, &keep, nodes).map(|_| true)
}

/// Waits until fusion has recorded its last tick and ended. False if fusion is still there: the run continues, or fusion hangs.
pub fn wait_for_last_estimate(run: &Rendezvous) -> bool {
    let began = Instant::now();
    while run.roster().is_held(Role::Fusion) {
        let at_most = if run.is_finished() { END_WAIT } else { EARLY_END_WAIT };
        if began.elapsed() >= at_most {
            return false;
        }
        std::thread::sleep(END_WAIT_POLL);
    }
    true
}

/// The nodes of a run.
pub fn roles(robots: usize) -> impl Iterator<Item = Role> {
    [Role::Sim, Role::Fusion].into_iter().chain((0..robots).map(Role::Robot))
}
