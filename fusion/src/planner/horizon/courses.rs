//! The courses of the robots over the horizon: headings that are held for blocks of steps.

use std::f64::consts::TAU;
use std::ops::Range;

use super::ahead::{Corners, Lookahead, PredictedBelief};
use super::minimum::minimum;
use crate::planner::Situation;
use crate::planner::curves::information::Information;
use crate::vector::Vector;

/// Headings that are tried for a block all round.
const SAMPLES: usize = 16;

/// How far a heading turns when it is improved, rad.
const NEAR_RAD: f64 = 0.5;

/// Accuracy of a heading, relative to how far it may turn: near the best, costs are alike.
const ACCURACY: f64 = 1e-2;

/// A sweep that improves the cost by less than this share is the last.
const SETTLED: f64 = 1e-4;

/// Work on a plan, after which no further robot is improved. The unit is a step of a robot, or with a separation a neighbour at a
/// step. It bounds the time for large teams.
const WORK_MAX: usize = 200_000;

/// Where a heading is improved.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Search {
    /// The best of samples.
    Global,
    /// A minimum near the present heading.
    Local,
}

/// Courses and what they lead to. Rows of robots are ordered by block or by step.
#[derive(Debug, Default)]
pub(super) struct Courses {
    steps: usize,
    blocks: usize,
    robots: usize,
    /// In each block, unit vectors. Clearances may turn or slow a robot.
    pub(super) headings: Vec<Vector>,
    /// Where the robots are at the start of each step, and at the end of the last, m.
    places_m: Vec<Vector>,
    /// The information of each robot's measurement at the end of each step.
    informations: Vec<Information>,
    /// The information of the measurements of all robots but one, by step.
    rest: Vec<Information>,
    /// Headings before a sweep.
    before: Vec<Vector>,
    corners: Corners,
    work: usize,
}

/// Work on a step of one robot.
fn work_of_step(situation: &Situation) -> usize {
    if situation.clearance.separation_m > 0.0 { situation.team.len() } else { 1 }
}

/// True if the team is so small that there is time to follow its courses.
pub(super) fn are_followed(steps: usize, situation: &Situation) -> bool {
    steps * situation.team.len() * work_of_step(situation) <= WORK_MAX
}

impl Courses {
    /// Makes room for a team of this size.
    pub(super) fn size(&mut self, steps: usize, blocks: usize, robots: usize) {
        (self.steps, self.blocks, self.robots, self.work) = (steps, blocks, robots, 0);
        self.headings.resize(blocks * robots, Vector::default());
        self.places_m.resize((steps + 1) * robots, Vector::default());
        self.informations.resize(steps * robots, Information::default());
        self.rest.resize(steps, Information::default());
    }

    /// Where the robots are at the start of a step, m.
    pub(super) fn places_m(&self, step: usize) -> &[Vector] {
        &self.places_m[step * self.robots..][..self.robots]
    }

    /// The block that a step belongs to.
    pub(super) fn block(&self, step: usize) -> usize {
        step * self.blocks / self.steps
    }

    /// The steps of blocks.
    fn steps(&self, blocks: Range<usize>) -> Range<usize> {
        let start = |block: usize| (block * self.steps).div_ceil(self.blocks);
        start(blocks.start)..start(blocks.end)
    }

    /// The team along its courses: the cost of the horizon.
    pub(super) fn follow<const N: usize>(&mut self, ahead: &Lookahead<'_, N>) -> f64 {
        for (place_m, member) in self.places_m.iter_mut().zip(&ahead.situation.team) {
            *place_m = member.position_m;
        }
        let mut known = ahead.first();
        for step in 0..self.steps {
            let mut total = Information::default();
            for robot in 0..self.robots {
                total += self.advance(ahead, &known, robot, step, self.places_m(step)[robot]).1;
            }
            ahead.measure(&mut known, total);
        }
        known.cost
    }

    /// Improves the headings robot by robot and block by block until little changes; returns the cost of the horizon.
    ///
    /// While a robot's headings are improved, the others keep their places, as if none had to make way. So the cost of a sweep's
    /// outcome is computed with all robots, and a sweep that does not lower it is undone.
    pub(super) fn descend<const N: usize>(&mut self, ahead: &Lookahead<'_, N>, look: Search, sweeps_max: usize) -> f64 {
        let mut cost = self.follow(ahead);
        for _ in 0..sweeps_max {
            self.before.clone_from(&self.headings);
            for (robot, _) in ahead.situation.team.iter().enumerate().filter(|(_, member)| member.is_fused) {
                if self.work >= WORK_MAX {
                    break;
                }
                self.improve(ahead, robot, look);
            }
            let after = self.follow(ahead);
            let is_settled = cost - after <= SETTLED * after;
            if after < cost {
                cost = after;
            } else {
                self.headings.clone_from(&self.before);
            }
            if is_settled {
                break;
            }
        }
        cost
    }

    /// Improves the headings of one robot, block by block.
    fn improve<const N: usize>(&mut self, ahead: &Lookahead<'_, N>, robot: usize, look: Search) {
        for (rest, informations) in self.rest.iter_mut().zip(self.informations.chunks(self.robots)) {
            let others = informations.iter().enumerate().filter(|(other, _)| *other != robot);
            *rest = others.fold(Information::default(), |sum, (_, information)| sum + *information);
        }
        let mut from = (self.places_m[robot], ahead.first());
        for block in 0..self.blocks {
            let at = block * self.robots + robot;
            let now = self.headings[at];
            let turned = |turn_rad: f64| now.rotated_by(Vector::from_angle(turn_rad));
            let mut cost = |turn_rad: f64, limit: f64| {
                self.headings[at] = turned(turn_rad);
                self.go(ahead, robot, from, block..self.blocks, limit).1.cost
            };
            let mut best = (0.0, cost(0.0, f64::INFINITY));
            match look {
                Search::Global => {
                    for k in 1..SAMPLES {
                        let turn_rad = TAU * k as f64 / SAMPLES as f64;
                        let tried = cost(turn_rad, best.1);
                        if tried < best.1 {
                            best = (turn_rad, tried);
                        }
                    }
                }
                Search::Local => {
                    let value = |turn_rad: f64| cost(turn_rad, f64::INFINITY);
                    let turn_rad = minimum(value, (-NEAR_RAD, NEAR_RAD), 0.0, ACCURACY);
                    if cost(turn_rad, best.1) < best.1 {
                        best.0 = turn_rad;
                    }
                }
            }
            self.headings[at] = turned(best.0);
            from = self.go(ahead, robot, from, block..block + 1, f64::INFINITY);
        }
    }

    /// One robot along its course through these blocks, from its place and what is known at their start, while the information of
    /// the others stays. Stops early once the cost is above a limit.
    fn go<const N: usize>(
        &mut self,
        ahead: &Lookahead<'_, N>,
        robot: usize,
        (mut place_m, mut known): (Vector, PredictedBelief<N>),
        blocks: Range<usize>,
        limit: f64,
    ) -> (Vector, PredictedBelief<N>) {
        for step in self.steps(blocks) {
            if known.cost > limit {
                break;
            }
            let (next_m, information) = self.advance(ahead, &known, robot, step, place_m);
            place_m = next_m;
            ahead.measure(&mut known, self.rest[step] + information);
        }
        (place_m, known)
    }

    /// One robot through a step: where it ends, and the information of its measurement there.
    fn advance<const N: usize>(
        &mut self,
        ahead: &Lookahead<'_, N>,
        known: &PredictedBelief<N>,
        robot: usize,
        step: usize,
        from_m: Vector,
    ) -> (Vector, Information) {
        let (robots, block) = (self.robots, self.block(step));
        let heading = self.headings[block * robots + robot];
        let (places_m, next_m) = self.places_m[step * robots..].split_at_mut(robots);
        let (along, speed_mps) = ahead.motion(known, robot, from_m, heading, places_m, &mut self.corners);
        let way_m = along * (speed_mps * ahead.situation.step_s);
        next_m[robot] = from_m + way_m;
        let information = ahead.information(known, robot, way_m, next_m[robot]);
        self.informations[step * robots + robot] = information;
        self.work += work_of_step(ahead.situation);
        (next_m[robot], information)
    }
}
