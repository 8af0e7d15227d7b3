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
use crate::terminal::{TITLE, counted, wrapped};

/// A measured system.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Contender {
    /// The system; on several hosts if they are measured.
    System,
    /// The system on one host, beside that on several.
    Local,
    /// The exchange alone.
    Reference(Reference),
}

impl Contender {
    /// The contenders on one host.
    pub(super) fn on_one_host() -> Vec<Self> {
        vec![Self::System, Self::Reference(Reference::Iceoryx2), Self::Reference(Reference::Futex)]
    }

    /// The contenders on several hosts, where the gateway's program has these transports.
    pub(super) fn on_hosts(transports: &[String]) -> Vec<Self> {
        let references = [Reference::Quic, Reference::Udp, Reference::Zenoh];
        let has = |reference: &Reference| transports.iter().any(|transport| transport == reference.name());
        [Self::System, Self::Local].into_iter().chain(references.into_iter().filter(has).map(Self::Reference)).collect()
    }

    /// All of them, starting with a different one in each round, so that a machine that slows down favours none.
    pub(super) fn in_turns(all: &[Self], round: u64) -> Vec<Self> {
        let mut order = all.to_vec();
        order.rotate_left((round % all.len() as u64) as usize);
        order
    }
}

impl std::fmt::Display for Contender {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::System => "system",
            Self::Local => "local",
            Self::Reference(reference) => reference.name(),
        })
    }
}

impl Serialize for Contender {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// One value for each contender, in their order.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Each<T>(Vec<(Contender, T)>);

impl<T> Each<T> {
    pub(super) fn get(&self, contender: Contender) -> Option<&T> {
        self.0.iter().find(|(other, _)| *other == contender).map(|(_, value)| value)
    }

    pub(super) fn get_mut(&mut self, contender: Contender) -> Option<&mut T> {
        self.0.iter_mut().find(|(other, _)| *other == contender).map(|(_, value)| value)
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = (Contender, &T)> {
        self.0.iter().map(|(contender, value)| (*contender, value))
    }

    fn map<U>(&self, of: impl Fn(&T) -> U) -> Each<U> {
        Each(self.iter().map(|(contender, value)| (contender, of(value))).collect())
    }
}

impl<T: Serialize> Serialize for Each<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.iter())
    }
}

impl Each<Samples> {
    /// An empty collection for each of these.
    ///
    /// # Errors
    /// If the histograms cannot be created.
    pub(super) fn samples(contenders: &[Contender]) -> anyhow::Result<Self> {
        let samples = contenders.iter().map(|contender| Ok((*contender, Samples::new()?)));
        Ok(Self(samples.collect::<anyhow::Result<_>>()?))
    }
}

/// The system's median latency over that of each other contender: below 1 the system is faster.
fn ratios(latency_us: &Each<LatencySummary>) -> Each<f64> {
    let system = latency_us.get(Contender::System).map_or(f64::NAN, |system| system.p50);
    let others = latency_us.iter().filter(|(contender, _)| *contender != Contender::System);
    Each(others.map(|(contender, other)| (contender, system / other.p50)).collect())
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
    /// Hosts.
    pub(super) hosts: usize,
    /// Time steps of a round.
    pub(super) ticks: u64,
    /// Number of first ticks that are not counted.
    pub(super) warm_up_ticks: u64,
    /// Processors that all processes shared.
    pub(super) pin: String,
    /// Latency over all rounds, us.
    pub(super) latency_us: Each<LatencySummary>,
    /// Median of the rounds' ratios.
    pub(super) p50_ratios: Each<f64>,
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
    pub(super) order: Vec<Contender>,
    /// Latency, us.
    pub(super) latency_us: Each<LatencySummary>,
    /// Ratios of the medians.
    pub(super) p50_ratios: Each<f64>,
    /// The system's hops, us.
    pub(super) hops_us: HopSummary,
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    values.collect::<Ascending>().quantile(0.5)
}

impl Outcome {
    /// An empty outcome.
    ///
    /// # Errors
    /// If the histograms cannot be created.
    pub(super) fn new(
        scenario: &Scenario,
        pin: &Pin,
        hosts: Option<usize>,
        contenders: &[Contender],
    ) -> anyhow::Result<Self> {
        Ok(Self {
            scenario: scenario.name.clone(),
            planner: scenario.planner.name(),
            clock: scenario.clock.name(),
            rate_hz: (scenario.clock == Clock::Realtime).then_some(1.0 / scenario.dt_s),
            robots: scenario.robots.len(),
            hosts: hosts.unwrap_or(1),
            ticks: scenario.ticks,
            warm_up_ticks: warm_up_ticks(scenario),
            pin: pin.to_string(),
            latency_us: Each::default(),
            p50_ratios: Each::default(),
            hops_us: HopSummary::default(),
            rounds: Vec::new(),
            percentiles: Each::default(),
            latencies_us: Each::samples(contenders)?,
        })
    }

    /// Adds a round.
    pub(super) fn add(&mut self, order: Vec<Contender>, latencies_us: &Each<Samples>, hops_us: HopSummary) {
        let latency_us = latencies_us.map(LatencySummary::of);
        self.rounds.push(Round { order, p50_ratios: ratios(&latency_us), latency_us, hops_us });
        for (contender, of_round) in latencies_us.iter() {
            if let Some(all) = self.latencies_us.get_mut(contender) {
                all.add_all(of_round);
            }
        }
        self.latency_us = self.latencies_us.map(LatencySummary::of);
        self.percentiles = self.latencies_us.map(percentiles::curve);
        let others = ratios(&self.latency_us);
        let of_rounds =
            |contender| self.rounds.iter().filter_map(move |round| round.p50_ratios.get(contender).copied());
        self.p50_ratios = Each(others.iter().map(|(contender, _)| (contender, median(of_rounds(contender)))).collect());
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
        let rate = self.rate_hz.map_or(String::new(), |rate_hz| format!(" at {} Hz", (rate_hz * 1e4).round() / 1e4));
        let hosts = if self.hosts > 1 { format!(" on {} hosts", self.hosts) } else { String::new() };
        let what = format!("{}{hosts}, {planner} planner, {clock}{rate}, pin {pin}", counted(robots, "robot"));
        writeln!(f, "{TITLE}latency{TITLE:#}: {scenario}, {}", wrapped(&what, 11 + scenario.len()))?;
        let rounds = counted(self.rounds.len(), "round");
        writeln!(f, "  {rounds} of {ticks} ticks, of which the first {warm_up_ticks} are not counted")?;
        let [p50, p90, p99, p99_9, max] = ["p50", "p90", "p99", "p99.9", "max"];
        writeln!(
            f,
            "  {:<20}{p50:>8} {p90:>8} {p99:>8} {p99_9:>9} {max:>10} {:>9}",
            "range to heading, us", "samples"
        )?;
        for (contender, latency_us) in self.latency_us.iter() {
            let LatencySummary { count, p50, p90, p99, p99_9, max } = latency_us;
            let name = contender.to_string();
            writeln!(f, "  {name:<20}{p50:>8.1} {p90:>8.1} {p99:>8.1} {p99_9:>9.1} {max:>10.1} {count:>9}")?;
        }
        let row = |f: &mut std::fmt::Formatter<'_>, name: &str, cells: Vec<String>| {
            writeln!(f, "  {name:<20}{}", cells.iter().map(|cell| format!("{cell:>8}")).collect::<Vec<_>>().join(" "))
        };
        let names = self.p50_ratios.iter().map(|(contender, _)| contender.to_string());
        row(f, "system's p50 over", names.collect())?;
        let numbers = |ratios: &Each<f64>| ratios.iter().map(|(_, ratio)| format!("{ratio:.2}")).collect();
        for (number, round) in (1..).zip(&self.rounds) {
            row(f, &format!("round {number}"), numbers(&round.p50_ratios))?;
        }
        row(f, "median", numbers(&self.p50_ratios))?;
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
        Outcome::new(&scenario, &Pin::None, None, &Contender::on_one_host()).unwrap()
    }

    /// Latencies of one value each, ns.
    fn latencies_us(system: u64, iceoryx2: u64, futex: u64) -> Each<Samples> {
        let mut latencies_us = Each::samples(&Contender::on_one_host()).unwrap();
        for ((_, samples), value) in latencies_us.0.iter_mut().zip([system, iceoryx2, futex]) {
            samples.add(value);
        }
        latencies_us
    }

    #[test]
    fn ratios_are_the_median_of_the_rounds() {
        let mut outcome = outcome();
        for system in [1_000, 4_000, 2_000] {
            outcome.add(Contender::on_one_host(), &latencies_us(system, 2_000, 1_000), HopSummary::default());
        }
        let of = |reference| *outcome.p50_ratios.get(Contender::Reference(reference)).unwrap();
        assert_eq!([Reference::Iceoryx2, Reference::Futex].map(of), [1.0, 2.0]);
        assert_eq!(outcome.latency_us.get(Contender::System).unwrap().count, 3);
        assert_eq!(median([4.0, 1.0].into_iter()), 2.5);
    }

    #[test]
    fn each_contender_comes_first_in_turn() {
        let all = Contender::on_one_host();
        let firsts: Vec<Contender> = (1..=3).map(|round| Contender::in_turns(&all, round)[0]).collect();
        assert!(all.iter().all(|contender| firsts.contains(contender)), "{firsts:?}");
    }

    #[test]
    fn only_what_the_gateways_program_has_is_measured() {
        let names = |transports: &[&str]| {
            let transports: Vec<String> = transports.iter().map(|name| (*name).to_owned()).collect();
            Contender::on_hosts(&transports).iter().map(ToString::to_string).collect::<Vec<_>>()
        };
        assert_eq!(names(&["udp", "quic"]), ["system", "local", "quic", "udp"]);
        assert_eq!(names(&["zenoh", "udp", "quic", "other"]), ["system", "local", "quic", "udp", "zenoh"]);
    }
}
