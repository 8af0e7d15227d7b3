//! A radio and a drive on serial ports, FIFOs, files or standard streams.
//!
//! The radio prints ranges in one of the formats of [`rangehound_shared::radio`]; the ranges of one anchor are this robot's. The
//! drive gets one command per line: `heading_rad,speed_mps`.
//!
//! A port is a path. A device (`/dev/ttyUSB0`, a pseudo-terminal) gives ranges and takes commands. Anything
//! else (a FIFO, a file) and `-`, standard input, gives ranges only, and the commands go to standard output. The settings of a
//! device are not changed; set it up first, for example with `stty -F /dev/ttyUSB0 115200 raw -echo clocal`.
//!
//! `node/examples/serial_range.rs` builds a robot from the two.

mod actuator;
mod choice;
mod sensor;

use std::fs::{File, OpenOptions};
use std::io::{Result, stdin, stdout};
use std::os::fd::AsFd;
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::Path;

use rustix::fs::OFlags;

pub use actuator::SerialActuator;
pub use choice::Radio;
pub use sensor::SerialSensor;

/// The path for standard input and output.
const STANDARD: &str = "-";

/// Opens the source of ranges. Opening a FIFO blocks until a writer opens it.
fn reader(port: &Path) -> Result<File> {
    if port == Path::new(STANDARD) {
        return Ok(stdin().as_fd().try_clone_to_owned()?.into());
    }
    options(OFlags::empty()).read(true).open(port)
}

/// Opens the destination of commands. A device never blocks; standard output is shared with other processes, and stays as it is.
fn writer(port: &Path) -> Result<File> {
    if port != Path::new(STANDARD) && port.metadata()?.file_type().is_char_device() {
        return options(OFlags::NONBLOCK).write(true).open(port);
    }
    Ok(stdout().as_fd().try_clone_to_owned()?.into())
}

/// The port must not become the controlling terminal, whose hang-up would end this process.
fn options(more: OFlags) -> OpenOptions {
    let mut options = OpenOptions::new();
    options.custom_flags((OFlags::NOCTTY | more).bits().cast_signed());
    options
}
