//! Writes a recording as CSV in rangehound's own form, which reads back to the last bit.

use std::borrow::Cow;
use std::fmt::Write as _;
use std::io::Write;

use super::{RecordedMeasurement, Recording, SensorName};

/// Bytes per write.
const CHUNK: usize = 1 << 16;

/// Writes a recording.
pub(super) fn write_csv(recording: &Recording, mut out: impl Write) -> std::io::Result<()> {
    let has_heights = recording.has_heights();
    let height = if has_heights { "sensor_z_m," } else { "" };
    let mut text = format!("time_s,sensor_id,sensor_x_m,sensor_y_m,{height}range_m");
    let mut extras = Vec::new();
    for (index, name) in
        ["bearing_rad", "sensor_heading_rad", "sensor_std_m", "sensor_heading_std_rad"].iter().enumerate()
    {
        if recording.readings.extras().iter().any(|numbers| numbers[index].is_some()) {
            let _ = write!(text, ",{name}");
            extras.push(index);
        }
    }
    text.push('\n');
    // Few sensors move, and most of the time goes into formatting numbers.
    let mut places: Vec<PlaceText> = recording.sensors.iter().map(|sensor| PlaceText::new(&sensor.name)).collect();
    let mut time = String::new();
    for index in 0..recording.len() {
        let Some((time_s, readings)) = recording.instant(index) else { break };
        time.clear();
        // Shortest decimals that read back, never with an exponent. A write to a string cannot fail.
        let _ = write!(time, "{time_s},");
        for reading in readings {
            text.push_str(&time);
            text.push_str(places[reading.sensor].at(&reading, has_heights));
            push(&mut text, reading.range_m);
            for index in &extras {
                text.push(',');
                push(&mut text, reading.extras()[*index]);
            }
            text.push('\n');
        }
        if text.len() >= CHUNK {
            out.write_all(text.as_bytes())?;
            text.clear();
        }
    }
    out.write_all(text.as_bytes())?;
    out.flush()
}

/// Appends a field, empty if there is no number.
fn push(text: &mut String, number: Option<f64>) {
    let _ = number.map_or(Ok(()), |number| write!(text, "{number}"));
}

/// The last written fields of sensor and place.
struct PlaceText {
    name: String,
    written: Option<([f64; 2], Option<f64>)>,
    text: String,
}

impl PlaceText {
    fn new(name: &SensorName) -> Self {
        Self { name: as_field(name.as_str()).into_owned(), written: None, text: String::new() }
    }

    fn at(&mut self, reading: &RecordedMeasurement, has_heights: bool) -> &str {
        let place = (reading.position_m, reading.height_m);
        if self.written != Some(place) {
            let ([x_m, y_m], height_m) = place;
            self.text.clear();
            let _ = write!(self.text, "{},{x_m},{y_m},", self.name);
            if has_heights {
                push(&mut self.text, height_m);
                self.text.push(',');
            }
            self.written = Some(place);
        }
        &self.text
    }
}

/// A name as a field, quoted if necessary.
fn as_field(name: &str) -> Cow<'_, str> {
    if name.contains(['"', ',']) { format!("\"{}\"", name.replace('"', "\"\"")).into() } else { name.into() }
}
