//! A written scenario reads back, and a read scenario is validated.

use proptest::prelude::*;

use super::*;

fn any_number() -> impl Strategy<Value = f64> {
    prop_oneof![Just(0.0), -1e3..1e3_f64, any::<f64>().prop_filter("finite", |value| value.is_finite())]
}

fn maybe<T: std::fmt::Debug + Clone>(value: impl Strategy<Value = T>) -> impl Strategy<Value = Option<T>> {
    proptest::option::of(value)
}

fn target() -> impl Strategy<Value = TargetTable> {
    let rows = || maybe(proptest::collection::vec(proptest::collection::vec(any_number(), 1..4), 1..4));
    let model = maybe(prop_oneof!["zero_acceleration", "custom", "[a-z_]{1,12}"]);
    let real = maybe(proptest::bool::ANY);
    (model, maybe(any_number()), maybe(proptest::collection::vec(any_number(), 0..9)), real, rows(), rows(), rows())
        .prop_map(|(model, noise_psd, start, real, phi, g, qd)| TargetTable {
            model,
            noise_psd,
            start,
            real,
            phi,
            g,
            qd,
        })
}

fn robot() -> impl Strategy<Value = RobotTable> {
    (maybe(0..300_u64), maybe([any_number(), any_number()]), maybe(any_number()), maybe(any_number())).prop_map(
        |(id, start_m, speed_mps, range_std_m)| RobotTable {
            id,
            start_m,
            speed_mps,
            range_std_m,
            ..RobotTable::default()
        },
    )
}

fn file() -> impl Strategy<Value = ScenarioFile> {
    let timeout = prop_oneof![any_number().prop_map(TimeoutKey::Seconds), ".{0,9}".prop_map(TimeoutKey::Word)];
    let clearance = (maybe(any_number()), maybe(any_number()), maybe(any_number()));
    let horizon = (maybe(0..999_u64), maybe(0..99_u64));
    let planner = (
        maybe("[a-z]{1,9}"),
        maybe(0..99_u64),
        maybe(0..99_u64),
        maybe(any_number()),
        maybe(any_number()),
        horizon,
        clearance,
    )
        .prop_map(|(name, nodes, iterations, alpha, step_rad, (steps, blocks), clearance)| {
            let (stand_off_m, stand_off_sigma, separation_m) = clearance;
            PlannerTable {
                name,
                nodes,
                iterations,
                alpha,
                step_rad,
                steps,
                blocks,
                stand_off_m,
                stand_off_sigma,
                separation_m,
                criterion: None,
            }
        });
    let covariance = prop_oneof![
        any_number().prop_map(CovarianceKey::Scalar),
        proptest::collection::vec(any_number(), 1..9).prop_map(CovarianceKey::Diagonal),
    ];
    let mean = prop_oneof![
        "[a-z]{1,6}".prop_map(MeanKey::Word),
        proptest::collection::vec(any_number(), 0..9).prop_map(MeanKey::State),
    ];
    let prior = (maybe(mean), maybe(covariance)).prop_map(|(mean, covariance)| PriorTable { mean, covariance });
    let head =
        (maybe(".{0,30}"), maybe(0..1_000_000_u64), maybe(any_number()), maybe(0..1_000_u64), maybe("[a-z]{1,9}"));
    let rest = (
        maybe(timeout),
        maybe(target()),
        maybe(prior),
        maybe(proptest::collection::vec(robot(), 0..4)),
        maybe(planner),
    );
    (head, rest).prop_map(|((name, ticks, dt_s, seed, clock), (timeout_s, target, prior, robot, planner))| {
        ScenarioFile {
            name,
            ticks,
            dt_s,
            seed,
            clock,
            timeout_s,
            target,
            prior,
            robot,
            planner,
            ..ScenarioFile::default()
        }
    })
}

proptest! {
    #[test]
    fn a_file_survives_being_written_and_read(file in file()) {
        let text = file.to_toml().unwrap();
        prop_assert_eq!(ScenarioFile::parse(&text, "test").unwrap(), file);
    }

    /// Any file is a scenario, or gives one line that says what was expected.
    #[test]
    fn every_file_is_accepted_or_refused_in_one_line(file in file()) {
        if let Err(error) = Scenario::from_file(&file, "test") {
            let line = error.to_string();
            prop_assert!(line.contains(" in test") && line.contains("expected"), "{line}");
        }
    }

    #[test]
    fn no_text_makes_the_parser_panic(text in ".{0,200}") {
        let _ = ScenarioFile::parse(&text, "test");
    }

    #[test]
    fn a_node_reads_the_validated_scenario(file in file()) {
        if let Ok(scenario) = Scenario::from_file(&file, "test") {
            let text = serde_json::to_string(&scenario).unwrap();
            prop_assert_eq!(serde_json::from_str::<Scenario>(&text).unwrap(), scenario);
        }
    }
}

/// `paper.toml` equals the defaults, except for the planner and the clearances.
#[test]
fn the_papers_scenario_has_the_defaults_except_for_planner_and_clearance() {
    let text = include_str!("../../../scenarios/paper.toml");
    let of = |file: &ScenarioFile| Scenario::from_file(file, "test").unwrap();
    let (paper, empty) = (of(&ScenarioFile::parse(text, "paper.toml").unwrap()), of(&ScenarioFile::default()));
    assert_eq!((paper.planner.name(), paper.clearance), ("adaptive", Clearance::default()));
    assert_eq!((empty.planner.name(), empty.clearance.stand_off_sigma), ("certified", defaults::STAND_OFF_SIGMA));
    assert_eq!(Scenario { planner: empty.planner, clearance: empty.clearance, ..paper }, empty);
}
