//! The courses of the robots over the horizon: headings that are held for blocks of steps.

use super::ahead::{Ahead, Corners, Known};
use crate::planner::curves::information::Information;
use crate::planner::curves::minimum::minimum;
use crate::vector::Vector;

/// Headings that are tried for a block, evenly spread, before the best of them is improved.
const SAMPLES: usize = 12;

/// How far a heading turns in a sweep after the first, rad.
const NEAR_RAD: f64 = 0.5;

/// Accuracy of a heading, relative to how far it may turn: near the best, costs are alike.
const ACCURACY: f64 = 1e-2;

/// Sweeps over the team at most.
const SWEEPS_MAX: usize = 6;

/// A sweep that improves the cost by less than this share is the last.
const SETTLED: f64 = 1e-3;

/// Courses and what they lead to. Rows of robots are ordered by step or by block.
#[derive(Debug, Default)]
pub(super) struct Courses {
    steps: usize,
    blocks: usize,
    robots: usize,
    /// Of each block's robots, unit vectors: the wishes; clearances may turn or slow a robot.
    pub(super) headings: Vec<Vector>,
    /// Where the robots are at the start of each step, m.
    places_m: Vec<Vector>,
    /// What each robot's measurement at the end of each step tells.
    told: Vec<Information>,
    /// What the measurements of all robots but one tell, by step.
    rest: Vec<Information>,
    /// Headings before a sweep.
    before: Vec<Vector>,
    corners: Corners,
}

impl Courses {
    /// Courses of a team of this size, all straight along the same axis.
    pub(super) fn size(&mut self, steps: usize, blocks: usize, robots: usize) {
        (self.steps, self.blocks, self.robots) = (steps, blocks, robots);
        self.headings.clear();
        self.headings.resize(blocks * robots, Vector::new(1.0, 0.0));
        self.places_m.clear();
        self.places_m.resize((steps + 1) * robots, Vector::default());
        self.told.clear();
        self.told.resize(steps * robots, Information::default());
        self.rest.clear();
        self.rest.resize(steps, Information::default());
    }

    /// The block that a step belongs to.
    pub(super) fn block(&self, step: usize) -> usize {
        step * self.blocks / self.steps
    }

    /// Where the robots stand now, m.
    pub(super) fn starts_m(&self) -> &[Vector] {
        &self.places_m[..self.robots]
    }

    /// The team along its courses: the cost of the horizon.
    pub(super) fn follow<const N: usize>(&mut self, ahead: &Ahead<'_, N>) -> f64 {
        let robots = self.robots;
        for (place_m, member) in self.places_m.iter_mut().zip(&ahead.situation.team) {
            *place_m = member.position_m;
        }
        let mut known = ahead.first();
        for step in 0..self.steps {
            let block = self.block(step);
            let (places_m, next_m) = self.places_m[step * robots..].split_at_mut(robots);
            let mut total = Information::default();
            for (robot, next_m) in next_m[..robots].iter_mut().enumerate() {
                let heading = self.headings[block * robots + robot];
                let from_m = places_m[robot];
                let (along, speed_mps) = ahead.motion(&known, robot, from_m, heading, places_m, &mut self.corners);
                let way_m = along * (speed_mps * ahead.situation.step_s);
                *next_m = from_m + way_m;
                let told = ahead.told(&known, robot, way_m, *next_m);
                self.told[step * robots + robot] = told;
                total += told;
            }
            ahead.measure(&mut known, total);
        }
        known.cost
    }

    /// Improves the headings robot by robot and block by block until little changes; returns the cost of the horizon.
    ///
    /// While one robot's heading is improved, the others keep their places, as if they had not to make way for it. So what a sweep
    /// leads to is computed with all robots, and a sweep that makes it worse is undone.
    pub(super) fn descend<const N: usize>(&mut self, ahead: &Ahead<'_, N>, work: &mut usize) -> f64 {
        let mut cost = self.follow(ahead);
        for sweep in 0..SWEEPS_MAX {
            self.before.clone_from(&self.headings);
            for robot in (0..self.robots).filter(|robot| ahead.situation.team[*robot].is_fused) {
                if *work == 0 {
                    break;
                }
                self.improve(ahead, robot, sweep == 0, work);
            }
            let after = self.follow(ahead);
            // NaN is no improvement.
            if !(after < cost) {
                self.headings.clone_from(&self.before);
                break;
            }
            let is_settled = cost - after <= SETTLED * after;
            cost = after;
            if is_settled {
                break;
            }
        }
        cost
    }

    /// Improves the headings of one robot, block by block: the first sweep looks all round, others near the present heading.
    fn improve<const N: usize>(&mut self, ahead: &Ahead<'_, N>, robot: usize, is_first: bool, work: &mut usize) {
        let robots = self.robots;
        for (rest, told) in self.rest.iter_mut().zip(self.told.chunks(robots)) {
            let others = told.iter().enumerate().filter(|(other, _)| *other != robot);
            *rest = others.fold(Information::default(), |sum, (_, told)| sum + *told);
        }
        let mut from = (self.places_m[robot], ahead.first());
        for block in 0..self.blocks {
            let at = block * robots + robot;
            let now = self.headings[at];
            let turned = |turn_rad: f64| now.rotated_by(Vector::from_angle(turn_rad));
            let mut cost = |turn_rad: f64| {
                self.headings[at] = turned(turn_rad);
                self.go(ahead, robot, from, block..self.blocks, work).1.cost
            };
            let (mut best_rad, mut least, mut width_rad) = (0.0, cost(0.0), NEAR_RAD);
            if is_first {
                width_rad = std::f64::consts::TAU / SAMPLES as f64;
                for k in 1..SAMPLES {
                    let turn_rad = k as f64 * width_rad;
                    let tried = cost(turn_rad);
                    if tried < least {
                        (best_rad, least) = (turn_rad, tried);
                    }
                }
            }
            let better_rad = minimum(&mut cost, (best_rad - width_rad, best_rad + width_rad), best_rad, ACCURACY);
            if cost(better_rad) < least {
                best_rad = better_rad;
            }
            self.headings[at] = turned(best_rad);
            from = self.go(ahead, robot, from, block..block + 1, work);
        }
    }

    /// One robot along its course through these blocks, from its place and what is known at their start; the others tell what
    /// they told.
    fn go<const N: usize>(
        &mut self,
        ahead: &Ahead<'_, N>,
        robot: usize,
        (mut place_m, mut known): (Vector, Known<N>),
        blocks: std::ops::Range<usize>,
        work: &mut usize,
    ) -> (Vector, Known<N>) {
        let robots = self.robots;
        let start = |block: usize| (block * self.steps).div_ceil(self.blocks);
        let steps = start(blocks.start)..start(blocks.end);
        *work = work.saturating_sub(steps.len());
        for step in steps {
            let heading = self.headings[self.block(step) * robots + robot];
            let places_m = &self.places_m[step * robots..][..robots];
            let (along, speed_mps) = ahead.motion(&known, robot, place_m, heading, places_m, &mut self.corners);
            let way_m = along * (speed_mps * ahead.situation.step_s);
            place_m = place_m + way_m;
            let told = ahead.told(&known, robot, way_m, place_m);
            self.told[step * robots + robot] = told;
            self.places_m[(step + 1) * robots + robot] = place_m;
            ahead.measure(&mut known, self.rest[step] + told);
        }
        (place_m, known)
    }
}
