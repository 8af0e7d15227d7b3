//! The errors that stay: of a robot's pose, and the bias of its ranges.

use rangehound_shared::angle::wrapped_rad;
use rangehound_shared::draws::{Draws, Stream};
use rangehound_shared::measurement::Pose;
use rangehound_shared::scenario::{NuisanceSpec, PoseCorrelation};
use serde::{Deserialize, Serialize};

/// One robot's errors at a tick.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct Errors {
    /// Believed less true position, m.
    position_m: [f64; 2],
    /// Believed less true heading, rad.
    heading_rad: f64,
    /// Bias of its ranges, m.
    pub(crate) bias_m: f64,
}

impl Errors {
    /// Where a robot at this pose believes it is. The covariance is its localiser's to say.
    pub(crate) fn believed(&self, pose: Pose) -> Pose {
        let [x_m, y_m] = self.position_m;
        let heading_rad = wrapped_rad(pose.heading_rad + self.heading_rad);
        Pose { x_m: pose.x_m + x_m, y_m: pose.y_m + y_m, heading_rad, ..pose }
    }

    /// All its numbers.
    pub(crate) fn numbers(&self) -> [f64; 4] {
        let Self { position_m: [x_m, y_m], heading_rad, bias_m } = *self;
        [x_m, y_m, heading_rad, bias_m]
    }
}

/// How one robot's errors change: `e(k+1) = f e(k) + s w(k)`, with independent standard normals `w`.
#[derive(Debug, Clone)]
pub(crate) struct ErrorModel {
    start: Scales,
    keep: Scales,
    step: Scales,
    /// `None` for a robot without errors.
    noise: Option<Draws>,
}

/// A factor for each kind of error.
#[derive(Debug, Clone, Copy)]
struct Scales {
    position: f64,
    heading: f64,
    bias: f64,
}

impl ErrorModel {
    pub(crate) fn new(spec: &NuisanceSpec, dt_s: f64, seed: u64, robot: usize) -> Self {
        let markov = |time_s: f64| (-dt_s / time_s).exp();
        let (position, heading) = match spec.correlation {
            PoseCorrelation::White => (0.0, 0.0),
            PoseCorrelation::Time(time_s) => (markov(time_s), markov(time_s)),
            // A heading does not drift: its error stays.
            PoseCorrelation::Drift | PoseCorrelation::Inferred => (1.0, 1.0),
        };
        let keep = Scales { position, heading, bias: spec.bias_correlation_s.map_or(1.0, markov) };
        // The variance of a stationary error stays.
        let fresh = |keep: f64, std: f64| std * (1.0 - keep * keep).sqrt();
        let step = Scales {
            position: fresh(keep.position, spec.pose_std_m) + spec.pose_drift_m * dt_s.sqrt(),
            heading: fresh(keep.heading, spec.heading_std_rad),
            bias: fresh(keep.bias, spec.bias_std_m),
        };
        let start = Scales { position: spec.pose_std_m, heading: spec.heading_std_rad, bias: spec.bias_std_m };
        let is_exact = [start, step].iter().all(|of| [of.position, of.heading, of.bias] == [0.0; 3]);
        let noise = (!is_exact).then(|| Draws::new(seed, Stream::Nuisances { robot }));
        Self { start, keep, step, noise }
    }

    /// The errors at tick 0.
    pub(crate) fn start(&mut self) -> Errors {
        let mut errors = Errors::default();
        self.add(0, self.start, &mut errors);
        errors
    }

    /// The errors at the next tick, which is this one.
    pub(crate) fn advance(&mut self, tick: u64, errors: &mut Errors) {
        let Scales { position, heading, bias } = self.keep;
        errors.position_m = errors.position_m.map(|error_m| position * error_m);
        errors.heading_rad *= heading;
        errors.bias_m *= bias;
        self.add(tick, self.step, errors);
    }

    fn add(&mut self, tick: u64, scales: Scales, errors: &mut Errors) {
        let Some(noise) = &mut self.noise else { return };
        let mut normal = [0.0; 4];
        noise.standard_normal(tick, &mut normal);
        let [x, y, heading, bias] = normal;
        errors.position_m[0] += scales.position * x;
        errors.position_m[1] += scales.position * y;
        errors.heading_rad += scales.heading * heading;
        errors.bias_m += scales.bias * bias;
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;

    /// Variances of the errors at one tick, over many robots.
    fn variances(spec: NuisanceSpec, ticks: u64) -> [f64; 4] {
        let robots = 4_000;
        let mut sums = [0.0; 4];
        for robot in 0..robots {
            let mut model = ErrorModel::new(&spec, 0.1, 7, robot);
            let mut errors = model.start();
            (1..=ticks).for_each(|tick| model.advance(tick, &mut errors));
            sums.iter_mut().zip(errors.numbers()).for_each(|(sum, error)| *sum += error * error);
        }
        sums.map(|sum| sum / robots as f64)
    }

    #[test]
    fn errors_have_the_variances_of_their_model() {
        let spec = NuisanceSpec { pose_std_m: 2.0, heading_std_rad: 0.1, bias_std_m: 0.5, ..NuisanceSpec::default() };
        let white = NuisanceSpec { correlation: PoseCorrelation::White, ..spec };
        let markov = NuisanceSpec { correlation: PoseCorrelation::Time(3.0), bias_correlation_s: Some(3.0), ..spec };
        for spec in [white, markov] {
            for ticks in [0, 1, 40] {
                let expected = [4.0, 4.0, 0.01, 0.25];
                for (variance, expected) in variances(spec, ticks).into_iter().zip(expected) {
                    // Five standard deviations of a sample variance.
                    assert!((variance / expected - 1.0).abs() < 0.112, "{variance} {expected}");
                }
            }
        }
        let drift = NuisanceSpec { pose_drift_m: 0.5, correlation: PoseCorrelation::Drift, ..spec };
        let [x_m2, _, heading_rad2, _] = variances(drift, 80);
        assert!((x_m2 / (4.0 + 0.25 * 8.0) - 1.0).abs() < 0.112 && (heading_rad2 / 0.01 - 1.0).abs() < 0.112);
    }

    #[test]
    fn a_believed_heading_is_wrapped() {
        for (error_rad, expected_rad) in [(0.5, 3.5 - TAU), (-0.5, 2.5), (-7.0, -4.0 + TAU)] {
            let errors = Errors { heading_rad: error_rad, ..Errors::default() };
            let believed_rad = errors.believed(Pose { heading_rad: 3.0, ..Pose::default() }).heading_rad;
            assert!((believed_rad - expected_rad).abs() < 1e-12, "{error_rad} {believed_rad}");
        }
    }

    #[test]
    fn a_robot_without_errors_believes_the_truth() {
        let mut model = ErrorModel::new(&NuisanceSpec::default(), 0.1, 7, 0);
        let mut errors = model.start();
        model.advance(1, &mut errors);
        let pose = Pose { heading_rad: 0.3, ..Pose::at([1.0, -2.0]) };
        assert_eq!((errors.believed(pose), errors.bias_m), (pose, 0.0));
    }
}
