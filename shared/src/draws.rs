//! Random numbers as a pure function of (seed, stream, tick).
//!
//! No generator keeps a position between ticks: each draw starts from the ChaCha stream of its
//! purpose at the block of its tick. A process that is restarted after a kill, or that sees a
//! tick twice, draws the same numbers. The order of arrival does not matter.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, StandardNormal, StandardUniform};

/// 32-bit words reserved for one tick of one stream; a normal draw takes two, rarely more.
const WORDS_PER_TICK: u128 = 1 << 10;

/// The purpose of a random number. Each purpose, and each robot, has its own ChaCha stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stream {
    /// Process noise of the simulated target.
    TargetNoise,
    /// Error of the prior mean, when it is drawn.
    PriorMean,
    /// Headings of the random planner.
    RandomPlanner,
    /// Faults of a campaign, which has its own seed.
    Faults,
    /// Noise of one robot's range.
    RangeNoise {
        /// The robot's id.
        robot: usize,
    },
    /// Noise of one robot's bearing.
    BearingNoise {
        /// The robot's id.
        robot: usize,
    },
    /// Errors of one robot's pose and bias of its ranges.
    Nuisances {
        /// The robot's id.
        robot: usize,
    },
}

impl Stream {
    fn number(self) -> u64 {
        match self {
            Self::TargetNoise => 0,
            Self::PriorMean => 1,
            Self::RandomPlanner => 2,
            Self::Faults => 3,
            // Far above the fixed purposes, so that a new purpose does not change any robot's noise.
            Self::RangeNoise { robot } => 1_000 + robot as u64,
            Self::BearingNoise { robot } => 1_000_000 + robot as u64,
            Self::Nuisances { robot } => 2_000_000 + robot as u64,
        }
    }
}

/// The random numbers of one stream under one seed.
#[derive(Debug, Clone)]
pub struct Draws {
    generator: ChaCha8Rng,
}

impl Draws {
    /// The draws for one purpose in the run with this seed.
    #[must_use]
    pub fn new(seed: u64, stream: Stream) -> Self {
        let mut generator = ChaCha8Rng::seed_from_u64(seed);
        generator.set_stream(stream.number());
        Self { generator }
    }

    /// Fills `out` with independent draws from N(0, 1) for this tick.
    pub fn standard_normal(&mut self, tick: u64, out: &mut [f64]) {
        self.generator.set_word_pos(u128::from(tick) * WORDS_PER_TICK);
        for value in out {
            *value = StandardNormal.sample(&mut self.generator);
        }
    }

    /// The first of these draws for this tick.
    #[must_use]
    pub fn one_standard_normal(&mut self, tick: u64) -> f64 {
        let mut out = [0.0];
        self.standard_normal(tick, &mut out);
        out[0]
    }

    /// Fills `out` with independent draws from the uniform distribution on [0, 1) for this tick.
    pub fn uniform(&mut self, tick: u64, out: &mut [f64]) {
        // A draw takes two words.
        let words = WORDS_PER_TICK.max(2 * out.len() as u128);
        self.generator.set_word_pos(u128::from(tick) * words);
        for value in out {
            *value = StandardUniform.sample(&mut self.generator);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn normal(draws: &mut Draws, tick: u64) -> f64 {
        let mut out = [0.0];
        draws.standard_normal(tick, &mut out);
        out[0]
    }

    #[test]
    fn a_draw_depends_on_seed_stream_and_tick_only() {
        let mut forward = Draws::new(7, Stream::TargetNoise);
        let mut backward = forward.clone();
        let mut ahead: Vec<f64> = (0..100).map(|tick| normal(&mut forward, tick)).collect();
        let behind: Vec<f64> = (0..100).rev().map(|tick| normal(&mut backward, tick)).collect();
        ahead.reverse();
        assert_eq!(ahead, behind);
        assert_ne!(normal(&mut forward, 3), normal(&mut Draws::new(8, Stream::TargetNoise), 3));
        assert_ne!(normal(&mut forward, 3), normal(&mut Draws::new(7, Stream::PriorMean), 3));
    }

    #[test]
    fn the_widest_tick_does_not_reach_into_the_next() {
        for robots in [1, 500, crate::ROBOTS_MAX] {
            let mut draws = Draws::new(1, Stream::RandomPlanner);
            let mut headings = vec![0.0; robots];
            draws.uniform(5, &mut headings);
            let end = draws.generator.get_word_pos();
            draws.uniform(6, &mut headings[..]);
            assert!(end <= draws.generator.get_word_pos() - 2 * robots as u128);
        }
    }

    #[test]
    fn moments_are_those_of_the_standard_normal() {
        let mut draws = Draws::new(11, Stream::RangeNoise { robot: 4 });
        let samples: Vec<f64> = (0..200_000).map(|tick| normal(&mut draws, tick)).collect();
        let mean = samples.iter().sum::<f64>() / samples.len() as f64;
        let variance = samples.iter().map(|x| x * x).sum::<f64>() / samples.len() as f64;
        assert!(mean.abs() < 0.01, "mean {mean}");
        assert!((variance - 1.0).abs() < 0.015, "variance {variance}");
    }
}
