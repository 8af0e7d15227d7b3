//! The notes of a gateway to the tools of its host about the robots on other hosts, and their orders to it.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::rendezvous::{Rendezvous, RendezvousError};

/// Name of the note.
const NOTE: &str = "gateway";

/// The links of a gateway.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GatewayNote {
    /// The gateway's process.
    pub pid: u32,
    /// The robots that have joined.
    pub robots: Vec<RemoteRobotNote>,
    /// Peers that were refused, by cause.
    pub refusals: BTreeMap<String, u64>,
}

/// The link to one robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RemoteRobotNote {
    /// Its number.
    pub robot: usize,
    /// Its host, by its certificate, or its address.
    pub host: String,
    /// Its address.
    pub address: String,
    /// The round trip, us, if it has answered.
    pub round_trip_us: Option<u64>,
    /// Part of the packets to it that were lost.
    pub lost: f64,
    /// Part of the frames to it that were repeats.
    pub repeated: f64,
    /// Time since its last frame, ms.
    pub silent_ms: u64,
    /// True if its host lets tools of the run's host end it.
    #[serde(default)]
    pub allows_control: bool,
}

/// How a robot on another host is to end. It is started again by the service manager of its host, if at all.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum RobotOrder {
    /// At once, as in a crash.
    Kill,
    /// In order.
    End,
}

impl RobotOrder {
    /// Writes it for the gateway.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn write(self, run: &Rendezvous, robot: usize) -> Result<(), RendezvousError> {
        // Removes the outcome of an earlier order.
        let _ = Self::has_arrived(run, robot);
        run.write_note(&order_of(robot), &serde_json::to_string(&self).unwrap_or_default())
    }

    /// The order for a robot, which is given once.
    #[must_use]
    pub fn take(run: &Rendezvous, robot: usize) -> Option<Self> {
        serde_json::from_str(&run.take_note(&order_of(robot))?).ok()
    }

    /// The gateway reports whether the robot has confirmed its order.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn report(run: &Rendezvous, robot: usize, has_arrived: bool) -> Result<(), RendezvousError> {
        run.write_note(&outcome_of(robot), if has_arrived { ARRIVED } else { "lost" })
    }

    /// True if the robot has confirmed its order; `None` until this is decided. The answer is reported once.
    #[must_use]
    pub fn has_arrived(run: &Rendezvous, robot: usize) -> Option<bool> {
        run.take_note(&outcome_of(robot)).map(|outcome| outcome == ARRIVED)
    }
}

/// The report of an order that was confirmed.
const ARRIVED: &str = "arrived";

fn outcome_of(robot: usize) -> String {
    format!("outcome-robot-{robot}")
}

fn order_of(robot: usize) -> String {
    format!("order-robot-{robot}")
}

impl GatewayNote {
    /// Leaves it for the tools.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn write(&self, run: &Rendezvous) -> Result<(), RendezvousError> {
        run.write_note(NOTE, &serde_json::to_string(self).unwrap_or_default())
    }

    /// The note of a run's gateway, if it has one that lives.
    #[must_use]
    pub fn read(run: &Rendezvous) -> Option<Self> {
        let note: Self = serde_json::from_str(&run.note(NOTE)?).ok()?;
        let pid = rustix::process::Pid::from_raw(i32::try_from(note.pid).ok()?)?;
        rustix::process::test_kill_process(pid).is_ok().then_some(note)
    }
}
