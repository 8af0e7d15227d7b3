//! The flags for reading a recording.

use std::path::PathBuf;

use clap::Args;

use super::values::number;

/// The flags of a recording.
#[derive(Debug, Clone, Default, Args)]
pub struct InputArgs {
    /// Recorded ranges and bearings: a table with a row for each measurement; a file, a pipe, or - for standard input
    pub ranges: PathBuf,
    /// Names and units of the columns, as in time=stamp_ns:ns,sensor=anchor_id,range=dist:mm; the keys are time, sensor,
    /// range, x, y, z, target, bearing, heading, position_std and heading_std [default: by the header's names]
    #[arg(long, value_name = "SPEC")]
    pub columns: Option<String>,
    /// Positions of the sensors, if the recording has none: a table with the columns sensor_id, x_m, y_m and optionally z_m
    #[arg(long, value_name = "FILE")]
    pub anchors: Option<PathBuf>,
    /// Height of the target, m, in the same frame as the sensors' heights: ranges are then slant ranges
    #[arg(long, value_name = "M", value_parser = number, allow_negative_numbers = true)]
    pub target_height: Option<f64>,
    /// The target to track, if the recording has several
    #[arg(long, value_name = "NAME")]
    pub target: Option<String>,
    /// Format of the radio, if the file is a log of a radio's serial port: dwm1001, linktrack, mauwb or plain
    #[arg(long, value_name = "NAME")]
    pub format: Option<String>,
    /// Reports per second, if such a log has no time stamps
    #[arg(long, value_name = "HZ", value_parser = number, allow_negative_numbers = true)]
    pub rate: Option<f64>,
    /// Unit of the time stamps in such a log, if they are integers: s, ms, us or ns
    #[arg(long, value_name = "UNIT")]
    pub stamp_unit: Option<String>,
    /// Refuse the file at its first bad row, and exit with 1 if the verdict of the report is "not sound"
    #[arg(long)]
    pub strict: bool,
}
