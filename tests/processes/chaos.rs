//! Campaigns of faults on live runs.

use serde_json::Value;

use crate::support::{Run, assert_refused_at_once};

fn outcome(run: &Run) -> Value {
    serde_json::from_str(&run.read("chaos.json")).unwrap()
}

fn hits(outcome: &Value, key: &str) -> Vec<String> {
    let injected = outcome["injected"].as_array().unwrap();
    injected.iter().map(|hit| hit[key].as_str().unwrap().to_owned()).collect()
}

#[test]
fn faults_of_all_kinds_break_no_promise_in_lock_step() {
    let run = Run::new();
    let printed = run.command("chaos --robots 3 --faults 12 --rate 4 --ticks 20000").finish().succeeded();
    assert!(printed.stdout.contains("all kept"), "{printed:#?}");
    assert!(printed.stdout.lines().all(|line| line.len() <= 80 || line.contains("run folder")), "{printed:#?}");
    let outcome = outcome(&run);
    assert_eq!(outcome["digest_equal"], true, "{outcome:#}");
    assert_eq!(outcome["ranges"]["missing"], 0, "{outcome:#}");
    assert_eq!(outcome["broken"].as_array().unwrap().len(), 0, "{outcome:#}");
    assert_eq!(outcome["injected"].as_array().unwrap().last().unwrap()["fault"], 11, "{outcome:#}");
    for kind in hits(&outcome, "kind") {
        assert!(["kill", "stop", "crash-loop", "several", "total-outage"].contains(&kind.as_str()), "{kind}");
    }
    for key in ["clock", "robots", "chaos_seed", "faults", "ticks", "without_heading", "files_left", "rounds"] {
        assert!(!outcome[key].is_null(), "{key} in {outcome:#}");
    }
    run.assert_nothing_left();
}

#[test]
fn standbys_take_over_and_runs_recover_from_total_outages() {
    let run = Run::new();
    let words = "--standby 1 --kinds kill,blackout --roles fusion,standby --faults 12 --rate 2 --ticks 20000";
    let printed = run.command(&format!("chaos {words}")).finish().succeeded();
    assert!(printed.stdout.contains("all kept"), "{printed:#?}");
    let outcome = outcome(&run);
    assert_eq!(outcome["digest_equal"], true, "{outcome:#}");
    let roles: Vec<&str> =
        outcome["faults"].as_array().unwrap().iter().map(|of| of["role"].as_str().unwrap()).collect();
    assert_eq!(roles, ["sim", "fusion", "robot", "standby", "run"], "{outcome:#}");
    assert!(outcome["faults"][1]["restart_ms"]["count"].as_u64() > Some(0), "{outcome:#}");
    assert!(outcome["faults"][4]["recovery_ms"]["count"].as_u64() > Some(0), "{outcome:#}");
    run.assert_nothing_left();
}

#[test]
fn killed_robots_come_back_in_real_time() {
    let run = Run::new();
    run.write("fast.toml", "dt_s = 0.02\n");
    let words = "chaos fast.toml --clock realtime --kinds kill --roles robot --faults 5 --rate 5 --ticks 200";
    run.command(words).finish().succeeded();
    let outcome = outcome(&run);
    assert!(outcome["digest_equal"].is_null(), "{outcome:#}");
    assert!(hits(&outcome, "kind").iter().all(|kind| kind == "kill"), "{outcome:#}");
    assert!(hits(&outcome, "role").iter().all(|role| role.starts_with("robot-")), "{outcome:#}");
    for error in ["faulted", "baseline"] {
        assert!(outcome["position_rmse_m"][error].as_f64() > Some(0.0), "{outcome:#}");
    }
    assert!(outcome["headings"]["fresh"].as_u64() > Some(0), "{outcome:#}");
    assert!(outcome["faults"][2]["recovery_ms"]["count"].as_u64() > Some(0), "{outcome:#}");
    run.assert_nothing_left();
}

#[test]
fn invalid_values_are_refused_before_anything_starts() {
    for (words, expected) in [
        ("chaos --faults 0", "--faults is 0: expected at least 1"),
        ("chaos --rate 0", "--rate is 0: expected 0.01 to 1000"),
        ("chaos --rate -1", "--rate is -1: expected 0.01 to 1000"),
        ("chaos --rate nan", "--rate is NaN: expected 0.01 to 1000"),
        ("chaos --rate inf", "--rate is inf: expected 0.01 to 1000"),
        (
            "chaos --kinds flood",
            "expected one of: kill, stop, crash-loop, several, total-outage, cut, one-way, reboot, all",
        ),
        ("chaos --longest-stop 0", "--longest-stop is 0: expected 0.01 to 60 s"),
        ("chaos --roles standby", "expected --standby 1 or more"),
        ("chaos --timeout 1", "--timeout is given in seconds: expected forever"),
        ("chaos --kinds cut", "expected --hosts 2 or more"),
        ("chaos --roles gateway", "expected --hosts 2 or more"),
        ("chaos --hosts 1", "--hosts is 1: expected 2 to 3"),
        ("chaos --hosts 4 --robots 3", "--hosts is 4: expected 2 to 3"),
        ("chaos --hosts 2 --robots 1", "--hosts is given for one robot"),
        ("chaos --hosts 2 --loss 1", "--loss is 1: expected 0 to 0.9"),
        ("chaos --hosts 2 --delay nan", "--delay is NaN: expected 0 to 1000 ms"),
        ("chaos --hosts 2 --burst 0", "--burst is 0: expected 1 to 1000"),
        ("chaos --loss 0.1", "--hosts"),
        ("latency --hosts 1", "--hosts is 1: expected 2 to 4"),
    ] {
        assert_refused_at_once(words, expected);
    }
}
