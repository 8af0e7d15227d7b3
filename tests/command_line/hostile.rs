//! Hostile input: every input is accepted, or refused in one line, without panic, hang or unbounded memory.
//!
//! Each target of `fuzz/` reads its corpus and a bounded number of inputs that are derived from it. `cargo fuzz` finds more.

#[allow(unreachable_pub, dead_code, reason = "to the fuzz targets it is a library")]
#[path = "../../fuzz/src/lib.rs"]
pub(crate) mod targets;

use std::cell::Cell;
use std::fmt::Debug;
use std::ops::Range;
use std::path::Path;
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::time::Duration;

use proptest::collection::vec;
use proptest::num::f64::ANY;
use proptest::prelude::*;
use proptest::sample::{Index, select};
use proptest::test_runner::{RngSeed, TestRunner};
use rangehound::plan::line::LineSolver;
use rangehound::results::report::Truth;
use rangehound_node::rendezvous::RunDescription;
use rangehound_node::world::world_of;
use rangehound_robot::drive::Controller;
use rangehound_robot::pose;
use rangehound_robot::sensor::{self, measure};
use rangehound_shared::measurement::Pose;
use rangehound_shared::message::{Command, Drive, WorldEntry};
use rangehound_shared::recording::{ReadOptions, Recording};
use rangehound_shared::scenario::{PlannerTable, ScenarioFile};

use targets::{Verdict, check, made, project};

/// A case takes microseconds: only an endless one reaches this limit.
const LIMIT: Duration = Duration::from_secs(60);

/// A test for each target: the number of derived inputs, and the generated documents beside those of `fuzz/corpus/`.
macro_rules! attacks {
    ($($target:ident: $cases:literal, $made:expr;)*) => {
        $(#[test]
        fn $target() {
            attack(stringify!($target), $cases, $made, targets::$target);
        })*
    };
}

attacks! {
    scenarios: 20_000, vec![];
    recordings: 10_000, vec![];
    anchors: 10_000, vec![];
    columns: 10_000, vec![];
    calibrations: 10_000, vec![];
    true_tracks: 20_000, vec![];
    plan_lines: 20_000, vec![];
    command_lines: 10_000, vec![];
    names: 20_000, vec![];
    run_descriptions: 20_000, made::run_descriptions();
    checkpoint_files: 4_000, made::checkpoint_files();
    node_states: 20_000, made::node_states();
    tick_logs: 2_000, made::tick_logs();
    run_files: 4_000, made::run_files();
    radio_logs: 10_000, vec![];
    bags: 2_000, made::bags();
    bag_messages: 20_000, vec![];
}

fn attack(name: &str, cases: u32, mut accepted: Vec<Vec<u8>>, target: fn(&[u8]) -> Verdict) {
    let watchdog = watchdog(name.to_owned());
    let feed = |bytes: &[u8]| {
        watchdog.send(bytes.to_vec()).unwrap();
        check(target, bytes)
    };
    let folder = project().join("fuzz/corpus").join(name);
    accepted.extend(documents(&folder.join("accepted")));
    for bytes in &accepted {
        let verdict = feed(bytes);
        assert!(verdict.is_ok(), "{name}: {} is refused: {verdict:?}", bytes.escape_ascii());
    }
    for bytes in documents(&folder.join("refused")) {
        assert!(feed(&bytes).is_err(), "{name}: {} is accepted", bytes.escape_ascii());
    }
    let count = Cell::new(0);
    for_all(cases, &derived(accepted), |Input(bytes)| count.set(count.get() + u32::from(feed(&bytes).is_ok())));
    // Derived inputs of only one kind would test half of a reader.
    assert!(count.get() > 0, "{name}: none of {cases} derived inputs is accepted");
    println!("{name}: {} of {cases} derived inputs are accepted", count.get());
}

/// The files of a folder, if it exists, always in the same order.
fn documents(folder: &Path) -> Vec<Vec<u8>> {
    // Valid documents of formats that follow the protocol version are generated, so there may be no folder for them.
    let mut files: Vec<_> = std::fs::read_dir(folder).into_iter().flatten().map(|file| file.unwrap().path()).collect();
    files.sort();
    files.iter().map(|file| std::fs::read(file).unwrap()).collect()
}

/// Uses the same values in each run; a failing value is minimised.
fn for_all<S: Strategy>(cases: u32, strategy: &S, test: impl Fn(S::Value)) {
    let config =
        ProptestConfig { cases, failure_persistence: None, rng_seed: RngSeed::Fixed(1), ..ProptestConfig::default() };
    let done = TestRunner::new(config).run(strategy, |value| {
        test(value);
        Ok(())
    });
    done.unwrap_or_else(|failure| panic!("{failure}"));
}

#[derive(Clone)]
struct Input(Vec<u8>);

impl Debug for Input {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "b\"{}\"", self.0.escape_ascii())
    }
}

/// Documents in which words and separators are lost, added or changed.
fn derived(documents: Vec<Vec<u8>>) -> impl Strategy<Value = Input> + Clone {
    let hostile = include_str!("../../fuzz/words.dict").lines().map(|line| line.trim_matches('"').as_bytes().to_vec());
    let piece = prop_oneof![
        1 => Just(vec![]),
        1 => select(hostile.collect::<Vec<_>>()),
        2 => (select(documents.clone()), any::<Index>(), 0..40_usize).prop_map(|(document, at, len)| {
            let words = in_words(&document);
            words[within(&words, at, len)].concat()
        }),
        1 => vec(any::<u8>(), 1..12),
    ];
    let len = prop_oneof![9 => 0..3_usize, 1 => 0..1_000_usize];
    (select(documents), vec((any::<Index>(), len, piece), 1..5)).prop_map(|(document, edits)| {
        let mut words = in_words(&document);
        for (at, len, piece) in &edits {
            words.splice(within(&words, *at, *len), [&piece[..]]);
        }
        Input(words.concat())
    })
}

fn in_words(document: &[u8]) -> Vec<&[u8]> {
    let is_part = |byte: &u8| byte.is_ascii_alphanumeric() || b"+-._".contains(byte);
    document.chunk_by(|a, b| is_part(a) && is_part(b)).collect()
}

fn within<T>(list: &[T], at: Index, len: usize) -> Range<usize> {
    let at = at.index(list.len() + 1);
    at..list.len().min(at + len)
}

/// Ends the test process if an input takes too long.
fn watchdog(name: String) -> Sender<Vec<u8>> {
    let (sender, inputs) = channel::<Vec<u8>>();
    std::thread::spawn(move || {
        let mut last = Vec::new();
        loop {
            match inputs.recv_timeout(LIMIT) {
                Ok(bytes) => last = bytes,
                Err(RecvTimeoutError::Disconnected) => return,
                Err(RecvTimeoutError::Timeout) => {
                    eprintln!("{name}: has not ended in {LIMIT:?}: b\"{}\"", last.escape_ascii());
                    std::process::abort();
                }
            }
        }
    });
    sender
}

/// Checksums detect all damage except forged checksums, so libFuzzer cannot test this.
#[test]
fn no_damage_passes_a_checksum() {
    let sealed: Vec<_> =
        made::run_descriptions().into_iter().filter(|bytes| RunDescription::open(bytes).is_ok()).collect();
    assert!(!sealed.is_empty());
    for_all(20_000, &derived(sealed.clone()), |Input(bytes)| {
        assert!(RunDescription::open(&bytes).is_err() || sealed.contains(&bytes));
    });
    let states = [made::state(3), made::state(4)];
    let slots = derived(made::checkpoint_files());
    for_all(4_000, &(slots.clone(), slots), |(Input(first), Input(second))| {
        for second in [&second, &made::CHECKPOINT_SLOTS[1]] {
            let found = targets::checkpoint_file(&first, second).ok().flatten();
            assert!(found.is_none_or(|found| states.contains(&found)));
        }
    });
}

/// A few million bytes that stress recursion, repetition and length.
#[test]
fn long_input_is_accepted_or_refused() {
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
            let mut solver = LineSolver::new(PlannerTable::default(), 1).unwrap();
            solver.answer(1, text.as_bytes(), &mut Vec::new());
        }
    }
}

/// Messages that broken nodes of this run could send.
#[test]
fn hostile_messages() {
    let scenario = made::scenario("paper.toml");
    let limit_mps = scenario.robots[0].speed_mps;
    let number = prop_oneof![ANY, select(vec![f64::MAX, f64::MIN, 5e-324, 1.0, -1.0, 1e18, -1e18, 1e100, 3.5])];
    let word = prop_oneof![any::<u64>(), 0..300_u64, select(vec![1 << 32, i64::MAX as u64, u64::MAX - 1, u64::MAX])];
    let drive = ([number.clone(), number.clone()], [(); 5].map(|()| word.clone())).prop_map(|(numbers, words)| Drive {
        robot: words[0],
        heading_rad: numbers[0],
        speed_mps: numbers[1],
        range_sent_ns: words[1],
        heading_held_ns: words[2],
        heading_late: words[3] as u32,
        headings_refused: words[4] as u32,
        network_ns: words[0] % 1_000,
        robot_host_ns: words[1] as u32,
        gateway_ns: words[2] as u32,
    });
    let bits = prop_oneof![2 => 0..4_u64, 1 => word.clone()];
    let entry = ([(); 10].map(|()| number.clone()), bits.clone(), bits);
    let entry = entry.prop_map(|(numbers, kinds, origin)| {
        let [x_m, y_m, range_m, height_m, xx_m2, xy_m2, yy_m2, heading_rad, heading_std_rad, bearing_rad] = numbers;
        let covariance_m2 = [xx_m2, xy_m2, yy_m2];
        let pose = Pose { x_m, y_m, height_m, heading_rad, covariance_m2, heading_std_rad };
        WorldEntry { pose, kinds, origin, range_m, bearing_rad }
    });
    let command = [number.clone(), number].prop_map(|[heading_rad, speed_mps]| Command { heading_rad, speed_mps });
    let step = (command, [(); 3].map(|()| word.clone()), entry, vec(proptest::option::of(drive), 0..6));
    let equipment = (sensor::of_scenario(&scenario, 0).unwrap(), pose::of_scenario(&scenario, 0).unwrap());
    let equipment = std::cell::RefCell::new(equipment);
    for_all(20_000, &vec(step, 4), |steps| {
        let mut controller = Controller::new(limit_mps);
        let mut world = world_of(&scenario, Path::new("")).unwrap();
        for (command, [given, asked, tick], entry, drives) in steps {
            for driven in [controller.obey(given, command), controller.hold(asked)] {
                assert!(driven.heading_rad.is_finite() && (0.0..=limit_mps).contains(&driven.speed_mps), "{driven:?}");
            }
            let (sensor, poses) = &mut *equipment.borrow_mut();
            let measured = measure(sensor.as_mut(), poses.as_mut(), (tick, 0.1), &entry);
            let values = [measured.range(), measured.bearing()];
            assert!(values.into_iter().flatten().all(|(value, _)| value.is_finite()), "{entry:?} {measured:?}");
            let _ = drives.iter().flatten().filter_map(Drive::latency_ns).max();
            world.advance(&drives);
            assert!(world.entries().iter().all(|entry| entry.is_valid()));
        }
    });
}
