//! The outcome of a measurement: `latency.json` and the table.

use std::path::Path;

use rangehound_shared::scenario::{Clock, Scenario};
use serde::{Serialize, Serializer};

use super::reference::Reference;
use super::warm_up_ticks;
use crate::files::atomic_file;
use crate::files::layout::LATENCY;
use crate::results::hops::HopSummary;
use crate::results::percentiles::{self, Point};
use crate::results::report::LatencySummary;
use crate::run::pin::Pin;
use crate::statistics::{Ascending, Percentiles, Samples};
use crate::terminal::{TITLE, wrapped};

/// A measured system.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Contender {
    System,
    Reference(Reference),
}

impl Contender {
    pub(super) const ALL: [Self; 3] =
        [Self::System, Self::Reference(Reference::Iceoryx2), Self::Reference(Reference::Futex)];

    /// All contenders, starting with a different one in each round, so that a machine that slows down favours none.
    pub(super) fn in_turns(round: u64) -> [Self; 3] {
        let mut order = Self::ALL;
        order.rotate_left((round % 3) as usize);
        order
    }
}

impl std::fmt::Display for Contender {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::System => "system",
            Self::Reference(reference) => reference.name(),
        })
    }
}

impl Serialize for Contender {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// One value for each contender.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub(super) struct Each<T> {
    pub(super) system: T,
    pub(super) iceoryx2: T,
    pub(super) futex: T,
}

impl<T> Each<T> {
    pub(super) fn get(&self, contender: Contender) -> &T {
        match contender {
            Contender::System => &self.system,
            Contender::Reference(Reference::Iceoryx2) => &self.iceoryx2,
            Contender::Reference(Reference::Futex) => &self.futex,
        }
    }

    pub(super) fn get_mut(&mut self, contender: Contender) -> &mut T {
        match contender {
            Contender::System => &mut self.system,
            Contender::Reference(Reference::Iceoryx2) => &mut self.iceoryx2,
            Contender::Reference(Reference::Futex) => &mut self.futex,
        }
    }

    fn map<U>(&self, of: impl Fn(&T) -> U) -> Each<U> {
        Each { system: of(&self.system), iceoryx2: of(&self.iceoryx2), futex: of(&self.futex) }
    }
}

impl Each<Samples> {
    /// An empty collection.
    ///
    /// # Errors
    /// If the histograms cannot be created.
    pub(super) fn samples() -> anyhow::Result<Self> {
        Ok(Self { system: Samples::new()?, iceoryx2: Samples::new()?, futex: Samples::new()? })
    }
}

/// The outcome of a measurement; its fields are the keys of `latency.json`.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Outcome {
    /// Name of the scenario.
    pub(super) scenario: String,
    /// Planner of the system.
    pub(super) planner: &'static str,
    /// Clock: `realtime` or `lockstep`.
    pub(super) clock: &'static str,
    /// Ticks a second; null in lock step.
    pub(super) rate_hz: Option<f64>,
    /// Robots.
    pub(super) robots: usize,
    /// Time steps of a round.
    pub(super) ticks: u64,
    /// Number of first ticks that are not counted.
    pub(super) warm_up_ticks: u64,
    /// Processors that all processes shared.
    pub(super) pin: String,
    /// Latency over all rounds, us.
    pub(super) latency_us: Each<LatencySummary>,
    /// Median of the rounds' ratios.
    pub(super) p50_ratios: Ratios,
    /// The system's hops, us: median of the rounds.
    pub(super) hops_us: HopSummary,
    /// The rounds.
    pub(super) rounds: Vec<Round>,
    /// Latency at each percentile, over all rounds.
    pub(super) percentiles: Each<Vec<Point>>,
    #[serde(skip)]
    latencies_us: Each<Samples>,
}

/// One round.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Round {
    /// The contenders in the order of measurement.
    pub(super) order: [Contender; 3],
    /// Latency, us.
    pub(super) latency_us: Each<LatencySummary>,
    /// Ratios of the medians.
    pub(super) p50_ratios: Ratios,
    /// The system's hops, us.
    pub(super) hops_us: HopSummary,
}

/// The system's median latency over that of each reference: below 1 the system is faster.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub(super) struct Ratios {
    pub(super) iceoryx2: f64,
    pub(super) futex: f64,
}

impl Ratios {
    fn of(latency_us: &Each<LatencySummary>) -> Self {
        let over = |reference: &LatencySummary| latency_us.system.p50 / reference.p50;
        Self { iceoryx2: over(&latency_us.iceoryx2), futex: over(&latency_us.futex) }
    }
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    values.collect::<Ascending>().quantile(0.5)
}

impl Outcome {
    /// An empty outcome.
    ///
    /// # Errors
    /// If the histograms cannot be created.
    pub(super) fn new(scenario: &Scenario, pin: &Pin) -> anyhow::Result<Self> {
        Ok(Self {
            scenario: scenario.name.clone(),
            planner: scenario.planner.name(),
            clock: scenario.clock.name(),
            rate_hz: (scenario.clock == Clock::Realtime).then_some(1.0 / scenario.dt_s),
            robots: scenario.robots.len(),
            ticks: scenario.ticks,
            warm_up_ticks: warm_up_ticks(scenario),
            pin: pin.to_string(),
            latency_us: Each::default(),
            p50_ratios: Ratios::default(),
            hops_us: HopSummary::default(),
            rounds: Vec::new(),
            percentiles: Each::default(),
            latencies_us: Each::samples()?,
        })
    }

    /// Adds a round.
    pub(super) fn add(&mut self, order: [Contender; 3], latencies_us: &Each<Samples>, hops_us: HopSummary) {
        let latency_us = latencies_us.map(LatencySummary::of);
        self.rounds.push(Round { order, latency_us, p50_ratios: Ratios::of(&latency_us), hops_us });
        for contender in Contender::ALL {
            self.latencies_us.get_mut(contender).add_all(latencies_us.get(contender));
        }
        self.latency_us = self.latencies_us.map(LatencySummary::of);
        self.percentiles = self.latencies_us.map(percentiles::curve);
        let ratios = |of: fn(&Ratios) -> f64| median(self.rounds.iter().map(|round| of(&round.p50_ratios)));
        self.p50_ratios = Ratios { iceoryx2: ratios(|ratios| ratios.iceoryx2), futex: ratios(|ratios| ratios.futex) };
        self.hops_us = self.median_hops_us();
    }

    fn median_hops_us(&self) -> HopSummary {
        let median = |hop: usize, of: fn(Percentiles) -> f64| {
            median(self.rounds.iter().map(|round| of(round.hops_us.in_order()[hop])))
        };
        let percentiles = |hop| Percentiles { p50: median(hop, |us| us.p50), p99: median(hop, |us| us.p99) };
        HopSummary::from_order(std::array::from_fn(percentiles))
    }

    /// Writes `latency.json`.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub(super) fn write(&self, folder: &Path) -> anyhow::Result<()> {
        atomic_file::write(&folder.join(LATENCY), serde_json::to_string_pretty(self)? + "\n")
    }
}

impl std::fmt::Display for Outcome {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { scenario, robots, planner, clock, ticks, warm_up_ticks, pin, .. } = self;
        let rate = self.rate_hz.map_or(String::new(), |rate_hz| format!(" at {rate_hz:.4} Hz"));
        let what = format!("{robots} robots, {planner} planner, {clock}{rate}, pin {pin}");
        writeln!(f, "{TITLE}latency{TITLE:#}: {scenario}, {}", wrapped(&what, 11 + scenario.len()))?;
        let rounds = self.rounds.len();
        writeln!(f, "  {rounds} rounds of {ticks} ticks, of which the first {warm_up_ticks} are not counted")?;
        let [p50, p90, p99, p99_9, max] = ["p50", "p90", "p99", "p99.9", "max"];
        writeln!(
            f,
            "  {:<20}{p50:>8} {p90:>8} {p99:>8} {p99_9:>9} {max:>10} {:>9}",
            "range to heading, us", "samples"
        )?;
        for contender in Contender::ALL {
            let LatencySummary { count, p50, p90, p99, p99_9, max } = self.latency_us.get(contender);
            let name = contender.to_string();
            writeln!(f, "  {name:<20}{p50:>8.1} {p90:>8.1} {p99:>8.1} {p99_9:>9.1} {max:>10.1} {count:>9}")?;
        }
        writeln!(f, "  {:<20}{:>8} {:>8}", "system's p50 over", "iceoryx2", "futex")?;
        let mut row =
            |name: &str, ratios: &Ratios| writeln!(f, "  {name:<20}{:>8.2} {:>8.2}", ratios.iceoryx2, ratios.futex);
        for (number, round) in (1..).zip(&self.rounds) {
            row(&format!("round {number}"), &round.p50_ratios)?;
        }
        row("median", &self.p50_ratios)?;
        writeln!(f, "  {:<20}{p50:>8} {p99:>8}", "system's hops, us")?;
        for (name, hop) in self.hops_us.named() {
            writeln!(f, "  {name:<20}{:>8.1} {:>8.1}", hop.p50, hop.p99)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use rangehound_shared::scenario::ScenarioFile;

    use super::*;

    fn outcome() -> Outcome {
        let file = ScenarioFile { clock: Some("lockstep".to_owned()), ..ScenarioFile::default() };
        let scenario = Scenario::from_file(&file, "test").unwrap();
        Outcome::new(&scenario, &Pin::None).unwrap()
    }

    /// Latencies of one value each, ns.
    fn latencies_us(system: u64, iceoryx2: u64, futex: u64) -> Each<Samples> {
        let mut latencies_us = Each::samples().unwrap();
        for (samples, value) in [
            (&mut latencies_us.system, system),
            (&mut latencies_us.iceoryx2, iceoryx2),
            (&mut latencies_us.futex, futex),
        ] {
            samples.add(value);
        }
        latencies_us
    }

    #[test]
    fn ratios_are_the_median_of_the_rounds() {
        let mut outcome = outcome();
        for system in [1_000, 4_000, 2_000] {
            outcome.add(Contender::ALL, &latencies_us(system, 2_000, 1_000), HopSummary::default());
        }
        assert_eq!(outcome.p50_ratios, Ratios { iceoryx2: 1.0, futex: 2.0 });
        assert_eq!(outcome.latency_us.system.count, 3);
        assert_eq!(median([4.0, 1.0].into_iter()), 2.5);
    }

    #[test]
    fn each_contender_comes_first_in_turn() {
        let firsts: Vec<Contender> = (1..=3).map(|round| Contender::in_turns(round)[0]).collect();
        assert!(Contender::ALL.iter().all(|contender| firsts.contains(contender)), "{firsts:?}");
    }
}
