//! A radio on a pseudo-terminal, which stands for the `/dev/ttyUSB0` of the book.

use std::fs::File;
use std::io::{ErrorKind, Read as _, Write as _};
use std::os::fd::AsFd;
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use rustix::fs::{OFlags, fcntl_setfl};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};

/// Time between two reports.
const PERIOD: Duration = Duration::from_millis(50);

/// The anchors of the DWM1001: id and place, m.
const ANCHORS: [(&str, [f64; 2]); 4] =
    [("022E", [7.94, 8.03]), ("15BA", [0.0, 8.03]), ("8B07", [7.94, 0.0]), ("D0A5", [0.0, 0.0])];

/// Where the tag is while it moves along x, m.
pub(super) const TAG_Y_M: f64 = 3.0;

/// Which radio it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// Prints one range a line.
    Plain,
    /// Has a shell, which two returns open, and prints after `lec`.
    Dwm1001,
    /// The same after these.
    Dwm1001Printing,
}

/// A radio that prints until it is unplugged.
pub(super) struct Radio {
    /// The path of its port.
    pub(super) port: String,
    unplugged: Arc<AtomicBool>,
    thread: Option<JoinHandle<String>>,
}

impl Radio {
    pub(super) fn plug(kind: Kind) -> Self {
        let radio = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
        grantpt(&radio).unwrap();
        unlockpt(&radio).unwrap();
        let port = ptsname(&radio, Vec::new()).unwrap().into_string().unwrap();
        fcntl_setfl(radio.as_fd(), OFlags::NONBLOCK).unwrap();
        let unplugged = Arc::new(AtomicBool::new(false));
        let (its, path) = (Arc::clone(&unplugged), port.clone());
        let thread = std::thread::spawn(move || play(kind, radio.into(), &path, &its));
        Self { port, unplugged, thread: Some(thread) }
    }

    /// Ends it; returns what was written to its port.
    pub(super) fn unplug(mut self) -> String {
        self.unplugged.store(true, Ordering::Relaxed);
        self.thread.take().unwrap().join().unwrap()
    }
}

impl Drop for Radio {
    fn drop(&mut self) {
        self.unplugged.store(true, Ordering::Relaxed);
    }
}

fn play(kind: Kind, mut radio: File, port: &str, unplugged: &AtomicBool) -> String {
    // An open port keeps its settings, and the other end readable, between the programs that use it.
    let flags = OFlags::NOCTTY.bits().cast_signed();
    let _open = File::options().read(true).write(true).custom_flags(flags).open(Path::new(port)).unwrap();
    let began = Instant::now();
    let mut heard = Vec::new();
    while !unplugged.load(Ordering::Relaxed) {
        std::thread::sleep(PERIOD);
        let mut bytes = [0; 4_096];
        loop {
            match radio.read(&mut bytes) {
                Ok(count) => heard.extend_from_slice(&bytes[..count]),
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(error) => panic!("{port}: {error}"),
            }
        }
        let asked = || heard.windows(5).any(|bytes| bytes == b"\rlec\r");
        let line = match kind {
            Kind::Plain => "12.34\n".to_owned(),
            Kind::Dwm1001 if !asked() => continue,
            Kind::Dwm1001 | Kind::Dwm1001Printing => report(began.elapsed().as_secs_f64()),
        };
        // Where nobody reads, the port is full, and lines are lost.
        let _ = radio.write(line.as_bytes());
    }
    String::from_utf8(heard).unwrap()
}

/// A line of `lec`: a tag on a straight way past the anchors.
fn report(time_s: f64) -> String {
    let [x_m, y_m] = [2.0 + 0.4 * time_s, TAG_Y_M];
    let anchors: String = ANCHORS
        .iter()
        .enumerate()
        .map(|(place, (id, at_m))| {
            let range_m = (at_m[0] - x_m).hypot(at_m[1] - y_m);
            format!(",AN{place},{id},{:.2},{:.2},0.00,{range_m:.2}", at_m[0], at_m[1])
        })
        .collect();
    format!("DIST,{}{anchors},POS,{x_m:.2},{y_m:.2},0.00,52\r\n", ANCHORS.len())
}
