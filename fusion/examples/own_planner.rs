//! A new planner beside the built-in ones: three robots and a target, in one process.
//!
//! ```sh
//! cargo run --release -p rangehound-fusion --example own_planner
//! ```
//!
//! It solves the range-only problem. A planner that needs other parts of the situation implements `Planner` itself.
//!
//! To add it to the tool, put it into a file in `fusion/src/planner/range_only/`, with a line in its `solver` and a
//! variant of `PlannerSpec`. `rangehound run`, `plan` and `compare` then know it by its name.

use rangehound_fusion::Centre;
use rangehound_fusion::planner::range_only::{Problem, RangeOnly, Solution, Solver};
use rangehound_fusion::planner::{Planner, for_team};
use rangehound_fusion::vector::Vector;
use rangehound_shared::draws::{Draws, Stream};
use rangehound_shared::measurement::{Measurement, Pose};
use rangehound_shared::scenario::{PlannerSpec, Scenario, ScenarioFile};

/// Each robot in turn reacts to its teammates: it points its vector against the sum of all others, or as near to that
/// as its arc allows. It does one round, so it is fast; the built-in relaxation continues until nothing moves.
#[derive(Debug)]
struct BestReplies;

impl Solver for BestReplies {
    fn name(&self) -> &'static str {
        "best replies"
    }

    fn solve(&mut self, _tick: u64, problem: &Problem, solution: &mut Solution) {
        let arms = problem.arms();
        // The start is the middle of each arc: the bearing if the robot does not move.
        solution.directions.clear();
        solution.directions.extend(arms.iter().map(|arm| arm.centre));
        let mut sum = problem.sum(&solution.directions);
        for (arm, direction) in arms.iter().zip(&mut solution.directions) {
            let others = sum - *direction * arm.lambda;
            *direction = arm.nearest(-others, arm.centre);
            sum = others + *direction * arm.lambda;
        }
        // Headings, speeds and the prediction follow from the directions.
        solution.complete(problem);
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let scenario = Scenario::from_file(&ScenarioFile::default(), "built in")?;
    let built_in = |spec| for_team(spec, scenario.robots.len(), scenario.seed);
    let planners: [Box<dyn Planner>; 4] = [
        Box::new(RangeOnly::new(Box::new(BestReplies))),
        built_in(PlannerSpec::Certified { nodes: 2_000 })?,
        built_in(PlannerSpec::Greedy)?,
        built_in(PlannerSpec::Random)?,
    ];
    println!("{:<14}{:>24}", "planner", "median trace, m^2");
    for planner in planners {
        let name = planner.name();
        println!("{name:<14}{:>24.3}", median_trace_m2(&scenario, planner)?);
    }
    Ok(())
}

/// Lets the team follow a target for a while; returns the median of the filter's trace at the ends of the ticks.
fn median_trace_m2(scenario: &Scenario, planner: Box<dyn Planner>) -> Result<f64, Box<dyn std::error::Error>> {
    let mut centre = Centre::new(scenario)?.planned_by(planner);
    let mut robots_m: Vec<Vector> =
        scenario.robots.iter().map(|robot| Vector::new(robot.start_m[0], robot.start_m[1])).collect();
    let stream = |robot| Draws::new(scenario.seed, Stream::RangeNoise { robot });
    let mut noise: Vec<Draws> = (0..robots_m.len()).map(stream).collect();
    let mut traces_m2 = Vec::new();
    for tick in 0..=300 {
        let time_s = tick as f64 * scenario.dt_s;
        let target_m = Vector::new(6.0 * time_s, 8.0 * (0.2 * time_s).sin());
        let measured = robots_m.iter().zip(&mut noise).zip(&scenario.robots).map(|((at_m, noise), robot)| {
            let mut drawn = [0.0];
            noise.standard_normal(tick, &mut drawn);
            let std_m = robot.sensor.range.map_or(1.0, |range| range.std_m);
            let range_m = (target_m - *at_m).norm() + std_m * drawn[0];
            // At tick 0 nothing is measured yet.
            let pose = Pose::at([at_m.x, at_m.y]);
            Some(Measurement::new(pose, (tick > 0).then_some((range_m, std_m))))
        });
        let reports: Vec<Option<Measurement>> = measured.collect();
        centre.update(time_s, &reports)?;
        for (at_m, command) in robots_m.iter_mut().zip(centre.plan()) {
            *at_m += Vector::from_angle(command.heading_rad) * (command.speed_mps * scenario.dt_s);
        }
        let (p, n) = (centre.covariance(), centre.state().len());
        traces_m2.push(p[0] + p[n + 1]);
    }
    traces_m2.sort_by(f64::total_cmp);
    Ok(traces_m2[traces_m2.len() / 2])
}
