//! A range sensor on a port, read in a thread of its own.

use std::io::{BufReader, Read, Result};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use rangehound_shared::message::WorldEntry;
use rangehound_shared::scenario::Calibration;

use super::{lines, reader};
use crate::sensor::{RangeSensor, calibrated_m};

/// The newest range that came over a port.
///
/// Malformed lines are counted and told once, in the log, as is the end of the stream, after which there is no range
/// any more. The thread that reads ends with the stream or the process.
#[derive(Debug)]
pub struct SerialSensor {
    newest: Newest,
    std_m: f64,
    age_max: Duration,
}

/// The newest range that has not been given yet, m, and when it came.
type Newest = Arc<Mutex<Option<(f64, Instant)>>>;

impl SerialSensor {
    /// The sensor on a port, whose ranges are calibrated, have this standard deviation, m, and count for as long as
    /// `age_max`. A FIFO that nobody writes to yet is waited for by the thread.
    ///
    /// # Errors
    /// The system's, if there is no such port or no thread can be started.
    pub fn open(port: &Path, calibration: Calibration, std_m: f64, age_max: Duration) -> Result<Self> {
        if port != Path::new(super::STANDARD) {
            port.metadata()?;
        }
        let port = port.to_owned();
        Self::start(move || reader(&port), calibration, std_m, age_max)
    }

    fn start<R: Read>(
        open: impl FnOnce() -> Result<R> + Send + 'static,
        calibration: Calibration,
        std_m: f64,
        age_max: Duration,
    ) -> Result<Self> {
        let newest = Newest::default();
        let sensor = Self { newest: Arc::clone(&newest), std_m, age_max };
        thread::Builder::new().name("ranges".to_owned()).spawn(move || listen(open(), calibration, &newest))?;
        Ok(sensor)
    }
}

impl RangeSensor for SerialSensor {
    fn std_m(&self) -> f64 {
        self.std_m
    }

    fn measure(&mut self, _tick: u64, _entry: &WorldEntry) -> Option<f64> {
        let newest = self.newest.lock().unwrap_or_else(PoisonError::into_inner).take();
        newest.filter(|(_, came)| came.elapsed() <= self.age_max).map(|(range_m, _)| range_m)
    }
}

/// Keeps the newest range of a stream until it ends.
fn listen(stream: Result<impl Read>, calibration: Calibration, newest: &Newest) {
    let (mut ranges, mut malformed) = (0_u64, 0_u64);
    let read = stream.and_then(|stream| {
        lines::read_ranges(BufReader::new(stream), |range_m| match range_m {
            Some(range_m) => {
                ranges += 1;
                let range_m = calibrated_m(range_m, calibration);
                *newest.lock().unwrap_or_else(PoisonError::into_inner) = Some((range_m, Instant::now()));
            }
            None => {
                malformed += 1;
                if malformed == 1 {
                    log::warn!("port: expected lines like 12.34 or A,12.34, m; others are passed over and counted");
                }
            }
        })
    });
    let why = read.map_or_else(|error| format!(" ({error})"), |()| String::new());
    log::warn!("port: ended{why} after {ranges} ranges and {malformed} malformed lines; there is no range any more");
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{PipeWriter, Write, pipe};

    const LONG: Duration = Duration::from_secs(1000);

    fn sensor(age_max: Duration) -> (PipeWriter, SerialSensor) {
        let (stream, mut radio) = pipe().unwrap();
        radio.write_all(b"\n").unwrap();
        let calibration = Calibration { bias_m: 1.0, scale: 0.0 };
        (radio, SerialSensor::start(move || Ok(stream), calibration, 0.1, age_max).unwrap())
    }

    /// The next range that the thread has read.
    fn next(sensor: &mut SerialSensor) -> f64 {
        let began = Instant::now();
        loop {
            if let Some(range_m) = sensor.measure(1, &WorldEntry::default()) {
                return range_m;
            }
            assert!(began.elapsed() < Duration::from_secs(60), "no range");
            thread::yield_now();
        }
    }

    #[test]
    fn a_range_is_calibrated_and_given_once() {
        let (mut radio, mut sensor) = sensor(LONG);
        assert_eq!(sensor.measure(1, &WorldEntry::default()), None);
        for line in ["5\n", "A,7\n", "nonsense\n8\n"] {
            radio.write_all(line.as_bytes()).unwrap();
            let expected_m = f64::from(line.trim().bytes().last().unwrap() - b'0') - 1.0;
            assert_eq!(next(&mut sensor), expected_m);
            assert_eq!(sensor.measure(1, &WorldEntry::default()), None);
        }
        drop(radio);
        assert_eq!(sensor.measure(1, &WorldEntry::default()), None);
    }

    #[test]
    fn a_stale_range_is_none() {
        let (radio, mut sensor) = sensor(Duration::from_millis(1));
        *sensor.newest.lock().unwrap() = Some((5.0, Instant::now()));
        thread::sleep(Duration::from_millis(2));
        assert_eq!(sensor.measure(1, &WorldEntry::default()), None);
        drop(radio);
    }

    #[test]
    fn a_port_that_is_not_there_is_refused() {
        assert!(SerialSensor::open(Path::new("/dev/no such port"), Calibration::default(), 0.1, LONG).is_err());
    }
}
