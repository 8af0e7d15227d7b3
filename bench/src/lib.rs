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
use rangehound_shared::draws::{Draws, Stream};
use rangehound_shared::scenario::{Clearance, PlannerTable, RangeNoise, Scenario, ScenarioFile, SensorSpec};

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

/// The sensors of the robots of a random problem.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Kind {
    /// Ranges, bearings or both, each robot its own.
    Mixed,
    /// Bearings.
    Bearing,
    /// Ranges of constant noise.
    Range,
    /// Both, from about where a range tells as much as a bearing.
    Flip,
    /// Ranges whose noise grows with the distance.
    Growing,
    /// Both, of robots that do not know exactly where they are.
    Uncertain,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Self; 6] = [Self::Mixed, Self::Bearing, Self::Range, Self::Flip, Self::Growing, Self::Uncertain];
}

/// The random problem of this number: a stand-off of 2 m, robots up to 60 m away, steps from 0.2 m to 20 m.
#[must_use]
pub fn random_situation(kind: Kind, robots: usize, number: u64) -> Situation {
    let mut draws = Draws::new(robots as u64, Stream::PriorMean);
    let mut numbers = vec![0.0; 3 + 9 * robots];
    draws.uniform(number, &mut numbers);
    let log = |share: f64, low: f64, high: f64| low * (high / low).powf(share);
    let turn = Vector::from_angle(std::f64::consts::TAU * numbers[0]);
    let ellipse = |u: &[f64], low: f64, high: f64| {
        let (a, b) = (log(u[0], low, high), log(u[1], low, high));
        let (x2, y2, xy) = (turn.x * turn.x, turn.y * turn.y, turn.x * turn.y);
        Matrix2::new(a * x2 + b * y2, (a - b) * xy, (a - b) * xy, a * y2 + b * x2)
    };
    let member = |u: &[f64]| {
        let both = (log(u[0], 0.3, 3.0), log(u[1], 0.0175, 0.175));
        let (range, bearing) = match kind {
            Kind::Mixed => {
                [(Some(both.0), None), (None, Some(both.1)), (Some(both.0), Some(both.1))][(3.0 * u[2]) as usize]
            }
            Kind::Bearing => (None, Some(both.1)),
            Kind::Range | Kind::Growing => (Some(both.0), None),
            Kind::Flip | Kind::Uncertain => (Some(both.0), Some(both.1)),
        };
        let (distance_m, max_speed_mps) = match kind {
            Kind::Flip => {
                let distance_m = both.0 / both.1 * (0.6 + u[3]);
                (distance_m, distance_m * (0.2 + 0.7 * u[4]))
            }
            _ => (5.0 + 55.0 * u[3], log(u[4], 0.2, 20.0)),
        };
        let std_per_m = if kind == Kind::Growing { 0.01 + 0.09 * u[6] } else { 0.0 };
        let position_m = Vector::from_angle(std::f64::consts::TAU * u[5]) * distance_m;
        let ranging = TeamMember::ranging(position_m, max_speed_mps, both.0);
        let sensor = SensorSpec {
            range: range.map(|std_m| RangeNoise { std_m, std_per_m }),
            bearing_std_rad: bearing,
            ..ranging.sensor
        };
        let is_uncertain = kind == Kind::Uncertain;
        let position_covariance_m2 = if is_uncertain { ellipse(&u[7..], 0.05, 2.0) } else { Matrix2::zeros() };
        let heading_std_rad = if is_uncertain { 0.05 * u[6] } else { 0.0 };
        TeamMember { sensor, position_covariance_m2, heading_std_rad, ..ranging }
    };
    Situation {
        belief: Belief::of_position(Vector::default(), &ellipse(&numbers[1..], 0.05, 20.0)),
        team: numbers[3..].chunks(9).map(member).collect(),
        clearance: Clearance { stand_off_m: 2.0, ..Clearance::default() },
        step_s: 1.0,
        ..Situation::default()
    }
}
