//! The planner that looks several steps ahead.
//!
//! It chooses headings that are held for blocks of steps, so that the criterion of the predicted position covariance, summed over
//! the steps of the horizon, is small, and commands the first of them; at the next tick it plans anew. It predicts with the
//! filter's own equations: `P_n = (P'_n^-1 + sum_i J_i)^-1`, `P'_n+1 = Phi P_n Phi^T + Q`, where `J_i` is what robot i's
//! measurement tells from its place after step n about the predicted mean.
//!
//! Coordinate descent (`courses`) starts from the certified plan of the first step, from the certified plan of every step in turn, and
//! for one robot from straight lines. The certified plans in turn are an answer themselves: unless the descent beats their sum,
//! their first step is commanded.

mod ahead;
mod courses;
mod minimum;

use std::f64::consts::TAU;

use rangehound_shared::message::Command;
use rangehound_shared::scenario::{PlannerSpec, defaults};
use rangehound_shared::with_state_dim;

use super::curves::information::Information;
use super::curves::noise::Noise;
use super::{ForAnyTeam, Plan, Planner, PlannerError, Situation};
use crate::vector::Vector;
use ahead::{Corners, Lookahead};
use courses::{Courses, Search};

/// Straight lines from which the descent of one robot starts.
const STRAIGHT: usize = 4;

/// Sweeps over the team at most.
const SWEEPS_MAX: usize = 6;

/// Plans over `steps` steps, in `blocks` of one heading each.
#[derive(Debug)]
pub(super) struct Horizon {
    steps: usize,
    blocks: usize,
    /// The certified planner of a single step. All steps together have the nodes that it has by default.
    one_step: ForAnyTeam,
    /// A later step's situation and plan.
    later: Situation,
    later_plan: Plan,
    noises: Vec<Noise>,
    courses: Courses,
    /// The headings of the certified plans, and the best of all starts.
    certified: Vec<Vector>,
    best: Vec<Vector>,
    corners: Corners,
}

impl Horizon {
    /// # Errors
    /// As of the certified planner.
    pub(super) fn new(steps: u32, blocks: u32, robots: usize, seed: u64) -> Result<Self, PlannerError> {
        let nodes = (defaults::NODES as u32 / steps.max(1)).max(1);
        Ok(Self {
            steps: steps as usize,
            blocks: blocks as usize,
            one_step: ForAnyTeam::new(PlannerSpec::Certified { nodes }, robots, seed)?,
            later: Situation::default(),
            later_plan: Plan::default(),
            noises: Vec::new(),
            courses: Courses::default(),
            certified: Vec::new(),
            best: Vec::new(),
            corners: Corners::default(),
        })
    }

    /// Plans for a target whose state has dimension `N`. `plan` has the certified plan of the first step, and keeps it if none is better.
    fn look_ahead<const N: usize>(&mut self, tick: u64, situation: &Situation, plan: &mut Plan) {
        let mut noises = std::mem::take(&mut self.noises);
        noises.clear();
        noises.extend(situation.team.iter().map(Noise::of));
        let ahead =
            Lookahead::<N> { situation, noises: &noises, transition: situation.motion.transition(situation.step_s) };
        let certified = self.follow_certified(tick, &ahead, plan);
        let least = self.search(&ahead, plan);
        // NaN is no improvement.
        if least < certified {
            self.command(&ahead, plan);
        }
        self.noises = noises;
    }

    /// Finds the best courses; returns the cost of the horizon.
    fn search<const N: usize>(&mut self, ahead: &Lookahead<'_, N>, plan: &Plan) -> f64 {
        let Self { courses, certified, best, .. } = self;
        let Situation { belief, team, .. } = ahead.situation;
        let mut least = f64::INFINITY;
        let straight = if team.len() == 1 { STRAIGHT } else { 0 };
        for start in 0..2 + straight {
            match start {
                0 => courses.headings.clone_from(certified),
                1 => {
                    let held = plan.commands.iter().map(|command| Vector::from_angle(command.heading_rad)).cycle();
                    courses.headings.iter_mut().zip(held).for_each(|(heading, held)| *heading = held);
                }
                _ => {
                    let turn = Vector::from_angle(TAU * (start - 2) as f64 / straight as f64);
                    let sight = (belief.position_m() - team[0].position_m).normalised();
                    courses.headings.fill(sight.unwrap_or(Vector::new(1.0, 0.0)).rotated_by(turn));
                }
            }
            let cost = courses.descend(ahead, Search::Global, 1);
            if start == 0 || cost < least {
                least = cost;
                best.clone_from(&courses.headings);
            }
        }
        courses.headings.clone_from(best);
        courses.descend(ahead, Search::Local, SWEEPS_MAX)
    }

    /// The certified plan of each step in turn: the cost of the horizon. Stores the team's headings, of each block from its start to its end.
    fn follow_certified<const N: usize>(&mut self, tick: u64, ahead: &Lookahead<'_, N>, plan: &Plan) -> f64 {
        let Situation { belief, team, clearance, criterion, step_s, .. } = ahead.situation;
        let Self { later, later_plan, one_step, courses, certified, .. } = self;
        courses.size(self.steps, self.blocks, team.len());
        later.team.clone_from(team);
        (later.belief, later.clearance, later.criterion, later.step_s) = (*belief, *clearance, *criterion, *step_s);
        certified.clear();
        certified.resize(courses.headings.len(), Vector::default());
        let mut known = ahead.first();
        for step in 0..self.steps {
            let commands = if step == 0 {
                &plan.commands
            } else {
                later.belief.assign(&known.target);
                one_step.plan(tick, later, later_plan);
                &later_plan.commands
            };
            let row = courses.block(step) * team.len();
            let mut total = Information::default();
            for (robot, (member, command)) in later.team.iter_mut().zip(commands).enumerate() {
                let way_m = Vector::from_angle(command.heading_rad) * (command.speed_mps * step_s);
                member.position_m += way_m;
                total += ahead.information(&known, robot, way_m, member.position_m);
                certified[row + robot] += way_m;
            }
            ahead.measure(&mut known, total);
        }
        for (robot, way_m) in certified.iter_mut().enumerate() {
            let first = || Vector::from_angle(plan.commands[robot % team.len()].heading_rad);
            *way_m = way_m.normalised().unwrap_or_else(first);
        }
        known.cost
    }

    /// Commands the first step of the best headings. Robots that are not fused keep their commands.
    fn command<const N: usize>(&mut self, ahead: &Lookahead<'_, N>, plan: &mut Plan) {
        let team = &ahead.situation.team;
        let known = ahead.first();
        let places_m = self.courses.places_m(0);
        for (robot, member) in team.iter().enumerate().filter(|(_, member)| member.is_fused) {
            let (heading, speed_mps) = ahead.motion(
                &known,
                robot,
                member.position_m,
                self.courses.headings[robot],
                places_m,
                &mut self.corners,
            );
            plan.commands[robot] = Command { heading_rad: heading.angle_rad(), speed_mps };
        }
    }
}

impl Planner for Horizon {
    fn name(&self) -> &'static str {
        "horizon"
    }

    fn plan(&mut self, tick: u64, situation: &Situation, plan: &mut Plan) {
        self.one_step.plan(tick, situation, plan);
        if courses::are_followed(self.steps, situation) {
            with_state_dim!(situation.motion.state_dim(), N => self.look_ahead::<N>(tick, situation, plan));
        }
        self.one_step.value(situation, plan);
    }
}

#[cfg(test)]
mod tests;
