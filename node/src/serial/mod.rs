//! A radio and a drive on serial ports, or on what stands in for them.
//!
//! The radio prints ranges in one of the formats of [`rangehound_shared::radio`]; one anchor's range is this robot's. The
//! drive is told a command a line: `heading_rad,speed_mps`.
//!
//! A port is a path. A device (`/dev/ttyUSB0`, a pseudo-terminal) takes commands as well as it gives ranges; anything
//! else (a FIFO, a file) and `-`, standard input, give ranges only, and the commands go to standard output. A device is
//! taken as it is set up, for example by `stty -F /dev/ttyUSB0 115200 raw -echo clocal`.
//!
//! `node/examples/serial_range.rs` makes a robot of the two.

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

/// The path that stands for standard input and output.
const STANDARD: &str = "-";

/// Where ranges come from. Opening a FIFO takes until somebody writes to it.
fn reader(port: &Path) -> Result<File> {
    if port == Path::new(STANDARD) {
        return Ok(stdin().as_fd().try_clone_to_owned()?.into());
    }
    options().read(true).open(port)
}

/// Where commands go.
fn writer(port: &Path) -> Result<File> {
    if port != Path::new(STANDARD) && port.metadata()?.file_type().is_char_device() {
        return options().write(true).open(port);
    }
    Ok(stdout().as_fd().try_clone_to_owned()?.into())
}

/// A port does not become the terminal whose hang-up ends this process.
fn options() -> OpenOptions {
    let mut options = OpenOptions::new();
    options.custom_flags(OFlags::NOCTTY.bits().cast_signed());
    options
}
