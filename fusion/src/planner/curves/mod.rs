//! Planners of teams with any sensors and uncertain positions.
//!
//! Each robot is a curve of the places that may be best for it (`curve`); what it adds from there is a symmetric 2x2 matrix
//! (`information`). The planners minimise a [`Criterion`] of the sum.
//!
//! | planner | method |
//! |---|---|
//! | certified | branch and bound with the bound of the curves' convex hulls: the global optimum, with a proof |
//! | adaptive, standard | each robot's best place given the others', in turn, until nothing changes |
//! | greedy | each robot by itself, its teammates counted where they stand |
//! | pursue | straight to the predicted target |
//! | random | uniformly random places of the curves |

mod curve;
mod follow;
mod hull;
pub(super) mod information;
mod leaf;
pub(super) mod noise;
mod piece;
mod search;
mod summit;
mod support;
mod team;

use rangehound_shared::message::Command;
use rangehound_shared::scenario::{Criterion, PlannerSpec};

use super::range_only::{Problem, RangeOnly};
use super::{Certificate, Plan, Planner, Predicted, Situation};
use crate::vector::Vector;
use information::{Cost, Information};
use noise::Noise;
use search::Memory;
use team::Team;

/// The planner for all sensors that a scenario asks for.
#[derive(Debug)]
pub(super) struct Curves {
    spec: PlannerSpec,
    /// Of the situation at hand: memory only.
    problem: Problem,
    team: Team,
    at: Vec<f64>,
    memory: Memory,
}

impl Curves {
    /// The planner of this kind.
    pub(super) fn new(spec: PlannerSpec) -> Self {
        Self { spec, problem: Problem::default(), team: Team::default(), at: Vec::new(), memory: Memory::default() }
    }

    /// Chooses a command for each member of the team. Random headings are those of teams of ranges.
    pub(super) fn plan(&mut self, tick: u64, situation: &Situation, range_only: &mut RangeOnly, plan: &mut Plan) {
        let Self { spec, problem, team, at, memory } = self;
        problem.pose(situation);
        team.pose(situation, problem);
        let total = match *spec {
            PlannerSpec::Random => {
                range_only.plan(tick, situation, plan);
                commanded(situation, team.curves.iter().map(|curve| curve.noise), &plan.commands)
            }
            _ => {
                let certificate = choose(team, *spec, problem, at, memory);
                let total = team.total(at);
                place_the_others(team, total, at);
                plan.commands.clear();
                plan.commands.extend(commands(team, problem, at));
                plan.certificate = certificate;
                total
            }
        };
        plan.predicted = predicted_of(situation, total);
        plan.certificate = plan.certificate.map(|certificate| below(&plan.predicted, certificate));
    }
}

/// What these commands lead to.
pub(super) fn predicted(situation: &Situation, commands: &[Command]) -> Predicted {
    predicted_of(situation, commanded(situation, situation.team.iter().map(Noise::of), commands))
}

fn predicted_of(situation: &Situation, total: Information) -> Predicted {
    Predicted {
        objective: situation.criterion.cost(total),
        least_information_per_m2: total.least(),
        position_trace_m2: total.position_trace_m2(),
    }
}

/// Chooses the places of all robots that count.
fn choose(
    team: &Team,
    spec: PlannerSpec,
    problem: &Problem,
    at: &mut Vec<f64>,
    memory: &mut Memory,
) -> Option<Certificate> {
    at.clear();
    at.extend(team.curves.iter().zip(&problem.reaches).map(|(curve, reach)| curve.straight(reach.sight)));
    match spec {
        PlannerSpec::Certified { nodes } => {
            let answer = search::search(team, std::mem::take(at), nodes, memory);
            let least_trace_m2 = match team.criterion {
                Criterion::Trace => answer.bound,
                _ => {
                    let total = team.total(&answer.at);
                    team.bound(Criterion::Trace, total).min(total.position_trace_m2())
                }
            };
            *at = answer.at;
            Some(Certificate {
                lower_bound: answer.bound,
                least_trace_m2,
                is_optimal: answer.cost - answer.bound <= search::GAP_MAX * answer.cost,
            })
        }
        PlannerSpec::Adaptive { .. } | PlannerSpec::Standard { .. } | PlannerSpec::Grid { .. } => {
            team.descend(&team.whole, at);
            None
        }
        PlannerSpec::Greedy => {
            let standing = |i: usize| team.curves[i].noise.information(problem.reaches[i].to_target_m);
            let all = team.fused().fold(team.prior, |sum, i| sum + standing(i));
            for i in team.fused() {
                at[i] = team.respond(i, all - standing(i), (0.0, team.curves[i].end()), at[i]);
            }
            None
        }
        PlannerSpec::Pursue | PlannerSpec::Random | PlannerSpec::Horizon { .. } => None,
    }
}

/// Sends each robot that is not fused to where it would add most.
fn place_the_others(team: &Team, total: Information, at: &mut [f64]) {
    for i in (0..at.len()).filter(|i| !team.is_fused[*i]) {
        at[i] = team.respond(i, total, (0.0, team.curves[i].end()), at[i]);
    }
}

fn commands(team: &Team, problem: &Problem, at: &[f64]) -> impl Iterator<Item = Command> {
    team.curves.iter().zip(at).zip(&problem.reaches).map(|((curve, at), reach)| {
        let (heading, speed_mps) = reach.motion_to(reach.to_target_m - curve.sight_m(*at));
        Command { heading_rad: heading.angle_rad(), speed_mps }
    })
}

/// The information after these commands.
fn commanded(situation: &Situation, noises: impl Iterator<Item = Noise>, commands: &[Command]) -> Information {
    let Situation { belief, team, step_s, .. } = situation;
    let prior = Information::of_covariance(&belief.position_covariance_m2());
    let fused = team.iter().zip(noises).zip(commands).filter(|((member, _), _)| member.is_fused);
    fused.fold(prior, |sum, ((member, noise), command)| {
        let way_m = Vector::from_angle(command.heading_rad) * (command.speed_mps * step_s);
        sum + noise.information_after(way_m, belief.position_m() - member.position_m - way_m)
    })
}

/// The bound of the curves' hulls for these commands; it holds for every planner.
pub(super) fn hull_certificate(situation: &Situation, problem: &Problem, plan: &Plan) -> Certificate {
    let mut team = Team::default();
    team.pose(situation, problem);
    let total = commanded(situation, team.curves.iter().map(|curve| curve.noise), &plan.commands);
    let lower_bound = team.bound(team.criterion, total);
    let certificate = Certificate {
        lower_bound,
        least_trace_m2: team.bound(Criterion::Trace, total),
        is_optimal: plan.predicted.objective - lower_bound <= search::GAP_MAX * plan.predicted.objective,
    };
    below(&plan.predicted, certificate)
}

/// Rounding may put a bound above what it bounds.
fn below(predicted: &Predicted, certificate: Certificate) -> Certificate {
    Certificate {
        lower_bound: certificate.lower_bound.min(predicted.objective),
        least_trace_m2: certificate.least_trace_m2.min(predicted.position_trace_m2),
        ..certificate
    }
}

#[cfg(test)]
pub(super) mod tests;
