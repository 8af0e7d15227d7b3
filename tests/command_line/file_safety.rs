//! No file of the user is replaced or removed: output folders, inputs, and results that several processes could write.

use std::os::unix::fs::symlink;
use std::path::Path;

use rustix::process::Signal;
use serde_json::Value;

use crate::support::{Outcome, Run};

const RECORDING: &str =
    "time_s,sensor_id,sensor_x_m,sensor_y_m,range_m\n0,0,0,0,5\n0.00000012,1,9,0,5\n1,0,0,0,5\n1,1,9,0,5\n";

const TRACK: &str = "--range-std 0.1 --in-process --no-record";

fn start(run: &Run, words: &str) -> Outcome {
    run.start(&words.split_whitespace().collect::<Vec<_>>()).finish()
}

/// Refused in one line with exit code 2.
#[track_caller]
fn assert_refused(refused: &Outcome, expected: &str) {
    assert_eq!((refused.code, refused.complaints().len()), (Some(2), 1), "{refused:#?}");
    assert!(refused.stderr.contains(expected), "{refused:#?}");
}

/// All files below a folder, with their content.
fn snapshot(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap().flatten() {
        let path = entry.path();
        if path.is_dir() {
            files.extend(snapshot(&path));
        } else {
            files.push((path.display().to_string(), std::fs::read(&path).unwrap()));
        }
    }
    files.sort();
    files
}

#[test]
fn a_folder_with_other_files_is_refused_by_every_command_and_left_as_it_was() {
    let run = Run::new();
    run.write("uwb.csv", RECORDING);
    std::fs::create_dir_all(run.path("mine/logs")).unwrap();
    for file in ["ranges.csv", "truth.csv", "report.json", "system-1", "compare.json", "logs/mine.log", "world.ticks"] {
        run.write(&format!("mine/{file}"), "mine");
    }
    symlink("mine", run.path("link")).unwrap();
    let before = snapshot(&run.path("mine"));
    let name = &run.name;
    for command in [
        format!("track uwb.csv {TRACK}"),
        "run --in-process --ticks 5".to_owned(),
        format!("run --ticks 5 --name {name}"),
        format!("sim --ticks 5 --name {name}"),
        "compare --runs 1 --ticks 5 --planners random".to_owned(),
        "latency --ticks 20 --rounds 1".to_owned(),
        format!("chaos --faults 1 --name {name}"),
    ] {
        for out in ["mine", "link", "./mine/../mine/."] {
            assert_refused(&start(&run, &format!("{command} --out {out}")), "choose another");
            assert!(before == snapshot(&run.path("mine")), "{command}");
        }
    }
    run.assert_nothing_left();
}

#[test]
fn a_path_that_is_no_folder_is_refused_with_the_cause_and_unchanged() {
    let run = Run::new();
    run.write("uwb.csv", RECORDING);
    run.write("file", "mine");
    symlink("nowhere", run.path("link")).unwrap();
    for (out, cause) in [
        ("file", "it is not a folder"),
        ("/dev/null", "it is not a folder"),
        ("link", "it is a link to nothing"),
        ("file/below", "Not a directory"),
    ] {
        for command in [format!("track uwb.csv {TRACK}"), "run --ticks 5 --in-process".to_owned()] {
            assert_refused(&start(&run, &format!("{command} --out {out}")), cause);
        }
    }
    assert_eq!(std::fs::read_to_string(run.path("file")).unwrap(), "mine");
    assert!(run.path("link").is_symlink() && !run.path("nowhere").exists());
}

#[test]
fn an_input_that_lies_where_results_would_go_is_refused_under_every_name() {
    let run = Run::new();
    start(&run, "run --in-process --ticks 50 --write-recording --no-record --out d").succeeded();
    symlink("d", run.path("link")).unwrap();
    symlink("d/ranges.csv", run.path("symlink.csv")).unwrap();
    std::fs::hard_link(run.path("d/ranges.csv"), run.path("hard.csv")).unwrap();
    std::fs::hard_link(run.path("d/truth.csv"), run.path("truth.csv")).unwrap();
    std::fs::copy(run.path("d/ranges.csv"), run.path("copy.csv")).unwrap();
    let before = snapshot(&run.path("d"));
    let absolute = run.path("d/ranges.csv").display().to_string();
    for ranges in ["d/ranges.csv", "./d/../d/ranges.csv", "link/ranges.csv", "symlink.csv", "hard.csv", &absolute] {
        for out in ["d", "link"] {
            assert_refused(&start(&run, &format!("track {ranges} {TRACK} --out {out}")), "is read, and lies where");
        }
    }
    for words in [
        format!("track copy.csv {TRACK} --truth d/truth.csv"),
        format!("track copy.csv {TRACK} --truth truth.csv"),
        "run d/scenario.toml --in-process".to_owned(),
        "compare d/scenario.toml --runs 1 --ticks 5".to_owned(),
    ] {
        assert_refused(&start(&run, &format!("{words} --out d")), "is read, and lies where");
    }
    assert!(before == snapshot(&run.path("d")));
    // With the inputs elsewhere, rangehound may use the folder again.
    start(&run, &format!("track copy.csv {TRACK} --out d")).succeeded();
    assert!(!run.path("d/ranges.csv").exists() && run.path("hard.csv").exists());
}

#[test]
fn in_a_folder_of_rangehounds_own_only_what_it_wrote_is_replaced() {
    let run = Run::new();
    let again = "run --in-process --ticks 20 --write-recording --out out";
    start(&run, again).succeeded();
    // Files without a result's name do not prevent a run.
    run.write("out/notes.txt", "mine");
    run.write("out/logs/mine.log", "mine");
    start(&run, again).succeeded();
    for file in ["out/notes.txt", "out/logs/mine.log"] {
        assert_eq!(std::fs::read_to_string(run.path(file)).unwrap(), "mine");
    }
    for file in ["truth.csv", "scenario.toml", "run.mcap", "world.ticks", "logs/sim.log", "report.json.1.partial"] {
        let file = format!("out/{file}");
        let was = std::fs::read(run.path(&file)).ok();
        // In its place, and on top of it.
        for is_removed in [true, false] {
            if is_removed {
                let _ = std::fs::remove_file(run.path(&file));
            }
            run.write(&file, "mine");
            assert_refused(&start(&run, again), "is not as rangehound wrote it");
            assert_eq!(std::fs::read_to_string(run.path(&file)).unwrap(), "mine");
        }
        std::fs::remove_file(run.path(&file)).unwrap();
        assert!(was.is_some() || file.contains("logs/") || file.contains("partial"), "{file}");
    }
    start(&run, again).succeeded();
}

#[test]
fn manual_pages_replace_pages_and_nothing_else() {
    let run = Run::new();
    start(&run, "man pages").succeeded();
    start(&run, "man pages").succeeded();
    run.write("pages/rangehound-run.1", "mine");
    assert_refused(&start(&run, "man pages"), "rangehound-run.1");
    assert_eq!(std::fs::read_to_string(run.path("pages/rangehound-run.1")).unwrap(), "mine");
}

#[test]
fn a_recording_replaces_no_file_but_one_with_fewer_ticks_of_the_same_run() {
    let run = Run::new();
    start(&run, "run --in-process --ticks 300 --out out").succeeded();
    start(&run, "run --in-process --ticks 20 --seed 2 --out other").succeeded();
    let intact = std::fs::read(run.path("out/run.mcap")).unwrap();
    run.write("mine.mcap", "mine");
    run.write("begun.mcap.partial", "mine");
    for (folder, out, kept) in [
        ("out", "mine.mcap", "mine.mcap"),
        ("out", "begun.mcap", "begun.mcap.partial"),
        ("other", "out/run.mcap", "out/run.mcap"),
        ("out", "out/world.ticks", "out/world.ticks"),
    ] {
        let before = std::fs::read(run.path(kept)).unwrap();
        assert_refused(&start(&run, &format!("record {folder} --out {out}")), "no recording of this run");
        assert!(before == std::fs::read(run.path(kept)).unwrap(), "{kept}");
    }
    for log in ["estimate.ticks", "world.ticks"] {
        let log = std::fs::File::options().write(true).open(run.path("out").join(log)).unwrap();
        log.set_len(log.metadata().unwrap().len() / 40).unwrap();
    }
    assert_refused(&start(&run, "record out"), "holds 301 ticks of the run");
    assert!(intact == std::fs::read(run.path("out/run.mcap")).unwrap());
    assert!(!run.path("out/run.mcap.partial").exists());
    // The input of a repair is protected too.
    run.write("intact.mcap.partial", &intact[..intact.len() / 2]);
    start(&run, "replay intact.mcap.partial --repair").succeeded();
    assert!(run.path("intact.mcap.partial").exists() && run.path("intact.mcap").exists());
    assert_refused(&start(&run, "replay intact.mcap --repair --out mine.mcap"), "expected a name that is free");
}

#[test]
fn a_run_without_states_is_not_resumed_and_stays_as_it_is() {
    let run = Run::new();
    let made = start(&run, "run --in-process --ticks 30 --clock realtime --out out").succeeded();
    assert!(made.stdout.contains("  in one process   30 ticks in ") && !made.stdout.contains("realtime"), "{made:#?}");
    let before = snapshot(&run.path("out"));
    assert_refused(&start(&run, &format!("resume out --name {}", run.name)), "sim.checkpoint is missing");
    assert!(before == snapshot(&run.path("out")));
    run.assert_nothing_left();
}

#[test]
fn a_run_that_goes_on_keeps_its_recording() {
    let run = Run::new();
    let supervisor = run.command("run --record --clock realtime --ticks 40");
    run.wait_for_ticks(5);
    assert_refused(&start(&run, "record out"), "over");
    assert_refused(&start(&run, &format!("record --name {}", run.name)), "another process is writing ");
    supervisor.finish().succeeded();
    let replayed = start(&run, "replay out/run.mcap --json").succeeded();
    let json: Value = serde_json::from_str(&replayed.stdout).unwrap();
    assert_eq!(json["ticks"], 40);
    run.assert_nothing_left();
}

#[test]
fn runs_that_start_at_once_take_the_next_number() {
    let run = Run::new();
    run.write("mine.toml", format!("name = \"{}\"\nclock = \"lockstep\"\nticks = 5\n", run.name));
    let words = ["run", "mine.toml", "--no-record"];
    let all: Vec<_> = (0..6).map(|_| run.start(&words)).collect();
    all.into_iter().for_each(|process| drop(process.finish().succeeded()));
    assert_eq!(std::fs::read_dir(run.path("runs")).unwrap().count(), 6);
    // They have their own folders, and no name.
    let outs: Vec<String> = (0..4).map(|number| format!("out{number}")).collect();
    let all: Vec<_> = outs.iter().map(|out| run.start(&[&words[..], &["--out", out]].concat())).collect();
    all.into_iter().for_each(|process| drop(process.finish().succeeded()));
}

/// As when the terminal is closed.
#[test]
fn a_hangup_ends_a_run_with_its_report_unless_it_is_ignored() {
    for ignored in [false, true] {
        let run = Run::new();
        let words = "run --clock realtime --ticks 60";
        let supervisor = if ignored { run.command_by("trap '' HUP; exec \"$@\"", words) } else { run.command(words) };
        run.wait_for_ticks(10);
        supervisor.signal(Signal::HUP);
        let outcome = supervisor.finish();
        let ticks = run.report()["ticks"].as_u64().unwrap();
        assert_eq!((ticks == 60, outcome.code == Some(0)), (ignored, ignored), "{outcome:#?}");
        assert!(outcome.stdout.contains("digest"), "{outcome:#?}");
        run.assert_nothing_left();
    }
}

#[test]
fn a_joining_simulator_with_other_flags_is_refused_by_flag() {
    let run = Run::new();
    let first = run.node("sim --out out --seed 7");
    run.wait_until("the run is created", || run.path("out/scenario.toml").exists() && first.has_joined());
    for (flag, expected) in [
        ("--seed 99", "--seed differs from run"),
        ("--ticks 3", "--ticks differs from run"),
        ("--robots 9", "--robots differs from run"),
        ("--planner greedy", "--planner differs from run"),
        ("--out other", "--out differs from run"),
    ] {
        assert_refused(&run.node(&format!("sim {flag}")).finish(), expected);
    }
    // A simulator with equal settings tries to take the role, which is not free.
    let same = run.node("sim --out out --seed 7").finish();
    assert!(same.stderr.contains("taking the simulator's place"), "{same:#?}");
    assert!(!run.path("other").exists());
    first.signal(Signal::TERM);
    first.finish().succeeded();
    run.assert_nothing_left();
}

#[test]
fn tables_hold_plain_decimals() {
    let run = Run::new();
    run.write("uwb.csv", RECORDING);
    start(&run, &format!("track uwb.csv {TRACK} --accel-psd 1e-12 --out out")).succeeded();
    let table = run.read("estimate.csv");
    assert!(table.contains("0.00000012,"), "{table}");
    assert!(!table.lines().skip(1).any(|row| row.contains(['e', 'E'])), "{table}");
}

#[test]
fn a_latency_measurement_of_one_tick_comes_to_its_end() {
    let run = Run::new();
    for _ in 0..5 {
        start(&run, &format!("latency --ticks 1 --rounds 1 --out out --name {}", run.name)).succeeded();
    }
    run.assert_nothing_left();
}
