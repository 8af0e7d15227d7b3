//! A run in one file: complete for other programs' readers, replayed bit-identically, and readable up to
//! the place where a kill has cut it.

mod zstd;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use rangehound::results::run_mcap::read::FrameReader;
use rangehound_shared::measurement::{Measurement, Pose};
use rangehound_shared::record::{FusionDecision, GateResult, GateResults, Heading, Heard};
use rustix::process::{Pid, Signal};
use serde_json::Value;

use crate::command_line::hostile::targets::made::{frames, recorded};
use crate::support::{Outcome, Run, is_alive, signal, skipped};

const NODES: [&str; 5] = ["sim", "fusion", "robot-0", "robot-1", "robot-2"];

/// The reader of the format's authors, and its dependencies.
const PACKAGES: [&str; 5] =
    ["mcap==1.6.0", "mcap-protobuf-support==0.6.0", "protobuf==7.36.2", "lz4==4.4.5", "zstandard==0.25.0"];

/// A Python with these packages, created once below the target folder. `None` without it, which CI treats as a
/// failure.
fn python() -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("mcap-reader");
    let python = folder.join("bin/python");
    let ready = folder.join(PACKAGES.concat());
    if ready.exists() {
        return Some(python);
    }
    let made = Command::new("python3").args(["-m", "venv"]).arg(&folder).status();
    let install = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check"];
    let installed = made.is_ok_and(|status| status.success())
        && Command::new(&python).args(install).args(PACKAGES).status().is_ok_and(|status| status.success());
    assert!(installed || std::env::var_os("CI").is_none(), "no python3 with {PACKAGES:?} can be made");
    if installed {
        std::fs::write(ready, "").unwrap();
    }
    installed.then_some(python)
}

fn replay(run: &Run, words: &str) -> Outcome {
    let args: Vec<&str> = ["replay"].into_iter().chain(words.split_whitespace()).collect();
    run.start(&args).finish()
}

/// Replays a file, which must be bit-identical, and returns the replay's JSON.
#[track_caller]
fn replayed(run: &Run, file: &str) -> Value {
    let outcome = replay(run, &format!("{file} --json"));
    assert_eq!(outcome.code, Some(0), "{outcome:#?}");
    let json: Value = serde_json::from_str(&outcome.stdout).unwrap();
    assert_eq!(json["verdict"], "bit-identical", "{json}");
    json
}

/// The present recorder of a run, not the one with this pid.
pub(crate) fn recorder(run: &Run, before: Option<Pid>) -> Pid {
    let words = format!("record\0--name\0{}\0", run.name);
    let mut found = None;
    run.wait_until("the recorder is there", || {
        let processes = std::fs::read_dir("/proc").unwrap().flatten();
        let pids = processes.filter_map(|entry| Pid::from_raw(entry.file_name().to_str()?.parse().ok()?));
        found = pids.filter(|pid| Some(*pid) != before).find(|pid| {
            std::fs::read_to_string(format!("/proc/{pid}/cmdline")).is_ok_and(|line| line.contains(&words))
        });
        found.is_some()
    });
    found.unwrap()
}

#[test]
fn other_programs_read_a_run_with_kills_and_it_replays_to_the_bit() {
    let run = Run::new();
    let supervisor = run.lockstep("--record --ticks 8000 --timeout forever");
    for (start, role) in [(1, "fusion"), (2, "fusion"), (1, "sim"), (1, "robot-1"), (3, "fusion")] {
        let ticks = run.ticks_done();
        run.wait_for_ticks(ticks + 500);
        signal(run.pid_of(role, start), Signal::KILL);
    }
    supervisor.finish().succeeded();
    let json = replayed(&run, "out/run.mcap");
    assert_eq!(json["digest"].as_str().unwrap(), run.digest());
    assert_eq!((&json["ticks"], &json["ranges_in_time"]), (&8_000.into(), &24_000.into()), "{json}");

    let expected: BTreeMap<&str, (&str, u64)> = BTreeMap::from([
        ("/world", ("world.World", 8_001)),
        ("/range", ("range.Range", 24_003)),
        ("/heading", ("heading.Heading", 8_001)),
        ("/drive", ("drive.Drive", 24_003)),
        ("/estimate", ("estimate.Estimate", 8_001)),
        ("/truth", ("truth.Truth", 8_001)),
        ("/scene", ("foxglove.SceneUpdate", 8_001)),
        ("/scene/robots", ("foxglove.PosesInFrame", 8_001)),
        ("/scene/target", ("foxglove.PointCloud", 8_001)),
        ("/scene/estimate", ("foxglove.PointCloud", 8_001)),
    ]);
    let bytes = std::fs::read(run.path("out/run.mcap")).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let counts = summary.stats.unwrap().channel_message_counts;
    let listed = summary.channels.iter().map(|(id, channel)| {
        let schema = channel.schema.as_ref().unwrap();
        (channel.topic.as_str(), (schema.name.as_str(), counts[id]))
    });
    assert_eq!(listed.collect::<BTreeMap<_, _>>(), expected);

    let Some(python) = python() else {
        skipped("a run's file with another reader than the mcap crate", "no python3 with its packages can be made");
        return;
    };
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/results/run_mcap/read.py");
    let output = Command::new(python).arg(script).arg(run.path("out/run.mcap")).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let read: Value = serde_json::from_slice(&output.stdout).unwrap();
    for (topic, (schema, count)) in expected {
        assert_eq!(read["topics"][topic], serde_json::json!([schema, count]), "{topic}");
        assert_eq!(read["read"][topic], count, "{topic}");
    }
    assert_eq!(read["ordered"], true);
    assert_eq!(read["last_ns"], 800_000_000_000_u64);
    assert_eq!(read["commands"], 3);
    assert_eq!(read["metadata"]["rangehound"]["clock"], "lockstep");
    assert_eq!(read["attachments"], serde_json::json!(["scenario.toml", "run.sealed"]));
    let csv = run.read("estimate.csv");
    let rows = csv.lines().skip(1).map(|line| line.split(',').map(|number| number.parse().unwrap()).collect());
    let rows: Vec<Vec<f64>> = rows.collect();
    let estimates = read["estimates"].as_array().unwrap();
    assert_eq!(rows.len(), estimates.len());
    for (row, estimate) in rows.iter().zip(estimates) {
        let numbers: Vec<f64> = estimate.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect();
        assert_eq!(*row, numbers);
    }
    run.assert_nothing_left();
}

#[test]
fn a_real_time_run_with_late_and_lost_ranges_and_a_killed_fusion_replays_to_the_bit() {
    let run = Run::new();
    let supervisor = run.command("run --record --clock realtime --ticks 50");
    let robot = run.pid_of("robot-1", 1);
    for (ticks, stop_ms) in [(5, 150), (12, 150), (19, 300), (26, 150), (33, 150)] {
        run.wait_for_ticks(ticks);
        signal(robot, Signal::STOP);
        std::thread::sleep(Duration::from_millis(stop_ms));
        signal(robot, Signal::CONT);
        if ticks == 19 {
            signal(run.pid_of("fusion", 1), Signal::KILL);
        }
    }
    supervisor.finish().succeeded();
    let json = replayed(&run, "out/run.mcap");
    let ranges = &run.report()["ranges"];
    assert!(ranges["late"].as_u64().unwrap() > 0 && ranges["missing"].as_u64().unwrap() > 0, "{ranges}");
    assert!(json["ranges_late"].as_u64().unwrap() >= ranges["fused_late"].as_u64().unwrap(), "{json} {ranges}");
    assert_eq!(json["digest"].as_str().unwrap(), run.digest());
    run.assert_nothing_left();
}

#[test]
fn tracked_recordings_replay_to_the_bit_and_other_flags_show_what_they_change() {
    let run = Run::new();
    let ranges = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/recording/ranges.csv");
    let words = format!("track {} --record --range-std 0.15 --accel-psd 0.05", ranges.display());
    run.command(&words).finish().succeeded();
    replayed(&run, "out/run.mcap");
    let changed = replay(&run, "out/run.mcap --gate 2 --accel-psd 0.5 --json");
    let json: Value = serde_json::from_str(&changed.stdout).unwrap();
    assert_eq!((changed.code, json["verdict"].as_str()), (Some(0), Some("changed")));
    let rejected = |side: &str| json["comparison"][side]["rejected"].as_u64().unwrap();
    assert!(rejected("replayed") > rejected("recorded"), "{json}");
    let psds = ["recorded", "replayed"].map(|side| json["comparison"][side]["noise_psd"].as_f64());
    assert_eq!(psds, [Some(0.05), Some(0.5)]);
    // Sensors of a recording have no planner.
    assert_eq!(json["comparison"]["replayed"]["lower_bound_mean"], Value::Null);
    let refused = replay(&run, "out/run.mcap --planner greedy");
    assert_eq!((refused.code, refused.complaints().len()), (Some(2), 1), "{refused:#?}");

    let run = Run::new();
    run.lockstep("--record --in-process --ticks 300").finish().succeeded();
    replayed(&run, "out/run.mcap");
    // Of these planners only the certified one proves a bound.
    for (words, has_bound, psd) in
        [("--planner greedy", false, "10"), ("--planner certified --accel-psd 0.125", true, "0.125")]
    {
        let changed = replay(&run, &format!("out/run.mcap {words}"));
        assert_eq!(changed.code, Some(0), "{changed:#?}");
        assert!(changed.stdout.contains("headings apart") && changed.stdout.lines().all(|line| line.len() <= 80));
        let row = |name: &str| -> Vec<&str> {
            let row = changed.stdout.lines().find(|line| line.contains(name)).unwrap();
            row.split_whitespace().rev().take(2).collect()
        };
        let [replayed, recorded] = row("its bound")[..] else { panic!("{changed:#?}") };
        assert_eq!((recorded, replayed != "-"), ("-", has_bound), "{changed:#?}");
        assert_eq!(row("noise psd, m^2/s^3"), [psd, "10"], "{changed:#?}");
    }
    // A recording made from the logs after the run is equal.
    let first = std::fs::read(run.path("out/run.mcap")).unwrap();
    let json = run.start(&["record", "out", "--out", "again.mcap", "--json"]).finish().succeeded().stdout;
    let json: Value = serde_json::from_str(&json).unwrap();
    assert_eq!((&json["file"], &json["ticks"]), (&"again.mcap".into(), &300.into()), "{json}");
    assert!(first == std::fs::read(run.path("again.mcap")).unwrap());
}

#[test]
fn a_killed_recorder_starts_anew_and_a_terminated_one_completes_its_file() {
    let run = Run::new();
    let supervisor = run.command("run --record --clock realtime --ticks 45");
    let first = recorder(&run, None);
    run.wait_for_ticks(5);
    signal(first, Signal::KILL);
    let second = recorder(&run, Some(first));
    run.wait_for_ticks(25);
    signal(second, Signal::TERM);
    supervisor.finish().succeeded();
    let json = replayed(&run, "out/run.mcap");
    let ticks = json["ticks"].as_u64().unwrap();
    assert!((10..45).contains(&ticks), "{json}");
    assert!(!run.path("out/run.mcap.partial").exists());
    run.assert_nothing_left();
}

#[test]
fn a_run_whose_processes_are_all_killed_has_a_recording_so_far_and_all_of_it_once_resumed() {
    let run = Run::new();
    let supervisor = run.command("run --record --clock realtime --ticks 60");
    let mut all = vec![recorder(&run, None)];
    all.extend(NODES.iter().map(|role| run.pid_of(role, 1)));
    run.wait_for_ticks(30);
    supervisor.signal(Signal::STOP);
    all.iter().for_each(|pid| signal(*pid, Signal::KILL));
    supervisor.signal(Signal::KILL);
    supervisor.finish();
    run.wait_until("all are gone", || !all.iter().any(|pid| is_alive(*pid)));
    assert!(!run.path("out/run.mcap").exists());
    let cut = replay(&run, "out/run.mcap.partial");
    assert_eq!((cut.code, cut.complaints().len()), (Some(2), 1), "{cut:#?}");
    assert!(cut.stderr.contains("--repair"), "{cut:#?}");
    let repaired = replay(&run, "out/run.mcap.partial --repair --out part.mcap");
    assert_eq!(repaired.code, Some(0), "{repaired:#?}");
    let json = replayed(&run, "part.mcap");
    assert!((1..30).contains(&json["ticks"].as_u64().unwrap()), "{json}");

    run.start(&["resume", "out", "--name", &run.name]).finish().succeeded();
    assert_eq!(replayed(&run, "out/run.mcap")["ticks"], 60);
    run.assert_nothing_left();
}

#[test]
fn a_recording_ends_at_its_limit_with_a_warning_and_the_run_goes_on() {
    let run = Run::new();
    let outcome = run.lockstep("--record --record-limit 1 --ticks 3000").finish();
    assert_eq!(outcome.code, Some(0), "{outcome:#?}");
    let json = replayed(&run, "out/run.mcap");
    let ticks = json["ticks"].as_u64().unwrap();
    let warning = format!("(--record-limit): nothing is recorded from tick {} on", ticks + 1);
    assert!(outcome.stderr.contains(&warning), "{warning}: {outcome:#?}");
    assert!(std::fs::metadata(run.path("out/run.mcap")).unwrap().len() < 2_000_000);
    assert_eq!(run.report()["ticks"], 3_000);
    run.assert_nothing_left();
}

/// Files that are damaged or that are not recordings.
#[test]
fn files_that_are_no_recordings_are_refused_in_one_line() {
    let run = Run::new();
    run.lockstep("--record --in-process --ticks 500").finish().succeeded();
    let intact = std::fs::read(run.path("out/run.mcap")).unwrap();
    let mut damaged = intact.clone();
    damaged[intact.len() / 2] ^= 0x55;
    run.write("damaged.mcap", &damaged);
    run.write("cut.mcap", &intact[..intact.len() / 2]);
    run.write("short.mcap", &intact[..300]);
    run.write("empty.mcap", b"");
    for file in ["damaged.mcap", "cut.mcap", "short.mcap", "empty.mcap", "nothing.mcap", "out", "out/report.json"] {
        let refused = replay(&run, file);
        assert_eq!((refused.code, refused.complaints().len()), (Some(2), 1), "{file}: {refused:#?}");
        assert!(refused.stderr.contains(file), "{refused:#?}");
        let can_be_repaired = ["damaged.mcap", "cut.mcap"].contains(&file);
        assert_eq!(refused.stderr.contains("--repair"), can_be_repaired, "{refused:#?}");
    }
    for (file, intact) in [("damaged.mcap", "damaged.repaired.mcap"), ("cut.mcap", "cut.repaired.mcap")] {
        let repaired = replay(&run, &format!("{file} --repair --json"));
        assert_eq!(repaired.code, Some(0), "{repaired:#?}");
        let json: Value = serde_json::from_str(&repaired.stdout).unwrap();
        assert_eq!((&json["whole"], &json["first_tick"]), (&intact.into(), &0.into()), "{json}");
        assert_eq!(replayed(&run, intact)["ticks"], json["ticks"]);
    }
    let refused = replay(&run, "short.mcap --repair");
    assert_eq!((refused.code, refused.complaints().len()), (Some(2), 1), "{refused:#?}");
}

/// The chunks of a file: offset of the byte with each record's type.
fn chunks(bytes: &[u8]) -> Vec<usize> {
    let (mut at, mut found) = (8, Vec::new());
    while let Some(len) = bytes.get(at + 1..at + 9) {
        if bytes[at] == mcap::records::op::CHUNK {
            found.push(at);
        }
        at += 9 + u64::from_le_bytes(len.try_into().unwrap()) as usize;
    }
    found
}

/// A record of unknown type is skipped, and so are the ticks of a chunk with a damaged type.
#[test]
fn ticks_of_a_damaged_chunk_are_reported_missing() {
    let run = Run::new();
    run.lockstep("--record --in-process --ticks 3000").finish().succeeded();
    let intact = std::fs::read(run.path("out/run.mcap")).unwrap();
    let chunks = chunks(&intact);
    assert!(chunks.len() >= 3, "{chunks:?}");
    for (at, is_last) in [(chunks[0], false), (chunks[1], false), (*chunks.last().unwrap(), true)] {
        for kind in [0x46, mcap::records::op::MESSAGE, mcap::records::op::MESSAGE_INDEX, mcap::records::op::DATA_END] {
            let mut damaged = intact.clone();
            damaged[at] = kind;
            run.write("damaged.mcap", &damaged);
            let json = replay(&run, "damaged.mcap");
            let case = format!("{at} {kind:#x}: {json:#?}");
            if kind == mcap::records::op::DATA_END && !is_last {
                assert_eq!((json.code, json.complaints().len()), (Some(2), 1), "{case}");
                assert!(json.stderr.contains("after the end of the data"), "{case}");
                continue;
            }
            assert_eq!((json.code, json.complaints().len()), (Some(1), 1), "{case}");
            let words: Vec<&str> = json.complaints()[0].split(' ').collect();
            let number = words.iter().position(|word| *word == "ticks,").unwrap() - 1;
            let numbers = [words[number], words[number + 2], words[number + 4].trim_end_matches(',')];
            let [count, first, last] = numbers.map(|word| word.parse::<u64>().unwrap());
            assert_eq!(count, last - first + 1, "{case}");
            // The first chunk defines the channels.
            assert_eq!((first == 0, last == 3000), (at == chunks[0], is_last || at == chunks[0]), "{case}");
            assert!(json.stderr.contains("are missing"), "{case}");
        }
    }
    // Only readable ticks of the existing file count: the logs hold more, so they are recorded.
    let mut damaged = intact.clone();
    damaged[chunks[1]] = 0x46;
    run.write("out/run.mcap", &damaged);
    let recorded = run.start(&["record", "out"]).finish().succeeded();
    assert!(recorded.stderr.contains("are missing"), "{recorded:#?}");
    assert_eq!(replayed(&run, "out/run.mcap")["ticks"], 3000);
}

#[test]
fn every_frame_comes_back_to_the_bit() {
    let files = ["paper.toml", "many_robots.toml", "constant_acceleration.toml", "mixed_sensors.toml", "cameras.toml"];
    for file in files.into_iter().chain(["recording/replay.toml"]) {
        let (description, mut all) = frames(file, 12);
        // Cases that do not occur in lock step.
        let strange = &mut all[7];
        strange.fusion.exchanges[0].heard = None;
        strange.fusion.exchanges[1].heard = Some(Heard {
            measurement: Measurement::new(
                Pose { height_m: -0.0, covariance_m2: [0.5, -0.25, 2.0], ..Pose::at([-0.0, 1e-300]) },
                Some((-0.5, 1.5)),
            ),
            taken_at: 9,
            judged: GateResults::default(),
        });
        let pose = Pose { height_m: 2.5, ..Pose::default() };
        let heard = Heard { measurement: Measurement::new(pose, None), taken_at: 7, judged: GateResults::default() };
        strange.fusion.exchanges[2].heard = Some(heard);
        let judged = GateResult { used: FusionDecision::Distrusted, normalised_square: None };
        let bearing = GateResult { used: FusionDecision::Rejected, normalised_square: Some(20.0) };
        let both = Measurement::new(Pose { heading_rad: 0.7, heading_std_rad: 0.1, ..pose }, Some((2.0, 0.1)));
        let both = both.with_bearing(Some((-1.5, 0.02)));
        all[8].fusion.exchanges[0].heard =
            Some(Heard { judged: [Some(judged), Some(bearing)], measurement: both, taken_at: 8 });
        let strange = &mut all[7];
        strange.world.robots[0].range_sent_ns = Some(5);
        strange.world.robots[0].pose.height_m = -1.25;
        strange.world.robots[0].pose.covariance_m2 = [1.5, 0.0, 0.25];
        strange.world.robots[1].heading = Heading::Late;
        strange.world.robots[2].heading = Heading::Unknown;
        strange.world.robots[2].range_m = None;
        strange.world.robots[2].bearing_rad = Some(0.3);
        strange.world.robots[2].pose.heading_rad = -2.0;
        let estimate = &mut strange.fusion.estimate;
        (estimate.late, estimate.fused_late, estimate.rejected_late, estimate.missing) = (4, 2, 1, 1);
        (estimate.nis_all, estimate.tested, estimate.noise_scale) = (12.5, 4, [1.75, 1.25]);
        estimate.refused = [1, 2, 3, 4, 5, 6];
        (estimate.distrusted[0][0], estimate.distrusted[1][0]) = (5, 2);
        (estimate.lower_bound, estimate.objective) = (f64::NEG_INFINITY, -0.0);
        let bytes = recorded(&description, &all);
        let mut reader = FrameReader::open(&bytes[..]).unwrap();
        assert_eq!(reader.description().unwrap().run_id, description.run_id);
        assert_eq!(reader.scenario_text(), Some(&b"name = \"x\""[..]));
        let mut read = Vec::new();
        while let Some(frame) = reader.next_frame().unwrap() {
            read.push(frame);
        }
        // As text: minus zero differs from zero, and each number has its own text.
        assert_eq!(format!("{read:?}"), format!("{all:?}"), "{file}");
    }
}
