//! Any text gets one answer, which depends on its line only.

use proptest::prelude::*;
use rangehound_shared::scenario::PLANNERS;
use serde_json::{Value, json};

use super::*;

const KEYS: [&str; 9] = [
    "certified",
    "headings_rad",
    "lower_bound",
    "lower_bound_trace_m2",
    "objective",
    "plan_us",
    "planner",
    "position_trace_m2",
    "speeds_mps",
];

fn solver() -> LineSolver {
    // A coarse grid, so that teams of several robots are served quickly.
    LineSolver::new(PlannerTable { step_rad: Some(0.3), ..PlannerTable::default() }, 1).unwrap()
}

/// The answer to a line; fails unless it is one line of one of the two kinds.
fn answered(solver: &mut LineSolver, number: u64, line: &[u8]) -> Result<Value, String> {
    let mut answer = Vec::new();
    let problem = solver.answer(number, line, &mut answer);
    let text = String::from_utf8(answer).unwrap();
    assert_eq!(text.matches('\n').count(), 1, "{text}");
    assert!(text.ends_with('\n'), "{text}");
    let value: Value = serde_json::from_str(&text).unwrap();
    let keys: Vec<&str> = value.as_object().unwrap().keys().map(String::as_str).collect();
    match problem {
        Some(problem) => {
            assert_eq!(value, json!({"line": number, "error": problem}));
            assert!(problem.contains("expected") && !problem.contains(char::is_control), "{problem:?}");
            assert!(problem.len() < 500);
            Err(problem)
        }
        None => {
            let mut sorted = keys.clone();
            sorted.sort_unstable();
            assert_eq!(sorted, KEYS);
            let numbers = ["headings_rad", "speeds_mps"].map(|key| value[key].as_array().unwrap().clone()).concat();
            assert!(numbers.iter().all(Value::is_number), "{text}");
            let number = |key: &str| value[key].as_f64().unwrap();
            assert!(0.0 <= number("lower_bound") && number("lower_bound") <= number("objective"), "{text}");
            assert!(number("position_trace_m2") > 0.0, "{text}");
            Ok(value)
        }
    }
}

fn without_time(mut answer: Value) -> Value {
    answer.as_object_mut().unwrap().remove("plan_us");
    answer
}

/// Numbers as programs write them, the bounds, and numbers beyond them.
fn odd_number() -> impl Strategy<Value = &'static str> {
    proptest::sample::select(vec![
        "0",
        "-0.0",
        "1",
        "1.0",
        "-1",
        "2",
        "15",
        "0.1",
        "1e-4",
        "1e5",
        "1e8",
        "-1e8",
        "1e12",
        "1e-9",
        "1e-13",
        "1e-160",
        "1e-320",
        "5e-324",
        "1e300",
        "1e308",
        "1e999",
        "-1e999",
        "1E2",
        "18446744073709551616",
        "null",
        "true",
        "\"1\"",
        "[]",
        "[1]",
        "[1,2]",
        "[[1,0],[0,1]]",
        "[1,2,3]",
        "{}",
        "NaN",
        "Infinity",
        "-",
        "01",
        "1.",
        "\"\\ud800\"",
        "",
    ])
}

fn odd_line() -> impl Strategy<Value = String> {
    let number = || {
        prop_oneof![8 => (-20.0..20.0_f64).prop_map(|value| value.to_string()),
                                1 => odd_number().prop_map(str::to_owned)]
    };
    let positive = || {
        prop_oneof![8 => (0.1..20.0_f64).prop_map(|value| value.to_string()),
                                  1 => odd_number().prop_map(str::to_owned)]
    };
    let robot = (number(), number(), positive(), positive())
        .prop_map(|(x, y, speed, std)| format!("{{\"position\":[{x},{y}],\"max_speed\":{speed},\"range_std\":{std}}}"));
    let clearance = (proptest::sample::select(vec!["stand_off_m", "stand_off_sigma", "separation_m"]), positive())
        .prop_map(|(key, value)| format!(",\"{key}\":{value}"));
    let planner = proptest::sample::select([&PLANNERS[..], &["luck", ""]].concat());
    (
        (positive(), positive(), number(), number(), positive()),
        proptest::collection::vec(robot, 0..4),
        proptest::collection::vec(clearance, 0..3),
        proptest::option::of(planner),
    )
        .prop_map(|((xx, yy, x, y, step), robots, clearances, planner)| {
            let planner = planner.map(|name| format!(",\"planner\":\"{name}\"")).unwrap_or_default();
            format!(
                "{{\"prior_position_covariance\":[[{xx},0.05],[0.05,{yy}]],\"target\":[{x},{y}],\
                 \"time_step_s\":{step},\"robots\":[{}]{}{planner}}}",
                robots.join(","),
                clearances.join("")
            )
        })
}

/// Changes to a text: bytes inserted, removed or doubled.
fn mutated(line: &str, changes: &[(u8, usize, usize, Vec<u8>)]) -> Vec<u8> {
    let mut bytes = line.as_bytes().to_vec();
    for (kind, from, length, put) in changes {
        let from = from % (bytes.len() + 1);
        let to = (from + length).min(bytes.len());
        match kind {
            0 => drop(bytes.splice(from..to, [])),
            1 => drop(bytes.splice(from..from, put.clone())),
            2 => drop(bytes.splice(from..to, put.clone())),
            _ => {
                let copy = bytes[from..to].to_vec();
                bytes.splice(to..to, copy);
            }
        }
    }
    bytes
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2_000))]

    #[test]
    fn any_text_has_one_answer(line in ".*", bytes in proptest::collection::vec(any::<u8>(), 0..60)) {
        prop_assert!(answered(&mut solver(), 1, line.as_bytes()).is_err());
        prop_assert!(answered(&mut solver(), 1, &bytes).is_err());
    }

    #[test]
    fn any_line_nearly_right_has_one_answer(
        line in odd_line(),
        changes in proptest::collection::vec(
            (0..4_u8, any::<usize>(), 0..12_usize, prop_oneof![
                proptest::collection::vec(any::<u8>(), 0..4), odd_number().prop_map(|text| text.as_bytes().to_vec()),
                proptest::sample::select(vec!["[", "]", "{", "}", ",", ":", "\"", "e9", "-", "\\u0000", "\u{feff}"])
                    .prop_map(|text| text.as_bytes().to_vec()),
            ]), 0..4),
    ) {
        let _ = answered(&mut solver(), 7, line.as_bytes());
        let _ = answered(&mut solver(), 7, &mutated(&line, &changes));
    }

    /// Answers do not depend on earlier lines, except for the time.
    #[test]
    fn an_answer_depends_on_its_line_alone(lines in proptest::collection::vec(odd_line(), 2..6)) {
        let mut used = solver();
        for (index, line) in lines.iter().enumerate() {
            let number = 1 + index as u64;
            let [again, fresh] =
                [&mut used, &mut solver()].map(|solver| answered(solver, number, line.as_bytes()).map(without_time));
            prop_assert_eq!(again, fresh);
        }
    }

    /// At the ends of all bounds at once, where products are largest and smallest.
    #[test]
    fn the_ends_of_all_bounds_are_answered(
        variances in (0..2_usize, 0..2_usize), step in 0..2_usize, target in (0..2_usize, 0..2_usize),
        robots in proptest::collection::vec((0..5_usize, 0..5_usize, 0..3_usize, 0..3_usize), 0..4),
        clearances in (0..3_usize, 0..3_usize, 0..3_usize),
        planner in proptest::sample::select(PLANNERS.to_vec()),
    ) {
        let [variance, coordinate] = [[1e-9, 1e12], [-1e8, 1e8]];
        let clearance = [0.0, 1.0, 1e6];
        let (xs, ys) = ([-1e8, 1e8, 0.0, 1.0, 1e-200], [-1e8, 1e8, 0.0, 1e-9, -1e-200]);
        let (speeds, stds, steps) = ([0.0, 10.0, 1e5], [1e-4, 1.0, 1e5], [1e-4, 1e4]);
        let robots: Vec<Value> = robots.iter().map(|&(x, y, speed, std)| json!({
            "position": [xs[x], ys[y]], "max_speed": (speeds[speed]), "range_std": (stds[std]),
        })).collect();
        let line = json!({
            "prior_position_covariance": [[variance[variances.0], 0.0], [0.0, variance[variances.1]]],
            "target": [coordinate[target.0], coordinate[target.1]], "time_step_s": (steps[step]),
            "robots": robots, "stand_off_m": (clearance[clearances.0]), "stand_off_sigma": (clearance[clearances.1]),
            "separation_m": (clearance[clearances.2]), "planner": planner,
        });
        let ends = variances.0 == variances.1;
        let answer = answered(&mut solver(), 1, line.to_string().as_bytes());
        // A matrix with variances of 1e-9 and 1e12 counts as singular.
        prop_assert_eq!(answer.is_ok(), ends, "{:?}", answer);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1_000))]

    /// At the ends of what sensors and uncertain poses may be: an answer whose numbers hold together, or a refusal.
    #[test]
    fn the_ends_of_all_sensors_are_answered_or_refused(
        robots in proptest::collection::vec((0..4_usize, 0..4_usize, 0..8_u32, 0..2_usize, 0..3_usize, 0..3_usize), 1..4),
        variance in 0..3_usize, step in 0..3_usize, stand_off in 0..3_usize, separation in 0..2_usize,
        criterion in proptest::sample::select(vec!["trace", "eigenvalue", "determinant"]),
        planner in proptest::sample::select(vec!["certified", "adaptive", "standard", "greedy", "pursue", "random", "horizon"]),
    ) {
        let robots: Vec<Value> = robots.iter().map(|&(x, y, kinds, end, pose, speed)| {
            let (x_m, y_m, max_speed) = ([-1e8, 1e8, 0.0, 1.0][x], [-1e8, 0.0, 1e-9, 7.0][y], [0.0, 10.0, 1e5][speed]);
            let mut robot = json!({"position": [x_m, y_m], "max_speed": max_speed});
            if kinds & 1 == 1 {
                robot["range_std"] = json!([1e-4, 1e5][end]);
                robot["range_std_per_m"] = json!([0.0, 10.0][end]);
            }
            if kinds & 1 == 0 || kinds & 2 == 2 {
                robot["bearing_std_rad"] = json!([1e-5, 3.2][end]);
                robot["heading_std_rad"] = json!([3.2, 0.0][end]);
            }
            if kinds & 4 == 4 {
                robot["max_range_m"] = json!([1e-3, 1e8][end]);
                robot["field_of_view_rad"] = json!([6.3, 1e-3][end]);
            }
            robot["position_covariance"] = json!([[[0.0, 0.0], [0.0, 0.0]], [[1e12, 0.0], [0.0, 1e12]], [[1.0, 1.0], [1.0, 1.0]]][pose]);
            robot
        }).collect();
        let prior = [1e-9, 1.0, 1e12][variance];
        let line = json!({
            "prior_position_covariance": [[prior, 0.0], [0.0, prior]], "target": [0.0, 0.0],
            "time_step_s": ([1e-4, 1.0, 1e4][step]), "robots": robots,
            "stand_off_m": ([0.0, 1.0, 1e6][stand_off]), "separation_m": ([0.0, 1.0][separation]), "planner": planner, "criterion": criterion,
        });
        let table = PlannerTable { nodes: Some(50), ..PlannerTable::default() };
        let answer = answered(&mut LineSolver::new(table, 1).unwrap(), 1, line.to_string().as_bytes());
        if let Err(problem) = answer {
            prop_assert!(problem.contains("finite"), "{problem}");
        }
    }
}

#[test]
fn no_depth_of_nesting_is_too_deep() {
    let deep = 1_000_000;
    for (open, end) in [("[", "]"), ("{\"target\":", "}"), ("{\"target\":[1,2,[", "]]}"), ("[{\"robots\":", "}]")] {
        for line in [open.repeat(deep), open.repeat(deep) + &end.repeat(deep)] {
            answered(&mut solver(), 1, line.as_bytes()).unwrap_err();
        }
    }
    let line = format!("{{\"target\":[1,2,{}{}]}}", "[".repeat(deep), "]".repeat(deep));
    answered(&mut solver(), 1, line.as_bytes()).unwrap_err();
}

/// A precise range beside a vague prior: `T - |S|` would be nothing but rounding.
#[test]
fn the_trace_keeps_its_digits_beside_very_precise_ranges() {
    let line = json!({
        "prior_position_covariance": [[1e12, 0], [0, 1e12]], "target": [0, 0], "time_step_s": 0.1,
        "robots": [{"position": [20, 0], "max_speed": 10, "range_std": 1e-4}],
    });
    let answer = answered(&mut solver(), 1, line.to_string().as_bytes()).unwrap();
    let trace = answer["position_trace_m2"].as_f64().unwrap();
    assert!((trace / 1e12 - 1.0).abs() < 1e-12, "{trace}");
}
