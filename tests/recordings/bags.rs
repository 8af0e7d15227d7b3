//! ROS 2 bags: a run's own bag is tracked as the run itself, bags of others are read by each flag, and damaged ones are refused.

use std::collections::BTreeMap;
use std::fs::File;
use std::path::Path;

use rangehound::files::bag::cdr::{self, Writer};
use rangehound::files::bag::definition::Types;
use rangehound::files::bag::interfaces;
use rangehound::files::bag::path::Path as FieldPath;
use rusqlite::Connection;
use serde_json::Value;

use crate::support::{Outcome, Run};

/// A message type of one's own.
const MANY: &str = "std_msgs/Header header\nOne[] ranges\nfloat32[] distances_m\nfloat32 angle\nuint64 stamp_us\nstring tag\n\
                    ================================================================================\nMSG: uwb_msgs/One\n\
                    string anchor_id\nuint32 distance\ngeometry_msgs/Point at\n";

/// One message: topic, type, definition, time of recording (ns), bytes.
pub(crate) struct Message {
    pub(crate) topic: &'static str,
    pub(crate) type_name: &'static str,
    pub(crate) definition: String,
    pub(crate) log_ns: u64,
    pub(crate) bytes: Vec<u8>,
}

pub(crate) fn header(out: &mut Writer, time_ns: u64, frame: &str) {
    out.begin();
    out.i32((time_ns / 1_000_000_000) as i32);
    out.u32((time_ns % 1_000_000_000) as u32);
    out.text(frame);
}

pub(crate) fn range(topic: &'static str, time_ns: u64, frame: &str, range_m: f32) -> Message {
    let mut out = Writer::default();
    header(&mut out, time_ns, frame);
    out.u8(0);
    for number in [0.0, 0.1, 50.0, range_m, 0.0] {
        out.f32(number);
    }
    let interface = interfaces::RANGE;
    Message {
        topic,
        type_name: interface.name,
        definition: interface.text(),
        log_ns: time_ns + 5,
        bytes: out.bytes().to_vec(),
    }
}

fn pose(topic: &'static str, time_ns: u64, x_m: f64, y_m: f64) -> Message {
    let mut out = Writer::default();
    header(&mut out, time_ns, "map");
    out.f64s(&[x_m, y_m, 0.5, 0.0, 0.0, 0.0, 1.0]);
    let interface = interfaces::POSE;
    Message {
        topic,
        type_name: interface.name,
        definition: interface.text(),
        log_ns: time_ns,
        bytes: out.bytes().to_vec(),
    }
}

pub(crate) fn many(time_ns: u64, ranges: &[(&str, u32, [f64; 2])], tag: &str) -> Message {
    let mut out = Writer::default();
    header(&mut out, time_ns, "tag");
    out.u32(ranges.len() as u32);
    for (name, distance, [x_m, y_m]) in ranges {
        out.text(name);
        out.u32(*distance);
        out.f64s(&[*x_m, *y_m, 0.0]);
    }
    out.u32(ranges.len() as u32);
    for (_, distance, _) in ranges {
        out.f32(*distance as f32 / 1000.0);
    }
    out.f32(0.25);
    // A number of eight bytes, as a floating-point one is.
    out.f64s(&[f64::from_bits(time_ns / 1_000)]);
    out.text(tag);
    Message {
        topic: "/tag",
        type_name: "uwb_msgs/msg/Many",
        definition: MANY.to_owned(),
        log_ns: time_ns,
        bytes: out.bytes().to_vec(),
    }
}

/// Writes a bag of one MCAP file.
pub(crate) fn write_mcap(path: &Path, messages: &[Message]) {
    let mut mcap = mcap::WriteOptions::new().profile("ros2").create(File::create(path).unwrap()).unwrap();
    for (sequence, message) in messages.iter().enumerate() {
        let schema = mcap.add_schema(message.type_name, "ros2msg", message.definition.as_bytes()).unwrap();
        let channel_id = mcap.add_channel(schema, message.topic, "cdr", &BTreeMap::new()).unwrap();
        let (log_time, publish_time) = (message.log_ns, message.log_ns);
        let header = mcap::records::MessageHeader { channel_id, sequence: sequence as u32, log_time, publish_time };
        mcap.write_to_known_channel(&header, &message.bytes).unwrap();
    }
    mcap.finish().unwrap();
}

/// Writes a bag of one sqlite3 file as Humble does: without definitions.
fn write_sqlite(path: &Path, messages: &[Message]) {
    let file = Connection::open(path).unwrap();
    file.execute_batch(
        "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, serialization_format TEXT NOT NULL, \
         offered_qos_profiles TEXT NOT NULL);\
         CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, data BLOB NOT NULL);",
    )
    .unwrap();
    let mut topics: Vec<&str> = Vec::new();
    for message in messages {
        if !topics.contains(&message.topic) {
            topics.push(message.topic);
            let id = topics.len() as i64;
            file.execute("INSERT INTO topics VALUES (?1, ?2, ?3, 'cdr', '')", (id, message.topic, message.type_name))
                .unwrap();
        }
        let id = topics.iter().position(|topic| *topic == message.topic).unwrap() as i64 + 1;
        let row = (id, message.log_ns.cast_signed(), &message.bytes);
        file.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (?1, ?2, ?3)", row).unwrap();
    }
}

/// Tracks a bag; the rows of the run's copy of it.
#[track_caller]
fn copy(run: &Run, words: &str) -> Vec<String> {
    let outcome = track(run, words);
    assert_eq!(outcome.code, Some(0), "{outcome:#?}");
    run.read("recording.csv").lines().map(str::to_owned).collect()
}

fn track(run: &Run, words: &str) -> Outcome {
    run.command(&format!("track {words} --in-process")).finish()
}

#[track_caller]
fn assert_refused(run: &Run, words: &str, expected: &str) {
    let refused = track(run, words);
    assert_eq!((refused.code, refused.complaints().len()), (Some(2), 1), "{words}: {refused:#?}");
    assert!(refused.stderr.contains(expected), "{words}: {refused:#?}");
}

const ANCHORS: &str =
    "sensor_id,x_m,y_m\na,0,0\nb,9,0\nc,0,9\n0A,1,2\n0B,4,5\n0,1,2\n1,4,5\n/tag,1,1\n/uwb/range,1,1\n";

#[test]
fn a_runs_own_bag_is_tracked_as_the_run_is() {
    let run = Run::new();
    let scenario = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/mixed_team.toml");
    let words = format!("run {} --clock lockstep --in-process --ticks 300 --write-recording", scenario.display());
    run.command(&words).finish().succeeded();
    let recorded = run.start(&["record", "out", "--ros2", "bag", "--json"]).finish();
    assert_eq!(recorded.code, Some(0), "{recorded:#?}");
    let summary: Value = serde_json::from_str(&recorded.stdout).unwrap();
    assert_eq!((&summary["ticks"], &summary["file"]), (&300.into(), &"bag".into()), "{summary}");
    let metadata = std::fs::read_to_string(run.path("bag/metadata.yaml")).unwrap();
    for expected in [
        "version: 9",
        "name: /target/truth",
        "name: /robot_2/range",
        "name: /rangehound/markers",
        "message_count: 301",
        "RIHS01_",
        "stamp_minus_run_time_ns: \"1000000000\"",
    ] {
        assert!(metadata.contains(expected), "{metadata}");
    }

    let report = |words: &str, truth: &str| -> (Value, usize) {
        let tracked = Run::new();
        let paths = words.replace("HERE", run.path("").to_str().unwrap());
        let truth = truth.replace("HERE", run.path("").to_str().unwrap());
        let outcome = track(&tracked, &format!("{paths} {truth} --range-std 1 --json"));
        assert_eq!(outcome.code, Some(0), "{outcome:#?}");
        (serde_json::from_str(&outcome.stdout).unwrap(), tracked.read("recording.csv").lines().count())
    };
    let of_csv = report("HEREout/ranges.csv", "--truth HEREout/truth.csv");
    let of_bag = report("HEREbag --topic /robot_*/range --position /robot_*/pose", "--truth-topic /target/truth");
    assert_eq!(of_bag.1, of_csv.1);
    let rmse_m = [&of_bag, &of_csv].map(|(report, _)| report["position_rmse_m"].as_f64().unwrap());
    assert!((rmse_m[0] / rmse_m[1] - 1.0).abs() < 0.01 && rmse_m[0] < 2.0, "{rmse_m:?}");
    let of_file = report("HEREbag/bag_0.mcap --topic /robot_*/range --position /robot_*/pose:pose.pose", "");
    assert_eq!(of_file.0["digest"], of_bag.0["digest"]);
    run.assert_nothing_left();
}

#[test]
fn markers_and_diagnostics_of_a_bag_are_those_of_the_estimate() {
    let run = Run::new();
    run.write("s.toml", "ticks = 255\ndt_s = 0.1\n[filter]\ngate_sigma = 1.0\ndistrust = false\n[robots]\ncount = 3\n");
    run.command("run s.toml --clock lockstep --in-process").finish().succeeded();
    assert_eq!(run.start(&["record", "out", "--ros2", "bag"]).finish().code, Some(0));
    let bytes = std::fs::read(run.path("bag/bag_0.mcap")).unwrap();
    let of_topic = |topic: &str, paths: &[&str]| -> Vec<Vec<Value>> {
        let messages = mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap);
        let messages = messages.filter(|message| message.channel.topic == topic);
        messages
            .map(|message| {
                let schema = message.channel.schema.as_ref().unwrap();
                let types = Types::parse(&schema.name, std::str::from_utf8(&schema.data).unwrap()).unwrap();
                let mut values = Vec::new();
                for path in paths {
                    cdr::read(&types, &message.data, &FieldPath::parse(&types, path).unwrap(), &mut values).unwrap();
                }
                values.iter().map(|value| value.text().parse().unwrap_or_else(|_| value.text().into())).collect()
            })
            .collect()
    };
    let number = |value: &Value| value.as_f64().unwrap();

    let rows: Vec<Vec<f64>> = run
        .read("estimate.csv")
        .lines()
        .skip(1)
        .map(|row| row.split(',').map(|cell| cell.parse().unwrap()).collect())
        .collect();
    let ellipse =
        ["pose.position.x", "pose.position.y", "scale.x", "scale.y"].map(|field| format!("markers[0].{field}"));
    let drawn = of_topic("/rangehound/markers", &ellipse.each_ref().map(String::as_str));
    assert_eq!((drawn.len(), rows.len()), (256, 256));
    for (row, drawn) in rows.iter().zip(&drawn) {
        let [x_m, y_m, long_m, short_m] = [0, 1, 2, 3].map(|index| number(&drawn[index]));
        assert_eq!([x_m, y_m], [row[1], row[2]]);
        // Six standard deviations: the axes have the trace and the determinant of the covariance.
        let [xx, xy, yy] = [row[5], row[6], row[7]];
        let [long, short] = [long_m, short_m].map(|axis_m| axis_m * axis_m / 36.0);
        assert!(((long + short) / (xx + yy) - 1.0).abs() < 1e-9 && long >= short, "{row:?} {drawn:?}");
        assert!((long * short / (xx * yy - xy * xy) - 1.0).abs() < 1e-6, "{row:?} {drawn:?}");
    }

    let diagnostics =
        of_topic("/diagnostics", &["status[0].name", "status[0].values[].key", "status[0].values[].value"]);
    // Once in a second of the run, and at its end.
    assert_eq!(diagnostics.len(), 27);
    let of = |status: &[Value], key: &str| {
        let place = status.iter().position(|text| text == key).unwrap_or_else(|| panic!("{key}: {status:?}"));
        status[place + (status.len() - 1) / 2].clone()
    };
    assert!(
        diagnostics.iter().all(|status| status[0] == "rangehound: estimate" && of(status, "silent robots") == "none"),
        "{diagnostics:?}"
    );
    let ticks: Vec<f64> = diagnostics.iter().map(|status| number(&of(status, "tick"))).collect();
    assert_eq!((&ticks[..3], ticks[26]), (&[0.0, 10.0, 20.0][..], 255.0));
    let rejected: f64 = diagnostics.iter().map(|status| number(&of(status, "rejected since the last status"))).sum();
    let report = run.report();
    assert!(rejected > 0.0 && rejected == number(&report["ranges"]["rejected"]), "{rejected}: {}", report["ranges"]);
}

#[test]
fn a_tracked_recording_with_bearings_has_a_bag_too() {
    let run = Run::new();
    let rows: String = (0..40)
        .map(|k| {
            format!(
                "{}.5,a,0,0,{},0.5,0.1\n{}.5,b,9,0,7,,\n",
                1_700_000_000 + k,
                5.0 + 0.1 * f64::from(k),
                1_700_000_000 + k
            )
        })
        .collect();
    run.write(
        "r.csv",
        format!("time_s,sensor_id,sensor_x_m,sensor_y_m,range_m,bearing_rad,sensor_heading_rad\n{rows}"),
    );
    track(&run, "r.csv").succeeded();
    let recorded = run.start(&["record", "out", "--ros2", "bag"]).finish();
    assert_eq!(recorded.code, Some(0), "{recorded:#?}");
    let metadata = std::fs::read_to_string(run.path("bag/metadata.yaml")).unwrap();
    assert!(
        metadata.contains("nanoseconds_since_epoch: 1700000000500000000"),
        "its stamps are the recording's: {metadata}"
    );
    assert!(
        !metadata.contains("cmd_vel") && !metadata.contains("truth") && metadata.contains("/robot_0/bearing"),
        "{metadata}"
    );
    let again = Run::new();
    let bag = run.path("bag");
    let topics = "--topic /robot_*/range,/robot_*/bearing --position /robot_*/pose";
    let copied = copy(&again, &format!("{} {topics}", bag.display()));
    assert_eq!(copied[0], "time_s,sensor_id,sensor_x_m,sensor_y_m,sensor_z_m,range_m,bearing_rad,sensor_heading_rad");
    assert_eq!(copied.len(), 81, "range and bearing of a time are one row");
    let row: Vec<f64> = copied[1].split(',').map(|number| number.parse().unwrap()).collect();
    let expected = [1_700_000_000.5, 0.0, 0.0, 0.0, 0.0, 5.0, 0.5, 0.1];
    assert!(row.iter().zip(expected).all(|(number, expected)| (number - expected).abs() < 1e-12), "{row:?}");
    assert_eq!(copied[2], "1700000000.5,1,9,0,0,7,,");
}

#[test]
fn only_its_own_bag_is_replaced_by_another() {
    let run = Run::new();
    run.lockstep("--in-process --ticks 20").finish().succeeded();
    let record = |words: &[&str]| run.start(&[&["record"], words].concat()).finish();
    for _ in 0..2 {
        assert_eq!(record(&["out", "--ros2", "bag"]).code, Some(0));
    }
    std::fs::create_dir(run.path("mine")).unwrap();
    run.write("mine/notes", "kept");
    run.write("file", "kept");
    for (words, expected) in [
        (vec!["out", "--ros2", "mine"], "rangehound did not make"),
        (vec!["out", "--ros2", "file"], "not a folder"),
        (vec!["out", "--ros2", "out"], "lies where results would go"),
        (vec!["out", "--ros2", "x", "--out", "y"], "cannot be used with"),
        (vec!["none", "--ros2", "x"], "expected the folder of a run"),
    ] {
        let refused = record(&words);
        assert_eq!(refused.code, Some(2), "{words:?}: {refused:#?}");
        assert!(refused.stderr.contains(expected), "{words:?}: {refused:#?}");
    }
    run.write("bag/metadata.yaml", "edited");
    let refused = record(&["out", "--ros2", "bag"]);
    assert_eq!(refused.code, Some(2), "{refused:#?}");
    assert_eq!(std::fs::read_to_string(run.path("bag/metadata.yaml")).unwrap(), "edited");
    assert!(!run.path("x").exists() && !run.path("mine/metadata.yaml").exists());
}

#[test]
fn ranges_of_the_standard_type_need_a_topic_only() {
    let run = Run::new();
    run.write("anchors.csv", ANCHORS);
    let second = 1_000_000_000;
    let messages = [
        range("/uwb/range", 1_700_000_000 * second + second / 4, "b", 2.5),
        range("/uwb/range", 1_700_000_000 * second, "a", 3.25),
        range("/uwb/range", 1_700_000_001 * second, "c", f32::INFINITY),
        range("/uwb/range", 1_700_000_002 * second, "c", 60.0),
        range("/uwb/range", 1_700_000_003 * second, "c", 4.0),
    ];
    write_mcap(&run.path("r.mcap"), &messages);
    write_sqlite(&run.path("r.db3"), &messages);
    let expected = [
        "time_s,sensor_id,sensor_x_m,sensor_y_m,range_m",
        "1700000000,a,0,0,3.25",
        "1700000000.25,b,9,0,2.5",
        "1700000003,c,0,9,4",
    ];
    for file in ["r.mcap", "r.db3"] {
        let tracked = track(&run, &format!("{file} --topic /uwb/range --anchors anchors.csv"));
        assert_eq!(tracked.code, Some(0), "{tracked:#?}");
        assert!(
            tracked.stderr.contains("3 ranges of 3 sensors") && tracked.stderr.contains("2 rows with range 0 left out"),
            "{tracked:#?}"
        );
        assert_eq!(run.read("recording.csv").lines().collect::<Vec<_>>(), expected, "{file}");
    }
    let by_topic = copy(&run, "r.mcap --topic /uwb/range --anchors anchors.csv --columns sensor=topic,time=log");
    assert_eq!(by_topic[1], "1700000000.000000005,/uwb/range,1,1,3.25".replace("1700000000.000000005", "1700000000"));
}

#[test]
fn fields_of_ones_own_messages_are_chosen_by_name() {
    let run = Run::new();
    run.write("anchors.csv", ANCHORS);
    let at = |k: u64| k * 100_000_000;
    let ranges = |k: u32| [("0A", 1500 + k, [1.0, 2.0]), ("0B", 2500, [4.0, 5.0])];
    let messages: Vec<Message> =
        (10..30).map(|k| many(at(k), &ranges(k as u32), if k % 2 == 0 { "red" } else { "blue" })).collect();
    std::fs::create_dir(run.path("bag")).unwrap();
    write_mcap(&run.path("bag/bag_0.mcap"), &messages[..10]);
    write_mcap(&run.path("bag/bag_1.mcap"), &messages[10..]);
    let anchors = "bag --topic /tag --anchors anchors.csv";
    let nested = copy(&run, &format!("{anchors} --field ranges[].distance:mm --columns sensor=ranges[].anchor_id"));
    assert_eq!((nested.len(), nested[1].as_str(), nested[2].as_str()), (41, "1,0A,1,2,1.51", "1,0B,4,5,2.5"));
    let indexed = copy(&run, &format!("{anchors} --field distances_m[] --columns sensor=index"));
    assert!(indexed[2].starts_with("1,1,4,5,2.5"), "{indexed:?}");
    let one = copy(&run, &format!("{anchors} --field distances_m[1] --columns sensor=topic"));
    assert_eq!((one.len(), one[1].as_str()), (21, "1,/tag,1,1,2.5"));
    let stamped = copy(&run, &format!("{anchors} --field distances_m[1] --columns sensor=topic,time=stamp_us:us"));
    assert_eq!(stamped, one);
    let places = "bag --topic /tag --field ranges[].distance:mm --columns sensor=ranges[].anchor_id,x=ranges[].at.x:m,y=ranges[].at.y:m,target=tag";
    let red = copy(&run, &format!("{places} --target red"));
    assert_eq!((red.len(), red[2].as_str()), (21, "1,0B,4,5,2.5"));
    let bearing = copy(&run, &format!("{anchors} --columns bearing=angle:rad,sensor=topic"));
    assert_eq!(
        (bearing[0].as_str(), bearing[1].as_str()),
        ("time_s,sensor_id,sensor_x_m,sensor_y_m,range_m,bearing_rad", "1,/tag,1,1,,0.25")
    );

    for (words, expected) in [
        (
            "bag",
            "no topic is chosen in bag: expected --topic with one of /tag (uwb_msgs/msg/Many: ranges[].distance, distances_m[])",
        ),
        ("bag --topic /x", "no topic /x in bag: expected one of /tag"),
        ("bag --topic /tag", "expected --field with one, as ranges[].distance, distances_m[]"),
        ("bag --topic /tag --field distances_m[]", "expected --columns sensor=FIELD"),
        (places, "several targets"),
        (
            "bag --topic /tag --field ranges[].distance --columns sensor=index --anchors anchors.csv",
            "'sensor=index,range=ranges[].distance:m'",
        ),
        (
            "bag --topic /tag --field ranges[].x:m --columns sensor=index",
            "expected one of its fields anchor_id, distance, at",
        ),
        ("bag --topic /tag --field distances_m --columns sensor=index", "distances_m[] for each element"),
        ("bag --topic /tag --field distances_m[7] --columns sensor=index", "no element [7]"),
        ("bag --topic /tag --field distances_m[] --columns sensor=index,time=tag", "tag is no time"),
        (
            "bag --topic /tag --field distances_m[] --columns sensor=index,time=stamp_us",
            "time=stamp_us:s with the right one of",
        ),
        ("bag --topic /tag --field tag --columns sensor=index", "tag is no number"),
        ("bag --topic /tag --field angle --columns sensor=ranges[].anchor_id", "2 values of sensor for 1 measurements"),
        (
            "bag --topic /tag --field distances_m[] --columns sensor=index --position /tag --anchors anchors.csv",
            "--position or --anchors, not both",
        ),
        ("bag --topic /tag --field distances_m[] --columns sensor=index --position /none", "no topic /none"),
        (
            "bag --topic /tag --field distances_m[] --columns sensor=index --position /a*",
            "expected one in each topic of --topic too",
        ),
        ("bag --topic a*b*c", "at most one *"),
        ("bag --topic /tag --format plain", "expected no --format"),
        ("anchors.csv --topic /tag", "is no ROS 2 bag"),
        ("anchors.csv --truth-topic /tag", "is no ROS 2 bag"),
        ("bag --topic /tag --field distances_m[] --columns sensor=index", "missing columns sensor_x_m and sensor_y_m"),
    ] {
        assert_refused(&run, words, expected);
    }
}

#[test]
fn a_moving_sensor_is_between_its_positions() {
    let run = Run::new();
    let second = 1_000_000_000;
    let mut messages: Vec<Message> =
        (1..=10).map(|k| range("/range", k * second, "beacon", 3.0 + k as f32 / 8.0)).collect();
    messages.extend((0..=4).map(|k| pose("/odom", k * 2 * second + second / 2, 4.0 * k as f64, -2.0)));
    write_mcap(&run.path("r.mcap"), &messages);
    let rows = copy(&run, "r.mcap --topic /range --position /odom");
    assert_eq!(rows[1], "1,beacon,1,-2,0.5,3.125");
    assert_eq!(rows[2], "2,beacon,3,-2,0.5,3.25");
    assert_eq!(rows.last().unwrap(), "9,beacon,16,-2,0.5,4.125", "a position holds for a second");
    assert_eq!(copy(&run, "r.mcap --topic /range --position /odom:pose.position"), rows);
    let tracked = track(&run, "r.mcap --topic /range --position /odom --truth-topic /odom");
    assert_eq!(tracked.code, Some(0), "{tracked:#?}");
    assert_refused(&run, "r.mcap --topic /range --position /odom:header", "is no place");
    assert_refused(&run, "r.mcap --topic /range --position /odom --truth-topic /range", "has no place");
    assert_refused(&run, "r.mcap --topic /range --position /odom --truth-topic /none", "no topic /none");
}

#[test]
fn an_old_bag_is_read_with_definitions_from_the_user() {
    let run = Run::new();
    run.write("anchors.csv", ANCHORS);
    run.write("Many.msg", MANY);
    let messages: Vec<Message> = (1..9)
        .map(|k| many(k * 500_000_000, &[("0A", 1500, [0.0; 2]), ("0B", 2500 + k as u32, [0.0; 2])], ""))
        .collect();
    write_sqlite(&run.path("r.db3"), &messages);
    let words =
        "r.db3 --topic /tag --field ranges[].distance:mm --columns sensor=ranges[].anchor_id --anchors anchors.csv";
    assert_refused(
        &run,
        words,
        "no definition of uwb_msgs/msg/Many in r.db3: expected a definition: type --msg uwb_msgs/msg/Many=FILE",
    );
    assert_refused(&run, &format!("{words} --msg uwb_msgs/msg/Many"), "expected TYPE=FILE");
    assert_refused(&run, &format!("{words} --msg uwb_msgs/msg/Many=none.msg"), "none.msg");
    let rows = copy(&run, &format!("{words} --msg uwb_msgs/msg/Many=Many.msg"));
    assert_eq!((rows.len(), rows[1].as_str()), (17, "0.5,0A,1,2,1.5"));
    assert!(!run.path("r.db3-wal").exists() && !run.path("r.db3-shm").exists());
}

#[test]
fn damaged_bags_are_refused_in_one_line() {
    let run = Run::new();
    run.write("anchors.csv", ANCHORS);
    let messages: Vec<Message> = (1..200).map(|k| range("/range", k * 100_000_000, "a", 3.0)).collect();
    write_mcap(&run.path("r.mcap"), &messages);
    write_sqlite(&run.path("r.db3"), &messages);
    let (mcap, sqlite) = (std::fs::read(run.path("r.mcap")).unwrap(), std::fs::read(run.path("r.db3")).unwrap());
    let with = |bytes: &[u8], at: usize, other: &[u8]| [&bytes[..at], other, &bytes[at + other.len()..]].concat();
    let magic = &mcap[..8];
    let cases: [(&str, Vec<u8>, &str); 8] = [
        ("cut.mcap", mcap[..mcap.len() / 2].to_vec(), "the file is cut short in cut.mcap: expected a complete bag"),
        ("magic.mcap", magic.to_vec(), "cut short"),
        ("length.mcap", [magic, &[6], &[0xFF; 8], b"x"].concat(), "in length.mcap: expected"),
        ("huge.mcap", [magic, &[5, 0, 0, 0, 16, 0, 0, 0, 0], b"x"].concat(), "a damaged record"),
        ("flipped.mcap", with(&mcap, mcap.len() / 3, &[0xA5; 40]), "in flipped.mcap: expected"),
        ("cut.db3", sqlite[..5000].to_vec(), "in cut.db3: expected"),
        ("flipped.db3", with(&sqlite, 4096, &[0xA5; 4000]), "in flipped.db3: expected"),
        ("magic.db3", b"SQLite format 3\0".to_vec(), "in magic.db3: expected"),
    ];
    for (name, bytes, expected) in cases {
        run.write(name, bytes);
        assert_refused(&run, &format!("{name} --topic /range --anchors anchors.csv"), expected);
    }
    let view = Connection::open(run.path("view.db3")).unwrap();
    view.execute_batch(
        "CREATE TABLE topics(id INTEGER, name TEXT, type TEXT, serialization_format TEXT);\
         CREATE VIEW messages AS WITH RECURSIVE n(i) AS (VALUES (1) UNION ALL SELECT i + 1 FROM n) SELECT i AS topic_id, i AS timestamp, x'00' AS data FROM n;",
    )
    .unwrap();
    drop(view);
    let mut wrong = messages;
    wrong[5].bytes.truncate(20);
    write_mcap(&run.path("short.mcap"), &wrong);
    std::fs::create_dir_all(run.path("empty")).unwrap();
    run.lockstep("--in-process --ticks 5 --record").finish().succeeded();
    for (words, expected) in [
        ("view.db3 --topic /range", "no tables of topics and messages"),
        (
            "short.mcap --topic /range --anchors anchors.csv",
            "the message is cut short or damaged on /range in short.mcap",
        ),
        ("empty --topic /range", "no file of a bag in empty"),
        ("none --topic /range", "none"),
        ("out/run.mcap --topic /range", "a recording of rangehound"),
    ] {
        let refused =
            run.start(&[&["track"], &words.split(' ').collect::<Vec<_>>()[..], &["--out", "other"]].concat()).finish();
        assert_eq!((refused.code, refused.complaints().len()), (Some(2), 1), "{words}: {refused:#?}");
        assert!(refused.stderr.contains(expected), "{words}: {refused:#?}");
    }
}
