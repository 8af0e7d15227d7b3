//! A robot with a temporary sensor fault, over many seeds; each is a complete team in this process.

use nalgebra::Vector2;
use rangehound::results::report::position_error;
use rangehound::run::in_process::Team;
use rangehound_shared::scenario::{Scenario, ScenarioFile};

const SEEDS: u64 = 100;
const TICKS: u64 = 300;

/// Ticks at which the ranges of robot 1 are too long.
const OFF: std::ops::Range<u64> = 100..200;

/// The outcome of one run.
struct Outcome {
    /// The first tick after which robot 1 was distrusted.
    named_at: Option<u64>,
    another_was_named: bool,
    all_trusted_at_the_end: bool,
    error_at_the_end_m: f64,
}

/// Runs of `recommended.toml` with this number of robots, and this bias of robot 1's ranges.
fn outcomes(robots: u64, bias_m: f64) -> Vec<Outcome> {
    let recommended = include_str!("../../scenarios/recommended.toml");
    let mut file = ScenarioFile::parse(recommended, "recommended.toml").unwrap();
    file.robots.get_or_insert_default().count = Some(robots);
    (1..=SEEDS)
        .map(|seed| {
            file.seed = Some(seed);
            let scenario = Scenario::from_file(&file, "test").unwrap();
            run(&mut Team::new(&scenario).unwrap(), bias_m)
        })
        .collect()
}

fn run(team: &mut Team, bias_m: f64) -> Outcome {
    let (mut named_at, mut another_was_named, mut error_m) = (None, false, 0.0);
    for tick in 0..=TICKS {
        let bias_m = if OFF.contains(&tick) { bias_m } else { 0.0 };
        team.tick_disturbed(|ranges| {
            ranges
                .iter_mut()
                .filter(|range| range.entry.robot == 1)
                .for_each(|range| range.entry.measurement.range_m += bias_m);
        })
        .unwrap();
        let [distrusted, _] = team.centre().distrusted();
        if distrusted.contains(1) {
            named_at.get_or_insert(tick);
        }
        another_was_named |= distrusted.iter().any(|id| id != 1);
        let truth_m = Vector2::from_column_slice(&team.world().truth()[..2]);
        error_m = position_error(&team.centre().estimate(), truth_m).0.sqrt();
        team.advance();
    }
    let all_trusted_at_the_end = team.centre().distrusted().iter().all(|of_kind| of_kind.is_empty());
    Outcome { named_at, another_was_named, all_trusted_at_the_end, error_at_the_end_m: error_m }
}

#[test]
fn only_the_robot_with_the_faulty_sensor_is_distrusted_and_it_is_trusted_again() {
    // In a team of three, a faulty robot sometimes biases the estimate before its ranges fail.
    for (robots, slow_ones_max) in [(3, 3), (5, 0)] {
        for bias_m in [10.0, 30.0] {
            let mut slow_ones = 0;
            for outcome in outcomes(robots, bias_m) {
                let Outcome { named_at, another_was_named, all_trusted_at_the_end, error_at_the_end_m } = outcome;
                let what = format!("{robots} robots, {bias_m} m: named at {named_at:?}, off by {error_at_the_end_m} m");
                assert!(named_at.is_some_and(|tick| tick >= OFF.start + 4), "{what}");
                slow_ones += u64::from(named_at > Some(OFF.start + 9));
                assert!(!another_was_named && all_trusted_at_the_end && error_at_the_end_m < 5.0, "{what}");
            }
            assert!(slow_ones <= slow_ones_max, "{robots} robots, {bias_m} m: {slow_ones}");
        }
    }
}

#[test]
fn no_robot_is_distrusted_if_all_sensors_work() {
    for robots in [1, 2, 3, 5] {
        for outcome in outcomes(robots, 0.0) {
            assert!(outcome.named_at.is_none() && !outcome.another_was_named, "{robots} robots");
        }
    }
}
