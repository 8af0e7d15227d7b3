//! What the test provides for blocks that need more than the program: `run with` marks them.

use std::path::Path;

use rangehound::files::bag::cdr::Writer;
use rangehound::files::bag::interfaces;
use serde_json::Value;

use super::page::{Block, Page};
use super::radio::{Kind, Radio, TAG_Y_M};
use crate::recordings::bags::{Message, header, many, range, write_mcap};
use crate::support::Run;

/// The name of a serial port in the book.
const PORT: &str = "/dev/ttyUSB0";

/// A command to a drive that stops it, as the driver ends with it.
const STOP: &str = "0.000000,0.000000";

/// A block as it is typed.
pub(super) struct Provided {
    pub(super) script: String,
    /// Looks, when all is over, whether it did what the page says. It gets the page's folder.
    pub(super) check: Check,
}

type Check = Box<dyn FnOnce(&Run)>;

type Provide = fn(&Page, &Block, &Run) -> Provided;

/// What a mark may name, and how it is provided.
pub(super) const PROVIDED: [(&str, Provide); 6] = [
    ("Ctrl-C", ctrl_c),
    ("a file that a kill has cut short", cut_file),
    ("a radio", radio),
    ("a FIFO that somebody writes", fifo),
    ("a radio that prints", log_of_radio),
    ("a bag", bag),
];

/// A block of one command, which is ended after some time.
fn ctrl_c(_: &Page, block: &Block, _: &Run) -> Provided {
    let script = format!("timeout --preserve-status --signal=INT 2 {}", block.text);
    Provided { script, check: Box::new(|_| {}) }
}

/// Leaves of the page's recording what a kill does.
fn cut_file(_: &Page, block: &Block, _: &Run) -> Provided {
    let cut = "head -c 400000 runs/recorded/run.mcap > runs/recorded/run.mcap.partial\nrm runs/recorded/run.mcap\n";
    let check = Box::new(|folder: &Run| assert!(folder.path("runs/recorded/run.mcap").exists()));
    Provided { script: format!("{cut}{}", block.text), check }
}

/// The simulated nodes of the page, in a short run, with `watch` in another terminal as the page says.
fn nodes(page: &Page) -> String {
    let block = page.commands().next().unwrap();
    let nodes: String =
        block.text.lines().filter(|line| line.starts_with("rangehound ")).map(|line| format!("{line}\n")).collect();
    assert!(nodes.contains("recommended.toml --name demo"), "{nodes}");
    format!("{}rangehound watch --name demo &\n", nodes.replace("recommended.toml", "recommended.toml --ticks 40"))
}

/// A block that runs a driver beside the page's nodes, and keeps the results for the check.
fn driven(page: &Page, block: &Block, script: &str) -> String {
    // The first block starts the nodes itself.
    let rest: String =
        script.lines().filter(|line| !line.starts_with("rangehound ")).map(|line| format!("{line}\n")).collect();
    format!("{}{rest}wait\nmv runs/demo {}\n", nodes(page), results(block))
}

fn results(block: &Block) -> String {
    format!("runs/of-line-{}", block.line)
}

/// All three robots have measured, robot 0 with its radio.
fn assert_all_measured(folder: &Run, results: &str) {
    let report = report(folder, results);
    let ranges: Vec<u64> =
        report["sensors"].as_array().unwrap().iter().map(|sensor| sensor["ranges"].as_u64().unwrap()).collect();
    // On a busy machine the kernel passes on late what a radio has written to its port.
    assert!(ranges.len() == 3 && ranges[0] > 0 && ranges[1..].iter().all(|count| *count > 5), "{results}: {report:#}");
}

fn report(folder: &Run, results: &str) -> Value {
    let path = folder.path(results).join("report.json");
    let text = std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    serde_json::from_str(&text).unwrap()
}

fn radio(page: &Page, block: &Block, _: &Run) -> Provided {
    let has_shell = block.text.contains("dwm1001");
    let radio = Radio::plug(if has_shell { Kind::Dwm1001 } else { Kind::Plain });
    let script = driven(page, block, &block.text.replace(PORT, &radio.port));
    let results = results(block);
    let check = move |folder: &Run| {
        let heard = radio.unplug();
        assert_all_measured(folder, &results);
        if has_shell {
            // Its shell would take commands for its own: they go to standard output.
            assert_eq!(heard, "\r\rlec\r");
        } else {
            let commands: Vec<&str> = heard.lines().filter(|line| line.contains(',')).collect();
            assert!(commands.len() > 20 && commands.iter().any(|line| !line.ends_with(",0.000000")), "{heard}");
            assert_eq!(commands.last(), Some(&STOP));
        }
    };
    Provided { script, check: Box::new(check) }
}

/// The writer of the FIFO loses its reader when the driver ends, and may be gone before `kill`.
fn fifo(page: &Page, block: &Block, _: &Run) -> Provided {
    let ended = "kill ${pids[-1]} || true; unset 'pids[-1]'\n";
    let commands = format!("commands-of-line-{}", block.line);
    let (writer, driver) = block.text.trim_end().rsplit_once('\n').unwrap();
    let script = driven(page, block, &format!("{writer}\n{driver} > {commands}\n{ended}"));
    let results = results(block);
    let check = move |folder: &Run| {
        assert_all_measured(folder, &results);
        let commands = std::fs::read_to_string(folder.path(&commands)).unwrap();
        assert_eq!(commands.lines().next_back(), Some(STOP), "{commands}");
    };
    Provided { script, check: Box::new(check) }
}

fn without_comment(command: &str) -> &str {
    command.split_once(" #").map_or(command, |(command, _)| command)
}

/// The log is ended after some time.
fn log_of_radio(_: &Page, block: &Block, folder: &Run) -> Provided {
    // A stand-in where moreutils is not installed.
    let stand_in = "#!/bin/bash\nwhile IFS= read -r line; do printf '%s %s\\n' \"$(date +%s.%N)\" \"$line\"; done\n";
    folder.write("ts-stand-in", stand_in);
    let radio = Radio::plug(Kind::Dwm1001Printing);
    let (log, track) = block.text.split_once('\n').unwrap();
    let script = format!(
        "mkdir -p programs; chmod +x ts-stand-in; type ts 2>/dev/null || mv ts-stand-in programs/ts; PATH=$PWD/programs:$PATH\n\
         stty -F {} raw -echo\ntimeout --signal=INT 3 {} || [ $? = 124 ]\n{track}",
        radio.port,
        without_comment(log).replace(PORT, &radio.port)
    );
    let check = move |folder: &Run| {
        radio.unplug();
        let report = report(folder, "runs/log");
        assert!(report["verdict"]["valid"] == true && report["sensors"].as_array().unwrap().len() == 4, "{report:#}");
        let [_, y_m] = last_position_m(folder, "runs/log");
        assert!((y_m - TAG_Y_M).abs() < 0.3, "{y_m} m");
    };
    Provided { script, check: Box::new(check) }
}

fn last_position_m(folder: &Run, results: &str) -> [f64; 2] {
    let estimates = std::fs::read_to_string(folder.path(results).join("estimate.csv")).unwrap();
    let cells: Vec<f64> = estimates.lines().next_back().unwrap().split(',').map(|cell| cell.parse().unwrap()).collect();
    [cells[1], cells[2]]
}

/// Places of the anchors of the bag, m.
const ANCHORS_M: [(&str, [f64; 2]); 3] = [("a", [0.0, 0.0]), ("b", [9.0, 0.0]), ("c", [0.0, 9.0])];

/// Where a target walks past the anchors, m.
fn target_m(time_s: f64) -> [f64; 2] {
    [2.0 + 0.2 * time_s, 3.0]
}

fn distance_m(from_m: [f64; 2], to_m: [f64; 2]) -> f64 {
    (from_m[0] - to_m[0]).hypot(from_m[1] - to_m[1])
}

/// A beacon drives on a circle round the origin, and so round the target.
fn beacon_m(time_s: f64) -> [f64; 2] {
    let (sin, cos) = (0.7 * time_s).sin_cos();
    [8.0 * cos, 8.0 * sin]
}

fn odometry(time_ns: u64, [x_m, y_m]: [f64; 2]) -> Message {
    let mut out = Writer::default();
    header(&mut out, time_ns, "map");
    out.text("beacon");
    out.f64s(&[x_m, y_m, 0.0, 0.0, 0.0, 0.0, 1.0]);
    out.f64s(&[0.0; 36 + 6 + 36]);
    let interface = interfaces::ODOMETRY;
    Message {
        topic: "/odom",
        type_name: interface.name,
        definition: interface.text(),
        log_ns: time_ns,
        bytes: out.bytes().to_vec(),
    }
}

/// A bag with all topics of the block: the ranges of three anchors in two forms, and those of one moving sensor.
fn write_bag(path: &Path) {
    let mut messages = Vec::new();
    for k in 0..150 {
        let time_ns = 1_700_000_000_000_000_000 + k * 100_000_000;
        let time_s = k as f64 * 0.1;
        let target_m = target_m(time_s);
        let ranges_mm = ANCHORS_M.map(|(id, at_m)| (id, (1000.0 * distance_m(at_m, target_m)).round() as u32, at_m));
        for (id, at_m) in ANCHORS_M {
            messages.push(range("/uwb/range", time_ns, id, distance_m(at_m, target_m) as f32));
        }
        messages.push(Message { topic: "/uwb/ranging", ..many(time_ns, &ranges_mm, "tag") });
        let beacon_m = beacon_m(time_s);
        messages.push(odometry(time_ns, beacon_m));
        messages.push(range("/beacon/range", time_ns, "beacon", distance_m(beacon_m, target_m) as f32));
    }
    write_mcap(path, &messages);
}

/// The first command is refused, and its message lists the topics.
fn bag(_: &Page, block: &Block, folder: &Run) -> Provided {
    write_bag(&folder.path("uwb.mcap"));
    let rows: String = ANCHORS_M.iter().map(|(id, [x_m, y_m])| format!("{id},{x_m},{y_m}\n")).collect();
    folder.write("anchors.csv", format!("sensor_id,x_m,y_m\n{rows}"));
    let mut script = String::new();
    let results = |line: usize| format!("runs/of-line-{line}");
    for (line, command) in block.text.lines().enumerate() {
        let command = without_comment(command).replace("BAG", "uwb.mcap");
        script += &if line == 0 {
            format!("refused=0; {command} 2> refused || refused=$?; [ $refused = 2 ]\n")
        } else {
            format!("{command}\nmv runs/uwb {}\n", results(line))
        };
    }
    let count = block.text.lines().count();
    let check = move |folder: &Run| {
        let refused = std::fs::read_to_string(folder.path("refused")).unwrap();
        for expected in ["/uwb/range (", "/uwb/ranging (", "/beacon/range (", "ranges[].distance"] {
            assert!(refused.contains(expected), "{refused}");
        }
        for line in 1..count {
            let report = report(folder, &results(line));
            assert_eq!(report["verdict"]["valid"], true, "{report:#}");
            let error_m = distance_m(last_position_m(folder, &results(line)), target_m(14.9));
            assert!(error_m < 0.5, "line {line}: {error_m} m");
        }
        assert_eq!(count, 4);
    };
    Provided { script, check: Box::new(check) }
}
