//! `plan`: problems in, answers out, checked against the paper's results by independent methods.

use std::f64::consts::{SQRT_2, TAU};
use std::io::{BufRead, BufReader, Write};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc;
use std::time::Duration;

use nalgebra::{Matrix2, Vector2};
use rangehound_shared::draws::{Draws, Stream};
use serde_json::{Value, json};

use crate::support::{Outcome, Run};

const LINE: &str = r#"{"prior_position_covariance":[[4,0.5],[0.5,2]],"target":[0,0],"time_step_s":0.1,"robots":[{"position":[20,0],"max_speed":10.0,"range_std":1.0},{"position":[0,15],"max_speed":10,"range_std":1}]}"#;

const PLANNERS: [&str; 8] = ["certified", "adaptive", "standard", "grid", "greedy", "pursue", "random", "horizon"];

/// `plan` on a file of these lines.
fn planned(lines: &[impl ToString], flags: &str) -> Outcome {
    let run = Run::new();
    let lines: Vec<String> = lines.iter().map(ToString::to_string).collect();
    run.write("steps.jsonl", lines.join("\n") + "\n");
    let mut args = vec!["plan", "steps.jsonl"];
    args.extend(flags.split_whitespace());
    run.start(&args).finish()
}

/// The answers, all of which must exist.
fn answers(lines: &[impl ToString], flags: &str) -> Vec<Value> {
    let outcome = planned(lines, flags).succeeded();
    assert_eq!(outcome.stderr, "");
    let answers: Vec<Value> = outcome.stdout.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(answers.len(), lines.len());
    answers
}

fn robot(x: f64, y: f64, max_speed: f64, range_std: f64) -> Value {
    json!({"position": [x, y], "max_speed": max_speed, "range_std": range_std})
}

fn step(covariance: [[f64; 2]; 2], target: [f64; 2], robots: &[Value]) -> Value {
    json!({"prior_position_covariance": covariance, "target": target, "time_step_s": 0.1, "robots": robots})
}

fn number(value: &Value, key: &str) -> f64 {
    value[key].as_f64().unwrap_or_else(|| panic!("{key}: {value}"))
}

fn pair(value: &Value) -> Vector2<f64> {
    Vector2::new(value[0].as_f64().unwrap(), value[1].as_f64().unwrap())
}

/// `|S|` and the trace of (13) for a team with these final positions, straight from the matrices.
fn worth(problem: &Value, ends: &[Vector2<f64>]) -> (f64, f64) {
    let p = &problem["prior_position_covariance"];
    let prior = Matrix2::from_rows(&[pair(&p[0]).transpose(), pair(&p[1]).transpose()]);
    let target = pair(&problem["target"]);
    let mut information = prior.try_inverse().unwrap();
    for (robot, end) in problem["robots"].as_array().unwrap().iter().zip(ends) {
        let e = (target - end).normalize();
        information += e * e.transpose() / number(robot, "range_std").powi(2);
    }
    // The eigenvalues of the posterior's inverse are (T -+ |S|) / 2.
    let eigenvalues = information.symmetric_eigenvalues();
    (eigenvalues.max() - eigenvalues.min(), information.try_inverse().unwrap().trace())
}

/// Final position of robot `i` of a problem at this heading and speed.
fn end(problem: &Value, i: usize, heading_rad: f64, speed_mps: f64) -> Vector2<f64> {
    let way = speed_mps * number(problem, "time_step_s");
    pair(&problem["robots"][i]["position"]) + Vector2::new(heading_rad.cos(), heading_rad.sin()) * way
}

fn ends(problem: &Value, answer: &Value) -> Vec<Vector2<f64>> {
    let of = |key: &str, i: usize| answer[key][i].as_f64().unwrap();
    let robots = problem["robots"].as_array().unwrap().len();
    assert_eq!(
        [&answer["headings_rad"], &answer["speeds_mps"]].map(|list| list.as_array().unwrap().len()),
        [robots; 2]
    );
    (0..robots).map(|i| end(problem, i, of("headings_rad", i), of("speeds_mps", i))).collect()
}

/// Problems of all kinds of geometry with up to `robots_max` robots.
fn many(count: u64, robots_max: usize, seed: u64) -> Vec<Value> {
    let mut draws = Draws::new(seed, Stream::PriorMean);
    (0..count)
        .map(|tick| {
            let mut u = [0.0; 40];
            draws.uniform(tick, &mut u);
            let (xx, yy) = (0.1 + 20.0 * u[0], 0.1 + 20.0 * u[1]);
            let xy = (1.8 * u[2] - 0.9) * (xx * yy).sqrt();
            let count = 1 + (u[3] * robots_max as f64) as usize;
            let robots: Vec<Value> = u[6..][..4 * count]
                .chunks(4)
                .map(|r| robot(40.0 * r[0] - 20.0, 40.0 * r[1] - 20.0, 80.0 * r[2], 0.1 + 3.0 * r[3]))
                .collect();
            step([[xx, xy], [xy, yy]], [10.0 * u[4], 10.0 * u[5]], &robots)
        })
        .collect()
}

#[test]
fn the_answer_has_the_keys_of_the_contract() {
    for planner in PLANNERS {
        let answer = &answers(&[LINE], &format!("--planner {planner}"))[0];
        let keys: Vec<&str> = answer.as_object().unwrap().keys().map(String::as_str).collect();
        let mut expected = [
            "planner",
            "headings_rad",
            "speeds_mps",
            "objective",
            "lower_bound",
            "certified",
            "position_trace_m2",
            "lower_bound_trace_m2",
            "plan_us",
        ];
        expected.sort_unstable();
        let mut sorted = keys.clone();
        sorted.sort_unstable();
        assert_eq!(sorted, expected);
        assert_eq!(answer["planner"], planner);
        assert!(answer["certified"].is_boolean());
        assert!(number(answer, "plan_us") > 0.0);
        assert_eq!(answer["headings_rad"].as_array().unwrap().len(), 2);
        assert!(number(answer, "lower_bound") <= number(answer, "objective"));
    }
}

/// Rayleigh's case: the best of many headings is no better, and almost as good.
#[test]
fn one_robot_does_as_well_as_any_heading() {
    let problems: Vec<Value> =
        many(40, 1, 1).into_iter().filter(|p| number(&p["robots"][0], "max_speed") > 1.0).collect();
    for (problem, answer) in problems.iter().zip(answers(&problems, "")) {
        let speed = number(&problem["robots"][0], "max_speed");
        let tried = (0..20_000).map(|k| worth(problem, &[end(problem, 0, TAU * f64::from(k) / 20_000.0, speed)]).0);
        let best = tried.fold(f64::INFINITY, f64::min);
        let objective = number(&answer, "objective");
        assert!(objective <= best * (1.0 + 1e-9) + 1e-9, "{objective} {best} {problem}");
        let lambda = number(&problem["robots"][0], "range_std").powi(-2);
        assert!(best - objective <= 1e-2 * lambda, "{objective} {best} {problem}");
        assert_eq!(answer["certified"], true);
    }
}

#[test]
fn two_robots_do_as_well_as_any_two_headings() {
    let problems = [
        step([[4.0, 0.5], [0.5, 2.0]], [0.0, 0.0], &[robot(9.0, 1.0, 60.0, 1.0), robot(0.0, 8.0, 50.0, 2.0)]),
        step([[1.0, -0.3], [-0.3, 0.5]], [3.0, -2.0], &[robot(-4.0, 1.0, 30.0, 0.8), robot(-5.0, 2.0, 40.0, 0.9)]),
        step([[2.0, 0.0], [0.0, 2.0]], [1.0, 1.0], &[robot(7.0, 1.0, 20.0, 1.0), robot(8.0, 2.0, 20.0, 0.5)]),
    ];
    for (problem, answer) in problems.iter().zip(answers(&problems, "")) {
        // Eq. 25 from the positions that the headings lead to.
        let steps = 1_500;
        let vectors = [0, 1].map(|i| {
            let robot = &problem["robots"][i];
            let lambda = number(robot, "range_std").powi(-2);
            (0..steps)
                .map(|k| {
                    let heading = TAU * f64::from(k) / f64::from(steps);
                    let sight = pair(&problem["target"]) - end(problem, i, heading, number(robot, "max_speed"));
                    let theta = 2.0 * sight.y.atan2(sight.x);
                    Vector2::new(theta.cos(), theta.sin()) * lambda
                })
                .collect::<Vec<_>>()
        });
        let p = &problem["prior_position_covariance"];
        let inverse = Matrix2::from_rows(&[pair(&p[0]).transpose(), pair(&p[1]).transpose()]).try_inverse().unwrap();
        let prior = Vector2::new(inverse[(0, 0)] - inverse[(1, 1)], 2.0 * inverse[(0, 1)]);
        let lengths = vectors[0].iter().flat_map(|a| vectors[1].iter().map(move |b| (prior + a + b).norm()));
        let best = lengths.fold(f64::INFINITY, f64::min);
        let objective = number(&answer, "objective");
        assert!(objective <= best + 1e-12, "{objective} {best}");
        assert!(best - objective < 0.02, "{objective} {best}");
        assert_eq!(answer["certified"], true);
    }
}

/// The paper's lambda = (sqrt 2; 1, 1) with two robots that can reach any bearing.
#[test]
fn the_worked_example_reaches_zero() {
    let prior = [[1.0 / (1.0 + SQRT_2), 0.0], [0.0, 1.0]];
    let problem = step(prior, [2.0, 3.0], &[robot(2.5, 3.0, 10.0, 1.0), robot(2.0, 3.4, 10.0, 1.0)]);
    let answer = &answers(std::slice::from_ref(&problem), "")[0];
    assert!(number(answer, "objective") < 1e-12, "{answer}");
    assert_eq!(answer["certified"], true);
    let trace = 4.0 / (4.0 + SQRT_2);
    assert!((number(answer, "position_trace_m2") / trace - 1.0).abs() < 1e-12, "{answer}");
    assert!((worth(&problem, &ends(&problem, answer)).1 / trace - 1.0).abs() < 1e-9, "{answer}");
}

#[test]
fn no_robots_leave_the_prior() {
    for planner in PLANNERS {
        let problem = step([[4.0, 0.5], [0.5, 2.0]], [0.0, 0.0], &[]);
        let answer = &answers(&[problem], &format!("--planner {planner}"))[0];
        assert_eq!(answer["headings_rad"], json!([]));
        assert!((number(answer, "position_trace_m2") - 6.0).abs() < 1e-12, "{answer}");
        assert_eq!(answer["certified"], true, "{answer}");
    }
}

#[test]
fn headings_lead_to_what_is_claimed() {
    let problems = many(200, 3, 2);
    for planner in PLANNERS {
        let flags = format!("--planner {planner} --step-rad 0.1");
        for (problem, answer) in problems.iter().zip(answers(&problems, &flags)) {
            let (objective, trace) = worth(problem, &ends(problem, &answer));
            let claimed = number(&answer, "position_trace_m2");
            assert!((claimed / trace - 1.0).abs() < 1e-9, "{planner}: {claimed} {trace} {problem}");
            // The eigenvalues of `worth` are themselves rounded, and their difference more so.
            let lambda_sum = 1e3;
            assert!((number(&answer, "objective") - objective).abs() < 1e-9 * lambda_sum, "{planner}: {problem}");
            for (robot, speed) in
                problem["robots"].as_array().unwrap().iter().zip(answer["speeds_mps"].as_array().unwrap())
            {
                assert!(speed.as_f64().unwrap() <= number(robot, "max_speed") * (1.0 + 1e-12));
            }
        }
    }
}

#[test]
fn no_bound_is_above_what_another_planner_reaches() {
    let problems = many(100, 4, 3);
    let all: Vec<Vec<Value>> =
        PLANNERS.iter().map(|name| answers(&problems, &format!("--planner {name} --step-rad 0.3"))).collect();
    for (k, problem) in problems.iter().enumerate() {
        let least = all.iter().map(|of| number(&of[k], "objective")).fold(f64::INFINITY, f64::min);
        for of in &all {
            assert!(number(&of[k], "lower_bound") <= least + 1e-9, "{} {problem}", of[k]);
            if of[k]["certified"] == true {
                assert!(number(&of[k], "objective") <= least + 1e-6, "{} {problem}", of[k]);
            }
        }
        assert_eq!(all[0][k]["certified"], true, "{problem}");
    }
}

#[test]
fn stand_off_and_separation_hold_at_the_end_of_the_step() {
    let mut problems = many(150, 4, 4);
    let apart_m = 1.0;
    for (k, problem) in problems.iter_mut().enumerate() {
        match k % 3 {
            0 => problem["stand_off_m"] = json!(2.5),
            1 => problem["stand_off_sigma"] = json!(0.8),
            _ => problem["separation_m"] = json!(apart_m),
        }
    }
    for planner in PLANNERS {
        for (problem, answer) in problems.iter().zip(answers(&problems, &format!("--planner {planner} --step-rad 0.3")))
        {
            let p = &problem["prior_position_covariance"];
            let sigma = (p[0][0].as_f64().unwrap() + p[1][1].as_f64().unwrap()).sqrt();
            let least = problem["stand_off_m"].as_f64().unwrap_or(0.0);
            let least = least.max(problem["stand_off_sigma"].as_f64().unwrap_or(0.0) * sigma);
            let ends = ends(problem, &answer);
            for (i, end) in ends.iter().enumerate() {
                let (robot, target) = (&problem["robots"][i], pair(&problem["target"]));
                let step_m = 0.1 * number(robot, "max_speed");
                // A robot inside the stand-off can only move out as far as it reaches.
                let least = least.min((pair(&robot["position"]) - target).norm() + step_m);
                assert!((end - target).norm() >= least - 1e-9, "{planner}: {problem} {answer}");
            }
            let starts: Vec<Vector2<f64>> = (0..ends.len()).map(|i| end(problem, i, 0.0, 0.0)).collect();
            for (i, j) in (0..ends.len()).flat_map(|i| (0..i).map(move |j| (i, j))) {
                let were_apart =
                    |k: usize| (0..ends.len()).all(|other| other == k || (starts[k] - starts[other]).norm() >= apart_m);
                if !problem["separation_m"].is_null() && were_apart(i) && were_apart(j) {
                    assert!((ends[i] - ends[j]).norm() >= apart_m - 1e-9, "{planner}: {problem} {answer}");
                }
            }
        }
    }
}

/// A range known to 0.1 mm beside two known to 20 and 57 km: in `|S|` they differ by less than rounding.
#[test]
fn a_certificate_holds_for_the_trace_of_very_different_robots() {
    let team = [robot(6.95, 5.35, 24.3, 1e-4), robot(-21.7, 41.8, 23.6, 20_000.0), robot(50.9, -25.0, 15.3, 57_000.0)];
    let problem = step([[1.6e7, -7e6], [-7e6, 1.56e7]], [6.24, 4.21], &team);
    let of = |planner: &str| answers(std::slice::from_ref(&problem), &format!("--planner {planner}"))[0].clone();
    let certified = of("certified");
    assert_eq!(certified["certified"], true, "{certified}");
    for other in ["adaptive", "standard", "grid", "greedy"] {
        let (ours, theirs) = (number(&certified, "position_trace_m2"), number(&of(other), "position_trace_m2"));
        assert!(ours <= theirs * (1.0 + 1e-9), "{other}: {ours} {theirs}");
        assert!(of(other)["certified"] == false || theirs <= ours * (1.0 + 1e-6), "{other}: {ours} {theirs}");
    }
}

/// Within a step of the target, with a stand-off so small that it was only partly applied before.
#[test]
fn a_tiny_stand_off_claims_what_its_motion_leads_to() {
    let team = [robot(0.3, 0.2, 10.0, 1.0), robot(-0.4, 0.1, 10.0, 1.0), robot(0.1, -0.5, 10.0, 1.0)];
    let problem = step([[4.0, 0.5], [0.5, 2.0]], [0.0, 0.0], &team);
    for stand_off_m in [0.0, 1e-300, 1e-15, 1e-12, 1e-9, 1e-6] {
        let mut problem = problem.clone();
        problem["stand_off_m"] = json!(stand_off_m);
        let answer = &answers(std::slice::from_ref(&problem), "")[0];
        let trace = worth(&problem, &ends(&problem, answer)).1;
        assert!((number(answer, "position_trace_m2") / trace - 1.0).abs() < 1e-9, "{stand_off_m}: {trace} {answer}");
    }
}

/// A nearly singular covariance: the products of its entries cancel to five digits.
#[test]
fn the_trace_keeps_its_digits_beside_a_flat_covariance() {
    // By rotation of diag(1, 1e-12), in entries that doubles have exactly: P = [[a, a - d], [a - d, a]], |P| = d (2 a - d).
    let (a, d) = (0.5, 2.0_f64.powi(-40));
    let problem = step([[a, a - d], [a - d, a]], [0.0, 0.0], &[robot(20.0, 0.0, 0.0, 1.0)]);
    let answer = &answers(std::slice::from_ref(&problem), "")[0];
    // Woodbury: P - P e e^T P / (1 + e^T P e), e = (1, 0).
    let trace = 2.0 * a - (a * a + (a - d) * (a - d)) / (1.0 + a);
    assert!((number(answer, "position_trace_m2") / trace - 1.0).abs() < 1e-9, "{trace} {answer}");
}

#[test]
fn without_the_key_there_is_no_stand_off() {
    let problem = step([[4.0, 0.5], [0.5, 2.0]], [0.0, 0.0], &[robot(3.0, 0.0, 20.0, 1.0)]);
    let pursuit = &answers(std::slice::from_ref(&problem), "--planner pursue")[0];
    assert!((ends(&problem, pursuit)[0].norm() - 1.0).abs() < 1e-12, "{pursuit}");
}

#[test]
fn a_line_may_name_its_planner_and_flags_set_the_rest() {
    let of = |name: &str| LINE.replacen('{', &format!("{{\"planner\":\"{name}\","), 1);
    let lines: Vec<String> = PLANNERS.iter().map(|name| of(name)).collect();
    let flags = "--planner greedy --nodes 10 --iterations 3 --alpha 0.1 --step-rad 0.2 --seed 9";
    for (answer, name) in answers(&lines, flags).iter().zip(PLANNERS) {
        assert_eq!(answer["planner"], name);
    }
    assert_eq!(answers(&[LINE], flags)[0]["planner"], "greedy");
    assert_eq!(answers(&[LINE], "")[0]["planner"], "certified");

    // Random headings follow from seed and line number.
    let headings = |lines: &[String], seed: u64| -> Vec<Value> {
        answers(lines, &format!("--seed {seed}")).iter().map(|answer| answer["headings_rad"].clone()).collect()
    };
    let random = [of("random"), of("random")];
    let (first, again, other) = (headings(&random, 1), headings(&random, 1), headings(&random, 2));
    assert_eq!(first, again);
    assert_ne!(first[0], first[1]);
    assert_ne!(first[0], other[0]);
}

/// A good line in which `old` is replaced by `new`.
fn but(old: &str, new: &str) -> String {
    assert!(LINE.contains(old), "{old}");
    LINE.replacen(old, new, 1)
}

#[test]
fn a_bad_line_is_reported_by_number_and_key_and_the_others_are_answered() {
    let covariance = |matrix: &str| (but("[[4,0.5],[0.5,2]]", matrix), "prior_position_covariance");
    let target = |place: &str| (but("[0,0]", place), "target");
    let with = |keys: &str, names| (but("{", &format!("{{{keys},")), names);
    let cases = [
        ("no JSON".to_owned(), "JSON"),
        ("{".to_owned(), "JSON"),
        (LINE[..LINE.len() - 1].to_owned(), "JSON"),
        (format!("{LINE}{LINE}"), "JSON"),
        ("[]".to_owned(), "object"),
        ("null".to_owned(), "object"),
        ("{}".to_owned(), "prior_position_covariance"),
        (r#"[[[4,0.5],[0.5,2]],[0,0],0.1,[]]"#.to_owned(), "object"),
        covariance("[[4,0.5],[0.4,2]]"),
        covariance("[[4,0.5],[0.5000001,2]]"),
        covariance("[[4,3],[3,2]]"),
        covariance("[[1,1],[1,1]]"),
        covariance("[[0,0],[0,0]]"),
        covariance("[[-4,0.5],[0.5,2]]"),
        covariance("[[4,0.5]]"),
        covariance("[[4,0.5],[0.5,2],[0,0]]"),
        covariance("[[4,0.5,0],[0.5,2,0]]"),
        covariance("[[4,0.5],[0.5,null]]"),
        covariance("[[4,0.5],[0.5,1e999]]"),
        covariance("[[1e300,0],[0,1e300]]"),
        covariance("4"),
        target("[0]"),
        target("[0,0,0]"),
        target("[\"0\",0]"),
        target("[1e999,0]"),
        target("[-1e300,0]"),
        target("{\"x\":0,\"y\":0}"),
        target("[NaN,0]"),
        (but("\"target\":[0,0],", ""), "target"),
        (but("\"target\"", "\"targets\""), "targets"),
        (but("\"time_step_s\":0.1", "\"time_step_s\":0"), "time_step_s"),
        (but("\"time_step_s\":0.1", "\"time_step_s\":-0.1"), "time_step_s"),
        (but("\"time_step_s\":0.1", "\"time_step_s\":1e300"), "time_step_s"),
        (but("\"time_step_s\":0.1", "\"time_step_s\":true"), "time_step_s"),
        (but("\"max_speed\":10.0", "\"max_speed\":-1"), "robots[0].max_speed"),
        (but("\"max_speed\":10.0", "\"max_speed\":\"fast\""), "robots[0].max_speed"),
        (but("\"max_speed\":10.0,", ""), "robots[0].max_speed"),
        (but("\"range_std\":1}", "\"range_std\":0}"), "robots[1].range_std"),
        (but("\"range_std\":1}", "\"range_std\":-1}"), "robots[1].range_std"),
        (but("\"range_std\":1}", "\"range_std\":1e-300}"), "robots[1].range_std"),
        (but("\"range_std\":1}", "\"range_std\":1,\"colour\":2}"), "robots[1].colour"),
        (but("[0,15]", "[0]"), "robots[1].position"),
        (but("{\"position\":[20,0],\"max_speed\":10.0,\"range_std\":1.0}", "[[20,0],10,1]"), "robots[0]"),
        (but("\"range_std\":1}", "\"bearing_std_rad\":0}"), "robots[1].bearing_std_rad"),
        (but("\"range_std\":1}", "\"range_std_per_m\":0.1,\"bearing_std_rad\":0.1}"), "robots[1].range_std_per_m"),
        (but("\"range_std\":1}", "\"range_std\":1,\"max_range_m\":0}"), "robots[1].max_range_m"),
        (but("\"range_std\":1}", "\"range_std\":1,\"field_of_view_rad\":7}"), "robots[1].field_of_view_rad"),
        (but("\"range_std\":1}", "\"range_std\":1,\"heading_std_rad\":-1}"), "robots[1].heading_std_rad"),
        (
            but("\"range_std\":1}", "\"range_std\":1,\"position_covariance\":[[1,2],[2,1]]}"),
            "robots[1].position_covariance",
        ),
        (
            but("\"range_std\":1}", "\"range_std\":1,\"position_covariance\":[[1,2],[0,1]]}"),
            "robots[1].position_covariance",
        ),
        with("\"criterion\":\"size\"", "criterion"),
        with("\"planner\":\"luck\"", "planner"),
        with("\"planner\":7", "planner"),
        with("\"stand_off_m\":-1", "stand_off_m"),
        with("\"stand_off_m\":null", "stand_off_m"),
        with("\"stand_off_sigma\":1e300", "stand_off_sigma"),
        with("\"separation_m\":\"1\"", "separation_m"),
        with("\"time_step_s\":0.2", "time_step_s"),
        with("\"nodes\":5", "nodes"),
    ];
    let mut lines = vec![LINE.to_owned()];
    for (bad, _) in &cases {
        lines.extend([bad.clone(), LINE.to_owned()]);
    }
    let outcome = planned(&lines, "");
    assert_eq!(outcome.code, Some(2), "{}", outcome.stderr);
    let answers: Vec<Value> = outcome.stdout.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(answers.len(), lines.len());
    assert!(answers.iter().step_by(2).all(|answer| answer["certified"] == true));
    let complaints: Vec<&str> = outcome.stderr.lines().collect();
    assert_eq!(complaints.len(), cases.len(), "{}", outcome.stderr);
    for (k, (bad, names)) in cases.iter().enumerate() {
        let (number, answer) = (2 * k + 2, &answers[2 * k + 1]);
        assert_eq!(answer["line"], number, "{bad}");
        let error = answer["error"].as_str().unwrap();
        assert!(error.contains(names) && error.contains("expected"), "{bad}: {error}");
        assert_eq!(answer.as_object().unwrap().len(), 2);
        assert!(!error.starts_with('?') && !error.contains(".?"), "{bad}: {error}");
        let (wrong, expected) = error.split_once(": ").unwrap();
        assert_eq!(complaints[k], format!("rangehound: {wrong} in steps.jsonl, line {number}: {expected}"));
    }
}

/// One camera and a round prior: straight ahead is as good as any way and nearest, so the answer has a closed form. A range
/// beside it and an uncertain position do too.
#[test]
fn a_camera_that_goes_straight_to_the_target_has_the_information_of_where_it_gets() {
    let line = |robot: &str| {
        format!(
            "{{\"prior_position_covariance\":[[4,0],[0,4]],\"target\":[0,0],\"time_step_s\":1,\"stand_off_m\":2,\"robots\":[{{\"position\":[20,0],\"max_speed\":5,{robot}}}]}}"
        )
    };
    let across = |variance_m2: f64| 1.0 / (0.25 + 1.0 / variance_m2);
    let (camera, turned) = (0.05_f64 * 15.0, 0.05_f64.hypot(0.1) * 15.0);
    let cases = [
        ("\"bearing_std_rad\":0.05", 4.0 + across(camera * camera)),
        ("\"bearing_std_rad\":0.05,\"range_std\":0.5", across(0.25) + across(camera * camera)),
        ("\"bearing_std_rad\":0.05,\"heading_std_rad\":0.1", 4.0 + across(turned * turned)),
        ("\"bearing_std_rad\":0.05,\"position_covariance\":[[1,0],[0,1]]", 4.0 + across(camera * camera + 1.0)),
        ("\"range_std\":0.5,\"range_std_per_m\":0.1", 4.0 + across(4.0)),
        ("\"bearing_std_rad\":0.05,\"max_range_m\":10", 8.0),
    ];
    let lines: Vec<String> = cases.iter().map(|(robot, _)| line(robot)).collect();
    let lines: Vec<&str> = lines.iter().map(String::as_str).collect();
    for planner in ["certified", "adaptive", "greedy", "pursue"] {
        for (answer, (robot, trace_m2)) in answers(&lines, &format!("--planner {planner}")).iter().zip(&cases) {
            let found_m2 = number(answer, "position_trace_m2");
            assert!((found_m2 / trace_m2 - 1.0).abs() < 1e-6, "{planner} {robot}: {found_m2} for {trace_m2}");
            assert!(number(answer, "lower_bound_trace_m2") <= trace_m2 * (1.0 + 1e-9), "{planner} {robot}");
            assert!(planner != "certified" || answer["certified"] == true, "{robot}");
        }
    }
}

/// The error names what was typed: the line's key, or the flag for lines that name no planner.
#[test]
fn the_grid_search_is_refused_for_a_camera() {
    let line = but("\"range_std\":1}", "\"bearing_std_rad\":0.1}");
    let named = line.replacen('{', "{\"planner\":\"grid\",", 1);
    for (line, flags, key) in [(&named, "", "planner"), (&line, "--planner grid", "--planner")] {
        let outcome = planned(&[line], flags);
        assert_eq!(outcome.code, Some(2), "{outcome:#?}");
        let expected = format!("{key} is grid in steps.jsonl, line 1: expected another planner, such as certified");
        assert!(outcome.stderr.contains(&expected), "{}", outcome.stderr);
    }
}

#[test]
fn overlong_nested_and_invalid_lines_are_refused() {
    let run = Run::new();
    let lines: [&[u8]; 9] = [
        b"\xff\xfe\x00",
        &LINE.replacen("\"target\"", "\"t\u{0}rget\"", 1).into_bytes(),
        &b"x".repeat(40 << 20),
        b"   ",
        LINE.as_bytes(),
        &b"[".repeat(10_000_000),
        &[&b"{\"target\":"[..], &b"[".repeat(1_000_000)].concat(),
        &[&b"{\"planner\":\""[..], &b"p".repeat(10_000_000), b"\"}"].concat(),
        LINE.as_bytes(),
    ];
    run.write("odd.jsonl", lines.join(&b'\n'));
    let outcome = run.start(&["plan", "odd.jsonl"]).finish();
    assert_eq!(outcome.code, Some(2));
    let answers: Vec<Value> = outcome.stdout.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let refused: Vec<Option<u64>> = answers.iter().map(|answer| answer["line"].as_u64()).collect();
    assert_eq!(refused, [Some(1), Some(2), Some(3), None, Some(6), Some(7), Some(8), None]);
    assert!(outcome.stderr.lines().all(|line| line.len() < 1_500) && outcome.stderr.lines().count() == 6);
}

#[test]
fn teams_may_be_large_but_for_separation_and_grid() {
    let team = |count: usize| -> Vec<Value> {
        (0..count).map(|k| robot((k % 100) as f64 * 3.1, (k / 100) as f64 * 5.3, 10.0, 1.0)).collect()
    };
    let problem = |count: usize| step([[4.0, 0.5], [0.5, 2.0]], [70.0, 30.0], &team(count));
    let with = |mut problem: Value, key: &str, value: Value| {
        problem[key] = value;
        problem
    };
    let large = problem(10_000);
    let answer = &answers(std::slice::from_ref(&large), "")[0];
    let claimed = number(answer, "position_trace_m2");
    assert!((claimed / worth(&large, &ends(&large, answer)).1 - 1.0).abs() < 1e-9);
    answers(&[with(problem(256), "separation_m", json!(2.0))], "");
    for (refused, names) in [
        (with(problem(1025), "separation_m", json!(2.0)), "separation_m"),
        (with(large, "planner", json!("grid")), "candidates"),
        (with(problem(5), "planner", json!("grid")), "3.200e11"),
    ] {
        let outcome = planned(&[refused], "");
        assert_eq!((outcome.code, outcome.stdout.lines().count()), (Some(2), 1));
        assert!(outcome.stderr.contains(names) && outcome.stderr.lines().count() == 1, "{}", outcome.stderr);
    }
}

#[test]
fn a_fatal_error_is_reported_in_one_line() {
    let cases = [
        ("plan missing.jsonl", "missing.jsonl"),
        ("plan folder", "folder"),
        ("plan --planner luck", "--planner is \"luck\": expected"),
        ("plan --nodes 0", "--nodes is "),
        ("plan --nodes many", "--nodes"),
        ("plan --iterations 0", "--iterations is "),
        ("plan --alpha 2", "--alpha is "),
        ("plan --step-rad 0", "--step-rad is "),
        ("plan --step-rad nan", "--step-rad is "),
        ("plan --steps 101", "--steps is "),
        ("plan --steps 2 --blocks 3", "--blocks is "),
        ("plan --seed -1", "--seed"),
        ("plan one two", "two"),
    ];
    for (words, names) in cases {
        let run = Run::new();
        std::fs::create_dir(run.path("folder")).unwrap();
        let outcome = run.start(&words.split_whitespace().collect::<Vec<_>>()).finish();
        let stderr = &outcome.stderr;
        assert_eq!(
            (outcome.code, stderr.lines().count(), outcome.stdout.as_str()),
            (Some(2), 1, ""),
            "{words}: {stderr}"
        );
        assert!(stderr.contains(names) && stderr.contains("expected"), "{words}: {stderr}");
    }
    // Empty input gives empty output.
    assert_eq!(Run::new().start(&["plan"]).finish().succeeded().stdout, "");
}

#[test]
fn the_example_of_its_help_is_answered() {
    let help = Run::new().start(&["plan", "--help"]).finish().succeeded().stdout;
    for flag in
        ["--planner", "--nodes", "--iterations", "--alpha", "--step-rad", "--steps", "--blocks", "--seed", "FILE"]
    {
        assert!(help.contains(flag), "{flag}");
    }
    let start = help.find("{\"prior").unwrap();
    let example = help[start..].split("\n\n").next().unwrap().replace('\n', "");
    assert!(answers(&[example], "")[0]["certified"].is_boolean());
}

/// The program behind two pipes; killed with the test.
struct Partner(Child);

impl Partner {
    fn start() -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_rangehound"));
        command.arg("plan").stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        Self(command.spawn().unwrap())
    }
}

impl Drop for Partner {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Far above the time of an answer: only a missing answer reaches it.
const LIMIT: Duration = Duration::from_secs(60);

#[test]
fn a_client_that_waits_after_one_line_is_answered() {
    let mut partner = Partner::start();
    let mut questions = partner.0.stdin.take().unwrap();
    let answers = BufReader::new(partner.0.stdout.take().unwrap());
    let (sender, received) = mpsc::channel();
    std::thread::spawn(move || answers.lines().try_for_each(|line| sender.send(line.unwrap())));
    for question in [LINE, "nonsense", LINE] {
        questions.write_all(format!("{question}\n").as_bytes()).unwrap();
        let answer: Value = serde_json::from_str(&received.recv_timeout(LIMIT).unwrap()).unwrap();
        assert_eq!(answer["error"].is_null(), question == LINE, "{answer}");
    }
    // A line in two pieces, and two lines at once, the second without an end.
    questions.write_all(&LINE.as_bytes()[..30]).unwrap();
    assert!(received.recv_timeout(Duration::from_millis(50)).is_err());
    questions.write_all(format!("{}\n{LINE}", &LINE[30..]).as_bytes()).unwrap();
    received.recv_timeout(LIMIT).unwrap();
    drop(questions);
    received.recv_timeout(LIMIT).unwrap();
    assert_eq!(received.recv_timeout(LIMIT), Err(mpsc::RecvTimeoutError::Disconnected));
    assert_eq!(partner.0.wait().unwrap().code(), Some(2));
}

#[test]
fn a_reader_that_closes_early_is_no_failure() {
    let mut partner = Partner::start();
    drop(partner.0.stdout.take());
    let mut questions = partner.0.stdin.take().unwrap();
    // The reader may be gone before all is written.
    while questions.write_all(format!("{LINE}\n").as_bytes()).is_ok() {}
    let mut stderr = String::new();
    std::io::Read::read_to_string(&mut partner.0.stderr.take().unwrap(), &mut stderr).unwrap();
    assert_eq!((partner.0.wait().unwrap().code(), stderr.as_str()), (Some(0), ""));
}
