//! The commands of README and docs that need this program: the blocks with the mark of this file.

use std::net::UdpSocket;
use std::path::Path;

use serde_json::Value;

use crate::namespaces::study;
use crate::support::Run;

/// The mark before a block.
const MARK: &str = "<!-- run by: gateway/tests/hosts/book.rs -->\n";

/// The blocks of a page that are marked for this file: as many as the caller runs.
fn blocks<const N: usize>(page: &str) -> [String; N] {
    let text = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(page)).unwrap();
    let block = |rest: &str| rest.strip_prefix("```sh\n").unwrap().split_once("```").unwrap().0.to_owned();
    let blocks = text.split(MARK).skip(1).map(block);
    blocks
        .collect::<Vec<_>>()
        .try_into()
        .unwrap_or_else(|blocks: Vec<_>| panic!("{page}: {} blocks, not {N}", blocks.len()))
}

/// The blocks of one page. The compiler finds one that no test reads.
struct Machines {
    team: String,
    trial: String,
    by_hand: String,
    latency: String,
    keys: String,
}

fn machines() -> Machines {
    let [team, trial, by_hand, latency, keys] = blocks("docs/machines.md");
    Machines { team, trial, by_hand, latency, keys }
}

/// A network, a `/dev/shm` and names of hosts of its own; alice has a folder of hers. What is built is there already.
const HOSTS: &str = r#"set -euo pipefail
mount -t tmpfs none /dev/shm
echo '127.0.0.1 localhost station alice' > hosts
mount --bind hosts /etc/hosts
ip link set lo up
program=$1
pids=()
rangehound() { "$program" "$@"; }
cargo() { [ "$1" = build ]; }
scp() { cp -r "$2" "${3/:/\/}"; }
mkdir -p alice
"#;

const END: &str = r#"for pid in "${pids[@]}"; do wait "$pid"; done
left=$(ls -A /dev/shm)
[ -z "$left" ] || { echo "left behind: $left" >&2; exit 1; }
"#;

/// The command without its comment, and the comment.
fn parts(line: &str) -> (&str, &str) {
    let (command, comment) = line.split_once(" #").unwrap_or((line, ""));
    (command.trim_end(), comment)
}

/// A block as it is typed on the hosts that its comments name: each command that does not end by itself in a terminal of its own.
fn typed(block: &str) -> String {
    let mut script = String::new();
    for line in block.lines() {
        let (command, comment) = parts(line);
        let mut start = |command: &str| script += &format!("{command} & pids+=($!)\n");
        if comment.contains("on alice") {
            start(&format!("(cd alice; {command})"));
            if comment.contains("the same for robot 2") {
                start(&format!("(cd alice; {})", command.replace("--id 1", "--id 2")));
            }
        } else if command.starts_with("rangehound run") {
            start(&format!("{command} --ticks 50"));
        } else {
            let ends = command.replace(" &", " & pids+=($!);");
            script += &format!("{}\n", ends.trim_end_matches(';'));
        }
        // `then` another command, in the comment.
        if let Some((_, then)) = comment.split_once("then `") {
            script += &format!("{}\n", then.trim_end_matches('`'));
        }
    }
    script
}

/// Runs a script on such hosts.
fn run_on_hosts(run: &Run, script: &str) {
    let scenarios = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenarios");
    std::os::unix::fs::symlink(scenarios, run.path("scenarios")).unwrap();
    std::fs::write(run.path("typed.sh"), format!("{HOSTS}{script}{END}")).unwrap();
    // All processes end with the namespace.
    let unshare = "exec unshare --net --mount --pid --fork --kill-child --mount-proc bash typed.sh \"$1\"";
    run.start_by(unshare, "").succeeds();
}

/// All three robots of a run have measured.
fn assert_all_measured(run: &Run, name: &str) {
    let report = std::fs::read_to_string(run.path(&format!("runs/{name}/report.json"))).unwrap();
    let report: Value = serde_json::from_str(&report).unwrap();
    let ranges: Vec<u64> =
        report["sensors"].as_array().unwrap().iter().map(|at| at["ranges"].as_u64().unwrap()).collect();
    assert!(ranges.len() == 3 && ranges.iter().all(|count| *count > 25), "{report:#}");
}

#[test]
#[cfg_attr(not(namespaces), ignore = "needs network and time namespaces: root, iproute2 and util-linux")]
fn the_team_of_the_readme_on_two_hosts_works() {
    let [block] = blocks("README.md");
    let run = Run::new();
    run_on_hosts(&run, &typed(&block));
    assert_all_measured(&run, "paper");
}

/// Also the run that was started by hand, with the same keys: robots 0 and 1 on its host, as in the first block.
#[test]
#[cfg_attr(not(namespaces), ignore = "needs network and time namespaces: root, iproute2 and util-linux")]
fn the_team_of_the_book_on_two_hosts_works() {
    let Machines { team, by_hand, .. } = machines();
    let run = Run::new();
    let robot = team.lines().find(|line| line.starts_with("rangehound robot")).unwrap();
    let robots = format!("rangehound robot --id 0 --name team &\nrangehound robot --id 1 --name team &\n{robot}\n");
    let by_hand = by_hand.replace("paper.toml", "paper.toml --ticks 50");
    // `watch` stays in the foreground until the end of the run.
    let (nodes, watch) = by_hand.trim_end().rsplit_once('\n').unwrap();
    let script = format!(
        "{}for pid in \"${{pids[@]}}\"; do wait \"$pid\"; done; pids=()\nmv runs/team runs/first\n{}{}",
        typed(&team),
        typed(&format!("{nodes}\n{robots}")),
        typed(watch)
    );
    run_on_hosts(&run, &script);
    assert_all_measured(&run, "first");
    assert_all_measured(&run, "team");
}

/// On one machine, with a name and a port of their own.
#[test]
fn the_trial_of_the_book_on_one_machine_works() {
    let run = Run::new();
    let port = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let commands = machines().trial.replace(":7400", &format!(":{port}")).replace("trial", &run.name);
    let commands = commands.replace("run --name", "run --ticks 50 --name");
    // The robot ends with the run.
    let script = format!("program=$1\nrangehound() {{ \"$program\" \"$@\"; }}\n{commands}wait $!");
    run.start_by(&script, "").succeeds();
    assert_all_measured(&run, &run.name);
    run.assert_nothing_left();
}

#[test]
fn the_keys_of_the_book_are_made_as_it_says() {
    let [readme] = blocks("README.md");
    let Machines { team, keys, .. } = machines();
    for (block, commands, hosts) in [(readme, 1, 1), (team, 1, 1), (keys, 2, 3)] {
        let run = Run::new();
        let typed: Vec<&str> = block.lines().filter_map(|line| parts(line).0.strip_prefix("rangehound keys")).collect();
        typed.iter().for_each(|words| run.finish_ok(&format!("keys {words}")));
        assert_eq!(typed.len(), commands, "{block}");
        let folders = ["authority", "station", "alice", "bob", "carol"];
        let made = folders.map(|folder| run.path("keys").join(folder).exists());
        assert_eq!(made.iter().filter(|made| **made).count(), 2 + hosts, "{block}");
    }
}

/// A study of a line of the book, which is made shorter.
fn study_of(line: &str, shorter: &[(&str, &str)], more: &str, file: &str) -> Value {
    let (command, _) = parts(line);
    let mut words = command.strip_prefix("rangehound ").unwrap().to_owned();
    for (long, short) in shorter {
        assert!(words.contains(long), "{words}: no {long}");
        words = words.replace(long, short);
    }
    study(&Run::new(), &format!("{words} {more}"), file)
}

#[test]
#[cfg_attr(not(namespaces), ignore = "needs network and time namespaces: root, iproute2 and util-linux")]
fn the_latency_between_hosts_is_measured_as_the_book_says() {
    let block = machines().latency;
    let outcome = study_of(block.trim_end(), &[("--rounds 3", "--rounds 1")], "--ticks 100", "latency.json");
    assert_eq!((&outcome["hosts"], &outcome["robots"]), (&2.into(), &10.into()), "{outcome:#}");
    for contender in ["local", "quic", "system", "udp"] {
        assert!(outcome["latency_us"][contender]["p50"].as_f64() > Some(0.0), "{contender}: {outcome:#}");
    }
}

#[test]
#[cfg_attr(not(namespaces), ignore = "needs network and time namespaces: root, iproute2 and util-linux")]
fn the_faults_between_hosts_of_the_book_break_no_promise() {
    let [block] = blocks("docs/recover.md");
    let [lockstep, realtime] = block.lines().collect::<Vec<_>>().try_into().unwrap();
    let outcome = study_of(lockstep, &[], "--faults 3 --ticks 2000", "chaos.json");
    assert_eq!(
        (&outcome["digest_equal"], &outcome["broken"]),
        (&true.into(), &Value::Array(Vec::new())),
        "{outcome:#}"
    );
    let outcome = study_of(realtime, &[("--faults 5", "--faults 1")], "", "chaos.json");
    assert_eq!(outcome["broken"], Value::Array(Vec::new()), "{outcome:#}");
}
