//! Planners: each step they choose every robot's heading so that the trace of the target's
//! position covariance after the next measurements is small (Eqs. 14-29).
//!
//! A [`Planner`] is asked with a [`Situation`] and answers with a [`Plan`]: commands, the information that they lead to, and a
//! [`Certificate`] if it has proven how good others can be at best. Neither knows what the robots measure with; what follows
//! from that is the planner's: [`range_only`] has those for teams that measure ranges of constant noise.
//!
//! A planner is a pure function of (tick, situation): nothing is kept from one step to the next, so
//! a restarted fusion plans as the old one would have.

mod curves;
mod custom;
mod horizon;
pub mod range_only;
mod situation;

use rangehound_shared::message::Command;
use rangehound_shared::scenario::PlannerSpec;
use serde::{Deserialize, Serialize};

use curves::Curves;
pub use custom::{Choose, Custom};
use horizon::Horizon;
use range_only::RangeOnly;
pub use situation::{Situation, TeamMember};

/// A way to choose headings.
pub trait Planner: std::fmt::Debug + Send {
    /// The name by which scenario and command line know it.
    fn name(&self) -> &'static str;

    /// Chooses a command for each member of the team, in the team's order; of what `plan` held before nothing is left.
    fn plan(&mut self, tick: u64, situation: &Situation, plan: &mut Plan);
}

/// The commands of one step, and the information that they lead to.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Plan {
    /// The command of each robot until it measures.
    pub commands: Vec<Command>,
    /// The predicted information about the target's position then, if all that will be fused is.
    pub predicted: Predicted,
    /// How good other commands can be at best; `None` from planners that prove nothing.
    pub certificate: Option<Certificate>,
}

/// What a plan leads to: predicted information about the target's position.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Predicted {
    /// The minimised quantity. For teams of ranges alone the paper's `|S|`, the difference of the eigenvalues of the information,
    /// 1/m^2; for others the criterion's value.
    pub objective: f64,
    /// Twice the lesser eigenvalue, `T - |S|`, 1/m^2: the trace hangs on it, and the difference of the two may be nothing but
    /// rounding.
    pub least_information_per_m2: f64,
    /// Trace of the position covariance, m^2.
    pub position_trace_m2: f64,
}

/// A proof of how good commands can be at best.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Certificate {
    /// No commands reach less of [`Predicted::objective`].
    pub lower_bound: f64,
    /// No commands lead to a lesser trace of the position covariance, m^2.
    pub least_trace_m2: f64,
    /// True if the plan reaches both bounds, but for what the planner states as its gap.
    pub is_optimal: bool,
}

/// Why a planner cannot serve a team.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PlannerError {
    /// The search would not finish.
    #[error(
        "planner.step_rad gives {candidates:.3e} candidates ({points} bearings for each of {robots} robots): expected at \
         most {limit:.0e}: choose a larger step, fewer robots or another planner"
    )]
    GridTooLarge {
        /// Candidates in the worst case, when every robot is within one step of the target.
        candidates: f64,
        /// Bearings a robot.
        points: usize,
        /// Robots.
        robots: usize,
        /// Most candidates that are searched.
        limit: f64,
    },
}

/// The planner that a scenario asks for, for a team of `robots`.
///
/// # Errors
/// [`PlannerError`] if it could not serve a team of this size.
pub fn for_team(spec: PlannerSpec, robots: usize, seed: u64) -> Result<Box<dyn Planner>, PlannerError> {
    Ok(match spec {
        PlannerSpec::Horizon { steps, blocks } => Box::new(Horizon::new(steps, blocks, robots, seed)?),
        _ => Box::new(ForAnyTeam::new(spec, robots, seed)?),
    })
}

/// A bound for commands of any planner, with proof: that of the convex hulls.
#[must_use]
pub fn hull_certificate(situation: &Situation, plan: &Plan) -> Certificate {
    let problem = range_only::Problem::of(situation);
    if situation.is_range_only() {
        range_only::hull_certificate(&problem, &plan.predicted)
    } else {
        curves::hull_certificate(situation, &problem, plan)
    }
}

/// Plans for teams of ranges alone as the paper does, and for all others over their curves.
#[derive(Debug)]
struct ForAnyTeam {
    range_only: RangeOnly,
    curves: Curves,
}

impl ForAnyTeam {
    fn new(spec: PlannerSpec, robots: usize, seed: u64) -> Result<Self, PlannerError> {
        let range_only = RangeOnly::new(range_only::solver(spec, robots, seed)?);
        Ok(Self { range_only, curves: Curves::new(spec) })
    }

    /// Computes what the plan's commands lead to; proves nothing.
    fn value(&mut self, situation: &Situation, plan: &mut Plan) {
        plan.certificate = None;
        plan.predicted = if situation.is_range_only() {
            self.range_only.predicted(situation, &plan.commands)
        } else {
            curves::predicted(situation, &plan.commands)
        };
    }
}

impl Planner for ForAnyTeam {
    fn name(&self) -> &'static str {
        self.range_only.name()
    }

    fn plan(&mut self, tick: u64, situation: &Situation, plan: &mut Plan) {
        if situation.is_range_only() {
            self.range_only.plan(tick, situation, plan);
        } else {
            self.curves.plan(tick, situation, &mut self.range_only, plan);
        }
    }
}
