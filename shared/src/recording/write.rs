//! A recording as CSV in our own form, which is read back the same to the last bit.

use std::borrow::Cow;
use std::fmt::Write as _;
use std::io::Write;

use super::Recording;

/// Bytes that are written at once.
const CHUNK: usize = 1 << 16;

/// Writes a recording.
pub(super) fn write_csv(recording: &Recording, mut out: impl Write) -> std::io::Result<()> {
    let has_heights = recording.has_heights();
    let names: Vec<Cow<'_, str>> = recording.sensors.iter().map(|sensor| as_field(sensor.name.as_str())).collect();
    let height = if has_heights { "sensor_z_m," } else { "" };
    let mut text = format!("time_s,sensor_id,sensor_x_m,sensor_y_m,{height}range_m\n");
    for index in 0..recording.len() {
        let Some((time_s, readings)) = recording.instant(index) else { break };
        for reading in readings {
            let [x_m, y_m] = reading.position_m;
            // Shortest decimals that read back, and never an exponent. Text in memory takes all that is written.
            let _ = write!(text, "{time_s},{},{x_m},{y_m},", names[reading.sensor]);
            if has_heights {
                let _ = reading.height_m.map_or(Ok(()), |z_m| write!(text, "{z_m}"));
                text.push(',');
            }
            let _ = writeln!(text, "{}", reading.range_m);
        }
        if text.len() >= CHUNK {
            out.write_all(text.as_bytes())?;
            text.clear();
        }
    }
    out.write_all(text.as_bytes())?;
    out.flush()
}

/// A name as a field, in quotes where it needs them.
fn as_field(name: &str) -> Cow<'_, str> {
    if name.contains(['"', ',']) { format!("\"{}\"", name.replace('"', "\"\"")).into() } else { name.into() }
}
