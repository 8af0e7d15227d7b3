//! `rangehound latency`: the time from range to heading of the system, compared with two references for the same exchange.
//!
//! `docs/latency.md` describes the measurement.
//!
//! | module | what |
//! |---|---|
//! | `system` | runs of the system, as `rangehound run` does them |
//! | [`mod@reference`] | the bare exchange, over iceoryx2 and over futexes |
//! | `samples` | from stamps to latencies, with one method for all |
//! | `outcome` | the figures: `latency.json` and the table |
//! | `picture` | the percentile curves and the hops |

mod outcome;
mod picture;
pub mod reference;
mod samples;
mod system;

use std::path::Path;

use rangehound_node::system::signal::Termination;
use rangehound_shared::scenario::{Clock, Scenario};

use crate::failure::{self, Failure};
use crate::files::layout::Kind;
use crate::files::out_folder::{self, claim_or_number};
use crate::results::frame::{Frames, LoggedTick};
use crate::results::hops::HopSummary;
use crate::run::experiment::Experiment;
use crate::run::gateway;
use crate::run::pin::Pin;
use crate::run::watch::Progress;
use crate::statistics::Samples;
use crate::study::hosts::Hosts;
use outcome::{Contender, Each, Outcome};
use reference::Reference;
use samples::Waits;

/// Default folder of the results.
pub const OUT: &str = "runs/latency";

/// The parameters of a measurement.
#[derive(Debug)]
pub struct Wanted {
    /// Processors for all processes.
    pub pin: Pin,
    /// Number of rounds.
    pub rounds: u64,
    /// Number of hosts, if there are several.
    pub hosts: Option<usize>,
}

/// `rangehound latency`.
///
/// # Errors
/// [`Failure`].
pub fn latency(mut experiment: Experiment, wanted: &Wanted, out: Option<&Path>, json: bool) -> Result<(), Failure> {
    let termination = Termination::listen()?;
    // All processes started from here inherit it.
    wanted.pin.apply().map_err(Failure::input)?;
    let claim = claim_or_number(out, OUT, Kind::Latency, &experiment.inputs())?;
    experiment.description.out_dir = std::path::absolute(claim.path())?;
    let Experiment { description, .. } = &experiment;
    let folder = &description.out_dir;
    claim.clear()?;
    for contender in [Contender::System, Contender::Local] {
        for stale in (1..).map(|round| system::folder(folder, contender, round)).take_while(|stale| stale.exists()) {
            out_folder::remove(&stale);
        }
    }
    let robots = description.scenario.robots.len();
    let mut hosts = wanted.hosts.map(|count| Hosts::all_remote(count, robots, &experiment.name, folder)).transpose()?;
    let contenders = contenders(hosts.is_some())?;
    let mut outcome = Outcome::new(&description.scenario, &wanted.pin, wanted.hosts, &contenders)?;
    let mut progress = Progress::new("measurement", wanted.rounds * contenders.len() as u64);
    for (number, done) in (1..=wanted.rounds).zip((0..).step_by(contenders.len())) {
        let mut round = Round {
            experiment: &experiment,
            round: number,
            termination: &termination,
            hosts: hosts.as_mut(),
            hops_us: HopSummary::default(),
        };
        let mut latencies_us = Each::samples(&contenders)?;
        let order = Contender::in_turns(&contenders, number);
        for (contender, done) in order.iter().copied().zip(done..) {
            progress.show(done, &format!("round {number}, {contender}"));
            let samples = latencies_us.get_mut(contender).ok_or_else(|| anyhow::anyhow!("no samples"))?;
            let measured = round.measure(contender, samples);
            measured.map_err(|failure| {
                progress.finish();
                // After a requested end, errors of the measured processes do not matter.
                let asked = || anyhow::anyhow!("interrupted before the last round: start `latency` again").into();
                if termination.requested() { asked() } else { failure }
            })?;
        }
        let hops_us = round.hops_us;
        outcome.add(order, &latencies_us, hops_us);
        // Written after each round, so that its result is not lost.
        outcome.write(folder)?;
    }
    progress.finish();
    picture::draw(&outcome, folder)?;
    if json {
        return failure::print_json(&outcome);
    }
    failure::print(format!("{outcome}\nfigures and picture in {}\n", folder.display()))
}

/// The systems that are measured.
///
/// # Errors
/// [`Failure`] if the gateway's program, which has the references for several hosts, does not answer.
fn contenders(on_hosts: bool) -> Result<Vec<Contender>, Failure> {
    if !on_hosts {
        return Ok(Contender::on_one_host());
    }
    let contenders = Contender::on_hosts(&gateway::latency_transports()?);
    if !contenders.contains(&Contender::Reference(Reference::Zenoh)) {
        failure::print_stderr(
            "zenoh is not measured: `cargo build --release -p rangehound-gateway --features zenoh` makes a gateway that can",
        );
    }
    Ok(contenders)
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
    hosts: Option<&'a mut Hosts>,
    hops_us: HopSummary,
}

impl Round<'_> {
    fn measure(&mut self, contender: Contender, latencies_us: &mut Samples) -> Result<(), Failure> {
        match contender {
            Contender::System | Contender::Local => self.measure_system(contender, latencies_us),
            Contender::Reference(reference) => self.measure_reference(reference, latencies_us),
        }
    }

    fn measure_system(&mut self, contender: Contender, latencies_us: &mut Samples) -> Result<(), Failure> {
        let folder = system::folder(&self.experiment.description.out_dir, contender, self.round);
        let hosts = self.hosts.as_deref_mut().filter(|_| contender == Contender::System);
        let description = system::run(self.experiment, &folder, self.termination, hosts)?;
        let scenario = &description.scenario;
        let mut robots: Vec<Waits> = scenario.robots.iter().map(|_| Waits::new(dt_ns(scenario))).collect();
        let mut sample = |latency_ns| latencies_us.add(latency_ns);
        let mut ended_ns = 0;
        Frames::open(&description)?.for_each(|LoggedTick { tick, world, .. }| {
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
        if contender == Contender::System {
            self.hops_us = system::hops_us(&description)?;
        }
        Ok(())
    }

    fn measure_reference(&self, reference: Reference, latencies_us: &mut Samples) -> Result<(), Failure> {
        let scenario = &self.experiment.description.scenario;
        let log = self.experiment.description.out_dir.join(format!("{}-{}.log", reference.name(), self.round));
        let warm_up = usize::try_from(warm_up_ticks(scenario))?;
        reference::measure(reference, self.experiment, &log, self.termination, self.hosts.as_deref(), |ticks| {
            // Every range of a reference is answered before the next one is sent.
            let mut waits = Waits::new(dt_ns(scenario));
            for exchange in ticks.skip(warm_up) {
                waits.add(exchange?, |latency_ns| latencies_us.add(latency_ns));
            }
            Ok(())
        })
    }
}
