//! Valid documents in the program's own formats. They change with its protocol, so they are generated, not kept in `corpus/`.

use std::fs::read;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use mcap::records::op;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader};
use rangehound::files::input;
use rangehound::results::frame::{Frame, Frames};
use rangehound::results::ros_bag::write::BagWriter;
use rangehound::results::run_mcap::write::FrameWriter;
use rangehound::run::in_process;
use rangehound_fusion::Centre;
use rangehound_node::checkpoint::Checkpoint;
use rangehound_node::rendezvous::RunDescription;
use rangehound_node::world::world_of;
use rangehound_shared::protocol::{PROGRAM, PROTOCOL};
use rangehound_shared::scenario::Scenario;
use rangehound_shared::sealed;
use ruzstd::encoding::{CompressionLevel, compress_to_vec};
use xxhash_rust::xxh3::xxh3_64;

use super::project;

/// The id of every generated run, so that one process accepts the documents of another.
pub const RUN_ID: u64 = 7;

/// Writes generated documents to the corpus folder of a target, for libFuzzer.
pub fn write_to_corpus(target: &str, documents: Vec<Vec<u8>>) {
    let folder = project().join("fuzz/corpus").join(target);
    std::fs::create_dir_all(&folder).unwrap();
    for (number, bytes) in documents.iter().enumerate() {
        std::fs::write(folder.join(format!("made-{number}")), bytes).unwrap();
    }
}

/// One of the project's scenarios.
#[must_use]
pub fn scenario(file: &str) -> Scenario {
    let path = project().join("scenarios").join(file);
    input::scenario(&input::scenario_file(&path).unwrap(), file, path.parent().unwrap()).unwrap()
}

fn description(file: &str, out_dir: PathBuf) -> RunDescription {
    RunDescription { run_id: RUN_ID, ..RunDescription::new(scenario(file), out_dir) }
}

/// Sealed descriptions of runs, and their bodies.
#[must_use]
pub fn run_descriptions() -> Vec<Vec<u8>> {
    let files = ["paper.toml", "mixed_team.toml", "mixed_sensors.toml", "custom_model.toml", "recording/replay.toml"];
    let descriptions = files.map(|file| description(file, PathBuf::from("/nowhere")));
    let sealed = descriptions.iter().map(|description| description.seal().unwrap().into_bytes());
    let bodies = descriptions.iter().map(|description| serde_json::to_vec(description).unwrap());
    sealed.chain(bodies).collect()
}

fn encoded(value: &impl serde::Serialize) -> Vec<u8> {
    let mut bytes = Vec::new();
    sealed::encode_into(value, &mut bytes).unwrap();
    bytes
}

/// A sealed description with this body: the checksum matches, so it does not reveal damage.
#[must_use]
pub fn sealed_body(body: &[u8]) -> Vec<u8> {
    let checksum = xxh3_64(&[format!("{PROGRAM} {PROTOCOL} ").as_bytes(), body].concat());
    let head = format!(r#"{{"program":"{PROGRAM}","protocol":{PROTOCOL},"checksum":"{checksum:016x}","description":"#);
    [head.as_bytes(), body, b"}\n"].concat()
}

/// The state in the checkpoints.
pub type State = (u64, Vec<f64>);

/// Offset of a checkpoint's second slot.
pub const SLOT_LEN: u64 = 1 << 20;

/// The slots of a checkpoint, with the states 4 and 3.
pub static CHECKPOINT_SLOTS: LazyLock<[Vec<u8>; 2]> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sim.checkpoint");
    let (mut checkpoint, _) = Checkpoint::open::<State>(&path, RUN_ID).unwrap();
    (1..=4).for_each(|k| checkpoint.write(&state(k)).unwrap());
    let whole = read(&path).unwrap();
    let second = whole[SLOT_LEN as usize..].to_vec();
    [whole[..second.len()].to_vec(), second]
});

/// The state that was saved at a tick.
#[must_use]
pub fn state(tick: u64) -> State {
    (tick, vec![0.5 * tick as f64; 40])
}

/// The valid slots.
#[must_use]
pub fn checkpoint_files() -> Vec<Vec<u8>> {
    CHECKPOINT_SLOTS.to_vec()
}

/// A simulated scenario and a recorded one.
pub static SCENARIOS_OF_STATES: LazyLock<[Scenario; 2]> =
    LazyLock::new(|| ["paper.toml", "recording/replay.toml"].map(scenario));

/// States of a simulator and of fusion after some ticks.
#[must_use]
pub fn node_states() -> Vec<Vec<u8>> {
    let mut states = Vec::new();
    for scenario in &*SCENARIOS_OF_STATES {
        let mut world = world_of(scenario, Path::new("")).unwrap();
        (0..3).for_each(|_| world.advance(&[]));
        let mut bytes = Vec::new();
        world.save(&mut bytes).unwrap();
        states.push(bytes);

        let mut centre = Centre::new(scenario).unwrap();
        for tick in 0..4 {
            centre.update(0.1 * f64::from(tick), &vec![None; scenario.robots.len()]).unwrap();
            centre.plan();
        }
        states.push(encoded(&centre.saved().unwrap()));
    }
    states
}

/// The logs of fusion and simulator.
pub const LOG_NAMES: [&str; 2] = ["estimate.ticks", "world.ticks"];

/// A short run and its logs.
pub static RUN_WITH_LOGS: LazyLock<(RunDescription, [Vec<u8>; 2])> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    let mut description = description("paper.toml", folder.path().to_owned());
    description.scenario.ticks = 12;
    in_process::run(&description, |_| {}).unwrap();
    (description, LOG_NAMES.map(|name| read(folder.path().join(name)).unwrap()))
});

/// The valid logs.
#[must_use]
pub fn tick_logs() -> Vec<Vec<u8>> {
    RUN_WITH_LOGS.1.to_vec()
}

/// Runs in one file, in three forms: as the recorder writes them, where checksums detect damage; without chunks and checksums,
/// where damage reaches the messages; and compressed with zstd, where it reaches the decoder.
#[must_use]
pub fn run_files() -> Vec<Vec<u8>> {
    let kinds = |file: &&str| {
        let (description, frames) = frames(file, 5);
        let recorded = recorded(&description, &frames);
        [with_chunks(&recorded, <[u8]>::to_vec), with_zstd(&recorded), recorded]
    };
    ["paper.toml", "recording/replay.toml"].iter().flat_map(kinds).collect()
}

/// Bags of runs with ranges, with bearings and of a recording. The messages are in no chunk, where damage reaches them.
#[must_use]
pub fn bags() -> Vec<Vec<u8>> {
    let bag = |file: &&str| {
        let (description, frames) = frames(file, 3);
        let out = std::io::Cursor::new(Vec::new());
        let mut writer = BagWriter::begin(out, &description.scenario, u64::MAX).unwrap();
        frames.iter().for_each(|frame| _ = writer.write(frame).unwrap());
        with_chunks(&writer.finish().unwrap().0.into_inner(), <[u8]>::to_vec)
    };
    ["paper.toml", "mixed_sensors.toml", "recording/replay.toml"].iter().map(bag).collect()
}

/// The frames of a run in one process, and the run's description.
#[must_use]
pub fn frames(file: &str, ticks: u64) -> (RunDescription, Vec<Frame>) {
    let folder = tempfile::tempdir().unwrap();
    let mut description = description(file, folder.path().to_owned());
    description.scenario.ticks = ticks;
    in_process::run(&description, |_| {}).unwrap();
    let mut logs = Frames::open(&description).unwrap();
    let frames = (0..=ticks).map(|tick| logs.at(tick).unwrap().unwrap()).collect();
    (description, frames)
}

/// A recording of these frames.
#[must_use]
pub fn recorded(description: &RunDescription, frames: &[Frame]) -> Vec<u8> {
    let mut writer =
        FrameWriter::begin(std::io::Cursor::new(Vec::new()), description, Some(b"name = \"x\""), u64::MAX).unwrap();
    frames.iter().for_each(|frame| _ = writer.write(frame).unwrap());
    writer.finish().unwrap().into_inner()
}

const MAGIC: &[u8] = b"\x89MCAP0\r\n";

/// A skippable zstd frame.
const SKIPPABLE: &[u8] = b"\x50\x2a\x4d\x18\x03\0\0\0abc";

/// Least bytes of a chunk before compression.
const CHUNK: usize = 100_000;

fn record(opcode: u8, body: &[u8]) -> Vec<u8> {
    [&[opcode][..], &(body.len() as u64).to_le_bytes(), body].concat()
}

/// The checksum of a chunk.
fn crc32(bytes: &[u8]) -> u32 {
    let step = |crc: u32, _| if crc & 1 != 0 { crc >> 1 ^ 0xEDB8_8320 } else { crc >> 1 };
    !bytes.iter().fold(u32::MAX, |crc, byte| (0..8).fold(crc ^ u32::from(*byte), step))
}

/// A chunk of these records, in two frames with a skippable frame between them.
fn chunk(records: &[u8]) -> Vec<u8> {
    let (first, second) = records.split_at(records.len() / 3);
    let frame = |bytes: &[u8]| compress_to_vec(bytes, CompressionLevel::Fastest);
    chunk_of(records.len() as u64, crc32(records), &[&frame(first)[..], SKIPPABLE, &frame(second)].concat())
}

/// The same with the given compressed bytes and claimed lengths.
#[must_use]
pub fn chunk_of(len: u64, crc: u32, compressed: &[u8]) -> Vec<u8> {
    let mut body = vec![0; 16];
    body.extend(len.to_le_bytes());
    body.extend(crc.to_le_bytes());
    body.extend(4_u32.to_le_bytes());
    body.extend(b"zstd");
    body.extend((compressed.len() as u64).to_le_bytes());
    body.extend(compressed);
    record(op::CHUNK, &body)
}

/// The same file with zstd chunks, and without index.
#[must_use]
pub fn with_zstd(bytes: &[u8]) -> Vec<u8> {
    with_chunks(bytes, chunk)
}

fn with_chunks(bytes: &[u8], chunk: fn(&[u8]) -> Vec<u8>) -> Vec<u8> {
    let (mut out, mut records) = (MAGIC.to_vec(), Vec::new());
    let mut reader = LinearReader::new();
    let mut input = bytes;
    while let Some(event) = reader.next_event() {
        match event.unwrap() {
            LinearReadEvent::ReadRequest(wanted) => {
                let count = wanted.min(input.len());
                reader.insert(count).copy_from_slice(&input[..count]);
                reader.notify_read(count);
                input = &input[count..];
            }
            LinearReadEvent::Record { opcode: op::DATA_END, .. } => break,
            LinearReadEvent::Record { opcode: opcode @ (op::SCHEMA | op::CHANNEL | op::MESSAGE), data } => {
                records.extend(record(opcode, data));
                if records.len() >= CHUNK {
                    out.extend(chunk(&std::mem::take(&mut records)));
                }
            }
            LinearReadEvent::Record { opcode: op::MESSAGE_INDEX, .. } => {}
            LinearReadEvent::Record { opcode, data } => out.extend(record(opcode, data)),
        }
    }
    out.extend(chunk(&records));
    out.extend(record(op::DATA_END, &[0; 4]));
    out.extend(record(op::FOOTER, &[0; 20]));
    out.extend(MAGIC);
    out
}
