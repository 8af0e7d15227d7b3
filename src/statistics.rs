//! Statistics, pure: quantiles, means, intervals, fits.
//!
//! Definitions of quantiles:
//!
//! | of | rule | in |
//! |---|---|---|
//! | [`Samples`], [`Ascending::measured`] | the least value that at least this part of all values do not exceed: nearest rank, as in HdrHistogram | latencies, hops and ranges; times of recovery |
//! | [`Ascending::quantile`] | linear between two ranks: Hyndman and Fan's type 7 (1996) | `compare`, medians over rounds, the axes of `report.html` |
//! | [`median`] | the middle value, the upper one of two | the trace in the report, `calibrate`, points of the live page |

use hdrhistogram::Histogram;

/// The 97.5 % quantile of the standard normal distribution: half the width of a 95 % interval, in standard deviations.
pub const Z_95: f64 = 1.959_963_984_540_054;

/// An interval.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Interval {
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

/// Two percentiles.
#[derive(Debug, Clone, Copy, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Percentiles {
    /// Median.
    pub p50: f64,
    /// 99 %.
    pub p99: f64,
}

/// Values in ascending order.
#[derive(Debug)]
pub struct Ascending(Vec<f64>);

impl FromIterator<f64> for Ascending {
    fn from_iter<I: IntoIterator<Item = f64>>(values: I) -> Self {
        let mut values: Vec<f64> = values.into_iter().collect();
        values.sort_unstable_by(f64::total_cmp);
        Self(values)
    }
}

impl Ascending {
    /// The `quantile` (0 to 1), interpolated linearly between ranks; NaN without values.
    #[must_use]
    pub fn quantile(&self, quantile: f64) -> f64 {
        let Some(last) = self.0.len().checked_sub(1) else { return f64::NAN };
        let rank = quantile.clamp(0.0, 1.0) * last as f64;
        let below = rank.floor() as usize;
        let (low, high) = (self.0[below], self.0[(below + 1).min(last)]);
        // Without the second case, equal infinities would give NaN.
        if low == high { low } else { low + (high - low) * (rank - below as f64) }
    }

    /// The least value that at least the part `quantile` (0 to 1) of all values do not exceed; `None` without values.
    #[must_use]
    pub fn measured(&self, quantile: f64) -> Option<f64> {
        let rank = (quantile * self.0.len() as f64).ceil() as usize;
        self.0.get(rank.saturating_sub(1)).copied()
    }

    /// The part of the values that are at most `limit`; 0 without values.
    #[must_use]
    pub fn fraction_at_most(&self, limit: f64) -> f64 {
        self.0.partition_point(|value| *value <= limit) as f64 / self.count().max(1) as f64
    }

    /// Number of values.
    #[must_use]
    pub fn count(&self) -> usize {
        self.0.len()
    }
}

/// A histogram of values with three digits, added in thousandths of the reported unit: ns for us, mm for m.
#[derive(Debug, Clone)]
pub struct Samples(Histogram<u64>);

impl Samples {
    /// An empty histogram.
    ///
    /// # Errors
    /// If the histogram cannot be made.
    pub fn new() -> anyhow::Result<Self> {
        Ok(Self(Histogram::new(3)?))
    }

    /// Adds a value.
    pub fn add(&mut self, thousandths: u64) {
        // The histogram grows as needed, so this cannot fail.
        let _ = self.0.record(thousandths);
    }

    /// Adds all values of another histogram.
    pub fn add_all(&mut self, other: &Self) {
        // The histogram grows here too.
        let _ = self.0.add(&other.0);
    }

    /// Removes all values.
    pub fn clear(&mut self) {
        self.0.reset();
    }

    /// Number of values.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.0.len()
    }

    /// The `quantile` (0 to 1); 0 without values.
    #[must_use]
    pub fn at(&self, quantile: f64) -> f64 {
        self.0.value_at_quantile(quantile) as f64 / 1e3
    }

    /// The largest value; 0 without values.
    #[must_use]
    pub fn max(&self) -> f64 {
        self.0.max() as f64 / 1e3
    }

    /// Median and 99 %.
    #[must_use]
    pub fn percentiles(&self) -> Percentiles {
        Percentiles { p50: self.at(0.5), p99: self.at(0.99) }
    }

    /// Quantiles with their values. They become denser towards 1: each time the remaining part halves, there are
    /// `points_per_halving` of them.
    pub fn curve(&self, points_per_halving: u32) -> impl Iterator<Item = (f64, f64)> {
        let steps = self.0.iter_quantiles(points_per_halving);
        steps.map(|step| (step.quantile_iterated_to(), step.value_iterated_to() as f64 / 1e3))
    }
}

/// The median, the upper one of two middle values; reorders the values. `None` without values.
#[must_use]
pub fn median(values: &mut [f64]) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Mean of values that are added one by one. NaN values do not count.
#[derive(Debug, Clone, Copy, Default)]
pub struct Mean {
    sum: f64,
    count: f64,
}

impl Mean {
    /// Adds a value.
    pub fn add(&mut self, value: f64) {
        if !value.is_nan() {
            self.sum += value;
            self.count += 1.0;
        }
    }

    /// Number of values.
    #[must_use]
    pub fn count(self) -> f64 {
        self.count
    }

    /// The mean of the values that were added after `earlier`, a copy of this mean.
    #[must_use]
    pub fn without(self, earlier: Self) -> Self {
        Self { sum: self.sum - earlier.sum, count: self.count - earlier.count }
    }

    /// The mean; `None` without values.
    #[must_use]
    pub fn value(self) -> Option<f64> {
        (self.count > 0.0).then(|| self.sum / self.count)
    }
}

impl std::iter::Sum for Mean {
    fn sum<I: Iterator<Item = Self>>(means: I) -> Self {
        means.fold(Self::default(), |all, mean| Self { sum: all.sum + mean.sum, count: all.count + mean.count })
    }
}

/// Mean of the values that are not NaN; NaN without values.
#[must_use]
pub fn mean(values: impl IntoIterator<Item = f64>) -> f64 {
    let mut mean = Mean::default();
    values.into_iter().for_each(|value| mean.add(value));
    mean.value().unwrap_or(f64::NAN)
}

/// Wilson's 95 % score interval of a rate, for `successes` in `trials` (Wilson 1927): unlike the normal
/// interval, it is valid near 0 and 1.
#[must_use]
pub fn wilson_interval(successes: usize, trials: usize) -> Interval {
    if trials == 0 {
        return Interval { low: 0.0, high: 1.0 };
    }
    let (n, z2) = (trials as f64, Z_95 * Z_95);
    let rate = successes as f64 / n;
    let centre = (rate + z2 / (2.0 * n)) / (1.0 + z2 / n);
    let half = Z_95 / (1.0 + z2 / n) * (rate * (1.0 - rate) / n + z2 / (4.0 * n * n)).sqrt();
    // The formula gives exactly 0 and 1 here, but not in floating point.
    let low = if successes == 0 { 0.0 } else { centre - half };
    let high = if successes == trials { 1.0 } else { centre + half };
    Interval { low, high }
}

/// The 95 % interval of the mean of `samples` independent chi-square variables of `dof` degrees of freedom each, divided by
/// `dof`: the bounds of an ANEES. By the approximation of Wilson and Hilferty (1931), accurate to 1 % from 10 degrees of
/// freedom in all.
#[must_use]
pub fn chi_square_mean_bounds(dof: usize, samples: usize) -> Interval {
    let spread = 2.0 / (9.0 * (dof * samples).max(1) as f64);
    let bound = |z: f64| (1.0 - spread + z * spread.sqrt()).max(0.0).powi(3);
    Interval { low: bound(-Z_95), high: bound(Z_95) }
}

/// `y = factor x^exponent`.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct PowerLaw {
    /// Slope on log-log axes.
    pub exponent: f64,
    /// Value at x = 1.
    pub factor: f64,
}

/// The least-squares line through points on log-log axes; `None` with fewer than two different x, or
/// points that have no logarithm.
#[must_use]
pub fn fit_power_law(points: &[(f64, f64)]) -> Option<PowerLaw> {
    let logs: Vec<(f64, f64)> = points.iter().map(|(x, y)| (x.ln(), y.ln())).collect();
    let mean_x = mean(logs.iter().map(|(x, _)| *x));
    let mean_y = mean(logs.iter().map(|(_, y)| *y));
    let (sxy, sxx) = logs
        .iter()
        .fold((0.0, 0.0), |(sxy, sxx), (x, y)| (sxy + (x - mean_x) * (y - mean_y), sxx + (x - mean_x) * (x - mean_x)));
    let exponent = sxy / sxx;
    exponent.is_finite().then(|| PowerLaw { exponent, factor: (mean_y - exponent * mean_x).exp() })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn assert_near(value: f64, expected: f64, tolerance: f64) {
        assert!((value - expected).abs() <= tolerance, "{value}, not {expected}");
    }

    fn ascending<const N: usize>(values: [f64; N]) -> Ascending {
        values.into_iter().collect()
    }

    #[test]
    fn quantiles_lie_between_ranks() {
        let values = ascending([4.0, 2.0, 3.0, 1.0]);
        assert_eq!(values.quantile(0.0), 1.0);
        assert_eq!(values.quantile(0.5), 2.5);
        assert_near(values.quantile(0.9), 3.7, 1e-12);
        assert_eq!(values.quantile(1.0), 4.0);
        assert_eq!(ascending([7.0]).quantile(0.99), 7.0);
        assert_eq!(ascending([1.0, f64::INFINITY, f64::INFINITY]).quantile(0.9), f64::INFINITY);
        assert!(ascending([]).quantile(0.5).is_nan());
    }

    #[test]
    fn measured_quantiles_are_values_of_the_sample_by_the_rule_of_a_histogram() {
        let values = ascending([4.0, 2.0, 3.0, 1.0]);
        let mut samples = Samples::new().unwrap();
        (1..=4).for_each(|value| samples.add(1_000 * value));
        for (quantile, expected) in [(0.0, 1.0), (0.25, 1.0), (0.5, 2.0), (0.51, 3.0), (0.99, 4.0), (1.0, 4.0)] {
            assert_eq!(values.measured(quantile), Some(expected));
            assert_near(samples.at(quantile), expected, 1e-3 * expected);
        }
        assert_eq!(ascending([]).measured(0.5), None);
        assert_eq!(samples.count(), 4);
        assert_eq!(Samples::new().unwrap().percentiles(), Percentiles::default());
    }

    #[test]
    fn the_median_is_the_upper_of_two() {
        assert_eq!(median(&mut [3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(median(&mut [4.0, 1.0, 3.0, 2.0]), Some(3.0));
        assert_eq!(median(&mut []), None);
    }

    #[test]
    fn a_mean_leaves_out_what_is_no_number() {
        assert_eq!(mean([1.0, f64::NAN, 3.0]), 2.0);
        assert!(mean([]).is_nan());
        let mut one = Mean::default();
        [1.0, 2.0, f64::NAN].into_iter().for_each(|value| one.add(value));
        assert_eq!([one, Mean::default(), one].into_iter().sum::<Mean>().value(), Some(1.5));
        assert_eq!((one.count(), Mean::default().value()), (2.0, None));
    }

    /// Newcombe (1998), Statistics in Medicine 17, table I, method 3.
    #[test]
    fn the_wilson_interval_is_newcombes() {
        for (successes, trials, low, high) in
            [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)]
        {
            let interval = wilson_interval(successes, trials);
            assert_near(interval.low, low, 5e-5);
            assert_near(interval.high, high, 5e-5);
        }
        assert_eq!(wilson_interval(20, 20).high, 1.0);
        assert_eq!(wilson_interval(0, 0), Interval { low: 0.0, high: 1.0 });
    }

    /// Quantiles of chi-square at 2.5 and 97.5 % from tables.
    #[test]
    fn chi_square_bounds_are_those_of_tables() {
        for (samples, low, high, tolerance) in
            [(5, 3.247, 20.483, 0.03), (50, 74.222, 129.561, 0.02), (500, 914.257, 1_089.531, 0.02)]
        {
            let bounds = chi_square_mean_bounds(2, samples);
            let dof = 2.0 * samples as f64;
            assert_near(bounds.low * dof, low, tolerance);
            assert_near(bounds.high * dof, high, tolerance);
        }
        let one = chi_square_mean_bounds(2, 1);
        assert!(one.low >= 0.0 && one.high > one.low);
    }

    #[test]
    fn a_power_law_is_found_again() {
        let points: Vec<(f64, f64)> = [1.0, 3.0, 10.0, 100.0].map(|x: f64| (x, 0.5 * x.powf(1.25))).to_vec();
        let law = fit_power_law(&points).unwrap();
        assert_near(law.exponent, 1.25, 1e-12);
        assert_near(law.factor, 0.5, 1e-12);
        assert_eq!(fit_power_law(&[(1.0, 2.0), (1.0, 3.0)]), None);
        assert_eq!(fit_power_law(&[(1.0, 2.0)]), None);
        assert_eq!(fit_power_law(&[]), None);
        assert_eq!(fit_power_law(&[(1.0, 0.0), (2.0, 1.0)]), None);
    }

    #[test]
    fn fractions_count_what_is_not_above() {
        assert_eq!(ascending([1.0, 2.0, 2.0, 9.0]).fraction_at_most(2.0), 0.75);
        assert_eq!(ascending([]).fraction_at_most(2.0), 0.0);
    }
}
