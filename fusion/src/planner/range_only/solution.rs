//! Directions within their arcs, the commands that lead there, and proven bounds on them.

use rangehound_shared::message::Command;

use super::problem::trace_m2;
use super::{Problem, certified};
use crate::planner::{Certificate, Predicted};
use crate::vector::Vector;

/// The answer to a [`Problem`].
#[derive(Debug, Clone, PartialEq)]
pub struct Solution {
    /// Doubled bearing of each robot to the predicted target after the step, `exp(2j theta_i)`.
    pub directions: Vec<Vector>,
    /// The command that leads each robot there.
    pub commands: Vec<Command>,
    /// `|S|` that these directions reach, 1/m^2.
    pub objective: f64,
    /// No directions in the arcs reach less than this; minus infinity from solvers that prove nothing.
    pub lower_bound: f64,
    /// Trace of the position covariance after the next ranges, m^2.
    pub position_trace_m2: f64,
    /// `T - |S|`, twice the least eigenvalue of the information, 1/m^2: the trace depends on it, and the difference of
    /// the two may be nothing but rounding.
    pub least_information: f64,
    /// No directions in the arcs reach more than this; infinite from solvers that prove nothing.
    pub least_information_bound: f64,
}

impl Default for Solution {
    /// Nothing chosen, nothing proven.
    fn default() -> Self {
        Self {
            directions: Vec::new(),
            commands: Vec::new(),
            objective: 0.0,
            lower_bound: f64::NEG_INFINITY,
            position_trace_m2: 0.0,
            least_information: 0.0,
            least_information_bound: f64::INFINITY,
        }
    }
}

impl Solution {
    /// Derives commands and prediction from [`Self::directions`] (Eq. 16).
    pub fn complete(&mut self, problem: &Problem) {
        self.commands.clear();
        let robots = problem.reaches.iter().zip(&self.directions);
        self.commands.extend(robots.map(|(reach, direction)| reach.command(*direction, &problem.corners_m)));
        self.value(problem);
    }

    /// Computes the objective of [`Self::directions`]; proves nothing.
    pub(super) fn value(&mut self, problem: &Problem) {
        let sum = problem.sum(&self.directions);
        self.objective = sum.norm();
        self.least_information = problem.least_information(&self.directions, sum);
        self.position_trace_m2 = trace_m2(self.least_information, self.objective);
        (self.lower_bound, self.least_information_bound) = (f64::NEG_INFINITY, f64::INFINITY);
    }

    /// Records that no directions reach less than `lower_bound`.
    pub fn prove(&mut self, lower_bound: f64) {
        self.lower_bound = lower_bound.min(self.objective);
        self.least_information_bound = self.least_information + (self.objective - self.lower_bound);
    }

    /// No directions have a lesser position trace than this, m^2; 0 if nothing is proven.
    #[must_use]
    pub fn least_trace_m2(&self) -> f64 {
        let gap = self.least_information_bound - self.least_information;
        if gap.is_finite() { trace_m2(self.least_information_bound, (self.objective - gap).max(0.0)) } else { 0.0 }
    }

    /// True if it is proven that no other directions are better by more than a billionth of the sum of all lambda in
    /// `|S|`, nor by more than a millionth in the trace.
    #[must_use]
    pub fn is_certified(&self, problem: &Problem) -> bool {
        self.objective - self.lower_bound <= certified::GAP_MAX * problem.lambda_sum()
            && self.least_information_bound <= self.least_information * (1.0 + certified::TRACE_GAP_MAX)
    }

    /// What the plan leads to.
    pub(super) fn predicted(&self) -> Predicted {
        Predicted {
            objective: self.objective,
            least_information_per_m2: self.least_information,
            position_trace_m2: self.position_trace_m2,
        }
    }

    /// The certificate, if anything is proven.
    pub(super) fn certificate(&self, problem: &Problem) -> Option<Certificate> {
        (self.lower_bound != f64::NEG_INFINITY).then(|| self.proven(problem))
    }

    fn proven(&self, problem: &Problem) -> Certificate {
        Certificate {
            lower_bound: self.lower_bound,
            least_trace_m2: self.least_trace_m2(),
            is_optimal: self.is_certified(problem),
        }
    }
}

/// The bound of the arcs' hulls for directions that lead to this; it holds for every solver.
#[must_use]
pub fn hull_certificate(problem: &Problem, predicted: &Predicted) -> Certificate {
    let Predicted { objective, least_information_per_m2: least_information, position_trace_m2 } = *predicted;
    let mut solution = Solution { objective, least_information, position_trace_m2, ..Solution::default() };
    // Lowered by the rounding of its sums.
    let rounding = 4.0 * f64::EPSILON * problem.len() as f64 * problem.lambda_sum();
    solution.prove((certified::hull_bound(problem) - rounding).max(0.0));
    solution.proven(problem)
}
