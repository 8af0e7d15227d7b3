//! Filter and planner steps over the size of the team: `cargo bench -p rangehound-bench`.

use std::hint::black_box;
use std::time::Instant;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use nalgebra::{Matrix2, SMatrix, SVector, Vector2};
use rangehound_bench::{paper_problems, problem, team};
use rangehound_fusion::filter::{Gaussian, Information};
use rangehound_fusion::nuisance::Chain;
use rangehound_fusion::planner::range_only::{Arm, Problem, Solution, solver};
use rangehound_fusion::planner::{self, Plan, Situation};
use rangehound_fusion::tracker::kalman::Kalman;
use rangehound_fusion::tracker::{Gate, Reading, Tracker};
use rangehound_fusion::vector::Vector;
use rangehound_shared::measurement::{Kind, Pose};
use rangehound_shared::motion::MotionModel;
use rangehound_shared::scenario::{Clearance, NuisanceSpec, PlannerSpec, PoseCorrelation, Treatment};

const CERTIFIED: PlannerSpec = PlannerSpec::Certified { nodes: 2_000 };

const PLANNERS: [PlannerSpec; 6] = [
    CERTIFIED,
    PlannerSpec::Adaptive { iterations: 20, alpha: 0.5 },
    PlannerSpec::Standard { iterations: 20 },
    PlannerSpec::Greedy,
    PlannerSpec::Pursue,
    PlannerSpec::Random,
];

/// Prediction and joint update of the paper's filter.
fn filter(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("filter step");
    let transition = MotionModel::IntegratorChain { order: 2, noise_psd: 10.0 }.transition::<4>(0.1);
    let start = Gaussian { x: SVector::zeros(), p: SMatrix::<f64, 4, 4>::identity() };
    for robots in [3, 10, 100, 1_000] {
        let readings: Vec<_> = team(robots)
            .filter_map(|robot| {
                let position_m = Vector2::new(robot.position_m.x, robot.position_m.y);
                Some((position_m, robot.position_m.norm(), robot.sensor.range?.std_m))
            })
            .collect();
        group.throughput(Throughput::Elements(robots as u64));
        group.bench_with_input(BenchmarkId::from_parameter(robots), &readings, |bencher, readings| {
            bencher.iter(|| {
                let predicted = black_box(&start).predict(black_box(&transition));
                let mut information = Information::default();
                for (position_m, range_m, std_m) in readings {
                    information.add(&predicted.innovation(*position_m, *range_m, *std_m));
                }
                predicted.update(&information)
            });
        });
    }
}

/// One tick of the tracker: ranges and bearings of robots whose positions drift.
fn uncertain_robots(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("filter step, both sensors and drifting positions");
    let motion = MotionModel::IntegratorChain { order: 2, noise_psd: 10.0 };
    let nuisances = NuisanceSpec {
        pose_std_m: 0.1,
        pose_drift_m: 0.1,
        heading_std_rad: 0.01,
        correlation: PoseCorrelation::Drift,
        ..NuisanceSpec::default()
    };
    for robots in [3, 10, 100, 1_000] {
        let chain = Chain::of(vec![nuisances; robots], Treatment::Schmidt);
        let start = Gaussian { x: SVector::zeros(), p: SMatrix::<f64, 4, 4>::identity() };
        let mut tracker = Kalman::new(motion.clone(), start, Gate::new(None), chain);
        let readings: Vec<Reading> = team(robots)
            .enumerate()
            .flat_map(|(id, robot)| {
                let pose = Pose {
                    covariance_m2: [0.02, 0.0, 0.02],
                    heading_std_rad: 0.01,
                    ..Pose::at([robot.position_m.x, robot.position_m.y])
                };
                let range = Reading { robot: id, pose, value: robot.position_m.norm(), std: 1.0, ..Reading::default() };
                let value = (-robot.position_m.y).atan2(-robot.position_m.x);
                [range, Reading { kind: Kind::Bearing, value, std: 0.02, ..range }]
            })
            .collect();
        group.throughput(Throughput::Elements(robots as u64));
        group.bench_with_input(BenchmarkId::from_parameter(robots), &readings, |bencher, readings| {
            bencher.iter(|| tracker.step(0.1, black_box(readings)));
        });
    }
}

/// From a problem to commands, for every planner that does not take exponential time.
fn planners(criterion: &mut Criterion) {
    for spec in PLANNERS {
        let mut group = criterion.benchmark_group(spec.name());
        for robots in [3, 10, 100, 1_000, 10_000] {
            let problem = problem(robots);
            let Ok(mut solver) = solver(spec, robots, 1) else { continue };
            let mut solution = Solution::default();
            group.throughput(Throughput::Elements(robots as u64));
            group.bench_with_input(BenchmarkId::from_parameter(robots), &problem, |bencher, problem| {
                bencher.iter(|| solver.solve(0, black_box(problem), &mut solution));
            });
        }
    }
}

/// The planners' inputs in the paper's runs: percentiles of single steps, then the mean.
fn along_the_papers_trajectories(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("along the paper's trajectories, mean");
    for (name, stand_off_m) in [("paper", 0.0), ("stand-off 2 m", 2.0)] {
        let Some(problems) = paper_problems(stand_off_m) else { continue };
        for spec in PLANNERS {
            let Ok(mut solver) = solver(spec, 3, 1) else { continue };
            let mut solution = Solution::default();
            let mut nanoseconds: Vec<u128> = problems
                .iter()
                .map(|problem| {
                    let began = Instant::now();
                    solver.solve(0, black_box(problem), &mut solution);
                    began.elapsed().as_nanos()
                })
                .collect();
            nanoseconds.sort_unstable();
            let at = |share: usize| nanoseconds[(nanoseconds.len() - 1) * share / 100];
            println!("{} on {name}: p50 {} ns, p99 {} ns, max {} ns", spec.name(), at(50), at(99), at(100));
            let mut next = problems.iter().cycle();
            group.bench_function(BenchmarkId::new(spec.name(), name), |bencher| {
                bencher.iter(|| next.next().map(|problem| solver.solve(0, black_box(problem), &mut solution)));
            });
        }
    }
}

/// From a situation to commands, as fusion does each tick.
fn pose_and_plan(criterion: &mut Criterion) {
    for spec in PLANNERS {
        let mut group = criterion.benchmark_group(format!("pose and plan, {}", spec.name()));
        for robots in [3, 10, 100] {
            let Ok(mut planner) = planner::for_team(spec, robots, 1) else { continue };
            let clearance = Clearance { stand_off_m: 2.0, ..Clearance::default() };
            let mut situation = Situation { clearance, step_s: 0.1, ..Situation::default() };
            let mut plan = Plan::default();
            group.bench_function(BenchmarkId::from_parameter(robots), |bencher| {
                bencher.iter(|| {
                    let prior = black_box(Matrix2::new(0.4, 0.1, 0.1, 0.2));
                    situation.belief.set_position(Vector::default(), &prior);
                    situation.team.clear();
                    situation.team.extend(team(robots));
                    planner.plan(0, &situation, &mut plan);
                });
            });
        }
    }
}

/// The paper's grid search against the proven optimum of (25) without (26): no speed limit, and so no headings. Also
/// prints their objectives; the grid is the less accurate of the two. With four robots the grid takes seconds per step.
fn grid(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("without constraints");
    group.sample_size(10);
    for robots in [1, 2, 3] {
        let free = problem(robots).arms().iter().map(|arm| Arm::circle(arm.lambda, arm.centre)).collect();
        let problem = Problem::of_arms(Vector::new(-2.0, -2.0), free);
        for spec in [PlannerSpec::Grid { step_rad: std::f64::consts::PI / 200.0 }, CERTIFIED] {
            let Ok(mut solver) = solver(spec, robots, 1) else { continue };
            let mut solution = Solution::default();
            solver.solve(0, &problem, &mut solution);
            let gap = solution.objective / problem.lambda_sum();
            println!("{} of {robots} robots: |S| is {gap:.1e} of the sum of all lambda", spec.name());
            group.bench_with_input(BenchmarkId::new(spec.name(), robots), &problem, |bencher, problem| {
                bencher.iter(|| solver.solve(0, black_box(problem), &mut solution));
            });
        }
    }
}

criterion_group!(benches, filter, uncertain_robots, planners, along_the_papers_trajectories, pose_and_plan, grid);
criterion_main!(benches);
