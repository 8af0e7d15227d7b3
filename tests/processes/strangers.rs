//! Access to a run: only processes of its owner and of its own version may join.

use std::os::unix::fs::{FileExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use rangehound_shared::protocol::{PROGRAM as VERSION, PROTOCOL};
use rustix::process::Signal;

use crate::support::{Outcome, PROGRAM, Run, skipped};

const ENDLESS: &str = "--ticks 100000000 --timeout forever";

/// Another user: any id that differs from this user's.
const NOBODY: [&str; 3] = ["--reuid=65534", "--regid=65534", "--clear-groups"];

/// True if this user may act as another; otherwise reports that the test is skipped.
fn may_be_another() -> bool {
    let probe = Command::new("setpriv").args(NOBODY).arg("true").output();
    let may = probe.is_ok_and(|output| output.status.success());
    if !may {
        skipped("what needs another user", "this user may not act as another");
    }
    may
}

fn as_nobody(program: &Path, args: &[&str]) -> Output {
    Command::new("setpriv").args(NOBODY).arg(program).args(args).current_dir("/").output().unwrap()
}

/// The output of a shell script that runs as nobody, given these arguments.
fn output_as_nobody(script: &str, args: &[String]) -> String {
    let mut all = vec!["-c", script, "sh"];
    all.extend(args.iter().map(String::as_str));
    String::from_utf8(as_nobody(Path::new("/bin/sh"), &all).stdout).unwrap()
}

fn files_below(folder: &Path) -> Vec<PathBuf> {
    let mut found = vec![folder.to_owned()];
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        if entry.file_type().unwrap().is_dir() {
            found.extend(files_below(&entry.path()))
        } else {
            found.push(entry.path())
        }
    }
    found
}

fn open_to_all(path: &Path) {
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o755)).unwrap();
}

#[test]
fn another_user_can_neither_look_nor_touch_nor_signal() {
    if !may_be_another() {
        return;
    }
    let run = Run::new();
    open_to_all(&run.path(""));
    let supervisor = run.lockstep(ENDLESS);
    run.wait_for_ticks(10);

    let prefix = run.shared_memory_prefix();
    let segments = std::fs::read_dir("/dev/shm").unwrap().flatten().map(|entry| entry.path());
    let segments = segments.filter(|path| path.file_name().unwrap().to_string_lossy().starts_with(&prefix));
    let mut files: Vec<PathBuf> = segments.chain(files_below(&run.shared_folder())).collect();
    files.extend(["sim.checkpoint", "fusion.checkpoint", "run.sealed"].map(|file| run.path("out").join(file)));
    assert!(files.len() > 30, "{files:?}");
    let files: Vec<String> = files.into_iter().map(|path| path.display().to_string()).collect();
    let openable = "for file; do if [ -r \"$file\" ] || [ -w \"$file\" ] || [ -x \"$file\" ] || (: < \"$file\") 2> /dev/null; \
                    then echo \"$file\"; fi; done";
    assert_eq!(output_as_nobody(openable, &files), "");
    // The probe itself works.
    assert_eq!(output_as_nobody(openable, &["/".to_owned()]), "/\n");

    let roles = ["run", "sim", "fusion", "robot-0", "robot-1", "robot-2"];
    let pids: Vec<String> = roles[1..].iter().map(|role| run.pid_of(role, 1).as_raw_pid().to_string()).collect();
    let signalled = "for pid; do kill -0 $pid 2> /dev/null && echo $pid; kill -9 $pid 2> /dev/null && echo $pid; done";
    assert_eq!(output_as_nobody(signalled, &pids), "");

    // The tool too, started in a folder that nobody can reach.
    let folder = tempfile::tempdir().unwrap();
    open_to_all(folder.path());
    let program = folder.path().join("rangehound");
    std::fs::copy(PROGRAM, &program).unwrap();
    open_to_all(&program);
    for words in ["status", "kill sim", "restart fusion", "stop"] {
        let mut args: Vec<&str> = words.split(' ').collect();
        args.extend(["--name", &run.name]);
        let output = as_nobody(&program, &args);
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!((output.status.code(), stderr.lines().count()), (Some(2), 1), "{words}: {stderr}");
        assert!(stderr.contains(&run.name), "{words}: {stderr}");
    }

    let before = run.ticks_done();
    run.wait_for_ticks(before + 10);
    assert!(roles[1..].iter().all(|role| run.starts(role) == 1));
    supervisor.signal(Signal::INT);
    supervisor.finish();
    run.assert_nothing_left();
}

#[test]
fn a_place_that_another_user_holds_is_not_used() {
    if !may_be_another() {
        return;
    }
    let run = Run::new();
    let place = run.shared_folder();
    output_as_nobody("mkdir -m 777 \"$1\"", &[place.display().to_string()]);
    for words in ["run", "sim", "status", "fusion"] {
        let outcome = if ["run", "sim"].contains(&words) {
            run.command(words)
        } else {
            // A node that only joins looks for a run first.
            std::fs::write(place.join("run"), "bait").unwrap();
            run.node(words)
        }
        .finish();
        assert_one_line(&outcome, 2, &["belongs to another user", &run.name]);
    }
    std::fs::remove_dir_all(place).unwrap();
}

#[track_caller]
fn assert_one_line(outcome: &Outcome, code: i32, names: &[&str]) {
    assert_eq!(outcome.code, Some(code), "{outcome:#?}");
    let complaints = outcome.complaints();
    assert!(complaints.len() == 1 && names.iter().all(|name| complaints[0].contains(name)), "{outcome:#?}");
}

/// Changes a description to one of the next version.
fn make_future_description(path: &Path) {
    let text = std::fs::read_to_string(path).unwrap();
    let build = |program: &str, protocol| format!("{{\"program\":\"{program}\",\"protocol\":{protocol},");
    let other = text.replace(&build(VERSION, PROTOCOL), &build("99.8.7", PROTOCOL + 1));
    assert_ne!(other, text);
    std::fs::write(path, other).unwrap();
}

/// Changes a sealed checkpoint, from this offset on, to one of the next version.
fn make_future(path: &Path, offset: u64) {
    let file = std::fs::OpenOptions::new().write(true).open(path).unwrap();
    file.write_all_at(&(PROTOCOL + 1).to_le_bytes(), offset + 8).unwrap();
    file.write_all_at(b"99.8.7\0\0\0\0\0\0\0\0\0\0", offset + 12).unwrap();
}

fn versions() -> [String; 2] {
    [format!("rangehound 99.8.7 (protocol {})", PROTOCOL + 1), format!("this is {VERSION} (protocol {PROTOCOL})")]
}

#[test]
fn two_versions_in_one_run_refuse_each_other_and_the_run_goes_on() {
    let run = Run::new();
    let supervisor = run.lockstep(ENDLESS);
    run.wait_for_ticks(10);
    make_future_description(&run.shared_folder().join("run"));
    let [other, this] = versions();
    for words in ["fusion", "robot --id 0", "watch", "status", "kill sim", "stop"] {
        let outcome = run.node(words).finish();
        assert_one_line(&outcome, 2, &[&run.name, &other, &this, "use one version"]);
    }
    let before = run.ticks_done();
    run.wait_for_ticks(before + 10);
    supervisor.signal(Signal::INT);
    supervisor.finish();
    run.assert_nothing_left();
}

/// A run folder in which the simulator's checkpoint has been changed, after everything was killed.
fn resumed_after(change: impl FnOnce(&Path)) -> (Run, Outcome) {
    let run = Run::new();
    let supervisor = run.lockstep(ENDLESS);
    run.wait_for_ticks(50);
    let nodes = ["sim", "fusion", "robot-0", "robot-1", "robot-2"].map(|role| run.pid_of(role, 1));
    supervisor.signal(Signal::KILL);
    nodes.iter().for_each(|pid| crate::support::signal(*pid, Signal::KILL));
    supervisor.finish();
    run.wait_until("all are gone", || !nodes.iter().any(|pid| crate::support::is_alive(*pid)));
    change(&run.path("out"));
    let outcome = run.start(&["resume", "out", "--name", &run.name]).finish();
    (run, outcome)
}

#[test]
fn a_run_of_another_version_is_not_resumed() {
    let (run, outcome) = resumed_after(|out| make_future_description(&out.join("run.sealed")));
    let [other, this] = versions();
    assert_one_line(&outcome, 2, &["run.sealed", &other, &this]);
    assert!(run.path("out/sim.checkpoint").exists());
    // As protocols up to 4 wrote it.
    let head = [&b"rhsealed"[..], &4_u32.to_le_bytes(), b"0.1.0\0\0\0\0\0\0\0\0\0\0\0", &[0; 100]].concat();
    std::fs::write(run.path("out/run.sealed"), head).unwrap();
    let outcome = run.start(&["resume", "out", "--name", &run.name]).finish();
    assert_one_line(&outcome, 2, &["run.sealed", "written by rangehound 0.1.0 (protocol 4)", &this]);
}

/// Bytes that two slots of a checkpoint start at, after their lengths.
const SLOTS: [u64; 2] = [4, (1 << 20) + 4];

#[test]
fn a_checkpoint_that_cannot_be_used_is_refused_kept_and_never_half_read() {
    let [other, _] = versions();
    let damage = |path: &Path| {
        let file = std::fs::OpenOptions::new().write(true).open(path).unwrap();
        SLOTS.iter().for_each(|at| file.write_all_at(b"\xff\xff", at + 50).unwrap());
    };
    type Change<'a> = &'a dyn Fn(&Path);
    let cases: [(Change<'_>, &str); 4] = [
        (&damage, "damaged"),
        (&|path: &Path| SLOTS.iter().for_each(|at| make_future(path, *at)), &other),
        (&|path: &Path| std::fs::write(path, "something else, of some length").unwrap(), "damaged"),
        (&|path: &Path| std::fs::OpenOptions::new().write(true).open(path).unwrap().set_len(30).unwrap(), "damaged"),
    ];
    for (change, reason) in cases {
        let mut bytes = Vec::new();
        let (run, outcome) = resumed_after(|out| {
            change(&out.join("sim.checkpoint"));
            bytes = std::fs::read(out.join("sim.checkpoint")).unwrap();
        });
        assert_one_line(&outcome, 1, &["sim.checkpoint: ", reason, "sim.checkpoint.refused", "start a new run"]);
        assert_eq!(std::fs::read(run.path("out/sim.checkpoint.refused")).unwrap(), bytes);
        // A second attempt finds no state, and must not start over and overwrite the ticks so far.
        let ticks = run.ticks_done();
        let again = run.start(&["resume", "out", "--name", &run.name]).finish();
        assert_one_line(&again, 2, &["cannot resume", "sim.checkpoint is missing", "start a new run"]);
        assert_eq!(run.ticks_done(), ticks);
        run.assert_nothing_left();
    }
}

/// A command line that runs the rest in a PID namespace of its own, as in a container.
const NAMESPACE: &str = "exec unshare --pid --fork --kill-child";

/// Fails if this user may not create PID namespaces: a skipped test would look like a passed one.
fn look_for_namespaces() {
    let probe = Command::new("unshare").args(["--pid", "--fork", "true"]).output();
    assert!(probe.is_ok_and(|output| output.status.success()), "needs `unshare --pid`: run this test as root");
}

#[test]
fn a_node_of_another_pid_namespace_is_reported_and_no_other_process_is_signalled() {
    look_for_namespaces();
    let run = Run::new();
    let in_container = format!("{NAMESPACE} --mount-proc sh -c '\"$@\" & wait' sh \"$@\"");
    let sim = run.command_by(&in_container, "sim --ticks 100000000");
    run.wait_until("the run is created", || run.shared_folder().join("run").exists());
    let named = |words: &'static str| words.split(' ').chain(["--name", run.name.as_str()]).collect::<Vec<&str>>();
    let robot = run.start_by(&in_container, &named("robot --id 1"));
    run.wait_until("the robot is there", || run.is_held("robot-1") && run.starts("robot-1") == 1);

    // Outside the namespace the process with that number is visible to the kernel.
    let status = run.start(&named("status --json")).finish().succeeded();
    let status: serde_json::Value = serde_json::from_str(&status.stdout).unwrap();
    let node = status["nodes"].as_array().unwrap().iter().find(|node| node["name"] == "robot-1").unwrap().clone();
    assert_eq!(node["state"], "running", "{node}");
    let pid = rustix::process::Pid::from_raw(node["pid"].as_i64().unwrap() as i32).unwrap();
    assert_eq!(crate::support::comm(pid), "rh-robot-1");

    // In a third namespace foreign processes have the first numbers.
    let script = format!(
        "{NAMESPACE} --mount-proc sh -c 'for i in 1 2 3 4 5 6 7 8; do sleep 100 & done; \"$@\"; code=$?; \
         kill -0 $(seq 2 9) || echo strangers died; exit $code' sh \"$@\""
    );
    for words in ["kill robot-1", "kill sim", "stop"] {
        let outcome = run.start_by(&script, &named(words)).finish();
        assert_one_line(&outcome, 2, &["another PID namespace", "run this command there", &run.name]);
        assert!(!outcome.stdout.contains("strangers died"), "{outcome:#?}");
    }
    let seen = run.start_by(&script, &named("status")).finish().succeeded().stdout;
    let line = seen.lines().find(|line| line.starts_with("robot-1")).unwrap();
    assert!(line.contains("elsewhere") && seen.contains("container"), "{seen}");
    assert!(run.is_held("robot-1") && run.is_held("sim"));

    run.start(&named("kill robot-1")).finish().succeeded();
    run.wait_until("the robot is gone", || !run.is_held("robot-1"));
    run.start(&named("stop")).finish().succeeded();
    robot.finish();
    sim.finish();
    run.assert_nothing_left();
}

/// Its own process id differs from the one in `/proc`.
#[test]
fn a_run_without_its_own_proc_finishes() {
    look_for_namespaces();
    let run = Run::new();
    run.command_by(&format!("{NAMESPACE} \"$@\""), "run --clock lockstep --ticks 40").finish().succeeded();
    assert_eq!(run.report()["ticks"], 40);
    assert_eq!(run.digest(), crate::support::digest_in_process("--ticks 40"));
}
