//! A planner from outside: a function chooses the commands.

use std::fmt;

use rangehound_shared::message::Command;
use rangehound_shared::scenario::PlannerSpec;

use super::{ForAnyTeam, Plan, Planner, PlannerError, Situation};

/// Chooses a command for each member of the team, in the team's order: `(tick, situation, commands)`. The commands come
/// zeroed, one for each member.
pub type Choose = dyn FnMut(u64, &Situation, &mut [Command]) + Send;

/// The planner round a function. What its commands lead to is computed as for the built-in planners; it proves nothing.
pub struct Custom {
    choose: Box<Choose>,
    valuer: ForAnyTeam,
}

impl Custom {
    /// The planner round this function, for a team of `robots`.
    ///
    /// # Errors
    /// [`PlannerError`], as for a built-in planner.
    pub fn new(
        robots: usize,
        choose: impl FnMut(u64, &Situation, &mut [Command]) + Send + 'static,
    ) -> Result<Self, PlannerError> {
        Ok(Self { choose: Box::new(choose), valuer: ForAnyTeam::new(PlannerSpec::Greedy, robots, 0)? })
    }
}

impl fmt::Debug for Custom {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Custom").finish_non_exhaustive()
    }
}

impl Planner for Custom {
    fn name(&self) -> &'static str {
        "custom"
    }

    /// A robot is not asked for more than it can do, and stands still on a command that is not finite.
    fn plan(&mut self, tick: u64, situation: &Situation, plan: &mut Plan) {
        plan.commands.clear();
        plan.commands.resize(situation.team.len(), Command::default());
        (self.choose)(tick, situation, &mut plan.commands);
        for (command, member) in plan.commands.iter_mut().zip(&situation.team) {
            if !(command.heading_rad.is_finite() && command.speed_mps.is_finite()) {
                *command = Command::default();
            }
            command.speed_mps = command.speed_mps.clamp(0.0, member.max_speed_mps);
        }
        self.valuer.value(situation, plan);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::belief::Belief;
    use crate::planner::{TeamMember, for_team};
    use crate::vector::Vector;
    use nalgebra::Matrix2;

    #[test]
    fn commands_of_a_function_are_predicted_like_those_of_a_built_in_planner() {
        let at = |x, y| TeamMember::ranging(Vector::new(x, y), 9.0, 0.5);
        let situation = Situation {
            belief: Belief::of_position(Vector::default(), &Matrix2::new(3.0, 0.4, 0.4, 1.0)),
            team: vec![at(8.0, 1.0), at(-4.0, 6.0)],
            step_s: 0.1,
            ..Situation::default()
        };
        let mut known = Plan::default();
        for_team(PlannerSpec::Certified { nodes: 2_000 }, 2, 1).unwrap().plan(0, &situation, &mut known);
        let commands = known.commands.clone();
        let mut custom = Custom::new(2, move |_, _, chosen| chosen.copy_from_slice(&commands)).unwrap();
        let mut plan = Plan { certificate: known.certificate, ..Plan::default() };
        custom.plan(0, &situation, &mut plan);
        assert_eq!((plan.commands, plan.certificate), (known.commands, None));
        assert!((plan.predicted.position_trace_m2 / known.predicted.position_trace_m2 - 1.0).abs() < 1e-9);
    }

    #[test]
    fn no_robot_is_asked_for_more_than_it_can_do() {
        let member = TeamMember::ranging(Vector::new(5.0, 0.0), 2.0, 1.0);
        let belief = Belief::of_position(Vector::default(), &Matrix2::identity());
        let situation = Situation { belief, team: vec![member; 3], step_s: 0.1, ..Situation::default() };
        let mut custom = Custom::new(3, |_, _, commands| {
            commands[0] = Command { heading_rad: 1.0, speed_mps: 1e9 };
            commands[1] = Command { heading_rad: f64::NAN, speed_mps: 1.0 };
            commands[2] = Command { heading_rad: 0.0, speed_mps: -1.0 };
        })
        .unwrap();
        let mut plan = Plan::default();
        custom.plan(0, &situation, &mut plan);
        assert_eq!(plan.commands.iter().map(|command| command.speed_mps).collect::<Vec<_>>(), [2.0, 0.0, 0.0]);
        assert!(plan.predicted.position_trace_m2.is_finite());
    }
}
