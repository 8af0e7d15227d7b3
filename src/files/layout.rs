//! The files in result folders; each name is defined once, here.
//!
//! A run folder has
//!
//! | file | what |
//! |---|---|
//! | `scenario.toml` | the scenario as it was run, command line included |
//! | `recording.csv` | the run's copy of its recording, which the simulator plays |
//! | `report.json`, `report.html`, `picture.svg` | the report, for programs and for people |
//! | `estimate.csv` | the track: a row for each tick |
//! | `ranges.csv`, `truth.csv` | with `--write-recording`: a recording that `track` reads |
//! | `run.mcap` | the whole run in one file |
//! | `estimate.ticks`, `world.ticks` | the nodes' records, see `rangehound_node::tick_log` |
//! | `run.sealed` | the run's description, for `resume`: JSON with a checksum |
//! | `hosts.json` | where the gateway listens, with which keys, and which robots are on other hosts, for `resume` |
//! | `external.json` | which robots of this host others start, for `resume` |
//! | `sim.checkpoint`, `fusion.checkpoint` | the state from which a killed node's successor continues, see `rangehound_node::checkpoint` |
//! | `logs/NODE.log` | a node's messages |

use rangehound_node::rendezvous::Role;
use rangehound_node::{checkpoint, logs};
use rangehound_shared::scenario::COPY;

/// The default folder of run folders and other results.
pub const RUNS: &str = "runs";

/// The scenario as it was run.
pub const SCENARIO: &str = "scenario.toml";

/// The run's description, for `resume`.
pub const DESCRIPTION: &str = "run.sealed";

/// How robots on other hosts join.
pub const HOSTS: &str = "hosts.json";

/// Robots of this host that others start.
pub const EXTERNAL: &str = "external.json";

/// The report, for programs.
pub const REPORT: &str = "report.json";

/// The report, for people.
pub const PAGE: &str = "report.html";

/// The picture of a run.
pub const PICTURE: &str = "picture.svg";

/// The track.
pub const ESTIMATES: &str = "estimate.csv";

/// Ranges as a recording.
pub const RANGES: &str = "ranges.csv";

/// The true track.
pub const TRUTH: &str = "truth.csv";

/// The whole run in one file.
pub const RECORDING: &str = "run.mcap";

/// The file of a ROS 2 bag, by its number as rosbag2 has it.
pub const BAG_FILE: &str = "bag_0.mcap";

/// The file of a bag that rosbag2 reads first.
pub const BAG_METADATA: &str = "metadata.yaml";

/// The folder of the nodes' logs.
pub const LOGS: &str = "logs";

/// The figures of a comparison.
pub const COMPARISON: &str = "compare.json";

/// Its pictures.
pub const COMPARISON_PICTURES: [&str; 5] =
    ["trace.svg", "paths.svg", "consistency.svg", "gap.svg", "planning_time.svg"];

/// The findings of a calibration.
pub const CALIBRATION: &str = "calibration.toml";

/// Their picture.
pub const RESIDUALS: &str = "residuals.svg";

/// The figures of a latency measurement.
pub const LATENCY: &str = "latency.json";

/// Their picture.
pub const LATENCY_PICTURE: &str = "latency.svg";

/// The outcome of a campaign of faults.
pub const CHAOS: &str = "chaos.json";

/// Suffix of unfinished files.
pub const PARTIAL: &str = ".partial";

/// Kind of an output folder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A run: report, tables, logs.
    Run,
    /// The figures and pictures of a comparison.
    Compare,
    /// The findings of a calibration.
    Calibrate,
    /// The figures of a latency measurement, and the folders of its runs.
    Latency,
    /// The outcome of a campaign of faults, and the folders of its runs.
    Chaos,
    /// A run as a ROS 2 bag.
    Bag,
}

impl Kind {
    /// Its name in the folder's mark.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Run => "run",
            Self::Compare => "compare",
            Self::Calibrate => "calibrate",
            Self::Latency => "latency",
            Self::Chaos => "chaos",
            Self::Bag => "bag",
        }
    }

    /// True if results of this kind have a file of this name; also for an unfinished one that a kill left.
    #[must_use]
    pub fn writes(self, name: &str) -> bool {
        let name = name.strip_suffix(PARTIAL).map_or(name, without_number);
        let numbered = |start: &str, end: &str| is_numbered(name, start, end);
        match self {
            Self::Run => {
                let made_first = [SCENARIO, DESCRIPTION, HOSTS, EXTERNAL, COPY, logs::ESTIMATES, logs::WORLDS];
                let results = [REPORT, PAGE, PICTURE, ESTIMATES, RANGES, TRUTH, RECORDING];
                let checkpoints = [Role::Sim, Role::Fusion].map(checkpoint::file_name);
                made_first.contains(&name) || results.contains(&name) || checkpoints.iter().any(|it| it == name)
            }
            Self::Calibrate => name == CALIBRATION || name == RESIDUALS,
            Self::Bag => name == BAG_FILE || name == BAG_METADATA,
            Self::Compare => name == COMPARISON || COMPARISON_PICTURES.contains(&name),
            Self::Latency => {
                name == LATENCY
                    || name == LATENCY_PICTURE
                    || ["system-", "local-"].iter().any(|start| numbered(start, ".toml"))
                    || ["system-", "local-", "iceoryx2-", "futex-", "udp-", "quic-"]
                        .iter()
                        .any(|start| numbered(start, ".log"))
                    || numbered("system-", ".hosts.log")
            }
            Self::Chaos => {
                name == CHAOS
                    || numbered("round-", ".toml")
                    || ["round-", "hosts-"].iter().any(|start| numbered(start, ".log"))
            }
        }
    }
}

/// A name without the number of the process that unfinished files have.
fn without_number(name: &str) -> &str {
    match name.rsplit_once('.') {
        Some((before, number)) if number.bytes().all(|byte| byte.is_ascii_digit() || byte == b'-') => before,
        _ => name,
    }
}

fn is_numbered(name: &str, start: &str, end: &str) -> bool {
    let number = name.strip_prefix(start).and_then(|rest| rest.strip_suffix(end));
    number.is_some_and(|number| !number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit()))
}
