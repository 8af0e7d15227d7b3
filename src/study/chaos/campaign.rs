//! The live part of a campaign: runs that are started, hurt, and waited for.

use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::Context;
use rangehound_fusion::standby::STANDBYS_MAX;
use rangehound_node::logs;
use rangehound_node::rendezvous::{Process, Rendezvous, Role, RunDescription, files_of, living_runs};
use rangehound_node::signal::Termination;
use rangehound_node::tick_log::TickLogReader;
use rangehound_shared::record::{FusionRecord, Record, WorldRecord};
use rangehound_shared::run_name::RunName;
use rustix::process::{Pid, Signal, kill_process};

use super::faults::{Fault, Faults, Kind};
use super::outcome::{Ended, Injected, Round, Tally, is_repeatable};
use crate::cli::ChaosArgs;
use crate::failure::{self, Failure};
use crate::files::out_folder;
use crate::files::whole_file;
use crate::results::report::{self, Report};
use crate::run::experiment::Experiment;
use crate::run::in_process;
use crate::run::node::input_or_running;
use crate::run::remote::{Status, process_in, signal};
use crate::run::watch::Progress;

const POLL: Duration = Duration::from_millis(1);

/// Where what a run says goes, beside its folder.
fn log(out_dir: &Path) -> PathBuf {
    out_dir.with_extension("log")
}

/// A run that has not completed a tick for so long after the last fault is called hung.
const HUNG: Duration = Duration::from_secs(30);

/// A run that has not completed a tick for so long is hurt no more until it does: a fault could end a
/// hang that should be seen.
const STILL: Duration = Duration::from_secs(2);

/// How long a run may take to end once it is finished or asked to.
const ENDING: Duration = Duration::from_secs(30);

/// A campaign of faults, over as many runs as it takes.
pub(super) struct Campaign<'a> {
    experiment: &'a Experiment,
    faults: Faults,
    count: u64,
    standbys: usize,
    termination: &'a Termination,
    progress: Progress,
    /// The next fault, and what is left of the time before it.
    next: Fault,
    next_number: u64,
    wait: Duration,
    injected: Vec<Injected>,
    rounds: usize,
}

impl<'a> Campaign<'a> {
    pub(super) fn new(
        experiment: &'a Experiment,
        mut faults: Faults,
        args: &ChaosArgs,
        termination: &'a Termination,
    ) -> Self {
        let (next, count, standbys) = (faults.at(0), args.faults, args.standby);
        let (wait, progress) = (next.gap, Progress::new("fault", count));
        let (next_number, injected, rounds) = (0, Vec::new(), 0);
        Self { experiment, faults, count, standbys, termination, progress, next, next_number, wait, injected, rounds }
    }

    /// True until all faults are in.
    pub(super) fn goes_on(&self) -> bool {
        self.next_number < self.count
    }

    pub(super) fn injected(&self) -> &[Injected] {
        &self.injected
    }

    /// One run, from its start to its end.
    ///
    /// # Errors
    /// [`Failure`] if the run cannot be started or looked at.
    pub(super) fn round(&mut self) -> Result<Round, Failure> {
        let Experiment { name, description, .. } = self.experiment;
        let seed = description.scenario.seed.wrapping_add(self.rounds as u64);
        self.rounds += 1;
        let out_dir = description.out_dir.join(format!("round-{}", self.rounds));
        let mut run = Run::start(self.experiment, seed, self.standbys, &out_dir)?;
        let began = Instant::now();
        let (joined, mut ended) = self.hurt(&mut run)?;
        self.progress.finish();
        let code = run.end(ended == Ended::Done)?;
        if ended == Ended::Done && code != Some(0) {
            ended = Ended::Failed;
        }
        let said = if ended == Ended::Done { String::new() } else { run.last_words() };
        let Some(joined) = joined else {
            // It ended before it was a run: what it complains about is the user's to mend.
            return Err(if code == Some(2) { Failure::input(said) } else { Failure::Running(anyhow::anyhow!(said)) });
        };
        let processes_left = processes_of(name);
        // Told, but not left.
        for pid in processes_left.iter().filter_map(|pid| Pid::from_raw(*pid)) {
            let _ = kill_process(pid, Signal::KILL);
        }
        let alone = (ended == Ended::Done).then(|| alone(&joined)).transpose()?;
        Ok(Round {
            seed,
            ended,
            said,
            wall_s: began.elapsed().as_secs_f64(),
            // A run that ended early may have left no logs.
            tally: tally(&joined).unwrap_or_default(),
            alone,
            is_repeatable: is_repeatable(&joined.scenario),
            files_left: files_of(name).iter().map(|path| path.display().to_string()).collect(),
            processes_left,
        })
    }

    /// Joins the run and hurts it until it ends, and after each blackout again. Membership ends with this,
    /// so that the run's last own member cleans up as it would without us.
    fn hurt(&mut self, run: &mut Run) -> Result<(Option<RunDescription>, Ended), Failure> {
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
                std::thread::sleep(POLL);
            };
            description = Some(rendezvous.description().clone());
            match self.hurt_until_it_ends(run, &rendezvous, recovering.take())? {
                Life::Over(ended) => return Ok((description, ended)),
                Life::BlackedOut(hit) => {
                    drop(rendezvous);
                    recovering = Some(Recovering {
                        hit,
                        role: Role::Supervisor,
                        killed: Instant::now(),
                        starts: 0,
                        heard_before: None,
                    });
                    run.black_out_and_resume()?;
                }
            }
        }
    }

    fn hurt_until_it_ends(
        &mut self,
        run: &mut Run,
        rendezvous: &Rendezvous,
        recovering: Option<Recovering>,
    ) -> Result<Life, Failure> {
        let mut live = Live::new(rendezvous, self.rounds, recovering);
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
            live.look(&mut self.injected);
            let idle = live.ticks.since.elapsed();
            if idle >= STILL {
                // Its first tick after a stillness is not met by what would have come meanwhile.
                due = due.max(Instant::now() + self.next.gap);
            }
            if self.goes_on()
                && Instant::now() >= due
                && idle < STILL
                && live.inject(self.next_number, &self.next, &mut self.injected)
            {
                let kind = self.next.kind;
                self.next_number += 1;
                self.next = self.faults.at(self.next_number);
                due = Instant::now() + self.next.gap;
                if kind == Kind::Blackout {
                    break Life::BlackedOut(self.injected.len() - 1);
                }
            }
            if idle > HUNG && live.last_fault.elapsed() > HUNG {
                failure::tell(Status::of(rendezvous).text(false));
                break Life::Over(Ended::Hung);
            }
            let message = format!("run {}, tick {}", self.rounds, live.ticks.newest);
            self.progress.show(self.next_number, &message);
            std::thread::sleep(POLL);
        };
        self.wait = due.saturating_duration_since(Instant::now());
        live.continue_all();
        Ok(life)
    }
}

/// What becomes of a run under one supervisor.
enum Life {
    Over(Ended),
    /// Everything is to be killed, for the hit of this number.
    BlackedOut(usize),
}

/// The child that supervises a run.
struct Run {
    child: Child,
    name: RunName,
    standbys: usize,
    out_dir: PathBuf,
}

impl Run {
    fn start(experiment: &Experiment, seed: u64, standbys: usize, out_dir: &Path) -> anyhow::Result<Self> {
        let scenario = out_dir.with_extension("toml");
        whole_file::write(&scenario, experiment.scenario_file.to_toml()?)?;
        let name = experiment.name.clone();
        let mut run = Command::new(std::env::current_exe().context("where this program is")?);
        run.arg("run").arg(&scenario).args(["--seed", &seed.to_string(), "--out"]).arg(out_dir);
        let child = Self::spawn(run, &name, standbys, out_dir)?;
        Ok(Self { child, name, standbys, out_dir: out_dir.to_owned() })
    }

    fn spawn(mut command: Command, name: &RunName, standbys: usize, out_dir: &Path) -> anyhow::Result<Child> {
        let output = out_folder::append(&log(out_dir))?;
        command
            .args(["--no-record", "--name", &name.to_string(), "--standby", &standbys.to_string()])
            // What it says is quoted.
            .env("NO_COLOR", "1")
            // A group of its own: Ctrl-C reaches this process, which ends the run in order.
            .process_group(0)
            .stdin(Stdio::null())
            .stdout(output.try_clone()?)
            .stderr(output)
            .spawn()
            .context("cannot start the run")
    }

    /// Kills the supervisor and all nodes, and has the run resumed.
    fn black_out_and_resume(&mut self) -> anyhow::Result<()> {
        // It starts nobody while the others die.
        let _ = kill_process(Pid::from_child(&self.child), Signal::STOP);
        loop {
            let left = processes_of(&self.name);
            // One that is not listed any more may still be on its way down.
            if left.is_empty() && !living_runs().contains(&self.name) {
                break;
            }
            for pid in left.into_iter().filter_map(Pid::from_raw) {
                let _ = kill_process(pid, Signal::KILL);
            }
            let _ = self.child.try_wait()?;
            std::thread::sleep(POLL);
        }
        self.child.wait()?;
        let mut resume = Command::new(std::env::current_exe().context("where this program is")?);
        resume.arg("resume").arg(&self.out_dir);
        self.child = Self::spawn(resume, &self.name, self.standbys, &self.out_dir)?;
        Ok(())
    }

    fn has_ended(&mut self) -> std::io::Result<bool> {
        Ok(self.child.try_wait()?.is_some())
    }

    /// Waits for the end, asks for it if the run is not over, and forces it in the end. The exit code, if
    /// it came to one.
    fn end(&mut self, is_over: bool) -> std::io::Result<Option<i32>> {
        for attempt in usize::from(!is_over).. {
            match attempt {
                0 => {}
                1 if !self.has_ended()? => drop(kill_process(Pid::from_child(&self.child), Signal::TERM)),
                1 => {}
                _ => drop(self.child.kill()),
            }
            let began = Instant::now();
            while began.elapsed() < ENDING {
                if let Some(status) = self.child.try_wait()? {
                    return Ok(status.code());
                }
                std::thread::sleep(POLL);
            }
        }
        Ok(None)
    }

    fn last_words(&self) -> String {
        let text = std::fs::read_to_string(log(&self.out_dir)).unwrap_or_default();
        let complaint = text.lines().rev().find(|line| line.starts_with("rangehound: "));
        complaint.or(text.lines().last()).unwrap_or_default().trim_start_matches("rangehound: ").to_owned()
    }
}

impl Drop for Run {
    /// An error on our side must not leave a run behind.
    fn drop(&mut self) {
        if matches!(self.has_ended(), Ok(false)) {
            let _ = self.end(false);
        }
    }
}

/// A run while it is being hurt.
struct Live<'a> {
    run: &'a Rendezvous,
    round: usize,
    began: Instant,
    last_fault: Instant,
    ticks: Ticks<'a>,
    /// Who is to be continued, and when.
    stopped: Vec<(Instant, Process)>,
    storms: Vec<Storm>,
    recovering: Vec<Recovering>,
}

struct Storm {
    hit: usize,
    role: Role,
    /// Starts of the role at the last kill.
    starts: u64,
    left: u32,
}

struct Recovering {
    hit: usize,
    role: Role,
    killed: Instant,
    starts: u64,
    /// What counted as heard of the role when its successor was there.
    heard_before: Option<u64>,
}

impl<'a> Live<'a> {
    fn new(run: &'a Rendezvous, round: usize, recovering: Option<Recovering>) -> Self {
        let now = Instant::now();
        let (stopped, storms, recovering) = (Vec::new(), Vec::new(), recovering.into_iter().collect());
        Self { run, round, began: now, last_fault: now, ticks: Ticks::of(run), stopped, storms, recovering }
    }

    /// Does a fault to those of its nodes that are there. False if none is: to be tried again.
    fn inject(&mut self, fault: u64, what: &Fault, injected: &mut Vec<Injected>) -> bool {
        let mut is_done = false;
        let everything = [Role::Supervisor];
        let roles = if what.kind == Kind::Blackout { &everything[..] } else { &what.roles };
        for role in roles {
            let Some(role) = self.present(*role) else { continue };
            let hit = injected.len();
            let is_hit = match what.kind {
                Kind::Stop => self.stop(role, what.stop),
                Kind::Kill | Kind::Several | Kind::Storm => self.kill(role, hit),
                // Done by who can do without the run.
                Kind::Blackout => true,
            };
            if !is_hit {
                continue;
            }
            is_done = true;
            match what.kind {
                Kind::Storm => {
                    let starts = self.recovering.last().map_or(0, |last| last.starts);
                    self.storms.push(Storm { hit, role, starts, left: what.kills - 1 });
                }
                Kind::Kill | Kind::Stop | Kind::Several | Kind::Blackout => {}
            }
            let (at_s, tick) = (self.began.elapsed().as_secs_f64(), self.ticks.newest);
            let round = self.round;
            injected.push(Injected {
                fault,
                round,
                at_s,
                tick,
                kind: what.kind,
                role,
                restart_ms: None,
                recovery_ms: None,
            });
        }
        if is_done {
            self.last_fault = Instant::now();
        }
        is_done
    }

    /// The role that is meant: standbys go by the numbers that are free when they come.
    fn present(&self, role: Role) -> Option<Role> {
        let Role::Standby(number) = role else { return Some(role) };
        let numbers = (number..=STANDBYS_MAX).chain(1..number);
        let mut roles = numbers.map(Role::Standby);
        roles.find(|role| self.run.roster().is_held(*role))
    }

    /// Stops a node for a while: the process, which may have lost its role when it is to go on.
    fn stop(&mut self, role: Role, duration: Duration) -> bool {
        let Ok(process) = process_in(self.run, role) else { return false };
        let is_stopped = process.signal(Signal::STOP).is_ok();
        self.stopped.push((Instant::now() + duration, process));
        is_stopped
    }

    /// Kills a node, for the hit of this number; an earlier one that it has not got over counts no more.
    fn kill(&mut self, role: Role, hit: usize) -> bool {
        let starts = self.run.roster().starts(role);
        if signal(self.run, role, Signal::KILL).is_err() {
            return false;
        }
        self.recovering.retain(|earlier| earlier.role != role);
        self.recovering.push(Recovering { hit, role, killed: Instant::now(), starts, heard_before: None });
        true
    }

    /// Does what is due of earlier faults, and notes who has recovered.
    fn look(&mut self, injected: &mut [Injected]) {
        let now = Instant::now();
        self.ticks.look();
        let run = self.run;
        self.stopped.retain(|(due, process)| {
            let is_due = now >= *due;
            if is_due {
                let _ = process.signal(Signal::CONT);
            }
            !is_due
        });
        for mut storm in std::mem::take(&mut self.storms) {
            let successor = run.roster().starts(storm.role);
            if successor > storm.starts && self.kill(storm.role, storm.hit) {
                (storm.starts, storm.left) = (successor, storm.left - 1);
                self.last_fault = now;
            }
            if storm.left > 0 {
                self.storms.push(storm);
            }
        }
        let ticks = &self.ticks;
        self.recovering.retain_mut(|node| {
            let heard = ticks.heard(node.role);
            match node.heard_before {
                None if run.roster().starts(node.role) > node.starts => {
                    node.heard_before = Some(heard);
                    injected[node.hit].restart_ms = Some(1e3 * node.killed.elapsed().as_secs_f64());
                }
                Some(before) if heard > before => {
                    injected[node.hit].recovery_ms = Some(1e3 * node.killed.elapsed().as_secs_f64());
                    return false;
                }
                _ => {}
            }
            true
        });
    }

    fn continue_all(&mut self) {
        for (_, process) in self.stopped.drain(..) {
            let _ = process.signal(Signal::CONT);
        }
    }
}

/// What the run's logs tell while they grow.
struct Ticks<'a> {
    description: &'a RunDescription,
    world: Option<TickLogReader<WorldRecord>>,
    estimate: Option<TickLogReader<FusionRecord>>,
    /// Newest tick that is over.
    newest: u64,
    /// Since when.
    since: Instant,
    newest_estimate: u64,
    /// Newest tick that was read, and for each robot the newest with a range of it.
    read: Option<u64>,
    heard: Vec<u64>,
}

impl<'a> Ticks<'a> {
    fn of(run: &'a Rendezvous) -> Self {
        let description = run.description();
        let heard = vec![0; description.scenario.robots.len()];
        let (newest, newest_estimate, since) = (0, 0, Instant::now());
        Self { description, world: None, estimate: None, newest, since, newest_estimate, read: None, heard }
    }

    fn look(&mut self) {
        // A log is there once its node has started.
        if self.world.is_none() {
            self.world = logs::read_worlds(self.description).ok();
        }
        if self.estimate.is_none() {
            self.estimate = logs::read_estimates(self.description).ok();
        }
        fn newest<R: Record>(log: &TickLogReader<R>) -> Option<u64> {
            log.newest_tick().ok().flatten()
        }
        if let Some(tick) = self.estimate.as_ref().and_then(newest::<FusionRecord>) {
            self.newest_estimate = tick;
        }
        let Some(log) = &mut self.world else { return };
        let Some(tick) = newest(log) else { return };
        if tick > self.newest {
            (self.newest, self.since) = (tick, Instant::now());
        }
        // Never beyond the records that are whole.
        while self.read.is_none_or(|read| read < tick) {
            let Some(Ok((read, record))) = log.next() else { break };
            self.read = Some(read);
            for (heard, robot) in self.heard.iter_mut().zip(&record.robots) {
                if robot.range_sent_ns.is_some() {
                    *heard = read;
                }
            }
        }
    }

    /// The newest tick that shows this role at work. In lock step no tick ends without all.
    fn heard(&self, role: Role) -> u64 {
        match role {
            _ if is_repeatable(&self.description.scenario) => self.newest,
            Role::Robot(id) => self.heard.get(id).copied().unwrap_or(0),
            Role::Fusion | Role::Standby(_) => self.newest_estimate,
            Role::Sim | Role::Supervisor => self.newest,
        }
    }
}

fn tally(description: &RunDescription) -> anyhow::Result<Tally> {
    let report = report::from_logs(description, None, Vec::new())?;
    let Report { ticks, digest, ranges, headings, position_rmse_m, .. } = report;
    Ok(Tally { ticks, digest, ranges, headings, position_rmse_m })
}

/// The same run left alone, composed in this process.
fn alone(description: &RunDescription) -> anyhow::Result<Tally> {
    let out_dir = description.out_dir.join("alone");
    let claim = out_folder::claim(&out_dir, crate::files::layout::Kind::Run, &[])
        .map_err(|refusal| anyhow::anyhow!("{refusal}"))?;
    claim.clear().map_err(|refusal| anyhow::anyhow!("{refusal}"))?;
    let alone = RunDescription { out_dir, ..description.clone() };
    in_process::run(&alone, |_| {})?;
    tally(&alone)
}

/// Living processes of this program in this PID namespace that go by this run's name, but for this one. Another container may
/// have a run of the same name.
fn processes_of(name: &RunName) -> Vec<i32> {
    let program = std::env::current_exe().ok();
    let name = name.to_string();
    let is_of_run = |pid: &i32| {
        let arguments = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
        let mut arguments = arguments.split(|byte| *byte == 0);
        arguments.any(|argument| argument == b"--name") && arguments.next() == Some(name.as_bytes())
    };
    let namespace = |process: &str| std::fs::read_link(format!("/proc/{process}/ns/pid")).ok();
    let here = namespace("self");
    // Where `/proc` is of another namespace, its numbers are not those that signals go by.
    let is_own = std::fs::read_link("/proc/self").is_ok_and(|me| me.as_os_str() == &*std::process::id().to_string());
    let processes = is_own.then(|| std::fs::read_dir("/proc").ok()).flatten();
    processes
        .into_iter()
        .flatten()
        .flatten()
        .filter_map(|entry| entry.file_name().to_str()?.parse::<i32>().ok())
        .filter(|pid| here.is_some() && namespace(&pid.to_string()) == here)
        .filter(|pid| Some(*pid) != i32::try_from(std::process::id()).ok())
        .filter(|pid| std::fs::read_link(format!("/proc/{pid}/exe")).ok() == program)
        .filter(is_of_run)
        .collect()
}
