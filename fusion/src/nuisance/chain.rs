//! How the nuisances of each robot change.

use nalgebra::{Matrix2, SMatrix, SVector};
use rangehound_shared::measurement::Pose;
use rangehound_shared::scenario::{NuisanceSpec, PoseCorrelation, Scenario, Treatment};
use serde::{Deserialize, Serialize};

use super::NUISANCES;

/// Covariance of one robot's nuisances: position, heading and bias are independent.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Covariance {
    /// Of the position, m^2.
    pub position_m2: Matrix2<f64>,
    /// Of the heading, rad^2.
    pub heading_rad2: f64,
    /// Of the bias of its ranges, m^2.
    pub bias_m2: f64,
}

/// The change of one robot's nuisances from one measurement to the next: `n' = F n + w`, and the covariance of `w`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Change {
    position: Matrix2<f64>,
    heading: f64,
    bias: f64,
    pub(crate) noise: Covariance,
}

/// The covariances of all robots' nuisances, which no measurement changes, and how they change with time.
#[derive(Debug, Clone, PartialEq)]
pub struct Chain {
    specs: Vec<NuisanceSpec>,
    treatment: Treatment,
    robots: Vec<Known>,
    /// True once a robot has a nuisance.
    is_active: bool,
}

/// The estimate of one robot's nuisances.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct Known {
    covariance: Covariance,
    /// Time since the robot's last measurement, s; `None` before the first.
    unheard_s: Option<f64>,
}

impl Covariance {
    /// Variance of a row on these nuisances.
    pub(crate) fn variance(&self, row: &SVector<f64, NUISANCES>) -> f64 {
        self.times(row).dot(row)
    }

    /// The product with a row, transposed.
    pub(crate) fn times(&self, row: &SVector<f64, NUISANCES>) -> SVector<f64, NUISANCES> {
        let p = &self.position_m2;
        SVector::from([
            p[(0, 0)] * row[0] + p[(0, 1)] * row[1],
            p[(1, 0)] * row[0] + p[(1, 1)] * row[1],
            self.heading_rad2 * row[2],
            self.bias_m2 * row[3],
        ])
    }

    /// The full matrix.
    pub(crate) fn matrix(&self) -> SMatrix<f64, NUISANCES, NUISANCES> {
        of_blocks(&self.position_m2, self.heading_rad2, self.bias_m2)
    }
}

impl Change {
    /// `C F^T`: the covariance of the target's error with the changed nuisances.
    pub(crate) fn forget<const N: usize>(&self, cross: &mut SMatrix<f64, N, NUISANCES>) {
        let position = cross.fixed_columns::<2>(0) * self.position.transpose();
        cross.fixed_columns_mut::<2>(0).copy_from(&position);
        cross.column_mut(2).scale_mut(self.heading);
        cross.column_mut(3).scale_mut(self.bias);
    }

    /// `F`.
    pub(crate) fn matrix(&self) -> SMatrix<f64, NUISANCES, NUISANCES> {
        of_blocks(&self.position, self.heading, self.bias)
    }
}

impl Chain {
    /// The nuisances of a scenario's team.
    #[must_use]
    pub fn new(scenario: &Scenario) -> Self {
        Self::of(scenario.robots.iter().map(|robot| robot.nuisances).collect(), scenario.treatment)
    }

    /// The nuisances of a team with these specifications.
    #[must_use]
    pub fn of(specs: Vec<NuisanceSpec>, treatment: Treatment) -> Self {
        let robots = vec![Known::default(); specs.len()];
        let mut chain = Self { specs, treatment, robots, is_active: false };
        chain.is_active = chain.starts_active();
        chain
    }

    /// The size of the team.
    #[must_use]
    pub fn robots(&self) -> usize {
        self.robots.len()
    }

    /// The filter's treatment of nuisances.
    #[must_use]
    pub fn treatment(&self) -> Treatment {
        self.treatment
    }

    /// True once a robot has a nuisance: before that, estimates need not follow any.
    #[must_use]
    pub fn is_active(&self) -> bool {
        self.is_active
    }

    /// State from which [`Self::restore`] continues: nothing without nuisances.
    pub(crate) fn saved(&self) -> &[Known] {
        if self.is_active { &self.robots } else { &[] }
    }

    /// Continues from the saved state of a chain of the same scenario. False if it is not such a state.
    pub(crate) fn restore(&mut self, saved: &[Known]) -> bool {
        let is_finite = |known: &Known| {
            known.covariance.matrix().iter().all(|value| value.is_finite())
                && known.unheard_s.is_none_or(f64::is_finite)
        };
        if saved.is_empty() && !self.starts_active() {
            self.robots.fill(Known::default());
        } else if saved.len() == self.robots.len() && saved.iter().all(is_finite) {
            self.robots.copy_from_slice(saved);
        } else {
            return false;
        }
        self.is_active = !saved.is_empty();
        true
    }

    fn starts_active(&self) -> bool {
        self.treatment != Treatment::Ignored && self.specs.iter().any(|spec| spec.bias_std_m > 0.0)
    }

    /// Covariance of one robot's nuisances at its last measurement.
    #[must_use]
    pub fn covariance(&self, robot: usize) -> Covariance {
        self.robots.get(robot).map(|known| known.covariance).unwrap_or_default()
    }

    /// Time passes.
    pub(crate) fn advance(&mut self, dt_s: f64) {
        if self.is_active {
            self.robots.iter_mut().filter_map(|known| known.unheard_s.as_mut()).for_each(|since_s| *since_s += dt_s);
        }
    }

    /// A robot has measured at this pose: its nuisances have the covariance that it reports. Returns how they have changed
    /// since its last measurement; `None` without nuisances.
    pub(crate) fn hear(&mut self, robot: usize, pose: &Pose) -> Option<Change> {
        if self.treatment == Treatment::Ignored || !self.is_active && pose.is_exact() {
            return None;
        }
        self.is_active = true;
        let (known, spec) = (self.robots.get_mut(robot)?, self.specs.get(robot)?);
        let now = Covariance {
            position_m2: pose.position_covariance_m2(),
            heading_rad2: pose.heading_std_rad * pose.heading_std_rad,
            bias_m2: spec.bias_std_m * spec.bias_std_m,
        };
        let before = std::mem::replace(&mut known.covariance, now);
        let elapsed_s = known.unheard_s.replace(0.0);
        Some(match elapsed_s {
            None => Change { position: Matrix2::zeros(), heading: 0.0, bias: 0.0, noise: now },
            Some(_) if self.treatment == Treatment::Inflated => {
                Change { position: Matrix2::zeros(), heading: 0.0, bias: 0.0, noise: now }
            }
            Some(elapsed_s) => {
                let kept = match spec.correlation {
                    PoseCorrelation::White => 0.0,
                    PoseCorrelation::Time(time_s) => (-elapsed_s / time_s).exp(),
                    PoseCorrelation::Drift | PoseCorrelation::Inferred => 1.0,
                };
                let position = kept_position(&before.position_m2, &now.position_m2, kept);
                let heading = kept_of(before.heading_rad2, now.heading_rad2, kept);
                let bias = spec.bias_correlation_s.map_or(1.0, |time_s| (-elapsed_s / time_s).exp());
                let position_m2 = now.position_m2 - position * before.position_m2 * position.transpose();
                let noise = Covariance {
                    position_m2: (position_m2 + position_m2.transpose()) * 0.5,
                    heading_rad2: (now.heading_rad2 - heading * heading * before.heading_rad2).max(0.0),
                    bias_m2: ((1.0 - bias * bias) * now.bias_m2).max(0.0),
                };
                Change { position, heading, bias, noise }
            }
        })
    }
}

/// The matrix of a robot's nuisances with these blocks.
fn of_blocks(position: &Matrix2<f64>, heading: f64, bias: f64) -> SMatrix<f64, NUISANCES, NUISANCES> {
    let mut matrix = SMatrix::<f64, NUISANCES, NUISANCES>::zeros();
    matrix.fixed_view_mut::<2, 2>(0, 0).copy_from(position);
    matrix[(2, 2)] = heading;
    matrix[(3, 3)] = bias;
    matrix
}

/// The factor on an error whose variance has changed, `f`. If the variance has fallen below `f^2` of what it was, the robot
/// has corrected itself with something new, and `P' / P` of the error is left.
fn kept_of(before: f64, now: f64, kept: f64) -> f64 {
    if now >= kept * kept * before { kept } else { now / before }
}

/// The same for a position: `F = f I`, or `F = P' P^-1` after a correction.
fn kept_position(before: &Matrix2<f64>, now: &Matrix2<f64>, kept: f64) -> Matrix2<f64> {
    let is_semidefinite = |m: &Matrix2<f64>| {
        // With room for rounding.
        let least = -1e-12 * (before.trace() + now.trace());
        m[(0, 0)] >= least
            && m[(1, 1)] >= least
            && m[(0, 0)] * m[(1, 1)] - m[(0, 1)] * m[(1, 0)] >= least * m.trace().abs()
    };
    if is_semidefinite(&(now - before * (kept * kept))) {
        return Matrix2::from_diagonal_element(kept);
    }
    let Some(inverse) = before.try_inverse() else { return Matrix2::zeros() };
    let corrected = now * inverse;
    if is_semidefinite(&(now - corrected * before * corrected.transpose())) {
        return corrected;
    }
    // Better in one direction and worse in another: the greatest common factor that leaves a covariance.
    let ratios = (inverse * now).complex_eigenvalues();
    let least = ratios[0].re.min(ratios[1].re).max(0.0);
    Matrix2::from_diagonal_element(kept.min((least * (1.0 - 1e-9)).sqrt()))
}
