//! Hostile input: whatever is handed in is taken or refused in one line, without panic, hang or endless memory.
//!
//! A few seconds' worth of cases by default; `RANGEHOUND_HOSTILE_CASES=2000000 cargo test --release --test integration
//! hostile -- --nocapture` runs two million of each, `RANGEHOUND_HOSTILE_SEED` others.

mod attack;
mod mutation;

use std::cell::{Cell, RefCell};
use std::ffi::OsString;
use std::fs::File;
use std::os::unix::ffi::OsStringExt;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use clap::Parser;
use rangehound::cli::{Cli, one_line};
use rangehound::failure::one_short_line;
use rangehound::files::input;
use rangehound::plan::line::Desk;
use rangehound::results::report;
use rangehound::results::report::Truth;
use rangehound::results::run_mcap::read::FrameReader;
use rangehound::results::run_mcap::scene::Scene;
use rangehound::results::{made, tables};
use rangehound::run::in_process::{self, Team};
use rangehound::run::supervisor::restart::Rule;
use rangehound::study::replay::steps::{Steps, difference};
use rangehound_fusion::{Centre, centre};
use rangehound_node::checkpoint::{Checkpoint, CheckpointError};
use rangehound_node::rendezvous::{Role, RunDescription};
use rangehound_node::world::world_of;
use rangehound_robot::drive::Controller;
use rangehound_robot::sensor::{RangeSensor, Sensor};
use rangehound_shared::message::{Command, Drive, WorldEntry};
use rangehound_shared::radio::log::{LogOptions, read_log};
use rangehound_shared::radio::{self, Format, RadioRange, StampUnit};
use rangehound_shared::recording::{Anchors, ColumnMap, ReadOptions, Recording};
use rangehound_shared::run_name::RunName;
use rangehound_shared::scenario::{PlannerSpec, PlannerTable, Scenario, ScenarioFile};
use rangehound_shared::sealed;
use rangehound_sim::World;
use rangehound_sim::playback::Playback;
use serde::Serialize;
use xxhash_rust::xxh3::xxh3_64;

use attack::{Verdict, attack, attack_parser};
use mutation::Dice;

const SCENARIOS: [&str; 7] = [
    "paper.toml",
    "recommended.toml",
    "many_robots.toml",
    "mixed_team.toml",
    "constant_acceleration.toml",
    "custom_model.toml",
    "recording/replay.toml",
];

fn scenarios_folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios")
}

fn recording_folder() -> PathBuf {
    scenarios_folder().join("recording")
}

fn documents(files: &[&str]) -> Vec<Vec<u8>> {
    files.iter().map(|file| std::fs::read(scenarios_folder().join(file)).unwrap()).collect()
}

/// The first lines of a file and no more: damage to row 700 is damage to row 7.
fn head_of(file: &str, lines: usize) -> Vec<u8> {
    let text = std::fs::read_to_string(recording_folder().join(file)).unwrap();
    text.lines().take(lines).map(|line| format!("{line}\n")).collect::<String>().into_bytes()
}

fn scenario(file: &str) -> Scenario {
    let raw = input::scenario_file(&scenarios_folder().join(file)).unwrap();
    input::scenario(&raw, file, &recording_folder()).unwrap()
}

fn refused(error: impl std::fmt::Display) -> Verdict {
    Verdict::Refused(one_short_line(&error.to_string()))
}

/// What a scenario that was taken must be good for: the first steps of a team.
fn step(scenario: &Scenario) {
    let is_slow = match scenario.planner {
        PlannerSpec::Certified { nodes } => nodes > 2_000,
        PlannerSpec::Adaptive { iterations, .. } | PlannerSpec::Standard { iterations } => iterations > 50,
        PlannerSpec::Grid { .. } => true,
        _ => false,
    };
    if is_slow || scenario.robots.len() > 16 {
        return;
    }
    let mut team = Team::new(scenario).unwrap();
    for _ in 0..3 {
        if team.tick().is_err() {
            return;
        }
        team.advance();
    }
}

#[test]
fn hostile_scenarios() {
    attack_parser("scenarios", 1.0, &documents(&SCENARIOS), |bytes| {
        let Ok(text) = std::str::from_utf8(bytes) else { return refused("not UTF-8") };
        let file = match ScenarioFile::parse(text, "hostile.toml") {
            Ok(file) => file,
            Err(error) => return refused(error),
        };
        let scenario = match input::scenario(&file, "hostile.toml", &recording_folder()) {
            Ok(scenario) => scenario,
            Err(error) => return refused(error),
        };
        assert!(scenario.is_whole());
        // The run folder's copy and the run's description say the same.
        assert_eq!(ScenarioFile::parse(&file.to_toml().unwrap(), "copy").unwrap(), file);
        assert_eq!(sealed::open::<Scenario>(&sealed::seal(&scenario).unwrap()).unwrap(), scenario);
        step(&scenario);
        Verdict::Taken
    });
}

/// A few million bytes of what recursion, repetition and length could break.
#[test]
fn long_input_is_taken_or_refused_too() {
    const LEN: usize = 2_000_000;
    let texts = [
        "[",
        "{\"robots\":[",
        "a.",
        "[[robot]]\n",
        "[[",
        "{a=",
        "x = 1\n",
        "\"",
        "9",
        "0,1,0,0,5\n",
        ",",
        "\n",
        "name = '''",
        "a",
        "[recording]\nsensor = [",
    ];
    for text in texts {
        for head in ["", "ticks = ", "name = \"", "time_s,sensor_id,sensor_x_m,sensor_y_m,range_m\n0,1,0,0,5\n"] {
            let text = format!("{head}{}", text.repeat(LEN / text.len()));
            let _ =
                ScenarioFile::parse(&text, "long.toml").inspect_err(|error| assert!(error.to_string().len() < 2_000));
            let _ = Recording::parse(text.as_bytes(), Path::new("long.csv"), &ReadOptions::default())
                .inspect_err(|error| assert!(error.to_string().len() < 2_000));
            let _ = Truth::parse(text.as_bytes()).inspect_err(|error| assert!(error.len() < 2_000));
            let mut desk = Desk::new(PlannerTable::default(), 1).unwrap();
            desk.answer(1, text.as_bytes(), &mut Vec::new());
        }
    }
}

/// Forms that a recording may be read in.
fn read_options() -> Vec<ReadOptions> {
    let columns = |text: &str| text.parse::<ColumnMap>().unwrap();
    let anchors = b"sensor_id;x_m;y_m;z_m\n1;0;0;2\n2;9,5;0;\n3;0;9;1\nA;1;1;1\n";
    let anchors = Anchors::parse(&anchors[..], Path::new("anchors.csv"), &ColumnMap::default()).unwrap();
    vec![
        ReadOptions::default(),
        ReadOptions { strict: true, ..ReadOptions::default() },
        ReadOptions { columns: columns("time=1:ms,sensor=2,x=3:m,y=4:cm,range=5:mm"), ..ReadOptions::default() },
        ReadOptions { target: Some("1".to_owned()), columns: columns("range=x:m"), ..ReadOptions::default() },
        ReadOptions { anchors: Some(anchors.clone()), ..ReadOptions::default() },
        ReadOptions { anchors: Some(anchors), columns: columns("range=d_*:cm"), ..ReadOptions::default() },
    ]
}

#[test]
fn hostile_recordings() {
    let documents = [
        head_of("ranges.csv", 12),
        b"range_m,sensor_id,x,sensor_x_m,sensor_y_m,time_s\n1,2,,3,4,5\n1,3,,3,4,5\n".to_vec(),
        b"\xef\xbb\xbf# log\r\nt (ms);Anchor;anchor_x_cm;anchor_y_cm;anchor_z_m;\"dist, mm\";tag\r\n1,5;2;3;4;;\"5,5\";1\r\n".to_vec(),
        b"# time_s sensor_id sensor_x_m sensor_y_m range_m\n1 2 3 4 5\n  2   \"a b\" 3 4 5.5e0 \n\n".to_vec(),
        b"timestamp\td_1\td_2\tdist_A (mm)\trssi_1\n2024-05-01T12:00:00.5+02:00\t1\t-1\t0\t7\n2024-05-01 10:00:01\t\t2\tnan\t7\n".to_vec(),
        b"time_s,range_1_m,range_2_m,3 (cm)\n1,2,3,400\n1.5,,0,1\n".to_vec(),
    ];
    let options = read_options();
    let turn = Cell::new(0);
    attack_parser("recordings", 2.0, &documents, |bytes| {
        turn.set(turn.get() + 1);
        let options = &options[turn.get() % options.len()];
        let (recording, summary) = match Recording::parse(bytes, Path::new("hostile.csv"), options) {
            Ok(read) => read,
            Err(error) => return refused(error),
        };
        assert!(summary.lines().iter().all(|line| line.lines().count() == 1));
        // The run folder's copy is the same recording.
        let mut copy = Vec::new();
        recording.write_csv(&mut copy).unwrap();
        let (again, _) = Recording::parse(&copy[..], Path::new("copy.csv"), &ReadOptions::default()).unwrap();
        assert_eq!(again, recording);
        let mut world = Playback::new(recording.into(), None);
        for _ in 0..20 {
            world.advance(&[]);
            let numbers = world.entries().iter().flat_map(|entry| [entry.x_m, entry.y_m, entry.range_m]);
            assert!(numbers.chain([world.time_s()]).all(f64::is_finite));
        }
        Verdict::Taken
    });
}

#[test]
fn hostile_anchors() {
    let documents = [
        b"sensor_id,x_m,y_m,z_m\n1,0,0,2\nA,9.5,0,\n".to_vec(),
        b"# site\nname;X (cm);Y (cm)\n\"a;b\";1,5;2\n7;0;9\n".to_vec(),
    ];
    attack_parser("anchors", 0.5, &documents, |bytes| {
        match Anchors::parse(bytes, Path::new("anchors.csv"), &ColumnMap::default()) {
            Ok(anchors) => {
                let numbers =
                    anchors.iter().flat_map(|(_, anchor)| anchor.position_m.into_iter().chain(anchor.height_m));
                assert!(numbers.into_iter().all(f64::is_finite));
                Verdict::Taken
            }
            Err(error) => refused(error),
        }
    });
}

#[test]
fn hostile_columns() {
    let documents =
        [b"time=stamp_ns:ns,sensor=anchor_id,range=dist:mm".to_vec(), b"time=1:iso,x=a b:m,y=3,z=7:cm".to_vec()];
    attack_parser("columns", 0.5, &documents, |bytes| {
        let Ok(text) = std::str::from_utf8(bytes) else { return refused("not UTF-8") };
        match text.parse::<ColumnMap>() {
            Ok(map) => {
                assert_eq!(map.to_string().parse::<ColumnMap>().unwrap(), map);
                Verdict::Taken
            }
            Err(error) => refused(error),
        }
    });
}

#[test]
fn hostile_true_tracks() {
    let documents =
        [head_of("truth.csv", 12), b"# mocap\nt_ms;z_m;X (mm);Y (mm)\n0;0;1500;2000\n1000;0;3000;4500,0\n".to_vec()];
    attack_parser("true tracks", 1.0, &documents, |bytes| match Truth::parse(bytes) {
        Ok(truth) => {
            for time_s in [0.0, 0.1, 1.0, f64::NAN, f64::INFINITY] {
                assert!(truth.at(time_s).is_none_or(|place| place.iter().all(|number| number.is_finite())));
            }
            Verdict::Taken
        }
        Err(problem) => refused(problem),
    });
}

#[test]
fn hostile_plan_lines() {
    let line = |rest: &str| {
        format!(
            r#"{{"prior_position_covariance":[[4,0.5],[0.5,2]],"target":[0,0],"time_step_s":0.1,"robots":[{{"position":[20,0],"max_speed":10,"range_std":1}},{{"position":[0,15],"max_speed":10,"range_std":1}}]{rest}}}"#
        )
        .into_bytes()
    };
    let documents = [
        line(""),
        line(r#","planner":"adaptive","stand_off_m":2"#),
        line(r#","planner":"greedy","separation_m":1"#),
        line(r#","planner":"random","stand_off_sigma":3"#),
    ];
    let desk = RefCell::new(Desk::new(PlannerTable::default(), 1).unwrap());
    attack_parser("plan lines", 1.0, &documents, |bytes| {
        let mut answer = Vec::new();
        let complaint = desk.borrow_mut().answer(7, bytes, &mut answer);
        assert_eq!(answer.iter().filter(|byte| **byte == b'\n').count(), 1);
        let answer: serde_json::Value = serde_json::from_slice(&answer).unwrap();
        assert_eq!(answer["error"].as_str(), complaint.as_deref());
        complaint.map_or(Verdict::Taken, Verdict::Refused)
    });
}

#[test]
fn hostile_command_lines() {
    let documents = [
        "run mine.toml --robots 3 --ticks 5 --seed 1 --clock lockstep --planner grid --patience forever --name a --out b",
        "run --restart robot=never --restart on-failure --in-process --write-recording --stand-off 2",
        "track r.csv --range-std 0.1 --accel-psd 0.2 --range-bias 105=0.15 --range-scale 0.008 --gate 4 --truth t.csv",
        "robot --id 3 --name a",
        "kill robot-2 --name a",
        "restart sim",
        "status --json",
        "resume runs/a --name a --restart never",
        "record --name a --out b.mcap --record-limit 5",
        "replay a.mcap --planner greedy --gate 3 --accel-psd 0.1 --json",
        "plan - --planner random --nodes 5 --iterations 3 --alpha 0.5 --step-rad 0.1 --seed 4",
        "chaos --faults 5 --kinds kill,stop --roles sim,robot --rate 3 --chaos-seed 2",
        "compare --planners certified,random --runs 3 --threads 2",
    ]
    .map(|line| line.as_bytes().to_vec());
    // Clap is slow: it builds all commands anew each time.
    attack_parser("command lines", 0.5, &documents, |bytes| {
        let words = bytes.split(|byte| *byte == b' ').map(|word| OsString::from_vec(word.to_vec()));
        match Cli::try_parse_from([OsString::from("rangehound")].into_iter().chain(words)) {
            Ok(_) => Verdict::Taken,
            Err(error) => refused(if error.use_stderr() { one_line(&error) } else { "help".to_owned() }),
        }
    });
}

#[test]
fn hostile_words() {
    let documents = ["robot-12", "fusion", "sim=on-failure", "a-name_7", "never", "robot=always"]
        .map(|word| word.as_bytes().to_vec());
    attack_parser("words", 1.0, &documents, |bytes| {
        let text = String::from_utf8_lossy(bytes);
        let role = text.parse::<Role>().inspect(|role| assert_eq!(role.to_string().parse::<Role>().as_ref(), Ok(role)));
        let name = text.parse::<RunName>().inspect(|name| assert!(name.to_string().len() <= 24));
        let rule = text.parse::<Rule>();
        match (role, name, rule) {
            (Err(role), Err(name), Err(rule)) => {
                assert!(name.to_string().starts_with("expected") && rule.starts_with("expected"));
                refused(role)
            }
            _ => Verdict::Taken,
        }
    });
}

/// The sealed bytes of a value, and the same with another body under a checksum that fits: damage that no checksum finds.
struct Forge {
    head: Vec<u8>,
    body: Vec<u8>,
}

impl Forge {
    fn of(value: &impl Serialize) -> Self {
        let mut body = Vec::new();
        sealed::encode_into(value, &mut body).unwrap();
        let mut head = sealed::seal(value).unwrap();
        head.truncate(head.len() - body.len());
        Self { head, body }
    }

    fn sealed(&self, body: &[u8]) -> Vec<u8> {
        let head = &self.head[..self.head.len() - 8];
        [head, &xxh3_64(&[head, body].concat()).to_le_bytes(), body].concat()
    }
}

fn description(file: &str) -> RunDescription {
    RunDescription::new(scenario(file), PathBuf::from("/nowhere"))
}

#[test]
fn hostile_run_descriptions() {
    let forges: Vec<Forge> = SCENARIOS.iter().map(|file| Forge::of(&description(file))).collect();
    let sound: Vec<Vec<u8>> = forges.iter().map(|forge| forge.sealed(&forge.body)).collect();
    let mut sound_and_one_more = sound.clone();
    sound_and_one_more.push(sealed::seal(&7_u64).unwrap());
    attack_parser("sealed files", 1.0, &sound_and_one_more, |bytes| match RunDescription::open(bytes) {
        // Some damage undoes itself; none passes.
        Ok(opened) => {
            assert!(sound.iter().any(|sound| sound == bytes), "{opened:?}");
            Verdict::Taken
        }
        Err(error) => refused(error),
    });
    let bodies: Vec<Vec<u8>> = forges.iter().map(|forge| forge.body.clone()).collect();
    attack_parser("forged run descriptions", 1.0, &bodies, |body| {
        match RunDescription::open(&forges[0].sealed(body)) {
            Ok(RunDescription { scenario, .. }) => {
                // What is opened has the right shapes at least.
                for id in 0..scenario.robots.len() {
                    assert!(Sensor::new(&scenario, id).is_some());
                }
                let _ = world_of(&scenario, Path::new("")).map(|mut world| world.advance(&[]));
                let _ = Centre::new(&scenario);
                Verdict::Taken
            }
            Err(error) => refused(error),
        }
    });
}

#[test]
fn hostile_checkpoint_files() {
    type State = (u64, Vec<f64>);
    const SLOT_LEN: u64 = 1 << 20;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sim.checkpoint");
    let kept = folder.path().join("sim.checkpoint.refused");
    let state = |k: u64| -> State { (k, vec![0.5 * k as f64; 40]) };
    let (mut checkpoint, _) = Checkpoint::open::<State>(&path, 7).unwrap();
    (1..=4).for_each(|k| checkpoint.write(&state(k)).unwrap());
    let whole = std::fs::read(&path).unwrap();
    let slots = [whole[..400].to_vec(), whole[SLOT_LEN as usize..].to_vec()];
    // Slow: two slots of a megabyte are read each time.
    attack("checkpoint files", 0.2, |dice, input| {
        let parts = [0, 1].map(|index| if dice.chance(0.3) { slots[index].clone() } else { dice.damaged(&slots) });
        // With holes, as the file has them.
        let file = File::create(&path).unwrap();
        file.write_all_at(&parts[0], 0).unwrap();
        if dice.chance(0.8) {
            file.write_all_at(&parts[1], SLOT_LEN).unwrap();
        }
        input.set(parts.concat());
        let _ = std::fs::remove_file(&kept);
        match Checkpoint::open::<State>(&path, 7) {
            Ok((_, found)) => {
                assert!(found.is_none_or(|found| [state(3), state(4)].contains(&found)));
                Verdict::Taken
            }
            Err(error @ CheckpointError::Unusable { .. }) => {
                assert!(kept.exists() && !path.exists());
                refused(error)
            }
            Err(error) => panic!("{error}"),
        }
    });
}

/// States that pass their checksum and are of another run, another version, or nobody's.
#[test]
fn hostile_states() {
    let simulated = scenario("paper.toml");
    let recorded = scenario("recording/replay.toml");
    let mut team = Team::new(&simulated).unwrap();
    for _ in 0..3 {
        team.tick().unwrap();
        team.advance();
    }
    let saved_world = |scenario: &Scenario, steps: usize| {
        let mut world = world_of(scenario, Path::new("")).unwrap();
        (0..steps).for_each(|_| world.advance(&[]));
        let mut bytes = Vec::new();
        world.save(&mut bytes).unwrap();
        bytes
    };
    let documents = [saved_world(&simulated, 3), saved_world(&recorded, 3)];
    let [fresh_simulated, fresh_recorded] =
        [&simulated, &recorded].map(|scenario| RefCell::new(world_of(scenario, Path::new("")).unwrap()));
    attack_parser("simulator's states", 1.0, &documents, |bytes| {
        let mut verdict = refused("no such state");
        for fresh in [&fresh_simulated, &fresh_recorded] {
            let mut world = fresh.borrow_mut();
            if world.restore(bytes).is_ok() {
                world.advance(&[]);
                assert!(world.entries().iter().all(|entry| entry.x_m.is_finite() && entry.range_m.is_finite()));
                verdict = Verdict::Taken;
            }
        }
        verdict
    });

    let mut documents = Vec::new();
    for scenario in [&simulated, &recorded] {
        let mut centre = Centre::new(scenario).unwrap();
        for tick in 0..4 {
            centre.update(0.1 * f64::from(tick), &vec![None; scenario.robots.len()]).unwrap();
            centre.plan();
        }
        let mut bytes = Vec::new();
        sealed::encode_into(&centre.saved().unwrap(), &mut bytes).unwrap();
        documents.push(bytes);
    }
    attack_parser("fusion's states", 1.0, &documents, |bytes| {
        let Ok(saved) = sealed::decode::<centre::Saved<'static>>(bytes) else { return refused("no such state") };
        let mut centre = Centre::new(&simulated).unwrap();
        if let Err(error) = centre.restore(saved) {
            return refused(error);
        }
        if centre.next_tick() < 1 << 40 && centre.update(0.5, &[None; 3]).is_ok() {
            assert!(centre.plan().iter().all(|command| command.heading_rad.is_finite()));
        }
        Verdict::Taken
    });
}

#[test]
fn hostile_logs() {
    let folder = tempfile::tempdir().unwrap();
    let mut scenario = scenario("paper.toml");
    scenario.ticks = 12;
    let description = RunDescription::new(scenario, folder.path().to_owned());
    in_process::run(&description, |_| {}).unwrap();
    let names = ["estimate.ticks", "world.ticks"];
    let sound = names.map(|name| std::fs::read(folder.path().join(name)).unwrap());
    attack("logs", 0.2, |dice, input| {
        let mut all = Vec::new();
        for (name, sound) in names.iter().zip(&sound) {
            let bytes = if dice.chance(0.3) { sound.clone() } else { hostile_log(dice, sound) };
            std::fs::write(folder.path().join(name), &bytes).unwrap();
            all.extend(bytes);
        }
        input.set(all);
        let done = report::from_logs(&description, None, Vec::new()).and_then(|report| {
            report::write(&report, folder.path())?;
            tables::write_estimate_csv(&description)?;
            tables::write_recording(&description)?;
            // Slow, and mostly the same.
            if dice.chance(0.02) { made::draw(&report, &description, None) } else { Ok(()) }
        });
        match done {
            Ok(()) => Verdict::Taken,
            Err(error) => refused(error),
        }
    });
}

/// Three kinds of files: as the recorder writes them, where damage meets a checksum; without chunks and checksums, where it
/// meets the messages; and compressed with zstd, where it meets the decoder.
#[test]
fn hostile_run_files() {
    let plain = |bytes: &[u8]| {
        let options =
            mcap::WriteOptions::new().profile("rangehound").use_chunks(false).calculate_data_section_crc(false);
        let mut out = options.create(std::io::Cursor::new(Vec::new())).unwrap();
        let mut written = 0;
        for record in mcap::read::LinearReader::new(bytes).unwrap() {
            match record.unwrap() {
                mcap::records::Record::Attachment { header, data, .. } => {
                    let mcap::records::AttachmentHeader { log_time, create_time, name, media_type } = header;
                    out.attach(&mcap::Attachment { log_time, create_time, name, media_type, data }).unwrap();
                }
                // In the file as written, all channels come before the first message, in the same order.
                mcap::records::Record::Chunk { header, data } if written == 0 => {
                    written += 1;
                    for record in mcap::read::ChunkReader::new(header, &data).unwrap() {
                        match record.unwrap() {
                            mcap::records::Record::Channel(channel) => {
                                let known = out.add_channel(0, &channel.topic, "protobuf", &channel.metadata).unwrap();
                                assert_eq!(known, channel.id);
                            }
                            mcap::records::Record::Message { header, data } => {
                                out.write_to_known_channel(&header, &data).unwrap();
                            }
                            _ => {}
                        }
                    }
                }
                _ => {}
            }
        }
        out.finish().unwrap();
        out.into_inner().into_inner()
    };
    let sound: Vec<Vec<u8>> = ["paper.toml", "recording/replay.toml"]
        .iter()
        .map(|file| {
            let (description, frames) = crate::run_mcap::frames(file, 5);
            crate::run_mcap::recorded(&description, &frames)
        })
        .collect();
    let mut documents: Vec<Vec<u8>> = sound.iter().map(|bytes| plain(bytes)).collect();
    documents.extend(sound.iter().map(|bytes| crate::run_mcap::zstd::with_zstd(bytes)));
    documents.extend(sound);
    attack_parser("run files", 0.2, &documents, |bytes| {
        let read = || -> Result<(), String> {
            let mut reader = FrameReader::open(bytes).map_err(|error| error.to_string())?;
            let scenario = reader.description().map_err(|error| error.to_string())?.scenario.clone();
            let mut steps = Steps::new(&scenario).map_err(|error| error.to_string())?;
            while let Some(frame) = reader.next_frame().map_err(|error| error.to_string())? {
                let estimate = steps.step(&frame).map_err(|error| error.to_string())?;
                let _ = difference(&frame, &estimate, steps.commands());
                let _ = Scene::default().update(&scenario, &frame, 0);
            }
            Ok(())
        };
        read().map_or_else(refused, |()| Verdict::Taken)
    });
}

/// Damage of any kind, or numbers that no run puts down under a header that stays.
fn hostile_log(dice: &mut Dice, sound: &[u8]) -> Vec<u8> {
    if dice.chance(0.3) {
        return dice.damaged(&[sound.to_vec()]);
    }
    let mut bytes = sound.to_vec();
    for _ in 0..=dice.below(8) {
        let at = 24 + 8 * dice.below((sound.len() - 24) / 8);
        let word = if dice.chance(0.5) { dice.number().to_bits() } else { dice.word() };
        bytes[at..at + 8].copy_from_slice(&word.to_le_bytes());
    }
    bytes
}

#[test]
fn hostile_radios() {
    for format in Format::ALL {
        let documents = radio_logs(format);
        attack(&format!("radio {format}"), 1.0, |dice, input| {
            let bytes = dice.damaged(&documents);
            input.set(bytes.clone());
            let whole = reports(format, &[&bytes]);
            assert_eq!(whole, reports(format, &bytes.chunks(1 + dice.below(40)).collect::<Vec<_>>()));
            for range in whole.iter().flatten() {
                assert!(range.range_m > 0.0 && range.range_m.is_finite(), "{range:?}");
                assert!(!range.anchor.chars().any(char::is_control), "{range:?}");
            }
            let options = LogOptions {
                rate_hz: dice.chance(0.1).then(|| dice.number()),
                stamp_unit: dice.chance(0.2).then_some(StampUnit::Microseconds),
                tag: dice.chance(0.1).then(|| "0".to_owned()),
            };
            let mut last_s = f64::NEG_INFINITY;
            match read_log(format, bytes.as_slice(), &options) {
                Ok((rows, summary)) => {
                    assert!(!rows.is_empty() && rows.len() as u64 == summary.rows);
                    for row in rows {
                        assert!(row.time_s >= last_s && row.time_s.is_finite() && row.range_m > 0.0, "{row:?}");
                        last_s = row.time_s;
                    }
                    Verdict::Taken
                }
                Err(error) => refused(error),
            }
        });
    }
}

/// All ranges of a stream that comes in these pieces, by report; none for what is refused.
fn reports(format: Format, pieces: &[&[u8]]) -> Vec<Vec<RadioRange>> {
    let (mut parser, mut all) = (radio::Parser::new(format), Vec::new());
    for piece in pieces {
        parser.push(piece, |report| all.push(report.map_or(Vec::new(), |report| report.ranges.to_vec())));
    }
    let _ = parser.finish();
    all
}

/// Undamaged logs of a port.
fn radio_logs(format: Format) -> Vec<Vec<u8>> {
    let stamped = |lines: &[&str]| {
        let line = |(number, line): (usize, &&str)| format!("{}.5 {line}\r\n", 1_700_000_000 + number);
        lines.iter().enumerate().map(line).collect::<String>().into_bytes()
    };
    let dated = |lines: &[&str]| {
        let line = |(number, line): (usize, &&str)| format!("2023-11-14T22:13:{number:02}.25Z {line}\n");
        lines.iter().enumerate().map(line).collect::<String>().into_bytes()
    };
    match format {
        Format::Plain => vec![stamped(&["12.34", "A,5.5", "anchor 7,0.25"]), dated(&["12.34", "A,5.5"])],
        Format::Dwm1001 => {
            let lec = "DIST,2,AN0,022E,7.94,8.03,0.00,3.44,AN1,15BA,0.00,8.03,0.00,6.71,POS,6.95,5.37,-1.97,52";
            let les = "022E[7.94,8.03,0.00]=3.44 15BA[0.00,8.03,0.00]=6.71 le_us=2576 est[6.95,5.37,-1.97,52]";
            vec![stamped(&["dwm> lec", lec, lec, "DIST,0"]), dated(&["dwm> les", les, les])]
        }
        Format::Mauwb => {
            let new = "AT+RANGE=tid:0,mask:01,seq:65,range:(92,0,0,0,0,0,0,0),ancid:(0,-1,-1,-1,-1,-1,-1,-1)";
            let old = "AT+RANGE=tid:0, mask:04, seq:63, range:(0,0,30,0), rssi:(0.00,0.00,-77.93,0.00)";
            vec![stamped(&["OK", new, new]), dated(&[old, old])]
        }
        Format::Linktrack => {
            vec![(0..5).flat_map(|number| node_frame(number * 20, &[1000, 2345, 8_388_607])).collect()]
        }
    }
}

/// A frame of a LinkTrack with nodes of these ranges, mm.
fn node_frame(local_time: u32, ranges_mm: &[u32]) -> Vec<u8> {
    let mut frame = vec![0x55, 0x05, (22 + 7 * ranges_mm.len()) as u8, 0, 2, 5];
    frame.extend(local_time.to_le_bytes());
    frame.extend([0; 8]);
    frame.extend([0x56, 0x13, ranges_mm.len() as u8]);
    for (id, range_mm) in (0..).zip(ranges_mm) {
        frame.extend([1, id]);
        frame.extend(&range_mm.to_le_bytes()[..3]);
        frame.extend([161, 158]);
    }
    frame.push(frame.iter().fold(0, |sum: u8, byte| sum.wrapping_add(*byte)));
    frame
}

/// What nodes of this run could send if they were broken.
#[test]
fn hostile_messages() {
    let scenario = scenario("paper.toml");
    let limit_mps = scenario.robots[0].speed_mps;
    let sensor = RefCell::new(Sensor::new(&scenario, 0).unwrap());
    attack("messages", 1.0, |dice, _| {
        let mut controller = Controller::new(limit_mps);
        let mut world = world_of(&scenario, Path::new("")).unwrap();
        for _ in 0..4 {
            let command = Command { heading_rad: dice.number(), speed_mps: dice.number() };
            let (given, asked) = (dice.word(), dice.word());
            for driven in [controller.obey(given, command), controller.hold(asked)] {
                assert!(driven.heading_rad.is_finite() && (0.0..=limit_mps).contains(&driven.speed_mps), "{driven:?}");
            }
            let entry = WorldEntry {
                x_m: dice.number(),
                y_m: dice.number(),
                range_m: dice.number(),
                range_kind: if dice.chance(0.7) { dice.below(4) as u64 } else { dice.word() },
                height_m: dice.number(),
            };
            let range_m = sensor.borrow_mut().measure(dice.word(), &entry);
            assert!(range_m.is_none_or(f64::is_finite), "{entry:?} {range_m:?}");
            let drives: Vec<Option<Drive>> = (0..dice.below(6))
                .map(|_| {
                    dice.chance(0.8).then(|| Drive {
                        robot: dice.word(),
                        heading_rad: dice.number(),
                        speed_mps: dice.number(),
                        range_sent_ns: dice.word(),
                        heading_held_ns: dice.word(),
                        heading_late: dice.word(),
                        headings_refused: dice.word(),
                    })
                })
                .collect();
            let _ = drives.iter().flatten().filter_map(Drive::latency_ns).max();
            world.advance(&drives);
            assert!(world.entries().iter().all(|entry| entry.x_m.is_finite() && entry.y_m.is_finite()));
        }
        Verdict::Taken
    });
}
