//! Statistics, pure: percentiles, intervals, fits.

/// The standard normal distribution's 97.5 % quantile.
const Z_95: f64 = 1.959_963_984_540_054;

/// An interval.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Interval {
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

/// The `quantile` (0 to 1) of values in ascending order, interpolated linearly between ranks; NaN of
/// nothing.
#[must_use]
pub fn percentile(ascending: &[f64], quantile: f64) -> f64 {
    let Some(last) = ascending.len().checked_sub(1) else { return f64::NAN };
    let rank = quantile.clamp(0.0, 1.0) * last as f64;
    let below = rank.floor() as usize;
    let (low, high) = (ascending[below], ascending[(below + 1).min(last)]);
    // Without the second case, equal infinities would give NaN.
    if low == high { low } else { low + (high - low) * (rank - below as f64) }
}

/// The upper median of values in any order, which are reordered; `None` of nothing.
#[must_use]
pub fn median(values: &mut [f64]) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Mean of the values that are numbers; NaN of nothing.
#[must_use]
pub fn mean(values: impl IntoIterator<Item = f64>) -> f64 {
    let numbers = values.into_iter().filter(|value| !value.is_nan());
    let (sum, count) = numbers.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    sum / count
}

/// Wilson's 95 % score interval of a rate, for `successes` in `trials` (Wilson 1927): unlike the normal
/// interval it holds near 0 and 1.
#[must_use]
pub fn wilson_interval(successes: usize, trials: usize) -> Interval {
    if trials == 0 {
        return Interval { low: 0.0, high: 1.0 };
    }
    let (n, z2) = (trials as f64, Z_95 * Z_95);
    let rate = successes as f64 / n;
    let centre = (rate + z2 / (2.0 * n)) / (1.0 + z2 / n);
    let half = Z_95 / (1.0 + z2 / n) * (rate * (1.0 - rate) / n + z2 / (4.0 * n * n)).sqrt();
    // At 0 and at 1 the ends are exact, but not in floating point.
    let low = if successes == 0 { 0.0 } else { centre - half };
    let high = if successes == trials { 1.0 } else { centre + half };
    Interval { low, high }
}

/// Where the mean of `samples` independent chi-square variables of `dof` degrees of freedom each, divided
/// by `dof`, lies with 95 %: the bounds of an ANEES. By Wilson and Hilferty's cube (1931), within 1 %
/// from 10 degrees of freedom in all.
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

/// The part of values in ascending order that is at most `limit`.
#[must_use]
pub fn fraction_at_most(ascending: &[f64], limit: f64) -> f64 {
    ascending.partition_point(|value| *value <= limit) as f64 / ascending.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn assert_near(value: f64, expected: f64, tolerance: f64) {
        assert!((value - expected).abs() <= tolerance, "{value}, not {expected}");
    }

    #[test]
    fn percentiles_lie_between_ranks() {
        let values = [1.0, 2.0, 3.0, 4.0];
        assert_eq!(percentile(&values, 0.0), 1.0);
        assert_eq!(percentile(&values, 0.5), 2.5);
        assert_near(percentile(&values, 0.9), 3.7, 1e-12);
        assert_eq!(percentile(&values, 1.0), 4.0);
        assert_eq!(percentile(&[7.0], 0.99), 7.0);
        assert_eq!(percentile(&[1.0, f64::INFINITY, f64::INFINITY], 0.9), f64::INFINITY);
        assert!(percentile(&[], 0.5).is_nan());
    }

    #[test]
    fn a_mean_leaves_out_what_is_no_number() {
        assert_eq!(mean([1.0, f64::NAN, 3.0]), 2.0);
        assert!(mean([]).is_nan());
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
        assert_eq!(fraction_at_most(&[1.0, 2.0, 2.0, 9.0], 2.0), 0.75);
        assert_eq!(fraction_at_most(&[], 2.0), 0.0);
    }
}
