//! The band of chance of a normalised error whose samples are correlated in time.

use serde::Serialize;

use crate::statistics::{Interval, chi_square_mean_bounds, mean};

/// Most batches; beyond it, two neighbours are merged.
const BATCHES_MAX: usize = 64;

/// Number of batches whose means are compared: few, so that each is longer than a filter's memory.
const COMPARED: usize = 16;

/// The mean of normalised squares in order of time (NIS or NEES, each per degree of freedom), and the effective number
/// of independent samples.
///
/// The errors of two successive ticks are almost equal, so a band for as many samples as there are ticks would
/// be far too narrow. The variance of means over batches of consecutive ticks (batch means, Conway 1963) gives the
/// effective number of independent samples. Memory is bounded: batches grow with the series.
#[derive(Debug, Clone, Default)]
pub struct Consistency {
    batches: Vec<Batch>,
    /// Ticks in a full batch.
    batch_len: u64,
    sum: f64,
    square_sum: f64,
    ticks: u64,
    dof: f64,
}

#[derive(Debug, Clone, Copy, Default)]
struct Batch {
    sum: f64,
    dof: f64,
    ticks: u64,
}

/// A mean with the band in which it lies for a consistent filter.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ConsistencySummary {
    /// Mean per degree of freedom: 1 for a consistent filter.
    pub mean: f64,
    /// The 95 % band of a consistent filter, for the ticks that were covered.
    pub band_95: Interval,
    /// Effective number of independent samples.
    pub independent_samples: f64,
}

impl ConsistencySummary {
    /// A mean over independent samples of so many degrees of freedom each.
    #[must_use]
    pub fn new(mean: f64, independent_samples: f64, dof_each: f64) -> Self {
        let dof = (independent_samples * dof_each).round().max(1.0);
        Self { mean, band_95: chi_square_mean_bounds(1, dof as usize), independent_samples }
    }

    /// True if the filter is overconfident by more than chance and rounding of its noise explain:
    /// the errors are at least 1.4 times as large as it believes.
    #[must_use]
    pub fn is_overconfident(&self) -> bool {
        self.mean > self.band_95.high.max(2.0)
    }
}

impl Consistency {
    /// Adds a tick's normalised square, which has so many degrees of freedom.
    pub fn add(&mut self, square: f64, dof: u64) {
        let dof = dof as f64;
        if dof == 0.0 || !square.is_finite() {
            return;
        }
        let normalised = square / dof;
        self.sum += square;
        self.square_sum += normalised * normalised;
        self.dof += dof;
        self.ticks += 1;
        if self.batches.last().is_none_or(|last| last.ticks >= self.batch_len.max(1)) {
            if self.batches.len() == BATCHES_MAX {
                self.halve();
            }
            self.batches.push(Batch::default());
        }
        if let Some(batch) = self.batches.last_mut() {
            batch.sum += square;
            batch.dof += dof;
            batch.ticks += 1;
        }
    }

    /// Merges each pair of batches.
    fn halve(&mut self) {
        self.batch_len = 2 * self.batch_len.max(1);
        let pairs = self.batches.chunks(2).map(|pair| {
            pair.iter().fold(Batch::default(), |all, batch| Batch {
                sum: all.sum + batch.sum,
                dof: all.dof + batch.dof,
                ticks: all.ticks + batch.ticks,
            })
        });
        self.batches = pairs.collect();
    }

    /// The mean; `None` if empty.
    #[must_use]
    pub fn mean(&self) -> Option<f64> {
        (self.dof > 0.0).then(|| self.sum / self.dof)
    }

    /// The mean and its band; `None` if empty.
    #[must_use]
    pub fn summary(&self) -> Option<ConsistencySummary> {
        self.mean().map(|mean| {
            let independent_samples = self.independent_samples();
            let dof_each = self.dof / self.ticks as f64;
            ConsistencySummary::new(mean, independent_samples, dof_each)
        })
    }

    /// Variance of one tick over the variance of the mean.
    fn independent_samples(&self) -> f64 {
        let ticks = self.ticks as f64;
        let together = self.batches.len() / COMPARED;
        if together < 2 {
            // The series is too short: a cautious guess for a filter with a memory of some ticks.
            return (ticks / 8.0).max(1.0);
        }
        let means = || {
            let long = self.batches.chunks_exact(together);
            long.map(|long| {
                long.iter().map(|batch| batch.sum).sum::<f64>() / long.iter().map(|batch| batch.dof).sum::<f64>()
            })
        };
        let count = means().count() as f64;
        let centre = mean(means());
        let variance_of_batches = means().map(|value| (value - centre).powi(2)).sum::<f64>() / (count - 1.0);
        let mean_of_ticks = self.sum / self.dof;
        let variance_of_ticks = (self.square_sum / ticks - mean_of_ticks * mean_of_ticks).max(0.0);
        let variance_of_mean = variance_of_batches / count;
        if variance_of_mean > 0.0 { (variance_of_ticks / variance_of_mean).clamp(1.0, ticks) } else { ticks }
    }
}

#[cfg(test)]
mod tests {
    use rangehound_shared::draws::{Draws, Stream};

    use super::*;

    /// A series of errors, each with a part `memory` of its predecessor.
    fn errors(memory: f64, sigma: f64, ticks: usize, seed: u64) -> ConsistencySummary {
        let mut draws = Draws::new(seed, Stream::RangeNoise { robot: 0 });
        let mut consistency = Consistency::default();
        let mut error = 0.0;
        for tick in 0..ticks as u64 {
            let mut normal = [0.0];
            draws.standard_normal(tick, &mut normal);
            error = memory * error + (1.0 - memory * memory).sqrt() * normal[0];
            consistency.add((sigma * error).powi(2), 1);
        }
        consistency.summary().unwrap()
    }

    #[test]
    fn independent_samples_count_fully_and_correlated_ones_do_not() {
        let free = errors(0.0, 1.0, 4_000, 1);
        assert!(free.independent_samples > 1_500.0, "{free:?}");
        // The squares of these errors have a correlation of 0.95^2 from tick to tick: n / 19 effective samples.
        let bound = errors(0.95, 1.0, 4_000, 2);
        assert!((70.0..700.0).contains(&bound.independent_samples), "{bound:?}");
    }

    #[test]
    fn a_consistent_filter_is_hardly_ever_called_overconfident_and_one_off_by_two_always() {
        let alarms = (0..200).filter(|seed| errors(0.9, 1.0, 300, *seed).is_overconfident()).count();
        assert!(alarms <= 4, "{alarms} of 200");
        let missed = (0..200).filter(|seed| !errors(0.9, 2.0, 300, *seed).is_overconfident()).count();
        assert!(missed <= 10, "{missed} of 200");
    }

    #[test]
    fn memory_is_bounded() {
        let mut consistency = Consistency::default();
        assert_eq!(consistency.summary(), None);
        (0..100_000).for_each(|_| consistency.add(2.0, 2));
        assert!(consistency.batches.len() <= BATCHES_MAX);
        let summary = consistency.summary().unwrap();
        assert_eq!(summary.mean, 1.0);
        consistency.add(f64::NAN, 1);
        assert_eq!(consistency.summary().unwrap(), summary);
    }
}
