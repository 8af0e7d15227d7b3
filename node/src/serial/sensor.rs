//! A range sensor on a port, read in its own thread.

use std::io::{ErrorKind, Read, Result};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use rangehound_robot::sensor::{Sensed, Sensor, calibrated_m};
use rangehound_shared::message::WorldEntry;
use rangehound_shared::radio::{Counts, Parser};
use rangehound_shared::scenario::Calibration;

use super::choice::Choice;
use super::{Radio, reader};
use crate::system::clock::monotonic_ns;

/// The newest range received on a port.
///
/// Refused lines are counted; the log says so of the first, the tenth, the hundredth and so on, and of the end of the
/// stream, after which there are no more ranges. The reading thread ends with the stream or the process.
#[derive(Debug)]
pub struct SerialSensor {
    newest: Newest,
    std_m: f64,
    age_max: Duration,
}

/// The newest unread range, m, and when it came, monotonic ns.
type Newest = Arc<Mutex<Option<(f64, u64)>>>;

impl SerialSensor {
    /// Opens the sensor on a port. Its ranges are calibrated, have this standard deviation, m, and expire after
    /// `age_max`. If the port is a FIFO without a writer, the thread waits for one.
    ///
    /// # Errors
    /// The system's, if the port does not exist or no thread can be started; invalid input if the radio reports several
    /// anchors and none is selected.
    pub fn open(port: &Path, radio: Radio, calibration: Calibration, std_m: f64, age_max: Duration) -> Result<Self> {
        if port != Path::new(super::STANDARD) {
            port.metadata()?;
        }
        let port = port.to_owned();
        Self::start(move || reader(&port), radio, calibration, std_m, age_max)
    }

    fn start<R: Read>(
        open: impl FnOnce() -> Result<R> + Send + 'static,
        radio: Radio,
        calibration: Calibration,
        std_m: f64,
        age_max: Duration,
    ) -> Result<Self> {
        let newest = Newest::default();
        let parser = Parser::listening(radio.format);
        let mut listener = Listener {
            sample: radio.format.sample(),
            parser,
            choice: radio.choice()?,
            calibration,
            newest: Arc::clone(&newest),
        };
        let sensor = Self { newest, std_m, age_max };
        thread::Builder::new().name("ranges".to_owned()).spawn(move || listener.listen(open()))?;
        Ok(sensor)
    }
}

impl Sensor for SerialSensor {
    fn sense(&mut self, _tick: u64, _entry: &WorldEntry) -> Sensed {
        let newest = self.newest.lock().unwrap_or_else(PoisonError::into_inner).take();
        let newest = newest.filter(|(_, came_ns)| age(*came_ns) <= self.age_max);
        newest.map_or_else(Sensed::default, |(range_m, _)| Sensed::range(range_m, self.std_m))
    }
}

fn age(came_ns: u64) -> Duration {
    Duration::from_nanos(monotonic_ns().saturating_sub(came_ns))
}

/// Keeps the newest range of a stream.
struct Listener {
    sample: &'static str,
    parser: Parser,
    choice: Choice,
    calibration: Calibration,
    newest: Newest,
}

impl Listener {
    /// Reads a stream until it ends.
    fn listen(&mut self, stream: Result<impl Read>) {
        let read = stream.and_then(|stream| self.read(stream));
        let why = read.map_or_else(|error| format!(" ({error})"), |()| String::new());
        let Counts { reports, refused, .. } = self.parser.counts();
        log::warn!(
            "port: the stream has ended{why} after {reports} reports and {refused} refused lines or frames: this robot has no more ranges"
        );
    }

    fn read(&mut self, mut stream: impl Read) -> Result<()> {
        let mut bytes = [0; 1024];
        let mut warn_at = 1;
        loop {
            let len = match stream.read(&mut bytes) {
                Ok(0) => return Ok(()),
                Ok(len) => len,
                Err(error) if error.kind() == ErrorKind::Interrupted => continue,
                Err(error) => return Err(error),
            };
            let Self { parser, choice, calibration, newest, .. } = self;
            let mut first_refusal = None;
            parser.push(&bytes[..len], |report| match report {
                Ok(report) => {
                    if let Some(range_m) = choice.range_m(&report) {
                        let range_m = calibrated_m(range_m, *calibration);
                        *newest.lock().unwrap_or_else(PoisonError::into_inner) = Some((range_m, monotonic_ns()));
                    }
                }
                Err(refusal) => first_refusal = first_refusal.or(Some(refusal)),
            });
            let Counts { reports, refused, .. } = parser.counts();
            if let Some(refusal) = first_refusal
                && refused >= warn_at
            {
                if warn_at == 1 {
                    let sample = self.sample;
                    log::warn!(
                        "port: a line or frame is refused ({refusal}): expected {sample}; further ones are skipped and counted"
                    );
                } else {
                    log::warn!("port: {refused} lines or frames refused, {reports} accepted");
                }
                while warn_at <= refused {
                    warn_at *= 10;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{PipeWriter, Write, pipe};

    fn sensed(sensor: &mut SerialSensor) -> Option<f64> {
        sensor.sense(1, &WorldEntry::default()).range_m.map(|(range_m, _)| range_m)
    }

    const LONG: Duration = Duration::from_secs(1000);

    fn sensor(age_max: Duration) -> (PipeWriter, SerialSensor) {
        let (stream, mut radio) = pipe().unwrap();
        radio.write_all(b"\n").unwrap();
        let calibration = Calibration { bias_m: 1.0, scale: 0.0 };
        (radio, SerialSensor::start(move || Ok(stream), Radio::default(), calibration, 0.1, age_max).unwrap())
    }

    /// The next range read by the thread.
    fn next(sensor: &mut SerialSensor) -> f64 {
        let began = std::time::Instant::now();
        loop {
            if let Some(range_m) = sensed(sensor) {
                return range_m;
            }
            assert!(began.elapsed() < Duration::from_secs(60), "no range");
            thread::yield_now();
        }
    }

    #[test]
    fn a_range_is_calibrated_and_given_once() {
        let (mut radio, mut sensor) = sensor(LONG);
        assert_eq!(sensed(&mut sensor), None);
        for line in ["5\n", "A,7\n", "nonsense\nA,6,52\n8\n"] {
            radio.write_all(line.as_bytes()).unwrap();
            let expected_m = f64::from(line.trim().bytes().last().unwrap() - b'0') - 1.0;
            assert_eq!(next(&mut sensor), expected_m);
            assert_eq!(sensed(&mut sensor), None);
        }
        drop(radio);
        assert_eq!(sensed(&mut sensor), None);
    }

    #[test]
    fn a_stale_range_is_none() {
        let (radio, mut sensor) = sensor(Duration::from_millis(1));
        *sensor.newest.lock().unwrap() = Some((5.0, monotonic_ns()));
        thread::sleep(Duration::from_millis(2));
        assert_eq!(sensed(&mut sensor), None);
        drop(radio);
    }

    #[test]
    fn a_port_that_is_not_there_is_refused() {
        let (port, radio) = (Path::new("/dev/no such port"), Radio::default());
        assert!(SerialSensor::open(port, radio, Calibration::default(), 0.1, LONG).is_err());
    }
}
