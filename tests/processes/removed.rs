//! Shared memory that is removed under a run, as systemd does at a user's last logout: the run goes on from its
//! checkpoints in new shared memory, and its estimates are the same to the bit.

use std::path::PathBuf;

use rustix::process::Signal;

use crate::support::{Process, Run, digest_in_process, is_alive, signal};

const WORDS: &str = "--ticks 40000 --timeout forever";
const ROLES: [&str; 5] = ["sim", "fusion", "robot-0", "robot-1", "robot-2"];

/// The run's segments in shared memory, without its folder.
fn files(run: &Run) -> Vec<PathBuf> {
    let prefix = run.shared_memory_prefix();
    let entries = std::fs::read_dir("/dev/shm").unwrap().flatten().map(|entry| entry.path());
    entries.filter(|path| path.file_name().unwrap().to_string_lossy().starts_with(&prefix)).collect()
}

/// Removes all of the run's shared memory.
fn remove_all(run: &Run) {
    let segments = files(run);
    // A node may just be creating a file in the folder.
    let mut result = Ok(());
    for _ in 0..10 {
        result = std::fs::remove_dir_all(run.shared_folder());
        if result.is_ok() {
            break;
        }
    }
    // The supervisor may be faster.
    assert!(result.is_ok() || !run.shared_folder().join("sim.role").exists(), "{result:?}");
    for file in segments {
        // The supervisor may be faster.
        let _ = std::fs::remove_file(file);
    }
}

fn removals_reported(supervisor: &Process) -> usize {
    supervisor.stderr().lines().filter(|line| line.contains("was removed from outside")).count()
}

/// Waits until all nodes have been started this many times, and have done 200 more ticks.
fn wait_for_next(run: &Run, starts: u64) {
    for role in ROLES {
        run.pid_of(role, starts);
    }
    let done = run.ticks_done();
    run.wait_for_ticks(done + 200);
}

#[test]
fn a_run_goes_on_however_often_its_shared_memory_is_removed() {
    let run = Run::new();
    let supervisor = run.lockstep(&format!("{WORDS} --record --standby 1"));
    run.wait_for_ticks(200);
    for removals in 1..=3 {
        let sim = run.pid_of("sim", removals);
        remove_all(&run);
        run.wait_until("the removal is reported", || removals_reported(&supervisor) as u64 == removals);
        assert!(!is_alive(sim), "a new process has replaced it");
        // The count of starts goes on, so the incarnation is greater than before.
        run.pid_of("sim", removals + 1);
        run.pid_of("robot-2", removals + 1);
        let done = run.ticks_done();
        run.wait_for_ticks(done + 200);
    }
    supervisor.finish().succeeded();
    assert_eq!(run.digest(), digest_in_process(WORDS));
    let report = run.report();
    let sim = &report["nodes"][0];
    assert_eq!(sim["starts"], 4, "{report}");
    assert_eq!(sim["kills"].as_u64().unwrap() + sim["exits"].as_u64().unwrap(), 3, "{report}");
    let replayed = run.start(&["replay", "out/run.mcap", "--json"]).finish().succeeded();
    assert!(replayed.stdout.contains("\"bit-identical\"") && replayed.stdout.contains("40000"), "{replayed:#?}");
    run.assert_nothing_left();
}

#[test]
fn the_removal_of_any_part_of_shared_memory_is_noticed_before_it_is_needed() {
    let expected = digest_in_process(WORDS);
    for part in [
        "folder",
        "segments",
        "run",
        "members",
        "membership.lock",
        "iceoryx2.toml",
        "sim.role",
        "wait_groups.dyn",
        ".dynamic",
        ".data",
        ".connection",
        "nodes",
        "services",
    ] {
        let run = Run::new();
        let supervisor = run.lockstep(WORDS);
        run.wait_for_ticks(200);
        let segments = files(&run);
        let of_folder = run.shared_folder().join(part);
        match part {
            "folder" => std::fs::remove_dir_all(run.shared_folder()).unwrap(),
            "segments" => segments.iter().for_each(|file| std::fs::remove_file(file).unwrap()),
            "nodes" | "services" => std::fs::remove_dir_all(of_folder).unwrap(),
            _ if of_folder.exists() => std::fs::remove_file(of_folder).unwrap(),
            ending => {
                let found = segments.iter().find(|file| file.to_string_lossy().ends_with(ending));
                std::fs::remove_file(found.unwrap_or_else(|| panic!("{ending} in {segments:?}"))).unwrap();
            }
        }
        // A new node makes its own connections.
        if part != ".connection" {
            run.wait_until(&format!("the removal of {part} is reported"), || removals_reported(&supervisor) == 1);
            wait_for_next(&run, 2);
        }
        signal(run.pid_of("fusion", if part == ".connection" { 1 } else { 2 }), Signal::KILL);
        signal(run.pid_of("robot-1", if part == ".connection" { 1 } else { 2 }), Signal::KILL);
        supervisor.finish().succeeded();
        assert_eq!(run.digest(), expected, "{part}");
        run.assert_nothing_left();
    }
}

#[test]
fn in_real_time_a_run_goes_on_too_and_so_do_a_watch_and_the_page() {
    let run = Run::new();
    let supervisor = run.command("run --clock realtime --ticks 60 --live");
    let watch = run.node("watch --json");
    run.wait_for_ticks(5);
    let address = |supervisor: &Process| -> Vec<String> {
        supervisor.stderr().lines().filter_map(|line| line.strip_prefix("live: ")).map(str::to_owned).collect()
    };
    run.wait_until("the page and the watch are there", || address(&supervisor).len() == 1 && watch.has_joined());
    remove_all(&run);
    run.wait_until("the page is there again", || address(&supervisor).len() == 2);
    assert_eq!(address(&supervisor)[0], address(&supervisor)[1]);
    supervisor.finish().succeeded();
    assert_eq!(run.report()["ticks"], 60);
    let watched = watch.finish().succeeded();
    assert!(watched.stdout.contains("\"ticks\":60"), "{watched:#?}");
    run.assert_nothing_left();
}

#[test]
fn nodes_without_a_supervisor_end_with_the_cause_and_resume_goes_on() {
    let run = Run::new();
    let sim = run.command(&format!("sim --clock lockstep {WORDS}"));
    let fusion = run.node("fusion");
    // It is started before the standby, which would lead otherwise.
    run.pid_of("fusion", 1);
    let nodes = ["fusion --standby", "robot --id 0", "robot --id 1", "robot --id 2"].map(|words| run.node(words));
    run.wait_for_ticks(200);
    remove_all(&run);
    for node in nodes.into_iter().chain([fusion, sim]) {
        let outcome = node.finish();
        assert_eq!(outcome.code, Some(1), "{outcome:#?}");
        let [complaint] = outcome.complaints()[..] else { panic!("{outcome:#?}") };
        assert!(complaint.contains("has lost its shared memory") && complaint.contains("RemoveIPC"), "{complaint}");
        assert!(complaint.contains("rangehound resume") && !outcome.stderr.contains("deposed"), "{outcome:#?}");
    }
    run.start(&["resume", "out", "--name", &run.name, "--no-record"]).finish().succeeded();
    assert_eq!(run.digest(), digest_in_process(WORDS));
    run.assert_nothing_left();
}

#[test]
fn without_its_checkpoints_the_run_ends_with_the_cause() {
    let run = Run::new();
    let supervisor = run.lockstep("--ticks 100000000 --timeout forever");
    run.wait_for_ticks(200);
    // It is stopped, so that it writes no new checkpoint.
    signal(run.pid_of("fusion", 1), Signal::STOP);
    for file in ["out/sim.checkpoint", "out/fusion.checkpoint"] {
        std::fs::remove_file(run.path(file)).unwrap();
    }
    remove_all(&run);
    let outcome = supervisor.finish();
    assert_eq!(outcome.code, Some(1), "{outcome:#?}");
    let [complaint] = outcome.complaints()[..] else { panic!("{outcome:#?}") };
    assert!(complaint.contains("was removed from outside") && complaint.contains("saved no state"), "{complaint}");
    run.assert_nothing_left();
}
