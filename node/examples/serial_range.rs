//! Runs one robot with its range sensor and its drive on a serial port: a starting point for your own driver.
//!
//! ```sh
//! cargo run --release --example serial_range -- --name demo --id 0 --port /dev/ttyUSB0
//! cargo run --release --example serial_range -- --name demo --id 0 --port /dev/ttyUSB0 --format dwm1001 --anchor 022E
//! ```
//!
//! Other hardware: implement `Sensor`, `PoseSource` and `Actuator` for it, and pass them to `run_with` instead of these.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use clap::error::ErrorKind;
use clap::{CommandFactory, Parser};
use rangehound_node::rendezvous::{Rendezvous, Role};
use rangehound_node::robot::run_with;
use rangehound_node::serial::{Radio, SerialActuator, SerialSensor};
use rangehound_node::system::signal::Termination;
use rangehound_robot::pose;
use rangehound_shared::radio::Format;
use rangehound_shared::run_name::RunName;
use rangehound_shared::scenario::{Calibration, bounds};

/// One robot of a run, with its range sensor and its drive on a serial port.
///
/// Reads ranges as the radio prints them and writes commands as lines `heading_rad,speed_mps`.
#[derive(Debug, Parser)]
struct Args {
    /// Name of the run to join; waits until the run exists
    #[arg(long)]
    name: RunName,
    /// Number of the robot in the team, from 0
    #[arg(long, value_name = "N")]
    id: usize,
    /// Device, FIFO or file; - for standard input
    #[arg(long, value_name = "PATH")]
    port: PathBuf,
    /// Format of the radio: plain (lines of `12.34` or `A,12.34`, m), dwm1001 (`lec` or `les` in its shell), linktrack
    /// (NodeFrame3), mauwb (`AT+RANGE=`)
    #[arg(long, default_value_t)]
    format: Format,
    /// Anchor that measures this robot's range, by the id that the radio prints; all formats but plain need it
    #[arg(long, value_name = "ID")]
    anchor: Option<String>,
    /// Tag that measures this robot's range, if the radio prints tag ids [default: the first seen]
    #[arg(long, value_name = "ID")]
    tag: Option<String>,
    /// Destination of commands: a device, or - for standard output [default: the port if it is a device and plain, else -]
    #[arg(long, value_name = "PATH")]
    drive: Option<PathBuf>,
    /// Age at which a range expires, s [default: the scenario's time step]
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    max_age: Option<Duration>,
    /// Bias B in `measured = (1+S) true + B`, m
    #[arg(long, value_name = "B", default_value_t = 0.0, allow_negative_numbers = true)]
    range_bias: f64,
    /// Scale error S in `measured = (1+S) true + B`
    #[arg(long, value_name = "S", default_value_t = 0.0, allow_negative_numbers = true)]
    range_scale: f64,
}

fn main() -> Result<()> {
    env_logger::Builder::from_env(env_logger::Env::default().default_filter_or("warn")).format_target(false).init();
    let args = Args::parse();
    if args.format != Format::Plain && args.anchor.is_none() {
        let complaint = format!(
            "--anchor is missing for --format {}: expected the id of the anchor that measures this robot's range",
            args.format
        );
        Args::command().error(ErrorKind::MissingRequiredArgument, complaint).exit();
    }
    ensure!(
        bounds::BIAS_M.contains(&args.range_bias),
        "--range-bias is {}: expected {:?} m",
        args.range_bias,
        bounds::BIAS_M
    );
    ensure!(
        bounds::SCALE.contains(&args.range_scale),
        "--range-scale is {}: expected {:?}",
        args.range_scale,
        bounds::SCALE
    );
    let termination = Termination::listen()?;
    Role::Robot(args.id).name_process();
    let waiting = || log::warn!("waiting for run {}; `rangehound sim --name {0}` starts it", args.name);
    let run = Rendezvous::join(&args.name, &termination, waiting)?;
    let scenario = &run.description().scenario;
    let robot = scenario.robots.get(args.id).with_context(|| {
        format!("robot {} (--id) is not in the run: expected 0 to {}", args.id, scenario.robots.len() - 1)
    })?;

    let port = || format!("--port {}", args.port.display());
    let calibration = Calibration { bias_m: args.range_bias, scale: args.range_scale };
    let max_age = args.max_age.unwrap_or(Duration::from_secs_f64(scenario.dt_s));
    let radio = Radio { format: args.format, anchor: args.anchor, tag: args.tag };
    let std_m = robot.reported.range.with_context(|| format!("robot {} has no ranges in the scenario", args.id))?.std_m;
    let mut sensor = SerialSensor::open(&args.port, radio, calibration, std_m, max_age).with_context(port)?;
    // A robot with a localiser of its own passes that instead.
    let mut poses = pose::of_scenario(scenario, args.id).context("the scenario gives this robot no pose")?;
    // A radio's shell would take drive commands for its own: send them elsewhere.
    let command_port = if args.format == Format::Plain { args.port.clone() } else { PathBuf::from("-") };
    let drive = args.drive.unwrap_or(command_port);
    let mut actuator =
        SerialActuator::open(&drive).with_context(|| format!("cannot send commands to {}", drive.display()))?;
    Ok(run_with(&run, args.id, (&mut sensor, poses.as_mut(), &mut actuator), &termination)?)
}

fn seconds(text: &str) -> Result<Duration> {
    Ok(Duration::try_from_secs_f64(text.parse()?)?)
}
