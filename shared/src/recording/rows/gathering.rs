//! Collects the measurements of a log into a recording.

use std::collections::HashMap;

use crate::ROBOTS_MAX;
use crate::recording::anchors::{Anchor, Anchors};
use crate::recording::measurements::Measurements;
use crate::recording::{Instant, RecordedMeasurement, Recording, Sensor, SensorName};

/// Most measurements: 14 h of 20 sensors at 10 Hz; each takes up to 100 bytes of memory, with a bearing 180.
const MEASUREMENTS_MAX: usize = 10_000_000;

/// Most sensors without an anchor that a message names.
const UNPLACED_MAX: usize = ROBOTS_MAX;

/// Why a measurement cannot be added.
pub(in crate::recording) enum Refusal {
    /// The sensor's name is invalid.
    NoName(String),
    /// The recording would exceed a limit.
    TooMany(String),
    /// The stamp is before the previous measurement's.
    NotInOrder(f64),
}

/// The measurements of a log in order of time. Sensors are numbered in order of appearance until the end.
#[derive(Default)]
pub(in crate::recording) struct Gathering<'a> {
    anchors: Option<&'a Anchors>,
    numbers: HashMap<Box<str>, usize>,
    names: Vec<SensorName>,
    places: Vec<Option<Anchor>>,
    /// Sensors of the log that have no anchor.
    pub(in crate::recording) unplaced: Vec<SensorName>,
    times_s: Vec<f64>,
    readings: Measurements,
}

impl<'a> Gathering<'a> {
    pub(in crate::recording) fn new(anchors: Option<&'a Anchors>) -> Self {
        Self { anchors, ..Self::default() }
    }

    /// The number of a sensor.
    pub(in crate::recording) fn sensor(&mut self, name: &[u8]) -> Result<usize, Refusal> {
        let no_name = || Refusal::NoName(crate::recording::name::SensorNameError.to_string());
        let text = std::str::from_utf8(name).map_err(|_| no_name())?.trim();
        if let Some(&number) = self.numbers.get(text) {
            return Ok(number);
        }
        let name: SensorName = text.parse().map_err(|_| no_name())?;
        let number = self.names.len();
        if number == ROBOTS_MAX {
            return Err(Refusal::TooMany(format!("1 to {ROBOTS_MAX} different sensors up to this row")));
        }
        let place = self.anchors.and_then(|anchors| anchors.get(&name));
        if self.anchors.is_some() && place.is_none() && self.unplaced.len() < UNPLACED_MAX {
            self.unplaced.push(name.clone());
        }
        self.numbers.insert(text.into(), number);
        self.names.push(name);
        self.places.push(place);
        Ok(number)
    }

    /// The sensor's place in the anchors file.
    pub(in crate::recording) fn place(&self, sensor: usize) -> Option<Anchor> {
        self.places[sensor]
    }

    pub(in crate::recording) fn last_time_s(&self) -> Option<f64> {
        self.times_s.last().copied()
    }

    pub(in crate::recording) fn len(&self) -> usize {
        self.readings.len()
    }

    /// Adds a measurement.
    pub(in crate::recording) fn push(&mut self, time_s: f64, reading: RecordedMeasurement) -> Result<(), Refusal> {
        if let Some(before_s) = self.last_time_s().filter(|before_s| time_s < *before_s) {
            return Err(Refusal::NotInOrder(before_s));
        }
        if self.readings.len() == MEASUREMENTS_MAX {
            return Err(Refusal::TooMany(format!("at most {MEASUREMENTS_MAX} measurements")));
        }
        self.times_s.push(time_s);
        self.readings.push(reading);
        Ok(())
    }

    /// Anchors without a measurement.
    pub(in crate::recording) fn silent_anchors(&self) -> Vec<SensorName> {
        let anchors = self.anchors.into_iter().flat_map(Anchors::iter).map(|(name, _)| name);
        anchors.filter(|name| !self.numbers.contains_key(name.as_str())).cloned().collect()
    }

    /// The recording, and the number of repeated measurements that were left out.
    pub(in crate::recording) fn finish(mut self) -> (Recording, u64) {
        self.drop_names_without_measurements();
        let repeats = self.drop_repeats();
        let mut order: Vec<usize> = (0..self.names.len()).collect();
        order.sort_by(|one, other| self.names[*one].cmp(&self.names[*other]));
        let mut rank = vec![0; order.len()];
        for (place, number) in order.iter().enumerate() {
            rank[*number] = place;
        }
        let mut first_positions = vec![None; order.len()];
        self.readings.renumber(&rank);
        for reading in self.readings.iter() {
            first_positions[reading.sensor].get_or_insert(reading.position_m);
        }
        let sensors = order
            .iter()
            .zip(first_positions)
            .filter_map(|(number, position_m)| {
                Some(Sensor { name: self.names[*number].clone(), first_position_m: position_m? })
            })
            .collect();
        let instants = instants(&self.times_s, self.readings.sensors(0..self.readings.len()));
        (Recording { sensors, instants, readings: self.readings }, repeats)
    }

    fn drop_names_without_measurements(&mut self) {
        let mut has_any = vec![false; self.names.len()];
        for sensor in self.readings.sensors(0..self.readings.len()) {
            has_any[sensor] = true;
        }
        if has_any.iter().all(|has| *has) {
            return;
        }
        let mut renumbered = Vec::with_capacity(has_any.len());
        let mut next = 0;
        for has in &has_any {
            renumbered.push(next);
            next += usize::from(*has);
        }
        self.readings.renumber(&renumbered);
        let mut has = has_any.into_iter();
        self.names.retain(|_| has.next().unwrap_or(false));
    }

    /// Drops all measurements that equal another of their stamp: fused again, they would count as new information.
    fn drop_repeats(&mut self) -> u64 {
        let (mut kept, mut start) = (0, 0);
        let mut order: Vec<usize> = Vec::new();
        while start < self.readings.len() {
            let time_s = self.times_s[start];
            let rest = &self.times_s[start..];
            let end = start + rest.iter().position(|other| *other != time_s).unwrap_or(rest.len());
            order.clear();
            if has_sensor_twice(self.readings.sensors(start..end)) {
                order.extend(start..end);
                order.sort_by_key(|index| bits(self.readings.get(*index)));
                order.dedup_by_key(|index| bits(self.readings.get(*index)));
                order.sort_unstable();
            } else {
                order.extend(start..end);
            }
            for &index in &order {
                self.times_s[kept] = time_s;
                self.readings.overwrite(kept, index);
                kept += 1;
            }
            start = end;
        }
        let repeats = self.readings.len() - kept;
        self.times_s.truncate(kept);
        self.readings.truncate(kept);
        repeats as u64
    }
}

fn has_sensor_twice(mut sensors: impl Iterator<Item = usize>) -> bool {
    let mut seen = [false; ROBOTS_MAX];
    sensors.any(|sensor| std::mem::replace(&mut seen[sensor], true))
}

/// All data of a reading in which two readings can differ.
fn bits(reading: RecordedMeasurement) -> impl Ord {
    let bits = |number: Option<f64>| number.map(f64::to_bits);
    let (place, extras) = (reading.position_m.map(f64::to_bits), reading.extras().map(bits));
    (reading.sensor, place, bits(reading.height_m), bits(reading.range_m), extras)
}

/// Measurements with one stamp form one instant, unless a sensor would be in it twice.
fn instants(times_s: &[f64], sensors: impl Iterator<Item = usize>) -> Vec<Instant> {
    let mut instants: Vec<Instant> = Vec::new();
    let mut heard = [false; ROBOTS_MAX];
    for (index, (time_s, sensor)) in times_s.iter().zip(sensors).enumerate() {
        match instants.last_mut() {
            Some(instant) if instant.time_s == *time_s && !heard[sensor] => instant.readings_end = index + 1,
            _ => {
                heard = [false; ROBOTS_MAX];
                instants.push(Instant { time_s: *time_s, readings_end: index + 1 });
            }
        }
        heard[sensor] = true;
    }
    instants
}
