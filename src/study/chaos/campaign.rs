//! The live part of a campaign: starts runs, injects faults, and waits for the runs to end.

use std::time::{Duration, Instant};

use rangehound_node::rendezvous::{Rendezvous, Role, RunDescription, files_of};
use rangehound_node::system::signal::Termination;
use rustix::process::{Pid, Signal, kill_process};

use super::faults::{Asked, Faults, Kind, OnHosts, PlannedFault, Target};
use super::live::{Live, Recovering};
use super::outcome::{Ended, Injected, Round, RunResult, is_repeatable};
use super::run::{Programs, Run, processes_of};
use crate::failure::{self, Failure};
use crate::files::out_folder;
use crate::results::report::{self, Report};
use crate::run::experiment::Experiment;
use crate::run::in_process;
use crate::run::node::input_or_running;
use crate::run::remote::Status;
use crate::run::watch::Progress;
use crate::study::hosts::Hosts;

const POLL: Duration = Duration::from_millis(1);

/// A run that has not completed a tick for this time after the last fault counts as hung.
const HUNG: Duration = Duration::from_secs(30);

/// While a run has not completed a tick for this time, it gets no further faults: a fault could end a
/// hang that must be detected.
const STILL: Duration = Duration::from_secs(2);

/// Most time for a robot on another host to leave a run that has ended, and to end once it is asked to.
const LEAVING: Duration = Duration::from_secs(5);

/// A campaign of faults, over as many runs as needed.
pub(super) struct Campaign<'a> {
    experiment: &'a Experiment,
    faults: Faults,
    count: u64,
    standbys: usize,
    /// The hosts of the team, if there are several.
    hosts: Option<Hosts>,
    programs: Programs,
    termination: &'a Termination,
    progress: Progress,
    /// The next fault, and the remaining time before it.
    next: PlannedFault,
    next_number: u64,
    wait: Duration,
    injected: Vec<Injected>,
    rounds: usize,
}

impl<'a> Campaign<'a> {
    /// A campaign.
    ///
    /// # Errors
    /// [`Failure`] if the hosts cannot be made.
    pub(super) fn new(
        experiment: &'a Experiment,
        mut faults: Faults,
        asked: &Asked,
        termination: &'a Termination,
    ) -> Result<Self, Failure> {
        let Experiment { name, description, .. } = experiment;
        let robots = description.scenario.robots.len();
        let hosts = |hosts: OnHosts| {
            Hosts::with_links(hosts.count, robots, name, &description.out_dir, (hosts.conditions, asked.seed))
        };
        let next = faults.at(0);
        Ok(Self {
            experiment,
            faults,
            count: asked.faults,
            standbys: asked.standbys,
            hosts: asked.hosts.map(hosts).transpose()?,
            programs: Programs::of_campaign(asked.hosts.is_some())?,
            termination,
            progress: Progress::new("fault", asked.faults),
            wait: next.gap,
            next,
            next_number: 0,
            injected: Vec::new(),
            rounds: 0,
        })
    }

    /// True until all faults are injected.
    pub(super) fn goes_on(&self) -> bool {
        self.next_number < self.count
    }

    pub(super) fn injected(&self) -> &[Injected] {
        &self.injected
    }

    /// One run, from start to end.
    ///
    /// # Errors
    /// [`Failure`] if the run cannot be started or observed.
    pub(super) fn round(&mut self) -> Result<Round, Failure> {
        let Experiment { name, description, .. } = self.experiment;
        let seed = description.scenario.seed.wrapping_add(self.rounds as u64);
        self.rounds += 1;
        let out_dir = description.out_dir.join(format!("round-{}", self.rounds));
        let mut run = Run::start(self.experiment, seed, self.standbys, &out_dir, self.hosts.as_ref())?;
        let mut hosts = self.hosts.take();
        if let Some(hosts) = &mut hosts {
            let log = description.out_dir.join(format!("hosts-{}.log", self.rounds));
            hosts.start(description.scenario.robots.len(), &log)?;
        }
        let began = Instant::now();
        let injected = self.inject_faults(&mut run, hosts.as_mut());
        self.progress.finish();
        let (joined, mut ended) = injected?;
        let code = run.end(ended == Ended::Done)?;
        // A robot whose link was cut when the run ended does not know of its end.
        let robots_left = hosts.as_mut().map(|hosts| hosts.end(LEAVING)).unwrap_or_default();
        let mut files_left: Vec<String> = files_of(name).iter().map(|path| path.display().to_string()).collect();
        files_left.extend(hosts.iter().flat_map(Hosts::files_left));
        self.hosts = hosts;
        if ended == Ended::Done && code != Some(0) {
            ended = Ended::Failed;
        }
        let last_message = if ended == Ended::Done { String::new() } else { run.last_message() };
        if joined.is_none() && ended == Ended::Interrupted {
            return Err(Failure::Running(anyhow::anyhow!("interrupted before the first fault of a run")));
        }
        let Some(joined) = joined else {
            // The run failed before it started: its error is one of the user's input.
            return Err(if code == Some(2) {
                Failure::input(last_message)
            } else {
                Failure::Running(anyhow::anyhow!(last_message))
            });
        };
        let mut processes_left = processes_of(name);
        processes_left.extend(robots_left);
        // Reported and killed.
        for pid in processes_left.iter().filter_map(|pid| Pid::from_raw(*pid)) {
            let _ = kill_process(pid, Signal::KILL);
        }
        let baseline = (ended == Ended::Done).then(|| baseline(&joined)).transpose()?;
        Ok(Round {
            seed,
            ended,
            last_message,
            wall_s: began.elapsed().as_secs_f64(),
            // A run that ended early may have written no logs.
            result: result_of_logs(&joined).unwrap_or_default(),
            baseline,
            is_repeatable: is_repeatable(&joined.scenario),
            files_left,
            processes_left,
        })
    }

    /// Joins the run and injects faults until it ends; joins again after each total outage. The membership ends on return,
    /// so that the run's last own member cleans up as usual.
    fn inject_faults(
        &mut self,
        run: &mut Run,
        mut hosts: Option<&mut Hosts>,
    ) -> Result<(Option<RunDescription>, Ended), Failure> {
        let name = &self.experiment.name;
        let (mut description, mut recovering) = (None, None);
        loop {
            let rendezvous = loop {
                if let Some(rendezvous) = Rendezvous::join_if_alive(name).map_err(input_or_running)? {
                    break rendezvous;
                }
                if run.has_ended()? {
                    return Ok((description, Ended::Failed));
                }
                if self.termination.requested() {
                    return Ok((description, Ended::Interrupted));
                }
                self.programs.check()?;
                if let Some(hosts) = hosts.as_deref_mut() {
                    hosts.look()?;
                }
                std::thread::sleep(POLL);
            };
            description = Some(rendezvous.description().clone());
            match self.inject_until_it_ends(run, &rendezvous, recovering.take(), hosts.as_deref_mut())? {
                Life::Over(ended) => return Ok((description, ended)),
                Life::AllKilled(hit) => {
                    drop(rendezvous);
                    recovering = Some(Recovering {
                        hit,
                        target: Target::Node(Role::Supervisor),
                        killed: Instant::now(),
                        starts: 0,
                        heard_before: None,
                    });
                    run.kill_all_and_resume(hosts.as_deref())?;
                }
            }
        }
    }

    fn inject_until_it_ends(
        &mut self,
        run: &mut Run,
        rendezvous: &Rendezvous,
        recovering: Option<Recovering>,
        hosts: Option<&mut Hosts>,
    ) -> Result<Life, Failure> {
        let mut live = Live::new(rendezvous, self.rounds, recovering, hosts);
        let mut due = live.began + self.wait;
        let life = loop {
            if rendezvous.is_finished() {
                break Life::Over(Ended::Done);
            }
            if run.has_ended()? {
                break Life::Over(Ended::Failed);
            }
            if self.termination.requested() {
                break Life::Over(Ended::Interrupted);
            }
            self.programs.check()?;
            live.update(&mut self.injected)?;
            let idle = live.ticks.since.elapsed();
            if idle >= STILL {
                // After a stall, faults that became due meanwhile do not hit the first tick.
                due = due.max(Instant::now() + self.next.gap);
            }
            let is_due = self.goes_on() && Instant::now() >= due && idle < STILL;
            let is_injected = is_due && live.inject(self.next_number, &self.next, &mut self.injected);
            if is_due && !is_injected && self.next.kind.is_of_hosts() {
                // The host is cut off or down: the next fault must not hit it at the moment when it comes back.
                due = Instant::now() + self.next.gap;
            }
            if is_injected {
                let kind = self.next.kind;
                self.next_number += 1;
                self.next = self.faults.at(self.next_number);
                due = Instant::now() + self.next.gap;
                if kind == Kind::TotalOutage {
                    break Life::AllKilled(self.injected.len() - 1);
                }
            }
            if idle > HUNG && live.last_fault.elapsed() > HUNG {
                failure::print_stderr(Status::of(rendezvous).text(false));
                break Life::Over(Ended::Hung);
            }
            let message = format!("run {}, tick {}", self.rounds, live.ticks.newest);
            self.progress.show(self.next_number, &message);
            std::thread::sleep(POLL);
        };
        self.wait = due.saturating_duration_since(Instant::now());
        live.continue_all()?;
        Ok(life)
    }
}

/// The outcome of a run under one supervisor.
enum Life {
    Over(Ended),
    /// All processes are to be killed, for the hit of this number.
    AllKilled(usize),
}

fn result_of_logs(description: &RunDescription) -> anyhow::Result<RunResult> {
    let report = report::from_logs(description, None, Vec::new(), |_| ())?;
    let Report { ticks, digest, ranges, headings, position_rmse_m, .. } = report;
    Ok(RunResult { ticks, digest, ranges, headings, position_rmse_m })
}

/// The baseline: the same run without faults, in this process.
fn baseline(description: &RunDescription) -> anyhow::Result<RunResult> {
    let out_dir = description.out_dir.join("baseline");
    let claim = out_folder::claim(&out_dir, crate::files::layout::Kind::Run, &[])
        .map_err(|refusal| anyhow::anyhow!("{refusal}"))?;
    claim.clear().map_err(|refusal| anyhow::anyhow!("{refusal}"))?;
    let baseline = RunDescription { out_dir, ..description.clone() };
    in_process::run(&baseline, |_| {})?;
    result_of_logs(&baseline)
}
