//! Several hosts, each with a network and a clock of its own: the commands that make them.

use serde_json::Value;

use crate::support::Run;

/// Runs a study to its end; returns what it wrote.
pub(crate) fn study(run: &Run, words: &str, file: &str) -> Value {
    let process = run.start(&format!("{words} --name {} --out out", run.name));
    let pid = process.pid().as_raw_pid();
    process.succeeds();
    let names = std::fs::read_dir("/run/netns").into_iter().flatten().flatten();
    let names = names.filter_map(|entry| entry.file_name().into_string().ok());
    let left: Vec<String> = names.filter(|name| name.starts_with(&format!("rangehound-{pid}-"))).collect();
    assert!(left.is_empty(), "{left:?}");
    run.assert_nothing_left();
    let is_of_hosts = |path: &str| run.path(&format!("out/{path}.{pid}")).exists();
    assert!(!is_of_hosts("keys") && !is_of_hosts("memory"), "folders of hosts that are no more");
    serde_json::from_str(&std::fs::read_to_string(run.path(&format!("out/{file}"))).unwrap()).unwrap()
}

fn names<'a>(hits: &'a Value, key: &str) -> Vec<&'a str> {
    hits.as_array().unwrap().iter().filter_map(|hit| hit[key].as_str()).collect()
}

#[track_caller]
fn assert_all_kept(outcome: &Value) {
    assert_eq!(outcome["broken"].as_array().map(Vec::len), Some(0), "{outcome:#}");
}

#[track_caller]
fn assert_no_bit_changed(outcome: &Value) {
    assert_eq!(outcome["digest_equal"], true, "{outcome:#}");
    assert_all_kept(outcome);
}

/// Cuts, restarts of hosts and kills of everything else, over links that lose packets: no bit changes.
#[test]
#[cfg_attr(not(namespaces), ignore = "needs network and time namespaces: root, iproute2 and util-linux")]
fn in_lock_step_no_fault_between_hosts_changes_a_bit() {
    let run = Run::new();
    let words = "chaos --hosts 3 --robots 5 --faults 14 --rate 5 --ticks 2000 --loss 0.05 --jitter 1 --longest-cut 0.8";
    let outcome = study(&run, words, "chaos.json");
    assert_no_bit_changed(&outcome);
    assert_eq!((&outcome["hosts"], &outcome["network"]["loss"]), (&Value::from(3), &Value::from(0.05)), "{outcome:#}");
    let (kinds, roles) = (names(&outcome["injected"], "kind"), names(&outcome["injected"], "role"));
    let is_of_hosts = |kind: &&str| ["cut", "one-way", "reboot"].contains(kind);
    assert!(kinds.iter().any(is_of_hosts) && roles.iter().any(|role| role.starts_with("host-")), "{outcome:#}");
}

/// Bad links all the time: a third of the packets is lost, or packets are up to 50 ms late and overtake each other.
const BAD_LINKS: [&str; 2] = ["--loss 0.3", "--jitter 50"];

#[test]
#[cfg_attr(not(namespaces), ignore = "needs network and time namespaces: root, iproute2 and util-linux")]
fn in_lock_step_bad_links_change_no_bit() {
    for link in BAD_LINKS {
        let run = Run::new();
        let words = "chaos --hosts 3 --robots 4 --faults 2 --rate 2 --kinds cut --longest-cut 0.2 --ticks 150";
        let outcome = study(&run, &format!("{words} {link}"), "chaos.json");
        assert_eq!(outcome["digest_equal"], true, "{link}: {outcome:#}");
        assert_all_kept(&outcome);
    }
}

/// Hosts whose packets are on their way for 300 ms each way: over a satellite, or a bad radio.
#[test]
#[cfg_attr(not(namespaces), ignore = "needs network and time namespaces: root, iproute2 and util-linux")]
fn in_lock_step_slow_links_change_no_bit() {
    let run = Run::new();
    let words = "chaos --hosts 3 --robots 4 --faults 2 --rate 0.5 --kinds cut --longest-cut 0.8 --ticks 15 --delay 300";
    let outcome = study(&run, words, "chaos.json");
    assert_no_bit_changed(&outcome);
}

/// In real time most headings are in time, with ticks that are longer than some round trips.
#[test]
#[cfg_attr(not(namespaces), ignore = "needs network and time namespaces: root, iproute2 and util-linux")]
fn in_real_time_most_headings_come_in_time_over_bad_links() {
    for link in BAD_LINKS {
        let run = Run::with_ticks_of(0.5);
        let words = "chaos slow.toml --clock realtime --hosts 3 --robots 4 --ticks 30 --faults 1 --kinds kill --roles robot --rate 1";
        let outcome = study(&run, &format!("{words} {link}"), "chaos.json");
        let [fresh, late, none] = ["fresh", "late", "none"].map(|key| outcome["headings"][key].as_u64().unwrap());
        println!("{link}: {fresh} headings in time, {late} late, {none} missing");
        assert!(10 * fresh > 9 * (fresh + late + none), "{link}: {outcome:#}");
        assert_all_kept(&outcome);
    }
}

/// In real time robots that were cut off, or whose host was down, have their headings in time again.
#[test]
#[cfg_attr(not(namespaces), ignore = "needs network and time namespaces: root, iproute2 and util-linux")]
fn robots_recover_from_cuts_and_restarts_of_their_host() {
    let run = Run::new();
    let words = "chaos --hosts 2 --clock realtime --robots 2 --kinds cut,reboot --faults 3 --rate 1 --longest-cut 0.7";
    let outcome = study(&run, words, "chaos.json");
    assert_all_kept(&outcome);
    assert!(names(&outcome["injected"], "role").iter().all(|role| *role == "host-1"), "{outcome:#}");
    let hosts = outcome["faults"].as_array().unwrap().iter().find(|role| role["role"] == "host").unwrap();
    assert!(hosts["recovery_ms"]["count"].as_u64() > Some(0), "{outcome:#}");
}

#[test]
#[cfg_attr(not(namespaces), ignore = "needs network and time namespaces: root, iproute2 and util-linux")]
fn latency_over_hosts_is_measured_beside_one_host_and_the_network_alone() {
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

/// A robot of a run on another host than the run's, as soon as it runs.
fn remote_robot(run: &Run) -> u32 {
    run.wait_for("a robot on another host", || {
        let mut processes = std::fs::read_dir("/proc").unwrap().flatten();
        processes.find_map(|entry| {
            let pid = entry.file_name().to_str()?.parse().ok()?;
            let words = std::fs::read_to_string(format!("/proc/{pid}/cmdline")).ok()?;
            // Before that it is a tool that makes its host.
            let is_robot = std::fs::read_link(format!("/proc/{pid}/exe")).ok()?.ends_with("rangehound-gateway");
            (is_robot && words.contains(&format!("\0{}\0", run.name)) && words.contains("--connect")).then_some(pid)
        })
    })
}

/// Nothing may stay in the shared memory of a robot's host, and chaos looks there.
#[test]
#[cfg_attr(not(namespaces), ignore = "needs network and time namespaces: root, iproute2 and util-linux")]
fn a_leftover_on_a_robots_host_is_a_broken_promise() {
    let run = Run::new();
    let words = "chaos --hosts 2 --robots 2 --faults 1 --rate 1 --kinds kill --roles sim --ticks 3000";
    let chaos = run.start(&format!("{words} --name {} --out out", run.name));
    std::fs::write(format!("/proc/{}/root/dev/shm/left", remote_robot(&run)), "").unwrap();
    let (code, text) = chaos.finish();
    assert!(code == Some(1) && text.contains("left in shared memory: left on host-1"), "{code:?}: {text}");
    run.assert_nothing_left();
}

#[test]
fn a_system_without_the_tools_for_hosts_is_refused_with_their_names() {
    for study in ["chaos", "latency"] {
        let run = Run::new();
        let process = run.start_by("PATH= exec \"$@\"", &format!("{study} --hosts 2 --robots 2 --out out"));
        let (code, text) = process.finish();
        assert!(code == Some(2) && text.contains("--hosts") && text.contains("iproute2"), "{code:?}: {text}");
    }
}
