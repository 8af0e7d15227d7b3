//! Monte Carlo of the planners, through the command.

use serde_json::Value;

use crate::support::Run;

const PICTURES: [&str; 5] = ["trace.svg", "paths.svg", "consistency.svg", "gap.svg", "planning_time.svg"];

/// First seed and number of a series in which some runs were lost, or nearly lost, at 3 sigma.
const LOST_WITH_LESS: [(u64, u64); 2] = [(1_755, 250), (20_255, 250)];

/// The output of `compare` and its figures.
fn compare(words: &str) -> (String, Value, Run) {
    let run = Run::new();
    let mut args: Vec<&str> = words.split_whitespace().collect();
    args.splice(..0, ["compare", "--out", "out"]);
    let outcome = run.start(&args).finish().succeeded();
    let figures = serde_json::from_str(&run.read("compare.json")).unwrap();
    (outcome.stdout, figures, run)
}

fn planner<'a>(figures: &'a Value, name: &str) -> &'a Value {
    let planners = figures["planners"].as_array().unwrap();
    planners.iter().find(|planner| planner["name"] == name).unwrap()
}

/// All figures but the timings.
fn without_timings(mut figures: Value) -> Value {
    for key in ["wall_s", "planning_time"] {
        assert!(figures.as_object_mut().unwrap().remove(key).is_some(), "{key}");
    }
    for planner in figures["planners"].as_array_mut().unwrap() {
        assert!(planner.as_object_mut().unwrap().remove("planning_us").is_some());
    }
    figures
}

/// The keys of texts.
const TEXTS: [&str; 3] = [".name", ".scenario", ".gap_meaning"];

/// Fails if a value is missing, not a number, or a string where a number should be.
fn assert_numbers(value: &Value, path: &str) {
    match value {
        Value::Object(entries) => {
            entries.iter().for_each(|(key, value)| assert_numbers(value, &format!("{path}.{key}")))
        }
        Value::Array(values) => values.iter().for_each(|value| assert_numbers(value, path)),
        Value::String(_) => assert!(TEXTS.iter().any(|key| path.ends_with(key)), "{path}"),
        other => assert!(other.is_number(), "{path}: {other}"),
    }
}

#[test]
fn a_comparison_leaves_figures_pictures_and_a_table() {
    let (table, figures, run) = compare("--runs 8 --ticks 40 --seed 3 --stand-off 2");
    assert_numbers(&figures, "");
    for (key, value) in [("seed", 3), ("runs", 8), ("ticks", 40), ("robots", 3)] {
        assert_eq!(figures[key], value, "{key}");
    }
    assert_eq!(figures["stand_off_m"], 2.0);
    let names: Vec<&str> =
        figures["planners"].as_array().unwrap().iter().map(|planner| planner["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["certified", "adaptive", "standard", "greedy", "pursue", "random"]);
    for planner in figures["planners"].as_array().unwrap() {
        for key in [
            "/position_trace_m2/final",
            "/position_trace_m2/mean",
            "/max_eigenvalue_m2/final",
            "/position_rmse_m/all",
            "/position_rmse_m/median",
            "/position_rmse_m/p95",
            "/anees",
            "/nis_per_dof",
            "/divergence/rate",
            "/divergence/interval/high",
            "/planning_us/p99",
            "/gap/max",
            "/trace_excess_percent/p99",
        ] {
            assert!(planner.pointer(key).is_some(), "{key}");
        }
        for series in ["/trace_m2/p10", "/trace_m2/median", "/trace_m2/p90", "/anees", "/rmse_m"] {
            assert_eq!(planner["series"].pointer(series).unwrap().as_array().unwrap().len(), 40, "{series}");
        }
        assert!(table.contains(planner["name"].as_str().unwrap()));
    }
    for scaling in figures["planning_time"].as_array().unwrap() {
        let exponent = scaling["law"]["exponent"].as_f64().unwrap();
        assert!(exponent.is_finite(), "{scaling}");
    }
    assert!(table.lines().all(|line| line.chars().count() <= 100), "{table}");
    for picture in PICTURES {
        let svg = run.read(picture);
        assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>") && !svg.contains("NaN"), "{picture}");
    }
}

/// Common random numbers: only the planners' headings differ, and better headings make the estimate
/// more accurate.
#[test]
fn better_planners_know_the_target_better() {
    let (_, figures, _) = compare("--runs 20 --ticks 60 --planners certified,adaptive,random");
    let trace_m2 = |name| planner(&figures, name)["position_trace_m2"]["mean"].as_f64().unwrap();
    assert!(trace_m2("certified") <= 1.01 * trace_m2("adaptive"));
    assert!(trace_m2("random") > 3.0 * trace_m2("adaptive"));
    let certified = planner(&figures, "certified");
    assert!(certified["gap"]["max"].as_f64().unwrap() <= 1e-9);
    assert_eq!(certified["uncertified"], 0.0);
    assert!(planner(&figures, "random")["gap"]["p50"].as_f64().unwrap() > 1e-6);
}

#[test]
fn figures_do_not_depend_on_the_number_of_threads() {
    let of = |threads: u64| {
        let (_, figures, _) = compare(&format!("--runs 9 --ticks 40 --planners adaptive,random --threads {threads}"));
        without_timings(figures)
    };
    assert_eq!(of(1), of(2));
}

/// Each run equals the one of `run` with its seed, whichever planners are compared.
#[test]
fn a_run_of_a_comparison_is_a_run() {
    let run = Run::new();
    run.lockstep("--in-process --ticks 30 --seed 11 --planner adaptive").finish().succeeded();
    let (_, figures, _) = compare("--runs 1 --ticks 30 --seed 11 --planners random,adaptive");
    let (alone, compared) = (run.report(), planner(&figures, "adaptive"));
    let near = |a: &Value, b: &Value| (a.as_f64().unwrap() - b.as_f64().unwrap()).abs() < 1e-12;
    assert!(near(&alone["position_rmse_m"], &compared["position_rmse_m"]["all"]));
    assert!(near(&alone["position_trace_m2"]["final"], &compared["position_trace_m2"]["final"]));
    assert!(near(&alone["anees"], &compared["anees"]));
    assert!(near(&alone["nis_mean"], &compared["nis_per_dof"]));
}

#[test]
fn scenario_flags_and_grid_reach_the_comparison() {
    let run = Run::new();
    run.write("mine.toml", "name = \"mine\"\nseed = 4\n[planner]\nstep_rad = 0.1\nstand_off_m = 7.0\n");
    let args = ["compare", "--scenario", "mine.toml", "--planners", "grid", "--robots", "2", "--runs", "2"];
    run.start(&[&args[..], &["--ticks", "5", "--stand-off", "0", "--out", "out"]].concat()).finish().succeeded();
    let figures: Value = serde_json::from_str(&run.read("compare.json")).unwrap();
    assert_eq!(figures["scenario"], "mine");
    assert_eq!(figures["seed"], 4);
    assert_eq!(figures["robots"], 2);
    assert_eq!(figures["stand_off_m"], 0.0);
    assert_eq!(figures["planners"][0]["name"], "grid");
}

/// The default stand-off, over the seeds at which a smaller one lost runs: one such run in thousands
/// dominates the errors of all.
#[test]
fn the_default_stand_off_loses_no_run() {
    let run = Run::new();
    run.write("x.toml", "name = \"x\"\n");
    for (seed, runs) in LOST_WITH_LESS {
        let (seed, runs) = (seed.to_string(), runs.to_string());
        let args = ["compare", "x.toml", "--planners", "certified", "--runs", &runs, "--seed", &seed, "--out", "out"];
        run.start(&args).finish().succeeded();
        let figures: Value = serde_json::from_str(&run.read("compare.json")).unwrap();
        let certified = planner(&figures, "certified");
        assert_eq!(certified["divergence"]["runs"], 0, "{seed}");
        let (rms_m, anees) = (&certified["position_rmse_m"]["all"], &certified["anees"]);
        assert!(rms_m.as_f64().unwrap() < 1.0 && (0.9..1.1).contains(&anees.as_f64().unwrap()), "{rms_m} {anees}");
    }
}

/// The scenario's own mix beside teams that are alike: what varies has its figures, and what is left out does not vary.
#[test]
fn the_mix_of_a_scenario_is_compared_with_teams_that_are_alike() {
    let mixed = format!("{}/scenarios/mixed_sensors.toml", env!("CARGO_MANIFEST_DIR"));
    let of = |flags: &str| compare(&format!("{mixed} --runs 4 --ticks 60 --seed 3 {flags}")).1;
    let traces = |figures: &Value, names: &[&str]| -> Vec<f64> {
        names.iter().map(|name| planner(figures, name)["position_trace_m2"]["mean"].as_f64().unwrap()).collect()
    };
    let plain = traces(&of("--planners certified"), &["certified"]);
    let sensors = traces(&of("--sensors own,both"), &["own", "both"]);
    assert!(sensors[0] == plain[0] && sensors[1] != plain[0], "{plain:?} {sensors:?}");
    let localisers = traces(&of("--localisers exact,own,gps,odometry"), &["exact", "own", "gps", "odometry"]);
    assert_eq!(localisers[1], plain[0]);
    assert!(localisers[0] < localisers[1] && localisers[0] < localisers[2], "{localisers:?}");
    for (flag, expected) in [("--localisers radar", "exact, own"), ("--sensors own,own", "own twice")] {
        let refused =
            Run::new().start(&[&["compare", &mixed], &flag.split(' ').collect::<Vec<_>>()[..]].concat()).finish();
        assert!(refused.code == Some(2) && refused.stderr.contains(expected), "{refused:#?}");
    }
}
