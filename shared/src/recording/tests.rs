//! Logs in the forms that users have.

mod bearings;

use std::f64::consts::PI;
use std::path::Path;

use proptest::prelude::*;

use super::*;

const HEADER: &str = "time_s,sensor_id,sensor_x_m,sensor_y_m,range_m\n";

/// The recording that all forms below contain.
const PLAIN: &str = "time_s,sensor_id,sensor_x_m,sensor_y_m,range_m\n\
                     0.1,A,0,0,2.957\n0.1,B,10,0,8.391\n0.2,A,0,0,3.05\n0.3,B,10,0,8.25\n";

const ANCHORS: &str = "sensor_id,x_m,y_m\nA,0,0\nB,10,0\n";

fn read(text: impl AsRef<[u8]>, options: &ReadOptions) -> Result<(Recording, ReadSummary), RecordingError> {
    Recording::parse(text.as_ref(), Path::new("r.csv"), options)
}

fn with_columns(columns: &str) -> ReadOptions {
    ReadOptions { columns: columns.parse().unwrap(), ..ReadOptions::default() }
}

fn anchored(anchors: &str, columns: &str) -> ReadOptions {
    let columns: ColumnMap = if columns.is_empty() { ColumnMap::default() } else { columns.parse().unwrap() };
    let anchors = Anchors::parse(anchors.as_bytes(), Path::new("anchors.csv"), &columns).unwrap();
    ReadOptions { anchors: Some(anchors), columns, ..ReadOptions::default() }
}

fn strict() -> ReadOptions {
    ReadOptions { strict: true, ..ReadOptions::default() }
}

fn parse(rows: &str) -> Result<(Recording, ReadSummary), RecordingError> {
    read(format!("{HEADER}{rows}"), &ReadOptions::default())
}

fn of_instant(recording: &Recording, index: usize) -> Vec<RecordedMeasurement> {
    recording.instant(index).unwrap().1.collect()
}

fn complaint(text: impl AsRef<[u8]>, options: &ReadOptions) -> String {
    let complaint = read(text, options).unwrap_err().to_string();
    assert!(complaint.lines().count() == 1 && complaint.len() < 600, "{complaint:?}");
    complaint
}

/// The options to type, from a header's message.
fn typed(complaint: &str) -> String {
    let words = complaint.split("--columns ").nth(1).unwrap();
    let words = words
        .strip_prefix('\'')
        .map_or_else(|| words.split(' ').next().unwrap(), |quoted| quoted.split('\'').next().unwrap());
    words.trim_end_matches(',').to_owned()
}

#[test]
fn equal_stamps_become_one_instant_but_never_with_a_sensor_twice() {
    let (recording, _) = parse("0,9,0,0,1\n0,4,1,0,2\n1,9,0,0,3\n1,9,0,0,4\n").unwrap();
    assert_eq!(recording.sensors().iter().map(|s| s.name.as_str()).collect::<Vec<_>>(), ["4", "9"]);
    assert_eq!(recording.len(), 3);
    assert_eq!(recording.instant(0).unwrap().0, 0.0);
    assert_eq!(of_instant(&recording, 0).iter().map(|range| range.sensor).collect::<Vec<_>>(), [1, 0]);
    assert_eq!(of_instant(&recording, 1)[0].range_m, Some(3.0));
    assert_eq!(recording.instant(2).unwrap().0, 1.0);
    assert_eq!(of_instant(&recording, 2), [recording.readings.get(3)]);
    assert!(recording.instant(3).is_none());
}

#[test]
fn separators_decimal_marks_and_comments_are_found() {
    let (plain, summary) = read(PLAIN, &strict()).unwrap();
    assert_eq!(summary, ReadSummary { rows: 4, read_as: summary.read_as.clone(), ..ReadSummary::default() });
    let commas = |separator: &str| PLAIN.replace(',', separator).replace('.', ",");
    let quoted: String = PLAIN
        .lines()
        .map(|line| {
            line.split(',').map(|field| format!("\"{}\"", field.replace('.', ","))).collect::<Vec<_>>().join(",")
                + "\r\n"
        })
        .collect();
    let forms = [
        PLAIN.replace(',', ";"),
        PLAIN.replace(',', "\t"),
        PLAIN.replace(',', "  "),
        PLAIN.replace(',', " , "),
        PLAIN.replace(',', " \t "),
        commas(";"),
        commas("\t"),
        commas("   "),
        quoted,
        format!("\u{feff}{}", PLAIN.replace('\n', "\r\n")),
        format!("# a log\n\n% of today\n{}\n  \n\n", PLAIN.replace("\n0.2", "\n// a pause\n0.2")),
        format!("# a log\n#{PLAIN}"),
        format!("% {PLAIN}"),
        format!("//{PLAIN}"),
        format!("sep=;\n{}", commas(";")),
        PLAIN.replace('\n', ",\n"),
        PLAIN.replace("\n0", ",\n0"),
        PLAIN.to_uppercase(),
        format!(",{}", PLAIN.replace('\n', "\n,").trim_end_matches(',')),
        PLAIN.trim_end().to_owned(),
    ];
    for form in forms {
        let (recording, summary) = read(&form, &strict()).unwrap_or_else(|error| panic!("{form}: {error}"));
        assert_eq!(recording, plain, "{form}");
        assert_eq!(summary.bad_rows, 0, "{form}");
    }
}

#[test]
fn columns_are_known_by_common_names_with_units() {
    let (plain, _) = read(PLAIN, &strict()).unwrap();
    let body = "100;A;0;0;2957\n100;B;1000;0;8391\n200;A;0;0;3050\n300;B;1000;0;8250\n";
    for header in [
        "timestamp_ms;anchor_id;anchor_x_cm;anchor_y_cm;distance_mm",
        "Time (ms);Anchor ID;x [cm];y [cm];Dist (mm)",
        "t_ms;beacon;x_cm;y_cm;range.mm",
        "stamp[ms];id;sensor_x_cm;sensor_y_cm;d_mm",
    ] {
        let (recording, _) =
            read(format!("{header}\n{body}"), &strict()).unwrap_or_else(|error| panic!("{header}: {error}"));
        assert_eq!(recording, plain, "{header}");
    }
    let iso = PLAIN.replace("time_s", "timestamp").replace("\n0.", "\n2024-05-01T12:00:00.");
    let (recording, _) = read(iso, &strict()).unwrap();
    assert_eq!(recording.instant(1).unwrap().0, 1_714_564_800.2);
}

#[test]
fn units_that_cannot_be_told_are_asked_for_with_the_line_to_type() {
    let (plain, _) = read(PLAIN, &strict()).unwrap();
    for (header, names) in [
        ("timestamp,anchor,sensor_x_m,sensor_y_m,distance", vec!["\"timestamp\"", "\"distance\"", "range=distance:m"]),
        ("t,anchor,x,y,range (ft)", vec!["x=x:m", "y=y:m", "range=range (ft):m"]),
        ("time_s,id,x_m,y_m,dist", vec!["range=dist:m", "m, cm, mm"]),
    ] {
        let text = PLAIN.replace("time_s,sensor_id,sensor_x_m,sensor_y_m,range_m", header);
        let complaint = complaint(&text, &ReadOptions::default());
        assert!(
            complaint.starts_with("unknown unit") && complaint.contains(" in r.csv, row 0 (line 1, the header): "),
            "{complaint}"
        );
        for name in names {
            assert!(complaint.contains(name), "{complaint}");
        }
        // The suggested option must be right too.
        let (recording, _) = read(&text, &with_columns(&typed(&complaint))).unwrap();
        assert_eq!(recording, plain, "{complaint}");
    }
    let ns = "timestamp,sensor_id,sensor_x_m,sensor_y_m,range_m\n1700000000000000000,A,0,0,1\n";
    assert!(complaint(ns, &ReadOptions::default()).contains("--columns time=timestamp:ns "));
}

#[test]
fn columns_that_are_told_go_before_names() {
    let (plain, _) = read(PLAIN, &strict()).unwrap();
    let text = PLAIN.replace("time_s,sensor_id,sensor_x_m,sensor_y_m,range_m", "zeit,wer,sensor_x_m,sensor_y_m,weite");
    let (recording, _) = read(&text, &with_columns("time=zeit:s,sensor=WER,range=weite:m")).unwrap();
    assert_eq!(recording, plain);
    let (recording, _) = read(&text, &with_columns("time=1:s,sensor=2,range=5:m")).unwrap();
    assert_eq!(recording, plain);
    let body = PLAIN.split_once('\n').unwrap().1;
    let (recording, _) = read(body, &with_columns("time=1:s,sensor=2,x=3:m,y=4:m,range=5:m")).unwrap();
    assert_eq!(recording, plain, "a file without a header");
    assert!(complaint(body, &ReadOptions::default()).starts_with("values instead of names, \"0.1,A,"));
    let missing = complaint(&text, &with_columns("time=uhr:s"));
    assert!(
        missing.contains("--columns time=uhr:s names no column in r.csv")
            && missing.contains("one of the columns \"zeit\", \"wer\""),
        "{missing}"
    );
    let unknown = complaint(&text, &ReadOptions::default());
    assert!(
        unknown.starts_with("missing column time_s in r.csv")
            && unknown.contains("among the columns \"zeit\"")
            && unknown.contains("--columns time=NAME")
    );
}

#[test]
fn a_first_row_of_values_is_no_header_though_it_holds_the_numbers_of_columns() {
    for (rows, first_range_m) in
        [("1,2,3\n2,2,4\n", 3.0), ("0.1,3,2.957\n0.2,3,3\n", 2.957), ("# 1,2,3\n0.5,2,7\n", 7.0)]
    {
        // Places are given by number in the log, and by an anchors file with a header.
        let with_places: String = rows.lines().map(|row| format!("{row},0,0\n")).collect();
        let options = with_columns("time=1:s,sensor=2,range=3:m,x=4:m,y=5:m");
        let anchors = anchored("x_m,sensor_id,y_m\n0,2,0\n9,3,0\n", "time=1:s,sensor=2,range=3:m");
        for (text, options) in [(with_places.as_str(), &options), (rows, &anchors)] {
            let (recording, summary) = read(text, options).unwrap();
            let count = rows.lines().filter(|row| !row.starts_with('#')).count();
            assert_eq!((summary.rows as usize, summary.bad_rows), (count, 0), "{text}");
            assert_eq!(of_instant(&recording, 0)[0].range_m, Some(first_range_m), "{text}");
        }
    }
    let (recording, _) = read(PLAIN, &with_columns("time=1,sensor=2,range=5")).unwrap();
    assert_eq!(recording, read(PLAIN, &ReadOptions::default()).unwrap().0, "a header is none of the rows");
    let refused = Anchors::parse("A,0,0\n".as_bytes(), Path::new("a.csv"), &ColumnMap::default()).unwrap_err();
    assert!(!refused.to_string().contains("by number"), "{refused}");
}

#[test]
fn two_columns_that_fit_one_role_are_refused() {
    let text = "time_s,anchor,sensor_x_m,sensor_y_m,distance_m,slant_distance_m\n0,A,0,0,1,2\n0,B,0,0,1,2\n";
    let complaint = complaint(text, &ReadOptions::default());
    assert!(
        complaint.starts_with("several columns, \"distance_m\", \"slant_distance_m\", that may be the range, in r.csv"),
        "{complaint}"
    );
    assert!(complaint.contains("type --columns range=distance_m"), "{complaint}");
    let (recording, summary) = read(text, &with_columns("range=slant_distance_m")).unwrap();
    assert_eq!(of_instant(&recording, 0)[0].range_m, Some(2.0));
    assert_eq!(summary.ignored_columns, ["distance_m"]);
    // The own name fits best.
    let own = text.replace("slant_distance_m", "range_m");
    assert_eq!(of_instant(&read(own, &strict()).unwrap().0, 0)[0].range_m, Some(2.0));
}

#[test]
fn anchors_place_the_sensors_of_a_log() {
    let (plain, _) = read(PLAIN, &strict()).unwrap();
    let log: String = PLAIN
        .lines()
        .map(|line| {
            let fields: Vec<&str> = line.split(',').collect();
            format!("{},{},{}\n", fields[0], fields[1], fields[4])
        })
        .collect();
    let (recording, _) = read(&log, &anchored(ANCHORS, "")).unwrap();
    assert_eq!(recording, plain);
    let (recording, summary) =
        read(&log, &anchored("name;x (cm);y (cm);z (mm)\nA;0;0;2500\nB;1000;0;2500\nC;1;1;\n", "")).unwrap();
    assert_eq!(
        of_instant(&recording, 0)[1],
        RecordedMeasurement {
            sensor: 1,
            position_m: [10.0, 0.0],
            height_m: Some(2.5),
            range_m: Some(8.391),
            ..RecordedMeasurement::default()
        }
    );
    assert_eq!(summary.silent_anchors.iter().map(SensorName::as_str).collect::<Vec<_>>(), ["C"]);
    let (recording, _) = read(&log, &anchored("id,px,py\nA,0,0\nB,10000,0\n", "x=px:mm,y=py:mm")).unwrap();
    assert_eq!(recording, plain);

    let missing = complaint(&log, &anchored("sensor_id,x_m,y_m\nA,0,0\n", ""));
    assert!(
        missing.contains("sensors without a place, \"B\", in r.csv: expected a row for every sensor in anchors.csv"),
        "{missing}"
    );
    assert!(complaint(&log, &ReadOptions::default()).contains("or give the sensors' places by --anchors FILE"));
    // If both have places, the anchors file takes precedence.
    let (recording, summary) = read(PLAIN, &anchored(&ANCHORS.replace("10,0", "10,5"), "")).unwrap();
    assert_eq!(recording.sensors()[1].first_position_m, [10.0, 5.0]);
    assert_eq!(summary.ignored_columns, ["sensor_x_m", "sensor_y_m"]);
}

#[test]
fn anchors_files_are_refused_by_row() {
    let refused = |text: &str| {
        Anchors::parse(text.as_bytes(), Path::new("a.csv"), &ColumnMap::default()).unwrap_err().to_string()
    };
    assert!(refused("sensor_id,x_m,y_m\nA,0,0\nA,1,0\n").contains("row 2 (line 3): expected each anchor at one place"));
    assert!(
        refused("sensor_id,x_m,y_m\nA,0,zero\n")
            .starts_with("y_m is \"zero\" in a.csv, row 1 (line 2): expected a finite number")
    );
    assert!(
        refused("sensor_id,x_m,y_m\nA,0\n")
            .starts_with("y_m is missing, the row has 2 fields, in a.csv, row 1 (line 2): expected 3 fields")
    );
    assert!(refused("sensor_id,x_m,y_m\nA,0,5,1,5\n").contains("probably decimal commas"));
    assert!(refused("sensor_id,x,y_m\nA,0,0\n").contains("--columns x=x:m"));
    assert!(refused("sensor_id,x_m\n").contains("missing columns x_m and y_m"));
    assert!(refused("sensor_id,x_m,y_m\n").contains("expected a row for each anchor"));
    assert_eq!(refused(""), "a.csv is empty: expected a header that names the columns");
    assert_eq!(refused("# anchors\n"), "only comments in a.csv: expected a header that names the columns");
}

#[test]
fn wide_logs_have_a_column_for_each_anchor() {
    let (plain, _) = read(PLAIN, &strict()).unwrap();
    for (header, columns) in [
        ("time_s,range_A_m,range_B_m", ""),
        ("time_s,A (m),B (m)", ""),
        ("time_s,A,B", "range=*:m"),
        ("time_s,gemessen_A,gemessen_B", "range=gemessen_*:m"),
        ("t,A,B", "time=t:s,range=*:m"),
    ] {
        for nothing in ["", "nan", "0", "-1", "null"] {
            let text = format!("{header}\n0.1,2.957,8.391\n0.2,3.05,{nothing}\n0.3,{nothing},8.25\n");
            let (recording, summary) = read(text, &anchored(ANCHORS, columns)).unwrap();
            assert_eq!(recording, plain, "{header}");
            assert_eq!(summary.not_heard, if matches!(nothing, "0" | "-1") { 2 } else { 0 });
        }
    }
    let mm = "t_ms\tA_mm\tB_mm\trssi_A\n100\t2957\t8391\t-7\n200\t3050\t\t-8\n300\t\t8250\t-9\n";
    let (recording, summary) = read(mm, &anchored(ANCHORS, "")).unwrap();
    assert_eq!(recording, plain);
    assert_eq!(summary.ignored_columns, ["rssi_A"]);
    // Sensor names are numbers.
    let numbered = "time_s,1,2\n0.1,2.5,3\n";
    let complaint = complaint(numbered, &anchored("sensor_id,x_m,y_m\n1,0,0\n2,9,0\n", ""));
    assert!(complaint.contains("--columns 'range=*:m'"), "{complaint}");
    let (recording, _) = read(numbered, &anchored("sensor_id,x_m,y_m\n1,0,0\n2,9,0\n", &typed(&complaint))).unwrap();
    assert_eq!(recording.readings.len(), 2);
}

#[test]
fn wide_logs_that_cannot_be_told_apart_are_asked_about() {
    let rivals = complaint("time_s,range_A_m,dist_A_m\n0,1,2\n", &anchored(ANCHORS, ""));
    assert!(
        rivals.starts_with("several columns, \"range_A_m\", \"dist_A_m\", that may have the ranges of anchor \"A\""),
        "{rivals}"
    );
    assert!(rivals.contains("--columns 'range=range_*:m'"), "{rivals}");
    let alone = complaint("time_s,A_m,B_m\n0,1,2\n", &ReadOptions::default());
    assert!(alone.contains("a log with a column for each anchor needs --anchors FILE"), "{alone}");
    let none = complaint("time_s,A_m,B_m\n0,1,2\n", &anchored("sensor_id,x_m,y_m\nC,0,0\n", ""));
    assert!(none.contains("--columns 'range=PREFIX_*:UNIT'"), "{none}");
}

#[test]
fn heights_are_read_where_there_are_any() {
    let text = "time_s,sensor_id,sensor_x_m,sensor_y_m,sensor_z_m,range_m\n0,A,0,0,2.5,3\n0,B,9,0,,3\n";
    let (recording, summary) = read(text, &strict()).unwrap();
    let heights: Vec<_> = of_instant(&recording, 0).iter().map(|reading| reading.height_m).collect();
    assert_eq!(heights, [Some(2.5), None]);
    assert!(summary.ignored_columns.is_empty() && recording.has_heights());
    assert!(!read(PLAIN, &strict()).unwrap().0.has_heights());
}

#[test]
fn a_bad_row_is_passed_over_and_counted_unless_strict() {
    let good = "0,A,0,0,1\n0.1,B,9,0,1\n0.2,A,0,0,1\n";
    for (row, fault) in [
        ("0.3,A,0,zero,1", "sensor_y_m is \"zero\" in row 4 (line 5): expected a finite number within +-1e8"),
        ("0.3,A,0,0,NaN", "range_m is \"NaN\" in row 4 (line 5): expected a finite number from 0 to 1e6"),
        ("0.3,A,0,0,-1", "range_m is \"-1\" in row 4 (line 5): expected a finite number from 0 to 1e6"),
        ("0.3,A,0,0,", "range_m is \"\" in row 4 (line 5): expected a finite number from 0 to 1e6"),
        ("0.3,A,0,0,1e7", "range_m is \"1e7\" in row 4 (line 5): expected a finite number from 0"),
        ("inf,A,0,0,1", "time_s is \"inf\" in row 4 (line 5): expected a finite number within +-1e11"),
        ("1e308,A,0,0,1", "time_s is \"1e308\" in row 4 (line 5): expected a finite number within +-1e11"),
        ("0.3,,0,0,1", "sensor_id is \"\" in row 4 (line 5): expected a name of 1 to 64 bytes"),
        (
            "0.3,A,0,0",
            "range_m is missing, the row has 4 fields, in row 4 (line 5): expected 5 fields as in the header",
        ),
        ("0.3,\"A,0,0,1", " in row 4 (line 5): expected fields with a quote at both ends"),
        (",,,,", "time_s is \"\" in row 4 (line 5): expected a finite number within +-1e11"),
        ("0.3,\u{fffd}\u{1},0,0,1", "in row 4 (line 5): expected a name"),
    ] {
        let text = format!("{HEADER}{good}{row}\n0.4,B,9,0,1\n");
        let (recording, summary) = read(&text, &ReadOptions::default()).unwrap();
        assert_eq!((recording.readings.len(), summary.rows, summary.bad_rows), (4, 4, 1), "{row}");
        let first = summary.first_bad_row.clone().unwrap();
        assert!(first.contains(fault), "{row}: {first}");
        assert_eq!(summary.lines()[0], format!("1 bad row skipped, the first: {first}"));
        assert!(complaint(&text, &strict()).contains(" in r.csv, row "), "{row}");
    }
    let bytes = [format!("{HEADER}{good}").as_bytes(), b"0.3,\xff,0,0,1\n"].concat();
    assert_eq!(read(bytes, &ReadOptions::default()).unwrap().1.bad_rows, 1);
}

#[test]
fn a_file_of_which_most_rows_are_bad_is_refused() {
    let complaint = complaint(format!("{HEADER}0,A,0,0,x\n0,A,0,0,y\n0,B,0,0,1\n"), &ReadOptions::default());
    assert_eq!(
        complaint,
        "2 of 3 rows are bad in r.csv: expected mostly valid rows; the first bad one: range_m is \"x\" in row 1 (line 2): \
         expected a finite number from 0 to 1e6"
    );
}

#[test]
fn a_row_longer_than_its_header_is_never_misread() {
    for row in ["0.1,0,0.0,0.0,2,9572", "0,1000,0,0,000,0,000,2,9572", "0.1,0,0,000,0.0,2.9572"] {
        let complaint = complaint(format!("{HEADER}{row}\n"), &ReadOptions::default());
        assert!(complaint.contains("row 1 (line 2): expected 5 fields as in the header; "), "{complaint}");
        assert!(
            complaint.contains("probably decimal commas in a file whose columns are separated by commas"),
            "{complaint}"
        );
    }
    // One such row refuses the file even among valid rows: the meaning of the others is unknown then.
    let late = complaint(format!("{HEADER}0,A,0,0,1\n0.1,Smith, John,0,0,1\n"), &ReadOptions::default());
    assert!(
        late.contains("row is 6 fields long in r.csv, row 2 (line 3): expected 5 fields as in the header; the columns have shifted"),
        "{late}"
    );
    let decimal = format!("{HEADER}0.1,A,0,0,\"2,957\"\n0.2,A,0,0,\"3,1\"\n");
    assert!(
        complaint(&decimal, &ReadOptions::default()).contains("2 of 2 rows are bad"),
        "two decimal marks in one file"
    );
    assert!(complaint(&decimal, &ReadOptions::default()).contains(
        "is \"2,957\" in row 1 (line 2): expected a finite number from 0 to 1e6 with the decimal mark of the rows above"
    ));
}

#[test]
fn repeated_rows_are_dropped_and_counted() {
    let (recording, summary) = parse("0,A,0,0,1\n0,B,9,0,1\n0,A,0,0,1\n0,A,0,0,2\n0,B,9,0,1.0\n1,A,0,0,1\n").unwrap();
    assert_eq!((recording.len(), recording.readings.len(), summary.rows, summary.repeats), (3, 4, 4, 2));
    assert_eq!(of_instant(&recording, 1)[0].range_m, Some(2.0), "another range of the same stamp is new information");
    assert_eq!(summary.lines(), ["2 repeated rows dropped: equal to an earlier row"]);
}

#[test]
fn a_range_of_zero_means_not_heard() {
    let (recording, summary) = parse("0,A,0,0,1\n0,B,9,0,0\n1,A,0,0,0.0\n").unwrap();
    assert_eq!(
        (recording.readings.len(), recording.sensors().len(), summary.not_heard, summary.bad_rows),
        (1, 1, 2, 0)
    );
    assert!(complaint(format!("{HEADER}0,A,0,0,0\n1,B,0,0,0\n"), &ReadOptions::default()).contains("all 2 are 0"));
}

#[test]
fn rows_are_in_order_of_time() {
    let complaint = complaint(format!("{HEADER}2,1,0,0,1\n1,2,0,0,1\n"), &ReadOptions::default());
    assert!(
        complaint.contains("in r.csv, row 2 (line 3): expected a time not before the row above (2)"),
        "{complaint}"
    );
}

#[test]
fn a_recording_has_1_to_1024_sensors() {
    assert_eq!(parse("0,A,0,0,1\n1,A,0,0,1\n").unwrap().0.sensors().len(), 1);
    let rows: String = (0..1025).map(|id| format!("{HEADER}0,{id},0,0,1\n").split_off(HEADER.len())).collect();
    let complaint = complaint(format!("{HEADER}{rows}"), &ReadOptions::default());
    assert!(complaint.contains("row 1025 (line 1026): expected 1 to 1024 different sensors"), "{complaint}");
    assert!(self::complaint(HEADER, &ReadOptions::default()).contains("expected rows of ranges under the header"));
    assert!(
        self::complaint("", &ReadOptions::default()).contains(" is empty: expected a header that names the columns")
    );
}

#[test]
fn a_log_of_two_targets_asks_which() {
    let header = "time_s,sensor_id,target_id,sensor_x_m,sensor_y_m,range_m\n";
    let text = format!("{header}0,A,tag1,0,0,1\n0,A,tag2,0,0,2\n1,B,tag1,9,0,3\n");
    let complaint = complaint(&text, &ReadOptions::default());
    assert!(
        complaint.contains(
            "several targets, \"tag1\", \"tag2\", in column target_id in r.csv: expected one target: type --target NAME"
        ),
        "{complaint}"
    );
    let target = |name: &str| ReadOptions { target: Some(name.to_owned()), ..ReadOptions::default() };
    let (recording, summary) = read(&text, &target("tag1")).unwrap();
    assert_eq!((recording.readings.len(), summary.other_targets), (2, 1));
    let unknown = self::complaint(&text, &target("tag3"));
    assert!(
        unknown.contains("no target \"tag3\" (--target) in r.csv: expected one of the targets of column target_id: \"tag1\", \"tag2\""),
        "{unknown}"
    );
    assert!(self::complaint(PLAIN, &target("tag1")).contains("missing column target_id"));
    assert!(read(text.replace("tag2", "tag1"), &ReadOptions::default()).is_ok(), "one target needs no flag");
}

#[test]
fn stamps_in_another_unit_than_their_column_says_are_refused_or_doubted() {
    for (stamp, unit) in [("1700000000000", "ms"), ("1700000000000000", "us"), ("1700000000000000000", "ns")] {
        let text = format!("{HEADER}{stamp},A,0,0,1\n");
        let complaint = complaint(&text, &ReadOptions::default());
        assert!(complaint.contains(&format!("this looks like {unit} since 1970")), "{complaint}");
        let options = with_columns(&typed(&complaint));
        assert_eq!(read(&text, &options).unwrap().0.instant(0).unwrap().0, 1.7e9);
    }
    let rows: String =
        (0..40).map(|k| format!("{},{},{},0,{}\n", k * 50, k % 2, k % 2 * 10, 5.0 + 0.01 * f64::from(k))).collect();
    let text = format!("{HEADER}{rows}");
    let (_, summary) = read(&text, &ReadOptions::default()).unwrap();
    assert_eq!(summary.doubts[0].kind, DoubtKind::TimesInAnotherUnit);
    assert!(summary.doubts[0].text.contains("type --columns time=time_s:ms"), "{:?}", summary.doubts);
    let (_, summary) = read(&text, &with_columns("time=time_s:ms")).unwrap();
    assert_eq!(summary.doubts, []);
}

#[test]
fn ranges_in_another_unit_than_their_column_says_are_doubted() {
    let rows = |scale: f64| -> String {
        (0..40)
            .map(|k| {
                let (sensor, t) = (k % 2, f64::from(k) * 0.05);
                let range_m = (3.0 + t - 10.0 * f64::from(sensor)).hypot(2.0);
                format!("{t},{sensor},{},0,{}\n", sensor * 10, range_m * scale)
            })
            .collect()
    };
    assert_eq!(parse(&rows(1.0)).unwrap().1.doubts, []);
    for (scale, unit) in [(1000.0, "mm"), (100.0, "cm")] {
        let (_, summary) = parse(&rows(scale)).unwrap();
        assert_eq!(summary.doubts[0].kind, DoubtKind::RangesFarBeyondSensors, "{unit}");
        let line = format!("if they are in {unit}, type --columns range=range_m:{unit}");
        assert!(summary.doubts[0].text.contains(&line), "{:?}", summary.doubts);
    }
    let (_, summary) = parse(&rows(0.001)).unwrap();
    assert_eq!(summary.doubts[0].kind, DoubtKind::RangesFarBelowSensors);
}

#[test]
fn files_that_are_no_tables_say_so() {
    assert!(complaint([0xFF, 0xFE, b't', 0], &ReadOptions::default()).contains("iconv -f UTF-16 -t UTF-8"));
    assert!(
        complaint([0x1F, 0x8B, 8, 0], &ReadOptions::default())
            .contains("gzip: expected text: unpack it, or give `zcat FILE`")
    );
    for (start, word) in [
        (&b"\x28\xb5\x2f\xfd\x04abc"[..], "zstdcat FILE"),
        (b"BZh91AY&SY", "bzcat FILE"),
        (b"\xfd7zXZ\0\0", "xzcat FILE"),
        (b"PK\x03\x04\x14", "zip archive"),
        (b"t\0i\0m\0e\0", "iconv -f UTF-16LE"),
        (b"time_s,sensor_id\r0,1\r1,1\r", "CR only"),
    ] {
        assert!(complaint(start, &ReadOptions::default()).contains(word), "{word}");
    }
    assert!(complaint(HEADER, &ReadOptions::default()).contains("expected rows of ranges under the header"));
    let thousands = complaint(format!("{HEADER}0,1,0,0,\"1,234.5\"\n"), &ReadOptions::default());
    assert!(thousands.contains("without thousands separators"), "{thousands}");
    assert!(complaint(vec![b'x'; 100_000], &ReadOptions::default()).contains("line 1 has more than 65536 bytes"));
}

#[test]
fn tracks_are_read_as_recordings_are() {
    let read = |text: &str| parse_track(text.as_bytes(), Path::new("t.csv"));
    let plain = read("time_s,x_m,y_m\n0,1.5,2\n1,3,4.5\n").unwrap();
    assert_eq!(plain, [(0.0, [1.5, 2.0]), (1.0, [3.0, 4.5])]);
    assert_eq!(read("# mocap\nt_ms;z_m;X (mm);Y (mm)\n0;0;1500;2000\n1000;0;3000;4500,0\n").unwrap(), plain);
    let refused = |text: &str| read(text).unwrap_err().to_string();
    assert!(refused("time_s,x,y\n0,1,2\n").contains("expected a unit in each name, as in time_s, x_m, y_m"));
    assert!(refused("time_s,x_m\n0,1\n").contains("missing columns time_s and x_m and y_m"));
    assert!(refused("time_s,x_m,y_m\n0,1,2,5\n").contains("row 1 (line 2)"));
    assert!(refused("time_s,x_m,y_m\n1,1,2\n0,1,2\n").starts_with("time_s is \"0\" in t.csv, row 2 (line 3)"));
    assert!(refused("time_s,x_m,y_m\n1,1,2\n").contains("two rows"));
}

/// Text that a sensor's name may contain.
fn name() -> impl Strategy<Value = String> {
    proptest::collection::vec(
        prop_oneof![
            Just('"'),
            Just(','),
            Just(';'),
            Just(' '),
            Just('#'),
            Just('0'),
            Just('7'),
            Just('a'),
            Just('\u{e9}')
        ],
        1..6,
    )
    .prop_map(|chars| format!("n{}", chars.into_iter().collect::<String>()).trim().to_owned())
}

/// Bearing, heading, and the standard deviations of position and heading.
fn extras() -> impl Strategy<Value = [Option<f64>; 4]> {
    let some = |numbers: std::ops::Range<f64>| proptest::option::of(prop_oneof![Just(0.0), Just(PI), numbers]);
    prop_oneof![
        Just([None; 4]),
        (some(-PI..PI), some(-1e-300..1.0), some(0.0..9.0), some(0.0..0.1))
            .prop_map(|(bearing, heading, position, heading_std)| [bearing, heading, position, heading_std]),
    ]
}

proptest! {
    #[test]
    fn no_bytes_make_it_panic(bytes in proptest::collection::vec(any::<u8>(), 0..400), headed in any::<bool>()) {
        let mut text = if headed { HEADER.as_bytes().to_vec() } else { Vec::new() };
        text.extend(bytes);
        let _ = read(text, &ReadOptions::default());
    }

    #[test]
    fn a_written_recording_is_read_back_to_the_last_bit(
        rows in proptest::collection::vec(
            (prop_oneof![Just(0.0), 0.0..1e-3_f64, 0.0..10.0_f64], 0_usize..6, -9.0..9.0_f64,
             prop_oneof![Just(None), (-9.0..9.0_f64).prop_map(Some)],
             prop_oneof![Just(1.0), 0.0..1e-300_f64, 0.0..9.0_f64, 0.0..1e6_f64], any::<bool>(), extras()),
            1..80,
        ),
        names in proptest::collection::vec(name(), 6),
    ) {
        let mut gathering = rows::gathering::Gathering::new(None);
        let mut time_s = 1.7e9;
        for (dt_s, sensor, x_m, height_m, range_m, has_range, extras) in rows {
            time_s += dt_s;
            if range_m > 0.0 {
                let Ok(sensor) = gathering.sensor(names[sensor].as_bytes()) else { unreachable!() };
                let [bearing_rad, heading_rad, position_std_m, heading_std_rad] = extras;
                let reading = RecordedMeasurement {
                    sensor,
                    position_m: [x_m, -x_m],
                    height_m,
                    range_m: Some(range_m).filter(|_| has_range || bearing_rad.is_none()),
                    bearing_rad,
                    heading_rad,
                    position_std_m,
                    heading_std_rad,
                };
                prop_assert!(gathering.push(time_s, reading).is_ok());
            }
        }
        let (recording, _) = gathering.finish();
        prop_assume!(!recording.is_empty());
        let mut text = Vec::new();
        recording.write_csv(&mut text).unwrap();
        let (read_back, summary) = read(&text, &strict()).unwrap();
        prop_assert_eq!(&read_back, &recording);
        prop_assert_eq!(read_back.digest(), recording.digest());
        prop_assert_eq!((summary.repeats, summary.bad_rows, summary.not_heard), (0, 0, 0));
        let mut again = Vec::new();
        read_back.write_csv(&mut again).unwrap();
        prop_assert_eq!(again, text);
    }
}
