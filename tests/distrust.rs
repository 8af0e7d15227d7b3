//! Robots whose sensors fail for a while, over many seeds, each a whole team in this process.

use std::path::Path;

use nalgebra::Vector2;
use rangehound::in_process::Team;
use rangehound::report::position_error;
use rangehound_shared::scenario::{Scenario, ScenarioFile};

const SEEDS: u64 = 200;

/// Ticks at which the sensor of robot 1 is off.
const OFF: std::ops::Range<u64> = 100..200;

#[derive(Debug, Default)]
struct Outcome {
    named: u64,
    named_after: Vec<u64>,
    mended: u64,
    sound_ones_named: u64,
    lost: u64,
    worst: f64,
}

fn outcome(robots: u64, gate_sigma: f64, bias_m: f64) -> Outcome {
    let mut outcome = Outcome::default();
    for seed in 1..=SEEDS {
        let text = include_str!("../scenarios/recommended.toml");
        let mut file = ScenarioFile {
            seed: Some(seed),
            ticks: Some(300),
            ..ScenarioFile::parse(text, "recommended.toml").unwrap()
        };
        file.robots.get_or_insert_default().count = Some(robots);
        file.filter.get_or_insert_default().gate_sigma = Some(gate_sigma);
        let scenario = Scenario::from_file(&file, "test", Path::new("")).unwrap();
        let mut team = Team::new(&scenario).unwrap();
        let mut named = None;
        let mut sound_named = false;
        let mut last = 0.0;
        let mut worst: f64 = 0.0;
        for tick in 0..=300 {
            let disturbed = team.tick_disturbed(|reports| {
                if let Some(Some(report)) = reports.get_mut(1).filter(|_| OFF.contains(&tick))
                    && let Some((range_m, _)) = &mut report.range_m
                {
                    *range_m += bias_m;
                }
            });
            if disturbed.is_err() {
                last = 1e9;
                break;
            }
            let distrusted = team.centre().distrusted();
            if distrusted.contains(1) {
                named.get_or_insert(tick);
            }
            sound_named |= distrusted.iter().any(|id| id != 1);
            let truth = team.world().truth();
            last = position_error(&team.centre().estimate(), Vector2::new(truth[0], truth[1])).0.sqrt();
            if tick > 20 {
                worst = worst.max(last);
            }
            team.advance();
        }
        outcome.named += u64::from(named.is_some());
        outcome.named_after.extend(named.map(|tick| tick.saturating_sub(OFF.start)));
        outcome.mended += u64::from(named.is_some() && !team.centre().distrusted().contains(1));
        outcome.sound_ones_named += u64::from(sound_named);
        outcome.lost += u64::from(last > 10.0);
        outcome.worst += worst / SEEDS as f64;
    }
    outcome.named_after.sort_unstable();
    outcome
}

#[test]
fn experiment() {
    for robots in [2, 3, 4, 5, 8] {
        for gate_sigma in [3.0, 4.0, 5.0, 100.0] {
            for bias_m in [0.0, 6.0, 10.0, 30.0, -8.0] {
                let Outcome { named, named_after, mended, sound_ones_named, lost, worst } =
                    outcome(robots, gate_sigma, bias_m);
                let at = |share: f64| named_after.get((share * named_after.len() as f64) as usize).copied();
                println!(
                    "M={robots} gate {gate_sigma} bias {bias_m}: named {named} after {:?} p95 {:?}, mended {mended}, sound named {sound_ones_named}, lost {lost}, worst {worst:.2}",
                    at(0.5),
                    at(0.95)
                );
            }
        }
    }
}
