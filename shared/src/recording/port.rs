//! A log of a radio's port as a recording.

use std::io::{BufReader, Read};
use std::path::Path;

use super::error::{Complaint, Problem, listed};
use super::rows::gathering::{Gathering, Refusal};
use super::{ReadOptions, ReadSummary, RecordedMeasurement, Recording, RecordingError, SensorName};
use crate::radio::log::{LogError, LogOptions, LogSummary, for_each_row};
use crate::radio::{Format, LogRow, StampUnit};

/// The radio's format, and the options for its times.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PortLog {
    /// The format of the radio (`--format`).
    pub format: Format,
    /// Reports per second, if they have no stamps (`--rate`).
    pub rate_hz: Option<f64>,
    /// The unit of integer stamps, or of the radio's clock (`--stamp-unit`).
    pub stamp_unit: Option<StampUnit>,
}

/// Reads a log of a radio's port in a single pass.
pub(super) fn read<R: Read>(
    input: R,
    path: &Path,
    port: PortLog,
    options: &ReadOptions,
) -> Result<(Recording, ReadSummary), RecordingError> {
    let PortLog { format, rate_hz, stamp_unit } = port;
    let mut gathering = Gathering::new(options.anchors.as_ref());
    let mut unplaced: Vec<SensorName> = Vec::new();
    let mut refused = None;
    let log_options = LogOptions { rate_hz, stamp_unit, tag: options.target.clone() };
    let log = for_each_row(format, BufReader::new(input), &log_options, |row| {
        if refused.is_none() {
            refused = take(row, &mut gathering, &mut unplaced).err();
        }
    })
    .map_err(|error| RecordingError::new(path, problem_of(&error)))?;
    if let Some(complaint) = refused {
        return Err(RecordingError::new(path, Problem::Report(complaint)));
    }
    let mut summary = summary(&log);
    let bad = |wrong: String, hint: &str| Err(RecordingError::of_file(path, wrong, hint));
    if let Some(first) = &summary.first_bad_row {
        if options.strict {
            return bad(first.clone(), "expected only valid reports, because of --strict");
        }
        if log.refused > log.reports {
            let wrong = format!("{} of {} reports are bad, {first},", log.refused, log.refused + log.reports);
            return bad(wrong, "expected mostly valid reports: check --format");
        }
    }
    if !unplaced.is_empty() {
        let names = listed(unplaced.iter().map(SensorName::as_str));
        let hint = "expected a place for every anchor: give all by --anchors FILE (sensor_id,x_m,y_m)";
        return bad(format!("anchors without a place, {names},"), hint);
    }
    summary.read_as = format!("a log of a radio's port, --format {format}");
    summary.silent_anchors = gathering.silent_anchors();
    let (recording, repeats) = gathering.finish();
    (summary.repeats, summary.rows) = (repeats, recording.readings.len() as u64);
    Ok((recording, summary))
}

/// Adds one range, or returns why the log is refused.
fn take(row: LogRow, gathering: &mut Gathering<'_>, unplaced: &mut Vec<SensorName>) -> Result<(), Complaint> {
    let LogRow { time_s, anchor, position_m, range_m } = row;
    let refuse = |refusal| match refusal {
        Refusal::NoName(expected) | Refusal::TooMany(expected) => {
            Complaint::new("the anchor", expected, anchor.as_bytes())
        }
        Refusal::NotInOrder(before_s) => {
            Complaint::new("the time", format!("a time not before {before_s}"), time_s.to_string().as_bytes())
        }
    };
    let sensor = gathering.sensor(anchor.as_bytes()).map_err(refuse)?;
    let place = gathering.place(sensor).map(|place| (place.position_m, place.height_m));
    let place = place.or_else(|| position_m.map(|[x_m, y_m, z_m]| ([x_m, y_m], Some(z_m))));
    let Some((position_m, height_m)) = place else {
        if let Ok(name) = anchor.parse::<SensorName>()
            && !unplaced.contains(&name)
        {
            unplaced.push(name);
        }
        return Ok(());
    };
    let range_m = Some(range_m);
    let reading = RecordedMeasurement { sensor, position_m, height_m, range_m, ..RecordedMeasurement::default() };
    gathering.push(time_s, reading).map_err(refuse)
}

/// The parts of a log's error before and after its first colon: what is wrong, and what to do.
fn problem_of(error: &LogError) -> Problem {
    if let LogError::Unreadable(reason) = error {
        return Problem::unreadable(reason);
    }
    let text = error.to_string();
    let (wrong, hint) = text.split_once(": ").unwrap_or((&text, "expected another log"));
    Problem::File { wrong: wrong.to_owned(), hint: hint.to_owned() }
}

fn summary(log: &LogSummary) -> ReadSummary {
    let bad_rows = log.refused + log.back_in_time;
    let first_bad_row = match log.first_refused {
        Some((number, refusal)) => Some(format!("report {number} is {refusal}")),
        None if log.back_in_time > 0 => Some("a report is older than the one above it".to_owned()),
        None => None,
    };
    ReadSummary { bad_rows, first_bad_row, other_targets: log.other_tags, ..ReadSummary::default() }
}

#[cfg(test)]
mod tests {
    use super::super::{Anchors, ColumnMap};
    use super::*;

    fn options(format: Format) -> ReadOptions {
        ReadOptions { port: Some(PortLog { format, ..PortLog::default() }), ..ReadOptions::default() }
    }

    fn read(text: &str, options: &ReadOptions) -> Result<(Recording, ReadSummary), RecordingError> {
        Recording::parse(text.as_bytes(), Path::new("port.log"), options)
    }

    const DWM1001: &str = "10.0 DIST,2,AN0,022E,1.00,2.00,2.50,3.44,AN1,1234,9.00,2.00,2.50,5.50,POS,1.00,2.00,3.00,50\n\
                           10.1 DIST,1,AN0,022E,1.00,2.00,2.50,3.45\n10.2 DIST,1,AN0,02\n";

    #[test]
    fn a_log_of_a_port_is_a_recording() {
        let (recording, summary) = read(DWM1001, &options(Format::Dwm1001)).unwrap();
        assert_eq!(recording.sensors().iter().map(|sensor| sensor.name.as_str()).collect::<Vec<_>>(), ["1234", "022E"]);
        let (time_s, readings) = recording.instant(1).unwrap();
        let expected = RecordedMeasurement {
            sensor: 1,
            position_m: [1.0, 2.0],
            height_m: Some(2.5),
            range_m: Some(3.45),
            ..RecordedMeasurement::default()
        };
        assert_eq!((time_s, readings.collect::<Vec<_>>()), (10.1, vec![expected]));
        assert_eq!((summary.rows, summary.bad_rows), (3, 1));
        assert!(summary.first_bad_row.unwrap().starts_with("report 3 is "));
        let strict = ReadOptions { strict: true, ..options(Format::Dwm1001) };
        assert!(read(DWM1001, &strict).unwrap_err().to_string().contains(" in port.log: expected only valid reports"));
    }

    #[test]
    fn anchors_that_the_radio_does_not_place_come_from_a_file() {
        let log = "1.0 A,2.5\n1.1 B,3.5\n";
        let error = read(log, &options(Format::Plain)).unwrap_err().to_string();
        assert!(
            error.contains(
                "anchors without a place, \"A\", \"B\", in port.log: expected a place for every anchor: give all"
            ),
            "{error}"
        );
        let anchors = Anchors::parse(
            "sensor_id,x_m,y_m\nA,0,0\nB,5,0\n".as_bytes(),
            Path::new("anchors.csv"),
            &ColumnMap::default(),
        );
        let options = ReadOptions { anchors: Some(anchors.unwrap()), ..options(Format::Plain) };
        let (recording, _) = read(log, &options).unwrap();
        assert_eq!(recording.sensors()[1].first_position_m, [5.0, 0.0]);
    }

    #[test]
    fn a_log_of_a_port_is_known_where_it_is_taken_for_a_table() {
        let error = read(DWM1001, &ReadOptions::default()).unwrap_err().to_string();
        assert!(error.contains("--format dwm1001"), "{error}");
    }
}
