//! Filter and planner steps over the size of the team: `cargo bench -p rangehound-bench`.

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use nalgebra::{Matrix2, SMatrix, SVector, Vector2};
use rangehound_bench::{problem, team};
use rangehound_fusion::filter::{Estimate, RangeInformation};
use rangehound_fusion::planner::{self, Plan, Problem, Vector};
use rangehound_shared::motion::MotionModel;
use rangehound_shared::scenario::PlannerSpec;

const PAPER: PlannerSpec = PlannerSpec::Adaptive { iterations: 20, alpha: 0.5 };

/// Prediction and joint update of the paper's filter.
fn filter(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("filter step");
    let transition = MotionModel::IntegratorChain { order: 2, noise_psd: 10.0 }.transition::<4>(0.1);
    let start = Estimate { x: SVector::zeros(), p: SMatrix::<f64, 4, 4>::identity() };
    for robots in [3, 10, 100, 1_000] {
        let readings: Vec<_> = team(robots)
            .map(|robot| {
                (Vector2::new(robot.position_m.x, robot.position_m.y), robot.position_m.norm(), robot.range_std_m)
            })
            .collect();
        group.throughput(Throughput::Elements(robots as u64));
        group.bench_with_input(BenchmarkId::from_parameter(robots), &readings, |bencher, readings| {
            bencher.iter(|| {
                let predicted = black_box(&start).predict(black_box(&transition));
                let mut information = RangeInformation::default();
                for (position_m, range_m, std_m) in readings {
                    information.add(&predicted.innovation(*position_m, *range_m, *std_m));
                }
                predicted.update(&information)
            });
        });
    }
}

/// The relaxations, from a problem to headings.
fn relaxation(criterion: &mut Criterion) {
    for (name, spec) in [("adaptive", PAPER), ("standard", PlannerSpec::Standard { iterations: 20 })] {
        let mut group = criterion.benchmark_group(format!("{name} relaxation, 20 iterations"));
        for robots in [3, 10, 100, 1_000, 10_000] {
            let problem = problem(robots);
            let Ok(mut planner) = planner::for_team(spec, robots, 1) else { continue };
            let mut plan = Plan::default();
            group.throughput(Throughput::Elements(robots as u64));
            group.bench_with_input(BenchmarkId::from_parameter(robots), &problem, |bencher, problem| {
                bencher.iter(|| planner.plan(0, black_box(problem), &mut plan));
            });
        }
    }
}

/// Posing the problem and planning, as fusion does each tick.
fn pose_and_plan(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("pose and plan, adaptive");
    for robots in [3, 10, 100] {
        let Ok(mut planner) = planner::for_team(PAPER, robots, 1) else { continue };
        let (mut problem, mut plan) = (Problem::default(), Plan::default());
        group.bench_function(BenchmarkId::from_parameter(robots), |bencher| {
            bencher.iter(|| {
                problem.pose(black_box(&Matrix2::new(0.4, 0.1, 0.1, 0.2)), Vector::default(), 0.1, team(robots));
                planner.plan(0, &problem, &mut plan);
            });
        });
    }
}

/// The paper's yardstick; four robots would take seconds a step.
fn grid(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("grid search, pi/200");
    group.sample_size(10);
    for robots in [1, 2, 3] {
        let problem = problem(robots);
        let spec = PlannerSpec::Grid { step_rad: std::f64::consts::PI / 200.0 };
        let Ok(mut planner) = planner::for_team(spec, robots, 1) else { continue };
        let mut plan = Plan::default();
        group.bench_with_input(BenchmarkId::from_parameter(robots), &problem, |bencher, problem| {
            bencher.iter(|| planner.plan(0, black_box(problem), &mut plan));
        });
    }
}

criterion_group!(benches, filter, relaxation, pose_and_plan, grid);
criterion_main!(benches);
