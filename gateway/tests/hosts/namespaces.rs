//! Several hosts, each with a network and a clock of its own: the commands that make them.

use std::process::Command;

use serde_json::Value;

use crate::support::Run;

/// True if this system makes network and time namespaces; else it says why not.
fn has_namespaces() -> bool {
    let script = "unshare --net --time --monotonic 60 true && command -v ip nsenter setpriv";
    let made = Command::new("sh").args(["-c", script]).output();
    let works = made.as_ref().is_ok_and(|output| output.status.success());
    if !works {
        eprintln!("NOT TESTED: hosts: no network namespaces here (root, iproute2 and util-linux are needed): {made:?}");
    }
    works
}

/// Runs a study to its end; returns what it wrote.
fn study(run: &Run, words: &str, file: &str) -> Value {
    let process = run.start(&format!("{words} --name {} --out out", run.name));
    let pid = process.id();
    process.succeeds();
    let names = std::fs::read_dir("/run/netns").into_iter().flatten().flatten();
    let names = names.filter_map(|entry| entry.file_name().into_string().ok());
    let left: Vec<String> = names.filter(|name| name.starts_with(&format!("rangehound-{pid}-"))).collect();
    assert!(left.is_empty(), "{left:?}");
    run.assert_nothing_left();
    assert!(!run.path(&format!("out/keys.{pid}")).exists(), "keys of hosts that are no more");
    serde_json::from_str(&std::fs::read_to_string(run.path(&format!("out/{file}"))).unwrap()).unwrap()
}

fn names<'a>(hits: &'a Value, key: &str) -> Vec<&'a str> {
    hits.as_array().unwrap().iter().filter_map(|hit| hit[key].as_str()).collect()
}

/// Cuts, restarts of hosts and kills of everything else, over links that lose packets: no bit changes.
#[test]
fn in_lock_step_no_fault_between_hosts_changes_a_bit() {
    if !has_namespaces() {
        return;
    }
    let run = Run::new();
    let words = "chaos --hosts 3 --robots 5 --faults 14 --rate 5 --ticks 2000 --loss 0.05 --jitter 1 --longest-cut 0.8";
    let outcome = study(&run, words, "chaos.json");
    assert_eq!(outcome["digest_equal"], true, "{outcome:#}");
    assert_eq!(outcome["broken"].as_array().map(Vec::len), Some(0), "{outcome:#}");
    assert_eq!((&outcome["hosts"], &outcome["network"]["loss"]), (&Value::from(3), &Value::from(0.05)), "{outcome:#}");
    let (kinds, roles) = (names(&outcome["injected"], "kind"), names(&outcome["injected"], "role"));
    let is_of_hosts = |kind: &&str| ["cut", "oneway", "reboot"].contains(kind);
    assert!(kinds.iter().any(is_of_hosts) && roles.iter().any(|role| role.starts_with("host-")), "{outcome:#}");
}

/// In real time robots that were cut off, or whose host was down, have their headings in time again.
#[test]
fn robots_recover_from_cuts_and_restarts_of_their_host() {
    if !has_namespaces() {
        return;
    }
    let run = Run::new();
    let words = "chaos --hosts 2 --clock realtime --robots 2 --kinds cut,reboot --faults 3 --rate 1 --longest-cut 0.7";
    let outcome = study(&run, words, "chaos.json");
    assert_eq!(outcome["broken"].as_array().map(Vec::len), Some(0), "{outcome:#}");
    assert!(names(&outcome["injected"], "role").iter().all(|role| *role == "host-1"), "{outcome:#}");
    let hosts = outcome["faults"].as_array().unwrap().iter().find(|role| role["role"] == "host").unwrap();
    assert!(hosts["recovery_ms"]["count"].as_u64() > Some(0), "{outcome:#}");
}

#[test]
fn latency_over_hosts_is_measured_beside_one_host_and_the_network_alone() {
    if !has_namespaces() {
        return;
    }
    let run = Run::new();
    let outcome = study(&run, "latency --hosts 2 --robots 2 --rounds 1 --rate 50 --ticks 60", "latency.json");
    assert_eq!(outcome["hosts"], 2);
    let contenders: Vec<&String> = outcome["latency_us"].as_object().unwrap().keys().collect();
    let zenoh = cfg!(feature = "zenoh").then_some("zenoh");
    assert!(
        contenders.iter().copied().eq(["local", "quic", "system", "udp"].into_iter().chain(zenoh)),
        "{contenders:?}"
    );
    for contender in contenders {
        // Two robots, and the first 5 % of the ticks do not count.
        let count = outcome["latency_us"][contender]["count"].as_u64();
        assert!(count >= Some(2 * 55) && outcome["latency_us"][contender]["p50"].as_f64() > Some(0.0), "{outcome:#}");
    }
    assert!(outcome["hops_us"]["network"]["p50"].as_f64() > Some(0.0), "{outcome:#}");
}

#[test]
fn a_system_without_the_tools_for_hosts_is_told_what_is_missing() {
    for study in ["chaos", "latency"] {
        let run = Run::new();
        let process = run.start_by("PATH= exec \"$@\"", &format!("{study} --hosts 2 --robots 2 --out out"));
        let (code, text) = process.finish();
        assert!(code == Some(2) && text.contains("--hosts") && text.contains("iproute2"), "{code:?}: {text}");
    }
}
