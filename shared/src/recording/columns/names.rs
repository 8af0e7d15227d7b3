//! Common names of columns.

use super::Role;
use crate::recording::table::unit::{Unit, UnitKind};

/// The kind of table with the columns: `x` is an anchor's place in one and the target's in another.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::recording) enum Kind {
    /// Ranges.
    Log,
    /// Places of sensors.
    Anchors,
    /// Places of the target.
    Track,
}

impl Kind {
    /// The name of a role's column in rangehound's own files.
    pub(in crate::recording) fn own_name(self, role: Role) -> &'static str {
        match (self, role) {
            (_, Role::Time) => "time_s",
            (_, Role::Sensor) => "sensor_id",
            (_, Role::Range) => "range_m",
            (Self::Log, Role::X) => "sensor_x_m",
            (Self::Log, Role::Y) => "sensor_y_m",
            (Self::Log, Role::Z) => "sensor_z_m",
            (_, Role::X) => "x_m",
            (_, Role::Y) => "y_m",
            (_, Role::Z) => "z_m",
            (_, Role::Target) => "target_id",
            (_, Role::Bearing) => "bearing_rad",
            (_, Role::Heading) => "sensor_heading_rad",
            (_, Role::PositionStd) => "sensor_std_m",
            (_, Role::HeadingStd) => "sensor_heading_std_rad",
        }
    }

    /// How well a name fits a role: 0 is best.
    pub(in crate::recording) fn rank(self, role: Role, column: &str) -> Option<usize> {
        if column.eq_ignore_ascii_case(self.own_name(role)) {
            return Some(0);
        }
        let Name { key, unit, .. } = Name::read(column);
        // An angle about an axis, such as `x_deg`, is not a coordinate of unknown unit.
        if unit.is_some_and(|unit| unit.kind() == UnitKind::Angle && !role.takes(unit)) {
            return None;
        }
        let is_axis = |axis: &str| AXES.iter().any(|axes| axes.replace('*', axis) == key);
        let is_target_axis = |axis: &str| TARGET_AXES.iter().any(|axes| axes.replace('*', axis) == key);
        let (sure, likely): (bool, bool) = match role {
            Role::Time => (TIME.contains(&&*key), TIME_LIKELY.contains(&&*key)),
            Role::Sensor => (SENSOR.contains(&&*key), SENSOR_LIKELY.contains(&&*key)),
            Role::Range => (RANGE.contains(&&*key), RANGE_LIKELY.contains(&&*key)),
            Role::Target => (TARGET.contains(&&*key), false),
            Role::Bearing => (BEARING.contains(&&*key), false),
            Role::Heading => (HEADING.contains(&&*key), false),
            Role::PositionStd => (POSITION_STD.contains(&&*key), false),
            Role::HeadingStd => (HEADING_STD.contains(&&*key), false),
            Role::X | Role::Y | Role::Z => {
                let axis = role.key();
                let of_table = if self == Self::Track { is_target_axis(axis) } else { is_axis(axis) };
                let is_height = role == Role::Z && (key == "sensorheight" || key == "anchorheight");
                let plain = [axis, &format!("pos{axis}"), &format!("position{axis}"), &format!("{axis}pos")];
                (of_table || is_height, plain.contains(&&*key))
            }
        };
        if sure {
            Some(1)
        } else if likely {
            Some(2)
        } else {
            None
        }
    }

    /// True if a header's name is known.
    pub(in crate::recording) fn knows(self, column: &str) -> bool {
        let roles: &[Role] = match self {
            Self::Log => &Role::ALL,
            Self::Anchors => &[Role::Sensor, Role::X, Role::Y, Role::Z],
            Self::Track => &[Role::Time, Role::X, Role::Y],
        };
        roles.iter().any(|role| self.rank(*role, column).is_some())
    }
}

const TIME: [&str; 12] = [
    "time",
    "timestamp",
    "timestamps",
    "stamp",
    "datetime",
    "unixtime",
    "epoch",
    "epochtime",
    "rostime",
    "timeutc",
    "headerstamp",
    "unixtimestamp",
];
const TIME_LIKELY: [&str; 6] = ["t", "ts", "utc", "date", "elapsed", "elapsedtime"];

const SENSOR: [&str; 21] = [
    "sensor",
    "sensorid",
    "sensorname",
    "anchor",
    "anchorid",
    "anchorname",
    "anchoraddr",
    "anchoraddress",
    "beacon",
    "beaconid",
    "beaconname",
    "station",
    "stationid",
    "node",
    "nodeid",
    "responder",
    "responderid",
    "bssid",
    "apid",
    "accesspoint",
    "anchormac",
];
const SENSOR_LIKELY: [&str; 9] = ["id", "name", "mac", "macaddress", "addr", "address", "ap", "device", "deviceid"];

const RANGE: [&str; 10] = [
    "range",
    "distance",
    "dist",
    "measuredrange",
    "measureddistance",
    "slantrange",
    "slantdistance",
    "uwbrange",
    "uwbdistance",
    "rangemeasured",
];
const RANGE_LIKELY: [&str; 4] = ["d", "r", "measurement", "ranging"];

const TARGET: [&str; 8] = ["target", "targetid", "targetname", "tag", "tagid", "tagname", "mobile", "mobileid"];

// Few, because a heading without the sensor's name may be the target's, and an azimuth or a yaw clockwise.
const BEARING: [&str; 3] = ["bearing", "measuredbearing", "bearingmeasured"];
const HEADING: [&str; 2] = ["sensorheading", "anchorheading"];
const POSITION_STD: [&str; 4] = ["sensorstd", "anchorstd", "sensorpositionstd", "anchorpositionstd"];
const HEADING_STD: [&str; 2] = ["sensorheadingstd", "anchorheadingstd"];

const AXES: [&str; 9] =
    ["sensor*", "anchor*", "beacon*", "station*", "node*", "sensorpos*", "anchorpos*", "*sensor", "*anchor"];
const TARGET_AXES: [&str; 7] = ["truth*", "true*", "target*", "tag*", "gt*", "groundtruth*", "poseposition*"];

/// A column's name, split into parts.
#[derive(Debug, PartialEq, Eq)]
pub(in crate::recording) struct Name {
    /// Letters and digits in lower case, without the unit.
    pub(in crate::recording) key: String,
    /// Its words in lower case, without the unit.
    pub(in crate::recording) words: Vec<String>,
    /// The unit at its end.
    pub(in crate::recording) unit: Option<Unit>,
}

impl Name {
    /// Splits a name: `Dist (mm)`, `dist[mm]`, `dist_mm`, `dist.mm`.
    pub(in crate::recording) fn read(column: &str) -> Self {
        let lower = column.trim().to_lowercase();
        // As in exports of ROS topics.
        let lower = lower.strip_prefix("field.").unwrap_or(&lower);
        let (base, unit) = split_unit(lower);
        // A character that no known name has makes the name unknown; it is not dropped.
        let key = base.chars().filter(|c| !is_joint(*c)).collect();
        let words = base.split(is_joint).filter(|word| !word.is_empty()).map(str::to_owned).collect();
        Self { key, words, unit }
    }
}

fn is_joint(c: char) -> bool {
    matches!(c, '_' | '-' | ' ' | '.' | '/' | ':')
}

fn split_unit(lower: &str) -> (&str, Option<Unit>) {
    for (open, close) in [('(', ')'), ('[', ']')] {
        if let Some((base, unit)) = lower.strip_suffix(close).and_then(|rest| rest.rsplit_once(open)) {
            return (base.trim_end(), Unit::from_word(unit.trim()));
        }
    }
    match lower.rsplit_once(is_joint) {
        Some((base, last)) if !base.is_empty() && Unit::from_word(last).is_some() => (base, Unit::from_word(last)),
        _ => (lower, None),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_ends_in_its_unit() {
        for (column, key, unit) in [
            ("range_m", "range", Some(Unit::Metre)),
            ("Dist (mm)", "dist", Some(Unit::Millimetre)),
            ("distance[CM]", "distance", Some(Unit::Centimetre)),
            ("stamp.ns", "stamp", Some(Unit::Nanosecond)),
            ("t [\u{b5}s]", "t", Some(Unit::Microsecond)),
            ("Anchor ID", "anchorid", None),
            ("range (ft)", "range", None),
            ("Bearing (\u{b0})", "bearing", Some(Unit::Degree)),
            ("sensor_heading_std_rad", "sensorheadingstd", Some(Unit::Radian)),
            ("m", "m", None),
            ("_m", "m", None),
        ] {
            let name = Name::read(column);
            assert_eq!((name.key.as_str(), name.unit), (key, unit), "{column}");
        }
        assert_eq!(Name::read("d_anchor-3 (mm)").words, ["d", "anchor", "3"]);
    }

    #[test]
    fn exact_column_names_rank_before_common_ones() {
        assert_eq!(Kind::Log.rank(Role::Range, "Range_m"), Some(0));
        assert_eq!(Kind::Log.rank(Role::Range, "distance"), Some(1));
        assert_eq!(Kind::Log.rank(Role::Range, "d (mm)"), Some(2));
        assert_eq!(Kind::Log.rank(Role::Range, "range_std_m"), None);
        assert_eq!(Kind::Log.rank(Role::X, "anchor_x"), Some(1));
        assert_eq!(Kind::Log.rank(Role::X, "x"), Some(2));
        assert_eq!(Kind::Log.rank(Role::X, "tag_x"), None);
        assert_eq!(Kind::Log.rank(Role::X, "x_deg"), None);
        assert_eq!(Kind::Log.rank(Role::Bearing, "bearing_deg"), Some(1));
        assert_eq!(Kind::Log.rank(Role::Heading, "heading_rad"), None, "it may be the target's");
        assert_eq!(Kind::Log.rank(Role::PositionStd, "sensor_std_mm"), Some(1));
        assert_eq!(Kind::Track.rank(Role::X, "tag_x"), Some(1));
        assert_eq!(Kind::Anchors.rank(Role::Z, "anchor_height"), Some(1));
        assert!(!Kind::Log.knows("sensor_id,"), "a name with a separator in it is none");
    }
}
