//! The fuzz targets: one function for each kind of input. It accepts or refuses the input, and panics if a promise is broken.
//!
//! `fuzz_targets/` passes these functions to libFuzzer, `tests/command_line/hostile.rs` to the ordinary tests.

pub mod made;

use std::cell::RefCell;
use std::ffi::OsString;
use std::fmt::Display;
use std::fs::File;
use std::os::unix::ffi::OsStringExt;
use std::os::unix::fs::FileExt;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use clap::Parser;
use rangehound::cli::{Cli, one_line};
use rangehound::failure::one_short_line;
use rangehound::files::bag::cdr;
use rangehound::files::bag::definition::Types;
use rangehound::files::bag::path::{Path as FieldPath, fields_named};
use rangehound::files::{calibration, input};
use rangehound::plan::line::LineSolver;
use rangehound::results::curves::CurvesBuilder;
use rangehound::results::report::{self, Truth};
use rangehound::results::run_mcap::read::FrameReader;
use rangehound::results::run_mcap::scene::Scene;
use rangehound::results::{made as pictures, tables};
use rangehound::run::in_process::Team;
use rangehound::run::supervisor::restart::Rule;
use rangehound::study::replay::steps::{Steps, difference};
use rangehound_fusion::{Centre, centre};
use rangehound_node::checkpoint::{Checkpoint, CheckpointError};
use rangehound_node::rendezvous::{Role, RunDescription};
use rangehound_node::world::world_of;
use rangehound_robot::{pose, sensor};
use rangehound_shared::radio::log::{LogOptions, read_log};
use rangehound_shared::radio::{self, Format, RadioRange, StampUnit};
use rangehound_shared::recording::{Anchors, ColumnMap, ReadOptions, Recording};
use rangehound_shared::run_name::RunName;
use rangehound_shared::scenario::{PlannerSpec, PlannerTable, RecordingTable, Scenario, ScenarioFile};
use rangehound_shared::sealed;
use rangehound_sim::World;
use rangehound_sim::playback::Playback;

/// Whether an input is accepted.
pub type Verdict = Result<(), Complaint>;

/// The line that refuses an input, from any reader's error.
#[derive(Debug)]
pub struct Complaint(pub String);

/// Memory that any input may use, plus a factor for each byte of input. A damaged length in a sealed file may claim as
/// much as the longest value that can be sealed, 16 MiB.
const BYTES_FREE: u64 = 20 << 20;
const BYTES_FOR_ONE: u64 = 400;

/// Longest error message, bytes: it contains file names and found values, but no file contents.
const COMPLAINT_MAX: usize = 600;

impl Complaint {
    fn of(line: String) -> Self {
        assert!(line.lines().count() == 1 && line.len() <= COMPLAINT_MAX, "refused by {line:?}");
        Self(line)
    }
}

impl<E: Display> From<E> for Complaint {
    fn from(error: E) -> Self {
        Self::of(one_short_line(&error.to_string()))
    }
}

/// Passes an input to a target. Panics if the memory used is more than the input's length explains.
pub fn check(target: fn(&[u8]) -> Verdict, bytes: &[u8]) -> Verdict {
    let mut verdict = Ok(Ok(()));
    let memory = allocation_counter::measure(|| verdict = catch_unwind(AssertUnwindSafe(|| target(bytes))));
    let verdict = verdict.unwrap_or_else(|panic| resume_unwind(panic));
    let explained = BYTES_FREE + BYTES_FOR_ONE * bytes.len() as u64;
    assert!(memory.bytes_max <= explained, "{} bytes of memory for {} bytes of input", memory.bytes_max, bytes.len());
    verdict
}

/// The project's folder, which contains this crate.
#[must_use]
pub fn project() -> &'static Path {
    let mut above = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors();
    above.find(|folder| folder.join("scenarios").is_dir()).unwrap()
}

fn recording_folder() -> PathBuf {
    project().join("scenarios/recording")
}

/// Accepted if one of several readers accepts it, otherwise refused as by the first. All readers read it.
fn any<const N: usize>(verdicts: [Verdict; N]) -> Verdict {
    verdicts.into_iter().reduce(|all, next| all.or_else(|first| next.map_err(|_| first))).unwrap()
}

/// A scenario file, and the first steps of its team.
pub fn scenarios(bytes: &[u8]) -> Verdict {
    let file = ScenarioFile::parse(std::str::from_utf8(bytes)?, "hostile.toml")?;
    let scenario = input::scenario(&file, "hostile.toml", &recording_folder())?;
    assert!(scenario.is_complete());
    // The run folder's copy and the run's description must be equal.
    assert_eq!(ScenarioFile::parse(&file.to_toml().unwrap(), "copy").unwrap(), file);
    let described = RunDescription::new(scenario.clone(), PathBuf::from("/nowhere"));
    assert_eq!(RunDescription::open(described.seal().unwrap().as_bytes()).unwrap(), described);
    let is_slow = match scenario.planner {
        PlannerSpec::Certified { nodes } => nodes > 2_000,
        PlannerSpec::Adaptive { iterations, .. } | PlannerSpec::Standard { iterations } => iterations > 50,
        PlannerSpec::Grid { .. } => true,
        _ => false,
    };
    if is_slow || scenario.robots.len() > 16 {
        return Ok(());
    }
    let mut team = Team::new(&scenario).unwrap();
    for _ in 0..3 {
        if team.tick().is_err() {
            break;
        }
        team.advance();
    }
    Ok(())
}

/// A table of ranges, in each of its forms.
pub fn recordings(bytes: &[u8]) -> Verdict {
    static OPTIONS: LazyLock<[ReadOptions; 7]> = LazyLock::new(|| {
        let columns = |text: &str| text.parse::<ColumnMap>().unwrap();
        let anchors = b"sensor_id;x_m;y_m;z_m\n1;0;0;2\n2;9,5;0;\n3;0;9;1\nA;1;1;1\n";
        let anchors = Anchors::parse(&anchors[..], Path::new("anchors.csv"), &ColumnMap::default()).unwrap();
        [
            ReadOptions::default(),
            ReadOptions { strict: true, ..ReadOptions::default() },
            ReadOptions { columns: columns("time=1:ms,sensor=2,x=3:m,y=4:cm,range=5:mm"), ..ReadOptions::default() },
            ReadOptions { columns: columns("time=1:s,sensor=2,x=3:m,y=4:m,bearing=5:deg"), ..ReadOptions::default() },
            ReadOptions { target: Some("1".to_owned()), columns: columns("range=x:m"), ..ReadOptions::default() },
            ReadOptions { anchors: Some(anchors.clone()), ..ReadOptions::default() },
            ReadOptions { anchors: Some(anchors), columns: columns("range=d_*:cm"), ..ReadOptions::default() },
        ]
    });
    any(OPTIONS.each_ref().map(|options| recording(bytes, options)))
}

fn recording(bytes: &[u8], options: &ReadOptions) -> Verdict {
    let (recording, summary) = Recording::parse(bytes, Path::new("hostile.csv"), options)?;
    assert!(summary.lines().iter().all(|line| line.lines().count() == 1));
    // The run folder's copy must be the same recording.
    let mut copy = Vec::new();
    recording.write_csv(&mut copy).unwrap();
    let (again, _) = Recording::parse(&copy[..], Path::new("copy.csv"), &ReadOptions::default()).unwrap();
    assert_eq!(again, recording);
    let mut world = Playback::new(recording.into(), None);
    for _ in 0..20 {
        world.advance(&[]);
        let numbers = world.entries().iter().flat_map(|entry| entry.numbers());
        assert!(numbers.chain([world.time_s()]).all(f64::is_finite));
    }
    Ok(())
}

/// A table of sensor positions.
pub fn anchors(bytes: &[u8]) -> Verdict {
    let anchors = Anchors::parse(bytes, Path::new("anchors.csv"), &ColumnMap::default())?;
    let numbers = anchors.iter().flat_map(|(_, anchor)| anchor.position_m.into_iter().chain(anchor.height_m));
    assert!(numbers.into_iter().all(f64::is_finite));
    Ok(())
}

/// The value of `--columns`.
pub fn columns(bytes: &[u8]) -> Verdict {
    let map: ColumnMap = std::str::from_utf8(bytes)?.parse()?;
    assert_eq!(map.to_string().parse::<ColumnMap>().unwrap(), map);
    Ok(())
}

/// A `calibration.toml`.
pub fn calibrations(bytes: &[u8]) -> Verdict {
    let file = calibration::parse(std::str::from_utf8(bytes)?)?;
    let all = file.sensor.iter().flat_map(|sensor| [sensor.bias_m, sensor.scale, sensor.range_std_m]);
    assert!(all.chain([file.range_std_m, file.accel_psd]).flatten().all(f64::is_finite));
    Ok(())
}

/// A table of target positions.
pub fn true_tracks(bytes: &[u8]) -> Verdict {
    let truth = Truth::parse(bytes)?;
    for time_s in [0.0, 0.1, 1.0, f64::NAN, f64::INFINITY] {
        assert!(truth.at(time_s).is_none_or(|place| place.iter().all(|number| number.is_finite())));
    }
    Ok(())
}

/// A line for `plan`.
pub fn plan_lines(bytes: &[u8]) -> Verdict {
    thread_local!(static SOLVER: RefCell<LineSolver> = RefCell::new(LineSolver::new(PlannerTable::default(), 1).unwrap()));
    let mut answer = Vec::new();
    let complaint = SOLVER.with_borrow_mut(|solver| solver.answer(7, bytes, &mut answer));
    assert_eq!(answer.iter().filter(|byte| **byte == b'\n').count(), 1);
    let answer: serde_json::Value = serde_json::from_slice(&answer).unwrap();
    assert_eq!(answer["error"].as_str(), complaint.as_deref());
    complaint.map(Complaint::of).map_or(Ok(()), Err)
}

/// A command line after `rangehound`, split at spaces.
pub fn command_lines(bytes: &[u8]) -> Verdict {
    let args = bytes.split(|byte| *byte == b' ').map(|arg| OsString::from_vec(arg.to_vec()));
    match Cli::try_parse_from([OsString::from("rangehound")].into_iter().chain(args)) {
        Ok(_) => Ok(()),
        Err(error) if error.use_stderr() => Err(Complaint::of(one_line(&error))),
        Err(_) => Err(Complaint::of("help".to_owned())),
    }
}

/// Names of nodes and runs, and rules for restarts.
pub fn names(bytes: &[u8]) -> Verdict {
    let text = String::from_utf8_lossy(bytes);
    let role = text.parse::<Role>().inspect(|role| assert_eq!(role.to_string().parse::<Role>().as_ref(), Ok(role)));
    let name = text.parse::<RunName>().inspect(|name| assert!(name.to_string().len() <= 24));
    let rule = text.parse::<Rule>();
    if let (Err(name), Err(rule)) = (&name, &rule) {
        assert!(name.to_string().starts_with("expected") && rule.starts_with("expected"));
    }
    any([
        role.map(drop).map_err(Complaint::from),
        name.map(drop).map_err(Complaint::from),
        rule.map(drop).map_err(Complaint::from),
    ])
}

/// A run's description: as a sealed file, and as a body with a matching checksum.
pub fn run_descriptions(bytes: &[u8]) -> Verdict {
    any([run_description(bytes), run_description(&made::sealed_body(bytes))])
}

fn run_description(bytes: &[u8]) -> Verdict {
    let RunDescription { scenario, .. } = RunDescription::open(bytes)?;
    // An accepted description has valid dimensions at least.
    for id in 0..scenario.robots.len() {
        assert!(sensor::of_scenario(&scenario, id).is_some() && pose::of_scenario(&scenario, id).is_some());
    }
    let _ = world_of(&scenario, Path::new("")).map(|mut world| world.advance(&[]));
    let _ = Centre::new(&scenario);
    Ok(())
}

/// A slot of a checkpoint file: alone, beside a valid one, and twice.
pub fn checkpoint_files(bytes: &[u8]) -> Verdict {
    for second in [&made::CHECKPOINT_SLOTS[1][..], bytes] {
        let _ = checkpoint_file(bytes, second);
    }
    checkpoint_file(bytes, &[]).map(drop)
}

/// Opens a checkpoint file with these slots.
pub fn checkpoint_file(first: &[u8], second: &[u8]) -> Result<Option<made::State>, Complaint> {
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("sim.checkpoint");
    // With a hole between the slots, as in the real file.
    let file = File::create(&path)?;
    file.write_all_at(first, 0)?;
    if !second.is_empty() {
        file.write_all_at(second, made::SLOT_LEN)?;
    }
    let opened = Checkpoint::open(&path, made::RUN_ID);
    if let Err(error) = &opened {
        assert!(matches!(error, CheckpointError::Unusable { .. }), "{error}");
        assert!(folder.path().join("sim.checkpoint.refused").exists() && !path.exists());
    }
    Ok(opened?.1)
}

/// States of simulator and fusion with a valid checksum but of another run or version, or arbitrary.
pub fn node_states(bytes: &[u8]) -> Verdict {
    any(made::SCENARIOS_OF_STATES
        .each_ref()
        .map(|scenario| any([sim_state(scenario, bytes), fusion_state(scenario, bytes)])))
}

fn sim_state(scenario: &Scenario, bytes: &[u8]) -> Verdict {
    let mut world = world_of(scenario, Path::new(""))?;
    world.restore(bytes)?;
    world.advance(&[]);
    assert!(world.entries().iter().all(|entry| entry.is_valid()));
    Ok(())
}

fn fusion_state(scenario: &Scenario, bytes: &[u8]) -> Verdict {
    let saved = sealed::decode::<centre::Saved<'static>>(bytes)?;
    let mut centre = Centre::new(scenario)?;
    centre.restore(saved)?;
    if centre.next_tick() < 1 << 40 && centre.update(0.5, &vec![None; scenario.robots.len()]).is_ok() {
        assert!(centre.plan().iter().all(|command| command.heading_rad.is_finite()));
    }
    Ok(())
}

/// The log of fusion or simulator, beside a valid log of the other.
pub fn tick_logs(bytes: &[u8]) -> Verdict {
    let (description, [estimate, world]) = &*made::RUN_WITH_LOGS;
    any([results(description, [bytes, world]), results(description, [estimate, bytes])])
}

/// All output that is made from a run's logs.
fn results(description: &RunDescription, logs: [&[u8]; 2]) -> Verdict {
    let folder = tempfile::tempdir()?;
    for (name, log) in made::LOG_NAMES.iter().zip(logs) {
        std::fs::write(folder.path().join(name), log)?;
    }
    let description = RunDescription { out_dir: folder.path().to_owned(), ..description.clone() };
    let mut curves = CurvesBuilder::new(&description.scenario, None);
    let report = report::from_logs(&description, None, Vec::new(), |put_down| curves.add(put_down))?;
    report::write(&report, folder.path())?;
    tables::write_estimate_csv(&description)?;
    tables::write_recording(&description)?;
    // Skipped: slow, and mostly repetitive.
    if logs.concat().len() % 50 == 0 {
        pictures::draw(&report, curves, folder.path())?;
    }
    Ok(())
}

/// A run in one file.
pub fn run_files(bytes: &[u8]) -> Verdict {
    let mut reader = FrameReader::open(bytes)?;
    let scenario = reader.description()?.scenario.clone();
    let mut steps = Steps::new(&scenario)?;
    while let Some(frame) = reader.next_frame()? {
        let estimate = steps.step(&frame)?;
        let _ = difference(&frame, &estimate, steps.commands());
        let _ = Scene::default().update(&scenario, &frame, 0);
    }
    Ok(())
}

/// A ROS 2 bag, of which ranges, bearings and positions are read.
pub fn bags(bytes: &[u8]) -> Verdict {
    let folder = tempfile::tempdir()?;
    std::fs::write(folder.path().join("hostile.mcap"), bytes)?;
    let table = |topic: &str, position: Option<&str>, columns: Option<&str>| RecordingTable {
        ranges: Some("hostile.mcap".to_owned()),
        topic: Some(topic.to_owned()),
        position: position.map(str::to_owned),
        columns: columns.map(str::to_owned),
        ..RecordingTable::default()
    };
    any([
        table("/robot_*/range,/robot_*/bearing", Some("/robot_*/pose"), None),
        table("/tf", None, Some("time=log,sensor=transforms[].child_frame_id,range=transforms[].transform.translation.x:m,bearing=transforms[].transform.rotation,x=transforms[].transform.translation.x:m,y=transforms[].transform.translation.y:m")),
    ]
    .map(|table| {
        let (recording, summary) = input::recording_of(&table, "test", folder.path())?;
        assert!(summary.lines().iter().all(|line| line.lines().count() == 1));
        let numbers = (0..recording.len()).filter_map(|index| recording.instant(index)).flat_map(|(_, all)| all);
        assert!(numbers.flat_map(|one| [one.position_m[0], one.position_m[1], one.range_m.unwrap_or(1.0)]).all(f64::is_finite));
        Ok(())
    }))
}

/// The definition of a message type, up to a zero byte, and a message of that type. All fields are read.
pub fn bag_messages(bytes: &[u8]) -> Verdict {
    let (definition, message) = bytes.split_at(bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len()));
    let types = Types::parse("hostile_msgs/msg/Hostile", std::str::from_utf8(definition)?)?;
    let mut values = Vec::new();
    for path in fields_named(&types, &|_| true) {
        cdr::read(&types, message.get(1..).unwrap_or_default(), &FieldPath::parse(&types, &path)?, &mut values)?;
    }
    Ok(())
}

/// Output of a radio, in each radio's format and split anywhere.
pub fn radio_logs(bytes: &[u8]) -> Verdict {
    any(Format::ALL.map(|format| radio_log(format, bytes)))
}

fn radio_log(format: Format, bytes: &[u8]) -> Verdict {
    let whole = reports(format, &[bytes]);
    assert_eq!(whole, reports(format, &bytes.chunks(1 + bytes.len() % 40).collect::<Vec<_>>()));
    for range in whole.iter().flatten() {
        assert!(range.range_m > 0.0 && range.range_m.is_finite(), "{range:?}");
        assert!(!range.anchor.chars().any(char::is_control), "{range:?}");
    }
    let options =
        |rate_hz, stamp_unit, tag: Option<&str>| LogOptions { rate_hz, stamp_unit, tag: tag.map(str::to_owned) };
    any([
        options(None, None, None),
        options(Some(10.0), Some(StampUnit::Microseconds), Some("0")),
        options(Some(f64::NAN), None, None),
    ]
    .map(|options| {
        let (rows, summary) = read_log(format, bytes, &options)?;
        assert!(!rows.is_empty() && rows.len() as u64 == summary.rows);
        let mut last_s = f64::NEG_INFINITY;
        for row in rows {
            assert!(row.time_s >= last_s && row.time_s.is_finite() && row.range_m > 0.0, "{row:?}");
            last_s = row.time_s;
        }
        Ok(())
    }))
}

/// All ranges of a stream that arrives in these pieces, by report; refused reports are empty.
fn reports(format: Format, pieces: &[&[u8]]) -> Vec<Vec<RadioRange>> {
    let (mut parser, mut all) = (radio::Parser::new(format), Vec::new());
    for piece in pieces {
        parser.push(piece, |report| all.push(report.map_or(Vec::new(), |report| report.ranges.to_vec())));
    }
    let _ = parser.finish();
    all
}
