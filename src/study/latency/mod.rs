//! `rangehound latency`: the time from range to heading of the real system, beside two references doing the same exchange.
//!
//! How it is measured is told in `docs/latency.md`.
//!
//! | module | what |
//! |---|---|
//! | `system` | runs of the system, as `rangehound run` does them |
//! | [`mod@reference`] | the bare exchange, over iceoryx2 and over futexes |
//! | `samples` | from stamps to latencies, the same for all |
//! | `outcome` | the figures: `latency.json` and the table |
//! | `picture` | the percentile curves and the hops |

mod outcome;
mod picture;
pub mod reference;
mod samples;
mod system;

use std::path::{Path, PathBuf};

use rangehound_node::system::signal::Termination;
use rangehound_shared::run_name::RunName;
use rangehound_shared::scenario::{Clock, Scenario};

use crate::failure::{self, Failure};
use crate::files::layout::Kind;
use crate::files::out_folder::{self, claim_or_number};
use crate::results::frame::{Frames, PutDown};
use crate::results::hops::HopSummary;
use crate::run::experiment::{Experiment, Given, Naming};
use crate::run::pin::Pin;
use crate::run::watch::Progress;
use crate::statistics::Samples;
use outcome::{Contender, Each, Outcome};
use reference::Reference;
use samples::Waits;

/// Where they go unless told otherwise.
const OUT: &str = "runs/latency";

/// Ticks of a round in lock step: seconds.
const TICKS: u64 = 5_000;

/// Time of a round in real time, s.
const ROUND_S: f64 = 10.0;

const ROUNDS_MAX: u64 = 1_000;

/// Ranges of one round: what is kept of them then takes some hundred megabytes.
const RANGES_MAX: u64 = 20_000_000;

/// What is asked of a measurement.
#[derive(Debug)]
pub struct Wanted {
    /// Ticks a second in real time, if not the scenario's.
    pub rate_hz: Option<f64>,
    /// As many ticks as a measurement takes, in place of the scenario's.
    pub chooses_ticks: bool,
    /// Processors for all processes.
    pub pin: Pin,
    /// How often each is measured.
    pub rounds: u64,
    /// Name of the runs.
    pub name: Option<RunName>,
}

/// `rangehound latency`.
///
/// # Errors
/// [`Failure`].
pub fn latency(given: Given, wanted: &Wanted, out: Option<&Path>, json: bool) -> Result<(), Failure> {
    let inputs = given.path.clone();
    let mut experiment = experiment(given, wanted, out)?;
    let termination = Termination::listen()?;
    // Whatever is started here inherits it.
    wanted.pin.apply().map_err(Failure::input)?;
    let inputs: Vec<&Path> = inputs.iter().map(PathBuf::as_path).collect();
    let claim = claim_or_number(out, OUT, Kind::Latency, &inputs)?;
    experiment.description.out_dir = std::path::absolute(claim.path())?;
    let Experiment { description, .. } = &experiment;
    let folder = &description.out_dir;
    claim.clear()?;
    for stale in (1..).map(|round| system::folder(folder, round)).take_while(|stale| stale.exists()) {
        out_folder::remove(&stale);
    }
    let mut outcome = Outcome::new(&description.scenario, &wanted.pin)?;
    let mut progress = Progress::new("measurement", wanted.rounds * Contender::ALL.len() as u64);
    for (round, done) in (1..=wanted.rounds).zip((0..).step_by(Contender::ALL.len())) {
        let mut round =
            Round { experiment: &experiment, round, termination: &termination, hops_us: HopSummary::default() };
        let mut latencies_us = Each::samples()?;
        let order = Contender::in_turns(round.round);
        for (contender, done) in order.into_iter().zip(done..) {
            progress.show(done, &format!("round {}, {contender}", round.round));
            let measured = round.measure(contender, latencies_us.get_mut(contender));
            measured.map_err(|failure| {
                progress.finish();
                // What an end that was asked for looks like to the one who is measured does not matter.
                let asked = || anyhow::anyhow!("ended before the last round, as asked").into();
                if termination.requested() { asked() } else { failure }
            })?;
        }
        outcome.add(order, &latencies_us, round.hops_us);
        // After each round, so that what it showed is not lost.
        outcome.write(folder)?;
    }
    progress.finish();
    picture::draw(&outcome, folder)?;
    if json {
        return failure::print_json(&outcome);
    }
    failure::print(format!("{outcome}\nfigures and picture in {}\n", folder.display()))
}

/// What is measured: checked, as a scenario. One that does not say for how many ticks goes on for as many as it takes.
fn experiment(mut given: Given, wanted: &Wanted, out: Option<&Path>) -> Result<Experiment, Failure> {
    if wanted.rounds == 0 || wanted.rounds > ROUNDS_MAX {
        return Err(Failure::input(format!("--rounds: expected 1 to {ROUNDS_MAX}, got {}", wanted.rounds)));
    }
    if given.file.recording.is_some() {
        let problem = "recording: expected a simulated target, whose ticks come at one rate";
        return Err(Failure::input(format!("{}: {problem}", given.file_name)));
    }
    if let Some(rate_hz) = wanted.rate_hz {
        if !(1e-3..=1e4).contains(&rate_hz) {
            return Err(Failure::input(format!("--rate: expected 0.001 to 10000 Hz, got {rate_hz}")));
        }
        given.file.dt_s = Some(1.0 / rate_hz);
    }
    let name: RunName = match &wanted.name {
        Some(name) => name.clone(),
        // Others that start at the same time have other numbers.
        None => format!("latency-{}", std::process::id()).parse().map_err(Failure::input)?,
    };
    let checked =
        |given| Experiment::from_given(given, Some(&name), Naming::Exact, Some(out.unwrap_or(Path::new(OUT))));
    let mut experiment = checked(given.clone())?;
    if wanted.chooses_ticks {
        let scenario = &experiment.description.scenario;
        given.file.ticks = Some(match scenario.clock {
            Clock::Lockstep => TICKS,
            Clock::Realtime => (ROUND_S / scenario.dt_s).clamp(20.0, TICKS as f64 * 20.0) as u64,
        });
        experiment = checked(given)?;
    }
    let Scenario { ticks, robots, .. } = &experiment.description.scenario;
    if ticks.saturating_mul(robots.len() as u64) > RANGES_MAX {
        let most = RANGES_MAX / robots.len() as u64;
        return Err(Failure::input(format!(
            "--ticks: expected at most {most} for {} robots, got {ticks}",
            robots.len()
        )));
    }
    Ok(experiment)
}

/// Ticks of a round that are not counted: caches are cold, memory is touched for the first time.
fn warm_up_ticks(scenario: &Scenario) -> u64 {
    scenario.ticks / 20
}

/// Time between two ranges of a robot, ns; `None` in lock step, where each follows the heading before.
fn dt_ns(scenario: &Scenario) -> Option<u64> {
    (scenario.clock == Clock::Realtime).then_some((scenario.dt_s * 1e9) as u64)
}

/// One round of measurements.
struct Round<'a> {
    experiment: &'a Experiment,
    round: u64,
    termination: &'a Termination,
    hops_us: HopSummary,
}

impl Round<'_> {
    fn measure(&mut self, contender: Contender, latencies_us: &mut Samples) -> Result<(), Failure> {
        match contender {
            Contender::System => self.measure_system(latencies_us),
            Contender::Reference(reference) => self.measure_reference(reference, latencies_us),
        }
    }

    fn measure_system(&mut self, latencies_us: &mut Samples) -> Result<(), Failure> {
        let folder = system::folder(&self.experiment.description.out_dir, self.round);
        let description = system::run(self.experiment, &folder, self.termination)?;
        let scenario = &description.scenario;
        let mut robots: Vec<Waits> = scenario.robots.iter().map(|_| Waits::new(dt_ns(scenario))).collect();
        let mut sample = |latency_ns| latencies_us.add(latency_ns);
        let mut ended_ns = 0;
        Frames::open(&description)?.for_each(|PutDown { tick, world, .. }| {
            let Some(world) = world else { return Ok(()) };
            ended_ns = world.ended_ns;
            if tick > warm_up_ticks(scenario) {
                for (waits, robot) in robots.iter_mut().zip(&world.robots) {
                    waits.add(system::exchange(robot), &mut sample);
                }
            }
            Ok(())
        })?;
        robots.iter_mut().for_each(|waits| waits.end(ended_ns, &mut sample));
        self.hops_us = system::hops_us(&description)?;
        Ok(())
    }

    fn measure_reference(&self, reference: Reference, latencies_us: &mut Samples) -> Result<(), Failure> {
        let scenario = &self.experiment.description.scenario;
        let log = self.experiment.description.out_dir.join(format!("{}-{}.log", reference.name(), self.round));
        let warm_up = usize::try_from(warm_up_ticks(scenario))?;
        reference::measure(reference, self.experiment, &log, self.termination, |ticks| {
            // Every range of a reference is answered before the next goes out.
            let mut waits = Waits::new(dt_ns(scenario));
            for exchange in ticks.skip(warm_up) {
                waits.add(exchange?, |latency_ns| latencies_us.add(latency_ns));
            }
            Ok(())
        })
    }
}
