//! The system's latency beside that of its references: counted samples, and cleanup.

use rustix::process::Signal;
use serde_json::Value;

use crate::support::{Run, assert_refused_at_once};

fn outcome(run: &Run) -> Value {
    serde_json::from_str(&run.read("latency.json")).unwrap()
}

const CONTENDERS: [&str; 3] = ["system", "iceoryx2", "futex"];

fn check(run: &Run, count: impl Fn(u64) -> bool, rounds: usize) {
    let outcome = outcome(run);
    assert_eq!(outcome["rounds"].as_array().unwrap().len(), rounds);
    for contender in CONTENDERS {
        let merged = &outcome["latency_us"][contender];
        let of_rounds = outcome["rounds"].as_array().unwrap().iter().map(|round| &round["latency_us"][contender]);
        let counts: Vec<u64> = of_rounds.map(|latency| latency["count"].as_u64().unwrap()).collect();
        assert!(counts.iter().all(|of_round| count(*of_round)), "{contender}: {counts:?}");
        assert_eq!(merged["count"].as_u64(), Some(counts.iter().sum()));
        let percentiles = ["p50", "p90", "p99", "p99_9", "max"].map(|key| merged[key].as_f64().unwrap());
        assert!(percentiles[0] > 0.0 && percentiles.is_sorted(), "{contender}: {percentiles:?}");
        let curve = outcome["percentiles"][contender].as_array().unwrap();
        assert_eq!(curve.last().unwrap()["percentile"], 100.0, "{contender}");
    }
    for reference in ["iceoryx2", "futex"] {
        assert!(outcome["p50_ratios"][reference].as_f64() > Some(0.0), "{outcome:#}");
    }
    assert!(outcome["hops_us"]["robot_awake"]["p50"].as_f64() > Some(0.0), "{outcome:#}");
    assert!(run.read("latency.svg").contains("</svg>"));
    run.assert_nothing_left();
}

#[test]
fn in_lock_step_every_range_is_counted_once() {
    let run = Run::new();
    let printed = run.command("latency --robots 2 --ticks 400 --rounds 2 --pin one-core").finish().succeeded();
    assert!(CONTENDERS.iter().all(|contender| printed.stdout.contains(contender)), "{printed:#?}");
    assert_eq!(outcome(&run)["warm_up_ticks"], 20);
    check(&run, |count| count == 2 * 380, 2);
}

/// More than were published if a node was late; at the ends of a run some may be missing.
#[test]
fn in_real_time_every_range_that_was_due_is_counted() {
    let run = Run::new();
    run.command("latency --robots 2 --ticks 100 --rounds 1 --rate 100").finish().succeeded();
    assert_eq!(outcome(&run)["rate_hz"], 100.0);
    check(&run, |count| count >= 2 * 50, 1);
}

#[test]
fn ended_or_killed_it_leaves_nothing() {
    for signal in [Signal::INT, Signal::KILL] {
        let run = Run::new();
        let measured = run.command("latency --robots 2 --ticks 1000000");
        run.wait_until("a node of a reference is there", || run.shared_folder().join("nodes").exists());
        measured.signal(signal);
        let ended = measured.finish();
        if signal == Signal::INT {
            assert_eq!(ended.code, Some(1), "{ended:#?}");
            assert_eq!(ended.complaints(), ["rangehound: interrupted before the last round: start `latency` again"]);
        }
        run.assert_nothing_left();
    }
}

#[test]
fn invalid_values_are_refused_before_anything_starts() {
    for (words, expected) in [
        ("latency --rounds 0", "--rounds is 0: expected 1 to 1000"),
        ("latency --rate 0", "--rate is 0: expected 0.001 to 10000 Hz"),
        ("latency --rate nan", "--rate is NaN: expected 0.001 to 10000 Hz"),
        ("latency --rate 10 --clock lockstep", "add --clock realtime"),
        ("latency --robots 0", "--robots is 0: expected a whole number from 1 to 1024"),
        ("latency --ticks 100000000", "--ticks is 100000000: expected at most"),
        ("latency --pin all", "expected none, one-core, or processors by number"),
        ("latency --pin 1000", "--pin 1000: Invalid argument (os error 22): expected processors that exist"),
    ] {
        assert_refused_at_once(words, expected);
    }
}
