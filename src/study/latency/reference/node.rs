//! One node of a reference: the command `latency-node`.
//!
//! The node reports on standard output that it is ready, and reads the start time from standard input. A robot writes its
//! stamps at the end. All of these are words of 8 bytes, little-endian.

use std::io::{Read, Write};
use std::time::Duration;

use anyhow::anyhow;
use rangehound_node::rendezvous::Role;
use rangehound_node::system::clock::{monotonic_ns, sleep_until};
use rangehound_shared::run_name::RunName;
use rangehound_shared::scenario::Scenario;

use super::{Centre, Command, DUE, Reference, Robot, SILENCE, TICK, futex, iceoryx2};
use crate::failure::Failure;
use crate::run::node::{join, prepare};
use crate::study::latency::dt_ns;

/// The word with which a node reports that it is ready.
pub(super) const READY: u64 = u64::from_le_bytes(*b"rh-ready");

/// `rangehound latency-node`: a robot or the centre of a reference run. It ends with its parent, if one is given.
///
/// # Errors
/// [`Failure`].
pub fn latency_node(
    reference: Reference,
    robot: Option<usize>,
    name: &RunName,
    parent: Option<u32>,
) -> Result<(), Failure> {
    let termination = prepare(robot.map_or(Role::Fusion, Role::Robot), parent)?;
    let run = join(name, &termination)?;
    let scenario = &run.description().scenario;
    let silence = SILENCE + Duration::from_nanos(dt_ns(scenario).unwrap_or(0));
    match (reference, robot) {
        (Reference::Iceoryx2, None) => {
            run_centre(iceoryx2::Centre::open(&run, &termination, silence)?, scenario)?;
        }
        (Reference::Iceoryx2, Some(id)) => {
            be_robot(iceoryx2::Robot::open(&run, id, &termination, silence)?, id, scenario)?;
        }
        (Reference::Futex, None) => run_centre(futex::Centre::open(&run, &termination, silence)?, scenario)?,
        (Reference::Futex, Some(id)) => be_robot(futex::Robot::open(&run, &termination, silence)?, id, scenario)?,
        (Reference::Udp | Reference::Quic | Reference::Zenoh, _) => {
            return Err(Failure::input("--reference: expected iceoryx2 or futex; rangehound-gateway does the others"));
        }
    }
    Ok(())
}

/// Waits for all ranges, answers all robots, and announces when the next range is due.
fn run_centre(mut link: impl Centre, scenario: &Scenario) -> anyhow::Result<()> {
    let dt_ns = dt_ns(scenario);
    let mut due_ns = wait_for_start()?;
    for tick in 1..=scenario.ticks {
        link.collect(tick)?;
        if let Some(dt_ns) = dt_ns {
            due_ns += dt_ns;
            // As in the simulator: lost time is not made up by a burst of ticks.
            let now_ns = monotonic_ns();
            if due_ns <= now_ns {
                due_ns = now_ns + dt_ns;
            }
        }
        let mut command: Command = [tick; _];
        command[DUE] = due_ns;
        link.answer(&command)?;
    }
    // If this publisher ended, a robot that is not yet connected would miss its last command. The parent closes the input
    // once it has received the stamps of all robots.
    let _ = std::io::stdin().read(&mut [0]);
    Ok(())
}

/// Publishes a range whenever it is due, waits for the command, and stamps both.
fn be_robot(mut link: impl Robot, id: usize, scenario: &Scenario) -> anyhow::Result<()> {
    let mut stamps: Vec<[u64; 2]> = Vec::with_capacity(usize::try_from(scenario.ticks)?);
    let (mut due_ns, mut held_ns) = (wait_for_start()?, monotonic_ns());
    for tick in 1..=scenario.ticks {
        if due_ns > held_ns {
            // After a signal the range goes out early; the wait for its command then notices the request to end.
            sleep_until(due_ns)?;
        }
        let sent_ns = monotonic_ns();
        link.publish(&[id as u64, tick, sent_ns, 0])?;
        let command = link.command(tick)?;
        held_ns = monotonic_ns();
        if command[TICK] != tick {
            return Err(anyhow!("the command is not of tick {tick}, but of {}", command[TICK]));
        }
        due_ns = command[DUE];
        stamps.push([sent_ns, held_ns]);
    }
    let bytes: Vec<u8> = stamps.iter().flatten().flat_map(|stamp| stamp.to_le_bytes()).collect();
    std::io::stdout().write_all(&bytes)?;
    Ok(())
}

/// Reports that this node is ready, and waits until all nodes are.
fn wait_for_start() -> anyhow::Result<u64> {
    let mut out = std::io::stdout();
    out.write_all(&READY.to_le_bytes())?;
    out.flush()?;
    let mut start_ns = [0; 8];
    std::io::stdin().read_exact(&mut start_ns)?;
    Ok(u64::from_le_bytes(start_ns))
}
