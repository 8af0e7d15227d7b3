//! Problems that the benchmarks measure on; the benchmarks are in `benches/`.
//!
//! It measures the two steps of the loop that fusion computes:
//!
//! ```text
//! robot 0..M-1 --range--> fusion: FILTER, PLANNER --heading--> robot 0..M-1
//! ```
//!
//! It calls these steps directly, on teams made here or on the planner's inputs in the paper's runs, without processes or
//! topics: `rangehound latency` measures their cost. No other crate depends on this one.

use nalgebra::Matrix2;
use rangehound::run::in_process::Team;
use rangehound_fusion::belief::Belief;
use rangehound_fusion::planner::range_only::Problem;
use rangehound_fusion::planner::{Situation, TeamMember};
use rangehound_fusion::vector::Vector;
use rangehound_shared::scenario::{PlannerTable, Scenario, ScenarioFile};

/// A team of `robots` around a target, at distances as in the paper's runs, some within reach of a step, each with its own
/// noise.
pub fn team(robots: usize) -> impl Iterator<Item = TeamMember> {
    (0..robots).map(|i| {
        let (i, golden_angle) = (i as f64, 2.399_963);
        let distance_m = 0.5 + 25.0 * (i * 0.618_034).fract();
        let position_m = Vector::from_angle(i * golden_angle) * distance_m;
        TeamMember::ranging(position_m, 10.0, 0.5 + (i * 0.414_214).fract())
    })
}

/// The planning problem of [`team`] under an elongated prior that is more accurate for larger teams: in steady state the
/// prior has as much information as the ranges of a few ticks.
#[must_use]
pub fn problem(robots: usize) -> Problem {
    let prior = Matrix2::new(0.4, 0.1, 0.1, 0.2) * (3.0 / robots as f64);
    let belief = Belief::of_position(Vector::default(), &prior);
    Problem::of(&Situation { belief, team: team(robots).collect(), step_s: 0.1, ..Situation::default() })
}

/// The planner's inputs along the paper's trajectories: 20 runs of 200 ticks of its scenario.
/// `None` if the default scenario does not run.
#[must_use]
pub fn paper_problems(stand_off_m: f64) -> Option<Vec<Problem>> {
    let text = include_str!("../../scenarios/paper.toml");
    let mut problems = Vec::new();
    for seed in 0..20 {
        let mut file = ScenarioFile::parse(text, "paper.toml").ok()?;
        file.seed = Some(seed);
        let planner = file.planner.get_or_insert_with(PlannerTable::default);
        planner.name = Some("certified".to_owned());
        planner.stand_off_m = Some(stand_off_m);
        let scenario = Scenario::from_file(&file, "paper.toml").ok()?;
        let mut team = Team::new(&scenario).ok()?;
        for _ in 0..200 {
            if team.tick().is_err() {
                break;
            }
            problems.push(Problem::of(team.centre().situation()));
            team.advance();
        }
    }
    Some(problems)
}
