//! The flags for reading a recording.

use std::path::PathBuf;

use clap::Args;

use super::values::number;
use crate::failure::Failure;
use crate::files::{bag, input};
use crate::results::report::Truth;

/// The flags of a recording.
#[derive(Debug, Clone, Default, Args)]
pub struct InputArgs {
    /// Recorded ranges and bearings: a table with a row for each measurement (a file, a pipe, or - for standard input), or a
    /// ROS 2 bag (its folder, or one of its files)
    pub ranges: PathBuf,
    /// Names and units of the columns, as in time=stamp_ns:ns,sensor=anchor_id,range=dist:mm; the keys are time, sensor,
    /// range, x, y, z, target, bearing, heading, position_std and heading_std [default: by the header's names]
    #[arg(long, value_name = "SPEC")]
    pub columns: Option<String>,
    /// In a ROS 2 bag: the topic with the measurements; * stands for a part of the name, as in /robot_*/range; several with
    /// commas [if missing: an error lists the topics]
    #[arg(long, value_name = "TOPIC")]
    pub topic: Option<String>,
    /// In a ROS 2 bag: the field with the range, as in range or ranges[].distance:mm (unit m, cm or mm); short for
    /// --columns range=FIELD [default: the field of sensor_msgs/Range]
    #[arg(long, value_name = "FIELD")]
    pub field: Option<String>,
    /// In a ROS 2 bag: the topic with the sensor's position, as in /odom or /robot_*/pose, and maybe the field
    #[arg(long, value_name = "TOPIC[:FIELD]")]
    pub position: Option<String>,
    /// In a ROS 2 bag without definitions (sqlite3 files of Humble): a message type and the file with its fields, repeatable
    #[arg(long, value_name = "TYPE=FILE")]
    pub msg: Vec<String>,
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
    /// With --format: reports per second, if the log has no time stamps
    #[arg(long, value_name = "HZ", value_parser = number, allow_negative_numbers = true)]
    pub rate: Option<f64>,
    /// With --format: unit of time stamps that are integers: s, ms, us or ns
    #[arg(long, value_name = "UNIT")]
    pub stamp_unit: Option<String>,
    /// Refuse the file at its first bad row, and exit with 1 if the verdict of the report is "not valid"
    #[arg(long)]
    pub strict: bool,
}

/// The true track to compare with.
#[derive(Debug, Clone, Default, Args)]
pub struct TruthArgs {
    /// True track to compare with: CSV with time_s,x_m,y_m; the tracker never reads it
    #[arg(long, value_name = "FILE")]
    pub truth: Option<PathBuf>,
    /// In a ROS 2 bag: the topic with the true track, as in /vicon/target, and maybe the field
    #[arg(long, value_name = "TOPIC[:FIELD]", conflicts_with = "truth")]
    pub truth_topic: Option<String>,
}

impl TruthArgs {
    /// Reads the true track, if one is given.
    ///
    /// # Errors
    /// [`Failure::Input`] with the first fault of its file.
    pub fn read(&self, recording: &InputArgs) -> Result<Option<Truth>, Failure> {
        if let Some(topic) = &self.truth_topic {
            if !bag::is_bag(&recording.ranges) {
                let ranges = recording.ranges.display();
                return Err(Failure::input(format!(
                    "--truth-topic is given, but {ranges} is no ROS 2 bag: expected --truth FILE"
                )));
            }
            let points = input::bag_track(&recording.ranges, topic, &recording.msg).map_err(Failure::input)?;
            return Ok(Some(points.into()));
        }
        self.truth.as_deref().map(Truth::read).transpose()
    }
}
