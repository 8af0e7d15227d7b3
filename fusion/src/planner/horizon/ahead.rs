//! The belief about the target at the steps ahead, given where the robots measure.

use nalgebra::{Matrix2, Vector2};
use rangehound_shared::motion::Transition;

use crate::filter::{self, Gaussian};
use crate::planner::curves::information::{Cost, Information};
use crate::planner::curves::noise::Noise;
use crate::planner::range_only::reach::{Limit, Reach, stand_off_m};
use crate::planner::{Situation, TeamMember};
use crate::vector::Vector;

/// The situation and what follows from it for every step ahead.
#[derive(Debug, Clone, Copy)]
pub(super) struct Lookahead<'a, const N: usize> {
    pub(super) situation: &'a Situation,
    /// Of each robot.
    pub(super) noises: &'a [Noise],
    pub(super) transition: Transition<N>,
}

/// The target at the end of a step, before the robots measure, and the cost of the steps before.
#[derive(Debug, Clone, Copy)]
pub(super) struct PredictedBelief<const N: usize> {
    pub(super) target: Gaussian<N>,
    pub(super) cost: f64,
}

/// Memory for the cells that neighbours leave.
#[derive(Debug, Default)]
pub(super) struct Corners {
    corners_m: Vec<Vector>,
    scratch_m: Vec<Vector>,
}

impl<const N: usize> Lookahead<'_, N> {
    /// At the end of the first step.
    pub(super) fn first(&self) -> PredictedBelief<N> {
        let belief = &self.situation.belief;
        let (x, p) = (belief.mean.fixed_rows::<N>(0).into(), belief.covariance.fixed_view::<N, N>(0, 0).into());
        PredictedBelief { target: Gaussian { x, p }, cost: 0.0 }
    }

    /// Counts the measurements at the end of a step, and goes on to the next: the filter's own update and prediction.
    pub(super) fn measure(&self, known: &mut PredictedBelief<N>, information: Information) {
        let Information { t, s } = information;
        let matrix = Matrix2::new(t + s.x, s.y, s.y, t - s.x) * 0.5;
        let prior = Information::of_covariance(&known.target.position_covariance());
        known.cost += self.situation.criterion.cost(prior + information);
        let updated = known.target.update(&filter::Information { matrix, vector: Vector2::zeros(), count: 0 });
        known.target = updated.predict(&self.transition);
    }

    /// Heading and speed of a robot that stands at `position_m` among these neighbours and wants to go along `heading`: as
    /// the clearances at the end of the step allow.
    pub(super) fn motion(
        &self,
        known: &PredictedBelief<N>,
        robot: usize,
        position_m: Vector,
        heading: Vector,
        places_m: &[Vector],
        corners: &mut Corners,
    ) -> (Vector, f64) {
        let Situation { team, clearance, step_s, .. } = self.situation;
        let (p, x) = (&known.target.p, &known.target.x);
        let stand_off_m = stand_off_m(clearance, p[(0, 0)] + p[(1, 1)]);
        let (target_m, speed_mps) = (Vector::new(x[0], x[1]), team[robot].max_speed_mps);
        let after_m = target_m - position_m - heading * (speed_mps * step_s);
        if clearance.separation_m == 0.0 && after_m.norm_squared() >= stand_off_m * stand_off_m {
            return (heading, speed_mps);
        }
        let member = TeamMember { position_m, ..team[robot] };
        let mut reach = Reach::new(&member, target_m, *step_s, stand_off_m);
        corners.corners_m.clear();
        if clearance.separation_m > 0.0 {
            let others = places_m.iter().enumerate().filter(|(other, _)| *other != robot);
            let limits = others.map(|(other, at_m)| {
                Limit::between((robot, position_m), (other, *at_m), clearance.separation_m, places_m.len())
            });
            reach.separate(limits, &mut corners.corners_m, &mut corners.scratch_m);
        }
        reach.motion_along(heading, &corners.corners_m)
    }

    /// The information of a robot's measurement after it went this way to a place.
    pub(super) fn information(
        &self,
        known: &PredictedBelief<N>,
        robot: usize,
        way_m: Vector,
        position_m: Vector,
    ) -> Information {
        if !self.situation.team[robot].is_fused {
            return Information::default();
        }
        let x = &known.target.x;
        self.noises[robot].information_after(way_m, Vector::new(x[0], x[1]) - position_m)
    }
}
