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
use crate::run::pin::Pin;
use crate::run::watch::Progress;
use crate::statistics::Samples;
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
                // After a requested end, errors of the measured processes do not matter.
                let asked = || anyhow::anyhow!("asked to end before the last round").into();
                if termination.requested() { asked() } else { failure }
            })?;
        }
        outcome.add(order, &latencies_us, round.hops_us);
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
        self.hops_us = system::hops_us(&description)?;
        Ok(())
    }

    fn measure_reference(&self, reference: Reference, latencies_us: &mut Samples) -> Result<(), Failure> {
        let scenario = &self.experiment.description.scenario;
        let log = self.experiment.description.out_dir.join(format!("{}-{}.log", reference.name(), self.round));
        let warm_up = usize::try_from(warm_up_ticks(scenario))?;
        reference::measure(reference, self.experiment, &log, self.termination, |ticks| {
            // Every range of a reference is answered before the next one is sent.
            let mut waits = Waits::new(dt_ns(scenario));
            for exchange in ticks.skip(warm_up) {
                waits.add(exchange?, |latency_ns| latencies_us.add(latency_ns));
            }
            Ok(())
        })
    }
}
