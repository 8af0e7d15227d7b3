//! Nuisances: errors that are not the target's and stay from one measurement to the next.
//!
//! Robot i believes it is at `p_i + e_i`, faces `psi_i + a_i`, and its ranges have the bias `b_i`. Each robot's nuisances
//! are the vector `n_i = [e_x e_y a b]`; they are independent between robots. They follow `n' = F n + w` ([`Chain`]), and a
//! measurement is linear in them: a range has the row `[h 0 1]` and a bearing `[h 1 0]`, with its gradient `h`.
//!
//! [`Estimate`] is the target's estimate together with what is known of its dependence on them. The Schmidt filter
//! (`schmidt.rs`) follows the cross-covariances `C_i = E[x~ n_i^T]` and estimates no nuisance, at a cost of O(M). The other
//! choice (`joint.rs`) estimates some of them with the target.

mod chain;
mod joint;
mod schmidt;
#[cfg(test)]
mod tests;

use nalgebra::{Matrix2, SMatrix, SVector, Vector2};
use rangehound_shared::angle::wrapped_rad;
use rangehound_shared::measurement::Kind;
use rangehound_shared::motion::Transition;
use rangehound_shared::scenario::Treatment;
use serde::{Deserialize, Serialize};

pub use chain::Chain;
pub(crate) use chain::{Change, Known};
use joint::Joint;
pub(crate) use schmidt::Whitened;

use crate::filter::{Gaussian, Information, Innovation};
use crate::tracker::Reading;

/// Number of a robot's nuisances: two of its position, one of its heading, one of its ranges.
pub(crate) const NUISANCES: usize = 4;

/// Cross-covariance of the target's error and one robot's nuisances.
type Cross<const N: usize> = SMatrix<f64, N, NUISANCES>;

/// A measurement compared with its prediction, with its row on its robot's nuisances.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Row {
    /// The robot that measured.
    pub robot: usize,
    /// Where it measured, as far as that is known, m.
    pub sensor_m: Vector2<f64>,
    /// Gradient, innovation and noise.
    pub innovation: Innovation,
    /// The row on the robot's nuisances.
    nuisance: SVector<f64, NUISANCES>,
}

/// The target's estimate, and how far its error depends on the robots' nuisances.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Estimate<const N: usize> {
    /// State and covariance of the target.
    pub target: Gaussian<N>,
    dependence: Dependence<N>,
}

/// The estimate's dependence on nuisances.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
enum Dependence<const N: usize> {
    /// There are no nuisances.
    None,
    /// `C_i` of each robot.
    Considered(Vec<Cross<N>>),
    /// Some are estimated.
    Joint(Joint<N>),
}

impl<const N: usize> Estimate<N> {
    /// An estimate that does not depend on nuisances yet.
    #[must_use]
    pub fn new(target: Gaussian<N>, chain: &Chain) -> Self {
        let dependence = match chain.treatment() {
            _ if !chain.is_active() => Dependence::None,
            Treatment::Estimated { bias, pose } => Dependence::Joint(Joint::new(chain, bias, pose)),
            _ => Dependence::Considered(vec![Cross::zeros(); chain.robots()]),
        };
        Self { target, dependence }
    }

    /// Begins to follow the dependence, when the first robot has reported an uncertain pose.
    pub fn follow(&mut self, chain: &Chain) {
        if matches!(self.dependence, Dependence::None) && chain.is_active() {
            self.dependence = Self::new(self.target, chain).dependence;
        }
    }

    /// The prediction over a step of the target.
    pub fn predict(&mut self, transition: &Transition<N>) {
        self.target = self.target.predict(transition);
        match &mut self.dependence {
            Dependence::None => {}
            Dependence::Considered(crosses) => crosses.iter_mut().for_each(|cross| *cross = transition.phi * *cross),
            Dependence::Joint(joint) => joint.predict(&transition.phi),
        }
    }

    /// One robot's nuisances have changed since its last measurement.
    pub(crate) fn change(&mut self, robot: usize, change: &Change) {
        match &mut self.dependence {
            Dependence::None => {}
            Dependence::Considered(crosses) => {
                if let Some(cross) = crosses.get_mut(robot) {
                    change.forget(cross);
                }
            }
            Dependence::Joint(joint) => joint.change(robot, change),
        }
    }

    /// A measurement compared with this estimate, to first order for a range in the plane and to second order for others.
    #[must_use]
    pub fn row(&self, reading: &Reading, chain: &Chain) -> Row {
        let nuisances = self.nuisances_of(reading.robot);
        let sensor_m = reading.pose.position_m() - Vector2::new(nuisances[0], nuisances[1]);
        match reading.kind {
            Kind::Range => {
                let (range_m, height_m) = (reading.value - nuisances[3], reading.pose.height_m);
                let mut innovation = self.target.slant_innovation(sensor_m, height_m, range_m, reading.std);
                if reading.std_per_m != 0.0 {
                    // The noise of the true distance, not of the measured one: otherwise short ranges would weigh more.
                    let std_m = (reading.std - reading.std_per_m * innovation.innovation).max(0.5 * reading.std);
                    innovation.noise_variance = std_m * std_m;
                }
                let nuisance = SVector::from([innovation.gradient.x, innovation.gradient.y, 0.0, 1.0]);
                Row { robot: reading.robot, sensor_m, innovation, nuisance }
            }
            Kind::Bearing => {
                let global_rad = wrapped_rad(reading.value + reading.pose.heading_rad - nuisances[2]);
                let sight_covariance = self.sight_covariance(reading.robot, chain);
                let innovation = self.target.bearing_innovation(sensor_m, &sight_covariance, (global_rad, reading.std));
                let nuisance = SVector::from([innovation.gradient.x, innovation.gradient.y, 1.0, 0.0]);
                Row { robot: reading.robot, sensor_m, innovation, nuisance }
            }
        }
    }

    /// Covariance of the sight from a robot to the target, m^2.
    pub(crate) fn sight_covariance(&self, robot: usize, chain: &Chain) -> Matrix2<f64> {
        let target = self.target.position_covariance();
        match &self.dependence {
            Dependence::None => target,
            Dependence::Considered(_) => target + chain.covariance(robot).position_m2,
            Dependence::Joint(joint) => target + joint.position_covariance(robot),
        }
    }

    /// Variance of an innovation, `S`, m^2 or rad^2.
    #[must_use]
    pub fn variance(&self, row: &Row, chain: &Chain) -> f64 {
        let of_target = row.innovation.variance(&self.target.position_covariance());
        match &self.dependence {
            Dependence::None => of_target,
            Dependence::Considered(crosses) => {
                let Some(cross) = crosses.get(row.robot) else { return of_target };
                let mixed = row.innovation.gradient.dot(&(cross.fixed_rows::<2>(0) * row.nuisance));
                let own = chain.covariance(row.robot).variance(&row.nuisance);
                // Rounding must not make it less than the noise.
                (of_target + 2.0 * mixed + own).max(row.innovation.noise_variance)
            }
            Dependence::Joint(joint) => of_target + joint.variance(row),
        }
    }

    /// Standard deviation of a measurement beyond that of the target: noise and nuisances, as if they were new.
    pub(crate) fn own_std(&self, reading: &Reading, row: &Row, chain: &Chain) -> f64 {
        let nuisances = match &self.dependence {
            Dependence::None => return reading.std,
            Dependence::Considered(_) => chain.covariance(row.robot).variance(&row.nuisance),
            Dependence::Joint(joint) => joint.own_variance(row),
        };
        (reading.std * reading.std + nuisances).sqrt()
    }

    /// Joint update with measurements that were compared with this estimate, those of each robot in succession. Returns
    /// their normalised innovation squared. `scratch` is memory.
    pub(crate) fn update<'a>(
        &mut self,
        rows: impl Iterator<Item = &'a Row> + Clone,
        chain: &Chain,
        scratch: &mut Vec<Whitened<N>>,
    ) -> f64 {
        match &mut self.dependence {
            Dependence::None => {
                let mut information = Information::default();
                rows.clone().for_each(|row| information.add(&row.innovation));
                let nis = self.target.nis(rows.map(|row| &row.innovation));
                self.target = self.target.update(&information);
                nis
            }
            Dependence::Considered(crosses) => {
                let (target, nis) = schmidt::update(&self.target, crosses, chain, rows, scratch);
                self.target = target;
                nis
            }
            Dependence::Joint(joint) => joint.update(&mut self.target, rows),
        }
    }

    /// Normalised innovation squared of measurements that were compared with this estimate, without an update.
    pub(crate) fn nis<'a>(
        &self,
        rows: impl Iterator<Item = &'a Row> + Clone,
        chain: &Chain,
        scratch: &mut Vec<Whitened<N>>,
    ) -> f64 {
        match &self.dependence {
            Dependence::None => self.target.nis(rows.map(|row| &row.innovation)),
            Dependence::Considered(crosses) => schmidt::nis(&self.target, crosses, chain, rows, scratch),
            Dependence::Joint(joint) => joint.clone().update(&mut self.target.clone(), rows),
        }
    }

    /// Update with information that does not depend on nuisances.
    pub(crate) fn update_with(&mut self, information: &Information) {
        let prior = self.target;
        self.target = prior.update(information);
        match &mut self.dependence {
            Dependence::None => {}
            Dependence::Considered(crosses) => {
                let keep = kept(&prior, &self.target);
                crosses.iter_mut().for_each(|cross| *cross = keep * *cross);
            }
            Dependence::Joint(joint) => joint.condition(&prior, &self.target),
        }
    }

    /// Replaces this estimate by the mean and the covariance of a sum of estimates with these weights, which sum to one.
    pub(crate) fn set_mixture(&mut self, target: Gaussian<N>, parts: &[(f64, &Self)]) {
        self.target = target;
        match &mut self.dependence {
            Dependence::None => {}
            // No nuisance is estimated, so all parts have the same mean of them.
            Dependence::Considered(crosses) => {
                for (robot, cross) in crosses.iter_mut().enumerate() {
                    *cross = parts.iter().fold(Cross::zeros(), |sum, (weight, part)| match &part.dependence {
                        Dependence::Considered(crosses) => sum + crosses[robot] * *weight,
                        _ => sum,
                    });
                }
            }
            Dependence::Joint(joint) => {
                let joints = parts.iter().filter_map(|(weight, part)| match &part.dependence {
                    Dependence::Joint(joint) => Some((*weight, &part.target, joint)),
                    _ => None,
                });
                *joint = Joint::mixture(&target, joints).unwrap_or_else(|| joint.clone());
            }
        }
    }

    /// Multiplies the target's covariance by a factor.
    pub(crate) fn widen(&mut self, factor: f64) {
        self.target.p *= factor;
    }

    /// Estimates of one robot's nuisances; zero where they are not estimated.
    fn nuisances_of(&self, robot: usize) -> SVector<f64, NUISANCES> {
        match &self.dependence {
            Dependence::Joint(joint) => joint.mean_of(robot),
            _ => SVector::zeros(),
        }
    }

    /// True if it belongs to a team of this size.
    pub(crate) fn is_of_team(&self, robots: usize) -> bool {
        match &self.dependence {
            Dependence::None => true,
            Dependence::Considered(crosses) => crosses.len() == robots,
            Dependence::Joint(joint) => joint.is_of_team(robots),
        }
    }
}

/// `I - K H` of an update with information about the position: what is kept of a covariance with the prior's error.
///
/// `P' = (I - K H) P` and `K H` depends on the position alone, so its columns are `I - P'_x1 P_11^-1`.
fn kept<const N: usize>(prior: &Gaussian<N>, posterior: &Gaussian<N>) -> SMatrix<f64, N, N> {
    let before = prior.position_covariance();
    let mut keep = SMatrix::<f64, N, N>::identity();
    let Some(inverse) = before.try_inverse() else { return keep };
    let after = posterior.p.fixed_columns::<2>(0) - prior.p.fixed_columns::<2>(0);
    let change = after * inverse;
    for i in 0..N {
        keep[(i, 0)] += change[(i, 0)];
        keep[(i, 1)] += change[(i, 1)];
    }
    keep
}
