//! The files of a run folder but for the report: scenario, CSV tables.
//!
//! | file | what |
//! |---|---|
//! | `scenario.toml` | the scenario as it was run, command line included |
//! | `recording.csv` | of a recorded run: the recording as it was read, which the simulator plays |
//! | `report.json` | see [`crate::results::report`] |
//! | `estimate.csv` | the track: a row for each tick |
//! | `report.html`, `picture.svg` | see [`crate::results::page`], [`crate::results::picture`] |
//! | `ranges.csv`, `truth.csv` | with `--write-recording`: a recording that `track` reads |
//! | `run.mcap` | the whole run in one file, see [`crate::results::run_mcap`] |
//! | `estimate.ticks`, `world.ticks` | what the nodes put down, see `rangehound_shared::record` |
//! | `run.sealed` | what the run is, for `resume` |
//! | `sim.checkpoint`, `fusion.checkpoint` | where a killed node's successor goes on, see `rangehound_node::checkpoint` |
//! | `logs/NODE.log` | what a node had to say |

use std::io::{Read, Write};
use std::path::Path;

use nalgebra::Vector2;
use rangehound_node::bounded;
use rangehound_node::checkpoint;
use rangehound_node::logs;
use rangehound_node::rendezvous::{Role, RunDescription};
use rangehound_robot::sensor::{RangeSensor, SimulatedSensor};
use rangehound_shared::message::{Estimate, RangeKind, WorldEntry};
use rangehound_shared::record::{FusionRecord, WorldRecord};
use rangehound_shared::recording::{RecordingError, TrackPoint, parse_track};
use rangehound_shared::scenario::{COPY, Source};
use rangehound_shared::sealed;

use crate::failure::{self, Failure};
use crate::files::input;
use crate::files::out_folder::{self, Claim, Kind};
use crate::files::whole_file::{self, WholeFile};
use crate::results::curves::Curves;
use crate::results::frame::{Frames, PutDown};
use crate::results::page;
use crate::results::picture;
use crate::results::report::{self, NodeSummary, Report, Truth, position_covariance};
use crate::results::run_mcap;
use crate::run::experiment::{Experiment, in_utf8};
use crate::terminal;

/// What the run is, for `resume`.
pub(crate) const DESCRIPTION: &str = "run.sealed";

/// The track.
const ESTIMATES: &str = "estimate.csv";

/// Files of a run folder, but for those that have a module of their own.
pub(crate) const FILE_NAMES: [&str; 8] =
    [run_mcap::SCENARIO, DESCRIPTION, ESTIMATES, "ranges.csv", "truth.csv", COPY, logs::ESTIMATES, logs::WORLDS];

/// Ticks times robots of a run whose report takes seconds: whoever waits wants to know what for.
const LONG: u64 = 1_000_000;

/// Makes the run folder ready, and claims it: removes an earlier run's results, writes the scenario.
///
/// # Errors
/// [`Failure::Input`] if the folder cannot be used.
pub fn prepare_folder(experiment: &Experiment) -> Result<Claim, Failure> {
    let out_dir = &experiment.description.out_dir;
    let claim = out_folder::claim(out_dir, Kind::Run, &experiment.inputs())?;
    claim.clear()?;
    let written = || {
        if let Source::Recorded(ranges) = &experiment.description.scenario.source
            && let Some(recording) = ranges.already_read()
        {
            let mut copy = WholeFile::create(&out_dir.join(COPY))?;
            recording.write_csv(&mut copy)?;
            copy.finish()?;
        }
        whole_file::write(&out_dir.join(run_mcap::SCENARIO), experiment.scenario_file.to_toml()?)?;
        whole_file::write_for_owner(&out_dir.join(DESCRIPTION), sealed::seal(&experiment.description_for_nodes())?)
    };
    written().map_err(|error: anyhow::Error| {
        Failure::input(format!("--out: expected a folder that can be written: {error}"))
    })?;
    for log in [logs::ESTIMATES, logs::WORLDS] {
        claim.make_growing(log)?;
    }
    Ok(claim)
}

/// What a run is, from its folder, wherever that is now.
///
/// # Errors
/// [`Failure::Input`] if the folder is not a run's.
pub fn read_description(folder: &Path) -> Result<RunDescription, Failure> {
    let path = folder.join(DESCRIPTION);
    let expected = |reason: &dyn std::fmt::Display| {
        Failure::input(format!("{}: expected the folder of a run: {reason}", path.display()))
    };
    let sealed = bounded::read(&path, sealed::FILE_LEN_MAX).map_err(|error| expected(&error))?;
    let description = RunDescription::open(&sealed).map_err(|error| expected(&error))?;
    let out_dir = std::path::absolute(folder).map_err(|error| expected(&error))?;
    in_utf8("DIR", &out_dir)?;
    Ok(RunDescription { out_dir, ..description })
}

/// Claims the folder of a run that is to go on, and looks whether it can: nodes that cannot write there go on without
/// their logs.
///
/// # Errors
/// [`Failure::Input`] with the first file that cannot be written.
pub fn look_for_writable(description: &RunDescription) -> Result<Claim, Failure> {
    let out_dir = &description.out_dir;
    let claim = out_folder::claim_again(out_dir)?;
    let checkpoints = [Role::Sim, Role::Fusion].map(|role| out_dir.join(checkpoint::file_name(role)));
    let logs = [logs::estimates_path(out_dir), logs::worlds_path(out_dir)];
    for path in logs.iter().chain(&checkpoints) {
        let opened = std::fs::OpenOptions::new().append(true).open(path);
        if let Err(error) = opened
            && error.kind() != std::io::ErrorKind::NotFound
        {
            return Err(Failure::input(format!("{}: expected a file that can be written: {error}", path.display())));
        }
    }
    // A node would begin another run's log anew.
    let has_content = |log: &Path| std::fs::metadata(log).is_ok_and(|log| log.len() > 0);
    let [estimates, worlds] = &logs;
    if has_content(estimates) {
        logs::read_estimates(description).map_err(Failure::input)?;
    }
    if has_content(worlds) {
        logs::read_worlds(description).map_err(Failure::input)?;
    }
    Ok(claim)
}

/// What is done with a run's logs beyond its report, and how that is printed.
#[derive(Debug, Default)]
pub struct Keep {
    /// The ranges and the true track are written as a recording.
    pub ranges: bool,
    /// The true track to compare with, where the run itself knows none.
    pub truth: Option<Truth>,
    /// The report is printed as JSON.
    pub json: bool,
    /// A result that is not sound is a failure.
    pub strict: bool,
}

/// Prints the report of a run and writes all that is made of its logs: whatever cannot be written, the rest is.
///
/// # Errors
/// [`Failure::Running`] with the first file that could not be read or written.
pub fn report_and_tables(
    description: &RunDescription,
    keep: &Keep,
    nodes: Vec<NodeSummary>,
) -> Result<Report, Failure> {
    let &Keep { ranges, ref truth, strict, .. } = keep;
    let truth = truth.as_ref();
    let (report, printed) = make_report(description, keep, nodes)?;
    let written = report::write(&report, &description.out_dir);
    let table = write_estimate_csv(description);
    let recorded = if ranges { write_recording(description) } else { Ok(()) };
    if let Err(error) = draw(&report, description, truth) {
        log::warn!("there is no picture, or no page: {error}");
    }
    written.and(table).and(recorded)?;
    printed?;
    if strict && !report.verdict.sound {
        return Err(Failure::Running(anyhow::anyhow!("the result is not sound, and --strict was given")));
    }
    Ok(report)
}

/// Prints the report of a run that another process writes down.
///
/// # Errors
/// [`Failure::Running`] if a log cannot be read, or standard output not written.
pub fn print_report(description: &RunDescription, keep: &Keep, nodes: Vec<NodeSummary>) -> Result<Report, Failure> {
    let (report, printed) = make_report(description, keep, nodes)?;
    printed.map(|()| report)
}

/// A run's report, and whether it could be printed.
fn make_report(
    description: &RunDescription,
    keep: &Keep,
    nodes: Vec<NodeSummary>,
) -> anyhow::Result<(Report, Result<(), Failure>)> {
    let &Keep { ref truth, json, .. } = keep;
    let truth = truth.as_ref();
    let scenario = &description.scenario;
    if scenario.ticks.saturating_mul(scenario.robots.len() as u64) >= LONG {
        failure::tell("the run is over, its report is made");
    }
    let report = report::from_logs(description, truth, nodes)?;
    let printed = if json {
        failure::print_json(&report)
    } else {
        let folder = terminal::field("run folder", from_here(&description.out_dir).display());
        failure::print(format!("{report}\n{folder}\n"))
    };
    Ok((report, printed))
}

/// A path as one would type it here.
pub(crate) fn from_here(path: &Path) -> &Path {
    let here = std::env::current_dir().ok();
    let below = here.and_then(|here| path.strip_prefix(here).ok()).filter(|below| !below.as_os_str().is_empty());
    below.unwrap_or(path)
}

/// Draws what people look at: the page, and the picture.
///
/// # Errors
/// If a log cannot be read, holds numbers that cannot be drawn, or a file cannot be written.
pub fn draw(report: &Report, description: &RunDescription, truth: Option<&Truth>) -> anyhow::Result<()> {
    let curves = Curves::read(description, truth)?;
    picture::draw(&curves, &description.out_dir)?;
    page::write(report, &curves, &description.out_dir)
}

/// Writes `estimate.csv` from fusion's log, a row for each stamp: a recording whose sensor repeats within a stamp takes
/// several ticks for it, of which the last knows most. A recording's tick 0 is left out: it comes before the first range,
/// when nothing is known.
///
/// # Errors
/// If a file cannot be read or written.
pub fn write_estimate_csv(description: &RunDescription) -> anyhow::Result<()> {
    let RunDescription { scenario, out_dir, .. } = description;
    let first_tick = u64::from(matches!(scenario.source, Source::Recorded { .. }));
    let mut out = WholeFile::create(&out_dir.join(ESTIMATES))?;
    writeln!(out, "time_s,x_m,y_m,vx_mps,vy_mps,var_x_m2,cov_xy_m2,var_y_m2")?;
    let mut last: Option<(f64, Estimate)> = None;
    Frames::open(description)?.for_each(|PutDown { tick, fusion, .. }| {
        let Some(FusionRecord { time_s, estimate, .. }) = fusion.filter(|_| tick >= first_tick) else { return Ok(()) };
        if let Some((last_s, last)) = last.filter(|(last_s, _)| last_s != time_s) {
            write_estimate_row(&mut out, last_s, &last)?;
        }
        last = Some((*time_s, *estimate));
        Ok(())
    })?;
    if let Some((time_s, estimate)) = last {
        write_estimate_row(&mut out, time_s, &estimate)?;
    }
    out.finish()
}

fn write_estimate_row(out: &mut impl Write, time_s: f64, estimate: &Estimate) -> std::io::Result<()> {
    // Models without velocities (a random walk) take them to be zero.
    let [x, y, vx, vy, ..] = estimate.state;
    let p = position_covariance(estimate);
    writeln!(out, "{time_s},{x},{y},{vx},{vy},{},{},{}", p[(0, 0)], p[(0, 1)], p[(1, 1)])
}

/// Writes `ranges.csv` and `truth.csv` of a simulated run: what the robots measured, in the form of
/// a recording, and where the target was.
///
/// # Errors
/// If a file cannot be read or written.
pub fn write_recording(description: &RunDescription) -> anyhow::Result<()> {
    let RunDescription { scenario, out_dir, .. } = description;
    let mut ranges = WholeFile::create(&out_dir.join("ranges.csv"))?;
    let mut truths = WholeFile::create(&out_dir.join("truth.csv"))?;
    writeln!(ranges, "time_s,sensor_id,sensor_x_m,sensor_y_m,range_m")?;
    writeln!(truths, "time_s,x_m,y_m")?;
    let mut sensors: Vec<SimulatedSensor> =
        (0..scenario.robots.len()).filter_map(|robot| SimulatedSensor::new(scenario, robot)).collect();
    Frames::open(description)?.for_each(|PutDown { tick, world, .. }| {
        let Some(WorldRecord { time_s, truth, robots, .. }) = world else { return Ok(()) };
        let &[x_m, y_m, ..] = truth.as_slice() else { return Ok(()) };
        writeln!(truths, "{time_s:.4},{x_m:.4},{y_m:.4}")?;
        for (id, (robot, sensor)) in robots.iter().zip(&mut sensors).enumerate() {
            let [robot_x_m, robot_y_m] = robot.position_m;
            // Noise is a function of (seed, robot, tick), so the range is measured again, the same.
            let range_m = (x_m - robot_x_m).hypot(y_m - robot_y_m);
            let entry = WorldEntry { range_m, range_kind: RangeKind::True.to_bits(), ..WorldEntry::default() };
            if let Some(range_m) = sensor.measure(tick, &entry).filter(|_| robot.range_sent_ns.is_some()) {
                writeln!(ranges, "{time_s:.4},{id},{robot_x_m:.4},{robot_y_m:.4},{:.4}", range_m.max(0.0))?;
            }
        }
        Ok(())
    })?;
    ranges.finish()?;
    truths.finish()
}

/// Reads a true track, `time_s,x_m,y_m` in any of the forms that a recording may have, in order of time.
///
/// # Errors
/// [`Failure::Input`] with file and row of the first thing that is wrong.
pub fn read_truth(path: &Path) -> Result<Truth, Failure> {
    truth_of(input::track(path)).map_err(|problem| Failure::input(problem.to_string()))
}

/// Parses a true track from a reader.
///
/// # Errors
/// What is wrong first, in one line.
pub fn parse_truth(input: impl Read) -> Result<Truth, String> {
    truth_of(parse_track(input, Path::new("the true track"))).map_err(|problem| problem.to_string())
}

fn truth_of(track: Result<Vec<TrackPoint>, RecordingError>) -> Result<Truth, RecordingError> {
    Ok(Truth::new(track?.into_iter().map(|(time_s, [x_m, y_m])| (time_s, Vector2::new(x_m, y_m))).collect()))
}
