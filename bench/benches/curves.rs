//! The certified planner on random problems with any sensors: how many are certified, and percentiles of the times.
//!
//! `cargo bench -p rangehound-bench --bench curves`, and after `--` the problems of each kind and size, then sizes.

use std::time::Instant;

use rangehound_bench::{Kind, random_situation};
use rangehound_fusion::planner::{self, Plan};
use rangehound_shared::scenario::PlannerSpec;

/// Each problem is planned this often: the least of its times counts.
const ROUNDS: usize = 3;

fn main() {
    let numbers: Vec<u64> = std::env::args().filter_map(|argument| argument.parse().ok()).collect();
    let problems = numbers.first().copied().unwrap_or(1_000);
    let sizes = if numbers.len() > 1 { &numbers[1..] } else { &[1, 3, 10, 20] };
    println!(
        "{:<10} {:>3} {:>10} {:>9} {:>9} {:>9} {:>10}",
        "kind", "M", "certified", "p50 us", "p95 us", "p99 us", "max us"
    );
    for kind in Kind::ALL {
        for robots in sizes.iter().map(|size| *size as usize) {
            let Ok(mut planner) = planner::for_team(PlannerSpec::Certified { nodes: 2_000 }, robots, 1) else {
                continue;
            };
            let mut plan = Plan::default();
            let mut certified = 0;
            let mut times_us: Vec<f64> = (0..problems)
                .map(|number| {
                    let situation = random_situation(kind, robots, number);
                    let mut least_us = f64::INFINITY;
                    for _ in 0..ROUNDS {
                        let began = Instant::now();
                        planner.plan(0, &situation, &mut plan);
                        least_us = least_us.min(1e6 * began.elapsed().as_secs_f64());
                    }
                    certified += u64::from(plan.certificate.is_some_and(|certificate| certificate.is_optimal));
                    least_us
                })
                .collect();
            times_us.sort_unstable_by(f64::total_cmp);
            let at =
                |percent: usize| times_us.get((times_us.len().max(1) - 1) * percent / 100).copied().unwrap_or(f64::NAN);
            println!(
                "{:<10} {robots:>3} {certified:>10} {:>9.2} {:>9.2} {:>9.2} {:>10.2}",
                format!("{kind:?}"),
                at(50),
                at(95),
                at(99),
                at(100)
            );
        }
    }
}
