//! Printed output: in 80 columns and without escapes if there is no terminal, as JSON for scripts; completions and manual
//! pages of the commands.

use std::time::{Duration, Instant};

use rangehound::cli;
use rustix::process::Signal;
use serde_json::Value;

use crate::results::run_mcap::recorder;
use crate::support::{Outcome, Run, signal};

const WIDTH: usize = 80;

/// Keys of the report that other programs use.
const CONTRACT: [&str; 17] = [
    "scenario",
    "seed",
    "clock",
    "planner",
    "robots",
    "ticks",
    "wall_s",
    "ticks_per_s",
    "digest",
    "position_rmse_m",
    "anees",
    "nis_mean",
    "position_trace_m2",
    "ranges",
    "latency_us",
    "nodes",
    "hops_us",
];

const SHELLS: [&str; 5] = ["bash", "zsh", "fish", "elvish", "powershell"];

/// Fails if a line is too wide; paths may be of any length.
#[track_caller]
fn assert_plain_and_narrow(text: &str) {
    assert!(!text.contains('\u{1b}'), "{text:?}");
    for line in text.lines().filter(|line| !line.contains("run folder")) {
        assert!(line.chars().count() <= WIDTH, "{line}");
        assert_eq!(line, line.trim_end());
    }
}

/// The only line of standard output.
#[track_caller]
fn json(outcome: &Outcome) -> Value {
    assert_eq!(outcome.stdout.lines().count(), 1, "{outcome:#?}");
    serde_json::from_str(&outcome.stdout).unwrap()
}

#[track_caller]
fn assert_report(report: &Value) {
    for key in CONTRACT {
        assert!(report.get(key).is_some(), "{key}: {report}");
    }
}

/// Every visible command.
fn commands() -> Vec<String> {
    let command = cli::command();
    let visible = command.get_subcommands().filter(|command| !command.is_hide_set());
    visible.map(|command| command.get_name().to_owned()).collect()
}

/// One run through its life: observed, killed, stopped, resumed, watched.
#[test]
fn a_run_reports_in_lines_that_fit_and_as_json() {
    let run = Run::new();
    let supervisor = run.command("run --clock realtime --ticks 50");
    run.wait_for_ticks(5);
    let watched = run.node("status --watch");
    assert_plain_and_narrow(&run.node("status").finish().succeeded().stdout);
    let status = json(&run.node("status --json").finish().succeeded());
    assert_eq!(status["nodes"].as_array().map(Vec::len), Some(6), "{status}");
    assert_eq!(status["phase"], "running", "{status}");
    let killed = json(&run.node("kill robot-1 --json").finish().succeeded());
    assert_eq!((&killed["node"], &killed["pid"]), (&status["nodes"][3]["name"], &status["nodes"][3]["pid"]));
    run.pid_of("robot-1", 2);
    let restarted = json(&run.node("restart robot-2 --json").finish().succeeded());
    assert_eq!((restarted["node"].as_str(), restarted["starts"].as_u64()), (Some("robot-2"), Some(2)));
    let names = |of| run.start(&["names", of]).finish().succeeded().stdout;
    assert!(names("runs").lines().any(|name| name == run.name), "{}", names("runs"));
    assert!(["sim", "fusion", "robot-2"].iter().all(|node| names("nodes").lines().any(|name| name == *node)));
    let stopped = json(&run.node("stop --json").finish().succeeded());
    assert_eq!(stopped["name"], run.name.as_str());
    let reported = supervisor.finish().stdout;
    // The path as the user would type it.
    assert!(reported.ends_with("  run folder       out\n"), "{reported}");
    // The simulator has not logged the tick in progress, but the ranges that fusion has count as published.
    let ranges = &run.report()["ranges"];
    assert!(ranges["published"].as_u64() >= Some(ranges["fused"].as_u64().unwrap()), "{ranges}");
    assert!(reported.contains("hops, us p50") && reported.contains("robot-1          2 starts, 1 kill,"), "{reported}");
    assert_plain_and_narrow(&reported);
    let watched = watched.finish().succeeded().stdout;
    assert_plain_and_narrow(&watched);
    assert!(watched.ends_with(&format!("run {} has ended\n", run.name)), "{watched}");

    let resumed = run.node("resume out --json");
    let watch = json(&run.node("watch --json").finish().succeeded());
    let resumed = resumed.finish().succeeded();
    assert_eq!(json(&resumed)["digest"], watch["digest"]);
    assert!(resumed.stderr.contains("tick "), "{resumed:#?}");
    assert_report(&json(&resumed));
    assert_report(&watch);
    run.assert_nothing_left();
}

#[test]
fn json_is_what_the_file_holds_and_nothing_else() {
    let run = Run::new();
    let printed = run.command("run --in-process --ticks 20 --write-recording --json").finish().succeeded();
    assert_eq!(json(&printed), run.report());
    assert_report(&json(&printed));
    let tracked = Run::new();
    tracked.write("ranges.csv", run.read("ranges.csv"));
    let printed = tracked.command("track ranges.csv --range-std 1 --in-process --json").finish().succeeded();
    assert_eq!(json(&printed), tracked.report());
    assert_report(&json(&printed));
    let file = |run: &Run, name: &str| -> Value { serde_json::from_str(&run.read(name)).unwrap() };
    let compared = Run::new();
    let words = "compare --runs 2 --ticks 5 --planners random,greedy --out out --json";
    let printed = compared.start(&words.split(' ').collect::<Vec<_>>()).finish().succeeded();
    assert_eq!(json(&printed), file(&compared, "compare.json"));
    let measured = Run::new();
    let printed = measured.command("latency --rounds 1 --ticks 100 --json").finish().succeeded();
    assert_eq!(json(&printed), file(&measured, "latency.json"));
    measured.assert_nothing_left();
    let faulted = Run::new();
    let printed = faulted.command("chaos --faults 1 --kinds kill --ticks 2000 --json").finish().succeeded();
    assert_eq!(json(&printed), file(&faulted, "chaos.json"));
    faulted.assert_nothing_left();
}

/// A supervisor that waits for its recorder for any time is not hung.
#[test]
fn a_complete_run_is_finishing_while_its_results_are_written() {
    let run = Run::new();
    let supervisor = run.lockstep("--record --ticks 8000");
    let recorder = recorder(&run, None);
    signal(recorder, Signal::STOP);
    run.wait_until("the run is over", || run.shared_folder().join("finished").exists());
    let began = Instant::now();
    run.wait_until("the supervisor has waited for longer than a hang takes", || {
        let waited = began.elapsed();
        let status = json(&run.node("status --json").finish().succeeded());
        let supervisor_is = status["nodes"].as_array().and_then(|nodes| nodes.last()).unwrap();
        assert_eq!((&status["phase"], &supervisor_is["state"]), (&"finishing".into(), &"running".into()), "{status}");
        waited > Duration::from_millis(1_500)
    });
    let shown = run.node("status").finish().succeeded().stdout;
    assert!(shown.contains("finishing") && !shown.contains("gone") && !shown.contains("nobody leads"), "{shown}");
    signal(recorder, Signal::CONT);
    supervisor.finish().succeeded();
    assert!(run.path("out/run.mcap").exists());
    run.assert_nothing_left();
}

#[test]
fn tables_fit() {
    let run = Run::new();
    let words = "compare --runs 3 --ticks 10 --out out";
    assert_plain_and_narrow(&run.start(&words.split(' ').collect::<Vec<_>>()).finish().succeeded().stdout);
    let sensors = "[sensor.radio]\nrange_std_m = 1.0\n[sensor.camera]\nbearing_std_rad = 0.1\n";
    run.write("mine.toml", format!("{sensors}[robots]\nsensor = \"radio\"\n"));
    let words = "compare mine.toml --sensors radio,camera --planners certified,adaptive --runs 2 --ticks 5 --out mixed";
    let mixed = run.start(&words.split(' ').collect::<Vec<_>>()).finish().succeeded().stdout;
    assert_plain_and_narrow(&mixed);
    // The rows are as long as the heads of their columns, however long the names.
    let lines: Vec<&str> = mixed.lines().collect();
    let row = lines.iter().position(|line| line.starts_with("certified camera ")).unwrap();
    let widths: Vec<usize> = lines[row - 2..row + 3].iter().map(|line| line.chars().count()).collect();
    assert_eq!(widths, [widths[0]; 5], "{mixed}");
    assert!(mixed.contains("criterion above its bound"), "{mixed}");
    assert_plain_and_narrow(&run.command("latency --rounds 2 --ticks 100").finish().succeeded().stdout);
    run.assert_nothing_left();
}

/// Colour is requested explicitly, because there is no terminal.
#[test]
fn colours_are_switched_off() {
    const COLOURED: &str = "CLICOLOR_FORCE=1 TERM=xterm";
    let has_escapes = |variables: &str, words: &str| {
        let run = Run::new();
        let outcome = run.command_by(&format!("{variables} exec \"$@\""), words).finish();
        (outcome.stdout + &outcome.stderr).contains('\u{1b}')
    };
    for words in ["run --in-process --ticks 5", "run --help", "run --ticks 0"] {
        assert!(has_escapes(COLOURED, words), "{words}");
        for variables in ["TERM=xterm", "CLICOLOR_FORCE=1 TERM=dumb", &format!("{COLOURED} NO_COLOR=1")] {
            assert!(!has_escapes(variables, words), "{variables} {words}");
        }
    }
    // An empty value does not disable colour.
    assert!(has_escapes(&format!("{COLOURED} NO_COLOR="), "run --help"));
    // JSON has no colour, even on request.
    assert!(!has_escapes(COLOURED, "run --in-process --ticks 5 --json"));
}

#[test]
fn every_command_has_help_that_fits_with_examples() {
    let run = Run::new();
    let top = run.start(&["--help"]).finish().succeeded().stdout;
    for command in commands() {
        assert!(top.contains(&format!("\n  {command} ")), "{command}");
        let help = run.start(&[&command, "--help"]).finish().succeeded().stdout;
        assert!(help.contains("\nExample"), "{command}: {help}");
        assert!(!help.contains("Exit codes"), "{command}: the tool's own help has them");
        let short = run.start(&[&command, "-h"]).finish().succeeded().stdout;
        for line in [&top, &help, &short].iter().flat_map(|text| text.lines()) {
            assert!(line.chars().count() <= WIDTH, "{command}: {line}");
        }
    }
    assert!(top.contains("Exit codes: 0 done") && !top.contains("latency-node"), "{top}");
}

#[test]
fn shells_complete_every_command_and_nothing_hidden() {
    let run = Run::new();
    for shell in SHELLS {
        let script = run.start(&["completions", shell]).finish().succeeded().stdout;
        for command in commands() {
            assert!(script.contains(&command), "{shell}: {command}");
        }
        for hidden in ["latency-node", "latency__node", "end-with"] {
            assert!(!script.contains(hidden), "{shell}: {hidden}");
        }
        assert!(["elvish", "powershell"].contains(&shell) || script.contains("names"), "{shell}");
        assert!(script.contains("--write-recording") || script.contains("write-recording"), "{shell}");
        // PowerShell and elvish do not get values.
        assert!(["elvish", "powershell"].contains(&shell) || script.contains("greedy"), "{shell}");
    }
}

#[test]
fn every_command_has_a_manual_page() {
    let run = Run::new();
    let page = run.start(&["man"]).finish().succeeded().stdout;
    assert!(page.contains(".TH rangehound 1") && !page.contains("latency\\-node"), "{page}");
    run.start(&["man", "pages"]).finish().succeeded();
    let mut expected: Vec<String> = commands().iter().map(|command| format!("rangehound-{command}.1")).collect();
    expected.push("rangehound.1".to_owned());
    expected.sort();
    let entries = std::fs::read_dir(run.path("pages")).unwrap().flatten();
    let mut found: Vec<String> = entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    found.sort();
    assert_eq!(found, expected);
    for page in found {
        let page = std::fs::read_to_string(run.path("pages").join(page)).unwrap();
        assert!(page.contains(".SH EXAMPLES") && !page.contains("end\\-with"), "{page}");
    }
    run.write("a-file", "");
    let refused = run.start(&["man", "a-file"]).finish();
    assert_eq!((refused.code, refused.complaints().len()), (Some(2), 1), "{refused:#?}");
    assert!(
        refused.stderr.contains("(DIR): ")
            && refused.stderr.contains("expected a folder")
            && !refused.stderr.contains("--out"),
        "{refused:#?}"
    );
}
