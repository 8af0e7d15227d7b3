//! The paper's experiment over many seeds; each is a complete team in this process (Figs. 3 and 4).

use rangehound::run::experiment::DEFAULT_SCENARIO;
use rangehound::run::in_process::Team;
use rangehound_shared::scenario::{Scenario, ScenarioFile};

const SEEDS: u64 = 200;
const TICKS: usize = 200;

/// Position trace by seed and tick, m^2.
fn traces_m2(planner: &str) -> Vec<Vec<f64>> {
    (1..=SEEDS)
        .map(|seed| {
            let mut file =
                ScenarioFile { seed: Some(seed), ..ScenarioFile::parse(DEFAULT_SCENARIO, "paper.toml").unwrap() };
            file.planner.get_or_insert_default().name = Some(planner.to_owned());
            let scenario = Scenario::from_file(&file, "test").unwrap();
            let mut team = Team::new(&scenario).unwrap();
            (0..=TICKS)
                .map(|_| {
                    team.tick().unwrap();
                    team.advance();
                    let covariance = team.centre().covariance();
                    covariance[0] + covariance[5]
                })
                .collect()
        })
        .collect()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Median over the seeds at one tick.
fn median_at(traces: &[Vec<f64>], tick: usize) -> f64 {
    median(traces.iter().map(|trace| trace[tick]).collect())
}

/// Median over the seeds and all ticks after 100.
fn median_after_100(traces: &[Vec<f64>]) -> f64 {
    median(traces.iter().flat_map(|trace| trace[101..].iter().copied()).collect())
}

#[test]
fn adaptive_relaxation_reaches_the_papers_trace_and_random_does_not() {
    let adaptive = traces_m2("adaptive");
    let (first, tenth, settled) = (median_at(&adaptive, 1), median_at(&adaptive, 10), median_after_100(&adaptive));
    let random = median_after_100(&traces_m2("random"));
    println!(
        "{SEEDS} seeds x {TICKS} ticks: adaptive relaxation's median trace is {first:.2} m^2 at tick 1, {tenth:.2} \
         at tick 10, {settled:.3} after tick 100; random {random:.2} ({:.0} times worse)",
        random / settled
    );
    assert!((settled - 0.58).abs() <= 0.04, "{settled}");
    assert!((first - 9.4).abs() < 0.6, "{first}");
    assert!((tenth - 1.0).abs() < 0.3, "{tenth}");
    assert!(random > 10.0 * settled, "{random}");
}
