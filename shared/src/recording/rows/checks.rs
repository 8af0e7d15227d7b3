//! Plausibility checks of a recording's units.

use crate::ROBOTS_MAX;
use crate::recording::columns::{ColumnMap, ColumnOption, Role};
use crate::recording::table::unit::Unit;
use crate::recording::{Doubt, DoubtKind, RecordedMeasurement, Recording};

/// Fewest instants, or pairs of ranges, for a check.
const FEWEST: usize = 8;

/// Approximate maximum of instants and ranges that are checked.
const SAMPLES: usize = 20_000;

/// Ratio of ranges to the sensors' distances above which the unit is wrong, or the ranges are useless.
const FAR: f64 = 100.0;

/// The columns of the numbers, for the option to type.
pub(super) struct Columns<'a> {
    pub(super) map: &'a ColumnMap,
    pub(super) time: (usize, Option<&'a String>),
    pub(super) time_unit: Unit,
    /// `None` in a wide log, or if there are only bearings.
    pub(super) range: Option<(usize, Option<&'a String>)>,
    pub(super) are_ranges_in_m: bool,
    pub(super) are_placed_by_rows: bool,
}

/// The option to type if a column has another unit.
pub(super) fn line_to_type(map: &ColumnMap, role: Role, name: Option<&String>, index: usize, unit: Unit) -> String {
    let is_plain = |name: &&String| name.len() <= 40 && !name.chars().any(|c| c.is_control() || ",='\"".contains(c));
    let column = name.filter(is_plain).cloned().unwrap_or_else(|| (index + 1).to_string());
    format!("type {}", map.line_to_type(&[ColumnOption { role, column, unit: Some(unit) }]))
}

/// Reasons to distrust a recording.
pub(super) fn doubts(recording: &Recording, columns: &Columns<'_>) -> Vec<Doubt> {
    [of_ranges(recording, columns), of_times(recording, columns)].into_iter().flatten().collect()
}

/// Checks the triangle inequality: two ranges of one moment and the distance of their sensors.
fn of_ranges(recording: &Recording, columns: &Columns<'_>) -> Option<Doubt> {
    let pairs = pairs(recording);
    let share = |is_wrong: &dyn Fn(&Pair) -> bool| pairs.iter().filter(|pair| is_wrong(pair)).count() * 2 > pairs.len();
    let is_judged = pairs.len() >= FEWEST;
    let spread_m = spread_m(recording);
    let far = ranges(recording).filter(|reading| reading.range_m >= FAR * spread_m).count();
    let are_far = spread_m > 0.0 && far * 2 > ranges(recording).count();
    let median_m = median(ranges(recording).map(|reading| reading.range_m));
    let text = |what: &str, hint: String| {
        format!(
            "most ranges are far {what} than the sensors' distances from each other allow (median range {median_m:.4} \
             m, sensors within {spread_m:.4} m): {hint}"
        )
    };
    if are_far || is_judged && share(&Pair::is_too_long) {
        let ratio = |unit: Unit| median_m * 10_f64.powi(unit.power_of_ten()) / spread_m;
        // In the right unit a range is about as long as the sensors' field is wide.
        let surprise = |unit: &Unit| ratio(*unit).ln().abs();
        let units = [Unit::Centimetre, Unit::Millimetre];
        let unit = units.into_iter().min_by(|one, other| surprise(one).total_cmp(&surprise(other)));
        let Some(unit) = unit.filter(|unit| columns.are_ranges_in_m && (0.02..20.0).contains(&ratio(*unit))) else {
            let hint = "look at the units of ranges and positions, and at what the column of ranges has".to_owned();
            return Some(Doubt { kind: DoubtKind::RangesFarBeyondSensors, text: text("longer", hint) });
        };
        let (column, index, name) = match columns.range {
            Some((index, name)) => (None, index, name),
            None => (Some("*".to_owned()), 0, None),
        };
        let line = line_to_type(columns.map, Role::Range, column.as_ref().or(name), index, unit);
        let text = text("longer", format!("if they are in {}, {line}", unit.symbol()));
        return Some(Doubt { kind: DoubtKind::RangesFarBeyondSensors, text });
    }
    if is_judged && share(&Pair::is_too_short) {
        let of = if columns.are_placed_by_rows { "the sensors' positions" } else { "the anchors' positions" };
        let text = text("shorter", format!("if {of} are in another unit, type it, as in --columns x=x:mm,y=y:mm"));
        return Some(Doubt { kind: DoubtKind::RangesFarBelowSensors, text });
    }
    None
}

/// Two ranges from different sensors in direct succession.
struct Pair {
    ranges_m: [f64; 2],
    distance_m: f64,
}

impl Pair {
    /// With a margin for bias, noise, and the target's motion between both.
    fn is_too_long(&self) -> bool {
        let [one_m, other_m] = self.ranges_m;
        (one_m - other_m).abs() > 3.0 * self.distance_m + 0.05 * one_m.max(other_m) + 1.0
    }

    fn is_too_short(&self) -> bool {
        self.distance_m > 3.0 * (self.ranges_m[0] + self.ranges_m[1]) + 1.0
    }
}

fn pairs(recording: &Recording) -> Vec<Pair> {
    const APART_MAX_S: f64 = 2.0;
    let mut pairs = Vec::new();
    let mut last: Option<(f64, Ranging)> = None;
    for index in sample(recording.len()) {
        let Some((time_s, readings)) = recording.instant(index) else { break };
        for reading in readings.filter_map(Ranging::of) {
            if let Some((before_s, before)) = last
                && before.sensor != reading.sensor
                && time_s - before_s <= APART_MAX_S
            {
                let apart_m = [0, 1].map(|axis| reading.position_m[axis] - before.position_m[axis]);
                let distance_m = apart_m[0].hypot(apart_m[1]);
                pairs.push(Pair { ranges_m: [before.range_m, reading.range_m], distance_m });
            }
            last = Some((time_s, reading));
        }
    }
    pairs
}

/// A measurement that has a range.
#[derive(Clone, Copy)]
struct Ranging {
    sensor: usize,
    position_m: [f64; 2],
    range_m: f64,
}

impl Ranging {
    fn of(measurement: RecordedMeasurement) -> Option<Self> {
        let RecordedMeasurement { sensor, position_m, range_m, .. } = measurement;
        range_m.map(|range_m| Self { sensor, position_m, range_m })
    }
}

/// Ranges spread over the recording.
fn ranges(recording: &Recording) -> impl Iterator<Item = Ranging> {
    recording.readings.iter().step_by(recording.readings.len() / SAMPLES + 1).filter_map(Ranging::of)
}

/// The first instants: they must be consecutive.
fn sample(len: usize) -> std::ops::Range<usize> {
    0..len.min(SAMPLES)
}

/// Diagonal of the sensors' field, m.
fn spread_m(recording: &Recording) -> f64 {
    let axis = |axis: usize| {
        let values = ranges(recording).map(|reading| reading.position_m[axis]);
        let (least, most) =
            values.fold((f64::MAX, f64::MIN), |(least, most), value| (least.min(value), most.max(value)));
        most - least
    };
    axis(0).hypot(axis(1))
}

/// If a target hardly moves for hours, or crosses the field in no time, its stamps have another unit.
fn of_times(recording: &Recording, columns: &Columns<'_>) -> Option<Doubt> {
    const LONG_STEP_S: f64 = 10.0;
    const SLOW_MPS: f64 = 0.02;
    const SHORT_STEP_S: f64 = 1e-6;
    if matches!(columns.time_unit, Unit::Iso) {
        return None;
    }
    let mut steps_s = Vec::new();
    let mut speeds_mps = Vec::new();
    let mut last: Vec<Option<(f64, f64)>> = vec![None; ROBOTS_MAX];
    for index in sample(recording.len()) {
        let Some((time_s, readings)) = recording.instant(index) else { break };
        for reading in readings.filter_map(Ranging::of) {
            if let Some((then_s, range_m)) = last[reading.sensor].replace((time_s, reading.range_m))
                && time_s > then_s
            {
                steps_s.push(time_s - then_s);
                speeds_mps.push((reading.range_m - range_m).abs() / (time_s - then_s));
            }
        }
    }
    if steps_s.len() < FEWEST {
        return None;
    }
    let (step_s, speed_mps) = (median(steps_s), median(speeds_mps));
    let (index, name) = columns.time;
    let likely = if step_s >= LONG_STEP_S && speed_mps < SLOW_MPS {
        match step_s / 10_f64.powi(columns.time_unit.power_of_ten()) {
            ..5e3 => Unit::Millisecond,
            ..5e6 => Unit::Microsecond,
            _ => Unit::Nanosecond,
        }
    } else if step_s < SHORT_STEP_S && columns.time_unit != Unit::Second {
        Unit::Second
    } else {
        return None;
    };
    let line = line_to_type(columns.map, Role::Time, name, index, likely);
    let text = format!(
        "a sensor's stamps step by {step_s} s, and its ranges change by {speed_mps:.1e} m/s (medians): if the stamps are in {}, {line}",
        likely.symbol()
    );
    Some(Doubt { kind: DoubtKind::TimesInAnotherUnit, text })
}

fn median(values: impl IntoIterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.into_iter().collect();
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}
