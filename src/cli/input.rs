//! How a recording is read.

use std::path::PathBuf;

use clap::Args;

use super::values::number;

/// The flags of a recording.
#[derive(Debug, Clone, Default, Args)]
pub struct InputArgs {
    /// Recorded ranges: a table with a row for each range, a pipe, or - for standard input
    pub ranges: PathBuf,
    /// Which column is what, and in which unit, as in time=stamp_ns:ns,sensor=anchor_id,range=dist:mm; keys are time, sensor,
    /// range, x, y, z and target
    #[arg(long, value_name = "SPEC")]
    pub columns: Option<String>,
    /// Where the sensors stand: a table with the columns sensor_id, x_m, y_m and perhaps z_m, for logs that do not say
    #[arg(long, value_name = "FILE")]
    pub anchors: Option<PathBuf>,
    /// Height of the target in the frame of the sensors' heights, m: ranges are then slant ones
    #[arg(long, value_name = "M", value_parser = number, allow_negative_numbers = true)]
    pub target_height: Option<f64>,
    /// Which target to read, of a log of several
    #[arg(long, value_name = "NAME")]
    pub target: Option<String>,
    /// The file is a log of a radio's port: dwm1001, linktrack, mauwb or plain
    #[arg(long, value_name = "NAME")]
    pub format: Option<String>,
    /// Reports a second of such a log, if it has no stamps
    #[arg(long, value_name = "HZ", value_parser = number, allow_negative_numbers = true)]
    pub rate: Option<f64>,
    /// Unit of the stamps of such a log, if they are whole numbers: s, ms, us or ns
    #[arg(long, value_name = "UNIT")]
    pub stamp_unit: Option<String>,
    /// Refuse the file at its first bad row, and exit with 1 if the report's verdict is that the result is not sound
    #[arg(long)]
    pub strict: bool,
}
