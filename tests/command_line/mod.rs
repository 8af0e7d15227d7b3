//! The command line: every mistake is reported in one line, before any file is created.

mod file_safety;
pub(crate) mod hostile;
mod terminal;

use crate::support::{Outcome, Run};

/// The contents of a folder, except the captured output.
fn listing(run: &Run) -> Vec<String> {
    let entries = std::fs::read_dir(run.path("")).unwrap().flatten();
    let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
    let mut names: Vec<String> = names.filter(|name| !name.starts_with('.')).collect();
    names.sort();
    names
}

/// The fault of a refusal, if any. A refusal has exit code 2 and one line that contains all of
/// `names` and the expected value, and no file is created.
fn fault(run: &Run, before: &[String], outcome: &Outcome, names: &[&str]) -> Option<String> {
    let Outcome { code, stdout, stderr } = outcome;
    let has_word = |word: &str| stderr.split(|c: char| !c.is_ascii_alphabetic()).any(|found| found == word);
    let faults = [
        (*code != Some(2), "exit code"),
        (!stdout.is_empty(), "standard output"),
        (stderr.lines().count() != 1, "not one line"),
        (!names.iter().all(|name| stderr.contains(name)), "not named"),
        (!has_word("expected"), "does not name the expected value"),
        (listing(run) != before, "made files"),
        (run.shared_folder().exists(), "made shared memory"),
    ];
    let found: Vec<&str> = faults.iter().filter(|(faulty, _)| *faulty).map(|(_, what)| *what).collect();
    (!found.is_empty()).then(|| format!("{}: {outcome:?}", found.join(", ")))
}

/// Fails with all faults of a table of cases.
fn assert_none(faults: Vec<String>) {
    assert!(faults.is_empty(), "{} cases:\n{}", faults.len(), faults.join("\n"));
}

/// Runs `COMMAND FILE` for each of (file's bytes, what the line must name).
fn refused_files(command: &str, file: &str, cases: &[(&[u8], &str)]) {
    let faults = cases.iter().filter_map(|(bytes, name)| {
        let run = Run::new();
        run.write(file, bytes);
        let outcome = run.command(&format!("{command} {file}")).finish();
        let text = String::from_utf8_lossy(bytes);
        fault(&run, &[file.to_owned()], &outcome, &[file, name]).map(|fault| format!("{text:?}: {fault}"))
    });
    assert_none(faults.collect());
}

#[test]
fn scenario_files_that_cannot_be_read_are_refused_by_place() {
    refused_files(
        "run",
        "bad.toml",
        &[
            (b"ticks = 3\nbogus = 1\n", "bad.toml:2, key bogus"),
            (b"[target]\nspeed = 1\n", "bad.toml:2, key target.speed"),
            (b"[[robot]]\ncolour = 1\n", "colour"),
            (b"ticks = \"many\"\n", "bad.toml:1, key ticks"),
            (b"ticks = 1.5\n", "bad.toml:1, key ticks"),
            (b"ticks = -1\n", "bad.toml:1, key ticks"),
            (b"seed = 99999999999999999999999\n", "bad.toml:1, key seed"),
            (b"name = \"a\"\nticks =\n", "bad.toml:2"),
            (b"ticks = 1\nticks = 2\n", "bad.toml:2"),
            (b"[target\n", "bad.toml:1"),
            (b"[target]\nstart = 3\n", "target.start"),
            (b"[robots]\nstart_m = [1.0]\n", "robots.start_m"),
            (b"[prior]\ncovariance = \"big\"\n", "prior.covariance"),
            (b"[prior]\nmean = 3\n", "prior.mean"),
            (b"timeout_s = true\n", "timeout_s"),
            (b"name = \"\xff\"\n", "bad.toml"),
        ],
    );
}

#[test]
fn values_that_make_no_sense_are_refused_by_key() {
    refused_files(
        "run",
        "bad.toml",
        &[
            (b"dt_s = nan\n", "dt_s"),
            (b"dt_s = inf\n", "dt_s"),
            (b"dt_s = 0.0\n", "dt_s"),
            (b"dt_s = 1e300\n", "dt_s"),
            (b"ticks = 0\n", "ticks"),
            (b"ticks = 1000000001\n", "ticks"),
            (b"name = \"a b\"\n", "name"),
            (b"clock = \"sundial\"\n", "clock"),
            (b"timeout_s = 0.0\n", "timeout_s"),
            (b"timeout_s = \"long\"\n", "timeout_s"),
            (b"[target]\nnoise_psd = -1.0\n", "target.noise_psd"),
            (b"[target]\nnoise_psd = inf\n", "target.noise_psd"),
            (b"[target]\nmodel = \"drunk\"\n", "target.model"),
            (b"[target]\nstart = [0.0, 0.0, 1.0]\n", "target.start"),
            (b"[target]\nstart = [0.0, 0.0, nan, 0.0]\n", "target.start"),
            (b"[target]\nphi = [[1.0]]\n", "target.phi"),
            (b"[prior]\ncovariance = -1.0\n", "prior.covariance"),
            (b"[prior]\ncovariance = [1.0, 1.0]\n", "prior.covariance"),
            (b"[prior]\nmean = \"guess\"\n", "prior.mean"),
            (b"[prior]\nmean = [0.0]\n", "prior.mean"),
            (b"[robots]\ncount = 0\n", "robots.count"),
            (b"[robots]\ncount = 1025\n", "robots.count"),
            (b"[robots]\nspeed_mps = -1.0\n", "robots.speed_mps"),
            (b"[robots]\nrange_std_m = -1.0\n", "robots.range_std_m"),
            (b"[robots]\nrange_std_m = 0.0\n", "robots.range_std_m"),
            (b"[robots]\nstart_m = [1e300, 0.0]\n", "robots.start_m"),
            (b"robot = []\n", "robot"),
            (b"[robots]\ncount = 2\n[[robot]]\nid = 0\n", "robots"),
            (b"[[robot]]\nid = 1\n[[robot]]\nid = 1\n", "robot[1].id"),
            (b"[[robot]]\nid = 7\n", "robot[0].id"),
            (b"[[robot]]\nrange_std_m = nan\n", "robot[0].range_std_m"),
            (b"[planner]\nname = \"luck\"\n", "planner.name"),
            (b"[planner]\nalpha = 2.0\n", "planner.alpha"),
            (b"[planner]\niterations = 0\n", "planner.iterations"),
            (b"[planner]\nname = \"grid\"\n[robots]\ncount = 5\n", "3.200e11"),
            (b"[filter]\ngate_sigma = 0.0\n", "filter.gate_sigma"),
            (b"[recording]\nrange_std_m = 1.0\n", "recording.ranges"),
        ],
    );
}

#[test]
fn matrices_that_make_no_sense_are_refused_by_key() {
    const CUSTOM: &str = "[target]\nmodel = \"custom\"\nstart = [0.0, 0.0]\n";
    let custom = |rest: &str| format!("{CUSTOM}{rest}\n").into_bytes();
    let prior = |rows: &str| format!("[target]\nmodel = \"random_walk\"\n[prior]\ncovariance = {rows}\n").into_bytes();
    let files = [
        (prior("[[1.0, 0.5], [0.0, 1.0]]"), "prior.covariance"),
        (prior("[[1.0, 2.0], [2.0, 1.0]]"), "prior.covariance"),
        (prior("[[1.0, 1.0], [1.0, 1.0]]"), "prior.covariance"),
        (prior("[[1.0, 0.0], [0.0]]"), "prior.covariance"),
        (prior("[[1.0, 0.0], [0.0, inf]]"), "prior.covariance"),
        (custom("qd = [[1.0]]"), "target.phi"),
        (custom("phi = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]\nqd = [[1.0]]"), "target.phi"),
        (custom("phi = [[1.0, 0.0], [0.0, nan]]\nqd = [[1.0]]"), "target.phi"),
        (custom("phi = [[1.0, 0.0], [0.0, 1.0]]"), "target.qd"),
        (custom("phi = [[1.0, 0.0], [0.0, 1.0]]\nqd = [[1.0, 2.0], [2.0, 1.0]]"), "target.qd"),
        (custom("phi = [[1.0, 0.0], [0.0, 1.0]]\nqd = [[1.0, 0.0], [0.0, 1.0]]\ng = [[1.0], [1.0]]"), "target.g"),
        (custom("phi = [[1.0, 0.0], [0.0, 1.0]]\nqd = [[1.0]]\nnoise_psd = 1.0"), "target.noise_psd"),
    ];
    let cases: Vec<(&[u8], &str)> = files.iter().map(|(bytes, key)| (bytes.as_slice(), *key)).collect();
    refused_files("run", "bad.toml", &cases);
}

#[test]
fn recordings_that_make_no_sense_are_refused_by_row() {
    const HEADER: &str = "time_s,sensor_id,sensor_x_m,sensor_y_m,range_m\n";
    // One bad row is skipped; if most rows are bad, the file is refused.
    let mostly = |row: &str| format!("{HEADER}{row}\n{row}\n0.2,1,0,0,5\n").into_bytes();
    let files = [
        (Vec::new(), "bad.csv is empty: expected a header"),
        (HEADER.into(), "row 0"),
        (b"time_s,sensor_id,sensor_x_m,sensor_y_m\n0,1,0,0\n".to_vec(), "range_m"),
        (b"0.0,1,0,0,5\n0.0,2,9,0,5\n".to_vec(), "row 0"),
        (mostly("0.1,2,9,0,far"), "range_m is \"far\" in row 1 (line 2)"),
        (mostly("0.1,2,9,0,NaN"), "range_m is \"NaN\" in row 1 (line 2)"),
        (mostly("0.1,2,9,0,inf"), "range_m is \"inf\" in row 1 (line 2)"),
        (mostly("0.1,2,9,0,-1"), "range_m is \"-1\" in row 1 (line 2)"),
        (mostly("0.1,2,9,0"), "range_m is missing, the row has 4 fields, in row 1 (line 2)"),
        (mostly("0.1,2,,0,5"), "sensor_x_m is \"\" in row 1 (line 2)"),
        (mostly("0.1,,9,0,5"), "sensor_id is \"\" in row 1 (line 2)"),
        (mostly("nan,2,9,0,5"), "time_s is \"nan\" in row 1 (line 2)"),
        (mostly("0.1,2,\u{fffd},0,5"), "sensor_x_m is \"\u{fffd}\" in row 1 (line 2)"),
        (
            mostly("0.1,2,9,0,2,957"),
            "6 fields long in bad.csv, row 1 (line 2): expected 5 fields as in the header; probably decimal commas",
        ),
        (format!("{HEADER}0.1,2,9,0,5\n0.05,1,0,0,5\n").into_bytes(), "time_s is \"0.05\" in bad.csv, row 2 (line 3)"),
        ([HEADER.as_bytes(), b"0.1,2,\xff,0,5\n"].concat(), "row 1"),
    ];
    let cases: Vec<(&[u8], &str)> = files.iter().map(|(bytes, place)| (bytes.as_slice(), *place)).collect();
    refused_files("track", "bad.csv", &cases);
}

/// Runs each of (arguments, what the line must name) in a folder with a valid recording.
fn refused_usage(cases: &[(&str, &[&str])]) {
    let faults = cases.iter().filter_map(|(words, names)| {
        let run = Run::new();
        run.write("good.csv", "time_s,sensor_id,sensor_x_m,sensor_y_m,range_m\n0,1,0,0,5\n0,2,9,0,5\n");
        std::fs::create_dir(run.path("folder")).unwrap();
        let args: Vec<&str> = words.split_whitespace().collect();
        let outcome = run.start(&args).finish();
        fault(&run, &["folder".to_owned(), "good.csv".to_owned()], &outcome, names)
            .map(|fault| format!("{words}: {fault}"))
    });
    assert_none(faults.collect());
}

#[test]
fn files_that_are_not_there_are_refused_by_name() {
    refused_usage(&[
        ("run missing.toml", &["missing.toml"]),
        ("run folder", &["folder"]),
        ("sim missing.toml", &["missing.toml"]),
        ("track missing.csv", &["missing.csv"]),
        ("track folder", &["folder"]),
        ("track good.csv --truth missing.csv", &["missing.csv"]),
    ]);
}

#[test]
fn values_on_the_command_line_are_refused_by_flag() {
    refused_usage(&[
        ("run --robots 0", &["--robots is 0: "]),
        ("run --robots 1025", &["--robots is 1025: "]),
        ("run --robots many", &["--robots"]),
        ("run --ticks 0", &["--ticks is 0: "]),
        ("run --ticks -1", &["--ticks"]),
        ("run --ticks=-1", &["--ticks"]),
        ("run --seed 1.5", &["--seed"]),
        ("run --clock sundial", &["--clock"]),
        ("run --planner luck", &["--planner is \"luck\": "]),
        ("run --stand-off -1", &["--stand-off is -1: "]),
        ("run --planner grid --robots 5", &["3.200e11"]),
        ("run --timeout 0", &["--timeout is 0: "]),
        ("run --timeout -1", &["--timeout is -1: "]),
        ("run --timeout=-1", &["--timeout is -1: "]),
        ("run --timeout abc", &["--timeout"]),
        ("run --timeout nan", &["--timeout is NaN: "]),
        ("run --name a/b", &["--name"]),
        ("run --name a-name-of-25-letters-long", &["--name"]),
        ("run --name=", &["--name"]),
        ("track good.csv --range-std -1", &["--range-std is -1: "]),
        ("track good.csv --range-std far", &["--range-std"]),
        ("track good.csv --accel-psd nan", &["--accel-psd is NaN: "]),
        ("track good.csv --pose-std -1", &["--pose-std is -1: "]),
        ("track good.csv --bias-std -1", &["--bias-std is -1: "]),
        ("track good.csv --heading-std 4", &["--heading-std is 4: "]),
        ("track good.csv --target-height 2", &["--target-height is given"]),
        ("track good.csv --columns range=dist:s", &["--columns is "]),
        ("track good.csv --range-bias x", &["--range-bias"]),
        ("track good.csv --range-bias 3=0.1", &["sensor"]),
        ("track good.csv --range-scale -1", &["--range-scale is -1: "]),
        ("track good.csv --gate 0", &["--gate is 0: "]),
        ("robot --id x", &["--id"]),
    ]);
}

#[test]
fn comparisons_that_make_no_sense_are_refused() {
    refused_usage(&[
        ("compare missing.toml", &["missing.toml"]),
        ("compare --scenario missing.toml", &["missing.toml"]),
        ("compare --planners certified,luck", &["--planners", "luck", "adaptive"]),
        ("compare --planners random,random", &["--planners", "random twice"]),
        ("compare --planners=", &["--planners"]),
        ("compare --planners grid --robots 5", &["3.200e11"]),
        ("compare --runs 0", &["--runs"]),
        ("compare --runs 1000000000000", &["--runs"]),
        ("compare --runs -1", &["--runs"]),
        ("compare --ticks 0", &["--ticks is 0: "]),
        ("compare --seed 18446744073709551615", &["--seed"]),
        ("compare --robots 0", &["--robots is 0: "]),
        ("compare --sensors radio", &["--sensors has \"radio\": ", "[sensor.NAME]", "paper.toml"]),
        ("compare --threads 0", &["--threads"]),
        ("compare --stand-off -1", &["--stand-off is -1: "]),
        ("compare --stand-off nan", &["--stand-off is NaN: "]),
        ("compare --stand-off near", &["--stand-off"]),
        ("compare --runs 1 --out good.csv/out", &["--out", "good.csv/out"]),
    ]);
}

/// Runs a command that must be refused because of a scenario file with this text: the line must name `names`.
#[track_caller]
fn refused_with(text: &str, words: &str, names: &[&str]) {
    let run = Run::new();
    run.write("mine.toml", text);
    let args: Vec<&str> = words.split_whitespace().collect();
    let outcome = run.start(&args).finish();
    assert_eq!(fault(&run, &["mine.toml".to_owned()], &outcome, names), None, "{words}");
}

#[test]
fn a_sensor_that_the_scenario_lacks_is_refused_with_those_that_it_has() {
    let text = "[sensor.radio]\nrange_std_m = 1.0\n[sensor.camera]\nbearing_std_rad = 0.1\n";
    refused_with(
        text,
        "compare mine.toml --sensors radio,sonar",
        &["--sensors has \"sonar\"", "camera, radio", "mine.toml"],
    );
}

/// `compare` has these names for the scenario's own equipment, and for poses without errors.
#[test]
fn a_sensor_or_localiser_with_a_name_that_compare_uses_is_refused() {
    for table in
        ["[sensor.own]\nrange_std_m = 1.0\n", "[localiser.own]\nstd_m = 1.0\n", "[localiser.exact]\nstd_m = 1.0\n"]
    {
        let name = table.lines().next().unwrap();
        refused_with(table, "run mine.toml --in-process", &[name, "expected another name", "mine.toml"]);
    }
}

/// The grid search serves the paper's sensors only.
#[test]
fn the_grid_search_is_refused_for_other_sensors_and_uncertain_robots() {
    let camera = "[sensor.camera]\nbearing_std_rad = 0.1\n[robots]\nsensor = \"camera\"\n";
    let lost = "[localiser.gps]\nstd_m = 1.0\n[robots]\nlocaliser = \"gps\"\n";
    for text in [camera, lost] {
        let instead = "another planner, such as certified";
        refused_with(text, "run mine.toml --in-process --planner grid", &["--planner is \"grid\": ", instead]);
        refused_with(text, "compare mine.toml --planners certified,grid", &["--planners is \"grid\": ", instead]);
        let in_file = format!("{text}[planner]\nname = \"grid\"\n");
        refused_with(&in_file, "run mine.toml", &["planner.name is \"grid\" in mine.toml: ", instead]);
    }
    // A filter that takes the poses as exact gives the planner exact ones.
    let run = Run::new();
    run.write("mine.toml", format!("{lost}[filter]\nnuisances = \"ignored\"\n[planner]\nstep_rad = 0.3\n"));
    run.command("run mine.toml --in-process --ticks 5 --planner grid").finish().succeeded();
}

/// The full covariance of many sensors would take too long.
#[test]
fn estimation_is_refused_for_too_many_sensors() {
    let run = Run::new();
    let rows: String = (0..33).map(|sensor| format!("0,{sensor},{sensor},0,5\n")).collect();
    run.write("many.csv", format!("time_s,sensor_id,sensor_x_m,sensor_y_m,range_m\n{rows}"));
    let outcome = run.start(&["track", "many.csv", "--estimate", "bias"]).finish();
    let names = ["--estimate is given for 33 robots or sensors: ", "at most 32", "leave it out"];
    // The recording has been read by then, and how is reported.
    let last = outcome.stderr.lines().last().unwrap_or_default().to_owned();
    let outcome = Outcome { stderr: last, ..outcome };
    assert_eq!(fault(&run, &["many.csv".to_owned()], &outcome, &names), None);
}

#[test]
fn a_recording_has_nothing_to_compare() {
    let run = Run::new();
    run.write("recording.toml", "[recording]\nranges = \"ranges.csv\"\n");
    let outcome = run.start(&["compare", "recording.toml"]).finish();
    let fault = fault(&run, &["recording.toml".to_owned()], &outcome, &["recording.toml", "recording"]);
    assert_eq!(fault, None);
}

#[test]
fn words_that_the_tool_does_not_know_are_refused() {
    refused_usage(&[
        ("run --fast", &["--fast"]),
        ("run one.toml two.toml", &["two.toml"]),
        ("run --robots", &["--robots"]),
        ("fly", &["fly"]),
        ("robot", &["--id"]),
        ("track", &["RANGES"]),
    ]);
}

/// Earlier names of flags and keys still work, and no advice names them.
#[test]
fn no_error_advises_an_earlier_name() {
    let run = Run::new();
    run.write("mine.toml", "unknown = 1\n");
    for words in ["run --gate 3", "run --pattern 3", "run --in-process mine.toml"] {
        let outcome = run.start(&words.split_whitespace().collect::<Vec<_>>()).finish();
        assert!(outcome.code == Some(2) && !outcome.stderr.contains("patience"), "{outcome:#?}");
    }
    run.write("mine.toml", "patience_s = 3\n");
    run.command("run mine.toml --in-process --ticks 3").finish().succeeded();
}

#[test]
fn the_printed_scenario_is_the_default_and_runs() {
    let run = Run::new();
    let printed = run.start(&["scenario"]).finish().succeeded();
    assert_eq!(printed.stderr, "");
    run.write("mine.toml", &printed.stdout);
    run.command("run mine.toml --in-process --ticks 5").finish().succeeded();
    let default = Run::new();
    default.command("run --in-process --ticks 5").finish().succeeded();
    assert_eq!(run.digest(), default.digest());
}

#[test]
fn the_tool_without_a_name_numbers_its_folders() {
    let run = Run::new();
    run.write("mine.toml", format!("name = \"{}\"\nticks = 2\n", run.name));
    for _ in 0..2 {
        run.start(&["run", "mine.toml", "--in-process"]).finish().succeeded();
    }
    for folder in [run.name.clone(), format!("{}-2", run.name)] {
        assert!(run.path("runs").join(&folder).join("report.json").exists(), "{folder}");
    }
}

#[test]
fn help_lists_every_flag() {
    let experiment = ["--robots", "--ticks", "--seed", "--clock", "--planner", "--timeout", "--name", "--out"];
    let cases: [(&[&str], &[&str]); 9] = [
        (&[], &["run", "sim", "fusion", "robot", "watch", "scenario", "track", "compare", "Exit codes"]),
        (&["run"], &["--in-process", "--write-recording"]),
        (&["sim"], &[]),
        (&["fusion"], &["--name"]),
        (&["robot"], &["--id", "--name"]),
        (&["watch"], &["--name"]),
        (&["scenario"], &["default scenario"]),
        (
            &["compare"],
            &[
                "--scenario",
                "--planners",
                "--runs",
                "--ticks",
                "--seed",
                "--robots",
                "--stand-off",
                "--threads",
                "--out",
            ],
        ),
        (&["track"], &["--range-std", "--accel-psd", "--range-bias", "--range-scale", "--gate", "--truth", "--out"]),
    ];
    for (command, flags) in cases {
        let run = Run::new();
        let help = run.start(&[command, &["--help"]].concat()).finish().succeeded();
        let of_experiment = if matches!(command, ["run" | "sim"]) { &experiment[..] } else { &[] };
        for flag in flags.iter().chain(of_experiment) {
            assert!(help.stdout.contains(flag), "{command:?}: {flag}");
        }
        assert_eq!(help.stderr, "");
        assert_eq!(listing(&run), [""; 0]);
    }
}

#[test]
fn the_version_is_the_packages() {
    let version = Run::new().start(&["--version"]).finish().succeeded();
    assert_eq!(version.stdout, format!("rangehound {}\n", env!("CARGO_PKG_VERSION")));
}
