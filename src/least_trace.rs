//! How well the target can be known at the next tick, whatever the headings: what the certified planner proves, as a trace.

use nalgebra::SMatrix;
use rangehound_shared::STATE_DIM_MAX;
use rangehound_shared::message::{Command, Estimate};
use rangehound_shared::motion::Transition;
use rangehound_shared::record::Exchange;
use rangehound_shared::robot_set::RobotSet;
use rangehound_shared::scenario::Scenario;

/// The trace of the position covariance, m^2, that no headings of this tick can lead below at the next one:
/// `4 T / (T^2 - L^2)` with the proven bound `L` on `|S|`. `None` if the planner has proven none.
///
/// `T` is what prediction and ranges tell together, 1/m^2, if all that were planned for measure and are fused. If fewer do,
/// the next trace lies above; only a late range, of which the plan did not know, can bring it below.
#[must_use]
pub fn least_next_trace_m2(
    scenario: &Scenario,
    tick: u64,
    estimate: &Estimate,
    exchanges: impl IntoIterator<Item = Exchange>,
) -> Option<f64> {
    let bound = Some(estimate.lower_bound).filter(|bound| bound.is_finite())?;
    let [xx, xy, yy] = predicted_position_covariance_m2(scenario, estimate);
    let prior = (xx + yy) / (xx * yy - xy * xy);
    // Who was not heard is planned for a while, and else told to stand.
    let is_planned = |Exchange { heard, command }: Exchange| {
        heard.is_some_and(|heard| heard.taken_at == tick) || command != Command::default()
    };
    let planned = scenario.robots.iter().zip(exchanges).enumerate().filter(|(_, (_, exchange))| is_planned(*exchange));
    // Of who is distrusted no range will be fused.
    let distrusted = RobotSet::from_bits(estimate.distrusted);
    let information = planned.fold(prior, |sum, (id, (robot, exchange))| {
        let told_m = exchange.heard.and_then(|heard| heard.range_m).map_or(robot.told_std_m, |(_, std_m)| std_m);
        if distrusted.contains(id) { sum } else { sum + (told_m * estimate.noise_scale).powi(-2) }
    });
    let trace_m2 = 4.0 * information / ((information - bound) * (information + bound));
    (trace_m2.is_finite() && trace_m2 > 0.0).then_some(trace_m2)
}

/// Its entries xx, xy and yy at the next tick, before any range.
fn predicted_position_covariance_m2(scenario: &Scenario, estimate: &Estimate) -> [f64; 3] {
    let Transition { phi, process_noise } = scenario.filter_motion.transition::<STATE_DIM_MAX>(scenario.dt_s);
    let n = (estimate.state_dim as usize).min(STATE_DIM_MAX);
    let covariance = SMatrix::<f64, STATE_DIM_MAX, STATE_DIM_MAX>::from_fn(|i, j| {
        if i < n && j < n { estimate.covariance[i * n + j] } else { 0.0 }
    });
    let position = phi.fixed_rows::<2>(0);
    let p = position * covariance * position.transpose() + process_noise.fixed_view::<2, 2>(0, 0);
    [p[(0, 0)], p[(0, 1)], p[(1, 1)]]
}

#[cfg(test)]
mod tests {

    use rangehound_shared::message::{Outgoing, Range};
    use rangehound_shared::scenario::{PlannerSpec, ScenarioFile};

    use super::*;
    use crate::in_process::Team;
    use crate::report::position_covariance;

    /// By tick, from 1 on: the trace, and the least that it could have been. Robot 0 is not heard at the tick that is missed.
    fn traces_m2(planner: PlannerSpec, missed: u64) -> Vec<(f64, Option<f64>)> {
        let mut scenario = Scenario::from_file(&ScenarioFile::default(), "test").unwrap();
        scenario.planner = planner;
        let mut team = Team::new(&scenario).unwrap();
        let (mut traces_m2, mut least_m2) = (Vec::new(), None);
        for tick in 0..=60 {
            let disturb = |ranges: &mut Vec<Outgoing<Range>>| {
                ranges.retain(|range| tick != missed || range.entry.robot != 0);
            };
            team.tick_disturbed(disturb).unwrap();
            let estimate = team.centre().estimate();
            traces_m2.push((position_covariance(&estimate).trace(), least_m2));
            let commands = team.centre().commands().iter();
            let exchanges = commands.map(|command| Exchange { heard: None, command: *command });
            least_m2 = least_next_trace_m2(&scenario, tick, &estimate, exchanges);
            team.advance();
        }
        traces_m2.split_off(1)
    }

    #[test]
    fn a_certified_team_reaches_the_least_trace_unless_a_range_is_missing() {
        let traces_m2 = traces_m2(PlannerSpec::Certified { nodes: 2_000 }, 30);
        for (tick, (trace_m2, least_m2)) in (1..).zip(traces_m2) {
            let above = trace_m2 / least_m2.unwrap() - 1.0;
            if tick == 30 {
                assert!(above > 1e-3, "{above}");
            } else {
                assert!(above.abs() < 1e-5, "tick {tick}: {above}");
            }
        }
    }

    #[test]
    fn who_proves_nothing_has_no_least_trace() {
        let traces_m2 = traces_m2(PlannerSpec::Adaptive { iterations: 20, alpha: 0.5 }, u64::MAX);
        assert!(traces_m2.iter().all(|(_, least_m2)| least_m2.is_none()));
    }
}
