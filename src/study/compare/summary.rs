//! The summary of the runs: the figures of `compare.json` and of the table.

use std::fmt::{Display, Formatter};

use rangehound_shared::scenario::Scenario;
use serde::Serialize;

use super::monte_carlo::{Sample, Trial};
use super::planning_time::Scaling;
use crate::statistics::{Ascending, Interval, Percentiles, chi_square_mean_bounds, mean, wilson_interval};
use crate::terminal::{TITLE, counted};

/// A run has diverged if its mean position error over this many last ticks is above
/// [`DIVERGED_ERROR_M`].
pub const DIVERGED_TICKS: usize = 50;

/// See [`DIVERGED_TICKS`]; m.
pub const DIVERGED_ERROR_M: f64 = 10.0;

/// Range of the gaps at which their distribution is given, in decades from the smallest, which is below a certificate's
/// tolerance.
const GAP_DECADES: std::ops::RangeInclusive<i32> = -12..=0;

/// Points of the distribution per decade.
const GAP_POINTS: i32 = 20;

/// The whole comparison; its fields are the keys of `compare.json`.
#[derive(Debug, Clone, Serialize)]
pub struct Comparison {
    /// Name of the scenario.
    pub scenario: String,
    /// Seed of the first run.
    pub seed: u64,
    /// Runs of each planner.
    pub runs: u64,
    /// Time steps of a run.
    pub ticks: u64,
    /// Robots.
    pub robots: usize,
    /// The meaning of the gaps.
    pub gap_meaning: &'static str,
    /// Least distance of robots to the predicted target, m.
    pub stand_off_m: f64,
    /// The same as a multiple of the square root of its position trace; the larger counts.
    pub stand_off_sigma: f64,
    /// Wall time of the runs, s.
    pub wall_s: f64,
    /// The 95 % band of a consistent filter's ANEES at a tick.
    pub anees_bounds: Interval,
    /// Times of the series, s.
    pub time_s: Vec<f64>,
    /// The planners.
    pub planners: Vec<Summary>,
    /// Planning time over the size of the team.
    pub planning_time: Vec<Scaling>,
}

/// The figures of one planner. Figures over all runs include the diverged runs.
#[derive(Debug, Clone, Serialize)]
pub struct Summary {
    /// The planner.
    pub name: String,
    /// Trace of the position covariance, m^2.
    pub position_trace_m2: OverTime,
    /// Largest eigenvalue of the position covariance, m^2.
    pub max_eigenvalue_m2: OverTime,
    /// Root mean square of the position error, m.
    pub position_rmse_m: Rmse,
    /// Position error squared over its covariance per degree of freedom, mean over runs and ticks: 1 for a consistent
    /// filter.
    pub anees: f64,
    /// Innovation squared over its covariance per range, mean over runs and ticks: 1 for a consistent filter.
    pub nis_per_dof: f64,
    /// Runs that lost the target.
    pub divergence: Divergence,
    /// Time of a step's planning, from the estimate to the headings, us.
    pub planning_us: Percentiles,
    /// How far the plan is from the certified lower bound of the same problem: see [`Comparison::gap_meaning`].
    pub gap: Spread,
    /// The planned position trace above the least that the bound allows, %.
    pub trace_excess_percent: Spread,
    /// Share of the steps whose bound is not proven to be the optimum.
    pub uncertified: f64,
    /// By tick.
    pub series: Series,
    /// (gap, part of the steps with at most this gap).
    pub gap_distribution: Vec<(f64, f64)>,
}

/// A quantity's median over the runs.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct OverTime {
    /// At the last tick.
    pub r#final: f64,
    /// Its mean over the ticks.
    pub mean: f64,
}

/// Root mean squares, m.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Rmse {
    /// Over all runs and ticks.
    pub all: f64,
    /// Of a run: median over the runs.
    pub median: f64,
    /// Of a run: 95 % of the runs have at most this.
    pub p95: f64,
}

/// How many runs diverged.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Divergence {
    /// Number of them.
    pub runs: usize,
    /// Part of all runs.
    pub rate: f64,
    /// Wilson's 95 % interval of the rate.
    pub interval: Interval,
}

/// Percentiles over all steps of all runs.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Spread {
    /// Median.
    pub p50: f64,
    /// 99 %.
    pub p99: f64,
    /// Largest.
    pub max: f64,
}

/// Figures over the runs by tick, from tick 1.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Series {
    /// Trace of the position covariance, m^2.
    pub trace_m2: Band,
    /// Mean position error squared over its covariance, per degree of freedom.
    pub anees: Vec<f64>,
    /// Root mean square of the position error, m.
    pub rmse_m: Vec<f64>,
}

/// Percentiles by tick.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Band {
    /// 10 %.
    pub p10: Vec<f64>,
    /// Median.
    pub median: Vec<f64>,
    /// 90 %.
    pub p90: Vec<f64>,
}

impl Summary {
    /// Sums up the runs of a planner, in their order.
    #[must_use]
    pub fn new(name: &str, trials: &[Trial], ticks: u64) -> Self {
        let samples = || trials.iter().flat_map(|trial| &trial.samples);
        let sorted = |value: fn(&Sample) -> f64| samples().map(value).collect::<Ascending>();
        let at = |tick: usize| trials.iter().filter_map(move |trial| trial.samples.get(tick));
        let ticks = ticks as usize;

        let mut series = Series::default();
        let mut max_eigenvalues_m2 = Vec::with_capacity(ticks);
        for tick in 0..ticks {
            let traces_m2: Ascending = at(tick).map(|sample| sample.trace_m2).collect();
            series.trace_m2.p10.push(traces_m2.quantile(0.1));
            series.trace_m2.median.push(traces_m2.quantile(0.5));
            series.trace_m2.p90.push(traces_m2.quantile(0.9));
            series.anees.push(mean(at(tick).map(|sample| sample.nees / 2.0)));
            series.rmse_m.push(mean(at(tick).map(|sample| sample.squared_error_m2)).sqrt());
            let eigenvalues_m2: Ascending = at(tick).map(|sample| sample.max_eigenvalue_m2).collect();
            max_eigenvalues_m2.push(eigenvalues_m2.quantile(0.5));
        }

        let rmse_of_runs_m: Ascending = trials.iter().map(|trial| root_mean_square(&trial.samples)).collect();
        let diverged = trials.iter().filter(|trial| trial.has_diverged(DIVERGED_TICKS, DIVERGED_ERROR_M)).count();
        let gaps = sorted(|sample| sample.gap);
        let planning_us = sorted(|sample| sample.planning_ns as f64 / 1e3);
        let uncertified = samples().filter(|sample| !sample.certified).count();
        let (nis, fused) = trials.iter().fold((0.0, 0), |(nis, fused), trial| (nis + trial.nis, fused + trial.fused));
        Self {
            name: name.to_owned(),
            position_trace_m2: OverTime::of(&series.trace_m2.median),
            max_eigenvalue_m2: OverTime::of(&max_eigenvalues_m2),
            position_rmse_m: Rmse {
                all: mean(samples().map(|sample| sample.squared_error_m2)).sqrt(),
                median: rmse_of_runs_m.quantile(0.5),
                p95: rmse_of_runs_m.quantile(0.95),
            },
            anees: mean(samples().map(|sample| sample.nees / 2.0)),
            nis_per_dof: nis / fused as f64,
            divergence: Divergence {
                runs: diverged,
                rate: diverged as f64 / trials.len() as f64,
                interval: wilson_interval(diverged, trials.len()),
            },
            planning_us: Percentiles { p50: planning_us.quantile(0.5), p99: planning_us.quantile(0.99) },
            trace_excess_percent: Spread::of(&sorted(|sample| 100.0 * sample.trace_excess)),
            gap: Spread::of(&gaps),
            uncertified: uncertified as f64 / gaps.count() as f64,
            gap_distribution: distribution(&gaps),
            series,
        }
    }
}

/// The meaning of the gaps of plans for these scenarios, in at most 80 characters.
#[must_use]
pub fn gap_meaning(scenarios: &[Scenario]) -> &'static str {
    let range_only = scenarios.iter().filter(|scenario| scenario.is_range_only()).count();
    match range_only {
        all if all == scenarios.len() => "|S| above its certified bound, relative to the sum of all lambda",
        0 => "criterion above its certified bound, relative to that bound",
        _ => "|S| above its bound / sum of all lambda, or criterion above its bound / bound",
    }
}

/// Bounds of an ANEES at a tick; the position has two degrees of freedom.
#[must_use]
pub fn anees_bounds(runs: u64) -> Interval {
    chi_square_mean_bounds(2, runs as usize)
}

fn root_mean_square(samples: &[Sample]) -> f64 {
    mean(samples.iter().map(|sample| sample.squared_error_m2)).sqrt()
}

fn distribution(gaps: &Ascending) -> Vec<(f64, f64)> {
    let points = GAP_DECADES.start() * GAP_POINTS..=GAP_DECADES.end() * GAP_POINTS;
    let at = |point| 10_f64.powf(f64::from(point) / f64::from(GAP_POINTS));
    points.map(|point| (at(point), gaps.fraction_at_most(at(point)))).collect()
}

impl OverTime {
    fn of(medians: &[f64]) -> Self {
        Self { r#final: medians.last().copied().unwrap_or(f64::NAN), mean: mean(medians.iter().copied()) }
    }
}

impl Spread {
    fn of(values: &Ascending) -> Self {
        Self { p50: values.quantile(0.5), p99: values.quantile(0.99), max: values.quantile(1.0) }
    }
}

impl Display for Comparison {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        let Self { scenario, robots, runs, ticks, seed, stand_off_m, stand_off_sigma, anees_bounds, .. } = self;
        let stand_off = match stand_off_sigma {
            0.0 => format!("{stand_off_m} m"),
            sigma => format!("{stand_off_m} m or {sigma} sigma"),
        };
        let last_seed = seed.wrapping_add(runs.saturating_sub(1));
        writeln!(f, "{TITLE}{scenario}{TITLE:#}: {}, stand-off {stand_off}, {ticks} ticks", counted(robots, "robot"))?;
        let wall_s = self.wall_s;
        let seeds = if *runs == 1 { format!("seed {seed}") } else { format!("seeds {seed} to {last_seed}") };
        writeln!(f, "{} for each row, {seeds}, in {wall_s:.1} s", counted(runs, "run"))?;
        writeln!(f)?;
        let of = |name: &str| self.planning_time.iter().find(|scaling| scaling.name == name);
        let names = self.planners.iter().map(|planner| planner.name.chars().count()).max().unwrap_or(0).max(10);
        let blank = "";
        writeln!(f, "{blank:names$}{:>16}{:>16}{:>24}", "trace, m²", "variance, m²", "trace above optimum, %")?;
        write_row(f, names, "", ["end", "mean", "end", "mean", "p50", "p99", "max"])?;
        for planner in &self.planners {
            write_row(f, names, &planner.name, planner.uncertainty())?;
        }
        writeln!(f)?;
        writeln!(f, "{blank:names$}{:>24}{:>16}{:>22}", "position error, m", "consistency", "diverged, %")?;
        write_row(f, names, "", ["RMS", "median", "p95", "ANEES", "NIS", "rate", "95 % interval"])?;
        for planner in &self.planners {
            write_row(f, names, &planner.name, planner.errors())?;
        }
        writeln!(f)?;
        writeln!(f, "{blank:names$}{:>24}{:>24}", "planning, us", "plan above optimum")?;
        write_row(f, names, "", ["p50", "p99", "over M", "p50", "p99", "max"])?;
        for planner in &self.planners {
            write_row(f, names, &planner.name, planner.planning(of(&planner.name)))?;
        }
        let Interval { low, high } = anees_bounds;
        let gap_meaning = self.gap_meaning;
        write!(
            f,
            "
Trace and variance (largest eigenvalue) of the position covariance: median over
the runs, at the end and its mean over time. Errors, ANEES and NIS include all
runs, diverged ones too; ANEES and NIS are ideally 1, and at one tick 95 % of
consistent filters have an ANEES from {low:.2} to {high:.2}. Diverged: over {DIVERGED_ERROR_M} m off
in the mean of the last {DIVERGED_TICKS} ticks. Trace above optimum: against the least trace
that the certified lower bound of the same step allows. Plan above optimum:
{gap_meaning}.
Over M: the power law of the time to plan, over teams of M = 10 to 1000 robots;
larger teams are left out once a planner takes too long."
        )
    }
}

/// A row of a table: a name in a column of this width, and figures below their column heads.
fn write_row(
    f: &mut Formatter<'_>,
    width: usize,
    name: &str,
    figures: impl IntoIterator<Item = impl Display>,
) -> std::fmt::Result {
    write!(f, "{name:<width$}")?;
    for figure in figures {
        write!(f, " {figure:>7}")?;
    }
    writeln!(f)
}

impl Summary {
    fn uncertainty(&self) -> [String; 7] {
        let Self { position_trace_m2, max_eigenvalue_m2, trace_excess_percent: excess, .. } = self;
        [
            position_trace_m2.r#final,
            position_trace_m2.mean,
            max_eigenvalue_m2.r#final,
            max_eigenvalue_m2.mean,
            excess.p50,
            excess.p99,
            excess.max,
        ]
        .map(figure)
    }

    fn errors(&self) -> [String; 7] {
        let Self { position_rmse_m, divergence: Divergence { rate, interval: Interval { low, high }, .. }, .. } = self;
        [
            figure(position_rmse_m.all),
            figure(position_rmse_m.median),
            figure(position_rmse_m.p95),
            figure(self.anees),
            figure(self.nis_per_dof),
            percent(*rate),
            format!("{:>13}", format!("{} to {}", percent(*low), percent(*high))),
        ]
    }

    fn planning(&self, scaling: Option<&Scaling>) -> [String; 6] {
        let Self { planning_us, gap, .. } = self;
        let law = scaling.and_then(|scaling| scaling.law);
        [
            figure(planning_us.p50),
            figure(planning_us.p99),
            law.map_or(String::new(), |law| format!("M^{:.2}", law.exponent)),
            figure(gap.p50),
            figure(gap.p99),
            figure(gap.max),
        ]
    }
}

/// A rate in percent; a small one with its first digit.
fn percent(rate: f64) -> String {
    match 100.0 * rate {
        0.0 => "0.0".to_owned(),
        small if small < 0.0095 => format!("{small:.3}"),
        small if small < 0.095 => format!("{small:.2}"),
        percent => format!("{percent:.1}"),
    }
}

/// A number in at most seven characters.
fn figure(value: f64) -> String {
    match value.abs() {
        size if size.is_nan() => "-".to_owned(),
        0.0 => "0".to_owned(),
        size if size < 1e-3 => format!("{value:.1e}"),
        size if size < 10.0 => format!("{value:.3}"),
        size if size < 100.0 => format!("{value:.2}"),
        size if size < 1e3 => format!("{value:.1}"),
        size if size < 1e5 => format!("{value:.0}"),
        _ => format!("{value:.1e}"),
    }
}

#[cfg(test)]
mod tests {
    use rangehound_shared::scenario::ScenarioFile;

    use super::*;

    fn trial(errors_m: &[f64]) -> Trial {
        let sample = |error_m: &f64| Sample {
            trace_m2: 2.0,
            max_eigenvalue_m2: 1.0,
            squared_error_m2: error_m * error_m,
            nees: error_m * error_m,
            gap: 1e-6,
            trace_excess: 0.01,
            certified: true,
            planning_ns: 1_000,
        };
        let samples: Vec<Sample> = errors_m.iter().map(sample).collect();
        Trial { nis: samples.len() as f64, fused: samples.len() as u64, samples, out_of_bounds: false }
    }

    #[test]
    fn runs_add_up() {
        let summary = Summary::new("test", &[trial(&[3.0, 4.0]), trial(&[0.0, 0.0])], 2);
        assert_eq!(summary.position_rmse_m.all, 2.5);
        assert_eq!(summary.position_rmse_m.median, 12.5_f64.sqrt() / 2.0);
        assert_eq!(summary.anees, 25.0 / 8.0);
        assert_eq!(summary.nis_per_dof, 1.0);
        assert_eq!(summary.series.anees, [2.25, 4.0]);
        assert_eq!(summary.series.trace_m2.median, [2.0, 2.0]);
        assert_eq!(summary.divergence.runs, 0);
        assert_eq!(summary.planning_us.p99, 1.0);
    }

    /// A run that ends early has diverged; later ticks are averaged over the others.
    #[test]
    fn lost_runs_are_counted() {
        let mut ended = trial(&[1.0]);
        ended.out_of_bounds = true;
        let lost = trial(&[[0.0; 10].as_slice(), [11.0; DIVERGED_TICKS].as_slice()].concat());
        let found = trial(&[[99.0; 10].as_slice(), [1.0; DIVERGED_TICKS].as_slice()].concat());
        let summary = Summary::new("test", &[ended, lost, found], 60);
        assert_eq!(summary.divergence.runs, 2);
        assert_eq!(summary.series.rmse_m.len(), 60);
        assert_eq!(summary.series.rmse_m[59], 61.0_f64.sqrt());
    }

    #[test]
    fn a_gap_distribution_rises_from_none_to_all() {
        let distribution = distribution(&[1e-6; 4].into_iter().collect());
        assert_eq!(distribution.first().map(|(_, part)| *part), Some(0.0));
        assert_eq!(distribution.last(), Some(&(1.0, 1.0)));
        assert!(distribution.is_sorted());
    }

    /// As a footnote it ends with a full stop in 80 columns.
    #[test]
    fn the_meaning_of_the_gaps_is_that_of_the_sensors() {
        let scenario = |text: &str| Scenario::from_file(&ScenarioFile::parse(text, "test").unwrap(), "test").unwrap();
        let ranges = scenario("");
        let cameras = scenario("[sensor.camera]\nbearing_std_rad = 0.1\n[robots]\nsensor = \"camera\"\n");
        let uncertain = scenario("[localiser.gps]\nstd_m = 1.0\n[robots]\nlocaliser = \"gps\"\n");
        let of_ranges = gap_meaning(&[ranges.clone(), ranges.clone()]);
        let of_others = gap_meaning(&[cameras.clone(), uncertain]);
        let of_both = gap_meaning(&[cameras, ranges]);
        assert!(of_ranges.contains("|S|") && !of_ranges.contains("criterion"), "{of_ranges}");
        assert!(of_others.contains("criterion") && !of_others.contains("|S|"), "{of_others}");
        assert!(of_both.contains("|S|") && of_both.contains("criterion"), "{of_both}");
        assert!([of_ranges, of_others, of_both].iter().all(|meaning| meaning.len() < 80));
    }

    #[test]
    fn small_rates_are_not_rounded_to_none() {
        for (rate, text) in [(0.0, "0.0"), (3.84e-4, "0.04"), (1.8e-5, "0.002"), (1e-3, "0.1"), (0.95, "95.0")] {
            assert_eq!(percent(rate), text);
        }
    }

    #[test]
    fn figures_are_short() {
        for (value, text) in [(0.0, "0"), (1.2345, "1.234"), (123.45, "123.5"), (1e-7, "1.0e-7"), (1e300, "1.0e300")] {
            assert_eq!(figure(value), text);
        }
        assert_eq!(figure(f64::NAN), "-");
    }
}
