use super::super::{Arm, Vector};
use super::*;
use rand::{RngExt as _, SeedableRng as _};
use rangehound_shared::scenario::defaults;
use std::f64::consts::PI;

/// Arcs, lengths and prior at random, as hard as they come.
fn hard_problem(random: &mut impl rand::Rng, robots: usize) -> Problem {
    let arms: Vec<Arm> = (0..robots)
        .map(|_| {
            let centre = Vector::from_angle(random.random_range(-PI..PI));
            let half_width = Vector::from_angle(random.random_range(0.1..3.0));
            Arm::with_half_width(random.random_range(0.1..10.0), centre, half_width)
        })
        .collect();
    let lambda_sum: f64 = arms.iter().map(|arm| arm.lambda).sum();
    let prior = Vector::from_angle(random.random_range(-PI..PI)) * (random.random_range(0.0..0.8) * lambda_sum);
    Problem::of_arms(prior, arms)
}

#[test]
fn survey() {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(1);
    for robots in [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 25, 50, 100, 150] {
        let mut planner = Certified::new(defaults::NODES as u32);
        let mut plan = Plan::default();
        let mut times = Vec::new();
        let mut nodes = Vec::new();
        let (mut certified, mut worst, mut zero) = (0, 0.0_f64, 0);
        let runs = 1000;
        for _ in 0..runs {
            let problem = hard_problem(&mut random, robots);
            let began = std::time::Instant::now();
            planner.plan(0, &problem, &mut plan);
            times.push(began.elapsed().as_nanos());
            nodes.push(planner.search.looked_into);
            certified += u32::from(plan.is_certified(&problem));
            zero += u32::from(plan.objective < 1e-9 * problem.lambda_sum());
            if !plan.is_certified(&problem) {
                println!("{} {} {problem:?}", plan.objective, plan.lower_bound);
            }
            worst = worst.max((plan.objective - plan.lower_bound) / problem.lambda_sum());
        }
        times.sort_unstable();
        nodes.sort_unstable();
        println!(
            "M={robots}: certified {certified}/{runs} zero {zero} worst gap {worst:.1e} ns p50 {} p90 {} p99 {} max {} nodes p50 {} p99 {} max {}",
            times[runs / 2],
            times[runs * 9 / 10],
            times[runs * 99 / 100],
            times[runs - 1],
            nodes[runs / 2],
            nodes[runs * 99 / 100],
            nodes[runs - 1]
        );
    }
}

#[test]
fn look() {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(1);
    let mut shown = 0;
    for robots in [3, 4, 5, 7] {
        let mut planner = Certified::new(defaults::NODES as u32);
        let mut plan = Plan::default();
        for _ in 0..3000 {
            let problem = hard_problem(&mut random, robots);
            planner.plan(0, &problem, &mut plan);
            if planner.search.looked_into > 60 {
                shown += 1;
                let s = problem.sum(&plan.directions);
                println!(
                    "M={robots} nodes {} S {:.4} prior {:.3}",
                    planner.search.looked_into,
                    s.norm(),
                    problem.prior.norm()
                );
                let u = s.normalised().unwrap();
                for (arm, d) in problem.arms.iter().zip(&plan.directions) {
                    let inside = if *d == arm.low || *d == arm.high { "end" } else { "inside" };
                    println!(
                        "   lambda {:.3} angle to S {:.4} {inside} half width {:.3}",
                        arm.lambda,
                        u.cross(*d).atan2(u.dot(*d)),
                        arm.centre.cross(arm.high).atan2(arm.centre.dot(arm.high))
                    );
                }
            }
        }
    }
    println!("{shown}");
}
