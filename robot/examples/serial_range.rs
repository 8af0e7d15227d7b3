//! One robot of a run, with its range sensor and its drive on a serial port: where a driver of one's own begins.
//!
//! ```sh
//! cargo run --release --example serial_range -- --name demo --id 0 --port /dev/ttyUSB0
//! ```
//!
//! Other hardware: implement `RangeSensor` and `Actuator` for it, and give them to `run_with` in place of these two.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use clap::Parser;
use rangehound_robot::run::run_with;
use rangehound_robot::serial::{SerialActuator, SerialSensor};
use rangehound_shared::rendezvous::{Rendezvous, Role, RunName};
use rangehound_shared::scenario::{Calibration, bounds};
use rangehound_shared::signal::Termination;

/// One robot of a run, with its range sensor and its drive on a serial port.
///
/// Reads ranges, one a line, as `12.34` or `A,12.34` (m, after a label), and writes commands as `heading_rad,speed_mps`:
/// to the port if it is a device, else to standard output.
#[derive(Debug, Parser)]
struct Args {
    /// Name of the run to join; waits for it to be founded
    #[arg(long)]
    name: RunName,
    /// Which robot of the team, counted from 0
    #[arg(long, value_name = "N")]
    id: usize,
    /// Device, FIFO or file; - for standard input
    #[arg(long, value_name = "PATH")]
    port: PathBuf,
    /// Age at which a range is none any more, s [default: the scenario's time step]
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
    ensure!(bounds::BIAS_M.contains(&args.range_bias), "--range-bias: expected {:?} m", bounds::BIAS_M);
    ensure!(bounds::SCALE.contains(&args.range_scale), "--range-scale: expected {:?}", bounds::SCALE);
    let termination = Termination::listen()?;
    Role::Robot(args.id).name_process();
    let waiting = || log::warn!("waiting for run {}; `rangehound sim --name {0}` starts it", args.name);
    let run = Rendezvous::join(&args.name, &termination, waiting)?;
    let scenario = &run.description().scenario;
    let robot = scenario.robots.get(args.id).context("--id: the run has no such robot")?;

    let port = || format!("--port {}", args.port.display());
    let calibration = Calibration { bias_m: args.range_bias, scale: args.range_scale };
    let max_age = args.max_age.unwrap_or(Duration::from_secs_f64(scenario.dt_s));
    let mut sensor = SerialSensor::open(&args.port, calibration, robot.told_std_m, max_age).with_context(port)?;
    let mut actuator = SerialActuator::open(&args.port).with_context(port)?;
    Ok(run_with(&run, args.id, &mut sensor, &mut actuator, &termination)?)
}

fn seconds(text: &str) -> Result<Duration> {
    Ok(Duration::try_from_secs_f64(text.parse()?)?)
}
