//! CSV tables of a run.

use std::io::Write;

use rangehound_node::logs;
use rangehound_node::rendezvous::RunDescription;
use rangehound_shared::measurement::{Measurement, Pose};
use rangehound_shared::message::Estimate;
use rangehound_shared::record::{FusionRecord, WorldRecord};
use rangehound_shared::scenario::Source;

use super::frame::{Frames, LoggedTick};
use super::report::position_covariance;
use crate::files::atomic_file::AtomicFile;
use crate::files::layout::{ESTIMATES, RANGES, TRUTH};

/// Writes `estimate.csv` from fusion's log, one row for each stamp. A recording whose sensor repeats within a stamp uses
/// several ticks for it; the last one has the most information. A recording's tick 0 is left out: it comes before the
/// first range, when nothing is known.
///
/// # Errors
/// If a file cannot be read or written.
pub fn write_estimate_csv(description: &RunDescription) -> anyhow::Result<()> {
    let RunDescription { scenario, out_dir, .. } = description;
    let first_tick = u64::from(matches!(scenario.source, Source::Recorded { .. }));
    let mut out = AtomicFile::create(&out_dir.join(ESTIMATES))?;
    writeln!(out, "time_s,x_m,y_m,vx_mps,vy_mps,var_x_m2,cov_xy_m2,var_y_m2")?;
    let mut last: Option<(f64, Estimate)> = None;
    // The simulator's log is not needed, and may be long.
    let mut log = logs::read_estimates(description)?;
    while let Some(record) = log.next() {
        let (tick, FusionRecord { time_s, estimate, .. }) = record?;
        if tick < first_tick {
            continue;
        }
        if let Some((last_s, last)) = last.filter(|(last_s, _)| last_s != time_s) {
            write_estimate_row(&mut out, last_s, &last)?;
        }
        last = Some((*time_s, *estimate));
    }
    if let Some((time_s, estimate)) = last {
        write_estimate_row(&mut out, time_s, &estimate)?;
    }
    out.finish()
}

fn write_estimate_row(out: &mut impl Write, time_s: f64, estimate: &Estimate) -> std::io::Result<()> {
    // Models without velocities (a random walk) have zero velocity.
    let [x, y, vx, vy, ..] = estimate.state;
    let p = position_covariance(estimate);
    writeln!(out, "{time_s},{x},{y},{vx},{vy},{},{},{}", p[(0, 0)], p[(0, 1)], p[(1, 1)])
}

/// Writes `ranges.csv` of a run, and `truth.csv` if the truth is known: the ranges and bearings that fusion received, in the form
/// of a recording, and the target's true positions. The columns of bearings, headings and uncertain poses are there if the run
/// has them.
///
/// # Errors
/// If a file cannot be read or written.
pub fn write_recording(description: &RunDescription) -> anyhow::Result<()> {
    let out_dir = &description.out_dir;
    let mut ranges = AtomicFile::create(&out_dir.join(RANGES))?;
    let mut truths = description.scenario.has_truth().then(|| AtomicFile::create(&out_dir.join(TRUTH))).transpose()?;
    let columns = columns_of(description)?;
    write!(ranges, "time_s,sensor_id,sensor_x_m,sensor_y_m,range_m")?;
    for (name, _) in &columns {
        write!(ranges, ",{name}")?;
    }
    writeln!(ranges)?;
    if let Some(truths) = &mut truths {
        writeln!(truths, "time_s,x_m,y_m")?;
    }
    Frames::open(description)?.for_each(|LoggedTick { fusion, world, .. }| {
        let Some(WorldRecord { time_s, truth, .. }) = world else { return Ok(()) };
        if let (Some(truths), [x_m, y_m, ..]) = (&mut truths, truth.as_slice()) {
            writeln!(truths, "{time_s:.4},{x_m:.4},{y_m:.4}")?;
        }
        let exchanges = fusion.map_or(&[][..], |fusion| &fusion.exchanges);
        for (id, heard) in exchanges.iter().enumerate().filter_map(|(id, exchange)| Some((id, exchange.heard?))) {
            let Measurement { pose: Pose { x_m, y_m, .. }, kinds, .. } = heard.measurement;
            if kinds == 0 {
                continue;
            }
            write!(ranges, "{time_s:.4},{id},{x_m:.4},{y_m:.4},")?;
            if let Some((range_m, _)) = heard.measurement.range() {
                write!(ranges, "{:.4}", range_m.max(0.0))?;
            }
            for (_, value) in &columns {
                match value(&heard.measurement) {
                    Some(value) => write!(ranges, ",{value:.6}")?,
                    None => write!(ranges, ",")?,
                }
            }
            writeln!(ranges)?;
        }
        Ok(())
    })?;
    ranges.finish()?;
    truths.map_or(Ok(()), AtomicFile::finish)
}

/// A column of a recording that only some runs need: its name, and its value for a measurement.
type Column = (&'static str, fn(&Measurement) -> Option<f64>);

const COLUMNS: [Column; 4] = [
    ("bearing_rad", |measurement| Some(measurement.bearing()?.0)),
    ("sensor_heading_rad", |measurement| measurement.bearing().map(|_| measurement.pose.heading_rad)),
    ("sensor_std_m", |measurement| Some((0.5 * measurement.pose.position_covariance_m2().trace()).max(0.0).sqrt())),
    ("sensor_heading_std_rad", |measurement| Some(measurement.pose.heading_std_rad)),
];

/// The columns that have a value other than 0 in a run.
fn columns_of(description: &RunDescription) -> anyhow::Result<Vec<Column>> {
    let mut is_needed = [false; COLUMNS.len()];
    let mut log = logs::read_estimates(description)?;
    while let Some(record) = log.next() {
        for heard in record?.1.exchanges.iter().filter_map(|exchange| exchange.heard) {
            for (is_needed, (_, value)) in is_needed.iter_mut().zip(COLUMNS) {
                *is_needed |= value(&heard.measurement).is_some_and(|value| value != 0.0);
            }
        }
    }
    Ok(COLUMNS.into_iter().zip(is_needed).filter_map(|(column, is_needed)| is_needed.then_some(column)).collect())
}
