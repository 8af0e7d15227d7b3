//! Measurements of a bag as a table in order of time, which is then read and checked as any recording is; and true tracks.

mod fields;
mod text;

use std::collections::{BTreeMap, HashMap};
use std::io::Read;
use std::path::Path;

use rangehound_shared::recording::{ColumnMap, TrackPoint};

use super::cdr::CdrError;
use super::definition::{ROOT, Types, short};
use super::selection::{Pattern, TopicField, patterns};
use super::storage::{self, Sink, Topic};
use super::{Fault, interfaces};
use crate::files::bytes_read::BytesRead;
use fields::{Measures, Place, Stamp};
use text::Text;

/// Most measurements, and most positions: as in other recordings.
const ROWS_MAX: usize = 10_000_000;

/// The first bytes of a message that is compressed by itself.
const ZSTD_MAGIC: &[u8] = &[0x28, 0xB5, 0x2F, 0xFD];

/// A position counts for this time after the last message of its topic, ns.
const LAST_NS: i64 = 1_000_000_000;

/// The user's selection of a bag's contents.
#[derive(Debug, Clone, Copy, Default)]
pub struct Selection<'a> {
    /// Topics with measurements: names with commas between them, and at most one `*` in each.
    pub topic: Option<&'a str>,
    /// Topic with the sensors' positions: `TOPIC[:FIELD]`.
    pub position: Option<&'a str>,
    /// Fields of the measurements by key.
    pub columns: Option<&'a ColumnMap>,
    /// Definitions of types that the bag lacks: `package/msg/Name`, and the text.
    pub definitions: &'a [(String, String)],
    /// The positions of all sensors are in another file.
    pub has_anchors: bool,
}

/// Numbers of a measurement, in this order; NaN where there is none.
const NUMBERS: [(&str, &str); 8] = [
    ("range", "range_m"),
    ("bearing", "bearing_rad"),
    ("x", "sensor_x_m"),
    ("y", "sensor_y_m"),
    ("z", "sensor_z_m"),
    ("heading", "sensor_heading_rad"),
    ("position_std", "sensor_std_m"),
    ("heading_std", "sensor_heading_std_rad"),
];

const RANGE: usize = 0;
const BEARING: usize = 1;
const X: usize = 2;

/// A measurement: stamp, sensor and target by number, and numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Row {
    time_ns: i64,
    sensor: u32,
    target: u32,
    /// The number of the part of its topic's name for which `*` stands.
    part: u32,
    numbers: [f64; NUMBERS.len()],
}

/// Where a sensor was: position (z is NaN if there is none), heading, and standard deviations, NaN where they are not known.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Fix {
    time_ns: i64,
    position_m: [f64; 3],
    heading_rad: f64,
    position_std_m: f64,
    heading_std_rad: f64,
}

/// Texts by number.
#[derive(Debug, Default)]
struct Names {
    texts: Vec<String>,
    numbers: HashMap<String, u32>,
}

impl Names {
    fn number(&mut self, text: &str) -> u32 {
        if let Some(number) = self.numbers.get(text) {
            return *number;
        }
        let number = self.texts.len() as u32;
        self.texts.push(text.to_owned());
        self.numbers.insert(text.to_owned(), number);
        number
    }
}

/// A bag's measurements as a table.
#[derive(Debug)]
pub struct BagTable {
    rows: Vec<Row>,
    sensors: Vec<String>,
    targets: Vec<String>,
    /// The names of time, sensor and target. Without targets it is empty.
    names: [String; 3],
    /// The columns of numbers: their place in [`NUMBERS`], and their names.
    numbers: Vec<(usize, String)>,
    /// How the columns are to be read.
    pub map: ColumnMap,
}

impl BagTable {
    /// Reads the measurements that the user chose.
    ///
    /// # Errors
    /// [`Fault`] of the bag, or of the choice.
    pub fn read(path: &Path, selection: &Selection<'_>, bytes: &BytesRead) -> Result<Self, Fault> {
        let none = ColumnMap::default();
        let mut reading = Reading::new(selection.columns.unwrap_or(&none), selection.definitions);
        reading.wanted = selection.topic.map(patterns).transpose()?.unwrap_or_default();
        reading.position = selection.position.map(TopicField::parse).transpose()?;
        if let Some(position) = &reading.position {
            if selection.has_anchors {
                let hint = "expected --position or --anchors, not both";
                return Err(Fault::new("two sources of the sensors' positions", hint));
            }
            if position.topic.has_star() && !reading.wanted.iter().all(Pattern::has_star) {
                let hint = "expected one in each topic of --topic too: both stand for the same part of the name";
                return Err(Fault::new("a * in --position", hint));
            }
        }
        if reading.wanted.is_empty() {
            // The topics are listed.
            reading.position = None;
        }
        storage::read(path, &mut reading, bytes)?;
        reading.into_table(selection.has_anchors)
    }

    /// The text of the table.
    pub fn text(&self) -> impl Read {
        Text::of(self)
    }
}

/// Reads a track from a topic, `TOPIC[:FIELD]`, in order of time.
///
/// # Errors
/// [`Fault`] of the bag, or of the choice.
pub fn read_track(path: &Path, topic: &str, definitions: &[(String, String)]) -> Result<Vec<TrackPoint>, Fault> {
    let none = ColumnMap::default();
    let mut reading = Reading::new(&none, definitions);
    reading.position = Some(TopicField::parse(topic)?);
    storage::read(path, &mut reading, &BytesRead::default())?;
    reading.check_topics()?;
    let mut fixes: Vec<Fix> = reading.fixes.into_values().flatten().collect();
    fixes.sort_by_key(|fix| fix.time_ns);
    if fixes.len() < 2 {
        return Err(Fault::new(format!("fewer than two positions on {topic}"), "expected a track of two or more"));
    }
    Ok(fixes.iter().map(|fix| (fix.time_ns as f64 / 1e9, [fix.position_m[0], fix.position_m[1]])).collect())
}

/// A bag that is being read.
struct Reading<'a> {
    wanted: Vec<Pattern>,
    position: Option<TopicField>,
    map: &'a ColumnMap,
    definitions: &'a [(String, String)],
    /// All topics of the bag, each with its type and its fields that look like measurements.
    topics: BTreeMap<String, String>,
    read: Vec<ReadTopic>,
    rows: Vec<Row>,
    fixes: HashMap<u32, Vec<Fix>>,
    fix_count: usize,
    sensors: Names,
    targets: Names,
    parts: Names,
}

/// A topic that is read.
struct ReadTopic {
    name: String,
    types: Types,
    stamp: Stamp,
    /// Its measurements, and the number of the part of its name for which `*` stands.
    measures: Option<(Measures, u32)>,
    /// Its positions, and the number of their part.
    place: Option<(Place, u32)>,
}

impl<'a> Reading<'a> {
    fn new(map: &'a ColumnMap, definitions: &'a [(String, String)]) -> Self {
        Self {
            wanted: Vec::new(),
            position: None,
            map,
            definitions,
            topics: BTreeMap::new(),
            read: Vec::new(),
            rows: Vec::new(),
            fixes: HashMap::new(),
            fix_count: 0,
            sensors: Names::default(),
            targets: Names::default(),
            parts: Names::default(),
        }
    }

    /// The definition of a topic's type.
    fn types(&self, topic: &Topic<'_>) -> Result<Types, Fault> {
        if let Some(obstacle) = topic.obstacle {
            return Err(Fault::new(
                format!("the topic {} cannot be read", topic.name),
                format!("expected CDR and ros2msg, but {obstacle}"),
            ));
        }
        let given = self.definitions.iter().find(|(name, _)| short(name) == short(topic.type_name));
        let given = given.map(|(_, text)| text.as_str());
        let text = given.or(topic.definition).or_else(|| interfaces::definition(&short(topic.type_name)));
        let Some(text) = text else {
            let hint =
                format!("expected a definition: type --msg {}=FILE with the fields of the type", topic.type_name);
            return Err(Fault::new(format!("no definition of {}", topic.type_name), hint));
        };
        Types::parse(topic.type_name, text).map_err(|reason| {
            Fault::new(format!("no usable definition of {}", topic.type_name), format!("expected ros2msg: {reason}"))
        })
    }

    /// How a topic is read, if it is one of those that were chosen.
    fn read_topic(&mut self, topic: &Topic<'_>) -> Result<Option<ReadTopic>, Fault> {
        let name = topic.name;
        let wanted = self.wanted.iter().find_map(|wanted| Some((wanted.has_star(), wanted.part(name)?)));
        let position = self.position.as_ref();
        let position = position.and_then(|position| Some((position.field.as_deref(), position.topic.part(name)?)));
        if wanted.is_none() && position.is_none() {
            return Ok(None);
        }
        let types = self.types(topic)?;
        let of = |problem: String| Fault::new(format!("the topic {name}"), problem);
        // The user's time is that of measurements.
        let none = ColumnMap::default();
        let stamp = Stamp::of(&types, if wanted.is_some() { self.map } else { &none }).map_err(of)?;
        let measures = wanted.map(|(has_star, part)| {
            Measures::of(&types, topic, has_star.then_some(part), self.map).map(|measures| (measures, part)).map_err(of)
        });
        let place = position
            .map(|(field, part)| Place::of(&types, field).map(|place| (place, part)).map_err(of))
            .transpose()?;
        let (measures, parts) = (measures.transpose()?, &mut self.parts);
        let measures = measures.map(|(measures, part)| (measures, parts.number(part)));
        let place = place.map(|(place, part)| (place, parts.number(part)));
        Ok(Some(ReadTopic { name: name.to_owned(), types, stamp, measures, place }))
    }

    /// Refuses a bag without the topics that were chosen.
    fn check_topics(&self) -> Result<(), Fault> {
        let listed = || {
            const SHOWN: usize = 12;
            let measured: Vec<String> = self
                .topics
                .iter()
                .filter(|(_, what)| what.contains(": "))
                .map(|(name, what)| format!("{name} ({what})"))
                .collect();
            let all = || self.topics.iter().map(|(name, what)| format!("{name} ({what})")).collect();
            let list: Vec<String> =
                if measured.is_empty() || self.wanted.is_empty() && self.position.is_some() { all() } else { measured };
            let more = list.len().saturating_sub(SHOWN);
            let more = if more > 0 { format!(" and {more} more") } else { String::new() };
            list.into_iter().take(SHOWN).collect::<Vec<_>>().join(", ") + &more
        };
        if self.wanted.is_empty() && self.position.is_none() {
            return Err(Fault::new("no topic is chosen", format!("expected --topic with one of {}", listed())));
        }
        let position = self.position.as_ref().map(|position| &position.topic);
        for pattern in self.wanted.iter().chain(position) {
            if !self.topics.keys().any(|name| pattern.part(name).is_some()) {
                return Err(Fault::new(
                    format!("no topic {}", pattern.text()),
                    format!("expected one of {}", listed()),
                ));
            }
        }
        Ok(())
    }

    /// The measurements that were read, as a table.
    fn into_table(self, has_anchors: bool) -> Result<BagTable, Fault> {
        self.check_topics()?;
        let Self { rows, fixes, read, map, sensors, targets, position, .. } = self;
        let measured: Vec<&ReadTopic> = read.iter().filter(|topic| topic.measures.is_some()).collect();
        let names = || measured.iter().map(|topic| topic.name.as_str()).collect::<Vec<_>>().join(", ");
        if rows.is_empty() {
            let hint = "expected messages with ranges or bearings";
            return Err(Fault::new(format!("no measurement on {}", names()), hint));
        }
        if rows.iter().all(|row| row.time_ns == 0) && rows.len() > 1 {
            let hint = "expected stamps: for the time of recording, type --columns time=log";
            return Err(Fault::new(format!("stamps that are never set on {}", names()), hint));
        }
        let mut rows = in_order(rows);
        if let Some(position) = &position {
            place(&mut rows, fixes, !position.topic.has_star());
        }
        let is_place = |index: usize| position.is_some() && (X..X + 2).contains(&index);
        let has_any = |index: usize| rows.iter().any(|row| !row.numbers[index].is_nan());
        let is_used = |index: &usize| map.given(NUMBERS[*index].0).is_some() || is_place(*index) || has_any(*index);
        let name = |(key, own): (&str, &str)| map.given(key).map_or(own, |(column, _)| column).to_owned();
        let numbers: Vec<(usize, String)> =
            (0..NUMBERS.len()).filter(is_used).map(|index| (index, name(NUMBERS[index]))).collect();
        let names = [name(("time", "time_s")), name(("sensor", "sensor_id")), name(("target", ""))];
        let has_bearing = numbers.iter().any(|(index, _)| *index == BEARING);
        let measures = measured.iter().filter_map(|topic| topic.measures.as_ref()).map(|(measures, _)| measures);
        let map = with_units(map, measures, has_anchors && has_bearing)?;
        Ok(BagTable { rows, sensors: sensors.texts, targets: targets.texts, names, numbers, map })
    }
}

/// The user's columns with the units that the types tell. Beside anchors the bearing is named, so that the table is not taken for
/// one with a column for each anchor.
fn with_units<'a>(
    map: &ColumnMap,
    measures: impl Iterator<Item = &'a Measures> + Clone,
    names_bearing: bool,
) -> Result<ColumnMap, Fault> {
    let units = |index: usize| {
        let mut units = measures.clone().filter_map(|measures| measures.unit(index));
        let first = units.next().flatten();
        first.filter(|_| units.all(|unit| unit == first))
    };
    let with_unit = |key: &str, column: &str, unit: Option<&str>| {
        format!("{key}={column}{}", unit.map_or(String::new(), |unit| format!(":{unit}")))
    };
    let mut words = Vec::new();
    for (key, known) in [("time", Some("s")), ("sensor", None), ("target", None)] {
        words.extend(map.given(key).map(|(column, _)| with_unit(key, column, known)));
    }
    for (index, (key, own)) in NUMBERS.into_iter().enumerate() {
        match map.given(key) {
            Some((column, unit)) => words.push(with_unit(key, column, unit.or_else(|| units(index)))),
            None if index == BEARING && names_bearing => words.push(with_unit(key, own, Some("rad"))),
            None => {}
        }
    }
    if words.is_empty() {
        return Ok(ColumnMap::default());
    }
    words
        .join(",")
        .parse()
        .map_err(|error| Fault::new("columns that cannot be read", format!("expected --columns: {error}")))
}

impl Sink for Reading<'_> {
    fn topic(&mut self, topic: Topic<'_>) -> Result<Option<usize>, Fault> {
        let known = self.read.iter().position(|read| read.name == topic.name);
        if let Some(read) = known.and_then(|known| self.read.get(known)) {
            if read.types.name(ROOT) != short(topic.type_name) {
                let hint = "expected one type of messages on each topic";
                return Err(Fault::new(format!("two types on {}", topic.name), hint));
            }
            return Ok(known);
        }
        let fields = self.types(&topic).map(|types| fields::measured(&types)).unwrap_or_default();
        let fields = if fields.is_empty() { String::new() } else { format!(": {}", fields.join(", ")) };
        self.topics.insert(topic.name.to_owned(), format!("{}{fields}", topic.type_name));
        let Some(read) = self.read_topic(&topic)? else { return Ok(None) };
        self.read.push(read);
        Ok(Some(self.read.len() - 1))
    }

    fn message(&mut self, topic: usize, log_ns: i64, message: &[u8]) -> Result<(), Fault> {
        let Some(ReadTopic { name, types, stamp, measures, place }) = self.read.get(topic) else { return Ok(()) };
        let damaged = |error: CdrError| {
            if message.starts_with(ZSTD_MAGIC) {
                let hint = "expected a bag without compression of messages, as `ros2 bag convert` makes it";
                return Fault::new(format!("messages compressed one by one on {name}"), hint);
            }
            Fault::new(format!("{error} on {name}"), "expected messages that fit the definition of their type")
        };
        let time_ns = stamp.read(types, message, log_ns).map_err(damaged)?;
        let too_many = |what: &str| Fault::new(format!("too many {what}"), format!("expected at most {ROWS_MAX}"));
        if let Some((place, part)) = place {
            self.fix_count += 1;
            if self.fix_count > ROWS_MAX {
                return Err(too_many("positions"));
            }
            let fix = place.read(types, message, time_ns).map_err(damaged)?;
            self.fixes.entry(*part).or_default().extend(fix);
        }
        if let Some((measures, part)) = measures {
            let found = measures.read(types, message).map_err(damaged)?;
            if let Some(problem) = found.problem() {
                let hint = "expected one value for all measurements of a message, or one for each";
                return Err(Fault::new(format!("{problem} on {name}"), hint));
            }
            if self.rows.len() + found.count > ROWS_MAX {
                return Err(too_many("measurements"));
            }
            for index in 0..found.count {
                let sensor = self.sensors.number(&found.sensor(index));
                let target = self.targets.number(&found.target(index));
                self.rows.push(Row { time_ns, sensor, target, part: *part, numbers: found.numbers(index) });
            }
        }
        Ok(())
    }
}

/// The rows in order of time. A range and a bearing of one sensor and one time become one row.
fn in_order(mut rows: Vec<Row>) -> Vec<Row> {
    rows.sort_by_key(|row| (row.time_ns, row.sensor, row.target));
    rows.dedup_by(|next, row| {
        let is_same =
            (next.time_ns, next.sensor, next.target, next.part) == (row.time_ns, row.sensor, row.target, row.part);
        let has = |row: &Row, index: usize| !row.numbers[index].is_nan();
        let is_pair = has(row, RANGE) != has(next, RANGE) && has(row, BEARING) != has(next, BEARING);
        if is_same && is_pair {
            for (number, other) in row.numbers.iter_mut().zip(next.numbers) {
                *number = if number.is_nan() { other } else { *number };
            }
        }
        is_same && is_pair
    });
    rows
}

/// Gives each row the place of its sensor at its time: that of its part of the topic's name, or the one of all sensors.
fn place(rows: &mut [Row], mut fixes: HashMap<u32, Vec<Fix>>, is_of_all: bool) {
    for fixes in fixes.values_mut() {
        fixes.sort_by_key(|fix| fix.time_ns);
    }
    for row in rows {
        let of_part = if is_of_all { fixes.values().next() } else { fixes.get(&row.part) };
        let Some(fix) = of_part.and_then(|fixes| at(fixes, row.time_ns)) else { continue };
        let [x_m, y_m, z_m] = fix.position_m;
        let has_bearing = !row.numbers[BEARING].is_nan();
        let of_bearing = |number: f64| if has_bearing { number } else { f64::NAN };
        let placed = [x_m, y_m, z_m, of_bearing(fix.heading_rad), fix.position_std_m, of_bearing(fix.heading_std_rad)];
        for (number, placed) in row.numbers[X..].iter_mut().zip(placed) {
            *number = if number.is_nan() { placed } else { *number };
        }
    }
}

/// The place at a time: between two messages on the line between them; for a second after the last, the last; at any time, an
/// only one.
fn at(fixes: &[Fix], time_ns: i64) -> Option<Fix> {
    let after = fixes.partition_point(|fix| fix.time_ns < time_ns);
    let next = fixes.get(after);
    let before = after.checked_sub(1).and_then(|before| fixes.get(before));
    match (before, next) {
        (_, Some(next)) if next.time_ns == time_ns || fixes.len() == 1 => Some(*next),
        (Some(before), Some(next)) => {
            let share = (time_ns - before.time_ns) as f64 / (next.time_ns - before.time_ns) as f64;
            let turn_rad =
                (next.heading_rad - before.heading_rad).sin().atan2((next.heading_rad - before.heading_rad).cos());
            let mut fix = *before;
            for (number, next) in fix.position_m.iter_mut().zip(next.position_m) {
                *number += share * (next - *number);
            }
            fix.heading_rad += share * turn_rad;
            Some(fix)
        }
        (Some(last), None) if fixes.len() == 1 || time_ns.saturating_sub(last.time_ns) <= LAST_NS => Some(*last),
        _ => None,
    }
}
