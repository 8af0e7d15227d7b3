//! Bearings, headings, and sensors whose places are uncertain.

use super::*;

const COLUMNS: &str = "time_s,sensor_id,sensor_x_m,sensor_y_m,range_m,bearing_rad,sensor_heading_rad,sensor_std_m,sensor_heading_std_rad\n";

fn measured(rows: &str) -> (Recording, ReadSummary) {
    read(format!("{COLUMNS}{rows}"), &strict()).unwrap()
}

fn refusal(row: &str) -> String {
    complaint(format!("{COLUMNS}{row}\n"), &strict())
}

fn bearings_rad(recording: &Recording) -> Vec<Option<f64>> {
    recording.readings.iter().map(|reading| reading.bearing_rad).collect()
}

#[test]
fn a_row_has_a_range_a_bearing_or_both() {
    let (recording, summary) =
        measured("0,A,1,2,3,0.5,-0.25,0.1,0.02\n1,A,1,2,,0.5,,0,0\n2,A,1,2,3,,,,\n3,A,1,2,0,1,,,\n");
    let place = RecordedMeasurement { position_m: [1.0, 2.0], ..RecordedMeasurement::default() };
    assert_eq!(
        recording.readings.iter().collect::<Vec<_>>(),
        [
            RecordedMeasurement {
                range_m: Some(3.0),
                bearing_rad: Some(0.5),
                heading_rad: Some(-0.25),
                position_std_m: Some(0.1),
                heading_std_rad: Some(0.02),
                ..place
            },
            RecordedMeasurement {
                bearing_rad: Some(0.5),
                position_std_m: Some(0.0),
                heading_std_rad: Some(0.0),
                ..place
            },
            RecordedMeasurement { range_m: Some(3.0), ..place },
            RecordedMeasurement { bearing_rad: Some(1.0), ..place },
        ]
    );
    assert_eq!((recording.ranges(), recording.bearings(), summary.rows, summary.not_heard), (2, 3, 4, 1));
    assert!(recording.has_ranges() && recording.has_bearings() && summary.ignored_columns.is_empty());
    // A bearing that comes late makes the ranges before it no longer.
    let (late, _) = measured("0,A,1,2,3,,,,\n1,A,1,2,,0.5,,,\n2,B,1,2,3,,,,\n");
    assert_eq!(bearings_rad(&late), [None, Some(0.5), None]);
}

#[test]
fn a_table_of_bearings_needs_no_column_of_ranges() {
    let text = "time_s,sensor_id,sensor_x_m,sensor_y_m,bearing_rad\n0,A,0,0,1\n0,B,9,0,2\n1,A,0,0,1.1\n";
    let (recording, summary) = read(text, &strict()).unwrap();
    assert_eq!((recording.len(), recording.ranges(), recording.bearings(), summary.rows), (2, 0, 3, 3));
    assert!(!recording.has_ranges() && summary.doubts.is_empty());
    let anchored = anchored(ANCHORS, "");
    let placed = read("time_s,sensor_id,bearing_deg\n0,A,90\n0,B,180\n", &anchored).unwrap().0;
    assert_eq!(bearings_rad(&placed), [Some(PI / 2.0), Some(PI)]);
    assert_eq!(placed.sensors()[1].first_position_m, [10.0, 0.0]);
    let empty = complaint(text.replace("B,9,0,2", "B,9,0,"), &strict());
    assert!(
        empty.contains("bearing_rad is \"\" in r.csv, row 2 (line 3): expected a range, a bearing or both"),
        "{empty}"
    );
    let neither = complaint("time_s,sensor_id,sensor_x_m,sensor_y_m\n0,A,0,0\n", &strict());
    assert!(neither.contains("missing column range_m") && neither.contains("bearing=NAME:UNIT"), "{neither}");
}

#[test]
fn columns_of_bearings_are_given_by_name_or_number_with_their_units() {
    let (plain, _) = measured("0,A,0,0,2,3.141592653589793,1.5707963267948966,0.25,0.5\n");
    let degrees = |header: &str, columns: &str| {
        let text = format!("{header}\n0,A,0,0,2,180,90,250,{}\n", 0.5_f64.to_degrees());
        read(text, &ReadOptions { strict: true, ..with_columns(columns) }).unwrap().0
    };
    let by_name = "time_s,sensor_id,sensor_x_m,sensor_y_m,range_m,Bearing (\u{b0}),sensor_heading_deg,sensor_std_mm,sensor_heading_std [deg]";
    assert_eq!(degrees(by_name, "time=time_s:s"), plain);
    let other = "t,id,x,y,d,aoa,yaw,s,ys";
    let roles = "time=t:s,sensor=id,x=x:m,y=y:m,range=d:m";
    let angles = "bearing=aoa:deg,heading=yaw:deg,position_std=s:mm,heading_std=ys:deg";
    assert_eq!(degrees(other, &format!("{roles},{angles}")), plain);
    let numbers =
        "time=1:s,sensor=2,x=3:m,y=4:m,range=5:m,bearing=6:deg,heading=7:deg,position_std=8:mm,heading_std=9:deg";
    assert_eq!(degrees("", numbers), plain);
    // A log without a header, whose anchors are numbers as its columns are.
    let numbered = anchored("sensor_id,x_m,y_m\n1,0,0\n2,9,0\n3,0,9\n", "time=1:s,sensor=2,bearing=3:deg");
    assert_eq!(bearings_rad(&read("0,2,90\n1,3,180\n", &numbered).unwrap().0), [Some(PI / 2.0), Some(PI)]);
    // Without a unit.
    let text = "time_s,sensor_id,sensor_x_m,sensor_y_m,bearing\n0,A,0,0,0.5\n";
    let complaint = complaint(text, &ReadOptions::default());
    assert!(complaint.contains("--columns bearing=bearing:rad with the right one of rad, deg"), "{complaint}");
    assert_eq!(bearings_rad(&read(text, &with_columns(&typed(&complaint))).unwrap().0), [Some(0.5)]);
}

#[test]
fn columns_that_only_resemble_bearings_are_left_alone() {
    let text = PLAIN.replace("range_m\n", "range_m,heading_rad,yaw_deg,x_deg,azimuth\n");
    let text: String =
        text.lines().map(|line| format!("{line}{}\n", if line.contains("time") { "" } else { ",1,2,3,4" })).collect();
    let (recording, summary) = read(text, &strict()).unwrap();
    assert_eq!(recording, read(PLAIN, &strict()).unwrap().0);
    assert_eq!(summary.ignored_columns, ["heading_rad", "yaw_deg", "x_deg", "azimuth"]);
    // In a wide log too.
    let wide = "time_s,A_m,B_m,A_deg,bearing_rad\n0.1,2.957,8.391,1,2\n0.2,3.05,,1,2\n0.3,,8.25,1,2\n";
    let (recording, summary) = read(wide, &anchored(ANCHORS, "")).unwrap();
    assert_eq!(recording, read(PLAIN, &strict()).unwrap().0);
    assert_eq!(summary.ignored_columns, ["A_deg", "bearing_rad"]);
}

#[test]
fn angles_are_wrapped_to_one_turn() {
    let rows = [0.0, 3.0, -3.0, PI, -PI, 4.0, -4.0, 2.0 * PI, -2.0 * PI, 3.0 * PI, 12.5];
    let text: String = rows.iter().enumerate().map(|(k, angle)| format!("{k},A,0,0,,{angle},{angle},,\n")).collect();
    let (recording, _) = measured(&text);
    let expected = [0.0, 3.0, -3.0, PI, PI, 4.0 - 2.0 * PI, 2.0 * PI - 4.0, 0.0, 0.0, PI, 12.5 - 4.0 * PI];
    for (reading, expected) in recording.readings.iter().zip(expected) {
        let bearing = reading.bearing_rad.unwrap();
        assert!((bearing - expected).abs() < 1e-14 && -PI < bearing && bearing <= PI, "{bearing} {expected}");
        assert!(bearing != 0.0 || bearing.is_sign_positive());
        assert_eq!(reading.heading_rad, reading.bearing_rad);
    }
}

#[test]
fn bad_angles_and_standard_deviations_are_bad_rows() {
    let good = "0,A,0,0,1,1,1,0,0\n0.1,B,9,0,1,,,,\n";
    for (row, fault) in [
        (
            "1,A,0,0,1,NaN,0,0,0",
            "bearing_rad is \"NaN\" in row 3 (line 4): expected a finite angle of at most two turns",
        ),
        (
            "1,A,0,0,1,1000,0,0,0",
            "bearing_rad is \"1000\" in row 3 (line 4): expected a finite angle of at most two turns",
        ),
        ("1,A,0,0,1,0,inf,0,0", "sensor_heading_rad is \"inf\" in row 3 (line 4): expected a finite angle of at most"),
        ("1,A,0,0,1,0,0,-0.1,0", "sensor_std_m is \"-0.1\" in row 3 (line 4): expected a finite number from 0 to 1e6"),
        (
            "1,A,0,0,1,0,0,0,-0.1",
            "sensor_heading_std_rad is \"-0.1\" in row 3 (line 4): expected a finite angle from 0",
        ),
        ("1,A,0,0,1,0,0,0,x", "sensor_heading_std_rad is \"x\" in row 3 (line 4): expected a finite angle from 0"),
        ("1,A,0,0,-1,0,0,0,0", "range_m is \"-1\" in row 3 (line 4): expected a finite number from 0 to 1e6"),
        ("1,A,0,0,,,0,0,0", "range_m is \"\" in row 3 (line 4): expected a range, a bearing or both"),
    ] {
        let (recording, summary) = read(format!("{COLUMNS}{good}{row}\n"), &ReadOptions::default()).unwrap();
        assert_eq!((recording.readings.len(), summary.bad_rows), (2, 1), "{row}");
        let first = summary.first_bad_row.unwrap();
        assert!(first.starts_with(fault), "{row}: {first}");
    }
}

#[test]
fn degrees_in_a_column_of_radians_refuse_the_file() {
    for (row, expected) in [
        ("0,A,0,0,,-45,0,0,0", "--columns bearing=bearing_rad:deg"),
        ("0,A,0,0,,1,270,0,0", "--columns heading=sensor_heading_rad:deg"),
        ("0,A,0,0,,1,0,0,5", "--columns heading_std=sensor_heading_std_rad:deg"),
    ] {
        let text = format!("{COLUMNS}1,A,0,0,1,1,1,0,0\n{}\n", row.replacen('0', "2", 1));
        let complaint = complaint(&text, &ReadOptions::default());
        assert!(
            complaint.contains("row 2 (line 3)")
                && complaint.ends_with(&format!("if it is in degrees, type {expected}")),
            "{complaint}"
        );
        assert!(read(&text, &with_columns(&typed(&complaint))).is_ok(), "{complaint}");
    }
    assert!(refusal("0,A,0,0,,13,0,0,0").contains("if it is in degrees"));
    assert!(!refusal("0,A,0,0,,721,0,0,0").contains("if it is in degrees"), "no angle in degrees either");
}

#[test]
fn rows_that_differ_in_a_bearing_alone_are_no_repeats() {
    let (recording, summary) = measured(
        "0,A,0,0,1,0.5,,,\n0,B,9,0,1,,,,\n0,A,0,0,1,0.5,,,\n0,A,0,0,1,0.6,,,\n0,A,0,0,1,0.5,0.1,,\n0,A,0,0,1,0.5,,0.1,\n0,A,0,0,1,,,,\n",
    );
    assert_eq!((recording.len(), summary.rows, summary.repeats), (5, 6, 1));
    let bearings = [Some(0.5), None, Some(0.6), Some(0.5), Some(0.5), None];
    assert_eq!(bearings_rad(&recording), bearings, "numbers stay with their rows");
    // Nor do sensors keep another's bearing once they are in order of their names.
    let (sorted, _) = measured("0,B,0,0,,0.5,,,\n0,A,0,0,1,,,,\n");
    assert_eq!(
        sorted.readings.iter().map(|r| (r.sensor, r.bearing_rad)).collect::<Vec<_>>(),
        [(1, Some(0.5)), (0, None)]
    );
}

#[test]
fn the_copy_has_only_the_columns_that_the_recording_has() {
    let copy = |rows: &str| {
        let recording = measured(rows).0;
        let mut text = Vec::new();
        recording.write_csv(&mut text).unwrap();
        let (again, _) = read(&text, &strict()).unwrap();
        assert_eq!((&again, again.digest()), (&recording, recording.digest()));
        String::from_utf8(text).unwrap()
    };
    let start = "time_s,sensor_id,sensor_x_m,sensor_y_m,range_m";
    assert_eq!(copy("0,A,0,0,2,,,,\n"), format!("{start}\n0,A,0,0,2\n"));
    assert_eq!(
        copy("0,A,0,0,2,,,,\n1,A,0,0,,1,,,0.5\n"),
        format!("{start},bearing_rad,sensor_heading_std_rad\n0,A,0,0,2,,\n1,A,0,0,,1,0.5\n")
    );
    assert_eq!(copy("0,A,0,0,2,,,0.5,\n"), format!("{start},sensor_std_m\n0,A,0,0,2,0.5\n"));
}

#[test]
fn the_digest_covers_bearings_and_that_of_ranges_has_not_changed() {
    let digest = |text: &str| read(text, &strict()).unwrap().0.digest();
    // Runs that were recorded before there were bearings have these.
    let plain = "RecordingDigest { ranges: 4, hash: 79694579792374693794728494717584449635 }";
    assert_eq!(format!("{:?}", digest(PLAIN)), plain);
    let heights =
        PLAIN.replace("range_m", "sensor_z_m,range_m").replace("A,0,0,", "A,0,0,2.5,").replace("B,10,0,", "B,10,0,,");
    let with_heights = "RecordingDigest { ranges: 4, hash: 302971842068051708458605919891341998904 }";
    assert_eq!(format!("{:?}", digest(&heights)), with_heights);
    let rows = ["2,,,,", "2,0,,,", "2,,0,,", "2,,,0,", "2,,,,0", ",0,,,", "2,0,0,,", "2,1,,,"];
    let digests: Vec<RecordingDigest> = rows.iter().map(|row| digest(&format!("{COLUMNS}0,A,0,0,{row}\n"))).collect();
    for (index, one) in digests.iter().enumerate() {
        assert!(!digests[index + 1..].contains(one), "{}", rows[index]);
    }
}
